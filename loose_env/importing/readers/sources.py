"""Source files of a mapping: found for each run, kind told, channels listed and read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.importing.mapping.mapping import (
    FileKind,
    ImportMapping,
    RunPlan,
    SourceEntry,
    TimeSource,
)
from loose_env.importing.readers.csv_file import read_csv_logger
from loose_env.importing.readers.csv_list import list_csv
from loose_env.importing.readers.datasets.episodes import chosen_episodes
from loose_env.importing.readers.datasets.hdf5_file import hdf5_episodes, list_hdf5, read_hdf5
from loose_env.importing.readers.datasets.lerobot import (
    INFO,
    UNITS,
    lerobot_episodes,
    list_lerobot,
    read_lerobot,
)
from loose_env.importing.readers.datasets.sysid_file import list_sysid, read_sysid
from loose_env.importing.readers.messages.mcap_file import list_mcap, read_mcap
from loose_env.importing.readers.messages.mcap_records import MAGIC
from loose_env.importing.readers.messages.rosbag2 import METADATA, list_rosbag2, read_rosbag2
from loose_env.importing.readers.uff_file import list_uff, read_uff
from loose_env.importing.samples import ChannelKey, FileList, Samples, unreadable
from loose_env.importing.timing.even_stamps import straightened
from loose_env.recording import nearest

Given = Mapping[str, Path]
"""Files of the command line by the names that a mapping may call them."""

_ENDINGS: dict[str, FileKind] = {
    ".mcap": "mcap", ".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv", ".log": "csv",
    ".asc": "csv", ".uff": "uff", ".unv": "uff", ".uf58": "uff", ".bunv": "uff",
    ".db3": "rosbag2", ".hdf5": "hdf5", ".h5": "hdf5", ".npz": "sysid",
}  # fmt: skip
_FOLDERS: dict[FileKind, str] = {"rosbag2": METADATA, "lerobot": INFO}
"""Kinds of folders, and the file that makes a folder one."""
_ADVICE = {
    ".bag": "convert it by 'mcap convert' to MCAP, from ROS 1 to ROS 2 first",
    ".mat": "save its columns as CSV",
    ".tdms": "export it as CSV or universal file",
    ".xlsx": "save the sheet as CSV",
    ".zstd": "expand it by 'zstd -d', or convert the bag by 'ros2 bag convert'",
    ".parquet": "give the folder of the LeRobot dataset; a recording takes Parquet as it is",
    ".pkl": "files that can hold code are not read",
    ".npy": "save it as CSV",
}


def given_files(words: Sequence[str]) -> Given:
    """Read the SOURCEs of a command line: ``PATH``, or ``NAME=PATH`` to name a source."""
    found: dict[str, Path] = {}
    for word in words:
        name, equals, rest = word.partition("=")
        named = bool(equals) and "/" not in name and not Path(word).exists()
        path = Path(rest if named else word)
        if not path.is_file() and not path.is_dir():
            raise InvalidSetting(f"there is no file {str(path)!r}")
        key = name if named else path.resolve().name
        if key in found:
            raise InvalidSetting(
                f"two sources are called {key!r}; give one as NAME=PATH, where NAME is the "
                "mapping's source or file"
            )
        found[key] = path
    return found


def files_of_runs(mapping: ImportMapping, given: Given) -> list[dict[str, Path]]:
    """Find, for each run, the file of each of its sources.

    Only files of the command line are ever read; a mapping chooses among them by name.
    """
    unused = set(given)
    found = []
    for run in mapping.runs:
        files = {}
        for name in dict.fromkeys(_needed(mapping, run)):
            entry = mapping.sources[name]
            told = run.sources.get(name, "")
            call = _called(told, name, entry.file, given)
            if call is None and not told and len(mapping.sources) == len(given) == 1:
                call = next(iter(given))
            if call is None:
                wanted = told or entry.file or name
                raise InvalidData(
                    f"{run.place}: source {name!r} is the file {wanted!r}, which is not among "
                    f"those given ({', '.join(map(repr, given)) or 'none'}); name it on the "
                    f"command line, or give {name}=PATH{nearest(wanted, list(given))}"
                )
            files[name] = given[call]
            unused.discard(call)
        found.append(files)
    if unused:
        raise InvalidSetting(
            f"{mapping.name} uses no file {sorted(unused)[0]!r}; leave it out, or name it in the "
            "mapping (file of a source, or sources of a run)"
        )
    return found


def kind_of(path: Path, told: FileKind | None = None) -> FileKind:
    """Kind of a file: the given one, by its ending, else by its first bytes."""
    if path.is_dir():
        for kind, mark in _FOLDERS.items():
            if path.joinpath(mark).is_file() or told == kind:
                return kind
        raise InvalidData(
            f"{path.name}: a folder without {' or '.join(_FOLDERS.values())}; read are folders of "
            "a ROS 2 bag (if metadata.yaml was lost, 'ros2 bag reindex' writes it) and of a "
            "LeRobot dataset"
        )
    if told is not None:
        return told
    try:
        with path.open("rb") as file:
            start = file.read(len(MAGIC))
    except OSError as error:
        raise unreadable(path.name, error) from None
    if start == MAGIC:
        return "mcap"
    ending = path.suffix.lower()
    if ending in _ADVICE:
        raise InvalidData(f"{path.name}: {ending} is not read; {_ADVICE[ending]}")
    if ending in _ENDINGS:
        return _ENDINGS[ending]
    if start.startswith(b"    -1"):
        return "uff"
    raise InvalidData(
        f"{path.name}: of what kind is it? Read are {', '.join(_ENDINGS)}; say kind = 'csv', "
        "'mcap', 'uff', 'hdf5' or 'sysid' with the source"
    )


def list_file(path: Path) -> FileList:
    """List the channels of a file; errors as `read_source`."""
    lists: dict[FileKind, Callable[[Path, str], FileList]] = {
        "mcap": list_mcap,
        "csv": list_csv,
        "uff": list_uff,
        "rosbag2": list_rosbag2,
        "lerobot": list_lerobot,
        "hdf5": list_hdf5,
        "sysid": list_sysid,
    }
    return lists[kind_of(path)](path, path.resolve().name)


def run_episodes(run: RunPlan, files: Mapping[str, Path], mapping: ImportMapping) -> list[str]:
    """Names of the episodes that a run stands for; none where no source has episodes."""
    found: list[str] = []
    owner = ""
    for name, path in files.items():
        there = _episodes(path, mapping.sources[name])
        if not there:
            continue
        own = chosen_episodes(run.episodes, there, f"{run.place}.episodes ({path.name})")
        if owner and own != found:
            raise InvalidData(
                f"{run.place}: sources {owner!r} and {name!r} have episodes of different names; "
                "make a run of each"
            )
        found, owner = own, name
    return found


def check_units(mapping: ImportMapping, files: Sequence[Mapping[str, Path]]) -> None:
    """Refuse columns without a unit where the format leaves the unit open."""
    for run, own in zip(mapping.runs, files, strict=True):
        for column in run.columns:
            kind = kind_of(own[column.source], mapping.sources[column.source].kind)
            if kind == "lerobot" and not column.unit:
                raise InvalidData(f"{column.place}: unit is missing: {UNITS}")


def read_source(
    path: Path, entry: SourceEntry, keys: Sequence[ChannelKey], episodes: Sequence[str] = ()
) -> dict[tuple[str, ChannelKey], Samples]:
    """Read channels of a source, with its clock as the mapping corrects it."""
    kind = kind_of(path, entry.kind)
    name = path.resolve().name
    found: dict[tuple[str, ChannelKey], Samples]
    if kind == "lerobot":
        found = read_lerobot(path, name, keys, episodes, entry.time)
    elif kind == "hdf5":
        found = read_hdf5(path, name, keys, episodes, entry.time)
    else:
        found = {("", key): each for key, each in _whole(kind, path, entry, keys).items()}
    earliest: dict[str, int] = {}
    for (episode, _), each in found.items():
        first = each.origin_ns + round(each.time[0] * 1e9)
        earliest[episode] = min(first, earliest.get(episode, first))
    return {
        (episode, key): _corrected(each, entry.time_of(key.topic), earliest[episode])
        for (episode, key), each in found.items()
    }


def _whole(
    kind: FileKind, path: Path, entry: SourceEntry, keys: Sequence[ChannelKey]
) -> dict[ChannelKey, Samples]:
    """Channels of a file without episodes."""
    name = path.resolve().name
    if kind in ("mcap", "rosbag2"):
        times = {key.topic: entry.time_of(key.topic) for key in keys}
        return (read_mcap if kind == "mcap" else read_rosbag2)(path, name, keys, times)
    if kind == "csv":
        return read_csv_logger(path, name, keys, entry.csv, entry.time)
    return (read_uff if kind == "uff" else read_sysid)(path, name, keys, entry.time)


def _episodes(path: Path, entry: SourceEntry) -> tuple[str, ...]:
    """Names of the episodes of a source; none where its kind has none."""
    kind = kind_of(path, entry.kind)
    if kind == "lerobot":
        return lerobot_episodes(path, path.resolve().name)
    return hdf5_episodes(path, path.name) if kind == "hdf5" else ()


def _called(told: str, name: str, file: str, given: Given) -> str | None:
    """Key of a source's file on the command line: by the run, its own name, or its file's."""
    if told:
        return told if told in given else None
    stems = [call for call, path in given.items() if call == path.name and path.stem == name]
    return next((call for call in (name, file, *stems[:1]) if call in given), None)


def _needed(mapping: ImportMapping, run: RunPlan) -> list[str]:
    """Sources that a run needs, those its clocks are set by included."""
    names = [column.source for column in run.columns]
    aligned = (mapping.sources[name].align for name in names)
    return names + [align.to for align in aligned if align is not None]


def _corrected(samples: Samples, time: TimeSource, earliest_ns: int) -> Samples:
    at, origin = samples.time, samples.origin_ns
    if time.even and time.rate_hz is None:
        at = straightened(samples.place, at)
    start = (earliest_ns - origin) * 1e-9
    if time.from_start:
        at, origin, start = at - start, 0, 0.0
    if time.drift_ppm:
        at = start + (at - start) * (1 + 1e-6 * time.drift_ppm)
    # Whole nanoseconds: an offset of years would cost the stamps their microseconds.
    return replace(samples, time=at, origin_ns=origin + round(time.offset_s * 1e9))
