"""Channel names of vector entries, split and numbered: ``obs/joint_pos[2]``, ``action``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.samples import Channel, ChannelKey
from loose_env.recording import nearest
from loose_env.typing import Array

_CHANNEL = re.compile(r"([^\[\]]+)(?:\[([^\[\]]+)\])?")
_MOST_LISTED = 64
"""Entries listed of one vector."""


def split_channel(channel: str, place: str) -> tuple[str, str]:
    """Split a channel into the name of a vector and an entry of it, which may be empty.

    Examples
    --------
    >>> split_channel("observation.state[elbow.pos]", "here")
    ('observation.state', 'elbow.pos')
    """
    found = _CHANNEL.fullmatch(channel)
    if found is None:
        raise InvalidData(
            f"{place}: {channel[:60]!r} is no channel; write the name of a vector and an entry of "
            "it in brackets, by number or name, such as 'action[0]'"
        )
    return found.group(1), found.group(2) or ""


def entry_index(entry: str, width: int, labels: Sequence[str], place: str) -> int:
    """Number of an entry of a vector, from its number or name; a vector of one needs none."""
    if entry in labels:
        return list(labels).index(entry)
    if not entry and width == 1:
        return 0
    if entry.isascii() and entry.isdigit() and len(entry) < 10 and int(entry) < width:
        return int(entry)
    own = f", or by name: {', '.join(map(repr, labels[:20]))}" if labels else ""
    raise InvalidData(
        f"{place}: {entry!r:.60} is no entry of it; its entries are [0] to [{width - 1}]{own}"
        f"{nearest(entry, labels) if labels else ''}"
    )


def vector_channels(
    name: str, first: Array, labels: Sequence[str] = (), *, topic: str = "", words: str = ""
) -> list[Channel]:
    """Channels of a vector, as ``--describe`` lists them."""
    width = first.shape[1]
    found = []
    for i in range(min(width, _MOST_LISTED)):
        entry = f"[{labels[i] if labels else i}]" if width > 1 or labels else ""
        key = ChannelKey(f"{name}{entry}", topic)
        found.append(Channel(key=key, first=tuple(first[:3, i].tolist()), words=words))
    return found


def usable_labels(names: Any, width: int) -> tuple[str, ...]:
    """Names of the entries of a vector where a file gives one for each, else none.

    Files give them as a list, or as a table that holds such a list.

    Examples
    --------
    >>> usable_labels({"motors": ["hip", "knee"]}, 2)
    ('hip', 'knee')
    >>> usable_labels(["state"], 2)
    ()
    """
    if isinstance(names, dict):
        inside = [usable_labels(each, width) for each in names.values()]
        if any(inside):
            return next(filter(None, inside))
        names = list(names)  # names as keys, numbers as values
    if not isinstance(names, list) or len(names) != width or len(set(map(str, names))) < width:
        return ()
    plain = all(
        isinstance(n, str) and n.isprintable() and n and not set(n) & set("[]") for n in names
    )
    return tuple(names) if plain else ()


def as_matrix(values: Any, place: str) -> Array:
    """Values as a matrix of shape (T, N), float64."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiub" or array.ndim not in (1, 2):
        raise InvalidData(
            f"{place}: {array.dtype} of shape {array.shape}; a channel is one number, or a vector "
            "of them, for each sample"
        )
    return array.astype(np.float64).reshape(len(array), -1)
