"""What a recording is too short or too still to show is said, with what to record instead."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap.residuals.preparation.prepare import prepare
from loose_env.gap.settings import GapSettings
from loose_env.recording import Recording, Run, write_recording
from tests.gap.cases.effect_arms import PLANAR


def recorded(folder: Path, *, seconds: float, swings: tuple[float, float, float]) -> Recording:
    """Three runs whose joints swing so far [rad], as their encoders show it."""
    rng = np.random.default_rng(8)
    time = 0.002 * np.arange(round(seconds / 0.002))
    runs = []
    for number in range(3):
        waves = np.sin(np.outer(time, rng.uniform(3.0, 9.0, 3))) * np.array(swings)
        shown = waves + rng.normal(0.0, 5e-5, waves.shape)
        runs.append(
            Run(
                name=f"run-{number}.parquet",
                time=time,
                controls={f"servo{j + 1}": waves[:, j] for j in range(3)},
                sensors={f"encoder{j + 1}": shown[:, j] for j in range(3)},
            )
        )
    return write_recording(folder, model_xml=PLANAR, runs=runs)


def test_enough_data_is_not_complained_of(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "r", seconds=4.0, swings=(0.3, 0.3, 0.3))
    found = prepare(recording, GapSettings(threads=1)).warnings
    assert not [w for w in found if "hardly moves" in w or "independent" in w]


def test_short_runs_are_said_to_be_short_and_by_how_much(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "r", seconds=0.5, swings=(0.3, 0.3, 0.3))
    found = [w for w in prepare(recording, GapSettings(threads=1)).warnings if "independent" in w]
    assert any("to fit to last 1 s in all" in w and "s more of them" in w for w in found)


def test_a_still_joint_is_named_with_the_motion_that_would_help(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "r", seconds=4.0, swings=(0.3, 0.0, 0.3))
    found = [w for w in prepare(recording, GapSettings(threads=1)).warnings if "hardly" in w]
    assert len(found) == 1
    assert found[0].startswith("joint2 hardly moves")
    assert "turns round several times" in found[0]


def marked(recording: Recording, folder: Path, conditions: str) -> Recording:
    """The same recording with a condition for every run: "s" suspect, "h" healthy."""
    names = {"s": "suspect", "h": "healthy"}
    runs = [
        replace(run, condition=names[c]) for run, c in zip(recording.runs, conditions, strict=True)
    ]
    return write_recording(folder, model_xml=PLANAR, runs=runs)


def test_healthy_runs_are_left_out_where_there_are_suspect_ones(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "r", seconds=1.0, swings=(0.3, 0.3, 0.3))
    settings = GapSettings(threads=1)
    mixed = prepare(marked(recording, tmp_path / "mixed", "shs"), settings)
    compared = [t.name for c in (mixed.fit, mixed.held_out_whole) for t in c.trials]
    assert compared == ["run-0.parquet", "run-2.parquet"]
    assert any("run-1.parquet" in words and "not used" in words for words in mixed.warnings)
    healthy = prepare(marked(recording, tmp_path / "healthy", "hhh"), settings)
    assert len(healthy.fit.trials) + len(healthy.held_out_whole.trials) == 3
    assert not any("not used" in words for words in healthy.warnings)


def test_one_suspect_run_among_healthy_ones_is_too_few(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "r", seconds=1.0, swings=(0.3, 0.3, 0.3))
    with pytest.raises(InvalidData, match=r"only run-2\.parquet is suspect"):
        prepare(marked(recording, tmp_path / "few", "hhs"), GapSettings(threads=1))


def test_links_without_names_and_a_tool_without_site_are_told_of(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "r", seconds=1.0, swings=(0.3, 0.3, 0.3))
    bare = PLANAR.replace('<body name="link2"', "<body").replace('name="tool"', 'name="tip"')
    bare = bare.replace('site="tool"', 'site="tip"')
    bare = bare.replace('<site name="tip" pos="0.3 0 0" euler="0 0 0.3"/>', "").replace(
        '<accelerometer name="shake" site="tip"/>', ""
    )
    other = write_recording(tmp_path / "bare", model_xml=bare, runs=list(recording.runs))
    warnings = prepare(other, GapSettings(threads=1)).warnings
    assert any("joint2_link" in words for words in warnings)
    assert any("no site at its tool" in words for words in warnings)
