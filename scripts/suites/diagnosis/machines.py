"""Rich cases of the diagnosis suite by number: disturbances, sampled servos, recorders."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property

import numpy as np
from scipy import signal
from scipy.spatial.transform import Rotation

from loose_env.recording import Run
from loose_env.typing import Array
from scripts.suites.gap import dynamics as of
from scripts.suites.gap.arms import GRAVITY, Figures, Link, model_xml
from scripts.suites.gap.dynamics import Factors, at_rest, build, simulate
from scripts.suites.gap.effects import KINDS as EFFECTS
from scripts.suites.gap.effects import Effect, Readings, Spot, apply_effect, log_uniform
from scripts.suites.gap.machine import steps_inside

PRESENT = 0.4
"""Probability of a disturbance in a case, but for those of `OFTEN`."""
OFTEN = {"parameter_errors": 1.0, "clock_offset": 0.33}
STRONG = 0.75
"""Position within its range of a disturbance that is played alone."""
WEAK_IS_HIGH = frozenset({"rate", "cutoff", "mode", "bandwidth", "bits", "speed", "ratio", "limit"})
"""Parameters of which low values disturb most."""
DISTURBANCES: Mapping[str, Mapping[str, tuple[float, float]]] = {
    # sd of masses, centres, inertias, rotors; lengths a fifteenth, damping five times that
    "parameter_errors": {"relative": (0.02, 0.04)},
    "coulomb_friction": {"share": (0.005, 0.03)},  # of peak torque
    "stribeck_friction": {"excess": (0.2, 0.8), "speed": (0.005, 0.05)},  # of Coulomb; rad/s
    "load_friction": {"share": (0.02, 0.1)},  # of drive torque
    "sampled_servo": {"rate": (500.0, 8000.0), "delay": (0.5, 3.49)},  # Hz; samples
    "velocity_filter": {"cutoff": (60.0, 300.0)},  # of the servo [Hz]
    "servo_gains": {"relative": (0.05, 0.25)},  # of gains, or torque constants, at most
    "torque_saturation": {"limit": (0.35, 0.8)},  # over peak torque
    "flexible_joints": {"mode": (40.0, 300.0), "ratio": (0.01, 0.05)},  # Hz; damping ratio
    "flexible_links": {"mode": (40.0, 300.0), "ratio": (0.005, 0.03)},  # of one or two links
    "compliant_base": {"mode": (30.0, 200.0), "ratio": (0.01, 0.05)},  # it slides and rocks
    "cables": {"stiffness": (0.005, 0.05), "damping": (0.001, 0.01)},  # of peak torque per rad, 1/s
    "tool_offset": {"offset": (0.001, 0.005)},  # of the accelerometer [m]
    "accelerometer_rotation": {"angle": (0.5, 2.0)},  # degrees
    "cross_axis": {"share": (0.01, 0.03)},  # of an axis that leaks into another, at most
    "accelerometer_filter": {"bandwidth": (120.0, 1000.0)},  # second order, analogue [Hz]
    "accelerometer_delay": {"delay": (1e-4, 1e-3)},  # s
    "clock_offset": {"offset": (5e-4, 5e-3)},  # of the accelerometer [s]
    "clock_drift": {"drift": (20.0, 300.0)},  # of the accelerometer [ppm]
    "encoder_quantisation": {"bits": (12.0, 20.0)},  # a turn; the servo's own have four more
    "accelerometer_noise": {"density": (20.0, 300.0)},  # µg/√Hz; 20 where absent
    "pose_repeat": {"error": (5e-4, 0.01)},  # rad
    "friction_drift": {"relative": (0.1, 0.4)},  # between sessions, at most
}
"""Disturbances and the ranges of their parameters, log-uniform."""
Sizes = Mapping[str, Mapping[str, float]]
"""Disturbances that are present, and their parameters."""


def drawn_disturbances(rng: np.random.Generator) -> Sizes:
    """Draw each disturbance by its probability."""
    there = {name: rng.random() < OFTEN.get(name, PRESENT) for name in DISTURBANCES}
    values = {
        name: {key: log_uniform(rng, *ends) for key, ends in ranges.items()}
        for name, ranges in DISTURBANCES.items()
    }
    return {name: sizes for name, sizes in values.items() if there[name]}


def alone(name: str, share: float = STRONG) -> Sizes:
    """One disturbance alone, strong by default."""
    return {
        name: {
            key: float(low * (high / low) ** (1 - share if key in WEAK_IS_HIGH else share))
            for key, (low, high) in DISTURBANCES[name].items()
        }
    }


# ------------------------------------------------------------------------------ random arms


def draw_arm(rng: np.random.Generator) -> Figures:
    """Draw an arm of 3 to 7 hinges, its drives still without gains."""
    n = int(rng.integers(3, 8))
    lengths = np.maximum(rng.uniform(0.1, 0.5, n) * min(1.0, 4.5 / n), 0.1)
    masses = np.sort(np.exp(rng.uniform(np.log(0.8), np.log(8.0), n)))[::-1]
    axis = 2 if rng.random() < 0.8 else 1
    links: list[Link] = []
    for i in range(n):
        if i and not (rng.random() < 0.35 and axis):  # not along the joint before
            axis = int(rng.choice([k for k in range(3) if k != axis]))
        along = 2 if i == 0 and axis == 2 else 0
        end = lengths[i] * np.eye(3)[along]
        end[1] += rng.choice([0.0, 0.0, 1.0]) * rng.uniform(-0.1, 0.1)
        radius = rng.uniform(0.03, 0.06)
        inertia = np.full(3, masses[i] * (3 * radius**2 + lengths[i] ** 2) / 12)
        inertia[along] = masses[i] * radius**2 / 2
        com = rng.uniform(0.35, 0.55) * end + rng.uniform(-0.01, 0.01, 3)
        if i == n - 1:  # the accelerometer sits beside the last link's end
            end[1:] += rng.choice([-1, 1], 2) * rng.uniform(0.03, 0.08, 2)
        links.append(
            Link(
                axis=_three(np.eye(3)[axis]), offset=links[-1].end if links else (0.0, 0.0, 0.0),
                end=_three(end), mass=float(masses[i]), com=_three(com), inertia=_three(inertia),
                armature=0.0, damping=0.0, kp=0.0, kv=0.0, limit=1.0, home=0.0, reach=1.3,
            )
        )  # fmt: skip
    bare = build(Figures(name="", links=tuple(links)), Factors.ones(n))
    rests = [at_rest(bare, rng.uniform(-1.5, 1.5, n)) for _ in range(200)]
    felt = np.max([np.diag(mass) for mass, _, _ in rests], axis=0)
    weight = np.max([np.abs(load) for _, load, _ in rests], axis=0)
    armature = np.geomspace(rng.uniform(1.0, 2.0), rng.uniform(0.3, 0.8), n) * felt
    limit = 1.5 * weight + rng.uniform(40.0, 120.0) * (felt + armature)
    damping = rng.uniform(0.005, 0.03, n) * limit
    return _with(Figures(name="random", links=tuple(links)), armature=armature, limit=limit,
                 damping=damping)  # fmt: skip


def _three(values: Array) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


def _with(figures: Figures, **columns: Array) -> Figures:
    """An arm with other numbers of its links, a value for each."""
    links = [
        dataclasses.replace(link, **{n: float(values[i]) for n, values in columns.items()})  # type: ignore[arg-type]
        for i, link in enumerate(figures.links)
    ]
    return dataclasses.replace(figures, links=tuple(links))


def with_gains(figures: Figures, hertz: Array, ratio: Array) -> Figures:
    """Servo gains by the frequency [Hz] and damping ratio of each joint alone (n,)."""
    system = build(figures, Factors.ones(figures.joints))
    inertia, omega = np.diag(at_rest(system, np.full(figures.joints, 0.7))[0]), 2 * np.pi * hertz
    damping = np.array([link.damping for link in figures.links])
    kv = np.maximum(2 * ratio * inertia * omega - damping, 0.1 * inertia * omega)
    return _with(figures, kp=inertia * omega**2, kv=kv)


def altered(figures: Figures, relative: float, rng: np.random.Generator) -> Figures:
    """The arm as built, its parameters off by a relative standard deviation."""

    def off(size: float) -> float:
        return float(np.exp(size * np.clip(rng.normal(), -2.5, 2.5)))

    links: list[Link] = []
    for link in figures.links:
        mass, turns = off(relative), off(relative)
        links.append(
            dataclasses.replace(
                link, mass=link.mass * mass, com=_three(np.array(link.com) * off(relative)),
                inertia=_three(np.array(link.inertia) * turns),
                end=_three(np.array(link.end) * off(relative / 15)),
                offset=links[-1].end if links else link.offset,
                armature=link.armature * off(relative), damping=link.damping * off(5 * relative),
            )
        )  # fmt: skip
    return dataclasses.replace(figures, links=tuple(links))


# ------------------------------------------------------------------------------ true machine

STEPS = 16
"""Integration steps in a millisecond, at least; servo rates divide them."""
MOST_TURNED = 0.1
"""Departure of a joint from its pose above which a run is unstable [rad]."""
MOST_CHATTER = 0.05
"""Rms torque of a servo at rest over the limit, above which its loop is unstable."""
SETTLE, RISE, AFTER = 0.4, 0.15, 0.02
"""Time at rest, of the rising noise before the record begins, and after its end [s]."""


class Unstable(Exception):
    """The servo loop does not hold the pose."""


class Machine:
    """The arm as it is, with or without its fault; the same seed gives the same machine."""

    def __init__(
        self,
        nominal: Figures,
        sizes: Sizes,
        fault: Effect | None,
        *,
        servoed: bool,
        seed: list[int],
    ) -> None:
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        n = nominal.joints
        self.nominal, self.sizes = nominal, sizes
        true = altered(nominal, self.size("parameter_errors", "relative"), rng)
        off = rng.normal(size=3)
        spread = rng.uniform(0.7, 1.3, (9, n))
        bent = [int(i) for i in rng.permutation(n)]
        gains = 1 + self.size("servo_gains", "relative") * rng.uniform(-1, 1, (3, n))
        rest = rng.uniform(-1, 1, n)
        system = self.system = build(true, Factors.ones(n))
        system.tool += self.size("tool_offset", "offset") * off / np.linalg.norm(off)
        limit = np.array([link.limit for link in nominal.links])
        axes = [np.array(link.axis) for link in nominal.links]
        if "flexible_joints" in sizes:
            for i in range(n):
                dof = of.free_link(system, i, "hinge", axes[i])
                self._spring("flexible_joints", dof, spread[0, i])
                system.bodies[dof, of.ARMATURE] = 0.05 * true.links[i].armature  # of the gear
        if fault is not None:
            apply_effect(fault, system, Readings(), nominal)
        if "flexible_links" in sizes:
            most = 1 + int(spread[1, 0] > 1.0)
            for i in bent:
                point = 0.3 * np.array(true.links[i].end)
                across = np.cross(point, [0.3, 0.5, 0.7])
                try:
                    dof = of.split_link(system, i, point, across / np.linalg.norm(across), 0.3)
                except ValueError:  # its mass lies too near its end for a bar of two parts
                    continue
                self._spring("flexible_links", dof, spread[2, i])
                if (most := most - 1) == 0:
                    break
        if "compliant_base" in sizes:
            for kind, axis in (("hinge", 1), ("hinge", 0), ("slide", 1), ("slide", 0)):
                of.free_base(system, np.eye(3)[axis], kind)
            system.bodies[3, of.MASS] = 5.0
            for k in range(4):
                self._spring("compliant_base", k, spread[3, k % n])
        laws = system.laws[system.joint_dofs]
        if "cables" in sizes:
            laws[:, of.STIFFNESS] = self.size("cables", "stiffness") * limit * spread[4]
            laws[:, of.REST] = rest
            laws[:, of.DAMPING] += self.size("cables", "damping") * limit * spread[5]
        coulomb = self.size("coulomb_friction", "share")
        excess = self.size("stribeck_friction", "excess")
        laws[:, of.FRICTION] = max(coulomb, 0.005 * (excess > 0)) * limit * spread[6]
        laws[:, of.BUMP], laws[:, of.SMOOTH_SPEED] = excess, 2e-3
        laws[:, of.STRIBECK_SPEED] = self.size("stribeck_friction", "speed", 1.0)
        system.laws[system.joint_dofs] = laws
        drives = system.drives
        drives[:, of.LOADED] = self.size("load_friction", "share")
        drives[:, of.LOADED_SPEED], drives[:, of.LOADED_SMOOTH] = 1.0, 2e-3
        drives[:, of.LIMIT] = limit * self.size("torque_saturation", "limit", 1.0)
        if servoed:
            drives[:, of.KP] *= gains[0]
            drives[:, of.KV] *= gains[1]
        else:
            drives[:, of.GAIN] = 1 + (gains[2] - 1) / 2
        self.inside = steps_inside(system, nominal, STEPS)

    def size(self, name: str, parameter: str, absent: float = 0.0) -> float:
        """Value of a parameter, or ``absent`` where the disturbance is not there."""
        return self.sizes[name][parameter] if name in self.sizes else absent

    def _spring(self, name: str, dof: int, factor: float) -> None:
        """Give an extra joint stiffness and damping by its mode."""
        inertia = at_rest(self.system, np.full(self.nominal.joints, 0.7))[0][dof, dof]
        omega = 2 * np.pi * self.size(name, "mode") * factor
        law = self.system.laws[dof]
        law[of.STIFFNESS] = inertia * omega**2
        law[of.DAMPING] = 2 * self.size(name, "ratio") * inertia * omega

    @cached_property
    def servo(self) -> tuple[int, int, float, float]:
        """Steps between samples, samples of delay, smoothing and encoder step of the servos."""
        per_second = 1000 * self.inside
        rate = (
            1000
            * STEPS
            / 2 ** round(np.log2(1000 * STEPS / self.size("sampled_servo", "rate", 8000)))
        )
        bits = self.size("encoder_quantisation", "bits")
        cutoff = self.size("velocity_filter", "cutoff", 400.0 if bits else np.inf)
        every = round(per_second / rate)
        smoothing = float(1 - np.exp(-2 * np.pi * cutoff / rate))
        resolution = 2 * np.pi / 2 ** (round(bits) + 4) if bits else 0.0
        return every, round(self.size("sampled_servo", "delay")), smoothing, resolution

    def play(self, commands: Array, pose: Array, friction: float) -> of.Signals:
        """Motion at every step under commands a millisecond apart, the first ones at rest."""
        system = self.system.copy()
        own = system.joint_dofs
        system.laws[own, of.FRICTION] *= friction
        system.laws[own, of.DAMPING] *= friction
        load, stiffness = at_rest(system, pose)[1], system.laws[:, of.STIFFNESS]
        q = -load / np.where(stiffness > 0, stiffness, np.inf)  # springs bent by the weight
        q[own] = pose
        found = simulate(
            system, commands, inside=self.inside, settle=0.0, fine=True, straight=True,
            start=(q, np.zeros_like(q)), servo=self.servo,
        )  # fmt: skip
        turned = np.abs(found.position - pose).max()
        if not turned < MOST_TURNED:
            raise Unstable(f"a joint left its pose by {turned:.3g} rad")
        settled = round(SETTLE * 1000 * self.inside)
        limit = [link.limit for link in self.nominal.links]
        chatter = (found.torque[settled // 2 : settled].std(axis=0) / limit).max()
        if chatter > MOST_CHATTER:
            raise Unstable(f"a servo at rest asks for {chatter:.0%} of its limit")
        return found


class Recorder:
    """Recorder and sensors of a machine."""

    def __init__(self, rate: float, machine: Machine, *, speeds: bool, seed: list[int]) -> None:
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        self.rate, self.speeds, self.machine = rate, speeds, machine
        size, axis = machine.size, rng.normal(size=3)
        angle = np.radians(size("accelerometer_rotation", "angle"))
        turned = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        leaks = size("cross_axis", "share") * rng.uniform(-1, 1, (3, 3)) * (1 - np.eye(3))
        self.mixing: Array = (np.eye(3) + leaks) @ turned
        late = float(rng.choice([-1, 1])) * size("clock_offset", "offset")
        self.late = late + size("accelerometer_delay", "delay")
        self.drift = float(rng.choice([-1, 1])) * size("clock_drift", "drift") * 1e-6
        self.bits = round(size("encoder_quantisation", "bits"))

    def sensors(
        self, played: of.Signals, seconds: float, rng: np.random.Generator
    ) -> tuple[Array, Array, dict[str, Array]]:
        """Times from the begin of the record and of the play, and readings."""
        per_second, size = 1000.0 * self.machine.inside, self.machine.size
        time = np.arange(round(seconds * self.rate), dtype=float) / self.rate
        steps = np.arange(len(played.position)) / per_second
        analogue = played.acceleration
        if bandwidth := size("accelerometer_filter", "bandwidth"):
            sos = signal.butter(2, bandwidth, fs=per_second, output="sos")
            begin = signal.sosfilt_zi(sos)[:, :, None] * analogue[0]
            analogue = signal.sosfilt(sos, analogue, axis=0, zi=begin)[0]
        if 0.4 * self.rate < 0.45 * per_second:  # decimation of linear phase
            sos = signal.butter(4, 0.4 * self.rate, fs=per_second, output="sos")
            analogue = signal.sosfiltfilt(sos, analogue, axis=0)
        asked = SETTLE + RISE + time * (1 + self.drift) - self.late
        reading = np.stack([np.interp(asked, steps, column) for column in analogue.T], axis=1)
        density = size("accelerometer_noise", "density", 20.0) * 1e-6 * GRAVITY
        noise = density * np.sqrt(self.rate / 2) * rng.normal(size=reading.shape)
        now = np.minimum(np.round((SETTLE + RISE + time) * per_second).astype(int), len(steps) - 1)
        angles, speeds = played.position, self._speeds(played.position)
        if self.bits:
            step = 2 * np.pi / 2**self.bits
            angles = np.round(angles / step) * step
        found: dict[str, Array] = {"tool_acc": reading @ self.mixing.T + noise}
        for j in range(angles.shape[1]):
            found[f"joint{j + 1}_pos"] = angles[now, j]
            if self.speeds:
                found[f"joint{j + 1}_vel"] = speeds[now, j]
        return time, now / per_second, found

    def _speeds(self, position: Array) -> Array:
        """The servo's estimate of speed, held from sample to sample."""
        every, _, smoothing, resolution = self.machine.servo
        seen = position[::every]
        if resolution:
            seen = np.round(seen / resolution) * resolution
        speed = np.diff(seen, axis=0, prepend=seen[:1]) * (1000 * self.machine.inside / every)
        filtered = signal.lfilter([smoothing], [1, smoothing - 1], speed, axis=0)
        return np.repeat(filtered, every, axis=0)[: len(position)]


# ------------------------------------------------------------------------------------ cases

SHARES = (0.08, 0.3)
"""Rms torque of the excitation over the limit, log-uniform."""
MOST_TOOL = 15.0
"""Rms acceleration of the tool that a plan would ask for at most [m/s²]."""
CHOSEN, CANDIDATES = 0.6, 30
"""Probability of a pose chosen among random ones, and their number: a plan chooses poses in which
gravity leaves seats open. Healthy cases have the poses of a fault that is not there."""
PEAK, CREST = 0.9, 3.5
"""Peak torque over the limit, and over its rms, that a plan would allow."""
GAPS = {"structural_looseness": (3e-5, 4e-4), "backlash": (3e-4, 3e-3)}
"""Free travel [m, rad], log-uniform."""
FIRST_LINK = 0.3
"""Probability of the first link over that of another: the whole arm's weight keeps it shut."""
ATTEMPTS = 8
"""Draws of gains and level before a machine counts as impossible."""
POSES = 3
"""Poses among the runs."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """A run to play."""

    pose: Array
    """Pose [rad] (n,)."""
    joint: int
    """Joint that is shaken."""
    shaken: Array
    """Shaking of its command, a millisecond apart [rad] (T,)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RichCase:
    """A case, drawn but not played."""

    number: int
    seed: int
    figures: Figures
    fault: Effect | None
    sizes: Sizes
    servoed: bool
    """True for position servos, False for torque motors with an outer controller."""
    reference: bool
    """True if the recording has healthy runs."""
    rate: float
    """Sampling rate of the recorder [Hz]."""
    speeds: bool
    """True if joint speeds are recorded."""
    plans: tuple[Plan, ...]
    seconds: float
    """Length of a run [s]."""

    @property
    def model_xml(self) -> str:
        """The user's model."""
        return model_xml(self.figures, drives="position" if self.servoed else "motor")

    @property
    def facts(self) -> dict[str, object]:
        """What the tables part cases by."""
        sizes = {name: dict(own) for name, own in self.sizes.items()}
        return {"joints": self.figures.joints, "servoed": self.servoed, "rate": self.rate,
                "disturbances": sizes}  # fmt: skip

    def played(self) -> tuple[list[Run], list[float]]:
        """Runs, and the change of the tool's motion by the fault in each suspect one.

        Loops that do not hold their pose are played with softer servos.
        """
        case = self
        for attempt in range(1, ATTEMPTS):
            try:
                return case._played()
            except Unstable:
                case = draw_rich(
                    self.number, self.seed, runs=len(self.plans), seconds=self.seconds,
                    sizes=self.sizes, healthy=self.fault is None, attempt=attempt,
                )  # fmt: skip
        return case._played()

    def _played(self) -> tuple[list[Run], list[float]]:
        seed = [self.seed, self.number]
        loose, sound = (
            Machine(self.figures, self.sizes, fault, servoed=self.servoed, seed=[*seed, 1])
            for fault in (self.fault, None)
        )
        recorder = {m: Recorder(self.rate, m, speeds=self.speeds, seed=[*seed, 2])
                    for m in (loose, sound)}  # fmt: skip
        runs: tuple[list[Run], list[Run]] = ([], [])
        change = []
        for i, plan in enumerate(self.plans):
            for session in range(0 if self.reference else 1, 2):
                rng, drift = (
                    np.random.default_rng(np.random.SeedSequence([*seed, *purpose]))
                    for purpose in ((3, session, i), (4, session))
                )
                machine = loose if session else sound
                relative = machine.size("friction_drift", "relative")
                friction = 1 + relative * (drift.uniform(-1, 1) + 0.3 * rng.uniform(-1, 1))
                error = machine.size("pose_repeat", "error")
                pose = plan.pose + error * rng.uniform(-1, 1, self.figures.joints)
                commands = self._commands(plan, pose)
                found = machine.play(commands, pose, friction)
                time, now, sensors = recorder[machine].sensors(found, self.seconds, rng)
                at = np.arange(len(commands)) * 1e-3
                steps = np.round(now * 1000 * machine.inside).astype(int)
                controls = {
                    f"motor{j + 1}": np.interp(now, at, commands[:, j])
                    if self.servoed
                    else found.torque[steps, j]
                    for j in range(self.figures.joints)
                }
                word = "run" if session else "healthy"
                runs[session].append(
                    Run(
                        name=f"{word}-{i + 1:02d}", time=time, controls=controls, sensors=sensors,
                        excited=(f"joint{plan.joint + 1}",),
                        pose={f"joint{j + 1}": float(q) for j, q in enumerate(plan.pose)},
                        condition="suspect" if session else "healthy",
                    )
                )  # fmt: skip
                if session and self.fault is not None:
                    without = sound.play(commands, pose, friction)
                    a, b = _shaken(found, loose), _shaken(without, sound)
                    change.append(float(np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2))))
        return [*runs[0], *runs[1]], change

    def _commands(self, plan: Plan, pose: Array) -> Array:
        """Commands that hold the weight of the model's arm in a pose, and shake a joint."""
        nominal = build(self.figures, Factors.ones(self.figures.joints))
        hold = pose + at_rest(nominal, pose)[1] / nominal.drives[:, of.KP]
        commands = np.tile(hold, (len(plan.shaken), 1))
        commands[:, plan.joint] += plan.shaken
        return commands


def _shaken(played: of.Signals, machine: Machine) -> Array:
    """Recorded motion of the tool a millisecond apart, its mean removed, below 200 Hz."""
    sos = signal.butter(4, 200.0, fs=1000 * machine.inside, output="sos")
    kept = signal.sosfiltfilt(sos, played.acceleration, axis=0)[:: machine.inside]
    kept = kept[round(1000 * (SETTLE + RISE)) :]
    return np.asarray(kept - kept.mean(axis=0))


def draw_rich(
    number: int, seed: int, *, runs: int = 6, seconds: float = 1.2, sizes: Sizes | None = None,
    healthy: bool | None = None, attempt: int = 0,
) -> RichCase:  # fmt: skip
    """Draw a case by its number; every second one is healthy, every other pair has references."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, number, 0]))
    figures = draw_arm(rng)
    n, servoed = figures.joints, bool(rng.random() < 0.7)
    drawn = drawn_disturbances(rng)
    sizes = drawn if sizes is None else sizes
    fault = _draw_fault(figures, rng)
    rate = float(np.round(np.exp(rng.uniform(np.log(400), np.log(10_000))), -2))
    speeds = bool(rng.random() < 0.6)
    hertz, ratio = rng.uniform(8.0, 25.0, n), rng.uniform(0.4, 1.0, n)
    if not servoed:
        hertz = rng.uniform(1.5, 4.0, n)
    hertz = np.minimum(hertz, _fastest(sizes)) * 0.7**attempt
    figures = with_gains(figures, hertz, ratio)
    sound = number % 2 == 0 if healthy is None else healthy
    return RichCase(
        number=number, seed=seed, figures=figures, fault=None if sound else fault, sizes=sizes,
        servoed=servoed, reference=bool((number // 2) % 2), rate=rate, speeds=speeds,
        plans=_draw_plans(figures, fault, sizes, rate, runs, seconds, rng, 0.7**attempt),
        seconds=seconds,
    )  # fmt: skip


def _draw_fault(figures: Figures, rng: np.random.Generator) -> Effect:
    """A link that slides in its seat, or play of a joint."""
    kind = "structural_looseness" if rng.random() < 2 / 3 else "backlash"
    weights = np.ones(figures.joints)
    weights[0] = FIRST_LINK
    index = int(rng.choice(figures.joints, p=weights / weights.sum()))
    place = next(p for p in EFFECTS[kind].places(figures) if p.index == index)
    gap = log_uniform(rng, *GAPS[kind])
    parameters = EFFECTS[kind].make(gap, Spot(figures, place, rng))
    return Effect(kind=kind, place=place, parameters=parameters)


def _fastest(sizes: Sizes) -> float:
    """Frequency of the servos that the delay of their loop allows [Hz]."""
    sampled = sizes.get("sampled_servo", {"rate": 8000.0, "delay": 0.0})
    bits = 400.0 if "encoder_quantisation" in sizes else 1e6
    cutoff = sizes.get("velocity_filter", {"cutoff": bits})["cutoff"]
    return float(0.05 / ((1 + sampled["delay"]) / sampled["rate"] + 1 / (2 * np.pi * cutoff)))


def _draw_plans(
    figures: Figures, fault: Effect, sizes: Sizes, rate: float, runs: int, seconds: float,
    rng: np.random.Generator, quiet: float,
) -> tuple[Plan, ...]:  # fmt: skip
    """Draw poses, joints, noise and level of the runs of a case."""
    n, system = figures.joints, build(figures, Factors.ones(figures.joints))
    servo = sizes.get("sampled_servo", {"rate": 8000.0})["rate"]
    band = (float(rng.uniform(6.0, 12.0)), min(rng.uniform(60.0, 90.0), 0.35 * rate, 0.2 * servo))
    share = log_uniform(rng, *SHARES)
    joints = rng.permutation(n)[: max(1, runs // POSES)]
    time = np.arange(round(1000 * (SETTLE + RISE + seconds + AFTER))) * 1e-3

    def load(pose: Array) -> float:
        """Weight that keeps the fault shut; only its order counts."""
        _, weight, work = at_rest(system, pose)
        if fault.kind == "backlash":
            return float(abs(weight[fault.place.index]))
        return float(abs(work[fault.place.index, 6:9] @ fault.parameters["direction"]))

    plans: list[Plan] = []
    pose = np.zeros(n)
    for i in range(runs):
        if i % len(joints) == 0:
            tried = CANDIDATES if rng.random() < CHOSEN else 1
            pose = min(rng.uniform(-1.3, 1.3, (tried, n)), key=load)
        joint = int(joints[i % len(joints)])
        link, (mass, weight, work) = figures.links[joint], at_rest(system, pose)
        moved = np.zeros((3, n))
        for k in range(3):
            of.add_tool_force(work, system.tool, np.eye(3)[k], moved[k])
        per_torque = float(np.linalg.norm(moved[:, joint]) / mass[joint, joint])
        torque = min(share * link.limit, MOST_TOOL / max(per_torque, 1e-9))
        spare = PEAK * link.limit - abs(weight[joint])
        torque = quiet * max(min(torque, spare / CREST), 0.02 * link.limit)
        spectrum = np.fft.rfft(rng.normal(size=2 * len(time)))
        frequency = np.fft.rfftfreq(2 * len(time), 1e-3)
        spectrum[(frequency < band[0]) | (frequency > band[1])] = 0
        noise = np.fft.irfft(spectrum)[: len(time)]
        swell = np.clip((time - SETTLE) / (0.7 * RISE), 0, 1)
        shaken = torque / link.kp * swell * noise / noise.std()
        plans.append(Plan(pose=pose, joint=joint, shaken=shaken))
    return tuple(plans)
