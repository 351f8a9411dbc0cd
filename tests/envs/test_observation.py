"""The observation: names, units and bounds, and nothing in it but readings and commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from loose_env.arms import (
    Arm,
    Mismatch,
    MismatchDraw,
    planar,
    vera,
)
from loose_env.diagnosis import RecordStatistics, statistics_of
from loose_env.envs import (
    DiagnosisEnv,
    DiagnosisSettings,
    Difficulty,
)
from loose_env.faults import Fault, Healthy
from loose_env.rig import Measurement, Records, Trials
from loose_env.sensors import LinkAccelerometers, SensorSuite
from loose_env.typing import Array, IndexArray

Make = Callable[..., Any]

NAMES = ["planar", "vera", "six_axis", "scara", "desk"]
NOMINAL = Difficulty(mismatch=Mismatch().scaled(0.0))
"""True arms equal to the nominal one."""


class Playback:
    """A rig that gives out recorded measurements, whatever is mounted and asked."""

    def __init__(self, recorded: Sequence[Measurement]) -> None:
        self.recorded = list(recorded)

    def mount_all(
        self, slots: IndexArray, faults: Sequence[Fault], mismatches: Sequence[MismatchDraw]
    ) -> None:
        pass

    def record(self, asked: Sequence[Trials]) -> Iterator[tuple[int, IndexArray, Records]]:
        for which, trials in enumerate(asked):
            played = [self.recorded.pop(0) for _ in range(len(trials))]
            yield which, np.arange(len(trials)), Records.of(played)


def shaking(env: DiagnosisEnv, rng: np.random.Generator, steps: int) -> list[NDArray[np.int64]]:
    """Short records with at least one joint shaken."""
    actions = []
    for _ in range(steps):
        levels = rng.integers(0, 4, env.arm.n)
        levels[rng.integers(env.arm.n)] = 2
        moves = rng.integers(0, 5, env.arm.n)
        actions.append(env.actions.encode(moves=moves, levels=levels, duration=0))
    return actions


def recorded(make_env: Make, name: str, **options: Any) -> Any:
    """Play three records; return what was measured, what was seen, and the actions."""
    env = make_env(name, raw=True)
    env.reset(seed=3, options=options)
    actions = shaking(env, np.random.default_rng(3), 3)
    steps = [env.step(action) for action in actions]
    return [s[-1]["measurement"] for s in steps], [s[0]["statistics"] for s in steps], actions


@pytest.mark.parametrize("name", NAMES)
def test_every_element_has_a_name_of_its_own_and_a_unit(make_env: Make, name: str) -> None:
    env = make_env(name, max_records=3)
    elements = env.layout.elements
    assert len(elements) == env.layout.size
    assert len({e.name for e in elements}) == len(elements)
    assert all(e.unit for e in elements)


@pytest.mark.parametrize("name", NAMES)
def test_poses_can_be_read_back(make_env: Make, name: str) -> None:
    env = make_env(name, max_records=3)
    arm, layout = env.arm, env.layout
    rng = np.random.default_rng(0)
    poses = []
    for k, action in enumerate(shaking(env, rng, 3)):
        if k == 0:
            observation, _ = env.reset(seed=2)
        else:
            observation = env.step(action)[0]
            poses.append(env.batch.episode(0).pose)
        pose = env.batch.episode(0).pose
        found = layout.pose_of(observation)
        assert arm.within_ranges(found).all()
        np.testing.assert_allclose(found, pose, atol=2e-6)
    read = layout.record_poses_of(observation)
    np.testing.assert_allclose(read[: len(poses)], poses, atol=2e-6)
    assert read.shape == (3, arm.n)
    many = np.stack([observation, observation])
    np.testing.assert_array_equal(layout.record_poses_of(many)[1], read)


def shown(arm: Arm, record: RecordStatistics) -> dict[str, Array]:
    """What the slot of a record should show, by group."""
    rms = np.sqrt(np.diag(record.tool_covariance))
    upper = np.triu_indices(len(rms), 1)
    low, high = np.array([ends or (-1.0, 1.0) for ends in arm.joint_ranges]).T
    place = -1 + 2 * (record.pose - low) / (high - low)
    wide = ~arm.sliding & (high - low > 2 * np.pi)
    u = record.lowest_direction
    return {
        "valid": np.ones(1),
        "sin_pose": np.where(arm.sliding, place, np.sin(record.pose)),
        "cos_pose": np.where(arm.sliding, 0.0, np.cos(record.pose)),
        **({"range_pose": place[wide]} if wide.any() else {}),
        "duration": np.array([record.duration]),
        "transmission": record.transmission.T.ravel(),
        "transmission_by_instrument": record.transmission_by_instrument.T.ravel(),
        "joint_rms": record.joint_rms,
        "inertia": record.inertia,
        "tool_rms": rms,
        "tool_correlation": (record.tool_covariance / np.outer(rms, rms))[upper],
        "lowest_direction": np.outer(u, u)[np.triu_indices(len(rms))],
        "coherence": np.array([record.lowest_coherence]),
        "correlation": np.array([record.maximum_correlation]),
        "skewness": record.skewness,
        "kurtosis": record.kurtosis,
        "lowest_skewness": np.array([record.lowest_skewness]),
        "lowest_kurtosis": np.array([record.lowest_kurtosis]),
    }


@pytest.mark.parametrize("name", NAMES)
def test_a_slot_shows_the_statistics_of_its_record(make_env: Make, name: str) -> None:
    measurements, observations, _ = recorded(make_env, name)
    layout = make_env(name).layout
    for slot, measurement in enumerate(measurements):
        for group, expected in shown(layout.arm, statistics_of(measurement)).items():
            found = layout.physical(observations[-1], group)[slot]
            np.testing.assert_allclose(found, expected, rtol=2e-6, atol=1e-6, err_msg=group)


def test_raw_gives_the_signals_of_the_latest_record(make_env: Make) -> None:
    env = make_env(n_links=2, raw=True)
    observation, _ = env.reset(seed=0)
    assert not any(observation[name].any() for name in ("command", "encoder", "tool"))
    for duration in (1, 0):
        action = env.actions.encode(levels=np.array([2, 1]), duration=duration)
        observation, _, _, _, info = env.step(action)
        assert observation in env.observation_space
        measurement = info["measurement"]
        count = measurement.tool.shape[1]
        angle = 1e3 * (measurement.encoder[:, 1:-1] - measurement.pose[:, None])
        for name, signal in (
            ("command", measurement.command),
            ("encoder", angle),
            ("tool", measurement.tool),
        ):
            np.testing.assert_allclose(observation[name][:, :count], signal, rtol=1e-5, atol=1e-5)
            assert not observation[name][:, count:].any()


@pytest.mark.parametrize(
    ("name", "levels"),
    [("planar", [0, 3, 0, 2]), pytest.param("vera", [3, 3], marks=pytest.mark.slow)],
)
def test_the_nominal_arm_shows_what_is_predicted_of_it(
    make_env: Make, name: str, levels: list[int]
) -> None:
    env = make_env(name, difficulty=NOMINAL)
    env.reset(seed=1, options={"fault": Healthy()})
    action = env.actions.encode(levels=np.array(levels))
    for _ in range(12):
        observation = env.step(action)[0]
    for group in (
        "transmission_by_instrument",
        "joint_rms",
        "inertia",
        "tool_rms",
        "tool_correlation",
        "lowest_direction",
    ):
        measured = env.layout.physical(observation, group)
        nominal = env.layout.physical(observation, f"nominal_{group}")[0]
        error = np.abs(measured.mean(axis=0) - nominal)
        scatter = measured.std(axis=0, ddof=1) / np.sqrt(len(measured))
        assert (error <= 5 * scatter + 1e-2 * np.abs(nominal).max()).all(), group


@pytest.mark.parametrize("name", NAMES)
def test_the_same_readings_make_the_same_observation_whatever_the_truth(
    make_env: Make, name: str
) -> None:
    pose = make_env(name).arm.random_pose(np.random.default_rng(4))
    measurements, observations, actions = recorded(make_env, name, pose=pose)
    for other in ("healthy", "structural_looseness@link1", "backlash@joint2"):
        env = make_env(name, difficulty="hard", rig=Playback(measurements))
        env.reset(seed=99, options={"pose": pose, "fault": other})
        for action, expected in zip(actions, observations, strict=True):
            np.testing.assert_array_equal(env.step(action)[0], expected)


def environment(arm: Arm, links: bool | LinkAccelerometers, **settings: Any) -> DiagnosisEnv:
    suite = SensorSuite(link_accelerometers=links)
    return DiagnosisEnv(arm, settings=DiagnosisSettings(sensors=suite, **settings))


@pytest.mark.parametrize(
    ("choice", "carriers", "axes"),
    [
        (True, 3, 2),
        (LinkAccelerometers(links=(1, 3)), 2, 2),
        (LinkAccelerometers(tangential=True), 3, 1),
    ],
)
def test_the_layout_has_a_transmission_for_each_sensor_axis_and_joint(
    choice: bool | LinkAccelerometers, carriers: int, axes: int
) -> None:
    env = environment(planar(3), choice, raw=True)
    names = [e.name for e in env.batch.observations.slot_elements]
    for group in ("link_transmission_by_instrument", "nominal_link_transmission_by_instrument"):
        assert sum(n.startswith(f"{group}.") for n in names) == carriers * axes * 3
    assert sum(n.startswith("link_rms.") for n in names) == carriers * axes
    space: Any = env.observation_space
    assert space["links"].shape[:2] == (carriers, axes)
    shown, _ = env.reset(seed=1)
    assert space.contains(shown)


def test_a_healthy_record_shows_the_nominal_transmission() -> None:
    env = environment(vera(), LinkAccelerometers(), raw=True)
    env.reset(seed=3, options={"fault": "healthy", "mismatch_scale": 0.0})
    action = env.actions.encode(levels=np.array([3, 3]))
    shown, _, _, _, info = env.step(action)
    layout = env.batch.observations
    found, nominal = (
        layout.physical(shown["statistics"], f"{p}link_transmission_by_instrument")[0]
        for p in ("", "nominal_")
    )
    assert np.abs(nominal).max() > 0.05
    np.testing.assert_allclose(found, nominal, atol=0.15 * np.abs(nominal).max())
    links = info["measurement"].links
    np.testing.assert_allclose(
        shown["links"][..., : links.shape[-1]], links.astype(np.float32), rtol=1e-6
    )
