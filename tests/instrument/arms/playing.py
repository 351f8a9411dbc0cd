"""Play a planned signal on the model it was made for, with MuJoCo and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.instrument.planning.plan import Plan

_SETTLE = 1.5
"""Time for which the arm is left under the first commands before the signal begins [s]."""


def held(model: mujoco.MjModel, pose: np.ndarray, commands: Mapping[str, float]) -> mujoco.MjData:
    """State of a model at rest in a pose under constant commands of its actuators."""
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    for a in range(model.nu):
        data.ctrl[a] = commands[model.actuator(a).name]
        if model.actuator_actadr[a] >= 0:
            data.act[model.actuator_actadr[a]] = data.ctrl[a]
    mujoco.mj_forward(model, data)
    return data


@dataclass(frozen=True, kw_only=True)
class Played:
    """What the simulated arm did."""

    tool_rms: float
    joint_rms: float
    torque_peaks: np.ndarray
    travel: np.ndarray
    standing: float
    """Largest acceleration of the tool before the noise begins, less gravity [m/s²]."""
    first_step: float
    """Largest acceleration of the tool in the first tenth of the hold, less gravity [m/s²]."""
    held_at: np.ndarray
    """Joint positions just before the noise begins [rad or m]."""
    columns: dict[str, np.ndarray]
    """The run, as a recording has it."""


def play(plan: Plan, *, step: float = 2e-4) -> Played:
    """Play the first signal; joints with motors are on the soft controller that is assumed."""
    machine, signal = plan.arm, plan.signals[0]
    spec = mujoco.MjSpec.from_string(machine.recording_model.xml)
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    m = spec.compile()
    joints = [m.joint(name) for name in machine.joints]
    at = [int(j.qposadr[0]) for j in joints]
    dofs = [int(j.dofadr[0]) for j in joints]
    for k, drive in enumerate(machine.drives):
        if drive is None or not drive.servo:
            m.jnt_stiffness[joints[k].id] += machine.nominal.centring.stiffness[k]
            m.dof_damping[dofs[k]] += machine.nominal.centring.damping[k]
            m.qpos_spring[at[k]] = plan.pose[k]
    data = mujoco.MjData(m)
    data.qpos[at] = plan.pose
    names = [m.actuator(a).name for a in range(m.nu)]
    u = np.array([signal.commands[name] for name in names]).T
    data.ctrl[:] = u[0]
    for a in range(m.nu):
        if m.actuator_actadr[a] >= 0:
            data.act[m.actuator_actadr[a]] = u[0, a]
    for _ in range(round(_SETTLE / step)):  # the arm stands under the signal's first commands
        mujoco.mj_step(m, data)
    data.time = 0.0
    sensor = int(m.sensor(machine.recording_model.accelerometer).adr[0])
    each = round(1 / (step * plan.next.rate_hz))
    tool, q, torque, qacc = [], [], [], []
    for t in range(len(u)):
        mujoco.mj_forward(m, data)
        tool.append(data.sensordata[sensor : sensor + 3].copy())
        q.append(data.qpos[at].copy())
        torque.append(data.qfrc_actuator[dofs].copy())
        qacc.append(data.qacc[dofs].copy())
        for s in range(each):
            data.ctrl[:] = u[t] + (u[min(t + 1, len(u) - 1)] - u[t]) * s / each
            mujoco.mj_step(m, data)
    a, angle = np.array(tool), np.array(q)
    on = (signal.time >= signal.steady_s[0]) & (signal.time < signal.steady_s[1])
    swells = signal.steady_s[0] - 0.25
    still = (signal.time > 0.8 * swells) & (signal.time < 0.9 * swells)
    early = signal.time < 0.1 * swells
    shaken = (signal.time > 0.9 * swells) & (signal.time < signal.steady_s[1] + 0.25)
    j = machine.joints.index(signal.joint)
    around = a[on] - a[on].mean(axis=0)
    columns = {"time": signal.time, **{f"ctrl.{n}": v for n, v in signal.commands.items()}}
    name = machine.recording_model.accelerometer
    columns |= {f"sensor.{name}.{axis}": a[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"sensor.{s}": angle[:, k] for k, s in enumerate(machine.recording_model.positions)}
    return Played(
        tool_rms=float(np.sqrt((around**2).sum(axis=1).mean())),
        joint_rms=float(np.array(qacc)[on][:, j].std()),
        torque_peaks=np.abs(torque).max(axis=0),
        travel=np.abs(angle[shaken] - plan.pose).max(axis=0),
        standing=float(np.abs(a[still] - a[still][0]).max()),
        first_step=float(np.abs(a[early] - a[0]).max()),
        held_at=angle[still].mean(axis=0),
        columns=columns,
    )
