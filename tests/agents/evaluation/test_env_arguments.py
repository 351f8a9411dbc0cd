"""The environment's arguments as scripts take them: what is wrong is said in one line."""

from __future__ import annotations

import gymnasium
import pytest
from loose_agents.evaluation import arguments_of, diagnosis_env
from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.rl.hyperparameters import key_values

from loose_env.errors import InvalidSetting, LooseEnvError, UnknownName


def test_arguments_are_those_that_json_says() -> None:
    found = arguments_of('{"n_links": 3, "durations": [0.2], "vertical": true}')
    assert found == {"n_links": 3, "durations": [0.2], "vertical": True}
    env = diagnosis_env("loose_env/Planar-v0", found)
    assert env.arm.n == 3
    assert env.settings.durations == [0.2]


@pytest.mark.parametrize(
    "text", ["", "n_links", '{"n_links": 3', "[3]", "3", "[" * 100_000, "9" * 5000]
)
def test_arguments_that_are_no_json_object_are_refused(text: str) -> None:
    with pytest.raises(InvalidSetting, match="--arguments must be") as caught:
        arguments_of(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "word",
    [
        "n_links",
        ":3",
        "n_links:",
        "n_links:[3",
        "n_links:open(3)",
        "n_links:dict(**{})",
        "n_links:{**{}}",
        "n_links:" + "-" * 100_000 + "1",
        "n_links:" + "1+" * 3000 + "1",
    ],
)
def test_key_values_that_cannot_be_read_are_refused(word: str) -> None:
    with pytest.raises(InvalidSetting, match="--env-kwargs") as caught:
        key_values([word], "--env-kwargs")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"n_links": "three"}, "n_links='three'"),
        ({"colour": 1}, "unknown arguments"),
        ({"durations": 0.2}, r"durations must be positive seconds, one or more; got 0\.2$"),
        ({"id": 1}, "does not take"),
        ({"engine": "fast"}, "engine is one of"),
        ({"link_accelerometers": "yes"}, "must be true or false"),
    ],
)
def test_arguments_that_the_environment_does_not_take_are_refused_in_words(
    arguments: dict[str, object], says: str
) -> None:
    with pytest.raises(LooseEnvError, match=says) as caught:
        diagnosis_env("loose_env/Planar-v0", arguments)
    assert "\n" not in str(caught.value)


def test_accelerometers_on_links_can_be_asked_for_in_json() -> None:
    arguments = arguments_of('{"n_links": 2, "link_accelerometers": true}')
    assert diagnosis_env("loose_env/Planar-v0", arguments).settings.sensors.on_links is not None
    assert diagnosis_env("loose_env/Planar-v0", {"n_links": 2}).settings.sensors.on_links is None


def test_other_environments_are_refused() -> None:
    with pytest.raises(UnknownName, match="no diagnosis environment"):
        diagnosis_env("CartPole-v1", {})
    with pytest.raises(gymnasium.error.NameNotFound):
        diagnosis_env("loose_env/Vero-v0", {})


def test_errors_end_a_script_in_one_line_and_faults_of_it_do_not() -> None:
    with pytest.raises(SystemExit, match=r"^train: no such arm$"), errors_in_one_line("train"):
        raise UnknownName("no such arm")
    with (
        pytest.raises(SystemExit, match=r"^train: interrupted; again$"),
        errors_in_one_line("train", interrupted="again"),
    ):
        raise KeyboardInterrupt
    with pytest.raises(SystemExit, match=r"^train: interrupted$"), errors_in_one_line("train"):
        raise KeyboardInterrupt
    with pytest.raises(AssertionError), errors_in_one_line("train"):
        raise AssertionError
