"""``twin map``: modes, compliance and depth of cut over postures, tool positions or along a tool path."""

import hashlib
import pickle
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.commands.outputs import Outputs, check_out
from twin.errors import InputError, tell
from twin.identify.posterior import FILE
from twin.measure.campaign import FloatArray
from twin.measure.hdf5 import created
from twin.milling import map as work
from twin.milling.cut import Cut, read_cut
from twin.milling.ensemble import ensemble
from twin.milling.postures import tool_place
from twin.milling.toolpath import Toolpath, read_toolpath
from twin.model.parameters import can_vibrate
from twin.parallel import Progress, cores
from twin.provenance import provenance, write_json
from twin.ranges import FARTHEST_M, FASTEST_RPM, FREE_TURNS, LONGEST_SPACING_M, SLOWEST_RPM, check_count, implausible
from twin.result import Result, written
from twin.robot.description import Robot, load_robot
from twin.robot.frames import rotation_z
from twin.robot.inverse_kinematics import inverse_kinematics
from twin.table import Table

SPACING_M = 0.01  # of points along a path: a feed of a minute has 10 to 100
UNITS = {"_m": "m", "_hz": "Hz", "_percent": "%", "_m_per_n": "m/N", "_rad": "rad"}


@dataclass
class Map(Result):
    """What ``twin map`` found; prints itself, and is the JSON of the command.

    Attributes:
        robot: the robot.
        cut: tool, material and cut.
        places: where, those in reach.
        left_out: how many places were asked for that the robot does not reach.
        result: arrays whose first axis is the places, see :func:`twin.milling.map.compute_block`.
        speeds: (ns,) rpm of full lobes, or ``None``.
        path: the tool path, or ``None``.
    """

    drawn_by = "twin.report.map_figures"

    robot: Robot
    cut: Cut
    places: work.Places
    left_out: int
    result: work.Result
    spindle_rpm: float | None
    speeds: np.ndarray | None
    path: Toolpath | None = None
    draws: int = 0
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    @property
    def depth(self) -> np.ndarray:
        """Limiting depth (N,) m: of full lobes the least over the speeds, else the closed form."""
        lobes = self.result.get("depth_m")
        return self.result["depth_closed_form_m"] if lobes is None else lobes.min(axis=1)

    @property
    def safe(self) -> np.ndarray | None:
        """The depth (N,) m that is stable with 90 % probability, where that is known."""
        lobes = self.result.get("depth_safe90_m")
        return self.result.get("depth_closed_form_safe90_m") if lobes is None else lobes.min(axis=1)

    def data(self) -> dict[str, Any]:
        """The JSON of the command."""
        best, worst = int(np.argmax(self.ranked)), int(np.argmin(self.ranked))
        return {
            "robot": self.robot.name,
            "postures": len(self.places),
            "out_of_reach": self.left_out,
            "depth_limit_mm": {"quantiles": [5, 50, 95], "values": _quantiles(self.depth)},
            "depth_safe90_mm": {"quantiles": [5, 50, 95], "values": _quantiles(self.safe)},
            "spindle_rpm": self.spindle_rpm if self.speeds is None else [float(v) for v in self.speeds],
            "method": "closed form" if self.speeds is None else "full lobes",
            "draws": self.draws,
            "best": self._place(best),
            "worst": self._place(worst),
            "files": self.files,
            "provenance": self.origin,
        }

    def tables(self) -> list[Table]:
        """What a notebook shows."""
        depths = (("limit, mm", self.depth), ("safe with 90 % probability, mm", self.safe))
        rows = [[name, *(f"{v:.3g}" for v in _quantiles(d) or ())] for name, d in depths if d is not None]
        return [Table(["depth over the postures", "5 %", "median", "95 %"], rows, numbers=(1, 2, 3))]

    @property
    def ranked(self) -> np.ndarray:
        """What places are compared by: the safe depth where it is known."""
        return self.depth if self.safe is None else self.safe

    def _place(self, k: int) -> dict[str, Any]:
        safe = self.safe
        line = int(self.places.line[k])
        return {
            "q_deg": self.robot.degrees(self.places.q[k]), "tip_m": [float(v) for v in self.result["tip_m"][k]],
            "depth_limit_mm": 1e3 * float(self.depth[k]),
            "depth_safe90_mm": None if safe is None else 1e3 * float(safe[k]),
            "frequency_hz": [float(v) for v in self.result["frequency_hz"][k] if np.isfinite(v)],
            "line": line if line >= 0 else None,
        }  # fmt: skip

    def __str__(self) -> str:
        said = "at every speed" if self.spindle_rpm is None else f"at {self.spindle_rpm:g} rpm"
        if self.speeds is not None:
            said = f"at {len(self.speeds)} speeds from {self.speeds[0]:g} to {self.speeds[-1]:g} rpm"
        away = f", {self.left_out} out of reach" if self.left_out else ""
        lines = [f"{self.robot.name} · {len(self.places)} postures{away}", f"  depth that is stable {said}, mm"]
        lines.append(f"  {'':28} {'5 %':>9} {'median':>9} {'95 %':>9}  of the postures")
        for name, depth in (("limit", self.depth), ("safe with 90 % probability", self.safe)):
            if depth is not None:
                lines.append(f"  {name:28}" + "".join(f" {value:9.3g}" for value in _quantiles(depth) or ()))
        frequency = self.result["frequency_hz"][:, 0]
        stiff = 1e-6 / np.linalg.norm(self.result["static_compliance_m_per_n"], ord=2, axis=(1, 2))
        lines.append(
            f"  {'first mode, Hz':28}" + "".join(f" {v:9.3g}" for v in np.nanquantile(frequency, (0.05, 0.5, 0.95)))
        )
        lines.append(
            f"  {'least stiffness, N/µm':28}" + "".join(f" {v:9.3g}" for v in np.quantile(stiff, (0.05, 0.5, 0.95)))
        )
        what = "the limit" if self.safe is None else "safe with 90 % probability"
        for word, k in (("best", int(np.argmax(self.ranked))), ("worst", int(np.argmin(self.ranked)))):
            place = self._place(k)
            tip = ", ".join(f"{v:.3f}" for v in place["tip_m"])
            angles = ", ".join(f"{v:.1f}" for v in place["q_deg"])
            where = f" line {place['line']}," if place["line"] else ""
            lines.append(
                f"  {word}:{where} tip ({tip}) m, q ({angles})°, {1e3 * float(self.ranked[k]):.3g} mm ({what})"
            )
        if self.safe is None:
            lines.append(
                "  the uncertainty is not known: there is no posterior of a fit beside the robot. twin fit and twin "
                "diagnose write one"
            )
        if self.files:
            lines.append(f"  {written(self.files)}")
        return "\n".join(lines)


def _quantiles(depth: np.ndarray | None) -> list[float] | None:
    return None if depth is None else [1e3 * float(v) for v in np.quantile(depth, (0.05, 0.5, 0.95))]


def make_map(
    cut: str | Path | None = None,
    *,
    robot: str | None = None,
    without: list[str] | None = None,
    random: int | None = None,
    grid: tuple[int, int, int] | None = None,
    posture_grid: Sequence[int] | None = None,
    path: str | Path | None = None,
    box: Sequence[float] | None = None,
    place: tuple[float, float, float] | None = None,
    place_turn_deg: float = 0.0,
    near_deg: Sequence[float] | None = None,
    spacing: float = SPACING_M,
    spindle_rpm: float | None = None,
    lobes: int = 0,
    draws: int = 50,
    processes: int | None = None,
    scheduler: str | None = None,
    out: Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Map:
    """Map a robot.

    Args:
        cut: ``cut.yaml``; the default cut without.
        robot: shipped name, ``robot.yaml`` or URDF; with ``posterior.h5`` beside it, depths get their probability.
        without: entries to remove.
        random: so many postures at random (1000, where nothing is asked for).
        grid: tip positions along x, y and z of the box.
        posture_grid: positions of every axis.
        path: tool path, CSV, G-code or APT.
        box: x, y, z from and to, m, base frame; the robot's workspace by default.
        place: where the path's origin is in the base frame, m; ``place_turn_deg`` about z.
        near_deg: posture that found ones should be near, degrees (m).
        spacing: of points along the path, m.
        spindle_rpm: speed of the closed form; ``None``: the smallest limit of all speeds, or the cut's lobes.
        lobes: so many speeds of full lobes; 0 for the closed form alone.
        draws: robots drawn from the posterior.
        processes: of this machine; by default as many as it has cores.
        scheduler: address of a Dask scheduler.
        out: folder for map.h5, figures and map.rrd; an interrupted map goes on there.
        seed: of postures and draws.
        progress: makes progress bars.

    Raises:
        InputError: bad input, or a point of the path that is out of reach.
    """
    check_out(out)
    for name, value in (("draws", draws), ("lobes", lobes), ("random", random or 1)):
        check_count(name, value)
    progress = progress or (lambda description, total: lambda count: None)
    loaded = load_robot(robot or "kr90").without(without or [])
    if not can_vibrate(loaded):
        text = "no axis has a stiffness, so nothing limits the depth of cut; `twin describe` fills it in"
        raise InputError(loaded.name, "axes", text)
    if isinstance(cut, str | Path) and not Path(cut).is_file():
        raise InputError(cut, "", "no such file; expected a cut.yaml (a robot is given as --robot)")
    asked = read_cut(cut) if cut else Cut()
    _check_finite(place_turn_deg, place, box, near_deg)
    _check_asked(loaded, random, grid, posture_grid, path, lobes, draws, spindle_rpm, spacing)
    for name, given in (("--spacing", spacing != SPACING_M), ("--place-turn-deg", place_turn_deg != 0)):
        if given and path is None:
            tell(name, "", "concerns a path (--path), and none is given: not used")
    near = None
    if near_deg is not None:
        near = loaded.check_posture(_angles(loaded, near_deg), "--near", "")
    tool_path = None
    if path is not None:
        tool_path = _placed(path, place, place_turn_deg, spacing)
        places, left_out = _along(loaded, asked, tool_path, near, seed, spindle_rpm, path), 0
    elif grid is not None:
        tips = work.tip_grid(loaded, grid, _box(loaded, box))
        places, left_out = _at_tips(loaded, asked, tips, near, seed, spindle_rpm)
    elif posture_grid is not None:
        places, left_out = work.posture_grid(loaded, asked, tuple(posture_grid)), 0
        if not len(places):
            raise InputError("--posture-grid", "", "no posture holds the tip above the table and in the workspace")
    else:
        places, left_out = work.random_postures(loaded, asked, random or 1000, seed), 0
    drawn = ensemble(loaded, asked, draws, seed) if draws else None
    speeds = np.geomspace(*asked.spindle_rpm, lobes) if lobes else None
    task = work.Task(loaded, asked, places, drawn, spindle_rpm, speeds)
    keep_in = _kept_in(out, task)
    result = work.compute(
        task, processes=processes or cores(), scheduler=scheduler, keep=keep_in, tick=progress("map", task.blocks)
    )
    found = Map(loaded, asked, places, left_out, result, spindle_rpm, speeds, tool_path, len(drawn) if drawn else 0)
    inputs = [file for file in (cut, path, robot) if file is not None and Path(file).is_file()]
    if drawn is not None and loaded.path is not None:
        inputs.append(loaded.path.with_name(FILE))
    options = {
        "robot": robot, "without": without or [], "random": random, "grid": grid, "posture_grid": posture_grid,
        "box": None if box is None else list(box), "place": place, "place_turn_deg": place_turn_deg,
        "near_deg": None if near_deg is None else list(near_deg), "spacing": spacing, "spindle_rpm": spindle_rpm,
        "lobes": lobes, "draws": draws, "seed": seed,
    }  # fmt: skip
    found.origin = provenance(inputs, options)
    if out is not None:
        with Outputs(out, "map") as outputs:
            found.files = outputs.files
            _write(found, outputs)
        if keep_in is not None:
            shutil.rmtree(keep_in, ignore_errors=True)
    return found


def _far(number: float, unit: str) -> str | None:
    """What was expected where a place is farther off, or turned further, than work lies."""
    most = 360.0 * FREE_TURNS if unit == "°" else FARTHEST_M
    return implausible(number, unit) if abs(number) <= most else f"expected up to {most:g} {unit}, found {number:g}"


def _check_finite(
    place_turn_deg: float,
    place: tuple[float, float, float] | None,
    box: Sequence[float] | None,
    near_deg: Sequence[float] | None,
) -> None:
    given = {
        "--place-turn-deg": ((place_turn_deg,), "°"),
        "--place": (place or (), "m"),
        "--box": (box or (), "m"),
        "--near": (near_deg or (), "°"),
    }
    for option, (numbers, unit) in given.items():
        for number in numbers:
            problem = _far(number, unit) if np.isfinite(number) else "expected finite numbers"
            if problem:
                raise InputError(option, f"{number:g}", problem)


def _at_tips(
    robot: Robot, cut: Cut, position: FloatArray, near: FloatArray | None, seed: int, spindle_rpm: float | None
) -> tuple[work.Places, int]:
    """Postures that hold the tip at positions (n, 3), m, and how many are out of reach."""
    places = work.reach(robot, cut, position, start=near, seed=seed, spindle_rpm=spindle_rpm)
    keep = places.reached & work.allowed(robot, cut, places.q)
    if not keep.any():
        raise InputError("--grid", "", _unreachable(robot, cut, position[0], seed))
    return places.rows(keep), int(len(places) - keep.sum())


def _check_asked(
    robot: Robot, random: int | None, grid: Any, posture_grid: Sequence[int] | None, path: Any, lobes: int, draws: int,
    spindle_rpm: float | None, spacing: float,
) -> None:  # fmt: skip
    """Raise ``InputError`` unless one thing is asked for and its numbers can be."""
    given = {"--random": random, "--grid": grid, "--posture-grid": posture_grid, "--path": path}
    asked = [name for name, value in given.items() if value is not None]
    if len(asked) > 1:
        raise InputError(asked[1], "", f"expected one of {', '.join(given)}; {asked[0]} is given too")
    if random is not None and random < 1:
        raise InputError("--random", str(random), "expected a number above 0")
    if grid is not None and min(grid) < 1:
        raise InputError("--grid", " ".join(map(str, grid)), "expected three numbers above 0")
    if posture_grid is not None and (len(posture_grid) != robot.axis_count or min(posture_grid) < 1):
        text = ",".join(map(str, posture_grid))
        raise InputError("--posture-grid", text, f"expected {robot.axis_count} numbers above 0, one for each axis")
    if lobes < 0 or draws < 0:
        raise InputError("--lobes" if lobes < 0 else "--draws", str(min(lobes, draws)), "expected 0 or more")
    if spindle_rpm is not None and not SLOWEST_RPM <= spindle_rpm <= FASTEST_RPM:
        expected = f"expected a speed from {SLOWEST_RPM:g} to {FASTEST_RPM:g}"
        raise InputError("--spindle-rpm", f"{spindle_rpm:g}", expected)
    if spindle_rpm is not None and lobes:
        raise InputError(
            "--spindle-rpm", "", "full lobes take the speeds of the cut's spindle_rpm; give one or the other"
        )
    if not 0 < spacing <= LONGEST_SPACING_M:
        raise InputError("--spacing", f"{spacing:g}", f"expected metres above 0, up to {LONGEST_SPACING_M:g}")


def _angles(robot: Robot, near_deg: Sequence[float]) -> np.ndarray:
    if len(near_deg) != robot.axis_count:
        raise InputError(
            "--near", "", f"expected {robot.axis_count} values for robot {robot.name}, found {len(near_deg)}"
        )
    return np.asarray(robot.angles(near_deg))


def _box(robot: Robot, box: Sequence[float] | None) -> np.ndarray:
    if box is not None:
        found = np.array(box, float).reshape(3, 2)
    elif robot.workspace is not None:
        found = np.array([robot.workspace.x, robot.workspace.y, robot.workspace.z], float)
    else:
        raise InputError("--box", "", f"{robot.name} states no workspace: give x, y and z from and to, m")
    if not (np.isfinite(found).all() and (found[:, 0] <= found[:, 1]).all()):
        raise InputError("--box", " ".join(f"{v:g}" for v in found.ravel()), "expected x, y and z, each from and to")
    return found


def _placed(path: str | Path, place: tuple[float, float, float] | None, turn_deg: float, spacing: float) -> Toolpath:
    position = np.array(place or (0.0, 0.0, 0.0), float)
    whole = read_toolpath(path).placed(position, rotation_z(float(np.deg2rad(turn_deg))))
    if whole.along[-1] / spacing > 1e6:
        raise InputError("--spacing", f"{spacing:g}", f"makes more than a million points of {whole.along[-1]:.3g} m")
    return whole.every(spacing)


def _along(
    robot: Robot, cut: Cut, path: Toolpath, near: np.ndarray | None, seed: int, spindle_rpm: float | None,
    source: str | Path,
) -> work.Places:  # fmt: skip
    """Postures along a path; all its points must be in reach and above the table."""
    if path.axis is not None and robot.axis_count < 5:
        raise InputError(
            source, "", f"states the tool's direction, which a robot of {robot.axis_count} axes cannot hold"
        )
    under = np.zeros(len(path.position), bool) if cut.table_z_m is None else path.position[:, 2] < cut.table_z_m
    if under.any():
        k = int(np.argmax(under))
        raise InputError(
            source, f"line {path.line[k]}",
            f"the tip is {float(cut.table_z_m or 0) - path.position[k, 2]:.3g} m below the table at z = "
            f"{cut.table_z_m:g} m; lift the work with --place",
        )  # fmt: skip
    feed = path.feed
    found = work.reach(
        robot,
        cut,
        path.position,
        axis=path.axis,
        feed=feed,
        start=near,
        follow=True,
        seed=seed,
        spindle_rpm=spindle_rpm,
    )
    if not found.reached.all():
        k = int(np.argmin(found.reached))
        raise InputError(source, f"line {path.line[k]}", _unreachable(robot, cut, path.position[k], seed))
    lying = np.linalg.norm(_across(robot, cut, found), axis=1) < 1e-6
    if lying.any():  # a plunge cuts in no direction across the axis: the cut's own feed serves
        feed = np.where(lying[:, None], np.array(cut.feed_direction), feed)
    return replace(found, feed=feed, along=path.along, line=path.line)


def _across(robot: Robot, cut: Cut, places: work.Places) -> np.ndarray:
    """Feed (N, 3) across the tool's axis."""
    from twin.robot.inverse_kinematics import tool_frames

    place = tool_place(robot, cut)
    axis = tool_frames(robot, places.q, place)[1] @ place.axis
    return places.feed - (places.feed * axis).sum(axis=1, keepdims=True) * axis


def _unreachable(robot: Robot, cut: Cut, position: np.ndarray, seed: int) -> str:
    found = inverse_kinematics(robot, position, tool_place(robot, cut), seed=seed)
    at = ", ".join(f"{v:.3f}" for v in position)
    away = float(found.distance[0])
    if found.reached[0]:
        return f"the tip can be at ({at}) m, but not with the tool's axis in that direction; turn or move the work"
    return f"({at}) m is out of reach by {away:.3g} m; move the work with --place or --box, or take a longer tool"


def _kept_in(out: Path | None, task: work.Task) -> Path | None:
    """Where the blocks of this task are kept until the map is whole."""
    if out is None:
        return None
    digest = hashlib.sha256(pickle.dumps(_plain(task), protocol=4)).hexdigest()[:12]
    return out.absolute().parent / f".{out.name}.map-{digest}"


def _plain(task: work.Task) -> Any:
    """What decides a task's result, in a form that is the same in every process."""
    import twin

    drawn = task.ensemble
    arrays = [getattr(task.places, name).tobytes() for name in ("q", "feed")]
    arrays += [a.tobytes() for a in (drawn.angle, drawn.coefficients, drawn.damping)] if drawn else []
    robots = [r.model_dump_json() for r in (task.robot, *(drawn.robots if drawn else []))]
    speeds = None if task.speeds is None else task.speeds.tobytes()
    scatter = drawn.scatter if drawn else None
    return twin.__version__, arrays, robots, task.cut.model_dump_json(), task.spindle_rpm, speeds, scatter, task.brakes


def _write(found: Map, name: Outputs) -> None:
    write_map(name("map.h5"), found)
    name.report(found)
    name.scene(found, "map.rrd")
    page = name("map.json")
    write_json(page, found.data())


def write_map(path: str | Path, found: Map) -> None:
    """The map as HDF5: every array with its unit, postures on the first axis."""
    with created(path) as file:
        file.attrs.update(format="twin-map", version=1, robot=found.robot.name, twin=str(found.origin["version"]))
        file.attrs["method"] = "closed form" if found.speeds is None else "full lobes"
        if found.spindle_rpm is not None:
            file.attrs["spindle_rpm"] = found.spindle_rpm
        if found.speeds is not None:
            file["spindle_rpm"] = found.speeds
        arrays = {"q_rad": found.places.q, "feed": found.places.feed, "line": found.places.line, **found.result}
        for key, values in (("turn_rad", found.places.turn), ("along_m", found.places.along)):
            if np.isfinite(values).any():
                arrays[key] = values
        for key, values in arrays.items():
            file[key] = values
            stem = key.removesuffix("_interval90")
            unit = next(
                (u for suffix, u in sorted(UNITS.items(), key=lambda i: -len(i[0])) if stem.endswith(suffix)), "1"
            )
            file[key].attrs["unit"] = unit
