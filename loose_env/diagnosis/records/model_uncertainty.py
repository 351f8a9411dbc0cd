"""Errors of the nominal transmission, by source.

With one joint excited and the others held, the healthy transmission is kinematics: link lengths,
joint zeros and the accelerometer's gains, leakage and mounting decide, masses hardly matter.

What an arm's own compliance does to a change of transmission.

On a stiff arm a seat that opens moves the tool along its own direction and nothing else. Bending
modes, gears, servos and, a little, brakes yield to the seat's reaction, and move the tool
elsewhere: near a mode by as much as the seat itself. And where the healthy arm is taken from the
nominal model, modes in or near the band change its transmission with every error of stiffness.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm, LinearPose, Mismatch, Response
from loose_env.statistics import TransmissionEstimate
from loose_env.typing import Array

__all__ = [
    "bent_by_seats",
    "calibrate_sensor",
    "joint_zero_errors",
    "kinematic_errors",
    "sensor_errors",
    "sensor_matrices",
    "stiffness_errors",
]


def sensor_matrices(axes: int, mismatch: Mismatch) -> Array:
    """Change of the reading per true acceleration by each accelerometer error.

    Parameters
    ----------
    axes : int
        Number of measured axes d.
    mismatch : Mismatch
        Standard deviations of the errors.

    Returns
    -------
    ndarray (d * d + d * (d - 1) / 2, d, d)
        One standard deviation each: gain of every axis and leakage from every axis into every
        other one, then rotation about each axis.
    """
    errors = []
    for i in range(axes):
        for j in range(axes):
            leak = np.zeros((axes, axes))
            leak[i, j] = mismatch.gain if i == j else mismatch.cross_axis
            errors.append(leak)
    turn = np.radians(mismatch.misalignment)
    for i in range(axes):
        for j in range(i):
            skew = np.zeros((axes, axes))
            skew[i, j], skew[j, i] = turn, -turn
            errors.append(skew)
    return np.array(errors)


def sensor_errors(b: Array, mismatch: Mismatch) -> Array:
    """Change of a measured transmission by each error of the tool accelerometer.

    Parameters
    ----------
    b : ndarray (d, m)
        Transmission, or change of transmission, that the accelerometer reads [m].
    mismatch : Mismatch
        Standard deviations of the errors.

    Returns
    -------
    ndarray (K, d, m)
        Changes by each of the `sensor_matrices`.

    Examples
    --------
    >>> errors = sensor_errors(np.array([[1.0], [0.0]]), Mismatch(cross_axis=0.02))
    >>> errors.shape, errors[2].ravel().tolist()
    ((5, 2, 1), [0.0, 0.02])
    """
    return np.asarray(sensor_matrices(len(b), mismatch) @ b)


def calibrate_sensor(
    healthy: TransmissionEstimate, nominal: Array, kinematic: Array, mismatch: Mismatch
) -> tuple[Array, Array]:
    """Calibrate the accelerometer on a healthy arm of known transmission.

    What differs between the healthy transmission and the nominal one is the sensor's doing or the
    model's. Both are given the sizes that the mismatch expects, and the sensor's part is what
    the difference leaves most probable (a linear Gaussian estimate).

    Parameters
    ----------
    healthy : TransmissionEstimate
        Measured on the healthy arm (d, m).
    nominal : ndarray (d, m)
        The same by the nominal model.
    kinematic : ndarray (K, d, m)
        Errors of the model, from `kinematic_errors`.
    mismatch : Mismatch
        Standard deviations of the errors.

    Returns
    -------
    ndarray (d, d)
        Best estimate of the reading per true acceleration, about one.
    ndarray (L, d, d)
        Remaining errors of it, independent errors of one standard deviation each.

    Examples
    --------
    >>> nominal = np.random.default_rng(0).standard_normal((3, 6))
    >>> true = np.eye(3) + 0.02 * np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0.0]])
    >>> small = 1e-8 * np.eye(18).reshape(3, 6, 3, 6)
    >>> read = TransmissionEstimate(true @ nominal, small)
    >>> found, left = calibrate_sensor(read, nominal, np.zeros((0, 3, 6)), Mismatch())
    >>> bool(np.abs(found - true).max() < 0.002)
    True
    """
    d = len(nominal)
    matrices = sensor_matrices(d, mismatch)
    size = nominal.size
    by_sensor = (matrices @ nominal).reshape(len(matrices), size)
    rest = kinematic.reshape(len(kinematic), size)
    noise = healthy.covariance.reshape(size, size) + rest.T @ rest
    noise += 1e-9 * float(np.mean(nominal**2)) * np.eye(size)  # the model is not exact
    seen = noise + by_sensor.T @ by_sensor
    gain = np.linalg.solve(seen, by_sensor.T).T
    strength = gain @ (healthy.b - nominal).ravel()
    left = np.eye(len(matrices)) - gain @ by_sensor.T
    values, vectors = np.linalg.eigh((left + left.T) / 2)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))
    return (
        np.eye(d) + np.einsum("k,kij->ij", strength, matrices),
        np.einsum("kl,kij->lij", roots, matrices),
    )


def joint_zero_errors(linear: LinearArm, pose: Array, mismatch: Mismatch) -> Array:
    """Change of the tool's Jacobian by an error of each joint's zero, tool frame [m] (n, d, n).

    The zero of a sliding joint is off by as many metres as that of a turning one by radians.
    """
    tiny = 1e-4
    kinematic = linear.at(pose).kinematic
    slopes = []
    for k in range(linear.arm.n):
        moved = np.array(pose, dtype=float)
        moved[k] += tiny
        slopes.append((linear.at(moved).kinematic - kinematic) / tiny)
    return np.asarray(np.radians(mismatch.joint_zero) * np.array(slopes))


def kinematic_errors(linear: LinearArm, pose: Array, mismatch: Mismatch) -> Array:
    """Change of the tool's Jacobian by each error of a joint zero and of a link's length.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    pose : ndarray (n,)
        Pose [rad or m].
    mismatch : Mismatch
        Standard deviations of the errors.

    Returns
    -------
    ndarray (K, d, n)
        Changes by one standard deviation each, tool frame [m]: a zero for every joint, then a
        length for every body between tool and base, the tool's own place first.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> linear = LinearArm(planar(2))
    >>> errors = kinematic_errors(linear, np.zeros(2), Mismatch(length=0.01, joint_zero=0.0))
    >>> np.abs(errors).sum(0).round(4).tolist()
    [[0.0, 0.0], [0.006, 0.003]]
    """
    arm = linear.arm
    axes = list(arm.axes)
    errors = list(joint_zero_errors(linear, pose, mismatch))
    model = arm.model
    data = mujoco.MjData(model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_kinematics(model, data)
    joints = [model.joint(name).id for name in arm.joints]
    turning = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_HINGE
    frame = data.site_xmat[model.site(arm.tool).id].reshape(3, 3)
    site = model.site(arm.tool)
    body = int(site.bodyid[0])
    offsets = [(body, data.site_xpos[site.id] - data.xpos[body])]
    while body:
        parent = int(model.body_parentid[body])
        offsets.append((parent, data.xpos[body] - data.xpos[parent]))
        body = parent
    for carrier, offset in offsets:
        longer = np.zeros((3, arm.n))
        for j, joint in enumerate(joints):
            # Only what lies beyond the joint's axis lengthens its lever.
            moves = model.jnt_bodyid[joint] in _ancestors(model, carrier)
            if turning[j] and moves:
                longer[:, j] = np.cross(data.xaxis[joint], mismatch.length * offset)
        errors.append((frame.T @ longer)[axes])
    return np.array(errors)


def _ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    found = {body}
    while body:
        body = int(model.body_parentid[body])
        found.add(body)
    return found


_IN_STEP = 0.3
"""Least share of a seat's motion that is taken to be in step with the command."""


def bent_by_seats(pose: LinearPose, excited: NDArray[np.bool_]) -> Array:
    """Direction error of the tool motion by a seat of each link.

    Parameters
    ----------
    pose : LinearPose
        The nominal arm at the pose, in the band that was played.
    excited : ndarray of bool (n,)
        Joints that were excited together.

    Returns
    -------
    ndarray (m, n, d, d)
        For each excited joint and link: what is added to a change of transmission z, over it, for
        a seat that floats in that link and slides along z in the tool frame.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import vera
    >>> def most(arm):
    ...     at = LinearArm(arm).at([0.0, 1.2])
    ...     return float(np.abs(bent_by_seats(at, np.array([True, False]))).max())
    >>> most(planar(2)) < 0.03, most(vera()) > 0.1
    (True, True)
    """
    answer, opened = pose.response(excited), pose.open_response(excited)
    b = _transmission(answer, excited)
    stiff = pose.jacobian[:, pose.linear.slide_dofs].transpose(1, 0, 2)  # (n, d, s)
    column = opened.tool_open_slide - np.einsum("dm,kmis->kdis", b, opened.joint_open_slide)
    mass = np.einsum("kiss->kis", opened.mass_slide)
    free = -answer.slide / mass[..., None]  # (K, n, s, m)
    shown = np.einsum("kdis,kism->midsk", column, free).real.mean(axis=-1)
    step = free.real.mean(axis=0)
    size = np.sqrt(np.mean(np.abs(free) ** 2, axis=0))
    off = shown - np.einsum("ids,ism->mids", stiff, step)
    scale = np.maximum(np.abs(step), _IN_STEP * size).transpose(2, 0, 1)[:, :, None]
    signed = np.where(step < 0, -1.0, 1.0).transpose(2, 0, 1)[:, :, None]
    share = np.divide(signed * off, scale, out=np.zeros_like(off), where=scale > 0)
    # From axes of the link to axes of the tool.
    return np.asarray(np.einsum("mids,ies->mide", share, stiff))


def stiffness_errors(
    linear: LinearArm, pose: Array, excited: NDArray[np.bool_], mismatch: Mismatch
) -> Array:
    """Change of the healthy transmission by an error of each compliant spring.

    Differences over two standard deviations, because answers near a mode are far from linear.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm, in the band that was played.
    pose : ndarray (n,)
        Pose [rad or m].
    excited : ndarray of bool (n,)
        Joints that were excited together.
    mismatch : Mismatch
        Standard deviations of the errors. Errors of mass shift modes as those of stiffness do.

    Returns
    -------
    ndarray (K, d, m)
        Changes by one standard deviation each [m]: bending modes and gears, then what holds each
        joint.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import vera
    >>> one = np.array([True, False])
    >>> def most(arm):
    ...     errors = stiffness_errors(LinearArm(arm), np.array([0.0, 1.2]), one, Mismatch())
    ...     return float(np.abs(errors).max())
    >>> most(planar(2)) < 0.002, most(vera()) > 0.01
    (True, True)
    """
    relative = float(np.hypot(mismatch.stiffness, mismatch.mass))

    at = linear.at(pose)

    def transmission(sprung: LinearArm) -> Array:
        # Springs change no inertia: the arm stands as it did.
        return _transmission(replace(at, linear=sprung).response(excited), excited)

    arm, held = linear.arm, ~np.asarray(excited, dtype=bool)
    dofs = len(linear.flexible_dofs)
    soft, stiff = [], []
    for k in range(dofs + arm.n):
        if k < dofs or held[k - dofs]:
            stiff.append(transmission(_sprung(linear, k, 1 + relative)))
            soft.append(transmission(_sprung(linear, k, 1 / (1 + relative))))
    shape = (-1, len(arm.axes), int(np.sum(excited)))  # there may be no spring at all
    return (np.reshape(stiff, shape) - np.reshape(soft, shape)) / 2


def _transmission(answer: Response, excited: NDArray[np.bool_]) -> Array:
    """Healthy transmission with the command as instrument, all commands alike (d, m)."""
    joint = answer.joint[:, np.flatnonzero(excited)].real.mean(axis=0)
    return np.asarray(np.linalg.solve(joint.T, answer.tool.real.mean(axis=0).T).T)


@lru_cache(maxsize=64)
def _sprung(linear: LinearArm, spring: int, factor: float) -> LinearArm:
    """Arm with one stiffer spring: a bending mode, a gear or a holding."""
    arm, joint = linear.arm, spring - len(linear.flexible_dofs)
    if joint < 0:
        model = copy(linear.model)
        model.jnt_stiffness[model.dof_jntid[linear.flexible_dofs[spring]]] *= factor
        return linear.variant(arm, model)
    stiffness = list(arm.holding.stiffness)
    stiffness[joint] *= factor
    held = replace(arm.holding, stiffness=tuple(stiffness))
    return linear.variant(
        replace(arm, servo=held) if arm.hold == "servo" else replace(arm, brake=held)
    )
