"""Roles of channels by what they do: positions, velocities, torques, commands, tool sensors.

A channel is a position if another follows its derivative, if another leads it, or if the torque
that the model needs for it is in the log. Of every other role at every joint each channel has a
score, the sum of evidence and prior: its correlation with what the motion makes of that role, and
what its name is worth. The roles are those of largest scores in sum. A name breaks ties, and never
makes a role of what contradicts.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import mujoco
import numpy as np

from loose_env.importing.evidence import (
    SIZES,
    Agreement,
    Likeness,
    Signal,
    derivative,
    likeness,
    slope,
    speed_in,
    torque_in,
)
from loose_env.importing.names import Role
from loose_env.importing.targets import (
    RATES,
    SPEEDS,
    JointTarget,
    Scaling,
    Tool,
    admits,
    by_motion,
    counted,
    is_rate,
    joint_targets,
    needed_torques,
    position_scalings,
    tool_sensors,
    vector_orders,
)
from loose_env.importing.units import nearest_unit, quantity_of, unit_named
from loose_env.typing import Array

ALIKE = 0.8
"""Least score of a role, the correlation of a channel whose name tells nothing [1]."""
_TRUSTED = 0.5
"""Correlation from which a channel with a telling name is believed [1]."""
_LOADS = 0.6
"""Correlation with the torques of a motion, from which positions without names are believed [1]."""
_SAME_UNIT = 3.0
"""Factor by which a measured torque may differ from the model's to count as one in N·m [1]."""
_TOGETHER = 0.3
"""Share of a step within which neither of two channels leads."""
_LAGS = 1.5
"""Steps by which a command may seem to come late for the stamps of two streams."""
_NAME = 0.3
"""Correlation that a telling name is worth; that of the joint, or of none, is worth half [1]."""
_PRIOR = {"position": 3.0, "": 0.0, "command": -3.0, "velocity": -4.0, "acceleration": -4.0,
          "torque": -4.0, "current": -4.0, "other": -6.0}  # fmt: skip
"""What a name is worth for a position, where leading or following a channel is worth 2."""
_MINUTES = 0.02
"""Logarithm by which a velocity may be off 60 times a derivative [1]: half way to deg/s of rad."""
_SLOW_S = 2.0
"""Time over which positions and commands are averaged to be compared in size [s]."""
_NEVER = 2.0
"""Correlation that none has."""
_RATE = 0.95
"""Least correlation with a derivative at which a channel without a name tells a position [1]: dry
friction's torque has 0.8 and more."""
_UNIT = 0.2
"""Most that its size speaks against a torque whose name tells nothing [1]."""
_BY_NAME = "by its name"
_ROWS = 2000
"""Rows of which torques are computed where several motions are tried."""
_CLEARER = 0.5
"""What exchanged states leave of the torques of their joints over what they leave as named, from
which the names are wrong [1]: half is more than friction makes of it."""
_ORDER = 1e-6
"""Score by which equal channels go to the joints in the file's order [1]."""
_MOST = 80
"""Channels that are compared with each other."""
_STRIDES = 12
"""Most quantities that a log may have of each joint in turn."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line of a proposal."""

    column: str
    """Column of the model; "" where it has none for the channel."""
    candidate: Signal
    scaling: Scaling
    reason: str = ""
    open: bool = False
    """True if something is missing, so that the line is left as a comment."""


class Vector(NamedTuple):
    """Channels of one quantity, each of its joint."""

    members: dict[str, Signal]
    words: str
    """Where the joints follow from."""
    given: bool
    """True if the file itself makes a vector of them, by names or brackets."""


class Match(NamedTuple):
    """A channel in a role at a joint."""

    joint: str
    role: Role
    evidence: float = 0.0
    """Correlation with what the motion makes of the role; the score without names [1]."""
    words: str = ""
    """The evidence in words."""
    why: str = ""
    """Reason for which it has not the role in spite of it."""
    sign: int = 1
    per: float = 0.0
    """Torque that the model needs for each of its units [N·m or N]; 0 where friction hides it."""


@dataclass(eq=False)
class Roles:
    """Roles of the channels of a log at the joints of a model."""

    model: mujoco.MjModel
    signals: Sequence[Signal]

    def __post_init__(self) -> None:
        self.step = self.signals[0].step
        self.joints = {each.name: each for each in joint_targets(self.model)}
        self.lines: dict[str, Line] = {}
        self.open: list[Line] = []
        self.why: dict[int, str] = {}
        """Reason for which a channel is left, by its place."""
        self.used: set[int] = set()
        self.positions: dict[str, tuple[Signal, Scaling, str]] = {}
        self.rates: dict[str, list[Array]] = {}
        self.needed: dict[str, list[Array]] = {}
        self.felt: list[Array] = []
        self.directed: set[str] = set()
        """Joints whose direction a tool sensor has told."""
        self.notes: list[str] = []
        self.pairs: dict[tuple[int, int], Likeness] = {}

    def found(self, exchanged: str = "") -> Roles:
        """All roles, in the order in which one rests on the other; exchanged states have a note."""
        self.places: dict[int, str] = {}
        self.vectors = self._vectors()
        self.places = {s.sort: j for v in self.vectors if v.given for j, s in v.members.items()}
        self._take_positions()
        self._take_places()
        self._take_units()
        self._take_tools(_NEVER)
        self._take_rest()
        self._take_still()
        self._take_tools(_RATE)
        if exchanged:
            self.notes.append(exchanged)
            return self
        return self._with_exchange()

    def _free(self) -> list[Signal]:
        return [s for s in self.signals if s.sort not in self.used and s.moves]

    # --------------------------------------------------------------------- names

    def _label(self, s: Signal) -> str:
        """Joint that a channel has by its name or place in a vector; else the only one, or ""."""
        only = next(iter(self.joints)) if len(self.joints) == 1 else ""
        return s.meaning.joint or self.places.get(s.sort, only)

    def _place(self, s: Signal) -> tuple[str, int | None]:
        """Joint and number of a channel by its name."""
        return self._label(s), s.meaning.index

    def _vectors(self) -> list[Vector]:
        """Channels that belong together by their names, by brackets, or by their order."""
        found: list[Vector] = []
        groups: dict[tuple[object, ...], list[Signal]] = {}
        rest: list[Signal] = []
        names = [*self.joints]
        orders = vector_orders(self.model)
        for s in self.signals:
            if s.meaning.joint or len(names) == 1:
                of = s.meaning.vector if s.meaning.joint else s.sort
                groups.setdefault(("label", s.source, of), []).append(s)
            elif s.meaning.index is not None:
                groups.setdefault(("index", s.source, s.meaning.vector), []).append(s)
            else:
                rest.append(s)
        for (kind, source, _), own in groups.items():
            while kind == "label" and own:  # a joint may have two channels of one name
                members = {self._label(s): s for s in reversed(own)}
                own = [s for s in own if s not in members.values()]
                array = {s.meaning.array for s in members.values()}
                others = [s for s in rest if s.source == source and {s.meaning.array} == array]
                lacking = [j for j in names if j not in members]
                if "" not in array and len(others) == len(lacking):
                    members |= dict(zip(lacking, others, strict=True))
                named = any(s.meaning.joint for s in members.values())
                words = _BY_NAME if named else "of the only joint"
                found.append(Vector(members, words, named))
            own = sorted(own, key=lambda s: s.meaning.index or 0)
            order = next((o for o in orders if own and len(o) == len(own)), None)
            if order is not None:
                place = {j: s for j, s in zip(order, own, strict=True) if j}
                found.append(Vector(place, "by its place in the vector", True))
            else:
                rest += own
        return [*found, *self._blocks(sorted(rest, key=lambda s: s.sort))]

    def _blocks(self, rest: Sequence[Signal]) -> Iterator[Vector]:
        """Vectors of channels without telling names: as many as joints, in a row or in turns."""
        names, count = [*self.joints], len(self.joints)
        for source in dict.fromkeys(s.source for s in rest):
            own = [s for s in rest if s.source == source and s.meaning.role != "other" and s.moves]
            for stride in range(1, _STRIDES + 1) if count > 1 else ():
                words = "in the file's order" if stride == 1 else f"every {stride}th channel"
                for first in range(len(own) - stride * (count - 1)):
                    block = own[first : first + stride * (count - 1) + 1 : stride]
                    yield Vector(dict(zip(names, block, strict=True)), words, False)

    def _take_places(self) -> None:
        """Places of joints in the vectors beside that of the positions, as wide as it.

        Their other entries are of what the model has not: the other legs of a robot.
        """
        taken = {p.meaning.index: j for j, (p, *_) in self.positions.items() if not self._label(p)}
        own = {(p.source, p.meaning.vector) for p, *_ in self.positions.values()}
        width = Counter((s.source, s.meaning.vector) for s in self.signals)
        if None in taken or len(own) != 1 or len(taken) < len(self.joints):
            return
        for s in self.signals:
            of = (s.source, s.meaning.vector)
            beside = of not in own and width[of] == width[next(iter(own))]
            if beside and s.meaning.index is not None and not s.meaning.joint:
                self.places[s.sort] = taken.get(s.meaning.index, f"[{s.meaning.index}]")

    # --------------------------------------------------------------------- positions

    def _alike(self, first: Signal, second: Signal) -> Likeness:
        key = (first.sort, second.sort)
        if key[::-1] in self.pairs:
            other = self.pairs[key[::-1]]
            return Likeness(other.correlation, -other.lag)
        if key not in self.pairs:
            self.pairs[key] = likeness(first.runs, second.runs, self.step)
        return self.pairs[key]

    def _rate(self, s: Signal, other: Signal) -> float:
        """Correlation of a channel with the derivative of another; 0 where it is no velocity."""
        if s is other or not is_rate(other.unit, s.unit):
            return 0.0
        value = abs(speed_in(s, other))
        return value if value >= (ALIKE if other.meaning.role == "velocity" else _RATE) else 0.0

    def _relation(self, s: Signal, others: Sequence[Signal]) -> tuple[float, str]:
        """What a channel does among the others, for a position, and the words for it."""
        rate, other = max(
            ((self._rate(s, d), d) for d in others), key=lambda pair: pair[0], default=(0.0, s)
        )
        is_of = max((self._rate(d, s) for d in others), default=0.0)
        score, words = (-3.0 if is_of else 0.0), ""
        if rate > is_of:
            score, words = 1.0 + rate, f"{other.key} is its derivative ({rate:.2f})"
        follows, apart, leads, lead = -math.inf, 0.0, False, ""
        for d in others:
            same = {quantity_of(d.unit), quantity_of(s.unit)} - {""}
            if d is s or len(same) > 1 or d.meaning.role not in ("", "position", "command"):
                continue
            like, told = self._alike(d, s), d.meaning.role == "command"
            if like.correlation < (_TRUSTED if told else ALIKE):
                continue
            leads |= like.lag < -_TOGETHER * self.step
            # Of two sensors of a joint, one before its gear, a command is in the unit of the other.
            size = min(abs(math.log(abs(slope(d.runs, s.runs)) * each)) for each in SIZES)
            near = like.correlation - size - _NAME * (self._place(d) != self._place(s))
            if like.lag > _TOGETHER * self.step and near > follows:
                follows, apart = near, min(size, 0.5)
                lead = f"follows {d.key} by {1e3 * like.lag:.3g} ms ({like.correlation:.2f})"
        return score + (2.0 - apart if lead else -2.0 if leads else 0.0), words or lead

    def _take_positions(self) -> None:
        moving = [s for s in self._free() if s.meaning.role != "other"][:_MOST]
        scored: list[tuple[float, int, Vector]] = []
        relations: dict[int, tuple[float, str]] = {}
        for i, vector in enumerate(self.vectors):
            own = []
            for joint, s in vector.members.items():
                if s.moves and admits(s.unit, "position", slide=self.joints[joint].slide):
                    near = _PRIOR[s.meaning.role] > _PRIOR["velocity"]
                    if near and s.sort not in relations:
                        relations[s.sort] = self._relation(s, moving)
                    own.append(_PRIOR[s.meaning.role] + (relations[s.sort][0] if near else 0.0))
            if own:
                score = float(np.mean(own) if vector.given else np.min(own))
                score = round(score + 0.5 * (vector.words == _BY_NAME), 1)  # of like ones the first
                scored.append((score, -i, vector))
        if not any(score > 0.5 for score, *_ in scored):
            scored += self._by_dynamics(scored, relations)
        for score, _, vector in sorted(scored, key=lambda each: each[:2], reverse=True):
            taken = {s.sort for s, _, _ in self.positions.values()}
            if score <= 0.5 or any(s.sort in taken for s in vector.members.values()):
                continue
            for joint, s in vector.members.items():
                fitting = s.moves and admits(s.unit, "position", slide=self.joints[joint].slide)
                if fitting and joint not in self.positions and _PRIOR[s.meaning.role] >= -3.0:
                    name = "position" if s.meaning.role == "position" else "taken as position"
                    told = relations.get(s.sort, (0.0, ""))[1]
                    reason = "; ".join(filter(None, [f"{name} {vector.words}", told]))
                    self.positions[joint] = (s, Scaling(""), reason)
                    self.used.add(s.sort)

    def _by_dynamics(
        self,
        scored: Sequence[tuple[float, int, Vector]],
        relations: dict[int, tuple[float, str]],
    ) -> list[tuple[float, int, Vector]]:
        """The vector for whose motion the model needs the torques of another one."""
        best: tuple[float, list[tuple[float, int, Vector]]] = (0.0, [])
        for score, i, vector in scored:
            if score > -2.0 and set(vector.members) == set(self.joints):
                whole = max(self._weighed(vector.members, unit) for unit in ("rad", "deg"))
                if whole > best[0]:
                    best = (whole, [(score + 4 * whole, i, vector)])
        for *_, vector in best[1]:
            why = f"the torque that the model needs for it is in the log ({best[0]:.2f})"
            relations |= {s.sort: (0.0, why) for s in vector.members.values()}
        return best[1]

    def _weighed(self, positions: Mapping[str, Signal], unit: str) -> float:
        """How much torques, or a tool sensor, are what positions in a unit make of them."""
        self._move({j: Scaling(s.unit or unit).si(s.runs) for j, s in positions.items()}, _ROWS)
        return max(self._loads(positions), math.sqrt(self._sensed()[0]))

    def _tools(self, untold: float = _NEVER) -> list[Tool]:
        free = [s for s in self.signals if s.sort not in self.used and s.values.size]
        return [*tool_sensors(self.model, free, self.felt, _TRUSTED, untold)]

    def _take_tools(self, untold: float) -> None:
        """Sensors of the tool by their names; by their readings alone from a correlation."""
        for tool in self._tools(untold):
            like, where = tool.agreement, f"the model's only sensor of {tool.quantity}"
            seen = f"correlation {like.whole:.2f} with what it reads in this motion"
            if like.whole > 0 and like.alone < like.whole - _NAME:
                seen += f", {like.alone:.2f} as it is mounted: check its axes by loose doctor"
            for i, s in tool.axes.items():
                column, scaling = f"sensor.{tool.name}.{'xyz'[i]}", tool.scaling
                if not tool.fits:
                    self.why[s.sort] = f"not {where}: {seen}"
                elif not scaling.unit:
                    self._open(column, s, scaling, f"{where}; nothing tells its unit")
                elif s.sort not in self.used:
                    self._add(column, s, scaling, where, seen * bool(like.whole), scaling.reason)

    def _sensed(self) -> Array:
        """How much the tool's sensors are like a motion, however mounted and as in the model (2,).

        Squared, and less what their sizes are off.
        """
        found = [(0.0, 0.0)]
        for tool in self._tools():
            like, off = tool.agreement, _off_size(tool.agreement.per / tool.scaling.factor)
            found.append((like.whole - off, max(like.alone, 0.0)))
        return np.asarray(np.mean(found[1:] or found, axis=0) ** 2)

    def _loads(self, positions: Mapping[str, Signal]) -> float:
        """How much some vector is like the torques of positions; 0 where none is."""
        best = 0.0
        for members in (v.members for v in self.vectors if self.needed):
            if not set(positions) <= set(members) or any(
                s.meaning.role not in ("", "torque") or s.sort in self.used or not s.moves
                for s in members.values()
            ):  # fmt: skip
                continue
            pairs = [(p, members[joint], self._explained(joint, members[joint]))
                     for joint, p in positions.items()]  # fmt: skip
            moves = [max(abs(self._alike(s, p).correlation), abs(speed_in(p, s)))
                     for p, s, _ in pairs]  # fmt: skip
            named = all(s.meaning.role == "torque" for s in members.values())
            whole = float(
                np.mean([abs(t.whole) - _off_size(t.per) * (not named) for *_, t in pairs])
            )
            clear = np.mean([abs(t.alone) for *_, t in pairs]) > _NAME and np.mean(moves) < whole
            if whole > max(best, _LOADS) and (named or clear):
                best = whole
        return best

    def _move(self, motion: dict[str, list[Array]], rows: int = 0) -> None:
        """Take a motion of the joints: its velocities, and the torques that the model needs."""
        length = sum(len(v) for v in next(iter(motion.values()), []))
        self.rates = {j: [derivative(v, self.step) for v in own] for j, own in motion.items()}
        every = max(1, length // rows) if rows else 1
        self.felt = []
        self.needed = needed_torques(self.model, motion, self.step, every, self.felt)

    def _take_units(self) -> None:
        """Units of positions, as stated, by a witness or the vector; motion and torques follow."""
        pairs = {j: (self.joints[j], s) for j, (s, _, _) in self.positions.items()}
        told: dict[str, tuple[float, str]] = {}
        for joint, (target, p) in pairs.items():
            rated = [
                (abs(speed_in(p, s)), s)
                for s in self._free()
                if admits(s.unit, "velocity", slide=target.slide)
                and is_rate(p.unit, s.unit)
                and s.meaning.role in ("", "velocity")
            ]
            value, s = max(rated, key=lambda each: each[0], default=(0.0, p))
            ratio = abs(slope(p.rates, s.smooth)) if value >= ALIKE else 0.0
            # Minutes are in no ratio of units but that of turns and turns a minute.
            turns = abs(math.log(max(ratio, 1e-9) / 60)) < _MINUTES and not target.slide
            if ratio and (s.unit or turns):
                size = 1 / (ratio * unit_named(s.unit or "rpm", "").factor)
                told[joint] = size, "by the velocity beside"
            elif not p.unit and (found := self._followed(joint)) and found[0].unit:
                told[joint] = slope([found[2]], [found[1]]), f"by {found[0].key}, which it follows"
        defined = all(s.defined for _, s in pairs.values())
        free = {j for j, (t, s) in pairs.items() if not (s.unit or t.limits or t.slide)} - {*told}
        if free and not defined:
            own = {j: s for j, (_, s) in pairs.items()}
            loads = {unit: self._weighed(own, unit) for unit in ("rad", "deg")}
            (least, other), (most, unit) = sorted((v, unit) for unit, v in loads.items())
            if most > _LOADS:
                words = f"by torques or the tool: {most:.2f} in {unit}, {least:.2f} in {other}"
                told |= dict.fromkeys(free, (1 / Scaling(unit).factor, words))
        scalings = position_scalings(pairs, told, defined)
        scalings |= self._by_commands([j for j, scaling in scalings.items() if scaling is None])
        for joint, scaling in scalings.items():
            s, _, reason = self.positions[joint]
            if scaling is None:
                words = f"{reason}; its values {s.ends[0]:.6g} to {s.ends[1]:.6g} {s.unit} "
                words += f"fit no unit of {joint!r}: give unit and scale"
                self._open(self.joints[joint].position, s, Scaling(""), words)
                del self.positions[joint]
            else:
                self.positions[joint] = (s, scaling, reason)
        self._take_signs()
        bare: list[str] = []
        for joint, (s, scaling, reason) in self.positions.items():
            if column := self.joints[joint].position:
                self._add(column, s, scaling, reason, scaling.reason)
            else:
                self.why[s.sort] = f"position of {joint!r}, for which the model has no sensor"
                bare.append(joint)
        if bare:
            self.notes.append(
                f"the model has no sensor for the position of {', '.join(map(repr, bare))}: add "
                f'<jointpos name="{bare[0]}_position" joint="{bare[0]}"/> to its <sensor>'
                f"{', and so for each' * (len(bare) > 1)}"
            )
        self._move(self._motion())

    def _motion(self) -> dict[str, list[Array]]:
        return {j: scaling.si(s.runs) for j, (s, scaling, _) in self.positions.items()}

    def _take_signs(self) -> None:
        """Reverse positions whose motion the tool's sensors then read as the model mounts them.

        Another mount would do as much for some; so it has to be more than any mount explains, or
        the joints have to move against their commands, too.
        """
        against = {j for j in self.positions if self._commanded(j)[1] <= -ALIKE}

        def sensed(turned: set[str]) -> Array:
            signs = {j: 1.0 - 2.0 * (j in turned) for j in motion}
            self._move({j: [signs[j] * v for v in own] for j, own in motion.items()}, _ROWS)
            return self._sensed()

        motion, found = self._motion(), set[str]()
        as_named = best = sensed(found)
        while as_named[0]:  # there is a sensor
            tried = {j: sensed({*found, j}) for j in self.positions if j not in found}
            j = max(tried, key=lambda j: tried[j][1], default="")
            if not j or tried[j][1] <= best[1]:
                break
            found, best = {*found, j}, tried[j]
        clear = 1 - best < _CLEARER * (1 - as_named)
        if not clear[1] or not (clear[0] or found <= against):
            found, best = set(), as_named
        self.directed = found | (against if best[1] > ALIKE**2 else set())
        for joint in found:
            s, scaling, reason = self.positions[joint]
            words = f"{reason}; reversed, as the tool's sensors tell"
            self.positions[joint] = (s, replace(scaling, sign=-1), words)

    def _commanded(self, joint: str) -> tuple[Signal, float]:
        """The channel that is most like a command of a position, or like it reversed."""
        s, target = self.positions[joint][0], self.joints[joint]
        own = [c for c in self._free() if self._label(c) in ("", joint)
               and c.meaning.role in ("", "command")]  # fmt: skip
        c = max(own, key=lambda c: abs(self._alike(c, s).correlation), default=s)
        return c, self._alike(c, s).correlation * (target.drive == "position" and c is not s)

    def _followed(self, joint: str) -> tuple[Signal, Array, Array] | None:
        """Command that a position follows; the position, and the command in SI, both slow.

        A servo follows slow commands as they are.
        """
        s, target = self.positions[joint][0], self.joints[joint]
        c, correlation = self._commanded(joint)
        if correlation < ALIKE:
            return None
        scaling = position_scalings({joint: (target, c)}, {}, defined=False)[joint]
        if scaling is None:
            return None
        return c, s.averaged(_SLOW_S), scaling.si([c.averaged(_SLOW_S)])[0]

    def _by_commands(self, joints: Sequence[str]) -> dict[str, Scaling]:
        """Scalings of positions that no unit fits, by the commands that they follow together."""
        followed = {j: self._followed(j) for j in joints if not self.positions[j][0].unit}
        found = {j: each for j, each in followed.items() if each is not None}
        slides = any(self.joints[joint].slide for joint in found)
        words, per = counted([slope([x], [y]) for _, x, y in found.values()], slides)
        return {
            joint: Scaling("m" if slides else "rad", per, float(np.median(y) - per * np.median(x)),
                           f"{words} and a zero by {c.key}, which it follows")
            for joint, (c, x, y) in found.items() if words and self.joints[joint].slide == slides
        }  # fmt: skip

    # --------------------------------------------------------------------- the other roles

    def _take_rest(self) -> None:
        """Velocity, torque and command of every joint, by the largest scores in sum."""
        from scipy.optimize import linear_sum_assignment  # half a second, and only a guess needs it

        candidates = self._free()
        places: list[tuple[str, Role]] = [
            (t.name, role)
            for t in self.joints.values()
            for role in ("velocity", "torque", "command")
            if role != "command" or t.command
        ]
        table = [[self._match(j, role, s) for s in candidates] for j, role in places]
        scores = np.array([[self._score(m, s) for m, s in zip(row, candidates, strict=True)]
                           for row in table]).reshape(len(places), len(candidates))  # fmt: skip
        open_to = np.array([[not m.why for m in row] for row in table]).reshape(scores.shape)
        order = _ORDER * np.outer(np.arange(len(places)), np.arange(len(candidates)))
        pairs = zip(*linear_sum_assignment(scores * open_to + order, maximize=True), strict=True)
        chosen = {k: table[i][k] for i, k in pairs if scores[i, k] >= ALIKE and open_to[i, k]}
        per: dict[object, list[float]] = {}
        for k, match in chosen.items():
            if match.per > 0:
                per.setdefault(self._vector_of(candidates[k]), []).append(match.per)
        for k, match in chosen.items():
            s = candidates[k]
            if match.role == "velocity":
                self._add_velocity(match, s)
            elif match.role == "torque":
                self._add_torque(match, s, float(np.median(per.get(self._vector_of(s), [0.0]))))
            else:
                self._add_command(match, s)
        for k, s in enumerate(candidates):
            if k not in chosen:
                self._leave(s, [(scores[i, k], row[k]) for i, row in enumerate(table)])

    def _leave(self, s: Signal, scored: Sequence[tuple[float, Match]]) -> None:
        """Tell why a channel has no role, and what it is most like."""
        best = sorted(scored, key=lambda each: -each[0])[:2]
        role = s.meaning.role
        own = next((m for score, m in best if m.why and score >= ALIKE), None)
        first = f"by its name of another quantity ({role})" if role else "no role"
        if role == "command":
            of = f" of {s.meaning.of}" if s.meaning.of != "command" else ""
            first = f"a command{of}, which no joint of the model is driven by"
        first = f"{own.words}: {own.why}" if own else first
        like = ", then ".join(
            f"the {m.role} of {m.joint!r} ({m.evidence:.2f})"
            for _, m in best
            if m.evidence > 0 and m is not own
        )
        self.why.setdefault(s.sort, f"{first}; most like {like}" if like else first)

    def _vector_of(self, s: Signal) -> object:
        own = next((i for i, v in enumerate(self.vectors) if s in v.members.values()), s.sort)
        return (s.source, s.meaning.vector) if s.meaning.role else own

    def _score(self, match: Match, s: Signal) -> float:
        """Evidence, and what the name is worth beside it."""
        if match.evidence <= 0.0:
            return match.evidence
        label = self._label(s)
        role = "torque" if s.meaning.role == "current" else s.meaning.role
        own = (label == match.joint) - (label not in ("", match.joint))
        own = own if role in ("", match.role) else min(own, 0)  # the name speaks for another role
        return match.evidence + _NAME * ((role == match.role) + 0.5 * own)

    def _match(self, joint: str, role: Role, s: Signal) -> Match:
        """Evidence of a channel in a role at a joint; none where name or unit contradict."""
        target, own = self.joints[joint], s.meaning.role
        named = own == role or (own == "current" and role == "torque")
        drive = target.drive if role == "command" else role
        of = s.meaning.of if own == "command" else ""
        takes = of in ("", "command", drive) or (of == "current" and drive == "torque")
        if admits(s.unit, role, slide=target.slide, drive=target.drive):
            if role == "velocity" and (named or own in ("", "position")):
                return self._as_velocity(joint, s)
            if role == "torque" and (named or own == ""):
                return self._as_torque(joint, s, named)
            if role == "command" and (named or own in ("", "position", "velocity")) and takes:
                return self._as_command(joint, s)
        return Match(joint, role)

    def _as_velocity(self, joint: str, s: Signal) -> Match:
        if joint not in self.positions:
            return Match(joint, "velocity")
        told = speed_in(self.positions[joint][0], s)
        words = f"the derivative of the position of {joint!r} (correlation {told:.2f})"
        sign = self.positions[joint][1].sign * (1 if told >= 0 else -1)
        return Match(joint, "velocity", abs(told), words, "", sign)

    def _speed(self, s: Signal) -> float:
        """Most that a channel is like the derivative of a position."""
        return max(abs(speed_in(p, s)) for p, _, _ in self.positions.values())

    def _explained(self, joint: str, s: Signal) -> Agreement:
        """What there is of a joint's torque in a channel."""
        if joint not in self.needed or joint not in self.rates:
            return Agreement()
        return torque_in(s.smooth, self.needed[joint], self.rates[joint])

    def _as_torque(self, joint: str, s: Signal, named: bool) -> Match:
        # A torque is of the joint that its name or its place in a vector tells, or of none.
        if self._label(s) not in ("", joint):
            return Match(joint, "torque")
        stated = quantity_of(s.unit) in ("torque", "force") or s.defined
        if not self.needed and named and stated and self._label(s):
            words = f"torque of {joint!r} by its name; the model's cannot be computed"
            return Match(joint, "torque", _TRUSTED, words, per=1.0)
        told = self._explained(joint, s)
        value = told.whole if named else told.alone
        words = f"the torque needed at {joint!r}{' and friction' * named} (correlation {value:.2f})"
        evidence = abs(value)
        if not named:  # a size in no unit speaks against it
            evidence -= _off_size(told.per)
        per = told.per if abs(told.alone) >= _TRUSTED or not named else 0.0
        # A sign is exchanged by what is seen clearly alone.
        sign = -1 if value < -_TRUSTED or (value < 0 and not named) else 1
        return Match(joint, "torque", evidence, words, "", sign, per)

    def _as_command(self, joint: str, s: Signal) -> Match:
        target = self.joints[joint]
        drive = target.drive
        motion = (self.needed if drive == "torque" else self.rates).get(joint)
        if drive == "position" and joint in self.positions:
            p, scaling, _ = self.positions[joint]
            motion = scaling.si(p.runs)
        if motion is None:
            return Match(joint, "command")
        like = likeness(s.runs, motion, self.step)
        value, why = like.correlation, ""
        words = f"the {'torque needed' if drive == 'torque' else 'motion'} at {joint!r}"
        if value <= -ALIKE and joint not in self.directed:
            why = "the joint moves against it: its sign, or the position's, may be reversed"
        elif like.lag < -_LAGS * self.step and drive != "torque":
            why = f"it comes {-1e3 * like.lag:.3g} ms later than the motion"
        elif s.meaning.role == "position" and like.lag < self.step:
            why = "a second sensor of it"
        elif s.meaning.role == "velocity" and drive != "velocity" and value < self._speed(s):
            why = "it is more like a velocity"
        late = f" by {1e3 * like.lag:.3g} ms" if like.lag > _TOGETHER * self.step else ""
        words = f"{words} follows it{late} (correlation {value:.2f})"
        evidence = abs(value) * (1.0 if value > 0 or joint in self.directed else 0.5)
        if drive == "torque" and s.meaning.role == "":
            evidence = min(evidence, 0.99 * self._as_torque(joint, s, False).evidence)
        sign = 1 if value >= 0 else -1
        return Match(joint, "command", evidence, words, why, sign)

    # --------------------------------------------------------------------- lines

    def _add_velocity(self, match: Match, s: Signal) -> None:
        target = self.joints[match.joint]
        ratio = slope(self.rates[match.joint], s.smooth)
        units, scale = SPEEDS if target.slide else RATES, abs(self.positions[match.joint][1].factor)
        scaling = Scaling(s.unit) if s.unit else by_motion(1 / abs(ratio), units, scale)
        words = f"{abs(ratio):.3g} times {match.words}"
        if not target.velocity:
            self.why[s.sort] = f"velocity of {match.joint!r}, for which the model has no sensor"
        elif scaling is not None:
            self._add(target.velocity, s, replace(scaling, sign=match.sign), words)
        else:
            self._open(target.velocity, s, Scaling("rad/s"), f"{words}: no unit is")

    def _add_torque(self, match: Match, s: Signal, per: float) -> None:
        """Line of a torque in the unit of its vector, of which one joint may tell it."""
        target, quantity = self.joints[match.joint], quantity_of(s.unit)
        unit = "N" if target.slide else "N*m"
        current = "current" in (quantity, s.meaning.role)
        told = (s.defined and s.meaning.role == "torque") or 1 / _SAME_UNIT < per < _SAME_UNIT
        if not current and (quantity in ("torque", "force") or (told and not quantity)):
            self._add(target.torque, s, Scaling(s.unit or unit, sign=match.sign), match.words)
            return
        scaling = Scaling(unit, per or 1.0, sign=match.sign)
        why = f"{per:.4g} times it would be that torque [{unit}]: a current?" if per else (
            "mostly friction, which does not tell its unit: give it")  # fmt: skip
        if current:
            scaling = Scaling(s.unit, per * match.evidence or 1.0, sign=match.sign)
            why = "a current: give torque constant times gear as scale [N·m/A]"
            why += f"; {scaling.scale:.4g} fits that torque" if per else ""
        self._open(target.torque, s, scaling, f"{match.words}; {why}")

    def _add_command(self, match: Match, s: Signal) -> None:
        joint, target = match.joint, self.joints[match.joint]
        if target.command in self.lines:
            return
        there, scaling = self.places.get(s.sort, ""), Scaling(s.unit)
        if target.drive == "position":
            scaling = self._scaled_as(s, *self.positions[joint][:2], target)
        elif target.drive == "velocity" and not s.unit:
            ratio, units = slope(self.rates[joint], s.runs), SPEEDS if target.slide else RATES
            scaling = by_motion(1 / abs(ratio), units) or scaling
        words = f"not of {there!r} as by its name or place" * (there not in ("", joint))
        scaling = replace(scaling, sign=match.sign)
        self._add(target.command, s, scaling, words, match.words, scaling.reason)

    def _scaled_as(self, s: Signal, p: Signal, own: Scaling, target: JointTarget) -> Scaling:
        """Scaling of a command by its size beside the position's, which turns to where it is."""
        units = ("m", "mm") if target.slide else ("rad", "deg")
        ratio = abs(slope(own.si(p.runs), s.runs))
        like = abs(math.log(max(abs(slope(p.runs, s.runs)), 1e-9)))
        best, off = nearest_unit(ratio, units)
        plain = own.scale == 1.0 and own.offset == 0.0
        if s.unit and s.unit != "%":
            scaling = Scaling(s.unit, reason=f"{s.unit} as stated")
        elif like <= (off if plain else off + 0.5):
            scaling = replace(own, reason="scaled as the position")
        else:
            scaling = Scaling(best, reason=f"{best}: {ratio:.3g} times the position [{units[0]}]")
        if p.period is not None and target.position in self.lines:
            turn = p.period * own.factor
            apart = np.concatenate(scaling.si(s.runs)) - np.concatenate(own.si(p.runs))
            turns = round(float(np.median(apart)) / turn)
            line = self.lines[target.position]
            self.lines[target.position] = replace(
                line,
                scaling=replace(own, offset=own.offset + turns * turn),
                reason=line.reason + f"; {turns} turns on, where its command is" * bool(turns),
            )
        return scaling

    def _with_exchange(self) -> Roles:
        """Roles with the states of joints exchanged that carry each other's names.

        Tried is the exchange by which each joint follows its own command; without commands, the
        one by which the states explain the torques, joint by joint. Witnesses decide.
        """
        named = {self._label(s): s for s in self.signals if s.meaning.role == "torque" and s.moves}
        torques, commands = (
            {t.name: self.lines[column].candidate for t in self.joints.values()
             if (column := getattr(t, kind)) in self.lines} for kind in ("torque", "command")
        )  # fmt: skip
        torques = {j: s for j, s in (named | torques).items() if j in self.needed}
        label = {j: self._label(s) for j, s in commands.items()}
        other = {j: to for j, to in label.items() if to not in ("", j) and to in label}
        asked, motion = set(other) == set(other.values()) != set(), self._motion()
        if not asked and (commands or len(torques) < 2):
            return self
        other = other if asked else self._by_torques(torques, motion)
        as_named = self._told_by(torques)
        self._move({other.get(j, j): own for j, own in motion.items()}, _ROWS)
        # Where commands tell, the torques have the names of the states.
        own = {other.get(j, j) if asked else j: s for j, s in torques.items()}
        exchanged = self._told_by(own)
        names = ", ".join(map(repr, sorted(other)))
        told = f"torques are explained by {as_named:.2f}, exchanged by {exchanged:.2f}"
        if 1 - exchanged < _CLEARER * (1 - as_named):
            columns = {c: to for j, to in other.items() for c in self.joints[j].columns[:2]}
            moved = {
                line.candidate.sort: columns[c] for c, line in self.lines.items() if c in columns
            }
            moved |= {s.sort: j for j, s in own.items()}
            signals = [replace(s, meaning=replace(s.meaning, joint=moved[s.sort]))
                       if s.sort in moved else s for s in self.signals]  # fmt: skip
            words = "each follows another's command, and " * asked
            note = f"the states of {names} are exchanged: {words}{told}"
            return Roles(self.model, signals).found(note)
        if asked:
            self.notes.append(
                f"{names} follow each other's commands: the names of the commands are exchanged, "
                f"as assumed here, or those of the states; {told if torques else 'no torque tells'}"
            )
        return self

    def _by_torques(
        self, torques: Mapping[str, Signal], motion: Mapping[str, list[Array]]
    ) -> dict[str, str]:
        """Joint to which the state of each belongs: those that best explain the torques in sum."""
        from scipy.optimize import linear_sum_assignment

        names = [*torques]
        table = np.zeros((len(names), len(names)))
        for a, b in itertools.combinations_with_replacement(range(len(names)), 2):
            swap = {names[a]: names[b], names[b]: names[a]}
            self._move({swap.get(j, j): own for j, own in motion.items()}, _ROWS)
            for i, k in ((a, b), (b, a)):  # the torque of i by the state of k
                table[k, i] = self._told_by({names[i]: torques[names[i]]})
        return {
            names[k]: names[i]
            for k, i in zip(*linear_sum_assignment(-table), strict=True)
            if k != i
        }

    def _told_by(self, torques: Mapping[str, Signal]) -> float:
        """Share of the witnesses' variance that the model explains, less what sizes are off."""
        told = [self._explained(j, s) for j, s in torques.items()]
        scores = [t.alone**2 - _off_size(t.per) for t in told]
        return float(np.mean(scores)) if scores else 0.0

    def _take_still(self) -> None:
        """Joints at rest: constant positions and commands beside others of their vector."""
        for s in self.signals:
            if not s.moves and s.values.size:
                self.why[s.sort] = f"constant, {s.values[0]:.6g}"
        roles = {getattr(t, role): role for t in self.joints.values()
                 for role in ("position", "command")}  # fmt: skip
        of = {line.candidate.sort: line for column, line in self.lines.items() if column in roles}
        for members in (v.members for v in self.vectors if v.given):
            own = next((of[s.sort] for s in members.values() if s.sort in of), None)
            for joint, s in members.items() if own else ():
                t, scaling = self.joints[joint], own.scaling if own else None
                column = getattr(t, roles[own.column]) if own else ""
                if column and column not in self.lines and not s.moves and s.values.size:
                    if scaling is None or scaling.scale != 1.0:
                        scaling = position_scalings({joint: (t, s)}, {}, defined=False)[joint]
                    if scaling is not None:
                        self._add(column, s, Scaling(scaling.unit, scaling.scale, scaling.offset),
                                  f"{joint!r} is at rest")  # fmt: skip

    def _add(self, column: str, s: Signal, scaling: Scaling, *reasons: str) -> None:
        reason = "; ".join(filter(None, reasons))
        if not column or column in self.lines:
            self._open(column, s, scaling, reason)
            return
        self.used.add(s.sort)
        self.lines[column] = Line(column=column, candidate=s, scaling=scaling, reason=reason)

    def _open(self, column: str, s: Signal, scaling: Scaling, reason: str) -> None:
        """Add a line that lacks something, as a comment."""
        self.used.add(s.sort)
        self.open.append(
            Line(column=column, candidate=s, scaling=scaling, reason=reason, open=True)
        )

    def left(self) -> tuple[Line, ...]:
        """Channels that are not used, each with the reason and what it is most like."""
        taken = {line.candidate.sort for line in (*self.lines.values(), *self.open)}
        return tuple(
            Line(column="", candidate=s, scaling=Scaling(s.unit), open=True,
                 reason=self.why.get(s.sort, "no role") if s.values.size else s.why)
            for s in self.signals if s.sort not in taken
        )  # fmt: skip


def _off_size(per: float) -> float:
    """What the size of a witness speaks against it, whose units should be SI [1]."""
    return min(_UNIT, 0.5 * _UNIT * abs(math.log(max(per, 1e-9))))
