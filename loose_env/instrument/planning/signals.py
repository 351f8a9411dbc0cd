"""Signal of a measurement: actuator commands and their predicted response.

The noise is periodic in the record: its linear answer is known line by line, so peaks of torque,
of travel and of the command are known before anything moves, and the signal is scaled down until
all of them stay within their limits. Nothing is clipped: the spectrum stays in its band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from loose_env.arms import LinearArm
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import Excitation, torque_signals
from loose_env.instrument.model.holding_commands import (
    holding_commands,
    starting_commands,
    why_not_held,
)
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.typing import Array, ComplexArray

__all__ = ["Signal", "holding_commands", "make_signal"]


_DRAWS = 8
"""Draws of the noise, of which the one with the lowest peak is played."""
_LOADING = 0.6
"""Share of the time of standing still over which commands go from the pose to what holds it [1]."""
_OVERSAMPLED = 4
"""Samples at which peaks are looked for, per sample of the signal."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """Commands of all actuators over one run, and what is expected of the arm."""

    joint: str
    """The excited joint."""
    time: Array
    """From the start of the run [s] (T,)."""
    commands: dict[str, Array]
    """Actuator -> its command, in its own unit (T,)."""
    start: dict[str, float]
    """Actuator -> the command with which the signal begins and ends: for servos the pose itself."""
    sags: Array
    """Sag of each joint's servo under the load that it holds: so much its holding command
    is beside the pose [rad or m] (n,)."""
    steady_s: tuple[float, float]
    """Beginning and end of the record proper, between the ramps [s]."""
    torque_rms: float
    """Rms of the torque that the command asks for; a servo's spring and damper take from it
    [N·m, N where the joint slides]."""
    drive_rms: float
    """Rms of the torque that the drive gives beside what holds the pose [N·m, N]."""
    torque_peaks: Array
    """Largest torque each drive gives, what holds the pose included [N·m, N] (n,)."""
    joint_rms: float
    """Expected rms acceleration of the excited joint [rad/s², m/s²]."""
    tool_rms: float
    """Expected rms acceleration of the tool [m/s²]."""
    travel: Array
    """Largest expected move of each joint from the pose [rad or m] (n,)."""
    scale: float
    """Share of the wanted torque that the limits allow [1]."""
    limited_by: str
    """Limit that was reached; "" for none."""


def make_signal(
    arm: InstrumentedArm,
    linear: LinearArm,
    pose: Array,
    joint: str,
    *,
    torque_rms: float,
    band: tuple[float, float],
    seconds: float,
    rate: float,
    ramp: float,
    hold: float,
    rng: np.random.Generator,
    torque_share: float = 0.8,
) -> Signal:
    """Draw the noise for one joint, and turn it into commands.

    Parameters
    ----------
    arm : InstrumentedArm
        The arm and its actuators.
    linear : LinearArm
        Its linear form, held as it will be.
    pose : ndarray (n,)
        Joint positions to hold [rad or m].
    joint : str
        Model's name of the joint to shake.
    torque_rms : float
        Wanted rms torque of the noise [N·m, N where the joint slides].
    band : tuple of float
        Of the noise [Hz].
    seconds : float
        Length of the record proper [s].
    rate : float
        Samples per second of the commands [Hz].
    ramp, hold : float
        Time over which the noise swells and dies away, and before and after it: there commands go
        from the pose to what holds the arm in it and back, and the arm stands still [s].
    rng : numpy.random.Generator
        Source of the noise.
    torque_share : float
        Share of each drive's torque that peaks may reach, what holds the pose included [1].

    Returns
    -------
    Signal

    Raises
    ------
    InvalidSetting
        If the rate is too low for the band, or no joint of that name is driven.
    InvalidData
        If the pose cannot be held within the limits, or the joint has no usable actuator.
    """
    if joint not in arm.joints:
        raise InvalidSetting(
            f"there is no driven joint {joint!r}; the model has {', '.join(arm.joints)}"
        )
    if not rate > 2.5 * band[1] * (1 - 1e-9):
        raise InvalidSetting(
            f"a rate of {rate:g} Hz is too low for a band up to {band[1]:g} Hz; take "
            f"{np.ceil(2.5 * band[1]) + 1:g} Hz or more, or a lower band"
        )
    j = arm.joints.index(joint)
    drive = arm.drives[j]
    if drive is None:
        raise InvalidData(
            f"joint {joint!r} has no actuator with a linear law, so no command for it "
            f"can be worked out: {'; '.join(arm.notes)}"
        )
    unheld = why_not_held(arm, pose)
    if unheld:
        raise InvalidData(f"the pose cannot be held: {unheld}; take one farther from the end")
    holding, load = holding_commands(arm, pose)
    start_at = starting_commands(arm, pose)
    noise = np.zeros(arm.nominal.n)
    noise[j] = torque_rms
    excitation = Excitation(torque_rms=tuple(noise), duration=seconds, band=band)
    draws = [
        torque_signals(excitation, timestep=1 / rate, before=0, after=0, rng=rng)[j]
        for _ in range(_DRAWS)
    ]
    # The expected rms is asked for; this draw shall have it itself.
    draws = [x * torque_rms / np.sqrt(np.mean(x**2)) for x in draws]
    period = min(draws, key=lambda x: float(np.abs(x).max()))
    answer = _Answer(arm, linear, pose, j, period, rate)
    scale, limited_by = _scale(arm, pose, j, load, holding[drive.actuator], answer, torque_share)
    if scale <= 0:
        raise InvalidData(f"the pose leaves nothing to shake joint {joint!r} with: {limited_by}")

    before, swell = round(hold * rate), max(round(ramp * rate), 1)
    count = len(period)
    envelope = np.concatenate(
        [
            np.zeros(before),
            0.5 - 0.5 * np.cos(np.pi * (np.arange(swell) + 0.5) / swell),
            np.ones(count),
            0.5 + 0.5 * np.cos(np.pi * (np.arange(swell) + 0.5) / swell),
            np.zeros(before),
        ]
    )
    total = len(envelope)
    index = (np.arange(total) - before - swell) % count
    # The command of a noise torque leads it by the actuator's lag.
    ahead = answer.in_time(answer.torque * (1 + answer.s * drive.lag)) / drive.gain
    loaded = _loaded(before, total)
    commands = {
        name: start_at[name] + (value - start_at[name]) * loaded for name, value in holding.items()
    }
    commands[drive.actuator] = commands[drive.actuator] + scale * envelope * ahead[index]
    start = (before + swell) / rate
    return Signal(
        joint=joint,
        time=np.arange(total) / rate,
        commands=commands,
        start=start_at,
        sags=np.array(
            [
                0.0
                if d is None or not d.servo
                else (holding[d.actuator] - start_at[d.actuator]) * d.gain / d.stiffness
                for d in arm.drives
            ]
        ),
        steady_s=(start, start + count / rate),
        torque_rms=float(scale * torque_rms),
        drive_rms=float(scale * np.sqrt(np.mean(answer.drive_torques[j] ** 2))),
        torque_peaks=np.abs(load[:, None] + scale * answer.drive_torques).max(axis=1),
        joint_rms=float(scale * answer.rms(answer.joints[j])),
        tool_rms=float(scale * answer.rms(answer.tool)),
        travel=scale * np.abs(answer.positions).max(axis=1),
        scale=float(scale),
        limited_by=limited_by,
    )


def _loaded(before: int, total: int) -> Array:
    """Share of the sag that commands make up for: none at either end, all while it is shaken."""
    rise = round(_LOADING * before)
    share = np.ones(total)
    if rise > 0:
        share[:rise] = 0.5 - 0.5 * np.cos(np.pi * np.arange(rise) / rise)
        share[total - rise :] = share[:rise][::-1]
    return share


class _Answer:
    """Response of the linear arm to one period of noise torque at one joint."""

    def __init__(
        self,
        arm: InstrumentedArm,
        linear: LinearArm,
        pose: Array,
        j: int,
        period: Array,
        rate: float,
    ) -> None:
        nominal = arm.nominal
        self.count = len(period)
        spectrum = np.asarray(fft.rfft(period))
        self._lines = np.flatnonzero(np.abs(spectrum) > 1e-9 * np.abs(spectrum).max())
        frequency = self._lines * rate / self.count
        fine = linear.variant(linear.arm)
        fine.frequency = frequency
        excited = np.arange(nominal.n) == j
        answer = fine.at(pose).response(excited)
        self.s = 2j * np.pi * frequency
        self.torque = spectrum[self._lines]
        self.joints = (answer.joint[:, :, 0] * self.torque[:, None]).T  # (n, K)
        self.tool = (answer.tool[:, :, 0] * self.torque[:, None]).T  # (d, K)
        moved = self.joints / self.s**2
        self.positions = self.in_time(moved, _OVERSAMPLED)
        spring = np.array([0.0 if d is None else d.stiffness for d in arm.drives])
        damper = np.array([0.0 if d is None else d.damping for d in arm.drives])
        own = -(spring[:, None] + damper[:, None] * self.s) * moved
        own[j] += self.torque
        self.drive_torques = self.in_time(own, _OVERSAMPLED)

    def in_time(self, lines: ComplexArray, finer: int = 1) -> Array:
        """One period of a signal of given lines (..., count)."""
        whole = np.zeros((*lines.shape[:-1], finer * self.count // 2 + 1), dtype=complex)
        whole[..., self._lines] = lines
        return np.asarray(fft.irfft(whole, n=finer * self.count) * finer)

    def rms(self, lines: ComplexArray) -> float:
        """Root of the sum of the mean squares of all rows."""
        return float(np.sqrt(2 * np.sum(np.abs(lines) ** 2)) / self.count)


def _scale(
    arm: InstrumentedArm,
    pose: Array,
    j: int,
    load: Array,
    holding: float,
    answer: _Answer,
    share: float,
) -> tuple[float, str]:
    """Share of the noise that every limit allows, and the limit that decides."""
    nominal = arm.nominal
    scale, why = 1.0, ""
    peaks = np.abs(answer.drive_torques).max(axis=1)
    for i, name in enumerate(arm.joints):
        drive = arm.drives[i]
        if i != j and not (drive is not None and drive.servo):
            continue  # held by a brake
        most = nominal.torque_limits[i]
        most = most if drive is None else min(most, drive.limit)
        spare = share * most - abs(float(load[i]))
        if spare < scale * peaks[i]:
            scale = max(spare, 0.0) / peaks[i]
            unit = "N" if nominal.sliding[i] else "N·m"
            why = (
                f"{share:.0%} of the {most:g} {unit} of {name}'s drive are used at most, and "
                f"{abs(float(load[i])):.3g} {unit} of them hold the pose"
            )
    travel = np.abs(answer.positions).max(axis=1)
    for i, allowed in enumerate(nominal.joint_ranges):
        if allowed is None:
            continue
        spare = min(pose[i] - allowed[0], allowed[1] - pose[i])
        if spare < scale * travel[i]:
            scale = max(float(spare), 0.0) / travel[i]
            why = f"{arm.joints[i]} goes from {allowed[0]:g} to {allowed[1]:g}"
    drive = arm.drives[j]
    assert drive is not None
    ahead = answer.in_time(answer.torque * (1 + answer.s * drive.lag), _OVERSAMPLED) / drive.gain
    low, high = drive.command_range
    spare, peak = min(holding - low, high - holding), float(np.abs(ahead).max())
    if spare < scale * peak:
        scale = max(spare, 0.0) / peak
        why = f"actuator {drive.actuator} takes commands from {low:g} to {high:g}"
    return scale, why
