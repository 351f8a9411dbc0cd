"""The native vector form: many arms stepped together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.envs.diagnosis_env import new_seed
from loose_env.envs.episode.batch import EpisodeBatch
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import InvalidAction, InvalidSetting
from loose_env.io import is_whole

__all__ = ["DiagnosisVectorEnv"]


class DiagnosisVectorEnv(VectorEnv[Any, Any, Any]):
    """`num_envs` diagnosis episodes side by side, simulated in one batch.

    Episodes end by themselves and start anew in the same step: the observation is the new
    episode's first one, that of the ended episode is in `infos["final_obs"]`, its info in
    `infos["final_info"]`. Environment i of a batch seeded with s plays the same episodes as a
    single environment seeded with s + i.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    settings : DiagnosisSettings, optional
        Settings of the environment.
    num_envs : int
        Number of arms.
    threads : int
        Simulation threads; 0 takes all processors.
    true_arm : Arm, optional
        The arm that is measured; the nominal one by default. See `loose_env.envs.EpisodeBatch`.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> envs = DiagnosisVectorEnv(planar(2), num_envs=3)
    >>> observations, infos = envs.reset(seed=0)
    >>> len(observations)
    3
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        arm: Arm,
        settings: DiagnosisSettings | None = None,
        *,
        num_envs: int = 1,
        threads: int = 0,
        true_arm: Arm | None = None,
    ) -> None:
        if isinstance(num_envs, bool) or num_envs < 1:
            raise InvalidSetting(f"num_envs must be 1 or more, got {num_envs!r}")
        super().__init__()
        self.num_envs = num_envs
        self.settings = DiagnosisSettings() if settings is None else settings
        self.batch = EpisodeBatch(
            arm, self.settings, num=num_envs, threads=threads, true_arm=true_arm
        )
        self.arm = arm
        self.hypotheses, self.verdicts = self.batch.hypotheses, self.batch.verdicts
        self.layout = self.batch.observations
        self.actions = self.batch.actions
        self.single_action_space = self.actions.space
        self.single_observation_space = self.batch.space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._seeds: list[int | None] = [None] * num_envs
        self._numbers = [-1] * num_envs

    @property
    def divergences(self) -> dict[str, int]:
        """Number of diverged simulations by fault kind."""
        return dict(self.batch.divergences)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every environment, or in those of `options["reset_mask"]`."""
        if options is not None and not isinstance(options, Mapping):
            raise InvalidSetting(
                f"options of reset() are a mapping such as {{'fault': 'healthy'}}, got "
                f"{options!r:.60}"
            )
        given = dict(options or {})
        chosen = self._reset_mask(given.pop("reset_mask", None))
        if not all(self.batch.has_episode(int(i)) for i in np.flatnonzero(~chosen)):
            raise ResetNeeded("the first reset() begins all episodes: give it no reset_mask")
        seeds = self._checked_seeds(seed)
        infos: dict[str, Any] = {}
        for i in np.flatnonzero(chosen):
            if seeds[i] is not None:
                self._seeds[i], self._numbers[i] = seeds[i], -1
            infos = self._add_info(infos, self._begin(int(i), given), int(i))
        return self._observe(), infos

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Step every environment; those that end begin anew."""
        try:
            rows = np.asarray(actions)
        except ValueError:  # rows of different length
            rows = np.array(None)
        if rows.ndim != 2 or len(rows) != self.num_envs:
            raise InvalidAction(
                f"actions of {self.num_envs} environments have shape "
                f"({self.num_envs}, {len(self.actions.nvec)}), got {rows.shape}"
            )
        if not all(self.batch.has_episode(i) for i in range(self.num_envs)):
            raise ResetNeeded("no episodes are running: call reset() before step()")
        outcomes = self.batch.step(range(self.num_envs), list(rows))
        rewards = np.array([o.reward for o in outcomes])
        terminated = np.array([o.terminated for o in outcomes])
        truncated = np.array([o.truncated for o in outcomes])
        infos: dict[str, Any] = {}
        for i, outcome in enumerate(outcomes):
            info = outcome.info
            if outcome.terminated or outcome.truncated:
                final = {"final_obs": self.batch.shown(i), "final_info": info}
                infos = self._add_info(infos, final, i)
                info = self._begin(i, {})
            infos = self._add_info(infos, info, i)
        return self._observe(), rewards, terminated, truncated, infos

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the next actions (num_envs, sum of choices)."""
        return np.array([self.batch.mask(i) for i in range(self.num_envs)])

    def _begin(self, i: int, options: dict[str, Any]) -> dict[str, Any]:
        seed = self._seeds[i]
        if seed is None:
            seed = self._seeds[i] = new_seed()
        info = self.batch.start(i, seed=seed, number=self._numbers[i] + 1, options=options)
        self._numbers[i] += 1  # only now: a refused reset leaves the sequence as it was
        return info

    def _checked_seeds(self, given: Any) -> list[int | None]:
        """One seed for each environment; a single one counts up."""
        several = isinstance(given, (Sequence, np.ndarray)) and not isinstance(given, str)
        seeds = list(given) if several else [given]
        for seed in seeds:
            if seed is not None and (not is_whole(seed) or seed < 0):
                raise InvalidSetting(f"a seed is a whole number, zero or more; got {seed!r}")
        if not several:
            first = seeds[0]
            return [None if first is None else int(first) + i for i in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise InvalidSetting(f"{self.num_envs} seeds are needed, got {len(seeds)}")
        return [None if seed is None else int(seed) for seed in seeds]

    def _reset_mask(self, given: Any) -> NDArray[np.bool_]:
        if given is None:
            return np.ones(self.num_envs, dtype=bool)
        mask = np.asarray(given)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise InvalidSetting(
                f"reset_mask must be {self.num_envs} booleans, at least one of them true; "
                f"got {given!r}"
            )
        return mask

    def _observe(self) -> Any:
        singles = [self.batch.shown(i) for i in range(self.num_envs)]
        if not self.settings.raw:
            return np.stack(singles)
        return {key: np.stack([s[key] for s in singles]) for key in singles[0]}
