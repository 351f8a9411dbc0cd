"""Settings: one set for the choice of the next measurement, checked for types and ranges."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidSetting
from loose_env.instrument.settings.arm_and_plan import ModelSettings, PlanSettings
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.instrument.settings.tolerances import Tolerances

KINDS: tuple[Any, ...] = (
    NextSettings,
    DiagnoseSettings,
    Tolerances,
    MotionSettings,
    PlanSettings,
    ModelSettings,
)


def test_plan_and_diagnosis_choose_with_the_same_settings_and_defaults() -> None:
    own = {each.name for each in dataclasses.fields(NextSettings)}
    assert own <= {each.name for each in dataclasses.fields(DiagnoseSettings)}
    assert DiagnoseSettings().choice() == NextSettings()
    limited = DiagnoseSettings(most_tool=2.0, torque_share=0.3, noise_ug=300.0, ground_m=0.1)
    assert limited.choice() == NextSettings(
        most_tool=2.0, torque_share=0.3, noise_ug=300.0, ground_m=0.1
    )


def test_the_rate_is_the_one_asked_for_unless_the_recorder_is_slower() -> None:
    assert DiagnoseSettings().choice(10_000.0).rate_hz == 1000.0
    assert DiagnoseSettings().choice(999.8).rate_hz == 1000.0
    assert DiagnoseSettings().choice(500.0).rate_hz == 500.0


@pytest.mark.parametrize("kind", KINDS)
def test_no_field_takes_a_value_of_another_type(kind: Any) -> None:
    for each in dataclasses.fields(kind):
        for wrong in ({}, object(), "no such", [None], True, np.array(["a"])):
            if wrong == "no such" and each.name in ("tool", "joint", "package_path"):
                continue
            if wrong is True and each.type == "bool":
                continue
            with pytest.raises(InvalidSetting, match=each.name):
                kind(**{each.name: wrong})


@pytest.mark.parametrize("kind", KINDS)
def test_no_number_is_taken_that_is_none(kind: Any) -> None:
    for each in dataclasses.fields(kind):
        if isinstance(each.default, float):
            for wrong in (float("nan"), float("inf"), 10**400):
                with pytest.raises(InvalidSetting, match=each.name):
                    kind(**{each.name: wrong})


def test_numbers_of_numpy_and_whole_ones_are_numbers() -> None:
    taken = NextSettings(seconds=np.float32(2.0), most_tool=2)  # type: ignore[arg-type]
    assert (taken.seconds, taken.most_tool) == (2.0, 2)


def test_a_record_that_no_memory_holds_is_refused() -> None:
    with pytest.raises(InvalidSetting, match="more than 5000000 samples"):
        NextSettings(seconds=600.0, rate_hz=1e5)


def test_a_band_ends_where_the_rate_allows() -> None:
    assert NextSettings(rate_hz=250.0).band_of((30.0, 150.0)) == (30.0, 100.0)
    assert DiagnoseSettings(band_high=140.0).choice(300.0).band_high == pytest.approx(120.0)
    with pytest.raises(InvalidSetting, match=r"band_high is at most 0\.4 of the rate, 100 Hz"):
        NextSettings(rate_hz=250.0, band_high=140.0)
    with pytest.raises(InvalidSetting, match="a rate of 60 Hz allows up to 24 Hz"):
        NextSettings(rate_hz=60.0).band_of((30.0, 150.0))


def test_nobody_is_asked_for_more_certainty_than_there_is() -> None:
    assert DiagnoseSettings(sure=0.995).sure == 0.995
    with pytest.raises(InvalidSetting, match=r"sure is at most 0\.995"):
        DiagnoseSettings(sure=0.999)
