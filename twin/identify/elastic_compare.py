"""The error of a robot on recorded FRFs or modes without fitting any physics: pooled, and by part.

FRFs: √(Σ |H − Ĥ|²/σ² / Σ |H|²/σ²), every line weighted by one over its variance (unweighted where the recording states
none), by posture, channel and band. What belongs to the recording — angles of its postures, gains of its channels — is
estimated first, within the description's tolerances; ``as_is`` leaves even that. Modal tables: RMS of relative
frequency differences, by posture and mode, as they are: 0.2° moves the KR90's first four modes by less than 0.1 %.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from twin.identify.descent import minimise
from twin.identify.elastic import FIT_TEMPERS, Fit, coarse
from twin.identify.elastic_modal import PairedMode, frequency_error, modal_postures, predict_modes
from twin.identify.objective import Objective, Sample
from twin.identify.uncertainty import posterior
from twin.measure.campaign import ComplexArray, FloatArray
from twin.measure.modal_table import ModalTable
from twin.model.parameters import Parameters, independent, join, recording_parameters
from twin.model.recorded import Recorded, noise_stated, without_limits
from twin.robot.description import Robot

ERROR_BANDS = 6  # a recording's frequency range is judged in this many equal bands
EQUAL_RIGHT, ONE_END = 10.0, 0.1  # ln likelihood and prior deviations, within which two ends are of equal right, or one


@dataclass(frozen=True)
class Judged:
    """A robot beside recordings.

    Attributes:
        recordings: what was judged.
        predicted: one (nf, nr, ne) per recording.
        parameters: what was estimated of the recordings, empty for ``as_is``; ``values`` (n,) what it came to.
        error: pooled.
    """

    recordings: tuple[Recorded, ...]
    predicted: tuple[ComplexArray, ...]
    parameters: Parameters
    values: FloatArray
    error: float

    @property
    def angles(self) -> list[FloatArray]:
        """By how much the angles of every recording were found to be off, (n,) rad (m)."""
        setups = [r.setup for r in self.recordings]
        return [self.parameters.posture_error(s.name, self.values, len(s.q)) for s in setups]


@dataclass(frozen=True)
class Comparison:
    """Error of a robot on recordings, in total and in parts; prints itself, and is the JSON of ``twin compare``.

    ``parts``: each names ``recording``, ``posture`` and one of ``channel`` or ``band_hz`` (or neither), and ``error``.
    """

    robot: str
    error: float
    noise_floor: float | None
    parts: tuple[dict[str, Any], ...]
    estimated: dict[str, float]
    judged: Judged

    def data(self) -> dict[str, Any]:
        """The JSON of the command."""
        return {
            "robot": self.robot,
            "error": self.error,
            "noise_floor": self.noise_floor,
            "parts": list(self.parts),
            "estimated": self.estimated,
        }

    def __str__(self) -> str:
        floor = "unweighted: no coherence" if self.noise_floor is None else f"noise alone {self.noise_floor:.2%}"
        lines = [f"{self.robot}: error {self.error:.2%} ({floor})"]
        for part in self.parts:
            if part["channel"] is None and part["band_hz"] is None:
                lines.append(f"  {part['posture']:24} {part['error']:9.2%}")
                worst = sorted(
                    (p for p in self.parts if p["posture"] == part["posture"] and p["channel"]),
                    key=lambda p: -p["error"],
                )[:3]
                bands = [p for p in self.parts if p["posture"] == part["posture"] and p["band_hz"]]
                lines.append("    bands     " + "  ".join(
                    f"{p['band_hz'][0]:.0f}–{p['band_hz'][1]:.0f} Hz {p['error']:.1%}" for p in bands
                ))  # fmt: skip
                lines.append("    channels  " + "  ".join(f"{p['channel']} {p['error']:.1%}" for p in worst))
        return "\n".join(lines)


def comparison(robot: Robot, judged: Judged, source: str) -> Comparison:
    """What :func:`judge` found of a robot, in parts."""
    recordings = judged.recordings
    weighted = noise_stated(recordings)
    parts: list[dict[str, Any]] = []
    for r, H in zip(judged.recordings, judged.predicted, strict=True):
        place = {"recording": source, "posture": r.group}
        weight = _weight(r, weighted)

        def ratio(cut: Any, r: Recorded = r, H: ComplexArray = H, weight: FloatArray = weight) -> float:
            return _ratio([r.frf[cut]], [H[cut]], [weight[cut]])

        parts.append({**place, "channel": None, "band_hz": None, "error": ratio(...)})
        for i, response in enumerate(r.setup.response.label):
            for j, excitation in enumerate(r.setup.excitation.label):
                cut = np.s_[:, i : i + 1, j : j + 1]
                if weight[cut].any():
                    channel = f"{response}/{excitation}"
                    parts.append({**place, "channel": channel, "band_hz": None, "error": ratio(cut)})
        edges = np.linspace(r.frequency[0], r.frequency[-1], ERROR_BANDS + 1)
        for low, high in pairwise(edges):
            lines = (r.frequency >= low) & ((r.frequency < high) | (high == edges[-1]))
            if lines.any():
                band = [float(low), float(high)]
                parts.append({**place, "channel": None, "band_hz": band, "error": ratio(lines)})
    estimated = dict(zip(judged.parameters.names, map(float, judged.values), strict=True))
    floor = noise_floor(recordings) if weighted else None
    return Comparison(robot.name, judged.error, floor, tuple(parts), estimated, judged)


def judge(robot: Robot, recordings: Sequence[Recorded], *, as_is: bool = False, stated: Collection[int] = ()) -> Judged:
    """Predict recordings, after estimating posture angles and channel gains within their tolerances.

    ``stated``: zero-based axes whose angles are taken as recorded.
    """
    robot = without_limits(robot)
    free = recording_set(robot, recordings) if not as_is else independent([])
    free = free.select(k for k, p in enumerate(free) if p.kind != "posture" or p.axis not in stated)
    z = np.zeros(len(free))
    if len(free):
        few = coarse(recordings)
        first, *_ = minimise(Objective(robot, free, few, logarithmic=True), z, 10, 0.1, bound=free.bound)
        ends = []
        for end in (z, first):
            for temper in FIT_TEMPERS:
                end, cost, *_ = minimise(Objective(robot, free, few, temper), end, 10, 0.1, bound=free.bound)
            ends.append((end, cost))
        (best, least), (other, more) = sorted(ends, key=lambda end: end[1])
        apart = more < least + EQUAL_RIGHT and not np.allclose(best, other, atol=ONE_END)
        whole = Objective(robot, free, Sample(tuple(recordings)), exact=True)
        starts = [best, other] if apart else [best]
        ends = [minimise(whole, start, 20, 1e-3, bound=free.bound, slack=0.0)[:2] for start in starts]
        z = min(ends, key=lambda end: end[1])[0]
    values = free.values(z)
    predicted = tuple(Objective(robot, free, Sample(tuple(recordings))).predicted(z))
    return Judged(tuple(recordings), predicted, free, values, relative_error(recordings, predicted))


def recording_set(robot: Robot, recordings: Sequence[Recorded]) -> Parameters:
    """Posture angles and channel gains of recordings as free parameters."""
    names = dict.fromkeys(r.setup.name for r in recordings)
    return independent(recording_parameters(robot, names, recordings[0].setup.response.label))


def relative_error(recordings: Sequence[Recorded], predicted: Sequence[ComplexArray]) -> float:
    """RMS of the residual over RMS of the data, pooled; weighted by one over the variance where all state theirs."""
    weighted = noise_stated(recordings)
    return _ratio([r.frf for r in recordings], predicted, [_weight(r, weighted) for r in recordings])


def noise_floor(recordings: Sequence[Recorded]) -> float:
    """The error that measurement noise alone makes: a perfect model would have it."""
    data = sum(float(np.isfinite(r.variance).sum()) for r in recordings)
    power = sum(float(np.sum(np.abs(r.frf) ** 2 / r.variance)) for r in recordings)
    return float(np.sqrt(2 * data / power)) if power else 0.0


def expected_error(robot: Robot, fit: Fit, recordings: Sequence[Recorded]) -> float:
    """The error to expect on recordings not used: noise, and what the fit's posterior leaves open there.

    First order: predictions vary as J C Jᵀ with C the posterior of springs and links, less what re-estimated posture
    angles and gains take back.
    """
    robot = without_limits(robot)
    own = [k for k, parameter in enumerate(fit.parameters) if parameter.kind in ("spring", "entry", "link")]
    physical = fit.parameters.select(own)
    nuisance = recording_set(robot, recordings)
    both = join(physical, nuisance)
    z = both.coordinates(np.concatenate([fit.values[own], nuisance.values(np.zeros(len(nuisance)))]))
    _, _, information = Objective(robot, both, Sample(tuple(recordings)))(z)
    information = information - np.eye(len(z))
    n = len(own)
    root = physical.root
    covariance = np.linalg.solve(root, np.linalg.solve(root, posterior(fit)[np.ix_(own, own)]).T)
    F_pp, F_pu, F_uu = information[:n, :n], information[:n, n:], information[n:, n:]
    back = np.linalg.solve(F_uu + np.eye(len(F_uu)), F_pu.T)
    left = F_pp - 2 * F_pu @ back + back.T @ F_uu @ back
    power = sum(float(np.sum(np.abs(r.frf) ** 2 / r.variance)) for r in recordings)
    return float(np.sqrt(noise_floor(recordings) ** 2 + np.trace(left @ covariance) / power))


def _weight(r: Recorded, weighted: bool) -> FloatArray:
    """(nf, nr, ne) weights of the squares; zero where a line is not used."""
    return 1 / r.variance if weighted else np.isfinite(r.variance).astype(float)


def _ratio(H: Sequence[ComplexArray], predicted: Sequence[ComplexArray], weight: Sequence[FloatArray]) -> float:
    top = sum(float(np.sum(np.abs(a - b) ** 2 * w)) for a, b, w in zip(H, predicted, weight, strict=True))
    bottom = sum(float(np.sum(np.abs(a) ** 2 * w)) for a, w in zip(H, weight, strict=True))
    return float(np.sqrt(top / bottom)) if bottom else 0.0


# --- modal tables -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ModalComparison:
    """A robot's modes beside those of a modal table; prints itself.

    ``error``: RMS of relative frequency differences; a measured mode without a partner counts as 1. ``parts``: each
    names ``recording``, ``posture``, ``channel`` (null), ``measured_hz`` (null for the whole posture) and ``error``.
    """

    robot: str
    error: float
    parts: tuple[dict[str, Any], ...]
    modes: tuple[PairedMode, ...]

    def __str__(self) -> str:
        lines = [f"{self.robot}: error {self.error:.2%} (RMS of relative frequency differences)"]
        for part in self.parts:
            if part["measured_hz"] is None:
                lines.append(f"  {part['posture']:24} {part['error']:9.2%}")
                lines += [f"    {mode}" for mode in self.modes if mode.posture == part["posture"]]
        return "\n".join(lines)


def compare_modes(robot: Robot, table: ModalTable, source: str = "table") -> ModalComparison:
    """Compare a robot with a modal table; modes are paired by MAC where it has shapes, else by nearest frequency.

    Raises:
        InputError: the table does not belong to a robot of this kind.
    """
    postures = modal_postures(table, robot, source)
    modes = predict_modes(robot, postures)
    parts: list[dict[str, Any]] = []
    for name in postures:
        place = {"recording": source, "posture": name, "channel": None}
        own = [mode for mode in modes if mode.posture == name]
        parts.append({**place, "measured_hz": None, "model_hz": None, "mac": None, "error": frequency_error(own)})
        for mode in own:
            error = 1.0 if mode.frequency_hz is None else abs(mode.frequency_hz / mode.measured_hz - 1)
            parts.append(
                {
                    **place, "measured_hz": mode.measured_hz, "model_hz": mode.frequency_hz, "mac": mode.mac,
                    "error": error,
                }
            )  # fmt: skip
    return ModalComparison(robot.name, frequency_error(modes), tuple(parts), tuple(modes))
