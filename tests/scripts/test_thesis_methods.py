"""The thesis's equations against closed forms, derivatives and simulations."""

from __future__ import annotations

import inspect
import math
import re
import string
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from loose_env.arms import LinearArm, planar, vera
from loose_env.errors import InvalidData
from loose_env.faults import Backlash, Healthy, StructuralLooseness
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.statistics import axial_difference
from scripts.thesis import loose_joint as loose_joints
from scripts.thesis import matching, planar_motion, signals
from scripts.thesis.estimators import kurtosis
from scripts.thesis.index_tables import error_summary, index_rows
from scripts.thesis.link_finding import predicted_slides
from scripts.thesis.page import SECTIONS, text_of
from scripts.thesis.planar_motion import (
    LoosePlanarArm,
    MonteCarlo,
    SeatMotion,
    histogram,
    nominal_jacobian,
    regions,
    tool_acceleration,
    tool_position,
    tool_velocity,
)
from scripts.thesis.pose_choice import axis_difference_deg, direction_deg, ellipsoid, rotation_line
from scripts.thesis.rigs import cylindrical, slide_rig
from scripts.thesis.sizing import TwoLinks, arm_loads, peak_force, two_link_loads, two_links
from tests.faults.thesis_equations import Figures, healthy_torques, thesis_arm

PLANE, POSE = [0, 1, 5], np.array([0.3, 0.9, -0.7])
SLIDE = StructuralLooseness(
    link=2, direction=(0.6, 0.8, 0.0), gap=2e-4, stiffness=(1e6, 1e6), damping=(100, 100)
)


def cited(source: str) -> set[str]:
    """Numbers of equations in a text, ranges such as 3.15-3.17 spelt out."""
    found = re.findall(r"\b(\d)\.(\d+)\)?(?:(?:-| to )\(?(\d)\.(\d+))?", " ".join(source.split()))
    return {f"{c}.{k}" for c, a, _, b in found for k in range(int(a), int(b or a) + 1)}


@pytest.mark.parametrize("key", list(SECTIONS))
def test_every_equation_has_a_function_that_cites_it(key: str) -> None:
    assert callable(getattr(import_module(f"scripts.thesis.{SECTIONS[key]}"), key))
    for path, numbers in text_of(key).get("equations", {}).items():
        parts, found = path.split("."), None
        for k in range(len(parts) - 1, 0, -1):  # a method stands behind its class
            try:
                found = import_module(".".join(parts[:k]))
            except ModuleNotFoundError:
                continue
            for part in parts[k:]:
                found = getattr(found, part)
            break
        assert callable(found)
        assert set(numbers.split()) <= cited(inspect.getdoc(found) or ""), path


def strings(consts: object) -> set[str]:
    """All strings among the constants of a function, those of its dictionaries too."""
    if isinstance(consts, str):
        return {consts}
    return set().union(*map(strings, consts)) if isinstance(consts, tuple) else set()


@pytest.mark.parametrize("key", list(SECTIONS))
def test_the_text_uses_names_that_its_section_has(key: str) -> None:
    module = import_module(f"scripts.thesis.{SECTIONS[key]}")
    code, text = getattr(module, key).__code__, text_of(key)
    known = {*vars(module), *text.get("printed", {}), *code.co_varnames, *code.co_cellvars}
    pages = [text["finding"], text["words"], text.get("left_out", "")]
    for block in (*text.get("table", ()), *text.get("figure", ())):
        pages += [block["caption"], block.get("title", ""), *block.get("columns", ())]
    used = {name for page in pages for _, name, *_ in string.Formatter().parse(page) if name}
    first = {re.split(r"[.\[]", name)[0] for name in used}
    assert first <= known | strings(code.co_consts)


def test_the_looseness_joint_is_a_column_that_locates_its_link() -> None:
    chain, step = Chain.of(planar(4), [0.2, 0.5, -0.8, 0.6]), 1e-6
    for kind, axis in (("prismatic", [1, 2, 0]), ("revolute", [0, 0, 1])):
        loose = loose_joints.insert_looseness(chain, 2, axis, kind=kind)
        ends = [loose_joints.displaced(chain, 2, axis, s * step, kind=kind).tool for s in (1, -1)]
        column = geometric_jacobian(loose)[:3, 2]
        np.testing.assert_allclose(column, (ends[0] - ends[1]) / (2 * step), atol=1e-8)
    for link in range(1, 5):
        moved = loose_joints.displaced(chain, link, [1, 2, 0], 2e-4)
        for frame in ("tool", "world", "base"):
            pair = (geometric_jacobian(c, frame) for c in (chain, moved))
            changed = loose_joints.changed_columns(*pair)
            proximal = np.arange(1, 5) <= link
            assert changed.tolist() == (~proximal if frame == "base" else proximal).tolist()
            found = loose_joints.link_of_changed_columns(changed, frame)
            assert found == (0 if frame == "base" and link == 4 else link)
    with pytest.raises(InvalidData, match="one block"):
        loose_joints.link_of_changed_columns([False, True], "tool")
    direction = loose_joints.slot_direction([0, 0, 1], [np.cos(0.6), np.sin(0.6), 0])  # (3.27)
    transform = loose_joints.looseness_transform(direction, 0.01)  # (3.26)
    np.testing.assert_allclose(transform[:3, :3], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(transform[:3, 3], 0.01 * direction, atol=1e-14)
    loose = geometric_jacobian(loose_joints.insert_looseness(chain, 1, [0, 1, 0]))
    error = loose_joints.velocity_error(
        geometric_jacobian(chain), [1, 2, 3, 4], loose, [1, 0.05, 2, 3, 4]
    )
    np.testing.assert_allclose(error, [0, 0.05, 0, 0, 0, 0], atol=1e-15)  # (3.34)


def test_a_seat_in_the_inertia_matrix_weighs_what_lies_beyond_it() -> None:
    arm, pose = planar(2), np.array([0.2, 0.8])
    nominal = loose_joints.seated_inertia(arm, pose, Healthy())
    play = Backlash(joint=2, gap=1e-4, stiffness=(1e4, 1e4))
    for fault in (SLIDE, play):
        loose = loose_joints.seated_inertia(arm, pose, fault)
        np.testing.assert_allclose(loose[:2, :2], nominal, rtol=1e-12)
    # Link 2 weighs 3 kg, a twentieth of it is the flange on the joint's side.
    slide = loose_joints.seated_inertia(arm, pose, SLIDE)
    assert slide[2, 2] == pytest.approx(0.95 * 3.0)
    ratio = loose[1, 1] / loose[2, 2] - 1
    condition = loose_joints.condition_of(loose[1:, 1:]).scaled
    assert condition == pytest.approx(loose_joints.backlash_condition(ratio))
    millimetres = np.diag([1, 1, 1e-3]) @ slide @ np.diag([1, 1, 1e-3])
    one, other = loose_joints.condition_of(slide), loose_joints.condition_of(millimetres)
    assert other.scaled == pytest.approx(one.scaled) and other.raw > 100 * one.raw


def test_the_recursion_finds_lengths_and_offsets_in_any_pose_and_frame() -> None:
    lengths, offsets = np.array([0.5, 0.35, 0.4, 0.2]), np.array([0.0, 0.3, -1.0, 0.7])
    rates, rng = np.array([0.4, -0.7, 0.5, 1.1]), np.random.default_rng(5)

    def velocities(angles: np.ndarray) -> np.ndarray:
        heading = np.cumsum(angles + offsets)
        links = lengths[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        arms = np.cumsum(links[::-1], axis=0)[::-1]
        return loose_joints.velocity_components([-arms[:, 1], arms[:, 0]], rates)

    for _ in range(10):
        q = rng.uniform(-np.pi, np.pi, 4)
        v = velocities(q)
        for turned in (v, v @ [[0.6, 0.8], [-0.8, 0.6]]):
            found = loose_joints.identify_planar(turned, rates, q)
            np.testing.assert_allclose(found.lengths, lengths, rtol=1e-10)
            error = np.angle(np.exp(1j * (found.offsets - offsets[1:])))
            np.testing.assert_allclose(error, 0, atol=1e-10)
    # Only the last joint moves; the printed angle (3.65) of inner joints changes with it.
    one, other = (
        loose_joints.distended_angles(velocities(np.array([0.0, 0.2, 0.3, last])), rates)
        for last in (0.1, 0.9)
    )
    assert np.angle(np.exp(1j * (other[-1] - one[-1]))) == pytest.approx(0.8)
    assert np.abs(other[:2] - one[:2]).min() > 0.02
    draws = [
        loose_joints.identify_planar(v + 1e-3 * rng.standard_normal(v.shape), rates, q)
        for _ in range(2000)
    ]
    sd, _ = loose_joints.parameter_deviations(v, rates, 1e-3)
    np.testing.assert_allclose(np.std([d.lengths for d in draws], axis=0), sd, rtol=0.06)
    np.testing.assert_allclose(loose_joints.slide_direction([0.03, 0.04]), [0.6, 0.8])
    with pytest.raises(InvalidData, match=r"joint 2 is prismatic.*free vector"):
        loose_joints.identify_planar(v, rates, q, kinds=["revolute", "prismatic"])


def nominal_and_loose(n: int, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    chain = Chain.of(planar(n), pose)
    axis = loose_joints.link_frames(planar(n), pose)[1] @ SLIDE.direction
    both = (chain, loose_joints.insert_looseness(chain, 2, axis))
    return tuple(geometric_jacobian(c)[PLANE] for c in both)  # type: ignore[return-value]


def test_a_docked_arm_moves_only_if_it_is_loose_or_has_a_joint_to_spare() -> None:
    for n, healthy in ((3, 0), (4, 1)):
        nominal, loose = nominal_and_loose(n, np.linspace(0.3, 1.0, n))
        assert loose_joints.remaining_motions(nominal).shape[1] == healthy
        motion = loose_joints.remaining_motions(loose)
        assert motion.shape[1] == healthy + 1
        np.testing.assert_allclose(loose @ motion, 0, atol=1e-12)
    arm, torque = planar(3), np.array([5.0, -2.0, 0.0, 1.0])
    nominal, loose = nominal_and_loose(3, POSE)
    inertia = loose_joints.seated_inertia(arm, POSE, Healthy())
    still = loose_joints.docked_acceleration(nominal, inertia, torque[[0, 1, 3]])
    np.testing.assert_allclose(still, 0, atol=1e-9)
    seated = loose_joints.seated_inertia(arm, POSE, SLIDE)[np.ix_([0, 1, 3, 2], [0, 1, 3, 2])]
    force = loose_joints.dock_force(loose, seated, torque)
    held = loose_joints.tool_acceleration(loose, seated, torque, force)
    np.testing.assert_allclose(held, 0, atol=1e-9)
    assert np.abs(loose_joints.docked_acceleration(loose, seated, torque)).max() > 0.1
    velocity = np.array([0.1, 0.2, 0.3])
    power = loose_joints.joint_torques(nominal, [3.0, -2.0, 0.5]) @ velocity
    assert power == pytest.approx(np.array([3.0, -2.0, 0.5]) @ nominal @ velocity)  # (3.10)


@pytest.mark.slow
def test_a_simulated_docked_arm_shows_its_seat_by_force_and_motion() -> None:
    arm, rng, directions, frames = planar(3), np.random.default_rng(7), [], []
    push = 0.03 * np.array(arm.torque_limits)[:, None]
    for _ in range(3):
        pose = rng.uniform(-1.8, 1.8, 3)
        wave = np.sin(np.outer([9.0, 15.0, 23.0], np.arange(0, 1, arm.timestep)))
        healthy = loose_joints.simulate_docked(arm, pose, Healthy(), push * wave, every=10)
        nominal, _ = nominal_and_loose(3, pose)
        wrench = np.vstack([healthy.forces, healthy.moments])
        rest = healthy.torques + loose_joints.joint_torques(nominal, wrench)
        assert np.abs(rest).max() < 0.005 * np.abs(healthy.torques).max()
        found = loose_joints.simulate_docked(arm, pose, SLIDE, push * wave, every=10)
        twist = loose_joints.seat_twist(nominal, found.angles)
        axis = (loose_joints.link_frames(arm, pose)[1] @ SLIDE.direction)[:2]
        assert abs(twist[:2] @ axis) > np.cos(np.radians(1.0))
        directions.append(twist[:2])
        frames.append(loose_joints.link_frames(arm, pose)[:, :2, :2])
    misfit, best = loose_joints.compatible_links(directions, frames)
    assert best == 2 and misfit[1] < 0.02 < 0.2 < np.delete(misfit, 1).min()


def test_tool_motion_is_the_derivative_of_the_one_before() -> None:
    arm, speed = LoosePlanarArm(length1=0.5, length2=0.3, beta=0.7), np.array([[1.3], [-0.8]])
    t, h = np.linspace(0.0, 2.0, 25), 1e-6

    def motion(t: np.ndarray) -> list[np.ndarray]:
        q, qd = np.sin(speed * t), speed * np.cos(speed * t)
        d, dd = 0.2 * np.sin(3 * t), 0.6 * np.cos(3 * t)
        return [q, qd, -(speed**2) * q, d, dd, -9 * d]

    q, qd, qdd, d, dd, ddd = motion(t)
    before, after = motion(t - h), motion(t + h)
    ends = [tool_position(arm, m[0], m[3]) for m in (before, after)]
    slope = (ends[1] - ends[0]) / (2 * h)
    np.testing.assert_allclose(tool_velocity(arm, q, qd, d, dd), slope, atol=1e-8)  # (5.4)
    ends = [tool_velocity(arm, m[0], m[1], m[3], m[4]) for m in (before, after)]
    slope = (ends[1] - ends[0]) / (2 * h)
    np.testing.assert_allclose(tool_acceleration(arm, q, qd, qdd, d, dd, ddd), slope, atol=1e-8)
    pose, rate = np.array([0.3, 1.1]), np.array([0.7, -0.2])
    tight = tool_velocity(arm, pose, rate, 0.0, 0.0)
    np.testing.assert_allclose(nominal_jacobian(arm, pose) @ rate, tight)  # (3.71)
    assert planar_motion.link_rate(rate) == pytest.approx(0.5)
    reach = [0.5 * np.cos(0.3) + 0.3 * np.cos(1.4), 0.5 * np.sin(0.3) + 0.3 * np.sin(1.4)]
    np.testing.assert_allclose(tool_position(arm, pose, 0.0), reach)  # (6.1)


def test_the_assumed_seat_leaves_its_stops_and_holds_their_probabilities() -> None:
    seat, rng = SeatMotion(gap=1.0, timestep=0.5), np.random.default_rng(2)
    d = planar_motion.draw_displacement(seat, 100_000, rng)
    shares = [np.mean(regions(seat, d) == region) for region in range(3)]
    np.testing.assert_allclose(shares, [0.25, 0.5, 0.25], atol=0.006)
    v = planar_motion.draw_seat_velocity(seat, d, rng)
    assert v[d == -0.5].min() == 0.0 and v[d == 0.5].max() == 0.0  # (3.35, 3.36)
    assert np.mean(v[d == 0.5] == 0.0) == pytest.approx(0.5, abs=0.015)
    a = planar_motion.draw_seat_acceleration(seat, d, v, rng)
    assert np.abs(v + a * seat.timestep).max() <= seat.fastest * (1 + 1e-12)
    chain = planar_motion.displacement_chain(SeatMotion(), 100_000, rng)
    table = planar_motion.transition_table(regions(SeatMotion(), chain))
    np.testing.assert_allclose(table, np.array([[1, 1, 0], [1, 2, 1], [0, 1, 1]]) / 8, atol=0.006)
    setting = MonteCarlo(angle_sd=1e-4, rate_sd=0.1, acceleration_sd=100.0)
    slide = planar_motion.looseness_direction(setting.arm, setting.theta)
    for draw in (
        planar_motion.draw_tool_displacement,
        planar_motion.draw_tool_velocity,
        planar_motion.draw_tool_acceleration,
    ):
        loose = draw(setting, 60_000, np.random.default_rng(8))
        tight = draw(replace(setting, seat=None), 60_000, np.random.default_rng(9))
        assert max(abs(kurtosis(loose, [-slide[1], slide[0]])), abs(kurtosis(tight, slide))) < 0.08
        assert abs(kurtosis(loose, slide)) > 0.2


def test_contours_and_marginals_of_a_gaussian() -> None:
    samples = np.random.default_rng(3).normal(size=(2, 1_000_000))
    found, shares = histogram(samples, bins=60), np.array([0.5, 0.9, 0.99])
    peak = 1_000_000 * found.width**2 / (2 * math.pi)
    levels = planar_motion.contour_levels(found, shares)
    np.testing.assert_allclose(levels / peak, 1 - shares, rtol=0.06)
    found = histogram(samples * [[1.0], [2.0]], bins=50)
    for axis, sd in enumerate((1.0, 2.0)):
        gauss = np.exp(-0.5 * (found.centres(axis) / sd) ** 2) / (sd * math.sqrt(2 * math.pi))
        density = planar_motion.marginal(found, axis)  # (3.70)
        np.testing.assert_allclose(density, gauss, atol=0.03 * gauss.max())
    with pytest.raises(InvalidData, match="vary"):
        histogram(np.ones((2, 10)))


@pytest.mark.parametrize("factors", [(1.1, 1.1, 1.1), (0.9, 0.9, 0.9), (1.1, 0.9, 1.1)])
def test_matching_is_as_accurate_as_printed(factors: tuple[float, ...]) -> None:
    pytest.importorskip("odrpack")
    surface, truth = matching.exact_surface(16)
    found = matching.match(surface, truth * factors)
    np.testing.assert_allclose(found.parameters, truth, rtol=1e-3)
    across = [-math.sin(matching.ANGLE), math.cos(matching.ANGLE)]
    np.testing.assert_allclose(found.direction, across, atol=1e-3)


def test_several_starts_find_directions_in_the_plane_and_in_space() -> None:
    pytest.importorskip("odrpack")
    rng = np.random.default_rng(9)
    data = histogram(matching.ridge_samples(6000, rng), bins=20)
    error = axial_difference(float(matching.search(data, 4).parameters[2]), matching.ANGLE)
    assert abs(math.degrees(error)) < 2.5
    frame = matching.rotation(0.5, 0.6)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)  # (4.2)
    motion = np.vstack([rng.standard_normal((2, 6000)), rng.uniform(-3, 3, 6000)])
    data = histogram(frame.T @ motion, bins=10)
    found = matching.match(data, matching.spatial_trial(data, frame[2] + 0.5 * frame[0]))
    assert math.degrees(math.acos(min(1.0, abs(found.direction @ frame[2])))) < 3.0
    round_motion = histogram(0.5 * rng.standard_normal((2, 50_000)), bins=60)
    assert matching.variance_trial(round_motion) == pytest.approx(0.25, rel=0.03)  # (4.7)


@pytest.mark.parametrize(("rules", "orders"), [("QUADRATURES", (3, 5)), ("DIFFERENCES", (1, 2))])
def test_rules_have_the_order_and_the_noise_they_claim(rules: str, orders: tuple[int, int]) -> None:
    noise = np.random.default_rng(1).standard_normal((40, 5000))
    for (rule, weights), order in zip(getattr(signals, rules).items(), orders, strict=True):
        errors = []
        for dt in (0.02, 0.01) if rules == "QUADRATURES" else (0.002, 0.001):
            g = np.sin(1.0 + dt * np.arange(5))
            if rules == "QUADRATURES":
                exact, found = np.cos(1.0 - dt) - np.cos(1.0), signals.quadrature_steps(g, dt, rule)
            else:
                exact, found = np.cos(1.0), signals.differentiate(g, dt, rule)
            errors.append(abs(found[0] - exact))
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.05)
        through = signals._filter(noise, weights).std()
        assert through == pytest.approx(signals.noise_gain(weights), rel=0.02)


def test_a_line_gives_its_own_direction_by_all_three_ways() -> None:
    rng = np.random.default_rng(3)
    motion, noise = rng.standard_normal((2, 200_000))
    for degrees in (5.0, 30.0, 80.0):
        x, y = np.cos(np.radians(degrees)) * motion, np.sin(np.radians(degrees)) * motion
        assert np.degrees(signals.rms_motion(x, y).direction) == pytest.approx(degrees)
        now = np.degrees(signals.instantaneous_motion(x, y).direction)
        np.testing.assert_allclose(now, degrees)
        assert np.degrees(signals.line_of_motion(x, y).direction) == pytest.approx(degrees)
    # Noise on the idle axis turns the rms direction, but not the regression.
    turned = float(signals.rms_motion(motion, 0.05 * noise).direction)
    assert turned == pytest.approx(np.arctan(0.05), rel=0.02)
    assert abs(signals.line_of_motion(motion, 0.05 * noise).direction) < 0.001
    own, gain = signals.subtract_base(motion + 0.9 * noise, noise, fit=True)
    assert gain == pytest.approx(0.9, abs=0.01)
    np.testing.assert_allclose(own, motion, atol=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_three_derivations_of_joint_loads_agree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    figures = Figures.draw(rng)
    arm = thesis_arm(figures)
    q, v, a = rng.uniform(-3, 3, (3, 2))
    closed = two_link_loads(two_links(arm), q[1], v, a, gravity=0.0)
    np.testing.assert_allclose(closed.torque, healthy_torques(figures, q, v, a), atol=1e-10)
    for one, other in zip(closed, arm_loads(arm, q, v, a), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
    weighed = two_link_loads(two_links(vera()), q[1], v, a)
    for one, other in zip(weighed, arm_loads(vera(), q, v, a), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_the_printed_slip_of_the_inertia_would_show() -> None:
    links = TwoLinks(0.5, (3.0, 1.0), (0.3, 0.2), (0.1, 0.05))
    found = two_link_loads(links, 0.0, [0.0, 0.0], [1.0, 0.0]).torque[0]
    assert found == pytest.approx(0.1 + 3.0 * 0.3**2 + 0.05 + 1.0 * 0.7**2)
    force = two_link_loads(links, 0.0, [2.0, 0.0], [0.0, 0.0]).force
    np.testing.assert_allclose(force[:, 0], [-4 * (3 * 0.3 + 0.7), -4 * 0.7])
    peak = peak_force(np.array([[1.0, 0.0, 9.0], [-3.0, 4.0, 9.0]]), np.array([10.0, 20.0]))
    assert peak == (5.0, -3.0, 4.0, 20.0) and peak.direction == "tangential"


@pytest.mark.parametrize(
    ("theta", "line", "major", "agrees"),
    [
        (122, 299, 260, False),
        (98, 311, 328, True),
        (56, 332, 338, True),
        (28, 346, 349, True),
        (302, 29, 215, False),
    ],
)
def test_lines_and_major_axes_printed_for_vera(
    theta: float, line: float, major: float, agrees: bool
) -> None:
    pose = np.radians([0.0, theta])
    found = direction_deg(rotation_line(vera(), pose))
    assert abs(axis_difference_deg(found, line)) < 0.1
    plain = ellipsoid(geometric_jacobian(Chain.of(vera(), pose), "tool")[:2])
    off = axis_difference_deg(direction_deg(plain.axes[:, 0]), major)
    assert (abs(off) < 1.5) is agrees
    assert np.prod(plain.lengths) == pytest.approx(0.16 * abs(np.sin(pose[1])))


def test_a_slide_is_carried_along_by_the_joints_beyond_it() -> None:
    from loose_env.diagnosis import ToolFrames

    frames, before, after = ToolFrames(planar(3)), np.zeros(3), np.array([0.0, 0.7, 0.0])
    found = predicted_slides(frames, before, after, np.array([1.0, 0.0]))  # (4.27)
    turned = [np.cos(0.7), -np.sin(0.7)]
    np.testing.assert_allclose(found, [turned, [1.0, 0.0], [1.0, 0.0]], atol=1e-12)


def test_the_index_follows_from_the_tables_and_their_slips_are_found() -> None:
    conditions = ("looseness", "low_preload", "backlash")
    rows = {condition: index_rows(condition) for condition in conditions}
    for row in (row for own in rows.values() for row in own):
        product = row.change_printed * abs(math.sin(math.radians(row.turn_printed)))
        assert row.mag_d_columns == pytest.approx(product, abs=1e-12)
        assert abs(row.mag_d_columns - row.mag_d_printed) < 0.0051
    assert rows["looseness"][0].mag_d == pytest.approx(0.375 * math.sin(math.radians(80)))
    assert rows["backlash"][3].mag_d == pytest.approx(11 / 15 * math.sin(math.radians(70)))
    assert rows["low_preload"][2].remark == "angle one step off"
    assert rows["looseness"][0].remark == "agrees"
    assert error_summary([350.0], [175.0]).mean == pytest.approx(-5.0)
    assert error_summary([1.0, 179.0], [180.0, 0.0]) == (0.0, 1.0, 1.0)


def test_the_cylindrical_arm_moves_in_cylindrical_coordinates_and_carries_its_weight() -> None:
    arm = cylindrical()
    at = LinearArm(arm).at([0.4, 0.3, 0.7, 0.0, 0.0, 0.0])
    radius = 0.15 + 0.55 + 0.12 + 0.10 + 0.14 + 0.7
    expected = [[0, 0, 1], [radius, 0, 0], [0, 1, 0]]
    np.testing.assert_allclose(at.kinematic[:, :3], expected, atol=1e-12)
    carried = arm.model.body("flange2").subtreemass[0]
    assert at.gravity_torque[1] == pytest.approx(9.81 * carried)
    still = np.zeros(6)
    loads = arm_loads(arm, np.array([0.3, 0.4, 0.5, 0.1, 0.2, -0.1]), still, still)
    assert loads.torque[1] == pytest.approx(9.81 * carried)
    assert slide_rig(looseness_angle=1.0).shaker.stand == "bench"
