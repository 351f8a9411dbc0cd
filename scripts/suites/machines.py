"""Command of the blind diagnosis suite on rich machines; finished cases are kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from loose_env.cli.command import command
from scripts.suites.diagnosis.__main__ import SuiteSettings, run


@dataclass(frozen=True, kw_only=True)
class MachinesSettings(SuiteSettings):
    """Which cases, and how large."""

    cases: int = 100
    """Number of cases."""
    seed: int = 81_207
    """Seed of the draw; nothing was developed on this one. Development used the seed 1."""
    runs: int = 6
    """Suspect runs of a recording."""
    form: Literal["machines"] = "machines"
    """Machines richer than the model."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command(
        "machines", __doc__, MachinesSettings, run, arguments, interrupted="finished cases are kept"
    )


if __name__ == "__main__":
    main()
