"""Text of a logger's table: opened, split into cells, with the names of its columns."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from loose_env.errors import InvalidData
from loose_env.importing.mapping.mapping import CsvLayout
from loose_env.importing.readers.rtde_names import expanded_names
from loose_env.importing.samples import unreadable

_LONGEST_LINE = 2**20
_MOST_COLUMNS = 10_000


@contextmanager
def open_text(path: Path, name: str, encoding: str) -> Iterator[IO[str]]:
    """Open a file as text; what cannot be read or decoded is refused."""
    try:
        with path.open("rb") as raw:
            start = raw.read(2)
        other = start in (b"\xff\xfe", b"\xfe\xff")
        if other and encoding != "utf-16":
            raise InvalidData(f"{name}: the file looks like UTF-16; give encoding = 'utf-16'")
        own = "utf-8-sig" if encoding == "utf-8" else encoding
        with path.open("r", encoding=own, newline="") as file:
            yield file
    except UnicodeError as error:
        raise InvalidData(
            f"{name}: it is not {encoding}: {str(error)[:120]}; give encoding = 'latin-1', "
            "'cp1252' or 'utf-16' with the source"
        ) from None
    except OSError as error:
        raise unreadable(name, error) from None


def cells(file: IO[str], name: str, layout: CsvLayout) -> Iterator[tuple[int, list[str]]]:
    """Rows of a table from its line of names on, each with its line; blank lines are left out.

    Lines that the layout skips may be anything; they are not looked at as a table.
    """
    lines = _lines(file, name)
    for _ in itertools.islice(lines, layout.skip):
        pass
    reader = csv.reader(
        lines, delimiter=layout.separator, skipinitialspace=layout.separator == " ", strict=True
    )
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                number = layout.skip + reader.line_num
                if len(row) > _MOST_COLUMNS:
                    raise InvalidData(
                        f"{name}: line {number}: {len(row)} cells; at most {_MOST_COLUMNS} are read"
                    )
                yield number, row
    except csv.Error as error:
        raise InvalidData(
            f"{name}: line {layout.skip + reader.line_num}: not a table: {error}; look for a quote "
            "that is not closed, or skip lines of words before the table"
        ) from None


def header_of(row: list[str], layout: CsvLayout) -> list[str]:
    """Names of the columns: those of the row or the layout, or numbers where there are none."""
    if not layout.header:
        return expanded_names(layout.names) or [str(i + 1) for i in range(len(row))]
    return [" ".join(cell.split()) for cell in row]


def _lines(file: IO[str], name: str) -> Iterator[str]:
    number = 0
    while line := file.readline(_LONGEST_LINE):
        number += 1
        if len(line) == _LONGEST_LINE and line[-1] not in "\r\n":
            raise InvalidData(
                f"{name}: line {number} is longer than {_LONGEST_LINE} characters; is it a table "
                "in text?"
            )
        yield line
