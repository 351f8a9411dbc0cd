"""Condition of the inertia matrix with a looseness joint in it (thesis 3.2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.faults import (
    SEAT,
    Backlash,
    Healthy,
    Preload,
    StructuralLooseness,
    seat_of,
    seated_spec,
)
from loose_env.typing import Array

__all__ = ["Condition", "backlash_condition", "condition_of", "seated_inertia"]


@dataclass(frozen=True, slots=True)
class Condition:
    """Condition number of an inertia matrix, twice."""

    raw: float
    """In SI units: largest eigenvalue over smallest. Depends on the unit of length."""
    scaled: float
    """Of the matrix with a unit diagonal; no choice of units changes it."""


def seated_inertia(
    arm: Arm, pose: ArrayLike, fault: Healthy | Preload | StructuralLooseness | Backlash
) -> Array:
    """Inertia matrix of the driven joints and, for a fault, its seat (3.11 with 3.43).

    ``arm``: the arm; its bending modes are at rest and left out. ``pose`` (n,): joint positions
    [rad]. ``fault``: the seat. Healthy gives the nominal (n, n) matrix. Returns (n, n) or (n+1,
    n+1): joints first, base to tool, then the seat [kg m², kg m, kg].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> fault = StructuralLooseness(link=2, direction=(0, 1, 0), gap=2e-4, stiffness=(1e5, 1e5))
    >>> seated_inertia(planar(2), [0.0, 0.5], fault).shape
    (3, 3)
    """
    q = np.asarray(pose, dtype=float)
    if q.shape != (arm.n,) or not np.isfinite(q).all():
        raise InvalidSetting(
            f"a pose of {arm.name!r} is {arm.n} finite numbers [rad], got {pose!r}"
        )
    link, kind = seat_of(fault)
    names = list(arm.joints)
    if isinstance(fault, Healthy) or link is None:
        model = arm.model
    else:
        spec = seated_spec(arm, link, kind)
        if isinstance(fault, (StructuralLooseness, Preload)):
            spec.joint(SEAT).axis = list(fault.direction)
        model = spec.compile()
        names.append(SEAT)
    data = mujoco.MjData(model)
    for name, value in zip(arm.joints, q, strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dofs = [int(model.joint(name).dofadr[0]) for name in names]
    return full[np.ix_(dofs, dofs)]


def condition_of(inertia: ArrayLike) -> Condition:
    """Condition number of an inertia matrix, raw and scaled to a unit diagonal.

    Examples
    --------
    >>> condition_of([[4.0, 0.0], [0.0, 1.0]])
    Condition(raw=4.0, scaled=1.0)
    """
    m = np.asarray(inertia, dtype=float)
    if m.ndim != 2 or m.shape[0] != m.shape[1] or not np.isfinite(m).all():
        raise InvalidData(f"an inertia matrix is square and finite, got shape {m.shape}")
    if not np.allclose(m, m.T, rtol=1e-9, atol=1e-12 * np.abs(m).max()):
        raise InvalidData("an inertia matrix is symmetric; this one is not")
    values = np.linalg.eigvalsh(m)
    if values[0] <= 0:
        raise InvalidData(
            f"an inertia matrix is positive definite; the smallest eigenvalue is {values[0]:.3g}"
        )
    size = np.sqrt(np.diag(m))
    unit = np.linalg.eigvalsh(m / np.outer(size, size))
    return Condition(raw=float(values[-1] / values[0]), scaled=float(unit[-1] / unit[0]))


def backlash_condition(ratio: float) -> float:
    """Scaled condition number of one joint with play, in closed form.

    Motor side of inertia ``ratio`` times that of the link side: M = I [[1 + r, 1], [1, 1]],
    condition (1 + c) / (1 - c) with c = (1 + r)^(-1/2), about 4 / r for a light motor side.

    ``ratio``: motor side over link side, seen at the joint; gears multiply a rotor's inertia by the
    square of their ratio.

    Examples
    --------
    >>> round(backlash_condition(3.0), 6)
    3.0
    """
    if not (np.isfinite(ratio) and ratio > 0):
        raise InvalidSetting(f"the ratio of inertias must be finite and above zero, got {ratio!r}")
    coupling = 1 / np.sqrt(1 + ratio)
    # 1 - c = r c² / (1 + c): no cancellation for a light motor side.
    return float((1 + coupling) ** 2 / (ratio * coupling**2))
