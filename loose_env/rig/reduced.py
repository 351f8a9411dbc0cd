"""Rig that simulates arms by equations of motion linearised in each pose (`ReducedRig`).

Within a record the joints move by fractions of a milliradian and the seat by fractions of a
millimetre, so the inertia matrix, the tool's Jacobian and gravity's linear part may be taken as
constant. What is left is a handful of linear equations and one seat that sticks, slides and
strikes its stops:

    M a = B u + f0 - K (q - q0) - C v + e (friction + stops).

Brakes and servos are the springs, dampers and inertances that MuJoCo's constraints make of
them; friction and stops follow the same constraint law as in `loose_env.faults.seats`.
Centripetal terms are left out: they are of second order in the motion.

The rig draws the same torques, noise and starting places as `SimulatedRig` and reads its records
with the same sensors. One compiled loop takes many arms at once from torque to low-passed
readings; linearisation and sensors work on whole batches, and every sum is taken in an order that
the batch does not change.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, fields

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, MismatchDraw
from loose_env.errors import InvalidSetting
from loose_env.faults import Fault, Healthy, gaps_of
from loose_env.rig.plant import Plant, PlantIndices
from loose_env.rig.records import Records, Trials
from loose_env.rig.simulated import (
    Controls,
    Motion,
    Noise,
    SlotRig,
    controls,
    decimation_filter,
    draw_noise,
    read_records,
)
from loose_env.sensors import SensorSuite
from loose_env.typing import Array, IndexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallMotion:
    """Linearised motion of J true arms of D degrees of freedom and S accelerometer axes.

    The driven joints come first, then bending modes, then the seat. Where the seat is shut, its
    mobility is zero.
    """

    mobility: Array
    """Inverse of the inertia matrix with the holdings' inertances (J, D, D)."""
    stiffness: Array
    """Springs, holdings and gravity's linear part (J, D, D)."""
    damping: Array
    """Dampers and holdings (J, D)."""
    force: Array
    """Constant force, gravity above all (J, D)."""
    start: Array
    """Position at the start less that at which springs rest (J, D)."""
    readings: Array
    """Sensor acceleration per acceleration of each degree of freedom (J, S, D)."""
    tilting: Array
    """Sensor reading per displacement: gravity seen from a turned sensor (J, S, D)."""
    still: Array
    """Sensor readings at rest (J, S)."""
    zero: Array
    """Joint positions where springs rest (J, n)."""
    law: Array
    """Forces of the seat (J, 11): positions of the lower and the upper stop; stiffness of each,
    damping of each, and force per acceleration that each adds when touched; largest friction
    force; friction force per acceleration while the seat sticks; deceleration per velocity that
    sticking friction aims at [N and m, N·m and rad for a hinge]."""

    @property
    def parts(self) -> tuple[Array, ...]:
        """All arrays, in the order in which the compiled loop takes them."""
        return tuple(getattr(self, each.name) for each in fields(self))


class MotionLayout:
    """Order and ancestry of a model's degrees of freedom: the same for all of one template."""

    def __init__(self, plant: Plant) -> None:
        model = plant.model
        _require_linear(model, plant)
        seat = model.joint("seat")
        self.seat, self.lock = int(seat.dofadr[0]), int(model.equality("seat_lock").id)
        driven = plant.indices.dofs
        others = [d for d in range(model.nv) if d != self.seat and d not in driven]
        self.order = np.array([*driven, *others, self.seat], dtype=np.intp)
        """Degrees of freedom in the order of `SmallMotion` (D,)."""
        self.joints = model.dof_jntid[self.order]
        self.positions = model.jnt_qposadr[self.joints]
        self.bodies = model.dof_bodyid[self.order]
        self.hinges = model.jnt_type[self.joints] == mujoco.mjtJoint.mjJNT_HINGE
        carriers = [_carriers(model, int(dof)) for dof in range(model.nv)]
        carried = np.array([[j in above for j in range(model.nv)] for above in carriers])
        self.carried = carried[np.ix_(self.order, self.order)]
        """Whether each degree of freedom is moved by each other one, or is it (D, D)."""
        accelerometer = mujoco.mjtSensor.mjSENS_ACCELEROMETER
        self.sites = model.sensor_objid[model.sensor_type == accelerometer]
        """Sites of the accelerometers, in the order of the channels (A,)."""
        ends = [_last_dof(model, int(model.site_bodyid[site])) for site in self.sites]
        reached = np.array([carried[end] if end >= 0 else np.zeros(model.nv) for end in ends])
        self.reached = reached.astype(bool)[:, self.order]
        """Whether each accelerometer is moved by each degree of freedom (A, D)."""
        self.stops = [int(model.tendon(f"seat_{side}").id) for side in ("low", "high")]


def _carriers(model: mujoco.MjModel, dof: int) -> set[int]:
    """Degrees of freedom from one to the base, itself included."""
    found = set()
    while dof >= 0:
        found.add(dof)
        dof = int(model.dof_parentid[dof])
    return found


def _last_dof(model: mujoco.MjModel, body: int) -> int:
    """Last degree of freedom that moves a body; -1 where it stands still."""
    while body > 0 and model.body_dofnum[body] == 0:
        body = int(model.body_parentid[body])
    return int(model.body_dofadr[body] + model.body_dofnum[body] - 1) if body > 0 else -1


def small_motions(
    fixed: _Fixed,
    models: Sequence[mujoco.MjModel],
    data: mujoco.MjData,
    *,
    poses: Array,
    excited: NDArray[np.bool_],
    places: Array,
    torque: Array,
    mixed: NDArray[np.intp],
) -> SmallMotion:
    """Linearise true arms about their initial poses; ``places`` are those of the seats."""
    found = _Placed(fixed, models, data, poses, places)
    n = excited.shape[1]
    diagonal = np.arange(found.inertia.shape[1])
    # Gravity, from the arms' geometry; angular velocity and motion of centres of mass.
    turning = np.where(fixed.hinges[..., None], found.axis, 0.0)
    centres = _motion(found, found.centres) * fixed.mass[..., None]
    gravity = fixed.gravity[:, None]
    stiffness = -_dot(_cross(turning[:, None], centres[:, :, None]), gravity[:, None])
    stiffness = np.where(fixed.carried, stiffness, 0.0)
    one_way = fixed.carried & ~fixed.carried.transpose(0, 2, 1)
    stiffness = stiffness + np.where(one_way, stiffness, 0.0).transpose(0, 2, 1)
    linear = stiffness.copy()
    # What holds the joints.
    held = np.where(excited, 0.0, fixed.held)
    inertia = found.inertia
    inertia[:, diagonal[:n], diagonal[:n]] += held
    springs, damping = fixed.springs.copy(), fixed.damping.copy()
    springs[:, :n] += np.where(excited, 0.0, fixed.holding[:, 0])
    damping[:, :n] += np.where(excited, 0.0, fixed.holding[:, 1])
    stiffness[:, diagonal, diagonal] += springs
    # A seat that is shut does not move.
    shut = fixed.shut
    inertia[shut, -1, :] = inertia[shut, :, -1] = 0.0
    inertia[shut, -1, -1] = 1.0
    mobility = np.linalg.inv(inertia)
    mobility[shut, -1, -1] = 0.0
    start = found.position - found.rest
    start[shut, -1] = 0.0
    # Gravity's linear part is taken about the start, springs about where they rest.
    force = _dot(centres, gravity) + _row_sums(linear * start[:, None])
    force[:, :n] += torque
    # Accelerometers: direction of each axis read, in the world.
    along = _dot(fixed.mixing[:, :, None], found.frames[:, mixed])
    reached = fixed.reached[:, mixed]
    moved = _motion(found, found.sites[:, :, None])[:, mixed]
    readings = np.where(reached, _dot(along[:, :, None], moved), 0.0)
    falling = _cross(turning, gravity)[:, None]
    tilting = np.where(reached, _dot(along[:, :, None], falling), 0.0)
    law = fixed.law.copy()
    law[:, :2] -= found.rest[:, -1:]
    return SmallMotion(
        mobility=np.asarray(mobility, dtype=np.float64),
        stiffness=stiffness,
        damping=damping,
        force=force,
        start=start,
        readings=readings,
        tilting=tilting,
        still=-_dot(along, gravity) - _row_sums(tilting * start[:, None]),
        zero=found.rest[:, :n],
        law=law,
    )


@dataclass(kw_only=True, eq=False)
class _Fixed:
    """What stays as it is while J arms are measured, degrees of freedom in the layouts' order."""

    at: Array
    """Layout of each (J,), of objects."""
    gravity: Array
    springs: Array
    damping: Array
    mass: Array
    """Mass that each degree of freedom moves (J, D)."""
    rest: Array
    """Positions where springs rest, those of held joints left out (J, D)."""
    held: Array
    """Inertance of what holds each joint (J, n)."""
    holding: Array
    """Its stiffness and its damping (J, 2, n)."""
    law: Array
    """As `SmallMotion.law`, positions of the stops from the joint's zero (J, 11)."""
    shut: NDArray[np.bool_]
    hinges: NDArray[np.bool_]
    carried: NDArray[np.bool_]
    reached: NDArray[np.bool_]
    mixing: Array
    """Output of each axis that is read per true acceleration (J, S, 3)."""
    gain: Array
    joint_zero: Array
    gap: Array

    @classmethod
    def of(cls, plants: Sequence[Plant], layouts: Sequence[MotionLayout], mixing: Array) -> _Fixed:
        """Take down what the models of some arms say."""
        n, models = len(plants[0].indices.brakes), [plant.model for plant in plants]
        both = list(zip(models, layouts, strict=True))
        weight = np.array([m.dof_invweight0[at.order] for m, at in both])
        brakes = [(plant.model, plant.indices.brakes) for plant in plants]
        impedance = np.array([m.eq_solimp[held, 0] for m, held in brakes])
        reference = np.array([m.eq_solref[held].T for m, held in brakes])
        inertance = impedance / ((1 - impedance) * weight[:, :n])
        draws = [plant.mismatch for plant in plants]
        return cls(
            at=np.array([*layouts, None], dtype=object)[:-1],
            gravity=np.array([m.opt.gravity for m in models]),
            springs=np.array([m.jnt_stiffness[at.joints] for m, at in both]),
            damping=np.array([m.dof_damping[at.order] for m, at in both]),
            mass=np.array([m.body_subtreemass[at.bodies] for m, at in both]),
            rest=np.array([m.qpos_spring[at.positions] for m, at in both]),
            held=inertance,
            holding=(-inertance / impedance)[:, None] * reference,
            law=np.array(
                [_law(m, at, float(w[-1])) for (m, at), w in zip(both, weight, strict=True)]
            ),
            shut=np.array([m.eq_active0[at.lock] for m, at in both], dtype=bool),
            hinges=np.array([at.hinges for at in layouts]),
            carried=np.array([at.carried for at in layouts]),
            reached=np.array([at.reached for at in layouts]),
            mixing=mixing,
            gain=np.array([draw.drive_gain for draw in draws]),
            joint_zero=np.array([draw.joint_zero for draw in draws]),
            gap=np.array([plant.gaps[0] for plant in plants]),
        )

    def some(self, rows: IndexArray) -> _Fixed:
        """Those of some arms."""
        return _Fixed(**{each.name: getattr(self, each.name)[rows] for each in fields(self)})

    def put(self, rows: IndexArray, other: _Fixed) -> None:
        """Write those of other arms over some."""
        for each in fields(self):
            getattr(self, each.name)[rows] = getattr(other, each.name)


class _Placed:
    """What MuJoCo's models say about J arms at rest in their poses."""

    def __init__(
        self,
        fixed: _Fixed,
        models: Sequence[mujoco.MjModel],
        data: mujoco.MjData,
        poses: Array,
        places: Array,
    ) -> None:
        first, n = fixed.at[0], poses.shape[1]
        jobs, sensors = len(models), len(first.sites)
        self.hinges = fixed.hinges
        true = poses + fixed.joint_zero
        self.rest = fixed.rest.copy()
        self.rest[:, :n] = true
        self.position = np.zeros(self.rest.shape)
        self.position[:, :n], self.position[:, -1] = true, places
        count = len(first.order)
        joints = np.array([at.joints for at in fixed.at])
        bodies = np.array([at.bodies for at in fixed.at])
        order = np.array([at.order for at in fixed.at])
        start = np.zeros((jobs, len(data.qpos)))
        rows = np.arange(jobs)[:, None]
        start[rows, np.array([at.positions for at in fixed.at])] = self.position
        inertia = np.zeros((jobs, count, count))
        axis, anchor = np.empty((2, jobs, *data.xaxis.shape))
        centres, sites = np.empty((jobs, *data.subtree_com.shape)), np.empty((jobs, sensors, 3))
        frames = np.empty((jobs, sensors, 9))
        qpos, own_axis, own_anchor = data.qpos, data.xaxis, data.xanchor
        com, site, frame, seen = data.subtree_com, data.site_xpos, data.site_xmat, first.sites
        for k, model in enumerate(models):
            qpos[:] = start[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_makeM(model, data)
            mujoco.mj_fullM(model, data, inertia[k])
            axis[k], anchor[k], centres[k] = own_axis, own_anchor, com
            sites[k], frames[k] = site[seen], frame[seen]
        self.inertia = inertia[rows[..., None], order[:, :, None], order[:, None]]
        self.axis, self.anchor = axis[rows, joints], anchor[rows, joints]
        self.centres, self.sites = centres[rows, bodies], sites
        self.frames = frames.reshape(jobs, sensors, 3, 3)


def _law(model: mujoco.MjModel, at: MotionLayout, weight: float) -> tuple[float, ...]:
    """Extract the constraint law of the seat from the model, as `SmallMotion.law`."""
    low, high = at.stops
    soft, inverse = model.tendon_solimp_lim, model.tendon_invweight0
    reference, limits = model.tendon_solref_lim, model.tendon_range
    scale = [1 / ((1 - soft[stop, 0]) * inverse[stop]) for stop in at.stops]
    stiff = float(model.dof_solimp[at.seat, 0])
    return (
        limits[low, 0],
        limits[high, 1],
        -reference[low, 0] * scale[0],
        -reference[high, 0] * scale[1],
        -reference[low, 1] * scale[0],
        -reference[high, 1] * scale[1],
        scale[0] * soft[low, 0],
        scale[1] * soft[high, 0],
        model.dof_frictionloss[at.seat],
        stiff / ((1 - stiff) * weight),
        # Critically damped with MuJoCo's shortest time constant.
        2 / (stiff * model.dof_solref[at.seat, 0]),
    )


def _motion(found: _Placed, points: Array) -> Array:
    """Velocity of points (J, ..., D or 1, 3) per velocity of each degree of freedom, D, there."""
    axis, anchor, hinges = found.axis, found.anchor, found.hinges
    if points.ndim > axis.ndim:
        axis, anchor, hinges = axis[:, None], anchor[:, None], hinges[:, None]
    return np.where(hinges[..., None], _cross(axis, points - anchor), axis)


# Written out, so that the order of a sum never depends on the number of arms.
def _dot(a: Array, b: Array) -> Array:
    product = a * b
    return np.asarray(product[..., 0] + product[..., 1] + product[..., 2])


def _cross(a: Array, b: Array) -> Array:
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _row_sums(a: Array) -> Array:
    total = a[..., 0].copy()
    for k in range(1, a.shape[-1]):
        total += a[..., k]
    return total


def _require_linear(model: mujoco.MjModel, plant: Plant) -> None:
    if plant.shaker is not None:
        raise InvalidSetting("the reduced engine knows no shaker; take the engine 'mujoco'")
    seat = int(model.joint("seat").dofadr[0])
    friction = np.delete(model.dof_frictionloss, seat)
    if model.jnt_stiffnesspoly.any() or model.dof_dampingpoly.any() or friction.any():
        raise InvalidSetting(
            "the reduced engine takes springs and dampers of joints as linear and knows no "
            "friction in them; this arm has others: take the engine 'mujoco'"
        )


_TOGETHER = 64  # arms whose signals are worked on at once: more than fit the cache are slower
_DIVERGED = "the simulation diverged: motion not finite"
_LEAST = 16  # arms in one run of the loop; it takes several in one instruction


class ReducedRig(SlotRig):
    """Measures simulated arms by their equations of small motion.

    For arms whose joints are held by brakes, servos or elastic gears, and for faults of one
    degree of freedom. A slot's readings depend on its arm, the pose, the excitation and the
    generator alone, as on `SimulatedRig`.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    slots : int
        Number of arms.
    sensors : SensorSuite
        What reads the motion.
    timestep : float, optional
        Simulation step [s]; the arm's own by default.
    threads : int
        Simulation threads; 0 takes all processors.

    Raises
    ------
    InvalidSetting
        If numba is missing, or the arm stands at a shaker.

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.excitation import Excitation
    >>> rig = ReducedRig(planar(2))
    >>> shake = Excitation(torque_rms=(5.0, 0.0), duration=0.2, band=(30.0, 150.0))
    >>> rig.measure(np.array([0.1, 0.4]), shake).tool.shape
    (2, 200)
    """

    def __init__(
        self,
        arm: Arm,
        *,
        slots: int = 1,
        sensors: SensorSuite | None = None,
        timestep: float | None = None,
        threads: int = 0,
    ) -> None:
        try:
            from loose_env.rig import small_motion_loop
        except ImportError as error:
            raise InvalidSetting(
                "the reduced engine needs numba: pip install 'loose-env[fast]', or take the "
                "engine 'mujoco'"
            ) from error
        if arm.shaker is not None:
            raise InvalidSetting("the reduced engine knows no shaker; take the engine 'mujoco'")
        super().__init__(arm, slots, sensors, timestep, threads)
        # numba's stubs know no signature.
        self._integrate: Callable[..., None] = small_motion_loop.integrate
        self._threads = threads or os.cpu_count() or 1
        rate, bandwidth = self.sensors.rate, self.sensors.accelerometer.bandwidth
        self._steps = (
            *(self.timestep, round(arm.settling * rate) * self.factor, self.factor),
            decimation_filter(self.factor, bandwidth, rate),
        )
        self._layouts: dict[PlantIndices, MotionLayout] = {}
        healthy, nominal = Healthy(), MismatchDraw.none(arm)
        self._spare = spare = self.shop.build(healthy, nominal)
        self.plants = [spare] * slots
        self._fixed = self._fixed_of([spare] * slots)
        self._data = mujoco.MjData(spare.model)

    def _fixed_of(self, plants: Sequence[Plant]) -> _Fixed:
        mixing = self._axes.mixing([plant.mismatch for plant in plants])
        return _Fixed.of(plants, [self._layout(plant) for plant in plants], mixing)

    def mount_all(
        self, slots: IndexArray, faults: Sequence[Fault], mismatches: Sequence[MismatchDraw]
    ) -> None:
        """Put new arms into slots.

        Raises
        ------
        InvalidSetting
            If a fault has several loose degrees of freedom.
        """
        if any(len(gaps_of(fault)) != 1 for fault in faults):
            raise InvalidSetting(
                "the reduced engine knows faults of one degree of freedom; take the engine "
                "'mujoco' for several faults at once"
            )
        old = [self.plants[slot] for slot in slots]
        plants = self.shop.build_all(faults, mismatches, [p for p in old if p is not self._spare])
        for slot, plant in zip(slots, plants, strict=True):
            self.plants[slot] = plant
        self._fixed.put(slots, self._fixed_of(plants))

    def record(self, asked: Sequence[Trials]) -> Iterator[tuple[int, IndexArray, Records]]:
        """Take measurements; yields an element's index, which of its own, and their records."""
        for which, trials in enumerate(asked):
            for first in range(0, len(trials), _TOGETHER):
                rows = np.arange(first, min(first + _TOGETHER, len(trials)))
                yield which, rows, self._measured(trials.some(rows))

    def _measured(self, trials: Trials) -> Records:
        """Measure arms, few enough for the cache."""
        fixed, plants = self._fixed.some(trials.slots), [self.plants[k] for k in trials.slots]
        if self.arm.gear_joints:
            for plant, pose in zip(plants, trials.poses, strict=True):
                plant.hold_at(pose)  # winds up the gears' springs
            at = [(plant.model, own.positions) for plant, own in zip(plants, fixed.at, strict=True)]
            fixed.rest = np.array([model.qpos_spring[own] for model, own in at])
        control = controls(self.nominal, trials, timestep=self.timestep)
        drawn = np.array([rng.random() for rng in trials.rngs])
        motions = small_motions(
            fixed,
            [plant.model for plant in plants],
            self._data,
            poses=trials.poses,
            excited=trials.excited,
            places=fixed.gap * (drawn - 0.5),
            torque=control.constant * fixed.gain,
            mixed=self._axes.sensor,
        )
        delivered = control.periods * fixed.gain[control.records, control.drives][:, None]
        count = round(trials.duration * self.sensors.rate)
        motion, noise = self._integrated(motions, control, delivered, trials, count)
        moved = np.concatenate([motion.smooth, motion.position[..., 1:-1]], axis=1)
        finite = np.asarray(np.isfinite(moved).all(axis=(1, 2)))
        return read_records(
            motion,
            noise,
            self._axes,
            trials,
            control,
            arm=self.arm,
            sensors=self.sensors,
            factor=self.factor,
            joint_zero=fixed.joint_zero,
            failures=[None if fine else _DIVERGED for fine in finite.tolist()],
        )

    def _integrated(
        self,
        motions: SmallMotion,
        control: Controls,
        delivered: Array,
        trials: Trials,
        count: int,
    ) -> tuple[Motion, Noise]:
        """Integrate the arms, some on each thread; draw the noise meanwhile."""
        arms, period = len(trials), delivered.shape[1]
        driven, at = np.unique(control.drives, return_inverse=True)
        torque = np.zeros((len(driven), period, arms))
        torque[at, :, control.records] = delivered
        # The loop takes the arms along the last axis.
        parts = [
            np.ascontiguousarray(part.transpose(*range(1, part.ndim), 0)) for part in motions.parts
        ]
        smooth = np.empty((motions.still.shape[1], count, arms))
        position = np.empty((self.arm.n, count + 2, arms))

        def some(first: int, last: int) -> None:
            own = [np.ascontiguousarray(part[..., first:last]) for part in (*parts, torque)]
            seen, turned = smooth[..., first:last].copy(), position[..., first:last].copy()
            self._integrate(*own, driven, *self._steps, seen, turned)
            smooth[..., first:last], position[..., first:last] = seen, turned

        share = max(_LEAST, -(-arms // self._threads))
        spans = [(first, min(first + share, arms)) for first in range(0, arms, share)]
        with ExitStack() as stack:
            waiting = []
            if self._threads > 1 and arms > 1:  # compiled loops and draws run beside each other
                pool = stack.enter_context(ThreadPoolExecutor(self._threads))
                waiting = [pool.submit(some, *span) for span in spans]
            noise = draw_noise(trials, self._axes, joints=self.arm.n, count=count)
            for done in waiting:
                done.result()
        if not waiting:
            for span in spans:
                some(*span)
        # Contiguous for each record, so that sums over it do not depend on the others.
        return Motion(
            smooth=np.ascontiguousarray(smooth.transpose(2, 0, 1)),
            position=np.ascontiguousarray(position.transpose(2, 0, 1)),
        ), noise

    def _layout(self, plant: Plant) -> MotionLayout:
        found = self._layouts.get(plant.indices)
        if found is None:
            found = self._layouts[plant.indices] = MotionLayout(plant)
        return found
