"""Arm on position servos, read from MJCF, with sensors; simulates motions by hypothesis."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import load_spec
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap.model.hypothesis import Hypothesis, NominalParameters
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import Channel, Trial
from loose_env.gap.simulator import Simulator, changes_within
from loose_env.io import Checked, Count, Positive
from loose_env.typing import Array

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_STABLE = 1.0
"""Largest rate of a rotor's damping times the time step: of Runge-Kutta's 2.8 the damping of the
stiffest spring takes as much again, and effects add to the joint's."""


@dataclass(frozen=True, kw_only=True)
class Sensing(Checked):
    """Sensors of the machine: encoders and drive torques, read at one rate.

    Examples
    --------
    >>> Sensing(encoder_steps=1000).quantum(np.array([True, False])).round(5).tolist()
    [0.00628, 0.001]
    """

    rate: Positive = 250.0
    """Sample rate [1/s]."""
    encoder_steps: Count = 2**14
    """Steps of an encoder per turn; of a slide, per metre."""
    encoder_noise: Positive = 1.5e-4
    """Standard deviation of the noise before quantisation [rad, m]."""
    torque_noise: Positive = 0.005
    """Standard deviation of the measured torque over the torque limit [1]."""

    def quantum(self, turning: NDArray[np.bool_]) -> Array:
        """Step of each encoder, of hinges and of slides [rad, m] (J,)."""
        return np.where(turning, 2 * np.pi, 1.0) / self.encoder_steps

    def encoder_sd(self, turning: NDArray[np.bool_]) -> Array:
        """Standard deviation of readings, quantisation as white noise [rad, m] (J,)."""
        return np.asarray(np.hypot(self.encoder_noise, self.quantum(turning) / np.sqrt(12)))


@dataclass(frozen=True, eq=False)
class ServoArm:
    """Nominal model of an arm on position servos, its home pose, limits and sensors.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The model, with one position servo a driven joint; never changed.
    sensing : Sensing
        Sensors.
    tolerance : float
        Relative tolerance of the nominal parameters.
    max_speed : float
        Largest joint speed of motions [rad/s]; of slides a fifth of it [m/s].

    Raises
    ------
    InvalidData
        If a joint is neither hinge nor slide, or no joint has a position servo.
    """

    spec: mujoco.MjSpec
    sensing: Sensing = Sensing()
    tolerance: float = 0.03
    max_speed: float = 2.0

    def __post_init__(self) -> None:
        """Check that there are servos to command."""
        if not 0 < self.tolerance < 0.5:
            raise InvalidSetting(f"tolerance lies between 0 and 0.5, got {self.tolerance!r}")
        if not self.max_speed > 0:
            raise InvalidSetting(f"max_speed is above 0 rad/s, got {self.max_speed!r}")
        if not len(self.driven):
            raise InvalidData(
                "the model has no position servo: motions are commanded as joint positions, so "
                "each driven joint needs a <position> actuator"
            )

    @cached_property
    def _prepared(self) -> mujoco.MjSpec:
        """Copy with an encoder at every driven joint and with a step that divides the samples.

        Runge-Kutta at 2 ms errs by less than a fifth of the noise; the implicit integrator by six
        times the noise, and differently for effects that need other steps. It is stable up to a
        rate times the step of 2.8 (E. Hairer and G. Wanner, Solving Ordinary Differential Equations
        II, IV.2), and the fastest rate is that of a drive whose rotor a compliance sets free.
        """
        spec = self.spec.copy()
        model = spec.copy().compile()
        for sensor in list(spec.sensors):
            spec.delete(sensor)
        interval = 1.0 / self.sensing.rate
        step = min(float(model.opt.timestep), _STABLE / max(_rotor_rate(model), 1e-9))
        steps = np.ceil(interval / max(step, 5e-4) - 1e-9)
        spec.option.timestep = interval / steps
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        for name in (model.joint(int(k)).name for k in _servos(model)[0]):
            spec.add_sensor(
                name=f"{name}_pos",
                type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=name,
            )
        return spec

    @cached_property
    def machine(self) -> NominalModel:
        """Nominal model of the identification, without contacts.

        Motions are checked to stay clear of them (`check_motion`), and simulations are faster.
        """
        spec = self._prepared.copy()
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        # typical loads and speeds scale the effects' starts
        return NominalModel(spec, loads=0.3 * self.all_torque_limits, speeds=self._speeds)

    @cached_property
    def nominal(self) -> NominalParameters:
        """Uncertain parameters of the nominal model."""
        return NominalParameters(self.machine, tolerance=self.tolerance)

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model, contacts and stops included."""
        return self._prepared.copy().compile()

    @cached_property
    def driven(self) -> Array:
        """Indices of the joints with a position servo (J,)."""
        return _servos(self.spec.copy().compile())[0]

    @cached_property
    def actuators(self) -> Array:
        """Index of the servo of each driven joint (J,)."""
        return _servos(self.model)[1]

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the driven joints."""
        return tuple(self.model.joint(int(k)).name for k in self.driven)

    @cached_property
    def turning(self) -> NDArray[np.bool_]:
        """Whether each driven joint is a hinge (J,)."""
        return np.asarray(self.model.jnt_type[self.driven] == _HINGE)

    @cached_property
    def home(self) -> Array:
        """Home pose: key "home", else the first key, else the middle of each range (J,)."""
        model = self.model
        if self._key is not None:
            return np.asarray(self.rest_position[self.driven], dtype=float)
        middle = model.jnt_range.mean(axis=1)
        return np.asarray(np.where(model.jnt_limited, middle, model.qpos0)[self.driven])

    @cached_property
    def _key(self) -> int | None:
        """Number of the key of the home pose; None without keys."""
        names = [self.model.key(k).name for k in range(self.model.nkey)]
        return (names.index("home") if "home" in names else 0) if names else None

    @property
    def rest_position(self) -> Array:
        """Positions of all joints with the driven ones anywhere: of the home pose's key (nq,)."""
        pose = self.model.qpos0 if self._key is None else self.model.key_qpos[self._key]
        return np.array(pose, dtype=float)

    @cached_property
    def ranges(self) -> tuple[Array, Array]:
        """Range of each driven joint, low and high (J,), a turn about home without limits."""
        model = self.model
        limited = model.jnt_limited[self.driven].astype(bool)
        low = np.where(limited, model.jnt_range[self.driven, 0], self.home - np.pi)
        high = np.where(limited, model.jnt_range[self.driven, 1], self.home + np.pi)
        return low, high

    @cached_property
    def speed_limits(self) -> Array:
        """Largest speeds of motions (J,) [rad/s, m/s]."""
        return np.where(self.turning, self.max_speed, 0.2 * self.max_speed)

    @cached_property
    def torque_limits(self) -> Array:
        """Torque limit of each driven joint (J,) [N·m, N]; without one, from load and inertia."""
        return np.asarray(self.all_torque_limits[self.driven])

    @cached_property
    def all_torque_limits(self) -> Array:
        """Torque limits of all joints (nv,) [N·m, N]."""
        model = self.model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        limits = 2.0 * np.abs(data.qfrc_bias) + 20.0 * np.diag(mass)
        for joint, servo in zip(self.driven, self.actuators, strict=True):
            if model.actuator_forcelimited[servo]:
                gear = abs(float(model.actuator_gear[servo, 0]))
                limits[joint] = gear * float(np.min(np.abs(model.actuator_forcerange[servo])))
        return np.asarray(limits)

    @property
    def _speeds(self) -> Array:
        turning = self.model.jnt_type == _HINGE
        return np.asarray(0.5 * self.max_speed * np.where(turning, 1.0, 0.2))

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Measured channels: positions, then torques of the driven joints."""
        positions = [Channel(f"sensor.{name}_pos") for name in self.joints]
        return (*positions, *(Channel(f"torque.{name}") for name in self.joints))

    @cached_property
    def noise(self) -> Array:
        """Noise standard deviation of each channel (2 J,)."""
        positions = self.sensing.encoder_sd(self.turning)
        return np.concatenate([positions, self.sensing.torque_noise * self.torque_limits])

    @cached_property
    def key(self) -> str:
        """Digest of model, sensing, tolerance and speed: what columns depend on."""
        text = self._prepared.to_xml() + repr((asdict(self.sensing), self.tolerance))
        text += repr((self.max_speed, mujoco.__version__))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def controls(self, commands: Array) -> Array:
        """Inputs of all actuators (n, nu) for desired positions of the driven joints (n, J)."""
        given = np.zeros((len(commands), self.model.nu))
        if self._key is not None:
            given[:] = self.model.key_ctrl[self._key]
        given[:, self.actuators] = commands
        return given

    def simulate(self, hypotheses: Sequence[Hypothesis], commands: Array) -> list[Array]:
        """Simulate the noise-free readings under each hypothesis, from rest at home.

        Parameters
        ----------
        hypotheses : sequence of Hypothesis
            Effects and nominal factors of the machine.
        commands : ndarray (n, J)
            Desired positions at the samples [rad, m].

        Returns
        -------
        list of ndarray (n, 2 J)
            Positions and torques; NaN where a simulation diverged.
        """
        simulator = Simulator(self.machine, [self._trial(commands)], self.channels, threads=1)

        def predicted(own: Sequence[Hypothesis]) -> list[Array]:
            return [run for (run,) in simulator.predict(own)]

        readings = predicted(hypotheses)
        within = [
            k
            for k, hypothesis in enumerate(hypotheses)
            if changes_within(self.machine, hypothesis, self.channels)
        ]
        # what shifts commands is read at other moments of a step: only its difference from the
        # same machine without effects, read alike, is the effect
        plain = [hypotheses[k].with_effects([]) for k in within]
        alike = [
            replace(each, stepped_as=hypotheses[k].effects)
            for k, each in zip(within, plain, strict=True)
        ]
        for k, at, of in zip(within, predicted(plain), predicted(alike), strict=True):
            readings[k] = readings[k] - of + at
        return readings

    @property
    def parts(self) -> int:
        """Steps of a simulation from sample to sample."""
        return round(1.0 / (self.sensing.rate * float(self.machine.model.opt.timestep)))

    def held(self, commands: Array, finer: int = 1) -> Array:
        """Commands that act, held, at the steps of a simulation or finer (n · parts · finer, nu).

        Each acts from half-way between two samples on, so that sensors are read in the middle of it
        and no small delay decides whether they see the old or the new one.
        """
        given = np.repeat(self.controls(commands), self.parts * finer, axis=0)
        late = self.parts // 2 * finer
        return np.concatenate([np.repeat(given[:1], late, axis=0), given])[: len(given)]

    def _trial(self, commands: Array) -> Trial:
        count, step = len(commands), float(self.machine.model.opt.timestep)
        controls = self.held(commands)[: (count - 1) * self.parts + 1]
        position = self.rest_position
        position[self.driven] = self.home
        return Trial(
            name="motion",
            form="forward",
            time=np.arange(count) / self.sensing.rate,
            measured=np.zeros((count, len(self.channels))),
            step=step,
            steps=len(controls),
            controls=controls,
            position=position,
            speed=np.zeros(self.model.nv),
            resting=True,
        )

    def measured(self, readings: Array, rng: np.random.Generator) -> Array:
        """Add encoder noise, quantisation and torque noise to readings (n, 2 J)."""
        count = len(self.joints)
        found = readings + rng.normal(size=readings.shape) * np.concatenate(
            [np.full(count, self.sensing.encoder_noise), self.noise[count:]]
        )
        quantum = self.sensing.quantum(self.turning)
        found[:, :count] = quantum * np.round(found[:, :count] / quantum)
        return np.asarray(found)


def read_servo_arm(
    path: str | Path,
    *,
    sensing: Sensing | None = None,
    tolerance: float = 0.03,
    max_speed: float = 2.0,
) -> ServoArm:
    """Read an MJCF file as an arm on position servos.

    Raises
    ------
    InvalidData
        If it cannot be read, or has no position servos.

    Examples
    --------
    >>> from loose_env.arms import SERVO_ARM
    >>> read_servo_arm(SERVO_ARM).joints
    ('joint1', 'joint2', 'joint3')
    """
    spec = load_spec(path)[2]
    try:
        spec.copy().compile()
    except ValueError as error:
        raise InvalidData(f"MuJoCo does not compile {path}: {error}") from error
    return ServoArm(spec, sensing or Sensing(), tolerance, max_speed)


def touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[str, str]]:
    """Pairs of bodies in contact."""
    found = set()
    for k in range(data.ncon):
        contact = data.contact[k]
        if contact.dist <= 0:
            one, two = (model.body(int(model.geom_bodyid[g])).name for g in contact.geom)
            found.add((min(one, two), max(one, two)))
    return found


def _servos(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Driven joints, in the model's order, and the servo of each."""
    found = {}
    for k in range(model.nu):
        at_joint = model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT
        closes = np.isclose(model.actuator_biasprm[k, 1], -model.actuator_gainprm[k, 0])
        if at_joint and closes and model.actuator_gainprm[k, 0] > 0:
            found[int(model.actuator_trnid[k, 0])] = k
    return np.array(sorted(found), dtype=int), np.array([found[k] for k in sorted(found)], int)


def _rotor_rate(model: mujoco.MjModel) -> float:
    """Damping of joint and servo over the rotor inertia, of the fastest drive [1/s]; 0 of none."""
    joints, servos = _servos(model)
    dofs = model.jnt_dofadr[joints]
    servo = -model.actuator_biasprm[servos, 2] * model.actuator_gear[servos, 0] ** 2
    inertia = model.dof_armature[dofs]
    there = inertia > 0
    return float(np.max(((model.dof_damping[dofs] + servo)[there] / inertia[there]), initial=0.0))
