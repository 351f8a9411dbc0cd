"""Keyed random streams, many at once: the generators that numpy's `SeedSequence` would seed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray

__all__ = ["seeded", "streams"]

Words = NDArray[np.uint32]

_POOL = 4  # words of the entropy pool
_WORD = 1 << 32
_FEW = 16  # of fewer streams each is hashed by numpy itself, which is quicker then


def streams(seeds: Sequence[int], keys: NDArray[np.intp]) -> list[np.random.Generator]:
    """Generators of B streams, each that of ``SeedSequence(seed, spawn_key=key)``.

    Parameters
    ----------
    seeds : sequence of B int
        Seeds, zero or more.
    keys : ndarray (B, k)
        Keys, zero or more.

    Examples
    --------
    >>> keys = np.arange(16).reshape(8, 2)
    >>> ours = streams([7] * 8, keys)[3].random()
    >>> theirs = np.random.default_rng(np.random.SeedSequence(7, spawn_key=(6, 7))).random()
    >>> ours == theirs
    True
    """
    if int(max(seeds, default=0)) >> 128 or keys.max(initial=0) >= _WORD:
        return [
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))
            for seed, key in zip(seeds, keys.tolist(), strict=True)
        ]
    words = np.frombuffer(b"".join(int(s).to_bytes(16, "little") for s in seeds), "<u4")
    return seeded(np.concatenate([words.reshape(-1, _POOL), keys.astype(np.uint32)], 1))


def seeded(entropy: Words) -> list[np.random.Generator]:
    """Generators seeded by rows of four words or more (B, W), as ``default_rng`` seeds them."""
    if len(entropy) < _FEW:
        return [np.random.default_rng(row) for row in entropy]
    states = _states(entropy)
    known: Any = _Hashed  # numpy's stubs know its own seed sequences alone
    return [np.random.Generator(np.random.PCG64(known(state))) for state in states]


class _Hashed(ISeedSequence):
    """A seed sequence whose words are known."""

    def __init__(self, state: NDArray[np.uint64]) -> None:
        self.state = state

    def generate_state(self, n_words: int, dtype: Any = None) -> NDArray[np.uint64]:
        """All words: a bit generator asks once."""
        return self.state


def _states(entropy: Words) -> NDArray[np.uint64]:
    """Initial states of PCG64 from rows of entropy (B, 4): numpy's `SeedSequence`, row by row.

    The hash is O'Neill's, https://www.pcg-random.org/posts/developing-a-seed_seq-alternative.html.
    """
    width = entropy.shape[1]
    first, later = _constants(0x43B0D7E5, 0x931E8875, _POOL * width)
    pool = _hashed(entropy[:, :_POOL], first[:_POOL], later[:_POOL])
    at = _POOL
    for source in range(width):
        others = [k for k in range(_POOL) if k != source]
        word = (pool if source < _POOL else entropy)[:, source, None]
        span = slice(at, at + len(others))
        pool[:, others] = _mixed(pool[:, others], _hashed(word, first[span], later[span]))
        at = span.stop
    first, later = _constants(0x8B51F9DD, 0x58F38DED, 2 * _POOL)
    found = _hashed(np.concatenate([pool, pool], axis=1), first, later)
    return np.ascontiguousarray(found).view(np.uint64)


@lru_cache
def _constants(start: int, factor: int, count: int) -> tuple[Words, Words]:
    """Constants of the hash before and after each step (count,)."""
    found = [start]
    for _ in range(count):
        found.append(found[-1] * factor % _WORD)
    both = np.array(found, dtype=np.uint32)
    return both[:-1], both[1:]


def _hashed(value: Words, first: Words, later: Words) -> Words:
    value = (value ^ first) * later
    return value ^ (value >> np.uint32(16))


def _mixed(x: Words, y: Words) -> Words:
    value: Words = np.uint32(0xCA01F9DD) * x - np.uint32(0x4973F715) * y
    return value ^ (value >> np.uint32(16))
