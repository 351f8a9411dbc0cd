"""Every effect of the catalogue on arms of several kinds: it fits in, writes out, vanishes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.errors import UnknownName
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.nominal_model import NominalModel
from tests.gap.cases.effect_arms import (
    ARMS,
    clock,
    commands,
    difference,
    machine_of,
    simulate,
    with_effect,
)

# As printed in the table of effects; part of the result format.
KINDS = [
    "viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag",
    "joint_compliance", "backlash", "structural_looseness", "link_flexibility", "link_mass",
    "link_com", "payload", "rotor_inertia", "actuator_gain", "actuator_lag", "command_delay",
    "encoder_offset", "sensor_misalignment", "sensor_gain", "sensor_bias", "sensor_delay",
    "base_tilt", "torque_ripple", "joint_spring", "load_friction", "asymmetric_friction",
    "torque_limit", "voltage_limit", "speed_limit",
    "dead_zone", "gravity_compensation", "torque_constant",
    "base_compliance", "gear_eccentricity", "sensor_quantisation",
]  # fmt: skip

CASES = [(arm, kind) for arm in ARMS for kind in KINDS]


def effects(arm: str, kind: str) -> list[Effect]:
    """Some effects of a kind: at the first and last place and one between, in every variant."""
    machine = machine_of(arm)
    found = candidates(machine, [kind])
    if not found:
        assert (arm, kind) in (("so101", "sensor_misalignment"), ("planar", "base_compliance"))
    places = list(dict.fromkeys(effect.where for effect in found))
    kept = {places[k] for k in (0, len(places) // 2, -1)} if places else set()
    return [effect for effect in found if effect.where in kept]


def names(model: mujoco.MjModel, what: str, count: int) -> list[str]:
    return [getattr(model, what)(k).name for k in range(count)]


def test_the_catalogue_has_the_kinds_of_the_result_format() -> None:
    assert list(CATALOGUE) == KINDS
    assert all(effect.kind == kind for kind, effect in CATALOGUE.items())
    for arm in ARMS:  # and every candidate is told from the others
        every = candidates(machine_of(arm))
        assert len({repr(effect) for effect in every}) == len(every)


@pytest.mark.parametrize(("arm", "kind"), CASES)
def test_what_a_recording_names_stays_where_it_was(arm: str, kind: str) -> None:
    for effect in effects(arm, kind):
        machine = effect.machine
        for change in (effect.edit, effect.export):
            spec = machine.fresh()
            change(spec, np.array(effect.starts[0]))
            model, nominal = spec.compile(), machine.model
            assert model.nu == nominal.nu
            assert names(model, "actuator", model.nu) == list(machine.actuators)
            assert names(model, "sensor", model.nsensor) == list(machine.sensors)
            joints = names(model, "joint", model.njnt)
            assert [name for name in joints if name in machine.joints] == list(machine.joints)
            assert model.njnt == nominal.njnt + effect.adds_motion
            assert nominal.nsite == model.nsite - (kind == "sensor_misalignment") * (
                change == effect.export
            )
            # An offset moves the zero of the coordinate, nothing else moves at rest.
            before, after = mujoco.MjData(nominal), mujoco.MjData(model)
            mujoco.mj_kinematics(nominal, before)
            mujoco.mj_kinematics(model, after)
            for name in names(nominal, "site", nominal.nsite):
                assert np.allclose(before.site(name).xpos, after.site(name).xpos, atol=1e-9)
                assert np.allclose(before.site(name).xmat, after.site(name).xmat, atol=1e-9)


@pytest.mark.parametrize(("arm", "kind"), CASES)
def test_the_written_model_does_what_the_simulation_does(arm: str, kind: str) -> None:
    for effect in effects(arm, kind):
        machine = effect.machine
        time = clock(machine)
        for start in effect.starts[-2:]:
            values = np.array(start)
            spec = machine.fresh()
            effect.export(spec, values)
            written = mujoco.MjModel.from_xml_string(spec.to_xml())
            simulated = with_effect(machine, effect, values)
            assert all(np.isfinite(column).all() for column in simulated.values())
            if not effect.in_model:
                continue
            # A reading that comes late shows 0 before the first one in MuJoCo.
            begin = (
                2 + round(start[0] / machine.model.opt.timestep) if kind == "sensor_delay" else 0
            )
            readings = simulate(written, commands(machine, time))
            # The file keeps six digits, also of turns; springs and impacts enlarge what is lost.
            tolerance = 2e-3 if effect.adds_motion else 2e-5
            for name, column in simulated.items():
                scale = max(float(np.abs(column).max()), 1e-2)
                off = np.abs(column - readings[name])[begin:].max()
                # MuJoCo holds what a lagging drive has at the beginning of a step, not its mean.
                held = kind == "actuator_lag"
                late = 0.5 * float(np.abs(np.diff(column, axis=0)).max()) if held else 0.0
                assert off < tolerance * scale + late, (effect, name)


@pytest.mark.parametrize(("arm", "kind"), CASES)
def test_where_there_is_nothing_the_nominal_model_is_left(arm: str, kind: str) -> None:
    for effect in effects(arm, kind):
        if effect.null_values is None:
            assert kind in (
                "stribeck_friction", "joint_compliance", "backlash", "structural_looseness",
                "link_flexibility", "torque_limit", "voltage_limit", "speed_limit",
                "base_compliance", "sensor_quantisation", "load_friction",
            )  # fmt: skip
            continue
        machine = effect.machine
        assert len(effect.null_values) == len(effect.parameters)
        nominal = simulate(machine.model, commands(machine, clock(machine)))
        values = np.array(effect.null_values)
        assert difference(nominal, with_effect(machine, effect, values)) < 1e-9
        spec = machine.fresh()
        effect.export(spec, values)
        written = mujoco.MjModel.from_xml_string(spec.to_xml())
        again = simulate(written, commands(machine, clock(machine)))
        assert difference(nominal, again) < 1e-5 * max(
            1.0, *(float(np.abs(column).max()) for column in nominal.values())
        )


@pytest.mark.parametrize(("arm", "kind"), CASES)
def test_fits_start_inside_the_bounds_where_something_shows(arm: str, kind: str) -> None:
    for effect in effects(arm, kind):
        machine = effect.machine
        nominal = simulate(machine.model, commands(machine, clock(machine)))
        assert effect.starts
        seen = 0.0
        for start in effect.starts:
            for parameter, value in zip(effect.parameters, start, strict=True):
                assert parameter.low <= value <= parameter.high, (effect, parameter)
            seen = max(seen, difference(nominal, with_effect(machine, effect, np.array(start))))
        # an offset shows in the recording's start only, a torque constant in a torque; a link that
        # turns about the vertical has no weight that acts
        elsewhere = ("encoder_offset", "torque_constant", "gravity_compensation")
        assert seen > 1e-5 or kind in elsewhere, effect


# nothing lies between two springs on one axis
@pytest.mark.filterwarnings("ignore:Inertia matrix is too close to singular")
@pytest.mark.parametrize("kind", KINDS)
def test_an_effect_is_there_twice_and_in_a_corrected_model_again(kind: str) -> None:
    for arm in ("planar", "spatial"):
        machine = machine_of(arm)
        if not (found := candidates(machine, [kind])):
            continue
        effect = found[-1]
        values = np.array(effect.starts[0])
        for change in (effect.edit, effect.export):
            spec = machine.fresh()
            change(spec, values)
            once = spec.compile()
            change(spec, values)
            twice = spec.compile()
            assert twice.njnt - once.njnt == once.njnt - machine.model.njnt
            assert twice.nbody - once.nbody == once.nbody - machine.model.nbody
        spec = machine.fresh()
        effect.export(spec, values)
        again = NominalModel(mujoco.MjSpec.from_string(spec.to_xml()))
        for other in candidates(again, [kind]):
            if other.where in (effect.where, f"{effect.where}_{kind}"):
                assert other.parameters and other.starts
                for change in (other.edit, other.export):
                    spec = again.fresh()
                    change(spec, np.array(other.starts[0]))
                    spec.compile()


def test_code_applies_what_the_model_cannot_express_whatever_sensors_are_called() -> None:
    spec = machine_of("planar").fresh()
    spec.sensor("encoder2").name = odd = "angle \"2\" of 'b'"
    machine = NominalModel(spec)
    for kind, where in (("sensor_gain", odd), ("sensor_bias", odd), ("sensor_bias", "shake")):
        effect = CATALOGUE[kind](machine, where)
        values = np.array(effect.starts[0])
        data = mujoco.MjData(machine.model)
        mujoco.mj_forward(machine.model, data)
        data.sensordata[:] = np.arange(1.0, 1 + machine.model.nsensordata)
        before = np.array(data.sensor(where).data)
        exec(effect.code(values), {"data": data})
        column = f"sensor.{where}"
        wanted = effect.read(np.zeros(1), {column: before}, values)[column]
        assert np.allclose(data.sensor(where).data, wanted)
        assert not np.allclose(before, wanted)
    assert CATALOGUE["base_tilt"](machine, "base").code(np.zeros(1)) == ""


def test_kinds_variants_and_locations_that_are_not_there_are_refused() -> None:
    machine = machine_of("planar")
    with pytest.raises(UnknownName, match=r"joint1"):
        CATALOGUE["viscous_friction"](machine, "link1")
    with pytest.raises(UnknownName, match="variant"):
        CATALOGUE["viscous_friction"](machine, "joint1", "command")
    with pytest.raises(UnknownName, match="joint_spring"):
        candidates(machine, ["rust"])
    assert CATALOGUE["sensor_misalignment"].locations(machine) == ("shake",)
    spec = machine.fresh()
    spec.option.gravity = [0, 0, 0]
    assert CATALOGUE["base_tilt"].locations(NominalModel(spec)) == ()


@pytest.mark.parametrize(
    ("kind", "where", "name", "end"),
    [
        ("joint_compliance", "joint2", "stiffness", "high"),
        ("link_flexibility", "link2", "stiffness", "high"),
        ("backlash", "joint2", "gap", "low"),  # without it the stops are a spring
        ("structural_looseness", "link2", "friction", "high"),
        ("stribeck_friction", "joint2", "torque", "low"),
    ],
)
def test_an_interval_that_reaches_the_limit_of_an_effect_includes_nothing(
    kind: str, where: str, name: str, end: str
) -> None:
    effect = CATALOGUE[kind](machine_of("planar"), where)
    parameters = effect.parameters
    number = [p.name for p in parameters].index(name)
    middle = np.array([np.sqrt(p.low * p.high) if p.log else 0.5 * (p.low + p.high)
                       for p in parameters])  # fmt: skip
    low, high = 0.9 * middle, 1.1 * middle
    assert not effect.interval_includes_null(low, high)
    if end == "high":
        high[number] = parameters[number].high
    else:
        low[number] = parameters[number].low
    assert effect.interval_includes_null(low, high)
