"""The reduced engine gives the records of MuJoCo's, to within sampling error."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import (
    Mismatch,
    MismatchDraw,
    planar,
    scara,
    servoed,
    six_axis,
    vera,
    with_compliance,
)
from loose_env.diagnosis import statistics_of
from loose_env.envs import DiagnosisSettings, Difficulty, EnvBatch, FaultSampler
from loose_env.errors import InvalidSetting
from loose_env.excitation import at_levels
from loose_env.faults import Healthy, Preload, SeveralFaults, StructuralLooseness, hypotheses
from loose_env.rig import ReducedRig, SimulatedRig
from loose_env.sensors import SensorSuite

ARMS = {
    "planar4": lambda: planar(4),
    "upright": lambda: planar(3, vertical=True),
    "vera": vera,
    "six_axis": six_axis,
    "scara": scara,
    "servo": lambda: servoed(planar(2)),
    "compliant": lambda: with_compliance(planar(3)),
}
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("vera", "six_axis")]


def pair(arm, fault, mismatch, pose, excitation, seed, sensors=None):
    """The same record from both engines."""
    found = []
    for rig in (SimulatedRig(arm, threads=1, sensors=sensors), ReducedRig(arm, sensors=sensors)):
        rig.mount(0, fault, mismatch)
        found.append(rig.measure(pose, excitation, rng=np.random.default_rng(seed)))
    return found


@pytest.mark.parametrize("name", ["planar4", "six_axis"])
def test_accelerometers_on_links_read_the_same(name):
    arm = ARMS[name]()
    rng = np.random.default_rng(1)
    mismatch, pose = Mismatch().draw(arm, rng), arm.random_pose(rng)
    sensors = SensorSuite(link_accelerometers=True)
    excitation = shake(ReducedRig(arm), pose, np.full(arm.n, 3))
    theirs, ours = pair(arm, Healthy(), mismatch, pose, excitation, 7, sensors)
    scale = np.std(theirs.tool)
    assert np.std(ours.links - theirs.links, axis=-1).max() < 0.005 * scale
    assert np.std(ours.encoder - theirs.encoder) < 0.01 * np.std(theirs.encoder)


def shake(rig, pose, levels, duration=0.4):
    wanted = np.array([0.0, *rig.arm.levels])[levels]
    return at_levels(rig.nominal.at(pose), wanted, duration=duration)[0]


@pytest.mark.parametrize("name", ARMS)
def test_a_sound_arm_reads_the_same(name):
    arm = ARMS[name]()
    rng = np.random.default_rng(1)
    mismatch = Mismatch().draw(arm, rng)
    pose = arm.random_pose(rng)
    excitation = shake(ReducedRig(arm), pose, np.full(arm.n, 3))
    theirs, ours = pair(arm, Healthy(), mismatch, pose, excitation, 7)
    off = np.std(ours.tool - theirs.tool, axis=1) / np.std(theirs.tool)
    assert off.max() < 0.005
    assert np.array_equal(ours.command, theirs.command)
    # The encoders differ by what was left out, far below one joint's motion.
    assert np.std(ours.encoder - theirs.encoder) < 0.01 * np.std(theirs.encoder - pose[:, None])


def summary(record):
    on = record.excited
    return np.concatenate(
        [
            record.transmission_by_instrument[:, on].ravel(),
            np.log(record.joint_rms[on]),
            0.5 * np.log(np.diag(record.tool_covariance)),
            np.arcsinh(record.kurtosis),
        ]
    )


@pytest.mark.parametrize("name", ["planar4", *SLOW])
def test_loose_arms_give_the_same_statistics_to_within_sampling_error(name):
    arm = ARMS[name]()
    rig = ReducedRig(arm)
    sampler = FaultSampler(rig.nominal, Difficulty())
    each = []
    play = next(name for name in hypotheses(arm) if name.startswith("backlash"))
    for k, kind in enumerate(("structural_looseness@link2", play)):
        rng = np.random.default_rng(k)
        fault, mismatch = sampler.draw(rng, hypothesis=kind), Mismatch().draw(arm, rng)
        pose = arm.random_pose(rng)
        excitation = shake(rig, pose, np.full(arm.n, 3))
        runs = [pair(arm, fault, mismatch, pose, excitation, seed) for seed in range(6)]
        theirs, ours = (np.array([summary(statistics_of(r[i])) for r in runs]) for i in (0, 1))
        scatter = theirs.std(0, ddof=1)
        each.append((ours - theirs).mean(0) / (scatter * np.sqrt(2 / len(runs))))
    off = np.concatenate(each)
    # Standard normal if the engines differed in their draws alone; here they share them.
    assert np.sqrt(np.mean(off**2)) < 1.2
    assert np.abs(off).max() < 4


def test_a_preloaded_seat_and_a_stuck_one_read_the_same():
    arm = planar(3)
    pose = np.array([0.3, 0.7, -0.5])
    excitation = shake(ReducedRig(arm), pose, np.array([0, 3, 0]))
    stuck = StructuralLooseness(
        link=2, direction=(0, 1, 0), gap=2e-4, stiffness=(1e5, 1e5), friction=1e6
    )
    tight = Preload(link=2, direction=(0, 1, 0), stiffness=2e5, damping=50.0)
    for fault in (stuck, tight):
        theirs, ours = pair(arm, fault, MismatchDraw.none(arm), pose, excitation, 3)
        assert np.std(ours.tool - theirs.tool) < 0.005 * np.std(theirs.tool)


def test_what_it_does_not_know_is_refused_with_words():
    arm = planar(2)
    part = StructuralLooseness(link=1, direction=(1, 0, 0), gap=1e-4, stiffness=(1e4, 1e4))
    other = StructuralLooseness(link=2, direction=(0, 1, 0), gap=1e-4, stiffness=(1e4, 1e4))
    rig = ReducedRig(arm)
    with pytest.raises(InvalidSetting, match="mujoco"):
        rig.mount(0, SeveralFaults(faults=(part, other)))
    rig.measure(np.zeros(2), shake(rig, np.zeros(2), np.array([3, 0])))  # the slot is as it was
    with pytest.raises(InvalidSetting, match="at least one slot"):
        ReducedRig(arm, slots=0)
    with pytest.raises(InvalidSetting, match="engine"):
        DiagnosisSettings(engine="fast")


def test_episodes_hide_the_same_faults_on_either_engine():
    arm = planar(2)
    found = []
    for engine in ("mujoco", "reduced"):
        batch = EnvBatch(arm, DiagnosisSettings(engine=engine), threads=1)
        batch.start(0, seed=5, number=3)
        shaking = batch.actions.encode(levels=np.array([3, 3]), duration=0)
        batch.step([0], [shaking])
        episode = batch.episode(0)
        found.append((episode.fault, episode.pose.tolist(), episode.slots[0]))
    assert found[0][:2] == found[1][:2]
    assert np.abs(found[0][2] - found[1][2]).max() < 0.2


def played(arm, num, threads, episodes):
    """Observations of two steps of some episodes, by the number of each."""
    batch = EnvBatch(arm, DiagnosisSettings(engine="reduced"), num=num, threads=threads)
    found = {}
    for first in range(0, len(episodes), num):
        mine = episodes[first : first + num]
        for slot, number in enumerate(mine):
            batch.start(slot, seed=9, number=number)
        for step in range(2):
            actions = []
            for number in mine:  # every length, every number of joints
                rng = np.random.default_rng([number, step])
                levels = rng.integers(0, 4, arm.n) * (rng.random(arm.n) < 0.6)
                moves = rng.integers(0, len(batch.settings.moves), arm.n)
                duration = int(rng.integers(len(batch.settings.durations)))
                actions.append(batch.actions.encode(moves=moves, levels=levels, duration=duration))
            batch.step(range(len(mine)), actions)
        found |= {number: batch.observe(slot) for slot, number in enumerate(mine)}
    return found


@pytest.mark.parametrize("name", ["planar4", *SLOW])
def test_episodes_are_the_same_bit_for_bit_at_any_batch_size_and_thread_count(name):
    arm = ARMS[name]()
    episodes = list(range(19))
    alone = played(arm, 1, 1, episodes[::4])
    assert all(observation.any() for observation in alone.values())
    for num, threads in ((19, 1), (19, 2), (11, 3)):
        found = played(arm, num, threads, episodes)
        for number, observation in alone.items():
            assert np.array_equal(found[number], observation), (num, threads, number)
