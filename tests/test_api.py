"""`loose_env.diagnose` and `loose_env.explain_gap` find what the commands find, in three lines."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import loose_env
from loose_env.api import DiagnosisReport, GapReport
from loose_env.doctor import examine
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap import read_result
from loose_env.instrument import read_diagnosis
from loose_env.recording import Recording, read_recording, write_recording
from scripts.suites.golden import GAPS, write_gap_recording
from tests.doctor.machine import record, with_sensors, xml
from tests.instrument.machine import short_session

KINDS = ("viscous_friction", "link_mass")


@pytest.fixture(scope="module")
def shaken(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return short_session(tmp_path_factory.mktemp("api") / "session")


@pytest.fixture(scope="module")
def diagnosed(shaken: Recording) -> DiagnosisReport:
    return loose_env.diagnose(shaken.folder)


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("api") / "arm"
    write_gap_recording(folder, **GAPS["forward, damping"])
    return folder


@pytest.fixture(scope="module")
def explained(moved: Path) -> GapReport:
    return loose_env.explain_gap(moved, kinds=list(KINDS), threads=1)


def test_a_diagnosis_shows_headline_table_and_what_to_do(diagnosed: DiagnosisReport) -> None:
    assert diagnosed.places[0].verdict in ("loose", "suspect")
    assert diagnosed.places[0].at == "fore"
    shown = repr(diagnosed).splitlines()
    assert shown[0] == diagnosed.headline
    assert any(diagnosed.result.remedy in line for line in shown)
    page = diagnosed._repr_html_()
    assert page.startswith(f"<p><strong>{diagnosed.headline}</strong></p>")
    assert page.count("<table>") == page.count("</table>") == 1


def test_results_have_the_findings_of_the_preflight(
    diagnosed: DiagnosisReport, explained: GapReport
) -> None:
    for report in (diagnosed, explained):
        assert report.result.preflight == examine(report.recording).findings


def test_a_diagnosis_is_written_as_the_command_writes_it(
    diagnosed: DiagnosisReport, tmp_path: Path
) -> None:
    pytest.importorskip("jinja2")
    pytest.importorskip("matplotlib")
    names = [path.name for path in diagnosed.write(tmp_path / "new")]
    assert sorted(names) == ["report.html", "result.json"]
    assert read_diagnosis(tmp_path / "new").headline == diagnosed.headline
    with pytest.raises(InvalidSetting, match="give another folder"):
        diagnosed.write(diagnosed.recording.folder)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InvalidSetting, match="is a file"):
        diagnosed.write(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.slow
def test_a_recording_in_memory_is_diagnosed_as_it_is(shaken: Recording, tmp_path: Path) -> None:
    part = dataclasses.replace(shaken, runs=shaken.runs[:1])
    said: list[str] = []
    found = loose_env.diagnose(part, say=said.append)
    assert len(found.result.runs) == 1 and found.result.verdict == "open"
    other = tmp_path / "renamed.xml"
    other.write_text(shaken.model_path.read_text().replace("bend_position", "bend_angle"))
    with pytest.raises(InvalidData, match=r"bend_position.*names nothing in the model"):
        loose_env.diagnose(part, model=other)
    with pytest.raises(InvalidSetting, match="there is no model"):
        loose_env.diagnose(part, model=tmp_path / "none.xml")
    same = tmp_path / "same.xml"
    same.write_bytes(shaken.model_path.read_bytes())
    assert loose_env.diagnose(part, model=same).recording.model_path == same


def test_a_gap_shows_headline_parameters_and_residual(explained: GapReport) -> None:
    assert explained.headline.startswith("The model lacks viscous friction (j1)")
    (effect,) = explained.effects
    assert effect.parameters["damping"] == pytest.approx(1.4 - 0.5, abs=0.09)
    assert "N·m·s/rad" in repr(explained) and "noise alone: 1" in repr(explained)
    shown = explained._repr_html_()
    assert f"<strong>{explained.headline}</strong>" in shown
    assert "viscous friction (j1)" in shown and "all together" in shown


def test_a_gap_is_written_with_its_corrected_model(
    explained: GapReport, moved: Path, tmp_path: Path
) -> None:
    written = [path.name for path in explained.write(tmp_path / "out", say=lambda _: None)]
    assert "model.xml" in written and written[-1] == "result.json"
    assert read_result(tmp_path / "out").effects[0].kind == "viscous_friction"
    with pytest.raises(InvalidSetting, match="would be overwritten"):
        explained.write(moved)


@pytest.mark.parametrize(
    ("call", "name"), [(loose_env.diagnose, "sure"), (loose_env.explain_gap, "threads")]
)
def test_what_cannot_be_used_is_said(call, name: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    wrong = f"{name}z"
    with pytest.raises(
        UnknownName, match=rf"no setting '{wrong}'; did you mean '{name}'\? The settings"
    ):
        call(tmp_path, **{wrong: 1})
    with pytest.raises(InvalidSetting, match=name):
        call(tmp_path, **{name: "a"})
    for given in (tmp_path / "none", tmp_path, 3):
        with pytest.raises(InvalidData):
            call(given)


@pytest.mark.parametrize("call", [loose_env.diagnose, loose_env.explain_gap])
def test_a_recording_in_degrees_is_refused(call, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    wrong = with_sensors(record(tmp_path / "right"), "q_", np.degrees)
    write_recording(tmp_path / "degrees", model_xml=xml(), runs=wrong.runs)
    said: list[str] = []
    with pytest.raises(
        InvalidData, match=r"3 errors of the recording, such as .*ignore_doctor=True"
    ):
        call(tmp_path / "degrees", say=said.append)
    assert said[0].startswith("error: sensor.q_base")


def test_names_of_the_package_are_loaded_when_they_are_used() -> None:
    assert {"diagnose", "explain_gap"} <= set(dir(loose_env))
    with pytest.raises(AttributeError, match="no attribute 'diagnos'"):
        loose_env.diagnos  # type: ignore[attr-defined]  # noqa: B018


def test_texts_of_a_model_are_escaped(diagnosed: DiagnosisReport) -> None:
    remark = "<script>alert(1)</script> & so on"
    result = dataclasses.replace(diagnosed.result, headline=remark)
    shown = DiagnosisReport(result=result, recording=diagnosed.recording)._repr_html_()
    assert "<script>" not in shown and "&lt;script&gt;" in shown


@pytest.mark.slow
def test_a_reread_recording_gives_the_same_diagnosis(
    shaken: Recording, diagnosed: DiagnosisReport
) -> None:
    again = loose_env.diagnose(read_recording(shaken.folder))
    assert again.result.places == diagnosed.result.places
