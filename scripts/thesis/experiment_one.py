"""Experiment One, simulated: repeatability of a cylindrical arm whose boom has play.

The boom of the arm runs through four roller bearing blocks with play. With its weight behind their
middle one diagonal pair of blocks carries it, ahead of it the other pair. As it strokes through the
point between, it pitches from one pair to the other by the play: the boom's seat is a hinge with a
gap, its stops are the pairs of blocks, and gravity turns it over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from scipy.signal import butter, lfilter, sosfiltfilt

from loose_env.envs import INK, MEASURED, MUTED, SHAKEN, TRUTH
from loose_env.errors import InvalidData
from loose_env.typing import Array
from scripts.charts import Panel, chart, curve
from scripts.thesis.page import Section, printed, section
from scripts.thesis.plots import rms
from scripts.thesis.rigs import GUIDE, LIFT, REACH, cylindrical

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEAT_HINGE = "boom_pitch"
"""Joint about which the boom pitches in its blocks."""
AXES = ("joint1", "joint2", "joint3")
"""Joints of swing, lift and reach."""
_SOFT = 1e-4  # MuJoCo's smallest constraint impedance
SHUDDER_BAND = (12.0, 120.0)
"""Band that holds the boom's shudder and leaves out the stroke itself [Hz]."""
SHIFTED_POSE = "A"
"""Pose whose end point is moved."""


@dataclass(frozen=True, kw_only=True)
class Guideway:
    """Guide, servos, sensors and trigger; estimates but for the potentiometer's noise."""

    play: float = 0.30e-3
    """Vertical travel of the boom within a bearing block [m]; 0 for a preloaded guide."""
    spacing: float = 0.50
    """Distance between front and rear blocks [m]."""
    block_stiffness: float = 4e7
    """Stiffness of one block [N/m]."""
    block_damping_ratio: float = 0.08
    """Damping of the boom's pitching on its blocks [1]."""
    servo_mode_hz: tuple[float, float, float] = (2.5, 6.0, 6.0)
    """Modes of the position servos of swing, lift and reach, all critically damped [Hz]."""
    potentiometer_noise: float = 25e-3
    """Noise of the reach potentiometer, peak to peak, taken as six deviations [V] (6.2.1)."""
    potentiometer_scale: float = 10.0 / 1.05
    """Volt per metre of reach."""
    feedback_bandwidth: float = 4.0
    """Two-pole low-pass of the potentiometer's signal in the servo [Hz]."""
    accelerometer_noise: float = 0.02
    """Noise of the accelerometer channel, rms [m/s²]."""
    trigger_jitter: float = 0.5e-3
    """Standard deviation of the controller's trigger [s]."""
    speed: float = 0.5
    """Speed of the stroke [m/s]."""
    ramp: float = 0.08
    """Time to reach it, and to stop [s]."""
    lead: float = 0.10
    """Time before the stroke starts [s]."""
    trigger: float = 0.12
    """Start of the record, after the start of the stroke [s]."""
    record: float = 1.40
    """Length of a record [s]."""
    rate: float = 1000.0
    """Sampling rate [Hz]."""
    timestep: float = 5e-4
    """Simulation step [s]."""

    @property
    def every(self) -> int:
        """Steps from sample to sample."""
        return max(1, round(1 / (self.rate * self.timestep)))

    @property
    def gap(self) -> float:
        """Angle by which the boom pitches from one pair of blocks to the other [rad]."""
        return 2 * self.play / self.spacing

    @property
    def pitch_stiffness(self) -> float:
        """Stiffness of the boom's pitching on a pair of blocks [N·m/rad]."""
        return self.block_stiffness * self.spacing**2 / 2


class StrokePose(NamedTuple):
    """Swing [rad], height above the lowest [m], reach at the start and end of the stroke [m]."""

    swing: float
    lift: float
    start: float
    end: float


POSES = {
    "A": StrokePose(0.0, 0.05, 0.50, 1.00),
    "B": StrokePose(0.0, 0.05, 0.05, 0.55),
    "C": StrokePose(0.0, 0.70, 0.50, 1.00),
    "D": StrokePose(0.0, 0.70, 0.05, 0.55),
    "E": StrokePose(np.pi / 2, 0.70, 0.50, 1.00),
}
"""Out and low, in and low, out and high, in and high, and C swung by 90°; figures estimated."""


def transfer_point() -> float:
    """Reach at which the weight of boom and wrist lies over the middle of the guide [m]."""
    arm = cylindrical()
    data = mujoco.MjData(arm.model)
    mujoco.mj_forward(arm.model, data)
    boom = arm.model.body("flange3").id
    return float(data.body(GUIDE).xpos[0] - data.subtree_com[boom][0])


def guideway_model(pose: StrokePose, settings: Guideway) -> mujoco.MjModel:
    """Compile the arm with a locked wrist, servos on the major axes and the boom's seat."""
    spec = cylindrical().spec.copy()
    for number in (4, 5, 6):
        spec.delete(spec.joint(f"joint{number}"))
    blocks = spec.body(GUIDE)
    blocks.add_joint(name=SEAT_HINGE, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0])
    for name, limits in {"low": (0.0, 2.0), "high": (-2.0, 0.0)}.items():
        stop = spec.add_tendon(
            name=name,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=list(limits),
            solimp_limit=[_SOFT, _SOFT, 0.001, 0.5, 2],
        )
        stop.wrap_joint(SEAT_HINGE, 1.0)
    for joint in AXES:
        spec.add_actuator(name=f"servo_{joint}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint)
    sensor = mujoco.mjtSensor
    spec.add_sensor(
        name="acceleration",
        type=sensor.mjSENS_ACCELEROMETER,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="wrist_base",
    )
    for name in ("joint3", SEAT_HINGE):
        spec.add_sensor(
            name=f"place_{name}",
            type=sensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
    spec.option.timestep = settings.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # MuJoCo 4.0.0 has a fault in its sparse Cholesky factorisation.
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model = spec.compile()
    _seat(model, settings)
    _servos(model, pose, settings)
    return model


def _inertia(model: mujoco.MjModel, pose: StrokePose, joint: str) -> float:
    """Inertia of a joint in the middle of the stroke."""
    data = mujoco.MjData(model)
    middle = (pose.swing, pose.lift, (pose.start + pose.end) / 2)
    for name, value in zip(AXES, middle, strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_forward(model, data)
    full, dof = np.zeros((model.nv, model.nv)), model.joint(joint).dofadr[0]
    mujoco.mj_fullM(model, data, full)
    return float(full[dof, dof])


def _seat(model: mujoco.MjModel, settings: Guideway) -> None:
    """Set the boom's stops, or with no play the spring that takes their place."""
    hinge = model.joint(SEAT_HINGE)
    dof = hinge.dofadr[0]
    stiffness = settings.pitch_stiffness
    inertia = _inertia(model, POSES["B"], SEAT_HINGE)
    damping = 2 * settings.block_damping_ratio * np.sqrt(stiffness * inertia)
    low, high = model.tendon("low").id, model.tendon("high").id
    if settings.play == 0:
        model.tendon_limited[[low, high]] = 0
        model.jnt_stiffness[hinge.id] = stiffness
        model.dof_damping[dof] = damping
        return
    model.tendon_range[low] = (-settings.gap / 2, 2.0)
    model.tendon_range[high] = (-2.0, settings.gap / 2)
    for stop in (low, high):
        weight = (1 - _SOFT) * model.tendon_invweight0[stop]
        model.tendon_solref_lim[stop] = (-stiffness * weight, -damping * weight)


def _servos(model: mujoco.MjModel, pose: StrokePose, settings: Guideway) -> None:
    """Give the major axes position servos for the inertia in the middle of the stroke."""
    for joint, mode in zip(AXES, settings.servo_mode_hz, strict=True):
        drive = model.actuator(f"servo_{joint}").id
        mass, omega = _inertia(model, pose, joint), 2 * np.pi * mode
        model.actuator_gainprm[drive, 0] = mass * omega**2
        model.actuator_biastype[drive] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_biasprm[drive, :3] = (0.0, -mass * omega**2, -2 * mass * omega)


@dataclass(frozen=True, kw_only=True, eq=False)
class Strokes:
    """Records of repeated strokes in one pose."""

    time: Array
    """Time since the nominal trigger [s] (N,)."""
    acceleration: Array
    """At the base of the wrist, along the boom, as measured [m/s²] (strokes, N)."""
    potentiometer: Array
    """Reach by the potentiometer, as measured [V] (strokes, N)."""
    reach: Array = field(repr=False)
    """True reach [m] (strokes, N)."""
    pitch: Array = field(repr=False)
    """True pitch of the boom on its blocks [rad] (strokes, N)."""

    @property
    def mean(self) -> Array:
        """Mean acceleration over the strokes (N,)."""
        return np.asarray(self.acceleration.mean(axis=0))


def stroke_many(
    pose: StrokePose, count: int, settings: Guideway, rng: np.random.Generator
) -> Strokes:
    """Stroke the horizontal axis again and again, under point-to-point control."""
    model = guideway_model(pose, settings)
    start = _at_rest(model, pose, settings)

    margin = 6 * settings.trigger_jitter  # so that a jittered record has samples at its ends
    begin = settings.lead + settings.trigger - margin
    steps = round((begin + settings.record + 2 * margin) / settings.timestep)
    t = settings.timestep * np.arange(steps, dtype=float)
    control = np.tile(start[1], (count, steps, 1))
    noise = settings.potentiometer_noise / 6 / settings.potentiometer_scale
    control[:, :, 2] += _travel(t - settings.lead, pose, settings) - _seen_by_servo(
        noise, (count, steps), model, settings, rng
    )
    batch = Batch(model, count, 1)
    batch.state[:] = start[0]
    recorded = batch.rollout(steps, control, record=("sensordata",))["sensordata"]
    if not np.isfinite(recorded).all() or batch.warning[:, :, 1].any():
        raise InvalidData("a stroke diverged; use a shorter timestep or softer blocks")

    wanted = np.arange(round(settings.record * settings.rate)) / settings.rate
    first = round(begin / settings.timestep)
    jitter = np.clip(settings.trigger_jitter * rng.standard_normal(count), -margin, margin)
    sampled = np.empty((3, count, len(wanted)))
    for k in range(count):
        # Sensors of a step are those of its start; a sample is the mean over one period.
        at = begin + margin + jitter[k] + wanted
        # The accelerometer has three axes, the first along the boom.
        for channel, column in enumerate((0, 3, 4)):
            smooth = recorded[k, :, column]
            if channel == 0 and settings.every > 1:
                smooth = np.convolve(smooth, np.ones(settings.every) / settings.every, "same")
            sampled[channel, k] = np.interp(at, t[first:], smooth[first:])
    acceleration, reach, pitch = sampled
    shape = reach.shape
    return Strokes(
        time=wanted,
        acceleration=acceleration + settings.accelerometer_noise * rng.standard_normal(shape),
        potentiometer=settings.potentiometer_scale * reach
        + settings.potentiometer_noise / 6 * rng.standard_normal(shape),
        reach=reach,
        pitch=pitch,
    )


def _travel(t: Array, pose: StrokePose, settings: Guideway) -> Array:
    """Commanded reach [m] over time since the start of the stroke: smooth start and stop."""
    distance = pose.end - pose.start
    # A raised-cosine run up, steady speed, and the same down.
    ramp, speed = settings.ramp, settings.speed * np.sign(distance)
    steady = abs(distance) / settings.speed - ramp

    def run_up(x: Array) -> Array:
        x = np.clip(x, 0.0, ramp)
        return np.asarray(speed / 2 * (x - ramp / np.pi * np.sin(np.pi * x / ramp)))

    up = run_up(t) + speed * np.clip(t - ramp, 0.0, None)
    stopped = t - ramp - steady
    down = run_up(stopped) + speed * np.clip(stopped - ramp, 0.0, None)
    return np.asarray(up - down)


def _seen_by_servo(
    noise: float,
    shape: tuple[int, int],
    model: mujoco.MjModel,
    settings: Guideway,
    rng: np.random.Generator,
) -> Array:
    """Noise of the reach potentiometer as an error of the set point [m]."""
    dt = settings.timestep
    # White over the recording band; a step's sample carries more, so that the density is kept.
    white = noise * np.sqrt(1 / (settings.rate * dt)) * rng.standard_normal(shape)
    keep = np.exp(-2 * np.pi * settings.feedback_bandwidth * dt)
    # Two poles, so that the rate is low-passed too.
    poles = [1.0, -2 * keep, keep**2]
    low = np.asarray(lfilter([(1 - keep) ** 2], poles, white, axis=1))
    drive = model.actuator("servo_joint3").id
    gain, rate_gain = model.actuator_gainprm[drive, 0], -model.actuator_biasprm[drive, 2]
    rate = np.diff(low, axis=1, prepend=low[:, :1]) / dt
    return np.asarray(low + rate_gain / gain * rate)


def _at_rest(model: mujoco.MjModel, pose: StrokePose, settings: Guideway) -> tuple[Array, Array]:
    """State at rest at the start of the stroke, and the set points that hold it there."""
    data = mujoco.MjData(model)
    target = np.array([pose.swing, pose.lift, pose.start])
    data.qpos[[model.joint(j).qposadr[0] for j in AXES]] = target
    mujoco.mj_forward(model, data)
    weight = data.qfrc_bias[[model.joint(j).dofadr[0] for j in AXES]]
    data.ctrl[:] = target + weight / model.actuator_gainprm[:, 0]
    # Start on the pair of blocks that carries the boom, and let what sags come to rest.
    load = data.qfrc_bias[model.joint(SEAT_HINGE).dofadr[0]]
    data.joint(SEAT_HINGE).qpos[0] = -np.sign(load) * settings.gap / 2
    for _ in range(round(4.0 / settings.timestep)):
        mujoco.mj_step(model, data)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state, data.ctrl.copy()


def repeatability(strokes: Array) -> tuple[float, float]:
    """Rms of a stroke about the mean of its set, and the lowest correlation with the others' mean.

    ``strokes`` (strokes, N): one signal a stroke.
    """
    mean = strokes.mean(axis=0)
    others = (len(strokes) * mean - strokes) / (len(strokes) - 1)
    lowest = min(np.corrcoef(s, o)[0, 1] for s, o in zip(strokes, others, strict=True))
    return float(np.sqrt(np.mean((strokes - mean) ** 2))), float(lowest)


def right_sets(sets: Mapping[str, Array]) -> float:
    """Share of strokes nearest to the mean of their own set, themselves left out of it."""
    means = {name: strokes.mean(axis=0) for name, strokes in sets.items()}
    right = []
    for own, strokes in sets.items():
        n = len(strokes)
        for stroke in strokes:
            to = {name: np.mean((stroke - mean) ** 2) for name, mean in means.items()}
            to[own] = np.mean((stroke - (n * means[own] - stroke) / (n - 1)) ** 2)
            right.append(min(to, key=lambda name: to[name]) == own)
    return float(np.mean(right))


def shudder(strokes: Strokes, settings: Guideway) -> Array | None:
    """Find where the boom goes over by its true pitch (strokes, 3); None if it does not.

    By stroke: rms of the mean acceleration in the shudder's band in the 0.2 s after the boom lands,
    reach at which the boom leaves its rear seat, and at which it lands on the other [m].
    """
    half, quick = settings.gap / 2, _quick(strokes, settings)
    over = (strokes.pitch[:, 0] < -0.9 * half) & (strokes.pitch[:, -1] > 0.9 * half)
    if half == 0 or not over.all():
        return None
    found = []
    for reach, pitch in zip(strokes.reach, strokes.pitch, strict=True):
        landed = int(np.argmax(pitch >= half))
        # The last instant on the rear seat before that.
        left = int(np.flatnonzero(pitch[:landed] <= -half)[-1])
        after = quick[landed : landed + round(0.2 * settings.rate)]
        found.append((after.std(), reach[left], reach[landed]))
    return np.array(found)


def ringing(settings: Guideway) -> float:
    """Frequency at which the raised, extended arm rings after a stroke without noise [Hz]."""
    still = replace(
        settings, potentiometer_noise=0.0, accelerometer_noise=0.0, trigger_jitter=0.0, record=2.4
    )
    raised = StrokePose(0.0, LIFT, REACH - 0.5, REACH)
    found = stroke_many(raised, 1, still, np.random.default_rng(0))
    tail = found.acceleration[0, found.time > 1.15]
    spectrum = np.abs(np.fft.rfft((tail - tail.mean()) * np.hanning(len(tail)), 16384))
    frequency = np.fft.rfftfreq(16384, 1 / settings.rate)
    inside = (frequency > 4.0) & (frequency < 40.0)
    return float(frequency[inside][np.argmax(spectrum[inside])])


def experiment_one(seed: int) -> Section:
    """Stroke the arm in five poses, with its end point moved, and without the play."""
    told, settings = printed("experiment_one"), Guideway()
    count, averages = told["strokes_per_set"], told["spectrum_averages"]

    def run(pose: StrokePose, key: int, settings: Guideway = settings) -> Strokes:
        return stroke_many(pose, count, settings, np.random.default_rng([seed, key]))

    sets = {name: run(POSES[name], k) for k, name in enumerate(told["poses"])}
    base, moved = sets[SHIFTED_POSE], POSES[SHIFTED_POSE]
    shifted = {0: base} | {
        by: run(moved._replace(end=moved.end + by / 1000), 10 + k)
        for k, by in enumerate(told["end_shifts_mm"])
    }
    tight = run(POSES["B"], 20, replace(settings, play=0.0))
    rings, weight_over = ringing(settings), transfer_point()

    def distance(one: Strokes, other: Strokes) -> float:
        return rms(one.mean - other.mean)

    own = {name: repeatability(s.acceleration) for name, s in sets.items()}
    apart = {(p, q): distance(sets[p], sets[q]) for p in sets for q in sets if p != q}
    nearest = min(apart, key=lambda pair: apart[pair])
    between = apart[nearest]
    spread, lowest = max(s for s, _ in own.values()), min(r for _, r in own.values())
    told_apart = right_sets({name: s.acceleration for name, s in sets.items()})
    ends_apart = right_sets({str(by): s.acceleration for by, s in shifted.items()})
    smallest = min(distance(s, base) for by, s in shifted.items() if by)
    own_spread, volts = own[SHIFTED_POSE][0], repeatability(base.potentiometer)[0]
    over_spread = smallest / own_spread
    goes_over = {name: shudder(s, settings) for name, s in sets.items()}
    at = {name: found for name, found in goes_over.items() if found is not None}
    crossing = " and ".join(at)
    _, leaves, lands = np.mean([s.mean(axis=0) for s in at.values()], axis=0)
    ahead, scatter = leaves - weight_over, max(s[:, 2].std() for s in at.values())
    with_play, without, quiet = _same_window(sets["B"], tight, settings)

    pose_rows, end_rows = [], []
    for name, (size, correlation) in own.items():
        other, seen = min((d, q) for (p, q), d in apart.items() if p == name), goes_over[name]
        shuddered = "none"
        if seen is not None:
            shuddered = f"{seen[:, 0].mean():.2f} from {seen[:, 2].mean():.3f} m"
        pose_rows.append((name, size, correlation, *other, shuddered))
    for by in sorted(shifted):
        change = distance(shifted[by], base)
        rest = [s.potentiometer[:, -100:].mean() for s in (shifted[by], base)]
        pair = right_sets({"here": shifted[by].acceleration, "base": base.acceleration})
        off = (rest[0] - rest[1]) / settings.potentiometer_scale
        end_rows.append((by, change, change / own_spread, off, pair) if by else ("0", *4 * "-"))
    ratio = without / with_play
    return section(
        "experiment_one",
        locals(),
        [pose_rows, end_rows],
        [
            time_figure(sets, tight),
            spectrum_figure(sets, averages, settings),
            end_figure(shifted),
            shudder_figure(sets["B"], tight, weight_over),
        ],
    )


def _quick(strokes: Strokes, settings: Guideway) -> Array:
    """Mean acceleration of a set in the shudder's band [m/s²] (N,)."""
    filter_ = butter(4, SHUDDER_BAND, "bandpass", fs=settings.rate, output="sos")
    return np.asarray(sosfiltfilt(filter_, strokes.mean))


def _same_window(loose: Strokes, tight: Strokes, settings: Guideway) -> tuple[float, float, float]:
    """Shudder with play and without, and the quiet part before; mean records, rms [m/s²]."""
    mean = [_quick(strokes, settings) for strokes in (loose, tight)]
    landed = int(np.argmax(loose.pitch.mean(axis=0) >= settings.gap / 2))
    width = round(0.2 * settings.rate)
    window, before = slice(landed, landed + width), slice(landed - width - 150, landed - 150)
    return rms(mean[0][window]), rms(mean[1][window]), rms(mean[0][before])


_LABEL = "m/s²"
_POSE_WORDS = {"A": "out and low", "B": "in and low", "C": "out and high"}


def time_figure(sets: Mapping[str, Strokes], tight: Strokes) -> Figure:
    """Draw three strokes each of poses A, B and C, and of B without play."""
    shown = {f"pose {name}: {words}": sets[name] for name, words in _POSE_WORDS.items()}
    shown["pose B, play taken out of the guide"] = tight
    panels = [
        Panel(
            title=title,
            up=_LABEL,
            curves=[
                curve(strokes.time, strokes.acceleration[k], color=colour, linewidth=0.8)
                for k, colour in enumerate((MEASURED, SHAKEN, INK))
            ],
        )
        for title, strokes in shown.items()
    ]
    return chart(panels, across="time since the trigger [s]", sharey="all")


def spectrum_figure(sets: Mapping[str, Strokes], averages: int, settings: Guideway) -> Figure:
    """Draw the spectra of poses A and B, and their difference."""
    frequency, a = _spectrum(sets["A"].acceleration[:averages], settings.rate)
    _, b = _spectrum(sets["B"].acceleration[:averages], settings.rate)
    shown = frequency <= 60.0
    panels = [
        Panel(
            title=title,
            up=_LABEL,
            curves=[curve(frequency[shown], line[shown], color=colour)],
            look={"yscale": scale},
        )
        for title, line, colour, scale in (
            ("pose A", a, MEASURED, "log"),
            ("pose B", b, MEASURED, "log"),
            ("A less B", a - b, TRUTH, "linear"),
        )
    ]
    return chart(panels, across="frequency [Hz]")


def _spectrum(strokes: Array, rate: float) -> tuple[Array, Array]:
    """Amplitude spectrum, averaged over strokes: frequency [Hz] and amplitude [m/s²]."""
    window = np.hanning(strokes.shape[1])
    level = strokes - strokes.mean(axis=1, keepdims=True)
    lines = np.abs(np.fft.rfft(level * window)) * 2 / window.sum()
    frequency = np.asarray(np.fft.rfftfreq(strokes.shape[1], 1 / rate), dtype=np.float64)
    return frequency, np.asarray(lines.mean(axis=0))


def end_figure(shifted: Mapping[int, Strokes]) -> Figure:
    """Draw the end of the stroke for each end point; keys are shifts [mm]."""
    colours = {-4: TRUTH, -2: SHAKEN, 0: INK, 2: "#56b4e9", 4: MEASURED}
    base = shifted[0]
    window = (base.time > 0.86) & (base.time < 1.10)
    spread = base.acceleration.std(axis=0)[window]
    curves = []
    for by in sorted(shifted):
        values = shifted[by].mean[window]
        band = values if by else np.array([values, values - spread, values + spread])
        name = f"{by:+d} mm" if by else "unmoved"
        curves.append(curve(base.time[window], band, name, color=colours[by]))
    title, across = "end of the stroke, mean of each set", "time since the trigger [s]"
    return chart([Panel(title=title, up=_LABEL, curves=curves)], across=across, height=2.1)


def shudder_figure(loose: Strokes, tight: Strokes, weight_over: float) -> Figure:
    """Draw acceleration and pitch of the boom against its reach, with play and without."""
    states = (("without play", tight, MUTED), ("with play", loose, MEASURED))
    shown: dict[str, Callable[[Strokes], Array]] = {
        "acceleration of the wrist along the boom, mean [m/s²]": lambda s: s.mean,
        "pitch of the boom in its guide [mrad]": lambda s: 1000 * s.pitch.mean(axis=0),
    }
    panels = [
        Panel(
            title=title,
            curves=[curve(s.reach.mean(axis=0), of(s), n, color=c) for n, s, c in states],
            marks=[weight_over],
            look={"xlim": (0.15, 0.50)} | ({"ylim": (-1.0, 1.5)} if k == 0 else {}),
        )
        for k, (title, of) in enumerate(shown.items())
    ]
    return chart(panels, across="reach [m]; dashed: weight over the middle")
