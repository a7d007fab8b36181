"""From hammer hits to FRFs, and the checks that tell whether to believe them.

Which hits count and why not (double, overloaded, quiet) is a table. Windows are applied to force and response alike. An
exponential of rate σ moves every FRF from H(iω) to H(σ + iω), exactly. The rate travels with the FRFs, so that every
later estimate is free of it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from twin.errors import InputError
from twin.measure.campaign import (
    DEAD_CHANNEL,
    BoolArray,
    Brakes,
    Campaign,
    Channels,
    ComplexArray,
    FloatArray,
    Hits,
    PostureFRF,
    as_quantity,
    frf_variance,
)

Estimator = Literal["H1", "H2", "Hv"]

DOUBLE_HIT = 0.1  # of the peak force, outside the blow
QUIET_HIT = 0.3  # of the median peak force of the excitation
QUIET_NOISE = 10.0  # times the RMS force before the trigger
FLAT_TOP = 4  # equal samples at the extreme of a record that mean an overload
END_LEVEL = 2e-4  # of the response after the blow that may be left at the end of the record: what is cut off leaks
UNALIASED = 4.0  # sampling rate over the highest line: of it a filter of order 8 folds 0.7 % back, of 1/2.56 4 %
SAME_POINT = 5e-3  # m
SAME_DIRECTION = 0.99  # |cosine|
CROSS_AXIS = 0.03  # transverse sensitivity of a good sensor; by how much a blow by hand misses its direction, rad


@dataclass(frozen=True)
class HitRow:
    """What became of one hit; ``reason`` is empty for an accepted one."""

    excitation: int
    hit: int
    peak_n: float
    reason: str


@dataclass(frozen=True)
class HitTable:
    """All hits of a posture; ``print`` shows what was rejected and why."""

    rows: tuple[HitRow, ...]

    def accepted(self, excitation: int) -> list[int]:
        """Indices of the hits that count."""
        return [row.hit for row in self.rows if row.excitation == excitation and not row.reason]

    def __str__(self) -> str:
        bad = [row for row in self.rows if row.reason]
        head = f"{len(self.rows) - len(bad)} of {len(self.rows)} hits accepted"
        return "\n".join(
            [head] + [f"  excitation {r.excitation} hit {r.hit}: {r.peak_n:.1f} N, {r.reason}" for r in bad]
        )


def judge_hits(hits: Hits) -> HitTable:
    """Accept or reject every hit: double, overloaded (force or response), quiet."""
    ne, nh, _ = hits.force.shape
    force = _without_offset(hits.force, hits)
    peak = np.abs(force).max(axis=2)
    silent = DEAD_CHANNEL * np.abs(hits.response).max(initial=0.0)  # rounding alone has flat tops, too
    rows = []
    for e in range(ne):
        typical = np.median(peak[e])
        for h in range(nh):
            reason = ""
            before = force[e, h, : _trigger(hits)]
            noise = np.sqrt(np.mean(before**2)) if before.size > 8 else 0.0
            if peak[e, h] < QUIET_HIT * typical or peak[e, h] <= QUIET_NOISE * noise:
                reason = f"quiet: the median is {typical:.1f} N"
            elif _flat_top(hits.force[e, h]):
                reason = "overload of the force"
            elif clipped := [
                r for r, record in enumerate(hits.response[e, h]) if np.abs(record).max() > silent and _flat_top(record)
            ]:
                reason = f"overload of response {clipped[0]}"
            elif (second := _second_blow(force[e, h])) > DOUBLE_HIT:
                reason = f"double hit: the second has {100 * second:.0f} % of the first"
            rows.append(HitRow(e, h, float(peak[e, h]), reason))
    return HitTable(tuple(rows))


def _trigger(hits: Hits) -> int:
    """Samples that are surely before the blow."""
    return int(0.8 * hits.pretrigger_s * hits.sample_rate_hz)


def _without_offset(records: FloatArray, hits: Hits) -> FloatArray:
    n = _trigger(hits)
    return records - records[..., :n].mean(axis=-1, keepdims=True) if n > 8 and not hits.windowed else records


def _flat_top(record: FloatArray) -> bool:
    """A run of equal samples at an extreme: the converter ran out of range."""
    size = np.abs(record)
    if size.max() == 0:
        return False
    at = np.concatenate([[0], (size >= size.max() * (1 - 1e-9)).astype(int), [0]])
    edges = np.flatnonzero(np.diff(at))
    return bool((edges[1::2] - edges[::2]).max() >= FLAT_TOP)


def _blow(force: FloatArray) -> tuple[int, int]:
    """First and last sample of the main blow, at a tenth of its peak, with a blow's length of margin."""
    size = np.abs(force)
    top = int(size.argmax())
    low = size < DOUBLE_HIT * size[top]
    before, after = np.flatnonzero(low[:top]), np.flatnonzero(low[top:])
    start = int(before[-1]) if before.size else 0
    end = top + int(after[0]) if after.size else size.size - 1
    width = end - start
    return max(start - width, 0), min(end + width, size.size - 1)


def _second_blow(force: FloatArray) -> float:
    """Largest same-sign force outside the main blow, as a share of its peak."""
    start, end = _blow(force)
    top = force[int(np.abs(force).argmax())]
    rest = np.concatenate([force[:start], force[end + 1 :]]) / top
    return float(rest.max(initial=0.0))


@dataclass(frozen=True)
class Spectra:
    """FRFs from hits.

    Attributes:
        frequency: (nf,) Hz.
        frf: (nf, nr, ne) accelerance.
        coherence: (nf, nr, ne).
        averages: hits per average, the fewest of all excitations.
        exponential_window_rate: 1/s, still in the FRFs.
        table: which hits counted.
    """

    frequency: FloatArray
    frf: ComplexArray
    coherence: FloatArray
    averages: int
    exponential_window_rate: float
    table: HitTable


def spectra(
    hits: Hits,
    estimator: Estimator = "H1",
    *,
    exponential_window_rate: float | None = None,
    force_window: bool = False,
    fmax: float | None = None,
    source: str = "",
) -> Spectra:
    """Average the accepted hits of every excitation.

    H1 = S_fx/S_ff for noise on the response, H2 = S_xx/S_xf for noise on the force. Hv is their geometric mean: total
    least squares with each side scaled by its own power, so that it does not depend on units. Records that carry their
    windows get no others.

    Args:
        hits: time records.
        exponential_window_rate: rate in 1/s of the exponential put on force and response; by default what
            :func:`needed_window_rate` finds.
        force_window: set the force to zero outside the blow. Its flanks cost 0.1 % of FRFs: the exponential already
            takes the noise of what follows down.
        fmax: highest line kept, Hz.
        source: file named in errors.

    Raises:
        InputError: when no hit of an excitation is left.
    """
    table = judge_hits(hits)
    ne, _, nr, nt = hits.response.shape
    if hits.windowed:
        rate = hits.exponential_window_rate
    else:
        rate = needed_window_rate(hits) if exponential_window_rate is None else exponential_window_rate
    time = np.arange(nt) / hits.sample_rate_hz - hits.pretrigger_s
    window = np.ones(nt) if hits.windowed else np.exp(-rate * time)
    frequency = np.asarray(np.fft.rfftfreq(nt, 1 / hits.sample_rate_hz), dtype=np.float64)
    lines = frequency <= (frequency[-1] if fmax is None else fmax)
    frf = np.empty((int(lines.sum()), nr, ne), dtype=complex)
    coherence = np.empty(frf.shape)
    for e in range(ne):
        kept = table.accepted(e)
        if not kept:
            reasons = "; ".join(dict.fromkeys(row.reason for row in table.rows if row.excitation == e))
            expected = f"expected at least one hit that can be used; they have: {reasons}"
            raise InputError(source, f"hits of excitation {e}", expected)
        force = _without_offset(hits.force[e, kept], hits)
        if force_window and not hits.windowed:
            force = np.stack([_gated(record) for record in force])
        f = np.fft.rfft(force * window)[:, lines]
        x = np.fft.rfft(_without_offset(hits.response[e, kept], hits) * window)[:, :, lines]
        sff = np.sum(np.abs(f) ** 2, axis=0)
        sxx = np.sum(np.abs(x) ** 2, axis=0)
        sfx = np.sum(f.conj()[:, None] * x, axis=0)
        tiny = np.finfo(float).tiny
        h1, h2 = sfx / np.maximum(sff, tiny), sxx * sfx / np.maximum(np.abs(sfx) ** 2, tiny)
        match estimator:
            case "H1":
                h = h1
            case "H2":
                h = h2
            case "Hv":
                h = np.sqrt(np.abs(h1) * np.abs(h2)) * np.exp(1j * np.angle(sfx))
        frf[:, :, e] = h.T
        gamma2 = np.abs(sfx) ** 2 / np.maximum(sff * sxx, tiny)
        coherence[:, :, e] = np.minimum(gamma2, 1).T
    averages = min(len(table.accepted(e)) for e in range(ne))
    return Spectra(frequency[lines], frf, coherence, averages, rate, table)


def needed_window_rate(hits: Hits) -> float:
    """Rate in 1/s of the exponential that takes the responses to END_LEVEL by the end of the record.

    0 where they decay that far on their own. A record that ends before the response does leaks, and leakage shifts
    damping by several per cent at 0.5 Hz resolution; the exponential is exact (see module docstring).
    """
    nt = hits.response.shape[-1]
    power = np.mean(_without_offset(hits.response, hits) ** 2, axis=(0, 1, 2))
    start = int(hits.pretrigger_s * hits.sample_rate_hz)
    piece = max((nt - start) // 10, 1)
    noise = power[: _trigger(hits)].mean() if _trigger(hits) > 8 else 0.0
    first, last = (max(p.mean() - noise, 0.0) for p in (power[start : start + piece], power[-piece:]))
    level = np.sqrt(last / first) if first > 0 else 0.0
    return float(np.log(level / END_LEVEL) / (nt / hits.sample_rate_hz)) if level > END_LEVEL else 0.0


def windowed_again(name: str, posture: PostureFRF, slight: float) -> tuple[PostureFRF, float] | None:
    """A posture's FRFs made again from its raw hits under a window that they need, and its rate, 1/s.

    ``None`` where there are no raw hits, or under the window that there is no more than a ``slight`` share is cut off.
    """
    hits = posture.hits
    if hits is None or hits.windowed or not posture.frf.size:
        return None
    rate = needed_window_rate(hits)
    length_s = hits.response.shape[-1] / hits.sample_rate_hz
    if END_LEVEL * np.exp((rate - posture.exponential_window_rate) * length_s) < slight:
        return None
    try:
        made, _ = posture_from_hits(name, posture.q_deg, posture.brakes, hits, fmax=float(posture.frequency[-1]))
    except InputError:  # no hit of a point can be used: the FRFs came from others
        return None
    keep = made.frequency >= posture.frequency[0] * (1 - 1e-9)
    assert made.coherence is not None
    whole = replace(
        made, frequency=made.frequency[keep], frf=made.frf[keep], coherence=made.coherence[keep],
        peak_force_n=posture.peak_force_n, pulse_s=posture.pulse_s, record_s=posture.record_s,
    )  # fmt: skip
    return whole, rate


def _gated(force: FloatArray) -> FloatArray:
    """The blow alone, with cosine flanks over its margins."""
    start, end = _blow(force)
    flank = max((end - start) // 6, 1)
    gate = np.zeros(force.size)
    gate[start : end + 1] = 1
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(flank) + 0.5) / flank)
    if start > 0:
        gate[start : start + flank] = ramp
    gate[end + 1 - flank : end + 1] = np.minimum(gate[end + 1 - flank : end + 1], ramp[::-1])
    return force * gate


def posture_from_hits(
    name: str,
    q_deg: FloatArray,
    brakes: Brakes | None,
    hits: Hits,
    estimator: Estimator = "H1",
    *,
    exponential_window_rate: float | None = None,
    fmax: float | None = None,
    source: str = "",
) -> tuple[PostureFRF, HitTable]:
    """FRFs of one posture from its hits, ready for a campaign, and the table of its hits."""
    found = spectra(hits, estimator, exponential_window_rate=exponential_window_rate, fmax=fmax, source=source)
    peaks = [row.peak_n for row in found.table.rows if not row.reason]
    posture = PostureFRF(
        name=name,
        q_deg=q_deg,
        brakes=brakes,
        frequency=found.frequency,
        frf=found.frf,
        quantity="accelerance",
        coherence=found.coherence,
        averages=found.averages,
        peak_force_n=float(np.median(peaks)),
        exponential_window_rate=found.exponential_window_rate,
        hits=hits,
    )
    return posture, found.table


def with_frfs(campaign: Campaign, source: str = "") -> tuple[Campaign, dict[str, HitTable]]:
    """A campaign whose postures all hold FRFs, and for each that held time records alone which hits counted."""
    postures, tables = dict(campaign.postures), {}
    for name, posture in postures.items():
        if posture.frf.size == 0 and posture.hits is not None:
            postures[name], tables[name] = posture_from_hits(
                name, posture.q_deg, posture.brakes, posture.hits,
                fmax=posture.hits.sample_rate_hz / UNALIASED, source=source,
            )  # fmt: skip
    return (replace(campaign, postures=postures) if tables else campaign), tables


# --- checks -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Check:
    """One number that says whether FRFs are to be believed.

    Attributes:
        kind: ``driving point``, ``reciprocity`` or ``linearity``.
        subject: channel pairs or postures it is about.
        value: what :func:`driving_points`, :func:`reciprocity`, :func:`linearity` define.
        passed: whether a test engineer would accept it.
    """

    kind: str
    subject: str
    value: float
    passed: bool

    @property
    def told(self) -> str:
        """What was found, for people."""
        found = {
            "driving point": f"{1 - self.value:.0%} of its energy has the wrong sign",
            "reciprocity": f"the two differ by {self.value:.0%} of their mean",
        }
        return f"{self.kind} {self.subject}: {found.get(self.kind, f'{self.value:.3g}')}"

    def __str__(self) -> str:
        return f"{'ok  ' if self.passed else 'FAIL'} {self.told}"


def _same(a: Channels, i: int, b: Channels, j: int) -> float:
    """Cosine between two channels at one point of one body, 0 when they are not at one point along one line.

    Nodes of which no place is known all lie at the foot's origin: there only one and the same node is one point.
    """
    if a.body[i] != b.body[j] or np.linalg.norm(a.position[i] - b.position[j]) > SAME_POINT:
        return 0.0
    if a.body[i] == "base" and not a.position[i].any() and a.label[i][:-2] != b.label[j][:-2]:
        return 0.0
    cosine = float(a.direction[i] @ b.direction[j])
    return cosine if abs(cosine) > SAME_DIRECTION else 0.0


def driving_pairs(campaign: Campaign) -> Iterator[tuple[int, int, float]]:
    """Response and excitation index, and sign, of every driving point."""
    for r in range(len(campaign.response.label)):
        for e in range(len(campaign.excitation.label)):
            if cosine := _same(campaign.response, r, campaign.excitation, e):
                yield r, e, float(np.sign(cosine))


def driving_points(campaign: Campaign, posture: PostureFRF) -> list[Check]:
    """Share of the quadrature energy of every driving point that has the sign of a passive structure.

    Im accelerance > 0 (Re mobility > 0): a wrong sign on a blow or sensor gives 0 instead of 1. A point fails if a
    tenth of the energy has the wrong sign beyond what noise has.
    """
    measured = as_quantity(posture, "accelerance")
    accelerance, noise = measured.frf, _noise_energy(measured)
    checks = []
    for r, e, sign in driving_pairs(campaign):
        quadrature = sign * accelerance[:, r, e].imag
        energy = np.sum(quadrature**2)
        share = float(np.sum(quadrature[quadrature > 0] ** 2) / energy) if energy > 0 else 1.0
        passed = (1 - share) * energy <= 0.1 * energy + noise[r, e]
        checks.append(Check("driving point", campaign.pair(r, e), share, bool(passed)))
    return checks


def reciprocity(campaign: Campaign, posture: PostureFRF) -> list[Check]:
    """RMS of H_ab − H_ba over the RMS of their mean, for every pair of points measured both ways.

    A pair fails if a tenth of the mean is left of the difference when two parts are taken away, as squares: the noise
    that the coherence states, and :data:`CROSS_AXIS` of the other directions at both points. A quiet pair at a loud
    point is all cross-axis motion.
    """
    driving = list(driving_pairs(campaign))
    noise = _noise_energy(posture)
    checks = []
    for n, (r, e, sign) in enumerate(driving):
        for r2, e2, sign2 in driving[n + 1 :]:
            if r == r2 or e == e2:
                continue
            ab, ba = sign2 * posture.frf[:, r, e2], sign * posture.frf[:, r2, e]
            size = float(np.linalg.norm(ab + ba)) / 2
            apart = float(np.linalg.norm(ab - ba))
            allowed = CROSS_AXIS**2 * (_across(campaign, posture, r, e2) + _across(campaign, posture, r2, e))
            allowed += 2 * float(noise[r, e2] + noise[r2, e])
            value = apart / size if size > 0 else 0.0
            passed = apart**2 <= (0.1 * size) ** 2 + allowed  # of channels that are dead both are zero
            checks.append(Check("reciprocity", f"{campaign.pair(r, e2)} and {campaign.pair(r2, e)}", value, passed))
    return checks


def _noise_energy(posture: PostureFRF) -> FloatArray:
    """Σ of the noise's square (nr, ne) over the lines of the real, or of the imaginary, part: so much there may be.

    Coherence is taken about the mean of its own n hits, which takes n/(n − 1) from the noise. The sum over lines may be
    three of its deviations larger.
    """
    variance = frf_variance(posture)
    if variance is None or posture.averages is None:
        return np.zeros(posture.frf.shape[1:])
    live = np.where(np.isfinite(variance), variance, 0.0).sum(axis=0)
    return np.asarray(live * posture.averages / (posture.averages - 1) * (1 + 3 / np.sqrt(len(variance))))


def _across(campaign: Campaign, posture: PostureFRF, r: int, e: int) -> float:
    """Σ |H|² of the sensors beside r under blow e, and of r under the blows beside e: what a small turn mixes in."""
    response, excitation = campaign.response, campaign.excitation
    sensors = [k for k in range(len(response.label)) if _beside(response, r, k)]
    blows = [k for k in range(len(excitation.label)) if _beside(excitation, e, k)]
    return float(np.sum(np.abs(posture.frf[:, sensors, e]) ** 2) + np.sum(np.abs(posture.frf[:, r, blows]) ** 2))


def _beside(channels: Channels, one: int, other: int) -> bool:
    """Whether two channels are at one point, in different directions."""
    near = np.linalg.norm(channels.position[one] - channels.position[other]) <= SAME_POINT
    along = abs(float(channels.direction[one] @ channels.direction[other])) > SAME_DIRECTION
    return bool(channels.body[one] == channels.body[other] and near and not along)


def force_levels(campaign: Campaign) -> list[list[PostureFRF]]:
    """Postures measured at several force levels, lowest force first."""
    groups: list[list[PostureFRF]] = []
    for posture in campaign.postures.values():
        for group in groups:
            same = group[0].frf.shape == posture.frf.shape and np.allclose(group[0].q_deg, posture.q_deg)
            if same and group[0].brakes == posture.brakes:
                group.append(posture)
                break
        else:
            groups.append([posture])
    levelled = [[p for p in group if p.peak_force_n is not None] for group in groups]
    return [sorted(group, key=lambda p: p.peak_force_n or 0.0) for group in levelled if len(group) > 1]


def linearity(campaign: Campaign, band: tuple[float, float] | None = None) -> list[Check]:
    """Homogeneity of FRFs over force levels: mean |H_hi − H_lo|² over its variance, 1 for a linear structure.

    Without a stated variance it is the RMS difference over the RMS, and 0 for a linear structure.
    """
    checks = []
    for group in force_levels(campaign):
        for low, high in pairwise(group):
            value, limit = _homogeneity(low, high, band)
            subject = f"{low.name} ({low.peak_force_n:.0f} N) and {high.name} ({high.peak_force_n:.0f} N)"
            checks.append(Check("linearity", subject, value, value < limit))
    return checks


def _homogeneity(low: PostureFRF, high: PostureFRF, band: tuple[float, float] | None) -> tuple[float, float]:
    """The statistic and the limit it is judged against."""
    high = as_quantity(high, low.quantity)
    lines: BoolArray = np.ones(low.frequency.size, dtype=bool)
    if band is not None:
        lines = (low.frequency >= band[0]) & (low.frequency <= band[1])
    difference = np.abs(high.frf - low.frf)[lines] ** 2
    variances: Sequence[FloatArray | None] = [frf_variance(low), frf_variance(high)]
    if variances[0] is None or variances[1] is None:
        return float(np.sqrt(difference.sum() / np.sum(np.abs(low.frf[lines]) ** 2))), 0.05
    total = 2 * (variances[0] + variances[1])[lines]
    live = np.isfinite(total) & (total > 0)
    return float(np.mean(difference[live] / total[live])), 3.0
