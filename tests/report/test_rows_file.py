"""Rows on disk: they come back as they were, with what made them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from loose_env.errors import InvalidData, UnknownName
from loose_env.evaluation import configuration_hash, need_format, read_rows, write_rows

CONFIGURATION = {"env": "loose_env/Vera-v0", "seed": 3, "agents": ["a"], "ranges": [0.02, 1.0]}
ROWS: list[dict[str, Any]] = [
    {
        "agent": "a",
        "episode": k,
        "truth": "healthy",
        "verdict": None if k else "healthy",
        "success": not k,
        "reward": 0.1 + k,
        "friction_ratio": None,
        "direction": (0.6, 0.8, 0.0) if k else None,
        "trail_best": ("healthy", "backlash@joint1") if k else (),
        "trail_truth": (0.1, 1 / 3) if k else (),
    }
    for k in range(3)
]


def as_lists(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{k: list(v) if isinstance(v, tuple) else v for k, v in row.items()} for row in rows]


def test_json_comes_back_as_it_was(tmp_path: Path) -> None:
    path = write_rows(tmp_path / "new", "rows", ROWS, CONFIGURATION, form="json")
    rows, configuration = read_rows(path)
    assert path.name == "rows.json"
    assert rows == as_lists(ROWS)
    assert configuration == CONFIGURATION
    assert [p.name for p in path.parent.iterdir()] == ["rows.json"]


def test_parquet_comes_back_as_it_was_with_its_hash(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    path = write_rows(tmp_path, "rows", ROWS, CONFIGURATION)
    rows, configuration = read_rows(path)
    assert rows == as_lists(ROWS)
    assert configuration == CONFIGURATION
    table = parquet.read_table(path)
    digest = configuration_hash(CONFIGURATION)
    assert table.schema.metadata[b"loose_env.configuration_hash"].decode() == digest
    assert set(table.column("configuration").to_pylist()) == {digest}
    # The type of a column does not depend on what happens to stand in it.
    assert str(table.schema.field("friction_ratio").type) == "double"
    assert str(table.schema.field("trail_best").type).startswith("list<")


def test_pandas_reads_the_rows(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow.parquet")
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_parquet(write_rows(tmp_path, "rows", ROWS, CONFIGURATION))
    assert frame.reward.tolist() == [0.1, 1.1, 2.1]
    assert list(frame.trail_truth[2]) == [0.1, 1 / 3]


def test_the_hash_knows_every_value_but_not_the_order() -> None:
    turned = dict(reversed(CONFIGURATION.items()))
    assert configuration_hash(turned) == configuration_hash(CONFIGURATION)
    assert configuration_hash({**CONFIGURATION, "seed": 4}) != configuration_hash(CONFIGURATION)


def test_a_configuration_that_was_changed_is_noticed(tmp_path: Path) -> None:
    path = write_rows(tmp_path, "rows", ROWS, CONFIGURATION, form="json")
    path.write_text(path.read_text().replace('"seed": 3', '"seed": 4'))
    with pytest.raises(InvalidData, match="does not match its hash"):
        read_rows(path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "rows.json").write_text("[]")
    (tmp_path / "rows.csv").write_text("a,b")
    for name in ("rows.json", "rows.csv"):
        with pytest.raises(InvalidData):
            read_rows(tmp_path / name)


def test_an_unknown_format_is_taught() -> None:
    with pytest.raises(UnknownName, match="parquet or json"):
        need_format("csv")
    assert need_format("json") == "json"
