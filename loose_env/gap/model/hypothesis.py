"""What is simulated: a nominal model with effects in it."""

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
    """Effects and their values, in the order in which they act; start offsets of free runs."""

    effects: tuple[Effect, ...]
    """What the nominal model lacks."""
    values: tuple[Array, ...]
    """Of the parameters of each."""
    position: Array | None = None
    """Added to the measured start [rad, m] (trials, joints)."""
    speed: Array | None = None
    """Added to the measured start speeds [rad/s, m/s] (trials, joints)."""

    def model(self, machine: Machine, step: float, *, released: bool = False) -> mujoco.MjModel:
        """Compile the model that it stands for, its drives off if the arm was let go.

        The last sensors are the forces of the machine's own actuators.
        """
        spec = machine.fresh()
        set_step(spec, step)
        for effect, values in zip(self.effects, self.values, strict=True):
            effect.edit(spec, values)
        for name in machine.actuators:
            # what a Runge-Kutta step leaves in actuator_force is the force at its end
            spec.add_sensor(
                name=_FORCE + name,
                type=mujoco.mjtSensor.mjSENS_ACTUATORFRC,
                objtype=mujoco.mjtObj.mjOBJ_ACTUATOR,
                objname=name,
            )
        model = compiled(spec)
        if released:  # effects that are written as actuators are none of its drives
            model.actuator_group[: len(machine.actuators)] = _OFF
            model.opt.disableactuator |= 1 << _OFF
        # an arm is one island: looking for more costs a tenth of its time and changes nothing
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        if _unconstrained(model):
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        return model


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model that a fit tries, without a word on the inertias that it tries.

    A fit may try masses so unlike that MuJoCo warns of them. Such a model is simulated badly, fits
    badly, and is not kept; a user who is not told of it has missed nothing.

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
    """Whether nothing in a model can ever become a constraint; it is simulated faster then."""
    contact = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    limit = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    return not (
        (contact and (model.geom_contype | model.geom_conaffinity).any())
        or (limit and (model.jnt_limited.any() or model.tendon_limited.any()))
        or model.dof_frictionloss.any()
        or model.tendon_frictionloss.any()
        or model.neq
    )
