"""Dates of a logger's table are recognised by their column, or refused; no rate is assumed."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.importing import describe_sources, import_recording
from loose_env.importing.timing.dates import date_format_of, date_ns

Mapped = Callable[[str], Path]

COLUMN = '[columns]\n"sensor.elbow_angle" = { channel = "q" }\n[[runs]]\n'


def table(path: Path, stamps: list[str]) -> Path:
    lines = ["Time;q", *(f"{stamp};{0.01 * i:.3f}" for i, stamp in enumerate(stamps))]
    path.write_text("\n".join(lines) + "\n")
    return path


def stamps(date: str) -> list[str]:
    """200 Hz over half a second, across a full second."""
    return [f"{date} 10:11:{12 + (i * 5) // 1000:02d}.{i * 5 % 1000:03d}" for i in range(180, 280)]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["04.03.2025 10:11:12.345"], "%d.%m.%Y %H:%M:%S.%f"),
        (["04.03.25 10:11:12"], "%d.%m.%y %H:%M:%S"),
        (["13/03/2025 10:11:12"], "%d/%m/%Y %H:%M:%S"),
        (["03/13/2025 10:11:12.5 AM"], "%m/%d/%Y %I:%M:%S.%f %p"),
        (["04/03/2025 23:59:59", "05/03/2025 00:00:00"], "%d/%m/%Y %H:%M:%S"),
        (["04/03/2025 23:59:59", "04/04/2025 00:00:00"], "%m/%d/%Y %H:%M:%S"),
        (["2025/03/04 10:11:12,345"], "%Y/%m/%d %H:%M:%S,%f"),
        (["", "2025-03-04T10:11:12.345Z"], "iso"),
    ],
)
def test_the_order_of_day_and_month_follows_from_the_data(cells: list[str], expected: str) -> None:
    assert date_format_of(cells, "log.csv") == expected
    for cell in filter(None, cells):
        assert date_ns(cell, expected, "log.csv") > 0


def test_a_date_that_may_be_either_is_refused_with_both_formats() -> None:
    with pytest.raises(InvalidData) as refused:
        date_format_of(["04/03/2025 10:11:12.345"] * 5, "log.csv: column 'Time'")
    assert "'%d/%m/%Y %H:%M:%S.%f' or '%m/%d/%Y %H:%M:%S.%f'" in str(refused.value)


def test_words_that_are_no_date_are_refused() -> None:
    with pytest.raises(InvalidData, match="no number and no date"):
        date_format_of(["yesterday"], "log.csv")
    with pytest.raises(InvalidData, match="is no date of the form"):
        date_format_of(["04.03.2025 10:11:12", "later"], "log.csv")
    with pytest.raises(InvalidData, match="is empty"):
        date_format_of(["", " "], "log.csv")


def test_whole_seconds_without_a_fraction_belong_to_the_same_format() -> None:
    first = date_ns("04.03.2025 10:11:12", "%d.%m.%Y %H:%M:%S.%f", "log.csv")
    second = date_ns("04.03.2025 10:11:12.000000250", "%d.%m.%Y %H:%M:%S.%f", "log.csv")
    assert second - first == 250


def test_a_table_with_german_dates_keeps_its_rate(home: Path, mapping: Mapped) -> None:
    log = table(home / "log.csv", stamps("04.03.2025"))
    mapped = mapping(f'[sources.log]\nseparator = ";"\ntime = {{ column = "Time" }}\n{COLUMN}')
    run = import_recording([log], mapped, home / "out").runs[0]
    np.testing.assert_allclose(np.diff(run.time), 0.005, atol=1e-9)
    assert 'date_format = "%d.%m.%Y %H:%M:%S.%f"' in describe_sources([str(log)])


def test_an_ambiguous_table_is_refused_until_the_format_is_stated(
    home: Path, mapping: Mapped
) -> None:
    log = table(home / "log.csv", stamps("04/03/2025"))
    source = '[sources.log]\nseparator = ";"\ntime = { column = "Time"'
    with pytest.raises(InvalidData, match="give date_format"):
        import_recording([log], mapping(f"{source} }}\n{COLUMN}"), home / "out")
    stated = mapping(f'{source}, date_format = "%m/%d/%Y %H:%M:%S.%f" }}\n{COLUMN}')
    assert import_recording([log], stated, home / "out").runs[0].samples == 100
    said = describe_sources([str(log)])
    tomllib.loads(said)
    assert "give date_format" in said


def test_no_rate_is_assumed_where_a_table_has_no_time(home: Path, mapping: Mapped) -> None:
    log = home / "log.csv"
    log.write_text("p,q\n" + "".join(f"{i},{i * 0.1}\n" for i in range(50)))
    said = describe_sources([str(log)])
    assert "time" not in tomllib.loads(said)["sources"]["log"]
    assert "no column of time was found" in said
    with pytest.raises(InvalidData, match="no rate is assumed"):
        import_recording([log], mapping(f"[sources.log]\n{COLUMN}"), home / "out")
