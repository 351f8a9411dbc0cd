"""Colours of the pictures: few, and told apart by colour-blind eyes."""

from __future__ import annotations

__all__ = [
    "BODY",
    "CAP",
    "EDGE",
    "FAINT",
    "HELD_CAP",
    "INK",
    "MEASURED",
    "MUTED",
    "ON_SHAKEN",
    "PAPER",
    "SHADOW",
    "SHAKEN",
    "TRUTH",
]

PAPER = "#ffffff"
"""Background, and letters on dark parts."""
INK = "#1b2128"
"""Text, and everything dark."""
MUTED = "#66717d"
"""Second-rank text, and what the healthy arm would show."""
FAINT = "#c9d0d7"
"""Guides in the background."""
BODY = "#d5dde4"
"""Links."""
EDGE = "#46525e"
"""Outline of links and joints."""
CAP = "#eef1f4"
"""Lit ends of joints at rest."""
HELD_CAP = "#5d6a77"
"""Lit ends of held joints."""
SHADOW = "#e4e8ec"
"""Shadow of the arm on the floor."""
SHAKEN = "#f0a30a"
"""Joints that are shaken."""
ON_SHAKEN = "#16191d"
"""Letters on shaken joints; they stay dark on a dark page."""
MEASURED = "#0072b2"
"""Values from the record."""
TRUTH = "#d0451b"
"""The hidden fault, once it may be shown."""
