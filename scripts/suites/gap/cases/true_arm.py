"""A true arm: figures that are off, effects on top; and running it."""

from __future__ import annotations

import dataclasses

import numpy as np

from scripts.suites.gap.cases.motions import Motion
from scripts.suites.gap.cases.sensing import Signals, needs_fine, read
from scripts.suites.gap.effects.catalogue import apply_effect
from scripts.suites.gap.effects.types import Effect, Readings
from scripts.suites.gap.simulator.arms import Figures
from scripts.suites.gap.simulator.build import Factors, build
from scripts.suites.gap.simulator.chain import felt_inertia
from scripts.suites.gap.simulator.laws import (
    BUMP,
    CROSSLEY,
    DAMPING,
    EXTRA,
    FRICTION,
    HERTZ,
    LOADED,
    LOADED_BUMP,
    LOADED_SMOOTH,
    SMOOTH_SPEED,
    STIFFNESS,
)
from scripts.suites.gap.simulator.simulate import SAMPLE, System, simulate

STOP_FORCE = 100.0
"""Force of a blow on the stops of a slide by which the steps are chosen [N]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrueArm:
    """An arm as it is: nominal figures times factors, with effects."""

    figures: Figures
    factors: Factors
    effects: tuple[Effect, ...] = ()

    def assemble(self) -> tuple[System, Readings]:
        """The arrays to integrate and what is wrong with the sensors."""
        system, readings = build(self.figures, self.factors), Readings()
        for effect in self.effects:
            apply_effect(effect, system, readings, self.figures)
        return system, readings

    def without(self) -> TrueArm:
        """The same arm with nothing missing."""
        return dataclasses.replace(self, effects=())

    def run(self, motion: Motion, *, inside: int = 10, settle: float = 1.2) -> Signals:
        """Readings of one run without noise.

        Parameters
        ----------
        motion : Motion
            What the arm is asked to do.
        inside : int
            Least number of integration steps in a sample; stiff arms take more.
        settle : float
            Time for which the first command is held beforehand [s].
        """
        system, readings = self.assemble()
        inside = steps_inside(system, self.figures, inside)
        fine = needs_fine(readings)
        trace = simulate(
            system,
            motion.commands,
            inside=inside,
            release=motion.release,
            settle=settle,
            fine=fine,
            straight=motion.straight,
        )
        signals = read(trace, readings, inside=inside if fine else 1)
        if motion.release is None:
            return signals
        return Signals(
            **{
                field.name: getattr(signals, field.name)[motion.release :]
                for field in dataclasses.fields(Signals)
            }
        )


def steps_inside(system: System, figures: Figures, least: int) -> int:
    """Steps in a sample that the stiffest law of an arm needs.

    The method is stable up to 2.8 over the step; rates stay below 1.2 and oscillations below 0.6.
    """
    step = SAMPLE / least
    needed = 1.0
    limits = np.array([link.limit for link in figures.links])
    for dof, law in enumerate(system.laws):
        joint = int(np.sum(system.joint_dofs <= dof)) - 1
        slide = system.bodies[dof, 0] > 0.5 and dof not in system.joint_dofs
        load = STOP_FORCE if slide else 0.6 * limits[max(joint, 0)]
        felt = felt_inertia(system, dof, figures.home)
        rate = law[DAMPING] + law[EXTRA]
        if law[FRICTION] > 0:
            rate += law[FRICTION] * (1 + law[BUMP]) / law[SMOOTH_SPEED]
        if dof in system.joint_dofs:
            drive = system.drives[joint]
            if drive[LOADED] > 0:
                slope = drive[LOADED] * (1 + drive[LOADED_BUMP]) / drive[LOADED_SMOOTH]
                rate += 0.6 * limits[joint] * slope
        stiffness = law[STIFFNESS]
        if law[HERTZ] > 0:
            stiffness += 1.5 * law[HERTZ] * (load / law[HERTZ]) ** (1 / 3)
            rate += load * law[CROSSLEY]
        needed = max(needed, rate / felt * step / 1.2, np.sqrt(stiffness / felt) * step / 0.6)
    return least * int(np.ceil(needed - 1e-9))
