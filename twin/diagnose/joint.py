"""One model for a motion log and a hammer test: what the log knows of masses is the hammer test's prior.

p(θ | log, hammer) ∝ p(hammer | θ) p(θ | log). The log's answer goes into the model. Links, lengths and twists of axes
and payloads matter to both recordings: the log's likelihood of these numbers replaces their prior. An entry that both
can show gains or loses probability by what the hammer test says of it. So a payload must satisfy both.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.refit import Fitted
from twin.diagnose.verdict import NEGLIGIBLE, Candidate, Finding, Missing, Verdict, Word
from twin.measure.campaign import FloatArray
from twin.model.parameters import (
    SIX,
    Parameter,
    Parameters,
    Sprung,
    axis_parameters,
    entry_parameter,
    independent,
    join,
)
from twin.model.regressor import body_of, inertial_vector
from twin.physics import CATALOGUE, effect_named
from twin.robot.description import Robot
from twin.robot.frames import inertia_matrix, inertia_six

ELSEWHERE = 1.0  # of the logarithm of a mass or moment: a line that moves one by a factor of e holds nowhere near


def shared(effect: str) -> bool:
    """Whether both kinds of recording can show an effect."""
    return effect == "parameter" or (effect in CATALOGUE and {"hammer", "log"} <= CATALOGUE[effect].seen_in)


def places_axis(parameter: Parameter) -> bool:
    """Whether a number says where an axis lies, in both kinds of recording; its zero is the angle of a hammer test."""
    return parameter.kind == "axis" and parameter.quantity in ("a", "d", "alpha")


@dataclass(frozen=True)
class Knowledge:
    """What a log's fit says of numbers that a hammer test depends on too.

    Attributes:
        names: of the numbers, those of the description first: links and axes; ``described`` of them are.
        mean: (n,) values.
        covariance: (n, n) of x about the mean, posterior; ``prior`` (described, described) what it was for those.
        log: (n,) x is relative.
    """

    names: tuple[str, ...]
    described: int
    mean: FloatArray
    covariance: FloatArray
    prior: FloatArray
    log: np.ndarray

    @classmethod
    def of(cls, fit: Fitted) -> "Knowledge":
        """From a log's fit: its links and axes, and the payloads of its hypothesis.

        The log's numbers of links are its moments, linear about the description. Masses and places have these moments.
        """
        names, values, covariance = fit.parameters.names, fit.values.copy(), fit.covariance
        prior = fit.parameters.covariance * max(1.0, fit.misfit)  # scaled like it: no more is taken out than is in it
        links = [k for k, p in enumerate(fit.parameters) if p.kind == "link"]
        turn, x = np.eye(len(names)), fit.parameters.root @ fit.z
        for at in _bodies(fit.parameters, links):
            described = np.array([fit.parameters[k].mean for k in at])
            was = _slopes_of(fit.parameters, at, described)
            values[at] = _numbers(_moments(described) + was @ x[at])
            turn[np.ix_(at, at)] = np.linalg.solve(_slopes_of(fit.parameters, at, values[at]), was)
        covariance, prior = turn @ covariance @ turn.T, turn @ prior @ turn.T
        stated = [*links, *(k for k, p in enumerate(fit.parameters) if places_axis(p))]
        own = [k for k, name in enumerate(names) if "@" in name and shared(name.partition("@")[0])]
        keep = [*stated, *own]
        return cls(
            tuple(names[k] for k in keep), len(stated), values[keep], covariance[np.ix_(keep, keep)],
            prior[np.ix_(stated, stated)], np.array([fit.parameters[k].log for k in keep]),
        )  # fmt: skip

    def on(self, free: Parameters, robot: Robot) -> Parameters:
        """The free numbers of a hammer test with what the log knows of them; axes and payloads of it become free too.

        The hammer test's prior of the description stays: the log's own prior is taken out of its posterior.

        Args:
            free: of the hammer test, links at the log's values.
            robot: the description that holds them, with the log's entries.
        """
        present = set(free.names)
        added = [p for p in axis_parameters(robot) if places_axis(p) and p.name in self.names]
        loads = [entry_parameter(robot, name) for name in self.names[self.described :] if name not in present]
        added += [p for p in loads if p.mean > 0 or not p.log]  # an inertia that the log has at zero stays there
        items = [*free.items, *added]
        whole = join(free, independent(items[len(free) :])) if added else free
        rows = [k for k, name in enumerate(self.names) if name in whole.names]
        at = [whole.names.index(self.names[k]) for k in rows]
        value = self.mean[rows]
        own_log = np.array([items[k].log for k in at])
        # x of one parametrisation in that of the other, to first order about the mean
        scale = np.where(self.log[rows], value, 1.0) / np.where(own_log, value, 1.0)
        information = np.linalg.inv(self.covariance[np.ix_(rows, rows)] * np.outer(scale, scale))
        stated = [i for i, k in enumerate(rows) if k < self.described]
        prior_log = self.prior[np.ix_([rows[i] for i in stated], [rows[i] for i in stated])]
        prior_own = whole.covariance[np.ix_([at[i] for i in stated], [at[i] for i in stated])]
        information[np.ix_(stated, stated)] += np.linalg.inv(prior_own) - np.linalg.inv(prior_log)
        block = np.linalg.inv(information)
        covariance = whole.covariance.copy()
        covariance[at, :] = covariance[:, at] = 0.0
        covariance[np.ix_(at, at)] = 0.5 * (block + block.T)
        for k, v in zip(at, value, strict=True):
            items[k] = replace(items[k], mean=float(v), deviation=float(np.sqrt(covariance[k, k])))
        return Parameters(tuple(items), covariance)


def about(parameters: Parameters, values: FloatArray) -> Parameters:
    """Parameters with the prior of masses and of where they hang made linear anew, at the values (n,) of a fit.

    A log knows moments, m c and J + m (cᵀc E − c cᵀ), which are linear in its torque. Its knowledge of moments is
    normal. Its knowledge of masses and places is normal only near the values at which it was made linear. Far from
    them, a payload that changes by a kilogram would change the log's torque. A body whose mass or moments the
    new line would have elsewhere altogether keeps what was known of it.
    """
    turn, items = np.eye(len(parameters)), list(parameters.items)
    for at in _bodies(parameters, range(len(parameters))):
        there, mean = values[at], np.array([items[k].mean for k in at])
        was, now = (_slopes_of(parameters, at, numbers) for numbers in (mean, there))
        off = np.linalg.solve(now, _moments(mean) - _moments(there))
        if any(items[k].log and abs(x) > ELSEWHERE for k, x in zip(at, off, strict=True)):
            continue
        turn[np.ix_(at, at)] = np.linalg.solve(now, was)
        for k, value, x in zip(at, there, off, strict=True):
            items[k] = replace(items[k], mean=float(value * np.exp(x) if items[k].log else value + x))
    covariance = turn @ parameters.covariance @ turn.T
    items = [replace(item, deviation=float(np.sqrt(covariance[k, k]))) for k, item in enumerate(items)]
    if not isinstance(parameters, Sprung):
        return Parameters(tuple(items), covariance)
    written = [replace(w, mean=i.mean, deviation=i.deviation) for w, i in zip(parameters.written, items, strict=True)]
    return Sprung(tuple(items), covariance, Parameters(tuple(written), covariance))


def _bodies(parameters: Parameters, among: Iterable[int]) -> list[list[int]]:
    """Of every body with free mass and centre of mass their indices, then those of its inertia where that is free."""
    index, found = {parameters.names[k]: k for k in among}, []
    for body in [name.removesuffix(".mass") for name in index if name.endswith(".mass")]:
        com = [f"{body}.com[{k}]" if "@" in body else f"{body}.com.{letter}" for k, letter in enumerate("xyz")]
        inertia = [f"{body}.inertia[{k}]" if "@" in body else f"{body}.inertia.{p}" for k, p in enumerate(SIX)]
        inertia = [name for name in inertia if name in index]
        own = [f"{body}.mass", *com, *inertia]
        if set(own) <= index.keys():
            found.append([index[name] for name in own])
    return found


def _moments(numbers: FloatArray) -> FloatArray:
    """m, m c and the inertia about the frame's origin, of m, c and the inertia at c: its moments, then its products.

    Args:
        numbers: (4,), (7,) or (10,): what is left out is zero at c, and not told of the origin.
    """
    inertia = inertia_matrix(np.pad(numbers[4:], (0, 10 - len(numbers))).tolist())
    return inertial_vector(float(numbers[0]), numbers[1:4], inertia)[: len(numbers)]


def _numbers(moments: FloatArray) -> FloatArray:
    """The inverse of :func:`_moments`."""
    mass, com, inertia = body_of(np.pad(moments, (0, 10 - len(moments))))
    return np.array([mass, *com, *inertia_six(inertia)])[: len(moments)]


def _slopes_of(parameters: Parameters, at: list[int], numbers: FloatArray) -> FloatArray:
    """∂ moments / ∂ x of a body at its numbers."""
    return np.asarray(_moment_slopes(numbers) * np.where([parameters[k].log for k in at], numbers, 1.0))


def _moment_slopes(numbers: FloatArray) -> FloatArray:
    """∂ moments / ∂ numbers, by differences of a cubic: good to 1e-6 of it."""
    step = 1e-3
    sides = [[_moments(numbers + sign * step * e) for e in np.eye(len(numbers))] for sign in (1.0, -1.0)]
    return (np.array(sides[0]) - np.array(sides[1])).T / (2 * step)


def settled_with(missing: Sequence[Missing], gains: dict[str, float], none: float, other: float) -> (
    tuple[list[Missing], float]
):  # fmt: skip
    """A log's answers after a hammer test: probabilities multiplied by what it says of each, and renormalised.

    Args:
        missing: the log's answers.
        gains: ``EFFECT@SITE`` → ln evidence over nothing missing, from the hammer test; what it cannot show is absent.
        none, other: of the log.

    Returns:
        The answers, and the probability that nothing is missing.
    """
    temperature = calibration()["temperature"]
    found, nothing = [], none
    for m in missing:
        candidates: list[tuple[Candidate, float]] = [(m.first, m.probability), *m.alternatives]
        if m.first.key not in gains:
            found.append(m)
            continue
        logs = np.array([np.log(max(p, NEGLIGIBLE)) + gains.get(c.key, 0.0) / temperature for c, p in candidates])
        logs = np.append(logs, np.log(max(none, NEGLIGIBLE)))
        share = np.exp(logs - logs.max())
        share *= (1 - other) / share.sum()
        ranked = sorted(zip((c for c, _ in candidates), share, strict=False), key=lambda item: -item[1])
        (first, p), *rest = ranked
        nothing = float(share[-1])
        found.append(replace(m, first=first, probability=float(p), alternatives=tuple((c, float(q)) for c, q in rest)))
    return found, nothing


def together(findings: Sequence[Finding], base: Robot, robot: Robot) -> Verdict:
    """The verdict of several findings that stand on one model."""
    missing = [m for finding in findings for m in finding.missing]
    none = float(np.prod([f.none for f in findings])) if missing else min(f.none for f in findings)
    other = max(f.other for f in findings)
    words = [f.word for f in findings]
    word: Word = "adequate"
    if missing:
        word = "ambiguous" if any(m.rivals for m in missing) else "named"
        word = "located" if all(effect_named(m.first.effect).part == "law" for m in missing) else word
    elif "unexplained" in words:
        word = "unexplained"
    return Verdict(list(findings), word, missing, none, other, base, robot)


def followed(missing: Missing, before: Robot, after: Robot) -> Missing:
    """A log's answer with numbers and intervals moved as its entry moves from one description to another."""
    first = missing.first
    key = first.effect, first.site
    was, now = ([e.values for e in robot.physics if (e.effect, e.site) == key] for robot in (before, after))
    if shared(first.effect) or len(was) != 1 or len(now) != 1:
        return missing
    parameters = {}
    for name, item in first.parameters.items():
        start, end = (np.array(values[0].get(name, np.nan), float) for values in (was, now))
        if start.shape != end.shape or start.shape != np.shape(item["value"]) or not np.allclose(start, item["value"]):
            return missing  # the entry holds more than the answer
        ends = np.array(item["interval90"]) + (end - start)[..., None]
        parameters[name] = {**item, "value": end.tolist(), "interval90": ends.tolist()}
    return replace(missing, first=replace(first, parameters=parameters))
