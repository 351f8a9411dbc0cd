"""Find out what a corrected model is worth: an arm with a spring in a drive that its model lacks.

The drive of one joint has a spring that the nominal model does not know. The sound arm is recorded,
`loose gap` names what the model lacks and writes the corrected model, and `arm_from_file` reads it.
Then faults are hidden in the true arm and diagnosed with the nominal model, with the corrected one
and with the true one, on the same hidden arms. The mode of the spring goes from above the band of
the excitation to below it.

Who diagnoses needs no training: it shakes every joint in turn in the pose it finds, compares the
records line by line with the whole dynamic model (`direction_by_dynamics`), calls the arm sound
where no seat is seen to move, and says "unsure" where model and seat leave too much unexplained.

Rows are written as they are found; a study that was interrupted goes on where it stopped.

Usage: python scripts/studies/corrected_arm.py [--quick] [--out FOLDER]
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import loose_env
from loose_env.arms import Arm, LinearArm, arm_from_file
from loose_env.cli.main import main as loose
from loose_env.diagnosis import direction_by_dynamics
from loose_env.envs import DiagnosisEnv, DiagnosisSettings
from loose_env.evaluation import Interval, bootstrap_mean, wilson
from loose_env.faults import UNSURE
from loose_env.gap import GapResult, read_result
from loose_env.recording import Recording, Run, write_recording
from loose_env.report import (
    INK,
    MUTED,
    pyplot,
    rounded,
    save_figure,
    stored_rows,
    study_head,
    write_study,
)
from loose_env.typing import Array

Row = dict[str, Any]

ROOT = Path(__file__).resolve().parents[2]

NOMINAL = """<mujoco model="three_axis_arm">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.0005" integrator="RK4" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="column" pos="0 0 0.3">
      <joint name="base" axis="0 0 1" armature="0.5" damping="3" range="-3 3"/>
      <inertial pos="0 0.01 0.06" mass="6" diaginertia="0.04 0.04 0.03"/>
      <body name="upper_arm" pos="0 0.06 0.12">
        <joint name="shoulder" axis="0 1 0" armature="0.5" damping="3" range="-2.2 2.2"/>
        <inertial pos="0.16 0.01 0.01" mass="4" diaginertia="0.008 0.05 0.05"/>
        <body name="forearm" pos="0.35 -0.04 0">
          <joint name="elbow" axis="0 1 0" armature="0.15" damping="1" range="-2.5 2.5"/>
          <inertial pos="0.14 0 0.01" mass="2.5" diaginertia="0.004 0.022 0.022"/>
          <site name="tool" pos="0.32 0.03 0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hold_base" joint="base" kp="2000" kv="80" forcerange="-100 100"/>
    <position name="hold_shoulder" joint="shoulder" kp="3000" kv="100" forcerange="-120 120"/>
    <position name="hold_elbow" joint="elbow" kp="1000" kv="30" forcerange="-50 50"/>
    <motor name="push_base" joint="base" ctrlrange="-60 60"/>
    <motor name="push_shoulder" joint="shoulder" ctrlrange="-60 60"/>
    <motor name="push_elbow" joint="elbow" ctrlrange="-25 25"/>
  </actuator>
  <sensor>
    <jointpos name="encoder_base" joint="base"/>
    <jointpos name="encoder_shoulder" joint="shoulder"/>
    <jointpos name="encoder_elbow" joint="elbow"/>
    <accelerometer name="acceleration" site="tool"/>
  </sensor>
</mujoco>
"""
"""An arm of three joints and 1 m reach under gravity: position servos, torques added to theirs,
encoders on the motors and an accelerometer at the tool. Figures are estimates for its class."""

MODELS = {"nominal": "nominal model", "corrected": "corrected by loose gap", "true": "true model"}
COLOURS = {"nominal": "#d0451b", "corrected": "#0072b2", "true": "#4a8f5c"}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What is studied."""

    joint: str = "shoulder"
    """Joint whose drive has a spring."""
    modes: tuple[float, ...] = (120.0, 60.0, 30.0, 15.0)
    """Mode of the spring with all that the joint carries, the arm stretched out [Hz]."""
    damping_ratio: float = 0.05
    """Damping ratio of that mode [1]."""
    off: float = 0.01
    """Masses, inertias and dampings of the true arm, relative to the nominal one, a deviation."""
    runs: int = 4
    """Runs of the recording; one is held out."""
    run_seconds: float = 1.0
    """Length of each [s]."""
    kinds: tuple[str, ...] = ()
    """Effects that `loose gap` considers; none: all of its catalogue."""
    episodes: int = 40
    """Hidden arms for each mode, the same for all models."""
    level: int = 3
    """Level at which joints are shaken, from 1."""
    duration: float = 0.4
    """Length of a record of the diagnosis [s]."""
    lack_of_fit: float = 1.0
    """Lack of fit from which on the verdict is "unsure" [1]."""
    seed: int = 20_261_121
    """Seed of the true arms' figures, of the recordings and of the hidden arms."""


def quick(settings: Settings) -> Settings:
    """Return a rough look at the same."""
    return dataclasses.replace(
        settings,
        modes=(60.0,),
        run_seconds=1.0,
        kinds=("joint_compliance", "backlash", "rotor_inertia"),
        episodes=12,
    )


# --- the true arm, and its recording


def carried_inertia(joint: str) -> float:
    """What a joint of the nominal arm carries without its rotor, at zero [kg·m²]."""
    model = mujoco.MjModel.from_xml_string(NOMINAL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    dof = int(model.joint(joint).dofadr[0])
    return float(mass[dof, dof] - model.dof_armature[dof])


def spring_of(settings: Settings, mode: float) -> tuple[float, float]:
    """Stiffness [N·m/rad] and damping [N·m·s/rad] of a spring with a mode [Hz]."""
    carried, omega = carried_inertia(settings.joint), 2 * np.pi * mode
    return carried * omega**2, 2 * settings.damping_ratio * carried * omega


def true_xml(settings: Settings, mode: float) -> str:
    """MJCF text of the true arm: a spring behind one drive, and figures a little off."""
    spec = mujoco.MjSpec.from_string(NOMINAL)
    rng = np.random.default_rng([settings.seed, 0])  # the same arm but for its spring

    def factor() -> float:
        return float(1 + settings.off * np.clip(rng.standard_normal(), -2, 2))

    for body in spec.bodies[1:]:
        share = factor()
        body.mass *= share
        body.inertia = np.array(body.inertia) * share * factor()
    for joint in spec.joints:
        joint.damping = np.array(joint.damping) * factor()
    stiffness, damping = spring_of(settings, mode)
    joint = spec.joint(settings.joint)
    joint.parent.add_joint(
        name=f"{settings.joint}_gear",
        type=joint.type,
        axis=list(joint.axis),
        pos=list(joint.pos),
        stiffness=[stiffness, 0, 0],
        damping=[damping, 0, 0],
    )
    spec.compile()
    return spec.to_xml()  # type: ignore[no-any-return]


RATE = 2000
"""Samples a second of a recording."""
_STEP = 1e-4  # of the true arm's simulation [s]
_REST = 1.5  # in which it comes to rest before a run [s]
_PUSHED = (3.0, 200.0)  # band of the torques added to the servos' [Hz]
_PUSH = np.array([8.0, 8.0, 3.0])  # their root mean square [N·m]
_ENCODER = 2 * np.pi / 2**18  # step of an encoder [rad]
_NOISE = 0.03  # of each axis of the accelerometer [m/s²]


def motion(count: int, rng: np.random.Generator) -> Array:
    """Commands of a run (T, 6): slow sways of all servos, and random torques on top [rad, N·m]."""
    time, joints = np.arange(count) / RATE, len(_PUSH)
    rise = np.minimum(2 * time, 1.0)
    commands = np.zeros((count, 2 * joints))
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    band = (frequency > _PUSHED[0]) & (frequency < _PUSHED[1])
    for j in range(joints):
        middle = (0.0, -0.8, 1.2)[j] + 0.5 * rng.standard_normal()
        size, rate, phase = rng.uniform((0.05, 0.2, 0.0), (0.2, 1.5, 6.0), (3, 3)).T
        sway = size * (np.sin(2 * np.pi * rate * time[:, None] + phase) - np.sin(phase))
        commands[:, j] = middle + rise * sway.sum(1)
        noise = np.fft.irfft(band * np.exp(2j * np.pi * rng.random(len(frequency))), count)
        torque = _PUSH[j] * noise / noise.std()
        commands[:, joints + j] = rise * np.clip(torque, -3 * _PUSH[j], 3 * _PUSH[j])
    return commands


def recorded(model: mujoco.MjModel, commands: Array, rng: np.random.Generator) -> Array:
    """What the sensors show at every sample (T, S); the arm rests where the servos hold it."""
    data, joints = mujoco.MjData(model), len(_PUSH)
    for k in range(joints):  # a spring behind a drive stays at zero
        data.qpos[model.jnt_qposadr[model.actuator_trnid[k, 0]]] = commands[0, k]
    data.ctrl[:] = commands[0]
    mujoco.mj_step(model, data, nstep=round(_REST / _STEP))
    data.time = 0.0
    shown = np.zeros((len(commands), model.nsensordata))
    for row, command in zip(shown, commands, strict=True):
        data.ctrl[:] = command
        mujoco.mj_forward(model, data)
        row[:] = data.sensordata
        mujoco.mj_step(model, data, nstep=round(1 / (RATE * _STEP)))
    angles = shown[:, :joints] + _ENCODER * rng.normal(0, 0.5, (len(commands), joints))
    shown[:, :joints] = _ENCODER * np.round(angles / _ENCODER)
    shown[:, joints:] += rng.normal(0, _NOISE, shown[:, joints:].shape)
    return shown


def record(settings: Settings, mode: float, folder: Path) -> Recording:
    """Record the sound true arm; the recording's model is the nominal one."""
    model = mujoco.MjModel.from_xml_string(true_xml(settings, mode))
    model.opt.timestep = _STEP
    count, runs = round(settings.run_seconds * RATE), []
    names = [model.actuator(k).name for k in range(model.nu)]
    sensors = [model.sensor(k).name for k in range(len(_PUSH))]
    for k in range(settings.runs):
        rng = np.random.default_rng([settings.seed, 1, k])  # the same motions for every mode
        commands = motion(count, rng)
        shown = recorded(model, commands, rng)
        runs.append(
            Run(
                name=f"run-{k + 1:02d}.csv",
                time=np.arange(count) / RATE,
                controls=dict(zip(names, commands.T, strict=True)),
                sensors=dict(zip(sensors, shown.T, strict=False))
                | {"acceleration": shown[:, len(_PUSH) :]},
            )
        )
    return write_recording(folder, model_xml=NOMINAL, runs=runs, file_format="csv", overwrite=True)


def close_gap(settings: Settings, recording: Path, folder: Path) -> GapResult:
    """Run `loose gap`; what it had finished before is taken up."""
    words = ["gap", str(recording), "--out", str(folder), "--threads", "1"]
    if settings.kinds:
        words += ["--kinds", *settings.kinds]
    if loose(words) != 0:
        raise SystemExit("loose gap did not end well; its message stands above")
    return read_result(folder)


def gap_row(settings: Settings, mode: float, result: GapResult) -> Row:
    """What `loose gap` found for one mode."""
    return {
        "what": "gap",
        "mode_hz": mode,
        "stiffness": spring_of(settings, mode)[0],
        "verdict": result.verdict,
        "effects": [
            {
                "kind": effect.kind,
                "where": effect.where,
                "parameters": dict(effect.parameters),
                "interval_95": {k: list(v) for k, v in effect.interval_95.items()},
                "ambiguous_with": [f"{p.kind}@{p.where}" for p in effect.ambiguous_with],
            }
            for effect in result.effects
        ],
        "before": result.gap.before,
        "after": result.gap.after,
    }


# --- diagnosis


def arm_of(path: Path, levels: tuple[float, ...] | None = None) -> Arm:
    """Read an arm, with levels in place of those that its own model would suggest."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arm = arm_from_file(path)
    return arm if levels is None else dataclasses.replace(arm, levels=levels)


def diagnose(env: DiagnosisEnv, linear: LinearArm, settings: Settings, seed: int) -> Row:
    """Play one episode: shake every joint in turn, compare with the model, name the fault."""
    env.reset(seed=seed)
    records, earned, lack = [], 0.0, None
    info: dict[str, Any] = {}
    for j in range(env.arm.n):
        levels = np.where(np.arange(env.arm.n) == j, settings.level, 0)
        shake = env.actions.encode(levels=levels, duration=0)
        _, reward, _, truncated, info = env.step(shake)
        earned += reward
        if truncated:
            return _outcome(info, earned, lack)
        if info["measurement"] is not None:  # None where gravity leaves the drive no torque
            records.append(info["measurement"])
    verdict = UNSURE
    if records:
        found = direction_by_dynamics(linear, records)
        lack = found.lack_of_fit
        if lack <= settings.lack_of_fit:
            verdict = found.place if found.evidence > 0 else "healthy"
    name = env.actions.encode(verdict=1 + env.verdicts.index(verdict))
    _, reward, _, _, info = env.step(name)
    return _outcome(info, earned + reward, lack)


def _outcome(info: dict[str, Any], earned: float, lack: float | None) -> Row:
    return {
        "truth": info["fault"],
        "verdict": info["verdict"],
        "success": bool(info["is_success"]),
        "reward": earned,
        "lack_of_fit": lack,
    }


def diagnosis_row(settings: Settings, mode: float | None, model: str, arm: Arm, true: Arm) -> Row:
    """Diagnose all hidden arms of a mode with one model; a list for each column."""
    rules = DiagnosisSettings(engine="reduced", raw=True, durations=(settings.duration,))
    env, linear = DiagnosisEnv(arm, rules, true_arm=true, threads=1), LinearArm(arm)
    played = [
        diagnose(env, linear, settings, settings.seed + 1 + k) for k in range(settings.episodes)
    ]
    columns = {name: [one[name] for one in played] for name in played[0]}
    return {"what": "diagnosis", "mode_hz": mode, "model": model} | columns


# --- tables and figures


def row_of(rows: Sequence[Row], mode: float | None, model: str) -> Row | None:
    """Diagnoses of a mode with one model, if they have been made."""
    for row in rows:
        if row["what"] == "diagnosis" and (row["mode_hz"], row["model"]) == (mode, model):
            return row
    return None


def mean_of(row: Row, column: str, less: Row | None = None) -> Interval:
    """Mean of a column with its 95 % interval; of paired differences if another row is given."""
    values = np.array(row[column], dtype=float)
    if less is not None:
        if row["truth"] != less["truth"]:
            raise ValueError("only diagnoses of the same hidden arms are paired")
        values = values - np.array(less[column], dtype=float)
    return bootstrap_mean(values, rng=np.random.default_rng(0))


def success_of(row: Row) -> Interval:
    """Share of right verdicts with Wilson's 95 % interval."""
    right, of = int(np.sum(row["success"])), len(row["success"])
    low, high = wilson(right, of)
    return Interval(estimate=right / of, low=low, high=high)


def print_tables(rows: Sequence[Row]) -> None:
    """Print what was named, and how the diagnosis went with every model."""
    print("What loose gap named\n")
    print(f"{'mode':>7} {'true stiffness':>14}  {'named':<38} {'stiffness (95 %)':<35} gap")
    for row in (r for r in rows if r["what"] == "gap"):
        named = [f"{e['kind']}@{e['where']}" for e in row["effects"]] or [row["verdict"]]
        figures = [
            "{:.4g} ({:.4g} to {:.4g})".format(
                effect["parameters"]["stiffness"], *effect["interval_95"]["stiffness"]
            )
            for effect in row["effects"]
            if effect["kind"] == "joint_compliance"
        ]
        print(
            f"{row['mode_hz']:>4.0f} Hz {row['stiffness']:>14.4g}  {', '.join(named):<38} "
            f"{', '.join(figures):<35} {row['before']:.1f} to {row['after']:.2f}"
        )
    print("\nDiagnosis of the same hidden arms\n")
    print(
        f"{'mode':>7} {'model':<10} {'right [%] (95 %)':>18} {'unsure':>7} {'return (95 %)':>23} "
        f"{'right over nominal':>22} {'return over nominal':>24}"
    )
    for row in (r for r in rows if r["what"] == "diagnosis"):
        mode = "none" if row["mode_hz"] is None else f"{row['mode_hz']:.0f} Hz"
        right, earned = success_of(row), mean_of(row, "reward")
        unsure = np.mean([v == UNSURE for v in row["verdict"]])
        line = (
            f"{mode:>7} {row['model']:<10} {100 * right.estimate:>6.1f} "
            f"({100 * right.low:>4.1f}-{100 * right.high:>5.1f}) {100 * unsure:>6.1f} "
            f"{earned.estimate:>+7.3f} ({earned.low:+.3f},{earned.high:+.3f})"
        )
        nominal = row_of(rows, row["mode_hz"], "nominal")
        if nominal is not None and nominal is not row:
            r, e = mean_of(row, "success", nominal), mean_of(row, "reward", nominal)
            line += f" {100 * r.estimate:>+7.1f} ({100 * r.low:+.1f},{100 * r.high:+.1f})"
            line += f" {e.estimate:>+8.3f} ({e.low:+.3f},{e.high:+.3f})"
        print(line)


def draw(rows: Sequence[Row], settings: Settings, path: Path) -> None:
    """Draw right verdicts and return against the mode of the spring, a line for each model."""
    plt = pyplot()
    figure, panels = plt.subplots(1, 2, figsize=(8.6, 3.7), sharex=True)
    stiff = row_of(rows, None, "nominal")
    for panel, (column, label) in zip(
        panels, (("success", "right verdicts [%]"), ("reward", "mean return")), strict=True
    ):
        scale = 100.0 if column == "success" else 1.0
        measure = success_of if column == "success" else lambda row: mean_of(row, "reward")
        panel.axvspan(30, 150, color="#eef1f4", lw=0, zorder=0)
        for shift, (model, words) in zip((0.97, 1.0, 1.03), MODELS.items(), strict=True):
            own = [(m, row_of(rows, m, model)) for m in settings.modes]
            found = [(m, measure(row)) for m, row in own if row is not None]
            panel.errorbar(
                [m * shift for m, _ in found],
                [scale * i.estimate for _, i in found],
                yerr=np.array(
                    [
                        [scale * (i.estimate - i.low) for _, i in found],
                        [scale * (i.high - i.estimate) for _, i in found],
                    ]
                ),
                color=COLOURS[model],
                lw=1.8,
                marker="o",
                ms=4,
                elinewidth=1,
                label=words,
            )
        if stiff is not None:
            at = scale * measure(stiff).estimate
            panel.axhline(at, color=MUTED, lw=1, ls=":", label="no spring, nominal model")
        panel.set_xscale("log")
        panel.set_xticks(list(settings.modes), [f"{m:g}" for m in settings.modes])
        panel.minorticks_off()
        panel.invert_xaxis()
        panel.set_xlabel(f"mode of the hidden spring in the {settings.joint} [Hz]")
        panel.set_ylabel(label, color=INK)
    panels[0].set_ylim(0, 102)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="upper left", ncols=4, frameon=False, fontsize=8)
    figure.text(
        0.01,
        0.012,
        "Shaded: band of the excitation. Bars: 95 % intervals.",
        fontsize=8,
        color=MUTED,
    )
    figure.tight_layout(rect=(0, 0.03, 1, 0.93))
    save_figure(plt, figure, path)


# --- the study


class Study:
    """All of it, in rows that are kept as soon as they are there."""

    def __init__(self, settings: Settings, folder: Path, say: Callable[[str], None]) -> None:
        self.settings, self.folder, self.say = settings, folder, say
        folder.mkdir(parents=True, exist_ok=True)
        self.nominal_path = folder / "nominal.xml"
        self.nominal_path.write_text(NOMINAL, encoding="utf-8")
        self.nominal = arm_of(self.nominal_path)

    def true_arm(self, mode: float) -> Arm:
        """The true arm with its spring."""
        path = self.folder / f"true-{mode:g}.xml"
        path.write_text(true_xml(self.settings, mode), encoding="utf-8")
        return arm_of(path, self.nominal.levels)

    def corrected_path(self, mode: float) -> Path:
        """Where `loose gap` writes the corrected model."""
        return self.folder / f"gap-{mode:g}" / "model.xml"

    def gap(self, mode: float) -> Row:
        """Record the sound arm and correct its model."""
        recording = self.folder / f"recording-{mode:g}"
        record(self.settings, mode, recording)
        result = close_gap(self.settings, recording, self.corrected_path(mode).parent)
        return gap_row(self.settings, mode, result)

    def diagnoses(self, mode: float, model: str) -> Row:
        """Diagnose the hidden arms of a mode with one model."""
        true, levels = self.true_arm(mode), self.nominal.levels
        arm = {
            "nominal": lambda: self.nominal,
            "corrected": lambda: arm_of(self.corrected_path(mode), levels),
            "true": lambda: true,
        }[model]()
        return diagnosis_row(self.settings, mode, model, arm, true)

    def run(self, rows: list[Row], keep: Callable[[list[Row]], None]) -> list[Row]:
        """Add what is missing among the rows; ``keep`` is told after each."""

        def add(row: Row, words: str) -> None:
            rows.append(rounded(row))
            keep(rows)
            self.say(words)

        if row_of(rows, None, "nominal") is None:
            arm = self.nominal
            add(diagnosis_row(self.settings, None, "nominal", arm, arm), "no spring: diagnosed")
        for mode in self.settings.modes:
            known = any(r["what"] == "gap" and r["mode_hz"] == mode for r in rows)
            if not (known and self.corrected_path(mode).is_file()):
                found = self.gap(mode)
                rows[:] = [r for r in rows if not (r["what"] == "gap" and r["mode_hz"] == mode)]
                add(found, f"{mode:g} Hz: {found['verdict']}")
            for model in MODELS:
                if row_of(rows, mode, model) is None:
                    add(self.diagnoses(mode, model), f"{mode:g} Hz: diagnosed, {MODELS[model]}")
        return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study, print its tables, draw its figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--modes", nargs="+", type=float, metavar="HZ", help="modes of the spring")
    parser.add_argument("--episodes", type=int, help="hidden arms for each mode")
    parser.add_argument("--seed", type=int, default=Settings.seed)
    parser.add_argument("--quick", action="store_true", help="a rough look, a few minutes")
    parser.add_argument("--afresh", action="store_true", help="forget what an earlier run found")
    parser.add_argument("--show", action="store_true", help="print and draw what is stored")
    parser.add_argument("--out", type=Path, help="folder; default docs/figures, quick: out/")
    chosen = parser.parse_args(arguments)
    settings = quick(Settings()) if chosen.quick else Settings()
    settings = dataclasses.replace(settings, seed=chosen.seed)
    if chosen.modes:
        if min(chosen.modes) <= 0:
            parser.error(f"modes are above 0 Hz, got {chosen.modes}")
        settings = dataclasses.replace(settings, modes=tuple(chosen.modes))
    if chosen.episodes is not None:
        if chosen.episodes < 2:
            parser.error(f"episodes must be 2 or more, got {chosen.episodes}")
        settings = dataclasses.replace(settings, episodes=chosen.episodes)
    folder: Path = chosen.out or ROOT / ("out" if chosen.quick else "docs/figures")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "corrected_arm.json"
    head = study_head("scripts/studies/corrected_arm.py", settings, version=loose_env.__version__)
    rows = [] if chosen.afresh else stored_rows(path, head)
    started = time.perf_counter()

    def say(line: str) -> None:
        print(f"[{time.perf_counter() - started:5.0f} s] {line}", file=sys.stderr, flush=True)

    if not chosen.show:
        work = (ROOT / "out" if chosen.out is None else folder) / "corrected_arm"
        work = work / ("quick" if chosen.quick else "full")
        study = Study(settings, work, say)
        rows = study.run(rows, lambda found: write_study(path, head, found))
    print_tables(rows)
    draw(rows, settings, path.with_suffix(".png"))
    print(f"\nfigure: {path.with_suffix('.png')}\nrows: {path}")


if __name__ == "__main__":
    main()
