"""Times of the twin beside Pinocchio + scipy on the same chain, as ratios of one run: ``python tools/benchmark.py``.

The peer computes the same nine-degree-of-freedom modes from Pinocchio's mass matrix and central differences of its
gravity torque, with scipy's eigenvalues, and the same FRFs by scipy's dense solver line by line.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import scipy.linalg
from rich.console import Console
from rich.table import Table

from twin.measure.poles import plscf
from twin.measure.stabilisation import chart, clusters
from twin.model.frf import frf
from twin.model.hammer import HammerTest, simulate_hits
from twin.model.linear import LinearModel, linearise
from twin.model.modes import modes
from twin.robot.description import Robot, load_robot
from twin.robot.frames import axis_placement, inertia_matrix, matrix_of
from twin.robot.mechanism import assemble
from twin.robot.mjcf import compile_model

MILLING = (0, 70, -100)
AXES = {"z": pin.JointModelRZ, "x": pin.JointModelRX, "y": pin.JointModelRY}


def best_of(action: Callable[[], object], repeats: int) -> float:
    """Shortest time of several runs, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def pinocchio_chain(robot: Robot, q: np.ndarray) -> tuple[pin.Model, np.ndarray, np.ndarray]:
    """The held chain in Pinocchio: three hinges per axis, with stiffness and damping per coordinate."""
    model, parent, stiffness, damping = pin.Model(), 0, [], []
    entries = {(e.effect, e.site): e.values for e in robot.physics}
    for i, (axis, link) in enumerate(zip(robot.axes, robot.links, strict=True)):
        position, quaternion = axis_placement(axis, q[i])
        placement = pin.SE3(matrix_of(quaternion), position)
        for letter in "zxy":
            entry = entries.get(("transverse_compliance", f"joint{i + 1}.{letter}"))
            if letter == "z":
                entry = {"stiffness": axis.stiffness, "damping": axis.damping}
            assert entry is not None
            parent = model.addJoint(parent, AXES[letter](), placement, f"joint{i + 1}.{letter}")
            stiffness.append(entry["stiffness"])
            damping.append(entry["damping"])
            placement = pin.SE3.Identity()
        assert link.inertia is not None
        inertia = pin.Inertia(link.mass, np.array(link.com), inertia_matrix(link.inertia))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return model, np.array(stiffness), np.array(damping)


def peer_modes(model: pin.Model, data: pin.Data, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Poles from Pinocchio and scipy."""
    q0 = pin.neutral(model)
    M = pin.crba(model, data, q0)
    M = np.triu(M) + np.triu(M, 1).T
    step = 1e-6
    K = np.diag(stiffness)
    for k in range(model.nv):
        e = np.zeros(model.nv)
        e[k] = step
        gravity = [pin.computeGeneralizedGravity(model, data, q0 + sign * e).copy() for sign in (1, -1)]
        K[:, k] += (gravity[0] - gravity[1]) / (2 * step)
    nv = model.nv
    A = np.block([[np.zeros((nv, nv)), np.eye(nv)], [-scipy.linalg.solve(M, np.hstack([K, np.diag(damping)]))]])
    pole = scipy.linalg.eig(A)[0]
    pole = pole[pole.imag > 1e-6]
    return pole[np.argsort(np.abs(pole))]


def peer_frf(linear: LinearModel, frequency: np.ndarray, J_r: np.ndarray, J_e: np.ndarray) -> np.ndarray:
    """FRFs line by line with scipy's solver."""
    lines = []
    for omega in 2 * np.pi * frequency:
        Z = -(omega**2) * linear.M + 1j * omega * linear.C + linear.K
        lines.append(-(omega**2) * J_r @ scipy.linalg.solve(Z, J_e.T))
    return np.array(lines)


def command(*arguments: str) -> float:
    """Best of three wall-clock times of a command, s."""
    return best_of(
        lambda: subprocess.run([sys.executable, "-m", "twin", *arguments], capture_output=True, check=True), 3
    )


def chart_of_a_large_test() -> float:
    """Time of the stabilisation chart of 20 modes with 1 % noise and of choosing its poles, s."""
    rng = np.random.default_rng(0)
    omega, zeta = 2 * np.pi * np.sort(rng.uniform(6, 190, 20)), rng.uniform(0.005, 0.03, 20)
    phi, frequency = rng.normal(size=(74, 20)), np.arange(1, 1601) * 0.125
    w = 2 * np.pi * frequency[:, None]
    kernel = -(w**2) / (omega**2 - w**2 + 2j * zeta * omega * w)
    frf = np.einsum("fm,rm,em->fre", kernel, phi, phi[:3])
    noise = rng.normal(size=(2, *frf.shape))
    frf = frf + 0.01 * np.sqrt(np.mean(np.abs(frf) ** 2, axis=0) / 2) * (noise[0] + 1j * noise[1])
    return best_of(lambda: clusters(chart(plscf(frf, frequency, range(1, 61)))), 1)


def main() -> None:
    """Measure and print."""
    robot = load_robot("kr90")
    q = robot.angles(MILLING)
    mechanism = assemble(robot, q)
    compiled = compile_model(mechanism, visual=False, instruments=False)
    chain, stiffness, damping = pinocchio_chain(robot, q)
    data = chain.createData()
    linear = linearise(mechanism, compiled)
    agreement = np.abs(modes(linear).pole / peer_modes(chain, data, stiffness, damping) - 1).max()
    labels = [point.label for point in robot.test_points]
    frequency = np.linspace(0.5, 100, 800)
    J_r, J_e = linear.jacobian(robot.accelerometers), linear.jacobian(labels)
    difference = frf(linear, frequency, robot.accelerometers, labels) - peer_frf(linear, frequency, J_r, J_e)

    table = Table("what", "twin", "peer", "ratio", "target", title=f"poles agree to {agreement:.0e}")

    def row(what: str, twin: float, peer: float | None, target: str) -> None:
        scale, unit = (1e3, "ms") if twin < 0.5 else (1, "s")
        shown = f"{peer * scale:.2f} {unit}" if peer else ""
        table.add_row(what, f"{twin * scale:.2f} {unit}", shown, f"{twin / peer:.2f}" if peer else "", target)

    row(
        "modes of a loaded posture",
        best_of(lambda: modes(linearise(mechanism, compiled)), 50),
        best_of(lambda: peer_modes(chain, data, stiffness, damping), 50),
        "< 2 ms",
    )
    row(
        "69 FRFs × 800 lines",
        best_of(lambda: frf(linear, frequency, robot.accelerometers, labels), 10),
        best_of(lambda: peer_frf(linear, frequency, J_r, J_e), 5),
        "< 50 ms",
    )
    row("posture from description to modes", best_of(lambda: modes(linearise(assemble(robot, q))), 20), None, "")
    start = time.perf_counter()
    simulate_hits(mechanism, HammerTest(), 300.0, labels, robot.accelerometers)
    row("23-point hammer test, 3 hits of 16 s", time.perf_counter() - start, None, "< 20 s")
    row("chart to order 60 of 74 × 3 FRFs × 1600 lines, poles chosen", chart_of_a_large_test(), None, "< 10 s")
    row("twin --help", command("--help"), None, "< 0.4 s")
    with tempfile.TemporaryDirectory() as folder:
        posture = Path(folder) / "posture.yaml"
        posture.write_text("posture: {q_deg: [0, 70, -100]}\nhammer: false\n")
        row("twin simulate, modes only, --json", command("simulate", str(posture), "--json"), None, "< 1.5 s")
    Console().print(table)
    Console().print(f"FRFs differ from the peer's by {np.abs(difference).max():.0e} m/(s²·N)")


if __name__ == "__main__":
    main()
