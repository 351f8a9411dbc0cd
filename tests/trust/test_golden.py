"""The same seeds give the same figures: on any number of threads, and in every release."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("safetensors")

from loose_env.errors import InvalidSetting
from scripts.suites.trust.golden import GOLDEN, PARTS
from scripts.suites.trust.golden_run import check_said, renewed

ROOT = Path(__file__).resolve().parents[2]
CHANGELOG = ROOT / "CHANGELOG.md"
MEANT = (
    "the same seeds give other figures than before. If that is not meant, something broke. If it "
    "is, put a line into CHANGELOG.md and run: "
    "python -m scripts.suites.trust.golden_run --because 'that line'"
)
# Another processor may round another way, and a simulation carries that on.
RELATIVE, ABSOLUTE = 1e-4, 1e-5
FITTED = 2e-2  # a search ends where it no longer gains
SEARCHED = ("gap", "instrument")


@pytest.fixture(scope="module")
def golden() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(GOLDEN.read_text(encoding="utf-8"))
    return found


@cache
def figures(part: str) -> Any:
    """The figures of a part, worked out in this process."""
    return PARTS[part]()


def differences(kept: Any, now: Any, place: str, relative: float) -> list[str]:
    """Places where two trees differ; numbers by more than rounding."""
    if isinstance(kept, dict) and isinstance(now, dict):
        if kept.keys() != now.keys():
            return [f"{place}: {sorted(kept)} before, {sorted(now)} now"]
        parts = [differences(kept[k], now[k], f"{place}.{k}", relative) for k in kept]
        return [each for part in parts for each in part]
    if isinstance(kept, list) and isinstance(now, list):
        if len(kept) != len(now):
            return [f"{place}: {len(kept)} before, {len(now)} now"]
        both = zip(kept, now, strict=True)
        parts = [differences(a, b, f"{place}[{i}]", relative) for i, (a, b) in enumerate(both)]
        return [each for part in parts for each in part]
    if isinstance(kept, float) and isinstance(now, (int, float)):
        if np.isclose(now, kept, rtol=relative, atol=ABSOLUTE, equal_nan=True):
            return []
    elif kept == now:
        return []
    return [f"{place}: {kept} before, {now} now"]


@pytest.mark.parametrize("part", PARTS)
def test_the_same_seeds_give_the_same_figures_in_every_release(
    golden: dict[str, Any], part: str
) -> None:
    now = json.loads(json.dumps(figures(part)))
    found = differences(golden[part]["found"], now, part, FITTED if part in SEARCHED else RELATIVE)
    assert not found, f"{MEANT}\n" + "\n".join(found[:10])


@pytest.mark.parametrize("part", PARTS)
def test_a_change_of_golden_results_has_its_line_in_the_changelog(
    golden: dict[str, Any], part: str
) -> None:
    said = " ".join(CHANGELOG.read_text(encoding="utf-8").split())
    because = " ".join(golden[part]["because"].split())
    assert because and because in said, f"CHANGELOG.md does not say {because!r}"


@pytest.mark.parametrize("part", ["environments", "comparison", "gap"])
def test_one_thread_and_many_give_the_same_to_the_last_digit(part: str) -> None:
    make: Any = PARTS[part]
    assert figures(part) == make(threads=3)


def test_threads_of_the_linear_algebra_change_no_digit_of_a_diagnosis() -> None:
    """They add up in another order: what comes out may differ in the last digits alone."""
    code = (
        "import json; from scripts.suites.trust.golden import instrument; "
        "print(json.dumps(instrument()))"
    )
    found = []
    for threads in ("1", "3"):
        env = os.environ | {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        command = [sys.executable, "-W", "ignore", "-c", code]
        done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout))
    assert differences(found[0], found[1], "instrument", RELATIVE) == []


ANOTHER = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX",
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX2 "
    "FMA3",
}
"""Makes the libraries of this processor round as an older one does, where they can be asked to."""


@pytest.mark.skipif(sys.platform != "linux", reason="asks the C library of Linux")
@pytest.mark.parametrize("part", ["environments", "comparison", "diagnosis"])
def test_a_processor_that_rounds_another_way_gives_the_same_figures(part: str) -> None:
    code = (
        f"import json; from scripts.suites.trust.golden import {part} as part; "
        "print(json.dumps(part()))"
    )
    command = [sys.executable, "-W", "ignore", "-c", code]
    env = os.environ | ANOTHER
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    now = json.loads(json.dumps(figures(part)))
    assert differences(now, json.loads(done.stdout), part, RELATIVE) == []


CHANGES = """# Changelog

## [0.2.0] - unreleased

- The step is finer:
  figures of the gap differ.

## [0.1.0] - 2026-01-01

- An old line.
"""


def test_a_change_of_golden_results_takes_a_new_line_under_what_is_unreleased() -> None:
    check_said("The step is finer: figures of the gap differ.", CHANGES)
    for old in ("An old line.", "", "Nobody wrote this."):
        with pytest.raises(InvalidSetting, match="under what is unreleased"):
            check_said(old, CHANGES)
    kept = {"because": "The step is finer: figures of the gap differ.", "found": [1.0]}
    assert renewed("gap", kept, [1.0], "another") == kept
    assert renewed("gap", kept, [2.0], "another") == {"because": "another", "found": [2.0]}
    assert renewed("gap", None, [2.0], "first") == {"because": "first", "found": [2.0]}
    with pytest.raises(InvalidSetting, match="reason of an earlier change"):
        renewed("gap", kept, [2.0], kept["because"])


def test_a_small_change_is_found() -> None:
    kept = {"a": [1.0, {"b": 2.0}], "c": "healthy"}
    assert not differences(kept, {"a": [1.0 + 1e-6, {"b": 2.0}], "c": "healthy"}, "", RELATIVE)
    assert differences(kept, {"a": [1.001, {"b": 2.0}], "c": "healthy"}, "x", RELATIVE) == [
        "x.a[0]: 1.0 before, 1.001 now"
    ]
    assert differences(kept, {"a": [1.0], "c": "healthy"}, "x", RELATIVE)
    assert differences(kept, {"a": [1.0, {"b": 2.0}], "c": "backlash"}, "x", RELATIVE)
