"""What to record next where a motion log leaves rivals: the motion, load or temperature in which they differ."""

from typing import Any

from twin.diagnose.verdict import Missing

LOAD = frozenset({"payload", "parameter", "torque_constant", "rotor_inertia", "gravity_compensator", "cable_stiffness"})
SLIDING = frozenset(
    {
        "coulomb_friction", "viscous_friction", "asymmetric_friction", "stribeck_friction", "hysteresis",
        "load_dependent_friction", "time_delay", "backlash", "discovered",
    }
)  # fmt: skip


def next_log(missing: Missing) -> dict[str, Any]:
    """The next recording, with the two that it would tell apart."""
    first, (rival, _) = missing.first, missing.rivals[0]
    return {
        "description": _advice({first.effect, rival.effect}),
        "separates": [first.key, rival.key],
        "posture_deg": None,
    }


def _advice(effects: set[str]) -> str:
    if "friction_drift" in effects:
        return "the same motion from cold and again after an hour's work: only warm-up changes with the clock"
    if "load_dependent_friction" in effects:
        return "the same motion with and without a known payload at the flange: friction that follows the load changes"
    if {"hysteresis", "time_delay"} & effects and effects <= SLIDING:
        return (
            "slow motion with short reversals (10⁻⁴ to 10⁻² rad) and standstills of a second: memory holds its torque "
            "through a standstill, sliding friction and a delay do not"
        )
    if effects <= SLIDING:
        return (
            "constant speeds from 1 % to 90 % of the limit, both ways: each friction law has its own curve over speed"
        )
    if effects <= {"payload", "parameter", "torque_constant"}:
        return (
            "the same motion once more with a known mass at the flange: it scales with the torque constant, "
            "and adds to a payload"
        )
    if effects & {"rotor_inertia", "joint_coupling"}:
        return "one axis at a time, at rest and at the largest acceleration: what the others do to it shows apart"
    if effects & LOAD or "torque_ripple" in effects:
        return "one slow sweep of the axis over its whole range, there and back: torque over position at constant speed"
    return "the same trajectories at half the speed, with standstills of a second"
