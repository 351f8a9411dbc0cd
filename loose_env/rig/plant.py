"""Compiled true arms with seat, drives, brakes and sensors, and the builder of them."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import (
    Arm,
    LinkSite,
    MismatchDraw,
    MismatchIndices,
    Shaker,
    add_shaker,
    apply_mismatches,
    inertance_rate,
    link_site,
    place_shaker,
    wind_up,
)
from loose_env.faults import (
    Fault,
    SeatIndices,
    SeatKind,
    gaps_of,
    part_seats,
    seat_indices,
    seated_spec,
    set_seat,
)
from loose_env.sensors import LinkAccelerometers, link_choice
from loose_env.typing import Array

__all__ = ["Plant", "PlantIndices", "PlantShop"]

_Seats = tuple[tuple[int, ...], tuple[SeatKind, ...]]


@dataclass(frozen=True, kw_only=True, eq=False)
class PlantIndices:
    """Indices of the parts of an arm under test: the same for all plants of one template."""

    template: mujoco.MjModel
    """The template."""
    mismatch: MismatchIndices
    """What a mismatch changes."""
    position: NDArray[np.intp]
    """Positions of the driven joints (n,)."""
    dofs: NDArray[np.intp]
    """Degrees of freedom of the driven joints (n,)."""
    seat: tuple[SeatIndices, ...]
    """Parts of the seat."""
    seat_positions: NDArray[np.intp]
    """Positions of the parts of the seat."""
    brakes: NDArray[np.intp]
    """Equality constraints that hold the joints (n,)."""
    gears: NDArray[np.intp]
    """Joints of elastic gears."""

    @classmethod
    def of(cls, model: mujoco.MjModel, arm: Arm) -> PlantIndices:
        """Look the parts up by their names."""
        joints = [model.joint(name) for name in arm.joints]
        seat = seat_indices(model)

        def indices(found: Iterable[int]) -> NDArray[np.intp]:
            return np.array(list(found), dtype=np.intp)

        return cls(
            template=model,
            mismatch=MismatchIndices.of(model, arm),
            position=indices(j.qposadr[0] for j in joints),
            dofs=indices(j.dofadr[0] for j in joints),
            seat=seat,
            seat_positions=indices(part.position for part in seat),
            brakes=indices(model.equality(f"hold_{name}").id for name in arm.joints),
            gears=indices(model.joint(name).id for name in arm.gear_joints),
        )


@dataclass(kw_only=True, eq=False)
class Plant:
    """One true arm: its compiled model and the indices of its parts."""

    fault: Fault
    """The fault."""
    mismatch: MismatchDraw
    """How the true arm differs from the nominal one."""
    model: mujoco.MjModel
    """Compiled model with the fault's seat."""
    indices: PlantIndices
    """Indices of its parts."""
    gaps: Array
    """Travel of each part of the seat [m or rad]."""
    shaker: Shaker | None
    """Shaker beside the arm."""

    @property
    def parts(self) -> int:
        """Degrees of freedom of the seat."""
        return len(self.gaps)

    def hold_at(self, pose: np.ndarray) -> np.ndarray:
        """Set brakes, springs and shaker to a commanded pose; return the actual one."""
        true, at = pose + self.mismatch.joint_zero, self.indices
        self.model.eq_data[at.brakes, 0] = true
        self.model.qpos_spring[at.position] = true
        if len(at.gears):
            wind_up(self.model, true, at.position, at.gears)
        if self.shaker is not None:
            data = mujoco.MjData(self.model)
            data.qpos[at.position] = true
            place_shaker(self.model, data, self.shaker)
        return np.asarray(true)


class PlantShop:
    """Builds the plants of one arm, caching the compiled template of every seat.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    timestep : float
        Simulation step [s].
    link_accelerometers : bool or LinkAccelerometers
        Accelerometers on links; True for one at the proximal end of each.
    """

    def __init__(
        self, arm: Arm, *, timestep: float, link_accelerometers: bool | LinkAccelerometers
    ) -> None:
        self.arm = arm
        self.timestep = timestep
        self.link_accelerometers = choice = link_choice(link_accelerometers)
        self.link_sites: tuple[LinkSite, ...] = (
            () if choice is None else tuple(link_site(arm, i, choice.place) for i in choice.on(arm))
        )
        self._templates: dict[_Seats, mujoco.MjModel] = {}
        self._indices: dict[_Seats, PlantIndices] = {}
        self._retired: dict[PlantIndices, list[mujoco.MjModel]] = {}
        self._scratch: dict[int, mujoco.MjData] = {}  # by the number of parts of the seat

    def template(self, links: tuple[int, ...], kinds: tuple[SeatKind, ...]) -> mujoco.MjModel:
        """Compiled model with a seat whose parts stand on links; one layout per number of parts."""
        found = self._templates.get((links, kinds))
        if found is None:
            found = self._templates[links, kinds] = self._compile(links, kinds)
        return found

    def build(self, fault: Fault, mismatch: MismatchDraw) -> Plant:
        """Build the true arm with the seat of its fault; as `build_all`."""
        return self.build_all([fault], [mismatch])[0]

    def build_all(
        self,
        faults: Sequence[Fault],
        mismatches: Sequence[MismatchDraw],
        old: Sequence[Plant] = (),
    ) -> list[Plant]:
        """Build true arms, each with the seat of its fault.

        The models of ``old`` plants of this shop may become theirs: they must not be used again.

        Raises
        ------
        UnknownName
            If a fault names a link or joint the arm does not have, or is no fault.
        """
        seats = [part_seats(fault) for fault in faults]
        for links, _ in seats:
            for link in links:
                self.arm.link_number(link)
        for plant in old:
            self._retired.setdefault(plant.indices, []).append(plant.model)
        plants = [self._bare(*each) for each in zip(faults, mismatches, seats, strict=True)]
        alike: dict[int, list[Plant]] = {}  # models of as many parts have one layout
        for plant in plants:
            alike.setdefault(plant.parts, []).append(plant)
        for members in alike.values():
            self._finish(members)
        return plants

    def _bare(self, fault: Fault, mismatch: MismatchDraw, seats: _Seats) -> Plant:
        """Build an arm with its seat in place, nominal so far."""
        links, kinds = seats
        # A shut seat shows nowhere; the last link's is as good as any.
        links = links or (self.arm.n,)
        template = self.template(links, kinds)
        indices = self._indices.get((links, kinds))
        if indices is None:
            indices = self._indices[links, kinds] = PlantIndices.of(template, self.arm)
        retired = self._retired.get(indices)
        if retired:  # all that tells plants of a template apart is written anew
            model = retired.pop()
            model.jnt_axis[:], model.jnt_pos[:] = template.jnt_axis, template.jnt_pos
        else:
            model = copy.copy(template)
        return Plant(
            fault=fault,
            mismatch=mismatch,
            model=model,
            indices=indices,
            gaps=np.array(gaps_of(fault)),
            shaker=self.arm.shaker,
        )

    def _finish(self, plants: Sequence[Plant]) -> None:
        """Write mismatches, seats and brakes into the models of arms of one layout."""
        arm, models = self.arm, [plant.model for plant in plants]
        indices, draws = [plant.indices for plant in plants], [plant.mismatch for plant in plants]
        parts = plants[0].parts
        if parts not in self._scratch:
            self._scratch[parts] = mujoco.MjData(models[0])
        templates = [at.template for at in indices]
        apply_mismatches(models, templates, draws, [at.mismatch for at in indices])
        for plant, model in zip(plants, models, strict=True):
            set_seat(model, plant.fault, self._scratch[parts], plant.indices.seat)
        step = self.timestep
        weight = np.array(
            [m.dof_invweight0[at.dofs] for m, at in zip(models, indices, strict=True)]
        )
        stiffness = np.array(arm.holding.stiffness) * [d.holding_stiffness for d in draws]
        damping = np.array(arm.holding.damping) * [d.holding_damping for d in draws]
        # The damper acts on the velocity half a step ago, which takes damping * step / 2
        # off the inertia; the inertance gives it back.
        ratio = weight * (stiffness / inertance_rate(step) ** 2 + damping * step / 2)
        impedance = np.clip(ratio / (1 + ratio), 1e-4, 0.9999)
        scale = (1 - impedance) * weight
        limits = np.broadcast_to((0.001, 0.5, 2.0), (*weight.shape, 3))
        soft = np.concatenate([impedance[..., None], impedance[..., None], limits], axis=-1)
        spring = -np.stack([stiffness * scale, np.maximum(damping * scale, 1e-12)], axis=-1)
        for k, (plant, model) in enumerate(zip(plants, models, strict=True)):
            model.eq_solimp[plant.indices.brakes] = soft[k]
            model.eq_solref[plant.indices.brakes] = spring[k]
            for at in self.link_sites:  # the end of a longer link lies farther out
                if at.scaled_by >= 0:
                    site = model.site(f"accelerometer{at.link}").id
                    model.site_pos[site] *= plant.mismatch.length[at.scaled_by]

    def _compile(self, links: tuple[int, ...], kinds: tuple[SeatKind, ...]) -> mujoco.MjModel:
        arm = self.arm
        spec = seated_spec(arm, links, kinds)
        option = spec.option
        option.timestep = self.timestep
        option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        # MuJoCo 4.0.0 has a fault in its sparse Cholesky factorisation.
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        # Implicit damping is applied after the constraints are solved and would loosen them.
        option.disableflags |= int(
            mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        )
        for j, name in enumerate(arm.joints):
            joint = spec.joint(name)
            joint.stiffness = [
                joint.stiffness[0] + arm.centring.stiffness[j],
                *joint.stiffness[1:],
            ]
            joint.armature += arm.centring.damping[j] * self.timestep / 2  # as for the brakes
            joint.damping = [joint.damping[0] + arm.centring.damping[j], *joint.damping[1:]]
            spec.add_actuator(name=f"drive_{name}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
            spec.add_equality(
                name=f"hold_{name}",
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name1=name,
            )
        if arm.shaker is not None:
            add_shaker(spec, arm.shaker)
        sensor, obj = mujoco.mjtSensor, mujoco.mjtObj
        spec.add_sensor(
            name="tool", type=sensor.mjSENS_ACCELEROMETER, objtype=obj.mjOBJ_SITE, objname=arm.tool
        )
        for name in arm.joints:
            spec.add_sensor(
                name=f"encoder_{name}",
                type=sensor.mjSENS_JOINTPOS,
                objtype=obj.mjOBJ_JOINT,
                objname=name,
            )
        for at in self.link_sites:
            place = spec.body(at.body).add_site(
                name=f"accelerometer{at.link}", pos=list(at.position)
            )
            if self.link_accelerometers is not None and self.link_accelerometers.tangential:
                place.quat = at.tangential_quat
            spec.add_sensor(
                name=f"link{at.link}",
                type=sensor.mjSENS_ACCELEROMETER,
                objtype=obj.mjOBJ_SITE,
                objname=f"accelerometer{at.link}",
            )
        for site in arm.probe_sites:
            spec.add_sensor(
                name=f"probe_{site}",
                type=sensor.mjSENS_ACCELEROMETER,
                objtype=obj.mjOBJ_SITE,
                objname=site,
            )
        return spec.compile()
