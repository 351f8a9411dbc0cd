"""Activations of actuators with internal dynamics by step, from commands, or at steady state."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.typing import Array

_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
_RUNGE_KUTTA = int(mujoco.mjtIntegrator.mjINT_RK4)
_SHORTEST = 1e-15  # MuJoCo's lower bound of a time constant [s]


def activations(model: mujoco.MjModel, controls: Array, step: float) -> Array | None:
    """Compute the activation of every actuator that has one, by simulation step.

    The first command is assumed to have been held before the run, with filters at steady state. The
    state of an integrator depends on its unknown initial value; muscles and others depend on more
    than their commands.

    Examples
    --------
    >>> model = mujoco.MjModel.from_xml_string(
    ...     "<mujoco><worldbody><body><joint name='j'/><geom size='.1'/></body></worldbody>"
    ...     "<actuator><general joint='j' dyntype='filterexact' dynprm='.02'/></actuator></mujoco>"
    ... )
    >>> activations(model, np.array([[0.0], [1.0], [1.0]]), 0.02).ravel().round(3).tolist()
    [0.0, 0.0, 0.632]
    """
    found = np.zeros((len(controls), model.na))
    for k in np.flatnonzero(model.actuator_actnum):
        if int(model.actuator_dyntype[k]) not in _FILTERS or model.actuator_actnum[k] != 1:
            return None
        command = controls[:, k] if k < controls.shape[1] else np.zeros(len(controls))
        found[:, model.actuator_actadr[k]] = _filtered(model, int(k), command, step)
    return found


def steady_activations(model: mujoco.MjModel, command: Array, step: float) -> Array:
    """Activations (model.na,) of filters at steady state under a command (actuators,).

    Zero, as MuJoCo starts, where the state does not follow from the command.
    """
    found = activations(model, command[None], step)
    return np.zeros(model.na) if found is None else np.asarray(found[0])


def _filtered(model: mujoco.MjModel, number: int, command: Array, step: float) -> list[float]:
    """Mean activation of a first-order filter in each step, as MuJoCo integrates it.

    Runge-Kutta substeps let the activation move within a step; other integrators hold it.
    """
    if model.actuator_ctrllimited[number]:
        command = np.clip(command, *model.actuator_ctrlrange[number])
    low, high = -np.inf, np.inf
    if model.actuator_actlimited[number]:
        low, high = model.actuator_actrange[number]
    lag = max(float(model.actuator_dynprm[number, 0]), _SHORTEST)
    exact, moving = -float(np.expm1(-step / lag)), int(model.opt.integrator) == _RUNGE_KUTTA
    plain = int(model.actuator_dyntype[number]) == _FILTERS[0]
    # Gain of one integration step on a rate, and the correction to the exact filter.
    share = exact if moving else step / lag
    if not plain:
        share *= exact * lag / step
    now, found = min(max(float(command[0]), low), high), []
    for wanted in command.tolist():
        after = min(max(now + share * (wanted - now), low), high)
        found.append((now + after) / 2 if moving else now)
        now = after
    return found
