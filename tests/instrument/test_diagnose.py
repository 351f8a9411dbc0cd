"""Sessions are diagnosed: what is loose, what was not tested, what is wrong with a record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from loose_env.arms import SIX_AXIS_SERVO_ARM
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument import (
    DiagnoseSettings,
    Diagnosis,
    PlanSettings,
    diagnose,
    plan,
    read_diagnosis,
    read_plan,
)
from loose_env.recording import Recording, Run
from tests.instrument.conftest import Play
from tests.instrument.machine import RATE, TWO, Truth, session

DIRECTION = (0.6, 0.0, 0.8)
LOOSE = Truth(seat="fore", direction=DIRECTION, mode_hz=40)


@pytest.fixture(scope="module")
def loose(play: Play) -> Recording:
    return play(LOOSE, reference=True)


@pytest.fixture(scope="module")
def healthy(play: Play) -> Recording:
    return play(Truth(mode_hz=40), seed=5)


@pytest.fixture(scope="module")
def found(loose: Recording) -> Diagnosis:
    return diagnose(loose, DiagnoseSettings(reference=False))


@pytest.fixture(scope="module")
def quiet(healthy: Recording) -> Diagnosis:
    return diagnose(healthy)


def changed(recording: Recording, how: Callable[[Run], Run]) -> Recording:
    runs = [how(run) if run.condition == "suspect" else run for run in recording.runs]
    return replace(recording, runs=tuple(runs))


def with_sensors(run: Run, **sensors: np.ndarray) -> Run:
    return replace(run, sensors={**run.sensors, **sensors})


def test_a_loose_seat_is_placed_with_its_direction(found: Diagnosis) -> None:
    top = found.places[0]
    assert found.verdict == "loose" and not found.reference
    assert top.name == "structural_looseness@fore" and top.verdict in ("loose", "suspect")
    assert np.degrees(np.arccos(min(1, abs(np.dot(top.direction or (0, 0, 0), DIRECTION))))) < 15
    assert sum(place.probability for place in found.places) == pytest.approx(1, abs=0.01)
    assert found.settled == (top.verdict == "loose") and top.words in found.headline.lower()


@pytest.mark.slow
def test_all_accelerometers_that_a_run_has_are_used(tmp_path: Path) -> None:
    (tmp_path / "two.xml").write_text(TWO)
    made, arm = plan(tmp_path / "two.xml", PlanSettings(poses=3))
    assert tuple(arm.accelerometers) == ("acc", "elbow_acc")
    both = session(tmp_path, made, arm, LOOSE)

    def told(keep: Callable[[int, Run], Run]) -> tuple[Diagnosis, float]:
        runs = tuple(keep(k, run) for k, run in enumerate(both.runs))
        found = diagnose(replace(both, runs=runs))
        place = found.place("structural_looseness@fore")
        way = abs(np.dot(place.direction or (0, 0, 0), DIRECTION))
        return found, float(np.degrees(np.arccos(min(1, way))))

    def without(run: Run, sensor: str) -> Run:
        return replace(run, sensors={n: v for n, v in run.sensors.items() if n != sensor})

    def clipped(run: Run) -> Run:
        return with_sensors(run, elbow_acc=np.clip(run.sensors["elbow_acc"], -10, 3))

    whole, off = told(lambda k, run: clipped(run) if k == 1 else run)
    alone, alone_off = told(lambda k, run: without(run, "elbow_acc"))
    moved, _ = told(lambda k, run: without(run, ("acc", "elbow_acc")[k % 2]))
    for found in (whole, alone, moved):
        assert found.verdict == "loose" and found.places[0].at == "fore" and len(found.runs) == 3
        assert all(run.used for run in found.runs)
    assert off <= alone_off + 1
    assert whole.places[0].probability >= alone.places[0].probability - 0.01
    assert any(r.startswith("run-02.parquet: elbow_acc is not used") for r in whole.remarks)
    unread = [with_sensors(r, turn_position=np.full(len(r.time), np.nan)) for r in both.runs]
    remarks = diagnose(replace(both, runs=tuple(unread))).remarks
    unused = [r.split(": ")[1] for r in remarks if "is not used" in r]
    assert unused == ["a channel holds no number"] * 3


def test_a_healthy_reference_says_what_rose(loose: Recording) -> None:
    beside = diagnose(loose)
    assert beside.reference and beside.verdict == "loose"
    assert beside.places[0].name == "structural_looseness@fore"
    assert beside.evidence["top_db"] > 10 and any("dB louder" in why for why in beside.reasons)
    own = [run for run in beside.runs if run.condition == "suspect"]
    assert all(len(run.healthy_lines) == len(run.lines) for run in own)


@pytest.mark.parametrize("joint", [pytest.param("turn", marks=pytest.mark.slow), "lift"])
def test_play_is_placed_in_its_joint(play: Play, joint: str) -> None:
    # Knocks of one loud pose agree with themselves at other times, as strikes do.
    told = diagnose(play(Truth(play=joint)))
    assert told.verdict == "loose" and told.places[0].name == f"backlash@{joint}"
    assert told.places[0].direction is None and told.places[0].verdict == "loose"


def test_a_rocking_base_is_no_link(play: Play) -> None:
    told = diagnose(play(Truth(rocks=4e-4)))
    assert told.verdict == "loose" and told.places[0].name == "structural_looseness@foot"
    assert told.places[0].direction is None
    assert "base on the ground" in told.headline and "Torque the bolts" in told.remedy


def test_a_payload_since_the_healthy_day_is_no_alarm(play: Play) -> None:
    told = diagnose(play(Truth(payload=1.2, mode_hz=40), reference=True))
    assert told.verdict == "tight" and told.reference
    assert told.evidence["even_db"] > 2  # lines of distortion rise with another payload, too


def test_a_healthy_arm_is_tight_where_it_was_tested(quiet: Diagnosis) -> None:
    assert quiet.verdict == "tight" and not quiet.settled
    assert {place.verdict for place in quiet.places} == {"tight", "not tested"}
    assert all(place.tested >= 0.95 for place in quiet.places if place.verdict == "tight")
    assert all(place.why and place.probability == 0 for place in quiet.places)
    assert "structural_looseness@column" in quiet.untested and "not tested" in quiet.headline
    assert "loose plan --known" in quiet.remedy


def test_a_result_is_read_back_and_comes_again(
    healthy: Recording, quiet: Diagnosis, tmp_path: Path
) -> None:
    read = read_diagnosis(quiet.write(tmp_path / "result.json"))
    assert read.to_json() == quiet.to_json() and read.places == quiet.places
    sweep = replace(healthy.runs[0], name="sweep.csv")  # planned beside the runs, and no run of it
    again = diagnose(replace(healthy, runs=(sweep, *healthy.runs)))
    assert replace(again, seconds=0.0) == replace(quiet, seconds=0.0)


@pytest.mark.parametrize(("fast", "whose"), [(0.006, "accelerometer"), (-0.02, "log")])
def test_a_clock_that_is_fast_is_set_right(
    loose: Recording, found: Diagnosis, fast: float, whose: str
) -> None:
    def drifted(run: Run) -> Run:
        if whose == "log":
            return replace(run, time=run.time * (1 + fast))
        late = run.time[0] + (run.time - run.time[0]) / (1 + fast)
        acc = [np.interp(late, run.time, axis) for axis in run.sensors["acc"].T]
        return with_sensors(run, acc=np.column_stack(acc))

    told = diagnose(changed(loose, drifted), DiagnoseSettings(reference=False))
    words = f"the {whose}'s clock is {100 * abs(fast):g} % {'fast' if fast > 0 else 'slow'}"
    assert sum(words in remark for remark in told.remarks) == len(told.runs)
    assert told.verdict == "loose" and told.places[0].name == found.places[0].name
    assert not any("clock" in remark for remark in found.remarks)


def test_a_loose_mount_of_the_accelerometer_is_named(play: Play) -> None:
    def rides(run: Run) -> Run:
        omega = 2 * np.pi * 240.0
        way = bilinear([2 * 0.06 * omega, omega**2], [1, 2 * 0.06 * omega, omega**2], fs=RATE)
        acc = run.sensors["acc"].copy()
        acc[:, 1] = acc[0, 1] + lfilter(*way, acc[:, 1] - acc[0, 1])
        return with_sensors(run, acc=acc)

    told = diagnose(changed(play(Truth(mode_hz=40), reference=True), rides))
    assert told.verdict == "open" and "mount may be loose: its y axis" in told.headline
    assert "accelerometer" in told.remedy


def test_an_accelerometer_that_was_started_later_is_set_right(
    loose: Recording, found: Diagnosis
) -> None:
    def later(run: Run) -> Run:
        acc, kept = run.sensors["acc"], run.part(slice(0, len(run.time) - 220))
        return with_sensors(kept, acc=acc[220:])

    late = diagnose(changed(loose, later), DiagnoseSettings(reference=False))
    assert any("0.22 s early" in remark for remark in late.remarks)
    assert late.places[0].at == found.places[0].at
    assert late.evidence["rhythm"] == pytest.approx(found.evidence["rhythm"], abs=0.1)
    assert not any("s early" in remark or "s late" in remark for remark in found.remarks)


def test_a_striking_cable_is_no_knock(healthy: Recording) -> None:
    rng = np.random.default_rng(4)

    def struck(run: Run) -> Run:
        values = run.sensors["acc"].copy()
        for at in rng.integers(0, len(values) - 60, 30):
            ring = np.exp(-np.arange(60) / 8) * np.sin(np.arange(60) * 2.2)
            values[at : at + 60] += 30 * ring[:, None] * rng.normal(size=3)
        return with_sensors(run, acc=values)

    told = diagnose(changed(healthy, struck))
    assert told.verdict in ("tight", "open") and "Something knocks" not in told.headline
    assert any("does not repeat" in remark for remark in told.remarks)


def cut(run: Run) -> Run:
    return run.part(slice(0, 1900))


def without(run: Run, start_s: float, end_s: float) -> Run:
    inside = (run.time - run.time[0] > start_s) & (run.time - run.time[0] < end_s)
    return with_sensors(
        run, **{n: np.where(inside.reshape(-1, *[1] * (v.ndim - 1)), np.nan, v)
                for n, v in run.sensors.items()},
    )  # fmt: skip


def still(run: Run) -> Run:
    return with_sensors(run, **{n: 0 * v + v[0] for n, v in run.sensors.items() if v.ndim == 1})


def exchanged(run: Run) -> Run:
    lift, bend = run.sensors["lift_position"], run.sensors["bend_position"]
    return with_sensors(run, lift_position=bend, bend_position=lift)


def opposite(run: Run) -> Run:
    return with_sensors(run, lift_position=-run.sensors["lift_position"])


@pytest.mark.parametrize(
    ("how", "says"),
    [
        (cut, "the machine stopped"),
        (lambda r: r.part(slice(None, None, 20)), "no band is left for what knocks"),
        (lambda r: with_sensors(r, acc=0 * r.sensors["acc"] + 9.81), "is constant"),
        (lambda r: with_sensors(r, acc=np.nan * r.sensors["acc"]), "holds no number"),
        (lambda r: with_sensors(r, acc=np.clip(r.sensors["acc"], -10, 3)), "at its limit"),
        (still, "no joint moves"),
        (lambda r: without(r, 2.6, 4.0), "rows are missing for 1.4 s"),
        (exchanged, "the column of lift follows the command of bend"),
        (opposite, "the column of lift has the opposite sign"),
        (lambda r: replace(r, sensors={"acc": r.sensors["acc"]}), "no column for turn_position"),
    ],
)
def test_a_record_that_cannot_be_used_is_said(
    healthy: Recording, how: Callable[[Run], Run], says: str
) -> None:
    refused = diagnose(changed(healthy, how))
    assert refused.verdict == "refused" and refused.remedy.endswith(".")
    assert any(says in words for words in (refused.headline, *refused.remarks, *refused.reasons))
    assert all(place.verdict == "not tested" for place in refused.places)


def test_missing_samples_and_a_short_cut_are_bridged(healthy: Recording, quiet: Diagnosis) -> None:
    gaps = np.arange(3000, 3400, 7)

    def holed(run: Run) -> Run:
        acc = run.sensors["acc"].copy()
        acc[gaps] = np.nan
        return with_sensors(run, acc=acc).part(slice(0, len(acc) - round((0.6 + 0.06) * RATE)))

    told = diagnose(changed(healthy, holed))
    assert told.verdict == "tight"
    # A period whose end is missing is not taken for a whole one.
    assert sum("3 of 4 periods are whole" in remark for remark in told.remarks) == 3
    for now, then in zip(told.runs, quiet.runs, strict=True):
        top = np.array(then.lines) > 0.3 * max(then.lines)
        np.testing.assert_allclose(np.array(now.lines)[top], np.array(then.lines)[top], rtol=0.05)


def test_the_longest_stretch_beside_missing_rows_is_judged(
    healthy: Recording, quiet: Diagnosis
) -> None:
    told = diagnose(changed(healthy, lambda run: without(run, 3.9, 4.0)))
    assert told.verdict == "tight"
    said = "2 of 4 periods are whole: rows are missing for 0.1 s"
    assert sum(said in remark for remark in told.remarks) == 3
    for now, then in zip(told.runs, quiet.runs, strict=True):
        top = np.array(then.lines) > 0.3 * max(then.lines)
        np.testing.assert_allclose(np.array(now.lines)[top], np.array(then.lines)[top], rtol=0.05)


def test_g_is_taken_as_g(healthy: Recording, quiet: Diagnosis) -> None:
    one = replace(healthy, runs=healthy.runs[:1])
    told = diagnose(changed(one, lambda r: with_sensors(r, acc=r.sensors["acc"] / 9.81)))
    assert any("logged in g" in remark for remark in told.remarks)
    np.testing.assert_allclose(told.runs[0].lines, quiet.runs[0].lines, rtol=1e-3, atol=1e-4)


def test_two_runs_are_too_few_and_say_what_to_do(healthy: Recording) -> None:
    few = diagnose(replace(healthy, runs=healthy.runs[:2]))
    assert few.verdict == "open" and "2 of 2 runs" in few.headline
    assert few.remedy.startswith("Record the runs") and "run-03.csv" in "".join(few.remarks)
    partly = diagnose(replace(healthy, runs=(*healthy.runs[:2], cut(healthy.runs[2]))))
    assert partly.verdict == "open" and "machine stopped" in partly.remedy


def test_a_healthy_session_in_other_poses_is_not_compared(healthy: Recording) -> None:
    def elsewhere(run: Run) -> Run:
        moved = {n: v + 0.3 * (v.ndim == 1) for n, v in run.sensors.items()}
        return replace(run, sensors=moved, condition="healthy")

    told = diagnose(replace(healthy, runs=(healthy.runs[0], elsewhere(healthy.runs[0]))))
    assert not told.reference and any("compared with none" in remark for remark in told.remarks)


def test_a_recording_without_its_plan_is_refused(healthy: Recording, tmp_path: Path) -> None:
    other, _ = plan(SIX_AXIS_SERVO_ARM, PlanSettings(poses=3))
    with pytest.raises(InvalidData, match="the plan is for the joints joint1"):
        diagnose(healthy, plan=other)
    with pytest.raises(InvalidData, match=r"there is no plan\.json"):
        read_plan(tmp_path)
    (tmp_path / "plan.json").write_text('{"format": "loose-plan/1"}')
    with pytest.raises(InvalidData, match="loose-plan/2"):
        read_plan(tmp_path)
    with pytest.raises(InvalidSetting, match=r"between 0\.5 and 1, got 0\.2"):
        DiagnoseSettings(sure=0.2)
