"""The measurement chain between the structure and the recording: channels, gains, delays."""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class MeasurementChain:
    """What stands between motion and numbers; measurement effects edit it.

    Attributes:
        response_labels: (nr,) accelerometer channels, as ``21Z+``.
        response_direction: (nr, 3) unit vectors in the body's frame.
        excitation_labels: (ne,) hammer degrees of freedom.
        excitation_direction: (ne, 3) unit vectors in the body's frame.
        response_gain: (nr,) recorded = gain × true.
        response_delay: (nr,) s, channel late by.
        response_load: (nr, nr) kg, of the sensor that a channel and another share: on the robot only where and while
            they record; 0 between nodes.
        torque_gain: (n,) recorded = gain × true, of a cold motor.
        torque_warming: axis → share by which the gain grows as the motor warms, and its time constant s.
        torque_delay: s, torque late against position.
        torque_lag: s, time constant of the recorder's low-pass of first order on torque.
    """

    response_labels: tuple[str, ...]
    response_direction: np.ndarray
    excitation_labels: tuple[str, ...]
    excitation_direction: np.ndarray
    response_gain: np.ndarray = field(default_factory=lambda: np.ones(0))
    response_delay: np.ndarray = field(default_factory=lambda: np.zeros(0))
    response_load: np.ndarray = field(default_factory=lambda: np.zeros(0))
    torque_gain: np.ndarray = field(default_factory=lambda: np.ones(0))
    torque_warming: dict[int, tuple[float, float]] = field(default_factory=dict)
    torque_delay: float = 0.0
    torque_lag: float = 0.0

    def __post_init__(self) -> None:
        self.response_direction = np.array(self.response_direction, float).reshape(-1, 3)
        self.excitation_direction = np.array(self.excitation_direction, float).reshape(-1, 3)
        if not self.response_gain.size:
            self.response_gain = np.ones(len(self.response_labels))
        if not self.response_delay.size:
            self.response_delay = np.zeros(len(self.response_labels))
        if not self.response_load.size:
            self.response_load = np.zeros((len(self.response_labels),) * 2)

    def gain_at(self, time: np.ndarray) -> np.ndarray:
        """Gain of the torques at times of the campaign's clock, s: (n,), or (nt, n) where motors warm."""
        if not self.torque_warming:
            return self.torque_gain
        gain = np.tile(self.torque_gain, (len(time), 1))
        for axis, (share, constant) in self.torque_warming.items():
            gain[:, axis] *= 1 + share * (1 - np.exp(-time / constant))
        return gain

    def responses(self, site: str) -> list[int]:
        """Indices of the response channel a site ``sensor:LABEL`` names; empty when it is not recorded."""
        return [k for k, label in enumerate(self.response_labels) if site == f"sensor:{label}"]

    def node_responses(self, site: str) -> list[int]:
        """Indices of all response channels on the node that ``sensor:NODE`` names."""
        return [k for k, label in enumerate(self.response_labels) if site == f"sensor:{node_of(label)}"]

    def nodes(self) -> dict[str, list[int]]:
        """Node → indices of its response channels."""
        found: dict[str, list[int]] = {}
        for k, label in enumerate(self.response_labels):
            found.setdefault(node_of(label), []).append(k)
        return found

    def excitations(self, site: str) -> list[int]:
        """Indices of the excitation that ``hammer:LABEL`` names."""
        return [k for k, label in enumerate(self.excitation_labels) if site == f"hammer:{label}"]


def node_of(label: str) -> str:
    """Node of a channel label: ``21Z+`` → ``21``."""
    return label.rstrip("+-").rstrip("XYZxyz")
