"""A recording as a LeRobotDataset, version 3.0: each run an episode, numbers to the last bit."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from loose_env.io import write_text, written_beside
from loose_env.recording import Recording, Run
from loose_env.typing import Array

__all__ = ["write_lerobot"]

INFO = "meta/info.json"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
DATA = "data/chunk-000/file-000.parquet"
TASKS = "meta/tasks.parquet"
ACTION, STATE, EFFORT = "action", "observation.state", "observation.effort"
PREFIX = {ACTION: "ctrl.", STATE: "sensor.", EFFORT: "torque."}
"""Features, and how their columns begin in a recording."""
_INDEX = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def write_lerobot(folder: Path, recording: Recording) -> Path:
    """Write a recording as a dataset; the folder is renamed into place when it is whole.

    Sensors go to ``observation.state``, commands to ``action``, measured torques to
    ``observation.effort``, as float64. The names of their entries are those of the model; units
    stand beside them in ``meta/info.json``. A feature that a run lacks is NaN there.
    ``mapping.toml`` and the nominal model lie beside, for ``loose import``.

    Parameters
    ----------
    folder : Path
        Folder of the dataset; one that is there is replaced.
    recording : Recording
        The recording, of one sampling rate.

    Returns
    -------
    Path
        The folder.
    """
    model = recording.model()
    runs = [_columns(run) for run in recording.runs]
    names = {
        feature: list(dict.fromkeys(n for run in runs for n in run if n.startswith(prefix)))
        for feature, prefix in PREFIX.items()
    }
    names = {feature: own for feature, own in names.items() if own}
    step = float(np.median(np.diff(recording.runs[0].time)))
    rate = round(1.0 / step)
    beside = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    shutil.rmtree(beside, ignore_errors=True)
    try:
        tasks = list(dict.fromkeys(map(_task, recording.runs)))
        info = _info(names, model, recording, rate, len(tasks))
        write_text(beside / INFO, json.dumps(info, indent=1, ensure_ascii=False) + "\n")
        _write_tasks(beside / TASKS, tasks)
        _write_data(beside / DATA, recording.runs, runs, names, tasks)
        _write_episodes(beside / EPISODES, recording.runs)
        write_text(beside / "meta/stats.json", json.dumps(_stats(runs, names), indent=1) + "\n")
        write_text(beside / "mapping.toml", _mapping(recording, runs, names, model, folder.name))
        shutil.copyfile(recording.model_path, beside / "model.xml")
        shutil.rmtree(folder, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside.rename(folder)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return folder


def _columns(run: Run) -> dict[str, Array]:
    """Columns of a run under the names of the recording format, each of shape (T,)."""
    found = {f"ctrl.{name}": values for name, values in run.controls.items()}
    for name, values in run.sensors.items():
        if values.ndim == 1:
            found[f"sensor.{name}"] = values
        else:
            found |= {f"sensor.{name}.{axis}": values[:, k] for k, axis in enumerate("xyz")}
    return found | {f"torque.{name}": values for name, values in run.torques.items()}


def _task(run: Run) -> str:
    """Task of an episode: what the arm was made to do."""
    if run.excited:
        return f"random excitation of {' and '.join(run.excited)}"
    if run.torques:
        return "motion with measured joint torques"
    return "commanded motion" if run.controls else "free response"


def _unit(column: str, model: mujoco.MjModel) -> str:
    """SI unit of a column, as mappings write it."""
    group, name = column.split(".")[:2]
    if group == "sensor":
        sensor = model.sensor(name)
        if sensor.type[0] == mujoco.mjtSensor.mjSENS_ACCELEROMETER:
            return "m/s^2"
        joint = model.joint(int(sensor.objid[0]))
        rate = sensor.type[0] == mujoco.mjtSensor.mjSENS_JOINTVEL
    else:
        joint = model.joint(name if group == "torque" else int(model.actuator(name).trnid[0]))
        rate = False
    slides = joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    if group == "torque":
        return "N" if slides else "N*m"
    return ("m" if slides else "rad") + ("/s" if rate else "")


def _info(
    names: Mapping[str, Sequence[str]],
    model: mujoco.MjModel,
    recording: Recording,
    rate: int,
    tasks: int,
) -> dict[str, Any]:
    features: dict[str, Any] = {
        feature: {
            "dtype": "float64",
            "shape": [len(own)],
            "names": [each.removeprefix(PREFIX[feature]) for each in own],
            "units": [_unit(each, model) for each in own],
        }
        for feature, own in names.items()
    }
    for name in _INDEX:
        dtype = "float32" if name == "timestamp" else "int64"
        features[name] = {"dtype": dtype, "shape": [1], "names": None}
    return {
        "codebase_version": "v3.0",
        "robot_type": "arm",
        "total_episodes": len(recording.runs),
        "total_frames": sum(run.samples for run in recording.runs),
        "total_tasks": tasks,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate,
        "splits": {"train": f"0:{len(recording.runs)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Tasks by number; LeRobot reads the texts as the index of a pandas table."""
    import pyarrow as pa

    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {"name": name, "field_name": name, "pandas_type": a, "numpy_type": b, "metadata": None}
            for name, (a, b) in kinds.items()
        ],
        "pandas_version": "2.2.0",
    }
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": list(tasks)})
    _write(path, table.replace_schema_metadata({"pandas": json.dumps(pandas)}))


def _write_data(
    path: Path,
    runs: Sequence[Run],
    columns: Sequence[Mapping[str, Array]],
    names: Mapping[str, Sequence[str]],
    tasks: Sequence[str],
) -> None:
    import pyarrow as pa

    table: dict[str, Any] = {}
    for feature, own in names.items():
        flat = np.concatenate(
            [_block(run, own, each) for run, each in zip(runs, columns, strict=True)]
        )
        table[feature] = pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), len(own))
    lengths = [run.samples for run in runs]
    table["timestamp"] = np.concatenate([run.time - run.time[0] for run in runs]).astype(np.float32)
    table["frame_index"] = np.concatenate([np.arange(n) for n in lengths])
    table["episode_index"] = np.repeat(np.arange(len(runs)), lengths)
    table["index"] = np.arange(sum(lengths))
    table["task_index"] = np.repeat([tasks.index(_task(run)) for run in runs], lengths)
    _write(path, pa.table(table))


def _block(run: Run, names: Sequence[str], columns: Mapping[str, Array]) -> np.ndarray:
    """Columns of one run, shape (T, N); NaN where the run has none."""
    missing = np.full(run.samples, np.nan)
    return np.stack([np.asarray(columns.get(name, missing)) for name in names], axis=1)


def _write_episodes(path: Path, runs: Sequence[Run]) -> None:
    import pyarrow as pa

    lengths = np.array([run.samples for run in runs])
    ends, zeros = np.cumsum(lengths), np.zeros(len(runs), dtype=np.int64)
    table = {
        "episode_index": np.arange(len(runs)),
        "tasks": [[_task(run)] for run in runs],
        "length": lengths,
        "dataset_from_index": ends - lengths,
        "dataset_to_index": ends,
    }
    places = ("data/chunk_index", "data/file_index", "meta/episodes/chunk_index",
              "meta/episodes/file_index")  # fmt: skip
    _write(path, pa.table({**table, **{place: zeros for place in places}}))


def _write(path: Path, table: Any) -> None:
    import pyarrow.parquet as pq

    written_beside(path, lambda beside: pq.write_table(table, beside))


def _stats(
    columns: Sequence[Mapping[str, Array]], names: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """Statistics of the features over all samples that are there, as LeRobot normalises by them."""
    found = {}
    for feature, own in names.items():
        parts = [np.concatenate([run[n] for run in columns if n in run]) for n in own]
        found[feature] = {
            name: [float(of(part)) for part in parts]
            for name, of in (("min", np.min), ("max", np.max), ("mean", np.mean), ("std", np.std))
        } | {"count": [min(map(len, parts))]}
    return found


def _mapping(
    recording: Recording,
    columns: Sequence[Mapping[str, Array]],
    names: Mapping[str, Sequence[str]],
    model: mujoco.MjModel,
    folder: str,
) -> str:
    """Mapping by which ``loose import`` reads the dataset back, a run for each episode.

    A source is read with the same columns in all its episodes: runs of other columns are of
    another source, which is the same folder.
    """
    kinds = list(dict.fromkeys(tuple(own) for own in columns))
    sources = ["dataset"] if len(kinds) == 1 else [f"dataset{k + 1}" for k in range(len(kinds))]
    lines = ['format = "loose-mapping/1"', 'model = "model.xml"']
    for source in sources:
        lines += ["", f"[sources.{source}]"]
        lines += [f"file = {json.dumps(folder)}"] if len(kinds) > 1 else []
    for number, (run, own) in enumerate(zip(recording.runs, columns, strict=True)):
        source = sources[kinds.index(tuple(own))]
        lines += ["", "[[runs]]", f'file = "{Path(run.name).stem}"', f'episodes = "{number}"']
        if run.excited:
            lines.append(f"excited = {json.dumps(list(run.excited))}")
        if run.pose is not None:
            pose = ", ".join(f"{joint} = {value!r}" for joint, value in run.pose.items())
            lines.append(f"pose = {{ {pose} }}")
        lines.append("[runs.columns]")
        for feature, entries in names.items():
            for each in entries:
                if each in own:
                    channel = f"{feature}[{each.removeprefix(PREFIX[feature])}]"
                    lines.append(
                        f'"{each}" = {{ source = "{source}", channel = "{channel}", '
                        f'unit = "{_unit(each, model)}" }}'
                    )
    return "\n".join(lines) + "\n"
