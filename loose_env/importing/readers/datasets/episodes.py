"""Choice of episodes of a dataset by a text such as ``"0, 3-5"``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from loose_env.errors import InvalidData
from loose_env.recording import nearest

_RANGE = re.compile(r"(\d{1,9})(?:\s*-\s*(\d{1,9}))?", re.ASCII)
_NUMBER = re.compile(r"(\d+)$", re.ASCII)


def chosen_episodes(text: str, there: Sequence[str], place: str) -> list[str]:
    """Names of the episodes that a text chooses, in its order.

    Examples
    --------
    >>> chosen_episodes("0, 2-3", ["demo_0", "demo_1", "demo_2", "demo_3"], "here")
    ['demo_0', 'demo_2', 'demo_3']
    """
    if text.strip() == "all":
        return list(there)
    numbers = {int(m.group(1)): name for name in there if (m := _NUMBER.search(name))}
    found: dict[str, None] = {}
    for part in filter(None, (each.strip() for each in text.split(","))):
        span = _RANGE.fullmatch(part)
        if part in there:
            found[part] = None
        elif span is not None:
            low, high = int(span.group(1)), int(span.group(2) or span.group(1))
            own = [i for i in sorted(numbers) if low <= i <= high]
            if len(own) != high - low + 1:
                missing = next(iter({low, high} - set(own)), low)
                raise InvalidData(
                    f"{place}: there is no episode {missing}; there are {_words(there)}"
                )
            found |= dict.fromkeys(numbers[i] for i in own)
        else:
            raise InvalidData(
                f"{place}: {part[:60]!r} is no episode; there are {_words(there)}; write 'all', or "
                f"numbers and ranges such as '0, 3-5'{nearest(part[:60], there)}"
            )
    if not found:
        raise InvalidData(f"{place}: {text[:60]!r} chooses no episode; 'all' takes each")
    return list(found)


def _words(there: Sequence[str]) -> str:
    if len(there) < 6:
        return ", ".join(there) or "none"
    return f"{len(there)}, from {there[0]} to {there[-1]}"
