"""Judges an attempt: what it said, what it wrote, what it opened, whether it ran anything."""

from __future__ import annotations

import hashlib
import os
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from loose_env.errors import LooseEnvError
from scripts.suites.trust.fuzz.hostile import SECRET

__all__ = ["BAD", "Attempt", "Verdict", "Watch", "judged", "snapshot"]

BAD = ("crash", "unclear", "wrote", "ran", "leaked", "hung", "died", "slow")
"""Outcomes that must not occur; the others are "refused" and "read"."""
SLOW = 20.0
"""Longest an attempt may take [s of processor time]."""
_RUNS = (
    *("os.system", "subprocess.Popen", "os.exec", "os.spawn", "os.posix_spawn", "os.fork"),
    *("socket.connect", "ctypes.dlopen", "pty.spawn", "webbrowser.open"),
)


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One file, or folder, and what reads it."""

    damage: str
    """What was done to it."""
    read: Callable[[], Any]
    """Reads it."""
    names: Sequence[str]
    """One of these has to stand in the message: the file, or the option."""
    may_write: Path | None = None
    """Folder that it may write to."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What came of an attempt."""

    outcome: str
    """ "refused", "read", or one of `BAD`."""
    words: str = ""
    """The message, or what went wrong."""


@dataclass
class Watch:
    """Notes through Python's audit hooks what is opened and run; it cannot be taken off again."""

    allowed: list[Path] = field(default_factory=list)
    """Folders that may be written to."""
    secret: Path | None = None
    """Folder that may not be opened at all."""
    noted: list[str] = field(default_factory=list)
    """What was done."""
    on: bool = False

    def install(self) -> None:
        """Begin to listen."""
        sys.addaudithook(self._hear)

    def _near(self, name: str) -> bool:
        """Whether a library lies among the files of the attempt."""
        root = None if self.secret is None else self.secret.parent
        return root is not None and Path(os.path.realpath(name)).is_relative_to(root)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event in _RUNS:
            if event == "ctypes.dlopen" and not self._near(str(arguments[0])):
                return  # a library that is installed, loaded by another one
            self.noted.append(f"ran: {event} {str(arguments)[:80]}")
        elif event == "open" and isinstance(arguments[0], str):
            path, flags = Path(os.path.realpath(arguments[0])), arguments[2] or 0
            writes = bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
            if writes and not any(path.is_relative_to(a) for a in self.allowed):
                self.noted.append(f"wrote: {path}")
            if self.secret is not None and path.is_relative_to(self.secret):
                self.noted.append(f"leaked: {path}")


def snapshot(*folders: Path) -> dict[str, str]:
    """Every file below some folders with a hash of what is in it."""
    found = {}
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            if path.is_symlink():
                found[str(path)] = f"-> {os.readlink(path)}"
            elif path.is_file():
                found[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()
            else:
                found[str(path)] = "folder"
    return found


def judged(attempt: Attempt, watch: Watch, around: Callable[[], dict[str, str]]) -> Verdict:
    """Let an attempt read, and say what came of it."""
    before = around()
    watch.noted.clear()
    watch.allowed = [] if attempt.may_write is None else [attempt.may_write]
    start = time.process_time()
    said, outcome = "", "read"
    watch.on = True
    try:
        shown = attempt.read()
    except LooseEnvError as error:
        outcome, said = "refused", str(error)
    except BaseException as error:
        outcome, said = "crash", f"{type(error).__name__}: {str(error)[:300]}"
    else:
        with suppress(Exception):
            if SECRET in repr(shown):
                watch.noted.append("leaked: what was read holds what lies outside")
    finally:
        watch.on = False
    spent = time.process_time() - start
    after = around()
    if after != before:
        changed = sorted(set(after.items()) ^ set(before.items()))
        return Verdict(outcome="wrote", words=f"{changed[:3]}")
    if watch.noted:
        kind, _, words = watch.noted[0].partition(": ")
        return Verdict(outcome=kind, words=words)
    if outcome == "crash":
        return Verdict(outcome=outcome, words=said)
    if outcome == "refused":
        if "\n" in said or len(said) > 2000 or not any(name in said for name in attempt.names):
            return Verdict(outcome="unclear", words=said[:400])
        if SECRET in said:
            return Verdict(outcome="leaked", words=said[:400])
    if spent > SLOW:
        return Verdict(outcome="slow", words=f"{spent:.0f} s {said[:100]}")
    return Verdict(outcome=outcome, words=said[:300])
