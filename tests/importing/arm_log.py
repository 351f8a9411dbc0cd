"""A simulated arm's motion, and the files in which people keep such motions.

ROS 2 bags are written by ``rosbags``, HDF5 by ``h5py``. LeRobot's own package is too heavy to
install for a test: its documented layout is written by ``pyarrow``.
The RTDE log is written as the recorder of Universal Robots' Python library writes it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy import signal

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow")
SENSORS = "".join(
    f'<jointpos name="{n}_pos" joint="{n}"/><jointvel name="{n}_vel" joint="{n}"/>' for n in JOINTS
)
ARM = f"""<mujoco>
  <compiler angle="radian"/>
  <option timestep=".0005" integrator="implicitfast"/>
  <worldbody>
    <body name="base">
      <joint name="shoulder_pan" axis="0 0 1" range="-1.9 1.9" limited="true" damping="1"/>
      <inertial pos="0 0 .1" mass="3" diaginertia=".02 .02 .02"/>
      <body name="upper" pos="0 0 .2">
        <joint name="shoulder_lift" axis="0 1 0" range="-1.7 1.7" limited="true" damping="1"/>
        <inertial pos=".15 0 0" mass="2" diaginertia=".02 .02 .02"/>
        <body name="lower" pos=".3 0 0">
          <joint name="elbow" axis="0 1 0" range="-1.6 1.6" limited="true" damping=".5"/>
          <inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="pan" joint="shoulder_pan" kp="300" kv="30"/>
    <position name="lift" joint="shoulder_lift" kp="400" kv="30"/>
    <position name="bend" joint="elbow" kp="200" kv="10"/>
  </actuator>
  <sensor>{SENSORS}</sensor>
</mujoco>
"""
EVERY = 16
"""Steps of the simulation between samples."""
START_NS = 1_714_557_600_000_000_000


@dataclass(frozen=True)
class Motion:
    """Signals of the arm at 125 Hz, each of shape (T, 3), time of shape (T,)."""

    time: np.ndarray
    command: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray


@cache
def moved(seconds: float = 8.0, friction: float = 0.0) -> Motion:
    """The arm driven by filtered noise, with more viscous friction [N·m·s/rad] at the elbow."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.dof_damping[2] += friction
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    steps = round(seconds / model.opt.timestep)
    top = signal.butter(2, 3.0 * model.opt.timestep)
    command = np.clip(signal.lfilter(*top, 12 * rng.normal(size=(steps, 3)), axis=0), -1.2, 1.2)
    rows, torque = [], np.zeros(3)
    for i in range(steps):
        data.ctrl[:] = command[i - i % EVERY]  # the log's rate
        mujoco.mj_step1(model, data)
        state = (data.qpos.copy(), data.qvel.copy())
        mujoco.mj_step2(model, data)
        torque = torque + data.actuator_force / EVERY  # averaged, as a drive filters its current
        if i % EVERY == 0:
            rows.append((i * model.opt.timestep, command[i], *state, torque))
            torque = np.zeros(3)
    time, command, position, velocity, torque = (np.array(each) for each in zip(*rows, strict=True))
    position = position + 5e-4 * rng.normal(size=position.shape)
    return Motion(time, command, position, velocity, torque)


def write_rtde(path: Path, motion: Motion, *, header: bool = True, separator: str = " ") -> Path:
    """As ``record.py`` of the RTDE client library writes a recipe of five fields."""
    names = ["timestamp"]
    names += [f"{n}_{i}" for n in ("target_q", "actual_q", "actual_qd", "actual_current")
              for i in range(3)]  # fmt: skip
    table = np.hstack(
        [
            100 + motion.time[:, None],
            motion.command,
            motion.position,
            motion.velocity,
            motion.torque / 12,
        ]
    )
    np.savetxt(path, table, delimiter=separator, fmt="%.12g", comments="",
               header=separator.join(names) if header else "")  # fmt: skip
    if not header:
        path.write_text(path.read_text().lstrip("\n"))
    return path


def write_lerobot(
    folder: Path,
    motion: Motion,
    *,
    version: str = "v3.0",
    episodes: int = 2,
    state: np.ndarray | None = None,
    action: np.ndarray | None = None,
) -> Path:
    """The layout of a LeRobot dataset whose episodes all hold one motion, in degrees."""
    state = np.degrees(motion.position) if state is None else state
    action = np.degrees(motion.command) if action is None else action
    rows = len(motion.time)
    names = [f"{name}.pos" for name in JOINTS]
    vector = {"dtype": "float32", "shape": [3], "names": names}
    one = {"dtype": "float32", "shape": [1], "names": None}
    template = {
        "v3.0": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "v2.1": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    }[version]
    info = {
        "codebase_version": version,
        "robot_type": "so101_follower",
        "total_episodes": episodes,
        "chunks_size": 1000,
        "fps": 125,
        "data_path": template,
        "features": {
            "action": vector,
            "observation.state": vector,
            "observation.images.top": {"dtype": "video", "shape": [4, 4, 3], "names": None},
            "timestamp": one,
            "episode_index": {**one, "dtype": "int64"},
        },
    }

    def table(numbers: list[int]) -> pa.Table:
        count = len(numbers)
        return pa.table(
            {
                "action": _vectors(np.tile(action, (count, 1))),
                "observation.state": _vectors(np.tile(state, (count, 1))),
                "timestamp": pa.array(np.tile(motion.time, count).astype(np.float32)),
                "episode_index": pa.array(np.repeat(numbers, rows)),
            }
        )

    meta = folder / "meta"
    meta.mkdir(parents=True)
    meta.joinpath("info.json").write_text(json.dumps(info))
    numbers = list(range(episodes))
    if version == "v3.0":
        _parquet(folder / template.format(chunk_index=0, file_index=0), table(numbers))
        index = {
            "episode_index": numbers,
            "tasks": [["reach"]] * episodes,
            "length": [rows] * episodes,
            "data/chunk_index": [0] * episodes,
            "data/file_index": [0] * episodes,
        }
        _parquet(meta / "episodes/chunk-000/file-000.parquet", pa.table(index))
        return folder
    for i in numbers:
        _parquet(folder / template.format(episode_chunk=0, episode_index=i), table([i]))
    lines = [json.dumps({"episode_index": i, "tasks": ["reach"], "length": rows}) for i in numbers]
    meta.joinpath("episodes.jsonl").write_text("\n".join(lines) + "\n")
    return folder


def write_bag(
    folder: Path,
    motion: Motion,
    *,
    storage: str = "sqlite3",
    packed: bool = False,
    definitions: bool = True,
) -> Path:
    """A ROS 2 bag of joint states and commands, written by ``rosbags``."""
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    store = get_typestore(Stores.ROS2_HUMBLE)
    state, array = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
    kinds = store.types
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if packed:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        states = writer.add_connection("/joint_states", state, typestore=store)
        commands = writer.add_connection("/commands", array, typestore=store)
        for i, second in enumerate(motion.time):
            stamp = START_NS + round(second * 1e9)
            time = kinds["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
            header = kinds["std_msgs/msg/Header"](stamp=time, frame_id="")
            order = [2, 0, 1]  # drivers name their joints in any order
            message = kinds[state](
                header=header,
                name=[JOINTS[j] for j in order],
                position=motion.position[i, order],
                velocity=motion.velocity[i, order],
                effort=motion.torque[i, order],
            )
            writer.write(states, stamp, store.serialize_cdr(message, state))
            layout = kinds["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            message = kinds[array](layout=layout, data=motion.command[i])
            writer.write(commands, stamp, store.serialize_cdr(message, array))
    if not definitions:  # as bags before ROS 2 Iron
        import sqlite3

        with sqlite3.connect(next(folder.glob("*.db3"))) as database:
            database.execute("DROP TABLE message_definitions")
            database.execute("UPDATE schema SET schema_version = 3")
    return folder


def write_robomimic(path: Path, motion: Motion, *, rate: float | None = 125.0) -> Path:
    """Two demonstrations as robomimic's documentation describes them."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        kwargs: dict[str, Any] = {} if rate is None else {"control_freq": rate}
        data.attrs["env_args"] = json.dumps({"env_name": "Reach", "env_kwargs": kwargs})
        for name in ("demo_0", "demo_1"):
            demo = data.create_group(name)
            demo.attrs["num_samples"] = len(motion.time)
            demo["actions"] = motion.command
            demo["obs/robot0_joint_pos"] = motion.position
            demo["obs/robot0_joint_vel"] = motion.velocity
            demo["obs/agentview_image"] = np.zeros((len(motion.time), 4, 4, 3), np.uint8)
    return path


def _vectors(values: np.ndarray) -> pa.Array:
    flat = pa.array(values.astype(np.float32).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _parquet(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)
