"""Text for people: durations, sentences, docstrings of fields."""

from __future__ import annotations

import ast
import inspect
import textwrap

__all__ = ["begun", "duration_words", "field_words", "sentence"]


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


def field_words(kind: type) -> dict[str, str]:
    """Docstrings under the fields of a dataclass; none where its source is not there.

    Examples
    --------
    >>> from loose_env.io.validation import Rule
    >>> field_words(Rule)["words"]
    'Allowed values, as an error states them.'
    """
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    except (OSError, TypeError, SyntaxError):
        return {}
    found: dict[str, str] = {}
    last = ""
    for node in tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else ():
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            last = node.target.id
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and last:
            found[last] = " ".join(str(node.value.value).split())
            last = ""
        else:
            last = ""
    return found
