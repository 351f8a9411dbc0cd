"""Other actions: whole records as single choices, or the verdict as a decision of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.envs import ActionLayout
from loose_env.errors import InvalidAction, InvalidSetting
from loose_env.wrappers.base import DiagnosisWrapper

__all__ = ["MacroActions", "SeparateVerdict", "default_macros"]


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
