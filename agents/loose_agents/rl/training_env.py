"""Vector environment that shows a posterior, for training; its seeds and curriculum."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from loose_agents.base import Problem
from loose_agents.belief import Tracker, make_estimator, records_measured
from loose_agents.rl.agents import PolicyForm
from loose_env.envs import DiagnosisVectorEnv
from loose_env.envs.sb3 import Sb3VecEnv
from loose_env.errors import InvalidSetting
from loose_env.typing import IndexArray

LOG_FLOOR = -5.0
"""Lowest log-posterior of the truth in the shaping: e^-5 is 0.7 %."""

_TRAINING, _EVALUATION = range(2)


def training_seed(seed: int, steps: int) -> int:
    """Seed of the environments of a run resumed after a number of steps.

    A run that is resumed so meets faults that it has not met. It is a number of 62 bits, from
    which those of the environments are spawned: they do not meet the small ones that people choose,
    nor those of the evaluation.
    """
    return _seed(seed, _TRAINING, steps)


def evaluation_seed(seed: int) -> int:
    """Fixed seed of the evaluation episodes of a run."""
    return _seed(seed, _EVALUATION, 0)


def _seed(seed: int, role: int, index: int) -> int:
    sequence = np.random.SeedSequence(seed, spawn_key=(role, index))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(2))


def forced_records(done: float, *, first: int = 3, until: float = 0.4) -> int:
    """Minimum number of records before stopping, as a curriculum.

    A policy that knows nothing stops early, is mostly wrong, and never sees what a later record
    would have told. So it is made to go on at first: before ``first`` records, then before
    fewer, down to one from the share ``until`` of the training on.
    """
    if done >= until:
        return 1
    return 1 + int(np.ceil((first - 1) * (1.0 - done / until)))


def log_posterior(probability: float) -> float:
    """Clipped natural log-posterior of the truth, used for reward shaping."""
    return float(np.log(max(probability, np.exp(LOG_FLOOR))))


class TrackedVecEnv(VecEnvWrapper):
    """Vectorised wrapper that applies an estimator to the observations.

    With ``shaping`` the reward of a record is raised by that many times what the record adds to
    the log-posterior of the truth. Without discount these gains sum to the log-posterior of the
    truth at the verdict less that at the start, whatever way the episode took: a proper score of
    the estimator's last word, which tells a good record from a bad one before the verdict does.
    It is not taken back at the verdict, so the shaped optimum is a little surer than the
    unshaped one: at 0.1, going from 90 to 95 % pays 0.005, a tenth of a record's price.

    Only the training looks at the truth. The returns in ``info["episode"]`` are unshaped.
    """

    def __init__(
        self,
        env: DiagnosisVectorEnv,
        problem: Problem,
        estimator: Tracker | None = None,
        *,
        shaping: float = 0.0,
    ) -> None:
        if not np.isfinite(shaping) or shaping < 0:
            raise InvalidSetting(f"the shaping's weight is a number, 0 or more; got {shaping!r}")
        self.problem, self.shaping = problem, shaping
        self.estimator = make_estimator("posterior", problem) if estimator is None else estimator
        self.form = PolicyForm(problem, self.estimator.feature_size)
        self.least_records = 1
        """Records before which stopping is refused."""
        self.diagnosis = env
        super().__init__(Sb3VecEnv(env), self.form.observation_space, self.form.action_space)
        self._memories = [self.estimator.begin() for _ in range(self.num_envs)]
        self._probabilities = np.zeros((self.num_envs, len(problem.hypotheses)))
        self._rows = np.zeros((self.num_envs, problem.layout.size), dtype=np.float32)
        self._records = np.zeros(self.num_envs, dtype=np.intp)
        self._truths = [""] * self.num_envs
        self._potentials = np.zeros(self.num_envs)

    def reset(self) -> Any:
        """Reset every environment."""
        return self._begin(np.arange(self.num_envs), np.asarray(self.venv.reset()))

    def step_async(self, actions: NDArray[np.int64]) -> None:
        """Convert the policy's choices to actions and step."""
        self.venv.step_async(
            np.array(
                [
                    self.form.action(
                        choice,
                        self._probabilities[i],
                        self._records[i],
                        records_measured(self.problem, self._rows[i]),
                        least=self.least_records,
                    )
                    for i, choice in enumerate(actions)
                ]
            )
        )

    def step_wait(self) -> Any:
        """Update the posteriors; finished episodes restart from the prior."""
        observations, rewards, dones, infos = self.venv.step_wait()
        shown, ended = np.array(observations), np.flatnonzero(dones)
        for i in ended:
            shown[i] = infos[i]["terminal_observation"]
        features = self._follow(np.arange(self.num_envs), shown)
        rewards += [self._gain(i) for i in range(self.num_envs)]
        for i in ended:
            infos[i]["terminal_observation"] = features[i].copy()
        if len(ended):
            features[ended] = self._begin(ended, np.asarray(observations)[ended])
        return features, rewards, dones, infos

    def action_masks(self) -> NDArray[np.bool_]:
        """Action masks for MaskablePPO (num_envs, options)."""
        layout = self.problem.layout
        return np.stack(
            [
                self.form.mask(
                    layout.pose_of(row),
                    self._records[i],
                    records_measured(self.problem, row),
                    least=self.least_records,
                )
                for i, row in enumerate(self._rows)
            ]
        )

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method; ``action_masks`` returns the masks of the policy's choices."""
        if method_name != "action_masks":
            return self.venv.env_method(method_name, *args, indices=indices, **kwargs)
        masks = self.action_masks()
        return [masks[i] for i in self._get_indices(indices)]

    def _begin(self, at: IndexArray, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Reset some arms to the prior; return the policy's observations."""
        for i in at:
            self._memories[i] = self.estimator.begin()
            self._truths[i] = self.diagnosis.batch.episode(i).fault.hypothesis
        features = self._follow(at, rows)
        for i in at:
            self._potentials[i] = self._potential(i)
        return features

    def _follow(self, at: IndexArray, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Process the observations of some arms; return the policy's observations."""
        memories = [self._memories[i] for i in at]
        self._probabilities[at] = self.estimator.follow(rows, memories)
        self._records[at], self._rows[at] = self.problem.layout.records_of(rows), rows
        return np.stack(
            [
                self.form.features(
                    row, self._probabilities[i], self.estimator.features(row, memory)
                )
                for i, row, memory in zip(at, rows, memories, strict=True)
            ]
        )

    def _potential(self, i: int) -> float:
        known = self.problem.hypotheses
        truth = self._truths[i]
        share = self._probabilities[i][known.index(truth)] if truth in known else 0.0
        return log_posterior(float(share))

    def _gain(self, i: int) -> float:
        """Shaping reward of the last step."""
        before, after = self._potentials[i], self._potential(i)
        self._potentials[i] = after
        return self.shaping * (after - before)  # type: ignore[no-any-return]
