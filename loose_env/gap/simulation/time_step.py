"""Number of steps of a hypothesis: as nominal, more for stiff effects.

The step is chosen for the nominal model, which has no stiff spring and often no friction. A joint
that comes to rest or a spring that oscillates within a few steps needs finer ones.
"""

from __future__ import annotations

from collections.abc import Iterable

from loose_env.gap.data.aligned_run import Trial
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.nominal_model import Machine

__all__ = ["step_with", "stepped"]


def stepped(trial: Trial, machine: Machine, effects: Iterable[Effect]) -> Trial:
    """Align a run with the steps needed by a hypothesis of these effects.

    Parameters
    ----------
    trial : Trial
        The run on the machine's steps.
    machine : Machine
        How many of them are taken as one (`Machine.joined`), and into how many parts they are cut
        for what is sharp (`Machine.cut`).
    effects : iterable of Effect
        Effects of the hypothesis.
    """
    if machine.even or not any(effect.sharp for effect in effects):
        return trial.coarser(machine.joined)
    return trial.coarser(machine.joined // 2) if machine.joined > 1 else trial.finer(machine.cut)


def step_with(machine: Machine, effects: Iterable[Effect]) -> float:
    """Time step for a model with these effects, at most that of the machine [s]."""
    step = machine.step or float(machine.model.opt.timestep)
    sharp = any(effect.sharp for effect in effects)
    return step / machine.cut if sharp and machine.joined == 1 else step
