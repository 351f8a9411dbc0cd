"""Checks of units, signs and axes: every channel beside what another source expects of it.

Commands of servos are compared with positions; velocities and gyroscopes with the motion of the
encoders; torques and motor commands with gravity and inertia, and with each other; accelerometers
with gravity.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations, product

import mujoco
import numpy as np

from loose_env.doctor.corrections import Correction, corrected
from loose_env.doctor.findings import Defect, DoctorSettings, Finding
from loose_env.doctor.machine import (
    BLOCK_S,
    Channel,
    Machine,
    Motion,
    carried,
    channels_of,
    forces_of,
    motion_of,
    positions_of,
    servos_of,
)
from loose_env.doctor.units import (
    ACCELERATION,
    ANGLE,
    FORCE,
    LEAST_BLOCKS,
    LENGTH,
    SCALE_NOTED,
    Pair,
    contradictions,
)
from loose_env.importing import filled, inverse_dynamics
from loose_env.recording import Run
from loose_env.typing import Array

# Signals
OVER_CONTROL_RANGE = 1.05
"""Command over its actuator's limit, above which it is a finding: the model clips it."""
LEAST_SPREAD_RAD = 0.02
"""Rms of the positions, from which position and command are compared [rad or m]: servo errors are
smaller."""
WEAK_AXIS = 0.3
"""Motion of a sensor's axis over that of its strongest, below which it is not judged: the strong
axes leak into it."""
LEAST_GRAVITY = 1.0
"""Acceleration that the model implies at rest, below which it has no gravity [m/s²]: models
for the moon have 1.6."""
UNCOUPLED = 0.13
"""Mean acceleration over gravity, below which an accelerometer does not measure gravity:
piezoelectric, or its mean was removed. A reading in g is 0.10 with 20 % of scatter."""
WRONG_AXES_DEG = 40.0
"""Angle between measured and predicted gravity, above which it is an error [deg]: no mounting
tolerance reaches half a right angle."""
EXPLAINED_DEG = 8.0
"""Angle left by another order or sign of the axes, or of one joint, up to which that is named
[deg]: mounting and pose are known to a few degrees."""
ALIKE_DEG = 1.0
"""Angle by which a further explanation may be worse than the best to be named too [deg]: less is
within the scatter of gravity over the poses."""

_EITHER = {"degrees beside radians": 180 / np.pi, "radians beside degrees": np.pi / 180}
_LENGTHS = {"millimetres beside metres": 1e3, "metres beside millimetres": 1e-3}
_POINTS = 500
"""Samples of a run that are looked at where the rows need no motion."""

BESIDE_GRAVITY = 0.1
"""Share of the mean square torque that commands lack which gravity leaves, below which they lack
gravity: friction and payloads are more beside it."""

_COMMANDED = Defect(
    "units", "error", "the model follows a command that the machine was not given",
    "import the column with its unit, or with sign = -1",
)  # fmt: skip
_CLIPS = Defect(
    "range", "warning", "the model clips the command, and the machine did not",
    "check the unit of the command (the actuator's own), and ctrlrange of the model",
)  # fmt: skip
_FAST = Defect(
    "range", "warning", "no arm moves so fast: unit, or lost samples",
    'import the column with its unit ("deg/s", "rpm")',
)  # fmt: skip
_MOTION = Defect(
    "units", "error", "readings and positions are taken for different motions",
    "import the column with its unit or with sign = -1, or turn the sensor's site in the model",
)  # fmt: skip
_REMARK = Defect("units", "note", _MOTION.consequence, _MOTION.remedy)
_DRIVEN = Defect(
    "units", "error", "the arm of the model is driven by another torque than the machine was",
    "import the column with sign = -1 or with its unit, or correct the gear of the actuator in the "
    "model",
)  # fmt: skip
_DISAGREE = Defect(
    "units", "error", "torque and command contradict each other, and one of them is used",
    "check the unit of both (the command's is the actuator's own), and gain and gear of the "
    "actuator in the model",
)  # fmt: skip
_DEAD = Defect(
    "stuck", "error", "its silence is taken for a measurement",
    "check cable and recorder, and record again: a sensor is read with all its axes or none",
)  # fmt: skip
_NOT_SI = Defect(
    "units", "error", "the transmission to the tool is wrong by that factor",
    'import the columns with their unit (unit = "g"), or convert them',
)  # fmt: skip
_WEIGHTLESS = Defect(
    "gravity", "warning", "under these commands the model falls",
    'set gravcomp="1" for the bodies of the model, as the controller does, or give measured '
    "torques in place of the commands",
)  # fmt: skip
_NO_GRAVITY = Defect(
    "gravity", "note", "its axes cannot be checked against gravity",
    "none is needed for vibration; check axes and signs by hand",
)  # fmt: skip
_TURNED = Defect(
    "axes", "warning",
    "axes or poses are not those of the model, and directions found are wrong",
    "exchange channels or set sign = -1 at the import, turn the sensor's site in the model, or "
    "correct the zero of the encoders",
)  # fmt: skip


def check_commands(
    machine: Machine, runs: Sequence[Run], settings: DoctorSettings
) -> Iterator[Finding]:
    """Compare commands of position servos with positions; ranges of commands and speeds."""
    pairs: dict[tuple[str, str], dict[str, Pair]] = {}
    for run in runs:
        measured = positions_of(machine, run)
        for drive, command in servos_of(machine, run):
            if drive.joint in measured:
                read = filled(run.time, measured[drive.joint].values)
                pair = Pair(_thin(command), _thin(read))
                pairs.setdefault((drive.name, drive.joint), {})[run.name] = pair
    wrong = set()
    for (name, joint), own in pairs.items():
        for found in contradictions(
            f"ctrl.{name}",
            f"the measured position of joint {joint}",
            own,
            _EITHER if machine.hinge(joint) else _LENGTHS,
            _COMMANDED,
            least=LEAST_SPREAD_RAD,
        ):
            wrong.add(name)
            yield found
    for run in runs:
        for c in channels_of(machine, run):
            servo = machine.drives.get(c.of) if c.kind == "command" else None
            limits = servo.limits if servo is not None and c.of not in wrong else None
            if limits and c.reach > OVER_CONTROL_RANGE * max(map(abs, limits)):
                told = f"reaches {c.reach:.4g}, and the actuator's limits are {limits}"
                yield _CLIPS.at(c.name, told, c.reach, run=run.name)
            if c.kind == "velocity" and c.reach > settings.fastest:
                unit = f"{machine.unit(c.of)}/s"
                told = f"reaches {c.reach:.4g} {unit}"
                yield _FAST.at(c.name, told, c.reach, unit=unit, run=run.name)


def _thin(values: Array) -> Array:
    return values[:: max(1, len(values) // _POINTS)]


def check_kinematics(machine: Machine, motions: Sequence[Motion]) -> Iterator[Finding]:
    """Compare velocities, gyroscopes and accelerometers with the motion of the encoders."""
    pairs: dict[tuple[str, str, str], dict[str, Pair]] = {}
    for motion in motions:
        for c, implied in implied_readings(machine, motion):
            if c.there.size and not np.ptp(c.there):
                told = f"every sample is {c.there[0]:.6g}, and the encoders imply motion there"
                yield _DEAD.at(c.name, told, float(c.there[0]), run=motion.run.name)
                continue
            read = motion.mean(c.values)
            pair = Pair(read - read.mean(), implied - implied.mean())
            pairs.setdefault((c.name, c.kind, c.of), {})[motion.run.name] = pair
    for (name, kind, of), own in pairs.items():
        angle = kind == "turning" or (kind == "velocity" and machine.hinge(of))
        units = ACCELERATION if kind == "acceleration" else ANGLE if angle else LENGTH
        # A rigid arm's dynamics are no judge of an amplitude above a resonance.
        defect = _REMARK if kind == "acceleration" else _MOTION
        yield from contradictions(
            name, "what the motion of the joints implies", own, units, defect,
            odd=np.inf, fixed=kind == "velocity",
        )  # fmt: skip


def implied_readings(machine: Machine, motion: Motion) -> Iterator[tuple[Channel, Array]]:
    """Channels that the encoders imply, each with the values that they imply."""
    model, measured = machine.model, positions_of(machine, motion.run)
    for c in channels_of(machine, motion.run):
        if c.kind not in ("acceleration", "turning", "velocity"):
            continue
        sensor = c.name.removeprefix("sensor.") if c.kind == "velocity" else c.of
        known = c.of in measured if c.kind == "velocity" else carried(machine, sensor, motion.known)
        if not known or not measured:
            continue
        at, width = (int(a[model.sensor(sensor).id]) for a in (model.sensor_adr, model.sensor_dim))
        axis = 0 if width == 1 else "xyz".index(c.name[-1])
        implied = motion.readings[:, at : at + width]
        spread = implied.std(axis=0)
        if spread[axis] >= WEAK_AXIS * spread.max() and spread.max() > 0.0:
            yield c, implied[:, axis]


def check_forces(machine: Machine, blocks: Sequence[Motion]) -> Iterator[Finding]:
    """Compare slow torques with gravity and inertia, and torque columns with motor commands."""
    needed: dict[tuple[str, str], dict[str, Pair]] = {}
    given: dict[str, dict[str, Pair]] = {}
    for motion in blocks:
        run = motion.run
        commanded = forces_of(machine, run, commands_only=True)
        for joint in commanded.keys() & run.torques.keys():
            torque = _thin(filled(run.time, run.torques[joint]))
            given.setdefault(joint, {})[run.name] = Pair(torque, _thin(commanded[joint][1]))
        if set(machine.joints) <= motion.known:  # a joint that is not may carry the rest
            for joint, (column, values) in forces_of(machine, run).items():
                dof = int(machine.model.jnt_dofadr[machine.model.joint(joint).id])
                pair = Pair(motion.mean(values), motion.torques[:, dof])
                needed.setdefault((joint, column), {})[run.name] = pair
    for joint, pairs in given.items():
        noun = "the torque that the command means by the model's gain and gear"
        yield from contradictions(f"torque.{joint}", noun, pairs, FORCE, _DISAGREE, odd=SCALE_NOTED)
    yield from _weightless(machine, blocks)
    for (_, column), pairs in needed.items():
        yield from contradictions(
            column, "the torque that gravity and inertia need", pairs, FORCE, _DRIVEN, friction=True
        )


def _weightless(machine: Machine, blocks: Sequence[Motion]) -> Iterator[Finding]:
    """Tell motor commands to which the controller adds gravity by itself."""
    lacking = beside = 0.0
    for motion in blocks:
        if motion.run.excited or not set(machine.joints) <= motion.known:
            continue
        still = np.zeros((2, len(motion.positions), machine.model.nv))
        weight = inverse_dynamics(machine.model, motion.positions, *still)
        for joint, (_, given) in forces_of(machine, motion.run, commands_only=True).items():
            dof = int(machine.model.jnt_dofadr[machine.model.joint(joint).id])
            lacks = motion.torques[:, dof] - motion.mean(given)
            lacking += float(lacks @ lacks)
            beside += float(np.sum((lacks - weight[:, dof]) ** 2))
    if beside < BESIDE_GRAVITY * lacking:
        share = 1 - beside / lacking
        found = f"gravity is {share:.0%} of what the motor commands lack of the torque needed"
        yield _WEIGHTLESS.at("ctrl", found, share, unit="1")


# ------------------------------------------------------------------------- gravity


def check_gravity(
    machine: Machine, blocks: Sequence[Motion], settings: DoctorSettings
) -> Iterator[Finding]:
    """Compare the slow part of every accelerometer with gravity: unit, axes, signs of joints."""
    model = machine.model
    for sensor in dict.fromkeys(name for motion in blocks for name in motion.run.sensors):
        if int(model.sensor_type[model.sensor(sensor).id]) != int(
            mujoco.mjtSensor.mjSENS_ACCELEROMETER
        ):
            continue
        felt = _gravity_pairs(machine, sensor, blocks)
        # A small mean that does not point along gravity is no acceleration in g.
        silent = {
            run: felt.pop(run)
            for run, pair in [*felt.items()]
            if _size(pair.measured) < UNCOUPLED * _size(pair.expected)
            and _angle([pair]) > WRONG_AXES_DEG
        }
        for run, (measured, expected) in [*silent.items()][:1]:
            found = f"reads {_size(measured):.4g} m/s² at rest, and gravity is "
            found += f"{_size(expected):.4g} m/s²: piezoelectric, or the mean was removed"
            of, name = f"sensor.{sensor}", run if felt else ""
            yield _NO_GRAVITY.at(of, found, _size(measured), unit="m/s²", run=name)
        sizes = {run: Pair(*(np.linalg.norm(x, axis=1) for x in p)) for run, p in felt.items()}
        if sizes:
            yield from contradictions(
                f"sensor.{sensor}", "gravity at rest", sizes, ACCELERATION, _NOT_SI, odd=SCALE_NOTED
            )
            own = [m for m in blocks if m.run.name in felt]
            yield from _turned(machine, sensor, [*felt.values()], own, settings)


def _gravity_pairs(machine: Machine, sensor: str, blocks: Sequence[Motion]) -> dict[str, Pair]:
    """Measured and implied acceleration of each run by blocks, shape (N, 3) [m/s²]."""
    at, pairs = int(machine.model.sensor_adr[machine.model.sensor(sensor).id]), {}
    for motion in blocks:
        columns = motion.run.sensors.get(sensor)
        if columns is None or not carried(machine, sensor, motion.known):
            continue
        if (np.nanstd(columns, axis=0) == 0).any():
            continue  # a dead axis is a finding of its own
        measured = np.stack([motion.mean(column) for column in columns.T], axis=1)
        expected = motion.readings[:, at : at + 3]
        if len(measured) >= LEAST_BLOCKS and _size(expected) >= LEAST_GRAVITY:
            pairs[motion.run.name] = Pair(measured, expected)
    return pairs


def _size(values: Array) -> float:
    return float(np.median(np.linalg.norm(values, axis=1)))


def _angle(parts: Sequence[Pair]) -> float:
    """Median angle between measured and implied gravity in the run where it is largest [deg].

    Axes that are wrong show in some poses alone, and each run holds a pose or moves through many.
    """
    worst = 1.0
    for measured, expected in parts:
        lengths = np.linalg.norm(measured, axis=1) * np.linalg.norm(expected, axis=1)
        cosine = np.einsum("ij,ij->i", measured, expected) / np.maximum(lengths, 1e-12)
        worst = min(worst, float(np.median(cosine)))
    return float(np.degrees(np.arccos(np.clip(worst, -1.0, 1.0))))


def _turned(
    machine: Machine, sensor: str, parts: Sequence[Pair], blocks: Sequence[Motion],
    settings: DoctorSettings,
) -> Iterator[Finding]:  # fmt: skip
    """Judge the direction of gravity, and say which axes or encoders would explain it."""
    turned = _angle(parts)
    if turned > settings.turned_deg:
        reasons = [*_by_axes(parts), *_by_joints(machine, sensor, blocks)]
        reasons = sorted(each for each in reasons if each[0] <= EXPLAINED_DEG)
        alike = [words for angle, words in reasons if angle <= reasons[0][0] + ALIKE_DEG][:3]
        found = f"gravity is {turned:.0f} degrees from where the model has it in the measured poses"
        found += f"; explained by {' or by '.join(alike)}" if alike else ""
        severity = "error" if turned > WRONG_AXES_DEG else "warning"
        yield _TURNED.at(f"sensor.{sensor}", found, turned, unit="deg", severity=severity)


def _by_axes(parts: Sequence[Pair]) -> Iterator[tuple[float, str]]:
    """Angles left with axes exchanged or reversed, the fewest changes first."""
    ways: dict[int, list[tuple[float, str]]] = {}
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        changes = sum(o != i for i, o in enumerate(order)) + signs.count(-1)
        left = _angle([Pair(m[:, order] * np.array(signs), e) for m, e in parts])
        if changes and left <= EXPLAINED_DEG:
            words = [
                f"{'xyz'[i]} = {'-' if s < 0 else ''}{'xyz'[o]} of the recording"
                for i, (o, s) in enumerate(zip(order, signs, strict=True))
                if o != i or s < 0
            ]
            ways.setdefault(changes, []).append((left, "axes " + ", ".join(words)))
    yield from ways[min(ways)] if ways else ()


def _by_joints(
    machine: Machine, sensor: str, blocks: Sequence[Motion]
) -> Iterator[tuple[float, str]]:
    """Angles left with the encoder of one joint reversed."""
    usual = _gravity_pairs(machine, sensor, blocks)
    for joint in machine.joints:
        moved = []
        for motion in blocks:
            encoder = positions_of(machine, motion.run).get(joint)
            if encoder is not None:
                fix = Correction(kind="scale", columns=(encoder.name,), factor=-1.0)
                moved.append(motion_of(machine, corrected(motion.run, [fix]), BLOCK_S))
        pairs = _gravity_pairs(machine, sensor, [m for m in moved if m is not None])
        if pairs and pairs.keys() == usual.keys():
            change = [Pair(pairs[name].expected, usual[name].expected) for name in pairs]
            if _angle(change) > EXPLAINED_DEG:
                yield _angle([*pairs.values()]), f"the opposite sign of joint {joint}'s encoder"
