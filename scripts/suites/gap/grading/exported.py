"""The model that the tool writes, simulated by plain MuJoCo on the held-out runs.

A result may say that its gap is closed by what the tool simulates inside. Here the file is read
back and stepped by MuJoCo alone, as a user would; what it leaves is held against what the tool says
is left of the same numbers.
"""

from __future__ import annotations

from pathlib import Path

import mujoco

from loose_env.gap import GapSolution, compared, exported, resting_runs, write_model

__all__ = ["MODEL", "exported_gap"]

MODEL = "model.xml"
"""File of the corrected model."""


def exported_gap(found: GapSolution, folder: Path) -> tuple[float, float] | None:
    """Gap of the written model and that of the fit, on the same numbers.

    Parameters
    ----------
    found : GapSolution
        What the tool found.
    folder : Path
        Where the model is written.

    Returns
    -------
    (float, float) or None
        Root mean squares in noise standard deviations; None where MJCF cannot carry an effect, or
        no held-out run is one that begins at rest, has commands and is compared sample by sample.
    """
    corrected, held = found.corrected, found.problem.held_out_whole
    if not found.effects or not all(effect.in_model for effect in corrected.effects):
        return None
    runs, machine = resting_runs(held), found.problem.machine
    if not runs:
        return None
    step = exported(held, corrected, found.best.held_out_residual).step
    file, *_ = write_model(folder / MODEL, machine, corrected, step=step)
    model = mujoco.MjModel.from_xml_path(str(file))
    tried = compared(held, found.best.held_out_residual, model, runs)
    return None if tried is None else (tried[1].left, tried[1].fitted)
