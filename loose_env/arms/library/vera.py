"""VERA, the planar two-joint arm of the thesis (section 6.1)."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.arms.arm import Arm, HoldKind
from loose_env.arms.holding.compliance import held
from loose_env.arms.spec_parts import GRAVITY, add_link, holdings, new_spec

__all__ = ["BENDING_MODE_HZ", "LINK_LENGTH", "BendingLink2", "vera", "vera_spec"]

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
LINK2_MASS, BLOCK_MASS, BLOCK_SIDE = 0.85, 0.25, 0.05
"""Beam of link 2 and the block of accelerometers at its end [kg, kg, m]; estimates."""
SEAT_SIDE = 0.06
"""Side of the looseness joint, where it is mounted [m]; an estimate."""


@dataclass(frozen=True, kw_only=True)
class BendingLink2:
    """Link 2 as a bending beam with the looseness joint at its proximal end."""

    mode_hz: float
    """First bending mode, clamped at joint 2 [Hz]."""
    damping: float
    """Its damping ratio."""
    seat_mass: float
    """Mass of the looseness joint [kg]."""


def vera(*, hold: HoldKind = "brake") -> Arm:
    """Build VERA: two links of 0.40 m in the horizontal plane, the first of them bending.

    Lengths, the masses of link 1, the bending mode and the peak torques (5.08 and
    3.39 N·m) are those of chapter 6 of the thesis. Link 2, which the thesis does not weigh,
    is taken as a beam of 0.85 kg with a 0.25 kg block of accelerometers at its end. The gear
    wheel of joint 1 and the rotors behind gears of 6:1 and 4:1 are estimates too.

    The bending mode is a hinge in link 1 at a third of its length: there, deflection and
    slope under a force at the end are those of a clamped beam (deflection F L³ / 3EI,
    slope F L² / 2EI), with 3EI/L³ from eq. 6.6. The thesis does not say how stiff the gears
    are; elastic ones have a mode of 60 Hz each, an estimate (1.6e5 and 1.2e4 N·m/rad).

    Parameters
    ----------
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding.compliance`.

    Examples
    --------
    >>> vera().torque_limits
    (5.08, 3.39)
    """
    spec = vera_spec()
    joints = ("joint1", "joint2")
    brake, servo, centring = holdings(spec, joints)
    arm = Arm(
        name="vera",
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
    )
    return held(arm, hold)


def vera_spec(
    *, link2: BendingLink2 | None = None, mode_damping: float = MODE_DAMPING
) -> mujoco.MjSpec:
    """Bodies, joints and tool of VERA.

    Parameters
    ----------
    link2 : BendingLink2, optional
        How link 2 bends; it is stiff without it.
    mode_damping : float
        Damping ratio of link 1's bending mode.
    """
    spec = new_spec(gravity=(0, 0, -GRAVITY))
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
        damping=[float(2 * mode_damping * hinge_stiffness / (2 * np.pi * BENDING_MODE_HZ)), 0, 0],
    )

    flange2 = add_link(
        tip, 2, at=(arm_out, 0, 0), flange_mass=0.15, rotor_inertia=0.01, joint_damping=0.03
    )
    end = _stiff_link2(flange2) if link2 is None else _bending_link2(flange2, link2)
    end.add_site(name="tool", pos=[length if end is flange2 else length - root, 0, 0])
    return spec


def _stiff_link2(link2: mujoco.MjsBody) -> mujoco.MjsBody:
    length = LINK_LENGTH
    mass = LINK2_MASS + BLOCK_MASS
    centre = (LINK2_MASS * length / 2 + BLOCK_MASS * length) / mass
    about_z = (
        LINK2_MASS * length**2 / 12
        + LINK2_MASS * (length / 2 - centre) ** 2
        + BLOCK_MASS * (length - centre) ** 2
        + BLOCK_MASS * BLOCK_SIDE**2 / 6
    )
    link2.mass = mass
    link2.ipos = [centre, 0, 0]
    link2.inertia = [0.001, about_z, about_z]
    link2.explicitinertial = True
    return link2


def _bending_link2(link2: mujoco.MjsBody, beam: BendingLink2) -> mujoco.MjsBody:
    """Split link 2 at a third of its length, as link 1; return its outer part."""
    root = LINK_LENGTH / 3
    out = LINK_LENGTH - root
    density = LINK2_MASS / LINK_LENGTH
    link2.mass = density * root + beam.seat_mass
    centre = density * root * root / 2 / link2.mass
    about_z = density * root**3 / 12 + density * root * (root / 2 - centre) ** 2
    about_z += beam.seat_mass * (centre**2 + SEAT_SIDE**2 / 6)
    link2.ipos = [centre, 0, 0]
    link2.inertia = [0.001, about_z, about_z]
    link2.explicitinertial = True
    mass = density * out + BLOCK_MASS
    centre = (density * out * out / 2 + BLOCK_MASS * out) / mass
    about_z = density * out**3 / 12 + density * out * (out / 2 - centre) ** 2
    about_z += BLOCK_MASS * ((out - centre) ** 2 + BLOCK_SIDE**2 / 6)
    end = link2.add_body(
        name="link2_end",
        pos=[root, 0, 0],
        mass=mass,
        ipos=[centre, 0, 0],
        inertia=[0.001, about_z, about_z],
        explicitinertial=True,
    )
    omega = 2 * np.pi * beam.mode_hz
    stiffness = (about_z + mass * centre**2) * omega**2
    end.add_joint(
        name="bending2",
        axis=[0, 0, 1],
        stiffness=[float(stiffness), 0, 0],
        damping=[float(2 * beam.damping * stiffness / omega), 0, 0],
    )
    return end
