"""Derivatives of a robot's model with respect to its free numbers, those of links that bend among them."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from twin.measure.campaign import FloatArray
from twin.model.parameters import SIX, Parameters, Sprung
from twin.model.sensitivity import Observed, Setup, Structure, slopes, spatial_inertia
from twin.robot.bodies import Inertial
from twin.robot.description import Robot
from twin.robot.frames import inertia_matrix, inertia_six

Changes = dict[tuple[Any, ...], Any]
"""What entries and links change in a mechanism, kept while the values are the same."""


def rates(
    robot: Robot,
    setup: Setup,
    parameters: Parameters,
    values: FloatArray,
    seen: Observed,
    model: Structure,
    changes: Changes,
    among: Iterable[int] | None = None,
) -> Observed:
    """:func:`twin.model.sensitivity.slopes`, links that bend differentiated through their cut."""
    split = {f"link{number}": split for number, split in model.mechanism.splits.items()}
    through = [
        k for k, p in enumerate(parameters) if p.kind == "link" and p.name.partition(".")[0] in split
    ]  # fmt: skip
    if not through:
        return slopes(robot, setup, parameters, values, seen, model, changes, among)
    # The rest is asked for under a name that nothing answers to, and filled in here.
    items = list(parameters.items)
    for k in through:
        items[k] = replace(items[k], name="gain.-", kind="gain")
    written = parameters.written if isinstance(parameters, Sprung) else parameters
    among = range(len(parameters)) if among is None else list(among)
    rest = Sprung(tuple(items), parameters.covariance, written)
    out = slopes(robot, setup, rest, values, seen, model, changes, among)
    for row, k in enumerate(among):
        if k not in through:
            continue
        body, _, quantity = parameters[k].name.partition(".")
        inertial = robot.links[int(body[4:]) - 1].inertial
        step = parameters[k].step(values[k])
        sides = [split[body].parts(_shifted(inertial, quantity, sign * step)) for sign in (1.0, -1.0)]
        for part, name, offset in ((0, body, np.zeros(3)), (1, f"{body}.tip", split[body].origin)):
            high, low = (
                spatial_inertia(m, com - offset, inertia) for m, com, inertia in (side[part] for side in sides)
            )
            dM, dK = model.inertial_slopes(name, ((high - low) / (2 * step))[None])
            out.M[row] += dM[0]
            out.K[row] += dK[0]
    return out


def _shifted(inertial: Inertial, quantity: str, step: float) -> Inertial:
    mass, com, inertia = inertial
    com = com.copy()
    if quantity == "mass":
        mass += step
    elif quantity.startswith("com."):
        com["xyz".index(quantity[-1])] += step
    else:
        six = inertia_six(inertia)
        six[SIX.index(quantity.partition(".")[2])] += step
        inertia = inertia_matrix(six)
    return mass, com, inertia
