"""Files of named arrays: npz, mat, pt, json, Parquet and HDF5.

Arrays of one length are the columns of a table; a list of tables, or groups of like names, are
episodes. A rate or a step beside them is their time where no column is one.
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from loose_env.errors import InvalidData, LooseEnvError, MissingExtra
from loose_env.importing.samples import ChannelKey, Log, Table, damaged, natural
from loose_env.importing.units import unit_in
from loose_env.recording import MOST_VALUES

_MOST_BYTES = 2**30
_FEWEST = 10
"""Samples from which an array is a signal and no constant of the set-up."""
_WIDEST = 4096
"""Entries from which a vector is an image or a matrix of weights."""
_DEEPEST = 7
_RATES = re.compile(r"(\w*_?hz|rate|freq|frequency|fs|fps|control_freq|sample_rate)", re.I)
_STEPS = re.compile(r"(dt|ts|sample_time|timestep|time_step|sampling_time)", re.I)
_NAMES = ("columns", "names", "labels", "header", "headers", "fields", "joint_names", "joints",
          "channels", "dof_names", "data_columns")  # fmt: skip
Tree = Any
"""Nested tables, lists, arrays, numbers and texts, as a file holds them."""


def open_arrays(path: Path, name: str) -> Log:
    """Open a file of arrays."""
    read = lru_cache(maxsize=1)(lambda: _tree(path, name))  # asked for an episode at a time
    places = _episodes(read())

    def tables(episode: str, _: Sequence[ChannelKey] | None) -> list[Table]:
        place = f"{name}: {episode}" if episode else name
        return [_table(_episodes(read())[episode], place, read())]

    if "" in places and not tables("", None)[0].columns:
        shapes = [f"{k or 'data'} of {'x'.join(map(str, np.shape(v))) or 'one'}"
                  for k, v in [*_leaves(read())][:4]]  # fmt: skip
        raise InvalidData(
            f"{name}: it holds no arrays of numbers that share {_FEWEST} or more samples"
            f"{' (' + ', '.join(shapes) + ')' if shapes else ''}: is it a log? Save the measured "
            "channels as a table"
        )
    angle = "rad" if path.suffix.lower() in (".h5", ".hdf5") else ""
    return Log(name=name, tables=tables, episodes=() if "" in places else (*places,), angle=angle)


# ------------------------------------------------------------------------- tables


def _episodes(tree: Tree) -> dict[str, Tree]:
    """Episodes of a tree by name; the tree itself under "" where it has none."""
    here, key = tree, "episode"
    while isinstance(here, dict) and not any(map(_is_signal, here.values())):
        groups = {k: v for k, v in here.items() if _has_signals(v)}
        if len(groups) != 1:
            kinds = {(*sorted(v),) if isinstance(v, dict) else () for v in groups.values()}
            if not groups or kinds == {()} or len(kinds) > 1:
                break
            return {k: groups[k] for k in sorted(groups, key=natural)}
        ((key, here),) = groups.items()
    if _is_list_of_tables(here):
        return {f"{key}_{i}": each for i, each in enumerate(here)}
    return {"": here}


def _has_signals(tree: Tree) -> bool:
    if isinstance(tree, dict):
        return any(_is_signal(v) or _has_signals(v) for v in tree.values())
    return _is_list_of_tables(tree)


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(
        isinstance(each, dict) and any(map(_is_signal, each.values())) for each in value
    )  # fmt: skip


def _is_signal(value: Any) -> bool:
    matrix = None if isinstance(value, dict) else _matrix(value)
    return matrix is not None and max(matrix.shape) >= _FEWEST


def _leaves(tree: Tree, key: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Arrays, lists, numbers and texts of a tree with the ways to them."""
    inside: Mapping[str, Any] = tree if isinstance(tree, dict) else {}
    if isinstance(tree, list) and tree and isinstance(tree[0], dict):
        rows = [each if isinstance(each, dict) else {} for each in tree]
        inside = {
            n: [each.get(n) for each in rows] for n in dict.fromkeys(n for r in rows for n in r)
        }
    for name, value in inside.items() if depth < _DEEPEST else ():
        yield from _leaves(value, f"{key}/{name}" if key else str(name), depth + 1)
    if not inside and not isinstance(tree, dict) and tree is not None:
        yield key, tree


def _table(tree: Tree, place: str, whole: Tree) -> Table:
    """Arrays of a tree that have the length that most of them have, as columns."""
    leaves = dict(_leaves(tree))
    found = {key or "data": _matrix(value) for key, value in leaves.items()}
    arrays = {k: v for k, v in found.items() if v is not None and v.shape[1] <= _WIDEST}
    lengths = [n for a in arrays.values() for n in {*a.shape} if n >= _FEWEST]
    # Most values lie along the time; of equals the longer one is it.
    length = max(set(lengths), key=lambda n: (lengths.count(n), n), default=0)
    around = [*leaves.items(), *_leaves(whole)]
    columns: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    for key, array in arrays.items():
        if array.shape[0] != length and array.shape[1] == length:
            array = array.T  # as MATLAB keeps rows
        if array.shape[0] != length:
            continue
        width = array.shape[1]
        labels = _labels(around, key, width, _NAMES) if width > 1 else ()
        own = vector_columns(key, array, labels if len(set(labels)) == width else ())
        told = _labels(around, key, width, ("units", "unit"))
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
    if value.ndim not in (1, 2):
        return None
    value = value if value.dtype.kind == "i" and value.itemsize == 8 else value.astype(np.float64)
    return np.asarray(value.reshape(len(value), -1))


def _labels(
    leaves: Sequence[tuple[str, Any]], key: str, width: int, names: Sequence[str]
) -> tuple[str, ...]:
    """Names, or units, of the entries of a vector where the file gives one for each."""
    for way, value in leaves:
        last = way.rsplit("/", 1)[-1].lower()
        if last in names or last in {f"{key}_{n}" for n in names}:
            texts = [*value] if isinstance(value, (list, np.ndarray)) and np.ndim(value) else []
            plain = [str(v).strip() for v in texts if isinstance(v, str)]
            if len(plain) == len(texts) == width and all(
                v and not set(v) & set("[]") for v in plain
            ):
                return tuple(plain)
    return ()


def _rate(way: str, value: Any) -> float | None:
    """Rate that a number of the file states by its name [Hz]."""
    name = way.rsplit("/", 1)[-1].lstrip("@")
    if isinstance(value, (bool, str)) or np.ndim(value) or not np.isreal(value) or not value:
        return None
    rate = float(value) if _RATES.fullmatch(name) else 1 / value if _STEPS.fullmatch(name) else 0
    return float(rate) if 0 < rate < 1e6 else None


# ------------------------------------------------------------------------- files


def _tree(path: Path, name: str) -> Tree:
    """Contents of a file; nothing in it is executed."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InvalidData(f"{name}: more than {_MOST_BYTES} bytes; split the file")
        return READERS[path.suffix.lower()](path)
    except LooseEnvError as error:
        raise type(error)(f"{name}: {str(error).removeprefix(f'{name}: ')}") from None
    except Exception as error:  # each library raises its own on damaged bytes
        raise damaged(name, f"{path.suffix.lstrip('.')} file", error) from None


def _of_npz(path: Path) -> Tree:
    """Arrays of an archive. Their headers are checked before memory is taken for them."""
    found: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive:
        members = [each for each in archive.infolist() if each.filename.endswith(".npy")]
        if sum(each.file_size for each in members) > _MOST_BYTES:
            raise InvalidData(f"more than {_MOST_BYTES} bytes once expanded")
        for each in members:
            with archive.open(each) as file:
                version = npy.read_magic(file)
                header = npy.read_array_header_1_0 if version == (1, 0) else None
                shape, _, kind = (header or npy.read_array_header_2_0)(file)
            if kind.hasobject or kind.itemsize * np.prod(shape, dtype=float) > each.file_size:
                raise InvalidData(f"{each.filename} is damaged, or holds objects")
            with archive.open(each) as file:
                found[each.filename.removesuffix(".npy")] = npy.read_array(file)
    return found


def _of_mat(path: Path) -> Tree:
    from scipy import io

    try:
        whole = io.loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3 is HDF5
        return _of_hdf5(path)
    return {key: each for key, each in whole.items() if not key.startswith("__")}


def _of_torch(path: Path) -> Tree:
    try:
        import torch
    except ImportError:
        raise MissingExtra("files of torch need torch: pip install torch") from None
    try:
        whole = torch.load(path, map_location="cpu", weights_only=True)
    except Exception:
        raise InvalidData(
            "it holds more than tensors, numbers and texts, or is damaged; files that can hold "
            "code are not read: save its tensors as a dictionary, or as .npz"
        ) from None

    def plain(each: Any) -> Any:
        if isinstance(each, dict):
            return {str(k): plain(v) for k, v in each.items()}
        if isinstance(each, (list, tuple)):
            return [plain(v) for v in each]
        return each.numpy() if isinstance(each, torch.Tensor) else each

    return plain(whole)


def _of_json(path: Path) -> Tree:
    return json.loads(path.read_text("utf-8-sig"))


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


def _of_hdf5(path: Path) -> Tree:
    """Numbers of an HDF5 file; links to other files, which were not given, are not followed."""
    try:
        import h5py
    except ImportError:
        raise MissingExtra("HDF5 files need h5py: pip install 'loose-env[import]'") from None

    def walk(group: Any, depth: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key in group:
            if depth == _DEEPEST or not isinstance(group.get(key, getlink=True), h5py.HardLink):
                continue
            here = group[key]
            if isinstance(here, h5py.Group):
                found[key] = walk(here, depth + 1)
            elif not here.is_virtual and not here.external and here.dtype.kind in "fiub":
                if len(here.shape) < 3 and here.size <= MOST_VALUES:
                    found[key] = here[()]
            elif here.dtype.kind in "SO" and len(here.shape) == 1 and len(here) <= _WIDEST:
                found[key] = [str(v, "utf-8") if isinstance(v, bytes) else str(v) for v in here[()]]
        for key, value in group.attrs.items():
            if isinstance(value, str):  # robomimic's hold a table
                with suppress(ValueError, RecursionError):
                    found[f"@{key}"] = json.loads(value)
            elif np.ndim(value) == 0:
                found[f"@{key}"] = value
        return found

    with h5py.File(path, "r") as file:
        return walk(file, 0)


READERS: dict[str, Callable[[Path], Tree]] = {
    ".npz": _of_npz, ".mat": _of_mat, ".pt": _of_torch, ".pth": _of_torch, ".json": _of_json,
    ".parquet": parquet_columns, ".hdf5": _of_hdf5, ".h5": _of_hdf5,
}  # fmt: skip
"""Ending -> reader."""
