"""Kinematics and statics of a serial arm: chain, Jacobian, joint loads, pose choice.

Data flow: chain -> jacobian -> joint_loads -> manipulability -> seat_loads -> pose_choice.
"""

from loose_env.kinematics.chain import (
    Chain,
    JointKind,
    require_kind,
)
from loose_env.kinematics.jacobian import (
    Frame,
    changed_columns,
    geometric_jacobian,
    link_of_changed_columns,
)
from loose_env.kinematics.joint_loads import (
    JointLoads,
    PeakForce,
    TwoLinks,
    arm_loads,
    peak_force,
    two_link_loads,
)
from loose_env.kinematics.manipulability import (
    axis_difference_deg,
    direction_deg,
    ellipsoid,
    rotation_line,
    submanipulator,
)
from loose_env.kinematics.pose_choice import (
    Drive,
    chebyshev_poses,
    choose_poses,
    seat_drive,
    worst_push,
)
from loose_env.kinematics.seat_loads import (
    reactions,
    reciprocal_product,
    wrench_rank,
)

__all__ = [
    "Chain",
    "Drive",
    "Frame",
    "JointKind",
    "JointLoads",
    "PeakForce",
    "TwoLinks",
    "arm_loads",
    "axis_difference_deg",
    "changed_columns",
    "chebyshev_poses",
    "choose_poses",
    "direction_deg",
    "ellipsoid",
    "geometric_jacobian",
    "link_of_changed_columns",
    "peak_force",
    "reactions",
    "reciprocal_product",
    "require_kind",
    "rotation_line",
    "seat_drive",
    "submanipulator",
    "two_link_loads",
    "worst_push",
    "wrench_rank",
]
