"""Predicted readings at tool and links, healthy and with each seat open."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, Mismatch, Place, link_site
from loose_env.typing import Array

__all__ = ["SensedArm", "SensedPose"]


@dataclass(frozen=True, kw_only=True, eq=False)
class SensedPose:
    """Prediction for one pose and m excited joints at S sensors, the tool's first.

    All three axes of each sensor's frame are given; averages are over the band.
    """

    transmission: Array
    """Acceleration per joint acceleration, healthy (S, 3, m) [m or 1]."""
    slopes: Array
    """Change of it per unit error of each joint's zero, rigid (n, S, 3, m)."""
    bending: Array
    """Change of it by one standard deviation of each bending mode's stiffness (f, S, 3, m)."""
    column: Array
    """Change of the readings per seat acceleration at fixed joints (S, 3, n, A)."""
    driven: Array
    """The same for a seat that follows the force across it, per torque: ``driven @ u @ u`` over
    the apparent mass is what a seat floating along u adds (S, 3, n, A, A, m) [kg m/s²/(N·m)]."""
    rough: Array
    """Variance of ``column`` over the band, relative to its mean power (n,) [1]."""
    rest: Array
    """Covariance of the healthy motion out of step with the commands, per torque squared, of each
    excited joint: all axes of all sensors (3 S, 3 S, m)."""
    force: Array
    """Mean power of the force a shut seat transmits per torque, over its axes (n, m)."""
    mass: Array
    """Apparent mass at the seats (n, A, A) [kg]."""
    orientation: Array
    """Frame of each link's seat in the world: columns are its axes (n, 3, 3)."""
    turns: Array
    """Axis of each joint in the frame of each link's seat; zero if the joint slides (n, n, 3)."""


class SensedArm:
    """The nominal arm with accelerometers at its tool and on links.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    links : sequence of int
        Links that carry one.
    place : {"distal", "proximal"}
        Where; see `loose_env.arms.sites.link_site`.
    mismatch : Mismatch, optional
        Error of the stiffness of bending modes.

    Examples
    --------
    A seat shows at every sensor beyond it and at none before.

    >>> from loose_env.arms import planar
    >>> sensed = SensedArm(planar(3), links=(1, 2, 3))
    >>> at = sensed.at([0.1, 0.5, 0.9], [True, False, False])
    >>> np.linalg.norm(at.column[:, :, 1], axis=(1, 2)).round(1).tolist()
    [1.4, 0.0, 1.4, 1.4]
    """

    def __init__(
        self,
        arm: Arm,
        *,
        links: Sequence[int],
        place: Place = "distal",
        mismatch: Mismatch | None = None,
    ) -> None:
        self.arm = arm
        self.links = tuple(links)
        mismatch = mismatch or Mismatch()
        spec = arm.spec.copy()
        names = [arm.tool]
        for link in links:
            at = link_site(arm, link, place)
            names.append(f"accelerometer{link}")
            spec.body(at.body).add_site(name=names[-1], pos=list(at.position))
        self._linear = [
            LinearArm(dataclasses.replace(arm, spec=spec, tool=name, axes=(0, 1, 2)), remember=32)
            for name in names
        ]
        # A mode's frequency is off by its stiffness and by the mass it carries.
        spread = float(np.hypot(mismatch.stiffness, mismatch.mass))
        self._bent: list[list[LinearArm]] = []
        for joint in spec.joints:
            if joint.name not in arm.joints:
                changed = spec.copy()
                changed.joint(joint.name).stiffness = joint.stiffness * np.exp(spread)
                self._bent.append(
                    [
                        LinearArm(
                            dataclasses.replace(arm, spec=changed, tool=name, axes=(0, 1, 2)),
                            remember=32,
                        )
                        for name in names
                    ]
                )
        self._found: dict[tuple[bytes, tuple[bool, ...]], SensedPose] = {}

    def at(
        self, pose: Sequence[float] | Array, excited: Sequence[bool] | NDArray[np.bool_]
    ) -> SensedPose:
        """Predict for a pose [rad or m] (n,) and a set of excited joints (n,)."""
        q, mask = np.asarray(pose, dtype=float), tuple(bool(e) for e in excited)
        key = (q.tobytes(), mask)
        if key not in self._found:
            if len(self._found) >= 512:
                del self._found[next(iter(self._found))]
            self._found[key] = self._predict(q, mask)
        return self._found[key]

    def _transmission(self, linear: list[LinearArm], q: Array, mask: tuple[bool, ...]) -> Array:
        on = np.flatnonzero(mask)
        found = []
        for one in linear:
            answer = one.at(q).response(mask)
            joint = answer.joint[:, on].real.mean(0)
            found.append(np.linalg.solve(joint.T, answer.tool.real.mean(0).T).T)
        return np.array(found)

    def _predict(self, q: Array, mask: tuple[bool, ...]) -> SensedPose:
        on, axes = np.flatnonzero(mask), len(self.arm.axes)
        healthy = self._transmission(self._linear, q, mask)
        columns, driven, out_of_step, varied = [], [], [], []
        for one, b in zip(self._linear, healthy, strict=True):
            answer, opened = one.at(q).response(mask), one.at(q).open_response(mask)
            through = np.einsum("im,kmns->kins", b, opened.joint_open_slide)
            column = (opened.tool_open_slide - through)[..., :axes]
            force = -answer.slide[:, :, :axes]
            columns.append(column.real.mean(0))
            varied.append(np.mean(np.abs(column - columns[-1]) ** 2, axis=0))
            out_of_step.append(answer.tool - np.einsum("im,kmn->kin", b, answer.joint[:, on]))
            driven.append(np.einsum("kina,knbm->inabm", column, force).real / len(force))
        first = self._linear[0].at(q)
        answer, opened = first.response(mask), first.open_response(mask)
        tiny, slopes = 1e-4, []
        for k in range(self.arm.n):
            moved = q.copy()
            moved[k] += tiny
            slopes.append(
                [
                    (one.at(moved).kinematic - one.at(q).kinematic)[:, on] / tiny
                    for one in self._linear
                ]
            )
        beside = np.concatenate(out_of_step, axis=1)  # (K, 3 S, m)
        power = np.sum(np.square(columns), axis=(0, 1, 3))
        orientation, joint_axes = self._frames(q)
        bending = [self._transmission(bent, q, mask) - healthy for bent in self._bent]
        return SensedPose(
            transmission=healthy,
            slopes=np.array(slopes),
            bending=np.array(bending).reshape(-1, *healthy.shape),
            column=np.array(columns),
            driven=np.array(driven),
            rough=np.sum(varied, axis=(0, 1, 3)) / power,
            rest=np.einsum("kim,kjm->ijm", beside, beside.conj()).real / len(beside),
            force=np.mean(np.abs(answer.slide[:, :, :axes]) ** 2, axis=(0, 2)),
            mass=opened.mass_slide[..., :axes, :axes].real.mean(0),
            orientation=orientation,
            turns=np.einsum("kci,jc->kji", orientation, joint_axes),
        )

    def _frames(self, q: Array) -> tuple[Array, Array]:
        """Frames of the seats (n, 3, 3) and axes of the joints that turn (n, 3), in the world."""
        m = self.arm.model
        data = mujoco.MjData(m)
        data.qpos[self.arm.pose_addresses] = q
        mujoco.mj_kinematics(m, data)
        joints = [m.joint(name).id for name in self.arm.joints]
        turning = m.jnt_type[joints] == mujoco.mjtJoint.mjJNT_HINGE
        seats = np.array([data.body(b).xmat.reshape(3, 3) for b in self.arm.seat_bodies])
        return seats, np.where(turning[:, None], data.xaxis[joints], 0.0)
