"""Which links carry an accelerometer, where, and along what it measures, is a setting."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from loose_env.arms import Arm, Mismatch, MismatchDraw, link_site, planar, scara, six_axis, vera
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import Excitation
from loose_env.faults import Healthy
from loose_env.rig import Measurement, SimulatedRig
from loose_env.sensors import LinkAccelerometers, SensorSuite


def measured(
    arm: Arm,
    links: bool | LinkAccelerometers,
    *,
    draw: MismatchDraw | None = None,
    sensors: SensorSuite | None = None,
) -> Measurement:
    suite = dataclasses.replace(sensors or SensorSuite.ideal(), link_accelerometers=links)
    rig = SimulatedRig(arm, sensors=suite)
    rig.mount(0, Healthy(), draw)
    shake = Excitation(torque_rms=(3.0,) * arm.n, duration=0.2, band=(30.0, 150.0))
    pose = np.array([0.4 if r is None else 0.4 * r[1] + 0.6 * r[0] for r in arm.joint_ranges])
    return rig.measure(pose, shake)


@pytest.mark.parametrize("make", [vera, lambda: planar(3), six_axis, scara])
def test_a_tangential_sensor_reads_what_all_axes_read_along_the_tangent(
    make: Callable[[], Arm],
) -> None:
    arm = make()
    every = measured(arm, LinkAccelerometers())
    along = measured(arm, LinkAccelerometers(tangential=True))
    assert every.links is not None and along.links is not None
    assert every.links.shape[:2] == (arm.n, len(arm.axes))
    assert along.links.shape[:2] == (arm.n, 1)
    for i in range(arm.n):
        tangent = link_site(arm, i + 1).tangent[list(arm.axes)]
        np.testing.assert_allclose(along.links[i, 0], tangent @ every.links[i], atol=1e-6)


def test_links_without_a_sensor_leave_no_channel() -> None:
    arm = planar(4)
    every, some, none = (
        measured(arm, LinkAccelerometers(links=links)) for links in (None, (1, 3), ())
    )
    assert every.links is not None and some.links is not None and none.links is not None
    np.testing.assert_allclose(some.links, every.links[[0, 2]], atol=1e-9)
    assert none.links.shape == (0, 2, 200)
    np.testing.assert_array_equal(some.tool, every.tool)


def test_the_distal_end_of_the_last_link_is_the_tool() -> None:
    found = measured(planar(3), LinkAccelerometers(links=(3,)))
    assert found.links is not None
    np.testing.assert_allclose(found.links[0], found.tool, atol=1e-9)


def test_true_stands_for_the_proximal_end_of_every_link() -> None:
    arm = planar(3)
    plain, spelt = measured(arm, True), measured(arm, LinkAccelerometers(place="proximal"))
    assert plain.links is not None and spelt.links is not None
    np.testing.assert_array_equal(plain.links, spelt.links)
    # Nothing moves the origin of link 1 on a healthy arm.
    assert plain.links[0].std() < 1e-6 < plain.links[1].std()


def test_every_sensor_has_errors_of_its_own() -> None:
    arm = planar(2)
    draw = Mismatch().scaled(0.0).draw(arm, np.random.default_rng(0))
    errors = np.array([1.1 * np.eye(3), 0.8 * np.eye(3)])
    links = LinkAccelerometers(tangential=True)
    exact = measured(arm, links, draw=draw)
    wrong = measured(arm, links, draw=dataclasses.replace(draw, link_sensors=errors))
    assert exact.links is not None and wrong.links is not None
    np.testing.assert_array_equal(wrong.tool, exact.tool)
    np.testing.assert_allclose(wrong.links[0], 1.1 * exact.links[0], atol=1e-9)
    np.testing.assert_allclose(wrong.links[1], 0.8 * exact.links[1], atol=1e-9)


def test_a_longer_link_carries_its_sensor_farther_out() -> None:
    arm = planar(2)
    draw = Mismatch().scaled(0.0).draw(arm, np.random.default_rng(0))
    longer = draw.length.copy()
    longer[link_site(arm, 1).scaled_by] = 1.05
    rig = SimulatedRig(arm, sensors=SensorSuite(link_accelerometers=LinkAccelerometers()))
    rig.mount(0, Healthy(), dataclasses.replace(draw, length=longer))
    model = rig.plants[0].model
    np.testing.assert_allclose(model.site("accelerometer1").pos, [0.315, 0, 0])
    np.testing.assert_allclose(model.body("flange2").pos, [0.315, 0, 0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"place": "proximal", "tangential": True}, "has no tangent"),
        ({"place": "middle"}, "'proximal', 'distal'; got 'middle'"),
        ({"links": (2, 1)}, "increasing"),
        ({"links": (0,)}, "numbers from 1"),
        ({"links": (True,)}, "numbers from 1"),
    ],
)
def test_a_choice_that_cannot_be_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSetting, match=message):
        LinkAccelerometers(**change)


def test_a_link_that_the_arm_does_not_have_is_refused() -> None:
    suite = SensorSuite(link_accelerometers=LinkAccelerometers(links=(1, 5)))
    with pytest.raises(UnknownName, match="has links 1 to 3"):
        SimulatedRig(planar(3), sensors=suite)
