"""Numbers of a description as hypotheses: each may be further off than its tolerance says.

A number that every fit has free (a spring, a mass, an angle) has its prior widened. One that fits take as described (a
length of an axis, the position of a node) is freed. How far off it is nobody knows: evidence is averaged over widths of
the prior, from its tolerance to ``DOUBT`` times that.
"""

from collections.abc import Container, Iterable
from dataclasses import replace

from twin.diagnose.hypotheses import Hypothesis
from twin.measure.campaign import Channels
from twin.model.parameters import Parameter, Parameters, axis_parameters, direction_parameters, point_parameters
from twin.physics.chain import node_of
from twin.robot.description import Robot

DOUBT = 10.0  # times its tolerance: as far off as a description is thought to be


def described(free: Parameters) -> list[Hypothesis]:
    """Numbers that every fit has free: springs, dampers, mass, centre and inertia of every link, angles of postures.

    Beside a motion log that knows them, lengths and twists of axes are free as well.

    Then the groups of them that one tolerance speaks for, all links or all joints at once: ``link*.inertia``.

    Args:
        free: the base model's parameters.
    """
    blocks: dict[str, list[Parameter]] = {}
    for parameter in free:
        if parameter.kind in ("spring", "axis"):
            blocks.setdefault(parameter.name, []).append(parameter)
        elif parameter.kind == "link":
            blocks.setdefault(".".join(parameter.name.split(".")[:2]), []).append(parameter)
        elif parameter.kind == "posture":
            blocks.setdefault("posture", []).append(parameter)
    groups: dict[str, list[Parameter]] = {}
    for own in blocks.values():
        for parameter in own if own[0].kind in ("spring", "link") else ():
            body, *what = parameter.name.split(".")
            kind = what[-1] if parameter.kind == "spring" else what[0]
            groups.setdefault(f"{body.rstrip('0123456789')}*.{kind}", []).append(parameter)
    blocks |= {site: own for site, own in groups.items() if len({p.name.partition(".")[0] for p in own}) > 1}
    return [Hypothesis("parameter", site, scale=tuple((p.name, DOUBT) for p in own)) for site, own in blocks.items()]


def geometry(
    robot: Robot, response: Channels, excitation: Channels, free: Container[str] = ()
) -> list[list[Hypothesis]]:
    """Numbers that fits take as described: lengths and twists of axes, positions of nodes, one by one and all.

    The zero of an axis is an effect. ``free`` has the names of what every fit has free all the same.

    Directions of sensors and blows are freed all at once; one by one they are effects.

    Whatever is at a node may be elsewhere, or its sensor, or one blow: variants of one hypothesis.
    """
    sensors = point_parameters(robot, response, "response")
    blows = point_parameters(robot, excitation, "excitation")
    together = {p.name: p for some in (response, excitation) for p in point_parameters(robot, some, "position")}
    variants: dict[str, dict[str, list[Parameter]]] = {}
    for parameter in (*together.values(), *sensors, *blows):
        node = node_of(parameter.site.partition(".")[0])
        variants.setdefault(node, {}).setdefault(parameter.site, []).append(parameter)
    nodes = []
    for node, some in variants.items():
        freed = [_freed(f"{node}.position", own) for own in some.values()]
        nodes.append(freed[1:] if len(freed) == 2 else freed)  # one channel group at the node: the two are the same
    lengths = [p for p in axis_parameters(robot) if p.quantity != "theta" and p.name not in free]
    axes = [[_freed(p.name, [p])] for p in lengths]
    turns = [*direction_parameters(robot, response, "response"), *direction_parameters(robot, excitation, "excitation")]
    everywhere = [_freed("node:*.position", [*sensors, *blows]), _freed("node:*.direction", turns)]
    found = [*axes, *nodes, *([group] for group in (*everywhere, _freed("axis*", lengths)))]
    return [some for some in found if some[0].own and all(p.deviation > 0 for p in some[0].own)]  # else known exactly


def nodes_within(robot: Robot, response: Channels, excitation: Channels) -> Hypothesis:
    """Positions of all nodes, as far off as the description's tolerance says."""
    own = [*point_parameters(robot, response, "response"), *point_parameters(robot, excitation, "excitation")]
    return Hypothesis("parameter", "node:*.position", own=tuple(p for p in own if p.deviation > 0))


def _freed(site: str, own: Iterable[Parameter]) -> Hypothesis:
    wide = [replace(p, deviation=DOUBT * p.deviation) for p in own]
    return Hypothesis("parameter", site, own=tuple(wide))
