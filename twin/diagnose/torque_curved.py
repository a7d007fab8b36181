"""Friction that is no straight line in speed at most joints of a robot: it belongs to the base model, and is no answer.

Lubricated gears need less torque at high speed than viscous friction would have, cycloidal or harmonic ones often more
(Bittencourt, Gunnarsson, J. Dyn. Sys. Meas. Control 134, 2012). A description has dry and viscous friction. What bends
alike at most joints is how its drives are; what bends at one joint alone is a suspect as any other.
"""

from collections.abc import Sequence

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.departures import STRAINED
from twin.diagnose.torque_fit import base_fit, evaluate, settle, start
from twin.diagnose.torque_judge import Judge
from twin.diagnose.torque_suspects import Suspect
from twin.diagnose.torque_system import System, extended, relinearised, unshrunk
from twin.measure.campaign import FloatArray
from twin.physics.effect import axis_of


def with_curved_friction(
    system: System, whole: System, suspects: Sequence[Suspect], judge: Judge | None
) -> System | None:
    """The model with friction that bends with speed at most joints, alike; ``None`` where it does not.

    Args:
        system: base model; ``whole`` with the friction that all joints lack.
        suspects: the law without a name that each joint may have is what bends.
        judge: runs not used, which such a model must predict better.
    """
    turning = system.base.regressor.robot.coupling != 0  # a drive that turns with several axes bends with all of them
    alone = np.flatnonzero((turning.sum(axis=0) == 1) & (turning.sum(axis=1) == 1))
    laws = [s for s in suspects if s.effect.part == "law" and axis_of(s.hypothesis.site) in alone]
    if len(laws) < 2:
        return None
    here = whole
    for law in laws:
        here = extended(here, unshrunk(settle(whole, start(whole, law))))
    here = relinearised(here)
    before, after = base_fit(whole), base_fit(here)
    off = bends(here, laws)
    strongest = int(np.argmax(np.abs(off)))
    alike = off * np.sign(off[strongest]) > STRAINED
    gained = after.evidence() - before.evidence()
    if np.delete(alike, strongest).mean() <= 0.5 or gained < calibration()["further"] * len(laws):
        return None
    if judge is not None and judge.density(here, after) <= judge.density(whole, before):
        return None
    added = here.found[len(whole.found) :]
    return with_entries(system, here, [law for law, bent in zip(added, alike, strict=True) if bent])


def with_entries(system: System, other: System, found: Sequence[Suspect]) -> System:
    """A system with what was found in another one, fitted again from where it is there."""
    for suspect in found:
        system = extended(system, evaluate(system, suspect, other.z[other.own(suspect)]))
    return relinearised(system)


def bends(system: System, laws: Sequence[Suspect]) -> FloatArray:
    """Deviations (n,) that each law's size is off zero; a joint that is missed by more than noise tells less."""
    found = []
    for law in laws:
        (own,) = system.own(law)
        joint = axis_of(law.hypothesis.site)
        rest = system.residual[system.rows(joint)]
        misfit = max(1.0, float(rest @ rest) / (system.count * float(system.level[joint])))
        found.append(float(system.z[own]) / np.sqrt(system.inverse[own, own] * misfit))
    return np.array(found)
