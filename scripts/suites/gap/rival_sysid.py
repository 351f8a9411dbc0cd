"""`mujoco.sysid` with all parameters free as a tool of the suite."""

from __future__ import annotations

import contextlib
import dataclasses
import io
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from loose_env.gap import NamedEffect
from loose_env.recording import Recording, read_recording
from loose_env.typing import Array
from scripts.suites.gap.rival_data import (
    Finding,
    JointRun,
    joint_runs,
    noise_replicas,
    write_finding,
)


@dataclass(frozen=True, kw_only=True)
class SysidSettings:
    """Settings of the windows, bounds and the optimiser."""

    windows: int = 3
    """Windows of each run."""
    window_s: float = 0.4
    """Length of a window [s]: several time constants of a servo."""
    torque_window_s: float = 0.15
    """The same where torques drive the model [s]: nothing calls it back, and errors grow."""
    stride: int = 5
    """Samples from one residual to the next."""
    off_bound: float = 0.02
    """Share of its range by which a parameter on a bound starts off it."""
    difference: float = 1e-5
    """Step of finite differences, in the parameters' units: the solver of dry friction stops at
    1e-8, which a smaller step would see."""
    iterations: int = 6
    """Iterations of the optimiser."""
    scale_bounds: tuple[float, float] = (0.2, 4.0)
    """Bounds of masses, armatures and gains over their nominal values."""
    centre_bound_m: float = 0.15
    """Bound of a centre of mass about its nominal place [m]."""
    torque_share: float = 0.2
    """Bound of dry friction, and of damping at one unit of speed, over the largest torque used."""
    confidence: float = 0.95
    """Of the intervals."""
    seed: int = 0
    """Seed of the noise replica by which the noise of the residual is measured."""


@dataclass(frozen=True, kw_only=True)
class Value:
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
    """What the package works on."""

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    runs: tuple[JointRun, ...]
    inputs: tuple[Array, ...]
    """Controls of each run, of shape (T, m)."""
    noise: Array
    """Noise of positions, then of velocities, of shape (2 n,)."""
    measured: bool
    """Whether the inputs are measured torques."""
    servo: bool
    """Whether the inputs are commands."""


def package() -> Any:
    """The package, which ships types of its own that are no part of MuJoCo's."""
    return import_module("mujoco.sysid")


def parameters_of(ready: Prepared, tolerance: float, settings: SysidSettings) -> tuple[Any, Any]:
    """Decision variables and what each stands for, in the same order."""
    sysid = package()
    found, values = sysid.ParameterDict(), []
    model, (low, high) = ready.model, settings.scale_bounds

    def add(
        name: str,
        nominal: float,
        bounds: tuple[float, float],
        write: Callable[[mujoco.MjSpec, float], None],
        value: Value | None,
    ) -> None:
        def modifier(spec: mujoco.MjSpec, own: Any) -> None:
            write(spec, float(own.value[0]))

        found.add(sysid.Parameter(name, nominal, *bounds, modifier=modifier))
        values.append(value)

    largest = np.max([np.abs(run.torque).max(axis=0) for run in ready.runs], axis=0)
    weight = np.abs(model.body_mass.sum() * 9.81 * 0.1)
    for j in range(model.njnt):
        name, dof = model.joint(j).name, int(model.jnt_dofadr[j])
        damping, armature = float(model.dof_damping[dof]), float(model.dof_armature[dof])
        most = settings.torque_share * max(float(largest[dof]), 0.1 * weight)

        def damp(spec: mujoco.MjSpec, value: float, name: str = name) -> None:
            spec.joint(name).damping = value

        def rub(spec: mujoco.MjSpec, value: float, name: str = name) -> None:
            spec.joint(name).frictionloss = value

        def load(spec: mujoco.MjSpec, value: float, name: str = name) -> None:
            spec.joint(name).armature = value

        add(
            f"{name}_damping", damping, (0.0, damping + most), _array(damp),
            _scalar("viscous_friction", name, "damping", damping, tolerance * damping),
        )  # fmt: skip
        add(
            f"{name}_frictionloss", 0.0, (0.0, most), rub,
            _scalar("coulomb_friction", name, "torque", 0.0, 0.0),
        )  # fmt: skip
        add(
            f"{name}_armature", armature, (low * armature, high * armature + 1e-6), load,
            _scalar("rotor_inertia", name, "inertia", armature, tolerance * armature),
        )  # fmt: skip
    if ready.measured or ready.model.actuator_biasprm.any():
        _add_gains(add, ready, tolerance, settings)
    for b in range(1, model.nbody):
        if model.body_mass[b] <= 0 or not model.body_dofnum[b]:
            continue
        own = sysid.body_inertia_param(
            ready.spec, model, model.body(b).name,
            inertia_type=sysid.InertiaType.MassIpos,
            scale_rot_inertia=True,
            mass_bound_mult=np.array([low, high]),
            ipos_bound_off=np.array([-settings.centre_bound_m, settings.centre_bound_m]),
        )  # fmt: skip
        found.add(own)
        values.append(
            Value(
                kind="link", where=model.body(b).name, names=("mass", "x", "y", "z"),
                offset=own.nominal.copy(),
                allowed=np.array([tolerance * float(own.nominal[0]), 0.0, 0.0, 0.0]),
            )
        )  # fmt: skip
    return found, values


def _array(
    write: Callable[[mujoco.MjSpec, float], None],
) -> Callable[[mujoco.MjSpec, float], None]:
    """Writer of a number, or of the polynomial that newer versions have in its place."""

    def either(spec: mujoco.MjSpec, value: float) -> None:
        try:
            write(spec, value)
        except TypeError:
            write(spec, np.array([value, 0.0, 0.0]))  # type: ignore[arg-type]

    return either


def _scalar(kind: str, where: str, name: str, offset: float, allowed: float) -> Value:
    return Value(
        kind=kind, where=where, names=(name,), offset=np.array([offset]),
        allowed=np.array([allowed]),
    )  # fmt: skip


def _add_gains(
    add: Callable[..., None], ready: Prepared, tolerance: float, settings: SysidSettings
) -> None:
    """Gain of each actuator, and the ratio of its velocity gain to its position gain."""
    sysid = package()
    for i in range(ready.model.nu):
        name = ready.model.actuator(i).name
        kp, kv = -ready.model.actuator_biasprm[i, 1], -ready.model.actuator_biasprm[i, 2]
        servo = bool(kp)

        def amplify(
            spec: mujoco.MjSpec, value: float, name: str = name, kp: float = kp, kv: float = kv
        ) -> None:
            if not kp:
                spec.actuator(name).gainprm[0] = value
                return
            sysid.apply_pdgain(spec, name, value * np.array([kp, kv]))

        def share(spec: mujoco.MjSpec, value: float, name: str = name) -> None:
            actuator = spec.actuator(name)
            actuator.biasprm[2] = value * actuator.biasprm[2]

        where = name if servo else name.removeprefix("torque_")
        kind, word = ("actuator_gain", "gain") if servo else ("torque_constant", "factor")
        add(
            f"{name}_gain", 1.0, settings.scale_bounds, amplify,
            _scalar(kind, where, word, 0.0, tolerance),
        )  # fmt: skip
        if servo:
            # written after the gain: parameters are applied in their order
            add(f"{name}_{PRIOR}", 1.0, (0.7, 1.4), share, None)


PRIOR = "velocity_ratio"
"""Ending of the parameters that have the tolerance as a prior."""


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
            told = _told(kind, value.names[part], change[part], own[part])
            effects.append(
                NamedEffect(
                    kind=kind,
                    where=value.where,
                    parameters={k: m for k, (m, _, _) in told.items()},
                    interval_95={k: (a, b) for k, (_, a, b) in told.items() if np.isfinite(b - a)},
                    in_model=False,
                )
            )
    return effects


def _told(
    kind: str, names: tuple[str, ...], values: Array, half: Array
) -> dict[str, tuple[float, float, float]]:
    """Value and ends of the interval of each parameter."""
    found = {}
    for name, value, own in zip(names, values, half, strict=True):
        low, high = float(value - own), float(value + own)
        if kind == "torque_constant":  # measured over true torque
            ends = sorted(1.0 / max(end, 1e-3) for end in (low, high))
            found[name] = (1.0 / float(value), *ends)
        else:
            found[name] = (float(value), low, high)
    return found  # type: ignore[return-value]


def run_sysid(recording: Path, folder: Path, tolerance: float) -> None:
    """Fit all parameters of a recording's model and write the result."""
    settings = SysidSettings()
    rng = np.random.default_rng(settings.seed)
    ready = _prepared(read_recording(recording), settings, rng)
    parameters, values = parameters_of(ready, tolerance, settings)
    training = tuple(range(max(1, len(ready.runs) - 1)))
    residual = _residual(ready, training, tolerance, settings)
    within = _fitted(_within(parameters, values, tolerance), residual, settings)[0]
    # dry friction starts on its bound, where the optimiser would stall
    started = parameters.copy().move_off_bounds(fraction=settings.off_bound)
    fitted, jacobian = _fitted(started, residual, settings)
    rest = residual(fitted.as_vector(), fitted.copy())[0]
    half = _half_widths(rest, jacobian, settings)
    held_out = _residual(ready, (len(ready.runs) - 1,), tolerance, settings)

    def left(own: Any) -> float:
        windows = held_out(own.as_vector(), own.copy())[0][:-1]  # without the prior
        return float(np.sqrt(np.mean(np.concatenate(windows) ** 2)))

    write_finding(
        folder,
        Finding(
            method="sysid",
            before=left(within),
            after=left(fitted),
            held_out=ready.runs[-1].name,
            effects=named(fitted, values, half),
            settings={"tolerance": tolerance, **dataclasses.asdict(settings)},
        ),
    )


def _fitted(parameters: Any, residual: Any, settings: SysidSettings) -> tuple[Any, Array]:
    """Parameters after the optimiser, and the Jacobian there."""
    sysid = package()
    with contextlib.redirect_stdout(io.StringIO()):  # it reports every iteration
        fitted, outcome = sysid.optimize(
            parameters, residual, optimizer="scipy_parallel_fd", verbose=False,
            max_iters=settings.iterations, x_scale="jac", diff_step=settings.difference,
        )  # fmt: skip
    return fitted, np.asarray(outcome.jac)


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


_HAIR = 1e-6
"""Half width of bounds that leave no room, in the parameter's unit: the optimiser wants some."""


def _residual(
    ready: Prepared, runs: tuple[int, ...], tolerance: float, settings: SysidSettings
) -> Callable[..., Any]:
    """Residual function of some runs, the rows of the prior last."""
    sysid = package()
    return _with_prior(
        sysid.build_residual_fn(
            models_sequences=[_sequences(ready, runs, settings)],
            modify_residual=_difference(ready, settings),
            n_threads=1,
            resample_true=False,
        ),
        tolerance,
    )


def _prepared(recording: Recording, settings: SysidSettings, rng: np.random.Generator) -> Prepared:
    """Model at the samples' step and inputs of each run."""
    runs = joint_runs(recording)
    spec = recording.spec()
    first = recording.runs[0]
    if first.comparison != "forward":
        names = list(recording.joint_sensors())
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
        for name in recording.joint_sensors():
            spec.add_sensor(
                name=f"{name}_{kind}", type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name
            )
    spec.option.timestep = 1.0 / runs[0].low_pass.rate_hz
    model = spec.compile()
    ready = Prepared(
        spec=spec,
        model=model,
        runs=runs,
        inputs=_inputs(recording, runs, model),
        noise=np.ones(2 * model.nv),
        measured=first.comparison == "inverse",
        servo=first.comparison == "forward",
    )
    replicas = noise_replicas(recording, runs, rng)
    noisy = dataclasses.replace(ready, runs=replicas, inputs=_inputs(recording, replicas, model))
    return dataclasses.replace(ready, noise=_noise(ready, noisy, settings))


def _inputs(
    recording: Recording, runs: tuple[JointRun, ...], model: mujoco.MjModel
) -> tuple[Array, ...]:
    inputs = []
    for run, own in zip(recording.runs, runs, strict=True):
        if run.comparison == "forward":
            zero = np.zeros(run.samples)
            columns = [
                np.nan_to_num(run.controls.get(model.actuator(i).name, zero))
                for i in range(model.nu)
            ]
            inputs.append(np.stack(columns, axis=1))
        else:
            inputs.append(own.low_pass.smooth(own.torque))
    return tuple(inputs)


def _noise(ready: Prepared, noisy: Prepared, settings: SysidSettings) -> Array:
    """Noise of a residual, of shape (2 n,): what once more as much sensor noise does to it."""
    sysid = package()
    both = []
    for own in (ready, noisy):
        sequences = _sequences(own, tuple(range(len(own.runs))), settings)
        residual = sysid.build_residual_fn(
            models_sequences=[sequences], modify_residual=_difference(own, settings),
            n_threads=1, resample_true=False,
        )  # fmt: skip
        both.append(residual(np.zeros(0), sysid.ParameterDict())[0])
    width = 2 * ready.model.nv
    changes = [(np.ravel(a) - np.ravel(b)).reshape(-1, width) for a, b in zip(*both, strict=True)]
    return np.asarray(np.sqrt(np.mean(np.concatenate(changes) ** 2, axis=0)))


def _with_prior(residual: Callable[..., Any], tolerance: float) -> Callable[..., Any]:
    """Residual function with a row for each parameter that has a prior."""
    # two gains, each off by the tolerance at most, all errors equally likely
    sd = tolerance * np.sqrt(2.0 / 3.0)

    def extended(x: Array, parameters: Any, **options: Any) -> Any:
        residuals, predicted, measured = residual(x, parameters, **options)
        names = parameters.get_non_frozen_parameter_names()
        own = [i for i, name in enumerate(names) if name.endswith(PRIOR)]
        prior = (np.asarray(x)[own] - 1.0) / sd
        return [*residuals, prior], predicted, measured

    return extended


def _sequences(ready: Prepared, runs: tuple[int, ...], settings: SysidSettings) -> Any:
    """Windows of some runs as the package wants them."""
    sysid = package()
    rate = ready.runs[0].low_pass.rate_hz
    seconds = settings.window_s if ready.servo else settings.torque_window_s
    length = round(seconds * rate)
    names, states, controls, readings = [], [], [], []
    for r in runs:
        run = ready.runs[r]
        q, v = run.low_pass.smooth(run.position), run.smooth_velocity()
        margin = min(round(0.1 * rate), len(q) // 8)
        last = len(q) - length - margin
        for k, start in enumerate(np.linspace(margin, last, settings.windows).round().astype(int)):
            part = slice(start, start + length)
            times = np.arange(length) / rate
            names.append(f"{run.name}-{k}")
            states.append(sysid.create_initial_state(ready.model, q[start], v[start]))
            controls.append(
                sysid.TimeSeries.from_control_names(times, ready.inputs[r][part], ready.model)
            )
            data = np.hstack((run.position[part], run.velocity[part]))
            readings.append(sysid.TimeSeries.from_names(times, data, ready.model))
    return sysid.ModelSequences("arm", ready.spec, names, states, controls, readings)


def _difference(ready: Prepared, settings: SysidSettings) -> Callable[..., Any]:
    """Residual in noise standard deviations: the package's own divides by the signal's size."""
    width = 2 * ready.model.nv

    def difference(
        parameters: Any, predicted: Any, measured: Any, model: Any, everything: bool, state: Array
    ) -> Any:
        del parameters, predicted, model, everything
        wanted = measured.data[1:]
        residual = (wanted - state[:, 1 : 1 + width]) / ready.noise
        return residual[:: settings.stride], measured, measured

    return difference


def _half_widths(residuals: list[Array], jacobian: Array, settings: SysidSettings) -> Array:
    """Half widths of the intervals, of shape (parameters,)."""
    sysid = package()
    flat = [np.ravel(part) for part in residuals]
    # a column of zeros would make every interval infinite, and so would columns of unlike sizes
    size = np.linalg.norm(jacobian, axis=0)
    seen = size > _UNSEEN * size.max()
    half = np.full(len(size), np.inf)
    _, own = sysid.calculate_intervals(
        flat,
        jacobian[:, seen] / size[seen],
        alpha=1.0 - settings.confidence,
        lambda_zero_thresh=_SINGULAR,
        v_zero_thresh=_PART,
    )
    half[seen] = own / size[seen]
    return half


_UNSEEN = 1e-9
"""Size of a parameter's column beside the largest one below which data do not depend on it."""
_SINGULAR = 1e-10
"""Eigenvalue over the largest one below which a direction is unknown: differences have an error."""
_PART = 1e-2
"""Part in an unknown direction below which a parameter is known all the same."""
