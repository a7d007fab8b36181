"""Frequency response functions of a linear model between any points, as the measurement chain would record them."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from twin.model.linear import LinearModel
from twin.physics import CATALOGUE
from twin.physics.chain import MeasurementChain
from twin.robot.description import Robot

Quantity = Literal["receptance", "mobility", "accelerance"]
_POWER = {"receptance": 0, "mobility": 1, "accelerance": 2}


def measurement_chain(
    linear: LinearModel, robot: Robot, responses: Sequence[str], excitations: Sequence[str],
    struck: LinearModel | None = None,
) -> MeasurementChain:  # fmt: skip
    """The chain between the model's points and the recording, as the robot's measurement entries make it.

    ``struck`` is as in :func:`frf`: where a blow has another direction than a sensor of the same label.
    """
    chain = MeasurementChain(
        tuple(responses), np.array([linear.directions[label] for label in responses]),
        tuple(excitations), np.array([(struck or linear).directions[label] for label in excitations]),
        torque_gain=np.ones(robot.axis_count),
    )  # fmt: skip
    for entry in robot.physics:
        CATALOGUE[entry.effect].record(chain, entry.site, entry.values)
    return chain


def frf(
    linear: LinearModel,
    frequency: np.ndarray,
    responses: Sequence[str] | MeasurementChain,
    excitations: Sequence[str] = (),
    quantity: Quantity = "accelerance",
    exponential_window_rate: float = 0.0,
    struck: LinearModel | None = None,
) -> np.ndarray:
    """Frequency response functions H(ω) = sᵖ J_r (s²M + sC + K + i·loss + integral/s)⁻¹ J_eᵀ, e^{+iωt}.

    Args:
        linear: from :func:`twin.model.linear.linearise`.
        frequency: (nf,) Hz.
        responses: (nr,) labels of points, or a measurement chain, which also holds the excitations.
        excitations: (ne,) labels of points.
        quantity: receptance m/N, mobility m/(N·s) or accelerance m/(N·s²).
        exponential_window_rate: 1/s; force and response both multiplied by e^{−rate·t} see s = iω + rate.
        struck: the same model with the points of the excitations, where a label names another point there.

    Returns:
        (nf, nr, ne) complex.
    """
    if isinstance(responses, MeasurementChain):
        chain = responses
    else:
        chain = MeasurementChain(
            tuple(responses), np.array([linear.directions[label] for label in responses]),
            tuple(excitations), np.array([(struck or linear).directions[label] for label in excitations]),
        )  # fmt: skip
    J_r = _rows(linear, chain.response_labels, chain.response_direction)
    J_e = _rows(struck or linear, chain.excitation_labels, chain.excitation_direction)
    s = (2j * np.pi * np.asarray(frequency, float) + exponential_window_rate)[:, None, None]
    Z = s**2 * linear.M + s * linear.C + linear.K
    if linear.loss.any():
        Z = Z + 1j * linear.loss
    if linear.integral.any():
        Z = Z + linear.integral / s
    loaded = chain.response_load.any()
    forces = np.vstack([J_e, J_r]).T if loaded else J_e.T
    X = J_r @ np.linalg.solve(Z, np.broadcast_to(forces, (len(s), *forces.shape)))
    if loaded:  # each sensor on the robot while it records, see twin.model.sensitivity
        X, B = X[..., : len(J_e)], X[..., len(J_e) :]
        X = np.linalg.solve(np.eye(len(J_r)) + s**2 * chain.response_load * B, X)
    record = chain.response_gain[:, None] * np.exp(-s * chain.response_delay[:, None])
    return s ** _POWER[quantity] * record * X


def _rows(linear: LinearModel, labels: Sequence[str], directions: np.ndarray) -> np.ndarray:
    rows = [direction @ linear.points[label][1] for label, direction in zip(labels, directions, strict=True)]
    return np.array(rows).reshape(-1, len(linear.coordinates))
