r"""Ablation of `loose gap`: the suite again with one thing changed at a time.

`NUMBERS` is the one list of numbers that decide what is named. Each is halved and doubled, and five
parts of the method are left out. Each variant is a tool of its own, ``loose_gap@VARIANT``, with its
own rows; those of the method as shipped are the suite's.

    python -m scripts.suites.gap.run --numbers 0-59 --ablate --most-seconds 20
    python -m scripts.suites.gap.run --numbers 0-59 --ablate without core.decision --show
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
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


@dataclass(frozen=True, kw_only=True)
class Number:
    """A number that decides what is named."""

    name: str
    """Module in the package, and constant."""
    unit: str
    reason: str
    """Why it has this value, from outside."""
    tried: tuple[float, float] | None = None
    """Values in place of its half and its double, where these have no meaning."""

    @property
    def value(self) -> float:
        """Value as shipped."""
        module, _, constant = self.name.rpartition(".")
        return getattr(import_module(f"{PACKAGE}.{module}"), constant)  # type: ignore[no-any-return]

    def values(self) -> tuple[float, float]:
        """Values that are tried; whole numbers stay whole."""
        if self.tried is not None:
            return self.tried
        half = self.value / 2
        return (max(round(half), 1) if isinstance(self.value, int) else half, 2 * self.value)

    def places(self) -> list[str]:
        """Everywhere that the number is known: where it is defined, and where it is imported."""
        import_module(f"{PACKAGE}.explain")  # the whole way, from recording to result
        constant = self.name.rpartition(".")[2]
        if constant.startswith("_"):
            return [self.name]
        return sorted(
            f"{name.removeprefix(PACKAGE + '.')}.{constant}"
            for name, module in sys.modules.items()
            if name.startswith(PACKAGE) and vars(module).get(constant) is self.value
        )


NUMBERS: tuple[Number, ...] = (
    # prior
    Number(name="core.selection.KIND", unit="−2 ln prior",
           reason="one kind of effect in 150 is missing: a model in four lacks one of 36"),
    Number(name="core.selection.FORM", unit="−2 ln prior",
           reason="one friction in ten has more than the simplest form"),
    Number(name="core.catalogue.LAW_WIDTH", unit="share",
           reason="a shape midway between two that are tried, ln(1.7) / 2 away, is two widths off"),
    Number(name="core.catalogue.USUAL_SHARE", unit="of the drive's force",
           reason="an effect matters, and does not rule"),
    # noise and discrepancy
    Number(name="core.evidence._NOISE", unit="of the estimate", tried=(1.05, 1.2),
           reason="filters and rounding colour noise, which is taken for white, by some per cent"),
    Number(name="core.selection.LEAST_VALUES", unit="values a cell",
           reason="a discrepancy that repeats has an amplitude, and half a number for its shape"),
    Number(name="core.selection.SHARE_VALUES", unit="of a cell's values",
           reason="and repeats to some per cent"),
    Number(name="core.evidence.BANDS", unit="bands",
           reason="three or four a decade: motion, its harmonics and resonances lie apart"),
    Number(name="core.evidence.STRETCHES", unit="stretches",
           reason="two of each of four runs: whether a residual repeats"),
    Number(name="core.evidence._SHORTEST_S", unit="s",
           reason="some periods of slow motion in each stretch"),
    # data that are left out
    Number(name="core.evidence.KNOCK", unit="of the median square",
           reason="four times the usual amplitude is no motion of the machine's own"),
    Number(name="core.evidence._REST", unit="of the speed",
           reason="below, presliding: dry friction takes any value"),
    Number(name="core.motion.HIGHEST_HZ", unit="Hz",
           reason="structural modes of any arm lie above"),
    Number(name="core.catalogue._MOVING", unit="noise sd",
           reason="a range of motion beyond drift and rounding of an encoder at rest"),
    Number(name="core.balance._MOST_LOAD", unit="of the load", tried=(0.45, 0.95),
           reason="with more friction by load a drive would lock"),
    # exact fits
    Number(name="core.exact.WINDOW_S", unit="s",
           reason="some periods of a joint's motion, before errors of the start have grown"),
    Number(name="core.exact.LEAD_S", unit="s",
           reason="longer than most drives are late"),
    Number(name="core.exact.LARGE", unit="noise sd",
           reason="three standard deviations: 1 in 370 by chance"),
    Number(name="core.exact.EXPLAINED", unit="of the power", tried=(0.8, 0.95),
           reason="less than a third of the amplitude is left"),
    # decision
    Number(name="core.decision.NAMED", unit="probability", tried=(0.25, 0.75),
           reason="as likely as not"),
    Number(name="core.decision._Z", unit="sd", tried=(1.64, 2.58),
           reason="95 of 100 intervals contain the true value"),
    Number(name="core.decision.HELD_OUT", unit="2 ln likelihood",
           reason="positive evidence (Kass and Raftery 1995)"),
    Number(name="core.decision.CONTRADICTED", unit="2 ln likelihood",
           reason="very strong evidence (Kass and Raftery 1995)"),
    Number(name="core.decision._NOISE", unit="noise sd", tried=(1.3, 2.4),
           reason="noise alone where its estimate is a third too small needs no effect"),
)  # fmt: skip
"""The numbers that decide, in the order of the method; half and double of each are tried."""

_RIGID = ("mass", "centre", "centre_m", "inertia")
_NONE = 1e-3
"""Share of a tolerance that is as good as none; more exactly, it would not be positive."""
_FULL = 1e6
"""Values of a cell's discrepancy at which all beyond the noise counts at full weight."""
_NEVER = -1e300


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
    for number in NUMBERS:
        for value in number.values():
            found[f"{number.name}={value:g}"] = _everywhere(number.name, value)
    return found


def _everywhere(name: str, value: float) -> Changes:
    """The change of a number in all modules that know it."""
    number = next(own for own in NUMBERS if own.name == name)
    return dict.fromkeys(number.places(), value)


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
        cells = [
            f"{name}{whole}",
            _counted(own, ["one"], "right"),
            _counted(own, ["two", "many"], "found"),
            _counted(own, ["none"], "right"),
            _counted(own, ["outside"], "right"),
            str(sum(len(row["false"]) for row in own)),
            f"{len(differences(own, shipped))}/{len(own)}",
            f"{np.median([row.get('cpu', np.nan) for row in own]):.0f} s",
        ]
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


def numbers_table() -> str:
    """Table of the numbers that decide in Markdown, with unit and reason."""
    lines = ["| number | value | unit | reason | also tried |", "|---|---|---|---|---|"]
    for own in NUMBERS:
        tried = ", ".join(f"{value:g}" for value in own.values())
        name = own.name.removeprefix("core.")
        lines.append(f"| `{name}` | {own.value:g} | {own.unit} | {own.reason} | {tried} |")
    return "\n".join(lines)
