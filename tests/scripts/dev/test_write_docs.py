"""The generated parts of pages are those of the code."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import pytest

from loose_env.envs import DiagnosisEnv
from loose_env.registration import IDS
from scripts.dev import write_docs

PAGE = Path(__file__).resolve().parents[3] / "docs" / "environments.md"


def elements() -> str:
    """Table of elements of the page."""
    text = PAGE.read_text(encoding="utf-8")
    return text.split("<!-- elements: begin -->")[1].split("<!-- elements: end -->")[0]


def test_the_pages_are_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == write_docs.environments()
    assert PAGE.with_name("gap.md").read_text(encoding="utf-8") == write_docs.gap()
    assert len(write_docs.tolerance_table()) > 10


@pytest.mark.parametrize("env_id", IDS)
def test_the_table_counts_every_element_of_every_environment(env_id: str) -> None:
    env = gymnasium.make(env_id).unwrapped
    assert isinstance(env, DiagnosisEnv)
    counted = {"now": 0, "record": 0}
    rows = [line.split(" | ") for line in elements().splitlines() if line.startswith("| `")]
    for _, number, *_ in rows:
        numbers = number.split(", and ")
        count = numbers[0].removesuffix(" a record")
        each = write_docs.FORMULAS[count](*write_docs.sizes(env.arm))
        counted["record" if numbers[0] != count else "now"] += each
        counted["record"] += each * ("nominal" in numbers)
        counted["now"] += each * ("now" in numbers)
    assert counted["now"] == len(env.layout.global_elements)
    assert counted["record"] == len(env.layout.slot_elements)
    env.close()
