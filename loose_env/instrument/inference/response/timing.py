"""Clock offset of the accelerometers (estimate, correction), and delay and bandwidth of servos.

Recorders of their own have clocks of their own. The acceleration that the measured motion of the
joints makes at a site is known from the kinematics alone; the delay at which it agrees best with
what the accelerometer reads is the offset of its clock (`loose_env.statistics.phase_delay`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.response.frequency_response import Response, respond
from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm
from loose_env.instrument.settings.thresholds import (
    CLOCK_NOTED_S,
    CLOCK_Z,
    LARGEST_CLOCK_OFFSET_S,
)
from loose_env.statistics import phase_delay
from loose_env.typing import Array, ComplexArray

_SEARCHED_S = 1.1 * LARGEST_CLOCK_OFFSET_S
"""Largest offset searched [s]: the largest one has to be a peak too."""
_LEAST_SD_S = 1e-5
"""Smallest standard deviation that is believed [s]."""
_SAME_PEAK_S = 0.002
"""Distance up to which a run's peak is that of all [s]."""
_LINE_ERROR = 0.1
"""Relative error of a line beside noise: no line counts more than its neighbours [1]."""
_SIGNAL = 4.0
"""Power of a joint's line over its noise from which it is used [1]."""


@dataclass(frozen=True, kw_only=True)
class ClockOffset:
    """Time by which the accelerometers' clock is late against that of the joints' sensors."""

    seconds: float
    """Positive where the accelerometers are late [s]."""
    sd: float
    """Its standard deviation, from the scatter over runs [s]."""

    @property
    def significant(self) -> bool:
        """True if it differs from zero."""
        return abs(self.seconds) > CLOCK_Z * self.sd

    @property
    def noted(self) -> bool:
        """True if it is large enough to be told, and to forbid a settled verdict."""
        return self.significant and abs(self.seconds) > CLOCK_NOTED_S

    @property
    def words(self) -> str:
        """Size and sign, as in "the accelerometers' clock is 5.0 ms late"."""
        late = "late" if self.seconds > 0 else "early"
        return f"the accelerometers' clock is {abs(self.seconds) * 1e3:.1f} ms {late}"


@dataclass(frozen=True, kw_only=True)
class ServoTiming:
    """Answer of a joint to its commands."""

    joint: str
    bandwidth_hz: float | None
    """Frequency at which the answer falls to 0.71 of the command; None if above the band or not of
    a position servo."""
    delay_s: float
    """Delay of the measured motion against the model's [s]."""


def clock_offset(uncertain: UncertainArm, lines: Sequence[Lines]) -> ClockOffset | None:
    """Estimate the clock offset of the accelerometers over all runs of a session."""
    found = [(one.frequency, _cross_spectrum(uncertain, one)) for one in lines]
    return _offset([(frequency, cross) for frequency, cross in found if cross is not None])


@dataclass(frozen=True, kw_only=True)
class Clocks:
    """Clock offsets of a session's runs, and the correction of their lines."""

    offset: ClockOffset | None
    """Offset that all runs have; None where it cannot be told."""
    common_s: float = 0.0
    """Time by which the accelerometers of all runs are late, as it is corrected [s]."""
    reference_s: float = 0.0
    """Time by which those of the references are earlier than that [s]."""

    def refined(self, uncertain: UncertainArm, errors: Array, normal: Array) -> ClockOffset | None:
        """Offset by a fit of all runs to the whole model, which started from this one."""
        if self.offset is None:
            return None
        clock, unit = uncertain.reading_lag.start, uncertain.tolerances.sensor_clock
        sd = unit * float(np.sqrt(np.linalg.inv(normal)[clock, clock]))
        return ClockOffset(seconds=self.common_s + unit * float(errors[clock]), sd=sd)

    def corrected(self, lines: Lines) -> Lines:
        """Lines of a run, and of the reference beside it, with stamps of one clock."""
        beside = None if lines.beside is None else self.corrected(lines.beside)
        own = shifted(lines, self.common_s - self.reference_s * lines.healthy)
        return replace(own, beside=beside)


def clocks_of(uncertain: UncertainArm, lines: Sequence[Lines]) -> Clocks:
    """Estimate the clock offsets of a session.

    One offset holds for all runs, but for what a session of references differs by: that is measured
    by the runs beside each other, whatever the model says.
    """
    common = clock_offset(uncertain, lines)
    between = _offset([cross for one in lines if (cross := _beside(one)) is not None])
    return Clocks(
        offset=common,
        common_s=common.seconds if common is not None and common.significant else 0.0,
        reference_s=between.seconds if between is not None and between.significant else 0.0,
    )


def shifted(lines: Lines, seconds: float) -> Lines:
    """Run whose accelerometers and gyroscopes are read that much earlier."""
    sites = np.array([reading.on_site for reading, _ in lines.row])
    turn = np.exp(2j * np.pi * lines.frequency * seconds)
    readings = lines.readings.copy()
    readings[:, sites] *= turn[:, None]
    return replace(lines, readings=readings)


def servo_timing(uncertain: UncertainArm, lines: Sequence[Lines]) -> tuple[ServoTiming, ...]:
    """Bandwidth and delay of the servos of the excited joints."""
    arm = uncertain.arm
    found = []
    for joint, name in enumerate(arm.joints):
        crosses, bandwidths = [], []
        for one in lines:
            if joint not in one.excited or one.blind[joint]:
                continue
            response = _nominal(uncertain, one)
            measured, used = _measured_motion(response)
            if not used[:, joint].any():
                continue
            keep = used[:, joint]
            cross = np.conj(response.motion[keep, joint]) * measured[keep, joint]
            crosses.append((one.frequency[keep], cross / np.maximum(np.abs(cross), 1e-300)))
            bandwidths.append(_bandwidth(response, measured, used, joint))
        delay = _delay(crosses)
        if delay is None:
            continue
        known = [b for b in bandwidths if b is not None]
        found.append(
            ServoTiming(
                joint=name,
                bandwidth_hz=float(np.median(known)) if known else None,
                delay_s=delay,
            )
        )
    return tuple(found)


def _offset(crosses: Sequence[tuple[Array, ComplexArray]]) -> ClockOffset | None:
    """Delay of highest cross-correlation over all runs, by frequencies and cross-spectra (K,)."""
    best = _delay(crosses)
    if best is None:
        return None
    own = [delay for each in crosses if (delay := _delay([each])) is not None]
    # Runs that peak elsewhere by a whole period of the band tell nothing of the scatter.
    near = [each for each in own if abs(each - best) < _SAME_PEAK_S]
    if len(near) < 0.5 * len(crosses) or not near:
        return None
    scatter = 1.4826 * float(np.median(np.abs(np.array(near) - best))) if len(near) > 1 else 1e-3
    return ClockOffset(seconds=best, sd=max(1.25 * scatter / np.sqrt(len(near)), _LEAST_SD_S))


def _delay(crosses: Sequence[tuple[Array, ComplexArray]]) -> float | None:
    """Delay over all lines of some runs, each run of the same weight [s]."""
    if not crosses:
        return None
    frequency, cross = (np.concatenate(each) for each in zip(*crosses, strict=True))
    weight = np.concatenate(
        [np.abs(each) / max(float(np.sum(np.abs(each))), 1e-300) for _, each in crosses]
    )
    found = phase_delay(frequency, cross, weight, largest=_SEARCHED_S, either_sign=False)
    return None if found is None else found.seconds


def _beside(lines: Lines) -> tuple[Array, ComplexArray] | None:
    """Frequencies and weighted cross-spectrum of a run's accelerations and its reference's."""
    if lines.beside is None:
        return None
    sites = [k for k, (reading, _) in enumerate(lines.row) if reading.kind == "acceleration"]
    first, second = lines.beside.readings[:, sites], lines.readings[:, sites]
    weight = 1 / (lines.noise[:, sites] + _LINE_ERROR * np.abs(second) ** 2)
    return lines.frequency, np.sum(np.conj(first) * second * weight, axis=1)


def _nominal(uncertain: UncertainArm, lines: Lines) -> Response:
    return respond(uncertain.at(lines.pose), lines, uncertain.nominal)


def _measured_motion(response: Response) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """Motion of the joints by their sensors (K, n), and mask of lines above noise (K, n)."""
    lines, n = response.lines, response.at.of.arm.n
    s = 2j * np.pi * lines.frequency
    motion, error = np.zeros((len(s), n), dtype=complex), np.full((len(s), n), np.inf)
    for k, (reading, _) in enumerate(lines.row):
        if reading.on_site:
            continue
        scale = s if reading.kind == "velocity" else np.ones_like(s)
        noise = lines.noise[:, k] / np.abs(scale) ** 2
        better = noise < error[:, reading.at]
        value = lines.readings[:, k] / scale
        motion[better, reading.at] = value[better]
        error[better, reading.at] = noise[better]
    return motion, np.asarray(np.abs(motion) ** 2 > _SIGNAL * error)


def _cross_spectrum(uncertain: UncertainArm, lines: Lines) -> ComplexArray | None:
    """Weighted cross-spectrum of predicted and measured acceleration (K,)."""
    response = _nominal(uncertain, lines)
    measured, used = _measured_motion(response)
    sites = [k for k, (reading, _) in enumerate(lines.row) if reading.kind == "acceleration"]
    excited = used[:, lines.excited].any(axis=1)
    if not sites or excited.sum() < 8:
        return None
    n = measured.shape[1]
    moved = np.where(used, measured, 0.0)
    predicted = (response.rows[:, sites, :n] @ moved[:, :, None])[:, :, 0]
    read = lines.readings[:, sites]
    weight = 1 / (lines.noise[:, sites] + _LINE_ERROR * np.abs(read) ** 2)
    cross = np.sum(np.conj(predicted) * read * weight, axis=1)
    size = np.sqrt(np.sum(np.abs(predicted) ** 2 * weight, axis=1))
    return np.asarray(np.where(excited, cross / np.maximum(size, 1e-300), 0.0))


def _bandwidth(
    response: Response, measured: ComplexArray, used: NDArray[np.bool_], joint: int
) -> float | None:
    """Frequency at which the smoothed answer falls to 0.71 of the command [Hz]."""
    lines, drives = response.lines, response.at.of.arm.actuators
    if not drives.stiffness[joint] > 0:
        return None
    command = lines.command @ drives.force[joint] / drives.stiffness[joint]
    width = min(max(3, round(4.0 / lines.spacing)), len(lines.frequency))
    kernel = np.ones(width) / width
    power = np.convolve(np.abs(command) ** 2, kernel, mode="same")
    answer = np.convolve(
        np.conj(command) * np.where(used[:, joint], measured[:, joint], 0), kernel, mode="same"
    )
    gain = np.abs(answer) / np.maximum(power, 1e-300)
    below = np.flatnonzero(gain < np.sqrt(0.5))
    if not len(below) or below[0] == 0:
        return None
    return float(lines.frequency[below[0]])
