"""Shells of the wrappers: what a `Change` makes of B arms, around one environment or a batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from loose_env.envs import DiagnosisEnv, DiagnosisVectorEnv
from loose_env.errors import InvalidSetting
from loose_env.typing import IndexArray


class Change:
    """Base of what a wrapper changes, as functions of the arrays of B arms; by default nothing.

    A subclass says what it shows and takes, once; with a shell it is a wrapper of one environment,
    which is a batch of one, or of a batch.
    """

    diagnosis: DiagnosisEnv | DiagnosisVectorEnv
    """The environment within all wrappers."""
    num: int
    """Number of arms, B."""
    of_inner: Callable[[str], Any]
    """Attribute of what is wrapped."""
    set_space: Callable[[str, spaces.Space[Any]], None]
    """Says what one arm shows or takes: "observation" or "action"."""

    def __init__(self, env: Any, **arguments: Any) -> None:
        super().__init__(env, **arguments)  # type: ignore[call-arg]

    def shown(self, observations: NDArray[np.float32], at: IndexArray) -> NDArray[np.float32]:
        """Observations of some arms as they are shown (A, ...)."""
        return observations

    def told(self, at: IndexArray) -> dict[str, NDArray[Any]]:
        """Further entries of the infos of some arms (A, ...), after `shown`."""
        return {}

    def inner_actions(self, actions: Any) -> Any:
        """Actions of what is wrapped (B, ...)."""
        return actions

    def masks(self, inner: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Allowed choices (A, choices) where those of what is wrapped are given."""
        return inner


_ONE = np.array([0])


def _checked(wrapper: Change, inner: Any, kind: type[Any], other: str) -> None:
    """Refuse what is no diagnosis environment of a kind, or shows raw signals."""
    name = type(wrapper).__name__
    if not isinstance(inner, kind):
        raise InvalidSetting(
            f"{name} wraps a {kind.__name__}, alone or within other wrappers; got "
            f"{type(inner).__name__}. {other}"
        )
    if inner.settings.raw:
        raise InvalidSetting(
            f"{name} takes the flat observation: make the environment without raw=True"
        )


class DiagnosisWrapper(
    Change, gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs
):
    """A Gymnasium wrapper around a single diagnosis environment, or a wrapped one.

    Parameters
    ----------
    env : gymnasium.Env
        The environment.
    **arguments
        Arguments of the subclass, from which Gymnasium makes the wrapper anew.

    Raises
    ------
    InvalidSetting
        If it is no single diagnosis environment, or shows raw signals.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], **arguments: Any) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, **arguments)
        inner: Any = getattr(env, "unwrapped", env)
        _checked(self, inner, DiagnosisEnv, "For a batch take loose_env.wrappers.vector")
        gymnasium.Wrapper.__init__(self, env)
        self.diagnosis, self.num = inner, 1

    def of_inner(self, name: str) -> Any:
        """Attribute of what is wrapped."""
        return self.env.get_wrapper_attr(name)

    def set_space(self, name: str, space: spaces.Space[Any]) -> None:
        """Say what is shown or taken: "observation" or "action"."""
        setattr(self, f"{name}_space", space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self.shown(observation[None], _ONE)[0], self._informed(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take a step."""
        observation, reward, terminated, truncated, info = self.env.step(
            self.inner_actions([action])[0]
        )
        shown = self.shown(observation[None], _ONE)[0]
        return shown, reward, terminated, truncated, self._informed(info)

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the next action, in the form MaskablePPO takes."""
        return np.asarray(self.masks(self.of_inner("action_masks")()[None])[0])

    def _informed(self, info: dict[str, Any]) -> dict[str, Any]:
        own = {name: values[0] for name, values in self.told(_ONE).items()}
        return {**info, "action_mask": self.masks(info["action_mask"][None])[0], **own}


class DiagnosisVectorWrapper(Change, VectorWrapper[Any, Any, Any, Any, Any]):
    """A wrapper around a batch of diagnosis environments, or a wrapped one.

    Parameters
    ----------
    env : DiagnosisVectorEnv or DiagnosisVectorWrapper
        The batch, as ``gymnasium.make_vec`` gives it.

    Raises
    ------
    InvalidSetting
        If it is no such batch, or shows raw signals.
    """

    def __init__(self, env: Any, **arguments: Any) -> None:
        inner = getattr(env, "unwrapped", env)
        _checked(self, inner, DiagnosisVectorEnv, "For one environment take loose_env.wrappers")
        VectorWrapper.__init__(self, env)
        self.diagnosis, self.num = inner, inner.num_envs
        self._all = np.arange(self.num)

    def of_inner(self, name: str) -> Any:
        """Attribute of what is wrapped."""
        own = self.env
        while not hasattr(own, name) and isinstance(own, VectorWrapper):
            own = own.env
        return getattr(own, name)

    def set_space(self, name: str, space: spaces.Space[Any]) -> None:
        """Say what one arm shows or takes: "observation" or "action"."""
        setattr(self, f"single_{name}_space", space)
        setattr(self, f"{name}_space", batch_space(space, self.num))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every environment, or in those of `options["reset_mask"]`."""
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        return self.shown(observations, self._all), self._informed(infos)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step every environment; those that end begin anew as the batch's mode says."""
        found = self.env.step(self.inner_actions(actions))
        observations, rewards, terminated, truncated, infos = found
        if "final_obs" in infos:
            at, shown = np.flatnonzero(infos["_final_obs"]), np.full(self.num, None, dtype=object)
            finals = self.shown(np.stack(infos["final_obs"][at]), at)
            for i, own in zip(at, finals, strict=True):
                shown[i] = own
            infos |= {"final_obs": shown, "final_info": self._informed(infos["final_info"])}
        return (
            self.shown(observations, self._all),
            rewards,
            terminated,
            truncated,
            self._informed(infos),
        )

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the next actions (num_envs, choices)."""
        return self.masks(self.of_inner("action_masks")())

    def _informed(self, infos: dict[str, Any]) -> dict[str, Any]:
        """Infos with this wrapper's masks, and its entries where there are masks."""
        there = infos["_action_mask"]
        masks = np.where(there[:, None], self.masks(infos["action_mask"]), False)
        own: dict[str, Any] = {}
        for name, values in self.told(self._all).items():
            own |= {name: values, f"_{name}": there.copy()}
        return {**infos, "action_mask": masks, **own}
