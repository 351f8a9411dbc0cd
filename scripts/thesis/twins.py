"""Pairs of a loose arm and its healthy twin, for what the thesis recommends for later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.arms import Arm, LinearArm
from loose_env.diagnosis import statistics_of
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Fault, Healthy
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.typing import Array
from scripts.thesis.loose_joint import placed

DURATION = 1.2
"""Length of a record [s], as in the thesis."""
Pair = tuple[Measurement, Measurement]
"""Record of the loose arm and of its healthy twin."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Twins:
    """Loose arms, each with its mismatch, fault and pose, and a healthy twin of each."""

    linear: LinearArm
    rig: SimulatedRig
    faults: Sequence[Fault]
    poses: Sequence[Array]

    @classmethod
    def draw(
        cls,
        arm: Arm,
        count: int,
        seed: Sequence[int],
        *,
        place: str = "structural_looseness@link",
        difficulty: Difficulty | None = None,
        sensors: SensorSuite | None = None,
    ) -> Twins:
        """Draw arms; the loose links or joints take turns."""
        hard, linear = Difficulty() if difficulty is None else difficulty, LinearArm(arm)
        sampler, faults, poses = FaultSampler(linear, hard), [], []
        rig = SimulatedRig(arm, slots=2 * count, sensors=sensors or SensorSuite())
        for k in range(count):
            rng = np.random.default_rng([*seed, k])
            faults.append(sampler.draw(rng, hypothesis=f"{place}{1 + k % arm.n}"))
            mismatch = hard.mismatch.draw(arm, rng)
            rig.mount(2 * k, faults[-1], mismatch)
            rig.mount(2 * k + 1, Healthy(), mismatch)
            poses.append(arm.random_pose(rng))
        return cls(linear=linear, rig=rig, faults=faults, poses=poses)

    def one_joint(
        self, joint: int, level: float, *, duration: float = DURATION
    ) -> list[Excitation]:
        """Excitation of one joint (from 0) in each arm, by the rms of the nominal tool [m/s²]."""
        levels = np.where(np.arange(self.linear.arm.n) == joint, level, 0.0)
        return [at_levels(self.linear.at(q), levels, duration=duration)[0] for q in self.poses]

    def measure(self, shakes: Sequence[Excitation], seed: Sequence[int]) -> list[Pair | None]:
        """Measure every pair; None where a record failed. Draws are ``[*seed, arm, twin]``."""
        jobs = [
            Job(
                slot=2 * k + twin,
                pose=pose,
                excitation=shake,
                rng=np.random.default_rng([*seed, k, twin]),
            )
            for k, (pose, shake) in enumerate(zip(self.poses, shakes, strict=True))
            for twin in (0, 1)
        ]
        found = self.rig.measure_many(jobs)
        pairs = zip(found[::2], found[1::2], strict=True)
        return [None if a.failure or b.failure else (a, b) for a, b in pairs]

    def slide(self, k: int) -> Array:
        """Direction of an arm's slide in the nominal tool's axes, unit vector (d,)."""
        arm, fault = self.linear.arm, self.faults[k]
        data = placed(arm, self.poses[k])
        link = data.body(arm.seat_bodies[fault.link - 1]).xmat.reshape(3, 3)  # type: ignore[union-attr]
        tool = data.site(arm.tool).xmat.reshape(3, 3)
        seen = (tool.T @ link @ np.array(fault.direction))[list(arm.axes)]  # type: ignore[union-attr]
        return np.asarray(seen / np.linalg.norm(seen))


def change_of(pair: Pair, joint: int) -> Array:
    """Change of the tool's transmission from an excited joint (from 0) to the healthy twin (d,)."""
    loose, healthy = (statistics_of(m).transmission_by_instrument[:, joint] for m in pair)
    return np.asarray(loose - healthy)


def angle_deg(one: Array, other: Array) -> float:
    """Angle between two axes [deg], 0 to 90."""
    cosine = abs(float(one @ other)) / float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.degrees(np.arccos(min(cosine, 1.0))))
