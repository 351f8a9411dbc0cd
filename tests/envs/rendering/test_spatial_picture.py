"""Pictures of arms in space: where parts are seen, and what the correlation's cuts show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loose_env.arms import arm_from_file

pytest.importorskip("matplotlib")

from matplotlib.colors import to_rgb

from loose_env.arms import DESK_ARM, LinearArm, planar, scara, six_axis
from loose_env.envs.diagnosis_env import DiagnosisEnv
from loose_env.envs.episode.state import Episode
from loose_env.envs.rendering.correlation import (
    loop_of,
    measured_surface,
    predicted_surface,
    surface_of,
)
from loose_env.envs.rendering.palette import TRUTH
from loose_env.envs.rendering.picture import Picture
from loose_env.envs.rendering.spatial.view import SpaceView
from loose_env.envs.settings import DiagnosisSettings
from loose_env.faults import Backlash, Fault, Healthy, RotationalLooseness, StructuralLooseness
from loose_env.statistics import (
    Covariances,
    acceleration_from_angle,
    bandpass,
    covariances,
    maximum_correlation,
)
from scripts.thesis.rigs import cylindrical

ARMS = {
    "six_axis": six_axis,
    "scara": scara,
    "desk": lambda: arm_from_file(DESK_ARM),
    "cylindrical": cylindrical,
}
STOPS = {"gap": 2e-4, "stiffness": (1e6, 1e6), "damping": (100.0, 100.0)}


def measured(name: str, levels: list[int], fault: str = "healthy", seed: int = 3) -> DiagnosisEnv:
    """An environment after one short record."""
    settings = DiagnosisSettings(difficulty="easy")
    env = DiagnosisEnv(ARMS[name](), settings, render_mode="rgb_array", threads=1)
    env.reset(seed=seed, options={"fault": fault})
    env.step(env.actions.encode(levels=np.array(levels), duration=0))
    return env


def episode_of(env: DiagnosisEnv) -> Episode:
    episode = env.batch.episode(0)
    assert episode is not None
    return episode


@pytest.mark.parametrize("name", ARMS)
def test_every_arm_in_space_can_be_drawn(name: str) -> None:
    arm = ARMS[name]()
    env = measured(name, [2, *[0] * (arm.n - 1)])
    pixels = env.render()
    assert pixels.shape == (1200, 896, 3)
    assert pixels.dtype == np.uint8
    figure = Picture(env.batch.nominal, show=False).figure(episode_of(env))
    # The arm, and three cuts of the correlation.
    assert len(figure.axes) == 4
    words = [text.get_text() for text in figure.axes[0].texts]
    assert [str(j + 1) in words for j in range(arm.n)] == [True] * arm.n
    assert "gravity" in words and {"x", "y", "z"} <= set(words)
    env.close()


def test_a_sliding_joint_s_place_is_given_in_millimetres() -> None:
    picture = Picture(LinearArm(scara()), show=False)
    slots = np.zeros((1, 8), dtype=np.float32)
    pose = np.array([0.5, -0.5, -0.08, 0.0])
    episode = Episode(seed=0, number=0, fault=Healthy(), pose=pose, slots=slots)
    texts = [text.get_text() for text in picture.figure(episode).texts]
    assert "Pose 29°, −29°, −80 mm, 0°" in texts


SPATIAL: list[Fault] = [
    StructuralLooseness(link=2, direction=(0.0, 1.0, 0.4), **STOPS),  # type: ignore[arg-type]
    RotationalLooseness(link=3, axis=(0.0, 1.0, 0.4), **STOPS),  # type: ignore[arg-type]
    Backlash(joint=2, **STOPS),  # type: ignore[arg-type]
]


def test_the_fault_shows_at_the_end_and_not_before() -> None:
    env = measured("six_axis", [0, 3, 0, 0, 0, 0])
    picture = Picture(env.batch.nominal, show=False)
    episode = episode_of(env)
    honest = picture.draw(episode)
    assert honest is not None
    red = np.round(255 * np.array(to_rgb(TRUTH))).astype(np.uint8)
    shown = []
    for fault in SPATIAL:
        episode.ended, episode.fault = False, fault
        assert np.array_equal(honest, picture.draw(episode))
        assert not (honest == red).all(axis=2).any()
        episode.ended = True
        after = picture.draw(episode)
        assert after is not None
        assert (after == red).all(axis=2).sum() > 200
        shown.append(after.tobytes())
    assert len(set(shown)) == len(SPATIAL)


# ---- where the parts are seen


def test_lengths_along_the_picture_are_true_and_up_is_up() -> None:
    arm = scara()
    at = SpaceView(arm).at(np.array([0.3, 0.7, -0.1, 0.2]))
    # Turned as a whole, nothing is stretched.
    np.testing.assert_allclose(at.frame.T @ at.frame, np.eye(3), atol=1e-12)
    outer = at.joints[2] - at.joints[1]
    assert np.linalg.norm(outer) == pytest.approx(0.275)
    # The vertical has no sideways part, points up, and leans a little towards the eye.
    upright = at.axes[0]
    assert upright[0] == pytest.approx(0.0, abs=1e-12)
    assert upright[1] > 0.9 and upright[2] > 0.1


def test_down_is_where_gravity_pulls() -> None:
    arm = six_axis()
    spec = arm.spec.copy()
    spec.option.gravity = [0.0, 9.81, 0.0]
    view = SpaceView(replace(arm, spec=spec))
    down = view._camera @ np.array([0.0, 1.0, 0.0])
    assert down[0] == pytest.approx(0.0, abs=1e-12) and down[1] < -0.9
    spec = arm.spec.copy()
    spec.option.gravity = [0.0, 0.0, 0.0]
    assert SpaceView(replace(arm, spec=spec)).gravity == 0.0


@pytest.mark.parametrize("name", ARMS)
def test_every_joint_is_drawn_on_its_axis_and_over_the_floor(name: str) -> None:
    arm = ARMS[name]()
    view, rng = SpaceView(arm), np.random.default_rng(0)
    for _ in range(10):
        pose = arm.random_pose(rng)
        at = view.at(pose)
        data = view._data
        anchors = np.array([data.joint(j).xanchor for j in arm.joints]) @ view._camera.T
        off = at.joints - anchors
        along = np.einsum("ni,ni->n", off, at.axes)
        np.testing.assert_allclose(off, along[:, None] * at.axes, atol=1e-9)
        height = (np.vstack([at.joints, at.tool]) - at.foot) @ at.floor[:, 2]
        assert height.min() > 0
        shadow = at.on_floor(at.joints)
        np.testing.assert_allclose((shadow - at.foot) @ at.floor[:, 2], 0.0, atol=1e-9)


# ---- the correlation


@pytest.mark.parametrize("name", ["six_axis", "scara"])
def test_the_surface_of_one_shaken_joint_is_that_of_the_statistics(name: str) -> None:
    env = measured(name, [0, 3] + [0] * (ARMS[name]().n - 2), "structural_looseness@link2")
    measurement = episode_of(env).last
    assert measurement is not None
    rate, band = measurement.rate, measurement.excitation.band
    joint = acceleration_from_angle(measurement.encoder[1:2], rate, band)[0]
    tool = bandpass(measurement.tool, rate, band)
    surface = measured_surface(measurement)
    assert surface.maximum == pytest.approx(maximum_correlation(joint, tool).value)
    directions = np.random.default_rng(0).standard_normal((30, 3))
    for direction, found in zip(directions, surface.along(directions), strict=True):
        assert found == pytest.approx(
            np.corrcoef(joint, np.asarray(direction) @ tool)[0, 1], abs=1e-9
        )
    for section in surface.sections:
        for point in section.points[60:-60:40]:
            direction = np.zeros(3)
            direction[list(section.axes)] = point
            r = np.corrcoef(joint, np.asarray(direction) @ tool)[0, 1]
            assert r == pytest.approx(np.linalg.norm(point), abs=1e-9)
        assert section.lowest is not None
        direction = np.zeros(3)
        direction[list(section.axes)] = section.lowest
        assert surface.along(direction[None])[0] == pytest.approx(0.0, abs=1e-9)


def test_several_joints_count_as_the_sum_the_tool_follows_best() -> None:
    rng = np.random.default_rng(1)
    x = rng.standard_normal((3, 4000))
    a = np.array([[1.0, 0.4, 0.0], [0.0, 1.0, -0.3], [0.2, 0.0, 0.5]]) @ x
    a += 0.5 * rng.standard_normal(a.shape)
    surface = surface_of(covariances(x, a))
    best = max(
        maximum_correlation(weights @ x, a).value for weights in rng.standard_normal((400, 3))
    )
    assert best <= surface.maximum <= best + 0.02


def test_in_the_plane_the_surface_is_the_loop() -> None:
    rng = np.random.default_rng(2)
    for m in (1, 2):
        x = rng.standard_normal((m, 500))
        a = rng.standard_normal((2, m)) @ x + 0.3 * rng.standard_normal((2, 500))
        cov = covariances(x, a)
        loop, section = loop_of(cov), surface_of(cov).section(0, 1)
        radius = np.linalg.norm(section.points, axis=1)
        assert radius.max() == pytest.approx(loop.maximum, abs=1e-3)
        assert section.lowest is not None
        assert abs(section.lowest @ loop.lowest) == pytest.approx(1.0)


def test_a_tool_axis_that_stands_still_leaves_the_cuts_finite() -> None:
    still = Covariances(
        xx=np.eye(1), xa=np.array([[2.0, 0.0, 0.0]]), aa=np.diag([4.0, 0.0, 0.0]), count=100
    )
    surface = surface_of(still)
    assert surface.maximum == pytest.approx(1.0)
    for section in surface.sections:
        assert np.isfinite(section.points).all()
    assert surface.section(1, 2).lowest is None


def test_the_healthy_arm_s_surface_is_that_of_the_prediction() -> None:
    from loose_env.diagnosis import SensorFloor, predict
    from loose_env.excitation import at_levels
    from loose_env.sensors import SensorSuite

    linear = LinearArm(six_axis())
    at = linear.at([0.3, -1.0, 1.2, 0.4, 0.6, -0.2])
    for levels in ([0, 2, 0, 0, 0, 0], [2, 0, 0, 0, 2, 0]):
        shake, _ = at_levels(at, np.array(levels, dtype=float), duration=1.2)
        prediction = predict(at, shake, SensorFloor.of(SensorSuite(), linear.arm.band))
        surface = predicted_surface(prediction)
        assert surface.maximum == pytest.approx(prediction.maximum_correlation)
        # The direction of lowest coherence is one in which the surface vanishes.
        lowest = prediction.lowest_direction
        assert surface.along(lowest[None])[0] == pytest.approx(0.0, abs=1e-6)


def test_an_arm_in_a_plane_is_still_drawn_in_it() -> None:
    env = DiagnosisEnv(planar(3), render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (896, 720, 3)
    env.close()
