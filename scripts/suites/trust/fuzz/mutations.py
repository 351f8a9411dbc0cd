"""Ways to damage a file: bytes, text, a tree of JSON, a tree of XML."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["BYTES", "HUGE", "TEXT", "damaged_bytes", "damaged_json", "damaged_text", "damaged_xml"]

Rng = np.random.Generator

HUGE = ("1e999", "-1e308", "9" * 400, "9" * 5000, "1e-400", "NaN", "Infinity", "0x7fffffff", "1_0")
"""Numbers that are none, or more than fits."""
PATHS = (
    *("../secret/secret.csv", "/etc/passwd", "..\\secret\\secret.csv", "C:\\secret.csv"),
    *("\\\\server\\share\\a.csv", "//server/share/a.csv", "a\x00b.csv", "link.csv", "sub/../../x"),
    *("file:///etc/passwd", "http://127.0.0.1:9/a.csv", "a" * 5000, "~/x.csv", "$(touch x)", "."),
    *("dev/zero", "pipe.csv", "", " ", "recording.json", "%2e%2e/secret/secret.csv"),
)
"""Paths that lead elsewhere, or nowhere."""
_WORDS = (
    "",
    "\x00",
    "null",
    "'; import os",
    "{{7*7}}",
    "\ud800".encode("utf-8", "ignore").decode(),
)


def _span(rng: Rng, size: int) -> tuple[int, int]:
    start = int(rng.integers(0, max(size, 1)))
    return start, min(size, start + int(rng.integers(1, max(size // 3, 2))))


def _cut(data: bytes, rng: Rng) -> bytes:
    return data[: int(rng.integers(0, max(len(data), 1)))]


def _lost(data: bytes, rng: Rng) -> bytes:
    a, b = _span(rng, len(data))
    return data[:a] + data[b:]


def _repeated(data: bytes, rng: Rng) -> bytes:
    a, b = _span(rng, len(data))
    return data[:b] + data[a:b] * int(rng.integers(1, 4)) + data[b:]


def _flipped(data: bytes, rng: Rng) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 12))):
        if changed:
            changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _noise(data: bytes, rng: Rng) -> bytes:
    a, _ = _span(rng, len(data))
    return data[:a] + rng.bytes(int(rng.integers(1, 40))) + data[a:]


def _zeros(data: bytes, rng: Rng) -> bytes:
    a, b = _span(rng, len(data))
    return data[:a] + bytes(b - a) + data[b:]


def _swapped(data: bytes, rng: Rng) -> bytes:
    a, b = _span(rng, len(data))
    return data[b:] + data[a:b] + data[:a]


BYTES: dict[str, Callable[[bytes, Rng], bytes]] = {
    "cut": _cut,
    "a piece lost": _lost,
    "a piece twice": _repeated,
    "bits flipped": _flipped,
    "noise put in": _noise,
    "zeros": _zeros,
    "pieces swapped": _swapped,
}
"""Damage to bytes, by name."""


def damaged_bytes(data: bytes, rng: Rng) -> tuple[str, bytes]:
    """Damage bytes in one way; return which."""
    name = str(rng.choice(list(BYTES)))
    return name, BYTES[name](data, rng)


def _lines(text: str, rng: Rng) -> bytes:
    lines = text.splitlines(keepends=True)
    rng.shuffle(lines)
    return "".join(lines).encode("utf-8", "surrogatepass")


def _number(text: str, rng: Rng) -> bytes:
    import re

    found = list(re.finditer(r"-?\d+(\.\d+)?", text))
    if not found:
        return _cut(text.encode(), rng)
    one = found[int(rng.integers(len(found)))]
    return (text[: one.start()] + str(rng.choice(HUGE)) + text[one.end() :]).encode()


def _word(text: str, rng: Rng) -> bytes:
    at = int(rng.integers(0, len(text) + 1))
    return (text[:at] + str(rng.choice(_WORDS)) + text[at:]).encode("utf-8", "surrogatepass")


TEXT: dict[str, Callable[[str, Rng], bytes]] = {
    "lines shuffled": _lines,
    "a huge number": _number,
    "a word put in": _word,
    "UTF-16": lambda text, rng: text.encode("utf-16"),
    "Latin-1": lambda text, rng: ("é" + text).encode("latin-1", "replace"),
    "empty": lambda text, rng: b"",
    "nested 100000 deep": lambda text, rng: b"[" * 100_000 + text.encode() + b"]" * 100_000,
}
"""Damage to text, by name."""


def damaged_text(data: bytes, rng: Rng) -> tuple[str, bytes]:
    """Damage text as text or as bytes; return in which way."""
    if rng.random() < 0.5:
        return damaged_bytes(data, rng)
    name = str(rng.choice(list(TEXT)))
    return name, TEXT[name](data.decode(), rng)


_VALUES: tuple[Any, ...] = (
    *(None, True, [], {}, "", 0, -1, 1e308, 2**70, 10**400, [[]], {"a": {}}, "x" * 5000, "\x00"),
    *([1, "a", None], {"file": "../x"}, -0.0, "nan", "1e5", [[[[[[1]]]]]]),
)


def _nodes(tree: Any) -> list[tuple[Any, Any]]:
    """Every container with every key or index."""
    found, waiting = [], [tree]
    while waiting:
        node = waiting.pop()
        keys = node.keys() if isinstance(node, dict) else range(len(node))
        for key in list(keys):
            found.append((node, key))
            if isinstance(node[key], (dict, list)):
                waiting.append(node[key])
    return found


def damaged_json(data: bytes, rng: Rng) -> tuple[str, bytes]:
    """Damage a tree of JSON: a value of another kind, a key lost, renamed, twice or new."""
    if rng.random() < 0.25:
        return damaged_text(data, rng)
    tree = json.loads(data)
    nodes = _nodes(tree)
    if not nodes:
        return "cut", _cut(data, rng)
    node, key = nodes[int(rng.integers(len(nodes)))]
    name = str(rng.choice(["another kind", "a key lost", "a path", "renamed", "new", "twice"]))
    if name == "another kind":
        node[key] = _VALUES[int(rng.integers(len(_VALUES)))]
    elif name == "a path":
        node[key] = str(rng.choice(PATHS))
    elif name == "a key lost" or isinstance(node, list):
        del node[key]
    elif name == "renamed":
        node[str(key) + "s"] = node.pop(key)
    elif name == "new":
        node["__class__"] = {"py/object": "os.system", "args": ["touch executed"]}
    text = json.dumps(tree)
    if name == "twice":
        inner = json.dumps(str(key)) + ": 1, "
        text = text[0] + inner + inner + text[1:]
    return name, text.encode("utf-8", "surrogatepass")


def damaged_xml(data: bytes, rng: Rng, hostile: tuple[str, ...]) -> tuple[str, bytes]:
    """Damage a model: an attribute, an element lost or doubled, or a hostile element put in."""
    if rng.random() < 0.3:
        return damaged_text(data, rng)
    root = ET.fromstring(data)
    elements = list(root.iter())
    name = str(
        rng.choice(["hostile", "attribute", "lost", "twice", "moved"], p=[0.4, 0.3, 0.1, 0.1, 0.1])
    )
    at = elements[int(rng.integers(len(elements)))]
    if name == "hostile":
        word = str(rng.choice(hostile))
        end = b"</robot>" if root.tag == "robot" else b"</mujoco>"
        return f"hostile: {word.split('>')[0][1:40]}", data.replace(end, word.encode() + end)
    if name == "attribute" and at.attrib:
        key = str(rng.choice(list(at.attrib)))
        values = (*HUGE, *_WORDS[2:5], "-1", "1 2 3 4 5 6 7 8 9", "../a", "x" * 5000, "nan nan nan")
        at.set(key, str(rng.choice(values)))
        return "attribute", ET.tostring(root)
    if name == "moved":
        order = list(at)
        rng.shuffle(order)
        at[:] = order
        return name, ET.tostring(root)
    parents = [(p, c) for p in elements for c in p]
    if not parents:
        return damaged_text(data, rng)
    parent, child = parents[int(rng.integers(len(parents)))]
    if name == "twice":
        parent.append(child)
    else:
        parent.remove(child)
    return name if name in ("twice", "lost") else "lost", ET.tostring(root)
