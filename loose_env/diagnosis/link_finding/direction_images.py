"""Tool-frame images of directions fixed in a link, for serial arms and many poses.

A slide loose at link i along z_l, fixed in the link, appears in the tool frame as R z_l, where R
takes link i's frame to the tool's (4.27, 4.28). Joints 1..i leave R alone; a hinge beyond link i
turns it about its own axis; a joint that slides never changes it. Play in a joint moves the tool
along that joint's own line instead: its column of the Jacobian.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array

__all__ = ["ToolFrames", "fault_locations", "predicted_images"]


def fault_locations(arm: Arm) -> tuple[str, ...]:
    """Fault hypotheses of an arm: a slide at each link, play in each joint.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> fault_locations(planar(2))[1:3]
    ('structural_looseness@link2', 'backlash@joint1')
    """
    numbers = range(1, arm.n + 1)
    return (
        *(f"structural_looseness@link{i}" for i in numbers),
        *(f"backlash@joint{i}" for i in numbers),
    )


class ToolFrames:
    """Rotations from every link to the tool, and every joint's line, as products of joint turns.

    The axes, anchors and frames are read once from MuJoCo with the arm at its reference; from
    there on each hinge turns what lies beyond it about its axis. Bending modes rest.

    Parameters
    ----------
    arm : Arm
        The nominal arm.

    Raises
    ------
    InvalidSetting
        If the tool senses fewer than two axes, or two axes of an arm that leaves their plane.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> seen = ToolFrames(planar(2)).images([0.3, np.pi / 2])[0] @ [1.0, 0.0]
    >>> seen.round(6).tolist()
    [[0.0, -1.0], [1.0, 0.0]]
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        model = arm.model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        ids = [model.joint(name).id for name in arm.joints]
        self.slides: NDArray[np.bool_] = np.array(
            [model.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE for i in ids]
        )
        """True for each prismatic joint (n,)."""
        self._reference = model.qpos0[arm.pose_addresses].copy()
        self._axis = data.xaxis[ids].copy()
        self._anchor = data.xanchor[ids].copy()
        self._links = np.array([data.body(b).xmat.reshape(3, 3) for b in arm.seat_bodies])
        self._tool = data.site(arm.tool).xmat.reshape(3, 3).copy()
        self._point = data.site(arm.tool).xpos.copy()
        self._seen = list(arm.axes)
        if self.dimension not in (2, 3):
            raise InvalidSetting(
                f"a direction is looked for in two or three axes, but the tool of {arm.name!r} "
                f"senses {self.dimension}"
            )
        if self.dimension == 2:
            rotation = self.images(np.vstack([self._reference, self._reference + 0.7]))
            if not np.allclose(np.swapaxes(rotation, -1, -2) @ rotation, np.eye(2), atol=1e-6):
                raise InvalidSetting(
                    f"the tool of {arm.name!r} senses axes {arm.axes} only, but its links turn out "
                    "of that plane; give it three axes"
                )

    @property
    def dimension(self) -> int:
        """Number of axes that the tool senses: 2 or 3."""
        return len(self._seen)

    def images(self, poses: ArrayLike) -> Array:
        """Rotation from each link's frame to the tool's, a product of joint turns (4.28, 4.29).

        Parameters
        ----------
        poses : array_like (P, n) or (n,)
            Joint positions [rad, or m where a joint slides].

        Returns
        -------
        ndarray (P, n, d, d)
            Row: tool axis; column: axis of the link frame.

        Raises
        ------
        InvalidData
            If a pose does not have one finite number for every joint.
        """
        turns = self._turns(self._poses(poses))
        beyond = np.broadcast_to(self._tool, turns[:, 0].shape)  # E_{k+1} .. E_n tool
        rotations = np.empty_like(turns)
        for k in reversed(range(self.arm.n)):
            rotations[:, k] = np.swapaxes(beyond, -1, -2) @ self._links[k]
            beyond = turns[:, k] @ beyond
        # A link frame is given in as many axes as the tool senses: x, y (, z).
        return rotations[:, :, self._seen, : self.dimension]

    def axes(self, poses: ArrayLike) -> Array:
        """Axis of each joint in the tool frame (P, n, 3), unit vectors (4.30)."""
        turns = self._turns(self._poses(poses))
        beyond = np.broadcast_to(self._tool, turns[:, 0].shape)
        found = np.empty(turns.shape[:3])
        for k in reversed(range(self.arm.n)):
            # A joint does not turn its own axis.
            found[:, k] = np.swapaxes(beyond, -1, -2) @ self._axis[k]
            beyond = turns[:, k] @ beyond
        return found

    def lines(self, poses: ArrayLike) -> Array:
        """Tool motion per motion of each joint, tool frame (P, n, d) [m, or 1 where it slides]."""
        poses = self._poses(poses)
        turns = self._turns(poses)
        # Walk from the tool to the base: the rotation and the tool's location beyond each joint,
        # in the reference's world axes.
        rotation = np.broadcast_to(self._tool, turns[:, 0].shape)
        point = np.broadcast_to(self._point, (len(poses), 3))
        columns = np.empty((len(poses), self.arm.n, 3))
        for k in reversed(range(self.arm.n)):
            axis, anchor = self._axis[k], self._anchor[k]
            if self.slides[k]:
                column = np.broadcast_to(axis, point.shape)
                point = point + (poses[:, k] - self._reference[k])[:, None] * axis
            else:
                column = np.cross(axis, point - anchor)
                point = np.einsum("pij,pj->pi", turns[:, k], point - anchor) + anchor
            columns[:, k] = np.einsum("pji,pj->pi", rotation, column)
            rotation = turns[:, k] @ rotation
        return columns[:, :, self._seen]

    def unit_lines(self, poses: ArrayLike) -> Array:
        """Direction of each joint's line (P, n, d); zero where the joint cannot move the tool."""
        lines = self.lines(poses)
        length = np.linalg.norm(lines, axis=-1, keepdims=True)
        useful = length > 1e-6 * max(self.arm.reach, 1e-6)
        return np.where(useful, lines / np.where(useful, length, 1.0), 0.0)

    def _poses(self, poses: ArrayLike) -> Array:
        rows = np.atleast_2d(np.asarray(poses, dtype=float))
        if rows.ndim != 2 or rows.shape[1] != self.arm.n or not np.isfinite(rows).all():
            raise InvalidData(
                f"poses of {self.arm.name!r} are rows of {self.arm.n} finite numbers, got shape "
                f"{np.shape(poses)}"
            )
        return rows

    def _turns(self, poses: Array) -> Array:
        """Rotation by each joint about its axis at the reference (P, n, 3, 3)."""
        angle = np.where(self.slides, 0.0, poses - self._reference)
        x, y, z = self._axis.T
        zero = np.zeros_like(x)
        skew = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
        sine, versine = np.sin(angle)[..., None, None], (1 - np.cos(angle))[..., None, None]
        return np.asarray(np.eye(3) + sine * skew + versine * (skew @ skew))


def predicted_images(
    frames: ToolFrames, pose_before: ArrayLike, pose_after: ArrayLike, direction: ArrayLike
) -> Array:
    """Direction that each hypothesis expects after a move (4.27).

    A slide at link k carries the direction seen before along with the joints beyond k; play in
    joint j shows the joint's own line, whatever was seen.

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    pose_before, pose_after : array_like (n,)
        Poses.
    direction : array_like (d,)
        Direction seen in the pose before, tool frame; its sign and length do not matter.

    Returns
    -------
    ndarray (2 n, d)
        Unit vectors (axial), in the order of `fault_locations`; zero for a joint that
        cannot move the tool.

    Raises
    ------
    InvalidData
        If the direction does not fit the tool's axes or has no length.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> after = predicted_images(ToolFrames(planar(2)), [0, 0], [0, np.pi / 2], [1.0, 0.0])
    >>> after[:2].round(6).tolist()  # the slide at link 1 is seen turned, that at link 2 is not
    [[0.0, -1.0], [1.0, 0.0]]
    """
    p = np.asarray(direction, dtype=float)
    if p.shape != (frames.dimension,) or not np.isfinite(p).all() or not np.any(p):
        raise InvalidData(
            f"a direction has {frames.dimension} finite numbers, not all zero; got {direction!r}"
        )
    before, after = frames.images(np.vstack([pose_before, pose_after]))
    carried = after @ np.swapaxes(before, -1, -2) @ (p / np.linalg.norm(p))
    return np.vstack([carried, frames.unit_lines(pose_after)[0]])
