"""Rig whose arms are simulated by their linearised equations of motion.

It answers the same calls as `SimulatedRig`, draws the same torques, noise and starting
places from the same generators, and reads its records with the same sensors. Only the engine
differs: no collision, no solver, one compiled loop that takes eight arms at once from torque to
low-passed readings (see `loose_env.rig.small_motion`). Linearisation and sensors work on
whole batches; every sum is taken in an order that the batch does not change. It needs numba, which
``pip install 'loose-env[fast]'`` brings.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import mujoco
import numpy as np

from loose_env.arms import Arm, LinearArm, MismatchDraw
from loose_env.errors import InvalidSetting
from loose_env.faults import Fault, Healthy
from loose_env.rig.measurement import Job, Measurement, check_jobs, whole_factor
from loose_env.rig.plant import Plant, PlantIndices, PlantShop
from loose_env.rig.reading import (
    AxesRead,
    Controls,
    Motion,
    Noise,
    controls,
    draw_noise,
    read_records,
)
from loose_env.rig.simulated import SlotRig, checked_slots, checked_threads
from loose_env.rig.small_motion import (
    MotionLayout,
    SmallMotion,
    require_one_part,
    small_motions,
)
from loose_env.sensors import SensorSuite, decimation_filter
from loose_env.typing import Array, IndexArray

__all__ = ["ReducedRig"]


_TOGETHER = 64  # arms whose signals are worked on at once: more than fit the cache are slower


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
        slots, threads = checked_slots(slots), checked_threads(threads)
        if arm.shaker is not None:
            raise InvalidSetting("the reduced engine knows no shaker; take the engine 'mujoco'")
        self.arm = arm
        self.sensors = sensors if sensors is not None else SensorSuite()
        self.timestep = arm.timestep if timestep is None else timestep
        self.factor = whole_factor(self.sensors.rate, self.timestep)
        self.nominal = LinearArm(arm)
        self.shop = PlantShop(
            arm, timestep=self.timestep, link_accelerometers=self.sensors.link_accelerometers
        )
        # numba's stubs know no signature.
        self._integrate: Callable[..., None] = small_motion_loop.integrate
        self._lanes = small_motion_loop.LANES
        self._threads = threads or os.cpu_count() or 1
        self._axes = AxesRead(arm, self.sensors)
        self._layouts: dict[PlantIndices, MotionLayout] = {}
        self._healthy = healthy = self.shop.build(Healthy(), MismatchDraw.none(arm))
        self.plants: list[Plant] = [healthy] * slots
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
        """Integrate the arms, so many at once as there are lanes; draw the noise meanwhile."""
        motion = Motion(
            smooth=np.empty((len(jobs), motions.still.shape[1], count)),
            position=np.empty((len(jobs), self.arm.n, count + 2)),
        )

        def some(first: int) -> None:
            last = min(first + self._lanes, len(jobs))
            own = (control.records >= first) & (control.records < last)
            self._integrate_some(
                first,
                last,
                motions,
                motion,
                delivered[own],
                control.records[own] - first,
                control.drives[own],
            )

        starts = range(0, len(jobs), self._lanes)
        with ExitStack() as stack:
            waiting = []
            if self._threads > 1:  # compiled loops and draws run beside each other
                pool = stack.enter_context(ThreadPoolExecutor(self._threads))
                waiting = [pool.submit(some, first) for first in starts]
            noise = draw_noise(jobs, self._axes, joints=self.arm.n, count=count)
            for done in waiting:
                done.result()
        if not waiting:
            for first in starts:
                some(first)
        return motion, noise

    def _integrate_some(
        self,
        first: int,
        last: int,
        motions: SmallMotion,
        motion: Motion,
        delivered: Array,
        lanes: IndexArray,
        drives: IndexArray,
    ) -> None:
        """Integrate the arms of one run of the loop; unused lanes repeat the last arm."""
        chosen = np.minimum(np.arange(first, first + self._lanes), last - 1)
        driven, at = np.unique(drives, return_inverse=True)
        torque = np.zeros((len(driven), self._lanes, delivered.shape[1]))
        torque[at, lanes] = delivered
        seen = np.empty((motion.smooth.shape[1], motion.smooth.shape[2], self._lanes))
        turned = np.empty((motion.position.shape[1], motion.position.shape[2], self._lanes))
        self._integrate(
            *(np.ascontiguousarray(np.moveaxis(part[chosen], 0, -1)) for part in motions.parts),
            np.ascontiguousarray(torque.transpose(0, 2, 1)),
            driven,
            self.timestep,
            round(self.arm.settling * self.sensors.rate) * self.factor,
            self.factor,
            decimation_filter(self.factor, self.sensors.accelerometer.bandwidth, self.sensors.rate),
            seen,
            turned,
        )
        motion.smooth[first:last] = seen.transpose(2, 0, 1)[: last - first]
        motion.position[first:last] = turned.transpose(2, 0, 1)[: last - first]

    def _layout(self, plant: Plant) -> MotionLayout:
        found = self._layouts.get(plant.indices)
        if found is None:
            found = self._layouts[plant.indices] = MotionLayout(plant)
        return found
