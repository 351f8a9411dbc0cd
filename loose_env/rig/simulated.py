"""Torques and sensor readings of rigs; rigs simulated by MuJoCo or recorded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import ArrayLike, NDArray
from scipy.signal import upfirdn

from loose_env.arms import Arm, LinearArm, MismatchDraw, quiet
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation, torque_periods
from loose_env.faults import Fault, Healthy
from loose_env.rig.plant import Plant, PlantShop
from loose_env.rig.records import Measurement, Records, Trials
from loose_env.sensors import Accelerometer, Encoder, SensorSuite
from loose_env.typing import Array, IndexArray


def whole_factor(rate: float, timestep: float) -> int:
    """Simulation steps per reading."""
    factor = round(1 / (rate * timestep))
    if factor < 1 or abs(factor * rate * timestep - 1) > 1e-6:
        raise InvalidSetting(
            f"the sampling rate {rate:g} Hz must be a whole fraction of the "
            f"simulation's {1 / timestep:g} Hz"
        )
    return factor


@dataclass(frozen=True, kw_only=True, eq=False)
class Controls:
    """Torques of J records of one length, within the drives' limits, and the shaker's force."""

    periods: Array
    """One period of each signal that varies, gravity included (R, steps of a period)."""
    records: NDArray[np.intp]
    """Record of each of them (R,)."""
    drives: NDArray[np.intp]
    """Joint of each of them; n for the shaker (R,)."""
    constant: Array
    """Torque of the drives that do not vary, zero for the others (J, n) [N·m]."""
    gravity: Array
    """Torque that holds each joint of the nominal arm against gravity (J, n) [N·m]."""

    def signals(self, *, drives: int, before: int, after: int) -> Array:
        """Torques of every step, and the shaker force if present (J, steps, drives).

        ``before`` and ``after`` are steps of run-in and run-out around the record.
        """
        jobs, n = self.constant.shape
        steps = np.arange(-before, self.periods.shape[1] + after) % self.periods.shape[1]
        control = np.zeros((jobs, len(steps), drives))
        control[..., :n] = self.constant[:, None]
        for row, job, drive in zip(self.periods, self.records, self.drives, strict=True):
            control[job, :, drive] = row[steps]
        return control

    def commands(self, factor: int, count: int) -> Array:
        """Commanded torque less gravity's at every reading (J, n, count) [N·m].

        ``factor`` is the number of steps per reading.
        """
        jobs, n = self.constant.shape
        command = np.empty((jobs, n, count))
        command[:] = np.where(self.constant != 0, self.constant - self.gravity, 0.0)[..., None]
        at, drives = self.records[self.drives < n], self.drives[self.drives < n]
        played = self.periods[self.drives < n, : factor * count : factor]
        command[at, drives] = played - self.gravity[at, drives, None]
        return command


def controls(nominal: LinearArm, trials: Trials, *, timestep: float) -> Controls:
    """Sample the torques of measurements; each draws from its own generator."""
    arm, n = nominal.arm, nominal.arm.n
    limits = np.array(arm.torque_limits)
    periods, records, drives = torque_periods(
        trials.torque_rms,
        trials.shaker_rms,
        duration=trials.duration,
        band=trials.band,
        timestep=timestep,
        rngs=trials.rngs,
        shaping=trials.shaping,
    )
    gravity = trials.gravity
    if gravity is None:
        gravity = nominal.gravity_torques(trials.poses)
    constant = np.minimum(np.maximum(gravity, -limits), limits)
    joints = np.flatnonzero(drives < n)  # the others are the shaker's
    constant[records[joints], drives[joints]] = 0.0
    periods[joints] += gravity[records[joints], drives[joints], None]
    force = np.inf if arm.shaker is None else arm.shaker.force_limit
    most = np.append(limits, force)[drives][:, None]
    np.minimum(np.maximum(periods, -most, out=periods), most, out=periods)
    return Controls(
        periods=periods, records=records, drives=drives, constant=constant, gravity=gravity
    )


class AxesRead:
    """Accelerometer axes that are read, of all sensors one after the other: tool, links, probes."""

    def __init__(self, arm: Arm, sensors: SensorSuite) -> None:
        choice = sensors.on_links
        axes = list(arm.axes)
        self.link_axes = [0] if choice is not None and choice.tangential else axes
        self.links: tuple[int, ...] = () if choice is None else choice.on(arm)
        """Links that carry an accelerometer."""
        self.on_links = choice is not None
        self.probes = arm.probe_sites
        self.tool = len(axes)
        """Axes of the tool's accelerometer."""
        each = [axes] + [self.link_axes] * len(self.links) + [[0, 1, 2]] * len(self.probes)
        self.sensor = np.repeat(np.arange(len(each)), [len(own) for own in each])
        """Accelerometer of each axis, in the order of the channels (S,)."""
        self._axes = np.concatenate(each)
        owners = [-1, *(link - 1 for link in self.links)] + [-1] * len(self.probes)
        self._owners = np.array(owners)[self.sensor]

    def mixing(self, mismatches: Sequence[MismatchDraw]) -> Array:
        """Output of each axis per true acceleration: gains, cross-axis, mounting (J, S, 3).

        Probes have those of the tool.
        """
        own = np.array([draw.sensor[self._axes] for draw in mismatches])
        if self.on_links:
            on = self._owners >= 0
            links = np.array([draw.link_sensors for draw in mismatches])
            own[:, on] = links[:, self._owners[on], self._axes[on]]
        return own


@lru_cache(maxsize=32)
def decimation_filter(factor: int, cutoff: float, rate: float) -> Array:
    """Taps of the recorder's linear-phase low-pass before decimation.

    Parameters
    ----------
    factor : int
        Fast samples per recorded sample.
    cutoff : float
        Half-amplitude frequency [Hz].
    rate : float
        Recorded rate [Hz].

    Returns
    -------
    ndarray (8 factor + 1,)
        Hamming-windowed sinc, sum 1. Read-only.
    """
    half = 4 * factor
    k = np.arange(-half, half + 1)
    taps = np.sinc(2 * cutoff / (rate * factor) * k) * np.hamming(2 * half + 1)
    taps /= taps.sum()
    taps.flags.writeable = False
    return np.asarray(taps)


def low_passed(
    true: Array, *, sensor: Accelerometer, factor: int, first: int, count: int, rate: float
) -> Array:
    """Low-pass true accelerations and take one sample for each reading.

    Parameters
    ----------
    true : ndarray (..., steps)
        Acceleration along the measured axes at every simulation step [m/s²].
    sensor : Accelerometer
        Parameters of the sensor.
    factor : int
        Simulation steps per reading.
    first, count : int
        Step of the first reading, and number of readings.
    rate : float
        Sampling rate [Hz].

    Returns
    -------
    ndarray (..., count)
    """
    taps = decimation_filter(factor, sensor.bandwidth, rate)
    half = len(taps) // 2
    # Steps from half a filter before the first reading to half a filter after the last.
    used = true[..., first - half : first + factor * (count - 1) + half + 1]
    lead = 2 * half // factor  # outputs before the first whole window
    return np.asarray(upfirdn(taps, used, down=factor)[..., lead : lead + count])


def read_accelerometer(smooth: Array, *, sensor: Accelerometer, rate: float, drawn: Array) -> Array:
    """Turn low-passed accelerations into readings.

    Parameters
    ----------
    smooth : ndarray (..., count)
        Acceleration as `low_passed` gives it [m/s²].
    sensor : Accelerometer
        Parameters of the sensor.
    rate : float
        Sampling rate [Hz].
    drawn : ndarray (..., count)
        Standard normal variates, one for each reading.

    Returns
    -------
    ndarray (..., count)
        Readings [m/s²].
    """
    # White noise of the given density up to half the sampling rate.
    noise = sensor.noise_density * np.sqrt(rate / 2)
    return _rounded(noise * drawn, smooth, sensor.resolution)


def read_encoder(
    true: Array, *, sensor: Encoder, drawn: Array, sliding: NDArray[np.bool_] | None = None
) -> Array:
    """Turn joint positions (..., n, count) [rad or m] into encoder readings of the same shape.

    ``drawn``, of that shape too, are standard normal variates. Rows where ``sliding`` (n,) is true
    are read by a linear scale.
    """
    readings = _rounded(sensor.noise * drawn, true, sensor.resolution)
    if sliding is not None and sliding.any():
        noise = sensor.linear_noise * drawn[..., sliding, :]
        linear = _rounded(noise, true[..., sliding, :], sensor.linear_resolution)
        readings[..., sliding, :] = linear
    return readings


def _rounded(noise: Array, true: Array, step: float) -> Array:
    """Sum rounded to whole steps, where the noise was."""
    noise += true
    if step > 0:
        noise /= step
        np.rint(noise, out=noise)
        noise *= step
    return noise


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """True motion of J arms as it reaches the converters of their sensors."""

    smooth: Array
    """Accelerations along the axes that are read, behind their low-pass (J, S, N) [m/s²]."""
    position: Array
    """Joint positions, one reading more at either end (J, n, N + 2) [rad or m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """Standard normal variates of J records, one for each reading."""

    accelerometers: Array
    """Of the axes that are read (J, S, N)."""
    encoders: Array
    """Of the encoders (J, n, N + 2)."""


def draw_noise(trials: Trials, axes: AxesRead, *, joints: int, count: int) -> Noise:
    """Draw the noise of records of ``count`` readings, each from its own generator."""
    read = np.empty((len(trials), len(axes.sensor), count))
    turned = np.empty((len(trials), joints, count + 2))
    for rng, own, joint in zip(trials.rngs, read, turned, strict=True):
        # Tool, encoders, then all further accelerometers.
        rng.standard_normal(out=own[: axes.tool])
        rng.standard_normal(out=joint)
        if axes.tool < len(axes.sensor):
            rng.standard_normal(out=own[axes.tool :])
    return Noise(accelerometers=read, encoders=turned)


def sampled(
    recorded: Array,
    axes: AxesRead,
    mixing: Array,
    *,
    sensors: SensorSuite,
    joints: int,
    factor: int,
    before: int,
    count: int,
) -> Motion:
    """Filter and sample the channels that MuJoCo recorded."""
    first = 3 * axes.sensor + np.where(axes.sensor > 0, joints, 0)
    channels = recorded.transpose(0, 2, 1)
    mixed = sum(mixing[:, :, k, None] * channels[:, first + k] for k in range(3))
    steps = before + factor * np.arange(-1, count + 1)
    return Motion(
        smooth=low_passed(
            np.asarray(mixed),
            sensor=sensors.accelerometer,
            factor=factor,
            first=before,
            count=count,
            rate=sensors.rate,
        ),
        position=channels[:, 3 : 3 + joints][..., steps],
    )


def read_records(
    motion: Motion,
    noise: Noise,
    axes: AxesRead,
    trials: Trials,
    control: Controls,
    *,
    arm: Arm,
    sensors: SensorSuite,
    factor: int,
    joint_zero: Array,
    failures: Sequence[str | None],
) -> Records:
    """Read records with an arm's sensors."""
    jobs, _, count = motion.smooth.shape
    smooth = read_accelerometer(
        motion.smooth, sensor=sensors.accelerometer, rate=sensors.rate, drawn=noise.accelerometers
    )
    encoder = read_encoder(
        motion.position - joint_zero[..., None],
        sensor=sensors.encoder,
        drawn=noise.encoders,
        sliding=arm.sliding,
    )
    shaken = np.zeros((jobs, count)) if arm.shaker is not None else None
    if shaken is not None:
        on = control.drives == arm.n
        shaken[control.records[on]] = control.periods[on][:, ::factor][:, :count]
    if any(failed := [failure is not None for failure in failures]):
        smooth[failed], encoder[failed] = 0.0, 0.0
    end = axes.tool + len(axes.links) * len(axes.link_axes)
    links = smooth[:, axes.tool : end].reshape(jobs, len(axes.links), len(axes.link_axes), count)
    probes = {site: smooth[:, end + 3 * i :][:, :3] for i, site in enumerate(axes.probes)}
    return Records(
        pose=trials.poses,
        torque_rms=trials.torque_rms,
        duration=trials.duration,
        band=trials.band,
        rate=sensors.rate,
        command=control.commands(factor, count),
        encoder=encoder,
        tool=smooth[:, : axes.tool],
        links=links if axes.on_links else None,
        probes=probes,
        shaker_force=shaken,
        failures=tuple(failures),
    )


class SlotRig(ABC):
    """A rig with one true arm in each slot; subclasses say how several are measured."""

    plants: list[Plant]
    """The arm of every slot."""

    def __init__(
        self,
        arm: Arm,
        slots: int,
        sensors: SensorSuite | None,
        timestep: float | None,
        threads: int,
    ) -> None:
        if isinstance(slots, bool) or not isinstance(slots, (int, np.integer)) or slots < 1:
            raise InvalidSetting(f"a rig needs at least one slot, got {slots!r}")
        if isinstance(threads, bool) or not isinstance(threads, int) or threads < 0:
            raise InvalidSetting(f"threads is a whole number, 0 for all, got {threads!r}")
        self.arm = arm
        self.sensors = SensorSuite() if sensors is None else sensors
        self.timestep = arm.timestep if timestep is None else timestep
        self.factor = whole_factor(self.sensors.rate, self.timestep)
        self.nominal = LinearArm(arm)
        self._axes = AxesRead(arm, self.sensors)
        self.shop = PlantShop(
            arm, timestep=self.timestep, link_accelerometers=self.sensors.link_accelerometers
        )

    @property
    def slots(self) -> int:
        """Number of arms."""
        return len(self.plants)

    @abstractmethod
    def mount_all(
        self, slots: IndexArray, faults: Sequence[Fault], mismatches: Sequence[MismatchDraw]
    ) -> None:
        """Put new arms into slots."""

    def mount(self, slot: int, fault: Fault, mismatch: MismatchDraw | None = None) -> None:
        """Put a new arm into a slot."""
        draw = MismatchDraw.none(self.arm) if mismatch is None else mismatch
        self.mount_all(np.array([slot]), [fault], [draw])

    @abstractmethod
    def record(self, asked: Sequence[Trials]) -> Iterator[tuple[int, IndexArray, Records]]:
        """Take measurements, those of one element of ``asked`` alike in length.

        Yields the index of an element, which of its measurements were taken, and their records.
        The caller may work on these while the next ones are simulated; all must be taken out
        before the rig is used again.
        """

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
        return self.measure_all([slot], pose, excitation, [generator])[0]

    def measure_all(
        self,
        slots: Sequence[int],
        poses: ArrayLike,
        excitations: Excitation | Sequence[Excitation],
        rngs: Sequence[np.random.Generator],
    ) -> list[Measurement]:
        """Take J measurements on different slots at once.

        Parameters
        ----------
        slots : sequence of int (J,)
            Arms of the rig.
        poses : array_like (J, n) or (n,)
            Commanded poses [rad or m], or one for all.
        excitations : Excitation or sequence of them (J,)
            What to play, or one for all.
        rngs : sequence of numpy.random.Generator (J,)
            Sources of excitation, sensor noise and the seat's place in its gap.

        Raises
        ------
        InvalidSetting
            If a slot is named twice, or a pose or excitation does not fit the arm.
        """
        arm, n, count = self.arm, self.arm.n, len(slots)
        if len(set(slots)) != count:
            raise InvalidSetting(f"each slot can be measured once at a time, got slots {[*slots]}")
        at = np.broadcast_to(np.asarray(poses, dtype=float), (count, np.shape(poses)[-1]))
        played = [excitations] * count if isinstance(excitations, Excitation) else [*excitations]
        alike: dict[tuple[object, ...], list[int]] = {}
        for k, own in enumerate(played):
            if at.shape[1] != n or len(own.torque_rms) != n:
                raise InvalidSetting(
                    f"arm {arm.name!r} needs {n} joint positions and {n} torques, got "
                    f"{at.shape[1:]} and {len(own.torque_rms)}"
                )
            if own.shaker_rms > 0 and arm.shaker is None:
                raise InvalidSetting(
                    f"arm {arm.name!r} has no shaker; set shaker_rms to 0 or take an arm "
                    "that stands at one"
                )
            alike.setdefault((own.duration, own.band), []).append(k)
        members = list(alike.values())
        asked = [
            Trials(
                slots=np.array([slots[k] for k in rows], dtype=np.intp),
                poses=at[rows],
                torque_rms=np.array([played[k].torque_rms for k in rows]),
                shaker_rms=np.array([played[k].shaker_rms for k in rows]),
                duration=played[rows[0]].duration,
                band=played[rows[0]].band,
                rngs=[rngs[k] for k in rows],
                shaping=[played[k].shaping for k in rows],
            )
            for rows in members
        ]
        results: dict[int, Measurement] = {}
        for which, taken, records in self.record(asked):
            for k, row in enumerate(taken):
                trial = members[which][row]
                results[trial] = records.measurement(k, played[trial])
        return [results[k] for k in range(count)]


_CHUNK = 16  # arms simulated in one call; reading one chunk overlaps with the next


@dataclass(kw_only=True, eq=False)
class _Batch:
    """Measurements of one length and model layout, and the engine that simulates them."""

    trials: Trials
    engine: Batch
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
    """Why the record of a slot is worthless."""


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
        super().__init__(arm, slots, sensors, timestep, threads)
        self._threads = threads
        # One each: a plant's model holds the pose at which its brakes and springs rest.
        self.plants = [self.shop.build(Healthy(), MismatchDraw.none(arm)) for _ in range(slots)]
        self._engines: dict[int, Batch] = {}
        self._models_changed = True
        # Two, so that one chunk can be read while the next is simulated.
        self._rooms = [np.empty(0), np.empty(0)]

    def mount_all(
        self, slots: IndexArray, faults: Sequence[Fault], mismatches: Sequence[MismatchDraw]
    ) -> None:
        """Put new arms into slots."""
        for slot, plant in zip(slots, self.shop.build_all(faults, mismatches), strict=True):
            self.plants[slot] = plant
        self._models_changed = True

    def record(self, asked: Sequence[Trials]) -> Iterator[tuple[int, IndexArray, Records]]:
        """Take measurements; yields an element's index, which of its own, and their records."""
        if self._models_changed:
            self._load()
        chunks: list[tuple[int, IndexArray]] = []
        for which, trials in enumerate(asked):
            parts = np.array([self.plants[slot].parts for slot in trials.slots])
            order = np.argsort(trials.slots, kind="stable")  # as the engine wants them
            for layout in dict.fromkeys(parts.tolist()):
                members = order[parts[order] == layout]
                chunks += [(which, members[i : i + _CHUNK]) for i in range(0, len(members), _CHUNK)]
        some = [asked[which].some(rows) for which, rows in chunks]
        for (which, rows), records in zip(chunks, self._pipeline(some), strict=True):
            yield which, rows, records

    def _load(self) -> None:
        """Load the models of the arms into the engines, one by number of loose directions.

        All models of a batch must have one layout, and a seat loose in two directions has a joint
        more than one loose in one. Arms of another layout leave their slots in an engine to the
        template of its own, which is never simulated: nobody else's number changes what it does.
        """
        for parts in {plant.parts for plant in self.plants}:
            spare = next(p.indices.template for p in self.plants if p.parts == parts)
            if parts not in self._engines:
                self._engines[parts] = Batch(spare, self.slots, self._threads)
            self._engines[parts].set_models(
                [plant.model if plant.parts == parts else spare for plant in self.plants]
            )
        self._models_changed = False

    def _pipeline(self, chunks: Sequence[Trials]) -> Iterator[Records]:
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

    def _prepare(self, trials: Trials, room: int) -> _Batch:
        """Sample the torques of measurements and set up their arms."""
        factor, rate = self.factor, self.sensors.rate
        half = len(decimation_filter(factor, self.sensors.accelerometer.bandwidth, rate)) // 2
        before = round(self.arm.settling * rate) * factor
        control = controls(self.nominal, trials, timestep=self.timestep)
        delivered = control.signals(
            drives=self.arm.n + (self.arm.shaker is not None),
            before=before,
            after=max(half, factor) + 1,
        )
        batch = self._engines[self.plants[trials.slots[0]].parts]
        position, active = batch.bind("qpos"), batch.bind("eq_active")
        for k, slot in enumerate(trials.slots):
            plant = self.plants[slot]
            batch.state[slot] = 0.0  # at rest, all positions zero
            position[slot, plant.indices.position] = plant.hold_at(trials.poses[k])
            places = plant.gaps * (trials.rngs[k].random(plant.parts) - 0.5)
            position[slot, plant.indices.seat_positions] = places
            active[slot] = plant.model.eq_active0
            released = trials.excited[k]
            if self.arm.shaker is not None and trials.shaker_rms[k] > 0:
                released[self.arm.shaker.joint - 1] = True
            active[slot, plant.indices.brakes] = ~released
            delivered[k, :, : self.arm.n] *= plant.mismatch.drive_gain
        return _Batch(
            trials=trials,
            engine=batch,
            control=control,
            delivered=delivered,
            recorded=self._buffer(room, len(trials), delivered.shape[1], batch.model.nsensordata),
            before=before,
            count=round(trials.duration * rate),
        )

    def _simulate(self, run: _Batch) -> None:
        """Run the engine; store its recordings and the failed arms."""
        batch, data, failures = run.engine, run.recorded, run.failures
        ids = run.trials.slots
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

    def _read_all(self, run: _Batch) -> Records:
        slots = run.trials.slots.tolist()
        mismatches = [self.plants[slot].mismatch for slot in slots]
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
            draw_noise(run.trials, self._axes, joints=self.arm.n, count=run.count),
            self._axes,
            run.trials,
            run.control,
            arm=self.arm,
            sensors=self.sensors,
            factor=self.factor,
            joint_zero=np.array([draw.joint_zero for draw in mismatches]),
            failures=[run.failures.get(slot) for slot in slots],
        )
