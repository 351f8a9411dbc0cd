"""Arm on position servos, read from MJCF, with sensors; simulates motions by hypothesis."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

import mujoco
import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import NDArray

from loose_env.arms import load_spec
from loose_env.errors import InvalidData
from loose_env.gap.model.hypothesis import Hypothesis, NominalParameters
from loose_env.gap.model.nominal_model import NominalModel, mass_matrix
from loose_env.gap.planned_motion import SLIDE, MotionLimits
from loose_env.gap.runs import Channel, Trial
from loose_env.gap.simulator import Simulator, changes_within
from loose_env.io import Checked, Count, Positive, Rule
from loose_env.typing import Array, IndexArray

_TORQUE_SHARE = 0.8
"""Share of a torque limit that a motion may take in the nominal model."""
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
class ServoArm(Checked):
    """Nominal model of an arm on position servos, its home pose, limits and sensors.

    Raises
    ------
    InvalidData
        If a joint is neither hinge nor slide, or no joint has a position servo.
    """

    spec: mujoco.MjSpec
    """The model, with one position servo a driven joint; never changed."""
    sensing: Sensing = Sensing()
    """Sensors."""
    tolerance: Annotated[float, Rule("between 0 and 0.5", (Gt(0), Lt(0.5)))] = 0.03
    """Relative tolerance of the nominal parameters."""
    max_speed: Positive = 2.0
    """Largest joint speed of motions [rad/s]; of slides a fifth of it [m/s]."""

    def __post_init__(self) -> None:
        """Check that there are servos to command."""
        super().__post_init__()
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
        spec.option.timestep = interval / np.ceil(interval / max(step, 5e-4) - 1e-9)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        joint, kind = mujoco.mjtObj.mjOBJ_JOINT, mujoco.mjtSensor.mjSENS_JOINTPOS
        for name in (model.joint(int(k)).name for k in _servos(model)[0]):
            spec.add_sensor(name=f"{name}_pos", type=kind, objtype=joint, objname=name)
        return spec

    @cached_property
    def machine(self) -> NominalModel:
        """Nominal model of the identification, without contacts.

        Motions are checked to stay clear of them (`check_motion`), and simulations are faster.
        """
        spec = self._prepared.copy()
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        # typical loads and speeds scale the effects' starts
        speeds = 0.5 * self.max_speed * np.where(_hinges(self.model), 1.0, SLIDE)
        return NominalModel(spec, loads=0.3 * self._all_torque_limits, speeds=speeds)

    @cached_property
    def nominal(self) -> NominalParameters:
        """Uncertain parameters of the nominal model."""
        return NominalParameters(self.machine, tolerance=self.tolerance)

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model, contacts and stops included."""
        return self._prepared.copy().compile()

    @cached_property
    def driven(self) -> IndexArray:
        """Indices of the joints with a position servo (J,)."""
        return _servos(self.spec.copy().compile())[0]

    @cached_property
    def actuators(self) -> IndexArray:
        """Index of the servo of each driven joint (J,)."""
        return _servos(self.model)[1]

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the driven joints."""
        return tuple(self.model.joint(int(k)).name for k in self.driven)

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
    def limits(self) -> MotionLimits:
        """Limits of motions: ranges, a turn about home without; speeds; most of the torques."""
        model, home = self.model, self.home
        limited, turning = model.jnt_limited[self.driven].astype(bool), _hinges(model)[self.driven]
        low, high = model.jnt_range[self.driven].T
        return MotionLimits(
            joints=self.joints, turning=turning, rate=self.sensing.rate, home=home,
            low=np.where(limited, low, home - np.pi), high=np.where(limited, high, home + np.pi),
            speed=self.max_speed * np.where(turning, 1.0, SLIDE),
            torque=_TORQUE_SHARE * self.torque_limits,
            sources=("its range", "its speed limit", f"{_TORQUE_SHARE:g} of its torque limit"),
        )  # fmt: skip

    @cached_property
    def torque_limits(self) -> Array:
        """Torque limit of each driven joint (J,) [N·m, N]; without one, from load and inertia."""
        return np.asarray(self._all_torque_limits[self.driven])

    @cached_property
    def _all_torque_limits(self) -> Array:
        """Torque limits of all joints (nv,) [N·m, N]."""
        model = self.model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        limits = 2.0 * np.abs(data.qfrc_bias) + 20.0 * np.diag(mass_matrix(model, data))
        for joint, servo in zip(self.driven, self.actuators, strict=True):
            if model.actuator_forcelimited[servo]:
                gear = abs(float(model.actuator_gear[servo, 0]))
                limits[joint] = gear * float(np.min(np.abs(model.actuator_forcerange[servo])))
        return np.asarray(limits)

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Measured channels: positions, then torques of the driven joints."""
        positions = [Channel(f"sensor.{name}_pos") for name in self.joints]
        return (*positions, *(Channel(f"torque.{name}") for name in self.joints))

    @cached_property
    def noise(self) -> Array:
        """Noise standard deviation of each channel (2 J,)."""
        positions = self.sensing.encoder_sd(self.limits.turning)
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

    def simulate(self, hypothesis: Hypothesis, commands: Array) -> Array:
        """Simulate the noise-free readings under a hypothesis, from rest at home.

        Parameters
        ----------
        hypothesis : Hypothesis
            Effects and nominal factors of the machine.
        commands : ndarray (n, J)
            Desired positions at the samples [rad, m].

        Returns
        -------
        ndarray (n, 2 J)
            Positions and torques; NaN where the simulation diverged.
        """
        simulator = Simulator(self.machine, [self._trial(commands)], self.channels, threads=1)

        def predicted(hypothesis: Hypothesis) -> Array:
            return simulator.predict([hypothesis])[0][0]

        found = predicted(hypothesis)
        if changes_within(self.machine, hypothesis, self.channels):
            # what shifts commands is read at other moments of a step: only its difference from the
            # same machine without effects, read alike, is the effect
            plain = hypothesis.with_effects([])
            alike = replace(plain, stepped_as=hypothesis.effects)
            found = found - predicted(alike) + predicted(plain)
        return found

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
            name="motion", form="forward", time=np.arange(count) / self.sensing.rate,
            measured=np.zeros((count, len(self.channels))), step=step, steps=len(controls),
            controls=controls, position=position, speed=np.zeros(self.model.nv), resting=True,
        )  # fmt: skip

    def measured(self, readings: Array, rng: np.random.Generator) -> Array:
        """Add encoder noise, quantisation and torque noise to readings (n, 2 J)."""
        count = len(self.joints)
        found = readings + rng.normal(size=readings.shape) * np.concatenate(
            [np.full(count, self.sensing.encoder_noise), self.noise[count:]]
        )
        quantum = self.sensing.quantum(self.limits.turning)
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


def _hinges(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Mask of the joints that are hinges."""
    return np.asarray(model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE))


def _servos(model: mujoco.MjModel) -> tuple[IndexArray, IndexArray]:
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
