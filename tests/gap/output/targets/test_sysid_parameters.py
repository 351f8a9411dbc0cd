"""Named effects as a ParameterDict of mujoco.sysid, loaded by that package."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.gap import export_result, write_export
from tests.gap.cases.exported_result import ARM, write_result


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("sysid")
    write_result(place / "gap")
    write_export(place / "out", export_result(place / "gap", "sysid"))
    return place


@pytest.fixture(scope="module")
def sysid() -> Any:
    found = pytest.importorskip("mujoco.sysid")
    if not hasattr(found, "ParameterDict"):
        pytest.skip("mujoco.sysid lacks its own optional packages: pip install 'mujoco[sysid]'")
    return found


@pytest.fixture(scope="module")
def parameters(folder: Path, sysid: Any) -> Any:
    return runpy.run_path(str(folder / "out" / "parameters.py"))["parameters"]()


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
    path = str(folder / "gap" / "model.xml")
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
    spec = mujoco.MjSpec.from_file(str(folder / "gap" / "model.xml"))
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
    parameters: Any, folder: Path, sysid: Any
) -> None:
    loaded = sysid.ParameterDict.load_from_disk(folder / "out" / "parameters.yaml")
    assert loaded.keys() == parameters.keys()
    np.testing.assert_allclose(loaded.as_vector(), parameters.as_vector())
    assert loaded.get_non_frozen_parameter_names() == parameters.get_non_frozen_parameter_names()


def test_every_parameter_of_every_effect_is_there_and_those_without_modifier_are_listed(
    folder: Path,
) -> None:
    result = export_result(folder / "gap", "sysid")
    listed = " ".join(result.not_expressed)
    for name in ("backlash.wrist.gap", "stribeck_friction.elbow.speed", "sensor_gain.encoder2"):
        assert name in listed
        assert name in result.files["parameters.yaml"] and name in result.files["parameters.py"]
    assert "viscous_friction" not in listed
