"""Colours of the pictures: few, and told apart by colour-blind eyes."""

from __future__ import annotations

__all__ = ["BODY", "EDGE", "FAINT", "INK", "MEASURED", "MUTED", "PAPER", "SHAKEN", "TRUTH"]

PAPER = "#ffffff"
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
SHAKEN = "#f0a30a"
"""Joints that are shaken."""
MEASURED = "#0072b2"
"""What the record says."""
TRUTH = "#d0451b"
"""The hidden fault, once it may be shown."""
