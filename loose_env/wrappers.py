"""Gymnasium wrappers of observation, action and score; posterior features, decoded records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, Protocol, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from scipy.special import log_softmax

from loose_env.arms import LinearArm
from loose_env.diagnosis import FaultPosterior, PosteriorSettings, RecordStatistics
from loose_env.envs import (
    ActionLayout,
    DiagnosisEnv,
    DiagnosisSettings,
    Element,
    ObservationLayout,
    RecordLayout,
    difficulty_named,
)
from loose_env.errors import InvalidAction, InvalidSetting, UnknownName

__all__ = [
    "PROBABILITY_FLOOR",
    "ActionAndPrediction",
    "DiagnosisWrapper",
    "JointSideObservation",
    "LatestRecord",
    "MacroActions",
    "MeasuredMinusNominal",
    "Posterior",
    "PosteriorObservation",
    "RecordLayout",
    "SeparateVerdict",
    "analytic_posterior",
    "default_macros",
    "posterior_bounds",
    "posterior_features",
    "record_from",
    "records_from",
]


class DiagnosisWrapper(
    gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs
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
        If it is no diagnosis environment, or shows raw signals.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], **arguments: Any) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, **arguments)
        gymnasium.Wrapper.__init__(self, env)
        inner = env.unwrapped
        if not isinstance(inner, DiagnosisEnv):
            raise InvalidSetting(
                f"{type(self).__name__} wraps a single diagnosis environment, as gymnasium.make "
                f"gives it; got {type(inner).__name__}. For several, give wrappers=[...] and "
                "vectorization_mode='sync' to gymnasium.make_vec"
            )
        if inner.settings.raw:
            raise InvalidSetting(
                f"{type(self).__name__} takes the flat observation: make the environment without "
                "raw=True"
            )
        self.diagnosis = inner
        """The environment within all wrappers."""

    def inner_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the environment that is wrapped."""
        masks: NDArray[np.bool_] = self.env.get_wrapper_attr("action_masks")()
        return masks

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the next action, in the form MaskablePPO takes."""
        return self.inner_masks()

    def masked(self, info: dict[str, Any]) -> dict[str, Any]:
        """Info with the mask of this wrapper's own actions."""
        return {**info, "action_mask": self.action_masks()}


_NOMINAL = "nominal_"
_JOINT_SIDE = ("level", "torque", "level_share", "duration", "joint_rms", "inertia", "valid")
"""Groups of a record that torque, encoder and the excitation give, beside its pose."""


class _RecordWrapper(DiagnosisWrapper):
    """A wrapper that shows the records in another layout."""

    inner: RecordLayout
    """Layout of what is wrapped."""
    layout: RecordLayout
    """Layout of what is shown."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        found: RecordLayout = env.get_wrapper_attr("layout")
        self.inner = RecordLayout(
            global_elements=found.global_elements,
            slot_elements=found.slot_elements,
            slots=found.slots,
        )
        self.layout = self._changed()
        self.observation_space = self.layout.space

    def _changed(self) -> RecordLayout:
        """Layout of what is shown."""
        raise NotImplementedError

    def _shown(
        self, start: NDArray[np.float32], records: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Records as they are shown."""
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._observation(observation), info

    def step(self, action: Any) -> tuple[NDArray[np.float32], Any, bool, bool, dict[str, Any]]:
        """Take a step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._observation(observation), reward, terminated, truncated, info

    def _observation(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        start, records = self.inner.split(observation)
        return np.concatenate([start, self._shown(start, records).ravel()])


class LatestRecord(_RecordWrapper):
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

    def _changed(self) -> RecordLayout:
        names = [each.name for each in self.inner.global_elements]
        self._spent = names.index("spent.records")
        self._most = self.diagnosis.settings.max_records
        return replace(self.inner, slots=1)

    def _shown(
        self, start: NDArray[np.float32], records: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        taken = round(float(start[self._spent]) * self._most)
        # Of a layout of one slot there is only that one.
        return np.asarray(records[min(max(taken, 1), len(records)) - 1])


class MeasuredMinusNominal(_RecordWrapper):
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

    def _changed(self) -> RecordLayout:
        elements = self.inner.slot_elements
        index = {each.name: k for k, each in enumerate(elements)}
        twins = {k: index.get(_NOMINAL + each.name) for k, each in enumerate(elements)}
        self._kept = [k for k, e in enumerate(elements) if not e.name.startswith(_NOMINAL)]
        self._pairs = np.array(
            [(k, twins[of]) for k, of in enumerate(self._kept) if twins[of] is not None],
            dtype=np.intp,
        ).reshape(-1, 2)
        shown = [elements[k] for k in self._kept]
        for k, twin in self._pairs:
            own, other = shown[k], elements[twin]
            shown[k] = replace(own, low=own.low - other.high, high=own.high - other.low)
        return replace(self.inner, slot_elements=tuple(shown))

    def _shown(
        self, start: NDArray[np.float32], records: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        shown = records[:, self._kept]
        own, twin = self._pairs.T
        shown[:, own] -= records[:, twin]
        return shown


class JointSideObservation(_RecordWrapper):
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

    def _changed(self) -> RecordLayout:
        elements = self.inner.slot_elements
        self._kept = [k for k, each in enumerate(elements) if _of_joints(each.name)]
        return replace(self.inner, slot_elements=tuple(elements[k] for k in self._kept))

    def _shown(
        self, start: NDArray[np.float32], records: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        return np.asarray(records[:, self._kept])


def _of_joints(name: str) -> bool:
    """Whether torque, encoders and the excitation give an element of a record."""
    group = name.partition(".")[0].removeprefix(_NOMINAL)
    return group in _JOINT_SIDE or group.endswith("pose")


PROBABILITY_FLOOR = 1e-6
"""Probabilities below count as this in logarithms: one arm does not decide a mean [1]."""


class Posterior(Protocol):
    """Protocol of a posterior, analytic or learned, updated record by record."""

    hypotheses: tuple[str, ...]
    """Hypotheses in the order of its probabilities."""

    def start(self) -> Any:
        """Return the prior, an object with ``probabilities``."""
        ...

    def update_all(self, beliefs: Sequence[Any], records: RecordStatistics) -> list[Any]:
        """Update B beliefs with one record each, given as arrays (B, ...)."""
        ...


def analytic_posterior(linear: LinearArm, settings: DiagnosisSettings) -> FaultPosterior:
    """Build the posterior whose likelihood is derived from the nominal arm alone.

    Raises
    ------
    InvalidSetting
        If a kind of fault that may come up has no model in it.
    """
    difficulty = difficulty_named(settings.difficulty)
    return FaultPosterior(
        linear,
        settings.sensors,
        PosteriorSettings(
            friction=difficulty.friction,
            friction_over=difficulty.friction_over,
            mismatch=difficulty.mismatch,
            kinds=difficulty.probabilities(settings.kinds),
        ),
    )


def record_from(
    layout: ObservationLayout, observation: NDArray[np.float32], slot: int
) -> RecordStatistics | None:
    """Decode one record's statistics from an observation; None for an empty slot."""
    row = layout.slots_of(observation)[slot]
    return None if row[0] < 0.5 else records_from(layout, row[None])[0]


def records_from(layout: ObservationLayout, rows: NDArray[np.float32]) -> RecordStatistics:
    """Decode the statistics of B records from their slots (B, slot size), none of them empty."""
    at = layout.groups_of(rows)
    arm = layout.arm
    n, d = arm.n, len(arm.axes)
    rms = at["tool_rms"]
    covariance = rms[:, :, None] ** 2 * np.eye(d)
    i, j = np.triu_indices(d, 1)
    covariance[:, i, j] = at["tool_correlation"] * rms[:, i] * rms[:, j]
    covariance[:, j, i] = covariance[:, i, j]
    products = np.zeros((len(rows), d, d))
    products[:, *np.triu_indices(d)] = at["lowest_direction"]
    products += np.triu(products, 1).mT
    several: dict[str, Any] = {
        **{name: at[name] for name in ("pose", "joint_rms", "inertia", "skewness", "kurtosis")},
        **{name: at[name][:, 0] for name in ("duration", "lowest_skewness", "lowest_kurtosis")},
        **{name: at[name].reshape(-1, n, d).mT for name in _TRANSMISSIONS},
        "torque": at["torque"] * np.array(arm.torque_limits),
        "tool_covariance": covariance,
        "lowest_direction": np.linalg.eigh(products)[1][..., -1],
        "lowest_coherence": at["coherence"][:, 0],
        "maximum_correlation": at["correlation"][:, 0],
    }
    return RecordStatistics(**several)


_TRANSMISSIONS = ("transmission", "transmission_by_instrument")


def posterior_bounds(hypotheses: int, start: Sequence[Element]) -> list[tuple[float, float]]:
    """Bounds of `posterior_features`, one pair for each number."""
    return [
        *[(0.0, 1.0)] * hypotheses,
        *[(-2.0, 0.0)] * hypotheses,
        *[(0.0, 1.0)] * 3,
        *((e.low, e.high) for e in start),
    ]


def posterior_features(
    probabilities: NDArray[np.float64], start: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Numbers that a policy sees of a posterior.

    One after the other: the probabilities of the hypotheses; their logarithms (the natural ones,
    those below 1e-6 cut off, divided by 7); the largest probability; the logarithm of what is
    left beside it, from 0 to 1 at 0.1 %; the entropy as a share of the largest possible; the
    observation's global elements ``start``.
    """
    p = np.asarray(probabilities, dtype=float)
    logs = np.log(np.maximum(p, PROBABILITY_FLOOR)) / 7.0
    entropy = -np.sum(p * np.log(np.maximum(p, 1e-12))) / np.log(max(len(p), 2))
    doubt = np.log(np.maximum(1 - p.max(), 1e-3)) / np.log(1e-3)
    return np.concatenate([p, logs, [p.max(), doubt, entropy], start])


class PosteriorObservation(DiagnosisWrapper):
    """Shows the posterior over the hypotheses in place of the records.

    A plain Gymnasium wrapper: any library can train on it, alone or in
    ``gymnasium.make_vec(id, vectorization_mode="sync", wrappers=[PosteriorObservation])``. The
    observation is that of `posterior_features`; `info["probabilities"]` has the posterior itself,
    in the order of the environment's `hypotheses`.

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
        super().__init__(env, posterior=posterior)
        inner = self.diagnosis
        if env.get_wrapper_attr("layout") is not inner.layout:
            raise InvalidSetting(
                "PosteriorObservation reads the full observation: put it inside the wrappers that "
                "change the records"
            )
        self._given = posterior
        if posterior is None:
            posterior = analytic_posterior(inner.batch.nominal, inner.settings)
        known = posterior.hypotheses
        unknown = [name for name in inner.hypotheses if name not in known]
        if unknown:
            raise InvalidSetting(
                f"the posterior knows nothing of {unknown}; it knows {list(known)}"
            )
        self.posterior = posterior
        self._order = [known.index(name) for name in inner.hypotheses]
        start = inner.layout.global_elements
        bounds = np.array(posterior_bounds(len(self._order), start), dtype=np.float32).T
        self.observation_space = spaces.Box(bounds[0], bounds[1], dtype=np.float32)
        self._belief: Any = None
        self._records = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode, from the prior."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._belief, self._records = self.posterior.start(), 0
        return self._observation(observation), {**info, "probabilities": self.probabilities}

    def step(self, action: Any) -> tuple[NDArray[np.float32], Any, bool, bool, dict[str, Any]]:
        """Take a step and update the posterior."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        taken = self.diagnosis.batch.episode(0).records
        for slot in range(self._records, taken):
            record = record_from(self.diagnosis.layout, observation, slot)
            if record is not None:
                (self._belief,) = self.posterior.update_all([self._belief], record.several)
        self._records = taken
        info = {**info, "probabilities": self.probabilities}
        return self._observation(observation), reward, terminated, truncated, info

    def __getstate__(self) -> dict[str, Any]:
        """Attributes; the analytic posterior is built anew in a copy."""
        return {**self.__dict__, "posterior": self._given}

    def __setstate__(self, stored: dict[str, Any]) -> None:
        """Take up the attributes."""
        self.__dict__.update(stored)
        if self._given is None:
            inner = self.diagnosis
            self.posterior = analytic_posterior(inner.batch.nominal, inner.settings)

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """Posterior of the environment's hypotheses (hypotheses,)."""
        return np.asarray(self._belief.probabilities[self._order])

    def _observation(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        start = observation[: len(self.diagnosis.layout.global_elements)]
        shown = posterior_features(self.probabilities, start).astype(np.float32)
        space = self.observation_space
        return np.clip(shown, space.low, space.high)  # type: ignore[attr-defined]


def default_macros(layout: ActionLayout) -> list[NDArray[np.int64]]:
    """Records that `MacroActions` offers by default.

    Every one of these moves with every one of these excitations, in the longest record: stay, or
    one joint by its largest move either way; all joints at the top level, or one alone.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = gymnasium.make("loose_env/Vera-v0").unwrapped
    >>> len(default_macros(env.actions))
    15
    """
    n, settings = layout.arm.n, layout.settings
    stay = np.full(n, settings.stay)
    extremes = {int(np.argmin(settings.moves)), int(np.argmax(settings.moves))} - {settings.stay}
    moves = [stay]
    for joint in range(n):
        for extreme in sorted(extremes):
            moved = stay.copy()
            moved[joint] = extreme
            moves.append(moved)
    top = len(layout.arm.levels)
    levels = [np.full(n, top), *(top * np.eye(n, dtype=np.intp))]
    built = [layout.encode(moves=m, levels=v) for m in moves for v in levels]
    return [np.array(each) for each in dict.fromkeys(tuple(each.tolist()) for each in built)]


class _ActionWrapper(DiagnosisWrapper):
    """A wrapper with other actions; masks and info follow them."""

    def _inner(self, action: Any) -> NDArray[np.int64]:
        """Action of the wrapped environment."""
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, self.masked(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take a step."""
        observation, reward, terminated, truncated, info = self.env.step(self._inner(action))
        return observation, reward, terminated, truncated, self.masked(info)


class MacroActions(_ActionWrapper):
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

    def __init__(
        self, env: gymnasium.Env[Any, Any], macros: Sequence[NDArray[np.int64]] | None = None
    ) -> None:
        super().__init__(env, macros=macros)
        layout = self.diagnosis.actions
        given = default_macros(layout) if macros is None else [np.asarray(m) for m in macros]
        if not given:
            raise InvalidSetting("MacroActions needs one record or more to choose from")
        for each in given:
            record = layout.decode(each)
            if record.verdict or not np.any(each[layout.excitation]):
                raise InvalidSetting(
                    f"a macro is a record: it excites a joint and gives no verdict; got {each!r}"
                )
        self.macros = np.stack(given)
        """Records to choose from (macros, entries)."""
        self.action_space = spaces.Discrete(len(given) + len(self.diagnosis.verdicts))

    def _inner(self, action: Any) -> NDArray[np.int64]:
        if not self.action_space.contains(action):
            raise InvalidAction(
                f"a choice is a whole number from 0 to {self.action_space.n - 1}, "  # type: ignore[attr-defined]
                f"got {action!r}"
            )
        choice = int(action)
        if choice < len(self.macros):
            return np.asarray(self.macros[choice])
        return self.diagnosis.actions.encode(verdict=1 + choice - len(self.macros))

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices (choices,)."""
        parts = _parts(self.diagnosis.actions, self.inner_masks())
        entries = range(self.diagnosis.actions.most_moved)
        moves = np.array([[parts[k][m[k]] for k in entries] for m in self.macros])
        return np.concatenate([moves.all(axis=1) & parts[-1][0], parts[-1][1:]])


class SeparateVerdict(_ActionWrapper):
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

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        nvec = self.diagnosis.actions.nvec
        self.action_space = spaces.MultiDiscrete([*nvec[:-1], 2, nvec[-1] - 1])

    def _inner(self, action: Any) -> NDArray[np.int64]:
        if not self.action_space.contains(np.asarray(action)):
            raise InvalidAction(
                f"an action is one of {self.action_space}: a record, whether to stop, a verdict; "
                f"got {action!r}"
            )
        *record, stop, verdict = np.asarray(action).tolist()
        return np.array([*record, 1 + verdict if stop else 0])

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of all entries, one after the other, as MaskablePPO takes them."""
        *record, last = _parts(self.diagnosis.actions, self.inner_masks())
        named = last[1:]
        # An entry without a choice is no mask; what it says does not count before a stop.
        said = named if named.any() else np.ones_like(named)
        return np.concatenate([*record, [last[0], named.any()], said])


def _parts(layout: ActionLayout, mask: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """Mask of each entry of the environment's action."""
    return np.split(mask, np.cumsum(layout.nvec)[:-1])


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
        return observation, {**self.masked(info), "prediction": {"target": self._target}}

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
            **self.masked(info),
            "base_reward": base,
            "prediction": {"target": self._target, "loss": loss},
        }
        return observation, base - (loss if scored else 0.0), terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """Allowed choices of the record's entries, one after the other."""
        *record, last = np.split(self.inner_masks(), np.cumsum(self.diagnosis.actions.nvec)[:-1])
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
