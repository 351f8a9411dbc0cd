"""The model-gap environment: choose the motion that tells missing effects apart."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from loose_env.envs.model_gap.hidden_machine import HiddenMachine
from loose_env.envs.model_gap.observation import GapObservation
from loose_env.envs.model_gap.settings import ModelGapSettings
from loose_env.errors import InvalidAction, UnknownName
from loose_env.gap import (
    Belief,
    HypothesisSet,
    LocalModels,
    Outlook,
    SignatureBank,
    outlook,
)
from loose_env.typing import Array

__all__ = ["ModelGapEnv"]


class ModelGapEnv(gymnasium.Env[NDArray[np.float32], np.int64]):
    """Find the physical effects that a robot's model lacks, in little machine time.

    ## Description
    A machine differs from its nominal model by none, one or two effects of the catalogue of
    `loose gap` (friction, compliance, play, delays, wrong inertias, sensor errors), at a random
    location and with a random size, and by nominal parameters within a tolerance. The agent
    chooses motions; each is simulated with the hidden effects in MuJoCo, measured by encoders and
    torque sensors with noise, and updates a belief: a posterior over all sets of at most two
    effects, from signatures about the nominal model. It names a set when it is sure.

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
    elbow), and all fields of `ModelGapSettings`. The signatures of the arm are computed once,
    within minutes, and stored in the user's cache folder. Options of `reset`: ``{"names": [...]}``
    hides given effects, ``{"count": n}`` a number of random ones.

    ## Version History
    v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self, bank: SignatureBank, settings: ModelGapSettings | None = None, *,
        models: LocalModels | None = None,
    ) -> None:  # fmt: skip
        self.bank, self.settings = bank, settings or ModelGapSettings()
        self.models = models or LocalModels(bank)
        self.motions = bank.library
        self.layout = GapObservation(
            candidates=len(bank.names), motions=len(bank.library), ranks=self.settings.ranks
        )
        self.observation_space: Any = self.layout.space
        self.action_space = spaces.Discrete(len(bank.library) + self.settings.ranks)
        self.machine: HiddenMachine | None = None
        """The hidden machine of the episode."""
        self.belief = Belief(self.models, self.settings.belief)
        """Belief about it."""
        self.seconds, self.wear = 0.0, 0.0
        self._over = True
        self._at_first: Outlook | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Draw a machine.

        Raises
        ------
        UnknownName
            If there is no such option.
        InvalidSetting
            If a name is no candidate.
        """
        super().reset(seed=seed)
        given = dict(options or {})
        unknown = sorted(set(given) - {"names", "count"})
        if unknown:
            raise UnknownName(f"unknown options {unknown}; known are ['names', 'count']")
        self.machine = self.settings.draw.draw(
            self.bank, self.np_random, count=given.get("count"),
            names=tuple(given.get("names", ())),
        )  # fmt: skip
        self.belief = Belief(self.models, self.settings.belief)
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
            self._over = True
            return self._observed(), prices.wrong, True, False, self._info()
        readings = self.machine.run(action, self.np_random)
        self.seconds += float(self.bank.seconds[action])
        self.wear += float(self.bank.wear[action])
        reward = -float(self.motion_prices[action])
        if not np.isfinite(readings).all():
            self._over = True
            info = {**self._info(), "failure": "the simulation of the machine diverged"}
            return self._observed(), reward, False, True, info
        self.belief.add(action, readings)
        return self._observed(), reward, False, False, self._info()

    def _verdict(self, rank: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        assert self.machine is not None
        if not self.action_masks()[len(self.motions) + rank]:  # it names nothing
            self._over = True
            missed = {**self._info(), "truth": self.machine.names, "is_success": False}
            return self._observed(), self.settings.prices.wrong, True, False, missed
        named = self.belief.posterior.sets[rank]
        truth, error = self.machine.names, self.parameter_error(named)
        reward = self.settings.prices.verdict(named.names, truth, parameter_error=error)
        self._over = True
        info = {
            **self._info(),
            "verdict": named.names,
            "truth": truth,
            "is_success": named.names == truth,
            "parameter_error": error,
            "probability": named.probability,
        }
        return self._observed(), reward, True, False, info

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
                null_values = effect.ray.effect.null_values
                none = 0.0 if null_values is None else null_values[effect.ray.main]
                off = abs(estimate.value - effect.value) / max(abs(effect.value - none), 1e-12)
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
        return self.layout.of(self.belief, self._outlook(), spent)

    def _outlook(self) -> Outlook:
        """Expected information and gain of the motions."""
        if self.belief.counts:
            return outlook(self.belief, self.settings.prices.named)
        if self._at_first is None:  # the same for every machine: nothing is known yet
            self._at_first = outlook(self.belief, self.settings.prices.named)
        return self._at_first

    def _info(self) -> dict[str, Any]:
        return {
            "seconds": self.seconds,
            "wear": self.wear,
            "motions": self.taken,
            "action_mask": self.action_masks(),
        }
