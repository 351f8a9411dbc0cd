"""What the simulated experiments of the thesis must show in every pose."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.arms import LinearArm, ShakenArm, planar
from loose_env.kinematics import reactions
from loose_env.statistics import axial_difference
from scripts.thesis import experiment_four, experiment_one, shaken_vera
from scripts.thesis.experiment_one import POSES, Guideway, shudder, stroke_many, transfer_point
from scripts.thesis.link_finding import (
    JOINTS,
    SLIDES,
    chance_of,
    named,
    pair_count,
    printed_directions,
    scatter,
    search,
)
from scripts.thesis.page import printed, run_section
from scripts.thesis.pose_choice import seat_drive
from scripts.thesis.rigs import PROXIMAL
from scripts.thesis.rigs import shaken_vera as vera_on_shaker
from scripts.thesis.shaken_vera import FINGER, LOOSE, PLAY, TIGHT, measured_case, poses
from scripts.thesis.signals import RESOLVER_UNIT, angles, play, slide_records

SOURCE = Path(__file__).resolve().parents[3] / "shared" / "thesis"
QUIET = Guideway(potentiometer_noise=0.0, accelerometer_noise=0.0, trigger_jitter=0.0)


@pytest.mark.skipif(not SOURCE.is_dir(), reason="the tables of the source do not lie beside it")
def test_printed_tables_are_those_of_the_source() -> None:
    def read(name: str) -> list[dict[str, str]]:
        with (SOURCE / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    figures = printed("index_tables")
    for name in ("C_n", "C_f", "C_b"):
        said = [float(row[name]) for row in read("table_6_4_max_correlation")]
        assert said == figures["table_6_4"][name.lower()]
    rows = read("tables_6_5_to_6_7_comparative_index")
    columns = {"one_minus_C_star": "one_minus_c", "delta_phi_deg": "turn_deg", "mag_D": "mag_d"}
    for row, theta2 in zip(rows, 3 * figures["theta2_deg"], strict=True):
        assert int(row["theta2_deg"]) == theta2
        table = figures[f"table_{row['table'].replace('.', '_')}_{row['condition']}"]
        for column, key in columns.items():
            assert float(row[column]) == table[key][figures["theta2_deg"].index(theta2)]
    found: dict[str, list[list[float]]] = {}
    for row in read("tables_6_1_6_2_histogram_ranges_g"):
        found.setdefault(row["condition"], []).append([float(row["min_g"]), float(row["max_g"])])
    first, second = figures["table_6_1_histogram_range_g"], figures["table_6_2_histogram_range_g"]
    assert found == first | {"backlash": second["backlash"]}
    names = {
        "direction_error_deg": "error_deg",
        "phi_n_high_preload_deg": "lowest_high_preload_deg",
        "phi_f_fault_deg": "lowest_{}_deg",
        "actual_fault_dir_deg": "{}_deg",
    }
    for fault in ("looseness", "backlash"):
        own = [row for row in read("vera_cases") if row["fault"] == fault]
        for row, case in zip(own, figures[f"{fault}_cases"], strict=True):
            for column, key in names.items():
                said = float(row[column]) if row[column] else None
                assert case.get(key.format(fault)) == said


def test_the_section_of_tables_lists_every_slip() -> None:
    pytest.importorskip("matplotlib")
    found = run_section("index_tables", 0).section
    assert found is not None
    slips = found.tables[-1].rows
    assert ("Table 6.3, 302°", "error, looseness", "20°", "35°") in slips
    assert ("Table 6.5, 56°", "|1\u00a0−\u00a0C*|", "0.80", "0.50") in slips
    assert len(slips) == 10
    assert not any("nan" in cell for table in found.tables for row in table.rows for cell in row)


def test_the_boom_goes_over_where_its_weight_does_and_only_with_play() -> None:
    def stroke(name: str, settings: Guideway = QUIET) -> experiment_one.Strokes:
        return stroke_many(POSES[name], 1, settings, np.random.default_rng(3))

    seen, tight = shudder(stroke("B"), QUIET), replace(QUIET, play=0.0)
    assert seen is not None
    assert seen.leaves == pytest.approx(transfer_point(), abs=0.01)
    # It falls freely through the gap, I a = m g v t: (6 gap I / (m g v))^(1/3), about 0.1 s.
    assert 0.06 < (seen.lands - seen.leaves) / QUIET.speed < 0.16
    assert shudder(stroke("A"), QUIET) is None
    assert shudder(stroke("B", tight), tight) is None


@pytest.mark.slow
def test_the_raised_arm_rings_below_its_columns_mode_and_sets_are_told_apart() -> None:
    assert 7.2 < experiment_one.ringing(Guideway()) < 8.0
    rng = np.random.default_rng(1)
    strokes = np.sin(np.arange(4000) / 20) + 0.1 * rng.standard_normal((40, 4000))
    spread, lowest = experiment_one.repeatability(strokes)
    assert spread == pytest.approx(0.1 * np.sqrt(39 / 40), rel=0.01)
    assert lowest == pytest.approx(0.5 / np.sqrt(0.51 * (0.5 + 0.01 / 39)), abs=0.002)
    sets = {k: rng.standard_normal((100, 50)) for k in "ab"}
    assert experiment_one.right_sets(sets) == pytest.approx(0.5, abs=0.12)
    assert experiment_one.right_sets(sets | {"b": sets["b"] + 2.0}) == 1.0


@pytest.mark.slow
def test_the_slide_rig_turns_the_lowest_correlation_from_across_the_motion_to_the_joint() -> None:
    found = {s: experiment_four.trials(5, s, "bolted", records=3) for s in experiment_four.STATES}

    def off(trial: experiment_four.Trial, direction: float, *, relative: bool = False) -> float:
        turn = axial_difference(trial.lowest(relative=relative).mean, direction)
        return abs(float(np.degrees(turn)))

    for tight, finger, loose in zip(*found.values(), strict=True):
        assert max(off(t, np.pi / 2 - t.angle) for t in (tight, finger)) < 2.0
        assert off(loose, 0.0) < 15.0
        assert off(loose, np.pi / 2, relative=True) < 5.0
    screw = [off(t, 0.0) for t in experiment_four.trials(5, LOOSE, "loose", records=3)]
    assert np.sqrt(np.mean(np.square(screw))) > 25.0


def test_modes_and_pin_bring_the_healthy_directions_to_the_printed_ones() -> None:
    shaken, linear, turns, rigid = ShakenArm(vera_on_shaker()), LinearArm(vera_on_shaker()), [], []
    for theta2, phi, _ in shaken_vera.printed_healthy():
        _, c, _ = shaken.at([0.0, theta2]).covariances(PROXIMAL, 1)
        turns.append(axial_difference(np.arctan2(c[1], c[0]) + np.pi / 2, phi))
        column = linear.at([0.0, theta2]).kinematic[:, 0]
        rigid.append(shaken_vera.from_y(float(np.arctan2(column[1], column[0])) + np.pi / 2))
    assert np.degrees(np.sqrt(np.mean(np.square(turns)))) < 12.0
    np.testing.assert_allclose(rigid, [29, 41, 62, 76, 119], atol=0.5)


@pytest.mark.slow
def test_vera_on_its_shaker_is_no_worse_than_printed() -> None:
    cases = {state: measured_case(7, state, records=8) for state in (TIGHT, FINGER, LOOSE, PLAY)}
    shaken = ShakenArm(vera_on_shaker())
    for case in cases[TIGHT]:
        variance, c, s = shaken.at([0.0, case.theta2]).covariances(PROXIMAL, 1)
        room = max(case.lowest.high - case.lowest.low, np.radians(6.0))
        closed = float(np.arctan2(c[1], c[0]) + np.pi / 2)
        assert abs(axial_difference(case.lowest.mean, closed)) < room
        largest = np.sqrt(c @ np.linalg.solve(s, c) / variance)
        assert case.maximum.mean == pytest.approx(largest, abs=0.05)
    for state, direction, most in (
        (LOOSE, shaken_vera.LOOSE_DIRECTION, 20.5),
        (PLAY, shaken_vera.PLAY_DIRECTION, 16.0),
    ):
        pairs = zip(cases[state], cases[TIGHT], strict=True)
        errors = [shaken_vera.direction_errors(f, n, direction) for f, n in pairs]
        assert np.median(np.sqrt(np.mean([e.lowest**2 for e in errors], axis=0))) <= most
        # Where the fault changes the transmission by more than a tenth, the change points at it.
        large = [e.change for e in errors if e.change_size > 0.1]
        assert len(large) >= 4 and shaken_vera.rms_over_poses(large).mean < 10.0
    for tight, finger in zip(cases[TIGHT], cases[FINGER], strict=True):
        assert finger.index(tight).mean <= 0.055  # low preload is no alarm
    loose = [f.index(n).mean for f, n in zip(cases[LOOSE], cases[TIGHT], strict=True)]
    assert sum(value > 0.11 for value in loose) >= 3
    again = measured_case(7, PLAY, records=3)
    for old, new in zip(cases[PLAY], again, strict=True):
        for a, b in zip(old.measurements[:3], new.measurements, strict=True):
            np.testing.assert_array_equal(a.tool, b.tool)


@pytest.mark.parametrize(("experiment", "right"), [("Five", 4), ("Six", 5)])
def test_printed_directions_need_all_poses(experiment: str, right: int) -> None:
    told = printed_directions(experiment)
    assert pair_count(told) == (right, 9)  # 122 and 302 degrees are half a turn apart
    assert named(told) == SLIDES[1]


def test_the_link_is_the_one_in_whose_frame_a_direction_is_fixed() -> None:
    theta2 = np.array(poses())
    assert named(0.4 - theta2) == SLIDES[0] and pair_count(0.4 - theta2)[0] == 0
    assert scatter(0.4 - theta2)[SLIDES[0]] == pytest.approx(0.0, abs=1e-9)
    assert named([0.4] * 5) == SLIDES[1] and pair_count([0.4] * 5)[0] == 9
    # Play in joint 2 moves the tool across link 2; the line of joint 1 lies half its angle on.
    assert scatter(np.full(5, np.pi / 2))[JOINTS[1]] == pytest.approx(0.0, abs=1e-9)
    assert scatter(np.pi / 2 - theta2 / 2)[JOINTS[0]] == pytest.approx(0.0, abs=1e-6)
    assert chance_of(np.radians(60.0), 0) > 0.95 and chance_of(np.radians(10.0), 0) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("order", ["outward", "inward", "bisection"])
def test_the_change_of_transmission_finds_most_links(order: str) -> None:
    runs = search(planar(3), "change of transmission", order, seed=3, arms=24)
    assert [r.link for r in runs] == [1 + k % 3 for k in range(24)]
    assert all(1 <= r.moves <= 2 for r in runs)
    # A blind guess names a third; half and more is beyond chance at 24 arms.
    assert np.mean([r.named == r.link for r in runs]) > 0.55
    for run in runs:
        if order == "outward" and run.named == run.link:
            assert run.moves == min(run.link, 2)


def test_a_stiff_arm_passes_on_what_the_rigid_one_does() -> None:
    arm, pose = planar(3), np.array([0.3, 0.8, -0.6])
    push = reactions(arm, pose).per_torque[1, :2]
    worst, whole = seat_drive(LinearArm(arm), pose, 2)
    assert whole == pytest.approx(np.linalg.norm(push), rel=0.06)
    assert worst == pytest.approx(np.linalg.svd(push, compute_uv=False)[-1], rel=0.06)


@pytest.mark.slow
def test_the_cube_tells_its_angle_and_the_resolver_lags_by_its_play() -> None:
    records = slide_records(1)
    found = angles(records, (2.0, 200.0))
    inside = (found.alpha >= 10) & (found.alpha <= 80)
    assert np.median(np.abs(found.by_rms - found.alpha)[inside]) < 1.0
    assert np.abs(found.by_line - found.alpha)[inside].max() < 2.0
    drive = RESOLVER_UNIT * np.array([0.0, 3.0, 1.0, -1.0])
    np.testing.assert_allclose(play(drive, 2 * RESOLVER_UNIT) / RESOLVER_UNIT, [0.0, 2.0, 2.0, 0.0])
