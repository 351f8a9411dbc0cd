"""Changes of observation and action, written once for B arms; wrappers of one environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.envs import ActionLayout, Element, RecordLayout
from loose_env.errors import InvalidAction, InvalidSetting
from loose_env.typing import IndexArray
from loose_env.wrappers.posteriors import (
    Posterior,
    analytic_posterior,
    checked_order,
    posterior_bounds,
    posterior_features,
    taken_in,
)
from loose_env.wrappers.shells import Change, DiagnosisWrapper

_NOMINAL = "nominal_"
_JOINT_SIDE = ("level", "torque", "level_share", "duration", "joint_rms", "inertia", "valid")
"""Groups of a record that torque, encoder and the excitation give, beside its pose."""


class _Records(Change):
    """Shows some elements of the records, in another layout."""

    inner: RecordLayout
    """Layout of what is wrapped."""
    layout: RecordLayout
    """Layout of what is shown."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self.inner = inner = self.of_inner("layout")
        elements = inner.slot_elements
        self._kept = [k for k, each in enumerate(elements) if self._keeps(each.name)]
        shown = tuple(self._changed([elements[k] for k in self._kept]))
        start = inner.global_elements
        self.layout = RecordLayout(global_elements=start, slot_elements=shown, slots=inner.slots)
        self.set_space("observation", self.layout.space)

    def _keeps(self, name: str) -> bool:
        """Whether an element of a record is shown."""
        raise NotImplementedError

    def _changed(self, elements: list[Element]) -> list[Element]:
        """Elements that are kept, as they are shown."""
        return elements

    def _shown(self, records: NDArray[np.float32]) -> NDArray[np.float32]:
        """Records (A, slots, size) as they are shown."""
        return np.asarray(records[..., self._kept])

    def shown(self, observations: NDArray[np.float32], at: IndexArray) -> NDArray[np.float32]:
        """Observations with the records in the other layout."""
        start, records = self.inner.split(observations)
        return np.concatenate([start, self._shown(records).reshape(len(start), -1)], axis=1)


class Differences(_Records):
    """See `MeasuredMinusNominal`."""

    def _keeps(self, name: str) -> bool:
        return not name.startswith(_NOMINAL)

    def _changed(self, elements: list[Element]) -> list[Element]:
        every = self.inner.slot_elements
        index, shown = {each.name: k for k, each in enumerate(every)}, [*elements]
        twins = [(k, index.get(_NOMINAL + each.name)) for k, each in enumerate(elements)]
        pairs = [(k, of) for k, of in twins if of is not None]
        self._pairs = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        for k, twin in self._pairs:
            own, other = shown[k], every[twin]
            shown[k] = replace(own, low=own.low - other.high, high=own.high - other.low)
        return shown

    def _shown(self, records: NDArray[np.float32]) -> NDArray[np.float32]:
        shown, (own, twin) = super()._shown(records), self._pairs.T
        shown[..., own] -= records[..., twin]
        return shown


class JointSide(_Records):
    """See `JointSideObservation`."""

    def _keeps(self, name: str) -> bool:
        group = name.partition(".")[0].removeprefix(_NOMINAL)
        return group in _JOINT_SIDE or group.endswith("pose")


class OfPosterior(Change):
    """See `PosteriorObservation`."""

    def __init__(self, env: Any, posterior: Posterior | None = None) -> None:
        super().__init__(env, posterior=posterior)
        inner = self.diagnosis
        if self.of_inner("layout") is not inner.layout:
            raise InvalidSetting(
                "PosteriorObservation reads the full observation: put it inside the wrappers that "
                "change the records"
            )
        if posterior is not None and not hasattr(posterior, "update_all"):
            raise InvalidSetting(
                f"a posterior has hypotheses, start() and update_all(); got {posterior!r:.80}"
            )
        self._given = posterior
        self.posterior = self._made()
        self._order = checked_order(self.posterior, inner.hypotheses)
        start = inner.layout.global_elements
        bounds = np.array(posterior_bounds(len(self._order), start), dtype=np.float32).T
        self._low, self._high = bounds
        self.set_space("observation", spaces.Box(*bounds, dtype=np.float32))
        self._beliefs: list[Any] = [self.posterior.start()] * self.num
        self._records = np.zeros(self.num, dtype=np.intp)
        self._shares = np.zeros((self.num, len(self._order)))

    def _made(self) -> Posterior:
        inner = self.diagnosis
        return self._given or analytic_posterior(inner.batch.nominal, inner.settings)

    def shown(self, observations: NDArray[np.float32], at: IndexArray) -> NDArray[np.float32]:
        """Update the posteriors of some arms and show them."""
        layout = self.diagnosis.layout
        for i in at[layout.records_of(observations) == 0]:  # an episode begins
            self._beliefs[i], self._records[i] = self.posterior.start(), 0
        before, known = [self._beliefs[i] for i in at], self._records[at]
        after, taken = taken_in(self.posterior, layout, observations, before, known)
        self._records[at] = taken
        for i, belief in zip(at, after, strict=True):
            self._beliefs[i] = belief
            self._shares[i] = belief.probabilities[self._order]
        start = observations[:, : len(layout.global_elements)]
        shown = posterior_features(self._shares[at], start).astype(np.float32)
        return np.clip(shown, self._low, self._high)

    def told(self, at: IndexArray) -> dict[str, NDArray[Any]]:
        """Posterior of the environment's hypotheses."""
        return {"probabilities": self._shares[at]}

    def __getstate__(self) -> dict[str, Any]:
        """Attributes; the analytic posterior is built anew in a copy."""
        return {**self.__dict__, "posterior": self._given}

    def __setstate__(self, stored: dict[str, Any]) -> None:
        """Take up the attributes."""
        self.__dict__.update(stored)
        self.posterior = self._made()


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


class Macros(Change):
    """See `MacroActions`."""

    def __init__(self, env: Any, macros: Sequence[NDArray[np.int64]] | None = None) -> None:
        super().__init__(env, macros=macros)
        layout = self.diagnosis.actions
        given = default_macros(layout) if macros is None else macros
        if not isinstance(given, (Sequence, np.ndarray)) or not len(given):
            raise InvalidSetting(
                f"MacroActions needs one record or more to choose from, a list; got {macros!r:.80}"
            )
        given = [np.asarray(each) for each in given]
        for each in given:
            record = layout.decode(each)
            if record.verdict or not np.any(each[layout.excitation]):
                raise InvalidSetting(
                    f"a macro is a record: it excites a joint and gives no verdict; got {each!r}"
                )
        self.macros = np.stack(given)
        """Records to choose from (macros, entries)."""
        verdicts = [layout.encode(verdict=1 + k) for k in range(len(self.diagnosis.verdicts))]
        self._choices = np.concatenate([self.macros, np.stack(verdicts)])
        self.set_space("action", spaces.Discrete(len(self._choices)))
        moved = self.macros[:, : layout.most_moved]
        first = np.cumsum([0, *layout.nvec[: layout.most_moved - 1]])
        self._moves, self._verdicts = first + moved, layout.nvec[-1]

    def inner_actions(self, actions: Any) -> NDArray[np.int64]:
        """Records and verdicts of the choices (B,)."""
        chosen, count = np.asarray(actions), len(self._choices)
        whole = chosen.shape == (self.num,) and np.issubdtype(chosen.dtype, np.integer)
        if not whole or chosen.min() < 0 or chosen.max() >= count:
            raise InvalidAction(
                f"a choice is a whole number from 0 to {count - 1}, one for each arm; got "
                f"{actions!r:.200}"
            )
        return np.asarray(self._choices[chosen])

    def masks(self, inner: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Allowed choices (A, choices)."""
        verdicts = inner[:, -self._verdicts :]
        records = inner[:, self._moves].all(axis=2) & verdicts[:, :1]
        return np.concatenate([records, verdicts[:, 1:]], axis=1)


class MeasuredMinusNominal(Differences, DiagnosisWrapper):
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


class JointSideObservation(JointSide, DiagnosisWrapper):
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


class PosteriorObservation(OfPosterior, DiagnosisWrapper):
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

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """Posterior of the environment's hypotheses (hypotheses,)."""
        return np.array(self._shares[0])


class MacroActions(Macros, DiagnosisWrapper):
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
