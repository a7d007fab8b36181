"""What the answers are worth: pure functions over cases (truth beside result), no file touched.

A hypothesis is written EFFECT@SITE. Probability mass of one case lies on hypotheses, on `none` and on `other`; what the
command leaves out is taken as nothing.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.trials.visible import SEEN
from twin.measure.campaign import FloatArray

Z95 = 1.959964
LEVEL = 0.9  # of the credible set
VISIBLE = 2.0  # multiples of the smallest visible size from which rates are asked for
LEAST = 1e-3  # probability that an answer left out is taken to have had
HIDING = -0.2  # cosine between a pair's signatures below which they hide each other
HELD_ROOM = 1.25  # times the held-out error of the true model, or of noise alone
EDIT_ROOM = 1.5  # times the held-out error: allowed on the robot that carries another load


@dataclass(frozen=True)
class Scored:
    """One case.

    Attributes:
        truth: hypotheses that are concealed, most visible first; empty: nothing.
        multiples: their sizes over the smallest visible.
        kind, recording: as drawn.
        groups: for each effect reported, its hypotheses and probabilities, first answer first.
        none, other: probabilities.
        location: sites that the residual, and a law without a name, were located at.
        circumstances: what the recording is like, whatever it conceals.
        overlap: cosine between a pair's signatures.
        reference: held-out error of the true model refitted, where that was done.
        kept: ln of a likelihood ratio that the recording itself keeps of a single effect, where that is known.
    """

    name: str
    kind: str
    recording: str
    truth: tuple[str, ...]
    multiples: tuple[float, ...]
    verdict: str
    groups: tuple[tuple[tuple[str, float], ...], ...]
    none: float
    other: float
    error: dict[str, Any]
    intervals: dict[str, tuple[float, float]]
    true_values: dict[str, float]
    location: str
    edit_error: float | None
    wall_s: float
    complaint: str = ""
    circumstances: dict[str, Any] = field(default_factory=dict)
    overlap: float | None = None
    reference: float | None = None
    kept: float | None = None

    @property
    def named(self) -> list[str]:
        """First answer of every effect."""
        return [group[0][0] for group in self.groups if group]

    @property
    def size(self) -> float:
        """The smaller multiple: a set is as hard to find as its faintest part."""
        return min(self.multiples, default=0.0)

    def right(self, guess: str, truth: str) -> bool:
        """Whether a guess is the truth, or an alias of it that comes with the truth beside it."""
        return guess == truth or (truth in self.aliases(guess) and any(truth in dict(group) for group in self.groups))

    def aliases(self, hypothesis: str) -> set[str]:
        """Hypotheses that mechanics does not tell from this one in this recording."""
        return aliases(hypothesis, bool(self.circumstances.get("same_q1")))

    @property
    def top1(self) -> bool:
        return bool(self.named) and self.right(self.named[0], self.truth[0])

    @property
    def top3(self) -> bool:
        return any(self.right(h, self.truth[0]) for group in self.groups[:1] for h, _ in group[:3])

    @property
    def credible(self) -> list[str]:
        """The fewest answers that hold `LEVEL` of the first effect's probability, none and other among them."""
        mass = [*(self.groups[0] if self.groups else ()), ("none", self.none), ("other", self.other)]
        kept, total = [], 0.0
        for name, p in sorted(mass, key=lambda item: -item[1]):
            kept.append(name)
            total += p
            if total >= LEVEL:
                break
        return kept

    @property
    def exact(self) -> bool:
        """Whether the set of named effects is the set of concealed ones."""
        return len(self.named) == len(self.truth) and all(
            any(self.right(guess, t) for guess in self.named) for t in self.truth
        )


def aliases(hypothesis: str, same_q1: bool = False) -> set[str]:
    """Hypotheses that mechanics does not tell from this one; `same_q1`: with one q₁ in all postures."""
    pairs = [
        {"payload@flange", "payload@link3", "parameter@link3.mass"},
        {"base_compliance@base.rz", "parameter@joint1.z.stiffness", "servo_compliance@joint1"},
        *({f"payload@link{i}", f"parameter@link{i}.mass"} for i in (1, 2)),
        *({f"servo_compliance@joint{i}", f"parameter@joint{i}.z.stiffness"} for i in (1, 2, 3)),
        *(
            {
                f"link_flexibility@link{i}.{a}",
                f"parameter@joint{i}.{a}.stiffness",
                f"transverse_compliance@joint{i}.{a}",
            }
            for i in (1, 2, 3)
            for a in "yz"
        ),
        *(
            {f"base_compliance@base.r{a}", f"transverse_compliance@joint1.{a}", f"parameter@joint1.{a}.stiffness"}
            for a in ("xy" if same_q1 else "")
        ),
    ]
    return set().union({hypothesis}, *(pair for pair in pairs if hypothesis in pair))


def outermost(effect: dict[str, Any]) -> dict[str, Any]:
    """An effect under the outermost name of its site: the last link of these three axes carries the flange."""
    return {**effect, "site": "flange"} if (effect["effect"], effect["site"]) == ("payload", "link3") else effect


def scored(answer: dict[str, Any], result: dict[str, Any], reference: float | None = None) -> Scored:
    """Truth and result put side by side, and the error of the true model.

    A command that failed has said nothing: no verdict, all mass on `other`.
    """
    effects = [outermost(e) for e in sorted(answer["effects"], key=lambda e: -e["multiple"])]
    d = result["diagnosis"] or {"verdict": "failed", "effects": [], "probabilities": {"none": 0.0, "other": 1.0}}
    groups = tuple(
        (
            (f"{e['effect']}@{e['site']}", float(e["probability"])),
            *((f"{a['effect']}@{a['site']}", float(a["probability"])) for a in e.get("alternatives", [])),
        )
        for e in d["effects"]
        if e["effect"] != "discovered"
    )
    intervals, values = named_parameters(effects, d["effects"])
    location = [str((d.get("location") or [{}])[0].get("site") or "")]
    location += [str(e["site"]) for e in d["effects"] if e["effect"] == "discovered"]
    return Scored(
        result["id"], answer["kind"], answer["recording"],
        tuple(f"{e['effect']}@{e['site']}" for e in effects), tuple(e["multiple"] for e in effects),
        d["verdict"], groups, float(d["probabilities"]["none"]), float(d["probabilities"]["other"]),
        d.get("error") or {}, intervals, values, " ".join(location),
        next(iter(numbers(result.get("edit_error"))), None), float(result["wall_s"]),
        "" if result["diagnosis"] else last_line(result.get("complaint", "")),
        answer.get("circumstances", {}), answer.get("overlap"), reference, answer.get("kept"),
    )  # fmt: skip


def numbers(error: Any) -> list[float]:
    """The numbers of an error: one, or one per recording."""
    values = error.values() if isinstance(error, dict) else [error]
    return [float(v) for v in values if isinstance(v, int | float)]


def last_line(text: str) -> str:
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "")


def named_parameters(
    truth: Sequence[dict[str, Any]], found: Sequence[dict[str, Any]]
) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """90 % intervals and true values of scalar parameters of effects that were named rightly.

    A beam is left out: its stiffness is spread along the link, no hinge that moves alike has that number.
    """
    intervals, values = {}, {}
    for t in truth:
        for f in found:
            if (t["effect"], t["site"]) != (f["effect"], f["site"]) or "segments" in t["parameters"]:
                continue
            for name, item in f.get("parameters", {}).items():
                true = t["parameters"].get(name)
                if isinstance(true, int | float) and np.size(item.get("interval90") or []) == 2:
                    key = f"{t['effect']}@{t['site']}.{name}"
                    intervals[key] = tuple(item["interval90"])
                    values[key] = float(true)
    return intervals, values


@dataclass(frozen=True)
class Rate:
    """k of n, with Wilson's 95 % interval."""

    k: int
    n: int

    @property
    def value(self) -> float:
        return self.k / self.n if self.n else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        if not self.n:
            return 0.0, 1.0
        p, n = self.value, self.n
        centre = (p + Z95**2 / 2 / n) / (1 + Z95**2 / n)
        half = Z95 / (1 + Z95**2 / n) * np.sqrt(p * (1 - p) / n + Z95**2 / 4 / n**2)
        return max(0.0, centre - half), min(1.0, centre + half)

    def __str__(self) -> str:
        if not self.n:
            return "–"
        low, high = self.interval
        return f"{self.k}/{self.n} = {self.value:.0%} [{low:.0%}, {high:.0%}]"


def rate(cases: Iterable[Scored], good: Callable[[Scored], bool]) -> Rate:
    """How many of the cases are good."""
    flags = [bool(good(c)) for c in cases]
    return Rate(sum(flags), len(flags))


def judged(cases: Iterable[Scored]) -> list[Scored]:
    """Nulls and single effects above twice the smallest visible size: what probabilities are judged by."""
    return [c for c in cases if c.kind == "none" or (c.kind in ("single", "chain") and c.size >= VISIBLE)]


def headline(cases: Sequence[Scored]) -> dict[str, Any]:
    """The vector of scores."""
    null = [c for c in cases if c.kind == "none"]
    one = [c for c in cases if c.kind in ("single", "chain")]
    clear = [c for c in one if c.size >= VISIBLE]
    keeps = [c for c in clear if c.kept is not None and c.kept >= VISIBLE**2 * SEEN]
    pairs = [c for c in cases if c.kind == "pair" and c.size >= VISIBLE]
    hiding = [c for c in pairs if c.overlap is not None and c.overlap < HIDING]
    outside = [c for c in cases if c.kind == "outside" and c.size >= VISIBLE]
    alike = [c for c in clear if len(c.aliases(c.truth[0])) > 1]
    sure = judged(cases)
    held = [g for c in clear if (g := _gain(c)) is not None]
    over = [r for c in clear if (r := over_floor(c, "after")) is not None]
    true = [r for c in clear if (r := over_reference(c)) is not None]
    edited = [c for c in cases if c.edit_error is not None and numbers(c.error.get("after", {}).get("held_out"))]
    inside = [low <= c.true_values[key] <= high for c in [*clear, *pairs] for key, (low, high) in c.intervals.items()]
    return {
        "false alarms": rate(null, lambda c: bool(c.named)),
        "nulls not called adequate": rate(null, lambda c: c.verdict != "adequate"),
        "found at all (above twice visible)": rate(clear, _found),
        "top-1 (above twice visible)": rate(clear, lambda c: c.top1),
        "top-1, where the recording itself shows as much": rate(keeps, lambda c: c.top1),
        "top-3 (above twice visible)": rate(clear, lambda c: c.top3),
        "top-1 by effect alone": rate(clear, lambda c: bool(c.named) and _effect(c.named[0]) == _effect(c.truth[0])),
        "top-3 by effect alone": rate(
            clear, lambda c: any(_effect(h) == _effect(c.truth[0]) for g in c.groups[:1] for h, _ in g[:3])
        ),
        "wrong name first (above twice visible)": rate(clear, lambda c: bool(c.named) and not c.top1),
        "pairs, exact set": rate(pairs, lambda c: c.exact),
        "pairs, one of both first": rate(
            pairs, lambda c: bool(c.named) and any(c.right(c.named[0], t) for t in c.truth)
        ),
        "pairs that hide each other, exact set": rate(hiding, lambda c: c.exact),
        "precision over sets": _rate([any(c.right(h, t) for t in c.truth) for c in cases for h in c.named]),
        "recall over sets": _rate([any(c.right(h, t) for h in c.named) for c in [*clear, *pairs] for t in c.truth]),
        "credible set holds the truth": rate(sure, lambda c: (c.truth[0] if c.truth else "none") in c.credible),
        "mean size of the credible set": float(np.mean([len(c.credible) for c in sure])) if sure else np.nan,
        "aliases come with the truth": rate(alike, lambda c: c.truth[0] in {h for g in c.groups for h, _ in g}),
        "wrong name on unknown physics": rate(outside, lambda c: bool(c.named)),
        "right joint on unknown physics": rate(outside, lambda c: _joint(c.truth[0]) in c.location),
        "90 % intervals hold the truth": _rate(inside),
        "calibration error": calibration([claim(c) for c in sure])[0],
        "calibration error that 19 in 20 calibrated splits stay below": by_chance([claim(c)[1] for c in sure]),
        "calibration error, faint ones too": calibration([claim(c) for c in [*null, *one]])[0],
        "Brier score": float(np.mean([brier(c) for c in sure])) if sure else np.nan,
        "log score": float(np.mean([log_score(c) for c in sure])) if sure else np.nan,
        "held-out gain over the true model's": float(np.median(held)) if held else np.nan,
        "held-out error over its noise floor, median": float(np.median(over)) if over else np.nan,
        f"held-out error ≤ {HELD_ROOM:g} × its noise floor": _rate([r <= HELD_ROOM for r in over]),
        "held-out error over the true model's, median": float(np.median(true)) if true else np.nan,
        f"held-out error ≤ {HELD_ROOM:g} × the true model's": _rate([r <= HELD_ROOM for r in true]),
        "edit test passed": rate(
            edited, lambda c: c.edit_error <= EDIT_ROOM * max(numbers(c.error["after"]["held_out"]))
        ),
        "failed": rate(cases, lambda c: c.verdict == "failed"),
        "seconds, median": float(np.median([c.wall_s for c in cases])) if cases else np.nan,
        "seconds, longest": float(np.max([c.wall_s for c in cases])) if cases else np.nan,
    }


def fault(c: Scored) -> str:
    """What is wrong with the answer to a case; empty: nothing."""
    if c.verdict == "failed":
        return "no answer"
    if c.kind == "none":
        return "false alarm" if c.named else "" if c.verdict == "adequate" else "null not called adequate"
    if c.kind == "outside":
        return "wrong name on unknown physics" if c.named else ""
    if c.kind == "pair":
        wrong = [h for h in c.named if not any(c.right(h, t) for t in c.truth)]
        return (
            "" if c.exact else "pair: a wrong name" if wrong else "pair: one missed" if c.named else "pair: both missed"
        )
    if c.top1:
        return "" if len(c.named) == 1 else "one too many"
    if c.named:
        same = _effect(c.named[0]) == _effect(c.truth[0])
        return "right effect, wrong site" if same else "truth among the rivals" if c.top3 else "wrong name"
    return "not seen" if c.verdict == "adequate" else "seen, not named"


def often(n: int) -> str:
    """Once, twice, 3 times."""
    return {1: "once", 2: "twice"}.get(n, f"{n} times")


def _rate(flags: Sequence[bool]) -> Rate:
    return Rate(sum(map(bool, flags)), len(flags))


def _effect(hypothesis: str) -> str:
    return hypothesis.partition("@")[0]


def _joint(hypothesis: str) -> str:
    return hypothesis.partition("@")[2].partition(".")[0]


def claim(c: Scored) -> tuple[bool, float]:
    """The most probable answer: whether it was right, and the probability claimed for it."""
    answer, p = max(masses(c).items(), key=lambda item: item[1])
    return (c.right(answer, c.truth[0]) if c.truth else answer == "none"), p


def _gain(c: Scored) -> float | None:
    """Fall of the held-out error over the fall down to the noise floor, which no model can beat by much.

    With both kinds of recording, the mean over those whose error could fall.
    """
    try:
        rows = [numbers(c.error[key]["held_out"]) for key in ("before", "after")] + [numbers(c.error["noise_floor"])]
    except (KeyError, TypeError):
        return None
    if len({len(row) for row in rows}) > 1:
        return None
    gains = [(b - a) / (b - floor) for b, a, floor in zip(*rows, strict=True) if b > 1.1 * floor]
    return float(np.clip(np.mean(gains), -1, 1.2)) if gains else None


def over_floor(c: Scored, stage: str) -> float | None:
    """Held-out error over its noise floor, of the worse of two recordings.

    The true model refitted ends near the floor, and above it: the ratio is no smaller than that to the true model's.
    """
    floor, row = numbers(c.error.get("noise_floor")), numbers((c.error.get(stage) or {}).get("held_out"))
    return max(e / f for e, f in zip(row, floor, strict=True)) if floor and len(row) == len(floor) else None


def over_reference(c: Scored) -> float | None:
    """Held-out error over that of the true model refitted."""
    row = numbers((c.error.get("after") or {}).get("held_out"))
    return max(row) / c.reference if row and c.reference else None


def calibration(claims: Sequence[tuple[bool, float]], bins: int = 10) -> tuple[float, list[tuple[float, Rate]]]:
    """Expected calibration error, and the curve: mean probability claimed and how often it was right, per bin."""
    if not claims:
        return float("nan"), []
    right, p = np.array([c[0] for c in claims]), np.array([c[1] for c in claims])
    inside = _bins(p, bins)
    curve = [(float(p[here].mean()), Rate(int(right[here].sum()), int(here.sum()))) for here in inside]
    return float(_error(right, p, inside)), curve


def by_chance(claimed: Sequence[float], bins: int = 10, draws: int = 4000, seed: int = 0) -> float:
    """Calibration error that 19 of 20 splits with these probabilities stay below if every one of them is right."""
    if not claimed:
        return float("nan")
    p = np.array(claimed)
    right = np.random.default_rng(seed).random((draws, len(p))) < p
    return float(np.quantile(_error(right, p, _bins(p, bins)), 0.95))


def _bins(p: FloatArray, bins: int) -> list[NDArray[np.bool_]]:
    """Which probabilities (n,) lie in each bin that holds any."""
    index = np.minimum((p * bins).astype(int), bins - 1)
    return [index == b for b in np.unique(index)]


def _error(right: NDArray[np.bool_], p: FloatArray, inside: Sequence[NDArray[np.bool_]]) -> FloatArray:
    """Expected calibration error (...) of answers (..., n) that are right or not."""
    miss = right - p
    return np.sum([np.abs(miss[..., here].sum(axis=-1)) for here in inside], axis=0) / len(p)


def temperature(cases: Sequence[Scored]) -> tuple[float, tuple[float, float], tuple[float, float]]:
    """Factor on the temperature that makes the right answers most probable (Guo et al., ICML 2017).

    Of nulls and clear effects: one outside the vocabulary has no right answer but "other", which no temperature makes.
    With the factor, log score and calibration error before and after.
    """
    known = [c for c in judged(cases) if c.verdict != "failed"]

    def at(factor: float) -> tuple[float, float]:
        lost, claims = [], []
        for c in known:
            truth = c.truth[0] if c.truth else "none"
            p = {**masses(c), truth: max(masses(c).get(truth, 0.0), LEAST)}
            weights = np.array(list(p.values())) ** (1 / factor)
            stated = dict(zip(p, weights / weights.sum(), strict=True))
            best = max(stated, key=lambda name: stated[name])
            lost.append(-np.log(stated[truth]))
            claims.append((c.right(best, truth) if c.truth else best == "none", stated[best]))
        return float(np.mean(lost)), calibration(claims)[0]

    factors = np.geomspace(0.3, 10, 60)
    best = float(factors[int(np.argmin([at(f)[0] for f in factors]))])
    before, after = at(1.0), at(best)
    return best, (before[0], after[0]), (before[1], after[1])


def masses(c: Scored) -> dict[str, float]:
    """Probability of every answer to a case with one effect or none."""
    found = dict(c.groups[0]) if c.groups else {}
    return {**found, "none": c.none, "other": c.other}


def brier(c: Scored) -> float:
    """Σ (p − truth)² over answers; 0 perfect, 2 worst."""
    mass, truth = masses(c), c.truth[0] if c.truth else "none"
    return sum((p - (h == truth)) ** 2 for h, p in mass.items()) + (truth not in mass)


def log_score(c: Scored) -> float:
    """−ln of the probability given to the truth, at most ln 1000."""
    truth = c.truth[0] if c.truth else "none"
    return float(-np.log(max(masses(c).get(truth, 0.0), LEAST)))


def _found(case: Scored) -> bool:
    """Whether the answer says that something is missing; no answer says nothing."""
    return case.verdict not in ("adequate", "failed")


def power(cases: Sequence[Scored], edges: Sequence[float] = (1, 2, 4, 8, 16, 31)) -> list[tuple[float, Rate, Rate]]:
    """Geometric middle of a size bin, rate of being found at all, rate of top-1."""
    one = [c for c in cases if c.kind in ("single", "chain")]
    found = []
    for low, high in pairwise(edges):
        here = [c for c in one if low <= c.size < high]
        found.append((float(np.sqrt(low * high)), rate(here, _found), rate(here, lambda c: c.top1)))
    return found


def by_effect(cases: Sequence[Scored]) -> dict[str, tuple[Rate, Rate]]:
    """Top-1 and top-3 of every effect, above twice the smallest visible size, and by recording."""
    clear = [c for c in cases if c.kind in ("single", "chain") and c.size >= VISIBLE]
    names = sorted({(c.recording, _effect(c.truth[0])) for c in clear})
    out = {}
    for recording, name in names:
        here = [c for c in clear if c.recording == recording and _effect(c.truth[0]) == name]
        out[f"{name} ({recording})"] = rate(here, lambda c: c.top1), rate(here, lambda c: c.top3)
    return out


def confusion(cases: Sequence[Scored]) -> tuple[list[str], list[str], np.ndarray]:
    """Counts of concealed effects (rows; unknown ones last) against first answers (columns; verdicts last)."""
    here = [c for c in cases if c.kind != "pair"]
    outside = {_effect(c.truth[0]) for c in here if c.kind == "outside"}
    rows = sorted(
        {_effect(c.truth[0]) if c.truth else "none" for c in here}, key=lambda r: (r in outside, r == "none", r)
    )
    said = [_effect(c.named[0]) if c.named else c.verdict for c in here]
    verdicts = {c.verdict for c in here if not c.named}
    columns = sorted(set(said), key=lambda column: (column in verdicts, column))
    table = np.zeros((len(rows), len(columns)), int)
    for c, answer in zip(here, said, strict=True):
        table[rows.index(_effect(c.truth[0]) if c.truth else "none"), columns.index(answer)] += 1
    return rows, columns, table
