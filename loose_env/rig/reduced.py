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
from typing import NamedTuple

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
        """Degrees of freedom: the driven joints, then bending modes, then the seat (D,)."""
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


class _Fixed(NamedTuple):
    """What stays as it is while J arms are measured, degrees of freedom in the layouts' order."""

    order: IndexArray
    """Degrees of freedom in the model's order, their joints, positions and bodies (J, D) each."""
    joints: IndexArray
    positions: IndexArray
    bodies: IndexArray
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
    """Forces of the seat (J, 11): positions of the lower and the upper stop from the joint's zero;
    stiffness of each, damping of each, and force per acceleration that each adds when touched;
    largest friction force; friction force per acceleration while the seat sticks; deceleration per
    velocity that sticking friction aims at [N and m, N·m and rad for a hinge]."""
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
        laid = ("order", "joints", "positions", "bodies", "hinges", "carried", "reached")
        return cls(
            **{name: np.array([getattr(at, name) for at in layouts]) for name in laid},
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
            mixing=mixing,
            gain=np.array([draw.drive_gain for draw in draws]),
            joint_zero=np.array([draw.joint_zero for draw in draws]),
            gap=np.array([plant.gaps[0] for plant in plants]),
        )

    def put(self, rows: IndexArray, other: _Fixed) -> None:
        """Write those of other arms over some."""
        for own, values in zip(self, other, strict=True):
            own[rows] = values


class _Seen(NamedTuple):
    """What MuJoCo says about J arms in their poses."""

    axes: Array
    """Axis and anchor of each joint of the model (J, joints, 3) each."""
    anchors: Array
    centres: Array
    """Centre of mass of what each body carries, itself included (J, bodies, 3)."""
    sites: Array
    """Place and axes of each site (J, sites, 3), (J, sites, 9)."""
    frames: Array
    inertia: Array
    """In the model's order (J, nv, nv)."""

    @classmethod
    def of(cls, models: Sequence[mujoco.MjModel], data: mujoco.MjData, positions: Array) -> _Seen:
        """Put models into positions (J, nq)."""
        here = (data.xaxis, data.xanchor, data.subtree_com, data.site_xpos, data.site_xmat)
        count, nv = len(models), models[0].nv
        shapes = [*(each.shape for each in here), (nv, nv)]
        found = cls._make([np.zeros((count, *shape)) for shape in shapes])
        for k, (model, own) in enumerate(zip(models, positions, strict=True)):
            data.qpos = own
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_makeM(model, data)
            mujoco.mj_fullM(model, data, found.inertia[k])
            for values, each in zip(found[:-1], here, strict=True):
                values[k] = each
        return found


def _law(model: mujoco.MjModel, at: MotionLayout, weight: float) -> tuple[float, ...]:
    """Extract the constraint law of the seat from the model, as `_Fixed.law`."""
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


_TOGETHER = 128  # arms whose signals are worked on at once: more than fit the cache are slower
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
        self._linearise: Callable[..., tuple[Array, ...]] = small_motion_loop.linearise
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
        self._sensors = self._layout(spare).sites[self._axes.sensor], self._axes.sensor

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
                some = trials if len(rows) == len(trials) else trials.some(rows)
                yield which, rows, self._measured(some)

    def _measured(self, trials: Trials) -> Records:
        """Measure arms, few enough for the cache."""
        fixed, slots = self._fixed, trials.slots
        models = [self.plants[k].model for k in slots]
        if self.arm.gear_joints:
            for slot, pose, model in zip(slots, trials.poses, models, strict=True):
                self.plants[slot].hold_at(pose)  # winds up the gears' springs
                fixed.rest[slot] = model.qpos_spring[fixed.positions[slot]]
        control = controls(self.nominal, trials, timestep=self.timestep)
        joint_zero, gain = fixed.joint_zero[slots], fixed.gain[slots]
        drawn = np.array([rng.random() for rng in trials.rngs])
        start = np.zeros(fixed.rest[slots].shape)
        start[:, : self.arm.n] = trials.poses + joint_zero
        start[:, -1] = fixed.gap[slots] * (drawn - 0.5)
        positions = np.zeros((len(slots), len(self._data.qpos)))
        positions[np.arange(len(slots))[:, None], fixed.positions[slots]] = start
        inertia, *motions = self._linearise(
            fixed,
            slots,
            _Seen.of(models, self._data, positions),
            start,
            trials.excited,
            control.constant * gain,
            self._sensors,
        )
        mobility = np.asarray(np.linalg.inv(inertia), dtype=np.float64)
        mobility[fixed.shut[slots], -1, -1] = 0.0
        delivered = control.periods * gain[control.records, control.drives][:, None]
        count = round(trials.duration * self.sensors.rate)
        motions.insert(0, np.ascontiguousarray(mobility.transpose(1, 2, 0)))
        motion, noise = self._integrated(motions, control, delivered, trials, count)
        finite = np.asarray(np.isfinite(motion.smooth).all(axis=(1, 2)))
        finite = finite & np.isfinite(motion.position[..., 1:-1]).all(axis=(1, 2))
        return read_records(
            motion,
            noise,
            self._axes,
            trials,
            control,
            arm=self.arm,
            sensors=self.sensors,
            factor=self.factor,
            joint_zero=joint_zero,
            failures=[None if fine else _DIVERGED for fine in finite.tolist()],
        )

    def _integrated(
        self,
        motions: Sequence[Array],
        control: Controls,
        delivered: Array,
        trials: Trials,
        count: int,
    ) -> tuple[Motion, Noise]:
        """Integrate the arms, some on each thread; draw the noise meanwhile."""
        arms, period = len(trials), delivered.shape[1]
        rank = np.arange(len(delivered)) - np.searchsorted(control.records, control.records)
        # The loop takes the arms along the last axis.
        driven = np.zeros((1 + rank.max(), arms), dtype=np.uintp)
        torque = np.zeros((len(driven), period, arms))
        driven[rank, control.records] = control.drives
        torque[rank, :, control.records] = delivered
        # Contiguous for each record, so that sums over it do not depend on the others.
        smooth = np.empty((arms, len(self._axes.sensor), count))
        position = np.empty((arms, self.arm.n, count + 2))

        def some(first: int, last: int) -> None:
            own = [
                np.ascontiguousarray(part[..., first:last]) for part in (*motions, torque, driven)
            ]
            found = [np.empty((*each.shape[1:], last - first)) for each in (smooth, position)]
            several = last - first if last - first > 1 else None
            self._integrate(*own, *self._steps, *found, several)
            for each, part in zip((smooth, position), found, strict=True):
                each[first:last] = part.transpose(2, 0, 1)

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
        return Motion(smooth=smooth, position=position), noise

    def _layout(self, plant: Plant) -> MotionLayout:
        found = self._layouts.get(plant.indices)
        if found is None:
            found = self._layouts[plant.indices] = MotionLayout(plant)
        return found
