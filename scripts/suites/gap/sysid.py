"""`mujoco.sysid` with all parameters free, as a tool of the gap suite."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from loose_env.gap import NamedEffect
from loose_env.recording import Recording, read_recording
from loose_env.typing import Array
from scripts.suites.gap.rivals import CONFIDENCE, SEED, JointRun, joint_runs, write_finding

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
    """The effect that a decision variable stands for, and how it is judged."""

    kind: str
    """"" for one that is no effect."""
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

    @property
    def comparison(self) -> str:
        """That of the first run."""
        return self.runs[0].comparison


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
    held_out = _windows(ready, [len(ready.runs) - 1])

    def left(own: Any) -> float:
        return float(np.sqrt(np.mean(np.square(held_out(own.as_vector(), own.copy())[0]))))

    residuals = left(within), left(fitted)
    write_finding(folder, "sysid", residuals, ready.runs[-1].name, effects, tolerance)


def _prepared(recording: Recording) -> Prepared:
    runs, spec, names = joint_runs(recording), recording.spec(), list(recording.joint_sensors())
    if runs[0].comparison != "forward":
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
    # noise of a residual: what once more as much sensor noise does to it
    ready, noisy = (
        Prepared(
            spec=spec, model=model, runs=own, inputs=_inputs(recording, own, model),
            noise=np.ones(2 * model.nv),
        )
        for own in (runs, joint_runs(recording, np.random.default_rng(SEED)))
    )  # fmt: skip
    one, other = (
        np.concatenate(
            _windows(each, range(len(runs)))(np.zeros(0), package().ParameterDict())[0]
        ).reshape(-1, 2 * model.nv)
        for each in (ready, noisy)
    )
    return replace(ready, noise=np.sqrt(np.mean((one - other) ** 2, axis=0)))


def _inputs(recording: Recording, runs: list[JointRun], model: mujoco.MjModel) -> list[Array]:
    names = [model.actuator(i).name for i in range(model.nu)]
    return [
        np.stack([np.nan_to_num(run.controls.get(n, np.zeros(run.samples))) for n in names], axis=1)
        if run.comparison == "forward"
        else own.low_pass.smooth(own.torque)
        for run, own in zip(recording.runs, runs, strict=True)
    ]


def parameters_of(ready: Prepared, tolerance: float) -> tuple[Any, list[Value]]:
    """Decision variables and what each stands for, in the same order."""
    sysid, model, (low, high) = package(), ready.model, SCALES
    found, values = sysid.ParameterDict(), []

    def add(
        name: str, nominal: float, bounds: tuple[float, float],
        write: Callable[[mujoco.MjSpec, float], None], kind: str, where: str, parameter: str,
        *, offset: float = 0.0, allowed: float = 0.0,
    ) -> None:  # fmt: skip
        def modifier(spec: mujoco.MjSpec, own: Any) -> None:
            write(spec, float(own.value[0]))

        found.add(sysid.Parameter(name, nominal, *bounds, modifier=modifier))
        values.append(Value(kind, where, (parameter,), np.array([offset]), np.array([allowed])))

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
                add(f"{name}_gain", 1.0, SCALES, _of_motor(name),
                    "torque_constant", name.removeprefix("torque_"), "factor",
                    allowed=tolerance)  # fmt: skip
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


def _within(parameters: Any, values: list[Value], tolerance: float) -> Any:
    """The same parameters inside the tolerance: friction and centres of mass stay as they are."""
    found = parameters.copy()
    for parameter, value in zip(found.values(), values, strict=True):
        if value.kind == "coulomb_friction":
            parameter.frozen = True
            continue
        # a ratio of two gains is off by both
        nominal = parameter.nominal
        room = (tolerance if value.kind else 2.0 * tolerance) * np.abs(nominal)
        if value.kind == "link":
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
    times = np.arange(length) / rate
    names, states, controls, readings = [], [], [], []
    for run, inputs in ((ready.runs[r], ready.inputs[r]) for r in runs):
        q, v = run.low_pass.smooth(run.position), run.low_pass.smooth(run.velocity)
        read = np.hstack((run.position, run.velocity))
        margin = min(round(0.1 * rate), len(q) // 8)
        last = len(q) - length - margin
        for k, start in enumerate(np.linspace(margin, last, WINDOWS).round().astype(int)):
            part = slice(start, start + length)
            names.append(f"{run.name}-{k}")
            states.append(sysid.create_initial_state(ready.model, q[start], v[start]))
            controls.append(sysid.TimeSeries.from_control_names(times, inputs[part], ready.model))
            readings.append(sysid.TimeSeries.from_names(times, read[part], ready.model))

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


def named(fitted: Any, values: list[Value], half: Array) -> list[NamedEffect]:
    """Effects whose interval excludes all that the tolerance allows."""
    effects, at = [], 0
    for parameter, value in zip(fitted.values(), values, strict=True):
        own = half[at : at + parameter.size]
        at += parameter.size
        change = parameter.as_vector() - value.offset
        departure = np.abs(parameter.as_vector() - parameter.as_nominal_vector())
        beyond = departure - own > value.allowed
        parts = {value.kind: slice(None)} if value.kind else {}
        if value.kind == "link":
            parts = {"link_mass": slice(0, 1), "link_com": slice(1, 4)}
        for kind, part in parts.items():
            if not beyond[part].any():
                continue
            ends = np.stack([change, change - own, change + own])[:, part]
            if kind == "torque_constant":  # measured over true torque
                ends = 1.0 / np.maximum(ends[[0, 2, 1]], 1e-3)
            effects.append(
                NamedEffect(
                    kind=kind,
                    where=value.where,
                    parameters=dict(zip(value.names[part], map(float, ends[0]), strict=True)),
                    interval_95={
                        name: (float(a), float(b))
                        for name, a, b in zip(value.names[part], *ends[1:], strict=True)
                        if np.isfinite(b - a)
                    },
                    in_model=False,
                )
            )
    return effects
