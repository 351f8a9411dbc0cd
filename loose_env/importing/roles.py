"""Roles of channels by what they do: positions, velocities, torques, commands, tool sensors.

A channel is a position if another follows its derivative, if another leads it, or if the torque
that the model needs for it is in the log; a velocity if it follows the derivative of a position;
a torque if it is what the model needs, and friction; a command if the motion follows it. Names
and units are priors among these: they break ties, and never make a role of what contradicts.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import linear_sum_assignment

from loose_env.importing.evidence import (
    Likeness,
    Signal,
    Torque,
    closeness,
    correlation,
    derivative,
    likeness,
    rate_likeness,
    slope,
    torque_in,
)
from loose_env.importing.scalings import (
    Scaling,
    admits,
    fits,
    group_unit,
    is_rate,
    normalised_scaling,
    position_scaling,
    rate_unit,
)
from loose_env.importing.targets import (
    JointTarget,
    joint_targets,
    needed_torques,
    tool_sensors,
)
from loose_env.importing.units import quantity_of, unit_named
from loose_env.importing.vectors import Labels, Vector
from loose_env.recording import ModelColumns
from loose_env.typing import Array

ALIKE = 0.8
"""Least correlation at which two channels without telling names are of one motion [1]."""
_TRUSTED = 0.5
"""Correlation from which a sign is read off a channel, and a name is believed [1]."""
_SAME_UNIT = 3.0
"""Factor by which a measured torque may differ from the model's to count as one in N·m [1]."""
_TOGETHER = 0.3
"""Share of a step within which neither of two channels leads."""
_LAGS = 1.5
"""Steps by which a command may seem to come late for the stamps of two streams."""
_NAME = 0.3
"""Correlation that a telling name is worth where channels compete for a joint [1]."""
_PRIOR = {"position": 3.0, "": 0.0, "command": -3.0, "velocity": -4.0, "acceleration": -4.0,
          "torque": -4.0, "current": -4.0, "other": -6.0}  # fmt: skip
"""What a name is worth for a position, where leading or following a channel is worth 2."""
_RATE = 0.95
"""Least correlation with a derivative at which a channel without a name is a velocity [1]: dry
friction's torque has 0.8 and more."""
_UNIT = 0.1
"""Share by which such a channel may be off the size that a unit gives it [1]."""
_NEAR = 0.3
"""Least closeness of a channel without a name to the motion that follows it [1]: it is less than
1.2 standard deviations of the motion away."""
_ROWS = 2000
"""Rows of which torques are computed where several motions are tried."""
_WEAK = 0.2
"""Least correlation of a named command with the motion of its joint [1]."""
_MOSTLY = 0.75
"""Share of the moving joints that have a velocity where channels without names are velocities."""
_MOST = 80
"""Channels that are compared with each other."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line of a proposal."""

    column: str
    """Column of the model; "" where it has none for the channel."""
    candidate: Signal
    scaling: Scaling
    sign: int = 1
    reason: str = ""
    open: bool = False
    """True if something is missing, so that the line is left as a comment."""


@dataclass(eq=False)
class Roles:
    """Roles of the channels of a log at the joints of a model."""

    model: mujoco.MjModel
    signals: Sequence[Signal]
    step: float
    defined: Mapping[str, str] = field(default_factory=dict)
    """Source -> unit of an angle that its format defines."""

    def __post_init__(self) -> None:
        self.targets = joint_targets(self.model)
        self.joints = {each.name: each for each in self.targets}
        self.labels = Labels(self.targets)
        self.lines: dict[str, Line] = {}
        self.open: list[Line] = []
        self.why: dict[int, str] = {}
        """Reason for which a channel is left, by its place."""
        self.used: set[int] = set()
        self.positions: dict[str, tuple[Signal, Scaling, str]] = {}
        self.rates: dict[str, list[Array]] = {}
        self.needed: dict[str, list[Array]] = {}
        self.commands: dict[str, Signal] = {}
        self.loads: dict[int, str] = {}
        """Joint of channels without names that are the torques of the motion."""
        self.places: dict[int, str] = {}
        """Joint of channels by the vectors that the file makes of them."""
        self.notes: list[str] = []
        self.pairs: dict[tuple[int, int], Likeness] = {}

    def found(self) -> Roles:
        """All roles, in the order in which one rests on the other."""
        self._direct()
        self.vectors = vectors = self.labels.vectors(
            [s for s in self.signals if s.sort not in self.used]
        )
        self.places = {s.sort: j for v in vectors if v.given for j, s in v.members.items()}
        self._take_positions(vectors)
        self._take_velocities()
        self._take_units()
        self._take_torques()
        self._take_commands()
        self._take_still()
        self._take_tool()
        return self

    # --------------------------------------------------------------------- candidates

    def _free(self, *roles: str) -> list[Signal]:
        return [
            s
            for s in self.signals
            if s.sort not in self.used and s.moves and (not roles or self._role(s) in roles)
        ]

    def _direct(self) -> None:
        """Channels that are named as sensors of the model other than those of joints."""
        known = ModelColumns.of(self.model).known
        own = {c for t in self.targets for c in (t.position, t.velocity, t.torque, t.command)}
        for s in self.signals:
            text = s.key.channel
            axis = {"[0]": ".x", "[1]": ".y", "[2]": ".z"}.get(text[-3:], "")
            names = [text, f"sensor.{text}", f"sensor.{text[:-3]}{axis}" if axis else ""]
            column = next((n for n in names if n in known and n not in own), "")
            if column and s.moves:
                words = f"named as the model's {text!r}"
                self._add(column, s, Scaling(s.unit), 1, words)

    def _role(self, s: Signal) -> str:
        return (
            self.labels.named(s)[0] or s.meaning.role or ("torque" if s.sort in self.loads else "")
        )

    # --------------------------------------------------------------------- positions

    def _alike(self, first: Signal, second: Signal) -> Likeness:
        key = (first.sort, second.sort)
        if key not in self.pairs:
            if key[::-1] in self.pairs:
                other = self.pairs[key[::-1]]
                return Likeness(other.correlation, -other.lag)
            self.pairs[key] = likeness(first.runs, second.runs, self.step)
        return self.pairs[key]

    def _rate(self, s: Signal, other: Signal) -> float:
        """Correlation of a channel with the derivative of another; 0 where it is no velocity."""
        if s is other or not is_rate(other.unit, s.unit):
            return 0.0
        value, named = abs(rate_likeness(s, other)), self._role(other) == "velocity"
        sized = named or bool(other.unit) or self._off_unit(s, other) < _UNIT
        return value if value >= (ALIKE if named else _RATE) and sized else 0.0

    @staticmethod
    def _off_unit(s: Signal, other: Signal) -> float:
        """Logarithm by which a channel is off the size of a velocity of another, in all units."""
        ratio = abs(slope(s.rates[1], other.smooth[1]))
        sizes = (1.0, 180 / math.pi, math.pi / 180, 30 / math.pi, 1 / 6, 60.0)
        return min(abs(math.log(max(ratio, 1e-12) / each)) for each in sizes)

    def _relation(self, s: Signal, others: Sequence[Signal]) -> tuple[float, str]:
        """What a channel does among the others, for a position, and the words for it."""
        score, words = 0.0, ""
        rate, other = max(
            ((self._rate(s, d), d) for d in others), key=lambda pair: pair[0], default=(0.0, s)
        )
        is_of = max((self._rate(d, s) for d in others), default=0.0)
        if rate > is_of:
            score += 1.0 + rate
            words = f"{other.key} is its derivative ({rate:.2f})"
        elif is_of:
            score -= 3.0
        follows, leads = 0.0, 0.0
        for d in others:
            same = {quantity_of(d.unit), quantity_of(s.unit)} - {""}
            if d is s or len(same) > 1 or self._role(d) not in ("", "position", "command"):
                continue
            like = self._alike(d, s)
            told = self._role(d) == "command"
            if like.correlation < (_TRUSTED if told else ALIKE):
                continue
            several = len(self.targets) > 1 and not told and not d.unit
            if several and closeness(d.runs, s.runs) < _NEAR:
                continue  # joints that move together lead each other, too
            if like.lag > _TOGETHER * self.step and like.correlation > follows:
                follows = like.correlation
                words = words or f"follows {d.key} by {like.lag:.3g} s ({like.correlation:.2f})"
            elif like.lag < -_TOGETHER * self.step:
                leads = max(leads, like.correlation)
        return score + (2.0 if follows else 0.0) - (2.0 if leads and not follows else 0.0), words

    def _take_positions(self, vectors: Sequence[Vector]) -> None:
        moving = [s for s in self._free() if s.meaning.role != "other"][:_MOST]
        scored: list[tuple[float, int, Vector, dict[str, str]]] = []
        relations: dict[int, tuple[float, str]] = {}
        for i, vector in enumerate(vectors):
            own, words = [], {}
            for joint, s in vector.members.items():
                if s.sort in self.used or not admits(
                    s.unit, "position", slide=self.joints[joint].slide
                ):
                    continue
                role = self._role(s)
                score = _PRIOR[role] + (2.0 if self.labels.named(s)[0] == "position" else 0.0)
                if not s.moves:
                    continue
                if role not in ("other", "velocity", "acceleration", "torque", "current"):
                    if s.sort not in relations:
                        relations[s.sort] = self._relation(s, moving)
                    relation, words[joint] = relations[s.sort]
                    score += relation
                    if position_scaling(self.joints[joint], s.values, s.unit) is None:
                        score -= 4.0
                own.append(score)
            if own:
                mean = float(np.mean(own) if vector.given else np.min(own))
                scored.append((mean, -i, vector, words))
        self._by_dynamics(scored)
        for score, _, vector, words in sorted(scored, key=lambda each: each[:2], reverse=True):
            if score <= 0.5:
                break
            taken = {s.sort for s, _, _ in self.positions.values()}
            if any(s.sort in taken for s in vector.members.values()):
                continue
            for joint, s in vector.members.items():
                fitting = admits(s.unit, "position", slide=self.joints[joint].slide)
                if joint in self.positions or not s.moves or not fitting:
                    continue
                if _PRIOR[self._role(s)] < -3.0:
                    continue
                name = "position" if self._role(s) == "position" else "taken as position"
                reason = "; ".join(filter(None, [f"{name} {vector.words}", words.get(joint, "")]))
                self.positions[joint] = (s, Scaling(""), reason)
                self.used.add(s.sort)

    def _by_dynamics(self, scored: list[tuple[float, int, Vector, dict[str, str]]]) -> None:
        """Raise vectors for whose motion the model needs the torques of another one."""
        if any(each[0] > 0.5 for each in scored):
            return
        full = [each for each in scored if set(each[2].members) == set(self.joints)]
        best: tuple[Any, ...] = (0.0,)
        for score, i, vector, words in [each for each in full if each[0] > -2.0]:
            for unit in ("rad", "deg"):
                factor = unit_named(unit, "").factor
                motion = {j: [v * factor for v in s.runs] for j, s in vector.members.items()}
                self.needed = needed_torques(self.model, motion, self.step, self._every(motion))
                self.rates = {j: [derivative(v, self.step) for v in m] for j, m in motion.items()}
                whole, _ = self._loads(vector.members)
                if whole > best[0]:
                    best = (whole, score, i, vector, words)
        if len(best) > 1:
            whole, score, i, vector, words = best
            why = f"the torque that the model needs for it is in the log ({whole:.2f})"
            words |= dict.fromkeys(vector.members, why)
            scored.append((score + 4 * whole, i, vector, words))
        self.needed, self.rates = {}, {}

    def _loads(self, positions: Mapping[str, Signal]) -> tuple[float, dict[str, Signal]]:
        """Vector that is most like the torques of positions, and how much; 0 where none is."""
        best: tuple[float, dict[str, Signal]] = (0.0, {})
        for other in self.vectors if self.needed else ():
            own = {j: s for j, s in other.members.items() if j in positions}
            taken = set(own.values()) & set(positions.values())
            if taken or len(own) < len(positions) or any(
                s.sort in self.used or self._role(s) not in ("", "torque") for s in own.values()
            ):  # fmt: skip
                continue
            named = all(self._role(s) == "torque" for s in own.values())
            told = [self._explained(j, s) for j, s in own.items()]
            whole, alone = (float(np.mean([t[i] for t in told])) for i in (0, 1))
            moves = [abs(self._alike(s, positions[j]).correlation) for j, s in own.items()]
            load = named or (alone > _NAME and float(np.mean(moves)) < whole)
            if whole > max(0.6, best[0]) and load:
                best = (whole, own)
        return best

    def _every(self, motion: Mapping[str, Sequence[Array]]) -> int:
        """Rows of which one is enough to tell a torque."""
        return max(1, sum(len(v) for v in next(iter(motion.values()))) // _ROWS)

    # --------------------------------------------------------------------- velocities, units

    def _take_velocities(self) -> None:
        joints = [j for j, (s, _, _) in self.positions.items() if s.moves]
        candidates = [
            s for s in self._free("velocity", "", "position")
            if all(admits(s.unit, "velocity", slide=t.slide) for t in self.targets)
        ]  # fmt: skip
        table, sizes = np.zeros((2, len(joints), len(candidates)))
        for i, joint in enumerate(joints):
            for k, s in enumerate(candidates):
                if self.labels.named(s)[0] in ("", "velocity"):
                    own = self.positions[joint][0]
                    table[i, k] = rate_likeness(own, s)
                    sizes[i, k] = 0.0 if s.unit else min(0.2, self._off_unit(own, s))
        self.speeds: dict[str, tuple[Signal, float]] = {}
        for i, k in self._assigned(np.abs(table) - sizes, joints, candidates, "velocity"):
            joint, s, value = joints[i], candidates[k], float(table[i, k])
            named = self._role(s) == "velocity"
            if abs(value) < (_TRUSTED if named else ALIKE):
                self.why[s.sort] = f"{value:.2f} with the derivative of the position of {joint!r}"
                continue
            rates = self.positions[joint][0].rates[1]
            like = likeness(s.smooth[1], rates, self.step)
            here = abs(correlation(s.smooth[1], rates))
            if like.lag > _LAGS * self.step and abs(like.correlation) > here + 0.02:
                self.why[s.sort] = (
                    f"leads the velocity of {joint!r} by {like.lag:.3g} s: one that was wanted, "
                    "not measured"
                )
                continue
            self.speeds[joint] = (s, value)
        bare = [j for j, (s, _) in self.speeds.items() if self._role(s) == "" and not s.unit]
        if len(bare) < _MOSTLY * len(joints):  # dry friction's torque is like a velocity, too
            for joint in bare:
                del self.speeds[joint]
        self.used |= {s.sort for s, _ in self.speeds.values()}

    def _assigned(
        self,
        strength: Array,
        joints: Sequence[str],
        candidates: Sequence[Signal],
        role: str,
    ) -> list[tuple[int, int]]:
        """Pairs of joint and channel of largest strength in sum, names adding theirs."""
        if not strength.size:
            return []
        worth = strength.copy()
        for i, joint in enumerate(joints):
            for k, s in enumerate(candidates):
                label = self.labels.joint(s)
                worth[i, k] += _NAME * (self._role(s) == role)
                worth[i, k] += 0.5 * _NAME * ((label == joint) - (label not in ("", joint)))
        rows, columns = linear_sum_assignment(-worth)
        return [(int(i), int(k)) for i, k in zip(rows, columns, strict=True)]

    def _take_units(self) -> None:
        """Units of positions: stated, by a velocity of known unit, by limits; then velocities."""
        pairs = {j: s for j, (s, _, _) in self.positions.items()}
        common = group_unit([self.joints[j] for j in pairs], [s.values for s in pairs.values()])
        told = self._by_speed()
        # One joint whose values are no degrees, but may be normalised, tells it of its vector.
        normalised = common == "deg" and not told and any(
            not s.unit and not fits(self.joints[j], s.low, s.high, "deg")
            and normalised_scaling(self.joints[j], s.values)
            and not self.defined.get(s.source)
            for j, s in pairs.items()
        )  # fmt: skip
        for joint, (s, _, reason) in list(self.positions.items()):
            target = self.joints[joint]
            unit, why = s.unit, "as stated"
            if not unit and told.get(joint):
                unit, why = told[joint], "by the velocity beside"
            elif not unit and self.defined.get(s.source):
                unit, why = self.defined[s.source], "as the format defines"
                unit = "m" if target.slide else unit
            elif not unit and not target.slide and fits(target, s.low, s.high, common, 0.5):
                unit, why = common, "fits most joints of the vector"
                if common == "deg" and np.max(np.abs(s.values)) <= 100:
                    why += "; values normalised to -100..100 would look alike"
            scaling = position_scaling(target, s.values, unit, why)
            if normalised and not s.unit:
                scaling = normalised_scaling(target, s.values) or scaling
            if scaling is None:
                words = f"{reason}; its values or unit fit no unit of {joint!r}"
                self.open.append(
                    Line(column=target.position, candidate=s, scaling=Scaling(""), reason=words,
                         open=True)
                )  # fmt: skip
                del self.positions[joint]
                continue
            self.positions[joint] = (s, scaling, reason)
            if target.position:
                self._add(target.position, s, scaling, 1, reason, scaling.reason)
            else:
                self.why[s.sort] = f"position of {joint!r}, for which the model has no sensor"
                self.notes.append(
                    f"the model has no sensor for the position of {joint!r}: add "
                    f'<jointpos name="{joint}_position" joint="{joint}"/> to its <sensor>'
                )
        motion = {j: sc.si(s.runs) for j, (s, sc, _) in self.positions.items()}
        self.rates = {j: [derivative(v, self.step) for v in own] for j, own in motion.items()}
        self.needed = needed_torques(self.model, motion, self.step)
        for joint, (s, value) in self.speeds.items():
            self._add_velocity(joint, s, value)

    def _by_speed(self) -> dict[str, str]:
        """Units of positions that a velocity of stated unit determines."""
        found = {}
        for joint, (s, _) in self.speeds.items():
            own, slide = self.positions[joint][0], self.joints[joint].slide
            if own.unit or not s.unit:
                continue
            ratio = abs(slope(own.rates[1], s.smooth[1])) * unit_named(s.unit, "").factor
            units = ("m", "cm", "mm", "um") if slide else ("rad", "deg", "rev", "mrad")
            away = {u: abs(math.log(max(ratio, 1e-12) / unit_named(u, "").factor)) for u in units}
            best = min(units, key=lambda u: away[u])
            if away[best] < math.log(1.2):
                found[joint] = best
        return found

    def _add_velocity(self, joint: str, s: Signal, value: float) -> None:
        target = self.joints[joint]
        if joint not in self.positions:
            self.used.discard(s.sort)
            return
        ratio = slope(self.rates[joint], s.smooth[1])
        unit = s.unit or rate_unit(ratio, target.slide)
        words = f"{abs(ratio):.3g} times the derivative of the position, correlation {value:.2f}"
        if not target.velocity:
            self.why[s.sort] = f"velocity of {joint!r}, for which the model has no sensor"
        elif not unit:
            column = target.velocity
            self._open(column, s, Scaling("rad/s"), f"velocity of {joint!r}; {words}: no unit is")
        else:
            sign = -1 if value < 0 else 1
            self._add(target.velocity, s, Scaling(unit), sign, f"velocity of {joint!r}", words)

    # --------------------------------------------------------------------- torques

    def _explained(self, joint: str, s: Signal) -> Torque:
        """What there is of a torque in a channel."""
        if joint not in self.needed or joint not in self.rates:
            return Torque()
        return torque_in(s.smooth[1], self.needed[joint], self.rates[joint])

    def _take_torques(self) -> None:
        joints = list(self.positions)
        quantities = ("", "torque", "force", "current", "number")
        candidates = [
            s for s in self._free("torque", "current", "")
            if quantity_of(s.unit) in quantities
        ]  # fmt: skip
        _, loads = self._loads({j: s for j, (s, _, _) in self.positions.items()})
        self.loads = {s.sort: j for j, s in loads.items()}
        self.places |= self.loads
        if not self.needed:
            self._torques_by_name(candidates)
            return
        found = [[self._explained(j, s) for s in candidates] for j in joints]
        named = [self._role(s) in ("torque", "current") for s in candidates]
        # A torque is of the joint that its name or its place in a vector tells, or of none.
        own = [self.labels.joint(s) or self.places.get(s.sort, "") for s in candidates]
        table = np.array(
            [[abs(t.whole if named[k] else t.alone) * (own[k] in ("", joint))
              for k, t in enumerate(row)] for joint, row in zip(joints, found, strict=True)]
        ).reshape(len(joints), len(candidates))  # fmt: skip
        chosen: list[tuple[JointTarget, Signal, Torque, bool]] = []
        for i, k in self._assigned(table, joints, candidates, "torque"):
            joint, s, told = joints[i], candidates[k], found[i][k]
            motion = abs(self._alike(s, self.positions[joint][0]).correlation)
            if named[k] and table[i, k] < _TRUSTED:
                self.why[s.sort] = (
                    f"correlation {told.whole:.2f} with the torque that the model needs at "
                    f"{joint!r}, and friction"
                )
            elif named[k]:
                chosen.append((self.joints[joint], s, told, True))
            elif table[i, k] > max(0.6, motion):
                chosen.append((self.joints[joint], s, told, False))
        bare = sum(not told for *_, told in chosen)
        self.sure = {
            ("loads",) if s.sort in self.loads else (s.source, s.meaning.vector)
            for _, s, told, _ in chosen
            if abs(told.alone) >= _TRUSTED and 1 / _SAME_UNIT < told.per < _SAME_UNIT
        }
        for target, s, told, by_name in chosen:
            if by_name or 2 * bare >= len(joints):  # one of many without a name is chance
                self._add_torque(target, s, told, named=by_name)

    def _torques_by_name(self, candidates: Sequence[Signal]) -> None:
        for s in candidates:
            joint = self.labels.joint(s)
            stated = quantity_of(s.unit) in ("torque", "force")
            if joint and self.joints[joint].torque and (
                stated or (self._role(s) == "torque" and self.defined.get(s.source))
            ):  # fmt: skip
                words = f"torque of {joint!r} by its name; the model's cannot be computed"
                self._add(self.joints[joint].torque, s, Scaling(s.unit), 1, words)

    def _add_torque(self, target: JointTarget, s: Signal, told: Torque, *, named: bool) -> None:
        value, per = (told.whole if named else told.alone), told.per
        sign = -1 if value < 0 else 1
        words = f"correlation {value:.2f} with the torque that the model needs, and friction"
        current = quantity_of(s.unit) == "current" or self._role(s) == "current"
        unit = "N" if target.slide else "N*m"
        stated = quantity_of(s.unit) in ("torque", "force")
        near = 1 / _SAME_UNIT < per < _SAME_UNIT
        self.used.add(s.sort)
        if current:
            self._open(
                target.torque, s, Scaling(unit, per * abs(value)),
                f"{words}; a current [A]: give the torque constant and gear as scale [N·m/A]; "
                f"{per * abs(value):.4g} fits the torque that the model needs", sign,
            )  # fmt: skip
        elif stated or near or self._told_beside(s):
            self._add(target.torque, s, Scaling(s.unit or unit), sign, words)
        elif named and abs(told.alone) < _TRUSTED:
            why = f"{words}; mostly friction, which does not tell its unit: give it"
            self._open(target.torque, s, Scaling(unit), why, sign)
        else:
            self._open(
                target.torque, s, Scaling(unit, per),
                f"{words}; {per:.4g} times it would be that torque [{unit}]: a current?", sign,
            )  # fmt: skip

    def _told_beside(self, s: Signal) -> bool:
        """Whether the unit of a torque is its format's, or is told by others of its vector."""
        defined = bool(self.defined.get(s.source)) and self._role(s) == "torque"
        vector = ("loads",) if s.sort in self.loads else (s.source, s.meaning.vector)
        return defined or vector in self.sure

    # --------------------------------------------------------------------- commands

    def _motion(self, target: JointTarget) -> list[Array] | None:
        if target.drive == "torque":
            return self.needed.get(target.name)
        if target.name not in self.positions:
            return None
        signal, scaling, _ = self.positions[target.name]
        return scaling.si(signal.runs) if target.drive == "position" else self.rates[target.name]

    def _take_commands(self) -> None:
        motion = {
            t.name: own
            for t in self.targets
            if t.command and t.command not in self.lines and (own := self._motion(t)) is not None
            and any(len(v) and np.ptp(v) > 0 for v in own)
        }  # fmt: skip
        joints = list(motion)
        candidates = [s for s in self._free("command", "", "position")]
        likes: dict[tuple[int, int], Likeness] = {}
        table = np.zeros((len(joints), len(candidates)))
        for i, joint in enumerate(joints):
            target = self.joints[joint]
            for k, s in enumerate(candidates):
                if not admits(s.unit, "command", slide=target.slide) or not self._commands(
                    s, target
                ):
                    continue
                like = likeness(s.runs, motion[joint], self.step)
                likes[i, k] = like
                table[i, k] = like.correlation
        near = np.array(
            [[closeness(s.runs, self.positions[j][0].runs) if j in self.positions else 0.0
              for s in candidates] for j in joints]
        ).reshape(table.shape)  # fmt: skip
        order = {k: self.places.get(s.sort, "") for k, s in enumerate(candidates)}
        table_by_place = np.where(table > 0, table, -0.5 * table) * (1 + _NAME * near) + np.array(
            [[0.1 * (order[k] == joint) for k in range(len(candidates))] for joint in joints]
        ).reshape(table.shape)
        for i, k in self._assigned(table_by_place, joints, candidates, "command"):
            if (i, k) in likes:
                self._take_command(joints[i], candidates[k], likes[i, k])
        self._exchanged()
        for joint, s in self.commands.items():
            if joint in self.positions or self.joints[joint].drive == "torque":
                self._add_command(joint, s, motion)

    def _commands(self, s: Signal, target: JointTarget) -> bool:
        """Whether a channel may be what the actuator of a joint takes, by its name and unit."""
        quantity = quantity_of(s.unit)
        rate = quantity in ("angular speed", "speed")
        load = quantity in ("torque", "force", "current")
        own = {"position": not rate and not load, "velocity": not load, "torque": not rate}
        of = s.meaning.of if self._role(s) == "command" else ""
        told = of in ("", "command", target.drive) or (of == "current" and target.drive == "torque")
        if target.drive == "torque" and quantity in ("angle", "length"):
            return False
        return own[target.drive] and told and self.labels.named(s)[0] in ("", "command")

    def _take_command(self, joint: str, s: Signal, like: Likeness) -> None:
        named = self._role(s) == "command"
        words = f"correlation {like.correlation:.2f} with the motion of {joint!r}"
        if like.correlation < 0 and abs(like.correlation) >= ALIKE and named:
            column = self.joints[joint].command
            why = f"{words}: the joint moves against it, so it is none, unless its sign is reversed"
            self._open(column, s, Scaling(s.unit), why, -1)
        elif like.correlation < (_WEAK if named else ALIKE):
            self.why[s.sort] = f"{words}: no command"
        elif like.lag < -_LAGS * self.step and self.joints[joint].drive != "torque":
            self.why[s.sort] = f"{words}, but it lags by {-like.lag:.3g} s: no command"
        elif self._role(s) == "position" and like.lag < self.step:
            self.why[s.sort] = f"{words}: a second sensor of it"
        else:
            self.commands[joint] = s
            self.used.add(s.sort)

    def _exchanged(self) -> None:
        """Note joints that follow each other's commands; the torques tell which are exchanged."""
        label = {j: s.meaning.joint for j, s in self.commands.items()}
        for a, b in itertools.combinations(label, 2):
            if (label[a], label[b]) == (b, a):
                self.notes.append(
                    f"{a!r} and {b!r} follow each other's commands: the names of the commands are "
                    "exchanged, as assumed here, or those of the states; loose doctor judges by "
                    "the torques"
                )

    def _add_command(
        self,
        joint: str,
        s: Signal,
        motion: Mapping[str, list[Array]],
    ) -> None:
        target = self.joints[joint]
        if target.command in self.lines:
            return
        like = likeness(s.runs, motion[joint], self.step)
        words = f"correlation {like.correlation:.2f}, the joint follows it by {like.lag:.3g} s"
        there = self.places.get(s.sort, "")
        if there not in ("", joint):
            words = f"{joint!r} follows it, not {there!r} as by its name or place; {words}"
        scaling = Scaling(s.unit)
        if target.drive == "position":
            signal, own, _ = self.positions[joint]
            scaling = self._scaled_as(s, signal, own, target)
        elif target.drive == "velocity" and not s.unit:
            scaling = Scaling(rate_unit(slope(motion[joint], s.runs), target.slide))
        self._add(target.command, s, scaling, 1, f"command of {joint!r}", words, scaling.reason)

    def _scaled_as(self, s: Signal, signal: Signal, own: Scaling, target: JointTarget) -> Scaling:
        """Scaling of a command by its size beside the position's."""
        if s.unit and s.unit != "%":
            return self._turned(s, signal, own, Scaling(s.unit, reason="as stated"))
        ratio = abs(slope(own.si(signal.runs), s.runs))
        units = ("m", "mm") if target.slide else ("rad", "deg")
        like = abs(slope(signal.runs, s.runs))  # of one unit with the position where near 1
        away = {u: abs(math.log(max(ratio, 1e-9) * unit_named(u, "").factor)) for u in units}
        best = min(units, key=lambda u: away[u])
        plain = own.scale == 1.0 and own.offset == 0.0
        if abs(math.log(max(like, 1e-9))) <= (away[best] if plain else away[best] + 0.5):
            like_position = replace(own, reason="scaled as the position")
            return self._turned(s, signal, own, like_position)
        return Scaling(best, reason=f"{ratio:.3g} times the position [{units[0]}]")

    def _turned(self, s: Signal, signal: Signal, own: Scaling, scaling: Scaling) -> Scaling:
        """Move the position by whole periods of its wrap-around to where its command is."""
        if signal.period is None:
            return scaling
        period = signal.period * own.scale * unit_named(own.unit or "1", "").factor
        apart = np.median(np.concatenate(scaling.si(s.runs)) - np.concatenate(own.si(signal.runs)))
        turns = round(float(apart) / period)
        column = self.joints[next(j for j, e in self.positions.items() if e[0] is signal)].position
        if turns and column in self.lines:
            moved = replace(own, offset=own.offset + turns * period)
            line = self.lines[column]
            self.lines[column] = replace(
                line, scaling=moved, reason=f"{line.reason}; {turns} turns on, where its command is"
            )
        return scaling

    # --------------------------------------------------------------------- the rest

    def _take_still(self) -> None:
        """Joints at rest: constant positions and commands beside others of their vector."""
        for s in self.signals:
            if not s.moves and s.values.size:
                self.why[s.sort] = f"constant, {s.values[0]:.6g}"
        for vector in self.vectors:
            lines = {line.candidate.sort: line for line in self.lines.values()}
            own = [lines[s.sort] for s in vector.members.values() if s.sort in lines]
            if not own or not vector.given:
                continue
            command = own[0].column.startswith("ctrl.")
            if not command and all(own[0].column != t.position for t in self.targets):
                continue
            for joint, s in vector.members.items():
                target = self.joints[joint]
                column = target.command if command else target.position
                rival = self.lines.get(target.position if command else target.command)
                if s.moves or not s.values.size or not column or column in self.lines:
                    continue
                if rival is None or not rival.candidate.moves:
                    plain = own[0].scaling.scale == 1.0
                    scaling = Scaling(own[0].scaling.unit) if plain else (
                        normalised_scaling(target, s.values))  # fmt: skip
                    if scaling is not None:
                        self._add(column, s, scaling, 1, f"{joint!r} is at rest")

    def _take_tool(self) -> None:
        """The model's only accelerometer and gyro, by names of axes, units and size."""
        for column, s, unit, words in tool_sensors(self.model, self._free(), self.rates):
            self._add(column, s, Scaling(unit), 1, words)

    def _add(self, column: str, s: Signal, scaling: Scaling, sign: int, *reasons: str) -> None:
        reason = "; ".join(filter(None, reasons))
        line = Line(column=column, candidate=s, scaling=scaling, sign=sign, reason=reason)
        self.used.add(s.sort)
        if column and column not in self.lines:
            self.lines[column] = line
        else:
            self.open.append(replace(line, open=True))

    def _open(self, column: str, s: Signal, scaling: Scaling, reason: str, sign: int = 1) -> None:
        """Add a line that lacks something, as a comment."""
        self.used.add(s.sort)
        self.open.append(
            Line(column=column, candidate=s, scaling=scaling, sign=sign, reason=reason, open=True)
        )

    def left(self) -> Iterable[tuple[Signal, str]]:
        """Channels that are not used, each with the reason and what it is most like."""
        taken = {line.candidate.sort for line in (*self.lines.values(), *self.open)}
        for s in self.signals:
            if s.sort in taken:
                continue
            why = self.why.get(s.sort, "")
            yield s, why or (self._nearest(s) if s.moves else "constant")

    def _nearest(self, s: Signal) -> str:
        """What a channel is most like, though not enough for a role."""
        scores: list[tuple[float, str]] = []
        for joint, (p, _, _) in self.positions.items():
            like = self._alike(s, p)
            if abs(like.correlation) < 0.995 or self._role(s) != "other":
                scores.append((abs(like.correlation), f"the motion of {joint!r}"))
            scores.append((abs(rate_likeness(p, s)), f"the velocity of {joint!r}"))
            scores.append((abs(self._explained(joint, s).alone), f"the torque of {joint!r}"))
        scores.sort(reverse=True)
        named = f"by its name of another quantity ({s.meaning.role})" if s.meaning.role else (
            "no role")  # fmt: skip
        best = ", then ".join(f"{words} ({value:.2f})" for value, words in scores[:2])
        return f"{named}; most like {best}" if best else named
