"""Makes mjcf/kr90_identified.yaml: kr90 with Table 3's springs and physically consistent links near Table A1.

Table A1 of Huynh et al. (Robotics and Computer-Integrated Manufacturing 61, 2020) holds no consistent robot: its
second link would have Σ m y² = 0.6 kg·m² with Σ m y = 48 kg·m. The links made here have positive definite
pseudo-inertias P = [[Σ m r rᵀ, Σ m r], [Σ m rᵀ, m]], kr90's masses, the nine natural frequencies that A1 and Table 3
give, and otherwise minimise

    Σ |π − π_A1| / |π_A1|  +  Σ_links w [tr(P₀⁻¹P) − log det(P₀⁻¹P) − 4]

over the fifteen inertial base parameters π, rotor terms removed. The second term, the log-det divergence from the
links of kr90 (Lee, Wensing, Park: Geometric robot dynamic identification, IEEE T-RO 36, 2020), decides what π leaves
open and keeps P away from the boundary. Both are convex in P. Everything else is copied from kr90.yaml.

    python tools/make_identified.py [--out mjcf/kr90_identified.yaml]
"""

import re
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from twin.files import writing
from twin.robot.description import SHIPPED, Link, Robot, load_robot
from twin.robot.frames import inertia_matrix, inertia_six

OUT = SHIPPED / "kr90_identified.yaml"
LINK_1, LINK_2 = 0.35, 1.35  # a1, a2: m
GRAVITY = 9.81  # m/s²
STIFFNESS = np.array([3.12e6, 3.75e6, 2.98e6])  # Table 3: N·m/rad
DAMPING = np.array([1450.0, 1100.0, 290.0])  # Table 3: N·m·s/rad
POSTURES_DEG = {"milling": (0, 70, -100), "upright": (0, 135, -100), "rigid": (0, 135, -140)}

# w above, approached from afar so that Newton's method keeps clear of the boundary. Larger is rounder and farther from
# A1 (0.1: π3 at 520); at 0.01 the arm's smallest standard deviation of mass is 9 cm, that of a plate 0.32 m thick.
DIVERGENCE_WEIGHTS = (1.0, 0.3, 0.1, 0.03, 0.01)
# A1 wants 175 kg·m² more yaw inertia than Table 5. The shoulder, of which A1 shows nothing else, is to take most of it.
TIE = np.array([0.1, 1.0, 1.0])
ROUNDING = 0.01  # relative differences below this count quadratically: |d| as sqrt(d² + ROUNDING²)
FREQUENCY_HZ = 0.001  # a frequency off by this much costs 1/2


class BaseParameter(NamedTuple):
    """A row of Table A1; products of inertia here are +Σ m x y, the sign under which Appendix B holds."""

    combination: str
    unit: str
    printed: float


TABLE_A1 = (
    BaseParameter("Izz1 + Iyy2 + Iyy3 + a1² (M2 + M3) + a2² M3", "kg·m²", 1897.8),
    BaseParameter("Izz2 + a2² M3", "kg·m²", 1466.5),
    BaseParameter("Cx2 M2 + a2 M3", "kg·m", 678.7),
    BaseParameter("Cy2 M2", "kg·m", 48.3),
    BaseParameter("Ixx2 − Iyy2 − a2² M3", "kg·m²", -662.2),
    BaseParameter("Ixz2 + a2 Cz3 M3", "kg·m²", 34.4),
    BaseParameter("Ixy2", "kg·m²", 91.9),
    BaseParameter("Iyz2", "kg·m²", -1.0),
    BaseParameter("Izz3", "kg·m²", 162.1),
    BaseParameter("Cx3 M3", "kg·m", 129.1),
    BaseParameter("Cy3 M3", "kg·m", -2.7),
    BaseParameter("Ixx3 − Iyy3", "kg·m²", -155.2),
    BaseParameter("Ixz3", "kg·m²", 1.4),
    BaseParameter("Ixy3", "kg·m²", 3.1),
    BaseParameter("Iyz3", "kg·m²", -1.0),
)


def table_a1(robot: Robot) -> np.ndarray:
    """The fifteen inertial base parameters (15,) of Table A1 less N²J of the first two rotors (paper, Section 4)."""
    value = np.array([row.printed for row in TABLE_A1])
    value[:2] -= [drive.gear_ratio**2 * drive.rotor_inertia for drive in robot.drives[:2]]
    return value


def pseudo_inertias(robot: Robot) -> np.ndarray:
    """Pseudo-inertias (n, 4, 4) of the links about their frames' origins: kg·m², kg·m, kg."""
    pseudo = np.zeros((len(robot.links), 4, 4))
    for P, link in zip(pseudo, robot.links, strict=True):
        r, inertia = np.append(link.com, 1.0), inertia_matrix(link.inertia)
        P[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        P += link.mass * np.outer(r, r)
    return pseudo


def link_of(P: np.ndarray, like: Link) -> Link:
    """A link with this pseudo-inertia (4, 4), rounded to 1 µm and 1e-5 kg·m²; name and mesh as ``like``."""
    com = P[:3, 3] / P[3, 3]
    central = P[:3, :3] - P[3, 3] * np.outer(com, com)
    inertia = np.trace(central) * np.eye(3) - central
    return like.model_copy(
        update={
            "com": tuple(round(float(c), 6) for c in com),
            "inertia": tuple(round(value, 5) for value in inertia_six(inertia)),
        }
    )


def smallest_spread(robot: Robot) -> float:
    """The least standard deviation (m) of any link's mass along any direction: how far from the boundary P is."""
    spread = []
    for link in robot.links:
        inertia = inertia_matrix(link.inertia)
        spread.append(np.linalg.eigvalsh(0.5 * np.trace(inertia) * np.eye(3) - inertia)[0] / link.mass)
    return float(np.sqrt(min(spread)))


def base_parameters(pseudo: np.ndarray) -> np.ndarray:
    """The fifteen combinations of Table A1, (15,), from three pseudo-inertias (3, 4, 4); linear."""
    P1, P2, P3 = pseudo
    xx1, yy1, _, _ = np.diag(P1)
    xx2, yy2, zz2, m2 = np.diag(P2)
    xx3, yy3, zz3, m3 = np.diag(P3)
    return np.array(
        [
            xx1 + yy1 + xx2 + zz2 + xx3 + zz3 + LINK_1**2 * (m2 + m3) + LINK_2**2 * m3,
            xx2 + yy2 + LINK_2**2 * m3,
            P2[0, 3] + LINK_2 * m3,
            P2[1, 3],
            yy2 - xx2 - LINK_2**2 * m3,
            P2[0, 2] + LINK_2 * P3[2, 3],
            P2[0, 1],
            P2[1, 2],
            xx3 + yy3,
            P3[0, 3],
            P3[1, 3],
            yy3 - xx3,
            P3[0, 2],
            P3[0, 1],
            P3[1, 2],
        ]
    )


def mass_and_gravity(pi: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix and gravity's stiffness, each (3, 3), from base parameters (15,) and angles q (3,) in rad."""
    p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11, p12, p13, p14, p15 = pi
    s2, c2, s3, c3, s23, c23 = (f(angle) for angle in (q[1], q[2], q[1] + q[2]) for f in (np.sin, np.cos))
    m11 = (
        p1 + p5 * s2**2 - 2 * p7 * s2 * c2 + 2 * LINK_1 * (p3 * c2 - p4 * s2)
        + p12 * s23**2 - 2 * p14 * s23 * c23 + 2 * (LINK_1 + LINK_2 * c2) * (p10 * c23 - p11 * s23)
    )  # fmt: skip
    m13 = -p13 * s23 - p15 * c23
    m12 = m13 - p6 * s2 - p8 * c2
    elbow = LINK_2 * (p10 * c3 - p11 * s3)
    M = np.array([[m11, m12, m13], [m12, p2 + p9 + 2 * elbow, p9 + elbow], [m13, p9 + elbow, p9]])
    forearm = -GRAVITY * (p10 * s23 + p11 * c23)
    arm = forearm - GRAVITY * (p3 * s2 + p4 * c2)
    return M, np.array([[0, 0, 0], [0, arm, forearm], [0, forearm, forearm]])


def poles(pi: np.ndarray) -> np.ndarray:
    """λ in rad/s, (3 postures, 3 modes), on Table 3's springs and dampers with the rotors held."""
    rows = []
    for q_deg in POSTURES_DEG.values():
        M, K = mass_and_gravity(pi, np.deg2rad(q_deg))
        lower = -np.linalg.solve(M, np.hstack([K + np.diag(STIFFNESS), np.diag(DAMPING)]))
        pole = np.linalg.eigvals(np.block([[np.zeros((3, 3)), np.eye(3)], [lower]]))
        pole = pole[pole.imag > 0]
        rows.append(pole[np.argsort(np.abs(pole))])
    return np.array(rows)


def frequencies(pi: np.ndarray) -> np.ndarray:
    """Nine natural frequencies in Hz, posture by posture."""
    return np.abs(poles(pi)).ravel() / (2 * np.pi)


def _frequency_slopes(pi: np.ndarray, step: float = 1e-3) -> np.ndarray:
    columns = [(frequencies(pi + d) - frequencies(pi - d)) / (2 * step) for d in step * np.eye(len(pi))]
    return np.array(columns).T


def nearest_consistent(start: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Pseudo-inertias (3, 4, 4) that minimise the objective above.

    A damped Newton method, Gauss–Newton in the frequencies.

    Args:
        start: (3, 4, 4) pseudo-inertias P₀; their masses are kept.
        target: (15,) base parameters π_A1, which also give the frequencies.
    """
    rows, columns = np.triu_indices(4)
    basis = np.zeros((9, 4, 4))  # of symmetric matrices without the mass
    basis[range(9), rows[:9], columns[:9]] = basis[range(9), columns[:9], rows[:9]] = 1
    inverse = np.linalg.inv(start)
    wanted, scale = frequencies(target), np.abs(target)
    rate = np.array([base_parameters(np.eye(3)[i][:, None, None] * e) for i in range(3) for e in basis]).T

    def residuals(pseudo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pi = base_parameters(pseudo)
        return (pi - target) / scale, (frequencies(pi) - wanted) / FREQUENCY_HZ

    def objective(pseudo: np.ndarray, weight: float) -> float:
        if np.linalg.eigvalsh(pseudo).min() <= 0:
            return np.inf
        d, r = residuals(pseudo)
        ratio = inverse @ pseudo
        divergence = np.trace(ratio, axis1=1, axis2=2) - np.linalg.slogdet(ratio)[1] - 4
        return float(np.sqrt(d**2 + ROUNDING**2).sum() + 0.5 * r @ r + weight * TIE @ divergence)

    def slopes(pseudo: np.ndarray, weight: float) -> tuple[np.ndarray, np.ndarray]:
        d, r = residuals(pseudo)
        rounded = np.sqrt(d**2 + ROUNDING**2)
        D, F = rate / scale[:, None], _frequency_slopes(base_parameters(pseudo)) @ rate / FREQUENCY_HZ
        gradient = D.T @ (d / rounded) + F.T @ r
        hessian = D.T @ ((ROUNDING**2 / rounded**3)[:, None] * D) + F.T @ F
        for i, P in enumerate(pseudo):
            link, here = slice(9 * i, 9 * i + 9), np.linalg.inv(P)
            gradient[link] += weight * TIE[i] * np.einsum("kij,ji->k", basis, inverse[i] - here)
            hessian[link, link] += weight * TIE[i] * np.einsum("kij,lji->kl", here @ basis, here @ basis)
        return gradient, hessian

    pseudo = start
    for weight in DIVERGENCE_WEIGHTS:
        for _ in range(200):
            gradient, hessian = slopes(pseudo, weight)
            step = -np.linalg.solve(hessian, gradient)
            decrement = -float(gradient @ step)
            move, length = np.einsum("ik,kab->iab", step.reshape(3, 9), basis), 1.0
            if decrement < 1e-10:  # rounding now hides what the objective gains
                pseudo = pseudo + move
                break
            bound = objective(pseudo, weight)
            while objective(pseudo + length * move, weight) > bound - 1e-4 * length * decrement:
                length /= 2
            pseudo = pseudo + length * move
        else:
            raise RuntimeError(f"no minimum at weight {weight} within 200 steps, decrement {decrement:.1e}")
    return pseudo


def identified(kr90: Robot) -> Robot:
    """kr90 with Table 3's springs and the links nearest to Table A1."""
    pseudo = nearest_consistent(pseudo_inertias(kr90), table_a1(kr90))
    links = [link_of(P, link) for P, link in zip(pseudo, kr90.links, strict=True)]
    axes = [
        axis.model_copy(update={"stiffness": float(k), "damping": float(d)})
        for axis, k, d in zip(kr90.axes, STIFFNESS, DAMPING, strict=True)
    ]
    return kr90.model_copy(update={"name": OUT.stem, "links": links, "axes": axes})


def statement(robot: Robot) -> list[str]:
    """Lines that state the distance to Table A1 and the frequencies."""
    target, here = table_a1(robot), base_parameters(pseudo_inertias(robot))
    difference = here - target
    relative = difference / np.abs(target)
    lines = [
        f"   {'':2}  {'base parameter':44} {'unit':5} {'A1':>8} {'here':>8} {'difference':>10} {'%':>6}",
        *(
            f"   {i:2}  {row.combination:44} {row.unit:5} {a:8.2f} {b:8.2f} {d:10.2f} {100 * e:6.1f}"
            for i, (row, a, b, d, e) in enumerate(
                zip(TABLE_A1, target, here, difference, relative, strict=True), start=1
            )
        ),
        f"Sum of the relative differences {np.abs(relative).sum():.3f}; "
        f"{np.sum(np.abs(relative) < 0.05)} of 15 within 5 %, {np.sum(np.abs(relative) < 0.01)} within 1 %.",
        f"Smallest standard deviation of a link's mass, in any direction: {smallest_spread(robot):.3f} m.",
        "Natural frequencies (Hz) and damping ratios (%), A1's in brackets:",
    ]
    for name, ours, theirs in zip(POSTURES_DEG, poles(here), poles(target), strict=True):
        pairs = (f"{_modal(a)} ({_modal(b)})" for a, b in zip(ours, theirs, strict=True))
        lines.append(f"   {name:8} {'   '.join(pairs)}")
    return lines


def _modal(pole: complex) -> str:
    return f"{abs(pole) / (2 * np.pi):.3f} {-100 * pole.real / abs(pole):.2f}"


def described(robot: Robot, kr90_text: str) -> str:
    """The description as YAML: the text of kr90.yaml with links and z-springs replaced and the distance stated."""
    target = table_a1(robot)
    bound = np.sqrt(target[1] * (robot.links[1].mass + robot.links[2].mass))
    least = GRAVITY * (target[2] - bound)
    lost = GRAVITY * (target[2] - base_parameters(pseudo_inertias(robot))[2])
    head = f"""\
KUKA KR90 R3100, first three axes, wrist locked, as identified with one spring per axis: Table 3's springs and dampers
about z, and links near Table A1 (Huynh et al., Robotics and Computer-Integrated Manufacturing 61, 2020).
With --without transverse_compliance it gives Table 4.
Made from kr90.yaml by `python tools/make_identified.py`; change those two, not this file.

Table A1 itself is physically inconsistent. These links have positive definite pseudo-inertias, Table 5's masses, and
A1's nine natural frequencies; under that they minimise the sum of relative differences to A1 (rotor terms removed),
loosely tied to Table 5 where A1 says nothing. What cannot agree: π3² ≤ π2 (M2 + M3) caps π3 at {bound:.0f} kg·m, and π7
must follow π3 to leave the yaw inertia, and with it the first mode, as A1 has it. Gravity at joint 2 is thereby
{lost:.0f} N·m × cos q2 below A1's; the cap leaves no less than {least:.0f}. Products in the table are +Σ m x y.
"""
    comment = "\n".join(f"# {line}".rstrip() for line in [*head.splitlines(), "", *statement(robot)])
    chapters = re.split(r"(?m)^(?=[a-z_]+:)", kr90_text)
    text = {chapter.partition(":")[0]: chapter for chapter in chapters[1:]}
    text["name"] = f"name: {robot.name}\n"
    text["description"] = "description: KUKA KR90 R3100 with Table 3's springs and consistent links near Table A1\n"
    text["links"] = _titled(
        text["links"], "masses from Table 5; inertia (xx, yy, zz, xy, xz, yz) at the centre of mass"
    )
    text["links"] = _filled(text["links"], "com", [list(link.com) for link in robot.links])
    text["links"] = _filled(text["links"], "inertia", [list(link.inertia) for link in robot.links])
    text["axes"] = _titled(text["axes"], "Table 1 limits; Table 3 springs and dampers about z")
    text["axes"] = _filled(text["axes"], "stiffness", [f"{k / 1e6:g}e6" for k in STIFFNESS])
    text["axes"] = _filled(text["axes"], "damping", [f"{d:g}" for d in DAMPING])
    text["physics"] = _titled(
        text["physics"], "Table 6 was fitted with other links and z-springs: starting values only"
    )
    return "\n".join([comment, "".join(text.values())])


def _titled(chapter: str, comment: str) -> str:
    first, _, rest = chapter.partition("\n")
    return f"{first.partition('#')[0].rstrip():42} # {comment}\n{rest}"


def _filled(chapter: str, key: str, values: list) -> str:
    pattern = rf"(?<=\b{key}: )(\[[^]]*\]|[^,}}]+)"
    fill = iter(values)
    chapter, count = re.subn(pattern, lambda _: str(next(fill)), chapter)
    if count != len(values):
        raise ValueError(f"expected {len(values)} times {key!r} in kr90.yaml, found {count}")
    return chapter


def main(out: Annotated[Path, typer.Option(help="where the description is written")] = OUT) -> None:
    """Write kr90_identified.yaml and print how far it is from Table A1."""
    robot = identified(load_robot("kr90"))
    with writing(out) as stream:
        stream.write(described(robot, (SHIPPED / "kr90.yaml").read_text(encoding="utf-8")))
    print("\n".join(statement(robot)))


if __name__ == "__main__":
    typer.run(main)
