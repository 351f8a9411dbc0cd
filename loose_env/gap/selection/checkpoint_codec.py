"""Scored fits and search steps as plain values in checkpoint files, and restored from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from loose_env.errors import UnknownName
from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.holdout_score import ScoredFit
from loose_env.gap.fitting.model_structure import ModelStructure, Nuisance
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.checkpoints import Stage
from loose_env.gap.selection.forward_selection import SelectionStep, StepStore


def plain_fit(scored: ScoredFit) -> dict[str, Any]:
    """Convert a scored fit to plain values, for `output.checkpoints.Stages`."""
    fitted = scored.fitted
    own = {each.name: getattr(fitted, each.name) for each in fields(fitted)}
    del own["structure"]
    own["effects"] = [[e.kind, e.where, e.variant] for e in fitted.effects]
    return {each.name: getattr(scored, each.name) for each in fields(scored)} | {"fitted": own}


def restored_fit(kept: dict[str, Any], machine: NominalModel, nuisance: Nuisance) -> ScoredFit:
    """Restore a scored fit."""
    plain = dict(kept["fitted"])
    effects = tuple(_effect(machine, *each) for each in plain.pop("effects"))
    fitted = Fit(structure=ModelStructure(nuisance=nuisance, effects=effects), **plain)
    return ScoredFit(**(kept | {"fitted": fitted}))


class StepFiles(StepStore):
    """Stores the steps of a search in checkpoint files."""

    def __init__(
        self, stages: Stage, machine: NominalModel, nuisance: Nuisance, prefix: str = ""
    ) -> None:
        self.stages, self.machine, self.nuisance = stages, machine, nuisance
        self.prefix = prefix

    def scored(self, name: str, make: Callable[[], ScoredFit]) -> ScoredFit:
        """Return a scored fit, of this run or an earlier one."""
        kept = self.stages(self.prefix + name, lambda: plain_fit(make()))
        return restored_fit(kept, self.machine, self.nuisance)

    def step(self, name: str, make: Callable[[], SelectionStep]) -> SelectionStep:
        """Return a step of the search, of this run or an earlier one."""
        kept = self.stages(self.prefix + name, lambda: _plain_step(make()))
        accepted = kept["accepted"]
        return SelectionStep(
            rivals=[restored_fit(each, self.machine, self.nuisance) for each in kept["rivals"]],
            accepted=None
            if accepted is None
            else restored_fit(accepted, self.machine, self.nuisance),
            dropped=[_effect(self.machine, *each) for each in kept["dropped"]],
        )


def _plain_step(step: SelectionStep) -> dict[str, Any]:
    """Convert a step to plain values, without the sensitivities of rivals."""
    return {
        "rivals": [plain_fit(scored.bare) for scored in step.rivals],
        "accepted": None if step.accepted is None else plain_fit(step.accepted),
        "dropped": [[e.kind, e.where, e.variant] for e in step.dropped],
    }


def _effect(machine: NominalModel, kind: str, where: str, variant: str) -> Effect:
    if kind not in CATALOGUE:
        raise UnknownName(f"unknown effect {kind!r}; the catalogue has {list(CATALOGUE)}")
    return CATALOGUE[kind](machine, where, variant)
