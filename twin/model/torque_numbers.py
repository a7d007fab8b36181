"""Numbers that a log's description states and the rigid-body regressor takes as given, as columns of torque.

Lengths and twists of axes, the zeros of joints, the direction of gravity, gear ratios, and a gain that the torque of
all joints shares. Each is as far off as the description's tolerances say; torque is linear in so small a change.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameter, axis_parameters, independent
from twin.model.regressor import Regressor
from twin.model.torque_signal import Run
from twin.physics.gravity_direction import GravityDirection
from twin.physics.joint_offset import JointOffset
from twin.physics.motion import Motion
from twin.robot.description import Entry, Robot

GAIN = "torque_gain"
LEANING = ("gravity.x", "gravity.y")  # rad, the foot's tilt


def numbers_of(robot: Robot) -> list[Parameter]:
    """Numbers of the description, values as described: m, rad, gear ratios, and one for the gain."""
    tolerance = robot.tolerances
    angle = float(np.deg2rad(tolerance.angle_deg))
    found = [p for p in axis_parameters(robot) if p.deviation > 0]
    found += [Parameter(name, "rad", "axis", False, 0.0, angle, "tolerance") for name in LEANING if angle]
    for i, drive in enumerate(robot.drives, 1):
        ratio, width = drive.gear_ratio, abs(drive.gear_ratio) * tolerance.gear_ratio
        if width and not robot.scatter(f"drives[{i - 1}].gear_ratio"):  # no log was converted with one that was assumed
            found.append(Parameter(f"drive{i}.gear_ratio", "1", "axis", False, ratio, width, "tolerance"))
    if tolerance.torque_gain:
        found.append(Parameter(GAIN, "1", "gain", False, 1.0, tolerance.torque_gain, "tolerance"))
    return found


def effect_of_number(name: str) -> tuple[str, str] | None:
    """Effect and site that a number of the description is told as; ``None`` where it is a number to people, too."""
    if name in LEANING:
        return GravityDirection.name, "base"
    owner, _, quantity = name.partition(".")
    return (JointOffset.name, f"joint{owner[4:]}") if quantity == "theta" else None


def number_columns(regressor: Regressor, run: Run, numbers: Sequence[Parameter]) -> FloatArray:
    """What each number adds to the torque of a run per unit (m, n, k), low-passed; by central differences.

    What a gain or a ratio does to friction is left to the friction of each joint, which is known less well. They depend
    on the motion alone and are computed once for a run and all that has the same motion.
    """
    if not numbers:
        return np.zeros((*run.torque.shape, 0))
    for known, columns in run.changes:
        if known is regressor:
            return columns
    torque, found = run.filtered(_through_gears(regressor, run.smooth)), []
    rotors = np.array([drive.rotor_inertia for drive in regressor.robot.drives])
    for parameter in numbers:
        if parameter.name == GAIN:
            found.append(torque + run.bodies[:, :, 10 * len(rotors) :] @ rotors)  # all that is recorded
            continue
        step = 0.1 * parameter.deviation
        high, low = (_changed(regressor, run.smooth, parameter, side) for side in (step, -step))
        change = run.filtered((high - low) / (2 * step))
        if parameter.quantity == "gear_ratio":  # the motor's torque is told times the described ratio
            joint = int(parameter.site[5:]) - 1
            change[:, joint] -= torque[:, joint] / parameter.mean
        found.append(change)
    run.changes.append((regressor, np.stack(found, axis=-1)))
    return run.changes[-1][1]


def _through_gears(regressor: Regressor, motion: Motion) -> FloatArray:
    """Torque (nt, n) of bodies and of laws of position, as described."""
    torque = regressor.carried_torque(motion)
    for column, axis, law in regressor.laws(motion, "load"):
        torque[:, axis] += regressor.columns[column].value * law
    return torque


def _changed(regressor: Regressor, motion: Motion, parameter: Parameter, step: float) -> FloatArray:
    """The same (nt, n) with one number changed by a step."""
    if parameter.quantity in ("theta", "gear_ratio"):  # the joint is elsewhere than its motor tells
        return _through_gears(regressor, _elsewhere(motion, parameter, step))
    changed = corrected(regressor.robot, [parameter], [parameter.mean + step])
    return replace(regressor, robot=changed).carried_torque(motion)


def follow(robot: Robot, log: Robot) -> Robot:
    """A robot whose axes have the zeros, and whose gravity points, as a log's description says: blows move neither."""
    axes = [
        axis.model_copy(update={"theta_deg": new.theta_deg}) for axis, new in zip(robot.axes, log.axes, strict=True)
    ]
    return robot.model_copy(update={"axes": axes, "gravity": log.gravity})


def _elsewhere(motion: Motion, parameter: Parameter, step: float) -> Motion:
    """The motion of the joints if a zero or a gear ratio is off by a step."""
    joint, shift, scale = int(parameter.site.lstrip("axisdrve")) - 1, step, 1.0
    if parameter.quantity == "gear_ratio":
        shift, scale = 0.0, 1 / (1 + step / parameter.mean)
    own = np.arange(motion.position.shape[1]) == joint
    factor = np.where(own, scale, 1.0)
    turned = motion.coupling @ own if motion.coupling is not None else own  # a zero of an axis is one of all it turns
    position = motion.position * factor + shift * turned
    return replace(
        motion, position=position, velocity=motion.velocity * factor, acceleration=motion.acceleration * factor
    )


def corrected(robot: Robot, numbers: Sequence[Parameter], values: Sequence[float], told: Collection[str] = ()) -> Robot:
    """The description with numbers changed; a gain of the record is none of the robot's.

    Args:
        told: numbers that are answers: what is told as an effect becomes its entry.
    """
    known = dict(zip((p.name for p in numbers), map(float, values), strict=True))
    for p in numbers:
        if p.name in told and p.quantity == "theta":
            angle, known[p.name] = known[p.name] - p.mean, p.mean
            robot = _added(robot, JointOffset.name, f"joint{p.site[4:]}", "angle", angle)
    if set(LEANING) <= set(told):
        robot = _added(robot, GravityDirection.name, "base", "angles", [known.pop(name, 0.0) for name in LEANING])
    axes = independent(p for p in numbers if p.name.startswith("axis"))
    robot = axes.apply(robot, np.array([known[name] for name in axes.names])) if len(axes) else robot
    drives = [
        drive.model_copy(update={"gear_ratio": known.get(f"drive{i}.gear_ratio", drive.gear_ratio)})
        for i, drive in enumerate(robot.drives, 1)
    ]
    robot = robot.model_copy(update={"drives": drives})
    lean = np.array([*(known.get(name, 0.0) for name in LEANING), 0.0])
    if not (lean.any() and np.any(robot.gravity)):
        return robot
    gravity = np.array(robot.gravity)
    turned = gravity - np.cross(lean, gravity)
    turned *= np.linalg.norm(gravity) / np.linalg.norm(turned)
    return robot.model_copy(update={"gravity": tuple(map(float, turned))})


def _added(robot: Robot, effect: str, site: str, name: str, value: float | list[float]) -> Robot:
    """A robot with an entry of one number or list, or with that added to the one that it has."""
    here = [e for e in robot.physics if (e.effect, e.site) == (effect, site)]
    total = np.add(value, here[0].values[name]).tolist() if here else value
    rest = [e for e in robot.physics if e not in here]
    return robot.model_copy(update={"physics": [*rest, Entry(effect=effect, site=site, **{name: total})]})
