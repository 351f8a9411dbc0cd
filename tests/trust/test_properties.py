"""Whatever arm, fault, action, settings or recording: no crash, no NaN out, no hang."""

from __future__ import annotations

import json
import math
import signal
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from loose_env.arms import arm_from_file, describe_file, planar, scara, vera
from loose_env.envs import DiagnosisEnv, DiagnosisSettings
from loose_env.errors import InvalidData, LooseEnvError
from loose_env.instrument import (
    DiagnoseSettings,
    diagnose,
    read_arm,
)
from loose_env.recording import Run, read_recording, write_recording
from scripts.suites.trust.fuzz import MODEL

pytestmark = pytest.mark.slow

HANGS = 120
"""Processor time after which an example hangs [s]; it takes a second or two."""
few = settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
many = settings(few, max_examples=60)
ARMS = {
    "vera": vera,
    "planar": lambda: planar(2),
    "vertical": lambda: planar(3, vertical=True),
    "scara": scara,
}


@pytest.fixture(autouse=True)
def no_hang() -> Iterator[None]:
    """End a test that hangs, with the place; figures that files do not give are no matter here."""

    def late(*_: object) -> None:
        raise TimeoutError(f"an example took more than {HANGS} s")

    before = signal.signal(signal.SIGPROF, late)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield
    signal.setitimer(signal.ITIMER_PROF, 0)
    signal.signal(signal.SIGPROF, before)


# ---- arms, faults and actions


@st.composite
def chains(draw: st.DrawFn) -> str:
    """An MJCF of a serial chain of any shape, sensible or not."""
    number, positive = st.floats(-2, 2, width=16), st.floats(1e-6, 1e3)
    vector = st.tuples(number, number, number).map(lambda v: " ".join(map(str, v)))
    text, count = "", draw(st.integers(1, 4))
    for k in range(count):
        kind = draw(st.sampled_from(["hinge", "hinge", "slide", "ball"]))
        limits = draw(st.sampled_from(["", 'range="-1 1"', 'range="0.1 0.2"']))
        drives = ["", 'actuatorfrcrange="-9 9"', 'actuatorfrcrange="-1e-3 1e-3"']
        more = f'armature="{draw(positive)}" damping="{draw(st.floats(0, 1e3))}"'
        i = draw(positive)
        text += (
            f'<body pos="{draw(vector)}"><joint name="j{k}" type="{kind}" axis="{draw(vector)}" '
            f"{'' if kind == 'ball' else limits} {draw(st.sampled_from(drives))} {more}/>"
            f'<inertial pos="{draw(vector)}" mass="{draw(positive)}" diaginertia="{i} {i} {i}"/>'
        )
    tool = f'<site name="tool" pos="{draw(vector)}"/>'
    return (
        '<mujoco><compiler angle="radian"/><worldbody>'
        f"{text}{tool}{'</body>' * count}</worldbody></mujoco>"
    )


def play(env: DiagnosisEnv, seed: int, *, steps: int = 3) -> None:
    """Play random actions; everything that comes out is finite and within its space."""
    rng = np.random.default_rng(seed)
    try:
        observation, info = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        for _ in range(steps):
            action = rng.integers(0, env.actions.nvec)
            observation, reward, terminated, truncated, info = env.step(action)
            assert env.observation_space.contains(observation)
            assert np.isfinite(observation).all() and np.isfinite(reward)
            if terminated or truncated:
                assert info["fault"] in (*env.hypotheses, "several_faults")
                observation, info = env.reset()
    finally:
        env.close()


@few
@given(chains(), st.integers(0, 2**31))
def test_any_chain_is_refused_in_words_or_described_and_measured(
    tmp_path: Path, text: str, seed: int
) -> None:
    signal.setitimer(signal.ITIMER_PROF, HANGS)
    file = tmp_path / "arm.xml"
    file.write_text(text)
    try:
        found = describe_file(file)
        assert found.joints and "nan" not in str(found)
        arm = arm_from_file(file)
    except LooseEnvError as error:
        assert "arm" in str(error) and "\n" not in str(error)
        return
    play(DiagnosisEnv(arm, DiagnosisSettings(durations=(0.2,)), threads=1), seed, steps=1)


@few
@given(
    st.sampled_from(sorted(ARMS)),
    st.integers(0, 2**31),
    st.sampled_from(["easy", "default", "hard"]),
    st.sampled_from(["mujoco", "reduced"]),
)
def test_any_fault_and_action_gives_finite_observations(
    name: str, seed: int, difficulty: str, engine: str
) -> None:
    signal.setitimer(signal.ITIMER_PROF, HANGS)
    given = {"difficulty": difficulty, "engine": engine, "max_records": 3, "durations": (0.2,)}
    play(DiagnosisEnv(ARMS[name](), DiagnosisSettings(**given), threads=1), seed)


@pytest.fixture(scope="module")
def env() -> Iterator[DiagnosisEnv]:
    made = DiagnosisEnv(planar(2), DiagnosisSettings(durations=(0.2,)), threads=1)
    yield made
    made.close()


@few
@given(
    st.sampled_from(["healthy", "backlash@joint1", "structural_looseness@link2", "several_faults"]),
    st.floats(0, 50),
    st.floats(0, 3),
    st.integers(0, 2**31),
)
def test_any_hidden_arm_is_measured_or_said_to_diverge(
    env: DiagnosisEnv, fault: str, scale: float, preload: float, seed: int
) -> None:
    signal.setitimer(signal.ITIMER_PROF, HANGS)
    options: dict[str, Any] = {"fault": fault, "mismatch_scale": scale}
    if fault != "healthy":
        options["preload_g"] = preload
    try:
        env.reset(seed=seed, options=options)
    except LooseEnvError as error:
        assert str(error)
        return
    action = np.random.default_rng(seed).integers(0, env.actions.nvec)
    action[-1] = 0
    observation, reward, _, truncated, info = env.step(action)
    assert np.isfinite(observation).all() and np.isfinite(reward)
    assert not truncated or "failure" in info


anything = st.one_of(
    st.none(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.integers(-3, 9), max_size=8),
    st.lists(st.floats(), max_size=8),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
)


@many
@given(anything, st.one_of(anything, st.dictionaries(st.text(max_size=9), anything, max_size=3)))
def test_anything_else_than_an_action_or_options_is_refused(
    env: DiagnosisEnv, action: Any, options: Any
) -> None:
    signal.setitimer(signal.ITIMER_PROF, HANGS)
    try:
        assert np.isfinite(env.reset(seed=2, options=options)[0]).all()
    except LooseEnvError as error:
        assert str(error)
        env.reset(seed=1)
    try:
        row = np.asarray(action)
        inside = row.shape == env.actions.nvec.shape and row.dtype.kind in "iu"
        inside = inside and bool(((row >= 0) & (row < env.actions.nvec)).all())
    except (ValueError, OverflowError):
        inside = False
    if inside:
        assert np.isfinite(env.step(action)[0]).all()
    else:
        with pytest.raises(LooseEnvError):
            env.step(action)


# ---- recordings, texts


@many
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=0, max_size=30),
    st.lists(st.floats(width=64), min_size=30, max_size=30),
    st.sampled_from(["csv", "parquet"]),
    st.booleans(),
)
def test_any_numbers_are_written_and_read_to_the_last_bit_or_refused(
    tmp_path: Path, time: list[float], angle: list[float], file_format: Any, ordered: bool
) -> None:
    signal.setitimer(signal.ITIMER_PROF, HANGS)
    given_time = np.array(sorted(set(time)) if ordered else time, dtype=float)
    count = len(given_time)
    run = Run(name="run", time=given_time, sensors={"angle": np.array(angle[:count])})
    home = tmp_path / "recording"
    try:
        write_recording(home, model_xml=MODEL, runs=[run], file_format=file_format, overwrite=True)
    except InvalidData as error:
        assert f"run.{file_format}" in str(error) and "column" in str(error)
        return
    (found,) = read_recording(home).runs
    np.testing.assert_array_equal(found.time, given_time)
    np.testing.assert_array_equal(found.sensors["angle"], angle[:count])
    assert np.isfinite(found.time).all() and (np.diff(found.time) > 0).all()
    assert np.isnan(found.sensors["angle"]).sum() <= 0.2 * count


# ---- diagnoses


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Arms of the package as files, with actuators and sensors."""
    found = {}
    for name, make in ARMS.items():
        found[name] = path = tmp_path_factory.mktemp(name) / f"{name}.xml"
        path.write_text(make().spec.to_xml(), "utf-8")
        path.write_text(read_arm(path).recording_model.xml, "utf-8")
    return found


def finite(value: Any) -> bool:
    """Whether no number of a tree is other than finite."""
    return "NaN" not in (text := json.dumps(value)) and "Infinity" not in text


records = st.fixed_dictionaries(
    {
        "seed": st.integers(0, 2**31),
        "rate": st.sampled_from([20.0, 123.4, 500.0, 1000.0, 9999.0]),
        "samples": st.integers(10, 600),
        "jitter": st.sampled_from([0.0, 0.0, 1e-3, 0.3]),
        "missing": st.sampled_from([0.0, 0.0, 0.01, 0.19]),
        "pause": st.sampled_from([0.0, 0.0, 0.5, 1e3, 1e7]),
        "loud": st.sampled_from([0.0, 1e-6, 1.0, 30.0, 1e5]),
        "wobble": st.sampled_from([0.0, 1e-5, 1e-3, 1.0]),
        "drives": st.sampled_from(["ctrl", "torque", "none"]),
        "noted": st.booleans(),
        "condition": st.sampled_from(["suspect", "suspect", "suspect", "healthy"]),
        "without": st.sets(st.integers(0, 9), max_size=2),
    }
)


def run_of(model: Path, number: int, how: dict[str, Any]) -> Run:
    """A run of noise: no arm made it, but a recorder could have written it."""
    machine, rng, count = read_arm(model), np.random.default_rng(how["seed"]), how["samples"]
    time = (np.arange(count) + how["jitter"] * rng.uniform(-1, 1, count)) / how["rate"]
    time[count // 2 :] += how["pause"]
    pose = {name: float(q) for name, q in zip(machine.joints, machine.home, strict=True)}

    def noise(size: float, *shape: int) -> np.ndarray:
        values = size * rng.normal(size=(count, *shape))
        values[rng.random(count) < how["missing"]] = np.nan
        return values

    made = machine.recording_model
    sensors = {made.accelerometer: noise(how["loud"], 3)}
    for sensor, q in zip(made.positions, pose.values(), strict=True):
        sensors[sensor] = q + noise(how["wobble"])
    actuators = [d.actuator for d in machine.drives if d is not None]
    return Run(
        name=f"run-{number}.parquet",
        time=np.sort(time),
        sensors={s: v for k, (s, v) in enumerate(sensors.items()) if k not in how["without"]},
        controls={a: noise(how["loud"]) for a in actuators} if how["drives"] == "ctrl" else {},
        torques={j: noise(how["loud"]) for j in pose} if how["drives"] == "torque" else {},
        pose=pose if how["noted"] else None,
        excited=machine.joints[:1] if how["noted"] else (),
        condition=how["condition"],
    )


@few
@given(
    name=st.sampled_from(["planar", "vertical", "scara"]),
    hows=st.lists(records, min_size=1, max_size=2),
    tolerance=st.sampled_from([1e-6, 0.02, 1.0]),
    healthy=st.floats(0.01, 0.99),
)
def test_any_recording_is_refused_or_weighed(
    tmp_path: Path, models: dict[str, Path], name: str, hows: list[Any], tolerance: float,
    healthy: float,
) -> None:  # fmt: skip
    signal.setitimer(signal.ITIMER_PROF, HANGS)
    home, model = tmp_path / "recording", models[name]
    runs = [run_of(model, k, how) for k, how in enumerate(hows)]
    chosen = DiagnoseSettings(
        poses=1, seconds=0.5, inertial_parameters=tolerance, healthy_prior=healthy
    )
    try:
        write_recording(home, model_xml=model, runs=runs, overwrite=True)
        found = diagnose(read_recording(home), chosen)
    except LooseEnvError as error:
        assert str(error) and "\n" not in str(error)
        return
    assert finite(json.loads(found.to_json()))
    for weighed in [found.posterior, *(r.probabilities for r in found.records if r.probabilities)]:
        assert math.isclose(math.fsum(weighed.values()), 1.0, abs_tol=1e-9)
        assert all(0 <= p <= 1 for p in weighed.values())
