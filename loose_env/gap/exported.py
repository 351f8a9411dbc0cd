"""Whether the corrected model's file does in plain MuJoCo what was fitted, and the step for that.

Fits move late commands by their means over steps, and work readings out at their moments. A file
has the delays and filters of MJCF, which act from step to step: one that is shorter than a step
comes out wrong, and a filter that is much shorter makes a Runge-Kutta method diverge. Finer steps
mend that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import nan

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from loose_env.gap.comparison import Comparison
from loose_env.gap.export import corrected_spec
from loose_env.gap.hypothesis import Hypothesis, compiled
from loose_env.gap.machine import Machine
from loose_env.gap.parting import STRIKING
from loose_env.gap.quantities import rms
from loose_env.gap.rest import SETTLE
from loose_env.gap.trial import Trial

__all__ = ["Exported", "exported", "played"]

Array = NDArray[np.float64]

PARTS = (1, 2, 4, 8)
"""Into how many parts a step is cut."""
_APART = 0.3
"""How far the file may be from the fit in a channel [noise standard deviations]."""
_OF_LEFT = 0.1
"""The same as a share of what the fit leaves there, where that is more."""
_BETTER = 0.5
"""Distance over that of the step as it was, from which on a finer one that does not do is taken."""
_PLAYED = 15.0
"""How much of the held-out runs is simulated [s]."""
_WILD = 1e4
"""Distance where a simulation went wild, and the largest that counts [standard deviations]."""


@dataclass(frozen=True, kw_only=True)
class Exported:
    """How a corrected model is written, and what its file does."""

    parts: int = 1
    """Into how many the step is cut."""
    step: float = nan
    """Step of the file [s]."""
    left: float = nan
    """What the file leaves of the held-out runs in plain MuJoCo [RMS, noise standard deviations];
    NaN where it cannot be tried: no run begins at rest and is simulated with its commands, or an
    effect is one that MJCF has not."""
    fitted: float = nan
    """What the fit leaves of the same numbers."""
    apart: float = 0.0
    """How far the file is from the fit, in the channel where that matters most [noise standard
    deviations]."""
    channel: str = ""
    """That channel."""
    matters: bool = False
    """Whether that is too far."""

    def words(self) -> list[str]:
        """What a reader should know."""
        found = []
        if self.parts > 1:
            found.append(
                f"the corrected model has a step of {self.step:.3g} s: what was added needs one "
                "that is finer than the nominal model's"
            )
        if self.matters:
            found.append(
                f"in plain MuJoCo the corrected model does not quite do what was fitted: in "
                f"{self.channel} it is {self.apart:.2g} noise standard deviations off, and leaves "
                f"{self.left:.3g} of the held-out runs where the fit leaves {self.fitted:.3g}"
            )
        return found


def exported(held: Comparison, hypothesis: Hypothesis, residual: Array) -> Exported:
    """Choose the step of a corrected model's file, by simulating it as a user would.

    Parameters
    ----------
    held : Comparison
        The held-out runs.
    hypothesis : Hypothesis
        Nominal figures and effects of the fit.
    residual : ndarray (N,)
        What it leaves of these runs, in noise standard deviations.

    Returns
    -------
    Exported
        With the fewest parts that will do, or those that come nearest.
    """
    trials = dict(_shown(held))
    read = any(channel.column.startswith("sensor.") for channel in held.channels)
    if not read or not trials or not all(effect.in_model for effect in hypothesis.effects):
        return Exported()
    found: list[Exported] = []
    for parts in PARTS:
        spec = corrected_spec(held.machine, hypothesis.effects, hypothesis.values, parts=parts)
        model = compiled(spec)
        tried = _compared(held, residual, model, trials, parts)
        found.append(tried)
        if not tried.matters:
            return tried
    if any(effect.kind in STRIKING for effect in hypothesis.effects):
        # after a blow no two simulations agree, however fine their steps
        return replace(found[0], matters=False)
    nearest = min(found, key=lambda each: each.apart)
    return nearest if nearest.apart < _BETTER * found[0].apart else found[0]


def _shown(held: Comparison) -> Iterator[tuple[int, Trial]]:
    """Number and beginning of each run that a file can be held against."""
    chosen = [
        t
        for t, trial in enumerate(held.trials)
        if trial.form == "forward" and trial.resting and trial.name not in held.parting
    ]
    for t in chosen:
        yield t, held.trials[t].until(_PLAYED / len(chosen))


def _compared(
    held: Comparison, residual: Array, model: mujoco.MjModel, trials: dict[int, Trial], parts: int
) -> Exported:
    """How far a model is from the fit on some runs."""
    rows, read = held.rows, np.array([c.column.startswith("sensor.") for c in held.channels])
    apart, left, fitted, channels = [], [], [], []
    for t, trial in trials.items():
        chosen = (rows.trial == t) & (rows.sample < len(trial.time)) & read[rows.channel]
        own = np.flatnonzero(chosen)
        sample, channel = rows.sample[own], rows.channel[own]
        shown = played(held, model, trial)[sample, channel]
        off = (trial.measured[sample, channel] - shown) / held.scales[t, channel]
        off = np.clip(np.nan_to_num(off, nan=_WILD), -_WILD, _WILD)
        left.append(off)
        fitted.append(residual[own])
        apart.append(off - residual[own])
        channels.append(channel)
    channel = np.concatenate(channels)
    count = np.maximum(np.bincount(channel), 1)
    by_channel, left_by = (
        np.sqrt(np.bincount(channel, np.concatenate(part) ** 2) / count) for part in (apart, fitted)
    )
    allowed = np.maximum(1.0, _OF_LEFT / _APART * left_by)
    worst = int(np.argmax(by_channel / allowed))
    return Exported(
        parts=parts,
        step=float(model.opt.timestep),
        left=rms(np.concatenate(left)),
        fitted=rms(np.concatenate(fitted)),
        apart=float(by_channel[worst]),
        channel=held.channels[worst].name,
        matters=bool(by_channel[worst] > _APART * allowed[worst]),
    )


def played(comparison: Comparison, model: mujoco.MjModel, trial: Trial) -> Array:
    """What the channels of a comparison show when plain MuJoCo plays a run's commands (T, C).

    Parameters
    ----------
    comparison : Comparison
        Its machine says which joints and actuators there are.
    model : MjModel
        A model that has them, and perhaps more joints.
    trial : Trial
        A run that begins at rest; its first command is held beforehand, as fits do.

    Returns
    -------
    ndarray (T, C)
        NaN of channels that are no sensors, and of a run that goes wild.
    """
    machine: Machine = comparison.machine
    inside = max(1, round(trial.step / model.opt.timestep))
    batch = Batch(model, 1, 1)
    batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
    batch.qpos[0] = model.qpos0
    places = [int(model.joint(name).qposadr[0]) for name in machine.joints]
    batch.qpos[0, places] = trial.position
    control = np.zeros((trial.steps, model.nu))
    control[:, [model.actuator(name).id for name in machine.actuators]] = trial.controls
    settle = round(SETTLE / model.opt.timestep)
    told = np.concatenate([np.repeat(control[:1], settle, 0), np.repeat(control, inside, 0)])
    out = batch.rollout(
        len(told),
        told[None],
        control_spec=int(mujoco.mjtState.mjSTATE_CTRL),
        record=("sensordata",),
    )
    shown = trial.at_samples(out["sensordata"][0, settle::inside])
    found = np.full((len(trial.time), len(comparison.channels)), np.nan)
    for c, channel in enumerate(comparison.channels):
        prefix, _, name = channel.column.partition(".")
        if prefix == "sensor":
            found[:, c] = shown[:, int(model.sensor(name).adr[0]) + (channel.axis or 0)]
    return found
