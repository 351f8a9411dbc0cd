"""When a loose part must knock: loads on seats and teeth, and a mass between two stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.instrument.arm import AXES, ROCKS, PoseModel
from loose_env.statistics import knocks, rung
from loose_env.typing import Array

DIRECTIONS = 240
"""Directions of a seat's slide that are tried, over half the sphere: 9 degrees apart."""
SEAT_FRICTION_N, SEAT_FRICTION = 3.0, 0.3
"""Friction of a loosened seat: of steel on steel under the weight that it carries [1], and at most
what bolts without preload leave [N]."""
TEETH_FRICTION = (0.06, 6.0)
"""Friction on the load's side of a joint's teeth [N·m; N where it slides]."""
_RING_S = 0.005
"""Time in which a knock's ringing decays to 1/e [s]."""
_REVERSAL_S = 0.010
"""The same of friction's reversal [s]."""


def sphere(count: int, share: float = 1.0) -> Array:
    """Directions (count, 3) over half the sphere, or that share of it around z (Fibonacci)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - share * k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1)


def around(centres: Array, count: int, share: float) -> Array:
    """Directions (n, count, 3) spread over that share of half the sphere around each centre."""
    flat = np.linalg.svd(centres[:, None])[2][:, 1:]
    axes = np.concatenate([flat, centres[:, None]], 1)
    found: Array = sphere(count, share) @ axes
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Loads:
    """What seats and teeth carry in one pose over a period; n joints."""

    seats: Array
    """Force of each seat on all beyond it, link frame (n, GRID, 3) [N]."""
    turning: Array
    """Torque of each joint's teeth, and on the base about each of its axes (n + AXES, GRID)
    [N·m, N]."""
    mass: Array
    """Mass beyond each seat (n,) [kg]."""
    throws: Array
    """Acceleration of the tool by unit force across each seat (n, 3, 3) [1/kg]."""
    stiff: Array
    """Force by unit acceleration of each seat's opening (n, 3, 3) [kg]."""
    turns: Array
    """Acceleration of the tool by unit acceleration of each's opening (n + AXES, 3)."""
    inertia: Array
    """Inertia that flies free when it parts (n + AXES,) [kg·m², kg]."""

    def along(self, link: int, directions: Array) -> tuple[Array, Array, Array]:
        """Load (D, GRID), mass (D,) and throw of the tool (D, 3) of a seat along directions."""
        stiff = np.einsum("da,ab,db->d", directions, self.stiff[link], directions)
        load = directions @ self.seats[link].T
        return load, np.maximum(stiff, 0.02), directions @ self.throws[link].T


def loads_of(model: PoseModel, acceleration: Array, stiffening: Array) -> Loads:
    """Loads under link accelerations (GRID, n), gravity included."""
    throws, stiff, turns, free = model.throws(stiffening)
    inertia = model.inertia + np.diag(np.maximum(stiffening, 0.0))
    seats = [
        acceleration @ carried.T + weight
        for carried, weight in zip(model.carried, model.weight, strict=True)
    ]
    return Loads(
        seats=np.array(seats),
        turning=np.vstack(
            [
                (acceleration @ inertia + model.torque).T,
                (acceleration @ model.rocked.T + model.moment).T,
            ]
        ),
        mass=model.mass,
        throws=throws,
        stiff=stiff,
        turns=turns,
        inertia=free,
    )


def trains(
    loads: Sequence[Loads], directions: Array, gap_mm: float, slides: Array, period: float
) -> list[Array]:
    """Ringing that hypotheses foretell in each pose (H, GRID): seats by direction, teeth, base.

    Parameters
    ----------
    directions : ndarray
        Directions of the seats, link frame: of all (D, 3), or of each (n, D, 3).
    gap_mm : float
        Clearance of a seat [mm]; ten times it is a joint's free travel [mrad], or as much of a
        slide [mm].
    """
    carried = [_carried(own, directions, gap_mm, slides) for own in loads]
    mass, gap, friction, louds = (np.concatenate([own[k] for own in carried]) for k in range(1, 5))
    load = np.concatenate([own[0].T for own in carried], axis=1).T  # time first, as knocks has it
    energy = rung(knocks(load, mass, gap, friction, period), _RING_S, period) * louds[:, None]
    return [_of_plates(own) for own in np.split(energy, len(loads))]


def _of_plates(each: Array, join: np.ufunc = np.add) -> Array:
    """Values of seats, joints and turns of the base, of those of its axes: two make a plate."""
    return np.concatenate([each[:-AXES], join(each[-AXES:-ROCKS], each[-ROCKS:])])


def _carried(
    loads: Loads, directions: Array, gap_mm: float, slides: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Load (H, GRID), mass, clearance, friction and loudness of each seat, joint, axis (H,)."""
    n, each = len(loads.seats), _of_each(loads, directions)
    parts = [loads.along(link, own) for link, own in enumerate(each)]
    load = np.concatenate([p[0].T for p in parts] + [loads.turning.T], axis=1).T
    mass = np.concatenate([p[1] for p in parts] + [loads.inertia])
    count = n * each.shape[1]
    gap = np.full(len(load), gap_mm * 1e-3)
    gap[count:] = np.where(_sliding(slides), gap_mm * 1e-3, gap_mm * 1e-2)
    thrown = np.concatenate([p[2] for p in parts])
    loud = np.concatenate([(thrown**2).sum(1), (loads.turns**2).sum(1)])
    return load, mass, gap, friction_of(loads, each.shape[1], slides), loud


def _of_each(loads: Loads, directions: Array) -> Array:
    """Directions of each seat (n, D, 3)."""
    return np.broadcast_to(directions, (len(loads.seats), *directions.shape[-2:]))


def friction_of(loads: Loads, directions: int, slides: Array) -> Array:
    """Friction of every seat's direction, joint, and axis of the base [N, N·m]."""
    each = np.minimum(SEAT_FRICTION_N, SEAT_FRICTION * 9.81 * loads.mass)
    seats = np.repeat(each, directions)
    teeth = np.where(slides, TEETH_FRICTION[1], TEETH_FRICTION[0])
    return np.concatenate([seats, teeth, np.full(AXES, SEAT_FRICTION_N * _PLATE_M)])


_PLATE_M = 0.1
"""Lever at which the bolts of a base hold it [m]."""


def _sliding(slides: Array) -> Array:
    """True where a joint slides, for each joint and each axis of the base (n + AXES,)."""
    return np.concatenate([slides, np.zeros(AXES, dtype=bool)])


def reversals(loads: Loads, speed: Array, period: float) -> Array:
    """Ringing that friction foretells (n, GRID): each motor turning round, faster is louder."""
    turned = (np.sign(speed) != np.sign(np.roll(speed, 1, 0))) * np.abs(np.gradient(speed, axis=0))
    turned = turned.T
    n = len(turned)
    loud = (loads.turns[:n] ** 2).sum(-1) / loads.inertia[:n] ** 2
    found: Array = rung(turned, _REVERSAL_S, period) * loud[:, None]
    return found


def thrown(loads: Loads, directions: Array) -> Array:
    """Covariance of the tool's acceleration by each hypothesis (H, 3, 3), as `trains`; trace 1.

    Isotropic where it does not move the tool.
    """
    each = _of_each(loads, directions)
    seats = np.concatenate([own @ to.T for own, to in zip(each, loads.throws, strict=True)])
    every = np.vstack([seats, loads.turns])
    made = _of_plates(every[:, :, None] * every[:, None, :]) + _STILL * np.eye(3)
    found: Array = made / np.trace(made, axis1=1, axis2=2)[:, None, None]
    return found


_STILL = 1e-20
"""Square of a throw that is none [1/kg², m²]."""


def reversing(loads: Loads, directions: Array, slides: Array) -> Array:
    """How far each hypothesis' load reverses (H,): the smaller of its two peaks over friction.

    A seat or a joint whose load stays on one side, or within friction, cannot knock: it is not
    tested by this pose.
    """
    n = len(loads.seats)
    load = np.concatenate([directions @ loads.seats[link].T for link in range(n)] + [loads.turning])
    friction = friction_of(loads, len(directions), slides)
    return _of_plates(np.minimum(load.max(1), -load.min(1)) / friction, np.maximum)
