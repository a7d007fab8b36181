"""A map of where a robot mills well: modes, compliance and depth of cut over many postures, in blocks.

A block is a pure function of the :class:`Task` and the numbers of its rows. Whoever computes it, in whatever order, a
process of this machine or of a cluster, gives the same bits; blocks that were kept are not computed again.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.files import replacing
from twin.milling import zeroth_order
from twin.milling.cut import Cut
from twin.milling.ensemble import Ensemble, quantile_of_safe
from twin.milling.lobes import first_at
from twin.milling.postures import Tips, tips, tool_place, without_fast
from twin.milling.tool_point import ToolModes
from twin.parallel import spread
from twin.robot.description import Robot
from twin.robot.inverse_kinematics import Reached, inverse_kinematics, limits, tool_frames

BLOCK = 250  # postures
SHOWN = 8  # modes
DIGITS = 2.0  # of the lobes' collocation: limits to 1e-5
TURNS = 24  # about the tool's axis, where it is free: every 15°
BAND = (0.05, 0.95)  # quantiles


@dataclass(frozen=True)
class Places:
    """What is asked of N postures.

    Attributes:
        q: (N, n) rad (m).
        feed: (N, 3) directions of the feed, base frame.
        target: (N, 3) where the tip was to be, m, base frame; where it is, if postures were asked for.
        reached: (N,) whether the robot can.
        turn: (N,) rad about the tool's axis, NaN where that is not free.
        along: (N,) m along a path, or NaN.
        line: (N,) of the path's file, or −1.
    """

    q: np.ndarray
    feed: np.ndarray
    target: np.ndarray
    reached: np.ndarray
    turn: np.ndarray
    along: np.ndarray
    line: np.ndarray

    def __len__(self) -> int:
        return len(self.q)

    def rows(self, some: Any) -> "Places":
        """Some of them."""
        return Places(*(getattr(self, field.name)[some] for field in fields(self)))


@dataclass(frozen=True)
class Task:
    """Everything that a block needs to know.

    Attributes:
        robot: the robot.
        cut: tool, material and cut.
        brakes: on or off.
        places: where.
        ensemble: robots that the recordings allow, or ``None``.
        spindle_rpm: speed of the closed form, ``None`` for the smallest limit of all speeds.
        speeds: (ns,) rpm of full lobes; empty for the closed form.
    """

    robot: Robot
    cut: Cut
    places: Places
    ensemble: Ensemble | None = None
    spindle_rpm: float | None = None
    speeds: np.ndarray | None = None
    brakes: str = "off"

    @property
    def blocks(self) -> int:
        """How many."""
        return -(-len(self.places) // BLOCK)


Result = dict[str, np.ndarray]


# --- where ------------------------------------------------------------------------------------------------------------


def postures_at(q: np.ndarray, robot: Robot, cut: Cut) -> Places:
    """Postures (N, n) as they are."""
    tip, *_ = tool_frames(robot, q, tool_place(robot, cut))
    count = len(q)
    feed = np.tile(np.array(cut.feed_direction), (count, 1))
    nothing = np.full(count, np.nan)
    return Places(q, feed, tip, np.ones(count, bool), nothing, nothing, np.full(count, -1))


def random_postures(robot: Robot, cut: Cut, count: int, seed: int = 0) -> Places:
    """Uniform within the axes' limits, the tip above the table and in the workspace that the robot states.

    Raises:
        InputError: hardly any posture is allowed.
    """
    rng = np.random.default_rng(seed)
    low, high = limits(robot)
    kept: list[np.ndarray] = []
    for _ in range(100):
        q = rng.uniform(low, high, (max(count, 100), robot.axis_count))
        kept.append(q[allowed(robot, cut, q)])
        if sum(map(len, kept)) >= count:
            return postures_at(np.concatenate(kept)[:count], robot, cut)
    raise InputError(robot.name, "workspace", "hardly any posture holds the tip above the table and in the workspace")


def posture_grid(robot: Robot, cut: Cut, counts: tuple[int, ...]) -> Places:
    """All combinations of evenly spaced joint positions, those that are allowed."""
    low, high = limits(robot)
    axes = [
        np.linspace(a, b, n) if n > 1 else np.array([0.5 * (a + b)]) for a, b, n in zip(low, high, counts, strict=True)
    ]
    q = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, robot.axis_count)
    return postures_at(q[allowed(robot, cut, q)], robot, cut)


def allowed(robot: Robot, cut: Cut, q: np.ndarray) -> np.ndarray:
    """(N,) whether the tip is above the table, and flange and tip in the workspace, in postures (N, n)."""
    tip, *_ = tool_frames(robot, q, tool_place(robot, cut))
    inside = np.ones(len(q), bool)
    if cut.table_z_m is not None:
        inside &= tip[:, 2] >= cut.table_z_m
    if robot.workspace is not None:
        flange = replace(tool_place(robot, cut), position=np.array(robot.flange.position))
        place, *_ = tool_frames(robot, q, flange)
        for k, name in enumerate("xyz"):
            low, high = getattr(robot.workspace, name)
            inside &= (place[:, k] >= low) & (place[:, k] <= high)
    return inside


def tip_grid(robot: Robot, counts: tuple[int, int, int], box: np.ndarray) -> np.ndarray:
    """Positions (N, 3) of the tip, m, evenly spaced in a box (3, 2)."""
    axes = [np.linspace(a, b, n) if n > 1 else np.array([0.5 * (a + b)]) for (a, b), n in zip(box, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def reach(
    robot: Robot,
    cut: Cut,
    position: np.ndarray,
    *,
    axis: np.ndarray | None = None,
    feed: np.ndarray | None = None,
    start: np.ndarray | None = None,
    follow: bool = False,
    seed: int = 0,
    spindle_rpm: float | None = None,
) -> Places:
    """Postures that bring the tip to positions (N, 3) m; a free turn about the tool's axis is swept for the best depth.

    Args:
        axis: (N, 3) from tip to spindle, where the robot can hold one (five axes or more); up by default.
        feed: (N, 3), by default the cut's.
        start: posture (n,) that they should be near.
        follow: each near the one before, as along a path.
    """
    count, tool = len(position), tool_place(robot, cut)
    feed = np.tile(np.array(cut.feed_direction), (count, 1)) if feed is None else feed
    nothing = np.full(count, np.nan)
    if robot.axis_count < 5:
        found = _led(robot, position, tool, None, None, start, follow, seed)
        return Places(found.q, feed, position, found.reached, nothing, nothing, np.full(count, -1))
    up = np.tile([0.0, 0.0, 1.0], (count, 1)) if axis is None else axis
    if robot.axis_count == 5:
        found = _led(robot, position, tool, -up, None, start, follow, seed)
        return Places(found.q, feed, position, found.reached, nothing, nothing, np.full(count, -1))
    best: Places | None = None
    depth = np.full(count, -np.inf)
    for turn in np.linspace(-np.pi, np.pi, TURNS, endpoint=False):
        found = _led(robot, position, tool, -up, np.full(count, turn), start, follow, seed)
        own = np.full(count, -np.inf)
        rows = np.flatnonzero(found.reached)
        if rows.size:
            seen = tips(robot, found.q[rows], cut, "off")
            modes = seen.modes.turned(cut.frame(seen.axis, feed[rows]))
            own[rows] = zeroth_order.limiting_depth(modes, cut, spindle_rpm=spindle_rpm)
        tried = Places(found.q, feed, position, found.reached, np.full(count, turn), nothing, np.full(count, -1))
        if best is None:
            best, depth = tried, own
            continue
        better = own > depth
        best = Places(*(
            np.where(better[:, None] if a.ndim > 1 else better, b, a)
            for a, b in ((getattr(best, f.name), getattr(tried, f.name)) for f in fields(Places))
        ))  # fmt: skip
        depth = np.maximum(depth, own)
    assert best is not None
    return best


def _led(
    robot: Robot, position: np.ndarray, tool: Any, axis: np.ndarray | None, turn: np.ndarray | None,
    start: np.ndarray | None, follow: bool, seed: int,
) -> Reached:  # fmt: skip
    if not follow:
        return inverse_kinematics(robot, position, tool, axis=axis, turn=turn, start=start, seed=seed)
    parts = []
    for k in range(len(position)):
        one = inverse_kinematics(
            robot, position[k], tool, axis=None if axis is None else axis[k],
            turn=None if turn is None else turn[k : k + 1], start=start, seed=seed,
        )  # fmt: skip
        start = one.q[0] if one.reached[0] else start
        parts.append(one)
    return Reached(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Reached)))


# --- what -------------------------------------------------------------------------------------------------------------


def compute_block(task: Task, number: int) -> Result:
    """Results of the rows of one block: name → array whose first axis is the postures."""
    some = task.places.rows(slice(number * BLOCK, (number + 1) * BLOCK))
    seen = tips(task.robot, some.q, task.cut, task.brakes)
    rotation = task.cut.frame(seen.axis, some.feed)
    modes = seen.modes.turned(rotation)
    peak, _ = dynamic_compliance(seen.modes)
    found: Result = {
        "tip_m": seen.position, "axis": -seen.axis, "static_compliance_m_per_n": seen.compliance,
        "dynamic_compliance_m_per_n": peak, **_modes_shown(seen.modes),
    }  # fmt: skip
    found["depth_closed_form_m"] = _closed(modes, task, None)
    if task.speeds is not None:
        found["depth_m"] = lobes(modes, task.cut, task.speeds)
    if task.ensemble is not None:
        found |= _band(task, some, rotation)
    return found


def _closed(modes: ToolModes, task: Task, shear: np.ndarray | None) -> np.ndarray:
    depth = zeroth_order.limiting_depth(modes, task.cut, spindle_rpm=task.spindle_rpm, shear=shear)
    return np.minimum(depth, task.cut.depth_max_m)


def _modes_shown(modes: ToolModes) -> Result:
    """Frequencies and damping ratios (N, SHOWN) of the lowest modes, NaN where there are fewer."""
    swings = (modes.pole.imag > 0) & (np.abs(modes.shape).max(axis=-1) > 0)
    order = np.argsort(np.where(swings, np.abs(modes.pole), np.inf), axis=1, kind="stable")[:, :SHOWN]
    shown = np.take_along_axis(swings, order, axis=1)
    out = {}
    for name, values in (("frequency_hz", modes.frequency_hz), ("damping_percent", modes.damping_percent)):
        picked = np.where(shown, np.take_along_axis(values, order, axis=1), np.nan)
        out[name] = np.pad(picked, ((0, 0), (0, SHOWN - picked.shape[1])), constant_values=np.nan)
    return out


def dynamic_compliance(modes: ToolModes) -> tuple[np.ndarray, np.ndarray]:
    """Largest compliance (N,) m/N in any direction and at any resonance, and the frequency (N,) Hz it is at."""
    at = np.abs(modes.pole)
    size = np.linalg.norm(modes.receptance(at), ord=2, axis=(-2, -1))
    best = size.argmax(axis=-1)
    return np.take_along_axis(size, best[..., None], -1)[..., 0], np.take_along_axis(at, best[..., None], -1)[
        ..., 0
    ] / (2 * np.pi)


def lobes(modes: ToolModes, cut: Cut, speeds: np.ndarray, shear: np.ndarray | None = None) -> np.ndarray:
    """Limits in depth (N, ns), m, of postures (N, nm) at spindle speeds (ns,) rpm, no deeper than the cut's deepest."""
    count = len(modes.pole)
    row = np.repeat(np.arange(count), len(speeds))
    own = None if shear is None else shear[row]
    found = first_at(without_fast(modes).rows(row), cut, np.tile(speeds, count), shear=own, digits=DIGITS)
    return np.minimum(found, cut.depth_max_m).reshape(count, -1)


def _band(task: Task, some: Places, rotation: np.ndarray) -> Result:
    """What is sure: depths stable with 90 % probability, and 90 % intervals of modes and compliance."""
    assert task.ensemble is not None
    drawn = task.ensemble
    seen: Tips = drawn.tips(some.q, task.cut, task.brakes)
    found: Result = {}
    shown = [_modes_shown(ToolModes(p, u)) for p, u in zip(seen.modes.pole, seen.modes.shape, strict=True)]
    for name in ("frequency_hz", "damping_percent"):
        values = np.array([s[name] for s in shown])
        found[f"{name}_interval90"] = np.moveaxis(np.quantile(values, BAND, axis=0), 0, -1)
    size = np.array([dynamic_compliance(ToolModes(p, u))[0] for p, u in zip(*_pair(seen.modes), strict=True)])
    found["dynamic_compliance_m_per_n_interval90"] = np.moveaxis(np.quantile(size, BAND, axis=0), 0, -1)
    closed, full = [], []
    for k in range(len(drawn)):
        modes = ToolModes(seen.modes.pole[k], seen.modes.shape[k]).turned(rotation)
        shear = np.tile(drawn.coefficients[k], (len(some), 1))
        closed.append(_closed(modes, task, shear))
        if task.speeds is not None:
            full.append(lobes(modes, task.cut, task.speeds, shear))
    found["depth_closed_form_safe90_m"] = quantile_of_safe(np.array(closed))
    if full:
        found["depth_safe90_m"] = quantile_of_safe(np.array(full))
    return found


def _pair(modes: ToolModes) -> tuple[np.ndarray, np.ndarray]:
    return modes.pole, modes.shape


# --- who --------------------------------------------------------------------------------------------------------------


def compute(
    task: Task,
    *,
    processes: int = 1,
    scheduler: str | None = None,
    keep: Path | None = None,
    tick: Callable[[int], None] = lambda count: None,
) -> Result:
    """The map, postures on the first axis.

    Args:
        processes: of this machine.
        scheduler: address of a Dask scheduler, whose workers then compute.
        keep: folder in which finished blocks are kept, and looked for first.
        tick: called with 1 for every block.

    Raises:
        InputError: no scheduler at that address.
    """
    found: dict[int, Result] = {}
    for number in range(task.blocks):
        if keep is not None and (kept := _kept(keep, number)) is not None:
            found[number] = kept
            tick(1)
    todo = [number for number in range(task.blocks) if number not in found]
    for number, result in _computed(task, todo, processes, scheduler):
        if keep is not None:
            _store(keep, number, result)
        found[number] = result
        tick(1)
    return {name: np.concatenate([found[k][name] for k in range(task.blocks)]) for name in found[0]}


def _computed(task: Task, todo: list[int], processes: int, scheduler: str | None) -> Iterator[tuple[int, Result]]:
    if scheduler is None:
        yield from zip(todo, spread(lambda k: compute_block(task, todo[k]), len(todo), processes), strict=True)
        return
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise InputError("--scheduler", scheduler, 'needs Dask: pip install "twin[distributed]"') from error
    try:
        client = Client(scheduler, timeout="5s")
    except (OSError, ValueError) as error:
        raise InputError("--scheduler", scheduler, f"no Dask scheduler answers there ({error})") from error
    with client:
        shared = client.scatter(task, broadcast=True, hash=False)
        futures = [client.submit(_numbered, shared, number, pure=False) for number in todo]
        for future in as_completed(futures):
            yield future.result()


def _numbered(task: Task, number: int) -> tuple[int, Result]:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return number, compute_block(task, number)


def _store(folder: Path, number: int, result: Result) -> None:
    with replacing(folder / f"block{number:05d}.npz") as scratch, scratch.open("wb") as stream:
        np.savez(stream, **result)  # type: ignore[arg-type]


def _kept(folder: Path, number: int) -> Result | None:
    path = folder / f"block{number:05d}.npz"
    if not path.is_file():
        return None
    with np.load(path) as file:
        return {name: file[name] for name in file.files}
