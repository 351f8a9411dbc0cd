"""Signatures: change of the residual by each candidate effect at each of its starting values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.fitting.gauss_newton import Fit, started
from loose_env.gap.fitting.refit import with_new_jacobian
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.residuals.progress import counted
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.confusable_effects import joint_of
from loose_env.gap.simulation.sensor_timing import changes_within
from loose_env.typing import Array

_GROUP = 24
"""Hypotheses simulated at a time."""
_CHANGED = 0.03
"""Mean square change of the sensitivities over their mean square, up to which signatures hold."""
_KEPT = 250_000_000
"""Memory for signatures that are kept [bytes]."""
Start = tuple[float, ...]


class Signatures:
    """Signatures of effects about a fit, each a difference of two residuals.

    Both residuals are of the same time steps and integrator: the difference of two methods of
    integration is no signature.

    What has been found so far often changes the motion by little beside the motion itself. The
    signatures about the nominal model then hold on, but for effects at the joints of those that
    were found; they are simulated once. Where torque is compared with motion, torques add up, and
    those of springs, which take thirty times as long as the others, always hold.
    """

    def __init__(self, nominal: Fit | None = None) -> None:
        self.nominal = nominal
        self._kept: dict[object, NDArray[np.float32]] = {}
        self._room = _KEPT
        self._sensitivities: Array | None = None
        self._holds: Callable[[Effect], bool] = _never

    def about(self, comparison: ResidualModel, fitted: Fit) -> None:
        """Decide for a fit which signatures about the nominal model still hold.

        The sensitivities of the nominal parameters tell: they are known for both.
        """
        nominal, self._holds = self.nominal, _never
        if nominal is None:
            return
        if comparison.rows.inverse.all():
            self._holds = _adds_motion
            return
        count = len(nominal.free)
        if self._sensitivities is None:
            first = fitted.jacobian
            if not np.array_equal(nominal.free, fitted.free):
                residual = comparison.residuals([nominal.hypothesis])[0]
                first = with_new_jacobian(replace(nominal, residual=residual), comparison).jacobian
            self._sensitivities = first[:, :count].astype(np.float32)
        first = self._sensitivities
        sizes = np.sum(first.astype(float) ** 2, axis=0)
        changes = np.sum((fitted.jacobian[:, :count] - first) ** 2, axis=0)[sizes > 0]
        if not len(changes) or np.mean(changes / sizes[sizes > 0]) > _CHANGED:
            return
        joints = {joint_of(effect) for effect in fitted.effects}
        self._holds = lambda effect: joint_of(effect) not in joints

    def of(
        self,
        compared: ResidualModel,
        fitted: Fit,
        entries: Sequence[tuple[Effect, Start]],
        base: Array,
    ) -> Iterator[tuple[Effect, Start, Array]]:
        """Change of the residual (N,) with each start of each candidate, one by one."""
        holding = [each for each in entries if self._holds(each[0])]
        yield from _signatures(
            compared, fitted, [each for each in entries if not self._holds(each[0])], base
        )
        if not holding or self.nominal is None:
            return
        steps = tuple((trial.name, trial.step) for trial in compared.trials)
        keys = [(steps, len(compared), effect.key, start) for effect, start in holding]
        unknown = [n for n, key in enumerate(keys) if key not in self._kept]
        for n, key in enumerate(keys):
            if key in self._kept:
                yield (*holding[n], self._kept[key].astype(float))
        if not unknown:
            return
        rigid = np.asarray(compared.residuals([self.nominal.hypothesis])[0])
        found = _signatures(compared, self.nominal, [holding[n] for n in unknown], rigid)
        for n, (effect, start, signature) in zip(unknown, found, strict=True):
            short = signature.astype(np.float32)
            if short.nbytes <= self._room:
                self._room -= short.nbytes
                self._kept[keys[n]] = short
            yield effect, start, short.astype(float)

    def reference(self, compared: ResidualModel, fitted: Fit) -> Array:
        """Residual (N,) of the nominal model where there is one, else of a fit."""
        if self.nominal is None:
            return fitted.residual
        return np.asarray(compared.residuals([self.nominal.hypothesis])[0])


def _never(effect: Effect) -> bool:
    return False


def _adds_motion(effect: Effect) -> bool:
    return effect.adds_motion


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
    fine = not machine.uniform_steps and any(
        effect.needs_fine_steps for effect in hypothesis.stepping
    )
    return fine, changes_within(machine, hypothesis, compared.channels)
