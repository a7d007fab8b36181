"""Force levels: the smallest law of amplitude that they would have shown, and what to strike next where laws rival.

A law would have shown where the triage would have found that levels disagree. The next blows are where the models of
two laws differ most. As for linear hypotheses (:mod:`twin.diagnose.next_test`), that is their squared difference in
units of noise, after everything free has moved to hide it. Blows are stepped in time.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from twin.diagnose.levels import RACE_LINES, Levels, View, excited, point, with_law
from twin.diagnose.refit import Fitted
from twin.diagnose.triage import HOMOGENEOUS, POOLED_LINES
from twin.errors import InputError
from twin.identify.objective import Sample
from twin.measure.blows import Blow
from twin.measure.campaign import ComplexArray, FloatArray
from twin.model.recorded import Recorded
from twin.physics import CATALOGUE, amplitude_laws
from twin.robot.description import Robot

EXCITATIONS = 5  # a law is looked at by
FACTORS = np.geomspace(1e-4, 1.0, 9)  # of the largest size
POSTURES = 8  # drawn, beside those recorded
SOFTER, HARDER = 0.4, 2.5  # times the lightest and the hardest blows


def smallest_visible_laws(robot: Robot, base: Fitted, sample: Sample, blow: dict[str, Blow]) -> list[dict[str, Any]]:
    """The size of every law at every sprung joint from which force levels of these recordings would disagree.

    A linear model is the same at all levels, so that nothing it has free can hide a law: what counts is the triage's
    homogeneity. A law that shows at no size is left out: a gap that gravity presses shut in all postures. Of slip, the
    sum of the yield torques is given.

    Args:
        robot: the description that was fitted; ``base`` its optimum.
        sample: recordings; ``blow`` how each was hit.
    """
    pairs = _extremes(sample, blow)
    if not pairs:
        return []
    count = pairs[0][0].frf.shape[2]
    index = np.unique(np.linspace(0, count - 1, EXCITATIONS).round().astype(int)).tolist()
    few = Sample(tuple(excited(r, index) for pair in pairs for r in pair))
    found = []
    for i, axis in enumerate(robot.axes):
        if axis.stiffness is None:
            continue
        for law in amplitude_laws():
            stepped, hypothesis = with_law(robot, base, law, f"joint{i + 1}.z", few, blow)
            amplitude = stepped.deflection(base.z)
            if not np.isfinite(amplitude):  # a base model so far off that stepping it diverges says nothing of sizes
                continue
            law = law.at(amplitude)
            largest = law.sizes(float(axis.stiffness), amplitude)[-2]
            stepped = replace(stepped, law=law)
            levels = stepped.predicted_at([point(stepped, base.values, largest * factor) for factor in FACTORS])
            factor = _first_seen(np.array([_disagreement(few, predicted) for predicted in levels]))
            if factor is None:
                continue
            entry = law.entry(largest * factor)
            name = law.shown or law.names[0]
            found.append({
                "effect": law.effect, "site": hypothesis.site, "parameter": name,
                "value": float(np.sum(entry[name])),
                "unit": CATALOGUE[law.effect].unit(name, hypothesis.site, robot),
            })  # fmt: skip
    return found


def _extremes(sample: Sample, blow: dict[str, Blow]) -> list[tuple[Recorded, Recorded]]:
    """Postures struck at several levels: their lightest and their hardest."""
    postures: dict[str, list[Recorded]] = {}
    for r in sample.recordings:
        postures.setdefault(r.setup.name, []).append(r)
    levels = [sorted(group, key=lambda r: blow[r.group].peak_n) for group in postures.values()]
    alike = [g for g in levels if blow[g[0].group].peak_n < blow[g[-1].group].peak_n]
    return [(g[0], g[-1]) for g in alike if g[0].frf.shape == g[-1].frf.shape]


def _disagreement(sample: Sample, predicted: Sequence[ComplexArray]) -> float:
    """Homogeneity of pairs of levels beyond noise, as the triage has it (lowest, highest, lowest, …)."""
    worst, window = 0.0, np.ones(POOLED_LINES)
    pairs = zip(sample.recordings[::2], sample.recordings[1::2], predicted[::2], predicted[1::2], strict=True)
    for a, b, low, high in pairs:
        variance = 2 * (a.variance + b.variance)
        live = np.isfinite(variance) & (variance > 0)
        ratio = np.divide(np.abs(high - low) ** 2, variance, out=np.zeros(live.shape), where=live)
        count = np.convolve(live.sum(axis=(1, 2)), window, "same")
        here = np.convolve(ratio.sum(axis=(1, 2)), window, "same") / np.maximum(count, 1)
        worst = max(worst, float(here.max()))
    return worst


def _first_seen(beyond: FloatArray) -> float | None:
    """The factor at which a disagreement over ``FACTORS`` first fails the triage: a law may hide again by growing."""
    limit = HOMOGENEOUS - 1  # noise alone makes 1
    seen = np.flatnonzero(beyond >= limit)
    if not len(seen):
        return None
    k = int(seen[0])
    if not k:
        return float(FACTORS[0] * np.sqrt(limit / beyond[0]))
    low, high = np.log(np.maximum(beyond[k - 1 : k + 1], 1e-12))
    share = (np.log(limit) - low) / (high - low)
    return float(FACTORS[k - 1] * (FACTORS[k] / FACTORS[k - 1]) ** share)


def next_blows(
    robot: Robot, levels: Levels, first: Fitted, rival: Fitted | None, sample: Sample, blow: dict[str, Blow],
    seed: int = 0,
) -> dict[str, Any] | None:  # fmt: skip
    """The posture and peak force that best separate two laws, or a law from none, with the expected separation.

    Candidates: the recorded postures struck more softly and harder, and random ones within the robot's limits, where
    gravity loads the joints otherwise.

    Args:
        robot: the description; its limits are kept.
        first, rival: of ``levels.fits``; no rival: nothing missing.
        sample: what was fitted to; ``blow`` how it was hit.
    """
    place = next(p for p in levels.places if p.site == first.hypothesis.site)
    few, _ = View(0.0, sample.thin(RACE_LINES), blow).telling(place, EXCITATIONS)
    forces = [b.peak_n for b in blow.values()]
    reference = max(few.recordings, key=lambda r: blow[r.group].peak_n)
    usual = blow[reference.group]
    postures = list({r.setup.q.tobytes(): r.setup.q for r in few.recordings}.values())
    tests = [(q, force) for q in postures for force in (SOFTER * min(forces), HARDER * max(forces))]
    free = (-np.pi / 2, np.pi / 2)
    limits = [(axis.limits.position if axis.limits else None) or free for axis in robot.axes]
    rng = np.random.default_rng(seed)
    tests += [(np.array([rng.uniform(*limit) for limit in limits]), max(forces)) for _ in range(POSTURES)]
    objective = levels.objectives[levels.fits.index(first)]
    if rival is None:
        null = np.zeros(len(objective.law.names))
        other, z = replace(objective, parameters=levels.base.parameters, fixed=null), levels.base.z
        information = levels.base.information
    else:
        other, z, information = levels.objectives[levels.fits.index(rival)], rival.z, rival.information
    best: tuple[float, FloatArray, float] | None = None
    for q, force in tests:
        # sensor noise counts less beside a harder blow; what scatters with the response does not
        quieter = max(1.0, usual.peak_n / force) ** 2
        setup = replace(reference.setup, name="next", q=q)
        struck = replace(reference, group="next", setup=setup, variance=reference.variance * quieter)
        how = {"next": replace(usual, peak_n=force)}
        try:
            seen = replace(objective, sample=Sample((struck,), few.repeat), blow=how, temper=0.0).predicted(first.z)
            told = Sample((replace(struck, frf=seen[0]),), few.repeat)
            cost, gradient, matrix = replace(other, sample=told, blow=how, temper=0.0)(z)
        except InputError:
            continue
        pull = gradient - z
        hidden = 0.5 * float(pull @ np.linalg.solve(information + matrix - np.eye(len(z)), pull))
        gain = cost - 0.5 * float(z @ z) - hidden
        if np.isfinite(gain) and (best is None or gain > best[0]):
            best = gain, q, force
    if best is None:
        return None
    gain, q, force = best
    degrees = [round(value, 1) for value in robot.degrees(q)]
    names = [first.hypothesis.key, rival.hypothesis.key if rival else "none"]
    against = names[1] if rival else "nothing missing"
    return {
        "description": f"the same hammer test at q = {degrees}° with blows of {force:.0f} N: it should separate "
        f"{names[0]} from {against} by {gain:.0f} in ln evidence",
        "separates": names, "posture_deg": degrees, "peak_force_n": force, "expected_ln_bayes_factor": gain,
    }  # fmt: skip
