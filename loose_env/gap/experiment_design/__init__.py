"""Choice of motions on a servoed arm whose records tell candidate effects apart.

Data flow: servo_arm -> motions -> library -> candidates -> sizing -> signatures -> bank ->
inference.
"""

from loose_env.gap.experiment_design.bank import SignatureBank, signature_bank
from loose_env.gap.experiment_design.candidates import Ray, rays_of
from loose_env.gap.experiment_design.inference.belief import Belief
from loose_env.gap.experiment_design.inference.information import (
    Outlook,
    outlook,
    pair_gains,
)
from loose_env.gap.experiment_design.inference.local_models import LocalModels
from loose_env.gap.experiment_design.inference.posterior import (
    BeliefSettings,
    EffectEstimate,
    HypothesisSet,
    Posterior,
)
from loose_env.gap.experiment_design.library import (
    MotionCheck,
    battery,
    brief_library,
    check_motion,
    motion_library,
    scaled_to_fit,
)
from loose_env.gap.experiment_design.motions import Motion
from loose_env.gap.experiment_design.servo_arm import Sensing, ServoArm, read_servo_arm
from loose_env.gap.experiment_design.signatures import MotionSignatures
from loose_env.gap.experiment_design.sizing import BankSettings

__all__ = [
    "BankSettings",
    "Belief",
    "BeliefSettings",
    "EffectEstimate",
    "HypothesisSet",
    "LocalModels",
    "Motion",
    "MotionCheck",
    "MotionSignatures",
    "Outlook",
    "Posterior",
    "Ray",
    "Sensing",
    "ServoArm",
    "SignatureBank",
    "battery",
    "brief_library",
    "check_motion",
    "motion_library",
    "outlook",
    "pair_gains",
    "rays_of",
    "read_servo_arm",
    "scaled_to_fit",
    "signature_bank",
]
