"""What answers about a wrong world are worth, and docs/proof-wrong.md: pure functions over cases.

A *name* is the first answer of an effect that is listed, EFFECT@SITE, a number of the description (`parameter`) among
them. It is wrong where it is neither the cause, nor what hardly differs from it, nor what was concealed on top.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from tools.trials.score import HELD_ROOM, Rate, aliases, last_line, named_parameters, numbers, often
from tools.trials.store import before, reading, typeset
from tools.trials.visible import SEEN
from tools.trials.wrong import OWN
from tools.truth.wrong import LACKING_NOTHING, WAYS

NAMED = 0.5  # probability from which an answer counts as a name
TOLD = {  # kinds of fault of a recording, in the sentences of version 1 and in refusals
    "unit": r"\bunits?\b|\bin g\b|mm/s|degrees",
    "reversed_channel": r"revers|opposite sign|wrong sign|polarity",
    "swapped_channels": r"swap|exchanged|interchanged",
    "label": r"\blabel",
    "posture": r"mislabel|not (in )?the (stated )?posture|wrong posture",
    "noise_understated": r"understat|noise is (larger|greater)",
    "hum": r"\bhum\b|mains|50 Hz",
    "leakage": r"leak|record is too short|still rings",
    "roving_mass": r"roving|sensor's mass|mass of the sensor",
    "other_robot": r"(an)?other robot|different robots?|not the same robot",
    "clock": r"\bclock",
    "drift": r"\bdrift|warm",
    "position": r"position of",
}
CLASSES = ("right", "near", "honest", "doubtful", "adequate above its floor", "wrong name", "no answer")
EXPLAINED = f"""\
Robots and recordings that are **not** as described: {len(WAYS)} ways, far outside what the description says of itself,
on three robots (the KR90, an arm half its size, a column with two vertical axes), in hammer tests and motion logs. A
third has an effect concealed on top, four times the smallest size that the recording shows when all numbers within
tolerance have moved to hide it. (Up to engine 04622b94 tension against the description counted as showing, too.) The
command is asked with the recording alone. The answer to a case is

- *right*: the cause comes first (the number of the description, the effect, or the fault of the recording in `triage`),
  and nothing else is named; for a robot that lacks nothing, `adequate`;
- *near*: a name that hardly differs from the cause in such data (a channel's gain for a unit, a load for a mass);
- *honest*: `unexplained`, `located`, or `adequate` with an error left of at most {HELD_ROOM:g} times the noise floor;
- *doubtful*: a wrong name below {NAMED:g}, or a robot that lacks nothing and is not called adequate;
- *adequate above its floor*; *wrong name*, at {NAMED:g} or more; *no answer*: a crash, a refusal that
  does not tell the cause, no time.

A number may be far off its description where no prediction shows it. It is then no name: a warning tells its value, its
interval and by how many deviations it is off. Such a warning makes no answer *right*; it has two rows of its own.

Every rate has Wilson's 95 % interval."""


@dataclass(frozen=True)
class Judged:
    """One case: what was wrong, and what was said.

    `groups`: for each effect listed, its hypotheses and probabilities, first answer first. `triage`: kind, severity,
    text, and EFFECT@SITE of what it says is off; kind empty in version 1. `held_out`: pairs of error before and after,
    one per recording. `floor`: error after over the noise floor, the largest. `inside`: by number, whether its 90 %
    interval holds the truth.
    `shown`: how far it shows that the robot is not as described, logarithm of a likelihood ratio, where that is known.
    `off`: EFFECT@SITE of what warnings of triage say is off its description, farthest first.
    """

    name: str
    way: str
    recording: str
    robot: str
    size: str
    causes: tuple[str, ...]
    faults: tuple[str, ...]
    fair: tuple[str, ...]
    top: str
    verdict: str
    groups: tuple[tuple[tuple[str, float], ...], ...]
    triage: tuple[tuple[str, str, str, tuple[str, ...]], ...]
    held_out: tuple[tuple[float, float], ...]
    floor: float | None
    inside: dict[str, bool]
    wall_s: float
    cpu_s: float | None
    complaint: str
    shown: float | None = None
    off: tuple[str, ...] = ()

    @property
    def lacks_nothing(self) -> bool:
        """Whether robot and recording are as described."""
        return not self.causes and not self.faults

    @property
    def told(self) -> bool:
        """Whether triage, or a refusal, tells what is wrong with the recording, and where, if it says where."""
        for kind, severity, text, sites in self.triage:
            there = not sites or not self.causes or self.is_cause(sites[0])
            if kind and severity != "note" and kind in self.faults and there:
                return True
            if not kind and self._says(text):
                return True
        return self.verdict == "refused" and self._says(self.complaint)

    def _says(self, text: str) -> bool:
        """Whether a sentence tells what is wrong with the recording."""
        return any(re.search(TOLD[fault], text, re.I) for fault in self.faults if fault in TOLD)

    @property
    def named(self) -> list[tuple[str, float]]:
        """First answer of every effect, laws found without a name left out."""
        return [group[0] for group in self.groups if group and not group[0][0].startswith("discovered@")]

    @property
    def wrong(self) -> list[str]:
        """Wrong names."""
        return [h for h, p in self.named if p >= NAMED and not self.allowed(h)]

    def allowed(self, hypothesis: str) -> bool:
        """Whether a name is not wrong."""
        return self.is_cause(hypothesis) or self.is_near(hypothesis) or self.is_top(hypothesis)

    def is_cause(self, hypothesis: str) -> bool:
        return _matches(hypothesis, self.causes)

    def is_near(self, hypothesis: str) -> bool:
        return _matches(hypothesis, self.fair) or any(hypothesis in aliases(cause) for cause in self.causes)

    def is_top(self, hypothesis: str) -> bool:
        return bool(self.top) and hypothesis in aliases(self.top)

    @property
    def cause_first(self) -> bool:
        """Whether the cause is among the first answers, or told by triage."""
        return self.told or any(self.is_cause(h) for h, _ in self.named)

    @property
    def cause_told(self) -> bool:
        """Whether the cause is among the first answers, or what a warning says is farthest off its description."""
        return self.cause_first or any(self.is_cause(site) for site in self.off[:1])

    @property
    def misled(self) -> bool:
        """Whether a warning says that a number is off its description which is neither a cause nor what is on top."""
        return any(not self.allowed(site) for site in self.off)

    @property
    def top_named(self) -> bool:
        return any(self.is_top(h) for h, _ in self.named)

    @property
    def fallen(self) -> bool:
        """Whether the held-out error of a recording falls with what is listed, if anything is."""
        return not self.groups or any(after < before for before, after in self.held_out)

    @property
    def outcome(self) -> str:
        """One of `CLASSES`."""
        if self.verdict in ("failed", "refused"):
            return "right" if self.told else "no answer"
        if self.wrong:
            return "wrong name"
        if self.lacks_nothing:
            return "right" if self.verdict == "adequate" else "doubtful"
        if self.cause_first:
            return "right"
        if any(self.is_near(h) for h, _ in self.named):
            return "near"
        if any(not self.allowed(h) for h, _ in self.named):
            return "doubtful"
        if self.verdict in ("located", "unexplained") or self.floor is None or self.floor <= HELD_ROOM:
            return "honest"
        return "adequate above its floor"


def _matches(hypothesis: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(hypothesis, pattern) or fnmatchcase(hypothesis, f"{pattern}.*") for pattern in patterns)


def judged(answer: dict[str, Any], result: dict[str, Any]) -> Judged:
    """Truth and result put side by side."""
    d, cause = result["diagnosis"], answer["cause"]
    failed = "refused" if result["code"] == 2 else "failed"
    d = d or {"verdict": failed, "effects": [], "error": {}, "triage": []}
    groups = tuple(
        tuple((f"{e['effect']}@{e['site']}", float(e["probability"])) for e in (first, *first.get("alternatives", [])))
        for first in d["effects"]
    )
    top = answer["effects"][0] if answer["effects"] else None
    error = d.get("error") or {}
    before, after = (numbers((error.get(key) or {}).get("held_out")) for key in ("before", "after"))
    floors = numbers(error.get("noise_floor"))
    over = [a / f for a, f in zip(after, floors, strict=False) if f > 0]
    return Judged(
        result["id"], answer["way"], answer["recording"], answer["robot"], cause["size"], tuple(cause["names"]),
        tuple(cause["triage"]), tuple(cause["fair"]), f"{top['effect']}@{top['site']}" if top else "", d["verdict"],
        groups, tuple(_triage(item) for item in d.get("triage") or []), tuple(zip(before, after, strict=False)),
        max(over, default=None), _inside(answer, d["effects"]), float(result["wall_s"]), result.get("cpu_s"),
        "" if result["diagnosis"] else last_line(result.get("complaint", "")), answer.get("shown"), _off(d),
    )  # fmt: skip


def _off(diagnosis: dict[str, Any]) -> tuple[str, ...]:
    """EFFECT@SITE of what warnings say is off its description."""
    items = [_triage(item) for item in diagnosis.get("triage") or []]
    return tuple(site for _, severity, _, sites in items if severity != "note" for site in sites)


def _triage(item: Any) -> tuple[str, str, str, tuple[str, ...]]:
    """Kind, severity, text and EFFECT@SITE of a line of triage; strings have no kind."""
    if isinstance(item, str):
        return "", "warning", item, ()
    sites = tuple(site if "@" in site else f"parameter@{site}" for site in item.get("sites", []))
    return str(item.get("kind", "")), str(item.get("severity", "warning")), str(item.get("text", "")), sites


def _inside(answer: dict[str, Any], effects: Sequence[dict[str, Any]]) -> dict[str, bool]:
    """Which 90 % intervals hold the truth: of numbers of the cause, and of what was concealed on top."""
    intervals, true = named_parameters(answer["effects"], effects)
    found = {key: low <= true[key] <= high for key, (low, high) in intervals.items()}
    known = answer["cause"]["values"]
    for e in effects:
        name = f"{e['effect']}@{e['site']}"
        if not _matches(name, answer["cause"]["names"]):
            continue
        for key, item in e.get("parameters", {}).items():
            bounds = np.asarray(item.get("interval90") or [], float)
            if bounds.shape == (2,):
                bounds = bounds.reshape(1, 2)
            labels = [key] if len(bounds) == 1 else [f"{key}.{axis}" for axis in "xyz"[: len(bounds)]]
            for label, (low, high) in zip(labels, bounds, strict=False):
                match = [k for k in known if label == k or label.endswith(f".{k}")]
                if match:
                    found[f"{name}.{label}"] = bool(low <= known[match[0]] <= high)
    return found


def rate(cases: Iterable[Judged], good: Callable[[Judged], bool]) -> Rate:
    """How many of the cases are good."""
    flags = [bool(good(c)) for c in cases]
    return Rate(sum(flags), len(flags))


def headline(cases: Sequence[Judged]) -> dict[str, Any]:
    """The vector of scores."""
    off = [c for c in cases if not c.lacks_nothing]
    clear = [c for c in off if c.shown is None or c.shown >= SEEN]
    whole = [c for c in cases if c.lacks_nothing]
    on_top = [c for c in cases if c.top]
    inside = [good for c in cases for good in c.inside.values()]
    first = [c.allowed(h) for c in cases for h, _ in c.named if h.startswith("parameter@")]
    cpu = [c.cpu_s for c in cases if c.cpu_s is not None]
    return {
        f"wrong name at {NAMED:g} or more": rate(cases, lambda c: bool(c.wrong)),
        "wrong name whose held-out error does not fall": rate(cases, lambda c: bool(c.wrong) and not c.fallen),
        "any answer whose held-out error does not fall": rate(cases, lambda c: not c.fallen),
        "true cause first": rate(off, lambda c: c.cause_first),
        f"true cause first, where it shows (ln likelihood ratio ≥ {SEEN:g})": rate(clear, lambda c: c.cause_first),
        "true cause first, or told as farthest off its description": rate(off, lambda c: c.cause_told),
        "a number told to be off that is not": rate(cases, lambda c: c.misled),
        "a number that comes first is a cause": Rate(sum(first), len(first)),
        "true cause first, and no wrong name beside it": rate(off, lambda c: c.outcome == "right"),
        "true cause, near it, or honest": rate(off, lambda c: c.outcome in CLASSES[:3]),
        "right cause, near it, or honest; nulls adequate": rate(cases, lambda c: c.outcome in CLASSES[:3]),
        "called adequate above its noise floor": rate(off, lambda c: c.outcome == CLASSES[4]),
        "effect on top named": rate(on_top, lambda c: c.top_named),
        "lacks nothing: adequate, nothing named": rate(whole, lambda c: c.outcome == "right"),
        "lacks nothing: warned of the recording": rate(whole, lambda c: any(s != "note" for _, s, _, _ in c.triage)),
        "90 % intervals hold the truth": Rate(sum(inside), len(inside)),
        "no answer": rate(cases, lambda c: c.outcome == "no answer"),
        "seconds, median": float(np.median([c.wall_s for c in cases])) if cases else np.nan,
        "seconds, longest": float(np.max([c.wall_s for c in cases])) if cases else np.nan,
        "seconds of processor, median": float(np.median(cpu)) if cpu else np.nan,
    }


WANTED = {
    f"wrong name at {NAMED:g} or more": "≤ 2 %",
    "wrong name whose held-out error does not fall": "none",
    "any answer whose held-out error does not fall": "none",
    "true cause first": "≥ 75 %",
    "effect on top named": "≥ 85 %",
    "lacks nothing: adequate, nothing named": "≥ 98 %",
    "90 % intervals hold the truth": "85 to 95 %",
}


def page(
    path: Path, cases: Sequence[Judged], drawn: int, results: dict[str, Any], ledger: Sequence[dict[str, str]]
) -> str:
    """The page on wrong descriptions and recordings, Markdown; `reading` and `before` of `path` are taken in."""
    engines = sorted({r["engine"] for r in results.values()})
    opened = sum(e["why"].startswith("answers opened") for e in ledger)
    many = "" if len(engines) == 1 else " (**more than one**)"
    scores = [(k, shown(v), WANTED.get(k, "")) for k, v in headline(cases).items()]
    recordings = [r for r in ("hammer", "log", "both") if any(c.recording == r for c in cases)]
    by_class = [
        (kind, *(sum(c.outcome == kind and c.recording == r for c in cases) for r in recordings),
         sum(c.outcome == kind for c in cases))
        for kind in CLASSES
    ]  # fmt: skip
    robots = [
        (robot, len(here), rate(here, lambda c: bool(c.wrong)),
         rate([c for c in here if not c.lacks_nothing], lambda c: c.cause_first))
        for robot in sorted({c.robot for c in cases})
        if (here := [c for c in cases if c.robot == robot])
    ]  # fmt: skip
    parts = [
        "# Proof: wrong descriptions and recordings", "",
        f"{len(cases)} of {drawn} cases, judged by engine {', '.join(engines)}{many}; the answers have been opened "
        f"{often(opened)}.", "",
        EXPLAINED, "",
        *table(("score", "measured", "wanted"), scores), "",
        *table(("answers", *recordings, "together"), by_class), "",
        *reading(path, engines),
        "## By way of being wrong", "", *_by_way(cases), "",
        "## By robot", "", *table(("robot", "cases", "wrong name", "true cause first"), robots), "",
        "## Intervals by number", "", *by_number(cases), "",
        "## Every answer that was neither right nor near", "",
        *every([c for c in cases if c.outcome not in CLASSES[:2]]), "",
        *before(path),
        "## Ledger", "", *[f"- {e['time']}: {e['why']} (engine {e['engine']}, {e['commit']})" for e in ledger], "",
    ]  # fmt: skip
    return typeset("\n".join(parts))


def _by_way(cases: Sequence[Judged]) -> list[str]:
    rows = []
    for way in (*(w for w in WAYS if w not in LACKING_NOTHING), *LACKING_NOTHING, OWN):
        for recording in ("hammer", "log", "both"):
            here = [c for c in cases if (c.way, c.recording) == (way, recording)]
            if here:
                counts = Counter(c.outcome for c in here)
                names = Counter(h for c in here for h in c.wrong)
                rows.append(
                    (way, recording, len(here), *(counts[kind] or "" for kind in CLASSES),
                     ", ".join(f"{n} × {h}" if n > 1 else h for h, n in names.most_common()))
                )  # fmt: skip
    head = ("way", "recording", "cases", *CLASSES, "wrong names")
    told = [k for k in range(len(head)) if any(row[k] != "" for row in rows)]
    return table([head[k] for k in told], [[row[k] for k in told] for row in rows])


def by_number(cases: Sequence[Judged]) -> list[str]:
    """Which numbers' 90 % intervals hold the truth: of an effect whatever its site, of the description by its kind."""
    held: dict[str, list[bool]] = {}
    for c in cases:
        for key, good in c.inside.items():
            effect, _, rest = key.partition("@")
            quantity = rest.rpartition(".")[2]
            if effect == "parameter":  # what is called like its site, or like a part of it, is said once
                quantity = re.sub(r"\b(\w+)\.\1\b", r"\1", re.sub(r"\d+", "N", rest))
            held.setdefault(f"{effect} {quantity}", []).append(good)
    rows = [(name, Rate(sum(good), len(good))) for name, good in held.items()]
    rows.sort(key=lambda row: (row[1].value, -row[1].n))
    return table(("number", "90 % interval holds the truth"), rows) if rows else ["None."]


def every(cases: Sequence[Judged]) -> list[str]:
    """One row per case, the worst first."""
    rows = []
    for c in sorted(cases, key=lambda c: (-CLASSES.index(c.outcome), c.way, c.recording)):
        said = " + ".join(", ".join(f"{h} {p:.2f}" for h, p in g[:3]) for g in c.groups if g)
        errors = ", ".join(f"{100 * b:.3g} → {100 * a:.3g} %" for b, a in c.held_out)
        errors += f" ({c.floor:.2g} × floor)" if c.floor is not None else ""
        kinds = Counter(kind or re.sub(r"[\d.+-]+|'[^']*'|\bjoint\S+", "…", text)[:30] for kind, _, text, _ in c.triage)
        triage = ", ".join(f"{n} × {k}" if n > 1 else k for k, n in kinds.most_common(3))
        shows = "" if c.shown is None else f"{c.shown:.0f}"
        case = (c.outcome, c.way, c.recording, c.robot, c.size, shows, c.top)
        rows.append((*case, c.verdict, said or re.sub(r"\S*/", "", c.complaint)[:80], errors, triage, c.name[:6]))
    head = ("", "way", "recording", "robot", "how far", "shows", "on top")
    head += ("verdict", "said", "held out", "triage", "case")
    return table(head, rows) if rows else ["None."]


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """A Markdown table."""
    cells = [[str(x).replace("|", "/") for x in row] for row in rows]
    return [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *(f"| {' | '.join(row)} |" for row in cells)]


def shown(value: object) -> str:
    """A score as it is printed."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)
