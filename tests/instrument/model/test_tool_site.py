"""Plan and diagnosis take the same accelerometer for the tool's, and a load sits where it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loose_env.instrument.model.instrumented_arm import (
    InstrumentedArm,
    read_arm,
    read_recorded_arm,
)
from loose_env.instrument.settings.arm_and_plan import ModelSettings
from tests.instrument.arms.plan_arms import SERVOED, written

_SENSORS = '<sensor><accelerometer name="outer" site="tool"/></sensor></mujoco>'
_INNER = '<site name="mid" pos=".2 0 .03"/><body name="fore"'
_TWIN = '<site name="tool" pos=".35 .03 0"/><site name="beside" pos=".3 0 0"/>'


def machine_of(folder: Path, text: str, settings: ModelSettings) -> tuple[InstrumentedArm, str]:
    made = read_arm(written(folder, text), settings).recording_model
    return read_recorded_arm(written(folder, made.xml, "recorded.xml")), made.site


def test_a_tool_that_was_named_stays_the_tool_of_the_recording(tmp_path: Path) -> None:
    """The model's own accelerometer sits farther out; its column may still be recorded."""
    text = SERVOED.replace('<body name="fore"', _INNER).replace("</mujoco>", _SENSORS)
    machine, site = machine_of(tmp_path, text, ModelSettings(tool="mid"))
    assert machine.sites[0] == site == "mid"
    assert machine.joints == ("pan", "lift")


def test_of_two_sites_on_a_link_the_named_one_is_the_tool(tmp_path: Path) -> None:
    text = SERVOED.replace('<site name="tool" pos=".35 .03 0"/>', _TWIN)
    text = text.replace("</mujoco>", _SENSORS)
    machine, _ = machine_of(tmp_path, text, ModelSettings(tool="beside"))
    assert machine.sites == ("beside", "tool")
    at_tool = [r.sensor for r in machine.readings if r.kind == "acceleration" and r.at == 0]
    assert at_tool == ["tool_accelerometer"]


def test_what_is_not_named_is_the_same_for_plan_and_diagnosis(tmp_path: Path) -> None:
    both = _SENSORS.replace("<accel", '<accelerometer name="first" site="beside"/><accel', 1)
    text = SERVOED.replace('<site name="tool" pos=".35 .03 0"/>', _TWIN).replace("</mujoco>", both)
    machine, site = machine_of(tmp_path, text, ModelSettings())
    assert machine.sites[0] == site == "beside"
    assert (
        read_recorded_arm(tmp_path / "arm.xml").sites[0] == "beside"
    )  # also of the model as it was given


@pytest.mark.parametrize(
    "place",
    [
        '<site name="tool" pos=".3 .02 0" euler="0 90 0"/>',
        '<site name="tool" pos=".3 .02 0" zaxis="1 0 0"/>',
        '<frame pos=".3 0 0" euler="0 90 0"><site name="tool" pos="0 .02 0"/></frame>',
    ],
)
def test_a_load_sits_in_the_tool_frame_however_the_file_writes_it(
    tmp_path: Path, place: str
) -> None:
    text = SERVOED.replace('<site name="tool" pos=".35 .03 0"/>', place)
    settings = ModelSettings(payload_kg=2.0, payload_at_m=(0.0, 0.0, 0.2))
    model = read_arm(written(tmp_path, text), settings).recording_model.model
    assert model.body("payload").pos == pytest.approx(np.array([0.5, 0.02, 0.0]), abs=1e-9)
