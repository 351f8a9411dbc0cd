"""Clocks of robot and accelerometer that were started apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from loose_env.instrument.arm import PoseModel, SuspectArm
from loose_env.instrument.records import Record, Unusable, read_run
from loose_env.instrument.signals import Multisine
from loose_env.recording import Run
from loose_env.typing import Array, ComplexArray

_HIGHEST_HZ = 19.0
"""Lines above are the gears' more than the clocks' [Hz]."""
_STEP_S = 1e-3
_BETTER = 0.1
"""Share of the tool's motion by which an offset stands out of every other from which a clock is
said to be apart [1]: true offsets do by 0.2 and more, the best of an arm on soft gears by 0.04."""
_HALF = 0.45
"""Largest offset, over the period [1]: half a period turns the signs of all lines, as a mirrored
axis does."""


def read_run_on_one_clock(
    arm: SuspectArm, run: Run, signal: Multisine, *, level: float, corner_hz: float | None,
    sensor: str | None = None,
) -> Record | Unusable:  # fmt: skip
    """Read a run as `read_run`; the accelerometer's clock is set right where it is far apart."""
    record = read_run(arm, run, signal, level=level, corner_hz=corner_hz, sensor=sensor)
    if isinstance(record, Unusable):
        return record
    late = clocks_apart_s(record, arm.at(record.pose, sensor), signal)
    if not late:
        return record
    moved = set_right(run, record.sensor, late)
    again = read_run(arm, moved, signal, level=level, corner_hz=corner_hz, sensor=sensor)
    way = "late" if late > 0 else "early"
    said = f"the accelerometer came {abs(late):.2f} s {way}, by its motion: set right"
    if isinstance(again, Unusable):
        return again
    return replace(again, remarks=(said, *again.remarks))


def clocks_apart_s(record: Record, model: PoseModel, signal: Multisine) -> float:
    """Time by which the tool's readings come late after the joints', modulo a period [s].

    The tool's lines are compared with those of the joints carried along as a rigid body, at the
    best turn of the sensor. 0 where no offset explains clearly more than all others.
    """
    lines = signal.excited[signal.hertz <= _HIGHEST_HZ]
    hertz = lines / signal.period_s
    own, read = record.joints[lines], record.tool[lines]
    told = own @ model.jacobian.T + model.tilt(own, hertz)
    size = np.sqrt((np.abs(told) ** 2).sum() * (np.abs(read) ** 2).sum())
    if not size > 0:
        return 0.0
    steps = int(_HALF * signal.period_s / _STEP_S)
    tried = _STEP_S * np.arange(-steps, steps + 1)
    turns = np.exp(2j * np.pi * hertz * tried[:, None])
    share: Array = _agreement(told, turns, read, model.up, record.gravity) / size
    best = float(tried[share.argmax()])
    half = 0.5 * signal.period_s  # later, odd lines have the other sign: nearly the same in a plane
    apart = np.abs((tried - best + half / 2) % half - half / 2)
    others = share[apart > 0.5 / hertz.max()]
    near = abs(best) <= 0.5 / hertz.max()
    return best if not near and share.max() > others.max() + _BETTER else 0.0


def _agreement(
    told: ComplexArray, turns: ComplexArray, read: ComplexArray, up: Array, gravity: Array
) -> Array:
    """Product of lines told and read at each offset (T,), at the best turn of the sensor.

    Gravity says how the sensor is tilted, so that it may be turned about the vertical alone.
    """
    if not np.any(up):
        u, s, v = np.linalg.svd(np.real(np.einsum("li,tl,lj->tij", told.conj(), turns, read)))
        s[:, 2] *= np.sign(np.linalg.det(u @ v))  # turned, not mirrored
        return np.asarray(s.sum(1))
    upright = [
        Rotation.align_vectors([[0, 0, 1]], own[None])[0].as_matrix() for own in (up, gravity)
    ]
    told, read = told @ upright[0].T, read @ upright[1].T
    m = np.real(np.einsum("li,tl,lj->tij", told.conj(), turns, read))
    level = np.hypot(m[:, 0, 0] + m[:, 1, 1], m[:, 0, 1] - m[:, 1, 0])
    return np.asarray(m[:, 2, 2] + level)


def set_right(run: Run, sensor: str, late_s: float) -> Run:
    """Run whose accelerometer is moved by whole rows; rows without a partner are cut off."""
    rows = round(late_s / float(np.median(np.diff(run.time))))
    count = len(run.time) - abs(rows)
    first = max(-rows, 0)  # row of the joints that is kept first

    def cut(values: Array, start: int) -> Array:
        return values[start : start + count]

    return replace(
        run,
        time=cut(run.time, first),
        controls={n: cut(v, first) for n, v in run.controls.items()},
        torques={n: cut(v, first) for n, v in run.torques.items()},
        sensors={n: cut(v, first + rows if n == sensor else first) for n, v in run.sensors.items()},
    )
