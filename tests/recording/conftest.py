"""Runs and folders that the tests of recordings share; tables written by hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loose_env.recording import Run

Folder = Callable[..., Path]
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
COS = [repr(float(v)) for v in np.cos(TIME)]


def csv_text(**columns: Any) -> str:
    """A CSV of `TIME` and columns: dots in names are two underscores, values are any words."""
    given = {"time": [f"{t:g}" for t in TIME]} | {
        name if name[0] == "_" else name.replace("__", "."): values
        for name, values in columns.items()
    }
    length = len(next(iter(given.values())))
    lines = [",".join(given)] + [",".join(str(v[i]) for v in given.values()) for i in range(length)]
    return "\n".join(lines) + "\n"


@pytest.fixture
def swing() -> Callable[..., Run]:
    """Make a run with two controls, two scalar sensors, a 3-vector, a torque and gaps."""

    def make(name: str = "swing.parquet", *, samples: int = 50, seed: int = 0, **more: Any) -> Run:
        rng = np.random.default_rng(seed)
        time = np.cumsum(rng.uniform(1e-3, 2e-3, samples))
        angle = rng.normal(size=samples) * 10.0 ** rng.integers(-300, 300, samples)
        tool = rng.normal(size=(samples, 3))
        angle[3], tool[5, 1], tool[6] = np.nan, np.nan, np.nan
        angle[7] = -0.0
        columns: dict[str, Any] = {
            "controls": {"lift": rng.normal(size=samples), "push": rng.normal(size=samples)},
            "sensors": {"angle": angle, "rate": rng.normal(size=samples), "tool": tool},
            "torques": {"reach": rng.normal(size=samples)},
        }
        return Run(name=name, time=time, **(columns | more))

    return make


@pytest.fixture
def folder(tmp_path: Path) -> Callable[..., Path]:
    """Write a recording by hand: files as text or bytes, and the keys of ``recording.json``."""

    def make(files: Mapping[str, str | bytes] | None = None, **description: Any) -> Path:
        home = tmp_path / "recorded"
        home.mkdir(exist_ok=True)
        rows = "".join(f"{t:g},{float(np.cos(t))!r}\n" for t in TIME)
        plain = {"model.xml": ARM, "run.csv": f"time,sensor.angle\n{rows}"}
        for name, content in (plain | dict(files or {})).items():
            path = home / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        whole = {"format": "loose-recording/1", "model": "model.xml", "runs": [{"file": "run.csv"}]}
        whole = {k: v for k, v in (whole | description).items() if v is not ...}
        if "recording.json" not in (files or {}):
            home.joinpath("recording.json").write_text(json.dumps(whole))
        return home

    return make
