"""Makes twin/examples/arm: what `twin example arm` writes. A six-axis arm like Universal Robots' UR10e, and its log.

The URDF has the arm's published lengths and masses, and bodies as rods of that mass. The log is Pinocchio's inverse
dynamics along random Fourier motions, with rotors, friction and one fault that the URDF knows nothing of: a hose
package that pulls at joint 1 like a spring. It is written as the record script of UR's RTDE client writes it, in
currents.

    python -m tools.make_arm [--out twin/examples/arm]
"""

import argparse
import json
from pathlib import Path

import numpy as np
import pinocchio

FOLDER = Path(__file__).parents[1] / "twin" / "examples" / "arm"
SEED, RATE_HZ, RUN_S, RUNS = 4, 100.0, 20.0, 2
MASS = (7.37, 13.05, 3.99, 2.1, 1.98, 0.62)  # kg, as the maker's URDF has them
ROD = ((0, 0, 0), (-0.6127, 0, 0), (-0.57155, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0))  # m: to the end of each link
OFFSET = ((0, 0, 0), (0, 0, 0.175), (0, 0, 0.039), (0, -0.02, 0.015), (0, 0.018, 0.01), (0, 0, -0.028))
RADIUS = (0.09, 0.08, 0.06, 0.05, 0.05, 0.045)
ORIGIN = (
    ("0 0 0.1807", "0 0 0"), ("0 0 0", "1.570796327 0 0"), ("-0.6127 0 0", "0 0 0"), ("-0.57155 0 0.17415", "0 0 0"),
    ("0 -0.11985 0", "1.570796327 0 0"), ("0 0.11655 0", "1.570796327 3.141592654 3.141592654"),
)  # fmt: skip
NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
EFFORT, SPEED = (330, 330, 150, 56, 56, 56), (2.09, 2.09, 3.14, 3.14, 3.14, 3.14)
CONSTANT = np.array([15.0, 15.0, 12.6, 9.3, 9.3, 9.3])  # N·m at the joint per ampere
GEAR, ROTOR = 101.0, np.array([3.0, 3.0, 1.3, 0.4, 0.4, 0.4]) * 1e-4  # kg·m² of a motor's shaft
VISCOUS, DRY = np.array([14.0, 16.0, 9.0, 3.0, 3.0, 3.0]), np.array([11.0, 12.0, 7.0, 3.0, 3.0, 2.5])
HOSE = {"effect": "cable_stiffness", "site": "joint1", "stiffness": 12.0, "rest": 0.2}  # N·m/rad, rad
NOISE = np.array([0.6, 0.6, 0.4, 0.15, 0.15, 0.1])  # N·m


def urdf() -> str:
    """The arm: a rod per link, at the end of which the next axis is."""
    parts = ['<?xml version="1.0"?>', '<robot name="ur_like">', '  <link name="base"/>']
    before = "base"
    for i, name in enumerate(NAMES):
        end, at = np.array(ROD[i]), np.array(OFFSET[i])
        length, r, m = float(np.linalg.norm(end)) or 2 * RADIUS[i], RADIUS[i], MASS[i]
        across, along = m * (3 * r**2 + length**2) / 12, m * r**2 / 2
        axis = 0 if end.any() else 2
        inertia = [along if k == axis else across for k in range(3)]
        com = " ".join(f"{x:g}" for x in end / 2 + at)
        rpy = "0 1.570796327 0" if axis == 0 else "0 0 0"
        parts.append(
            f'  <link name="{name}_link">\n'
            f'    <inertial><origin xyz="{com}"/><mass value="{m:g}"/>\n'
            f'      <inertia ixx="{inertia[0]:.5g}" iyy="{inertia[1]:.5g}" izz="{inertia[2]:.5g}" '
            'ixy="0" ixz="0" iyz="0"/></inertial>\n'
            f'    <visual><origin xyz="{com}" rpy="{rpy}"/>'
            f'<geometry><cylinder radius="{r:g}" length="{length:g}"/></geometry></visual>\n'
            "  </link>\n"
            f'  <joint name="{name}_joint" type="revolute">\n'
            f'    <parent link="{before}"/><child link="{name}_link"/>\n'
            f'    <origin xyz="{ORIGIN[i][0]}" rpy="{ORIGIN[i][1]}"/><axis xyz="0 0 1"/>\n'
            f'    <limit lower="-6.2832" upper="6.2832" effort="{EFFORT[i]}" velocity="{SPEED[i]}"/>\n'
            "  </joint>"
        )
        before = f"{name}_link"
    return "\n".join([*parts, "</robot>"]) + "\n"


def recorded(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (nt,) s, position (nt, 6) rad, torque (nt, 6) N·m at the joint, of one run."""
    time = np.arange(round(RUN_S * RATE_HZ)) / RATE_HZ
    middle = np.array([0.2, -1.4, 1.3, -1.2, -1.5, 0.0])
    q, v, a = (np.zeros((len(time), 6)) for _ in range(3))
    for j in range(6):
        for k in range(1, 6):
            w = 2 * np.pi * k / 10
            wave = random.uniform(0.15, 0.4) / k**0.5 * np.exp(1j * (w * time + random.uniform(0, 2 * np.pi)))
            q[:, j] += wave.real
            v[:, j] += (1j * w * wave).real
            a[:, j] -= (w**2 * wave).real
    q += middle - q.mean(axis=0)
    model = pinocchio.buildModelFromXML(urdf())
    data = model.createData()
    torque = np.array([pinocchio.rnea(model, data, *each) for each in zip(q, v, a, strict=True)])
    torque += GEAR**2 * ROTOR * a + VISCOUS * v + DRY * np.sign(v)
    torque[:, 0] += float(HOSE["stiffness"]) * (q[:, 0] - float(HOSE["rest"]))  # type: ignore[arg-type]
    return time, q, torque + NOISE * random.normal(size=torque.shape)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=FOLDER)
    write(parser.parse_args().out)


def write(out: Path) -> None:
    """The files of the example."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "arm.urdf").write_text(urdf())
    answer = {"concealed": [HOSE], "rotor_inertia_at_the_joint": (GEAR**2 * ROTOR).round(3).tolist()}
    (out / "answer.json").write_text(json.dumps(answer, indent=2) + "\n")
    random = np.random.default_rng(SEED)
    names = ["timestamp", *(f"actual_q_{i}" for i in range(6)), *(f"actual_current_{i}" for i in range(6))]
    for run in range(1, RUNS + 1):
        time, q, torque = recorded(random)
        rows = np.column_stack([time + 30 * run, q, torque / CONSTANT])
        form = ["%.3f", *["%.6f"] * 6, *["%.3f"] * 6]
        np.savetxt(out / f"run{run}.csv", rows, form, header=" ".join(names), comments="")


if __name__ == "__main__":
    main()
