"""Candidate motions played on the corrected model, and as runs in the recording's columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.data.aligned_run import Channel, Trial, align_run
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.simulation.simulator import Simulator
from loose_env.recording import Run
from loose_env.typing import Array

CommandMode = Literal["position", "speed", "torque", "none"]
"""What commands of the recording's actuators are; "none" where runs have no commands."""

_TRACKING_HZ = 3.0
"""Bandwidth of the controller that is assumed to track a motion by torque commands [Hz]."""
_NOISE_SEED = 7
"""Of the sensor noise on the motion of runs compared by inverse dynamics, whose own sets their
level."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """A motion as it is given to the machine and as the corrected model answers."""

    time: Array
    """Sample times [s], from 0 (T,)."""
    desired: Array
    """Desired joint positions [rad, m] (T, joints)."""
    controls: Array
    """Commands in the actuators' own units (T, actuators); no column where runs have none."""
    position: Array
    """Joint positions of the model under its servos [rad, m] (T, joints)."""
    torque: Array
    """Torque of the drives on the joints [N·m, N] (T, joints)."""
    contacts: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies that touch and do not at the beginning."""
    saturated: tuple[str, ...] = ()
    """Actuators that reach the range of their force."""

    @property
    def seconds(self) -> float:
        """Length [s]."""
        return float(self.time[-1])

    @property
    def speed(self) -> Array:
        """Joint speeds of the model [rad/s, m/s] (T, joints)."""
        return np.asarray(np.gradient(self.position, self.time, axis=0))


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


class MotionRuns:
    """Predicts what a machine would show in motions that were not recorded yet."""

    def __init__(self, comparison: ResidualModel, likely: Hypothesis, weights: Array) -> None:
        self.comparison, self.machine = comparison, comparison.machine
        self.likely = replace(likely, position=None, speed=None)
        forms = {trial.form for trial in comparison.trials}
        self.form = next((f for f in ("forward", "inverse") if f in forms), "free")
        self.drive: CommandMode = drive_of(self.machine) if self.form == "forward" else "none"
        self.floors = np.asarray(comparison.floors) / weights
        self.rate = float(np.median([trial.rate for trial in comparison.trials]))
        step = min(trial.step for trial in comparison.trials)
        self._step = step if self.form == "forward" else min(step, 1e-3)
        self._model = self.likely.model(self.machine, self._step)
        self._joints = len(self.machine.joints)

    def played(self, desired: Array) -> Played:
        """Play desired joint positions (T, joints), sampled as the recording, on the model."""
        model, data = self._model, mujoco.MjData(self._model)
        own = [int(model.joint(name).qposadr[0]) for name in self.machine.joints]
        dofs = [int(model.joint(name).dofadr[0]) for name in self.machine.joints]
        time = np.arange(len(desired)) / self.rate
        controls = self._controls(desired)
        data.qpos[own] = desired[0]
        if controls is not None and self.drive != "torque":
            data.ctrl[: controls.shape[1]] = controls[0]
            for k in range(model.nu):
                if model.actuator_dyntype[k] != int(mujoco.mjtDyn.mjDYN_NONE):
                    data.act[model.actuator_actadr[k]] = controls[0, min(k, controls.shape[1] - 1)]
            for _ in range(round(0.5 / model.opt.timestep)):
                mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        before = _touching(model, data)
        touching: dict[tuple[str, str], None] = {}
        saturated: dict[str, None] = {}
        position, torque = np.zeros((2, len(desired), self._joints))
        given = np.zeros((len(desired), len(self.machine.actuators) * (self.form == "forward")))
        tracking = _Tracking(self.machine, dofs)
        gears = np.stack([self.machine.gears(j) for j in self.machine.joints])
        last = 0
        for row in range(len(desired)):
            steps = round(time[row] / model.opt.timestep) - last
            last += steps
            for _ in range(steps):
                if tracking.needed(self.drive):
                    at = desired[max(row - 1, 0)]
                    data.qfrc_applied[dofs] = 0.0
                    effort = tracking.torque(data, own, at, _slope(desired, row, self.rate))
                    if self.drive == "torque":
                        command = np.linalg.lstsq(gears, effort, rcond=None)[0]
                        data.ctrl[: len(command)] = command
                    else:
                        data.qfrc_applied[dofs] = effort
                mujoco.mj_step(model, data)
                for pair in _touching(model, data) - before:
                    touching[pair] = None
            if controls is not None and self.drive != "torque":
                data.ctrl[: controls.shape[1]] = controls[row]
            position[row] = data.qpos[own]
            torque[row] = (data.qfrc_actuator + data.qfrc_applied)[dofs]
            if self.drive == "none":  # that of this state, not of the step before
                torque[row] = tracking.torque(
                    data, own, desired[row], _slope(desired, row, self.rate)
                )
            if given.size:
                given[row] = data.ctrl[: given.shape[1]]
            for k, name in enumerate(self.machine.actuators):
                low, high = model.actuator_forcerange[k]
                force = float(data.actuator_force[k])
                if model.actuator_forcelimited[k] and not low < force < high:
                    saturated[name] = None
        return Played(
            time=time, desired=np.asarray(desired), controls=given, position=position,
            torque=torque, contacts=tuple(touching), saturated=tuple(saturated),
        )  # fmt: skip

    def _controls(self, desired: Array) -> Array | None:
        """Commands for desired positions (T, actuators); None without position or speed servos."""
        if self.drive not in ("position", "speed"):
            return None
        gears = np.stack([self.machine.gears(j) for j in self.machine.joints])
        wanted = desired if self.drive == "position" else np.gradient(desired, axis=0) * self.rate
        return np.asarray(wanted @ gears)

    def compared(self, motions: Sequence[Played]) -> ResidualModel:
        """Runs of some motions, measured as the corrected model predicts."""
        channels = self.comparison.channels
        trials = [self._trial(k, motion) for k, motion in enumerate(motions)]
        if self.form == "forward":
            simulator = Simulator(self.machine, trials, channels, threads=self.comparison.threads)
            trials = [
                replace(trial, measured=np.where(self._read, values, np.nan))
                for trial, values in zip(trials, simulator.predict([self.likely])[0], strict=True)
            ]
        return ResidualModel(
            self.machine, trials, channels, self.floors, threads=self.comparison.threads
        )

    @property
    def _read(self) -> Array:
        """Channels that any recorded run shows (C,)."""
        seen = [np.isfinite(trial.measured).any(axis=0) for trial in self.comparison.trials]
        return np.asarray(np.any(seen, axis=0))

    def _trial(self, number: int, motion: Played) -> Trial:
        run = self.run(f"motion-{number}", motion, noise=self.form == "inverse")
        return align_run(run, self.machine, self.comparison.channels, step=self.machine.time_step)

    def run(self, name: str, motion: Played, *, noise: bool = False) -> Run:
        """Motion in the recording's columns: commands, and what position and torque will be."""
        rng = np.random.default_rng(_NOISE_SEED)
        sensors: dict[str, Array] = {}
        torques: dict[str, Array] = {}
        expected = motion.position if self.form == "inverse" or noise else motion.desired
        for k, channel in enumerate(self.comparison.channels):
            values = self._reading(channel, motion, expected)
            if values is None or not self._read[k]:
                continue
            if noise:
                values = values + self.floors[k] * rng.standard_normal(len(values))
            prefix, _, own = channel.column.partition(".")
            (sensors if prefix == "sensor" else torques)[own] = values
        controls = {
            name: motion.controls[:, k]
            for k, name in enumerate(self.machine.actuators)
            if motion.controls.shape[1]
        }
        return Run(name=name, time=motion.time, controls=controls, sensors=sensors, torques=torques)

    def _reading(self, channel: Channel, motion: Played, expected: Array) -> Array | None:
        """Reading of a joint's position, speed or torque (T,); None of another quantity."""
        prefix, _, name = channel.column.partition(".")
        if prefix == "torque":
            return np.asarray(motion.torque[:, self.machine.joint_number(name)])
        model = self.machine.model
        sensor = model.sensor(name)
        kind, joint = int(sensor.type[0]), int(sensor.objid[0])
        if kind == int(mujoco.mjtSensor.mjSENS_JOINTPOS):
            return np.asarray(expected[:, joint])
        if kind == int(mujoco.mjtSensor.mjSENS_JOINTVEL):
            return np.asarray(np.gradient(expected[:, joint], motion.time))
        return None


class _Tracking:
    """Computed-torque controller that follows a motion where the model has no servo."""

    def __init__(self, machine: NominalModel, dofs: Sequence[int]) -> None:
        rate = 2 * np.pi * _TRACKING_HZ
        self._stiffness = machine.inertias * rate**2
        self._damping = 2 * machine.inertias * rate
        self._dofs = list(dofs)

    def needed(self, drive: CommandMode) -> bool:
        """Return whether motions need it."""
        return drive in ("torque", "none")

    def torque(self, data: mujoco.MjData, own: Sequence[int], at: Array, speed: Array) -> Array:
        """Torque on the joints (joints,)."""
        error = at - data.qpos[list(own)]
        rate = speed - data.qvel[self._dofs]
        bias = data.qfrc_bias[self._dofs] - data.qfrc_passive[self._dofs]
        return np.asarray(bias + self._stiffness * error + self._damping * rate)


def _slope(desired: Array, row: int, rate: float) -> Array:
    return np.asarray((desired[row] - desired[max(row - 1, 0)]) * rate)


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[str, str]]:
    """Pairs of bodies in contact."""
    found = set()
    for k in range(data.ncon):
        contact = data.contact[k]
        if contact.dist <= 0:
            one, two = (model.body(int(model.geom_bodyid[g])).name for g in contact.geom)
            found.add((min(one, two), max(one, two)))
    return found
