"""Meshes of links: read in metres, and made such that MuJoCo takes them."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError

MOST_FACES = 200_000  # that MuJoCo reads of one mesh
FINE = 1e-3  # of a mesh's size, within which vertices of one that has more faces are taken together first
COARSER = 1.5  # times that, and so on


def read_mesh(path: str | Path, source: str | Path, field: str) -> Any:
    """The surface in a file, in metres where the file states its unit.

    Raises:
        InputError: naming source and field: not readable, or without triangles.
    """
    import trimesh
    from trimesh.units import unit_conversion

    name = Path(path).name
    try:
        mesh = trimesh.load_mesh(path)
    except Exception as error:  # the readers raise whatever a broken file provokes in them
        raise InputError(source, field, f"{name} cannot be read as a mesh ({error})") from error
    if mesh.is_empty or not len(getattr(mesh, "faces", ())):
        raise InputError(source, field, f"{name} holds no triangles")
    if mesh.units is not None:  # Collada states its unit
        mesh.apply_scale(unit_conversion(mesh.units, "meters"))
    return mesh


def drawn_by_mujoco(path: str | Path) -> bool:
    """Whether MuJoCo reads the file as it is: OBJ, or binary STL with few enough faces."""
    file = Path(path)
    if file.suffix.lower() == ".obj":
        return file.stat().st_size < 20 * MOST_FACES  # bytes that a face and its share of the vertices take at least
    if file.suffix.lower() != ".stl":
        return False
    with file.open("rb") as stream:
        head = stream.read(84)
    count = int.from_bytes(head[80:84], "little")
    return len(head) == 84 and 0 < count <= MOST_FACES and os.path.getsize(file) == 84 + 50 * count


def thinned(mesh: Any) -> Any:
    """The mesh, with vertices taken together on an ever coarser grid until MuJoCo takes all faces."""
    import trimesh

    cell = FINE * float(np.max(mesh.extents))
    while len(mesh.faces) > MOST_FACES:
        _, cluster = np.unique(np.round(mesh.vertices / cell), axis=0, return_inverse=True)
        cluster = cluster.ravel()
        count = np.bincount(cluster)
        vertices = np.stack([np.bincount(cluster, x) / count for x in mesh.vertices.T], axis=1)
        faces = cluster[mesh.faces]
        whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        mesh = trimesh.Trimesh(vertices, faces[whole], process=False)
        cell *= COARSER
    return mesh
