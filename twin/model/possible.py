"""Parameters of robots that can exist: links are bodies, rotors turn, and friction takes power."""

import numpy as np
from numpy.typing import NDArray

from twin.measure.campaign import FloatArray
from twin.model.regressor import Regressor, body_of, pseudo_inertia


def floors(regressor: Regressor, margin: float) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which parameters (p,) have a least value of their own, and that (p,)."""
    columns = regressor.columns
    floor = np.array([column.nonnegative and column.group != "link" for column in columns])
    rotor = np.array([column.group == "rotor" for column in columns])
    return floor, np.where(rotor, margin * regressor.described, 0.0)


def nearest_possible(
    regressor: Regressor, H: FloatArray, linear: FloatArray, x0: FloatArray, step: FloatArray, margin: float = 1e-3
) -> FloatArray:
    """d (m,) of least ½ dᵀH d + linearᵀd at which x0 + step d (p,) is a robot that can exist.

    Convex in the cone of positive semidefinite matrices (Wensing, Kim, Slotine 2018), solved by Clarabel. ``margin`` of
    the described pseudo-inertia of a body and inertia of a rotor are left at least.
    """
    import clarabel  # type: ignore[import-untyped]
    from scipy import sparse

    rows, bounds, cones = [], [], []
    floor, least = floors(regressor, margin)
    if floor.any():
        rows.append(-step[floor])
        bounds.append((x0 - least)[floor])
        cones.append(clarabel.NonnegativeConeT(int(floor.sum())))
    root2 = np.sqrt(2.0)
    triangle = [(i, j) for j in range(4) for i in range(j + 1)]
    for i in range(regressor.robot.axis_count):
        part = slice(10 * i, 10 * i + 10)
        scale = np.sqrt(np.diag(pseudo_inertia(regressor.described[part])))
        # congruence keeps definiteness and makes the numbers of one size
        unit = np.stack([pseudo_inertia(row) for row in np.eye(10)], axis=-1) / np.outer(scale, scale)[:, :, None]
        pick = np.array([unit[a, c] * (1 if a == c else root2) for a, c in triangle])
        rows.append(-pick @ step[part])
        bounds.append(pick @ (x0[part] - margin * regressor.described[part]))
        cones.append(clarabel.PSDTriangleConeT(4))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(H)), linear, sparse.csc_matrix(np.concatenate(rows)), np.concatenate(bounds), cones,
        settings,
    )  # fmt: skip
    solution = solver.solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        raise ArithmeticError(f"no physically consistent set found: {solution.status}")
    return np.array(solution.x)


def possible(vector: FloatArray) -> bool:
    """Whether ten parameters of a link are a body's."""
    if vector[0] <= 0 or np.linalg.eigvalsh(pseudo_inertia(vector))[0] <= 0:
        return False
    principal = np.linalg.eigvalsh(body_of(vector)[2])
    return bool(principal[0] > 0 and principal[0] + principal[1] > principal[2] * (1 + 1e-9))
