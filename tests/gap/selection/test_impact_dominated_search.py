"""What else is missing beside a part that strikes its stops, whose law is not quite the model's."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.checkpoints import Stages, key_of
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.pipeline import GapSolution, find_gap
from loose_env.recording import Recording, write_recording
from tests.gap.cases.level_arm import FINE, LEVEL, moving

pytestmark = pytest.mark.slow

KINDS = ("backlash", "actuator_gain")
COUNT = 2000
GAP, GAIN = 0.01, 0.9


def with_play(folder: Path) -> Recording:
    """Runs of an arm with backlash between stops of another law, and a motor that is weak."""
    spec = mujoco.MjSpec.from_string(LEVEL)
    spec.option.timestep = FINE
    machine = NominalModel(mujoco.MjSpec.from_string(LEVEL), step=FINE)
    play = CATALOGUE["backlash"](machine, "joint2")
    play.edit(spec, np.array([GAP, 4e3, 0.15]))
    added = spec.joints[2]
    assert added.name == "joint2_backlash"
    added.solimp_limit[4] = 1.5  # force grows with travel by another power than on the model's
    servo = spec.actuator("servo1")
    servo.gainprm[0] *= GAIN
    servo.biasprm[1:3] *= GAIN
    speeds = [np.array([7.0 + k, 11.0 - 2 * k, 16.0 + k]) for k in range(3)]
    runs = moving(spec.compile(), speeds, size=0.3, count=COUNT)
    return write_recording(folder, model_xml=LEVEL, runs=runs)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return with_play(tmp_path_factory.mktemp("play") / "r")


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stages")


@pytest.fixture(scope="module")
def whole(recording: Recording, kept: Path) -> tuple[GapSolution, list[str]]:
    lines: list[str] = []
    stages, settings = Stages(kept, key_of(recording, {})), GapSettings(threads=1, kinds=KINDS)
    return find_gap(recording, settings, say=lines.append, stages=stages), lines


def test_a_weak_motor_is_found_beside_play_of_another_law(
    whole: tuple[GapSolution, list[str]],
) -> None:
    found, lines = whole
    assert found.verdict == "named"
    assert {(e.kind, e.where) for e in found.effects} == {
        ("backlash", "joint2"),
        ("actuator_gain", "servo1"),
    }
    own = {e.kind: e for e in found.effects}
    assert own["backlash"].parameters["gap"] == pytest.approx(GAP, rel=0.05)
    low, high = own["actuator_gain"].interval_95["gain"]
    assert 0.8 < low < GAIN < high < 1.0
    assert any("reweighting: the residual of the stops counts as noise" in line for line in lines)
    # told in the noise there is, of which stops leave several times as much
    assert found.base.held_out_rms > 1.5 * found.best.held_out_rms > 4


def test_steps_of_both_searches_are_listed_one_after_the_other(
    whole: tuple[GapSolution, list[str]],
) -> None:
    found, _ = whole
    steps = [each.step for each in found.ranking]
    assert steps == sorted(steps) and set(steps) >= {1, 2}
    first = {each.step: each for each in reversed(found.ranking)}
    assert (first[1].kind, first[2].kind) == ("backlash", "actuator_gain")
    # in the noise there is; by that of its own part it leaves about one
    assert first[2].held_out == pytest.approx(found.best.held_out_rms, rel=0.3)


def test_an_interrupted_second_search_goes_on_where_it_was(
    recording: Recording, kept: Path, whole: tuple[GapSolution, list[str]]
) -> None:
    names = {file.stem for file in kept.iterdir()}
    first = ["nominal", "effect-1", "part-2-begun"]
    assert names > {*first, "part-2-effect-1"}
    for name in names - set(first):
        (kept / f"{name}.npz").unlink()
    stages = Stages(kept, key_of(recording, {}))
    again = find_gap(recording, GapSettings(threads=1, kinds=KINDS), stages=stages)
    assert stages.taken_up == first
    assert again.effects == whole[0].effects and again.ranking == whole[0].ranking
