"""Rigs of the thesis: the cylindrical arm, the slide, VERA on its shaker.

Data flow: cylindrical -> shaken_vera -> slide.
"""

from loose_env.thesis.rigs.cylindrical import cylindrical
from loose_env.thesis.rigs.shaken_vera import shaken_vera
from loose_env.thesis.rigs.slide import slide_rig

__all__ = ["cylindrical", "shaken_vera", "slide_rig"]
