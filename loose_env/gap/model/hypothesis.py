"""Hypothesis: the nominal model with added effects."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import mujoco

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.nominal_model import Machine, set_step
from loose_env.typing import Array

__all__ = ["Hypothesis", "compiled"]


_FORCE = "loose_env force of "
_OFF = 30
"""Group of actuators that are switched off."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects and their values, in the order in which they act; initial-state offsets."""

    effects: tuple[Effect, ...]
    """Effects added to the nominal model."""
    values: tuple[Array, ...]
    """Parameter values of each effect."""
    position: Array | None = None
    """Offsets of the measured initial positions [rad, m] (trials, joints)."""
    speed: Array | None = None
    """Offsets of the measured initial speeds [rad/s, m/s] (trials, joints)."""

    def model(self, machine: Machine, step: float, *, released: bool = False) -> mujoco.MjModel:
        """Compile the model of the hypothesis, with its drives off for a free response.

        The last sensors are the forces of the machine's own actuators.
        """
        spec = machine.fresh()
        set_step(spec, step)
        for effect, values in zip(self.effects, self.values, strict=True):
            effect.edit(spec, values)
        for name in machine.actuators:
            # after a Runge-Kutta step actuator_force is the force at its end
            spec.add_sensor(
                name=_FORCE + name,
                type=mujoco.mjtSensor.mjSENS_ACTUATORFRC,
                objtype=mujoco.mjtObj.mjOBJ_ACTUATOR,
                objname=name,
            )
        model = compiled(spec)
        if released:  # effects exported as actuators are none of its drives
            model.actuator_group[: len(machine.actuators)] = _OFF
            model.opt.disableactuator |= 1 << _OFF
        # an arm is one island: searching for more costs a tenth of its time and changes nothing
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        if _unconstrained(model):
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        return model


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model during a fit, without MuJoCo's warnings on inertias.

    A fit may evaluate masses so different that MuJoCo warns of them. Such a model is simulated
    inaccurately, fits badly, and is not kept, so that a user needs no warning.

    Raises
    ------
    ValueError
        If the model does not compile.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message="Inertia matrix is too close to singular", category=UserWarning
        )
        return spec.compile()


def _unconstrained(model: mujoco.MjModel) -> bool:
    """Return whether a model can never have a constraint; it is simulated faster then."""
    contact = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    limit = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    return not (
        (contact and (model.geom_contype | model.geom_conaffinity).any())
        or (limit and (model.jnt_limited.any() or model.tendon_limited.any()))
        or model.dof_frictionloss.any()
        or model.tendon_frictionloss.any()
        or model.neq
    )
