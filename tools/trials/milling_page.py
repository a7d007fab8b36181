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
        material, helix_deg: of the cut.
        limit, safe: stage → depth, m; ``stable`` stage → whether the true robot's cut at ``safe`` was, with teeth that
        may leave the work; ``linear`` the same for a small vibration alone, ``limit_stable`` so at ``limit``.
        damping: stage → rows (true %, stated %, low %, high %) of the modes.
    """

    name: str
    number: int
    kind: str
    effects: tuple[str, ...]
    word: str | None
    named: tuple[str, ...]
    material: str
    helix_deg: float
    limit: dict[str, float]
    safe: dict[str, float]
    stable: dict[str, bool]
    linear: dict[str, bool]
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
        asked = store.read(split / "cuts" / f"{name}.json")
        for number, cut in cuts.items():
            given = asked[int(number)]["cut"]
            own = {stage: depths[stage][int(number)] for stage in STAGES if stage in depths}
            growth = cut["growth"]
            found.append(Stated(
                name, int(number), answer["kind"], effects, result.get("word"), named,
                given["coefficients"]["source"], given["tool"]["helix_deg"],
                {s: d["limit_m"] for s, d in own.items()}, {s: d["safe90_m"] for s, d in own.items()},
                {s: growth[f"{s} safe90_m"] < 0 and not cut["chatters"][s] for s in own},
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
    shown = [entry for entry, later in zip(ledger, [*ledger[1:], {}], strict=True) if later.get("why") != entry["why"]]
    parts = [
        _head(cuts), _stable(cuts, deepest), _cost(cuts), _by_effect(cuts, deepest), _by_cut(cuts, deepest),
        _damping(cuts),
        ["## Ledger", "", *(f"- {e['time']}: {e['why']} (engine {e['engine']})" for e in shown), ""],
    ]  # fmt: skip
    return store.typeset("\n".join(["# Proof: milling", "", *(line for part in parts for line in part)]))


def _head(cuts: Sequence[Stated]) -> list[str]:
    robots, asked = {c.name for c in cuts}, {c.name for c in cuts if "after" in c.safe}
    hidden = {c.name for c in cuts if c.effects}
    return [
        f"{len(robots)} sealed robots of the truth code made {len(cuts)} cuts. No hammer test was made in the postures "
        f"of the cuts. {len(hidden)} of the robots conceal something, of any usual size. {len(asked)} robots were "
        f"diagnosed. {len({c.name for c in cuts if 'base' in c.safe})} were refitted as described, and "
        f"{len({c.name for c in cuts if 'true' in c.safe})} with what they truly conceal. Each robot had a hammer test "
        "as in [the other trials](proof.md), in six or seven postures.",
        "",
        "The spindle weighs 20 kg. Cuts have 2 to 4 teeth, an immersion of 5 to 100 %, any feed direction and 600 to "
        "6000 rpm. They are up or down milling with straight or helical teeth (30°, 45°), in aluminium, steel or "
        "titanium. Coefficients are known to 15 %, postures to 0.2°. The true cut is stepped in time by "
        "`tools/truth/milling.py`, which shares no code with the twin. The cut is stable if a small vibration dies out "
        "and if a cut from rest settles. The cut from rest has the feed, and its teeth may leave the work.",
        "",
        "`python -m tools.trials.milling prove` draws another split and writes this page. The split has only linear "
        "effects of hammer tests. Gaps, slip and hardening are left out, because they need force levels.",
        "",
    ]


def _stable(cuts: Sequence[Stated], deepest: float) -> list[str]:
    lines = [
        "## Is the stated depth stable?", "",
        "The depth that is stable with 90 % probability should be stable in nine of ten cuts. The last column is for "
        "the limit of the best model, the depth that a user without intervals would trust. Cuts whose 90 % depth is "
        f"the deepest asked for ({1e3 * deepest:g} mm) are left out.", "",
    ]  # fmt: skip
    groups = (
        ("all", lambda c: True),
        ("diagnosed", lambda c: "after" in c.safe),
        ("diagnosed, nothing concealed", lambda c: "after" in c.safe and not c.effects),
        ("diagnosed, something concealed", lambda c: "after" in c.safe and bool(c.effects)),
    )
    rows = []
    for title, chosen in groups:
        for stage in STAGES:
            own = open_([c for c in cuts if chosen(c)], stage, deepest)
            if own:
                shares = (
                    share(own, lambda c, s=stage: c.stable[s]),
                    share(own, lambda c, s=stage: c.linear[s]),
                    share(own, lambda c, s=stage: c.limit_stable[s]),
                )
                rows.append([title, NAMES[stage], len({c.name for c in own}), *shares])
    return [
        *lines,
        *_lines(
            [
                "robots",
                "model",
                "how many",
                "stable at the 90 % depth",
                "a small vibration there dies out",
                "and at the limit",
            ],
            rows,
        ),
        "",
    ]


def _cost(cuts: Sequence[Stated]) -> list[str]:
    lines = ["## What certainty costs", ""]
    for stage in ("base", "after"):
        ratio = np.array([c.safe[stage] / c.safe["true"] for c in cuts if stage in c.safe and "true" in c.safe])
        if ratio.size:
            low, middle, high = np.quantile(ratio, (0.05, 0.5, 0.95))
            lines.append(
                f"- {NAMES[stage]}, {ratio.size} cuts: in the median the 90 % depth is {middle:.0%} of what the true "
                f"model refitted allows. In nine of ten cuts it is {low:.0%} to {high:.0%} of that."
            )
    own = np.array([c.safe["true"] / c.limit["true"] for c in cuts if "true" in c.safe])
    if own.size:
        lines.append(
            f"- true model refitted: in the median the 90 % depth is {np.median(own):.0%} of this model's limit."
        )
    return [*lines, ""]


def _by_effect(cuts: Sequence[Stated], deepest: float) -> list[str]:
    rows = []
    for kind in sorted({e.partition("@")[0] for c in cuts for e in c.effects}):
        own = [c for c in cuts if any(e.startswith(f"{kind}@") for e in c.effects)]
        cells = [share(open_(own, s, deepest), lambda c, s=s: not c.stable[s]) for s in STAGES]
        trusted = share(open_(own, "base", deepest), lambda c: not c.limit_stable["base"])
        rows.append([kind, len({c.name for c in own}), *cells, trusted])
    head = ["effect", "robots", "unsafe before", "unsafe after", "unsafe, true model", "unsafe before, at the limit"]
    title = "A cut is unsafe if the true robot chatters at the 90 % depth."
    return ["## By effect", "", title, "", *_lines(head, rows), ""]


def _by_cut(cuts: Sequence[Stated], deepest: float) -> list[str]:
    rows = []
    for title, value in (("material", "material"), ("helix", "helix_deg")):
        for one in sorted({getattr(c, value) for c in cuts}):
            own = [c for c in cuts if getattr(c, value) == one]
            cells = [share(open_(own, s, deepest), lambda c, s=s: c.stable[s]) for s in STAGES]
            depth = np.median([1e3 * c.safe["base"] for c in own if "base" in c.safe] or [np.nan])
            rows.append([f"{title} {one:g}°" if title == "helix" else one, len(own), f"{depth:.2g} mm", *cells])
    head = ["cut", "cuts", "median depth", "stable before", "stable after", "stable, true model"]
    title = "The columns count cuts at the 90 % depth that are stable on the true robot."
    return ["## By cut", "", title, "", *_lines(head, rows), ""]


def _damping(cuts: Sequence[Stated]) -> list[str]:
    rows = []
    for stage in STAGES:
        table = np.concatenate([c.damping[stage] for c in cuts if stage in c.damping] or [np.zeros((0, 4))])
        if len(table):
            off = np.abs(table[:, 1] / table[:, 0] - 1)
            inside = (table[:, 0] >= table[:, 2]) & (table[:, 0] <= table[:, 3])
            held = Rate(int(inside.sum()), len(table))
            rows.append([NAMES[stage], len(table), f"{np.median(off):.1%}", f"{np.quantile(off, 0.9):.0%}", held])
    head = ["model", "modes", "error, median", "nine of ten below", "inside the 90 % interval"]
    title = f"Modes below {BAND_HZ:g} Hz whose frequency is predicted within {PAIRED:.0%}."
    return ["## Damping in postures that were not struck", "", title, "", *_lines(head, rows), ""]
