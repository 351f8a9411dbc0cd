"""Signal of a measurement: actuator commands scaled to limits, and their predicted response.

The noise is periodic in the record: its linear answer is known line by line, so peaks of torque,
of travel and of the command are known before anything moves, and the signal is scaled down until
all of them stay within their limits. Nothing is clipped: the spectrum stays in its band.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from loose_env.arms import LinearArm
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import Excitation, torque_signals
from loose_env.instrument.model.holding_commands import (
    holding_commands,
    starting_commands,
    why_not_held,
)
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.model.motion_limits import MotionLimits
from loose_env.instrument.planning.signals.linear_answer import OVERSAMPLED, LinearAnswer
from loose_env.instrument.planning.signals.motion_peaks import (
    MotionPeak,
    Peaks,
    command_peaks,
    highest,
    joint_peaks,
    with_limits,
)
from loose_env.instrument.planning.signals.played_commands import (
    excited_command,
    played_columns,
)
from loose_env.instrument.settings.motion import CommandKind
from loose_env.typing import Array

_DRAWS = 8
"""Draws of the noise, of which the one with the lowest peak is played."""
_LOADING = 0.6
"""Share of the time of standing still over which commands go from the pose to what holds it [1]."""


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
    kind: CommandKind = "model"
    """Kind of the commands that are played."""
    played: Mapping[str, Array] = field(default_factory=dict)
    """Columns of the signal's files, time left out (T,)."""
    peaks: tuple[MotionPeak, ...] = ()
    """Peaks of speed, acceleration, jerk and torque rate beside their limits."""

    @property
    def rate_hz(self) -> float:
        """Samples per second [Hz]."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))


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
    limits: MotionLimits | None = None,
    kind: CommandKind = "model",
) -> Signal:
    """Draw the noise for one joint, and turn it into commands."""
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
    answer = LinearAnswer(arm, linear, pose, j, period, rate)
    before, swell = round(hold * rate), max(round(ramp * rate), 1)
    count = len(period)
    envelope = _envelope(before, swell, count)
    total = len(envelope)
    index = (np.arange(total, dtype=np.intp) - before - swell) % count
    command = excited_command(kind, drive, answer, j, envelope, index, rate)
    loaded = _loaded(before, total)
    commands = {
        name: start_at[name] + (value - start_at[name]) * loaded for name, value in holding.items()
    }
    sags = _sags(arm, holding, start_at)
    moving = highest(joint_peaks(arm, answer, j), command.peaks)
    slow = _loading_peaks(arm, sags, loaded, rate) if kind == "model" else {}
    if limits is not None:
        for one in with_limits(arm, slow, limits):
            if not one.within:
                raise InvalidData(
                    f"the command of {one.joint} moves by its sag in {_LOADING * hold:.3g} s with "
                    f"a {one.quantity} of {one.value:.3g} {one.unit}, above the limit of "
                    f"{one.limit:.3g} ({one.source}); take a longer hold_s"
                )
    scale, limited_by = _scale(arm, pose, j, load, holding[drive.actuator], answer, torque_share)
    if limits is not None:
        for one in with_limits(arm, moving, limits):
            if one.limit is not None and one.limit < scale * one.value:
                scale = one.limit / one.value
                whose = "command of " if one.of == "command" else ""
                limited_by = (
                    f"the {one.quantity} of the {whose}{one.joint} is at most {one.limit:g} "
                    f"{one.unit} ({one.source})"
                )
    if scale <= 0:
        raise InvalidData(f"the pose leaves nothing to shake joint {joint!r} with: {limited_by}")
    commands[drive.actuator] = commands[drive.actuator] + scale * command.own
    peaks: tuple[MotionPeak, ...] = ()
    if limits is not None:
        scaled = {key: scale * value for key, value in moving.items()}
        peaks = with_limits(arm, highest(slow, scaled), limits)
    start = (before + swell) / rate
    return Signal(
        joint=joint,
        time=np.arange(total) / rate,
        commands=commands,
        start=start_at,
        sags=sags,
        steady_s=(start, start + count / rate),
        torque_rms=float(scale * torque_rms),
        drive_rms=float(scale * np.sqrt(np.mean(answer.drive_torques[j] ** 2))),
        torque_peaks=np.abs(load[:, None] + scale * answer.drive_torques).max(axis=1),
        joint_rms=float(scale * answer.rms(answer.joints[j])),
        tool_rms=float(scale * answer.rms(answer.tool)),
        travel=scale * np.abs(answer.positions).max(axis=1),
        scale=float(scale),
        limited_by=limited_by,
        kind=kind,
        played=played_columns(arm, pose, j, command, scale, commands, rate),
        peaks=peaks,
    )


def _envelope(before: int, swell: int, count: int) -> Array:
    """Level of the noise over time [1]: it swells, is played and dies away."""
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(swell) + 0.5) / swell)
    still = np.zeros(before)
    return np.concatenate([still, rise, np.ones(count), rise[::-1], still])


def _sags(arm: InstrumentedArm, holding: dict[str, float], start: dict[str, float]) -> Array:
    """Sag of each joint's servo under its load [rad or m] (n,)."""
    return np.array(
        [
            0.0
            if d is None or not d.servo
            else (holding[d.actuator] - start[d.actuator]) * d.gain / d.stiffness
            for d in arm.drives
        ]
    )


def _loading_peaks(arm: InstrumentedArm, sags: Array, loaded: Array, rate: float) -> Peaks:
    """Peaks of the commands while they make up for the sag of their servos."""
    found: Peaks = {}
    for i, drive in enumerate(arm.drives):
        if drive is not None and drive.servo:
            found |= command_peaks(i, sags[i] * loaded, rate, of_torque=False)
    return found


def _loaded(before: int, total: int) -> Array:
    """Share of the sag that commands make up for: none at either end, all while it is shaken."""
    rise = round(_LOADING * before)
    share = np.ones(total)
    if rise > 0:
        share[:rise] = 0.5 - 0.5 * np.cos(np.pi * np.arange(rise) / rise)
        share[total - rise :] = share[:rise][::-1]
    return share


def _scale(
    arm: InstrumentedArm,
    pose: Array,
    j: int,
    load: Array,
    holding: float,
    answer: LinearAnswer,
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
    ahead = answer.in_time(answer.torque * (1 + answer.s * drive.lag), OVERSAMPLED) / drive.gain
    low, high = drive.command_range
    spare, peak = min(holding - low, high - holding), float(np.abs(ahead).max())
    if spare < scale * peak:
        scale = max(spare, 0.0) / peak
        why = f"actuator {drive.actuator} takes commands from {low:g} to {high:g}"
    return scale, why
