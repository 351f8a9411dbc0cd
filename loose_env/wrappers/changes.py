"""Changes of observation and action, each written once for B arms."""

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
from loose_env.wrappers.shells import Change

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
        found: RecordLayout = self.of_inner("layout")
        elements = found.slot_elements
        self.inner = RecordLayout(
            global_elements=found.global_elements, slot_elements=elements, slots=found.slots
        )
        self._kept = [k for k, each in enumerate(elements) if self._keeps(each.name)]
        shown = self._changed([elements[k] for k in self._kept])
        self.layout = replace(self.inner, slot_elements=tuple(shown))
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


class MeasuredMinusNominal(_Records):
    """Shows statistics less what the nominal, healthy arm would show."""

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


class JointSideObservation(_Records):
    """Shows what torque and encoders give."""

    def _keeps(self, name: str) -> bool:
        group = name.partition(".")[0].removeprefix(_NOMINAL)
        return group in _JOINT_SIDE or group.endswith("pose")


class PosteriorObservation(Change):
    """Shows the posterior over the hypotheses in place of the records."""

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


class MacroActions(Change):
    """A `Discrete` choice among whole records, then among the verdicts."""

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
