"""A folder for what a command writes; nobody's other files are touched."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from loose_env.errors import InvalidSetting

__all__ = ["OutputFolder"]

_KEPT = ".gap"
_LIST = "written.json"
_OWN = frozenset({_KEPT, "model.xml", "result.json", "report.html"})


class OutputFolder:
    """A new folder, an empty one, or one that an earlier run wrote and nothing else lies in.

    Parameters
    ----------
    path : Path
        The folder.

    Raises
    ------
    InvalidSetting
        If it is a file or holds other files.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        if self.path.exists() and not self.path.is_dir():
            raise InvalidSetting(f"--out {path} is a file; give a folder")
        there = sorted(p.name for p in self.path.iterdir()) if self.path.is_dir() else []
        known = _OWN | self._written() if _KEPT in there else frozenset()
        other = [name for name in there if name not in known and not _half_written(name)]
        if other:
            raise InvalidSetting(
                f"--out {path} holds other files ({', '.join(other[:3])}"
                f"{', ...' if len(other) > 3 else ''}); give a new or empty folder, or that of an "
                "earlier run"
            )

    def prepared(self) -> Path:
        """Make the folder, and return the one inside it for what is kept between runs."""
        kept = self.path / _KEPT
        kept.mkdir(parents=True, exist_ok=True)
        return kept

    def note(self, written: Iterable[Path]) -> None:
        """Note what was written, so that a later run knows it as its own."""
        inside = (path.relative_to(self.path) for path in written)
        names = sorted({path.parts[0] for path in inside} | self._written())
        self.prepared().joinpath(_LIST).write_text(json.dumps(names) + "\n", encoding="utf-8")

    def _written(self) -> frozenset[str]:
        try:
            names = json.loads(self.path.joinpath(_KEPT, _LIST).read_text("utf-8"))
        except (OSError, ValueError):
            return frozenset()
        return frozenset(str(name) for name in names) if isinstance(names, list) else frozenset()


def _half_written(name: str) -> bool:
    """Whether a file was left by a run cut short while it wrote."""
    return name.startswith(".") and ".part" in name
