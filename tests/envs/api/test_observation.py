"""The observation: names, units and bounds, and nothing in it but readings and commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from loose_env.arms import (
    Arm,
    Mismatch,
    MismatchDraw,
    inertance_rate,
    planar,
    scara,
    six_axis,
    vera,
)
from loose_env.diagnosis import RecordStatistics, statistics_of
from loose_env.envs.env import DiagnosisEnv
from loose_env.envs.observation import Element, ObservationLayout
from loose_env.envs.settings import DiagnosisSettings, Difficulty
from loose_env.envs.vector_env import DiagnosisVectorEnv
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults import Fault, Healthy
from loose_env.rig import Job, Measurement, Plant, SimulatedRig
from loose_env.sensors import Accelerometer, Encoder, SensorSuite
from loose_env.typing import Array

NAMES = ["planar", "vera", "six_axis", "scara", "desk"]
NOMINAL = Difficulty(mismatch=Mismatch().scaled(0.0))
"""True arms equal to the nominal one."""


class Playback:
    """A rig that gives out recorded measurements, whatever is mounted and asked."""

    def __init__(self, recorded: Sequence[Measurement]) -> None:
        self.recorded = list(recorded)

    def mount(self, slot: int, fault: Fault, mismatch: MismatchDraw | None = None) -> None:
        pass

    def measure_many(self, jobs: Sequence[Job]) -> list[Measurement]:
        return [self.recorded.pop(0) for _ in jobs]


def shaking(env: DiagnosisEnv, rng: np.random.Generator, steps: int) -> list[NDArray[np.int64]]:
    """Short records with at least one joint shaken."""
    actions = []
    for _ in range(steps):
        levels = rng.integers(0, 4, env.arm.n)
        levels[rng.integers(env.arm.n)] = 2
        moves = rng.integers(0, 5, env.arm.n)
        actions.append(env.actions.encode(moves=moves, levels=levels, duration=0))
    return actions


def recorded(make_env: Callable[..., DiagnosisEnv], name: str, **options: Any) -> Any:
    """Play three records; return what was measured, what was seen, and the actions."""
    env = make_env(name, raw=True)
    env.reset(seed=3, options=options)
    actions = shaking(env, np.random.default_rng(3), 3)
    steps = [env.step(action) for action in actions]
    return [s[-1]["measurement"] for s in steps], [s[0]["statistics"] for s in steps], actions


# ---- the space


@pytest.mark.parametrize("name", NAMES)
def test_the_space_is_a_flat_float32_box_with_finite_bounds(
    make_env: Callable[..., DiagnosisEnv], name: str
) -> None:
    env = make_env(name)
    space = env.observation_space
    assert isinstance(space, spaces.Box)
    assert space.dtype == np.float32
    assert space.shape == (env.layout.size,)
    assert np.isfinite(space.low).all() and np.isfinite(space.high).all()
    assert (space.low < space.high).all()


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("planar", {"n_links": 2, "difficulty": "hard", "vertical": True}),
        ("planar", {"n_links": 4, "hold": "servo"}),
        ("planar", {"n_links": 7, "difficulty": "easy"}),
        ("vera", {}),
        ("six_axis", {"difficulty": "hard"}),
        ("scara", {"sensors": SensorSuite.ideal()}),
        ("desk", {"difficulty": "easy"}),
    ],
)
def test_whatever_is_done_the_observation_stays_in_its_space(
    make_vector: Callable[..., DiagnosisVectorEnv], name: str, arguments: dict[str, Any]
) -> None:
    env = make_vector(name, num_envs=8, **arguments)
    observation, _ = env.reset(seed=11)
    assert observation in env.observation_space
    rng = np.random.default_rng(0)
    for _ in range(20):
        actions = rng.integers(0, env.actions.nvec, (8, len(env.actions.nvec)))
        actions[:, -2] = 0
        actions[rng.random(8) < 0.8, -1] = 0
        observation, _, _, _, infos = env.step(actions)
        assert observation in env.observation_space
        for final in infos.get("final_obs", []):
            assert final is None or final in env.single_observation_space


@pytest.mark.parametrize("name", NAMES)
def test_every_element_has_a_name_of_its_own_and_a_unit(
    make_env: Callable[..., DiagnosisEnv], name: str
) -> None:
    env = make_env(name, max_records=3)
    elements = env.layout.elements
    assert len(elements) == env.layout.size
    assert len({e.name for e in elements}) == len(elements)
    assert all(e.unit for e in elements)
    assert list(env.layout) == list(elements)


def test_the_table_shows_every_element_of_a_slot_once(
    make_env: Callable[..., DiagnosisEnv],
) -> None:
    layout = make_env("vera").layout
    shown = [line.split()[0] for line in layout.table().splitlines()[1:]]
    own = [e.name for e in layout.global_elements]
    assert shown == own + [f"record<k>.{e.name}" for e in layout.slot_elements]


# ---- scaling


LAYOUTS = {
    arm.name: ObservationLayout(arm, DiagnosisSettings(max_records=2))
    for arm in (planar(3), vera(), six_axis(), scara())
}


def unscaled(element: Element, scaled: float) -> float:
    """Undo the scaling as the element documents it."""
    if element.scaling == "asinh":
        return float(np.sinh(scaled) * element.scale)
    if element.scaling == "log10":
        return float(10**scaled * element.scale) if scaled > element.low else 0.0
    return scaled * element.scale


def groups(elements: Sequence[Element]) -> dict[str, list[int]]:
    """Places of the elements that share all but the last part of their name."""
    found: dict[str, list[int]] = {}
    for k, element in enumerate(elements):
        found.setdefault(element.name.rpartition(".")[0] or element.name, []).append(k)
    return found


@given(name=st.sampled_from(sorted(LAYOUTS)), seed=st.integers(0, 2**32 - 1))
def test_physical_inverts_the_scaling_of_every_element(name: str, seed: int) -> None:
    layout = LAYOUTS[name]
    space, rng = layout.space, np.random.default_rng(seed)
    scaled = rng.uniform(space.low, space.high).astype(np.float32)
    at_the_bottom = rng.random(len(scaled)) < 0.1
    scaled[at_the_bottom] = space.low[at_the_bottom]
    layout.slots_of(scaled)[:, 0] = 1.0  # every slot holds a record
    start = len(layout.global_elements)
    for group, places in groups(layout.global_elements).items():
        expected = [unscaled(layout.global_elements[k], float(scaled[k])) for k in places]
        np.testing.assert_allclose(layout.physical(scaled, group), expected, rtol=1e-12)
    for group, places in groups(layout.slot_elements).items():
        found = layout.physical(scaled, group)
        for slot, row in enumerate(scaled[start:].reshape(2, -1)):
            expected = [unscaled(layout.slot_elements[k], float(row[k])) for k in places]
            np.testing.assert_allclose(found[slot], expected, rtol=1e-12)


def test_physical_takes_many_observations_at_once() -> None:
    layout = LAYOUTS["vera"]
    many = np.stack([layout.space.low, layout.space.high, np.zeros(layout.size, np.float32)])
    for name in ("now.cos_pose", "spent", "transmission", "lowest_kurtosis"):
        each = [layout.physical(row, name) for row in many]
        np.testing.assert_array_equal(layout.physical(many, name), each)
    assert layout.physical(many, "transmission").shape == (3, 2, 4)


def test_a_group_that_does_not_exist_is_refused() -> None:
    layout = LAYOUTS["vera"]
    with pytest.raises(UnknownName, match=r"no group 'speed'.*'now.sin_pose'.*'transmission'"):
        layout.physical(np.zeros(layout.size, np.float32), "speed")


# ---- poses


@pytest.mark.parametrize("name", NAMES)
def test_poses_can_be_read_back(make_env: Callable[..., DiagnosisEnv], name: str) -> None:
    env = make_env(name, max_records=3)
    arm, layout = env.arm, env.layout
    whole = np.array([r is not None and r[1] - r[0] > 2 * np.pi for r in arm.joint_ranges])
    rng = np.random.default_rng(0)
    poses = []
    for k, action in enumerate(shaking(env, rng, 3)):
        if k == 0:
            observation, _ = env.reset(seed=2)
        else:
            observation = env.step(action)[0]
            poses.append(env.batch.episode(0).pose)  # type: ignore[union-attr]
        pose = env.batch.episode(0).pose  # type: ignore[union-attr]
        found = layout.pose_of(observation)
        assert arm.within_ranges(found).all()
        turns = np.where(whole, 2 * np.pi, np.inf)
        off = np.abs(found - pose)
        # A joint that turns more than once round is known up to whole turns.
        np.testing.assert_allclose(np.minimum(off, np.abs(off - turns)), 0.0, atol=2e-6)
    read = layout.record_poses_of(observation)
    assert read.shape == (3, arm.n)
    for slot, pose in enumerate(poses):
        off = np.abs(read[slot] - pose)
        np.testing.assert_allclose(np.minimum(off, np.abs(off - turns)), 0.0, atol=2e-6)
    many = np.stack([observation, observation])
    np.testing.assert_array_equal(layout.record_poses_of(many)[1], read)


def test_a_hinge_is_read_within_a_range_that_lies_to_one_side() -> None:
    layout = LAYOUTS["six_axis"]
    assert layout.arm.joint_ranges[1] == pytest.approx(np.radians([-225, 45]))
    for angle in (-224.0, -181.0, -90.0, 0.0, 44.0):
        pose = np.radians([0.0, angle, 0.0, 0.0, 0.0, 0.0])
        head = layout.globals_of(pose, 0, 0.0, 0)
        observation = np.concatenate([head, np.zeros(layout.size - len(head), np.float32)])
        assert np.degrees(layout.pose_of(observation)[1]) == pytest.approx(angle, abs=1e-4)


def test_a_slide_shows_where_it_stands_in_its_range() -> None:
    layout = LAYOUTS["scara"]
    for place, expected in ((-0.21, -1.0), (-0.105, 0.0), (0.0, 1.0)):
        head = layout.globals_of(np.array([0.0, 0.0, place, 0.0]), 0, 0.0, 0)
        assert head[2] == pytest.approx(expected, abs=1e-6)
        assert head[4 + 2] == 0.0
    names = [e.name for e in layout.global_elements]
    assert names[2] == "now.sin_pose.joint3_position"
    units = {e.name: e.unit for e in layout.slot_elements}
    assert units["transmission.joint3_z"] == "1"
    assert units["transmission.joint1_z"] == "m"
    assert (units["joint_rms.joint3"], units["joint_rms.joint4"]) == ("m/s²", "rad/s²")
    assert (units["inertia.joint3"], units["inertia.joint4"]) == ("kg", "kg·m²")


def test_a_slide_without_limits_is_refused() -> None:
    arm = scara()
    endless = replace(arm, joint_ranges=(*arm.joint_ranges[:2], None, arm.joint_ranges[3]))
    with pytest.raises(InvalidSetting, match=r"joint3.*slides.*\(low, high\)"):
        DiagnosisEnv(endless)


# ---- what a record leaves


def shown(arm: Arm, record: RecordStatistics) -> dict[str, Array]:
    """What the slot of a record should show, by group."""
    rms = np.sqrt(np.diag(record.tool_covariance))
    upper = np.triu_indices(len(rms), 1)
    first, second = np.sin(record.pose), np.cos(record.pose)
    for j in np.flatnonzero(arm.sliding):
        low, high = arm.joint_ranges[j]  # type: ignore[misc]
        first[j], second[j] = -1 + 2 * (record.pose[j] - low) / (high - low), 0.0
    u = record.lowest_direction
    return {
        "valid": np.ones(1),
        "sin_pose": first,
        "cos_pose": second,
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
def test_a_slot_shows_the_statistics_of_its_record(
    make_env: Callable[..., DiagnosisEnv], name: str
) -> None:
    measurements, observations, _ = recorded(make_env, name)
    layout = make_env(name).layout
    for slot, measurement in enumerate(measurements):
        for group, expected in shown(layout.arm, statistics_of(measurement)).items():
            found = layout.physical(observations[-1], group)[slot]
            np.testing.assert_allclose(found, expected, rtol=2e-6, atol=1e-6, err_msg=group)


def test_records_fill_the_slots_in_order_and_stay(make_env: Callable[..., DiagnosisEnv]) -> None:
    env = make_env(n_links=3, max_records=5)
    observation, _ = env.reset(seed=0)
    slots = env.layout.slots_of(observation)
    assert not slots.any()
    for k, action in enumerate(shaking(env, np.random.default_rng(0), 5)):
        after = env.layout.slots_of(env.step(action)[0])
        np.testing.assert_array_equal(np.delete(after, k, axis=0), np.delete(slots, k, axis=0))
        assert after[k, 0] == 1.0
        slots = after


@pytest.mark.parametrize("name", NAMES)
def test_a_reset_shows_the_pose_and_no_record(
    make_env: Callable[..., DiagnosisEnv], spy_on: Callable[..., Any], name: str
) -> None:
    env = make_env(name)
    spy = spy_on(env)
    poses = []
    for seed in range(5):
        observation, _ = env.reset(seed=seed)
        assert not env.layout.slots_of(observation).any()
        assert env.layout.physical(observation, "left") == 1.0
        assert not env.layout.physical(observation, "spent").any()
        poses.append(env.layout.physical(observation, "now.sin_pose"))
    assert spy.calls == 0
    assert len(np.unique(poses, axis=0)) == 5


def test_what_has_been_spent_adds_up(make_env: Callable[..., DiagnosisEnv]) -> None:
    env = make_env(n_links=2, max_records=4)
    env.reset(seed=0)
    spent = np.zeros(3)
    # all joints off is the last joint at its top level: every record is excited
    for levels, duration, excited in (([3, 0], 0, 3), ([0, 0], 2, 3), ([2, 1], 1, 3)):
        action = env.actions.encode(levels=np.array(levels), duration=duration)
        observation = env.step(action)[0]
        spent += [0.25, (0.2, 0.4, 1.2)[duration], excited]
        np.testing.assert_allclose(env.layout.physical(observation, "spent"), spent, rtol=1e-6)
        left = env.layout.physical(observation, "left")[0]
        assert left == pytest.approx(1 - spent[0])


def test_raw_gives_the_signals_of_the_latest_record(make_env: Callable[..., DiagnosisEnv]) -> None:
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


@pytest.mark.parametrize("name", NAMES)
def test_raw_adds_signals_and_changes_no_statistics(
    make_env: Callable[..., DiagnosisEnv], name: str
) -> None:
    _, observations, actions = recorded(make_env, name)
    plain = make_env(name)
    plain.reset(seed=3)
    for action, expected in zip(actions, observations, strict=True):
        np.testing.assert_array_equal(plain.step(action)[0], expected)


# ---- the nominal prediction


def rigid_arm(arm: Arm, pose: Array) -> tuple[Array, Array]:
    """Inertia matrix (n, n) and tool Jacobian (2, n), tool frame, of a planar arm.

    From lengths and masses alone: 0.30 m, 4 kg and 0.75 of it from link to link, 5 % of it in
    the flange, centre of mass at 0.55.
    """
    n, length, centre = arm.n, 0.30, 0.55
    heading = np.cumsum(pose)
    along = np.stack([np.cos(heading), np.sin(heading)])
    across = np.stack([-np.sin(heading), np.cos(heading)])

    def jacobian(link: int, share: float) -> Array:
        """Of the point at a share of a link's length."""
        lengths = np.where(np.arange(n) < link, length, 0.0)
        lengths[link] = share * length
        # Turning joint j carries all that lies beyond it about it.
        return np.stack([across[:, j:] @ lengths[j:] for j in range(n)], axis=1)

    masses = 4.0 * 0.75 ** np.arange(n)
    inertia = np.zeros((n, n))
    for link, whole in enumerate(masses):
        turning = (np.arange(n) <= link).astype(float)
        for mass, share, own in (
            (0.05 * whole, 0.0, 0.05 * whole * 0.04**2 / 2),
            (0.95 * whole, centre, 0.95 * whole * length**2 / 12),
        ):
            j = jacobian(link, share)
            inertia += mass * j.T @ j + own * np.outer(turning, turning)
        beyond = length**2 * (1 / 12 + (np.arange(n - link) + centre) ** 2)
        inertia[link, link] += 0.5 * masses[link:] @ beyond  # the rotor
    return inertia, np.stack([along[:, -1], across[:, -1]]) @ jacobian(n - 1, 1.0)


@pytest.mark.parametrize("hold", ["brake", "servo"])
@pytest.mark.parametrize("levels", [(2, 0, 0), (0, 3, 0), (0, 1, 2), (3, 2, 1)])
def test_the_nominal_prediction_is_that_of_the_rigid_arm_on_its_springs(
    make_env: Callable[..., DiagnosisEnv], hold: str, levels: tuple[int, ...]
) -> None:
    pose = np.array([0.3, -0.8, 1.1])
    env = make_env(n_links=3, hold=hold, sensors=SensorSuite.ideal())
    env.reset(seed=0, options={"pose": pose})
    observation = env.step(env.actions.encode(levels=np.array(levels), duration=0))[0]

    arm, on = env.arm, np.flatnonzero(levels)
    held = np.array(levels) == 0
    torque = env.layout.physical(observation, "torque")[0][on] * np.array(arm.torque_limits)[on]
    inertia, jacobian = rigid_arm(arm, pose)
    hold_k, hold_c = (np.array(v) * held for v in (arm.holding.stiffness, arm.holding.damping))
    stiffness = arm.centring.stiffness + hold_k
    damping = arm.centring.damping + hold_c + 0.3 * 0.75 ** np.arange(3)
    inertia = inertia + np.diag(hold_k / inertance_rate(arm.timestep) ** 2)
    frequencies = np.linspace(30.0, 150.0, 241)
    joint, tool = [], []
    for omega in 2 * np.pi * frequencies:
        impedance = np.diag(stiffness + 1j * omega * damping) - omega**2 * inertia
        answer = -(omega**2) * np.linalg.inv(impedance)[:, on] * torque
        joint.append(answer[on])
        tool.append(jacobian @ answer)

    def covariance(a: Any, b: Any) -> Array:
        return np.einsum("kim,kjm->ij", np.array(a), np.conj(b)).real / len(frequencies)

    transmission = np.zeros((3, 2))
    transmission[on] = np.linalg.solve(covariance(joint, joint), covariance(joint, tool))
    cov = covariance(tool, tool)
    rms = np.sqrt(np.diag(cov))
    joint_rms = np.zeros(3)
    joint_rms[on] = np.sqrt(np.diag(covariance(joint, joint)))
    for group, expected in {
        "nominal_transmission": transmission.ravel(),
        "nominal_joint_rms": joint_rms,
        "nominal_tool_rms": rms,
        "nominal_tool_correlation": cov[0, 1:] / rms.prod(),
    }.items():
        found = env.layout.physical(observation, group)[0]
        np.testing.assert_allclose(
            found, expected, rtol=5e-3, atol=5e-3 * np.abs(expected).max(), err_msg=group
        )


@pytest.mark.parametrize(("name", "levels"), [("planar", [0, 3, 0, 2]), ("vera", [3, 3])])
def test_the_nominal_arm_shows_what_is_predicted_of_it(
    make_env: Callable[..., DiagnosisEnv], name: str, levels: list[int]
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


# ---- nothing but readings and commands


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("other", ["healthy", "structural_looseness@link1", "backlash@joint2"])
def test_the_same_readings_make_the_same_observation_whatever_the_truth(
    make_env: Callable[..., DiagnosisEnv], name: str, other: str
) -> None:
    pose = make_env(name).arm.random_pose(np.random.default_rng(4))
    measurements, observations, actions = recorded(make_env, name, pose=pose)
    env = make_env(name, difficulty="hard", rig=Playback(measurements))
    env.reset(seed=99, options={"pose": pose, "fault": other})
    for action, expected in zip(actions, observations, strict=True):
        np.testing.assert_array_equal(env.step(action)[0], expected)


class Garbage:
    """Knows nothing: whoever looks at it fails."""

    def __getattribute__(self, name: str) -> Any:
        raise AssertionError(f"somebody looked at {name}")


def test_nobody_looks_at_the_truth_while_the_episode_runs(
    make_env: Callable[..., DiagnosisEnv],
) -> None:
    _, observations, actions = recorded(make_env, "planar")
    env = make_env("planar")
    env.reset(seed=3)
    env.batch.episode(0).fault = Garbage()  # type: ignore[union-attr, assignment]
    for action, expected in zip(actions, observations, strict=True):
        np.testing.assert_array_equal(env.step(action)[0], expected)


def test_a_step_simulates_the_arm_once_and_its_nominal_model_never(
    make_env: Callable[..., DiagnosisEnv],
    spy_on: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    measurements, observations, actions = recorded(make_env, "planar")
    env = make_env("planar")
    spy = spy_on(env)
    env.reset(seed=3)
    for k, action in enumerate(actions, start=1):
        env.step(action)
        assert (spy.calls, len(spy.jobs)) == (k, k)

    env = make_env("planar", rig=Playback(measurements))
    env.reset(seed=3)

    def simulate(*_: Any, **__: Any) -> None:
        raise AssertionError("something was simulated")

    for name in ("mj_step", "mj_step1", "mj_step2"):
        monkeypatch.setattr(mujoco, name, simulate)
    for name in ("rollout", "step"):
        monkeypatch.setattr(mujoco.batch.Batch, name, simulate)
    for action, expected in zip(actions, observations, strict=True):
        np.testing.assert_array_equal(env.step(action)[0], expected)


# ---- no seat shows


@pytest.mark.parametrize("arm", [planar(3), vera()], ids=lambda arm: arm.name)
def test_all_arms_share_one_model_layout(arm: Arm) -> None:
    shop = SimulatedRig(arm).shop
    places = [(link, kind) for link in range(1, arm.n + 1) for kind in ("slide", "hinge")]
    first, *others = [shop.template(link, kind) for link, kind in places]
    sizes = [x for x in dir(first) if x.startswith("n") and isinstance(getattr(first, x), int)]
    assert {"nq", "nv", "nu", "neq", "ntendon", "nsensordata"} <= set(sizes)
    for other in others:
        for size in sizes:
            assert getattr(other, size) == getattr(first, size), size
        for where in ("sensor_adr", "sensor_type", "jnt_qposadr", "jnt_dofadr", "eq_type"):
            np.testing.assert_array_equal(getattr(other, where), getattr(first, where))


@pytest.mark.parametrize("arm", [planar(3), vera()], ids=lambda arm: arm.name)
def test_a_healthy_arm_is_seen_the_same_whichever_seat_it_has(arm: Arm) -> None:
    seen = []
    # A shut seat gives by a millionth; where a reading lies between two steps it would flip.
    sensors = SensorSuite(
        accelerometer=Accelerometer(resolution=0.0), encoder=Encoder(resolution=0.0)
    )
    settings = DiagnosisSettings(max_records=2, sensors=sensors)
    for link in range(1, arm.n + 1):
        for kind in ("slide", "hinge"):
            env = DiagnosisEnv(arm, settings, threads=1)
            env.reset(seed=5, options={"fault": Healthy(), "pose": np.full(arm.n, 0.7)})
            rig = env.batch.rig
            assert isinstance(rig, SimulatedRig)
            template = rig.shop.template(link, kind)
            rig.plants[0] = Plant(template, arm, Healthy(), rig.plants[0].mismatch)
            for _ in range(2):
                observation = env.step(env.actions.encode(levels=np.full(arm.n, 3), duration=0))[0]
            seen.append(observation)
    for other in seen[1:]:
        np.testing.assert_allclose(other, seen[0], rtol=0, atol=3e-4)
