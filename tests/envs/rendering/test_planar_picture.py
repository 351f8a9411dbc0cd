from __future__ import annotations

import builtins
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("matplotlib")

from loose_env.arms import Arm, LinearArm, planar, scara, vera
from loose_env.diagnosis import SensorFloor, predict
from loose_env.envs.diagnosis_env import DiagnosisEnv
from loose_env.envs.episode.state import Episode
from loose_env.envs.rendering.correlation import measured_loop, predicted_loop
from loose_env.envs.rendering.picture import Picture
from loose_env.envs.rendering.planar.view import PlanarView
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import InvalidSetting, LooseEnvError
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import (
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    RotationalLooseness,
    StructuralLooseness,
)
from loose_env.sensors import SensorSuite
from loose_env.statistics import axial_difference, maximum_correlation

LOOSE = StructuralLooseness(
    link=2, direction=(0.0, 1.0, 0.0), gap=2e-4, stiffness=(1e6, 1e6), damping=(100.0, 100.0)
)
PLAY = Backlash(joint=1, gap=1e-3, stiffness=(1e5, 1e5), damping=(10.0, 10.0))
ROCKS = RotationalLooseness(link=2, axis=(0.0, 0.0, 1.0), gap=1e-3, stiffness=(1e5, 1e5))
BOTH = CompoundLooseness(link=2, parts=(LOOSE, ROCKS))


def measured(
    fault: Fault | str = "healthy",
    *,
    arm: Arm | None = None,
    levels: Sequence[int] = (0, 2),
    pose: Sequence[float] = (30.0, -60.0),
    seed: int = 3,
) -> DiagnosisEnv:
    """An environment of two joints after one short record."""
    settings = DiagnosisSettings(difficulty="easy")
    env = DiagnosisEnv(vera() if arm is None else arm, settings, render_mode="rgb_array", threads=1)
    env.reset(seed=seed, options={"fault": fault, "pose": np.radians(pose)})
    env.step(env.actions.encode(levels=np.array(levels), duration=0))
    return env


def episode_of(env: DiagnosisEnv) -> Episode:
    episode = env.batch.episode(0)
    assert episode is not None
    return episode


def at_rest(pose: Sequence[float], fault: Fault | None = None) -> Episode:
    """An episode that has not measured anything."""
    return Episode(
        seed=0,
        number=0,
        fault=Healthy() if fault is None else fault,
        pose=np.radians(pose),
        slots=np.zeros((4, 8), dtype=np.float32),
    )


@pytest.fixture(scope="module")
def picture() -> Picture:
    return Picture(LinearArm(vera()), show=False)


def test_a_picture_is_an_array_of_colours() -> None:
    env = measured()
    pixels = env.render()
    assert pixels.shape == (896, 720, 3)
    assert pixels.dtype == np.uint8
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 20
    env.close()


def test_the_same_episode_gives_the_same_pixels(picture: Picture) -> None:
    episode = episode_of(measured())
    assert np.array_equal(picture.draw(episode), picture.draw(episode))


def test_another_pose_gives_another_picture(picture: Picture) -> None:
    assert not np.array_equal(
        picture.draw(at_rest([30.0, -60.0])), picture.draw(at_rest([30.0, 60.0]))
    )


def test_a_record_shows(picture: Picture) -> None:
    before = picture.draw(at_rest([30.0, -60.0]))
    assert not np.array_equal(before, picture.draw(episode_of(measured())))


def test_a_record_without_excitation_shows_no_loop(picture: Picture) -> None:
    episode = episode_of(measured())
    episode.last = None  # as where gravity leaves the drives no torque
    words = texts(picture, episode)
    assert words[0] == "Record 1"
    assert "Nothing was shaken" in words[1]
    assert not any("healthy arm" in line for line in words)


def test_a_failed_record_says_so(picture: Picture) -> None:
    episode = episode_of(measured())
    assert episode.last is not None
    episode.last = replace(episode.last, failure="it diverged")
    episode.slots[:] = 0.0
    episode.ended = True
    assert "The measurement failed: this record says nothing." in texts(picture, episode)


@pytest.mark.parametrize("fault", [LOOSE, PLAY, ROCKS, BOTH], ids=lambda fault: fault.kind)
def test_the_fault_is_not_seen_before_the_end(picture: Picture, fault: Fault) -> None:
    # The same readings, whatever hides behind them.
    episode = episode_of(measured())
    honest = picture.draw(episode)
    episode.fault = fault
    assert np.array_equal(honest, picture.draw(episode))
    assert np.array_equal(honest, picture.draw(episode, verdict="structural_looseness@link2"))
    assert np.array_equal(
        picture.draw(at_rest([30.0, -60.0])), picture.draw(at_rest([30.0, -60.0], fault))
    )


def test_the_end_says_what_it_was(picture: Picture) -> None:
    episode = episode_of(measured())
    episode.ended = True
    found = {}
    for fault in (Healthy(), LOOSE, PLAY, ROCKS, BOTH):
        episode.fault = fault
        found[fault.hypothesis] = picture.draw(episode)
        title = {
            "healthy": "Nothing was loose",
            "structural_looseness": "Link 2 was loose (0.2 mm)",
            "backlash": "Joint 1 had play (0.057°)",
            "rotational_looseness": "Link 2 was loose and rocked (0.057°)",
            "compound_looseness": "Link 2 was loose in several directions (0.2 mm, 0.057°)",
        }[fault.kind]
        mark = "right" if fault is PLAY else "wrong"
        words = " ".join(texts(picture, episode, verdict="backlash@joint1"))
        assert words.startswith(f"{title} Verdict: joint 1 has play – {mark} ")
    assert len({pixels.tobytes() for pixels in found.values() if pixels is not None}) == 5


@pytest.mark.parametrize("make", [vera, scara], ids=["plane", "space"])
@pytest.mark.parametrize("fault", [PLAY, ROCKS, BOTH], ids=lambda fault: fault.kind)
def test_the_words_above_stay_in_the_figure_and_off_the_drawing(
    make: Callable[[], Arm], fault: Fault
) -> None:
    arm = make()
    pose = np.zeros(arm.n)
    pose[2:] = -4.0  # degrees; the SCARA's slide goes down by 70 mm
    env = measured(fault, arm=arm, levels=[2, *[0] * (arm.n - 1)], pose=pose)
    episode = episode_of(env)
    episode.ended = True
    picture = Picture(env.batch.nominal, show=False)
    figure = picture.figure(episode, verdict="compound_looseness@link2")
    figure.canvas.draw()
    header = [text.get_window_extent() for text in figure.texts if text.get_va() == "top"]
    assert len(header) >= 5
    assert max(box.x1 for box in header) < figure.bbox.x1
    assert min(box.y0 for box in header) > figure.axes[0].bbox.y1 - 3  # pixels


def test_the_words_name_joint_level_pose_and_correlation(picture: Picture) -> None:
    words = texts(picture, episode_of(measured()))
    assert words[:3] == [
        "Record 1",
        "Joint 2 shaken at level 2 (0.75 m/s²) for 0.2 s",
        "Pose 30°, −60°",
    ]
    assert "max" in words[3] and "on a healthy arm" in words[3]


@pytest.mark.parametrize("links", [2, 4, 7])
@pytest.mark.parametrize("vertical", [False, True], ids=["horizontal", "vertical"])
def test_every_planar_arm_can_be_drawn(links: int, vertical: bool) -> None:
    arm = planar(links, vertical=vertical)
    episode = at_rest(np.degrees(arm.random_pose(np.random.default_rng(0))))
    shown = Picture(LinearArm(arm), show=False)
    pixels = shown.draw(episode)
    assert pixels is not None and pixels.shape == (896, 720, 3)
    assert ("gravity" in all_texts(shown, episode)) is vertical


def test_the_arm_lies_where_its_joints_put_it() -> None:
    pose = np.radians([30.0, 40.0, -100.0])
    at = PlanarView(planar(3)).at(pose)
    headings = np.cumsum(pose)
    links = 0.3 * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    assert np.allclose(at.ends, np.cumsum(links, axis=0))
    last = headings[-1]
    turned = [[np.cos(last), -np.sin(last)], [np.sin(last), np.cos(last)]]
    assert np.allclose(at.frame, turned)


def test_gravity_points_down_in_the_picture() -> None:
    spec = planar(2).spec.copy()
    spec.option.gravity = [9.81, 0.0, 0.0]
    arm = changed(planar(2), spec)
    view = PlanarView(arm)
    assert view.vertical
    # The links lie along x at zero, which is down now.
    assert np.allclose(view.at(np.zeros(2)).tool, [0.0, -0.6])


def test_a_plane_s_view_refuses_an_arm_in_space_with_its_axes() -> None:
    spec = planar(2).spec.copy()
    spec.joint("joint2").axis = [0, 1, 0]
    with pytest.raises(InvalidSetting, match=r"moves in a plane.*planar2"):
        PlanarView(changed(planar(2), spec))


@pytest.mark.parametrize("levels", [(0, 2), (2, 0), (2, 3)])
def test_the_loop_is_that_of_the_statistics(levels: Sequence[int]) -> None:
    env = measured("structural_looseness@link2", levels=levels)
    measurement = episode_of(env).last
    assert measurement is not None
    loop = measured_loop(measurement)
    radius = np.linalg.norm(loop.points, axis=1)
    assert radius.max() == pytest.approx(loop.maximum, abs=1e-3)
    # At its ends the loop passes through the tool, along the direction of lowest correlation.
    assert radius[[0, -1]] == pytest.approx(0.0, abs=1e-6)


def test_one_shaken_joint_has_the_loop_of_that_joint() -> None:
    from loose_env.statistics import acceleration_from_angle, bandpass

    measurement = episode_of(measured("structural_looseness@link2")).last
    assert measurement is not None
    rate, band = measurement.rate, measurement.excitation.band
    joint = acceleration_from_angle(measurement.encoder[1:], rate, band)[0]
    tool = bandpass(measurement.tool, rate, band)
    loop = measured_loop(measurement)
    assert loop.maximum == pytest.approx(maximum_correlation(joint, tool).value)
    assert np.corrcoef(joint, np.asarray(loop.lowest) @ tool)[0, 1] == pytest.approx(0.0, abs=1e-9)
    for point in loop.points[60:-60:40]:
        r = float(np.linalg.norm(point))
        assert np.corrcoef(joint, np.asarray(point) @ tool)[0, 1] == pytest.approx(r)


def test_the_healthy_loop_is_that_of_the_nominal_arm() -> None:
    linear = LinearArm(planar(2))
    at = linear.at([0.3, 1.0])
    shake, _ = at_levels(at, np.array([0.0, 4.0]), duration=1.2)
    assert isinstance(shake, Excitation)
    floor = SensorFloor.of(SensorSuite(), linear.arm.band)
    prediction = predict(at, shake, floor)
    loop = predicted_loop(prediction)
    assert loop.maximum == pytest.approx(prediction.maximum_correlation)
    angles = [np.arctan2(d[1], d[0]) for d in (loop.lowest, prediction.lowest_direction)]
    assert axial_difference(*map(float, angles)) == pytest.approx(0.0, abs=1e-9)


def test_a_window_without_a_display_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib

    monkeypatch.setitem(matplotlib.rcParams, "backend", "agg")
    with pytest.raises(InvalidSetting, match="rgb_array"):
        Picture(LinearArm(vera()), show=True)


def test_without_matplotlib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any, **named: Any) -> Any:
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(LooseEnvError, match=r"loose-env\[report\]"):
        Picture(LinearArm(vera()), show=False)


def texts(picture: Picture, episode: Episode, verdict: str | None = None) -> list[str]:
    """The lines above the drawing, from the top."""
    return [text.get_text() for text in picture.figure(episode, verdict=verdict).texts]


def all_texts(picture: Picture, episode: Episode) -> list[str]:
    figure = picture.figure(episode)
    return [text.get_text() for text in [*figure.texts, *figure.axes[0].texts]]


def changed(arm: Arm, spec: mujoco.MjSpec) -> Arm:
    """The same arm of other parts."""
    return replace(arm, spec=spec)
