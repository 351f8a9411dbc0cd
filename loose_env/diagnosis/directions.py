"""Directions of looseness: sighted in a pose, turned into link frames, posterior over links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import i0e

from loose_env.arms import Arm, Mismatch
from loose_env.diagnosis.prediction import Prediction, RecordStatistics, SensorFloor
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.faults import hypotheses
from loose_env.statistics import axial_vector
from loose_env.typing import Array

# Polar angles, equally weighted in their logarithm: the peak may be as narrow as a microradian.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(96)
_LOG_LOW, _LOG_HIGH = np.log(1e-7), np.log(np.pi / 2)
_POLAR = np.exp(0.5 * (_LOG_HIGH - _LOG_LOW) * (_NODES + 1) + _LOG_LOW)
_SHARE = 0.5 * (_LOG_HIGH - _LOG_LOW) * _WEIGHTS * _POLAR * np.sin(_POLAR)


def precision_of(direction: ArrayLike, uncertainty: ArrayLike) -> Array:
    """Precision matrix of a measured axis.

    Parameters
    ----------
    direction : array_like (d,)
        Measured axis; its sign and length do not matter.
    uncertainty : array_like, scalar or (d, d)
        Standard deviation of the angle in every direction across [rad], or covariance of the
        unit vector [rad²]; of the latter only what lies across the axis counts. Infinite where
        nothing is known.

    Returns
    -------
    ndarray (d, d)
        W [1/rad²], symmetric, without part along the axis.

    Raises
    ------
    InvalidData
        If the shapes do not fit, or the uncertainty is not positive.

    Examples
    --------
    >>> precision_of([1.0, 0.0], 0.1).round(6).tolist()
    [[0.0, 0.0], [0.0, 100.0]]
    """
    p, spread = np.asarray(direction, dtype=float), np.asarray(uncertainty, dtype=float)
    if p.ndim != 1 or len(p) not in (2, 3) or not np.isfinite(p).all() or not np.any(p):
        raise InvalidData(
            f"an axis is two or three finite numbers, not all zero; got {direction!r}"
        )
    p = p / np.linalg.norm(p)
    across = np.linalg.svd(p[None])[2][1:].T  # (d, d - 1)
    if np.isinf(spread).any() and not np.isnan(spread).any():
        return np.zeros((len(p), len(p)))  # nothing is known
    if spread.ndim == 0:
        if spread <= 0:
            raise InvalidData(f"a standard deviation is above zero, got {uncertainty!r} rad")
        spread = spread**2 * np.eye(len(p))
    if spread.shape != (len(p), len(p)) or np.isnan(spread).any():
        raise InvalidData(
            f"uncertainty is one number [rad] or a ({len(p)}, {len(p)}) covariance, got "
            f"{uncertainty!r}"
        )
    inside = across.T @ spread @ across
    if np.linalg.eigvalsh(inside)[0] <= 0:
        raise InvalidData(f"the uncertainty across the axis must be positive, got {uncertainty!r}")
    return np.asarray(across @ np.linalg.inv(inside) @ across.T)


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
        return np.asarray(
            np.einsum("pkji,kj->pki", self._beyond(self._turns(self._poses(poses))), self._axis)
        )

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


@dataclass(frozen=True, kw_only=True, eq=False)
class DirectionSighting:
    """Direction of looseness seen in one pose."""

    pose: Array
    """Pose [rad, or m where a joint slides] (n,)."""
    direction: Array
    """Unit vector in the tool frame (d,), axial."""
    precision: Array
    """Precision across the direction [1/rad²] (d, d); zero where nothing was seen."""

    @classmethod
    def of(cls, pose: ArrayLike, direction: ArrayLike, uncertainty: ArrayLike) -> DirectionSighting:
        """Sighting of a direction with a standard deviation [rad] or covariance [rad²]."""
        precision = precision_of(direction, uncertainty)
        p = np.asarray(direction, dtype=float)
        return cls(
            pose=np.asarray(pose, dtype=float),
            direction=p / np.linalg.norm(p),
            precision=precision,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkPosterior:
    """Posterior over the loose link, from the directions of several poses."""

    names: tuple[str, ...]
    """Hypotheses: a slide at each link, then play in each joint."""
    probabilities: Array
    """Their probabilities (H,)."""
    log_likelihoods: Array
    """Log-density of all directions under each, relative to uniform ones (H,)."""
    directions: Array
    """Direction that fits each link best, in the link's own frame, axial (n, d)."""
    covariances: Array
    """Its covariance [rad²] (n, d, d); no eigenvalue exceeds 1."""

    @property
    def best(self) -> str:
        """The most probable hypothesis; the first of equals."""
        return self.names[int(np.argmax(self.probabilities > self.probabilities.max() - 1e-9))]

    @property
    def direction_sd(self) -> Array:
        """Rms standard deviation of each link's direction, over the directions across [rad]."""
        total = np.trace(self.covariances, axis1=-2, axis2=-1)
        # Rounding can leave a sure direction a trace below zero.
        return np.asarray(np.sqrt(np.maximum(total, 0.0) / (self.directions.shape[1] - 1)))

    def of(self, names: Sequence[str]) -> float:
        """Probability that one of several hypotheses holds."""
        return float(sum(self.probabilities[self.names.index(name)] for name in set(names)))


def link_posterior(
    frames: ToolFrames,
    sightings: Sequence[DirectionSighting],
    *,
    prior: ArrayLike | None = None,
    scales: Sequence[float] = (1.0,),
) -> LinkPosterior:
    """Weigh all hypotheses by the directions seen in several poses.

    The direction in the link is summed out (uniform beforehand), so that play, whose line is
    known, is weighted fairly against a slide, whose direction is not.

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    sightings : sequence of DirectionSighting
        One or more.
    prior : array_like (2 n,), optional
        Prior weight of each hypothesis, in the order of `fault_locations`; equal by default. Zero
        leaves a hypothesis out.
    scales : sequence of float
        Factors by which the standard deviations given may be too small, all equally likely;
        summed out. More than one makes single bad directions matter less.

    Raises
    ------
    InvalidData
        If there is no sighting.
    InvalidSetting
        If prior or scales make no sense.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> frames = ToolFrames(planar(2))
    >>> poses = np.array([[0.0, 0.3], [0.0, 1.6]])
    >>> seen = frames.images(poses)[:, 0] @ [0.8, 0.6]  # a slide at link 1
    >>> found = link_posterior(
    ...     frames, [DirectionSighting.of(q, p, 0.05) for q, p in zip(poses, seen)]
    ... )
    >>> found.best, found.directions[0].round(6).tolist()
    ('structural_looseness@link1', [0.8, 0.6])
    """
    names = fault_locations(frames.arm)
    weights = np.ones(len(names)) if prior is None else np.asarray(prior, dtype=float)
    if weights.shape != (len(names),) or not np.isfinite(weights).all() or weights.min() < 0:
        raise InvalidSetting(
            f"the prior has {len(names)} weights, zero or more, one for each of {names}; "
            f"got {prior!r}"
        )
    if not weights.any():
        raise InvalidSetting("the prior leaves no hypothesis; give one a positive weight")
    if not scales or min(scales) <= 0:
        raise InvalidSetting(f"scales are positive factors, got {scales!r}")
    if not sightings:
        raise InvalidData("there is no direction to judge by; take a record first")
    poses = np.array([s.pose for s in sightings])
    precision = np.array([s.precision for s in sightings])
    images, lines = frames.images(poses), frames.unit_lines(poses)
    carried = np.einsum("tkia,tij,tkjb->kab", images, precision, images)
    off = np.einsum("tki,tij,tkj->tk", lines, precision, lines)
    has_line = np.any(lines != 0, axis=-1)

    by_scale = []
    for scale in scales:
        alone = log_mean_bingham(precision / scale**2)  # (T,)
        slide = log_mean_bingham(carried / scale**2) - alone.sum()
        # A joint that cannot move the tool in a pose expects nothing there: uniform.
        play = np.where(has_line, -0.5 * off / scale**2 - alone[:, None], 0.0).sum(axis=0)
        by_scale.append(np.concatenate([slide, play]))
    likelihood = np.logaddexp.reduce(by_scale, axis=0) - np.log(len(scales))
    with np.errstate(divide="ignore"):
        log = likelihood + np.log(weights)
    probability = np.exp(log - log.max())
    values, vectors = np.linalg.eigh(carried)
    above = values[:, 1:] - values[:, :1]
    spread = 1 / np.maximum(above, 1.0)
    across = vectors[:, :, 1:]
    return LinkPosterior(
        names=names,
        probabilities=probability / probability.sum(),
        log_likelihoods=likelihood,
        directions=_axial(vectors[:, :, 0]),
        covariances=np.einsum("kia,ka,kja->kij", across, spread, across),
    )


def confusable_faults(
    frames: ToolFrames,
    hypothesis: str,
    direction: ArrayLike | None = None,
    *,
    tolerance: float = np.radians(1.0),
    poses: int = 64,
) -> tuple[str, ...]:
    """Hypotheses that no move can tell from a given one by direction, itself included.

    Play in the last joint always moves the tool along one line of the tool frame, as a slide of
    the last link does; the links either side of a sliding joint never turn against each other;
    and a slide along a joint's axis looks the same on both sides of that joint.

    Parameters
    ----------
    frames : ToolFrames
        The arm's rotations.
    hypothesis : str
        One of `fault_locations`.
    direction : array_like (d,), optional
        Direction of the slide in its link's frame; needed for structural looseness.
    tolerance : float
        Rms angle up to which two hypotheses count as alike [rad].
    poses : int
        Number of poses, spread over the joints' ranges, in which all are compared.

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> confusable_faults(ToolFrames(scara()), "structural_looseness@link2", [1.0, 0.0, 0.0])
    ('structural_looseness@link2', 'structural_looseness@link3')
    """
    names, n = fault_locations(frames.arm), frames.arm.n
    if hypothesis not in names:
        raise InvalidSetting(f"unknown hypothesis {hypothesis!r}; known are {names}")
    rng = np.random.default_rng(0)  # the same poses for everybody
    sample = np.array([frames.arm.random_pose(rng) for _ in range(poses)])
    images, lines = frames.images(sample), frames.unit_lines(sample)
    location = names.index(hypothesis)
    if location < n:
        if direction is None:
            raise InvalidSetting(f"{hypothesis} needs the direction of the slide in its link")
        z = np.asarray(direction, dtype=float)
        seen = images[:, location] @ (z / np.linalg.norm(z))
    else:
        seen = lines[:, location - n]
    across = np.eye(frames.dimension) - np.einsum("ti,tj->tij", seen, seen)
    carried = np.einsum("tkia,tij,tkjb->kab", images, across, images) / poses
    slide = np.linalg.eigvalsh(carried)[:, 0]
    play = np.mean(1 - np.einsum("tki,ti->tk", lines, seen) ** 2, axis=0)
    alike = np.concatenate([slide, play]) <= np.sin(tolerance) ** 2
    alike[location] = True
    return tuple(name for name, same in zip(names, alike, strict=True) if same)


def _axial(vectors: Array) -> Array:
    """Choose signs so that each vector's largest component is positive."""
    largest = np.take_along_axis(vectors, np.argmax(np.abs(vectors), axis=1)[:, None], axis=1)
    return np.asarray(np.where(largest < 0, -vectors, vectors))


@dataclass(frozen=True, kw_only=True)
class ChangeModel:
    """Errors of the transmission of a healthy arm."""

    sensor: float = 0.025
    """Entries of the accelerometer's error matrix: leakage, gain, mounting [1]."""
    geometry: float = 0.015
    """Error of each joint's transmission by lengths and joint zeros, relative [1]."""
    floor: float = np.radians(2.0)
    """Standard deviation that no direction can beat: the mounting bends all alike [rad]."""

    @classmethod
    def of(cls, mismatch: Mismatch, *, joints: int) -> ChangeModel:
        """Derive it from how far the nominal model of an arm with so many joints is off."""
        mounting = np.radians(mismatch.misalignment)
        sensor = float(np.hypot(mismatch.cross_axis, mounting))
        zeros = np.radians(mismatch.joint_zero) * np.sqrt(joints)
        tilt = np.hypot(mismatch.gain, mismatch.length)
        return cls(
            sensor=sensor,
            geometry=float(np.hypot(zeros, tilt)),
            floor=max(sensor, float(np.radians(0.5))),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ChangeSighting(DirectionSighting):
    """A direction of looseness from the change of transmission."""

    ratio: float
    """Size of the change over that of the nominal transmission, |dB| / |B| [1]."""
    expected_ratio: float
    """Rms of that ratio where nothing is loose [1]."""
    values: Array
    """Singular values of the change, falling, joints weighted by their motion [m/s²]."""
    noise: float
    """Singular value that errors alone leave, rms [m/s²]."""

    @property
    def rank(self) -> int:
        """Number of directions in the change that stand out: 0 none, 1 one slide, more several."""
        return int(np.sum(self.values > 3 * self.noise))

    @property
    def excess(self) -> float:
        """Change over what errors leave [1]: about 1 where nothing is loose."""
        return self.ratio / self.expected_ratio


def sight_change(
    record: RecordStatistics,
    nominal: Prediction,
    *,
    band: tuple[float, float],
    floor: SensorFloor,
    model: ChangeModel,
    springs: Array | None = None,
) -> ChangeSighting:
    """Read the direction of looseness off the change of transmission in one record.

    Joints are weighted by their nominal accelerations, so that those that turn and those that
    slide can be excited together.

    Parameters
    ----------
    record : RecordStatistics
        The record.
    nominal : Prediction
        Prediction of the healthy nominal arm for it.
    band : (float, float)
        Band of the excitation [Hz].
    floor : SensorFloor
        Noise of the sensors in the band.
    model : ChangeModel
        Errors of model and sensors.
    springs : ndarray (K, d, m), optional
        Changes of the transmission by errors of springs, from
        `loose_env.diagnosis.prediction.stiffness_errors`; they matter for an arm
        that bends in its band.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.diagnosis import predict, statistics_of
    >>> from loose_env.excitation import Excitation
    >>> from loose_env.rig import SimulatedRig
    >>> arm = planar(2)
    >>> rig, pose = SimulatedRig(arm), np.array([0.1, 0.9])
    >>> shake = Excitation(torque_rms=(5.0, 2.0), duration=0.4, band=arm.band)
    >>> quiet = SensorFloor(joint=0.01, tool=0.001)
    >>> seen = sight_change(
    ...     statistics_of(rig.measure(pose, shake)),
    ...     predict(rig.nominal.at(pose), shake, quiet),
    ...     band=arm.band,
    ...     floor=quiet,
    ...     model=ChangeModel(),
    ... )
    >>> seen.rank  # nothing is loose
    0
    """
    on = np.flatnonzero(record.excited)
    reference = nominal.transmission_by_instrument
    d, m = reference.shape
    rms = np.sqrt(np.diag(nominal.joint))
    weighted = reference * rms
    change = record.transmission_by_instrument[:, on] * rms - weighted
    left, values, right = np.linalg.svd(change, full_matrices=False)
    direction, v = axial_vector(left[:, 0]), right[0]

    samples = 2 * (band[1] - band[0]) * record.duration
    # Encoder noise n enters as B n; it does not know the command, so it only adds scatter.
    scatter = _residual(record, nominal, on, floor) + floor.joint**2 * (reference @ reference.T)
    scatter = scatter / samples
    # Joints that move alike, or follow the command badly, are harder to tell apart: a row of B
    # scatters with (Sxu Suu^-1 Sux)^-1.
    followed = nominal.command_joint.T @ np.linalg.solve(nominal.command, nominal.command_joint)
    mixed = np.linalg.inv(followed) * np.outer(rms, rms)

    columns = np.sum(weighted**2, axis=0)
    bent = model.sensor**2 * float(np.sum((weighted @ v) ** 2))
    bent += model.geometry**2 * float(columns @ v**2)
    errors = float(np.trace(mixed) * np.trace(scatter))
    errors += (d * model.sensor**2 + model.geometry**2) * float(columns.sum())
    bending = np.zeros((0, d, m)) if springs is None else springs * rms
    errors += float(np.sum(bending**2))
    lean = bending @ v  # (K, d)
    noise = float(np.sqrt(errors / min(d, m)))
    # Errors alone have a largest singular value too: only what exceeds it points anywhere.
    top = float(values[0]) ** 2 - noise**2
    precision = np.zeros((d, d))
    if top > 0:
        covariance = float(v @ mixed @ v) * scatter + bent * np.eye(d) + lean.T @ lean
        covariance = covariance / top
        precision = precision_of(direction, covariance + model.floor**2 * np.eye(d))
    return ChangeSighting(
        pose=record.pose,
        direction=direction,
        precision=precision,
        ratio=float(np.sqrt(np.sum(values**2) / columns.sum())),
        expected_ratio=float(np.sqrt(errors / columns.sum())),
        values=values,
        noise=noise,
    )


def _residual(
    record: RecordStatistics, nominal: Prediction, on: NDArray[np.intp], floor: SensorFloor
) -> Array:
    """Covariance of the tool acceleration that the joints leave unexplained (d, d).

    Its shape is what remains beside the measured transmission of the measured joint motion, its
    size at most what the lowest coherence of the record leaves.
    """
    rms = np.sqrt(np.diag(nominal.joint))
    correlation = nominal.joint / np.outer(rms, rms)
    moved = record.transmission_by_instrument[:, on] * record.joint_rms[on]
    values, vectors = np.linalg.eigh(record.tool_covariance - moved @ correlation @ moved.T)
    left = (vectors * np.maximum(values, max(floor.tool**2, 1e-30))) @ vectors.T
    most = max(1 - record.lowest_coherence, 0.0) * float(np.trace(record.tool_covariance))
    return np.asarray(min(1.0, most / float(np.trace(left))) * left)
