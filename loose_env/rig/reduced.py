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
from loose_env.faults import Fault, Healthy
from loose_env.rig.plant import Plant, PlantIndices
from loose_env.rig.simulated import (
    Controls,
    Job,
    Measurement,
    Motion,
    Noise,
    SlotRig,
    check_jobs,
    controls,
    decimation_filter,
    draw_noise,
    read_records,
)
from loose_env.sensors import SensorSuite
from loose_env.typing import Array


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
        self.entries = self.order[:, None] * model.nv + self.order
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
    plants: Sequence[Plant],
    layouts: Sequence[MotionLayout],
    data: mujoco.MjData,
    *,
    excited: NDArray[np.bool_],
    places: Array,
    torque: Array,
    mixing: Array,
    mixed: NDArray[np.intp],
) -> SmallMotion:
    """Linearise true arms about their initial poses."""
    found = _gathered(plants, layouts, data, places)
    jobs, n = excited.shape
    diagonal = np.arange(found.inertia.shape[1])
    # Gravity, from the arms' geometry; angular velocity and motion of centres of mass.
    turning = np.where(found.hinges[..., None], found.axis, 0.0)
    centres = _motion(found, found.centres) * found.mass[..., None]
    gravity = found.gravity[:, None]
    stiffness = -_dot(_cross(turning[:, None], centres[:, :, None]), gravity[:, None])
    stiffness = np.where(found.carried, stiffness, 0.0)
    one_way = found.carried & ~found.carried.transpose(0, 2, 1)
    stiffness = stiffness + np.where(one_way, stiffness, 0.0).transpose(0, 2, 1)
    linear = stiffness.copy()
    # What holds the joints.
    held = np.where(excited, 0.0, found.held)
    inertia = found.inertia
    inertia[:, diagonal[:n], diagonal[:n]] += held
    springs, damping = found.springs, found.damping
    springs[:, :n] += np.where(excited, 0.0, found.holding[0])
    damping[:, :n] += np.where(excited, 0.0, found.holding[1])
    stiffness[:, diagonal, diagonal] += springs
    # A seat that is shut does not move.
    inertia[found.shut, -1, :] = inertia[found.shut, :, -1] = 0.0
    inertia[found.shut, -1, -1] = 1.0
    mobility = np.linalg.inv(inertia)
    mobility[found.shut, -1, -1] = 0.0
    start = found.position - found.rest
    start[found.shut, -1] = 0.0
    # Gravity's linear part is taken about the start, springs about where they rest.
    force = _dot(centres, gravity) + _row_sums(linear * start[:, None])
    force[:, :n] += torque
    # Accelerometers: direction of each axis read, in the world.
    frames = found.frames[:, mixed]
    along = np.stack([_dot(mixing, frames[:, :, k]) for k in range(3)], axis=-1)
    readings = np.empty((jobs, len(mixed), len(diagonal)))
    tilting = np.empty_like(readings)
    falling = _cross(turning, gravity)
    for s, sensor in enumerate(mixed):
        reached = found.reached[:, sensor]
        moved = _motion(found, found.sites[:, sensor][:, None])
        readings[:, s] = np.where(reached, _dot(along[:, s][:, None], moved), 0.0)
        tilting[:, s] = np.where(reached, _dot(along[:, s][:, None], falling), 0.0)
    law = found.law
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


class _Gathered:
    """What MuJoCo's models say about J arms, degrees of freedom in the layouts' order."""

    def __init__(self, jobs: int, count: int, joints: int, sensors: int) -> None:
        self.inertia = np.empty((jobs, count, count))
        self.axis, self.anchor = np.empty((jobs, count, 3)), np.empty((jobs, count, 3))
        self.centres, self.mass = np.empty((jobs, count, 3)), np.empty((jobs, count))
        self.sites, self.frames = np.empty((jobs, sensors, 3)), np.empty((jobs, sensors, 3, 3))
        self.gravity = np.empty((jobs, 3))
        self.springs, self.damping = np.empty((jobs, count)), np.empty((jobs, count))
        self.position, self.rest = np.empty((jobs, count)), np.empty((jobs, count))
        self.held, self.holding = np.empty((jobs, joints)), np.empty((2, jobs, joints))
        self.law = np.empty((jobs, 11))
        self.shut = np.empty(jobs, dtype=bool)
        self.hinges = np.empty((jobs, count), dtype=bool)
        self.carried = np.empty((jobs, count, count), dtype=bool)
        self.reached = np.empty((jobs, sensors, count), dtype=bool)


def _gathered(
    plants: Sequence[Plant], layouts: Sequence[MotionLayout], data: mujoco.MjData, places: Array
) -> _Gathered:
    """Place every arm at rest in its pose and take down what its model says."""
    first = layouts[0]
    n, count, sensors = len(plants[0].brakes), len(first.order), len(first.sites)
    found = _Gathered(len(plants), count, n, sensors)
    full = np.zeros((count, count))
    qpos = data.qpos
    for k, (plant, at) in enumerate(zip(plants, layouts, strict=True)):
        model = plant.model
        brakes = plant.brakes
        qpos[:] = 0.0
        qpos[plant.position] = model.eq_data[brakes, 0]
        qpos[plant.seat_positions] = places[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_fullM(model, data, full)
        found.inertia[k] = full.ravel()[at.entries]
        found.axis[k], found.anchor[k] = data.xaxis[at.joints], data.xanchor[at.joints]
        found.centres[k] = data.subtree_com[at.bodies]
        found.mass[k] = model.body_subtreemass[at.bodies]
        found.sites[k] = data.site_xpos[at.sites]
        found.frames[k] = data.site_xmat[at.sites].reshape(-1, 3, 3)
        found.gravity[k] = model.opt.gravity
        found.springs[k] = model.jnt_stiffness[at.joints]
        found.damping[k] = model.dof_damping[at.order]
        found.position[k] = qpos[at.positions]
        found.rest[k] = model.qpos_spring[at.positions]
        weight = model.dof_invweight0
        impedance = model.eq_solimp[brakes, 0]
        inertance = impedance / ((1 - impedance) * weight[at.order[:n]])
        found.held[k] = inertance
        found.holding[:, k] = (-inertance / impedance) * model.eq_solref[brakes].T
        found.shut[k] = model.eq_active0[at.lock]
        found.hinges[k], found.carried[k], found.reached[k] = at.hinges, at.carried, at.reached
        found.law[k] = _law(model, at, float(weight[at.seat]))
    return found


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


def _motion(found: _Gathered, points: Array) -> Array:
    """Velocity of points (J, D or 1, 3) per velocity of each degree of freedom (J, D, 3)."""
    turned = _cross(found.axis, points - found.anchor)
    return np.where(found.hinges[..., None], turned, found.axis)


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


def require_one_part(plant: Plant) -> None:
    """Reject an arm that is loose in more than one degree of freedom."""
    if plant.parts != 1:
        raise InvalidSetting(
            "the reduced engine knows faults of one degree of freedom; take the engine 'mujoco' "
            "for compound looseness and for several faults at once"
        )


def _require_linear(model: mujoco.MjModel, plant: Plant) -> None:
    require_one_part(plant)
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
        self._healthy = healthy = self.shop.build(Healthy(), MismatchDraw.none(arm))
        self.plants = [healthy] * slots
        self._data = mujoco.MjData(healthy.model)

    def mount(self, slot: int, fault: Fault, mismatch: MismatchDraw | None = None) -> None:
        """Put a new arm into a slot.

        Raises
        ------
        InvalidSetting
            If the fault has several loose degrees of freedom.
        """
        draw = MismatchDraw.none(self.arm) if mismatch is None else mismatch
        plant = self.shop.build(fault, draw)
        require_one_part(plant)
        if self.plants[slot] is not self._healthy:
            self.shop.retire(self.plants[slot])
        self.plants[slot] = plant

    def measure_each(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Measurement]]:
        """Take measurements of one length together; yield each job's index and measurement."""
        check_jobs(self.arm, jobs)
        alike: dict[tuple[object, ...], list[int]] = {}
        for k, job in enumerate(jobs):
            alike.setdefault((job.excitation.duration, job.excitation.band), []).append(k)
        for members in alike.values():
            for first in range(0, len(members), _TOGETHER):
                some = members[first : first + _TOGETHER]
                yield from zip(some, self._measured([jobs[k] for k in some]), strict=True)

    def _measured(self, jobs: Sequence[Job]) -> list[Measurement]:
        """Measure jobs of one length and band."""
        plants = [self.plants[job.slot] for job in jobs]
        mismatches = [plant.mismatch for plant in plants]
        control = controls(self.nominal, jobs, timestep=self.timestep)
        places = np.empty(len(jobs))
        for k, (plant, job) in enumerate(zip(plants, jobs, strict=True)):
            plant.hold_at(job.pose)
            places[k] = plant.gaps[0] * (job.rng.random(plant.parts)[0] - 0.5)
        gain = np.array([draw.drive_gain for draw in mismatches])
        motions = small_motions(
            plants,
            [self._layout(plant) for plant in plants],
            self._data,
            excited=np.array([job.excitation.excited for job in jobs]),
            places=places,
            torque=control.constant * gain,
            mixing=self._axes.mixing(mismatches),
            mixed=self._axes.sensor,
        )
        delivered = control.periods * gain[control.records, control.drives][:, None]
        count = round(jobs[0].excitation.duration * self.sensors.rate)
        motion, noise = self._integrated(motions, control, delivered, jobs, count)
        finite = np.isfinite(motion.smooth).all(axis=(1, 2))
        finite &= np.isfinite(motion.position).all(axis=(1, 2))
        return read_records(
            motion,
            noise,
            self._axes,
            jobs,
            control,
            arm=self.arm,
            sensors=self.sensors,
            factor=self.factor,
            joint_zero=np.array([draw.joint_zero for draw in mismatches]),
            failures={
                jobs[int(k)].slot: "the simulation diverged: motion not finite"
                for k in np.flatnonzero(~finite)
            },
        )

    def _integrated(
        self,
        motions: SmallMotion,
        control: Controls,
        delivered: Array,
        jobs: Sequence[Job],
        count: int,
    ) -> tuple[Motion, Noise]:
        """Integrate the arms, some on each thread; draw the noise meanwhile."""
        arms, period = len(jobs), delivered.shape[1]
        driven, at = np.unique(control.drives, return_inverse=True)
        torque = np.zeros((len(driven), period, arms))
        torque[at, :, control.records] = delivered
        # The loop takes the arms along the last axis.
        parts = [np.ascontiguousarray(np.moveaxis(part, 0, -1)) for part in motions.parts]
        smooth = np.empty((motions.still.shape[1], count, arms))
        position = np.empty((self.arm.n, count + 2, arms))

        def some(first: int, last: int) -> None:
            own = [np.ascontiguousarray(part[..., first:last]) for part in (*parts, torque)]
            seen = np.empty((*smooth.shape[:-1], last - first))
            turned = np.empty((*position.shape[:-1], last - first))
            self._integrate(*own, driven, *self._steps, seen, turned)
            smooth[..., first:last], position[..., first:last] = seen, turned

        share = max(_LEAST, -(-arms // self._threads))
        spans = [(first, min(first + share, arms)) for first in range(0, arms, share)]
        with ExitStack() as stack:
            waiting = []
            if self._threads > 1:  # compiled loops and draws run beside each other
                pool = stack.enter_context(ThreadPoolExecutor(self._threads))
                waiting = [pool.submit(some, *span) for span in spans]
            noise = draw_noise(jobs, self._axes, joints=self.arm.n, count=count)
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
