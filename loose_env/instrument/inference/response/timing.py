"""Clock offset of the accelerometers, and delay and bandwidth of the servos.

Recorders of their own have clocks of their own. The acceleration that the measured motion of the
joints makes at a site is known from the kinematics alone; the shift at which it agrees best with
what the accelerometer reads is the offset of its clock (generalised cross-correlation; Knapp and
Carter, IEEE Trans. Acoust. Speech Signal Process. 24, 1976).
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
from loose_env.typing import Array, ComplexArray

__all__ = ["ClockOffset", "ServoTiming", "clock_offset", "on_one_clock", "servo_timing"]

_STEP_S = 5e-5
"""Step of the shifts that are tried [s]."""
_SHIFTS = np.arange(-LARGEST_CLOCK_OFFSET_S, LARGEST_CLOCK_OFFSET_S + _STEP_S / 2, _STEP_S)
"""Shifts that are tried [s]."""
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
    """Estimate the clock offset of the accelerometers over all runs of a session.

    Parameters
    ----------
    uncertain : UncertainArm
        The arm.
    lines : sequence of Lines
        Runs of one session.

    Returns
    -------
    ClockOffset or None
        None where no run has positions or velocities of the joints that rise above their noise.
    """
    found = [(one.frequency, _cross_spectrum(uncertain, one)) for one in lines]
    return _offset([(frequency, cross) for frequency, cross in found if cross is not None])


def on_one_clock(
    uncertain: UncertainArm, lines: Sequence[Lines]
) -> tuple[list[Lines], tuple[ClockOffset, ...]]:
    """Runs without the clock offset of their accelerometers, and the estimated offsets.

    One offset holds for all runs, but for what a session of references differs by: that is measured
    by the runs beside each other, whatever the model says.

    Parameters
    ----------
    uncertain : UncertainArm
        The arm.
    lines : sequence of Lines
        All runs.
    """
    common = clock_offset(uncertain, lines)
    late = common.seconds if common is not None and common.significant else 0.0
    between = _offset([cross for one in lines if (cross := _beside(one)) is not None])
    later = between.seconds if between is not None and between.significant else 0.0
    made = []
    for one in lines:
        beside = None if one.beside is None else shifted(one.beside, late - later)
        own = shifted(one, late - later * one.healthy)
        made.append(replace(own, beside=beside))
    return made, () if common is None else (common,)


def shifted(lines: Lines, seconds: float) -> Lines:
    """Run whose accelerometers and gyroscopes are read that much earlier."""
    sites = np.array([reading.on_site for reading, _ in lines.row])
    turn = np.exp(2j * np.pi * lines.frequency * seconds)
    readings = lines.readings.copy()
    readings[:, sites] *= turn[:, None]
    return replace(lines, readings=readings)


def servo_timing(uncertain: UncertainArm, lines: Sequence[Lines]) -> tuple[ServoTiming, ...]:
    """Bandwidth and delay of the servos of the excited joints.

    Parameters
    ----------
    uncertain : UncertainArm
        The arm.
    lines : sequence of Lines
        Runs.
    """
    arm = uncertain.arm
    found = []
    for joint, name in enumerate(arm.joints):
        curves, bandwidths = [], []
        for one in lines:
            if joint not in one.excited or one.blind[joint]:
                continue
            response = _nominal(uncertain, one)
            measured, used = _measured_motion(response)
            if not used[:, joint].any():
                continue
            keep = used[:, joint]
            cross = np.conj(response.motion[keep, joint]) * measured[keep, joint]
            cross = cross / np.maximum(np.abs(cross), 1e-300)
            curves.append(
                np.real(np.exp(2j * np.pi * np.outer(_SHIFTS, one.frequency[keep])) @ cross)
            )
            bandwidths.append(_bandwidth(response, measured, used, joint))
        if not curves:
            continue
        known = [b for b in bandwidths if b is not None]
        found.append(
            ServoTiming(
                joint=name,
                bandwidth_hz=float(np.median(known)) if known else None,
                delay_s=_peak(_SHIFTS, np.sum(curves, axis=0)),
            )
        )
    return tuple(found)


def _offset(crosses: Sequence[tuple[Array, ComplexArray]]) -> ClockOffset | None:
    """Delay of highest cross-correlation over all runs, by frequencies and cross-spectra (K,)."""
    curves, own = [], []
    for frequency, cross in crosses:
        curve = np.real(np.exp(2j * np.pi * np.outer(_SHIFTS, frequency)) @ cross)
        curve /= max(float(np.sum(np.abs(cross))), 1e-300)
        curves.append(curve)
        own.append(_peak(_SHIFTS, curve))
    if not curves:
        return None
    best = _peak(_SHIFTS, np.sum(curves, axis=0))
    # Runs that peak elsewhere by a whole period of the band tell nothing of the scatter.
    near = [each for each in own if abs(each - best) < _SAME_PEAK_S]
    if len(near) < 0.5 * len(own):
        return None
    scatter = 1.4826 * float(np.median(np.abs(np.array(near) - best))) if len(near) > 1 else 1e-3
    return ClockOffset(seconds=best, sd=max(1.25 * scatter / np.sqrt(len(near)), 0.2 * _STEP_S))


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
    width = max(3, round(4.0 / lines.spacing))
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


def _peak(shifts: Array, curve: Array) -> float:
    """Shift of the highest point, by a parabola through its neighbours [s]."""
    at = int(np.argmax(curve))
    if not 0 < at < len(curve) - 1:
        return float(shifts[at])
    before, here, after = curve[at - 1 : at + 2]
    bend = before - 2 * here + after
    return float(shifts[at] + 0.5 * (shifts[1] - shifts[0]) * (before - after) / min(bend, -1e-300))
