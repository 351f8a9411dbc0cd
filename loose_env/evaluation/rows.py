"""Raw rows of a comparison on disk: Parquet or JSON, with the configuration that made them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

from loose_env.errors import InvalidData, UnknownName
from loose_env.evaluation.success import Row
from loose_env.io import write_text, written_beside

RowsFormat = Literal["parquet", "json"]
"""File format of rows."""

COLUMN = "configuration"
"""Column of the configuration's hash, so that rows of several files can be told apart."""

_METADATA = b"loose_env.configuration"
_HASH = b"loose_env.configuration_hash"
_WHOLE = ("seed", "episode", "poses", "records", "excited")
_REAL = (
    "seconds",
    "price",
    "reward",
    "gap",
    "friction",
    "friction_ratio",
    "opening_ratio",
    "confidence",
    "truth_probability",
)
_WORDS = ("agent", "difficulty", "truth", "verdict", "actions", COLUMN)
_TRUE = ("success", "link_success", "truncated")
_REALS = ("direction", "trail_confidence", "trail_truth", "trail_price", "trail_seconds")


def configuration_hash(configuration: Mapping[str, Any]) -> str:
    """Hash what rows rest on: SHA-256 of its canonical JSON, 64 hexadecimal digits.

    Examples
    --------
    >>> configuration_hash({"a": 1, "b": 2}) == configuration_hash({"b": 2, "a": 1})
    True
    >>> len(configuration_hash({}))
    64
    """
    text = json.dumps(configuration, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def seed_of(phrase: str) -> int:
    """Seed of 64 bits that a phrase stands for, its SHA-256: nobody can choose it.

    Examples
    --------
    >>> seed_of("a phrase") == seed_of("a phrase") != seed_of("another")
    True
    """
    return int.from_bytes(hashlib.sha256(phrase.encode()).digest()[:8], "big")


def need_format(form: str) -> RowsFormat:
    """Check that rows can be written in a format, before hours are spent on playing them.

    Raises
    ------
    UnknownName
        If there is no such format.
    """
    if form not in get_args(RowsFormat):
        raise UnknownName(f"rows are kept as {' or '.join(get_args(RowsFormat))}, not {form!r}")
    return form  # type: ignore[return-value]


def write_rows(
    folder: str | os.PathLike[str],
    name: str,
    rows: Sequence[Row],
    configuration: Mapping[str, Any],
    *,
    form: RowsFormat = "parquet",
) -> Path:
    """Write rows and their configuration into ``folder/name.parquet``, or ``.json``.

    The file is written atomically. Parquet holds the configuration and its hash in the metadata
    of the schema, and the hash in a column.

    Parameters
    ----------
    folder : path-like
        Where the file goes; made where there is none.
    name : str
        Name of the file without its ending.
    rows : sequence of Row
        One an episode.
    configuration : mapping
        What they rest on; anything that JSON holds.
    form : {"parquet", "json"}
        The format.

    Returns
    -------
    Path
        The file written.
    """
    target = Path(folder) / f"{name}.{need_format(form)}"
    digest = configuration_hash(configuration)
    if form == "json":
        whole = {"configuration": configuration, "hash": digest, "rows": list(rows)}
        return write_text(target, json.dumps(whole, indent=0) + "\n")
    return written_beside(target, lambda path: _write_parquet(path, rows, configuration, digest))


def read_rows(path: str | os.PathLike[str]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Read rows and their configuration back.

    Raises
    ------
    InvalidData
        If the file is none that `write_rows` wrote, or its configuration was changed.
    """
    file = Path(path)
    readers = {".json": _read_json, ".parquet": _read_parquet}
    if file.suffix not in readers:
        raise InvalidData(f"rows are kept in .parquet or .json files, not in {file.name!r}")
    try:
        rows, configuration, digest = readers[file.suffix](file)
    except InvalidData:
        raise
    except Exception as error:  # json, pyarrow and the codecs raise a dozen kinds
        reason = " ".join(str(error).split())[:200]
        raise InvalidData(f"{file}: the rows cannot be read: {reason}") from error
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InvalidData(f"{file}: rows is a list of objects, one an episode")
    if not isinstance(configuration, dict) or digest != configuration_hash(configuration):
        raise InvalidData(f"the configuration in {file} does not match its hash {str(digest)[:64]}")
    return rows, configuration


def _read_json(file: Path) -> tuple[Any, Any, Any]:
    whole = json.loads(file.read_text(encoding="utf-8"), parse_constant=_no_constant)
    if not isinstance(whole, dict) or not {"configuration", "rows"} <= whole.keys():
        raise InvalidData(f"{file} holds no rows of a comparison with their configuration")
    return whole["rows"], whole["configuration"], whole.get("hash")


def _no_constant(word: str) -> Any:
    # Python writes NaN where a row has no number; infinities are none of a row.
    if word == "NaN":
        return float("nan")
    raise ValueError(f"{word} is no number of a row")


def _read_parquet(file: Path) -> tuple[Any, Any, Any]:
    import pyarrow.parquet

    # Threads of pyarrow would not survive a fork of the caller.
    stored = pyarrow.parquet.ParquetFile(file, page_checksum_verification=True)
    with stored:
        table = stored.read(use_threads=False)
    metadata = table.schema.metadata or {}
    if _METADATA not in metadata or _HASH not in metadata:
        raise InvalidData(f"{file} was not written by compare: it holds no configuration")
    configuration = json.loads(metadata[_METADATA])
    return table.drop_columns([COLUMN]).to_pylist(), configuration, metadata[_HASH].decode()


def _write_parquet(
    path: Path, rows: Sequence[Row], configuration: Mapping[str, Any], digest: str
) -> None:
    import pyarrow
    import pyarrow.parquet

    # Types are stated, not guessed: a column may be empty in one run and full in the next.
    types = {
        **dict.fromkeys(_WHOLE, pyarrow.int64()),
        **dict.fromkeys(_REAL, pyarrow.float64()),
        **dict.fromkeys(_WORDS, pyarrow.string()),
        **dict.fromkeys(_TRUE, pyarrow.bool_()),
        **dict.fromkeys(_REALS, pyarrow.list_(pyarrow.float64())),
        **dict.fromkeys(("trail_best", "trail_verdict"), pyarrow.list_(pyarrow.string())),
    }
    names = [*(dict.fromkeys(name for row in rows for name in row)), COLUMN]
    whole = [{**row, COLUMN: digest} for row in rows]
    columns = {
        name: pyarrow.array([_plain(row.get(name)) for row in whole], type=types.get(name))
        for name in names
    }
    text = json.dumps(configuration, sort_keys=True)
    metadata = {_METADATA: text.encode("utf-8"), _HASH: digest.encode("ascii")}
    table = pyarrow.table(columns).replace_schema_metadata(metadata)
    pyarrow.parquet.write_table(table, path, compression="zstd", write_page_checksum=True)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
