"""Collision checks of poses and paths, between bodies and with a ground plane.

Poses that keep the arm above what it stands on, where the model knows no ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.arms import Arm
from loose_env.instrument.settings.thresholds import ALWAYS_TOUCHING, GROUND_TOLERANCE_M
from loose_env.typing import Array

_LOOKED = 64
"""Random poses in which pairs of shapes are checked."""
_STEP = 0.1
"""Largest move of a joint between two checks of a path [rad or m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Collisions:
    """Collision checker; joints outside the chain stay at the model's reference."""

    model: mujoco.MjModel | None
    """The compiled model with its shapes; None where it cannot be compiled with them."""
    addresses: NDArray[np.intp]
    """Indices of the joints in its ``qpos`` (n,)."""
    usual: frozenset[tuple[int, int]]
    """Pairs of shapes that touch at the model's reference or nearly always."""
    unseen: tuple[str, ...] = ()
    """Moving bodies without a shape: their contacts are unknown."""

    @classmethod
    def of(cls, spec: mujoco.MjSpec, joints: Sequence[str]) -> Collisions:
        """Build a checker; shapes whose files are missing are dropped.

        Examples
        --------
        >>> spec = mujoco.MjSpec.from_string('''<mujoco><worldbody>
        ... <geom type="plane" size="1 1 .1"/><body pos="0 0 .3"><joint name="j" axis="0 1 0"/>
        ... <geom type="capsule" size=".02" fromto=".1 0 0 .5 0 0"/></body></worldbody></mujoco>''')
        >>> look = Collisions.of(spec, ["j"])
        >>> look.touch([0.0]), len(look.touch([1.2]))
        ((), 1)
        """
        model = _compiled(spec, joints)
        if model is None or not cls._shapes(model):
            return cls(model=None, addresses=np.zeros(0, dtype=np.intp), usual=frozenset())
        unseen = _without_shapes(model, joints)
        at = np.array([int(model.joint(j).qposadr[0]) for j in joints], dtype=np.intp)
        bare = cls(model=model, addresses=at, usual=frozenset())
        rng = np.random.default_rng(0)  # the same file always gives the same pairs
        ids = [int(model.joint(j).id) for j in joints]
        low, high = np.full(len(ids), -np.pi), np.full(len(ids), np.pi)
        for k, j in enumerate(ids):
            if model.jnt_limited[j]:
                low[k], high[k] = model.jnt_range[j]
        counts: dict[tuple[int, int], int] = {}
        for _ in range(_LOOKED):
            for pair in bare._pairs(low + (high - low) * rng.random(len(ids))):
                counts[pair] = counts.get(pair, 0) + 1
        often = {pair for pair, count in counts.items() if count >= ALWAYS_TOUCHING * _LOOKED}
        usual = frozenset(often | bare._pairs(model.qpos0[at]))
        return cls(model=model, addresses=at, usual=usual, unseen=unseen)

    @staticmethod
    def _shapes(model: mujoco.MjModel) -> bool:
        """True if any two shapes of the model can collide."""
        return bool(np.any(model.geom_contype) and np.any(model.geom_conaffinity))

    @property
    def known(self) -> bool:
        """True if the model defines collision geometry."""
        return self.model is not None

    def touch(self, pose: ArrayLike) -> tuple[str, ...]:
        """Describe pairs of bodies in unintended contact in a pose."""
        if self.model is None:
            return ()
        body = self.model.geom_bodyid
        found = []
        for one, other in sorted(self._pairs(np.asarray(pose, dtype=float)) - self.usual):
            names = [self.model.body(int(body[g])).name or "world" for g in (one, other)]
            found.append(" and ".join(names))
        return tuple(dict.fromkeys(found))

    def touch_between(self, start: ArrayLike, end: ArrayLike) -> tuple[str, ...]:
        """Colliding pairs on the straight joint-space path between two poses."""
        if self.model is None:
            return ()
        first, last = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        steps = max(1, int(np.ceil(np.abs(last - first).max() / _STEP)))
        for k in range(1, steps + 1):
            found = self.touch(first + (last - first) * k / steps)
            if found:
                return found
        return ()

    def _pairs(self, pose: Array) -> set[tuple[int, int]]:
        assert self.model is not None
        data = mujoco.MjData(self.model)
        data.qpos[self.addresses] = pose
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_collision(self.model, data)
        contacts = data.contact
        return {
            (int(min(pair)), int(max(pair)))
            for pair, apart in zip(contacts.geom, contacts.dist, strict=True)
            if apart < 0
        }


def _without_shapes(model: mujoco.MjModel, joints: Sequence[str]) -> tuple[str, ...]:
    """Moving bodies without collision shapes, including all that is fixed to them."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    shaped = set(model.body_weldid[model.geom_bodyid[solid]].tolist())
    moved = [int(model.jnt_bodyid[model.joint(joint).id]) for joint in joints]
    return tuple(model.body(b).name for b in moved if int(model.body_weldid[b]) not in shaped)


def _compiled(spec: mujoco.MjSpec, joints: Sequence[str]) -> mujoco.MjModel | None:
    """Compiled model with its shapes, without meshes where files are missing."""
    spec.compiler.fusestatic = False
    for with_meshes in (True, False):
        trial = spec.copy()
        if not with_meshes:
            for geom in list(trial.geoms):
                if geom.type in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD):
                    trial.delete(geom)
        try:
            model = trial.compile()
        except Exception:  # MuJoCo raises ValueError and mujoco.FatalError alike
            continue
        names = {model.joint(j).name for j in range(model.njnt)}
        return model if set(joints) <= names else None
    return None


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """Ground plane normal to gravity that links and tool stay above."""

    arm: Arm
    """The arm."""
    height: float
    """Of the plane, against gravity from the model's origin [m]; -inf for no ground."""

    @classmethod
    def of(cls, arm: Arm, height: float | None = None) -> Ground:
        """Ground at a height [m], or at the model's origin for an upright arm.

        An arm that hangs, its second joint below its first, gets no ground by itself, nor one
        without gravity.

        Examples
        --------
        >>> import numpy as np
        >>> from loose_env.arms import six_axis
        >>> ground = Ground.of(six_axis())
        >>> ground.clear(np.array([0.0, -1.5, 1.5, 0.0, 0.5, 0.0]))
        True
        """
        if height is not None:
            return cls(arm=arm, height=float(height))
        if not np.any(arm.model.opt.gravity):
            return cls(arm=arm, height=-np.inf)
        bare = cls(arm=arm, height=-np.inf)
        points, first = bare._heights(arm.model.qpos0[arm.pose_addresses])
        if points[0] < first - GROUND_TOLERANCE_M:
            return bare  # the second joint is below the first
        return cls(arm=arm, height=min(0.0, first))

    def clear(self, pose: Array) -> bool:
        """True if links beyond the first and the tool are above the ground."""
        if np.isneginf(self.height):
            return True
        return bool((self._heights(pose)[0] >= self.height - GROUND_TOLERANCE_M).all())

    def clear_between(self, start: Array, end: Array) -> bool:
        """True if the straight joint-space path between two poses is above the ground.

        An arm that stands below it is let out, and not in again.
        """
        if np.isneginf(self.height):
            return True
        steps = max(1, int(np.ceil(np.abs(end - start).max() / _STEP)))
        clear = [self.clear(start + (end - start) * k / steps) for k in range(steps + 1)]
        return all(clear[clear.index(True) :]) if any(clear) else False

    def _heights(self, pose: Array) -> tuple[Array, float]:
        """Heights of the links beyond the first and the tool, and of the first [m]."""
        model = self.arm.model
        data = mujoco.MjData(model)
        data.qpos[self.arm.pose_addresses] = pose
        mujoco.mj_kinematics(model, data)
        up = -model.opt.gravity / max(float(np.linalg.norm(model.opt.gravity)), 1e-9)
        first, *others = [data.body(name).xpos for name in self.arm.seat_bodies]
        points = np.array([*others, data.site(self.arm.tool).xpos])
        return points @ up, float(first @ up)
