"""Rig whose arms are simulated by their linearised equations of motion.

It answers the same calls as `SimulatedRig`, draws the same torques, noise and starting
places from the same generators, and reads its records with the same sensors. Only the engine
differs: no collision, no solver, one compiled loop (see `loose_env.rig.simulation.small_motion`).
It needs numba, which ``pip install 'loose-env[fast]'`` brings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from loose_env.arms import Arm, LinearArm, MismatchDraw
from loose_env.errors import InvalidSetting
from loose_env.faults import Fault, Healthy
from loose_env.rig.jobs import Job, Run, check_jobs, whole_factor
from loose_env.rig.measurement import Measurement
from loose_env.rig.plant import Plant, PlantShop
from loose_env.rig.simulation.controls import controls
from loose_env.rig.simulation.reading import read_record
from loose_env.rig.simulation.slots import SlotRig
from loose_env.rig.simulation.small_motion import require_one_part, small_motion
from loose_env.sensors import SensorSuite, decimation_filter
from loose_env.typing import Array

__all__ = ["ReducedRig"]


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
    ) -> None:
        try:
            from loose_env.rig.simulation.small_motion_loop import integrate
        except ImportError as error:
            raise InvalidSetting(
                "the reduced engine needs numba: pip install 'loose-env[fast]', or take the "
                "engine 'mujoco'"
            ) from error
        if isinstance(slots, bool) or not isinstance(slots, (int, np.integer)) or slots < 1:
            raise InvalidSetting(f"a rig needs at least one slot, got {slots!r}")
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
        self._integrate = integrate
        healthy = self.shop.build(Healthy(), MismatchDraw.none(arm))
        self.plants: list[Plant] = [healthy] * int(slots)
        self._data = mujoco.MjData(healthy.model)
        self._rooms: dict[int, Array] = {}

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
        self.plants[slot] = plant

    def measure_each(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Measurement]]:
        """Take measurements in sequence; yield each job's index and measurement."""
        check_jobs(self.arm, jobs)
        for k, job in enumerate(jobs):
            yield k, self._measure(job)

    def _measure(self, job: Job) -> Measurement:
        plant, arm = self.plants[job.slot], self.arm
        rate, factor = self.sensors.rate, self.factor
        half = len(decimation_filter(factor, self.sensors.accelerometer.bandwidth, rate)) // 2
        before = round(arm.settling * rate) * factor
        control = controls(
            self.nominal,
            [job],
            timestep=self.timestep,
            before=before,
            after=max(half, factor) + 1,
        )
        plant.hold_at(job.pose)
        place = float(plant.gaps[0] * (job.rng.random(plant.parts)[0] - 0.5))
        motion = small_motion(plant, arm, self._data, job.excitation, place)
        delivered = control[0] * plant.mismatch.drive_gain
        channels = len(motion.still) + arm.n
        recorded = self._room(len(delivered) * channels).reshape(len(delivered), channels)
        self._integrate(
            motion.mobility,
            motion.stiffness,
            motion.damping,
            motion.force,
            motion.start,
            motion.drives,
            np.flatnonzero(np.abs(delivered).max(axis=0) > 0),
            motion.readings,
            motion.tilting,
            motion.still,
            motion.encoders,
            motion.zero,
            motion.seat,
            np.zeros(11) if motion.law is None else motion.law.numbers,
            delivered,
            self.timestep,
            recorded,
        )
        others = len(motion.still) - 3
        if others:  # the loop writes encoders last, records have them after the tool
            recorded = np.concatenate(
                [recorded[:, :3], recorded[:, 3 + others :], recorded[:, 3 : 3 + others]], axis=1
            )
        run = Run(
            jobs=[job],
            control=control,
            delivered=delivered[None],
            recorded=recorded[None],
            before=before,
            count=round(job.excitation.duration * rate),
        )
        if not np.isfinite(recorded[-1]).all():
            run.failures[job.slot] = "the simulation diverged: motion not finite"
        return read_record(
            run,
            0,
            arm=arm,
            sensors=self.sensors,
            factor=factor,
            mismatch=plant.mismatch,
            gravity=self.nominal.at(job.pose).gravity_torque,
        )

    def _room(self, size: int) -> Array:
        """Allocate or reuse the buffers of the recorded channels."""
        if size not in self._rooms:
            self._rooms[size] = np.empty(size)
        return self._rooms[size]
