"""Accelerometers on links in the observation: layout, signals, and the effect of a loose link."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from loose_env.arms import Arm, MismatchDraw, planar, vera
from loose_env.diagnosis import NominalLinks, link_readings_of_all, statistics_of
from loose_env.envs import DiagnosisSettings, ObservationLayout
from loose_env.envs.diagnosis_env import DiagnosisEnv
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation
from loose_env.faults import Healthy, StructuralLooseness
from loose_env.rig import SimulatedRig
from loose_env.sensors import LinkAccelerometers, SensorSuite


def environment(arm: Arm, links: bool | LinkAccelerometers, **settings: Any) -> DiagnosisEnv:
    suite = SensorSuite(link_accelerometers=links)
    return DiagnosisEnv(arm, settings=DiagnosisSettings(sensors=suite, **settings))


def test_without_them_the_layout_is_what_it_was() -> None:
    plain = ObservationLayout(planar(3), DiagnosisSettings())
    assert not any("link" in e.name for e in plain.slot_elements)


@pytest.mark.parametrize(
    ("choice", "carriers", "axes"),
    [
        (True, 3, 2),
        (LinkAccelerometers(links=(1, 3)), 2, 2),
        (LinkAccelerometers(tangential=True), 3, 1),
    ],
)
def test_the_layout_has_a_transmission_for_each_sensor_axis_and_joint(
    choice: bool | LinkAccelerometers, carriers: int, axes: int
) -> None:
    env = environment(planar(3), choice, raw=True)
    names = [e.name for e in env.batch.observations.slot_elements]
    for group in ("link_transmission_by_instrument", "nominal_link_transmission_by_instrument"):
        assert sum(n.startswith(f"{group}.") for n in names) == carriers * axes * 3
    assert sum(n.startswith("link_rms.") for n in names) == carriers * axes
    space: Any = env.observation_space
    assert space["links"].shape[:2] == (carriers, axes)
    shown, _ = env.reset(seed=1)
    assert space.contains(shown)


def test_a_healthy_record_shows_the_nominal_transmission() -> None:
    env = environment(vera(), LinkAccelerometers(), raw=True)
    env.reset(seed=3, options={"fault": "healthy", "mismatch_scale": 0.0})
    action = env.actions.encode(levels=np.array([3, 3]))
    shown, _, _, _, info = env.step(action)
    layout = env.batch.observations
    found, nominal = (
        layout.physical(shown["statistics"], f"{p}link_transmission_by_instrument")[0]
        for p in ("", "nominal_")
    )
    assert np.abs(nominal).max() > 0.05
    np.testing.assert_allclose(found, nominal, atol=0.15 * np.abs(nominal).max())
    links = info["measurement"].links
    np.testing.assert_allclose(
        shown["links"][..., : links.shape[-1]], links.astype(np.float32), rtol=1e-6
    )


@pytest.mark.parametrize("loose", [1, 2, 3])
def test_a_loose_link_changes_the_sensors_beyond_its_seat_and_none_before(loose: int) -> None:
    arm, choice = planar(3), LinkAccelerometers(place="distal")
    sensors = dataclasses.replace(SensorSuite.ideal(), link_accelerometers=choice)
    rig = SimulatedRig(arm, slots=1, sensors=sensors)
    fault = StructuralLooseness(
        link=loose, direction=(0.0, 1.0, 0.0), gap=2e-4, stiffness=(1e5, 1e5), friction=0.5
    )
    pose = np.array([0.1, 0.7, -0.6])
    shake = Excitation(torque_rms=(6.0, 0.0, 0.0), duration=1.2, band=arm.band)
    nominal = NominalLinks(arm, choice).transmission(pose, [True, False, False])
    changes = {}
    for name, what in (("healthy", Healthy()), ("loose", fault)):
        rig.mount(0, what, MismatchDraw.none(arm))
        record = rig.measure(pose, shake, rng=np.random.default_rng(2))
        found = link_readings_of_all([record])
        changes[name] = np.linalg.norm(
            found.transmission_by_instrument[0] - nominal, axis=(1, 2)
        ) / np.linalg.norm(nominal, axis=(1, 2))
    assert changes["healthy"].max() < 0.03
    # The local method (7.1.3): the first sensor that has changed stands on the loose link.
    assert int(np.argmax(changes["loose"] > 0.1)) == loose - 1


def test_a_record_without_them_is_refused() -> None:
    arm = planar(2)
    record = SimulatedRig(arm).measure(
        np.zeros(2), Excitation(torque_rms=(2.0, 0.0), duration=0.4, band=arm.band)
    )
    assert statistics_of(record).duration == 0.4
    with pytest.raises(InvalidData, match="link_accelerometers"):
        link_readings_of_all([record])
