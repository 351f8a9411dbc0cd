"""Tests of initial rest: whether a measured joint stays at rest, and the model settles there.

An arm at rest under its first command has been so before: springs are in equilibrium. The model is
therefore settled under that command before a run that begins at rest. An arm set in motion by its
first command, or by an unopposed torque, must not be settled: it would drift away.
"""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.gap.data.actuator_states import steady_activations
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.statistics import noise_floor, resolution_of
from loose_env.typing import Array

SETTLE = 0.4
"""How long an arm at rest is held before the start, so that springs take their load [s]."""
_REST_WINDOW_S = 0.3
"""How much of a command that is held tells whether the arm stays under it [s]."""
_LEAST = 9
"""Samples below which it is not told."""
_LATE_RATIO = 4
"""Times `SETTLE` after which a model that comes to rest is about where it was after `SETTLE`."""
_DRIFT_RATIO = 1.5
"""How many times as far away it is then, if it does not."""
_NEGLIGIBLE_DRIFT = 1e-3
"""Way that is no matter [rad, m]."""


def stays(time: Array, values: Array, controls: Array) -> bool:
    """Return whether a joint stays at rest while the first commands are held.

    Examples
    --------
    >>> time = np.arange(300) / 1000
    >>> read = np.random.default_rng(1).normal(0, 1e-4, 300)
    >>> stays(time, read, np.ones((300, 1))), stays(time, read + time**2, np.ones((300, 1)))
    (True, False)
    """
    changed = np.flatnonzero((controls != controls[0]).any(axis=1))
    count = min(
        len(time) if not len(changed) else int(changed[0]), np.searchsorted(time, _REST_WINDOW_S)
    )
    good = values[:count][np.isfinite(values[:count])]
    if len(good) < _LEAST:
        return True
    third = len(good) // 3
    moved = abs(float(np.mean(good[-third:]) - np.mean(good[:third])))
    chance = 4.0 * noise_floor(values) * float(np.sqrt(2.0 / third))
    return moved <= max(chance, 1.5 * resolution_of(values))


def comes_to_rest(machine: NominalModel, position: Array, commands: Array) -> bool:
    """Return whether the nominal model, released at rest in a pose, settles nearby.

    A servo moves to where it carries its load; an unopposed torque accelerates without bound.
    """
    model = machine.model
    data = mujoco.MjData(model)
    at = [model.joint(name) for name in machine.joints]
    data.qpos[[int(j.qposadr[0]) for j in at]] = position
    data.ctrl[: len(commands)] = commands
    data.act[:] = steady_activations(model, data.ctrl, float(model.opt.timestep))
    start = data.qpos.copy()
    count = round(SETTLE / model.opt.timestep)
    way = np.empty((_LATE_RATIO * count, len(start)))
    for k in range(len(way)):
        mujoco.mj_step(model, data)
        way[k] = data.qpos - start
    last = max(count // 4, 1)  # mean over an interval, as a servo may oscillate
    soon = np.abs(np.mean(way[count - last : count], axis=0))
    later = np.abs(np.mean(way[-last:], axis=0))
    return bool(np.all((later <= _DRIFT_RATIO * soon) | (later < _NEGLIGIBLE_DRIFT)))
