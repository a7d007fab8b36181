"""Measured FRFs as a fit uses them: one posture and force level, its Laplace points, its noise."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from twin.errors import InputError
from twin.measure.campaign import (
    QUANTITIES,
    Campaign,
    ComplexArray,
    FloatArray,
    PostureFRF,
    dead_channels,
    frf_variance,
    laplace,
)
from twin.measure.frf_noise import pooled_variance, shared_lines
from twin.model.parameters import Parameters
from twin.model.sensitivity import Observed, Setup, Structure, frf, frf_slopes
from twin.ranges import FARTHEST_M
from twin.robot.description import Robot

UNKNOWN_NOISE = 0.02  # of a channel's RMS: variance where the recording states none; the fit then scales it
LIMIT_SLACK = 0.02  # rad (m): an encoder's zero is not that of the limits


@dataclass(frozen=True)
class Recorded:
    """FRFs of one posture and force level as the fit uses them.

    Attributes:
        group: name of the recording's group; ``setup.name`` is the posture's, without the force level.
        s: (nf,) Laplace points; ``power`` of s in the quantity over receptance.
        frf: (nf, nr, ne), SI per newton.
        variance: (nf, nr, ne) of real and imaginary part; infinite where a line is not used.
        stated: the variance is the recording's; where it states none, a share of the channel's RMS.
        exact: models predict it but for noise, if they are right.
    """

    exact: ClassVar[bool] = True
    group: str
    setup: Setup
    frequency: FloatArray
    s: ComplexArray
    power: int
    frf: ComplexArray
    variance: FloatArray
    stated: bool

    def respond(self, seen: Observed, model: Structure) -> ComplexArray:
        """FRFs (nf, nr, ne) of a model where and as they were recorded."""
        return frf(seen, self.s, self.power)

    def respond_slopes(self, seen: Observed, model: Structure, rate: Observed) -> tuple[ComplexArray, ComplexArray]:
        """The same and its derivatives (n, nf, nr, ne)."""
        return frf_slopes(seen, rate, self.s, self.power)

    def probed(self, count: int) -> "Recorded":
        """What receptance is asked for with ``count`` more excitations."""
        return replace(self, power=0)

    def every(self, step: int) -> "Recorded":
        """Every ``step``-th line."""
        keep = slice(step // 2, None, step)
        return replace(
            self, frequency=self.frequency[keep], s=self.s[keep], frf=self.frf[keep], variance=self.variance[keep]
        )


def fields_of(r: Recorded) -> dict[str, Any]:
    """What every recording has, by name: for one of another kind made of it."""
    return {one.name: getattr(r, one.name) for one in fields(Recorded)}


def base_name(campaign: Campaign, group: str) -> str:
    """Name of a posture without its force level: the first group with the same angles, up to ``@``."""
    q = campaign.postures[group].q_deg
    first = next(name for name, posture in campaign.postures.items() if np.array_equal(posture.q_deg, q))
    return first.partition("@")[0]


def prepare(
    campaign: Campaign, robot: Robot, source: str = "recording", band_hz: tuple[float, float] | None = None
) -> dict[str, Recorded]:
    """The groups of a campaign as the fit uses them.

    Raises:
        InputError: channels on bodies the robot does not have, or postures it cannot take.
    """
    _check_bodies(campaign, robot, source)
    found = {}
    for name, posture in campaign.postures.items():
        q = recorded_posture(robot, posture.q_deg, source, f"postures/{name}: q_deg")
        setup = Setup(base_name(campaign, name), q, posture.brakes, campaign.response, campaign.excitation)
        low, high = band_hz or (0.0, np.inf)
        lines = (posture.frequency > 0) & (posture.frequency >= low) & (posture.frequency <= high)
        if np.count_nonzero(lines) < 2:
            raise InputError(source, f"postures/{name}/frequency", f"no lines from {low:g} to {high:g} Hz")
        variance, stated = measured_variance(posture)
        found[name] = Recorded(
            name, setup, posture.frequency[lines],
            laplace(posture.frequency[lines], posture.exponential_window_rate),
            QUANTITIES.index(posture.quantity), posture.frf[lines], variance[lines], stated,
        )  # fmt: skip
    return found


def believed(
    campaign: Campaign, robot: Robot, source: str, band_hz: tuple[float, float] | None = None
) -> tuple[dict[str, Recorded], float]:
    """Recordings by group with their variance pooled over lines, in which a channel that has no coherence counts for
    nothing; and how many lines share their noise.

    Raises:
        InputError: the recording does not fit the robot.
    """
    recordings, shared = {}, shared_lines(list(campaign.postures.values()))
    for name, recorded in prepare(campaign, robot, source, band_hz).items():
        variance = pooled_variance(campaign.postures[name], shared)
        lines = np.isin(campaign.postures[name].frequency, recorded.frequency)
        recordings[name] = replace(recorded, variance=variance[lines])
    return recordings, shared


def recorded_posture(robot: Robot, q_deg: FloatArray, source: str, field: str) -> FloatArray:
    """Joint positions (n,), rad (m), of a recording; no more than ``LIMIT_SLACK`` beyond the axes' limits.

    Raises:
        InputError: positions this robot cannot take, as when their sign or unit is another.
    """
    if not q_deg.size:
        raise InputError(source, field, "expected the axis positions of the robot, the recording does not say them")
    if q_deg.size != robot.axis_count:
        raise InputError(
            source, field, f"expected {robot.axis_count} values for robot {robot.name}, found {q_deg.size}"
        )
    q = np.asarray(robot.angles(q_deg))
    near = within_limits(robot, q)
    try:
        robot.check_posture(np.where(np.abs(q - near) <= LIMIT_SLACK, near, q), source, field)
    except InputError as error:
        raise InputError(
            source, error.field, f"{error.expected}: a wrong posture, another sign, unit or robot?"
        ) from None
    return q


def measured_variance(posture: PostureFRF) -> tuple[FloatArray, bool]:
    """Variance (nf, nr, ne) of real and imaginary part, and whether the recording states it.

    From coherence and averages; without them, a share of the channel's RMS.
    """
    variance = frf_variance(posture)
    if variance is not None:
        return variance, True
    power = np.mean(np.abs(posture.frf) ** 2, axis=0)
    variance = np.broadcast_to(UNKNOWN_NOISE**2 * power, posture.frf.shape).copy()
    variance[:, dead_channels(posture)] = np.inf
    return variance, False


def placed(recordings: Sequence[Recorded], parameters: Parameters, values: FloatArray) -> tuple[Recorded, ...]:
    """Recordings with the nodes of their channels where parameters have them."""
    return tuple(replace(r, setup=r.setup.placed(parameters, values)) for r in recordings)


def noise_stated(recordings: Sequence[Recorded]) -> bool:
    """Every recording states its variance."""
    return all(r.stated for r in recordings)


def _check_bodies(campaign: Campaign, robot: Robot, source: str) -> None:
    bodies = {"base", *(f"link{i + 1}" for i in range(robot.axis_count))}
    for side, channels in (("response", campaign.response), ("excitation", campaign.excitation)):
        for label, body in zip(channels.label, channels.body, strict=True):
            if body not in bodies:
                raise InputError(
                    source,
                    f"{side}/body",
                    f"{label} is on {body!r}; {robot.name} has base, link1 … {sorted(bodies)[-1]}",
                )
        far = np.abs(channels.position).max(axis=1)
        if far.max() > FARTHEST_M:
            label = channels.label[int(far.argmax())]
            text = f"{label} is {far.max():.4g} m from its body's frame; expected metres, up to {FARTHEST_M:g}"
            raise InputError(source, f"{side}/position", text)


def within_limits(robot: Robot, q: FloatArray) -> FloatArray:
    """Joint positions (n,) moved to the nearest within the axes' limits."""
    limits = [axis.limits.position if axis.limits else None for axis in robot.axes]
    return np.array(
        [value if limit is None else np.clip(value, *limit) for value, limit in zip(q, limits, strict=True)]
    )


def without_limits(robot: Robot) -> Robot:
    """A copy whose angles may leave their limits: the error of a posture at a limit is free to either side."""
    return robot.model_copy(update={"axes": [axis.model_copy(update={"limits": None}) for axis in robot.axes]})
