"""The value of choice is a paired difference of returns on the same arms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from scripts.agents.value_of_choice import STUDY, Settings, cases_of
from scripts.study_parts.choice_tables import agent_table, pooled, value_table

TIER = "loose_env/ControlTier-v0"


def row(agent: str, block: int, reward: list[float]) -> dict[str, Any]:
    count = len(reward)
    return {
        "tier": TIER, "agent": agent, "block": block, "reward": reward,
        "success": [1] * count, "unsure": [0] * count, "records": [2] * count,
    }  # fmt: skip


ROWS = [
    row("greedy", 1, [0.8, 0.8]),
    row("greedy", 0, [0.9, 0.5]),
    row("fixed", 0, [0.6, 0.2]),
    row("fixed", 1, [0.5, 0.5]),
    row("fixed_1", 0, [0.9, 0.5]),
    row("fixed_1", 1, [0.7, 0.7]),
    row("fixed_2", 0, [0.0, 0.0]),
    row("fixed_2", 1, [0.0, 0.0]),
    row("open_loop", 0, [0.9, 0.5]),
]


def test_values_are_paired_differences_by_arm() -> None:
    assert pooled(ROWS)[TIER]["greedy"]["reward"].tolist() == [0.9, 0.5, 0.8, 0.8]
    cells = [cell.strip() for cell in value_table(ROWS)[-1].strip("|").split("|")]
    # Every difference to "fixed" is 0.3: the paired error is nil though the returns differ.
    assert cells[:2] == ["ControlTier", "4"]
    assert cells[4] == "+0.300 ± 0.000"
    assert cells[3].startswith("+0.050")  # over fixed_1, the better of the two
    assert cells[5] == ""  # the open loop has not played the same arms yet
    assert len(agent_table(ROWS)) == 2 + 5


def test_the_command_plays_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--tiers", TIER, "--agents", "always_healthy", "--blocks", "1", "--block", "3"]
    given += ["--out", str(tmp_path), "--workers", "1"]
    STUDY.main(given)
    first = capsys.readouterr().out
    assert "| ControlTier | always_healthy | 3 |" in first
    stored = (tmp_path / "value_of_choice.json").read_text()
    STUDY.main(given)
    assert capsys.readouterr().out == first
    assert (tmp_path / "value_of_choice.json").read_text() == stored
    run = STUDY.run(tiers=(TIER,), agents=("fixed", "greedy"), blocks=2)
    assert [case[1:] for case in cases_of(Settings(), run)] == [
        ("fixed", 0), ("greedy", 0), ("fixed", 1), ("greedy", 1),
    ]  # fmt: skip
