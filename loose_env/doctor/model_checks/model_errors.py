"""Torque variance left by the best single model error, rival of an alternative reading.

Each is linear in coefficients c that are bounded, tau = ID(q) + B c, beside friction, rotor inertia
and an offset of each joint: mass within a link's reach and its own mass, the masses of all links, a
drive's gain, a spring at a joint, the zero of an encoder, and a base that is not level.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.optimize import lsq_linear

from loose_env.doctor.channels import Machine
from loose_env.doctor.model_checks.torque_fit import (
    TorqueData,
    measured_positions,
    measured_torque,
    needed_torque,
    nuisance,
    share_left,
)
from loose_env.doctor.thresholds import LARGEST_GAIN, LARGEST_ZERO_RAD, TURNED_GRAVITY_DEG
from loose_env.typing import Array

_SMALL = 1e-4
"""Change of a position for its derivative [rad or m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Error:
    """Torque by each coefficient of an error (E, J, C), with the coefficients' bounds (C,)."""

    torque: Array
    low: Array
    high: Array


def left_by_model_errors(machine: Machine, data: TorqueData, dofs: list[int]) -> float:
    """Share of the torque's variance that the best single error of the model leaves [1]."""
    needed, speed, change = needed_torque(machine, data, dofs)
    measured = measured_torque(data)
    spread = np.maximum(measured.std(axis=0), 1e-12 * measured.std() + 1e-300)
    bases = [
        np.linalg.qr(nuisance(v, a))[0] for v, a in zip(speed.T, change.T, strict=True)
    ]  # what friction and rotor inertia explain

    def beyond(columns: Array) -> Array:
        rows = [
            (columns[:, j] - basis @ (basis.T @ columns[:, j])) / spread[j]
            for j, basis in enumerate(bases)
        ]
        return np.concatenate(rows)

    right = beyond((measured - needed)[:, :, None])[:, 0]
    best = np.inf
    for error in (
        *_masses(machine, data, dofs),
        *_at_joints(machine, data, dofs, needed),
        _tilt(machine, data, dofs, needed),
    ):
        if np.isfinite(error.torque).all():
            fit = lsq_linear(beyond(error.torque), right, (error.low, error.high))
            best = min(best, share_left(measured, needed + error.torque @ fit.x, speed, change))
    return best


def _masses(machine: Machine, data: TorqueData, dofs: list[int]) -> Iterator[_Error]:
    """Mass added at points of a link, or taken from its own; own masses of all links."""
    model = machine.model
    bare = copy.copy(model)
    bare.body_mass[:], bare.body_inertia[:] = 0.0, 0.0
    without = needed_torque(machine, data, dofs, bare)[0]

    def torque(changed: mujoco.MjModel) -> Array:
        return needed_torque(machine, data, dofs, changed)[0] - without

    own = []
    for link in np.unique(model.body_weldid[model.body_weldid > 0]):
        parts = np.flatnonzero(model.body_weldid == link)
        whole = copy.copy(bare)
        whole.body_mass[parts] = model.body_mass[parts]
        whole.body_inertia[parts] = model.body_inertia[parts]
        own.append(torque(whole))
        columns = [own[-1]]
        for point in _points(model, int(link)):
            loaded = copy.copy(bare)
            loaded.body_mass[link], loaded.body_ipos[link] = 1.0, point
            columns.append(torque(loaded))
        low = np.zeros(len(columns))
        low[0] = -1.0
        yield _Error(torque=np.stack(columns, axis=2), low=low, high=np.full(len(columns), np.inf))
    if own:
        low, high = np.full(len(own), -1.0), np.full(len(own), np.inf)
        yield _Error(torque=np.stack(own, axis=2), low=low, high=high)


def _points(model: mujoco.MjModel, link: int) -> Array:
    """Centre of mass of a link and six points about it, as far as the link reaches [m]."""
    engine = mujoco.MjData(model)
    mujoco.mj_kinematics(model, engine)
    parts = np.flatnonzero(model.body_weldid == link)
    outside = np.flatnonzero(np.isin(model.body_parentid, parts))
    at = [engine.xpos[link], *engine.xpos[outside], *engine.xipos[parts]]
    at += [*engine.site_xpos[np.isin(model.site_bodyid, parts)]]
    centre = engine.xipos[link]
    reach = max(float(np.linalg.norm(point - centre)) for point in at)
    inertia = float(model.body_inertia[link].max()) / max(float(model.body_mass[link]), 1e-9)
    around = max(reach, float(np.sqrt(inertia))) * np.concatenate([np.eye(3), -np.eye(3)])
    return np.asarray(model.body_ipos[link] + np.concatenate([np.zeros((1, 3)), around]))


def _at_joints(
    machine: Machine, data: TorqueData, dofs: list[int], needed: Array
) -> Iterator[_Error]:
    """A drive's gain, a spring, and an encoder's zero, at one joint each."""
    positions = measured_positions(data)
    addresses = [int(machine.model.jnt_dofadr[machine.model.joint(j).id]) for j in machine.joints]
    for k, joint in enumerate(machine.joints):
        moved = replace(data, positions=[q + _SMALL * _unit(q, k) for q in data.positions])
        slope = (needed_torque(machine, moved, dofs)[0] - needed) / _SMALL
        zero = LARGEST_ZERO_RAD if machine.hinge(joint) else 0.0
        if zero:
            yield _Error(torque=slope[:, :, None], low=np.array([-zero]), high=np.array([zero]))
        if addresses[k] not in dofs:
            continue
        j = dofs.index(addresses[k])
        for values, low, high in (
            (needed[:, j], 1 / LARGEST_GAIN - 1, LARGEST_GAIN - 1),
            (positions[:, k], 0.0, np.inf),
        ):
            column = np.zeros_like(needed)
            column[:, j] = values
            yield _Error(torque=column[:, :, None], low=np.array([low]), high=np.array([high]))


def _unit(values: Array, k: int) -> Array:
    one = np.zeros(values.shape[1])
    one[k] = 1.0
    return one


def _tilt(machine: Machine, data: TorqueData, dofs: list[int], needed: Array) -> _Error:
    """Gravity off by what a base may be off level."""
    own = machine.model.opt.gravity
    columns = []
    for axis in np.eye(3):
        turned = copy.copy(machine.model)
        turned.opt.gravity[:] = own + axis
        columns.append(needed_torque(machine, data, dofs, turned)[0] - needed)
    most = np.full(3, float(np.linalg.norm(own)) * np.sin(np.radians(TURNED_GRAVITY_DEG)) + 1e-9)
    return _Error(torque=np.stack(columns, axis=2), low=-most, high=most)
