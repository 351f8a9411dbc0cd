"""Command that checks recordings: ``loose doctor``."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, arg

from loose_env.cli.console import Console, OnRecording, Outcome
from loose_env.doctor import DoctorSettings, Finding, examine, write_corrected
from loose_env.recording import Recording, read_recording


@dataclass(frozen=True, kw_only=True)
class Doctor(OnRecording):
    """Check a recording: units, ranges, signs, sampling, channels, clocks, entries.

    Reads a recording (a folder with recording.json, the nominal model and measured runs), and
    prints all findings at once: errors, which make a result wrong; warnings, which may; notes. Each
    says what was found, with its number and unit, the consequence and the remedy. 'loose diagnose'
    and 'loose gap' run the same checks first and stop at errors; --ignore-doctor goes on. The exit
    code is 1 where there are errors.

        loose doctor session/recording
        loose doctor session/recording --fix session/corrected

    Where a changed unit, sign, order of joints, clock or direction of gravity explains the torques,
    the finding names it with the share of their variance that is left. --fix writes the corrected
    recording beside; nothing is corrected without it.
    """

    fix: Annotated[Path | None, arg(metavar="DIR")] = None
    """Write the recording with the offered corrections of errors and warnings to a new folder; the
    one that is read stays as it is."""
    settings: OmitArgPrefixes[DoctorSettings]
    """Tolerances."""

    def run(self, console: Console) -> Outcome:
        """Check the recording, and correct it where asked to."""
        recording = read_recording(self.recording, model=self.model)
        report = examine(recording, self.settings)
        outcome = Outcome(text=report.text(), json=report.to_json, code=1 if report.errors else 0)
        if self.fix is None:
            return outcome
        found = (*report.errors, *report.warnings)
        fixes = list(dict.fromkeys(each.fix for each in found if each.fix is not None))
        try:
            made = write_corrected(recording, fixes, self.fix)
        except BaseException:
            console.show(outcome)  # the findings are worth their time without the copy, too
            raise
        written = f"written: {made.folder}, with {'; '.join(fix.words for fix in fixes)}"
        return replace(outcome, text=f"{outcome.text}\n{written}")


def check_first(recording: Recording, *, ignore_errors: bool) -> tuple[Finding, ...]:
    """Check a recording that was read, and print errors and warnings on the error stream.

    Returns
    -------
    tuple of Finding
        All findings, for the result.

    Raises
    ------
    InvalidData
        If there are errors, and they are not to be ignored.
    """
    report = examine(recording)
    for line in report.lines(least="warning"):
        print(line, file=sys.stderr)
    if not ignore_errors:
        report.refuse_errors(listed="listed above", remedy="--ignore-doctor")
    return report.findings
