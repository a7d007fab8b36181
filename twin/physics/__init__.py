"""What a model can leave out: one file per effect, and the plain list of them."""

from twin.physics.asymmetric_friction import AsymmetricFriction
from twin.physics.attached_resonator import AttachedResonator
from twin.physics.backlash import Backlash
from twin.physics.base_compliance import BaseCompliance
from twin.physics.cable_stiffness import CableStiffness
from twin.physics.coulomb_friction import CoulombFriction
from twin.physics.discovered import Discovered
from twin.physics.effect import Effect
from twin.physics.friction_drift import FrictionDrift
from twin.physics.gravity_compensator import GravityCompensator
from twin.physics.hammer_misalignment import HammerMisalignment
from twin.physics.hardening_stiffness import HardeningStiffness
from twin.physics.hysteresis import Hysteresis
from twin.physics.joint_coupling import JointCoupling
from twin.physics.link_flexibility import LinkFlexibility
from twin.physics.load_dependent_friction import LoadDependentFriction
from twin.physics.payload import Payload
from twin.physics.presliding import Presliding
from twin.physics.rotor_inertia import RotorInertia
from twin.physics.sensor_gain import SensorGain
from twin.physics.sensor_misalignment import SensorMisalignment
from twin.physics.servo_compliance import ServoCompliance
from twin.physics.stribeck_friction import StribeckFriction
from twin.physics.structural_damping import StructuralDamping
from twin.physics.time_delay import TimeDelay
from twin.physics.torque_constant import TorqueConstant
from twin.physics.torque_ripple import TorqueRipple
from twin.physics.transverse_compliance import TransverseCompliance
from twin.physics.viscous_friction import ViscousFriction

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        TransverseCompliance(),
        BaseCompliance(),
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
        SensorGain(),
        SensorMisalignment(),
        HammerMisalignment(),
        TimeDelay(),
        TorqueConstant(),
        Discovered(),
    )
}
"""Identifier → effect, in the order of the vocabulary; last what stands outside it."""
