"""Statistics of records at tool and links: measured; predicted healthy, by open seat, by error.

Predictions are of the arm healthy, with one seat freed, and with errors of the model. A shut seat
transmits a force. If it floats, the two sides part with acceleration
``-force / apparent mass``, and the whole arm answers through the seat's open columns. A seat
that opens in part moves ``s`` times as far, in step with the force; what it does out of step
(impacts, stick and slip) adds motion along the same direction that follows no command.
"""

from __future__ import annotations

import dataclasses
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from loose_env.arms import (
    Arm,
    LinearArm,
    LinearPose,
    LinearPoses,
    Mismatch,
    distinct,
    link_site,
)
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation, SeatDrive, SeatReference
from loose_env.rig import Measurement, Records
from loose_env.sensors import LinkAccelerometers, SensorSuite
from loose_env.statistics import (
    RecordCovariances,
    apparent_inertia_from,
    central_moments,
    lowest_coherence_direction_from,
    record_covariances,
    transmission_by_instrument_from,
    transmission_from,
)
from loose_env.typing import Array, ComplexArray, IndexArray


@dataclass(frozen=True, kw_only=True)
class SensorFloor:
    """Noise that the sensors leave in the band."""

    joint: float
    """Standard deviation of a joint acceleration from an encoder [rad/s²]."""
    tool: float
    """Standard deviation of one axis of the tool acceleration [m/s²]."""
    slide: float = 0.0
    """Standard deviation of a sliding joint's acceleration from its linear scale [m/s²]."""

    def joints(self, arm: Arm) -> Array:
        """Standard deviation of every joint's acceleration [rad/s², m/s² where it slides] (n,)."""
        return np.where(arm.sliding, self.slide, self.joint)

    @classmethod
    def of(cls, sensors: SensorSuite, band: tuple[float, float]) -> SensorFloor:
        """Floor of a set of sensors in a band [Hz].

        Readings are white, quantisation included; twice differentiated, the noise of the encoder
        rises with the square of the frequency.
        """
        low, high = band
        share = (high - low) / (sensors.rate / 2)
        encoder = sensors.encoder.noise**2 + sensors.encoder.resolution**2 / 12
        scale = sensors.encoder.linear_noise**2 + sensors.encoder.linear_resolution**2 / 12
        fourth = (2 * np.pi) ** 4 * (high**5 - low**5) / 5 / (high - low)
        accelerometer = sensors.accelerometer
        tool = accelerometer.noise_density**2 * (high - low)
        tool += accelerometer.resolution**2 / 12 * share
        return cls(
            joint=float(np.sqrt(encoder * fourth * share)),
            tool=float(np.sqrt(tool)),
            slide=float(np.sqrt(scale * fourth * share)),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Second-order statistics of one record; m joints are excited.

    The command is scaled to its rms; all covariances are in-band.
    """

    covariances: RecordCovariances
    """Of the command, the accelerations of the excited joints and that of the tool."""

    @property
    def joint(self) -> Array:
        """Covariance of the excited joints' accelerations (m, m) [rad²/s⁴]."""
        return self.covariances.x_a.xx

    @property
    def joint_tool(self) -> Array:
        """Covariance of joint and tool acceleration (m, d) [rad/s² m/s²]."""
        return self.covariances.x_a.xa

    @property
    def tool(self) -> Array:
        """Covariance of the tool acceleration (d, d) [m²/s⁴]."""
        return self.covariances.x_a.aa

    @property
    def transmission(self) -> Array:
        """Regression of the tool on the measured joint accelerations (d, m) [m]."""
        return transmission_from(self.covariances.x_a)

    @property
    def transmission_by_instrument(self) -> Array:
        """The same with the command as instrument: free of encoder noise (d, m) [m]."""
        own = self.covariances
        return transmission_by_instrument_from(own.command_x, own.command_a)


def predict(pose: LinearPose, excitation: Excitation, floor: SensorFloor) -> Prediction:
    """Predict a record of the nominal, healthy arm.

    Parameters
    ----------
    pose : LinearPose
        The nominal arm at the pose.
    excitation : Excitation
        Excitation; at least one joint must be on. Spectra are taken as flat.
    floor : SensorFloor
        Noise of the sensors.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import LinearArm
    >>> shake = Excitation(torque_rms=(0.0, 3.0), duration=1.2, band=(30.0, 150.0))
    >>> quiet = SensorFloor(joint=0.0, tool=0.0)
    >>> at = LinearArm(planar(2)).at([0.0, 1.0])
    >>> predict(at, shake, quiet).transmission.round(2).ravel().tolist()
    [0.0, 0.3]
    """
    torque = np.array([excitation.torque_rms])
    answer = pose.response(torque[0] > 0)
    arm = pose.linear.arm
    found = predictions(arm, torque, floor, answer.acceleration[None], answer.tool[None])
    return Prediction(covariances=RecordCovariances.of(found.full[0], int((torque > 0).sum()), 0))


def predictions(
    arm: Arm,
    torque_rms: Array,
    floor: SensorFloor,
    acceleration: ComplexArray,
    tool: ComplexArray,
) -> RecordCovariances:
    """Predict several records of the nominal, healthy arm, in which equally many joints are on.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    torque_rms : ndarray (B, n)
        Rms torques [N·m]; at least one in each record is above zero.
    floor : SensorFloor
        Noise of the sensors.
    acceleration, tool : ndarray (B, K, v, m), (B, K, d, m)
        The arm's responses, as `LinearPoses.responses` gives them.

    Returns
    -------
    RecordCovariances
        Of all records; arrays have a first axis of length B.
    """
    joints, rows = joints_on(torque_rms), np.arange(len(torque_rms))[:, None]
    torque = torque_rms[rows, joints]
    joint = acceleration[rows, :, joints].transpose(0, 2, 1, 3)
    both = np.concatenate([joint, tool], axis=2) * torque[:, None, None]
    _, count, p, m = both.shape
    # Spectra averaged over the band; the command of joint j drives column j alone.
    full = np.zeros((len(torque), m + p, m + p))
    full[:, m:, :m] = np.einsum("bkim->bim", both).real * torque[:, None] / count
    full[:, :m, m:] = full[:, m:, :m].mT
    full[:, m:, m:] = np.einsum("bkim,bkjm->bij", both, both.conj()).real / count
    diagonal = np.arange(m + p)
    full[:, diagonal[:m], diagonal[:m]] = torque**2
    full[:, diagonal[m:], diagonal[m:]] += channel_noise(floor, arm, joints)
    return RecordCovariances.of(full, m, count)


def _diagonal(values: Array) -> Array:
    """Diagonal matrices of rows (B, m, m)."""
    return np.asarray(values[..., None] * np.eye(values.shape[-1]))


INERTIA_ERROR = 0.03
"""Relative error of the predicted apparent inertia."""
POWER_ERROR = 0.35
"""Relative error of predicted residual powers that sampling does not explain."""
LINEAR_ERROR = 0.003
"""Share of the tool's rms motion that no linear model explains."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeatPrediction:
    """Answers of the m excited joints and the d tool axes, p = m + d channels.

    Places are the sliding directions of link 1, those of link 2, ..., then the joints' plays:
    P = n A + n of them. The command of each excited joint has its rms. Of B records together,
    as `predict_seats` gives them, arrays have an axis more in front.
    """

    in_step: Array
    """Healthy part of the answer in step with the command (p, m), per unit-rms command."""
    in_step_open: Array
    """Change of it if a seat floats (P, p, m)."""
    rest: Array
    """Covariance of the healthy answer's part out of step with the command (p, p)."""
    rest_mixed: Array
    """Term of that covariance in s if a seat opens (P, p, p)."""
    rest_open: Array
    """Term of it in s² (P, p, p)."""
    loose: Array
    """Covariance that the free motion of a seat on its own would add (P, p, p)."""
    force: Array
    """Rms force or torque that the shut seat transmits (P,)."""
    load: Array
    """Force or torque that gravity puts on the seat at rest, without sign (P,)."""


def predict_seats(
    poses: LinearPoses,
    torque: Array,
    directions: Array,
    floor: Array,
    *,
    locations: NDArray[np.intp] | None = None,
    free: bool = False,
    opening: bool = False,
) -> SeatPrediction:
    """Work out all seats of the arm in B records in which equally many joints are on.

    Parameters
    ----------
    poses : LinearPoses
        The nominal arm at the poses.
    torque : ndarray (B, n)
        Rms torque of every joint [N·m]; zero for held joints. At least one must be on.
    directions : ndarray (A, axes)
        Sliding directions of a link, unit vectors in its frame.
    floor : ndarray (B, p)
        Variance that the sensors add to each channel.
    locations : ndarray of int (M,) or (B, M), optional
        Places that are asked for, in all records or in each; all by default.
    free, opening : bool
        Whether to work out `loose`; and `rest_mixed` and `rest_open`. Without, they have no places.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import LinearArm
    >>> at = LinearArm(planar(2)).at_all(np.array([[0.0, 1.0]]))
    >>> seats = predict_seats(at, np.array([[0.0, 3.0]]), np.eye(2), np.zeros((1, 3)))
    >>> seats.in_step_open.shape
    (1, 6, 3, 1)
    """
    linear, excited = poses.linear, torque > 0
    along, squares, pairs = _seat_axes(linear.arm.n, directions.shape[1], directions.tobytes())
    (acceleration, tool), opened = poses.responses(excited), poses.open_responses(excited, pairs)
    on, weights = joints_on(torque), linear.weights
    if locations is not None:
        along, squares = along[locations], squares[locations]
    m, t = tool.shape[-1], np.take_along_axis(torque, on, axis=1)[:, None, :, None]

    def summed(among: Array, values: ComplexArray) -> ComplexArray:
        """Sums (B, P, ..., K) of values (B, seats or degrees of freedom, ..., K).

        Frequencies come last, so that averages over them are products of matrices.
        """
        flat: Any = among @ values.reshape(*values.shape[:2], -1).view(float)
        return np.asarray(flat.view(complex).reshape(*flat.shape[:2], *values.shape[2:]))

    answer, seen = (
        np.ascontiguousarray(part.transpose(0, 2, 3, 1)) * t for part in (acceleration, tool)
    )
    coupling = np.ascontiguousarray(poses.inertia[:, linear.seats[:, None], linear.moving])
    force = summed(along, summed(coupling, answer))
    column, mass = summed(along, opened[0]), summed(squares, opened[1])
    moved = -force / mass[:, :, None]  # (B, P, m, K), column (B, P, p, K)

    joints = np.take_along_axis(answer, on[..., None, None], axis=1)
    own = np.concatenate([joints, seen], axis=1)
    p, in_step = own.shape[1], own.real @ weights
    flat = own.reshape(len(own), p, -1)
    back = moved.conj() * weights
    step = _summed(column, back)
    mixed, rest_open, loose = (np.zeros((len(own), 0, p, p)) for _ in range(3))
    power = (moved * back).real.sum(2)
    if free:
        loose = _summed(column * weights, column) * power.sum(-1)[..., None, None]
    if opening:
        follows = sum(own[:, None, :, k] * back[:, :, None, k] for k in range(m))
        mixed = _summed(np.asarray(follows), column) - in_step[:, None] @ step.mT
        rest_open = _summed(column * power[:, :, None], column) - step @ step.mT
    return SeatPrediction(
        in_step=in_step,
        in_step_open=step,
        rest=_summed(flat * np.tile(weights, m), flat) - in_step @ in_step.mT + _diagonal(floor),
        rest_mixed=mixed + mixed.mT,
        rest_open=rest_open,
        loose=loose,
        force=np.sqrt((np.abs(force) ** 2).sum(2) @ weights),
        load=np.abs(along @ poses.load[:, linear.seats, None])[..., 0],
    )


@lru_cache(maxsize=64)
def _seat_axes(
    n: int, count: int, directions: bytes
) -> tuple[Array, Array, tuple[IndexArray, IndexArray]]:
    """Motion of every location along the axes of all seats (P, n count + n).

    The apparent mass along it is a sum over pairs of axes of one seat: their shares (P, pairs), and
    the numbers of the two.
    """
    u, (i, j) = np.frombuffer(directions).reshape(-1, count), np.triu_indices(count)
    hinges, links = n * count + np.arange(n), count * np.arange(n)[:, None]
    squares = u[:, i] * u[:, j] * np.where(i == j, 1.0, 2.0)
    along, shares = (block_diag(np.kron(np.eye(n), own), np.eye(n)) for own in (u, squares))
    one, other = (np.concatenate([(links + own).ravel(), hinges]) for own in (i, j))
    return along, shares, (one, other)


def _summed(a: NDArray[Any], b: NDArray[Any]) -> Array:
    """Real part of the products a bᴴ (..., i, j), summed over the last axis of both."""
    one, other = (np.ascontiguousarray(x).view(float) for x in (a, b))
    return np.asarray(one @ other.mT)


def joints_on(torque: NDArray[Any]) -> IndexArray:
    """Numbers of the excited joints in each record (B, m), equally many in all (B, n)."""
    return np.nonzero(torque)[1].reshape(len(torque), -1)


def independent_samples(arm: Arm, duration: Any) -> Any:
    """Independent samples in the arm's band in records of some length [s]."""
    return 2 * (arm.band[1] - arm.band[0]) * duration


def channel_noise(floor: SensorFloor, arm: Arm, on: NDArray[np.intp]) -> Array:
    """Variance that the sensors add to the excited joints (..., m) and the tool's axes (..., p)."""
    tool = np.full((*on.shape[:-1], len(arm.axes)), floor.tool)
    return np.concatenate([floor.joints(arm)[on], tool], axis=-1) ** 2


def shut_seats(pose: LinearPose, torque: Array, directions: Array) -> tuple[Array, Array]:
    """Rms force that every shut seat transmits, and gravity's load on it at rest (P,) each.

    Slides along the directions (A, d) of every link, or (n, A, d) of each, then plays.
    """
    on, n, d = torque > 0, pose.linear.arm.n, directions.shape[-1]
    answer, u = pose.response(on), np.broadcast_to(directions, (n, *directions.shape[-2:]))
    slide = answer.slide[:, :, :d] * torque[on]
    power = np.einsum("kism,kitm->ist", slide, slide.conj(), optimize=True).real / len(slide)
    slides = np.einsum("ias,ist,iat->ia", u, power, u, optimize=True)
    plays = np.mean(np.sum(np.abs(answer.hinge * torque[on]) ** 2, axis=-1), axis=0)
    loads = np.einsum("is,ias->ia", pose.seat_load[:, :d], u)
    force = np.sqrt(np.maximum(np.concatenate([slides.ravel(), plays]), 0.0))
    return force, np.abs(np.concatenate([loads.ravel(), pose.load[pose.linear.hinge_dofs]]))


def seat_drives(linear: LinearArm, directions: Array, over: SeatReference) -> Array:
    """Rms force of the top level across every seat (P,), slides of each link, then plays.

    Some motions of a seat no joint drives, such as those across a plane of motion.
    """
    drive, links = SeatDrive(linear, over=over), np.arange(1, linear.arm.n + 1)
    slides = drive.slide(np.repeat(links, len(directions)), np.tile(directions, (len(links), 1)))
    found = np.concatenate([slides, drive.hinges])
    return np.asarray(np.maximum(found, 1e-9 * found.max()))


def sensor_errors(b: Array, mismatch: Mismatch) -> Array:
    """Change of measured transmissions (B, d, m) by each error of the sensor (B, K, d, m).

    Gain of every axis and leakage from every axis into every other one, then rotation about each
    axis, one standard deviation each.
    """
    d = b.shape[-2]
    units = np.eye(d * d).reshape(d, d, d, d)
    leaks = units * np.where(np.eye(d) > 0, mismatch.gain, mismatch.cross_axis)[..., None, None]
    turn = np.radians(mismatch.misalignment)
    turns = [turn * (units[i, j] - units[j, i]) for i in range(d) for j in range(i)]
    return np.asarray(np.array([*leaks.reshape(-1, d, d), *turns]) @ b[:, None])


def joint_zero_errors(linear: LinearArm, poses: Array, mismatch: Mismatch) -> Array:
    """Change of the tool's Jacobian by an error of each joint's zero, tool frame [m] (B, n, d, n).

    The zero of a sliding joint is off by as many metres as that of a turning one by radians.
    """
    tiny, n = 1e-4, linear.arm.n
    different, back = distinct(poses)
    moved = different[:, None] + tiny * np.concatenate([np.zeros((1, n)), np.eye(n)])
    kinematic = linear.kinematics(moved.reshape(-1, n)).reshape(len(different), 1 + n, -1, n)
    slopes = (kinematic[:, 1:] - kinematic[:, :1]) / tiny
    return np.asarray(np.radians(mismatch.joint_zero) * slopes[back])


def stiffness_errors(poses: LinearPoses, excited: NDArray[np.bool_], mismatch: Mismatch) -> Array:
    """Change of the healthy transmission by an error of each compliant spring.

    Differences over two standard deviations, because answers near a mode are far from linear.

    Parameters
    ----------
    poses : LinearPoses
        The nominal arm at B poses, in the band that was played.
    excited : ndarray of bool (B, n)
        Joints that were excited together, equally many in each.
    mismatch : Mismatch
        Standard deviations of the errors. Errors of mass shift modes as those of stiffness do.

    Returns
    -------
    ndarray (B, K, d, m)
        Changes by one standard deviation each [m]: bending modes and gears, then what holds each
        joint; zero for joints that are excited.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.arms import vera
    >>> one = np.array([[True, False]])
    >>> def most(arm):
    ...     at = LinearArm(arm).at_all(np.array([[0.0, 1.2]]))
    ...     return float(np.abs(stiffness_errors(at, one, Mismatch())).max())
    >>> most(planar(2)) < 0.002, most(vera()) > 0.01
    (True, True)
    """
    linear, excited = poses.linear, np.asarray(excited, dtype=bool)
    relative = float(np.hypot(mismatch.stiffness, mismatch.mass))
    dofs, m = len(linear.flexible_dofs), int(np.sum(excited[0]))
    found = np.zeros((len(poses), dofs + linear.arm.n, len(linear.arm.axes), m))
    for k in range(found.shape[1]):
        held = np.flatnonzero(~excited[:, k - dofs]) if k >= dofs else np.arange(len(poses))
        if not len(held):
            continue
        at, driven = poses.some(held), excited[held]
        stiff, soft = (
            # Springs change no inertia: the arm stands as it did.
            healthy_transmission(replace(at, linear=_sprung(linear, k, factor)), driven)
            for factor in (1 + relative, 1 / (1 + relative))
        )
        found[held, k] = (stiff - soft) / 2
    return found


def healthy_transmission(poses: LinearPoses, excited: NDArray[np.bool_]) -> Array:
    """Healthy transmission with the command as instrument, all commands alike (B, d, m)."""
    acceleration, tool = poses.responses(excited)
    on = joints_on(excited)[:, None, :, None]
    joint = np.take_along_axis(acceleration, on, axis=2).real.mean(axis=1)
    return np.asarray(np.linalg.solve(joint.mT, tool.real.mean(axis=1).mT).mT)


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


_STILL = 1e-12
"""Share of the largest variance, and of a row's mean, taken as rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondOrder:
    """Second-order statistics of one record in the band, measured or predicted.

    Arrays over joints have n entries; those of joints that were not excited are zero. Of B
    records together, as `statistics_of_all` gives them, every number is an array (B,) and every
    array has an axis more in front.
    """

    transmission: Array
    """Tool acceleration per measured joint acceleration [m] (d, n)."""
    transmission_by_instrument: Array
    """The same with the command as instrument [m] (d, n)."""
    joint_rms: Array
    """Rms joint acceleration [rad/s²] (n,)."""
    inertia: Array
    """Apparent inertia: torque per joint acceleration [kg·m²] (n,)."""
    tool_covariance: Array
    """Covariance of the tool acceleration [m²/s⁴] (d, d)."""
    lowest_direction: Array
    """Direction of lowest coherence with the excitation, tool frame, unit vector (d,)."""
    lowest_coherence: float
    """Squared correlation along that direction [1]; zero by construction for one joint."""
    maximum_correlation: float
    """Highest correlation over directions [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordStatistics(SecondOrder):
    """Second- and higher-order statistics of one record; of B records as `SecondOrder`."""

    pose: Array
    """Commanded pose [rad] (n,)."""
    torque: Array
    """Rms random torque commanded [N·m] (n,)."""
    duration: float
    """Length of the record [s]."""
    skewness: Array
    """Skewness along the tool axes, whole bandwidth; 0 along one that stands still [1] (d,)."""
    kurtosis: Array
    """Excess kurtosis along the tool axes, whole bandwidth; 0 as above [1] (d,)."""
    lowest_skewness: float
    """Skewness along the direction of lowest coherence [1]."""
    lowest_kurtosis: float
    """Excess kurtosis along the direction of lowest coherence [1]."""

    @property
    def excited(self) -> NDArray[np.bool_]:
        """True for each excited joint (n,)."""
        return np.asarray(self.torque > 0)

    def __getitem__(self, k: Any) -> RecordStatistics:
        """Statistics of one record of several, or of some of them."""
        own: dict[str, Any] = {}
        for each in fields(self):
            value = getattr(self, each.name)[k]
            own[each.name] = float(value) if np.ndim(value) == 0 else value
        return RecordStatistics(**own)

    @property
    def several(self) -> RecordStatistics:
        """One record as a batch of one."""
        return RecordStatistics(**{k: np.asarray(v)[None] for k, v in vars(self).items()})  # type: ignore[arg-type]


def statistics_of(measurement: Measurement) -> RecordStatistics:
    """Work out the statistics of a measurement in which at least one joint was excited.

    Raises
    ------
    InvalidData
        If the measurement failed, or nothing moves.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.excitation import Excitation
    >>> from loose_env.faults import Healthy
    >>> from loose_env.rig import SimulatedRig
    >>> arm = planar(2)
    >>> rig = SimulatedRig(arm)
    >>> rig.mount(0, Healthy())
    >>> shake = Excitation(torque_rms=(0.0, 1.0), duration=0.4, band=arm.band)
    >>> measured = rig.measure(np.zeros(2), shake, rng=np.random.default_rng(0))
    >>> statistics_of(measured).transmission.shape
    (2, 2)
    """
    if measurement.failure is not None:
        raise InvalidData(f"the measurement failed: {measurement.failure}")
    return statistics_of_all(Records.of([measurement]))[0]


def statistics_of_all(records: Records) -> RecordStatistics:
    """Work out the statistics of B records of one arm.

    Equally many joints, one at least, were excited in each; not necessarily the same ones. The
    statistics of a record do not depend on those beside it.

    Raises
    ------
    InvalidData
        If nothing moves in one of the records.
    """
    return statistics_beside(records)[0]


def statistics_beside(
    records: Records, nominal: Array | None = None
) -> tuple[RecordStatistics, SecondOrder]:
    """As `statistics_of_all`; also of second order alone, of the records and what is predicted.

    ``nominal`` (B, P, P) has the covariances of each record that `predictions` gives, and more
    rows and columns behind. The second result is that of all records, then of all predictions.
    """
    torque, count = records.torque_rms, len(records)
    joints, raw = joints_on(torque), np.ascontiguousarray(records.tool)
    cov = _covariances(records, joints, raw)
    if nominal is not None:
        size = cov.full.shape[-1]
        full = np.concatenate([cov.full, nominal[:, :size, :size]])
        cov = RecordCovariances.of(full, joints.shape[1], 0)
        joints = np.concatenate([joints, joints])
    x_a, n = cov.x_a, torque.shape[1]
    lowest = lowest_coherence_direction_from(x_a)
    instrument = transmission_by_instrument_from(cov.command_x, cov.command_a)
    inertia = apparent_inertia_from(cov.command_x)
    both: dict[str, Any] = {
        "transmission": _spread(transmission_from(x_a), joints, n),
        "transmission_by_instrument": _spread(instrument, joints, n),
        "joint_rms": _spread(np.sqrt(np.diagonal(x_a.xx, axis1=-2, axis2=-1)), joints, n),
        "inertia": _spread(np.diagonal(inertia, axis1=-2, axis2=-1), joints, n),
        "tool_covariance": x_a.aa,
        "lowest_direction": lowest.direction,
        "lowest_coherence": lowest.coherence,
        "maximum_correlation": np.sqrt(lowest.coherences[:, -1]),
    }
    third, fourth = _shape(raw, lowest.direction[:count])
    measured: dict[str, Any] = {
        "pose": records.pose,
        "torque": torque,
        "duration": np.full(count, records.duration),
        "skewness": third[:, :-1],
        "kurtosis": fourth[:, :-1],
        "lowest_skewness": third[:, -1],
        "lowest_kurtosis": fourth[:, -1],
    }
    own = {name: values[:count] for name, values in both.items()}
    return RecordStatistics(**measured, **own), SecondOrder(**both)


def _covariances(records: Records, joints: IndexArray, motion: Array) -> RecordCovariances:
    """Covariances of records in the band with a motion (B, k, N)."""
    rows, rate, band = np.arange(len(joints))[:, None], records.rate, records.band
    command, encoder = records.command[rows, joints], records.encoder[rows, joints]
    return record_covariances(command, encoder, motion, rate=rate, band=band)


def _spread(values: Array, joints: IndexArray, n: int) -> Array:
    """Values of the excited joints (B, ..., m) among those of all (B, ..., n)."""
    last = values.ndim - 1
    wide = np.zeros((len(values), n, *values.shape[1:last]))
    wide[np.arange(len(values))[:, None], joints] = values if last == 1 else values.mT
    return wide if last == 1 else wide.mT


def _shape(tool: Array, direction: Array) -> tuple[Array, Array]:
    """Skewness and excess kurtosis along the tool axes, then along a direction (B, d + 1).

    Along an axis that stands still ideal sensors show rounding only; zero means no impacts there.
    """
    rows = np.concatenate([tool, direction[:, None] @ tool], axis=1)
    means, power, third, fourth = central_moments(rows)
    still = power <= np.maximum(_STILL * power.max(axis=-1, keepdims=True), (_STILL * means) ** 2)
    scale = np.where(still, np.inf, power)
    return third / scale**1.5, fourth / scale**2 - 3.0 * ~still


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkReadings:
    """Statistics of the accelerometers on L links with a axes each, base first.

    Of several records, arrays have an axis more in front.
    """

    transmission_by_instrument: Array
    """Acceleration per joint acceleration, the command as instrument, frame of the link
    [m, 1 where the joint slides] (L, a, n); zero for joints that were not excited."""
    rms: Array
    """Rms acceleration in the band [m/s²] (L, a)."""


def link_axes(arm: Arm, choice: LinkAccelerometers) -> tuple[str, ...]:
    """Names of the axes that each accelerometer measures.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> link_axes(planar(2), LinkAccelerometers())
    ('x', 'y')
    """
    return ("tangent",) if choice.tangential else tuple("xyz"[axis] for axis in arm.axes)


def link_readings_of_all(records: Records) -> LinkReadings:
    """Statistics of the accelerometers on links in B records; alike as for `statistics_of_all`.

    Raises
    ------
    InvalidData
        If there are none, or nothing moves.
    """
    if records.links is None:
        raise InvalidData(
            "the record has no accelerometers on links; set link_accelerometers to False, or "
            "take a rig that carries them"
        )
    count, links, axes, _ = records.links.shape
    signals = records.links.reshape(count, links * axes, -1)
    joints = joints_on(records.torque_rms)
    cov = _covariances(records, joints, signals)
    found = transmission_by_instrument_from(cov.command_x, cov.command_a)
    own = _spread(found, joints, records.torque_rms.shape[1])
    return LinkReadings(
        transmission_by_instrument=own.reshape(count, links, axes, -1),
        rms=np.sqrt(np.diagonal(cov.x_a.aa, axis1=-2, axis2=-1)).reshape(count, links, axes),
    )


def sensed_arms(arm: Arm, choice: LinkAccelerometers) -> list[Arm]:
    """Arms whose tool is the accelerometer on a link, one for each link that carries one."""
    arms = []
    for link in choice.on(arm):
        at, spec = link_site(arm, link, choice.place), arm.spec.copy()
        name = f"accelerometer{link}"
        site = spec.body(at.body).add_site(name=name, pos=list(at.position))
        if choice.tangential:
            site.quat = at.tangential_quat
        axes = (0,) if choice.tangential else arm.axes
        arms.append(dataclasses.replace(arm, spec=spec, tool=name, axes=axes))
    return arms


class NominalLinks:
    """Transmission of the nominal, healthy arm to the accelerometers on its links.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    choice : LinkAccelerometers
        Which links carry one, where, and along which axes.

    Examples
    --------
    At the proximal end link 1 sits on its own joint, which moves it nowhere.

    >>> from loose_env.arms import planar
    >>> links = NominalLinks(planar(2), LinkAccelerometers(place="proximal"))
    >>> links.transmission([[0.0, 0.5]], [[True, False]]).round(2)[0, :, :, 0].tolist()
    [[0.0, 0.0], [0.14, 0.26]]
    """

    def __init__(self, arm: Arm, choice: LinkAccelerometers) -> None:
        self._linear = [LinearArm(one) for one in sensed_arms(arm, choice)]
        self._axes = len(link_axes(arm, choice))

    def transmission(self, poses: Array, excited: NDArray[np.bool_]) -> Array:
        """Acceleration per joint acceleration at poses [rad] (B, n), command as instrument.

        Equally many joints are excited in each (B, n).

        Returns
        -------
        ndarray (B, L, a, n)
            As `LinkReadings.transmission_by_instrument`, for flat torque.
        """
        mask, q = np.asarray(excited, dtype=bool), np.asarray(poses, dtype=float)
        on, wide = joints_on(mask), np.zeros((len(q), len(self._linear), self._axes, q.shape[1]))
        rows = np.arange(len(q))[:, None]
        for k, linear in enumerate(self._linear):
            found = healthy_transmission(linear.at_all(q), mask)
            wide[rows, k, :, on] = found.mT
        return wide
