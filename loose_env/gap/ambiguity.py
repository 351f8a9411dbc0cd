"""What held-out data cannot tell from what was named."""

from __future__ import annotations

from loose_env.gap.effect import Effect
from loose_env.gap.judgement import lead_of
from loose_env.gap.kinship import joint_of
from loose_env.gap.naming import Named
from loose_env.gap.naming_settings import NamingSettings
from loose_env.gap.ranking import added_to

__all__ = ["indistinct"]

TIE = NamingSettings.tie
"""Lead on held-out runs below which two hypotheses cannot be told apart [standard deviations]."""
_AS_MUCH = 0.05
"""What a rival may leave unexplained beyond what the named one does, as a share of the gap."""


def indistinct(named: Named, effect: Effect) -> tuple[Effect, ...]:
    """Effects of rivals that explain the held-out runs as well as a step that named this one.

    Of a rival with several effects, those at the joint of the named one stand against it; all of
    them where none is there.

    Parameters
    ----------
    named : Named
        What was found.
    effect : Effect
        One of the named.
    """
    found: list[Effect] = []
    before = named.base
    for step, rivals in zip(named.steps, named.rivals, strict=False):
        new = {each.key for each in added_to(before, step)}
        if effect.key in new:
            added = [({e.key for e in added_to(before, judged)}, lead) for judged, lead in rivals]
            own = next((lead for keys, lead in added if keys >= new), None)
            for judged, lead in rivals:
                if lead.held < TIE or lead_of(step, judged).held >= TIE:
                    continue
                if own is None or lead.share > own.share - _AS_MUCH:
                    found += _against(effect, added_to(before, judged))
        before = step
    return tuple({(e.kind, e.where): e for e in found}.values())


def _against(effect: Effect, others: tuple[Effect, ...]) -> list[Effect]:
    """Effects of a rival that stand against one; none where the rival has it, too."""
    if any((other.kind, other.where) == (effect.kind, effect.where) for other in others):
        return []
    joint = joint_of(effect)
    here = [other for other in others if joint_of(other) == joint]
    return here or list(others)
