"""``twin lobes``: how deep a robot may cut in a posture, at every spindle speed, and how sure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from twin.commands.outputs import Outputs, check_out
from twin.commands.posture_file import posture_in_memory, read_posture_file
from twin.errors import InputError
from twin.measure.campaign import Campaign
from twin.measure.recordings import Recording, read_one
from twin.milling.cut import Cut, read_cut
from twin.milling.ensemble import ensemble
from twin.milling.forced import Vibration, forced_vibration
from twin.milling.in_time import CutStepper
from twin.milling.lobes import Lobes, band_speeds, lobes_of, starting_speeds, with_band
from twin.milling.tool_point import ToolModes, ToolPoint, measured_point, tool_point
from twin.milling.zeroth_order import limiting_depth
from twin.parallel import Progress, silent
from twin.physics import CATALOGUE
from twin.provenance import provenance, write_json
from twin.ranges import FASTEST_RPM, SLOWEST_RPM, check_count
from twin.result import Result, written
from twin.robot.description import Robot, load_robot
from twin.table import Table
from twin.yamlfile import read_yaml

Given = str | Path | Robot | Campaign | Mapping[str, Any] | Sequence[float] | np.ndarray

SHOWN = 8  # speeds in the table
FORCED = 60  # speeds at which forced vibration is given
HARDEST_BLOW_N_S = 100.0  # a sledge hammer of 10 kg at 10 m/s
IN_TIME_REACH = 3.0  # times the linear limit, up and down, that a limit in time is looked for


@dataclass
class Case:
    """What is cut with: the tip's dynamics and what is known of them.

    Attributes:
        robot: description, or ``None`` for a measurement without one.
        name, q_deg, brakes: of the posture.
        cut: what is cut how.
        point: the tip, base frame.
        draws: modes (nd, nm) in the cut frame and shear coefficients (nd, 3) N/m², or ``None`` where no posterior is.
        notes: what was assumed.
        inputs: what a result is traced back to.
    """

    robot: Robot | None
    name: str
    q_deg: list[float]
    brakes: str
    cut: Cut
    point: ToolPoint
    draws: tuple[ToolModes, np.ndarray] | None = None
    notes: list[str] = field(default_factory=list)
    inputs: list[Any] = field(default_factory=list)

    @property
    def modes(self) -> ToolModes:
        """In the cut frame."""
        return self.point.modes.turned(self.cut.frame(self.point.axis))


@dataclass
class StabilityLobes(Result):
    """What ``twin lobes`` found; prints itself, and is the JSON of the command.

    Attributes:
        case: tip, cut, posture.
        lobes: the limits over spindle speed.
        closed_form_m: (ns,) limits by the zeroth-order approximation.
        forced: spindle speeds (nf,) rpm, depths (nf,) m, vibrations.
        in_time: (spindle speed rpm, depth m) where the stepped robot begins to chatter, after a blow of ``blow_n_s``.
        files: what was written.
    """

    case: Case
    lobes: Lobes
    closed_form_m: np.ndarray
    forced: tuple[np.ndarray, np.ndarray, list[Vibration]]
    in_time: list[tuple[float, float]] = field(default_factory=list)
    blow_n_s: float = 0.0
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    drawn_by = "twin.report.milling_figures"

    def data(self) -> dict[str, Any]:
        """The JSON of the command."""
        found, (rpm, depth, shaken) = self.lobes, self.forced
        safe = found.safe_m
        return {
            "robot": self.case.robot.name if self.case.robot else None,
            "posture": self.case.name,
            "q_deg": self.case.q_deg,
            "tip_m": [float(v) for v in self.case.point.position],
            "spindle_rpm": [float(v) for v in found.spindle_rpm],
            "depth_limit_mm": _mm(found.depth_m),
            "depth_safe90_mm": [None] * len(found.spindle_rpm) if safe is None else _mm(safe),
            "kind": [str(kind) for kind in found.kind],
            "frequency_hz": [None if np.isnan(f) else float(f) for f in found.frequency_hz],
            "depth_closed_form_mm": _mm(np.minimum(self.closed_form_m, found.depth_max_m)),
            "depth_max_mm": 1e3 * found.depth_max_m,
            "limits": {
                "spindle_rpm": [float(v) for v in found.spindle_rpm[found.limits.row]],
                "depth_mm": _mm(found.limits.depth_m),
                "kind": [str(kind) for kind in found.limits.kind],
                "unstable_multipliers": [int(v) for v in found.limits.change],
            },
            "best": self._place(found.best()),
            "most_removed": self._place(found.productive()),
            "forced": {
                "spindle_rpm": [float(v) for v in rpm],
                "depth_mm": _mm(depth),
                "peak_to_peak_mm": [_mm(v.peak_to_peak_m) for v in shaken],
                "surface_error_mm": [_mm(np.array(v.surface_error_m)) for v in shaken],
            },
            "in_time": [
                {"spindle_rpm": rpm, "depth_mm": 1e3 * depth, "blow_n_s": self.blow_n_s} for rpm, depth in self.in_time
            ],
            "cut": self.case.cut.model_dump(mode="json"),
            "notes": self.case.notes,
            "files": self.files,
            "provenance": self.origin,
        }

    def _place(self, k: int) -> dict[str, Any]:
        safe, cut = self.lobes.safe_m, self.case.cut
        depth = float((self.lobes.depth_m if safe is None else safe)[k])
        rpm = float(self.lobes.spindle_rpm[k])
        removal = depth * cut.immersion * cut.tool.diameter_m * cut.feed_per_tooth_m * cut.tool.teeth * rpm
        return {
            "spindle_rpm": rpm, "depth_mm": 1e3 * depth, "probability": None if safe is None else 0.9,
            "removal_cm3_per_min": 1e6 * removal,
        }  # fmt: skip

    def tables(self) -> list[Table]:
        """Limits at speeds evenly spread over the range."""
        found = self.lobes
        at = np.linspace(found.spindle_rpm[0], found.spindle_rpm[-1], SHOWN)
        rows = []
        for k in np.unique([int(np.argmin(np.abs(found.spindle_rpm - rpm))) for rpm in at]):
            safe = "" if found.safe_m is None else f"{1e3 * found.safe_m[k]:.3g} mm"
            none = found.kind[k] == "none"
            rows.append((
                f"{found.spindle_rpm[k]:.0f} rpm", f"{'> ' if none else ''}{1e3 * found.depth_m[k]:.3g} mm", safe,
                "" if none else f"{found.frequency_hz[k]:.1f} Hz",
                str(found.kind[k]).replace("_", " ").replace("hopf", "Hopf"),
            ))  # fmt: skip
        head = ("speed", "limit", "safe 90 %", "vibrates at", "kind")
        shown = [k for k in range(len(head)) if k != 2 or found.safe_m is not None]
        cells = [[row[k] for k in shown] for row in rows]
        return [Table([head[k] for k in shown], cells, range(len(shown) - 1))]

    def summary(self) -> list[str]:
        """The least limit, the most productive cut, what was stepped in time, and how sure that is."""
        case, found = self.case, self.lobes
        lines = []
        lowest = int(np.argmin(found.depth_m))
        lines.append(f"least limit {1e3 * found.depth_m[lowest]:.3g} mm at {found.spindle_rpm[lowest]:.0f} rpm")
        place = self._place(found.productive())
        sure = "with 90 % probability " if found.safe_m is not None else ""
        lines.append(
            f"most is removed {sure}at {place['spindle_rpm']:.0f} rpm, {place['depth_mm']:.3g} mm: "
            f"{place['removal_cm3_per_min']:.3g} cm³/min"
        )
        rpm, depth, shaken = self.forced
        k = int(np.argmin(np.abs(rpm - place["spindle_rpm"])))
        high, low = (f"{1e6 * wall:.3g}" for wall in shaken[k].surface_error_m)
        deep = f"{1e3 * depth[k]:.3g} mm deep" + (", 90 % of the limit" if found.safe_m is None else "")
        lines.append(
            f"there the tip moves {1e6 * shaken[k].peak_to_peak_m.max():.3g} µm peak to peak ({deep}); "
            f"surface location error {low if low == high else f'{low} … {high}'} µm"
        )
        for rpm_, depth_ in self.in_time:
            linear = np.interp(rpm_, found.spindle_rpm, found.depth_m)
            hit = f", after a blow of {self.blow_n_s:g} N·s" if self.blow_n_s else ""
            lines.append(
                f"in time{hit}, at {rpm_:.0f} rpm: chatter from {1e3 * depth_:.3g} mm (linear {1e3 * linear:.3g} mm)"
            )
        if found.safe_m is None:
            lines.append(
                "the uncertainty is not known: there is no posterior of a fit beside the robot. twin fit and twin "
                "diagnose write one"
            )
        return [*lines, *case.notes]

    def __str__(self) -> str:
        case = self.case
        cut, tool = case.cut, case.cut.tool
        who = case.robot.name if case.robot else "measured FRF"
        lines = [
            f"{who} · {case.name} · {cut.milling} milling, immersion {cut.immersion:g}, {tool.teeth} teeth of "
            f"{1e3 * tool.diameter_m:g} mm, tip at ({', '.join(f'{v:z.3f}' for v in case.point.position)}) m"
        ]
        (table,) = self.tables()
        lines.append("  " + "".join(f"{name:>13}" for name in table.header[:-1]) + "   kind")
        lines += ["  " + "".join(f"{cell:>13}" for cell in row[:-1]) + f"   {row[-1]}" for row in table.rows]
        lines += [f"  {line}" for line in self.summary()]
        if self.files:
            lines.append(f"  {written(self.files)}")
        return "\n".join(lines)


def _mm(values: np.ndarray) -> list[float]:
    return [1e3 * float(v) for v in values]


def lobes(
    given: Given,
    *,
    robot: Robot | str | Path | None = None,
    without: list[str] | None = None,
    cut: Cut | Mapping[str, Any] | str | Path | None = None,
    q_deg: Sequence[float] | None = None,
    posture: str | None = None,
    brakes: Literal["on", "off"] | None = None,
    spindle_rpm: tuple[float, float] | None = None,
    draws: int = 100,
    in_time: int = 0,
    blow_n_s: float = 0.0,
    out: str | Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> StabilityLobes:
    """Stability lobes of one posture: from a model, a fit with its posterior, or straight from a measured FRF.

    Args:
        given: a posture file, a robot or a hammer test. A posture file may also be its content, or axis positions in
            degrees. A robot is a ``robot.yaml``, a URDF, or the output folder of a fit or diagnosis. A hammer test must
            have hit the tool where it was measured.
        robot: wins over the robot that a file names.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        cut: a :class:`Cut`, its content, or ``cut.yaml``; wins over the posture file's ``cut``.
        q_deg: posture of a robot, degrees (m); by default the middle of the axes' limits.
        posture: which posture of a hammer test, by default the first.
        brakes: ``"off"`` by default, as in a cut, where servos hold the axes. The brakes in a posture file are those of
            its hammer test.
        spindle_rpm: lowest and highest speed; wins over the cut's.
        draws: of the posterior, for the depth that is stable with 90 % probability; 0 for none.
        in_time: at how many speeds the cut is also stepped in MuJoCo, with the nonlinear joints.
        blow_n_s: momentum of a blow on the tip along the feed, before each of these cuts begins.
        out: folder for JSON and figures; ``None`` writes nothing.
        seed: of the draws.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    progress = progress or silent
    check_out(out)
    check_count("draws", draws)
    check_count("in_time", in_time)
    if draws < 0 or in_time < 0:
        raise InputError("--draws" if draws < 0 else "--in-time", "", "expected no negative number")
    if not 0 <= blow_n_s <= HARDEST_BLOW_N_S:
        raise InputError("--blow", "", f"expected 0 to {HARDEST_BLOW_N_S:g} N·s, found {blow_n_s:g}")
    if blow_n_s and not in_time:
        raise InputError("--blow", "", "is a blow on the cut in time; add --in-time N")
    case = _case(given, robot, without, _read_cut(cut), q_deg, posture, brakes, spindle_rpm, draws, seed)
    if in_time and (case.robot is None or case.point.linear is None):
        raise InputError("--in-time", "", "needs a robot; a measured FRF cannot be stepped")
    found = lobes_of(case.modes, case.cut, progress=progress("speeds", len(starting_speeds(case.modes, case.cut))))
    if case.draws is not None:
        tick = progress("draws of the posterior", len(band_speeds(found, draws)))
        found = with_band(found, case.draws[0], case.cut, case.draws[1], progress=tick)
    closed = np.array(
        [limiting_depth(case.modes, case.cut, spindle_rpm=float(rpm)) for rpm in _spread(found.spindle_rpm, 400)]
    )
    closed = np.interp(found.spindle_rpm, _spread(found.spindle_rpm, 400), np.minimum(closed, found.depth_max_m))
    result = StabilityLobes(case, found, closed, _forced(case, found))
    result.in_time, result.blow_n_s = _in_time(case, found, in_time, blow_n_s, progress), blow_n_s
    options = {
        "robot": robot, "without": without or [], "draws": draws, "in_time": in_time, "blow_n_s": blow_n_s, "seed": seed
    }  # fmt: skip
    result.origin = provenance(case.inputs, options)
    if out is not None:
        with Outputs(out, "lobes") as outputs:
            outputs.report(result)
            path = outputs("lobes.json")
            result.files = outputs.files
            write_json(path, result.data())
    return result


def _spread(speeds: np.ndarray, most: int) -> np.ndarray:
    """At most so many of the speeds, ends included."""
    return speeds[np.unique(np.round(np.linspace(0, len(speeds) - 1, min(most, len(speeds)))).astype(int))]


def _read_cut(cut: Cut | Mapping[str, Any] | str | Path | None) -> Cut | None:
    return cut if cut is None or isinstance(cut, Cut) else read_cut(cut)


def _case(
    given: Given,
    robot: Robot | str | Path | None,
    without: list[str] | None,
    cut: Cut | None,
    q_deg: Sequence[float] | None,
    posture: str | None,
    brakes: Literal["on", "off"] | None,
    spindle_rpm: tuple[float, float] | None,
    draws: int,
    seed: int,
) -> Case:
    if brakes not in (None, "on", "off"):
        raise InputError("brakes", "", f"expected 'on' or 'off', found {brakes!r}")
    notes: list[str] = []
    source, held = _opened(given), brakes or "off"
    if isinstance(source, Recording):
        return _measured(source, robot, without, _complete(cut, None, spindle_rpm, notes), posture, draws, seed, notes)
    of_file: Cut | None = None
    if isinstance(source, Robot):
        described = (load_robot(robot) if robot else source).without(without or [])
        if q_deg is None:
            middle = [np.mean(a.limits.position) if a.limits and a.limits.position else 0.0 for a in described.axes]
            q_deg = described.degrees(float(value) for value in middle)
            at = ", ".join(f"{value:g}" for value in q_deg)
            notes.append(f"posture: the middle of the axes' limits, {at}°; --q asks for another")
        q = described.check_posture(described.angles(_counted(q_deg, described)), "--q", "")
        name, inputs = "posture", [described.path or described]
    else:
        read = read_posture_file if isinstance(source, Path) else posture_in_memory
        file = read(source, robot, without)  # type: ignore[arg-type]
        described, of_file, q, name, inputs = file.robot, file.cut, file.q, file.name, file.inputs
        idle = any(not CATALOGUE[entry.effect].shown_by(["on"]) for entry in described.physics)
        if brakes is None and file.brakes == "on" and idle:
            notes.append("brakes: off, as in a cut; those of the posture file are of its hammer test")
        if q_deg is not None:
            q = described.check_posture(described.angles(_counted(q_deg, described)), "--q", "")
        q_deg = file.q_deg if q_deg is None else q_deg
    named = _complete(cut, of_file, spindle_rpm, notes)
    point = tool_point(described, q, held, named)
    case = Case(described, name, list(q_deg), held, named, point, None, notes, list(inputs))
    if Path(named.source).is_file() and named.source not in map(str, case.inputs):
        case.inputs.append(Path(named.source))
    known = ensemble(described, named, draws, seed) if draws else None
    if known is not None:
        tips = known.tips(q[None], named, held)
        modes = ToolModes(tips.modes.pole[:, 0], tips.modes.shape[:, 0])
        case.draws = modes.turned(named.frame(point.axis)), known.coefficients
    return case


def _counted(q_deg: Sequence[float], robot: Robot) -> Sequence[float]:
    if len(q_deg) != robot.axis_count:
        raise InputError("--q", "", f"expected {robot.axis_count} values for robot {robot.name}, found {len(q_deg)}")
    return q_deg


def _complete(cut: Cut | None, of_file: Cut | None, spindle_rpm: tuple[float, float] | None, notes: list[str]) -> Cut:
    """The cut that counts, with its speeds; a usual one, said so, where none is given."""
    found = cut or of_file
    if found is None:
        found = Cut()
        notes.append(
            "no cut was given; a usual one is taken: Al7075, overhang 200 mm, feed 0.1 mm per tooth; --cut takes yours"
        )
    if spindle_rpm is not None:
        low, high = spindle_rpm
        if not SLOWEST_RPM <= low < high <= FASTEST_RPM:
            expected = f"expected a lowest and a highest speed, {SLOWEST_RPM:g} to {FASTEST_RPM:g} rpm"
            raise InputError("--rpm", f"{low:g} {high:g}", expected)
        changed = found.model_copy(update={"spindle_rpm": (float(low), float(high))})
        changed._source, changed._folder = found._source, found._folder
        found = changed
    return found


def _opened(given: Given) -> Recording | Robot | Path | Mapping[str, Any] | Sequence[float] | np.ndarray:
    """What was given: a recording, a robot, a posture file, or the content of one."""
    if isinstance(given, Robot):
        return given
    if isinstance(given, Campaign):
        return read_one(given, "frf-campaign")
    if not isinstance(given, str | Path):
        return given
    path = Path(given)
    if path.is_dir():
        if not (path / "robot.yaml").is_file():
            raise InputError(path, "", "holds no robot.yaml; expected the output folder of a fit or a diagnosis")
        return load_robot(path / "robot.yaml")
    if path.suffix.lower() in (".yaml", ".yml") and path.is_file():
        content = read_yaml(path)
        if "posture" in content:
            return path
        if "postures" in content:
            raise InputError(path, "postures", "is a modal table; lobes need a model, or the FRFs of the tool's point")
        if "axes" not in content and ("tool" in content or "coefficients" in content):
            raise InputError(path, "", "is a cut: give it as --cut, beside a posture or a robot")
        return load_robot(path)
    if path.suffix.lower() in (".urdf", ".xml", "") or not path.is_file():
        return load_robot(given)
    return read_one(path, "frf-campaign")


def _measured(
    recording: Recording,
    robot: Robot | str | Path | None,
    without: list[str] | None,
    cut: Cut,
    posture: str | None,
    draws: int,
    seed: int,
    notes: list[str],
) -> Case:
    campaign: Campaign = recording.content
    name = posture or next(iter(campaign.postures))
    if name not in campaign.postures:
        raise InputError(
            recording.source, f"postures/{name}", f"no such posture; there are {', '.join(campaign.postures)}"
        )
    described = recording.described(robot, without)
    frf = campaign.postures[name]
    if len(frf.q_deg) != described.axis_count:
        notes.append("directions are taken as recorded: the posture does not fit the robot")
        point, said = measured_point(campaign, name, None, cut, recording.source)
    else:
        point, said = measured_point(campaign, name, described, cut, recording.source)
    case = Case(
        described, name, [float(v) for v in frf.q_deg], str(frf.brakes or "on"), cut, point, None, notes + said,
        list(recording.inputs),
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    modes = point.drawn(rng, draws) if draws else None
    if modes is not None:
        case.draws = modes.turned(cut.frame(point.axis)), cut.coefficients.draw(rng, draws)
    return case


def _forced(case: Case, found: Lobes) -> tuple[np.ndarray, np.ndarray, list[Vibration]]:
    """Forced vibration at the safe depth (90 % of the limit where how sure is not known), over the speeds."""
    depth = 0.9 * found.depth_m if found.safe_m is None else found.safe_m
    places = _spread(np.arange(len(depth)), FORCED)
    places = np.unique(np.append(places, found.productive()))
    shaken = [forced_vibration(case.modes, case.cut, float(found.spindle_rpm[k]), float(depth[k])) for k in places]
    return found.spindle_rpm[places], depth[places], shaken


def _in_time(case: Case, found: Lobes, count: int, blow: float, progress: Progress) -> list[tuple[float, float]]:
    """Limits in time, after a blow, N·s, at speeds spread evenly over the range."""
    if not count:
        return []
    assert case.robot is not None
    if case.cut.tool.modes or case.cut.tool.frf:
        case.notes.append("in time the tool's own modes are left out")
    low, high = case.cut.spindle_rpm
    speeds = low + (high - low) * (np.arange(count) + 0.5) / count
    q, tick, out = case.robot.angles(case.q_deg), progress("in time", count), []
    for rpm in speeds:
        linear = float(np.interp(rpm, found.spindle_rpm, found.depth_m))
        stepper = CutStepper(case.robot, q, case.brakes, case.cut, float(rpm))
        out.append((float(rpm), stepper.limit(linear / IN_TIME_REACH, linear * IN_TIME_REACH, kick_n_s=blow)))
        tick(1)
    return out
