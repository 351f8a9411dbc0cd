"""How much a model file may announce: a few words can ask for more than a computer has.

A count in an MJCF file costs nothing to write and is made good when the file is read, so a file of
a hundred bytes can ask for all the memory there is. What is allowed here is far above what models
of arms have.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from loose_env.errors import InvalidData

__all__ = ["MOST_BYTES", "check_counts", "check_expanded"]

MOST_BYTES = 2**26
"""Largest XML file that is read [bytes]."""
MOST_ELEMENTS = 200_000
"""Most elements of a model once copies and attached models are counted."""

_PIXELS = 2**24
_MOST: Mapping[tuple[str, tuple[str, ...]], int] = {
    ("replicate", ("count",)): 10_000,
    ("flexcomp", ("count",)): 100_000,
    ("composite", ("count",)): 100_000,
    ("texture", ("width", "height")): _PIXELS,
    ("texture", ("gridsize",)): 10_000,
    ("hfield", ("nrow", "ncol")): _PIXELS,
    ("camera", ("resolution",)): _PIXELS,
    ("mesh", ("params",)): 1_000_000,
    ("mesh", ("octree_maxdepth",)): 8,
    ("key", ("nkey",)): 100_000,
    ("size", ("nkey",)): 100_000,
    ("size", ("nuserdata",)): 10_000_000,
    ("size", ("nconmax",)): 10_000_000,
    ("size", ("njmax",)): 1_000_000,
    ("size", ("nstack",)): 1_000_000_000,
    **{
        ("size", (f"nuser_{kind}",)): 1000
        for kind in ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")
    },
    ("numeric", ("size",)): 100_000,
    **{(tag, ("nsample",)): 100_000 for tag in ("general", "motor", "position", "velocity")},
}
"""Element, attributes -> the largest product of the numbers in them."""
_ANYWHERE: Mapping[str, int] = {"nsample": 100_000, "num": 1_000_000}
"""Attributes that ask for memory wherever they stand."""
_MEMORY = 2**32
_UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}


def check_counts(root: ET.Element, file: Path) -> None:
    """Refuse numbers in a file that ask for more than any arm needs.

    Raises
    ------
    InvalidData
        With the element, the attribute and what is allowed.

    Examples
    --------
    >>> check_counts(ET.fromstring('<size nkey="1000000000"/>'), Path("arm.xml"))
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: arm.xml: <size nkey='1000000000'> asks for 1e+09; ...
    """
    for element in root.iter():
        tag = _local(element.tag)
        for (name, keys), most in _MOST.items():
            if tag == name:
                _check(element, tag, keys, most, file)
        for key, most in _ANYWHERE.items():
            _check(element, tag, (key,), most, file)
        memory = element.get("memory") if tag == "size" else None
        if memory is not None and _bytes(memory) > _MEMORY:
            raise InvalidData(
                f"{file.name}: <size memory={memory!r:.40}> asks for too much; at most 4G is "
                "taken. Leave it out, MuJoCo finds what the model needs"
            )


def check_expanded(
    root: ET.Element, attached: Mapping[str, float], file: Path, included: float = 0.0
) -> float:
    """Elements of a file with its copies, and with the models that it attaches.

    Parameters
    ----------
    root : Element
        The file.
    attached : mapping
        Name of a model of its assets -> elements of that model.
    file : Path
        What errors name.
    included : float
        Elements that the files it includes add.

    Raises
    ------
    InvalidData
        If there are more than `MOST_ELEMENTS`: copies of copies multiply.
    """
    total = included
    waiting: list[tuple[ET.Element, float]] = [(root, 1.0)]
    while waiting:
        element, copies = waiting.pop()
        total += copies
        tag = _local(element.tag)
        if tag == "replicate":
            copies *= max(_product(element, ("count",)), 1.0)
        elif tag == "attach":
            # A model without a name goes by another one: the largest is counted.
            given = element.get("model", "")
            total += copies * attached.get(given, max(attached.values(), default=0.0))
        if total > MOST_ELEMENTS or copies > MOST_ELEMENTS:
            raise InvalidData(
                f"{file.name}: <{tag}>: with its copies and the models it attaches the file has "
                f"more than {MOST_ELEMENTS} elements, which are not read"
            )
        waiting += [(child, copies) for child in element]
    return total


def _check(element: ET.Element, tag: str, keys: tuple[str, ...], most: int, file: Path) -> None:
    asked = _product(element, keys)
    if asked > most:
        words = " ".join(f"{k}={element.get(k)!r:.40}" for k in keys if element.get(k))
        raise InvalidData(
            f"{file.name}: <{tag} {words}> asks for {asked:.3g}; at most {most} are read"
        )


def _product(element: ET.Element, keys: tuple[str, ...]) -> float:
    """Product of all numbers in some attributes; 0 where there is none."""
    words = [word for key in keys for word in element.get(key, "").split()]
    found = 1.0 if words else 0.0
    for word in words:
        try:
            number = abs(float(word))
        except ValueError:  # left to MuJoCo, which says it better
            return 0.0
        found *= max(number, 1.0) if not math.isnan(number) else 1.0
    return found


def _bytes(text: str) -> float:
    word = text.strip().upper()
    unit = word[-1:] if word[-1:] in _UNITS else ""
    try:
        return float(word.removesuffix(unit)) * _UNITS[unit]
    except ValueError:
        return 0.0


def _local(tag: str) -> str:
    return tag.rpartition("}")[2]
