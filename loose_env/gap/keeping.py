"""Judged fits as plain values and back: what a stage of a comparison keeps."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from loose_env.errors import UnknownName
from loose_env.gap.catalogue import CATALOGUE
from loose_env.gap.effect import Effect
from loose_env.gap.fit import Fit
from loose_env.gap.judgement import Judged
from loose_env.gap.machine import Machine
from loose_env.gap.nominal import NominalFigures

__all__ = ["judged_of", "plain_judged"]


def plain_judged(judged: Judged) -> dict[str, Any]:
    """Plain values and arrays of a judged fit, as `loose_env.gap.stages.Stages` keeps them."""
    fitted = judged.fitted
    own = {each.name: getattr(fitted, each.name) for each in fields(fitted)}
    own["effects"] = [[e.kind, e.where, e.variant] for e in fitted.effects]
    return {each.name: getattr(judged, each.name) for each in fields(judged)} | {"fitted": own}


def judged_of(kept: dict[str, Any], machine: Machine, nominal: NominalFigures) -> Judged:
    """Restore a judged fit.

    Parameters
    ----------
    kept : dict
        As of `plain_judged`.
    machine : Machine
        The nominal model.
    nominal : NominalFigures
        The nominal figures, the one effect that is not in the catalogue.

    Raises
    ------
    UnknownName
        If the catalogue has an effect no more.
    """
    effects = tuple(_effect(machine, nominal, *each) for each in kept["fitted"]["effects"])
    fitted = Fit(**(kept["fitted"] | {"effects": effects}))
    return Judged(**(kept | {"fitted": fitted}))


def _effect(
    machine: Machine, nominal: NominalFigures, kind: str, where: str, variant: str
) -> Effect:
    if kind == nominal.kind:
        return nominal
    if kind not in CATALOGUE:
        raise UnknownName(f"unknown effect {kind!r}; the catalogue has {list(CATALOGUE)}")
    return CATALOGUE[kind](machine, where, variant)
