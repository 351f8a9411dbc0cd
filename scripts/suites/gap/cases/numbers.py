"""Numbers of cases: from the words of a command line, and in the order of a run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from loose_env.errors import InvalidSetting
from scripts.suites.gap.cases.cases import LAST, role_of

__all__ = ["mixed", "numbers_of"]


def numbers_of(words: Iterable[str]) -> list[int]:
    """Numbers of cases from words such as ``7`` and ``1000-1003``.

    Raises
    ------
    InvalidSetting
        If a word is neither, or a number lies outside 0 to 3999.

    Examples
    --------
    >>> numbers_of(["2001", "0-2", "1"])
    [2001, 0, 1, 2]
    """
    found: dict[int, None] = {}
    for word in words:
        ends = word.split("-")
        if len(ends) > 2 or not all(end.isdecimal() for end in ends):
            raise InvalidSetting(f"{word!r} is no case; give numbers as in 7 or 1000-1003")
        first, last = int(ends[0]), int(ends[-1])
        if not first <= last <= LAST:
            raise InvalidSetting(
                f"{word}: cases have numbers from 0 to {LAST}, the lower one first"
            )
        found.update(dict.fromkeys(range(first, last + 1)))
    return list(found)


def mixed(numbers: Sequence[int]) -> list[int]:
    """The same numbers in an order in which a run cut short has a little of every role.

    Examples
    --------
    >>> mixed([0, 1, 2, 3, 1000, 1001, 2000])
    [0, 1000, 2000, 1, 2, 1001, 3]
    """
    roles: dict[str, list[int]] = {}
    for number in sorted(set(numbers)):
        roles.setdefault(role_of(number), []).append(number)
    return sorted(
        (number for own in roles.values() for number in own),
        key=lambda n: (roles[role_of(n)].index(n) / len(roles[role_of(n)]), n),
    )
