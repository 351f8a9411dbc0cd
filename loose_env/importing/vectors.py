"""Vectors of channels: of one quantity, each of its joint, by names, by brackets or by order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from loose_env.importing.evidence import Signal
from loose_env.importing.targets import JointTarget

_STRIDES = 5
"""Most quantities that a log may have of each joint in turn."""


@dataclass(eq=False)
class Vector:
    """Channels of one quantity, each of its joint."""

    members: dict[str, Signal]
    words: str
    """Where the joints follow from."""
    given: bool = False
    """True if the file itself makes a vector of them, by names or brackets."""


@dataclass(eq=False)
class Labels:
    """Joints that the names of channels tell, and the vectors that follow."""

    targets: Sequence[JointTarget]

    def named(self, s: Signal) -> tuple[str, str]:
        """Role and joint of a channel that is named as a sensor or actuator of the model."""
        text = s.key.channel
        for t in self.targets:
            for role, column in (("position", t.position), ("velocity", t.velocity),
                                 ("torque", t.torque), ("command", t.command)):  # fmt: skip
                bare = column.split(".", 1)[-1]
                alone = bare if role != "torque" and bare != t.name else column
                if column and text in (column, alone):
                    return role, t.name
                if role == "command" and column and text == f"{bare}_ctrl":
                    return role, t.name
            if text in (f"{t.name}_qpos", f"{t.name}_qvel"):
                return ("position" if text.endswith("pos") else "velocity"), t.name
        return "", ""

    def joint(self, s: Signal) -> str:
        """Joint that a channel names; that of the only one where it names none."""
        return self.named(s)[1] or s.meaning.joint or (
            self.targets[0].name if len(self.targets) == 1 else ""
        )  # fmt: skip

    def vectors(self, signals: Sequence[Signal]) -> list[Vector]:
        """Channels that belong together by their names, by brackets, or by their order."""
        found: list[Vector] = []
        groups: dict[tuple[object, ...], list[Signal]] = {}
        rest: list[Signal] = []
        for s in signals:
            role, joint = self.named(s)
            if joint:
                groups.setdefault(("named", s.source, role), []).append(s)
            elif s.meaning.joint:
                groups.setdefault(("label", s.source, s.meaning.vector), []).append(s)
            elif len(self.targets) == 1:
                groups.setdefault(("only", s.source, s.sort), []).append(s)
            elif s.meaning.index is not None and (s.meaning.entry or s.meaning.role):
                groups.setdefault(("index", s.source, s.meaning.vector), []).append(s)
            else:
                rest.append(s)
        driven = [t.name for t in self.targets if t.command]
        names = [t.name for t in self.targets]
        for (kind, *_), own in groups.items():
            if kind != "index":
                while own:  # a joint may have two channels of one name
                    members = {self.joint(s): s for s in reversed(own)}
                    own = [s for s in own if s not in members.values()]
                    words = "of the only joint" if kind == "only" else "by its name"
                    found.append(Vector(members, words, kind != "only"))
                continue
            own = sorted(own, key=lambda s: s.meaning.index or 0)
            order = next((o for o in (names, driven) if len(o) == len(own)), None)
            if order is None and len(own) > len(names) and own[0].meaning.role:
                order = names
            if order is None:
                rest += own
                continue
            place = {n: s for n, s in zip(order, own, strict=False)}
            found.append(Vector(place, "by its place in the vector", True))
        return found + self._blocks(sorted(rest, key=lambda s: s.sort))

    def _blocks(self, rest: list[Signal]) -> list[Vector]:
        """Vectors of channels without telling names: as many as joints, in a row or in turns."""
        names, count = [t.name for t in self.targets], len(self.targets)
        found: list[Vector] = []
        for source in dict.fromkeys(s.source for s in rest):
            own = [s for s in rest if s.source == source and s.meaning.role != "other" and s.moves]
            for stride in range(1, _STRIDES + 1) if count > 1 else ():
                words = "in the file's order" if stride == 1 else f"every {stride}th channel"
                for first in range(len(own) - stride * (count - 1)):
                    block = own[first : first + stride * (count - 1) + 1 : stride]
                    found.append(Vector(dict(zip(names, block, strict=True)), words))
        return found
