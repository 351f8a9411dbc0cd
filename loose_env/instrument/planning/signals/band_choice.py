"""Band and level of excitation within the limits of a controller, chosen for detectability."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from loose_env.arms import LinearArm
from loose_env.errors import InvalidSetting
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.model.motion_limits import MotionLimits
from loose_env.instrument.planning.signals.signal import Signal
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.motion import CommandKind
from loose_env.instrument.settings.thresholds import (
    BAND_GAIN,
    FEWEST_LINES,
    HIGHEST_BAND,
    LOWEST_HZ,
    SCALED_LEVEL,
)
from loose_env.typing import Array

Band = tuple[float, float]
LevelCap = Callable[[Array, int, Band], float]
"""Largest rms torque of a joint in a pose and a band [N·m, N]."""
Making = Callable[[Band, float], Signal]
"""Makes a signal in a band, with a wanted rms torque."""

_SHARES = (0.75, 0.5, 0.33, 0.2)
"""Widths of narrower bands, over that of the arm's [1]."""
_LOWER_END = 0.2
"""Lower end over upper end of a band that has to move down to the bandwidth of commands [1]."""
_CREST = 3.5
"""Peak over rms of the calmest of a few draws of noise [1]."""


def within_bandwidth(settings: NextSettings, band: Band, limits: MotionLimits) -> NextSettings:
    """Settings whose band ends where the controller stops following its commands.

    Examples
    --------
    >>> limits = MotionLimits(values={}, sources={}, bandwidth_hz=50.0, command_rate_hz=None)
    >>> slow = within_bandwidth(NextSettings(), (30.0, 150.0), limits)
    >>> slow.band_low, slow.band_high
    (None, 50.0)
    """
    allowed = limits.bandwidth_hz
    if limits.command_rate_hz is not None:
        allowed = min(allowed, HIGHEST_BAND * limits.command_rate_hz)
    high = min(band[1] if settings.band_high is None else settings.band_high, settings.allowed_hz)
    if allowed >= high:
        return settings
    low = band[0] if settings.band_low is None else settings.band_low
    if low > _SHARES[0] * allowed:
        if settings.band_low is not None or _LOWER_END * allowed < LOWEST_HZ:
            raise InvalidSetting(
                f"commands are followed up to {allowed:g} Hz, which leaves no band above "
                f"{max(low if settings.band_low else 0.0, LOWEST_HZ):g} Hz to shake a joint in: "
                "give a lower band_low, a controller of a higher rate or bandwidth, or shake the "
                "tool with --excitation hammer"
            )
        return replace(settings, band_low=_LOWER_END * allowed, band_high=allowed)
    return replace(settings, band_high=allowed)


def level_cap(
    arm: InstrumentedArm, linear: LinearArm, limits: MotionLimits, kind: CommandKind
) -> LevelCap:
    """Largest level that the motion limits allow, for the choice of pose and joint."""
    speed, acceleration, jerk = (limits.values[q] for q in ("speed", "acceleration", "jerk"))

    def cap(pose: Array, j: int, band: Band) -> float:
        drive = arm.drives[j]
        inner = linear.variant(replace(linear.arm, band=band))
        answer = inner.at(pose).response(np.arange(arm.n) == j).joint[:, :, 0]  # (K, n)
        omega = 2 * np.pi * inner.frequency
        most = np.inf
        for power, allowed in ((-1, speed), (0, acceleration), (1, jerk)):
            size = np.sqrt(np.mean(np.abs(answer * omega[:, None] ** power) ** 2, axis=0))
            most = min(most, float((allowed / np.maximum(_CREST * size, 1e-12)).min()))
        rate = limits.limit("torque rate", j)
        most = min(most, rate / (_CREST * float(np.sqrt(np.mean(omega**2)))))
        if drive is not None and drive.servo and kind == "model":
            ahead = np.abs(1 + 1j * omega * drive.lag) / drive.stiffness
            for power, allowed in ((1, speed), (2, acceleration), (3, jerk)):
                size = _CREST * float(np.sqrt(np.mean((ahead * omega**power) ** 2)))
                most = min(most, float(allowed[j]) / size)
        return most

    return cap


def best_band(
    make: Making,
    judge: Callable[[Signal, Band], float],
    band: Band,
    torque_rms: float,
    *,
    seconds: float,
    most_tool: float,
) -> tuple[Signal, Band, str]:
    """Signal in the arm's band, or in a narrower and lower one where limits make that better.

    Speed, acceleration and jerk of a command rise with frequency: a band that ends lower leaves
    more torque within the same limits.
    """
    first = make(band, torque_rms)
    reached = any(p.limit is not None and p.value >= SCALED_LEVEL * p.limit for p in first.peaks)
    if first.scale >= SCALED_LEVEL or not reached:
        return first, band, ""
    best, played = BAND_GAIN * judge(first, band), (first, band, "")
    for share in _SHARES:
        width = share * (band[1] - band[0])
        if width * seconds < 2 * FEWEST_LINES:
            break
        narrower = (band[0], band[0] + width)
        signal = make(narrower, torque_rms)
        if signal.tool_rms > most_tool:
            signal = make(narrower, torque_rms * most_tool / signal.tool_rms)
        found = judge(signal, narrower)
        if found > best:
            best, played = found, (signal, narrower, first.limited_by)
    return played
