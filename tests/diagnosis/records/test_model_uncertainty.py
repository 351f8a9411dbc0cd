"""What bending does to a change of transmission: VERA's first mode lies in its band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loose_env.arms import LinearArm, Mismatch, vera
from loose_env.diagnosis.records.model_uncertainty import stiffness_errors

BELOW = (8.0, 36.0)
POSE = np.array([0.3, 1.0])


def test_errors_of_springs_are_those_of_an_arm_with_other_springs() -> None:
    arm, one = vera(), np.array([True, False])
    pose, mismatch = POSE, Mismatch(stiffness=0.1, mass=0.0)
    errors = stiffness_errors(LinearArm(arm), pose, one, mismatch)
    assert errors.shape == (2, 2, 1)  # the bending mode, and the brake of joint 2
    found = []
    for factor in (1.1, 1 / 1.1):
        spec = arm.spec.copy()
        for joint in spec.joints:
            if joint.name not in arm.joints:
                joint.stiffness = joint.stiffness * factor
        answer = LinearArm(replace(arm, spec=spec)).at(pose).response(one)
        found.append(answer.tool.real.mean(axis=0) / answer.joint[:, :1].real.mean(axis=0))
    np.testing.assert_allclose(errors[0], (found[0] - found[1]) / 2, rtol=1e-6)
    assert np.abs(errors[1]).max() < 0.1 * np.abs(errors[0]).max()
