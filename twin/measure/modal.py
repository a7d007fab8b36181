"""From the FRFs of a posture to its modes: chart, automatic choice, refinement, and what the data do not hold.

Poly-reference LSCF gives candidates. :mod:`twin.measure.modal_choice` decides which of them, and which others, the data
hold. The maximum-likelihood fit of :mod:`twin.measure.modal_fit` sharpens them and puts a deviation on each.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.measure.campaign import (
    ComplexArray,
    FloatArray,
    PostureFRF,
    as_quantity,
    dead_channels,
    frf_variance,
    laplace,
)
from twin.measure.modal_choice import Band
from twin.measure.modal_fit import ModalFit
from twin.measure.poles import lsce, plscf
from twin.measure.shapes import frac, mpc, real_phase
from twin.measure.stabilisation import DAMPING_RANGE, Chart, chart, clusters, column_share

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
        orders: of the chart that have a stable pole there, as a share; 0 for a mode that only the residual shows.
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
    orders: float = 0.0

    @property
    def remark(self) -> str:
        """What the data do not hold, in words; empty where they hold everything."""
        if not self.frequency_held:
            return "the data do not hold this mode"
        if not self.damping_held:
            return "the data do not hold this damping"
        return "" if self.orders > 0 else "no column in the chart, found in what other modes leave over"


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
        coherence: (nf,) median over the channels, or ``None``.
        operational: of responses alone; ``measured`` and ``synthesised`` are half-spectra over reference responses.
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
    coherence: FloatArray | None = None
    operational: bool = False

    @property
    def quantity(self) -> tuple[str, str]:
        """What ``measured`` holds, and its unit."""
        return ("half-spectrum", "(m/s²)²/Hz") if self.operational else ("accelerance", "m/(s²·N)")

    @property
    def frac(self) -> FloatArray:
        """(nr, ne) agreement of measured and synthesised FRFs."""
        return frac(self.measured, self.synthesised)

    @property
    def missed_hz(self) -> float | None:
        """The line with the largest FRFs, where the modes leave more than half of their energy there; else ``None``."""
        power, left = (np.sum(np.abs(x) ** 2, axis=(1, 2)) for x in (self.measured, self.measured - self.synthesised))
        at = int(np.argmax(power))
        return float(self.frequency[at]) if left[at] > 0.5 * power[at] else None

    @property
    def complaint(self) -> str:
        """That the largest response is no mode's, in words; empty where it is."""
        if self.missed_hz is None:
            return ""
        return (
            f"no mode explains the largest response, at {self.missed_hz:.4g} Hz. Either the lines there scatter as "
            "much as a peak, or the response is nonlinear. Try a narrow band around it, and look at the coherence"
        )

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
    def titles(self) -> list[str]:
        """One per mode, for pictures: number, frequency, damping ratio."""
        return [f"{n} · {m.frequency_hz:.4g} Hz · {m.damping_percent:.3g} %" for n, m in enumerate(self.modes, 1)]

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
                    "mpc": m.mpc,
                    "chart_share": m.orders,
                    "remark": m.remark,
                }
                for m in self.modes
            ],
            "missed_hz": self.missed_hz,
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
        if self.complaint:
            rows.append(f"  {self.complaint}")
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
        ends = f"{posture.frequency[0]:g} to {posture.frequency[-1]:g} Hz"
        raise InputError(
            source, f"postures/{posture.name}",
            f"expected 16 lines or more from {low:g} to {high:g} Hz; lines go from {ends}",
        )  # fmt: skip
    turned = accelerance.frf.shape[2] > accelerance.frf.shape[1]

    def turn(array: NDArray[Any]) -> NDArray[Any]:
        """References last in the fit, excitations last outside."""
        return array.swapaxes(-1, -2) if turned else array

    inside = (posture.frequency >= low) & (posture.frequency <= high)
    synthesised = np.zeros_like(accelerance.frf[inside])
    modes: list[Mode] = []
    charts = []
    for start, end in _split(low, high, step):
        edge = EDGE * (end - start)
        lines = (posture.frequency >= start - edge) & (posture.frequency <= end + edge) & (posture.frequency > 0)
        band = Band.of(
            turn(accelerance.frf[lines]),
            posture.frequency[lines],
            None if variance is None else turn(variance[lines]),
            turn(dead),
            posture.exponential_window_rate,
        )
        drawn = _chart(band, max_order, method)
        band, fit = band.choose(clusters(drawn))
        charts.append(drawn)
        here = (posture.frequency[inside] >= start) & (posture.frequency[inside] <= end)
        s = laplace(posture.frequency[inside][here], posture.exponential_window_rate)
        synthesised[here] = turn(fit.model.synthesise(s))
        modes += _modes(band, fit, start, end, turned, drawn)
    return ModalResult(
        posture.name,
        posture.q_deg,
        tuple(sorted(modes, key=lambda m: m.frequency_hz)),
        posture.frequency[inside],
        accelerance.frf[inside],
        synthesised,
        tuple(charts),
        *labels,
        coherence=None
        if posture.coherence is None
        else np.median(posture.coherence[inside].reshape(np.count_nonzero(inside), -1), axis=1),
    )


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


def _chart(band: Band, max_order: int, method: Method) -> Chart:
    """Stabilisation chart of a band; poles are corrected for the window."""
    frf, weight = band.frf, np.sqrt(band.variance.weight / band.variance.course[:, None, None])
    principal = np.eye(frf.shape[2], dtype=complex)
    if frf.shape[2] > MAX_REFERENCES:
        whole = (frf * weight).reshape(-1, frf.shape[2])
        principal = np.linalg.eigh(whole.conj().T @ whole)[1][:, -MAX_REFERENCES:]
    top = max(2, min(max_order, band.frequency.size // LINES_PER_ORDER))
    orders = range(top % 2 + 2 if top > MOST_ORDERS else 1, top + 1, 2 if top > MOST_ORDERS else 1)
    found = (
        plscf(frf @ principal, band.frequency, orders, np.sqrt(np.mean(weight**2, axis=2)))
        if method == "plscf"
        else lsce(frf @ principal, band.frequency, orders)
    )
    return chart(
        [replace(p, poles=p.poles + band.rate, participation=p.participation @ principal.conj().T) for p in found]
    )


def _modes(band: Band, fit: ModalFit, start: float, end: float, turned: bool, drawn: Chart) -> list[Mode]:
    """The modes of a fit that lie within a band and are physical."""
    frequency_std, damping_std = band.deviations(fit)
    shape, participation = real_phase(fit.model.shape), real_phase(fit.model.participation)
    collinear = mpc(fit.model.shape)
    if turned:
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
            orders=column_share(drawn, complex(fit.model.poles[r])),
        )
        for r in np.argsort(fit.frequency)
        if start <= fit.frequency[r] <= end and DAMPING_RANGE[0] < fit.damping[r] < DAMPING_RANGE[1]
    ]
