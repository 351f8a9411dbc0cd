"""Time step and number of steps that a hypothesis needs: as nominal, finer for stiff effects.

The step is chosen for the nominal model, which has no stiff spring and often no friction. A joint
that comes to rest or a spring that oscillates within a few steps needs finer ones.
"""

from __future__ import annotations

from collections.abc import Iterable

from loose_env.gap.data.aligned_run import Trial
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.nominal_model import NominalModel


def stepped(trial: Trial, machine: NominalModel, effects: Iterable[Effect]) -> Trial:
    """Align a run with the steps needed by a hypothesis of these effects."""
    if machine.uniform_steps or not any(effect.needs_fine_steps for effect in effects):
        return trial.coarser(machine.merged_steps)
    return (
        trial.coarser(machine.merged_steps // 2)
        if machine.merged_steps > 1
        else trial.finer(machine.substeps)
    )


def step_with(machine: NominalModel, effects: Iterable[Effect]) -> float:
    """Time step for a model with these effects, at most that of the machine [s]."""
    step = machine.time_step
    needs_fine_steps = any(effect.needs_fine_steps for effect in effects)
    return step / machine.substeps if needs_fine_steps and machine.merged_steps == 1 else step
