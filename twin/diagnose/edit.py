"""Checks run on the new model as it was written: MuJoCo predicts what the search's algebra predicts; what an edit does.

The search evaluates FRFs with its own algebra (:mod:`twin.model.sensitivity`). Here the written files are read
again, compiled by MuJoCo, and predict the same: FRFs linearised, torque in time along a run. Blows in time are in
:mod:`twin.diagnose.levels_finding`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from twin.diagnose.records import FrfRecord, Stage
from twin.errors import InputError
from twin.measure.campaign import QUANTITIES, ComplexArray, FloatArray, laplace
from twin.measure.motion_log import MotionRun
from twin.measure.signals import lowpass
from twin.model.expansion import with_channels
from twin.model.frf import frf, measurement_chain
from twin.model.linear import linearise
from twin.model.modes import Modes, modes, same_modes
from twin.model.parameters import independent
from twin.model.recorded import without_limits
from twin.model.replay import STEP_S, inverse_dynamics, motion_of, recorded_torque, replay
from twin.model.sensitivity import Setup, observe
from twin.model.sensitivity import frf as algebra
from twin.physics import CATALOGUE
from twin.physics.payload import Payload
from twin.robot.description import Entry, Robot
from twin.robot.mechanism import assemble

ALGEBRA = 1e-6  # relative difference allowed between MuJoCo and the algebra
REPLAYED = 0.05  # the same of torque after the low-pass: an elastic robot under servos does not follow exactly
REPLAYED_S, LOW_PASS = 10.0, (3.0, 4.0)  # how much of a run is stepped: some thirty periods; Hz
DENSE_HZ = 100.0  # a replay's torque is a mean over one sample, which takes 0.3 % off 4 Hz at this rate
CHECKED_LINES = 60  # per posture are compared
EDIT_SHARE = 0.05  # of the robot's mass is the payload of the edit test
EDIT_MODES = 4
SAME_SHAPE = 0.5  # modal assurance criterion: modes of both models that are less alike are not compared


def check_linear(robot: Robot, records: Sequence[FrfRecord]) -> dict[str, Any]:
    """The written description, linearised by MuJoCo, against the algebra that found it.

    Args:
        robot: ``robot.yaml`` as written, read again.
        records: postures and channels to predict.
    """
    robot = without_limits(robot)
    worst = 0.0
    for record in {r.posture: r for r in records}.values():
        lines = record.frequency[:: max(1, len(record.frequency) // CHECKED_LINES)]
        H = predicted_by_mujoco(robot, record, lines)
        expected = predicted_by_algebra(robot, record, lines)
        worst = max(worst, float(np.linalg.norm(H - expected) / np.linalg.norm(expected)))
    return {
        "name": "model in MuJoCo", "value": worst, "limit": ALGEBRA, "passed": worst < ALGEBRA,
        "description": "robot.yaml read again and linearised by MuJoCo (mjd_transitionFD) predicts the FRFs of the "
        f"search within {worst:.1e} (limit {ALGEBRA:.0e})",
    }  # fmt: skip


def predicted_by_mujoco(robot: Robot, record: FrfRecord, frequency: np.ndarray) -> ComplexArray:
    """FRFs (nf, nr, ne) of a record's posture and channels by MuJoCo's linearisation."""
    tested = with_channels(robot, record.excitation, record.response)
    blows = with_channels(robot, record.response, record.excitation)  # a sensor and a blow of one label may be apart
    linear, struck = (linearise(assemble(r, record.q, brakes=record.brakes or "off")) for r in (tested, blows))
    chain = measurement_chain(linear, tested, record.response.label, record.excitation.label, struck)
    return np.asarray(frf(linear, frequency, chain, quantity=record.quantity, struck=struck))


def predicted_by_algebra(robot: Robot, record: FrfRecord, frequency: np.ndarray) -> ComplexArray:
    """The same by the algebra of the search."""
    setup = Setup(record.posture, record.q, record.brakes, record.response, record.excitation)
    seen, _ = observe(robot, setup, independent([]), np.zeros(0))
    return algebra(seen, laplace(frequency), QUANTITIES.index(record.quantity))


def check_xml(mjcf: Path, robot: Robot, q: np.ndarray, brakes: Any) -> dict[str, Any]:
    """The written XML in plain MuJoCo has the poles of the description."""
    mechanism = assemble(without_limits(robot), q, brakes=brakes or "off")
    described = modes(linearise(mechanism)).pole
    spec = mujoco.MjSpec.from_file(str(mjcf))
    for sensor in list(spec.sensors):  # they change no motion, and mjd_transitionFD refuses their delays
        spec.delete(sensor)
    written = modes(linearise(mechanism, spec.compile())).pole
    alike = len(described) == len(written)
    worst = float(np.max(np.abs(written / described - 1), initial=0.0)) if alike else float("inf")
    return {
        "name": "MJCF in MuJoCo", "value": worst if alike else None, "limit": ALGEBRA,
        "passed": worst < ALGEBRA,
        "description": "robot.xml loaded by MuJoCo has the poles of robot.yaml within "
        f"{worst:.1e} (limit {ALGEBRA:.0e})",
    }  # fmt: skip


def is_nonlinear(robot: Robot) -> bool:
    """Whether what was found last answers differently to different force levels."""
    return any(CATALOGUE[entry.effect].amplitude_law for entry in robot.physics[-1:])


def check_replayed(robot: Robot, run: MotionRun, source: str) -> dict[str, Any]:
    """The written description, read again, time-stepped along a run under servos against its inverse dynamics, after a
    low-pass."""
    short = _stepped_part(run)
    try:
        stepped = replay(robot, short, source=source).torque
    except InputError as trouble:  # a model that no robot is: the fit was far off
        told = f"robot.yaml cannot be stepped in time: {trouble}"
        return {
            "name": "replay in MuJoCo", "value": None, "limit": REPLAYED, "passed": False, "description": told,
        }  # fmt: skip
    exact = recorded_torque(robot, short.time, inverse_dynamics(robot, motion_of(short)))
    second = round(short.sample_rate_hz)
    inside = slice(second, -second)
    smooth = [lowpass(torque, short.sample_rate_hz, *LOW_PASS)[inside] for torque in (stepped, exact)]
    off = np.mean((smooth[0] - smooth[1]) ** 2, axis=0) / np.mean(smooth[1] ** 2, axis=0)
    value = float(np.sqrt(np.mean(off)))
    return {
        "name": "replay in MuJoCo", "value": value, "limit": REPLAYED, "passed": value < REPLAYED,
        "description": f"robot.yaml read again and stepped in time by MuJoCo along '{run.name}' gives the torque of "
        f"its inverse dynamics within {value:.1%} (limit {REPLAYED:.0%})",
    }  # fmt: skip


def _stepped_part(run: MotionRun) -> MotionRun:
    """The first seconds of a run, a sample a step at most; between the samples of a slow controller it is a spline."""
    count = round(min(REPLAYED_S, run.time[-1] - run.time[0]) * run.sample_rate_hz)
    every = max(1, int(run.sample_rate_hz * STEP_S))  # enough of what is smoothed afterwards
    series = {field.name: getattr(run, field.name) for field in fields(run)}
    first: dict[str, Any] = {name: v[:count:every] for name, v in series.items() if isinstance(v, np.ndarray)}
    short = replace(run, **first, sample_rate_hz=run.sample_rate_hz / every)
    if short.sample_rate_hz >= DENSE_HZ or len(short.time) < 2:
        return short
    time = np.arange(short.time[0], short.time[-1], 1 / DENSE_HZ)
    path = make_interp_spline(short.time, short.position, k=min(5, len(short.time) - 1))
    position, velocity, acceleration = (path.derivative(k)(time) if k else path(time) for k in range(3))
    return MotionRun(run.name, time, position, DENSE_HZ, velocity=velocity, acceleration=acceleration)


def payload_edit(before: Robot, after: Robot, records: Sequence[FrfRecord]) -> dict[str, Any] | None:
    """What a payload at the flange does to both models without refitting: an experiment that tells them apart.

    Returns:
        Mass, posture and the frequencies of the lowest modes of the model before, and of the same modes of the model
        after, each without the mass and with it. ``mode`` is the number in the model after. In that posture the two
        models shift a mode most differently; a shift to a frequency outside the recorded band counts a tenth. ``None``
        for a robot without modes.
    """
    total = sum(link.inertial[0] for link in after.links)
    mass = float(f"{EDIT_SHARE * total:.1g}")
    hung = partial(_with_payload, mass=mass)
    found: list[tuple[float, dict[str, Any]]] = []
    for record in {r.posture: r for r in records}.values():
        moved = _moved(before, after, hung, record)
        if not len(moved.number):
            continue
        shift = moved.changed_hz / moved.alone_hz - 1
        k = int(np.argmax(np.abs(shift[1] - shift[0])))
        (was, now), (was_changed, now_changed) = moved.alone_hz[:, k], moved.changed_hz[:, k]
        rows = [
            {"mode": int(number) + 1, "before_hz": list(map(float, before)), "after_hz": list(map(float, after))}
            for number, before, after in zip(moved.number, *moved.pairs(), strict=True)
        ]
        lacking = f"{100 * shift[0][k]:+.1f} %, from {was:.2f} to {was_changed:.2f} Hz"
        says = f"{100 * shift[1][k]:+.1f} %, from {now:.2f} to {now_changed:.2f} Hz"
        text = f"{mass:g} kg more at the flange would move mode {moved.number[k] + 1} in '{record.posture}' by {says}"
        if lacking != says:
            text += f"; the model without what was found says {lacking}"
        told = {"mass_kg": mass, "posture": record.posture, "modes": rows, "description": text}
        inside = record.frequency[0] <= now_changed <= record.frequency[-1]
        found.append((float(np.abs(shift[1] - shift[0])[k]) * (1.0 if inside else 0.1), told))
    return max(found, key=lambda item: item[0])[1] if found else None


@dataclass(frozen=True)
class _Moved:
    """What a change does to the modes that two models have in common.

    Attributes:
        number: (k,) of the modes in the second model, zero-based.
        alone_hz, changed_hz: (2, k) natural frequencies of both models, without the change and with it.
    """

    number: NDArray[np.intp]
    alone_hz: FloatArray
    changed_hz: FloatArray

    def pairs(self) -> FloatArray:
        """Of either model the frequency of every mode without the change and with it, (2, k, 2)."""
        return np.stack([self.alone_hz, self.changed_hz], axis=-1)


def _moved(before: Robot, after: Robot, change: Callable[[Robot], Robot], record: FrfRecord) -> _Moved:
    """The lowest modes of the model before in a record's posture, as far as the model after has them too."""
    alone = [_modes(robot, record) for robot in (before, after)]
    changed = [_modes(change(robot), record) for robot in (before, after)]
    first = np.arange(min(EDIT_MODES, *(len(m) for m in (*alone, *changed))))
    own, alike = same_modes(alone[0], first, alone[1])  # a resonator has a mode of its own among them
    first, own = first[alike > SAME_SHAPE], own[alike > SAME_SHAPE]
    then = [same_modes(m, some, other)[0] for m, some, other in zip(alone, (first, own), changed, strict=True)]
    return _Moved(
        own, np.array([m.frequency_hz[some] for m, some in zip(alone, (first, own), strict=True)]),
        np.array([m.frequency_hz[some] for m, some in zip(changed, then, strict=True)]),
    )  # fmt: skip


def _with_payload(robot: Robot, mass: float) -> Robot:
    """With a point mass more at the flange's centre."""
    values: dict[str, Any] = {"mass": mass, "com": [float(v) for v in robot.flange.position]}
    entry = Entry(effect=Payload.name, site="flange", **values)
    return robot.model_copy(update={"physics": [*robot.physics, entry]})


def _modes(robot: Robot, record: FrfRecord) -> Modes:
    tested = with_channels(without_limits(robot), record.excitation, record.response)
    return modes(linearise(assemble(tested, record.q, brakes=record.brakes or "off")))


def with_modes(records: Sequence[FrfRecord], before: Robot, after: Robot) -> list[FrfRecord]:
    """Records with the natural frequencies of the models before and after in their posture."""
    found: dict[str, dict[Stage, FloatArray]] = {}
    out = []
    for record in records:
        if record.posture not in found:
            found[record.posture] = {
                "before": _modes(before, record).frequency_hz, "after": _modes(after, record).frequency_hz
            }  # fmt: skip
        out.append(replace(record, modes_hz=found[record.posture]))
    return out
