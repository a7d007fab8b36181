"""What to measure next, and what this test could have shown at all.

Both rest on signature energy after projection. That is the squared difference of the predictions of two models, in
units of noise. Only that part counts which is left when everything free in the model has moved to hide it. It moves
under its prior and the data so far.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from twin.diagnose.hypotheses import Hypothesis, same_axes
from twin.diagnose.refit import Fitted
from twin.diagnose.screen import Linear
from twin.errors import InputError
from twin.identify.objective import Objective, Sample
from twin.measure.campaign import Brakes, FloatArray
from twin.model.sensitivity import Setup, frf, observe
from twin.ranges import implausible
from twin.robot.description import Robot

SEEN = 8.0  # ln Bayes factor from which an effect would be seen
SLOPE_SIZE = 1e-4  # of the usual size, where the derivative is taken
ROUNDING = 1e-12  # share of the square of a signature that is known to a millionth
PLACES_TRIED = 24
UNDECIDED = 1.0  # ln evidence: odds of e, which decide nothing
MANY = 1000  # ln evidence beyond which a number says no more


def smallest_visible(
    robot: Robot, fit: Fitted, sample: Sample, suspects: Sequence[Sequence[Hypothesis]]
) -> list[dict[str, Any]]:
    """The size of each entry whose signature, after projection, this recording would have shown.

    The signature is the derivative with respect to the size; a spring's size is its compliance. A difference would also
    count the curvature of what a refit absorbs. Then a payload of grams would seem to show. The first parameter of the
    entry is given. One that no size a robot can have would show is left out.
    """
    linear = Linear(Objective(robot, fit.parameters, sample), fit.z)
    residual, found = linear.residual, []
    for variants in (some for some in suspects if some[0].law):
        hypothesis = variants[len(variants) // 2]
        first = hypothesis.own[0]
        changed = Objective(hypothesis.robot(robot), hypothesis.parameters(fit.parameters), sample)
        one, two = (
            residual - changed.residual(hypothesis.of_size(fit.z, size)) for size in (SLOPE_SIZE, 2 * SLOPE_SIZE)
        )
        if np.linalg.norm(two - one) < np.linalg.norm(one) / 2:
            continue  # something is left at size nought: a slab without mass still stands on its springs
        tangent = (4 * one - two) / (2 * SLOPE_SIZE)  # one-sided: a size has a sign
        whole, share = float(tangent @ tangent), linear.share(tangent)
        energy = whole - float(share @ share)
        if energy <= ROUNDING * whole:
            continue
        size = float(np.sqrt(2 * SEEN / energy))
        if first.log:
            value = first.mean / size if first.quantity == "stiffness" else first.mean * size
        else:
            value = first.deviation * size
        if implausible(value, first.unit, first.log):
            continue
        found.append(
            {
                "effect": hypothesis.effect, "site": hypothesis.site,
                "parameter": first.quantity.partition("[")[0], "value": value, "unit": first.unit,
            }
        )  # fmt: skip
    return found


WEIGH = (
    "no recording of the robot as it is tells a payload from its link's own inertia: weigh what the robot carries, or "
    "take it off and repeat the test"
)


def next_test(robot: Robot, first: Fitted, rival: Fitted, sample: Sample, seed: int = 0) -> dict[str, Any] | None:
    """The posture and brake state that best separate two fitted hypotheses, with the expected separation.

    Candidates are the recorded postures turned about joint 1, and random ones within the robot's limits. If brakes were
    not on, some recorded postures with brakes on are candidates, too. In all of them, as few of the two hypotheses'
    entries as possible turn the robot about one axis (:func:`twin.diagnose.hypotheses.same_axes`).

    Args:
        robot: the description with its limits, which fitted models are without.
    """
    rng = np.random.default_rng(seed)
    reference = sample.recordings[0]
    variance = np.median(
        [r.variance for r in sample.recordings if r.variance.shape == reference.variance.shape], axis=0
    )
    limits = [axis.limits.position if axis.limits else None for axis in robot.axes]
    places: list[tuple[FloatArray, Brakes | None]] = []
    for r in sample.recordings:
        for turn in (-np.pi / 3, np.pi / 3):
            q = r.setup.q.copy()
            q[0] += turn
            places.append((q, r.setup.brakes))
    while len(places) < PLACES_TRIED:
        q = np.array([rng.uniform(*(limit or (-np.pi / 2, np.pi / 2))) for limit in limits])
        places.append((q, reference.setup.brakes))
    if reference.setup.brakes != "on":
        places += [(r.setup.q, "on") for r in sample.recordings[:3]]
    seen = [r.setup.q for r in sample.recordings]
    keys = [piece.key for fit in (first, rival) for piece in fit.hypothesis.pieces]
    alike = [sum(key in same_axes(robot, [*seen, q]) for key in keys) for q, _ in places]
    places = [place for place, count in zip(places, alike, strict=True) if count == min(alike)]
    best: tuple[float, FloatArray, Brakes | None] | None = None
    for q, brakes in places:
        if any(limit and not limit[0] <= v <= limit[1] for v, limit in zip(q, limits, strict=True)):
            continue
        setup = replace(reference.setup, name="next", q=q, brakes=brakes)
        try:
            gain = _separation(first, rival, replace(reference, setup=setup, variance=variance), sample.repeat)
        except InputError:
            continue
        if best is None or gain > best[0]:
            best = gain, q, brakes
    if best is None:
        return None
    gain, q, brakes = best
    degrees = [round(value, 1) for value in robot.degrees(q)]
    state = f", brakes {brakes}" if brakes and brakes != reference.setup.brakes else ""
    sets = [[piece.key for piece in fit.hypothesis.pieces] for fit in (first, rival)]
    names = [" + ".join(key for key in a if key not in b) or "none" for a, b in (sets, sets[::-1])]
    if gain < UNDECIDED:
        text = f"no posture of such a hammer test tells {names[0]} from {names[1]}"
        if all(key in same_axes(robot, seen) for key in names):
            text += ": both turn the robot about one axis. Put a sensor on the base, which only its foundation moves"
        return {"description": text, "separates": names, "posture_deg": None, "expected_ln_bayes_factor": gain}
    return {
        "description": f"the same hammer test at q = {degrees}°{state}: it should separate "
        f"{names[0]} from {names[1]} by {f'{gain:.0f}' if gain < MANY else f'more than {MANY}'} in ln evidence",
        "separates": names, "posture_deg": degrees, "brakes": brakes, "expected_ln_bayes_factor": gain,
    }  # fmt: skip


def _separation(first: Fitted, rival: Fitted, recorded: Any, repeat: float) -> float:
    """½ ‖H₁ − H₂‖² in units of noise, after the rival has moved what it has free within its posterior."""

    def predicted(fit: Fitted, setup: Setup) -> Any:
        seen, _ = observe(fit.robot, setup, fit.parameters, fit.values)
        return frf(seen, recorded.s, recorded.power)

    truth = predicted(first, recorded.setup)
    objective = Objective(rival.robot, rival.parameters, Sample((replace(recorded, frf=truth),), repeat))
    residual, J = objective.jacobian(rival.z)
    information = rival.information + J @ J.T
    gradient = J @ residual
    return float(0.5 * (residual @ residual - gradient @ np.linalg.solve(information, gradient)))
