"""Everything fitted by ``mujoco.sysid``: all parameters free at once, named by their intervals.

Damping, dry friction and armature of every joint, gain of every actuator, mass and centre of mass
of every link are decision variables of one nonlinear least-squares problem over rollouts, as that
package documents it; an effect is named where its fitted value leaves the nominal one by more than
the tolerance told and its 95 % interval, from the Jacobian, excludes that. The ratio of an
actuator's velocity gain to its position gain is free with the tolerance as a prior: damping in the
joint and in the drive brake alike. Runs with measured torques are rolled out by motors with these
torques, and their gain is the inverse of the torque sensor's.

Shortened, so that a case ends within about two minutes of one core: rollouts start from low-passed
readings at a few windows of each run in place of whole runs, at the samples' step in place of the
model's, residuals are decimated, the accelerometer is left out, and the optimiser has few
iterations.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from loose_env.recording import Recording, read_recording
from loose_env.typing import Array
from scripts.suites.gap.rivals.joint_data import JointRun, joint_runs, noise_replicas
from scripts.suites.gap.rivals.results import Finding, write_finding
from scripts.suites.gap.rivals.sysid_parameters import (
    PRIOR,
    Prepared,
    SysidSettings,
    Value,
    named,
    package,
    parameters_of,
)

__all__ = ["run_sysid"]


def run_sysid(recording: Path, folder: Path, tolerance: float) -> None:
    """Fit all parameters of a recording's model and write the result.

    Parameters
    ----------
    recording : Path
        Folder of the recording.
    folder : Path
        Folder of the result.
    tolerance : float
        Largest relative error of the nominal parameters.
    """
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
    """Noise of a residual, of shape (2 n,): what once more as much sensor noise does to it.

    It holds the noise of the initial state and of measured torques too, which the model integrates.
    """
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
    """Residual in noise standard deviations: the package's own divides by the signal's size.

    States are compared, not the rollout's sensors, which lag by one step.
    """
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
