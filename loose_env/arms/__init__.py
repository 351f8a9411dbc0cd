"""Arms to diagnose: what they are made of and how they answer in the ideal case."""

from loose_env.arms.arm import Arm, Holding, HoldKind
from loose_env.arms.files.load import DESK_ARM, FileReport, arm_from_file, describe_file
from loose_env.arms.holding.compliance import servoed, with_compliance
from loose_env.arms.library.planar import planar
from loose_env.arms.library.puma560 import six_axis
from loose_env.arms.library.scara import scara
from loose_env.arms.library.vera import vera

__all__ = [
    "DESK_ARM",
    "Arm",
    "FileReport",
    "HoldKind",
    "Holding",
    "arm_from_file",
    "describe_file",
    "planar",
    "scara",
    "servoed",
    "six_axis",
    "vera",
    "with_compliance",
]
