"""Particle posterior: likelihood-free model comparison by simulation.

The likelihood of what was measured is synthetic. A particle is one fault; all else (the arm's
mismatch, the excitation, the noise) is left to chance, and shared out among numbered
realisations. Every particle is simulated with the same realisation, in the poses of the records.
What it shows is set against what was measured, in a vector of summaries; how the summaries
scatter from realisation to realisation, and what the common one adds to them, is seen on some
particles that are repeated with others
(`loose_env.diagnosis.research.particles.synthetic_likelihood`). So one simulation a particle
stands for the law of many.

From the prior to that likelihood goes a ladder of powers 0 < p1 < ... < 1 of it. Each step
leaves a given share of effective particles, then draws them anew and moves them by a Markov
kernel that keeps the target. The product of the mean weights is the evidence of a hypothesis.

References
----------
S. N. Wood, "Statistical inference for noisy nonlinear ecological dynamic systems", Nature 466,
2010: synthetic likelihood. E. Sellentin, A. F. Heavens, "Parameter inference with estimated
covariance matrices", MNRAS Letters 456, 2016: Student's law for it. P. Del Moral, A. Doucet,
A. Jasra, "Sequential Monte Carlo samplers", JRSS B 68, 2006, and "An adaptive sequential Monte
Carlo method for approximate Bayesian computation", Statistics and Computing 22, 2012: the
ladder. S. L. Cotter et al., "MCMC methods for functions", Statistical Science 28, 2013: the
moves, which do not slow down with the number of variates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from loose_env.diagnosis.research.particles.synthetic_likelihood import (
    ParticleModel,
    Repeated,
    SyntheticLikelihood,
    nearness,
)
from loose_env.diagnosis.research.particles.tempering import next_power, resampled
from loose_env.errors import InvalidSetting
from loose_env.typing import Array

__all__ = ["Evidence", "ParticleSettings", "evidence_by_particles", "probabilities_from"]


@dataclass(frozen=True, kw_only=True)
class ParticleSettings:
    """Size of a population and how it climbs."""

    particles: int = 4000
    """Particles of all hypotheses together, as many for each."""
    islands: int = 4
    """Populations that are resampled apart; their spread gives the standard error."""
    share: float = 0.5
    """Effective share of the particles that a step of the ladder leaves."""
    moves: int = 2
    """Times that every particle tries to move after a step."""
    repeated: int = 60
    """Anchors: particles of all hypotheses that are repeated to see how summaries scatter."""
    repeats: int = 8
    """Realisations of all that is left to chance for each of them."""
    neighbours: int = 8
    """Anchors from which a particle takes its scatter, half of them at most."""
    freedom: float = 10.0
    """Degrees of freedom of the likelihood; infinite ones make it normal."""
    negligible: float = 1e-3
    """A hypothesis is left once its evidence cannot exceed this share of the best one's."""
    steps: int = 60
    """Most steps of a ladder; the last one goes all the way."""

    def __post_init__(self) -> None:
        for name, least in (
            ("particles", 1),
            ("islands", 2),
            ("moves", 1),
            ("repeated", 4),
            ("repeats", 2),
            ("neighbours", 1),
            ("steps", 1),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
                raise InvalidSetting(f"{name} is a whole number, {least} or more; got {value!r}")
        if not 0 < self.share < 1 or not 0 < self.negligible < 1 or not self.freedom > 0:
            raise InvalidSetting(
                "share and negligible lie between 0 and 1, freedom is positive; got "
                f"{self.share!r}, {self.negligible!r} and {self.freedom!r}"
            )

    def each(self, hypotheses: int) -> int:
        """Particles of an island of one hypothesis.

        Raises
        ------
        InvalidSetting
            If there are fewer than four.
        """
        count = self.particles // (hypotheses * self.islands)
        if count < 4:
            raise InvalidSetting(
                f"{self.particles} particles leave {count} for each of {self.islands} islands of "
                f"{hypotheses} hypotheses; at least 4 are needed, {16 * hypotheses} with 4 islands"
            )
        return count


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Evidence of the hypotheses by particles."""

    prior: Array
    """Probability of each hypothesis beforehand (H,)."""
    log_evidence: Array
    """Log evidence of each island and hypothesis, up to one constant (B, H)."""
    finished: NDArray[np.bool_]
    """True if tempering reached power 1; else the evidence is an upper bound (H,)."""
    simulations: int
    """Particles simulated, moves and repeats included."""
    steps: NDArray[np.intp]
    """Steps of each ladder (H,)."""
    accepted: float
    """Share of the moves that were accepted."""
    interaction: float
    """Variance over the repeated particles of what the common realisation adds to them, beyond
    that by chance, over the scatter's variance, mean over the summaries. The likelihood is too
    wide by what of it neighbours do not share."""

    @property
    def probabilities(self) -> Array:
        """Probability of each hypothesis (H,)."""
        return probabilities_from(self.prior, self.log_evidence)

    @property
    def standard_error(self) -> Array:
        """Monte-Carlo standard error of the probabilities: jackknife over the islands (H,)."""
        islands = len(self.log_evidence)
        without = np.array(
            [
                probabilities_from(self.prior, np.delete(self.log_evidence, b, axis=0))
                for b in range(islands)
            ]
        )
        deviations = without - without.mean(axis=0)
        return np.asarray(np.sqrt((islands - 1) / islands * (deviations**2).sum(axis=0)))


def probabilities_from(prior: Array, log_evidence: Array) -> Array:
    """Probabilities of hypotheses by the mean evidence of islands.

    Parameters
    ----------
    prior : ndarray (H,)
        Probability of each hypothesis beforehand.
    log_evidence : ndarray (B, H)
        Log evidence of each island, up to one constant.

    Returns
    -------
    ndarray (H,)

    Examples
    --------
    >>> probabilities_from(np.array([0.5, 0.5]), np.log([[1.0, 2.0], [1.0, 4.0]])).tolist()
    [0.25, 0.75]
    """
    with np.errstate(divide="ignore"):
        total = np.log(prior) + logsumexp(log_evidence, axis=0)
    return np.asarray(np.exp(total - logsumexp(total)))


def evidence_by_particles(
    model: ParticleModel, settings: ParticleSettings, rng: np.random.Generator
) -> Evidence:
    """Model comparison of hypotheses by tempered particles.

    The ladder of the hypothesis that may still have most evidence is climbed first: the evidence
    falls from step to step, so that of one that is left at ``negligible`` is a bound.

    Parameters
    ----------
    model : ParticleModel
        Simulator and measured summaries.
    settings : ParticleSettings
        Size of the population and how it climbs.
    rng : numpy.random.Generator
        Source of all draws but those within a simulation.

    Raises
    ------
    InvalidSetting
        If there are too few particles for the hypotheses.
    """
    hypotheses = [h for h, p in enumerate(model.prior) if p > 0]
    each = settings.each(len(hypotheses))
    islands = settings.islands
    log_evidence = np.zeros((islands, len(model.prior)))
    steps = np.zeros(len(model.prior), dtype=np.intp)
    if not len(model.measured):
        return Evidence(
            prior=model.prior,
            log_evidence=log_evidence,
            finished=np.ones(len(model.prior), dtype=bool),
            simulations=0,
            steps=steps,
            accepted=0.0,
            interaction=0.0,
        )
    counted = _Counted(model)
    ladders = {h: _Ladder(counted, h, settings, each, rng) for h in hypotheses}
    likelihood = _likelihood(counted, settings, ladders)
    for ladder in ladders.values():
        ladder.weigh(likelihood)
    found = -np.inf
    while True:
        bounds = {
            h: float(np.log(model.prior[h])) + ladder.bound
            for h, ladder in ladders.items()
            if ladder.power < 1
        }
        if not bounds:
            break
        first = max(bounds, key=lambda h: bounds[h])
        if bounds[first] < found + np.log(settings.negligible):
            break
        ladder = ladders[first]
        ladder.climb()
        if ladder.power == 1:
            found = max(found, float(np.log(model.prior[first])) + ladder.bound)
    for h, ladder in ladders.items():
        log_evidence[:, h], steps[h] = ladder.log_evidence, ladder.steps
    tried = sum(ladder.tried for ladder in ladders.values())
    return Evidence(
        prior=model.prior,
        log_evidence=log_evidence,
        finished=np.array(
            [h not in ladders or ladders[h].power == 1 for h in range(len(model.prior))]
        ),
        simulations=counted.simulations,
        steps=steps,
        accepted=sum(ladder.accepted for ladder in ladders.values()) / max(tried, 1),
        interaction=likelihood.interaction,
    )


class _Counted:
    """A model that counts what it simulates."""

    def __init__(self, model: ParticleModel) -> None:
        self.model = model
        self.simulations = 0

    def simulate(self, hypothesis: int, variates: Array, realisations: NDArray[np.intp]) -> Array:
        self.simulations += len(variates)
        return self.model.simulate(hypothesis, variates, realisations)


def _likelihood(
    counted: _Counted, settings: ParticleSettings, ladders: dict[int, _Ladder]
) -> SyntheticLikelihood:
    """Build the likelihood by repeating particles near to what was measured.

    Half of the anchors are near in units of the particles' spread, the other half in those of
    the likelihood that the first ones give.
    """
    measured = counted.model.measured
    summaries = np.concatenate([ladder.summaries for ladder in ladders.values()])
    owner = np.concatenate([np.full(len(x.summaries), h) for h, x in ladders.items()])
    index = np.concatenate([np.arange(len(x.summaries)) for x in ladders.values()])
    values = nearness(measured, summaries)
    repeated: list[Repeated] = []
    rng = next(iter(ladders.values())).rng
    number = 1  # realisation 0 is that of all particles
    for wanted in (settings.repeated // 2, settings.repeated - settings.repeated // 2):
        share = max(0.05, min(0.5, 2 * wanted / len(values)))
        weights = np.exp(next_power(values, 0.0, share) * (values - values.max()))
        for k in rng.permutation(resampled(weights, rng))[:wanted]:
            h = int(owner[k])
            again = np.tile(ladders[h].variates[index[k]], (settings.repeats, 1))
            numbers = np.arange(number, number + settings.repeats)
            number += settings.repeats
            repeated.append(
                Repeated(common=summaries[k], again=counted.simulate(h, again, numbers))
            )
        likelihood = SyntheticLikelihood.by_repeats(
            measured, repeated, freedom=settings.freedom, neighbours=settings.neighbours
        )
        values = likelihood.log(summaries)
    return likelihood


class _Ladder:
    """The particles of one hypothesis on their way from the prior to the posterior."""

    def __init__(
        self,
        counted: _Counted,
        hypothesis: int,
        settings: ParticleSettings,
        each: int,
        rng: np.random.Generator,
    ) -> None:
        self.counted, self.hypothesis, self.settings, self.rng = counted, hypothesis, settings, rng
        islands = settings.islands
        count = islands * each
        size = counted.model.variates[hypothesis]
        self.variates = rng.standard_normal((count, size))
        alike = size == 0  # nothing tells particles apart: one stands for all
        self.summaries = self._simulate(self.variates[:1] if alike else self.variates)
        self.summaries = np.resize(self.summaries, (count, self.summaries.shape[1]))
        self.likelihood: SyntheticLikelihood | None = None
        self.highest = 0.0
        self.values = np.zeros(count)
        self.power, self.steps = 0.0, 0
        self.log_evidence = np.zeros(islands)
        self.accepted = self.tried = 0

    @property
    def bound(self) -> float:
        """Log evidence at the power reached, the mean of the islands."""
        return float(logsumexp(self.log_evidence) - np.log(len(self.log_evidence)))

    def weigh(self, likelihood: SyntheticLikelihood) -> None:
        """Work out the likelihood of all particles.

        The highest density is taken off. What is left is hardly above zero, so that the evidence
        falls from step to step.
        """
        self.likelihood, self.highest = likelihood, likelihood.highest
        self.values = self._values(self.summaries)

    def _values(self, summaries: Array) -> Array:
        assert self.likelihood is not None  # it was weighed
        return self.likelihood.log(summaries) - self.highest

    def climb(self) -> None:
        """Go one step up: reweigh, resample within islands, move."""
        self.steps += 1
        last = self.steps >= self.settings.steps
        after = 1.0 if last else next_power(self.values, self.power, self.settings.share)
        with np.errstate(invalid="ignore"):
            weights = (after - self.power) * self.values
        chosen = []
        rows = np.arange(len(self.values)).reshape(self.settings.islands, -1)
        for b, island in enumerate(rows):
            total = logsumexp(weights[island])
            self.log_evidence[b] += total - np.log(len(island))
            if np.isfinite(total):
                island = island[resampled(np.exp(weights[island] - total), self.rng)]
            chosen.append(island)
        at = np.concatenate(chosen)
        self.variates, self.summaries = self.variates[at], self.summaries[at]
        self.values, self.power = self.values[at], after
        if after < 1:
            for _ in range(self.settings.moves):
                self._move()

    def _move(self) -> None:
        """Let every particle try a move that keeps the target.

        The proposal keeps a normal law fitted to the particles, whatever its length; lengths are
        drawn over half a decade, so that none has to be tuned.
        """
        here, rng = self.variates, self.rng
        count, size = here.shape
        damped = count / (count + size)
        middle = damped * here.mean(axis=0)
        covariance = damped * np.cov(here, rowvar=False).reshape(size, size)
        covariance += (1 - damped) * np.eye(size)
        root = np.linalg.cholesky(covariance)
        length = 10 ** rng.uniform(-0.5, 0.0, (count, 1))
        there = middle + np.sqrt(1 - length**2) * (here - middle)
        there = there + length * (rng.standard_normal(here.shape) @ root.T)
        shown = self._simulate(there)
        values = self._values(shown)

        def against(variates: Array) -> Array:
            """Log prior over the law that the proposal keeps."""
            along = np.linalg.solve(root, (variates - middle).T)
            return np.asarray(0.5 * ((along**2).sum(axis=0) - (variates**2).sum(axis=1)))

        before = np.where(np.isfinite(self.values), self.values, -1e300)
        gain = self.power * (values - before) + against(there) - against(here)
        takes = np.log(rng.random(count)) < gain
        self.variates = np.where(takes[:, None], there, here)
        self.summaries = np.where(takes[:, None], shown, self.summaries)
        self.values = np.where(takes, values, self.values)
        self.accepted += int(takes.sum())
        self.tried += count

    def _simulate(self, variates: Array) -> Array:
        common = np.zeros(len(variates), dtype=np.intp)
        return self.counted.simulate(self.hypothesis, variates, common)
