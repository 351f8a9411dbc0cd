"""A six-axis arm with the published parameters of the PUMA 560."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.arms.arm import Arm, Gears, HoldKind
from loose_env.arms.holding.compliance import held
from loose_env.arms.holding.gears import STIFFNESS_PER_TORQUE
from loose_env.arms.spec_parts import GRAVITY, MOTOR_SIDE, holdings, new_spec

__all__ = ["TOOL", "six_axis"]

TOOL = (0.10, 0.0, 0.05625)
"""Accelerometer in the frame of link 6 [m]: on a bracket beside the mounting flange, which
lies 56.25 mm before the wrist's centre. On the axis itself it would not see joint 6. The
bracket, 0.10 m, is an estimate and has no mass."""

# Modified Denavit-Hartenberg parameters: alpha and a of the link before [rad, m], d [m].
_DH = (
    (0.0, 0.0, 0.0),
    (-np.pi / 2, 0.0, 0.2435),
    (0.0, 0.4318, -0.0934),
    (np.pi / 2, -0.0203, 0.4331),
    (-np.pi / 2, 0.0, 0.0),
    (np.pi / 2, 0.0, 0.0),
)
# Mass [kg], centre of mass [m] and inertia about it [kg·m²] of each link, in its own frame.
_LINKS = (
    (13.0, (0.0, 0.0, 0.0), (0.35, 0.35, 0.35)),
    (17.40, (0.068, 0.006, -0.016), (0.130, 0.524, 0.539)),
    (4.80, (0.0, -0.070, 0.014), (0.0686, 0.0151, 0.0834)),
    (0.82, (0.0, 0.0, -0.019), (0.0018, 0.0018, 0.0013)),
    (0.34, (0.0, 0.0, 0.0), (0.0003, 0.0003, 0.0004)),
    (0.09, (0.0, 0.0, 0.032), (0.00015, 0.00015, 0.00004)),
)
_ROTORS = (1.14, 4.71, 0.827, 0.200, 0.179, 0.193)
_GEARS = (62.6, 107.8, 53.7, 76.0, 71.9, 76.7)
_MOTOR_DAMPING = (1.48e-3, 0.817e-3, 1.38e-3, 71.2e-6, 82.6e-6, 36.7e-6)
_TORQUES = (97.6, 186.4, 89.4, 24.2, 20.1, 21.3)
_RANGES = ((-160, 160), (-225, 45), (-45, 225), (-110, 170), (-100, 100), (-266, 266))


def six_axis(*, hold: HoldKind = "brake") -> Arm:
    """Build an arm of six turning joints after the PUMA 560, gravity along -z.

    Masses, centres of mass, inertias and the drives' inertias seen at the joints (1.14 kg·m²
    at joint 1 to 0.193 at joint 6) are those measured by Armstrong, Khatib and Burdick [1]_,
    in their modified Denavit-Hartenberg frames: with all joints at zero the upper arm lies
    along x and the forearm points up; ``(0, -pi/2, pi/2, 0, 0, 0)`` is the ready pose, both
    up. The world's origin is in the shoulder, where the axes of joints 1 and 2 cross.

    Three things are not as printed. Link 1 was only measured about its axis (0.35 kg·m²): its
    mass of 13 kg, which nothing but its own seat feels, and its other two inertias are
    estimates. The moments of link 3 (0.066, 0.0125, 0.086 kg·m²; copies with 0.066 for the last
    do not give the paper's own constant I6) cannot be those of a rigid body, as the largest
    exceeds the sum of the others; each is moved by 0.0026, just enough to mend it. And each link
    is split into a flange (`MOTOR_SIDE`) and the rest, both about the link's centre of mass,
    so that their sum is the printed link.

    The constants of the explicit model that the same paper prints follow from its links to
    within their rounding, with two exceptions: those of joint 1's own inertia, 1.43 and 1.38 kg·m²,
    where the links give 1.56 and 1.60. The links are kept. The inertia about joint 1 is then
    0.13 (arm up) to 0.35 kg·m² (upper arm level) above the explicit model's 2.6 to 3.9, about
    what the paper states as the uncertainty of the drive's share, 0.27, and of the two constants.

    Friction: joints have the viscous friction measured at the motors [2]_, times the gear
    ratio squared (5.8, 9.5, 4.0, 0.41, 0.43, 0.22 N·m·s/rad). The Coulomb friction of the real
    joints, about 25, 8 to 14, 6 to 7, 1, 0.8 and 0.5 N·m, is left out, because the linear
    prediction has none: the arm answers as if its joints were sliding already. At the lowest
    level the torques are mostly no larger than that friction, so a real arm would need more.
    Torque limits are the motors' times their gears; with the tool close to the axis of a joint
    they allow less than the top level. The coupling of the wrist's gears and bending of links
    are left out as well. Gears are stiff unless ``hold="compliant"``: then they have
    `loose_env.arms.holding.gears.STIFFNESS_PER_TORQUE` times the torque limits, 5.6e4 N·m/rad
    at joint 2 and 6e3 in the wrist, which is derived and not measured; the arm sways at about
    15 Hz about joint 1 and 25 Hz about joint 2.

    Parameters
    ----------
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding.compliance`.

    References
    ----------
    .. [1] B. Armstrong, O. Khatib, J. Burdick, "The explicit dynamic model and inertial
       parameters of the PUMA 560 arm", IEEE Int. Conf. Robotics and Automation, 1986.
    .. [2] P. Corke, B. Armstrong-Hélouvry, "A search for consensus among model parameters
       reported for the PUMA 560 robot", IEEE Int. Conf. Robotics and Automation, 1994.

    Examples
    --------
    >>> arm = six_axis()
    >>> arm.n, arm.torque_limits[1]
    (6, 186.4)
    """
    spec = new_spec(gravity=(0, 0, -GRAVITY))
    parent = spec.worldbody
    for i, (alpha, a, d) in enumerate(_DH):
        flange = parent.add_body(
            name=f"flange{i + 1}",
            pos=[a, -float(np.sin(alpha)) * d, float(np.cos(alpha)) * d],
            quat=[float(np.cos(alpha / 2)), float(np.sin(alpha / 2)), 0, 0],
        )
        flange.add_joint(
            name=f"joint{i + 1}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            armature=_ROTORS[i],
            damping=[_MOTOR_DAMPING[i] * _GEARS[i] ** 2, 0, 0],
        )
        link = flange.add_body(name=f"link{i + 1}")
        mass, centre, inertia = _LINKS[i]
        for body, share in ((flange, MOTOR_SIDE), (link, 1 - MOTOR_SIDE)):
            body.mass, body.ipos = share * mass, list(centre)
            body.inertia = [share * moment for moment in inertia]
            body.explicitinertial = True
        parent = link
    parent.add_site(name="tool", pos=list(TOOL))

    joints = tuple(f"joint{i}" for i in range(1, 7))
    brake, servo, centring = holdings(spec, joints)
    arm = Arm(
        name="six_axis",
        spec=spec,
        joints=joints,
        seat_bodies=tuple(f"link{i}" for i in range(1, 7)),
        tool="tool",
        axes=(0, 1, 2),
        torque_limits=_TORQUES,
        joint_ranges=tuple((float(np.radians(a)), float(np.radians(b))) for a, b in _RANGES),
        levels=(1.0, 2.0, 4.0),
        band=(30.0, 150.0),
        brake=brake,
        servo=servo,
        centring=centring,
        timestep=2e-4,
        gears=Gears(stiffness=tuple(STIFFNESS_PER_TORQUE * t for t in _TORQUES)),
    )
    return held(arm, hold)
