"""Uncertain parameters of the nominal model, known within a tolerance.

They are fitted with every hypothesis, within the tolerance, and never reported as an effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.nominal_model import Machine
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

__all__ = ["NominalFigures"]


_BEYOND = 1.02
"""Share of the tolerance to which a figure may go; more than 1 for figures right at its end. With
more room, stronger servos take up what is a friction."""
_SPREAD = 0.6
"""Standard deviation of a figure beforehand, as a share of the tolerance (uniform: 0.58)."""


@dataclass(frozen=True)
class _Figure:
    """One nominal parameter: field and element of the model."""

    field: str
    of: str


class NominalFigures(Effect):
    """Factors on masses, inertias, dampings, rotor inertias and actuator gains.

    Parameters
    ----------
    machine : Machine
        The nominal model.
    tolerance : float
        Relative tolerance within which they are known.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> figures = NominalFigures(Machine(planar(2).spec), tolerance=0.03)
    >>> sorted({figure.field for figure in figures.figures})
    ['armature', 'damping', 'inertia', 'mass']
    """

    kind = "nominal"

    def __init__(self, machine: Machine, *, tolerance: float) -> None:
        super().__init__(machine, "all")
        self.tolerance = tolerance

    @classmethod
    def places(cls, machine: Machine) -> tuple[str, ...]:
        """Locations: the whole model."""
        return ("all",)

    @cached_property
    def figures(self) -> tuple[_Figure, ...]:
        """Nominal parameters of the model that are not zero."""
        model, machine = self.machine.model, self.machine
        found = [
            _Figure(field, link)
            for link in machine.links
            for field in ("mass", "inertia")
            if model.body(link).mass[0] > 0
        ]
        for k, joint in enumerate(machine.joints):
            dof = int(model.jnt_dofadr[k])
            values = {
                "damping": model.dof_damping[dof],
                "armature": model.dof_armature[dof],
                "frictionloss": model.dof_frictionloss[dof],
            }
            found += [_Figure(field, joint) for field, value in values.items() if value > 0]
        for k, actuator in enumerate(machine.actuators):
            found.append(_Figure("gain", actuator))
            if model.actuator_biasprm[k, 2] != 0:
                found.append(_Figure("velocity_gain", actuator))
        return tuple(found)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters: one scale factor each."""
        wide = _BEYOND * self.tolerance
        return tuple(
            Parameter(
                name=f"{figure.field}.{figure.of}",
                unit="",
                low=1 - wide,
                high=1 + wide,
                scale=self.tolerance,
                centre=1.0,
                spread=_SPREAD,
            )
            for figure in self.figures
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starting values: nominal."""
        return ((1.0,) * len(self.figures),)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Scale the nominal parameters."""
        for figure, factor in zip(self.figures, values, strict=True):
            if figure.field == "mass":
                spec.body(figure.of).mass *= factor
            elif figure.field == "inertia":
                body = spec.body(figure.of)
                body.inertia = np.asarray(body.inertia) * factor
            elif figure.field == "damping":
                joint = spec.joint(figure.of)
                joint.damping = np.asarray(joint.damping) * factor
            elif figure.field in ("armature", "frictionloss"):
                joint = spec.joint(figure.of)
                setattr(joint, figure.field, getattr(joint, figure.field) * factor)
            else:
                _scale_gain(spec.actuator(figure.of), factor, velocity=figure.field != "gain")


def _scale_gain(actuator: mujoco.MjsActuator, factor: float, *, velocity: bool) -> None:
    """Scale the gain, or the velocity gain, of an actuator."""
    bias = np.array(actuator.biasprm)
    if velocity:
        bias[2] *= factor
    else:
        gain = np.array(actuator.gainprm)
        gain[0] *= factor
        actuator.gainprm = gain
        bias[:2] *= factor
    actuator.biasprm = bias
