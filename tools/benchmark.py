"""Times of the twin beside other packages, as ratios of one run: ``python tools/benchmark.py [robot] [modal]``.

``robot``: the peer computes the same nine-degree-of-freedom modes from Pinocchio's mass matrix and central differences
of its gravity torque, with scipy's eigenvalues, and the same FRFs by scipy's dense solver line by line.

``modal``: stabilisation charts of a hammer test of 74 responses, 3 references and 1600 lines by sdypy-EMA and pyOMA2
(MIT licence both) from the same FRFs, and the whole of ``twin modal`` on it, files and figures written. CPU times.
"""

import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pinocchio as pin
import scipy.linalg
from rich.console import Console
from rich.table import Table

from twin.measure.campaign import Campaign, Channels, PostureFRF, write_campaign
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

PEER_ORDER = 16  # of pyOMA2's chart, which takes minutes for more
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


def large_test() -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (1600,) in Hz and accelerance (1600, 74, 3) of 20 modes with 1 % noise."""
    rng = np.random.default_rng(0)
    omega, zeta = 2 * np.pi * np.sort(rng.uniform(6, 190, 20)), rng.uniform(0.005, 0.03, 20)
    phi, frequency = rng.normal(size=(74, 20)), np.arange(1, 1601) * 0.125
    w = 2 * np.pi * frequency[:, None]
    kernel = -(w**2) / (omega**2 - w**2 + 2j * zeta * omega * w)
    frf = np.einsum("fm,rm,em->fre", kernel, phi, phi[:3])
    noise = rng.normal(size=(2, *frf.shape))
    return frequency, frf + 0.01 * np.sqrt(np.mean(np.abs(frf) ** 2, axis=0) / 2) * (noise[0] + 1j * noise[1])


def cpu_of(action: Callable[[], object]) -> float:
    """CPU time of one run whose progress bars are not shown, s."""
    start = time.process_time()
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        action()
    return time.process_time() - start


def peer_charts(frequency: np.ndarray, frf: np.ndarray) -> list[tuple[str, int, float, float]]:
    """Peer, highest order, CPU time of the twin's chart and of the peer's, s."""
    from pyoma2.functions.plscf import pLSCF
    from sdypy import EMA

    def ema() -> None:
        model = EMA.Model(
            frf.reshape(len(frequency), -1).T, frequency, lower=1, upper=frequency[-1], pol_order_high=60,
            frf_form="accelerance",
        )  # fmt: skip
        model.get_poles(method="lscf", show_progress=False)

    spectra = np.concatenate([np.zeros((1, *frf.shape[1:]), complex), frf]).transpose(1, 2, 0)
    peers = (
        ("sdypy-EMA", 60, ema),
        ("pyOMA2", PEER_ORDER, lambda: pLSCF(spectra, 1 / (2 * frequency[-1]), PEER_ORDER)),
    )

    def mine(order: int) -> float:
        return cpu_of(lambda: clusters(chart(plscf(frf, frequency, range(1, order + 1)))))

    return [(name, order, mine(order), cpu_of(peer)) for name, order, peer in peers]


def modal_command(frequency: np.ndarray, frf: np.ndarray) -> str:
    """CPU and wall time, memory and page of ``twin modal`` with default options, and what it found, in a sentence."""
    grid = np.array([(x, y, 0.0) for x in np.linspace(0, 1, 37) for y in (0, 0.5)])
    axis = np.tile([0.0, 0.0, 1.0], (74, 1))
    label = tuple(f"{n}Z+" for n in range(1, 75))
    response = Channels(label, ("base",) * 74, grid, axis)
    excitation = Channels(label[:3], ("base",) * 3, grid[:3], axis[:3])
    posture = PostureFRF("large", np.zeros(0), None, frequency, frf, "accelerance")
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "large.h5", Path(folder) / "out"
        write_campaign(path, Campaign(response, excitation, {"large": posture}))
        start = time.perf_counter()
        line = [sys.executable, "-m", "twin", "modal", str(path), "-o", str(out)]
        child = subprocess.Popen(line, stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(child.pid, 0)
        wall = time.perf_counter() - start
        if os.waitstatus_to_exitcode(status):
            raise RuntimeError("twin modal failed")
        found = json.loads((out / "modal.json").read_text())["postures"]["large"]["modes"]
        page = (out / "modal.html").stat().st_size
    return (
        f"twin modal on 74 x 3 x 1600, files and figures: {used.ru_utime + used.ru_stime:.1f} s CPU, "
        f"{wall:.1f} s wall, {used.ru_maxrss / 2**20:.2f} GiB, page {page / 1e6:.2f} MB, {len(found)} modes of 20"
    )


def modal() -> None:
    """Charts beside peers, and the command."""
    frequency, frf = large_test()
    table = Table("chart of 74 x 3 x 1600", "order", "twin", "peer", "ratio", title="CPU time")
    for name, order, mine, theirs in peer_charts(frequency, frf):
        table.add_row(name, str(order), f"{mine:.2f} s", f"{theirs:.2f} s", f"{mine / theirs:.3f}")
    Console().print(table)
    Console().print(modal_command(frequency, frf))


def robot() -> None:
    """Modes and FRFs of the robot beside Pinocchio."""
    described = load_robot("kr90")
    q = described.angles(MILLING)
    mechanism = assemble(described, q)
    compiled = compile_model(mechanism, visual=False, instruments=False)
    chain, stiffness, damping = pinocchio_chain(described, q)
    data = chain.createData()
    linear = linearise(mechanism, compiled)
    agreement = np.abs(modes(linear).pole / peer_modes(chain, data, stiffness, damping) - 1).max()
    labels = [point.label for point in described.test_points]
    frequency = np.linspace(0.5, 100, 800)
    J_r, J_e = linear.jacobian(described.accelerometers), linear.jacobian(labels)
    difference = frf(linear, frequency, described.accelerometers, labels) - peer_frf(linear, frequency, J_r, J_e)

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
        best_of(lambda: frf(linear, frequency, described.accelerometers, labels), 10),
        best_of(lambda: peer_frf(linear, frequency, J_r, J_e), 5),
        "< 50 ms",
    )
    row("posture from description to modes", best_of(lambda: modes(linearise(assemble(described, q))), 20), None, "")
    start = time.perf_counter()
    simulate_hits(mechanism, HammerTest(), 300.0, labels, described.accelerometers)
    row("23-point hammer test, 3 hits of 16 s", time.perf_counter() - start, None, "< 20 s")
    row("twin --help", command("--help"), None, "< 0.4 s")
    with tempfile.TemporaryDirectory() as folder:
        posture = Path(folder) / "posture.yaml"
        posture.write_text("posture: {q_deg: [0, 70, -100]}\nhammer: false\n")
        row("twin simulate, modes only, --json", command("simulate", str(posture), "--json"), None, "< 1.5 s")
    Console().print(table)
    Console().print(f"FRFs differ from the peer's by {np.abs(difference).max():.0e} m/(s²·N)")


if __name__ == "__main__":
    for part in sys.argv[1:] or ["robot", "modal"]:
        {"robot": robot, "modal": modal}[part]()
