"""Proposal of a mapping: a column for each channel that belongs to the model, with its reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from loose_env.importing.guessing.commands import (
    commanded_motion,
    matched_commands,
    needed_torques,
    smoothed,
    torques_by_signal,
)
from loose_env.importing.guessing.joint_targets import (
    accelerometer_axes,
    joint_targets,
)
from loose_env.importing.guessing.quantities import admits, quantity_of
from loose_env.importing.guessing.roles import (
    Assigned,
    Candidate,
    assigned_by_name,
    assigned_by_signal,
)
from loose_env.importing.guessing.signals import correlation, derivative, moves, slope
from loose_env.importing.guessing.source_signals import LogSource, other_channels, read_signals
from loose_env.importing.guessing.units_by_range import (
    Scaling,
    group_unit,
    normalised_scaling,
    position_scaling,
    rate_unit,
)
from loose_env.importing.mapping.units import unit_named
from loose_env.importing.samples import Channel
from loose_env.recording import ModelColumns
from loose_env.typing import Array

_TRUSTED = 0.5
"""Correlation from which a sign is read off a channel [1]."""

_SAME_UNIT = 3.0
"""Factor by which a measured torque may differ from the model's to count as one in N·m [1]."""


@dataclass(frozen=True, kw_only=True)
class ProposedColumn:
    """One line of a proposal."""

    column: str
    """Column of the model; "" where it has none for the channel."""
    candidate: Candidate
    scaling: Scaling
    sign: int
    reason: str
    open: bool = False
    """True if something is missing, so that the line is left as a comment."""


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A proposed mapping."""

    logs: Mapping[str, LogSource]
    columns: tuple[ProposedColumn, ...]
    notes: tuple[str, ...]
    unassigned: tuple[tuple[str, Channel], ...] = ()
    """Sources and channels for which no column was found."""


def propose(
    sources: Sequence[str], model: mujoco.MjModel, rate_hz: float | None = None
) -> Proposal:
    """Propose a mapping of files to the columns of a model.

    Parameters
    ----------
    sources : sequence of str
        Files, or ``NAME=PATH``.
    model : mujoco.MjModel
        The model.
    rate_hz : float, optional
        Sampling rate of files without times [Hz].

    Raises
    ------
    InvalidData
        If a file cannot be read or its times are not known.
    """
    logs, candidates, step, notes = read_signals(sources, rate_hz)
    return _Guess(model, logs, candidates, step, notes).proposal()


class _Guess:
    """A proposal while it is made."""

    def __init__(
        self,
        model: mujoco.MjModel,
        logs: dict[str, LogSource],
        candidates: list[Candidate],
        step: float,
        notes: list[str],
    ) -> None:
        self.model, self.logs, self.step, self.notes = model, logs, step, notes
        self.candidates = candidates
        self.targets = joint_targets(model)
        self.columns: dict[str, ProposedColumn] = {}
        self.open: list[ProposedColumn] = []
        self.used: set[int] = set()
        self.positions: dict[str, Array] = {}
        self.scalings: dict[str, Scaling] = {}

    def proposal(self) -> Proposal:
        direct = self._direct()
        rest = [c for c in self.candidates if id(c) not in self.used]
        named = assigned_by_name(rest, self.targets)
        known = {(each.role, each.joint.name) for each in direct}
        found = direct + [each for each in named if (each.role, each.joint.name) not in known]
        if not any(each.role == "position" for each in found):
            bare = [c for c in rest if c.meaning.role == ""]
            found += assigned_by_signal(bare, self.targets, self.step)
        self.used |= {id(each.candidate) for each in found}
        self._take_positions([each for each in found if each.role == "position"])
        for each in found:
            if each.role == "velocity":
                self._take_velocity(each)
        torques = needed_torques(self.model, self.positions, self.step)
        commands = [each for each in found if each.role == "command"]
        self._take_commands(commands, torques)
        self._take_torques(found, torques)
        self._take_accelerometer()
        if not self.columns and not self.open:
            self.notes.append("no channel was recognised; name columns by loose import --describe")
        lines = [*self.columns.values(), *self.open]
        taken = {(each.candidate.source, each.candidate.key) for each in lines}
        return Proposal(
            logs=self.logs,
            columns=(*self.columns.values(), *self.open),
            notes=tuple(self.notes),
            unassigned=other_channels(self.logs, taken),
        )

    def _direct(self) -> list[Assigned]:
        """Channels that are named as the model's columns, sensors, actuators or joints."""
        known = ModelColumns.of(self.model).known
        joints = {each.name: each for each in self.targets}
        places = {
            column: (role, joint)
            for joint in self.targets
            for role, column in (
                ("position", joint.position),
                ("velocity", joint.velocity),
                ("torque", joint.torque),
                ("command", joint.command),
            )
            if column
        }
        found = []
        for each in self.candidates:
            text = each.key.channel
            words = f"named as the model's {text!r}"
            axis = {"[0]": ".x", "[1]": ".y", "[2]": ".z"}.get(text[-3:], "")
            names = [text, f"sensor.{text}", f"sensor.{text[:-3]}{axis}" if axis else ""]
            names.append(f"ctrl.{text.removesuffix('_ctrl')}" if text.endswith("_ctrl") else "")
            column = next((name for name in names if name in known), "")
            joint = joints.get(text.removesuffix("_qpos").removesuffix("_qvel"))
            if not column and joint is not None and text.endswith(("_qpos", "_qvel")):
                role = "position" if text.endswith("_qpos") else "velocity"
                column = joint.position if role == "position" else joint.velocity
            if column in places:
                role, joint = places[column]
                found.append(
                    Assigned(
                        candidate=each,
                        role=role,  # type: ignore[arg-type]
                        joint=joint,
                        reason=words,
                        labelled=True,
                    )
                )
                self.used.add(id(each))
            elif column:
                self.used.add(id(each))
                self._add(column, each, Scaling(each.unit), 1, words)
        return found

    def _add(
        self, column: str, candidate: Candidate, scaling: Scaling, sign: int, *reasons: str
    ) -> None:
        reason = "; ".join(filter(None, reasons))
        line = ProposedColumn(
            column=column, candidate=candidate, scaling=scaling, sign=sign, reason=reason
        )
        if column and column not in self.columns:
            self.columns[column] = line
        else:
            self.open.append(replace(line, open=True))

    def _leave_open(
        self, each: Assigned, column: str, scaling: Scaling, sign: int, words: str
    ) -> None:
        """Add a line that lacks something, as a comment."""
        self.open.append(
            ProposedColumn(
                column=column,
                candidate=each.candidate,
                scaling=scaling,
                sign=sign,
                reason=f"{each.reason}; {words}",
                open=True,
            )
        )

    def _given_unit(self, candidate: Candidate) -> tuple[str, str]:
        """Unit of an angle that the file or its format defines, and which; "" where neither."""
        if candidate.unit:
            return candidate.unit, "as the file says"
        kind = self.logs[candidate.source].file.kind
        rtde = candidate.key.channel.startswith(("actual_q", "target_q"))
        defined = kind in ("mcap", "rosbag2", "sysid", "hdf5") or rtde
        return ("rad", "as the format defines") if defined else ("", "")

    def _take_positions(self, found: Sequence[Assigned]) -> None:
        common = group_unit([e.joint for e in found], [e.candidate.values for e in found])
        # One joint whose values are no degrees, but may be normalised, tells it of its vector.
        normalised = common == "deg" and any(
            not _fits(e, "deg") and normalised_scaling(e.joint, e.candidate.values)
            and not self._given_unit(e.candidate)[0]
            for e in found
        )  # fmt: skip
        for each in found:
            unit, why = self._given_unit(each.candidate)
            if each.joint.slide:
                unit = "m" if unit == "rad" else unit
            elif not unit and _fits(each, common):
                unit, why = common, "fits most joints of the vector"
                if common == "deg" and np.max(np.abs(each.candidate.values)) <= 100:
                    why += "; values normalised to -100..100 would look alike"
            scaling = position_scaling(each.joint, each.candidate.values, unit, why)
            if normalised and not each.candidate.unit:
                scaling = normalised_scaling(each.joint, each.candidate.values) or scaling
            if scaling is None:
                words = f"its values or unit fit no unit of {each.joint.name!r}"
                self._leave_open(each, each.joint.position, Scaling(""), 1, words)
                continue
            self.positions[each.joint.name] = _si(each.candidate.values, scaling)
            self.scalings[each.joint.name] = scaling
            if each.joint.position:
                self._add(
                    each.joint.position, each.candidate, scaling, 1, each.reason, scaling.reason
                )
            else:
                name = each.joint.name
                self._add("", each.candidate, scaling, 1, each.reason)
                self.notes.append(
                    f"the model has no sensor for the position of {name!r}: add "
                    f'<jointpos name="{name}_position" joint="{name}"/> to its <sensor>'
                )

    def _take_velocity(self, each: Assigned) -> None:
        slide = each.joint.slide
        unit, sign, words = each.candidate.unit, 1, ""
        position = self.positions.get(each.joint.name)
        if position is not None and moves(position) and moves(each.candidate.values):
            rate = derivative(position, self.step)
            value, ratio = correlation(rate, each.candidate.values), 0.0
            if abs(value) >= _TRUSTED:
                ratio = slope(rate, each.candidate.values)
                sign = 1 if value > 0 else -1
            unit = unit or rate_unit(ratio, slide)
            words = (
                f"{abs(ratio):.3g} times the derivative of the position, correlation {value:.2f}"
            )
        unit = unit or ("m/s" if slide else "rad/s")
        self._add(each.joint.velocity, each.candidate, Scaling(unit), sign, each.reason, words)

    def _take_commands(self, commands: Sequence[Assigned], torques: Array | None) -> None:
        motion = commanded_motion(self.targets, self.positions, torques, self.model, self.step)
        for each, like in matched_commands(commands, motion, self.step):
            values, name = each.candidate.values, each.joint.name
            trusted = like is not None and abs(like.correlation) >= _TRUSTED
            sign = -1 if trusted and like is not None and like.correlation < 0 else 1
            words = "moves against it, so its sign or the sensor's is reversed" if sign < 0 else ""
            scaling = Scaling("")
            if each.joint.drive == "position":
                own = self.scalings.get(name)
                ratio = abs(slope(motion[name], values)) if trusted else 0.0
                if own is not None and own.scale != 1.0:
                    scaling = Scaling(own.unit, own.scale, own.offset, "scaled as the position")
                elif ratio and not each.joint.slide:
                    unit = {"rad/s": "rad", "deg/s": "deg"}.get(rate_unit(ratio, False), "")
                    scaling = Scaling(unit, reason=f"{ratio:.3g} times the position [rad]")
                unit = scaling.unit or (own.unit if own else self._given_unit(each.candidate)[0])
                scaling = replace(scaling, unit=unit)
            elif each.joint.drive == "velocity" and trusted:
                ratio = abs(slope(motion[name], values))
                scaling = Scaling(rate_unit(ratio, each.joint.slide))
            self._add(each.joint.command, each.candidate, scaling, sign, each.reason, words,
                      scaling.reason)  # fmt: skip

    def _take_torques(self, found: Sequence[Assigned], torques: Array | None) -> None:
        for each in found:
            if each.role == "torque":
                unit = each.candidate.unit or ("N" if each.joint.slide else "N*m")
                sign, words = self._torque_sign(each, torques)
                self._add(
                    each.joint.torque, each.candidate, Scaling(unit), sign, each.reason, words
                )
            elif each.role == "current":
                words = "a current [A]: give the torque constant and gear as scale [N·m/A]"
                factor = self._per_ampere(each, torques)
                if factor:
                    words += f"; {factor:.4g} fits the torque that the model needs"
                scaling = Scaling("N*m", abs(factor) or 1.0)
                self._leave_open(each, each.joint.torque, scaling, -1 if factor < 0 else 1, words)
        if torques is None:
            return
        rest = [c for c in self.candidates if id(c) not in self.used and c.meaning.role == ""]
        rest = [c for c in rest if quantity_of(c.unit) in ("", "torque", "force", "current")]
        for each, value in torques_by_signal(rest, self.targets, torques, self.model):
            drives = each.joint.drive == "torque" and each.joint.command
            free = bool(drives) and each.joint.command not in self.columns
            column = each.joint.command if free else each.joint.torque
            sign = 1 if value > 0 else -1
            unit, slide = each.candidate.unit, each.joint.slide
            if not admits(unit, "torque", slide=slide) and quantity_of(unit) != "current":
                continue
            self.used.add(id(each.candidate))
            own = torques[:, self.model.joint(each.joint.name).dofadr[0]]
            ratio = abs(slope(each.candidate.values, own))
            words = "taken as the command of its motor" if free else ""
            if not free and not 1 / _SAME_UNIT < ratio < _SAME_UNIT:
                words = f"{ratio:.4g} times it would be that torque [N·m]; is it a current?"
                self._leave_open(each, column, Scaling("N*m", ratio), sign, words)
                continue
            self._add(column, each.candidate, Scaling("" if free else "N*m"), sign, each.reason,
                      words)  # fmt: skip

    def _torque_sign(self, each: Assigned, torques: Array | None) -> tuple[int, str]:
        if torques is None or not moves(each.candidate.values):
            return 1, ""
        own = torques[:, self.model.joint(each.joint.name).dofadr[0]]
        value = correlation(own, each.candidate.values)
        words = f"correlation {value:.2f} with the torque that the model needs"
        return (-1 if value < -_TRUSTED else 1), words

    def _per_ampere(self, each: Assigned, torques: Array | None) -> float:
        if torques is None or not moves(each.candidate.values):
            return 0.0
        own = torques[:, self.model.joint(each.joint.name).dofadr[0]]
        current = smoothed(each.candidate.values)  # as the positions behind the torque
        value = correlation(own, current)
        if abs(value) < _TRUSTED:
            return 0.0
        return slope(current, own) * abs(value)

    def _take_accelerometer(self) -> None:
        axes = accelerometer_axes(self.model)
        own: dict[str, Candidate] = {}
        for each in self.candidates:
            if id(each) in self.used or not axes or not each.meaning.axis:
                continue
            stated = quantity_of(each.unit)
            words = set(each.meaning.words) & {"acc", "accel", "acceleration", "accelerometer"}
            named = each.meaning.role == "acceleration" and bool(words) and stated == ""
            if named or stated == "acceleration":
                own.setdefault(each.meaning.axis, each)
        if len(own) == 3:
            for axis in "xyz":
                unit = own[axis].unit or "m/s^2"
                reason = "the model's only accelerometer; check its axes by loose doctor"
                self._add(axes[axis], own[axis], Scaling(unit), 1, reason)


def _fits(each: Assigned, unit: str) -> bool:
    scaling = position_scaling(each.joint, each.candidate.values, unit)
    return (
        scaling is not None
        and scaling.unit == unit
        and scaling.scale == 1.0
        and not (scaling.reason.endswith("which they exceed"))
    )


def _si(values: Array, scaling: Scaling) -> Array:
    factor = unit_named(scaling.unit, "").factor
    return np.asarray(values * scaling.scale * factor + scaling.offset)
