"""Runs of a recording, joined from channels of different files, rates and shifted clocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.importing.mapping import ColumnEntry, RunPlan
from loose_env.importing.resampling import bridged, held, median_step, resampled, rows_of
from loose_env.importing.samples import ChannelKey, Samples
from loose_env.importing.units import UNITS, column_quantity, unit_named
from loose_env.recording import (
    FEWEST_SAMPLES,
    MOST_MISSING,
    MOST_VALUES,
    CommandTiming,
    ModelColumns,
    Run,
    joint_sensors,
)
from loose_env.typing import Array

Pool = Mapping[tuple[str, Path, ChannelKey], Samples]
"""Samples by source, file and channel."""

_PREFIX = {"ctrl": "controls", "sensor": "sensors", "torque": "torques"}


@dataclass(frozen=True, kw_only=True)
class Joined:
    """A run, and the log of its processing."""

    run: Run
    lines: tuple[str, ...]


def joined_run(
    plan: RunPlan,
    files: Mapping[str, Path],
    pool: Pool,
    model: mujoco.MjModel,
) -> Joined:
    """Join a run."""
    columns = [
        _Column(entry, pool[entry.source, files[entry.source], entry.key], model)
        for entry in plan.columns
    ]
    origin = min(column.samples.origin_ns for column in columns)
    for column in columns:
        column.place_in_time(origin)
    start, stop = _ends(plan, columns, origin)
    lead = min(columns, key=lambda c: (c.entry.way == "hold", c.step))
    rows = _rows(plan, lead, start, stop, len(columns))
    table: dict[str, Array] = {}
    lines = []
    for column in columns:
        values, how = column.at(rows)
        missing = int(np.count_nonzero(np.isnan(values)))
        if missing > MOST_MISSING * len(rows):
            first = rows[int(np.flatnonzero(np.isnan(values))[0])] - rows[0]
            raise InvalidData(
                f"{plan.place}: column {column.entry.column!r}, from {column.samples.place}: "
                f"{missing / len(rows):.0%} of {len(rows)} rows have no sample, the first "
                f"{first:.3f} s after the start; a column may miss {100 * MOST_MISSING:g} %. Cut "
                "the run by start and stop; or, where pauses belong to the channel, set its gap_s "
                f"(now {column.longest:.4g})"
            )
        table[column.entry.column] = values
        note = f", {missing} missing" if missing else ""
        note += f", unwrapped at {column.entry.period:g}" if column.entry.period else ""
        lines.append(f"  {column.entry.column}: {how}{note}")
    ModelColumns.of(model).check_header(plan.place, ["time", *table])
    groups = ModelColumns.of(model).grouped(table)
    run = Run(
        name=plan.file,
        time=rows - rows[0],
        controls=groups["controls"],
        sensors=groups["sensors"],
        torques=groups["torques"],
        excited=plan.excited,
        pose=_pose(plan, model, groups["sensors"]),
        condition=plan.condition,
        commands={
            each.column[5:]: CommandTiming(mode="linear")
            for each in plan.columns
            if each.column.startswith("ctrl.") and each.method == "band"
        },
    )
    seconds = run.time[-1]
    rate = 1 / median_step(run.time)
    first_line = f"{plan.file}: {len(rows)} rows, {seconds:.3f} s at {rate:.6g} Hz"
    return Joined(run=run, lines=(first_line, *lines))


class _Column:
    """One column on its way: in SI units, on the clock of the run."""

    def __init__(
        self,
        entry: ColumnEntry,
        samples: Samples,
        model: mujoco.MjModel,
    ) -> None:
        self.entry, self.samples = entry, samples
        values = decoded(samples.values, entry.period, entry.sign_bit)
        self.values = values * _factor(entry, samples, model) + entry.offset
        if not np.isfinite(self.values).all():
            raise InvalidData(f"{entry.place}: scaled, its values are too large for a number")
        self.longest = bridged(samples.time, entry.gap_s)
        self.step = samples.step
        self.time = samples.time

    def place_in_time(self, origin_ns: int) -> None:
        self.time = self.samples.since(origin_ns) - self.entry.delay_s

    @property
    def last(self) -> float:
        """Last time that it speaks of; a command stands until the next."""
        return float(self.time[-1]) + (self.longest if self.entry.way == "hold" else 0.0)

    def at(self, rows: Array) -> tuple[Array, str]:
        """Values at the rows, and what was done."""
        if self.entry.way == "hold":
            return held(self.time, self.values, rows, self.longest), "last value held"
        return resampled(self.time, self.values, rows, self.longest)


def decoded(values: Array, period: float | None, sign_bit: int | None) -> Array:
    """Values without their wrap-around and without a bit for their sign.

    Examples
    --------
    >>> decoded(np.array([358.0, 359.0, 0.0, 1.0]), 360, None).tolist()
    [-2.0, -1.0, 0.0, 1.0]
    >>> decoded(np.array([32769.0, 2.0]), None, 15).tolist()
    [-1.0, 2.0]
    """
    if sign_bit is not None:
        high = float(2**sign_bit)
        values = np.where(values >= high, high - values, values)
    if period is not None and len(values):
        values = np.unwrap(values, period=period)
        values = values - period * np.round(values[0] / period)
    return values


def _factor(entry: ColumnEntry, samples: Samples, model: mujoco.MjModel) -> float:
    """Factor from the channel's values to SI units."""
    wanted = column_quantity(model, entry.column)
    name = entry.unit or samples.unit
    if not name:
        return entry.sign * entry.scale
    unit = unit_named(name, f"{entry.place}.unit")
    if wanted is not None and unit.quantity != wanted:
        fitting = " ".join(n for n, each in UNITS.items() if each.quantity == wanted)
        told = "" if entry.unit else f" (so says {samples.place})"
        raise InvalidData(
            f"{entry.place}.unit: {name!r}{told} measures {unit.quantity}, and the column holds "
            f"{wanted}: {fitting}. A sensor's sensitivity goes into scale"
        )
    return entry.sign * entry.scale * unit.factor


def _ends(plan: RunPlan, columns: list[_Column], origin: int) -> tuple[float, float]:
    late = max(columns, key=lambda c: float(c.time[0]))
    early = min(columns, key=lambda c: c.last)
    first, last = float(late.time[0]), early.last
    # Commands may end before the readings, but rows end with the readings.
    last = min(last, max(float(c.time[-1]) for c in columns))
    if first >= last:
        raise InvalidData(
            f"{plan.place}: its channels have no time in common: {early.samples.place} ends "
            f"{first - last:.6g} s before {late.samples.place} begins. Where clocks differ, set "
            "offset_s or from_start of a source's time"
        )
    moments = []
    for told, default in ((plan.start, first), (plan.stop, last)):
        if told is None:
            moments.append(default)
        elif isinstance(told, int):  # a date
            moments.append((told - origin) * 1e-9)
        else:
            moments.append(first + told)
    start, stop = moments
    slack = 1e-6
    if start < first - slack or stop > last + slack or start >= stop:
        raise InvalidData(
            f"{plan.place}: from {start - first:.6g} to {stop - first:.6g} s is not within what "
            f"all its channels have, 0 to {last - first:.6g} s ({late.samples.place} begins last, "
            f"{early.samples.place} ends first)"
        )
    return start, stop


def _rows(plan: RunPlan, lead: _Column, start: float, stop: float, columns: int) -> Array:
    most = MOST_VALUES // (columns + 1)
    rows: Array | None
    if plan.rate_hz is None:
        rows = rows_of(lead.time, start, stop, lead.longest, most)
    else:
        count = (stop - start) * plan.rate_hz
        rows = start + np.arange(int(count + 1e-6) + 1) / plan.rate_hz if count < most else None
    if rows is None:
        raise InvalidData(
            f"{plan.place}: more than {most} rows; take a shorter time by start and stop, or a "
            "lower rate_hz"
        )
    if len(rows) < FEWEST_SAMPLES:
        raise InvalidData(
            f"{plan.place}: {len(rows)} rows in {stop - start:.6g} s; a run has at least "
            f"{FEWEST_SAMPLES}"
        )
    return rows


def _pose(
    plan: RunPlan, model: mujoco.MjModel, sensors: Mapping[str, Array]
) -> dict[str, float] | None:
    if plan.pose is None:
        return None
    allowed = ModelColumns.of(model)
    if plan.pose != "measured":
        for joint in plan.pose:
            allowed.check_joint(f"{plan.place}.pose", joint)
        return dict(plan.pose)
    pose = {
        joint: float(np.nanmedian(sensors[name]))
        for joint, each in joint_sensors(model).items()
        for name in each.position[:1]
        if name in sensors
    }
    if not pose:
        raise InvalidData(
            f"{plan.place}.pose is 'measured', and the run has no column of a joint's position"
        )
    return pose
