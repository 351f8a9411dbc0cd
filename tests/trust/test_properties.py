"""Whatever arm, fault, action, settings or recording: no crash, no NaN out, no hang."""

from __future__ import annotations

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
