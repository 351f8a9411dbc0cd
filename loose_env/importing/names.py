"""Meaning of a channel by its name: quantity, joint, and place in a vector; a prior, no proof."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from loose_env.importing.samples import ChannelKey

Role = Literal["position", "velocity", "torque", "current", "command", "acceleration", "other", ""]
"""Quantity that a channel seems to hold; "" where the name says nothing."""

_WORD = re.compile(r"[A-ZÄÖÜ]?[a-zäöüß]+|[A-ZÄÖÜ]+(?![a-zäöüß])|\d+")
_UNIT = re.compile(r"\s*[\[(][^\[\]()]*[\])]\s*$")
_ENTRY = re.compile(r"(.*)\[([^\[\]]+)\]$")
_NUMBERED = re.compile(r"(.*\D)?(\d+)(\D*)$")
_TABLE = """
other: tcp temp temperature temperatures volt volts voltage mode bits momentum pose quat eef wrench
other: fraction scaling sin cos image reward done index task frame next orientation twist
other: error err seq count counter id status state_machine enable kp kd gain mass
command: target target command commands cmd action actions desired des ref reference setpoint goal
command: ctrl control controls soll sollwert demand tgt sp set cmds traj trajectory
acceleration: qdd ddq acc accel acceleration accelerometer qacc gyro gyr gyroscope imu
acceleration: gx gy gz
velocity: velocity velocities vel qd dq qvel speed rate omega
torque: effort torque torques tau moment force forces frc load
current: current currents amps
position: position positions pos q qpos angle angles encoder enc state states ist
"""
_WORDS: dict[str, set[str]] = {}
"""Quantity -> words that name it, in the order in which quantities are tried."""
for _line in _TABLE.strip().splitlines():
    _role, _, _rest = _line.partition(":")
    _WORDS.setdefault(_role, set()).update(_rest.split())
_TELLING = 3
"""Fewest letters of a word by which a channel names a joint."""


@dataclass(frozen=True)
class Meaning:
    """Meaning of a channel by its name."""

    role: Role
    of: Role
    """Quantity commanded, where the role is "command"; else the role."""
    joint: str
    """Joint that the name has; "" where it has none."""
    vector: tuple[str, ...]
    """What is left of the name without joint and number: equal for the channels of a vector."""
    index: int | None
    """Place in that vector, where the name has a number."""
    array: str
    """Array of which it is an entry, in brackets, so that the file makes a vector; else ""."""
    words: tuple[str, ...]
    """Words of the whole name, in lower case."""

    @property
    def axis(self) -> tuple[tuple[str, ...], str]:
        """Words without the axis, or number, that the name has last; and that axis, or ""."""
        for i, word in reversed([*enumerate(self.words)]):
            stem, axis = ("", word) if word.isdigit() else (word[:-1], word[-1])
            known = len(stem) < 2 or any(stem in each for each in _WORDS.values())
            if axis.isdigit() or (axis in "xyz" and known):
                return (*self.words[:i], stem, *self.words[i + 1 :]), axis
        return self.words, ""


def meaning_of(
    key: ChannelKey, joints: Mapping[str, Sequence[str]] | None = None, beside: str = ""
) -> Meaning:
    """Read the name of a channel by the names of each joint; ``beside`` has further words.

    Examples
    --------
    >>> found = meaning_of(ChannelKey("target_qd_3"))
    >>> found.role, found.of, found.index
    ('command', 'velocity', 3)
    >>> joints = {"elbow": ["elbow", "bend"], "wrist": ["wrist"]}
    >>> found = meaning_of(ChannelKey("position[bend]", "/joint_states"), joints)
    >>> found.role, found.joint
    ('position', 'elbow')
    """
    entry = _ENTRY.fullmatch(key.channel) if " " not in key.channel else None
    plain = key.channel if entry else _UNIT.sub("", key.channel).strip()
    numbered = _NUMBERED.fullmatch(plain)
    index = int(numbered[2]) if numbered is not None else None
    words = tuple(words_of(plain))
    joint, own = _joint_of(words, joints or {})
    left = [i for i in range(len(words)) if i not in own]
    last = max((i for i, word in enumerate(words) if word.isdigit()), default=-1)
    rest = tuple(words[i] for i in left if i != last)
    roles = _roles(set(rest) | set(words_of(beside)) if rest or beside else set(words))
    wanted = len(rest) > 1 and rest[-1] == "d"  # q_d, tau_J_d: desired
    commanded = wanted or set(words_of(key.topic)) & _WORDS["command"]
    if commanded and "command" not in roles and "other" not in roles:
        roles = ["command", *roles]
    role = roles[0] if roles else ""
    of = next((each for each in roles if each != "command"), role)
    vector = (key.topic, beside, *rest)
    array = f"{key.topic} {entry[1]}" if entry else ""
    return Meaning(role, of, joint, vector, index, array, words)  # type: ignore[arg-type]


def quantities(name: str) -> list[str]:
    """Quantities that the words of a name tell, such as those of a file's."""
    return _roles(set(words_of(name)))


def words_of(name: str) -> list[str]:
    """Words of a name, in lower case.

    Examples
    --------
    >>> words_of("shoulderPan_joint.pos")
    ['shoulder', 'pan', 'joint', 'pos']
    """
    return [word.lower() for word in _WORD.findall(name)]


def _roles(words: set[str]) -> list[str]:
    return [role for role, known in _WORDS.items() if words & known]


def _joint_of(words: tuple[str, ...], joints: Mapping[str, Sequence[str]]) -> tuple[str, set[int]]:
    """Joint that a name has, and the places of the words by which: a whole name, or a word."""
    found: dict[int, dict[str, set[int]]] = {}
    for joint, names in joints.items():
        for places in (places for name in names if (places := _named(words, name))):
            found.setdefault(len(places), {}).setdefault(joint, places)
    if found:
        fitting = found[max(found)]
        ((joint, own),) = fitting.items() if len(fitting) == 1 else (("", set[int]()),)
        return joint, own | {i for i, word in enumerate(words) if word == "joint" and joint}
    known = set().union(*_WORDS.values()) | {"joint", "motor", "axis"}
    named = {j: {w for name in names for w in words_of(name)} for j, names in joints.items()}
    of = {w: [j for j in named if w in named[j]] for w in words if len(w) >= _TELLING}
    telling = {w: each[0] for w, each in of.items() if len(each) == 1 and w not in known}
    joint = next(iter(telling.values())) if len({*telling.values()}) == 1 else ""
    return joint, {i for i, word in enumerate(words) if joint and word in telling}


def _named(words: tuple[str, ...], joint: str) -> set[int]:
    """Places of the words of a joint's name that a channel's contain in a row; none if not all."""
    own = [word for word in words_of(joint) if word != "joint"]
    if all(word.isdigit() for word in own):  # a number alone is a place, not a name
        own = words_of(joint)
    starts = range(len(words) - len(own) + 1) if own else range(0)
    return next(({*range(i, i + len(own))} for i in starts if [*words[i : i + len(own)]] == own),
                set())  # fmt: skip
