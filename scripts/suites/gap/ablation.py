r"""Ablation of `loose gap`: the suite again with one thing changed at a time.

Each number that decides what is named is halved and doubled, and five parts of the method are left
out. Each variant is a tool of its own, ``loose_gap@VARIANT``, with its
own rows; those of the method as shipped are the suite's.

    python -m scripts.suites.gap.run --numbers 0-59 --ablate --most-seconds 20
    python -m scripts.suites.gap.run --numbers 0-59 --ablate without core.decision --show
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from importlib import import_module
from typing import Any

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.gap import GapSettings
from scripts.suites.rows import Row

PACKAGE = "loose_env.gap"
"""Package whose numbers are changed."""
Changes = Mapping[str, Any]
"""New values by name: ``core.decision.NAMED``, ``tolerances.mass`` or ``settings.simulate``."""
_NUMBERS = """
    find._FALLS find._MOVES selection.KIND selection.FORM catalogue.LAW_WIDTH catalogue.USUAL_SHARE
    evidence._NOISE selection.LEAST_VALUES selection.SHARE_VALUES evidence.BANDS evidence.STRETCHES
    evidence._SHORTEST_S evidence.KNOCK evidence._REST motion.HIGHEST_HZ catalogue._MOVING
    balance._MOST_LOAD exact.WINDOW_S exact.LEAD_S exact.LARGE selection.EXPLAINED
    decision.NAMED decision._Z decision.HELD_OUT decision.CONTRADICTED decision._NOISE
"""
NUMBERS = tuple(f"core.{name}" for name in _NUMBERS.split())
"""The numbers that decide, modules and constants in the order of the method: models that fall and
readings of nothing; priors; noise and discrepancy; data that are left out; exact fits; decision.
Reasons stand where they are defined."""
TRIED = {
    "core.evidence._NOISE": (1.05, 1.2), "core.balance._MOST_LOAD": (0.45, 0.95),
    "core.selection.EXPLAINED": (0.8, 0.95), "core.decision.NAMED": (0.25, 0.75),
    "core.decision._Z": (1.64, 2.58), "core.decision._NOISE": (1.3, 2.4),
}  # fmt: skip
"""Values that are tried where half and double have no meaning."""

_RIGID = ("mass", "centre", "centre_m", "inertia")
_NONE = 1e-3
"""Share of a tolerance that is as good as none; more exactly, it would not be positive."""
_FULL = 1e6
"""Values of a cell's discrepancy at which all beyond the noise counts at full weight."""
_NEVER = -1e300


def value_of(name: str) -> float:
    """Number as shipped."""
    module, _, constant = name.rpartition(".")
    return getattr(import_module(f"{PACKAGE}.{module}"), constant)  # type: ignore[no-any-return]


def tried(name: str) -> tuple[float, float]:
    """Values of a number that are tried; whole numbers stay whole."""
    value = value_of(name)
    half = max(round(value / 2), 1) if isinstance(value, int) else value / 2
    return TRIED.get(name, (half, 2 * value))


def _everywhere(name: str, value: float) -> Changes:
    """The change of a number where it is defined, and where it is imported."""
    import_module(f"{PACKAGE}.explain")  # the whole way, from recording to result
    constant, known = name.rpartition(".")[2], value_of(name)
    if constant.startswith("_"):
        return {name: value}
    return {
        f"{module.removeprefix(PACKAGE + '.')}.{constant}": value
        for module, there in sorted(sys.modules.items())
        if module.startswith(f"{PACKAGE}.") and vars(there).get(constant) is known
    }


def variants() -> dict[str, Changes]:
    """Changes by name of the variant: five parts left out, tolerances and numbers changed."""
    tolerances = asdict(GapSettings().tolerances)

    def times(factor: float, names: Sequence[str]) -> Changes:
        return {f"tolerances.{name}": factor * tolerances[name] for name in names}

    found: dict[str, Changes] = {
        "without rigid nuisances": times(_NONE, _RIGID),
        "without discrepancy": _everywhere("core.selection.SHARE_VALUES", _FULL),
        "without command shift": times(_NONE, ["shift_samples"]),
        "without exact fit": {"settings.simulate": False},
        "without held-out decision": {
            "core.decision.HELD_OUT": _NEVER, "core.decision.CONTRADICTED": _NEVER,
        },
        "all tolerances x0.5": times(0.5, list(tolerances)),
        "all tolerances x2": times(2.0, list(tolerances)),
    }  # fmt: skip
    for name in NUMBERS:
        found |= {f"{name}={value:g}": _everywhere(name, value) for value in tried(name)}
    return found


def changes_of(name: str) -> Changes:
    """Changes of a variant, by its name."""
    known = variants()
    if name not in known:
        raise InvalidSetting(f"no variant {name!r}; there are {', '.join(known)}")
    return known[name]


def changed(name: str) -> dict[str, Any]:
    """Set the numbers of a variant in this process; settings that `explain_gap` gets for it."""
    settings: dict[str, Any] = {}
    tolerances = GapSettings().tolerances
    for key, value in changes_of(name).items():
        module, _, own = key.rpartition(".")
        if module == "tolerances":
            tolerances = replace(tolerances, **{own: value})
        elif module == "settings":
            settings[own] = value
        else:
            setattr(import_module(f"{PACKAGE}.{module}"), own, value)
    return {"tolerances": tolerances, **settings}


def chosen(prefixes: Sequence[str]) -> list[str]:
    """Names of the variants that begin with one of some words, of all for none."""
    names = [name for name in variants() if not prefixes or name.startswith(tuple(prefixes))]
    if not names:
        raise InvalidSetting(
            f"no variant begins with {prefixes}; there are {', '.join(variants())}"
        )
    return names


# ---------------------------------------------------------------------------------- tables


def _counted(rows: Sequence[Row], roles: Sequence[str], what: str) -> str:
    """How many of the cases of some roles are right, or of their effects are found."""
    own = [row for row in rows if row["role"] in roles]
    hits = [hit for row in own for hit in (row["found"] if what == "found" else [row["right"]])]
    return f"{sum(hits)}/{len(hits)}" if hits else "none"


def differences(rows: Sequence[Row], shipped: Sequence[Row]) -> list[str]:
    """Names that a variant says beside those as shipped, and those that it lacks, by case."""
    known = {row["number"]: row for row in shipped}
    found = []
    for row in rows:
        now, before = ({"@".join(n) for n in r["said"]} for r in (row, known[row["number"]]))
        words = [f"+{name}" for name in sorted(now - before)]
        words += [f"-{name}" for name in sorted(before - now)]
        if row["error"]:
            words = [f"failed: {row['error']}"]
        if words:
            found.append(f"{row['number']}: {' '.join(words)}")
    return found


def ablation_table(shipped: Sequence[Row], rows: Mapping[str, Sequence[Row]]) -> str:
    """Table of the variants in Markdown, each on the same cases as the method as shipped."""
    lines = [
        "| variant | one effect, right | several, recall | nothing named | outside, said so "
        "| false names | cases with other names | CPU, median |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, own in {"as shipped": shipped, **rows}.items():
        whole = "" if len(own) == len(shipped) else f" ({len(own)} of {len(shipped)} cases)"
        cells = [f"{name}{whole}", _counted(own, ["one"], "right")]
        cells += [_counted(own, ["two", "many"], "found"), _counted(own, ["none"], "right")]
        cells += [_counted(own, ["outside"], "right"), str(sum(len(r["false"]) for r in own))]
        cells.append(f"{len(differences(own, shipped))}/{len(own)}")
        cells.append(f"{np.median([row.get('cpu', np.nan) for row in own]):.0f} s")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def summary(
    shipped: Sequence[Row], rows: Mapping[str, Sequence[Row]], *, of: int, most_seconds: float
) -> str:
    """Caption, table, and the names that differ."""
    limit = f"{most_seconds:g} s of CPU time or less"
    words = [f"{len(shipped)} of {of} cases, those that took {limit} as shipped.", ""]
    words += [ablation_table(shipped, rows), ""]
    for name, own in rows.items():
        if found := differences(own, shipped):
            words.append(f"- {name}: {'; '.join(found)}")
    return "\n".join(words).rstrip() + "\n"
