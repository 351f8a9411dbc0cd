"""A large cylindrical arm after the Prab Versatran FA600 (6.2.1): swing, lift, reach, wrist."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from loose_env.arms import HOLDING_MODE_HZ, Arm, Gears, Holding, HoldKind, held, holdings, new_spec

COLUMN_MODE_HZ = 8.0
"""Mode of the column on its floor, arm raised and extended, joints locked [Hz] (6.2.1)."""
COLUMN_DAMPING = 0.03
"""Damping ratio of that mode; an estimate."""
SIDE_STIFFNESS = 1.9
"""Column stiffness sideways over that fore and aft [1]: the feet are farther apart; an estimate."""
LOCK_MODE_HZ = 240.0
"""Holding mode of the mechanical locks: four times the top of the band; an estimate."""
OIL_MODE_HZ = 25.0
"""Mode of each joint on the oil of its cylinder, valves shut, for ``hold="compliant"`` [Hz]: an
estimate for large hydraulic drives, inside the band."""
GUIDE = "guide"
"""Body of the bearing blocks on the carriage, through which the boom runs."""

SWING_LIMIT = np.radians(125.0)
LIFT, REACH = 0.76, 1.05
_LOWEST = 0.60  # height of the boom over the floor, carriage down [m]
_BOOM_LENGTH, _BOOM_AHEAD = 2.40, 0.55  # length, and how much is ahead of the guide, drawn in [m]
_COLUMN_MASS, _CARRIAGE_MASS, _BLOCKS_MASS, _BOOM_MASS = 400.0, 170.0, 12.0, 110.0
_WRIST = ((16.0, 0.12), (11.0, 0.10), (8.0, 0.14))  # mass [kg] and length [m] of each wrist link

_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE


def cylindrical(*, hold: HoldKind = "brake") -> Arm:
    """Build a hydraulic cylindrical arm of six axes with gravity along -z.

    Joint 1 swings the column about the vertical [rad], joint 2 lifts the carriage along it
    [m], joint 3 runs the boom out through the carriage's bearing blocks [m]; joints 4 to 6
    are the wrist: roll about the boom, pitch, roll [rad]. Where joint 2 or 3 is meant, every
    figure of `Arm` that is given there per radian or in N·m is per metre or in N: positions and
    ranges in m, torque limits in N, stiffness in N/m and damping in N·s/m. Play in joints 2 and 3
    (`Backlash`) is along them.

    The thesis gives the layout, the mode at 8 Hz with the arm raised and extended, and no
    masses or lengths. All masses, lengths, strokes and force limits here are estimates for an
    arm of this class: 0.76 m of lift, 1.05 m of reach, 145 kg of boom and wrist. The boom
    reaches back behind the column, so its weight goes over from the rear of its guide to the front
    as it runs out. The column leans on its floor in two directions; the one fore and aft at
    zero swing has the mode of 8 Hz, sideways it is stiffer, so what the tool shows depends
    on the swing as well.

    Parameters
    ----------
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding`.

    Examples
    --------
    >>> arm = cylindrical()
    >>> arm.n, arm.joint_ranges[2]
    (6, (0.0, 1.05))
    """
    spec = new_spec(gravity=(0, 0, -9.81))
    floor = _body(spec.worldbody, "column_foot", (0, 0, 0), 60.0, (0, 0, 0), (0.6, 0.6, 0.6))
    for name, axis in (("lean_fore", (0, 1, 0)), ("lean_side", (1, 0, 0))):
        floor.add_joint(name=name, type=_HINGE, axis=list(axis))

    column = _link(
        floor, 1, (0, 0, 0.1), _HINGE, (0, 0, 1), flange_mass=20.0, armature=5.0, damping=400.0
    )
    _mass(column, _COLUMN_MASS, (0, 0, 0.75), _box(_COLUMN_MASS, 0.45, 0.45, 1.7))

    carriage = _link(
        column,
        2,
        (0.15, 0, _LOWEST - 0.1),
        _SLIDE,
        (0, 0, 1),
        flange_mass=10.0,
        armature=10.0,
        damping=900.0,
    )
    _mass(carriage, _CARRIAGE_MASS, (0, 0, 0), _box(_CARRIAGE_MASS, 0.6, 0.5, 0.4))
    blocks = _body(
        carriage, GUIDE, (0, 0, 0), _BLOCKS_MASS, (0, 0, 0), _box(_BLOCKS_MASS, 0.5, 0.2, 0.2)
    )
    boom = _link(
        blocks, 3, (0, 0, 0), _SLIDE, (1, 0, 0), flange_mass=5.0, armature=5.0, damping=300.0
    )
    centre = _BOOM_AHEAD - _BOOM_LENGTH / 2
    _mass(boom, _BOOM_MASS, (centre, 0, 0), _box(_BOOM_MASS, _BOOM_LENGTH, 0.15, 0.15))

    parent, place = boom, (_BOOM_AHEAD, 0.0, -0.15)
    for number, axis in ((4, (1, 0, 0)), (5, (0, 1, 0)), (6, (1, 0, 0))):
        mass, length = _WRIST[number - 4]
        link = _link(
            parent, number, place, _HINGE, axis, flange_mass=1.0, armature=0.05, damping=5.0
        )
        _mass(link, mass, (length / 2, 0, 0), _box(mass, length, 0.12, 0.12))
        parent, place = link, (length, 0.0, 0.0)
    parent.add_site(name="tool", pos=list(place))
    boom.add_site(name="wrist_base", pos=[_BOOM_AHEAD, 0, -0.15])
    _stiffen_column(spec)

    joints = tuple(f"joint{i}" for i in range(1, 7))
    brake, servo, centring = holdings(spec, joints)
    softer = LOCK_MODE_HZ / HOLDING_MODE_HZ
    brake = Holding(
        stiffness=tuple(float(f"{k * softer**2:.3g}") for k in brake.stiffness),
        damping=tuple(float(f"{c * softer:.3g}") for c in brake.damping),
    )
    turn = np.radians(170.0)
    arm = Arm(
        name="cylindrical",
        spec=spec,
        joints=joints,
        seat_bodies=tuple(f"link{i}" for i in range(1, 7)),
        tool="tool",
        axes=(0, 1, 2),
        torque_limits=(3000.0, 9000.0, 4000.0, 400.0, 300.0, 150.0),
        joint_ranges=(
            (-SWING_LIMIT, SWING_LIMIT),
            (0.0, LIFT),
            (0.0, REACH),
            (-turn, turn),
            (-np.pi / 2, np.pi / 2),
            (-turn, turn),
        ),
        levels=(0.2, 0.6, 2.0),
        band=(15.0, 60.0),
        brake=brake,
        servo=servo,
        centring=centring,
        timestep=2e-4,
        settling=0.5,  # the column's mode, below the band, is hardly excited
        gears=Gears(mode_hz=OIL_MODE_HZ),
        probes=("wrist_base",),
    )
    return held(arm, hold)


def _stiffen_column(spec: mujoco.MjSpec) -> None:
    """Give the leaning column its mode with the arm raised and extended, joints locked."""
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    data.joint("joint2").qpos[0], data.joint("joint3").qpos[0] = LIFT, REACH
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dof = model.joint("lean_fore").dofadr[0]
    inertia, omega = float(full[dof, dof]), 2 * np.pi * COLUMN_MODE_HZ
    for name, factor in (("lean_fore", 1.0), ("lean_side", SIDE_STIFFNESS)):
        joint = spec.joint(name)
        joint.stiffness = [factor * inertia * omega**2, 0, 0]
        joint.damping = [factor * 2 * COLUMN_DAMPING * inertia * omega, 0, 0]


def _link(
    parent: mujoco.MjsBody,
    number: int,
    at: Sequence[float],
    kind: mujoco.mjtJoint,
    axis: Sequence[float],
    *,
    flange_mass: float,
    armature: float,
    damping: float,
) -> mujoco.MjsBody:
    """Add the flange that carries a joint, and on it the still massless link."""
    flange = _body(
        parent, f"flange{number}", at, flange_mass, (0, 0, 0), _box(flange_mass, 0.1, 0.1, 0.1)
    )
    flange.add_joint(
        name=f"joint{number}",
        type=kind,
        axis=list(axis),
        armature=armature,
        damping=[damping, 0, 0],
    )
    return flange.add_body(name=f"link{number}")


def _body(
    parent: mujoco.MjsBody,
    name: str,
    at: Sequence[float],
    mass: float,
    centre: Sequence[float],
    inertia: Sequence[float],
) -> mujoco.MjsBody:
    body = parent.add_body(name=name, pos=list(at))
    _mass(body, mass, centre, inertia)
    return body


def _mass(
    body: mujoco.MjsBody, mass: float, centre: Sequence[float], inertia: Sequence[float]
) -> None:
    body.mass, body.ipos, body.inertia = mass, list(centre), list(inertia)
    body.explicitinertial = True


def _box(mass: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Principal inertia of a box of the given sides [kg·m²]."""
    return (mass * (y**2 + z**2) / 12, mass * (x**2 + z**2) / 12, mass * (x**2 + y**2) / 12)
