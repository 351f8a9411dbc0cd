"""The corrected model's file keeps names and has all that was found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap import Effect, Hypothesis, write_model
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.effects.elasticity import JointCompliance
from loose_env.gap.model.effects.joints import CoulombFriction, ViscousFriction
from loose_env.gap.model.effects.sensors import SensorBias, SensorGain
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.corrected_model import correction_code, step_for
from loose_env.recording import ModelColumns
from tests.gap.cases.effect_arms import PLANAR, SPATIAL, machine_of

RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
ARMS = {"planar": PLANAR, "spatial": SPATIAL}


def stepped(arm: str) -> NominalModel:
    """A machine with another step and integrator than the others."""
    spec = mujoco.MjSpec.from_string(ARMS[arm])
    spec.option.timestep, spec.option.integrator = 0.0005, RK4
    return NominalModel(spec)


def added(effect: Effect, values: Sequence[float]) -> Hypothesis:
    """The nominal model and an effect."""
    return Hypothesis().with_effects([(effect, np.array(values))])


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("kind", CATALOGUE)
def test_the_file_compiles_and_keeps_its_names_step_and_integrator(
    arm: str, kind: str, tmp_path: Path
) -> None:
    machine = stepped(arm)
    if not (found := candidates(machine, [kind])):
        assert kind == "base_compliance" and arm == "planar"  # its base turns as its first joint
        return
    effect = found[-1]
    corrected = added(effect, effect.starts[0])
    written = write_model(tmp_path / "model.xml", machine, corrected)
    assert written == [tmp_path / "model.xml"] and list(tmp_path.iterdir()) == written
    model = mujoco.MjModel.from_xml_path(str(written[0]))
    before, after = ModelColumns.of(machine.model).known, ModelColumns.of(model).known
    assert all(after[column] == meaning for column, meaning in before.items())
    assert model.opt.timestep == 0.0005 and model.opt.integrator == RK4
    assert effect.in_model or effect.where in correction_code(corrected)


def test_several_effects_stand_in_one_file(tmp_path: Path) -> None:
    machine = stepped("planar")
    wet = ViscousFriction(machine, "joint1"), np.array([1.5])
    others = JointCompliance(machine, "joint2"), CoulombFriction(machine, "joint3")
    corrected = Hypothesis().with_effects([wet, *((e, np.array(e.starts[0])) for e in others)])
    file = write_model(tmp_path / "model.xml", machine, corrected)[0]
    model = mujoco.MjModel.from_xml_path(str(file))
    spec = machine.fresh()
    for effect, own in corrected.pairs:
        effect.edit(spec, own)
    expected = spec.compile()
    assert np.allclose(model.body_mass, expected.body_mass, rtol=1e-5)
    assert np.allclose(model.dof_damping, expected.dof_damping, rtol=1e-5)
    assert np.allclose(model.actuator_gainprm, expected.actuator_gainprm, rtol=1e-5)
    assert model.nv == machine.model.nv + 1 and model.dof_frictionloss.any()


def test_what_readings_need_stands_in_the_code_and_runs() -> None:
    machine = machine_of("planar")
    gain, bias = SensorGain(machine, "encoder1"), SensorBias(machine, "shake")
    given = (ViscousFriction(machine, "joint1"), [1.0]), (gain, [1.25]), (bias, [0.5, 0.0, -0.5])
    lines = correction_code(Hypothesis().with_effects([(e, np.array(v)) for e, v in given]))
    data = mujoco.MjData(machine.model)
    data.sensor("encoder1").data[:] = 2.0
    exec(lines, {"data": data})  # as a user would
    assert data.sensor("encoder1").data[0] == 2.5
    assert np.array_equal(data.sensor("shake").data, [0.5, 0.0, -0.5])


def test_keyframes_keep_the_states_of_joints_and_actuators(tmp_path: Path) -> None:
    two = PLANAR.replace('<position name="servo2"', '<position name="servo2" timeconst="0.05"')
    key = 'name="home" qpos="0.1 0.2 0.3" qvel="1 2 3" ctrl="0.1 0.2 0.3" act="0.7"'
    xml = two.replace("</mujoco>", f"<keyframe><key {key}/></keyframe></mujoco>")
    machine = NominalModel(mujoco.MjSpec.from_string(xml))
    effects = JointCompliance(machine, "joint1"), CATALOGUE["actuator_lag"](machine, "servo1")
    pairs = [(effect, np.array(effect.starts[0])) for effect in effects]
    file = write_model(tmp_path / "model.xml", machine, Hypothesis().with_effects(pairs))[0]
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    for joint, position, speed in (("joint1", 0.1, 1), ("joint2", 0.2, 2), ("joint3", 0.3, 3)):
        assert data.joint(joint).qpos[0] == pytest.approx(position)
        assert data.joint(joint).qvel[0] == pytest.approx(speed)
    new = next(n for k in range(model.njnt) if (n := model.joint(k).name) not in machine.joints)
    assert data.joint(new).qpos[0] == 0.0
    # servo1's filter, which is new, begins at its command; servo2's keeps its state
    assert model.key_act[0] == pytest.approx([0.1, 0.7])


def test_meshes_and_files_that_are_included_are_taken_along(tmp_path: Path) -> None:
    home, out = tmp_path / "arm", tmp_path / "out"
    (home / "meshes").mkdir(parents=True)
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    home.joinpath("meshes", "corner.obj").write_text(corners)
    home.joinpath("motors.xml").write_text(
        '<mujocoinclude><actuator><motor name="m" joint="turn"/></actuator></mujocoinclude>'
    )
    file = home / "arm.xml"
    file.write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh name="c" file="corner.obj"/></asset>'
        '<worldbody><body name="link"><joint name="turn"/><geom type="mesh" mesh="c"/></body>'
        '</worldbody><include file="motors.xml"/></mujoco>'
    )
    machine = NominalModel(mujoco.MjSpec.from_file(str(file)))
    effect = ViscousFriction(machine, "turn")
    written = write_model(
        out / "model.xml", machine, added(effect, [2.0]), source=file, notes=["a -- b"]
    )
    assert [p.relative_to(out).as_posix() for p in written] == ["model.xml", "meshes/corner.obj"]
    for path in (home / "meshes" / "corner.obj", home / "motors.xml", file):
        path.unlink()
    model = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    assert model.dof_damping[0] == 2.0 and model.nmesh == 1 and model.actuator("m").id == 0


def test_an_effect_that_changes_a_name_is_refused_and_leaves_no_file(tmp_path: Path) -> None:
    class Renaming(ViscousFriction):
        kind = "renaming"

        def edit(self, spec: mujoco.MjSpec, values: np.ndarray) -> None:
            spec.sensor("encoder1").name = "other"

    machine = machine_of("planar")
    with pytest.raises(InvalidData, match=r"sensor\.encoder1"):
        write_model(tmp_path / "model.xml", machine, added(Renaming(machine, "joint1"), [1.0]))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("late", "parts"), [(0.02, 1), (0.0011, 1), (0.0004, 4), (1e-5, 8)])
def test_what_is_shorter_than_a_step_is_written_with_a_finer_one(late: float, parts: int) -> None:
    machine = machine_of("planar")
    delay = CATALOGUE["command_delay"](machine, "all")
    assert step_for(machine, added(delay, [late])) == pytest.approx(0.001 / parts)
