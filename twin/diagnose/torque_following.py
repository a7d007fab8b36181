"""What a motion log says of all else where another recording has settled links, lengths of axes and payloads."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from twin.diagnose.joint import places_axis
from twin.diagnose.refit import Fitted
from twin.diagnose.torque_play import Play, with_play
from twin.diagnose.torque_suspects import with_values
from twin.diagnose.torque_system import System, own_prior
from twin.measure.campaign import FloatArray
from twin.model.parameters import axis_parameters, entry_parameter
from twin.model.regressor import inertial_vector
from twin.model.torque_numbers import follow
from twin.model.torque_robot import with_presliding
from twin.physics import CATALOGUE
from twin.robot.description import Robot


@dataclass(frozen=True)
class Following:
    """A log's fit, given links, axes and payloads.

    A log hardly tells the weight of a payload from the torque of a compensator, or a link's mass from the gain of its
    record. Where another recording moves one of them, what the log knows of both together must not be lost. Everything
    is normal about the fit, so the rest moves to its mean, given those.

    Attributes:
        system, fit: of the log.
        gaps: what its encoders show of play.
    """

    system: System
    fit: Fitted
    gaps: Sequence[Play] = ()

    def values(self, robot: Robot) -> dict[str, float]:
        """The numbers of the fit by name, in their units, beside what a description has settled."""
        return dict(zip(self.fit.parameters.names, self._values(self._given(robot)).tolist(), strict=True))

    def __call__(self, robot: Robot) -> Robot:
        """A description that has settled links, axes and payloads, with the rest where the log then has it."""
        system, fit = self.system, self.fit
        z = self._given(robot)
        log = system.robot(z, with_values(fit.hypothesis, self._values(z)[fit.own]))
        log = with_presliding(system, z, system.entries(z), reduce(with_play, self.gaps, log))
        physics = [entry for entry in robot.physics if _shown_by_blows(entry.effect)]
        physics += [entry for entry in log.physics if not _shown_by_blows(entry.effect)]
        return follow(robot, log).model_copy(update={"drives": log.drives, "physics": physics})

    def _values(self, z: FloatArray) -> FloatArray:
        parameters = self.fit.parameters
        return np.array([p.value(x) for p, x in zip(parameters, parameters.root @ z, strict=True)])

    def _given(self, robot: Robot) -> FloatArray:
        """Coordinates z of the fit's mean, given what a description has settled."""
        system, fit = self.system, self.fit
        links = system.base.links
        vectors = np.concatenate([inertial_vector(*link.inertial) for link in robot.links])
        spread = system.base.spread[: len(vectors), :links] * system.plain(np.ones(len(fit.z)))[:links]
        there = system.base.values(system.plain(fit.z))[: len(vectors)]
        at, moved = list(range(links)), np.linalg.lstsq(spread, vectors - there, rcond=None)[0].tolist()
        axes = {p.name: p.mean for p in axis_parameters(robot) if places_axis(p)}
        for k, p in enumerate(fit.parameters):
            if p.name in axes:
                at.append(k)
                moved.append((axes[p.name] - p.mean) / fit.parameters.root[k, k] - fit.z[k])
        keys = [f"{entry.effect}@{entry.site}" for entry in robot.physics]
        present = {key for key in keys if keys.count(key) == 1}  # of two at one place, which one moved is not told
        for suspect in system.found:
            hypothesis, own = suspect.hypothesis, system.own(suspect)
            if _shown_by_blows(hypothesis.effect) and hypothesis.key in present:
                values = np.array([entry_parameter(robot, parameter.name).mean for parameter in hypothesis.own])
                at += own
                moved += (own_prior(hypothesis.own, values) - fit.z[own]).tolist()
        covariance = np.linalg.inv(fit.information)[:, at]
        return np.asarray(fit.z + covariance @ np.linalg.solve(covariance[at], moved))


def _shown_by_blows(effect: str) -> bool:
    """Whether a hammer test shows an effect."""
    return effect in CATALOGUE and "hammer" in CATALOGUE[effect].seen_in
