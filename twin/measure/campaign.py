"""Hammer tests on disk: the ``frf-campaign`` HDF5 file, its checks, and the variance its coherence implies.

A campaign is one set of response and excitation channels measured in one or several postures. Time dependence
is e^{+iωt}; every frequency response function (FRF) is SI per newton. What the file may hold is checked by
:func:`check_campaign`, once, whichever format it came from.
"""

import hashlib
import re
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.errors import InputError, tell
from twin.measure.hdf5 import Node, created, opened
from twin.ranges import (
    FARTHEST_M,
    FASTEST_HZ,
    FREE_TURNS,
    LARGEST_FORCE_N,
    LEAST_FORCE_N,
    LONGEST_LABEL,
    NODE_APART_M,
    ill_named,
    implausible,
)

FORMAT, VERSION = "frf-campaign", 1

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
Quantity = Literal["receptance", "mobility", "accelerance"]
Brakes = Literal["on", "off"]

QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)  # the index is the power of s = iω over receptance
UNITS: dict[str, str] = {"receptance": "m/N", "mobility": "(m/s)/N", "accelerance": "(m/s^2)/N"}
LABEL = re.compile(r"([0-9]+)([XYZ])([+-])")

VARIANCE_FLOOR_QUANTILE = 0.3
SENSOR_FLOOR = 1e-4  # of the median RMS accelerance of all channels: amplitude a sensor cannot resolve
ACCELERANCE = (1e-10, 1e6)  # m/s² per newton at the highest peak: a thousandth of a building, and a gram that rings
LEAST_COHERENCE = 1e-6  # less is none
MOST_PADDING = 100  # times as long as its record may a record have been made by zeros
MOST_AVERAGES = 100_000  # blows, or records of a shaker
LONGEST_PULSE_S, LONGEST_RECORD_S = 10.0, 1e5
LARGEST_SHOCK = 1e7  # m/s²: the range of the stiffest shock sensors is ten times less
OTHER = 100.0  # times: so far apart are no FRFs of one test
SILENT = 1e-9  # m/s²: a thousandth of what the quietest seismic sensors resolve
FASTEST_SAMPLES_HZ = 1e7
BACKWARD = 4.0  # standard deviations; noise alone is beyond in 3 of 100 000 recordings
DEAD_CHANNEL = 1e-6  # of the same: a channel below it carries no signal


@dataclass(frozen=True)
class Channels:
    """Where and in which direction something was measured or hit, n channels.

    Attributes:
        label: node number, axis, sign, e.g. ``21Z+``.
        body: body each point is fixed to.
        position: (n, 3) in m, in that body's frame.
        direction: (n, 3) unit vectors in that body's frame; they carry the sign of the label.
    """

    label: tuple[str, ...]
    body: tuple[str, ...]
    position: FloatArray
    direction: FloatArray

    def only(self, rows: Sequence[int]) -> "Channels":
        """Some of them."""
        label, body = (tuple(names[k] for k in rows) for names in (self.label, self.body))
        return Channels(label, body, self.position[list(rows)], self.direction[list(rows)])


@dataclass(frozen=True)
class Hits:
    """Time records of ne excitations with nh hits each, nt samples, seen by nr sensors.

    Attributes:
        force: (ne, nh, nt) in N.
        response: (ne, nh, nr, nt) in m/s².
        pretrigger_s: time before the trigger in every record.
        windowed: the records already carry their windows.
        exponential_window_rate: rate in 1/s of the exponential window they carry (0: none).
    """

    force: FloatArray
    response: FloatArray
    sample_rate_hz: float
    pretrigger_s: float = 0.0
    windowed: bool = False
    exponential_window_rate: float = 0.0


@dataclass(frozen=True)
class PostureFRF:
    """FRFs of one posture at one force level.

    Attributes:
        q_deg: (n,) axis positions, degrees for revolute and metres for prismatic axes; empty where the recording has
            none, as of a structure that is no robot.
        brakes: ``"on"``, ``"off"`` or ``None`` where unknown.
        frequency: (nf,) in Hz, evenly spaced.
        frf: (nf, nr, ne), SI per newton.
        coherence: (nf, nr, ne) ordinary coherence γ², ``averages`` hits per average.
        peak_force_n: of the blows, the force level; ``None`` where unknown.
        exponential_window_rate: rate in 1/s of a window still in the FRFs: they are H(s) on s = rate + iω.
        pulse_s, record_s: length of the blow and of the record, ``None`` where unknown. Lines may have been thinned:
            one over their spacing is a lower bound of the record.
    """

    name: str
    q_deg: FloatArray
    brakes: Brakes | None
    frequency: FloatArray
    frf: ComplexArray
    quantity: Quantity
    coherence: FloatArray | None = None
    averages: int | None = None
    peak_force_n: float | None = None
    exponential_window_rate: float = 0.0
    hits: Hits | None = None
    pulse_s: float | None = None
    record_s: float | None = None

    def __repr__(self) -> str:
        """One line: the arrays are long."""
        parts = [f"q = {', '.join(f'{q:.4g}' for q in self.q_deg)}"] if len(self.q_deg) else []
        parts += [f"brakes {self.brakes}"] if self.brakes else []
        parts += [self.quantity, f"{len(self.frequency)} lines"]
        parts[-1] += f" from {self.frequency[0]:.4g} to {self.frequency[-1]:.4g} Hz" if len(self.frequency) else ""
        parts += [f"{self.averages} averages"] if self.averages else []
        parts += [f"{self.peak_force_n:.3g} N"] if self.peak_force_n else []
        return f"{self.name}: {'; '.join([*parts, *(['raw hits'] if self.hits else [])])}"


@dataclass(frozen=True)
class Campaign:
    """One hammer test: channels and the postures they were measured in, by group name.

    ``source`` is for messages. ``lines`` are polylines over node numbers that draw the structure, where the recording
    holds some.
    """

    response: Channels
    excitation: Channels
    postures: dict[str, PostureFRF]
    robot: str | None = None
    comment: str = ""
    source: str = "hammer test"
    lines: tuple[tuple[int, ...], ...] = ()

    def __repr__(self) -> str:
        """One line per posture."""
        channels = f"{len(self.response.label)} responses × {len(self.excitation.label)} excitations"
        head = f"hammer test {self.source}{f' of {self.robot}' if self.robot else ''}: {channels}"
        return "\n  ".join([head, *map(repr, self.postures.values())])

    def pair(self, response: int, excitation: int) -> str:
        """Name of a channel pair, as in ``21Z+/4Y+``."""
        return f"{self.response.label[response]}/{self.excitation.label[excitation]}"


# --- quantities and variance --------------------------------------------------------------------------------


def laplace(frequency: ArrayLike, exponential_window_rate: float = 0.0) -> ComplexArray:
    """s = rate + iω, the line on which FRFs of exponentially windowed signals sample H(s)."""
    return np.asarray(exponential_window_rate + 2j * np.pi * np.asarray(frequency), dtype=np.complex128)


def convert(
    frf: ComplexArray,
    frequency: FloatArray,
    source: Quantity,
    target: Quantity,
    exponential_window_rate: float = 0.0,
) -> ComplexArray:
    """FRFs (nf, …) of quantity ``source`` as ``target``: multiplied by the difference in powers of s.

    Integrating has no value at s = 0; such a line becomes NaN.
    """
    power = QUANTITIES.index(target) - QUANTITIES.index(source)
    if power == 0:
        return frf
    s = laplace(frequency, exponential_window_rate)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(s == 0, np.nan if power < 0 else 0, s**power)
    return frf * factor.reshape(-1, *[1] * (frf.ndim - 1))


def as_quantity(posture: PostureFRF, target: Quantity) -> PostureFRF:
    """The same posture with its FRFs given as ``target`` (see :func:`convert`)."""
    frf = convert(posture.frf, posture.frequency, posture.quantity, target, posture.exponential_window_rate)
    return replace(posture, frf=frf, quantity=target)


def _accelerance(posture: PostureFRF) -> ComplexArray:
    return as_quantity(posture, "accelerance").frf


def dead_channels(posture: PostureFRF) -> BoolArray:
    """(nr, ne) mask of channel pairs without signal: an unplugged sensor, a direction nothing moves in."""
    rms = np.sqrt(np.mean(np.abs(_accelerance(posture)) ** 2, axis=0))
    live = rms[rms > 0]
    return rms <= DEAD_CHANNEL * (np.median(live) if live.size else 1.0)


def frf_variance(posture: PostureFRF) -> FloatArray | None:
    """Variance (nf, nr, ne) of the real, and of the imaginary, part of every line, in the unit of ``frf`` squared.

    |H|² (1 − γ²) / (2 n γ²) from coherence γ² and n averages (Bendat & Piersol, Random Data, chapter 9). |H| near an
    antiresonance is noise itself and takes the estimate to zero with it. So the variance, as accelerance, is at least
    the channel's 30 % quantile and a sensor floor. It is infinite for dead channels. ``None`` where the recording holds
    no coherence over two averages or more.
    """
    if posture.coherence is None or posture.averages is None or posture.averages < 2:
        return None
    accelerance = _accelerance(posture)
    coherence = np.clip(posture.coherence, LEAST_COHERENCE, 1.0)
    variance = np.abs(accelerance) ** 2 * (1 - coherence) / (2 * posture.averages * coherence)
    dead = dead_channels(posture)
    rms = np.sqrt(np.mean(np.abs(accelerance) ** 2, axis=0))
    sensor = (SENSOR_FLOOR * np.median(rms[~dead])) ** 2 if not dead.all() else 0.0
    variance = np.maximum(variance, np.maximum(np.quantile(variance, VARIANCE_FLOOR_QUANTILE, axis=0), sensor))
    power = QUANTITIES.index(posture.quantity) - QUANTITIES.index("accelerance")
    s = np.abs(laplace(posture.frequency, posture.exponential_window_rate))
    with np.errstate(divide="ignore"):
        variance = variance * (s[:, None, None] ** (2 * power))
    variance[:, dead] = np.inf
    return variance


# --- checks -------------------------------------------------------------------------------------------------


def check_campaign(source: str | Path, campaign: Campaign) -> None:
    """Raise :class:`InputError` where a campaign breaks the contract of its format."""
    for side, channels in (("response", campaign.response), ("excitation", campaign.excitation)):
        check_channels(source, side, channels)
    if not campaign.postures:
        raise InputError(source, "postures", "expected at least one posture")
    axes = {posture.q_deg.size for posture in campaign.postures.values()}
    if len(axes) > 1:
        problem = f"q_deg must have one length in all postures, or be in none, found {sorted(axes)}"
        raise InputError(source, "postures", problem)
    for name, posture in campaign.postures.items():
        if wrong := ill_named(name):
            raise InputError(source, "postures", wrong)
        _check_posture(
            source, f"postures/{name}", posture, len(campaign.response.label), len(campaign.excitation.label)
        )
    if found := twice((name, _recorded(posture)) for name, posture in campaign.postures.items()):
        again, first = found
        problem = f"expected every posture once, the same recording is also there as {first!r}"
        raise InputError(source, f"postures/{again}", problem)


def _tell_nodes(source: str | Path, campaign: Campaign) -> None:
    """Tell where one node number stands for two places."""
    at: dict[str, tuple[str, FloatArray]] = {}
    for side, channels in (("response", campaign.response), ("excitation", campaign.excitation)):
        for label, body, position in zip(channels.label, channels.body, channels.position, strict=True):
            where, place = at.setdefault(label[:-2], (body, position))
            if where == body and (apart := float(np.linalg.norm(position - place))) <= NODE_APART_M:
                continue
            found = f"on {where} and {body}" if where != body else f"{apart:.3g} m apart"
            tell(source, f"{side}/position", f"expected node {label[:-2]} at one place, found it {found}")
            return


def forward(source: str | Path, campaign: Campaign) -> Campaign:
    """The campaign with e^{+iωt} where its FRFs are those of e^{−iωt}, which is told; otherwise as it is.

    The phase of a response that follows its blow falls with frequency: Σ Im(H_{k+1} H̄_k), which is minus the mean time
    of the impulse response's energy, is below zero. Where it is above zero, responses come before blows. Channels count
    alike. The sum is judged by its scatter, that of noise of which no line knows the next.
    """
    steps = [np.zeros(0)]
    for posture in campaign.postures.values():
        along = np.imag(posture.frf[1:] * posture.frf[:-1].conj())
        size = np.abs(posture.frf[1:] * posture.frf[:-1]).sum(axis=0)
        steps.append((along / np.where(size > 0, size, 1.0)).ravel())
    every = np.concatenate(steps)
    if every.sum() <= BACKWARD * np.linalg.norm(every) or not every.any():
        return campaign
    tell(source, "frf", "responses come before their blows, as with e^{−iωt}; expected e^{+iωt}: taken as conjugates")
    postures = {name: replace(one, frf=one.frf.conj()) for name, one in campaign.postures.items()}
    return replace(campaign, postures=postures)


def _recorded(posture: PostureFRF) -> tuple[object, ...]:
    stated = (posture.q_deg, posture.brakes, posture.quantity, posture.peak_force_n, posture.exponential_window_rate)
    return (*stated, posture.frequency, posture.frf, posture.hits and posture.hits.response)


def twice(parts: Iterable[tuple[str, Sequence[object]]]) -> tuple[str, str] | None:
    """Name of the first part that holds, bit for bit, what one before it holds, and the name of that.

    It would count twice, and intervals come out too narrow.
    """
    met: dict[bytes, str] = {}
    for name, values in parts:
        seen = hashlib.sha256()
        for value in values:
            plain = (
                np.ascontiguousarray(value).reshape(-1).view(np.uint8).data if isinstance(value, np.ndarray) else None
            )
            seen.update(repr(value).encode() if plain is None else plain)
        if (first := met.setdefault(seen.digest(), name)) != name:
            return name, first
    return None


def check_channels(source: str | Path, side: str, channels: Channels) -> None:
    """Raise :class:`InputError` where channels of one side, ``response`` or ``excitation``, break the contract."""
    n = len(channels.label)
    if n == 0:
        raise InputError(source, f"{side}/label", "expected at least one channel")
    for label in channels.label:
        if not LABEL.fullmatch(label) or len(label) > LONGEST_LABEL:
            found = reprlib.repr(label)
            raise InputError(source, f"{side}/label", f"expected node number, axis, sign such as 21Z+, found {found}")
    repeated = sorted({label for label in channels.label if channels.label.count(label) > 1})
    if repeated:
        raise InputError(source, f"{side}/label", f"labels must be unique, {repeated[0]} is there more than once")
    if len(channels.body) != n:
        raise InputError(source, f"{side}/body", f"expected one per label ({n}), found {len(channels.body)}")
    for field, array in (("position", channels.position), ("direction", channels.direction)):
        _check_array(source, f"{side}/{field}", array, (n, 3))
    far = np.abs(channels.position).max(axis=1)
    if far.max() > FARTHEST_M:
        text = f"{channels.label[int(far.argmax())]} is {far.max():.4g} m from its body's frame"
        raise InputError(source, f"{side}/position", f"{text}; expected metres, up to {FARTHEST_M:g}")
    length = np.linalg.norm(channels.direction, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1) > 1e-3)
    if wrong.size:
        raise InputError(
            source,
            f"{side}/direction",
            f"expected unit vectors, {channels.label[wrong[0]]} has length {length[wrong[0]]:.4g}",
        )


def _check_array(
    source: str | Path, field: str, array: NDArray[Any], shape: tuple[int | None, ...], names: str = ""
) -> None:
    """A None in ``shape`` leaves that axis open; ``names`` says what the axes are."""
    if len(array.shape) != len(shape) or any(
        want is not None and want != have for want, have in zip(shape, array.shape, strict=True)
    ):
        want = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(source, field, f"expected shape ({want}){' = ' + names if names else ''}, found {array.shape}")
    if array.size == 0:
        raise InputError(source, field, "expected data, found an empty array")
    if not np.isfinite(array).all():
        raise InputError(source, field, "expected finite numbers, found NaN or infinity")


def _check_posture(source: str | Path, field: str, posture: PostureFRF, nr: int, ne: int) -> None:
    check_q_deg(source, field, posture.q_deg)
    if posture.brakes not in (None, "on", "off"):
        raise InputError(source, f"{field}: brakes", f'expected "on" or "off", found {posture.brakes!r}')
    if posture.hits is not None:
        _check_hits(source, field, posture.hits, nr, ne)
        if posture.frf.size == 0:
            return
    nf = _check_axis(source, field, posture.frequency)
    if posture.quantity not in QUANTITIES:
        raise InputError(
            source,
            f"{field}/frf: quantity",
            f"expected one of {', '.join(QUANTITIES)}, found {posture.quantity!r}",
        )
    _check_array(source, f"{field}/frf", posture.frf, (nf, nr, ne), "frequency, response, excitation")
    if posture.coherence is not None:
        _check_array(source, f"{field}/coherence", posture.coherence, (nf, nr, ne), "frequency, response, excitation")
        low, high = posture.coherence.min(), posture.coherence.max()
        if high > 1 + 1e-6 or low < -1e-6:
            raise InputError(source, f"{field}/coherence", f"expected values from 0 to 1, found {low:g} to {high:g}")
        if high < LEAST_COHERENCE:
            raise InputError(
                source, f"{field}/coherence", "expected values above 0: of noise alone nothing can be said"
            )
    loudest = float(np.nanmax(np.abs(_accelerance(posture))))
    if loudest == 0:
        raise InputError(source, f"{field}/frf", "expected a response, every channel is zero")
    least, most = ACCELERANCE
    if not least <= loudest <= most:
        raise InputError(
            source, f"{field}/frf", f"expected a peak from {least:g} to {most:g} m/s² per newton, found {loudest:.3g}"
        )
    if posture.averages is not None and not 1 <= posture.averages <= MOST_AVERAGES:
        raise InputError(
            source,
            f"{field}/coherence: averages",
            f"expected 1 or more, up to {MOST_AVERAGES}, found {posture.averages}",
        )
    if posture.hits is not None and posture.averages is not None and posture.averages > posture.hits.force.shape[1]:
        problem = f"{posture.averages}, and {posture.hits.force.shape[1]} hits of each point are in the file"
        tell(source, f"{field}/coherence: averages", problem)
    if posture.peak_force_n is not None:
        _check_force(source, f"{field}: peak_force_n", posture.peak_force_n)
    _check_times(source, field, posture)
    if posture.hits is not None and posture.frequency[-1] > 0:
        _tell_other_hits(source, field, posture, posture.hits)
    _check_rate(source, field, posture.exponential_window_rate)


def _check_times(source: str | Path, field: str, posture: PostureFRF) -> None:
    """Length of the pulse and of the record, and the lines that records of such a length and rate can tell."""
    longest = {"pulse_s": LONGEST_PULSE_S, "record_s": LONGEST_RECORD_S}
    for name, most in longest.items():
        length = getattr(posture, name)
        if length is not None and not 1e-7 <= length <= most:
            raise InputError(source, f"{field}: {name}", f"expected seconds, above 0 to {most:g}, found {length:g}")
    if posture.pulse_s is not None and posture.record_s is not None and posture.pulse_s > posture.record_s:
        problem = f"expected a blow within its record of {posture.record_s:g} s, found {posture.pulse_s:g}"
        raise InputError(source, f"{field}: pulse_s", problem)
    spacing = float(np.diff(posture.frequency).mean())
    if posture.record_s is not None and spacing * posture.record_s * MOST_PADDING < 1:
        problem = f"expected lines as far apart as records of {posture.record_s:g} s tell, found {spacing:g} Hz"
        raise InputError(source, f"{field}/frequency", problem)
    if posture.hits is not None and posture.frequency[-1] > (1 + 1e-6) * posture.hits.sample_rate_hz / 2:
        problem = (
            f"expected twice the highest line ({posture.frequency[-1]:g} Hz), found {posture.hits.sample_rate_hz:g}"
        )
        raise InputError(source, f"{field}/hits: sample_rate_hz", problem)


def _tell_other_hits(source: str | Path, field: str, posture: PostureFRF, hits: Hits) -> None:
    """Tell of blows at the first point whose accelerance over the band is not that of the file by a factor OTHER."""
    force, response = np.fft.rfft(hits.force[0], axis=-1), np.fft.rfft(hits.response[0], axis=-1)
    frequency = np.fft.rfftfreq(hits.force.shape[2], 1 / hits.sample_rate_hz)
    band = (frequency >= posture.frequency[0]) & (frequency <= posture.frequency[-1]) & (frequency > 0)
    power = np.sum(np.abs(force[:, None, band]) ** 2)
    stated = float(np.sqrt(np.mean(np.abs(_accelerance(posture)[posture.frequency > 0, :, 0]) ** 2)))
    if not (band.any() and power > 0 and stated > 0):
        return
    seen = float(np.sqrt(np.sum(np.abs(response[..., band]) ** 2) / power / response.shape[1]))
    if not 1 / OTHER < seen / stated < OTHER:
        problem = f"make accelerances {seen / stated:.2g} times those of frf: is one of them in another unit?"
        tell(source, f"{field}/hits", problem)


def check_sample_rate(source: str | Path, field: str, rate: float) -> None:
    """Raise :class:`InputError` for a rate that nothing samples at."""
    if not 0 < rate <= FASTEST_SAMPLES_HZ:
        expected = f"expected Hz above 0, up to {FASTEST_SAMPLES_HZ:g}, found {rate:g}"
        raise InputError(source, f"{field}: sample_rate_hz", expected)


def _check_force(source: str | Path, field: str, peak: float) -> None:
    if not LEAST_FORCE_N <= peak <= LARGEST_FORCE_N:
        expected = f"expected newtons, {LEAST_FORCE_N:g} to {LARGEST_FORCE_N:g} at the peak of a blow, found {peak:.4g}"
        raise InputError(source, field, expected)


def _check_axis(source: str | Path, field: str, frequency: FloatArray) -> int:
    """Number of lines of an axis of frequencies (nf,), Hz."""
    _check_array(source, f"{field}/frequency", frequency, (None,))
    nf = frequency.size
    if nf < 2:
        raise InputError(source, f"{field}/frequency", f"expected at least two lines, found {nf}")
    if frequency[0] < 0:
        raise InputError(source, f"{field}/frequency", f"expected Hz from 0 upwards, found {frequency[0]:g}")
    if problem := implausible(float(frequency[-1]), "Hz", True):
        raise InputError(source, f"{field}/frequency", problem)
    if (highest := float(frequency[-1])) > FASTEST_HZ:
        raise InputError(source, f"{field}/frequency", f"expected lines up to {FASTEST_HZ:g} Hz, found {highest:g}")
    step = np.diff(frequency)
    if (step <= 0).any():
        raise InputError(source, f"{field}/frequency", "expected a strictly increasing axis, found it unsorted")
    # Readable files hold single-precision axes, whose steps scatter by 1e-7 of the highest frequency.
    if np.ptp(step) > 1e-3 * step.mean() + 1e-6 * frequency[-1]:
        raise InputError(
            source,
            f"{field}/frequency",
            f"expected even spacing, found steps {step.min():g} to {step.max():g} Hz",
        )
    return nf


def _check_hits(source: str | Path, field: str, hits: Hits, nr: int, ne: int) -> None:
    _check_array(source, f"{field}/hits/force", hits.force, (ne, None, None), "excitation, hit, sample")
    if not (hits.force != hits.force[..., :1]).any(axis=(1, 2)).all():
        raise InputError(source, f"{field}/hits/force", "expected blows at every point, some have no force at all")
    for peak in np.abs(hits.force).max(axis=(1, 2)):  # of every point: single blows may have failed
        _check_force(source, f"{field}/hits/force", float(peak))
    shape = (ne, hits.force.shape[1], nr, hits.force.shape[2])
    _check_array(source, f"{field}/hits/response", hits.response, shape, "excitation, hit, response, sample")
    if (shock := float(np.abs(hits.response).max())) < SILENT:
        raise InputError(source, f"{field}/hits/response", "expected motion after the blows, every record is silent")
    if shock > LARGEST_SHOCK:
        expected = f"expected m/s², up to {LARGEST_SHOCK:g}, found {shock:.4g}"
        raise InputError(source, f"{field}/hits/response", expected)
    check_sample_rate(source, f"{field}/hits", hits.sample_rate_hz)
    if not 0 <= hits.pretrigger_s < hits.force.shape[2] / hits.sample_rate_hz:
        raise InputError(
            source,
            f"{field}/hits: pretrigger_s",
            f"expected seconds within the record, found {hits.pretrigger_s:g}",
        )
    _check_rate(source, f"{field}/hits", hits.exponential_window_rate)


def _check_rate(source: str | Path, field: str, rate: float) -> None:
    if not (np.isfinite(rate) and rate >= 0):
        raise InputError(source, f"{field}: exponential_window_rate", f"expected 1/s from 0 upwards, found {rate:g}")
    if problem := implausible(rate, "1/s", True):
        raise InputError(source, f"{field}: exponential_window_rate", problem)


# --- HDF5 ---------------------------------------------------------------------------------------------------


def read_campaign(path: str | Path) -> Campaign:
    """Read and check an ``frf-campaign`` HDF5 file; :class:`InputError` says what it lacks."""
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "expected a file, there is none")
    with opened(path) as file:
        root = Node(path, file)
        if root.text("format") != FORMAT:
            raise InputError(path, "format", f'expected "{FORMAT}", found {root.text("format")!r}')
        if root.number("version") != VERSION:
            raise InputError(path, "version", f"expected {VERSION}, found {root.attribute('version')!r}")
        root.tell_unknown("response", "excitation", "postures")
        postures = root.group("postures")
        campaign = Campaign(
            response=read_channels(root.group("response")),
            excitation=read_channels(root.group("excitation")),
            postures={name: _read_posture(name, postures.group(name)) for name in postures.item},
            robot=root.text("robot") or None,
            comment=root.text("comment") or "",
            source=str(path),
        )
    check_campaign(path, campaign)
    _tell_nodes(path, campaign)
    return campaign


def read_channels(node: Node) -> Channels:
    """Channels of a group with ``label``, ``body``, ``position`` and ``direction``."""
    node.tell_unknown("label", "body", "position", "direction")
    return Channels(node.strings("label"), node.strings("body"), node.real("position", "m"), node.real("direction"))


def read_q_deg(node: Node) -> FloatArray:
    """Axis positions (n,) that a posture's group states; none where it does not."""
    try:
        found: FloatArray = np.atleast_1d(np.asarray(node.item.attrs.get("q_deg", []), dtype=np.float64))
    except (TypeError, ValueError, OSError):
        raise node.fail(f"{node.field}: q_deg", f"expected numbers, found {node.attribute('q_deg')!r}") from None
    return found


def check_q_deg(source: str | Path, field: str, q_deg: FloatArray) -> None:
    """Raise :class:`InputError` where axis positions (n,), if any, are none that an axis can take."""
    if not q_deg.size:
        return
    _check_array(source, f"{field}: q_deg", q_deg, (None,))
    if (most := float(np.abs(q_deg).max())) > 360 * FREE_TURNS:
        raise InputError(source, f"{field}: q_deg", f"expected degrees (m), up to {360 * FREE_TURNS}, found {most:g}")


def _read_posture(name: str, node: Node) -> PostureFRF:
    q_deg = read_q_deg(node)
    node.tell_unknown("frequency", "frf", "coherence", "hits", "running")
    hits = _read_hits(node.group("hits")) if node.has("hits") else None
    brakes: Any = node.attribute("brakes")
    brakes = None if isinstance(brakes, h5py.Empty) else brakes
    if hits is not None and not node.has("frf"):  # time records alone
        empty = np.zeros((0, hits.response.shape[2] if hits.response.ndim == 4 else 0, len(hits.force)))
        return PostureFRF(name, q_deg, brakes, np.zeros(0), empty.astype(complex), "accelerance", hits=hits)
    frf = node.dataset("frf")
    quantity: Any = frf.text("quantity")
    if quantity is None:
        raise node.fail(f"{frf.field}: quantity", f"expected one of {', '.join(QUANTITIES)}, the attribute is missing")
    if quantity in UNITS:
        for holder in (frf, node):
            holder.check_unit(UNITS[quantity])
    coherence, averages = None, node.number("averages")
    if node.has("coherence"):
        coherence = node.real("coherence")
        averages = node.dataset("coherence").number("averages", averages)
        if averages is None:
            tell(node.source, f"{node.field}/coherence: averages", "is missing: noise is not known from the coherence")
    if averages is not None and not averages.is_integer():
        raise node.fail(f"{node.field}/coherence: averages", f"expected a whole number, found {averages:g}")
    return PostureFRF(
        name=name,
        q_deg=q_deg,
        brakes=brakes,
        frequency=node.real("frequency", "Hz"),
        frf=frf.complex(),
        quantity=quantity,
        coherence=coherence,
        averages=None if averages is None else int(averages),
        peak_force_n=node.number("peak_force_n"),
        pulse_s=node.number("pulse_s"),
        record_s=node.number("record_s"),
        exponential_window_rate=node.number("exponential_window_rate") or 0.0,
        hits=hits,
    )


def _read_hits(node: Node) -> Hits:
    rate = node.number("sample_rate_hz")
    if rate is None:
        raise node.fail(f"{node.field}: sample_rate_hz", "expected Hz, the attribute is missing")
    node.tell_unknown("force", "response")
    if (windowed := node.number("windowed", 0.0)) not in (0.0, 1.0):
        raise node.fail(f"{node.field}: windowed", f"expected true or false, found {windowed:g}")
    return Hits(
        force=node.real("force", "N"),
        response=node.real("response", "m/s^2"),
        sample_rate_hz=rate,
        pretrigger_s=node.number("pretrigger_s") or 0.0,
        windowed=bool(windowed),
        exponential_window_rate=node.number("exponential_window_rate") or 0.0,
    )


def write_campaign(path: str | Path, campaign: Campaign) -> None:
    """Check a campaign and write it as ``frf-campaign`` HDF5; the file appears whole or not at all."""
    check_campaign(path, campaign)
    with created(path) as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, "comment": campaign.comment})
        if campaign.robot is not None:
            file.attrs["robot"] = campaign.robot
        for side, channels in (("response", campaign.response), ("excitation", campaign.excitation)):
            group = file.create_group(side)
            text = h5py.string_dtype()
            group.create_dataset("label", data=list(channels.label), dtype=text)
            group.create_dataset("body", data=list(channels.body), dtype=text)
            group.create_dataset("position", data=channels.position)
            group.create_dataset("direction", data=channels.direction)
        postures = file.create_group("postures", track_order=True)
        for name, posture in campaign.postures.items():
            _write_posture(postures.create_group(name), posture)


def _write_attributes(node: h5py.Group | h5py.Dataset, values: Mapping[str, Any]) -> None:
    node.attrs.update({name: value for name, value in values.items() if value is not None})


def _write_posture(group: h5py.Group, posture: PostureFRF) -> None:
    _write_attributes(
        group,
        {
            "q_deg": posture.q_deg if posture.q_deg.size else None,
            "brakes": posture.brakes,
            "peak_force_n": posture.peak_force_n,
            "pulse_s": posture.pulse_s,
            "record_s": posture.record_s,
            "exponential_window_rate": posture.exponential_window_rate,
        },
    )
    group.create_dataset("frequency", data=posture.frequency)
    frf = group.create_dataset("frf", data=posture.frf)
    frf.attrs.update({"quantity": posture.quantity, "unit": UNITS[posture.quantity]})
    if posture.coherence is not None:
        coherence = group.create_dataset("coherence", data=posture.coherence)
        _write_attributes(coherence, {"averages": posture.averages})
    if posture.hits is not None:
        hits = group.create_group("hits")
        hits.create_dataset("force", data=posture.hits.force)
        hits.create_dataset("response", data=posture.hits.response)
        _write_attributes(
            hits,
            {
                "sample_rate_hz": posture.hits.sample_rate_hz,
                "pretrigger_s": posture.hits.pretrigger_s,
                "windowed": posture.hits.windowed,
                "exponential_window_rate": posture.hits.exponential_window_rate,
            },
        )
