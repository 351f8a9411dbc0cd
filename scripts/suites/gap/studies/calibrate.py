"""Calibrate probabilities and intervals of `loose gap` on cases of the suite.

python -m scripts.suites.gap.studies.calibrate --take FOLDER [FOLDER ...]
python -m scripts.suites.gap.studies.calibrate --fit --docs

Folders are those of `scripts.suites.gap.run --out`. Taken cases are lines of
docs/gap_evidence.jsonl: what each effect of an answer was judged by, whether the machine has it,
and by what factor each interval would hold the truth. What is stored with the package is fitted to
all cases; it is judged case by case, each by what is fitted to all others.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from loose_env.cli.command import errors_in_one_line
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.evaluation import expected_calibration_error, reliability
from loose_env.gap import (
    PROBABILITY_FEATURES,
    GapCalibration,
    GapResult,
    interval_score,
    probability_features,
    read_result,
    stored_calibration,
)
from loose_env.io import json_text, restored, write_text, written_beside
from loose_env.recording import read_text
from loose_env.typing import Array
from scripts.study import write_between
from scripts.suites.gap.grading.parameters import judged_intervals

__all__ = ["CaseEvidence", "EffectEvidence", "fitted", "judged_text", "main", "taken"]

ROOT = Path(__file__).resolve().parents[4]
EVIDENCE = ROOT / "docs/gap_evidence.jsonl"
STORED = ROOT / "loose_env/gap/output/calibration.json"
DOCS = ROOT / "docs/gap_suite.md"
FIGURE = ROOT / "docs/figures/gap_calibration.svg"
_PRIOR = 0.7
"""Standard deviation of a weight's prior, by standard deviation of its feature: with some tens of
wrong effects a map that follows every feature is too sure."""
_COVERAGE = 0.95
_BINS = 10
_MOST_BYTES = 20_000_000
_MOST = 1e6
"""Score in place of infinity, which JSON does not have."""
_WITH_STOPS = ("structural_looseness", "backlash")
"""Kinds whose intervals get no factor."""


@dataclass(frozen=True, kw_only=True)
class EffectEvidence:
    """An effect of an answer, beside the truth."""

    kind: str
    where: str
    named: bool
    """Whether it was named; else it was held for doubtful."""
    right: bool
    """Whether the machine has it, or one that data do not tell from it."""
    features: tuple[float | None, ...]
    """Of `PROBABILITY_FEATURES`; None where a part found by impacts has no such test."""
    main: tuple[float, ...] = ()
    """Least factor on the interval of each parameter that sizes it, to hold the truth."""
    further: tuple[float, ...] = ()
    """The same of parameters that shape it."""


@dataclass(frozen=True, kw_only=True)
class CaseEvidence:
    """A case of the suite that the tool was run on."""

    number: int
    role: str
    effects: tuple[EffectEvidence, ...]


def taken(folder: Path) -> list[CaseEvidence]:
    """Evidence of the finished cases of a run of the suite.

    Parameters
    ----------
    folder : Path
        The run's ``--out``, with its truths in ``blind``.

    Raises
    ------
    InvalidSetting
        If it has no finished cases, or the truth of one is not there.
    """
    found = []
    for file in sorted((folder / "rows").glob("shard-*.json")):
        for row in json.loads(file.read_text(encoding="utf-8"))["rows"]:
            if row["error"]:
                continue
            result = read_result(folder / "results" / row["case"])
            file_of_truth = folder / f"blind/truth/{row['case']}.json"
            if not file_of_truth.is_file():
                raise InvalidSetting(
                    f"{folder}: the truth of {row['case']} is not there ({file_of_truth}); run the "
                    f"suite with --blind {folder / 'blind'}"
                )
            truth = json.loads(file_of_truth.read_text("utf-8"))
            found.append(
                CaseEvidence(
                    number=row["number"],
                    role=row["role"],
                    effects=tuple(_effects(result, truth["effects"], row["grade"]["right"])),
                )
            )
    if not found:
        raise InvalidSetting(f"{folder} has no finished cases; run the suite into it first")
    return found


def _effects(
    result: GapResult, truths: Sequence[dict[str, Any]], whole: bool
) -> Iterable[EffectEvidence]:
    """Named and doubtful effects; the named ones are right where the case is."""
    true = {(str(t["kind"]), str(t["where"])): t for t in truths}
    for effects, named in ((result.effects, True), (result.doubtful, False)):
        for effect in effects:
            own = true.get((effect.kind, effect.where))
            scores: dict[bool, list[float]] = {True: [], False: []}
            apart = own is None or effect.kind in _WITH_STOPS
            for each in [] if own is None or apart else judged_intervals(own, asdict(effect)):
                score = interval_score(each.value, each.interval, each.truth)
                factor = result.interval_factors.get("size" if each.main else "shape", 1.0)
                scores[each.main].append(min(score * factor, _MOST))
            features = probability_features(effect, result.gap)
            yield EffectEvidence(
                kind=effect.kind,
                where=effect.where,
                named=named,
                right=own is not None or (named and whole and bool(truths)),
                features=tuple(float(f) if np.isfinite(f) else None for f in features),
                main=tuple(scores[True]),
                further=tuple(scores[False]),
            )


def read_evidence(path: Path = EVIDENCE) -> list[CaseEvidence]:
    """Cases of the file.

    Raises
    ------
    InvalidData
        If a line is none of a case.
    """
    if not path.exists():
        return []
    found = []
    for number, line in enumerate(read_text(path, path.name, _MOST_BYTES).splitlines(), start=1):
        try:
            found.append(restored(CaseEvidence, json.loads(line), "case"))
        except ValueError as error:
            raise InvalidData(f"{path}, line {number} is no case: {error}") from None
    return found


def add_evidence(cases: Sequence[CaseEvidence], path: Path = EVIDENCE) -> int:
    """Put cases into the file, in place of those of the same numbers; return how many it has."""
    by_number = {case.number: case for case in (*read_evidence(path), *cases)}
    lines = [json.dumps(asdict(by_number[n]), ensure_ascii=False) for n in sorted(by_number)]
    text = "\n".join(lines) + "\n"
    written_beside(path, lambda beside: beside.write_text(text, encoding="utf-8") and None)
    return len(lines)


def _features(effects: Sequence[EffectEvidence]) -> tuple[Array, Array]:
    """Features (E, F) with NaN where there are none, and whether each is right (E,)."""
    rows = [[np.nan if f is None else f for f in e.features] for e in effects]
    features = np.array(rows, dtype=float).reshape(-1, len(PROBABILITY_FEATURES))
    return features, np.array([float(e.right) for e in effects])


def fitted(cases: Sequence[CaseEvidence]) -> GapCalibration:
    """Logistic map of the largest posterior, each weight of its known sign, and interval factors.

    A factor is the conformal quantile: of n scores the ceil(0.95 (n + 1))-th smallest; of fewer
    than 19 the largest, with which n / (n + 1) are expected to hold the truth.

    Raises
    ------
    InvalidSetting
        If the cases have no parameters.
    """
    effects = [e for case in cases for e in case.effects]
    features, right = _features(effects)
    mean = np.nanmean(features, axis=0)
    deviation = np.maximum(np.nanstd(features, axis=0), 1e-6)
    standard = np.nan_to_num((features - mean) / deviation)
    design = np.column_stack([np.ones(len(right)), standard])
    precision = np.array([0.0, *np.full(standard.shape[1], _PRIOR**-2)])

    def cost(weights: Array) -> tuple[float, Array]:
        odds = design @ weights
        chance = 1 / (1 + np.exp(-odds))
        loss = np.sum(np.logaddexp(0, odds) - right * odds)
        shrunk = precision * weights
        return float(loss + 0.5 * weights @ shrunk), design.T @ (chance - right) + shrunk

    signs = [(0, None) if sign > 0 else (None, 0) for _, sign in PROBABILITY_FEATURES]
    start = np.zeros(design.shape[1])
    best = minimize(cost, start, jac=True, bounds=[(-5, 5), *signs], method="L-BFGS-B").x
    sizes = np.sort([s for e in effects for s in e.main])
    shapes = np.sort([s for e in effects for s in e.further])
    if not len(sizes):
        raise InvalidSetting("the cases have no parameters whose truth is known; take more cases")
    return GapCalibration(
        offset=float(best[0]),
        weights=tuple(float(w) for w in best[1:]),
        mean=tuple(map(float, mean)),
        deviation=tuple(map(float, deviation)),
        effects=len(right),
        right=int(right.sum()),
        size_factor=_conformal(sizes),
        shape_factor=_conformal(shapes),
        sizes=len(sizes),
        shapes=len(shapes),
    )


def _conformal(scores: Array) -> float:
    """Factor with which 95 % of new intervals hold the truth, at least 1; the largest of few."""
    if not len(scores):
        return 1.0
    rank = min(int(np.ceil(_COVERAGE * (len(scores) + 1))), len(scores))
    return max(1.0, float(scores[rank - 1]))


@dataclass(frozen=True, eq=False)
class Judged:
    """Effects and intervals of all cases, each judged by what was fitted to all other cases."""

    said: Array
    """Probability of each effect (E,)."""
    right: Array
    """Whether it is right (E,), 1 or 0."""
    scores: Array
    """Least factor of each interval to hold the truth (P,)."""
    factors: Array
    """Factor that it got (P,)."""
    sizes: NDArray[np.bool_]
    """Whether its parameter sizes the effect (P,)."""


def left_out(cases: Sequence[CaseEvidence]) -> Judged:
    """Judge every case by a calibration on all others."""
    said: list[float] = []
    right: list[float] = []
    intervals: list[tuple[float, float, bool]] = []
    for k, case in enumerate(cases):
        if not case.effects:
            continue
        found = fitted([*cases[:k], *cases[k + 1 :]])
        features, own = _features(case.effects)
        said += found.probability(features).tolist()
        right += own.tolist()
        for effect in case.effects:
            intervals += [(score, found.size_factor, True) for score in effect.main]
            intervals += [(score, found.shape_factor, False) for score in effect.further]
    scores, factors, sizes = (np.array(column) for column in zip(*intervals, strict=True))
    return Judged(np.array(said), np.array(right), scores, factors, sizes.astype(bool))


def judged_text(judged: Judged, cases: int, calibration: GapCalibration) -> str:
    """Tables of said probability against share right, and of intervals that hold the truth."""
    found = reliability(judged.said, judged.right, bins=_BINS)
    lines = [
        f"{len(judged.said)} effects of {cases} cases, {int(judged.right.sum())} of them "
        "right; each judged by what is fitted to the other cases.",
        "",
        "| probability | effects | right |",
        "|---:|---:|---:|",
    ]
    for mean, share, count in zip(found.confidence, found.right, found.count, strict=True):
        lines.append(f"| {mean:.2f} | {count} | {share:.2f} |")
    brier = float(np.mean((judged.said - judged.right) ** 2))
    error = expected_calibration_error(judged.said, judged.right, bins=_BINS)
    lines += [
        "",
        f"Expected calibration error {error:.3f} ({_BINS} bins), Brier score {brier:.3f}.",
        "",
        "| intervals that hold the truth | without a factor | with the factor | factor |",
        "|---|---:|---:|---:|",
    ]
    for name, sizes, factor in (
        ("parameters that size an effect", True, calibration.size_factor),
        ("parameters that shape it", False, calibration.shape_factor),
    ):
        own = judged.sizes == sizes
        before = int((judged.scores[own] <= 1.0).sum())
        after = int((judged.scores[own] <= judged.factors[own]).sum())
        count = int(own.sum())
        if count:
            lines.append(f"| {name} | {_of(before, count)} | {_of(after, count)} | {factor:.2f} |")
    return "\n".join(lines)


def _of(part: int, whole: int) -> str:
    return f"{part} of {whole} = {100 * part / whole:.0f} %"


def draw(judged: Judged, path: Path) -> Path:
    """Draw the reliability of the probabilities."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams["svg.hashsalt"] = "gap"
    from matplotlib.figure import Figure

    found = reliability(judged.said, judged.right, bins=_BINS)
    figure = Figure(figsize=(4.2, 3.8), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1, label="calibrated")
    spread = 1.96 * np.sqrt(found.confidence * (1 - found.confidence) / found.count)
    low, high = np.minimum(spread, found.right), np.minimum(spread, 1 - found.right)
    axes.errorbar(
        found.confidence, found.right, yerr=[low, high], fmt="o", capsize=3, label="effects"
    )
    for x, y, count in zip(found.confidence, found.right, found.count, strict=True):
        axes.annotate(f"{count}", (x, y), textcoords="offset points", xytext=(6, -10), fontsize=8)
    axes.set(xlabel="probability given", ylabel="share of effects that are right")
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02))
    axes.legend(loc="upper left", frameon=False)
    return written_beside(
        path, lambda beside: figure.savefig(beside, format="svg", metadata={"Date": None})
    )


def main(words: Sequence[str] | None = None) -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--take", type=Path, nargs="+", default=[], help="runs of the suite")
    parser.add_argument("--evidence", type=Path, default=EVIDENCE, help="file of taken cases")
    parser.add_argument("--fit", action="store_true", help="fit to all cases, and store")
    parser.add_argument("--docs", action="store_true", help="write tables and figure to the docs")
    given = parser.parse_args(words)
    with errors_in_one_line("calibrate", interrupted="nothing was changed"):
        if given.take:
            count = add_evidence([c for f in given.take for c in taken(f)], given.evidence)
            print(f"{given.evidence} has {count} cases")
        cases = read_evidence(given.evidence)
        if sum(bool(case.effects) for case in cases) < 2:
            raise InvalidSetting("two cases with effects are needed at least; take some")
        if given.fit:
            write_text(STORED, json_text(asdict(fitted(cases))))
            stored_calibration.cache_clear()
        judged = left_out(cases)
        text = judged_text(judged, len(cases), stored_calibration())
        print(text)
        if given.docs:
            write_between(DOCS, text, name="calibration")
            draw(judged, FIGURE)


if __name__ == "__main__":
    main()
