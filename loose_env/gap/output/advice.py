"""Effects in words, and motions and sensors that make one visible, or tell two apart."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def _words() -> dict[str, Any]:
    """Tables of the words, as the file says."""
    return tomllib.loads(files("loose_env.gap.output").joinpath("advice.toml").read_text("utf-8"))


def _found(table: str, *keys: str) -> str:
    """Words of the first key that a table has; "" if it has none."""
    words = _words()[table]
    first = next((words[key] for key in keys if key in words), "")
    return str(words.get(first, first))


def how_to_separate(kind: str, where: str, other: str, elsewhere: str) -> str:
    """Name a motion or a measurement that tells two effects apart.

    Examples
    --------
    >>> how_to_separate("payload", "tool", "link_mass", "link3").split(":")[0]
    'Move the last joint by itself, with its axis level'
    >>> how_to_separate("viscous_friction", "joint1", "viscous_friction", "joint2")
    'Move joint1 while joint2 is held, and the other way round.'
    >>> how_to_separate("command_delay", "motor1", "command_delay", "all")
    'Command the drives one at a time.'
    """
    if known := _found("separate", f"{kind} {other}", f"{other} {kind}"):
        return known
    if kind == other and "all" in (where, elsewhere):
        return "Command the drives one at a time."
    if where != elsewhere and kind == other:
        return f"Move {where} while {elsewhere} is held, and the other way round."
    return _found("otherwise", kind.split("_")[0], other.split("_")[0], "any")


def how_to_see(kind: str) -> str:
    """Name a motion that shows an effect.

    Examples
    --------
    >>> how_to_see("coulomb_friction")
    'reverse the joint slowly, many times'
    >>> how_to_see("own_effect")
    'move the joint alone, slowly and fast, both ways, over its whole range'
    """
    general = _found("otherwise", "any").rstrip(".")
    return _found("see", kind) or general[0].lower() + general[1:]


def kind_words(kind: str) -> str:
    """A kind of effect, as one says it."""
    return _found("name", kind) or kind.replace("_", " ")


def effect_words(kind: str, where: str) -> str:
    """An effect and its location, as one says it.

    Examples
    --------
    >>> effect_words("coulomb_friction", "joint2")
    'dry friction (joint2)'
    """
    place = _words()["location"].get(f"{kind} {where}", f"({where})")
    return f"{kind_words(kind)} {place}".rstrip()
