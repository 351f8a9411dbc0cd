"""A planar arm of n links, horizontal or vertical."""

from __future__ import annotations

import numpy as np

from loose_env.arms.arm import Arm, HoldKind
from loose_env.arms.holding.compliance import held
from loose_env.arms.spec_parts import (
    CREST_FACTOR,
    GRAVITY,
    MOTOR_SIDE,
    add_link,
    holdings,
    new_spec,
)
from loose_env.errors import InvalidSetting

__all__ = ["planar"]


def planar(n_links: int = 4, *, vertical: bool = False, hold: HoldKind = "brake") -> Arm:
    """Build a planar arm of ``n_links`` equal lengths whose masses taper towards the tool.

    Each link is 0.30 m long; link 1 has 4 kg, each next one 0.75 of it, centre of mass at
    0.55 of the length because the next joint's drive sits at the far end. A drive's
    reflected rotor inertia is half the inertia it moves with the arm straight, as on
    industrial arms (PUMA 560: 1.1 and 4.7 kg·m² at the first two joints). Torque limits
    are what the top level asks of each joint with the arm straight, peaks included. Elastic
    gears have a mode of 60 Hz each (`loose_env.arms.arm.GEAR_MODE_HZ`): for three
    links 3e5, 8.4e4 and 1.1e4 N·m/rad, within what industrial drives have.

    Parameters
    ----------
    n_links : int
        2 to 7.
    vertical : bool
        Whether the plane of motion holds gravity; else gravity is normal to it.
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding.compliance`.

    Raises
    ------
    InvalidSetting
        If ``n_links`` is not 2 to 7.

    Examples
    --------
    >>> planar(3).joints
    ('joint1', 'joint2', 'joint3')
    """
    whole = isinstance(n_links, (int, np.integer)) and not isinstance(n_links, bool)
    if not whole or n_links not in range(2, 8):
        raise InvalidSetting(f"a planar arm has 2 to 7 links, got n_links={n_links!r}")
    if not isinstance(vertical, (bool, np.bool_)):
        raise InvalidSetting(f"vertical is True or False, got {vertical!r}")
    length, first_mass, taper, centre = 0.30, 4.0, 0.75, 0.55
    levels = (1.0, 4.0, 12.0)
    # The plane of motion is x-y: gravity along -y makes the arm a vertical one.
    spec = new_spec(gravity=(0, -GRAVITY, 0) if vertical else (0, 0, -GRAVITY))
    parent = spec.worldbody
    masses = [first_mass * taper**i for i in range(n_links)]
    for i in range(1, n_links + 1):
        mass = masses[i - 1]
        link = add_link(
            parent,
            i,
            at=(0.0 if i == 1 else length, 0, 0),
            flange_mass=MOTOR_SIDE * mass,
            rotor_inertia=0.5 * _distal_inertia(masses[i - 1 :], length, centre),
            joint_damping=0.3 * taper ** (i - 1),
        )
        link.mass = (1 - MOTOR_SIDE) * mass
        link.ipos = [centre * length, 0, 0]
        across = (1 - MOTOR_SIDE) * mass * length**2 / 12
        link.inertia = [0.1 * across, across, across]
        link.explicitinertial = True
        parent = link
    parent.add_site(name="tool", pos=[length, 0, 0])
    joints = tuple(f"joint{i}" for i in range(1, n_links + 1))
    brake, servo, centring = holdings(spec, joints)
    limit = np.radians(150.0)
    arm = Arm(
        name=f"planar{n_links}{'v' if vertical else ''}",
        spec=spec,
        joints=joints,
        seat_bodies=tuple(f"link{i}" for i in range(1, n_links + 1)),
        tool="tool",
        axes=(0, 1),
        torque_limits=tuple(
            float(f"{_peak_torque(masses[i:], length, centre, levels[-1]):.2g}")
            for i in range(n_links)
        ),
        joint_ranges=((-np.pi, np.pi), *((-limit, limit) for _ in joints[1:])),
        levels=levels,
        band=(30.0, 150.0),
        brake=brake,
        servo=servo,
        centring=centring,
        timestep=2e-4,
    )
    return held(arm, hold)


def _distal_inertia(masses: list[float], length: float, centre: float) -> float:
    """Inertia of straight links about the joint of the first of them [kg·m²]."""
    return sum(m * length**2 * (1 / 12 + (k + centre) ** 2) for k, m in enumerate(masses))


def _peak_torque(masses: list[float], length: float, centre: float, level: float) -> float:
    """Peak torque that shakes the tool of the straight arm at a level [N·m]."""
    inertia = 1.5 * _distal_inertia(masses, length, centre)
    return CREST_FACTOR * level * inertia / (len(masses) * length)
