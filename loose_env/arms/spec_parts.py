"""Parts from which the planar arms are built."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Holding

__all__ = [
    "CREST_FACTOR",
    "FASTEST_TURN",
    "GRAVITY",
    "HOLDING_MODE_HZ",
    "MOTOR_SIDE",
    "SERVO_DAMPING",
    "SERVO_MODE_HZ",
    "add_link",
    "held_inertia",
    "holdings",
    "new_spec",
]

HOLDING_MODE_HZ = 800.0
"""Holding mode of a default brake: several times the top of the default band."""
SERVO_MODE_HZ = 25.0
"""Holding mode of a default position servo: what industrial drives reach on a large arm."""
SERVO_DAMPING = 0.5
"""Damping ratio of that mode."""
CENTRING_MODE_HZ = 4.0
"""Mode of an excited joint on its centring spring: below the band."""
GRAVITY = 9.81
"""Gravity of the arms in the library, and 1 g of a preload [m/s²]."""
CREST_FACTOR = 3.0
"""Peak over rms that a drive has to deliver [1]; rarer peaks are clipped at its limit."""
FASTEST_TURN = 1.4
"""Largest angle by which a spring's or a stop's mode may turn in one simulation step [rad]:
stepping is stable below 2."""
MOTOR_SIDE = 0.05
"""Share of a link's mass and inertia that is the flange on the motor side [1]; an estimate."""


def new_spec(*, gravity: Sequence[float]) -> mujoco.MjSpec:
    """Return an empty spec in radians, without contacts, under the given gravity [m/s²]."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    spec.option.gravity = list(gravity)
    return spec


def add_link(
    parent: mujoco.MjsBody,
    number: int,
    *,
    at: Sequence[float],
    flange_mass: float,
    rotor_inertia: float,
    joint_damping: float,
) -> mujoco.MjsBody:
    """Add link ``number``: a flange that carries the joint, and on it the still massless link.

    The flange is the link's share on the motor side of a loose seat; the seat lies between
    flange and link. ``at`` is the joint's place in the parent's frame [m].
    """
    flange = parent.add_body(
        name=f"flange{number}",
        pos=list(at),
        mass=flange_mass,
        ipos=[0, 0, 0],
        # A disc of 40 mm radius about the joint axis.
        inertia=[flange_mass * 0.0004, flange_mass * 0.0004, flange_mass * 0.0008],
        explicitinertial=True,
    )
    flange.add_joint(
        name=f"joint{number}",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        armature=rotor_inertia,
        damping=[joint_damping, 0, 0],
    )
    return flange.add_body(name=f"link{number}")


def held_inertia(
    spec: mujoco.MjSpec, joints: Sequence[str], poses: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Inertia that each joint holds, rotor included [kg·m², or kg where it slides] (n,).

    It is that of everything distal to the joint with all joints at zero or, with ``poses``
    (m, n) given, the largest over these [rad or m].
    """
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    full = np.zeros((model.nv, model.nv))
    inertia = np.zeros(len(joints))
    dofs = [int(model.joint(j).dofadr[0]) for j in joints]
    for pose in [None] if poses is None else poses:
        if pose is not None:
            data.qpos[[int(model.joint(j).qposadr[0]) for j in joints]] = pose
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = np.maximum(inertia, full[dofs, dofs])
    return inertia


def holdings(
    spec: mujoco.MjSpec,
    joints: Sequence[str],
    *,
    damping_ratio: float = 0.1,
    poses: NDArray[np.float64] | None = None,
) -> tuple[Holding, Holding, Holding]:
    """Brake, servo and centring spring for every joint, from the modes they should have.

    The inertia a joint holds is that of everything distal to it with all joints at zero or,
    with ``poses`` given, the largest over these. Where a joint slides, it is a mass, and spring
    and damper are per metre.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The arm.
    joints : sequence of str
        Its joints, base first.
    damping_ratio : float
        Of the brakes.
    poses : ndarray (m, n), optional
        Joint positions at which the inertia is looked at [rad or m].
    """
    inertia = held_inertia(spec, joints, poses)

    def holding(mode_hz: float, ratio: float) -> Holding:
        omega = 2 * np.pi * mode_hz
        return Holding(
            stiffness=tuple(float(f"{k:.3g}") for k in inertia * omega**2),
            damping=tuple(float(f"{c:.3g}") for c in 2 * ratio * inertia * omega),
        )

    return (
        holding(HOLDING_MODE_HZ, damping_ratio),
        holding(SERVO_MODE_HZ, SERVO_DAMPING),
        holding(CENTRING_MODE_HZ, 0.7),
    )
