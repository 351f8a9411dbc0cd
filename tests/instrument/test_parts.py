"""Parts of the instrument: signals, knocks, gears and what repeats."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loose_env.arms import SIX_AXIS_SERVO_ARM
from loose_env.instrument import PlanSettings, SuspectArm, commands_of, plan, read_arm
from loose_env.instrument.arm import AXES, ROCKS
from loose_env.instrument.knocks import knocks, loads_of, rung, sphere, thrown, trains
from loose_env.instrument.locate import correlation
from loose_env.instrument.motion import accelerations, fit_gears, links_of, mounted, softening, wave
from loose_env.instrument.records import Record, followed_hz, read_run, shares_followed
from loose_env.instrument.ringing import GRID
from loose_env.instrument.signals import Multisine, multisine
from loose_env.recording import Run
from tests.instrument.machine import JOINTS, NOMINAL, RATE, REST, Truth, played, simulated


class Elastic(NamedTuple):
    """Records of an arm on springs, and what is true of it."""

    arm: SuspectArm
    signal: Multisine
    records: tuple[Record, ...]
    links: tuple[np.ndarray, ...]
    turn: np.ndarray
    springs: np.ndarray


@pytest.fixture(scope="module")
def arm() -> SuspectArm:
    return read_arm(SIX_AXIS_SERVO_ARM)


def test_lines_are_odd_and_some_are_left_out() -> None:
    signal = multisine(3, 25.0, np.random.default_rng(1))
    assert (signal.excited % 2 == 1).all() and (signal.silent % 2 == 1).all()
    assert not set(signal.excited) & set(signal.silent) and len(signal.silent) >= 3
    waves = signal.accelerations(np.array([1.0, 2.0, 3.0]), 1000)
    np.testing.assert_allclose(np.abs(waves).max(0), [1, 2, 3], rtol=1e-3)
    # Lines of one amplitude in phase would reach the root of twice their number over the rms.
    rms = np.sqrt((waves**2).mean(0))
    assert (np.abs(waves).max(0) / rms < 0.75 * np.sqrt(2 * len(signal.excited))).all()
    share = np.abs(np.fft.rfft(waves, axis=0)[signal.silent]).max()
    assert share < 1e-6 * np.abs(np.fft.rfft(waves, axis=0)).max()


def test_commands_begin_and_end_at_rest() -> None:
    signal, peak = multisine(2, 25.0, np.random.default_rng(1)), np.array([8.0, 5.0])
    for kind in ("position", "velocity"):
        given = signal.played(peak, kind, np.zeros(2), np.eye(2), 500.0)
        assert len(given) == round(signal.seconds * 500)
        speed = np.diff(given, axis=0) * 500 if kind == "position" else given
        assert np.abs(speed[[0, -1]]).max() < 1e-3 * np.abs(speed).max()


def test_a_mass_between_two_stops_arrives_when_it_must() -> None:
    # Constant load L: the mass crosses the gap g in sqrt(2 g m / L) and arrives at 2 g L / m.
    n, period = 4000, 1.0
    load = np.where(np.arange(n) < n // 2, 10.0, -10.0)[None]
    energy = knocks(load, np.array([2.0]), np.array([1e-3]), np.zeros(1), period)[0]
    hits = np.flatnonzero(energy)
    late = np.sqrt(2 * 1e-3 * 2 / 10)
    np.testing.assert_allclose(hits * period / n, [late, 0.5 + late], atol=1e-3)
    np.testing.assert_allclose(energy[hits], 2 * 1e-3 * 10 / 2, rtol=0.05)
    held = knocks(load, np.array([2.0]), np.array([1e-3]), np.array([11.0]), period)
    assert not held.any()


def test_knocks_agree_with_a_finer_integration() -> None:
    rng = np.random.default_rng(8)
    n, period, fine = 1000, 1.0, 50
    t = np.arange(n * fine) / n / fine
    lines, phases = np.array([3, 5, 9, 13]), rng.uniform(0, 2 * np.pi, 4)
    load = 20 * np.cos(2 * np.pi * np.outer(t, lines) + phases).sum(1) + 4
    mass, gap, friction = 3.0, 8e-5, 2.0
    x = v = 0.0
    hits, speeds = [], []
    for k in range(2 * n * fine):
        force = -load[k % (n * fine)]
        if (x <= 0 and force < friction) or (x >= gap and force > -friction):
            v = 0.0
            continue
        v += (force - friction * np.sign(v or force)) / mass * period / n / fine
        x += v * period / n / fine
        if x <= 0 or x >= gap:
            if k >= n * fine and abs(v) > 1e-3:
                hits.append(k / n / fine - period)
                speeds.append(v * v)
            x, v = min(max(x, 0.0), gap), 0.0
    one = np.ones(1)
    energy = knocks(load[None, ::fine], mass * one, gap * one, friction * one, period)[0]
    heard = np.flatnonzero(energy > 1e-6)
    np.testing.assert_allclose(heard / n, hits, atol=0.003)
    np.testing.assert_allclose(energy[heard], speeds, rtol=0.35)


def test_ringing_decays_around_the_period() -> None:
    energy = np.zeros((1, 1000))
    energy[0, 990] = 1.0
    rings = rung(energy, 0.005, 1.0)[0]
    assert rings[990] == pytest.approx(1.0) and rings[995] == pytest.approx(np.exp(-1), rel=1e-3)
    assert rings[5] == pytest.approx(np.exp(-3), rel=1e-2)


def test_directions_cover_half_the_sphere() -> None:
    grid = sphere(240)
    np.testing.assert_allclose(np.linalg.norm(grid, axis=1), 1)
    rng = np.random.default_rng(0)
    tried = rng.normal(size=(500, 3))
    tried /= np.linalg.norm(tried, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.abs(tried @ grid.T).max(1).min())) < 9


def test_correlation_takes_off_what_friction_explains() -> None:
    rng = np.random.default_rng(3)
    friction, knock = rng.random((1, 1000)), rng.random((1, 1000))
    heard = 3 * friction[0] + knock[0]
    told = [np.vstack([knock, friction])]
    found, share, chance = correlation([heard[None]], told, [friction], np.array([[300], [500]]))
    assert abs(chance) < 0.2
    assert found[0] == pytest.approx(1.0) and found[1] == 0.0 and share > 0.8


def test_links_on_springs_resonate(arm: SuspectArm) -> None:
    model = arm.at(np.zeros(arm.n))
    free = 1 / np.diag(np.linalg.inv(model.inertia))
    spring = free * (2 * np.pi * 1000.0) ** 2
    still = links_of(np.ones((1, arm.n), complex), model, spring, 0 * free, np.array([5.0]), 0.0)
    np.testing.assert_allclose(still, 1, rtol=1e-3)
    np.testing.assert_allclose(np.abs(wave(np.array([[0], [0], [3j]]))).max(), 3, rtol=1e-3)


@pytest.fixture(scope="module")
def elastic(bench: Path) -> Elastic:
    """Records of the bench arm on springs, its sensor turned, and the links' own motion."""
    own = read_arm(bench)
    made, _ = plan(bench, PlanSettings(poses=3))
    machine = simulated(Truth(mode_hz=40, mass=1.0))
    turn = Rotation.from_euler("xyz", [20, -35, 100], degrees=True).as_matrix()
    signal, records, links = made.signal.signal, [], []
    for number, run in enumerate(made.runs):
        rng = np.random.default_rng(number)
        time, read = played(machine, commands_of(made, own, run)[1], 500.0, rng)
        sensors = {f"{j}_position": read[j] for j in JOINTS}
        moved = Run(name=run.file, time=time, sensors={**sensors, "acc": read["acc"] @ turn})
        record = read_run(own, moved, signal, level=1.0, corner_hz=None)
        assert isinstance(record, Record)
        records.append(record)
        first = round((REST + signal.lead_s) * RATE)
        link = np.column_stack([read[j] + read[f"{j}_spring"] for j in JOINTS])
        period = np.fft.rfft(link[first : first + GRID], axis=0)[signal.excited]
        links.append(np.abs(period) * (2 * np.pi * signal.hertz[:, None]) ** 2)
    springs = np.array([machine.joint(f"{j}_spring").stiffness[0] for j in JOINTS])
    return Elastic(own, signal, tuple(records), tuple(links), turn, springs)


def test_the_sensor_may_be_mounted_at_any_angle(elastic: Elastic) -> None:
    models = [elastic.arm.at(r.pose) for r in elastic.records]
    found = mounted(elastic.records, models, elastic.signal)
    between = Rotation.from_matrix(found @ elastic.turn.T).magnitude()
    assert len(found) == len(elastic.records) and np.degrees(between).max() < 3


def test_a_bandwidth_below_the_plan_is_measured(elastic: Elastic) -> None:
    signal, joints = elastic.signal, elastic.arm.joints
    peaks = [
        dict(zip(joints, np.abs(r.joints[signal.excited]).max(0) * signal.crest, strict=True))
        for r in elastic.records
    ]
    slow = []
    for record in elastic.records:
        lines = record.joints.copy()
        lines[signal.excited, 0] = peaks[0]["turn"] / signal.crest[0]
        lines[signal.excited[-3:], 0] *= 0.3
        slow.append(replace(record, joints=lines))
    shares = shares_followed([r.joints for r in slow], [peaks[0]] * len(slow), signal, joints)
    assert followed_hz(shares[:, :1], signal) == signal.hertz[-4]
    # A dip below the end, or a loud line above it, is not the end.
    for k, share in ((2, 0.2), (-1, 0.8)):
        other = np.where(np.arange(len(shares)) == k % len(shares), share, shares[:, 0])
        assert followed_hz(other[:, None], signal) == signal.hertz[-4]
    assert followed_hz(0.3 * shares, signal) == 0


def test_springs_of_the_gears_are_found_and_carry_the_links(elastic: Elastic) -> None:
    arm, signal = elastic.arm, elastic.signal
    models = [arm.at(r.pose) for r in elastic.records]
    gears = fit_gears(arm, elastic.records, models, signal)
    assert gears.left < 0.02
    np.testing.assert_allclose(gears.spring, elastic.springs, rtol=0.3)
    for k, (record, model) in enumerate(zip(elastic.records, models, strict=True)):
        soft = np.abs(np.fft.rfft(accelerations(record, model, gears, k, 1.0), axis=0))
        hard = np.abs(np.fft.rfft(wave(record.joints), axis=0))
        true = elastic.links[k]
        error, without = (
            np.linalg.norm(a[signal.excited] - true) / np.linalg.norm(true) for a in (soft, hard)
        )
        assert error < 0.08 and without > 2 * error


def test_a_heavier_tool_is_told_from_a_softer_joint(elastic: Elastic) -> None:
    arm, signal = elastic.arm, elastic.signal
    models = [arm.at(r.pose) for r in elastic.records]
    gears = fit_gears(arm, elastic.records, models, signal)

    def told(load: float, factors: np.ndarray) -> list[Record]:
        """Records of the arm as its gears foretell them, with a mass at the tool."""
        found = []
        for k, (record, model) in enumerate(zip(elastic.records, models, strict=True)):
            heavier = replace(model, inertia=model.inertia + load * model.held)
            lines, spring = np.arange(1, len(record.joints)), gears.spring * factors
            moved = links_of(
                record.joints[lines], heavier, spring, gears.rotor, lines / signal.period_s, 0.06
            )
            tool = record.tool.copy()
            read = moved @ model.jacobian.T + model.tilt(moved, lines / signal.period_s)
            early = np.exp(-2j * np.pi * lines / signal.period_s * gears.late[k])[:, None]
            tool[lines] = read @ gears.rotation[k] * early
            found.append(replace(record, tool=tool))
        return found

    heavy = softening(told(0.7, np.ones(3)), models, gears, signal)
    assert heavy.payload < heavy.joints.min() < heavy.none
    assert heavy.payload_kg == pytest.approx(0.7, rel=0.1)
    soft = softening(told(0.0, np.array([1.0, 0.6, 1.0])), models, gears, signal)
    assert soft.joints.argmin() == 1 and soft.joints.min() < soft.payload


def test_rigid_dynamics_agree_with_weights(arm: SuspectArm) -> None:
    pose = np.array([0.3, -1.2, 1.1, 0.2, 0.6, 0.1])
    model = arm.at(pose)
    np.testing.assert_allclose(np.linalg.norm(model.weight, axis=1), 9.81 * model.mass, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(model.up), 9.81)
    np.testing.assert_allclose(model.inertia, model.inertia.T, atol=1e-9)
    throws, stiff, turns, free = model.throws(np.zeros(arm.n))
    assert throws.shape == (6, 3, 3) and (np.linalg.eigvalsh(stiff) > -1e-9).all()
    assert turns.shape == (6 + AXES, 3) and (free > 0).all()


def test_joints_that_are_all_parallel_leave_numbers(tmp_path: Path) -> None:
    path = tmp_path / "planar.xml"
    path.write_text("""<mujoco><worldbody><body name="a"><joint name="lift" axis="0 1 0"
    range="-2 2"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="2"/><body name="b"
    pos=".3 0 0"><joint name="bend" axis="0 1 0" range="-2 2"/><site name="tool" pos=".3 0 .1"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1"/></body></body></worldbody>
    </mujoco>""")
    made, planar = plan(path, PlanSettings(poses=3, max_torque_nm=(50.0,)))
    assert np.isfinite([*made.tested.values()]).all()
    found = planar.at(np.array([0.3, 0.4])).throws(np.zeros(2))
    assert all(np.isfinite(each).all() for each in found)
    # The free joint takes up all of a rocking about its own axis.
    np.testing.assert_allclose(found[2][2 + AXES // 2], 0, atol=1e-9)
    swing = np.sin(np.linspace(0, 20 * np.pi, 200))[:, None] * np.array([200.0, 300.0])
    loads = loads_of(planar.at(np.array([0.3, 0.4])), swing, np.zeros(2))
    (rang,) = trains([loads], np.eye(3), 0.05, planar.slides, 1.0)
    assert len(rang) == 2 * 3 + 2 + ROCKS and np.isfinite(rang).all()
    told = thrown(loads, np.eye(3))
    np.testing.assert_allclose(np.trace(told, axis1=1, axis2=2), 1)


def test_a_link_that_is_called_base_is_not_the_ground(tmp_path: Path) -> None:
    path = tmp_path / "named.xml"
    named = NOMINAL.replace('"foot"', '"plate"').replace('"column"', '"base"')
    path.write_text(named.replace('<inertial pos="0 0 -.1" mass="15" diaginertia=".2 .2 .1"/>', ""))
    arm = read_arm(path)
    assert arm.base == "plate" and len(set(arm.places)) == 7
    path.write_text("""<mujoco><worldbody><body name="base"><joint name="turn" axis="0 0 1"
    range="-1 1"/><geom size=".1" mass="2"/><body name="fore" pos=".4 0 0"><joint name="base"
    axis="0 1 0" range="-1 1"/><geom size=".1" mass="1"/><site name="tool" pos=".3 0 0"/></body>
    </body></worldbody></mujoco>""")
    arm = read_arm(path)
    assert arm.base == "ground" and len(set(arm.places)) == 5


def test_a_base_rocks_as_if_it_hung_on_a_hinge(bench: Path) -> None:
    arm, pose = read_arm(bench), np.array([0.4, -0.5, 1.0])
    model = arm.at(pose)
    spec = mujoco.MjSpec.from_file(str(bench))
    spec.body("foot").add_joint(name="rock", axis=[1, 0, 0])
    hinged = spec.compile()
    data, full = mujoco.MjData(hinged), np.zeros((hinged.nv, hinged.nv))
    data.qpos[1:] = pose
    mujoco.mj_forward(hinged, data)
    mujoco.mj_fullM(hinged, data, full)
    np.testing.assert_allclose(model.rocked[0], full[0, 1:], atol=1e-9)
    np.testing.assert_allclose([model.bulk[0], model.moment[0]], [full[0, 0], data.qfrc_bias[0]])
    move = np.zeros((3, hinged.nv))
    site = hinged.site("tool").id
    mujoco.mj_jacSite(hinged, data, move, None, site)
    np.testing.assert_allclose(model.swung[0], data.site_xmat[site].reshape(3, 3).T @ move[:, 0])
