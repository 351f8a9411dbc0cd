"""Input of an export (result, corrected model), its output, and sentences on what it leaves out.

An export carries some kinds of effects; `not_carried` lists all others by name, so that none is
lost unnoticed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco

from loose_env.errors import InvalidData
from loose_env.gap.output.result import GapResult, NamedEffect, read_result

ALL: tuple[str, ...] = ("*",)
"""Stands for all parameters of an effect."""
Carried = Mapping[str, tuple[str, ...]]
"""Kind of effect -> its parameters that an export carries, or `ALL`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportSource:
    """The named effects of a result, and the corrected model beside it."""

    result: GapResult
    """The result; it names one effect at least."""
    path: Path
    """File of the corrected model."""

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The corrected model."""
        if not self.path.is_file():
            raise InvalidData(
                f"there is no corrected model {str(self.path)!r}, whose values this export needs; "
                "give the whole folder that 'loose gap' wrote"
            )
        try:
            return mujoco.MjModel.from_xml_path(str(self.path))
        except ValueError as error:
            raise InvalidData(f"{self.path} does not compile: {error}") from error


@dataclass(frozen=True, kw_only=True)
class Export:
    """Files of one export, with what they do not contain."""

    files: Mapping[str, str]
    """Name of a file -> its text."""
    not_expressed: tuple[str, ...] = ()
    """Effects, or parameters of effects, that the target cannot express, in sentences."""
    notes: tuple[str, ...] = ()
    """Conditions under which the files hold, in sentences."""


def read_source(path: str | Path) -> ExportSource:
    """Read a result, and locate the corrected model beside it.

    Parameters
    ----------
    path : str or Path
        ``result.json`` of ``loose gap``, or the folder with it.

    Raises
    ------
    InvalidData
        If there is no result of this version, or it names no effect.

    Examples
    --------
    >>> read_source("no/such/folder")
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidData: ...
    """
    result, place = read_result(path), Path(path)
    if not result.effects:
        raise InvalidData(
            f"{place} names no effect (verdict {result.verdict!r}): there is nothing to export. "
            "Only effects that 'loose gap' identified are exported"
        )
    folder = place if place.is_dir() else place.parent
    return ExportSource(result=result, path=folder / (result.model or "model.xml"))


def number(value: float) -> str:
    """Format a number with six significant digits.

    Examples
    --------
    >>> number(0.1 + 0.2), number(3.0)
    ('0.3', '3')
    """
    return f"{value:.6g}"


def effect_words(effect: NamedEffect, names: Iterable[str] | None = None) -> str:
    """Format an effect with some of its parameters; by default with all."""
    wanted = tuple(effect.parameters) if names is None else tuple(names)
    values = ", ".join(
        f"{name} {effect.parameters[name]:.4g} {effect.units.get(name, '')}".rstrip()
        for name in wanted
    )
    return f"{effect.kind} at {effect.where} ({values})"


def not_carried(
    effects: Iterable[NamedEffect], carried: Carried, *, remedy: str = ""
) -> tuple[str, ...]:
    """List what an export with these kinds of effects leaves out, in sentences."""
    found = []
    for effect in effects:
        known = carried.get(effect.kind, ())
        lost = () if known == ALL else tuple(n for n in effect.parameters if n not in known)
        if lost:
            where = "model.xml" if effect.in_model else "the code in result.json"
            found.append(f"{effect_words(effect, lost)}; {remedy or f'{where} carries it'}")
    return tuple(found)
