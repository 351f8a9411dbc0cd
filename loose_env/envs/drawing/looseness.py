"""What of an arm a fault leaves loose, for the pictures."""

from __future__ import annotations

from loose_env.faults import Fault, RotationalLooseness, StructuralLooseness, parts_of

__all__ = ["loose_links_of"]


def loose_links_of(fault: Fault | None) -> frozenset[int]:
    """Return the numbers of the links that are loose on their flanges.

    Examples
    --------
    >>> from loose_env.faults import Backlash
    >>> sorted(loose_links_of(Backlash(joint=1, gap=1e-3, stiffness=(1e4, 1e4))))
    []
    """
    parts = () if fault is None else parts_of(fault)
    kinds = StructuralLooseness, RotationalLooseness
    return frozenset(part.link for part in parts if isinstance(part, kinds))
