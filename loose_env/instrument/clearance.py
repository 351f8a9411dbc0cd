"""Collision checks of poses and paths, between bodies and with a ground plane.

Poses that keep the arm above what it stands on, where the model knows no ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.typing import Array, IndexArray

_LOOKED = 64
"""Random poses in which pairs of shapes are checked."""
ALWAYS_TOUCHING = 0.9
"""Share of random poses from which two shapes that touch are neighbours by design [1]."""
GROUND_TOLERANCE_M = 5e-3
"""Rounding of a model's heights [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Collisions:
    """Collision checker; joints outside the chain stay at the model's reference."""

    model: mujoco.MjModel | None
    """The compiled model with its shapes; None where it cannot be compiled with them."""
    addresses: IndexArray
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

    model: mujoco.MjModel
    addresses: IndexArray
    """Indices of the joints in its ``qpos`` (n,)."""
    links: Sequence[int]
    """Bodies that the joints move, base first."""
    site: str
    """Site of the tool."""
    height: float
    """Of the plane, against gravity from the model's origin [m]; -inf for no ground."""

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        addresses: IndexArray,
        links: Sequence[int],
        site: str,
        height: float | None = None,
    ) -> Ground:
        """Ground at a height [m], or at the model's origin for an upright arm.

        An arm that hangs, its second joint below its first, gets no ground by itself, nor one
        without gravity.
        """
        bare = cls(model=model, addresses=addresses, links=links, site=site, height=-np.inf)
        if height is not None:
            return replace(bare, height=float(height))
        if not np.any(model.opt.gravity):
            return bare
        points, first = bare._heights(model.qpos0[addresses])
        if points[0] < first - GROUND_TOLERANCE_M:
            return bare  # the second joint is below the first
        return replace(bare, height=min(0.0, first))

    def clear(self, pose: Array) -> bool:
        """True if links beyond the first and the tool are above the ground."""
        if np.isneginf(self.height):
            return True
        return bool((self._heights(pose)[0] >= self.height - GROUND_TOLERANCE_M).all())

    def _heights(self, pose: Array) -> tuple[Array, float]:
        """Heights of the links beyond the first and the tool, and of the first [m]."""
        data = mujoco.MjData(self.model)
        data.qpos[self.addresses] = pose
        mujoco.mj_kinematics(self.model, data)
        gravity = self.model.opt.gravity
        up = -gravity / max(float(np.linalg.norm(gravity)), 1e-9)
        first, *others = [data.body(int(b)).xpos for b in self.links]
        points = np.array([*others, data.site(self.site).xpos])
        return points @ up, float(first @ up)
