"""The rows of a log's torque whitened, and a model on them that is linear about where it is."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.signal import lfilter

from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters
from twin.model.torque_base import Base
from twin.model.torque_design import Block, Design
from twin.model.torque_laws import State, entry_torque
from twin.model.torque_noise import whole_rows
from twin.model.torque_stops import Stop, stops_in
from twin.robot.description import Entry


@dataclass(frozen=True)
class Columns:
    """Whitened columns (N_active, k), zero on every joint that is not in ``joints``."""

    joints: tuple[int, ...]
    rows: FloatArray


@dataclass
class Whitened:
    """Whitened rows of a log and the base model on them; N rows, joint by joint, run by run.

    Attributes:
        whitening: (n, order + 1) prediction-error filter per joint over the noise's deviation.
        parameters: the model's numbers, those of entries that were added to the description last.
        design: whitened torque per prior deviation of the description's numbers, as (N, z).
        A: the same and what was added, as the recording has it at the tolerances in force. ``data`` (N,): whitened
            torque less the description's. ``y`` (N,): the same less what A is not linear in.
        state: per run, what laws that act on other torques see.
        level: (n,) mean square of whitened noise: below one, for the low-pass leaves rows dependent.
        noise: (n,) RMS of the noise at the rows, N·m (N).
        widened: number in z → factor on the prior deviation its description gives it.
        through: delay and gains of a recording (:attr:`recorded_through`), and the design as it has it.
        stops: per joint, what is left out of every judgement where the axis comes to rest or starts.
        turning: (n, n) speeds of the drives per speed of the axes, where drives were found to turn with other axes too.
        late: s by which the stops are late, where the torque was found to be recorded late.
    """

    base: Base
    whitening: FloatArray
    parameters: Parameters
    A: Design = field(default_factory=lambda: Design(0, 0, (), np.zeros(0)))
    design: Design = field(default_factory=lambda: Design(0, 0, (), np.zeros(0)))
    data: FloatArray = field(default_factory=lambda: np.zeros(0))
    y: FloatArray = field(default_factory=lambda: np.zeros(0))
    state: list[State] = field(default_factory=list)
    level: FloatArray = field(default_factory=lambda: np.ones(0))
    noise: FloatArray = field(default_factory=lambda: np.ones(0))
    stops: list[list[Stop]] = field(default_factory=list)
    widened: dict[int, float] = field(default_factory=dict)
    through: tuple[FloatArray, Design] | None = None
    turning: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    late: float = 0.0

    @property
    def order(self) -> int:
        """Of the autoregression."""
        return self.whitening.shape[1] - 1

    @cached_property
    def masks(self) -> list[np.ndarray]:
        """Rows (m,) of each run whose whitened residual rests on valid rows only."""
        return [whole_rows(run.valid, self.order) for run in self.base.runs]

    @property
    def count(self) -> int:
        """Rows per joint."""
        return int(sum(mask.sum() for mask in self.masks))

    def rows(self, joint: int) -> slice:
        """Rows of a joint."""
        return slice(joint * self.count, (joint + 1) * self.count)

    def whiten(self, *columns: Sequence[FloatArray]) -> Columns:
        """Columns, each the torque (m, n) of every run, whitened; joint by joint, for most act on one."""
        acting = np.any([part.any(axis=0) for column in columns for part in column], axis=0)
        joints, runs = tuple(np.flatnonzero(acting).tolist()), range(len(self.base.runs))
        out = [self.whitened(j, [np.stack([c[k][:, j] for c in columns]).T for k in runs]) for j in joints]
        return Columns(joints, np.concatenate(out) if out else np.zeros((0, len(columns))))

    def whitened(self, joint: int, parts: Sequence[FloatArray]) -> FloatArray:
        """Torque (m,) or (m, k) of a joint in every run, whitened (count, k)."""
        filtered = [
            lfilter(self.whitening[joint], [1.0], part, axis=0)[mask]
            for part, mask in zip(parts, self.masks, strict=True)
        ]
        rows = np.concatenate(filtered)
        rows = rows.reshape(len(rows), -1)
        for stop in self.stops[joint] if self.stops else ():
            part = rows[stop.span]
            part -= stop.directions @ (stop.share[:, None] * (stop.directions.T @ part))
        return rows

    def full(self, columns: Columns) -> FloatArray:
        """Columns on all rows (N, k)."""
        out = np.zeros((len(self.whitening) * self.count, columns.rows.shape[1]))
        for part, j in enumerate(columns.joints):
            out[self.rows(j)] = columns.rows[part * self.count : (part + 1) * self.count]
        return out

    def on(self, rows: FloatArray, columns: Columns) -> FloatArray:
        """Those of N rows where columns act (N_active, …)."""
        joints = columns.joints
        if joints and joints[-1] - joints[0] == len(joints) - 1:
            return rows[joints[0] * self.count : (joints[-1] + 1) * self.count]
        return np.concatenate([rows[self.rows(j)] for j in joints]) if joints else rows[:0]

    def assemble(self) -> None:
        """Whiten design and data."""
        base = self.base
        self.stops, self.through = stops_in(base, self.whitening, self.masks, self.turning, self.late), None
        self.A = self.design = self._designed([None] * len(base.runs))
        self.data = self.y = self.full(self.whiten(base.rest))[:, 0]

    def _designed(self, states: Sequence[State | None]) -> Design:
        """The base model's columns whitened, as the states' recordings have them."""
        base, axes = self.base, range(len(self.whitening))
        parts = ([base.design(k, j, state) for k, state in enumerate(states)] for j in axes)
        blocks = tuple(Block(j, base.acting(j), self.whitened(j, part)) for j, part in zip(axes, parts, strict=True))
        return Design(self.count, len(axes), blocks, np.ones(len(base.parameters)))

    def recorded(self, alike: float = 0.01) -> Design:
        """The base model's columns as the recording has them, at the tolerances in force.

        Through a recording whose gains, and delay in rows, are so much ``alike``, they are what they were.
        """
        now = self.recorded_through
        if not np.any(now[0]) and np.all(now[1:] == 1):
            return self.design.scaled(self.widened)
        if self.through is None or np.abs(self.through[0] - now).max() > alike:
            self.through = now, self._designed(self.state)
        return self.through[1].scaled(self.widened)

    @property
    def recorded_through(self) -> FloatArray:
        """(1 + n,) delay in rows, and gains, through which the torque is recorded."""
        state = self.state[0]
        rows = (state.delay + state.lag) * self.base.runs[0].rate_hz
        return np.array([rows, *np.atleast_2d(state.gain).mean(axis=0)])

    @cached_property
    def information(self) -> FloatArray:
        """Gauss–Newton matrix (z, z), prior included."""
        return self.A.gram + np.eye(self.A.width)

    @cached_property
    def inverse(self) -> FloatArray:
        """Of the information."""
        return np.asarray(np.linalg.inv(self.information))

    @cached_property
    def z(self) -> FloatArray:
        """The base model's optimum."""
        return np.asarray(np.linalg.solve(self.information, self.A.transposed(self.y)))

    @cached_property
    def residual(self) -> FloatArray:
        """y − A z (N,)."""
        return self.y - self.A.times(self.z)

    def plain(self, z: FloatArray) -> FloatArray:
        """z in the deviations of the description."""
        out = z.copy()
        for k, factor in self.widened.items():
            out[k] *= factor
        return out

    def torque(self, entries: Sequence[Entry], at_once: bool = False) -> list[FloatArray]:
        """What entries add (m, n), run by run; a coupled drive's friction may turn round ``at_once``, to begin with."""
        out = []
        for run, state in zip(self.base.runs, self.state, strict=True):
            known = replace(state, at_once=at_once)
            parts = [entry_torque(run, known, e, e.values) for e in entries]
            out.append(parts[0] if len(parts) == 1 else sum(parts, np.zeros_like(run.torque)))
        return out

    def across(self, columns: Columns) -> FloatArray:
        """CᵀA (k, z)."""
        return self.A.across(columns.joints, columns.rows)

    def projected(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """CᵀPC (k, k) and CᵀPy (k,), the base model's numbers eliminated."""
        across = self.across(columns)
        pull = columns.rows.T @ self.on(self.residual, columns)
        return columns.rows.T @ columns.rows - across @ self.inverse @ across.T, pull
