"""Pieces of a fit that came out with numbers which what they are called cannot have, and what may be there instead.

A mass far off the link that it hangs on is a mass on another link, or something else. A damper that outweighs its
spring in the whole recorded band makes the axis rigid: then the spring is stiffer than described, and no recording says
by how much.
"""

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.hypotheses import Hypothesis, entry_hypothesis, together
from twin.diagnose.refit import Fitted
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters, written_names
from twin.physics.effect import axis_of
from twin.robot.description import Robot
from twin.robot.frames import between_links


def cannot_be(fit: Fitted, piece: Hypothesis, band_hz: tuple[float, float]) -> bool:
    """Whether a piece of a fit cannot be what it is called.

    What would hang ``far`` deviations of its prior off its link is something else: a rotor on a soft shaft passes for a
    small mass metres away.
    """
    return out_of_place(fit, piece) or bool(_rigid(fit, piece, band_hz[0]))


def out_of_place(fit: Fitted, piece: Hypothesis) -> bool:
    """Whether what hangs on a link came out ``far`` deviations of its prior from where such things are."""
    lever = piece.law.lever if piece.law else ""
    own = [(p, x) for p, x in zip(fit.parameters, fit.values, strict=True) if p.site == piece.key]
    places = [(p, x) for p, x in own if lever and not p.log and p.quantity.partition("[")[0] == lever]
    return any(abs(x - p.mean) > calibration()["far"] * p.deviation for p, x in places)


def may_be(
    robot: Robot, fit: Fitted, piece: Hypothesis, free: Parameters, q: FloatArray, band_hz: tuple[float, float]
) -> list[tuple[Hypothesis, FloatArray]]:
    """What may be there instead of a piece that cannot be: a hypothesis of it, the others beside it, and its start.

    Args:
        free: the base model's parameters.
        q: (axes,) of a posture, rad or m: a mass on another link is at the same place in space there.
        band_hz: of the recordings.
    """
    rest = [other for other in fit.hypothesis.pieces if other is not piece]
    known = dict(zip(written_names(fit.parameters).names, fit.values, strict=True))
    found = []
    for instead, numbers in (*_on_other_links(robot, fit, piece, q), *_springs(fit, piece, band_hz)):
        if instead.key in {other.key for other in rest}:
            continue
        hypothesis = together(*rest, instead)
        parameters = hypothesis.parameters(free)
        values = known | {p.name: p.mean for p in instead.own} | numbers
        z = parameters.coordinates(np.array([values[name] for name in written_names(parameters).names], float))
        found.append((hypothesis, z))
    return found


def _on_other_links(
    robot: Robot, fit: Fitted, piece: Hypothesis, q: FloatArray
) -> list[tuple[Hypothesis, dict[str, float]]]:
    """The same body on every other link, and its numbers there."""
    law = piece.law
    if law is None or not piece.entries or not out_of_place(fit, piece):
        return []
    own = {p.quantity: x for p, x in zip(fit.parameters, fit.values, strict=True) if p.site == piece.key}
    here, found = carrier_at(piece, robot, piece.site), []
    place = np.array([own[f"{law.lever}[{k}]"] for k in range(3)])
    sites = {carrier_at(piece, robot, site): site for site in reversed(list(law.fixed_sites(robot.axis_count)))}
    for there, site in sites.items():
        typical = law.typical(robot, site)
        if there == here or not typical:
            continue
        moved = between_links(robot, q, here, there, place)
        numbers = own | {f"{law.lever}[{k}]": float(x) for k, x in enumerate(moved)}
        given = piece.entries[0].model_extra or {}
        other = entry_hypothesis(robot, piece.effect, site, {**given, law.lever: typical[law.lever]})
        found.append((other, {p.name: numbers[p.quantity] for p in other.own}))
    return found


def carrier_at(piece: Hypothesis, robot: Robot, site: str) -> int:
    """The zero-based link on which something hangs, or would at another site."""
    carrier = piece.law.carrier(robot, site) if piece.law else None
    return axis_of(site) if carrier is None else carrier


def _springs(fit: Fitted, piece: Hypothesis, band_hz: tuple[float, float]) -> list[tuple[Hypothesis, dict[str, float]]]:
    """The springs of dampers that outweigh them, as stiff as the dampers are in the band, all dampers as described."""
    described = {p.name: p.mean for p in fit.parameters}
    omega = 2 * np.pi * float(np.sqrt(band_hz[0] * band_hz[1]))
    found = []
    for axis, damping in _rigid(fit, piece, band_hz[0]).items():
        name = f"{axis}.stiffness"
        spring = Hypothesis("parameter", name, scale=((name, piece.scale[0][1]),))
        numbers = {damper: described[damper] for damper, _ in piece.scale}
        found.append((spring, {**numbers, name: omega * damping}))
    return found


def _rigid(fit: Fitted, piece: Hypothesis, lowest_hz: float) -> dict[str, float]:
    """Axis → damping, of the dampers of a piece that outweigh their spring from the lowest recorded frequency on."""
    values = dict(zip(fit.parameters.names, fit.values, strict=True))
    found = {}
    for name, _ in piece.scale:
        axis, _, quantity = name.rpartition(".")
        stiffness = values.get(f"{axis}.stiffness")
        if quantity == "damping" and stiffness and 2 * np.pi * lowest_hz * values[name] > stiffness:
            found[axis] = float(values[name])
    return found
