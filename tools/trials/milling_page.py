"""The page of the milling trials: docs/proof-milling.md, from what was stated and what the true robots' cuts did."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tools.trials import store
from tools.trials.score import Rate

STAGES = ("base", "after", "true")
NAMES = {"base": "before: the described model refitted", "after": "after its diagnosis", "true": "true model refitted"}
PAIRED = 0.05  # relative difference in frequency of modes that are compared
BAND_HZ = 40.0  # modes below it


@dataclass(frozen=True)
class Stated:
    """One cut of one robot.

    Attributes:
        name, number: of robot and cut.
        kind, effects: what is concealed.
        word, named: the diagnosis; ``None`` where there was none.
        limit, safe: stage → depth, m; ``stable`` stage → whether the true robot's cut at ``safe`` was;
        ``limit_stable`` at ``limit``.
        damping: stage → rows (true %, stated %, low %, high %) of the modes.
    """

    name: str
    number: int
    kind: str
    effects: tuple[str, ...]
    word: str | None
    named: tuple[str, ...]
    limit: dict[str, float]
    safe: dict[str, float]
    stable: dict[str, bool]
    limit_stable: dict[str, bool]
    damping: dict[str, np.ndarray]


def collected(split: Path) -> list[Stated]:
    """All cuts that were stepped."""
    found = []
    for name, cuts in store.read(split / "milled.json").items():
        answer = store.read(split / "answers" / f"{name}.json")
        depths = store.read(split / "depths" / f"{name}.json")
        path = split / "results" / f"{name}.json"
        result = store.read(path) if path.exists() else {}
        effects = tuple(f"{e['effect']}@{e['site']}" for e in answer["effects"])
        named = tuple(f"{e['effect']}@{e['site']}" for e in result.get("effects", ()))
        for number, cut in cuts.items():
            own = {stage: depths[stage][int(number)] for stage in STAGES if stage in depths}
            growth = cut["growth"]
            found.append(Stated(
                name, int(number), answer["kind"], effects, result.get("word"), named,
                {s: d["limit_m"] for s, d in own.items()}, {s: d["safe90_m"] for s, d in own.items()},
                {s: growth[f"{s} safe90_m"] < 0 for s in own}, {s: growth[f"{s} limit_m"] < 0 for s in own},
                {s: _dampings(cut, d) for s, d in own.items()},
            ))  # fmt: skip
    return found


def _dampings(cut: dict[str, Any], stated: dict[str, Any]) -> np.ndarray:
    """Rows (true, stated, low, high), percent, of the true modes that a mode of the model is near."""
    f, ratio = np.array(stated["frequency_hz"]), np.array(stated["damping_percent"])
    band = np.array(stated["damping_interval90"])
    rows = []
    for frequency, true in zip(cut["frequency_hz"], cut["damping_percent"], strict=True):
        k = int(np.argmin(np.abs(np.log(f / frequency))))
        if frequency < BAND_HZ and abs(f[k] / frequency - 1) < PAIRED:
            rows.append([true, ratio[k], *band[k]])
    return np.array(rows).reshape(-1, 4)


def share(cuts: Iterable[Stated], good: Callable[[Stated], bool]) -> Rate:
    """k of n."""
    flags = [good(c) for c in cuts]
    return Rate(sum(flags), len(flags))


def open_(cuts: Sequence[Stated], stage: str, deepest: float) -> list[Stated]:
    """Cuts whose stated depth is not the deepest of interest."""
    return [c for c in cuts if stage in c.safe and c.safe[stage] < 0.999 * deepest]


def _lines(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    return ["| " + " | ".join(map(str, row)) + " |" for row in (head, ["---"] * len(head), *rows)]


def page(split: Path, deepest: float, ledger: list[dict[str, str]]) -> str:
    """The page as Markdown."""
    cuts = collected(split)
    robots = len({c.name for c in cuts})
    asked = len({c.name for c in cuts if "after" in c.safe})
    lines = [
        "# Proof: milling with concealed physics", "",
        f"{robots} sealed robots of the truth code, {len(cuts)} cuts in postures that were not struck; {asked} of the robots "
        f"were also diagnosed. Each robot was struck as in [the other trials](proof.md): six or seven postures, effects of "
        "any usual size, a quarter without any. Then it milled: spindle of 20 kg, 2 to 4 teeth, immersion 5 to 100 %, up "
        "and down, any feed direction, 600 to 6000 rpm. Cutting coefficients are known to 15 %, angles to 0.2°. The true "
        "cut is the delay equation stepped in time by `tools/truth/milling.py`, which shares no code with the twin.", "",
        "`python -m tools.trials.milling prove` draws another split and writes this page.", "",
        "## Is the stated depth stable?", "",
        "The depth that is stable with 90 % probability should be stable in nine of ten cuts. Beside it the depth that a "
        "user without intervals would trust: the limit of the best model.", "",
    ]  # fmt: skip
    rows = []
    for stage in STAGES:
        own = open_(cuts, stage, deepest)
        if own:
            rows.append([
                NAMES[stage], len({c.name for c in own}), share(own, lambda c, s=stage: c.stable[s]),
                share(own, lambda c, s=stage: c.limit_stable[s]),
            ])  # fmt: skip
    lines += _lines(["model", "robots", "stable at the 90 % depth", "stable at the limit"], rows)
    both = [c for c in cuts if "true" in c.safe]
    lines += ["", "The same, robots that conceal something structural, and those that conceal nothing:", ""]
    rows = []
    for title, some in (
        ("nothing concealed", [c for c in cuts if not c.effects]),
        ("something concealed", [c for c in cuts if c.effects]),
        ("something concealed and diagnosed", [c for c in cuts if c.effects and "after" in c.safe]),
    ):
        rows.append([title, len({c.name for c in some}), *(
            share(open_(some, s, deepest), lambda c, s=s: c.stable[s]) if open_(some, s, deepest) else "—" for s in STAGES
        )])  # fmt: skip
    lines += _lines(["robots", "how many", *(NAMES[s] for s in STAGES)], rows)
    lines += ["", "## What the depth costs", ""]
    for stage in ("base", "after"):
        ratio = np.array([c.safe[stage] / c.safe["true"] for c in both if stage in c.safe])
        if ratio.size:
            low, middle, high = np.quantile(ratio, (0.05, 0.5, 0.95))
            lines.append(
                f"- {NAMES[stage]}: {middle:.0%} of what the true model refitted allows in the median, 5 to 95 %: "
                f"{low:.0%} to {high:.0%} ({ratio.size} cuts)."
            )
    lines += ["", "## By effect", "", "Unsafe: the true robot's cut at the stated 90 % depth grows.", ""]
    kinds = sorted({e.partition("@")[0] for c in cuts for e in c.effects})
    rows = []
    for kind in kinds:
        own = [c for c in cuts if any(e.startswith(f"{kind}@") for e in c.effects)]
        row: list[object] = [kind, len({c.name for c in own})]
        for stage in STAGES:
            some = open_(own, stage, deepest)
            row.append(share(some, lambda c, s=stage: not c.stable[s]) if some else "—")
        base = open_(own, "base", deepest)
        row.append(share(base, lambda c: not c.limit_stable["base"]) if base else "—")
        rows.append(row)
    lines += _lines(
        ["effect", "robots", "unsafe before", "unsafe after", "unsafe, true model", "unsafe before, at the limit"], rows
    )
    lines += ["", "## Damping in postures that were not struck", ""]
    rows = []
    for stage in STAGES:
        table = np.concatenate([c.damping[stage] for c in cuts if stage in c.damping] or [np.zeros((0, 4))])
        if len(table):
            off = np.abs(table[:, 1] / table[:, 0] - 1)
            inside = (table[:, 0] >= table[:, 2]) & (table[:, 0] <= table[:, 3])
            rows.append(
                [
                    NAMES[stage],
                    len(table),
                    f"{np.median(off):.1%}",
                    f"{np.quantile(off, 0.9):.0%}",
                    Rate(int(inside.sum()), len(table)),
                ]
            )
    lines += _lines(["model", "modes", "error, median", "error, nine of ten below", "inside the 90 % interval"], rows)
    engines = sorted({entry["engine"] for entry in ledger})
    lines += ["", f"Ledger: {len(ledger)} entries, engines {', '.join(engines)}; " + "; ".join(
        f"{entry['time']} {entry['why']}" for entry in ledger
    ) + ".", ""]  # fmt: skip
    return "\n".join(lines)
