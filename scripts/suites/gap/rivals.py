"""Rivals of `loose gap` on the same recordings: stepwise regression, and mujoco.sysid.

Both are what a practised user would write in an afternoon: a regression of joint torques on the
columns of a catalogue, selected by BIC, and a fit of all parameters of MuJoCo's own package, of
which those are named whose intervals leave what a model tolerates.
"""

from __future__ import annotations

import contextlib
import copy
import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy import linalg, signal

from loose_env.recording import Recording, Run, read_recording
from loose_env.typing import Array

TOLERANCE = 0.1
"""Share of a nominal figure up to which a change of it is no effect."""


def result_of(verdict: str, effects: list[dict[str, Any]]) -> dict[str, Any]:
    """A result as `loose gap` writes it, as far as it is graded."""
    return {"format": "loose-gap/1", "verdict": verdict, "effects": effects}


def _effect(kind: str, where: str, values: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    """An effect from values and their standard deviations."""
    return {
        "kind": kind, "where": where,
        "parameters": {name: float(value) for name, (value, _) in values.items()},
        "interval_95": {
            name: [float(value - 1.96 * sd), float(value + 1.96 * sd)]
            for name, (value, sd) in values.items() if np.isfinite(sd)
        },
    }  # fmt: skip


# ------------------------------------------------------------------------ motion and torque


@dataclass(frozen=True, kw_only=True)
class Moved:
    """One run, low-passed and thinned; arrays of shape (t, n)."""

    q: Array
    v: Array
    a: Array
    torque: Array
    """Of the log, or what the nominal drives give; zero in a free swing."""
    command: Array
    """Force over the velocity of the command: what a delay takes away."""


def _columns(run: Run, names: list[str], part: Mapping[str, Array]) -> Array:
    """Columns of a run, missing samples interpolated and missing columns zero."""
    found = []
    for name in names:
        values = np.asarray(part.get(name, np.zeros(run.samples)), dtype=float)
        good = np.flatnonzero(np.isfinite(values))
        found.append(np.interp(np.arange(len(values)), good, values[good]))
    return np.stack(found, axis=1)


def moved(recording: Recording, run: Run) -> Moved:
    """Motion and torque of a run at the joints."""
    model, sensors = recording.model(), recording.joint_sensors()
    step = float(np.median(np.diff(run.time)))
    band = min(15.0, 0.15 / step)
    low = signal.butter(4, band, fs=1 / step, output="sos")
    q = _columns(run, [own.position[0] for own in sensors.values()], run.sensors)
    q = signal.sosfiltfilt(low, q, axis=0)
    v = np.gradient(q, step, axis=0)
    torque, command = np.zeros_like(q), np.zeros_like(q)
    if run.controls:
        names = [model.actuator(i).name for i in range(model.nu)]
        given = _columns(run, names, run.controls)
        held = signal.sosfiltfilt(low, 0.5 * (given + np.vstack((given[:1], given[:-1]))), axis=0)
        joint = model.jnt_dofadr[model.actuator_trnid[:, 0]]
        gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm
        force = gain * held + bias[:, 0] + bias[:, 1] * q[:, joint] + bias[:, 2] * v[:, joint]
        free = model.actuator_forcelimited == 0  # their range is of zeros
        low_end, high_end = np.where(free, [[-np.inf], [np.inf]], model.actuator_forcerange.T)
        torque[:, joint] = np.clip(force, low_end, high_end)
        command[:, joint] = gain * np.gradient(held, step, axis=0)
    elif run.torques:
        torque = signal.sosfiltfilt(low, _columns(run, list(sensors), run.torques), axis=0)
    thin = max(1, int(0.4 / (band * step)))
    kept = slice(2 * thin, -2 * thin, thin)
    a = np.gradient(v, step, axis=0)
    return Moved(q=q[kept], v=v[kept], a=a[kept], torque=torque[kept], command=command[kept])


def _inverse(model: mujoco.MjModel, run: Moved) -> Array:
    """Torque that a model needs for a motion, of shape (t, n)."""
    data, out = mujoco.MjData(model), np.empty_like(run.q)
    for k, (q, v, a) in enumerate(zip(run.q, run.v, run.a, strict=True)):
        data.qpos, data.qvel, data.qacc = q, v, a
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


# ------------------------------------------------------------------------------ stepwise BIC


@dataclass(frozen=True, kw_only=True)
class Group:
    """Columns of one effect at one place."""

    kind: str
    where: str
    columns: Array
    """Of shape (t n, p)."""
    names: tuple[str, ...]
    least: float = 0.0
    """Size up to which the first coefficient is no effect."""
    positive: bool = False
    """Whether the first coefficient cannot be negative."""


def _at_joint(j: int, *columns: Array, n: int) -> Array:
    out = np.zeros((len(columns[0]), n, len(columns)))
    out[:, j] = np.stack(columns, axis=1)
    return out.reshape(-1, len(columns))


def groups_of(recording: Recording, run: Moved, form: str) -> tuple[list[Group], Array]:
    """Columns of the catalogue along a motion, and the torque that is unexplained, (t n,)."""
    model, joints = recording.model(), list(recording.joint_sensors())
    base, n = _inverse(model, run), run.q.shape[1]
    found: list[Group] = []

    def add(kind: str, where: str, columns: Array, *names: str, **rest: Any) -> None:
        found.append(Group(kind=kind, where=where, columns=columns, names=names, **rest))

    for j, name in enumerate(joints):
        q, v, a, needed = run.q[:, j], run.v[:, j], run.a[:, j], base[:, j]
        turning = np.tanh(v / (0.02 * np.abs(v).max() + 1e-9))
        dof = int(model.joint(name).dofadr[0])
        slack = TOLERANCE * float(model.dof_damping[dof])
        add("viscous_friction", name, _at_joint(j, v, n=n), "damping", positive=True, least=slack)
        add("coulomb_friction", name, _at_joint(j, turning, n=n), "torque", positive=True)
        add("quadratic_drag", name, _at_joint(j, v * np.abs(v), n=n), "drag", positive=True)
        add("rotor_inertia", name, _at_joint(j, a, n=n), "inertia", positive=True,
            least=2 * TOLERANCE * float(model.dof_armature[dof]))  # fmt: skip
        add("joint_spring", name, _at_joint(j, q, np.ones_like(q), n=n), "stiffness", "offset",
            positive=True)  # fmt: skip
        if form == "torque":
            add("torque_offset", name, _at_joint(j, np.ones_like(q), n=n), "torque")
            add("torque_constant", name, _at_joint(j, needed, n=n), "factor",
                least=TOLERANCE)  # fmt: skip
        if form == "servo":
            motor = model.actuator(j).name
            add("actuator_gain", motor, _at_joint(j, needed, n=n), "gain",
                least=TOLERANCE)  # fmt: skip
            add("command_delay", motor, _at_joint(j, run.command[:, j], n=n), "delay",
                positive=True, least=1e-3)  # fmt: skip
    for b in range(1, model.nbody):
        if model.body_mass[b] <= 0:
            continue
        own = np.arange(model.nbody) == b
        name, mass = model.body(b).name, float(model.body_mass[b])
        heavier = copy.copy(model)
        heavier.body_mass[:] += 1e-2 * own
        heavier.body_inertia[:] += 1e-2 / mass * own[:, None] * model.body_inertia
        weight = (_inverse(heavier, run) - base).reshape(-1, 1) / 1e-2
        add("link_mass", name, weight, "mass", least=TOLERANCE * mass)
        shifts = []
        for axis in range(3):
            shifted = copy.copy(model)
            shifted.body_ipos[b, axis] += 1e-3
            shifts.append((_inverse(shifted, run) - base).ravel() / 1e-3)
        add("link_com", name, np.stack(shifts, axis=1), "x", "y", "z")
    tilts = []
    for push in ([0.0, -1.0, 0.0], [1.0, 0.0, 0.0]):  # a base turned about x, about y
        tilted = copy.copy(model)
        tilted.opt.gravity[:] += 1e-3 * 9.81 * np.array(push)
        tilts.append((_inverse(tilted, run) - base).ravel() / 1e-3)
    add("base_tilt", "base", np.stack(tilts, axis=1), "tilt_x", "tilt_y")
    alive = [g for g in found if np.linalg.norm(g.columns, axis=0).min() > 1e-9]
    return alive, (run.torque - base).ravel()


def stepwise(folder: Path) -> dict[str, Any]:
    """Forward selection by BIC of a regression of joint torques."""
    recording = read_recording(folder)
    form = "servo" if recording.runs[0].controls else "torque"
    form = form if recording.runs[0].torques or form == "servo" else "free"
    parts = [groups_of(recording, moved(recording, run), form) for run in recording.runs]
    keys = [(g.kind, g.where) for g in parts[0][0]]
    stacked = {
        key: [g for groups, _ in parts for g in groups if (g.kind, g.where) == key] for key in keys
    }
    groups = {
        key: Group(**{**vars(own[0]), "columns": np.vstack([g.columns for g in own])})
        for key, own in stacked.items()
        if len(own) == len(parts)
    }
    y, n = np.concatenate([rest for _, rest in parts]), recording.model().nv
    whole = np.hstack([g.columns for g in groups.values()])
    left = y - whole @ linalg.lstsq(whole, y)[0]
    scale = np.tile(left.reshape(-1, n).std(axis=0) + 1e-9, len(y) // n)
    y = y / scale
    columns = {key: g.columns / scale[:, None] for key, g in groups.items()}
    chosen: list[tuple[str, str]] = []

    def bic(keys: list[tuple[str, str]]) -> tuple[float, Array]:
        if not keys:
            return len(y) * float(np.log(y @ y)), np.zeros(0)
        x = np.hstack([columns[key] for key in keys])
        beta = linalg.lstsq(x, y)[0]
        rest = y - x @ beta
        return float(len(y) * np.log(rest @ rest) + x.shape[1] * np.log(len(y))), beta

    now = bic([])[0]
    while len(chosen) < 12:
        tried = [(bic([*chosen, key]), key) for key in groups if key not in chosen]
        allowed = [
            (score, key)
            for (score, beta), key in tried
            if _possible([groups[each] for each in (*chosen, key)], beta)
        ]
        if not allowed or min(allowed)[0] >= now - 10.0:
            break
        now, key = min(allowed)
        chosen.append(key)
    beta = bic(chosen)[1]
    x = np.hstack([columns[key] for key in chosen]) if chosen else np.zeros((len(y), 0))
    rest = (y - x @ beta).reshape(-1, n)
    # neighbours that agree are fewer observations, and say that something is left
    agree = np.clip((rest[1:] * rest[:-1]).sum(axis=0) / (rest**2).sum(axis=0), 0.0, 0.95)
    widen = np.sqrt((1 + agree.max()) / (1 - agree.max()) * rest.var())
    sd = widen * np.sqrt(np.diag(np.linalg.pinv(x.T @ x)))
    effects, at = [], 0
    for key in chosen:
        group, width = groups[key], columns[key].shape[1]
        b, s = beta[at : at + width], sd[at : at + width]
        at += width
        if width == 1 and abs(b[0]) - 2 * s[0] < group.least:
            continue
        values = dict(zip(group.names, zip(b, s, strict=True), strict=True))
        if group.kind == "torque_constant":
            values = {"factor": (1 + b[0], s[0])}
        if group.kind == "actuator_gain":  # what is needed is the gain times what was asked for
            values = {"gain": (1 / (1 + b[0]), s[0])}
        if group.kind == "joint_spring":
            values = {"stiffness": values["stiffness"]}
        effects.append(_effect(group.kind, group.where, values))
    before = float(np.mean(y**2))
    explained = 1 - float(np.mean(rest**2)) / before
    if effects:
        return result_of("named" if explained > 0.5 else "unexplained", effects)
    return result_of("no_gap" if before < 4.0 else "unexplained", [])


def _possible(groups: list[Group], beta: Array) -> bool:
    """Whether friction brakes and rotors add inertia."""
    firsts = np.cumsum([0, *(group.columns.shape[1] for group in groups[:-1])])
    return all(beta[k] > 0 or not group.positive for k, group in zip(firsts, groups, strict=True))


# ----------------------------------------------------------------------------- mujoco.sysid

WINDOWS, WINDOW = 3, 0.4
"""Windows of each run, and their length [s]: several time constants of a servo."""
ITERATIONS = 6
"""Iterations of the optimiser."""


@dataclass(frozen=True)
class Free:
    """A parameter that is fitted, and the effect that a change of it is."""

    kind: str
    where: str
    name: str
    nominal: float
    neutral: float
    """Value of the effect's parameter at the nominal one."""


def _package() -> Any:
    # it ships types of its own that are no part of MuJoCo's
    return import_module("mujoco.sysid")


def _write(part: str, name: str, field: str) -> Callable[[mujoco.MjSpec, Any], None]:
    def modifier(spec: mujoco.MjSpec, own: Any) -> None:
        value = float(own.value[0])
        element = getattr(spec, part)(name)
        if field == "gain":
            element.gainprm[0] *= value
            element.biasprm[1:3] *= value
        elif field == "ipos":
            element.ipos = element.ipos + np.array([value, 0.0, 0.0])
        else:
            # newer versions have a polynomial in the place of damping
            setattr(element, field, [value, 0.0, 0.0] if field == "damping" else value)

    return modifier


def _parameters(model: mujoco.MjModel) -> Iterator[tuple[Free, Any]]:
    """All parameters that are free, and what the package wants of each."""
    make, most = _package().Parameter, np.abs(model.body_mass.sum() * 9.81 * 0.1)
    for j in range(model.njnt):
        name, dof = model.joint(j).name, int(model.jnt_dofadr[j])
        damping, armature = float(model.dof_damping[dof]), float(model.dof_armature[dof])
        for kind, field, value, high in (
            ("viscous_friction", "damping", damping, 10 * damping + 0.1 * most),
            ("coulomb_friction", "frictionloss", 1e-3 * most, most),
            ("rotor_inertia", "armature", armature, 4 * armature + 1e-6),
        ):
            said = {"frictionloss": "torque", "armature": "inertia"}.get(field, field)
            own = make(f"{name}_{field}", value, 0.0, high, modifier=_write("joint", name, field))
            yield Free(kind, name, said, value, 0.0), own
    for i in range(model.nu if model.actuator_biasprm.any() else 0):
        name = model.actuator(i).name
        own = make(f"{name}_gain", 1.0, 0.2, 4.0, modifier=_write("actuator", name, "gain"))
        yield Free("actuator_gain", name, "gain", 1.0, 1.0), own
    for b in range(1, model.nbody):
        name, mass = model.body(b).name, float(model.body_mass[b])
        own = make(
            f"{name}_mass", mass, 0.3 * mass, 4 * mass, modifier=_write("body", name, "mass")
        )
        yield Free("link_mass", name, "mass", mass, 0.0), own
        own = make(f"{name}_x", 0.0, -0.15, 0.15, modifier=_write("body", name, "ipos"))
        yield Free("link_com", name, "x", 0.0, 0.0), own


def sysid(folder: Path) -> dict[str, Any]:
    """Fit all parameters of `mujoco.sysid` on windows; name what leaves the tolerance."""
    recording, package = read_recording(folder), _package()
    spec, sensors = recording.spec(), recording.joint_sensors()
    names, drives = list(sensors), bool(recording.runs[0].controls)
    if not drives:
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        for name in names:
            motor = spec.add_actuator(name=f"on_{name}", target=name,
                                      trntype=mujoco.mjtTrn.mjTRN_JOINT)  # fmt: skip
            motor.set_to_motor()
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for name in names:
        spec.add_sensor(name=f"{name}_q", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                        objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name)  # fmt: skip
    step = float(np.median(np.diff(recording.runs[0].time)))
    inside = max(1, int(np.ceil(step / 1e-3)))
    spec.option.timestep = step / inside
    model = spec.compile()
    controls = [model.actuator(i).name for i in range(model.nu)]
    length, labels, states, inputs, readings, noise = round(WINDOW / step), [], [], [], [], []
    low = signal.butter(4, min(40.0, 0.3 / step), fs=1 / step, output="sos")
    for run in recording.runs:
        q = _columns(run, [own.position[0] for own in sensors.values()], run.sensors)
        given = run.controls if drives else {f"on_{k}": v for k, v in run.torques.items()}
        u = _columns(run, controls, given)
        smooth = signal.sosfiltfilt(low, q, axis=0)
        v = np.gradient(smooth, step, axis=0)
        noise.append((q - smooth).std(axis=0))
        for k, start in enumerate(np.linspace(5, len(q) - length - 5, WINDOWS).astype(int)):
            part = slice(start, start + length)
            # the model steps inside a sample, and inputs are held there
            fine = np.arange((length - 1) * inside + 1) * step / inside
            held = u[part][np.minimum(np.arange(len(fine)) // inside, length - 1)]
            labels.append(f"{run.name}-{k}")
            states.append(package.create_initial_state(model, smooth[start], v[start]))
            inputs.append(package.TimeSeries.from_control_names(fine, held, model))
            read = np.stack([np.interp(fine, np.arange(length) * step, c) for c in q[part].T], 1)
            readings.append(package.TimeSeries.from_names(fine, read, model))
    sd, n = np.mean(noise, axis=0) + 1e-6, model.nv

    def difference(_: Any, __: Any, measured: Any, ___: Any, ____: bool, state: Array) -> Any:
        off = (measured.data[1:] - state[:, 1 : 1 + n]) / sd
        return off[:: 5 * inside], measured, measured

    sequences = package.ModelSequences("arm", spec, labels, states, inputs, readings)
    residual = package.build_residual_fn(
        models_sequences=[sequences], modify_residual=difference, n_threads=1, resample_true=False
    )
    parameters, free = package.ParameterDict(), []
    for effect, own in _parameters(model):
        parameters.add(own)
        free.append(effect)
    with contextlib.redirect_stdout(io.StringIO()):  # it reports every iteration
        fitted, outcome = package.optimize(
            parameters.copy().move_off_bounds(fraction=0.02), residual,
            optimizer="scipy_parallel_fd", verbose=False, max_iters=ITERATIONS, x_scale="jac",
            diff_step=1e-5,
        )  # fmt: skip
    rest = np.concatenate([np.ravel(part) for part in residual(fitted.as_vector(), fitted)[0]])
    jacobian = np.asarray(outcome.jac)
    information = jacobian.T @ jacobian
    spread = np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-10)) * np.mean(rest**2))
    effects = []
    for own, value, width in zip(free, fitted.as_vector(), spread, strict=True):
        change = float(value) - own.nominal
        least = TOLERANCE * (0.1 if own.kind == "link_com" else abs(own.nominal))
        if own.kind in ("viscous_friction", "coulomb_friction", "rotor_inertia") and change < 0:
            continue
        if abs(change) - 1.96 * width > least:
            effects.append(_effect(own.kind, own.where, {own.name: (own.neutral + change, width)}))
    loud = float(np.sqrt(np.mean(rest**2)))
    verdict = "named" if effects else "no_gap" if loud < 1.5 else "unexplained"
    return result_of(verdict, effects)
