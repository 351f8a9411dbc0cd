"""Try the commands on generated arms and recordings, and count results, refusals and tracebacks.

    python -m scripts.suites.robustness --examples 500

Each case runs in a process of its own, with its peak memory measured. Rows are kept in the output
folder, and a case that is there is not run again. The exit code is 1 where a case ended with a
traceback, without a clear line, late, or with more memory than allowed.
"""

from __future__ import annotations

import contextlib
import io
import json
import multiprocessing
import resource
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated

import hypothesis
import mujoco
import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from loose_env.arms import quiet
from loose_env.cli.command import command, one_of
from loose_env.recording import write_csv
from loose_env.typing import Array
from scripts.suites.rows import Row, run_cases

ACTUATORS: dict[str, str] = {
    "motor": '<motor name="a_{j}" joint="{j}" gear="{gear}"/>',
    "position": '<position name="a_{j}" joint="{j}" kp="{kp}" kv="{kv}"/>',
    "velocity": '<velocity name="a_{j}" joint="{j}" kv="{kv}"/>',
    "general": '<general name="a_{j}" joint="{j}" dyntype="filter" dynprm=".02" gainprm="{kp}" '
    'biastype="affine" biasprm="0 -{kp} -{kv}"/>',
    "dcmotor": '<dcmotor name="a_{j}" joint="{j}" motorconst="{kv}" resistance="2"/>',
    "intvelocity": '<intvelocity name="a_{j}" joint="{j}" kp="{kp}" kv="{kv}" actrange="-9 9"/>',
    "damper": '<damper name="a_{j}" joint="{j}" kv="{kv}" ctrlrange="0 1"/>',
}
"""Actuator of a joint in MJCF, by its kind."""
_SENSORS = (
    '<jointpos name="q_{j}" joint="{j}"/>',
    '<jointvel name="v_{j}" joint="{j}"/>',
    '<jointactuatorfrc name="f_{j}" joint="{j}"/>',
)
_TOOL = (
    '<accelerometer name="acc" site="tool"/>',
    '<gyro name="gyro" site="tool"/>',
    '<force name="wrench" site="tool"/>',
    '<framepos name="place" objtype="site" objname="tool"/>',
)


@dataclass(frozen=True, kw_only=True)
class ArmFile:
    """Text of a generated model."""

    text: str
    """The file."""
    joints: int
    """Joints of the chain, those of a gripper included."""
    ending: str
    """"xml" or "urdf"."""


_AXES = st.sampled_from(["1 0 0", "0 1 0", "0 0 1", "0 1 0", "0.6 0 0.8"])
_MASS = st.sampled_from([0.02, 0.1, 1.0, 5.0, 30.0])
_LENGTH = st.sampled_from([0.05, 0.1, 0.3, 0.8])
_JOINTS = st.sampled_from([1, 1, 1, 2, 2, 3, 6, 12])


@st.composite
def mjcf_arms(draw: st.DrawFn) -> ArmFile:
    """Serial arms in MJCF, with any mix of drives, a gripper, a mimic joint or a tendon."""
    count = draw(_JOINTS)
    opened, actuators = "", []
    kinds = draw(st.sampled_from(["none", "mixed", *ACTUATORS]))
    for k in range(count):
        mass, length = draw(_MASS), draw(_LENGTH)
        limits = draw(st.sampled_from(["", "", 'range="-2.5 2.5"', 'range="0 0.5"']))
        extra = draw(
            st.sampled_from(
                ["", 'damping="0.1"', 'armature="0.05" frictionloss="0.2"', 'stiffness="3"',
                 'actuatorfrcrange="-5 5"', 'armature="0.01" damping="1"']
            )
        )  # fmt: skip
        slides = draw(st.sampled_from(["hinge", "hinge", "hinge", "slide"]))
        opened += (
            f'<body name="b{k}" pos="0 0 {length}"><joint name="j{k}" type="{slides}" '
            f'axis="{draw(_AXES)}" {limits} {extra}/>'
            f'<geom type="capsule" fromto="0 0 0 0 {length / 3} {length}" size=".02" '
            f'mass="{mass}" contype="0" conaffinity="0"/>'
        )
        kind = draw(st.sampled_from(["none", *ACTUATORS])) if kinds == "mixed" else kinds
        if kind != "none":
            form = ACTUATORS[kind]
            actuators.append(
                form.format(
                    j=f"j{k}",
                    kp=draw(st.sampled_from([1.0, 50.0, 2000.0])),
                    kv=draw(st.sampled_from([0.1, 5.0])),
                    gear=draw(st.sampled_from([1.0, 1.0, -1.0, 0.05, 100.0])),
                )
            )
    closed, more, joints = "</body>" * count, "", [f"j{k}" for k in range(count)]
    hand = draw(st.sampled_from(["", "", "", "", "gripper", "mimic", "tendon"]))
    fingers = ""
    if hand == "gripper" and count <= 10:
        joints += ["left", "right"]
        for name, sign in (("left", 1), ("right", -1)):
            fingers += (
                f'<body pos="0 {sign * 0.03} .02"><joint name="{name}" type="slide" '
                f'axis="0 {sign} 0" range="0 .04"/><geom size=".01" mass=".02" contype="0" '
                'conaffinity="0"/></body>'
            )
        more = '<equality><joint joint1="left" joint2="right"/></equality>'
        actuators.append('<position name="grip" joint="left" kp="100"/>')
    elif hand == "mimic" and count > 1:
        more = '<equality><joint joint1="j0" joint2="j1" polycoef="0 0.5 0 0 0"/></equality>'
    elif hand == "tendon" and count > 1:
        more = (
            '<tendon><fixed name="cord" stiffness="5" damping=".1"><joint joint="j0" coef="1"/>'
            '<joint joint="j1" coef="-0.5"/></fixed></tendon>'
        )
        if draw(st.booleans()):
            actuators.append('<motor name="pull" tendon="cord"/>')
    read = draw(st.sets(st.sampled_from(_SENSORS), max_size=3)) | {_SENSORS[0]}
    sensors = "".join(form.format(j=j) for form in _SENSORS if form in read for j in joints)
    placed = draw(st.sets(st.sampled_from(_TOOL), max_size=2))
    sensors += "".join(sorted(placed | set(draw(st.sampled_from([_TOOL[:1], _TOOL[:1], ()])))))
    step = draw(st.sampled_from(["0.001", "0.002", "0.005", "0.0001"]))
    how = draw(st.sampled_from(["Euler", "implicitfast", "implicit", "RK4"]))
    text = (
        f'<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="{how}"/>'
        f'<worldbody>{opened}<site name="tool" pos="0 0 .1"/>{fingers}{closed}</worldbody>{more}'
        f"<actuator>{''.join(actuators)}</actuator><sensor>{sensors}</sensor></mujoco>"
    )
    return ArmFile(text=text, joints=len(joints), ending="xml")


@st.composite
def urdf_arms(draw: st.DrawFn) -> ArmFile:
    """Serial arms in URDF: revolute, continuous and prismatic joints, dynamics tags, mimic."""
    count = draw(_JOINTS)
    parts = ['<link name="base"/>']
    for k in range(count):
        mass, length = draw(_MASS), draw(_LENGTH)
        inertia = max(mass * length**2 / 12, 1e-6)
        kind = draw(st.sampled_from(["revolute", "revolute", "continuous", "prismatic", "fixed"]))
        kind = "revolute" if k == 0 else kind
        dynamics = draw(st.sampled_from(["", '<dynamics damping="0.5" friction="0.1"/>']))
        mimic = (
            '<mimic joint="j0" multiplier="-1"/>'
            if k == 1 and draw(st.sampled_from([False, False, True]))
            else ""
        )
        effort = draw(st.sampled_from([0, 10, 300]))
        limit = f'<limit lower="-2" upper="2" effort="{effort}" velocity="3"/>'
        if kind == "fixed":
            limit = dynamics = mimic = ""
        parts.append(
            f'<link name="l{k}"><inertial><origin xyz="0 0 {length / 2}"/><mass value="{mass}"/>'
            f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
            f'</inertial></link><joint name="j{k}" type="{kind}">'
            f'<parent link="{f"l{k - 1}" if k else "base"}"/><child link="l{k}"/>'
            f'<origin xyz="0 0 {length}"/><axis xyz="{draw(_AXES)}"/>'
            f"{limit}{dynamics}{mimic}</joint>"
        )
    text = f'<robot name="arm">{"".join(parts)}</robot>'
    return ArmFile(text=text, joints=count, ending="urdf")


def arms() -> st.SearchStrategy[ArmFile]:
    """Arms of either format."""
    return st.one_of(mjcf_arms(), mjcf_arms(), urdf_arms())


DAMAGES = (
    "quantised", "stuck", "saturated", "corrupt", "mostly corrupt", "missing", "noisy", "degrees",
)  # fmt: skip
"""Faults of a channel."""
_CLOCKS = (*["even"] * 9, "uneven", "uneven", "pause", "pause", "jump", "duplicate", "backwards")
_FASTEST = 50.0
"""Largest simulated speed that counts as motion of an arm [rad/s, m/s]."""


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """Recipe of a run."""

    seed: int
    rate: float
    """Samples per second."""
    samples: int
    clock: str
    """Defect of the time stamps; "even" has none."""
    columns: str
    """"ctrl", "torque", "both" or "free"."""
    damages: tuple[str, ...]
    """Faults of channels, each of a channel chosen by the seed."""
    without: float
    """Share of columns left out."""
    still: bool
    """Whether nothing moves."""


def run_plans() -> st.SearchStrategy[RunPlan]:
    """Recipes of runs from 5 Hz to 20 kHz."""
    return st.builds(
        RunPlan,
        seed=st.integers(0, 2**31),
        rate=st.sampled_from([5.0, 20.0, 50.0, 190.0, 500.0, 1000.0, 4000.0, 20000.0]),
        samples=st.sampled_from([10, 40, 150, 400, 1000, 1000, 3000]),
        clock=st.sampled_from(_CLOCKS),
        columns=st.sampled_from(["ctrl", "ctrl", "torque", "both", "free"]),
        damages=st.one_of(
            st.just(()), st.lists(st.sampled_from(DAMAGES), min_size=1, max_size=2).map(tuple)
        ),
        without=st.sampled_from([0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.8]),
        still=st.sampled_from([False, False, False, False, True]),
    )


def make_run(model: mujoco.MjModel, plan: RunPlan, number: int) -> dict[str, Array]:
    """Columns of a recipe's run by their names in a file; the same recipe gives the same run."""
    rng = np.random.default_rng([plan.seed, number])
    time = np.arange(plan.samples) / plan.rate
    columns = _simulated(model, plan, time, rng)
    for damage in plan.damages:
        name = str(rng.choice(list(columns)))
        columns[name] = _damaged(columns[name], damage, rng)
    for name in list(columns):
        if len(columns) > 1 and rng.random() < plan.without:
            del columns[name]
    kept = {"free": ("sensor",), "both": ("ctrl", "sensor", "torque")}
    groups = kept.get(plan.columns, (plan.columns, "sensor"))
    found = {"time": _stamped(time, plan, rng)}
    for group in ("ctrl", "sensor", "torque"):
        for name, values in columns.items():
            if group in groups and name.startswith(f"{group}."):
                axes = (
                    {name: values}
                    if values.ndim == 1
                    else {f"{name}.{axis}": values[:, i] for i, axis in enumerate("xyz")}
                )
                found |= axes
    return found


def _simulated(
    model: mujoco.MjModel, plan: RunPlan, time: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Commands, readings and joint torques at the times (T,), with noise, by their columns."""
    count = len(time)
    sines = np.array(
        [
            np.sin(2 * np.pi * np.outer(time, rng.uniform(0.3, 3, 3)) + rng.uniform(0, 6, 3)).sum(1)
            for _ in range(max(model.nu, model.nv))
        ]
    ).T * (0.0 if plan.still else 0.3)
    data = mujoco.MjData(model)
    most = 4000
    every = max(float(time[-1]) / most, float(model.opt.timestep))
    model.opt.timestep = min(every, 0.004)
    read = np.zeros((count, model.nsensordata))
    torque = np.zeros((count, model.nv))
    for k, now in enumerate(time):
        data.ctrl[: model.nu] = sines[k, : model.nu]
        for _ in range(max(0, round((now - data.time) / model.opt.timestep))):
            if not plan.still:
                mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        diverged = data.time < now - 2 * model.opt.timestep  # the engine began anew
        if diverged or np.abs(data.qvel).max(initial=0) > _FASTEST:
            mujoco.mj_resetData(model, data)
            data.time = now
            mujoco.mj_forward(model, data)
        read[k] = data.sensordata
        torque[k] = data.qfrc_actuator + data.qfrc_applied
    read += 1e-4 * (1 + np.abs(read).max(axis=0)) * rng.normal(size=read.shape)
    torque += 0.1 * sines[:, : model.nv] + 1e-3 * rng.normal(size=torque.shape)
    columns = {f"ctrl.{model.actuator(a).name}": sines[:, a] for a in range(model.nu)}
    for s in range(model.nsensor):
        at, width = int(model.sensor_adr[s]), int(model.sensor_dim[s])
        values = read[:, at : at + width]
        columns[f"sensor.{model.sensor(s).name}"] = values[:, 0] if width == 1 else values
    for j in range(model.njnt):
        if int(model.jnt_type[j]) in (2, 3):
            columns[f"torque.{model.joint(j).name}"] = torque[:, int(model.jnt_dofadr[j])]
    return columns


def _damaged(values: Array, damage: str, rng: np.random.Generator) -> Array:
    values = np.array(values)
    size = float(np.ptp(values)) or 1.0
    some = rng.random(len(values)) < 0.03
    absurd = rng.choice([1e282, -1e30, 1e9, 1e5])
    if damage == "quantised":
        return np.asarray(np.round(values / (size / 8)) * (size / 8))
    if damage == "stuck":
        values[:] = values[0]
    elif damage == "saturated":
        values = np.clip(values, values.min() + size / 4, values.max() - size / 4)
    elif damage == "corrupt":
        values[some] = absurd
    elif damage == "mostly corrupt":
        values[rng.random(len(values)) < 0.7] = absurd
    elif damage == "missing":
        values[some] = np.nan
    elif damage == "noisy":
        values += size * rng.normal(size=values.shape)
    else:
        values *= 180 / np.pi
    return values


def _stamped(time: Array, plan: RunPlan, rng: np.random.Generator) -> Array:
    time, middle = time.copy(), len(time) // 2
    if plan.clock == "uneven":
        time += rng.uniform(-0.4, 0.4, len(time)) / plan.rate
    elif plan.clock == "pause":
        time[middle:] += rng.choice([0.5, 30.0])
    elif plan.clock == "jump":
        time[middle:] += rng.choice([1e5, 1.7e9, 1e15])
    elif plan.clock == "duplicate":
        time[middle] = time[middle - 1]
    elif plan.clock == "backwards":
        time[middle:] -= 2.5 / plan.rate
    return time


COMMANDS = ("gap", "diagnose", "doctor", "inspect", "plan")
"""Commands that are tried."""
_RECORDED = ("gap", "diagnose", "doctor")
_PASSED_OVER = 3


@dataclass(frozen=True, kw_only=True)
class Case:
    """One call of a command."""

    command: str
    arm: ArmFile
    runs: tuple[RunPlan, ...] = ()
    """Recipes of the runs; none for a command that reads a model."""
    kinds: tuple[str, ...] = ()
    """Effects that `loose gap` considers; all where none is named."""

    @property
    def words(self) -> str:
        """Short description."""
        runs = "; ".join(
            f"{r.columns} {r.samples} at {r.rate:g} Hz, {r.clock}, {'+'.join(r.damages) or 'sound'}"
            for r in self.runs
        )
        return f"{self.command}: {self.arm.ending} of {self.arm.joints} joints; {runs}"


def cases(commands: tuple[str, ...] = COMMANDS) -> st.SearchStrategy[Case]:
    """Cases of some commands, equally often."""
    return st.sampled_from(commands).flatmap(_cases_of)


def case_of(number: int, commands: tuple[str, ...] = COMMANDS) -> Case:
    """Case of a number: the same in every run, and unlike its neighbours."""
    drawn: list[Case] = []

    @hypothesis.seed(number)
    @settings(
        max_examples=_PASSED_OVER,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=cases(commands))
    def draw(case: Case) -> None:
        drawn.append(case)

    draw()
    return drawn[-1]


def _cases_of(command: str) -> st.SearchStrategy[Case]:
    if command not in _RECORDED:
        return st.builds(Case, command=st.just(command), arm=arms())
    mixed = st.lists(run_plans(), min_size=1, max_size=3)
    same = run_plans().flatmap(lambda r: st.integers(2, 3).map(lambda n: [r] * n))
    kinds = st.sampled_from([("viscous_friction", "coulomb_friction"), ("backlash",), ("payload",)])
    return st.builds(
        Case,
        command=st.just(command),
        arm=st.one_of(mjcf_arms(), mjcf_arms(), mjcf_arms(), arms()),
        runs=st.one_of(same, same, mixed).map(tuple),
        kinds=kinds if command == "gap" else st.just(()),
    )


def write_case(case: Case, folder: Path) -> list[str]:
    """Write the files of a case as any recorder might, unchecked, and return the command line."""
    folder.mkdir(parents=True, exist_ok=True)
    model_file = folder / f"model.{case.arm.ending}"
    model_file.write_text(case.arm.text, encoding="utf-8")
    out = ["--out", str(folder / "out")]
    if case.command not in _RECORDED:
        return [case.command, str(model_file), *(out if case.command == "plan" else ()), "--quiet"]
    with quiet(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = mujoco.MjModel.from_xml_string(case.arm.text)
        for k, plan in enumerate(case.runs):
            write_csv(folder / f"run-{k}.csv", make_run(model, plan, k))
    runs = [{"file": f"run-{k}.csv"} for k in range(len(case.runs))]
    whole = {"format": "loose-recording/1", "model": model_file.name, "runs": runs}
    folder.joinpath("recording.json").write_text(json.dumps(whole), encoding="utf-8")
    more = [] if case.command == "doctor" else [*out, "--ignore-doctor"]
    if case.command == "gap":
        more += ["--kinds", *case.kinds, "--threads", "1"]
    return [case.command, str(folder), *more, "--quiet"]


OUTCOMES = ("result", "refused", "traceback", "unclear", "late", "died")
"""Outcomes of a case. "unclear" is a refusal of several lines or none."""
MOST_BYTES = 4 * 1024**3
"""Memory that a process may have [byte]; beyond it allocations fail."""


def run_case(case: Case, folder: Path) -> tuple[str, str]:
    """Run a case in this process; return its outcome and what was said."""
    from loose_env.cli.main import main

    words = write_case(case, folder)
    said, shown = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(shown):
            code = main(words)
    except BaseException:
        return "traceback", traceback.format_exc()
    if code == 0 or shown.getvalue().strip():  # findings of the doctor end with 1
        return "result", ""
    head = f"loose {case.command}: "
    lines = [line for line in said.getvalue().splitlines() if line.startswith(head)]
    last = said.getvalue().strip().splitlines()[-1:] or [""]
    clear = len(lines) == 1 and lines == last and len(lines[0]) > len(head)
    return "refused" if clear else "unclear", "\n".join(lines or last)


def tried(case: Case, *, seconds: float) -> Row:
    """Run a case in a forked process with a limit of memory and of time [s]."""
    fork = multiprocessing.get_context("fork")
    reading, writing = fork.Pipe(duplex=False)
    child = fork.Process(target=_child, args=(case, writing))
    child.start()
    writing.close()
    found = ("late", f"no end within {seconds:g} s", seconds, 0.0)
    try:
        if reading.poll(seconds):
            found = reading.recv()
    except EOFError:
        found = ("died", "the process ended without a word", 0.0, 0.0)
    child.kill()
    child.join()
    names = ("command", "case", "outcome", "words", "seconds", "peak_mb")
    return dict(zip(names, (case.command, case.words, *found), strict=True))


def _child(case: Case, writing: Connection) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (3 * MOST_BYTES, 3 * MOST_BYTES))
    with tempfile.TemporaryDirectory() as place:
        outcome, words = run_case(case, Path(place) / "case")
    usage = resource.getrusage(resource.RUSAGE_SELF)
    writing.send((outcome, words, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024))


FINE = OUTCOMES[:2]


def table(rows: Sequence[Row]) -> str:
    """Counts of outcomes by command, as a table in Markdown."""
    head = ["command", "cases", *OUTCOMES, "slowest [s CPU]", "peak memory [MB]"]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for name in dict.fromkeys(row["command"] for row in rows):
        own = [row for row in rows if row["command"] == name]
        counts = Counter(row["outcome"] for row in own)
        cells = [f"`loose {name}`", str(len(own)), *(str(counts[o]) for o in OUTCOMES)]
        cells += [f"{max(r['seconds'] for r in own):.1f}", f"{max(r['peak_mb'] for r in own):.0f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def line_of(row: Row) -> str:
    """A case in a line, with what it said where that is not fine."""
    said = "" if row["outcome"] in FINE else f"\n  {row['words'].strip()[-600:]}"
    return f"{row['outcome']}: {row['case']}{said}"


@dataclass(frozen=True, kw_only=True)
class SuiteSettings:
    """Which cases, and their limits."""

    examples: int = 100
    """Number of cases."""
    first: int = 1
    """Number of the first case."""
    seconds: float = 120.0
    """Limit of one case [s]."""
    commands: tuple[Annotated[str, one_of(COMMANDS)], ...] = COMMANDS
    """Commands that are tried."""
    out: Path = Path("out/robustness")
    """Folder of the rows."""


def row_of(number: int, given: SuiteSettings) -> Row:
    """Row of a case by its number."""
    return tried(case_of(number, given.commands), seconds=given.seconds) | {"number": number}


def run(given: SuiteSettings) -> None:
    """Run the cases and print the table."""
    import loose_env.cli.main  # noqa: F401  loaded once, before processes are forked

    numbers = range(given.first, given.first + given.examples)
    work = partial(row_of, given=given)
    rows = run_cases(numbers, work, given.out / "rows.jsonl", say=line_of)
    print(table(rows))
    if any(r["outcome"] not in FINE or r["peak_mb"] * 1024**2 > MOST_BYTES for r in rows):
        sys.exit(1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    command("robustness", __doc__, SuiteSettings, run, arguments)


if __name__ == "__main__":
    main()
