"""Modes of a structure that runs, from its responses alone: recordings without excitation, and their modes.

Poles, with deviations from the scatter between segments of the record, come from covariance-driven stochastic subspace
identification by pyOMA2 (MIT licence; Peeters & De Roeck, MSSP 13, 1999; Döhler & Mevel, MSSP 38, 2013). Columns of
its stabilisation chart are modes where some channel shows them. Shapes over all channels are the residues of the
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
from scipy.linalg import qr
from scipy.signal import decimate, detrend

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
    read_channels,
)
from twin.measure.hdf5 import Node, opened
from twin.measure.modal import HELD_DAMPING, HELD_FREQUENCY, MAX_REFERENCES, ModalResult, Mode
from twin.measure.modal_choice import VISIBLE
from twin.measure.poles import Poles
from twin.measure.shapes import mac, mpc, real_phase
from twin.measure.spectra import USABLE
from twin.measure.stabilisation import DAMPING_RANGE, Chart, chart, clusters, column_share
from twin.measure.uff import read_uff_responses

MOST_OUTPUTS = 8  # of which poles are identified; shapes are of all
MOST_ORDER = 40  # deviations of a higher order cost minutes
MOST_LAGS, FEWEST_LAGS = 30, 12  # block rows of the Hankel matrix
SEGMENTS, FEWEST_SEGMENTS = 40, 10  # of the record, whose scatter gives deviations
SEGMENT_LAGS = 20  # block rows that a segment is long at least
HALF_SPECTRUM = 4096, 8  # most lags of a half-spectrum, and parts of a record that one is at most
AROUND = 8  # lines on either side of a mode, from whose median the noise there is told
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
            q_deg = np.atleast_1d(np.asarray(node.item.attrs.get("q_deg", []), dtype=np.float64))
            records[name] = Running(q_deg, running.real("response", "m/s^2"), rate)
        return read_channels(root.group("response")), root.text("robot") or None, (), records


def _check(source: Path, name: str, record: Running, channels: int) -> None:
    field = f"postures/{name}/running"
    if record.response.ndim != 2 or record.response.shape[0] != channels:
        raise InputError(
            source,
            f"{field}/response",
            f"expected shape ({channels}, any) = response, sample, found {record.response.shape}",
        )
    if not np.isfinite(record.response).all():
        raise InputError(source, f"{field}/response", "expected finite numbers, found NaN or infinity")
    if not (np.isfinite(record.sample_rate_hz) and record.sample_rate_hz > 0):
        raise InputError(source, f"{field}: sample_rate_hz", f"expected Hz above 0, found {record.sample_rate_hz:g}")
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
    scaled = y[live] / rms[live, None]
    pivot = live[qr(scaled.T, mode="r", pivoting=True, check_finite=False)[1]]
    outputs, references = pivot[:MOST_OUTPUTS], pivot[:MAX_REFERENCES]
    order = min(max_order, MOST_ORDER) // 2 * 2
    lags = int(np.clip(max(np.ceil(order / references.size) + 1, FEWEST_LAGS), FEWEST_LAGS, MOST_LAGS))
    if fmin is not None and fmin > 0:
        lags = int(np.clip(np.ceil(rate / (2 * fmin)), lags, MOST_LAGS))
    order = min(order, lags * references.size, (lags - 1) * outputs.size) // 2 * 2
    segments = min(SEGMENTS, (y.shape[1] - 2 * lags) // (SEGMENT_LAGS * lags))
    if segments < FEWEST_SEGMENTS:
        need = (FEWEST_SEGMENTS * SEGMENT_LAGS + 2) * lags / rate
        raise InputError(
            source, f"postures/{name}/running/response", f"expected {need:.3g} s or more, found {y.shape[1] / rate:.3g}"
        )
    low = rate / (2 * MOST_LAGS * SEGMENT_LAGS) if fmin is None else fmin
    poles, deviations = _subspace(y[outputs] / rms[outputs, None], references.size, 1 / rate, lags, order, segments)
    drawn = chart(poles)
    found = _columns(drawn, deviations, low, top)
    correlation = _correlations(y, references)
    s, spectra = _half_spectra(correlation, rate, low, top)
    found, residues, synthesised = _visible(found, correlation[: 2 * lags], s, spectra, rate)
    return ModalResult(
        name,
        record.q_deg,
        _modes(found, residues, drawn),
        s.imag / (2 * np.pi),
        spectra,
        synthesised,
        (drawn,),
        label,
        tuple(label[r] for r in references),
        operational=True,
    )


def _thinned(record: Running, top: float) -> tuple[FloatArray, float]:
    """Responses without their mean, at the lowest rate that a filter leaves right up to ``top`` Hz."""
    y, rate = detrend(record.response, axis=1, type="constant"), record.sample_rate_hz
    factor = int(rate / (USABLE * top))
    while factor > 1:
        step = min(factor, 10)
        y, rate, factor = decimate(y, step, ftype="fir", axis=1), rate / step, factor // step
    return y, rate


def _subspace(
    y: FloatArray, references: int, dt: float, lags: int, order: int, segments: int
) -> tuple[list[Poles], list[FloatArray]]:
    """Poles of every even order, and (n, 2) deviations of their frequencies in Hz and damping ratios."""
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
            observability, a, c, order, dt, xi_max=DAMPING_RANGE[1], calc_unc=True, H=hankel, T=scatter
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


def _columns(drawn: Chart, deviations: list[FloatArray], low: float, top: float) -> list[_Column]:
    """Columns of the chart within the band, each once, with the scatter over orders in their deviations."""
    found: list[_Column] = []
    for cluster in sorted(clusters(drawn), key=lambda c: -c.count):
        members = []
        for poles, deviation in zip(drawn.poles, deviations, strict=True):
            if poles.poles.size:
                n = int(np.argmin(np.abs(poles.poles - cluster.pole)))
                if abs(poles.poles[n] - cluster.pole) < -cluster.pole.real:
                    members.append((poles.shape[n], *deviation[n]))
        frequency = abs(cluster.pole) / (2 * np.pi)
        if not members or not low <= frequency <= top:
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


def _correlations(y: FloatArray, references: Any) -> FloatArray:
    """Correlations (lag, nr, ne) of all responses with the references at positive lags, (m/s²)²."""
    nt = y.shape[1]
    size = 2 ** int(np.ceil(np.log2(2 * nt)))
    whole = np.fft.rfft(y, size, axis=1)
    lags = min(HALF_SPECTRUM[0], nt // HALF_SPECTRUM[1])
    found = [np.fft.irfft(whole * whole[r].conj(), size, axis=1)[:, :lags].T / nt for r in references]
    return np.stack(found, axis=2)


def _half_spectra(correlation: FloatArray, rate: float, low: float, top: float) -> tuple[ComplexArray, ComplexArray]:
    """Laplace points (nf,) and half-spectra (nf, nr, ne) of correlations under an exponential window."""
    lags = correlation.shape[0]
    sigma = -np.log(LEFT_AT_END) * rate / lags
    window = np.exp(-sigma / rate * np.arange(lags))
    window[0] /= 2
    frequency = np.fft.rfftfreq(2 * lags, 1 / rate)
    inside = (frequency >= low) & (frequency <= top)
    spectra = np.fft.rfft(correlation * window[:, None, None], 2 * lags, axis=0)[inside] / rate
    return sigma + 2j * np.pi * frequency[inside], spectra


def _visible(
    found: list[_Column], correlation: FloatArray, s: ComplexArray, spectra: ComplexArray, rate: float
) -> tuple[list[_Column], ComplexArray, ComplexArray]:
    """Modes that some channel shows above what all of them leave over, residues (nm, nr, ne), synthesised spectra.

    Residues are fitted to the youngest ``correlation``, where a record of finite length errs least.
    """
    while True:
        poles, n = np.array([c.pole for c in found], dtype=complex), len(found)
        decay = np.exp(np.arange(1, len(correlation))[:, None] / rate * poles)
        terms = np.concatenate([decay.real, -decay.imag], axis=1)
        solution = np.linalg.lstsq(terms, correlation[1:].reshape(len(terms), -1), rcond=None)[0]
        residues = ((solution[:n] + 1j * solution[n:]) / 2).reshape(n, *spectra.shape[1:])
        p, c = (1 / (rate * (1 - np.exp((q - s[:, None]) / rate))) for q in (poles, poles.conj()))
        start = (correlation[0] / 2 - residues.real.sum(axis=0) * 2) / rate  # lag zero holds the noise of sensors
        synthesised = np.tensordot(p, residues, 1) + np.tensordot(c, residues.conj(), 1) + start
        if not n:
            return found, residues, synthesised
        left = np.abs(spectra - synthesised)
        line = np.argmin(np.abs(s.imag[:, None] - poles.imag), axis=0)
        around = [left[max(k - AROUND, 0) : k + AROUND + 1] for k in line]
        noise = np.stack([np.sqrt(np.median(part**2, axis=0) / np.log(2)) for part in around])
        own = np.abs(p[line, np.arange(n)])[:, None, None] * np.abs(residues)
        shown = np.max(own / np.where(noise > 0, noise, np.inf), axis=(1, 2))
        if shown.min() >= VISIBLE:
            return found, residues, synthesised
        found = [c for k, c in enumerate(found) if k != int(np.argmin(shown))]


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
