"""Export of domain-randomisation ranges from the 95 % intervals, as JSON.

The form is ``loose-ranges/1``. Each range has the parameter's effect, location, unit and interval;
where the parameter is one attribute of MJCF, also that attribute with its absolute range.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

from loose_env.gap.output.targets.model_parameters import ModelParameter, model_parameters
from loose_env.gap.output.targets.source import Export, ExportSource
from loose_env.io import json_text

RANGES_FORMAT = "loose-ranges/1"


def ranges_export(source: ExportSource) -> Export:
    """Write a range for every parameter of the named effects."""
    parameters = model_parameters(source)
    left = tuple(
        f"{p.name} {p.value:.4g} {p.unit}".rstrip() + ": the result has no interval for it"
        for p in parameters
        if not p.low < p.high
    )
    whole = {
        "format": RANGES_FORMAT,
        "interval": "95 % confidence interval, to be drawn from uniformly",
        "ranges": [_range(p) for p in parameters if p.low < p.high],
        "not_expressed": list(left),
    }
    return Export(files={"ranges.json": json_text(whole)}, not_expressed=left)


def _range(p: ModelParameter) -> dict[str, Any]:
    low, high = p.effect.interval_95[p.parameter]
    found: dict[str, Any] = {
        "effect": p.effect.kind,
        "where": p.where,
        "parameter": p.parameter,
        "unit": p.unit,
        "value": p.effect.parameters[p.parameter],
        "low": low,
        "high": high,
    }
    if p.attribute and not p.scales:
        index = "" if p.index is None else f"[{p.index}]"
        found["mjcf"] = {
            "attribute": f"{p.element}/{p.attribute}{index}",
            "nominal": p.nominal,
            "value": p.value,
            "low": p.low,
            "high": p.high,
        }
    elif isfinite(p.nominal):
        found["without_effect"] = p.nominal
    return found
