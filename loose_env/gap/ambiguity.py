"""What held-out data cannot tell from what was named."""

from __future__ import annotations

from loose_env.gap.effect import Effect
from loose_env.gap.judgement import lead_of
from loose_env.gap.naming import Named
from loose_env.gap.naming_settings import NamingSettings

__all__ = ["indistinct"]

TIE = NamingSettings.tie
"""Lead on held-out runs below which two hypotheses cannot be told apart [standard deviations]."""
_AS_MUCH = 0.05
"""What a rival may leave unexplained beyond what the named one does, as a share of the gap."""


def indistinct(named: Named, effect: Effect) -> tuple[Effect, ...]:
    """Rivals of a named effect that explain the held-out runs as well.

    Parameters
    ----------
    named : Named
        What was found.
    effect : Effect
        One of the named.
    """
    found: list[Effect] = []
    for step, rivals in zip(named.steps, named.rivals, strict=False):
        if step.fitted.effects[-1].key != effect.key:
            continue
        own = next((lead for j, lead in rivals if j.fitted.effects[-1].key == effect.key), None)
        for judged, lead in rivals:
            other = judged.fitted.effects[-1]
            same = (other.kind, other.where) == (effect.kind, effect.where)
            if same or lead.held < TIE:
                continue
            ahead = lead_of(step, judged)
            near = own is None or lead.share > own.share - _AS_MUCH
            if ahead.held < TIE and near:
                found.append(other)
    return tuple({(e.kind, e.where): e for e in found}.values())
