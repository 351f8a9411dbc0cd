"""Check of accelerometers against gravity in the measured poses: unit, axes, signs of joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import permutations, product
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.doctor.channels import Factors, Machine, filled
from loose_env.doctor.findings import Finding
from loose_env.doctor.model_checks.by_run import judged_runs
from loose_env.doctor.model_checks.motion import Blocks, block_means, block_motion, carried
from loose_env.doctor.model_checks.units import ACCELERATION, named_unit
from loose_env.doctor.settings import DoctorSettings
from loose_env.doctor.thresholds import (
    ALIKE_DEG,
    EXPLAINED_DEG,
    LEAST_BLOCKS,
    LEAST_GRAVITY,
    SCALE_NOTED,
    UNCOUPLED,
    WRONG_AXES_DEG,
)
from loose_env.typing import Array

_ACCELEROMETER = int(mujoco.mjtSensor.mjSENS_ACCELEROMETER)
_AXES = "xyz"


class _Pair(NamedTuple):
    """Measured and implied acceleration by blocks, shape (N, 3) [m/s²]."""

    measured: Array
    implied: Array
    runs: NDArray[np.intp]
    """Number of the run of each block, shape (N,)."""


def check_gravity(
    machine: Machine, blocks: Blocks, factors: Factors, settings: DoctorSettings
) -> Iterator[Finding]:
    """Compare the slow part of every accelerometer with gravity and motion."""
    for sensor in _accelerometers(machine, blocks):
        alone = {run.name: [each] for each in blocks for run in each[:1]}
        for name, some in judged_runs(alone, partial(_unit_alone, machine, sensor)):
            own = [each for part in some for each in part]
            pair = _pair(machine, sensor, own)
            if pair is not None:
                found = _judged(machine, sensor, pair, own, factors, settings)
                yield from (replace(each, run=name) for each in found)


def _unit_alone(machine: Machine, sensor: str, _: str, block: Blocks) -> str | None:
    """Judge the unit of one run: "" for the right one; None where it tells nothing."""
    pair = _pair(machine, sensor, block)
    if pair is None or _size(pair.implied) < LEAST_GRAVITY:
        return None
    ratio = _size(pair.measured) / _size(pair.implied)
    words = _wrong_unit(pair, ratio)
    return "" if words is None and abs(ratio - 1) <= SCALE_NOTED else words


def _wrong_unit(pair: _Pair, ratio: float) -> str | None:
    words = named_unit(ratio, ACCELERATION)
    if ratio < UNCOUPLED and _angle(pair.measured, pair.implied, pair.runs) > WRONG_AXES_DEG:
        return None  # a small mean that does not point along gravity is no acceleration in g
    return words


def _accelerometers(machine: Machine, blocks: Blocks) -> list[str]:
    model = machine.model
    names = dict.fromkeys(name for run, *_ in blocks for name in run.sensors)
    return [n for n in names if int(model.sensor_type[model.sensor(n).id]) == _ACCELEROMETER]


def _pair(machine: Machine, sensor: str, blocks: Blocks) -> _Pair | None:
    measured, implied, runs = [], [], []
    at = int(machine.model.sensor_adr[machine.model.sensor(sensor).id])
    for k, (run, _, motion, rows) in enumerate(blocks):
        if sensor not in run.sensors or not carried(machine, sensor, motion.known):
            continue
        if (np.nanstd(run.sensors[sensor], axis=0) == 0).any():
            continue  # a dead axis is a finding of its own
        columns = np.stack([filled(run.time, c) for c in run.sensors[sensor].T], axis=1)
        measured.append(block_means(columns, rows))
        implied.append(motion.readings[:, at : at + 3])
        runs.append(np.full(len(rows), k))
    if sum(map(len, measured)) < LEAST_BLOCKS:
        return None
    return _Pair(np.concatenate(measured), np.concatenate(implied), np.concatenate(runs))


def _size(values: Array) -> float:
    return float(np.median(np.linalg.norm(values, axis=1)))


def _judged(
    machine: Machine,
    sensor: str,
    pair: _Pair,
    blocks: Blocks,
    factors: Factors,
    settings: DoctorSettings,
) -> Iterator[Finding]:
    expected = _size(pair.implied)
    if expected < LEAST_GRAVITY:
        return  # a model without gravity
    ratio = _size(pair.measured) / expected
    channel = f"sensor.{sensor}"
    words = _wrong_unit(pair, ratio)
    turned = _angle(pair.measured, pair.implied, pair.runs)
    if words is not None:
        yield Finding(
            check="units",
            severity="error",
            channel=channel,
            found=f"reads {ratio * expected:.4g} at rest, and gravity is {expected:.4g} m/s²: "
            f"{words}",
            value=ratio,
            unit="1",
            consequence="the transmission to the tool is wrong by that factor",
            remedy='import the columns with their unit (unit = "g"), or convert them',
        )
    elif ratio < UNCOUPLED:
        yield Finding(
            check="gravity",
            severity="note",
            channel=channel,
            found=f"its mean is {ratio * expected:.3g} m/s², and gravity is {expected:.4g} m/s²: "
            "piezoelectric, or the mean was removed",
            value=ratio * expected,
            unit="m/s²",
            consequence="its axes cannot be checked against gravity",
            remedy="none is needed for vibration; check axes and signs by hand",
        )
        return
    elif abs(ratio - 1) > SCALE_NOTED:
        yield Finding(
            check="gravity",
            severity="warning",
            channel=channel,
            found=f"reads {ratio * expected:.4g} m/s² at rest, and gravity is {expected:.4g} m/s²",
            value=ratio * expected,
            unit="m/s²",
            consequence="sensitivity or offset of the sensor is not the one assumed",
            remedy="correct scale or offset of the column at the import",
        )
    if turned > settings.turned_deg:
        yield _turned(machine, sensor, pair, turned, blocks, factors)


def _angle(measured: Array, implied: Array, runs: NDArray[np.intp]) -> float:
    """Median angle between two sets of vectors in the run where it is largest [deg].

    Axes that are wrong show in some poses alone, and each run holds a pose or moves through many.
    """
    lengths = np.linalg.norm(measured, axis=1) * np.linalg.norm(implied, axis=1)
    cosine = np.einsum("ij,ij->i", measured, implied) / np.maximum(lengths, 1e-12)
    worst = min(float(np.median(cosine[runs == k])) for k in np.unique(runs))
    return float(np.degrees(np.arccos(np.clip(worst, -1.0, 1.0))))


def _turned(
    machine: Machine,
    sensor: str,
    pair: _Pair,
    turned: float,
    blocks: Blocks,
    factors: Factors,
) -> Finding:
    """Finding for gravity in a wrong direction, with what would explain it."""
    reasons = [*_by_axes(pair), *_by_joints(machine, sensor, pair, blocks, factors)]
    reasons = sorted(r for r in reasons if r[0] <= EXPLAINED_DEG)
    alike = [words for angle, words in reasons if angle <= reasons[0][0] + ALIKE_DEG][:3]
    explained = f"; explained by {' or by '.join(alike)}" if alike else ""
    return Finding(
        check="axes",
        severity="error" if turned > WRONG_AXES_DEG else "warning",
        channel=f"sensor.{sensor}",
        found=f"gravity is {turned:.0f} degrees from where the model has it in the measured poses"
        f"{explained}",
        value=turned,
        unit="deg",
        consequence="axes or poses are not those of the model, and directions found are wrong",
        remedy="exchange channels or set sign = -1 at the import, turn the sensor's site in the "
        "model, or correct the zero of the encoders",
    )


def _by_axes(pair: _Pair) -> Iterator[tuple[float, str]]:
    """Angles left with axes exchanged or reversed, the fewest changes first."""
    ways = []
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            changes = sum(o != i for i, o in enumerate(order)) + signs.count(-1)
            left = _angle(pair.measured[:, order] * np.array(signs), pair.implied, pair.runs)
            ways.append((changes, left, order, signs))
    ways = [way for way in ways if way[0] > 0 and way[1] <= EXPLAINED_DEG]
    fewest = min((way[0] for way in ways), default=0)
    for changes, left, order, signs in ways:
        if changes == fewest:
            words = [
                f"{_AXES[i]} = {'-' if s < 0 else ''}{_AXES[o]} of the recording"
                for i, (o, s) in enumerate(zip(order, signs, strict=True))
                if o != i or s < 0
            ]
            yield left, "axes " + ", ".join(words)


def _by_joints(
    machine: Machine,
    sensor: str,
    pair: _Pair,
    blocks: Blocks,
    factors: Factors,
) -> Iterator[tuple[float, str]]:
    """Angles left with the encoder of one joint reversed."""
    for joint in machine.joints:
        other = _pair(machine, sensor, _reversed(machine, joint, blocks, factors))
        if other is not None and len(other.measured) == len(pair.measured):
            moved = _angle(other.implied, pair.implied, pair.runs)
            if moved > EXPLAINED_DEG:
                yield (
                    _angle(other.measured, other.implied, other.runs),
                    f"the opposite sign of joint {joint}'s encoder",
                )


def _reversed(machine: Machine, joint: str, blocks: Blocks, factors: Factors) -> Blocks:
    found = []
    for run, channels, _, _ in blocks:
        made = block_motion(
            machine,
            run,
            channels,
            {**factors, (run.name, joint): -factors.get((run.name, joint), 1.0)},
        )
        if made is not None:
            found.append((run, channels, *made))
    return found
