"""The drive of seats in the linear arm, and chosen pose sets that beat random ones."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, planar, vera
from loose_env.kinematics import chebyshev_poses, choose_poses, reactions, worst_push
from loose_env.thesis.ch4_diagnosis.pose_trials import seat_drive


@pytest.mark.parametrize(("arm", "count"), [(vera(), 15), (planar(4), 5)], ids=["vera", "planar4"])
def test_chosen_poses_drive_the_worst_seat_harder_than_random_ones(arm: Arm, count: int) -> None:
    rng = np.random.default_rng(3)
    linear = LinearArm(arm, points=48)
    poses = chebyshev_poses(arm, count)
    scores = np.array([worst_push(arm, q) for q in poses])
    chosen = poses[choose_poses(poses, scores, 4, difference="sine")]

    def drive(q: np.ndarray) -> float:
        return min(seat_drive(linear, q, k, per="tool")[0] for k in range(1, arm.n + 1))

    drawn = np.array([drive(arm.random_pose(rng)) for _ in range(60)])
    sets = drawn[rng.integers(0, 60, (500, 4))].mean(axis=1)
    mine = np.mean([drive(q) for q in chosen])
    assert mine > 1.15 * drawn.mean()
    assert (sets < mine).mean() > 0.8


def test_a_stiff_arm_passes_on_what_the_rigid_one_does() -> None:
    """Far below the brakes' modes the linear arm's seat force is the rigid push per torque."""
    arm, pose = planar(3), [0.3, 0.8, -0.6]
    linear = LinearArm(arm)
    push = reactions(arm, pose).per_torque[1, :2]
    worst, whole = seat_drive(linear, pose, 2)
    assert whole == pytest.approx(np.linalg.norm(push), rel=0.06)
    assert worst == pytest.approx(np.linalg.svd(push, compute_uv=False)[-1], rel=0.06)
