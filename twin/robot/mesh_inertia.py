"""Mass, centre of mass and inertia of links given by a closed mesh, and all links rebalanced to a known total mass."""

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from twin.errors import InputError
from twin.robot.description import Link, Robot, check_inertia
from twin.robot.frames import inertia_six
from twin.robot.mesh import read_mesh


def complete_inertias(robot: Robot, source: str | Path) -> None:
    """Complete links that have only a mesh, then scale all links to ``total_mass``; changes ``robot`` in place.

    A link with a mesh and a ``density`` or a ``mass`` gets what a homogeneous solid of that shape has. Where
    ``total_mass`` is given, one factor on all links' masses and inertias makes Σ link masses + base mass equal to it
    (Huynh et al. 2020, section 5). Afterwards every link has mass, com and inertia; ``density`` and ``total_mass`` are
    used up and ``None``, so that what is saved is not scaled again on loading.

    Args:
        robot: description whose meshes are found (absolute paths).
        source: the file named in errors.

    Raises:
        InputError: a mesh that cannot be read or encloses no volume, or a total mass below the base's.
    """
    links = [
        link if link.inertia is not None else _solid(link, source, f"links[{i}].mesh")
        for i, link in enumerate(robot.links)
    ]
    if robot.total_mass is not None:
        available = robot.total_mass - robot.base.mass
        if available <= 0:
            raise InputError(
                source, "total_mass", f"must exceed the base's {robot.base.mass:g} kg, found {robot.total_mass:g} kg"
            )
        factor = available / sum(link.mass for link in links if link.mass is not None)
        links = [_scaled(link, factor) for link in links]
        robot.total_mass = None
    robot.links = links


def _solid(link: Link, source: str | Path, field: str) -> Link:
    assert link.mesh is not None  # the schema asks for it where the inertia is missing
    shape = closed_mesh(link.mesh, source, field)
    shape.apply_scale(link.mesh_scale)
    shape.density = link.density if link.density is not None else link.mass / shape.volume
    inertia = inertia_six(shape.moment_inertia)
    try:
        check_inertia(inertia)
    except ValueError as error:  # shells turned inside out can cancel
        raise InputError(source, field, f"{Path(link.mesh).name}: {error}") from error
    found = {"mass": float(shape.mass), "com": shape.center_mass.tolist(), "inertia": inertia}
    try:
        return Link.model_validate(link.model_dump(include={"name", "mesh", "mesh_scale", "collision"}) | found)
    except ValidationError as error:
        size = " x ".join(f"{extent:.3g}" for extent in shape.extents)
        told = f"{Path(link.mesh).name} is {size} m large and would weigh {shape.mass:.3g} kg"
        raise InputError(source, field, f"{told}; is it in mm? mesh_scale: 0.001 makes metres of them") from error


def closed_mesh(path: str, source: str | Path, field: str) -> Any:
    """A mesh that encloses a volume, in metres where its file states the unit, wound outwards.

    Raises:
        InputError: naming source and field: not readable, empty, or not closed.
    """
    name, shape = Path(path).name, read_mesh(path, source, field)
    shape.merge_vertices(merge_tex=True, merge_norm=True)  # files split vertices where a texture or normal jumps
    if not shape.is_watertight:
        raise InputError(source, field, f"{name} is not closed (watertight), so that it encloses no volume")
    if not shape.is_winding_consistent:
        raise InputError(source, field, f"{name} has neighbouring triangles that face opposite ways")
    if shape.volume < 0:  # as a whole inside out; cavities are wound inwards and must stay so
        shape.invert()
    return shape


def _scaled(link: Link, factor: float) -> Link:
    assert link.mass is not None
    assert link.inertia is not None
    return link.model_copy(
        update={"mass": factor * link.mass, "inertia": tuple(factor * value for value in link.inertia)}
    )
