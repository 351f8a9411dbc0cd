"""Pictures: what they say and hide, where parts are seen, the correlation by direction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

pytest.importorskip("matplotlib")

from loose_env.arms import DESK_ARM, Arm, LinearArm, arm_from_file, planar, scara, six_axis, vera
from loose_env.diagnosis import SensorFloor, predict
from loose_env.envs import (
    ArmDrawing,
    CorrelationByDirection,
    DiagnosisEnv,
    DiagnosisSettings,
    Picture,
    measured_correlation,
    predicted_correlation,
)
from loose_env.errors import LooseEnvError, UnknownName
from loose_env.excitation import at_levels
from loose_env.faults import (
    Backlash,
    Fault,
    Healthy,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
)
from loose_env.sensors import SensorSuite
from loose_env.statistics import (
    Covariances,
    acceleration_from_angle,
    bandpass,
    lowest_coherence_direction_from,
)

ARMS: dict[str, Callable[[], Arm]] = {
    "vera": vera,
    "planar": lambda: planar(7),
    "vertical": lambda: planar(3, vertical=True),
    "six_axis": six_axis,
    "scara": scara,
    "desk": lambda: arm_from_file(DESK_ARM),
}
STOPS: Any = {"gap": 2e-4, "stiffness": (1e6, 1e6), "damping": (100.0, 100.0)}
LOOSE = StructuralLooseness(link=2, direction=(0.0, 1.0, 0.0), **STOPS)
PLAY = Backlash(joint=1, gap=1e-3, stiffness=(1e5, 1e5))
ROCKS = RotationalLooseness(link=2, axis=(0.0, 0.0, 1.0), gap=1e-3, stiffness=(1e5, 1e5))
TITLES = [
    (Healthy(), "Nothing was loose"),
    (LOOSE, "Link 2 was loose (0.2 mm)"),
    (PLAY, "Joint 1 had play (0.057°)"),
    (ROCKS, "Link 2 was loose and rocked (0.057°)"),
    (SeveralFaults(faults=(PLAY, LOOSE)), "Joint 1 had play (0.057°); link 2 was loose (0.2 mm)"),
]


def measured(arm: Arm, fault: Fault | str = "healthy", joint: int = 1, **given: Any) -> Any:
    """An environment after one short record with one joint shaken."""
    settings = DiagnosisSettings(difficulty="easy")
    env = DiagnosisEnv(arm, settings, render_mode="rgb_array", threads=1)
    env.reset(seed=3, options={"fault": fault, **given})
    env.step(env.actions.encode(levels=2 * np.eye(arm.n, dtype=int)[joint], duration=0))
    return env


def correlation_along(joint: Any, tool: Any, direction: Any) -> float:
    """Correlation of a joint's motion with the tool's along a direction."""
    return float(np.corrcoef(joint, direction @ tool)[0, 1])


def words_of(picture: Picture, shown: Any, verdict: str | None = None) -> list[str]:
    """All that is written of an environment or an episode, in lines, from the top."""
    episode = shown.batch.episode(0) if isinstance(shown, DiagnosisEnv) else shown
    figure = picture.figure(episode, verdict=verdict)
    texts = [text for part in (figure, *figure.axes) for text in part.texts]
    return [line for text in texts for line in text.get_text().split("\n")]


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("vera", "six_axis") else pytest.param(name, marks=pytest.mark.slow)
        for name in ARMS
    ],
)
def test_every_arm_can_be_drawn(name: str) -> None:
    arm = ARMS[name]()
    env = measured(arm)
    pixels = env.render()
    assert pixels.shape == (1056, 896, 3) and pixels.dtype == np.uint8
    episode, picture = env.batch.episode(0), Picture(env.batch.nominal)
    figure = picture.figure(episode)
    d = len(arm.axes)
    assert len(figure.axes) == 1 + d * (d - 1) // 2  # the arm, and a plane of each pair of axes
    words = words_of(picture, env)
    assert {str(j + 1) for j in range(arm.n)} | set("xyz"[:d]) <= set(words)
    assert ("seen from above" in words) is (name in ("vera", "planar"))
    episode.pose = arm.random_pose(np.random.default_rng(5))
    assert not np.array_equal(pixels, picture.draw(episode))
    env.close()


def test_the_words_name_joint_level_pose_and_correlation() -> None:
    env = measured(vera(), pose=np.radians([30.0, -60.0]))
    words = words_of(Picture(env.batch.nominal), env)
    shaken = "Joint 2 shaken at level 2 (0.75 m/s²) for 0.2 s"
    assert words[:3] == ["Record 1", shaken, "Pose 30°, −60°"]
    assert words[3].startswith("Highest correlation") and "healthy arm" in words[3]
    env = measured(scara(), pose=[0.5, -0.5, -0.08, 0.0])
    assert "Pose 29°, −29°, −80 mm, 0°" in words_of(Picture(env.batch.nominal), env)


def test_a_record_that_shows_nothing_says_why() -> None:
    env = measured(vera())
    picture, episode = Picture(env.batch.nominal), env.batch.episode(0)
    last, episode.last = episode.last, None  # as where gravity leaves the drives no torque
    words = words_of(picture, episode)
    assert "Nothing was shaken" in words[1] and not any("healthy arm" in line for line in words)
    episode.last = replace(last, failure="it diverged")
    episode.slots[:] = 0.0
    assert "The measurement failed: this record says nothing." in words_of(picture, episode)


@pytest.mark.parametrize(("fault", "title"), TITLES, ids=lambda given: getattr(given, "kind", ""))
def test_the_fault_is_seen_at_the_end_and_not_before(fault: Fault, title: str) -> None:
    env = measured(vera())
    episode, picture = env.batch.episode(0), Picture(env.batch.nominal)
    before = picture.draw(episode)
    episode.fault = fault  # the same readings, whatever hides behind them
    assert np.array_equal(before, picture.draw(episode, verdict="structural_looseness@link2"))
    episode.ended = True
    words = " ".join(words_of(picture, episode, "backlash@joint1"))
    mark = "right" if fault is PLAY else "wrong"
    assert words.startswith(f"{title} Verdict: joint 1 has play – {mark} ")
    assert "Verdict: unsure" in words_of(picture, episode, "unsure")
    drawing = ArmDrawing(vera())
    plain, pointed = drawing.marks(episode.pose), drawing.marks(episode.pose, fault=fault)
    changed = len(plain) != len(pointed) or any(
        a.color != b.color for a, b in zip(plain, pointed, strict=True)
    )
    assert changed is (fault.kind != "healthy")


def test_the_arm_lies_where_its_joints_put_it() -> None:
    pose = np.radians([30.0, 40.0, -100.0])
    drawing = ArmDrawing(planar(3))
    links = [mark for mark in drawing.marks(pose) if mark.kind == "link"]
    headings = np.cumsum(pose)
    ends = np.cumsum(0.3 * np.stack([np.cos(headings), np.sin(headings)], axis=1), axis=0)
    seen = np.array([drawing.camera[:2] @ link.end for link in links])
    np.testing.assert_allclose(seen, ends, atol=1e-12)


def test_the_checker_of_gymnasium_passes_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    check_env(gymnasium.make("loose_env/Planar-v0", n_links=2, durations=(0.2,)).unwrapped)
    with pytest.raises(UnknownName, match="HumanRendering"):
        gymnasium.make("loose_env/Planar-v0", render_mode="human")


def test_without_matplotlib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(LooseEnvError, match=r"loose-env\[report\]"):
        Picture(LinearArm(vera()))


# ---- the correlation by direction


def multiple_correlation(x: np.ndarray, a: np.ndarray) -> float:
    design = np.vstack((a, np.ones(len(x)))).T
    residual = x - design @ np.linalg.lstsq(design, x, rcond=None)[0]
    return float(np.sqrt(1 - residual.var() / x.var()))


@pytest.mark.parametrize("name", ["vera", "six_axis", "scara"])
def test_the_correlation_of_one_shaken_joint_is_that_of_the_statistics(name: str) -> None:
    env = measured(ARMS[name](), "structural_looseness@link2")
    measurement = env.batch.episode(0).last
    rate, band = measurement.rate, measurement.excitation.band
    joint = acceleration_from_angle(measurement.encoder[1:2], rate, band)[0]
    tool = bandpass(measurement.tool, rate, band)
    found = measured_correlation(measurement)
    assert found.maximum == pytest.approx(multiple_correlation(joint, tool))
    directions = np.random.default_rng(0).standard_normal((30, len(tool)))
    for direction, r in zip(directions, found.along(directions), strict=True):
        assert r == pytest.approx(correlation_along(joint, tool, direction), abs=1e-9)
    for axes in combinations(range(len(tool)), 2):
        points, lowest = found.section(*axes)
        direction = np.zeros(len(tool))
        for point in points[60:-60:40]:
            direction[list(axes)] = point
            r = correlation_along(joint, tool, direction)
            assert r == pytest.approx(np.linalg.norm(point), abs=1e-9)
        assert lowest is not None
        direction[list(axes)] = lowest
        assert found.along(direction[None])[0] == pytest.approx(0.0, abs=1e-9)


def test_a_tool_axis_that_stands_still_leaves_the_planes_finite() -> None:
    still = Covariances(
        xx=np.eye(1), xa=np.array([[2.0, 0.0, 0.0]]), aa=np.diag([4.0, 0.0, 0.0]), count=100
    )
    found = CorrelationByDirection.of(still)
    assert found.maximum == pytest.approx(1.0)
    assert all(np.isfinite(found.section(*axes)[0]).all() for axes in ((0, 1), (0, 2), (1, 2)))
    assert found.section(1, 2)[1] is None


@pytest.mark.parametrize(
    ("arm", "levels"),
    [(planar(2), [0, 4]), (six_axis(), [0, 2, 0, 0, 0, 0]), (six_axis(), [2, 0, 0, 0, 2, 0])],
    ids=["plane", "one joint", "two joints"],
)
def test_the_healthy_arm_s_correlation_is_that_of_the_prediction(
    arm: Arm, levels: list[int]
) -> None:
    linear = LinearArm(arm)
    at = linear.at(np.array([0.3, -1.0, 1.2, 0.4, 0.6, -0.2])[: arm.n])
    shake, _ = at_levels(at, np.array(levels, dtype=float), duration=1.2)
    prediction = predict(at, shake, SensorFloor.of(SensorSuite(), arm.band))
    found = predicted_correlation(prediction)
    lowest = lowest_coherence_direction_from(prediction.covariances.x_a)
    assert found.maximum == pytest.approx(np.sqrt(lowest.coherences[-1]))
    # The direction of lowest coherence is one in which the correlation vanishes.
    assert found.along(lowest.direction[None])[0] == pytest.approx(0.0, abs=1e-6)
