"""Uncertain parameters of the nominal model (masses, frictions ...), as factors in a tolerance.

They are nuisance parameters: fitted with every hypothesis, within the tolerance, and never reported
as an effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from loose_env.gap.model.effect import Parameter
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

_BEYOND = 1.02
"""Largest deviation of a parameter, as a share of the tolerance; above 1, so that a true value at
the end of the tolerance is no bound. With more room, servo gains absorb a friction."""
_SPREAD = 0.6
"""Prior standard deviation, as a share of the tolerance (of a uniform distribution: 0.58)."""


@dataclass(frozen=True)
class _Entry:
    """One nominal parameter: field and element of the model."""

    field: str
    of: str


class NominalParameters:
    """Factors on masses, inertias, dampings, frictions, rotor inertias and actuator gains."""

    def __init__(self, machine: NominalModel, *, tolerance: float, drives: bool = True) -> None:
        self.machine, self.tolerance, self.drives = machine, tolerance, drives

    @cached_property
    def entries(self) -> tuple[_Entry, ...]:
        """Nominal parameters of the model that are not zero."""
        model, machine = self.machine.model, self.machine
        found = [
            _Entry(field, link)
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
            found += [_Entry(field, joint) for field, value in values.items() if value > 0]
        for k, actuator in enumerate(machine.actuators) if self.drives else ():
            found.append(_Entry("gain", actuator))
            if model.actuator_biasprm[k, 2] != 0:
                found.append(_Entry("velocity_gain", actuator))
        return tuple(found)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters: one scale factor each."""
        wide = _BEYOND * self.tolerance
        return tuple(
            Parameter(
                name=f"{entry.field}.{entry.of}",
                unit="",
                low=1 - wide,
                high=1 + wide,
                scale=self.tolerance,
                spread=_SPREAD,
            )
            for entry in self.entries
        )

    def edit(self, spec: mujoco.MjSpec, factors: Array) -> None:
        """Scale the nominal parameters by factors (P,)."""
        for entry, factor in zip(self.entries, factors, strict=True):
            if entry.field == "mass":
                spec.body(entry.of).mass *= factor
            elif entry.field == "inertia":
                body = spec.body(entry.of)
                body.inertia = np.asarray(body.inertia) * factor
            elif entry.field in ("damping", "armature", "frictionloss"):
                joint = spec.joint(entry.of)
                setattr(joint, entry.field, np.asarray(getattr(joint, entry.field)) * factor)
            else:
                _scale_gain(spec.actuator(entry.of), factor, velocity=entry.field != "gain")


def _scale_gain(actuator: mujoco.MjsActuator, factor: float, *, velocity: bool) -> None:
    """Scale the gain, or the velocity gain, of an actuator."""
    gain, bias = np.array(actuator.gainprm), np.array(actuator.biasprm)
    if velocity:
        bias[2] *= factor
    else:
        gain[0] *= factor
        bias[:2] *= factor
    actuator.gainprm, actuator.biasprm = gain, bias
