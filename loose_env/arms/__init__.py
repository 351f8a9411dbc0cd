"""Arms to diagnose: what they are made of and how they answer in the ideal case."""

from loose_env.arms.arm import Arm, Holding, HoldKind
from loose_env.arms.planar import planar
from loose_env.arms.vera import vera

__all__ = ["Arm", "HoldKind", "Holding", "planar", "vera"]
