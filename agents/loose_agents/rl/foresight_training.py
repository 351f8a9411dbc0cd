"""Training of the learned choice of records: play simulated arms, fit, play the better records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from loose_agents.base import Problem
from loose_agents.belief import BeliefAgent, Tracker
from loose_agents.jobs import Store, spans
from loose_agents.policies.choice import FORESEEN_POSES, BatchPolicy, ForesightPolicy, poses
from loose_agents.rl.foresight import (
    Foresight,
    Numbers,
    Standardised,
    entropy_of,
)
from loose_env.arms import ArmGeometry
from loose_env.io import Count, NonNegative, Positive, Probability
from loose_env.typing import Array, IndexArray


@dataclass(frozen=True, kw_only=True)
class ForesightTraining:
    """Settings of the training."""

    records: Count = 600_000
    """Records in all."""
    rounds: Count = 6
    """Parts of them; each but the first is played by networks fitted to those before it."""
    episode: Count = 6
    """Records of an arm."""
    random: Probability = 0.5
    """Share of the records at random [1]: what is never tried is never known."""
    steps: Count = 6000
    """Steps of the last fit, of `batch` records; earlier ones take their share."""
    batch: Count = 512
    """Records of a step."""
    rate: Positive = 1e-3
    """Rate of learning, falling to none."""
    decay: NonNegative = 0.05
    """Decay of weights."""
    seed: int = 0
    """Seed of arms, choices and steps."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Taken:
    """M records on simulated arms: what was known before and after each."""

    before: Array
    """The posterior's probabilities (M, H)."""
    shown: Numbers
    """What `Tracker.seen` tells besides (M, features)."""
    pose: Array
    """Pose of the record [rad] (M, n)."""
    joint: IndexArray
    """The joint that was excited (M,)."""
    after: Array
    """Probabilities after it (M, H)."""
    shown_after: Numbers
    """The same after it (M, features)."""
    truth: IndexArray
    """The hypothesis that was true (M,)."""

    @classmethod
    def joined(cls, parts: Sequence[Taken]) -> Taken:
        """Parts, one after the other."""
        return cls(
            **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)}
        )


Show = Callable[[int], None]


def train(
    problem: Problem, envs: Any, settings: ForesightTraining, store: Store, show: Show
) -> tuple[Foresight, list[str]]:
    """Play and fit in rounds; what the store holds is not played again."""
    parts: list[Taken] = []
    foresight = None
    for part, span in enumerate(spans(settings.records, -(-settings.records // settings.rounds))):
        if store.missing([span]):
            if parts:
                foresight, _ = fit(problem, Taken.joined(parts), settings)
            store.write(span, vars(play(problem, envs, foresight, settings, part, span, show)))
        parts.append(Taken(**store.read(span)))
    return fit(problem, Taken.joined(parts), settings)


def play(
    problem: Problem,
    envs: Any,
    foresight: Foresight | None,
    settings: ForesightTraining,
    part: int,
    span: range,
    show: Show,
) -> Taken:
    """Take a round's records, by networks where there are some and the rest at random."""
    rng = np.random.default_rng([settings.seed, part])
    tracker = Tracker(problem)
    wandering = _Wandering(problem)
    policy: Any = wandering
    if foresight is not None:
        policy = ForesightPolicy(problem, tracker, foresight)
    agent, count, found = BeliefAgent(problem, tracker, None, None), envs.num_envs, []
    for done in range(span.start, span.stop, count * settings.episode):
        observations, _ = envs.reset(seed=int(rng.integers(2**62)))
        memories = [agent.begin(rng) for _ in range(count)]
        faults = [envs.batch.episode(k).fault.hypothesis for k in range(count)]
        truth = np.array([problem.hypotheses.index(fault) for fault in faults])
        now, going = agent.situations(observations, memories), np.ones(count, dtype=bool)
        told = tracker.seen([memory.estimate for memory in memories])
        for _ in range(settings.episode):
            lost = rng.random(count) < settings.random
            actions = np.where(
                lost[:, None], wandering.choose_all(now), np.stack(policy.choose_all(now))
            )
            joint = problem.actions.decode_all(actions).levels.argmax(axis=1)
            observations, _, over, cut, _ = envs.step(actions)
            going &= ~(over | cut)  # the simulation of an arm may fail: it is left from there on
            now = agent.situations(observations, memories)
            after = tracker.seen([memory.estimate for memory in memories])
            row = (*told, problem.layout.pose_of(observations), joint, *after, truth)
            found.append([each[going] for each in row])
            told = after
        show(min(done + count * settings.episode, span.stop))
    columns = map(np.concatenate, zip(*found, strict=True))
    return Taken(**dict(zip((f.name for f in fields(Taken)), columns, strict=True)))


class _Wandering(BatchPolicy):
    """Any of the records that `ForesightPolicy` weighs."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def choose_all(self, situations: Sequence[Any]) -> list[Any]:
        chosen, n, top = [], self.problem.arm.n, len(self.problem.arm.levels)
        for situation in situations:
            moves, _ = poses(self.problem, situation, FORESEEN_POSES)
            levels = top * np.eye(n, dtype=np.intp)[situation.rng.integers(n)]
            own = moves[situation.rng.integers(len(moves))]
            chosen.append(self.problem.actions.encode(moves=own, levels=levels))
        return chosen


HELD_OUT = 0.05
"""Share of the records that is only judged on: the last ones, whole arms."""


def fit(problem: Problem, taken: Taken, settings: ForesightTraining) -> tuple[Foresight, list[str]]:
    """Fit both networks; return them with what they are worth on records held out."""
    torch.manual_seed(settings.seed)
    rng, foresight = np.random.default_rng(settings.seed), Foresight(problem)
    total, views = len(taken.truth), foresight.views
    learned, steps = int((1 - HELD_OUT) * total), settings.steps * total // settings.records
    at = problem.linear.geometry(taken.pose)

    def posterior(rows: IndexArray) -> Tensor:
        return torch.from_numpy(
            views.of_poses(taken.after[rows], taken.shown_after[rows], _some(at, rows))[0]
        )

    def records(rows: IndexArray) -> Tensor:
        there, which = _some(at, rows), np.arange(len(rows))
        pose, turned = views.of_poses(taken.before[rows], taken.shown[rows], there)
        record = views.of_records(turned, there, which, taken.joint[rows])
        return torch.from_numpy(np.concatenate([pose, record], axis=1))

    truth, logs = (
        torch.from_numpy(taken.truth),
        torch.from_numpy(np.log(np.maximum(taken.after, 1e-6)).astype(np.float32)),
    )

    def surprise(answer: Tensor, rows: IndexArray) -> Tensor:
        return nn.functional.cross_entropy(logs[rows] + answer, truth[rows])

    _descend(foresight.correction, posterior, surprise, learned, steps, settings, rng)
    corrected = np.concatenate(
        [
            foresight.corrected(taken.after[r], taken.shown_after[r], _some(at, r))
            for r in np.array_split(np.arange(total), -(-total // 65536))
        ]
    )
    left = torch.from_numpy(entropy_of(corrected).astype(np.float32))

    def misses(answer: Tensor, rows: IndexArray) -> Tensor:
        return (answer[:, 0] - left[rows]).square().mean()

    _descend(foresight.after, records, misses, learned, steps, settings, rng)
    held = np.arange(learned, total)
    return foresight, _judged(foresight, taken, corrected, left, records(held), held)


def _judged(
    foresight: Foresight,
    taken: Taken,
    corrected: Array,
    left: Tensor,
    seen: Tensor,
    held: IndexArray,
) -> list[str]:
    """What the networks are worth on records held out."""
    truth, lines = taken.truth[held], []
    for name, p in (("posterior", taken.after[held]), ("calibrated", corrected[held])):
        score = np.log(np.maximum(p[np.arange(len(held)), truth], 1e-6)).mean()
        right = (p.argmax(axis=1) == truth).mean()
        lines.append(f"{name:12} log score {score:+.3f} nat, right {100 * right:.1f} %")
    with torch.inference_mode():
        error = (foresight.after(seen)[:, 0] - left[held]).square().mean()
    explained = 1 - float(error / left[held].var())
    return [*lines, f"of the entropy after a record {100 * explained:.1f} % is foretold"]


def _some(at: ArmGeometry, rows: IndexArray) -> ArmGeometry:
    return ArmGeometry(**{name: values[rows] for name, values in vars(at).items()})


def _descend(
    network: Standardised,
    seen: Callable[[IndexArray], Tensor],
    loss: Callable[[Tensor, IndexArray], Tensor],
    learned: int,
    steps: int,
    settings: ForesightTraining,
    rng: np.random.Generator,
) -> None:
    """Standardise what a network sees, and descend on a loss."""
    sample = seen(rng.integers(learned, size=min(learned, 20_000)))
    spread = sample.std(0)
    network.mean.copy_(sample.mean(0))
    network.gain.copy_(torch.where(spread > 1e-4, 1 / spread, 0.0))  # what never changes goes
    for own in network.layers[-1].parameters():
        nn.init.zeros_(own)
    optimiser = torch.optim.AdamW(network.parameters(), settings.rate, weight_decay=settings.decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(steps, 1))
    network.train()
    for _ in range(steps):
        rows = rng.integers(learned, size=settings.batch)
        optimiser.zero_grad()
        loss(network(seen(rows)), rows).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    network.eval()
