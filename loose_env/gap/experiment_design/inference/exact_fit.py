"""Gauss-Newton fit of a set of effects to all motions by simulation, with its Laplace evidence.

Gauss-Newton: the readings are simulated at the current parameters, and their derivatives begin as
those of the bank and are corrected by every further simulation (Broyden's update, in sizes and
shapes). One simulation a motion then takes the error of the bank's linearisation away, and few more
converge. The evidence is Laplace's approximation there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from loose_env.gap.experiment_design.inference.expansion import (
    Data,
    Expansion,
    Solution,
    solve,
)
from loose_env.gap.experiment_design.inference.local_models import (
    SIZE_SD,
    LocalModels,
    parabola,
)
from loose_env.gap.experiment_design.inference.posterior import BeliefSettings, EffectEstimate
from loose_env.gap.experiment_design.inference.simulations import Simulations
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.typing import Array

_REACH, _SHRINK = 1.2, 0.4
"""Largest step in the logarithm of a size, and its factor after a step that made the fit worse."""
_SLOW, _DIFFERENCE = 0.5, 0.02
"""A step that leaves more than this share of the way is slow: the derivatives by sizes and shapes
are then found by differences over this many prior standard deviations."""
_RESEMBLES = 1.0
"""Component of the derivative by a nominal parameter along that by a size or shape, from which it
is sharpened too [noise standard deviations]."""
_SMALLER = 0.4
"""Least size to begin with, over that of the local model."""
_WITHIN, _SHAPES_WITHIN = 1.7, 3.0
"""Bounds of nominal parameters (the tolerance) and of shape parameters [prior sd]."""
_BELOW, _ABOVE = 0.1, 3.0
"""Bounds of a size over the smallest and largest of the bank."""


@dataclass(eq=False)
class ExactFit:
    """Exact fit of a set of effects.

    Its parameters are the nominal ones, then the logarithm of the size and the shape of each
    effect, all over their prior standard deviations.
    """

    models: LocalModels
    rays: tuple[int, ...]
    """Rays of its effects."""
    settings: BeliefSettings
    parameters: Array = field(default_factory=lambda: np.empty(0))
    """Where it is simulated next (D,)."""
    about: dict[int, Expansion] = field(default_factory=dict)
    """Motion -> latest exact expansion."""
    diverged: bool = False
    _reach: float = _REACH
    _slow: bool = False
    _sloped: set[int] = field(default_factory=set)
    _sharp: set[int] = field(default_factory=set)

    def with_models(self, beside: Sequence[int], parameters: Array) -> ExactFit:
        """New fit of these effects and more, from a linear fit of local models beside them."""
        models, parts = self.models, [parameters[: len(self.parameters)]]
        rays = tuple(int(models.ray[h]) for h in beside)
        width, at = models.weights.shape[2] - 1, len(self.parameters)
        for h, ray in zip(beside, rays, strict=True):
            size = float(models.size[h]) * max(1 + SIZE_SD * float(parameters[at]), _SMALLER)
            shapes = len(models.bank.rays[ray].shape_parameters)
            parts += [
                np.array([(np.log(size) - self._middle(ray)) / self.settings.size_sd]),
                parameters[at + 2 : at + 2 + shapes],
            ]
            at += width
        fit = ExactFit(models, (*self.rays, *rays), self.settings)
        fit.parameters = fit._bounded(np.concatenate(parts))
        return fit

    def _middle(self, ray: int) -> float:
        """Prior mean of the logarithm of a size."""
        return float(np.mean(np.log(self.models.bank.sizes[ray])))

    def _parts(self) -> list[tuple[int, int, int]]:
        """Ray, index of the size among the parameters and index after the last shape."""
        at, found = self.models.bank.nuisances, []
        for ray in self.rays:
            end = at + 1 + len(self.models.bank.rays[ray].shape_parameters)
            found.append((ray, at, end))
            at = end
        return found

    def _size(self, ray: int, value: float) -> float:
        return float(np.exp(self._middle(ray) + self.settings.size_sd * value))

    def _bounded(self, parameters: Array) -> Array:
        found, bank = parameters.copy(), self.models.bank
        found[: bank.nuisances] = np.clip(found[: bank.nuisances], -_WITHIN, _WITHIN)
        for ray, at, end in self._parts():
            low = max(bank.rays[ray].smallest, _BELOW * bank.sizes[ray][0])
            high = min(0.98 * bank.rays[ray].largest, _ABOVE * bank.sizes[ray][-1])
            ends = (np.log([low, high]) - self._middle(ray)) / self.settings.size_sd
            found[at] = np.clip(found[at], *ends)
            found[at + 1 : end] = np.clip(found[at + 1 : end], -_SHAPES_WITHIN, _SHAPES_WITHIN)
        return found

    def _bank_jacobian(self, motion: int, at: Array) -> Array:
        """Derivatives by the parabolas of the bank (K, D)."""
        bank = self.models.bank
        vectors = self.models.products(motion)[0]
        found = [vectors[:, : bank.nuisances]]
        for ray, k, _ in self._parts():
            size, sizes = self._size(ray, float(at[k])), bank.sizes[ray]
            first = bank.point(ray, 0)
            slope = vectors[:, first : first + len(sizes)] @ parabola(sizes, size)[0]
            shapes = vectors[:, list(bank.shape_columns[ray])] * size / sizes[len(sizes) // 2]
            found += [(slope * size * self.settings.size_sd)[:, None], shapes]
        return np.concatenate(found, axis=1)

    def hypothesis(self, parameters: Array) -> Hypothesis:
        """The hypothesis at some parameters (D,)."""
        bank = self.models.bank
        nominal = bank.arm.nominal
        sds = np.array([p.spread or 1.0 for p in nominal.parameters]) * bank.arm.tolerance
        return Hypothesis(
            effects=tuple(bank.rays[ray].effect for ray in self.rays),
            values=tuple(
                bank.rays[ray].values(
                    self._size(ray, float(parameters[at])), parameters[at + 1 : e]
                )
                for ray, at, e in self._parts()
            ),
            nominal=nominal,
            factors=1 + sds * parameters[: bank.nuisances],
        )

    def lacks(self, data: Data) -> list[int]:
        """Measured motions that are not simulated yet."""
        return [motion for motion in data if motion not in self.about]

    def solution(self, data: Data) -> Solution:
        """Least squares about the latest simulations."""
        return solve(data, self.about, self.settings.linearisation, len(self.parameters))

    def step(self, data: Data, simulations: Simulations, within: float) -> None:
        """Simulate motions that are new; if there are none, take one step of the fit."""
        new = self.lacks(data)
        here = self.hypothesis(self.parameters)
        simulations.ahead(new, [here])
        for motion in new:
            found = simulations.readings(motion, [here])[0]
            if found is None:
                self.diverged = True
                return
            jacobian = self._bank_jacobian(motion, self.parameters)
            self.about[motion] = Expansion(found, self.parameters, jacobian)
        if new:
            self._reach = _REACH
            return
        target = self._bounded(self.solution(data).parameters)
        far, before = self._far(data, target, within), self.unsettled(data)
        blunt = [k for k in far if k not in self._sloped]
        if self._slow and blunt:
            for motion in blunt:
                self._difference(motion, [], simulations)
            self._slow = False
            return
        way = target - self.parameters
        longest = max(
            (abs(way[at]) * self.settings.size_sd for _, at, _ in self._parts()), default=0.0
        )
        step = min(1.0, self._reach / max(longest, 1e-9))
        tried = self._bounded(self.parameters + step * way)
        if self._moved(data, far, tried, simulations):
            self.parameters = tried
        else:
            self._reach = _SHRINK * min(longest * step, self._reach)
        self._slow = self.unsettled(data) > _SLOW * before

    def sharpen(self, motions: Iterable[int], simulations: Simulations) -> None:
        """Replace the derivatives of motions by differences of simulations.

        Those by sizes and shapes, and by the nominal parameters that resemble one of them: of a
        machine whose gain is a fifth off, the bank's derivative by the nominal gain differs enough
        to tell both apart, which nothing does.
        """
        first = self.models.bank.nuisances
        for motion in motions:
            jacobian = self.about[motion].jacobian
            own = jacobian[:, first:]
            along = jacobian[:, :first].T @ (own / (np.linalg.norm(own, axis=0) + 1e-9))
            alike = np.flatnonzero((np.abs(along) > _RESEMBLES).any(axis=1))
            self._difference(motion, alike.tolist(), simulations)
            self._sharp.add(motion)

    def _difference(self, motion: int, nuisances: Sequence[int], simulations: Simulations) -> None:
        """Derivatives of a motion by some nominal parameters and all sizes and shapes."""
        about = self.about[motion]
        which = [*nuisances, *range(self.models.bank.nuisances, len(self.parameters))]
        steps = np.where(about.at[which] > 0, -_DIFFERENCE, _DIFFERENCE)  # off the bounds
        moved = about.at + np.eye(len(about.at))[which] * steps[:, None]
        jacobian = about.jacobian.copy()
        simulated = simulations.readings(motion, [self.hypothesis(each) for each in moved])
        for k, step, found in zip(which, steps, simulated, strict=True):
            if found is not None:
                jacobian[:, k] = (found - about.readings) / step
        self.about[motion] = replace(about, jacobian=jacobian)
        self._sloped.add(motion)

    def blunt(self, data: Data) -> list[int]:
        """Motions whose derivatives were not sharpened yet."""
        return [motion for motion in data if motion not in self._sharp]

    def unsettled(self, data: Data) -> float:
        """Length of the change of the readings to the fit from where they were simulated.

        By the derivatives [noise standard deviations]; infinite before all motions are simulated.
        """
        if set(self.about) != set(data):
            return float("inf")
        target = self._bounded(self.solution(data).parameters)
        return float(np.sqrt(sum(n * self._way(k, target) ** 2 for k, (_, n) in data.items())))

    def _far(self, data: Data, target: Array, within: float) -> list[int]:
        ways = {k: self._way(k, target) * float(np.sqrt(data[k][1])) for k in data}
        return [k for k, way in ways.items() if way > min(within, 0.99 * max(ways.values()))]

    def _way(self, motion: int, target: Array) -> float:
        about = self.about[motion]
        return float(np.linalg.norm(about.jacobian @ (target - about.at)))

    def _moved(
        self, data: Data, far: Sequence[int], tried: Array, simulations: Simulations
    ) -> bool:
        """Simulate motions at new parameters; whether the fit got better there.

        The derivatives learn from it in any case.
        """
        there = self.hypothesis(tried)
        simulations.ahead(far, [there])
        found = {k: simulations.readings(k, [there])[0] for k in far}
        before, after = float(self.parameters @ self.parameters), float(tried @ tried)
        for motion, readings in found.items():
            if readings is None:
                return False
            about, (mean, repeated) = self.about[motion], data[motion]
            before += repeated * float(np.sum((mean - about.readings) ** 2))
            after += repeated * float(np.sum((mean - readings) ** 2))
        better = after < before + 1.0
        for motion, readings in found.items():
            assert readings is not None
            about = self.about[motion]
            way = tried - about.at
            along = way.copy()
            along[: self.models.bank.nuisances] = 0.0
            jacobian = about.jacobian
            if motion not in self._sharp and along @ along > 1e-12:
                missed = readings - about.readings - jacobian @ way
                jacobian = jacobian + np.outer(missed, along) / (along @ along)
            kept = (readings, tried) if better else (about.readings, about.at)
            self.about[motion] = Expansion(*kept, jacobian)
        return better

    def estimates(self, found: Solution, misfit: float) -> tuple[EffectEstimate, ...]:
        """Estimates of the effects, with 95 % intervals in the logarithm of their sizes."""
        estimates = []
        for ray_index, at, end in self._parts():
            ray = self.models.bank.rays[ray_index]
            spread = 1.96 * float(np.sqrt(found.covariance[at, at] * misfit))
            values = self._bounded(found.parameters)
            sizes = [self._size(ray_index, values[at] + s) for s in (0.0, -spread, spread)]
            ends = [float(ray.values(size, values[at + 1 : end])[ray.main]) for size in sizes]
            parameter = ray.effect.parameters[ray.main]
            estimates.append(
                EffectEstimate(
                    ray.name, parameter.name, parameter.unit, ends[0], min(ends), max(ends),
                    sizes[0],
                )
            )  # fmt: skip
        return tuple(sorted(estimates, key=lambda e: e.name))
