"""`diagnose` and `explain_gap`: the commands in Python, with reports that a notebook shows.

    import loose_env
    found = loose_env.diagnose("session/recording")
    found  # headline, table, next steps; a notebook draws them

Both take the folder of a recording or a `loose_env.recording.Recording`, and the options of the
command as keywords. Nothing is written until `write` is called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from loose_env import gap, instrument, report
from loose_env.doctor import Finding, examine
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.gap import GapResult, GapSettings, GapSolution
from loose_env.instrument import DiagnoseSettings, Diagnosis, Place
from loose_env.io import nearest
from loose_env.recording import ModelColumns, Recording, read_recording, table_of

__all__ = ["DiagnosisReport", "GapReport", "diagnose", "explain_gap"]

Say = Callable[[str], None]
Result = TypeVar("Result", Diagnosis, GapResult)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Report(Generic[Result]):
    """Result with the recording that it is of."""

    result: Result
    """All that was found: content of ``result.json``."""
    recording: Recording
    """The runs, and the model that they were compared with."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DiagnosisReport(_Report[Diagnosis]):
    """Diagnosis of an arm, shown as a headline, a table and what to do."""

    @property
    def headline(self) -> str:
        """Outcome in one sentence."""
        return self.result.headline

    @property
    def places(self) -> tuple[Place, ...]:
        """Verdict of every link's seat and every joint's gear, the most suspect first."""
        return self.result.places

    @property
    def warnings(self) -> tuple[str, ...]:
        """What limits the result."""
        return self.result.remarks

    def write(self, folder: str | Path, *, say: Say = print) -> list[Path]:
        """Write ``report.html`` and ``result.json``, as `loose diagnose` does.

        Parameters
        ----------
        folder : str or Path
            Where they go; made where there is none.
        say : callable
            Receives the reason where the page cannot be drawn.

        Returns
        -------
        list of Path
            The files written.

        Raises
        ------
        InvalidSetting
            If the folder is a file, or the recording itself.
        """
        place = _target(folder, self.recording)
        name = self.recording.folder.name
        model = self.recording.model_path
        given = str(self.recording.folder)
        return report.write_diagnosis(
            place, self.result, model, recording=name, given=given, say=say
        )

    def __repr__(self) -> str:
        """Headline, table, next steps and warnings."""
        return report.diagnosis_text(self.result, folder=str(self.recording.folder))

    def _repr_html_(self) -> str:
        """Return the same in HTML, as notebooks show it."""
        return report.diagnosis_html(self.result)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GapReport(_Report[GapResult]):
    """Effects that a model lacks, shown as a headline and tables of parameters and residual."""

    solution: GapSolution
    """The finished comparison, from which `write` makes model and report."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings that limit the validity."""
        return tuple(self.result.warnings)

    @property
    def headline(self) -> str:
        """Outcome in one sentence."""
        return report.gap_headline(self.result)

    @property
    def effects(self) -> tuple[gap.NamedEffect, ...]:
        """Effects that the model lacks, with their parameters and intervals."""
        return self.result.effects

    def write(self, folder: str | Path, *, say: Say = print) -> list[Path]:
        """Write ``model.xml``, ``report.html`` and ``result.json``, as `loose gap` does.

        Parameters
        ----------
        folder : str or Path
            Where they go; made where there is none.
        say : callable
            Receives what is being written, and the reason where the page cannot be drawn.

        Returns
        -------
        list of Path
            The files written, those that the corrected model needs included.

        Raises
        ------
        InvalidSetting
            If the folder is a file, or holds the recording or its model.
        InvalidData
            If the corrected model does not compile.
        """
        place = _target(folder, self.recording)
        page = partial(report.write_gap_report, say=say)
        return gap.write_gap(place, self.solution, report=page, say=say)

    def __repr__(self) -> str:
        """Headline, parameters, residual and warnings."""
        return report.gap_text(self.result)

    def _repr_html_(self) -> str:
        """Return the same in HTML, as notebooks show it."""
        return report.gap_html(self.result)


def diagnose(
    recording: str | Path | Recording,
    *,
    model: str | Path | None = None,
    ignore_doctor: bool = False,
    say: Say = lambda _: None,
    **settings: Any,
) -> DiagnosisReport:
    """Say what is loose in an arm, as `loose diagnose` does.

    Parameters
    ----------
    recording : str, Path or Recording
        Folder of the recording, or the recording.
    model : str or Path, optional
        MJCF file that takes the place of the recording's model.
    ignore_doctor : bool
        True to go on although the preflight finds errors in the recording.
    say : callable
        Receives warnings of the preflight and progress, line by line; ``print`` shows them.
    **settings
        Fields of `loose_env.instrument.DiagnoseSettings`, such as ``reference=False``.

    Returns
    -------
    DiagnosisReport

    Raises
    ------
    UnknownName
        If a setting does not exist.
    InvalidSetting
        If a setting is out of range, or ``model`` is no file.
    InvalidData
        If the recording or the model cannot be used, or the preflight finds errors.

    Examples
    --------
    >>> import loose_env
    >>> found = loose_env.diagnose("session/recording")  # doctest: +SKIP
    >>> found.headline  # doctest: +SKIP
    'The seat of link forearm is loose.'

    What cannot be used is said in one line:

    >>> loose_env.diagnose("no/recording")
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidData: there is no folder 'no/recording'; a recording is a folder...
    """
    chosen = DiagnoseSettings(**_checked(DiagnoseSettings, settings))
    read = _recording(recording, model)
    preflight = _check_first(read, ignore_doctor, say)
    result = instrument.diagnose(read, chosen, say=say)
    return DiagnosisReport(result=replace(result, preflight=preflight), recording=read)


def explain_gap(
    recording: str | Path | Recording,
    *,
    model: str | Path | None = None,
    ignore_doctor: bool = False,
    say: Say = lambda _: None,
    **settings: Any,
) -> GapReport:
    """Name what a simulation model lacks, as `loose gap` does.

    Parameters
    ----------
    recording : str, Path or Recording
        Folder of the recording, or the recording.
    model : str or Path, optional
        MJCF file that takes the place of the recording's model.
    ignore_doctor : bool
        True to go on although the preflight finds errors in the recording.
    say : callable
        Receives warnings of the preflight and progress, line by line; ``print`` shows them.
    **settings
        Fields of `loose_env.gap.GapSettings`, such as ``kinds=("coulomb_friction",)``.

    Returns
    -------
    GapReport

    Raises
    ------
    UnknownName
        If a setting does not exist.
    InvalidSetting
        If a setting is out of range, or ``model`` is no file.
    InvalidData
        If the recording or the model cannot be used, or the preflight finds errors.

    Examples
    --------
    >>> import loose_env
    >>> found = loose_env.explain_gap("recordings/arm")  # doctest: +SKIP
    >>> found.headline  # doctest: +SKIP
    'The model lacks dry friction (joint2).'

    A setting that does not exist is refused before anything is read:

    >>> loose_env.explain_gap("recordings/arm", tolerence=0.05)
    Traceback (most recent call last):
        ...
    loose_env.errors.UnknownName: there is no setting 'tolerence'; did you mean 'tolerances'? ...
    """
    chosen = GapSettings(**_checked(GapSettings, settings))
    read = _recording(recording, model)
    preflight = _check_first(read, ignore_doctor, say)
    solution = gap.solve_gap(read, chosen, preflight=preflight, say=say)
    return GapReport(result=solution.result, solution=solution, recording=read)


def _check_first(recording: Recording, ignore_errors: bool, say: Say) -> tuple[Finding, ...]:
    """Findings of `loose doctor` in a recording, which is refused if there are errors."""
    report = examine(recording)
    for line in report.lines(least="warning"):
        say(line)
    if not ignore_errors:
        first = f"such as {report.errors[0].found!r}" if report.errors else ""
        listed = f"{first}; loose_env.doctor.examine lists them"
        report.refuse_errors(listed=listed, remedy="ignore_doctor=True")
    return report.findings


def _recording(given: str | Path | Recording, model: str | Path | None) -> Recording:
    """Recording of a folder, or the one given; with another model where one is given."""
    if not isinstance(given, Recording):
        return read_recording(given, model=model)
    if model is None:
        return given
    path = Path(model)
    if not path.is_file():
        raise InvalidSetting(f"there is no model {str(model)!r}; give an MJCF file")
    found = replace(given, model_path=path.resolve())
    allowed = ModelColumns.of(found.model())
    for run in found.runs:
        allowed.check_header(run.name, list(table_of(run)))
    return found


def _checked(kind: type, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with tuples in the place of lists; those that make no sense are refused."""
    known = [each.name for each in fields(kind)]
    for name in settings:
        if name not in known:
            meant = nearest(name, known) or "."
            raise UnknownName(
                f"there is no setting {name!r}{meant} The settings are {', '.join(known)}"
            )
    found = {n: tuple(v) if isinstance(v, list) else v for n, v in settings.items()}
    kind(**found)
    return found


def _target(folder: str | Path, recording: Recording) -> Path:
    """Folder to write to, which must not be that of the recording or of its model."""
    place = Path(folder).resolve()
    if place.exists() and not place.is_dir():
        raise InvalidSetting(f"{folder} is a file; give a folder")
    if place in (recording.folder, recording.model_path.parent):
        raise InvalidSetting(
            f"{folder} holds the recording or its model, which would be overwritten; give another "
            "folder"
        )
    return place
