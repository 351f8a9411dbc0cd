"""Hashes of configurations and differences between them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import PurePath
from typing import Any

import numpy as np

from loose_env.errors import InvalidData

__all__ = ["canonical", "configuration_hash", "differences"]

MOST_NAMED = 8  # differences that a message lists


def configuration_hash(configuration: Any) -> str:
    """Hash of a configuration: SHA-256 of its canonical JSON.

    Equal values give equal hashes in every process and on every machine: the order of keys, a
    tuple for a list, a numpy number for Python's and 1.0 for 1 make no difference. A dataclass
    counts with its name, so that two kinds with the same fields differ.

    Parameters
    ----------
    configuration : mapping or dataclass
        Of strings, numbers, booleans, None, arrays, paths, enumerations, and more of these.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    InvalidData
        If it holds something else.

    Examples
    --------
    >>> configuration_hash({"seed": 1, "gap": 0.1})[:12]
    '2c47eaee84d7'
    >>> configuration_hash({"gap": np.float64(0.1), "seed": 1.0})[:12]
    '2c47eaee84d7'
    """
    text = json.dumps(
        canonical(configuration), sort_keys=True, separators=(",", ":"), ensure_ascii=True
    )
    return hashlib.sha256(text.encode()).hexdigest()


def canonical(value: Any) -> Any:
    """Reduce a configuration to JSON types, with a unique form for each value.

    Raises
    ------
    InvalidData
        If it holds something that JSON does not.
    """
    if is_dataclass(value) and not isinstance(value, type):
        named = {each.name: getattr(value, each.name) for each in fields(value)}
        return {"class": type(value).__name__, **canonical(named)}
    if isinstance(value, Mapping):
        if not all(isinstance(name, str) for name in value):
            raise InvalidData(f"a configuration is named with strings, not {list(value)}")
        return {name: canonical(part) for name, part in value.items()}
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, (np.ndarray, np.generic)):
        return canonical(value.tolist())
    if isinstance(value, (list, tuple)):
        return [canonical(part) for part in value]
    if isinstance(value, PurePath):
        return value.as_posix()
    if isinstance(value, float) and value.is_integer() and abs(value) < 2.0**53:
        return int(value)
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    raise InvalidData(
        f"a configuration cannot hold {value!r} ({type(value).__name__}); give strings, numbers, "
        "lists, dictionaries, arrays or dataclasses of these"
    )


def differences(before: Any, now: Any) -> str:
    """List the differences between two configurations, each by its path.

    Parameters
    ----------
    before, now : JSON value
        As `canonical` returns them.

    Examples
    --------
    >>> differences({"seed": 1, "arm": {"links": 3}}, {"seed": 1, "arm": {"links": 4}})
    'arm.links is 3 there and 4 here'
    """
    old, new = dict(_leaves(before)), dict(_leaves(now))
    found = [
        f"{name} is {old.get(name, 'absent')} there and {new.get(name, 'absent')} here"
        for name in dict.fromkeys([*old, *new])
        if old.get(name) != new.get(name)
    ]
    more = f" and {len(found) - MOST_NAMED} more" if len(found) > MOST_NAMED else ""
    return ", ".join(found[:MOST_NAMED]) + more


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, dict) and value:
        for key, part in value.items():
            yield from _leaves(part, f"{name}.{key}" if name else key)
    else:
        yield name or "configuration", json.dumps(value, ensure_ascii=False)
