"""Frequency response of a healthy arm to the force of its shaker, in closed form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import COIL, Arm, add_shaker, inertance_rate, place_shaker
from loose_env.typing import Array, ComplexArray


@dataclass(frozen=True, kw_only=True)
class ShakenResponse:
    """Accelerations per unit force of the shaker, over the band."""

    frequency: Array
    """Frequencies [Hz] (K,)."""
    tool: ComplexArray
    """Tool acceleration in the tool frame [m/s² per N] (K, d)."""
    probes: Mapping[str, ComplexArray]
    """Acceleration of every probe along its own axes [m/s² per N] (K, 3)."""

    def covariances(self, probe: str, axis: int) -> tuple[float, Array, Array]:
        """Covariances that white force over the band gives."""
        x, a = self.probes[probe][:, axis], self.tool
        count = len(self.frequency)
        return (
            float(np.mean(np.abs(x) ** 2)),
            np.asarray((x.conj() @ a).real / count),
            np.asarray((a.conj().T @ a).real / count),
        )


class ShakenArm:
    """A healthy arm on its shaker, linearised wherever it is asked to be.

    ``points``: number of frequencies across the arm's band.
    """

    def __init__(self, arm: Arm, *, points: int = 400) -> None:
        assert arm.shaker is not None
        self.arm, self.shaker = arm, arm.shaker
        spec = arm.spec.copy()
        add_shaker(spec, arm.shaker)
        self.model = spec.compile()
        self.frequency = np.linspace(*arm.band, points)

    def at(self, pose: ArrayLike) -> ShakenResponse:
        """Give the answer at a pose [rad or m] (n,)."""
        arm, model = self.arm, self.model
        data = mujoco.MjData(model)
        data.qpos[[model.joint(name).qposadr[0] for name in arm.joints]] = pose
        place_shaker(model, data, self.shaker)
        mujoco.mj_forward(model, data)
        omega = 2 * np.pi * self.frequency
        force = np.zeros((model.nv, 1), dtype=complex)
        force[model.joint("shaker").dofadr[0]] = 1.0
        motion = np.linalg.solve(
            self._stiffness(data, omega), np.broadcast_to(force, (len(omega), *force.shape))
        )
        acceleration = -(omega**2)[:, None] * motion[..., 0]

        def moves(site: str) -> ComplexArray:
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, jacobian, None, model.site(site).id)
            frame = data.site(site).xmat.reshape(3, 3)
            return np.asarray(acceleration @ (frame.T @ jacobian).T)

        return ShakenResponse(
            frequency=self.frequency,
            tool=moves(arm.tool)[:, list(arm.axes)],
            probes={site: moves(site) for site in arm.probe_sites},
        )

    def _stiffness(self, data: mujoco.MjData, omega: Array) -> ComplexArray:
        """Dynamic stiffness of every degree of freedom (K, nv, nv)."""
        arm, model = self.arm, self.model
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        stiffness = np.diag(model.jnt_stiffness[model.dof_jntid]).astype(float)
        damping = np.diag(model.dof_damping).astype(float)
        for j, name in enumerate(arm.joints):
            dof = model.joint(name).dofadr[0]
            stiffness[dof, dof] += arm.centring.stiffness[j]
            damping[dof, dof] += arm.centring.damping[j]
            if j != self.shaker.joint - 1:
                stiffness[dof, dof] += arm.holding.stiffness[j]
                damping[dof, dof] += arm.holding.damping[j]
                mass[dof, dof] += arm.holding.stiffness[j] / inertance_rate(arm.timestep) ** 2
        stinger = _stinger_row(model, data)
        stiffness += self.shaker.stinger_stiffness * np.outer(stinger, stinger)
        damping += self.shaker.stinger_damping * np.outer(stinger, stinger)
        s = 1j * omega[:, None, None]
        return np.asarray(stiffness + s * damping + s**2 * mass)


def _stinger_row(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Change of the stinger's length per motion of each degree of freedom (nv,)."""
    ends = np.zeros((2, 3, model.nv))
    for end, site in zip(ends, (COIL, "stinger_end"), strict=True):
        mujoco.mj_jacSite(model, data, end, None, model.site(site).id)
    along = data.site("stinger_end").xpos - data.site(COIL).xpos
    return np.asarray((along / np.linalg.norm(along)) @ (ends[1] - ends[0]))
