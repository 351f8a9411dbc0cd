"""Checks of joint positions and noted poses: unit, sign, ticks, turns, limits; notes of commands.

Every run says of each of its joints what unit it is in, by the pose noted or by the joint's limits;
a joint that says nothing has the unit of the run's other joints of its kind.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from loose_env.doctor.corrections import Correction
from loose_env.doctor.findings import Defect, DoctorSettings, Finding
from loose_env.doctor.machine import (
    Channel,
    Machine,
    channels_of,
    positions_of,
    servos_of,
)
from loose_env.doctor.units import ANGLE, LENGTH, UNIT_MATCH, grouped, named_unit
from loose_env.importing import coding_of, filled
from loose_env.recording import Run
from loose_env.typing import Array

# Positions
OUT_OF_RANGE_RAD = 0.1
"""Excess over a joint's limit, above which it is a finding [rad]: a wrong zero is within."""
OUT_OF_RANGE_M = 0.02
"""The same of a prismatic joint [m]: a wrong zero is within."""
OTHER_UNIT = 3.0
"""Reach of a position over its joint's limit, from which another unit is the reason and not a wrong
zero: degrees reach 57 times as far."""
MANY_TURNS_RAD = 20.0
"""Position of a hinge without limits, above which degrees are suspected [rad]: three turns."""
LEAST_POSE = 0.2
"""Largest noted position, below which measured positions are not compared with the notes [rad or
m]: ten times a wrong zero."""
POSE_SPREAD = 0.2
"""Rms motion of a joint in a run with a noted pose, above which it is a finding, and a diagnosis
refuses the run [rad or m]: shaking about a pose stays within 0.1."""
LEAST_TICKS = 50.0
"""Range of a position of whole numbers, from which they are encoder ticks: as radians they would
be eight turns."""

_UNIT, _SIGN, _NOTED, _TICKS, _LIMITS = "unit", "sign", "noted", "ticks", "limits"
_ALIKE = "alike"  # says nothing itself, and the run's others are in another unit
_WRONG_UNIT = Defect(
    "units", "error", "every pose and every prediction of the model is wrong by that factor",
    'import the column with its unit (unit = "deg" or "mm"), or convert it',
)  # fmt: skip
_COUNTS = replace(
    _WRONG_UNIT,
    remedy="import the column with scale = 2π over the ticks per turn, and with its zero",
)
_WRONG_SIGN = Defect(
    "sign", "error", "the model is compared in another pose, and its motion runs backwards",
    "import the column with sign = -1, or turn the joint's axis in the model",
)  # fmt: skip
_WRONG_NOTE = Defect(
    "units", "error", "the noted pose is not the one that was held", "note the pose in rad or m"
)
_WRAPS = Defect(
    "range", "error", "each jump passes for a motion of a whole turn within a sample",
    "--fix DIR writes the recording with the lost turns put back",
)  # fmt: skip
_OUTSIDE = Defect(
    "range", "warning",
    "the model pushes the joint back into its limits, which the machine does not",
    "check the zero, the sign and the unit of the encoder, and the limits of the model",
)  # fmt: skip
_MOVES = Defect(
    "pose", "warning", "a diagnosis refuses a run that moves through poses",
    "hold the pose, or leave 'pose' out and use 'loose gap'",
)  # fmt: skip
_ELSEWHERE = Defect(
    "pose", "warning",
    "the measured pose is used; where the entry is right, the encoder is not",
    "note the pose that was held, or record the run again in that pose",
)  # fmt: skip
_FREE = Defect(
    "commands", "warning", "the run is taken for a free response, its drives off",
    "record the commands or the joint torques in every run; let go of the arm for free responses",
)  # fmt: skip
_ZERO = Defect(
    "commands", "warning", "simulated with a command of 0",
    "record the commands of all actuators of the model, or take out those that the machine has not",
)  # fmt: skip


def check_turns(machine: Machine, runs: Sequence[Run]) -> Iterator[Finding]:
    """Look for turns that encoders lose."""
    for joint in filter(machine.hinge, machine.joints):
        own = [(r, c[joint]) for r in runs if joint in (c := positions_of(machine, r))]
        turns = [(run, channel.name, n) for run, channel in own if (n := _wraps(channel.there))]
        if turns:
            count, column = sum(n for *_, n in turns), turns[0][1]
            found = f"jumps by a turn of 2π rad {count} time{'s' * (count > 1)}: its encoder wraps"
            fix = Correction(kind="unwrap", columns=(column,))
            yield _WRAPS.at(column, f"{found} round", float(count), unit="jumps", fix=fix)


def _wraps(values: Array) -> int:
    """Jumps by a turn, as an import would find them; none where other steps are large too."""
    wrapped = coding_of(values)[0] == 2 * np.pi
    return int(np.count_nonzero(np.abs(np.diff(values)) > np.pi)) if wrapped else 0


def check_positions(
    machine: Machine, runs: Sequence[Run], settings: DoctorSettings
) -> Iterator[Finding]:
    """Judge unit and sign of every joint's positions, of all runs together where they agree."""
    told = _told(machine, runs, settings)
    for joint in machine.joints:
        own = {r.name: (r, c[joint]) for r in runs if joint in (c := positions_of(machine, r))}
        said = {name: told.get((name, joint)) for name in own}
        for name, parts in grouped(own, said):
            word = said[parts[0][0].name] if name else next(filter(None, said.values()), None)
            found = _judged(machine, joint, parts, word)
            if found is not None:
                yield replace(found, run=name, fix=found.fix and found.fix.of(name))


def _told(
    machine: Machine, runs: Sequence[Run], settings: DoctorSettings
) -> dict[tuple[str, str], str]:
    """Defect that a run by itself tells of a joint's positions: "" for none."""
    told: dict[tuple[str, str], str] = {}
    for run in runs:
        measured = positions_of(machine, run)
        said = {j: _alone(machine, run, j, c.there, settings) for j, c in measured.items()}
        noted = [j for j in measured if abs((run.pose or {}).get(j, 0.0)) >= LEAST_POSE]
        # An entry that fits no joint but for its sign is that of another run.
        believed = all(said[joint] is not None for joint in noted)
        for hinge in (True, False):
            own = {j: word for j, word in said.items() if machine.hinge(j) == hinge}
            words = set(own.values()) - {None}
            others = _ALIKE if words and words <= {_UNIT, _LIMITS} else None
            for joint, word in own.items():
                word = others if word is None and others else word
                if word is not None and (believed or word != _SIGN):
                    told[run.name, joint] = word
    wrong = {joint for (_, joint), word in told.items() if word in (_UNIT, _LIMITS, _ALIKE)}
    for run in runs:  # beside a run in another unit, the ones that fit are in the right one
        for joint in wrong & set(positions_of(machine, run)):
            told.setdefault((run.name, joint), "")
    return told


def _alone(
    machine: Machine, run: Run, joint: str, values: Array, settings: DoctorSettings
) -> str | None:
    """Judge one joint of one run by its pose and its limits; None where they tell nothing."""
    if not values.size:
        return None
    if np.all(values == np.round(values)) and np.ptp(values) > LEAST_TICKS and machine.hinge(joint):
        return _TICKS
    noted, mean = (run.pose or {}).get(joint, 0.0), float(np.mean(values))
    if abs(noted) >= LEAST_POSE:
        units = ANGLE if machine.hinge(joint) else LENGTH
        if abs(mean - noted) <= max(settings.pose_offset, UNIT_MATCH * abs(noted)):
            return ""
        if abs(mean + noted) <= settings.pose_offset:
            return _SIGN
        if named_unit(mean / noted, units):
            return _UNIT
        if mean and named_unit(noted / mean, units):
            return _NOTED
    if not _outside_by_unit(machine, joint, values):
        return None
    consistent = machine.joints[joint].limits is None and _moves_alike(machine, run, joint)
    return None if consistent else _LIMITS


def _moves_alike(machine: Machine, run: Run, joint: str) -> bool:
    """Return whether a command or a velocity of the joint has the unit that its positions have."""
    beside = [(command, 0) for drive, command in servos_of(machine, run) if drive.joint == joint]
    beside += [
        (filled(run.time, c.values), 1)
        for c in channels_of(machine, run)
        if c.kind == "velocity" and c.of == joint
    ]
    position = filled(run.time, positions_of(machine, run)[joint].values)
    own = (position, np.gradient(position, run.time))
    return any(0.5 < np.std(other) / max(np.std(own[k]), 1e-12) < 2.0 for other, k in beside)


def _outside_by_unit(machine: Machine, joint: str, values: Array) -> bool:
    """Return whether positions are outside the limits as they stand, and inside once converted."""
    limits = machine.joints[joint].limits
    if limits is None:
        return machine.hinge(joint) and float(np.abs(values).max()) > MANY_TURNS_RAD
    (factor,) = (ANGLE if machine.hinge(joint) else LENGTH).values()
    far = np.abs(values).max() >= OTHER_UNIT * max(map(abs, limits))
    inside = not _excess(machine, joint, values / factor)
    return bool(far and inside and _excess(machine, joint, values))


def _excess(machine: Machine, joint: str, values: Array) -> float:
    """Excess of samples over the limits of their joint [rad or m]; 0 for a wrong zero's."""
    low, high = machine.joints[joint].limits or (-np.inf, np.inf)
    excess = float(max(low - values.min(initial=np.inf), values.max(initial=-np.inf) - high))
    return (
        excess if excess > (OUT_OF_RANGE_RAD if machine.hinge(joint) else OUT_OF_RANGE_M) else 0.0
    )


def _judged(
    machine: Machine, joint: str, parts: Sequence[tuple[Run, Channel]], word: str | None
) -> Finding | None:
    """Finding for the defect that runs tell of a joint."""
    (run, channel), *_ = parts
    mean, noted = float(np.mean(channel.there)) if channel.there.size else 0.0, run.pose or {}
    ((words, factor),) = (ANGLE if machine.hinge(joint) else LENGTH).items()
    reach = max(c.reach for _, c in parts)
    pair = f"measured {mean:.4g}, noted {noted.get(joint, 0.0):.4g} in {run.name}"
    fix = Correction(kind="scale", columns=(channel.name,), factor=1 / factor)
    if word in (_UNIT, _LIMITS, _ALIKE):
        limits, found = machine.joints[joint].limits, f"reaches {reach:.4g}: {words} ({pair})"
        if joint not in noted or abs(noted[joint]) < LEAST_POSE:
            within = f"goes from {limits[0]:.3g} to {limits[1]:.3g}" if limits else "has no limits"
            found = f"reaches {reach:.4g}, and joint {joint} {within}: probably {words}"
        certain = word == _UNIT or (word == _LIMITS and limits is not None)
        found += " as the others" * (word == _ALIKE)
        return _WRONG_UNIT.at(
            channel.name, found, reach, unit=machine.unit(joint), fix=fix,
            severity="error" if certain else "warning",
        )  # fmt: skip
    if word == _SIGN:
        fix = replace(fix, factor=-1.0)
        return _WRONG_SIGN.at(
            channel.name, f"has the opposite sign of the pose noted ({pair})", mean, fix=fix
        )
    if word == _NOTED:
        return _WRONG_NOTE.at(
            f"pose of {joint}", f"{pair}: noted in {words.partition(' ')[0]}", noted[joint]
        )
    if word == _TICKS:
        low, high = channel.there.min(), channel.there.max()
        found = f"holds whole numbers from {low:.0f} to {high:.0f}: encoder ticks"
        return _COUNTS.at(channel.name, found, float(high))
    return None


def check_entries(
    machine: Machine, runs: Sequence[Run], settings: DoctorSettings
) -> Iterator[Finding]:
    """Compare limits, and the entries of all runs, with the columns in the right units."""
    driven = any(run.controls or run.torques for run in runs)
    # Sessions of 'loose plan' hold a pose: what shakes them is in the plan.
    if machine.drives and not driven and any(run.pose is None for run in runs):
        names = _some(list(machine.drives))
        yield _FREE.at("ctrl", f"no commands and no torques, and the model has actuators ({names})")
    for run in runs:
        measured = positions_of(machine, run)
        for joint, channel in measured.items():
            excess, unit = _excess(machine, joint, channel.there), machine.unit(joint)
            if excess:
                low, high = machine.joints[joint].limits or (0.0, 0.0)
                found = f"{excess:.3g} {unit} outside joint {joint}'s limits of {low:.4g} to "
                found += f"{high:.4g} {unit}"
                yield _OUTSIDE.at(channel.name, found, excess, unit=unit, run=run.name)
        if run.pose is not None:
            yield from _pose(machine, run, measured, runs, settings)
        if driven and not run.controls and not run.torques:
            found = "no command and no torque, and other runs have them"
            yield _FREE.at("ctrl", found, run=run.name)
        missing = [
            name for name, drive in machine.drives.items()
            if name not in run.controls and drive.joint not in run.torques
        ]  # fmt: skip
        if missing and run.controls and not run.excited:  # else the other joints are braked
            found = f"no command of {_some(missing)}, and other actuators have theirs"
            yield _ZERO.at(f"ctrl.{missing[0]}", found, run=run.name)


def _some(names: Sequence[str]) -> str:
    """List names, the first three of many."""
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _pose(
    machine: Machine, run: Run, measured: Mapping[str, Channel], runs: Sequence[Run],
    settings: DoctorSettings,
) -> Iterator[Finding]:  # fmt: skip
    """Compare a noted pose with the measured one."""
    mean = {j: float(np.mean(c.there)) for j, c in measured.items() if c.there.size}

    def off(pose: Mapping[str, float] | None) -> tuple[float, str]:
        both = [(abs(mean[j] - q), j) for j, q in (pose or {}).items() if j in mean]
        return max(both, default=(0.0, ""))

    for joint in mean:
        spread, unit = float(np.std(measured[joint].there)), machine.unit(joint)
        if joint in (run.pose or {}) and spread > POSE_SPREAD:
            found = f"moves by {spread:.3g} {unit} rms, and a held pose is noted"
            yield _MOVES.at(joint, found, spread, unit=unit, run=run.name)
    worst, joint = off(run.pose)
    if worst > settings.pose_offset and run.pose:
        unit = machine.unit(joint)
        fits = (
            each.name for each in runs if each.pose and off(each.pose)[0] <= settings.pose_offset
        )
        found = f"measured {mean[joint]:.4g} {unit}, noted {run.pose[joint]:.4g} {unit}"
        other = next(fits, None)
        if other is not None:
            found += f": the pose noted for {other}; two entries of recording.json seem exchanged"
        yield _ELSEWHERE.at(joint, found, worst, unit=unit, run=run.name)
