"""What of an arm a fault leaves loose, for the pictures."""

from __future__ import annotations

from loose_env.faults import CompoundLooseness, Fault, RotationalLooseness, StructuralLooseness

__all__ = ["loose_link_of"]


def loose_link_of(fault: Fault | None) -> int | None:
    """Return the number of the link that is loose on its flange; None where none is.

    Examples
    --------
    >>> from loose_env.faults import Backlash
    >>> loose_link_of(Backlash(joint=1, gap=1e-3, stiffness=(1e4, 1e4))) is None
    True
    """
    kinds = StructuralLooseness, RotationalLooseness, CompoundLooseness
    return fault.link if isinstance(fault, kinds) else None
