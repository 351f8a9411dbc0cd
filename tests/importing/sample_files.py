"""An arm, a motion of it, and files as loggers write them, made by the libraries' own writers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer as Ros2Writer

ARM = """<mujoco>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0"/>
      <inertial pos=".2 0 0" mass="2" diaginertia=".02 .02 .02"/>
      <body name="lower" pos=".4 0 0">
        <joint name="elbow" axis="0 1 0"/>
        <inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/>
        <site name="tip" pos=".2 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="lift" joint="shoulder"/><motor name="bend" joint="elbow"/></actuator>
  <sensor>
    <jointpos name="shoulder_angle" joint="shoulder"/><jointpos name="elbow_angle" joint="elbow"/>
    <jointvel name="shoulder_rate" joint="shoulder"/><accelerometer name="tool" site="tip"/>
  </sensor>
</mujoco>
"""
START_NS = 1_714_557_600_000_000_000  # 2024-05-01T10:00:00Z

HEADER = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
JOINT_STATE = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{HEADER}"""
IMU = f"""std_msgs/Header header
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{HEADER}================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
COMMANDS = """std_msgs/MultiArrayLayout layout
float64[] data
================================================================================
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""


def motion(time: np.ndarray, *, seed: int = 3, top_hz: float = 20.0) -> dict[str, np.ndarray]:
    """Smooth random signals whose band ends at ``top_hz``, known at any time."""
    rng = np.random.default_rng(seed)
    found = {}
    for name in ("shoulder", "elbow", "rate", "x", "y", "z", "lift"):
        frequency = rng.uniform(0.5, top_hz, 25)
        phase = rng.uniform(0, 2 * np.pi, 25)
        found[name] = np.sin(2 * np.pi * np.outer(time, frequency) + phase).sum(1) / 5
    return found


def stamp(ns: int) -> dict[str, int]:
    return {"sec": ns // 10**9, "nanosec": ns % 10**9}


def header(ns: int) -> dict[str, Any]:
    return {"stamp": stamp(ns), "frame_id": "base"}


def write_ros2(
    path: Path,
    topics: Mapping[str, tuple[str, str, Sequence[tuple[int, dict[str, Any]]]]],
    **options: Any,
) -> Path:
    """Write topics: their type, its definition, and messages with their times [ns]."""
    with path.open("wb") as file:
        writer = Ros2Writer(file, **options)
        rows = []
        for topic, (kind, text, messages) in topics.items():
            schema = writer.register_msgdef(kind, text)
            rows += [(ns, topic, schema, message) for ns, message in messages]
        for ns, topic, schema, message in sorted(rows, key=lambda row: row[:2]):
            writer.write_message(topic, schema, message, log_time=ns, publish_time=ns + 5)
        writer.finish()
    return path


def joint_states(time: np.ndarray, *, late_ns: int = 0) -> list[tuple[int, dict[str, Any]]]:
    """Joint states whose names change places, as two publishers' do."""
    signals = motion(time)
    found = []
    for i, t in enumerate(time):
        ns = START_NS + round(t * 1e9)
        names = ["shoulder", "elbow"] if i % 2 else ["elbow", "shoulder"]
        found.append(
            (
                ns + late_ns,
                {
                    "header": header(ns),
                    "name": names,
                    "position": [float(signals[name][i]) for name in names],
                    "velocity": [float(signals["rate"][i])] * 2,
                    "effort": [],
                },
            )
        )
    return found


def imu(time: np.ndarray) -> list[tuple[int, dict[str, Any]]]:
    signals = motion(time)
    return [
        (
            START_NS + round(t * 1e9),
            {
                "header": header(START_NS + round(t * 1e9)),
                "linear_acceleration": {axis: float(signals[axis][i]) for axis in "xyz"},
                "linear_acceleration_covariance": [0.0] * 9,
            },
        )
        for i, t in enumerate(time)
    ]


def commands(time: np.ndarray) -> list[tuple[int, dict[str, Any]]]:
    signals = motion(time)
    return [
        (
            START_NS + round(t * 1e9),
            {"layout": {"dim": [], "data_offset": 0}, "data": [float(signals["lift"][i]), 0.0]},
        )
        for i, t in enumerate(time)
    ]


def write_robot(path: Path, *, seconds: float = 2.0, hz: float = 200.0, **options: Any) -> Path:
    """A bag of joint states, an IMU and commands, all on the same times."""
    time = np.arange(int(seconds * hz)) / hz
    return write_ros2(
        path,
        {
            "/joint_states": ("sensor_msgs/msg/JointState", JOINT_STATE, joint_states(time)),
            "/imu": ("sensor_msgs/msg/Imu", IMU, imu(time)),
            "/commands": ("std_msgs/msg/Float64MultiArray", COMMANDS, commands(time)),
        },
        **options,
    )


def write_csv(path: Path, rows: np.ndarray, names: Sequence[str], **how: Any) -> Path:
    """Write a table with 9 digits: separator, decimal, lines before and after the names."""
    separator, decimal = how.get("separator", ","), how.get("decimal", ".")
    lines = [*how.get("before", ()), separator.join(names), *how.get("after", ())]
    for row in rows:
        lines.append(separator.join(f"{v:.9f}".replace(".", decimal) for v in row))
    path.write_text("\n".join(lines) + "\n", encoding=how.get("encoding", "utf-8"))
    return path
