"""Layouts of action and observation spaces: coding, name, unit and bounds of each entry."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.arms import Arm, held_inertia, limits_of
from loose_env.diagnosis import (
    SEAT_AXES,
    LinkReadings,
    RecordStatistics,
    SecondOrder,
    link_axes,
)
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import InvalidAction, InvalidSetting, UnknownName
from loose_env.typing import Array, IndexArray


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
        raise InvalidAction(
            f"{name}: {len(choices)} whole numbers from 0 to "
            f"{most if len(set(most)) > 1 else most[0]}, got {found.tolist()!r:.80}"
        )
    return found.astype(np.intp)


class JointPose:
    """Numbers from -1 to 1 for every joint, which tell its place.

    A hinge is its sine and its cosine, and one whose range is more than a whole turn also its
    place in that range, -1 at the low end and 1 at the high end. A slide is its place, and a zero.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.slides = np.flatnonzero(arm.sliding)
        """Joints that slide."""
        low, high = limits_of(arm.joint_ranges, endless=0.0)
        self.middle = (low + high) / 2
        """Middle of each joint's range; 0 for one that turns without end [rad or m] (n,)."""
        self.width = high - low
        """Width of each joint's range; 0 for one that turns without end [rad or m] (n,)."""
        self.wide = np.flatnonzero(~arm.sliding & (self.width > 2 * np.pi))
        """Hinges of more than a whole turn."""
        for j in self.slides:
            if not self.width[j] > 0:
                raise InvalidSetting(
                    f"joint {arm.joints[j]!r} of arm {arm.name!r} slides and has the range "
                    f"{arm.joint_ranges[j]}; its moves and its place in an observation are "
                    "shares of a range: give (low, high) in metres"
                )

    @property
    def parts(self) -> tuple[str, ...]:
        """Groups of the numbers."""
        return ("sin_pose", "cos_pose", "range_pose")[: 3 if len(self.wide) else 2]

    @property
    def elements(self) -> Iterator[tuple[str, str]]:
        """Name and unit of every number, in the order of the observation."""
        for part, of_slide, unit in (
            ("sin_pose", "position", "of range"),
            ("cos_pose", "unused", "1"),
        ):
            for joint, slides in zip(self.arm.joints, self.arm.sliding, strict=True):
                yield (f"{part}.{joint}_{of_slide}", unit) if slides else (f"{part}.{joint}", "1")
        for k in self.wide:
            yield f"range_pose.{self.arm.joints[k]}", "of range"

    def numbers(self, pose: Array) -> tuple[Array, ...]:
        """Turn poses [rad or m] (..., n) into the numbers of each of the `parts`."""
        first, second, k = np.sin(pose), np.cos(pose), self.slides
        if len(k):
            first[..., k], second[..., k] = self._places(pose, k), 0.0
        return (first, second, *([self._places(pose, self.wide)] if len(self.wide) else ()))

    def _places(self, pose: Array, k: IndexArray) -> Array:
        return np.asarray(2 * (pose[..., k] - self.middle[k]) / self.width[k])

    def pose(self, first: Array, second: Array, place: Array | None = None) -> Array:
        """Turn numbers back into poses (..., n) [rad or m]."""
        found, k, wide = np.arctan2(first, second), self.slides, self.wide
        near = np.broadcast_to(self.middle, found.shape).copy()
        if place is not None:
            near[..., wide] += 0.5 * self.width[wide] * place
        found = found + 2 * np.pi * np.round((near - found) / (2 * np.pi))
        found[..., k] = self.middle[k] + 0.5 * self.width[k] * first[..., k]
        return np.asarray(found)


@dataclass(frozen=True, kw_only=True)
class Action:
    """A decoded action; of several, every array has an axis more in front."""

    moves: NDArray[np.intp]
    """Index into the moves, one for each joint (n,)."""
    levels: NDArray[np.intp]
    """Excitation level of each joint, 0 for off (n,)."""
    duration: float
    """Record length [s]."""
    verdict: int
    """0 to go on, k to name the k-th hypothesis and end, the last choice to end unsure."""

    def some(self, rows: Any) -> Action:
        """Some of several actions."""
        return Action(**{name: values[rows] for name, values in vars(self).items()})


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
        self.stay = settings.stay
        self.moves = np.radians(settings.moves)
        """Relative moves of a hinge [rad] (moves,)."""
        shown = JointPose(arm)
        share = np.where(arm.sliding, shown.width / np.pi, 1.0)
        self.steps = share[:, None] * self.moves
        """Change of each joint by each move [rad, m where it slides] (n, moves)."""
        low, high = limits_of(arm.joint_ranges, endless=np.inf)
        self._low, self._high = low[:, None] - 1e-9, high[:, None] + 1e-9
        self._others = np.delete(np.arange(len(settings.moves)), self.stay)
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
        self._last_at_top = np.where(np.arange(n) == n - 1, len(arm.levels), 0)
        self._options = int(self.nvec.sum())
        self._move_options = int(self.nvec[: self.most_moved].sum())

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
        return self.decode_all([action]).some(0)

    def decode_all(self, actions: Any) -> Action:
        """Check A actions and take them apart; as `decode`."""
        given, n = np.asarray(actions) if isinstance(actions, np.ndarray) else None, self.arm.n
        if (
            given is None
            or given.dtype.kind not in "iu"
            or given.shape[1:] != self.nvec.shape
            or ((given < 0) | (given >= self.nvec)).any()
        ):
            form = (
                f"an action ({self.most_moved} for moves, {self.most_excited} for levels of "
                f"{n} joints, a record length, a verdict)"
            )
            rows = [checked_indices(form, action, self.nvec) for action in actions]
            given = np.reshape(rows, (-1, len(self.nvec)))
        whole_numbers = given.astype(np.intp, copy=False)
        moves, levels = whole_numbers[:, : self.most_moved], whole_numbers[:, self.excitation]
        if self._few_moved:
            own = _by_joint(moves, len(self._others), n)
            first = np.take_along_axis(own, (own > 0).argmax(axis=1)[:, None], axis=1)[:, 0]
            moves = np.where(first > 0, self._others[first - 1], self.stay)
        levels = _by_joint(levels, len(self.arm.levels), n).max(1) if self._few_excited else levels
        levels = np.where(levels.any(axis=1, keepdims=True), levels, self._last_at_top)
        durations: Any = np.array(self.settings.durations)[whole_numbers[:, -2]]
        verdicts: Any = whole_numbers[:, -1]
        return Action(moves=moves, levels=levels, duration=durations, verdict=verdicts)

    @property
    def excitation(self) -> slice:
        """Entries of the excitation."""
        return slice(self.most_moved, self.most_moved + self.most_excited)

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
        settings, n, stay = self.settings, self.arm.n, self.stay
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

    def allowed_moves(self, pose: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return the moves that keep each joint of poses (..., n) in its range (..., n, moves)."""
        target = pose[..., None] + self.steps
        allowed = (target >= self._low) & (target <= self._high)
        allowed[..., self.stay] = True
        return np.asarray(allowed)

    def few_moves(self, moves: NDArray[np.intp], rng: np.random.Generator) -> NDArray[np.intp]:
        """Let only as many joints move as may at once, drawn anew in each row of moves (K, n).

        From ``rng`` nothing is taken where all of them may.
        """
        if not self._few_moved:
            return moves
        rank = np.argsort(np.argsort(rng.random(moves.shape), axis=-1), axis=-1)
        return np.where(rank < self.most_moved, moves, self.stay)

    def allows_unsure(self, records: Any, measured: Any) -> Any:
        """Return whether "unsure" may be said after so many records, so many of them measured."""
        settings = self.settings
        enough = (measured >= settings.unsure_after) | (records >= settings.max_records)
        return (measured > 0) & enough

    def mask(self, pose: NDArray[np.float64], records: int, measured: int) -> NDArray[np.bool_]:
        """Allowed choices of one action (sum of choices,); as `masks`."""
        found = self.masks(pose[None], np.array([records]), np.array([measured]))
        return np.asarray(found[0])

    def masks(
        self, poses: Array, records: NDArray[np.intp], measured: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        """Allowed choices of all entries, one after the other, as MaskablePPO takes them.

        Of A arms (A, sum of choices), from their poses [rad, m where a joint slides] (A, n), the
        records taken (A,), and those among them that show something (A,).
        """
        verdicts, count = self.hypotheses + 1, len(poses)
        last = records >= self.settings.max_records
        mask = np.ones((count, self._options), dtype=bool)
        moves, allowed = self._move_options, self.allowed_moves(poses)
        if self._few_moved:
            entry = np.ones((count, moves // self.most_moved), dtype=bool)
            entry[:, 1:] = allowed[..., self._others].reshape(count, -1)
            mask[:, :moves] = np.tile(entry, self.most_moved)
        else:
            mask[:, :moves] = allowed.reshape(count, -1)
        if self._few_excited:
            mask[:, moves] = False  # a record without excitation shows nothing
        mask[:, -verdicts - 1] = ~last
        mask[:, -verdicts:-1] = (last | (measured > 0))[:, None]
        mask[:, -1] = self.allows_unsure(records, measured)
        return mask


def _by_joint(entries: NDArray[np.intp], choices: int, n: int) -> NDArray[np.intp]:
    """Choice of each joint, from 1, by each of E entries for a few of the joints (A, E, n)."""
    joint, k = np.divmod(entries[..., None] - 1, choices)
    return np.where((entries[..., None] > 0) & (joint == np.arange(n)), k + 1, 0)


Scaling = Literal["linear", "log10", "asinh"]
_AXES = "xyz"


@dataclass(frozen=True, kw_only=True)
class Element:
    """One number of the observation."""

    name: str
    """Name; elements of record k start with ``record<k>.``."""
    unit: str
    """Unit before scaling; 1 for a pure number."""
    scaling: Scaling
    """Linear: value / scale. log10: log10(value / scale). asinh: asinh(value / scale)."""
    scale: float
    """Scale, in the element's unit."""
    low: float
    """Lower bound after scaling; smaller values are clipped to it."""
    high: float
    """Upper bound after scaling."""


def _linear(name: str, unit: str = "1", scale: float = 1.0, low: float = 0.0) -> Element:
    return Element(name=name, unit=unit, scaling="linear", scale=scale, low=low, high=1.0)


def _asinh(name: str, unit: str = "1", scale: float = 1.0) -> Element:
    return Element(name=name, unit=unit, scaling="asinh", scale=scale, low=-6.0, high=6.0)


def _log(name: str, unit: str, scale: float) -> Element:
    return Element(name=name, unit=unit, scaling="log10", scale=scale, low=-4.0, high=4.0)


def global_elements(arm: Arm, settings: DiagnosisSettings) -> Iterator[Element]:
    """Elements of the pose and of what has been spent."""
    for name, unit in JointPose(arm).elements:
        yield _linear(f"now.{name}", unit, low=-1.0)
    yield _linear("spent.records")
    yield _linear("spent.seconds", "s", settings.max_records * max(settings.durations))
    yield _linear("spent.levels", scale=float(settings.max_records * arm.n * len(arm.levels)))
    yield _linear("left.records")


def slot_elements(arm: Arm, settings: DiagnosisSettings) -> Iterator[Element]:
    """Elements of one record; those of accelerometers on links come last, where there are any."""
    axes = [_AXES[a] for a in arm.axes]
    pairs = [(a, b) for i, a in enumerate(axes) for b in axes[i + 1 :]]
    products = [(a, b) for i, a in enumerate(axes) for b in axes[i:]]
    joints = list(zip(arm.joints, arm.sliding, strict=True))
    top, inertias = arm.levels[-1], held_inertia(arm.spec, arm.joints)

    def transmission(group: str, names: Iterable[tuple[str, bool]]) -> Iterator[Element]:
        for name, slides in names:
            yield _asinh(f"{group}.{name}", *(("1", 0.25) if slides else ("m", 0.25 * arm.reach)))

    def statistics(prefix: str) -> Iterator[Element]:
        for kind in ("transmission", "transmission_by_instrument"):
            names = ((f"{joint}_{axis}", slides) for joint, slides in joints for axis in axes)
            yield from transmission(f"{prefix}{kind}", names)
        for joint, slides in joints:
            unit, scale = ("m/s²", top) if slides else ("rad/s²", top / arm.reach)
            yield _log(f"{prefix}joint_rms.{joint}", unit, scale)
        for (joint, slides), carried in zip(joints, inertias, strict=True):
            # A bending mode can make the apparent inertia negative (joint 1 of VERA).
            # Bounds of 200 scales hold twice what the joint carries, on heavy arms too.
            unit, least = ("kg", 1.0) if slides else ("kg·m²", 0.1)
            yield _asinh(f"{prefix}inertia.{joint}", unit, max(least, round(carried / 100, 3)))
        for axis in axes:
            yield _log(f"{prefix}tool_rms.{axis}", "m/s²", top)
        for a, b in pairs:
            yield _linear(f"{prefix}tool_correlation.{a}{b}", low=-1.0)
        for a, b in products:
            yield _linear(f"{prefix}lowest_direction.{a}{b}", low=-1.0)
        yield _linear(f"{prefix}coherence.lowest")
        yield _linear(f"{prefix}correlation.maximum")

    yield _linear("valid")
    for name, unit in JointPose(arm).elements:
        yield _linear(name, unit, low=-1.0)
    for joint in arm.joints:
        yield _linear(f"level.{joint}", scale=float(len(arm.levels)))
    for joint in arm.joints:
        yield _linear(f"torque.{joint}", "of limit")
    for joint in arm.joints:
        yield _linear(f"level_share.{joint}")
    yield _linear("duration", "s", max(settings.durations))
    yield from statistics("")
    for kind in ("skewness", "kurtosis"):
        for axis in axes:
            yield _asinh(f"{kind}.{axis}")
    yield _asinh("lowest_skewness")
    yield _asinh("lowest_kurtosis")
    yield from statistics("nominal_")
    if settings.rhythm:
        yield _log("loudness.top", "1", 1e-2)
        for i in range(1, arm.n + 1):
            for k in range(SEAT_AXES[len(axes)]):
                yield _asinh(f"rhythm.link{i}_{k}")
        for joint in arm.joints:
            yield _asinh(f"rhythm.{joint}")
    choice = settings.sensors.on_links
    if choice is None:
        return
    measured = [f"link{i}_{axis}" for i in choice.on(arm) for axis in link_axes(arm, choice)]
    for prefix in ("", "nominal_"):
        names = ((f"{seen}_{joint}", slides) for seen in measured for joint, slides in joints)
        yield from transmission(f"{prefix}link_transmission_by_instrument", names)
    for seen in measured:
        yield _log(f"link_rms.{seen}", "m/s²", top)


@dataclass(kw_only=True, eq=False)
class RecordLayout:
    """Layout of a flat observation: global elements, then slots of equal layout."""

    global_elements: tuple[Element, ...]
    """Elements of the pose and of what has been spent."""
    slot_elements: tuple[Element, ...]
    """Elements of one record."""
    slots: int
    """Number of records that are shown."""

    @property
    def size(self) -> int:
        """Number of elements of an observation."""
        return len(self.global_elements) + self.slots * len(self.slot_elements)

    @property
    def space(self) -> spaces.Box:
        """The observation space: flat, float32, finite; an empty slot is zero."""
        first, each = self.global_elements, self.slot_elements
        low = [e.low for e in first] + [min(e.low, 0.0) for e in each] * self.slots
        high = [e.high for e in first] + [max(e.high, 0.0) for e in each] * self.slots
        bounds = np.array([low, high], dtype=np.float32)
        return spaces.Box(bounds[0], bounds[1], dtype=np.float32)

    def split(
        self, observation: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Global elements (..., globals) and records (..., slots, slot size) of observations."""
        count, shape = len(self.global_elements), (*observation.shape[:-1], self.slots, -1)
        return observation[..., :count], observation[..., count:].reshape(shape)


class ObservationLayout(RecordLayout):
    """Layout and scaling of the flat observation.

    Global elements come first, then ``max_records`` slots of equal layout. A slot that has
    not been measured is zero throughout.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    settings : DiagnosisSettings
        Settings of the environment.

    Examples
    --------
    >>> from loose_env.arms import vera
    >>> layout = ObservationLayout(vera(), DiagnosisSettings())
    >>> layout.elements[0].name, layout.elements[0].unit
    ('now.sin_pose.joint1', '1')
    """

    def __init__(self, arm: Arm, settings: DiagnosisSettings) -> None:
        super().__init__(
            global_elements=tuple(global_elements(arm, settings)),
            slot_elements=tuple(slot_elements(arm, settings)),
            slots=settings.max_records,
        )
        self.arm, self.settings = arm, settings
        self._joint_pose = JointPose(arm)
        self._global_scaling = _Scaling(self.global_elements)
        self._slot_scaling = _Scaling(self.slot_elements)
        self._slot_index = _spans(self.slot_elements)
        self._global_index = _spans(self.global_elements)

    @property
    def elements(self) -> tuple[Element, ...]:
        """All elements in the order of the observation."""
        slots = (
            replace(e, name=f"record{k}.{e.name}")
            for k in range(1, self.slots + 1)
            for e in self.slot_elements
        )
        return (*self.global_elements, *slots)

    def globals_of(
        self, poses: Array, records: NDArray[np.intp], seconds: Array, levels: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """Scale the global elements of A episodes (A, globals)."""
        most = self.settings.max_records
        spent = [records / most, seconds, levels, (most - records) / most]
        values = [*self._joint_pose.numbers(poses), np.array(spent).T]
        return self._global_scaling.forward(np.concatenate(values, axis=1))

    def slots_for(
        self,
        levels: NDArray[np.intp],
        share: Array,
        record: RecordStatistics,
        both: SecondOrder,
        *,
        rhythm: Sequence[Array] = (),
        links: LinkReadings | None = None,
        nominal_links: Array | None = None,
    ) -> NDArray[np.float32]:
        """Scale the elements of B records (B, slot size).

        From their levels (B, n), the shares of these that torque limits allow (B, n), statistics,
        and those of second order of the records, then of the nominal arm's; where the settings
        ask, loudness (B,) and rhythm (B, seats); where accelerometers stand on links, also what
        these measured and would show on the nominal arm (B, L, a, n).
        """
        count = len(levels)

        second = _second_order_numbers(both)
        values = [
            np.ones((count, 1)),
            *self._joint_pose.numbers(record.pose),
            levels,
            record.torque / np.array(self.arm.torque_limits),
            share,
            record.duration,
            second[:count],
            record.skewness,
            record.kurtosis,
            record.lowest_skewness,
            record.lowest_kurtosis,
            second[count:],
            *rhythm,
        ]
        if links is not None and nominal_links is not None:
            values += [links.transmission_by_instrument, nominal_links, links.rms]
        return self._slot_scaling.forward(_joined(values))

    def table(self) -> str:
        """One line for each element of the globals and of one slot, for people to read."""
        rows = [("name", "unit", "scaling", "scale", "bounds")]
        for prefix, elements in (("", self.global_elements), ("record<k>.", self.slot_elements)):
            rows += [
                (prefix + e.name, e.unit, e.scaling, f"{e.scale:g}", f"[{e.low:g}, {e.high:g}]")
                for e in elements
            ]
        widths = [max(len(r[c]) for r in rows) for c in range(5)]
        return "\n".join(
            "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
            for row in rows
        )

    def slots_of(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """View the slots of observations (..., size) as (..., slots, slot size)."""
        return self.split(observation)[1]

    def records_of(self, observation: NDArray[np.float32]) -> Any:
        """Number of records taken in observations (..., size)."""
        share = self.physical(observation, "spent")[..., 0]
        return np.rint(share * self.settings.max_records).astype(np.intp)

    def pose_of(self, observation: NDArray[np.float32]) -> Array:
        """Poses in which arms are now (..., n) [rad, m where a joint slides]."""
        parts = (self.physical(observation, f"now.{part}") for part in self._joint_pose.parts)
        return self._joint_pose.pose(*parts)

    def record_poses_of(self, observation: NDArray[np.float32]) -> Array:
        """Poses of all records, as `pose_of`; an empty slot's means nothing (..., slots, n)."""
        parts = (self.physical(observation, part) for part in self._joint_pose.parts)
        return self._joint_pose.pose(*parts)

    def groups_of(self, slot: NDArray[np.float32]) -> dict[str, Array]:
        """All groups of measured slots (..., slot size) in their own units, and their ``pose``.

        The names are those that `physical` takes.
        """
        values = self._slot_scaling.backward(slot, slice(None))
        groups = {name: values[..., span] for name, span in self._slot_index.items()}
        groups["pose"] = self._joint_pose.pose(*(groups[part] for part in self._joint_pose.parts))
        return groups

    def physical(self, observation: NDArray[np.float32], name: str) -> Array:
        """Value of a group of elements in its own unit.

        Parameters
        ----------
        observation : ndarray (..., size)
            Observations.
        name : str
            A global group such as ``"now.sin_pose"``, or a slot group such as
            ``"transmission"``: the element's name without its last part.

        Returns
        -------
        ndarray (..., elements) or (..., slots, elements)
            Values in the elements' unit, clipped where the observation is.

        Raises
        ------
        UnknownName
            If there is no such group.
        """
        if name in self._global_index:
            span = self._global_index[name]
            return self._global_scaling.backward(observation[..., span], span)
        if name in self._slot_index:
            span = self._slot_index[name]
            slots = self.slots_of(observation)[..., span]
            values = self._slot_scaling.backward(slots, span)
            # An empty slot is zero, not the value that scaling takes to zero.
            empty = self.slots_of(observation)[..., 0] < 0.5
            values[empty] = 0.0
            return values
        known = [*self._global_index, *self._slot_index]
        raise UnknownName(f"the observation has no group {name!r}; groups are {known}")


class _Scaling:
    """Scaling of a run of elements, both ways."""

    def __init__(self, elements: tuple[Element, ...]) -> None:
        kinds = np.array([e.scaling for e in elements])
        self.log, self.asinh = kinds == "log10", kinds == "asinh"
        self._logs, self._asinhs = np.flatnonzero(self.log), np.flatnonzero(self.asinh)
        self.scale = np.array([e.scale for e in elements])
        self.low = np.array([e.low for e in elements])
        self.high = np.array([e.high for e in elements])

    def forward(self, values: Array) -> NDArray[np.float32]:
        """Scale values (..., elements)."""
        y, log, asinh = values / self.scale, self._logs, self._asinhs
        if len(asinh):
            y[..., asinh] = np.arcsinh(y[..., asinh])
        if len(log):  # zero stands for "not excited" and goes to the lower bound
            y[..., log] = np.log10(np.maximum(y[..., log], np.finfo(float).tiny))
        return np.asarray(np.minimum(np.maximum(y, self.low), self.high), dtype=np.float32)

    def backward(self, scaled: NDArray[np.float32], span: slice) -> Array:
        y = scaled.astype(float)
        log, asinh = self.log[span], self.asinh[span]
        y[..., asinh] = np.sinh(y[..., asinh])
        at_bottom = y[..., log] <= self.low[span][log]
        y[..., log] = np.where(at_bottom, 0.0, 10.0 ** y[..., log])
        return np.asarray(y * self.scale[span])


def _joined(values: Sequence[Array]) -> Array:
    """Arrays of B records beside each other (B, elements)."""
    return np.concatenate([each.reshape(len(each), -1) for each in values], axis=1)


def _second_order_numbers(found: SecondOrder) -> Array:
    """Elements that tell the second-order statistics of B records, not yet scaled (B, elements)."""
    return _joined(
        [
            found.transmission.mT,
            found.transmission_by_instrument.mT,
            found.joint_rms,
            found.inertia,
            *_covariance_numbers(found.tool_covariance),
            _axial_numbers(found.lowest_direction),
            np.asarray(found.lowest_coherence),
            np.asarray(found.maximum_correlation),
        ]
    )


def _covariance_numbers(covariance: Array) -> tuple[Array, Array]:
    """Rms along the axes (B, d), and the correlations of the pairs of axes."""
    rms = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    outer = np.maximum(rms[..., :, None] * rms[..., None, :], 1e-30)
    return rms, (covariance / outer)[..., *_pairs(rms.shape[-1], 1)]


def _axial_numbers(direction: Array) -> Array:
    """Directions (B, d) without sign as numbers without a jump: products of their components."""
    products = direction[..., :, None] * direction[..., None, :]
    return np.asarray(products[..., *_pairs(direction.shape[-1], 0)])


@lru_cache
def _pairs(count: int, above: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the upper triangle, asked for in every record."""
    return np.triu_indices(count, above)


def _spans(elements: tuple[Element, ...]) -> dict[str, slice]:
    """Span of each group of elements: those that share all but the last part of their name."""
    spans: dict[str, slice] = {}
    for k, element in enumerate(elements):
        group, _, last = element.name.rpartition(".")
        name = group or last
        start = spans[name].start if name in spans else k
        spans[name] = slice(start, k + 1)
    return spans
