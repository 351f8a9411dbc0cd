"""Making the model-gap environment: arm, library and signatures from arguments."""

from __future__ import annotations

import sys
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from loose_env.arms import SERVO_ARM
from loose_env.envs.model_gap.env import ModelGapEnv
from loose_env.envs.model_gap.settings import ModelGapSettings
from loose_env.errors import UnknownName
from loose_env.gap import (
    BankSettings,
    LocalModels,
    battery,
    brief_library,
    motion_library,
    read_servo_arm,
    signature_bank,
)

__all__ = ["make_model_gap"]

_OTHERS = ("model", "render_mode")


def make_model_gap(*, model: str | Path | None = None, **arguments: Any) -> ModelGapEnv:
    """Make the environment of an arm in an MJCF file, by default `loose_env.arms.SERVO_ARM`.

    Raises
    ------
    UnknownName
        If there is no such argument.
    InvalidData
        If the file is no model with position servos.
    """
    known = [f.name for f in fields(ModelGapSettings)]
    arguments.pop("render_mode", None)
    unknown = sorted(set(arguments) - set(known))
    if unknown:
        raise UnknownName(f"unknown arguments {unknown}; known are {[*_OTHERS, *known]}")
    settings = ModelGapSettings(**arguments)
    path = SERVO_ARM if model is None else Path(model)
    models = _models(
        str(path), settings.tolerance, settings.max_speed, tuple(settings.kinds), settings.library
    )
    return ModelGapEnv(models.bank, settings, models=models)


@lru_cache(maxsize=4)
def _models(
    path: str, tolerance: float, max_speed: float, kinds: tuple[str, ...], library: str
) -> LocalModels:
    """Local models of an arm, shared by the environments of a process."""
    arm = read_servo_arm(path, tolerance=tolerance, max_speed=max_speed)
    motions = {"whole": motion_library, "brief": brief_library, "battery": battery}[library](arm)
    settings = BankSettings(kinds=kinds or None)
    bank = signature_bank(arm, motions, settings, say=_say)
    return LocalModels(bank)


def _say(words: str) -> None:
    print(f"loose_env/Gap-v0: {words}", file=sys.stderr, flush=True)
