"""Kills a command at chosen moments, lets it go on, and looks at what it left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

__all__ = ["Command", "Killed", "kill_often", "run_whole"]

ROOT = Path(__file__).resolve().parents[4]
POLL = 0.004
"""Time between two looks at the folder [s]."""
LONGEST = 900.0
"""Longest that a run may take [s]."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command that writes to a folder and goes on when it is run again."""

    name: str
    words: Callable[[Path], Sequence[str]]
    """Words after ``python``, for an output folder."""
    problems: Callable[[Path], list[str]]
    """What is wrong with what lies in the folder now, whatever moment it is."""
    result: Callable[[Path], Any]
    """What the finished command wrote, to be compared with another run's."""


@dataclass
class Killed:
    """What came of killing a command."""

    command: str
    events: int = 0
    """Changes of the folder in a run that is let through."""
    kills: int = 0
    runs: int = 0
    """Runs that ended by themselves."""
    moments: list[int] = field(default_factory=list)
    """Changes of the folder that each kill waited for."""
    after_write: int = 0
    """Kills before which the run had changed its folder."""
    problems: list[str] = field(default_factory=list)
    """Everything that was wrong."""
    equal: int = 0
    """Finished runs whose result is that of the run that was let through."""


def run_whole(command: Command, out: Path) -> list[float]:
    """Let it through; return the time to each change of its folder, and to its end [s]."""
    process = _started(command, out)
    begin, before = time.monotonic(), _listing(out)
    times = [begin]
    while process.poll() is None:
        now = _listing(out)
        if now != before:
            times.append(time.monotonic())
        before = now
        if time.monotonic() - begin > LONGEST:
            _end(process)
            raise TimeoutError(f"{command.name}: not done after {LONGEST:g} s")
        time.sleep(POLL)
    if process.returncode:
        raise RuntimeError(f"{command.name} failed: {_said(process, out)}")
    return np.diff([*times, time.monotonic()]).tolist()  # type: ignore[no-any-return]


def kill_often(
    command: Command,
    place: Path,
    *,
    kills: int,
    rng: np.random.Generator,
    say: Callable[[str], None] = lambda _: None,
) -> Killed:
    """Kill a command, again and again, until it was killed so often; then let the last one through.

    It runs in one folder until it is done, then in a new one. A moment is a number of changes of
    the folder since the run began, from none to all, and a share of the time that the run that
    was let through took from there to the next change: so kills fall as often between the writes
    of a command that writes at its end as into the work before.

    Parameters
    ----------
    command : Command
        What is killed.
    place : Path
        Folder for the output folders.
    kills : int
        How often.
    rng : Generator
        Draws the moments.
    say : callable
        Told what goes on.
    """
    found = Killed(command=command.name)
    pauses = run_whole(command, place / "whole")
    found.events = len(pauses) - 1
    wanted = command.result(place / "whole")
    found.problems += [f"unkilled: {p}" for p in command.problems(place / "whole")]
    chain = 0
    while True:
        out = place / f"chain-{chain}"
        moment = int(rng.integers(len(pauses)))
        delay = float(rng.random()) * pauses[moment]
        before = _listing(out)
        if found.kills < kills and _killed(command, out, moment, delay):
            found.kills += 1
            found.after_write += _listing(out) != before
            found.moments.append(moment)
            found.problems += [f"kill {found.kills}: {p}" for p in command.problems(out)]
            say(f"{command.name}: killed {found.kills} of {kills}, after {moment} changes")
            continue
        if found.kills >= kills:
            run_whole(command, out)
        found.runs += 1
        found.problems += [f"end of chain {chain}: {p}" for p in command.problems(out)]
        same = _same(command.result(out), wanted)
        found.equal += same
        if not same:
            found.problems.append(f"end of chain {chain}: another result than the unkilled run")
        chain += 1
        if found.kills >= kills:
            return found


def _killed(command: Command, out: Path, moment: int, delay: float) -> bool:
    """Run a command and kill it; False if it was done before."""
    process = _started(command, out)
    begin, changes, before = time.monotonic(), 0, _listing(out)
    while process.poll() is None and changes < moment:
        now = _listing(out)
        changes, before = changes + (now != before), now
        if time.monotonic() - begin > LONGEST:
            _end(process)
            raise TimeoutError(f"{command.name}: not done after {LONGEST:g} s")
        time.sleep(POLL)
    if process.poll() is None:
        time.sleep(delay)
    _end(process)
    if process.returncode == -signal.SIGKILL:
        return True
    if process.returncode:
        raise RuntimeError(f"{command.name} does not go on: {_said(process, out)}")
    return False


def _started(command: Command, out: Path) -> subprocess.Popen[bytes]:
    out.parent.mkdir(parents=True, exist_ok=True)
    with _words(out).open("wb") as said:
        return _popen([sys.executable, *command.words(out)], said)


def _popen(words: list[str], said: BinaryIO) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        words,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=said,
        start_new_session=True,
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill it with all that it started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _said(process: subprocess.Popen[bytes], out: Path) -> str:
    return f"code {process.returncode}: {_words(out).read_text(errors='replace')[-600:]}"


def _words(out: Path) -> Path:
    """What a command said on its error stream; a pipe that nobody reads would stop it."""
    return out.with_name(f"{out.name}.said")


def _listing(folder: Path) -> frozenset[tuple[str, int, int, int]]:
    """Files with what changes when they are written anew or in place."""
    found = set()
    for root, _, names in os.walk(folder):
        for name in names:
            try:
                state = os.stat(os.path.join(root, name))
            except OSError:  # renamed while it was looked at
                continue
            found.add((os.path.join(root, name), state.st_ino, state.st_size, state.st_mtime_ns))
    return frozenset(found)


def _same(one: Any, other: Any) -> bool:
    return repr(one) == repr(other)
