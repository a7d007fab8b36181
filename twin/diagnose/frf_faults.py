"""What is wrong with a hammer test itself: channels or blows in another unit or reversed, channels exchanged, too much
noise for what is stated, mains hum.

Channels are compared with those of the description. What counts is phase, averaged over all lines, and the median of
the ratio of sizes, so that the description's modes may be elsewhere. A fault that is found is put right, with a note.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from twin.diagnose.note import Note
from twin.diagnose.refit import Fitted
from twin.errors import tell
from twin.identify.objective import Objective, Sample
from twin.measure.campaign import Campaign, ComplexArray, FloatArray
from twin.measure.units import POUND_FORCE_N, STANDARD_GRAVITY
from twin.model.parameters import independent, require_springs
from twin.model.recorded import Recorded, prepare, without_limits
from twin.robot.description import Robot

UNITS = {"g": 1 / STANDARD_GRAVITY, "mm/s²": 1e3, "m/s² per lbf": POUND_FORCE_N}
"""What FRFs in other units are over those in m/s² per newton."""
OF_FORCE = ("m/s² per lbf",)  # a unit of the hammer, which all channels share
FORCES = {"lbf": POUND_FORCE_N, "kgf": STANDARD_GRAVITY}
"""What FRFs of blows whose force has another unit are over those per newton."""
IN_PHASE = 0.5  # mean cosine of the phase between a channel and the one it is; of robots as described 0.5 to 0.95
NEARLY_ALL = 0.8  # of the blows must be as described for the others to be faults; by eye
NEAR_UNIT = 0.5  # in ln size: so near a unit's factor a channel is in that unit

ROUGH = 4.0  # times the stated variance: rougher FRFs have more noise than stated; sound ones came to 2.3 at most
NOISY = 3.0  # times, from the smoothest tenth of lines to the median: above, it is resonances and no noise

MAINS_HZ = (50.0, 60.0)
TONE = 4.0  # times the residual around a tone; of noise alone, averaged over channels, neighbouring lines come to 2
BY_CHANCE = 1e-3  # probability that residuals peak at a multiple of the mains in every posture by chance


def put_right(campaign: Campaign, robot: Robot, source: str) -> tuple[Campaign, list[Note]]:
    """A campaign without the faults that are found in it, and a note on each.

    Args:
        robot: the description, its limits taken off.
        source: the file, for messages.
    """
    phase, size = _alike(campaign, robot, source)
    labels = campaign.response.label
    order, sign = _order(phase)
    notes = []
    if moved := np.flatnonzero(order != np.arange(len(order))).tolist():
        told = ", ".join(f"{labels[k]} has what is recorded as {labels[order[k]]}" for k in moved)
        text = f"sensor channels are exchanged: {told}; they were put in order"
        notes.append(Note(text, "swapped_channels", "fail", tuple(labels[k] for k in moved)))
    if turned := [labels[k] for k in np.flatnonzero(sign < 0)]:
        text = f"{', '.join(turned)} is recorded with the opposite sign; it was turned round"
        notes.append(Note(text, "reversed_channel", "fail", tuple(turned)))
    factor = np.ones(len(order))
    for unit, times in UNITS.items():
        off = np.array([size[order[k], k] for k in range(len(order))]) - np.log(times)
        clear = np.array([abs(phase[order[k], k]) > IN_PHASE for k in range(len(order))])
        near = np.abs(off) < NEAR_UNIT  # channels share their unit: one that is plain speaks for those alike in size
        inside = [int(k) for k in np.flatnonzero(near)] if np.any(clear & near) else []
        if inside and (unit not in OF_FORCE or len(inside) == len(order)):
            factor[inside] = times
            of = tuple(labels[k] for k in inside)
            text = f"recorded in {unit}, it seems: {', '.join(of)}; FRFs are {times:.4g} times those in m/s² per newton"
            notes.append(Note(f"{text}; they were divided by that", "unit", "fail", of))
    postures = {}
    for name, posture in campaign.postures.items():
        frf = (sign / factor)[:, None] * posture.frf[:, order]
        coherence = None if posture.coherence is None else posture.coherence[:, order]
        postures[name] = replace(posture, frf=frf, coherence=coherence, hits=None)
    campaign = replace(campaign, postures=postures) if notes else campaign
    campaign, of_blows = _with_blows(campaign, robot, source)
    return campaign, [*notes, *of_blows]


def _with_blows(campaign: Campaign, robot: Robot, source: str) -> tuple[Campaign, list[Note]]:
    """A campaign with blows put right that were struck the other way, or whose force has a unit of its own.

    A blow that the described robot hardly answers says nothing: neither its phase nor its size is clear. If many blows
    are answered otherwise, or some by other factors, the robot is not as described, and no blow is blamed.
    """
    pairs, labels = _compared(campaign, robot, source), campaign.excitation.label
    phase, size = np.array([_likeness(pairs, np.s_[:, :, k], np.s_[:, :, k]) for k in range(len(labels))]).T
    clear, turned_round, notes = np.abs(phase) > IN_PHASE, phase < -IN_PHASE, []
    few = turned_round.sum() < (1 - NEARLY_ALL) * clear.sum()
    factor = np.where(turned_round & few, -1.0, 1.0)
    if turned := [labels[k] for k in np.flatnonzero(factor < 0)]:
        text = f"{', '.join(turned)}: the blow was struck the other way; its FRFs were turned round"
        notes.append(Note(text, "reversed_channel", "fail", tuple(turned)))
    off = size - np.median(size[clear]) if clear.any() else size
    away = np.abs(off - np.log([*FORCES.values()])[:, None])
    as_others = clear & (np.abs(off) < NEAR_UNIT)
    odd = [clear & (away.argmin(axis=0) == number) & (away[number] < NEAR_UNIT) for number in range(len(FORCES))]
    plain = bool((as_others | np.any(odd, axis=0))[clear].all()) and as_others.sum() > NEARLY_ALL * clear.sum()
    for inside, (unit, times) in zip(odd, FORCES.items(), strict=True):
        if inside.any() and plain:  # else the robot is not as described, and answers some blows more than others
            factor[inside] /= times
            of = tuple(labels[k] for k in np.flatnonzero(inside))
            text = f"the force of {', '.join(of)} is recorded in {unit}, it seems: FRFs are {times:.4g} times those of"
            notes.append(Note(f"{text} the other blows; they were divided by that", "unit", "fail", of))
    if not notes:
        return campaign, []
    postures = {name: replace(p, frf=p.frf * factor, hits=None) for name, p in campaign.postures.items()}
    return replace(campaign, postures=postures), notes


def sound(campaign: Campaign, robot: Robot, source: str) -> Campaign:
    """A campaign without the faults that are found in it; each is told as a warning. Arguments of :func:`put_right`."""
    require_springs(robot)
    campaign, notes = put_right(campaign, without_limits(robot), source)
    for note in notes:
        tell(source, "channels", note)
    return campaign


def _alike(campaign: Campaign, robot: Robot, source: str) -> tuple[FloatArray, FloatArray]:
    """:func:`_likeness` of recorded and described channels, (nr, nr) both."""
    pairs, channels = _compared(campaign, robot, source), range(len(campaign.response.label))
    both = np.array([[_likeness(pairs, np.s_[:, i], np.s_[:, k]) for k in channels] for i in channels])
    return both[..., 0], both[..., 1]


def _compared(campaign: Campaign, robot: Robot, source: str) -> list[tuple[Recorded, ComplexArray]]:
    """Every recording with the FRFs (nf, nr, ne) of the robot as described."""
    recordings = tuple(prepare(campaign, robot, source).values())
    model = Objective(robot, independent([]), Sample(recordings)).predicted(np.zeros(0))
    return list(zip(recordings, model, strict=True))


def _likeness(pairs: Iterable[tuple[Recorded, ComplexArray]], seen: Any, described: Any) -> tuple[float, float]:
    """Mean cosine of the phase between some recorded FRFs and some described ones, and the median of ln |H|/|Ĥ|.

    Both are zero where nothing is recorded.
    """
    cosine, ratio = [], []
    for r, model in pairs:
        H, as_described = r.frf[seen], model[described]
        both = np.abs(H) * np.abs(as_described)
        some = np.isfinite(r.variance[seen]) & (both > 0)
        cosine.append(np.real(H * np.conj(as_described))[some] / both[some])
        ratio.append(np.log(np.abs(H)[some] / np.abs(as_described)[some]))
    if not sum(part.size for part in cosine):
        return 0.0, 0.0
    return float(np.concatenate(cosine).mean()), float(np.median(np.concatenate(ratio)))


def _order(phase: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Which recorded channel (nr,) is each described one, and its sign (nr,)."""
    n = len(phase)
    order, sign = np.arange(n), np.ones(n)
    recorded, described = linear_sum_assignment(-np.abs(phase))
    order[described] = recorded
    moved = np.flatnonzero(order != np.arange(n))
    as_it_is = np.where(phase < -IN_PHASE, -phase, phase)  # out of phase, but not by a sign: no such channel
    there, here = (
        float(some.mean()) if moved.size else 0.0
        for some in (np.abs(phase[order[moved], moved]), as_it_is[moved, moved])
    )
    if there < IN_PHASE or here > 0.5 * there:  # one channel alone may be out of phase: its modes are elsewhere
        order = np.arange(n)
    sign[[k for k in range(n) if phase[order[k], k] < -IN_PHASE]] = -1.0
    return order, sign


def understated(recordings: Iterable[Recorded]) -> float:
    """How many times larger the variance of the noise is than stated; 1 where that is not plain.

    The third difference of four neighbouring lines leaves little of a smooth FRF, and of noise the sum of 1, 9, 9 and 1
    times its variance. |d|² over that is exponentially distributed: its quantiles tell noise, which is everywhere, from
    resonances, which are not. A scale from the quantile p of n of them is known to √(p/(1 − p)/n)/−ln(1 − p). Two such
    deviations are added: noise that is thought too small passes for something missing.
    """
    parts = []
    for r in recordings:
        d = r.frf[:-3] - 3 * r.frf[1:-2] + 3 * r.frf[2:-1] - r.frf[3:]
        expected = 2 * (r.variance[:-3] + 9 * r.variance[1:-2] + 9 * r.variance[2:-1] + r.variance[3:])
        some = np.isfinite(expected)
        parts.append(np.abs(d[some]) ** 2 / expected[some])
    ratio = np.concatenate(parts) if parts else np.zeros(0)
    if not ratio.size:
        return 1.0
    few = 0.1
    smooth, middle = np.quantile(ratio, [few, 0.5]) / -np.log1p(-np.array([few, 0.5]))
    doubt = np.sqrt(few / (1 - few) / (ratio.size / 4)) / -np.log1p(-few)  # four differences share a line
    return float(smooth * (1 + 2 * doubt)) if smooth > ROUGH and middle < NOISY * smooth else 1.0


def without_hum(campaign: Campaign, fit: Fitted, sample: Sample) -> tuple[Campaign, list[Note]]:
    """A campaign without the lines that mains hum into, and a note on each tone.

    What the best fit leaves peaks at one multiple of the mains' frequency in every posture, where modes move.
    """
    hummed = _tones(fit, sample)
    notes = [
        Note(
            f"the residual of the FRFs has a peak at {tone:g} Hz in all postures used, wherever their modes are. That "
            f"is mains hum; lines within {reach:.3g} Hz of it were left out",
            "hum",
            "fail",
        )
        for tone, reach in hummed
    ]
    if not hummed:
        return campaign, notes
    postures = {}
    for name, posture in campaign.postures.items():
        keep = np.all([np.abs(posture.frequency - tone) > reach for tone, reach in hummed], axis=0)
        coherence = None if posture.coherence is None else posture.coherence[keep]
        postures[name] = replace(posture, frequency=posture.frequency[keep], frf=posture.frf[keep], coherence=coherence)
    return replace(campaign, postures=postures), notes


def _tones(fit: Fitted, sample: Sample) -> list[tuple[float, float]]:
    """Multiples of the mains' frequency that hum, and how far each reaches, Hz."""
    objective = Objective(fit.robot, fit.parameters, sample)
    residual, at, left = objective.residual(fit.z), 0, []
    for w in objective.weight:
        part = residual[2 * at : 2 * (at + w.size)].view(complex).reshape(w.shape)
        at += w.size
        left.append((np.abs(part) ** 2).sum(axis=(1, 2)))
    top = max(float(r.frequency[-1]) for r in sample.recordings)
    tones = [mains * k for mains in MAINS_HZ for k in range(1, int(top / mains) + 1)]
    found = []
    for tone in tones:
        seen = [_tone(r, energy, tone) for r, energy in zip(sample.recordings, left, strict=True)]
        chance = len(tones) * float(np.prod([chance for chance, _ in seen]))
        if chance < BY_CHANCE:
            found.append((tone, max(reach for _, reach in seen)))
    return found


def _tone(r: Recorded, energy: FloatArray, tone: float) -> tuple[float, float]:
    """Probability that a residual's energy (nf,) peaks at a tone by chance, one where it does not; its reach, Hz.

    A window of rate σ spreads a tone as 1/(1 + (2πΔf/σ)²). It reaches to where that adds a tenth to the median.
    """
    spacing, rate = float(np.median(np.diff(r.frequency))), float(r.s[0].real)
    around = np.abs(r.frequency - tone) <= 3 * max(spacing, rate) + spacing
    near = np.abs(r.frequency - tone) <= spacing
    if not near.any() or energy[near].max() <= max(
        TONE * float(np.median(energy[around])), energy[around & ~near].max()
    ):
        return 1.0, 0.0
    times = float(energy[near].max() / max(np.median(energy), np.finfo(float).tiny))
    return float(near.sum() / around.sum()), max(spacing, rate / (2 * np.pi) * float(np.sqrt(10 * times)))
