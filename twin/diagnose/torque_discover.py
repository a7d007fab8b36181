"""A law for torque that no known effect explains: a sparse sum of products of the state, found by orthogonal matching.

Terms are taken one after the other from a library of physical features, until one more gains nothing (Pati, Rezaiifar,
Krishnaprasad, Asilomar 1993). Each is of usual size under its prior. Brunton, Proctor, Kutz, PNAS 113, 2016, use the
same idea. The law is an entry like any other: its formula is evaluated by the effect ``discovered``.
"""

from collections.abc import Sequence

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.torque_fit import settle, start
from twin.diagnose.torque_suspects import Suspect
from twin.diagnose.torque_system import System, Trial
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameter
from twin.model.torque_laws import USUAL_SHARE
from twin.model.torque_noise import span_of
from twin.model.torque_whitened import Columns
from twin.physics import effect_of
from twin.robot.description import Entry


def library(axes: int, joint: int, speed: float, revolute: Sequence[bool]) -> list[str]:
    """Features of the state as formulas of the effect ``discovered``.

    Args:
        axes: number of axes.
        joint: zero-based; its own velocity takes part in products.
        speed: its largest, rad/s (m/s).
        revolute: which axes turn.
    """
    own = joint + 1
    v = f"v{own}"
    where = []
    for i in range(1, axes + 1):
        where += [f"sin({k}*q{i})" if k > 1 else f"sin(q{i})" for k in (1, 2, 3)] if revolute[i - 1] else [f"q{i}"]
        where += [f"cos({k}*q{i})" if k > 1 else f"cos(q{i})" for k in (1, 2, 3)] if revolute[i - 1] else [f"q{i}**2"]
    pace = [v, f"sign({v})", f"abs({v})*{v}", f"{v}**3", f"abs({v})"]
    pace += [f"sign({v})*exp(-({v}/{share * speed:.3g})**2)" for share in (0.03, 0.1, 0.3)]
    others = [f"v{i}" for i in range(1, axes + 1) if i != own] + [f"sign(v{i})" for i in range(1, axes + 1) if i != own]
    terms = [f"q{own}", f"q{own}**2", f"q{own}**3", *where, *pace, *others]
    terms += [f"{a}*{b}" for a in (f"q{own}", f"q{own}**2", *where) for b in (v, f"sign({v})", f"abs({v})*{v}")]
    terms += [f"load{own}*{v}", f"abs(load{own})*sign({v})", f"abs(load{own})*{v}"]
    terms += [f"v{i}*v{k}" for i in range(1, axes + 1) for k in range(i, axes + 1)]
    terms += [f"a{i}" for i in range(1, axes + 1)]
    return list(dict.fromkeys(terms))


def unnamed(law: Trial) -> bool:
    """Whether a law has a term that none of the vocabulary's effects at its joint is by itself."""
    (entry,) = law.suspect.hypothesis.entries
    own = entry.site.removeprefix("joint")
    v = f"v{own}"
    named = {v, f"sign({v})", f"q{own}", f"a{own}", f"abs(load{own})*sign({v})"}
    terms = [term.partition("*")[2] for term in entry.values["formula"].split(" + ")]
    return any(term not in named and not term.startswith(f"sign({v})*exp(") for term in terms)


def discover(system: System, joint: int, most: int = 5) -> tuple[Trial, int] | None:
    """A law of ``most`` terms for what the model misses at a joint, and the number of terms it was chosen from.

    ``None`` where no term is worth its place.
    """
    robot = system.base.regressor.robot
    runs = system.base.runs
    terms = library(robot.axis_count, joint, span_of(runs, joint)[2], [a.type == "revolute" for a in robot.axes])
    site = f"joint{joint + 1}"
    scale = USUAL_SHARE * float(np.sqrt(np.mean(np.concatenate([r.torque[r.valid, joint] for r in runs]) ** 2)))
    units, widths, kept = [], [], []
    for term in terms:
        torque = system.torque([_entry(site, f"c1*{term}", [1.0])])
        rms = float(
            np.sqrt(np.mean(np.concatenate([t[r.valid, joint] for t, r in zip(torque, runs, strict=True)]) ** 2))
        )
        if rms > 0:
            units.append([t * (scale / rms) for t in torque])
            widths.append(scale / rms)
            kept.append(term)
    whitened = system.whiten(*units)
    chosen = _match(system, whitened, most)
    if not chosen:
        return None
    formula = " + ".join(f"c{k + 1}*{kept[c]}" for k, c in enumerate(chosen))
    law = effect_of("law")
    key, unit = f"{law.name}@{site}", law.unit("coefficients", site, system.base.regressor.robot)
    own = tuple(
        Parameter(f"{key}.coefficients[{k}]", unit, "entry", False, 0.0, widths[c], "usual size")
        for k, c in enumerate(chosen)
    )
    entry = _entry(site, formula, [0.0] * len(own))
    hypothesis = Hypothesis(entry.effect, site, (entry,), own)
    sizes = tuple(range(len(own)))
    suspect = Suspect(hypothesis, np.zeros((1, len(own))), sizes, np.zeros(len(own), bool))
    return settle(system, start(system, suspect)), len(kept)


def _entry(site: str, formula: str, coefficients: list[float]) -> Entry:
    data = {"effect": effect_of("law").name, "site": site, "formula": formula, "coefficients": coefficients}
    return Entry.model_validate(data)


def _match(system: System, whitened: Columns, most: int) -> list[int]:
    """Indices of the columns that explain the residual, most first."""
    G, pull = system.projected(whitened)
    numbers = calibration()
    chosen: list[int] = []
    before = 0.0
    while len(chosen) < most:
        gains = np.array([_evidence(G, pull, [*chosen, k]) if k not in chosen else -np.inf for k in range(len(pull))])
        best = int(np.argmax(gains))
        if gains[best] - before < max(numbers["term"], numbers["term_share"] * before):
            break
        chosen.append(best)
        before = float(gains[best])
    return chosen


def _evidence(G: FloatArray, pull: FloatArray, members: list[int]) -> float:
    inside = G[np.ix_(members, members)] + np.eye(len(members))
    part = pull[members]
    return float(0.5 * part @ np.linalg.solve(inside, part) - 0.5 * np.linalg.slogdet(inside)[1])
