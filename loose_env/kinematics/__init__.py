"""Kinematics and statics of a serial arm: chain, Jacobian, seat loads, pose choice.

Data flow: chain -> seat_loads -> pose_choice.
"""

from loose_env.kinematics.chain import Chain, Frame, JointKind, geometric_jacobian, require_kind
from loose_env.kinematics.pose_choice import chebyshev_poses, choose_poses, worst_push
from loose_env.kinematics.seat_loads import carried_bodies, reactions, wrench_rank

__all__ = [
    "Chain",
    "Frame",
    "JointKind",
    "carried_bodies",
    "chebyshev_poses",
    "choose_poses",
    "geometric_jacobian",
    "reactions",
    "require_kind",
    "worst_push",
    "wrench_rank",
]
