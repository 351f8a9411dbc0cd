"""Hidden faults: difficulties, kinds, and how both are drawn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from scipy import stats

from loose_env.arms import (
    FASTEST_TURN,
    Arm,
    LinearArm,
    arm_from_file,
    planar,
    scara,
    six_axis,
    vera,
)
from loose_env.envs import (
    DIFFICULTIES,
    DiagnosisEnv,
    DiagnosisSettings,
    Difficulty,
    FaultSampler,
)
from loose_env.excitation import SeatDrive, at_levels
from loose_env.faults import KINDS, Backlash, StructuralLooseness, hypotheses, parts_of
from loose_env.rig import PlantShop

UR5E = Path(__file__).parents[3] / "shared" / "models" / "ur5e_bare.xml"
PLANE = ("planar3", "planar4v", "vera")
MANY: dict[str, Callable[[], Arm]] = {
    "vera": vera,
    "planar3": lambda: planar(3),
    "six_axis": six_axis,
    "scara": scara,
    "scara-compliant": lambda: scara(hold="compliant"),
}
if UR5E.exists():
    MANY["ur5e"] = lambda: arm_from_file(UR5E)
GANTRY = """<mujoco><compiler autolimits="true"/><worldbody>
  <body name="x"><joint name="x" type="slide" axis="1 0 0" range="0 1"/>
    <geom type="box" size=".5 .05 .05" mass="30"/>
    <body name="y"><joint name="y" type="slide" axis="0 1 0" ref=".4" range="0 1"/>
      <geom type="box" size=".1 .1 .1" mass="10"/>
      <body name="z"><joint name="z" type="slide" axis="0 0 1" range="-.5 0"/>
        <geom type="box" size=".03 .03 .3" mass="4"/><site name="tool" pos="0 0 -.3"/>
  </body></body></body></worldbody>
  <actuator><motor joint="x" gear="-100" ctrlrange="-5 5"/>
    <motor joint="y" gear="100" ctrlrange="-3 3"/></actuator></mujoco>"""
HEAVY = """<mujoco><worldbody>
  <body name="a"><joint name="a" axis="0 0 1" armature="50" damping="100"/>
    <geom type="box" size=".4 .4 .4" mass="250"/>
    <body name="b" pos=".3 0 .4"><joint name="b" axis="0 1 0" range="-120 60" armature="50"/>
      <geom type="capsule" fromto="0 0 0 0 0 1.2" size=".15" mass="150"/>
      <body name="c" pos="0 0 1.2"><joint name="c" axis="0 1 0" range="-150 100" armature="30"/>
        <geom type="capsule" fromto="0 0 0 1.5 0 0" size=".1" mass="90"/>
        <body name="d" pos="1.5 0 0"><joint name="d" axis="1 0 0" armature="2"/>
          <geom type="box" size=".1 .1 .1" mass="10"/><site name="tool" pos=".2 .1 0"/>
  </body></body></body></body></worldbody></mujoco>"""
SMALL = """<mujoco><worldbody><body><joint axis="0 0 1" range="-150 150"/>
  <geom type="capsule" fromto="0 0 0 .05 0 0" size=".004"/>
  <body pos=".04 0 0"><joint axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .03 0 0" size=".003"/>
    <body pos=".04 0 0"><joint axis="1 0 0"/>
      <geom type="capsule" fromto="0 0 0 .02 0 0" size=".002"/><site name="tip" pos=".02 .005 0"/>
  </body></body></body></worldbody></mujoco>"""
SOME = [
    pytest.param(name, marks=pytest.mark.slow) if name in ("ur5e", "scara-compliant") else name
    for name in MANY
]
"""Arms in every run, the others before a release."""
FILES = {"gantry": GANTRY, "heavy": HEAVY, "small": SMALL}


FRICTION = {
    "easy": (0.02, 0.2),
    "default": (0.02, 1.0),
    "hard": (0.1, 2.0),
    "reachable": (0.1, 0.7),
}
GAP = {"easy": (0.1e-3, 0.4e-3), "default": (0.02e-3, 0.4e-3), "hard": (0.02e-3, 0.4e-3)}
GAP["reachable"] = GAP["hard"]


@cache
def arm_of(name: str) -> Arm:
    if name in FILES:
        with TemporaryDirectory() as folder:
            path = Path(folder, f"{name}.xml")
            path.write_text(FILES[name])
            return arm_from_file(path)
    return planar(4, vertical=True) if name == "planar4v" else MANY[name]()


@cache
def linear(name: str) -> LinearArm:
    return LinearArm(arm_of(name))


@cache
def sampler_of(name: str, difficulty: str = "default") -> FaultSampler:
    return FaultSampler(linear(name), DIFFICULTIES[difficulty], KINDS)


@cache
def sampler(name: str, difficulty: str) -> FaultSampler:
    return FaultSampler(linear(name), DIFFICULTIES[difficulty])


@cache
def figures(arm: str, difficulty: str) -> tuple[list[float], list[float]]:
    """Friction ratios and travels [m] of many draws."""
    over = DIFFICULTIES[difficulty].friction_over
    drive, reach = SeatDrive(linear(arm), over=over), arm_of(arm).reach
    rng = np.random.default_rng(0)
    frictions, travels = [], []
    for _ in range(600):
        fault = sampler(arm, difficulty).draw(rng)
        if isinstance(fault, StructuralLooseness):
            frictions.append(fault.friction / drive.slide(fault.link, fault.direction))
            travels.append(fault.gap)
        elif isinstance(fault, Backlash):
            frictions.append(fault.friction / drive.hinges[fault.joint - 1])
            travels.append(fault.gap * reach)
    return frictions, travels


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
@pytest.mark.parametrize("arm", PLANE)
def test_friction_and_gap_lie_in_the_range_and_spread_evenly_over_it(
    arm: str, difficulty: str
) -> None:
    for values, (low, high) in zip(
        figures(arm, difficulty), (FRICTION[difficulty], GAP[difficulty]), strict=True
    ):
        assert low * (1 - 1e-9) <= min(values) and max(values) <= high * (1 + 1e-9)
        share = np.log(np.array(values) / low) / np.log(high / low)
        assert stats.kstest(share, "uniform").pvalue > 0.001


def test_a_ratio_of_one_is_the_force_that_the_top_level_drives_through_the_seat() -> None:
    # In the plane, shaken joint by joint at the top level, over random poses: the joint that
    # drives the seat best, and the middle pose.
    arm = arm_of("planar3")
    at, rng = linear("planar3"), np.random.default_rng(5)
    direction = np.array([0.6, 0.8])
    forces, torques = [], []
    for _ in range(200):
        pose = at.at(arm.random_pose(rng))
        force, torque = [], []
        for joint in range(arm.n):
            levels = np.where(np.arange(arm.n) == joint, arm.levels[-1], 0.0)
            shake, _ = at_levels(pose, levels, duration=1.0)
            answer, rms = pose.response(shake.excited), shake.torque_rms[joint]
            force.append(rms * np.sqrt(np.mean(np.abs(answer.slide[:, 1, :, 0] @ direction) ** 2)))
            torque.append(rms * np.sqrt(np.mean(np.abs(answer.hinge[:, 1, 0]) ** 2)))
        forces.append(max(force))
        torques.append(max(torque))
    drive = SeatDrive(at)
    # The yardstick takes 48 poses of its own.
    assert drive.slide(2, (0.6, 0.8, 0.0)) == pytest.approx(np.median(forces), rel=0.15)
    assert drive.hinges[1] == pytest.approx(np.median(torques), rel=0.15)


def seat_masses(arm: str, fault: StructuralLooseness | Backlash) -> tuple[float, float]:
    """Mass on a seat with the rest of the straight arm held, and the least with the rest free."""
    at = linear(arm)
    whole = at.at(np.zeros(arm_of(arm).n)).inertia
    seat = np.zeros(len(whole))
    if isinstance(fault, Backlash):
        seat[at.hinge_dofs[fault.joint - 1]] = 1.0
    else:
        seat[at.slide_dofs[fault.link - 1]] = fault.direction[:2]
    moving = np.vstack([np.eye(len(whole))[[*at.joint_dofs, *at.flexible_dofs]], seat])
    rng = np.random.default_rng(0)
    folded = [at.at(arm_of(arm).random_pose(rng)).inertia for _ in range(64)]
    free = [1 / np.linalg.inv(moving @ m @ moving.T)[-1, -1] for m in (whole, *folded)]
    return float(seat @ whole @ seat), float(min(free))


@pytest.mark.parametrize("arm", PLANE)
def test_stops_are_as_stiff_and_damped_as_stated_each_side_its_own(arm: str) -> None:
    rng = np.random.default_rng(2)
    fastest = 0.85 * FASTEST_TURN / arm_of(arm).timestep
    for name in hypotheses(arm_of(arm))[1:]:
        for _ in range(10):
            fault = sampler(arm, "default").draw(rng, hypothesis=name)
            assert isinstance(fault, (StructuralLooseness, Backlash))
            held, free = seat_masses(arm, fault)
            stiffness, damping = np.array(fault.stiffness), np.array(fault.damping)
            mode = np.sqrt(stiffness / held) / (2 * np.pi)
            local = np.sqrt(stiffness / free)
            assert ((mode < 360.001) & (local < fastest * 1.001)).all()
            # Below 300 Hz only where the local mode would be too fast for the step.
            assert ((mode > 299.999) | (local > fastest * 0.999)).all()
            ratio = damping / (2 * np.sqrt(stiffness * free))
            assert ((ratio > 0.0499) & (ratio < 0.3001)).all()
            assert damping[0] != damping[1]


@pytest.mark.parametrize(
    "kinds",
    [
        {"healthy": 1.0},
        {"backlash": 1.0},
        {"healthy": 0.2, "structural_looseness": 0.8},
        {"healthy": 0.0, "structural_looseness": 0.25, "backlash": 0.75},
    ],
)
def test_kinds_come_with_the_probability_given(kinds: dict[str, float]) -> None:
    own = FaultSampler(linear("planar3"), Difficulty(kinds=kinds))
    rng = np.random.default_rng(6)
    found = Counter(own.draw(rng).kind for _ in range(400))
    possible = [kind for kind, share in kinds.items() if share > 0]
    assert set(found) == set(possible)
    expected = [400 * kinds[kind] for kind in possible]
    if len(possible) > 1:
        observed = [found[kind] for kind in possible]  # type: ignore[index]
        assert stats.chisquare(observed, expected).pvalue > 0.01


def draws(name: str, kind: str, count: int, difficulty: str = "default") -> list[Any]:
    """Faults of one kind, as many at every link."""
    rng, own = np.random.default_rng(8), sampler_of(name, difficulty)
    places = hypotheses(arm_of(name), ("healthy", kind))[1:]
    return [own.draw(rng, hypothesis=place) for place in places for _ in range(count)]


def test_hypotheses_are_ordered_by_kind_then_by_place() -> None:
    arm = planar(2)
    assert hypotheses(arm) == hypotheses(arm, KINDS) == hypotheses(arm, KINDS[::-1])
    assert hypotheses(arm)[3:] == ("backlash@joint1", "backlash@joint2")
    assert hypotheses(arm, ("healthy",)) == ("healthy",)


def test_all_kinds_come_up_alike_at_every_place() -> None:
    own, rng = sampler_of("planar3"), np.random.default_rng(6)
    found = Counter(own.draw(rng).hypothesis for _ in range(600))
    kinds = Counter({k: sum(c for h, c in found.items() if h.startswith(k)) for k in KINDS})
    assert stats.chisquare([kinds[k] for k in KINDS]).pvalue > 0.01
    assert set(found) == set(hypotheses(arm_of("planar3"), KINDS))


@pytest.mark.parametrize(
    "difficulty",
    [d if d == "hard" else pytest.param(d, marks=pytest.mark.slow) for d in DIFFICULTIES],
)
@pytest.mark.parametrize("name", SOME)
def test_every_fault_can_be_simulated_in_every_drawn_arm(name: str, difficulty: str) -> None:
    arm = arm_of(name)
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    rng = np.random.default_rng(1)
    for kind in KINDS[1:]:
        for fault in draws(name, kind, 10, difficulty):
            mismatch = DIFFICULTIES[difficulty].mismatch.draw(arm, rng)
            plant = shop.build(fault, mismatch)
            assert plant.parts == len(parts_of(fault))


def run(env: Any, fault: str, seed: int) -> tuple[Any, ...]:
    """One record in which everything is shaken, then the right verdict."""
    n = env.arm.n
    first, _ = env.reset(seed=seed, options={"fault": fault})
    seen = env.step(env.actions.encode(levels=np.full(n, 3), duration=0))
    verdict = env.actions.encode(verdict=1 + env.hypotheses.index(fault))
    return first, seen, env.step(verdict)


@pytest.mark.filterwarnings("ignore:.*(no torque limits|no limits):UserWarning")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in ("six_axis", "ur5e") else name
        for name in (*MANY, *FILES)
    ],
)
def test_episodes_with_all_kinds_run_on_every_arm(name: str) -> None:
    env = DiagnosisEnv(
        arm_of(name), DiagnosisSettings(kinds=KINDS, max_records=2, durations=(0.1,)), threads=1
    )
    assert env.hypotheses == hypotheses(env.arm, KINDS)
    assert env.action_space.nvec[-1] == 1 + len(env.verdicts)
    for k, fault in enumerate(env.hypotheses):
        first, (seen, _, terminated, truncated, info), last = run(env, fault, k)
        assert first.shape == seen.shape
        assert np.isfinite(seen).all() and env.observation_space.contains(seen)
        assert not terminated and not truncated
        assert info["action_mask"].shape == (int(env.action_space.nvec.sum()),)
        _, reward, terminated, _, info = last
        assert terminated and reward == 1.0
        assert info["is_success"] and info["link_success"] and info["fault"] == fault
        assert info["fault_figures"].hypothesis == fault
