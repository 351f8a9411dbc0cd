"""Terms on the torque: what they do to a simulation, and what they say of a measured motion."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap.data.aligned_run import Channel, Trial, align_run, channels_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, register
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.export_mjcf import correction_code, write_model
from loose_env.gap.simulation.inverse_dynamics import InverseDynamics
from loose_env.gap.simulation.simulator import Simulator
from loose_env.gap.simulation.torque_terms import torque_terms
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.own_effects import (
    Cogging,
    CubicSpring,
    Damper,
    LinearSpring,
    OneTerm,
    SlickFriction,
)
from tests.gap.cases.recorded_runs import measurable, torque_run

STEP, INSIDE, COUNT = 0.001, 20, 1200
RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
IMPLICIT = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
CHANNELS = (
    *(Channel(f"sensor.encoder{k}") for k in (1, 2, 3)),
    *(Channel("sensor.shake", axis) for axis in range(2)),
)
NOISE = np.array([1e-5, 1e-5, 1e-5, 0.02, 0.02])
"""Of good encoders and accelerometers [rad, m/s²]."""
NOTHING = Hypothesis()


def machine(integrator: int = RK4, step: float = STEP) -> NominalModel:
    return NominalModel(mujoco.MjSpec.from_string(PLANAR), step=step, integrator=integrator)


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
        "controls": commands(), "position": np.zeros(3), "speed": np.zeros(3), "resting": True,
        "joints": ("joint1", "joint2", "joint3"),
    }  # fmt: skip
    return Trial(**(whole | given))  # type: ignore[arg-type]


@contextmanager
def acting(hypothesis: Hypothesis) -> Iterator[None]:
    """The terms as MuJoCo itself would have them, in every stage of its integrator."""

    def passive(_: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_passive[:] += torque_terms(hypothesis, np.array(data.qpos), np.array(data.qvel))

    mujoco.set_mjcb_passive(passive)
    try:
        yield
    finally:
        mujoco.set_mjcb_passive(None)


def fine(hypothesis: Hypothesis, delay: float = 0.0) -> Array:
    """Encoders and accelerometer at the samples, by steps of 1/20."""
    model = machine(step=STEP / INSIDE).fresh().compile()
    data, controls = mujoco.MjData(model), commands()
    shown = np.zeros((COUNT, len(CHANNELS)))
    with acting(hypothesis):
        for _ in range(400 * INSIDE):
            mujoco.mj_step(model, data)
        for k in range(COUNT * INSIDE):
            late = int(np.floor(k / INSIDE - delay / STEP + 1e-9))
            data.ctrl[:] = controls[max(late, 0)]
            mujoco.mj_step(model, data)
            if k % INSIDE == 0:
                shown[k // INSIDE] = [*data.sensordata[:3], *data.sensordata[4:6]]
    return shown


TERMS = [
    (CubicSpring, "joint2", 300.0),
    (LinearSpring, "joint3", 400.0),
    (Cogging, "joint2", 12.0),
    (Damper, "joint1", 30.0),
    (SlickFriction, "joint3", 3.0),
]


@pytest.mark.parametrize(("kind", "where", "value"), TERMS)
def test_neither_encoder_nor_accelerometer_sees_that_it_is_held(
    kind: type[OneTerm], where: str, value: float
) -> None:
    own = machine()
    term = of(kind(own, where), value)
    expected = fine(term)
    simulator = Simulator(own, [trial()], CHANNELS, threads=1)
    (shown,), (without,) = simulator.predict([term, NOTHING])
    off = np.sqrt(np.mean((shown - expected) ** 2, axis=0))
    visible = np.sqrt(np.mean((without - expected) ** 2, axis=0))
    assert np.max(visible / NOISE) > 100
    assert np.all(off[:3] < 0.5 * NOISE[:3]), (off / NOISE).round(3)
    assert np.all(off[:3] < 0.002 * visible[:3]), (off / visible).round(4)
    assert np.all(off[3:] < 0.02 * visible[3:]), (off / visible).round(4)


@pytest.mark.parametrize("integrator", [RK4, IMPLICIT])
@pytest.mark.parametrize("form", ["forward", "free"])
def test_a_linear_spring_is_the_catalogues_spring(form: str, integrator: int) -> None:
    own = machine(integrator, step=0.0005)
    catalogue = CATALOGUE["joint_spring"](own, "joint2")
    values = {"stiffness": 40.0}
    known = of(catalogue, *(values.get(p.name, 0.0) for p in catalogue.parameters))
    given = {"resting": False, "position": np.array([0.3, -0.5, 0.2])} if form == "free" else {}
    run = trial(form=form, **given)
    simulator = Simulator(own, [run], CHANNELS, threads=1)
    (term,), (spring,), (without,) = simulator.predict(
        [of(LinearSpring(own, "joint2"), 40.0), known, NOTHING]
    )
    off = np.sqrt(np.mean((term - spring) ** 2, axis=0))
    visible = np.sqrt(np.mean((without - spring) ** 2, axis=0))
    assert np.all(off < 0.005 * visible), (off / visible).round(5)


def test_a_term_of_the_wrong_shape_says_so() -> None:
    class Short(CubicSpring):
        kind = "short_spring"

        def torque(self, position: Array, speed: Array, values: Array) -> Array:
            return position[..., 0]

    own = machine()
    with pytest.raises(InvalidData, match=r"short_spring@joint2: torque .* each joint"):
        Simulator(own, [trial()], CHANNELS, threads=1).predict([of(Short(own, "joint2"), 1.0)])


def test_backwards_a_linear_spring_is_the_catalogues_spring() -> None:
    own = NominalModel(measurable(mujoco.MjSpec.from_string(PLANAR)))
    run = torque_run(own, own.model, np.random.default_rng(5), duration=4.0)
    channels = channels_of([run])
    inverse = InverseDynamics(own, [align_run(run, own, channels, step=0.001)], channels, threads=1)
    catalogue = CATALOGUE["joint_spring"](own, "joint2")
    known = of(catalogue, *(40.0 if p.name == "stiffness" else 0.0 for p in catalogue.parameters))
    term = of(LinearSpring(own, "joint2"), 40.0)
    assert inverse.shows(term.effects[0])
    (a,), (b,), (nominal,) = inverse.predict([term, known, NOTHING])
    scale = np.nanmax(np.abs(nominal - b))
    assert scale > 1.0
    assert np.nanmax(np.abs(a - b)) < 0.01 * scale
    # and where the model is led because something in it moves unseen
    soft = CATALOGUE["joint_compliance"](own, "joint3")
    values = np.array(soft.starts[0])
    led = [
        Hypothesis(effects=(soft, *h.effects), values=(values, *h.values)) for h in (term, known)
    ]
    (a,), (b,) = inverse.predict(led)
    assert np.nanmax(np.abs(a - b)) < 0.02 * scale


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


def test_a_term_that_nothing_applies_is_not_registered() -> None:
    with pytest.raises(InvalidSetting, match=r"LinearSpring .* torque_code"):
        register(LinearSpring)
    try:
        assert register(CubicSpring) is CubicSpring
    finally:
        del CATALOGUE["cubic_spring"]
