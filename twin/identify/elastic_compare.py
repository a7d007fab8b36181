"""The error of a robot on recorded FRFs without fitting any physics: pooled, and by posture, channel and band.

error = √(Σ |H − Ĥ|²/σ² / Σ |H|²/σ²), every line weighted by one over its variance (unweighted where the recording
states none). What belongs to the recording — angles of its postures, gains of its channels — is estimated first, within
the description's tolerances; ``as_is`` leaves even that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from twin.identify.elastic import (
    TEMPERS,
    Fit,
    Recorded,
    coarse,
    linear_objective,
    log_objective,
    minimise,
    model_frf,
    prepare,
    without_limits,
)
from twin.identify.parameters import Parameters, independent, join, recording_parameters
from twin.identify.uncertainty import posterior
from twin.measure.campaign import ComplexArray, FloatArray, read_campaign
from twin.robot.description import Robot

BANDS = 6  # a recording's frequency range is judged in this many equal bands


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
        floor = "" if self.noise_floor is None else f", noise floor {self.noise_floor:.2%}"
        lines = [f"{self.robot}: error {self.error:.2%}{floor}"]
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


def compare_frf(path: str | Path, robot: Robot, as_is: bool = False) -> Comparison:
    """Compare a robot with an ``frf-campaign`` file.

    Args:
        path: the recording.
        robot: the description.
        as_is: leave posture angles and channel gains as stated.

    Raises:
        InputError: the file breaks its contract or does not belong to a robot of this kind.
    """
    campaign = read_campaign(path)
    recordings = list(prepare(campaign, robot, str(path)).values())
    weighted = all(p.coherence is not None for p in campaign.postures.values())
    return comparison(robot, recordings, str(path), as_is=as_is, noise_known=weighted)


def comparison(
    robot: Robot, recordings: Sequence[Recorded], source: str, *, as_is: bool = False, noise_known: bool = True
) -> Comparison:
    """Compare a robot with recordings that have been read, see :func:`compare_frf`."""
    judged = judge(robot, recordings, as_is=as_is)
    parts: list[dict[str, Any]] = []
    for r, H in zip(judged.recordings, judged.predicted, strict=True):
        place = {"recording": source, "posture": r.group}
        parts.append({**place, "channel": None, "band_hz": None, "error": relative_error([r], [H])})
        for i, response in enumerate(r.setup.response.label):
            for j, excitation in enumerate(r.setup.excitation.label):
                cut = np.s_[:, i : i + 1, j : j + 1]
                if np.isfinite(r.variance[cut]).any():
                    error = _ratio(r.frf[cut], H[cut], r.variance[cut])
                    parts.append({**place, "channel": f"{response}/{excitation}", "band_hz": None, "error": error})
        edges = np.linspace(r.frequency[0], r.frequency[-1], BANDS + 1)
        for low, high in pairwise(edges):
            lines = (r.frequency >= low) & ((r.frequency < high) | (high == edges[-1]))
            if lines.any():
                error = _ratio(r.frf[lines], H[lines], r.variance[lines])
                band = [float(low), float(high)]
                parts.append({**place, "channel": None, "band_hz": band, "error": error})
    estimated = dict(zip(judged.parameters.names, map(float, judged.values), strict=True))
    floor = noise_floor(recordings) if noise_known else None
    return Comparison(robot.name, judged.error, floor, tuple(parts), estimated, judged)


def judge(robot: Robot, recordings: Sequence[Recorded], *, as_is: bool = False) -> Judged:
    """Predict recordings, after estimating posture angles and channel gains within their tolerances."""
    robot = without_limits(robot)
    free = recording_set(robot, recordings) if not as_is else independent([])
    z = np.zeros(len(free))
    if len(free):
        few = coarse(recordings)
        first, _, _, _ = minimise(log_objective(robot, free, few), z, 10, 0.1, free.bound)
        ends = []
        for start in (z, first):
            end = start
            for temper in TEMPERS:
                end, *_ = minimise(linear_objective(robot, free, few, temper), end, 10, 0.1, free.bound)
            ends.append(minimise(linear_objective(robot, free, recordings), end, 20, 1e-3, free.bound)[:2])
        z = min(ends, key=lambda end: end[1])[0]
    values = free.values(z)
    predicted = tuple(model_frf(robot, r, free, values) for r in recordings)
    return Judged(tuple(recordings), predicted, free, values, relative_error(recordings, predicted))


def recording_set(robot: Robot, recordings: Sequence[Recorded]) -> Parameters:
    """Posture angles and channel gains of recordings as free parameters."""
    names = dict.fromkeys(r.setup.name for r in recordings)
    return independent(recording_parameters(robot, names, recordings[0].setup.response.label))


def relative_error(recordings: Sequence[Recorded], predicted: Sequence[ComplexArray]) -> float:
    """Weighted RMS of the residual over weighted RMS of the data, pooled over recordings."""
    top = bottom = 0.0
    for r, H in zip(recordings, predicted, strict=True):
        top += float(np.sum(np.abs(r.frf - H) ** 2 / r.variance))
        bottom += float(np.sum(np.abs(r.frf) ** 2 / r.variance))
    return float(np.sqrt(top / bottom)) if bottom else 0.0


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
    _, _, information = linear_objective(robot, both, recordings)(z)
    information = information - np.eye(len(z))
    n = len(own)
    root = physical.root
    covariance = np.linalg.solve(root, np.linalg.solve(root, posterior(fit)[np.ix_(own, own)]).T)
    F_pp, F_pu, F_uu = information[:n, :n], information[:n, n:], information[n:, n:]
    back = np.linalg.solve(F_uu + np.eye(len(F_uu)), F_pu.T)
    left = F_pp - 2 * F_pu @ back + back.T @ F_uu @ back
    power = sum(float(np.sum(np.abs(r.frf) ** 2 / r.variance)) for r in recordings)
    return float(np.sqrt(noise_floor(recordings) ** 2 + np.trace(left @ covariance) / power))


def _ratio(H: ComplexArray, predicted: ComplexArray, variance: FloatArray) -> float:
    bottom = float(np.sum(np.abs(H) ** 2 / variance))
    return float(np.sqrt(np.sum(np.abs(H - predicted) ** 2 / variance) / bottom)) if bottom else 0.0
