"""Files of named arrays: npz, npy, mat, pt, json, Parquet, HDF5, and time series of mujoco.sysid.

Arrays of one length are the columns of a table; a list of tables, or groups of like names, are
episodes. A rate or a step beside them is their time where no column is one.
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from loose_env.errors import InvalidData, LooseEnvError, MissingExtra
from loose_env.importing.samples import ChannelKey, FileKind, Log, Table, natural
from loose_env.importing.units import unit_in
from loose_env.recording import MOST_VALUES

ENDINGS: dict[str, FileKind] = {
    ".npz": "sysid", ".npy": "arrays", ".mat": "arrays", ".pt": "arrays", ".pth": "arrays",
    ".json": "arrays", ".jsonl": "arrays", ".parquet": "arrays", ".hdf5": "hdf5", ".h5": "hdf5",
}  # fmt: skip
_MOST_BYTES = 2**30
_FEWEST = 10
"""Samples from which an array is a signal and no constant of the set-up."""
_WIDEST = 4096
"""Entries from which a vector is an image or a matrix of weights."""
_RATES = re.compile(
    r"(^|_|/|@)(\w*_?hz|rate|freq|frequency|fs|fps|control_freq|sample_rate)$", re.I
)
_STEPS = re.compile(r"(^|_|/|@)(dt|ts|sample_time|timestep|time_step|sampling_time)$", re.I)
_NAMES = ("columns", "names", "labels", "header", "headers", "fields", "joint_names", "joints",
          "channels", "dof_names", "data_columns")  # fmt: skip
_NUMBER = re.compile(r"(\d+)")
_PARTS = ("control", "sensordata", "state")
_SIGNALS = ("sensor", "observation", "position", "velocity", "activation", "control")
"""Kinds of signals, by the numbers of ``mujoco.sysid.SignalType``."""
Tree = Any
"""Nested tables, lists, arrays, numbers and texts, as a file holds them."""


def open_arrays(path: Path, name: str, kind: FileKind) -> Log:
    """Open a file of arrays."""
    read = lru_cache(maxsize=1)(
        lambda: _tree(path, name)
    )  # an episode of many is asked for at a time
    tree = read()
    parts = _series_parts(tree) if isinstance(tree, dict) else ()
    if parts:
        return Log(
            name=name, kind="sysid", words="time series of mujoco.sysid",
            tables=lambda _, __: [_series(read(), part, name) for part in parts],
        )  # fmt: skip
    places = _episodes(tree)
    rate = _rate_of(tree)

    def tables(episode: str, _: Sequence[ChannelKey] | None) -> list[Table]:
        place = f"{name}: {episode}" if episode else name
        return [_table(places[episode], place, rate, tree)]

    if len(places) == 1 and "" in places:
        first = tables("", None)[0]
        if not first.columns:
            raise InvalidData(f"{name}: {_holds(tree)}")
    option = f"time = {{ rate_hz = {rate:.9g} }}  # as the file states" if rate else ""
    return Log(
        name=name,
        kind="arrays" if kind == "sysid" else kind,
        words=path.suffix.lstrip(".").upper() if kind != "hdf5" else "HDF5",
        tables=tables,
        options=(option,) if option else (),
        episodes=tuple(places) if "" not in places else (),
    )


# ------------------------------------------------------------------------- tables


def _episodes(tree: Tree) -> dict[str, Tree]:
    """Episodes of a tree by name; the tree itself under "" where it has none."""
    here = tree
    while isinstance(here, dict):
        groups = {k: v for k, v in here.items() if isinstance(v, dict) and _has_signals(v)}
        lists = {k: v for k, v in here.items() if _is_list_of_tables(v)}
        if len(lists) == 1 and not groups:
            ((key, members),) = lists.items()
            return {f"{key}_{i}": each for i, each in enumerate(members)}
        own = any(_is_signal(v) for v in here.values())
        kinds = {tuple(sorted(each)) for each in groups.values()}
        numbered = all(_NUMBER.search(key) for key in groups)
        if groups and not own and len(kinds) == 1 and (numbered or len(groups) > 1):
            return {key: groups[key] for key in sorted(groups, key=natural)}
        if len(groups) != 1 or own:
            break
        here = next(iter(groups.values()))
    if _is_list_of_tables(here):
        return {f"episode_{i}": each for i, each in enumerate(here)}
    cubes = [v for _, v in _leaves(here) if getattr(v, "ndim", 0) == 3 and v.dtype.kind in "fiu"]
    if cubes and len({c.shape[:2] for c in cubes}) == 1 and cubes[0].shape[1] >= _FEWEST:
        count = cubes[0].shape[0]

        def part(i: int) -> dict[str, Any]:
            return {k: v[i] for k, v in _leaves(here) if np.ndim(v) >= 2 and len(v) == count}

        return {f"episode_{i}": part(i) for i in range(count)}
    return {"": here}


def _table(tree: Tree, place: str, rate: float | None, whole: Tree) -> Table:
    """Arrays of a tree that have the length that most of them have, as columns."""
    arrays: dict[str, NDArray[Any]] = {}
    for key, value in _leaves(tree):
        array = _matrix(value)
        if array is not None and array.shape[1] <= _WIDEST:
            arrays[key or "data"] = array
    lengths = [n for a in arrays.values() for n in {a.shape[0], a.shape[1]} if n >= _FEWEST]
    if not lengths:
        return Table(place=place, columns={}, kind=_holds(tree))
    # Most values lie along the time; of equals the longer one is it.
    length = max(set(lengths), key=lambda n: (lengths.count(n), n))
    columns: dict[str, NDArray[Any]] = {}
    aliases: dict[str, str] = {}
    units: dict[str, str] = {}
    for key, array in arrays.items():
        if array.shape[0] != length and array.shape[1] == length:
            array = array.T  # as MATLAB keeps rows
        if array.shape[0] != length:
            continue
        labels = _labels(tree, whole, key, array.shape[1], _NAMES)
        told = _labels(tree, whole, key, array.shape[1], ("units", "unit"))
        own, others = vector_columns(key, array, labels if array.shape[1] > 1 else ())
        columns |= own
        aliases |= others
        units |= {n: u for n, u in zip(own, told, strict=False) if unit_in(f"[{u}]")}
    size = length * len(columns)
    if size > MOST_VALUES:
        raise InvalidData(f"{place}: {size} values; at most {MOST_VALUES} are read")
    return Table(
        place=place, columns=columns, aliases=aliases, units=units, row_word="sample",
        rate_hz=rate if not any(
            "time" in key.lower() or key in ("t", "ts") for key in columns) else None,
        kind=f"{len(columns)} columns of {length}",
    )  # fmt: skip


def vector_columns(
    key: str, matrix: NDArray[Any], labels: Sequence[str]
) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Columns of a matrix by its name and its entries' labels or numbers, and their aliases."""
    width = matrix.shape[1]
    names = [f"{key}[{each}]" for each in labels or range(width)] if width > 1 or labels else [key]
    columns = {name: matrix[:, i] for i, name in enumerate(names)}
    return columns, {f"{key}[{i}]": name for i, name in enumerate(names)}


def _leaves(tree: Tree, key: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Arrays and lists of a tree with the ways to them."""
    if isinstance(tree, dict) and depth < 6:
        for name, value in tree.items():
            yield from _leaves(value, f"{key}/{name}" if key else str(name), depth + 1)
    elif isinstance(tree, list) and tree and isinstance(tree[0], dict):
        names = list(dict.fromkeys(n for each in tree if isinstance(each, dict) for n in each))
        for name in names:
            values = [each.get(name) if isinstance(each, dict) else None for each in tree]
            yield from _leaves(values, f"{key}/{name}" if key else str(name), depth + 1)
    elif isinstance(tree, (list, np.ndarray)):
        yield key, tree


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
    if value.ndim not in (1, 2):
        return None
    value = value if value.dtype.kind == "i" and value.itemsize == 8 else value.astype(np.float64)
    return np.asarray(value.reshape(len(value), -1))


def _labels(tree: Tree, whole: Tree, key: str, width: int, names: Sequence[str]) -> tuple[str, ...]:
    """Names, or units, of the entries of a vector where the file gives one for each."""
    for holder in (tree, whole):
        for name, value in _texts(holder):
            last = name.rsplit("/", 1)[-1].lower()
            own = last in names or last in {f"{key}_{n}" for n in names}
            alone = len(set(value)) == width or names is not _NAMES
            plain = all(v and not set(v) & set("[]") for v in value)
            if own and len(value) == width and alone and plain:
                return tuple(value)
    return ()


def _texts(tree: Tree, key: str = "", depth: int = 0) -> Iterator[tuple[str, list[str]]]:
    if isinstance(tree, dict) and depth < 4:
        for name, value in tree.items():
            yield from _texts(value, f"{key}/{name}" if key else str(name), depth + 1)
    elif (
        isinstance(tree, (list, np.ndarray))
        and np.ndim(tree)
        and len(tree)
        and all(isinstance(each, (str, np.str_)) for each in list(tree)[:_WIDEST])
    ):
        yield key, [str(each).strip() for each in tree]


def _rate_of(tree: Tree, key: str = "", depth: int = 0) -> float | None:
    """Rate that a number of the file states by its name [Hz]."""
    if isinstance(tree, dict) and depth < 4:
        for name, value in tree.items():
            found = _rate_of(value, str(name), depth + 1)
            if found:
                return found
        return None
    if isinstance(tree, bool) or not (_is_plain(tree) or (np.ndim(tree) == 0 and _is_array(tree))):
        return None
    value = float(tree)
    rate = value if _RATES.search(key) else 1 / value if value and _STEPS.search(key) else 0.0
    return rate if 0 < rate < 1e6 else None


def _is_plain(value: Any) -> bool:
    return isinstance(value, (int, float, np.number))


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in "fiu"


def _is_signal(value: Any) -> bool:
    if isinstance(value, list):
        return len(value) >= _FEWEST and (_is_plain(value[0]) or _matrix(value) is not None)
    return isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and max(
        value.shape, default=0) >= _FEWEST  # fmt: skip


def _has_signals(tree: Tree) -> bool:
    if isinstance(tree, dict):
        return any(_is_signal(v) or _has_signals(v) for v in tree.values())
    return _is_list_of_tables(tree)


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(
        isinstance(each, dict) and any(_is_signal(v) for v in each.values()) for each in value
    )  # fmt: skip


def _holds(tree: Tree) -> str:
    """Words for a file that holds no signals."""
    shapes = [f"{k or 'data'} of {'x'.join(map(str, np.shape(v))) or 'one'}"
              for k, v in list(_leaves(tree))[:4]]  # fmt: skip
    return (
        f"it holds no arrays of numbers that share {_FEWEST} or more samples"
        f"{' (' + ', '.join(shapes) + ')' if shapes else ''}: is it a log? Save the measured "
        "channels as a table"
    )


# ------------------------------------------------------------------------- files


def _tree(path: Path, name: str) -> Tree:
    """Contents of a file; nothing in it is executed."""
    readers: dict[str, Callable[[Path, str], Tree]] = {
        ".npz": _of_npz, ".npy": _of_npy, ".mat": _of_mat, ".pt": _of_torch, ".pth": _of_torch,
        ".json": _of_json, ".jsonl": _of_json, ".parquet": _of_parquet,
    }  # fmt: skip
    ending = path.suffix.lower()
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InvalidData(f"{name}: more than {_MOST_BYTES} bytes; split the file")
        return readers.get(ending, _of_hdf5)(path, name)
    except LooseEnvError:
        raise
    except Exception as error:  # each library raises its own on damaged bytes
        words = " ".join(str(error).split())[:120] or type(error).__name__
        kind = ending.lstrip(".") or "HDF5"
        raise InvalidData(f"{name}: no whole {kind} file, cut short or damaged ({words})") from None


def _of_npz(path: Path, name: str) -> Tree:
    """Arrays of an archive. Their headers are checked before memory is taken for them."""
    found: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive:
        members = [each for each in archive.infolist() if each.filename.endswith(".npy")]
        if sum(each.file_size for each in members) > _MOST_BYTES:
            raise InvalidData(f"{name}: more than {_MOST_BYTES} bytes once expanded")
        for each in members:
            with archive.open(each) as file:
                version = npy.read_magic(file)
                header = npy.read_array_header_1_0 if version == (1, 0) else None
                shape, _, kind = (header or npy.read_array_header_2_0)(file)
            if kind.hasobject or kind.itemsize * np.prod(shape, dtype=float) > each.file_size:
                raise InvalidData(f"{name}: {each.filename} is damaged, or holds objects")
            with archive.open(each) as file:
                found[each.filename.removesuffix(".npy")] = npy.read_array(file)
    return found


def _of_npy(path: Path, _: str) -> Tree:
    return {"data": np.load(path, allow_pickle=False)}


def _of_mat(path: Path, name: str) -> Tree:
    from scipy import io

    try:
        whole = io.loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3 is HDF5
        return _of_hdf5(path, name)
    return {key: each for key, each in whole.items() if not key.startswith("__")}


def _of_torch(path: Path, name: str) -> Tree:
    try:
        import torch
    except ImportError:
        raise MissingExtra(f"{name}: files of torch need torch: pip install torch") from None
    try:
        whole = torch.load(path, map_location="cpu", weights_only=True)
    except Exception:
        raise InvalidData(
            f"{name}: it holds more than tensors, numbers and texts, or is damaged; files that can "
            "hold code are not read: save its tensors as a dictionary, or as .npz"
        ) from None

    def plain(each: Any) -> Any:
        if isinstance(each, dict):
            return {str(k): plain(v) for k, v in each.items()}
        if isinstance(each, (list, tuple)):
            return [plain(v) for v in each]
        return each.numpy() if isinstance(each, torch.Tensor) else each

    return plain(whole)


def _of_json(path: Path, name: str) -> Tree:
    text = path.read_text("utf-8-sig")
    try:
        if path.suffix.lower() == ".jsonl" or (text.lstrip()[:1] == "{" and "\n{" in text.strip()):
            try:
                return json.loads(text)
            except ValueError:
                return [json.loads(line) for line in text.splitlines() if line.strip()]
        return json.loads(text)
    except RecursionError:
        raise InvalidData(f"{name}: nested too deeply") from None


def _of_parquet(path: Path, _: str) -> Tree:
    return parquet_columns(path)


def parquet_columns(path: Path, columns: Sequence[str] | None = None) -> dict[str, NDArray[Any]]:
    """Columns of numbers of a Parquet table, those of vectors as matrices."""
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        table = file.read(columns=columns, use_threads=False)
    found: dict[str, NDArray[Any]] = {}
    for key in table.column_names:
        column, width = table.column(key), 1
        if hasattr(column.type, "value_type"):
            widths = pc.list_value_length(column).unique().to_pylist()
            width, column = widths[0] if len(widths) == 1 else 0, pc.list_flatten(column)
        if pa.types.is_timestamp(column.type):
            column = column.cast("int64")
        plain = pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
        if (plain or pa.types.is_boolean(column.type)) and width:
            values = np.asarray(column.to_numpy())
            found[key] = values.reshape(table.num_rows, width) if width > 1 else values
    return found


def _of_hdf5(path: Path, name: str) -> Tree:
    """Numbers of an HDF5 file; links to other files, which were not given, are not followed."""
    try:
        import h5py
    except ImportError:
        raise MissingExtra("HDF5 files need h5py: pip install 'loose-env[import]'") from None

    def walk(group: Any, depth: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key in group:
            if depth > 6 or not isinstance(group.get(key, getlink=True), h5py.HardLink):
                continue
            here = group[key]
            if isinstance(here, h5py.Group):
                found[key] = walk(here, depth + 1)
            elif not here.is_virtual and not here.external and here.dtype.kind in "fiub":
                if len(here.shape) in (0, 1, 2) and here.size <= MOST_VALUES:
                    found[key] = here[()]
            elif here.dtype.kind in "SO" and len(here.shape) == 1 and len(here) <= _WIDEST:
                found[key] = [str(v, "utf-8") if isinstance(v, bytes) else str(v) for v in here[()]]
        for key, value in group.attrs.items():
            if isinstance(value, (str, bytes)) and key == "env_args":
                try:
                    kwargs = json.loads(value)["env_kwargs"]
                except (KeyError, TypeError, ValueError, RecursionError):
                    continue
                found["env_args"] = {"control_freq": kwargs.get("control_freq")}
            elif np.ndim(value) == 0 and _is_plain(value):
                found[f"@{key}"] = value
        return found

    with h5py.File(path, "r") as file:
        return walk(file, 0)


# ------------------------------------------------------------------------- mujoco.sysid


def _series_parts(arrays: Mapping[str, Any]) -> tuple[str, ...]:
    """Parts of a ``SystemTrajectory``, or "" for a ``TimeSeries``; none of another file."""
    whole = ("",) if {"times", "data"} <= set(arrays) else ()
    return whole or tuple(p for p in _PARTS if f"{p}_times" in arrays)


def _series(arrays: Mapping[str, Any], part: str, name: str) -> Table:
    prefix = f"{part}_" if part else ""
    place = f"{name}: {prefix}data"
    times, data = np.asarray(arrays[f"{prefix}times"]), np.asarray(arrays.get(f"{prefix}data"))
    data = data[:, None] if data.ndim == 1 else data
    if times.dtype.kind not in "fiu" or data.dtype.kind not in "fiub":
        raise InvalidData(f"{place}: {data.dtype} at times of {times.dtype}; both are numbers")
    if times.ndim != 1 or data.ndim != 2 or len(times) != len(data) or len(times) < 2:
        raise InvalidData(
            f"{place}: shape {data.shape} at times of shape {times.shape}; a series has one row "
            "for each time, and two at least"
        )
    names = [f"#{i + 1}" for i in range(data.shape[1])]
    words: dict[str, str] = {}
    encoded = str(arrays.get(f"{prefix}signal_mapping", "{}"))
    try:
        for signal, (kind, own) in json.loads(encoded).items():
            for i, column in enumerate(own):
                key = names[int(column)] = f"{signal}[{i}]" if len(own) > 1 else signal
                words[key] = _SIGNALS[kind]
    except (ValueError, TypeError, IndexError, AttributeError, KeyError, RecursionError):
        raise InvalidData(f"{name}: {prefix}signal_mapping is damaged") from None
    return Table(
        place=name, topic=part, words=words, times=times.astype(np.float64), row_word="sample",
        columns={key: data[:, i].astype(np.float64) for i, key in enumerate(names)},
        aliases={f"#{i + 1}": key for i, key in enumerate(names)}, kind=f"{len(names)} columns",
    )  # fmt: skip
