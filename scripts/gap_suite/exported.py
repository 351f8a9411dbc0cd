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
from loose_env.gap.exported import exported, played
from loose_env.gap.finding import GapFound
from loose_env.gap.judgement import machine_part

__all__ = ["MODEL", "exported_gap"]

Array = NDArray[np.float64]

MODEL = "model.xml"
"""File of the corrected model."""


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
    step = exported(held, corrected, found.best.held_residual).step
    file, *_ = write_model(folder / MODEL, machine, corrected.effects, corrected.values, step=step)
    model = mujoco.MjModel.from_xml_path(str(file))
    rows, left, fitted = held.rows, [], []
    for t in chosen:
        own = rows.trial == t
        sample, channel = rows.sample[own], rows.channel[own]
        shown = played(held, model, held.trials[t])[sample, channel]
        left.append((held.trials[t].measured[sample, channel] - shown) / held.scales[t, channel])
        fitted.append(found.best.held_residual[own])
    return _rms(np.concatenate(left)), _rms(np.concatenate(fitted))


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(residual**2)))
