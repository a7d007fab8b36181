"""What answers about whole arms of six and seven axes are worth, and docs/proof-arms.md: pure functions over cases."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tools.trials.score import Rate, often
from tools.trials.store import before, reading, typeset
from tools.trials.wrong_score import NAMED, Judged, by_number, rate, shown, table

EXPLAINED = f"""\
Whole arms near their description, each number drawn within the tolerances that it states: *six*, six axes with a
spherical wrist (20 kg, 1.8 m); *light*, six axes of which the second to fourth are parallel; *seven*, a collaborative
arm of seven axes. Three in four have one effect concealed, of which the recording itself shows four times the smallest
visible size when all numbers within tolerance have moved to hide it. What shows is counted at every line. Another code
than the twin's records hammer tests of six postures, with blows of 100 N (*six*) or 30 N, and logs. `twin diagnose` is
asked with the recording and the description alone, on two cores (`tools/truth`, `tools/trials`).

*Named first*: the first answer listed is the effect that was concealed, at its site. A *wrong name* is any first answer
of an effect, at {NAMED:g} or more, that is not there. Every rate has Wilson's 95 % interval."""

WANTED = {
    "named first": "≥ 90 %",
    "false alarms": "≤ 3 %",
    "any answer whose held-out error does not fall": "none",
    "seconds, median": "< 60",
    "seconds, longest": "≤ 240",
}


def headline(cases: Sequence[Judged]) -> dict[str, Any]:
    """The scores."""
    nulls, concealed = [c for c in cases if not c.top], [c for c in cases if c.top]
    inside = [good for c in cases for good in c.inside.values()]
    seconds = [c.wall_s for c in cases]
    return {
        "named first": rate(concealed, first),
        "named": rate(concealed, lambda c: c.top_named),
        "false alarms": rate(nulls, lambda c: bool(c.named)),
        "nulls not called adequate": rate(nulls, lambda c: c.verdict != "adequate"),
        f"wrong name at {NAMED:g} or more": rate(cases, lambda c: bool(c.wrong)),
        "any answer whose held-out error does not fall": rate(cases, lambda c: not c.fallen),
        "90 % intervals hold the truth": Rate(sum(inside), len(inside)),
        "no answer": rate(cases, lambda c: c.verdict in ("failed", "refused")),
        "seconds, median": float(np.median(seconds)) if cases else np.nan,
        "seconds, longest": float(np.max(seconds)) if cases else np.nan,
    }


def first(case: Judged) -> bool:
    """Whether what was concealed is the first answer."""
    return bool(case.named) and case.is_top(case.named[0][0])


def page(
    path: Path, cases: Sequence[Judged], drawn: int, results: dict[str, Any], ledger: Sequence[dict[str, str]]
) -> str:
    """The page on whole arms, Markdown; `reading` and `before` of `path` are taken in."""
    engines = sorted({r["engine"] for r in results.values()})
    many = "" if len(engines) == 1 else " (**more than one**)"
    opened = sum(e["why"].startswith("answers opened") for e in ledger)
    scores = [(k, shown(v), WANTED.get(k, "")) for k, v in headline(cases).items()]
    robots = [
        (robot, recording, rate([c for c in here if c.top], first), rate([c for c in here if not c.top], _alarm),
         f"{np.median([c.wall_s for c in here]):.0f}")
        for robot in sorted({c.robot for c in cases}) for recording in ("hammer", "log")
        if (here := [c for c in cases if (c.robot, c.recording) == (robot, recording)])
    ]  # fmt: skip
    effects = [
        (effect, recording, rate(here, first))
        for recording in ("hammer", "log") for effect in sorted({c.top.partition("@")[0] for c in cases if c.top})
        if (here := [c for c in cases if c.recording == recording and c.top.partition("@")[0] == effect])
    ]  # fmt: skip
    parts = [
        "# Proof: six and seven axes", "",
        f"{len(cases)} of {drawn} cases, judged by engine {', '.join(engines)}{many}; the answers have been opened "
        f"{often(opened)}.", "", EXPLAINED, "",
        *table(("score", "measured", "wanted"), scores), "",
        *reading(path, engines),
        "## By robot", "",
        *table(("robot", "recording", "named first", "false alarms", "seconds, median"), robots), "",
        "## By effect", "", *table(("effect", "recording", "named first"), effects), "",
        "## Intervals by number", "", *by_number(cases), "",
        "## Every answer that is not right", "", *_others(cases), "",
        *before(path),
        "## Ledger", "", *[f"- {e['time']}: {e['why']} (engine {e['engine']}, {e['commit']})" for e in ledger], "",
    ]  # fmt: skip
    return typeset("\n".join(parts))


def _alarm(case: Judged) -> bool:
    return bool(case.named)


def _others(cases: Sequence[Judged]) -> list[str]:
    """One row per answer that has not what was concealed first and alone, or is not `adequate` where nothing is."""
    rows = []
    for c in cases:
        if (c.top and first(c) and not c.wrong) or (not c.top and c.verdict == "adequate"):
            continue
        said = " + ".join(", ".join(f"{h} {p:.2f}" for h, p in g[:3]) for g in c.groups if g)
        errors = ", ".join(f"{100 * b:.3g} → {100 * a:.3g} %" for b, a in c.held_out)
        rows.append((c.robot, c.recording, c.top or "nothing", c.verdict, said or c.complaint[:60], errors,
                     f"{c.wall_s:.0f}", c.name[:6]))  # fmt: skip
    head = ("robot", "recording", "concealed", "verdict", "said", "held out", "seconds", "case")
    return table(head, rows) if rows else ["None."]
