"""Closed-form prediction of the nominal, healthy arm in a pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from loose_env.arms import Arm, LinearPose
from loose_env.excitation import Excitation
from loose_env.sensors import SensorSuite
from loose_env.statistics import Covariances, LowestCoherence, lowest_coherence_direction_from
from loose_env.typing import Array

__all__ = ["Prediction", "SensorFloor", "predict", "predictions"]


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
        """Work out the floor of a set of sensors in a band [Hz].

        Readings are taken to be white, quantisation included; twice differentiated, the
        encoder's noise rises with the square of the frequency.
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


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Second-order statistics of one record; m joints are excited.

    The command is scaled to its rms; all covariances are in-band. Of B records together, as
    `predictions` gives them, every number is an array (B,) and every array has an axis more in
    front.
    """

    joint: Array
    """Covariance of the excited joints' accelerations (m, m) [rad²/s⁴]."""
    joint_tool: Array
    """Covariance of joint and tool acceleration (m, d) [rad/s² m/s²]."""
    tool: Array
    """Covariance of the tool acceleration (d, d) [m²/s⁴]."""
    command_joint: Array
    """Covariance of command and joint acceleration (m, m) [N·m rad/s²]."""
    command_tool: Array
    """Covariance of command and tool acceleration (m, d) [N·m m/s²]."""

    command: Array
    """Covariance of the command, diagonal (m, m) [N²·m²]."""

    @property
    def transmission(self) -> Array:
        """Regression of the tool on the measured joint accelerations (d, m) [m]."""
        return np.asarray(np.linalg.solve(self.joint, self.joint_tool).mT)

    @property
    def transmission_by_instrument(self) -> Array:
        """The same with the command as instrument: free of encoder noise (d, m) [m]."""
        return np.asarray(np.linalg.solve(self.command_joint, self.command_tool).mT)

    @property
    def inertia(self) -> Array:
        """Apparent inertia of each excited joint (m,) [kg·m²]."""
        found = np.linalg.solve(self.command_joint, self.command)
        return np.asarray(np.diagonal(found, axis1=-2, axis2=-1))

    @cached_property
    def _lowest(self) -> LowestCoherence:
        return lowest_coherence_direction_from(
            Covariances(xx=self.joint, xa=self.joint_tool, aa=self.tool, count=0)
        )

    @property
    def lowest_direction(self) -> Array:
        """Direction of lowest coherence with the excitation, tool frame, unit vector (d,)."""
        return self._lowest.direction

    @property
    def lowest_coherence(self) -> float:
        """Squared correlation along that direction [1]."""
        return self._lowest.coherence

    @property
    def maximum_correlation(self) -> float:
        """Highest correlation over directions [1]."""
        highest: Any = np.sqrt(self._lowest.coherences[..., -1])
        return highest  # type: ignore[no-any-return]

    def __getitem__(self, k: int) -> Prediction:
        """Prediction of one record of several."""
        return Prediction(**{each.name: getattr(self, each.name)[k] for each in fields(self)})


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
    return predictions([pose], [excitation], floor)[0]


def predictions(
    poses: Sequence[LinearPose], excitations: Sequence[Excitation], floor: SensorFloor
) -> Prediction:
    """Predict several records of the nominal, healthy arm, in which equally many joints are on.

    Parameters
    ----------
    poses : sequence of B LinearPose
        One nominal arm at several poses.
    excitations : sequence of B Excitation
        Excitations.
    floor : SensorFloor
        Noise of the sensors.

    Returns
    -------
    Prediction
        Of all records; arrays have a first axis of length B.
    """
    arm = poses[0].linear.arm
    levels = np.array([excitation.torque_rms for excitation in excitations])
    on = levels > 0
    responses = poses[0].linear.responses(poses, on)
    joints = np.nonzero(on)[1].reshape(len(poses), -1)
    torque = np.take_along_axis(levels, joints, axis=1)
    noise = floor.joints(arm)[joints]
    answers = np.array([answer.acceleration for answer in responses])
    joint = np.take_along_axis(answers, joints[:, None, :, None], axis=2)
    tool = np.array([answer.tool for answer in responses])
    # Spectra averaged over the band: joint (B, K, m, m), tool (B, K, d, m).
    count, axes = tool.shape[1:3]
    x, a = joint * torque[:, None, None], tool * torque[:, None, None]
    return Prediction(
        joint=np.einsum("bkim,bkjm->bij", x, x.conj()).real / count + _diagonal(noise**2),
        joint_tool=np.einsum("bkim,bkdm->bid", x, a.conj()).real / count,
        tool=np.einsum("bkim,bkjm->bij", a, a.conj()).real / count + floor.tool**2 * np.eye(axes),
        # The command of joint j drives column j alone.
        command_joint=np.einsum("bkim,bm->bmi", x, torque).real / count,
        command=_diagonal(torque**2),
        command_tool=np.einsum("bkdm,bm->bmd", a, torque).real / count,
    )


def _diagonal(values: Array) -> Array:
    """Diagonal matrices of rows (B, m, m)."""
    return np.asarray(values[..., None] * np.eye(values.shape[-1]))
