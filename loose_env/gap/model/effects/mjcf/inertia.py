"""Explicit mass, centre and inertia of a body of an MJCF spec, read and written."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass distribution of a body."""

    mass: float
    """Mass [kg]."""
    centre: Array
    """Centre of mass, in the body's frame [m] (3,)."""
    tensor: Array
    """Inertia about the centre, along the body's axes [kg·m²] (3, 3)."""


def inertial_of(machine: NominalModel, spec: mujoco.MjSpec, body: str) -> Inertial:
    """Read a body of a spec; mass from geoms is taken from the compiled model."""
    own = spec.body(body)
    taken = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if own.explicitinertial and not taken:
        full = np.array(own.fullinertia)
        if np.isfinite(full).all() and full[0] > 0:
            xx, yy, zz, xy, xz, yz = full
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            number = machine.model.body(body).id
            oriented = own.ialt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT
            quat = machine.model.body_iquat[number] if oriented else np.array(own.iquat)
            axes = Rotation.from_quat(quat, scalar_first=True).as_matrix()
            tensor = axes @ np.diag(np.array(own.inertia)) @ axes.T
        # A centre that was not given lies at the body's origin.
        return Inertial(float(own.mass), np.nan_to_num(np.array(own.ipos)), tensor)
    model = machine.model
    number = model.body(body).id
    axes = Rotation.from_quat(model.body_iquat[number], scalar_first=True).as_matrix()
    return Inertial(
        float(model.body_mass[number]),
        np.array(model.body_ipos[number]),
        axes @ np.diag(model.body_inertia[number]) @ axes.T,
    )


def set_inertial(machine: NominalModel, spec: mujoco.MjSpec, body: str, inertial: Inertial) -> None:
    """Write a body's mass, centre and inertia, overriding its geoms."""
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        # Geoms would override explicit values: all bodies get those from their geoms.
        every = [b.name for b in spec.bodies if b.name and b.name != "world"]
        kept = {name: inertial_of(machine, spec, name) for name in every if name != body}
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        for name, own in kept.items():
            if own.mass > 0:
                _write(spec.body(name), own)
    _write(spec.body(body), inertial)


def _write(body: mujoco.MjsBody, inertial: Inertial) -> None:
    moments, axes = np.linalg.eigh(inertial.tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    # Of a flat body the largest moment is the sum of the others; rounding must not exceed it.
    moments[2] = min(moments[2], (moments[0] + moments[1]) * (1 - 1e-15))
    x, y, z, w = Rotation.from_matrix(axes).as_quat()
    body.mass, body.ipos = inertial.mass, inertial.centre
    body.iquat, body.inertia = [w, x, y, z], moments
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.fullinertia = np.full(6, np.nan)
    body.explicitinertial = True


def steiner(mass: float, lever: Array) -> Array:
    """Inertia (3, 3) [kg·m²] of a point mass [kg] at a lever (3,) [m].

    Examples
    --------
    >>> steiner(2.0, np.array([0.0, 0.0, 3.0])).diagonal()
    array([18., 18.,  0.])
    """
    return mass * (lever @ lever * np.eye(3) - np.outer(lever, lever))
