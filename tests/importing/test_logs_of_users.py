"""Logs as users have them are guessed and imported rightly, or refused with what to do.

``python -m tests.importing.test_logs_of_users`` prints the table of all of them.
"""

from __future__ import annotations

import contextlib
import io
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from math import pi
from pathlib import Path

import pytest

from loose_env.cli.main import main as loose
from loose_env.importing import read_mapping
from loose_env.recording import read_recording

CASES = Path(__file__).resolve().parents[3] / "shared" / "cases"
DEG = pi / 180
Told = dict[str, tuple[str, float]]
"""Column of the recording -> part of the channel's name, and its factor to SI."""


@dataclass(frozen=True, kw_only=True)
class Log:
    """One log, typed as a user would, and its right answer."""

    case: str
    """Folder of the case."""
    files: tuple[str, ...]
    """Files or folders given on the command line, as patterns."""
    model: str
    runs: int = 0
    columns: Told = field(default_factory=dict)
    seconds: float = 0.0
    """Length of the shortest run [s]."""
    said: str = ""
    """Pattern of a line that has to be said, by a refusal where there are no runs."""


def _joints(names: Sequence[str], sensor: str, channel: str, factor: float) -> Told:
    return {sensor.format(n): (channel.format(n), factor) for n in names}


_UR = [
    f"{n}_joint"
    for n in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
]
_SO = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex")
_HOBBY = ("shoulder_pan", "shoulder_lift", "elbow_flex")
_HOBBY_BOTH = _joints(_HOBBY, "sensor.{}_pos", "state[{}.pos]", DEG) | _joints(
    _HOBBY, "ctrl.{}", "action[{}.pos]", DEG
)
_URDF = ("shoulder", "elbow", "wrist", "finger_left_joint")
_LEG = ("hip", "thigh", "calf")
_ARM3 = ("pan", "lift", "elbow")
_ARM3_BOTH = _joints(_ARM3, "sensor.{}_pos", "{}_pos", 1) | _joints(_ARM3, "ctrl.{}", "{}_cmd", 1)
_UR_BOTH = _joints(_UR, "sensor.{}_pos", "position[{}]", 1) | {
    f"ctrl.{n}": (f"data[{i}]", 1) for i, n in enumerate(_UR)
}
_UNEVEN = ("19-lerobot-broken-datasets", "hobby.xml")


def _hobby(name: str, **more: object) -> Log:
    right: dict[str, object] = {"runs": 4, "columns": _HOBBY_BOTH, "seconds": 19.0} | more
    return Log(case=_UNEVEN[0], files=(name,), model=_UNEVEN[1], **right)  # type: ignore[arg-type]


LOGS = (
    Log(case="01-lerobot-gripper-percent", files=("so_arm_dataset",), model="so_arm.xml", runs=4,
        seconds=19.9,
        columns=_joints(_SO, "sensor.{}_pos", "state[{}.pos]", DEG)
        | _joints(_SO, "ctrl.{}", "action[{}.pos]", DEG)
        | {"sensor.gripper_pos": ("state[gripper.pos]", 0.0192),
           "ctrl.gripper": ("action[gripper.pos]", 0.0192)}),
    Log(case="03-rosbag-joint-order-nan", files=("rosbag2_run*",), model="ur_like.xml", runs=3,
        seconds=11.9, columns=_UR_BOTH, said="NaN|no number|missing"),
    Log(case="03-rosbag-joint-order-nan", files=("run*.mcap",), model="ur_like.xml", runs=3,
        seconds=11.9, columns=_UR_BOTH, said="NaN|no number|missing"),
    Log(case="06-urdf-mimic-gripper", files=("run*.csv",), model="jaw_arm.urdf", runs=3,
        seconds=14.9,
        columns=_joints(_URDF, "sensor.{}_pos", "{}.position", 1)
        | _joints(_URDF, "sensor.{}_vel", "{}.velocity", 1)
        | _joints(_URDF, "torque.{}", "{}.effort", 1)),
    Log(case="08-delay-commands-on-change", files=("leg_log_*.csv",), model="leg.xml", runs=3,
        seconds=14.99,
        columns=_joints(_LEG, "sensor.{}_pos", "{}_q", 1) | _joints(_LEG, "ctrl.{}", "{}_des", 1)),
    Log(case="10-harmonic-drive-sweep", files=("sweep_*.csv",), model="axis.xml", runs=3,
        seconds=11.99,
        columns={"ctrl.drive": ("torque_cmd", 1), "sensor.motor_angle": ("angle", DEG),
                 "sensor.motor_speed": ("speed", pi / 30)}),
    Log(case="11-palletiser-closed-loop", files=("palletiser_*.csv",), model="palletiser.xml",
        runs=3, seconds=11.9,
        columns=_joints(("shoulder", "crank"), "sensor.{}_pos", "{}.pos", 1)
        | _joints(("shoulder", "crank"), "ctrl.{}", "cmd.{}", 1)),
    Log(case="12-gantry-mm-clock-overflow", files=("messung_*.csv",), model="gantry.xml", runs=3,
        seconds=9.99, said="overflow|wraps",
        columns={f"sensor.{a}_scale": (f"Ist {a.upper()}", 1e-3) for a in "xyz"}
        | {f"ctrl.{a}": (f"Soll {a.upper()}", 1e-3) for a in "xyz"}),
    Log(case="14-gimbal-wrapped-angles", files=("gimbal_*.csv",), model="gimbal.xml", runs=3,
        seconds=14.9, said="unwrap|wraps",
        columns={f"sensor.{a}_pos": (f"{a}_deg", DEG) for a in ("yaw", "tilt")}
        | {f"ctrl.{a}": (f"{a}_cmd_deg", DEG) for a in ("yaw", "tilt")}
        | {f"sensor.imu_gyro.{a}": (f"gyro_{a}_dps", DEG) for a in "xyz"}),
    Log(case="18-clock-step-and-late-rows", files=("log_[01].csv",), model="arm3.xml", runs=2,
        seconds=15.9, columns=_ARM3_BOTH, said="late|sorted"),
    Log(case="18-clock-step-and-late-rows", files=("log_wall_only_*.csv",), model="arm3.xml",
        said=r"line \d+: time runs backwards.*stamp_ns.*\d{10,} after \d{10,}"),
    _hobby("a_video_and_actions_only", runs=0, columns={}, said="action|state"),
    _hobby("b_uneven_timestamps"),
    _hobby("c_without_meta_episodes"),
    _hobby("d_names_missing", columns={
        f"{kind.format(n)}": (f"{channel}[{i}]", DEG)
        for kind, channel in (("sensor.{}_pos", "state"), ("ctrl.{}", "action"))
        for i, n in enumerate(_HOBBY)}),
    _hobby("e_epoch_in_float32", said="float32|frame"),
    *(Log(case="onejoint", files=(file,), model="arm.xml", runs=1, seconds=5.0,
          columns={"ctrl.drive": (command, 1), "sensor.enc": (angle, 1), "sensor.rate": (speed, 1)})
      for file, command, angle, speed in (
          ("a.csv", "command", "position", "velocity"), ("b.csv", "setpoint", "angle", "speed"),
          ("c.csv", "x1", "x2", "x3"))),
)  # fmt: skip


LONG_MADE = {log.case for log in LOGS if log.case[:2] in ("01", "03", "08", "12")}
"""Cases whose files take more than five seconds; `test_formats` reads their formats."""


def tried(log: Log, case: Path) -> tuple[str, str]:
    """Outcome of a log of a case's folder, and the reason where it is wrong."""
    files = [str(p) for pattern in log.files for p in sorted(case.glob(pattern))]
    with tempfile.TemporaryDirectory() as place:
        mapping, out = Path(place, "map.toml"), Path(place, "rec")
        told = ["--model", str(case / log.model), "--mapping", str(mapping)]
        code, said = run("import", "--guess", *files, *told)
        if code == 0:
            code, more = run("import", *files, *told, "--out", str(out))
            said += more
        if code:
            last = said.strip().splitlines()[-1] if said.strip() else ""
            if log.runs:
                return "refused", last
            return ("right: refused" if re.search(log.said, last) else "wrong words"), last
        if not log.runs:
            return "wrong", "imported, and to be refused"
        recording = read_recording(out)
        wrong = list(differences(log, mapping))
        if len(recording.runs) != log.runs:
            wrong.append(f"{len(recording.runs)} runs for {log.runs}")
        shortest = min(float(each.time[-1]) for each in recording.runs)
        if shortest < log.seconds:
            wrong.append(f"{shortest:.3f} s for {log.seconds:g} s")
        if log.said and not re.search(log.said, said):
            wrong.append(f"nothing said of {log.said!r}")
        return ("wrong" if wrong else "right"), "; ".join(wrong)


def differences(log: Log, mapping: Path) -> list[str]:
    """Columns that a mapping has wrong."""
    found: list[str] = []
    entries = read_mapping(mapping).columns
    for column, (channel, factor) in log.columns.items():
        if column not in entries:
            found.append(f"no {column}")
            continue
        own = entries[column]
        actual = own.factor
        if channel not in f"{own.key}" or abs(actual / factor - 1) > 0.02:
            found.append(
                f"{column}: {own.key} times {actual:.4g}, not {channel} times {factor:.4g}"
            )
    found += [f"{column} is not known" for column in entries if column not in log.columns]
    return found


def run(*words: str) -> tuple[int, str]:
    """Exit code and all that a command says."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
        try:
            code = loose(list(words))
        except SystemExit as ended:
            code = int(ended.code or 0)
    return code, told.getvalue()


def maker(place: Path) -> Callable[[str], Path]:
    """Folder of a case in a place, its files made there, once, by its own ``make.py``."""

    def copied(*paths: Path) -> None:
        for path in (p for p in paths if p.is_file()):  # folders there are read-only
            own = place / path.relative_to(CASES)
            own.parent.mkdir(parents=True, exist_ok=True)
            own.write_bytes(path.read_bytes())

    @cache
    def make(case: str) -> Path:
        copied(*CASES.glob("*.py"), *(CASES / case).rglob("*"))
        script = place / case / "make.py"
        if script.is_file():
            subprocess.run([sys.executable, script.name], cwd=script.parent, check=True)
        return script.parent

    return make


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    if not CASES.is_dir():
        pytest.skip("the cases are no part of the repository")
    return maker(tmp_path_factory.mktemp("cases"))


@pytest.mark.parametrize(
    "log",
    [pytest.param(e, marks=pytest.mark.slow if e.case in LONG_MADE else ()) for e in LOGS],
    ids=lambda log: f"{log.case}-{log.files[0]}",
)
def test_a_log_ends_as_it_should(log: Log, made: Callable[[str], Path]) -> None:
    outcome, why = tried(log, made(log.case))
    assert outcome.startswith("right"), why


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        own = maker(Path(folder))
        for each in LOGS:
            files, (end, reason) = " ".join(each.files), tried(each, own(each.case))
            print(f"{each.case:30} {files:26} {end:15} {reason}", flush=True)
