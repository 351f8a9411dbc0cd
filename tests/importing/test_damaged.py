"""Files that are cut or whose bytes are flipped, and mappings of any content: no traceback."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from loose_env.errors import LooseEnvError
from loose_env.importing import ImportSettings, describe_sources, import_recording
from loose_env.importing.mapping.mapping_file import MAPPING_FORMAT, mapping_of, read_mapping
from loose_env.importing.mapping.units import unit_named
from loose_env.importing.readers.messages.field_path import FieldPath
from loose_env.importing.timing.dates import date_ns
from tests.importing.sample_files import (
    motion,
    write_csv,
    write_protobuf_mcap,
    write_robot,
    write_uff,
)

pytestmark = pytest.mark.slow

REPLACED = ImportSettings(overwrite=True)
FREELY = settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
COLUMNS = {
    "robot.mcap": '"sensor.elbow_angle" = { topic = "/joint_states", channel = "position[elbow]" }',
    "plain.mcap": '"sensor.elbow_angle" = { topic = "/joint_states", channel = "position[elbow]" }',
    "proto.mcap": '"sensor.elbow_angle" = { topic = "/tool", channel = "axes[0]" }',
    "log.csv": '"sensor.elbow_angle" = { channel = "q" }',
    "v.uff": '"sensor.tool.x" = { channel = "1+X" }\n"sensor.tool.y" = { channel = "1+Y" }\n'
    '"sensor.tool.z" = { channel = "#3" }',
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of a sound file of each kind."""
    place = tmp_path_factory.mktemp("whole")
    time = np.arange(60) / 100
    signals = motion(time)
    write_robot(place / "robot.mcap", seconds=0.3)
    write_robot(place / "plain.mcap", seconds=0.3, compression=CompressionType.NONE,
                enable_crcs=False)  # fmt: skip
    write_protobuf_mcap(place / "proto.mcap", time)
    write_csv(place / "log.csv", np.stack([time, signals["x"]], 1), ["t", "q"])
    axes = {(1, 1): signals["x"], (1, 2): signals["y"], (1, 3): signals["z"]}
    write_uff(place / "v.uff", time, axes)
    return {path.name: path.read_bytes() for path in sorted(place.iterdir())}


def tried(home: Path, mapping: Callable[[str], Path], name: str, content: bytes) -> bool:
    """Whether a file is still taken; if not it has to be refused by name, and leave nothing."""
    (home / name).write_bytes(content)
    clock = 'time = { column = "t" }\n' if name == "log.csv" else ""
    mapped = mapping(f"[sources.s]\n{clock}[columns]\n{COLUMNS[name]}\n[[runs]]\n")
    try:
        tomllib.loads(describe_sources([str(home / name)]))
    except LooseEnvError as error:
        assert name in str(error)
    try:
        found = import_recording([home / name], mapped, home / "out", REPLACED)
    except LooseEnvError as error:
        assert name in str(error) or "map.toml" in str(error)
        assert not list(home.glob(".*.part"))
        return False
    assert all(np.isfinite(run.time).all() for run in found.runs)
    return True


@pytest.mark.parametrize("name", list(COLUMNS))
@FREELY
@given(share=st.floats(0, 1))
def test_files_that_were_cut(
    home: Path, mapping: Callable[[str], Path], whole: dict[str, bytes], name: str, share: float
) -> None:
    content = whole[name]
    cut = min(int(share * len(content)), len(content) - 12)
    taken = tried(home, mapping, name, content[:cut])
    # A table has no end of its own, so what is left of it is a table.
    assert not taken or name == "log.csv"


@pytest.mark.parametrize("name", list(COLUMNS))
@FREELY
@given(data=st.data())
def test_files_whose_bytes_were_flipped(
    home: Path,
    mapping: Callable[[str], Path],
    whole: dict[str, bytes],
    name: str,
    data: st.DataObject,
) -> None:
    content = bytearray(whole[name])
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    tried(home, mapping, name, bytes(content))


KEYS = st.sampled_from(
    [
        "format",
        "model",
        "sources",
        "columns",
        "runs",
        "file",
        "kind",
        "time",
        "topics",
        "align",
        "column",
        "unit",
        "stamp",
        "rate_hz",
        "even",
        "channel",
        "topic",
        "source",
        "scale",
        "sign",
        "offset",
        "method",
        "pose",
        "excited",
        "condition",
        "start",
        "stop",
        "to",
        "band_hz",
        "separator",
        "decimal",
        "skip",
        "header",
        "missing",
        "to_channel",
        "s",
    ]
)
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.just(10**400)
    | st.floats()
    | st.text(max_size=20)
    | st.sampled_from(["s", "csv", "g", "measured", "30 deg", "../x", MAPPING_FORMAT]),
    lambda inside: (
        st.lists(inside, max_size=4)
        | st.dictionaries(KEYS | st.text(max_size=8), inside, max_size=6)
    ),
    max_leaves=25,
)
SOUND = {
    "format": MAPPING_FORMAT,
    "model": "arm.xml",
    "sources": {"s": {"time": {"column": "t"}, "topics": {"/a": {"stamp": "header"}}}},
    "columns": {"sensor.elbow_angle": {"channel": "q", "unit": "deg"}},
    "runs": [{"pose": {"elbow": "3 deg"}, "start": 0.1, "stop": 2}],
}


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path] if path else []
    if isinstance(value, (dict, list)):
        for key, each in value.items() if isinstance(value, dict) else enumerate(value):
            found += places(each, (*path, key))
    return found


@settings(FREELY, max_examples=200)
@given(data=st.data())
def test_mappings_of_any_content(data: st.DataObject) -> None:
    whole: Any = json.loads(json.dumps(SOUND))
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(places(whole)))
        here = whole
        for key in path[:-1]:
            here = here[key]
        here[path[-1]] = data.draw(VALUES)
        if not isinstance(whole, dict) or not places(whole):
            break
    try:
        mapping_of(whole, "map.json")
    except LooseEnvError as error:
        assert "map.json" in str(error)
        assert "\n" not in str(error)


@FREELY
@given(value=VALUES)
def test_anything_in_the_place_of_a_mapping(value: Any) -> None:
    with pytest.raises(LooseEnvError, match=r"map\.json"):
        mapping_of(value, "map.json")


@FREELY
@given(content=st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
@pytest.mark.parametrize("ending", ["toml", "json"])
def test_any_bytes_in_the_place_of_a_mapping(tmp_path: Path, ending: str, content: bytes) -> None:
    path = tmp_path / f"map.{ending}"
    path.write_bytes(content)
    with pytest.raises(LooseEnvError, match=r"map\."):
        read_mapping(path)


@FREELY
@given(words=st.text(max_size=40))
def test_any_words_in_the_place_of_a_unit_a_path_or_a_date(words: str) -> None:
    for read in (
        lambda: unit_named(words, "here"),
        lambda: FieldPath.parse(words, "here").find({"a": [1], "name": ["b"]}),
        lambda: date_ns(words, "iso", "here"),
        lambda: date_ns(words, words, "here"),
    ):
        try:
            read()
        except LooseEnvError as error:
            assert str(error).startswith("here")
        except KeyError as error:
            assert "no field" in str(error) or "have no names" in str(error)
