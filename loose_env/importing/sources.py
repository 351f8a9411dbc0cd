"""Files of a command line: found, kind told, opened; folders of logs expanded."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.importing.array_files import READERS, open_arrays
from loose_env.importing.clocks import samples_of
from loose_env.importing.lerobot import INFO, open_lerobot
from loose_env.importing.mapping import ImportMapping, RunPlan, SourceEntry, TimeSource
from loose_env.importing.messages import open_messages, storages
from loose_env.importing.samples import ChannelKey, Log, Samples, found_in, natural
from loose_env.importing.text_tables import open_text_table
from loose_env.recording import nearest

Given = Mapping[str, Path]
"""Files of the command line by the names that a mapping may call them."""

Opener = Callable[[Path, str], Log]
_OPENERS: dict[str, Opener] = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".log", ".asc"), open_text_table),
    **dict.fromkeys((".mcap", ".db3", ".bag", ".zstd"), open_messages),
    **dict.fromkeys(READERS, open_arrays),
}
_UFF = "pyuff reads its time histories: save them with their times as .npz"
_ADVICE = {
    ".tdms": "export it as CSV",
    ".uff": _UFF,
    ".unv": _UFF,
    ".xlsx": "save the sheet as CSV",
    ".pkl": "files that can hold code are not read",
    ".pickle": "files that can hold code are not read",
}
_NOT_LOGS = ("readme", "license", "requirements", "metadata", "info", "package", "config")
"""Names of files of a folder that are no logs."""
_RANGE = re.compile(r"(\d{1,9})(?:\s*-\s*(\d{1,9}))?", re.ASCII)
_LAST_NUMBER = re.compile(r"(\d+)$", re.ASCII)


def given_files(words: Sequence[str]) -> Given:
    """Read the SOURCEs of a command line: ``PATH``, or ``NAME=PATH`` to name a source.

    A folder that is neither a bag nor a dataset stands for the logs in it.
    """
    found: dict[str, Path] = {}
    for word in words:
        name, equals, rest = word.partition("=")
        named = bool(equals) and "/" not in name and not Path(word).exists()
        path = Path(rest if named else word)
        if not path.is_file() and not path.is_dir():
            raise InvalidSetting(f"there is no file {str(path)!r}")
        members = [path] if named or path.is_file() or _folder_opener(path) else _logs_in(path)
        if not members:
            raise InvalidData(
                f"{path.resolve().name}: a folder without logs; read are folders of a ROS bag, of "
                f"a LeRobot dataset ({INFO}), or of files that end in {', '.join(_OPENERS)}"
            )
        names = [each.resolve().name for each in members]
        for each in members:
            own = each.resolve()
            key = name if named else own.name
            if names.count(key) > 1 or (key in found and found[key].resolve() != own and not named):
                key = f"{own.parent.name}/{own.name}"
            if key in found:
                raise InvalidSetting(
                    f"two sources are called {key!r}; give one as NAME=PATH, where NAME is the "
                    "mapping's source or file"
                )
            found[key] = each
    return found


def _logs_in(folder: Path) -> list[Path]:
    """Logs of a folder and, where it has none itself, of the folders in it."""
    members = sorted(folder.iterdir(), key=lambda p: natural(p.name))
    logs = [p for p in members if p.is_dir() and _folder_opener(p)]
    logs += [
        p
        for p in members
        if p.is_file()
        and p.suffix.lower() in _OPENERS
        and not p.stem.lower().startswith(_NOT_LOGS)
        and not (p.suffix == ".json" and any(q.suffix in (".csv", ".parquet") for q in members))
    ]
    if logs:
        return logs
    return [log for p in members if p.is_dir() for log in _logs_in(p)]


def files_of_runs(mapping: ImportMapping, given: Given) -> list[dict[str, Path]]:
    """Find, for each run, the file of each of its sources.

    Only files of the command line are ever read; a mapping chooses among them by name.
    """
    unused = set(given)
    found = []
    for run in mapping.runs:
        files = {}
        for name in dict.fromkeys(column.source for column in run.columns):
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
    unused -= {call for call in unused if call in mapping.unused}
    if unused:
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
        advice = _ADVICE.get(ending, f"read are {', '.join(_OPENERS)}")
        raise InvalidData(
            f"{path.name}: {ending or 'a file without an ending'} is not read; {advice}"
        )
    return opener(path, path.resolve().name)


def read_source(
    log: Log, entry: SourceEntry, keys: Sequence[ChannelKey], episode: str = ""
) -> dict[ChannelKey, Samples]:
    """Read channels of a source, with its clock as the mapping corrects it."""
    tables = log.tables(episode, keys)
    found = {
        key: samples_of(found_in(tables, key, log.name), key.channel, entry.time_of(key.topic))
        for key in keys
    }
    earliest = min((s.origin_ns + round(s.time[0] * 1e9) for s in found.values()), default=0)
    return {k: _corrected(s, entry.time_of(k.topic), earliest) for k, s in found.items()}


def run_episodes(run: RunPlan, logs: Mapping[str, Log]) -> list[str]:
    """Names of the episodes that a run stands for; none where no source has episodes."""
    found: list[str] = []
    owner = ""
    for name, log in logs.items():
        if not log.episodes:
            continue
        own = chosen_episodes(run.episodes, log.episodes, f"{run.place}.episodes ({log.name})")
        if owner and own != found:
            raise InvalidData(
                f"{run.place}: sources {owner!r} and {name!r} have episodes of different names; "
                "make a run of each"
            )
        found, owner = own, name
    return found


def chosen_episodes(text: str, there: Sequence[str], place: str) -> list[str]:
    """Names of the episodes that a text chooses, in its order.

    Examples
    --------
    >>> chosen_episodes("0, 2-3", ["demo_0", "demo_1", "demo_2", "demo_3"], "here")
    ['demo_0', 'demo_2', 'demo_3']
    """
    if text.strip() == "all":
        return list(there)
    some = ", ".join(there) if len(there) < 6 else f"{len(there)}, from {there[0]} to {there[-1]}"
    numbers = {int(m.group(1)): name for name in there if (m := _LAST_NUMBER.search(name))}
    found: dict[str, None] = {}
    for part in filter(None, (each.strip() for each in text.split(","))):
        span = _RANGE.fullmatch(part)
        if part in there:
            found[part] = None
        elif span is not None:
            low, high = int(span.group(1)), int(span.group(2) or span.group(1))
            own = [i for i in sorted(numbers) if low <= i <= high]
            if len(own) != high - low + 1:
                missing = next(iter({low, high} - set(own)), low)
                raise InvalidData(f"{place}: there is no episode {missing}; there are {some}")
            found |= dict.fromkeys(numbers[i] for i in own)
        else:
            raise InvalidData(
                f"{place}: {part[:60]!r} is no episode; there are {some}; write 'all', or "
                f"numbers and ranges such as '0, 3-5'{nearest(part[:60], there)}"
            )
    if not found:
        raise InvalidData(f"{place}: {text[:60]!r} chooses no episode; 'all' takes each")
    return list(found)


def _called(told: str, name: str, file: str, given: Given) -> str | None:
    """Key of a source's file on the command line: by the run, its own name, or its file's."""
    if told:
        return told if told in given else None
    stems = [call for call, path in given.items() if call == path.name and path.stem == name]
    return next((call for call in (name, file, *stems[:1]) if call in given), None)


def _corrected(samples: Samples, time: TimeSource, earliest_ns: int) -> Samples:
    at, origin = samples.time, samples.origin_ns
    if time.from_start:
        at, origin = at - (earliest_ns - origin) * 1e-9, 0
    # Whole nanoseconds: an offset of years would cost the stamps their microseconds.
    return replace(samples, time=at, origin_ns=origin + round(time.offset_s * 1e9))
