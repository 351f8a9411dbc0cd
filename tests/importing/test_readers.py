"""Every reader gives the columns that were written; what a logger does to them changes nothing."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy import io

from loose_env.errors import LooseEnvError
from loose_env.importing import propose
from loose_env.importing.clocks import chosen_time, samples_of
from loose_env.importing.sources import open_log
from tests.importing.arm_log import ARM, JOINTS, moved

Columns = dict[str, np.ndarray]
STATE, STAMP, HEADER = (
    "sensor_msgs/msg/JointState", "builtin_interfaces/msg/Time", "std_msgs/msg/Header"
)  # fmt: skip
START_NS = 1_714_557_600_000_000_000

# ------------------------------------------------------------------------- writers


def write_text(path: Path, time: np.ndarray, columns: Columns) -> Path:
    rows = np.column_stack([time, *columns.values()])
    lines = [",".join(["time [s]", *columns]), *(",".join(map(repr, r)) for r in rows.tolist())]
    path.with_suffix(".csv").write_text("\n".join(lines))
    return path.with_suffix(".csv")


def write_npz(path: Path, time: np.ndarray, columns: Columns) -> Path:
    np.savez(path, **{"time": time, **columns})
    return path.with_suffix(".npz")


def write_matrix(path: Path, time: np.ndarray, columns: Columns) -> Path:
    names = np.array([*columns])
    np.savez(path, t=time, q=np.column_stack([*columns.values()]), names=names)
    return path.with_suffix(".npz")


def write_mat(path: Path, time: np.ndarray, columns: Columns) -> Path:
    names = np.array([*columns], dtype=object)
    log = {"time": time[None], "q": np.stack([*columns.values()]), "names": names}
    io.savemat(path.with_suffix(".mat"), {"log": log, "gain": 3.0})
    return path.with_suffix(".mat")


def write_torch(path: Path, time: np.ndarray, columns: Columns) -> Path:
    values = {name: torch.from_numpy(own.copy()) for name, own in columns.items()}
    gains = {"kp": np.full(12, 20.0), "kd": np.full(12, 1.5)}  # arrays of numpy, of another length
    torch.save({"time": torch.from_numpy(time.copy()), **values, **gains}, path.with_suffix(".pt"))
    return path.with_suffix(".pt")


def write_parquet(path: Path, time: np.ndarray, columns: Columns) -> Path:
    pq.write_table(pa.table({"time": time, **columns}), path.with_suffix(".parquet"))
    return path.with_suffix(".parquet")


def write_hdf5(path: Path, time: np.ndarray, columns: Columns) -> Path:
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        file["log/time"] = time
        for name, values in columns.items():
            file[f"log/{name}"] = values
        file["other"] = h5py.ExternalLink("elsewhere.h5", "/log")
    return path.with_suffix(".h5")


def write_lerobot(path: Path, time: np.ndarray, columns: Columns) -> Path:
    vector = {"dtype": "float64", "shape": [len(columns)], "names": [*columns]}
    info = {"codebase_version": "v2.1", "fps": float(1 / (time[1] - time[0])),
            "features": {"q": vector}}  # fmt: skip
    for folder in ("meta", "data/chunk-000"):
        (path / folder).mkdir(parents=True)
    (path / "meta/info.json").write_text(json.dumps(info))
    table = {"q": [*np.column_stack([*columns.values()])], "timestamp": time,
             "episode_index": np.zeros(len(time), int)}  # fmt: skip
    pq.write_table(pa.table(table), path / "data/chunk-000/episode_000000.parquet")
    return path


def write_bag(path: Path, time: np.ndarray, columns: Columns, kind: str) -> Path:
    """Joint states, the bag recorded by a clock that is not the header's."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
    if kind == "bag":
        writer = Writer1(path.with_suffix(".bag"))
        serialise = store.serialize_ros1
    else:
        plugin = StoragePlugin.SQLITE3 if kind == "db3" else StoragePlugin.MCAP
        writer = Writer(path, version=9, storage_plugin=plugin)
        serialise = store.serialize_cdr
        if kind == "zstd":
            writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/states", STATE, typestore=store)
        for i, second in enumerate(time):
            stamp = START_NS + round(second * 1e9)
            at = store.types[STAMP](sec=stamp // 10**9, nanosec=stamp % 10**9)
            header = {"stamp": at, "frame_id": ""} | ({"seq": i} if kind == "bag" else {})
            names = sorted(columns, key=lambda name: hash((name, i % 2)))  # of any order
            message = store.types[STATE](
                header=store.types[HEADER](**header), name=names, velocity=np.empty(0),
                effort=np.empty(0), position=np.array([columns[name][i] for name in names]),
            )  # fmt: skip
            late = round(3e8 * (time[1] - time[0])) * (i % 3)
            writer.write(topic, stamp + late, serialise(message, STATE))
    return path.with_suffix(".bag") if kind == "bag" else path


WRITERS: Mapping[str, tuple[Callable[..., Path], str]] = {
    "text": (write_text, "{}"), "npz": (write_npz, "{}"), "matrix": (write_matrix, "q[{}]"),
    "mat": (write_mat, "q[{}]"), "torch": (write_torch, "{}"), "parquet": (write_parquet, "{}"),
    "hdf5": (write_hdf5, "{}"), "lerobot": (write_lerobot, "q[{}]"),
    **{kind: (lambda *log, kind=kind: write_bag(*log, kind), "position[{}]")
       for kind in ("bag", "db3", "mcap", "zstd")},
}  # fmt: skip
"""Writer, and the channel that it makes of a column."""


# ------------------------------------------------------------------------- columns

NAMES = st.lists(
    st.tuples(st.sampled_from(["q", "Winkel", "motor pos", "a.x", "V_in", "é", "J-"]),
              st.integers(0, 99)).map(lambda pair: f"{pair[0]}{pair[1]}"),
    min_size=2, max_size=5, unique=True,
)  # fmt: skip
QUICK = settings(max_examples=8, deadline=None)


@pytest.mark.parametrize("kind", WRITERS)
@QUICK
@given(names=NAMES, rows=st.integers(12, 40), rate=st.sampled_from([50.0, 125.0, 1000.0]),
       seed=st.integers(0, 99))  # fmt: skip
def test_columns_are_read_as_they_were_written(
    kind: str, names: list[str], rows: int, rate: float, seed: int
) -> None:
    time = np.arange(rows) / rate
    values = np.random.default_rng(seed).normal(0, 10.0, (len(names), rows))
    columns = dict(zip(names, values, strict=True))
    write, channel = WRITERS[kind]
    with TemporaryDirectory() as folder:
        log = open_log(write(Path(folder, "log"), time, columns))
        tables = [table for table in log.first() if table.columns]
    (table,) = tables
    clock, _ = chosen_time(tables)
    for name, own in columns.items():
        found = samples_of(table, channel.format(name), clock)
        np.testing.assert_allclose(found.time, time, atol=2e-7)
        np.testing.assert_array_equal(found.values, own)
    assert not table.texts


# ------------------------------------------------------------------------- what loggers do


MODEL = mujoco.MjModel.from_xml_string(ARM)
KINDS = ("text", "npz", "parquet", "hdf5", "torch")
Line = tuple[str, str, float, int]


def arm() -> tuple[np.ndarray, Columns]:
    motion = moved(4.0)
    log = {"q": motion.position, "dq": motion.velocity, "cmd": motion.command, "tau": motion.torque}
    named = {f"{JOINTS[i]}_{n}": own[:, i] for n, own in log.items() for i in range(3)}
    return motion.time, named


def lines(kind: str, time: np.ndarray, columns: Columns) -> dict[str, Line]:
    with TemporaryDirectory() as folder:
        proposal = propose([str(WRITERS[kind][0](Path(folder, "log"), time, columns))], MODEL)
    return {
        e.column: (e.candidate.key.channel, e.scaling.unit, e.scaling.scale, e.scaling.sign)
        for e in proposal.columns if not e.open
    }  # fmt: skip


@cache
def known() -> dict[str, Line]:
    found = lines("text", *arm())
    assert len(found) == 12
    return found


@QUICK
@given(data=st.data(), kind=st.sampled_from(KINDS), order=st.permutations(range(12)),
       more=st.lists(st.sampled_from(["noise", "still", "nan", "walk"]), max_size=4))  # fmt: skip
def test_order_and_other_columns_change_no_role(
    data: st.DataObject, kind: str, order: list[int], more: list[str]
) -> None:
    time, columns = arm()
    rng = np.random.default_rng(0)
    noise = rng.normal(size=len(time))
    made = {"noise": noise, "still": 0 * noise + 3.0, "nan": np.nan * noise,
            "walk": np.cumsum(noise)}  # fmt: skip
    whole = [*(([*columns][i], [*columns.values()][i]) for i in order)]
    for i, each in enumerate(more):
        whole.insert(data.draw(st.integers(0, len(whole))), (f"extra{i}_{each}", made[each]))
    assert lines(kind, time, dict(whole)) == known()


@QUICK
@given(kind=st.sampled_from(KINDS), late=st.lists(st.integers(1, 490), max_size=20, unique=True),
       by=st.integers(1, 8), lost=st.lists(st.integers(1, 490), max_size=20))  # fmt: skip
def test_late_and_lost_rows_are_put_right_or_refused_in_a_line(
    kind: str, late: list[int], by: int, lost: list[int]
) -> None:
    time, columns = arm()
    order = np.argsort(np.arange(len(time)) + (by + 0.5) * np.isin(np.arange(len(time)), late),
                       kind="stable")  # fmt: skip
    order = order[~np.isin(order, lost)]
    try:
        found = lines(kind, time[order], {name: own[order] for name, own in columns.items()})
    except LooseEnvError as error:
        assert "\n" not in str(error) and "time" in str(error)
    else:
        assert {c: line[0] for c, line in found.items()} == {c: k[0] for c, k in known().items()}


@QUICK
@given(missing=st.dictionaries(st.integers(0, 11), st.sampled_from([0.02, 0.3, 1.0]), max_size=3))
def test_a_column_without_samples_costs_no_other(missing: dict[int, float]) -> None:
    time, columns = arm()
    rng = np.random.default_rng(1)
    log = {
        name: np.where(rng.random(len(time)) < missing.get(i, 0.0), np.nan, own)
        for i, (name, own) in enumerate(columns.items())
    }
    found = {line[0] for line in lines("text", time, log).values()}
    whole = {name for i, name in enumerate(columns) if i not in missing or "_tau" in name}
    assert {n for n in whole if "_tau" not in n} <= found <= {*columns}
