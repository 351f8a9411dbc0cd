"""Command-line arguments that construct the environment in scripts."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import gymnasium

import loose_env  # noqa: F401  (registers the ids)
from loose_env.envs import DiagnosisEnv, DiagnosisVectorEnv
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.registration import IDS, TIERS

__all__ = ["arguments_of", "diagnosis_env", "make_environments", "refused_in_words"]

MOST_SHOWN = 300
"""Letters of the arguments that an error repeats."""


def arguments_of(text: str) -> dict[str, Any]:
    """Parse the environment's arguments from the option ``--arguments``.

    Raises
    ------
    InvalidSetting
        If they are no JSON object.

    Examples
    --------
    >>> arguments_of('{"n_links": 3}')
    {'n_links': 3}
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidSetting(
            f"--arguments must be JSON such as '{{\"n_links\": 3}}': {error}"
        ) from error
    if not isinstance(found, dict):
        raise InvalidSetting(f"--arguments must be a JSON object, got {text!r:.100}")
    return found


def diagnosis_env(
    env_id: str, arguments: Mapping[str, Any], *, render_mode: str | None = None
) -> DiagnosisEnv:
    """Make the environment without Gymnasium's checking wrappers.

    Parameters
    ----------
    env_id : str
        Its id.
    arguments : mapping
        Its arguments.
    render_mode : str, optional
        How it draws itself.

    Raises
    ------
    UnknownName
        If it is no diagnosis environment.
    InvalidSetting
        If it does not take the arguments.
    gymnasium.error.Error
        If there is no such id.

    Examples
    --------
    >>> diagnosis_env("loose_env/Planar-v0", {"n_links": 3}).arm.n
    3
    """
    drawn = {} if render_mode is None else {"render_mode": render_mode}
    with refused_in_words(env_id, arguments):
        env = gymnasium.make(env_id, **drawn, **arguments).unwrapped  # type: ignore[arg-type]
    if not isinstance(env, DiagnosisEnv):
        known = ", ".join((*IDS, *TIERS))
        raise UnknownName(f"{env_id} is no diagnosis environment; those are {known}")
    return env


@contextmanager
def refused_in_words(env_id: str, arguments: Mapping[str, Any]) -> Iterator[None]:
    """Name the arguments that an environment does not accept, in a readable error.

    Raises
    ------
    InvalidSetting
        In place of a TypeError, or an OverflowError.

    Examples
    --------
    >>> with refused_in_words("loose_env/Vera-v0", {"durations": 0.2}):
    ...     tuple(0.2)
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidSetting: loose_env/Vera-v0 does not take {'durations': 0.2}: 'float'
    object is not iterable
    """
    try:
        yield
    except (TypeError, OverflowError) as error:
        # Gymnasium adds the arguments once more.
        reason = " ".join(str(error).split()).partition(" was raised from the environment")[0]
        shown = str(dict(arguments))
        shown = shown if len(shown) <= MOST_SHOWN else f"{shown[:MOST_SHOWN]}..."
        raise InvalidSetting(f"{env_id} does not take {shown}: {reason}") from error


def make_environments(env_id: str, num_envs: int, arguments: dict[str, Any]) -> DiagnosisVectorEnv:
    """Make the environments side by side.

    Raises
    ------
    UnknownName
        If the id is none of the registered ones, or no diagnosis.
    InvalidSetting
        If the arguments are refused, or the observation carries raw signals.
    """
    if env_id not in gymnasium.registry:
        raise UnknownName(f"unknown environment {env_id!r}; environments are {', '.join(IDS)}")
    with refused_in_words(env_id, arguments):
        env = gymnasium.make_vec(env_id, num_envs=num_envs, **arguments)
    if not isinstance(env, DiagnosisVectorEnv):
        raise UnknownName(f"{env_id} is no diagnosis environment; those are {', '.join(IDS)}")
    if env.settings.raw:
        raise InvalidSetting("a policy learns on statistics, not on raw signals: leave raw out")
    return env
