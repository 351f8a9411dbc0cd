"""Reading of mapping files, TOML or JSON; nothing in them is executed."""

from __future__ import annotations

import datetime
import json
import tomllib
from pathlib import Path
from typing import Any, Literal

from loose_env.errors import InvalidData
from loose_env.importing.checked_fields import Fields, got, number, text
from loose_env.importing.dates import date_ns
from loose_env.importing.mapping import (
    Align,
    ColumnEntry,
    CsvLayout,
    ImportMapping,
    RunPlan,
    SourceEntry,
    TimeSource,
)
from loose_env.importing.samples import ChannelKey
from loose_env.importing.units import unit_named
from loose_env.recording import nearest, read_text

MAPPING_FORMAT = "loose-mapping/1"
"""The format read here."""

_MOST_BYTES = 2**22
_MOST_RUNS = 10_000
_YEAR = 3.2e7  # [s]


def read_mapping(file: str | Path) -> ImportMapping:
    """Read a mapping file.

    Parameters
    ----------
    file : str or Path
        A file that ends in .toml or .json.

    Returns
    -------
    ImportMapping
        What it says, checked as far as it can be without the sources and the model.

    Raises
    ------
    InvalidData
        If it is no such file; the message says where and what is allowed.

    Examples
    --------
    >>> read_mapping("mapping.yaml")
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidData: mapping.yaml: a mapping ends in .toml or .json
    """
    path = Path(file)
    ending = path.suffix.lower()
    if ending not in (".toml", ".json"):
        raise InvalidData(f"{path.name}: a mapping ends in .toml or .json")
    if not path.is_file():
        raise InvalidData(f"there is no mapping file {str(file)!r}")
    words = read_text(path, path.name, _MOST_BYTES)
    try:
        if ending == ".toml":
            whole = tomllib.loads(words)
        else:
            whole = json.loads(words, object_pairs_hook=_once)
    except RecursionError:
        raise InvalidData(f"{path.name}: nested too deeply") from None
    except ValueError as error:
        kind = ending[1:].upper()
        raise InvalidData(f"{path.name}: not {kind}: {' '.join(str(error).split())}") from None
    return mapping_of(whole, path.name)


def mapping_of(whole: Any, name: str) -> ImportMapping:
    """Check a mapping that was read from a file; errors as `read_mapping`."""
    top = Fields(name, whole, also=("format", "model", "sources", "columns", "runs", "unused"))
    if top.text("format") != MAPPING_FORMAT:
        raise InvalidData(
            f"{name}: format is {top.given['format']!r:.60}; this version reads {MAPPING_FORMAT!r}"
        )
    sources = {
        key: source_of(f"{name}: sources.{key}", key, value)
        for key, value in top.table("sources").items()
    }
    if not sources:
        raise InvalidData(f"{name}: [sources.NAME] is missing; a mapping has at least one")
    for each in sources.values():
        if each.align is not None:
            place = f"{name}: sources.{each.name}.align.to"
            _known(place, each.align.to, sources)
            if each.align.to == each.name or sources[each.align.to].align is not None:
                raise InvalidData(f"{place} is a source that is not aligned itself")
    shared = top.table("columns")
    runs = whole.get("runs")
    if not isinstance(runs, list) or not 0 < len(runs) <= _MOST_RUNS:
        raise InvalidData(
            f"{name}: runs is a list of 1 to {_MOST_RUNS} tables, [[runs]] in TOML, {got(runs)}"
        )
    plans = tuple(_run(name, i, run, shared, sources) for i, run in enumerate(runs))
    unused = whole.get("unused", [])
    if not isinstance(unused, list) or not all(isinstance(each, str) for each in unused):
        raise InvalidData(f"{name}: unused is a list of files, {got(unused)}")
    model = top.text("model", "")
    return ImportMapping(name=name, model=model, sources=sources, runs=plans, unused=tuple(unused))


def source_of(place: str, name: str, given: Any) -> SourceEntry:
    """Check the table of a source; errors as `read_mapping`."""
    fields = Fields(
        place, given, SourceEntry, CsvLayout, also=("time", "topics", "align"), without=("name",)
    )
    if not name.replace("_", "").replace("-", "").isalnum():
        raise InvalidData(f"{place}: a source's name is of letters, digits, _ and -")
    csv = CsvLayout(**fields.values(CsvLayout))
    if csv.names and csv.header:
        raise InvalidData(f"{place}: names are for a table without a line of them: header = false")
    if csv.separator == csv.decimal:
        raise InvalidData(
            f"{place}: separator and decimal are both {csv.separator!r}; a table with decimal "
            "commas has another separator, mostly ';'"
        )
    return SourceEntry(
        name=name,
        **fields.values(SourceEntry),
        csv=csv,
        time=_time(fields.at("time"), given.get("time", {})),
        topics={
            topic: _time(f"{place}.topics.{topic}", value)
            for topic, value in fields.table("topics").items()
        },
        align=_align(fields.at("align"), given["align"]) if "align" in given else None,
    )


def _time(place: str, given: Any) -> TimeSource:
    fields = Fields(place, given, TimeSource)
    time = TimeSource(**fields.values(TimeSource))
    if unit_named(time.unit, fields.at("unit")).quantity != "time":
        raise InvalidData(
            f"{fields.at('unit')}: {time.unit!r} is no unit of time; s, ms, us, ns are"
        )
    return time


def _align(place: str, given: Any) -> Align:
    other = ("to_channel", "to_topic", "band_hz")
    fields = Fields(place, given, Align, ChannelKey, also=other)
    band = None
    if "band_hz" in given:
        ends = given["band_hz"]
        if not isinstance(ends, list) or len(ends) != 2:
            raise InvalidData(f"{fields.at('band_hz')} is two frequencies, {got(ends)}")
        low, high = (number(fields.at("band_hz"), end, 0.0, 1e9) for end in ends)
        if low >= high:
            raise InvalidData(f"{fields.at('band_hz')}: {low:g} is not below {high:g}")
        band = (low, high)
    return Align(
        **fields.values(Align),
        own=ChannelKey(**fields.values(ChannelKey)),
        other=ChannelKey(fields.text("to_channel"), fields.text("to_topic", "")),
        band_hz=band,
    )


def _run(
    name: str, index: int, given: Any, shared: Any, sources: dict[str, SourceEntry]
) -> RunPlan:
    place = f"{name}: runs[{index}]"
    own = ("columns", "sources", "pose", "start", "stop")
    if isinstance(given, dict):
        given = {"file": f"run-{index + 1:02d}", **given}
    fields = Fields(place, given, RunPlan, also=own, without=("place", "episode"))
    columns = {
        column: _column(f"{name}: columns.{column!r}", column, value, sources)
        for column, value in shared.items()
    }
    for column, value in fields.table("columns").items():
        if value is False:  # a shared column that this run does without
            if columns.pop(column, None) is None:
                raise InvalidData(f"{place}.columns.{column!r} is false, and no shared column")
            continue
        columns[column] = _column(f"{place}.columns.{column!r}", column, value, sources)
    if not columns:
        raise InvalidData(f"{place}: it has no columns; give [columns] for all runs or its own")
    files = {}
    for source, file in fields.table("sources").items():
        _known(f"{place}.sources", source, sources)
        files[source] = text(f"{place}.sources.{source}", file)
    start, stop = (_moment(fields, key) for key in ("start", "stop"))
    if type(start) is type(stop) and start is not None and stop is not None and start >= stop:
        raise InvalidData(f"{place}: start is not before stop")
    return RunPlan(
        place=place,
        columns=tuple(columns.values()),
        sources=files,
        pose=_pose(fields) if "pose" in given else None,
        start=start,
        stop=stop,
        **fields.values(RunPlan),
    )


def _column(place: str, column: str, given: Any, sources: dict[str, SourceEntry]) -> ColumnEntry:
    if len(sources) == 1 and isinstance(given, dict):
        given = {"source": next(iter(sources)), **given}
    fields = Fields(place, given, ColumnEntry, ChannelKey, without=("place", "column"))
    entry = ColumnEntry(
        place=place,
        column=column,
        key=ChannelKey(**fields.values(ChannelKey)),
        **fields.values(ColumnEntry),
    )
    _known(fields.at("source"), entry.source, sources)
    if entry.unit:
        unit_named(entry.unit, fields.at("unit"))
    if entry.scale == 0:
        raise InvalidData(f"{fields.at('scale')} is 0, which leaves nothing of the channel")
    return entry


def _pose(fields: Fields) -> dict[str, float] | Literal["measured"]:
    if fields.given["pose"] == "measured":
        return "measured"
    pose = {}
    for joint, value in fields.table("pose").items():
        place = f"{fields.place}.pose.{joint}"
        if isinstance(value, str):
            words = value.split()
            try:
                amount = float(words[0]) if len(words) == 2 else None
            except ValueError:
                amount = None
            if amount is None:
                raise InvalidData(
                    f"{place} is a number [rad or m] or such as '30 deg', {got(value)}"
                )
            unit = unit_named(words[1], place)
            if unit.quantity not in ("angle", "length"):
                raise InvalidData(f"{place}: {words[1]!r} measures no angle and no length")
            value = amount * unit.factor
        pose[joint] = number(place, value, -1e9, 1e9)
    return pose


def _moment(fields: Fields, key: str) -> float | int | None:
    value = fields.given.get(key)
    if value is None:
        return None
    if isinstance(value, datetime.datetime):
        value = value.isoformat()
    if isinstance(value, str):
        return date_ns(value, "iso", fields.at(key))
    if isinstance(value, (int, float)) and not isinstance(value, bool) and value > _YEAR:
        raise InvalidData(
            f"{fields.at(key)} is in seconds after the first time that all columns have, and "
            f"{value!s:.30} is more than a year; give a date in quotes, such as "
            "'2024-05-01T10:00:03.5Z'"
        )
    return number(fields.at(key), value, 0.0, _YEAR)


def _known(place: str, source: str, sources: dict[str, SourceEntry]) -> None:
    if source not in sources:
        raise InvalidData(
            f"{place}: there is no source {source[:60]!r}; there are {', '.join(sources)}"
            f"{nearest(source[:60], list(sources))}"
        )


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key[:60]!r} stands twice in one object")
        found[key] = value
    return found


def quoted(words: str) -> str:
    """Quote text for TOML, whose strings are JSON's but for one control character."""
    return json.dumps(words, ensure_ascii=False).replace("\x7f", "\\u007f")
