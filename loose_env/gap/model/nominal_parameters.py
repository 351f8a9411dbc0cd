"""Uncertain parameters of the nominal model (masses, frictions ...), as factors in a tolerance.

They are nuisance parameters: fitted with every hypothesis, within the tolerance, and never reported
as an effect.
"""

from __future__ import annotations

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
_JOINT = ("damping", "armature", "frictionloss")
"""Attributes of joints."""


class NominalParameters:
    """Factors on masses, inertias, dampings, frictions, rotor inertias and actuator gains."""

    def __init__(self, machine: NominalModel, *, tolerance: float) -> None:
        self.machine, self.tolerance = machine, tolerance

    @cached_property
    def entries(self) -> tuple[tuple[str, str], ...]:
        """Attribute and element of the nominal parameters of the model that are not zero."""
        model, machine = self.machine.model, self.machine
        links = [link for link in machine.links if model.body(link).mass[0] > 0]
        found = [(field, link) for link in links for field in ("mass", "inertia")]
        for k, joint in enumerate(machine.joints):
            values = (getattr(model, f"dof_{field}")[model.jnt_dofadr[k]] for field in _JOINT)
            found += [(f, joint) for f, value in zip(_JOINT, values, strict=True) if value > 0]
        for k, actuator in enumerate(machine.actuators):
            found.append(("gain", actuator))
            if model.actuator_biasprm[k, 2] != 0:
                found.append(("velocity_gain", actuator))
        return tuple(found)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters: one scale factor each."""
        wide = _BEYOND * self.tolerance
        return tuple(
            Parameter(
                name=f"{field}.{of}", unit="", low=1 - wide, high=1 + wide, scale=self.tolerance,
                spread=_SPREAD,
            )
            for field, of in self.entries
        )  # fmt: skip

    def edit(self, spec: mujoco.MjSpec, factors: Array) -> None:
        """Scale the nominal parameters by factors (P,)."""
        for (field, of), factor in zip(self.entries, factors, strict=True):
            if field in ("gain", "velocity_gain"):
                actuator = spec.actuator(of)
                gain, bias = np.array(actuator.gainprm), np.array(actuator.biasprm)
                if field == "gain":
                    gain[0] *= factor
                bias[slice(2) if field == "gain" else 2] *= factor
                actuator.gainprm, actuator.biasprm = gain, bias
            else:
                own = spec.joint(of) if field in _JOINT else spec.body(of)
                setattr(own, field, np.asarray(getattr(own, field)) * factor)
