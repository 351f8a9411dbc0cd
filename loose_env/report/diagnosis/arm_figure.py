"""The arm in a pose, with what is suspected marked, for the page of a diagnosis."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.envs import EDGE, INK, MUTED, SHAKEN, TRUTH, ArmDrawing
from loose_env.errors import InvalidData
from loose_env.faults import Backlash, StructuralLooseness
from loose_env.instrument import Fault
from loose_env.report.pages.figures import new_figure
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["arm_figure", "pose_of"]

_HEIGHT, _LEGEND = 4.5, 0.34  # of the figure, and of the words above the arm [inch]
_STIFF = (1.0, 1.0)
"""Parameters of a drawn seat, of which only location and direction show."""


def pose_of(arm: Arm, pose: Mapping[str, float]) -> Array:
    """Positions of an arm's joints, base first; those that are not named stand at zero.

    Raises
    ------
    InvalidData
        If the pose names a joint that the arm does not have.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> pose_of(planar(2), {"joint2": 0.5}).tolist()
    [0.0, 0.5]
    """
    unknown = sorted(set(pose) - set(arm.joints))
    if unknown:
        raise InvalidData(
            f"the diagnosis has a pose of the joints {unknown}, which are none of arm "
            f"{arm.name!r}; it has {', '.join(arm.joints)}: give the model that was diagnosed"
        )
    return np.array([float(pose.get(joint, 0.0)) for joint in arm.joints])


def arm_figure(
    arm: Arm,
    pose: Mapping[str, float],
    *,
    fault: Fault | None = None,
    excited: Collection[str] | None = None,
) -> Figure:
    """Draw an arm in a pose.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    pose : mapping
        Joint -> position [rad or m].
    fault : Fault, optional
        Suspected fault; drawn in the colour of the fault.
    excited : collection of str, optional
        Joints that are shaken; the others are held. Without it no joint is either.

    Raises
    ------
    InvalidData
        If the pose or the fault names what the arm does not have.
    """
    figure = new_figure(_HEIGHT)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0 - _LEGEND / _HEIGHT))
    shaken = None if excited is None else np.array([joint in excited for joint in arm.joints])
    loose, seat = _seat(arm, fault)
    drawing = ArmDrawing(arm)
    drawing.draw(axes, drawing.marks(pose_of(arm, pose), excited=shaken, loose=loose, fault=seat))
    figure.text(0.97, 0.03, drawing.seen, color=MUTED, fontsize=9.5, ha="right")
    _legend(figure, shaken, seat, bool(loose))
    return figure


def _seat(arm: Arm, fault: Fault | None) -> tuple[list[int], StructuralLooseness | Backlash | None]:
    """Loose links, and the fault as the drawings know it; None where it has no direction."""
    if fault is None or fault.where is None:
        return [], None
    places = arm.joints if fault.kind == "backlash" else arm.seat_bodies
    if fault.where not in places:
        raise InvalidData(
            f"the diagnosis names {fault.where!r}, which arm {arm.name!r} does not have; it has "
            f"{', '.join(places)}: give the model that was diagnosed"
        )
    number = places.index(fault.where) + 1
    if fault.kind == "backlash":
        return [], Backlash(joint=number, gap=0.0, stiffness=_STIFF)
    if fault.direction is None:
        return [number], None
    slide = StructuralLooseness(link=number, direction=fault.direction, gap=0.0, stiffness=_STIFF)
    return [number], slide


def _legend(
    figure: Figure,
    shaken: NDArray[np.bool_] | None,
    seat: StructuralLooseness | Backlash | None,
    loose: bool,
) -> None:
    """Name the colours above the arm."""
    entries: list[tuple[str, str, str]] = []
    if loose:
        entries.append(("■", TRUTH, "suspected link"))
    if isinstance(seat, StructuralLooseness):
        entries.append(("↔", INK, "the way it slides"))
    if isinstance(seat, Backlash):
        entries.append(("○", TRUTH, "suspected joint"))
    if shaken is not None and shaken.any():
        entries.append(("●", SHAKEN, "shaken"))
        if not shaken.all():
            entries.append(("■", EDGE, "held"))
    x, y = 0.03, 1 - 0.5 * _LEGEND / _HEIGHT
    for mark, colour, words in entries:
        figure.text(x, y, mark, color=colour, fontsize=11, ha="left", va="center")
        figure.text(x + 0.04, y, words, color=INK, fontsize=10, ha="left", va="center")
        x += 0.075 + 0.015 * len(words)
