"""What a model can leave out: one file per effect, the plain list of them, and how a user adds an effect of his own.

    from twin.physics import register
    register(MyEffect())                      # in a script or notebook

or, for an installed package, so that the ``twin`` command has it too, in its pyproject.toml:

    [project.entry-points."twin.effects"]
    my_effect = "my_package.my_effect:MyEffect"
"""

import re
from importlib.metadata import entry_points

from twin.physics.asymmetric_friction import AsymmetricFriction
from twin.physics.attached_resonator import AttachedResonator
from twin.physics.backlash import Backlash
from twin.physics.base_compliance import BaseCompliance
from twin.physics.cable_stiffness import CableStiffness
from twin.physics.coulomb_friction import CoulombFriction
from twin.physics.cross_stiffness import CrossStiffness
from twin.physics.discovered import Discovered
from twin.physics.effect import Effect
from twin.physics.floor_mode import FloorMode
from twin.physics.friction_drift import FrictionDrift
from twin.physics.gravity_compensator import GravityCompensator
from twin.physics.gravity_direction import GravityDirection
from twin.physics.hammer_misalignment import HammerMisalignment
from twin.physics.hardening_stiffness import HardeningStiffness
from twin.physics.hysteresis import Hysteresis
from twin.physics.joint_coupling import JointCoupling
from twin.physics.joint_law import Law
from twin.physics.joint_offset import JointOffset
from twin.physics.link_flexibility import LinkFlexibility
from twin.physics.load_dependent_friction import LoadDependentFriction
from twin.physics.payload import Payload
from twin.physics.presliding import Presliding
from twin.physics.rotor_inertia import RotorInertia
from twin.physics.sensor_gain import SensorGain
from twin.physics.sensor_mass import SensorMass
from twin.physics.sensor_misalignment import SensorMisalignment
from twin.physics.servo_compliance import ServoCompliance
from twin.physics.statements import Part
from twin.physics.stribeck_friction import StribeckFriction
from twin.physics.structural_damping import StructuralDamping
from twin.physics.time_delay import TimeDelay
from twin.physics.torque_constant import TorqueConstant
from twin.physics.torque_filter import TorqueFilter
from twin.physics.torque_ripple import TorqueRipple
from twin.physics.transverse_compliance import TransverseCompliance
from twin.physics.viscous_friction import ViscousFriction

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        TransverseCompliance(),
        CrossStiffness(),
        BaseCompliance(),
        FloorMode(),
        LinkFlexibility(),
        ServoCompliance(),
        Payload(),
        AttachedResonator(),
        StructuralDamping(),
        HardeningStiffness(),
        Backlash(),
        Hysteresis(),
        ViscousFriction(),
        CoulombFriction(),
        Presliding(),
        AsymmetricFriction(),
        StribeckFriction(),
        LoadDependentFriction(),
        FrictionDrift(),
        GravityCompensator(),
        CableStiffness(),
        TorqueRipple(),
        JointCoupling(),
        RotorInertia(),
        JointOffset(),
        GravityDirection(),
        SensorGain(),
        SensorMisalignment(),
        SensorMass(),
        HammerMisalignment(),
        TimeDelay(),
        TorqueConstant(),
        TorqueFilter(),
        Discovered(),
    )
}
"""Identifier → effect, in the order of the vocabulary; last what stands outside it."""


def amplitude_laws() -> tuple[Law, ...]:
    """The laws of amplitude of the vocabulary: of effects that answer differently to different force levels."""
    return tuple(effect.amplitude_law for effect in CATALOGUE.values() if effect.amplitude_law is not None)


BESIDE = ("parameter",)
"""Words that stand where an effect's name does."""


def register(effect: Effect) -> Effect:
    """Add an effect to the catalogue: it is suspected, fitted, named, written and simulated like the others.

    Args:
        effect: an instance of a subclass of :class:`Effect`. One of the same class takes the place of the earlier one.

    Returns:
        The effect.

    Raises:
        ValueError: it does not state what a kind of recording in its ``seen_in`` needs, or its name is taken.
    """
    known = CATALOGUE.get(effect.name)
    if known is not None and type(known).__qualname__ != type(effect).__qualname__:
        raise ValueError(f"effect {effect.name!r}: the name is taken by {type(known).__qualname__}; choose another")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", effect.name) or effect.name in BESIDE:
        raise ValueError(f"effect {effect.name!r}: expected a name of small letters, digits and _ as its identifier")
    if problem := effect.unstated():
        raise ValueError(f"effect {effect.name!r}: {problem}")
    CATALOGUE[effect.name] = effect
    return effect


def _installed() -> None:
    """Register what installed packages offer under the entry-point group ``twin.effects``."""
    for point in entry_points(group="twin.effects"):
        register(point.load()())


class _Nothing(Effect):
    """What is no effect states nothing."""

    name = ""
    sites = ()
    parameters = ()
    seen_in = frozenset()


NOTHING = _Nothing()


def effect_named(name: str) -> Effect:
    """The effect with a name; for what is no effect (a number of the description) one that states nothing."""
    return CATALOGUE.get(name, NOTHING)


def effect_of(part: Part) -> Effect:
    """The effect that is a part of a drive's model, where an entry of that kind has to be written."""
    return next(effect for effect in CATALOGUE.values() if effect.part == part)


_installed()
