"""Durations in words, to two figures.

Words as sentences: what programs say in one line, on a page.
"""

from __future__ import annotations

__all__ = ["begun", "duration_words", "sentence"]


def duration_words(seconds: float) -> str:
    """A duration to two figures, in the unit that suits it.

    Examples
    --------
    >>> [duration_words(s) for s in (0.0123, 1.41, 52.0, 740.0, 13_400.0, 130_000.0)]
    ['12 ms', '1.4 s', '52 s', '12 min', '3.7 h', '36 h']
    """
    for unit, length in (("h", 3600.0), ("min", 60.0), ("s", 1.0)):
        # two minutes in seconds, two hours in minutes: still plain to read
        if seconds >= (1.0 if unit == "s" else 2.0) * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{1e3 * seconds:.2g}'):g} ms"


def begun(words: str) -> str:
    """Words as a sentence begins."""
    return words[:1].upper() + words[1:]


def sentence(words: str) -> str:
    """Words as a sentence.

    Examples
    --------
    >>> sentence("the step is coarse"), sentence("Is it?")
    ('The step is coarse.', 'Is it?')
    """
    ended = words.rstrip()
    return begun(ended) + ("" if ended[-1:] in (".", "!", "?", "") else ".")
