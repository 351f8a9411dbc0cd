"""Prior and batched simulator of records: for experiment design and simulation-based inference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from loose_env.envs import Beginning, EnvBatch
from loose_env.errors import InvalidSetting
from loose_env.faults import Fault
from loose_env.io import is_whole
from loose_env.typing import Array

NAMES = (
    *("hypothesis", "gap", "friction", "contact_mode_low", "contact_mode_high"),
    *("contact_damping_low", "contact_damping_high", "direction_turn", "direction_height"),
)
"""Parameters of a fault, in the order of theta."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultPrior:
    """Prior of a hidden fault's parameters: those of an environment's difficulty.

    ``theta`` (B, 9) has the index of the hypothesis; the travel at the tool [m] and the friction
    over the seat drive of the top level [1], log-uniform; modes [Hz] and damping ratios [1] of the
    lower and the upper stop, uniform; and two numbers from 0 to 1 that give a slide's direction.
    A healthy arm, play and an arm in the plane do not depend on all of them.
    """

    hypotheses: tuple[str, ...]
    """Names of the hypotheses."""
    probabilities: Array
    """Their prior probabilities (hypotheses,)."""
    low: Array
    """Least value of each other parameter (8,)."""
    high: Array
    """Largest value of each (8,)."""
    names: tuple[str, ...] = NAMES
    """Names of the parameters."""

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """Draw parameters (count, 9)."""
        _check_generator(rng)
        if not is_whole(count) or count < 0:
            raise InvalidSetting(f"count is a whole number, zero or more; got {count!r:.60}")
        drawn = np.empty((count, len(NAMES)))
        drawn[:, 0] = rng.choice(len(self.hypotheses), size=count, p=self.probabilities)
        low, high = self.low.copy(), self.high.copy()
        low[:_LOG], high[:_LOG] = np.log(low[:_LOG]), np.log(high[:_LOG])
        drawn[:, 1:] = low + (high - low) * rng.random((count, len(low)))
        drawn[:, 1 : 1 + _LOG] = np.exp(drawn[:, 1 : 1 + _LOG])
        return drawn

    def log_prob(self, theta: Array) -> Array:
        """Logarithm of the prior density (B,): of the hypothesis a probability."""
        rest = theta[:, 1:]
        with np.errstate(divide="ignore"):
            found = np.log(self.probabilities)[theta[:, 0].astype(int)]
        width = self.high - self.low
        width[:_LOG] = np.log(self.high[:_LOG] / self.low[:_LOG])
        found = found - np.log(width[width > 0]).sum() - np.log(rest[:, :_LOG]).sum(axis=1)
        inside = ((rest >= self.low) & (rest <= self.high)).all(axis=1)
        return np.where(inside, found, -np.inf)


_LOG = 2
"""Log-uniform parameters, the first ones after the hypothesis."""


Simulate = Callable[[Array, Array, np.random.Generator], Array]
"""Simulator of records, as `simulator` makes it."""


def simulator(
    env_id: str, *, num_envs: int = 64, engine: str = "reduced", **arguments: Any
) -> tuple[FaultPrior, Simulate]:
    """Prior of a hidden fault and simulator of the records that an environment would show.

    Parameters
    ----------
    env_id : str
        An environment, such as ``"loose_env/Planar-v0"``; not ``loose_env/Gap-v0``.
    num_envs : int
        Arms simulated at once.
    engine : {"reduced", "mujoco"}
        Engine; "mujoco" where the extra ``fast`` is not installed.
    **arguments
        As for `gymnasium.make`.

    Returns
    -------
    FaultPrior
        Prior of theta.
    callable
        ``simulate(theta, design, rng)``: theta (B, 9), design (B, 2 n + 1) or, for T records of the
        same arm one after the other, (B, T, 2 n + 1): the pose [rad, m], the level of each joint,
        and the index of the record's length. The true arms' deviations from the nominal one and
        all noise come from ``rng``. Returns the elements of each record (B, S) or (B, T, S), as
        they stand in the observation (`loose_env.envs.ObservationLayout`); NaN where a
        simulation diverged, zero where gravity leaves the drives no torque.

    Raises
    ------
    InvalidSetting
        If the environment hides no faults, or there are too many records.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> prior, simulate = simulator("loose_env/Planar-v0", n_links=2)
    >>> theta = prior.sample(rng, 8)
    >>> design = np.tile([0.3, 0.8, 0, 3, 0], (8, 1))  # a pose; joint 2 at level 3, 0.2 s
    >>> simulate(theta, design, rng).shape
    (8, 58)
    """
    if not str(gymnasium.spec(str(env_id)).vector_entry_point).startswith("loose_env."):
        raise InvalidSetting(
            f"{env_id!r} hides no fault of an arm: give an arm's id, such as 'loose_env/Planar-v0'"
        )
    made: Any = gymnasium.make_vec(env_id, num_envs=num_envs, engine=engine, **arguments)
    batch: EnvBatch = made.unwrapped.batch
    hypotheses, difficulty = batch.hypotheses, batch.difficulty
    kinds = [name.partition("@")[0] for name in hypotheses]
    shares = [batch.sampler.probabilities[kind] / kinds.count(kind) for kind in kinds]
    ranges = [difficulty.gap, difficulty.friction]
    ranges += [difficulty.contact_mode] * 2 + [difficulty.contact_damping] * 2 + [(0.0, 1.0)] * 2
    low, high = np.array(ranges).T
    prior = FaultPrior(
        hypotheses=hypotheses, probabilities=np.array(shares) / sum(shares), low=low, high=high
    )

    def simulate(theta: Array, design: Array, rng: np.random.Generator) -> Array:
        """Records of arms with given faults, in given poses and excitations."""
        parameters, designs = np.asarray(theta, dtype=float), np.asarray(design, dtype=float)
        one = designs.ndim == 2
        designs = designs[:, None] if one else designs
        _check_generator(rng)
        _check(batch, prior, parameters, designs)
        faults = batch.sampler.faults(
            [hypotheses[int(k)] for k in parameters[:, 0]],
            gap=parameters[:, 1],
            ratio=parameters[:, 2],
            modes=parameters[:, 3:5],
            damping=parameters[:, 5:7],
            direction=parameters[:, 7:],
        )
        found = np.empty((*designs.shape[:2], len(batch.observations.slot_elements)))
        for first in range(0, len(faults), num_envs):
            own = slice(first, first + num_envs)
            found[own] = _records(batch, faults[own], designs[own], rng)
        return found[:, 0] if one else found

    return prior, simulate


def _check_generator(rng: Any) -> None:
    if not isinstance(rng, np.random.Generator):
        raise InvalidSetting(f"rng is numpy's default_rng(seed), a Generator; got {rng!r:.60}")


def _check(batch: EnvBatch, prior: FaultPrior, theta: Array, designs: Array) -> None:
    n, most = batch.arm.n, batch.settings.max_records
    if theta.ndim != 2 or theta.shape[1] != len(NAMES) or not np.isfinite(theta).all():
        raise InvalidSetting(
            f"theta is (B, {len(NAMES)}) finite numbers {list(NAMES)}, got shape {theta.shape}"
        )
    if (theta[:, 1:7] < 0).any():
        raise InvalidSetting(
            f"{', '.join(NAMES[1:7])} are zero or more, got {theta[:, 1:7].min():g}"
        )
    if designs.ndim != 3 or designs.shape[::2] != (len(theta), 2 * n + 1):
        raise InvalidSetting(
            f"a design is ({len(theta)}, {2 * n + 1}) numbers, or ({len(theta)}, T, {2 * n + 1}): "
            f"pose, levels, index of the length; got shape {designs.shape}"
        )
    if designs.shape[1] > most:
        raise InvalidSetting(
            f"an arm takes {most} records at most, got {designs.shape[1]}: give max_records"
        )
    if not np.isin(theta[:, 0], np.arange(len(prior.hypotheses))).all():
        raise InvalidSetting(
            f"hypotheses of theta are whole numbers from 0 to {len(prior.hypotheses) - 1}, got "
            f"{theta[:, 0].tolist()!r:.80}"
        )


def _records(
    batch: EnvBatch, faults: list[Fault], designs: Array, rng: np.random.Generator
) -> Array:
    """Take records of some arms, one after the other (B, T, S)."""
    count, records, n = *designs.shape[:2], batch.arm.n
    slots = np.arange(count)
    batch.start_all(
        slots.tolist(),
        seeds=[int(rng.integers(1 << 63)) for _ in range(count)],
        numbers=[0] * count,
        beginnings=[Beginning(fault=fault) for fault in faults],
    )
    failed = np.zeros(count, dtype=bool)
    for t in range(records):
        going = slots[~failed]
        batch.place(going, designs[going, t, :n])
        actions = [
            batch.actions.encode(levels=row[n : 2 * n], duration=row[2 * n])
            for row in designs[going, t]
        ]
        failed[going] = batch.step(going, np.array(actions)).truncated
    found = np.array([batch.episode(int(slot)).slots[:records] for slot in slots], dtype=float)
    found[failed] = np.nan
    return found
