"""Recordings beside the model as it came, before and after: what errors, figures and sentences of evidence read off."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from twin.diagnose.refit import Fitted
from twin.identify.elastic_compare import judge, relative_error
from twin.identify.objective import Objective, Sample
from twin.measure.campaign import QUANTITIES, Brakes, Channels, ComplexArray, FloatArray, Quantity
from twin.model.recorded import Recorded, placed
from twin.parallel import spread
from twin.robot.description import Robot
from twin.robot.physical import physical

Stage = Literal["as_given", "before", "after"]
STAGES: tuple[Stage, ...] = ("as_given", "before", "after")


@dataclass(frozen=True)
class FrfRecord:
    """One posture and force level.

    Attributes:
        name: of the group; ``posture`` is its base name, shared by force levels.
        held_out: not used for fitting.
        q: (n,) rad (m).
        frequency: (nf,) Hz.
        measured: (nf, nr, ne); ``variance`` of real and imaginary part, infinite where a line is not used.
        predicted: stage → (nf, nr, ne).
        angles: stage → (n,) by how much the recorded angles are off in it, over the tolerance that is described.
        modes_hz: stage → natural frequencies of the model in this posture.
        shared: lines that carry the noise of one independent line.
    """

    name: str
    posture: str
    held_out: bool
    q: FloatArray
    brakes: Brakes | None
    response: Channels
    excitation: Channels
    frequency: FloatArray
    quantity: Quantity
    measured: ComplexArray
    variance: FloatArray
    predicted: Mapping[Stage, ComplexArray]
    angles: Mapping[Stage, FloatArray] = field(default_factory=dict)
    modes_hz: Mapping[Stage, FloatArray] = field(default_factory=dict)
    shared: float = 1.0

    def energy(self, stage: Stage) -> FloatArray:
        """|residual|²/σ² (nf, nr, ne); zero where a line is not used; two for every line that is pure noise."""
        return np.asarray(np.abs(self.measured - self.predicted[stage]) ** 2 / self.variance)

    def error(self, stage: Stage) -> float:
        """Weighted RMS of the residual over that of the data."""
        return float(np.sqrt(self.energy(stage).sum() / self._power))

    @property
    def floor(self) -> float:
        """The same for a residual that is all noise."""
        return float(np.sqrt(2 * np.isfinite(self.variance).sum() / self._power))

    @property
    def _power(self) -> float:
        return max(float((np.abs(self.measured) ** 2 / self.variance).sum()), 1e-300)

    def channel(self, pair: int) -> tuple[slice, int, int]:
        """Index of a channel pair, given its number in ``pairs``, into the arrays (nf, nr, ne)."""
        return slice(None), pair // len(self.excitation.label), pair % len(self.excitation.label)

    @property
    def pairs(self) -> list[str]:
        """Channel pairs in the order of the last two axes, flattened."""
        return [f"{r}/{e}" for r in self.response.label for e in self.excitation.label]


@dataclass(frozen=True)
class LogRecord:
    """One run of a motion log, in joint coordinates, after the identification's own low-pass.

    Attributes:
        time: (nt,) s; ``position``, ``velocity``, ``measured`` (nt, n).
        valid: (nt,) rows that count.
        predicted: stage → torque (nt, n), offsets included.
        noise: (n,) RMS of the torque noise after the same low-pass; NaN where unknown.
        units: (n,) of torque, for people.
    """

    name: str
    held_out: bool
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    measured: FloatArray
    valid: np.ndarray
    predicted: Mapping[Stage, FloatArray]
    noise: FloatArray
    units: tuple[str, ...] = ()

    def error(self, stage: Stage) -> float:
        """RMS over joints of residual RMS over torque RMS."""
        rest = np.mean((self.measured - self.predicted[stage])[self.valid] ** 2, axis=0)
        return float(np.sqrt(np.mean(rest / np.maximum(np.mean(self.measured[self.valid] ** 2, axis=0), 1e-300))))

    def energy(self, stage: Stage) -> float:
        """Sum over rows and joints of |residual|²/σ²."""
        return float(np.sum(((self.measured - self.predicted[stage])[self.valid] / self.noise) ** 2))

    @property
    def floor(self) -> float:
        """The same for a residual that is all noise."""
        power = np.maximum(np.mean(self.measured[self.valid] ** 2, axis=0), 1e-300)
        return float(np.sqrt(np.mean(self.noise**2 / power)))


@dataclass(frozen=True)
class ModalRecord:
    """One posture of a modal table.

    Attributes:
        measured: (nm, 2) Hz and percent of critical, NaN where a number is missing.
        deviation: (nm, 2) standard deviations, relative.
        predicted: stage → (nm, 2) of the model's modes paired with them.
    """

    name: str
    held_out: bool
    q: FloatArray
    measured: FloatArray
    deviation: FloatArray
    predicted: Mapping[Stage, FloatArray]

    def error(self, stage: Stage) -> float:
        """RMS of relative frequency differences."""
        return float(np.sqrt(np.nanmean((self.predicted[stage][:, 0] / self.measured[:, 0] - 1) ** 2)))

    @property
    def floor(self) -> float:
        """RMS of the relative standard deviations of the frequencies."""
        return float(np.sqrt(np.nanmean(self.deviation[:, 0] ** 2)))


Record = FrfRecord | LogRecord | ModalRecord


def pooled_floor(records: Sequence[Record]) -> float | None:
    """Error of a residual that is all noise, pooled over records of one kind as their errors are; ``None`` of none."""
    frfs = [r for r in records if isinstance(r, FrfRecord)]
    logs = [r for r in records if isinstance(r, LogRecord)]
    tables = [r for r in records if isinstance(r, ModalRecord)]
    if frfs:
        count = sum(np.isfinite(r.variance).sum() for r in frfs)
        return float(np.sqrt(2 * count / sum(r._power for r in frfs)))
    if logs:
        power = np.mean(np.concatenate([r.measured[r.valid] for r in logs]) ** 2, axis=0)
        return float(np.sqrt(np.mean(logs[0].noise ** 2 / np.maximum(power, 1e-300))))
    return float(np.sqrt(np.nanmean(np.concatenate([r.deviation[:, 0] for r in tables]) ** 2))) if tables else None


def frf_records(
    given: Robot,
    before: Fitted,
    after: Fitted,
    used: Sequence[Recorded],
    kept: Sequence[Recorded],
    shared: float = 1.0,
    processes: int = 1,
) -> tuple[list[FrfRecord], dict[str, Any]]:
    """Every posture of a campaign beside the three models, and the errors of a diagnosis.

    Models are judged as they will be written, see :func:`physical`. Where a model was fitted, its own posture angles
    and gains are used. Elsewhere they are re-estimated within the description's tolerances, and nothing else is. Of the
    angles, only those that the model has free are re-estimated.

    Args:
        given: the description as it came.
        before, after: base model and answer, both fitted to all lines of ``used``.
        used, kept: recordings fitted to and held out.
        shared: lines that carry the noise of one independent line.
        processes: the three models, on either part, are spread over so many.

    Returns:
        Records, used ones first, and stage → ``train`` and ``held_out`` (``None`` without any).
    """
    models = ((given, None), (before.robot, before), (after.robot, after))

    def part_of(number: int) -> tuple[list[ComplexArray], list[FloatArray], float | None]:
        """What a model predicts of used or of held-out recordings, the angles that takes, and the error."""
        stage, late = divmod(number, 2)
        (robot, fit), some = models[stage], kept if late else used
        if not some:
            return [], [], None
        robot = physical(robot)
        there = placed(some, fit.parameters, fit.values) if fit else some
        if fit is None or late or robot is not fit.robot:
            judged = judge(robot, there, stated=_as_recorded(fit) if fit else ())
            return list(judged.predicted), list(judged.angles), judged.error
        of_used = list(Objective(fit.robot, fit.parameters, Sample(tuple(used))).predicted(fit.z))
        turned = [fit.parameters.posture_error(r.setup.name, fit.values, len(r.setup.q)) for r in used]
        return of_used, turned, relative_error(used, of_used)

    parts = list(spread(part_of, 2 * len(STAGES), processes))
    predicted, angles, errors = {}, {}, dict[str, Any]()
    for stage, (train, rest) in zip(STAGES, zip(parts[::2], parts[1::2], strict=True), strict=True):
        predicted[stage], angles[stage] = [*train[0], *rest[0]], [*train[1], *rest[1]]
        errors[stage] = {"train": train[2], "held_out": rest[2]}
    records, width = [], np.deg2rad(given.tolerances.posture_deg) or np.inf
    for k, r in enumerate(placed((*used, *kept), after.parameters, after.values)):
        records.append(
            FrfRecord(
                r.group, r.setup.name, k >= len(used), r.setup.q, r.setup.brakes, r.setup.response, r.setup.excitation,
                r.frequency, QUANTITIES[r.power], r.frf, r.variance,
                {stage: predicted[stage][k] for stage in STAGES},
                {stage: angles[stage][k] / width for stage in STAGES}, shared=shared,
            )
        )  # fmt: skip
    return records, errors


def _as_recorded(fit: Fitted) -> list[int]:
    """Axes (zero-based) whose angles a fit takes as recorded, though it has those of others free."""
    free = {p.axis for p in fit.parameters if p.kind == "posture"}
    return [axis for axis in range(len(fit.robot.axes)) if free and axis not in free]
