"""The table of a run in a Parquet file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData
from loose_env.recording.table import CheckHeader, Table, place, refuse_size
from loose_env.typing import Array

__all__ = ["read_parquet", "write_parquet"]


def read_parquet(path: Path, name: str, check_header: CheckHeader) -> Table:
    """Read a Parquet file: a column of numbers each, nulls as missing samples.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        What errors call it.
    check_header : callable
        Is given the names of the columns before any row is read.

    Raises
    ------
    InvalidData
        If it is no whole Parquet file, is too large, or has a column of anything but numbers.
    """
    import pyarrow.parquet

    if path.stat().st_size == 0:
        raise InvalidData(f"{name}: the file is empty; a run has at least 10 samples")
    try:
        file = pyarrow.parquet.ParquetFile(path, page_checksum_verification=True)
        header = file.schema_arrow.names
        rows = file.metadata.num_rows
    except Exception as error:  # pyarrow raises OSError, ValueError and its own
        raise _broken(name, error) from None
    with file:
        check_header(header)
        refuse_size(name, rows, len(header))
        try:
            # Threads of pyarrow would not survive a fork of the caller, and save nothing here.
            table = file.read(use_threads=False)
        except (Exception, MemoryError) as error:
            raise _broken(name, error) from None
        if table.num_rows != rows or table.column_names != header:
            raise _broken(name, f"it announces {rows} rows and holds {table.num_rows}")
        columns = {column: _numbers(table.column(column), name, column) for column in header}
    return Table(file=name, columns=columns)


def write_parquet(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns of one length as Parquet, with checksums."""
    import pyarrow
    import pyarrow.parquet

    table = pyarrow.table({name: pyarrow.array(values) for name, values in columns.items()})
    pyarrow.parquet.write_table(table, path, compression="zstd", write_page_checksum=True)


def _broken(name: str, error: object) -> InvalidData:
    words = " ".join(str(error).split())[:200] or type(error).__name__
    return InvalidData(
        f"{name}: not a whole Parquet file: {words}. It may be cut short, damaged or of another "
        "kind; copy it again, or give a CSV file the ending .csv"
    )


def _numbers(column: Any, name: str, title: str) -> Array:
    import pyarrow
    import pyarrow.types as types

    try:
        if types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        kind = column.type
        if types.is_null(kind):
            return np.full(len(column), np.nan)
        if types.is_floating(kind) or types.is_integer(kind) or types.is_decimal(kind):
            values = column.cast(pyarrow.float64(), safe=False).to_numpy()
            return np.array(values, dtype=np.float64)
    except Exception as error:
        raise _broken(name, f"column {title!r}: {error}") from None
    row, shown = 0, ""
    for i, value in enumerate(column):
        if value.is_valid:
            row, shown = i, _shown(value)
            break
    raise InvalidData(
        f"{place(name, title, row, None)}: {shown or 'nothing'} of type {kind} where a number "
        "belongs; store the column as float64 in SI units"
    )


def _shown(value: Any) -> str:
    try:
        return repr(value.as_py())[:40]
    except Exception:  # times finer than Python's, text that is not UTF-8
        return "a value"
