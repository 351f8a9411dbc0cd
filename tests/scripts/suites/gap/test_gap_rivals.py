"""Other methods in the suite: planted friction is found, nothing is named for nothing."""

from __future__ import annotations

import json
import math
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")

from loose_agents.execution.backends import BackendSettings

from loose_env.errors import InvalidSetting
from loose_env.gap import read_result
from loose_env.recording import Run, read_recording, write_recording
from loose_env.typing import Array
from scripts.suites.gap import run as suite
from scripts.suites.gap.cases import name_of, role_of
from scripts.suites.gap.grading import Grade, grade
from scripts.suites.gap.grading.one_case import Folders
from scripts.suites.gap.rivals import METHODS, run_method
from scripts.suites.gap.rivals import __main__ as comparison
from scripts.suites.gap.rival_stepwise import InverseDynamics
from scripts.suites.gap.rival_data import FilterSettings, LowPass, joint_runs
from scripts.suites.gap.rivals.residual_network import NetworkSettings, improvement_z, predicted
from scripts.suites.gap.rival_data import Finding, write_finding

XML = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.00025" integrator="RK4"/>
  <worldbody>
    <body name="link1">
      <inertial mass="3" pos=".2 0 0" diaginertia=".01 .06 .06"/>
      <joint name="joint1" axis="0 1 0" damping="1" armature=".2"/>
      <body name="link2" pos=".4 0 0">
        <inertial mass="1.5" pos=".15 0 0" diaginertia=".005 .02 .02"/>
        <joint name="joint2" axis="0 1 0" damping=".5" armature=".08"/>
        <site name="tool" pos=".3 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="motor1" joint="joint1" kp="1500" kv="60"/>
    <position name="motor2" joint="joint2" kp="600" kv="20"/>
  </actuator>
  <sensor>
    <jointpos name="joint1_pos" joint="joint1"/><jointvel name="joint1_vel" joint="joint1"/>
    <jointpos name="joint2_pos" joint="joint2"/><jointvel name="joint2_vel" joint="joint2"/>
  </sensor>
</mujoco>
"""
TORQUE = 1.5
"""Dry friction that is planted [N m]."""
NAMING = ("least_squares", "stepwise_bic", "group_lasso")
THREADS = BackendSettings(backend="threading", workers=1)


def write_arm(folder: Path, *, friction: float, seconds: float = 3.0, runs: int = 3) -> Path:
    """A recording of an arm with dry friction at its first joint, its model without."""
    rng = np.random.default_rng(7)
    model = mujoco.MjModel.from_xml_string(XML)
    time = np.arange(round(seconds * 1000)) / 1000
    recorded = []
    for i in range(runs):
        commands = sum(
            np.sin(2 * np.pi * f * time[:, None] + rng.uniform(0, 6, 2)) * 0.25 / f
            for f in (0.4, 0.9, 1.7, 2.9)
        )
        commands *= np.minimum(1.0, time / 0.5)[:, None]
        data = mujoco.MjData(model)
        readings = np.empty((len(time), 4))
        for k, command in enumerate(commands):
            readings[k, :2], readings[k, 2:] = data.qpos, data.qvel
            data.ctrl = command
            for _ in range(4):  # steps in a sample
                # MuJoCo's own dry friction is soft: it would be another law
                data.qfrc_applied[0] = -friction * np.tanh(data.qvel[0] / 3e-3)
                mujoco.mj_step(model, data)
        readings += rng.normal(size=readings.shape) * [1e-4, 1e-4, 2e-3, 2e-3]
        recorded.append(
            Run(
                name=f"run-{i}",
                time=time,
                controls={"motor1": commands[:, 0], "motor2": commands[:, 1]},
                sensors={
                    "joint1_pos": readings[:, 0], "joint2_pos": readings[:, 1],
                    "joint1_vel": readings[:, 2], "joint2_vel": readings[:, 3],
                },
            )
        )  # fmt: skip
    write_recording(folder, model_xml=XML, runs=recorded)
    return folder


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_arm(tmp_path_factory.mktemp("arms") / "rubbing", friction=TORQUE)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_arm(tmp_path_factory.mktemp("arms") / "sound", friction=0.0)


def needs(name: str) -> None:
    if name == "group_lasso":
        pytest.importorskip("skglm")
    if name == "residual_network":
        pytest.importorskip("torch")


def result_of(recording: Path, folder: Path, name: str) -> dict[str, Any]:
    needs(name)
    run_method(recording, folder, 0.03, name=name)
    result: dict[str, Any] = json.loads((folder / "result.json").read_text("utf-8"))
    return result


def graded(result: dict[str, Any], *, torque: float | None) -> Grade:
    """Marks against the planted friction, or against nothing."""
    effect = {
        "kind": "coulomb_friction",
        "where": "joint1",
        "parameters": {"torque": torque},
        "size": {"ratio": 5.0},
    }
    truth = {
        "format": "gap-truth/1",
        "case": "case-0001",
        "role": "none" if torque is None else "single",
        "form": "forward",
        "effects": [] if torque is None else [effect],
    }
    return grade(result, truth)


@pytest.mark.parametrize("name", NAMING)
def test_planted_friction_is_named_with_its_size(rubbing: Path, tmp_path: Path, name: str) -> None:
    marks = graded(result_of(rubbing, tmp_path, name), torque=TORQUE)
    assert marks.found == 1, marks.said
    assert marks.parameter_error[0] < 0.15
    assert marks.gap_after < 1.25 < marks.gap_before
    read_result(tmp_path / "result.json")


def test_stepwise_selection_names_nothing_beside_it(rubbing: Path, tmp_path: Path) -> None:
    assert graded(result_of(rubbing, tmp_path, "stepwise_bic"), torque=TORQUE).right


@pytest.mark.parametrize("name", [*NAMING, "residual_network"])
def test_nothing_is_named_where_nothing_is_missing(sound: Path, tmp_path: Path, name: str) -> None:
    marks = graded(result_of(sound, tmp_path, name), torque=None)
    assert marks.right, marks.said
    assert marks.gap_before < 1.25


def test_a_network_learns_what_the_inputs_say() -> None:
    pytest.importorskip("torch")
    rng = np.random.default_rng(0)
    inputs = [rng.normal(size=(400, 2)) for _ in range(3)]
    residuals = [5.0 * np.tanh(x[:, :1]) + rng.normal(size=(400, 1)) for x in inputs]
    settings = NetworkSettings(epochs=60)
    after = residuals[-1] - predicted(inputs, residuals, settings, rng)
    assert np.sqrt(np.mean(after**2)) < 1.5
    assert improvement_z(residuals[-1], after, 50.0, settings) > settings.least_z


def test_a_network_never_names(rubbing: Path, tmp_path: Path) -> None:
    result = result_of(rubbing, tmp_path, "residual_network")
    assert result["verdict"] in ("no_gap", "unexplained") and not result["effects"]
    assert result["gap"]["after"] <= result["gap"]["before"]


def test_sysid_predicts_the_held_out_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sysid = pytest.importorskip("mujoco.sysid")
    if not hasattr(sysid, "Parameter"):
        pytest.skip("mujoco.sysid lacks its own optional packages: pip install 'mujoco[sysid]'")
    from scripts.suites.gap.rivals import sysid as rival

    short = partial(rival.SysidSettings, windows=3, window_s=0.3, iterations=5)
    monkeypatch.setattr(rival, "SysidSettings", short)
    arm = write_arm(tmp_path / "arm", friction=TORQUE, seconds=2.0, runs=2)
    result = result_of(arm, tmp_path, "sysid")
    marks = graded(result, torque=TORQUE)
    assert marks.gap_after < marks.gap_before


# Parts


def test_columns_are_derivatives_of_the_torque(sound: Path) -> None:
    recording = read_recording(sound)
    dynamics = InverseDynamics(recording=recording)
    rng = np.random.default_rng(0)
    motion = tuple(rng.normal(size=(20, 2)) for _ in range(3))
    base = dynamics.torque(motion)  # type: ignore[arg-type]

    def heavier(model: mujoco.MjModel) -> None:
        model.body_mass[2] += 0.5
        # half a kilogram at the tool, 0.3 m from the joint: the new middle and tensor
        model.body_ipos[2] = (1.5 * 0.15 + 0.5 * 0.3) / 2.0, 0.0, 0.0
        model.body_inertia[2, 1:] += 1.5 * 0.0375**2 + 0.5 * 0.1125**2

    own = dynamics.point_mass(motion, 2, np.array([0.3, 0.0, 0.0]), base)  # type: ignore[arg-type]
    moved = dynamics.torque(motion, heavier)  # type: ignore[arg-type]
    assert base + 0.5 * own[..., 0] == pytest.approx(moved, abs=1e-9)


def test_a_low_pass_keeps_a_slow_motion_and_its_derivative() -> None:
    low_pass = LowPass(rate_hz=1000.0, cutoff_hz=25.0, settings=FilterSettings())
    time = np.arange(4000) / 1000
    slow: Array = np.sin(2 * np.pi * 2.0 * time)[:, None]
    rate = low_pass.derivative(low_pass.smooth(slow))[low_pass.rows(4000)]
    wanted = 4 * np.pi * np.cos(2 * np.pi * 2.0 * time)[:, None][low_pass.rows(4000)]
    assert low_pass.stride == 16
    assert rate == pytest.approx(wanted, abs=0.02)


def test_a_recording_without_positions_is_refused(sound: Path, tmp_path: Path) -> None:
    whole = read_recording(sound).runs[0]
    sensors = {name: x for name, x in whole.sensors.items() if name != "joint2_pos"}
    run = Run(name="run", time=whole.time, controls=whole.controls, sensors=sensors)
    write_recording(tmp_path / "arm", model_xml=XML, runs=[run])
    with pytest.raises(Exception, match="'joint2' has no position sensor"):
        joint_runs(read_recording(tmp_path / "arm"))


@pytest.mark.parametrize(
    ("before", "after", "effects", "verdict"),
    [(1.1, 1.1, 0, "no_gap"), (3.0, 3.0, 0, "unexplained"),
     (3.0, 1.1, 1, "named"), (3.0, 2.9, 1, "unexplained")],
)  # fmt: skip
def test_effects_are_named_where_they_explain_most(
    tmp_path: Path, before: float, after: float, effects: int, verdict: str
) -> None:
    from loose_env.gap import NamedEffect

    effect = NamedEffect(kind="link_mass", where="link1", parameters={"mass": 1.0})
    result = write_finding(
        tmp_path,
        Finding(method="m", before=before, after=after, held_out="r", effects=[effect] * effects),
    )
    assert result.verdict == verdict
    assert len(result.effects) + len(result.doubtful) == effects


def test_an_improvement_in_one_block_is_no_improvement() -> None:
    before = np.ones((400, 1))
    after = before.copy()
    after[:20] = 0.0
    assert improvement_z(before, after, 100.0, NetworkSettings()) < 2.0
    assert improvement_z(before, 0.5 * before, 100.0, NetworkSettings()) > 100.0


# Rows and the table


def stub(verdict: str, recording: Path, folder: Path, tolerance: float) -> None:
    gap = {"before": 2.0, "after": 1.0}
    result = {"format": "loose-gap/1", "verdict": verdict, "effects": [], "gap": gap}
    (folder / "result.json").write_text(json.dumps(result))


def rows_of(tool: str, out: Path, verdict: str, numbers: list[int]) -> None:
    folder = out / suite.folder_of(tool).name
    folders = Folders(out=folder, blind=out / "blind", keep=True)
    folders.truth.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        name = name_of(number)
        (folders.recordings / name).mkdir(parents=True, exist_ok=True)
        (folders.recordings / name / "recording.json").write_text("{}")
        truth = {
            "format": "gap-truth/1", "case": name, "role": role_of(number), "form": "forward",
            "effects": [],
        }  # fmt: skip
        (folders.truth / f"{name}.json").write_text(json.dumps(truth))
    store = suite.store_in(folder, tool=tool)
    suite.run_suite(numbers, folders, store, tool=partial(stub, verdict), backend=THREADS)


def test_rows_of_tools_never_mix(tmp_path: Path) -> None:
    rows_of("loose_gap", tmp_path, "no_gap", [0, 1, 2])
    folder = tmp_path / suite.folder_of("loose_gap").name
    with pytest.raises(InvalidSetting):
        suite.store_in(folder, tool="stepwise_bic")
    configurations = [suite.configuration(tool)["tool"] for tool in ("sysid", "stepwise_bic")]
    assert configurations[0] != configurations[1]
    assert len({suite.folder_of(tool) for tool in suite.TOOLS}) == len(suite.TOOLS)


def test_the_table_is_of_the_cases_that_all_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows_of("loose_gap", tmp_path, "no_gap", [0, 1, 2])
    rows_of("stepwise_bic", tmp_path, "unexplained", [1, 2, 3])
    page = tmp_path / "page.md"
    page.write_text("<!-- methods: begin -->\n<!-- methods: end -->\n")
    comparison.main(["--out", str(tmp_path), "--docs", str(page)])
    said = capsys.readouterr().out
    assert "2 cases that all methods have run: 1-2." in said
    first, second = page.read_text().splitlines()[6:8]
    assert first.startswith("| `loose gap` |") and "0/2 = 0 %" in first
    assert second.startswith("| stepwise selection, BIC |") and "2/2 = 100 %" in second


def test_every_method_has_a_label_and_a_function() -> None:
    assert set(comparison.LABELS) == set(suite.TOOLS)
    for name, (_, function) in METHODS.items():
        assert function == f"run_{name}"
    with pytest.raises(InvalidSetting, match="there are loose_gap"):
        suite.tool_named("guessing")


def test_failed_cases_count_in_the_table() -> None:
    marks: dict[str, Any] = {"number": 1000, "grade": None}
    from dataclasses import asdict

    from scripts.suites.gap.grading import failed

    effect = {"kind": "payload", "where": "tool", "size": {"ratio": 2.0}}
    truth = {"case": "c", "role": "single", "form": "forward", "effects": [effect]}
    marks["grade"] = asdict(failed(truth))
    cells = comparison.method_row("sysid", [marks]).cells
    assert cells[0].startswith("0/1") and cells[-1] == "none"
    assert math.isnan(failed(truth).gap_after)
