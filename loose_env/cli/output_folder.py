"""A folder for what a command writes; nobody's other files are touched.

Commands write files of the same names, so the folder notes whose they are.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from loose_env.errors import InvalidSetting, LooseEnvError

KEPT = ".gap"
"""Folder in an output for what is kept between runs."""
_LIST, _WHOSE = "written.json", "command"
_FORMATS = {"loose-gap": "gap", "loose-diagnosis": "diagnose"}
"""Whose a result is, by its format: folders of earlier versions note nothing."""
_OWN = frozenset({KEPT, "model.xml", "result.json", "report.html"})


class OutputFolder:
    """A new folder, an empty one, or one that an earlier run wrote and nothing else lies in.

    Parameters
    ----------
    path : Path
        The folder.
    command : str
        The command of ``loose`` that writes.

    Raises
    ------
    InvalidSetting
        If it is a file, or holds other files or what another command wrote.
    """

    def __init__(self, path: Path, command: str) -> None:
        self.path, self.command = path.resolve(), command
        if self.path.exists() and not self.path.is_dir():
            raise InvalidSetting(f"--out {path} is a file; give a folder")
        there = sorted(p.name for p in self.path.iterdir()) if self.path.is_dir() else []
        known = _OWN | self._written() if KEPT in there else frozenset()
        other = [name for name in there if name not in known and not _half_written(name)]
        if other:
            raise InvalidSetting(
                f"--out {path} holds other files ({', '.join(other[:3])}"
                f"{', ...' if len(other) > 3 else ''}); give a new or empty folder, or that of an "
                "earlier run"
            )
        whose = self._whose() if there else command
        if whose not in (command, ""):
            raise InvalidSetting(
                f"--out {path} holds what 'loose {whose}' wrote, and 'loose {command}' would "
                "overwrite it; give another folder"
            )

    def prepared(self) -> Path:
        """Make the folder, and return the one inside it for what is kept between runs."""
        kept = self.path / KEPT
        kept.mkdir(parents=True, exist_ok=True)
        kept.joinpath(_WHOSE).write_text(self.command, encoding="utf-8")
        return kept

    @contextmanager
    def worked_in(self) -> Iterator[Path]:
        """Work with the folder prepared; what a user's mistake leaves empty is removed again."""
        before = self.path.exists()
        kept = self.prepared()
        try:
            yield kept
        except LooseEnvError:
            if not any(p.is_file() and p.name != _WHOSE for p in self.path.rglob("*")):
                shutil.rmtree(kept)
                if not before:
                    self.path.rmdir()
            raise

    def note(self, written: Iterable[Path]) -> None:
        """Note what was written, so that a later run knows it as its own."""
        inside = (path.relative_to(self.path) for path in written)
        names = sorted({path.parts[0] for path in inside} | self._written())
        self.prepared().joinpath(_LIST).write_text(json.dumps(names) + "\n", encoding="utf-8")

    def _written(self) -> frozenset[str]:
        try:
            names = json.loads(self.path.joinpath(KEPT, _LIST).read_text("utf-8"))
        except (OSError, ValueError):
            return frozenset()
        return frozenset(str(name) for name in names) if isinstance(names, list) else frozenset()

    def _whose(self) -> str:
        """Command that wrote here before; "" if that is not known."""
        try:
            return self.path.joinpath(KEPT, _WHOSE).read_text("utf-8").strip()
        except (OSError, ValueError):
            pass
        try:
            whole = json.loads(self.path.joinpath("result.json").read_text("utf-8"))
        except (OSError, ValueError, RecursionError):
            return ""
        kind = str(whole.get("format", "")) if isinstance(whole, dict) else ""
        return _FORMATS.get(kind.partition("/")[0], "")


def _half_written(name: str) -> bool:
    """True if a file was left by an interrupted write."""
    return name.startswith(".") and ".part" in name
