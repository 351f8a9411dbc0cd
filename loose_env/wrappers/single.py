"""Wrappers of a single environment."""

from __future__ import annotations

from typing import Any, Literal, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from scipy.special import log_softmax

from loose_env.errors import InvalidAction, InvalidSetting, UnknownName
from loose_env.wrappers import changes
from loose_env.wrappers.posteriors import Posterior
from loose_env.wrappers.shells import DiagnosisWrapper


class LatestRecord(changes.LatestRecord, DiagnosisWrapper):
    """Shows the latest record only: a policy with a memory of its own reads them one by one.

    The global elements stay: the pose, and what has been spent. Before the first record, and where
    the latest one is empty, the record is zero.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = LatestRecord(gymnasium.make("loose_env/Vera-v0"))
    >>> env.reset(seed=0)[0].shape
    (66,)
    """


class MeasuredMinusNominal(changes.MeasuredMinusNominal, DiagnosisWrapper):
    """Shows statistics less what the nominal, healthy arm would show.

    Every element with a nominal twin becomes the difference of the two, each scaled as the
    observation has it; the twin is left out. What has none, pose and excitation, stays.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = MeasuredMinusNominal(gymnasium.make("loose_env/Vera-v0"))
    >>> env.observation_space.shape, env.layout.slot_elements[-1].name
    ((464,), 'lowest_kurtosis')
    """


class JointSideObservation(changes.JointSideObservation, DiagnosisWrapper):
    """Shows what torque and encoders give: a robot without accelerometers (thesis, 2.2.2).

    Left are the pose, what has been spent, and of every record its pose, excitation, joint
    motion and apparent inertia, measured and nominal. That a seat is loose shows there nearly as
    well as at the tool; its direction does not.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = gymnasium.make("loose_env/Planar-v0", n_links=2)
    >>> whole, alone = env.observation_space.shape[0], JointSideObservation(env)
    >>> alone.observation_space.shape[0] < whole / 2
    True
    """


class PosteriorObservation(changes.PosteriorObservation, DiagnosisWrapper):
    """Shows the posterior over the hypotheses in place of the records.

    A plain Gymnasium wrapper: any library can train on it. The observation is that of
    `posterior_features`; `info["probabilities"]` has the posterior itself, in the order of the
    environment's `hypotheses`.

    Parameters
    ----------
    env : gymnasium.Env
        The environment; records are read from its full observation, so put this wrapper first.
    posterior : Posterior, optional
        What weighs the records: by default the analytic posterior, from the nominal arm alone.

    Raises
    ------
    InvalidSetting
        If the observation is another one already, or the posterior lacks a hypothesis.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = PosteriorObservation(gymnasium.make("loose_env/Vera-v0"))
    >>> observation, info = env.reset(seed=0)
    >>> observation.shape, info["probabilities"].round(2).tolist()
    ((21,), [0.33, 0.17, 0.17, 0.17, 0.17])
    """

    def __init__(self, env: gymnasium.Env[Any, Any], posterior: Posterior | None = None) -> None:
        super().__init__(env, posterior)

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """Posterior of the environment's hypotheses (hypotheses,)."""
        return np.array(self._shares[0])


class MacroActions(changes.MacroActions, DiagnosisWrapper):
    """A `Discrete` choice among whole records, then among the verdicts.

    Choice k below ``len(macros)`` takes that record, the next ones give the environment's
    `verdicts` in their order. `action_masks` says which records stay within the joints' ranges
    and which verdicts count; a record without excitation is not among the choices.

    Parameters
    ----------
    env : gymnasium.Env
        The environment.
    macros : sequence of ndarray, optional
        Records as actions of the environment, such as its ``actions.encode`` gives;
        `default_macros` by default.

    Raises
    ------
    InvalidSetting
        If there is none, or one gives a verdict or excites nothing.
    InvalidAction
        If one is no action of the environment.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = MacroActions(gymnasium.make("loose_env/Vera-v0"))
    >>> env.action_space
    Discrete(21)
    """


class SeparateVerdict(changes.SeparateVerdict, DiagnosisWrapper):
    """Whether to stop, and what to say then, as two entries in place of one.

    In the environment's own action six of seven choices of the last entry end the episode (on
    VERA), so a policy that knows nothing stops at once. Here the last two entries are whether to
    stop, and the verdict, which counts only then: a policy that knows nothing stops every other
    time.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = SeparateVerdict(gymnasium.make("loose_env/Vera-v0"))
    >>> env.action_space
    MultiDiscrete([5 5 4 4 3 2 6])
    """


Score = Literal["log", "brier"]
"""Proper scores of a prediction: -log p(truth), or the squared distance to the truth."""


class ActionAndPrediction(DiagnosisWrapper):
    """A record and a prediction in every step, as the package ap_gym has it.

    The action is a `Dict`: ``"action"``, a record and whether to stop after the environment's own
    fashion, `MultiDiscrete`; ``"prediction"``, logits of the hypotheses in their order, a `Box`.
    The reward is ``info["base_reward"]``, less the price of the record, minus the loss of the
    prediction; ``info["prediction"]`` has the target, the number of the true hypothesis, and the
    loss, so that a prediction can be trained by its gradient. Beware: the target is the truth, and
    is no observation.

    Both losses are strictly proper: their mean is least where the prediction is the posterior. By
    default the last prediction is scored alone, the one with which the agent stops: charged in
    every step, a loss would be saved by stopping early. With ``every_step`` all predictions are
    scored and nothing stops an episode before its last record, as in ap_gym's own environments.

    Parameters
    ----------
    env : gymnasium.Env
        The environment.
    score : {"log", "brier"}
        The loss.
    every_step : bool
        True to score every prediction and to give the action no entry to stop.

    Raises
    ------
    UnknownName
        If there is no such score.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = ActionAndPrediction(gymnasium.make("loose_env/Vera-v0"))
    >>> env.action_space["action"], env.action_space["prediction"].shape
    (MultiDiscrete([5 5 4 4 3 2]), (5,))
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], score: Score = "log", *, every_step: bool = False
    ) -> None:
        super().__init__(env, score=score, every_step=every_step)
        if score not in get_args(Score):
            raise UnknownName(f"score is one of {list(get_args(Score))}, got {score!r}")
        self.score, self.every_step = score, every_step
        nvec = self.diagnosis.actions.nvec[:-1].tolist()
        count = len(self.diagnosis.hypotheses)
        self.inner_action_space = spaces.MultiDiscrete(nvec if every_step else [*nvec, 2])
        """Space of the record."""
        self.prediction_space = spaces.Box(-np.inf, np.inf, (count,), dtype=np.float32)
        """Space of the logits."""
        self.prediction_target_space = spaces.Discrete(count)
        """Space of the truth."""
        self.action_space = spaces.Dict(
            {"action": self.inner_action_space, "prediction": self.prediction_space}
        )

    def loss_fn(
        self, prediction: NDArray[Any], target: int | NDArray[Any], **_: Any
    ) -> NDArray[np.float64]:
        """Loss of logits (..., hypotheses) where the truth is ``target`` (...)."""
        logs = log_softmax(np.asarray(prediction, dtype=float), axis=-1)
        index = np.asarray(target)[..., None]
        if self.score == "log":
            return np.asarray(-np.take_along_axis(logs, index, axis=-1)[..., 0])
        truth = np.arange(logs.shape[-1]) == index
        return np.asarray(np.sum((np.exp(logs) - truth) ** 2, axis=-1))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode.

        Raises
        ------
        InvalidSetting
            If the hidden fault is none of the hypotheses: no prediction could be right.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        truth = self.diagnosis.batch.episode(0).fault.hypothesis
        if truth not in self.diagnosis.hypotheses:
            raise InvalidSetting(
                f"the fault {truth!r} is none of the hypotheses {list(self.diagnosis.hypotheses)}: "
                "a prediction of it has no target"
            )
        self._target = self.diagnosis.hypotheses.index(truth)
        return observation, {
            **info,
            "action_mask": self.action_masks(),
            "prediction": {"target": self._target},
        }

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take a record, or stop; the prediction is scored."""
        record, prediction = self._checked(action)
        episode = self.diagnosis.batch.episode(0)
        settings, layout = self.diagnosis.settings, self.diagnosis.actions
        last = episode.records >= settings.max_records
        stops = not self.every_step and bool(record[-1]) and episode.measured > 0
        verdict = 1 + int(np.argmax(prediction)) if last or stops else 0
        inner = np.array([*record[: len(layout.nvec) - 1], verdict])
        observation, reward, terminated, truncated, info = self.env.step(inner)
        loss = float(self.loss_fn(prediction, self._target))
        base = 0.0 if terminated else float(reward)
        if self.every_step and not truncated:
            # The last record ends the episode: there is nothing to stop.
            taken = self.diagnosis.batch.episode(0).records
            terminated = terminated or taken >= settings.max_records
        scored = self.every_step or terminated
        info = {
            **info,
            "action_mask": self.action_masks(),
            "base_reward": base,
            "prediction": {"target": self._target, "loss": loss},
        }
        return observation, base - (loss if scored else 0.0), terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the record's entries, one after the other."""
        ends = np.cumsum(self.diagnosis.actions.nvec)[:-1]
        *record, last = np.split(self.of_inner("action_masks")(), ends)
        return np.concatenate([*record, *([] if self.every_step else [[last[0], last[1:].any()]])])

    def _checked(self, action: Any) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        try:
            record = np.asarray(action["action"])
            prediction = np.asarray(action["prediction"], dtype=float)
        except (KeyError, TypeError, IndexError, ValueError):
            record, prediction = np.zeros(0), np.zeros(0)
        fits = prediction.shape == self.prediction_space.shape and np.isfinite(prediction).all()
        if not (fits and self.inner_action_space.contains(record)):
            raise InvalidAction(
                f"an action is a mapping of 'action', one of {self.inner_action_space}, and "
                f"'prediction', {self.prediction_space.shape[0]} finite logits; got {action!r:.200}"
            )
        return record, prediction
