"""Catalogue of the analysis: that of the simulations, and effects that logs of machines ask for."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.effects.drives import CommandInterpolation
from loose_env.gap.model.effects.joints import FrictionBehindSlack, TorqueOffset

EFFECTS: Mapping[str, type[Effect]] = ChainMap(
    {effect.kind: effect for effect in (TorqueOffset, FrictionBehindSlack, CommandInterpolation)},
    CATALOGUE,
)
"""Identifier -> class, of all effects, those that users register included."""
