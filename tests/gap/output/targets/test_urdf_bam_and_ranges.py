"""URDF tags, parameter files of BAM, ranges for randomisation, and what all exports refuse."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import mujoco
import pytest

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap import (
    TARGETS,
    ExportSettings,
    NamedEffect,
    export_result,
    read_result,
    write_export,
)
from loose_env.gap.model.effects.friction import CoulombFriction, StribeckFriction
from tests.gap.cases.exported_result import ARM, LAG, write_result

URDF = """<?xml version="1.0"?>
<robot name="arm"><!-- kept --><link name="base"/><link name="upper"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="8" velocity="3"/><dynamics damping="9"/></joint></robot>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("targets") / "gap"
    write_result(place)
    return place


def test_a_copy_of_the_urdf_has_the_friction_that_mujoco_reads_from_it(
    tmp_path: Path, folder: Path
) -> None:
    arm = tmp_path / "arm.urdf"
    arm.write_text(URDF)
    effects = [e for e in read_result(folder).effects if e.where == "shoulder"]
    own = tmp_path / "gap"
    own.mkdir()
    replace(read_result(folder), effects=tuple(effects)).write(own / "result.json")
    own.joinpath("model.xml").write_text(folder.joinpath("model.xml").read_text())
    made = export_result(own, "urdf", urdf=arm)
    (file,) = write_export(tmp_path / "out", made)
    model = mujoco.MjModel.from_xml_path(str(file))
    assert model.dof_damping[0] == pytest.approx(0.4)
    assert model.dof_frictionloss[0] == pytest.approx(0.6)
    assert "kept" in file.read_text() and arm.read_text() == URDF
    assert not made.not_expressed


def test_without_a_urdf_each_joint_gets_a_tag_to_paste(folder: Path) -> None:
    made = export_result(folder, "urdf")
    root = ET.fromstring(made.files["dynamics.urdf.xml"])
    tags = {joint.get("name"): joint.find("dynamics") for joint in root.findall("joint")}
    shoulder = tags["shoulder"]
    assert shoulder is not None
    assert shoulder.attrib == {"damping": "0.4", "friction": "0.6"}
    assert any("backlash at wrist" in words for words in made.not_expressed)
    assert "backlash at wrist" in made.files["dynamics.urdf.xml"]


def test_other_urdfs_are_refused(tmp_path: Path, folder: Path) -> None:
    other = tmp_path / "other.urdf"
    for text, said in (
        (URDF.replace('"shoulder"', '"waist"'), "has no joint 'shoulder'"),
        ("<mujoco/>", "its first element is <mujoco>"),
        ("<robot", "is not XML"),
    ):
        other.write_text(text)
        with pytest.raises(InvalidData, match=said):
            export_result(folder, "urdf", urdf=other)


def test_bam_gets_the_simplest_of_its_models_that_has_the_friction(folder: Path) -> None:
    made = export_result(folder, "bam", ExportSettings(servo="xl330"))
    shoulder = json.loads(made.files["bam_shoulder.json"])
    assert shoulder == pytest.approx(
        {"armature": 0.01, "q_offset": 0, "friction_base": 0.6, "friction_viscous": 0.4}
        | {"model": "m1", "actuator": "xl330"}
    )
    elbow = json.loads(made.files["bam_elbow.json"])
    assert elbow["model"] == "m2" and elbow["armature"] == pytest.approx(0.004)
    assert (elbow["friction_base"], elbow["friction_stribeck"]) == pytest.approx((0.1, 0.06))
    assert (elbow["dtheta_stribeck"], elbow["alpha"]) == (0.25, 2.0)
    assert any("command_delay at all" in words for words in made.not_expressed)


def test_bam_loads_its_files_and_computes_the_friction_of_the_corrected_model(
    folder: Path, tmp_path: Path
) -> None:
    bam = pytest.importorskip(
        "bam.model", reason="better-actuator-models needs Python 3.12", exc_type=ImportError
    )
    made = export_result(folder, "bam", ExportSettings(servo="xl330"))
    write_export(tmp_path, made)
    shoulder = bam.load_model(str(tmp_path / "bam_shoulder.json"))
    assert shoulder.compute_frictions(0.0, 0.0, 1.0) == pytest.approx((0.6, 0.4))
    elbow = bam.load_model(str(tmp_path / "bam_elbow.json"))
    assert elbow.compute_frictions(0.0, 0.0, 0.0)[0] == pytest.approx(0.16)
    assert elbow.compute_frictions(0.0, 0.0, 5.0)[0] == pytest.approx(0.1)
    assert elbow.armature.value == pytest.approx(0.004)


def test_bam_needs_a_servo_and_friction(folder: Path, tmp_path: Path) -> None:
    for servo in ("", "mg996r"):
        with pytest.raises(InvalidSetting, match=r"give --servo with one of mx64, .*xl330"):
            export_result(folder, "bam", ExportSettings(servo=servo))
    write_result(tmp_path, (LAG,))
    with pytest.raises(InvalidSetting, match="names no effect that BAM has"):
        export_result(tmp_path, "bam", ExportSettings(servo="xl330"))


def test_ranges_are_the_intervals_with_units_and_attributes(folder: Path) -> None:
    whole = json.loads(export_result(folder, "ranges").files["ranges.json"])
    assert whole["format"] == "loose-ranges/1"
    named = {(r["effect"], r["where"], r["parameter"]): r for r in whole["ranges"]}
    damping = named["viscous_friction", "shoulder", "damping"]
    assert damping["unit"] == "N·m·s/rad"
    assert (damping["low"], damping["high"]) == pytest.approx((0.27, 0.33))
    assert damping["mjcf"]["attribute"] == "joint/damping[0]"
    assert (damping["mjcf"]["low"], damping["mjcf"]["high"]) == pytest.approx((0.37, 0.43))
    gap = named["backlash", "wrist", "gap"]
    assert (gap["low"], gap["high"]) == pytest.approx((0.018, 0.022)) and gap["unit"] == "rad"
    parameters = sum(len(e.parameters) for e in read_result(folder).effects)
    assert len(named) == parameters + 1  # the delay of all actuators, for each of the two


def test_a_parameter_without_an_interval_is_listed(tmp_path: Path) -> None:
    result = write_result(tmp_path, ((CoulombFriction, "shoulder", (0.4,)),))
    bare = replace(result, effects=(replace(result.effects[0], interval_95={}),))
    bare.write(tmp_path / "result.json")
    made = export_result(tmp_path, "ranges")
    assert "coulomb_friction.shoulder.torque" in made.not_expressed[0]
    assert json.loads(made.files["ranges.json"])["ranges"] == []


@pytest.mark.parametrize("target", TARGETS)
def test_every_target_carries_or_lists_every_effect(folder: Path, target: str) -> None:
    made = export_result(folder, target, ExportSettings(servo="xl330"))
    listed = " ".join(made.not_expressed)
    carried = {
        "sysid": (), "ranges": (), "urdf": ("viscous", "coulomb"),
        "bam": ("viscous", "coulomb", "stribeck", "rotor"),
        "mjlab": ("viscous", "coulomb", "rotor", "actuator_gain", "command_delay"),
        "isaaclab": ("viscous", "coulomb", "rotor", "actuator_gain", "command_delay"),
    }[target]  # fmt: skip
    for effect in read_result(folder).effects:
        in_files = any(f"{effect.kind}.{effect.where}" in t for t in made.files.values())
        in_files |= any(f'"{effect.kind}"' in t for t in made.files.values())
        in_files |= target == "sysid" and effect.where == "all"
        assert effect.kind in listed or in_files or effect.kind.startswith(carried), effect


def test_results_that_cannot_be_exported_are_refused(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(UnknownName, match=r"no export to 'gazebo'; there are sysid, mjlab"):
        export_result(folder, "gazebo")
    with pytest.raises(InvalidData):
        export_result(tmp_path / "none", "ranges")
    text = folder.joinpath("result.json").read_text()
    tmp_path.joinpath("result.json").write_text(text)
    with pytest.raises(InvalidData, match="there is no corrected model"):
        export_result(tmp_path / "result.json", "urdf")
    tmp_path.joinpath("model.xml").write_text("<mujoco><worldbody>")
    with pytest.raises(InvalidData, match="does not compile"):
        export_result(tmp_path, "urdf")
    tmp_path.joinpath("result.json").write_text(text.replace("loose-gap/1", "loose-gap/7"))
    with pytest.raises(InvalidData, match="loose-gap/1"):
        export_result(tmp_path, "ranges")
    nothing = replace(read_result(folder), verdict="no_gap", effects=())
    nothing.write(tmp_path / "result.json")
    with pytest.raises(InvalidData, match=r"names no effect \(verdict 'no_gap'\)"):
        export_result(tmp_path, "ranges")


def test_friction_that_only_slides_have_is_no_matter_of_bam(tmp_path: Path) -> None:
    xml = ARM.replace('name="shoulder"', 'name="shoulder" type="slide"')
    effects = ((CoulombFriction, "shoulder", (2.0,)), (StribeckFriction, "elbow", (0.1, 1.5, 0.2)))
    write_result(tmp_path, effects, xml=xml)
    made = export_result(tmp_path, "bam", ExportSettings(servo="mx64"))
    assert list(made.files) == ["bam_elbow.json"]
    assert "coulomb_friction at shoulder (torque 2 N); BAM has no slides" in made.not_expressed


def test_friction_of_the_drives_torque_is_that_of_bams_directional_model(tmp_path: Path) -> None:
    result = write_result(tmp_path, (LAG,))
    load = NamedEffect(
        kind="load_friction",
        where="shoulder",
        parameters={"share": 0.2, "static_ratio": 1.5, "speed": 0.4},
        variant="stribeck",
        in_model=False,
    )
    replace(result, effects=(load,)).write(tmp_path / "result.json")
    made = export_result(tmp_path, "bam", ExportSettings(servo="xl330"))
    found = json.loads(made.files["bam_shoulder.json"])
    assert found["model"] == "m5" and not made.not_expressed
    assert (found["load_friction_motor"], found["load_friction_external"]) == (0.2, 0)
    assert found["load_friction_motor_stribeck"] == pytest.approx(0.1)
    assert (found["friction_stribeck"], found["dtheta_stribeck"]) == (0, 0.4)
    bam = pytest.importorskip(
        "bam.model", reason="better-actuator-models needs Python 3.12", exc_type=ImportError
    )
    model = bam.load_model_from_dict(found)
    assert model.compute_frictions(3.0, 1.0, 0.0)[0] == pytest.approx(0.2 + 0.3 * 3)
    assert model.compute_frictions(3.0, 1.0, 9.0)[0] == pytest.approx(0.2 + 0.2 * 3)
