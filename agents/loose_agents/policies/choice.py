"""Policies choosing the next record: random, constant, fixed, greedy, look-ahead, open loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import Problem, action_of
from loose_agents.belief import AfterRecords, BeliefAgent, Estimator, Policy, Situation, belief_of
from loose_agents.evaluation import evaluate
from loose_agents.stored import tuned
from loose_env.diagnosis import (
    AmortisedPosterior,
    Belief,
    FaultPosterior,
    ImaginedFaults,
    RecordInformation,
    SeatFeatures,
)
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import torques_at_levels
from loose_env.typing import Array
from loose_env.wrappers import records_from


class BatchPolicy:
    """Policy that chooses the records of several episodes together, each as if it were alone."""

    def choose_all(self, situations: Sequence[Situation]) -> list[NDArray[np.int64]]:
        """Choose the next record of each episode."""
        raise NotImplementedError

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Choose the next record of one episode."""
        return self.choose_all([situation])[0]


class RandomPolicy:
    """Excites one random joint at a random level and duration, in random poses."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Sample an action from the episode's generator."""
        problem, rng = self.problem, situation.rng
        moves = random_moves(problem, situation)
        levels = np.zeros(problem.arm.n, dtype=np.intp)
        levels[rng.integers(problem.arm.n)] = rng.integers(1, 1 + len(problem.arm.levels))
        duration = int(rng.integers(len(problem.settings.durations)))
        return problem.actions.encode(moves=moves, levels=levels, duration=duration)


def random_moves(problem: Problem, situation: Situation) -> NDArray[np.intp]:
    """Sample an allowed move for every joint (n,)."""
    drawn = problem.random_moves(situation.pose, situation.rng)
    return problem.actions.few_moves(drawn, situation.rng)


class ConstantPolicy:
    """Applies a constant excitation in random poses."""

    def __init__(
        self, problem: Problem, levels: tuple[int, ...], *, duration: int | None = None
    ) -> None:
        if len(levels) != problem.arm.n or not any(levels):
            raise InvalidSetting(
                f"a constant policy needs a level for each of {problem.arm.n} joints, at least one "
                f"of them above 0; got {levels}"
            )
        self.problem, self.levels, self.duration = problem, np.array(levels), duration

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Move at random and apply the constant excitation."""
        return self.problem.actions.encode(
            moves=random_moves(self.problem, situation), levels=self.levels, duration=self.duration
        )


def information_of(problem: Problem, estimator: Estimator) -> RecordInformation:
    """Build the information criterion for the beliefs of an estimator."""
    posterior = getattr(estimator, "posterior", None)
    if isinstance(posterior, AmortisedPosterior):
        return RecordInformation(posterior.features, posterior.frictions)
    if isinstance(posterior, FaultPosterior):
        difficulty = difficulty_named(problem.settings.difficulty)
        features = SeatFeatures(
            problem.linear,
            problem.settings.sensors,
            difficulty.mismatch,
            directions=len(posterior.directions),
            over=difficulty.friction_over,
        )
        return RecordInformation(features, posterior.frictions)
    raise InvalidSetting(
        "choosing records by information needs an estimator with a posterior over places and "
        f"frictions, not {type(estimator).__name__}"
    )


def _constant(problem: Problem, estimator: Estimator) -> Policy:
    top = len(problem.arm.levels)
    usual = [top] + [0] * (problem.arm.n - 1)  # joint 1 moves everything behind it
    levels = tuned(problem).get("constant", usual)
    return ConstantPolicy(problem, tuple(min(level, top) for level in levels))


POLICIES: dict[str, tuple[Callable[[Problem, Estimator], Policy], str]] = {
    "random": (lambda problem, _: RandomPolicy(problem), "random poses, joint, level and length"),
    "constant": (_constant, "the best single joint and level, random poses"),
    "together": (
        lambda problem, _: ConstantPolicy(problem, (len(problem.arm.levels),) * problem.arm.n),
        "all joints at the top level, random poses",
    ),
    "fixed": (
        lambda problem, _: FixedPolicy(problem, tuned_sequence(problem)),
        "the same records on every arm, the best of many sequences",
    ),
    "open_loop": (
        lambda problem, made: OpenLoopPolicy(problem, information_of(problem, made), made),
        "records that the model chooses without looking at any result",
    ),
    "greedy": (
        lambda problem, made: GreedyPolicy(problem, information_of(problem, made)),
        "the record that is expected to say most",
    ),
    "look_ahead": (
        lambda problem, made: LookAheadPolicy(problem, information_of(problem, made)),
        "the record that is worth most with the next one in view",
    ),
    "foresight": (
        lambda problem, made: ForesightPolicy(problem, made),
        "the record after which a network foretells the least doubt",
    ),
}
"""Constructor and short description of each policy."""


def make_policy(name: str, problem: Problem, estimator: Estimator) -> Policy:
    """Make a policy for a problem and its estimator.

    Raises
    ------
    UnknownName
        If there is no policy of that name.
    """
    if name not in POLICIES:
        raise UnknownName(f"unknown policy {name!r}; policies are {list(POLICIES)}")
    return POLICIES[name][0](problem, estimator)


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """C records that could be taken next."""

    arm: NDArray[np.intp]
    """Arm that each is for (C,)."""
    moves: NDArray[np.intp]
    """Moves of the joints (C, n)."""
    levels: NDArray[np.intp]
    """Levels of the joints (C, n)."""
    duration: NDArray[np.intp]
    """Indices of their lengths (C,)."""
    poses: Array
    """Joint positions of the records [rad or m] (C, n)."""
    torque: Array
    """Rms torque of every joint, within the drives' limits [N·m or N] (C, n)."""
    seconds: Array
    """Their lengths [s] (C,)."""
    price: Array
    """Costs of the records (C,)."""

    def __len__(self) -> int:
        return len(self.price)

    def __getitem__(self, rows: Any) -> Candidates:
        """Some of the records."""
        return Candidates(**{name: values[rows] for name, values in vars(self).items()})

    def by_arm(self, count: int, order: Array | None = None) -> list[Candidates]:
        """Those of each of some arms, the highest of ``order`` (C,) first."""
        rank = np.arange(len(self)) if order is None else np.argsort(-order, kind="stable")
        return [self[rank[self.arm[rank] == arm]] for arm in range(count)]

    def action(self, problem: Problem, k: int) -> NDArray[np.int64]:
        """Action that takes one of them."""
        return problem.actions.encode(
            moves=self.moves[k], levels=self.levels[k], duration=int(self.duration[k])
        )


EVERY_MOVE = 64
"""Moves of one joint that are all weighed, where one may move: a sample misses the best one."""


def poses(
    problem: Problem, situation: Situation, count: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Sample moves uniformly from the allowed ranges, with the resulting poses."""
    allowed = problem.actions.allowed_moves(situation.pose)
    options = [np.flatnonzero(row) for row in allowed]
    stay, n = problem.settings.stay, problem.arm.n
    one = [(j, k) for j, own in enumerate(options) for k in own if k != stay]
    total = int(np.prod([len(o) for o in options], dtype=np.int64))
    if problem.actions.most_moved == 1 and len(one) < EVERY_MOVE:
        moves = np.full((1 + len(one), n), stay)
        moves[np.arange(1, len(moves)), [j for j, _ in one]] = [k for _, k in one]
    elif total <= count and problem.actions.most_moved == n:
        moves = np.stack(np.meshgrid(*options, indexing="ij"), -1).reshape(-1, len(options))
    else:
        drawn = [situation.rng.choice(o, 2 * count) for o in options]
        moves = np.unique(problem.actions.few_moves(np.stack(drawn, 1), situation.rng), axis=0)
        moves = situation.rng.permutation(moves)[:count]
    steps = problem.actions.steps[np.arange(problem.arm.n), moves]
    where = problem.arm.wrap(situation.pose + steps)
    return moves.astype(np.intp), np.round(where, 9)


Excitations = list[tuple[NDArray[np.intp], int]]
"""Levels of the joints (n,) and index of the duration."""


def excitations(problem: Problem) -> tuple[Excitations, Excitations]:
    """Enumerate excitations: those weighed in every pose, then those weighed in the best ones.

    The first is all joints together at the top level for the longest time; the further ones are
    lower levels, shorter times, and each joint alone at the two highest levels. Where not all
    joints may be excited at once, the first are each joint alone at the top level.
    """
    n, top = problem.arm.n, len(problem.arm.levels)
    durations = problem.settings.durations
    longest = int(np.argmax(durations))
    alone = list(np.eye(n, dtype=np.intp))
    first = [np.ones(n, dtype=np.intp)] if problem.actions.most_excited == n else alone
    found = [(level * one, longest) for level in range(top, 0, -1) for one in first]
    found += [(top * one, k) for k in range(len(durations)) if k != longest for one in first]
    if len(first) == 1:
        for level in range(top, max(top - 2, 0), -1):
            found += [(level * one, longest) for one in alone]
    return found[: len(first)], found[len(first) :]


def candidates_at(
    problem: Problem,
    places: Sequence[tuple[NDArray[np.intp], Array]],
    every: Excitations,
) -> Candidates:
    """Each of the moves (K, n) of some arms, to poses (K, n), with every one of some excitations.

    The torques are those of the levels in the pose.
    """
    arm, prices = problem.arm, problem.settings.prices
    owner = np.repeat(np.arange(len(places)), [len(moves) for moves, _ in places])
    moves, where = (np.concatenate(part) for part in zip(*places, strict=True))
    pose = np.repeat(np.arange(len(moves)), len(every))
    levels = np.tile(np.array([own for own, _ in every]), (len(moves), 1))
    duration = np.tile(np.array([length for _, length in every]), len(moves))
    wanted, at = np.array([0.0, *arm.levels])[levels], problem.linear.at_all(where)
    torque, excited = np.zeros(wanted.shape), np.count_nonzero(levels, axis=1)
    for count in np.unique(excited):
        rows = np.flatnonzero(excited == count)
        here = at.some(pose[rows])
        answer = here.responses(wanted[rows] > 0)
        torque[rows], _ = torques_at_levels(arm, wanted[rows], here.gravity_torque, *answer)
    seconds = np.array(problem.settings.durations)[duration]
    moved = np.count_nonzero(moves != problem.settings.stay, axis=1)[pose]
    price = prices.record + prices.second * seconds + prices.level * levels.sum(axis=1)
    return Candidates(
        arm=owner[pose],
        moves=moves[pose],
        levels=levels,
        duration=duration,
        poses=where[pose],
        torque=torque,
        seconds=seconds,
        price=price + prices.move * moved,
    )


TOGETHER_POSES, SINGLE_POSES = 16, 6
"""Poses weighed with all joints shaken at the top level; with each joint shaken alone."""
SHORTLIST = 1
"""The best of these, weighed with every other excitation too."""
WORTH = 0.5
"""Value of a nat of information, in the environment's reward."""


class GreedyPolicy(BatchPolicy):
    """Maximises expected information over pose, joints, level and duration."""

    def __init__(self, problem: Problem, information: RecordInformation) -> None:
        self.problem, self.information = problem, information

    def choose_all(self, situations: Sequence[Situation]) -> list[NDArray[np.int64]]:
        """Choose the best of the scored records of each episode."""
        faults = imagined(self.information, situations)
        best = ranked(self.problem, self.information, situations, faults)
        return [own.action(self.problem, 0) for own in best]


def imagined(information: RecordInformation, situations: Sequence[Situation]) -> ImaginedFaults:
    """Thin the beliefs of several episodes."""
    return information.imagine([belief_of(s) for s in situations], [s.rng for s in situations])


def ranked(
    problem: Problem,
    information: RecordInformation,
    situations: Sequence[Situation],
    faults: ImaginedFaults,
    planned: Array | None = None,
) -> list[Candidates]:
    """Score candidate records of each of A episodes and sort them, best first.

    After records with the likelihood ``planned`` (A, M, M) where it is given, as
    `loose_env.diagnosis.RecordInformation.of` takes it.
    """

    def value(candidates: Candidates) -> Array:
        worth = np.full(len(candidates), -np.inf)
        some = candidates.torque.any(axis=1)  # gravity leaves the drives nothing in the others
        own = candidates[some]
        found = information.of(faults, own.poses, own.torque, own.seconds, planned, beliefs=own.arm)
        worth[some] = WORTH * found.information - own.price
        return worth

    first, further = excitations(problem)
    count = TOGETHER_POSES if len(first) == 1 else SINGLE_POSES
    places = [poses(problem, situation, count) for situation in situations]
    found = candidates_at(problem, places, first)
    worth = value(found)
    if further:
        best = found.by_arm(len(places), worth)
        shortlist = [(own.moves[:SHORTLIST], own.poses[:SHORTLIST]) for own in best]
        more = candidates_at(problem, shortlist, further)
        found, worth = _joined(found, more), np.concatenate([worth, value(more)])
    return found.by_arm(len(places), worth)


def _joined(*parts: Candidates) -> Candidates:
    """Candidates of several parts, one after the other."""
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Candidates(**dict(zip(vars(parts[0]), map(np.concatenate, columns), strict=True)))


FORESEEN_POSES = 64
"""Poses in which every joint's record is foretold, where there are more."""


class ForesightPolicy(BatchPolicy):
    """Takes the record after which the least doubt is foretold: one joint at its top level."""

    def __init__(self, problem: Problem, estimator: Any, foresight: Any = None) -> None:
        self.problem, self.estimator = problem, estimator
        from loose_agents.rl.foresight import Foresight

        own = getattr(estimator, "foresight", None) if foresight is None else foresight
        self.foresight = Foresight.load(problem) if own is None else own

    def choose_all(self, situations: Sequence[Situation]) -> list[NDArray[np.int64]]:
        """Choose the next record of each episode."""
        problem = self.problem
        where = [poses(problem, situation, FORESEEN_POSES) for situation in situations]
        owner = np.repeat(np.arange(len(where)), [len(moves) for moves, _ in where])
        moves, there = (np.concatenate(part) for part in zip(*where, strict=True))
        p, shown = self.estimator.seen([situation.memory for situation in situations])
        entropies = self.foresight.entropies(p[owner], shown[owner], problem.linear.geometry(there))
        top, chosen = len(problem.arm.levels) * np.eye(problem.arm.n, dtype=np.intp), []
        for k in range(len(situations)):
            rows = np.flatnonzero(owner == k)
            pose, joint = np.unravel_index(entropies[rows].argmin(), (len(rows), problem.arm.n))
            chosen.append(problem.actions.encode(moves=moves[rows[pose]], levels=top[joint]))
        return chosen


FIRST_RECORDS, SECOND_RECORDS = 4, 4
"""First records that the look-ahead weighs, the best by information; poses after each."""
OUTCOMES = 24
"""Outcomes that the look-ahead imagines of each first record."""


class LookAheadPolicy(BatchPolicy):
    """Maximises the expected reward after a record, or after one more.

    The value of a record is the expected reward of the best name less what the records cost.
    """

    def __init__(self, problem: Problem, information: RecordInformation) -> None:
        self.problem, self.information = problem, information

    def choose_all(self, situations: Sequence[Situation]) -> list[NDArray[np.int64]]:
        """Choose the record of the highest value in each episode."""
        problem, faults = self.problem, imagined(self.information, situations)
        every = ranked(problem, self.information, situations, faults)
        firsts = [own[:FIRST_RECORDS] for own in every]
        firsts = [own[own.torque.any(axis=1)] if own.torque.any() else own[:1] for own in firsts]
        after = [
            poses(problem, replace(situation, pose=pose), SECOND_RECORDS)
            for own, situation in zip(firsts, situations, strict=True)
            for pose in own.poses
        ]
        arm = np.repeat(np.arange(len(firsts)), [len(own) for own in firsts])
        seconds = candidates_at(problem, after, excitations(problem)[0])
        seconds = seconds[seconds.torque.any(axis=1)]
        first = seconds.arm  # the first record that each one follows
        together = _joined(*firsts, seconds)
        whose = np.concatenate([arm, arm[first]])
        likely = self.information.likelihoods(
            faults, together.poses, together.torque, together.seconds, beliefs=whose
        )
        values = np.array(
            [
                self._value(
                    likely[k],
                    float(together.price[k]),
                    likely[len(arm) :][first == k],
                    seconds.price[first == k],
                    faults[arm[k]],
                )
                for k in range(len(arm))
            ]
        )
        chosen = [int(np.argmax(values[arm == a])) for a in range(len(firsts))]
        return [own.action(problem, k) for own, k in zip(firsts, chosen, strict=True)]

    def _value(
        self, first: Array, price: float, seconds: Array, prices: Array, faults: ImaginedFaults
    ) -> float:
        """Expected reward after the first record (M, M), or after one of those that follow it."""
        worth = self.problem.settings.prices
        stake = worth.correct - worth.wrong
        ticks = (np.arange(OUTCOMES) + 0.5) / OUTCOMES
        drawn = np.searchsorted(np.cumsum(faults.weight), ticks * faults.weight.sum())
        weight = faults.weight * first[np.minimum(drawn, len(faults.weight) - 1)]
        weight /= weight.sum(1, keepdims=True)
        total, most = np.zeros((2, len(seconds), *weight.T.shape))  # (N, M, outcomes)
        now = []
        for hypothesis in np.unique(faults.hypothesis):
            own = faults.hypothesis == hypothesis
            share = seconds[:, :, own] @ weight[:, own].T  # after the second record, too
            total += share
            np.maximum(most, share, out=most)
            now.append(weight[:, own].sum(1))
        then = np.einsum("om,nmo->no", weight, most / total) - prices[:, None] / stake
        best = np.maximum(np.max(now, axis=0), then.max(axis=0, initial=-np.inf))
        return float(worth.wrong + stake * best.mean() - price)


FIXED_RECORDS = 4
"""Longest sequence of the agents without stopping, `fixed_1` to `fixed_4`."""

Records = tuple[tuple[int, ...], ...]
"""Records one after the other, each as an action of the environment."""


class FixedPolicy:
    """Takes the same records on every arm, then begins again.

    The first pose is random and moves are relative, so a move may lead out of a joint's range: the
    joint then makes the opposite move if it can, and stays if not.
    """

    def __init__(self, problem: Problem, sequence: Sequence[Sequence[int]]) -> None:
        if not sequence:
            raise InvalidSetting("a fixed sequence has one record or more")
        self.problem = problem
        self.records = [problem.actions.decode(action) for action in sequence]
        moves = np.array(problem.settings.moves)
        self._opposite = np.abs(moves[:, None] + moves).argmin(axis=1)

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Take the next record of the sequence."""
        problem = self.problem
        record = self.records[situation.records % len(self.records)]
        allowed, joints = problem.actions.allowed_moves(situation.pose), np.arange(problem.arm.n)
        other = self._opposite[record.moves]
        moves = np.where(allowed[joints, other], other, problem.settings.stay)
        moves = np.where(allowed[joints, record.moves], record.moves, moves)
        return problem.actions.encode(
            moves=moves,
            levels=record.levels,
            duration=problem.settings.durations.index(record.duration),
        )


def drawn_sequences(
    problem: Problem, count: int, length: int, rng: np.random.Generator
) -> list[Records]:
    """Draw sequences of records to choose a fixed one from.

    Moves are uniform. Joints are excited at the top level for the longest time: every other
    sequence all of them in every record where the rules allow, else one at a time, each joint
    once before one comes again.
    """
    n, actions = problem.arm.n, problem.actions
    top, found = len(problem.arm.levels), []
    for k in range(count):
        order = np.concatenate([rng.permutation(n) for _ in range(-(-length // n))])
        moves = rng.integers(len(problem.settings.moves), size=(length, n))
        moves = actions.few_moves(moves.astype(np.intp), rng)
        together = actions.most_excited == n and k % 2 == 0
        found.append(
            tuple(
                tuple(
                    actions.encode(
                        moves=moves[r],
                        levels=top * (np.ones(n) if together else np.eye(n)[order[r]]).astype(int),
                    ).tolist()
                )
                for r in range(length)
            )
        )
    return found


def tuned_sequence(problem: Problem, records: int | None = None) -> Records:
    """Best sequence of training episodes: of a number of records, or with its own stopping."""
    chosen = tuned(problem).get("fixed", {}).get("stopping" if records is None else str(records))
    if chosen is None:
        raise InvalidSetting(
            f"no fixed sequence was chosen for arm {problem.arm.name!r} under these rules: "
            "python scripts/agents/tune_agents.py --agents amortised/fixed chooses one on "
            "training episodes"
        )
    return tuple(tuple(int(entry) for entry in action) for action in chosen)


class OpenLoopPolicy(BatchPolicy):
    """Maximises expected information over records whose results it does not look at.

    It knows where the arm is and which records were taken, and counts on what they will have
    shown on average over the prior.
    """

    def __init__(
        self,
        problem: Problem,
        information: RecordInformation,
        estimator: Estimator,
    ) -> None:
        self.problem, self.information = problem, information
        start = getattr(estimator.begin(), "belief", None)
        prior = getattr(start, "belief", start)
        if not isinstance(prior, Belief):
            raise InvalidSetting(
                "open_loop needs an estimator that keeps a posterior over places and frictions, "
                f"not {type(estimator).__name__}"
            )
        self._prior = prior

    def choose_all(self, situations: Sequence[Situation]) -> list[NDArray[np.int64]]:
        """Choose the best of the scored records of each episode, given which ones were taken."""
        count, rngs = len(situations), [situation.rng for situation in situations]
        faults = self.information.imagine([self._prior] * count, rngs)
        observations = np.stack([situation.observation for situation in situations])
        slots = self.problem.layout.slots_of(observations)
        arm, slot = np.nonzero(slots[..., 0] > 0.5)
        records = records_from(self.problem.layout, slots[arm, slot])
        likely = self.information.likelihoods(
            faults, records.pose, records.torque, records.duration, beliefs=arm
        )
        planned = np.stack([likely[arm == k].prod(axis=0) for k in range(count)])
        best = ranked(self.problem, self.information, situations, faults, planned)
        return [own.action(self.problem, 0) for own in best]


def designed_sequences(
    policy: OpenLoopPolicy, estimator: Estimator, count: int, length: int, *, seed: int
) -> list[Records]:
    """Sequences that the model chooses in open loop, each from another first pose."""
    problem, stopping = policy.problem, AfterRecords(records=length)
    agent = BeliefAgent(problem, estimator, policy, stopping, surprising=0.0)
    rows = evaluate(
        agent, "", problem.arm, problem.settings, episodes=count, seed=seed, threads=1,
        options={"fault": "healthy"},
    )  # fmt: skip
    taken = [row.actions.split()[:length] for row in rows]
    return [tuple(tuple(action_of(problem.actions, c).tolist()) for c in own) for own in taken]
