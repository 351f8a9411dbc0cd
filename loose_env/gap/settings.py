"""Settings of `loose gap`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Ge, Le

from loose_env.gap.core.tolerances import Tolerances
from loose_env.io import Rule, check_fields


@dataclass(frozen=True, kw_only=True)
class GapSettings:
    """Settings of the comparison of a recording with its model.

    Examples
    --------
    >>> GapSettings(threads=-1)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: GapSettings.threads must be a whole number, 0 to 10000; got -1
    """

    kinds: tuple[str, ...] = ()
    """Kinds of effect that are considered, such as coulomb_friction; by default the whole
    catalogue."""
    held_out: tuple[str, ...] = ()
    """Runs kept out of everything and predicted at the end: their files, or the beginning of their
    names. By default every run is held out once, in turn."""
    simulate: bool = True
    """Whether full simulation decides among the leading sets of effects, where there are
    commands; without it the force balance alone decides, in a fraction of the time."""
    threads: Annotated[int, Rule("a whole number, 0 to 10000", (Ge(0), Le(10_000)))] = 0
    """Threads of the simulation; 0 for all processors."""
    tolerances: Tolerances = field(default_factory=Tolerances)
    """Standard deviations of what the nominal model states."""

    def __post_init__(self) -> None:
        """Check the values."""
        check_fields(self, GapSettings)  # a command line has more
