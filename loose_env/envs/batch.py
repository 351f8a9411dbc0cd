"""Rules of diagnosis episodes (`EnvBatch`): reset and step of any number of arms at once.

The single and the vector environment are thin shells around `EnvBatch`, so that both
give the same episode bit for bit. Every random draw comes from a stream of its own, keyed by
(seed, episode, stream, record): what an agent does, how many arms run beside it and what ran
before change nothing.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from loose_env.arms import Arm, Drift, LinearArm, MismatchDraw
from loose_env.diagnosis import (
    KnockRhythm,
    NominalLinks,
    SensorFloor,
    link_axes,
    link_readings_of_all,
    predictions,
    statistics_of_all,
)
from loose_env.envs.faults import FaultSampler
from loose_env.envs.settings import DiagnosisSettings, difficulty_named, refuse_unknown
from loose_env.envs.spaces import ActionLayout, ObservationLayout
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.excitation import Excitation, torques_at_levels
from loose_env.faults import (
    SEVERAL_FAULTS,
    UNSURE,
    Fault,
    Healthy,
    SeveralFaults,
    hypotheses,
    is_fault,
    place_of,
    preloaded,
)
from loose_env.io import is_finite
from loose_env.rig import Measurement, Records, ReducedRig, SimulatedRig, Trials
from loose_env.streams import streams
from loose_env.typing import Array, ComplexArray, IndexArray


@dataclass(kw_only=True, eq=False)
class Episode:
    """Copy of the state of one episode."""

    seed: int
    number: int
    fault: Fault
    mismatch: MismatchDraw
    pose: Array
    slots: NDArray[np.float32]
    records: int
    seconds: float
    levels: int
    visited: Array
    """Poses in which a record was taken (records, n)."""
    last: Measurement | None
    """The latest record."""
    ended: bool
    verdict: str | None

    @property
    def measured(self) -> int:
        """Number of records that show something."""
        return int(np.count_nonzero(self.slots[:, 0]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Steps:
    """Results of one step of A arms."""

    rewards: Array
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    told: dict[str, NDArray[Any]]
    """Entries of the info of each arm whose episode goes on (A, ...)."""
    ends: dict[int, dict[str, Any]]
    """Info of each arm whose episode has ended, by its row."""

    @property
    def arrays(self) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Rewards, and which episodes terminated and were truncated (A,)."""
        return self.rewards, self.terminated, self.truncated

    def info(self, k: int) -> dict[str, Any]:
        """Info of one arm."""
        return self.ends[k] if k in self.ends else _of_row(self.told, k)


def _of_row(told: Mapping[str, NDArray[Any]], k: int) -> dict[str, Any]:
    """Entries of one row; a truth value is Python's own."""
    return {
        name: v[k].item() if v.ndim == 1 and v.dtype == bool else v[k] for name, v in told.items()
    }


_LIMIT = 1e3  # bound of every channel: signals beyond it are clipped


class RawMeasurement(Measurement):
    """A measurement as it stands in `info`: equal to another one of the same values."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Measurement) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)
        )


def raw_shapes(arm: Arm, settings: DiagnosisSettings) -> dict[str, tuple[int, ...]]:
    """Shapes of the latest record's signals, padded to the longest record."""
    n, count = arm.n, round(max(settings.durations) * settings.sensors.rate)
    shapes: dict[str, tuple[int, ...]] = {
        "command": (n, count),
        "encoder": (n, count),
        "tool": (len(arm.axes), count),
    }
    choice = settings.sensors.on_links
    if choice is not None:
        shapes["links"] = (len(choice.on(arm)), len(link_axes(arm, choice)), count)
    return shapes


def raw_signals(
    shapes: Mapping[str, tuple[int, ...]], last: tuple[Records, int] | None
) -> dict[str, NDArray[np.float32]]:
    """Signals of the latest record, zero where there is none.

    The command is in N·m, or N where the joint slides; the encoder in mrad, or mm, off the
    commanded pose; the tool in m/s², and so the links where they carry accelerometers.
    """
    signals = {name: np.zeros(shape, dtype=np.float32) for name, shape in shapes.items()}
    if last is not None and last[0].failures[last[1]] is None:
        records, k = last
        channels = {
            "command": records.command[k],
            "encoder": 1e3 * (records.encoder[k, :, 1:-1] - records.pose[k, :, None]),
            "tool": records.tool[k],
            "links": None if records.links is None else records.links[k],
        }
        for name, signal in signals.items():
            channel = channels[name]
            if channel is not None:
                signal[..., : channel.shape[-1]] = np.clip(channel, -_LIMIT, _LIMIT)
    return signals


def checked_true_arm(true_arm: Arm | None, arm: Arm) -> Arm:
    """Return the arm that is measured, which is to be moved and read as the nominal one.

    A pose or a record of one would else mean something else on the other. The nominal arm where
    none is given. Its drives carry what gravity puts on it, as servos do.
    """
    if true_arm is None:
        return arm
    if not isinstance(true_arm, Arm):
        raise InvalidSetting(f"true_arm is an Arm, as `arm_from_file` makes it; got {true_arm!r}")
    for name in ("joints", "sliding", "joint_ranges", "axes", "band"):
        own, other = getattr(true_arm, name), getattr(arm, name)
        if not _alike(own, other):
            raise InvalidSetting(
                f"the true arm {true_arm.name!r} differs from the nominal arm {arm.name!r} in "
                f"{name}: {own} and {other}; both are to be moved and read alike"
            )
    if (true_arm.shaker is None) != (arm.shaker is None) or true_arm.probes != arm.probes:
        raise InvalidSetting(
            f"the true arm {true_arm.name!r} has another shaker or other probes than the nominal "
            f"arm {arm.name!r}; both are to be moved and read alike"
        )
    return true_arm


def _alike(own: object, other: object) -> bool:
    """Return whether values are equal, numbers to rounding."""
    if isinstance(own, np.ndarray):
        return bool(np.array_equal(own, np.asarray(other)))
    if isinstance(own, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(own) == len(other) and all(map(_alike, own, other))
    if isinstance(own, float) and isinstance(other, float):
        return bool(np.isclose(own, other, rtol=1e-9, atol=1e-12))
    return own == other


_OPTIONS = ("fault", "pose", "mismatch_scale", "preload_g")


def mapping_of(options: Any, what: str = "options of reset() are") -> dict[str, Any]:
    """Options of `reset` as a dictionary, empty where there are none."""
    if options is not None and not isinstance(options, Mapping):
        raise InvalidSetting(f"{what} a mapping of names to values, or None; got {options!r:.60}")
    return dict(options or {})


def _number(name: str, given: Any, default: float) -> float:
    if given is None:
        return default
    if not is_finite(given):
        raise InvalidSetting(f"{name} must be a finite number, got {given!r}")
    return float(given)


def _fault(given: Any, arm: Arm) -> Fault | str | None:
    """Check a fault; it may lie outside the hypotheses of the environment."""
    if given is None or is_fault(given):
        return given  # type: ignore[no-any-return]
    names = (*hypotheses(arm, everywhere=True), SEVERAL_FAULTS)
    if isinstance(given, str) and given in names:
        return given
    raise UnknownName(
        f"unknown fault {given!r}; give a fault of loose_env.faults or one of {list(names)}"
    )


_STATE = (
    *("_seeds", "_numbers", "_faults", "_mismatches", "_verdicts", "_begun", "_ended"),
    *("_records", "_spent_levels", "_seconds", "_poses", "_visited", "_visits", "_flat"),
)
"""State of the episodes, but for their latest records."""
_FAULT, _MISMATCH, _POSE, _RECORD, _DRIFT = range(5)
"""Streams of random draws of an episode."""
_TOGETHER = 64
"""Records worked out at once: their signals fit the processor's cache."""


class BatchRig(Protocol):
    """Protocol of a rig: arms in slots, measured several at once."""

    def mount_all(
        self, slots: IndexArray, faults: Sequence[Fault], mismatches: Sequence[MismatchDraw]
    ) -> None:
        """Put new arms into slots."""
        ...

    def record(self, asked: Sequence[Trials]) -> Iterator[tuple[int, IndexArray, Records]]:
        """Take measurements; yield the index of a trial, its rows and their records, in any order.

        The caller works on these while the next ones are taken.
        """
        ...


class EnvBatch:
    """Runs the episodes of ``num`` arms.

    Parameters
    ----------
    arm : Arm
        The nominal arm: what is predicted, commanded and observed rests on it.
    settings : DiagnosisSettings
        Settings of the environment.
    num : int
        Number of arms.
    threads : int
        Simulation threads; 0 takes all processors.
    rig : BatchRig, optional
        Where measurements come from; simulated arms by default.
    true_arm : Arm, optional
        The arm that is measured, where the nominal model is wrong about more than the mismatch
        says. The nominal arm by default.

    Raises
    ------
    InvalidSetting
        If the true arm is not moved and read as the nominal one.
    """

    def __init__(
        self,
        arm: Arm,
        settings: DiagnosisSettings,
        *,
        num: int = 1,
        threads: int = 0,
        rig: BatchRig | None = None,
        true_arm: Arm | None = None,
    ) -> None:
        self.arm, self.settings, self.num, self.threads = arm, settings, num, threads
        self.true_arm = checked_true_arm(true_arm, arm)
        if rig is not None and not (hasattr(rig, "mount_all") and hasattr(rig, "record")):
            raise InvalidSetting(f"rig has mount_all() and record(), as a BatchRig; got {rig!r}")
        if rig is None:
            engine = ReducedRig if settings.engine == "reduced" else SimulatedRig
            own = engine(self.true_arm, slots=num, sensors=settings.sensors, threads=threads)
            # One linear arm for both: it remembers the poses it has worked out.
            rig, true = own, own.nominal
        else:
            true = LinearArm(self.true_arm)
        self.rig: BatchRig = rig
        self.nominal = true if self.true_arm is arm else LinearArm(arm)
        self.difficulty = difficulty_named(settings.difficulty)
        self.sampler = FaultSampler(true, self.difficulty, settings.kinds)
        self.hypotheses = hypotheses(arm, settings.kinds)
        self.verdicts = (*self.hypotheses, UNSURE)
        self.actions = ActionLayout(arm, settings, len(self.hypotheses))
        for seconds in settings.durations:  # fails here where the arm's band is too narrow
            Excitation(torque_rms=(0.0,) * arm.n, duration=seconds, band=arm.band)
        self.observations = ObservationLayout(arm, settings)
        self.floor = SensorFloor.of(settings.sensors, arm.band)
        links = settings.sensors.on_links
        self._nominal_links = None if links is None else NominalLinks(arm, links)
        self._rhythm = (
            KnockRhythm(self.nominal, settings.sensors.rate, self.difficulty.friction_over)
            if settings.rhythm
            else None
        )
        self._raw = raw_shapes(arm, settings) if settings.raw else {}
        self.divergences: Counter[str] = Counter()
        self._levels = np.array([0.0, *arm.levels])
        self._plain_mismatch = self.difficulty.mismatch
        # State of the episodes.
        most, n, layout = settings.max_records, arm.n, self.observations
        self._seeds, self._numbers = [0] * num, np.zeros(num, dtype=np.intp)
        self._faults: list[Fault] = [Healthy()] * num
        self._mismatches: list[Any] = [None] * num
        self._last: list[tuple[Records, int] | None] = [None] * num
        self._verdicts: list[str | None] = [None] * num
        self._begun, self._ended = np.zeros((2, num), dtype=bool)
        self._records, self._spent_levels = np.zeros((2, num), dtype=np.intp)
        self._seconds, self._poses = np.zeros(num), np.zeros((num, n))
        self._visited, self._visits = np.zeros((num, most, n)), np.zeros(num, dtype=np.intp)
        self._flat = np.zeros((num, layout.size), dtype=np.float32)
        self._slots = layout.slots_of(self._flat)

    @property
    def space(self) -> spaces.Space[Any]:
        """Observation space of one arm: flat, or with raw signals where the settings ask."""
        flat = self.observations.space
        if not self.settings.raw:
            return flat
        boxes = {
            name: spaces.Box(-_LIMIT, _LIMIT, shape, dtype=np.float32)
            for name, shape in self._raw.items()
        }
        return spaces.Dict({"statistics": flat, **boxes})

    def has_episode(self, slot: int) -> bool:
        """Return whether an episode was started in a slot."""
        return bool(self._begun[slot])

    @property
    def records(self) -> IndexArray:
        """Records taken so far in each slot's episode (num,)."""
        return self._records.copy()

    def episode(self, slot: int) -> Episode:
        """Return a copy of the latest episode of a slot, running or ended.

        Raises
        ------
        ResetNeeded
            If none was started.
        """
        self._require_begun([slot])
        last = self._last[slot]
        return Episode(
            seed=self._seeds[slot],
            number=int(self._numbers[slot]),
            fault=self._faults[slot],
            mismatch=self._mismatches[slot],
            pose=self._poses[slot].copy(),
            slots=self._slots[slot].copy(),
            records=int(self._records[slot]),
            seconds=float(self._seconds[slot]),
            levels=int(self._spent_levels[slot]),
            visited=self._visited[slot, : self._visits[slot]].copy(),
            last=None if last is None else last[0].measurement(last[1]),
            ended=bool(self._ended[slot]),
            verdict=self._verdicts[slot],
        )

    def _require_begun(self, slots: Sequence[int] | IndexArray) -> None:
        if not self._begun[slots].all():
            raise ResetNeeded("no episode is running: call reset() first")

    def start(
        self, slot: int, *, seed: int, number: int, options: Mapping[str, Any] | None = None
    ) -> None:
        """Begin an episode in a slot: hide a fault, take a random pose, measure nothing."""
        self.start_all([slot], seeds=[seed], numbers=[number], options=[options])

    def start_all(
        self,
        slots: Sequence[int],
        *,
        seeds: Sequence[int],
        numbers: Sequence[int],
        options: Sequence[Mapping[str, Any] | None],
    ) -> None:
        """Begin episodes in slots; where one is refused, none begins."""
        given = [mapping_of(each) for each in options]
        for each in given:
            refuse_unknown("reset options", each, _OPTIONS)
        arm, rows = self.true_arm, list(range(len(slots)))
        faults = [_fault(own.get("fault"), arm) for own in given]
        scales = [_number("mismatch_scale", own.get("mismatch_scale"), 1.0) for own in given]
        shares = [_number("preload_g", own.get("preload_g"), 0.0) for own in given]
        for scale in scales:
            if scale < 0:
                raise InvalidSetting(f"mismatch_scale is a factor, zero or more; got {scale:g}")
        fixed = {
            k: self._checked(given[k]["pose"]) for k in rows if given[k].get("pose") is not None
        }
        kinds = (_FAULT, _MISMATCH, _POSE)
        keys = [(number, kind, 0) for kind in kinds for number in numbers]
        drawn = streams(list(seeds) * len(kinds), np.array(keys))
        rngs = [drawn[k * len(slots) : (k + 1) * len(slots)] for k in range(len(kinds))]
        poses = arm.random_poses(rngs[2])
        for k, pose in fixed.items():
            poses[k] = pose
        hidden = self._hidden(faults, shares, rngs[0])
        mismatches: dict[int, MismatchDraw] = {}
        for scale in set(scales):
            own = [k for k in rows if scales[k] == scale]
            # The same stream gives the same draw at every scale, only larger or smaller.
            scaled = self._plain_mismatch if scale == 1 else self._plain_mismatch.scaled(scale)
            draws = scaled.draw_all(arm, [rngs[1][k] for k in own])
            mismatches |= dict(zip(own, draws, strict=True))
        self._mount(slots, hidden, [mismatches[k] for k in rows])
        at = np.array(slots, dtype=np.intp)
        for k, slot in enumerate(slots):
            self._seeds[slot], self._last[slot], self._verdicts[slot] = seeds[k], None, None
        self._numbers[at], self._poses[at] = numbers, poses
        self._records[at] = self._spent_levels[at] = self._visits[at] = 0
        self._seconds[at], self._slots[at] = 0.0, 0.0
        self._begun[at], self._ended[at] = True, False
        self._show_globals(at)

    def _hidden(
        self,
        wanted: Sequence[Fault | str | None],
        shares: Sequence[float],
        rngs: Sequence[np.random.Generator],
    ) -> list[Fault]:
        """Draw faults, or take those that are given."""
        found: list[Any] = list(wanted)
        named = [own is None or isinstance(own, str) for own in wanted]
        rows = [k for k, own in enumerate(wanted) if named[k] and own != SEVERAL_FAULTS]
        drawn = self.sampler.draw_all([rngs[k] for k in rows], [found[k] for k in rows])
        for k, fault in zip(rows, drawn, strict=True):
            found[k] = fault
        for k, (fault, share) in enumerate(zip(found, shares, strict=True)):
            if fault == SEVERAL_FAULTS:
                found[k] = self.sampler.several(rngs[k])
            if share:
                found[k] = preloaded(self.true_arm, found[k], share)
        return found

    def _mount(
        self, slots: Sequence[int], faults: Sequence[Fault], mismatches: Sequence[MismatchDraw]
    ) -> None:
        """Put arms on the rig."""
        self.rig.mount_all(np.array(slots, dtype=np.intp), faults, mismatches)
        for slot, fault, mismatch in zip(slots, faults, mismatches, strict=True):
            self._faults[slot], self._mismatches[slot] = fault, mismatch

    def _show_globals(self, slots: IndexArray) -> None:
        """Enter pose and what has been spent into the observations."""
        self._flat[slots, : len(self.observations.global_elements)] = self.observations.globals_of(
            self._poses[slots],
            self._records[slots],
            self._seconds[slots],
            self._spent_levels[slots],
        )

    def _checked(self, given: Any) -> Array:
        """Check a pose, and turn its hinges into their ranges."""
        return self.true_arm.wrap(self.true_arm.checked_pose(given, reachable=True))

    @cached_property
    def fingerprint(self) -> str:
        """Arm, settings, and what observations and actions mean, as 16 hexadecimal digits."""
        parts = (self.arm.name, repr(self.settings), self.observations.table())
        return hashlib.sha256("\n".join(parts).encode("utf-8")).hexdigest()[:16]

    def state(self) -> dict[str, Any]:
        """Copy of the episodes of all slots: arrays and lists with an entry for each."""
        latest = [own and (own[0].some(np.array([own[1]])), 0) for own in self._last]
        return {name: copy(getattr(self, name)) for name in _STATE} | {"_last": latest}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a copy of the episodes, with their arms on the rig."""
        for name, value in state.items():
            setattr(self, name, copy(value))
        self._slots = self.observations.slots_of(self._flat)
        begun = np.flatnonzero(self._begun).tolist()
        if begun:
            faults = [self._faults[slot] for slot in begun]
            self._mount(begun, faults, [self._mismatches[slot] for slot in begun])

    def place(self, slots: Sequence[int] | IndexArray, poses: Array) -> None:
        """Put the arms of A running episodes into poses (A, n), as no action can."""
        self._require_begun(slots)
        own = np.asarray(slots, dtype=np.intp)
        self._poses[own] = [self._checked(pose) for pose in poses]
        self._show_globals(own)

    def mask(self, slot: int) -> NDArray[np.bool_]:
        """Return the allowed choices of a slot's next action."""
        found: NDArray[np.bool_] = self.masks([slot])[0]
        return found

    def masks(self, slots: Sequence[int] | IndexArray) -> NDArray[np.bool_]:
        """Return the allowed choices of the next actions of A slots (A, sum of choices)."""
        self._require_begun(slots)
        at = np.asarray(slots)
        return self.actions.masks(self._poses[at], self._records[at], self._measured(at))

    def _measured(self, slots: IndexArray) -> IndexArray:
        """Records of each slot that show something (A,)."""
        return np.asarray(np.count_nonzero(self._slots[slots, :, 0], axis=1))

    def observe(self, slot: int) -> NDArray[np.float32]:
        """Return the flat observation of a slot."""
        self._require_begun([slot])
        return np.array(self._flat[slot])

    def shown(self, slots: Sequence[int] | IndexArray) -> Any:
        """Return the observations of A slots, flat or raw as the settings ask for (A, ...)."""
        self._require_begun(slots)
        flat = self._flat[np.asarray(slots)]
        if not self.settings.raw:
            return flat
        several = [raw_signals(self._raw, self._last[slot]) for slot in slots]
        signals = {name: np.stack([own[name] for own in several]) for name in self._raw}
        return {"statistics": flat, **signals}

    def step(self, slots: Sequence[int] | IndexArray, actions: Any) -> Steps:
        """Take one step in each of the given slots; arms that measure do so together."""
        at = np.asarray(slots, dtype=np.intp)
        self._require_begun(at)
        if self._ended[at].any():
            raise ResetNeeded("the episode has ended: call reset() before step()")
        action = self.actions.decode_all(actions)
        verdicts: Any = action.verdict
        over, measured = self._records[at] >= self.settings.max_records, self._measured(at)
        unsure = self.actions.allows_unsure(self._records[at], measured)
        said = np.where(verdicts == self.actions.unsure, unsure, over | (measured > 0))
        said &= verdicts > 0
        rewards, ends = np.zeros(len(at)), {}
        for k in np.flatnonzero(said | over).tolist():
            named = self.verdicts[verdicts[k] - 1] if said[k] else None
            ends[k] = self._end(int(at[k]), named)
            prices, truth = self.settings.prices, ends[k]["fault"]
            rewards[k] = prices.wrong if named is None else prices.verdict(named, truth)
        terminated, truncated = said | over, np.zeros(len(at), dtype=bool)
        rows = np.flatnonzero(~terminated)
        told: dict[str, NDArray[Any]] = {}
        if len(rows):
            own = at[rows]
            durations: Any = action.duration
            ignored = self._move(own, action.moves[rows])
            share, taken, failures = self._take(own, action.levels[rows], durations[rows])
            prices = self.settings.prices
            moved = ((action.moves[rows] != self.actions.stay) & ~ignored).sum(axis=1)
            levels = np.where(taken, action.levels[rows].sum(axis=1), 0)
            seconds = np.where(taken, durations[rows], 0.0)
            price = prices.record + prices.move * moved
            rewards[rows] = -(price + (prices.second * seconds + prices.level * levels))
            self._seconds[own] += seconds
            self._spent_levels[own] += levels
            self._visited[own[taken], self._visits[own[taken]]] = self._poses[own[taken]]
            self._visits[own[taken]] += 1
            self._records[own] += 1
            self._show_globals(own)
            told = {
                "verdict_ignored": verdicts > 0,
                "move_ignored": spread(ignored, rows, len(at)),
                "level_share": spread(share, rows, len(at)),
            }
            for k, failure in failures.items():
                row, slot = int(rows[k]), int(own[k])
                self.divergences[self._faults[slot].kind] += 1
                self._ended[slot] = truncated[row] = True
                own_end = {"failure": failure} | self._truth(slot, None)
                ends[row] = _of_row(told, row) | own_end
            if self.settings.raw:
                last = np.full(len(at), None, dtype=object)
                for k in np.flatnonzero(taken).tolist():
                    latest = self._last[own[k]]
                    if latest is not None:
                        found = latest[0].measurement(latest[1])
                        last[rows[k]] = RawMeasurement(**vars(found))
                told["measurement"] = last
            told["action_mask"] = self.masks(at)
        return Steps(
            rewards=rewards, terminated=terminated, truncated=truncated, told=told, ends=ends
        )

    def _move(self, slots: IndexArray, moves: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Move joints; one whose move leaves its range stays. Return which stayed (A, n)."""
        poses, joints = self._poses[slots], np.arange(self.arm.n)
        fits = np.take_along_axis(self.actions.allowed_moves(poses), moves[..., None], 2)[..., 0]
        step = np.where(fits, self.actions.steps[joints, moves], 0.0)
        # Rounded to a nanoradian, or nanometre, so that going there and back is the same pose.
        self._poses[slots] = np.round(self.arm.wrap(poses + step), 9)
        return ~fits

    def _take(
        self, slots: IndexArray, levels: NDArray[np.intp], durations: Array
    ) -> tuple[Array, NDArray[np.bool_], dict[int, str]]:
        """Excite and measure arms, and enter what they show into their slots.

        Returns the share of each level that torque limits allow, which arms had any torque left
        for a record, and why the records of some failed, by their row.
        """
        self._drift(slots)
        torque, share, predicted = self._planned(slots, levels)
        taken = np.asarray((torque > 0).any(axis=1))  # not where gravity leaves a drive no torque
        for slot in slots:
            self._last[slot] = None
        failures: dict[int, str] = {}
        excited = np.count_nonzero(torque, axis=1)

        def enter(rows: IndexArray, records: Records) -> None:
            """Enter records alike in length and number of excited joints."""
            try:
                found = self._slots_of(levels[rows], share[rows], records, predicted[rows])
            except InvalidData as error:
                if len(rows) == 1:
                    failures[int(rows[0])] = f"the readings make no statistics: {error}"
                    return
                for k, row in enumerate(rows):
                    enter(np.array([row]), records.some(np.array([k])))
                return
            own = slots[rows]
            self._slots[own, self._records[own]] = found

        for rows, records in self._measure(slots, torque, durations, np.flatnonzero(taken)):
            for k, row in enumerate(rows.tolist()):
                self._last[slots[row]] = (records, k)
                failure = records.failures[k]
                if failure is not None:
                    failures[row] = failure
            good = np.array([failure is None for failure in records.failures])
            for m in np.unique(excited[rows]).tolist():
                chosen = np.flatnonzero(good & (excited[rows] == m))
                if len(chosen):
                    enter(rows[chosen], records.some(chosen))
        return share, taken, failures

    def _planned(self, slots: IndexArray, levels: NDArray[np.intp]) -> tuple[Array, Array, Array]:
        """Torques for levels (A, n), shares of the levels allowed, and predicted elements."""
        linear, arm, wanted = self.nominal, self.arm, self._levels[levels]
        torque, share = np.zeros(wanted.shape), np.ones(wanted.shape)
        predicted = np.zeros((len(slots), self.observations.predicted_count))

        def predict(rows: IndexArray, answer: tuple[ComplexArray, ComplexArray]) -> None:
            found = predictions(arm, torque[rows], self.floor, *answer)
            predicted[rows] = self.observations.predicted(torque[rows], found)

        for rows in _groups(np.count_nonzero(levels, axis=1)):
            at, on = linear.at_all(self._poses[slots[rows]]), levels[rows] > 0
            answer = at.responses(on)
            found = torques_at_levels(arm, wanted[rows], at.gravity_torque, *answer)
            torque[rows], share[rows] = found
            driven = torque[rows] > 0
            if np.array_equal(driven, on):
                predict(rows, answer)
                continue
            for some in _groups(np.count_nonzero(driven, axis=1)):  # held otherwise than asked for
                if driven[some[0]].any():
                    predict(rows[some], at.some(some).responses(driven[some]))
        return torque, share, predicted

    def _slots_of(
        self, levels: NDArray[np.intp], share: Array, records: Records, predicted: Array
    ) -> NDArray[np.float32]:
        """Slots of records alike in length and number of excited joints."""
        links = expected = None
        if self._nominal_links is not None:
            links = link_readings_of_all(records)
            expected = self._nominal_links.transmission(records.pose, records.torque_rms > 0)
        return self.observations.slots_for(
            levels,
            share,
            statistics_of_all(records),
            predicted,
            rhythm=() if self._rhythm is None else self._rhythm.of(records),
            links=links,
            nominal_links=expected,
        )

    def _drift(self, slots: IndexArray) -> None:
        """Let true arms drift since the record before, if there was one and they do."""
        going = slots[self._records[slots] > 0]
        if self.settings.drift == Drift() or not len(going):
            return
        draws = zip(going, self._streams(going, _DRIFT), strict=True)
        after = [self.settings.drift.after(self._mismatches[k], rng) for k, rng in draws]
        self._mount(going.tolist(), [self._faults[slot] for slot in going], after)

    def _streams(self, slots: IndexArray, kind: int) -> list[np.random.Generator]:
        """Generators of one kind of draw for the next record of each slot."""
        key = [self._numbers[slots], np.full(len(slots), kind), self._records[slots]]
        return streams([self._seeds[slot] for slot in slots], np.column_stack(key))

    def _measure(
        self, slots: IndexArray, torque: Array, durations: Array, rows: IndexArray
    ) -> Iterator[tuple[IndexArray, Records]]:
        """Measure some of the arms; yield records of one length with their rows."""
        if not len(rows):
            return
        rngs = dict(zip(rows.tolist(), self._streams(slots[rows], _RECORD), strict=True))
        # Those of as many excited joints together: so their statistics are worked out.
        order = rows[np.argsort(np.count_nonzero(torque[rows], axis=1), kind="stable")]
        members = [order[durations[order] == length] for length in dict.fromkeys(durations[rows])]
        asked = [
            Trials(
                slots=slots[own],
                poses=self._poses[slots[own]],
                torque_rms=torque[own],
                shaker_rms=np.zeros(len(own)),
                duration=float(durations[own[0]]),
                band=self.arm.band,
                rngs=[rngs[k] for k in own.tolist()],
            )
            for own in members
        ]
        for which, some, records in self.rig.record(asked):
            yield members[which][some], records

    def _end(self, slot: int, named: str | None) -> dict[str, Any]:
        """End an episode by naming a hypothesis, or None by running out of records."""
        self._ended[slot], self._verdicts[slot] = True, named
        return ({"out_of_records": True} if named is None else {}) | self._truth(slot, named)

    def _truth(self, slot: int, named: str | None) -> dict[str, Any]:
        fault = self._faults[slot]
        truth = fault.hypothesis
        right_place = named not in (None, UNSURE) and place_of(named) in _places(fault)
        return {
            "fault": truth,
            "fault_figures": fault,
            "verdict": named,
            "is_success": named == truth,
            "link_success": right_place,
            "poses": len(np.unique(self._visited[slot, : self._visits[slot]], axis=0)),
            "records": int(self._records[slot]),
            "seconds": float(self._seconds[slot]),
            "action_mask": self.mask(slot),
        }


def spread(values: NDArray[Any], rows: IndexArray, count: int) -> NDArray[Any]:
    """Values of some rows among those of all, zero for the others."""
    wide = np.zeros((count, *values.shape[1:]), dtype=values.dtype)
    wide[rows] = values
    return wide


def _groups(keys: NDArray[np.intp]) -> Iterator[IndexArray]:
    """Rows of equal keys, few enough for the processor's cache."""
    for key in np.unique(keys):
        rows = np.flatnonzero(keys == key)
        yield from (rows[k : k + _TOGETHER] for k in range(0, len(rows), _TOGETHER))


def _places(fault: Fault) -> set[int | None]:
    """Numbers of the links and joints where something is loose; None where nothing is."""
    faults = fault.faults if isinstance(fault, SeveralFaults) else (fault,)
    return {place_of(one.hypothesis) for one in faults}
