"""Jacobian of a serial arm, and its columns that a loose seat changes (thesis 3.2.2).

A looseness joint is one more column of the Jacobian, whose rate nobody drives or measures.
Where the loose seat has moved by d, other columns change too; which ones depends on the point
and the frame in which the Jacobian is written, and they tell the link.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.kinematics.chain import Chain
from loose_env.typing import Array

__all__ = [
    "Frame",
    "changed_columns",
    "geometric_jacobian",
    "link_of_changed_columns",
    "tool_velocity",
    "velocity_error",
]

Frame = Literal["tool", "world", "base"]
"""Point and axes of a Jacobian: tool point in tool axes, tool point in world axes, or the point
of the tool's body that lies on the world's origin, in world axes."""


def geometric_jacobian(chain: Chain, frame: Frame = "world") -> Array:
    """Columns of the Jacobian, linear part above angular part (3.2, 3.28, 3.29, 3.32).

    A revolute joint gives z × (p - o) and z, a prismatic one z and nothing. The thesis prints
    only the revolute form.

    Parameters
    ----------
    chain : Chain
        Joints and tool.
    frame : {"world", "tool", "base"}
        Tool point in world axes; tool point in tool axes; or the twist at the world's origin.

    Returns
    -------
    ndarray (6, n)
        Rows 0 to 2 [m/s per rad/s, or 1 for a prismatic joint], rows 3 to 5 [1].

    Raises
    ------
    UnknownName
        If there is no such frame.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> geometric_jacobian(Chain.of(planar(2), [0.0, 0.0]))[1]
    array([0.6, 0.3])
    """
    if frame not in ("world", "tool", "base"):
        raise UnknownName(f"unknown frame {frame!r}: 'world', 'tool' or 'base'")
    point = np.zeros(3) if frame == "base" else chain.tool
    turning = np.array([k == "revolute" for k in chain.kinds])[:, None]
    linear = np.where(turning, np.cross(chain.axes, point - chain.anchors), chain.axes)
    angular = np.where(turning, chain.axes, 0.0)
    if frame == "tool":
        linear, angular = linear @ chain.tool_axes, angular @ chain.tool_axes
    return np.vstack([linear.T, angular.T])


def tool_velocity(jacobian: ArrayLike, rates: ArrayLike) -> Array:
    """Tool velocity from joint velocities (3.3); with ``J`` of the loose arm, (3.30).

    Parameters
    ----------
    jacobian : array (m, n)
        Any rows of the Jacobian.
    rates : array (n,) or (n, N)
        Joint velocities, the looseness joint's too if it is in the Jacobian.

    Raises
    ------
    InvalidData
        If the shapes do not match or a value is not finite.

    Examples
    --------
    >>> tool_velocity([[1.0, 2.0]], [0.5, 0.25])
    array([1.])
    """
    j, q = np.asarray(jacobian, dtype=float), np.asarray(rates, dtype=float)
    if j.ndim != 2 or q.ndim not in (1, 2) or q.shape[0] != j.shape[1]:
        raise InvalidData(
            f"a Jacobian of shape {j.shape} needs one rate for every column, got {q.shape}"
        )
    if not (np.isfinite(j).all() and np.isfinite(q).all()):
        raise InvalidData("Jacobian and rates must be finite")
    return np.asarray(j @ q)


def velocity_error(
    jacobian: ArrayLike, rates: ArrayLike, loose_jacobian: ArrayLike, loose_rates: ArrayLike
) -> Array:
    """Tool velocity of the loose arm minus that of the nominal arm (3.34).

    Examples
    --------
    >>> velocity_error([[1.0, 2.0]], [0.5, 0.5], [[1.0, 0.7, 2.0]], [0.5, 0.1, 0.5])
    array([0.07])
    """
    return tool_velocity(loose_jacobian, loose_rates) - tool_velocity(jacobian, rates)


def changed_columns(before: ArrayLike, after: ArrayLike, *, tolerance: float) -> NDArray[np.bool_]:
    """Mask of the Jacobian columns that changed beyond a tolerance (3.33), shape (n,).

    Parameters
    ----------
    before, after : array (m, n)
        The Jacobian without and with the seat displaced, in the same frame.
    tolerance : float
        Largest change taken for none: norm of the column's change, in units of the Jacobian.

    Examples
    --------
    >>> changed_columns([[1.0, 2.0]], [[1.1, 2.0]], tolerance=0.01)
    array([ True, False])
    """
    a, b = np.asarray(before, dtype=float), np.asarray(after, dtype=float)
    if a.ndim != 2 or a.shape != b.shape:
        raise InvalidData(f"both Jacobians must have the same shape, got {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InvalidData("both Jacobians must be finite")
    if not tolerance >= 0:
        raise InvalidSetting(f"tolerance must be zero or more, got {tolerance!r}")
    return np.asarray(np.linalg.norm(b - a, axis=0) > tolerance)


def link_of_changed_columns(changed: Sequence[bool] | NDArray[np.bool_], frame: Frame) -> int:
    """Locate the loose link from the changed columns (after 3.33).

    In tool coordinates columns 1 to i change, where i is the loose link. At the world's origin
    columns i+1 to n change. At the tool point in world axes columns 1 to i change if the seat
    slides, and all may if it turns.

    Returns
    -------
    int
        The link, from 1; 0 where the columns name none: nothing changed, or at the base point
        everything did. A column parallel to the slide never changes, so that the last changed
        column is a lower bound of the link in a spatial arm.

    Raises
    ------
    InvalidData
        If the columns do not change in one block, which a single seat cannot cause.

    Examples
    --------
    >>> link_of_changed_columns([True, True, False], "tool")
    2
    """
    mask = np.asarray(changed, dtype=bool)
    if frame not in ("world", "tool", "base"):
        raise UnknownName(f"unknown frame {frame!r}: 'world', 'tool' or 'base'")
    count = int(mask.sum())
    block = mask[len(mask) - count :] if frame == "base" else mask[:count]
    if not block.all():
        raise InvalidData(
            f"columns {(np.flatnonzero(mask) + 1).tolist()} changed, which is not one block from "
            f"the {'tool' if frame == 'base' else 'base'}: check the tolerance, or look for a "
            "second seat"
        )
    if count == 0:
        return 0
    return len(mask) - count if frame == "base" else count
