"""Calibrate the probabilities of `loose gap` on cases of the suite, and judge them on others.

python -m scripts.suites.gap.calibrate --collect 1400-1440 2140-2160 --out FOLDER
python -m scripts.suites.gap.calibrate --fit FOLDER [FOLDER ...] --judge FOLDER [FOLDER ...]

Folders are those of --collect, or of `scripts.suites.gap.run --out`. With --fit the map in the
package is replaced; with --judge alone the one that is there is judged.

Most effects that are named are right, and a map needs wrong ones, too. --collect therefore runs the
tool with a small catalogue, drawn for each case: ten kinds, and in one case of four a true one is
not among them, so that what is named is a stand-in for it.
"""

from __future__ import annotations

import argparse
import itertools
import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.execution.study import write_between
from scipy.optimize import minimize

from loose_env.errors import InvalidSetting
from loose_env.gap import (
    PROBABILITY_FEATURES,
    GapResult,
    GapSettings,
    NamedEffect,
    ProbabilityMap,
    find_gap,
    probability_features,
    read_result,
    result_of,
    stored_map,
)
from loose_env.io import json_text, write_text
from loose_env.recording import read_recording
from loose_env.typing import Array
from scripts.suites.gap.cases.draw import draw_case, tolerance_of
from scripts.suites.gap.cases.recordings import runs_of, write_runs
from scripts.suites.gap.effects.catalogue import CATALOGUE
from scripts.suites.gap.run import numbers_of

__all__ = ["Judged", "calibration_table", "collect", "fitted_map", "main"]

ROOT = Path(__file__).resolve().parents[3]
MAP = ROOT / "loose_env/gap/output/probability_map.json"
DOCS = ROOT / "docs/gap_suite.md"
_SEED = 77
"""Seed of the catalogues."""
_KINDS, _LACKING = 10, 0.25
"""Kinds of a small catalogue, and share of the cases in which it lacks a true one."""
_SLOW = ("structural_looseness", "backlash")
"""Kinds that are left out where they are not true: cost."""
_PRIOR = 2.0
"""Standard deviation of a weight's prior."""
_BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 1.0)
"""Bins of the table."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Effects of some cases: what the map reads of each, and whether it was right."""

    features: Array
    """(E, F)."""
    right: Array
    """(E,), 1 or 0."""


def collect(number: int, folder: Path) -> None:
    """Run the tool on a case with a small catalogue, and store what it said and what is true."""
    rng = np.random.default_rng(np.random.SeedSequence([_SEED, number]))
    case = draw_case(number)
    truth = [(effect.kind, effect.place.name) for effect in case.arm.effects]
    true = list(dict.fromkeys(kind for kind, _ in truth))
    lacking = {str(rng.choice(true))} if rng.random() < _LACKING else set()
    others = [kind for kind in CATALOGUE if kind not in {*true, *_SLOW}]
    drawn = [str(kind) for kind in rng.choice(others, _KINDS - len(true), replace=False)]
    kinds = tuple(kind for kind in (*true, *drawn) if kind not in lacking)
    settings = GapSettings(threads=1, tolerance=tolerance_of(number), kinds=kinds)
    with tempfile.TemporaryDirectory() as place:
        recording = write_runs(Path(place) / "recording", case, runs_of(case))
        result = result_of(find_gap(read_recording(recording), settings))
    name = f"case-{number}"
    result.write(folder / "results" / name / "result.json")
    right = {(effect.kind, effect.where) for effect in result.effects} == set(truth)
    row = {"case": name, "error": "", "grade": {"truth": truth, "right": right}}
    write_text(folder / "rows" / f"shard-{number}.json", json_text({"rows": [row]}))


def read_cases(folders: Sequence[Path]) -> Judged:
    """Effects of the finished cases of some folders, named and doubtful ones."""
    found, right = [], []
    for folder in folders:
        rows = sorted((folder / "rows").glob("shard-*.json"))
        if not rows:
            raise InvalidSetting(f"{folder} has no finished cases; run the suite into it first")
        for file in rows:
            for row in json.loads(file.read_text(encoding="utf-8"))["rows"]:
                if row["error"]:
                    continue
                result = read_result(folder / "results" / row["case"])
                truth = {tuple(each) for each in row["grade"]["truth"]}
                for effect, true in _effects(result, truth, whole=row["grade"]["right"]):
                    found.append(_features(effect, result))
                    right.append(float(true))
    return Judged(np.array(found).reshape(-1, len(PROBABILITY_FEATURES)), np.array(right))


def _effects(
    result: GapResult, truth: set[tuple[str, ...]], *, whole: bool
) -> list[tuple[NamedEffect, bool]]:
    """Effects with a deletion test, and whether each is right; all are where the case is."""
    named = [(e, whole or (e.kind, e.where) in truth) for e in result.effects]
    doubtful = [(e, (e.kind, e.where) in truth) for e in result.doubtful]
    return [each for each in (*named, *doubtful) if each[0].deletion is not None]


def _features(effect: NamedEffect, result: GapResult) -> Array:
    assert effect.deletion is not None
    return probability_features(effect.deletion, rivals=len(effect.ambiguous_with), gap=result.gap)


def fitted_map(judged: Judged) -> ProbabilityMap:
    """Logistic map of the largest posterior, each weight of its known sign.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> values = rng.normal(size=(400, len(PROBABILITY_FEATURES)))
    >>> right = (rng.random(400) < 1 / (1 + np.exp(-1 - 2 * values[:, 1]))).astype(float)
    >>> found = fitted_map(Judged(values, right))
    >>> round(found.offset), round(found.weights[1])
    (1, 2)
    """
    design = np.column_stack([np.ones(len(judged.right)), judged.features])

    def cost(weights: Array) -> tuple[float, Array]:
        odds = design @ weights
        chance = 1 / (1 + np.exp(-odds))
        loss = np.sum(np.logaddexp(0, odds) - judged.right * odds)
        shrunk = weights / _PRIOR**2
        return float(loss + 0.5 * weights @ shrunk), design.T @ (chance - judged.right) + shrunk

    bounds = [
        (None, None),
        *((0, None) if sign > 0 else (None, 0) for _, sign in PROBABILITY_FEATURES),
    ]
    best = minimize(cost, np.zeros(design.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    return ProbabilityMap(
        offset=float(best[0]),
        weights=tuple(float(w) for w in best[1:]),
        effects=len(judged.right),
        right=int(judged.right.sum()),
    )


def calibration_table(judged: Judged, probability: Array) -> str:
    """Table of said probability against share right, and the expected calibration error."""
    lines = ["| said | effects | mean said | right |", "|---|---:|---:|---:|"]
    off = 0.0
    for low, high in itertools.pairwise(_BINS):
        own = (probability > low) & (probability <= high)
        if not own.any():
            continue
        said, true = float(probability[own].mean()), float(judged.right[own].mean())
        off += abs(said - true) * float(own.mean())
        lines.append(f"| {low:.2f} to {high:.2f} | {own.sum()} | {said:.2f} | {true:.2f} |")
    brier = float(np.mean((probability - judged.right) ** 2))
    lines += [
        "",
        f"{len(judged.right)} effects of fresh cases; expected calibration error {off:.3f}, Brier "
        f"score {brier:.3f}.",
    ]
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(prog="calibrate", description=__doc__)
    parser.add_argument("--fit", type=Path, nargs="+", default=[], help="folders to fit the map to")
    parser.add_argument("--judge", type=Path, nargs="+", default=[], help="folders to judge by")
    parser.add_argument("--collect", nargs="+", metavar="CASE", default=[], help="cases to run")
    parser.add_argument("--out", type=Path, help="folder of the cases that are run")
    parser.add_argument("--docs", action="store_true", help="write the table into the docs")
    given = parser.parse_args(words)
    if bool(given.collect) != (given.out is not None):
        parser.error("--collect and --out go together: cases to run, and where they are stored")
    if not (given.collect or given.judge):
        parser.error("give cases to --collect, or folders to --judge")
    with errors_in_one_line("calibrate", interrupted="the same command goes on"):
        for number in numbers_of(given.collect):
            if not (given.out / "rows" / f"shard-{number}.json").exists():
                collect(number, given.out)
                print(f"case {number} done", flush=True)
        if not given.judge:
            return
        if given.fit:
            write_text(MAP, json_text(asdict(fitted_map(read_cases(given.fit)))))
            stored_map.cache_clear()
        judged = read_cases(given.judge)
        table = calibration_table(judged, stored_map().probability(judged.features))
        if given.docs:
            write_between(DOCS, table, name="calibration")
        print(table)


if __name__ == "__main__":
    main()
