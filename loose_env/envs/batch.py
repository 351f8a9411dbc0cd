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
from typing import Annotated, Any, Protocol

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
    statistics_beside,
)
from loose_env.envs.faults import FaultSampler
from loose_env.envs.settings import DiagnosisSettings, difficulty_named, refuse_unknown
from loose_env.envs.spaces import Action, ActionLayout, ObservationLayout
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.excitation import Excitation, torques_at_levels
from loose_env.faults import (
    SEVERAL_FAULTS,
    UNSURE,
    Fault,
    SeveralFaults,
    hypotheses,
    is_fault,
    place_of,
    preloaded,
)
from loose_env.io import Checked, NonNegative, Rule, plain
from loose_env.rig import Measurement, Records, ReducedRig, SimulatedRig, Trials
from loose_env.streams import streams
from loose_env.typing import Array, ComplexArray, IndexArray


@dataclass(kw_only=True, eq=False)
class Episode:
    """Copy of the state of one episode."""

    fault: Fault
    mismatch: MismatchDraw
    pose: Array
    slots: NDArray[np.float32]
    records: int
    seconds: float
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
        channels = [
            records.command[k],
            1e3 * (records.encoder[k, :, 1:-1] - records.pose[k, :, None]),
            records.tool[k],
            *([] if records.links is None else [records.links[k]]),
        ]
        for signal, channel in zip(signals.values(), channels, strict=False):
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
        if plain([*own], digits=9) != plain([*other], digits=9):
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


def mapping_of(options: Any, what: str = "options of reset() are") -> dict[str, Any]:
    """Options of `reset` as a dictionary, empty where there are none."""
    if options is not None and not isinstance(options, Mapping):
        raise InvalidSetting(f"{what} a mapping of names to values, or None; got {options!r:.60}")
    return dict(options or {})


@dataclass(frozen=True, kw_only=True, eq=False)
class Beginning(Checked):
    """How an episode begins: options of `reset`, checked."""

    fault: Fault | str | None = None
    """Fault, or the hypothesis under which one is drawn; None draws one."""
    pose: Any = None
    """First pose [rad or m] (n,); None draws one."""
    mismatch_scale: NonNegative = 1.0
    """Factor on the deviations of the true arm from the nominal one."""
    preload_g: Annotated[float, Rule("a finite number")] = 0.0
    """Weight carried that presses a loose seat towards its upper stop [1]."""

    @classmethod
    def of(cls, options: Any, arm: Arm) -> Beginning:
        """Check options; a fault may lie outside the hypotheses of the environment."""
        if not (given := mapping_of(options)):
            return cls()
        refuse_unknown("reset options", given, [each.name for each in fields(cls)])
        given = {name: value for name, value in given.items() if value is not None}
        names, fault = (*hypotheses(arm, everywhere=True), SEVERAL_FAULTS), given.get("fault")
        if not (fault is None or is_fault(fault) or (isinstance(fault, str) and fault in names)):
            raise UnknownName(
                f"unknown fault {fault!r}; give a fault of loose_env.faults or one of {list(names)}"
            )
        if "pose" in given:
            given["pose"] = arm.wrap(arm.checked_pose(given["pose"], reachable=True))
        return cls(**given)


_STATE = (
    *("seeds", "numbers", "_faults", "_mismatches", "_verdicts", "begun", "ended"),
    *("records", "_spent_levels", "_seconds", "_poses", "_visited", "_visits", "_flat"),
)
"""State of the episodes, but for their latest records."""
_FAULT, _MISMATCH, _POSE, _RECORD, _DRIFT = range(5)
"""Streams of random draws of an episode."""
_TOGETHER = 128
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
    settings : DiagnosisSettings, optional
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
        settings: DiagnosisSettings | None = None,
        *,
        num: int = 1,
        threads: int = 0,
        rig: BatchRig | None = None,
        true_arm: Arm | None = None,
    ) -> None:
        settings = settings or DiagnosisSettings()
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
        self._levels, self._drifts = np.array([0.0, *arm.levels]), settings.drift != Drift()
        # State of the episodes.
        most, n, layout = settings.max_records, arm.n, self.observations
        objects = np.full((5, num), None)  # seeds may have more bits than a whole number of numpy
        self.seeds, self._faults, self._mismatches, self._last, self._verdicts = objects
        """Root seed of each slot's run of episodes (num,)."""
        self.numbers = np.full(num, -1, dtype=np.intp)
        """Number of each slot's episode under it (num,)."""
        self.begun, self.ended = np.zeros((2, num), dtype=bool)
        """Whether an episode was started in each slot, and whether it has ended (num,)."""
        self.records, self._spent_levels = np.zeros((2, num), dtype=np.intp)
        """Records taken so far in each slot's episode (num,)."""
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
            fault=self._faults[slot],
            mismatch=self._mismatches[slot],
            pose=self._poses[slot].copy(),
            slots=self._slots[slot].copy(),
            records=int(self.records[slot]),
            seconds=float(self._seconds[slot]),
            last=None if last is None else last[0].measurement(last[1]),
            ended=bool(self.ended[slot]),
            verdict=self._verdicts[slot],
        )

    def _require_begun(self, slots: Sequence[int] | IndexArray) -> None:
        if not self.begun[slots].all():
            raise ResetNeeded("no episode is running: call reset() first")

    def start(
        self, slot: int, *, seed: int, number: int, options: Mapping[str, Any] | None = None
    ) -> None:
        """Begin an episode in a slot: hide a fault, take a random pose, measure nothing."""
        beginning = Beginning.of(options, self.true_arm)
        self.start_all([slot], seeds=[seed], numbers=[number], beginnings=[beginning])

    def start_all(
        self,
        slots: Sequence[int] | IndexArray,
        *,
        seeds: Sequence[int],
        numbers: Sequence[int],
        beginnings: Sequence[Beginning],
    ) -> None:
        """Begin episodes in slots; where one cannot be, none begins."""
        at, count, arm = np.asarray(slots, dtype=np.intp), len(slots), self.true_arm
        keys = [(number, kind, 0) for kind in (_FAULT, _MISMATCH, _POSE) for number in numbers]
        drawn = streams([*seeds] * 3, np.array(keys))
        of_fault, of_mismatch, of_pose = (drawn[k * count : (k + 1) * count] for k in range(3))
        poses = arm.random_poses(of_pose)
        for k, beginning in enumerate(beginnings):
            if beginning.pose is not None:
                poses[k] = beginning.pose
        mismatches, scales = np.full(count, None), np.array([b.mismatch_scale for b in beginnings])
        for scale in np.unique(scales):
            # The same stream gives the same draw at every scale, only larger or smaller.
            plain, own = self.difficulty.mismatch, np.flatnonzero(scales == scale)
            scaled = plain if scale == 1 else plain.scaled(float(scale))
            mismatches[own] = scaled.draw_all(arm, [of_mismatch[k] for k in own])
        self._mount(at, self._hidden(beginnings, of_fault), mismatches)
        for k, slot in enumerate(at):
            self.seeds[slot] = seeds[k]
        self._last[at] = self._verdicts[at] = None
        self.numbers[at], self._poses[at] = numbers, poses
        self.records[at] = self._spent_levels[at] = self._visits[at] = 0
        self._seconds[at], self._slots[at] = 0.0, 0.0
        self.begun[at], self.ended[at] = True, False
        self._show_globals(at)

    def _hidden(
        self, beginnings: Sequence[Beginning], rngs: Sequence[np.random.Generator]
    ) -> list[Fault]:
        """Draw faults, or take those that are given."""
        found: list[Any] = [beginning.fault for beginning in beginnings]
        rows = [k for k, own in enumerate(found) if own is None or isinstance(own, str)]
        rows = [k for k in rows if found[k] != SEVERAL_FAULTS]
        drawn = self.sampler.draw_all([rngs[k] for k in rows], [found[k] for k in rows])
        for k, fault in zip(rows, drawn, strict=True):
            found[k] = fault
        for k, (fault, beginning) in enumerate(zip(found, beginnings, strict=True)):
            if fault == SEVERAL_FAULTS:
                found[k] = self.sampler.several(rngs[k])
            if beginning.preload_g:
                found[k] = preloaded(self.true_arm, found[k], beginning.preload_g)
        return found

    def _mount(self, slots: IndexArray, faults: Any, mismatches: Any) -> None:
        """Put arms on the rig."""
        self.rig.mount_all(slots, faults, mismatches)
        self._faults[slots], self._mismatches[slots] = faults, mismatches

    def _show_globals(self, slots: IndexArray) -> None:
        """Enter pose and what has been spent into the observations."""
        self._flat[slots, : len(self.observations.global_elements)] = self.observations.globals_of(
            self._poses[slots],
            self.records[slots],
            self._seconds[slots],
            self._spent_levels[slots],
        )

    @cached_property
    def fingerprint(self) -> str:
        """Arm, settings, and what observations and actions mean, as 16 hexadecimal digits."""
        parts = (self.arm.name, repr(self.settings), self.observations.table())
        return hashlib.sha256("\n".join(parts).encode("utf-8")).hexdigest()[:16]

    def state(self) -> dict[str, Any]:
        """Copy of the episodes of all slots: arrays and lists with an entry for each."""
        latest = np.full(self.num, None)
        for slot, own in enumerate(self._last):
            latest[slot] = own and (own[0].some(np.array([own[1]])), 0)
        return {name: copy(getattr(self, name)) for name in _STATE} | {"_last": latest}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a copy of the episodes, with their arms on the rig."""
        for name, value in state.items():
            setattr(self, name, copy(value))
        self._slots = self.observations.slots_of(self._flat)
        begun = np.flatnonzero(self.begun)
        if len(begun):
            self._mount(begun, self._faults[begun], self._mismatches[begun])

    def place(self, slots: Sequence[int] | IndexArray, poses: Array) -> None:
        """Put the arms of A running episodes into poses (A, n), as no action can."""
        self._require_begun(slots)
        own = np.asarray(slots, dtype=np.intp)
        checked = [self.true_arm.checked_pose(pose, reachable=True) for pose in poses]
        self._poses[own] = self.true_arm.wrap(np.reshape(checked, (-1, self.arm.n)))
        self._show_globals(own)

    def masks(self, slots: Sequence[int] | IndexArray) -> NDArray[np.bool_]:
        """Return the allowed choices of the next actions of A slots (A, sum of choices)."""
        self._require_begun(slots)
        at = np.asarray(slots)
        return self.actions.masks(self._poses[at], self.records[at], self._measured(at))

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
        at = self._running(slots)
        action = self.actions.decode_all(actions)
        said, over = self._said(at, action.verdict), self.records[at] >= self.settings.max_records
        rows = np.flatnonzero(~(said | over))
        own, act = at[rows], action.some(rows)
        stayed = self._move(own, act.moves)
        torque, share, nominal, gravity = self._excite(own, act.levels)
        failures = self._measure(own, act, torque, share, nominal, gravity)
        rewards = np.zeros(len(at))
        rewards[rows] = -self._spend(own, act, (act.moves != self.actions.stay) & ~stayed, torque)
        ends = self._ends(at, action.verdict, said, over, rewards)
        told = self._told(at, rows, stayed, share) if len(rows) else {}
        told = told and {"verdict_ignored": np.asarray(action.verdict) > 0, **told}
        truncated = np.zeros(len(at), dtype=bool)
        for k, failure in failures.items():
            row = int(rows[k])
            truncated[row] = self.ended[own[k]] = True
            self.divergences[self._faults[own[k]].kind] += 1
            end = {"failure": failure} | self._truth(int(own[k]), None)
            ends[row] = _of_row(told, row) | end
        return Steps(
            rewards=rewards, terminated=said | over, truncated=truncated, told=told, ends=ends
        )

    def _running(self, slots: Sequence[int] | IndexArray) -> IndexArray:
        """Slots whose episodes go on."""
        at = np.asarray(slots, dtype=np.intp)
        self._require_begun(at)
        if self.ended[at].any():
            raise ResetNeeded("the episode has ended: call reset() before step()")
        return at

    def _said(self, at: IndexArray, verdicts: Any) -> NDArray[np.bool_]:
        """Which verdicts count (A,): none before the first record, "unsure" later still."""
        records, measured = self.records[at], self._measured(at)
        unsure = self.actions.allows_unsure(records, measured)
        named = (records >= self.settings.max_records) | (measured > 0)
        said = np.where(verdicts == self.actions.unsure, unsure, named)
        return np.asarray(said & (verdicts > 0))

    def _ends(
        self, at: IndexArray, verdicts: Any, said: Any, over: Any, rewards: Array
    ) -> dict[int, dict[str, Any]]:
        """End episodes by verdicts or by running out of records; enter rewards, return infos."""
        ends, prices = {}, self.settings.prices
        for k in np.flatnonzero(said | over).tolist():
            slot, named = int(at[k]), self.verdicts[verdicts[k] - 1] if said[k] else None
            self.ended[slot], self._verdicts[slot] = True, named
            ends[k] = ({"out_of_records": True} if named is None else {}) | self._truth(slot, named)
            truth = self._faults[slot].hypothesis
            rewards[k] = prices.wrong if named is None else prices.verdict(named, truth)
        return ends

    def _told(
        self, at: IndexArray, rows: IndexArray, stayed: NDArray[np.bool_], share: Array
    ) -> dict[str, NDArray[Any]]:
        """Entries of the infos of arms, some rows of which have taken a record."""
        told: dict[str, NDArray[Any]] = {
            "move_ignored": spread(stayed, rows, len(at)),
            "level_share": spread(share, rows, len(at)),
        }
        if self.settings.raw:
            told["measurement"] = np.full(len(at), None, dtype=object)
            for row in rows[[latest is not None for latest in self._last[at[rows]]]]:
                records, k = self._last[at[row]]
                told["measurement"][row] = RawMeasurement(**vars(records.measurement(k)))
        told["action_mask"] = self.masks(at)
        return told

    def _spend(
        self, slots: IndexArray, act: Action, moved: NDArray[np.bool_], torque: Array
    ) -> Array:
        """Count records, seconds and levels; return the price of each record (A,)."""
        prices, taken = self.settings.prices, _taken(torque)
        levels = np.where(taken, act.levels.sum(axis=1), 0)
        seconds = np.where(taken, act.duration, 0.0)
        self._seconds[slots] += seconds
        self._spent_levels[slots] += levels
        own = slots[taken]
        self._visited[own, self._visits[own]] = self._poses[own]
        self._visits[own] += 1
        self.records[slots] += 1
        self._show_globals(slots)
        price = prices.record + prices.move * moved.sum(axis=1)
        return np.asarray(price + (prices.second * seconds + prices.level * levels))

    def _move(self, slots: IndexArray, moves: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Move joints; one whose move leaves its range stays. Return which stayed (A, n)."""
        poses, joints = self._poses[slots], np.arange(self.arm.n)
        fits = self.actions.allowed_moves(poses)[np.arange(len(poses))[:, None], joints, moves]
        step = np.where(fits, self.actions.steps[joints, moves], 0.0)
        # Rounded to a nanoradian, or nanometre, so that going there and back is the same pose.
        self._poses[slots] = self.arm.wrap(poses + step).round(9)
        return ~fits

    def _measure(
        self,
        slots: IndexArray,
        act: Action,
        torque: Array,
        share: Array,
        nominal: Array,
        gravity: Array,
    ) -> dict[int, str]:
        """Measure arms, and enter what they show into the observations.

        Returns why the records of some failed, by their row.
        """
        self._drift(slots)
        self._last[slots] = None
        failures: dict[int, str] = {}
        excited = np.count_nonzero(torque, axis=1)

        def enter(rows: IndexArray, records: Records) -> None:
            """Enter records alike in length and number of excited joints."""
            try:
                found = self._observed(act.levels[rows], share[rows], records, nominal[rows])
            except InvalidData as error:
                if len(rows) == 1:
                    failures[int(rows[0])] = f"the readings make no statistics: {error}"
                    return
                for k, row in enumerate(rows):
                    enter(np.array([row]), records.some(np.array([k])))
                return
            own = slots[rows]
            self._slots[own, self.records[own]] = found

        for rows, records in self._simulated(slots, torque, act.duration, gravity):
            for k, row in enumerate(rows.tolist()):
                self._last[slots[row]] = (records, k)
                failure = records.failures[k]
                if failure is not None:
                    failures[row] = failure
            good = np.array([failure is None for failure in records.failures])
            for m in sorted(set(excited[rows].tolist())):
                chosen = np.flatnonzero(good & (excited[rows] == m))
                if len(chosen):
                    enter(rows[chosen], records.some(chosen))
        return failures

    def _excite(
        self, slots: IndexArray, levels: NDArray[np.intp]
    ) -> tuple[Array, Array, Array, Array]:
        """Torques for levels (A, n), shares allowed, predicted covariances, gravity's torques."""
        linear, arm, wanted = self.nominal, self.arm, self._levels[levels]
        torque, gravity, share = *np.zeros((2, *wanted.shape)), np.ones(wanted.shape)
        counts = np.count_nonzero(levels, axis=1)
        size = 2 * int(counts.max(initial=0)) + len(arm.axes)
        nominal = np.zeros((len(slots), size, size))

        def predict(rows: IndexArray, answer: tuple[ComplexArray, ComplexArray]) -> None:
            full = predictions(arm, torque[rows], self.floor, *answer).full
            nominal[rows, : full.shape[1], : full.shape[2]] = full

        for rows in _groups(counts):
            at, on = linear.at_all(self._poses[slots[rows]]), levels[rows] > 0
            answer = at.responses(on)
            gravity[rows] = at.gravity_torque
            found = torques_at_levels(arm, wanted[rows], gravity[rows], *answer)
            torque[rows], share[rows] = found
            driven = torque[rows] > 0
            if np.array_equal(driven, on):
                predict(rows, answer)
                continue
            for some in _groups(np.count_nonzero(driven, axis=1)):  # held otherwise than asked for
                if driven[some[0]].any():
                    predict(rows[some], at.some(some).responses(driven[some]))
        return torque, share, nominal, gravity

    def _observed(
        self, levels: NDArray[np.intp], share: Array, records: Records, nominal: Array
    ) -> NDArray[np.float32]:
        """Slots of records alike in length and number of excited joints."""
        links = expected = None
        if self._nominal_links is not None:
            links = link_readings_of_all(records)
            expected = self._nominal_links.transmission(records.pose, records.torque_rms > 0)
        return self.observations.slots_for(
            levels,
            share,
            *statistics_beside(records, nominal),
            rhythm=() if self._rhythm is None else self._rhythm.of(records),
            links=links,
            nominal_links=expected,
        )

    def _drift(self, slots: IndexArray) -> None:
        """Let true arms drift since the record before, if there was one and they do."""
        going = slots[(self.records[slots] > 0) & self._drifts]
        if not len(going):
            return
        draws = zip(self._mismatches[going], self._streams(going, _DRIFT), strict=True)
        after = [self.settings.drift.after(mismatch, rng) for mismatch, rng in draws]
        self._mount(going, self._faults[going], after)

    def _streams(self, slots: IndexArray, kind: int) -> list[np.random.Generator]:
        """Generators of one kind of draw for the next record of each slot."""
        key = [self.numbers[slots], np.full(len(slots), kind), self.records[slots]]
        return streams(self.seeds[slots].tolist(), np.array(key).T)

    def _simulated(
        self, slots: IndexArray, torque: Array, durations: Any, gravity: Array
    ) -> Iterator[tuple[IndexArray, Records]]:
        """Measure the arms whose drives have torque; yield records of one length with rows."""
        rows = np.flatnonzero(_taken(torque))
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
                gravity=gravity[own] if self.true_arm is self.arm else None,
            )
            for own in members
        ]
        for which, some, records in self.rig.record(asked):
            yield members[which][some], records

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
            "records": int(self.records[slot]),
            "seconds": float(self._seconds[slot]),
            "action_mask": self.masks([slot])[0],
        }


def _taken(torque: Array) -> NDArray[np.bool_]:
    """Which arms are measured (A,): not where gravity leaves a drive no torque (A, n)."""
    return np.asarray((torque > 0).any(axis=1))


def spread(values: NDArray[Any], rows: IndexArray, count: int) -> NDArray[Any]:
    """Values of some rows among those of all, zero for the others."""
    wide = np.zeros((count, *values.shape[1:]), dtype=values.dtype)
    wide[rows] = values
    return wide


def _groups(keys: NDArray[np.intp]) -> Iterator[IndexArray]:
    """Rows of equal keys, few enough for the processor's cache."""
    for key in sorted(set(keys.tolist())):
        rows = np.flatnonzero(keys == key)
        yield from (rows[k : k + _TOGETHER] for k in range(0, len(rows), _TOGETHER))


def _places(fault: Fault) -> set[int | None]:
    """Numbers of the links and joints where something is loose; None where nothing is."""
    faults = fault.faults if isinstance(fault, SeveralFaults) else (fault,)
    return {place_of(one.hypothesis) for one in faults}
