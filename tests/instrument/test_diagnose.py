"""Sessions are diagnosed: what is loose, what was not tested, what is wrong with a record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.instrument import DiagnoseSettings, Diagnosis, diagnose, read_diagnosis, trend
from loose_env.recording import Recording, Run
from scripts.example_recording import LOOSE, loose_arm

ACC = "tool_acc"


@pytest.fixture(scope="module")
def loose(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return loose_arm(tmp_path_factory.mktemp("loose") / "recording", reference=True)


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return loose_arm(tmp_path_factory.mktemp("healthy") / "recording", loose=False)


@pytest.fixture(scope="module")
def found(loose: Recording) -> Diagnosis:
    return diagnose(loose, DiagnoseSettings(reference=False))


def sensor(run: Run) -> str:
    return next(name for name, values in run.sensors.items() if values.ndim == 2)


def changed(recording: Recording, how: Callable[[Run], Run]) -> Recording:
    runs = [how(run) if run.condition == "suspect" else run for run in recording.runs]
    return replace(recording, runs=tuple(runs))


def test_a_loose_link_is_placed_with_its_direction(found: Diagnosis) -> None:
    link, direction, _ = LOOSE
    assert found.verdict == "loose" and found.places[0].at == link
    assert found.places[0].kind == "structural_looseness"
    cosine = abs(np.dot(found.places[0].direction or (0, 0, 0), direction))
    assert np.degrees(np.arccos(min(cosine, 1.0))) < 15
    assert sum(place.probability for place in found.places) == pytest.approx(1, abs=0.01)


def test_a_reference_says_what_rose(loose: Recording) -> None:
    beside = diagnose(loose)
    assert beside.reference and beside.verdict == "loose" and beside.places[0].at == LOOSE[0]
    assert beside.evidence["top_db"] > 10 and any("dB" in words for words in beside.reasons)


def test_a_healthy_arm_is_tight_where_it_was_tested(healthy: Recording) -> None:
    quiet = diagnose(healthy)
    assert quiet.verdict == "tight" and not quiet.settled
    verdicts = {place.verdict for place in quiet.places}
    assert verdicts == {"tight", "not tested"}
    assert all(place.tested >= 0.95 for place in quiet.places if place.verdict == "tight")
    assert all(place.why for place in quiet.places)
    assert quiet.untested and "not tested" in quiet.headline


def test_a_result_is_read_back_and_comes_again(
    loose: Recording, found: Diagnosis, tmp_path: Path
) -> None:
    assert read_diagnosis(found.write(tmp_path / "result.json")).places == found.places
    again = diagnose(loose, DiagnoseSettings(reference=False))
    assert again.places == found.places and again.evidence == found.evidence


def test_an_accelerometer_that_was_started_later_is_set_right(
    loose: Recording, found: Diagnosis
) -> None:
    def later(run: Run) -> Run:
        rows = round(0.22 / float(np.median(np.diff(run.time))))
        name, count = sensor(run), len(run.time) - rows
        cut = {n: v[rows:] if n == name else v[:count] for n, v in run.sensors.items()}
        return replace(
            run,
            time=run.time[:count],
            sensors=cut,
            controls={n: v[:count] for n, v in run.controls.items()},
            torques={n: v[:count] for n, v in run.torques.items()},
        )

    late = diagnose(changed(loose, later), DiagnoseSettings(reference=False))
    assert any("0.22 s early" in remark for remark in late.remarks)
    assert late.places[0].at == found.places[0].at
    assert late.evidence["rhythm"] == pytest.approx(found.evidence["rhythm"], abs=0.1)
    assert not any("s early" in remark or "s late" in remark for remark in found.remarks)


def test_a_striking_cable_is_no_knock(healthy: Recording) -> None:
    rng = np.random.default_rng(4)

    def struck(run: Run) -> Run:
        name = sensor(run)
        values = run.sensors[name].copy()
        for at in rng.integers(0, len(values) - 60, 24):
            ring = np.exp(-np.arange(60) / 8) * np.sin(np.arange(60) * 2.2)
            values[at : at + 60] += 30 * ring[:, None] * rng.normal(size=3)
        return replace(run, sensors={**run.sensors, name: values})

    quiet = diagnose(changed(healthy, struck))
    assert quiet.verdict in ("tight", "open") and "knocks:" not in quiet.headline
    assert any("does not repeat" in remark for remark in quiet.remarks)


def cut(run: Run) -> Run:
    return run.part(slice(0, 1400))


def silent(run: Run) -> Run:
    name = sensor(run)
    return replace(run, sensors={**run.sensors, name: 0 * run.sensors[name] + 9.81})


def clipped(run: Run) -> Run:
    name = sensor(run)
    return replace(run, sensors={**run.sensors, name: np.clip(run.sensors[name], -10, 3)})


def still(run: Run) -> Run:
    held = {n: 0 * v + v[0] for n, v in run.sensors.items() if v.ndim == 1}
    return replace(run, sensors={**run.sensors, **held})


def swapped(run: Run) -> Run:
    first, second = [n for n, v in run.sensors.items() if v.ndim == 1][:2]
    sensors = dict(run.sensors)
    sensors[first], sensors[second] = sensors[second], sensors[first]
    return replace(run, sensors=sensors)


def opposite(run: Run) -> Run:
    name = next(n for n, v in run.sensors.items() if v.ndim == 1)
    return replace(run, sensors={**run.sensors, name: -run.sensors[name]})


def bare(run: Run) -> Run:
    return replace(run, sensors={n: v for n, v in run.sensors.items() if v.ndim == 1})


@pytest.mark.parametrize(
    ("how", "says"),
    [
        (cut, "the machine stopped"),
        (silent, "is constant"),
        (clipped, "at its limit"),
        (still, "no joint moves"),
        (swapped, "follows the command of"),
        (opposite, "opposite sign"),
        (bare, "no column"),
    ],
)
def test_a_record_that_cannot_be_used_is_said(
    healthy: Recording, how: Callable[[Run], Run], says: str
) -> None:
    refused = diagnose(changed(healthy, how))
    assert refused.verdict == "refused" and refused.remedy
    assert any(says in words for words in (refused.headline, *refused.remarks))
    assert all(place.verdict == "not tested" for place in refused.places)


def test_g_is_taken_as_g_and_two_runs_are_too_few(loose: Recording, found: Diagnosis) -> None:
    def in_g(run: Run) -> Run:
        name = sensor(run)
        return replace(run, sensors={**run.sensors, name: run.sensors[name] / 9.81})

    alone = replace(loose, runs=tuple(r for r in loose.runs if r.condition == "suspect"))
    same = diagnose(changed(alone, in_g))
    assert same.places[0].at == found.places[0].at
    assert any("logged in g" in remark for remark in same.remarks)
    few = diagnose(replace(alone, runs=alone.runs[:2]))
    assert few.verdict == "open" and "2 of 2 runs" in few.headline
    assert few.remedy.startswith("Record the runs")


def test_a_change_is_told_and_stays(healthy: Recording, loose: Recording) -> None:
    again = replace(healthy, runs=healthy.runs)
    found = trend([healthy, again, loose, loose], ["April", "May", "June", "July"])
    assert [visit.alarm for visit in found.visits] == [False, False, True, True]
    assert found.since == "June" and found.headline.startswith("Changed since June")
    assert trend([healthy, again], ["April", "May"]).since is None
