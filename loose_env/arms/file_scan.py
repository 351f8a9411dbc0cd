"""A look over an arm's file before it is read: nothing outside its folder is to be opened."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from loose_env.errors import InvalidData

__all__ = ["files_of", "scan"]

_INCLUDED = ("include", "model")  # elements whose file is XML of its own


def scan(file: Path) -> ET.Element:
    """Parse a file and those it includes, and return its outermost element.

    Raises
    ------
    InvalidData
        If one of them is not XML, is a xacro, declares entities, or refers to anything
        outside the folder of the first.
    """
    return _scan(file, file.parent, set(), set())


def files_of(file: Path) -> set[Path]:
    """Files that stand for a model: the file, those it includes, and the assets that are there.

    Raises as `scan`. ``file`` has to be resolved, as there.
    """
    seen: set[Path] = set()
    assets: set[Path] = set()
    _scan(file, file.parent, seen, assets)
    return seen | assets


def _scan(file: Path, folder: Path, seen: set[Path], assets: set[Path]) -> ET.Element:
    """Parse a file and those it includes; refuse whatever points outside ``folder``."""
    seen.add(file)
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
    places = {"": folder}
    for compiler in root.iter("compiler"):
        for key in ("assetdir", "meshdir", "texturedir"):
            given = compiler.get(key)
            if given:
                places[key] = _inside(given, folder, folder, file, "compiler", key)
    for element in root.iter():
        for key, given in element.attrib.items():
            if not key.startswith("file") or not given:
                continue
            for place in set(places.values()) | {file.parent}:
                found = _inside(given, place, folder, file, element.tag, key)
                assets |= {f for f in (found, place / found.name) if f.is_file()}
                if element.tag in _INCLUDED and found.is_file() and found not in seen:
                    _scan(found, folder, seen, assets)
    return root


def _inside(given: str, place: Path, folder: Path, file: Path, tag: str, key: str) -> Path:
    # Packages are not looked up: MuJoCo takes their file's name alone.
    local = given.removeprefix("file://").removeprefix("package://")
    found = (place / local).resolve()
    if "://" in local or not found.is_relative_to(folder):
        raise InvalidData(
            f"{file.name}: <{tag} {key}={given!r}> lies outside the file's folder and is not "
            "read; copy what it needs beside the file, or remove the element"
        )
    return found
