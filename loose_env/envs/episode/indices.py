"""Check of the indices that an action is made of."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidAction

__all__ = ["checked_indices"]


def checked_indices(name: str, given: Any, choices: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return indices (n,) of choices, one for each number of choices (n,).

    Raises
    ------
    InvalidAction
        If they are of another number, or one is no whole number from 0 to below its choices.

    Examples
    --------
    >>> checked_indices("levels", [0, 2.0], np.array([3, 3])).tolist()
    [0, 2]
    """
    try:
        found = np.asarray(given)
    except ValueError:  # rows of different length
        found = np.array(None)
    whole = found.dtype.kind in "iu" or (
        found.dtype.kind == "f" and bool(np.all(found == np.round(found)))
    )
    inside = found.shape == choices.shape and whole and np.all((found >= 0) & (found < choices))
    if not inside:
        most = (choices - 1).tolist()
        if len(set(most)) == 1:
            most = most[:1]
        raise InvalidAction(
            f"{name}: {len(choices)} whole numbers from 0 to {most if len(most) > 1 else most[0]}, "
            f"got {found.tolist()!r:.80}"
        )
    return found.astype(np.intp)
