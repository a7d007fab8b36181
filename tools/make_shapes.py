"""Draws the KR90's links and motors from turned, extruded and lofted solids and writes them as binary STL.

The shapes are for looking at: proportions follow the published joint geometry; masses and inertias never come
from here. Every mesh is in the frame of the body that carries it (`base`: the foot; `link1` … `link3`: the
modified-DH link frames; `motor1` … `motor3`: the frame of the joint they drive), in metres. Solids overlap
instead of being merged.

    python tools/make_shapes.py [--out mjcf/meshes/kr90] [--preview kr90.png]
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import trimesh
import typer
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

Outline = NDArray[np.float64]  # (m, 2) convex polygon, counter-clockwise
Solid = trimesh.Trimesh
Axis = Literal["x", "y", "z"]

SHOULDER_HEIGHT, A1, A2 = 0.675, 0.35, 1.35  # m: joint 1's frame above the floor, common normals 1-2 and 2-3
FLANGE = (1.615, -0.041, 0.0)  # m, in link 3's frame
POSTURES = {"milling": (0, 70, -100), "upright": (0, 135, -100), "rigid": (0, 135, -140)}  # degrees
OUT = Path("mjcf/meshes/kr90")


# Outlines --------------------------------------------------------------------------------------------


def rounded(
    width: float, height: float, radius: float, center: tuple[float, float] = (0, 0), per_corner: int = 0
) -> Outline:
    """Rectangle with rounded corners, (4 per_corner, 2); by default 3 points per corner below 4 cm, 6 above.

    Corners are sampled off the quadrant ends: no double point even where the radius eats the whole side.
    """
    per_corner = per_corner or (3 if radius < 0.04 else 6)
    angle = np.radians(90 / per_corner) * (np.arange(4 * per_corner) + 0.5)
    round_ = np.c_[np.cos(angle), np.sin(angle)]
    return np.sign(round_) * [width / 2 - radius, height / 2 - radius] + radius * round_ + center


def circle(radius: float, center: tuple[float, float] = (0, 0), per_corner: int = 0) -> Outline:
    return rounded(2 * radius, 2 * radius, radius, center, per_corner or (8 if radius > 0.15 else 0))


def hull(*outlines: ArrayLike) -> Outline:
    """Convex outline around others, from its smallest vertex on, whatever order the hull code returns."""
    points = np.vstack([np.asarray(o, dtype=float) for o in outlines])
    around = points[ConvexHull(points).vertices]
    return np.roll(around, -np.lexsort(around.T[::-1])[0], axis=0)


def inset(outline: Outline, depth: float) -> Outline:
    """The outline with every edge moved inwards by `depth` (m)."""
    edge = np.roll(outline, -1, axis=0) - outline
    normal = np.c_[edge[:, 1], -edge[:, 0]] / np.linalg.norm(edge, axis=1)[:, None]
    before = np.roll(normal, 1, axis=0)
    return outline - depth * (normal + before) / (1 + np.sum(normal * before, axis=1))[:, None]


# Solids ----------------------------------------------------------------------------------------------


def skin(rings: NDArray[np.float64]) -> Solid:
    """Closed surface through convex rings (k, m, 3), counter-clockwise seen from the side they advance to."""
    k, m, _ = rings.shape
    i, j = np.arange(m), np.roll(np.arange(m), -1)
    band = np.vstack([np.c_[i, j, m + j], np.c_[i, m + j, m + i]])
    cap = np.c_[np.zeros(m - 2, dtype=int), i[1:-1], i[2:]]
    faces = [cap[:, ::-1], *(band + m * ring for ring in range(k - 1)), cap + m * (k - 1)]
    return Solid(rings.reshape(-1, 3), np.vstack(faces), process=False)


def loft(sections: Sequence[tuple[float, Outline]], axis: Axis) -> Solid:
    """Solid through (station, outline) pairs; outlines lie in the next two axes (x: yz, y: zx, z: xy)."""
    rings = np.array([np.c_[outline, np.full(len(outline), at)] for at, outline in sections])
    return skin(np.roll(rings, {"x": 1, "y": -1, "z": 0}[axis], axis=2))


def prism(outline: Outline, start: float, end: float, axis: Axis, chamfer: float = 0.008) -> Solid:
    """Extrusion with chamfered ends."""
    slim = inset(outline, chamfer)
    return loft([(start, slim), (start + chamfer, outline), (end - chamfer, outline), (end, slim)], axis)


def turned(profile: Sequence[tuple[float, float]], axis: Axis, center: tuple[float, float] = (0, 0)) -> Solid:
    """Solid of revolution through (station, radius) pairs, as fine as its largest radius asks for."""
    per_corner = len(circle(max(radius for _, radius in profile))) // 4
    return loft([(at, circle(radius, center, per_corner)) for at, radius in profile], axis)


def bolts(
    count: int,
    pitch_radius: float,
    start: float,
    end: float,
    axis: Axis,
    center: tuple[float, float] = (0, 0),
    size: float = 0.011,
) -> list[Solid]:
    """Hexagon heads on a pitch circle."""
    hexagon = size * np.c_[np.cos(np.radians(60 * np.arange(6))), np.sin(np.radians(60 * np.arange(6)))]
    angles = 2 * np.pi * (np.arange(count) + 0.5) / count
    heads = [hexagon + center + pitch_radius * np.array([np.cos(a), np.sin(a)]) for a in angles]
    return [loft([(start, head), (end, head)], axis) for head in heads]


def hose(path: ArrayLike, radius: float) -> Solid:
    """Round tube along a path (k, 3) that never runs along z."""
    points = np.asarray(path, dtype=float)
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    side = np.cross([0.0, 0.0, 1.0], along)
    side /= np.linalg.norm(side, axis=1)[:, None]
    up = np.cross(along, side)
    angle = np.radians(45) * np.arange(8)
    ring = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    return skin(points[:, None] + radius * ring)


def can(start: float, end: float, axis: Axis, center: tuple[float, float], radius: float) -> Solid:
    """Servo motor from its mounting flange at `start` to its encoder cap at `end`, on either side of it."""
    # share of the length, side and corner radius in units of `radius`
    flange = [(0.0, 2.05, 0.40), (0.02, 2.15, 0.45), (0.06, 2.15, 0.45)]
    stator = [
        (0.06, 1.85, 0.45),
        (0.55, 1.85, 0.45),
        (0.56, 1.74, 0.40),
        (0.58, 1.74, 0.40),
        (0.59, 1.85, 0.45),
    ]
    cap = [(0.80, 1.85, 0.45), (0.82, 1.76, 0.88), (0.97, 1.76, 0.88), (1.0, 1.50, 0.75)]
    sections = [
        (start + share * (end - start), rounded(side * radius, side * radius, corner * radius, center, 5))
        for share, side, corner in flange + stator + cap
    ]
    return loft(sections if end > start else sections[::-1], axis)


def motor(start: float, end: float, center: tuple[float, float], radius: float, away: float) -> list[Solid]:
    """Joint motor along z with its connector box on the side of angle `away` (degrees)."""
    middle = start + 0.62 * (end - start)
    box = [prism(rounded(0.10, 0.09, 0.015, (middle, 0)), 0.85 * radius, radius + 0.055, "y", chamfer=0.006)]
    for plug, shift in ((0.022, -0.022), (0.016, 0.028)):
        profile = [(radius + 0.05, plug), (radius + 0.075, plug), (radius + 0.085, plug - 0.004)]
        box.append(turned(profile, "y", (middle + shift, 0)))
    turn = trimesh.transformations.rotation_matrix(np.radians(away - 90), [0, 0, 1])
    turn[:2, 3] = center
    return [can(start, end, "z", center, radius)] + [part.apply_transform(turn) for part in box]


# Bodies ----------------------------------------------------------------------------------------------


def base() -> list[Solid]:
    """Foot plate, pedestal and the fixed ring of joint 1, in the world frame."""
    feet = [(x, y) for x in (-0.33, 0.33) for y in (-0.33, 0.33)]
    return [
        prism(rounded(0.80, 0.80, 0.14), 0.0, 0.04, "z"),
        *(prism(rounded(0.17, 0.17, 0.05, foot), 0.0, 0.065, "z") for foot in feet),
        *(bolt for foot in feet for bolt in bolts(2, 0.045, 0.065, 0.09, "z", foot, size=0.02)),
        loft(
            [
                (0.03, rounded(0.72, 0.72, 0.16)),
                (0.10, rounded(0.66, 0.66, 0.20)),
                (0.21, rounded(0.60, 0.60, 0.27)),
                (0.28, rounded(0.60, 0.60, 0.30)),
            ],
            "z",
        ),
        turned([(0.26, 0.28), (0.28, 0.335), (0.33, 0.335), (0.34, 0.325)], "z"),
        *bolts(16, 0.315, 0.335, 0.352, "z"),
        turned([(0.33, 0.29), (0.41, 0.29)], "z"),
        prism(rounded(0.34, 0.20, 0.02, (0.0, 0.15)), -0.43, -0.26, "x"),  # connector panel at the back
        *(turned([(-0.455, 0.026), (-0.425, 0.026)], "x", (y, 0.17)) for y in (-0.11, -0.04)),
        *(turned([(-0.445, 0.018), (-0.425, 0.018)], "x", (y, 0.17)) for y in (0.03, 0.08, 0.13)),
        *(prism(rounded(0.03, 0.10, 0.01, (y, 0.11)), 0.28, 0.37, "x", chamfer=0.004) for y in (-0.15, 0.15)),
    ]


def link1() -> list[Solid]:
    """Rotating column with joint 2's bracket and the counterbalance cylinder; link 1's frame."""
    cheek = hull(
        circle(0.245, (0.0, A1)),
        [(-0.235, -0.33), (-0.08, -0.33), (0.04, -0.24), (-0.235, 0.50), (-0.16, 0.53)],
    )
    cylinder = [
        (-0.60, 0.055),
        (-0.58, 0.092),
        (-0.55, 0.098),
        (-0.13, 0.098),
        (-0.10, 0.088),
        (-0.09, 0.055),
    ]
    cylinder += [(-0.06, 0.055), (-0.06, 0.033), (0.20, 0.033)]
    return [
        turned([(-0.265, 0.33), (-0.255, 0.365), (-0.205, 0.365), (-0.195, 0.35)], "z"),
        *bolts(20, 0.348, -0.20, -0.185, "z"),
        loft(
            [
                (-0.215, rounded(0.66, 0.47, 0.10, (-0.01, 0.10))),
                (-0.14, rounded(0.64, 0.45, 0.10, (-0.02, 0.095))),
                (-0.05, rounded(0.48, 0.40, 0.10, (-0.10, 0.08))),
                (-0.035, rounded(0.45, 0.37, 0.09, (-0.10, 0.08))),
            ],
            "z",
        ),
        prism(cheek, -0.115, 0.07, "y", chamfer=0.018),
        turned([(-0.13, 0.225), (-0.11, 0.235), (-0.10, 0.235)], "y", (0.0, A1)),  # gear of joint 2
        turned([(0.06, 0.20), (0.085, 0.20), (0.095, 0.19)], "y", (0.0, A1)),  # and the seat of its motor
        *bolts(10, 0.175, 0.085, 0.107, "y", (0.0, A1)),
        prism(rounded(0.25, 0.25, 0.05, (-0.13, 0.16)), -0.06, -0.02, "z"),  # seat of motor 1
        # counterbalance: shelf, cheeks with the trunnion, cylinder and rod
        loft(
            [
                (-0.25, rounded(0.42, 0.24, 0.06, (-0.15, -0.23))),
                (-0.17, rounded(0.38, 0.22, 0.05, (-0.16, -0.23))),
            ],
            "z",
        ),
        *(
            prism(
                hull(circle(0.055, (0.0, -0.20)), [(-0.19, -0.30), (-0.19, -0.10)]),
                y,
                y + 0.026,
                "y",
                chamfer=0.004,
            )
            for y in (-0.355, -0.131)
        ),
        turned([(-0.37, 0.030), (-0.095, 0.030)], "y", (0.0, -0.20)),
        turned(cylinder, "x", (-0.23, 0.0)),
        turned([(-0.665, 0.025), (-0.66, 0.030), (-0.59, 0.030)], "x", (-0.23, 0.0)),  # gas valve
        # lifting eyes
        *(turned([(-0.04, 0.022), (0.0, 0.022), (0.005, 0.016)], "z", (-0.29, y)) for y in (-0.05, 0.22)),
    ]


def link2() -> list[Solid]:
    """Arm, in link 2's frame: beside the plane of the column and of the forearm, at z > 0.12."""
    lower = hull(circle(0.232), circle(0.15, (0.20, 0.0)))
    shaft = [  # x, height, depth, corner radius
        (0.02, 0.40, 0.16, 0.05),
        (0.16, 0.385, 0.19, 0.06),
        (0.34, 0.315, 0.185, 0.06),
        (0.60, 0.265, 0.175, 0.06),
        (0.90, 0.240, 0.165, 0.055),
        (1.12, 0.250, 0.165, 0.055),
        (1.26, 0.300, 0.170, 0.055),
        (1.34, 0.320, 0.155, 0.05),
    ]
    s = np.linspace(0, 1, 11)
    path = np.c_[0.10 + 1.20 * s, 0.215 - 0.10 * s - 0.02 * np.sin(2 * np.pi * s), np.full(11, 0.235)]
    return [
        prism(lower, 0.125, 0.335, "z", chamfer=0.018),
        turned([(0.325, 0.165), (0.345, 0.165), (0.36, 0.145)], "z"),
        *bolts(10, 0.195, 0.33, 0.35, "z", size=0.013),
        loft([(x, rounded(h, d, r, (0.0, 0.235))) for x, h, d, r in shaft], "x"),
        # the ribs around the casting's outer pocket
        *(
            loft(
                [
                    (0.24, rounded(0.035, 0.02, 0.009, (side * 0.135, 0.328))),
                    (0.62, rounded(0.03, 0.02, 0.009, (side * 0.092, 0.322))),
                    (1.16, rounded(0.03, 0.02, 0.009, (side * 0.088, 0.316))),
                ],
                "x",
            )
            for side in (-1, 1)
        ),
        *(
            prism(rounded(h, 0.024, 0.008, (0.0, 0.32)), x, x + 0.03, "x", chamfer=0.004)
            for x, h in ((0.56, 0.18), (0.86, 0.17))
        ),
        prism(circle(0.185, (A2, 0.0)), 0.128, 0.325, "z", chamfer=0.018),
        turned([(0.315, 0.125), (0.335, 0.125), (0.347, 0.11)], "z", (A2, 0.0)),
        *bolts(10, 0.15, 0.32, 0.338, "z", (A2, 0.0)),
        # energy supply along the back of the arm, in two clamps
        hose(path, 0.026),
        *(
            prism(rounded(0.10, 0.09, 0.015, (y, 0.235)), x, x + 0.045, "x", chamfer=0.005)
            for x, y in ((0.42, 0.155), (0.98, 0.15))
        ),
    ]


def link3() -> list[Solid]:
    """Elbow, wrist motors, forearm, in-line wrist and flange, in link 3's frame; forearm along x."""
    y = FLANGE[1]
    middle = (y, -0.025)
    axis5 = 1.40
    return [
        # elbow: gear of joint 3 towards the arm, seat of its motor on the other side
        prism(circle(0.20), -0.165, 0.105, "z", chamfer=0.015),
        turned([(0.095, 0.185), (0.118, 0.185), (0.128, 0.175)], "z"),
        turned([(-0.19, 0.135), (-0.18, 0.145), (-0.16, 0.145)], "z"),
        *bolts(10, 0.17, -0.182, -0.16, "z"),
        loft(
            [
                (-0.27, rounded(0.31, 0.26, 0.05, middle)),
                (-0.255, rounded(0.335, 0.28, 0.06, middle)),
                (-0.10, rounded(0.37, 0.28, 0.07, (y + 0.005, -0.025))),
                (0.12, rounded(0.38, 0.28, 0.09, (y + 0.01, -0.025))),
                (0.26, rounded(0.35, 0.30, 0.13, (y, -0.012))),
                (0.34, rounded(0.33, 0.33, 0.16, (y, 0.0))),
            ],
            "x",
        ),
        # motors of axes 4 to 6
        can(-0.265, -0.60, "x", (y + 0.085, -0.025), 0.066),
        can(-0.265, -0.56, "x", (y - 0.068, -0.096), 0.062),
        can(-0.265, -0.56, "x", (y - 0.068, 0.046), 0.062),
        # forearm
        turned([(0.32, 0.165), (0.335, 0.178), (0.375, 0.178), (0.39, 0.165)], "x", (y, 0.0)),
        *bolts(10, 0.163, 0.385, 0.402, "x", (y, 0.0)),
        turned([(0.37, 0.152), (0.52, 0.148), (0.80, 0.130), (1.08, 0.114), (1.13, 0.114)], "x", (y, 0.0)),
        turned([(1.09, 0.118), (1.10, 0.128), (1.135, 0.128), (1.145, 0.120)], "x", (y, 0.0)),
        *bolts(10, 0.118, 1.14, 1.152, "x", (y, 0.0), size=0.008),
        # wrist: fork of axis 5, its covers, the tilting body and the flange of axis 6
        loft(
            [
                (1.13, circle(0.112, (y, 0.0))),
                (1.20, rounded(0.215, 0.235, 0.10, (y, 0.0))),
                (1.27, rounded(0.20, 0.25, 0.06, (y, 0.0))),
                (1.29, rounded(0.18, 0.24, 0.05, (y, 0.0))),
            ],
            "x",
        ),
        *(
            prism(
                hull(circle(0.098, (axis5, y)), [(1.20, y - 0.095), (1.20, y + 0.095)]),
                z,
                z + 0.05,
                "z",
                chamfer=0.012,
            )
            for z in (-0.13, 0.08)
        ),
        *(
            turned(sorted(((0.12 * s, 0.072), (0.138 * s, 0.072), (0.146 * s, 0.062))), "z", (axis5, y))
            for s in (-1, 1)
        ),
        *bolts(6, 0.083, 0.13, 0.138, "z", (axis5, y), size=0.007),
        *bolts(6, 0.083, -0.138, -0.13, "z", (axis5, y), size=0.007),
        turned([(-0.085, 0.088), (0.085, 0.088)], "z", (axis5, y)),
        turned([(1.40, 0.074), (1.50, 0.080), (1.53, 0.080), (1.545, 0.070), (1.575, 0.070)], "x", (y, 0.0)),
        turned([(1.57, 0.072), (1.575, 0.080), (1.610, 0.080), (FLANGE[0], 0.075)], "x", (y, 0.0)),
    ]


def motor1() -> list[Solid]:
    return motor(-0.02, 0.34, (-0.13, 0.16), 0.105, away=150)


def motor2() -> list[Solid]:
    return motor(-0.095, -0.47, (0.0, 0.0), 0.115, away=115)


def motor3() -> list[Solid]:
    return motor(-0.188, -0.50, (0.0, 0.0), 0.095, away=160)


BODIES: dict[str, Callable[[], list[Solid]]] = {
    f.__name__: f for f in (base, link1, link2, link3, motor1, motor2, motor3)
}


# Output ----------------------------------------------------------------------------------------------


def mesh(body: str) -> Solid:
    """One body's solids as one mesh."""
    solids = BODIES[body]()
    first = np.cumsum([0, *(len(solid.vertices) for solid in solids[:-1])])
    faces = np.vstack([solid.faces + start for solid, start in zip(solids, first, strict=True)])
    return Solid(np.vstack([solid.vertices for solid in solids]), faces, process=False)


def placements(q_deg: ArrayLike) -> dict[str, NDArray[np.float64]]:
    """World poses (4, 4) of all bodies at joint angles (3,) in degrees."""
    shift, turn = trimesh.transformations.translation_matrix, trimesh.transformations.rotation_matrix
    z = [turn(q, [0, 0, 1]) for q in np.radians(np.asarray(q_deg, dtype=float))]
    first = shift([0, 0, SHOULDER_HEIGHT]) @ z[0]
    second = first @ shift([A1, 0, 0]) @ turn(np.pi / 2, [1, 0, 0]) @ z[1]
    third = second @ shift([A2, 0, 0]) @ z[2]
    poses = enumerate((first, second, third), start=1)
    return {"base": np.eye(4)} | {f"{kind}{i}": pose for i, pose in poses for kind in ("link", "motor")}


def write(path: Path, content: bytes) -> None:
    """Write aside, then replace: a broken run leaves the old file."""
    aside = path.with_name(path.name + ".part")
    aside.write_bytes(content)
    os.replace(aside, path)


def draw(path: Path) -> None:
    """PNG of the assembled robot in the three postures, each from either side."""
    import matplotlib.pyplot as plt
    from matplotlib.colors import to_rgb
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    colours = {"base": "#4a4d52", "link": "#f36f1d", "motor": "#2b2d31"}
    fine = {}  # small faces sort well in depth
    for body in BODIES:
        whole = mesh(body)
        fine[body] = trimesh.remesh.subdivide_to_size(whole.vertices, whole.faces, 0.09)[:2]
    shades = [to_rgb(colours[body.rstrip("123")]) for body, (_, faces) in fine.items() for _ in faces]
    figure = plt.figure(figsize=(18, 13))
    for column, (name, q_deg) in enumerate(POSTURES.items()):
        poses = placements(q_deg)
        placed = {body: trimesh.transform_points(fine[body][0], poses[body]) for body in fine}
        triangles = np.vstack([placed[body][faces] for body, (_, faces) in fine.items()])
        low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        for row, azimuth in enumerate((-60, 125)):
            axes = figure.add_subplot(2, 3, 1 + column + 3 * row, projection="3d", proj_type="ortho")
            axes.add_collection3d(Poly3DCollection(triangles, facecolors=shades, shade=True))
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
            axes.set_title(f"{name} {q_deg}°")
            axes.set_box_aspect(high - low, zoom=1.05)
            axes.view_init(elev=16, azim=azimuth)
            axes.set_axis_off()
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def main(
    out: Annotated[Path, typer.Option(help="Folder for the STL files.", file_okay=False)] = OUT,
    preview: Annotated[Path | None, typer.Option(help="PNG of the assembled robot.", dir_okay=False)] = None,
) -> None:
    """Write the KR90's shapes as binary STL, one file per body."""
    out.mkdir(parents=True, exist_ok=True)
    for body in BODIES:
        content = trimesh.exchange.stl.export_stl(mesh(body))
        write(out / f"{body}.stl", content)
        typer.echo(f"{out / body}.stl  {len(content) / 1000:.0f} kB")
    if preview:
        draw(preview)


if __name__ == "__main__":
    typer.run(main)
