"""``twin simulate``: posture in; modes, hammer FRFs, torques and pictures out."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.commands.outputs import Outputs, check_out
from twin.commands.posture_file import PostureFile, read_posture_file
from twin.errors import InputError
from twin.model.linear import LinearModel, linearise
from twin.model.modes import Modes, modes
from twin.parallel import Progress
from twin.provenance import provenance, write_json
from twin.robot.description import save_robot
from twin.robot.mechanism import Mechanism, assemble
from twin.robot.mjcf import build_spec, save_mjcf

FREQUENCY_SHARE = 0.8  # FRFs are kept up to this share of 1/pulse, where a half sine still excites


@dataclass
class Simulation:
    """What ``twin simulate`` found; prints itself, and is the JSON of the command.

    Attributes:
        case: the posture file.
        mechanism: the robot in the posture.
        linear: its linearisation.
        modes: its modes.
        campaign: the simulated hammer test, or ``None``.
        replays: per run of the trajectory, the replay and its inverse dynamics.
        files: what was written.
    """

    case: PostureFile
    mechanism: Mechanism
    linear: LinearModel
    modes: Modes
    campaign: Any = None
    replays: dict[str, Any] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    def data(self) -> dict[str, Any]:
        """The JSON of the command, SI except where a name ends in its unit."""
        m = self.modes
        return {
            "robot": self.case.robot.name,
            "posture": self.case.name,
            "q_deg": self.case.q_deg,
            "brakes": self.case.brakes,
            "modes": [
                {
                    "frequency_hz": float(m.frequency_hz[k]),
                    "damping_percent": float(m.damping_percent[k]),
                    "dominant": [{"site": site.split(".part")[0], "share": share} for site, share in m.dominant(k)],
                }
                for k in range(len(m))
            ],
            "replay": {
                name: {"torque_rms": _rms(found.replay.torque), "inverse_dynamics_rms": _rms(found.inverse)}
                for name, found in self.replays.items()
            },
            "files": self.files,
            "provenance": self.origin,
        }

    def __str__(self) -> str:
        case = self.case
        units = ["°" if axis.type == "revolute" else " m" for axis in case.robot.axes]
        position = ", ".join(f"{value:g}{unit}" for value, unit in zip(case.q_deg, units, strict=True))
        lines = [f"{case.robot.name} · {case.name} ({position}) · brakes {case.brakes}"]
        if len(self.modes):
            lines.append("  mode   frequency   damping   deflections that dominate (share of strain energy)")
        else:
            lines.append("  no modes: no axis has a stiffness")
        for k in range(len(self.modes)):
            shares = ", ".join(f"{site} {share:.0%}" for site, share in self.modes.dominant(k))
            lines.append(
                f"  {k + 1:4d}  {self.modes.frequency_hz[k]:7.2f} Hz  {self.modes.damping_percent[k]:6.2f} %   {shares}"
            )
        for posture in self.campaign.postures.values() if self.campaign else ():
            responses, excitations = posture.frf.shape[1:]
            lines.append(
                f"  hammer {posture.name}: {responses} × {excitations} FRFs, {len(posture.frequency)} lines to "
                f"{posture.frequency[-1]:.0f} Hz, peak {posture.peak_force_n:.0f} N, {posture.averages} hits each"
                + (
                    f", exponential window {posture.exponential_window_rate:.2f} 1/s"
                    if posture.exponential_window_rate
                    else ""
                )
            )
        for name, found in self.replays.items():
            torque = ", ".join(f"{value:.0f}" for value in _rms(found.replay.torque))
            error = ", ".join(f"{value:.1f}" for value in _rms(found.replay.torque - found.inverse))
            lines.append(f"  replay {name}: torque RMS {torque} N·m (N); beyond inverse dynamics {error}")
        if self.files:
            lines.append("  wrote " + ", ".join(self.files))
        return "\n".join(lines)


@dataclass(frozen=True)
class _Replayed:
    run: Any
    replay: Any
    inverse: np.ndarray


def simulate(
    path: str | Path,
    *,
    robot: str | None = None,
    without: list[str] | None = None,
    out: Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Simulation:
    """Modes, hammer test and replay of a posture file.

    Args:
        path: ``posture.yaml``.
        robot: shipped name, ``robot.yaml`` or URDF; wins over the file's.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        out: folder for MJCF, recordings, figures, ``.rrd`` and JSON; ``None`` writes nothing.
        seed: of the hammer test's noise.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    progress = progress or (lambda description, total: lambda count: None)
    check_out(out)
    case = read_posture_file(path, robot, without)
    runs = None
    if case.replay:
        from twin.measure.motion_log import read_motion_log, require_axes

        runs = require_axes(read_motion_log(case.replay), case.robot.axis_count)
    mechanism = assemble(case.robot, case.q, brakes=case.brakes)
    linear = linearise(mechanism)
    found = Simulation(case, mechanism, linear, modes(linear))
    if found.modes.growth > 1e-6 * np.abs(found.modes.pole).max(initial=1.0):
        raise InputError(case.robot.name, case.name, "the posture is not a stable equilibrium: a stiffness is too low")
    found.origin = provenance(case.inputs, {"robot": robot, "without": without or [], "seed": seed})
    if case.hammer and linear.coordinates and case.robot.accelerometers:
        found.campaign = _hammer(case, mechanism, linear, seed, progress)
    if runs:
        from twin.model.replay import inverse_dynamics, motion_of, recorded_torque, replay

        for name, run in runs.runs.items():
            tick = progress(f"replay {name}", len(run.time))
            stepped = replay(case.robot, run, progress=tick, source=runs.source)
            exact = recorded_torque(case.robot, run.time, inverse_dynamics(case.robot, motion_of(run)))
            found.replays[name] = _Replayed(run, stepped, exact)
    if out is not None:
        with Outputs(out) as outputs:
            _write(found, outputs)
    return found


def _hammer(case: PostureFile, mechanism: Mechanism, linear: LinearModel, seed: int, progress: Progress) -> Any:
    from twin.measure.campaign import Campaign
    from twin.measure.spectra import posture_from_hits
    from twin.model.hammer import HammerTest, channels, simulate_hits, window_rate

    options = case.hammer
    assert options is not None
    levels = options.force_n
    test = HammerTest(seed=seed, **options.model_dump(exclude={"force_n", "raw_hits"}))
    excitations = [point.label for point in case.robot.test_points]
    responses = list(case.robot.accelerometers)
    rate = window_rate(linear, test.duration_s)
    tick = progress("hammer test", len(levels) * len(excitations) * test.hits)
    postures = {}
    for level in levels:
        name = case.name if len(levels) == 1 else f"{case.name}@{level:g}N"
        hits = simulate_hits(mechanism, test, level, excitations, responses, progress=tick)
        posture, _ = posture_from_hits(
            name, np.array(case.q_deg), case.brakes, hits,
            exponential_window_rate=rate, fmax=FREQUENCY_SHARE / test.pulse_s,
        )  # fmt: skip
        postures[name] = replace(
            posture,
            hits=posture.hits if options.raw_hits else None,
            frf=posture.frf * _structural_share(case, linear, posture, responses, excitations),
        )
    comment = "simulated by twin simulate" + (
        "; structural damping and integral action, which no time stepping has, put in by the ratio of the linear FRFs "
        "with them and with viscous dampers in their stead" if _unstepped(linear) else ""
    )  # fmt: skip
    sides = channels(mechanism, responses), channels(mechanism, excitations)
    return Campaign(*sides, postures, "robot.yaml", comment)


def _unstepped(linear: Any) -> bool:
    return bool(linear.loss.any() or linear.integral.any())


def _structural_share(
    case: PostureFile, linear: LinearModel, posture: Any, responses: list[str], excitations: list[str]
) -> np.ndarray | float:
    """What complex stiffnesses and servos' integral action make of the FRFs that MuJoCo steps."""
    if not _unstepped(linear):
        return 1.0
    from twin.model.frf import frf, measurement_chain

    frequency, rate = np.maximum(posture.frequency, posture.frequency[1] / 2), posture.exponential_window_rate
    both = [
        frf(
            model, frequency, measurement_chain(model, case.robot, responses, excitations), exponential_window_rate=rate
        )
        for model in (linear, linear.stepped)
    ]
    return both[0] / both[1]


def _write(found: Simulation, name: Outputs) -> None:
    from twin.report import figures, scene

    case, mechanism = found.case, found.mechanism
    save_robot(name("robot.yaml"), case.robot)
    save_mjcf(name("robot.xml"), build_spec(mechanism))
    if len(found.modes):
        figures.save(figures.mode_shapes(mechanism, found.modes), name("modes.png"))
        scene.write_modes(name("modes.rrd"), mechanism, found.modes)
    if found.campaign:
        from twin.measure.campaign import write_campaign
        from twin.model.frf import frf, measurement_chain

        write_campaign(name("hammer.h5"), found.campaign)
        excitation = found.campaign.excitation.label
        flange = [label for label in case.robot.accelerometers if label in excitation][:3]
        columns = [excitation.index(label) for label in flange]
        first = next(iter(found.campaign.postures.values()))
        rows = slice(0, 3)
        band = first.frequency >= 4
        chain = measurement_chain(found.linear, case.robot, case.robot.accelerometers[rows], flange)
        exact = frf(found.linear, first.frequency[band], chain, exponential_window_rate=first.exponential_window_rate)
        shown = {"linear model": exact} | {
            f"hammer test {key}": p.frf[band][:, rows][:, :, columns] for key, p in found.campaign.postures.items()
        }
        figures.save(
            figures.frf_matrix(
                first.frequency[band], shown, case.robot.accelerometers[rows], flange, "accelerance",
                modes_hz=found.modes.frequency_hz,
            ),
            name("frf.png"),
        )  # fmt: skip
    if found.replays:
        units = ["N·m" if axis.type == "revolute" else "N" for axis in case.robot.axes]
        from twin.measure.motion_log import MotionLog, MotionRun, write_motion_log

        runs = {}
        for key, item in found.replays.items():
            r = item.replay
            runs[key] = MotionRun(
                key, r.time, r.position, item.run.sample_rate_hz, r.torque, link_position=r.link_position
            )
            stem = "replay" if len(found.replays) == 1 else f"replay-{key}"
            figures.save(
                figures.replay(r.time, item.run.torque, r.torque, item.inverse, case.robot.joint_names, units),
                name(f"{stem}.png"),
            )
            torque = {"twin": r.torque, "inverse dynamics": item.inverse}
            if item.run.torque is not None:
                torque["measured"] = item.run.torque
            servo = assemble(case.robot, r.position[0], brakes="off", drives="servo")
            scene.write_replay(name(f"{stem}.rrd"), servo, r.time, r.position, r.deflections, torque)
        write_motion_log(name("replay.h5"), MotionLog(runs, "robot.yaml"))
    path = name("simulate.json")
    found.files = name.files
    write_json(path, found.data())


def _rms(values: np.ndarray) -> list[float]:
    return [float(value) for value in np.sqrt(np.mean(np.square(values), axis=0))]
