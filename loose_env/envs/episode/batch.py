"""Episodes: the rules of the diagnosis, for any number of arms at once.

The single and the vector environment are thin shells around `EpisodeBatch`, so that both
give the same episode bit for bit. Every random draw comes from a stream of its own, keyed by
(seed, episode, stream, record): what an agent does, how many arms run beside it and what ran
before change nothing.
"""

from __future__ import annotations

import copy
import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from loose_env.arms import Arm, Drift, LinearArm, MismatchDraw
from loose_env.diagnosis import (
    SensorFloor,
)
from loose_env.envs.episode.actions import Action, ActionLayout
from loose_env.envs.episode.observation import ObservationLayout
from loose_env.envs.episode.record_writer import AskedRecord, RecordWriter
from loose_env.envs.episode.reset_options import ResetOptions, checked_true_arm
from loose_env.envs.episode.state import (
    Episode,
    Outcome,
    RawMeasurement,
    raw_observation,
    raw_space,
)
from loose_env.envs.faults.difficulty import difficulty_named
from loose_env.envs.faults.sampler import FaultSampler
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation, all_at_levels
from loose_env.faults import UNSURE, Fault, Healthy, SeveralFaults, hypotheses, place_of
from loose_env.rig import Job, Measurement, ReducedRig, SimulatedRig
from loose_env.typing import Array

__all__ = ["BatchRig", "EpisodeBatch"]

_FAULT, _MISMATCH, _POSE, _RECORD, _DRIFT = range(5)


class BatchRig(Protocol):
    """Protocol of a rig: arms in slots, measured several at once."""

    def mount(self, slot: int, fault: Fault, mismatch: MismatchDraw | None = None) -> None:
        """Put a new arm into a slot."""
        ...

    def measure_many(self, jobs: Sequence[Job]) -> list[Measurement]:
        """Take one measurement on each of several slots."""
        ...


class EpisodeBatch:
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
        says; see `loose_env.envs.episode.reset_options`. The nominal arm by default.

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
        self.rig: BatchRig
        if rig is None:
            # One linear arm for both: it remembers the poses it has worked out.
            self.rig, true = _simulated_rig(self.true_arm, settings, num, threads)
        else:
            self.rig, true = rig, LinearArm(self.true_arm)
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
        self._writer = RecordWriter(arm, settings, self.observations, self.floor)
        self.divergences: Counter[str] = Counter()
        self._episodes: list[Episode | None] = [None] * num
        self._levels = np.array([0.0, *arm.levels])

    @property
    def space(self) -> spaces.Space[Any]:
        """Observation space of one arm: flat, or with raw signals where the settings ask."""
        flat = self.observations
        return raw_space(self.arm, self.settings, flat) if self.settings.raw else flat.space

    def has_episode(self, slot: int) -> bool:
        """Return whether an episode was started in a slot."""
        return self._episodes[slot] is not None

    def episode(self, slot: int) -> Episode:
        """Return the latest episode of a slot, running or ended.

        Raises
        ------
        ResetNeeded
            If none was started.
        """
        episode = self._episodes[slot]
        if episode is None:
            raise ResetNeeded("no episode is running: call reset() first")
        return episode

    def start(
        self, slot: int, *, seed: int, number: int, options: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Begin an episode in a slot: hide a fault, take a random pose, measure nothing."""
        return self.begin(slot, self.drawn(seed=seed, number=number, options=options))

    def drawn(self, *, seed: int, number: int, options: Mapping[str, Any] | None = None) -> Episode:
        """Draw all that is hidden in an episode, and its first pose."""
        given = ResetOptions.of(options, self.true_arm)
        blank = np.zeros(
            (self.settings.max_records, len(self.observations.slot_elements)), dtype=np.float32
        )
        episode = Episode(
            seed=seed, number=number, fault=Healthy(), pose=np.zeros(self.arm.n), slots=blank
        )
        episode.fault = given.hidden_fault(self.sampler, episode.stream(_FAULT))
        episode.pose = given.first_pose(episode.stream(_POSE))
        episode.mismatch = given.true_arm(self.difficulty.mismatch, episode.stream(_MISMATCH))
        return episode

    def begin(self, slot: int, episode: Episode) -> dict[str, Any]:
        """Begin a drawn episode in a slot, and mount its arm on the rig."""
        self.rig.mount(slot, episode.fault, episode.mismatch)
        self._episodes[slot] = episode
        return {"action_mask": self.mask(slot)}

    def episode_copy(self, slot: int) -> Episode | None:
        """Copy of a slot's latest episode, None where none was started."""
        return copy.deepcopy(self._episodes[slot])

    @cached_property
    def fingerprint(self) -> str:
        """Arm, settings, and what observations and actions mean, as 16 hexadecimal digits."""
        parts = (self.arm.name, repr(self.settings), self.observations.table())
        return hashlib.sha256("\n".join(parts).encode("utf-8")).hexdigest()[:16]

    def check_fits(self, fingerprint: str) -> None:
        """Refuse a state of another arm or other settings.

        Raises
        ------
        InvalidSetting
            If its fingerprint is another one.
        """
        if fingerprint != self.fingerprint:
            raise InvalidSetting(
                "the state was taken from an environment of another arm or other settings; make "
                "this environment with the same arguments"
            )

    def restore(self, slot: int, episode: Episode | None) -> None:
        """Put a copy of an episode into a slot, and its arm on the rig."""
        if episode is not None:
            self.rig.mount(slot, episode.fault, episode.mismatch)
        self._episodes[slot] = copy.deepcopy(episode)

    def mask(self, slot: int) -> NDArray[np.bool_]:
        """Return the allowed choices of a slot's next action."""
        episode = self.episode(slot)
        return self.actions.mask(episode.pose, episode.records, episode.measured)

    def observe(self, slot: int) -> NDArray[np.float32]:
        """Return the flat observation of a slot."""
        e = self.episode(slot)
        head = self.observations.globals_of(e.pose, e.records, e.seconds, e.levels)
        return np.concatenate([head, e.slots.ravel()])

    def shown(self, slot: int) -> Any:
        """Return the observation in the form that the settings ask for, flat or raw."""
        flat = self.observe(slot)
        if not self.settings.raw:
            return flat
        return raw_observation(self.arm, self.settings, flat, self.episode(slot).last)

    def step(self, slots: Sequence[int], actions: Sequence[Any]) -> list[Outcome]:
        """Take one step in each of the given slots; arms that measure do so together."""
        decoded = [self.actions.decode(action) for action in actions]
        outcomes: dict[int, Outcome] = {}
        asked: list[AskedRecord] = []
        for slot, action in zip(slots, decoded, strict=True):
            episode = self.episode(slot)
            if episode.ended:
                raise ResetNeeded("the episode has ended: call reset() before step()")
            if self._heard(episode, action):
                outcomes[slot] = self._end(episode, self.verdicts[action.verdict - 1], {})
            elif episode.records >= self.settings.max_records:
                outcomes[slot] = self._end(episode, None, {"out_of_records": True})
            else:
                info: dict[str, Any] = {"verdict_ignored": action.verdict > 0}
                info["move_ignored"] = self._move(episode, action)
                at = self.nominal.at(episode.pose)
                asked.append(
                    AskedRecord(slot=slot, episode=episode, action=action, at=at, info=info)
                )
        self._take_records(asked)
        for each in asked:
            outcomes[each.slot] = self._enter(each)
        return [outcomes[slot] for slot in slots]

    def _heard(self, episode: Episode, action: Action) -> bool:
        """Return whether an action's verdict counts: there is something to base it on."""
        if action.verdict == self.actions.unsure:
            return self.actions.allows_unsure(episode.records, episode.measured)
        last = episode.records >= self.settings.max_records
        return action.verdict > 0 and (last or episode.measured > 0)

    def _take_records(self, asked: Sequence[AskedRecord]) -> None:
        """Excite and measure all arms that ask for a record, and work out what they show."""
        if not asked:
            return
        for each in asked:
            self._drift(each.slot, each.episode)
        excitations, shares = all_at_levels(
            [each.at for each in asked],
            self._levels[np.array([each.action.levels for each in asked])],
            durations=[each.action.duration for each in asked],
        )
        jobs, played = [], []
        for each, excitation, share in zip(asked, excitations, shares, strict=True):
            each.share = each.info["level_share"] = share
            if any(excitation.excited):  # not where gravity leaves a drive no torque
                jobs.append(self._job(each.slot, each.episode, excitation))
                played.append(each)
        measured = self._measured(jobs)
        self._writer.write((played[k], measurement) for k, measurement in measured)

    def _drift(self, slot: int, episode: Episode) -> None:
        """Let the true arm drift since the record before, if there was one and it does."""
        if self.settings.drift == Drift() or not episode.records or episode.mismatch is None:
            return
        rng = episode.stream(_DRIFT, episode.records)
        episode.mismatch = self.settings.drift.after(episode.mismatch, rng)
        self.rig.mount(slot, episode.fault, episode.mismatch)

    def _measured(self, jobs: Sequence[Job]) -> Iterable[tuple[int, Measurement]]:
        """Measure; a simulated rig gives each record out while it works on the next ones."""
        if not jobs:
            return ()
        if isinstance(self.rig, (SimulatedRig, ReducedRig)):
            return self.rig.measure_each(jobs)
        return enumerate(self.rig.measure_many(jobs))

    def simulate(
        self,
        fault: Fault,
        pose: Array,
        excitation: Excitation,
        rng: np.random.Generator,
        *,
        mismatch: MismatchDraw | None = None,
    ) -> Measurement:
        """Measure an arm with a given fault outside any episode.

        The mismatch is drawn from ``rng`` unless it is given.
        """
        draw = self.difficulty.mismatch.draw(self.true_arm, rng) if mismatch is None else mismatch
        rig, _ = _simulated_rig(self.true_arm, self.settings, 1, 1)
        rig.mount(0, fault, draw)
        return rig.measure(pose, excitation, rng=rng)

    def _job(self, slot: int, episode: Episode, excitation: Excitation) -> Job:
        return Job(
            slot=slot,
            pose=episode.pose,
            excitation=excitation,
            rng=episode.stream(_RECORD, episode.records),
        )

    def _move(self, episode: Episode, action: Action) -> NDArray[np.bool_]:
        """Move the joints; a joint whose move leaves its range stays. Return which stayed."""
        allowed = self.actions.allowed_moves(episode.pose)
        fits = allowed[np.arange(self.arm.n), action.moves]
        step = np.where(fits, self.actions.steps[np.arange(self.arm.n), action.moves], 0.0)
        # Rounded to a nanoradian, or nanometre, so that going there and back is the same pose.
        episode.pose = np.round(self.arm.wrap(episode.pose + step), 9)
        return ~fits

    def _enter(self, asked: AskedRecord) -> Outcome:
        """Enter a record into the episode; without excitation there is none."""
        episode, action, info = asked.episode, asked.action, asked.info
        measurement, failure = asked.measurement, asked.failure
        prices = self.settings.prices
        moved = (action.moves != self.settings.stay) & ~info["move_ignored"]
        price = prices.record + prices.move * int(moved.sum())
        if measurement is not None:
            levels = int(action.levels.sum())
            price += prices.second * action.duration + prices.level * levels
            episode.seconds += action.duration
            episode.levels += levels
            episode.visited.add(episode.pose.tobytes())
        episode.last = measurement
        episode.records += 1
        if failure is not None:
            self.divergences[episode.fault.kind] += 1
            episode.ended = True
            info |= {"failure": failure} | self._truth(episode, None)
            return Outcome(reward=-price, terminated=False, truncated=True, info=info)
        if self.settings.raw:
            info["measurement"] = (
                None if measurement is None else RawMeasurement(**vars(measurement))
            )
        info["action_mask"] = self.mask(asked.slot)
        return Outcome(reward=-price, terminated=False, truncated=False, info=info)

    def _end(self, episode: Episode, named: str | None, info: dict[str, Any]) -> Outcome:
        truth = episode.fault.hypothesis
        prices = self.settings.prices
        reward = prices.wrong if named is None else prices.verdict(named, truth)
        episode.ended, episode.verdict = True, named
        return Outcome(
            reward=reward, terminated=True, truncated=False, info=info | self._truth(episode, named)
        )

    def _truth(self, episode: Episode, named: str | None) -> dict[str, Any]:
        truth = episode.fault.hypothesis
        right_place = named not in (None, UNSURE) and place_of(named) in _places(episode.fault)
        return {
            "fault": truth,
            "fault_figures": episode.fault,
            "verdict": named,
            "is_success": named == truth,
            "link_success": right_place,
            "poses": len(episode.visited),
            "records": episode.records,
            "seconds": episode.seconds,
            "action_mask": self.actions.mask(episode.pose, episode.records, episode.measured),
        }


def _places(fault: Fault) -> set[int | None]:
    """Numbers of the links and joints where something is loose; None where nothing is."""
    faults = fault.faults if isinstance(fault, SeveralFaults) else (fault,)
    return {place_of(one.hypothesis) for one in faults}


def _simulated_rig(
    arm: Arm, settings: DiagnosisSettings, num: int, threads: int
) -> tuple[SimulatedRig | ReducedRig, LinearArm]:
    """Build the rig of the engine that the settings name."""
    rig: SimulatedRig | ReducedRig
    if settings.engine == "reduced":
        rig = ReducedRig(arm, slots=num, sensors=settings.sensors, threads=threads)
    else:
        rig = SimulatedRig(arm, slots=num, sensors=settings.sensors, threads=threads)
    return rig, rig.nominal
