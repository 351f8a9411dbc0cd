"""A case: poses and noise that are played, the recorder, and its runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import mujoco
import numpy as np
from scipy import signal
from scipy.spatial.transform import Rotation

from scripts.suites.machines.machine import (
    GRAVITY,
    STEP,
    Arm,
    Array,
    Disturbances,
    Fault,
    Machine,
    Played,
    Unstable,
    draw_arm,
    nominal_xml,
    with_gains,
)

SHARES = (0.08, 0.3)
"""Rms torque of the excitation over the limit, log-uniform."""
MOST_TOOL = 15.0
"""Rms acceleration of the tool that a plan would ask for at most [m/s²]."""
CHOSEN, CANDIDATES = 0.6, 30
"""Probability of a pose chosen among random ones, and their number: a plan chooses poses in which
gravity leaves seats open. Healthy cases have the poses of a fault that is not there."""
PEAK, CREST = 0.9, 3.5
"""Peak torque over the limit, and over its rms, that a plan would allow."""
SETTLE, RISE = 0.4, 0.15
"""Time at rest, and of the rising noise, before the record begins [s]."""
AFTER = 0.02
"""Time simulated after the record [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class CaseSettings:
    """Size of a recording."""

    runs: int = 6
    """Suspect runs, and healthy ones where there are any."""
    poses: int = 3
    """Poses among them."""
    seconds: float = 1.2
    """Length of a run [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunPlan:
    """A run to play."""

    pose: Array
    """Pose [rad] (n,)."""
    joint: int
    """Joint that is shaken."""
    noise: Array
    """Noise of rms one by integration step (T,)."""
    level: float
    """Rms of the excitation [rad, N m of torque motors]."""


def draw_plans(
    arm: Arm, fault: Fault, disturbances: Disturbances, rate: float, settings: CaseSettings,
    rng: np.random.Generator, quiet: float,
) -> tuple[RunPlan, ...]:  # fmt: skip
    """Draw poses, joints, noise and level of the runs of a case."""
    servo = disturbances.size("sampled_servo", "rate", 1 / STEP)
    n = arm.joints
    high = min(float(rng.uniform(60.0, 90.0)), 0.35 * rate, 0.2 * servo)
    band = (float(rng.uniform(6.0, 12.0)), high)
    share = float(np.exp(rng.uniform(*np.log(SHARES))))
    joints = rng.permutation(n)[: max(1, settings.runs // settings.poses)]
    count = round((SETTLE + RISE + settings.seconds + AFTER) / STEP)
    plans: list[RunPlan] = []
    load = _load(arm, fault)
    pose = np.zeros(n)
    for i in range(settings.runs):
        if i % len(joints) == 0:
            tried = CANDIDATES if rng.random() < CHOSEN else 1
            pose = min(rng.uniform(-1.3, 1.3, (tried, n)), key=load)
        joint = int(joints[i % len(joints)])
        noise = _noise(band, count, rng)
        torque = share * arm.limit[joint]
        torque *= min(1.0, MOST_TOOL / max(_moved(arm, pose, joint) * torque, 1e-9))
        spare = PEAK * arm.limit[joint] - abs(weight_of(arm, pose)[joint])
        torque = max(min(torque, spare / CREST), 0.02 * arm.limit[joint])
        level = quiet * torque / (arm.kp[joint] if arm.servoed else 1.0)
        plans.append(RunPlan(pose=pose, joint=joint, noise=noise, level=level))
    return tuple(plans)


def _load(arm: Arm, fault: Fault) -> Callable[[Array], float]:
    """Weight that keeps a fault shut, as a function of the pose; only its order counts."""
    model = mujoco.MjModel.from_xml_string(nominal_xml(arm))
    data = mujoco.MjData(model)
    body = model.body(f"link{fault.link + 1}").id

    def load(pose: Array) -> float:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        if fault.kind == "backlash":
            return float(abs(data.qfrc_bias[fault.link]))
        return float(abs(data.xmat[body].reshape(3, 3)[2] @ fault.direction))

    return load


def _noise(band: tuple[float, float], count: int, rng: np.random.Generator) -> Array:
    """Band-limited Gaussian noise of rms one that rises after the time at rest."""
    spectrum = np.fft.rfft(rng.normal(size=2 * count))
    frequency = np.fft.rfftfreq(2 * count, STEP)
    spectrum[(frequency < band[0]) | (frequency > band[1])] = 0
    noise = np.fft.irfft(spectrum)[:count]
    time = np.arange(count) * STEP
    swell = np.clip((time - SETTLE) / (0.7 * RISE), 0, 1)
    return np.asarray(swell * noise / noise.std())


def _moved(arm: Arm, pose: Array, joint: int) -> float:
    """Acceleration of the tool per torque of a joint, the others held [m/s²/(N m)]."""
    model = mujoco.MjModel.from_xml_string(nominal_xml(arm))
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("tool").id)
    return float(np.linalg.norm(jacobian[:, joint]) / full[joint, joint])


def weight_of(arm: Arm, pose: Array) -> Array:
    """Torques that hold the arm's weight by its model [N m]."""
    model = mujoco.MjModel.from_xml_string(nominal_xml(arm))
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    return np.array(data.qfrc_bias)


USUAL_NOISE = 20.0
"""Noise density of an accelerometer where it is not drawn [µg/√Hz]."""


class Recorder:
    """Recorder and sensors of a machine."""

    def __init__(
        self, rate: float, disturbances: Disturbances, *, speeds: bool, seed: list[int]
    ) -> None:
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        self.rate, self.speeds, self.disturbances = rate, speeds, disturbances
        size = disturbances.size
        axis = rng.normal(size=3)
        angle = np.radians(size("accelerometer_rotation", "angle"))
        turned = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        leaks = size("cross_axis", "share") * rng.uniform(-1, 1, (3, 3)) * (1 - np.eye(3))
        self.mixing: Array = (np.eye(3) + leaks) @ turned
        self.offset = float(rng.choice([-1, 1])) * size("clock_offset", "offset")
        self.drift = float(rng.choice([-1, 1])) * size("clock_drift", "drift") * 1e-6
        self.bits = round(size("encoder_quantisation", "bits"))

    def columns(
        self, played: Played, commands: Array, begin: float, seconds: float,
        rng: np.random.Generator,
    ) -> dict[str, Array]:  # fmt: skip
        """Columns of the recording format."""
        count = round(seconds * self.rate)
        time: Array = np.arange(count, dtype=np.float64) / self.rate
        steps: Array = np.arange(len(played.position), dtype=np.float64) * STEP
        size = self.disturbances.size
        late = float(size("accelerometer_delay", "delay") + self.offset)
        asked: Array = begin + time * (1 + self.drift) - late
        analogue = self._filtered(played.acceleration)
        density = size("accelerometer_noise", "density", USUAL_NOISE) * 1e-6 * GRAVITY
        noise = density * np.sqrt(self.rate / 2) * rng.normal(size=(count, 3))
        reading = _at(asked, steps, analogue) @ self.mixing.T + noise
        now = np.minimum(np.round((begin + time) / STEP).astype(int), len(steps) - 1)
        angles, speeds = played.position[now], played.velocity[now]
        if self.bits:
            step = 2 * np.pi / 2**self.bits
            angles = np.round(angles / step) * step
        columns: dict[str, Array] = {"time": time}
        for j in range(angles.shape[1]):
            columns[f"ctrl.servo{j + 1}"] = commands[now, j]
            columns[f"sensor.joint{j + 1}_pos"] = angles[:, j]
            if self.speeds:
                columns[f"sensor.joint{j + 1}_vel"] = speeds[:, j]
        for k, axis in enumerate("xyz"):
            columns[f"sensor.tool_acc.{axis}"] = reading[:, k]
        return columns

    def _filtered(self, acceleration: Array) -> Array:
        """Analogue low-pass of the sensor, then decimation of linear phase."""
        bandwidth = self.disturbances.size("accelerometer_filter", "bandwidth")
        found: Array = acceleration
        if bandwidth:
            sos = signal.butter(2, bandwidth, fs=1 / STEP, output="sos")
            start = signal.sosfilt_zi(sos)[:, :, None] * found[0]
            found, _ = signal.sosfilt(sos, found, axis=0, zi=start)
        if 0.4 * self.rate < 0.45 / STEP:
            sos = signal.butter(4, 0.4 * self.rate, fs=1 / STEP, output="sos")
            found = signal.sosfiltfilt(sos, found, axis=0)
        return np.asarray(found, dtype=np.float64)


def _at(asked: Array, time: Array, values: Array) -> Array:
    return np.stack([np.interp(asked, time, column) for column in values.T], axis=1)


OPENS = 0.05
"""Change of the tool's motion by a fault over the motion, from which the fault opens."""
GAPS = {"structural_looseness": (3e-5, 4e-4), "backlash": (3e-4, 3e-3)}
"""Free travel [m, rad], log-uniform."""
FIRST_LINK = 0.3
"""Probability of the first link over that of another: the whole arm's weight keeps it shut."""
ATTEMPTS = 8
"""Draws of gains and level before a machine counts as impossible."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunMade:
    """A run, recorded."""

    name: str
    """Name of its file."""
    columns: dict[str, Array]
    """Columns of the recording format."""
    excited: str
    """Joint that was shaken."""
    pose: dict[str, float]
    """Pose that was asked for [rad]."""
    condition: str
    """"suspect" or "healthy"."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A case, drawn but not played."""

    number: int
    seed: int
    arm: Arm
    fault: Fault | None
    disturbances: Disturbances
    reference: bool
    """True if the recording has healthy runs."""
    rate: float
    """Sampling rate of the recorder [Hz]."""
    speeds: bool
    """True if joint speeds are recorded."""
    plans: tuple[RunPlan, ...]
    settings: CaseSettings

    @property
    def name(self) -> str:
        """Name of the recording; it tells nothing."""
        return f"machine-{self.number:04d}"

    @property
    def truth(self) -> str:
        """Hypothesis that is true."""
        return "healthy" if self.fault is None else self.fault.hypothesis

    @property
    def model_xml(self) -> str:
        """The user's model."""
        return nominal_xml(self.arm)


@dataclasses.dataclass(frozen=True, kw_only=True)
class CaseMade:
    """A case, played: the recording and the truth about it."""

    case: Case
    """The case, with the gains and levels that were played."""
    runs: tuple[RunMade, ...]
    """Healthy ones first."""
    change: tuple[float, ...]
    """Change of the tool's motion by the fault over the motion, by suspect run."""
    travel: tuple[float, ...]
    """Rms motion of the loose seat over its free travel, by suspect run."""
    share: tuple[float, ...]
    """Rms acceleration of the tool by the seat's motion alone over that of the tool, by run."""
    attempts: int
    """Draws of gains and level that it took."""

    @property
    def opens(self) -> bool:
        """True if in one run at least the seat moves the tool and removing it changes that."""
        return self.opened > 0

    @property
    def opened(self) -> int:
        """Suspect runs in which the fault opens."""
        return sum(min(pair) > OPENS for pair in zip(self.change, self.share, strict=True))


def draw(
    number: int,
    seed: int,
    settings: CaseSettings | None = None,
    *,
    disturbances: Disturbances | None = None,
    healthy: bool | None = None,
    attempt: int = 0,
) -> Case:
    """Draw a case by its number."""
    settings = CaseSettings() if settings is None else settings
    rng = np.random.default_rng(np.random.SeedSequence([seed, number, 0]))
    arm = draw_arm(rng)
    n = arm.joints
    own = Disturbances.draw(rng)
    disturbances = own if disturbances is None else disturbances
    fault = _draw_fault(arm, rng)
    reference = bool((number // 2) % 2)
    rate = float(np.round(np.exp(rng.uniform(np.log(400), np.log(10_000))), -2))
    speeds = bool(rng.random() < 0.6)
    hertz, ratio = rng.uniform(8.0, 25.0, n), rng.uniform(0.4, 1.0, n)
    if not arm.servoed:
        hertz = rng.uniform(1.5, 4.0, n)
    arm = with_gains(arm, np.minimum(hertz, _fastest(disturbances)) * 0.7**attempt, ratio)
    plans = draw_plans(arm, fault, disturbances, rate, settings, rng, 0.7**attempt)
    sound = number % 2 == 0 if healthy is None else healthy
    return Case(
        number=number, seed=seed, arm=arm, fault=None if sound else fault,
        disturbances=disturbances, reference=reference, rate=rate, speeds=speeds,
        plans=plans, settings=settings,
    )  # fmt: skip


def play(case: Case) -> CaseMade:
    """Play and record the runs of a case; loops that do not hold are played with softer servos."""
    healthy = case.fault is None
    for attempt in range(ATTEMPTS):
        try:
            return _play(case, attempt)
        except Unstable:
            if attempt == ATTEMPTS - 1:
                raise
            case = draw(
                case.number, case.seed, case.settings, disturbances=case.disturbances,
                healthy=healthy, attempt=attempt + 1,
            )  # fmt: skip
    raise AssertionError


def _play(case: Case, attempt: int) -> CaseMade:
    seed = [case.seed, case.number]
    loose = Machine(case.arm, case.disturbances, case.fault, [*seed, 1])
    sound = loose if case.fault is None else Machine(
        case.arm, case.disturbances, None, [*seed, 1]
    )  # fmt: skip
    recorder = Recorder(case.rate, case.disturbances, speeds=case.speeds, seed=[*seed, 2])
    references: list[RunMade] = []
    suspects: list[RunMade] = []
    change: list[float] = []
    travel: list[float] = []
    share: list[float] = []
    size = case.disturbances.size
    for i, plan in enumerate(case.plans):
        for session in (0, 1):
            if session == 0 and not case.reference:
                continue
            rng = np.random.default_rng(np.random.SeedSequence([*seed, 3, session, i]))
            drift = np.random.default_rng(np.random.SeedSequence([*seed, 4, session]))
            relative = size("friction_drift", "relative")
            friction = 1 + relative * (drift.uniform(-1, 1) + 0.3 * rng.uniform(-1, 1))
            pose = plan.pose + size("pose_repeat", "error") * rng.uniform(-1, 1, case.arm.joints)
            machine = sound if session == 0 else loose
            played, commands = _run(case, machine, plan, pose, friction)
            columns = recorder.columns(played, commands, SETTLE + RISE, case.settings.seconds, rng)
            made = RunMade(
                name=f"{'healthy' if session == 0 else 'run'}-{i + 1:02d}",
                columns=columns,
                excited=f"joint{plan.joint + 1}",
                pose={f"joint{j + 1}": float(q) for j, q in enumerate(plan.pose)},
                condition="healthy" if session == 0 else "suspect",
            )
            (references if session == 0 else suspects).append(made)
            if session == 1 and case.fault is not None:
                without, _ = _run(case, sound, plan, pose, friction)
                change.append(_change(played, without))
                travel.append(_travel(played, case.fault))
                share.append(_share(machine, played, without, pose))
    return CaseMade(
        case=case, runs=(*references, *suspects), change=tuple(change), travel=tuple(travel),
        share=tuple(share), attempts=attempt + 1,
    )  # fmt: skip


def _run(
    case: Case, machine: Machine, plan: RunPlan, pose: Array, friction: float
) -> tuple[Played, Array]:
    """Motion of a run, and the commands of the model's actuators."""
    arm = case.arm
    weight = weight_of(arm, pose)
    hold = pose + weight / arm.kp if arm.servoed else weight
    settle = round(SETTLE / STEP)
    shaken = plan.level * plan.noise
    played = machine.play(pose, hold, shaken, plan.joint, settle, friction)
    if not arm.servoed:
        return played, played.torque
    commands = np.tile(hold, (len(shaken), 1))
    commands[:, plan.joint] += shaken
    return played, commands


def _draw_fault(arm: Arm, rng: np.random.Generator) -> Fault:
    kind = "structural_looseness" if rng.random() < 2 / 3 else "backlash"
    weights = np.ones(arm.joints)
    weights[0] = FIRST_LINK
    link = int(rng.choice(arm.joints, p=weights / weights.sum()))
    gap = float(np.exp(rng.uniform(*np.log(GAPS[kind]))))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    stop = float(rng.uniform(3e-4, 6e-4))
    friction = float(np.exp(rng.uniform(np.log(0.2), np.log(5.0))))
    if kind == "backlash":
        direction = arm.axes[link]
        friction = float(np.exp(rng.uniform(np.log(1e-4), np.log(3e-3))) * arm.limit[link])
    return Fault(
        kind=kind, link=link, gap=gap, friction=friction, stop=stop,
        direction=(float(direction[0]), float(direction[1]), float(direction[2])),
    )  # fmt: skip


def _fastest(disturbances: Disturbances) -> float:
    """Frequency of the servos that the delay of their loop allows [Hz]."""
    size = disturbances.size
    late = (1 + size("sampled_servo", "delay")) / size("sampled_servo", "rate", 1 / STEP)
    bits = disturbances.has("encoder_quantisation")
    cutoff = size("velocity_filter", "cutoff", 400.0 if bits else 1e6)
    return float(0.05 / (late + 1 / (2 * np.pi * cutoff)))


def _shaken(values: Array) -> Array:
    """Recorded part of a motion, its mean removed, below 200 Hz."""
    begin = round((SETTLE + RISE) / STEP)
    sos = signal.butter(4, 200.0, fs=1 / STEP, output="sos")
    kept = signal.sosfiltfilt(sos, values[begin:], axis=0)
    return np.asarray(kept - kept.mean(axis=0))


def _change(loose: Played, sound: Played) -> float:
    """Change of the tool's motion by the fault over the motion."""
    a, b = _shaken(loose.acceleration), _shaken(sound.acceleration)
    return float(np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)))


def _share(machine: Machine, loose: Played, sound: Played, pose: Array) -> float:
    """Acceleration of the tool by the motion in the seat over its acceleration without."""
    lever = machine.lever(pose)
    moved = _shaken(np.gradient(np.gradient(loose.seat, STEP), STEP))
    b = _shaken(sound.acceleration)
    return float(lever * moved.std() / np.sqrt(np.mean(np.sum(b**2, axis=1))))


def _travel(loose: Played, fault: Fault) -> float:
    begin = round((SETTLE + RISE) / STEP)
    return float(loose.seat[begin:].std() / fault.gap)
