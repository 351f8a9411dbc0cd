"""A shaker beside the arm: a voice coil that pushes a link through a stinger."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidSetting
from loose_env.io import Checked, NonNegative, Positive

__all__ = ["COIL", "DRIVE", "Shaker", "add_shaker", "place_shaker"]

COIL = "shaker_coil"
"""Body of the coil; a site of the same name carries its accelerometer."""
DRIVE = "drive_shaker"
"""Actuator that forces the coil."""
_STAND = "shaker_stand"


@dataclass(frozen=True, kw_only=True)
class Shaker(Checked):
    """An external source of excitation, as in Experiments Two to Six.

    The coil slides along a line fixed to its stand and pushes one point of the arm through
    a stinger, a rod that is stiff along itself and turns freely at its end. Wherever the arm
    is taken, the stand is set up again so that the stinger meets its point along `direction`.
    """

    joint: int
    """Joint the shaker moves, from 1 at the base; it is released while the shaker runs."""
    body: str
    """Body of the arm that the stinger pushes."""
    point: tuple[float, float, float]
    """Point of attack in that body's frame [m]."""
    direction: tuple[float, float, float]
    """Direction of its push, in that body's frame."""
    coil_mass: Positive
    """Mass of the coil and the table on it [kg]."""
    stinger_stiffness: Positive
    """Stiffness of the stinger along itself [N/m] (6.12)."""
    stinger_damping: NonNegative
    """Damping of the stinger [N·s/m]."""
    stinger_length: Positive
    """Length of the stinger [m]."""
    suspension_stiffness: NonNegative
    """Spring that centres the coil [N/m]; it takes the lowest frequencies away."""
    suspension_damping: NonNegative
    """Damping of the coil's suspension and back EMF [N·s/m]."""
    stand: str = "world"
    """Body the stand is fixed to; it takes the reaction."""
    force_limit: Positive = 500.0
    """Largest force of the coil [N]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.linalg.norm(self.direction) > 0:
            raise InvalidSetting("a shaker's direction must not be zero")


def add_shaker(spec: mujoco.MjSpec, shaker: Shaker) -> None:
    """Add stand, coil, stinger and drive to a spec; `place_shaker` puts them in their place.

    Raises
    ------
    InvalidSetting
        If the spec lacks a body that the shaker names.
    """
    pushed = spec.body(shaker.body)
    stand_on = spec.worldbody if shaker.stand == "world" else spec.body(shaker.stand)
    for name, body in ((shaker.body, pushed), (shaker.stand, stand_on)):
        if body is None:
            known = ", ".join(b.name for b in spec.bodies)
            raise InvalidSetting(f"the shaker needs a body {name!r}; the arm has {known}")
    stand = stand_on.add_body(name=_STAND)
    coil = stand.add_body(
        name=COIL,
        mass=shaker.coil_mass,
        ipos=[0, 0, 0],
        inertia=[1e-3, 1e-3, 1e-3],  # it does not turn
        explicitinertial=True,
    )
    coil.add_joint(
        name="shaker",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[1, 0, 0],
        stiffness=[shaker.suspension_stiffness, 0, 0],
        damping=[shaker.suspension_damping, 0, 0],
    )
    coil.add_site(name=COIL)
    pushed.add_site(name="stinger_end", pos=list(shaker.point))
    stinger = spec.add_tendon(
        name="stinger",
        stiffness=[shaker.stinger_stiffness, 0, 0],
        damping=[shaker.stinger_damping, 0, 0],
        springlength=[shaker.stinger_length, shaker.stinger_length],
    )
    stinger.wrap_site(COIL)
    stinger.wrap_site("stinger_end")
    spec.add_actuator(name=DRIVE, trntype=mujoco.mjtTrn.mjTRN_JOINT, target="shaker")


def place_shaker(model: mujoco.MjModel, data: mujoco.MjData, shaker: Shaker) -> None:
    """Set the stand up for the positions in ``data.qpos``, the stinger at its own length.

    Parameters
    ----------
    model : MjModel
        Changed: the stand's place in its parent.
    data : MjData
        Positions of the arm; scratch space otherwise.
    shaker : Shaker
        The shaker of the model.
    """
    mujoco.mj_kinematics(model, data)
    body = data.body(shaker.body)
    rotation = body.xmat.reshape(3, 3)
    push = rotation @ np.asarray(shaker.direction, dtype=float)
    push /= np.linalg.norm(push)
    origin = body.xpos + rotation @ np.asarray(shaker.point) - shaker.stinger_length * push
    stand = model.body(_STAND)
    parent = data.body(int(stand.parentid[0]))
    turn = parent.xmat.reshape(3, 3).T
    model.body_pos[stand.id] = turn @ (origin - parent.xpos)
    model.body_quat[stand.id] = _turn_x_to(turn @ push)


def _turn_x_to(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternion that turns the x axis to a unit vector."""
    x = np.array([1.0, 0.0, 0.0])
    cross = np.cross(x, direction)
    quaternion = np.array([1.0 + x @ direction, *cross])
    if np.linalg.norm(quaternion) < 1e-9:  # straight back
        return np.array([0.0, 0.0, 0.0, 1.0])
    return np.asarray(quaternion / np.linalg.norm(quaternion))
