"""Choice of integrator and time step, so that step error is below sensor noise, with notes.

A semi-implicit integrator is late by half a step, which encoders resolve. A fourth-order
Runge-Kutta method is accurate enough at the sample interval for most arms. The step error is
measured: the nominal model is simulated at a step and at a quarter of it, and the difference is
compared with the noise, at the beginning of a run and in the fastest windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from loose_env.gap.data.aligned_run import Channel, align_run
from loose_env.gap.model.effect import have_stops
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.residuals.windows import windowed
from loose_env.gap.settings import (
    OWN_STEP_ERROR,
    STEP_ERROR,
)
from loose_env.gap.simulation.time_step import stepped
from loose_env.recording import Run
from loose_env.statistics import channel_floor

_POOR_FIT_RMS, _SHARE = 50.0, 0.5
"""How far the nominal model is off [noise standard deviations] where the noise is no measure any
more, and the share of that which is one in its place."""
_LEFT = 0.3
"""Share of what the corrected model leaves in a channel that counts as a noise where it is more."""
_SHORT = 2.0
"""How much of the first run the error is measured on, from its beginning [s]."""
_FASTEST, _RUNS = 0.75, 4
"""Length of the fastest window of a run [s], and of how many runs such windows are measured on."""
_SPEED = 0.02
"""Time between readings whose difference tells how fast a run is [s]."""
_CHECKED, _FINER = 15.0, 4
"""How much of the held-out runs the corrected model's step is checked on [s], and by how many times
finer steps."""
_FINEST = 16
_UNSEEN = 0.01
"""Error that cannot be seen in as many readings as a recording has [noise standard deviations]: up
to it hypotheses may take different steps."""
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)


@dataclass(frozen=True, kw_only=True)
class Integration:
    """A time step and an integrator, with their step errors."""

    step: float
    """Longest step [s]."""
    integrator: int
    """One of `mujoco.mjtIntegrator`."""
    error: float
    """Step error of the worst channel, in noise standard deviations."""
    nominal_error: float
    """Step error of the model's own step and integrator."""
    relative_error: float
    """As `error`; where the nominal model is off by more than 50 noise standard deviations, as a
    share of half of that: what is a hundred times off need not be simulated to the noise."""
    nominal_relative_error: float
    """Relative step error of the model's own step and integrator."""

    @property
    def merged_steps(self) -> int:
        """Number of steps that can be joined; a doubled Runge-Kutta step errs 16 times."""
        if self.integrator != _RK4:
            return 1
        return max(k for k in (1, 2, 4) if k == 1 or k**4 * self.relative_error < _UNSEEN)

    @property
    def substeps(self) -> int:
        """Number of substeps for stiff effects.

        None where the step error itself is visible: a finer step would explain that, too.
        """
        return 2 if self.integrator == _RK4 and self.relative_error < _UNSEEN else 1

    def notes(self, *, own: float) -> list[str]:
        """Notes on a changed step, and on one that is still too coarse."""
        found = []
        if (
            self.nominal_relative_error > OWN_STEP_ERROR
            and self.relative_error < self.nominal_relative_error
        ):
            found.append(
                f"the model's own step of {own:g} s is a model error by itself: "
                f"{self.nominal_error:.2g} noise standard deviations in the worst channel; runs "
                "were simulated by a "
                f"Runge-Kutta method at {self.step:.3g} s instead, and so is a corrected model"
            )
        if self.relative_error > OWN_STEP_ERROR:
            found.append(
                f"the step is still too coarse to judge by: at {self.step:.3g} s its error is "
                f"{self.error:.2g} noise standard deviations in the worst channel, and what is "
                "named may stand for it. Give the model a finer step, or soften what is stiffer "
                "than the recording can show"
            )
        return found


def choose_integration(
    machine: NominalModel, runs: Sequence[Run], channels: tuple[Channel, ...], *, threads: int = 1
) -> Integration:
    """Choose a step by the measured step error on parts of the runs.

    The parts are the beginning of the first run that has commands, and the fastest windows of the
    fastest runs.
    """
    parts = _parts(runs)
    interval = float(np.median(np.diff(parts[0].time)))
    own = float(machine.model.opt.timestep)
    longest = min(interval, 4 * own)
    floors = _floors(runs, channels)

    def laid_out(on: NominalModel, step: float) -> ResidualModel:
        trials = [align_run(part, on, channels, step=step) for part in parts]
        return ResidualModel(on, trials, channels, floors, threads=threads)

    def residual(step: float, integrator: int) -> np.ndarray:
        model = NominalModel(machine.spec, step=step, integrator=integrator)
        found = laid_out(model, step).residuals([Hypothesis(effects=(), values=())])[0]
        return np.asarray(found)

    rows = laid_out(machine, own).rows

    def by_channel(values: np.ndarray) -> np.ndarray:
        squares = np.bincount(rows.channel, values**2, minlength=len(channels))
        return np.sqrt(squares / np.maximum(np.bincount(rows.channel, minlength=len(channels)), 1))

    integrator = int(machine.model.opt.integrator)
    as_given = residual(own, integrator)
    off = float(np.sqrt(np.mean(as_given**2)))
    scale = _SHARE * off if off > _POOR_FIT_RMS else 1.0

    def worst(difference: np.ndarray) -> float:
        return float(np.max(by_channel(difference)) / scale)

    finer = {k: residual(longest / k, _RK4) for k in (1, 4)}
    divided = 1
    while divided < _FINEST and worst(finer[divided] - finer[4 * divided]) > STEP_ERROR:
        divided *= 2
        for k in (divided, 4 * divided):
            if k not in finer:
                finer[k] = residual(longest / k, _RK4)
    best = finer[4 * divided]
    given, chosen = as_given - best, finer[divided] - best
    stages = 4 if integrator == _RK4 else 1
    cheaper = stages / own < 4 * divided / longest
    step, kept = longest / divided, _RK4
    if (worst(given) < OWN_STEP_ERROR and cheaper) or worst(given) <= worst(chosen):
        step, kept, chosen = own, integrator, given
    return Integration(
        step=step,
        integrator=kept,
        error=float(np.max(by_channel(chosen))),
        nominal_error=float(np.max(by_channel(given))),
        relative_error=worst(chosen),
        nominal_relative_error=worst(given),
    )


def corrected_step_notes(held_out: ResidualModel, hypothesis: Hypothesis) -> list[str]:
    """Report whether the corrected model needs a finer step; none where it does not.

    An added effect may be stiffer than the nominal model by which the step was chosen. Runs that
    are compared by features or inverse dynamics are left out.
    """
    if have_stops(hypothesis.effects):
        return []  # after an impact no two simulations agree, however fine their steps
    machine, chosen = held_out.machine, windowed(held_out, _CHECKED)
    trials = [t for t in chosen.trials if t.form != "inverse" and t.name not in chosen.chaotic]
    if not trials:
        return []
    step = stepped(trials[0], machine, hypothesis.effects).step
    found = []
    for parts in (1, _FINER):
        finer = replace(machine, step=machine.step / parts)
        own = [trial.finer(parts) for trial in trials]
        compared = ResidualModel(finer, own, chosen.channels, chosen.floors, threads=chosen.threads)
        found.append(compared.residuals([hypothesis])[0])
    channel = compared.rows.channel
    counts = np.maximum(np.bincount(channel), 1)
    error, left = (
        np.sqrt(np.bincount(channel, values**2) / counts)
        for values in (found[0] - found[1], found[1])
    )
    worst = int(np.argmax(error / np.maximum(1.0, _LEFT * left)))
    if error[worst] <= OWN_STEP_ERROR * max(1.0, _LEFT * left[worst]):
        return []
    return [
        f"the corrected model needs a finer step than {step:.3g} s: its step error is "
        f"{error[worst]:.2g} noise standard deviations in {chosen.channels[worst].name}. Set a "
        "smaller timestep in the nominal model and run it again"
    ]


def _floors(runs: Sequence[Run], channels: tuple[Channel, ...]) -> np.ndarray:
    """Noise of each channel (C,), the median over runs; infinite if not known."""
    floors = np.full(len(channels), np.inf)
    for k, channel in enumerate(channels):
        found = [channel_floor(_column(run, channel)) for run in runs]
        known = [floor for floor in found if np.isfinite(floor)]
        if known:
            floors[k] = float(np.median(known))
    return floors


def _parts(runs: Sequence[Run]) -> list[Run]:
    """Select the parts of the runs that are simulated."""
    first = next((run for run in runs if run.comparison == "forward"), runs[0])
    fastest = sorted(
        ((*_fastest(run), run) for run in runs), key=lambda found: -found[0]
    )[:_RUNS]  # fmt: skip
    begins = max(20, int(np.searchsorted(first.time - first.time[0], _SHORT)))
    parts = [_between(first, 0, begins)]
    for _, begin, end, run in fastest:
        if run is not first or begin > begins // 2:
            parts.append(_between(run, begin, end))
    return parts


def _fastest(run: Run) -> tuple[float, int, int]:
    """Find the fastest window of a run: its speed, first sample and end.

    The speed is the change of the readings over a short time, relative to their noise.
    """
    interval = float(np.median(np.diff(run.time)))
    apart = max(1, round(_SPEED / interval))
    size = min(len(run.time), max(20, round(_FASTEST / interval)))
    speed = np.zeros(len(run.time))
    for values in run.sensors.values():
        for column in np.atleast_2d(values.T):
            floor = channel_floor(column)
            if np.isfinite(floor):
                change = np.nan_to_num(column[apart:] - column[:-apart]) / floor
                speed[apart:] += change**2
    summed = np.concatenate([[0.0], np.cumsum(speed)])
    windows = summed[size:] - summed[:-size]
    begin = int(np.argmax(windows))
    return float(windows[begin]) / size, begin, begin + size


def _column(run: Run, channel: Channel) -> np.ndarray:
    """Values of a channel (T,); NaN where the run has none."""
    prefix, _, name = channel.column.partition(".")
    values = (run.sensors if prefix == "sensor" else run.torques).get(name)
    if values is None:
        return np.full(run.samples, np.nan)
    return np.asarray(values if channel.axis is None else values[:, channel.axis])


def _between(run: Run, begin: int, end: int) -> Run:
    """Cut a range of samples from a run, as a run."""
    return replace(
        run,
        time=run.time[begin:end],
        controls={k: v[begin:end] for k, v in run.controls.items()},
        sensors={k: v[begin:end] for k, v in run.sensors.items()},
        torques={k: v[begin:end] for k, v in run.torques.items()},
    )
