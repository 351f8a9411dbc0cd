"""The model that the tool writes, simulated by plain MuJoCo on the held-out runs.

A result may say that its gap is closed by what the tool simulates inside. Here the file is read
back and stepped by MuJoCo alone, as a user would; what it leaves is held against what the tool says
is left of the same numbers.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.gap.export import write_model
from loose_env.gap.exported import exported
from loose_env.gap.finding import GapFound
from loose_env.gap.judgement import machine_part
from loose_env.gap.trial import Trial

__all__ = ["MODEL", "exported_gap", "simulated"]

Array = NDArray[np.float64]

MODEL = "model.xml"
"""File of the corrected model."""
SETTLE = 0.4
"""How long the first command is held beforehand, as the tool does [s]."""


def exported_gap(found: GapFound, folder: Path) -> tuple[float, float] | None:
    """Gap of the written model and that of the fit, on the same numbers.

    Parameters
    ----------
    found : GapFound
        What the tool found.
    folder : Path
        Where the model is written.

    Returns
    -------
    (float, float) or None
        Root mean squares in noise standard deviations; None where MJCF cannot carry an effect, or
        no held-out run is one that begins at rest, has commands and is compared sample by sample.
    """
    corrected, held = machine_part(found.best), found.prepared.whole_held
    if not found.effects or not all(effect.in_model for effect in corrected.effects):
        return None
    chosen = [
        t
        for t, trial in enumerate(held.trials)
        if trial.form == "forward" and trial.resting and trial.name not in held.parting
    ]
    if not chosen:
        return None
    machine = found.prepared.machine
    parts = exported(held, corrected, found.best.held_residual).parts
    file, *_ = write_model(
        folder / MODEL, machine, corrected.effects, corrected.values, parts=parts
    )
    model = mujoco.MjModel.from_xml_path(str(file))
    rows, left, fitted = held.rows, [], []
    for t in chosen:
        own = rows.trial == t
        shown = simulated(model, held.trials[t], machine.actuators, machine.joints)
        columns = np.stack([_column(model, shown, c.column, c.axis) for c in held.channels], axis=1)
        sample, channel = rows.sample[own], rows.channel[own]
        measured = held.trials[t].measured[sample, channel]
        left.append((measured - columns[sample, channel]) / held.scales[t, channel])
        fitted.append(found.best.held_residual[own])
    return _rms(np.concatenate(left)), _rms(np.concatenate(fitted))


def simulated(
    model: mujoco.MjModel, trial: Trial, actuators: tuple[str, ...], joints: tuple[str, ...]
) -> Array:
    """Sensors of a model at the samples of a run (T, sensordata), from the measured start on."""
    data = mujoco.MjData(model)
    for joint, angle in zip(joints, trial.position, strict=True):
        data.joint(joint).qpos[0] = angle
    driven = [model.actuator(name).id for name in actuators]
    inside = max(1, round(trial.step / model.opt.timestep))
    model.opt.timestep = trial.step / inside
    data.ctrl[driven] = trial.controls[0]
    for _ in range(round(SETTLE / model.opt.timestep)):
        mujoco.mj_step(model, data)
    shown = np.zeros((trial.steps, model.nsensordata))
    for row, command in zip(shown, trial.controls, strict=True):
        data.ctrl[driven] = command
        # sensors show the beginning of a step; late ones keep a history that only steps may add to
        mujoco.mj_step(model, data)
        row[:] = data.sensordata
        mujoco.mj_step(model, data, inside - 1)
    return trial.at_samples(shown)


def _column(model: mujoco.MjModel, shown: Array, column: str, axis: int | None) -> Array:
    """Readings of one channel (T,); NaN of what is no sensor."""
    kind, _, name = column.partition(".")
    if kind != "sensor":
        return np.full(len(shown), np.nan)
    return np.asarray(shown[:, int(model.sensor(name).adr[0]) + (axis or 0)])


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(residual**2)))
