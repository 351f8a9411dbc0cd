"""Safety of a model file before it is read: its sizes, and no file outside its folder.

A count in an MJCF file costs nothing to write and is made good when the file is read, so a file of
a hundred bytes can ask for all the memory there is. What is allowed here is far above what models
of arms have.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from loose_env.errors import InvalidData

__all__ = ["MOST_BYTES", "check_counts", "check_expanded", "files_of", "outermost", "scan"]


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
        tag = _local(element)
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
        tag = _local(element)
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


_INCLUDED = ("include", "model")  # elements whose file is XML of its own
_DIRECTORIES = ("assetdir", "meshdir", "texturedir")


def scan(file: Path, root: Path | None = None) -> ET.Element:
    """Parse a file and those it includes, and return its outermost element.

    Files lie in the file's own folder, or in ``root`` where that is given.

    Raises
    ------
    InvalidData
        If one of them is not XML, is a xacro, declares entities, asks for more copies than any
        arm needs, or refers to anything outside that folder. The message names the
        first file, and the one in which it is.
    """
    return _looked_over(file, root).parsed[file]


def outermost(file: Path) -> str:
    """Name of the outermost element of a file; raises as `scan`."""
    return str(_parsed(file).tag)


def files_of(file: Path) -> set[Path]:
    """Files that stand for a model: the file, those it includes, and the assets that are there.

    Raises as `scan`. ``file`` has to be resolved, as there.
    """
    found = _looked_over(file)
    return set(found.parsed) | found.assets


@dataclass(kw_only=True)
class _Found:
    """Files to which a file and its includes refer."""

    folders: tuple[Path, ...]
    """Folders in which every file has to lie."""
    parsed: dict[Path, ET.Element] = field(default_factory=dict)
    places: list[Path] = field(default_factory=list)
    """Folders in which assets are looked for: a directory that one file names holds for all."""
    parts: dict[Path, list[tuple[ET.Element, Path]]] = field(default_factory=dict)
    """File -> elements that name a file of XML, and that file."""
    assets: set[Path] = field(default_factory=set)


def _looked_over(file: Path, root: Path | None = None) -> _Found:
    try:
        return _followed(file, root)
    except InvalidData as error:
        if str(error).startswith(f"{file.name}:"):
            raise
        raise InvalidData(f"{file.name}: it includes {error}") from None


def _followed(file: Path, package: Path | None) -> _Found:
    folders = (file.parent,) if package is None else (file.parent, package)
    found = _Found(folders=folders, places=[file.parent])
    waiting = [file]
    while waiting:
        while waiting:
            each = waiting.pop()
            if each not in found.parsed:
                found.parsed[each] = _parsed(each)
                found.places += _directories(each, found)
        # A folder named in one file may be where another one's part lies.
        found.parts, found.assets = {}, set()
        for each, root in found.parsed.items():
            waiting += [part for part in _references(each, root, found) if part not in found.parsed]
    _expanded(file, found, {}, [])
    return found


def _parsed(file: Path) -> ET.Element:
    size = file.stat().st_size
    if size > MOST_BYTES:
        raise InvalidData(f"{file.name}: {size} bytes; at most {MOST_BYTES} are read")
    raw = file.read_bytes()
    if re.search(rb"<!(DOCTYPE|ENTITY)", raw):
        raise InvalidData(
            f"{file.name}: it declares a document type or entities, which are not read; "
            "remove the <!DOCTYPE ...>"
        )
    try:
        root = ET.fromstring(raw)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InvalidData(f"{file.name}: not XML: {error}") from None
    if any("ros.org/wiki/xacro" in str(e.tag) for e in root.iter()):
        raise InvalidData(f"{file.name}: it is a xacro; expand it to a plain URDF first")
    check_counts(root, file)
    return root


def _directories(file: Path, found: _Found) -> list[Path]:
    places = [file.parent]
    for element in found.parsed[file].iter():
        if _local(element) == "compiler":
            for key in _DIRECTORIES:
                given = element.get(key)
                if given:
                    at = (found.places[0], file.parent)
                    places += [_inside(given, p, found.folders, file, "compiler", key) for p in at]
    return [place for place in dict.fromkeys(places) if place not in found.places]


def _references(file: Path, root: ET.Element, found: _Found) -> list[Path]:
    """Check every file that a file names; return those that are XML of their own."""
    parts = found.parts[file] = []
    for element in root.iter():
        tag = _local(element)
        for key, given in element.attrib.items():
            if not key.startswith("file") or not given:
                continue
            for place in dict.fromkeys((*found.places, file.parent)):
                named = _inside(given, place, found.folders, file, tag, key)
                # URDF and the option strippath take the last part of a path alone.
                alone = _inside(named.name, place, found.folders, file, tag, key)
                there = {f for f in (named, alone) if _is_file(f, file, tag, key, given)}
                found.assets |= there
                if tag in _INCLUDED and named in there:
                    parts.append((element, named))
    return [part for _, part in parts]


def _expanded(file: Path, found: _Found, known: dict[Path, float], above: list[Path]) -> float:
    """Elements of a file with what it includes and attaches."""
    if file in above:  # MuJoCo refuses a file that includes itself
        return 0.0
    if file not in known:
        included, attached = 0.0, dict[str, float]()
        for element, part in found.parts[file]:
            size = _expanded(part, found, known, [*above, file])
            if _local(element) == "include":
                included += size
            else:
                names = (element.get("name", ""), part.stem, found.parsed[part].get("model", ""))
                attached |= dict.fromkeys(filter(None, names), size)
        known[file] = check_expanded(found.parsed[file], attached, file, included)
    return known[file]


def _is_file(path: Path, file: Path, tag: str, key: str, given: str) -> bool:
    """Return whether there is a file; refuse a pipe or a device, which would block."""
    if path.is_file():
        return True
    if path.exists() and not path.is_dir():
        raise InvalidData(
            f"{file.name}: <{tag} {key}={given!r:.60}> is no file but a pipe or a device, which "
            "is not read"
        )
    return False


def _inside(
    given: str, place: Path, folders: tuple[Path, ...], file: Path, tag: str, key: str
) -> Path:
    # Packages are not looked up: MuJoCo takes their file's name alone. It also takes a
    # backslash for a slash, on every system.
    local = given.replace("\\", "/").removeprefix("file://").removeprefix("package://")
    words = f"{file.name}: <{tag} {key}={given!r:.200}>"
    try:
        found = (place / local).resolve()
        found.exists()
    except (OSError, RuntimeError, ValueError) as error:
        raise InvalidData(f"{words} leads nowhere: {_reason(error)}") from None
    if "://" in local or not any(found.is_relative_to(folder) for folder in folders):
        raise InvalidData(
            f"{words} lies outside the file's folder and is not "
            "read; copy what it needs beside the file, remove the element or, for meshes of a "
            "URDF's package, name the package's folder with --package-path"
        )
    return found


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _local(element: ET.Element) -> str:
    """Name of an element without its namespace, which MuJoCo does not know."""
    return str(element.tag).rpartition("}")[2]
