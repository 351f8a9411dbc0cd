"""Which runs are fitted to, and which are kept to judge by: whole runs, never rows."""

from __future__ import annotations

from collections.abc import Sequence

from loose_env.errors import InvalidData

__all__ = ["split_runs"]


def split_runs(names: Sequence[str], *, share: float = 0.25) -> tuple[list[int], list[int]]:
    """Numbers of the runs to fit to, and of those held out.

    Runs are held out evenly through the recording, at least one, the last among them.

    Parameters
    ----------
    names : sequence of str
        The runs.
    share : float
        Share held out.

    Raises
    ------
    InvalidData
        If there are fewer than two runs.

    Examples
    --------
    >>> split_runs(["a", "b", "c", "d"])
    ([0, 1, 2], [3])
    """
    count = len(names)
    if count < 2:
        raise InvalidData(
            f"the recording has {count} run; at least two are needed, so that one can be held "
            "out to judge by. Record another run with another motion"
        )
    held = max(1, round(share * count))
    chosen = sorted({count - 1 - round(k * count / held) for k in range(held)})
    return [k for k in range(count) if k not in chosen], chosen
