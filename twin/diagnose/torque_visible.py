"""The smallest size of every suspect that a log would have shown."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.torque_fit import evaluate
from twin.diagnose.torque_suspects import Suspect
from twin.diagnose.torque_system import System, own_prior, own_values
from twin.model.torque_whitened import Columns
from twin.parallel import spread
from twin.ranges import implausible


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
