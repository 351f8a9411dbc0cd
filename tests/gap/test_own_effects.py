"""Effects of one's own: torque terms, files of effects, tried step by step, and in one call."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap import (
    Effect,
    GapSettings,
    Hypothesis,
    JointEffect,
    Parameter,
    find_gap,
    read_effects,
    read_result,
    register,
    solve_gap,
    try_effect,
    write_gap,
    write_model,
)
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.corrected_model import correction_code
from loose_env.gap.runs import Channel, Trial
from loose_env.gap.simulator import Simulator
from loose_env.recording import Recording, Run, write_recording
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR, machine_of


@pytest.fixture(autouse=True)
def own_catalogue() -> Iterator[None]:
    before = dict(CATALOGUE)
    yield
    CATALOGUE.clear()
    CATALOGUE.update(before)


class OneTerm(JointEffect):
    """A term at one joint, of its own position and speed."""

    in_model = False
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter(name="size", unit="", low=-1e4, high=1e4, scale=1.0),)

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        return ((1.0,),)

    def torque(self, position: Array, speed: Array, values: Array) -> Array:
        found = np.zeros_like(position)
        k = self.machine.joint_number(self.where)
        found[..., k] = float(values[0]) * self.law(position[..., k], speed[..., k])
        return found

    def law(self, angle: Array, speed: Array) -> Array:
        raise NotImplementedError


class CubicSpring(OneTerm):
    kind = "cubic_spring"

    def law(self, angle: Array, speed: Array) -> Array:
        return -(angle**3)

    def torque_code(self, values: Array) -> str:
        k = self.machine.joint_number(self.where)
        return f"torque[{k}] -= {float(values[0])!r} * position[{k}] ** 3"


class LinearSpring(OneTerm):
    kind = "linear_spring"

    def law(self, angle: Array, speed: Array) -> Array:
        return -angle


STEP, COUNT = 0.001, 1200
RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
IMPLICIT = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
CHANNELS = (
    *(Channel(f"sensor.encoder{k}") for k in (1, 2, 3)),
    *(Channel("sensor.shake", axis) for axis in range(2)),
)
NOTHING = Hypothesis()


def machine(integrator: int = RK4, step: float = STEP) -> NominalModel:
    spec = mujoco.MjSpec.from_string(PLANAR)
    spec.option.timestep, spec.option.integrator = step, integrator
    return NominalModel(spec)


def of(effect: Effect, *values: float) -> Hypothesis:
    return Hypothesis(effects=(effect,), values=(np.array(values),))


def commands() -> Array:
    """Fast ramps: a held command jumps at every sample."""
    time = np.arange(COUNT) * STEP
    return np.sin(np.outer(time, [9.0, 13.0, 17.0])) * np.minimum(4 * time, 1.0)[:, None]


def trial(**given: object) -> Trial:
    whole: dict[str, object] = {
        "name": "run-01.csv", "form": "forward", "time": np.arange(COUNT) * STEP,
        "measured": np.zeros((COUNT, len(CHANNELS))), "step": STEP, "steps": COUNT,
        "controls": commands(), "before": np.empty((0, 3)), "position": np.zeros(3),
        "speed": np.zeros(3), "resting": True,
    }  # fmt: skip
    return Trial(**(whole | given))  # type: ignore[arg-type]


@pytest.mark.parametrize("integrator", [RK4, IMPLICIT])
@pytest.mark.parametrize("form", ["forward", "free"])
def test_a_linear_spring_is_the_catalogues_spring(form: str, integrator: int) -> None:
    own = machine(integrator, step=0.0005)
    known = of(CATALOGUE["joint_spring"](own, "joint2"), 40.0, 0.0)
    given = {"resting": False, "position": np.array([0.3, -0.5, 0.2])} if form == "free" else {}
    simulator = Simulator(own, [trial(form=form, **given)], CHANNELS, threads=1)
    both = of(LinearSpring(own, "joint2"), 40.0), known
    (term,), (spring,), (without,) = simulator.predict([*both, NOTHING])
    off = np.sqrt(np.mean((term - spring) ** 2, axis=0))
    visible = np.sqrt(np.mean((without - spring) ** 2, axis=0))
    assert np.all(off < 0.005 * visible), (off / visible).round(5)


def test_the_code_of_the_result_applies_a_term_to_the_written_model(tmp_path: Path) -> None:
    own = machine()
    term, gain = CubicSpring(own, "joint2"), CATALOGUE["sensor_gain"](own, "encoder2")
    hinge = CATALOGUE["joint_compliance"](own, "joint1")  # shifts the numbers of the joints
    given = (hinge, hinge.starts[0]), (term, [300.0]), (gain, [1.1])
    hypothesis = Hypothesis().with_effects([(e, np.array(v)) for e, v in given])
    file = write_model(tmp_path / "model.xml", own, hypothesis)[0]
    before, after = correction_code(hypothesis).split("# after every mj_step")
    model = mujoco.MjModel.from_xml_path(str(file))
    data, shown = mujoco.MjData(model), np.zeros((COUNT, len(CHANNELS)))
    names = {"model": model, "data": data}
    controls = np.vstack([np.zeros((400, 3)), commands()])
    for k, command in enumerate(controls):
        data.ctrl[: len(command)] = command
        exec(before, names)  # as a user would
        mujoco.mj_step(model, data)
        exec(after, names)
        shown[max(k - 400, 0)] = [*data.sensordata[:3], *data.sensordata[4:6]]
    simulator = Simulator(own, [trial()], CHANNELS, threads=1)
    (expected,), (without,) = simulator.predict([hypothesis, of(hinge, *hinge.starts[0])])
    off = np.sqrt(np.mean((shown - expected) ** 2, axis=0))
    visible = np.sqrt(np.mean((without - expected) ** 2, axis=0))
    assert np.all(off[:3] < 0.001 * visible[:3]), (off / visible).round(4)
    # it is the torque of half a step later that an accelerometer shows
    assert np.all(off[3:] < 0.05 * visible[3:]), (off / visible).round(4)


def test_what_is_no_effect_is_refused() -> None:
    class Short(CubicSpring):
        kind = "short_spring"

        def torque(self, position: Array, speed: Array, values: Array) -> Array:
            return position[..., 0]

    class Nameless(CubicSpring):
        kind = ""

    class Pathwise(CubicSpring):
        kind = "pathwise_spring"

        def torque_along(self, position: Array, speed: Array, values: Array) -> Array:
            return self.torque(position, speed, values)

    own = machine()
    with pytest.raises(InvalidSetting, match=r"Pathwise has a torque_along, .* give it an edit"):
        register(Pathwise)
    with pytest.raises(InvalidData, match=r"short_spring@joint2: torque .* each joint"):
        Simulator(own, [trial()], CHANNELS, threads=1).predict([of(Short(own, "joint2"), 1.0)])
    with pytest.raises(InvalidSetting, match=r"LinearSpring .* torque_code"):
        register(LinearSpring)
    with pytest.raises(InvalidSetting, match="kind"):
        register(Nameless)


def test_a_new_effect_joins_the_catalogue_once() -> None:
    for _ in range(2):
        assert register(CubicSpring) is CubicSpring
    own = machine_of("planar")
    assert [effect.where for effect in candidates(own, ["cubic_spring"])] == list(own.joints)

    class Other(CubicSpring):
        pass

    with pytest.raises(InvalidSetting, match="CubicSpring"):
        register(Other)


CREEP = """
from loose_env.gap import register
from loose_env.gap.model.effects.sensors import SensorBias

@register
class Creep(SensorBias):
    kind = "creep"
    version = {version}
"""


def test_a_file_registers_effects_and_may_be_run_again(tmp_path: Path) -> None:
    file = tmp_path / "creep.py"
    for version in (1, 2):
        file.write_text(CREEP.format(version=version))
        assert read_effects(file) == ("creep",)
        assert vars(CATALOGUE["creep"])["version"] == version


def test_a_file_without_effects_or_with_a_mistake_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetting, match=r"there is no file .*none\.py"):
        read_effects(tmp_path / "none.py")
    file = tmp_path / "empty.py"
    file.write_text("x = 1\n")
    with pytest.raises(InvalidSetting, match=r"empty\.py registers no effect"):
        read_effects(file)
    file.write_text("x = 1 / 0\n")
    with pytest.raises(InvalidSetting, match=r"cannot be run: ZeroDivisionError"):
        read_effects(file)


def test_the_command_considers_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = sprung(tmp_path / "arm", seconds=1.2)
    file = tmp_path / "creep.py"
    file.write_text(CREEP.format(version=1))
    words = ["gap", str(recording.folder), "--out", str(tmp_path / "out"), "--threads", "1"]
    words += ["--kinds", "creep", "--quiet", "--no-simulate"]
    assert main(words) == 1
    assert "creep" in capsys.readouterr().err
    assert main([*words, "--effects", str(file)]) == 0
    found = read_result(tmp_path / "out")
    listed = {(e.kind, e.where) for tried in found.ranking for e in tried.effects}
    assert listed <= {("creep", "encoder"), ("creep", "rate")}
    assert found.settings["kinds"] == ["creep"]
    assert main([*words, "--effects", str(tmp_path / "none.py")]) == 1
    assert "none.py'; give a Python file" in capsys.readouterr().err


STIFFNESS = 40.0
"""Torque over the cube of the angle [N·m/rad³]."""
MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.004" integrator="RK4"/>
  <worldbody>
    <body name="link">
      <joint name="elbow" axis="0 1 0" damping="0.4" armature="0.05"/>
      <inertial pos="0.2 0 0" mass="1.5" diaginertia="0.01 0.02 0.02"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="elbow" kp="120" kv="6"/></actuator>
  <sensor><jointpos name="encoder" joint="elbow"/><jointvel name="rate" joint="elbow"/></sensor>
</mujoco>
"""


def sprung(folder: Path, *, runs: int = 3, seconds: float = 2.4) -> Recording:
    """Write a recording, integrated ten times as finely as its samples."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.opt.timestep = 0.0004
    rng = np.random.default_rng(3)
    time = 0.004 * np.arange(round(seconds / 0.004))
    found = []
    for k in range(runs):
        data = mujoco.MjData(model)
        given = 0.9 * np.sin((2.0 + k) * time) * np.sin((5.3 - k) * time)
        for _ in range(2000):
            mujoco.mj_step(model, data)
        shown = np.zeros((len(time), 2))
        for row, command in zip(shown, given, strict=True):
            data.ctrl[:] = command
            for part in range(10):
                middle = data.qpos + 0.0002 * data.qvel
                data.qfrc_applied[:] = -STIFFNESS * middle**3
                mujoco.mj_step(model, data)
                if part == 0:
                    row[:] = data.sensordata
        shown += rng.normal(0.0, [1e-4, 5e-3], shown.shape)
        found.append(
            Run(
                name=f"run-{k + 1}.csv",
                time=time,
                controls={"servo": given},
                sensors={"encoder": shown[:, 0], "rate": shown[:, 1]},
            )
        )
    return write_recording(folder, model_xml=MODEL, runs=found, file_format="csv")


SETTINGS = GapSettings(threads=1, simulate=False, kinds=("coulomb_friction", "joint_spring"))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return sprung(tmp_path_factory.mktemp("arm") / "sprung", seconds=6.0)


def test_an_effect_of_ones_own_is_fitted_and_judged(recording: Recording, tmp_path: Path) -> None:
    answer = find_gap(recording, SETTINGS)
    for _ in range(2):  # its columns are made once
        tried = try_effect(answer, CubicSpring, "elbow")
        assert not tried.doubt and tried.parameters["size"] == pytest.approx(STIFFNESS, rel=0.05)
    assert min(tried.held_out_gain.values()) > 100
    assert try_effect(answer, CATALOGUE["coulomb_friction"], "elbow").doubt
    with pytest.raises(UnknownName, match="cubic_spring cannot be at"):
        try_effect(answer, CubicSpring, "knee")


def test_a_registered_effect_is_named_and_its_code_written(
    recording: Recording, tmp_path: Path
) -> None:
    register(CubicSpring)
    kinds = ("coulomb_friction", "joint_spring", "cubic_spring")
    settings = GapSettings(threads=1, kinds=kinds)
    solution = solve_gap(recording, settings)
    write_gap(tmp_path / "out", solution)
    found = solution.result
    assert read_result(tmp_path / "out").to_json() == found.to_json()
    (spring,) = found.effects
    assert spring.kind == "cubic_spring" and not spring.in_model
    low, high = spring.interval_95["size"]
    assert low < STIFFNESS < high and "torque[0] -= " in found.code
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "model.xml")).nu == 1
