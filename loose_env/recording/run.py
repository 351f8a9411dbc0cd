"""`Run`, one measured run: commanded and measured columns over time, and its table for a file.

`CommandTiming` is the one place that says what a command does between its samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray
from pydantic import ConfigDict

from loose_env.errors import InvalidData
from loose_env.typing import Array

Condition = Literal["suspect", "healthy"]
"""Whether the arm was as it is judged, or is known to have been healthy."""

Comparison = Literal["forward", "inverse", "free"]
"""How a run is compared with a model.

``"forward"``: the controls are given to the model and its sensors compared. ``"inverse"``: the
torque that the model needs for the measured motion is compared with the torque measured.
``"free"``: the model is let go from the measured initial state.
"""


@dataclass(frozen=True, kw_only=True)
class CommandTiming:
    """Course of a command between its samples, and the time at which it acts.

    Examples
    --------
    >>> time, values = np.arange(3.0), np.array([0.0, 1.0, 1.0])
    >>> CommandTiming().acting(time, values, time[:2] + 0.5).tolist()
    [0.0, 1.0]
    >>> CommandTiming(mode="linear", shift_s=-0.25).acting(time, values, time[:2] + 0.5).tolist()
    [0.75, 1.0]
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    mode: Literal["held", "linear"] = "held"
    """"held" until the next sample, or along straight lines from sample to sample."""
    shift_s: Annotated[float, Ge(-1.0), Le(1.0)] = 0.0
    """Time at which a sample acts after its stamp, negative where it acts before [s]."""

    def acting(self, time: Array, values: Array, at: Array) -> Array:
        """Command at some times (N,) by samples (T,); a missing one is as the last before it."""
        values, at = last_known(values), at - self.shift_s
        if self.mode == "linear":
            return np.asarray(np.interp(at, time, values))
        return np.asarray(values[np.maximum(np.searchsorted(time, at, side="right") - 1, 0)])

    def response(self, turn: Array, step: float) -> NDArray[np.complex128]:
        """Acting command over its samples, at angular frequencies (F,), by their step [s]."""
        share = np.sinc(turn * step / (2 * np.pi))
        shape = share**2 if self.mode == "linear" else share
        return np.asarray(shape * np.exp(-1j * turn * self.delay(step)))

    def delay(self, step: float) -> float:
        """Mean time by which the command acts after its samples, by their step [s]."""
        return self.shift_s + (0.0 if self.mode == "linear" else 0.5 * step)


def last_known(values: Array) -> Array:
    """Commands with each missing one as the last before it: a drive keeps its set point.

    Those at the start take the first one; zeros where none is known.
    """
    known = np.flatnonzero(np.isfinite(values))
    if len(known) == len(values):
        return values
    if not len(known):
        return np.zeros_like(values)
    at = np.clip(np.searchsorted(known, np.arange(len(values)), "right") - 1, 0, None)
    return np.asarray(values[known[at]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One run of a recording, in SI units; a missing sample is NaN.

    Arrays are taken over as float64 that cannot be written to, mappings as dictionaries.

    Raises
    ------
    InvalidData
        If a column has not one value a sample, or the condition is none of the two.

    Examples
    --------
    >>> time = np.arange(10) / 100
    >>> run = Run(name="run-01.parquet", time=time, sensors={"encoder": np.sin(time)})
    >>> run.samples, run.comparison
    (10, 'free')
    """

    name: str
    """File of the run, from the recording's folder."""
    time: Array
    """Times of the samples [s], shape (T,)."""
    controls: Mapping[str, Array] = field(default_factory=dict)
    """Input of each actuator, in its own unit, shape (T,)."""
    sensors: Mapping[str, Array] = field(default_factory=dict)
    """Reading of each sensor, in its own unit, shape (T,), or (T, 3) of a 3-vector."""
    torques: Mapping[str, Array] = field(default_factory=dict)
    """Measured torque of each joint [N·m, or N where it slides], shape (T,)."""
    excited: tuple[str, ...] = ()
    """Joints driven with random noise."""
    pose: Mapping[str, float] | None = None
    """Joint positions held in this run [rad or m], where that was noted."""
    condition: Condition = "suspect"
    """``"healthy"`` where the run is a reference taken before the fault."""
    commands: Mapping[str, CommandTiming] = field(default_factory=dict)
    """Timing of each command; one that is not there is held from sample to sample."""

    def __post_init__(self) -> None:
        if self.condition not in get_args(Condition):
            raise InvalidData(
                f"{self.name}: condition is {self.condition!r}; it is one of "
                f"{list(get_args(Condition))}"
            )
        time = _taken(self.name, "time", self.time)
        if time.ndim != 1:
            raise InvalidData(f"{self.name}: time has shape (samples,), got {time.shape}")
        object.__setattr__(self, "time", time)
        for group, prefix in (("controls", "ctrl"), ("sensors", "sensor"), ("torques", "torque")):
            columns = {}
            for name, values in getattr(self, group).items():
                column = _taken(self.name, f"{prefix}.{name}", values)
                allowed = [time.shape] + [(len(time), 3)] * (group == "sensors")
                if column.shape not in allowed:
                    raise InvalidData(
                        f"{self.name}: column '{prefix}.{name}' has shape {column.shape}; with "
                        f"{len(time)} samples it is {' or '.join(map(str, allowed))}"
                    )
                columns[name] = column
            object.__setattr__(self, group, columns)
        object.__setattr__(self, "excited", tuple(self.excited))
        if self.pose is not None:
            object.__setattr__(self, "pose", {j: float(q) for j, q in self.pose.items()})

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.time)

    def timing(self, actuator: str) -> CommandTiming:
        """How the command of an actuator acts."""
        return self.commands.get(actuator, CommandTiming())

    def part(self, rows: slice) -> Run:
        """Run of some of the rows.

        Parameters
        ----------
        rows : slice
            Samples to keep.

        Examples
        --------
        >>> run = Run(name="run", time=np.arange(10.0), sensors={"q": np.zeros(10)})
        >>> run.part(slice(3, 9)).samples
        6
        """

        def cut(columns: Mapping[str, Array]) -> dict[str, Array]:
            return {name: values[rows] for name, values in columns.items()}

        return replace(
            self,
            time=self.time[rows],
            controls=cut(self.controls),
            sensors=cut(self.sensors),
            torques=cut(self.torques),
        )

    @property
    def comparison(self) -> Comparison:
        """How the run is compared with a model; its columns decide."""
        if self.controls:
            return "forward"
        return "inverse" if self.torques else "free"


def table_of(run: Run) -> dict[str, Array]:
    """Columns of a run by their names in a file, for `write_csv` and `write_parquet`.

    Examples
    --------
    >>> run = Run(name="run", time=np.arange(3.0), sensors={"tip": np.zeros((3, 3))})
    >>> list(table_of(run))
    ['time', 'sensor.tip.x', 'sensor.tip.y', 'sensor.tip.z']
    """
    columns = {"time": run.time}
    columns |= {f"ctrl.{name}": values for name, values in run.controls.items()}
    for name, values in run.sensors.items():
        if values.ndim == 1:
            columns[f"sensor.{name}"] = values
        else:
            columns |= {f"sensor.{name}.{a}": values[:, i] for i, a in enumerate("xyz")}
    return columns | {f"torque.{name}": values for name, values in run.torques.items()}


def _taken(run: str, column: str, values: object) -> Array:
    try:
        array = np.asarray(values, dtype=np.float64).view()
    except (TypeError, ValueError):
        raise InvalidData(f"{run}: column {column!r} does not hold numbers alone") from None
    array.flags.writeable = False
    return array
