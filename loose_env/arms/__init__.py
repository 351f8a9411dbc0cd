"""Arms to diagnose: what they are made of and how they answer in the ideal case."""

from loose_env.arms.arm import Arm, Holding, HoldKind
from loose_env.arms.cylindrical import cylindrical
from loose_env.arms.from_file import DESK_ARM, FileReport, arm_from_file, describe_file
from loose_env.arms.planar import planar
from loose_env.arms.scara import scara
from loose_env.arms.six_axis import six_axis
from loose_env.arms.slide import slide_rig
from loose_env.arms.vera import vera
from loose_env.arms.vera_shaken import shaken_vera

__all__ = [
    "DESK_ARM",
    "Arm",
    "FileReport",
    "HoldKind",
    "Holding",
    "arm_from_file",
    "cylindrical",
    "describe_file",
    "planar",
    "scara",
    "shaken_vera",
    "six_axis",
    "slide_rig",
    "vera",
]
