"""Channels of a rosbag2 folder (MCAP or SQLite files), read and listed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loose_env.errors import InvalidData, MissingExtra
from loose_env.importing.mapping.mapping import TimeSource
from loose_env.importing.readers.messages.mcap_file import list_topics, read_topics
from loose_env.importing.readers.messages.mcap_records import Message, walk
from loose_env.importing.readers.messages.sqlite_records import walk_sqlite
from loose_env.importing.samples import ChannelKey, FileList, Samples, file_within
from loose_env.recording import read_text

METADATA = "metadata.yaml"
"""File that makes a folder a ROS 2 bag."""
_MOST_BYTES = 2**24
_NEWEST = 9
_STORAGES = ("mcap", "sqlite3")
_CONVERT = "'ros2 bag convert' writes one that is read"


@dataclass(frozen=True)
class _Bag:
    """Files of a bag in their order, and how they are written."""

    files: tuple[Path, ...]
    storage: str
    packed: bool
    name: str

    def walk(self, topics: frozenset[str] | None) -> Iterator[Message]:
        for path in self.files:
            name = path.name if path.name == self.name else f"{self.name}/{path.name}"
            if self.storage == "mcap":
                yield from walk(path, name, topics)
            else:
                yield from walk_sqlite(path, name, topics, packed=self.packed)


def read_rosbag2(
    path: Path, name: str, keys: Sequence[ChannelKey], times: Mapping[str, TimeSource]
) -> dict[ChannelKey, Samples]:
    """Read channels of a bag, as `read_topics`."""
    return read_topics(_bag(path, name).walk, name, keys, times)


def list_rosbag2(path: Path, name: str) -> FileList:
    """List topics and channels of a bag, as `list_topics`."""
    bag = _bag(path, name)
    words = f"ROS 2 bag, {bag.storage}"
    return FileList(name=name, kind="rosbag2", words=words, streams=list_topics(bag.walk, name))


def _bag(path: Path, name: str) -> _Bag:
    if path.is_file():
        return _Bag((path,), "sqlite3", False, name)
    place = f"{name}/{METADATA}"
    whole = _yaml(path / METADATA, place)
    about = whole.get("rosbag2_bagfile_information") if isinstance(whole, dict) else None
    if not isinstance(about, dict):
        raise InvalidData(f"{place}: it has no rosbag2_bagfile_information; is it a ROS 2 bag?")
    version = about.get("version")
    if not isinstance(version, int) or not 1 <= version <= _NEWEST:
        raise InvalidData(
            f"{place}: version {version!r:.40} of rosbag2; read are 1 to {_NEWEST}; {_CONVERT}"
        )
    storage = about.get("storage_identifier")
    if storage not in _STORAGES:
        raise InvalidData(
            f"{place}: storage {storage!r:.40}; read are {' and '.join(_STORAGES)}; {_CONVERT}"
        )
    mode = str(about.get("compression_mode") or "").upper()
    packed = mode == "MESSAGE" and storage == "sqlite3"
    if mode not in ("", "NONE", "MESSAGE") or (packed and about["compression_format"] != "zstd"):
        raise InvalidData(
            f"{place}: compressed by {about.get('compression_format')!r:.40} in mode {mode!r:.40}; "
            f"read are bags whose messages, not files, are compressed by zstd; {_CONVERT}"
        )
    given = about.get("relative_file_paths")
    if not isinstance(given, list) or not given or not all(isinstance(f, str) for f in given):
        raise InvalidData(f"{place}: relative_file_paths names no files; try 'ros2 bag reindex'")
    files = tuple(file_within(path, each, f"{place}: relative_file_paths") for each in given)
    return _Bag(files, storage, packed, name)


def _yaml(path: Path, place: str) -> Any:
    try:
        import yaml  # type: ignore[import-untyped]
    except ImportError:
        raise MissingExtra("ROS 2 bags need pyyaml: pip install 'loose-env[import]'") from None
    if not path.is_file():
        raise InvalidData(f"{place}: there is no such file; 'ros2 bag reindex' writes it")
    text = read_text(path, place, _MOST_BYTES)
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InvalidData(f"{place}: not YAML: {' '.join(str(error).split())[:120]}") from None
