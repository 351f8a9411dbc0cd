"""Signatures: the change of the residual with an effect at one of its starts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.fitting.gauss_newton import Fit, started
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.residuals.progress import counted
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.simulation.sensor_timing import changes_within
from loose_env.typing import Array

__all__ = ["Signatures"]


_GROUP = 24
"""Hypotheses simulated at a time."""
Start = tuple[float, ...]


class Signatures:
    """Signatures of effects about a fit, each a difference of two residuals.

    Both residuals are of the same time steps and integrator: the difference of two methods of
    integration is no signature.

    Where torque is compared with motion, torques add up: what a spring changes hardly depends on
    the frictions found so far, and a spring takes thirty times as long as they do. Its signatures
    are taken about the nominal model there, once.

    Parameters
    ----------
    nominal : Fit, optional
        The nominal model; without it, all signatures are taken about the current fit.
    """

    def __init__(self, nominal: Fit | None = None) -> None:
        self.nominal = nominal
        self._kept: dict[object, NDArray[np.float32]] = {}

    def of(
        self,
        compared: ResidualModel,
        fitted: Fit,
        entries: Sequence[tuple[Effect, Start]],
        base: Array,
    ) -> Iterator[tuple[Effect, Start, Array]]:
        """Change of the residual (N,) with each start of each candidate, one by one.

        Parameters
        ----------
        compared : ResidualModel
            Comparison used for the simulations.
        fitted : Fit
            Fit that they are added to.
        entries : sequence of (Effect, values)
            The starts.
        base : ndarray (N,)
            Residual of `fitted` in that comparison. A candidate that needs other time steps is
            compared with `fitted` on those.
        """
        nominal = self.nominal
        if nominal is None or not compared.rows.inverse.all():
            yield from _signatures(compared, fitted, entries, base)
            return
        runs = (*(trial.name for trial in compared.trials), len(compared))
        springs = [each for each in entries if each[0].adds_motion]
        yield from _signatures(
            compared, fitted, [each for each in entries if not each[0].adds_motion], base
        )
        unknown = [each for each in springs if (runs, each[0].key, each[1]) not in self._kept]
        if unknown:
            rigid = np.asarray(compared.residuals([nominal.hypothesis])[0])
            for effect, start, signature in _signatures(compared, nominal, unknown, rigid):
                self._kept[runs, effect.key, start] = signature.astype(np.float32)
        for effect, start in springs:
            yield effect, start, self._kept[runs, effect.key, start].astype(float)

    def reference(self, compared: ResidualModel, fitted: Fit) -> Array:
        """Residual (N,) of the fit about which the signatures of springs are taken."""
        if self.nominal is None or not compared.rows.inverse.all():
            return fitted.residual
        return np.asarray(compared.residuals([self.nominal.hypothesis])[0])


def _signatures(
    compared: ResidualModel, fitted: Fit, entries: Sequence[tuple[Effect, Start]], base: Array
) -> Iterator[tuple[Effect, Start, Array]]:
    """Signatures about a fit, simulated."""
    own = _steps(compared, fitted.hypothesis)
    references = {own: base}
    for begin in counted("screening, in batches", range(0, len(entries), _GROUP)):
        group = entries[begin : begin + _GROUP]
        tried = [
            fitted.structure.plus(effect).hypothesis(started(fitted, effect, start))
            for effect, start in group
        ]
        for (effect, start), residual in zip(group, compared.residuals(tried), strict=True):
            plain = replace(fitted.hypothesis, stepped_as=(effect,))
            steps = _steps(compared, plain)
            if steps not in references:
                references[steps] = compared.residuals([plain])[0]
            yield effect, start, residual - references[steps]


def _steps(compared: ResidualModel, hypothesis: Hypothesis) -> tuple[bool, bool]:
    """Whether a hypothesis is simulated with finer steps, and with steps in parts."""
    machine = compared.machine
    fine = not machine.uniform_steps and any(effect.sharp for effect in hypothesis.stepping)
    return fine, changes_within(machine, hypothesis, compared.channels)
