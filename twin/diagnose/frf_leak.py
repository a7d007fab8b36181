"""Records that end while the robot still rings: FRFs made again from raw hits, or models that leak as they do."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.note import Note
from twin.diagnose.refit import Fitted, descend
from twin.diagnose.search import REFIT_LINES
from twin.identify.objective import Objective, Sample
from twin.measure.blows import PULSE_S, record_length_s
from twin.measure.campaign import Campaign, FloatArray
from twin.measure.frf_noise import ANALYSER
from twin.measure.spectra import windowed_again
from twin.model.cut_off import CutOff, Leak, ringing, rings_most
from twin.model.leakage import leakage
from twin.model.recorded import Recorded
from twin.model.sensitivity import Observed, observe_all
from twin.robot.description import Robot

LEFT = 0.1  # of a mode's swing at the end of a record without a window: 10 % of it leak
MISSED = 1.2  # misfit of a fit that misses something
SLIGHT = ANALYSER  # of its swing: no FRF shows that so much of a mode is cut off
LEAST = 0.75  # of a record is after the blow, at least
TRIED_RAD = 0.5  # of the fastest mode that rings at the end, by which records are tried longer
SETTLED_SHARE = 0.01  # of the steps by which lengths of records and blows are found
LEAK_STEPS, QUARTERED = 6, 3  # of these, and trials of one, each a quarter of the last
INEXACT = 0.005  # of what records lack: blows differ in length by a tenth, and the mean of some by less
JITTER_S = 3e-4  # by which the middles of blows differ, whose lengths differ by a tenth
SPREAD = 0.218  # root of the second moment of a half-sine over its length
RESCANNED = 3  # times at most that the length of a record is looked for again beside a better model
EXPLAINED = 0.5  # of the misfit beyond noise that leakage has to explain: a model that is far off gains some by chance


def rewindowed(campaign: Campaign) -> tuple[Campaign, list[Note]]:
    """A campaign whose raw hits are windowed where its FRFs leak, and a note that says so."""
    again = {name: found for name, p in campaign.postures.items() if (found := windowed_again(name, p, SLIGHT))}
    if not again:
        return campaign, []
    text = (
        f"records end while the robot still rings, and the FRFs leak: they were made again from the raw hits under an "
        f"exponential window of {max(rate for _, rate in again.values()):.3g} 1/s"
    )
    postures = {**campaign.postures, **{name: made for name, (made, _) in again.items()}}
    return replace(campaign, postures=postures), [Note(text, "leakage", "fail")]


def cut_off(
    campaign: Campaign, base: Robot, fit: Fitted, sample: Sample, every: Sequence[Recorded]
) -> tuple[Leak, Fitted, list[Note]] | None:
    """How records leak that ended while modes rang, the model as fitted beside that, and a note.

    ``None`` where it does not explain most of what a fit misses.

    ``every`` recording leaks, those beside the sample too.

    A whole record is taken to be as long as stated, or as the spacing of its lines says. Where in it the blows are, and
    how long they are, is fitted: a mode's phase at the end tells the former to less than a millisecond.
    """
    described, fitted = (rings_most(robot, sample.recordings, campaign)[0] for robot in (base, fit.robot))
    if fit.misfit < MISSED or max(described, fitted) < SLIGHT:
        return None
    thin = sample.thin(REFIT_LINES)
    leaks = _lengths(fit, thin, campaign)
    starts = fit.z, np.zeros(len(fit.z))  # a model that does not leak may have come to rest far away
    tried = [(z, _likeliest(leaks, fit, z, thin, campaign)) for z in starts]
    missed = np.linalg.norm(Objective(fit.robot, fit.parameters, thin).residual(fit.z))
    if max(_size(fit, leaking(thin, campaign, leak), z) for z, leak in tried) < (1 - np.sqrt(1 - EXPLAINED)) * missed:
        return None  # however it leaks, too much would be left
    plain = descend(base, fit.hypothesis, fit.parameters, thin, fit.z, tempered=0)
    # the cost of a model that explains enough, as tense as the plain one
    enough = 0.5 * plain.data * (1 + (1 - EXPLAINED) * (plain.misfit - 1)) + 0.5 * float(plain.z @ plain.z)

    def at(z: FloatArray, leak: Leak) -> tuple[Fitted, Leak]:
        leaky = leaking(thin, campaign, leak)
        return descend(base, fit.hypothesis, fit.parameters, leaky, z, logarithmic=25, hopeless=enough), leak

    near, leak = min((at(*one) for one in tried), key=lambda one: one[0].cost)
    for _ in range(RESCANNED):  # the phase at the end was judged by a model that is better known now
        other = _likeliest(leaks, fit, near.z, thin, campaign)
        if other == leak or (again := at(near.z, other)[0]).cost >= near.cost:
            break
        near, leak = again, other
    if not _explains(near, plain):
        return None
    leak, better = refined(leak, campaign, base, near, sample, every)
    if plain.cost - better.cost < calibration()["seen"]:
        return None
    left, group, frequency_hz = rings_most(better.robot, sample.recordings, campaign)
    text = (
        f"{group}: the mode near {frequency_hz:.3g} Hz still has {left:.0%} of its amplitude at the end of a record of "
        f"{record_length_s(campaign.postures[group]):.3g} s. The FRFs contain leakage, and the model was given the "
        "same leakage. Put an exponential window on the records and state it, or record longer"
    )
    return leak, better, [Note(text, "leakage", "fail")]


def refined(
    leak: Leak, campaign: Campaign, base: Robot, fit: Fitted, sample: Sample, every: Sequence[Recorded]
) -> tuple[Leak, Fitted]:
    """The leak of least cost near another, the model fitted again at every one; and that fit, to fewer lines."""
    thin = sample.thin(REFIT_LINES)

    def fitted(how: Leak, z: FloatArray) -> Fitted:
        return descend(base, fit.hypothesis, fit.parameters, leaking(thin, campaign, how), z, tempered=0)

    better = fitted(leak, fit.z)
    reach = np.array([TRIED_RAD / _longest(campaign) / _fastest(thin), 0.5 * leak.spread_s])
    for _ in range(LEAK_STEPS):
        step = np.clip(_step(lambda how: leaking(thin, campaign, how), leak, better, base, reach), -reach, reach)
        for _ in range(QUARTERED):
            found = _moved(leak, step)
            if (again := fitted(found, better.z)).cost < better.cost:
                break
            step = step / 4
        else:
            break
        leak, better = found, again
        if np.max(np.abs(step) / reach) < SETTLED_SHARE:
            break
    for _ in range(2):
        leak = replace(leak, earlier=_earlier(leaking(Sample(tuple(every)), campaign, leak), better))
        better = fitted(leak, better.z)
    known = replace(leak, variance={})  # of the recordings themselves
    return replace(leak, variance=_doubted(leaking(Sample(tuple(every)), campaign, known), better)), better


def _lengths(fit: Fitted, thin: Sample, campaign: Campaign) -> list[Leak]:
    """Leaks of records cut off at many instants, closer to each other than the fastest ringing mode turns."""
    rates = [rate for left, _, rate in ringing(fit.robot, thin.recordings, campaign) if left > SLIGHT]
    longest, fastest = _longest(campaign), max(rates, default=_fastest(thin))
    usual = SPREAD * max([p.pulse_s for p in campaign.postures.values() if p.pulse_s] or [PULSE_S])
    return [Leak(x, usual) for x in np.linspace(LEAST, 1.0, int((1 - LEAST) * longest * fastest / TRIED_RAD) + 2)]


def _likeliest(leaks: Sequence[Leak], fit: Fitted, z: FloatArray, thin: Sample, campaign: Campaign) -> Leak:
    """Of some leaks the one under which the model at z fits best."""
    objective = Objective(fit.robot, fit.parameters, thin, logarithmic=True)
    whole, seen = objective.predicted(z), _seen(fit, z, thin)

    def cost(leak: Leak) -> float:
        leaky = (CutOff.of(r, campaign.postures[r.group], leak) for r in thin.recordings)
        lacks = (r.lacks(one) for r, one in zip(leaky, seen, strict=True))
        return objective.loss([H - lack for H, lack in zip(whole, lacks, strict=True)])

    return min(leaks, key=cost)


def _seen(fit: Fitted, z: FloatArray, sample: Sample) -> list[Observed]:
    """The models of recordings at z."""
    values = fit.parameters.values(z)
    robot = fit.parameters.apply(fit.robot, values)
    return [one for one, _ in observe_all(robot, [r.setup for r in sample.recordings], fit.parameters, values)]


def _size(fit: Fitted, leaky: Sample, z: FloatArray) -> float:
    """Root of the sum of the squares of what records lack of the model at z, in deviations of noise."""
    weight = Objective(fit.robot, fit.parameters, leaky).weight
    lacking = zip(leaky.recordings, weight, _seen(fit, z, leaky), strict=True)
    parts = [w * r.lacks(one) for r, w, one in lacking if isinstance(r, CutOff)]
    return float(np.sqrt(sum(np.sum(np.abs(part) ** 2) for part in parts)))


def _earlier(some: Sample, fit: Fitted) -> dict[str, FloatArray]:
    """By how many s the blows on every point came earlier in the record, as what a fit leaves says, by group."""
    objective = Objective(fit.robot, fit.parameters, some)
    seen = observe_all(fit.robot, [r.setup for r in some.recordings], fit.parameters, fit.values)
    found = {}
    for r, H, (one, _) in zip(some.recordings, objective.predicted(fit.z), seen, strict=True):
        assert isinstance(r, CutOff)
        column = r.later(one)
        along = np.sum((column.conj() * (H - r.frf)).real / r.variance, axis=(0, 1))
        found[r.group] = r.earlier_s + along / (np.sum(np.abs(column) ** 2 / r.variance, axis=(0, 1)) + 1 / JITTER_S**2)
    return found


def _longest(campaign: Campaign) -> float:
    """Length of the longest record, s."""
    return max(record_length_s(posture) for posture in campaign.postures.values())


def _fastest(sample: Sample) -> float:
    """The highest line, rad/s."""
    return max(float(np.abs(r.s[-1])) for r in sample.recordings)


def _step(leaking_as: Callable[[Leak], Sample], leak: Leak, fit: Fitted, base: Robot, reach: FloatArray) -> FloatArray:
    """Gauss–Newton step (2,) of a leak's ``share`` and ``spread_s`` with all numbers of a fit following.

    Variable projection (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973); at a fit's optimum the gradient is that of
    the residual alone. Derivatives by central differences over a hundredth of ``reach``.
    """
    robot = fit.hypothesis.robot(base)

    def objective(how: Leak) -> Objective:
        return Objective(robot, fit.parameters, leaking_as(how))

    residual, J = objective(leak).jacobian(fit.z)
    columns = []
    for h in np.diag(0.01 * reach):
        high, low = (objective(_moved(leak, side * h)).residual(fit.z) for side in (1, -1))
        columns.append((high - low) / (2 * h.sum()))
    own = np.stack(columns, axis=1)
    if not (np.isfinite(own).all() and np.isfinite(J).all()):  # a model with a mode that grows leaks without end
        return np.zeros(2)
    across = J @ own
    information = own.T @ own - across.T @ np.linalg.solve(J @ J.T + np.eye(len(J)), across)
    return -np.asarray(np.linalg.lstsq(information, own.T @ residual)[0])  # a model may leak nothing


def _moved(leak: Leak, step: FloatArray) -> Leak:
    return replace(leak, share=leak.share + float(step[0]), spread_s=leak.spread_s + float(step[1]))


def _explains(leaky: Fitted, plain: Fitted) -> bool:
    """Whether leakage explains enough of what a fit misses beyond noise."""
    return leaky.misfit - 1 < (1 - EXPLAINED) * (plain.misfit - 1)


def leaking(sample: Sample, campaign: Campaign, how: Leak) -> Sample:
    """Recordings whose records end while modes ring."""
    leaky = tuple(CutOff.of(r, campaign.postures[r.group], how) for r in sample.recordings)
    return Sample(leaky, sample.repeat)


def _doubted(sample: Sample, fit: Fitted) -> dict[str, FloatArray]:
    """The variance (nf, nr, ne) of leaking recordings with what the model of a fit may be off by, by group.

    Blows differ in length: ``INEXACT`` of what records lack is not as it says.
    """
    seen = observe_all(fit.robot, [r.setup for r in sample.recordings], fit.parameters, fit.values)
    found = {}
    for r, (one, _) in zip(sample.recordings, seen, strict=True):
        assert isinstance(r, CutOff)
        lacks = leakage(one, r.s, r.power, r.record_s, r.spread_s)
        found[r.group] = r.variance + 0.5 * np.abs(INEXACT * lacks) ** 2
    return found


def cut_short(robot: Robot, campaign: Campaign, recordings: Sequence[Recorded]) -> list[Note]:
    """A note where modes of the description still ring at the end of a record whose FRFs state no window."""
    left, group, frequency_hz = rings_most(robot, recordings, campaign)
    if left <= LEFT:
        return []
    record_s = record_length_s(campaign.postures[group])
    text = (
        f"{group}: lines are {1 / record_s:.3g} Hz apart, so a record as stated is {record_s:.3g} s long. At its end "
        f"the mode near {frequency_hz:.3g} Hz still has {left:.0%} of its amplitude. Unless lines were dropped, "
        "leakage distorts every peak. Put an exponential window on the records and state it, or record longer"
    )
    return [Note(text, "leakage")]
