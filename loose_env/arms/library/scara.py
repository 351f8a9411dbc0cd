"""A SCARA of 600 mm: two joints turn in the plane, one lifts, the wrist turns."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.arms.arm import Arm, Gears, HoldKind
from loose_env.arms.holding.compliance import held
from loose_env.arms.holding.gears import STIFFNESS_PER_TORQUE
from loose_env.arms.spec_parts import GRAVITY, add_link, holdings, new_spec

__all__ = ["INNER", "OUTER", "STROKE", "scara"]

INNER, OUTER = 0.325, 0.275
"""Lengths of the two arms, 0.60 m together [m]."""
STROKE = 0.21
"""Travel of the quill [m]."""

_TOOL = (0.08, 0.0, -0.03)  # accelerometer on a bracket, or it would not see the wrist turn [m]
_BELOW = -0.15  # wrist below the outer arm's plane, quill drawn up [m]
_FLANGES = (0.5, 0.4, 0.1, 0.05)  # [kg]
_ROTORS = (1.5, 0.30, 8.0, 0.02)  # seen at the joints [kg·m², kg for the quill]
_DAMPING = (2.0, 0.6, 60.0, 0.02)  # [N·m·s/rad, N·s/m for the quill]
_TORQUES = (150.0, 60.0, 250.0, 8.0)  # [N·m, N for the quill]
_SCREW_STIFFNESS = 1e6  # of a ball screw turned by a belt [N/m]
# Mass [kg], centre of mass [m] and inertia about it [kg·m²] of each link.
_LINKS = (
    (8.0, (0.15, 0.0, 0.0), (0.030, 0.110, 0.120)),
    (10.0, (0.09, 0.0, 0.10), (0.090, 0.130, 0.100)),
    (1.8, (0.0, 0.0, 0.02), (0.020, 0.020, 0.0002)),
    (0.6, (0.0, 0.0, -0.02), (0.0006, 0.0006, 0.0004)),
)


def scara(*, hold: HoldKind = "brake") -> Arm:
    """Build a SCARA of four axes with gravity along -z.

    Joint 1 turns the inner arm (0.325 m) and joint 2 the outer one (0.275 m), both about the
    vertical [rad]; joint 3 lifts the quill [m], zero drawn up and negative below; joint 4 turns
    the wrist at its end [rad]. Where joint 3 is meant, every figure of `Arm` that is given
    there per radian or in N·m is per metre or in N. Only this joint carries weight: gravity is
    along the other axes.

    Lengths, stroke and ranges are those usual in arms of 600 mm. Masses, inertias, drives,
    damping and torque limits are estimates for that class: arms of 8 and 10 kg (the outer one
    carries the drives of the quill), a quill and wrist of 2.6 kg, a ball screw whose rotor feels
    like 8 kg along the stroke. Links are rigid, so that shaking the plane does not move the
    tool along the vertical, nor the other way round, unless a seat is open. The accelerometer
    sits on a bracket 80 mm off the wrist's axis, without mass; on the axis it would not see
    joint 4. Play in joint 3 (`Backlash`) is that of the screw, along the stroke; a quill that
    turns in its spline is a `RotationalLooseness` of link 3 about the vertical.

    Elastic gears (``hold="compliant"``) are estimates too: strain-wave gears with
    `loose_env.arms.holding.gears.STIFFNESS_PER_TORQUE` times the torque limits (4.5e4, 1.8e4 and
    2.4e3 N·m/rad) and a screw of 1e6 N/m; the arm sways in the plane at about 17 Hz.

    Parameters
    ----------
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding.compliance`.

    Examples
    --------
    >>> arm = scara()
    >>> arm.n, arm.joint_ranges[2]
    (4, (-0.21, 0.0))
    """
    spec = new_spec(gravity=(0, 0, -GRAVITY))
    parent = spec.worldbody
    places = ((0.0, 0.0, 0.0), (INNER, 0.0, 0.0), (OUTER, 0.0, 0.0), (0.0, 0.0, _BELOW))
    for i, place in enumerate(places):
        link = add_link(
            parent,
            i + 1,
            at=place,
            flange_mass=_FLANGES[i],
            rotor_inertia=_ROTORS[i],
            joint_damping=_DAMPING[i],
        )
        mass, centre, inertia = _LINKS[i]
        link.mass, link.ipos, link.inertia = mass, list(centre), list(inertia)
        link.explicitinertial = True
        parent = link
    spec.joint("joint3").type = mujoco.mjtJoint.mjJNT_SLIDE
    parent.add_site(name="tool", pos=list(_TOOL))

    joints = tuple(f"joint{i}" for i in range(1, 5))
    brake, servo, centring = holdings(spec, joints)
    first, second = float(np.radians(105.0)), float(np.radians(150.0))
    arm = Arm(
        name="scara",
        spec=spec,
        joints=joints,
        seat_bodies=tuple(f"link{i}" for i in range(1, 5)),
        tool="tool",
        axes=(0, 1, 2),
        torque_limits=_TORQUES,
        joint_ranges=((-first, first), (-second, second), (-STROKE, 0.0), (-2 * np.pi, 2 * np.pi)),
        levels=(0.5, 2.0, 6.0),
        band=(30.0, 150.0),
        brake=brake,
        servo=servo,
        centring=centring,
        timestep=2e-4,
        gears=Gears(
            stiffness=tuple(
                _SCREW_STIFFNESS if i == 2 else STIFFNESS_PER_TORQUE * t
                for i, t in enumerate(_TORQUES)
            )
        ),
    )
    return held(arm, hold)
