"""``twin simulate``: posture in; modes, hammer FRFs, torques and pictures out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from twin.commands.outputs import Outputs, check_out
from twin.commands.posture_file import Hammer, PostureFile, posture_in_memory, read_posture_file
from twin.errors import InputError, tell
from twin.measure.campaign import Campaign, write_campaign
from twin.measure.motion_log import MotionLog, MotionRun, require_axes, write_motion_log
from twin.model.hammer import HammerTest, usual_duration
from twin.model.linear import LinearModel, linearise
from twin.model.modes import Modes, modes
from twin.model.replay import Replay, inverse_dynamics, motion_of, recorded_torque, replay
from twin.model.simulated_test import LARGE, beyond_linear, simulated_test, suited_force
from twin.parallel import Progress, silent
from twin.physics import CATALOGUE
from twin.provenance import provenance, write_json
from twin.result import Result, written
from twin.robot.description import Robot, save_robot
from twin.robot.mechanism import Mechanism, assemble
from twin.robot.mjcf import build_spec, lit, save_mjcf
from twin.table import Table


@dataclass
class Simulation(Result):
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
    campaign: Campaign | None = None
    replays: dict[str, "Replayed"] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    drawn_by = "twin.report.simulation_figures"

    @property
    def robot(self) -> Robot:
        """The description, removals applied."""
        return self.case.robot

    @property
    def log(self) -> MotionLog:
        """The replays as a motion log: what the twin's motors and encoders did."""
        turns = self.robot.coupling.T
        runs = {
            name: MotionRun(
                name, r.replay.time, r.replay.position @ turns, r.run.sample_rate_hz, r.replay.torque,
                link_position=r.replay.link_position,
            )
            for name, r in self.replays.items()
        }  # fmt: skip
        return MotionLog(runs, self.robot.name, f"{self.case.name}, replayed")

    def stem(self, run: str) -> str:
        """Name of the files about a run."""
        return "replay" if len(self.replays) == 1 else f"replay-{run}"

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

    def tables(self) -> list[Table]:
        """Modes, with the deflections that hold most of their strain energy."""
        m = self.modes
        rows = [
            (
                str(k + 1), f"{m.frequency_hz[k]:.2f} Hz", f"{m.damping_percent[k]:.2f} %",
                ", ".join(f"{site} {share:.0%}" for site, share in m.dominant(k)),
            )
            for k in range(len(m))
        ]  # fmt: skip
        return [Table(("mode", "frequency", "damping", "share of strain energy"), rows, (1, 2))]

    def __str__(self) -> str:
        case = self.case
        units = ["°" if axis.type == "revolute" else " m" for axis in case.robot.axes]
        position = ", ".join(f"{value:g}{unit}" for value, unit in zip(case.q_deg, units, strict=True))
        lines = [f"{case.robot.name} · {case.name} ({position}) · brakes {case.brakes}"]
        if len(self.modes):
            lines.append("  mode   frequency   damping   deflections that dominate (share of strain energy)")
        else:
            skipped = ", and no hammer test" if case.hammer else ""
            lines.append(f"  no modes{skipped}: no axis has a stiffness; `twin describe` fills it in, for a drawing")
        for k in range(len(self.modes)):
            shares = ", ".join(f"{site} {share:.0%}" for site, share in self.modes.dominant(k))
            lines.append(
                f"  {k + 1:4d}  {self.modes.frequency_hz[k]:7.2f} Hz  {self.modes.damping_percent[k]:6.2f} %   {shares}"
            )
        for posture in self.campaign.postures.values() if self.campaign else ():
            responses, excitations = posture.frf.shape[1:]
            lines.append(
                f"  hammer {posture.name}: {responses} × {excitations} FRFs, {len(posture.frequency)} lines to "
                f"{posture.frequency[-1]:.0f} Hz, {posture.record_s:g} s, peak {posture.peak_force_n:.0f} N, "
                f"{posture.averages} hits each"
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
            lines.append(f"  {written(self.files)}")
        return "\n".join(lines)


@dataclass(frozen=True)
class Replayed:
    """One run of a trajectory: ``run`` as given, ``replay`` in time, ``inverse`` dynamics' torque (nt, n), N·m (N)."""

    run: MotionRun
    replay: Replay
    inverse: np.ndarray


def simulate(
    posture: str | Path | Mapping[str, Any] | Sequence[float] | np.ndarray,
    *,
    robot: Robot | str | Path | None = None,
    without: list[str] | None = None,
    brakes: Literal["on", "off"] | None = None,
    hammer: Mapping[str, Any] | bool | None = None,
    trajectory: MotionLog | str | Path | None = None,
    movie: bool = False,
    out: str | Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Simulation:
    """Modes, hammer test and replay of one posture.

    Args:
        posture: a posture file, a mapping with the content of one, or axis positions (n,) in degrees (m).
        robot: a :class:`Robot`, shipped name, ``robot.yaml`` or URDF; wins over the file's.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        brakes: wins over the file's; ``"on"`` unless one says otherwise.
        hammer: wins over the file's: keys as in a posture file, ``True`` for three hits of 300 N, ``False`` for modes
            only. Positions alone are not hit unless this says so.
        trajectory: wins over the file's ``replay``: what the twin follows.
        movie: with ``out``, also write the modes in motion as a GIF.
        out: folder for MJCF, recordings, figures, ``.rrd`` and JSON; ``None`` writes nothing.
        seed: of the hammer test's noise.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    progress = progress or silent
    check_out(out)
    changes = {"brakes": brakes, "hammer": hammer, "trajectory": trajectory}
    if isinstance(posture, str | Path):
        case = read_posture_file(posture, robot, without, **changes)
    else:
        case = posture_in_memory(posture, robot, without, **changes)
    runs = require_axes(case.trajectory, case.robot.axis_count) if case.trajectory else None
    mechanism = assemble(case.robot, case.q, brakes=case.brakes)
    linear = linearise(mechanism)
    found = Simulation(case, mechanism, linear, modes(linear))
    if found.modes.growth > 1e-6 * np.abs(found.modes.pole).max(initial=1.0):
        raise InputError(case.robot.name, case.name, "the posture is not a stable equilibrium: a stiffness is too low")
    found.origin = provenance(case.inputs, {"robot": robot, "without": without or [], "seed": seed})
    if case.hammer and linear.coordinates and case.robot.accelerometers:
        given = case.hammer.model_dump(exclude={"force_n", "raw_hits"}, exclude_none=True)
        test = HammerTest(seed=seed, **given)
        if case.hammer.duration_s is None:
            test = replace(test, duration_s=usual_duration(linear, test))
        found.campaign = simulated_test(
            mechanism, linear, test, _forces(found, test, case.hammer), name=case.name, q_deg=case.q_deg,
            raw_hits=case.hammer.raw_hits, progress=progress,
        )  # fmt: skip
    for name, run in runs.runs.items() if runs else ():
        run = _of_axes(case.robot, run)
        tick = progress(f"replay {name}", len(run.time))
        stepped = replay(case.robot, run, progress=tick, source=runs.source if runs else "")
        exact = recorded_torque(case.robot, run.time, inverse_dynamics(case.robot, motion_of(run)))
        found.replays[name] = Replayed(run, stepped, exact)
    if out is not None:
        with Outputs(out, "simulate") as outputs:
            _write(found, outputs, movie)
    return found


def _forces(found: Simulation, test: HammerTest, hammer: Hammer) -> list[float]:
    """Peak forces (N), told where they move a light robot so far that its FRFs are not those of small motion.

    Where the file states no force, one that suits the robot is taken instead. Of geometry alone: a description with a
    law of amplitude is meant to answer so.
    """
    if any(CATALOGUE[entry.effect].amplitude_law for entry in found.robot.physics):
        return hammer.force_n
    largest = max(hammer.force_n)
    if (off := beyond_linear(found.mechanism, found.linear, test, largest)) <= LARGE:
        return hammer.force_n
    suited = suited_force(largest, off)
    text = f"{largest:g} N moves this robot so far that its FRFs differ by {off:.2%} from those of small motion"
    if "force_n" in hammer.model_fields_set:
        tell(found.case.name, "hammer.force_n", f"{text}. fit and diagnose compare with these; {suited:g} N suits it")
        return hammer.force_n
    tell(found.case.name, "hammer.force_n", f"{text}. The file states no force, so it is hit with {suited:g} N")
    return [suited]


def _of_axes(robot: Robot, run: MotionRun) -> MotionRun:
    """A run to be followed: a recording holds its motors, a trajectory is of the axes already."""
    if run.torque is None:
        return run
    back = np.linalg.inv(robot.coupling).T
    motion = {"position": run.position, "velocity": run.velocity, "acceleration": run.acceleration}
    turned: dict[str, Any] = {name: None if values is None else values @ back for name, values in motion.items()}
    return replace(run, **turned)


def _write(found: Simulation, name: Outputs, movie: bool) -> None:
    from twin.report import scene

    robot = found.robot
    save_robot(name("robot.yaml"), robot)
    save_mjcf(name("robot.xml"), lit(build_spec(found.mechanism)))
    if len(found.modes):
        scene.write_modes(name("modes.rrd"), found.mechanism, found.modes)
        if movie:
            from twin.report.movie import write_movie

            write_movie(name("modes.gif"), found.mechanism, found.modes)
    if found.campaign:
        write_campaign(name("hammer.h5"), replace(found.campaign, robot="robot.yaml"))
    for key, item in found.replays.items():
        r = item.replay
        torque = {"twin": r.torque, "inverse dynamics": item.inverse}
        if item.run.torque is not None:
            torque["measured"] = item.run.torque
        servo = assemble(robot, r.position[0], brakes="off", drives="servo")
        stem = found.stem(key)
        scene.write_replay(name(f"{stem}.rrd"), servo, r.time, r.position, r.deflections, torque)
    if found.replays:
        write_motion_log(name("replay.h5"), replace(found.log, robot="robot.yaml"))
    name.report(found)
    path = name("simulate.json")
    found.files = name.files
    write_json(path, found.data())


def _rms(values: np.ndarray) -> list[float]:
    return [float(value) for value in np.sqrt(np.mean(np.square(values), axis=0))]
