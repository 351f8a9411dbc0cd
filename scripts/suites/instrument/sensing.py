"""Logs of a run and the recording that a user's script makes of them, and files that are damaged.

Accelerometer: mount, analogue filter, gains, bias, noise, bits, a clock of its own. Robot: encoder
resolution and log rate. A recording has the accelerometer's times; the robot's channels are
interpolated, and what is left of clock offset and drift stays in.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet
from scipy import signal

from loose_env.io import write_text, written_beside
from loose_env.typing import Array
from scripts.suites.instrument.machines import STEP, Sheet
from scripts.suites.instrument.physics import Chances, Played, World

G = 9.81


@dataclasses.dataclass(frozen=True, kw_only=True)
class Log:
    """Both logs of a run, each with the times of its own clock [s]."""

    robot_time: Array
    position: Array
    torque: Array | None
    time: Array
    acceleration: Array


def logged(played: Played, sheet: Sheet, world: World, chances: Chances, run: int) -> Log:
    """What robot and accelerometer log of a run."""
    sensor, own, rng = sheet.sensor, chances.machine(5), chances.today(5, run)
    seen = played.acceleration - played.acceleration[0]
    for axis, hertz, ratio in world.mount:
        omega = 2 * np.pi * hertz
        rides = [2 * ratio * omega, omega**2]
        above, below = signal.bilinear(rides, [1, *rides], fs=1 / STEP)
        seen[:, axis] = signal.lfilter(above, below, seen[:, axis])
    filter_ = signal.butter(2, sensor.corner_hz, fs=1 / STEP, output="sos")
    seen = signal.sosfilt(filter_, seen, axis=0) + played.acceleration[0]
    seen = seen * (1 + 0.02 * own.uniform(-1, 1, 3)) + 0.03 * own.standard_normal(3)
    offset = own.choice([-1, 1]) * own.uniform(1e-3, 2e-3) + 2e-4 * rng.uniform(-1, 1)
    drift = own.choice([-1, 1]) * own.uniform(2e-5, 8e-5)
    length = len(seen) * STEP
    time = np.arange(int((length - 0.01) * sensor.rate_hz)) / sensor.rate_hz
    true = time * (1 + drift) + offset
    inside = (true >= 0) & (true <= length - STEP)
    time, true = time[inside], true[inside]
    steps = np.arange(len(seen)) * STEP
    read = np.stack([np.interp(true, steps, column) for column in seen.T], axis=1)
    noise = sensor.noise_ug * 1e-6 * G * np.sqrt(sensor.rate_hz / 2)
    read += noise * rng.standard_normal(read.shape)
    bit = 2 * sensor.range_g * G / 2**sensor.bits
    read = np.clip(np.round(read / bit) * bit, -sensor.range_g * G, sensor.range_g * G)
    fine = np.array(sheet.resolution)
    position = played.motor if sheet.encoders == "motor" else played.link
    torque = None
    if sheet.torques != "none":
        limit = np.array(sheet.torque)
        torque = played.torque + 2e-3 * limit * rng.standard_normal(played.torque.shape)
    return Log(
        robot_time=np.arange(len(position)) / sheet.log_hz,
        position=np.round(position / fine) * fine, torque=torque, time=time, acceleration=read,
    )  # fmt: skip


def columns_of(log: Log, sheet: Sheet) -> dict[str, Array]:
    """Columns of a run's recording."""
    columns: dict[str, Array] = {"time": log.time}
    for i, joint in enumerate(sheet.joints):
        columns[f"sensor.{joint}_pos"] = np.interp(log.time, log.robot_time, log.position[:, i])
    for i, joint in enumerate(sheet.joints):
        if log.torque is not None:
            columns[f"torque.{joint}"] = np.interp(log.time, log.robot_time, log.torque[:, i])
    for i, axis in enumerate("xyz"):
        columns[f"sensor.tool_acc.{axis}"] = log.acceleration[:, i]
    return columns


def write_run(folder: Path, name: str, columns: Mapping[str, Array]) -> None:
    """Write the columns of a run as parquet."""
    kinds = {key: float if key == "time" or key.endswith("_pos") else np.float32 for key in columns}
    table = pa.table({key: np.asarray(values, kinds[key]) for key, values in columns.items()})
    options = {"compression": "zstd", "use_dictionary": False}
    path = folder / f"{name}.parquet"
    written_beside(path, lambda beside: parquet.write_table(table, beside, **options))


def read_run(folder: Path, name: str) -> dict[str, Array]:
    """Columns of a run."""
    table = parquet.read_table(folder / f"{name}.parquet")
    return {key: np.array(table[key], float) for key in table.column_names}


def write_raw(folder: Path, name: str, log: Log, sheet: Sheet) -> None:
    """Write both logs as CSV, each on its own clock."""
    parts = [log.robot_time[:, None], log.position]
    head = ["t", *(f"q_{joint}" for joint in sheet.joints)]
    if log.torque is not None:
        parts.append(log.torque)
        head += [f"tau_{joint}" for joint in sheet.joints]
    folder.mkdir(parents=True, exist_ok=True)
    common: dict[str, Any] = {"delimiter": ",", "comments": "", "fmt": "%.8g"}
    np.savetxt(folder / f"{name}.robot.csv", np.hstack(parts), header=",".join(head), **common)
    rows = np.hstack([1e3 * log.time[:, None], log.acceleration])
    np.savetxt(folder / f"{name}.accelerometer.csv", rows, header="t_ms,ax,ay,az", **common)


def write_index(
    folder: Path, model: str, runs: Sequence[Mapping[str, Any]], joints: Sequence[str],
    condition: str,
) -> None:  # fmt: skip
    """Write ``recording.json`` and the model beside it."""
    index = {
        "format": "loose-recording/1", "model": "model.xml",
        "runs": [
            {"file": f"{run['name']}.parquet",
             "pose": dict(zip(joints, map(float, run["pose"]), strict=True)),
             "condition": condition}
            for run in runs
        ],
    }  # fmt: skip
    write_text(folder / "model.xml", model)
    write_text(folder / "recording.json", json.dumps(index, indent=1) + "\n")


# ----------------------------------------------------------------------------------- damage


Columns = dict[str, Array]
_ACC = tuple(f"sensor.tool_acc.{axis}" for axis in "xyz")


def _cut(runs: list[Columns], sheet: Sheet, rng: np.random.Generator) -> None:
    which = int(rng.integers(len(runs)))
    runs[which] = {key: values[runs[which]["time"] < 0.5] for key, values in runs[which].items()}


def _saturated(runs: list[Columns], sheet: Sheet, rng: np.random.Generator) -> None:
    means = {key: runs[0][key].mean() for key in _ACC}
    most = 0.25 * max(np.abs(run[key] - means[key]).max() for run in runs for key in _ACC)
    for run in runs:
        run |= {key: np.clip(run[key], means[key] - most, means[key] + most) for key in _ACC}


def _exchanged(runs: list[Columns], sheet: Sheet, rng: np.random.Generator) -> None:
    one, other = (sheet.joints[i] for i in rng.choice(len(sheet.joints), 2, replace=False))
    for run in runs:
        for a, b in [(f"sensor.{one}_pos", f"sensor.{other}_pos"),
                     (f"torque.{one}", f"torque.{other}")]:  # fmt: skip
            run |= {a: run[b], b: run[a]} if a in run else {}


def _silent(runs: list[Columns], sheet: Sheet, rng: np.random.Generator) -> None:
    for run in runs:
        run |= {key: np.full_like(run[key], round(float(run[key][0]), 2)) for key in _ACC}


def _in_g(runs: list[Columns], sheet: Sheet, rng: np.random.Generator) -> None:
    for run in runs:
        run |= {key: run[key] / G for key in _ACC}


def _stopped(runs: list[Columns], sheet: Sheet, rng: np.random.Generator) -> None:
    """From some moment on all joints stand, after a jolt."""
    run = runs[int(rng.integers(len(runs)))]
    time, moment = run["time"], rng.uniform(0.35, 0.7) * run["time"][-1]
    after, late = time >= moment, np.maximum(time - moment, 0)
    for key in run:
        if key.endswith("_pos"):
            run[key] = np.where(after, np.interp(moment, time, run[key]), run[key])
        elif key.startswith("torque."):
            run[key] = np.where(after, 0.0, run[key])
    for key in _ACC:
        still = run[key].mean() + 0.02 * rng.standard_normal(len(time))
        jolt = rng.uniform(10, 30) * np.exp(-late / 0.05) * np.sin(2 * np.pi * 31 * late)
        run[key] = np.where(after, still + jolt, run[key])


DAMAGES: Mapping[str, Callable[[list[Columns], Sheet, np.random.Generator], None]] = {
    "cut": _cut, "saturated": _saturated, "exchanged": _exchanged, "silent": _silent, "g": _in_g,
    "stopped": _stopped,
}  # fmt: skip
"""Kinds of damage: a run cut off after half a second, a saturated accelerometer, exchanged joints,
a constant accelerometer, g in place of m/s2, an emergency stop."""


def damage(
    folder: Path, kind: str, names: Sequence[str], sheet: Sheet, seed: Sequence[int]
) -> None:
    """Damage the runs of a recording."""
    runs = [read_run(folder, name) for name in names]
    DAMAGES[kind](runs, sheet, np.random.default_rng([*seed, 77]))
    for name, columns in zip(names, runs, strict=True):
        write_run(folder, name, columns)
