"""Table of the parameters of a gap page: nominal, found, interval, unit."""

from __future__ import annotations

from typing import Any

from loose_env.gap import GapResult, NamedEffect
from loose_env.report.gap.effects import effect_words
from loose_env.report.pages.sections import group

__all__ = ["parameters_group"]

_ROWS = 16
"""Rows of the table, at most."""
_MOVED = 1e-3
"""Deviation of a factor from 1 from which it is listed."""
_ZERO = frozenset(
    {
        "amplitude", "damping", "delay", "drag", "gap", "inertia", "mass", "offset",
        "time_constant", "torque",
        "backward", "cosine", "forward", "share", "sine", "width",
    }
)  # fmt: skip
"""Parameters that are zero where the effect is absent."""
_VECTORS = frozenset({"link_com", "sensor_misalignment", "sensor_bias", "base_tilt"})
"""Effects whose components are all zero where the effect is absent."""
_ONE = frozenset({"factor", "gain", "static_ratio"})
"""Parameters that are one where the effect is absent."""


def parameters_group(result: GapResult) -> dict[str, Any]:
    """Section with the one table of parameters: effects first, then the nominal parameters."""
    rows = [
        _row(
            f"{effect_words(effect.kind, effect.where)}: {name.replace('_', ' ')}",
            _nominal(effect, name),
            value,
            effect.interval_95.get(name),
            effect.units.get(name, "") or "1",
        )
        for effect in result.effects
        for name, value in effect.parameters.items()
    ]
    moved = sorted(result.nominal_parameters.items(), key=lambda item: -abs(item[1] - 1))
    kept = [item for item in moved if abs(item[1] - 1) >= _MOVED][: max(_ROWS - len(rows), 4)]
    rows += [_row(name, "1", value, None, "factor") for name, value in kept]
    note = (
        "Nominal: value in the recording's model, or with which the effect is absent. Factors are "
        "of nominal parameters, fitted within their tolerance and never reported as an effect; "
        "model.xml carries them."
    )
    if len(kept) < len(moved):
        note += f" The other {len(moved) - len(kept)} are closer to 1: see result.json."
    return group("Parameters", "", tables=[{"rows": rows, "note": note}] if rows else [])


def _row(
    name: str, nominal: str, found: float, ends: tuple[float, float] | None, unit: str
) -> dict[str, str]:
    between = "–" if ends is None else f"{_number(ends[0])} to {_number(ends[1])}"
    return {
        "Parameter": f"{name[0].upper()}{name[1:]}" if " " in name else name,
        "Nominal": nominal,
        "Found": _number(found),
        "95 % interval": between,
        "Unit": unit,
    }


def _number(value: float) -> str:
    return f"{value:.4g}".replace("-", "−")


def _nominal(effect: NamedEffect, name: str) -> str:
    """Value of a parameter where the effect is absent; a dash where it only shapes the effect.

    Examples
    --------
    >>> from loose_env.gap import NamedEffect
    >>> _nominal(NamedEffect(kind="sensor_gain", where="a", parameters={"gain": 1.2}), "gain")
    '1'
    """
    if name in _ONE:
        return "1"
    if name == "stiffness":
        return "0" if effect.kind == "joint_spring" else "rigid"
    return "0" if name in _ZERO or effect.kind in _VECTORS else "–"
