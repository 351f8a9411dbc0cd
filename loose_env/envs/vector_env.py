"""Vector environment `DiagnosisVectorEnv`: many arms stepped in one batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.envs.batch import EnvBatch, mapping_of, spread
from loose_env.envs.env import BatchShell, row_of
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import InvalidAction, InvalidSetting
from loose_env.io import is_whole


def batch_seeds(seed: int, count: int) -> list[int]:
    """Root seeds of the environments of a batch; two batches share no episode.

    The first is ``seed`` itself, the others are numbers of 128 bits made from it. Seeds that count
    up would do worse: of 16 environments each, batches seeded 0 and 1 would share 15.

    Parameters
    ----------
    seed : int
        Seed of the batch.
    count : int
        Number of environments.

    Examples
    --------
    >>> batch_seeds(7, 1)
    [7]
    >>> len({*batch_seeds(7, 64), *batch_seeds(8, 64)})
    128
    """
    further = (np.random.SeedSequence(seed, spawn_key=(i,)) for i in range(1, count))
    states = (each.generate_state(2, np.uint64) for each in further)
    return [seed, *(int(high) << 64 | int(low) for high, low in states)]


def checked_seeds(given: Any, count: int) -> list[int | None]:
    """One seed for each environment; a single one is spread by `batch_seeds`."""
    several = isinstance(given, (Sequence, np.ndarray)) and not isinstance(given, str)
    seeds = list(given) if several else [given]
    for seed in seeds:
        if seed is not None and (not is_whole(seed) or seed < 0):
            raise InvalidSetting(f"a seed is a whole number, zero or more; got {seed!r}")
    if not several:
        first = seeds[0]
        return [None] * count if first is None else [*batch_seeds(int(first), count)]
    if len(seeds) != count:
        raise InvalidSetting(f"{count} seeds are needed, got {len(seeds)}")
    return [None if seed is None else int(seed) for seed in seeds]


def own_options(given: Any, count: int) -> list[dict[str, Any]]:
    """Options of each environment alone."""
    if given is None:
        return [{}] * count
    fits = isinstance(given, Sequence) and not isinstance(given, str)
    if not fits or len(given) != count:
        raise InvalidSetting(
            f"env_options are {count} mappings, one for each environment, None where "
            f"there are none; got {given!r:.60}"
        )
    return [mapping_of(each, "each of env_options is") for each in given]


def checked_mask(given: Any, count: int) -> NDArray[np.bool_]:
    """Environments to reset, all by default (count,)."""
    if given is None:
        return np.ones(count, dtype=bool)
    mask = np.asarray(given)
    if mask.shape != (count,) or mask.dtype != bool or not mask.any():
        raise InvalidSetting(
            f"reset_mask must be {count} booleans, at least one of them true; got {given!r}"
        )
    return mask


def mode_named(given: AutoresetMode | str) -> AutoresetMode:
    """Mode of that name or value."""
    for mode in AutoresetMode:
        if given is mode or given in (mode.value, mode.name):
            return mode
    raise InvalidSetting(
        f"autoreset_mode is one of {[mode.value for mode in AutoresetMode]}, got {given!r}"
    )


class DiagnosisVectorEnv(BatchShell, VectorEnv[Any, Any, Any]):
    """`num_envs` diagnosis episodes side by side, simulated in one batch.

    `autoreset_mode` says what becomes of an episode that has ended, as in Gymnasium's own vector
    environments. With ``SAME_STEP``, the default, the next one begins in the same step: the
    observation is its first one, that of the ended episode is in `infos["final_obs"]`, its info in
    `infos["final_info"]`. No step is lost, which matters where an episode takes three.

    With ``NEXT_STEP`` the next step begins it, whatever the action, with reward 0. Gymnasium's
    wrappers of observations (`NormalizeObservation` and others) need this one. With ``DISABLED``
    ``reset(options={"reset_mask": ended})`` begins it; to step before is an error.

    Environment 0 of a batch seeded with s plays the same episodes as a single environment seeded
    with s, the others those of `loose_env.envs.batch_seeds`. A sequence of seeds is taken as it is.

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
        The arm that is measured; the nominal one by default. See `loose_env.envs.EnvBatch`.
    autoreset_mode : AutoresetMode or str
        A mode or its value: "SameStep", "NextStep" or "Disabled".
    render_mode : {"rgb_array"}, optional
        With "rgb_array" `render` returns a picture of each environment.
    max_episode_steps : int, optional
        Steps after which an episode is truncated, as Gymnasium's time limit does it.

    Raises
    ------
    InvalidSetting
        If there is no environment, or the mode is none.
    UnknownName
        If a batch cannot be drawn that way.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> envs = DiagnosisVectorEnv(planar(2), num_envs=3)
    >>> observations, infos = envs.reset(seed=0)
    >>> len(observations)
    3
    """

    metadata = BatchShell.metadata | {"autoreset_mode": AutoresetMode.SAME_STEP}
    _kept = ("spec", "action_space", "closed")

    def __init__(
        self,
        arm: Arm,
        settings: DiagnosisSettings | None = None,
        *,
        num_envs: int = 1,
        threads: int = 0,
        true_arm: Arm | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
    ) -> None:
        limit = 1 if max_episode_steps is None else max_episode_steps
        for name, given in (("num_envs", num_envs), ("max_episode_steps", limit)):
            if not is_whole(given) or given < 1:
                raise InvalidSetting(f"{name} must be 1 or more, a whole number; got {given!r}")
        super().__init__()
        self.autoreset_mode = mode_named(autoreset_mode)
        # The class's own dictionary says what the default is.
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = int(num_envs)
        self._show(
            EnvBatch(arm, settings, num=self.num_envs, threads=threads, true_arm=true_arm),
            render_mode,
            num_envs=self.num_envs,
            autoreset_mode=self.autoreset_mode,
            max_episode_steps=max_episode_steps,
        )
        self._limit = max_episode_steps
        self.single_action_space = self.actions.space
        self.single_observation_space = self.batch.space
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._all = np.arange(self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every environment, or in those of `options["reset_mask"]`.

        The other options are those of the single environment, for all alike;
        ``options["env_options"]`` is a sequence of further ones, a mapping or None for each
        environment, which go before them.
        """
        given = mapping_of(options)
        chosen = checked_mask(given.pop("reset_mask", None), self.num_envs)
        own = own_options(given.pop("env_options", None), self.num_envs)
        if not self.batch.begun[~chosen].all():
            raise ResetNeeded("the first reset() begins all episodes: give it no reset_mask")
        self._begin(
            np.flatnonzero(chosen),
            checked_seeds(seed, self.num_envs),
            [given | each for each in own],
        )
        return self.batch.shown(self._all), self._begun_infos(chosen)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Step every environment; `autoreset_mode` says when those that end begin anew."""
        try:
            rows = np.asarray(actions)
        except ValueError:  # rows of different length
            rows = np.array(None)
        if rows.ndim != 2 or len(rows) != self.num_envs:
            raise InvalidAction(
                f"actions of {self.num_envs} environments have shape "
                f"({self.num_envs}, {len(self.actions.nvec)}), got {rows.shape}"
            )
        over, same_step = self.batch.ended.copy(), self.autoreset_mode is AutoresetMode.SAME_STEP
        if self.autoreset_mode is AutoresetMode.DISABLED and over.any():
            raise ResetNeeded(
                f"the episodes of environments {np.flatnonzero(over).tolist()} have ended and "
                "autoreset is disabled: call reset(options={'reset_mask': ended}) before step()"
            )
        going, infos = np.flatnonzero(~over), {}
        found = self.batch.step(going, rows[going])
        n = self.num_envs
        rewards, terminated, truncated = (spread(own, going, n) for own in found.arrays)
        ended = {int(going[k]): info for k, info in found.ends.items()}
        if self._limit is not None:  # every step of an episode that goes on is a record
            cut = ~over & ~terminated & ~truncated & (self.batch.records >= self._limit)
            ended |= {int(going[k]): found.info(k) for k in np.flatnonzero(cut[going]).tolist()}
            truncated |= cut
        went_on = ~over & ~terminated & ~truncated
        if went_on.any():
            for name, values in found.told.items():
                infos[name] = spread(values[went_on[going]], np.flatnonzero(went_on), n)
                infos[f"_{name}"] = went_on.copy()
        finals = self.batch.shown(list(ended)) if ended and same_step else None
        for k, (i, info) in enumerate(ended.items()):
            if finals is None:
                self.batch.ended[i] = True
            else:
                info = {"final_obs": row_of(finals, k), "final_info": info}
            infos = self._add_info(infos, info, i)
        fresh = np.array(list(ended), dtype=np.intp) if same_step else np.flatnonzero(over)
        self._begin(fresh, [None] * n, [{}] * n)
        if len(fresh):  # what they may do next
            infos |= self._begun_infos(np.ones(n, dtype=bool))
        return self.batch.shown(self._all), rewards, terminated, truncated, infos

    def _begun_infos(self, chosen: NDArray[np.bool_]) -> dict[str, Any]:
        """Infos of the environments chosen: what their next actions may be."""
        masks = np.where(chosen[:, None], self.batch.masks(self._all), False)
        return {"action_mask": masks, "_action_mask": chosen.copy()}

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the next actions (num_envs, sum of choices)."""
        return self.batch.masks(self._all)

    def render(self) -> tuple[Any, ...]:
        """Picture of every environment, each (height, width, 3) of uint8."""
        return tuple(self._drawn())
