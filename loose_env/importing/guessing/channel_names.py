"""Meaning of a channel by its name: quantity, joint label, and place in a vector."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from loose_env.importing.samples import ChannelKey

Role = Literal["position", "velocity", "torque", "current", "command", "acceleration", "other", ""]
"""Quantity that a channel seems to hold; "" where the name says nothing."""

_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_UNIT = re.compile(r"[\[(][^\[\]()]*[\])]\s*$")
_ENTRY = re.compile(r"(.*?)\[([^\[\]]+)\]$")
_NUMBERED = re.compile(r"(.*?\D)(\d+)$")
_TABLE = """
other: tcp temperature temperatures voltage mode bits momentum pose quat eef wrench fraction
other: scaling sin cos image reward done force index task time timestamp stamp frame next
other: orientation twist
command: target command commands cmd action actions desired des ref reference setpoint goal ctrl
command: control controls
acceleration: qdd ddq acc accel acceleration accelerometer qacc
velocity: velocity velocities vel qd dq qvel speed rate
torque: effort torque torques tau moment frc
current: current currents amps
position: position positions pos q qpos angle angles encoder enc state
"""
_WORDS: dict[str, set[str]] = {}
"""Quantity -> words that name it, in the order in which quantities are tried."""
for _line in _TABLE.strip().splitlines():
    _role, _, _rest = _line.partition(":")
    _WORDS.setdefault(_role, set()).update(_rest.split())
_TELLING = 3
"""Fewest letters of a word by which a channel names a joint."""
_AXES = {"0": "x", "1": "y", "2": "z", "x": "x", "y": "y", "z": "z"}


@dataclass(frozen=True)
class Meaning:
    """Meaning of a channel by its name."""

    role: Role
    of: Role
    """Quantity commanded, where the role is "command"; else the role."""
    group: tuple[str, str]
    """Topic and name of the vector that the channel is an entry of."""
    index: int | None
    """Place in that vector, where the name has a number."""
    words: tuple[str, ...]
    """Words of the whole name, in lower case."""

    @property
    def axis(self) -> str:
        """Axis x, y or z that the name ends with, alone or as in ``ax``; else ""."""
        last = self.words[-1] if self.words else ""
        return _AXES.get(last, last[1:] if last in ("ax", "ay", "az") else "")


def meaning_of(key: ChannelKey) -> Meaning:
    """Read the name of a channel.

    Examples
    --------
    >>> found = meaning_of(ChannelKey("target_qd_3"))
    >>> found.role, found.of, found.index
    ('command', 'velocity', 3)
    >>> meaning_of(ChannelKey("position[elbow]", "/joint_states")).role
    'position'
    """
    plain = _UNIT.sub("", key.channel).strip() if not key.channel.endswith("]") else key.channel
    if key.channel.endswith("]") and " " in key.channel:  # a table's "elbow [deg]"
        plain = _UNIT.sub("", key.channel).strip()
    base, index = plain, None
    found = _ENTRY.fullmatch(plain)
    numbered = _NUMBERED.fullmatch(plain)
    if found is not None:
        base = found.group(1)
        index = int(found.group(2)) if found.group(2).isdigit() else None
    elif numbered is not None:
        base, index = numbered.group(1), int(numbered.group(2))
    words = tuple(words_of(plain))
    own = set(words) | ({"command"} if set(words_of(key.topic)) & _WORDS["command"] else set())
    roles = [role for role, known in _WORDS.items() if own & known]
    role, of = "", ""
    if roles:
        role = roles[0]
        of = next((each for each in roles if each != "command"), "")
        if role == "command" and of == "":
            of = "command"
    return Meaning(role, of, (key.topic, base.rstrip("_. ")), index, words)  # type: ignore[arg-type]


def words_of(name: str) -> list[str]:
    """Words of a name, in lower case.

    Examples
    --------
    >>> words_of("shoulderPan_joint.pos")
    ['shoulder', 'pan', 'joint', 'pos']
    """
    return [word.lower() for word in _WORD.findall(name)]


def names_joint(words: tuple[str, ...], joint: str) -> int:
    """Number of words of a joint's name that a channel's words contain in a row; 0 where not all.

    Examples
    --------
    >>> names_joint(("observation", "state", "shoulder", "pan", "pos"), "shoulder_pan_joint")
    2
    """
    own = [word for word in words_of(joint) if word != "joint"] or words_of(joint)
    span = len(own)
    there = any(list(words[i : i + span]) == own for i in range(len(words) - span + 1))
    return span if there and span else 0


def telling_words(joints: Sequence[str]) -> dict[str, str]:
    """Words that the name of one joint alone has, and that name no quantity -> that joint.

    Examples
    --------
    >>> telling_words(["shoulder_pitch", "elbow_pitch", "wrist_1", "wrist_2"])
    {'shoulder': 'shoulder_pitch', 'elbow': 'elbow_pitch'}
    """
    found: dict[str, str] = {}
    everywhere = [set(words_of(joint)) for joint in joints]
    quantities = set().union(*_WORDS.values())
    for joint in joints:
        for word in words_of(joint):
            alone = sum(word in words for words in everywhere) == 1
            if alone and len(word) >= _TELLING and word not in quantities:
                found[word] = joint
    return found
