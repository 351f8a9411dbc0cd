"""Directions of looseness: rotations from links to the tool, lines of joints, axial densities."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import i0e

from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.faults import hypotheses
from loose_env.typing import Array

# Polar angles, equally weighted in their logarithm: the peak may be as narrow as a microradian.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(96)
_LOG_LOW, _LOG_HIGH = np.log(1e-7), np.log(np.pi / 2)
_POLAR = np.exp(0.5 * (_LOG_HIGH - _LOG_LOW) * (_NODES + 1) + _LOG_LOW)
_SHARE = 0.5 * (_LOG_HIGH - _LOG_LOW) * _WEIGHTS * _POLAR * np.sin(_POLAR)


def log_mean_bingham(matrix: ArrayLike) -> Array:
    """Logarithm of the mean of exp(-m' A m / 2) over all unit vectors m.

    Parameters
    ----------
    matrix : array_like (..., d, d)
        Symmetric, positive semidefinite A; d = 2 or 3.

    Returns
    -------
    ndarray (...)
        Logarithm of the mean; 0 for A = 0.

    References
    ----------
    Mardia and Jupp, Directional Statistics, section 9.4. In the plane it is a Bessel function;
    in space one angle is integrated in closed form and the other by Gauss-Legendre quadrature.

    Examples
    --------
    >>> log_mean_bingham(np.zeros((3, 3))).round(6).tolist()
    0.0
    >>> log_mean_bingham(np.diag([0.0, 200.0])).round(4).tolist()  # a narrow Gaussian, twice
    -2.8724
    """
    values = np.linalg.eigvalsh(np.asarray(matrix, dtype=float))
    low = values[..., 0]
    rest = values[..., 1:] - low[..., None]
    if rest.shape[-1] == 1:
        return np.asarray(np.log(i0e(rest[..., 0] / 4)) - low / 2)
    second, third = rest[..., 0, None], rest[..., 1, None]
    square = np.sin(_POLAR) ** 2
    # About the axis of the smallest eigenvalue; i0e carries exp(-|x|) of the azimuth's integral.
    integrand = np.exp(-0.5 * second * square) * i0e(0.25 * (third - second) * square)
    return np.asarray(np.log(integrand @ _SHARE) - low / 2)


def fault_locations(arm: Arm) -> tuple[str, ...]:
    """Fault hypotheses of an arm: a slide at each link, play in each joint.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> fault_locations(planar(2))[1:3]
    ('structural_looseness@link2', 'backlash@joint1')
    """
    return hypotheses(arm, everywhere=True)[1:]


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
        """Rotation from the frame of each link to the tool's in some poses (4.28, 4.29).

        A product of joint turns, for poses (P, n) of shape (P, n, d, d), in as many axes as the
        tool senses: row, tool axis; column, axis of the link.
        """
        # A link frame is given in as many axes as the tool senses: x, y (, z).
        rotations = self._beyond(self._turns(self._poses(poses))).mT @ self._links
        return np.asarray(rotations[:, :, self._seen, : self.dimension])

    def axes(self, poses: ArrayLike) -> Array:
        """Axis of each joint in the tool frame (P, n, 3), unit vectors (4.30)."""
        # A joint does not turn its own axis.
        turned = self._beyond(self._turns(self._poses(poses)))
        return np.asarray(np.einsum("pkji,kj->pki", turned, self._axis))

    def lines(self, poses: ArrayLike) -> Array:
        """Tool motion per motion of each joint, tool frame (P, n, d) [m, or 1 where it slides]."""
        poses = self._poses(poses)
        turns = self._turns(poses)
        # Walk from the tool to the base: the tool's location beyond each joint, in the reference's
        # world axes.
        point = np.broadcast_to(self._point, (len(poses), 3))
        columns = np.empty((len(poses), self.arm.n, 3))
        for k in reversed(range(self.arm.n)):
            axis, anchor = self._axis[k], self._anchor[k]
            if self.slides[k]:
                columns[:, k] = axis
                point = point + (poses[:, k] - self._reference[k])[:, None] * axis
            else:
                columns[:, k] = np.cross(axis, point - anchor)
                point = np.einsum("pij,pj->pi", turns[:, k], point - anchor) + anchor
        return np.asarray(
            np.einsum("pkji,pkj->pki", self._beyond(turns), columns)[:, :, self._seen]
        )

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

    def _beyond(self, turns: Array) -> Array:
        """Rotation of the tool by all joints beyond each one (P, n, 3, 3)."""
        found = np.empty_like(turns)
        beyond = np.broadcast_to(self._tool, turns[:, 0].shape)
        for k in reversed(range(self.arm.n)):
            found[:, k] = beyond
            beyond = turns[:, k] @ beyond
        return found

    def _turns(self, poses: Array) -> Array:
        """Rotation by each joint about its axis at the reference (P, n, 3, 3)."""
        angle = np.where(self.slides, 0.0, poses - self._reference)
        x, y, z = self._axis.T
        zero = np.zeros_like(x)
        skew = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
        sine, versine = np.sin(angle)[..., None, None], (1 - np.cos(angle))[..., None, None]
        return np.asarray(np.eye(3) + sine * skew + versine * (skew @ skew))
