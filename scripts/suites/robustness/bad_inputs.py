"""Bad input of every kind, and the line that `loose doctor` and `loose gap` have for it.

Usage: python -m scripts.suites.robustness.bad_inputs [--docs]

Makes one recording of each kind, runs the commands on it as a user would, and prints a table. With
--docs the table goes into docs/doctor.md.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from loose_env.cli.main import main as loose
from loose_env.typing import Array
from scripts.study import write_between
from scripts.suites.robustness.cases import write_unchecked

__all__ = ["INPUTS", "BadInput", "main", "table"]

DOCS = Path(__file__).resolve().parents[3] / "docs" / "doctor.md"
RATE, SECONDS = 200.0, 8.0
JOINTS = ("turn", "lift", "bend")
MODEL = """<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/>
<worldbody><body pos="0 0 .25"><joint name="turn" axis="0 0 1"/>
 <inertial pos=".04 0 .1" mass="4" diaginertia=".03 .03 .02"/>
 <body pos="0 0 .2"><joint name="lift" axis="0 1 0"/>
  <inertial pos=".18 .03 0" mass="3" diaginertia=".01 .05 .05"/>
  <body pos=".35 0 0"><joint name="bend" axis="0 1 0"/>
   <inertial pos=".14 0 .02" mass="1.6" diaginertia=".004 .015 .015"/>
</body></body></body></worldbody><sensor>{}</sensor></mujoco>""".format(
    "".join(f'<jointpos name="q_{j}" joint="{j}"/>' for j in JOINTS)
)
"""An arm without actuators: torque against motion."""

Columns = dict[str, Array]


@dataclass(frozen=True, kw_only=True)
class BadInput:
    """One kind of bad input, made of a valid recording."""

    name: str
    change: Callable[[Columns], Columns] = dict
    """Columns of a run -> those that are written."""
    model: Callable[[str], str] = str
    """MJCF of the sound arm -> that which is written."""
    file: Callable[[bytes], bytes] = bytes
    """Bytes of a run's file -> those that are written."""


def _column(name: str, column: str, values: Callable[[Array], Array]) -> BadInput:
    """Input of which one column is changed."""
    return BadInput(name=name, change=lambda c: c | {column: values(c[column])})


def _columns(name: str, prefix: str, values: Callable[[Array], Array]) -> BadInput:
    """Input of which all columns of one prefix are changed."""
    return BadInput(
        name=name,
        change=lambda c: {n: values(v) if n.startswith(prefix) else v for n, v in c.items()},
    )


def _another(columns: Columns) -> Columns:
    return columns | {"sensor.q_wrist": columns["sensor.q_bend"]}


def _without_time(columns: Columns) -> Columns:
    return {name: values for name, values in columns.items() if name != "time"}


def _upside_down(xml: str) -> str:
    return xml.replace("0 0 -9.81", "0 0 9.81")


def _ticks(values: Array) -> Array:
    return np.round(values * 4096 / (2 * np.pi))


def _exchanged(columns: Columns) -> Columns:
    first, second = "sensor.q_lift", "sensor.q_bend"
    return columns | {first: columns[second], second: columns[first]}


def _some(values: Array, share: float, instead: float) -> Array:
    chosen = np.random.default_rng(5).random(len(values)) < share
    return np.where(chosen, instead, values)


def _uneven(time: Array) -> Array:
    return time + np.random.default_rng(6).uniform(-0.4, 0.4, len(time)) / RATE


def _later(time: Array, seconds: float) -> Array:
    return np.where(np.arange(len(time)) < len(time) // 2, time, time + seconds)


def _twice(time: Array) -> Array:
    found = time.copy()
    found[len(time) // 2] = found[len(time) // 2 - 1]
    return found


def _shifted(values: Array, samples: int) -> Array:
    return np.concatenate([np.repeat(values[:1], samples), values[:-samples]])


def _clipped(values: Array) -> Array:
    middle, size = 0.5 * (values.max() + values.min()), np.ptp(values)
    return np.clip(values, middle - 0.2 * size, middle + 0.2 * size)


INPUTS: tuple[BadInput, ...] = (
    BadInput(name="a valid recording of a model without actuators"),
    _column("1 % of a channel is 1e282", "sensor.q_bend", lambda v: _some(v, 0.01, 1e282)),
    _column("70 % of a channel is 1e12", "sensor.q_bend", lambda v: _some(v, 0.7, 1e12)),
    _column("6 % of a channel is missing", "torque.lift", lambda v: _some(v, 0.06, np.nan)),
    _column("time steps vary by ± 40 %", "time", _uneven),
    _column("a pause of 30 s", "time", lambda t: _later(t, 30.0)),
    _column("the clock jumps by 1.7e9 s", "time", lambda t: _later(t, 1.7e9)),
    _column("a time stamp comes twice", "time", _twice),
    _column("time runs backwards", "time", lambda t: _later(t, -2.0)),
    _column("times in milliseconds", "time", lambda t: 1e3 * t),
    _column("times in milliseconds, at 1 kHz", "time", lambda t: RATE * t),
    _column("a saturated channel", "torque.lift", _clipped),
    _column("a stuck channel", "sensor.q_lift", lambda v: np.full_like(v, v[0])),
    _column("an encoder of 0.05 rad steps", "sensor.q_lift", lambda v: 0.05 * np.round(20 * v)),
    _columns("positions in degrees", "sensor.q_", np.degrees),
    _columns("positions in ticks (4096 a turn)", "sensor.q_", _ticks),
    _column("a joint's position has the opposite sign", "sensor.q_lift", np.negative),
    BadInput(name="two joints are exchanged", change=_exchanged),
    _columns("torques 100 ms late", "torque.", lambda v: _shifted(v, 20)),
    _columns("torques in N·mm", "torque.", lambda v: 1e3 * v),
    _column("a current in place of a torque (8.5 N·m/A)", "torque.lift", lambda v: v / 8.5),
    BadInput(name="gravity opposite to the model's", model=_upside_down),
    BadInput(name="a column that the model does not have", change=_another),
    BadInput(name="no time column", change=_without_time),
    BadInput(name="a file that is cut off in a row", file=lambda b: b[: int(0.6 * len(b)) - 7]),
    BadInput(name="a file that is no table", file=lambda b: b"\x00\xff" + b[: len(b) // 9]),
    BadInput(name="a model that is no XML", model=lambda xml: xml[:200]),
)
"""All kinds."""


def sound_run(number: int) -> Columns:
    """Columns of a run: sines, the torque that they need with friction, and noise."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data, rng = mujoco.MjData(model), np.random.default_rng([11, number])
    time = np.arange(round(RATE * SECONDS)) / RATE
    rates, phases = rng.uniform(1, 4, (2, model.nv)), rng.uniform(0, 6, (2, model.nv))
    angle = time[:, None, None] * rates + phases
    position, speed = (0.6 * np.sin(angle)).sum(1), (0.6 * rates * np.cos(angle)).sum(1)
    acceleration = (-0.6 * rates**2 * np.sin(angle)).sum(1)
    torque = np.empty_like(position)
    for row, *state in zip(torque, position, speed, acceleration, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        row[:] = data.qfrc_inverse
    size = torque.std(axis=0)
    torque += 0.05 * size * np.sign(speed) + 0.02 * size * rng.normal(size=torque.shape)
    position += rng.normal(0, 1e-4, position.shape)
    columns = {"time": time}
    columns |= {f"sensor.q_{j}": position[:, k] for k, j in enumerate(JOINTS)}
    return columns | {f"torque.{j}": torque[:, k] for k, j in enumerate(JOINTS)}


def write(bad: BadInput, folder: Path) -> None:
    """Write the recording as any recorder might: unchecked."""
    folder.mkdir(parents=True)
    (folder / "model.xml").write_text(bad.model(MODEL), encoding="utf-8")
    runs = {f"run-{number}.csv": bad.change(sound_run(number)) for number in range(2)}
    write_unchecked(folder, "model.xml", runs)
    for name in runs:
        file = folder / name
        file.write_bytes(bad.file(file.read_bytes()))


def said(words: Sequence[str]) -> tuple[int, list[str]]:
    """Exit code and lines of a command."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = loose(list(words))
        except SystemExit as stopped:
            code = stopped.code if isinstance(stopped.code, int) else 1
    lines = (err.getvalue() + out.getvalue()).splitlines()
    return int(code or 0), [line.strip() for line in lines if line.strip()]


def row(bad: BadInput) -> tuple[str, str, str]:
    """Name of the input, first line of `loose doctor` on it, and what `loose gap` does."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, "recording")
        write(bad, folder)
        _, lines = said(["doctor", str(folder)])
        found = next((each for each in lines if not each.startswith("recording (")), "")
        found = found.replace(f"{place}/", "").removeprefix("loose doctor: ")
        code, answer = said(
            ["gap", str(folder), "--out", str(Path(place, "out")), "--kinds", "coulomb_friction",
             "--threads", "1", "--quiet"]
        )  # fmt: skip
    told = answer[-1].removeprefix("loose gap: ") if answer else ""
    stops = "stops" if "preflight" in told or told == found else f"stops: {told}"
    return bad.name, found or "nothing found", stops if code else "goes on"


def table(inputs: Sequence[BadInput] = INPUTS) -> str:
    """Table in Markdown."""
    lines = ["| input | first line of `loose doctor` | `loose gap` |", "|---|---|---|"]
    for bad in inputs:
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in row(bad)) + " |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--docs", action="store_true", help="write the table into docs/doctor.md")
    given = parser.parse_args(arguments)
    made = table()
    print(made)
    if given.docs:
        write_between(DOCS, made, name="bad inputs")


if __name__ == "__main__":
    main()
