"""Arm on position servos, limits of its motions, and what a model does in them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

import mujoco
import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import NDArray

from loose_env.arms import load_spec
from loose_env.errors import InvalidData
from loose_env.gap.model.hypothesis import JOINT, Hypothesis, scale
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import SETTLE, Channel, align_run
from loose_env.gap.simulator import Simulator
from loose_env.io import Checked, Positive, Rule
from loose_env.recording import CommandTiming, Run
from loose_env.typing import Array, IndexArray

SLIDE = 0.2  # limits of slides over those of hinges: metres for radians
RATE = 250.0  # rate at which its sensors are read [1/s]
_ENCODER_STEPS = 2**14  # steps of an encoder per turn; of a slide, per metre
_ENCODER_NOISE = 1.5e-4  # standard deviation of its noise before quantisation [rad, m]
_TORQUE_NOISE = 0.005  # standard deviation of the measured torque over the torque limit
_OVERSHOOT = 1.25
"""Speed of the machine over the limit of its commands: a servo overshoots after a step."""
_ROOM = 1e-6  # rounding that a limit does not count
_TORQUE_SHARE = 0.8  # share of a torque limit that a motion may take in the nominal model
_STABLE = 1.0
"""Largest rate of a rotor's damping times the time step: of Runge-Kutta's 2.8 the damping of the
stiffest spring takes as much again, and effects add to the joint's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedMotion:
    """A motion as it is given to a machine and as its model answers."""

    desired: Array  # Desired joint positions [rad, m] (T, joints)
    interval: float  # Interval of the samples [s]
    controls: Array  # Commands of the actuators, in their own units (T, actuators)
    position: Array  # Joint positions of the model [rad, m] (T, joints)
    speed: Array  # Joint speeds of the model [rad/s, m/s] (T, joints)
    torque: Array  # Torque of the drives on the joints [N·m, N] (T, joints)
    readings: Array  # Readings of all sensors of the model (T, sensordata)
    contacts: tuple[tuple[str, str], ...]  # Pairs of bodies that touch and do not at the beginning
    saturated: tuple[str, ...]  # Actuators that reach the range of their force

    @property
    def time(self) -> Array:
        """Sample times [s], from 0 (T,)."""
        return np.arange(len(self.desired), dtype=float) * self.interval


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionLimits:
    """Limits of the joints, with where they come from."""

    joints: tuple[str, ...]  # Names of the joints
    turning: NDArray[np.bool_]  # Whether each of them is a hinge (joints,)
    rate: float  # Sample rate [1/s]
    home: Array  # Pose in which motions begin and end [rad, m] (joints,)
    low: Array  # Lowest positions [rad, m] (joints,)
    high: Array  # Highest positions [rad, m] (joints,)
    speed: Array  # Largest speeds [rad/s, m/s] (joints,)
    torque: Array  # Largest torques of the drives [N·m, N] (joints,), infinite where none is known
    sources: tuple[str, str, str]  # Where those of position, speed and torque come from

    @property
    def unit(self) -> Array:
        """Size of a motion of each joint over that of a hinge (joints,)."""
        return np.where(self.turning, 1.0, SLIDE)

    def refusal(self, motion: PlannedMotion) -> str:
        """Reason why a motion does not fit, "" if it does."""
        if not (np.isfinite(motion.position).all() and np.isfinite(motion.torque).all()):
            return "the model does not follow it"
        if motion.contacts:
            return f"{motion.contacts[0][0]} and {motion.contacts[0][1]} would touch"
        low = np.minimum(motion.position, motion.desired).min(axis=0)
        high = np.maximum(motion.position, motion.desired).max(axis=0)
        for k in np.flatnonzero((low < self.low - _ROOM) | (high > self.high + _ROOM)):
            may = f"it may from {self.low[k]:.3g} to {self.high[k]:.3g} ({self.sources[0]})"
            return f"{self.joints[k]} would move from {low[k]:.3g} to {high[k]:.3g}; {may}"
        if motion.saturated:
            return f"{motion.saturated[0]} would reach the range of its force"
        wanted = np.abs(np.gradient(motion.desired, motion.time, axis=0)).max(axis=0)
        speed = np.maximum(wanted, np.abs(motion.speed).max(axis=0) / _OVERSHOOT)
        found = np.stack([speed, np.abs(motion.torque).max(axis=0)])
        limits = np.stack([self.speed, self.torque])
        for row, k in np.argwhere(found > limits * (1 + _ROOM)):
            need = f"a {('speed', 'torque')[row]} of {found[row, k]:.3g}"
            may = f"it may have {limits[row, k]:.3g} ({self.sources[1 + row]})"
            return f"{self.joints[k]} would need {need}; {may}"
        return ""

    def notes(self, motion: PlannedMotion) -> tuple[str, ...]:
        """What was checked, with the margins left."""
        room = np.minimum(motion.position - self.low, self.high - motion.position).min()
        fastest = float(np.max(np.abs(motion.speed) / self.speed))
        torques = "torques: the model and the recording state no limit; not checked"
        if np.isfinite(self.torque).any():
            share = float(np.max(np.abs(motion.torque).max(axis=0) / self.torque))
            torques = f"torques reach {share:.0%} of their limit ({self.sources[2]})"
        return (
            f"joint positions stay {room:.3g} rad or m within their range ({self.sources[0]})",
            f"joint speeds reach {fastest:.0%} of their limit ({self.sources[1]})",
            torques,
            "collisions: no two bodies of the model touch that do not at the beginning",
        )


def followed(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    desired: Array,
    interval: float,
    where: tuple[IndexArray, IndexArray],
    command: Callable[[int], None],
    *,
    held: bool = True,
) -> PlannedMotion:
    """Simulate a motion from a state, with a command at each sample, contacts included."""
    # Held by its first command before, unless that depends on the state.
    at, dofs = where
    if held:
        command(0)
        mujoco.mj_step(model, data, round(SETTLE / model.opt.timestep))
    mujoco.mj_forward(model, data)
    before = _touching(model, data)  # what touches at home may
    met, saturated = dict[tuple[str, str], None](), dict[str, None]()
    position, speed, torque = np.zeros((3, *desired.shape))
    controls, readings = (np.zeros((len(desired), n)) for n in (model.nu, model.nsensordata))
    limited, (low, high) = model.actuator_forcelimited.astype(bool), model.actuator_forcerange.T
    for row in range(len(desired)):
        for _ in range(round(interval / model.opt.timestep) if row else 0):
            mujoco.mj_step(model, data)
            met |= dict.fromkeys(sorted(_touching(model, data) - before))
        mujoco.mj_forward(model, data)
        position[row], speed[row], readings[row] = data.qpos[at], data.qvel[dofs], data.sensordata
        torque[row] = data.qfrc_actuator[dofs]
        force = data.actuator_force
        for k in np.flatnonzero(limited & ~((low < force) & (force < high))):
            saturated[model.actuator(int(k)).name] = None
        command(row)
        controls[row] = data.ctrl
        torque[row] += data.qfrc_applied[dofs]
    return PlannedMotion(
        desired=desired, interval=interval, controls=controls, position=position, speed=speed,
        torque=torque, readings=readings, contacts=tuple(met), saturated=tuple(saturated),
    )  # fmt: skip


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[str, str]]:
    """Pairs of bodies in contact."""
    near = (c for c in map(data.contact.__getitem__, range(data.ncon)) if c.dist <= 0)
    names = (sorted(model.body(int(model.geom_bodyid[g])).name for g in c.geom) for c in near)
    return {(one, two) for one, two in names}


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
        """Copy with an encoder at every driven joint and with a step that divides the samples."""
        # Runge-Kutta at 2 ms errs by less than a fifth of the noise; the implicit integrator by six
        # times the noise, and differently for effects that need other steps. It is stable up to a
        # rate times the step of 2.8 (E. Hairer and G. Wanner, Solving Ordinary Differential
        # Equations II, IV.2), and the fastest rate is that of a drive whose rotor a compliance sets
        # free.
        spec = self.spec.copy()
        model, interval = spec.copy().compile(), 1.0 / RATE
        for sensor in list(spec.sensors):
            spec.delete(sensor)
        step = min(float(model.opt.timestep), _STABLE / max(_rotor_rate(model), 1e-9))
        spec.option.timestep = interval / np.ceil(interval / max(step, 5e-4) - 1e-9)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        joint, kind = mujoco.mjtObj.mjOBJ_JOINT, mujoco.mjtSensor.mjSENS_JOINTPOS
        for name in (model.joint(int(k)).name for k in _servos(model)[0]):
            spec.add_sensor(name=f"{name}_pos", type=kind, objtype=joint, objname=name)
        return spec

    @cached_property
    def machine(self) -> NominalModel:
        """Nominal model of the identification, without contacts."""
        # Motions are checked to stay clear of them (`check_motion`), and simulations are faster.
        spec = self._prepared.copy()
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        # typical loads and speeds scale the effects' starts
        speeds = 0.5 * self.max_speed * np.where(NominalModel(spec).hinges, 1.0, SLIDE)
        return NominalModel(spec, loads=0.3 * self._all_torque_limits, speeds=speeds)

    @cached_property
    def uncertain(self) -> tuple[tuple[str, str], ...]:
        """Attribute and element of the parameters that are known within the tolerance."""
        model, machine = self.machine.model, self.machine
        links = [link for link in machine.links if model.body(link).mass[0] > 0]
        found = [(name, link) for link in links for name in ("mass", "inertia")]
        for k, joint in enumerate(machine.joints):
            of_joint = (getattr(model, f"dof_{name}")[model.jnt_dofadr[k]] for name in JOINT)
            found += [(f, joint) for f, value in zip(JOINT, of_joint, strict=True) if value > 0]
        for actuator, damping in zip(machine.actuators, model.actuator_biasprm[:, 2], strict=True):
            found += [("gain", actuator), ("velocity_gain", actuator)][: 1 + bool(damping != 0)]
        return tuple(found)

    def off(self, factors: Array) -> mujoco.MjSpec:
        """Model of the identification whose uncertain parameters are scaled by factors (P,)."""
        spec = self.machine.fresh()
        for (name, of), factor in zip(self.uncertain, factors, strict=True):
            scale(spec, name, of, factor)
        return spec

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model, contacts and stops included."""
        return self._prepared.copy().compile()

    @cached_property
    def servos(self) -> tuple[IndexArray, IndexArray]:
        """Indices of the joints with a position servo, and of the servo of each (J,)."""
        return _servos(self.spec.copy().compile())

    @property
    def driven(self) -> IndexArray:
        """Indices of the joints with a position servo (J,)."""
        return self.servos[0]

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the driven joints."""
        return tuple(self.model.joint(int(k)).name for k in self.driven)

    @cached_property
    def rest(self) -> tuple[Array, Array]:
        """Home pose of all joints (nq,), with the inputs of all actuators there (nu,)."""
        # Key "home", else the first key, else the middle of the range of each driven joint.
        model = self.model
        names = [model.key(k).name for k in range(model.nkey)]
        if names:
            key = names.index("home") if "home" in names else 0
            return model.key_qpos[key].copy(), model.key_ctrl[key].copy()
        pose = model.qpos0.copy()
        limited = self.driven[model.jnt_limited[self.driven].astype(bool)]
        pose[limited] = model.jnt_range[limited].mean(axis=1)
        return pose, np.zeros(model.nu)

    @property
    def home(self) -> Array:
        """Home pose of the driven joints (J,)."""
        return np.asarray(self.rest[0][self.driven])

    @cached_property
    def limits(self) -> MotionLimits:
        """Limits of motions: ranges, a turn about home without; speeds; most of the torques."""
        home, turning = self.home, self.machine.hinges[self.driven]
        limited = self.model.jnt_limited[self.driven].astype(bool)
        low, high = self.model.jnt_range[self.driven].T
        return MotionLimits(
            joints=self.joints, turning=turning, rate=RATE, home=home,
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
        machine = NominalModel(self._prepared)
        own, bias = machine.torque_limits, machine.at_zero.qfrc_bias
        return np.where(np.isfinite(own), own, 2.0 * np.abs(bias) + 20.0 * machine.inertias)

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Measured channels: positions, then torques of the driven joints."""
        columns = [f"sensor.{name}_pos" for name in self.joints]
        return tuple(map(Channel, (*columns, *(f"torque.{name}" for name in self.joints))))

    @cached_property
    def noise(self) -> Array:
        """Noise standard deviation of each channel (2 J,)."""
        positions = np.hypot(_ENCODER_NOISE, self._quantum / np.sqrt(12))
        return np.concatenate([positions, _TORQUE_NOISE * self.torque_limits])

    @property
    def _quantum(self) -> Array:
        """Step of each encoder [rad, m] (J,)."""
        return np.where(self.limits.turning, 2 * np.pi, 1.0) / _ENCODER_STEPS

    @cached_property
    def key(self) -> str:
        """Digest of model, sensors, tolerance and speed: what columns depend on."""
        sensors = RATE, _ENCODER_STEPS, _ENCODER_NOISE, _TORQUE_NOISE, self.tolerance
        text = f"{self._prepared.to_xml()}{sensors!r}{(self.max_speed, mujoco.__version__)!r}"
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def controls(self, commands: Array) -> Array:
        """Inputs of all actuators (n, nu) for desired positions of the driven joints (n, J)."""
        given = np.tile(self.rest[1], (len(commands), 1))
        given[:, self.servos[1]] = commands
        return given

    def play(self, desired: Array) -> PlannedMotion:
        """Play desired positions (n, J) on the nominal model, contacts and stops included."""
        controls, data = self.controls(desired), mujoco.MjData(self.model)
        data.qpos[:] = self.rest[0]

        def command(row: int) -> None:
            data.ctrl[:] = controls[row]

        # joints are hinges and slides: one position and one speed each
        where = (self.driven, self.driven)
        return followed(self.model, data, desired, 1 / RATE, where, command)

    def simulate(
        self, hypothesis: Hypothesis, commands: Array, factors: Array | None = None
    ) -> Array:
        """Simulate the noise-free readings under a hypothesis, from rest at home.

        Parameters
        ----------
        hypothesis : Hypothesis
            Effects of the machine.
        commands : ndarray (n, J)
            Desired positions at the samples [rad, m].
        factors : ndarray (P,), optional
            Factors on its uncertain parameters; as in the model by default.

        Returns
        -------
        ndarray (n, 2 J)
            Positions and torques; NaN where the simulation diverged.
        """
        controls = dict(zip(self.machine.actuators, self.controls(commands).T, strict=True))
        run = Run(
            name="motion", time=np.arange(len(commands)) / RATE, controls=controls,
            commands=dict.fromkeys(controls, CommandTiming(mode="linear")),
        )  # fmt: skip
        trial = align_run(run, self.machine, self.channels, step=self.machine.time_step)
        trial = replace(trial, position=self.rest[0], resting=True)
        machine = self.machine if factors is None else NominalModel(self.off(factors))
        simulator = Simulator(machine, [trial], self.channels, threads=1)
        return simulator.predict([hypothesis])[0][0]

    def measured(self, readings: Array, rng: np.random.Generator) -> Array:
        """Add encoder noise, quantisation and torque noise to readings (n, 2 J)."""
        count = len(self.joints)
        noise = np.concatenate([np.full(count, _ENCODER_NOISE), self.noise[count:]])
        found = readings + rng.normal(size=readings.shape) * noise
        found[:, :count] = self._quantum * np.round(found[:, :count] / self._quantum)
        return np.asarray(found)


def read_servo_arm(
    path: str | Path, *, tolerance: float = 0.03, max_speed: float = 2.0
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
    return ServoArm(spec, tolerance, max_speed)


def _servos(model: mujoco.MjModel) -> tuple[IndexArray, IndexArray]:
    """Driven joints, in the model's order, and the servo of each."""
    gain, kinds = model.actuator_gainprm[:, 0], model.actuator_trntype
    closes = (kinds == mujoco.mjtTrn.mjTRN_JOINT) & (gain > 0)
    closes &= np.isclose(model.actuator_biasprm[:, 1], -gain)
    found = {int(model.actuator_trnid[k, 0]): int(k) for k in np.flatnonzero(closes)}
    return np.array(sorted(found), dtype=int), np.array([found[k] for k in sorted(found)], int)


def _rotor_rate(model: mujoco.MjModel) -> float:
    """Damping of joint and servo over the rotor inertia, of the fastest drive [1/s]; 0 of none."""
    joints, servos = _servos(model)
    dofs = model.jnt_dofadr[joints]
    servo = -model.actuator_biasprm[servos, 2] * model.actuator_gear[servos, 0] ** 2
    damping, inertia = model.dof_damping[dofs] + servo, model.dof_armature[dofs]
    return float(np.max(damping[inertia > 0] / inertia[inertia > 0], initial=0.0))
