"""Arguments of a vector environment: checked, and one for each environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from loose_env.errors import InvalidSetting
from loose_env.io import is_whole

__all__ = ["batch_seeds", "checked_mask", "checked_seeds", "mode_named", "own_options"]


def batch_seeds(seed: int, count: int) -> list[int]:
    """Root seeds of the environments of a batch; two batches share no episode.

    The first is ``seed`` itself, the others are numbers of 128 bits made from it. Seeds that count
    up would do worse: of 16 environments each, batches seeded 0 and 1 would share 15.

    Parameters
    ----------
    seed : int
        Seed of the batch.
    count : int
        Number of environments.

    Examples
    --------
    >>> batch_seeds(7, 1)
    [7]
    >>> len({*batch_seeds(7, 64), *batch_seeds(8, 64)})
    128
    """
    further = (np.random.SeedSequence(seed, spawn_key=(i,)) for i in range(1, count))
    states = (each.generate_state(2, np.uint64) for each in further)
    return [seed, *(int(high) << 64 | int(low) for high, low in states)]


def checked_seeds(given: Any, count: int) -> list[int | None]:
    """One seed for each environment; a single one is spread by `batch_seeds`."""
    several = isinstance(given, (Sequence, np.ndarray)) and not isinstance(given, str)
    seeds = list(given) if several else [given]
    for seed in seeds:
        if seed is not None and (not is_whole(seed) or seed < 0):
            raise InvalidSetting(f"a seed is a whole number, zero or more; got {seed!r}")
    if not several:
        first = seeds[0]
        return [None] * count if first is None else [*batch_seeds(int(first), count)]
    if len(seeds) != count:
        raise InvalidSetting(f"{count} seeds are needed, got {len(seeds)}")
    return [None if seed is None else int(seed) for seed in seeds]


def own_options(given: Any, count: int) -> list[Mapping[str, Any]]:
    """Options of each environment alone."""
    if given is None:
        return [{}] * count
    fits = isinstance(given, Sequence) and not isinstance(given, str)
    if not fits or len(given) != count:
        raise InvalidSetting(
            f"env_options are {count} mappings, one for each environment, None where "
            f"there are none; got {given!r:.60}"
        )
    for each in given:
        if each is not None and not isinstance(each, Mapping):
            raise InvalidSetting(
                f"each of env_options is a mapping such as {{'fault': 'healthy'}}, or None; "
                f"got {each!r:.60}"
            )
    return [{} if each is None else each for each in given]


def checked_mask(given: Any, count: int) -> NDArray[np.bool_]:
    """Environments to reset, all by default (count,)."""
    if given is None:
        return np.ones(count, dtype=bool)
    mask = np.asarray(given)
    if mask.shape != (count,) or mask.dtype != bool or not mask.any():
        raise InvalidSetting(
            f"reset_mask must be {count} booleans, at least one of them true; got {given!r}"
        )
    return mask


def mode_named(given: AutoresetMode | str) -> AutoresetMode:
    """Mode of that name or value."""
    for mode in AutoresetMode:
        if given is mode or given in (mode.value, mode.name):
            return mode
    raise InvalidSetting(
        f"autoreset_mode is one of {[mode.value for mode in AutoresetMode]}, got {given!r}"
    )
