from __future__ import annotations

import ast
import dataclasses
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

import scripts.suites.machines as machines
from scripts.suites.machines.case import CaseMade, CaseSettings, draw, play
from scripts.suites.machines.machine import (
    KINDS,
    Disturbances,
    Machine,
    Unstable,
    nominal_xml,
)

pytestmark = pytest.mark.slow

SHORT = CaseSettings(runs=1, poses=1, seconds=0.1)
OPENS = 5  # a case whose fault opens
PACKAGE_FREE = ("machine", "case")


@cache
def made(name: str, healthy: bool = True) -> CaseMade:
    own = Disturbances.none() if name == "none" else Disturbances.only(name)
    return play(draw(OPENS, 1, SHORT, disturbances=own, healthy=healthy))


def columns(name: str, condition: str = "suspect") -> dict[str, np.ndarray]:
    return next(r.columns for r in made(name).runs if r.condition == condition)


@pytest.mark.parametrize("module", PACKAGE_FREE)
def test_the_generator_shares_no_code_with_the_package(module: str) -> None:
    assert machines.__file__ is not None
    text = Path(machines.__file__).with_name(f"{module}.py").read_text("utf-8")
    for node in ast.walk(ast.parse(text)):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        for name in names:
            assert name.split(".")[0] not in ("loose_env", "loose_agents")
            assert not name.startswith("scripts.") or name.startswith("scripts.suites.machines.")


def test_arms_have_three_to_seven_joints_and_a_model_of_each_compiles() -> None:
    joints = set()
    for number in range(25):
        case = draw(number, 1, SHORT)
        model = mujoco.MjModel.from_xml_string(nominal_xml(case.arm))
        assert model.nv == case.arm.joints
        assert (np.diff(case.arm.masses) <= 0).all()
        joints.add(model.nv)
    assert joints == {3, 4, 5, 6, 7}


def test_healthy_cases_and_references_are_half_of_all() -> None:
    drawn = [draw(number, 1, SHORT) for number in range(8)]
    assert sum(case.truth == "healthy" for case in drawn) == 4
    for healthy in (True, False):
        own = [case for case in drawn if (case.truth == "healthy") == healthy]
        assert sum(case.reference for case in own) == 2


def test_the_same_seed_gives_the_same_recording_and_another_one_another() -> None:
    first, again = (play(draw(3, 1, SHORT)).runs[-1].columns for _ in range(2))
    assert all(np.array_equal(first[name], again[name]) for name in first)
    other = play(draw(3, 2, SHORT)).runs[-1].columns
    assert not np.array_equal(first["ctrl.servo1"], other["ctrl.servo1"])


def test_a_loose_seat_moves_within_its_travel_and_changes_the_tools_motion() -> None:
    found = made("none", healthy=False)
    assert found.opens and found.opened == 1
    assert 0.02 < found.travel[0] < 0.6
    assert found.change[0] > 0.05


def test_a_machine_without_disturbances_moves_as_its_model() -> None:
    found = made("none")
    run, case = found.runs[-1], found.case
    model = mujoco.MjModel.from_xml_string(case.model_xml)
    model.opt.timestep = 1e-4
    data = mujoco.MjData(model)
    data.qpos[:] = list(run.pose.values())
    n = case.arm.joints
    time = run.columns["time"]
    angles = np.stack([run.columns[f"sensor.joint{j + 1}_pos"] for j in range(n)], axis=1)
    data.qpos[:] = angles[0]
    assert np.allclose(angles[0], list(run.pose.values()), atol=0.02)
    speeds = (angles[1] - angles[0]) / (time[1] - time[0])
    data.qvel[:] = speeds
    commands = np.stack([run.columns[f"ctrl.servo{j + 1}"] for j in range(n)], axis=1)
    for k in range(round(0.02 / 1e-4)):
        now = k * 1e-4
        data.ctrl[:] = [np.interp(now, time, c) for c in commands.T]
        mujoco.mj_step(model, data)
    expected = [np.interp(0.02, time, a) for a in angles.T]
    assert np.abs(data.qpos - expected).max() < 0.2 * np.ptp(angles, axis=0).max()


@pytest.mark.parametrize("name", sorted(set(KINDS) - {"friction_drift", "torque_saturation"}))
def test_each_disturbance_alone_changes_the_record(name: str) -> None:
    usual, other = columns("none"), columns(name)
    assert usual.keys() == other.keys()
    scale = max(np.ptp(usual[f"sensor.tool_acc.{k}"]) for k in "xyz")
    changed = max(
        np.abs(usual[c] - other[c]).max() / (scale if "acc" in c else np.ptp(usual[c]) + 1e-9)
        for c in usual
    )
    assert changed > 3e-4
    assert all(np.isfinite(values).all() for values in other.values())


def test_a_drive_saturates_at_its_own_limit_and_not_at_the_models() -> None:
    peaks = {}
    for name in ("none", "torque_saturation"):
        own = Disturbances.none() if name == "none" else Disturbances.only(name)
        case = draw(OPENS, 1, SHORT, disturbances=own, healthy=True)
        machine = Machine(case.arm, own, None, [1, OPENS, 1])
        pose, joint = case.plans[0].pose, case.plans[0].joint
        push = np.zeros(800)
        push[400:] = 2 * case.arm.limit[joint] / case.arm.kp[joint]
        played = machine.play(pose, pose, push, joint, 400, 1.0)
        peaks[name] = np.abs(played.torque[:, joint]).max() / case.arm.limit[joint]
    assert peaks["none"] == pytest.approx(1.0)
    assert peaks["torque_saturation"] == pytest.approx(0.8 * (0.35 / 0.8) ** 0.75)


def test_friction_differs_between_sessions_only_where_it_drifts() -> None:
    drifting = Disturbances({
        "coulomb_friction": {"share": 0.02}, "friction_drift": {"relative": 0.4},
    })  # fmt: skip
    for own, same in ((Disturbances.only("coulomb_friction"), True), (drifting, False)):
        found = play(draw(2, 1, SHORT, disturbances=own, healthy=True))
        healthy, suspect = (r.columns["sensor.joint1_pos"] for r in found.runs)
        assert np.array_equal(healthy, suspect) == same


def test_sizes_lie_within_their_ranges_and_the_table_has_them_all() -> None:
    rng = np.random.default_rng(0)
    seen: set[str] = set()
    for _ in range(60):
        for name, sizes in Disturbances.draw(rng).sizes.items():
            seen.add(name)
            for key, value in sizes.items():
                assert KINDS[name].parameters[key].low <= value <= KINDS[name].parameters[key].high
    assert seen == set(KINDS)
    with pytest.raises(KeyError):
        Disturbances.only("gremlins")
    with pytest.raises(KeyError, match="no parameter"):
        Disturbances.none().size("cables", "colour")


def test_a_loop_that_does_not_hold_its_pose_is_said_to_be_unstable() -> None:
    own = Disturbances.none()
    case = draw(OPENS, 1, SHORT, disturbances=own, healthy=True)
    stiff = dataclasses.replace(case.arm, kv=-case.arm.kv)
    plan = case.plans[0]
    with pytest.raises(Unstable):
        Machine(stiff, own, None, [1, 1]).play(
            plan.pose, plan.pose, np.zeros(16_000), plan.joint, 8_000, 1.0
        )
