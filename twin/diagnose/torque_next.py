"""What to record next, and what this log could have shown at all.

Where a motion log leaves rivals, the next motion, load or temperature is one in which they differ. Every effect states
the recordings that show it (:attr:`Effect.log_tests`); here stands what these recordings are.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.next_test import WEIGH
from twin.diagnose.torque_fit import evaluate
from twin.diagnose.torque_suspects import Suspect
from twin.diagnose.torque_system import System, own_prior, own_values
from twin.diagnose.verdict import Missing
from twin.model.torque_whitened import Columns
from twin.parallel import spread
from twin.physics import CATALOGUE
from twin.physics.statements import Test
from twin.ranges import implausible

ADVICE: dict[Test, str] = {
    "clock": "the same motion from cold and again after an hour's work: only warm-up changes with the clock",
    "load": "the same motion with and without a known payload at the flange: friction that follows the load changes",
    "jerk": "short moves at the largest jerk, recorded as fast as the controller can: a low-pass takes amplitude off "
    "fast torque, a delay only shifts it",
    "reversals": "slow motion with short reversals (10⁻⁴ to 10⁻² rad) and standstills of a second: friction with "
    "memory keeps its torque through a standstill, sliding friction and a delay do not",
    "speeds": "constant speeds from 1 % to 90 % of the limit, both ways: each friction law has its own curve over "
    "speed",
    "mass": "the same motion once more with a known mass at the flange: its torque scales with the torque "
    "constant, and adds to that of a payload",
    "acceleration": "one axis at a time, at rest and at the largest acceleration: the effect of the other axes on it "
    "then shows separately",
    "sweep": "one slow sweep of the axis over its whole range, there and back: torque over position at constant speed",
}
"""Tests, the most telling first."""

OTHERWISE = "the same trajectories at half the speed, with standstills of a second"
HELD = "a hammer test of the joint with its brake on, at two force levels: the gear slips there, a held rotor does not"
OFF: tuple[Test, ...] = ("mass", "sweep")  # what shows a number of the description that is off: it is a mass or a load


def next_log(missing: Missing) -> dict[str, Any]:
    """The next recording, with the two that it would tell apart; of a load and its link, what is to be done."""
    first, (rival, _) = missing.first, missing.rivals[0]
    pair = (first, rival)
    load = any(c.effect in CATALOGUE and CATALOGUE[c.effect].lever for c in pair)
    load = load and any(c.effect not in CATALOGUE and c.site.startswith("link") for c in pair)
    return {
        "description": WEIGH if load else _advice(first.effect, rival.effect),
        "separates": [first.key, rival.key],
        "posture_deg": None,
    }


def _advice(*names: str) -> str:
    """What a test shows of one alone tells it from the other; some need both to show, each in its own way."""
    laws = [CATALOGUE[name] for name in names if name in CATALOGUE]
    shown = [law.log_tests for law in laws] + [OFF] * (len(names) - len(laws))
    if shown[0] == shown[-1] and sum("levels" in law.seen_in for law in laws) == 1:  # no log tells
        return HELD
    some = {test for tests in shown for test in tests}
    both = {test for test in some if all(test in tests for tests in shown)}
    useful = (some - {"jerk", "reversals", "speeds", "mass"}) | both
    if "speeds" in both and "reversals" in some:
        useful.add("reversals")
    return next((ADVICE[test] for test in ADVICE if test in useful), OTHERWISE)


def smallest_visible(
    system: System, suspects: Sequence[Suspect], processes: int = 1, misfit: float = 1.0
) -> list[dict[str, Any]]:
    """The size of each suspect from which it would be named: its evidence then outweighs that nothing is missing.

    Other numbers of the entry are free beside it. Of its other sizes, a list's are taken in proportion, and the rest as
    is usual beside the first, or as none. A slip element is given by the torque it yields at. One that no size a robot
    can have would show is left out. What a model misses, ``misfit`` times noise in power, hides as noise does. The work
    is spread over ``processes``.
    """
    suspects = [s for s in suspects if s.effect.part != "law"]
    sizes = spread(lambda number: _visible_size(system, suspects, number, misfit), len(suspects), processes)
    return [size for size in sizes if implausible(size["value"], size["unit"], False) is None]


def _visible_size(system: System, suspects: Sequence[Suspect], number: int, misfit: float) -> dict[str, Any]:
    numbers, effects = calibration(), {s.hypothesis.effect for s in suspects}
    suspect = suspects[number]
    hypothesis, own = suspect.hypothesis, suspect.hypothesis.own
    values = suspect.starts[len(suspect.starts) // 2].copy()
    u = own_prior(own, values)
    first = suspect.sizes[0] if suspect.sizes else 0
    quantity = own[first].quantity.partition("[")[0]
    u[[k for k in suspect.sizes if own[k].quantity.partition("[")[0] == quantity]] += 0.3
    usual = suspect.effect.given_size(system.base.regressor.robot, hypothesis.site, float(own_values(own, u)[first]))
    u = own_prior(own, np.array([usual.get(p.quantity, x) for p, x in zip(own, own_values(own, u), strict=True)]))
    others = [k for k in range(len(own)) if k != first and k not in suspect.sizes]
    trial = evaluate(system, suspect, u, slopes=bool(others))
    information, _ = system.projected(trial.column)
    energy = max(float(information[0, 0]), 1e-300)  # of the entry as it is
    if others:
        joint = Columns(trial.slopes.joints, np.column_stack([trial.column.rows, trial.slopes.rows[:, others]]))
        whole, _ = system.projected(joint)
        inner = whole[1:, 1:] + np.eye(len(others))
        energy = max(float(whole[0, 0] - whole[0, 1:] @ np.linalg.solve(inner, whole[1:, 0])), 0.05 * energy)
    energy /= max(misfit, 1.0)
    sites = sum(s.hypothesis.effect == hypothesis.effect for s in suspects)
    occam = 0.5 * np.log1p(energy) * max(1, len(own) - 1)
    needed = numbers["temperature"] * np.log(2 * (len(effects) + 1) * sites) + max(occam, 2.0)
    ratio = float(np.sqrt(2 * needed / energy))
    null = suspect.effect.parameters[0].null
    parameter, value = own[first], own_values(own, u)[first]
    size = abs(value - null) * ratio if suspect.sizes else abs(value) * ratio
    return {
        "effect": hypothesis.effect, "site": hypothesis.site, "parameter": quantity,
        "value": float(size), "unit": parameter.unit,
    }  # fmt: skip
