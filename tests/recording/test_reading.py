"""What is read: columns of a model as arrays, the comparison they allow, real data."""

from __future__ import annotations

import pickle
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.recording import (
    JointSensors,
    joint_sensors,
    read_recording,
)
from tests.recording.conftest import ARM, COS, TIME, Folder, csv_text


def test_columns_become_arrays_of_the_elements_they_name(folder: Folder) -> None:
    text = csv_text(
        torque__reach=COS,
        sensor__tool__z=COS,
        sensor__tool__x=["1"] * 20,
        sensor__tool__y=["2e0"] * 20,
        ctrl__lift=COS,
    )
    entry = {"file": "run.csv", "excited": ["reach"], "pose": {"aside": 1}, "condition": "healthy"}
    recording = read_recording(folder({"run.csv": text}, runs=[entry]))
    (run,) = recording.runs
    assert (run.name, run.samples, run.condition, run.excited) == (
        "run.csv",
        20,
        "healthy",
        ("reach",),
    )
    assert run.pose == {"aside": 1.0}
    np.testing.assert_array_equal(run.time, TIME)
    np.testing.assert_array_equal(run.controls["lift"], np.cos(TIME))
    np.testing.assert_array_equal(run.torques["reach"], np.cos(TIME))
    expected = np.column_stack([np.ones(20), np.full(20, 2.0), np.cos(TIME)])
    np.testing.assert_array_equal(run.sensors["tool"], expected)
    assert list(run.sensors) == ["tool"]
    with pytest.raises(ValueError, match="read-only"):
        run.time[0] = 1.0


def test_a_recording_without_more_is_suspect_and_unexcited(folder: Folder) -> None:
    (run,) = read_recording(folder()).runs
    assert (run.excited, run.pose, run.condition, run.comparison) == ((), None, "suspect", "free")


@pytest.mark.parametrize(
    ("columns", "comparison"),
    [
        (("ctrl.lift", "sensor.angle"), "forward"),
        (("ctrl.lift", "torque.reach", "sensor.angle"), "forward"),
        (("torque.reach", "sensor.angle"), "inverse"),
        (("torque.reach",), "inverse"),
        (("sensor.angle",), "free"),
    ],
)
def test_the_columns_decide_the_comparison(
    folder: Folder, columns: tuple[str, ...], comparison: str
) -> None:
    text = csv_text(**{column: COS for column in columns})
    assert read_recording(folder({"run.csv": text})).runs[0].comparison == comparison


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_csv_of_other_programs_reads_the_same(folder: Folder, ending: str, mark: str) -> None:
    text = csv_text(sensor__angle=COS).replace("\n", ending) + ending
    text = mark + text.replace("sensor.angle", '"sensor.angle"')
    (run,) = read_recording(folder({"run.csv": text.encode()})).runs
    np.testing.assert_array_equal(run.sensors["angle"], np.cos(TIME))


def test_an_empty_cell_and_nan_are_missing_samples(folder: Folder) -> None:
    cells = [*COS[:5], "", "NaN", "nan", " ", *COS[9:]]
    (run,) = read_recording(folder({"run.csv": csv_text(sensor__angle=cells)})).runs
    missing = np.flatnonzero(np.isnan(run.sensors["angle"]))
    np.testing.assert_array_equal(missing, [5, 6, 7, 8])  # 20 %, which is allowed


def test_nulls_and_other_numbers_of_parquet_are_taken(folder: Folder, tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    angle = pa.array([None, *np.arange(19.0)], type=pa.float32())
    rate = pa.array([7] * 20, type=pa.int32()).dictionary_encode()
    table = pa.table({"time": pa.array(range(20)), "sensor.angle": angle, "sensor.rate": rate})
    file = folder() / "run.parquet"
    pq.write_table(table, file)
    (run,) = read_recording(folder(runs=[{"file": "run.parquet"}])).runs
    np.testing.assert_array_equal(run.time, np.arange(20.0))
    np.testing.assert_array_equal(run.sensors["angle"], [np.nan, *np.arange(19.0)])
    np.testing.assert_array_equal(run.sensors["rate"], np.full(20, 7.0))


def test_runs_and_model_may_lie_in_folders_of_the_recording(folder: Folder) -> None:
    files = {"cad/arm.xml": ARM, "day 1/run.csv": csv_text(sensor__angle=COS)}
    home = folder(files, model="cad/arm.xml", runs=[{"file": "./day 1/run.csv"}])
    recording = read_recording(str(home))
    assert recording.runs[0].name == "day 1/run.csv"
    assert recording.model_path == home / "cad" / "arm.xml"


def test_a_link_within_the_folder_is_followed(folder: Folder) -> None:
    home = folder(runs=[{"file": "latest.csv"}])
    home.joinpath("latest.csv").symlink_to("run.csv")
    assert read_recording(home).runs[0].name == "latest.csv"


def test_the_model_is_fresh_at_each_call_and_its_edits_stay_outside(folder: Folder) -> None:
    recording = read_recording(folder())
    edited = recording.spec()
    edited.joint("shoulder").frictionloss = 3.0
    assert edited.compile().dof_frictionloss[0] == 3.0
    assert recording.spec().compile().dof_frictionloss[0] == 0.0
    assert recording.model().njnt == 3


def test_another_model_may_take_the_place_of_the_nominal_one(
    folder: Folder, tmp_path: Path
) -> None:
    other = tmp_path / "other.xml"
    other.write_text(ARM.replace('mass="2"', 'mass="5"'))
    recording = read_recording(folder({"model.xml": "no model"}), model=str(other))
    assert recording.model().body("upper").mass[0] == 5.0
    renamed = tmp_path / "renamed.xml"
    renamed.write_text(ARM.replace('"angle"', '"winkel"'))
    with pytest.raises(InvalidData, match=r"run\.csv: column 'sensor\.angle'.*names nothing"):
        read_recording(folder(), model=renamed)


def test_a_recording_travels_to_another_process(folder: Folder) -> None:
    recording = read_recording(folder())
    twin = pickle.loads(pickle.dumps(recording))
    np.testing.assert_array_equal(twin.runs[0].sensors["angle"], np.cos(TIME))
    assert twin.model().nv == 3


def test_sensors_of_joints_are_found() -> None:
    assert joint_sensors(mujoco.MjModel.from_xml_string(ARM)) == {
        "shoulder": JointSensors(position=("angle",), velocity=("rate",)),
        "reach": JointSensors(position=("stroke",)),
        "aside": JointSensors(position=("aside_angle",)),
    }
