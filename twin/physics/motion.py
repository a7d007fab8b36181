"""The motion of all axes over time, as the torque laws of the effects read it."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from twin.robot.description import Robot


TURNING = 0.02
"""Share of its largest speed over which a joint's dry friction changes its sign, where no law says how."""


def gradual_sign(velocity: np.ndarray, over: float = TURNING) -> np.ndarray:
    """Signum of velocities (nt, ...) that changes gradually, over the share ``over`` of the largest of each."""
    return np.tanh(velocity / np.maximum(over * np.abs(velocity).max(axis=0, initial=0.0), 1e-300))


def sliding(time: np.ndarray, sign: np.ndarray, about_s: float = 0.1) -> np.ndarray:
    """Where an axis moves (nt,), 0 or 1, by the signum (nt,) of its velocity: where it turns back it does not rest.

    It rests where it has no sign for ``about_s`` and longer. At a single instant, as in time stepping, that is unknown;
    there it is the square of a signum that changes gradually.
    """
    if len(sign) < 2:
        return np.asarray(sign**2)
    edges = np.diff((sign == 0).astype(int), prepend=0, append=0)
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    rests = time[last] - time[first] >= about_s
    edges[:] = 0
    edges[first[rests]] += 1
    edges[last[rests] + 1] -= 1
    return 1.0 - np.cumsum(edges[:-1])


@dataclass
class Motion:
    """States of n axes at nt instants; laws are added one after the other.

    Attributes:
        time: (nt,) s, the campaign's clock.
        position: (nt, n) rad (m), as encoders say it, or as it is: :meth:`on`.
        velocity: (nt, n) rad/s (m/s).
        acceleration: (nt, n) rad/s² (m/s²).
        load: (nt, n) N·m (N), torque through the gears: rigid body and compensator.
        friction: (nt, n) N·m (N), sum of the friction laws evaluated so far.
        sign: signum of a velocity; time stepping replaces it by a continuous one.
        coupling: C (n, n) of θ = C q, where other axes turn a drive's rotor too; ``None`` where none does.
        drives: it is the motion of the drives' rotors at their gear outputs, and of their torque; else of the axes.
        kept: what it was through the coupling, of position, velocity and acceleration, while these are the same arrays.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    load: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    friction: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    sign: Callable[[np.ndarray], np.ndarray] = np.sign
    coupling: np.ndarray | None = None
    drives: bool = False
    kept: list[tuple[Any, ...]] = field(default_factory=list, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.load.size:
            self.load = np.zeros_like(self.position)
        if not self.friction.size:
            self.friction = np.zeros_like(self.position)

    def on(self, robot: "Robot") -> "Motion":
        """The motion as a robot feels it: encoders' zeros may be off, and drives be coupled."""
        motion = self if self.coupling is not None else self.coupled(robot)
        zeros = robot.encoder_zeros
        if not zeros.any():
            return motion
        if motion.drives and motion.coupling is not None:
            zeros = motion.coupling @ zeros
        return replace(motion, position=motion.position + zeros)

    def coupled(self, robot: "Robot") -> "Motion":
        """The same motion of axes, which knows how they turn the drives."""
        coupled = any(drive.coupling for drive in robot.drives)
        return replace(self, coupling=robot.coupling) if coupled else self

    @property
    def of_axes(self) -> "Motion":
        """Of the axes, q = C⁻¹ θ and τ_q = Cᵀ τ_θ."""
        if self.coupling is None or not self.drives:
            return self
        return self._turned(_inverse(self.coupling))

    @property
    def of_drives(self) -> "Motion":
        """Of the drives' rotors at their gear outputs, θ = C q and τ_θ = C⁻ᵀ τ_q."""
        if self.coupling is None or self.drives:
            return self
        return self._turned(self.coupling)

    def _turned(self, C: np.ndarray) -> "Motion":
        """The motion through x → C x: computed once for the same instants, its torques where a law asks for them."""
        own = self.position, self.velocity, self.acceleration
        of = *own, self.coupling
        if not self.kept or any(x is not y for x, y in zip(of, self.kept[0], strict=True)):
            self.kept[:] = [of, (*(x @ C.T for x in own), _inverse(C))]
        position, velocity, acceleration, back = self.kept[1]
        return _Turned(
            self.time, position, velocity, acceleration, sign=self.sign, coupling=self.coupling,
            drives=not self.drives, source=self, back=back,
        )  # fmt: skip

    def seen(self, torque: np.ndarray) -> np.ndarray:
        """Torque of the axes (nt, n, …) as what this is the motion of bears it."""
        if self.coupling is None or not self.drives:
            return torque
        return np.asarray(np.einsum("ji,tj...->ti...", _inverse(self.coupling), torque))

    def spread(self, torque: dict[int, np.ndarray], of_drives: bool) -> dict[int, np.ndarray]:
        """Torque by index, of drives or of axes, as what this is the motion of bears it."""
        if self.coupling is None or of_drives == self.drives:
            return torque
        turns = self.coupling if of_drives else _inverse(self.coupling)  # τ_q = Cᵀ τ_θ, and back
        total: dict[int, np.ndarray] = {}
        for i, one in torque.items():
            for k in np.flatnonzero(turns[i]):
                total[int(k)] = total.get(int(k), 0.0) + turns[i, k] * one
        return total


def _inverse(coupling: np.ndarray) -> np.ndarray:
    """Of a coupling (n, n), which is asked for with every torque."""
    return _inverse_of(coupling.tobytes(), len(coupling))


@lru_cache(maxsize=64)
def _inverse_of(coupling: bytes, n: int) -> np.ndarray:
    found = np.linalg.inv(np.frombuffer(coupling).reshape(n, n))
    found.setflags(write=False)
    return found


@dataclass
class _Turned(Motion):
    """A motion seen through a coupling: torques that it is not given are those of ``source`` times ``back`` (n, n)."""

    source: Motion | None = None
    back: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        for name in ("load", "friction"):
            if not getattr(self, name).size:
                delattr(self, name)  # until it is asked for

    @cached_property  # type: ignore[misc]
    def load(self) -> np.ndarray:  # type: ignore[override]
        assert self.source is not None
        return np.asarray(self.source.load @ self.back)

    @cached_property  # type: ignore[misc]
    def friction(self) -> np.ndarray:  # type: ignore[override]
        assert self.source is not None
        return np.asarray(self.source.friction @ self.back)
