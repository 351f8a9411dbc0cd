"""Actions, and poses as numbers of an observation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import InvalidAction, InvalidSetting
from loose_env.typing import Array


def checked_indices(name: str, given: Any, choices: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return indices (n,) of choices, each a whole number from 0 to below its choices (n,)."""
    try:
        found = np.asarray(given)
    except ValueError:  # rows of different length
        found = np.array(None)
    whole = found.dtype.kind in "iu" or (
        found.dtype.kind == "f" and bool(np.all(found == np.round(found)))
    )
    inside = found.shape == choices.shape and whole and np.all((found >= 0) & (found < choices))
    if not inside:
        most = (choices - 1).tolist()
        if len(set(most)) == 1:
            most = most[:1]
        raise InvalidAction(
            f"{name}: {len(choices)} whole numbers from 0 to {most if len(most) > 1 else most[0]}, "
            f"got {found.tolist()!r:.80}"
        )
    return found.astype(np.intp)


class JointPose:
    """Two numbers for every joint, each from -1 to 1.

    A hinge is its sine and its cosine. A slide is its position within its range, -1 at the low
    end and 1 at the high end, and a zero.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.slides = np.flatnonzero(arm.sliding)
        """Joints that slide."""
        limits = np.array([(0.0, 0.0) if r is None else r for r in arm.joint_ranges])
        self.middle = limits.mean(axis=1)
        """Middle of each joint's range; 0 for one that turns without end [rad or m] (n,)."""
        self.width = limits[:, 1] - limits[:, 0]
        """Width of each joint's range; 0 for one that turns without end [rad or m] (n,)."""
        for j in self.slides:
            if not self.width[j] > 0:
                raise InvalidSetting(
                    f"joint {arm.joints[j]!r} of arm {arm.name!r} slides and has the range "
                    f"{arm.joint_ranges[j]}; its moves and its place in an observation are "
                    "shares of a range: give (low, high) in metres"
                )

    @property
    def elements(self) -> Iterator[tuple[str, str]]:
        """Name and unit of every number, in the order of the observation."""
        for part, of_slide, unit in (
            ("sin_pose", "position", "of range"),
            ("cos_pose", "unused", "1"),
        ):
            for joint, slides in zip(self.arm.joints, self.arm.sliding, strict=True):
                yield (f"{part}.{joint}_{of_slide}", unit) if slides else (f"{part}.{joint}", "1")

    def numbers(self, pose: Array) -> tuple[Array, Array]:
        """Turn poses [rad or m] (..., n) into their first and their second numbers (..., n)."""
        first, second, k = np.sin(pose), np.cos(pose), self.slides
        if len(k):
            first[..., k] = 2 * (pose[..., k] - self.middle[k]) / self.width[k]
            second[..., k] = 0.0
        return first, second

    def pose(self, first: Array, second: Array) -> Array:
        """Turn numbers (..., n) back into poses (..., n) [rad or m].

        A hinge may be off by whole turns: it is given as near the middle of its range as can be.
        """
        found = np.arctan2(first, second)
        found = found + 2 * np.pi * np.round((self.middle - found) / (2 * np.pi))
        k = self.slides
        found[..., k] = self.middle[k] + 0.5 * self.width[k] * first[..., k]
        return np.asarray(found)


@dataclass(frozen=True, kw_only=True)
class Action:
    """A decoded action."""

    moves: NDArray[np.intp]
    """Index into the moves, one for each joint (n,)."""
    levels: NDArray[np.intp]
    """Excitation level of each joint, 0 for off (n,)."""
    duration: float
    """Record length [s]."""
    verdict: int
    """0 to go on, k to name the k-th hypothesis and end, the last choice to end unsure."""


class ActionLayout:
    """Layout of the `MultiDiscrete` action, and the choices that are allowed.

    Moves have an entry for each joint, and so has the excitation. Where the settings allow fewer
    joints at once (`max_moved`, `max_excited`), there is an entry for each of those allowed
    instead: 0 for none, then every joint with every move (or level) that it can have, base first.
    So a mask can say of every choice whether it is allowed. Of two entries for one joint the first
    move counts, and the higher level.

    Parameters
    ----------
    arm : Arm
        The arm.
    settings : DiagnosisSettings
        Settings of the environment.
    hypotheses : int
        Number of hypotheses.

    Raises
    ------
    InvalidSetting
        If a joint slides without limits, or more joints than the arm has may move or be excited.
    """

    def __init__(self, arm: Arm, settings: DiagnosisSettings, hypotheses: int) -> None:
        self.arm, self.settings, self.hypotheses = arm, settings, hypotheses
        n = arm.n
        for name in ("max_moved", "max_excited"):
            most = getattr(settings, name)
            if most is not None and most > n:
                raise InvalidSetting(
                    f"{name} is 1 to {n} on arm {arm.name!r}, its number of joints, got {most}; "
                    "leave it out for no limit"
                )
        self.moves = np.radians(settings.moves)
        """Relative moves of a hinge [rad] (moves,)."""
        shown = JointPose(arm)
        share = np.where(arm.sliding, shown.width / np.pi, 1.0)
        self.steps = share[:, None] * self.moves
        """Change of each joint by each move [rad, m where it slides] (n, moves)."""
        endless = (-np.inf, np.inf)
        limits = np.array([endless if r is None else r for r in arm.joint_ranges], dtype=float)
        self._low, self._high = limits[:, :1] - 1e-9, limits[:, 1:] + 1e-9
        self._others = np.delete(np.arange(len(settings.moves)), settings.stay)
        self._few_moved = settings.max_moved is not None and settings.max_moved < n
        self._few_excited = settings.max_excited is not None and settings.max_excited < n
        self.most_moved = min(settings.max_moved or n, n)
        """Joints that may move before a record, and entries for them."""
        self.most_excited = min(settings.max_excited or n, n)
        """Joints that may be excited in a record, and entries for them."""
        move_choices = 1 + n * len(self._others) if self._few_moved else len(settings.moves)
        level_choices = 1 + (n if self._few_excited else 1) * len(arm.levels)
        self.nvec = np.array(
            [move_choices] * self.most_moved
            + [level_choices] * self.most_excited
            + [len(settings.durations), 2 + hypotheses]
        )

    @property
    def unsure(self) -> int:
        """The verdict entry's choice that names nothing, its last one."""
        return 1 + self.hypotheses

    @property
    def space(self) -> spaces.MultiDiscrete:
        """The action space."""
        return spaces.MultiDiscrete(self.nvec)

    def decode(self, action: Any) -> Action:
        """Check an action and take it apart.

        A record without excitation shows nothing: where every joint is off, the last one is
        excited at its top level. A mask could not forbid it, for it has a place for each choice
        and none for a combination of choices.

        Raises
        ------
        InvalidAction
            If it is not one whole number in range for every entry.

        Examples
        --------
        >>> from loose_env.arms import planar
        >>> layout = ActionLayout(planar(3), DiagnosisSettings(max_excited=1), hypotheses=7)
        >>> layout.nvec.tolist()
        [5, 5, 5, 10, 3, 9]
        >>> layout.decode([2, 2, 2, 5, 0, 0]).levels.tolist()
        [0, 2, 0]
        """
        form = (
            f"an action ({self.most_moved} for moves, {self.most_excited} for levels of "
            f"{self.arm.n} joints, a record length, a verdict)"
        )
        whole_numbers = checked_indices(form, action, self.nvec)
        levels = self._levels_of(whole_numbers[self.excitation])
        if not levels.any():
            levels[-1] = len(self.arm.levels)
        return Action(
            moves=self._moves_of(whole_numbers[: self.most_moved]),
            levels=levels,
            duration=self.settings.durations[int(whole_numbers[-2])],
            verdict=int(whole_numbers[-1]),
        )

    @property
    def excitation(self) -> slice:
        """Entries of the excitation."""
        return slice(self.most_moved, self.most_moved + self.most_excited)

    def code(self, action: Any) -> str:
        """Write an action as its number among all actions, in base 36.

        Raises
        ------
        InvalidAction
            As `decode` does.

        Examples
        --------
        >>> from loose_env.arms import planar
        >>> layout = ActionLayout(planar(2), DiagnosisSettings(), hypotheses=5)
        >>> layout.code([2, 2, 0, 3, 2, 0])
        '365'
        >>> layout.from_code("365").tolist()
        [2, 2, 0, 3, 2, 0]
        """
        self.decode(action)
        number = 0
        for entry, choices in zip(np.asarray(action).tolist(), self.nvec.tolist(), strict=True):
            number = number * choices + int(entry)
        return str(np.base_repr(number, 36)).lower()

    def from_code(self, code: str) -> NDArray[np.int64]:
        """Read an action that `code` wrote.

        Raises
        ------
        InvalidAction
            If it stands for no action.
        """
        try:
            number = int(code, 36)
        except ValueError:
            number = -1
        entries = []
        for choices in self.nvec[::-1].tolist():
            number, entry = divmod(number, choices)
            entries.append(entry)
        if number != 0:
            raise InvalidAction(
                f"{code!r:.40} is not the number of an action, in base 36: there are "
                f"{math.prod(self.nvec.tolist())} actions"
            )
        return np.array(entries[::-1], dtype=np.int64)

    def _moves_of(self, entries: NDArray[np.intp]) -> NDArray[np.intp]:
        """Move of each joint (n,)."""
        if not self._few_moved:
            return entries
        moves = np.full(self.arm.n, self.settings.stay, dtype=np.intp)
        for entry in entries[entries > 0]:
            joint, k = divmod(int(entry) - 1, len(self._others))
            if moves[joint] == self.settings.stay:
                moves[joint] = self._others[k]
        return moves

    def _levels_of(self, entries: NDArray[np.intp]) -> NDArray[np.intp]:
        """Level of each joint (n,)."""
        if not self._few_excited:
            return entries
        levels = np.zeros(self.arm.n, dtype=np.intp)
        for entry in entries[entries > 0]:
            joint, k = divmod(int(entry) - 1, len(self.arm.levels))
            levels[joint] = max(levels[joint], k + 1)
        return levels

    def encode(
        self,
        *,
        moves: NDArray[np.intp] | None = None,
        levels: NDArray[np.intp] | None = None,
        duration: int | None = None,
        verdict: int = 0,
    ) -> NDArray[np.int64]:
        """Build an action; by default stay, no levels, the longest record, go on.

        Of more joints than may move or be excited at once, the first ones from the base move, and
        those of the highest levels are excited.

        Parameters
        ----------
        moves : ndarray (n,), optional
            Index of each joint's move.
        levels : ndarray (n,), optional
            Level of each joint, 0 for none.
        duration : int, optional
            Index of the duration.
        verdict : int
            0 to go on, else 1 and the index of the verdict.

        Raises
        ------
        InvalidAction
            If one of them is of another shape, or no index there.
        """
        settings, n, stay = self.settings, self.arm.n, self.settings.stay
        longest = int(np.argmax(settings.durations))
        moved, excited = np.full(n, stay), np.zeros(n, dtype=np.intp)
        if moves is not None:
            moved = checked_indices("moves", moves, np.full(n, len(settings.moves)))
        if levels is not None:
            excited = checked_indices("levels", levels, np.full(n, len(self.arm.levels) + 1))
        given = [longest if duration is None else duration, verdict]
        ends = checked_indices("duration and verdict", given, self.nvec[-2:])
        action = np.zeros(len(self.nvec), dtype=np.int64)
        if self._few_moved:
            chosen = np.flatnonzero(moved != stay)[: self.most_moved]
            place = np.searchsorted(self._others, moved[chosen])
            action[: len(chosen)] = 1 + chosen * len(self._others) + place
        else:
            action[: self.most_moved] = moved
        entries = action[self.excitation]
        if self._few_excited:
            best = np.argsort(-excited, kind="stable")[: self.most_excited]
            chosen = np.sort(best[excited[best] > 0])
            entries[: len(chosen)] = chosen * len(self.arm.levels) + excited[chosen]
        else:
            entries[:] = excited
        action[-2:] = ends
        return action

    def strongest_options(self) -> NDArray[np.intp]:
        """Places, among all options one after the other, of top levels and longest record (K,)."""
        first = np.cumsum(self.nvec) - self.nvec
        top = len(self.arm.levels) * np.arange(1, (self.arm.n if self._few_excited else 1) + 1)
        levels = (first[self.excitation][:, None] + top).ravel()
        return np.append(levels, first[-2] + int(np.argmax(self.settings.durations)))

    def allowed_moves(self, pose: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return the moves that keep each joint within its range (n, moves)."""
        target = pose[:, None] + self.steps
        allowed = (target >= self._low) & (target <= self._high)
        allowed[:, self.settings.stay] = True
        return np.asarray(allowed)

    def few_moves(self, moves: NDArray[np.intp], rng: np.random.Generator) -> NDArray[np.intp]:
        """Let only as many joints move as may at once, drawn anew in each row of moves (K, n).

        From ``rng`` nothing is taken where all of them may.
        """
        if not self._few_moved:
            return moves
        rank = np.argsort(np.argsort(rng.random(moves.shape), axis=-1), axis=-1)
        return np.where(rank < self.most_moved, moves, self.settings.stay)

    def allows_unsure(self, records: int, measured: int) -> bool:
        """Return whether "unsure" may be said after so many records, so many of them measured."""
        settings = self.settings
        enough = measured >= settings.unsure_after or records >= settings.max_records
        return measured > 0 and enough

    def mask(self, pose: NDArray[np.float64], records: int, measured: int) -> NDArray[np.bool_]:
        """Allowed choices of all entries, one after the other, as MaskablePPO takes them.

        Parameters
        ----------
        pose : ndarray (n,)
            Where the arm is [rad, m where a joint slides].
        records, measured : int
            Records taken, and those among them that show something.
        """
        verdicts = self.hypotheses + 1
        last = records >= self.settings.max_records
        mask = np.ones(int(self.nvec.sum()), dtype=bool)
        moves = int(self.nvec[: self.most_moved].sum())
        allowed = self.allowed_moves(pose)
        if self._few_moved:
            entry = np.concatenate([[True], allowed[:, self._others].ravel()])
            mask[:moves] = np.tile(entry, self.most_moved)
        else:
            mask[:moves] = allowed.ravel()
        if self._few_excited:
            mask[moves] = False  # a record without excitation shows nothing
        mask[-verdicts - 1] = not last
        mask[-verdicts:-1] = last or measured > 0
        mask[-1] = self.allows_unsure(records, measured)
        return mask
