"""Arms struck at the tool, simulated with MuJoCo alone: a stand-in for a hammer with a sensor."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.recording import Run

RATE = 1000.0
"""Samples per second of the recorder [Hz]."""
_STEP = 2e-5
_SETTLE = 1.0


def blows(seconds: float, rng: np.random.Generator, *, peak: float = 40.0) -> np.ndarray:
    """Force of a hammer with a soft tip: half sines of 4 ms, some ten a second, at _STEP [N]."""
    force = np.zeros(round(seconds / _STEP))
    pulse = np.sin(np.pi * np.arange(round(4e-3 / _STEP)) * _STEP / 4e-3)
    at = 0.05
    while at < seconds - 0.05:
        k = round(at / _STEP)
        force[k : k + len(pulse)] += peak * rng.uniform(0.5, 1.0) * pulse
        at += rng.uniform(0.05, 0.15)
    return force


def strike(
    arm: InstrumentedArm,
    pose: np.ndarray,
    direction: Sequence[float],
    seed: int,
    *,
    seconds: float = 3.0,
    loose: tuple[str, Sequence[float], float] | None = None,
) -> Run:
    """Run of an arm on its servos whose tool is struck along a direction of its frame.

    Parameters
    ----------
    loose : tuple, optional
        Body, direction in its frame and clearance [m] of a loose seat.
    """
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec.from_string(arm.recording_model.xml)
    spec.option.timestep, spec.option.integrator = _STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if loose is not None:
        body, axis, gap = loose
        spec.body(body).add_joint(
            name="seat", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=list(axis), limited=True,
            range=[-gap / 2, gap / 2], solref_limit=[-4e6, -400.0], frictionloss=0.5,
        )  # fmt: skip
    m = spec.compile()
    data = mujoco.MjData(m)
    at = [int(m.joint(name).qposadr[0]) for name in arm.joints]
    data.qpos[at] = pose
    for j, drive in enumerate(arm.drives):
        assert drive is not None
        a = m.actuator(drive.actuator).id
        data.ctrl[a] = float(drive.command(0.0, pose[j]))
        if m.actuator_actadr[a] >= 0:
            data.act[m.actuator_actadr[a]] = data.ctrl[a]
    site = m.site(arm.recording_model.site).id
    body, sensor = int(m.site_bodyid[site]), int(m.sensor(arm.recording_model.accelerometer).adr[0])
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    for _ in range(round(_SETTLE / _STEP)):
        mujoco.mj_step(m, data)
    each = round(1 / (RATE * _STEP))
    pushed, tool, where, zero = [], [], [], np.zeros(3)
    for k, force in enumerate(blows(seconds, rng)):
        data.qfrc_applied[:] = 0.0
        along = data.site_xmat[site].reshape(3, 3) @ (force * unit)
        mujoco.mj_applyFT(m, data, along, zero, data.site_xpos[site], body, data.qfrc_applied)
        mujoco.mj_forward(m, data)
        if k % each == 0:
            pushed.append(force * unit)
            tool.append(data.sensordata[sensor : sensor + 3] + 0.01 * rng.standard_normal(3))
            where.append(data.qpos[at] + 1e-5 * rng.standard_normal(len(at)))
        mujoco.mj_step(m, data)
    names = arm.recording_model.positions
    return Run(
        name=f"run-{seed}.csv",
        time=np.arange(len(tool)) / RATE,
        sensors={
            arm.recording_model.accelerometer: np.array(tool),
            str(arm.tool_force): np.array(pushed) + 0.002 * rng.standard_normal((len(tool), 3)),
            **{name: np.array(where)[:, k] for k, name in enumerate(names)},
        },
        pose=arm.by_joint(pose),
    )
