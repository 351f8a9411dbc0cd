"""Studies: cases worked out one by one, stored with their configuration, shown as tables."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from loose_agents.execution.backends import BackendSettings
from loose_agents.execution.command import add_options, new_parser, option, options_of
from loose_agents.execution.progress import ProgressLine
from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.execution.shards import map_shards

import loose_env
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.io import restored, write_text
from loose_env.report import read_study, rounded, stored_rows, study_head, write_study

__all__ = ["ClusterRun", "Row", "Study", "StudyRun", "write_between"]

S = TypeVar("S")
O = TypeVar("O", bound="StudyRun")  # noqa: E741
Row = dict[str, Any]

MARKS = ("<!-- {}: begin -->", "<!-- {}: end -->")
"""Lines of a page between which generated text of a name goes."""


@dataclass(frozen=True, kw_only=True)
class StudyRun:
    """Run of the study; no row depends on it."""

    out: Path | None = option(
        None, "folder, or picture beside which the rows lie; default: docs/figures, quick: out"
    )
    quick: bool = option(False, "a rough look with few cases")
    afresh: bool = option(False, "work out again what is stored")
    show: str | None = option(
        None, "print what is stored, here or in a file; a file is drawn where --out is given",
        nargs="?", const="", metavar="FILE",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ClusterRun(StudyRun, BackendSettings):
    """Run of a study whose cases are worked out side by side; no row depends on it."""


@dataclass(frozen=True, kw_only=True)
class Study(Generic[S, O]):
    """A study: its settings, its cases, the work on one of them, and what it shows.

    The command line comes from the fields of the settings and of the run. Rows are written after
    every case, with the settings and the versions that they rest on; the same command goes on
    where it was stopped.

    Parameters
    ----------
    script : str
        Path of the script, two folders below the root of the repository.
    about : str
        Text of the help.
    settings : type
        Frozen dataclass of all that the rows depend on; all fields have defaults.
    cases : callable
        Gives the cases of some settings, hashable and in order.
    work : callable
        Gives the rows of one case, from the case and, by keyword, ``settings``, ``run`` and
        ``say``, which shows how the work stands. At the top of a module where cases run side by
        side.
    case_of : callable
        Case to which a row belongs.
    show : callable
        Prints the rows, from rows, settings, the path of the rows, and the run.
    run : type
        `StudyRun`, or a dataclass with more options; of `ClusterRun` for work side by side.
    quick : mapping
        Settings of a quick run.
    file : str or callable
        File of the rows, or what gives it for some settings; the script's name by default.
    folder : str
        Folder of the rows, from the root.
    unit : str
        What the cases are called.
    head : callable, optional
        What rows rest on by name: ``settings`` and more; the settings alone by default.
    adapt : callable, optional
        Settings changed by options of the run.
    order : callable, optional
        Key by which stored rows are sorted; the order of the cases by default.
    draw : callable, optional
        Draws the rows, from rows, settings and the path of the picture.
    digits : int
        Significant digits of the rows.
    """

    script: str
    about: str | None
    settings: type[S]
    cases: Callable[[S, O], Sequence[Any]]
    work: Callable[..., Sequence[Row]]
    case_of: Callable[[Row], Any]
    show: Callable[[list[Row], S, Path, O], None]
    run: type[O]
    quick: Mapping[str, Any] = field(default_factory=dict)
    file: str | Callable[[S], str] = ""
    folder: str = "docs/figures"
    unit: str = "cases"
    head: Callable[[S], Mapping[str, Any]] | None = None
    adapt: Callable[[S, O], S] | None = None
    order: Callable[[Row], Any] | None = None
    draw: Callable[[list[Row], S, Path], None] | None = None
    digits: int = 4

    @property
    def root(self) -> Path:
        """Folder of the repository."""
        return Path(self.script).resolve().parents[2]

    @property
    def name(self) -> str:
        """Name of the script."""
        return Path(self.script).stem

    def main(self, arguments: Sequence[str] | None = None) -> None:
        """Read the command line, work out what is missing, and show all rows."""
        with errors_in_one_line(self.name, interrupted="the same command goes on"):
            parser = new_parser(self.about)
            add_options(parser, self.settings)
            add_options(parser, self.run)
            given = parser.parse_args(arguments)
            run = options_of(self.run, given)
            settings = options_of(self.settings, given, self.quick if run.quick else None)
            if self.adapt is not None:
                settings = self.adapt(settings, run)
            path = self.path(settings, run)
            if run.show is None:
                rows = self.rows(path, settings, run)
            else:
                path = Path(run.show or path)
                rows, settings = self.stored(path)
            self.show(rows, settings, path, run)
            if self.draw is not None and not (run.show and run.out is None):
                picture = (self.path(settings, run) if run.show else path).with_suffix(".png")
                picture.parent.mkdir(parents=True, exist_ok=True)
                self.draw(rows, settings, picture)
                print(f"picture: {picture}", file=sys.stderr)
            print(f"rows: {path}", file=sys.stderr)

    def path(self, settings: S, run: O) -> Path:
        """File of the rows of a run."""
        if run.out is not None and run.out.suffix == ".png":
            return run.out.with_suffix(".json")
        folder = run.out or self.root / ("out" if run.quick else self.folder)
        file = self.file if isinstance(self.file, str) else self.file(settings)
        return folder / (file or f"{self.name}.json")

    def stored(self, path: Path) -> tuple[list[Row], S]:
        """Rows of a file, and the settings that made them.

        Raises
        ------
        InvalidData
            If there are none, or the file is none of a study.
        """
        if not path.is_file():
            raise InvalidData(f"no rows at {path}: run the study without --show first")
        whole = read_study(path)
        if not isinstance(own := whole.get("settings"), dict):
            raise InvalidData(f"{path} lacks the settings of its rows; give the file of a study")
        settings = restored(self.settings, {**whole, **own}, path.name)
        return whole["rows"], settings

    def rows(self, path: Path, settings: S, run: O) -> list[Row]:
        """Rows of all cases: those stored, and the missing ones, stored as they come."""
        parts = {"settings": settings} if self.head is None else dict(self.head(settings))
        script = Path(self.script).resolve().relative_to(self.root).as_posix()
        head = study_head(script, version=loose_env.__version__, **parts)
        rows = [] if run.afresh else stored_rows(path, head)
        places = {case: k for k, case in enumerate(self.cases(settings, run))}
        done = set(map(self.case_of, rows))
        missing = [case for case in places if case not in done]

        def place(row: Row) -> Any:
            return places.get(self.case_of(row), len(places))

        path.parent.mkdir(parents=True, exist_ok=True)
        with (
            ProgressLine(len(places), done=len(places) - len(missing), unit=self.unit) as line,
            closing(self._results(missing, settings, run, line.say)) as results,
        ):
            for case, found in results:
                rows = sorted([*rows, *rounded(list(found), self.digits)], key=self.order or place)
                write_study(path, head, rows, digits=self.digits)
                line.advance(1, _words(case))
        return [row for row in rows if self.case_of(row) in places]

    def _results(
        self, cases: Sequence[Any], settings: S, run: O, say: Callable[[str], None]
    ) -> Generator[tuple[Any, Sequence[Row]], None, None]:
        if isinstance(run, BackendSettings):
            work = partial(self.work, settings=settings, run=run, say=_nothing)
            for position, found in map_shards(work, cases, settings=run):
                yield cases[position], found
            return
        for case in cases:
            say(_words(case))
            yield case, self.work(case, settings=settings, run=run, say=say)


def write_between(page: Path, text: str, *, name: str = "tables", new: str | None = None) -> None:
    """Put tables between their marks on a page.

    Parameters
    ----------
    page : Path
        The page.
    text : str
        The tables.
    name : str
        Name in the marks.
    new : str, optional
        Content of a page that does not exist yet.

    Raises
    ------
    InvalidSetting
        If there is no page, or it lacks the marks.
    """
    if new is None and not page.is_file():
        raise InvalidSetting(f"{page} does not exist; name a page that has marks for tables")
    old = new if new is not None and not page.exists() else page.read_text(encoding="utf-8")
    first, last = (mark.format(name) for mark in MARKS)
    before, begin, rest = old.partition(first)
    _, end, after = rest.partition(last)
    if not (begin and end):
        raise InvalidSetting(
            f"{page} lacks the lines {first!r} and {last!r}, between which tables go"
        )
    write_text(page, f"{before}{first}\n\n{text}\n\n{last}{after}")


def _words(case: Any) -> str:
    parts = case if isinstance(case, tuple) else (case,)
    return " ".join(f"{part:g}" if isinstance(part, float) else str(part) for part in parts)


def _nothing(words: str) -> None:
    """Say nothing, in a worker."""
