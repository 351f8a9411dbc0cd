"""The looseness joint that the thesis built once and mounted on both of its rigs (6.1.5)."""

from __future__ import annotations

from loose_env.faults import Preload, StructuralLooseness

__all__ = ["finger_tight", "loosened"]

Direction = tuple[float, float, float]


def loosened(*, link: int, direction: Direction) -> StructuralLooseness:
    """Return the joint with its stops turned back by a quarter turn: 0.2 mm of travel (6.3.3).

    Travel is the thesis's. It runs on linear bushings of low friction between steel stops whose
    stiffness differs; those figures are estimates, the same on both rigs.

    Examples
    --------
    >>> loosened(link=2, direction=(1.0, 0.0, 0.0)).gap
    0.0002
    """
    return StructuralLooseness(
        link=link,
        direction=direction,
        gap=2e-4,
        stiffness=(4e6, 2.4e6),
        damping=(1600.0, 960.0),
        friction=0.3,
    )


def finger_tight(*, link: int, direction: Direction) -> Preload:
    """Return the joint with its stops finger-tight: stiff, but not as a solid part.

    Examples
    --------
    >>> finger_tight(link=2, direction=(1.0, 0.0, 0.0)).kind
    'healthy'
    """
    return Preload(link=link, direction=direction, stiffness=5e7, damping=2e3)
