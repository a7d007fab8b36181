"""What a search found to be off by no more than the description allows: doubt that a fit takes in, and no answer.

Nodes stand a few millimetres from where a file says, sensors and blows point a fraction of a degree elsewhere. Where
recordings show that, predictions become better with it, so it stays in the fits before and after. It is told in
``triage``.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import gammaincinv

from twin.diagnose.described import DOUBT
from twin.diagnose.hypotheses import Hypothesis, together
from twin.diagnose.note import Note
from twin.diagnose.refit import Fitted, descend
from twin.identify.objective import Sample
from twin.model.parameters import Parameter, Parameters
from twin.physics.chain import node_of
from twin.robot.description import Robot

WORDS = {"response": "sensor", "excitation": "blow", "position": "node"}
EVERY_NODE = {f"node:*.{what}": f"{what}s of sensors and blows" for what in ("position", "direction")}
LISTED = 3  # points that a note lists
RARE = 0.01  # share of numbers within their tolerance that are taken to be beyond it


def allowed(fit: Fitted, robot: Robot) -> tuple[Hypothesis, ...]:
    """The pieces of a fit whose numbers together are as near to their description as all but ``RARE`` of such are."""
    found, at = [], len(fit.z) - len(fit.hypothesis.own)
    for piece in fit.hypothesis.pieces:
        values = fit.values[at : at + len(piece.own)]
        at += len(piece.own)
        width = [_tolerance(piece, p, robot) for p in piece.own]
        if not width or None in width:
            continue
        off = (values - [p.mean for p in piece.own]) / np.maximum(np.array(width, float), 1e-300)
        if off @ off <= 2 * gammaincinv(len(off) / 2, 1 - RARE):  # χ² of so many numbers
            found.append(piece)
    return tuple(found)


def members(fit: Fitted, piece: Hypothesis) -> list[Hypothesis]:
    """Of a piece that frees all nodes: each node that is farther astray than so many nodes within tolerance would be.

    Alone, and beside the others, which are then free in a piece of their own.
    """
    if piece.law is not None or not piece.own or "node:*" not in piece.site:
        return []
    values = dict(zip(fit.parameters.names, fit.values, strict=True))
    nodes: dict[str, list[Parameter]] = {}
    for p in piece.own:
        nodes.setdefault(node_of(p.site.partition(".")[0]), []).append(p)
    found = []
    for node, own in nodes.items():
        off = np.array([(values[p.name] - p.mean) / p.deviation for p in own]) * DOUBT
        if off @ off > 2 * gammaincinv(len(own) / 2, 1 - RARE / len(nodes)):
            alone = replace(piece, site=piece.site.replace("node:*", node), own=tuple(own))
            rest = tuple(p for p in piece.own if p not in own)
            found += [alone, together(alone, replace(piece, own=rest))] if rest else [alone]
    return found


def _tolerance(piece: Hypothesis, parameter: Parameter, robot: Robot) -> float | None:
    """What the description allows of a number, one standard deviation; ``None`` where it says nothing."""
    if piece.law is None:
        return parameter.deviation / DOUBT
    allows: Mapping[str, float] = piece.law.tolerances(robot)
    return allows.get(parameter.quantity.partition("[")[0])


def base_with(
    robot: Robot, free: Parameters, settled: Fitted, pieces: tuple[Hypothesis, ...], sample: Sample, few: Sample
) -> Fitted:
    """The base model with what the description allows free within its tolerance."""
    narrow = [
        replace(piece, own=tuple(replace(p, deviation=_tolerance(piece, p, robot) or p.deviation) for p in piece.own))
        for piece in pieces
    ]
    hypothesis = together(*narrow)
    parameters = hypothesis.parameters(free)
    z = np.concatenate([settled.z[: len(free)], np.zeros(len(hypothesis.own))])
    near = descend(robot, hypothesis, parameters, few, z, tempered=0)
    return descend(robot, hypothesis, parameters, sample, near.z, tempered=0, tolerance=0.02)


def without(robot: Robot, pieces: tuple[Hypothesis, ...]) -> Robot:
    """A description without what belongs to the recording alone."""
    gone = {(entry.effect, entry.site) for piece in pieces for entry in piece.entries}
    return robot.model_copy(update={"physics": [e for e in robot.physics if (e.effect, e.site) not in gone]})


def taken_in(pieces: tuple[Hypothesis, ...], fit: Fitted) -> list[Note]:
    """What was found and is allowed, in one sentence; a warning where a node is farther off than one tolerance."""
    if not pieces:
        return []
    values = dict(zip(fit.parameters.names, fit.values, strict=True))
    sites = [piece.site if piece.law is None else piece.key for piece in pieces]
    names = ", ".join(f"{EVERY_NODE[site]} ({site})" if site in EVERY_NODE else site for site in sites)
    text = f"{names}: a little off, within the description's tolerances. Every fit took that into account: no finding"
    places = [piece for piece in pieces if piece.law is None and piece.site.endswith(".position")]
    return [Note(text, "description", "note"), *filter(None, (_farthest(piece, values) for piece in places))]


def _farthest(piece: Hypothesis, values: Mapping[str, float]) -> Note | None:
    """The points that a piece has farthest from where the file says, mm; none where all are within one tolerance."""
    off: dict[str, float] = {}
    for p in piece.own:
        node, side, _ = p.name.removeprefix("node:").split(".")
        point = f"{WORDS[side]} {node}"
        off[point] = float(np.hypot(off.get(point, 0.0), values.get(p.name, p.mean) - p.mean))
    tolerance = piece.own[0].deviation / DOUBT
    first = sorted((point for point in off if off[point] > tolerance), key=lambda point: -off[point])
    if not first:
        return None
    told = ", ".join(f"{point} by {1e3 * off[point]:.1f} mm" for point in first[:LISTED])
    more = f" and {len(first) - LISTED} more" if len(first) > LISTED else ""
    text = f"not where the file says, by more than its tolerance of {1e3 * tolerance:g} mm: {told}{more}"
    text = f"position of nodes: {text}; the fits have them where the recordings do"
    nodes = dict.fromkeys(node_of(f"node:{point.split()[1]}") for point in first)
    return Note(text, "position", sites=tuple(f"{node}.position" for node in nodes))
