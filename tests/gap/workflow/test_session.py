"""Effects of one's own tried step by step, and the whole search in one call."""

from __future__ import annotations

from copy import copy
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.output.result import GapResult, read_result
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.explain import explain_gap
from loose_env.gap.workflow.session import GapSession, TriedEffect
from loose_env.recording import Recording
from tests.gap.cases.own_effects import CubicSpring
from tests.gap.cases.sprung_arm import STIFFNESS, sprung

SETTINGS = GapSettings(threads=1, kinds=("coulomb_friction", "joint_spring"))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return sprung(tmp_path_factory.mktemp("arm") / "sprung")


@pytest.fixture(scope="module")
def said() -> list[str]:
    """What the session says."""
    return []


@pytest.fixture(scope="module")
def nominal(recording: Recording, said: list[str]) -> GapSession:
    return GapSession(recording, SETTINGS, say=said.append)


@pytest.fixture
def steps(nominal: GapSession) -> GapSession:
    """A session of its own, to which nothing was added yet."""
    return copy(nominal)


@pytest.fixture(scope="module")
def tried(nominal: GapSession) -> TriedEffect:
    return nominal.try_effect(CubicSpring, "elbow")


def test_an_effect_of_ones_own_is_fitted_and_judged(steps: GapSession, tried: TriedEffect) -> None:
    assert tried.before == steps.nominal.held_out_rms > 5
    assert tried.held_out < 1.1 and tried.accepted
    assert tried.improvement.held_out > 2 and tried.improvement.share > 0.9
    assert tried.parameters["size"] == pytest.approx(STIFFNESS, rel=0.05)
    assert str(tried).startswith("cubic_spring@elbow: size ") and str(tried).endswith("; accepted")
    assert "cubic_spring@elbow" in tried._repr_html_()


def test_one_of_the_catalogue_is_tried_the_same_way(steps: GapSession, tried: TriedEffect) -> None:
    friction = steps.try_effect("coulomb_friction", "elbow")
    assert friction.held_out > tried.held_out and friction.effect.kind == "coulomb_friction"
    again = steps.try_effect(CubicSpring(steps.machine, "elbow"), start=[30.0])
    assert again.parameters["size"] == pytest.approx(tried.parameters["size"], rel=0.01)


def test_what_is_added_stays_and_what_is_left_is_noise(
    steps: GapSession, tried: TriedEffect, said: list[str], tmp_path: Path
) -> None:
    before = steps.residual_torque("elbow")
    late = steps.try_effect("joint_spring", "elbow")
    steps.add(tried)
    assert [repr(effect) for effect in steps.added] == ["cubic_spring@elbow"]
    with pytest.raises(InvalidSetting, match=r"before cubic_spring@elbow was added"):
        steps.add(late)
    left = steps.residuals()
    assert {series.channel for series in left} == {"sensor.encoder", "sensor.rate"}
    assert all(0.9 < series.rms < 1.1 for series in left)
    after = steps.residual_torque("elbow")
    cube = before.position**3
    assert np.polyfit(cube, before.torque, 1)[0] == pytest.approx(STIFFNESS, rel=0.2)
    assert abs(np.polyfit(cube, after.torque, 1)[0]) < 0.2 * STIFFNESS
    friction = steps.try_effect("coulomb_friction", "elbow")
    assert friction.before == steps.best.held_out_rms and not friction.accepted
    (named,) = steps.named()
    low, high = named.interval_95["size"]
    assert low < named.parameters["size"] < high and high - low < 0.2 * STIFFNESS
    (file,) = steps.write_model(tmp_path / "model.xml")
    assert mujoco.MjModel.from_xml_path(str(file)).nv == 1
    assert "torque[0] -= " in steps.code and steps.code.startswith("# before every mj_step")
    assert said[0].startswith("nominal model: ") and any("added" in line for line in said)


def test_what_cannot_be_tried_is_refused(steps: GapSession) -> None:
    with pytest.raises(InvalidSetting, match=r"cubic_spring needs a location, one of \['elbow'\]"):
        steps.try_effect(CubicSpring)
    with pytest.raises(InvalidSetting, match="leave out 'elbow'"):
        steps.try_effect(CubicSpring(steps.machine, "elbow"), "elbow")
    with pytest.raises(UnknownName, match="shoulder"):
        steps.try_effect(CubicSpring, "shoulder")
    with pytest.raises(UnknownName, match="rust"):
        steps.try_effect("rust", "elbow")
    with pytest.raises(UnknownName, match="shoulder"):
        steps.residual_torque("shoulder")

    class Idle(CubicSpring):
        kind = "idle"

        def law(self, angle: np.ndarray, speed: np.ndarray) -> np.ndarray:
            return 0.0 * angle

    with pytest.raises(InvalidData, match="idle@elbow changes nothing"):
        steps.try_effect(Idle, "elbow")


def test_a_second_one_is_tried_beside_the_first(steps: GapSession) -> None:
    for _ in range(2):
        tried = steps.try_effect("torque_ripple", "elbow", start=[0.5, 2.0, 0.0])
        steps.add(tried)
    assert [repr(effect) for effect in steps.added] == ["torque_ripple@elbow"] * 2


def test_there_is_no_room_for_a_second_spring_at_a_joint(
    steps: GapSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    spring = CATALOGUE["joint_compliance"](steps.machine, "elbow")
    monkeypatch.setattr(GapSession, "added", (spring,))
    with pytest.raises(InvalidSetting, match=r"^joint_compliance@elbow was added already, .*other"):
        steps.try_effect("joint_compliance", "elbow")
    with pytest.raises(InvalidSetting, match="added already"):
        steps.try_effect(spring)


@pytest.fixture(scope="module")
def result(
    recording: Recording, tmp_path_factory: pytest.TempPathFactory
) -> tuple[GapResult, Path]:
    folder = tmp_path_factory.mktemp("out") / "gap"
    return explain_gap(recording, SETTINGS, folder=folder), folder


def test_one_call_gives_what_the_result_file_holds(result: tuple[GapResult, Path]) -> None:
    found, folder = result
    assert read_result(folder).to_json() == found.to_json()
    assert set(found.gap.by_horizon_s) == {"0.1", "0.5", "2.0"} and found.held_out_runs
    assert mujoco.MjModel.from_xml_path(str(folder / "model.xml")).nu == 1
    assert found.ranking and found.gap.after <= found.gap.before
