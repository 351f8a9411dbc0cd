"""Words as sentences: what programs say in one line, on a page."""

from __future__ import annotations

__all__ = ["begun", "sentence"]


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
