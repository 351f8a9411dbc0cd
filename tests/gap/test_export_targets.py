"""Results for other tools: mujoco.sysid, mjlab, Isaac Lab, URDF, USD, BAM, ranges.

Neither mjlab nor Isaac Lab installs beside MuJoCo 4: their classes are stood for by classes with
the documented fields of `mjlab.actuator` 1.6 and `isaaclab.actuators` 2.3.
"""

from __future__ import annotations

import json
import re
import runpy
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field, make_dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
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
from loose_env.gap.model.effects.joints import CoulombFriction, StribeckFriction
from loose_env.recording import CommandTiming
from tests.gap.cases.exported_result import ARM, LAG, write_result

SERVO = ExportSettings(servo="xl330")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("targets") / "gap"
    write_result(place)
    return place


def bam_package() -> Any:
    return pytest.importorskip(
        "bam.model", reason="better-actuator-models needs Python 3.12", exc_type=ImportError
    )


_MJLAB = {
    "target_names_expr": ..., "armature": None, "frictionloss": None, "viscous_damping": None,
    "delay_min_lag": 0, "delay_max_lag": 0, "delay_hold_prob": 0.0, "delay_update_period": 0,
}  # fmt: skip
_ISAACLAB = {
    "joint_names_expr": ..., "effort_limit": None, "velocity_limit": None, "effort_limit_sim": None,
    "velocity_limit_sim": None, "stiffness": ..., "damping": ..., "armature": None,
    "friction": None, "dynamic_friction": None, "viscous_friction": None,
}  # fmt: skip
CLASSES: dict[str, dict[str, dict[str, Any]]] = {
    "mjlab.actuator": {
        "BuiltinPositionActuatorCfg": _MJLAB
        | {"stiffness": ..., "damping": ..., "effort_limit": None},
        "BuiltinVelocityActuatorCfg": _MJLAB | {"damping": ..., "effort_limit": None},
        "DcMotorActuatorCfg": _MJLAB
        | {"stiffness": ..., "damping": ..., "effort_limit": float("inf")}
        | {"saturation_effort": ..., "velocity_limit": ...},
        "BuiltinMotorActuatorCfg": _MJLAB | {"effort_limit": ..., "gear": 1.0},
    },
    "isaaclab.actuators": {
        "ImplicitActuatorCfg": _ISAACLAB,
        "IdealPDActuatorCfg": _ISAACLAB,
        "DCMotorCfg": _ISAACLAB | {"saturation_effort": ...},
        "DelayedPDActuatorCfg": _ISAACLAB | {"min_delay": 0, "max_delay": 0},
        "BamActuatorCfg": dict.fromkeys(("joint_names_expr", "motor", "kp_fw", "vin"), ...)
        | {"armature": None, "min_delay": 0, "max_delay": 0},
        "BamMotorCfg": dict.fromkeys(
            (
                "model",
                "kt",
                "resistance",
                "error_gain",
                "max_current",
                "friction_base",
                "friction_viscous",
            ),
            ...,
        )
        | {"friction_stribeck": 0.0, "dtheta_stribeck": 1.0, "alpha": 1.0},
    },
}
"""Module -> class -> field with its default; an ellipsis where there is none."""


@dataclass
class Loaded:
    actuators: Any
    text: str
    lost: str = field(default="")


def load(folder: Path, target: str, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> Loaded:
    """Export, and run what was written against the documented classes."""
    for module, classes in CLASSES.items():
        stand_in = ModuleType(module)
        for name, fields in classes.items():
            given = [
                (n, Any) if d is ... else (n, Any, field(default=d)) for n, d in fields.items()
            ]
            setattr(stand_in, name, make_dataclass(name, given, kw_only=True))
        monkeypatch.setitem(sys.modules, module.split(".")[0], ModuleType(module.split(".")[0]))
        monkeypatch.setitem(sys.modules, module, stand_in)
    made = export_result(folder, target, ExportSettings(**settings))
    (text,) = made.files.values()
    space: dict[str, Any] = {}
    exec(compile(text, target, "exec"), space)
    found = space["ACTUATORS"] if "ACTUATORS" in space else space["actuators"]
    return Loaded(found, text, "\n".join(made.not_expressed))


def test_isaaclab_gets_gains_limits_friction_inertia_and_delays_of_each_joint(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = load(folder, "isaaclab", monkeypatch).actuators
    assert list(found)[:2] == ["shoulder", "elbow"]
    shoulder, elbow, wrist = found["shoulder"], found["elbow"], found["wrist"]
    assert type(shoulder).__name__ == "DelayedPDActuatorCfg"
    assert (shoulder.stiffness, shoulder.damping, shoulder.effort_limit) == (40, 2, 8)
    assert (shoulder.friction, shoulder.viscous_friction) == (0.6, 0.4)
    assert (shoulder.min_delay, shoulder.max_delay) == (5, 7)  # 10.8 to 13.2 ms in steps of 2 ms
    # gear 2 and gain 0.8: 4 x 0.8 x 10, 4 x 0.8 x 0.5, 2 x 0.8 x 3
    assert (elbow.stiffness, elbow.damping, elbow.effort_limit) == pytest.approx((32, 1.6, 4.8))
    assert elbow.armature == pytest.approx(0.004)
    assert (elbow.friction, elbow.dynamic_friction) == pytest.approx((0.16, 0.1))
    assert type(wrist).__name__ == "ImplicitActuatorCfg"
    assert (wrist.stiffness, wrist.damping, wrist.viscous_friction) == (0, 0, 0.02)


def test_mjlab_gets_the_same_by_its_own_fields(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shoulder, elbow = load(folder, "mjlab", monkeypatch).actuators
    assert shoulder.target_names_expr == ("shoulder",)
    assert (shoulder.frictionloss, shoulder.viscous_damping, shoulder.armature) == (0.6, 0.4, 0.01)
    assert (shoulder.delay_min_lag, shoulder.delay_max_lag) == (5, 7)
    assert (elbow.stiffness, elbow.effort_limit) == pytest.approx((32, 4.8))


def test_delays_are_counted_in_the_steps_of_the_trainer(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shoulder, _ = load(folder, "mjlab", monkeypatch, timestep=0.005).actuators
    assert (shoulder.delay_min_lag, shoulder.delay_max_lag) == (2, 3)
    coarse = load(folder, "isaaclab", monkeypatch, timestep=0.05)
    assert type(coarse.actuators["shoulder"]).__name__ == "IdealPDActuatorCfg"
    assert "the delay of servo1, 0.012 s: less than half a physics step of 0.05 s" in coarse.lost


@pytest.mark.parametrize("target", ["mjlab", "isaaclab"])
def test_what_cannot_be_expressed_is_listed_and_written(
    folder: Path, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = load(folder, target, monkeypatch)
    for words in ("backlash at wrist", "quadratic_drag at wrist", "sensor_gain at encoder2 (gain"):
        assert words in found.lost and words in found.text
    assert "stribeck_friction at elbow (" in found.lost  # at least the Stribeck speed
    assert "viscous_friction" not in found.lost and "command_delay" not in found.lost


def test_motors_are_configured_by_their_torque_per_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    servo = '<position name="servo1" joint="shoulder" kp="40" kv="2" forcerange="-8 8"/>'
    motor = '<motor name="servo1" joint="shoulder" gear="5" ctrlrange="-1 1"/>'
    xml = ARM.replace(servo, motor)
    write_result(tmp_path, (LAG,), xml=xml)
    found = load(tmp_path, "mjlab", monkeypatch).actuators[0]
    assert type(found).__name__ == "BuiltinMotorActuatorCfg"
    assert (found.gear, found.effort_limit) == (5, 1)
    isaac = load(tmp_path, "isaaclab", monkeypatch)
    assert isaac.actuators["shoulder"].effort_limit == 5
    assert "the torque of servo1 per command, 5" in isaac.lost
    assert "actuator_lag at servo1 (time_constant 0.02 s)" in isaac.lost
    two = ARM.replace("</actuator>", '<motor name="extra" joint="elbow"/></actuator>')
    write_result(tmp_path, (LAG,), xml=two)
    found = load(tmp_path, "mjlab", monkeypatch)
    assert len(found.actuators) == 1
    assert "joint elbow, because several actuators drive it (servo2, extra)" in found.lost


def test_a_voltage_limit_becomes_a_motor_with_a_torque_speed_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = write_result(tmp_path, (LAG,))
    limit = NamedEffect(
        kind="voltage_limit",
        where="servo2",
        parameters={"stall_torque": 1.5, "no_load_speed": 12.0},
    )
    replace(result, effects=(limit,)).write(tmp_path / "result.json")
    for target, kind in (("isaaclab", "DCMotorCfg"), ("mjlab", "DcMotorActuatorCfg")):
        found = load(tmp_path, target, monkeypatch).actuators
        motor = found["elbow"] if target == "isaaclab" else found[1]
        assert type(motor).__name__ == kind
        assert (motor.saturation_effort, motor.velocity_limit, motor.effort_limit) == (3, 6, 3)
        assert motor.stiffness == 40


@pytest.fixture(scope="module")
def sysid() -> Any:
    found = pytest.importorskip("mujoco.sysid")
    if not hasattr(found, "ParameterDict"):
        pytest.skip("mujoco.sysid lacks its own optional packages: pip install 'mujoco[sysid]'")
    return found


@pytest.fixture(scope="module")
def files(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sysid")
    write_export(out, export_result(folder, "sysid"))
    return out


@pytest.fixture(scope="module")
def parameters(files: Path, sysid: Any) -> Any:
    return runpy.run_path(str(files / "parameters.py"))["parameters"]()


def test_nominal_value_and_bounds_are_those_of_the_model_and_of_the_intervals(
    parameters: Any,
) -> None:
    damping = parameters["viscous_friction.shoulder.damping"]
    assert (damping.nominal[0], damping.value[0]) == pytest.approx((0.1, 0.4))
    assert damping.get_bounds() == (pytest.approx([0.37]), pytest.approx([0.43]))
    friction = parameters["coulomb_friction.shoulder.torque"]
    assert (friction.nominal[0], friction.value[0]) == pytest.approx((0.2, 0.6))
    assert parameters["command_delay.servo2.delay"].value[0] == pytest.approx(0.012)
    assert parameters["actuator_gain.servo2.gain"].nominal[0] == 1.0
    low, high = parameters.get_bounds()
    assert np.all(low <= parameters.as_vector()) and np.all(parameters.as_vector() <= high)


def test_modifiers_reproduce_the_corrected_model(parameters: Any, folder: Path, sysid: Any) -> None:
    path = str(folder / "model.xml")
    before = mujoco.MjModel.from_xml_path(path)
    after = sysid.apply_param_modifiers(parameters.copy(), mujoco.MjSpec.from_file(path))
    for name in ("dof_damping", "dof_dampingpoly", "dof_frictionloss", "dof_armature",
                 "actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "actuator_delay",
                 "sensor_delay"):  # fmt: skip
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=1e-5)


def test_other_values_reach_the_attributes_they_are_for(
    parameters: Any, folder: Path, sysid: Any
) -> None:
    own = parameters.copy()
    own["viscous_friction.shoulder.damping"].update_from_vector(np.array([0.7]))
    own["quadratic_drag.wrist.drag"].update_from_vector(np.array([0.09]))
    own["actuator_gain.servo2.gain"].update_from_vector(np.array([1.0]))
    own["command_delay.servo1.delay"].update_from_vector(np.array([0.04]))
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    model, nominal = sysid.apply_param_modifiers(own, spec), mujoco.MjModel.from_xml_string(ARM)
    dof = int(model.joint("shoulder").dofadr[0])
    assert model.dof_damping[dof] == pytest.approx(0.7)
    drag = model.dof_dampingpoly[int(model.joint("wrist").dofadr[0])]
    assert drag[0] == pytest.approx(0.09)
    servo = model.actuator("servo2").id
    np.testing.assert_allclose(
        model.actuator_gainprm[servo], nominal.actuator_gainprm[1], rtol=1e-6
    )
    np.testing.assert_allclose(model.actuator_forcerange[servo], [-3, 3], rtol=1e-6)
    assert model.actuator_delay[model.actuator("servo1").id] == pytest.approx(0.04)


def test_the_yaml_file_is_one_that_the_package_loads(
    parameters: Any, files: Path, sysid: Any
) -> None:
    loaded = sysid.ParameterDict.load_from_disk(files / "parameters.yaml")
    assert loaded.keys() == parameters.keys()
    np.testing.assert_allclose(loaded.as_vector(), parameters.as_vector())
    assert loaded.get_non_frozen_parameter_names() == parameters.get_non_frozen_parameter_names()


URDF = """<?xml version="1.0"?>
<robot name="arm"><!-- kept --><link name="base"/><link name="upper"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="8" velocity="3"/><dynamics damping="9"/></joint></robot>"""


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


def test_bam_gets_the_simplest_of_its_models_that_has_the_friction(folder: Path) -> None:
    made = export_result(folder, "bam", SERVO)
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
    bam = bam_package()
    write_export(tmp_path, export_result(folder, "bam", SERVO))
    shoulder = bam.load_model(str(tmp_path / "bam_shoulder.json"))
    assert shoulder.compute_frictions(0.0, 0.0, 1.0) == pytest.approx((0.6, 0.4))
    elbow = bam.load_model(str(tmp_path / "bam_elbow.json"))
    assert elbow.compute_frictions(0.0, 0.0, 0.0)[0] == pytest.approx(0.16)
    assert elbow.compute_frictions(0.0, 0.0, 5.0)[0] == pytest.approx(0.1)
    assert elbow.armature.value == pytest.approx(0.004)


def test_drivebam_gets_the_friction_of_bam_beside_the_motor_of_a_fit(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = load(folder, "drivebam", monkeypatch)
    fit = {"kt": 0.37, "resistance": 2.8, "error_gain": 0.003, "max_current": 1.75}
    found = loaded.actuators(fit | {"friction_base": 9.0}, kp_fw=200.0, vin=7.4)
    shoulder, elbow = found["shoulder"], found["elbow"]
    assert (shoulder.kp_fw, shoulder.vin, shoulder.armature) == (200, 7.4, 0.01)
    assert (shoulder.min_delay, shoulder.max_delay) == (5, 7)
    motor = shoulder.motor
    assert (motor.model, motor.kt, motor.max_current) == ("m1", 0.37, 1.75)
    assert (motor.friction_base, motor.friction_viscous) == pytest.approx((0.6, 0.4))
    assert elbow.motor.model == "m2" and elbow.motor.friction_stribeck == pytest.approx(0.06)
    assert "backlash at wrist" in loaded.lost and "command_delay" not in loaded.lost


def test_usd_gets_drives_and_joint_dynamics_per_degree(folder: Path) -> None:
    made = export_result(folder, "usd")
    text = made.files["joints.usda"]
    joints = dict(re.findall(r'^        over "(\w+)" \((.*?)^        }', text, re.M | re.S))
    assert list(joints)[:3] == ["shoulder", "elbow", "wrist"] and 'over "arm"' in text
    number = {
        name: {k.split(":", 1)[1]: float(v) for k, v in re.findall(r"float (\S+) = (\S+)", own)}
        for name, own in joints.items()
    }
    degree = np.pi / 180
    assert number["shoulder"] == pytest.approx(
        {"armature": 0.01, "friction": 0.6, "damping": 0.4 * degree}
        | {"angular:physics:stiffness": 40 * degree, "angular:physics:damping": 2 * degree}
        | {"angular:physics:maxForce": 8},
        rel=1e-5,
    )
    assert "DriveAPI" in joints["elbow"] and "DriveAPI" not in joints["wrist"]
    assert "the delay of servo1, 0.012 s" in made.not_expressed
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    stage = usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(text)
    drive = stage.GetPrimAtPath("/arm/joints/shoulder").GetAttribute(
        "drive:angular:physics:stiffness"
    )
    assert drive.Get() == pytest.approx(40 * degree)


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
    made = export_result(folder, target, SERVO)
    listed = " ".join(made.not_expressed)
    carried = {
        "sysid": (), "ranges": (), "urdf": ("viscous", "coulomb"),
        "bam": ("viscous", "coulomb", "stribeck", "rotor"),
        "mjlab": ("viscous", "coulomb", "rotor", "actuator_gain", "command_delay"),
        "isaaclab": ("viscous", "coulomb", "rotor", "actuator_gain", "command_delay"),
        "usd": ("viscous", "coulomb", "rotor", "actuator_gain"),
        "drivebam": ("viscous", "coulomb", "stribeck", "rotor", "command_delay"),
    }[target]  # fmt: skip
    for effect in read_result(folder).effects:
        in_files = any(f"{effect.kind}.{effect.where}" in t for t in made.files.values())
        in_files |= any(f'"{effect.kind}"' in t for t in made.files.values())
        in_files |= target == "sysid" and effect.where == "all"
        assert effect.kind in listed or in_files or effect.kind.startswith(carried), effect


@pytest.mark.parametrize("target", sorted(TARGETS))
def test_how_commands_act_is_told_in_every_export(tmp_path: Path, target: str) -> None:
    timing = CommandTiming(mode="linear", shift_s=-0.002)
    replace(write_result(tmp_path), commands={"servo1": timing}).write(tmp_path / "result.json")
    made = export_result(tmp_path, target, SERVO)
    (words,) = [each for each in made.not_expressed if "servo1 act along straight lines" in each]
    assert "-2 ms after" in words
    if target not in ("bam", "urdf"):
        assert any("servo1 act along" in text for text in made.files.values())


def test_results_that_cannot_be_exported_are_refused(tmp_path: Path, folder: Path) -> None:
    def refused(words: str, place: Path, target: str, *settings: ExportSettings, **urdf: Path):
        with pytest.raises((InvalidData, InvalidSetting, UnknownName), match=words):
            export_result(place, target, *settings, **urdf)

    refused(r"no export to 'gazebo'; there are sysid, mjlab", folder, "gazebo")
    refused("there is no result", tmp_path / "none", "ranges")
    for servo in ("", "mg996r"):
        given = ExportSettings(servo=servo)
        refused(r"give --servo with one of mx64, .*xl330", folder, "bam", given)
    other = tmp_path / "other.urdf"
    for text, said in (
        (URDF.replace('"shoulder"', '"waist"'), "has no joint 'shoulder'"),
        ("<mujoco/>", "its first element is <mujoco>"),
        ("<robot", "is not XML"),
    ):
        other.write_text(text)
        refused(said, folder, "urdf", urdf=other)
    text, file = folder.joinpath("result.json").read_text(), tmp_path / "result.json"
    file.write_text(text)
    refused("there is no corrected model", file, "urdf")
    tmp_path.joinpath("model.xml").write_text("<mujoco><worldbody>")
    refused("does not compile", tmp_path, "urdf")
    file.write_text(text.replace("loose-gap/1", "loose-gap/7"))
    refused("loose-gap/1", tmp_path, "ranges")
    replace(read_result(folder), verdict="no_gap", effects=()).write(file)
    refused(r"names no effect \(verdict 'no_gap'\)", tmp_path, "ranges")
    write_result(tmp_path, (LAG,))
    refused("names no effect that BAM has", tmp_path, "bam", SERVO)


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
    made = export_result(tmp_path, "bam", SERVO)
    found = json.loads(made.files["bam_shoulder.json"])
    assert found["model"] == "m5" and not made.not_expressed
    assert (found["load_friction_motor"], found["load_friction_external"]) == (0.2, 0)
    assert found["load_friction_motor_stribeck"] == pytest.approx(0.1)
    assert (found["friction_stribeck"], found["dtheta_stribeck"]) == (0, 0.4)
    bam = bam_package()
    model = bam.load_model_from_dict(found)
    assert model.compute_frictions(3.0, 1.0, 0.0)[0] == pytest.approx(0.2 + 0.3 * 3)
    assert model.compute_frictions(3.0, 1.0, 9.0)[0] == pytest.approx(0.2 + 0.2 * 3)
