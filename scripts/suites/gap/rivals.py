"""Rival methods of `loose gap` on a recording: stepwise regression by BIC, and `mujoco.sysid`."""

from __future__ import annotations

import contextlib
import copy
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy import linalg, optimize, signal, stats

from loose_env.errors import InvalidData
from loose_env.gap import Gap, GapResult, NamedEffect, read_result
from loose_env.recording import Recording, Run, read_recording
from loose_env.typing import Array

NO_GAP = 1.25
"""Held-out residual up to which nothing is missing [noise sd]: filtering and interpolation leave up
to a quarter beside the noise."""
EXPLAINED = 0.5
"""Least share of the held-out mean square above the noise that effects have to explain: less than
half says that the main cause is another one."""
CONFIDENCE = 0.95
"""Of intervals."""
SEED = 0
"""Seed of the noise replica by which the noise of the residual is measured."""


def write_finding(
    folder: Path, method: str, residuals: tuple[float, float], held_out: str,
    effects: Sequence[NamedEffect], tolerance: float,
) -> GapResult:  # fmt: skip
    """Write what was found as ``result.json``, with the held-out residuals before and after."""
    before, after = residuals
    explained = (before**2 - after**2) / max(before**2 - 1.0, 1e-9)
    named = bool(effects) and explained >= EXPLAINED
    verdict = "named" if named else "unexplained" if before > NO_GAP else "no_gap"
    result = GapResult(
        verdict=verdict,  # type: ignore[arg-type]
        gap=Gap(before=before, after=after),
        effects=tuple(effects) if named else (),
        doubtful=() if named else tuple(effects),
        held_out_runs=(held_out,),
        model=None,
        settings={"method": method, "tolerance": tolerance, "seed": SEED},
    )
    return read_result(result.write(folder / "result.json"))


# ------------------------------------------------------------------- joint motions and torques

SIGNAL_OVER_FLOOR = 10.0
"""Power density of a velocity over its noise floor down to which it counts as motion."""
FLOOR_ABOVE = 350.0
"""Frequency above which a velocity is noise alone [Hz]; 0.35 of the rate if that is lower."""
CUTOFFS = (15.0, 100.0)
"""Least and largest cut-off frequency [Hz]: friction at reversals needs a few harmonics of the
motion; higher up differentiated noise hides the inertial torque."""
ORDER = 4
"""Order of the Butterworth filter, which is run forwards and backwards."""
RATE_OVER_CUTOFF = 2.5
"""Rate of the decimated samples over the cut-off: just above Nyquist, so that the noise of
neighbouring samples is nearly independent."""
MARGIN = 0.15
"""Time cut off at both ends of a run, where the filter has no past or future [s]."""


@dataclass(frozen=True, kw_only=True)
class LowPass:
    """One low-pass and decimation for all signals of a recording."""

    rate: float
    """Rate of the samples [Hz]."""
    cutoff: float
    """Cut-off frequency [Hz]."""

    @property
    def stride(self) -> int:
        """Samples from one decimated sample to the next."""
        return max(1, int(self.rate / (RATE_OVER_CUTOFF * self.cutoff)))

    def smooth(self, values: Array) -> Array:
        """Low-passed values at the full rate, along the first axis."""
        if self.cutoff >= 0.45 * self.rate:
            return values
        sos = signal.butter(ORDER, self.cutoff, fs=self.rate, output="sos")
        return np.asarray(signal.sosfiltfilt(sos, values, axis=0))

    def rows(self, samples: int) -> slice:
        """Rows of a run of so many samples that are kept."""
        margin = min(round(MARGIN * self.rate), samples // 4)
        return slice(margin, samples - margin, self.stride)

    def reduced(self, values: Array) -> Array:
        """Low-passed and decimated values."""
        return self.smooth(values)[self.rows(len(values))]

    def derivative(self, values: Array) -> Array:
        """Derivative by time at the full rate, by central differences of the sixth order."""
        out = np.gradient(values, axis=0)
        ahead = [values[3 + k : len(values) - 3 + k] for k in (1, 2, 3)]
        behind = [values[3 - k : len(values) - 3 - k] for k in (1, 2, 3)]
        weights = (0.75, -0.15, 1.0 / 60.0)
        out[3:-3] = sum(w * (a - b) for w, a, b in zip(weights, ahead, behind, strict=True))
        return out * self.rate


class Actuator(NamedTuple):
    """An actuator that acts on a single joint: force = gain u + bias."""

    name: str
    dof: int
    gear: float
    gain: float
    bias: Array
    """Constant, force over length and over velocity."""
    limits: tuple[float, float]


def actuators_of(model: mujoco.MjModel) -> list[Actuator]:
    """Actuators of a model."""
    if (model.actuator_trntype != int(mujoco.mjtTrn.mjTRN_JOINT)).any() or model.na:
        raise InvalidData("only actuators at joints without a state of their own are read")
    return [
        Actuator(
            name=model.actuator(i).name,
            dof=int(model.jnt_dofadr[model.actuator_trnid[i, 0]]),
            gear=model.actuator_gear[i, 0],
            gain=model.actuator_gainprm[i, 0],
            bias=model.actuator_biasprm[i, :3].copy(),
            limits=tuple(model.actuator_forcerange[i])
            if model.actuator_forcelimited[i]
            else (-np.inf, np.inf),
        )
        for i in range(model.nu)
    ]


@dataclass(frozen=True, kw_only=True)
class JointRun:
    """One run at the full rate; joints in the model's order, torques at the joints, (T, n)."""

    name: str
    position: Array
    """As read [rad or m]."""
    velocity: Array
    """As read [rad/s or m/s]."""
    command: Array | None
    """Commands of the actuators, of shape (T, m); None for a run without."""
    measured: Array | None
    """Measured torque [N m or N]; None for a run with commands or without torques."""
    low_pass: LowPass = LowPass(rate=1.0, cutoff=1.0)
    proportional: Array | float = 0.0
    """Torque of the actuators from command and position [N m or N]."""
    derivative: Array | float = 0.0
    """Torque of the actuators from velocity."""
    command_slope: Array | float = 0.0
    """Derivative of `proportional` by the time of the command [N m/s]."""
    derivative_gain: Array | float = 0.0
    """Torque over velocity of `derivative`, zero where a drive is saturated."""

    @property
    def torque(self) -> Array:
        """Torque at the joints."""
        return self.proportional + self.derivative if self.measured is None else self.measured  # type: ignore[return-value]

    def motion(self) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration, low-passed and decimated, each of shape (t, n)."""
        keep = self.low_pass.rows(len(self.position))
        speed = self.low_pass.smooth(self.velocity)
        acceleration = self.low_pass.derivative(speed)
        return self.low_pass.smooth(self.position)[keep], speed[keep], acceleration[keep]


def joint_runs(recording: Recording, replica: np.random.Generator | None = None) -> list[JointRun]:
    """Runs of a recording as joint motions and torques.

    With a generator as much sensor noise is added once more, through the same filter.
    """
    actuators = actuators_of(recording.model())
    raw = [_raw(recording, run, actuators) for run in recording.runs]
    rate = 1.0 / float(np.median(np.diff(recording.runs[0].time)))
    low_pass = LowPass(rate=rate, cutoff=_cutoff(raw, rate))
    if replica is not None:
        raw = [_noisier(run, replica) for run in raw]
    return [_with_torques(replace(run, low_pass=low_pass), actuators) for run in raw]


def _raw(recording: Recording, run: Run, actuators: Sequence[Actuator]) -> JointRun:
    sensors, zero = recording.joint_sensors(), np.zeros(run.samples)
    rate = 1.0 / float(np.median(np.diff(run.time)))
    positions, velocities = [], []
    for joint, own in sensors.items():
        if not own.position or own.position[0] not in run.sensors:
            raise InvalidData(f"{run.name}: joint {joint!r} has no position sensor")
        positions.append(_whole(run.sensors[own.position[0]]))
        if own.velocity and own.velocity[0] in run.sensors:
            velocities.append(_whole(run.sensors[own.velocity[0]]))
        else:
            velocities.append(np.gradient(positions[-1], 1.0 / rate))
    command = measured = None
    if run.comparison == "forward":
        columns = [_whole(run.controls.get(each.name, zero)) for each in actuators]
        command = np.stack(columns, axis=1)
    elif run.comparison == "inverse":
        measured = np.stack([_whole(run.torques.get(joint, zero)) for joint in sensors], axis=1)
    return JointRun(
        name=run.name,
        position=np.stack(positions, axis=1),
        velocity=np.stack(velocities, axis=1),
        command=command,
        measured=measured,
    )


def _whole(values: Array) -> Array:
    """Values with missing samples interpolated."""
    good = np.isfinite(values)
    if good.all():
        return values
    if not good.any():
        raise InvalidData("a column holds no numbers")
    at = np.arange(len(values))
    return np.interp(at, at[good], values[good])


def _noisier(run: JointRun, rng: np.random.Generator) -> JointRun:
    def noisy(values: Array) -> Array:
        # white noise of smooth signals, by fifth differences: their squared binomials sum to 252
        differences = np.diff(values, 5, axis=0) / np.sqrt(252.0)
        noise = 1.4826 * np.median(np.abs(differences), axis=0)
        return np.asarray(values + noise * rng.normal(size=values.shape))

    position, velocity = noisy(run.position), noisy(run.velocity)
    measured = None if run.measured is None else noisy(run.measured)
    return replace(run, position=position, velocity=velocity, measured=measured)


def _with_torques(run: JointRun, actuators: Sequence[Actuator]) -> JointRun:
    p_torque, d_torque, slope, damping = (np.zeros_like(run.position) for _ in range(4))
    if run.command is not None:
        # mean around each sample of a command that is held from sample to sample
        wide = np.vstack((run.command[:1], run.command[:1], run.command, run.command[-1:]))
        held = (13.0 * (wide[2:-1] + wide[1:-2]) - (wide[3:] + wide[:-3])) / 24.0
        rate = run.low_pass.derivative(run.low_pass.smooth(held))
        for i, (_, dof, gear, gain, bias, (low, high)) in enumerate(actuators):
            p = gain * held[:, i] + bias[0] + bias[1] * gear * run.position[:, dof]
            d = bias[2] * gear * run.velocity[:, dof]
            free = (p + d > low) & (p + d < high)
            # a saturated drive gives its limit, whatever its gains are
            p_torque[:, dof] += gear * np.where(free, p, np.clip(p + d, low, high))
            d_torque[:, dof] += gear * np.where(free, d, 0.0)
            damping[:, dof] += np.where(free, bias[2] * gear * gear, 0.0)
            slope[:, dof] += gear * np.where(free, gain * rate[:, i], 0.0)
    return replace(
        run, proportional=p_torque, derivative=d_torque, command_slope=slope,
        derivative_gain=damping,
    )  # fmt: skip


def _cutoff(raw: Sequence[JointRun], rate: float) -> float:
    """Highest frequency at which some joint moves clearly above its noise [Hz]."""
    highest = CUTOFFS[0]
    for run in raw:
        length = min(1024, len(run.velocity))
        frequency, power = signal.welch(run.velocity, rate, nperseg=length, axis=0)
        floor = np.median(power[frequency > min(FLOOR_ABOVE, 0.35 * rate)], axis=0)
        moving = (power > SIGNAL_OVER_FLOOR * floor).any(axis=1)
        if moving.any():
            highest = max(highest, float(frequency[moving].max()))
    return min(highest, CUTOFFS[1], 0.4 * rate)


# ------------------------------------------------------------------------- regressor

_ANGLE = 1e-4
"""Step of angles [rad]: its square is far below the noise, its rounding error too."""
_LENGTH = 1e-3
"""Step of centres of mass [m]; torques are quadratic in them, with a small square."""
STRIBECK_SPEEDS = (0.03, 0.07, 0.15, 0.3)
"""Stribeck speeds that are tried [rad/s]."""
RIPPLE_ORDERS = range(4, 29)
"""Periods of torque ripple in a turn that are tried."""
SMOOTH_SPEED = 2e-3
"""Speed within which friction turns round [rad/s]: that of a tachometer's noise."""
SLIDE_METRES = 0.2
"""Metres of a slide that count like a radian of a hinge."""
CLOCK_SAMPLES = 0.25
"""Samples up to which a delay is the clock of the recording."""
LARGEST_ANGLE, LARGEST_SHIFT = 0.3, 0.5
"""Largest angle for which a torque is linear in it [rad], largest shift of a centre of mass [m]."""

Read = Callable[[Array], dict[str, float]]
"""Parameters of an effect from its coefficients."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """Columns of one effect at one location."""

    kind: str
    where: str
    columns: Array
    """Of one run, of shape (t, n, width)."""
    read: Read
    """Parameters of the effect from its coefficients."""
    grid: bool = False
    """Whether it is one value of a grid."""
    positive: bool = False
    """Whether the first coefficient cannot be negative: friction brakes, rotors add inertia."""
    nominal: float = 0.0
    """Nominal value in the unit of the first coefficient: within the tolerance of it an effect
    does not count."""
    least: float = 0.0
    """Value of the first coefficient beyond that up to which an effect does not count."""
    largest: float = np.inf
    """Largest coefficient for which the columns, which are derivatives, hold."""

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.columns.shape[-1])

    def possible(self, values: Array) -> bool:
        """Whether coefficients have the right sign and a size for which the columns hold."""
        right_sign = not self.positive or values[0] > 0.0
        return bool(right_sign and np.all(np.abs(values) <= self.largest))


class Dynamics:
    """Inverse dynamics of a nominal model along a motion; torques of shape (t, n)."""

    def __init__(self, model: mujoco.MjModel, motion: tuple[Array, Array, Array]) -> None:
        self.model, self.motion = model, motion
        self.base = self.torque()

    def torque(
        self,
        edit: Callable[[mujoco.MjModel], None] | None = None,
        motion: tuple[Array, Array, Array] | None = None,
    ) -> Array:
        """Torque for a motion, of the model or of an edited copy of it."""
        model, motion = copy.copy(self.model), motion or self.motion
        if edit is not None:
            edit(model)
        data = mujoco.MjData(model)
        out = np.empty_like(motion[0])
        for k, (q, v, a) in enumerate(zip(*motion, strict=True)):
            data.qpos, data.qvel, data.qacc = q, v, a
            mujoco.mj_inverse(model, data)
            out[k] = data.qfrc_inverse
        return out

    def slope(self, edit: Callable[[mujoco.MjModel], None], step: float = 1.0) -> Array:
        """Change of the torque by an edit, over its step."""
        return (self.torque(edit) - self.base) / step

    def by_position(self, joint: int) -> Array:
        """Derivative by the position of a joint."""
        q, v, a = self.motion
        moved = q.copy()
        moved[:, joint] += _ANGLE
        return (self.torque(motion=(moved, v, a)) - self.base) / _ANGLE

    def weight(self, body: int) -> Array:
        """Torque that carries the weight of a body at rest."""
        still = np.zeros_like(self.motion[0])
        motion = (self.motion[0], still, still)
        return self.torque(_heavier(body), motion) - self.torque(motion=motion)

    def point_mass(self, body: int, place: Array) -> Array:
        """Torque of a kilogram at a place of a body, and by its first moment: (t, n, 4)."""

        def loaded(shift: Array) -> Array:
            return self.slope(lambda model: _add_point(model, body, place + shift))

        at = loaded(np.zeros(3))
        moves = [(loaded(_LENGTH * axis) - at) / _LENGTH for axis in np.eye(3)]
        return np.stack([at, *moves], axis=-1)


def _heavier(body: int, *, mass: bool = True) -> Callable[[mujoco.MjModel], None]:
    """Twice the inertia of a body, and twice its mass."""

    def edit(model: mujoco.MjModel) -> None:
        model.body_mass[body] *= 2.0 if mass else 1.0
        model.body_inertia[body] *= 2.0

    return edit


def _shifted(body: int, axis: int) -> Callable[[mujoco.MjModel], None]:
    def edit(model: mujoco.MjModel) -> None:
        model.body_ipos[body, axis] += _LENGTH

    return edit


def _leaning(axis: Array) -> Callable[[mujoco.MjModel], None]:
    def edit(model: mujoco.MjModel) -> None:
        # the base turns, so gravity turns back in its frame
        model.opt.gravity[:] += np.cross(-_ANGLE * axis, model.opt.gravity)

    return edit


def _add_point(model: mujoco.MjModel, body: int, place: Array) -> None:
    """Add a kilogram to a body, in place; the new tensor gets principal axes again."""
    mass, centre = model.body_mass[body], model.body_ipos[body].copy()
    middle = (mass * centre + place) / (mass + 1.0)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    frame = turn.reshape(3, 3)
    tensor = np.asarray(frame @ np.diag(model.body_inertia[body]) @ frame.T)
    for weight, arm in ((mass, centre - middle), (1.0, place - middle)):
        tensor += weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    values, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.linalg.det(axes)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    model.body_mass[body], model.body_ipos[body] = mass + 1.0, middle
    model.body_inertia[body], model.body_iquat[body] = values, quaternion


def columns_of(model: mujoco.MjModel, run: JointRun) -> tuple[list[Group], Array, Array]:
    """Groups of a run, columns of the nominal parameters (t, n, p), and the torque unexplained."""
    dynamics = Dynamics(model, run.motion())
    bodies = [b for b in range(1, model.nbody) if model.body_mass[b] > 0 and model.body_dofnum[b]]
    masses = {b: dynamics.slope(_heavier(b)) for b in bodies}
    groups = [
        *_friction_groups(model, run),
        *_joint_groups(model, dynamics),
        *_drive_groups(model, dynamics, run),
        *_body_groups(model, dynamics, masses),
    ]
    nuisance = _nuisance(model, dynamics, masses, run)
    return groups, nuisance, run.low_pass.reduced(run.torque) - dynamics.base


def _plain(*names: str) -> Read:
    return lambda values: dict(zip(names, map(float, values), strict=True))


def _scaled(name: str, unit: float) -> Read:
    return lambda values: {name: unit * float(values[0])}


def _at(joint: int, joints: int, *columns: Array) -> Array:
    """Columns that act on one joint alone, of shape (t, n, width)."""
    whole = np.zeros((len(columns[0]), joints, len(columns)))
    whole[:, joint] = np.stack(columns, axis=-1)
    return whole


def _is_slide(model: mujoco.MjModel, joint: int) -> bool:
    return bool(model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE))


def _friction_groups(model: mujoco.MjModel, run: JointRun) -> Iterator[Group]:
    smooth, reduced = run.low_pass.smooth, run.low_pass.reduced
    speed, load = smooth(run.velocity), np.abs(smooth(run.torque))
    position_rate = run.low_pass.derivative(smooth(run.position))
    for j in range(model.njnt):
        v, unit = speed[:, j], SLIDE_METRES if _is_slide(model, j) else 1.0
        side = np.tanh(v / (SMOOTH_SPEED * unit))
        coulomb = reduced(side)

        def group(kind: str, read: Read, *columns: Array, j: int = j, **more: Any) -> Group:
            name, whole = model.joint(j).name, _at(j, model.njnt, *columns)
            return Group(kind=kind, where=name, columns=whole, read=read, positive=True, **more)

        yield group("coulomb_friction", _plain("torque"), coulomb)
        yield group("viscous_friction", _plain("damping"), reduced(position_rate[:, j]),
                    nominal=float(model.dof_damping[j]))  # fmt: skip
        yield group("quadratic_drag", _plain("drag"), reduced(v * np.abs(v)))
        yield group("asymmetric_friction", _plain("forward", "backward"),
                    reduced(np.maximum(side, 0.0)), reduced(np.minimum(side, 0.0)))  # fmt: skip
        if load.any():
            yield group("load_friction", _plain("share"), reduced(load[:, j] * side))
        for at in STRIBECK_SPEEDS:
            bump = reduced(side * np.exp(-((v / (at * unit)) ** 2)))
            yield group("stribeck_friction", _stribeck(at * unit), coulomb, bump, grid=True)


def _stribeck(speed: float) -> Read:
    def read(values: Array) -> dict[str, float]:
        torque = float(values[0])
        ratio = 1.0 + float(values[1]) / torque if torque else 1.0
        return {"torque": torque, "static_ratio": ratio, "speed": speed}

    return read


def _joint_groups(model: mujoco.MjModel, dynamics: Dynamics) -> Iterator[Group]:
    position, _, acceleration = dynamics.motion
    for j in range(model.njnt):
        name, q = model.joint(j).name, position[:, j]
        yield Group(
            kind="rotor_inertia", where=name, read=_plain("inertia"), positive=True,
            columns=_at(j, model.njnt, acceleration[:, j]), nominal=float(model.dof_armature[j]),
        )  # fmt: skip
        springs = _at(j, model.njnt, q, np.ones_like(q))
        yield Group(kind="joint_spring", where=name, read=_spring, columns=springs)


def _spring(values: Array) -> dict[str, float]:
    stiffness = float(values[0])
    reference = -float(values[1]) / stiffness if stiffness else 0.0
    return {"stiffness": stiffness, "reference": reference}


def _drive_groups(
    model: mujoco.MjModel, dynamics: Dynamics, run: JointRun
) -> Iterator[Group]:  # fmt: skip
    base, joints, reduced = dynamics.base, model.njnt, run.low_pass.reduced
    if run.measured is not None:
        for j in range(joints):
            yield Group(
                kind="torque_constant", where=model.joint(j).name, nominal=1.0,
                columns=_at(j, joints, base[:, j]),
                read=lambda values: {"factor": 1.0 + float(values[0])},
            )  # fmt: skip
        return
    if not np.any(run.command_slope):
        return
    slope = reduced(run.command_slope)  # type: ignore[arg-type]
    clock = CLOCK_SAMPLES / run.low_pass.rate
    rate = run.low_pass.derivative(run.low_pass.smooth(run.torque))
    rate = rate[run.low_pass.rows(len(rate))]
    for name, j, _, gain, *_ in actuators_of(model):
        # a drive without torque inside its dead zone loses that much of its error outside
        zone = reduced(gain * np.tanh(run.proportional[:, j] / (1e-4 * gain)))  # type: ignore[index]
        # by the torque of the model, which has no noise of the torque that is explained
        yield Group(
            kind="actuator_gain", where=name, nominal=1.0, columns=_at(j, joints, base[:, j]),
            # nominal torque = model's torque / gain
            read=lambda values: {"gain": 1.0 / max(1.0 + float(values[0]), 1e-3)},
        )  # fmt: skip
        for kind, read, least, column in (
            ("command_delay", _plain("delay"), clock, slope[:, j]),
            ("actuator_lag", _plain("time_constant"), clock, rate[:, j]),
            ("dead_zone", _plain("width"), 0.0, zone),
        ):
            whole = _at(j, joints, column)
            yield Group(kind=kind, where=name, columns=whole, read=read, positive=True, least=least)
    yield Group(
        kind="command_delay", where="all", columns=slope[..., None], read=_plain("delay"),
        positive=True, least=clock,
    )  # fmt: skip


def _body_groups(
    model: mujoco.MjModel, dynamics: Dynamics, masses: Mapping[int, Array]
) -> Iterator[Group]:
    # the model needs more torque, so the actuators give more than the nominal model asks for
    for b, column in masses.items():
        name, mass = model.body(b).name, float(model.body_mass[b])
        yield Group(
            kind="link_mass", where=name, columns=column[..., None], nominal=1.0,
            read=_scaled("mass", mass),
        )  # fmt: skip
        moves = [dynamics.slope(_shifted(b, axis), _LENGTH) for axis in range(3)]
        yield Group(
            kind="link_com", where=name, columns=np.stack(moves, axis=-1),
            read=_plain("x", "y", "z"), largest=LARGEST_SHIFT,
        )  # fmt: skip
        weight = -dynamics.weight(b)[..., None]
        yield Group(kind="gravity_compensation", where=name, columns=weight, read=_plain("share"))
    for site in range(model.nsite):
        if model.site(site).name == "tool":
            point = dynamics.point_mass(int(model.site_bodyid[site]), model.site_pos[site].copy())
            yield Group(kind="payload", where="tool", columns=point, read=_payload, positive=True)
    tilts = [dynamics.slope(_leaning(axis), _ANGLE) for axis in np.eye(3)[:2]]
    yield Group(
        kind="base_tilt", where="base", columns=np.stack(tilts, axis=-1),
        read=_plain("tilt_x", "tilt_y"), largest=LARGEST_ANGLE,
    )  # fmt: skip
    for j in range(model.njnt):
        name, q = model.joint(j).name, dynamics.motion[0][:, j]
        if _is_slide(model, j):
            continue
        yield Group(
            kind="encoder_offset", where=name, columns=-dynamics.by_position(j)[..., None],
            read=_plain("offset"), largest=LARGEST_ANGLE,
        )  # fmt: skip
        for order in RIPPLE_ORDERS:
            yield Group(
                kind="torque_ripple", where=name, read=_ripple(order), grid=True,
                columns=_at(j, model.njnt, np.sin(order * q), np.cos(order * q)),
            )  # fmt: skip


def _payload(values: Array) -> dict[str, float]:
    mass = float(values[0])
    off = values[1:] / mass if mass else np.zeros(3)
    return {"mass": mass, **dict(zip("xyz", map(float, off), strict=True))}


def _ripple(order: int) -> Read:
    return lambda values: {"amplitude": float(np.hypot(*values)), "periods": float(order)}


def _nuisance(
    model: mujoco.MjModel, dynamics: Dynamics, masses: Mapping[int, Array], run: JointRun
) -> Array:
    """Columns by relative changes of the nominal parameters known within the tolerance."""
    columns: list[Array] = []
    # mass and inertia each have an error of their own; `masses` changes both
    for b, mass in masses.items():
        inertia = dynamics.slope(_heavier(b, mass=False))
        columns += [mass - inertia, inertia]
    # none of these columns has the noise by which the actuators' torque is computed
    reduced, base = run.low_pass.reduced, dynamics.base
    rate = run.low_pass.derivative(run.low_pass.smooth(run.position))
    derivative = reduced(run.derivative_gain * rate)
    driven = run.measured is None and bool(np.any(run.proportional))
    for j in range(model.njnt):
        for values in (
            model.dof_armature[j] * dynamics.motion[2][:, j],
            model.dof_damping[j] * reduced(rate[:, j]),
            (derivative[:, j] - base[:, j]) * driven,
            -derivative[:, j],
        ):
            columns.append(_at(j, model.njnt, values)[..., 0])
    return np.stack(columns, axis=-1)


# ------------------------------------------------------------------- stepwise least squares

_RIDGE = 1e-10
"""Ridge relative to the diagonal of the normal equations: it only keeps them solvable."""
_RANK = 1e-7
"""Share of a column that has to be left by the others, squared, for it to be a direction."""
LONGEST_LAG = 0.3
"""Longest lag at which autocorrelation of the residual counts [s]."""
LEAST_DROP = 10.0
"""Least drop of the criterion by a group: above 10 the evidence is very strong (Kass and Raftery,
JASA 1995)."""
MOST_GROUPS = 15
"""Groups after which selection ends: as many as a whole machine may have."""


class Fit(NamedTuple):
    """A fit of some groups."""

    chosen: tuple[int, ...]
    """Numbers of the groups."""
    coefficients: Array
    """Of nuisances, then of the chosen groups in their order."""
    covariance: Array
    """Of the coefficients, with the autocorrelation of the residual in it."""
    bound: list[int]
    """Numbers of the nominal parameters that are on the bound of their tolerance."""
    objective: float
    """Weighted sum of squares, with that of the prior."""


@dataclass(frozen=True, kw_only=True)
class Regression:
    """Rows of all runs, the last one held out; columns are nuisances, groups, target."""

    tolerance: float
    groups: tuple[Group, ...]
    nuisances: int
    """Number of nuisance columns, which come first."""
    weights: Array
    """Standard deviation of a row of each joint for the fit, of shape (n,) [N m or N]."""
    noise: Array
    """What of that is the sensors' noise, of shape (n,)."""
    rows: tuple[Array, ...]
    """For each run, of shape (t, n, columns) [N m or N]."""
    inflation: float = 1.0
    """Rows for each independent one."""

    @property
    def training(self) -> tuple[Array, ...]:
        """Rows of the runs that are fitted."""
        return self.rows[: max(1, len(self.rows) - 1)]

    @cached_property
    def gram(self) -> Array:
        """Normal equations of the training runs, with the prior of a uniform error."""
        total = np.zeros((self.rows[0].shape[-1],) * 2)
        for rows in self.training:
            flat = (rows / self.weights[:, None]).reshape(-1, total.shape[0])
            total += flat.T @ flat
        own = np.arange(self.nuisances)
        total[own, own] += 1.0 / float(self.tolerance / np.sqrt(3.0)) ** 2
        return total

    def span(self, group: int) -> slice:
        """Columns of a group."""
        start = self.nuisances + sum(g.width for g in self.groups[:group])
        return slice(start, start + self.groups[group].width)

    def columns(self, chosen: Sequence[int]) -> Array:
        """Numbers of the nuisance columns and those of the chosen groups."""
        spans = [np.arange(self.span(g).start, self.span(g).stop) for g in chosen]
        return np.concatenate([np.arange(self.nuisances), *spans])

    def fit(self, chosen: Sequence[int]) -> Fit:
        """Fit some groups beside the nominal parameters, which stay within the tolerance."""
        at = self.columns(chosen)
        inner, right = self.gram[np.ix_(at, at)], self.gram[at, -1]
        scale = np.sqrt(np.diag(inner))
        scale[scale == 0] = 1.0
        factor = linalg.cholesky(
            inner / np.outer(scale, scale) + _RIDGE * np.eye(len(at)), check_finite=False
        )
        limits = np.full(len(at), np.inf)
        limits[: self.nuisances] = self.tolerance * scale[: self.nuisances]
        wanted = linalg.solve_triangular(factor, right / scale, trans="T")
        values = linalg.solve_triangular(factor, wanted)
        bound = np.zeros(len(at), dtype=bool)
        if (np.abs(values) > limits).any():
            solved = optimize.lsq_linear(factor, wanted, (-limits, limits), method="bvls")
            values, bound = solved.x, solved.active_mask != 0
        inverse = np.zeros_like(inner)
        free = np.flatnonzero(~bound)
        inverse[np.ix_(free, free)] = linalg.inv((factor.T @ factor)[np.ix_(free, free)])
        values, inverse = values / scale, inverse / np.outer(scale, scale)
        objective = float(self.gram[-1, -1] - 2 * right @ values + values @ inner @ values)
        covariance = inverse * self.inflation
        return Fit(tuple(chosen), values, covariance, np.flatnonzero(bound).tolist(), objective)

    def gains(self, fit: Fit) -> Array:
        """What each group takes off the objective when it joins a fit, of shape (groups,)."""
        gram, at = self.gram, self.columns(fit.chosen)
        fixed, own = at[fit.bound], np.delete(at, fit.bound)
        target = gram[:, -1] - gram[:, fixed] @ fit.coefficients[fit.bound]
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        inner = gram[np.ix_(own, own)] / np.outer(scale[own], scale[own])
        factor = linalg.cho_factor(inner + _RIDGE * np.eye(len(own)))
        cross = gram[own] / scale[own][:, None]
        solved = linalg.cho_solve(factor, np.column_stack((cross, target[own] / scale[own])))
        left = target - cross.T @ solved[:, -1]
        gains = np.zeros(len(self.groups))
        for g in set(range(len(self.groups))) - set(fit.chosen):
            span = self.span(g)
            size = scale[span]
            schur = gram[span, span] - cross[:, span].T @ solved[:, span]
            inverse = linalg.pinvh(schur / np.outer(size, size), rtol=_RANK, atol=_RANK)
            values = inverse @ (left[span] / size)
            if self.groups[g].possible(values / size):
                gains[g] = (left[span] / size) @ values
        return gains

    def within(self, fit: Fit, position: int) -> slice:
        """Coefficients of the group at a position among the chosen ones."""
        widths = [self.groups[g].width for g in fit.chosen]
        start = self.nuisances + sum(widths[:position])
        return slice(start, start + widths[position])

    def counts(self, fit: Fit, position: int) -> bool:
        """Whether an effect is possible and beyond what the tolerance of the model allows."""
        group = self.groups[fit.chosen[position]]
        own = fit.coefficients[self.within(fit, position)]
        allowed = self.tolerance * group.nominal + group.least
        return group.possible(own) and bool(np.abs(own[0]) > allowed)

    def residual(self, fit: Fit, rows: Array) -> Array:
        """Residual torque of a run, of shape (t, n) [N m or N]."""
        return np.asarray(rows[..., -1] - rows[..., self.columns(fit.chosen)] @ fit.coefficients)

    def held_out(self, fit: Fit) -> float:
        """Root mean square of the held-out run's residual [noise sd]."""
        return float(np.sqrt(np.mean((self.residual(fit, self.rows[-1]) / self.noise) ** 2)))

    def effect(self, fit: Fit, position: int) -> NamedEffect:
        """Effect at a position among the chosen ones; intervals by the delta method."""
        group, at = self.groups[fit.chosen[position]], self.within(fit, position)
        values, covariance = fit.coefficients[at], fit.covariance[at, at]
        parameters = group.read(values)
        z = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE))
        slopes = {name: np.zeros(len(values)) for name in parameters}
        for i, sd in enumerate(np.sqrt(np.diag(covariance))):
            step = 1e-3 * sd + 1e-12
            unit = step * np.eye(len(values))[i]
            up, down = group.read(values + unit), group.read(values - unit)
            for name in parameters:
                slopes[name][i] = (up[name] - down[name]) / (2 * step)
        halves = {n: z * float(np.sqrt(s @ covariance @ s)) for n, s in slopes.items()}
        return NamedEffect(
            kind=group.kind,
            where=group.where,
            parameters=parameters,
            interval_95={
                n: (parameters[n] - half, parameters[n] + half)
                for n, half in halves.items()
                if half > 0
            },
            in_model=False,
        )


def run_stepwise_bic(recording: Path, folder: Path, tolerance: float) -> None:
    """Select effects of a recording stepwise by the BIC and write the result."""
    read = read_recording(recording)
    runs = joint_runs(read)
    regression = regression_of(read, runs, tolerance)
    fit = selected(regression)
    residuals = regression.held_out(regression.fit([])), regression.held_out(fit)
    effects = [regression.effect(fit, i) for i in range(len(fit.chosen))]
    write_finding(folder, "stepwise_bic", residuals, runs[-1].name, effects, tolerance)


def regression_of(recording: Recording, runs: Sequence[JointRun], tolerance: float) -> Regression:
    """Regression of a recording, weighted by what a first fit of all groups leaves."""
    model = recording.model()
    found = [columns_of(model, run) for run in runs]
    total, count = np.zeros(model.nv), 0
    replicas = joint_runs(recording, np.random.default_rng(SEED))
    for (_, _, target), own in zip(found, replicas, strict=True):
        base = Dynamics(model, own.motion()).base
        total = total + np.sum((own.low_pass.reduced(own.torque) - base - target) ** 2, axis=0)
        count += len(target)
    noise = np.asarray(np.sqrt(total / count))
    rows = tuple(
        np.concatenate((nuisance, *(g.columns for g in groups), target[..., None]), axis=-1)
        for groups, nuisance, target in found
    )
    groups = tuple(found[0][0])
    first = Regression(
        tolerance=tolerance, groups=groups, nuisances=found[0][1].shape[-1], weights=noise,
        noise=noise, rows=rows,
    )  # fmt: skip
    driven = any(bool(run.torque.any()) for run in runs)
    # without torques the whole regressor would fit any motion by an arm of no inertia
    fit = first.fit([i for i, g in enumerate(groups) if not g.grid] * driven)
    residuals = [first.residual(fit, each) for each in first.training]
    left = np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0))
    weights = np.maximum(noise, left) if driven else noise
    lags = round(LONGEST_LAG * runs[0].low_pass.rate / runs[0].low_pass.stride)
    inflation = _inflation([r / weights for r in residuals], lags)
    return replace(first, weights=weights, inflation=inflation)


def _inflation(residuals: Sequence[Array], lags: int) -> float:
    """Rows for each independent one: 1 + 2 sum of autocorrelations up to the first below zero."""
    total = sum(float(np.sum(r * r)) for r in residuals)
    inflation = 1.0
    for lag in range(1, lags + 1):
        share = sum(float(np.sum(r[lag:] * r[:-lag])) for r in residuals) / total
        if share <= 0.0:
            break
        inflation += 2.0 * share
    return inflation


def selected(regression: Regression) -> Fit:
    """Fit of the groups that forward steps with deletions choose."""
    inflation, groups = regression.inflation, regression.groups
    independent = sum(r.shape[0] * r.shape[1] for r in regression.training) / inflation
    widths = np.array([group.width for group in groups])
    prices = widths * np.log(independent) + 2.0 * np.log(len(groups))
    fit = regression.fit([])
    while len(fit.chosen) < MOST_GROUPS:
        drops = regression.gains(fit) / inflation - prices
        best = int(np.argmax(drops))
        if drops[best] < LEAST_DROP:
            break
        larger = regression.fit([*fit.chosen, best])
        drop = (fit.objective - larger.objective) / inflation - prices[best]
        if drop < LEAST_DROP or not regression.counts(larger, len(fit.chosen)):
            prices[best] = np.inf  # nominal parameters inside the tolerance explain it
            continue
        fit = larger
        while len(fit.chosen) > 1:  # drop what the newest has made superfluous, the least first
            smaller = {
                g: regression.fit([other for other in fit.chosen if other != g])
                for g in fit.chosen[:-1]
            }
            worth = {
                g: (own.objective - fit.objective) / inflation - prices[g]
                for g, own in smaller.items()
            }
            idle = min(worth, key=lambda g: worth[g])
            if worth[idle] >= LEAST_DROP:
                break
            fit = smaller[idle]
    return fit


# ------------------------------------------------------------------------- mujoco.sysid

WINDOWS, WINDOW, TORQUE_WINDOW = 3, 0.4, 0.15
"""Windows of each run, and their length [s]: several time constants of a servo; shorter where
torques drive the model, for nothing calls it back, and errors grow."""
STRIDE = 5
"""Samples from one residual to the next."""
OFF_BOUND = 0.02
"""Share of its range by which a parameter on a bound starts off it."""
DIFFERENCE = 1e-5
"""Step of finite differences, in the parameters' units: the solver of dry friction stops at 1e-8,
which a smaller step would see."""
ITERATIONS = 6
"""Iterations of the optimiser."""
SCALES = (0.2, 4.0)
"""Bounds of masses, armatures and gains over their nominal values."""
CENTRE = 0.15
"""Bound of a centre of mass about its nominal place [m]."""
TORQUE_SHARE = 0.2
"""Bound of dry friction, and of damping at one unit of speed, over the largest torque used."""
PRIOR = "velocity_ratio"
"""Ending of the parameters that have the tolerance as a prior."""
_HAIR = 1e-6
"""Half width of bounds that leave no room, in the parameter's unit: the optimiser wants some."""
_UNSEEN = 1e-9
"""Size of a parameter's column beside the largest one below which data do not depend on it."""
_SINGULAR = 1e-10
"""Eigenvalue over the largest one below which a direction is unknown: differences have an error."""
_PART = 1e-2
"""Part in an unknown direction below which a parameter is known all the same."""


class Value(NamedTuple):
    """One decision variable, the effect that it stands for and how it is judged."""

    kind: str
    where: str
    names: tuple[str, ...]
    offset: Array
    """What is taken off the fitted value to have the parameter of the effect."""
    allowed: Array
    """Departure from the nominal value that the tolerance allows."""


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """What the package works on: a model at the samples' step, and inputs of each run."""

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    runs: list[JointRun]
    inputs: list[Array]
    """Controls of each run, of shape (T, m)."""
    noise: Array
    """Noise of positions, then of velocities, of shape (2 n,)."""
    comparison: str


def package() -> Any:
    """The package, which ships types of its own that are no part of MuJoCo's."""
    return import_module("mujoco.sysid")


def run_sysid(recording: Path, folder: Path, tolerance: float) -> None:
    """Fit all parameters of a recording's model and write the result."""
    ready = _prepared(read_recording(recording))
    parameters, values = parameters_of(ready, tolerance)
    residual = _residual(ready, range(max(1, len(ready.runs) - 1)), tolerance)
    within = _fitted(_within(parameters, values, tolerance), residual)[0]
    # dry friction starts on its bound, where the optimiser would stall
    started = parameters.copy().move_off_bounds(fraction=OFF_BOUND)
    fitted, jacobian = _fitted(started, residual)
    rest = residual(fitted.as_vector(), fitted.copy())[0]
    effects = named(fitted, values, _half_widths(rest, jacobian))
    held_out = _residual(ready, [len(ready.runs) - 1], tolerance)

    def left(own: Any) -> float:
        windows = held_out(own.as_vector(), own.copy())[0][:-1]  # without the prior
        return float(np.sqrt(np.mean(np.concatenate(windows) ** 2)))

    residuals = left(within), left(fitted)
    write_finding(folder, "sysid", residuals, ready.runs[-1].name, effects, tolerance)


def _prepared(recording: Recording) -> Prepared:
    runs = joint_runs(recording)
    spec, comparison = recording.spec(), recording.runs[0].comparison
    names = list(recording.joint_sensors())
    if comparison != "forward":
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        # a free response has motors too, without torque: the package wants controls
        for name in names:
            motor = spec.add_actuator(
                name=f"torque_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            motor.set_to_motor()
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for kind in (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL):
        for name in names:
            spec.add_sensor(
                name=f"{name}_{kind}", type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name
            )
    spec.option.timestep = 1.0 / runs[0].low_pass.rate
    model = spec.compile()
    width = 2 * model.nv
    ready = Prepared(
        spec=spec, model=model, runs=runs, inputs=_inputs(recording, runs, model),
        noise=np.ones(width), comparison=comparison,
    )  # fmt: skip
    # noise of a residual: what once more as much sensor noise does to it
    replicas = joint_runs(recording, np.random.default_rng(SEED))
    noisy = replace(ready, runs=replicas, inputs=_inputs(recording, replicas, model))
    both = [
        _windows(each, range(len(runs)))(np.zeros(0), package().ParameterDict())[0]
        for each in (ready, noisy)
    ]
    changes = [(np.ravel(a) - np.ravel(b)).reshape(-1, width) for a, b in zip(*both, strict=True)]
    noise = np.asarray(np.sqrt(np.mean(np.concatenate(changes) ** 2, axis=0)))
    return replace(ready, noise=noise)


def _inputs(recording: Recording, runs: list[JointRun], model: mujoco.MjModel) -> list[Array]:
    inputs = []
    for run, own in zip(recording.runs, runs, strict=True):
        if run.comparison == "forward":
            zero = np.zeros(run.samples)
            given = [run.controls.get(model.actuator(i).name, zero) for i in range(model.nu)]
            inputs.append(np.stack([np.nan_to_num(each) for each in given], axis=1))
        else:
            inputs.append(own.low_pass.smooth(own.torque))
    return inputs


def parameters_of(ready: Prepared, tolerance: float) -> tuple[Any, list[Value | None]]:
    """Decision variables and what each stands for, in the same order."""
    sysid = package()
    found, values = sysid.ParameterDict(), []
    model, (low, high) = ready.model, SCALES

    def add(
        name: str, nominal: float, bounds: tuple[float, float],
        write: Callable[[mujoco.MjSpec, float], None], kind: str, where: str, parameter: str,
        *, offset: float = 0.0, allowed: float = 0.0,
    ) -> None:  # fmt: skip
        def modifier(spec: mujoco.MjSpec, own: Any) -> None:
            write(spec, float(own.value[0]))

        found.add(sysid.Parameter(name, nominal, *bounds, modifier=modifier))
        told = Value(kind, where, (parameter,), np.array([offset]), np.array([allowed]))
        values.append(told if kind else None)

    largest = np.max([np.abs(run.torque).max(axis=0) for run in ready.runs], axis=0)
    weight = np.abs(model.body_mass.sum() * 9.81 * 0.1)
    for j in range(model.njnt):
        name, dof = model.joint(j).name, int(model.jnt_dofadr[j])
        damping, armature = float(model.dof_damping[dof]), float(model.dof_armature[dof])
        most = TORQUE_SHARE * max(float(largest[dof]), 0.1 * weight)
        add(f"{name}_damping", damping, (0.0, damping + most), _of_joint(name, "damping"),
            "viscous_friction", name, "damping", offset=damping,
            allowed=tolerance * damping)  # fmt: skip
        add(f"{name}_frictionloss", 0.0, (0.0, most), _of_joint(name, "frictionloss"),
            "coulomb_friction", name, "torque")  # fmt: skip
        add(f"{name}_armature", armature, (low * armature, high * armature + 1e-6),
            _of_joint(name, "armature"), "rotor_inertia", name, "inertia", offset=armature,
            allowed=tolerance * armature)  # fmt: skip
    if ready.comparison == "inverse" or model.actuator_biasprm.any():
        for i in range(model.nu):
            name = model.actuator(i).name
            kp, kv = -model.actuator_biasprm[i, 1], -model.actuator_biasprm[i, 2]
            if not kp:
                add(f"{name}_gain", 1.0, SCALES, _of_motor(name), "torque_constant",
                    name.removeprefix("torque_"), "factor", allowed=tolerance)  # fmt: skip
                continue
            add(f"{name}_gain", 1.0, SCALES, _of_servo(name, np.array([kp, kv])),
                "actuator_gain", name, "gain", allowed=tolerance)  # fmt: skip
            # written after the gain: parameters are applied in their order
            add(f"{name}_{PRIOR}", 1.0, (0.7, 1.4), _of_ratio(name), "", "", "")
    for b in range(1, model.nbody):
        if model.body_mass[b] <= 0 or not model.body_dofnum[b]:
            continue
        own = sysid.body_inertia_param(
            ready.spec, model, model.body(b).name, inertia_type=sysid.InertiaType.MassIpos,
            scale_rot_inertia=True, mass_bound_mult=np.array(SCALES),
            ipos_bound_off=np.array([-CENTRE, CENTRE]),
        )  # fmt: skip
        found.add(own)
        allowed = np.array([tolerance * float(own.nominal[0]), 0.0, 0.0, 0.0])
        names = ("mass", "x", "y", "z")
        values.append(Value("link", model.body(b).name, names, own.nominal.copy(), allowed))
    return found, values


def _of_joint(name: str, what: str) -> Callable[[mujoco.MjSpec, float], None]:
    def write(spec: mujoco.MjSpec, value: float) -> None:
        # newer versions have a polynomial in the place of a number
        setattr(spec.joint(name), what, [value, 0.0, 0.0] if what == "damping" else value)

    return write


def _of_motor(name: str) -> Callable[[mujoco.MjSpec, float], None]:
    def write(spec: mujoco.MjSpec, value: float) -> None:
        spec.actuator(name).gainprm[0] = value

    return write


def _of_servo(name: str, gains: Array) -> Callable[[mujoco.MjSpec, float], None]:
    return lambda spec, value: package().apply_pdgain(spec, name, value * gains)


def _of_ratio(name: str) -> Callable[[mujoco.MjSpec, float], None]:
    def write(spec: mujoco.MjSpec, value: float) -> None:
        spec.actuator(name).biasprm[2] *= value

    return write


def _within(parameters: Any, values: list[Value | None], tolerance: float) -> Any:
    """The same parameters inside the tolerance: friction and centres of mass stay as they are."""
    found = parameters.copy()
    for parameter, value in zip(found.values(), values, strict=True):
        nominal = parameter.nominal
        if value is not None and value.kind == "coulomb_friction":
            parameter.frozen = True
            continue
        # a ratio of two gains is off by both
        room = (tolerance if value is not None else 2.0 * tolerance) * np.abs(nominal)
        if value is not None and value.kind == "link":
            room[1:] = _HAIR
        parameter.min_value, parameter.max_value = nominal - room - _HAIR, nominal + room + _HAIR
    return found


def _fitted(parameters: Any, residual: Any) -> tuple[Any, Array]:
    """Parameters after the optimiser, and the Jacobian there."""
    with contextlib.redirect_stdout(io.StringIO()):  # it reports every iteration
        fitted, outcome = package().optimize(
            parameters, residual, optimizer="scipy_parallel_fd", verbose=False,
            max_iters=ITERATIONS, x_scale="jac", diff_step=DIFFERENCE,
        )  # fmt: skip
    return fitted, np.asarray(outcome.jac)


def _residual(ready: Prepared, runs: Sequence[int], tolerance: float) -> Callable[..., Any]:
    """Residual function of some runs, with a row for each parameter that has a prior last."""
    windows = _windows(ready, runs)
    # two gains, each off by the tolerance at most, all errors equally likely
    sd = tolerance * np.sqrt(2.0 / 3.0)

    def extended(x: Array, parameters: Any, **options: Any) -> Any:
        residuals, predicted, measured = windows(x, parameters, **options)
        names = parameters.get_non_frozen_parameter_names()
        own = [i for i, name in enumerate(names) if name.endswith(PRIOR)]
        return [*residuals, (np.asarray(x)[own] - 1.0) / sd], predicted, measured

    return extended


def _windows(ready: Prepared, runs: Sequence[int]) -> Callable[..., Any]:
    """Residual function of windows of some runs, in noise standard deviations."""
    sysid = package()
    rate, width = ready.runs[0].low_pass.rate, 2 * ready.model.nv
    length = round((WINDOW if ready.comparison == "forward" else TORQUE_WINDOW) * rate)
    names, states, controls, readings = [], [], [], []
    for r in runs:
        run = ready.runs[r]
        q, v = run.low_pass.smooth(run.position), run.low_pass.smooth(run.velocity)
        margin = min(round(0.1 * rate), len(q) // 8)
        last = len(q) - length - margin
        for k, start in enumerate(np.linspace(margin, last, WINDOWS).round().astype(int)):
            part = slice(start, start + length)
            times = np.arange(length) / rate
            names.append(f"{run.name}-{k}")
            states.append(sysid.create_initial_state(ready.model, q[start], v[start]))
            controls.append(
                sysid.TimeSeries.from_control_names(times, ready.inputs[r][part], ready.model)
            )
            data = np.hstack((run.position[part], run.velocity[part]))
            readings.append(sysid.TimeSeries.from_names(times, data, ready.model))

    def difference(_: Any, __: Any, measured: Any, ___: Any, ____: bool, state: Array) -> Any:
        # the package's own residual divides by the signal's size
        residual = (measured.data[1:] - state[:, 1 : 1 + width]) / ready.noise
        return residual[::STRIDE], measured, measured

    sequences = sysid.ModelSequences("arm", ready.spec, names, states, controls, readings)
    return sysid.build_residual_fn(  # type: ignore[no-any-return]
        models_sequences=[sequences], modify_residual=difference, n_threads=1, resample_true=False
    )


def _half_widths(residuals: list[Array], jacobian: Array) -> Array:
    """Half widths of the intervals, of shape (parameters,)."""
    # a column of zeros would make every interval infinite, and so would columns of unlike sizes
    size = np.linalg.norm(jacobian, axis=0)
    seen = size > _UNSEEN * size.max()
    half = np.full(len(size), np.inf)
    _, own = package().calculate_intervals(
        [np.ravel(part) for part in residuals], jacobian[:, seen] / size[seen],
        alpha=1.0 - CONFIDENCE, lambda_zero_thresh=_SINGULAR, v_zero_thresh=_PART,
    )  # fmt: skip
    half[seen] = own / size[seen]
    return half


def named(fitted: Any, values: list[Value | None], half: Array) -> list[NamedEffect]:
    """Effects whose interval excludes all that the tolerance allows."""
    effects, at = [], 0
    for parameter, value in zip(fitted.values(), values, strict=True):
        own = half[at : at + parameter.size]
        at += parameter.size
        if value is None:
            continue
        change = parameter.as_vector() - value.offset
        nominal = parameter.as_nominal_vector() - value.offset
        beyond = np.abs(change - nominal) - own > value.allowed
        parts = {value.kind: slice(None)}
        if value.kind == "link":
            parts = {"link_mass": slice(0, 1), "link_com": slice(1, 4)}
        for kind, part in parts.items():
            if not beyond[part].any():
                continue
            found = {
                name: (float(one), float(one - off), float(one + off))
                for name, one, off in zip(value.names[part], change[part], own[part], strict=True)
            }
            if kind == "torque_constant":  # measured over true torque
                found = {n: _reciprocal(*each) for n, each in found.items()}
            intervals = {n: (a, b) for n, (_, a, b) in found.items() if np.isfinite(b - a)}
            parameters = {n: middle for n, (middle, _, _) in found.items()}
            effects.append(
                NamedEffect(
                    kind=kind, where=value.where, parameters=parameters, interval_95=intervals,
                    in_model=False,
                )
            )  # fmt: skip
    return effects


def _reciprocal(value: float, *ends: float) -> tuple[float, float, float]:
    low, high = sorted(1.0 / max(end, 1e-3) for end in ends)
    return 1.0 / value, low, high
