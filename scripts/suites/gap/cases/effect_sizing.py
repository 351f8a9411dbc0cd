"""How large an effect must be to be just visible.

Let d be the difference that an effect makes to the readings of one run, in standard deviations
of the noise, and G the change of the readings with the nuisance parameters (masses, inertias,
dampings, gains and rotors, each known within the tolerance). What no nuisance explains is

    excess = min |d + G t|²  over all t that the tolerance leaves,

the chi-square that the best model without the effect has above its expectation N, the number of
independent readings. The nominal figures may move within the tolerance: of a true figure that lies
2 % above the nominal one they may reach 5 % below it and 1 % above. The chi-square's own standard
deviation is sqrt(2 N + 4 excess). The run is one that the tool holds out. An effect is just visible
when its excess is three times that.
Kinds that could stand for it (a steady friction for a Stribeck curve) join G without bounds.

The readings are: every sample of every sensor for commanded and free motion (their noise is
white, so N is their number); low-passed torque residuals for the inverse form; the transfer from
the command to every sensor by frequency for a shaken arm, because trajectories with struck stops
part ways.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy import signal
from scipy.optimize import lsq_linear

from loose_env.typing import Array
from scripts.suites.gap.cases.inverse import torque_residual
from scripts.suites.gap.cases.motions import Motion
from scripts.suites.gap.cases.sensing import Noise, Signals, add_noise
from scripts.suites.gap.cases.true_arm import TrueArm
from scripts.suites.gap.effects.catalogue import kinds
from scripts.suites.gap.effects.types import (
    INVERSE,
    RANDOM,
    Effect,
    Kind,
    Parameters,
    Place,
    log_uniform,
)
from scripts.suites.gap.simulator.build import FACTORS, TOLERANCE, Factors
from scripts.suites.gap.simulator.simulate import SAMPLE

VISIBLE = 3.0
"""Standard deviations of the excess at which an effect is just visible."""
STEP = 2e-3
"""Step of a factor for a difference quotient."""
INSIDE = 1
"""Integration steps in a sample while sizes are sought; recordings take more."""
SETTLE = 0.8
"""Time to settle while sizes are sought [s]."""
SEGMENT = 1024
"""Samples of a segment of a spectrum."""
PRECISION = 1.05
"""Ratio to which a size is found."""
THIN = 4
"""Of trajectories one sample in this many is looked at and counted for all: what effects do
changes little in between."""


class Visibility:
    """How visible effects are on one run of one arm.

    Parameters
    ----------
    arm : TrueArm
        The true arm with its effects; they are put aside.
    motion : Motion
        The run.
    noise : Noise
        Noise of the sensors.
    form : str
        Form of the recording.
    seed : int
        Seed of the noise by which spectra are weighed.
    tolerance : float
        Largest relative error of the nominal figures.

    Attributes
    ----------
    columns : Array
        Changes of the features with the nuisance factors, of shape (features, 6 n).
    count : int
        Number of independent readings.
    """

    def __init__(
        self,
        arm: TrueArm,
        motion: Motion,
        noise: Noise,
        form: str,
        *,
        seed: int = 0,
        tolerance: float = TOLERANCE,
    ) -> None:
        self.arm, self.motion, self.noise, self.form = arm.without(), motion, noise, form
        self._rng = np.random.default_rng(seed)
        self._kept: dict[tuple[object, ...], Array] = {}
        signals = self._signals(self.arm)
        self._scale = self._noise_scale(signals)
        self._base = self._features(signals)
        self.count = self._base.size * (1 if form in (INVERSE, RANDOM) else THIN)
        self.columns = columns = self._sensitivities()
        # a figure that does nothing (an inertia about an axis that never turns) is left out
        lengths = np.linalg.norm(columns, axis=0)
        self._acts, self._lengths = lengths > 0, lengths[lengths > 0]
        # of the true figures: a figure of the model less that of the arm, changed in sign
        off = (self.arm.factors.flat() - 1.0)[self._acts]
        self._low = (off - tolerance) * self._lengths
        self._high = (off + tolerance) * self._lengths
        self._q, self._r = np.linalg.qr(columns[:, self._acts] / self._lengths)

    def _signals(self, arm: TrueArm) -> Signals:
        return arm.run(self.motion, inside=INSIDE, settle=SETTLE)

    def _noise_scale(self, signals: Signals) -> Array:
        """Standard deviations of the features, or one where they are normalised already."""
        noisy = add_noise(signals, self.noise, self._rng)
        if self.form == INVERSE:
            arm = self.arm
            moved = torque_residual(noisy, arm.figures, arm.factors) - torque_residual(
                signals, arm.figures, arm.factors
            )
            return np.asarray(moved.std(axis=0))
        if self.form == RANDOM:
            transfer, coherence, segments = self._transfer(noisy)
            spread = np.abs(transfer) ** 2 * (1 - coherence) / (2 * segments * coherence)
            return np.sqrt(np.maximum(spread, 1e-30))
        return np.ones(1)

    def _transfer(self, signals: Signals) -> tuple[Array, Array, float]:
        """Transfer from the command to every reading, its coherence, number of segments."""
        x = self.motion.commands[:, self.motion.excited]
        y = signals.normalised(self.noise).T
        spectrum = signal.welch(x, 1 / SAMPLE, nperseg=SEGMENT)[1]
        frequencies, cross = signal.csd(x[None], y, 1 / SAMPLE, nperseg=SEGMENT)
        power = signal.welch(y, 1 / SAMPLE, nperseg=SEGMENT)[1]
        band = (frequencies > 5.0) & (spectrum > 0.05 * spectrum.max())
        coherence = np.abs(cross) ** 2 / (spectrum * np.maximum(power, 1e-30))
        segments = 2 * len(x) / SEGMENT * 0.75
        return (cross / spectrum)[:, band], np.clip(coherence[:, band], 1e-6, 1 - 1e-9), segments

    def _features(self, signals: Signals, factors: Factors | None = None) -> Array:
        if self.form == INVERSE:
            arm = self.arm
            residual = torque_residual(signals, arm.figures, factors or arm.factors)
            return (residual / self._scale).ravel()
        if self.form == RANDOM:
            transfer = self._transfer(signals)[0] / self._scale
            return np.concatenate((transfer.real.ravel(), transfer.imag.ravel()))
        return np.sqrt(THIN) * signals.normalised(self.noise)[::THIN].ravel()  # type: ignore[no-any-return]

    def _sensitivities(self) -> Array:
        """Change of the features with every factor, of shape (features, 6 n)."""
        columns = []
        base = self._signals(self.arm) if self.form == INVERSE else None
        for name in FACTORS:
            for joint in range(self.arm.figures.joints):
                moved = self.arm.factors.changed(name, joint, STEP)
                if base is not None:
                    features = self._features(base, moved)
                else:
                    arm = dataclasses.replace(self.arm, factors=moved)
                    features = self._features(self._signals(arm))
                columns.append((features - self._base) / STEP)
        return np.stack(columns, axis=1)

    def difference(self, effects: tuple[Effect, ...]) -> Array:
        """Difference that effects make, in standard deviations, of shape (features,)."""
        arm = dataclasses.replace(self.arm, effects=effects)
        return self._features(self._signals(arm)) - self._base

    def excess(self, difference: Array, rivals: Array | None = None) -> float:
        """What of a difference no nuisance explains, squared and summed.

        Parameters
        ----------
        difference : Array
            Of shape (features,).
        rivals : Array, optional
            Further columns without bounds, of shape (features, r).
        """
        if not np.all(np.isfinite(difference)):
            return float("inf")
        q, r, low, high = self._q, self._r, self._low, self._high
        if rivals is not None:
            inside = q.T @ rivals
            new, corner = np.linalg.qr(rivals - q @ inside)  # what the nuisances leave of them
            q = np.hstack((q, new))
            zero = np.zeros((corner.shape[0], r.shape[1]))
            r = np.block([[r, inside], [zero, corner]])
            free = np.full(rivals.shape[1], np.inf)
            low, high = np.concatenate((low, -free)), np.concatenate((high, free))
        inside = q.T @ difference
        rest = float(difference @ difference - inside @ inside)
        found = lsq_linear(r, -inside, bounds=(low, high), method="bvls")
        return max(rest, 0.0) + 2 * float(found.cost)

    def explained(self, difference: Array) -> Array:
        """Changes of the nuisance factors that undo most of a difference, of shape (6 n,)."""
        found = lsq_linear(
            self._r, -self._q.T @ difference, bounds=(self._low, self._high), method="bvls"
        )
        changes = np.zeros(len(self._acts))
        changes[self._acts] = found.x / self._lengths
        return changes

    def score(self, excess: float) -> float:
        """An excess in its own standard deviations."""
        if not np.isfinite(excess):
            return float("inf")
        return excess / np.sqrt(2 * self.count + 4 * excess)  # type: ignore[no-any-return]

    def of(self, kind: Kind, place: Place, drawn: Parameters, size: float) -> float:
        """Score of an effect of a given size, beyond what its rivals explain."""
        figures = self.arm.figures
        effect = Effect(
            kind=kind.name, place=place, parameters=kind.size(size, drawn, figures, place)
        )
        return self.score(self.excess(self.difference((effect,)), self._rivals(kind, place, drawn)))

    def beside(self, effect: Effect, other: Effect) -> float:
        """Score of an effect beyond what a change of another one explains."""
        columns = self._columns_of(kinds()[other.kind], other.place)
        return self.score(self.excess(self.difference((effect,)), np.stack(columns, axis=1)))

    def _rivals(self, kind: Kind, place: Place, drawn: Parameters) -> Array | None:
        """Changes with the kinds that could stand for another, of shape (features, r)."""
        if not kind.rivals:
            return None
        key = (kind.name, place.index, drawn.get("other"))
        if key not in self._kept:
            columns = []
            for name in kind.rivals:
                rival = kinds()[name]
                for at in rival.places(self.arm.figures):
                    if place.index in (-1, at.index) or drawn.get("other") == at.index:
                        columns += self._columns_of(rival, at)
            # none of them may be there: a wheel about the vertical has no zero that matters
            self._kept[key] = np.stack(columns, axis=1) if columns else np.empty((0, 0))
        return self._kept[key] if self._kept[key].size else None

    def _columns_of(self, kind: Kind, place: Place) -> list[Array]:
        """Changes of the readings with the free numbers of a kind, each of shape (features,)."""
        figures = self.arm.figures
        rng = np.random.default_rng(1)
        low, high = kind.bounds(figures, place)
        # a fraction of its range: small enough to be nearly linear, large enough to be exact
        size = float(np.sqrt(low * high))
        drawn = {**kind.draw(rng, figures, place), "sign": 1.0}
        shapes = [drawn]
        if "direction" in drawn:
            shapes = [{**drawn, "direction": axis.tolist()} for axis in np.eye(3)]
        elif "reference" in drawn:
            shapes.append({**drawn, "reference": drawn["reference"] + figures.reach[place.index]})
        columns = []
        for shape in shapes:
            parameters = kind.size(size, shape, figures, place)
            effect = Effect(kind=kind.name, place=place, parameters=parameters)
            columns.append(self.difference((effect,)))
        moves = [column for column in columns if np.linalg.norm(column) > 1e-9]
        return moves or columns[:1]


def visible_size(
    visibility: Visibility, kind: Kind, place: Place, drawn: Parameters
) -> float | None:
    """Size at which an effect is just visible on a run, or None if it cannot be.

    Parameters
    ----------
    visibility : Visibility
        The run.
    kind, place, drawn : Kind, Place, Parameters
        The effect but for its size.
    """
    low, high = kind.bounds(visibility.arm.figures, place)
    score = visibility.of(kind, place, drawn, high)
    if score < VISIBLE:
        return None
    guess = np.sqrt(low * high)
    while high / low > PRECISION:
        score = visibility.of(kind, place, drawn, guess)
        if score < VISIBLE:
            low = guess
        else:
            high = guess
        # most effects show by the square of their size: guess by that, inside the bracket
        step = np.sqrt(VISIBLE / score) if 0 < score < np.inf else 0.0
        guess = guess * step * (PRECISION**0.4 if score < VISIBLE else PRECISION**-0.4)
        if not low * PRECISION**0.2 < guess < high / PRECISION**0.2:
            guess = np.sqrt(low * high)
    return float(high)


def drawn_effect(
    rng: np.random.Generator,
    visibility: Visibility,
    kind: Kind,
    place: Place,
    *,
    ratios: tuple[float, float],
) -> tuple[Effect, dict[str, Any]] | None:
    """Draw an effect at a place, with its size; None if it cannot be seen there.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that is random.
    visibility : Visibility
        The run on which it is just visible.
    kind, place : Kind, Place
        What it is, and where.
    ratios : tuple of float
        Smallest and largest size over the one that is just visible.

    Returns
    -------
    tuple or None
        The effect; and its size, the size that is just visible, and their ratio.
    """
    figures = visibility.arm.figures
    drawn = kind.draw(rng, figures, place)
    visible = visible_size(visibility, kind, place, drawn)
    factor = log_uniform(rng, *ratios)
    if visible is None:
        return None
    least, largest = kind.bounds(figures, place)
    size = min(visible * factor, largest)
    parameters = kind.size(size, drawn, figures, place)
    return Effect(kind=kind.name, place=place, parameters=parameters), {
        "size": size,
        "visible": visible,
        "ratio": size / visible,
        # seen at every size that is real: the smallest of those stands for just visible
        "least_real": visible <= least * PRECISION,
    }
