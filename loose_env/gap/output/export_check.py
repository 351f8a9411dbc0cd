"""Exported model simulated in plain MuJoCo and compared with the fit; choice of its time step.

Fits apply delayed commands by their means over steps, and compute readings at their exact times.
The file uses the delays and filters of MJCF, which act from step to step: a delay shorter than a
step is inaccurate, and a filter that is much shorter makes a Runge-Kutta method diverge. Finer
steps resolve that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, nan

import mujoco
import numpy as np

from loose_env.arms import quiet
from loose_env.gap.data.aligned_run import Trial
from loose_env.gap.data.initial_rest import SETTLE
from loose_env.gap.model.effect import have_stops
from loose_env.gap.model.hypothesis import Hypothesis, compiled
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.corrected_model import corrected_spec
from loose_env.gap.residuals.physical_units import rms
from loose_env.gap.residuals.residual_model import DIVERGED_RESIDUAL, ResidualModel
from loose_env.gap.settings import (
    EXPORT_ERROR,
    EXPORT_ERROR_SHARE,
)
from loose_env.gap.simulation.time_step import step_with
from loose_env.typing import Array

PARTS = (1, 2, 4, 8)
"""Into how many parts a step is cut."""
_BETTER = 0.5
"""Distance over that of the step as it was, below which a finer one that will not do is taken."""
_PLAYED = 15.0
"""How much of the held-out runs is simulated [s]."""
_AS_LONG = 1.02
"""Step over that on which a run was laid out, up to which it is the same."""
_SHORTEST = 1.0
"""What is simulated of a run, at least [s]; of many runs some are taken."""
_GONE_WILD = tuple(
    int(kind)
    for kind in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
)


@dataclass(frozen=True, kw_only=True)
class Exported:
    """Export form of a corrected model, with the accuracy of its file."""

    parts: int = 1
    """Number of substeps per step."""
    step: float | None = None
    """Time step of the file [s]; None: as chosen in the comparison."""
    left: float = nan
    """Residual of the file on the held-out runs in plain MuJoCo [RMS, noise standard
    deviations]; NaN where it cannot be simulated: no run begins at rest and is simulated with
    its commands, or an effect is not available in MJCF."""
    fitted: float = nan
    """Residual of the fit on the same samples."""
    apart: float = 0.0
    """Deviation of the file from the fit, in the most affected channel [noise standard
    deviations]."""
    channel: str = ""
    """The most affected channel."""
    matters: bool = False
    """Whether the deviation is too large."""

    def notes(self) -> list[str]:
        """Notes for the reader."""
        found = []
        if self.parts > 1:
            found.append(
                f"model.xml has a time step of {self.step:.3g} s: the added effects need a finer "
                "one than the nominal model"
            )
        if self.matters:
            found.append(
                f"model.xml in plain MuJoCo deviates from the fit by {self.apart:.2g} noise "
                f"standard deviations in {self.channel}: its residual on the held-out runs is "
                f"{self.left:.3g}, that of the fit {self.fitted:.3g}"
            )
        return found


def exported(held: ResidualModel, hypothesis: Hypothesis, residual: Array) -> Exported:
    """Choose the step of the exported model, by simulating it in plain MuJoCo.

    Parameters
    ----------
    held : ResidualModel
        The held-out runs.
    hypothesis : Hypothesis
        Nominal parameters and effects of the fit.
    residual : ndarray (N,)
        Its residual on these runs, in noise standard deviations.

    Returns
    -------
    Exported
        Export with the fewest substeps that suffice, or the most accurate ones.
    """
    trials = _shown(held)
    if not trials or not all(effect.in_model for effect in hypothesis.effects):
        return Exported()
    own = step_with(held.machine, hypothesis.effects)
    shortest = min(trial.step for trial in trials.values())
    longest = own if own < _AS_LONG * shortest else shortest
    found: list[tuple[float, Exported]] = []
    for parts in PARTS:
        step = longest / parts
        spec = corrected_spec(held.machine, hypothesis, step=step)
        tried = compared(held, residual, compiled(spec), trials)
        if tried is None:
            return Exported()
        off, shown = tried
        found.append((off, replace(shown, parts=parts, step=step, matters=off > 1.0)))
        if off <= 1.0:
            break
    nearest = min(found, key=lambda each: each[0])
    chosen = nearest if nearest[0] < max(1.0, _BETTER * found[0][0]) else found[0]
    if have_stops(hypothesis.effects):
        # after an impact no two simulations agree, however fine their steps
        return replace(chosen[1], matters=False)
    return chosen[1]


def resting_runs(held: ResidualModel) -> dict[int, Trial]:
    """Select runs that an exported file can be checked with, by index.

    They begin at rest, and are simulated with their commands and compared sample by sample.
    """
    return {t: run for t, run in enumerate(held.trials) if held.follows(run) and run.resting}


def _shown(held: ResidualModel) -> dict[int, Trial]:
    """Beginnings of these runs; of some if there are many."""
    runs = resting_runs(held)
    count = min(len(runs), int(_PLAYED / _SHORTEST))
    taken = np.unique(np.linspace(0, len(runs) - 1, count).round().astype(int))
    numbers = list(runs)
    return {numbers[k]: runs[numbers[k]].until(_PLAYED / count) for k in taken.tolist()}


def compared(
    held: ResidualModel, residual: Array, model: mujoco.MjModel, trials: dict[int, Trial]
) -> tuple[float, Exported] | None:
    """Compare a model, simulated by MuJoCo alone, with a fit.

    Parameters
    ----------
    held : ResidualModel
        The held-out runs.
    residual : ndarray (N,)
        Residual of the fit on them, in noise standard deviations.
    model : MjModel
        The corrected model.
    trials : dict
        Number -> run, or the beginning of it, for those that are played.

    Returns
    -------
    (float, Exported) or None
        Deviation from the fit over its tolerance, and the residuals of both; None where
        nothing was read.
    """
    rows, read = held.rows, np.array([c.column.startswith("sensor.") for c in held.channels])
    left, fitted = [np.zeros(0)], [np.zeros(0)]
    channels = [np.zeros(0, dtype=np.intp)]
    for t, trial in trials.items():
        chosen = (rows.trial == t) & (rows.sample < len(trial.time)) & read[rows.channel]
        own = np.flatnonzero(chosen)
        sample, channel = rows.sample[own], rows.channel[own]
        with quiet():  # a step that is too long may diverge
            shown = played(held, model, trial)[sample, channel]
        off = (trial.measured[sample, channel] - shown) / held.scales[t, channel]
        left.append(
            np.clip(
                np.nan_to_num(off, nan=DIVERGED_RESIDUAL), -DIVERGED_RESIDUAL, DIVERGED_RESIDUAL
            )
        )
        fitted.append(residual[own])
        channels.append(channel)
    by_file, by_fit = np.concatenate(left), np.concatenate(fitted)
    channel = np.concatenate(channels)
    if not len(channel):
        return None
    count = np.maximum(np.bincount(channel), 1)
    apart, left_by = (
        np.sqrt(np.bincount(channel, part**2) / count) for part in (by_file - by_fit, by_fit)
    )
    allowed = np.maximum(EXPORT_ERROR, EXPORT_ERROR_SHARE * left_by)
    worst = int(np.argmax(apart / allowed))
    return float(apart[worst] / allowed[worst]), Exported(
        left=rms(by_file),
        fitted=rms(by_fit),
        apart=float(apart[worst]),
        channel=held.channels[worst].name,
    )


def played(comparison: ResidualModel, model: mujoco.MjModel, trial: Trial) -> Array:
    """Simulate a run's commands in plain MuJoCo, as channel values (T, C)."""
    machine, own = comparison.machine, float(model.opt.timestep)
    inside = max(1, ceil(trial.step / own - 1e-6))
    model.opt.timestep = trial.step / inside
    data = mujoco.MjData(model)
    driven = np.arange(len(machine.actuators))  # effects add none
    for name, angle in zip(machine.joints, trial.position, strict=True):
        data.joint(name).qpos[0] = angle
    data.ctrl[driven] = trial.controls[0]
    _begin_with(model, data, machine)
    mujoco.mj_step(model, data, round(SETTLE / model.opt.timestep))
    readings = np.full((trial.steps, model.nsensordata), np.nan)
    for row, command in zip(readings, trial.controls, strict=True):
        data.ctrl[driven] = command
        # sensors show the beginning of a step; delayed ones keep a history that only steps may
        # extend
        mujoco.mj_step(model, data)
        if any(data.warning[kind].number for kind in _GONE_WILD):
            break
        row[:] = data.sensordata
        mujoco.mj_step(model, data, inside - 1)
    model.opt.timestep = own
    shown = trial.at_samples(readings)
    found = np.full((len(trial.time), len(comparison.channels)), np.nan)
    for c, channel in enumerate(comparison.channels):
        prefix, _, name = channel.column.partition(".")
        if prefix == "sensor":
            found[:, c] = shown[:, int(model.sensor(name).adr[0]) + (channel.axis or 0)]
    return found


def _begin_with(model: mujoco.MjModel, data: mujoco.MjData, machine: NominalModel) -> None:
    """Initialise added actuator states with the first command, as fits do.

    MuJoCo initialises them with zeros: the arm would swing there before the first command.
    """
    nominal = machine.model
    for k in range(len(machine.actuators)):
        first = float(data.ctrl[k])
        if model.actuator_ctrllimited[k]:
            first = float(np.clip(first, *model.actuator_ctrlrange[k]))
        if model.actuator_dyntype[k] != nominal.actuator_dyntype[k]:
            data.act[model.actuator_actadr[k]] = first
        if model.actuator_delay[k] > 0 and nominal.actuator_delay[k] == 0:
            samples = int(model.actuator_history[k, 0])
            mujoco.mj_initCtrlHistory(model, data, k, None, np.full((samples, 1), first))
