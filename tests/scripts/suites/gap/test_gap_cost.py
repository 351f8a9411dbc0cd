"""Time and memory of `loose gap`, measured on a process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.recording import Run, write_recording
from scripts.suites.gap.studies.cost import cost_of, table
from tests.gap.cases.recorded_runs import PENDULUM, pendulum_run


def test_a_recording_is_measured(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    runs = [
        pendulum_run(rng, viscous=0.0, coulomb=0.0, start=(1.0 + k, 0.0), name=f"run-{k}")
        for k in range(3)
    ]
    write_recording(tmp_path / "arm", model_xml=PENDULUM, runs=runs)
    cost = cost_of(tmp_path / "arm", tmp_path / "out", name="pendulum")
    assert cost.said == "no_gap"
    assert cost.size.startswith("1 joints, 3 runs, 18 s at 100 Hz")
    assert 0.1 < cost.seconds < 600 and 20 < cost.peak_mb < 4000
    assert "| pendulum |" in table([cost])


def test_a_recording_without_result_is_refused(tmp_path: Path) -> None:
    time = np.arange(12) / 100.0
    run = Run(name="run", time=time, sensors={"encoder": np.zeros(12)})
    write_recording(tmp_path / "arm", model_xml=PENDULUM, runs=[run])
    with pytest.raises(InvalidData, match="loose gap gives no result for short: loose gap: "):
        cost_of(tmp_path / "arm", tmp_path / "out", name="short")
