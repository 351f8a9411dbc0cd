"""Serialisation of scored fits as plain values, for checkpoints of a search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np

from loose_env.errors import UnknownName
from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.holdout_score import Judged
from loose_env.gap.fitting.model_structure import ModelStructure, Nuisance
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import Machine
from loose_env.gap.output.checkpoints import Stage
from loose_env.gap.selection.forward_selection import Keep, Step

__all__ = ["KeepInFiles", "judged_of", "plain_judged"]


def plain_judged(judged: Judged) -> dict[str, Any]:
    """Convert a scored fit to plain values, for `output.checkpoints.Stages`."""
    fitted = judged.fitted
    own = {each.name: getattr(fitted, each.name) for each in fields(fitted)}
    del own["structure"]
    own["effects"] = [[e.kind, e.where, e.variant] for e in fitted.effects]
    return {each.name: getattr(judged, each.name) for each in fields(judged)} | {"fitted": own}


def judged_of(kept: dict[str, Any], machine: Machine, nuisance: Nuisance) -> Judged:
    """Restore a scored fit.

    Parameters
    ----------
    kept : dict
        As of `plain_judged`.
    machine : Machine
        The nominal model.
    nuisance : Nuisance
        Nuisance parameters of the fit.

    Raises
    ------
    UnknownName
        If the catalogue no longer has an effect.
    """
    plain = dict(kept["fitted"])
    effects = tuple(_effect(machine, *each) for each in plain.pop("effects"))
    fitted = Fit(structure=ModelStructure(nuisance=nuisance, effects=effects), **plain)
    return Judged(**(kept | {"fitted": fitted}))


class KeepInFiles(Keep):
    """Stores the steps of a search in checkpoint files.

    Parameters
    ----------
    stages : Stage
        The files.
    machine : Machine
        The nominal model.
    nuisance : Nuisance
        Nuisance parameters of the fits.
    prefix : str
        Prefix of the stage names, so that two searches do not share checkpoints.
    """

    def __init__(
        self, stages: Stage, machine: Machine, nuisance: Nuisance, prefix: str = ""
    ) -> None:
        self.stages, self.machine, self.nuisance = stages, machine, nuisance
        self.prefix = prefix

    def judged(self, name: str, make: Callable[[], Judged]) -> Judged:
        """Return a scored fit, of this run or an earlier one."""
        kept = self.stages(self.prefix + name, lambda: plain_judged(make()))
        return judged_of(kept, self.machine, self.nuisance)

    def step(self, name: str, make: Callable[[], Step]) -> Step:
        """Return a step of the search, of this run or an earlier one."""
        kept = self.stages(self.prefix + name, lambda: _plain_step(make()))
        accepted = kept["accepted"]
        return Step(
            rivals=[judged_of(each, self.machine, self.nuisance) for each in kept["rivals"]],
            accepted=None if accepted is None else judged_of(accepted, self.machine, self.nuisance),
            dropped=[_effect(self.machine, *each) for each in kept["dropped"]],
        )


def _plain_step(step: Step) -> dict[str, Any]:
    """Convert a step to plain values, without the sensitivities of rivals."""
    rivals = []
    for judged in step.rivals:
        fitted = replace(judged.fitted, jacobian=np.zeros((0, len(judged.fitted.free))))
        rivals.append(plain_judged(replace(judged, fitted=fitted)))
    return {
        "rivals": rivals,
        "accepted": None if step.accepted is None else plain_judged(step.accepted),
        "dropped": [[e.kind, e.where, e.variant] for e in step.dropped],
    }


def _effect(machine: Machine, kind: str, where: str, variant: str) -> Effect:
    if kind not in CATALOGUE:
        raise UnknownName(f"unknown effect {kind!r}; the catalogue has {list(CATALOGUE)}")
    return CATALOGUE[kind](machine, where, variant)
