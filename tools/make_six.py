"""Makes mjcf/kr90_six.yaml and its shapes from kr90.yaml: link 3 divided into elbow, forearm, hand and flange.

The paper keeps three axes and one body beyond the elbow. Here that body is divided so that its mass, centre of mass
and inertia stay exactly Table 5's while axes 4-6 stand at zero: forearm, hand and flange are cylinders of assumed
mass, and the elbow is what is left. Geometry and speeds of the wrist are the maker's. All else of it is assumed and
listed as such in the description.

    python tools/make_six.py
"""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import typer

from tools import make_shapes as shapes
from twin.physics import effect_of
from twin.robot.bodies import Inertial, fuse
from twin.robot.description import SHIPPED, Robot, load_robot, parse_robot, save_robot
from twin.robot.frames import axis_placement, inertia_six, matrix_of
from twin.robot.scaling import estimate

WRIST_M, FLANGE_M, ELBOW_M = 1.40, 0.215, 0.041  # joint 3 to wrist centre, on to the flange; the forearm's offset
SPEEDS = np.deg2rad([292, 258, 284])  # rad/s, the maker's data of the KR 90 R3100
RANGES = np.deg2rad([350, 125, 350])
CYLINDERS = ((50.0, 0.34, 1.30, 0.13), (24.0, 1.31, 1.57, 0.10), (4.0, 1.57, 1.615, 0.08))
"""Forearm, hand and flange: mass (kg), from and to along the forearm, radius (m). Lengths and radii are the shape's;
the masses are assumed, and leave the elbow, with its gear and four motors, 145 of Table 5's 223 kg."""
PEAK_TORQUE = (1030.0, 1030.0, 417.0)  # N·m of axes 4-6: gears of the size RV-40E, RV-40E, RV-20E, 2.5 times rated
WRIST_GEAR = 80.0  # reduction inside the wrist, behind the coaxial shafts of motors 5 and 6
SPINDLE = (35.0, 0.16, 0.09, 0.32)  # mass (kg), centre of mass beyond the flange, radius, length (m)
TOOL_TIP_M = 0.40  # beyond the flange
OUT = SHIPPED / "kr90_six.yaml"
AXES = (
    {"alpha_deg": -90.0, "a": ELBOW_M, "d": WRIST_M}, {"alpha_deg": 90.0}, {"alpha_deg": -90.0},
)  # fmt: skip
TITLE = """\
# KUKA KR90 R3100 with six axes: kr90.yaml whose third link is divided into elbow, forearm, hand and flange, and a
# milling spindle. With axes 4-6 locked and --without payload its modes are kr90's. Frame 3 is turned by -90 degrees
# about its axis, as axis 4 along the forearm asks: joint3.x here is joint3.y there.
# What the wrist's numbers are taken from is listed under `assumed`.
# Made from kr90.yaml by `python -m tools.make_six`; change those two, not this file.
"""


def frames() -> list[np.ndarray]:
    """Frames of links 3 … 6 in kr90's link 3 frame, the wrist at zero; (4, 4) each."""
    from twin.robot.description import Axis

    turned = trimesh.transformations.rotation_matrix(-np.pi / 2, [0, 0, 1])
    found = [turned]
    for axis in AXES:
        step = np.eye(4)
        step[:3, 3], quaternion = axis_placement(Axis(**axis), 0.0)
        step[:3, :3] = matrix_of(quaternion)
        found.append(found[-1] @ step)
    return found


def inertials(whole: Inertial) -> list[Inertial]:
    """Elbow, forearm, hand, flange in kr90's link 3 frame: together they are the whole."""
    parts: list[Inertial] = []
    for mass, start, end, radius in CYLINDERS:
        along, across = mass * radius**2 / 2, mass * (3 * radius**2 + (end - start) ** 2) / 12
        parts.append((mass, np.array([(start + end) / 2, -ELBOW_M, 0.0]), np.diag([along, across, across])))
    left = whole
    for mass, com, inertia in parts:
        left = fuse(left, (-mass, com, -inertia))
    return [left, *parts]


def solids() -> list[list[trimesh.Trimesh]]:
    """The solids of link 3's shape by body; the last three are hand and flange."""
    drawn = shapes.link3()
    elbow = [solid for solid in drawn[:-3] if solid.centroid[0] < CYLINDERS[0][1]]
    forearm = [solid for solid in drawn[:-3] if solid.centroid[0] >= CYLINDERS[0][1]]
    start, (_, _, radius, length) = WRIST_M + FLANGE_M, SPINDLE
    profile = [(0.0, 0.07), (0.03, 0.07), (0.04, radius), (length, radius), (length + 0.02, 0.03), (TOOL_TIP_M, 0.008)]
    spindle = shapes.turned([(start + x, r) for x, r in profile], "x", (-ELBOW_M, 0.0))
    return [elbow, forearm, drawn[-3:-1], [drawn[-1], spindle]]


def write_shapes(folder: Path) -> None:
    """One STL per link from the third on, in its own frame."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, (frame, parts) in enumerate(zip(frames(), solids(), strict=True), start=3):
        whole = trimesh.util.concatenate(parts).apply_transform(np.linalg.inv(frame))
        shapes.write(folder / f"link{number}.stl", trimesh.exchange.stl.export_stl(whole))


def six(kr90: Robot) -> Robot:
    """The description with six axes."""
    data: dict[str, Any] = kr90.model_dump(mode="json")
    data |= {"name": "kr90_six", "description": "KUKA KR90 R3100 with six axes, coupled wrist drives and a spindle"}
    placed = frames()
    whole = kr90.links[2].inertial
    names = ("elbow", "forearm", "hand", "flange")
    data["links"] = data["links"][:2] + [
        {"name": name, **_inertial_in(frame, part), "mesh": f"meshes/kr90_six/link{number}.stl"}
        for number, (name, frame, part) in enumerate(zip(names, placed, inertials(whole), strict=True), start=3)
    ]
    data["axes"][2]["theta_deg"] = -90.0
    data["flange"] = {"position": [0.0, 0.0, FLANGE_M]}
    _swap_elbow(data)
    _move_points(data, placed)
    _add_wrist(data)
    mass, com, radius, length = SPINDLE
    across = mass * (3 * radius**2 + length**2) / 12
    spindle = {
        "mass": mass,
        "com": [0.0, 0.0, FLANGE_M + com],
        "inertia": [across, across, mass * radius**2 / 2, 0, 0, 0],
    }
    data["physics"].append({"effect": effect_of("mass").name, "site": "flange", **spindle})
    return parse_robot(data)


def _inertial_in(frame: np.ndarray, part: Inertial) -> dict[str, Any]:
    mass, com, inertia = part
    R, x = frame[:3, :3], frame[:3, 3]
    return {
        "mass": mass, "com": np.round(R.T @ (com - x), 9).tolist(),
        "inertia": [round(value, 9) for value in inertia_six(R.T @ inertia @ R)],
    }  # fmt: skip


def _swap_elbow(data: dict[str, Any]) -> None:
    """Frame 3 is turned by a right angle: what is about x there is about y here."""
    names = {"joint3.x": "joint3.y", "joint3.y": "joint3.x"}
    for entry in data["physics"]:
        entry["site"] = names.get(entry["site"], entry["site"])
    for prior in data["priors"]:
        site, _, number = prior["parameter"].rpartition(".")
        prior["parameter"] = f"{names.get(site, site)}.{number}"


def _move_points(data: dict[str, Any], placed: list[np.ndarray]) -> None:
    """Test points of link 3 go to the body that now carries them; one more node at the tool's tip."""
    starts = [-np.inf, *(start for _, start, _, _ in CYLINDERS)]
    for point in data["test_points"]:
        if point["body"] == "link3":
            position = np.array(point["position"])
            k = max(i for i, start in enumerate(starts) if position[0] >= start)
            R, x = placed[k][:3, :3], placed[k][:3, 3]
            point["body"] = f"link{3 + k}"
            point["position"] = np.round(R.T @ (position - x), 9).tolist()
            point["direction"] = np.round(R.T @ np.array(point["direction"]), 9).tolist()
    tip = [0.0, 0.0, FLANGE_M + TOOL_TIP_M]
    data["test_points"] += [
        {"label": f"22{letter}+", "body": "link6", "position": tip, "direction": np.eye(3)[i].tolist()}
        for i, letter in enumerate("XYZ")
    ]


def _add_wrist(data: dict[str, Any]) -> None:
    """Axes 4-6 with gears, bearings, drives and friction, each listed as assumed."""
    said: list[dict[str, Any]] = []
    for mass, part in zip((part[0] for part in CYLINDERS), ("links[3]", "links[4]", "links[5]"), strict=True):
        say(said, f"{part}.mass", mass, "kg", 1.5, "a cylinder of the drawn size", "torque log")
    lag, share, overload, motor = (estimate(law) for law in ("damping_time", "tilt_share", "overload", "motor_speed"))
    for i, (axis, peak, speed, end) in enumerate(zip(AXES, PEAK_TORQUE, SPEEDS, RANGES, strict=True), start=3):
        gear = estimate("cycloidal_torsion", peak / overload.value)
        bearing = estimate("cycloidal_tilt", peak / overload.value).times(share)
        k = say(said, f"axes[{i}].stiffness", gear.value, "N·m/rad", gear.within, gear.source, "hammer test")
        d = say(said, f"axes[{i}].damping", k * lag.value, "N·m·s/rad", lag.within, lag.source, "hammer test")
        limits = {
            "position": [-float(end), float(end)], "velocity": float(speed), "torque": peak,
            "acceleration": float(f"{speed / estimate('ramp_time').value:.3g}"),
        }  # fmt: skip
        data["axes"].append({**axis, "stiffness": k, "damping": d, "limits": limits})
        ratio = say(said, f"drives[{i}].gear_ratio", motor.value / speed, "", motor.within, motor.source, "data sheet")
        rotor = estimate("rotor_inertia", peak / ratio)
        J = say(said, f"drives[{i}].rotor_inertia", rotor.value, "kg·m²", rotor.within, rotor.source, "torque log")
        turns = {f"joint{other + 1}": 1 / WRIST_GEAR for other in range(3, i)}
        data["drives"].append({"gear_ratio": ratio, "rotor_inertia": J, "coupling": turns})
        if turns:
            say(
                said,
                f"drives[{i}].coupling",
                1 / WRIST_GEAR,
                "",
                3.0,
                "coaxial shafts, geared in the wrist",
                "torque log",
            )
        for letter in "xy":
            site = f"joint{i + 1}.{letter}"
            k = say(said, f"{site}.stiffness", bearing.value, "N·m/rad", bearing.within, bearing.source, "hammer test")
            d = say(said, f"{site}.damping", k * lag.value, "N·m·s/rad", lag.within, lag.source, "hammer test")
            tilt = {"effect": effect_of("tilt").name, "site": site, "stiffness": k, "damping": d}
            data["physics"].append(tilt)
        for part, law, factor in (("viscous", "motor_viscous", ratio**2), ("dry", "motor_coulomb", ratio)):
            effect, found = effect_of("viscous" if part == "viscous" else "dry"), estimate(law, peak / ratio)
            name = effect.parameters[0]
            field = f"{effect.name}@joint{i + 1}.{name.name}"
            value = say(said, field, factor * found.value, name.unit, found.within, found.source, "torque log")
            data["physics"].append({"effect": effect.name, "site": f"joint{i + 1}", name.name: value})
    data["assumed"] = said


def say(
    said: list[dict[str, Any]], field: str, value: float, unit: str, within: float, source: str, settled_by: str
) -> float:
    """List a number as assumed; returns it as it is written, at three digits."""
    value = float(f"{value:.3g}")
    said.append({
        "field": field, "value": value, "unit": unit, "tolerance": round(within, 2), "source": f"assumed: {source}",
        "settled_by": settled_by,
    })  # fmt: skip
    return value


def main(out: Path = OUT) -> None:
    """Write the description and its shapes."""
    write_shapes(out.parent / "meshes" / "kr90_six")
    save_robot(out, six(load_robot("kr90")))
    out.write_text(TITLE + out.read_text())


if __name__ == "__main__":
    typer.run(main)
