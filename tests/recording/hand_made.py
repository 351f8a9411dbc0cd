"""A model with every kind of element that a column may name, and tables written by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

ARM = """<mujoco>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0"/>
      <inertial pos=".2 0 0" mass="2" diaginertia=".02 .02 .02"/>
      <body name="lower" pos=".4 0 0">
        <joint name="reach" type="slide" axis="1 0 0"/>
        <inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/>
        <site name="tip" pos=".2 0 0"/>
      </body>
    </body>
    <body name="stand" pos="0 1 0">
      <joint name="aside"/>
      <inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="lift" joint="shoulder"/><position name="push" joint="reach" kp="100"/>
  </actuator>
  <sensor>
    <jointpos name="angle" joint="shoulder"/><jointvel name="rate" joint="shoulder"/>
    <jointpos name="stroke" joint="reach"/><jointpos name="aside_angle" joint="aside"/>
    <accelerometer name="tool" site="tip"/><framequat name="turned" objtype="site" objname="tip"/>
  </sensor>
</mujoco>
"""

TIME = np.arange(20) / 100


def csv_text(**columns: Any) -> str:
    """A CSV of `TIME` and columns: dots in names are two underscores, values are any words."""
    given = {"time": [f"{t:g}" for t in TIME]} | {
        name if name[0] == "_" else name.replace("__", "."): values
        for name, values in columns.items()
    }
    length = len(next(iter(given.values())))
    lines = [",".join(given)] + [",".join(str(v[i]) for v in given.values()) for i in range(length)]
    return "\n".join(lines) + "\n"
