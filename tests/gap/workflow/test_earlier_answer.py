"""An earlier answer is one more hypothesis of a search, and passes the same tests."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import Channel, align_run
from loose_env.gap.diagnostics.experiment_advice import identifiability_notes
from loose_env.gap.fitting.model_structure import nuisance_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.evidence_schema import (
    ConfusablePair,
    Identifiability,
    UnidentifiableEffect,
)
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.forward_selection import select_effects
from loose_env.recording import Run
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR

STEP = 0.002
MACHINE = NominalModel(mujoco.MjSpec.from_string(PLANAR), step=STEP)
CHANNELS = tuple(Channel(f"sensor.encoder{j}") for j in (1, 2, 3))
FLOORS = np.full(3, 2e-5)
TRUE = (CATALOGUE["viscous_friction"](MACHINE, "joint2"), np.array([3.0]))
SECOND = (CATALOGUE["joint_spring"](MACHINE, "joint3"), np.array([12.0, 0.2]))
WRONG = (CATALOGUE["rotor_inertia"](MACHINE, "joint1"), np.array([0.2]))


def runs_of(pairs: list[tuple[Effect, Array]], seed: int, rate: float) -> ResidualModel:
    """Two seconds of all joints, measured on a machine with some effects."""
    time = STEP * np.arange(1000)
    wave = (
        0.5
        * np.minimum(2 * time, 1.0)[:, None]
        * np.sin(np.outer(time, rate * np.array([1.0, 1.4, 1.9])))
    )
    run = Run(
        name=f"{seed}.csv", time=time,
        controls={f"servo{j + 1}": wave[:, j] for j in range(3)},
        sensors={f"encoder{j + 1}": 1e-9 * time for j in range(3)},
    )  # fmt: skip
    trial = align_run(run, MACHINE, CHANNELS, step=STEP)
    plain = ResidualModel(MACHINE, [trial], CHANNELS, FLOORS, threads=1)
    effects, values = zip(*pairs, strict=True)
    shown = plain.predict([Hypothesis(effects=effects, values=values)])[0][0]
    trial.measured[:] = shown + np.random.default_rng(seed).normal(0, FLOORS, shown.shape)
    return ResidualModel(MACHINE, [trial], CHANNELS, FLOORS, threads=1)


@pytest.mark.parametrize("earlier", [[TRUE, SECOND], [WRONG]])
def test_a_right_answer_is_taken_whole_and_a_wrong_one_is_not(
    earlier: list[tuple[Effect, Array]],
) -> None:
    fitted, held = (runs_of([TRUE, SECOND], seed, rate) for seed, rate in ((1, 5.0), (2, 6.0)))
    found = select_effects(
        fitted,
        held,
        nuisance_of(fitted, tolerance=0.03),
        [TRUE[0], SECOND[0], WRONG[0]],
        earlier=earlier,
    )
    names = {(e.kind, e.where) for e in found.best.fitted.effects}
    assert names == {("viscous_friction", "joint2"), ("joint_spring", "joint3")}
    first = {repr(effect) for effect in found.steps[0].fitted.effects}
    assert (len(first) == 2) or earlier == [WRONG]
    assert repr(WRONG[0]) not in first


def test_warnings_name_the_motion_where_there_is_one() -> None:
    found = Identifiability(
        unidentifiable=(
            UnidentifiableEffect(
                kind="payload", where="tool", parameters={"mass": 0.2}, z=1.0, additional_s=None
            ),
        ),
        confusable=(
            ConfusablePair(
                kind="command_delay", where="a", other_kind="actuator_lag", other_where="a",
                z=2.0, additional_s=None,
            ),
            ConfusablePair(
                kind="base_tilt", where="base", other_kind="encoder_offset", other_where="one",
                z=0.1, additional_s=None,
            ),
        ),
    )  # fmt: skip

    def motion(one: str, other: str) -> str | None:
        return None if "base" in one else f"run it for {one} and {other}"

    payload, delay, tilt = identifiability_notes(found, motion)
    assert payload.endswith("(such as mass 0.2); run it for nothing and payload at tool")
    assert delay.endswith("run it for command_delay at a and actuator_lag at a")
    assert "a spirit level on the base decides" in tilt
