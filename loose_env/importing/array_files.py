"""Files of named arrays: npz, mat, pt, Parquet and HDF5; LeRobot datasets.

Arrays of one length are the columns of a table; groups of like names are episodes. A rate or a step
beside them is their time where no column is one.
"""

from __future__ import annotations

import json
import re
from _codecs import encode  # by which pickles hold bytes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Gt, Le
from numpy.typing import NDArray

from loose_env.errors import InvalidData, LooseEnvError, MissingExtra
from loose_env.importing.samples import ChannelKey, Log, Table, damaged, entry_names, natural
from loose_env.importing.units import unit_in
from loose_env.io import restored
from loose_env.recording import MOST_VALUES, read_text

_MOST_BYTES = 2**30
_FEWEST = 10
"""Samples from which an array is a signal and no constant of the set-up."""
_WIDEST = 4096
"""Entries from which a vector is an image or a matrix of weights."""
_RATES = re.compile(r"(\w*_?hz|rate|freq|frequency|fs|fps|control_freq|sample_rate)", re.I)
_STEPS = re.compile(r"(dt|ts|sample_time|timestep|time_step|sampling_time)", re.I)
_NAMES = ("columns", "names", "labels", "header", "headers", "fields", "joint_names", "joints",
          "channels", "dof_names", "data_columns")  # fmt: skip
Leaves = dict[str, Any]
"""Arrays, lists, numbers and texts of a file by the ways to them, such as "group/name"."""


def open_arrays(path: Path, name: str) -> Log:
    """Open a file of arrays."""
    read = lru_cache(maxsize=1)(lambda: _leaves(path, name))  # asked for an episode at a time
    places = _episodes(read())

    def tables(episode: str, _: Sequence[ChannelKey] | None) -> list[Table]:
        place = f"{name}: {episode}" if episode else name
        return [_table(_episodes(read())[episode], place, read())]

    if "" in places and not tables("", None)[0].columns:
        shapes = [f"{k} of {'x'.join(map(str, np.shape(v))) or 'one'}"
                  for k, v in [*read().items()][:4]]  # fmt: skip
        raise InvalidData(
            f"{name}: it holds no arrays of numbers that share {_FEWEST} or more samples"
            f"{' (' + ', '.join(shapes) + ')' if shapes else ''}: is it a log? Save the measured "
            "channels as a table"
        )
    angle = "rad" if path.suffix.lower() in (".h5", ".hdf5") else ""
    return Log(name=name, tables=tables, episodes=() if "" in places else (*places,), angle=angle)


# ------------------------------------------------------------------------- tables


def _episodes(leaves: Leaves) -> dict[str, Leaves]:
    """Groups of like names that hold signals; all of the only one under "" where there are none."""
    while True:
        groups: dict[str, Leaves] = {}
        for key, value in leaves.items():
            head, inside, rest = key.partition("/")
            groups.setdefault(head if inside else "", {})[rest or key] = value
        found = {k: g for k, g in groups.items() if any(map(_is_signal, g.values()))}
        if "" in found or len(found) != 1:
            alike = "" not in found and len({(*sorted(g),) for g in found.values()}) == 1
            return {k: found[k] for k in sorted(found, key=natural)} if alike else {"": leaves}
        ((_, leaves),) = found.items()


def _is_signal(value: Any) -> bool:
    matrix = _matrix(value)
    return matrix is not None and max(matrix.shape) >= _FEWEST


def _table(leaves: Leaves, place: str, whole: Leaves) -> Table:
    """Arrays that have the length that most of them have, as columns."""
    found = {key: _matrix(value) for key, value in leaves.items()}
    arrays = {k: v for k, v in found.items() if v is not None and v.shape[1] <= _WIDEST}
    # Most arrays lie along the time, by their longer sides; of equals the longer one is it.
    lengths = [n for a in arrays.values() if (n := max(a.shape)) >= _FEWEST]
    length = max(set(lengths), key=lambda n: (lengths.count(n), n), default=0)
    around = [*leaves.items(), *whole.items()]
    columns: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    for key, array in arrays.items():
        if array.shape[0] != length and array.shape[1] == length:
            array = array.T  # as MATLAB keeps rows
        if array.shape[0] == length:
            width = array.shape[1]
            own = vector_columns(key, array, _labels(around, key, width, _NAMES))
            told = _labels(around, key, width, ("units", "unit"), unique=False)
            columns |= own
            units |= {n: u for n, u in zip(own, told, strict=False) if unit_in(f"[{u}]")}
    if length * len(columns) > MOST_VALUES:
        raise InvalidData(f"{place}: more than {MOST_VALUES} values; split the file")
    timed = any("time" in key.lower() or key in ("t", "ts") for key in columns)
    rate = None if timed else next(filter(None, (_rate(k, v) for k, v in around)), None)
    return Table(place=place, columns=columns, units=units, row_word="sample", rate_hz=rate)


def vector_columns(
    key: str, matrix: NDArray[Any], labels: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Columns of a matrix by its name and its entries' labels or numbers."""
    width = matrix.shape[1]
    names = [f"{key}[{each}]" for each in labels or range(width)] if width > 1 or labels else [key]
    return {name: matrix[:, i] for i, name in enumerate(names)}


def _matrix(value: Any) -> NDArray[Any] | None:
    """Numbers as a matrix of rows in time; None for what is none."""
    if isinstance(value, list):
        try:
            value = np.array([np.nan if v is None else v for v in value])
        except (ValueError, OverflowError):
            return None
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub" or value.size < 2:
        return None
    if value.ndim == 3 and 1 in value.shape:
        value = value.reshape([n for n in value.shape if n != 1] or [1])
    if value.dtype != np.int64:
        value = value.astype(np.float64, copy=False)
    return np.asarray(value.reshape(len(value), -1)) if value.ndim in (1, 2) else None


def _labels(
    leaves: Sequence[tuple[str, Any]], key: str, width: int, names: Sequence[str],
    *, unique: bool = True,
) -> tuple[str, ...]:  # fmt: skip
    """Names, or units, of the entries of a vector where the file gives one for each."""
    lasts = ((way.rsplit("/", 1)[-1].lower(), value) for way, value in leaves if width > 1)
    lists = (v for last, v in lasts if last in names or last in {f"{key}_{n}" for n in names})
    told = (entry_names(v, width, unique=unique) for v in lists if np.ndim(v) == 1)
    return next(filter(None, told), ())


def _rate(way: str, value: Any) -> float | None:
    """Rate that a number of the file states by its name [Hz]."""
    name = way.rsplit("/", 1)[-1].lstrip("@")
    if isinstance(value, (bool, str)) or np.ndim(value) or not np.isreal(value) or not value:
        return None
    rate = float(value) if _RATES.fullmatch(name) else 1 / value if _STEPS.fullmatch(name) else 0
    return float(rate) if 0 < rate < 1e6 else None


# ------------------------------------------------------------------------- files


def _leaves(path: Path, name: str) -> Leaves:
    """Contents of a file; nothing in it is executed."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InvalidData(f"{name}: more than {_MOST_BYTES} bytes; split the file")
        return READERS[path.suffix.lower()](path)
    except LooseEnvError as error:
        raise type(error)(f"{name}: {str(error).removeprefix(f'{name}: ')}") from None
    except Exception as error:  # each library raises its own on damaged bytes
        raise damaged(name, f"{path.suffix.lstrip('.')} file", error) from None


def _flat(tree: Any, way: str = "") -> Leaves:
    """Contents of nested tables by the ways to them."""
    if not isinstance(tree, dict):
        return {way or "data": tree}
    inner = (_flat(value, f"{way}/{key}" if way else str(key)) for key, value in tree.items())
    return {key: value for each in inner for key, value in each.items()}


def _of_npz(path: Path) -> Leaves:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        if sum(each.file_size for each in archive.zip.infolist()) > _MOST_BYTES:
            raise InvalidData(f"more than {_MOST_BYTES} bytes once expanded")
        return dict(archive)


def _of_mat(path: Path) -> Leaves:
    from scipy import io

    try:
        whole = io.loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3 is HDF5
        return _of_hdf5(path)
    return _flat({key: each for key, each in whole.items() if not key.startswith("__")})


def _of_torch(path: Path) -> Leaves:
    try:
        import torch
    except ImportError:
        raise MissingExtra("files of torch need torch: pip install torch") from None
    # Arrays of numpy beside the tensors: what rebuilds numbers runs no other code.
    numbers = {type(np.dtype(kind)) for kind in "?bBhHiIqQefd"}
    known: list[Any] = [np.ndarray, np.dtype, np.zeros(0).__reduce__()[0], encode, *numbers]
    try:
        with torch.serialization.safe_globals(known):
            whole = torch.load(path, map_location="cpu", weights_only=True)
    except Exception:
        raise InvalidData(
            "it holds more than tensors, arrays, numbers and texts, or is damaged; files that can "
            "hold code are not read: save its tensors as a dictionary, or as .npz"
        ) from None
    tensor = torch.Tensor
    return {k: v.numpy() if isinstance(v, tensor) else v for k, v in _flat(whole).items()}


def parquet_columns(path: Path) -> dict[str, NDArray[Any]]:
    """Columns of numbers of a Parquet table, those of vectors as matrices."""
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        table = file.read(use_threads=False)
    found: dict[str, NDArray[Any]] = {}
    for key in table.column_names:
        column, width = table.column(key), 1
        if hasattr(column.type, "value_type"):
            widths = pc.list_value_length(column).unique().to_pylist()
            width, column = widths[0] if len(widths) == 1 else 0, pc.list_flatten(column)
        if pa.types.is_timestamp(column.type):
            column = column.cast("int64")
        values = np.asarray(column.to_numpy()) if width else np.empty(0, object)
        if values.dtype.kind in "fiub":
            found[key] = values.reshape(table.num_rows, width) if width > 1 else values
    return found


def _of_hdf5(path: Path) -> Leaves:
    """Numbers of an HDF5 file; links to other files, which were not given, are not followed."""
    try:
        import h5py
    except ImportError:
        raise MissingExtra("HDF5 files need h5py: pip install 'loose-env[import]'") from None
    found: Leaves = {}

    def take(way: str, here: Any) -> None:
        if isinstance(here, h5py.Dataset):
            own = not here.is_virtual and not here.external and len(here.shape) < 3
            if own and here.dtype.kind in "fiub" and here.size <= MOST_VALUES:
                found[way] = here[()]
            elif own and here.dtype.kind in "SO" and len(here.shape) == 1 and len(here) <= _WIDEST:
                found[way] = [str(v, "utf-8") if isinstance(v, bytes) else str(v) for v in here[()]]
            return
        for key, value in here.attrs.items():
            if isinstance(value, str) and value[:1] == "{":  # robomimic's hold a table
                found.update(_flat(json.loads(value), f"{way}/@{key}"))
            elif np.ndim(value) == 0:
                found[f"{way}/@{key}"] = value

    with h5py.File(path, "r") as file:
        take("", file)
        file.visititems(take)  # which follows no links to other files
    return found


READERS: dict[str, Callable[[Path], Leaves]] = {
    ".npz": _of_npz, ".mat": _of_mat, ".pt": _of_torch, ".pth": _of_torch,
    ".parquet": parquet_columns, ".hdf5": _of_hdf5, ".h5": _of_hdf5,
}  # fmt: skip
"""Ending -> reader."""


# ------------------------------------------------------------------------- LeRobot

INFO = "meta/info.json"
"""File that makes a folder a LeRobot dataset."""
_UNITS = (
    "a LeRobot dataset does not say the unit of its states and actions, which depends on the "
    "robot's settings: unit = 'deg', unit = 'rad', or, where they are normalised to -100..100, "
    "unit = 'rad' with scale = (upper - lower) / 200 and offset = (upper + lower) / 2 of the "
    "calibrated range [rad]; 'loose import --guess' proposes one"
)

_INDICES = ("episode_index", "frame_index", "index", "task_index")
_NORMALISED = ("gripper",)
"""Joints that the drivers of lerobot normalise to 0..100 whatever the others' unit."""


@dataclass(frozen=True, kw_only=True)
class _Info:
    """What is needed of ``meta/info.json``."""

    codebase_version: Literal["v2.0", "v2.1", "v3.0"]
    fps: Annotated[float, Gt(0.0), Le(1e6)]
    features: Any = None
    total_episodes: Any = None


def open_lerobot(folder: Path, name: str) -> Log:
    """Open a dataset: its tables say which episodes it has, whatever is missing of ``meta``."""
    place = f"{name}/{INFO}"
    if not (folder / INFO).is_file():
        raise InvalidData(f"{place}: there is no such file, which says the rate and the names; "
                          "download the dataset again, with its meta")  # fmt: skip
    try:
        parsed = json.loads(read_text(folder / INFO, place, 2**28))
    except (ValueError, RecursionError) as error:
        raise InvalidData(f"{place}: not JSON: {str(error)[:120]}") from None
    info = restored(_Info, parsed, f"{place}:")

    @lru_cache(maxsize=2)
    def whole(path: Path) -> dict[str, NDArray[Any]]:
        own = f"{name}/{path.relative_to(folder).as_posix()}"
        try:
            return parquet_columns(path)
        except Exception as error:  # pyarrow raises OSError, ValueError and its own
            raise damaged(own, "Parquet file", error, "; download it again") from None

    where: dict[int, Path] = {}
    for path in sorted((folder / "data").glob("*/*.parquet")):
        where |= dict.fromkeys(whole(path).get("episode_index", np.empty(0, int)).tolist(), path)
    if not where:
        raise InvalidData(f"{name}/data: there are no Parquet files with a column 'episode_index'; "
                          "download the dataset again, with its data")  # fmt: skip
    told, names = info.total_episodes, {f"episode_{number:06d}": number for number in sorted(where)}
    lacking = isinstance(told, int) and told != len(names)
    done = [f"{name}: {len(names)} episodes are there, and {INFO} says {told}"] if lacking else []

    def tables(episode: str, _: Sequence[ChannelKey] | None) -> list[Table]:
        path = where[names[episode]]
        place = f"{name}/{path.relative_to(folder).as_posix()}: {episode}"
        return [_frames(whole(path), names[episode], place, info, done)]

    return Log(name=name, tables=tables, episodes=tuple(names), ambiguous=_UNITS)


def _frames(
    whole: dict[str, NDArray[Any]], number: int, place: str, info: _Info, done: Sequence[str]
) -> Table:
    """Frames of one episode."""
    rows = np.flatnonzero(whole["episode_index"] == number)
    if len(rows) < 2:
        raise InvalidData(f"{place}: it has {len(rows)} frames; choose others by episodes of the "
                          "run, such as episodes = [0, 3]")  # fmt: skip
    columns: dict[str, NDArray[Any]] = {}
    for key, values in whole.items():
        if key not in _INDICES:
            matrix = values[rows].reshape(len(rows), -1).astype(np.float64)
            feature = info.features.get(key) if isinstance(info.features, dict) else None
            named = feature.get("names") if isinstance(feature, dict) else None
            columns |= vector_columns(key, matrix, _names_in(named, matrix.shape[1]))
    even = np.arange(len(rows)) / info.fps
    stamps = columns.get("timestamp", even)
    step = float(np.spacing(np.float32(np.max(np.abs(stamps)))))
    if step > 0.5 / info.fps:
        words = f"{place}: its timestamps are float32 of {stamps[0]:.10g} s, which has steps of "
        done = [*done, f"{words}{step:.3g} s; the frames are taken at {info.fps:g} Hz instead"]
        stamps = even
    # Whole frames that were rounded to float32 are taken without the rounding.
    frames = np.round(stamps * info.fps) / info.fps
    columns["timestamp"] = frames if np.all(np.abs(frames - stamps) <= max(step, 1e-7)) else stamps
    units = {name: "%" for name in columns if any(w in name.lower() for w in _NORMALISED)}
    return Table(place=place, columns=columns, units=units, row_word="frame", done=(*done,),
                 time="timestamp")  # fmt: skip


def _names_in(names: Any, width: int) -> tuple[str, ...]:
    """Names of the entries of a vector, a list or a table that holds one; else none.

    Examples
    --------
    >>> _names_in({"motors": ["hip", "knee"]}, 2), _names_in(["state"], 2)
    (('hip', 'knee'), ())
    """
    if isinstance(names, dict):
        inside = [own for each in names.values() if (own := _names_in(each, width))]
        return inside[0] if inside else _names_in([*names], width)  # names as keys
    return entry_names(names, width)
