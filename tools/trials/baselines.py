"""What simpler minds would score on the same cases, and what a cheat would find who sees everything but the physics."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tools.trials.naive import best_correlated
from tools.trials.score import Rate, Scored, over_floor


def chance(cases: Sequence[Scored]) -> Rate:
    """Top-1 of always answering the most frequent hypothesis of the same kind of recording."""
    one = [c for c in cases if c.kind in ("single", "chain")]
    right = 0
    for recording in {c.recording for c in one}:
        here = [c.truth[0] for c in one if c.recording == recording]
        right += Counter(here).most_common(1)[0][1]
    return Rate(right, len(one))


def by_finalists(cases: Sequence[Scored], results: dict[str, dict[str, Any]], rule: str) -> tuple[Rate, Rate]:
    """Top-1 and false alarms of another rule on the hypotheses that the engine refitted.

    ``fit``: the best fit wins, always. ``bic``: the best Bayes information criterion wins, nothing missing included.
    """
    top, alarms = [], []
    for c in cases:
        rows = _finalists(results[c.name])
        if not rows or c.kind not in ("none", "single", "chain"):
            continue
        scores = {}
        for row in rows:
            chi2 = row["misfit"] * row["data"]
            penalty = row["own_parameters"] * np.log(max(row["data"], 2)) if rule == "bic" else 0.0
            scores[f"{row['effect']}@{row['site']}" if row["effect"] != "none" else "none"] = chi2 + penalty
        if rule == "fit" and len(scores) > 1:
            scores.pop("none", None)
        answer = min(scores, key=lambda name: scores[name])
        if c.kind == "none":
            alarms.append(answer != "none")
        else:
            top.append(c.truth[0] in c.aliases(answer))
    return Rate(sum(top), len(top)), Rate(sum(alarms), len(alarms))


def _finalists(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows with a misfit; none where the command does not tell."""
    rows = (result["diagnosis"] or {}).get("finalists") or []
    return [r for r in rows if r.get("misfit") is not None and r.get("data")]


def naive(cases: Sequence[Scored], split: Path, without: dict[str, list[str]]) -> Rate:
    """Top-1 of the signature that correlates best with the misfit of the model as described (`naive.py`)."""
    one = [c for c in cases if c.kind in ("single", "chain")]
    answers = [best_correlated(split / "recordings" / c.name, without[c.name]) for c in one]
    return Rate(sum(c.truth[0] in c.aliases(a) for c, a in zip(one, answers, strict=True)), len(one))


def freed(cases: Sequence[Scored]) -> dict[str, float]:
    """Median held-out error over its noise floor: as described, all parameters of the base model freed, diagnosed."""
    found: dict[str, list[float]] = {"as_given": [], "before": [], "after": []}
    for c in cases:
        ratios = {stage: over_floor(c, stage) for stage in found}
        for stage, ratio in ratios.items():
            if ratio is not None and None not in ratios.values():
                found[stage].append(ratio)
    return {key: float(np.median(values)) if values else float("nan") for key, values in found.items()}


def impostors(cases: Sequence[Scored], results: dict[str, dict[str, Any]]) -> tuple[Rate, float]:
    """With the truth struck from the list: how often another explains most of the misfit, and how much of it.

    The share is the median of what the strongest impostor explains of the misfit that the truth explains.
    """
    fooled, share = [], []
    for c in cases:
        rows = _finalists(results[c.name])
        if c.kind != "single" or not rows:
            continue
        misfit = {f"{r['effect']}@{r['site']}": r["misfit"] for r in rows}
        base = next((r["misfit"] for r in rows if r["effect"] == "none"), None)
        same = c.aliases(c.truth[0])
        true = [m for name, m in misfit.items() if name in same]
        rest = [m for name, m in misfit.items() if name not in same and not name.startswith("none@")]
        if base is None or not true or not rest or base <= min(true):
            continue
        taken = (base - min(rest)) / (base - min(true))
        share.append(taken)
        fooled.append(taken > 0.5)
    return Rate(sum(fooled), len(fooled)), float(np.median(share)) if share else float("nan")


def metadata(room: Path) -> np.ndarray:
    """What a cheat sees of a case without its physics: counts, sizes, noise levels."""
    row = [0.0] * 17
    for path in sorted(room.glob("*.h5")):
        with h5py.File(path) as file:
            if "postures" in file:
                postures = list(file["postures"].values())
                first = postures[0]
                brakes = {"on": 1.0, "off": 2.0}.get(str(first.attrs.get("brakes", "")), 0.0)
                coherence = np.median([np.median(p["coherence"][()]) for p in postures])
                q1 = np.ptp([p.attrs["q_deg"][0] for p in postures])
                row[:10] = [1, len(postures), len(first["frequency"]), first["frequency"][0], float(coherence), brakes,
                            float(first["coherence"].attrs.get("averages", 0)), float(q1 > 0),
                            float(first.attrs.get("exponential_window_rate", 0)), first["frf"].shape[2]]  # fmt: skip
            else:
                runs = list(file["runs"].values())
                rough = [np.median(np.abs(np.diff(run["torque"][()], axis=0))) for run in runs]
                row[10:16] = [1, len(runs), len(runs[0]["time"]), float("link_position" in runs[0]),
                              float(np.median(rough)), sum(len(run["time"]) for run in runs)]  # fmt: skip
        row[16] += path.stat().st_size
    row[16] = np.log(row[16])
    return np.array(row, float)


def leak_probe(
    cases: Sequence[Scored], split: Path, without: dict[str, list[str]], neighbours: int = 5
) -> dict[str, Rate]:
    """Nearest neighbours on metadata, left-one-out: how often they tell a null, and the effect; beside the majority."""
    here = [c for c in cases if c.kind in ("none", "single")]
    rows = np.array([[*metadata(split / "recordings" / c.name), len(without[c.name])] for c in here])
    rows = (rows - rows.mean(0)) / np.where(rows.std(0) > 0, rows.std(0), 1)
    rows[:, [0, 10]] *= 10  # never across kinds of recording
    distance = np.linalg.norm(rows[:, None] - rows[None], axis=2) + np.diag(np.full(len(rows), np.inf))
    null = [c.kind == "none" for c in here]
    name = [c.truth[0].partition("@")[0] if c.truth else "" for c in here]
    told_null, told_name = [], []
    for k in range(len(here)):
        near = np.argsort(distance[k])[:neighbours]
        told_null.append(Counter(null[j] for j in near).most_common(1)[0][0] == null[k])
        if not null[k]:
            named = [name[j] for j in near if name[j]]
            told_name.append(bool(named) and Counter(named).most_common(1)[0][0] == name[k])
    common = max(sum(null), len(null) - sum(null))
    names = Counter(n for n in name if n)
    return {
        "null or not, by metadata": Rate(sum(told_null), len(told_null)),
        "null or not, majority": Rate(common, len(null)),
        "effect, by metadata": Rate(sum(told_name), len(told_name)),
        "effect, most frequent": Rate(names.most_common(1)[0][1] if names else 0, sum(names.values())),
    }
