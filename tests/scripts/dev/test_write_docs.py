"""The tables in the documents are those the code prints."""

from __future__ import annotations

import importlib
from pathlib import Path

from loose_env.arms import six_axis

ROOT = Path(__file__).resolve().parents[3]


def test_the_environment_tables_are_up_to_date() -> None:
    written = (ROOT / "docs" / "environments.md").read_text(encoding="utf-8")
    assert written == importlib.import_module("scripts.dev.write_docs").environments()


def test_every_element_of_every_environment_is_counted_in_the_document() -> None:
    import gymnasium

    from loose_env.registration import IDS

    pattern = importlib.import_module("scripts.dev.write_docs").pattern
    text = (ROOT / "docs" / "environments.md").read_text(encoding="utf-8")
    parts = dict(zip(IDS, text.split("\n## loose_env/")[1:], strict=True))
    for env_id in IDS:
        env = gymnasium.make(env_id).unwrapped
        layout = env.layout  # type: ignore[attr-defined]
        counted = 0
        for line in parts[env_id].splitlines():
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            if line.startswith("|") and len(cells) == 5 and cells[1].isdigit():
                counted += int(cells[1])
        assert counted == len(layout.global_elements) + len(layout.slot_elements)
        for element in layout.slot_elements:
            row = rf"| record\<k\>.{pattern(env.arm, element.name)} |"  # type: ignore[attr-defined]
            rows = [line for line in parts[env_id].splitlines() if line.startswith(row)]
            assert any(f" | {element.unit} | " in line for line in rows), element.name
        env.close()


def test_every_name_of_an_element_has_its_row_in_the_table_of_meanings() -> None:
    import gymnasium

    from loose_env.registration import IDS

    write_docs = importlib.import_module("scripts.dev.write_docs")
    text = (ROOT / "docs" / "environments.md").read_text(encoding="utf-8")
    for names, meaning in write_docs.MEANINGS.items():
        assert f"| {write_docs.names_cell(names)} | {meaning} |" in text
    used = set()
    for env_id in IDS:
        env = gymnasium.make(env_id).unwrapped
        layout = env.layout  # type: ignore[attr-defined]
        for element in (*layout.global_elements, *layout.slot_elements):
            meaning = write_docs.meaning_of(element.name)
            assert meaning is not None, f"{element.name} of {env_id} has no row"
            used.add(meaning)
        env.close()
    assert used == set(write_docs.MEANINGS.values())  # and no row is of something that is gone
    assert write_docs.meaning_of("nominal_rust.joint1") is None


def test_the_page_has_what_the_docstring_says_of_actions_and_rewards() -> None:
    import inspect

    from loose_env.envs import DiagnosisEnv

    text = (ROOT / "docs" / "environments.md").read_text(encoding="utf-8")
    words = " ".join(text.split())
    said = inspect.cleandoc(DiagnosisEnv.__doc__ or "")
    for title in ("Action Space", "Rewards", "Starting State", "Episode End", "Arguments"):
        assert f"\n## {title}\n" in text
        body = said.split(f"## {title}\n")[1].split("\n## ")[0]
        assert " ".join(body.split()) in words


def test_elements_that_differ_in_joint_and_axis_share_a_pattern() -> None:
    from loose_env.arms import scara

    pattern = importlib.import_module("scripts.dev.write_docs").pattern
    assert pattern(six_axis(), "transmission.joint4_y") == r"transmission.\<joint\>_\<axis\>"
    assert pattern(scara(), "inertia.joint3") == r"inertia.\<slide\>"
    assert pattern(scara(), "sin_pose.joint3_position") == r"sin_pose.\<slide\>_position"
    assert pattern(scara(), "tool_correlation.xz") == r"tool_correlation.\<axes\>"
    assert pattern(scara(), "lowest_skewness") == "lowest_skewness"
    assert pattern(scara(), "spent.records") == "spent.records"
