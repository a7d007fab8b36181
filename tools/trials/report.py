"""The proof as people read it: a Markdown page with tables, and its figures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from tools.trials import baselines, score
from tools.trials.score import Rate, Scored

WANTED = {
    "false alarms": "≤ 5 %",
    "top-1 (above twice visible)": "≥ 85 %",
    "top-3 (above twice visible)": "≥ 95 %",
    "pairs, exact set": "≥ 65 % (logs)",
    "credible set holds the truth": "≥ 90 %",
    "mean size of the credible set": "≤ 2",
    "calibration error": "≤ 0.05",
    "wrong name on unknown physics": "≤ 15 %",
    "right joint on unknown physics": "≥ 70 %",
    "90 % intervals hold the truth": "90 %",
    "held-out gain over the true model's": "≥ 0.9",
}


def page(
    path: Path, title: str, cases: Sequence[Scored], results: dict[str, dict[str, Any]], split: Path,
    without: dict[str, list[str]], ledger: Sequence[dict[str, str]], real: str = "",
) -> None:  # fmt: skip
    """Write `path` (Markdown) and figures beside it in a folder of the same name."""
    figures = path.with_suffix("")
    figures.mkdir(parents=True, exist_ok=True)
    _calibration(figures / "calibration.png", cases)
    _power(figures / "power.png", cases)
    _confusion(figures / "confusion.png", cases)
    name = figures.name
    kinds = ", ".join(f"{sum(c.kind == k for c in cases)} {k}" for k in dict.fromkeys(c.kind for c in cases))
    parts = [
        f"# {title}", "",
        f"{len(cases)} cases: {kinds}. Engine {' '.join(sorted({r['engine'] for r in results.values()}))}, answers "
        f"opened {len(ledger)} time(s), last {ledger[-1]['time']}.", "",
        "Every rate with Wilson's 95 % interval. Sizes are multiples of the smallest visible size of each effect on "
        "its own recording (`tools/trials/visible.py`); `python -m tools.trials --help` says how to run this again.",
        "",
        "## Scores", "", *_scores(cases), "",
        "## By kind of recording", "", *_by_recording(cases), "",
        "## By effect", "", "Above twice the smallest visible size.", "", *_effects(cases), "",
        f"![power]({name}/power.png)", "", f"![calibration]({name}/calibration.png)", "",
        f"![confusion]({name}/confusion.png)", "",
        "## Beside simpler rules", "", *_baselines(cases, results), "",
        "## What metadata gives away", "", *_leaks(cases, split, without), "",
        "## Wrong answers", "", *_wrong(cases), "",
        "## Openings", "", *[f"- {e['time']} {e['why']} (engine {e['engine']}, {e['commit']})" for e in ledger], "",
    ]  # fmt: skip
    path.write_text("\n".join(parts) + (f"\n{real.strip()}\n" if real else ""))


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    return [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *(f"| {' | '.join(map(str, r))} |" for r in rows)]


def _shown(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _scores(cases: Sequence[Scored]) -> list[str]:
    found = score.headline(cases)
    return _table(("score", "measured", "wanted"), [(k, _shown(v), WANTED.get(k, "")) for k, v in found.items()])


def _by_recording(cases: Sequence[Scored]) -> list[str]:
    recordings = sorted({c.recording for c in cases})
    columns = {r: score.headline([c for c in cases if c.recording == r]) for r in recordings}
    names = list(next(iter(columns.values()))) if columns else []
    return _table(("score", *recordings), [(n, *(_shown(columns[r][n]) for r in recordings)) for n in names])


def _effects(cases: Sequence[Scored]) -> list[str]:
    return _table(("effect", "top-1", "top-3"), [(n, *rates) for n, rates in score.by_effect(cases).items()])


def _baselines(cases: Sequence[Scored], results: dict[str, dict[str, Any]]) -> list[str]:
    one = [c for c in cases if c.kind in ("single", "chain")]
    null = [c for c in cases if c.kind == "none"]
    rows: list[tuple[str, object, object]] = [
        ("twin diagnose", score.rate(one, lambda c: c.top1), score.rate(null, lambda c: bool(c.named))),
        ("most frequent answer, always", baselines.chance(cases), Rate(len(null), len(null))),
        ("best fit of all finalists, always", *baselines.by_finalists(cases, results, "fit")),
        ("Bayes information criterion", *baselines.by_finalists(cases, results, "bic")),
    ]
    fooled, share = baselines.impostors(cases, results)
    note = (
        "With the truth struck from the list, the strongest impostor explains more than half of what the truth "
        f"explains in {fooled}; in the median {share:.0%}."
    )
    return [*_table(("rule", "top-1, all sizes", "false alarms"), rows), "", note]


def _leaks(cases: Sequence[Scored], split: Path, without: dict[str, list[str]]) -> list[str]:
    if len(cases) < 12:
        return ["Too few cases."]
    found = baselines.leak_probe(cases, split, without)
    return _table(("probe", "right"), list(found.items()))


def _wrong(cases: Sequence[Scored]) -> list[str]:
    rows = []
    for c in cases:
        good = {"none": not c.named, "outside": not c.named, "pair": c.exact}.get(c.kind, c.top1)
        if not good:
            truth = " + ".join(f"{t} ×{m:.1f}" for t, m in zip(c.truth, c.multiples, strict=True)) or "nothing"
            said = " + ".join(f"{g[0][0]} {g[0][1]:.2f}" for g in c.groups if g) or c.verdict
            rows.append((c.name, c.recording, c.kind, truth, said))
    return _table(("case", "recording", "kind", "concealed (× smallest visible)", "said"), rows)


def _calibration(path: Path, cases: Sequence[Scored]) -> None:
    error, curve = score.calibration([score.claim(c) for c in cases if c.kind in ("none", "single", "chain")])
    figure, axes = plt.subplots(figsize=(4.2, 4.0), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    for p, found in curve:
        low, high = found.interval
        axes.plot([p, p], [low, high], color="C0", lw=1.2)
        axes.plot(p, found.value, "o", color="C0", ms=3 + 1.2 * np.sqrt(found.n))
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="probability claimed", ylabel="share that was right",
             title=f"calibration error {error:.3f}")  # fmt: skip
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _power(path: Path, cases: Sequence[Scored]) -> None:
    recordings = sorted({c.recording for c in cases})
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
