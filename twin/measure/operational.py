"""Modes of a structure that runs, from its responses alone: recordings without excitation, and their modes.

Poles come from covariance-driven stochastic subspace identification by pyOMA2 (MIT licence; Peeters & De Roeck, MSSP
13, 1999; Döhler & Mevel, MSSP 38, 2013). Their deviations come from the scatter between segments of the record. Columns
of its stabilisation chart are modes where some channel shows them. Shapes over all channels are the residues of the
correlations at positive lags, which decay with the same poles; their transforms, the half-spectra, are what is drawn.
"""

import logging
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.ndimage import uniform_filter1d
from scipy.signal import decimate, detrend, firwin, oaconvolve

from twin.errors import InputError
from twin.measure.campaign import (
    DEAD_CHANNEL,
    FORMAT,
    Campaign,
    Channels,
    ComplexArray,
    FloatArray,
    PostureFRF,
    check_channels,
    check_q_deg,
    check_sample_rate,
    read_channels,
    read_q_deg,
)
from twin.measure.hdf5 import Node, opened
from twin.measure.modal import HELD_DAMPING, HELD_FREQUENCY, MAX_REFERENCES, ModalResult, Mode
from twin.measure.modal_choice import VISIBLE
from twin.measure.poles import Poles
from twin.measure.shapes import mac, mpc, real_phase
from twin.measure.stabilisation import DAMPING_RANGE, Chart, chart, clusters, column_share
from twin.measure.uff import read_uff_responses
from twin.ranges import ill_named

MOST_OUTPUTS = 8  # of which poles are identified; shapes are of all
MOST_ORDER = 40  # deviations of a higher order cost minutes
MOST_LAGS, FEWEST_LAGS = 30, 12  # block rows of the Hankel matrix
SEGMENTS, FEWEST_SEGMENTS = 40, 10  # of the record, whose scatter gives deviations
SEGMENT_LAGS = 20  # block rows that a segment is long at least
HALF_SPECTRUM = 4096, 8  # most lags of a half-spectrum, and parts of a record that one is at most
REWEIGHTED, TAILS = 4, 3  # fits of residues, and powers of 1/s beside the modes
FEWEST_LINES = 16  # of a half-spectrum in the band
AROUND = 8  # lines on either side of a mode, from whose median the noise there is told
CUT, CUT_PERIODS = 0.85, 6  # a filter's corner over the lower end of an octave, its length in periods of that end
USABLE = 2.56  # sampling rate over the highest line an anti-aliasing filter leaves alone, as analysers have it
LEFT_AT_END = 0.01  # of the exponential window of a half-spectrum
ONE_MODE = 0.97  # MAC from which two columns within a bandwidth are one mode
EXTRA = 'needs pyOMA2: pip install "twin[operational]"'


@dataclass(frozen=True)
class Running:
    """One record of a structure that runs.

    Attributes:
        q_deg: (n,) axis positions; empty where there are none.
        response: (nr, nt) m/s².
        sample_rate_hz: Hz.
    """

    q_deg: FloatArray
    response: FloatArray
    sample_rate_hz: float


def read_running(paths: str | Path | Sequence[str | Path]) -> tuple[Campaign, dict[str, Running]]:
    """Read responses without excitation: universal files (58, time responses) or one ``frf-campaign`` HDF5 file.

    The HDF5 file holds ``response/`` and ``postures/NAME/running/response`` (nr, nt) in m/s² with the attribute
    ``sample_rate_hz``; it needs neither ``excitation/`` nor FRFs.

    Returns:
        the channels as a campaign whose postures hold no FRFs, and posture → record.

    Raises:
        InputError: a file is missing or breaks the contract.
    """
    files = [Path(p) for p in ([paths] if isinstance(paths, str | Path) else paths)]
    if h5py.is_hdf5(files[0]):
        if len(files) > 1:
            raise InputError(files[1], "", "several files are taken only when all are universal files (.uff, .unv)")
        channels, robot, lines, records = _from_hdf5(files[0])
    else:
        channels, robot, lines, found = read_uff_responses(files)
        records = {name: Running(*record) for name, record in found.items()}
    empty = np.zeros((0, len(channels.label), 1), dtype=complex)
    postures = {
        name: PostureFRF(name, record.q_deg, None, np.zeros(0), empty, "accelerance")
        for name, record in records.items()
    }
    campaign = Campaign(channels, channels, postures, robot, source=str(files[0]), lines=lines)
    check_channels(files[0], "response", channels)
    for name, record in records.items():
        _check(files[0], name, record, len(channels.label))
    return campaign, records


def _from_hdf5(path: Path) -> tuple[Channels, str | None, tuple[tuple[int, ...], ...], dict[str, Running]]:
    with opened(path) as file:
        root = Node(path, file)
        if root.text("format") != FORMAT:
            raise InputError(path, "format", f'expected "{FORMAT}", found {root.text("format")!r}')
        postures = root.group("postures")
        records = {}
        for name in postures.item:
            node = postures.group(name)
            running = node.group("running")
            rate = running.number("sample_rate_hz")
            if rate is None:
                raise running.fail(f"{running.field}: sample_rate_hz", "expected Hz, the attribute is missing")
            records[name] = Running(read_q_deg(node), running.real("response", "m/s^2"), rate)
        return read_channels(root.group("response")), root.text("robot") or None, (), records


def _check(source: Path, name: str, record: Running, channels: int) -> None:
    field = f"postures/{name}/running"
    if wrong := ill_named(name):
        raise InputError(source, "postures", wrong)
    check_q_deg(source, f"postures/{name}", record.q_deg)
    if record.response.ndim != 2 or record.response.shape[0] != channels:
        raise InputError(
            source,
            f"{field}/response",
            f"expected shape ({channels}, any) = response, sample, found {record.response.shape}",
        )
    if not np.isfinite(record.response).all():
        raise InputError(source, f"{field}/response", "expected finite numbers, found NaN or infinity")
    check_sample_rate(source, field, record.sample_rate_hz)
    if not record.response.any():
        raise InputError(source, f"{field}/response", "expected a response, every channel is zero")


def identify_running(
    name: str,
    record: Running,
    label: tuple[str, ...],
    fmin: float | None = None,
    fmax: float | None = None,
    max_order: int = MOST_ORDER,
    *,
    source: str = "",
) -> ModalResult:
    """Modes of a record, not told how many; ``measured`` of the result are half-spectra in (m/s²)²/Hz.

    Args:
        name: of the posture.
        record: responses to something broad, as wind, traffic, cutting or a running motor.
        label: of the responses.
        fmin: lowest frequency, Hz; by default the lowest whose decay the block rows cover.
        fmax: highest, Hz; the record is thinned to it. By default what the sampling rate allows.
        max_order: highest order of the chart, ``MOST_ORDER`` at most.
        source: file named in errors.

    Raises:
        InputError: pyOMA2 is missing, or the record is too short.
    """
    highest = record.sample_rate_hz / USABLE
    top = highest if fmax is None else min(fmax, highest)
    y, rate = _thinned(record, top)
    rms = np.sqrt(np.mean(y**2, axis=1))
    live = np.flatnonzero(rms > DEAD_CHANNEL * np.median(rms[rms > 0]))
    count = min(MAX_REFERENCES, live.size)
    order = min(max_order, MOST_ORDER) // 2 * 2
    lags = int(np.clip(np.ceil(order / count) + 1, FEWEST_LAGS, MOST_LAGS))
    need = FEWEST_SEGMENTS * SEGMENT_LAGS * lags + 2 * lags
    if y.shape[1] < need:
        raise InputError(
            source,
            f"postures/{name}/running/response",
            f"expected {need / rate:.3g} s or more, found {y.shape[1] / rate:.3g}",
        )
    step = rate / (2 * min(HALF_SPECTRUM[0], y.shape[1] // HALF_SPECTRUM[1]))
    if fmin is not None and top - fmin < FEWEST_LINES * step:
        band = f"from {fmin:g} to {top:g} Hz; lines are {step:.3g} Hz apart, up to {highest:.4g} Hz"
        raise InputError(source, f"postures/{name}/running", f"expected {FEWEST_LINES} lines or more {band}")
    parts = _octaves(y, rate, top, fmin, need)
    references = _pivot(np.concatenate([_scaled(part.y[live]) for part in parts], axis=1), live)[:count]
    modes: list[Mode] = []
    frequency, measured, synthesised, charts = [], [], [], []
    for part in parts:
        outputs = _pivot(_scaled(part.y[live]), live)[:MOST_OUTPUTS]
        poles, deviations = _subspace(_scaled(part.y[outputs]), count, lags, order, part)
        drawn = chart(poles)
        charts.append(_inside(drawn, part))
        s, spectra = _half_spectra(_correlations(part, references), part)
        found, residues, sum_of_modes = _visible(_columns(drawn, deviations), s, spectra, part)
        modes += [m for m in _modes(found, residues, drawn) if part.holds(m.frequency_hz)]
        frequency.append(s.imag / (2 * np.pi))
        measured.append(spectra)
        synthesised.append(sum_of_modes)
    return ModalResult(
        name,
        record.q_deg,
        tuple(sorted(modes, key=lambda m: m.frequency_hz)),
        np.concatenate(frequency),
        np.concatenate(measured),
        np.concatenate(synthesised),
        tuple(charts),
        label,
        tuple(label[r] for r in references),
        operational=True,
    )


@dataclass(frozen=True)
class _Octave:
    """A part of the band: responses (nr, nt) in m/s² that hold it, ``rate`` and its ends ``low`` and ``high`` in Hz."""

    y: FloatArray
    rate: float
    low: float
    high: float

    @property
    def lags(self) -> int:
        """Of the correlations whose transforms are half-spectra."""
        return min(HALF_SPECTRUM[0], self.y.shape[1] // HALF_SPECTRUM[1])

    def transforms(self, poles: ComplexArray, s: ComplexArray) -> ComplexArray:
        """(nf, nm) half-spectra of sampled decays, which break off as the correlations do."""
        step = (poles - s[:, None]) / self.rate
        return np.asarray((1 - np.exp(self.lags * step)) / (self.rate * (1 - np.exp(step))), dtype=complex)

    def holds(self, frequency: Any) -> NDArray[np.bool_]:
        """Which frequencies, Hz, are inside."""
        return np.asarray((frequency >= self.low) & (frequency < self.high))


def _octaves(y: FloatArray, rate: float, top: float, fmin: float | None, need: int) -> list[_Octave]:
    """The band in octaves, lowest first, each without what lies below and at a rate of its own.

    Block rows that resolve a low mode would be too many at a high rate, and what is strong below would hide what is
    weak above. A record of ``need`` samples is not halved any more: below its octave is one last part.
    """
    parts: list[_Octave] = []
    high = top
    while fmin is None or rate / 2 / USABLE > np.sqrt(2) * fmin:  # no part is narrower than half an octave
        low = rate / 2 / USABLE
        parts.insert(0, _Octave(_without_below(y, rate, low, need), rate, low, high))
        high = low
        if y.shape[1] // 2 < need:
            break
        y, rate = decimate(y, 2, ftype="fir", axis=1), rate / 2
    lowest = rate / (2 * MOST_LAGS * SEGMENT_LAGS) if fmin is None else fmin
    return [_Octave(_without_below(y, rate, lowest, need), rate, lowest, high), *parts]


def _without_below(y: FloatArray, rate: float, low: float, need: int) -> FloatArray:
    """Responses (nr, nt) without what is well below ``low`` Hz; with it where the record is too short for a filter."""
    taps = int(CUT_PERIODS * rate / low) | 1 if low > 0 else y.shape[1]
    if y.shape[1] - taps < need:
        return y
    window = firwin(taps, CUT * low, fs=rate, pass_zero=False)
    return np.asarray(oaconvolve(y, window[None], mode="valid", axes=1))


def _scaled(y: FloatArray) -> FloatArray:
    """Every response (nr, nt) over its root mean square."""
    rms = np.sqrt(np.mean(y**2, axis=1, keepdims=True))
    return y / np.where(rms > 0, rms, 1.0)


def _pivot(y: FloatArray, number: NDArray[np.intp]) -> NDArray[np.intp]:
    """The ``number`` of responses (nr, nt), the most independent first."""
    return number[qr(y.T, mode="r", pivoting=True, check_finite=False)[1]]


def _thinned(record: Running, top: float) -> tuple[FloatArray, float]:
    """Responses without their mean, at the lowest rate that a filter leaves right up to ``top`` Hz."""
    y, rate = detrend(record.response, axis=1, type="constant"), record.sample_rate_hz
    factor = int(rate / (USABLE * top))
    while factor > 1:
        step = min(factor, 10)
        y, rate, factor = decimate(y, step, ftype="fir", axis=1), rate / step, factor // step
    return y, rate


def _subspace(
    y: FloatArray, references: int, lags: int, order: int, part: _Octave
) -> tuple[list[Poles], list[FloatArray]]:
    """Poles of every even order, and (n, 2) deviations of frequencies in Hz and damping ratios."""
    order = min(order, lags * references, (lags - 1) * len(y)) // 2 * 2
    segments = min(SEGMENTS, (y.shape[1] - 2 * lags) // (SEGMENT_LAGS * lags))
    state = np.geterr()
    try:
        from pyoma2.functions import ssi
    except ImportError as error:
        raise InputError("--operational", "", EXTRA) from error
    finally:
        np.seterr(**state)  # pyOMA2 silences warnings of the whole process
    logging.getLogger("pyoma2").setLevel(logging.WARNING)
    peer: Any = ssi  # its annotations are not those of what it returns
    with redirect_stderr(StringIO()), np.errstate(all="ignore"):  # its progress bars
        hankel, scatter = peer.build_hank(y, y[:references], lags, "cov", calc_unc=True, nb=segments)
        observability, a, c, _ = peer.SSI_fast(hankel, lags, order)
        _, _, shapes, poles, f_std, z_std, _ = peer.SSI_poles(
            observability, a, c, order, 1 / part.rate, xi_max=DAMPING_RANGE[1], calc_unc=True, H=hankel, T=scatter
        )
    found, deviations = [], []
    for n in range(2, order + 1, 2):
        keep = np.isfinite(poles[:, n]) & np.isfinite(f_std[:, n]) & (np.abs(poles[:, n].imag) > 0)
        pole, shape = poles[keep, n], shapes[keep, n]
        back = pole.imag < 0
        pole, shape = np.where(back, pole.conj(), pole), np.where(back[:, None], shape.conj(), shape)
        found.append(Poles(n, pole, shape, np.ones((pole.size, 1), dtype=complex)))
        deviations.append(np.stack([f_std[keep, n], z_std[keep, n]], axis=1))
    return found, deviations


@dataclass(frozen=True)
class _Column:
    """A mode: pole in rad/s, shape over the outputs, deviations of frequency in Hz and damping ratio."""

    pole: complex
    shape: ComplexArray
    frequency_std: float
    damping_std: float


def _inside(drawn: Chart, part: _Octave) -> Chart:
    """The chart without poles beside the octave, which another octave's chart holds."""
    poles, symbols = [], []
    for found, marks in zip(drawn.poles, drawn.symbols, strict=True):
        keep = part.holds(found.frequency)
        poles.append(Poles(found.order, found.poles[keep], found.shape[keep], found.participation[keep]))
        symbols.append("".join(mark for mark, stays in zip(marks, keep, strict=True) if stays))
    return Chart(tuple(poles), tuple(symbols))


def _columns(drawn: Chart, deviations: list[FloatArray]) -> list[_Column]:
    """Columns of the chart, each once, with the scatter over orders in their deviations."""
    found: list[_Column] = []
    for cluster in sorted(clusters(drawn), key=lambda c: -c.count):
        members = []
        for poles, deviation in zip(drawn.poles, deviations, strict=True):
            if poles.poles.size:
                n = int(np.argmin(np.abs(poles.poles - cluster.pole)))
                if abs(poles.poles[n] - cluster.pole) < -cluster.pole.real:
                    members.append((poles.shape[n], *deviation[n]))
        frequency = abs(cluster.pole) / (2 * np.pi)
        if not members:
            continue
        f_std, z_std = (float(np.median([m[k] for m in members])) for k in (1, 2))
        shape = members[len(members) // 2][0]
        one = _Column(
            cluster.pole,
            shape,
            float(np.hypot(f_std, cluster.frequency_spread)),
            float(np.hypot(z_std, cluster.damping_spread)),
        )
        again = any(
            abs(one.pole - other.pole) < max(-2 * one.pole.real, -2 * other.pole.real)
            and mac(shape[None], other.shape[None])[0, 0] > ONE_MODE
            for other in found
        )
        if one.frequency_std < HELD_FREQUENCY * frequency and not again:
            found.append(one)
    return sorted(found, key=lambda c: abs(c.pole))


def _correlations(part: _Octave, references: Any) -> FloatArray:
    """Correlations (lag, nr, ne) of all responses with the references at positive lags, (m/s²)²."""
    nt = part.y.shape[1]
    size = 2 ** int(np.ceil(np.log2(2 * nt)))
    whole = np.fft.rfft(part.y, size, axis=1)
    found = [np.fft.irfft(whole * whole[r].conj(), size, axis=1)[:, : part.lags].T / nt for r in references]
    return np.stack(found, axis=2)


def _half_spectra(correlation: FloatArray, part: _Octave) -> tuple[ComplexArray, ComplexArray]:
    """Laplace points (nf,) and half-spectra (nf, nr, ne) of correlations under an exponential window."""
    lags, rate = part.lags, part.rate
    sigma = -np.log(LEFT_AT_END) * rate / lags
    window = np.exp(-sigma / rate * np.arange(lags))
    window[0] /= 2
    frequency = np.fft.rfftfreq(2 * lags, 1 / rate)
    inside = part.holds(frequency)
    spectra = np.fft.rfft(correlation * window[:, None, None], 2 * lags, axis=0)[inside] / rate
    return sigma + 2j * np.pi * frequency[inside], spectra


def _visible(
    found: list[_Column], s: ComplexArray, spectra: ComplexArray, part: _Octave
) -> tuple[list[_Column], ComplexArray, ComplexArray]:
    """Modes that some channel shows above what all of them leave over, residues (nm, nr, ne), synthesised spectra.

    Modes beside the octave stay: filters leave some of them, which would go into the others.
    """
    while True:
        poles = np.array([c.pole for c in found], dtype=complex)
        residues, synthesised = _residues(poles, s, spectra, part)
        if not found:
            return found, residues, synthesised
        left = np.abs(spectra - synthesised)
        line = np.argmin(np.abs(s.imag[:, None] - poles.imag), axis=0)
        around = [left[max(k - AROUND, 0) : k + AROUND + 1] for k in line]
        noise = np.stack([np.sqrt(np.median(near**2, axis=0) / np.log(2)) for near in around])
        own = np.abs(part.transforms(poles, s)[line, np.arange(line.size)])[:, None, None] * np.abs(residues)
        shown = np.max(own / np.where(noise > 0, noise, np.inf), axis=(1, 2))
        shown[~part.holds(np.abs(poles) / (2 * np.pi))] = np.inf
        if shown.min() >= VISIBLE:
            return found, residues, synthesised
        found = [c for k, c in enumerate(found) if k != int(np.argmin(shown))]


def _residues(
    poles: ComplexArray, s: ComplexArray, spectra: ComplexArray, part: _Octave
) -> tuple[ComplexArray, ComplexArray]:
    """Residues (nm, nr, ne) of the poles in the half-spectra, and what they make of these.

    A line counts the less, the more is left over around it: a record of finite length errs most where modes are strong.
    """
    p, c = part.transforms(poles, s), part.transforms(poles.conj(), s)
    tails = (s / np.abs(s[-1]))[:, None] ** -np.arange(TAILS)  # noise of a sensor, in lag zero; what is strong below
    terms = np.concatenate([p + c, 1j * (p - c), tails], axis=1)
    flat = spectra.reshape(s.size, -1)
    scale = np.sqrt(np.mean(np.abs(flat) ** 2, axis=0))
    weight = np.ones(s.size)
    for _ in range(REWEIGHTED):
        a, b = (x * weight[:, None] for x in (terms, flat))
        solution = np.linalg.lstsq(np.concatenate([a.real, a.imag]), np.concatenate([b.real, b.imag]), rcond=None)[0]
        synthesised = terms @ solution
        left = np.mean(np.abs((flat - synthesised) / np.where(scale > 0, scale, 1.0)) ** 2, axis=1)
        weight = 1 / np.sqrt(uniform_filter1d(left, 2 * AROUND + 1) + np.finfo(float).tiny)
    residues = solution[: poles.size] + 1j * solution[poles.size : 2 * poles.size]
    return residues.reshape(poles.size, *spectra.shape[1:]), synthesised.reshape(spectra.shape)


def _modes(found: list[_Column], residues: ComplexArray, drawn: Chart) -> tuple[Mode, ...]:
    modes = []
    for column, residue in zip(found, residues, strict=True):
        u, _, v = np.linalg.svd(residue)
        shape = u[:, :1].T
        frequency, damping = abs(column.pole) / (2 * np.pi), -column.pole.real / abs(column.pole)
        modes.append(
            Mode(
                frequency_hz=float(frequency),
                damping_percent=float(100 * damping),
                frequency_std_hz=column.frequency_std,
                damping_std_percent=100 * column.damping_std,
                response_shape=real_phase(shape)[0],
                excitation_shape=real_phase(v[:1])[0],
                mpc=float(mpc(shape)[0]),
                frequency_held=True,
                damping_held=bool(column.damping_std < HELD_DAMPING * damping),
                orders=column_share(drawn, column.pole),
            )
        )
    return tuple(modes)
