"""Policies choosing the next record: random, constant, fixed, greedy, look-ahead, open loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import Problem
from loose_agents.belief import (
    AfterRecords,
    BeliefAgent,
    Estimator,
    Policy,
    Situation,
    belief_of,
    tuned,
)
from loose_agents.evaluation import evaluate
from loose_env.diagnosis import (
    AmortisedPosterior,
    Belief,
    FaultPosterior,
    ImaginedFaults,
    InformationFactors,
    RecordInformation,
    SeatFeatures,
)
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import at_levels
from loose_env.typing import Array
from loose_env.wrappers import record_from


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
    fitted = tuned(problem).get("information")
    factors = None
    if fitted is not None:
        factors = InformationFactors(**fitted | {"joints": tuple(fitted["joints"])})
    if isinstance(posterior, AmortisedPosterior):
        return RecordInformation(posterior.features, posterior.frictions, factors=factors)
    if isinstance(posterior, FaultPosterior):
        difficulty = difficulty_named(problem.settings.difficulty)
        features = SeatFeatures(
            problem.linear,
            problem.settings.sensors,
            difficulty.mismatch,
            directions=len(posterior.directions),
            over=difficulty.friction_over,
        )
        return RecordInformation(features, posterior.frictions, factors=factors)
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
class Candidate:
    """A record that could be taken next."""

    action: NDArray[np.int64]
    """The action that takes it."""
    pose: NDArray[np.float64]
    """Joint positions of the record (n,) [rad or m]."""
    torque: NDArray[np.float64]
    """Rms torque of every joint, within the drives' limits (n,) [N·m or N]."""
    duration: float
    """Its length [s]."""
    price: float
    """Cost of the record."""


def poses(
    problem: Problem, situation: Situation, count: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Sample moves uniformly from the allowed ranges, with the resulting poses."""
    allowed = problem.actions.allowed_moves(situation.pose)
    options = [np.flatnonzero(row) for row in allowed]
    total = int(np.prod([len(o) for o in options], dtype=np.int64))
    if total <= count and problem.actions.most_moved == problem.arm.n:
        moves = np.stack(np.meshgrid(*options, indexing="ij"), -1).reshape(-1, len(options))
    else:
        drawn = [situation.rng.choice(o, 2 * count) for o in options]
        moves = np.unique(problem.actions.few_moves(np.stack(drawn, 1), situation.rng), axis=0)
        moves = situation.rng.permutation(moves)[:count]
    steps = problem.actions.steps[np.arange(problem.arm.n), moves]
    where = np.array([problem.arm.wrap(situation.pose + step) for step in steps])
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


def candidate_at(
    problem: Problem,
    moves: NDArray[np.intp],
    pose: NDArray[np.float64],
    levels: NDArray[np.intp],
    duration: int,
) -> Candidate:
    """Build a candidate: the torque of the levels in a pose, and its cost."""
    seconds = problem.settings.durations[duration]
    wanted = np.array([0.0, *problem.arm.levels])[levels]
    excitation, _ = at_levels(problem.linear.at(pose), wanted, duration=seconds)
    prices = problem.settings.prices
    moved = int(np.count_nonzero(moves != problem.settings.stay))
    price = prices.record + prices.second * seconds + prices.level * int(levels.sum())
    return Candidate(
        action=problem.actions.encode(moves=moves, levels=levels, duration=duration),
        pose=pose,
        torque=np.array(excitation.torque_rms),
        duration=seconds,
        price=price + prices.move * moved,
    )


TOGETHER_POSES, SINGLE_POSES = 16, 6
"""Poses weighed with all joints shaken at the top level; with each joint shaken alone."""
SHORTLIST = 1
"""The best of these, weighed with every other excitation too."""
WORTH = 0.5
"""Value of a nat of information, in the environment's reward."""


class GreedyPolicy:
    """Maximises expected information over pose, joints, level and duration."""

    def __init__(self, problem: Problem, information: RecordInformation) -> None:
        self.problem, self.information = problem, information

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Choose the best of the scored records."""
        faults = self.information.imagine(belief_of(situation), situation.rng)
        return ranked(self.problem, self.information, situation, faults)[0].action


def ranked(
    problem: Problem,
    information: RecordInformation,
    situation: Situation,
    faults: ImaginedFaults,
    planned: Array | None = None,
) -> list[Candidate]:
    """Score candidate records and sort them, best first.

    After records with the likelihood ``planned`` where it is given, as
    `loose_env.diagnosis.RecordInformation.of` takes it.
    """

    def value(candidate: Candidate) -> float:
        if not candidate.torque.any():  # gravity leaves the drives nothing
            return -np.inf
        found = information.of(
            faults, candidate.pose, candidate.torque, candidate.duration, planned
        )
        return WORTH * found.information - candidate.price

    first, further = excitations(problem)
    moves, where = poses(problem, situation, TOGETHER_POSES if len(first) == 1 else SINGLE_POSES)
    begun = [(k, how) for k in range(len(moves)) for how in first]
    candidates = [candidate_at(problem, moves[k], where[k], *how) for k, how in begun]
    found = [(value(candidate), candidate) for candidate in candidates]
    order = np.argsort([-v for v, _ in found], kind="stable")
    for k in (begun[i][0] for i in order[:SHORTLIST]):
        for levels, duration in further:
            candidate = candidate_at(problem, moves[k], where[k], levels, duration)
            found.append((value(candidate), candidate))
    found.sort(key=lambda pair: -pair[0])
    return [candidate for _, candidate in found]


FIRST_RECORDS, SECOND_RECORDS = 4, 4
"""First records that the look-ahead weighs, the best by information; poses after each."""
OUTCOMES = 24
"""Outcomes that the look-ahead imagines of each first record."""


class LookAheadPolicy:
    """Maximises the expected reward after a record, or after one more.

    The value of a record is the expected reward of the best name less what the records cost.
    """

    def __init__(self, problem: Problem, information: RecordInformation) -> None:
        self.problem, self.information = problem, information

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Choose the record of the highest value."""
        faults = self.information.imagine(belief_of(situation), situation.rng)
        firsts = ranked(self.problem, self.information, situation, faults)[:FIRST_RECORDS]
        values = [self._value(candidate, faults, situation) for candidate in firsts]
        return firsts[int(np.argmax(values))].action

    def _value(self, candidate: Candidate, faults: ImaginedFaults, situation: Situation) -> float:
        """Expected reward after taking this record."""
        if not candidate.torque.any():
            return -np.inf
        prices, every = self.problem.settings.prices, excitations(self.problem)[0]
        stake = prices.correct - prices.wrong
        after = replace(situation, pose=candidate.pose)
        moves, where = poses(self.problem, after, SECOND_RECORDS)
        seconds = [
            candidate_at(self.problem, move, pose, *how)
            for move, pose in zip(moves, where, strict=True)
            for how in every
        ]
        seconds = [second for second in seconds if second.torque.any()]
        likely, *more = [
            self.information.likelihood(faults, c.pose, c.torque, c.duration)
            for c in (candidate, *seconds)
        ]
        ticks = (np.arange(OUTCOMES) + 0.5) / OUTCOMES
        drawn = np.searchsorted(np.cumsum(faults.weight), ticks * faults.weight.sum())
        total = 0.0
        for k in np.minimum(drawn, len(faults.weight) - 1):
            weight = faults.weight * likely[k]
            weight = weight / weight.sum()
            worth = float(_sureness(weight[None], faults)[0])  # of a verdict now
            for second, of_second in zip(seconds, more, strict=True):
                both = weight[None] * of_second
                both /= both.sum(1, keepdims=True)
                then = float(weight @ _sureness(both, faults))
                worth = max(worth, then - second.price / stake)
            total += worth / len(drawn)
        return prices.wrong + stake * total - candidate.price


def _sureness(weights: Array, faults: ImaginedFaults) -> Array:
    """Maximum posterior probability (K,) for weights (K, M)."""
    labels = np.eye(int(faults.hypothesis.max()) + 1)[faults.hypothesis]
    return np.asarray((weights @ labels).max(1))


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


class OpenLoopPolicy:
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

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Choose the best of the scored records, given which ones were taken."""
        faults = self.information.imagine(self._prior, situation.rng)
        planned = np.ones((len(faults.weight), len(faults.weight)))
        for slot in range(situation.records):
            record = record_from(self.problem.layout, situation.observation, slot)
            if record is not None:
                planned *= self.information.likelihood(
                    faults, record.pose, record.torque, record.duration
                )
        return ranked(self.problem, self.information, situation, faults, planned)[0].action


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
    return [tuple(tuple(problem.actions.from_code(c).tolist()) for c in own) for own in taken]
