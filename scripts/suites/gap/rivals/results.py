"""Result of a rival: its verdict by one rule, and the file of the format ``loose-gap/1``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loose_env.gap import Gap, GapResult, NamedEffect, read_result

__all__ = ["RESULT", "Finding", "VerdictSettings", "write_finding"]

RESULT = "result.json"
"""File of a result."""


@dataclass(frozen=True, kw_only=True)
class VerdictSettings:
    """When a model counts as right, and a list of effects as an explanation."""

    no_gap: float = 1.25
    """Held-out residual up to which nothing is missing [noise sd]: filtering and interpolation
    leave up to a quarter beside the noise."""
    explained: float = 0.5
    """Least share of the held-out mean square above the noise that effects have to explain: less
    than half says that the main cause is another one."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a method came to on one recording."""

    method: str
    """Name of the method."""
    before: float
    """Held-out residual of the nominal model within its tolerance [noise sd]."""
    after: float
    """The same of the model with the effects, or of the predictor [noise sd]."""
    held_out: str
    """File of the held-out run."""
    effects: Sequence[NamedEffect] = ()
    settings: Mapping[str, Any] | None = None
    """What the result depends on besides the recording."""

    @property
    def explained(self) -> float:
        """Share of the held-out mean square above the noise that is gone."""
        above = max(self.before**2 - 1.0, 1e-9)
        return (self.before**2 - self.after**2) / above


def write_finding(
    folder: Path, finding: Finding, settings: VerdictSettings | None = None
) -> GapResult:
    """Write what was found as ``result.json``, read back once, and return it.

    Parameters
    ----------
    folder : Path
        Folder that exists.
    finding : Finding
        What was found.
    settings : VerdictSettings, optional
        Thresholds of the verdict.
    """
    settings = settings or VerdictSettings()
    named = bool(finding.effects) and finding.explained >= settings.explained
    if named:
        verdict = "named"
    elif finding.before > settings.no_gap:
        verdict = "unexplained"
    else:
        verdict = "no_gap"
    result = GapResult(
        verdict=verdict,  # type: ignore[arg-type]
        gap=Gap(before=finding.before, after=finding.after),
        effects=tuple(finding.effects) if named else (),
        doubtful=() if named else tuple(finding.effects),
        held_out_runs=(finding.held_out,),
        model=None,
        settings={"method": finding.method, **(finding.settings or {})},
    )
    return read_result(result.write(folder / RESULT))
