"""The same seeds give the same figures: on any number of threads, and in every release."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("safetensors")

from loose_env.errors import InvalidSetting
from scripts.suites import golden

ROOT = Path(__file__).resolve().parents[1]
MEANT = (
    "the same seeds give other figures than before. If that is not meant, something broke. If it "
    "is, put a line into CHANGELOG.md and run: "
    "python -m scripts.suites.golden {part} --because 'that line'"
)
QUICK = ("environments", "agents", "posterior")
PARTS = [
    part if part in QUICK else pytest.param(part, marks=pytest.mark.slow) for part in golden.PARTS
]


@cache
def figures(part: str) -> Any:
    """The figures of a part, computed in this process."""
    return json.loads(json.dumps(golden.PARTS[part]()))


@pytest.mark.parametrize("part", PARTS)
def test_the_same_seeds_give_the_same_figures_in_every_release(part: str) -> None:
    if part == "agents" and not golden.rounds_alike():
        pytest.skip("episodes of loose arms hold on processors that round alike")
    found = golden.compare(part, figures(part))
    assert not found, "\n".join([MEANT.format(part=part), *found[:10]])


@pytest.mark.slow
def test_one_thread_and_many_give_the_same_to_the_last_bit() -> None:
    assert figures("environments") == golden.environments(threads=3)


def elsewhere(part: str, **variables: str) -> Any:
    """The figures of a part, computed in a process with other environment variables."""
    names = list(golden.DIAGNOSES)[:3] if part == "instrument" else None
    code = (
        "import json; from scripts.suites import golden; "
        f"print(json.dumps(golden.{part}({names or ''})))"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        cwd=ROOT, env=os.environ | variables, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_threads_of_the_linear_algebra_change_no_digit_of_a_diagnosis() -> None:
    """They add up in another order: what comes out may differ in the last digits alone."""
    one, three = (
        elsewhere("instrument", OMP_NUM_THREADS=n, OPENBLAS_NUM_THREADS=n) for n in ("1", "3")
    )
    assert golden.differences(one, three, "instrument") == []


ANOTHER = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX",
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX2 "
    "FMA3",
}
"""Makes the libraries of this processor round as an older one does, where they can be asked to."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="asks the C library of Linux")
def test_a_processor_that_rounds_another_way_gives_the_same_figures() -> None:
    part = "environments"
    here, there = (
        golden.comparable(part, each) for each in (figures(part), elsewhere(part, **ANOTHER))
    )
    assert here and golden.differences(here, there, part) == []


CHANGES = """# Changelog

## [0.2.0] - unreleased

- The step is finer:
  figures of the gap differ.

## [0.1.0] - 2026-01-01

- An old line.
"""


def test_a_change_of_golden_results_takes_a_new_line_under_what_is_unreleased(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    said = "The step is finer: figures of the gap differ."
    (tmp_path / "CHANGELOG.md").write_text(CHANGES, encoding="utf-8")
    monkeypatch.setattr(golden, "ROOT", tmp_path)
    monkeypatch.setattr(golden, "FOLDER", tmp_path)
    for old in ("An old line.", "", "Nobody wrote this."):
        with pytest.raises(InvalidSetting, match="under what is unreleased"):
            golden.write("plan", {"a": 1.0}, old)
    golden.write("plan", {"a": 1.0}, said)
    golden.write("plan", {"a": 1.0}, "another")
    assert golden.kept("plan") == {"because": said, "found": {"a": 1.0}}
    with pytest.raises(InvalidSetting, match="reason of an earlier change"):
        golden.write("plan", {"a": 2.0}, said)


def test_a_small_change_is_found() -> None:
    before = {"a": [1.0, {"b": 2.0, "bits": "ab"}], "c": "healthy"}
    rounded = {"a": [1.0 + 1e-6, {"b": 2.0, "bits": "cd"}], "c": "healthy"}
    assert golden.differences(before, rounded, "") == []
    assert len(golden.differences(before, rounded, "", relative=0.0, bits=True)) == 2
    assert golden.differences(before, rounded | {"a": [1.001, before["a"][1]]}, "x") == [
        "x.a[0]: 1.0 before, 1.001 now"
    ]
    assert golden.differences(before, {"a": [1.0], "c": "healthy"}, "x")
    assert golden.differences(before, before | {"c": "backlash"}, "x")
