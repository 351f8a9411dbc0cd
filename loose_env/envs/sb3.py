"""Environments as stable-baselines3 wants them: the native batch, and keyed seeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from loose_env.envs.env import new_seed
from loose_env.envs.vector_env import DiagnosisVectorEnv, batch_seeds
from loose_env.errors import InvalidSetting, UnknownName

_SHARED = {
    **{name: f"single_{name}" for name in ("action_space", "observation_space")},
    **{name: name for name in ("actions", "arm", "hypotheses", "layout", "metadata")},
    **{name: name for name in ("render_mode", "settings", "spec", "verdicts")},
}
"""Attributes that are the same object for every environment of a batch, by their name there."""


class _Keyed(VecEnv):
    """Environments whose seeds are those of `loose_env.envs.batch_seeds`."""

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the next reset; return each environment's seed."""
        self._seeds = [*batch_seeds(new_seed() if seed is None else int(seed), self.num_envs)]
        return list(self._seeds)


class KeyedDummyVecEnv(_Keyed, DummyVecEnv):
    """Single environments whose seeds are those of `loose_env.envs.batch_seeds`.

    For the ``vec_env_cls`` of stable-baselines3's ``make_vec_env``, whose own seeds count up: of 16
    environments each, those of seeds 0 and 1 would play 15 runs of episodes in common.
    """


class Sb3VecEnv(_Keyed):
    """The native vector environment as stable-baselines3 wants it.

    Every environment keeps its own info dictionary; ended episodes carry
    ``terminal_observation``, ``TimeLimit.truncated`` and ``episode`` (return and length), and
    the masks come through ``env_method("action_masks")`` as sb3-contrib asks for them.

    Parameters
    ----------
    env : DiagnosisVectorEnv
        The environments, made for example by ``gymnasium.make_vec(id, num_envs=8)``, or these
        within `loose_env.wrappers.vector`.

    Raises
    ------
    InvalidSetting
        If it is another environment, or does not reset in the same step.
    """

    def __init__(self, env: Any) -> None:
        inner = getattr(env, "diagnosis", env)  # of the wrappers that keep masks and final infos
        if not isinstance(inner, DiagnosisVectorEnv):
            raise InvalidSetting(
                f"Sb3VecEnv adapts a DiagnosisVectorEnv, as gymnasium.make_vec gives it; got "
                f"{type(env).__name__}: wrap single environments and give them to "
                "stable_baselines3's DummyVecEnv instead"
            )
        if inner.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise InvalidSetting(
                "stable-baselines3 resets in the same step: make the environments with "
                f"autoreset_mode='SameStep', got {inner.autoreset_mode.value!r}"
            )
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: NDArray[np.int64] | None = None
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=int)

    def reset(self) -> Any:
        """Begin an episode in every environment, with the options of each."""
        seeds = self._seeds if any(s is not None for s in self._seeds) else None
        options = {"env_options": self._options} if any(self._options) else None
        observation, infos = self.env.reset(seed=seeds, options=options)
        self.reset_infos = [self._info(infos, i) for i in range(self.num_envs)]
        self._returns[:], self._lengths[:] = 0.0, 0
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the actions of the next step."""
        self._actions = np.asarray(actions)

    def step_wait(self) -> Any:
        """Step all environments."""
        observation, reward, terminated, truncated, infos = self.env.step(self._actions)
        done = terminated | truncated
        self._returns += reward
        self._lengths += 1
        single: list[dict[str, Any]] = []
        for i in range(self.num_envs):
            info = self._info(infos, i)
            if done[i]:
                self.reset_infos[i] = info
                info = self._info(infos["final_info"], i)
                info["terminal_observation"] = infos["final_obs"][i]
                info["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
                info["episode"] = {"r": float(self._returns[i]), "l": int(self._lengths[i])}
                self._returns[i], self._lengths[i] = 0.0, 0
            single.append(info)
        return observation, reward.astype(np.float32), done, single

    def close(self) -> None:
        """Close the environments."""
        self.env.close()

    def get_images(self) -> Sequence[Any]:
        """Picture of every environment; they need the render_mode "rgb_array"."""
        return tuple(self.env.render())

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Attribute of the environments; it is the same object for all."""
        if attr_name not in _SHARED:
            raise UnknownName(
                f"environments of a batch have no {attr_name!r}; they have the attributes "
                f"{sorted(_SHARED)} and the method 'action_masks'"
            )
        value = getattr(self.env.unwrapped, _SHARED[attr_name])
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse: environments of a batch share their attributes, which stay as they were made."""
        raise InvalidSetting(
            f"{attr_name!r} of the environments of a batch cannot be set: they share their arm and "
            "settings; give these when the batch is made, and what changes from episode to "
            "episode as options of reset()"
        )

    def has_attr(self, attr_name: str) -> bool:
        """Return whether the environments have an attribute or a method."""
        return attr_name == "action_masks" or attr_name in _SHARED

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method; of the environments' own methods, only ``action_masks`` exists."""
        if method_name != "action_masks":
            raise UnknownName(
                f"environments of a batch have the method 'action_masks' only, got {method_name!r}"
            )
        masks = self.env.action_masks()
        return [masks[i] for i in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Return True for stable-baselines3's ``Monitor``, whose ``episode`` infos are here."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def _info(self, infos: dict[str, Any], i: int) -> dict[str, Any]:
        """Take the info of one environment out of the vector's."""
        return {
            key: value[i]
            for key, value in infos.items()
            if not key.startswith("_")
            and not key.startswith("final_")
            and infos.get(f"_{key}", np.zeros(self.num_envs, dtype=bool))[i]
        }
