"""Corrupt samples: finite values that no sensor read, set aside as missing.

A sample v_k of a channel is corrupt if it is absurd in itself, |v_k| > `LARGEST_VALUE`, or if two
deviations exceed a multiple m of what the channel shows otherwise:

    |v_k - median(v)| > m R   and   |v_k - median(v_{k-3} ... v_{k+3})| > m D

R is the range of the middle 90 % of the samples (where it is below `STANDSTILL`, the size of the
median, at least 1), and D the larger of R and the 99 % quantile of the
deviations from the local median. The second condition keeps motion: the local median follows every
monotone course. m is `MULTIPLE` for positions, which are continuous, and `IMPULSIVE_MULTIPLE` for
quantities that impacts and pulses raise for one sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.recording.run import Run
from loose_env.typing import Array

LARGEST_VALUE = 1e9
"""Magnitude in any SI unit, above which a value is no measurement."""
MULTIPLE = 20.0
"""Deviation of a position over what its channel shows, from which it is corrupt [1]: a joint does
not leave the range of its motion twentyfold and come back within three samples."""
IMPULSIVE_MULTIPLE = 1000.0
"""The same of other quantities [1]: an impact of 500 m/s² on noise of 1 m/s² is no error."""
STANDSTILL = 1e-6
"""Range of a column in any SI unit, below which it stands still and its range tells nothing:
encoders resolve no less."""
MOST_CORRUPT = 0.2
"""Share of corrupt and missing samples of a column, above which it is refused [1]: the format's
share of missing samples."""
_WINDOW = 7
"""Samples of the local median: bursts of up to three stand out."""
_POSITION = int(mujoco.mjtSensor.mjSENS_JOINTPOS)


@dataclass(frozen=True, kw_only=True)
class Corrupt:
    """Corrupt samples of one column."""

    run: str
    """File of the run."""
    column: str
    """Name of the column, axis included."""
    count: int
    """Number of corrupt samples."""
    samples: int
    """Number of samples."""
    first: float
    """Time of the first one [s]."""
    largest: float
    """Largest magnitude, in the column's unit."""
    missing: float
    """Share of the samples that are missing with these set aside [1]."""

    @property
    def too_many(self) -> bool:
        """Whether too little of the column is left."""
        return self.missing > MOST_CORRUPT

    @property
    def found(self) -> str:
        """Count, size and time, without the name of the column."""
        are = "is" if self.count == 1 else "are"
        return (
            f"{self.count} of {self.samples} samples {are} corrupt (up to {self.largest:.3g}, the "
            f"first at {self.first:.4g} s)"
        )

    @property
    def words(self) -> str:
        """One line on them."""
        done = f"{self.missing:.0%} would be missing" if self.too_many else "set aside as missing"
        return f"{self.run}: column '{self.column}': {self.found}: {done}"


def corrupt_mask(values: Array, multiple: float = IMPULSIVE_MULTIPLE) -> NDArray[np.bool_]:
    """Mask of the corrupt samples of a channel.

    Parameters
    ----------
    values : ndarray of shape (T,)
        Samples in the order of time, NaN where one is missing.
    multiple : float
        Deviation over what the channel shows, from which a sample is corrupt [1].

    Returns
    -------
    ndarray of shape (T,)
        True for a corrupt sample.

    Examples
    --------
    >>> swing = np.sin(np.arange(200) / 20)
    >>> swing[[50, 120]] = 1e282, 700.0
    >>> np.flatnonzero(corrupt_mask(swing, MULTIPLE))
    array([ 50, 120])
    """
    absurd = np.abs(values) > LARGEST_VALUE
    good = np.flatnonzero(np.isfinite(values) & ~absurd)
    if len(good) < _WINDOW:
        return absurd
    kept = values[good]
    low, middle, high = np.quantile(kept, (0.05, 0.5, 0.95))
    shown = float(high - low)
    if shown < STANDSTILL:
        shown = max(abs(middle), 1.0)  # a column that stands still shows no range
    far = np.abs(kept - middle) > multiple * shown
    if far.any():
        around = np.pad(kept, _WINDOW // 2, mode="reflect")
        jumps = np.abs(kept - np.median(sliding_window_view(around, _WINDOW), axis=1))
        usual = max(shown, float(np.quantile(jumps, 0.99)))
        absurd[good[far & (jumps > multiple * usual)]] = True
    return absurd


def without_corrupt(run: Run, model: mujoco.MjModel) -> tuple[Run, tuple[Corrupt, ...]]:
    """Replace the corrupt samples of a run by NaN.

    Parameters
    ----------
    run : Run
        The run as read.
    model : mujoco.MjModel
        The model of its recording, which tells positions from other quantities.

    Returns
    -------
    Run
        The run; the same object where nothing is corrupt.
    tuple of Corrupt
        Columns that had corrupt samples, in the order of the run.

    Examples
    --------
    >>> xml = '''<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/></body></worldbody>
    ... <sensor><jointpos name="encoder" joint="turn"/></sensor></mujoco>'''
    >>> angle = np.sin(np.arange(200) / 20)
    >>> angle[7] = 1e282
    >>> run = Run(name="a.csv", time=np.arange(200) / 100, sensors={"encoder": angle})
    >>> print(without_corrupt(run, mujoco.MjModel.from_xml_string(xml))[1][0].words)
    a.csv: column 'sensor.encoder': 1 of 200 samples is corrupt (up to 1e+282, the first at 0.07 s):
    set aside as missing
    """
    positions = {
        name for name in run.sensors if int(model.sensor_type[model.sensor(name).id]) == _POSITION
    }
    found: list[Corrupt] = []

    def clean(prefix: str, columns: Mapping[str, Array]) -> dict[str, Array]:
        made = {}
        for name, values in columns.items():
            kept = np.array(values)
            for axis, own in enumerate([kept] if kept.ndim == 1 else kept.T):
                multiple = MULTIPLE if name in positions else IMPULSIVE_MULTIPLE
                wrong = corrupt_mask(own, multiple)
                if not wrong.any():
                    continue
                largest = float(np.abs(own[wrong]).max())
                own[wrong] = np.nan
                found.append(
                    Corrupt(
                        run=run.name,
                        column=f"{prefix}.{name}" + ("" if kept.ndim == 1 else f".{'xyz'[axis]}"),
                        count=int(wrong.sum()),
                        samples=len(own),
                        missing=float(np.mean(np.isnan(own))),
                        first=float(run.time[int(np.argmax(wrong))]),
                        largest=largest,
                    )
                )
            made[name] = kept
        return made

    controls = clean("ctrl", run.controls)
    sensors, torques = clean("sensor", run.sensors), clean("torque", run.torques)
    if not found:
        return run, ()
    return replace(run, controls=controls, sensors=sensors, torques=torques), tuple(found)


def set_aside(run: Run, model: mujoco.MjModel) -> tuple[Run, tuple[Corrupt, ...]]:
    """Replace the corrupt samples of a run by NaN, or refuse a run that is mostly such.

    Parameters and results are those of `without_corrupt`.

    Raises
    ------
    InvalidData
        If more than `MOST_CORRUPT` of a column is corrupt or missing.
    """
    clean, found = without_corrupt(run, model)
    for each in found:
        if each.too_many:
            raise InvalidData(
                f"{each.words}; at most {MOST_CORRUPT:.0%} of a column may be. Check unit and "
                "scale at the import, leave the column out, or record the run again"
            )
    return clean, found
