"""Blind suites of diagnosis: their machines, what recordings tell, and what tables count."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")

from loose_env.recording import Run, read_recording, write_recording
from scripts.suites.diagnosis import __main__ as suite
from scripts.suites.diagnosis.cases import KINDS, draw, random_motion, taken
from scripts.suites.diagnosis.machines import (
    DISTURBANCES,
    RichCase,
    alone,
    draw_rich,
)
from scripts.suites.rows import kept

OPENS = 5  # a case whose fault opens


def short(number: int, seed: int = 1, **more: Any) -> RichCase:
    return draw_rich(number, seed, runs=1, seconds=0.1, **more)


@cache
def made(name: str, healthy: bool = True) -> tuple[RichCase, list[Run], list[float]]:
    case = short(OPENS, sizes={} if name == "none" else alone(name), healthy=healthy)
    return (case, *case.played())


# -------------------------------------------------------------------------------- machines


@pytest.mark.parametrize(
    "place", ["diagnosis/machines", "gap/dynamics", "gap/effects", "gap/machine"]
)
def test_the_generator_shares_no_code_with_what_it_tests(place: str) -> None:
    text = Path(str(suite.__file__)).parents[1].joinpath(f"{place}.py").read_text("utf-8")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("loose"):
            assert node.module in ("loose_env.typing", "loose_env.recording")
        elif isinstance(node, ast.Import):
            assert not any(alias.name.startswith(("loose", "mujoco")) for alias in node.names)


@pytest.mark.slow
def test_a_machine_without_disturbances_moves_as_its_model() -> None:
    case, runs, _ = made("none")
    run, n = runs[-1], case.figures.joints
    model = mujoco.MjModel.from_xml_string(case.model_xml)
    model.opt.timestep = 1e-4
    data = mujoco.MjData(model)
    angles = np.stack([run.sensors[f"joint{j + 1}_pos"] for j in range(n)], axis=1)
    assert run.pose is not None
    np.testing.assert_allclose(angles[0], list(run.pose.values()), atol=0.02)
    data.qpos[:] = angles[0]
    data.qvel[:] = (angles[1] - angles[0]) / (run.time[1] - run.time[0])
    for now in np.arange(0.0, 0.02, 1e-4):
        data.ctrl[:] = [np.interp(now, run.time, c) for c in run.controls.values()]
        mujoco.mj_step(model, data)
    expected = [np.interp(0.02, run.time, a) for a in angles.T]
    assert np.abs(data.qpos - expected).max() < 0.2 * np.ptp(angles, axis=0).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", sorted(set(DISTURBANCES) - {"friction_drift", "torque_saturation"})
)
def test_each_disturbance_alone_changes_the_record(name: str) -> None:
    usual, other = (made(each)[1][-1] for each in ("none", name))
    assert usual.sensors.keys() == other.sensors.keys()
    changed = max(
        np.abs(values - other.sensors[key]).max() / (np.ptp(values, axis=0).max() + 1e-9)
        for key, values in usual.sensors.items()
    )
    assert changed > 3e-4
    assert all(np.isfinite(values).all() for values in other.sensors.values())


# ---------------------------------------------------------------------- recordings and rows


def test_a_case_is_drawn_by_its_number_and_seed_alone() -> None:
    kinds = [
        case.fault.kind if case.fault else "healthy" for case in (draw(k, 1) for k in range(4))
    ]
    assert kinds == list(KINDS)
    assert draw(5, 1).fault == draw(5, 1).fault
    assert not np.array_equal(draw(0, 1).sensor, draw(0, 2).sensor)


@pytest.mark.slow
@pytest.mark.parametrize("rich", [False, True])
def test_a_recording_reads_and_tells_nothing_of_the_truth(rich: bool, tmp_path: Path) -> None:
    case: Any = short(7) if rich else draw(1, 1)
    if rich:
        runs = case.played()[0]
        assert [run.condition for run in runs] == ["healthy", "suspect"]
        assert runs[0].samples == round(0.1 * case.rate)
    else:
        runs = [taken(case, random_motion(case, 0, 3), "run-1", case.rng(4, 0), sound=False)]
    write_recording(tmp_path / "case", model_xml=case.model_xml, runs=runs)
    run = read_recording(tmp_path / "case").runs[-1]
    assert run.pose is not None and len(run.excited) == 1
    words = "".join(path.read_text("utf-8") for path in (tmp_path / "case").glob("*.[jx]*"))
    assert not any(word in words for word in ("looseness", "backlash", "gap", "gear"))


@pytest.mark.slow
def test_a_case_is_diagnosed_and_a_finished_one_is_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "rows.jsonl"
    words = ["--cases", "1", "--first", "8", "--seed", "1", "--runs", "2", "--seconds", "0.5",
             "--only", "none", "--form", "machines", "--out", str(file)]  # fmt: skip
    suite.main(words)
    first = capsys.readouterr().out
    assert "1/1 8" in first and "| sure false alarms, without reference |" in first
    with file.open("a", encoding="utf-8") as rows:
        rows.write('{"case": 9, "se')  # cut off
    suite.main(words)
    assert "1/1" not in capsys.readouterr().out
    assert len(kept(file)) == 1 and kept(file)[0]["disturbances"] == {}
    with pytest.raises(SystemExit, match="rows of another seed or --only"):
        suite.main([*words, "--only", "cables"])


# ---------------------------------------------------------------------------------- tables


def row(**changed: Any) -> dict[str, Any]:
    slides = "structural_looseness@link2"
    base: dict[str, Any] = {
        "case": 1, "seed": 1, "joints": 4, "servoed": True, "rate": 1000.0, "reference": False,
        "disturbances": {"cables": {}}, "truth": slides, "link": 2, "gap": 1e-4, "opens": True,
        "named": slides, "named_link": 2, "probability": 0.99, "verdict": "faulty", "angle": 3.0,
        "half_angle": 4.0, "gap_named": 2e-4, "gap_interval": (1.5e-4, 3e-4), "used": 3,
        "seconds": 5.0, "only": "any", "steps": [{"healthy": 0.75, slides: 0.25}, {slides: 1.0}],
    }  # fmt: skip
    return base | changed


HEALTHY = {"truth": "healthy", "link": None, "gap": None, "opens": False}


def test_tables_count_false_alarms_links_and_what_was_refused() -> None:
    refused = row(error="no run can be used", **HEALTHY)
    for name in ("named", "named_link", "probability", "verdict", "angle", "gap_named", "used"):
        del refused[name]
    rows = [
        row(),
        row(named="backlash@joint2"),
        row(named="structural_looseness@link3", named_link=3),
        row(named="structural_looseness@link3", named_link=3, verdict="model_mismatch"),
        row(opens=False, verdict="healthy", named="healthy", named_link=None),
        row(**HEALTHY),
        row(**HEALTHY, reference=True, verdict="healthy", named="healthy", named_link=None),
        refused,
    ]
    said = suite.tables(rows)
    for line in (
        "sure false alarms, without reference | at most 2 % | 1 of 2 = 50.0%",
        "sure false alarms, with reference | at most 0.5 % | 0 of 1 = 0.0%",
        "right link of faults that open | at least 85 % | 2 of 4 = 50.0%",
        "right hypothesis of faults that open |  | 1 of 4 = 25.0%",
        "no sure wrong name where the link is not right | at least 90 % | 1 of 2",
        "true direction inside its 95 % cone |  | 1 of 1",
        "true free travel inside its 95 % interval |  | 0 of 1",
        "refused recordings |  | 1 of 8",
        "`cables` | 1 of 3 = 33.3%",
        "1 | 2 of 7 = 28.6%",
        "2 | 5 of 7 = 71.4%",
    ):
        assert f"\n| {line}" in said
    assert "no run can be used" in suite.line_of(refused)
    assert suite.tables([])
