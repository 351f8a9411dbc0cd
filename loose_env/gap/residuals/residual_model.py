"""Residuals of runs in noise standard deviations (ResidualModel); run and channel of each row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.progress import tick
from loose_env.gap.residuals.random_excitation.features import GROUP, RandomFeatures, RandomRun
from loose_env.gap.simulation.inverse_dynamics import InverseDynamics
from loose_env.gap.simulation.simulator import Simulator
from loose_env.typing import Array

_MAX_INTEGRATOR_ERROR = 100.0
"""Error of a cheaper integrator above which its differences are not taken [noise standard
deviations], where it is larger than what is to be explained."""
DIVERGED_RESIDUAL = 1e4
"""Residual where a simulation diverged, and the largest that counts [noise standard deviations]."""
_PREDICTED_AT_ONCE = 4_000_000
"""Numbers of predictions that are held at a time: 32 MB, and their sensors as much."""
_FEWEST_AT_ONCE = 16
"""Hypotheses that are predicted together at least: they share simulations."""
_RUNGE_KUTTA = int(mujoco.mjtIntegrator.mjINT_RK4)
_IMPLICIT = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
BURN_IN = 0.1
"""What an unknown start may disturb, at the beginning of a run [s]."""
BLOCKS = 100
"""Number of blocks that the runs are cut into; residuals may be autocorrelated within a block."""
SHORTEST, LONGEST = 0.1, 0.5
"""Lengths of a block, however short or long the runs are [s]."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Run, channel and sample of each number of a residual vector (N,)."""

    trial: NDArray[np.intp]
    """Index of the run."""
    channel: NDArray[np.intp]
    """Index of the channel."""
    sample: NDArray[np.intp]
    """Sample in the run."""
    index: NDArray[np.intp]
    """Index of the sample among those compared: neighbours differ by one."""
    block: NDArray[np.intp]
    """Block of time, or of features, numbered through all runs."""
    is_feature: NDArray[np.bool_]
    """Whether it is a feature: independent of the others, of unit variance if the model is right.
    Its channel is one of those that it is made of, its sample stands for none."""
    random_excitation: NDArray[np.bool_]
    """Whether the run is one of random excitation."""
    inverse: NDArray[np.bool_]
    """Whether the run is compared by inverse dynamics."""


class ResidualModel:
    """Compares runs with hypotheses, each run by its form.

    Forward and free runs are simulated, and their sensors compared. Inverse runs are compared by
    their torques, in the band of the motion; chaotic random runs by features.
    """

    def __init__(
        self,
        machine: NominalModel,
        trials: Sequence[Trial],
        channels: tuple[Channel, ...],
        floors: Array,
        *,
        threads: int = 0,
        inverse: InverseDynamics | None = None,
        chaotic: frozenset[str] = frozenset(),
        read: Array | None = None,
    ) -> None:
        self.machine, self.trials = machine, list(trials)
        self.runs = np.arange(len(self.trials))
        """Indices of the runs in the initial states of hypotheses; -1 for one that begins later."""
        self.channels, self.floors, self.threads = channels, floors, threads
        self._cheaper: dict[int, ResidualModel] = {}
        self._beginnings: dict[tuple[tuple[int, ...], float], ResidualModel] = {}
        backwards = [t for t, trial in enumerate(self.trials) if trial.form == "inverse"]
        self._backwards = np.array(backwards, dtype=np.intp)
        self._ahead = np.setdiff1d(np.arange(len(self.trials)), self._backwards)
        forwards = [self.trials[t] for t in self._ahead]
        self.simulator = Simulator(machine, forwards, channels, threads=threads)
        if inverse is None and backwards:
            runs = [self.trials[t] for t in backwards]
            inverse = InverseDynamics(machine, runs, channels, threads=threads)
        self.inverse = inverse
        self.scales = np.repeat(np.asarray(floors, dtype=float)[None], len(self.trials), axis=0)
        """Noise standard deviation of what is compared (trials, C)."""
        if inverse is not None:
            for k, t in enumerate(backwards):
                self.scales[t] = inverse.floors(k)
        self.chaotic = chaotic
        self.read = np.asarray(floors if read is None else read, dtype=float)
        self._random = {
            t: RandomRun.of_trial(trial, machine, channels, self.read)
            for t, trial in enumerate(self.trials)
            if trial.excited and trial.name in chaotic
        }
        self.rows, self.measured = self._rows()

    @property
    def features(self) -> dict[int, RandomFeatures]:
        """Features of the runs that are compared by features, by index of the run."""
        return {t: run.features for t, run in self._random.items()}

    def _spacing(self, number: int) -> int:
        """Spacing of the compared samples of a run."""
        if self.inverse is not None and number in self._backwards:
            return self.inverse.spacing(int(np.searchsorted(self._backwards, number)))
        return 1

    def _compared(self, number: int) -> Array:
        """Measured values of a run, NaN where they are not compared (T, C)."""
        trial = self.trials[number]
        if self.inverse is not None and number in self._backwards:
            return self.inverse.measured(int(np.searchsorted(self._backwards, number)))
        early = trial.time < min(BURN_IN, 0.2 * trial.time[-1])
        return np.where(early[:, None], np.nan, trial.measured)

    def _rows(self) -> tuple[Rows, Array]:
        """Rows of all measured numbers outside the initial transient."""
        parts: list[list[Array]] = [[], [], [], [], [], [], []]
        blocks = 0
        whole = sum(float(trial.time[-1]) for trial in self.trials)
        length = min(max(whole / BLOCKS, SHORTEST), LONGEST)
        for t, trial in enumerate(self.trials):
            if t in self._random:
                channels = self._random[t].channel
                index = np.arange(len(channels))
                samples = index * (len(trial.time) - 1) // len(channels)
                block = blocks + index // GROUP
                values = np.zeros(len(channels))
            else:
                compared = self._compared(t)
                samples, channels = np.nonzero(np.isfinite(compared))
                index = samples // self._spacing(t)
                block = blocks + (trial.time[samples] // length).astype(int)
                values = compared[samples, channels] / self.scales[t, channels]
            blocks = int(block.max()) + 1 if len(block) else blocks
            run, is_feature = np.full(len(samples), t), np.full(len(samples), t in self._random)
            found = (run, channels, samples, index, block, is_feature, values)
            for part, new in zip(parts, found, strict=True):
                part.append(new)
        *where, measured = (np.concatenate(part) for part in parts)
        runs, channel, sample, indices, block, is_feature = (part.astype(np.intp) for part in where)
        excited = np.array([bool(trial.excited) for trial in self.trials])
        rows = Rows(
            trial=runs, channel=channel, sample=sample, index=indices, block=block,
            is_feature=is_feature.astype(bool), random_excitation=excited[runs],
            inverse=np.isin(runs, self._backwards),
        )  # fmt: skip
        return rows, measured

    def follows(self, trial: Trial) -> bool:
        """Return whether a run is simulated with its commands, sample by sample."""
        return trial.form == "forward" and trial.name not in self.chaotic

    def shows(self, effect: Effect) -> bool:
        """Return whether an effect is observable in the form of any run.

        A free response has no commands; `InverseDynamics` defines the omissions of an inverse run.
        """
        forms = {self.trials[t].form for t in self._ahead}
        if "forward" in forms:
            return True
        if "free" in forms and not effect.drives:
            return True
        return self.inverse is not None and self.inverse.shows(effect)

    def like(
        self,
        *,
        machine: NominalModel | None = None,
        trials: Sequence[Trial] | None = None,
        floors: Array | None = None,
        inverse: InverseDynamics | None = None,
    ) -> ResidualModel:
        """Copy with another machine, runs, noise of the channels (C,), or inverse dynamics.

        Features of random runs keep the sensor noise as their weight.
        """
        found = ResidualModel(
            machine or self.machine,
            self.trials if trials is None else trials,
            self.channels,
            self.floors if floors is None else floors,
            threads=self.threads,
            inverse=inverse or (self.inverse if trials is None else None),
            chaotic=self.chaotic,
            read=self.read,
        )
        if trials is None:
            found.runs = self.runs
        return found

    def run_with_largest_residual(self, residual: Array) -> NDArray[np.bool_] | None:
        """Mask of the rows (N,) of the run with the largest residual, a simulated one if any is.

        None where there are no two.
        """
        among = self._ahead if len(self._ahead) else np.arange(len(self.trials))
        if len(among) < 2:
            return None
        squares = np.bincount(self.rows.trial, residual**2, minlength=len(self.trials))
        return np.asarray(self.rows.trial == among[int(np.argmax(squares[among]))])

    def of_run(self, rows: NDArray[np.bool_]) -> ResidualModel:
        """Copy with the only run that some rows belong to."""
        number = int(self.rows.trial[rows][0])
        found = self.like(trials=[self.trials[number]])
        found.runs = self.runs[[number]]
        return found

    def beginnings(self, numbers: tuple[int, ...], seconds: float) -> ResidualModel:
        """Copy with the beginnings [s] of some runs; of a run compared by features all of it."""
        key = numbers, seconds
        if key not in self._beginnings:
            own = [(t, self.trials[t]) for t in numbers]
            part = self.like(trials=[r if t in self._random else r.until(seconds) for t, r in own])
            part.runs = self.runs[list(numbers)]
            self._beginnings[key] = part
        return self._beginnings[key]

    def channel_rms(self, residual: Array) -> Array:
        """Root mean square of a residual (N,) by channel (C,), noise standard deviations.

        Of the runs compared sample by sample; 0 where a channel has no such readings.
        """
        own = ~(self.rows.is_feature | self.rows.inverse)
        channel, most = self.rows.channel[own], len(self.channels)
        count = np.bincount(channel, minlength=most)
        squares = np.bincount(channel, residual[own] ** 2, minlength=most)
        return np.asarray(np.sqrt(squares / np.maximum(count, 1)))

    def with_cheaper_integrator(self, *, stiff: bool = False) -> ResidualModel:
        """Copy with a cheaper integrator: one evaluation a step instead of four.

        The difference that an effect makes is nearly the same, since the step error is in both.
        Inverse runs take longer steps where there are unmeasured degrees of freedom.
        """
        cheaper = self.machine.integrator == _RUNGE_KUTTA
        if self.inverse is None and not cheaper:
            return self
        joined = 1 if stiff or not cheaper else self.machine.merged_steps
        if joined not in self._cheaper:
            machine = self.machine
            if cheaper:
                machine = replace(
                    machine, integrator=_IMPLICIT, merged_steps=joined, uniform_steps=True
                )
            inverse = self.inverse and self.inverse.with_longer_steps()
            self._cheaper[joined] = self.like(machine=machine, inverse=inverse)
        return self._cheaper[joined]

    def cheaper_residual(
        self,
        hypothesis: Hypothesis,
        residual: Array,
        *,
        stiff: bool = False,
        springs: bool = False,
    ) -> tuple[ResidualModel, Array]:
        """Cheaper comparison, with the residual of a hypothesis in it (N,).

        Where the cheaper integrator is not stable, or would shift the modes of springs that are
        added to simulated runs, that is this comparison with the given residual.
        """
        if springs and not self.rows.inverse.all():
            return self, residual
        cheaper = self.with_cheaper_integrator(stiff=stiff)
        if cheaper is self:
            return self, residual
        found = np.asarray(cheaper.residuals([hypothesis])[0])
        off = float(np.mean((found - residual) ** 2))
        astray = off > max(_MAX_INTEGRATOR_ERROR**2, float(np.mean(residual**2)))
        return (self, residual) if astray else (cheaper, found)

    def __len__(self) -> int:
        """Number of residuals."""
        return len(self.measured)

    @property
    def simulated(self) -> int:
        """Number of simulated steps and evaluated samples so far."""
        own = self.simulator.simulated + (0 if self.inverse is None else self.inverse.simulated)
        return own + sum(part.simulated for part in self._beginnings.values())

    def predict(self, hypotheses: Sequence[Hypothesis]) -> list[list[Array]]:
        """Predict the readings of every run under every hypothesis."""
        found: list[list[Array]] = [[np.empty(0)] * len(self.trials) for _ in hypotheses]
        if len(self._ahead):
            own = [hypothesis.for_runs(self.runs[self._ahead]) for hypothesis in hypotheses]
            for predictions, runs in zip(found, self.simulator.predict(own), strict=True):
                for t, values in zip(self._ahead, runs, strict=True):
                    predictions[t] = values
        if self.inverse is not None:
            for predictions, runs in zip(found, self.inverse.predict(hypotheses), strict=True):
                for t, values in zip(self._backwards, runs, strict=True):
                    predictions[t] = values
        return found

    def residuals(self, hypotheses: Sequence[Hypothesis]) -> Array:
        """Measured less predicted, in noise standard deviations (hypotheses, N)."""
        found = np.empty((len(hypotheses), len(self.measured)))
        # Predictions are many times as large as their residuals, which are kept.
        each = sum(t.measured.size for t in self.trials) + len(self.machine.joints)
        size = max(_FEWEST_AT_ONCE, _PREDICTED_AT_ONCE // each)
        for first in range(0, len(hypotheses), size):
            for h, predicted in enumerate(self.predict(hypotheses[first : first + size]), first):
                found[h] = self.measured - self.flatten(predicted)
            tick()
        found[~np.isfinite(found)] = DIVERGED_RESIDUAL
        return np.clip(found, -DIVERGED_RESIDUAL, DIVERGED_RESIDUAL, out=found)

    def levels(self, hypothesis: Hypothesis) -> Array:
        """Noise under a hypothesis, relative to that of the rigid arm (N,).

        1 except in inverse runs, where a spring attenuates noise of the motion
        (`loose_env.gap.simulation.inverse_dynamics.InverseDynamics.levels`).
        """
        found = np.ones(len(self.measured))
        if self.inverse is None or not any(effect.adds_motion for effect in hypothesis.effects):
            return found
        for t, level in zip(self._backwards, self.inverse.levels(hypothesis), strict=True):
            own = self.rows.trial == t
            found[own] = level[self.rows.channel[own]]
        return found

    def flatten(self, predicted: Sequence[Array]) -> Array:
        """Convert predictions by trial to one number per row, in noise deviations (N,)."""
        rows, found = self.rows, np.empty(len(self.measured))
        for t, values in enumerate(predicted):
            own = rows.trial == t
            if t in self._random:  # measured features are the origin, so they count as zero
                found[own] = -self._random[t].residual(values)
                continue
            channel = rows.channel[own]
            found[own] = values[rows.sample[own], channel] / self.scales[t, channel]
        return found

    def by_block(self, values: Array) -> Array:
        """Sum values (..., N) over blocks (..., B)."""
        count = int(self.rows.block.max()) + 1
        flat = values.reshape(-1, values.shape[-1])
        summed = np.array([np.bincount(self.rows.block, v, minlength=count) for v in flat])
        return summed.reshape(*values.shape[:-1], count)
