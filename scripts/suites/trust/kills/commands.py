"""Commands that are killed, and what has to hold of what they leave."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.cli.main import COMMANDS as LOOSE
from scripts.suites.trust.kills.killing import Command

__all__ = ["commands", "make_recording", "make_shaken_recording"]

STEPS = 96
EPISODES = 24
_ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="RK4"/>
<worldbody><body name="link"><joint name="turn" axis="0 0 1" damping="1" armature="0.1"/>
<inertial pos=".2 0 0" mass="2" diaginertia=".02 .02 .02"/><site name="tool" pos=".4 0 0"/></body>
</worldbody><actuator><motor name="m" joint="turn"/></actuator>
<sensor><jointpos name="angle" joint="turn"/><accelerometer name="acc" site="tool"/></sensor>
</mujoco>"""

_SHAKEN = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="RK4"/>
<worldbody><body name="one"><joint name="turn" axis="0 0 1" armature="0.05" damping="0.5"/>
<inertial pos=".2 0 0" mass="2" diaginertia=".02 .02 .02"/><body name="two" pos=".4 0 0">
<joint name="bend" axis="0 0 1" armature="0.05" damping="0.5"/>
<inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/><site name="tool" pos=".3 0 0"/></body>
</body></worldbody>
<actuator><position name="hold1" joint="turn" kp="200" kv="5" forcerange="-50 50"/>
<position name="hold2" joint="bend" kp="200" kv="5" forcerange="-50 50"/>
<motor name="shake" joint="turn" ctrlrange="-50 50"/></actuator>
<sensor><jointpos name="turn_pos" joint="turn"/><jointpos name="bend_pos" joint="bend"/>
<accelerometer name="acc" site="tool"/></sensor></mujoco>"""


def commands(place: Path) -> dict[str, Command]:
    """Commands by name; what they read is made below a folder."""
    found = {
        "training": Command(name="training", words=_training, problems=_policies, result=_trained),
        "comparison": Command(name="comparison", words=_compare, problems=_rows, result=_table),
    }
    recording = place / "recording"
    if not recording.exists():
        make_recording(recording)
    found["gap"] = Command(
        name="gap", words=_loose("gap", recording), problems=_gap, result=_gap_result
    )
    if "diagnose" in LOOSE:
        measured = place / "measured"
        if not measured.exists():
            make_shaken_recording(measured)
        found["diagnosis"] = Command(
            name="diagnosis",
            words=_loose("diagnose", measured),
            problems=_diagnosis,
            result=_diagnosis_result,
        )
    return found


def _training(out: Path) -> Sequence[str]:
    return (
        *(
            "scripts/agents/train.py",
            "--env",
            "loose_env/Planar-v0",
            "-n",
            str(STEPS),
            "-f",
            str(out),
        ),
        *("--env-kwargs", "n_links:2", "durations:[0.2]", "max_records:4", "threads:1"),
        *("-params", "n_envs:4", "n_steps:4", "batch_size:8", "n_epochs:1"),
        *("policy_kwargs:dict()", "--eval-freq", "32", "--eval-episodes", "3", "--export"),
        str(out / "export"),
    )


def _compare(out: Path) -> Sequence[str]:
    return (
        *(
            "scripts/agents/compare.py",
            "--env",
            "loose_env/Planar-v0",
            "--arguments",
            '{"n_links": 2}',
        ),
        *("--agents", "random", "posterior/random", "--episodes", str(EPISODES), "--shard", "4"),
        *("--threads", "1", "--workers", "1", "--width", "4", "--out", str(out)),
    )


def _loose(name: str, recording: Path) -> Callable[[Path], Sequence[str]]:
    more = ("--kinds", "viscous_friction", "link_mass", "--threads", "1") if name == "gap" else ()

    def words(out: Path) -> Sequence[str]:
        return ("-m", "loose_env.cli.main", name, str(recording), "--out", str(out), *more)

    return words


def make_recording(folder: Path) -> None:
    """A recording of one joint with more friction than its model has."""
    import mujoco

    from loose_env.recording import Run, write_recording

    spec = mujoco.MjSpec.from_string(_ARM)
    spec.joint("turn").damping = np.array([3.0, 0, 0])
    model = spec.compile()
    rng = np.random.default_rng(1)
    time = np.arange(600) * 0.002
    runs = []
    for k in range(3):
        data = mujoco.MjData(model)
        command = 4 * np.sin((3 + 2 * k) * time) * np.minimum(4 * time, 1.0)
        shown = np.zeros((len(time), 4))
        for row, value in zip(shown, command, strict=True):
            data.ctrl[:] = value
            mujoco.mj_step(model, data)
            row[:] = data.sensordata
        shown += rng.normal(0, [2e-5, 0.02, 0.02, 0.02], shown.shape)
        sensors = {"angle": shown[:, 0], "acc": shown[:, 1:]}
        runs.append(Run(name=f"run-{k}.csv", time=time, controls={"m": command}, sensors=sensors))  # type: ignore[arg-type]
    write_recording(folder, model_xml=_ARM, runs=runs, file_format="csv")


def make_shaken_recording(folder: Path) -> None:
    """Two runs of a healthy arm, a joint shaken at random in a pose that servos hold."""
    import mujoco
    from scipy import signal

    from loose_env.recording import Run, write_recording

    model = mujoco.MjModel.from_xml_string(_SHAKEN)
    rng = np.random.default_rng(2)
    step = float(model.opt.timestep)
    time = np.arange(2000) * step
    band = signal.butter(4, [20.0, 100.0], "bandpass", fs=1 / step, output="sos")
    runs = []
    for k, pose in enumerate(({"turn": 0.1, "bend": 0.4}, {"turn": -0.3, "bend": -0.8})):
        data = mujoco.MjData(model)
        held = np.array(list(pose.values()))
        data.qpos[:] = held
        noise = 60.0 * signal.sosfilt(band, rng.normal(size=len(time)))
        shown = np.zeros((len(time), model.nsensordata))
        for row, torque in zip(shown, noise, strict=True):
            data.ctrl[:] = [*held, torque]
            mujoco.mj_step(model, data)
            row[:] = data.sensordata
        shown += rng.normal(0, [1e-6, 1e-6, 0.01, 0.01, 0.01], shown.shape)
        controls = {"hold1": np.full(len(time), held[0]), "hold2": np.full(len(time), held[1])}
        sensors = {"turn_pos": shown[:, 0], "bend_pos": shown[:, 1], "acc": shown[:, 2:]}
        runs.append(
            Run(
                name=f"run-{k}.parquet",
                time=time,  # type: ignore[arg-type]
                controls=controls | {"shake": noise},
                sensors=sensors,
                pose=pose,
                excited=("turn",),
            )
        )
    write_recording(folder, model_xml=_SHAKEN, runs=runs)


def _try(problems: list[str], file: Path, read: Callable[[], object]) -> None:
    if not file.exists():
        return
    try:
        read()
    except Exception as error:  # whatever it is, the file is not whole
        problems.append(f"{file.name}: {type(error).__name__}: {error}")


def _policies(out: Path) -> list[str]:
    from loose_agents.rl.model_files import RUN, read_model
    from safetensors.numpy import load_file

    found: list[str] = []
    for file in out.rglob("*.json"):
        _try(found, file, lambda f=file: json.loads(f.read_text()))  # type: ignore[misc]
    for file in out.rglob("*.safetensors"):
        _try(found, file, lambda f=file: load_file(f))  # type: ignore[misc]
        # Weights never lie anywhere without the words that say what they are.
        if not file.with_name("configuration.json").exists():
            found.append(f"{file}: no configuration beside it")
    # What is being written has a name that begins with a dot until it is whole.
    for file in (f for f in out.rglob("*.zip") if not f.name.startswith(".")):
        _try(found, file, lambda f=file: read_model(f))  # type: ignore[misc]
        if file.name == "checkpoint.zip":
            run = read_model(file).run
            steps = run["state"]["items"] if run else found.append(f"{RUN} is missing")  # type: ignore[func-returns-value]
            evaluated = dict(steps or [])["steps"]
            if sorted(set(evaluated)) != evaluated:
                found.append(f"evaluations at {evaluated}: one is there twice")
    for file in out.rglob("evaluations.npz"):
        _try(found, file, lambda f=file: _evaluations(f))  # type: ignore[misc]
    return found


def _evaluations(file: Path) -> list[int]:
    with np.load(file, allow_pickle=False) as stored:
        steps = stored["timesteps"].tolist()
        if stored["results"].shape != (len(steps), 3) or sorted(set(steps)) != steps:
            raise ValueError(f"evaluations at {steps} of shape {stored['results'].shape}")
        return [int(step) for step in steps]


def _trained(out: Path) -> Any:
    """What does not depend on the faults that a resumed run meets: counts and names of files."""
    from loose_agents.rl.model_files import read_model

    (checkpoint,) = out.rglob("checkpoint.zip")
    run = read_model(checkpoint).run
    assert run is not None
    names = sorted(str(p.relative_to(out)) for p in out.rglob("*") if ".part" not in p.name)
    return run["counters"], _evaluations(next(out.rglob("evaluations.npz"))), names


def _rows(out: Path) -> list[str]:
    from loose_env.evaluation import read_rows

    found: list[str] = []
    for file in out.glob("shards/*/shard-*.json"):
        _try(found, file, lambda f=file: json.loads(f.read_bytes())["rows"])  # type: ignore[misc]
    file = out / "rows.parquet"
    _try(found, file, lambda: read_rows(file))
    if file.exists():
        rows, _ = read_rows(file)
        played = [(row["agent"], row["episode"]) for row in rows]
        if len(played) != 2 * EPISODES or len(set(played)) != len(played):
            found.append(f"rows.parquet: {len(played)} rows, {len(set(played))} of them different")
    return found


def _table(out: Path) -> Any:
    from loose_env.evaluation import read_rows

    return read_rows(out / "rows.parquet")


def _gap(out: Path) -> list[str]:
    import mujoco

    from loose_env.gap import read_result

    found: list[str] = []
    result, page, model = out / "result.json", out / "report.html", out / "model.xml"
    _try(found, result, lambda: read_result(result))
    _try(found, model, lambda: mujoco.MjModel.from_xml_path(str(model)))
    if result.exists() and not model.exists():
        found.append("a result without its model")
    if page.exists() and "</html>" not in page.read_text("utf-8")[-40:]:
        found.append("report.html: cut short")
    return found


def _gap_result(out: Path) -> Any:
    return (out / "result.json").read_text("utf-8"), (out / "model.xml").read_text("utf-8")


def _diagnosis(out: Path) -> list[str]:
    from loose_env.instrument import read_diagnosis

    found: list[str] = []
    result, page = out / "result.json", out / "report.html"
    _try(found, result, lambda: read_diagnosis(result))
    if page.exists() and "</html>" not in page.read_text("utf-8")[-40:]:
        found.append("report.html: cut short")
    return found


def _diagnosis_result(out: Path) -> Any:
    return (out / "result.json").read_text("utf-8")
