"""What cannot be done is refused with an error that says what was given and what is allowed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import Drift, Mismatch, planar, scara
from loose_env.envs import (
    DiagnosisEnv,
    DiagnosisSettings,
    DiagnosisVectorEnv,
    Difficulty,
    FaultSampler,
    ObservationLayout,
    Prices,
)
from loose_env.errors import InvalidAction, InvalidSetting, LooseEnvError, UnknownName
from loose_env.faults import Backlash, StructuralLooseness, hypotheses
from loose_env.registration import GAP_ID, IDS

NAN, INF = float("nan"), float("inf")
Make = Callable[..., Any]


def refused(error: type[Exception], *words: str) -> Any:
    """The package's own error, naming all of the words in order."""
    return pytest.raises(error, match="(?s)" + ".*".join(re.escape(word) for word in words))


MADE: list[tuple[str, dict[str, Any], type[LooseEnvError], tuple[str, ...]]] = [
    ("Planar", {"links": 3}, UnknownName, ("links", "n_links", "vertical", "hold")),
    ("Vera", {"rewards": 3}, UnknownName, ("rewards", "hold", "threads", "difficulty", "prices")),
    ("Vera", {"n_links": 3}, UnknownName, ("n_links", "hold")),
    ("SixAxis", {"model": "arm.xml"}, UnknownName, ("model", "hold")),
    ("Scara", {"n_links": 3}, UnknownName, ("n_links", "hold")),
    ("Arm", {"path": "arm.xml"}, UnknownName, ("path", "model", "tool", "joints", "hold")),
    ("Arm", {"model": "nowhere.xml"}, InvalidSetting, ("'nowhere.xml'", "MJCF or URDF")),
    ("Arm", {"model": 3}, InvalidSetting, ("path of an MJCF or URDF", "3")),
    ("Arm", {"tool": "hook"}, UnknownName, ("'hook'", "sites: 'tool'", "bodies: 'column'")),
    ("Arm", {"joints": 2}, InvalidSetting, ("list of names", "2", "'base', 'shoulder'")),
    *(
        ("Planar", {"n_links": n}, InvalidSetting, ("2 to 7 links", f"n_links={n!r}"))
        for n in (1, 8, 2.5, "4", None, True)
    ),
    *((env_id[10:-3], {"hold": "glue"}, UnknownName, ("'glue'", "'compliant'")) for env_id in IDS),
    ("Planar", {"hold": None}, UnknownName, ("None", "'compliant'")),
    ("Planar", {"durations": (0.2, 0.01)}, InvalidSetting, ("0.01 s", "(30.0, 150.0) Hz")),
    (
        "Planar",
        {"kinds": ("healthy", "rotational_looseness")},
        InvalidSetting,
        ("rotational_looseness", "no posterior", "reset("),
    ),
    ("Planar", {"kinds": ("healthy", "compound_looseness")}, UnknownName, ("kinds are",)),
    ("Planar", {"kinds": ["healthy", ["backlash"]]}, UnknownName, ("[['backlash']]", "kinds are")),
    ("Planar", {"rig": "x"}, LooseEnvError, ("rig",)),
    ("Planar", {"sensors": 3, "link_accelerometers": True}, InvalidSetting, ("a SensorSuite", "3")),
    ("Gap", {"model": 3}, InvalidSetting, ("path of an MJCF or URDF", "3")),
    ("Planar", {"max_moved": 5}, InvalidSetting, ("max_moved is 1 to 4", "got 5")),
    ("Vera", {"max_excited": 9}, InvalidSetting, ("max_excited is 1 to 2", "got 9")),
    *(
        ("Planar", {"levels": levels}, InvalidSetting, ("levels",))
        for levels in ([], [2, 1], [0.0, 1.0], ["a"], "12")
    ),
    *(
        ("Planar", {"gravity": gravity}, InvalidSetting, ("gravity",))
        for gravity in ((1.0, 2.0), (0, 0, NAN), "xyz", 9.81)
    ),
    *(
        ("Arm", {"tool_offset": offset}, InvalidSetting, ("tool_offset is three",))
        for offset in ((0.1, 0.2), "far", (NAN, 0, 0), 0.05)
    ),
]


@pytest.mark.parametrize(("name", "arguments", "error", "words"), MADE)
def test_arguments_that_make_no_environment_are_refused(
    name: str, arguments: dict[str, Any], error: type[LooseEnvError], words: tuple[str, ...]
) -> None:
    (env_id,) = (own for own in (*IDS, GAP_ID) if own[10:-3] == name)
    for make in (gymnasium.make, gymnasium.make_vec):
        with refused(error, *words):
            make(env_id, **arguments)  # type: ignore[operator]


SETTINGS: list[tuple[str, Any, str]] = [
    *(("max_records", value, "whole number, 1 or more") for value in (0, -1, 2.5, "12", True)),
    *(("moves", value, "0 among them") for value in ((-45.0, 45.0), (), (0.0, NAN), (0.0, "45"))),
    *(
        ("durations", value, "positive seconds")
        for value in ((), (0.2, 0.0), (0.2, -1.0), (NAN,), (INF,))
    ),
    ("max_excited", 0, "whole number, 1 or more"),
    ("prices", {"record": 0.1}, "prices must be a Prices"),
    ("prices", None, "prices must be a Prices"),
    ("sensors", 1000.0, "sensors must be a SensorSuite"),
    ("kinds", ("healthy", "backlash", "backlash"), "named once"),
    ("kinds", ("backlash",), "add it to the kinds, got"),
    ("kinds", (), '"healthy" is always a hypothesis'),
    ("kinds", "healthy", "several names out of"),
    ("kinds", None, "several names out of"),
]
PRICES: list[tuple[str, Any, str]] = [
    *(
        (name, value, "finite number, zero or more")
        for name in ("record", "second", "level", "move")
        for value in (-0.1, NAN, INF, "1", None)
    ),
    *((name, NAN, "finite number") for name in ("correct", "wrong", "false_alarm", "miss")),
    *((name, "1", "finite number") for name in ("unsure", "false_alarm", "miss")),
    *((name, None, f"Prices.{name}") for name in ("correct", "wrong", "unsure")),
]
RANGES = ((0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (1.0, INF), (NAN, 1.0))
DIFFICULTY: list[tuple[str, Any, str]] = [
    *(
        (name, limits, "0 < low <= high")
        for name in ("friction", "gap", "contact_mode", "contact_damping")
        for limits in RANGES
    ),
    *(
        ("kinds", kinds, "sum to 1")
        for kinds in ({}, {"healthy": 0.5}, {"healthy": 1.5, "backlash": -0.5}, {"healthy": NAN})
    ),
]


@pytest.mark.parametrize(
    ("make", "name", "value", "words"),
    [
        (make, *row)
        for make, rows in (
            (DiagnosisSettings, SETTINGS),
            (Prices, PRICES),
            (Difficulty, DIFFICULTY),
        )
        for row in rows
    ],
)
def test_a_bad_setting_is_refused(make: Any, name: str, value: Any, words: str) -> None:
    with refused(InvalidSetting, words):
        make(**{name: value})


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: DiagnosisSettings(difficulty="mad"), UnknownName, ("'mad'", "'easy', 'default'")),
        (lambda: DiagnosisSettings(difficulty=3), UnknownName, ("3", "'easy', 'default'")),  # type: ignore[arg-type]
        (lambda: hypotheses(planar(2), ("healthy", "rust")), UnknownName, ("rust", "backlash")),
        (lambda: Difficulty(kinds={"rust": 1.0}), UnknownName, ("'rust'", "'backlash'")),
        (
            lambda: Difficulty(kinds={"rotational_looseness": 1.0}),
            InvalidSetting,
            ("no posterior", "reset("),
        ),
        (lambda: Difficulty(friction_over="mean"), InvalidSetting, ("friction_over", "'mean'")),  # type: ignore[arg-type]
        (lambda: Mismatch(mass=-0.1), InvalidSetting, ("mass", "zero or more", "-0.1")),
        (lambda: Drift(gain=-0.1), InvalidSetting, ("gain", "-0.1")),
        (
            lambda: DiagnosisEnv(replace(scara(), joint_ranges=(None,) * 4)),
            InvalidSetting,
            ("joint3", "slides", "(low, high)"),
        ),
        (
            lambda: gymnasium.make("loose_env/Vera-v0", render_mode="ascii").unwrapped,
            UnknownName,
            ("'ascii'", "rgb_array"),
        ),
        (
            lambda: ObservationLayout(planar(2), DiagnosisSettings()).physical(
                np.zeros(2, np.float32), "speed"
            ),
            UnknownName,
            ("no group 'speed'", "'now.sin_pose'", "'transmission'"),
        ),
    ],
)
def test_what_does_not_exist_is_refused(call: Any, error: Any, words: tuple[str, ...]) -> None:
    with refused(error, *words):
        call()


def test_a_difficulty_hides_hypotheses_alone() -> None:
    from loose_env.arms import LinearArm

    own, few = Difficulty(kinds={"backlash": 0.25, "healthy": 0.75}), ("healthy",)
    for make in (
        lambda: DiagnosisSettings(difficulty=own, kinds=few),  # type: ignore[arg-type]
        lambda: FaultSampler(LinearArm(planar(2)), own, few),
    ):
        with refused(InvalidSetting, "hides ['backlash'], but only", "add"):
            make()
    sampler = FaultSampler(LinearArm(planar(2)), Difficulty())
    for name in ("rotational_looseness@link1", "backlash@joint3", "backlash"):
        with refused(UnknownName, f"hypothesis '{name}'", "'backlash@joint2'"):
            sampler.draw(np.random.default_rng(0), hypothesis=name)
    with refused(InvalidSetting, "2 to 2"):
        sampler.several(np.random.default_rng(0), count=3)


def slide(link: int) -> StructuralLooseness:
    return StructuralLooseness(link=link, direction=(1, 0, 0), gap=1e-4, stiffness=(1e4, 1e4))


@pytest.fixture(scope="module")
def pairs() -> Iterator[list[tuple[Any, Any]]]:
    """Environments and batches, two alike each, which were reset together."""
    arm, settings = planar(2), DiagnosisSettings()
    envs = [DiagnosisEnv(arm, settings, threads=1) for _ in range(2)]
    batches = [DiagnosisVectorEnv(arm, settings, num_envs=2, threads=1) for _ in range(2)]
    made: list[Any] = [*envs, *batches]
    for each in made:
        each.reset(seed=0)
    yield [(made[0], made[1]), (made[2], made[3])]
    for each in made:
        each.close()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        *(
            ({"fault": fault}, UnknownName, (repr(fault), "'healthy'", "'backlash@joint2'"))
            for fault in ("rust", "backlash@joint3", "backlash", "", 3, ["healthy"])
        ),
        ({"fault": slide(7)}, UnknownName, ("'planar2'", "links 1 to 2", "got 7")),
        ({"fault": slide(0)}, UnknownName, ("'planar2'", "links 1 to 2", "got 0")),
        (
            {"fault": Backlash(joint=1, gap=1e-4, stiffness=(1e12, 1e3))},
            InvalidSetting,
            ("1e+12", "too fast for a step"),
        ),
        *(
            ({"pose": pose}, InvalidSetting, ("2 finite numbers", repr(pose)))
            for pose in ([0.1], [0.1, 0.2, 0.3], [0.1, NAN], [INF, 0.0], "ab", 0.5)
        ),
        ({"pose": [0.0, 3.0]}, InvalidSetting, ("[0.0, 3.0]", "ranges", "2.617")),
        ({"foult": 1}, UnknownName, ("'foult'", "'fault', 'pose', 'mismatch_scale', 'preload_g'")),
        *(
            ({name: value}, InvalidSetting, (name, "finite number", repr(value)))
            for name in ("mismatch_scale", "preload_g")
            for value in (NAN, INF, "3", True, [3.0])
        ),
        ({"mismatch_scale": -1.0}, InvalidSetting, ("mismatch", "zero or more")),
        ({"mismatch_scale": 4.0}, InvalidSetting, ("mismatch", "must be below 0.33")),
    ],
)
def test_options_of_reset_that_cannot_be_are_refused_and_change_nothing(
    pairs: list[tuple[Any, Any]], options: dict[str, Any], error: Any, words: tuple[str, ...]
) -> None:
    for env, plain in pairs:
        with refused(error, *words):
            env.reset(options=options)
        np.testing.assert_array_equal(env.reset()[0], plain.reset()[0])


@pytest.mark.parametrize(
    ("reset", "words"),
    [
        *(({"seed": seed}, ("whole number, zero or more", repr(seed))) for seed in (-1, 1.5, "a")),
        *(({"seed": seeds}, ("2 seeds", f"got {len(seeds)}")) for seeds in ([], [1], [1, 2, 3])),
        ({"seed": [1, -1]}, ("whole number, zero or more", "-1")),
        *(
            ({"options": {"reset_mask": mask}}, ("reset_mask", "2 booleans", repr(mask)))
            for mask in (np.array([True]), np.array([False, False]), np.array([1, 0]), "yes")
        ),
        *(
            ({"options": {"env_options": own}}, ("env_options",))
            for own in ({"fault": "healthy"}, [None], ["healthy"] * 2)
        ),
    ],
)
def test_a_reset_of_a_batch_that_cannot_be_is_refused(
    make_vector: Make, reset: dict[str, Any], words: tuple[str, ...]
) -> None:
    env = make_vector(n_links=2)
    env.reset(seed=0)
    with refused(InvalidSetting, *words):
        env.reset(**reset)


def test_a_batch_that_cannot_be_is_refused(make_vector: Make) -> None:
    for number in (0, -1, True):
        with refused(InvalidSetting, "num_envs", "1 or more", repr(number)):
            make_vector(n_links=2, num_envs=number)
    for mode in ("Sometimes", None, 3):
        with refused(InvalidSetting, "NextStep"):
            gymnasium.make_vec("loose_env/Planar-v0", num_envs=2, autoreset_mode=mode)
    with pytest.raises(gymnasium.error.Error, match="Seed must"):
        gymnasium.make("loose_env/Planar-v0", n_links=2).reset(seed=-1)


GOOD = [2, 2, 1, 0, 0, 0]
WHOLE = ("2 joints", "6 whole numbers", "0 to [4, 4, 3, 3, 2, 6]", "got")


@pytest.mark.parametrize(
    "action",
    [
        *([2, 2, 1, 0, 0], [*GOOD, 0], [GOOD], 2, None, "221000", [[2], [2, 1]], {}),
        *([*GOOD[:-1], last] for last in (0.5, NAN, 1j, None, 10**30)),
        [str(entry) for entry in GOOD],
        [True, True, True, False, False, False],
        *(
            [*GOOD[:k], value, *GOOD[k + 1 :]]
            for k in range(6)
            for value in (-1, 9, INF, -INF, 1e300)
        ),
    ],
    ids=repr,
)
def test_an_action_that_is_none_is_refused(
    action: Any, make_env: Make, request: pytest.FixtureRequest
) -> None:
    env = make_env(n_links=2)
    env.reset(seed=0)
    with refused(InvalidAction, *WHOLE):
        env.step(action)


def test_a_refused_action_leaves_the_episode_as_it_was(make_env: Make, make_vector: Make) -> None:
    for make, rows in ((make_env, 1), (make_vector, 2)):
        env, plain = make(n_links=2), make(n_links=2)
        good = env.actions.encode(levels=np.array([1, 1]), duration=0)
        actions = good if rows == 1 else np.stack([good] * 2)
        for each in (env, plain):
            each.reset(seed=0)
            each.step(actions)
        bad = np.array(actions)
        bad[..., -1] = 99
        with refused(InvalidAction, "0 to", "99"):
            env.step(bad)
        np.testing.assert_array_equal(env.step(actions)[0], plain.step(actions)[0])


@pytest.mark.parametrize("shape", [(6,), (3, 6), (1, 6), (2, 6, 1)])
def test_actions_of_a_batch_are_one_row_for_each_environment(
    make_vector: Make, shape: tuple[int, ...]
) -> None:
    env = make_vector(n_links=2)
    env.reset(seed=0)
    with refused(InvalidAction, "shape (2, 6)", f"got {shape}"):
        env.step(np.zeros(shape, dtype=int))
    with refused(InvalidAction, "shape (2, 6)"):
        env.step([GOOD, [2]])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"levels": [3]}, "levels: 3 whole numbers from 0 to 3"),
        ({"levels": [4, 0, 0]}, "levels"),
        ({"levels": [0, 0, 2.7]}, "levels"),
        ({"moves": [7, 2, 2]}, "moves: 3 whole numbers from 0 to 4"),
        ({"moves": [2, -1, 2]}, "moves"),
        ({"duration": 3}, "duration and verdict"),
        ({"verdict": -1}, "duration and verdict"),
    ],
)
def test_an_action_is_not_built_of_what_is_no_choice(
    make_env: Make, given: dict[str, Any], words: str
) -> None:
    for rules in ({}, {"max_excited": 1, "max_moved": 1}):
        with refused(InvalidAction, words):
            make_env(n_links=3, **rules).actions.encode(**given)


def test_whole_numbers_may_come_in_any_type(make_env: Make) -> None:
    env = make_env(n_links=2)
    seen = []
    for kind in (np.int64, np.int8, np.uint16, np.float32, list):
        env.reset(seed=0)
        action = env.actions.encode(levels=np.array([1, 2]), duration=0)
        seen.append(env.step(action.tolist() if kind is list else action.astype(kind))[0])
    for other in seen[1:]:
        np.testing.assert_array_equal(other, seen[0])


def test_nothing_goes_before_the_first_reset(make_env: Make, make_vector: Make) -> None:
    env, batch = make_env(n_links=2), make_vector(n_links=2)
    drawn: Any = gymnasium.make("loose_env/Vera-v0", render_mode="rgb_array").unwrapped
    for call in (
        lambda: env.step(env.actions.encode()),
        env.action_masks,
        lambda: batch.step(np.stack([env.actions.encode()] * 2)),
        batch.action_masks,
        lambda: batch.reset(options={"reset_mask": np.array([True, False])}),
        drawn.render,
    ):
        with pytest.raises(ResetNeeded, match="reset"):
            call()
    env.reset(seed=0)
    with refused(UnknownName, "render_mode", "'rgb_array'"):
        env.render()
