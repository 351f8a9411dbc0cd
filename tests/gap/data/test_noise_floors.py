"""Channels that show one value, and recordings without noise: neither is a gap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.pipeline import find_gap
from loose_env.recording import Run, read_recording, write_recording
from tests.gap.data.test_initial_rest import COUNT, EVERY, KINDS, SERVOS, motion

STEP = 2 * np.pi / 2**10
"""Of an encoder of ten bits [rad]."""


@pytest.mark.parametrize("exact", [True, False])
def test_a_held_joint_and_a_simulation_without_noise_are_no_gap(
    exact: bool, tmp_path: Path
) -> None:
    time, runs, rng = np.arange(COUNT) * EVERY * 0.002, [], np.random.default_rng(2)
    for number in range(4):
        swing = 0.3 * np.sin(2 * np.pi * (0.5 + 0.3 * number) * time) * np.minimum(2 * time, 1.0)
        commands = np.stack([swing, 0.0 * time], axis=1)
        positions = motion(SERVOS, np.zeros(2), np.vstack([np.zeros((COUNT, 2)), commands])[:COUNT])
        positions = motion(SERVOS, positions[-1], commands)
        if not exact:
            positions[:, 0] += rng.normal(0, 1e-4, COUNT)
            positions[:, 1] = np.round(positions[:, 1] / STEP) * STEP
        runs.append(
            Run(
                name=f"run-{number}.csv",
                time=time,
                controls={"hip_drive": commands[:, 0], "knee_drive": commands[:, 1]},
                sensors={"hip_at": positions[:, 0], "knee_at": positions[:, 1]},
            )
        )
    write_recording(tmp_path / "recording", model_xml=SERVOS, runs=runs)
    settings = GapSettings(kinds=KINDS, threads=1)
    found = find_gap(read_recording(tmp_path / "recording"), settings)
    assert found.verdict == "no_gap"
    assert any("sensor.knee_at: constant" in w for w in found.problem.warnings) != exact
