"""Joints that equality constraints carry along with others: couplings and closed loops.

Along a motion that keeps the constraints the speeds of followers are linear in those of the other
joints. By the principle of virtual work the forces on followers act at the others by the transpose
of the same matrix, and the forces of the constraints drop out.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

_STEPS = 20
"""Steps of Gauss and Newton to the loop, at most; each sample begins where the last one ended."""
_CLOSED = 1e-9
"""Distance of constraints from zero at which they are kept [m, rad]."""
_OPEN = 1e-3
"""Distance beyond which a measured motion does not keep them [m, rad]."""
_RANK = 1e-6
"""Share of the largest singular value, below which a constraint repeats another one."""


@dataclass(frozen=True, eq=False)
class Followers:
    """Followers of a model, the equality constraints that carry them, and their paths."""

    machine: NominalModel
    numbers: tuple[int, ...] = ()
    """Followers by their number among the joints: those without a reading or a drive first."""

    @classmethod
    def of(cls, machine: NominalModel, read: Collection[str]) -> Followers:
        """Choose the followers of a model of which the positions of some joints are read."""
        if not machine.model.neq:
            return cls(machine)
        own = cls(machine)
        _, slope = own._constraints(own._placed(machine.model.qpos0.copy(), ()))
        driven = set(machine.actuated_joint.values())
        order = sorted(range(len(machine.joints)), key=lambda k: (
            machine.joints[k] in read, machine.joints[k] in driven, -k
        ))  # fmt: skip
        chosen: list[int] = []
        for k in order:
            if _rank(slope[:, [*chosen, k]]) > len(chosen):
                chosen.append(k)
        return cls(machine, tuple(sorted(chosen)))

    def fill(self, run: str, position: Array, unread: Sequence[int]) -> None:
        """Set the positions (T, joints) of followers without a reading, so that loops close.

        Raises
        ------
        InvalidData
            If a joint without a reading is no follower, or the others keep no loop closed.
        """
        lost = [self.machine.joints[k] for k in unread if k not in self.numbers]
        if lost:
            raise InvalidData(
                f"{run}: joint {lost[0]!r} has no position reading; the motion of every joint is "
                "needed to say which force was missing along it, but of those that an equality "
                "constraint carries along"
            )
        last = self.machine.model.qpos0.copy()
        for row in position if unread else ():
            row[list(unread)] = last[list(unread)]
            last = row[:] = self._placed(row, unread)
            off = float(np.abs(self._constraints(row)[0]).max())
            if off > _OPEN:
                names = ", ".join(self.machine.joints[k] for k in unread)
                raise InvalidData(
                    f"{run}: the model's equality constraints do not close at the measured "
                    f"positions, by {off:.3g} m or rad; they place {names}: check the positions' "
                    "zeros and the constraints"
                )

    def paths(self, position: Array) -> Array:
        """Speed of each follower per speed of each other joint along a motion (T, P, joints)."""
        found = np.zeros((len(position), len(self.numbers), position.shape[1]))
        own = list(self.numbers)
        rest = [k for k in range(position.shape[1]) if k not in self.numbers]
        for k, row in enumerate(position if own else ()):
            slope = self._constraints(row)[1]
            found[k][:, rest] = -np.linalg.pinv(slope[:, own], rcond=_RANK) @ slope[:, rest]
        return found

    def _constraints(self, position: Array) -> tuple[Array, Array]:
        """Distances of the equality constraints from zero (C,), and their Jacobian (C, joints)."""
        model, data = self._scratch()
        data.qpos[:] = position
        mujoco.mj_fwdPosition(model, data)
        jacobian = data.efc_J.reshape(-1, model.nv)
        return data.efc_pos[: data.ne].copy(), jacobian[: data.ne].copy()

    def _scratch(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        cache = self.machine.__dict__
        if "_followers" not in cache:
            model = self.machine.spec.copy().compile()
            model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
            off = mujoco.mjtDisableBit
            model.opt.disableflags |= int(off.mjDSBL_CONTACT | off.mjDSBL_LIMIT)
            cache["_followers"] = model, mujoco.MjData(model)
        return cache["_followers"]  # type: ignore[no-any-return]

    def _placed(self, position: Array, free: Sequence[int]) -> Array:
        """Position with some joints moved to where the constraints are kept; all by default."""
        own = list(free) or list(range(len(position)))
        for _ in range(_STEPS):
            off, slope = self._constraints(position)
            if not len(off) or np.abs(off).max() < _CLOSED:
                break
            position = position.copy()
            position[own] -= np.linalg.pinv(slope[:, own], rcond=_RANK) @ off
        return position


def _rank(slope: Array) -> int:
    values = np.linalg.svd(slope, compute_uv=False)
    return int(np.count_nonzero(values > _RANK))
