"""What a corrected model says of itself: the effects that were named, and those it has besides.

Where too much is left for what was accepted to be the explanation, nothing is named; the corrected
model has it nevertheless, and its errors are stated with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.effect import Effect
from loose_env.gap.result import NamedEffect

__all__ = ["model_notes", "nameless_words"]

Array = NDArray[np.float64]
Added = tuple[Effect, Array]
"""An effect with its values."""


def nameless_words(added: Sequence[Added]) -> list[str]:
    """A sentence on effects that the corrected model has and that are not named; none without.

    Parameters
    ----------
    added : sequence of (Effect, ndarray)
        These effects, with their values.
    """
    if not added:
        return []
    listed = "; ".join(_added_words(effect, values) for effect, values in added)
    return [
        f"the corrected model has, without its being named: {listed}. That lowers the gap on the "
        "held-out runs, but too much is left for it to be the explanation; the gap after, "
        "model.xml and the code are with it"
    ]


def model_notes(
    named: Sequence[NamedEffect], nameless: Sequence[Added], figures: Mapping[str, float]
) -> list[str]:
    """Lines at the head of ``model.xml``: all that it has beyond the nominal model.

    Parameters
    ----------
    named : sequence of NamedEffect
        Effects that were named.
    nameless : sequence of (Effect, ndarray)
        Effects that were not, with their values.
    figures : mapping
        Factors on nominal figures.
    """
    notes = ["Corrected by loose gap."]
    if named:
        notes.append("On top of the nominal model:")
        notes += [
            _words(each.kind, each.where, each.parameters, each.units, each.in_model)
            for each in named
        ]
    if nameless:
        notes.append(
            "On top of the nominal model, without being named (it lowers the gap, but too much is "
            "left for it to be the explanation):"
        )
        notes += [_added_words(effect, values) for effect, values in nameless]
    if not named and not nameless:
        notes.append("No effect was added to the nominal model.")
    if figures:
        off = max(abs(value - 1) for value in figures.values())
        notes.append(
            f"nominal figures fitted within the tolerance, off by {100 * off:.1f} % at most"
        )
    return notes


def _added_words(effect: Effect, values: Array) -> str:
    """An effect that was added, with its values."""
    parameters = {p.name: float(v) for p, v in zip(effect.parameters, values, strict=True)}
    units = {p.name: p.unit for p in effect.parameters}
    return _words(effect.kind, effect.where, parameters, units, effect.in_model)


def _words(
    kind: str, where: str, values: Mapping[str, float], units: Mapping[str, str], in_model: bool
) -> str:
    numbers = ", ".join(
        f"{name} {value:.4g} {units.get(name, '')}".rstrip() for name, value in values.items()
    )
    place = "" if in_model else " (not in model.xml: see result.json, code)"
    return f"{kind} at {where}: {numbers}{place}"
