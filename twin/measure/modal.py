"""From the FRFs of a posture to its modes: chart, automatic choice, refinement, and what the data do not hold.

Poly-reference LSCF gives candidates; the maximum-likelihood fit of :mod:`twin.measure.modal_fit` sharpens them and
puts a deviation on each. A candidate whose removal the data would not notice goes, one that the residual asks for is
added, both by the Bayesian information criterion, so that weak modes below strong ones are found and noise is not.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from twin.errors import InputError
from twin.measure.campaign import (
    SENSOR_FLOOR,
    BoolArray,
    Campaign,
    ComplexArray,
    FloatArray,
    PostureFRF,
    as_quantity,
    dead_channels,
    frf_variance,
    laplace,
)
from twin.measure.modal_fit import ModalFit, fit_modes, strongest_missing, without
from twin.measure.poles import lsce, plscf
from twin.measure.shapes import frac, mac, mpc, real_phase
from twin.measure.stabilisation import DAMPING_RANGE, Chart, Cluster, chart, clusters

Method = Literal["plscf", "lsce"]

MAX_ORDER = 60
MAX_REFERENCES = 4  # a chart of more is drawn from their principal combinations
MOST_ORDERS = 30  # a higher chart takes every other order
LINES_PER_ORDER = 4  # a chart's order stays below the number of lines over this
BAND_LINES = 1600  # a band with more lines is split, so that low modes are not crowded into a corner of the circle
BAND_RATIO = 5.0
EDGE = 0.15  # of the band on either side: modes there are fitted, not reported
HELD_DAMPING, HELD_FREQUENCY = 0.3, 0.02  # largest relative deviations of a damping and a frequency the data hold
USABLE_COHERENCE = 0.5
REWEIGHTINGS = 2  # rounds of fit and residual variance where the recording states none
NOISE_LINES = (30, 100)  # fewest and most lines of a block that a variance is estimated from
MOST_ADDED, MOST_DOUBTED = 12, 4
LEAST_SHARE = 0.01  # of the response at its own frequency, below which a resonance is no mode
FAR, OVERDAMPED = 2.0, 0.5  # ratio to the end of the band and damping ratio from which a pole is no mode


@dataclass(frozen=True)
class Mode:
    """One identified mode.

    Attributes:
        frequency_hz, damping_percent: undamped natural frequency and damping ratio, windows removed.
        frequency_std_hz, damping_std_percent: standard deviations.
        response_shape: (nr,) mode shape over the responses, most real, largest entry 1.
        excitation_shape: (ne,) over the excitations.
        mpc: modal phase collinearity of the larger of the two.
        frequency_held, damping_held: whether the data hold the value.
    """

    frequency_hz: float
    damping_percent: float
    frequency_std_hz: float
    damping_std_percent: float
    response_shape: ComplexArray
    excitation_shape: ComplexArray
    mpc: float
    frequency_held: bool
    damping_held: bool

    @property
    def remark(self) -> str:
        """What the data do not hold, in words; empty where they hold everything."""
        if not self.frequency_held:
            return "the data do not hold this mode"
        return "" if self.damping_held else "the data do not hold this damping"


@dataclass(frozen=True)
class ModalResult:
    """The modes of one posture; ``print`` shows the table.

    Attributes:
        name: of the posture.
        modes: by frequency.
        frequency: (nf,) lines used, Hz.
        measured, synthesised: (nf, nr, ne) accelerance.
        charts: one per band the analysis was split into.
        response_label, excitation_label: of the channels.
    """

    name: str
    q_deg: FloatArray
    modes: tuple[Mode, ...]
    frequency: FloatArray
    measured: ComplexArray
    synthesised: ComplexArray
    charts: tuple[Chart, ...]
    response_label: tuple[str, ...] = ()
    excitation_label: tuple[str, ...] = ()

    @property
    def frac(self) -> FloatArray:
        """(nr, ne) agreement of measured and synthesised FRFs."""
        return frac(self.measured, self.synthesised)

    @property
    def roving(self) -> Literal["response", "excitation"]:
        """The side with more channels, which carries the mode shapes."""
        return "response" if self.measured.shape[1] >= self.measured.shape[2] else "excitation"

    @property
    def shapes(self) -> ComplexArray:
        """(nm, n) shapes over the roving side."""
        n = max(self.measured.shape[1:])
        rows = [m.response_shape if self.roving == "response" else m.excitation_shape for m in self.modes]
        return np.array(rows, dtype=complex).reshape(-1, n)

    @property
    def shape_label(self) -> tuple[str, ...]:
        """Labels of the columns of :attr:`shapes`."""
        return self.response_label if self.roving == "response" else self.excitation_label

    def report(self) -> dict[str, Any]:
        """What ``twin modal --json`` shows for this posture."""
        return {
            "q_deg": [float(q) for q in self.q_deg],
            "modes": [
                {
                    "frequency_hz": m.frequency_hz,
                    "damping_percent": m.damping_percent,
                    "frequency_std_hz": m.frequency_std_hz,
                    "damping_std_percent": m.damping_std_percent,
                    "damping_held": m.damping_held,
                    "remark": m.remark,
                }
                for m in self.modes
            ],
        }

    def __str__(self) -> str:
        rows = [
            f"{self.name}: {len(self.modes)} modes, {self.frequency[0]:g} to {self.frequency[-1]:g} Hz, "
            f"median FRAC {np.median(self.frac):.3f}",
            f"{'':>3} {'f [Hz]':>10} {'± std':>9} {'ζ [%]':>8} {'± std':>8} {'MPC':>6}",
        ]
        for n, m in enumerate(self.modes, 1):
            rows.append(
                f"{n:>3} {m.frequency_hz:>10.4f} {m.frequency_std_hz:>9.2g} {m.damping_percent:>8.3f} "
                f"{m.damping_std_percent:>8.2g} {m.mpc:>6.3f}  {m.remark}".rstrip()
            )
        return "\n".join(rows)


def identify_modes(
    posture: PostureFRF,
    fmin: float | None = None,
    fmax: float | None = None,
    max_order: int = MAX_ORDER,
    *,
    method: Method = "plscf",
    labels: tuple[tuple[str, ...], tuple[str, ...]] = ((), ()),
    source: str = "",
) -> ModalResult:
    """Modes of one posture between ``fmin`` and ``fmax`` (Hz; by default all that is usable), not told how many.

    Args:
        posture: FRFs of any quantity; coherence and averages, where present, weight every line.
        max_order: highest order of the stabilisation chart.
        method: estimator of the chart.
        labels: of responses and excitations.
        source: file named in errors.

    Raises:
        InputError: when the band holds too few lines.
    """
    low, high = _band(posture, fmin, fmax)
    accelerance = as_quantity(posture, "accelerance")
    variance = frf_variance(accelerance)
    dead = dead_channels(accelerance)
    if dead.all():
        raise InputError(source, f"postures/{posture.name}/frf", "expected a response, every channel is zero")
    step = (posture.frequency[-1] - posture.frequency[0]) / (posture.frequency.size - 1)
    if (high - low) / step < 16:
        raise InputError(source, f"postures/{posture.name}", f"expected 16 lines or more from {low:g} to {high:g} Hz")
    inside = (posture.frequency >= low) & (posture.frequency <= high)
    synthesised = np.zeros_like(accelerance.frf[inside])
    modes: list[Mode] = []
    charts = []
    for start, end in _split(low, high, step):
        edge = EDGE * (end - start)
        lines = (posture.frequency >= start - edge) & (posture.frequency <= end + edge) & (posture.frequency > 0)
        band = _Band.of(
            accelerance.frf[lines],
            posture.frequency[lines],
            None if variance is None else variance[lines],
            dead,
            posture.exponential_window_rate,
        )
        drawn = band.chart(max_order, method)
        band, fit = band.choose(clusters(drawn))
        charts.append(drawn)
        here = (posture.frequency[inside] >= start) & (posture.frequency[inside] <= end)
        s = laplace(posture.frequency[inside][here], posture.exponential_window_rate)
        synthesised[here] = band.oriented(fit.model.synthesise(s))
        modes += band.modes(fit, start, end)
    return ModalResult(
        posture.name,
        posture.q_deg,
        tuple(sorted(modes, key=lambda m: m.frequency_hz)),
        posture.frequency[inside],
        accelerance.frf[inside],
        synthesised,
        tuple(charts),
        *labels,
    )


def identify_campaign(
    campaign: Campaign,
    fmin: float | None = None,
    fmax: float | None = None,
    max_order: int = MAX_ORDER,
    *,
    method: Method = "plscf",
    source: str = "",
) -> dict[str, ModalResult]:
    """:func:`identify_modes` for every posture of a campaign."""
    labels = campaign.response.label, campaign.excitation.label
    return {
        name: identify_modes(posture, fmin, fmax, max_order, method=method, labels=labels, source=source)
        for name, posture in campaign.postures.items()
    }


def modal_report(results: dict[str, ModalResult]) -> dict[str, Any]:
    """The JSON of ``twin modal``: ``postures: {name: {modes: […]}}``."""
    return {"postures": {name: result.report() for name, result in results.items()}}


def _band(posture: PostureFRF, fmin: float | None, fmax: float | None) -> tuple[float, float]:
    frequency = posture.frequency
    low = frequency[frequency > 0][0] if fmin is None else max(fmin, frequency[0])
    if fmax is not None:
        return float(low), float(min(fmax, frequency[-1]))
    if posture.coherence is None:
        return float(low), float(frequency[-1])
    from scipy.ndimage import median_filter

    # A hammer stops exciting somewhere: above it the coherence of all channels falls for good.
    typical = np.median(posture.coherence.reshape(frequency.size, -1), axis=1)
    usable = median_filter(typical, size=min(25, frequency.size)) > USABLE_COHERENCE
    return float(low), float(frequency[np.flatnonzero(usable)[-1]] if usable.any() else frequency[-1])


def _split(low: float, high: float, step: float) -> list[tuple[float, float]]:
    """Bands of at most BAND_LINES lines or a frequency ratio of BAND_RATIO, from the bottom up."""
    bands = []
    while (high - low) / step > BAND_LINES and high > 2 * BAND_RATIO * max(low, step):
        bands.append((high / BAND_RATIO, high))
        high /= BAND_RATIO
    return [*bands, (low, high)][::-1]


@dataclass(frozen=True)
class _Band:
    """FRFs of one band with the references last, and the variance that weights them.

    ``turned`` says that the excitations were more than the responses, so that the two changed places.
    """

    frf: ComplexArray  # (nf, no, ni)
    frequency: FloatArray
    variance: FloatArray
    stated: bool  # the variance comes with the recording
    floor: FloatArray  # (no, ni) variance no residual is trusted below
    rate: float
    turned: bool

    @classmethod
    def of(
        cls, frf: ComplexArray, frequency: FloatArray, variance: FloatArray | None, dead: BoolArray, rate: float
    ) -> "_Band":
        turned = frf.shape[2] > frf.shape[1]
        if turned:
            frf, dead = frf.swapaxes(1, 2), dead.T
            variance = None if variance is None else variance.swapaxes(1, 2)
        rms2 = np.mean(np.abs(frf) ** 2, axis=0)
        floor = np.where(dead, np.inf, np.maximum(SENSOR_FLOOR**2 * rms2, 1e-300))
        if variance is None:
            return cls(frf, frequency, np.where(dead, np.inf, rms2) + 0 * np.abs(frf), False, floor, rate, turned)
        return cls(frf, frequency, np.maximum(variance, floor), True, floor, rate, turned)

    @property
    def s(self) -> ComplexArray:
        return laplace(self.frequency, self.rate)

    def oriented(self, frf: ComplexArray) -> ComplexArray:
        """FRFs of the model as (nf, nr, ne)."""
        return frf.swapaxes(1, 2) if self.turned else frf

    def chart(self, max_order: int, method: Method) -> Chart:
        """Stabilisation chart of the band; poles are corrected for the window."""
        frf, weight = self.frf, 1 / np.sqrt(self.variance)
        principal = np.eye(frf.shape[2], dtype=complex)
        if frf.shape[2] > MAX_REFERENCES:
            whole = (frf * weight).reshape(-1, frf.shape[2])
            principal = np.linalg.eigh(whole.conj().T @ whole)[1][:, -MAX_REFERENCES:]
        top = max(2, min(max_order, self.frequency.size // LINES_PER_ORDER))
        orders = range(top % 2 + 2 if top > MOST_ORDERS else 1, top + 1, 2 if top > MOST_ORDERS else 1)
        found = (
            plscf(frf @ principal, self.frequency, orders, np.sqrt(np.mean(weight**2, axis=2)))
            if method == "plscf"
            else lsce(frf @ principal, self.frequency, orders)
        )
        return chart(
            [replace(p, poles=p.poles + self.rate, participation=p.participation @ principal.conj().T) for p in found]
        )

    def choose(self, candidates: list[Cluster]) -> tuple["_Band", ModalFit]:
        """The modes the data hold, refined: the chart's, without those not needed, with those missing.

        Returned with the band as it was weighted, by residuals where the recording states no variance.
        """
        candidates = [c for c in candidates if c.pole.real < 0]
        poles = np.array([c.pole for c in candidates], dtype=complex)
        participation = np.array([c.participation for c in candidates], dtype=complex)
        participation = participation.reshape(-1, self.frf.shape[2])
        large = self._share(fit_modes(self.frf, self.s, self.variance, poles, participation, 0)) >= LEAST_SHARE
        poles, participation = poles[large], participation[large]
        if self.stated:
            return self, self._completed(self._pruned(self._refitted(poles, participation)))
        weighted, fit = self, self._refitted(poles, participation)
        for _ in range(REWEIGHTINGS):
            weighted = replace(self, variance=self._residual_variance(fit))
            fit = weighted._refitted(fit.model.poles, fit.model.participation)
            fit = weighted._completed(weighted._pruned(fit))
        return weighted, fit

    def _price(self, fit: ModalFit) -> float:
        """Rise of chi2 below which a mode is not worth its parameters (Schwarz 1978), with noise as fitted."""
        _, no, ni = self.frf.shape
        live = np.isfinite(self.floor)
        noise = max(fit.chi2 / fit.dof, float(np.median(self.floor[live] / self.variance[:, live])))
        return (2 * no + 2 * ni) * np.log(2 * self.frf.size) * noise * self.repetition

    @property
    def repetition(self) -> float:
        """Lines that say the same: an exponential window of rate σ over T correlates the noise of neighbouring lines.

        T ∫ w⁴ / (∫ w²)² for w = exp(−σt) over the record length T, one over the distance of the lines.
        """
        a = self.rate * (self.frequency.size - 1) / (self.frequency[-1] - self.frequency[0])
        return float(a * -np.expm1(-4 * a) / np.expm1(-2 * a) ** 2) if a > 1e-6 else 1.0

    def _deviations(self, fit: ModalFit) -> tuple[FloatArray, FloatArray]:
        """Of frequency in Hz and of the damping ratio, with as few independent lines as there are.

        Where the fit misses a resonance by more than it misses the rest (leakage, hits that disagree), the deviations
        of its mode grow by as much.
        """
        misfit = np.sum(np.abs(self.frf - fit.model.synthesise(self.s)) ** 2 / self.variance, axis=(1, 2))
        live = 2 * np.count_nonzero(np.isfinite(self.variance), axis=(1, 2))
        _, no, ni = self.frf.shape
        factor = np.ones(fit.model.poles.size)
        for r, pole in enumerate(fit.model.poles):
            lines = np.abs(self.frequency - abs(pole) / (2 * np.pi)) <= 1.5 * self._reach(pole)
            dof = max(live[lines].sum() - 2 * (no + ni), 0.5 * live[lines].sum(), 1.0)
            factor[r] = max(1.0, misfit[lines].sum() / dof / max(fit.chi2 / fit.dof, np.finfo(float).tiny))
        factor = np.sqrt(factor * self.repetition)
        frequency, damping = fit.deviations()
        return frequency * factor, damping * factor

    def _refitted(self, poles: ComplexArray, participation: ComplexArray) -> ModalFit:
        return fit_modes(self.frf, self.s, self.variance, poles, participation)

    def _pruned(self, fit: ModalFit) -> ModalFit:
        """Without modes that explain nothing, and without halves of one mode."""
        while fit.model.poles.size:
            large = self._share(fit) >= LEAST_SHARE
            if not large.all():
                fit = self._refitted(fit.model.poles[large], fit.model.participation[large])
                continue
            away = np.maximum(self.frequency[0] / fit.frequency, fit.frequency / self.frequency[-1])
            weakest = int(np.argmin(np.where((away > FAR) | (fit.damping > OVERDAMPED), 0, fit.wald)))
            if fit.wald[weakest] < self._price(fit) or away[weakest] > FAR or fit.damping[weakest] > OVERDAMPED:
                fit = self._refitted(*without(fit, weakest))
                continue
            for mode in self._doubtful(fit)[:MOST_DOUBTED]:
                fewer = self._refitted(*without(fit, mode))
                if fewer.chi2 - fit.chi2 < self._price(fit):
                    fit = fewer
                    break
            else:
                return fit
        return fit

    def _share(self, fit: ModalFit) -> FloatArray:
        """(nm,) RMS over the channels of what each mode adds at its own frequency, over that of the measured response.

        A smooth background that the model lacks, such as an overdamped mode, is fitted by many small resonances.
        """
        lines = np.argmin(np.abs(self.frequency[:, None] - fit.frequency), axis=0)
        s, poles = self.s[lines], fit.model.poles
        size = np.linalg.norm(fit.model.shape, axis=1) * np.linalg.norm(fit.model.participation, axis=1)
        live = np.isfinite(self.floor)
        measured = np.sqrt(np.sum(np.abs(self.frf[:, live]) ** 2, axis=1))
        return np.asarray(size * np.abs(s**2 / (s - poles)) / np.maximum(measured[lines], np.finfo(float).tiny))

    def _doubtful(self, fit: ModalFit) -> list[int]:
        """Modes of implausible or uncertain damping, or that share frequency and shape with another; weakest first."""
        poles, damping = fit.model.poles, fit.damping
        uncertain = self._deviations(fit)[1] > HELD_DAMPING * damping
        implausible = (damping < DAMPING_RANGE[0]) | (damping > DAMPING_RANGE[1])
        bandwidth = -2 * poles.real
        close = np.abs(poles[:, None] - poles) < np.maximum(bandwidth[:, None], bandwidth)
        alike = mac(fit.model.shape) * mac(fit.model.participation) > 0.8
        twin = (close & alike & ~np.eye(poles.size, dtype=bool)).any(axis=1)
        doubtful = np.flatnonzero(uncertain | implausible | twin)
        return [int(mode) for mode in doubtful[np.argsort(fit.wald[doubtful])]]

    def _completed(self, fit: ModalFit) -> ModalFit:
        """With the modes that stand out of the residual.

        Hits that do not quite agree, as when a roving test shifts a frequency, leave a residual beside a mode that
        looks like a second one with its shape on one side. It is passed over: a pair that is real shows in the chart.
        """
        variance = self.variance.copy()
        for _ in range(MOST_ADDED):
            residual = self.frf - fit.model.synthesise(self.s)
            pole, shape, participation, gain = strongest_missing(residual, self.s, variance, self.frequency)
            if gain < self._price(fit):
                return fit
            if self._shadow(fit, pole, shape, participation):
                variance[np.abs(self.frequency - abs(pole) / (2 * np.pi)) <= self._reach(pole)] = np.inf
                continue
            more = self._refitted(
                np.append(fit.model.poles, pole), np.concatenate([fit.model.participation, participation[None]])
            )
            more = self._pruned(more)
            added = more.model.poles.size - fit.model.poles.size
            if fit.chi2 - more.chi2 < self._price(more) * max(added, 0.1):
                return fit
            fit = more
        return fit

    def _reach(self, pole: complex) -> float:
        """Half-width in Hz of what a pole dominates, a line at least."""
        step = (self.frequency[-1] - self.frequency[0]) / (self.frequency.size - 1)
        return float(max(-2 * pole.real / (2 * np.pi), step))

    def _shadow(self, fit: ModalFit, pole: complex, shape: ComplexArray, participation: ComplexArray) -> bool:
        """Whether a pole lies on a fitted mode and shares its shape or its participation factors."""
        close = [abs(pole.imag - p.imag) / (2 * np.pi) < self._reach(p) + self._reach(pole) for p in fit.model.poles]
        alike = np.zeros(len(close))
        for new, have in ((shape, fit.model.shape), (participation, fit.model.participation)):
            if new.size > 1:
                alike = np.maximum(alike, mac(new[None], have)[0])
        return bool((np.array(close, dtype=bool) & (alike > 0.9)).any()) or (self.frf[0].size == 1 and any(close))

    def _residual_variance(self, fit: ModalFit) -> FloatArray:
        """Variance per line from the residual: a level per channel times one course over the band.

        Medians of blocks of lines, which a resonance left over cannot lift; the course is the median channel's.
        """
        residual = np.abs(self.frf - fit.model.synthesise(self.s)) ** 2 / (2 * np.log(2))
        lines = self.frequency.size
        blocks = np.array_split(np.arange(lines), max(1, lines // int(np.clip(lines // 8, *NOISE_LINES))))
        level = np.stack([np.median(residual[block], axis=0) for block in blocks])
        channel = np.median(level, axis=0)
        live = np.isfinite(self.floor) & (channel > 0)
        if not live.any():
            return np.broadcast_to(self.floor, self.frf.shape).copy()
        course = np.median(level[:, live] / channel[live], axis=1)
        over = np.interp(np.arange(lines), [float(block.mean()) for block in blocks], course)
        return np.maximum(over[:, None, None] * channel, self.floor)

    def modes(self, fit: ModalFit, start: float, end: float) -> list[Mode]:
        """The modes of a fit that lie within a band and are physical."""
        frequency_std, damping_std = self._deviations(fit)
        shape, participation = real_phase(fit.model.shape), real_phase(fit.model.participation)
        collinear = mpc(fit.model.shape)
        if self.turned:
            shape, participation = participation, shape
        return [
            Mode(
                frequency_hz=float(fit.frequency[r]),
                damping_percent=float(100 * fit.damping[r]),
                frequency_std_hz=float(frequency_std[r]),
                damping_std_percent=float(100 * damping_std[r]),
                response_shape=shape[r],
                excitation_shape=participation[r],
                mpc=float(collinear[r]),
                frequency_held=bool(frequency_std[r] < HELD_FREQUENCY * fit.frequency[r]),
                damping_held=bool(damping_std[r] < HELD_DAMPING * fit.damping[r]),
            )
            for r in np.argsort(fit.frequency)
            if start <= fit.frequency[r] <= end and DAMPING_RANGE[0] < fit.damping[r] < DAMPING_RANGE[1]
        ]
