"""Base parameters: the smallest set of combinations of parameters that the torque depends on.

Gautier, Numerical calculation of the base inertial parameters of robots, J. Robotic Systems 8 (1991).
"""

from dataclasses import dataclass

import numpy as np

from twin.model.regressor import INERTIAL, Column, Regressor
from twin.physics.motion import Motion
from twin.robot.description import Robot

ROUNDING = 1e-10  # of a column's norm: what is left of a dependent column is rounding
INDEPENDENT = 1e-5  # of a column's norm: less is an axis a few microradians off (π written as 3.14159), not a parameter
_KEPT_FIRST = ("Izz", "mcx", "mcy", "Ixx", "Ixz", "Ixy", "Iyz", "Iyy", "mcz", "mass")


@dataclass(frozen=True)
class BaseParameters:
    """How p parameters combine to b base parameters: π = K x, and Y x = Y[:, kept] π.

    Attributes:
        columns: (p,) of the regressor.
        kept: (b,) indices of the columns that stay; each names its combination.
        combine: K (b, p); unity in the kept columns.
        none: indices of columns without any torque.
    """

    columns: list[Column]
    kept: np.ndarray
    combine: np.ndarray
    none: np.ndarray

    @property
    def names(self) -> list[str]:
        """Names (b,) of the kept columns."""
        return [self.columns[k].name for k in self.kept]

    @property
    def units(self) -> list[str]:
        """Units (b,)."""
        return [self.columns[k].unit for k in self.kept]

    def combinations(self, robot: Robot) -> list[str]:
        """Each base parameter written out (b,), with the robot's lengths where they fit: ``a2² link3.mass``."""
        lengths = _lengths(robot)
        return [self._written(row, kept, lengths) for row, kept in zip(self.combine, self.kept, strict=True)]

    def _written(self, row: np.ndarray, kept: int, lengths: dict[str, float]) -> str:
        text = self.columns[kept].name
        for k in np.flatnonzero(np.abs(row) > 1e-6):
            if k != kept:
                sign, factor = "−" if row[k] < 0 else "+", _symbol(abs(row[k]), lengths)
                text += f" {sign} {factor}{' ' if factor else ''}{self.columns[k].name}"
        return text


def base_parameters(matrix: np.ndarray, columns: list[Column]) -> BaseParameters:
    """Which columns a regressor needs, by orthogonal triangularisation in a fixed order of preference.

    A column is kept when it is independent of those before it. Links' moments Izz, mcx, mcy, Ixx, Ixz, Ixy, Iyz come
    first (the choice of the paper's Appendix B), Iyy, mcz and mass last, both from the base outwards. Then come rotors
    and entries.

    Args:
        matrix: (m, p) regressor rows of a motion that excites everything, m well above p.
        columns: (p,).
    """
    scale = np.linalg.norm(matrix, axis=0)
    none = np.flatnonzero(scale <= ROUNDING * max(scale.max(), 1e-300))
    # Rows are squeezed to p first, so that the loop below is over small vectors.
    R: np.ndarray = np.asarray(np.linalg.qr(matrix / np.where(scale > 0, scale, 1), mode="r"))
    order = sorted((k for k in range(len(columns)) if k not in none), key=lambda k: _preference(columns[k], k))
    kept: list[int] = []
    basis = np.zeros((len(R), 0))
    for k in order:
        rest = R[:, k]
        for _ in range(2):  # twice is enough (Kahan)
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > INDEPENDENT:
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            kept.append(k)
    kept.sort()
    combine = np.zeros((len(kept), len(columns)))
    used = [k for k in range(len(columns)) if k not in none]
    combine[:, used] = np.linalg.lstsq(R[:, kept], R[:, used], rcond=None)[0]
    combine *= scale[None, :] / scale[kept][:, None]
    size = np.abs(combine) * scale[kept][:, None] / np.where(scale > 0, scale, 1)[None, :]
    combine[size < ROUNDING] = 0.0
    combine[:, kept] = np.eye(len(kept))
    return BaseParameters(columns, np.array(kept), combine, none)


def random_motion(robot: Robot, samples: int = 400, seed: int = 0) -> Motion:
    """Independent states (samples, n) within the axes' limits: they excite whatever can be excited at all."""
    rng = np.random.default_rng(seed)
    n = robot.axis_count
    low, high = np.empty(n), np.empty(n)
    for i, axis in enumerate(robot.axes):
        given = axis.limits.position if axis.limits else None
        low[i], high[i] = given or ((-np.pi, np.pi) if axis.type == "revolute" else (-1.0, 1.0))
    q = rng.uniform(low, high, (samples, n))
    return Motion(np.arange(samples, dtype=float), q, rng.normal(size=(samples, n)), rng.normal(0, 3, (samples, n)))


def structural_base(regressor: Regressor) -> BaseParameters:
    """Base parameters of a robot whatever the motion."""
    motion = random_motion(regressor.robot, 40 + 4 * len(regressor.columns))
    Y = regressor.evaluate(motion)
    return base_parameters(Y.reshape(-1, Y.shape[-1]), regressor.columns)


def _preference(column: Column, k: int) -> tuple[int, int, int]:
    if column.group == "link":
        name = column.name.partition(".")[2]
        late = _KEPT_FIRST.index(name)
        link = k // len(INERTIAL)
        return (0, link, late) if late < 7 else (1, link, late)
    return (2, k, 0)


def _lengths(robot: Robot) -> dict[str, float]:
    """Symbols of the robot's lengths (m) and gear ratios."""
    symbols = {}
    for i, axis in enumerate(robot.axes):
        for name, value in ((f"a{i}", axis.a), (f"d{i + 1}", axis.d)):
            if abs(value) > ROUNDING:
                symbols[name] = abs(value)
    return symbols


def _symbol(value: float, lengths: dict[str, float]) -> str:
    """A positive coefficient as a product of at most two lengths, else as a number; nothing for one."""
    if abs(value - 1) < 1e-7:
        return ""
    names = list(lengths)
    products = {name: lengths[name] for name in names}
    for i, first in enumerate(names):
        for second in names[i:]:
            products[f"{first}²" if first == second else f"{first} {second}"] = lengths[first] * lengths[second]
    for factor, mark in ((1.0, ""), (2.0, "2 ")):
        for name, product in products.items():
            if abs(value - factor * product) < 1e-7 * max(value, 1.0):
                return mark + name
    return f"{value:.6g}"
