"""Stepwise regression by BIC as a rival of `loose gap`; runs and results that rivals share."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy import linalg, ndimage, optimize, signal, stats

from loose_env.errors import InvalidData
from loose_env.gap import Gap, GapResult, NamedEffect, read_result
from loose_env.recording import JointSensors, Recording, Run, read_recording
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
) -> None:  # fmt: skip
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
    read_result(result.write(folder / "result.json"))


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

    def smooth(self, values: Array) -> Array:
        """Low-passed values at the full rate, along the first axis."""
        if self.cutoff >= 0.45 * self.rate:
            return values
        sos = signal.butter(ORDER, self.cutoff, fs=self.rate, output="sos")
        return np.asarray(signal.sosfiltfilt(sos, values, axis=0))

    @property
    def stride(self) -> int:
        """Samples from one decimated sample to the next."""
        return max(1, int(self.rate / (RATE_OVER_CUTOFF * self.cutoff)))

    def kept(self, values: Array) -> Array:
        """Decimated values without the ends."""
        margin = min(round(MARGIN * self.rate), len(values) // 4)
        return values[margin : len(values) - margin : self.stride]

    def reduced(self, values: Array) -> Array:
        """Low-passed and decimated values."""
        return self.kept(self.smooth(values))

    def derivative(self, values: Array) -> Array:
        """Derivative by time of the low-passed values, by differences of the sixth order."""
        weights = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) * self.rate / 60.0
        return np.asarray(ndimage.correlate1d(self.smooth(values), weights, axis=0, mode="nearest"))


@dataclass(frozen=True, kw_only=True)
class JointRun:
    """One run at the full rate; joints in the model's order, torques at the joints, (T, n)."""

    name: str
    comparison: str
    """``forward``: torques of the commands, ``inverse``: measured ones; else there are none."""
    low_pass: LowPass
    position: Array
    """As read [rad or m]."""
    velocity: Array
    """As read [rad/s or m/s]."""
    torque: Array
    """Torque at the joints [N m or N]."""
    proportional: Array
    """Torque of the actuators from command and position [N m or N]."""
    command_slope: Array
    """Derivative of `proportional` by the time of the command [N m/s]."""
    derivative_gain: Array
    """Torque of the actuators over velocity, zero where a drive is saturated."""

    def motion(self) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration, low-passed and decimated, each of shape (t, n)."""
        own = self.low_pass
        acceleration = own.kept(own.derivative(self.velocity))
        return own.reduced(self.position), own.reduced(self.velocity), acceleration


def joint_runs(recording: Recording, replica: np.random.Generator | None = None) -> list[JointRun]:
    """Runs of a recording as joint motions and torques.

    With a generator as much sensor noise is added once more, through the same filter.
    """
    model, sensors = recording.model(), recording.joint_sensors()
    if (model.actuator_trntype != int(mujoco.mjtTrn.mjTRN_JOINT)).any() or model.na:
        raise InvalidData("only actuators at joints without a state of their own are read")
    for run in recording.runs:
        if not all(own.position and own.position[0] in run.sensors for own in sensors.values()):
            raise InvalidData(f"{run.name}: every joint needs a position sensor")
    rate = 1.0 / float(np.median(np.diff(recording.runs[0].time)))
    motions = [_motion(run, sensors.values()) for run in recording.runs]
    low_pass = LowPass(rate=rate, cutoff=_cutoff([speed for _, speed in motions], rate))
    return [
        _joint_run(model, list(sensors), run, low_pass, motion, replica)
        for run, motion in zip(recording.runs, motions, strict=True)
    ]


def _motion(run: Run, sensors: Iterable[JointSensors]) -> tuple[Array, Array]:
    """Position and velocity of the joints as read, differences where no sensor gives velocity."""
    step = float(np.median(np.diff(run.time)))
    positions, velocities = [], []
    for own in sensors:
        positions.append(_whole(run.sensors[own.position[0]]))
        read = own.velocity and own.velocity[0] in run.sensors
        velocities.append(
            _whole(run.sensors[own.velocity[0]]) if read else np.gradient(positions[-1], step)
        )
    return np.stack(positions, axis=1), np.stack(velocities, axis=1)


def _whole(values: Array) -> Array:
    """Values with missing samples interpolated."""
    good = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), good, values[good])


def _cutoff(velocities: Sequence[Array], rate: float) -> float:
    """Highest frequency at which some joint moves clearly above its noise [Hz]."""
    highest = CUTOFFS[0]
    for velocity in velocities:
        frequency, power = signal.welch(velocity, rate, nperseg=min(1024, len(velocity)), axis=0)
        floor = np.median(power[frequency > min(FLOOR_ABOVE, 0.35 * rate)], axis=0)
        moving = (power > SIGNAL_OVER_FLOOR * floor).any(axis=1)
        highest = max(highest, float(frequency[moving].max(initial=0.0)))
    return min(highest, CUTOFFS[1], 0.4 * rate)


def _joint_run(
    model: mujoco.MjModel, joints: Sequence[str], run: Run, low_pass: LowPass,
    motion: tuple[Array, Array], replica: np.random.Generator | None,
) -> JointRun:  # fmt: skip
    def noisy(values: Array) -> Array:
        if replica is None:
            return values
        # white noise of smooth signals, by fifth differences: their squared binomials sum to 252
        differences = np.diff(values, 5, axis=0) / np.sqrt(252.0)
        noise = 1.4826 * np.median(np.abs(differences), axis=0)
        return np.asarray(values + noise * replica.normal(size=values.shape))

    def columns(values: Mapping[str, Array], names: Sequence[str]) -> Array:
        zero = np.zeros(run.samples)
        return np.stack([_whole(values.get(name, zero)) for name in names], axis=1)

    position, velocity = map(noisy, motion)
    torque, proportional, slope, damping = (np.zeros_like(position) for _ in range(4))
    if run.comparison == "inverse":
        torque = noisy(columns(run.torques, joints))
    elif run.comparison == "forward":
        command = columns(run.controls, [model.actuator(i).name for i in range(model.nu)])
        # mean around each sample of a command that is held from sample to sample
        wide = np.vstack((command[:1], command[:1], command, command[-1:]))
        held = (13.0 * (wide[2:-1] + wide[1:-2]) - (wide[3:] + wide[:-3])) / 24.0
        dofs, gear = _dofs(model), model.actuator_gear[:, 0]
        gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm.T
        low, high = np.where(
            model.actuator_forcelimited, model.actuator_forcerange.T, [[-np.inf], [np.inf]]
        )
        p = gain * held + bias[0] + bias[1] * gear * position[:, dofs]
        d = bias[2] * gear * velocity[:, dofs]
        free = (p + d > low) & (p + d < high)
        at_joints = gear[:, None] * (dofs[:, None] == np.arange(model.nv))
        # a saturated drive gives its limit, whatever its gains are
        proportional = np.where(free, p, np.clip(p + d, low, high)) @ at_joints
        torque = proportional + np.where(free, d, 0.0) @ at_joints
        damping = np.where(free, bias[2] * gear, 0.0) @ at_joints
        slope = np.where(free, gain * low_pass.derivative(held), 0.0) @ at_joints
    return JointRun(
        name=run.name, comparison=run.comparison, low_pass=low_pass, position=position,
        velocity=velocity, torque=torque, proportional=proportional, command_slope=slope,
        derivative_gain=damping,
    )  # fmt: skip


def _dofs(model: mujoco.MjModel) -> Array:
    """Degree of freedom of each actuator."""
    return np.asarray(model.jnt_dofadr[model.actuator_trnid[:, 0]])


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

    def possible(self, values: Array) -> bool:
        """Whether coefficients have the right sign and a size for which the columns hold."""
        right_sign = not self.positive or values[0] > 0.0
        return bool(right_sign and np.all(np.abs(values) <= self.largest))


def _torque(model: mujoco.MjModel, motion: tuple[Array, Array, Array]) -> Array:
    """Inverse dynamics of a model along a motion, of shape (t, n)."""
    data, out = mujoco.MjData(model), np.empty_like(motion[0])
    for k, (q, v, a) in enumerate(zip(*motion, strict=True)):
        data.qpos, data.qvel, data.qacc = q, v, a
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def _changed(model: mujoco.MjModel, **changes: Array) -> mujoco.MjModel:
    """Copy of a model with something added to arrays of it."""
    model = copy.copy(model)
    for name, change in changes.items():
        getattr(model, name)[:] += change
    return model


def columns_of(recording: Recording, run: JointRun) -> tuple[list[Group], Array, Array]:
    """Groups of a run, columns of the nominal parameters (t, n, p), and the torque unexplained."""
    model, motion = recording.model(), run.motion()
    base = _torque(model, motion)
    mass_columns, inertia_columns = {}, {}
    for b in range(1, model.nbody):
        if model.body_mass[b] > 0 and model.body_dofnum[b]:
            own = np.arange(model.nbody) == b
            more = own[:, None] * model.body_inertia
            twice = _changed(model, body_mass=own * model.body_mass, body_inertia=more)
            mass_columns[b] = _torque(twice, motion) - base
            inertia_columns[b] = _torque(_changed(model, body_inertia=more), motion) - base
    groups = [
        *_joint_groups(model, run, motion, base),
        *_drive_groups(model, run, base),
        *_body_groups(recording, motion, base, mass_columns),
    ]
    # relative changes of the nominal parameters; mass and inertia have an error of their own
    columns = [
        part
        for b, mass in mass_columns.items()
        for part in (mass - inertia_columns[b], inertia_columns[b])
    ]
    # none of these columns has the noise by which the actuators' torque is computed
    rate = run.low_pass.derivative(run.position)
    derivative = run.low_pass.reduced(run.derivative_gain * rate)
    driven = run.comparison == "forward" and bool(np.any(run.proportional))
    per_joint = (model.dof_armature * motion[2], model.dof_damping * run.low_pass.reduced(rate),
                 (derivative - base) * driven, -derivative)  # fmt: skip
    for j in range(model.njnt):
        columns += [_at(j, model.njnt, each[:, j])[..., 0] for each in per_joint]
    target = run.low_pass.reduced(run.torque) - base
    return groups, np.stack(columns, axis=-1), target


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


def _stribeck(speed: float) -> Read:
    return lambda values: {
        "torque": float(values[0]),
        "static_ratio": 1.0 + float(values[1] / values[0]),
        "speed": speed,
    }


def _spring(values: Array) -> dict[str, float]:
    return {"stiffness": float(values[0]), "reference": -float(values[1] / values[0])}


def _ripple(order: int) -> Read:
    return lambda values: {"amplitude": float(np.hypot(*values)), "periods": float(order)}


def _joint_groups(
    model: mujoco.MjModel, run: JointRun, motion: tuple[Array, Array, Array], base: Array
) -> Iterator[Group]:
    smooth, reduced = run.low_pass.smooth, run.low_pass.reduced
    speed, load = smooth(run.velocity), np.abs(smooth(run.torque))
    rate = reduced(run.low_pass.derivative(run.position))
    for j in range(model.njnt):
        v, unit = speed[:, j], SLIDE_METRES if _is_slide(model, j) else 1.0
        side = np.tanh(v / (SMOOTH_SPEED * unit))
        q, coulomb = motion[0][:, j], reduced(side)

        def group(kind: str, read: Read, *columns: Array, j: int = j, **more: Any) -> Group:
            whole = _at(j, model.njnt, *columns)
            return Group(kind=kind, where=model.joint(j).name, columns=whole, read=read, **more)

        friction = partial(group, positive=True)
        yield friction("coulomb_friction", _plain("torque"), coulomb)
        yield friction("viscous_friction", _plain("damping"), rate[:, j],
                       nominal=float(model.dof_damping[j]))  # fmt: skip
        yield friction("quadratic_drag", _plain("drag"), reduced(v * np.abs(v)))
        yield friction("asymmetric_friction", _plain("forward", "backward"),
                       reduced(np.maximum(side, 0.0)), reduced(np.minimum(side, 0.0)))  # fmt: skip
        if load.any():
            yield friction("load_friction", _plain("share"), reduced(load[:, j] * side))
        for at in STRIBECK_SPEEDS:
            bump = reduced(side * np.exp(-((v / (at * unit)) ** 2)))
            yield friction("stribeck_friction", _stribeck(at * unit), coulomb, bump, grid=True)
        yield group("rotor_inertia", _plain("inertia"), motion[2][:, j], positive=True,
                    nominal=float(model.dof_armature[j]))  # fmt: skip
        yield group("joint_spring", _spring, q, np.ones_like(q))
        if run.comparison == "inverse":
            yield group("torque_constant", lambda values: {"factor": 1.0 + float(values[0])},
                        base[:, j], nominal=1.0)  # fmt: skip
        if not _is_slide(model, j):
            ahead = (motion[0] + _ANGLE * np.eye(model.nv)[j], *motion[1:])
            yield Group(
                kind="encoder_offset", where=model.joint(j).name, read=_plain("offset"),
                columns=(base - _torque(model, ahead))[..., None] / _ANGLE, largest=LARGEST_ANGLE,
            )  # fmt: skip
            for order in RIPPLE_ORDERS:
                sine, cosine = np.sin(order * q), np.cos(order * q)
                yield group("torque_ripple", _ripple(order), sine, cosine, grid=True)


def _drive_groups(model: mujoco.MjModel, run: JointRun, base: Array) -> Iterator[Group]:
    joints, low_pass = model.njnt, run.low_pass
    if not np.any(run.command_slope):
        return
    slope = low_pass.reduced(run.command_slope)
    clock = CLOCK_SAMPLES / low_pass.rate
    rate = low_pass.kept(low_pass.derivative(run.torque))
    for i, j in enumerate(_dofs(model)):
        name, gain = model.actuator(i).name, model.actuator_gainprm[i, 0]
        # a drive without torque inside its dead zone loses that much of its error outside
        zone = low_pass.reduced(gain * np.tanh(run.proportional[:, j] / (1e-4 * gain)))
        # by the torque of the model, which has no noise of the torque that is explained
        yield Group(
            kind="actuator_gain", where=name, nominal=1.0, columns=_at(j, joints, base[:, j]),
            # nominal torque = model's torque / gain
            read=lambda values: {"gain": 1.0 / max(1.0 + float(values[0]), 1e-3)},
        )  # fmt: skip
        for kind, parameter, least, column in (
            ("command_delay", "delay", clock, slope[:, j]),
            ("actuator_lag", "time_constant", clock, rate[:, j]),
            ("dead_zone", "width", 0.0, zone),
        ):
            yield Group(
                kind=kind, where=name, columns=_at(j, joints, column), read=_plain(parameter),
                positive=True, least=least,
            )  # fmt: skip
    yield Group(
        kind="command_delay", where="all", columns=slope[..., None], read=_plain("delay"),
        positive=True, least=clock,
    )  # fmt: skip


def _body_groups(
    recording: Recording, motion: tuple[Array, Array, Array], base: Array,
    masses: Mapping[int, Array],
) -> Iterator[Group]:  # fmt: skip
    model = recording.model()

    def slope(changed: mujoco.MjModel, step: float) -> Array:
        return (_torque(changed, motion) - base) / step

    # the model needs more torque, so the actuators give more than the nominal model asks for
    still = (motion[0], np.zeros_like(base), np.zeros_like(base))
    weightless = _torque(model, still)
    for b, column in masses.items():
        name, own = model.body(b).name, (np.arange(model.nbody) == b)[:, None]
        yield Group(
            kind="link_mass", where=name, columns=column[..., None], nominal=1.0,
            read=_scaled("mass", float(model.body_mass[b])),
        )  # fmt: skip
        moves = [slope(_changed(model, body_ipos=_LENGTH * own * x), _LENGTH) for x in np.eye(3)]
        yield Group(
            kind="link_com", where=name, columns=np.stack(moves, axis=-1), read=_plain(*"xyz"),
            largest=LARGEST_SHIFT,
        )  # fmt: skip
        heavier = _changed(
            model, body_mass=own[:, 0] * model.body_mass, body_inertia=own * model.body_inertia
        )
        weight = weightless - _torque(heavier, still)
        yield Group(
            kind="gravity_compensation", where=name, columns=weight[..., None],
            read=_plain("share"),
        )  # fmt: skip
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tool") >= 0:
        at, *moved = (
            slope(_loaded(recording, x), 1.0) for x in (np.zeros(3), *_LENGTH * np.eye(3))
        )
        yield Group(
            kind="payload", where="tool", positive=True,
            columns=np.stack([at, *((each - at) / _LENGTH for each in moved)], axis=-1),
            read=lambda v: {"mass": float(v[0]), **_plain(*"xyz")(v[1:] / v[0])},
        )  # fmt: skip
    tilts = []
    for axis in np.eye(3)[:2]:
        leaning = copy.copy(model)
        # the base turns, so gravity turns back in its frame
        leaning.opt.gravity[:] += np.cross(-_ANGLE * axis, model.opt.gravity)
        tilts.append(slope(leaning, _ANGLE))
    yield Group(
        kind="base_tilt", where="base", columns=np.stack(tilts, axis=-1),
        read=_plain("tilt_x", "tilt_y"), largest=LARGEST_ANGLE,
    )  # fmt: skip


def _loaded(recording: Recording, shift: Array) -> mujoco.MjModel:
    """The model with a point mass of a kilogram at its tool, shifted in the frame of its link."""
    spec = recording.spec()
    site = spec.site("tool")
    place = np.asarray(site.pos) + shift
    site.parent.add_body(
        pos=place, mass=1.0, inertia=np.full(3, 1e-12), explicitinertial=True, ipos=np.zeros(3)
    )
    return spec.compile()


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
        total[own, own] += 3.0 / self.tolerance**2
        return total

    @cached_property
    def spans(self) -> list[slice]:
        """Columns of each group."""
        ends = self.nuisances + np.cumsum([0, *(g.columns.shape[-1] for g in self.groups)])
        return [slice(a, b) for a, b in pairwise(ends)]

    def columns(self, chosen: Sequence[int]) -> Array:
        """Numbers of the nuisance columns and those of the chosen groups."""
        every = np.arange(self.rows[0].shape[-1])
        return np.concatenate([every[: self.nuisances], *(every[self.spans[g]] for g in chosen)])

    def fit(self, chosen: Sequence[int]) -> Fit:
        """Fit some groups beside the nominal parameters, which stay within the tolerance."""
        at = self.columns(chosen)
        inner, right = self.gram[np.ix_(at, at)], self.gram[at, -1]
        scale = np.sqrt(np.diag(inner))
        scale[scale == 0] = 1.0
        factor = linalg.cholesky(inner / np.outer(scale, scale) + _RIDGE * np.eye(len(at)))
        limits = np.where(np.arange(len(at)) < self.nuisances, self.tolerance * scale, np.inf)
        wanted = linalg.solve_triangular(factor, right / scale, trans="T")
        solved = optimize.lsq_linear(factor, wanted, (-limits, limits), method="bvls")
        free = np.ix_(*[np.flatnonzero(solved.active_mask == 0)] * 2)
        covariance = np.zeros_like(inner)
        covariance[free] = linalg.inv((factor.T @ factor)[free])
        covariance *= self.inflation / np.outer(scale, scale)
        values = solved.x / scale
        objective = float(self.gram[-1, -1] - 2 * right @ values + values @ inner @ values)
        bound = np.flatnonzero(solved.active_mask).tolist()
        return Fit(tuple(chosen), values, covariance, bound, objective)

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
            span = self.spans[g]
            size = scale[span]
            schur = gram[span, span] - cross[:, span].T @ solved[:, span]
            inverse = linalg.pinvh(schur / np.outer(size, size), rtol=_RANK, atol=_RANK)
            values = inverse @ (left[span] / size)
            if self.groups[g].possible(values / size):
                gains[g] = (left[span] / size) @ values
        return gains

    def within(self, fit: Fit, group: int) -> slice:
        """Coefficients of a chosen group."""
        before = self.columns(fit.chosen[: fit.chosen.index(group)])
        return slice(len(before), len(before) + self.groups[group].columns.shape[-1])

    def counts(self, fit: Fit, group: int) -> bool:
        """Whether an effect is possible and beyond what the tolerance of the model allows."""
        own, about = fit.coefficients[self.within(fit, group)], self.groups[group]
        beyond = abs(own[0]) > self.tolerance * about.nominal + about.least
        return about.possible(own) and bool(beyond)

    def residual(self, fit: Fit, rows: Array) -> Array:
        """Residual torque of a run, of shape (t, n) [N m or N]."""
        return np.asarray(rows[..., -1] - rows[..., self.columns(fit.chosen)] @ fit.coefficients)

    def held_out(self, fit: Fit) -> float:
        """Root mean square of the held-out run's residual [noise sd]."""
        return float(np.sqrt(np.mean((self.residual(fit, self.rows[-1]) / self.noise) ** 2)))

    def effect(self, fit: Fit, group: int) -> NamedEffect:
        """Effect of a chosen group; intervals by the delta method."""
        own, at = self.groups[group], self.within(fit, group)
        values, covariance = fit.coefficients[at], fit.covariance[at, at]
        parameters, z = own.read(values), float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE))
        steps = np.diag(1e-3 * np.sqrt(np.diag(covariance)) + 1e-12)
        ends = [(own.read(values + step), own.read(values - step)) for step in steps]
        intervals = {}
        for name, value in parameters.items():
            slope = np.array([up[name] - down[name] for up, down in ends]) / (2 * np.diag(steps))
            if half := z * float(np.sqrt(slope @ covariance @ slope)):
                intervals[name] = (value - half, value + half)
        return NamedEffect(
            kind=own.kind, where=own.where, parameters=parameters, interval_95=intervals,
            in_model=False,
        )  # fmt: skip


def run_stepwise_bic(recording: Path, folder: Path, tolerance: float) -> None:
    """Select effects of a recording stepwise by the BIC and write the result."""
    read = read_recording(recording)
    regression = regression_of(read, tolerance)
    fit = selected(regression)
    residuals = regression.held_out(regression.fit([])), regression.held_out(fit)
    effects = [regression.effect(fit, group) for group in fit.chosen]
    write_finding(folder, "stepwise_bic", residuals, read.runs[-1].name, effects, tolerance)


def regression_of(recording: Recording, tolerance: float) -> Regression:
    """Regression of a recording, weighted by what a first fit of all groups leaves."""
    model, runs = recording.model(), joint_runs(recording)
    found = [columns_of(recording, run) for run in runs]
    replicas = joint_runs(recording, np.random.default_rng(SEED))
    changes = [
        own.low_pass.reduced(own.torque) - _torque(model, own.motion()) - target
        for (_, _, target), own in zip(found, replicas, strict=True)
    ]
    noise = np.asarray(np.sqrt(np.mean(np.concatenate(changes) ** 2, axis=0)))
    groups, nuisance, _ = found[0]
    first = Regression(
        tolerance=tolerance,
        groups=tuple(groups),
        nuisances=nuisance.shape[-1],
        weights=noise,
        noise=noise,
        rows=tuple(
            np.concatenate((columns, *(g.columns for g in own), target[..., None]), axis=-1)
            for own, columns, target in found
        ),
    )
    driven = any(run.torque.any() for run in runs)
    # without torques the whole regressor would fit any motion by an arm of no inertia
    fit = first.fit([i for i, g in enumerate(groups) if not g.grid] * driven)
    residuals = [first.residual(fit, each) for each in first.training]
    left = np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0))
    weights = np.maximum(noise, left) if driven else noise
    residuals = [each / weights for each in residuals]
    # rows for each independent one: 1 + 2 sum of autocorrelations up to the first below zero
    own = runs[0].low_pass
    total, inflation = sum(float(np.sum(r * r)) for r in residuals), 1.0
    for lag in range(1, round(LONGEST_LAG * own.rate / own.stride) + 1):
        share = sum(float(np.sum(r[lag:] * r[:-lag])) for r in residuals) / total
        if share <= 0.0:
            break
        inflation += 2.0 * share
    return replace(first, weights=weights, inflation=inflation)


def selected(regression: Regression) -> Fit:
    """Fit of the groups that forward steps with deletions choose."""
    inflation, groups = regression.inflation, regression.groups
    independent = sum(r.shape[0] * r.shape[1] for r in regression.training) / inflation
    widths = np.array([group.columns.shape[-1] for group in groups])
    prices = widths * np.log(independent) + 2.0 * np.log(len(groups))
    fit = regression.fit([])
    while len(fit.chosen) < MOST_GROUPS:
        drops = regression.gains(fit) / inflation - prices
        best = int(np.argmax(drops))
        if drops[best] < LEAST_DROP:
            break
        larger = regression.fit([*fit.chosen, best])
        drop = (fit.objective - larger.objective) / inflation - prices[best]
        if drop < LEAST_DROP or not regression.counts(larger, best):
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
            idle = min(worth, key=worth.__getitem__)
            if worth[idle] >= LEAST_DROP:
                break
            fit = smaller[idle]
    return fit
