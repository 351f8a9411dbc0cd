"""Linearised equations of motion of one arm in one pose, from its MuJoCo model.

Within a record the joints move by fractions of a milliradian and the seat by fractions of a
millimetre, so the inertia matrix, the tool's Jacobian and gravity's linear part may be taken as
constant. What is left is a handful of linear equations and one seat that sticks, slides and
strikes its stops:

    M a = B u + f0 - K (q - q0) - C v + e (friction + stops).

Brakes and servos are the springs, dampers and inertances that MuJoCo's constraints make of
them; friction and stops follow the same constraint law as in `loose_env.faults.seating`.
Centripetal terms are left out: they are of second order in the motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation
from loose_env.rig.plant import Plant
from loose_env.typing import Array

__all__ = ["SeatLaw", "SmallMotion", "require_one_part", "small_motion"]


@dataclass(frozen=True, kw_only=True)
class SeatLaw:
    """Forces of a seat with one degree of freedom [N and m, N·m and rad for a hinge]."""

    low: float
    """Position of the lower stop."""
    high: float
    """Position of the upper stop."""
    stiffness: tuple[float, float]
    """Of the lower and the upper stop."""
    damping: tuple[float, float]
    """Of the lower and the upper stop."""
    inertance: tuple[float, float]
    """Force per acceleration that a touched stop adds."""
    friction: float
    """Largest friction force."""
    grip: float
    """Friction force per acceleration while the seat sticks."""
    rate: float
    """Deceleration per velocity that sticking friction aims at [1/s]."""

    @property
    def numbers(self) -> Array:
        """All parameters as one array, the input of the compiled loop (11,)."""
        return np.array(
            [
                self.low,
                self.high,
                *self.stiffness,
                *self.damping,
                *self.inertance,
                self.friction,
                self.grip,
                self.rate,
            ]
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallMotion:
    """Linearised motion of one true arm about one pose, with D degrees of freedom."""

    dofs: NDArray[np.intp]
    """Which degrees of freedom of the model they are (D,)."""
    mobility: Array
    """Inverse of the inertia matrix with the holdings' inertances (D, D)."""
    stiffness: Array
    """Springs, holdings and gravity's linear part (D, D)."""
    damping: Array
    """Dampers and holdings (D,)."""
    force: Array
    """Constant force, gravity above all (D,)."""
    start: Array
    """Position at the start less that at which springs rest (D,)."""
    drives: Array
    """Force per drive torque (D, n)."""
    readings: Array
    """Sensor acceleration per acceleration of each degree of freedom (S, D)."""
    tilting: Array
    """Sensor reading per displacement: gravity seen from a turned sensor (S, D)."""
    still: Array
    """Sensor readings at rest (S,)."""
    encoders: Array
    """Joint position per displacement of each degree of freedom (n, D)."""
    zero: Array
    """Joint positions where springs rest (n,)."""
    seat: int
    """Index of the loose seat among the degrees of freedom; -1 where there is none."""
    law: SeatLaw | None
    """Forces of that seat."""


def small_motion(
    plant: Plant, arm: Arm, data: mujoco.MjData, excitation: Excitation, place: float
) -> SmallMotion:
    """Linearise a true arm about its initial pose.

    Parameters
    ----------
    plant : Plant
        The true arm; `Plant.hold_at` has been called.
    arm : Arm
        The nominal arm.
    data : mujoco.MjData
        Scratch space of the plant's layout.
    excitation : Excitation
        Says which joints are excited and not held.
    place : float
        Start of the seat, from the middle between its stops [m or rad].

    Raises
    ------
    InvalidSetting
        If the seat has several degrees of freedom, there is a shaker, or a joint has a spring,
        a damper or a friction that is not linear.
    """
    model = plant.model
    _require_linear(model, plant)
    seat_dof = int(model.joint("seat").dofadr[0])
    lock = bool(model.eq_active0[model.equality("seat_lock").id])
    _place(model, data, plant, place)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    bias = data.qfrc_bias.copy()
    readings, tilting, still = _sensors(model, data)
    stiffness = _gravity_stiffness(model, data, bias)

    springs = model.jnt_stiffness[model.dof_jntid]
    rest = model.qpos_spring[model.jnt_qposadr[model.dof_jntid]]
    damping = model.dof_damping.copy()
    released = np.array(excitation.excited)
    joints = [int(model.joint(name).dofadr[0]) for name in arm.joints]
    for j, (dof, equality) in enumerate(zip(joints, plant.brakes, strict=True)):
        if released[j]:
            continue
        held, stiff, damper = _holding(model, int(equality), dof)
        inertia[dof, dof] += held
        springs = springs + stiff * (np.arange(model.nv) == dof)
        damping[dof] += damper
        rest = np.where(np.arange(model.nv) == dof, model.eq_data[equality, 0], rest)
    stiffness[np.arange(model.nv), np.arange(model.nv)] += springs

    free = np.array([d for d in range(model.nv) if not (lock and d == seat_dof)], dtype=np.intp)
    position = data.qpos[model.jnt_qposadr[model.dof_jntid]]
    drives = np.zeros((model.nv, arm.n))
    drives[joints, np.arange(arm.n)] = 1.0
    encoders = np.zeros((arm.n, model.nv))
    encoders[np.arange(arm.n), joints] = 1.0
    # Gravity's linear part is taken about the start, springs about where they rest.
    start = (position - rest)[free]
    gravity = stiffness[np.ix_(free, free)].copy()
    gravity[np.arange(len(free)), np.arange(len(free))] -= springs[free]
    return SmallMotion(
        dofs=free,
        mobility=np.linalg.inv(inertia[np.ix_(free, free)]),
        stiffness=stiffness[np.ix_(free, free)],
        damping=damping[free],
        force=-bias[free] + gravity @ start,
        start=start,
        drives=drives[free],
        readings=readings[:, free],
        tilting=tilting[:, free],
        still=still - tilting[:, free] @ start,
        encoders=encoders[:, free],
        zero=rest[joints],
        seat=-1 if lock else int(np.searchsorted(free, seat_dof)),
        law=None if lock else _law(model, seat_dof, rest=float(rest[seat_dof])),
    )


def require_one_part(plant: Plant) -> None:
    """Reject an arm that is loose in more than one degree of freedom.

    Raises
    ------
    InvalidSetting
        If it is.
    """
    if plant.parts != 1:
        raise InvalidSetting(
            "the reduced engine knows faults of one degree of freedom; take the engine 'mujoco' "
            "for compound looseness and for several faults at once"
        )


def _require_linear(model: mujoco.MjModel, plant: Plant) -> None:
    require_one_part(plant)
    if plant.shaker is not None:
        raise InvalidSetting("the reduced engine knows no shaker; take the engine 'mujoco'")
    seat = int(model.joint("seat").dofadr[0])
    friction = np.delete(model.dof_frictionloss, seat)
    if model.jnt_stiffnesspoly.any() or model.dof_dampingpoly.any() or friction.any():
        raise InvalidSetting(
            "the reduced engine takes springs and dampers of joints as linear and knows no "
            "friction in them; this arm has others: take the engine 'mujoco'"
        )


def _place(model: mujoco.MjModel, data: mujoco.MjData, plant: Plant, place: float) -> None:
    """Set the arm to its pose at rest, all other coordinates zero."""
    data.qpos[:] = 0.0
    data.qvel[:] = 0.0
    data.qacc_warmstart[:] = 0.0
    data.ctrl[:] = 0.0
    data.qpos[plant.position] = model.eq_data[plant.brakes, 0]
    data.qpos[plant.seat_positions] = place
    data.eq_active[:] = 0  # readings and forces of the constraints are worked out here


def _sensors(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array, Array]:
    """Linear part and rest reading of every accelerometer, in the order of the channels."""
    jacobian, turning = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    gravity = model.opt.gravity
    readings, tilting, still = [], [], []
    for k in range(model.nsensor):
        if model.sensor_type[k] != mujoco.mjtSensor.mjSENS_ACCELEROMETER:
            continue
        site = int(model.sensor_objid[k])
        mujoco.mj_jacSite(model, data, jacobian, turning, site)
        frame = data.site_xmat[site].reshape(3, 3).T
        readings.append(frame @ jacobian)
        tilting.append(frame @ np.cross(turning, gravity, axisa=0).T)
        still.append(-frame @ gravity)
    return np.concatenate(readings), np.concatenate(tilting), np.concatenate(still)


def _gravity_stiffness(model: mujoco.MjModel, data: mujoco.MjData, bias: Array) -> Array:
    """Gravity stiffness matrix of the degrees of freedom (nv, nv)."""
    change = np.zeros((model.nv, model.nv))
    if not np.abs(bias).max() > 0:
        return change
    step = 1e-6
    before = data.qpos.copy()
    for dof in range(model.nv):
        data.qpos[model.jnt_qposadr[model.dof_jntid[dof]]] += step
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        moved = np.zeros(model.nv)
        mujoco.mj_rne(model, data, 0, moved)
        change[:, dof] = (moved - bias) / step
        data.qpos[:] = before
    return change


def _holding(model: mujoco.MjModel, equality: int, dof: int) -> tuple[float, float, float]:
    """Inertance, stiffness and damping of a braked or servoed joint."""
    impedance = float(model.eq_solimp[equality, 0])
    inertance = impedance / ((1 - impedance) * model.dof_invweight0[dof])
    stiff, damper = -model.eq_solref[equality]
    return inertance, inertance * stiff / impedance, inertance * damper / impedance


def _law(model: mujoco.MjModel, dof: int, *, rest: float) -> SeatLaw:
    """Extract the constraint law of the seat from the model."""
    stops = [model.tendon(f"seat_{side}").id for side in ("low", "high")]
    soft = model.tendon_solimp_lim[stops, 0]
    inertance = soft / ((1 - soft) * model.tendon_invweight0[stops])
    scale = inertance / soft
    stiffness = -model.tendon_solref_lim[stops, 0] * scale
    damping = -model.tendon_solref_lim[stops, 1] * scale
    stiff = float(model.dof_solimp[dof, 0])
    return SeatLaw(
        low=float(model.tendon_range[stops[0], 0]) - rest,
        high=float(model.tendon_range[stops[1], 1]) - rest,
        stiffness=(float(stiffness[0]), float(stiffness[1])),
        damping=(float(damping[0]), float(damping[1])),
        inertance=(float(inertance[0]), float(inertance[1])),
        friction=float(model.dof_frictionloss[dof]),
        grip=stiff / ((1 - stiff) * float(model.dof_invweight0[dof])),
        # Critically damped with MuJoCo's shortest time constant.
        rate=2 / (stiff * float(model.dof_solref[dof, 0])),
    )
