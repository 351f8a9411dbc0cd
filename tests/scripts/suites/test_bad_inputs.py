"""Every kind of bad input gets one line, and stops `loose gap` where it would mislead it."""

from __future__ import annotations

import pytest

from scripts.suites.robustness.bad_inputs import INPUTS, row, table

GOES_ON = (
    "a valid recording of a model without actuators",
    "1 % of a channel is 1e282",
    "a pause of 30 s",
)
STOPS = {
    "70 % of a channel is 1e12": "are corrupt",
    "times in milliseconds": "sampled at 0.2 Hz",
    "times in milliseconds, at 1 kHz": "sampled at 1 Hz",
    "positions in ticks (4096 a turn)": "encoder ticks",
    "two joints are exchanged": "sensor.q_lift and sensor.q_bend exchanged",
    "gravity opposite to the model's": "180 degrees from the model's",
    "no time column": "a run needs it",
}
OF = {bad.name: bad for bad in INPUTS}


@pytest.mark.parametrize("name", GOES_ON)
def test_a_recording_with_few_bad_samples_is_used(name: str) -> None:
    _, line, gap = row(OF[name])
    assert gap == "goes on" and not line.startswith("error")


@pytest.mark.parametrize("name", STOPS)
def test_a_recording_that_would_mislead_is_stopped_with_a_line(name: str) -> None:
    _, line, gap = row(OF[name])
    assert STOPS[name] in line and gap == "stops"


def test_the_table_has_a_row_for_each_input() -> None:
    lines = table(INPUTS[:2]).splitlines()
    assert len(lines) == 4 and all(line.count("|") == 4 for line in lines)
