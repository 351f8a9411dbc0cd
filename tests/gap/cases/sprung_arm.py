"""A recording of a small arm with a spring that hardens, which its model lacks."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from loose_env.recording import Recording, Run, write_recording

STIFFNESS = 40.0
"""Torque over the cube of the angle [N·m/rad³]."""
MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.004" integrator="RK4"/>
  <worldbody>
    <body name="link">
      <joint name="elbow" axis="0 1 0" damping="0.4" armature="0.05"/>
      <inertial pos="0.2 0 0" mass="1.5" diaginertia="0.01 0.02 0.02"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="elbow" kp="120" kv="6"/></actuator>
  <sensor><jointpos name="encoder" joint="elbow"/><jointvel name="rate" joint="elbow"/></sensor>
</mujoco>
"""


def sprung(folder: Path, *, runs: int = 3, seconds: float = 2.4) -> Recording:
    """Write a recording, integrated ten times as finely as its samples."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.opt.timestep = 0.0004
    rng = np.random.default_rng(3)
    time = 0.004 * np.arange(round(seconds / 0.004))
    found = []
    for k in range(runs):
        data = mujoco.MjData(model)
        given = 0.9 * np.sin((2.0 + k) * time) * np.sin((5.3 - k) * time)
        for _ in range(2000):
            mujoco.mj_step(model, data)
        shown = np.zeros((len(time), 2))
        for row, command in zip(shown, given, strict=True):
            data.ctrl[:] = command
            for part in range(10):
                middle = data.qpos + 0.0002 * data.qvel
                data.qfrc_applied[:] = -STIFFNESS * middle**3
                mujoco.mj_step(model, data)
                if part == 0:
                    row[:] = data.sensordata
        shown += rng.normal(0.0, [1e-4, 5e-3], shown.shape)
        found.append(
            Run(
                name=f"run-{k + 1}.csv",
                time=time,
                controls={"servo": given},
                sensors={"encoder": shown[:, 0], "rate": shown[:, 1]},
            )
        )
    return write_recording(folder, model_xml=MODEL, runs=found, file_format="csv")
