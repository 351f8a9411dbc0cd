"""Motion of a comparison for the Rerun viewer, read back by the package itself."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.errors import MissingExtra
from loose_env.gap import GapSolution
from loose_env.recording import joint_sensors
from loose_env.report import write_rerun
from tests.gap.cases.gap_case import FEW, record, solution_for


@pytest.fixture(scope="module")
def solution(tmp_path_factory: pytest.TempPathFactory) -> GapSolution:
    settings = replace(FEW, held_out=("run-03",))
    return solution_for(record(tmp_path_factory.mktemp("rerun") / "recording"), settings)


@pytest.fixture(scope="module")
def columns(
    solution: GapSolution, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, dict[str, Any]]:
    """Entity -> its columns over time."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun-sdk reads no files")
    file = write_rerun(tmp_path_factory.mktemp("rrd") / "motion.rrd", solution)
    found: dict[str, dict[str, Any]] = {}
    for each in chunk.RrdReader(file).stream().to_chunks():
        if not each.is_static:
            batch = each.to_record_batch()
            named = zip(batch.schema.names, batch.columns, strict=True)
            # times are columns of nanoseconds, which Python's own durations lack
            own = {name: values.to_pylist() for name, values in named if name != "time"}
            found.setdefault(each.entity_path, {}).update(own)
    return found


def scalars(columns: dict[str, Any]) -> np.ndarray[Any, Any]:
    (values,) = (v for name, v in columns.items() if "scalars" in name)
    return np.concatenate([np.asarray(v, dtype=float) for v in values])


def test_readings_are_those_measured_and_those_of_both_models(
    solution: GapSolution, columns: dict[str, dict[str, Any]]
) -> None:
    assert solution.played is not None
    c = next(k for k, each in enumerate(solution.played.channels) if "encoder2" in each.name)
    entity = next(e for e in columns if "encoder2" in e and e.endswith("/measured"))
    measured = scalars(columns[entity])
    expected = np.concatenate([trial.measured[:, c] for trial in solution.played.trials])
    np.testing.assert_allclose(measured, expected)
    nominal, corrected = (
        scalars(columns[entity.replace("measured", kind)]) for kind in ("nominal", "corrected")
    )
    errors = [np.sqrt(np.mean((each - measured) ** 2)) for each in (nominal, corrected)]
    assert errors[0] > 3 * errors[1]


def test_the_arm_moves_as_measured(
    solution: GapSolution, columns: dict[str, dict[str, Any]]
) -> None:
    assert solution.played is not None
    machine = solution.answer.selection.evidence.balance.machine
    trials = solution.played.trials
    places = {
        kind: next(
            np.array([row[0] for row in values])
            for name, values in columns[f"/arm/{kind}/{machine.links[-1]}"].items()
            if "translation" in name
        )
        for kind in ("measured", "nominal", "corrected")
    }
    data = mujoco.MjData(machine.model)
    encoders = joint_sensors(machine.model)
    columns_of = {channel.column: c for c, channel in enumerate(solution.played.channels)}
    for frame, trial in ((0, trials[0]), (-1, trials[-1])):
        for joint in machine.joints:
            (encoder,) = encoders[joint].position
            reading = trial.measured[frame, columns_of[f"sensor.{encoder}"]]
            data.joint(joint).qpos[0] = reading
        mujoco.mj_kinematics(machine.model, data)
        expected = data.body(machine.links[-1]).xpos
        np.testing.assert_allclose(places["measured"][frame], expected, atol=1e-5)


def test_without_the_package_the_remedy_is_said_and_nothing_is_written(
    solution: GapSolution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtra, match=r"pip install 'loose-env\[rerun\]'"):
        write_rerun(tmp_path / "motion.rrd", solution)
    assert not list(tmp_path.iterdir())
