"""Gymnasium environment `ModelGapEnv`: motions that tell missing effects apart; its settings."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache, partial
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
from annotated_types import Predicate
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from loose_env.arms import SERVO_ARM, model_path
from loose_env.envs.batch import mapping_of
from loose_env.envs.settings import refuse_unknown
from loose_env.errors import InvalidAction, InvalidSetting, UnknownName
from loose_env.gap import (
    VISIBLE,
    Belief,
    Effect,
    Hypothesis,
    HypothesisSet,
    Library,
    MotionBank,
    Outlook,
    Shape,
    motion_bank,
    motion_library,
    outlook,
    read_servo_arm,
)
from loose_env.io import Checked, Count, NonNegative, Positive, Probability, Rule, is_whole
from loose_env.typing import Array

_JITTER, _LIMIT = 0.2, 1.5
"""Standard deviation of the logarithm of parameters beside the size, and the largest deviation; the
damping of a spring is that of the catalogue's start."""
_STRONGEST = 400.0
"""Largest signature that is drawn where nominal parameters explain most of it [noise sd]."""
_LARGEST = 0.7  # largest size that is drawn, over that of the largest visibility


@dataclass(frozen=True, eq=False)
class HiddenEffect:
    """An effect of the machine, with its values."""

    effect: Effect
    values: Array

    @property
    def name(self) -> str:
        """Kind and location."""
        return f"{self.effect.kind}@{self.effect.where}"

    @cached_property
    def none(self) -> Array:
        """Values that are no effect; of an effect that has none, of no size."""
        null = self.effect.null_values
        return np.zeros(len(self.values)) if null is None else np.array(null)

    @cached_property
    def main(self) -> int:
        """Index of the parameter by which its size is stated."""
        scale = np.array([parameter.scale for parameter in self.effect.parameters])
        if self.effect.proportional is not None or self.effect.null_values is None:
            return self.effect.proportional or 0
        return int(np.argmax(np.abs(self.values - self.none) / scale))

    @property
    def value(self) -> float:
        """Parameter by which its size is stated."""
        return float(self.values[self.main])


@dataclass(frozen=True, eq=False)
class HiddenMachine:
    """A machine: hidden effects, and nominal parameters that are off."""

    bank: MotionBank
    effects: tuple[HiddenEffect, ...]
    factors: Array
    """Factors on the nominal parameters."""

    @property
    def names(self) -> tuple[str, ...]:
        """Hidden effects, sorted."""
        return tuple(sorted(effect.name for effect in self.effects))

    def run(self, motion: int, rng: np.random.Generator) -> Array:
        """Measure a motion of the library: readings with noise (n, C); NaN if it diverged."""
        arm = self.bank.arm
        commands = self.bank.library[motion].commands(arm.limits)
        hidden = Hypothesis().with_effects([(each.effect, each.values) for each in self.effects])
        return arm.measured(arm.simulate(hidden, commands, self.factors), rng)


Shares = Annotated[
    tuple[NonNegative, NonNegative, NonNegative],
    Rule("shares that sum to 1", (Predicate(lambda shares: abs(sum(shares) - 1) < 1e-9),)),
]


@dataclass(frozen=True, kw_only=True)
class MachineDraw(Checked):
    """Distribution of hidden machines.

    Sizes are uniform in the logarithm from that seen at `least_visible` up to a share of that of
    the largest visibility, or of the parameter's bound. Locations and kinds are uniform.
    """

    probabilities: Shares = (0.2, 0.5, 0.3)
    """Probabilities of none, one and two effects."""
    least_visible: Positive = 15.0
    """Least visibility on the fixed battery [noise standard deviations]."""

    def draw(
        self, bank: MotionBank, rng: np.random.Generator, *, count: int | None = None,
        names: tuple[str, ...] = (),
    ) -> HiddenMachine:  # fmt: skip
        """Draw a machine, with a number of effects or with given ones where asked.

        Raises
        ------
        InvalidSetting
            If a name is no candidate of the bank.
        """
        unknown = [name for name in names if name not in bank.names]
        if unknown:
            raise InvalidSetting(f"no candidate {unknown[0]!r}; candidates are {list(bank.names)}")
        if count is None:
            count = int(rng.choice(3, p=self.probabilities))
        count = min(count, len(bank.names))
        chosen = names or tuple(
            bank.names[k] for k in rng.choice(len(bank.names), count, replace=False)
        )
        tolerance = bank.arm.tolerance
        factors = 1 + rng.uniform(-tolerance, tolerance, len(bank.arm.uncertain))
        return HiddenMachine(bank, tuple(self._effect(bank, n, rng) for n in chosen), factors)

    def _effect(self, bank: MotionBank, name: str, rng: np.random.Generator) -> HiddenEffect:
        own = [shape for shape in bank.shapes if shape.name == name]
        own = [s for s in own if s.term.contact == own[0].term.contact]
        effect = own[0].term.effect
        if own[0].term.law:
            return HiddenEffect(effect, self._law(bank, own, rng))
        shape = own[int(rng.integers(len(own)))]
        at = [
            (axis, sign)
            for axis, column in enumerate(shape.term.columns)
            for sign, bound in ((1.0, column.high), (-1.0, -column.low))
            if bound > self.least_visible * bank.unit(shape, axis)
        ]
        at = at or [(0, 1.0)]
        axis, sign = at[int(rng.integers(len(at)))]
        column, unit = shape.term.columns[axis], bank.unit(shape, axis)
        most = _LARGEST * min(VISIBLE[1] * unit, column.high if sign > 0 else -column.low)
        most = min(most, _STRONGEST / bank.strength(shape, axis))
        least = min(self.least_visible * unit, 0.9 * most)
        values = np.zeros(len(shape.at))
        values[axis] = sign * np.exp(rng.uniform(np.log(least), np.log(most)))
        found = shape.term.values(values)
        return HiddenEffect(effect, self._beside_size(effect, found, effect.proportional or 0, rng))

    def _law(self, bank: MotionBank, own: Sequence[Shape], rng: np.random.Generator) -> Array:
        """Values of a law: between two neighbouring shapes, by visibility."""
        variants = list(dict.fromkeys(shape.term.effect for shape in own))
        chosen = variants[int(rng.integers(len(variants)))]
        own = [shape for shape in own if shape.term.effect is chosen]
        seen = np.array([bank.visibility(shape, shape.centre) for shape in own])
        # from the weakest on: what is large looks like other effects
        order = np.argsort([bank.strength(shape) for shape in own])
        most = int(np.argmax([*(seen[order] > _LARGEST * VISIBLE[1]), True]))
        good = [k for k in order[:most] if seen[k] >= self.least_visible] or [order[0]]
        near = np.log(np.abs([own[k].term.axes[0][0] for k in good]))
        values = np.array(own[0].term.axes[0])
        values[0] = np.sign(values[0]) * np.exp(rng.uniform(near.min(), near.max()))
        return self._beside_size(chosen, values, 0, rng)

    def _beside_size(
        self, effect: Effect, values: Array, size: int, rng: np.random.Generator
    ) -> Array:
        """Values with other shapes: logarithmic parameters beside the size."""
        found = values.copy()
        for k, parameter in enumerate(effect.parameters):
            if k != size and parameter.log and not effect.adds_motion:
                z = np.clip(rng.normal(), -_LIMIT, _LIMIT)
                found[k] = parameter.clipped(float(values[k] * np.exp(_JITTER * z)))
        return found


@dataclass(frozen=True, kw_only=True)
class GapPrices(Checked):
    """Rewards of verdicts and prices of machine time.

    Examples
    --------
    >>> GapPrices().verdict(("payload@tool",), ("payload@tool",), parameter_error=0.1)
    0.98
    >>> GapPrices().verdict(("payload@tool",), ("base_tilt@base",), parameter_error=1.0)
    -1.0
    """

    correct: float = 1.0
    """Reward for naming every missing effect at its location and nothing else."""
    partly: float = 0.0
    """Reward for naming one of two and nothing false."""
    wrong: float = -1.0
    """Reward for anything else."""
    parameter: NonNegative = 0.2
    """Price of the mean relative error of the parameters, at most 1, of a correct verdict."""
    second: NonNegative = 0.01
    """Price of one second of machine time."""
    wear: NonNegative = 0.1
    """Price of one second at the torque limit of one joint: wear is the integral of the squared
    shares of the torque limits."""

    def verdict(
        self, named: tuple[str, ...], truth: tuple[str, ...], *, parameter_error: float
    ) -> float:
        """Reward of a verdict."""
        right = bool(truth) and set(named) == set(truth)
        return self.named(named, truth) - right * self.parameter * min(parameter_error, 1.0)

    def named(self, named: tuple[str, ...], truth: tuple[str, ...]) -> float:
        """Reward of the names alone."""
        if set(named) == set(truth):
            return self.correct
        if named and set(named) < set(truth):
            return self.partly
        return self.wrong


@dataclass(frozen=True, kw_only=True)
class ModelGapSettings(Checked):
    """Everything about the environment but the arm.

    Examples
    --------
    >>> ModelGapSettings(max_motions=6).max_motions
    6
    """

    draw: MachineDraw = field(default_factory=MachineDraw)
    """Distribution of the hidden machines."""
    prices: GapPrices = field(default_factory=GapPrices)
    """Rewards and prices."""
    kinds: Annotated[tuple[str, ...], Rule("kinds of the catalogue, none for all")] = ()
    """Kinds of effect that are hidden and considered; none for the whole catalogue but those that
    the sensors cannot show."""
    library: Library = "battery"
    """Motions: the fixed battery of three; that and twelve brief ones; the whole library of 40."""
    max_motions: Count = 12
    """Motions an episode may take; after the last one only a verdict is left."""
    ranks: Count = 5
    """Sets of effects that a verdict can name: the most probable ones."""
    tolerance: Probability = 0.03
    """Relative error within which masses, inertias, dampings and gains are known [1]."""
    max_speed: Positive = 2.0
    """Largest joint speed of motions [rad/s]; of slides a fifth of it [m/s]."""


_FLOOR = 1e-6  # probabilities below count as this in logarithms
_MOST = 20.0  # bound of every element


class GapObservation:
    """Layout of the observation; each slice is an attribute, in the table of `ModelGapEnv`.

    Of N candidate effects, M motions of the library and R sets that a verdict can name.

    Examples
    --------
    >>> layout = GapObservation(candidates=3, motions=2, ranks=5)
    >>> layout.size, layout.information
    (34, slice(26, 28, None))
    """

    def __init__(self, *, candidates: int, motions: int, ranks: int) -> None:
        self.candidates, self.motions, self.ranks = n, m, r = candidates, motions, ranks
        ends = accumulate((n, n, n, n, r, r, m, m, m, m, 4), initial=0)
        groups = iter([slice(*own) for own in pairwise(ends)])
        self.probability, self.evidence = next(groups), next(groups)
        self.parameter, self.interval = next(groups), next(groups)
        self.sets, self.members = next(groups), next(groups)
        self.taken, self.rest = next(groups), next(groups)
        self.information, self.gain = next(groups), next(groups)
        self.spent = next(groups)

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(self.spent.stop)

    @property
    def space(self) -> spaces.Box:
        """The space."""
        return spaces.Box(-_MOST, _MOST, (self.size,), np.float32)

    def of(
        self, belief: Belief, ahead: Outlook, spent: tuple[float, float, float]
    ) -> NDArray[np.float32]:
        """Observation of a belief, the outlook of the motions, and what was spent."""
        found = np.zeros(self.size)
        posterior = belief.posterior
        found[self.probability] = np.log10(np.maximum(posterior.marginal, _FLOOR))
        evidence = posterior.log_evidence
        found[self.evidence] = np.sign(evidence) * np.log1p(np.abs(evidence))
        found[self.parameter], found[self.interval] = posterior.size, posterior.size_sd
        shares = np.full(self.ranks, _FLOOR)
        members = np.zeros(self.ranks)
        for k, each in enumerate(posterior.sets[: self.ranks]):
            shares[k], members[k] = max(each.probability, _FLOOR), len(each.names)
        found[self.sets], found[self.members] = np.log10(shares), members
        for motion, count in belief.counts.items():
            found[self.taken.start + motion] = count
            found[self.rest.start + motion] = belief.rest[motion] - 1.0
        found[self.information], found[self.gain] = ahead.information, ahead.gain
        found[self.spent] = (*spent, np.log10(posterior.misfit))
        return np.clip(found, -_MOST, _MOST).astype(np.float32)


class ModelGapEnv(gymnasium.Env[NDArray[np.float32], np.int64]):
    """Find the physical effects that a robot's model lacks, in little machine time.

    ## Description
    A machine differs from its nominal model by none, one or two effects of the catalogue of
    `loose gap` (friction, compliance, play, delays, wrong inertias, sensor errors), at a random
    location and with a random size, and by nominal parameters within a tolerance. The agent
    chooses motions; each is simulated with the hidden effects in MuJoCo, measured by encoders and
    torque sensors with noise, and updates a belief: a posterior over all sets of at most two
    effects, from the columns of `loose gap` along the nominal motion. It names a set when sure.

    ## Action Space
    `Discrete(M + R)`: a motion of the library, `motions[k]`, or M + r: name the set of rank r in
    the posterior, 0 the most probable. `action_masks()` and `info["action_mask"]` say what makes
    sense: no verdict before the first motion, no motion after the last one.

    ## Observation Space
    A flat float32 `Box`; `layout` has a slice for each row.

    | elements | name | meaning |
    |---|---|---|
    | N | `probability` | log10 of the probability that each candidate is missing |
    | N | `evidence` | log evidence x of each alone against none, as sign(x) ln(1 + abs(x)) |
    | N | `parameter` | log10 of its size, as visibility on the fixed battery |
    | N | `interval` | standard deviation of that |
    | R | `sets` | log10 of the probabilities of the R most probable sets |
    | R | `members` | effects in each of them |
    | M | `taken` | repetitions of each motion |
    | M | `rest` | rms of the residual that no candidate spans, less 1 [noise sd] |
    | M | `information` | expected information of each motion about the set [nats] |
    | M | `gain` | expected gain of each motion in the reward of the best verdict |
    | 4 | `spent` | machine time [min], wear [s], motions over the most, log10 of the misfit |

    ## Rewards
    +1 for every missing effect at its location and nothing else, less 0.2 times the mean relative
    error of the parameters; 0 for one of two and nothing false; -1 for anything else and for going
    on after the last motion. Each second of machine time costs 0.01, and wear, the integral of the
    squared shares of the torque limits, 0.1 a second.

    ## Starting State
    A machine drawn by `settings.draw`: no, one or two effects with probabilities 0.2, 0.5 and 0.3;
    sizes uniform in the logarithm, from a visibility of 15 noise standard deviations on the fixed
    battery; nominal parameters uniform within the tolerance. Nothing is measured.

    ## Episode End
    A verdict terminates, and so does going on after the last motion; one that names no set of the
    belief, as before the first motion, is wrong. A simulation that diverges
    truncates.

    ## Arguments
    `model`, the path of an MJCF file with position servos (by default a waist, shoulder and
    elbow), and all fields of `ModelGapSettings`. The columns of the arm are made once, within
    minutes, and stored in the user's cache folder. Options of `reset`: ``{"names": [...]}``
    hides given effects, ``{"count": n}`` a number of random ones.

    ## Version History
    v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, bank: MotionBank, settings: ModelGapSettings | None = None) -> None:
        self.bank, self.settings = bank, settings or ModelGapSettings()
        self.motions = bank.library
        self.layout = GapObservation(
            candidates=len(bank.names), motions=len(bank.library), ranks=self.settings.ranks
        )
        self.observation_space: Any = self.layout.space
        self.action_space = spaces.Discrete(len(bank.library) + self.settings.ranks)
        self.machine: HiddenMachine | None = None
        """The hidden machine of the episode."""
        self.belief = Belief(self.bank)
        """Belief about it."""
        self.seconds, self.wear = 0.0, 0.0
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Draw a machine.

        Raises
        ------
        UnknownName
            If there is no such option.
        InvalidSetting
            If a name is no candidate, or a value no list or number.
        """
        super().reset(seed=seed)
        given = mapping_of(options)
        refuse_unknown("reset options", given, ("names", "count"))
        names, count = given.get("names", ()), given.get("count")
        if isinstance(names, str) or not isinstance(names, Sequence):
            raise InvalidSetting(f"names are a list of candidates, got {names!r:.60}")
        if count is not None and not (is_whole(count) and count >= 0):
            raise InvalidSetting(f"count is a whole number, zero or more; got {count!r:.60}")
        self.machine = self.settings.draw.draw(
            self.bank, self.np_random, count=count, names=tuple(names)
        )
        self.belief = Belief(self.bank)
        self.seconds, self.wear, self._over = 0.0, 0.0, False
        return self._observed(), self._info()

    def step(
        self, action: np.int64 | int
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Run a motion, or name a set.

        Raises
        ------
        InvalidAction
            If the action lies outside the space.
        ResetNeeded
            If the episode is over.
        """
        if self.machine is None or self._over:
            raise ResetNeeded("the episode is over: call reset() first")
        if not self.action_space.contains(action):
            raise InvalidAction(
                f"an action is 0 to {len(self.motions) + self.settings.ranks - 1}, got {action!r}"
            )
        action, prices = int(action), self.settings.prices
        if action >= len(self.motions):
            return self._verdict(action - len(self.motions))
        if self.taken >= self.settings.max_motions:
            return self._ended(prices.wrong)
        readings = self.machine.run(action, self.np_random)
        self.seconds += float(self.bank.seconds[action])
        self.wear += float(self.bank.wear[action])
        reward = -float(self.motion_prices[action])
        if not np.isfinite(readings).all():
            failure = "the simulation of the machine diverged"
            return self._ended(reward, truncated=True, failure=failure)
        self.belief.add(action, readings)
        return self._observed(), reward, False, False, self._info()

    def _verdict(self, rank: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        assert self.machine is not None
        truth, prices = self.machine.names, self.settings.prices
        if not self.action_masks()[len(self.motions) + rank]:  # it names nothing
            return self._ended(prices.wrong, truth=truth, is_success=False)
        named = self.belief.posterior.sets[rank]
        error = self.parameter_error(named)
        return self._ended(
            prices.verdict(named.names, truth, parameter_error=error),
            verdict=named.names, truth=truth, is_success=named.names == truth,
            parameter_error=error, probability=named.probability,
        )  # fmt: skip

    def _ended(
        self, reward: float, *, truncated: bool = False, **info: Any
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """The last step of an episode."""
        self._over = True
        return self._observed(), reward, not truncated, truncated, {**self._info(), **info}

    def parameter_error(self, named: HypothesisSet) -> float:
        """Mean relative error of the parameters of the effects that are rightly named; else 1.

        Relative to the distance from no effect: a gain of 1.2 estimated as 1.1 is half off.
        """
        assert self.machine is not None
        hidden = {effect.name: effect for effect in self.machine.effects}
        errors = []
        for estimate in named.effects:
            if estimate.name in hidden:
                effect = hidden[estimate.name]
                none, own = effect.none[effect.main], estimate.values[effect.main]
                off = abs(own - effect.value) / max(abs(effect.value - none), 1e-12)
                errors.append(min(off, 1.0))
        return float(np.mean(errors)) if errors else float(bool(hidden))

    @property
    def motion_prices(self) -> Array:
        """Price of each motion, for its machine time and its wear (M,)."""
        prices = self.settings.prices
        return np.asarray(prices.second * self.bank.seconds + prices.wear * self.bank.wear)

    @property
    def taken(self) -> int:
        """Motions taken so far."""
        return sum(self.belief.counts.values())

    def action_masks(self) -> NDArray[np.bool_]:
        """Actions that make sense (M + R,), as sb3-contrib's MaskablePPO asks for them."""
        mask = np.zeros(len(self.motions) + self.settings.ranks, dtype=np.bool_)
        mask[: len(self.motions)] = self.taken < self.settings.max_motions
        if self.taken:
            known = min(len(self.belief.posterior.sets), self.settings.ranks)
            mask[len(self.motions) : len(self.motions) + known] = True
        return mask

    def _observed(self) -> NDArray[np.float32]:
        spent = (self.seconds / 60, self.wear, self.taken / self.settings.max_motions)
        known = outlook(self.belief, self.settings.prices.named) if self.taken else self._at_first
        return self.layout.of(self.belief, known, spent)

    @cached_property
    def _at_first(self) -> Outlook:
        """Expected information and gain of the first motion, the same for every machine."""
        return outlook(Belief(self.bank), self.settings.prices.named)

    def _info(self) -> dict[str, Any]:
        return {
            "seconds": self.seconds,
            "wear": self.wear,
            "motions": self.taken,
            "action_mask": self.action_masks(),
        }


def make_model_gap(*, model: str | Path | None = None, **arguments: Any) -> ModelGapEnv:
    """Make the environment of an arm in an MJCF file, by default `loose_env.arms.SERVO_ARM`.

    Raises
    ------
    UnknownName
        If there is no such argument.
    InvalidSetting
        If a setting cannot be used, or there is no such file.
    InvalidData
        If the file is no model with position servos.
    """
    known = [f.name for f in fields(ModelGapSettings)]
    if arguments.pop("render_mode", None) is not None:
        raise UnknownName("loose_env/Gap-v0 draws nothing: leave render_mode out")
    refuse_unknown("arguments", arguments, ("model", *known))
    settings = ModelGapSettings(**arguments)
    path = str(SERVO_ARM if model is None else model_path(model))
    bank = _bank(path, settings.tolerance, settings.max_speed, settings.kinds, settings.library)
    return ModelGapEnv(bank, settings)


@lru_cache(maxsize=4)
def _bank(
    path: str, tolerance: float, max_speed: float, kinds: tuple[str, ...], library: Library
) -> MotionBank:
    """Evidence of the motions of an arm, shared by the environments of a process."""
    arm = read_servo_arm(path, tolerance=tolerance, max_speed=max_speed)
    say = partial(print, "loose_env/Gap-v0:", file=sys.stderr, flush=True)
    return motion_bank(arm, motion_library(arm, library), kinds, say=say)
