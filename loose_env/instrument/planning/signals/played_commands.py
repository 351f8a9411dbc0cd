"""Commands that play a noise torque, as actuator, torque, position or velocity columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.model.actuators import JointDrive
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.planning.signals.linear_answer import OVERSAMPLED, LinearAnswer
from loose_env.instrument.planning.signals.motion_peaks import Peaks, command_peaks, highest
from loose_env.instrument.settings.motion import CommandKind
from loose_env.typing import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ExcitedCommand:
    """Command of the excited joint at the scale 1, without what holds the pose."""

    kind: CommandKind
    """Kind of the commands."""
    own: Array
    """In the actuator's own unit (T,)."""
    shown: Array
    """As position of the joint [rad or m], or torque [N·m, N], by the kind (T,)."""
    of_torque: bool
    """True if `shown` is a torque."""
    peaks: Peaks
    """Its peaks at the scale 1."""


def excited_command(
    kind: CommandKind,
    drive: JointDrive,
    answer: LinearAnswer,
    j: int,
    envelope: Array,
    index: NDArray[np.intp],
    rate: float,
) -> ExcitedCommand:
    """Command of the excited joint for a noise torque.

    A model's actuator is given the torque ahead of its lag, divided by its gain: for a servo, the
    position whose tracking error makes that torque. A controller that follows positions or
    velocities is given the motion itself that the torque would make.
    """
    ahead = answer.torque * (1 + answer.s * drive.lag)
    lines: ComplexArray = ahead
    of_torque = True
    if kind == "model" and drive.servo:
        lines, of_torque = ahead / drive.stiffness, False
    elif kind == "torque":
        lines = answer.torque
    elif kind in ("position", "velocity"):
        lines, of_torque = answer.moved[j], False
    shown = envelope * answer.in_time(lines)[index]
    sampled = command_peaks(j, shown, rate, of_torque=of_torque)
    # Between its samples a controller interpolates; the envelope is at most 1.
    fine = np.asarray(answer.in_time(lines, OVERSAMPLED))
    between = command_peaks(j, np.append(fine, fine[:4]), OVERSAMPLED * rate, of_torque=of_torque)
    return ExcitedCommand(
        kind=kind,
        own=envelope * answer.in_time(ahead)[index] / drive.gain,
        shown=shown,
        of_torque=of_torque,
        peaks=highest(sampled, between),
    )


def played_columns(
    arm: InstrumentedArm,
    pose: Array,
    joint: int,
    command: ExcitedCommand,
    scale: float,
    commands: dict[str, Array],
    rate: float,
) -> dict[str, Array]:
    """Columns of the signal's files, without time.

    ``ctrl.ACTUATOR`` in the actuators' own units for commands of the model's kind; else
    ``position.JOINT`` [rad or m], ``velocity.JOINT`` [rad/s or m/s] or ``torque.JOINT`` [N·m, N]
    of every joint. Torque is what is to be added to that of the controller, which holds the arm.
    """
    if command.kind == "model":
        return {f"ctrl.{name}": values for name, values in commands.items()}
    moving = scale * command.shown
    found = {}
    for i, name in enumerate(arm.joints):
        own = moving if i == joint else np.zeros(len(moving))
        if command.kind == "position":
            own = pose[i] + own
        elif command.kind == "velocity":
            # Held until the next sample, it leads to the next position exactly.
            own = np.append(np.diff(own), 0.0) * rate
        found[f"{command.kind}.{name}"] = own
    return found
