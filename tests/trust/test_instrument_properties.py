"""Whatever arm, settings and recording the instrument is given: refused in words, or finite."""

from __future__ import annotations

import json
import math
import signal
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from loose_env.arms import DESK_ARM, Arm, arm_from_file, planar, scara
from loose_env.errors import LooseEnvError
from loose_env.instrument import (
    DiagnoseSettings,
    Diagnosis,
    ModelSettings,
    NextSettings,
    PlanSettings,
    diagnose,
    inspect_model,
    plan,
    plan_json,
    screen,
)
from loose_env.instrument.model.instrumented_arm import read_arm
from loose_env.recording import Run, read_recording, write_recording
from tests.trust.test_properties import chains

pytestmark = pytest.mark.slow

HANGS = 120
"""Time after which an example hangs [s]; it takes a second or two."""
few = settings(
    max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
some = settings(few, max_examples=14)


@pytest.fixture(autouse=True)
def no_hang() -> Iterator[None]:
    """End a test that hangs, with the place; figures that files do not give are no matter here."""

    def late(*_: object) -> None:
        raise TimeoutError(f"nothing happened for {HANGS} s")

    before = signal.signal(signal.SIGALRM, late)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def finite(value: Any, place: str = "") -> None:
    """No number of a tree is other than finite."""
    if isinstance(value, dict):
        for name, one in value.items():
            finite(one, f"{place}.{name}")
    elif isinstance(value, (list, tuple)):
        for k, one in enumerate(value):
            finite(one, f"{place}[{k}]")
    elif isinstance(value, float):
        assert math.isfinite(value), place


ARMS: dict[str, Callable[[], Arm]] = {
    "planar": lambda: planar(2),
    "vertical": lambda: planar(3, vertical=True),
    "scara": scara,
    "desk": lambda: arm_from_file(DESK_ARM),
}


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Arms of the package as files, with actuators and sensors."""
    found = {}
    for name, make in ARMS.items():
        path = tmp_path_factory.mktemp(name) / f"{name}.xml"
        path.write_text(make().spec.to_xml(), "utf-8")
        path.write_text(read_arm(path).recording_model.xml, "utf-8")
        found[name] = path
    return found


positive = st.floats(1e-3, 1e3)


def ends(rate: float) -> st.SearchStrategy[float | None]:
    """Upper ends of a band that a rate [Hz] allows; others are refused before any plan."""
    most = min(400.0, NextSettings(rate_hz=rate).allowed_hz)
    return st.none() | st.floats(51, most) if most > 51 else st.none()


choices = st.sampled_from([100.0, 333.3, 1000.0, 5000.0]).flatmap(
    lambda rate: st.builds(
        NextSettings,
        gap_mm=positive,
        noise_ug=positive,
        rate_hz=st.just(rate),
        seconds=st.floats(0.2, 2.0),
        most_tool=positive,
        torque_share=st.floats(0.01, 1.0),
        ground_m=st.none() | st.floats(-2, 2),
        poses=st.integers(1, 3),
        band_low=st.none() | st.floats(1, 50),
        band_high=ends(rate),
        in_turn=st.integers(1, 3),
        margin=st.floats(0, 0.4),
        seed=st.integers(0, 2**62),
    )
)
owns = st.builds(PlanSettings, ramp_s=st.floats(0, 1), hold_s=st.floats(0, 1), pose_deg=st.just(()))
stands = st.builds(
    ModelSettings,
    hold=st.sampled_from(["model", "brake", "servo", "compliant"]),
    payload_kg=st.floats(0, 20),
)


def planned(model: Path, choice: NextSettings, own: PlanSettings, stand: ModelSettings) -> None:
    """Plan, if it can be; everything that is written is finite, and no limit is left."""
    try:
        made = plan(model, arm=stand, choice=choice, own=own)
    except LooseEnvError as error:
        assert str(error) and "\n" not in str(error)
        return
    finite(plan_json(made, [f"run-{k}.csv" for k in range(len(made.signals))]))
    for one in made.signals:
        assert all(np.isfinite(u).all() for u in one.commands.values())
        assert one.tool_rms <= 1.2 * choice.most_tool
        limits = choice.torque_share * np.array(made.arm.nominal.torque_limits)
        assert (one.torque_peaks <= limits * 1.01).all()


@few
@given(name=st.sampled_from(sorted(ARMS)), choice=choices, own=owns, stand=stands)
def test_any_settings_are_refused_or_planned_with(
    models: dict[str, Path], name: str, choice: NextSettings, own: PlanSettings,
    stand: ModelSettings,
) -> None:  # fmt: skip
    signal.alarm(HANGS)
    planned(models[name], choice, own, stand)


@few
@given(text=chains(), choice=choices, stand=stands)
def test_any_chain_is_refused_or_inspected_and_planned_for(
    tmp_path: Path, text: str, choice: NextSettings, stand: ModelSettings
) -> None:
    signal.alarm(HANGS)
    model = tmp_path / "arm.xml"
    model.write_text(text)
    try:
        found = inspect_model(model, choice, stand)
    except LooseEnvError as error:
        assert str(error) and "\n" not in str(error)
    else:
        assert "nan" not in screen(found)
        assert "NaN" not in found.to_json()
    planned(model, choice, PlanSettings(), stand)


@st.composite
def records(draw: st.DrawFn) -> dict[str, Any]:
    """How a run is recorded: rate, length, what is missing, how loud, what is noted."""
    return {
        "seed": draw(st.integers(0, 2**31)),
        "rate": draw(st.sampled_from([20.0, 123.4, 500.0, 1000.0, 9999.0])),
        "samples": draw(st.integers(10, 600)),
        "jitter": draw(st.sampled_from([0.0, 0.0, 1e-3, 0.3])),
        "missing": draw(st.sampled_from([0.0, 0.0, 0.01, 0.19])),
        "pause": draw(st.sampled_from([0.0, 0.0, 0.5, 1e3, 1e7])),
        "loud": draw(st.sampled_from([0.0, 1e-6, 1.0, 30.0, 1e5])),
        "wobble": draw(st.sampled_from([0.0, 1e-5, 1e-3, 1.0])),
        "drives": draw(st.sampled_from(["ctrl", "torque", "none"])),
        "noted": draw(st.booleans()),
        "healthy": draw(st.sampled_from([False, False, False, True])),
        "without": draw(st.sets(st.integers(0, 9), max_size=2)),
    }


def run_of(model: Path, number: int, how: dict[str, Any]) -> Run:
    """A run of noise: no arm made it, but a recorder could have written it."""
    machine = read_arm(model)
    made = machine.recording_model
    rng = np.random.default_rng(how["seed"])
    count = how["samples"]
    time = (np.arange(count) + how["jitter"] * rng.uniform(-1, 1, count)) / how["rate"]
    time[count // 2 :] += how["pause"]
    pose = {name: float(q) for name, q in zip(machine.joints, machine.home, strict=True)}

    def noise(size: float, *shape: int) -> np.ndarray:
        values = size * rng.normal(size=(count, *shape))
        values[rng.random(count) < how["missing"]] = np.nan
        return values

    sensors = {made.accelerometer: noise(how["loud"], 3)}
    for sensor, q in zip(made.positions, pose.values(), strict=True):
        sensors[sensor] = q + noise(how["wobble"])
    sensors = {s: v for k, (s, v) in enumerate(sensors.items()) if k not in how["without"]}
    actuators = [d.actuator for d in machine.drives if d is not None]
    return Run(
        name=f"run-{number}.parquet",
        time=np.sort(time),
        sensors=sensors,
        controls={a: noise(how["loud"]) for a in actuators} if how["drives"] == "ctrl" else {},
        torques={j: noise(how["loud"]) for j in pose} if how["drives"] == "torque" else {},
        pose=pose if how["noted"] else None,
        excited=machine.joints[:1] if how["noted"] else (),
        condition="healthy" if how["healthy"] else "suspect",
    )


@some
@given(
    name=st.sampled_from(["planar", "vertical", "scara"]),
    hows=st.lists(records(), min_size=1, max_size=2),
    tolerance=st.sampled_from([1e-6, 0.02, 1.0]),
    healthy=st.floats(0.01, 0.99),
    asked=st.sampled_from([False, False, True]),
)
def test_any_recording_is_refused_or_weighed(
    tmp_path: Path, models: dict[str, Path], name: str, hows: list[dict[str, Any]],
    tolerance: float, healthy: float, asked: bool,
) -> None:  # fmt: skip
    signal.alarm(HANGS)
    home = tmp_path / "recording"
    runs = [run_of(models[name], k, how) for k, how in enumerate(hows)]
    chosen = DiagnoseSettings(
        poses=1, seconds=0.5, inertial_parameters=tolerance, healthy_prior=healthy
    )
    try:
        write_recording(home, model_xml=models[name], runs=runs, overwrite=True)
        found = diagnose(read_recording(home), chosen, plan=asked)
    except LooseEnvError as error:
        assert str(error) and "\n" not in str(error)
        return
    finite(json.loads(found.to_json()))
    weighed = [found.posterior, *(r.probabilities for r in found.records if r.probabilities)]
    for probabilities in weighed:
        assert math.isclose(math.fsum(probabilities.values()), 1.0, abs_tol=1e-9)
        assert all(0 <= p <= 1 for p in probabilities.values())
    assert Diagnosis.from_json(found.to_json()).fault.hypothesis == found.fault.hypothesis
