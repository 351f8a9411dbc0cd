"""Files of a command line: found, kind told, opened; folders of logs expanded."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.importing.array_files import INFO, READERS, open_arrays, open_lerobot
from loose_env.importing.mapping import ImportMapping, RunPlan
from loose_env.importing.messages import open_messages, storages
from loose_env.importing.samples import Log, natural
from loose_env.importing.text_tables import open_text_table
from loose_env.recording import nearest

Given = Mapping[str, Path]
"""Files of the command line by the names that a mapping may call them."""

Opener = Callable[[Path, str], Log]
_OPENERS: dict[str, Opener] = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".log", ".asc"), open_text_table),
    **dict.fromkeys((".mcap", ".db3", ".bag"), open_messages),
    **dict.fromkeys(READERS, open_arrays),
}
_NOT_LOGS = ("readme", "license", "requirements", "metadata", "info", "package", "config")
"""Names of files of a folder that are no logs."""
_LAST_NUMBER = re.compile(r"(\d+)$", re.ASCII)


def given_files(words: Sequence[str]) -> Given:
    """Read the SOURCEs of a command line: ``PATH``, or ``NAME=PATH`` to name a source.

    A folder that is neither a bag nor a dataset stands for the logs in it.
    """
    members: list[tuple[str, Path]] = []
    for word in words:
        name, equals, rest = word.partition("=")
        named = bool(equals) and "/" not in name and not Path(word).exists()
        path = Path(rest if named else word)
        if not path.is_file() and not path.is_dir():
            raise InvalidSetting(f"there is no file {str(path)!r}")
        own = [path] if named or path.is_file() or _folder_opener(path) else _logs_in(path)
        if not own:
            raise InvalidData(
                f"{path.resolve().name}: a folder without logs; read are folders of a ROS bag, of "
                f"a LeRobot dataset ({INFO}), or of files that end in {', '.join(_OPENERS)}"
            )
        members += [(name if named else "", each) for each in own]
    places = {path.resolve() for name, path in members if not name}
    names = [each.name for each in places]
    found: dict[str, Path] = {}
    for name, path in members:
        own_name = path.resolve().name
        folder = f"{path.resolve().parent.name}/" * (names.count(own_name) > 1)
        key = name or f"{folder}{own_name}"
        if key in found:
            raise InvalidSetting(
                f"two sources are called {key!r}; give one as NAME=PATH, where NAME is the "
                "mapping's source or file"
            )
        found[key] = path
    return found


def _logs_in(folder: Path) -> list[Path]:
    """Logs of a folder and, where it has none itself, of the folders in it."""
    members = sorted(folder.iterdir(), key=lambda p: natural(p.name))
    logs = [p for p in members if p.is_dir() and _folder_opener(p)]
    logs += [
        p
        for p in members
        if p.is_file() and p.suffix.lower() in _OPENERS and not p.stem.lower().startswith(_NOT_LOGS)
    ]
    return logs or [log for p in members if p.is_dir() for log in _logs_in(p)]


def files_of_runs(mapping: ImportMapping, given: Given) -> list[dict[str, Path]]:
    """Find, for each run, the file of each of its sources.

    Only files of the command line are ever read; a mapping chooses among them by name.
    """
    unused = set(given)
    found = []
    for run in mapping.runs:
        files = {}
        for name in dict.fromkeys(column.source for column in mapping.columns.values()):
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
    if unused := unused - {*mapping.unused}:
        raise InvalidSetting(
            f"{mapping.name} uses no file {sorted(unused)[0]!r}; leave it out, or name it in the "
            "mapping (file of a source, or sources of a run)"
        )
    return found


def _folder_opener(path: Path) -> Opener | None:
    """What opens a folder that is one log: a dataset, or the pieces of one bag."""
    dataset = path.joinpath("meta").is_dir() and any(path.glob("data/*/*.parquet"))
    if dataset or path.joinpath(INFO).is_file():
        return open_lerobot
    files = storages(path)
    pieces = {re.sub(r"(_\d+)?(\.mcap|\.db3)(\.zstd)?$", "", each.name) for each in files}
    whole = path.joinpath("metadata.yaml").is_file() or pieces == {path.name}
    return open_messages if files and (whole or len(files) == 1) else None


def open_log(path: Path) -> Log:
    """Open a file by its ending, or a folder by what is in it."""
    ending = path.suffix.lower()
    opener = _folder_opener(path) if path.is_dir() else _OPENERS.get(ending)
    if opener is None:
        raise InvalidData(
            f"{path.name}: {ending or 'a file without an ending'} is not read; read are "
            f"{', '.join(_OPENERS)}; save the channels as one of these (files that can hold code, "
            "such as pickles, are never read)"
        )
    return opener(path, path.resolve().name)


def run_episodes(run: RunPlan, logs: Iterable[Log]) -> list[str]:
    """Names of the episodes that a run stands for; none where no source has episodes."""
    found: list[str] = []
    for log in logs:
        there = {int(m[1]) if (m := _LAST_NUMBER.search(e)) else i: e
                 for i, e in enumerate(log.episodes)}  # fmt: skip
        chosen = [*there] if run.episodes == "all" or not there else run.episodes
        if lost := [number for number in chosen if number not in there]:
            raise InvalidData(
                f"{run.place}.episodes: {log.name}: there is no episode {lost[0]}; there are "
                f"{len(there)}, from {min(there)} to {max(there)}"
            )
        own = [there[number] for number in chosen]
        if found and own and own != found:
            raise InvalidData(
                f"{run.place}: {log.name} and another source have episodes of different names; "
                "make a run of each"
            )
        found = found or own
    return found


def _called(told: str, name: str, file: str, given: Given) -> str | None:
    """Key of a source's file on the command line: by the run, its own name, or its file's."""
    if told:
        return told if told in given else None
    stems = [call for call, path in given.items() if call == path.name and path.stem == name]
    return next((call for call in (name, file, *stems[:1]) if call in given), None)
