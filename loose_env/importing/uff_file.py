"""Time histories of a universal file (data set 58), read by ``pyuff``."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData, MissingExtra
from loose_env.importing.samples import ChannelKey, Log, Table, unreadable
from loose_env.importing.units import unit_named
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


def open_uff(path: Path, name: str) -> Log:
    """Open a universal file: a table for each time history.

    A file keeps six digits of its step: where that step is a whole number of samples a second
    within those digits, the whole number is taken, since 48000.77 Hz in the place of 48000 Hz
    would shift a minute's end by a millisecond.
    """

    def tables(_: str, keys: Sequence[ChannelKey] | None) -> list[Table]:
        sets = _headers(path, name)
        wanted = None if keys is None else {key.channel for key in keys}
        found = []
        for each in sets:
            alone = sum(other.name == each.name for other in sets) == 1
            key = each.name if alone else f"#{each.number}"
            if each.is_history:
                asked = wanted is None or wanted & {key, f"#{each.number}"}
                found.append(_table(path, name, each, key) if asked else _bare(name, each, key))
            elif wanted is not None and wanted & {each.name, f"#{each.number}"}:
                raise InvalidData(
                    f"{name}: {key!r} is of the kind {each.kind!r}, no time history; export the "
                    "recorded signal itself"
                )
        return found

    return Log(name=name, kind="uff", words="universal file", tables=tables)


def _bare(name: str, each: _Set, key: str) -> Table:
    """Name of a history that is not read."""
    return Table(place=name, columns={key: np.empty(0)}, aliases={f"#{each.number}": key})


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


def _table(path: Path, name: str, each: _Set, key: str) -> Table:
    place = f"{name}: {key!r}"
    data = _quietly(lambda: _open(path, name).read_sets(each.number - 1), place)
    values, told = np.asarray(data["data"]), int(data["num_pts"])
    if np.iscomplexobj(values):
        raise InvalidData(f"{place}: its values are complex; a time history is real")
    if len(values) != told:
        raise InvalidData(
            f"{place}: cut short or damaged: {told} values declared, {len(values)} there"
        )
    if int(data["abscissa_spacing"]) == 1:
        step = float(data["abscissa_inc"])
        if not 1e-9 <= step <= 1e6:
            raise InvalidData(f"{place}: its step is {step:g} s; say the rate by time.rate_hz")
        at: Array = float(data["abscissa_min"]) + np.arange(told) / _rate(step)
    else:
        at = np.asarray(data["x"], dtype=np.float64)
    return Table(
        place=name,
        columns={key: values.astype(np.float64)},
        times=at,
        units={key: each.unit} if each.unit else {},
        words={key: f"#{each.number}, {each.data.get('id1', '')}".strip(" ,")},
        aliases={f"#{each.number}": key},
        row_word="value",
        kind=each.kind,
        note="" if each.unit else "the file gives no unit that is known",
    )


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
