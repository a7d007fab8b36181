"""The proof as people read it: a Markdown page with tables, and its figures."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from tools.trials import baselines, score
from tools.trials.cases import SIZES
from tools.trials.score import Rate, Scored, often
from tools.trials.store import before, reading, typeset

WANTED: dict[str, tuple[str, float]] = {  # sign: at most, at least
    "false alarms": ("≤", 0.05),
    "top-1 (above twice visible)": ("≥", 0.85),
    "top-3 (above twice visible)": ("≥", 0.95),
    "credible set holds the truth": ("≥", 0.90),
    "mean size of the credible set": ("≤", 2.0),
    "calibration error": ("≤", 0.05),
    "wrong name on unknown physics": ("≤", 0.15),
    "90 % intervals hold the truth": ("≥", 0.85),
    "held-out gain over the true model's": ("≥", 0.9),
    "held-out error over its noise floor, median": ("≤", score.HELD_ROOM),
    "held-out error over the true model's, median": ("≤", score.HELD_ROOM),
}
FAULTS = (
    "false alarm",
    "wrong name on unknown physics",
    "wrong name",
    "right effect, wrong site",
    "truth among the rivals",
    "one too many",
    "pair: a wrong name",
    "pair: one missed",
    "pair: both missed",
    "seen, not named",
    "not seen",
    "null not called adequate",
    "no answer",
)  # the worst first
EXPLAINED = """\
Each case is a robot near the description, each number drawn within the tolerances that the description states;
something is concealed in it, or nothing. Another code than the twin's records it: mass matrices from Kane's
equations, links that bend as beams in part of the cases, cascade servos, many slip elements, gas-law compensators,
friction with memory, encoders that count, blows that double, H1 averages, coherence estimated from few hits, channels
that are noise. `twin diagnose` is called as a user would, with the recording alone. Answers are kept apart under a
hash and opened by the scorer only; every opening is listed below.

A *size* is a multiple of the smallest visible size: where the effect, after everything that nobody knows exactly has
moved to hide it, makes a log-likelihood ratio of 8 (`tools/trials/visible.py`). Sizes here are log-uniform from
{sizes[0]:g} to {sizes[1]:g} times that, often far below what one would call a fault: the rates say what the recordings
allow, not what a workshop meets. *Clear* means twice the smallest visible size or more. Every rate has Wilson's 95 %
interval."""


def page(
    path: Path, cases: Sequence[Scored], results: dict[str, dict[str, Any]], split: Path,
    without: dict[str, list[str]], ledger: Sequence[dict[str, str]], manifest: dict[str, Any],
) -> None:  # fmt: skip
    """Write `path` (Markdown) and figures beside it in a folder of the same name; `reading` and `before` are taken in.

    `manifest`: of the split, of which `cases` have a result.
    """
    figures = path.with_suffix("")
    figures.mkdir(parents=True, exist_ok=True)
    _calibration(figures / "calibration.png", cases)
    _power(figures / "power.png", cases)
    _confusion(figures / "confusion.png", cases)
    name = figures.name
    kinds = ", ".join(f"{n} {k}" for k in ("none", "single", "pair", "outside", "chain")
                      if (n := sum(c.kind == k for c in cases)))  # fmt: skip
    engines = sorted({r["engine"] for r in results.values()})
    openings = [e for e in ledger if e["why"].startswith("answers opened")]
    parts = [
        "# Proof: three axes", "",
        f"{len(cases)} of {len(manifest['cases'])} cases ({kinds}), judged by engine {', '.join(engines)}"
        f"{'' if len(engines) == 1 else ' — **more than one**'}; the answers have been opened {often(len(openings))}.",
        "", EXPLAINED.format(sizes=manifest.get("sizes", SIZES)), "",
        "Run it again: `make proof`; other mixes and sizes: `python -m tools.trials --help`.", "",
        "## Scores", "", *_scores(cases), "",
        *reading(path, engines),
        "## Where it is weak", "", *_weak(cases), "",
        "## By kind of recording", "", *_by_recording(cases), "",
        "## Power", "", f"![Share found and share named rightly against size]({name}/power.png)", "",
        "## How much a probability is worth", "",
        f"![Probability claimed against share right, nulls and clear effects]({name}/calibration.png)", "",
        "Circles grow with the number of cases; bars are 95 % intervals.", "",
        "## By effect", "", "Clear effects, one alone.", "", *_effects(cases), "",
        f"![What was concealed against the first answer]({name}/confusion.png)", "",
        "All sizes, without pairs. The last columns are verdicts without a name.", "",
        "## What else the robot and the recording were like", "", *_circumstances(cases), "",
        "## Beside simpler rules", "", *_baselines(cases, results, split, without), "",
        "## What metadata gives away", "", *_leaks(cases, split, without), "",
        "## Every answer that was not right", "", *_wrong(cases), "",
        *before(path),
        "## Ledger", "", *[f"- {e['time']}: {e['why']} (engine {e['engine']}, {e['commit']})" for e in ledger], "",
    ]  # fmt: skip
    path.write_text(typeset("\n".join(parts)), encoding="utf-8")


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    return [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *(f"| {' | '.join(map(str, r))} |" for r in rows)]


def _shown(value: object) -> str:
    return "–" if value != value else f"{value:.3g}" if isinstance(value, float) else str(value)


def _met(name: str, value: object) -> str:
    """What was wanted, and whether the measured value, or only its interval, reaches it."""
    if name not in WANTED:
        return ""
    sign, limit = WANTED[name]
    wanted = f"{sign} {limit:.0%}" if isinstance(value, Rate) else f"{sign} {limit:g}"
    if (isinstance(value, Rate) and not value.n) or value != value:
        return wanted

    def reached(x: float) -> bool:
        return x <= limit if sign == "≤" else x >= limit

    if isinstance(value, Rate):
        low, high = value.interval
        sure = reached(high if sign == "≤" else low)
        return f"{wanted}: {'yes' if sure else 'yes, within the interval' if reached(value.value) else '**no**'}"
    return f"{wanted}: {'yes' if reached(float(value)) else '**no**'}"  # type: ignore[arg-type]


def _scores(cases: Sequence[Scored]) -> list[str]:
    """What was measured; references of true models may not have been."""
    found = {k: v for k, v in score.headline(cases).items() if (v.n if isinstance(v, Rate) else v == v)}
    return _table(("score", "measured", "wanted"), [(k, _shown(v), _met(k, v)) for k, v in found.items()])


def _weak(cases: Sequence[Scored]) -> list[str]:
    """Classes of wrong answers, the worst first, and the effects that are met least."""
    faults = [score.fault(c) for c in cases]
    rows = []
    for fault in FAULTS:
        here = [c for c, f in zip(cases, faults, strict=True) if f == fault]
        if here:
            faint = sum(bool(c.truth) and c.size < score.VISIBLE for c in here)
            kinds = Counter(c.recording for c in here)
            rows.append((fault, len(here), faint, ", ".join(f"{k}: {n}" for k, n in kinds.most_common())))
    lines = _table(("wrong answer", "cases", "of them not clear", "recording"), rows) if rows else ["No wrong answer."]
    poor = [(n, r) for n, (r, _) in score.by_effect(cases).items() if r.value < 0.5]
    if poor:
        named = ", ".join(f"{n} {r.k}/{r.n}" for n, r in sorted(poor, key=lambda item: item[1].value))
        lines += ["", f"Clear effects that were named first in less than half of their cases: {named}."]
    crashed = [c for c in cases if c.verdict == "failed"]
    if crashed:
        said = Counter(c.complaint for c in crashed)
        lines += ["", "Without an answer:", "", *(f"- {n} × `{text}`" for text, n in said.most_common())]
    return lines


def _by_recording(cases: Sequence[Scored]) -> list[str]:
    recordings = sorted({c.recording for c in cases})
    columns = {r: score.headline([c for c in cases if c.recording == r]) for r in recordings}
    names = list(next(iter(columns.values()))) if columns else []
    return _table(("score", *recordings), [(n, *(_shown(columns[r][n]) for r in recordings)) for n in names])


def _circumstances(cases: Sequence[Scored]) -> list[str]:
    """False alarms and top-1 by what has nothing to do with the concealed effect."""
    rows = []
    for key in ("measured", "same_q1", "friction", "compensator"):
        for value in sorted({str(c.circumstances[key]) for c in cases if key in c.circumstances}):
            here = [c for c in cases if str(c.circumstances.get(key)) == value]
            clear = [c for c in here if c.kind in ("single", "chain") and c.size >= score.VISIBLE]
            null = [c for c in here if c.kind == "none"]
            label = "one q₁ in all postures" if key == "same_q1" else key
            said = {"True": "yes", "False": "no"}.get(value, value)
            rows.append(
                (f"{label}: {said}", score.rate(null, lambda c: bool(c.named)), score.rate(clear, lambda c: c.top1))
            )
    return _table(("", "false alarms", "top-1, clear"), rows)


def _effects(cases: Sequence[Scored]) -> list[str]:
    return _table(("effect", "top-1", "top-3"), [(n, *rates) for n, rates in score.by_effect(cases).items()])


def _baselines(
    cases: Sequence[Scored], results: dict[str, dict[str, Any]], split: Path, without: dict[str, list[str]]
) -> list[str]:
    one = [c for c in cases if c.kind in ("single", "chain")]
    null = [c for c in cases if c.kind == "none"]
    always = Rate(len(null), len(null))
    rows: list[tuple[str, object, object]] = [
        ("twin diagnose", score.rate(one, lambda c: c.top1), score.rate(null, lambda c: bool(c.named))),
        ("most frequent answer, always", baselines.chance(cases), always),
        ("best correlation with the misfit, always", baselines.naive(cases, split, without), always),
        ("best fit of all finalists, always", *baselines.by_finalists(cases, results, "fit")),
        ("BIC forward selection among them", *baselines.by_finalists(cases, results, "bic")),
    ]
    lines = _table(("rule", "top-1, all sizes", "false alarms"), rows)
    fooled, share = baselines.impostors(cases, results)
    if fooled.n:
        lines += ["", "With the truth struck from the list, the strongest impostor explains more than half of what the "
                  f"truth explains in {fooled}; in the median {share:.0%}."]  # fmt: skip
    held = baselines.freed([c for c in one if c.size >= score.VISIBLE])
    told = "the model as described {as_given:.3g}, all its parameters freed {before:.3g}, diagnosed {after:.3g}"
    return [*lines, "", f"Held-out error over its noise floor, median of clear effects: {told.format(**held)}."]


def _leaks(cases: Sequence[Scored], split: Path, without: dict[str, list[str]]) -> list[str]:
    if len(cases) < 12:
        return ["Too few cases."]
    found = baselines.leak_probe(cases, split, without)
    return _table(("probe", "right"), list(found.items()))


def _wrong(cases: Sequence[Scored]) -> list[str]:
    rows = []
    for c in cases:
        if fault := score.fault(c):
            truth = " + ".join(f"{t} ×{m:.1f}" for t, m in zip(c.truth, c.multiples, strict=True)) or "nothing"
            said = " + ".join(", ".join(f"{h} {p:.2f}" for h, p in g[:3]) for g in c.groups if g) or c.verdict
            rows.append((FAULTS.index(fault), fault, c.name[:6], c.recording, c.kind, truth, said))
    head = ("", "case", "recording", "kind", "concealed (× smallest visible)", "said")
    return _table(head, [row[1:] for row in sorted(rows)])


def _calibration(path: Path, cases: Sequence[Scored]) -> None:
    error, curve = score.calibration([score.claim(c) for c in score.judged(cases)])
    figure, axes = plt.subplots(figsize=(4.2, 4.0), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    for p, found in curve:
        low, high = found.interval
        axes.plot([p, p], [low, high], color="C0", lw=1.2)
        axes.plot(p, found.value, "o", color="C0", ms=3 + 1.2 * np.sqrt(found.n))
    axes.set(xlim=(0, 1.06), ylim=(0, 1.06), xlabel="probability claimed", ylabel="share that was right",
             title=f"calibration error {error:.3f}")  # fmt: skip
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _power(path: Path, cases: Sequence[Scored]) -> None:
    recordings, sizes = sorted({c.recording for c in cases}), (1, 2, 4, 8, 16, 30)
    figure, all_axes = plt.subplots(1, len(recordings), figsize=(3.6 * len(recordings), 3.4), layout="constrained",
                                    sharey=True, squeeze=False)  # fmt: skip
    for axes, recording in zip(all_axes[0], recordings, strict=True):
        rows = [r for r in score.power([c for c in cases if c.recording == recording]) if r[1].n]
        for index, label, colour in ((1, "something found", "C0"), (2, "named rightly", "C1")):
            x = np.array([r[0] for r in rows])
            rates = [r[index] for r in rows]
            axes.plot(x, [r.value for r in rates], "o-", color=colour, label=label, ms=4)
            if rows:
                axes.fill_between(x, *np.array([r.interval for r in rates]).T, color=colour, alpha=0.15, lw=0)
        axes.set(xscale="log", xlabel="size / smallest visible", title=recording, ylim=(0, 1.02))
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.set_xlim(1, 30)
        axes.minorticks_off()
        axes.axvline(score.VISIBLE, color="0.7", lw=1)
    all_axes[0][0].set_ylabel("share of cases")
    all_axes[0][0].legend(frameon=False, loc="lower right")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _confusion(path: Path, cases: Sequence[Scored]) -> None:
    rows, columns, table = score.confusion(cases)
    if not rows:
        return
    size = (2.6 + 0.34 * len(columns), 2.0 + 0.3 * len(rows))
    figure, axes = plt.subplots(figsize=size, layout="constrained")
    axes.imshow(table / np.maximum(table.sum(1, keepdims=True), 1), cmap="Blues", vmin=0, vmax=1)
    for i, j in zip(*np.nonzero(table), strict=True):
        dark = table[i, j] > 0.6 * table[i].sum()
        axes.text(j, i, table[i, j], ha="center", va="center", fontsize=8, color="w" if dark else "k")
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right", fontsize=8)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    axes.set(xlabel="first answer", ylabel="concealed")
    figure.savefig(path, dpi=130)
    plt.close(figure)
