"""Motions before they are made: limits of the joints, and what the corrected model does in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Literal

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.core.motion import Motion
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.corrected_model import step_for
from loose_env.gap.servo_arm import Sensing, ServoArm, touching
from loose_env.io import Checked, Count, NonNegative, Positive
from loose_env.recording import Recording, Run, joint_sensors
from loose_env.typing import Array

CommandMode = Literal["position", "speed", "torque", "none"]
"""What commands of the recording's actuators are; "none" where runs have no commands."""

_SLIDE = 0.2
"""Limits of slides over those of hinges: metres for radians."""
_OVERSHOOT = 1.25
"""Speed of the machine over the limit of its commands: a servo overshoots after a step."""
_ROOM = 1e-6
"""Rounding that a limit does not count."""
_CONTROL_HZ = 3.0
"""Bandwidth of the controller that is assumed where the model has no servo [Hz]."""
_SETTLE_S = 0.5
"""How long a servo holds the first pose before a motion [s]."""
_SEED = 7
"""Seed of the sensors' noise."""


@dataclass(frozen=True, kw_only=True)
class NextMotionSettings(Checked):
    """Limits of the next motion, and what it costs.

    Examples
    --------
    >>> NextMotionSettings(next_max_speed_rad_s=-1.0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: NextMotionSettings.next_max_speed_rad_s must be ...
    """

    next_max_speed_rad_s: NonNegative = 0.0
    """Largest joint speed [rad/s]; of slides a fifth of it [m/s]; 0 for the fastest that the
    recorded runs were."""
    next_reach_rad: Positive = 1.0
    """Furthest from the first pose of the recording, where the model has no joint limit [rad]; of
    slides a fifth of it [m]."""
    next_torque_share: Positive = 0.8
    """Share of a drive's torque limit that a motion may take [1]."""
    next_seconds: Positive = 15.0
    """Longest motion [s]."""
    next_least_seconds: Positive = 6.0
    """Shortest excitation [s]: stretches of it are held out in turn."""
    next_setup_s: NonNegative = 10.0
    """Time that a recording costs beside its motion [s]: of two motions that separate equally well
    the shorter one is taken."""
    next_rivals: Count = 6
    """Most pairs that are compared, the closest first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedMotion:
    """A motion as it is given to the machine and as the corrected model answers."""

    time: Array
    """Sample times [s], from 0 (T,)."""
    desired: Array
    """Desired joint positions [rad, m] (T, joints)."""
    controls: Array
    """Commands in the actuators' own units (T, actuators); no column where runs have none."""
    position: Array
    """Joint positions of the model [rad, m] (T, joints)."""
    speed: Array
    """Joint speeds of the model [rad/s, m/s] (T, joints)."""
    torque: Array
    """Torque of the drives on the joints [N·m, N] (T, joints)."""
    readings: Mapping[str, Array]
    """Readings of the sensors that the recording has (T,) or (T, 3)."""
    contacts: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies that touch and do not at the beginning."""
    saturated: tuple[str, ...] = ()
    """Actuators that reach the range of their force."""

    @property
    def seconds(self) -> float:
        """Length [s]."""
        return float(self.time[-1])


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionLimits:
    """Limits of the joints, with where they come from."""

    joints: tuple[str, ...]
    """Names of the joints."""
    home: Array
    """Pose in which motions begin and end [rad, m] (joints,)."""
    low: Array
    """Lowest positions [rad, m] (joints,)."""
    high: Array
    """Highest positions [rad, m] (joints,)."""
    speed: Array
    """Largest speeds [rad/s, m/s] (joints,)."""
    torque: Array
    """Largest torques of the drives [N·m, N] (joints,), infinite where none is known."""
    sources: tuple[str, str, str]
    """Where those of position, speed and torque come from."""

    def refusal(self, motion: PlannedMotion) -> str:
        """Reason why a motion does not fit, "" if it does."""
        if not (np.isfinite(motion.position).all() and np.isfinite(motion.torque).all()):
            return "the corrected model does not follow it"
        if motion.contacts:
            return f"{motion.contacts[0][0]} and {motion.contacts[0][1]} would touch"
        low = np.minimum(motion.position, motion.desired).min(axis=0)
        high = np.maximum(motion.position, motion.desired).max(axis=0)
        for k, joint in enumerate(self.joints):
            if low[k] < self.low[k] - _ROOM or high[k] > self.high[k] + _ROOM:
                return (
                    f"{joint} would move from {low[k]:.3g} to {high[k]:.3g}; it may from "
                    f"{self.low[k]:.3g} to {self.high[k]:.3g} ({self.sources[0]})"
                )
        if motion.saturated:
            return f"{motion.saturated[0]} would reach the range of its force"
        wanted = np.abs(np.gradient(motion.desired, motion.time, axis=0)).max(axis=0)
        fastest = np.maximum(wanted, np.abs(motion.speed).max(axis=0) / _OVERSHOOT)
        largest = np.abs(motion.torque).max(axis=0)
        for name, found, limits, source in (
            ("speed", fastest, self.speed, self.sources[1]),
            ("torque", largest, self.torque, self.sources[2]),
        ):
            over = found > limits * (1 + _ROOM)
            if over.any():
                k = int(np.argmax(over))
                return (
                    f"{self.joints[k]} would need a {name} of {found[k]:.3g}; it may have "
                    f"{limits[k]:.3g} ({source})"
                )
        return ""

    def notes(self, motion: PlannedMotion) -> tuple[str, ...]:
        """What was checked, with the margins left."""
        room = np.minimum(motion.position - self.low, self.high - motion.position).min()
        fastest = float(np.max(np.abs(motion.speed) / self.speed))
        found = [
            f"joint positions stay {room:.3g} rad or m within their range ({self.sources[0]})",
            f"joint speeds reach {fastest:.0%} of their limit ({self.sources[1]})",
        ]
        if np.isfinite(self.torque).any():
            share = float(np.max(np.abs(motion.torque).max(axis=0) / self.torque))
            found.append(f"torques reach {share:.0%} of their limit ({self.sources[2]})")
        else:
            found.append("torques: the model and the recording state no limit; not checked")
        found.append("collisions: no two bodies of the model touch that do not at the beginning")
        return tuple(found)

    def arm(self, machine: NominalModel, rate: float) -> ServoArm:
        """The machine for the library: servos where it has none, its first pose and ranges."""
        spec = machine.spec.copy()
        for key in list(spec.keys):
            spec.delete(key)
        servos = machine.model.nu > 0 and bool(np.all(machine.model.actuator_biasprm[:, 1]))
        if not servos:
            for actuator in list(spec.actuators):
                spec.delete(actuator)
            turn = 2 * np.pi * _CONTROL_HZ
            for joint, inertia in zip(machine.joints, machine.inertias, strict=True):
                servo = spec.add_actuator(
                    name=f"servo of {joint}", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
                )
                servo.set_to_position(kp=float(inertia * turn**2), kv=float(2 * inertia * turn))
        for k, joint in enumerate(machine.joints):
            own = spec.joint(joint)
            own.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            own.range = [float(self.low[k]), float(self.high[k])]
        control = self.home @ _gears(machine) if servos else self.home
        spec.add_key(name="home", qpos=self.home.tolist(), ctrl=control.tolist())
        return ServoArm(spec, Sensing(rate=rate), max_speed=float(np.max(self.speed)))


def limits_of(machine: NominalModel, motion: Motion, settings: NextMotionSettings) -> MotionLimits:
    """Collect the limits: of the settings, else of the model, else what the recording showed."""
    model: mujoco.MjModel = machine.model
    unit = np.where(model.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE), _SLIDE, 1.0)
    home = np.array(motion.runs[0].position[0])
    limited = model.jnt_limited.astype(bool)
    low = np.where(limited, model.jnt_range[:, 0], home - settings.next_reach_rad * unit)
    high = np.where(limited, model.jnt_range[:, 1], home + settings.next_reach_rad * unit)
    from_model = "joint limits of the model" if limited.all() else (
        "joint limits of the model, else --next-reach-rad" if limited.any() else "--next-reach-rad"
    )  # fmt: skip
    stated = _stated_speed(model, unit)
    if settings.next_max_speed_rad_s > 0:
        speed, of_speed = settings.next_max_speed_rad_s * unit, "--next-max-speed-rad-s"
    elif stated is not None:
        speed, of_speed = stated, "max_speed_rad_s of the model"
    else:
        seen, of_speed = np.abs(motion.stacked("speed")).max(axis=0), "the fastest of the runs"
        # a joint that never moved may move as fast as others
        speed = np.where(seen > 0.05 * seen.max(), seen, max(float(seen.max()), 0.1))
    torque = np.full(len(unit), np.inf)
    for k, gears in enumerate(np.abs(_gears(machine))):
        for a in np.flatnonzero(gears > 0):
            if model.actuator_forcelimited[a]:
                own = gears[a] * float(np.min(np.abs(model.actuator_forcerange[a])))
                torque[k] = own if np.isinf(torque[k]) else torque[k] + own
        if model.jnt_actfrclimited[k]:
            torque[k] = min(torque[k], float(np.min(np.abs(model.jnt_actfrcrange[k]))))
    return MotionLimits(
        joints=machine.joints, home=home, low=np.minimum(low, home), high=np.maximum(high, home),
        speed=speed, torque=settings.next_torque_share * torque,
        sources=(from_model, of_speed, f"{settings.next_torque_share:g} of the drives' limits"),
    )  # fmt: skip


def _stated_speed(model: mujoco.MjModel, unit: Array) -> Array | None:
    """Speed limits that a model states as a custom number (joints,); None if it does not."""
    for k in range(model.nnumeric):
        if model.numeric(k).name == "max_speed_rad_s":
            told = np.asarray(model.numeric(k).data, dtype=float)
            if told.size not in (1, len(unit)):
                raise InvalidData(
                    f"max_speed_rad_s of the model has {told.size} values; it must have one, or "
                    f"one for each of the {len(unit)} joints (of a slide in m/s)"
                )
            return told * unit if told.size == 1 else told
    return None


def _gears(machine: NominalModel) -> Array:
    """Torque on each joint per force of each actuator (joints, actuators)."""
    return np.stack([machine.gears(joint) for joint in machine.joints])


def drive_of(machine: NominalModel) -> CommandMode:
    """Return what the commands of a model's actuators are."""
    model = machine.model
    kinds: set[CommandMode] = set()
    for k in range(model.nu):
        place, rate = model.actuator_biasprm[k, 1], model.actuator_biasprm[k, 2]
        kinds.add("position" if place else "speed" if rate else "torque")
    if len(kinds) > 1:
        raise InvalidData(
            f"the actuators of the model take {' and '.join(sorted(kinds))} commands; a motion is "
            "written for actuators of one kind"
        )
    return kinds.pop() if kinds else "none"


def followed(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    desired: Array,
    interval: float,
    parts: int,
    where: tuple[Array, Array],
    command: Callable[[int], None],
    sensors: Sequence[str] = (),
) -> PlannedMotion:
    """Simulate a motion from a state, with a command at each sample, contacts included."""
    at, dofs = where
    mujoco.mj_forward(model, data)
    before = touching(model, data)  # what touches at home may
    met: dict[tuple[str, str], None] = {}
    saturated: dict[str, None] = {}
    position, speed, torque = np.zeros((3, *desired.shape))
    limited = np.flatnonzero(model.actuator_forcelimited)
    seen: dict[str, list[Array]] = {name: [] for name in sensors}
    for row in range(len(desired)):
        for _ in range(parts if row else 0):
            mujoco.mj_step(model, data)
            met |= dict.fromkeys(sorted(touching(model, data) - before))
        mujoco.mj_forward(model, data)
        position[row], speed[row] = data.qpos[at], data.qvel[dofs]
        torque[row] = data.qfrc_actuator[dofs]
        for name, values in seen.items():
            values.append(np.array(data.sensor(name).data))
        for k in limited:
            low, high = model.actuator_forcerange[k]
            if not low < data.actuator_force[k] < high:
                saturated[model.actuator(int(k)).name] = None
        command(row)
    return PlannedMotion(
        time=np.arange(len(desired), dtype=float) * interval, desired=np.asarray(desired),
        controls=np.zeros((len(desired), 0)), position=position, speed=speed, torque=torque,
        readings={name: np.squeeze(np.stack(values)) for name, values in seen.items()},
        contacts=tuple(met), saturated=tuple(saturated),
    )  # fmt: skip


class Player:
    """Plays desired positions on the corrected model, in the columns of a recording.

    Raises
    ------
    InvalidData
        If the runs have neither commands nor torques, or the actuators differ in kind.
    """

    def __init__(
        self, recording: Recording, machine: NominalModel, motion: Motion, corrected: Hypothesis
    ) -> None:
        self.machine, self._motion = machine, motion
        forms = {run.form for run in motion.runs}
        self.form = next((f for f in ("forward", "inverse") if f in forms), "free")
        if self.form == "free":
            raise InvalidData(
                "the recorded runs have neither commands nor torques, so that no command is known "
                "to move the machine; record runs with ctrl. or torque. columns for --next"
            )
        self.drive: CommandMode = drive_of(machine) if self.form == "forward" else "none"
        self._interval = float(np.median([run.log_step for run in motion.runs]))
        step = min(machine.time_step, step_for(machine, corrected))
        self._parts = ceil(self._interval / step - 1e-9)
        self._model = corrected.model(
            machine, self._interval / self._parts, released=self.form == "inverse"
        )
        model, joints = self._model, machine.joints
        self._at = np.array([int(model.joint(name).qposadr[0]) for name in joints])
        self._dofs = np.array([int(model.joint(name).dofadr[0]) for name in joints])
        common = set.intersection(*(set(run.sensors) for run in recording.runs))
        self._sensors = [name for name in machine.sensors if name in common]
        self._torques = [
            name for name in joints if any(name in run.torques for run in recording.runs)
        ]
        turn = 2 * np.pi * _CONTROL_HZ
        self._stiffness, self._damping = machine.inertias * turn**2, 2 * machine.inertias * turn

    @property
    def rate(self) -> float:
        """Sample rate [1/s]."""
        return 1.0 / self._interval

    def play(self, desired: Array) -> PlannedMotion:
        """Play desired joint positions (T, joints), sampled as the recording, on the model."""
        model, data = self._model, mujoco.MjData(self._model)
        count, gears = len(self.machine.actuators), _gears(self.machine)
        rates = np.gradient(desired, self._interval, axis=0)
        controls = None
        if self.drive in ("position", "speed"):
            controls = (desired if self.drive == "position" else rates) @ gears
        data.qpos[self._at] = desired[0]
        if controls is not None:
            data.ctrl[:count] = controls[0]
            for own in np.flatnonzero(model.actuator_actnum):
                data.act[model.actuator_actadr[own]] = data.ctrl[min(int(own), count - 1)]
            mujoco.mj_step(model, data, round(_SETTLE_S / model.opt.timestep))
        given = np.zeros((len(desired), count * (self.form == "forward")))
        external = np.zeros_like(desired)

        def command(row: int) -> None:
            effort = self._effort(data, desired[row], rates[row])
            if controls is not None:
                data.ctrl[:count] = controls[row]
            elif self.drive == "torque":
                data.ctrl[:count] = np.linalg.lstsq(gears, effort, rcond=None)[0]
            else:
                data.qfrc_applied[self._dofs] = external[row] = effort
            given[row] = data.ctrl[: given.shape[1]]

        found = followed(
            model, data, desired, self._interval, self._parts, (self._at, self._dofs), command,
            self._sensors,
        )  # fmt: skip
        torque = external if controls is None and self.drive != "torque" else found.torque
        return replace(found, controls=given, torque=torque)

    def _effort(self, data: mujoco.MjData, at: Array, rate: Array) -> Array:
        """Torque by which a controller follows a motion where the model has no servo (joints,)."""
        off, late = at - data.qpos[self._at], rate - data.qvel[self._dofs]
        carried = data.qfrc_bias[self._dofs] - data.qfrc_passive[self._dofs]
        return np.asarray(carried + self._stiffness * off + self._damping * late)

    def run(self, name: str, motion: PlannedMotion, *, noise: bool = False) -> Run:
        """Motion in the recording's columns, if wanted with the noise of its sensors."""
        rng = np.random.default_rng(_SEED)
        sensors = {
            key: values + noise * self._noise(key) * rng.standard_normal(values.shape)
            for key, values in motion.readings.items()
        }
        sd = self._motion.noise[2] * self._thinned
        torques = {}
        if self.form == "inverse":
            for joint in self._torques:
                k = self.machine.joint_number(joint)
                own = sd[k] if noise and np.isfinite(sd[k]) else 0.0
                torques[joint] = motion.torque[:, k] + own * rng.standard_normal(len(motion.time))
        controls = {
            actuator: motion.controls[:, k]
            for k, actuator in enumerate(self.machine.actuators)
            if motion.controls.shape[1]
        }
        return Run(name=name, time=motion.time, controls=controls, sensors=sensors, torques=torques)

    @property
    def _thinned(self) -> float:
        """Noise of a sample of the log over that of a thinned sample."""
        return float(np.sqrt(round(self._motion.step / self._interval)))

    def _noise(self, sensor: str) -> float:
        """Noise of a sensor's sample; 0 where none is known."""
        found = {n: float(s) for (n, _), s in zip(
            self._motion.sensors, self._motion.sensor_noise, strict=True
        )}  # fmt: skip
        known = joint_sensors(self.machine.model)
        for k, joint in enumerate(self.machine.joints):
            for row, names in enumerate((known[joint].position, known[joint].velocity)):
                found |= dict.fromkeys(names, float(self._motion.noise[row, k]))
        own = found.get(sensor, 0.0)
        return own * self._thinned if np.isfinite(own) else 0.0
