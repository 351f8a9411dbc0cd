"""VERA, the planar two-joint arm of the thesis (section 6.1)."""

from __future__ import annotations

import numpy as np

from loose_env.arms.arm import Arm, HoldKind
from loose_env.arms.parts import add_link, holdings, new_spec

__all__ = ["BENDING_MODE_HZ", "vera"]

LINK_LENGTH = 0.40
"""Length of either link [m] (6.1.2)."""
BEAM_MASS = 1.34
"""Mass of the beam of link 1 [kg] (6.1.2)."""
END_MASS = 3.2
"""Mass at the end of link 1, the drive of joint 2 [kg] (6.1.2)."""
GEAR_MASS, GEAR_RADIUS = 4.0, 0.12
"""Gear wheel of joint 1, a steel disc: mass [kg] and radius [m]; an estimate."""
BENDING_MODE_HZ = 83.0
"""First bending mode of link 1 alone, clamped at joint 1 [Hz] (eq. 6.6)."""
MODE_DAMPING = 0.01
"""Damping ratio of that mode: a bolted aluminium beam."""


def vera(*, hold: HoldKind = "brake") -> Arm:
    """Build VERA: two links of 0.40 m in the horizontal plane, the first of them bending.

    Lengths, the masses of link 1, the bending mode and the peak torques (5.08 and
    3.39 N·m) are those of chapter 6 of the thesis. Link 2, which the thesis does not weigh,
    is taken as a beam of 0.85 kg with a 0.25 kg block of accelerometers at its end. The gear
    wheel of joint 1 and the rotors behind gears of 6:1 and 4:1 are estimates too.

    The bending mode is a hinge in link 1 at a third of its length: there, deflection and
    slope under a force at the end are those of a clamped beam (deflection F L³ / 3EI,
    slope F L² / 2EI), with 3EI/L³ from eq. 6.6.

    Parameters
    ----------
    hold : {"brake", "servo"}
        How joints that are not excited are held.

    Examples
    --------
    >>> vera().torque_limits
    (5.08, 3.39)
    """
    spec = new_spec(gravity=(0, 0, -9.81))
    length = LINK_LENGTH
    root = length / 3
    line_density = BEAM_MASS / length
    root_mass, tip_mass = line_density * root, line_density * (length - root)

    link1 = add_link(
        spec.worldbody, 1, at=(0, 0, 0.3), flange_mass=0.3, rotor_inertia=0.03, joint_damping=0.05
    )
    # Root of the beam and gear wheel on the shaft as one body.
    link1.mass = root_mass + GEAR_MASS
    centre = root_mass * root / 2 / link1.mass
    about_z = (
        root_mass * root**2 / 12
        + root_mass * (root / 2 - centre) ** 2
        + GEAR_MASS * (GEAR_RADIUS**2 / 2 + centre**2)
    )
    link1.ipos = [centre, 0, 0]
    link1.inertia = [GEAR_MASS * GEAR_RADIUS**2 / 4, about_z, about_z]
    link1.explicitinertial = True

    # Beam end and drive of joint 2 as one body, about their common centre of mass.
    arm_out = length - root
    mass = tip_mass + END_MASS
    centre = (tip_mass * arm_out / 2 + END_MASS * arm_out) / mass
    drive_radius = 0.05
    about_z = (
        tip_mass * arm_out**2 / 12
        + tip_mass * (arm_out / 2 - centre) ** 2
        + END_MASS * (arm_out - centre) ** 2
        + END_MASS * drive_radius**2 / 2
    )
    stiffness_at_end = (2 * np.pi * BENDING_MODE_HZ) ** 2 * (END_MASS + 0.23 * BEAM_MASS)
    hinge_stiffness = stiffness_at_end * arm_out**2
    tip = link1.add_body(
        name="link1_end",
        pos=[root, 0, 0],
        mass=mass,
        ipos=[centre, 0, 0],
        inertia=[END_MASS * drive_radius**2 / 2, about_z, about_z],
        explicitinertial=True,
    )
    tip.add_joint(
        name="bending1",
        axis=[0, 0, 1],
        stiffness=[float(hinge_stiffness), 0, 0],
        damping=[float(2 * MODE_DAMPING * hinge_stiffness / (2 * np.pi * BENDING_MODE_HZ)), 0, 0],
    )

    link2 = add_link(
        tip, 2, at=(arm_out, 0, 0), flange_mass=0.15, rotor_inertia=0.01, joint_damping=0.03
    )
    beam, block = 0.85, 0.25
    mass = beam + block
    centre = (beam * length / 2 + block * length) / mass
    about_z = (
        beam * length**2 / 12
        + beam * (length / 2 - centre) ** 2
        + block * (length - centre) ** 2
        + block * 0.05**2 / 6
    )
    link2.mass = mass
    link2.ipos = [centre, 0, 0]
    link2.inertia = [0.001, about_z, about_z]
    link2.explicitinertial = True
    link2.add_site(name="tool", pos=[length, 0, 0])

    joints = ("joint1", "joint2")
    brake, servo, centring = holdings(spec, joints)
    return Arm(
        name="vera-servo" if hold == "servo" else "vera",
        spec=spec,
        joints=joints,
        seat_bodies=("link1", "link2"),
        tool="tool",
        axes=(0, 1),
        torque_limits=(5.08, 3.39),
        joint_ranges=(None, None),
        levels=(0.25, 0.75, 2.25),
        band=(30.0, 150.0),
        brake=brake,
        servo=servo,
        centring=centring,
        timestep=1e-4,
        settling=0.2,  # the bending mode dies away in 0.2 s
        hold=hold,
    )
