"""What a recording is too short or too still to show is said, with what to record instead."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from loose_env.gap.preparing import GapSettings, prepare
from loose_env.recording import Recording, Run, write_recording
from tests.gap.effect_arms import PLANAR


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
