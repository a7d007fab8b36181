"""What a search found to be off by no more than the description allows: doubt that a fit takes in, and no answer.

Nodes stand a few millimetres from where a file says, sensors and blows point a fraction of a degree elsewhere. Where
recordings show that, predictions become better with it, so it stays in the fits before and after. It is told in
``triage``.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import gammaincinv

from twin.diagnose.described import DOUBT
from twin.diagnose.hypotheses import Hypothesis, together
from twin.diagnose.note import Note
from twin.diagnose.refit import Fitted, descend
from twin.identify.elastic import RARE, STATED
from twin.identify.objective import Sample
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameter, Parameters, written_names
from twin.physics.chain import node_of
from twin.robot.description import Robot

WORDS = {"response": "sensor", "excitation": "blow", "position": "node"}
EVERY = {f"node:*.{what}": f"{what}s of sensors and blows" for what in ("position", "direction")}
EVERY["axis*"] = "lengths and twists of axes"
LISTED = 3  # points that a note lists


def allowed(fit: Fitted, robot: Robot) -> tuple[Hypothesis, ...]:
    """The pieces of a fit whose numbers together are as near to their description as all but ``RARE`` of such are.

    What the law of another piece leaves open (:meth:`Effect.leaves_open`) is among them.
    """
    found, at = [], len(fit.z) - len(fit.hypothesis.own)
    for piece in fit.hypothesis.pieces:
        at += len(piece.own)
        if _left_open(fit, piece, fit.values[at - len(piece.own) : at], robot):
            found.append(piece)
            continue
        width = [_tolerance(piece, p, robot) for p in piece.own]
        if not width or None in width:
            continue
        own = np.arange(at - len(piece.own), at)
        doubt = STATED if piece.site in EVERY else 1.0
        if astray(fit, own, doubt * np.array(width, float)) <= most_astray(len(own)):
            found.append(piece)
    return tuple(found)


def _left_open(fit: Fitted, piece: Hypothesis, values: FloatArray, robot: Robot) -> bool:
    """Whether a piece with these values (m,) is a part of what another piece's law simplifies."""
    for other in fit.hypothesis.pieces:
        size = other.law.leaves_open(robot, other.site).get(piece.key) if other.law else None
        if size:
            own = dict(zip((p.quantity for p in piece.own), values, strict=True))
            if sum((own[name] / most) ** 2 for name, most in size.items()) <= most_astray(len(size)):
                return True
    return False


def excused(fit: Fitted, others: Sequence[Fitted], robot: Robot) -> tuple[Hypothesis, ...]:
    """The pieces of a fit that are :func:`allowed` in another one which has more such groups free, and else the same.

    A group that alone is off takes up what the others leave, which are off by as much as the description allows.
    """
    keys = set[str]()
    for other in others:
        more = [piece for piece in other.hypothesis.pieces if piece.key not in fit.hypothesis.identity]
        if fit.hypothesis.identity < other.hypothesis.identity and all(piece.site in EVERY for piece in more):
            keys |= {piece.key for piece in allowed(other, robot) if piece.site in EVERY}
    return tuple(piece for piece in fit.hypothesis.pieces if piece.key in keys)


def singled_out(fit: Fitted, others: Sequence[Fitted], robot: Robot) -> Fitted | None:
    """The same model with what is off of a group in pieces of its own, the rest of that group being :func:`allowed`."""
    for other in others:
        more = [piece for piece in other.hypothesis.pieces if piece.key not in fit.hypothesis.identity]
        if not more or not fit.hypothesis.identity < other.hypothesis.identity:
            continue
        groups = [group for group in fit.hypothesis.pieces if any(_within(piece, group) for piece in more)]
        named = all(any(_within(piece, group) for group in groups) for piece in more)
        if named and {group.key for group in groups} <= {piece.key for piece in allowed(other, robot)}:
            return other
    return None


def _within(piece: Hypothesis, group: Hypothesis) -> bool:
    """Whether a piece is a part of one that frees all nodes or axes."""
    own = {p.name for p in piece.own}
    return piece.law is None and group.site in EVERY and bool(own) and own < {p.name for p in group.own}


def astray(fit: Fitted, own: np.ndarray, tolerance: FloatArray, nothing: float = 1e-9) -> float:
    """χ² of a fit's numbers about their description: how far off the data alone have them, doubt of both beside.

    A number that the data hardly know may come out far off under its wide prior, and says nothing.

    Args:
        fit: under priors wider than the tolerances.
        own: (k,) indices of the numbers, which have independent priors.
        tolerance: (k,) in their units, one standard deviation.
        nothing: information per tolerance², of which rounding leaves so much where the data hold none.
    """
    some = [fit.parameters[k] for k in own]
    width = np.maximum(tolerance, 1e-300) / [p.mean if p.log else 1.0 for p in some]
    x = (fit.parameters.root @ fit.z)[own]
    both = _inverse(fit.covariance[np.ix_(own, own)] / max(1.0, fit.misfit))  # of the data and of the prior
    data = both - np.diag([p.deviation**-2 for p in some])
    information, axes = np.linalg.eigh(data * np.outer(width, width))
    pull, known = axes.T @ (width * (both @ x)), information > nothing
    return float(np.sum(pull[known] ** 2 / (information * (information + 1))[known]))


def _inverse(covariance: FloatArray, least: float = 1e-12) -> FloatArray:
    """Of a covariance whose correlations rounding may have made singular: to ``least`` of a variance they hold."""
    scale = np.sqrt(np.diag(covariance))
    share, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray((axes / np.maximum(share, least)) @ axes.T / np.outer(scale, scale))


def most_astray(count: int, among: int = 1) -> float:
    """χ² of so many numbers within their tolerance, beyond which one in ``RARE`` is, or the farthest of several."""
    return float(2 * gammaincinv(count / 2, 1 - RARE / among))


def members(fit: Fitted, piece: Hypothesis) -> list[Hypothesis]:
    """Of a piece that frees all nodes or axes: what is farther astray than so many within tolerance would be.

    That is a node, or one number of an axis. Alone, and beside the others, which are then free in a piece of their own.
    A single sensor or blow that points elsewhere is an effect, and no number of the description (:func:`turned`).
    """
    if piece.site not in EVERY or piece.site.endswith(".direction"):
        return []
    found, parts = [], _by_node(piece.own) if "node:*" in piece.site else {p.name: [p] for p in piece.own}
    for part, own in parts.items():
        if _astray(fit, own) > most_astray(len(own), len(parts)):
            site = piece.site.replace("node:*", part).replace("axis*", part)
            alone = replace(piece, site=site, own=tuple(own))
            rest = tuple(p for p in piece.own if p not in own)
            found += [alone, together(alone, replace(piece, own=rest))] if rest else [alone]
    return found


def turned(fit: Fitted, piece: Hypothesis, suspects: Sequence[Sequence[Hypothesis]], robot: Robot) -> list[Hypothesis]:
    """Of a piece that frees all directions: effects on what is farther off than the tolerance of so many allows.

    Each alone, or all of several, and beside the directions of the others, which are then free in a piece of their own.
    """
    if piece.site not in EVERY or not piece.site.endswith(".direction"):
        return []
    parts: dict[str, list[Parameter]] = {}
    for p in piece.own:
        label, side, _ = p.name.removeprefix("node:").split(".")
        parts.setdefault(f"hammer:{label}" if side == "excitation" else f"sensor:{node_of(label)}", []).append(p)
    far = {site for site, own in parts.items() if _astray(fit, own) > most_astray(len(own), len(parts))}
    some = [one for one, *_ in suspects if one.site in far and one.law and one.own and one.law.tolerances(robot)]
    found = []
    for effects in [*([one] for one in some), *([some] if len({one.site for one in some}) > 1 else [])]:
        sites = {one.site for one in effects}
        rest = tuple(p for site, own in parts.items() if site not in sites for p in own)
        found += [together(*effects), together(*effects, replace(piece, own=rest))] if rest else [together(*effects)]
    return found


def _by_node(own: Iterable[Parameter]) -> dict[str, list[Parameter]]:
    nodes: dict[str, list[Parameter]] = {}
    for p in own:
        nodes.setdefault(node_of(p.site.partition(".")[0]), []).append(p)
    return nodes


def _astray(fit: Fitted, own: Sequence[Parameter]) -> float:
    """:func:`astray` of numbers that a hypothesis frees."""
    names = fit.parameters.names
    return astray(fit, np.array([names.index(p.name) for p in own]), np.array([p.deviation for p in own]) / DOUBT)


def _tolerance(piece: Hypothesis, parameter: Parameter, robot: Robot) -> float | None:
    """What the description allows of a number, one standard deviation; ``None`` where it says nothing."""
    if piece.law is None:
        return parameter.deviation / DOUBT
    allows: Mapping[str, float] = piece.law.tolerances(robot)
    return allows.get(parameter.quantity.partition("[")[0])


def base_with(robot: Robot, free: Parameters, settled: Fitted, beside: Fitted, sample: Sample, few: Sample) -> Fitted:
    """The base model with what the description allows free within its tolerance.

    Args:
        settled: the base model without that; ``beside``: a fit that has it free (``allowed``), wider. It ends at the
            better optimum of those that the two lead to.
    """
    narrow = [
        replace(piece, own=tuple(replace(p, deviation=_tolerance(piece, p, robot) or p.deviation) for p in piece.own))
        for piece in beside.allowed
    ]
    hypothesis = together(*narrow)
    parameters = hypothesis.parameters(free)
    known = dict(zip(written_names(beside.parameters).names, beside.values, strict=True))
    values = [known.get(name, p.mean) for name, p in zip(written_names(parameters).names, parameters, strict=True)]
    starts = [parameters.coordinates(np.array(values)), np.concatenate([settled.z, np.zeros(len(hypothesis.own))])]
    near = [descend(robot, hypothesis, parameters, few, z, tempered=0) for z in starts]
    best = min(near, key=lambda fit: fit.cost)
    return descend(robot, hypothesis, parameters, sample, best.z, tempered=0, tolerance=0.02)


def without(robot: Robot, pieces: tuple[Hypothesis, ...]) -> Robot:
    """A description without what belongs to the recording alone."""
    gone = {(entry.effect, entry.site) for piece in pieces for entry in piece.entries}
    return robot.model_copy(update={"physics": [e for e in robot.physics if (e.effect, e.site) not in gone]})


def taken_in(pieces: tuple[Hypothesis, ...], fit: Fitted) -> list[Note]:
    """What was found and is allowed, in one sentence; a warning where a node is farther off than a tolerance allows.

    Args:
        pieces: free beyond their tolerances.
        fit: under their tolerances or beyond.
    """
    if not pieces:
        return []
    told = []
    if ordinary := [piece for piece in pieces if not _of_robot(piece)]:
        sites = [piece.site if piece.law is None else piece.key for piece in ordinary]
        names = ", ".join(f"{EVERY[site]} ({site})" if site in EVERY else site for site in sites)
        text = "a little off, within the description's tolerances. Every fit took that into account: no finding"
        told.append(Note(f"{names}: {text}", "description", "note"))
    if parts := ", ".join(f"{piece.effect} at {piece.site}" for piece in pieces if _of_robot(piece)):
        text = "so small that what was found beside it may include it. Every fit took that into account: no finding"
        told.append(Note(f"{parts}: {text}", "description", "note"))
    places = [piece for piece in pieces if piece.law is None and piece.site.endswith(".position")]
    return [*told, *filter(None, (_farthest(piece, fit) for piece in places))]


def _of_robot(piece: Hypothesis) -> bool:
    """Whether a piece is an effect on the robot, which another one's law leaves open."""
    return piece.law is not None and piece.law.changes_robot


def _farthest(piece: Hypothesis, fit: Fitted) -> Note | None:
    """The nodes that a fit has farthest from where the file says, mm; none where all are within tolerance."""
    values, far = dict(zip(fit.parameters.names, fit.values, strict=True)), dict[str, tuple[str, float]]()
    nodes, tolerance = _by_node(piece.own), piece.own[0].deviation / DOUBT
    for node, own in nodes.items():
        off = np.array([values.get(p.name, p.mean) - p.mean for p in own])
        if float(np.sum((off / tolerance) ** 2)) <= most_astray(len(own), len(nodes)):
            continue
        points: dict[str, float] = {}
        for p, moved in zip(own, off, strict=True):
            point, side, _ = p.name.removeprefix("node:").split(".")
            name = f"{WORDS[side]} {point}"
            points[name] = float(np.hypot(points.get(name, 0.0), moved))
        far[node] = max(points.items(), key=lambda one: one[1])
    if not far:
        return None
    first = sorted(far.values(), key=lambda one: -one[1])
    told = ", ".join(f"{point} by {1e3 * off:.1f} mm" for point, off in first[:LISTED])
    more = f" and {len(first) - LISTED} more" if len(first) > LISTED else ""
    text = f"not where the file says, by more than a tolerance of {1e3 * tolerance:g} mm per axis allows: {told}{more}"
    text = f"position of nodes: {text}; the fits have them where the recordings do"
    return Note(text, "position", sites=tuple(f"{node}.position" for node in far))
