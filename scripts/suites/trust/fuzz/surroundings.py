"""A folder with what must not be touched: files outside, links to them, a pipe."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from scripts.suites.trust.fuzz.documents import tetrahedron
from scripts.suites.trust.fuzz.hostile import SECRET

__all__ = ["Surroundings"]

_INCLUDE = f'<mujocoinclude><worldbody><body name="{SECRET}"/></worldbody></mujocoinclude>'


class Surroundings:
    """Folders of an attempt below a root.

    ``case`` is the file or folder that is read, ``secret`` lies outside it, and ``cwd`` is where
    the process stands.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()
        self.case, self.secret, self.cwd = (self.root / n for n in ("case", "secret", "cwd"))
        self.work = self.root / "work"
        for folder in (self.secret, self.cwd, self.work):
            folder.mkdir(parents=True, exist_ok=True)
        self.secret.joinpath("secret.xml").write_text(_INCLUDE)
        self.secret.joinpath("secret.stl").write_bytes(tetrahedron())
        self.secret.joinpath("secret.csv").write_text(f"time,{SECRET}\n0,1\n")

    def fresh(self, files: dict[str, bytes] | None = None) -> Path:
        """Empty the folder of the case, lay links and a pipe into it, and write files."""
        shutil.rmtree(self.case, ignore_errors=True)
        self.case.joinpath("sub").mkdir(parents=True)
        for kind in ("xml", "stl", "csv"):
            for link in (f"link.{kind}", f"sub/link.{kind}"):
                self.case.joinpath(link).symlink_to(self.secret / f"secret.{kind}")
        for kind in ("xml", "stl", "csv"):
            os.mkfifo(self.case / f"pipe.{kind}")
        self.case.joinpath("loop.xml").symlink_to("loop.xml")
        self.case.joinpath("part.xml").write_text(
            '<mujocoinclude><asset><mesh name="m" file="link.stl"/></asset></mujocoinclude>'
        )
        self.case.joinpath("inner.xml").write_text(
            '<mujocoinclude><include file="../secret/secret.xml"/></mujocoinclude>'
        )
        for name, data in (files or {}).items():
            path = self.case / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        return self.case
