"""Recordings of three formats, imported by a guessed mapping and explained by ``loose gap``."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from loose_env.cli.main import main
from tests.importing.formats.arm_log import Motion, moved, write_bag, write_lerobot, write_rtde

pytestmark = pytest.mark.slow

WRITERS: dict[str, Callable[[Path, Motion], Path]] = {
    "lerobot": lambda home, m: write_lerobot(home / "log", m, episodes=1),
    "rtde": lambda home, m: write_rtde(home / "log.csv", m),
    "rosbag2": lambda home, m: write_bag(home / "log", m),
}


@pytest.mark.parametrize("kind", list(WRITERS))
def test_the_gap_of_an_imported_log_names_the_friction_of_the_elbow(home: Path, kind: str) -> None:
    log = str(WRITERS[kind](home, moved(friction=2.0)))
    model, mapping = str(home / "arm.xml"), home / "map.toml"
    told = ["import", "--guess", log, "--model", model, "--mapping", str(mapping)]
    assert main(told) == 0
    # By the commands alone, and one log cut into the two runs that a fit and its check need.
    lines = mapping.read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith('"torque.'))
    first, second = "\nstart = 0.0\nstop = 3.9\n", "\nfile = 'b'\nstart = 4.0\nstop = 7.9\n"
    mapping.write_text(f"{text}{first}[[runs]]{second}")
    assert main(["import", log, "--mapping", str(mapping), "--out", str(home / "out")]) == 0
    told = ["gap", str(home / "out"), "--out", str(home / "gap")]
    told += ["--kinds", "viscous_friction", "--most-effects", "1", "--threads", "1"]
    assert main(told) == 0
    result = json.loads((home / "gap" / "result.json").read_text())
    (effect,) = result["effects"]
    assert (effect["kind"], effect["where"]) == ("viscous_friction", "elbow")
    assert result["gap"]["after"] < 0.2 * result["gap"]["before"]
