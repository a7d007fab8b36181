"""The result of a diagnosis: what is missing, how sure, how much better the model becomes. It prints itself.

Whatever the recording (hammer test, modal table, motion log), an engine hands over one :class:`Finding`; a
:class:`Verdict` is one finding, or several settled on one model.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.decide import Decision
from twin.diagnose.departures import STRAINED, departures, far_off
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.note import Note
from twin.diagnose.records import STAGES, Record
from twin.diagnose.refit import Fitted
from twin.identify.damping_transfer import Transfer
from twin.identify.descent import ASTRAY
from twin.identify.uncertainty import beside_prior, interval
from twin.model.parameters import Parameter
from twin.result import Result, listed, no_model, written
from twin.robot.description import Robot
from twin.table import Table

if TYPE_CHECKING:
    from twin.diagnose.torque_following import Following
    from twin.model.torque_rows import Bands

Word = Literal["adequate", "named", "ambiguous", "located", "unexplained"]
Source = Literal["frf-campaign", "modal-table", "motion-log"]

PARTS = ("train", "held_out")
MOVED = 2.0  # of them: what is told though the description allows it
MOVED_TIMES = 1.5  # the same of a number whose tolerance the description does not state; by eye
SAME_SPRING = 0.01  # of the logarithm of a stiffness
NEGLIGIBLE = 1e-12  # probability below which an alternative is not listed
ONE_BY_ONE = 5  # numbers of the description that have a sentence each, the farthest off
MEANING: dict[Word, str] = {
    "adequate": "adequate: nothing is missing that these recordings could show",
    "named": "named: what is missing stands out, each one effect at one site",
    "ambiguous": "ambiguous: these recordings cannot tell the following apart",
    "located": "located: the site is clear, no known effect fits",
    "unexplained": "unexplained: a mismatch beyond noise that no known effect explains",
}
PARTLY = (
    "unexplained: what follows explains a part; beyond it and noise a mismatch is left that no known effect explains"
)


@dataclass(frozen=True)
class Candidate:
    """One thing that may be missing, fitted.

    Attributes:
        effect, site: as in the vocabulary, or ``parameter`` or ``discovered``.
        ln_bayes_factor: over the base model refitted to the same recording, of what both were fitted to.
        robot: the description with it, refitted.
        parameters: name → ``value``, ``unit``, ``interval90``; lists where the parameter is a list.
        formula: of a discovered law.
        words: what an entry says in words: the joint that a coupled drive belongs to, the axis of a resonator.
    """

    effect: str
    site: str
    ln_bayes_factor: float
    robot: Robot
    parameters: dict[str, Any]
    formula: str | None = None
    words: dict[str, str] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """``EFFECT@SITE``."""
        return f"{self.effect}@{self.site}"

    @property
    def title(self) -> str:
        """``EFFECT at SITE, WORD VALUE``, for lists."""
        return ", ".join([f"{self.effect} at {self.site}", *(f"{word} {value}" for word, value in self.words.items())])

    @property
    def phrase(self) -> str:
        """The same for sentences: what a model is with or without."""
        return f"the correction of {self.site}" if self.effect == "parameter" else self.title


@dataclass(frozen=True)
class Missing:
    """The first answer for one thing that is missing, and who else it could be.

    Attributes:
        alternatives: with their probabilities, most probable first.
        evidence: one sentence a person can check.
    """

    first: Candidate
    probability: float
    alternatives: tuple[tuple[Candidate, float], ...]
    evidence: str

    @property
    def rivals(self) -> list[tuple[Candidate, float]]:
        """Alternatives that cannot be dismissed."""
        return [(c, p) for c, p in self.alternatives if p >= calibration()["alternative"]]

    def data(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        data: dict[str, Any] = {
            "effect": self.first.effect, "site": self.first.site, "probability": self.probability,
            "alternatives": [{"effect": c.effect, "site": c.site, "probability": p} for c, p in self.alternatives],
            "parameters": self.first.parameters, "evidence": self.evidence,
        }  # fmt: skip
        if self.first.words:
            data["words"] = self.first.words
        if self.first.formula is not None:
            data["formula"] = self.first.formula
        return data


@dataclass
class Finding:
    """What one recording says.

    Attributes:
        recording: the file, as given; ``source`` its kind.
        word: the verdict.
        missing: empty unless something is named, ambiguous or located.
        none, other: probabilities that nothing, or something without a name here, is missing.
        given, base, robot: the description as it came, refitted, and with the answer.
        apart: ``EFFECT@SITE`` → sentences on how far an answer can be told from what does nearly the same.
        written: ``robot`` with what the fit held for ordinary and the description has no number for, if anything.
        following: a description whose links, axes and payloads another recording has settled → the same, with the rest
            where this one then has it.
        bare: the same as ``following`` of a log's base model: without the log's names.
        error: ``as_given``, ``before``, ``after`` → ``train``, ``held_out``; ``noise_floor``.
        held_out: names of postures, runs or blows not used; ``in_turn``: each was left out once, and used otherwise.
        records: the recording beside the three models.
        location: where the base model misses, as in diagnosis.json.
        sites: site → what freeing it alone would gain, in ln likelihood or evidence.
        smallest_visible: per effect and site, the size this recording would have shown.
        warnings: of the triage, one line each.
        fit: of ``robot``, where another recording can build on it.
        finalists: what the answer was chosen from, as :func:`twin.diagnose.decide.finalists` has it.
        gain: ln likelihood that the answer of a hammer test gains over the base model, all angles of postures free; of
            a log, on the runs left out in turn. ``None``: as the records have it.
        held_out_misfit: χ² per datum of what was held out, doubt of the base model's numbers beside its noise; 0 where
            not known.
        fits: the base model refitted, and the model with the answer, where a fit of theirs says how sure they are.
        unsure: relative error of what the answer predicts of whole decays that doubt of its own numbers makes.
        damping: how well the answer predicts damping in postures that were held out.
        bands: low-passes through which a motion log was fitted; ``content`` the log without its faults.
        alone: ``train``, ``held_out`` of a log's own answer, where ``before`` and ``after`` have the links of all.
    """

    recording: str
    source: Source
    word: Word
    missing: list[Missing]
    none: float
    other: float
    given: Robot
    base: Robot
    robot: Robot
    error: dict[str, Any]
    held_out: list[str]
    records: Sequence[Record] = ()
    location: list[dict[str, Any]] = field(default_factory=list)
    sites: dict[str, float] = field(default_factory=dict)
    smallest_visible: list[dict[str, Any]] = field(default_factory=list)
    next_test: dict[str, Any] | None = None
    warnings: list[str] = field(default_factory=list)
    fit: Fitted | None = None
    finalists: tuple[dict[str, Any], ...] = ()
    gain: float | None = None
    held_out_misfit: float = 0.0
    unsure: float = 0.0
    fits: tuple[Fitted, ...] = ()
    damping: Transfer | None = None
    apart: dict[str, list[str]] = field(default_factory=dict)
    in_turn: bool = False

    written: Robot | None = None
    following: "Following | None" = None
    bare: "Following | None" = None
    bands: "Bands | None" = None
    content: Any = None
    alone: dict[str, Any] | None = None

    def with_each(self, names: Sequence[str], error: tuple[float, float], gain: float | None) -> "Finding":
        """The same with what every posture, run or blow left out in turn is missed by, before and after, held out.

        ``gain``: of a log, the fall of ½ χ² over the noise of each joint. The description as it came was fitted to
        none of them.
        """
        errors = {**self.error}
        if errors["as_given"]["held_out"] is None:
            errors["as_given"] = {**errors["as_given"], "held_out": errors["as_given"]["train"]}
        for stage, value in zip(("before", "after"), error, strict=True):
            errors[stage] = {**errors[stage], "held_out": value}
        gained = self.gain if gain is None else gain
        return replace(self, error=errors, held_out=list(names), in_turn=True, gain=gained)

    @property
    def model(self) -> Robot:
        """What is written, and what other recordings build on."""
        return self.written or self.robot


@dataclass
class Verdict(Result):
    """``twin diagnose``'s answer; ``data()`` is the content of diagnosis.json.

    Attributes:
        findings: one per recording; ``word``, ``missing``, ``none`` and ``other`` are what they say together.
        robot: the new description; ``base`` the one without what was found.
        checks: what was run on the new model: ``name``, ``value``, ``limit``, ``passed``, ``description``.
        payload_edit: what a payload would do to the model before and after.
    """

    findings: list[Finding]
    word: Word
    missing: list[Missing]
    none: float
    other: float
    base: Robot
    robot: Robot
    checks: list[dict[str, Any]] = field(default_factory=list)
    payload_edit: dict[str, Any] | None = None
    model: dict[str, str | None] = field(default_factory=no_model)
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    drawn_by = "twin.report.diagnosis"

    @classmethod
    def of(cls, finding: Finding) -> "Verdict":
        """The verdict of a single recording."""
        return cls([finding], finding.word, finding.missing, finding.none, finding.other, finding.base, finding.model)

    @property
    def error(self) -> dict[str, Any]:
        """As in diagnosis.json: numbers, or recording → number where there are several."""
        if len(self.findings) == 1:
            return self.findings[0].error

        def by_recording(stage: str, part: str) -> dict[str, Any]:
            return {f.recording: f.error[stage][part] for f in self.findings}

        both: dict[str, Any] = {s: {part: by_recording(s, part) for part in ("train", "held_out")} for s in STAGES}
        return {**both, "noise_floor": {f.recording: f.error["noise_floor"] for f in self.findings}}

    @property
    def unclear(self) -> float:
        """Probability of all known effects together where none is told; 0 where it would be told as 0.00."""
        rest = 0.0 if self.missing else 1 - self.none - self.other
        return rest if rest >= 0.005 else 0.0

    @property
    def likeliest(self) -> str:
        """Of what is known but not clear, what gained most, ``EFFECT at SITE``; empty where nothing did."""
        rows = [row for f in self.findings for row in f.finalists if row["effect"] != "none" and not self.missing]
        best = max(rows, key=lambda row: row["ln_bayes_factor"], default=None)
        return f"{best['effect']} at {best['site']}" if best and best["ln_bayes_factor"] > 0 else ""

    @property
    def location(self) -> list[dict[str, Any]]:
        """Where the base model misses, recording by recording; first those that it does not do for."""
        told = sorted(self.findings, key=lambda finding: finding.word == "adequate")
        return [spot for finding in told for spot in finding.location]

    @property
    def next_test(self) -> dict[str, Any] | None:
        """What to measure next, where rivals remain or a likely name may be none."""
        if self.word not in ("ambiguous", "unexplained"):
            return None
        return next((f.next_test for f in self.findings if f.next_test), None)

    @property
    def held_out(self) -> list[str]:
        """Postures and runs not used."""
        return [name for finding in self.findings for name in finding.held_out]

    @property
    def smallest_visible(self) -> list[dict[str, Any]]:
        """The smallest size that any of the recordings would have shown; a spring's the stiffest."""
        best: dict[tuple[str, str, str], dict[str, Any]] = {}
        for item in (item for finding in self.findings for item in finding.smallest_visible):
            if not np.isfinite(item["value"]):
                continue
            key = item["effect"], item["site"], item["parameter"]
            wins = max if item["parameter"] == "stiffness" else min
            best[key] = wins((best.get(key, item), item), key=lambda one: one["value"])
        return list(best.values())

    def data(self) -> dict[str, Any]:
        """Plain data in the format ``twin-diagnosis``."""
        data = {
            "format": "twin-diagnosis", "version": 2, "verdict": self.word,
            "effects": [missing.data() for missing in self.missing],
            "probabilities": {"none": self.none, "other": self.other},
            "location": self.location, "error": self.error, "smallest_visible": self.smallest_visible,
            "next_test": self.next_test, "model": self.model, "held_out": self.held_out,
            "triage": [_note(text).data() for finding in self.findings for text in finding.warnings],
            "finalists": [row for finding in self.findings for row in finding.finalists],
            "checks": self.checks, "payload_edit": self.payload_edit,
            "recordings": [
                {"recording": f.recording, "kind": f.source, "verdict": f.word,
                 "effects": [m.data() for m in f.missing], "probabilities": {"none": f.none, "other": f.other},
                 "sites": f.sites, "parts": [_part(record) for record in f.records]}
                for f in self.findings
            ],
            "files": self.files, "provenance": self.origin,
        }  # fmt: skip
        return dict(_finite(data))

    def tables(self) -> list[Table]:
        """Answers with their probabilities, parameters of the first answers, errors by recording."""
        answers: list[tuple[str, str]] = []
        for missing in self.missing:
            answers.append((missing.first.title, f"{missing.probability:.2f}"))
            answers += [(f"or {rival.title}", f"{p:.2f}") for rival, p in missing.rivals]
        answers.append(("nothing missing", f"{self.none:.2f}"))
        answers += [("something known but not clear", f"{self.unclear:.2f}")] if self.unclear else []
        answers.append(("something else", f"{self.other:.2f}"))
        numbers = [(m.first.title, row) for m in self.missing for row in parameter_rows(m.first.parameters)]
        errors = [
            (finding.recording, stage.replace("_", " "), *(_percent(finding.error[stage][p]) for p in PARTS))
            for finding in self.findings
            for stage in STAGES
        ]
        found = [
            Table(("what is missing", "probability"), answers, (1,)),
            Table(("", "parameter"), numbers),
            Table(("recording", "error", "used", "held out"), errors, (2, 3)),
        ]
        return [table for table in found if table.rows]

    def __str__(self) -> str:
        lines, said = [PARTLY if self.missing and self.word == "unexplained" else MEANING[self.word]], set[str]()
        for missing in self.missing:
            lines.append(f"  {missing.first.title}   probability {missing.probability:.2f}")
            lines += [f"      {row}" for row in parameter_rows(missing.first.parameters)]
            if missing.first.formula:
                lines.append(f"      torque {missing.first.formula}")
            lines += [f"  or {rival.title}   probability {p:.2f}" for rival, p in missing.rivals]
            sentences = [text for text in _SENTENCES.split(missing.evidence) if text not in said]
            said.update(sentences)  # the error of a recording is told once
            lines += [f"  {' '.join(sentences)}"] if sentences else []
        first = f" (likeliest {self.likeliest})" if self.likeliest else ""
        unclear = f"something known but not clear {self.unclear:.2f}{first}, " if self.unclear else ""
        lines.append(f"  nothing missing {self.none:.2f}, {unclear}something else {self.other:.2f}")
        for finding in self.findings:
            if len(self.findings) > 1:
                lines.append(f"  {finding.recording}: {finding.word}")
            if finding.word == "unexplained" and any(finding.sites.values()):
                where = ", ".join(
                    f"{site} {gain:.0f}" for site, gain in sorted(finding.sites.items(), key=lambda item: -item[1])[:3]
                )
                lines.append(f"  a law without a name would gain most at (ln evidence): {where}")
            for stage in STAGES:
                item = finding.error[stage]
                held = "" if item["held_out"] is None else f", held out {item['held_out']:.2%}"
                lines.append(f"  error {stage.replace('_', ' '):9s} {item['train']:.2%}{held}")
            floor = finding.error["noise_floor"]
            noise, turn = "unknown" if floor is None else f"{floor:.2%}", " in turn" if finding.in_turn else ""
            lines.append(f"  noise floor {noise}; held out{turn}: {listed(finding.held_out) or 'nothing'}")
        if self.next_test:
            lines.append(f"  next test: {self.next_test['description']}")
        lines += [f"  triage: {text}" for finding in self.findings for text in finding.warnings]
        for check in self.checks:
            lines.append(f"  {'check' if check['passed'] else 'check FAILED'}: {check['description']}")
        if self.payload_edit:
            lines.append(f"  edit: {self.payload_edit['description']}")
        if self.files:
            lines.append(f"  {written(self.files)}")
        return "\n".join(lines)


_SENTENCES = re.compile(r"(?<=[.!?]) ")  # ends of sentences


def _percent(error: float | None) -> str:
    return "" if error is None else f"{error:.2%}"


def _note(text: str) -> Note:
    """A sentence of the triage, of no special kind where it has none."""
    return text if isinstance(text, Note) else Note(text)


def _finite(data: Any) -> Any:
    """Plain data with ``None`` for what is not a number, which JSON cannot say."""
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    if isinstance(data, float | np.floating):
        return float(data) if np.isfinite(data) else None
    return data


def _unit(unit: str) -> str:
    """As it stands behind a number."""
    return "" if unit == "1" else f" {unit}"


def parameter_rows(parameters: dict[str, Any]) -> list[str]:
    """``gap 0.0002 rad   90 %: 0.00017 … 0.00024``, one line per number."""
    rows = []
    for name, item in parameters.items():
        many = isinstance(item["value"], list)
        values, ranges = (item["value"], item["interval90"]) if many else ([item["value"]], [item["interval90"]])
        units = item["unit"].split(", ")
        for k, (value, (low, high)) in enumerate(zip(values, ranges, strict=True)):
            title, n = f"{name}[{k}]" if many else name, _digits(low, high)
            unit = units[min(k, len(units) - 1)]
            rows.append(f"{title} {value:.{n}g}{_unit(unit)}   90 %: {low:.{n}g} … {high:.{n}g}")
    return rows


def _digits(low: float, high: float) -> int:
    """Significant digits that show two of an interval's width, four at least."""
    width, size = high - low, max(abs(low), abs(high))
    if not (np.isfinite(size) and width > 0):
        return 4
    return int(np.clip(np.ceil(np.log10(size / width)) + 2, 4, 10))


def _part(record: Record) -> dict[str, Any]:
    """Errors of one posture or run."""
    return {
        "name": record.name, "held_out": record.held_out, "error": {stage: record.error(stage) for stage in STAGES},
        "noise_floor": record.floor,
    }  # fmt: skip


# --- from the hammer engine's decision --------------------------------------------------------------------------------


def judge(decision: Decision) -> Word:
    """The word for a decision."""
    top = max(decision.alike, *decision.probability[:1], 0.0)
    if decision.none >= max(top, decision.other):
        return "adequate"
    if decision.other > top:
        return "unexplained"
    numbers = calibration()
    if rival_of(decision) or decision.none >= numbers["alternative"] or decision.nameless > numbers["nameless"] * top:
        return "ambiguous"
    return "named"


def rival_of(decision: Decision) -> Fitted | None:
    """The most probable alternative with something else in the place of the first answer, not only more beside it."""
    first = set(parts(decision.ranked[0])) if decision.ranked else set()
    rivals = (decision.ranked[k] for k in decision.rivals)
    return next((fit for fit in rivals if not first <= set(parts(fit))), None)


def missing_of(decision: Decision, base: Fitted) -> list[Missing]:
    """Answers of a decision, one for each thing in its first hypothesis; evidence is left to be written.

    A hypothesis of several things gives each its own alternatives: those that stand in its place beside the others, or
    in the place of it and some of them.
    """
    first = decision.ranked[0]
    sets = [frozenset(parts(fit)) for fit in decision.ranked]
    found = []
    for part in parts(first):
        probability = sum(p for s, p in zip(sets, decision.probability, strict=True) if part in s)
        others = []
        for fit, s, p in zip(decision.ranked, sets, decision.probability, strict=True):
            if p >= NEGLIGIBLE and part not in s and len(s - sets[0]) == 1:
                others.append((candidate(fit, next(iter(s - sets[0])), base), p))
        found.append(Missing(candidate(first, part, base), probability, tuple(others), ""))
    return found


def parts(fit: Fitted) -> list[tuple[str, str]]:
    """Effects and sites of a hypothesis, without what the description allows."""
    pieces = fit.hypothesis.pieces or (fit.hypothesis,)
    return [(piece.effect, piece.site) for piece in pieces if piece not in fit.allowed]


def candidate(fit: Fitted, part: tuple[str, str], base: Fitted) -> Candidate:
    scale = max(1.0, fit.misfit)
    gain = fit.evidence(scale) - base.evidence(scale)
    return Candidate(*part, gain, fit.robot, estimates(fit, part), words=_words(fit, part))


def _words(fit: Fitted, part: tuple[str, str]) -> dict[str, str]:
    """What an entry says in words, but for a formula, which has a place of its own."""
    for piece in fit.hypothesis.pieces:
        if (piece.effect, piece.site) == part and piece.law and piece.entries:
            values = piece.entries[0].values
            told = [p.name for p in piece.law.parameters if p.word and p.name != "formula"]
            return {name: str(values[name]) for name in told if name in values}
    return {}


def estimates(fit: Fitted, part: tuple[str, str]) -> dict[str, Any]:
    """Value, unit and 90 % interval of the parameters of one of a hypothesis' things; a list's numbers in one list."""
    at = len(fit.z) - len(fit.hypothesis.own)
    for piece in fit.hypothesis.pieces:
        if (piece.effect, piece.site) == part:
            indices = [fit.parameters.names.index(name) for name, _ in piece.scale] or range(at, at + len(piece.own))
            if piece.law and piece.scale:  # a number that is told as an effect: how far off it is
                return _off(fit, piece, indices)
            return estimates_of(fit, indices) if piece.law else _described(fit, piece.site, indices)
        at += len(piece.own)
    return {}


def _off(fit: Fitted, piece: Hypothesis, indices: Iterable[int]) -> dict[str, Any]:
    """The same of numbers that are told as an effect of one parameter: by how much they are not as described."""
    assert piece.law is not None
    (parameter,) = piece.law.parameters
    some = []
    for k in indices:
        ((_, one),) = estimates_of(fit, [k]).items()
        mean = fit.parameters[k].mean
        some.append({**one, "value": one["value"] - mean, "interval90": [end - mean for end in one["interval90"]]})
    if not parameter.length:
        return {parameter.name: some[0]}
    many = {key: [one[key] for one in some] for key in ("value", "interval90")}
    return {parameter.name: {**many, "unit": parameter.unit}}


def _described(fit: Fitted, site: str, indices: Sequence[int]) -> dict[str, Any]:
    """The same of numbers of the description at a site: coordinates of one point or link in one list.

    Of angles of postures, which are errors, those that are off by more than ``STRAINED`` tolerances, or the one that is
    off most.
    """
    found: dict[str, Any] = {}
    if any(fit.parameters[k].kind == "posture" for k in indices):
        return _angles(fit, indices)
    for k in indices:
        parameter = fit.parameters[k]
        (one,) = estimates_of(fit, [k]).values()
        if parameter.name == site:
            found[parameter.quantity] = one
            continue
        same = "*" not in site  # of one node, its sensor or a blow
        key = site.rpartition(".")[2] if same else parameter.site
        if same and parameter.kind == "link":  # beside a wrong mass the rest of its link is free
            key = parameter.name.split(".")[1]
        many = found.setdefault(key, {"value": [], "unit": one["unit"], "interval90": []})
        many["value"].append(one["value"])
        many["interval90"].append(one["interval90"])
    return found


def _angles(fit: Fitted, indices: Sequence[int]) -> dict[str, Any]:
    """Errors of angles that are off most, by posture and axis (``p4.q5``), degrees (m)."""
    ranked = [(k, off) for k, _, off in departures(fit) if k in indices]
    found: dict[str, Any] = {}
    for k, _ in [one for one in ranked if one[1] > STRAINED] or ranked[:1]:
        (one,) = estimates_of(fit, [k]).values()
        scale = 180 / np.pi if one["unit"] == "rad" else 1.0
        found[fit.parameters[k].name.removeprefix("posture.")] = {
            "value": one["value"] * scale, "unit": "°" if one["unit"] == "rad" else one["unit"],
            "interval90": [end * scale for end in one["interval90"]],
        }  # fmt: skip
    return found


def estimates_of(fit: Fitted, indices: Iterable[int]) -> dict[str, Any]:
    """Value, unit and 90 % interval of some of a fit's numbers, by the last part of their names."""
    covariance = fit.covariance
    found: dict[str, Any] = {}
    for k in indices:
        parameter = fit.parameters[k]
        ends = list(interval(parameter, *beside_prior(fit.parameters, fit.z, covariance, k)))
        name = parameter.name.rpartition(".")[2]
        found[name] = {"value": float(fit.values[k]), "unit": parameter.unit, "interval90": ends}
    for name in [name for name in found if name.endswith("[0]")]:
        stem = name[:-3]
        items = [found.pop(key) for key in [key for key in found if key.startswith(f"{stem}[")]]
        found[stem] = {
            "value": [i["value"] for i in items], "unit": ", ".join(dict.fromkeys(i["unit"] for i in items)),
            "interval90": [i["interval90"] for i in items],
        }  # fmt: skip
    return found


def elsewhere(base: Fitted, others: Sequence[Fitted]) -> list[str]:
    """Optima of the base model beside the best, in one sentence, with the springs that differ most."""
    if not others:
        return []
    springs = [k for k, p in enumerate(base.parameters) if p.kind == "spring" and p.quantity == "stiffness"]
    apart = {k: max(abs(np.log(fit.values[k] / base.values[k])) for fit in others) for k in springs}
    most = sorted((k for k in springs if apart[k] > SAME_SPRING), key=lambda k: -apart[k])[:3]
    names = ", ".join(f"{base.parameters[k].name} (by {np.expm1(apart[k]):.0%})" for k in most)
    ends = " and ".join(f"{fit.misfit:.3g}" for fit in others)
    differ = f"Most apart are {names}" if names else "Their springs agree within 1 %"
    return [
        f"the fit of the base model depends on its start: the best ends at {base.misfit:.3g} times the variance of the "
        f"noise, another start at {ends} times. {differ}"
    ]


def moved_most(fit: Fitted, most: int = 3) -> list[Note]:
    """The springs and links that a fit has farthest from the description, within what that allows, in one sentence.

    Springs without a tolerance come first: they may be far off though they move by few deviations of a usual spring.
    """
    if fit.misfit > ASTRAY:
        return []
    free, within = [], []
    for k, change, off in departures(fit):
        p = fit.parameters[k]
        if p.kind not in ("spring", "link") or off > STRAINED:  # what is strained has a sentence of its own
            continue
        told = f"{p.name} is {fit.values[k]:.4g}{_unit(p.unit)} (described {p.mean:.4g}"
        if p.source == "usual" and p.quantity == "stiffness" and abs(change) > np.log(MOVED_TIMES):
            free.append(f"{told})")
        elif off > MOVED:
            within.append(f"{told}, {off:.1f} standard deviations off)")
    texts = {
        "the fit moved springs for which the description states no tolerance": free,
        "the fit moved most, within their tolerances": within,
    }
    return [Note(f"{text}: {'; '.join(some[:most])}", "note", "note") for text, some in texts.items() if some]


def strained(fit: Fitted) -> list[Note]:
    """Described numbers that a fit takes much further than their description allows, a sentence each, farthest first.

    What is in series with such a spring, about its axis, may be all that is wrong with it.
    """
    if fit.misfit > ASTRAY:
        times = fit.misfit**0.5
        text = f"the fit still misses the recording by {times:.0f} times its noise: none of its numbers can be believed"
        return [Note(text, "note", "note")]
    found, numbers = [], []
    for k, change, off in far_off(fit):
        p, answered = fit.parameters[k], fit.parameters.names[k] in dict(fit.hypothesis.scale)
        # which of all angles is wrong, where they are the answer, too
        if p.kind == "posture":
            found.append(_elsewhere_hit(p, change, off, answered))
        else:
            numbers.append((k, off))
    return [*found, *off_descriptions(fit, numbers)]


def off_descriptions(fit: Fitted, numbers: Sequence[tuple[int, float]]) -> list[Note]:
    """That numbers of a fit, by index and deviations, farthest first, are not as described.

    A sentence each of the first ``ONE_BY_ONE``, one of all others: where many are off, no one of them says much.
    """
    told = ONE_BY_ONE if len(numbers) > ONE_BY_ONE + 1 else len(numbers)
    first, rest = numbers[:told], numbers[told:]
    notes = [_number_off(fit, k, off) for k, off in first]
    if numbers and fit.misfit > calibration()["held_out_adequate"]:
        text = (
            "the model still misses the recording. Numbers that it has far off their description may stand for what "
            "is missing: correct none of them yet"
        )
        notes.insert(0, Note(text))
    if rest:
        names = tuple(fit.parameters[k].name for k, _ in rest)
        among = ", ".join(names[:ONE_BY_ONE]) + (", …" if len(names) > ONE_BY_ONE else "")
        text = (
            f"{len(rest)} more numbers are {rest[-1][1]:.1f} to {rest[0][1]:.1f} standard deviations off their "
            f"description ({among}). So many together mean a poor description rather than as many faults"
        )
        notes.append(Note(text, "description", sites=names))
    return notes


def _elsewhere_hit(p: Parameter, change: float, off: float, answered: bool) -> Note:
    """That a posture may not be where the file says."""
    posture, _, axis = p.name.removeprefix("posture.").rpartition(".")
    wrong = f"{np.rad2deg(change):+.2g}°" if p.unit == "rad" else f"{change:+.2g} {p.unit}"
    text = (
        f"{posture}: the fit has {axis} {wrong} away from the file, {off:.1f} standard deviations off. "
        "Is that the posture that was hit?"
    )
    return Note(text, "posture", "fail" if answered else "warning")


def _distinct(*values: float, least: int = 3, most: int = 9) -> list[str]:
    """Values with so many digits, the same for all, that those which differ are told apart."""
    for digits in range(least, most + 1):
        texts = [f"{value:.{digits}g}" for value in values]
        if len(set(texts)) == len(set(values)):
            break
    return texts


def _number_off(fit: Fitted, k: int, off: float) -> Note:
    """That a number is not as described, with its value, its interval and by how many deviations."""
    p = fit.parameters[k]
    (one,) = estimates_of(fit, [k]).values()
    ends = np.ravel(one["interval90"])
    value, low, high, mean = _distinct(float(fit.values[k]), float(ends[0]), float(ends[1]), p.mean)
    told = (
        f"the fit gives {value}{_unit(p.unit)} (90 %: {low} to {high}), the description {mean}: "
        f"{off:.1f} standard deviations off"
    )
    if p.quantity == "stiffness":
        text = (
            f"{p.site}: {told}. Either the description is wrong, or something in series about the same axis is missing"
        )
    else:
        text = f"{p.name}: {told}. The described value may be wrong, or its tolerance too narrow"
    return Note(text, "description", sites=(p.name,))
