"""Hypothesis: effects that are added to a nominal model; edits and compiles a spec."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.nominal_model import NominalModel, set_step
from loose_env.typing import Array

_FORCE = "loose_env force of "
_OFF = 30  # group of actuators that are switched off
JOINT = ("damping", "armature", "frictionloss")  # attributes of joints that can be scaled
_GAINS = {
    "gain": (slice(1), slice(2)),
    "velocity_gain": (slice(0), slice(2, 3)),
    "all_gains": (slice(None), slice(None)),
}
"""Entries of an actuator's gain and bias that are scaled together."""


def scale(spec: mujoco.MjSpec, name: str, of: str, factor: float) -> None:
    """Scale an attribute of a joint or a link, or gains of an actuator."""
    if name in _GAINS:
        actuator = spec.actuator(of)
        gain, bias = np.array(actuator.gainprm), np.array(actuator.biasprm)
        for values, own in zip((gain, bias), _GAINS[name], strict=True):
            values[own] *= factor
        actuator.gainprm, actuator.biasprm = gain, bias
    else:
        element = spec.joint(of) if name in JOINT else spec.body(of)
        setattr(element, name, np.asarray(getattr(element, name)) * factor)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects with their values.

    Examples
    --------
    >>> Hypothesis().pairs  # the nominal model itself
    ()
    """

    effects: tuple[Effect, ...] = ()
    """Effects added to the nominal model, in the order in which they act."""
    values: tuple[Array, ...] = ()
    """Parameter values of each effect."""

    @property
    def pairs(self) -> tuple[tuple[Effect, Array], ...]:
        """Effects with their values."""
        return tuple(zip(self.effects, self.values, strict=True))

    def with_effects(self, pairs: Sequence[tuple[Effect, Array]]) -> Hypothesis:
        """Hypothesis of other effects and values."""
        return Hypothesis(tuple(e for e, _ in pairs), tuple(v for _, v in pairs))

    def in_run(self, run: str) -> Hypothesis:
        """The same as it was in one run, where runs have a payload in different ways."""
        pairs = (effect.in_run(run, own) for effect, own in self.pairs)
        return self.with_effects([pair for pair in pairs if pair is not None])

    def edit(self, spec: mujoco.MjSpec, *, export: bool = False) -> None:
        """Change a spec in place, that of the exported model too."""
        for effect, values in self.pairs:
            (effect.export if export else effect.edit)(spec, values)

    def model(
        self, machine: NominalModel, step: float, *, released: bool = False
    ) -> mujoco.MjModel:
        """Compile the model of the hypothesis, with its drives off for a free response."""
        # The last sensors are the forces of the machine's own actuators.
        spec = machine.fresh()
        set_step(spec, step)
        self.edit(spec)
        for name in machine.actuators:
            # after a Runge-Kutta step actuator_force is the force at its end
            kind, drive = mujoco.mjtSensor.mjSENS_ACTUATORFRC, mujoco.mjtObj.mjOBJ_ACTUATOR
            spec.add_sensor(name=_FORCE + name, type=kind, objtype=drive, objname=name)
        model = compiled(spec)
        if released:  # effects exported as actuators are none of its drives
            model.actuator_group[: len(machine.actuators)] = _OFF
            model.opt.disableactuator |= 1 << _OFF
        # an arm is one island: searching for more costs a tenth of its time and changes nothing
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        return model


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model during a fit: one of whose inertias MuJoCo warns fits badly by itself."""
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message="Inertia matrix is too close to singular", category=UserWarning
        )
        return spec.compile()
