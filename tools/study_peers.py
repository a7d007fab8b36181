"""`python -m tools.study_peers`: a real six-axis arm, identified by others and by this package from one half record.

The arm is the TX40 (nine seconds at 5 kHz, its URDF alone). The first half is used, the second half held out. Every
model predicts the torque of the held-out half; what is printed is RMS of the error over RMS of the torque, joint by
joint and pooled, after one low-pass for all (the one that `twin diagnose` chooses).

- *least squares*: regressor of Pinocchio, viscous and dry friction, rotor, offset; no prior, minimum norm.
- *least squares, coupled*: beside that the columns of motor 6 on axes 5 and 6, as the arm's makers state them.
- *FIGAROH*: its own regressor, elimination, base parameters (QR) and weighted least squares, filtered and thinned as in
  its TX40 example, with the same three columns. Needs `pip install figaroh`; left out where it is not installed.
- *identify*, *diagnose*: `twin identify` and `twin diagnose` on what `twin describe` makes of the URDF. Nothing is said
  of the coupling.

``TWIN_RECORDINGS`` is the folder of real recordings.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import numpy as np
import pinocchio
from scipy.signal import butter, decimate, sosfiltfilt

import twin
from tools.public_logs import RECORDINGS, need
from tools.study_payload import tx40
from twin.diagnose.records import LogRecord
from twin.measure.motion_log import MotionLog, MotionRun
from twin.measure.signals import lowpass
from twin.model.regressor import Regressor
from twin.model.torque_signal import bands_of
from twin.physics.motion import Motion
from twin.robot.description import Robot

URDF = RECORDINGS / "tx40" / "tx40.urdf"
MOTION_HZ = 100.0  # low-pass of positions, as in FIGAROH's example of this arm
THIN = 10  # samples of which one is used, likewise
EDGE = 20  # samples left out at either end, likewise
ZERO = 1e-3  # squared norm of a column that says nothing, likewise

Array = np.ndarray
Predict = Callable[[MotionRun], Array]


def halves(log: MotionLog) -> tuple[MotionRun, MotionRun]:
    """The first and the second half of a lone run."""
    (run,) = log.runs.values()
    middle = len(run.time) // 2
    assert run.torque is not None
    return tuple(
        replace(run, name=name, time=run.time[at], position=run.position[at], torque=run.torque[at])
        for name, at in (("used", slice(None, middle)), ("kept", slice(middle, None)))
    )  # type: ignore[return-value]


def motion(run: MotionRun) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration (nt, n), by a Butterworth low-pass and differences."""
    sos = butter(4, MOTION_HZ, fs=run.sample_rate_hz, output="sos")
    q = sosfiltfilt(sos, run.position, axis=0)
    v = np.gradient(q, 1 / run.sample_rate_hz, axis=0)
    return q, v, np.gradient(v, 1 / run.sample_rate_hz, axis=0)


def wrist(v: Array, a: Array) -> Array:
    """Columns (6, nt, 3) of motor 6, which turns with axes 5 and 6: inertia, viscous and dry friction."""
    out = np.zeros((6, len(v), 3))
    for axis, other in ((4, 5), (5, 4)):
        out[axis] = np.stack([a[:, other], v[:, other], np.sign(v[:, 4] + v[:, 5])], axis=1)
    return out


def pinocchio_columns(run: MotionRun, coupled: bool) -> Array:
    """Regressor (6, nt, p): ten numbers per link, viscous and dry friction, rotor and offset per joint."""
    model = pinocchio.buildModelFromUrdf(str(URDF))
    data, (q, v, a), n = model.createData(), motion(run), model.nv
    bodies = np.stack([pinocchio.computeJointTorqueRegressor(model, data, *x) for x in zip(q, v, a, strict=True)], 1)
    own = np.zeros((n, len(q), 4 * n))
    for j in range(n):
        own[j, :, 4 * j : 4 * j + 4] = np.stack([v[:, j], np.sign(v[:, j]), a[:, j], np.ones(len(q))], axis=1)
    return np.concatenate([bodies, own, *([wrist(v, a)] if coupled else [])], axis=2)


def least_squares(used: MotionRun, coupled: bool) -> Predict:
    """Every joint weighted by what plain least squares leaves of it."""
    X = decimate(pinocchio_columns(used, coupled)[:, EDGE:-EDGE], THIN, axis=1)
    tau = decimate(used.torque[EDGE:-EDGE], THIN, axis=0).T  # type: ignore[index]
    weight = np.ones(len(X))
    for _ in range(2):
        rows, y = (X / weight[:, None, None]).reshape(-1, X.shape[2]), (tau / weight[:, None]).ravel()
        found = np.linalg.lstsq(rows, y, rcond=1e-9)[0]
        weight = np.sqrt(np.mean((tau - X @ found) ** 2, axis=1))
    return lambda run: (pinocchio_columns(run, coupled) @ found).T


def figaroh(used: MotionRun) -> Predict:
    """FIGAROH's own steps, from its regressor to its weighted base parameters.

    Raises:
        ImportError: it is not installed.
    """
    from figaroh.tools.qrdecomposition import QRDecomposer
    from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate
    from figaroh.tools.robot import Robot as FigarohRobot

    tree = ElementTree.parse(URDF)  # without its shapes, whose meshes are not here
    for link in tree.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    with TemporaryDirectory() as scratch:
        tree.write(bare := Path(scratch) / "bare.urdf")
        robot = FigarohRobot(str(bare), scratch)
    n = robot.model.nv
    flags = {"has_friction": True, "has_actuator_inertia": True, "has_joint_offset": True, "is_joint_torques": True,
             "is_external_wrench": False, "force_torque": None, "act_idxv": list(range(n))}  # fmt: skip

    def columns(run: MotionRun) -> Array:
        q, v, a = motion(run)
        W = build_regressor_basic(robot, q, v, a, flags)
        return np.concatenate([W, wrist(v, a).reshape(-1, 3)], axis=1)

    thinned = decimate(columns(used).reshape(n, len(used.time), -1)[:, EDGE:-EDGE], THIN, axis=1)
    tau = decimate(used.torque[EDGE:-EDGE], THIN, axis=0).T.ravel()  # type: ignore[index]
    W = thinned.reshape(len(tau), -1)
    standard = {f"p{k}": 0.0 for k in range(W.shape[1])}
    gone, left = get_index_eliminate(W, standard, ZERO)
    solver = QRDecomposer()
    W_b, _, _, phi, _ = solver.double_decomposition(tau, build_regressor_reduced(W, gone), left, standard)
    weight = 1 / np.sqrt(np.mean((tau - W_b @ phi).reshape(n, -1) ** 2, axis=1))
    rows = np.repeat(weight, len(tau) // n)
    phi = np.linalg.lstsq(W_b * rows[:, None], tau * rows, rcond=None)[0]
    kept = solver.get_base_indices()
    return lambda run: (build_regressor_reduced(columns(run), gone)[:, kept] @ phi).reshape(n, -1).T


def identified(used: MotionRun, robot: Robot) -> Predict:
    """What `twin identify` writes, its constant torques fitted to the half that was used."""
    found = twin.identify(MotionLog({"used": used}), robot=robot).robot
    rest = used.torque - torque_of(found, used)  # type: ignore[operator]
    return lambda run: torque_of(found, run) + rest.mean(axis=0)


def torque_of(robot: Robot, run: MotionRun) -> Array:
    """Torque (nt, n) of a description along a run, without offsets."""
    q, v, a = motion(run)
    state = Motion(run.time, q, v, a)
    regressor = Regressor(robot)
    bodies = regressor.bodies(state)
    torque = bodies @ regressor.described[: bodies.shape[2]]
    for column, axis, law in regressor.laws(state):
        torque[:, axis] += regressor.described[column] * law
    return torque if regressor.complete else torque + regressor.known_torque(state)


def main() -> None:
    need("tx40")
    with TemporaryDirectory() as scratch:
        robot, log = tx40(Path(scratch), np.random.default_rng())
    used, kept = halves(log)
    bands = bands_of(MotionLog({"used": used, "kept": kept}))
    away = int(used.sample_rate_hz / 5)  # a fifth of a second, where the low-pass sees the end of the record

    def filtered(torque: Array) -> Array:
        return lowpass(torque, kept.sample_rate_hz, *bands.fit)[away:-away]

    recorded = filtered(kept.torque)  # type: ignore[arg-type]
    rows: dict[str, tuple[Array, float]] = {}
    asked: dict[str, Callable[[], Predict]] = {
        "least squares": lambda: least_squares(used, False),
        "least squares, coupled": lambda: least_squares(used, True),
        "FIGAROH, coupled": lambda: figaroh(used),
        "twin identify": lambda: identified(used, robot),
    }
    for name, make in asked.items():
        begin = time.process_time()
        try:
            predict = make()
        except ImportError as error:
            print(f"{name}: left out, {error}")
            continue
        rows[name] = filtered(predict(kept)) - recorded, time.process_time() - begin
    begin = time.process_time()
    verdict = twin.diagnose(MotionLog({"used": used, "kept": kept}), robot=robot, hold_out=["kept"])
    (record,) = [r for r in verdict.findings[0].records if isinstance(r, LogRecord) and r.held_out]
    rate = 1 / float(np.median(np.diff(record.time)))  # of its rows; its own low-pass may be wider
    error = lowpass(record.predicted["after"] - record.measured, rate, *bands.fit)
    at = record.valid & (record.time > kept.time[away]) & (record.time < kept.time[-away])
    rows["twin diagnose"] = error[at], time.process_time() - begin
    size = np.sqrt(np.mean(recorded**2, axis=0))
    print(f"held-out half, RMS of the error over RMS of the torque, % ({bands.fit[1]:.3g} Hz); then all joints, CPU s")
    for name, (error, seconds) in rows.items():
        share = 100 * np.sqrt(np.mean(error**2, axis=0)) / size
        whole = np.sqrt(np.mean(share**2))
        print(f"{name:24s}", *(f"{x:6.2f}" for x in share), f"  {whole:6.2f} {seconds:6.1f}")
    print("twin diagnose:", verdict.word, ", ".join(m.first.key for m in verdict.missing))


if __name__ == "__main__":
    main()
