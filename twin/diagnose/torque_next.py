"""What to record next where a motion log leaves rivals: the motion, load or temperature in which they differ.

Every effect states the recordings that show it (:attr:`Effect.log_tests`); here stands what these recordings are.
"""

from typing import Any

from twin.diagnose.next_test import WEIGH
from twin.diagnose.verdict import Missing
from twin.physics import CATALOGUE
from twin.physics.statements import Test

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
