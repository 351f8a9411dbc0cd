"""Time histories of a universal file (data set 58), read by ``pyuff`` and listed."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData, MissingExtra
from loose_env.importing.mapping.mapping import TimeSource
from loose_env.importing.mapping.units import unit_named
from loose_env.importing.samples import (
    Channel,
    ChannelKey,
    FileList,
    Samples,
    Stream,
    checked,
    unreadable,
)
from loose_env.recording import nearest
from loose_env.typing import Array

_MOST_BYTES = 2**30
_MARK = re.compile(rb"    -1(?=[\r\n]|\Z| {74})")
_DIRECTIONS = {0: "", 1: "+X", 2: "+Y", 3: "+Z", 4: "+RX", 5: "+RY", 6: "+RZ"}
_DIRECTIONS |= {-code: words.replace("+", "-") for code, words in _DIRECTIONS.items() if code}
_KINDS = {0: "function", 1: "time response", 2: "auto spectrum", 3: "cross spectrum",
          4: "frequency response", 6: "coherence", 9: "power spectrum", 12: "spectrum"}  # fmt: skip
_TIME = 17  # kind of abscissa
_ROUNDING = 6e-6  # a file keeps six digits of its step, so it is off by 5e-6 at most


@dataclass(frozen=True)
class _Set:
    """A data set 58: its number in the file, counted from 1, its name, and what pyuff read."""

    number: int
    name: str
    data: dict[str, Any]

    @property
    def unit(self) -> str:
        label = " ".join(str(self.data.get("ordinate_axis_units_lab", "")).split())
        try:
            unit_named(label, "")
        except InvalidData:
            return ""
        return label

    @property
    def kind(self) -> str:
        code = self.data.get("func_type", 0)
        return _KINDS.get(code, f"function of kind {code}")

    @property
    def is_history(self) -> bool:
        code = self.data.get("func_type")
        return code == 1 or (code == 0 and self.data.get("abscissa_spec_data_type") == _TIME)


def read_uff(
    path: Path, name: str, keys: Sequence[ChannelKey], time: TimeSource
) -> dict[ChannelKey, Samples]:
    """Read time histories of a universal file.

    A file keeps six digits of its step: where that step is a whole number of samples a second
    within those digits, the whole number is taken, since 48000.77 Hz in the place of 48000 Hz
    would shift a minute's end by a millisecond.
    """
    sets = _headers(path, name)
    names = [each.name for each in sets]
    chosen: dict[ChannelKey, _Set] = {}
    for key in keys:
        if key.topic:
            raise InvalidData(f"{name}: a universal file has no topics; leave out topic")
        found = [s for s in sets if key.channel in (s.name, f"#{s.number}")]
        if len(found) != 1:
            if found:
                numbers = " or ".join(f"#{each.number}" for each in found)
                raise InvalidData(
                    f"{name}: {key.channel!r} is there {len(found)} times; take {numbers}"
                )
            raise InvalidData(
                f"{name}: there is no history {key.channel!r}; there are "
                f"{', '.join(map(repr, names[:30])) or 'none'}{nearest(key.channel, names)}"
            )
        if not found[0].is_history:
            raise InvalidData(
                f"{name}: {key.channel!r} is of the kind {found[0].kind!r}, no time history; "
                "export the recorded signal itself"
            )
        chosen[key] = found[0]
    return {key: _samples(path, name, each, key, time) for key, each in chosen.items()}


def list_uff(path: Path, name: str) -> FileList:
    """List the data sets 58 of a universal file."""
    streams = []
    sets = _headers(path, name)
    names = [each.name for each in sets]
    for each in sets:
        key = ChannelKey(each.name if names.count(each.name) == 1 else f"#{each.number}")
        words = f"#{each.number}, {each.data.get('id1', '')}".strip(" ,")
        if not each.is_history:
            streams.append(Stream(kind=each.kind, note=f"{key}: no time history"))
            continue
        samples = _samples(path, name, each, key, TimeSource())
        channel = Channel(
            key=key, first=tuple(samples.values[:3].tolist()), unit=each.unit, words=words
        )
        streams.append(
            Stream(
                kind=each.kind,
                samples=len(samples.time),
                seconds=float(samples.time[-1] - samples.time[0]),
                channels=(channel,),
                note="" if each.unit else "the file gives no unit that is known",
            )
        )
    return FileList(name=name, kind="uff", words="universal file", streams=tuple(streams))


def _headers(path: Path, name: str) -> list[_Set]:
    try:
        size = path.stat().st_size
        if size > _MOST_BYTES:
            raise InvalidData(f"{name}: {size} bytes; at most {_MOST_BYTES} are read, export less")
        marks = len(_MARK.findall(path.read_bytes()))
    except OSError as error:
        raise unreadable(name, error) from None
    if marks == 0:
        raise InvalidData(f"{name}: no universal file: it has no lines '    -1'")
    if marks % 2:
        raise InvalidData(
            f"{name}: cut short or damaged: data set {marks // 2 + 1} has no '    -1' at its end"
        )
    file = _open(path, name)
    sets = []
    for i, kind in enumerate(_quietly(file.get_set_types, name)):
        if int(kind) != 58:
            continue
        data = _quietly(
            lambda i=i: file.read_sets(i, header_only=True), f"{name}: data set {i + 1}"
        )
        direction = _DIRECTIONS.get(data.get("rsp_dir"), f"?{data.get('rsp_dir')}")
        sets.append(_Set(i + 1, f"{data.get('rsp_node', 0)}{direction}", data))
    if not sets:
        raise InvalidData(f"{name}: it has no data set 58, which holds measured functions")
    return sets


def _samples(path: Path, name: str, each: _Set, key: ChannelKey, time: TimeSource) -> Samples:
    place = f"{name}: {key.channel!r}"
    data = _quietly(lambda: _open(path, name).read_sets(each.number - 1), place)
    values, told = np.asarray(data["data"]), int(data["num_pts"])
    if np.iscomplexobj(values):
        raise InvalidData(f"{place}: its values are complex; a time history is real")
    if len(values) != told:
        raise InvalidData(
            f"{place}: cut short or damaged: {told} values declared, {len(values)} there"
        )
    even = int(data["abscissa_spacing"]) == 1
    if time.rate_hz is not None:
        at: Array = np.arange(told) / time.rate_hz
    elif even:
        step = float(data["abscissa_inc"])
        if not 1e-9 <= step <= 1e6:
            raise InvalidData(f"{place}: its step is {step:g} s; say the rate by time.rate_hz")
        at = float(data["abscissa_min"]) + np.arange(told) / _rate(step)
    else:
        at = np.asarray(data["x"], dtype=np.float64)
    return checked(place, at, values.astype(np.float64), unit=each.unit, row_word="value")


def _rate(step: float) -> float:
    """Rate of a step that was rounded to six digits; whole where that is within the rounding."""
    rate = 1.0 / step
    whole = round(rate)
    return float(whole) if whole and abs(rate / whole - 1) <= _ROUNDING else rate


def _open(path: Path, name: str) -> Any:
    try:
        import pyuff
    except ImportError:
        raise MissingExtra("universal files need pyuff: pip install 'loose-env[import]'") from None
    return _quietly(lambda: pyuff.UFF(str(path)), name)


def _quietly(call: Any, place: str) -> Any:
    """Call the library, which raises plain exceptions on whatever it cannot read."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return call()
    except Exception as error:
        words = " ".join(str(error).split())[:100]
        raise InvalidData(
            f"{place}: damaged: the header or the values cannot be read ({words})"
        ) from None
