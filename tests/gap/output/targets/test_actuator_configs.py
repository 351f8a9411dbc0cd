"""Actuator configurations for mjlab and Isaac Lab against their documented fields.

Neither package installs beside MuJoCo 4: their classes are stood for by classes with the fields of
`mjlab.actuator` 1.6 and `isaaclab.actuators` 2.3.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, make_dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from loose_env.gap import ExportSettings, NamedEffect, export_result
from tests.gap.cases.exported_result import ARM, LAG, Sized, write_result

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
    return Loaded(space["ACTUATORS"], text, "\n".join(made.not_expressed))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("configs") / "gap"
    write_result(place)
    return place


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
    effects: tuple[Sized, ...] = (LAG,)
    write_result(tmp_path, effects, xml=xml)
    found = load(tmp_path, "mjlab", monkeypatch).actuators[0]
    assert type(found).__name__ == "BuiltinMotorActuatorCfg"
    assert (found.gear, found.effort_limit) == (5, 1)
    isaac = load(tmp_path, "isaaclab", monkeypatch)
    assert isaac.actuators["shoulder"].effort_limit == 5
    assert "the torque of servo1 per command, 5" in isaac.lost
    assert "actuator_lag at servo1 (time_constant 0.02 s)" in isaac.lost


def test_a_joint_with_two_actuators_is_said_to_be_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    xml = ARM.replace("</actuator>", '<motor name="extra" joint="elbow"/></actuator>')
    write_result(tmp_path, (LAG,), xml=xml)
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
