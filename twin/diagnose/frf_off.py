"""The number of a description that hammer tests show to be wrong, as an answer of its own beside what is missing.

Every fit has such numbers free within their tolerance, so FRFs are predicted no better by a hypothesis that widens one.
What counts is the model that has the number as described and all others free: does it miss the recordings?
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.cannot_be import cannot_be, may_be
from twin.diagnose.departures import far_off
from twin.diagnose.described import DOUBT, described
from twin.diagnose.hypotheses import Hypothesis, together
from twin.diagnose.refit import Fitted, descend, recorded_error
from twin.diagnose.search import REFIT_LINES
from twin.diagnose.verdict import Missing, candidate
from twin.identify.objective import Sample
from twin.model.parameters import Parameters, written_names
from twin.model.recorded import Recorded
from twin.robot.description import Robot

MOST = 4  # groups of numbers that are tried: where more are far off, the description is another robot's


@dataclass(frozen=True)
class Told:
    """A number of the description, or all of one link, that is wrong.

    Attributes:
        missing: the answer, with a load on the link as its rival where that does most of it.
        fit: of the model, with the numbers as free as they have to be.
    """

    missing: Missing
    fit: Fitted


def off_description(
    base: Robot, free: Parameters, fit: Fitted, bare: Fitted, others: Sequence[Fitted], sample: Sample,
    kept: Sequence[Recorded],
) -> Told | None:  # fmt: skip
    """The one thing of the description that is far off beside an answer; ``None`` where none is, or several are.

    Args:
        free: the base model's parameters.
        fit: the answer so far, which is the base model where nothing is missing.
        bare: the base model.
        others: what else was fitted.
        kept: recordings that nothing was fitted to.
    """
    told = _one_thing(base, free, fit, sample)
    if told is None:
        return None
    number = told.hypothesis.pieces[-1]
    held = {name for name, _ in number.scale}
    # a damper may make a spring's axis rigid, too: the model that has the spring as described has its damper so
    held |= {f"{axis}.damping" for axis, _, what in (name.rpartition(".") for name in held) if what == "stiffness"}
    rest = fit.parameters.select(k for k, name in enumerate(written_names(fit.parameters).names) if name not in held)
    known = dict(zip(written_names(fit.parameters).names, fit.values, strict=True))
    z = rest.coordinates(np.array([known[name] for name in written_names(rest).names]))
    hypothesis = _without_scale(fit.hypothesis, held)
    without = descend(base, hypothesis, rest, sample, z, tempered=0, linear=20)
    if data_cost(without) - data_cost(told) < calibration()["seen"] * max(1.0, told.misfit):
        return None
    if kept and recorded_error(told.robot, kept)[0] >= recorded_error(without.robot, kept)[0]:
        return None
    part = number.effect, number.site
    gain = told.evidence() - fit.evidence()
    loads = [other for other in others if _load(other, fit, number.site, base) and _gain(other, fit) > gain / 2]
    share = calibration()["told"] / (1 + len(loads[:1]))
    rivals = tuple((candidate(other, _more(other, fit), bare), share) for other in loads[:1])
    return Told(Missing(candidate(told, part, bare), share, rivals, ""), told)


def data_cost(fit: Fitted) -> float:
    """½ χ² of the recordings alone."""
    return float(fit.cost - 0.5 * fit.z @ fit.z)


def _one_thing(base: Robot, free: Parameters, fit: Fitted, sample: Sample) -> Fitted | None:
    """The model with the fewest numbers free, of one kind or of one link, that bring all that is far off back."""
    names = written_names(fit.parameters).names
    far = {names[k]: off for k, _, off in far_off(fit)}
    if not far or any(fit.parameters[names.index(name)].kind not in ("spring", "link") for name in far):
        return None
    blocks = [h for h in described(free) if "*" not in h.site and far.keys() & dict(h.scale).keys()]
    if len(blocks) > MOST:
        return None
    if len(blocks) > 1:  # all of a link, under the name of its mass
        for link in sorted({h.site.partition(".")[0] for h in blocks if h.site.startswith("link")}):
            whole = [(name, DOUBT) for name in free.names if name.startswith(f"{link}.")]
            blocks.append(Hypothesis("parameter", f"{link}.mass", scale=tuple(whole)))
    few = sample.thin(REFIT_LINES)
    for block in sorted(blocks, key=lambda h: len(h.scale)):
        hypothesis = together(*fit.hypothesis.pieces, block)
        parameters = hypothesis.parameters(free)
        z = np.asarray(np.linalg.solve(parameters.root, fit.parameters.root @ fit.z))
        near = descend(base, hypothesis, parameters, few, z, tempered=0)
        if not far_off(near):
            told = descend(base, hypothesis, parameters, sample, near.z, tempered=0, tolerance=0.02)
            told = _or_what_may_be(base, free, told, sample)
            return None if far_off(told) else replace(told, allowed=fit.allowed)
    return None


def _or_what_may_be(base: Robot, free: Parameters, told: Fitted, sample: Sample) -> Fitted:
    """A fit, or where its last piece cannot be what it is called, the likeliest of what may be there instead."""
    piece, band = told.hypothesis.pieces[-1], sample.band_hz
    if not cannot_be(told, piece, band):
        return told
    instead = may_be(base, told, piece, free, sample.recordings[0].setup.q, band)
    fits = [descend(base, h, h.parameters(free), sample, z, tempered=0, tolerance=0.02) for h, z in instead]
    return max(fits, key=lambda fit: fit.evidence(), default=told)


def _without_scale(hypothesis: Hypothesis, held: set[str]) -> Hypothesis:
    """A hypothesis none of whose pieces widens numbers that are held."""
    pieces = [replace(p, scale=tuple(one for one in p.scale if one[0] not in held)) for p in hypothesis.pieces]
    return together(*pieces) if pieces else hypothesis


def _load(other: Fitted, fit: Fitted, site: str, base: Robot) -> bool:
    """Whether another fit has a load on the link whose numbers these are, and else the same answer."""
    more = [p for p in other.hypothesis.pieces if p.key not in fit.hypothesis.identity]
    if len(more) != 1 or len(other.hypothesis.pieces) != len(fit.hypothesis.pieces) + 1:
        return False
    law = more[0].law
    carrier = law.carrier(base, more[0].site) if law else None
    return carrier is not None and site.startswith(f"link{carrier + 1}.")


def _more(other: Fitted, fit: Fitted) -> tuple[str, str]:
    """Effect and site of what another fit has beside the answer."""
    return next((p.effect, p.site) for p in other.hypothesis.pieces if p.key not in fit.hypothesis.identity)


def _gain(other: Fitted, fit: Fitted) -> float:
    return other.evidence() - fit.evidence()
