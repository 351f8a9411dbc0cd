"""Tolerances of a nominal model: what a user's model never has exactly.

Nuisances are fitted with every hypothesis, each with a Gaussian prior of the width that stands
here, and are never reported. An effect is named only where the data pull it clearly out of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.gap.core.balance import USUAL, Balance, Forces
from loose_env.gap.model.effects.drives.actuators import ActuatorGain
from loose_env.gap.model.effects.link_inertia import LinkMass, links_with_mass
from loose_env.gap.model.effects.mjcf.geometry import link_ends
from loose_env.gap.model.effects.mjcf.inertia import Inertial, inertial_of, set_inertial
from loose_env.gap.model.effects.sensors import EncoderOffset
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Standard deviations of what a nominal model states."""

    mass: float = 0.05
    """Mass of a link, with its inertia [share]: CAD against a weighed part."""
    centre: float = 0.06
    """Centre of mass of a link [share of its length], at most `centre_m`: cables, screws."""
    centre_m: float = 0.015
    """Largest tolerance of a centre of mass [m]."""
    inertia: float = 0.15
    """Each of the six components of a link's inertia [share of its mean moment]."""
    armature: float = 0.2
    """Rotor inertia [share]: data sheets round, and gears add."""
    torque: float = 0.04
    """Torque constant, or gain of a servo [share]."""
    velocity_gain: float = 0.1
    """Velocity gain of a servo [share]: the same column as viscous friction."""
    damping: float = 0.1
    """Damping and dry friction that the model has [share]: they change with temperature."""
    offset: float = 0.01
    """Constant torque of a joint [share of its typical torque]."""
    zero: float = 0.002
    """Zero position of a joint [rad, m]: a calibrated encoder."""
    shift_samples: float = 0.7
    """Shift of commands or torques against the motion [intervals of the log], of either sign:
    held or interpolated commands, and the order of a logger's cycle."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Nuisance:
    """One tolerance: the change of the balance by one standard deviation."""

    name: str
    """Name for the reader."""
    change: Array
    """Change of the balance (T, joints)."""
    operator: Array
    """Change of the mean inertia, damping and stiffness (3, joints, joints)."""


_STEP = 1e-3
"""Relative step of numerical derivatives."""


def nuisances(balance: Balance, tolerances: Tolerances) -> list[Nuisance]:
    """List the tolerances of a model that its recording can depend on."""
    return [
        *_rigid(balance, tolerances),
        *_joints(balance, tolerances),
        *_drives(balance, tolerances),
    ]


def _nuisance(name: str, forces: Forces, balance: Balance, factor: float) -> Nuisance:
    change = factor * forces.with_contact(balance.directions[USUAL])
    return Nuisance(name=name, change=change, operator=factor * forces.operator)


def _rigid(balance: Balance, tolerances: Tolerances) -> Iterator[Nuisance]:
    """Ten rigid parameters of each link."""
    machine = balance.machine
    for link in links_with_mass(machine):
        mass = LinkMass(machine, link)
        own = float(machine.model.body(link).mass[0])
        forces = balance.forces(mass, np.array([_STEP * own]))
        yield _nuisance(f"mass of {link}", forces, balance, tolerances.mass / _STEP)
        size = _size(machine, link)
        width = min(tolerances.centre * size, tolerances.centre_m)
        for k, axis in enumerate("xyz"):
            forces = balance.edited(_inertial(machine, link, centre=_STEP * size * np.eye(3)[k]))
            scale = width / (_STEP * size)
            yield _nuisance(f"centre of {link} along {axis}", forces, balance, scale)
        moment = float(np.mean(machine.model.body(link).inertia)) + 1e-3 * own * size**2
        for row, column in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
            tensor = np.zeros((3, 3))
            tensor[row, column] = tensor[column, row] = _STEP * moment
            forces = balance.edited(_inertial(machine, link, tensor=tensor))
            name = f"inertia {'xyz'[row]}{'xyz'[column]} of {link}"
            yield _nuisance(name, forces, balance, tolerances.inertia / _STEP)


def _inertial(
    machine: NominalModel, link: str, *, centre: Array | None = None, tensor: Array | None = None
) -> mujoco.MjSpec:
    """Spec with a link's centre or inertia changed."""
    spec = machine.fresh()
    spec.compiler.balanceinertia = False
    old = inertial_of(machine, spec, link)
    zero = np.zeros(3)
    changed = Inertial(
        old.mass,
        old.centre + (zero if centre is None else centre),
        old.tensor + (0.0 if tensor is None else tensor),
    )
    set_inertial(machine, spec, link, changed)
    return spec


def _size(machine: NominalModel, link: str) -> float:
    """Length of a link: between its joints, or what its inertia and centre say [m]."""
    start, end = link_ends(machine, link)
    body = machine.model.body(link)
    gyration = 2 * np.sqrt(np.sum(body.inertia) / 2 / body.mass[0])
    return float(max(np.linalg.norm(end - start), gyration, np.linalg.norm(body.ipos)))


def _joints(balance: Balance, tolerances: Tolerances) -> Iterator[Nuisance]:
    """Zero positions, rotor inertias, dampings, constant torques and shifts of torque readings."""
    machine, model = balance.machine, balance.machine.model
    count = len(machine.joints)
    for joint, name in enumerate(machine.joints):
        offset = _STEP * tolerances.zero
        forces = balance.forces(EncoderOffset(machine, name), np.array([offset]))
        yield _nuisance(f"zero of {name}", forces, balance, 1 / _STEP)
        for field, width in (
            ("armature", tolerances.armature),
            ("damping", tolerances.damping),
            ("frictionloss", tolerances.damping),
        ):
            nominal = float(getattr(model, f"dof_{field}")[int(model.joint(name).dofadr[0])])
            if nominal > 0:
                spec = machine.fresh()
                own = spec.joint(name)
                setattr(own, field, np.asarray(getattr(own, field)) * (1 + _STEP))
                yield _nuisance(f"{field} of {name}", balance.edited(spec), balance, width / _STEP)
        one, nothing = np.eye(count)[joint], np.zeros((3, count, count))
        constant = tolerances.offset * machine.load_scales[joint] * np.ones((len(balance.drive), 1))
        yield Nuisance(name=f"constant torque at {name}", change=constant * one, operator=nothing)
        inverse = (balance.forms == "inverse") & balance.seen[:, joint]
        if inverse.any():
            gain = np.where(inverse, balance.needed[:, joint], 0.0)[:, None] * one
            yield Nuisance(
                name=f"torque constant of {name}",
                change=tolerances.torque * gain,
                operator=tolerances.torque * balance.operator * one[:, None],
            )
            rates = [
                np.gradient(run, balance.motion.step)
                for run in balance.motion.split(balance.drive[:, joint])
            ]
            rate = np.where(inverse, np.concatenate(rates), 0.0)[:, None] * one
            yield Nuisance(
                name=f"shift of the torque of {name}",
                change=tolerances.shift_samples * balance.motion.runs[0].log_step * rate,
                operator=nothing,
            )


def _drives(balance: Balance, tolerances: Tolerances) -> Iterator[Nuisance]:
    """Gains and command shifts of the actuators."""
    machine = balance.machine
    if balance.released.all():
        return
    for number, name in enumerate(machine.actuators):
        if name in ActuatorGain.locations(machine):
            gain = ActuatorGain(machine, name)
            forces = balance.forces(gain, np.array([1 + _STEP]))
            yield _nuisance(f"gain of {name}", forces, balance, tolerances.torque / _STEP)
            if machine.model.actuator_biasprm[number, 2] != 0:
                spec = machine.fresh()
                own = spec.actuator(name)
                bias = np.array(own.biasprm)
                bias[2] *= 1 + _STEP
                own.biasprm = bias
                scale = tolerances.velocity_gain / _STEP
                yield _nuisance(f"velocity gain of {name}", balance.edited(spec), balance, scale)
        yield Nuisance(
            name=f"shift of the commands of {name}",
            change=tolerances.shift_samples * shifted(balance, [number]),
            operator=np.zeros_like(balance.operator),
        )


def shifted(balance: Balance, actuators: list[int]) -> Array:
    """Change of the balance by commands one interval of the log later (T, joints)."""
    motion, late = balance.motion, balance.commands.copy()
    for number in actuators:
        rates = [np.gradient(run, motion.step) for run in motion.split(balance.commands[:, number])]
        late[:, number] -= motion.runs[0].log_step * np.concatenate(rates)
    return balance.given - balance.given_by(late)
