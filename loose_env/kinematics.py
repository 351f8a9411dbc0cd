"""Kinematics of serial chains: Jacobian, loads on seats, Chebyshev poses, choice of poses."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm, limits_of
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.typing import Array

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

JointKind = Literal["revolute", "prismatic"]
Frame = Literal["tool", "world", "base"]
"""Point and axes of a Jacobian: tool point in tool axes, tool point in world axes, or the point
of the tool's body that lies on the world's origin, in world axes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Joints of a serial arm in one pose, in world coordinates, base first."""

    kinds: tuple[JointKind, ...]
    """Kind of each joint (n,)."""
    axes: Array
    """Unit vector of each joint's axis (n, 3)."""
    anchors: Array
    """A point of each joint's axis [m] (n, 3)."""
    tool: Array
    """Tool point [m] (3,)."""
    tool_axes: Array
    """Rotation from the tool frame to the world (3, 3)."""

    def __post_init__(self) -> None:
        n = len(self.kinds)
        shapes = {"axes": (n, 3), "anchors": (n, 3), "tool": (3,), "tool_axes": (3, 3)}
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise InvalidData(
                    f"{name} of a chain of {n} joints must be finite and of shape {shape}, "
                    f"got shape {value.shape}"
                )
            object.__setattr__(self, name, value)
        for kind in self.kinds:
            require_kind(kind)
        if n and np.abs(np.linalg.norm(self.axes, axis=1) - 1).max() > 1e-6:
            raise InvalidData("axes of a chain must be unit vectors; divide each by its length")
        if np.abs(self.tool_axes.T @ self.tool_axes - np.eye(3)).max() > 1e-6:
            raise InvalidData("tool_axes must be a rotation matrix, its columns the tool's axes")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.kinds)

    @classmethod
    def of(cls, arm: Arm, pose: ArrayLike) -> Chain:
        """Extract the joints of an arm at a pose [rad] (n,) from its MuJoCo model.

        The tool's position is a function of pose and parameters (3.1). Bending modes of the arm
        stay at rest and are no joints of the chain.

        Raises
        ------
        InvalidSetting
            If the pose does not have one finite number for every joint.

        Examples
        --------
        >>> from loose_env.arms import planar
        >>> float(Chain.of(planar(2), [0.0, 0.0]).tool[0])
        0.6
        """
        q = arm.checked_pose(pose)
        data = mujoco.MjData(arm.model)
        data.qpos[arm.pose_addresses] = q
        mujoco.mj_kinematics(arm.model, data)
        joints = [arm.model.joint(name) for name in arm.joints]
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        site = data.site(arm.tool)
        return cls(
            kinds=tuple("prismatic" if j.type[0] == slide else "revolute" for j in joints),
            axes=np.array([data.xaxis[j.id] for j in joints]),
            anchors=np.array([data.xanchor[j.id] for j in joints]),
            tool=site.xpos.copy(),
            tool_axes=site.xmat.reshape(3, 3).copy(),
        )


def require_kind(kind: str) -> None:
    """Reject an unknown kind of joint.

    Raises
    ------
    UnknownName
        If the kind is neither "revolute" nor "prismatic".
    """
    if kind not in ("revolute", "prismatic"):
        raise UnknownName(f"a joint is 'revolute' or 'prismatic', got {kind!r}")


def geometric_jacobian(chain: Chain, frame: Frame = "world") -> Array:
    """Columns of the Jacobian, linear part above angular part (3.2, 3.28, 3.29, 3.32).

    A revolute joint gives z × (p - o) and z (3.54), a prismatic one z and nothing (3.55). The
    thesis prints the whole column only in the revolute form.

    Parameters
    ----------
    chain : Chain
        Joints and tool.
    frame : {"world", "tool", "base"}
        Tool point in world axes; tool point in tool axes; or the twist at the world's origin.

    Returns
    -------
    ndarray (6, n)
        Rows 0 to 2 [m/s per rad/s, or 1 for a prismatic joint], rows 3 to 5 [1].

    Raises
    ------
    UnknownName
        If there is no such frame.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> geometric_jacobian(Chain.of(planar(2), [0.0, 0.0]))[1]
    array([0.6, 0.3])
    """
    if frame not in ("world", "tool", "base"):
        raise UnknownName(f"unknown frame {frame!r}: 'world', 'tool' or 'base'")
    point = np.zeros(3) if frame == "base" else chain.tool
    turning = np.array([k == "revolute" for k in chain.kinds])[:, None]
    linear = np.where(turning, np.cross(chain.axes, point - chain.anchors), chain.axes)
    angular = np.where(turning, chain.axes, 0.0)
    if frame == "tool":
        linear, angular = linear @ chain.tool_axes, angular @ chain.tool_axes
    return np.vstack([linear.T, angular.T])


@dataclass(frozen=True, kw_only=True, eq=False)
class Reactions:
    """Reactions at the seats from rest, without gravity (4.2.3); force then moment."""

    wrench: Array
    """On what a link carries, itself included, per joint acceleration, in the link's axes
    [N and N m per rad/s²] (n links, 6, n joints)."""
    distal: Array
    """Inertia matrix of links j to n alone [kg m²] (n links, n joints, n joints)."""
    inertia: Array
    """Inertia matrix of the arm, rotors included [kg m²] (n joints, n joints)."""

    @property
    def accelerations(self) -> Array:
        """Joint accelerations per torque at each joint in turn, the others braked (n, n)."""
        return np.diag(1 / np.diag(self.inertia))

    @property
    def per_torque(self) -> Array:
        """Wrench at each seat per torque at each joint, others braked (n links, 6, n joints)."""
        return np.asarray(self.wrench @ self.accelerations)

    @property
    def per_energy(self) -> Array:
        """Wrench at each seat per root energy of links j to n, others braked.

        Impulses instead of steady torques: an impulsive torque at joint i gives links j to n
        the energy T and the momentum p. The property is p / √(2T) (n links, 6, n joints) [√kg for
        forces]. No force exceeds the root of the mass that link j carries, its own included.
        """
        motion = self.accelerations
        energy = np.einsum("ai,jab,bi->ji", motion, self.distal, motion)
        # A joint that leaves links j to n at rest neither pushes them nor gives them energy.
        scale = np.where(energy > 0, np.sqrt(np.where(energy > 0, energy, 1.0)), np.inf)
        return np.asarray((self.wrench @ motion) / scale[:, None, :])


def reactions(arm: Arm, pose: ArrayLike) -> Reactions:
    """Compute the load on every seat from every joint in a pose (4.2.3).

    Moments are about the seat, the bolted connection at the link's proximal end.

    Parameters
    ----------
    arm : Arm
        The arm; bending modes at rest.
    pose : array (n,)
        Joint positions [rad].

    Raises
    ------
    InvalidSetting
        If the pose does not have one finite number for every joint.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> reactions(planar(2), [0.0, 0.5]).per_torque.shape
    (2, 6, 2)
    """
    q = arm.checked_pose(pose)
    model, n = arm.model, arm.n
    data = mujoco.MjData(model)
    data.qpos[arm.pose_addresses] = q
    mujoco.mj_forward(model, data)
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints]
    momentum, turning = np.zeros((model.nbody, 3, n)), np.zeros((model.nbody, 3, n))
    inertias = np.zeros((model.nbody, n, n))
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for body in range(1, model.nbody):
        mujoco.mj_jacBodyCom(model, data, linear, angular, body)
        axes = data.ximat[body].reshape(3, 3)
        v, w = linear[:, dofs], angular[:, dofs]
        momentum[body] = model.body_mass[body] * v
        turning[body] = (axes * model.body_inertia[body]) @ axes.T @ w
        inertias[body] = v.T @ momentum[body] + w.T @ turning[body]
    wrench, distal = np.zeros((n, 6, n)), np.zeros((n, n, n))
    for k, name in enumerate(arm.seat_bodies):
        seat = model.body(name).id
        carried = carried_bodies(model, seat)
        arms = data.xipos[carried] - data.xpos[seat]
        force = momentum[carried].sum(axis=0)
        moment = (turning[carried] + np.cross(arms[:, :, None], momentum[carried], axis=1)).sum(0)
        frame = data.xmat[seat].reshape(3, 3)
        wrench[k] = np.vstack([frame.T @ force, frame.T @ moment])
        distal[k] = inertias[carried].sum(axis=0)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return Reactions(wrench=wrench, distal=distal, inertia=full[np.ix_(dofs, dofs)])


def wrench_rank(wrenches: ArrayLike, *, tolerance: float = 1e-6) -> tuple[int, Array]:
    """Number of independent wrenches, and their singular values (4.2.3).

    Parameters
    ----------
    wrenches : array (r, m)
        Components of m wrenches that matter, in columns.
    tolerance : float
        A singular value below this share of the largest counts as zero.

    Returns
    -------
    tuple of int and ndarray (r,)
        The last value is the push in the direction least pushed.

    Examples
    --------
    >>> wrench_rank([[1.0, 2.0], [0.0, 0.0]])[0]
    1
    """
    w = np.asarray(wrenches, dtype=float)
    if w.ndim != 2 or 0 in w.shape or not np.isfinite(w).all():
        raise InvalidData(f"wrenches are (r, m) and finite, got shape {w.shape}")
    if not 0 <= tolerance < 1:
        raise InvalidSetting(f"tolerance is a share from 0 up to 1, got {tolerance!r}")
    values = np.zeros(w.shape[0])
    found = np.linalg.svd(w, compute_uv=False)
    values[: len(found)] = found
    return int(np.sum(values > tolerance * values[0])), values


def carried_bodies(model: mujoco.MjModel, body: int) -> NDArray[np.bool_]:
    """Mask of the bodies in the subtree of a body, itself included (nbody,).

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> model = planar(2).model
    >>> [model.body(b).name for b in np.flatnonzero(carried_bodies(model, model.body("link1").id))]
    ['link1', 'flange2', 'link2']
    """
    carried = np.zeros(model.nbody, dtype=bool)
    carried[body] = True
    for b in range(body + 1, model.nbody):  # parents come before their children
        carried[b] = carried[model.body_parentid[b]]
    return carried


MOST_POSES = 50_000


def worst_push(
    arm: Arm, pose: ArrayLike, link: int | None = None, *, normalised: bool = True
) -> float:
    """Minimum over directions of the load that the joints exert on a link's seat (4.2.3).

    Parameters
    ----------
    arm, pose
        As `reactions`.
    link : int, optional
        Link of interest, from 1; by default the link that fares worst.
    normalised : bool
        Per root of the energy of the links beyond the seat [√kg]; else per torque [1/m].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> round(worst_push(planar(2), [0.3, 0.0]), 9)  # straight: no push along the arm
    0.0
    """
    found = reactions(arm, pose)
    push = found.per_energy if normalised else found.per_torque
    links = range(arm.n) if link is None else (arm.link_number(link) - 1,)
    return min(float(wrench_rank(push[k, list(arm.axes)])[1][-1]) for k in links)


def chebyshev_nodes(low: float, high: float, count: int) -> Array:
    """Chebyshev points of an interval, from low to high (4.2.3).

    They are the zeros of the Chebyshev polynomial of degree ``count``, closer at the ends.

    Examples
    --------
    >>> chebyshev_nodes(0.0, 1.0, 2).round(4)
    array([0.1464, 0.8536])
    """
    if not (np.isfinite([low, high]).all() and low < high):
        raise InvalidSetting(f"an interval runs from low to high, got {low!r} to {high!r}")
    if isinstance(count, bool) or count < 1 or int(count) != count:
        raise InvalidSetting(f"the number of points is a whole number from 1, got {count!r}")
    k = np.arange(count)
    nodes = -np.cos((2 * k + 1) * np.pi / (2 * count))
    return np.asarray((low + high) / 2 + (high - low) / 2 * nodes)


def chebyshev_poses(arm: Arm, count: int) -> Array:
    """Poses on the Chebyshev nodes of every joint's range (4.2.3).

    Parameters
    ----------
    arm : Arm
        The arm; joints that turn without end span -π to π.
    count : int
        Points a joint.

    Returns
    -------
    ndarray (count**n, n)
        Poses [rad].

    Raises
    ------
    InvalidSetting
        If there would be more than 50,000 poses.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> chebyshev_poses(planar(2), 4).shape
    (16, 2)
    """
    if count**arm.n > MOST_POSES:
        raise InvalidSetting(
            f"{count} points for each of {arm.n} joints are {count**arm.n} poses; take fewer "
            f"points, at most {int(MOST_POSES ** (1 / arm.n))}"
        )
    ends = zip(*limits_of(arm.joint_ranges), strict=True)
    return np.array(list(product(*(chebyshev_nodes(*each, count) for each in ends))))


def choose_poses(
    poses: ArrayLike,
    scores: ArrayLike,
    count: int,
    *,
    keep: float = 0.25,
    difference: Literal["angle", "sine"] = "angle",
) -> NDArray[np.intp]:
    """Select, among the best poses, a set with maximum joint-space spread (4.2.3).

    The pose of the best score comes first. Each next one is, among the best share ``keep``, the
    one whose least-moved joint differs most from every pose already chosen; of equals the one
    with the larger mean difference, then the better score.

    Parameters
    ----------
    poses : array (P, n)
        Candidates [rad].
    scores : array (P,)
        The larger the better, as from `worst_push`.
    count : int
        Size of the set.
    keep : float
        Share of the candidates from which to choose [1].
    difference : {"angle", "sine"}
        How a joint's move counts: by its angle modulo a turn, up to π, or by |sin| of it. The
        axis of rotation is found by dividing by the sine (4.31): a half turn tells nothing.

    Returns
    -------
    ndarray (count,)
        Rows of ``poses`` in the order chosen.

    Raises
    ------
    InvalidData
        If shapes do not fit or a value is not finite.
    InvalidSetting
        If the share keeps fewer poses than are wanted.

    Examples
    --------
    >>> choose_poses([[0.0], [0.1], [1.0]], [3.0, 2.0, 1.0], 2, keep=1.0)
    array([0, 2])
    """
    q, s = np.asarray(poses, dtype=float), np.asarray(scores, dtype=float)
    if q.ndim != 2 or s.shape != (len(q),) or not (np.isfinite(q).all() and np.isfinite(s).all()):
        raise InvalidData(f"poses (P, n) and scores (P,) must be finite, got {q.shape}, {s.shape}")
    if difference not in ("angle", "sine"):
        raise UnknownName(f"moves count by 'angle' or 'sine', got {difference!r}")
    if not 0 < keep <= 1:
        raise InvalidSetting(f"keep is a share above 0 and up to 1, got {keep!r}")
    best = np.argsort(-s, kind="stable")[: max(1, int(np.ceil(keep * len(q))))]
    if not 1 <= count <= len(best):
        raise InvalidSetting(f"choose 1 to {len(best)} poses from the best {keep:g}, got {count}")
    near, mean = np.full(len(best), np.inf), np.zeros(len(best))
    chosen = [0]
    while len(chosen) < count:
        move = q[best] - q[best[chosen[-1]]]
        size = np.abs(np.sin(move)) if difference == "sine" else np.abs(_wrapped(move))
        near = np.minimum(near, size.min(axis=1))
        mean += size.mean(axis=1)
        near[chosen] = -1.0
        # Sorted by score already; lexsort keeps the earlier of equals.
        order = np.lexsort((np.arange(len(best)), -mean.round(9), -near.round(9)))
        chosen.append(int(order[0]))
    return np.asarray(best[chosen])


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
