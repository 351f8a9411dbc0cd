"""Structural-looseness effect: a link that slides on its seat within a clearance with stops.

The direction of the slide is estimated from accelerometer residuals at the tool. The response of
the tool to a slide is known from the model: the tool moves with the link, and the joints, which no
drive holds at the frequencies of an impact, move by their inertia. Seen through that response, the
residual of the loose link has one axis in all poses, and that of other links has none. The loose
link was found in this way in the thesis (4.2.2), there with joints at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi
from typing import ClassVar

import mujoco
import numpy as np
from scipy.linalg import eigh

from loose_env.gap.model.data_starts import ResidualAccelerations
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.backlash import SOFTER, stops
from loose_env.gap.model.effects.mjcf.extra_joint import add_extra_joint, keep_motor_side, set_stops
from loose_env.gap.model.effects.mjcf.geometry import frame_about, normal_of, reach_of
from loose_env.gap.model.effects.mjcf.joint_effect import added_name
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array

_GRAVITY = 9.81
"""Usual load of a seat, over the mass on it [m/s²]."""
_MOST_JOINTS = 3
"""Joints of a link beside which there is room for slides: a body has six at most."""
_STARTS = (1e-4, 6e-4)
"""Gaps from which fits start, as shares of the reach."""
_GAPS = (3e-5, 6e-5, 1.2e-4, 2.5e-4, 5e-4, 1e-3)
"""The same where the direction is known."""
_FRICTIONS = (0.1, 0.5)
"""Frictions from which fits start then, over a usual one."""


class StructuralLooseness(Effect):
    """Structural looseness: a slide behind the link's joint, with stops and friction.

    Its direction is fixed in the link. In a machine that moves in a plane it lies in that plane, at
    ``angle`` from the body's axis nearest to it; in space ``azimuth`` counts about the body's z
    axis from its x axis, and ``elevation`` from the plane of both.
    """

    kind = "structural_looseness"
    acts_on: ClassVar[str] = "link"
    limit: ClassVar[tuple[tuple[str, str], ...]] = (("friction", "high"),)
    adds_motion: ClassVar[bool] = True
    needs_fine_steps: ClassVar[bool] = True
    has_stops: ClassVar[bool] = True

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return links with room for another joint."""
        count = machine.model.body_jntnum
        return tuple(n for n in machine.links if count[machine.model.body(n).id] <= _MOST_JOINTS)

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        normal = normal_of(machine)
        self._plane: Array | None = None
        if normal is not None:
            data = mujoco.MjData(machine.model)
            mujoco.mj_kinematics(machine.model, data)
            self._plane = frame_about(data.body(where).xmat.reshape(3, 3).T @ normal)[1:]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Direction, clearance, friction, stiffness of the stops, damping ratio on them."""
        turn = dict(unit="rad", low=-2 * pi, high=2 * pi, scale=0.5)
        names = ("angle",) if self._plane is not None else ("azimuth", "elevation")
        length, force = reach_of(self.machine), 1.0 / self._mean_weight
        return (
            *(Parameter(name=name, **turn) for name in names),  # type: ignore[arg-type]
            Parameter(
                name="gap", unit="m", low=1e-5 * length, high=0.05 * length, scale=1e-3 * length,
                log=True,
            ),
            Parameter(
                name="friction", unit="N", low=1e-3 * force, high=100 * force, scale=force, log=True
            ),
            *stops(self._mean_weight, self.machine.time_step, "N/m"),
        )  # fmt: skip

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: directions all round, a small and a larger clearance, little friction."""
        length = reach_of(self.machine)
        _, friction, stiffness, ratio = self.parameters[-4:]
        rests = [
            (share * length, 0.3 * friction.scale, stiffness.scale, ratio.scale)
            for share in _STARTS
        ]
        if self._plane is not None:
            return tuple((turn, *rest) for rest in rests for turn in (0.0, pi / 3, 2 * pi / 3))
        tilt = 0.55  # of the six axes of an icosahedron, one of them moved to z
        axes = (*((2 * pi * k / 5, tilt) for k in range(5)), (0.0, pi / 2))
        return tuple((*axis, *rest) for rest in rests for axis in axes)

    def propose_along(self, residual: ResidualAccelerations) -> tuple[tuple[float, ...], ...]:
        """Propose the direction that explains the residual, with a range of clearances.

        A fit converges to the direction of a slide only from nearby, and to the clearance within a
        factor of two.
        """
        axis = slide_axis(self._slides, residual)
        if axis is None:
            return ()
        if self._plane is not None:
            x, y = self._plane @ axis
            angles: tuple[float, ...] = (float(np.arctan2(y, x)),)
        else:
            x, y, z = axis
            angles = (float(np.arctan2(y, x)), float(np.arcsin(np.clip(z, -1.0, 1.0))))
        length = reach_of(self.machine)
        _, friction, stiffness, ratio = (p.scale for p in self.parameters[-4:])
        return tuple(
            (*angles, gap * length, share * friction, softer * stiffness, ratio)
            for softer in SOFTER
            for gap in _GAPS
            for share in _FRICTIONS
        )

    def direction(self, values: Array) -> Array:
        """Unit vector (3,) of the slide, in the body's frame."""
        if self._plane is not None:
            return np.asarray(np.array([np.cos(values[0]), np.sin(values[0])]) @ self._plane)
        azimuth, up = values[0], values[1]
        flat = np.cos(up)
        return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(up)])

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add the slide behind the link's joints."""
        self._keep_rotors(spec)
        direction = self.direction(values)
        gap, friction, stiffness, ratio = (float(v) for v in values[-4:])
        joint = add_extra_joint(
            spec.body(self.where),
            added_name(spec, self.where, self.kind),
            turns=False,
            axis=direction,
            pos=np.zeros(3),
            friction=friction,
            step=spec.option.timestep,
        )
        weight = self._weight(direction)
        # The same contact mode in every direction.
        set_stops(
            joint,
            0.5 * gap,
            stiffness=stiffness * self._mean_weight / weight,
            ratio=ratio,
            weight=weight,
            load=_GRAVITY / weight,
        )

    def _keep_rotors(self, spec: mujoco.MjSpec) -> None:
        """Keep inertia on the drive's side of a slide, whose added one may lie along it."""
        machine = self.machine
        body = machine.model.body(self.where).id
        for joint, owner in zip(machine.joints, machine.model.jnt_bodyid, strict=True):
            if owner == body and not machine.turns(joint):
                keep_motor_side(machine, spec, joint, machine.inertia(joint))

    @cached_property
    def _slides(self) -> Slides:
        """Build the arm with slides along the body's three axes."""
        spec = self.machine.fresh()
        self._keep_rotors(spec)
        names = tuple(added_name(spec, self.where, axis) for axis in "xyz")
        body = spec.body(self.where)
        for name, axis in zip(names, np.eye(3), strict=True):
            add_extra_joint(body, name, turns=False, axis=axis, pos=np.zeros(3))
        return Slides(model=spec.compile(), names=names)

    @cached_property
    def _mass(self) -> tuple[Array, list[int], list[int]]:
        """Mass matrix with slides along the body's three axes, with DOF indices."""
        slides = self._slides
        data = mujoco.MjData(slides.model)
        mujoco.mj_forward(slides.model, data)
        return slides.mass(data), slides.own, slides.added

    def _weight(self, direction: Array) -> float:
        """Inverse of the mass on the slide [1/kg], all joints free."""
        mass, own, added = self._mass
        basis = np.zeros((len(mass), len(own) + 1))
        basis[own, np.arange(len(own))] = 1.0
        basis[added, -1] = direction
        return float(np.linalg.inv(basis.T @ mass @ basis)[-1, -1])

    @cached_property
    def _mean_weight(self) -> float:
        axes = np.eye(3) if self._plane is None else self._plane
        return float(np.exp(np.mean([np.log(self._weight(axis)) for axis in axes])))


_SLIGHT = 1e-3
"""Share of the largest response that a direction has to show to be told at all."""


@dataclass(frozen=True, eq=False)
class Slides:
    """An arm with one link that can slide along three axes."""

    model: mujoco.MjModel
    """The arm, slides included."""
    names: tuple[str, ...]
    """Joints of the slides, along the link's x, y, z."""

    @cached_property
    def added(self) -> list[int]:
        """Indices of the slides among the degrees of freedom."""
        return [int(self.model.joint(name).dofadr[0]) for name in self.names]

    @cached_property
    def own(self) -> list[int]:
        """Indices of all other degrees of freedom."""
        return [k for k in range(self.model.nv) if k not in self.added]

    def mass(self, data: mujoco.MjData) -> Array:
        """Mass matrix (nv, nv) in an evaluated pose."""
        found = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, found)
        return found

    def response(self, data: mujoco.MjData, site: int) -> Array:
        """Acceleration of a site in its own frame (3, 3) per acceleration of each slide."""
        mass = self.mass(data)
        moved = np.zeros((self.model.nv, 3))
        moved[self.added] = np.eye(3)
        moved[self.own] = -np.linalg.solve(
            mass[np.ix_(self.own, self.own)], mass[np.ix_(self.own, self.added)]
        )
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, data, jacobian, None, site)
        return np.asarray(data.site_xmat[site].reshape(3, 3).T @ jacobian @ moved)


def slide_axis(slides: Slides, residual: ResidualAccelerations) -> Array | None:
    """Direction of the slide that explains most of the accelerometer residuals.

    Maximum ratio of the power along the slide's response to the largest possible, sample by sample:
    a generalised eigenvalue problem.
    """
    model = slides.model
    data = mujoco.MjData(model)
    places = [int(model.joint(name).qposadr[0]) for name in residual.joints]
    along, size = np.zeros((3, 3)), np.zeros((3, 3))
    for pose, name, shaken in zip(
        residual.poses, residual.sites, residual.accelerations, strict=True
    ):
        data.qpos[:] = model.qpos0
        data.qpos[places] = pose
        mujoco.mj_fwdPosition(model, data)
        response = slides.response(data, model.site(name).id)
        seen = response.T @ shaken
        along += np.outer(seen, seen)
        size += float(shaken @ shaken) * response.T @ response
    largest = float(np.linalg.eigvalsh(size)[-1])
    if not np.isfinite(largest) or largest <= 0:
        return None
    _, axes = eigh(along, size + _SLIGHT * largest * np.eye(3))
    return np.asarray(axes[:, -1] / np.linalg.norm(axes[:, -1]))
