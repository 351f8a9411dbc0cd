"""What motions could not show, or tell apart, and what would help: as data and in sentences."""

from __future__ import annotations

from dataclasses import dataclass

from loose_env.gap.durations import duration_words
from loose_env.gap.separating import how_to_see, how_to_separate

__all__ = ["Alike", "Identifiability", "Unseen", "identifiability_words"]

_LISTED = 3
"""Effects, and pairs, that are told of one by one."""


@dataclass(frozen=True, kw_only=True)
class Unseen:
    """An effect that would not be seen at a size that matters."""

    kind: str
    """Identifier of the catalogue."""
    where: str
    """Its place."""
    parameters: dict[str, float]
    """The size."""
    sureness: float
    """What it changes beyond all that can be mistaken for it, in standard deviations; 5 needed."""
    more_s: float | None
    """How much more of the same runs would show it [s]; None where no length would."""


@dataclass(frozen=True, kw_only=True)
class Alike:
    """Two effects that these motions do not tell apart."""

    kind: str
    """Of the first; a named one, if either is."""
    where: str
    """Its place."""
    other_kind: str
    """Of the second."""
    other_where: str
    """Its place."""
    sureness: float
    """What of the first the second cannot take up, in standard deviations; 5 are needed."""
    more_s: float | None
    """How much more of the same runs would tell them apart [s]; None where no length would."""


@dataclass(frozen=True, kw_only=True)
class Identifiability:
    """What these motions can show."""

    unseen: tuple[Unseen, ...] = ()
    """Effects that they do not show."""
    alike: tuple[Alike, ...] = ()
    """Pairs that they do not tell apart, those with a named effect first."""


def identifiability_words(found: Identifiability) -> list[str]:
    """Sentences on what cannot be seen or told apart, how much is missing and what would help."""
    said, by_kind = [], dict[str, list[Unseen]]()
    for each in found.unseen:
        by_kind.setdefault(each.kind, []).append(each)
    for kind, many in list(by_kind.items())[:_LISTED]:
        places = ", ".join(each.where for each in many[:_LISTED])
        places += " and elsewhere" if len(many) > _LISTED else ""
        size = ", ".join(f"{k} {v:.2g}" for k, v in many[0].parameters.items())
        said.append(
            f"these motions would not show {kind} at {places} (such as {size}); "
            f"{_missing(many[0].more_s)}{how_to_see(kind)}"
        )
    for pair in found.alike[:_LISTED]:
        advice = how_to_separate(pair.kind, pair.where, pair.other_kind, pair.other_where)
        said.append(
            f"these motions do not tell {pair.kind} at {pair.where} from {pair.other_kind} at "
            f"{pair.other_where}; {_missing(pair.more_s)}{advice[0].lower()}{advice[1:]}"
        )
    further = [
        f"kinds of effect not shown ({len(by_kind) - _LISTED})" * (len(by_kind) > _LISTED),
        f"pairs that look alike ({len(found.alike) - _LISTED})" * (len(found.alike) > _LISTED),
    ]
    if any(further):
        listed = " and ".join(filter(None, further))
        said.append(f"further {listed} in these motions are listed under identifiability")
    return said


def _missing(seconds: float | None) -> str:
    if seconds is None:
        return "more of the same will not help: "
    return f"record about {duration_words(seconds)} more of them, or better: "
