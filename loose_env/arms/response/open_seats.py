"""Response of an arm through its seats, were they open."""

from __future__ import annotations

from dataclasses import dataclass

from loose_env.typing import ComplexArray

__all__ = ["OpenResponse"]


@dataclass(frozen=True, kw_only=True)
class OpenResponse:
    """Response of the arm through each of its seats, were it open, over the band."""

    tool_open_slide: ComplexArray
    """Change of tool acceleration per unit seat acceleration, (K, d, n links, s axes)."""
    joint_open_slide: ComplexArray
    """Change of excited joint acceleration per unit seat acceleration, (K, m, n, s)."""
    mass_slide: ComplexArray
    """Apparent mass seen by the seats' slides [kg], (K, n, s, s)."""
    tool_open_hinge: ComplexArray
    """As `tool_open_slide`, for play in a joint, (K, d, n)."""
    joint_open_hinge: ComplexArray
    """As `joint_open_slide`, for play in a joint, (K, m, n)."""
    inertia_hinge: ComplexArray
    """Apparent inertia seen by the joints' link sides [kg·m², kg where it slides], (K, n)."""
    tool_open_twist: ComplexArray | None = None
    """As `tool_open_slide`, for slides and rotations of links, (K, d, n, t); None without."""
    joint_open_twist: ComplexArray | None = None
    """As `joint_open_slide`, for slides and rotations of links, (K, m, n, t); None without."""
    mass_twist: ComplexArray | None = None
    """Apparent mass of slides and rotations of links [kg, kg·m, kg·m²], (K, n, t, t)."""
