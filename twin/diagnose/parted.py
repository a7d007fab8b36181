"""A mass and the link that carries it, divided anew: the whole that moves stays the same, the prior says how."""

from collections.abc import Iterable

import numpy as np
from scipy.optimize import least_squares

from twin.diagnose.hypotheses import Hypothesis
from twin.measure.campaign import FloatArray
from twin.model.parameters import SIX, Parameters
from twin.robot.bodies import Inertial, fuse
from twin.robot.description import Robot
from twin.robot.frames import inertia_six

PARTED_FROM = (-2.0, -0.5, 0.5)  # prior deviations of a mass from which a part of a link is sought
LEAST_LEFT = 0.1  # of the whole is the link's, at least
MOMENT_LEFT = 0.01  # of the usual one
INERTIAL = ("mass", "com.x", "com.y", "com.z", *(f"inertia.{pair}" for pair in SIX))


def divided(
    robot: Robot, parameters: Parameters, z: FloatArray, piece: Hypothesis, present: bool
) -> tuple[FloatArray, float] | None:
    """Where a mass and its link are least tense, all else as it is.

    Several divisions may be: a mass out to one side of a link whose own centre is off to the other side moves as the
    same two the other way round.

    Args:
        robot: as described.
        parameters: of the hypothesis that has the mass.
        z: their prior coordinates (n,).
        piece: the mass.
        present: whether ``z`` has the mass on the link; else it is to become a part of the link.

    Returns:
        z (n,) and the fall of ½ zᵀz; ``None`` for what is no part of a link, or a link whose numbers are not free.
    """
    found = _whole(robot, parameters, z, piece, present)
    if found is None:
        return None
    number, at, own, whole = found
    link, part = parameters.select(at), parameters.select(own)
    order = [INERTIAL.index(p.name.partition(".")[2]) for p in link]

    def tension(own: FloatArray) -> FloatArray:
        mass, com, inertia = _body(part.values(own))
        left, centre, rest = fuse(whole, (-mass, com, -inertia))
        if left <= LEAST_LEFT * whole[0]:
            return np.full(len(at) + len(own), 1e6)
        values = [left, *centre, *inertia_six(rest)]
        return np.concatenate([link.coordinates(np.array([values[k] for k in order])), own])

    starts = [np.array([size, *[0.0] * (len(own) - 1)]) for size in PARTED_FROM]
    starts += _rest_of(whole, robot.links[number].inertial, part)
    best = min((least_squares(tension, start) for start in starts), key=lambda end: float(end.cost))
    before = [*z[at], *(z[own] if present else [])]
    there = z.copy()
    there[own], there[at] = best.x, tension(best.x)[: len(at)]
    return there, 0.5 * float(np.sum(np.square(before))) - float(best.cost)


def on_a_described_link(
    robot: Robot, parameters: Parameters, z: FloatArray, piece: Hypothesis
) -> tuple[FloatArray, float] | None:
    """Where a mass is all that its link seems off by, and the link is as described.

    A body's products of inertia have no number, so the whole is not quite the same. From there a fit may go down
    another valley than from any division of the whole.

    Returns:
        z (n,) and the fall of the link's ½ zᵀz; ``None`` as in :func:`divided`, or if no mass would be left.
    """
    found = _whole(robot, parameters, z, piece, present=True)
    if found is None:
        return None
    number, at, own, whole = found
    rest = _rest_of(whole, robot.links[number].inertial, parameters.select(own))
    if not rest:
        return None
    there = z.copy()
    there[at], there[own] = 0.0, rest[0]
    return there, 0.5 * float(z[at] @ z[at])


def _whole(
    robot: Robot, parameters: Parameters, z: FloatArray, piece: Hypothesis, present: bool
) -> tuple[int, list[int], list[int], Inertial] | None:
    """Of a mass: its link, the indices of the link's numbers and of its own, and what the two are together.

    ``None`` as in :func:`divided`.
    """
    number = piece.law.carrier(robot, piece.site) if piece.law else None
    if number is None:
        return None
    mine = {p.name for p in piece.own}
    own = [k for k, p in enumerate(parameters) if p.name in mine]
    at = [k for k, p in enumerate(parameters) if p.kind == "link" and p.name.startswith(f"link{number + 1}.")]
    if len(at) < len(INERTIAL):
        return None
    link, part = parameters.select(at), parameters.select(own)
    whole = link.apply(robot, link.values(z[at])).links[number].inertial
    return number, at, own, fuse(whole, _body(part.values(z[own]))) if present else whole


def _body(values: Iterable[float]) -> Inertial:
    """A point, or a body with principal moments of its own."""
    mass, x, y, z, *moments = values
    return mass, np.array([x, y, z]), np.diag(moments or [0.0] * 3)


def _rest_of(whole: Inertial, link: Inertial, part: Parameters) -> list[FloatArray]:
    """Own coordinates with which the link is as described, where what is left has a mass."""
    mass, com, inertia = fuse(whole, (-link[0], link[1], -link[2]))
    if mass <= 0:
        return []
    values = part.values(np.zeros(len(part)))
    values[:4] = [mass, *com]
    moments = len(part) - 4
    values[4:] = np.maximum(np.diag(inertia)[:moments], MOMENT_LEFT * values[4:])
    return [part.coordinates(values)]
