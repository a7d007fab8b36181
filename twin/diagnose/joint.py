"""One model for a motion log and a hammer test: what the log knows of masses is the hammer test's prior.

p(θ | log, hammer) ∝ p(hammer | θ) p(θ | log): the log's answer goes into the model, its likelihood of the numbers both
depend on (links, payloads) replaces their prior, and an entry that both can show gains or loses by what the hammer test
says of it. So a payload must satisfy both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.refit import Fitted
from twin.diagnose.verdict import Candidate, Finding, Missing, Verdict, Word
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters, entry_parameter, independent, join
from twin.physics import CATALOGUE, effect_named
from twin.robot.description import Robot


def shared(effect: str) -> bool:
    """Whether both kinds of recording can show an effect."""
    return effect == "parameter" or (effect in CATALOGUE and {"hammer", "log"} <= CATALOGUE[effect].seen_in)


@dataclass(frozen=True)
class Knowledge:
    """What a log's fit says of numbers that a hammer test depends on too.

    Attributes:
        names: of the numbers, links first; ``links`` of them are.
        mean: (n,) values.
        covariance: (n, n) of x about the mean, posterior; ``prior`` (links, links) what it was for the links.
        log: (n,) x is relative.
    """

    names: tuple[str, ...]
    links: int
    mean: FloatArray
    covariance: FloatArray
    prior: FloatArray
    log: np.ndarray

    @classmethod
    def of(cls, fit: Fitted) -> "Knowledge":
        """From a log's fit: its links, and the payloads of its hypothesis."""
        names = fit.parameters.names
        own = [k for k, name in enumerate(names) if "@" in name and shared(name.partition("@")[0])]
        links = [k for k, p in enumerate(fit.parameters) if p.kind == "link"]
        keep = [*links, *own]
        covariance = fit.covariance
        prior = fit.parameters.covariance * max(1.0, fit.misfit)  # scaled like it: no more is taken out than is in it
        return cls(
            tuple(names[k] for k in keep), len(links), fit.values[keep], covariance[np.ix_(keep, keep)],
            prior[np.ix_(links, links)], np.array([fit.parameters[k].log for k in keep]),
        )  # fmt: skip

    def on(self, free: Parameters, robot: Robot) -> Parameters:
        """The free numbers of a hammer test with what the log knows of them; payloads it found become free too.

        The hammer test's prior of the links stays: the log's own prior is taken out of its posterior.

        Args:
            free: of the hammer test, links at the log's values.
            robot: the description that holds them, with the log's entries.
        """
        present = set(free.names)
        added = [name for name in self.names[self.links :] if name not in present]
        items = list(free.items) + [entry_parameter(robot, name) for name in added]
        whole = join(free, independent(items[len(free) :])) if added else free
        rows = [k for k, name in enumerate(self.names) if name in whole.names]
        at = [whole.names.index(self.names[k]) for k in rows]
        value = self.mean[rows]
        own_log = np.array([items[k].log for k in at])
        # x of one parametrisation in that of the other, to first order about the mean
        scale = np.where(self.log[rows], value, 1.0) / np.where(own_log, value, 1.0)
        information = np.linalg.inv(self.covariance[np.ix_(rows, rows)] * np.outer(scale, scale))
        linked = [i for i, k in enumerate(rows) if k < self.links]
        prior_log = self.prior[np.ix_([rows[i] for i in linked], [rows[i] for i in linked])]
        prior_own = whole.covariance[np.ix_([at[i] for i in linked], [at[i] for i in linked])]
        information[np.ix_(linked, linked)] += np.linalg.inv(prior_own) - np.linalg.inv(prior_log)
        block = np.linalg.inv(information)
        covariance = whole.covariance.copy()
        covariance[at, :] = covariance[:, at] = 0.0
        covariance[np.ix_(at, at)] = 0.5 * (block + block.T)
        for k, v in zip(at, value, strict=True):
            items[k] = replace(items[k], mean=float(v), deviation=float(np.sqrt(covariance[k, k])))
        return Parameters(tuple(items), covariance)


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
        logs = np.array([np.log(max(p, 1e-12)) + gains.get(c.key, 0.0) / temperature for c, p in candidates])
        logs = np.append(logs, np.log(max(none, 1e-12)))
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
