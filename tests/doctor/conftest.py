"""Two recordings of the same arm: on position servos, and on torque motors."""

from __future__ import annotations

import pytest

from loose_env.recording import Recording
from tests.doctor.machine import MOTORS, record


@pytest.fixture(scope="session")
def servo(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("doctor") / "servo")


@pytest.fixture(scope="session")
def motor(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("doctor") / "motor", MOTORS)
