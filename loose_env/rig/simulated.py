"""Rigs that measure many simulated arms at once on the batched engine of MuJoCo."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, MismatchDraw, quiet
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation
from loose_env.faults import Fault, Healthy
from loose_env.rig.measurement import Job, Measurement, check_jobs, whole_factor
from loose_env.rig.plant import Plant, PlantShop
from loose_env.rig.reading import AxesRead, Controls, controls, draw_noise, read_records, sampled
from loose_env.sensors import SensorSuite, decimation_filter
from loose_env.typing import Array


def checked_slots(slots: int) -> int:
    """Return a number of arms, or raise `InvalidSetting`."""
    if isinstance(slots, bool) or not isinstance(slots, (int, np.integer)) or slots < 1:
        raise InvalidSetting(f"a rig needs at least one slot, got {slots!r}")
    return int(slots)


def checked_threads(threads: int) -> int:
    """Return a number of threads, 0 for all, or raise `InvalidSetting`."""
    if isinstance(threads, bool) or not isinstance(threads, int) or threads < 0:
        raise InvalidSetting(f"threads is a whole number, 0 for all, got {threads!r}")
    return threads


class SlotRig(ABC):
    """A rig with one true arm in each slot; subclasses say how several are measured."""

    plants: list[Plant]
    """The arm of every slot."""

    @property
    def slots(self) -> int:
        """Number of arms."""
        return len(self.plants)

    @abstractmethod
    def measure_each(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Measurement]]:
        """Take measurements; yield the index of each job with its measurement."""

    def measure(
        self,
        pose: Array,
        excitation: Excitation,
        *,
        rng: np.random.Generator | None = None,
        slot: int = 0,
    ) -> Measurement:
        """Measure one arm (the first seam: any rig answers this call)."""
        generator = np.random.default_rng(0) if rng is None else rng
        job = Job(
            slot=slot, pose=np.asarray(pose, dtype=float), excitation=excitation, rng=generator
        )
        return self.measure_many([job])[0]

    def measure_many(self, jobs: Sequence[Job]) -> list[Measurement]:
        """Take measurements on different slots at once; results in the order of the jobs."""
        results = dict(self.measure_each(jobs))
        return [results[k] for k in range(len(jobs))]


@dataclass(frozen=True, kw_only=True, eq=False)
class Engine:
    """One batch, in which every arm has its slot."""

    batch: Batch
    """The batch; all its models have the same layout."""
    rest: NDArray[np.float64]
    """State of an arm at rest with all positions zero."""


class Engines:
    """Engines by number of loose degrees of freedom, created on demand.

    All models of a batch must have one layout, and a seat loose in two directions has a joint
    more than one loose in one. Arms whose seats have the same number share an engine; nobody
    else's number changes what an engine does. Arms of another layout leave their slots in it to
    the template of its own, which is never simulated.
    """

    def __init__(self, shop: PlantShop, slots: int, threads: int) -> None:
        self._shop, self._slots, self._threads = shop, slots, threads
        self._made: dict[int, Engine] = {}

    def of(self, parts: int) -> Engine:
        """Return the engine for seats with a number of degrees of freedom."""
        found = self._made.get(parts)
        if found is None:
            batch = Batch(self._shop.spare(parts), self._slots, self._threads)
            rest = batch.state[0].copy()
            rest[:] = 0.0
            found = self._made[parts] = Engine(batch=batch, rest=rest)
        return found

    def load(self, plants: Sequence[Plant]) -> None:
        """Load the models of the arms into every engine."""
        for parts in {plant.parts for plant in plants}:
            spare = self._shop.spare(parts)
            models = [plant.model if plant.parts == parts else spare for plant in plants]
            self.of(parts).batch.set_models(models)


_CHUNK = 16  # arms simulated in one call; reading one chunk overlaps with the next


@dataclass(kw_only=True, eq=False)
class _Batch:
    """Jobs with one duration and one model layout, and the engine that simulates them."""

    jobs: Sequence[Job]
    engine: Engine
    control: Controls
    delivered: Array
    """Torques that the drives deliver, and the shaker's force (jobs, steps, drives)."""
    recorded: Array
    """Sensor channels of every step (jobs, steps, channels)."""
    before: int
    """Steps of run-in."""
    count: int
    """Samples of the record."""
    failures: dict[int, str] = field(default_factory=dict)


class SimulatedRig(SlotRig):
    """Measures many simulated arms at once on MuJoCo's batched engine.

    Each slot holds one true arm: a fault and a draw of the mismatch. A slot's readings depend
    on its arm, the pose, the excitation and the generator alone, not on the other slots, the
    batch size, the thread count or what was measured before.

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

    Examples
    --------
    >>> import numpy as np
    >>> from loose_env.arms import planar
    >>> from loose_env.excitation import Excitation
    >>> rig = SimulatedRig(planar(2))
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
        slots = checked_slots(slots)
        threads = checked_threads(threads)
        self.arm = arm
        self.sensors = sensors if sensors is not None else SensorSuite()
        self.timestep = arm.timestep if timestep is None else timestep
        self.factor = whole_factor(self.sensors.rate, self.timestep)
        self.nominal = LinearArm(arm)
        self._axes = AxesRead(arm, self.sensors)
        self.shop = PlantShop(
            arm, timestep=self.timestep, link_accelerometers=self.sensors.link_accelerometers
        )
        self._engines = Engines(self.shop, slots, threads)
        # One each: a plant's model holds the pose at which its brakes and springs rest.
        self.plants: list[Plant] = [
            self.shop.build(Healthy(), MismatchDraw.none(arm)) for _ in range(slots)
        ]
        self._engines.load(self.plants)
        self._models_changed = False
        # Two, so that one chunk can be read while the next is simulated.
        self._rooms = [np.empty(0), np.empty(0)]

    @property
    def _batch(self) -> Batch:
        """Engine of all arms whose seat has one degree of freedom."""
        return self._engines.of(1).batch

    def mount(self, slot: int, fault: Fault, mismatch: MismatchDraw | None = None) -> None:
        """Put a new arm into a slot."""
        draw = MismatchDraw.none(self.arm) if mismatch is None else mismatch
        self.plants[slot] = self.shop.build(fault, draw)
        self._models_changed = True

    def measure_each(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Measurement]]:
        """Take measurements as `measure_many`, yielding each on completion.

        Yields the index of a job with its measurement. While the caller works on it, the engine
        goes on with the next ones. All must be taken out before the rig is used again.

        Raises
        ------
        InvalidSetting
            If a slot is named twice, or a pose or excitation does not fit the arm.
        """
        check_jobs(self.arm, jobs)
        if self._models_changed:
            self._engines.load(self.plants)
            self._models_changed = False
        alike: dict[tuple[object, ...], list[int]] = {}  # of one length and one model layout
        for k, job in enumerate(jobs):
            key = (job.excitation.duration, job.excitation.band, self.plants[job.slot].parts)
            alike.setdefault(key, []).append(k)
        chunks: list[list[int]] = []
        for members in alike.values():
            members.sort(key=lambda k: jobs[k].slot)  # as the batch wants them
            chunks += [members[i : i + _CHUNK] for i in range(0, len(members), _CHUNK)]
        for chunk, measured in zip(
            chunks, self._pipeline([[jobs[k] for k in chunk] for chunk in chunks]), strict=True
        ):
            yield from zip(chunk, measured, strict=True)

    def _pipeline(self, chunks: Sequence[Sequence[Job]]) -> Iterator[list[Measurement]]:
        """Prepare and read on this thread while the engine simulates the next batch."""
        if len(chunks) == 1:
            run = self._prepare(chunks[0], 0)
            self._simulate(run)
            yield self._read_all(run)
            return
        with ThreadPoolExecutor(max_workers=1) as engine:
            pending: tuple[_Batch, Future[None]] | None = None
            for k, chunk in enumerate(chunks):
                run = self._prepare(chunk, k % 2)
                if pending is not None:
                    pending[1].result()
                started = engine.submit(self._simulate, run)
                if pending is not None:
                    yield self._read_all(pending[0])
                pending = (run, started)
            if pending is not None:
                pending[1].result()
                yield self._read_all(pending[0])

    def _prepare(self, jobs: Sequence[Job], room: int) -> _Batch:
        """Sample the torques of a batch of jobs and set up their arms."""
        factor, rate = self.factor, self.sensors.rate
        half = len(decimation_filter(factor, self.sensors.accelerometer.bandwidth, rate)) // 2
        before = round(self.arm.settling * rate) * factor
        control = controls(self.nominal, jobs, timestep=self.timestep)
        delivered = control.signals(
            drives=self.arm.n + (self.arm.shaker is not None),
            before=before,
            after=max(half, factor) + 1,
        )
        engine = self._engines.of(self.plants[jobs[0].slot].parts)
        batch = engine.batch
        position, active = batch.bind("qpos"), batch.bind("eq_active")
        for k, job in enumerate(jobs):
            plant = self.plants[job.slot]
            batch.state[job.slot] = engine.rest
            position[job.slot, plant.position] = plant.hold_at(job.pose)
            places = plant.gaps * (job.rng.random(plant.parts) - 0.5)
            position[job.slot, plant.seat_positions] = places
            active[job.slot] = plant.model.eq_active0
            released = np.array(job.excitation.excited)
            if self.arm.shaker is not None and job.excitation.shaker_rms > 0:
                released[self.arm.shaker.joint - 1] = True
            active[job.slot, plant.brakes] = ~released
            delivered[k, :, : self.arm.n] *= plant.mismatch.drive_gain
        return _Batch(
            jobs=jobs,
            engine=engine,
            control=control,
            delivered=delivered,
            recorded=self._buffer(room, len(jobs), delivered.shape[1], batch.model.nsensordata),
            before=before,
            count=round(jobs[0].excitation.duration * rate),
        )

    def _simulate(self, run: _Batch) -> None:
        """Run the engine; store its recordings and the failed arms."""
        batch, data, failures = run.engine.batch, run.recorded, run.failures
        ids = np.array([job.slot for job in run.jobs])
        batch.warning[ids] = 0
        try:
            with quiet():
                batch.rollout(
                    run.delivered.shape[1],
                    run.delivered,
                    record=("sensordata",),
                    ids=ids,
                    out={"sensordata": data},
                )
        except SimulationError as error:  # the other simulations ran to their end
            failures |= {int(i): f"the simulation stopped: {batch.error(i)}" for i in error.ids}
        for k, slot in enumerate(ids):
            counts = batch.warning[slot, :, 1]  # column 0 holds what the last one was about
            if counts.any():
                kinds = [
                    mujoco.mjtWarning(w).name.removeprefix("mjWARN_").lower()
                    for w in np.flatnonzero(counts)
                ]
                failures[int(slot)] = f"the simulation diverged: {', '.join(kinds)}"
            elif not np.isfinite(data[k]).all():
                failures.setdefault(int(slot), "the simulation diverged: motion not finite")

    def _buffer(self, room: int, jobs: int, steps: int, channels: int) -> Array:
        """Allocate or reuse the buffers of the recorded channels."""
        size = jobs * steps * channels
        if self._rooms[room].size < size:
            self._rooms[room] = np.empty(size)
        return self._rooms[room][:size].reshape(jobs, steps, -1)

    def _read_all(self, run: _Batch) -> list[Measurement]:
        mismatches = [self.plants[job.slot].mismatch for job in run.jobs]
        motion = sampled(
            run.recorded,
            self._axes,
            self._axes.mixing(mismatches),
            sensors=self.sensors,
            joints=self.arm.n,
            factor=self.factor,
            before=run.before,
            count=run.count,
        )
        return read_records(
            motion,
            draw_noise(run.jobs, self._axes, joints=self.arm.n, count=run.count),
            self._axes,
            run.jobs,
            run.control,
            arm=self.arm,
            sensors=self.sensors,
            factor=self.factor,
            joint_zero=np.array([draw.joint_zero for draw in mismatches]),
            failures=run.failures,
        )
