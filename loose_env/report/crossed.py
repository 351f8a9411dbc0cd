"""Estimators crossed with policies: what each of the two gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from loose_env.report.standings import Standing

__all__ = ["Crossing", "crossing"]


@dataclass(frozen=True, kw_only=True)
class Crossing:
    """Agents made of an estimator and a policy, laid out by both."""

    estimators: tuple[str, ...]
    """The columns."""
    policies: tuple[str, ...]
    """The rows."""
    cells: dict[tuple[str, str], Standing]
    """By policy and estimator; pairs that were not played are missing."""


def crossing(found: Sequence[Standing]) -> Crossing | None:
    """Lay agents called ``estimator/policy`` out; None where nothing is crossed.

    Estimators and policies stand in the order of their best agent.
    """
    cells = {}
    for s in found:
        estimator, mark, policy = s.agent.partition("/")
        if mark:
            cells[policy, estimator] = s
    estimators = tuple(dict.fromkeys(estimator for _, estimator in cells))
    policies = tuple(dict.fromkeys(policy for policy, _ in cells))
    if len(cells) < 2:
        return None
    return Crossing(estimators=estimators, policies=policies, cells=cells)
