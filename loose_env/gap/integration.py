"""How finely a model has to be stepped so that the step is no gap of its own.

A model that is stepped semi-implicitly is late by half a step, which encoders see. A Runge-Kutta
method of fourth order is exact enough at the sample interval for most arms. Which step will do is
measured: the nominal model is simulated at a step and at a quarter of it, and the difference is
held against the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.gap.comparison import Comparison
from loose_env.gap.machine import Machine
from loose_env.gap.noise import channel_floor
from loose_env.gap.simulator import Hypothesis
from loose_env.gap.trial import Channel, lay_out
from loose_env.recording import Run

__all__ = ["Integration", "choose_integration"]

_ENOUGH = 0.1
"""Step error that is no matter, in noise standard deviations."""
_OWN = 0.3
"""Error up to which the model's own step and integrator are kept, where they are cheaper."""
_SHORT = 2.0
"""How much of the run the error is measured on [s]."""
_FINEST = 16
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)


@dataclass(frozen=True, kw_only=True)
class Integration:
    """A step and an integrator, with what they cost in exactness."""

    step: float
    """Longest step [s]."""
    integrator: int
    """One of `mujoco.mjtIntegrator`."""
    error: float
    """Step error of the worst channel, in noise standard deviations."""
    nominal_error: float
    """That of the model's own step and integrator."""


def choose_integration(
    machine: Machine, runs: Sequence[Run], channels: tuple[Channel, ...], *, threads: int = 1
) -> Integration:
    """Measure the step error on the first run that has commands, and choose a step."""
    run = _beginning(next((r for r in runs if r.comparison == "forward"), runs[0]))
    interval = float(np.median(np.diff(run.time)))
    own = float(machine.model.opt.timestep)
    longest = min(interval, 4 * own) if interval > 4 * own else interval
    floors = np.array([channel_floor(_column(run, c)) for c in channels])
    floors = np.where(np.isfinite(floors), floors, np.inf)

    def residual(step: float, integrator: int) -> np.ndarray:
        stepped = Machine(machine.spec, step=step, integrator=integrator)
        trial = lay_out(run, stepped, channels, step=step)
        comparison = Comparison(stepped, [trial], channels, floors, threads=threads)
        found = comparison.residuals([Hypothesis(effects=(), values=())])[0]
        return np.asarray(found)

    rows = Comparison(machine, [lay_out(run, machine, channels, step=own)], channels, floors).rows

    def worst(difference: np.ndarray) -> float:
        squares = np.bincount(rows.channel, difference**2, minlength=len(channels))
        counts = np.maximum(np.bincount(rows.channel, minlength=len(channels)), 1)
        return float(np.sqrt(np.max(squares / counts)))

    finer = {k: residual(longest / k, _RK4) for k in (1, 4)}
    divided = 1
    while divided < _FINEST and worst(finer[divided] - finer[4 * divided]) > _ENOUGH:
        divided *= 2
        for k in (divided, 4 * divided):
            if k not in finer:
                finer[k] = residual(longest / k, _RK4)
    best = finer[4 * divided]
    nominal = residual(own, int(machine.model.opt.integrator))
    stages = 4 if int(machine.model.opt.integrator) == _RK4 else 1
    if worst(nominal - best) < _OWN and stages / own < 4 * divided / longest:
        return Integration(
            step=own,
            integrator=int(machine.model.opt.integrator),
            error=worst(nominal - best),
            nominal_error=worst(nominal - best),
        )
    return Integration(
        step=longest / divided,
        integrator=_RK4,
        error=worst(finer[divided] - best),
        nominal_error=worst(nominal - best),
    )


def _column(run: Run, channel: Channel) -> np.ndarray:
    """Values of a channel (T,); NaN where the run has none."""
    prefix, _, name = channel.column.partition(".")
    values = (run.sensors if prefix == "sensor" else run.torques).get(name)
    if values is None:
        return np.full(run.samples, np.nan)
    return np.asarray(values if channel.axis is None else values[:, channel.axis])


def _beginning(run: Run) -> Run:
    """First seconds of a run."""
    count = max(20, int(np.searchsorted(run.time - run.time[0], _SHORT)))
    return Run(
        name=run.name,
        time=run.time[:count],
        controls={k: v[:count] for k, v in run.controls.items()},
        sensors={k: v[:count] for k, v in run.sensors.items()},
        torques={k: v[:count] for k, v in run.torques.items()},
        excited=run.excited,
        pose=run.pose,
        condition=run.condition,
    )
