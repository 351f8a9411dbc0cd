"""Assignment of channels to joints: by names where they tell, else by their signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from loose_env.importing.guessing.channel_names import Meaning, Role, names_joint, telling_words
from loose_env.importing.guessing.joint_targets import JointTarget
from loose_env.importing.guessing.quantities import admits, is_rate, same_quantity
from loose_env.importing.guessing.signals import correlation, derivative, likeness, moves
from loose_env.importing.samples import ChannelKey
from loose_env.typing import Array

_RATE = 0.8
"""Least correlation of a channel with the derivative of another for which it is its rate [1]."""
_ALIKE = 0.8
"""Least correlation of a command with the motion that follows it [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A channel of a log, with its signal on the common time base."""

    source: str
    key: ChannelKey
    unit: str
    """Unit that the file, or its format, gives."""
    meaning: Meaning
    values: Array
    """Shape (T,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Assigned:
    """A channel with its role and joint, and the reason."""

    candidate: Candidate
    role: Role
    joint: JointTarget
    reason: str
    labelled: bool = False
    """True if the channel's name has the joint's name."""


def assigned_by_name(
    candidates: Sequence[Candidate], targets: Sequence[JointTarget]
) -> list[Assigned]:
    """Assign channels whose names tell their quantity.

    The joint is the one whose name the channel has, else the one at the channel's place in its
    vector. Of several vectors of one quantity the one that reaches most joints is taken.
    """
    groups: dict[tuple[object, ...], list[Candidate]] = {}
    for each in candidates:
        meaning = each.meaning
        if meaning.role in ("position", "velocity", "torque", "current", "command"):
            # "position[elbow]" is an entry of a vector, "elbow [deg]" has a unit.
            entry = each.key.channel.endswith("]") and " " not in each.key.channel
            alone = meaning.index is None and not entry
            vector = "" if alone else meaning.group[1]  # shoulder_pos, elbow_pos: one vector
            group = (each.source, meaning.role, meaning.of, meaning.group[0], vector)
            groups.setdefault(group, []).append(each)
    best: dict[Role, list[Assigned]] = {}
    for own in groups.values():
        found = _of_vector(own, targets)
        role = own[0].meaning.role
        if _rank(found) > _rank(best.get(role, [])):
            best[role] = found
    return [each for found in best.values() for each in found]


def assigned_by_signal(
    candidates: Sequence[Candidate], targets: Sequence[JointTarget], step: float
) -> list[Assigned]:
    """Assign channels without telling names by their derivatives and delays.

    A channel whose stated unit is that of another quantity is none of them. One that correlates
    with the derivative of another is its velocity. Of two channels that correlate, the one that
    leads is the command. Positions are taken in the order of the joints.
    """
    moving = [each for each in candidates if moves(each.values) and _of_a_joint(each, targets)]
    rates = _rates(moving, step)
    left = [i for i in range(len(moving)) if i not in rates.values()]
    commands = _commands(moving, left, rates, step)
    followed = {position for position, _, _, _ in commands}
    driving = {command for _, command, _, _ in commands}
    related = [i for i in left if i not in driving and (i in rates or i in followed)]
    positions = related or [i for i in left if i not in driving]
    positions = [i for i in positions if any(_is_position(moving[i], t) for t in targets)]
    if not related and len(positions) != len(targets):
        return []
    found: list[Assigned] = []
    for place, i in enumerate(positions, 1):
        taken = {each.joint.name for each in found}
        free = [t for t in targets if t.name not in taken and _is_position(moving[i], t)]
        if not free:
            continue
        joint = free[0]
        order = f"position {place} of {len(positions)} in the file's order"
        found.append(
            Assigned(candidate=moving[i], role="position", joint=joint, reason=f"{order}, assumed")
        )
        if i in rates:
            value = correlation(derivative(moving[i].values, step), moving[rates[i]].values)
            words = f"correlates {value:.2f} with the derivative of {moving[i].key.channel!r}"
            found.append(
                Assigned(candidate=moving[rates[i]], role="velocity", joint=joint, reason=words)
            )
        for position, command, value, lag in commands:
            if position == i:
                leads = f"leads it by {lag:.3g} s" if lag else "without delay, so either may lead"
                words = f"correlates {value:.2f} with {moving[i].key.channel!r} and {leads}"
                found.append(
                    Assigned(candidate=moving[command], role="command", joint=joint, reason=words)
                )
    return found


def _is_position(each: Candidate, joint: JointTarget) -> bool:
    return admits(each.unit, "position", slide=joint.slide)


def _of_a_joint(each: Candidate, targets: Sequence[JointTarget]) -> bool:
    """Return whether a stated unit allows a channel to be motion or command of any joint."""
    roles: tuple[Role, ...] = ("position", "velocity", "command")
    return any(admits(each.unit, role, slide=t.slide) for role in roles for t in targets)


def _rank(found: Sequence[Assigned]) -> tuple[int, int, int]:
    labelled = sum(each.labelled for each in found)
    fits = sum(each.candidate.meaning.of in ("command", each.joint.drive) for each in found)
    return len(found), fits if found and found[0].role == "command" else 0, labelled


def _of_vector(own: Sequence[Candidate], targets: Sequence[JointTarget]) -> list[Assigned]:
    """Channels of one vector, each with its joint."""
    telling = telling_words([target.name for target in targets])
    if own[0].meaning.role == "command":
        targets = [each for each in targets if each.command]
    indices = [each.meaning.index for each in own if each.meaning.index is not None]
    lowest = min(indices, default=0)
    numbered = len(indices) == len(own) >= len(targets) > 0
    taken: set[str] = set()
    found = []
    for each in own:
        sizes = {t.name: names_joint(each.meaning.words, t.name) for t in targets}
        if not any(sizes.values()):  # no whole name: a word that no other joint has
            named = {telling[word] for word in each.meaning.words if word in telling}
            sizes = {t.name: int(t.name in named) for t in targets}
        most = max(sizes.values(), default=0)
        fitting = [t for t in targets if sizes[t.name] == most > 0]
        role = each.meaning.role
        if fitting and not any(admits(each.unit, role, slide=t.slide) for t in fitting):
            continue
        if len(fitting) == 1 and fitting[0].name not in taken:
            joint = fitting[0]
            words = f"name has {role} of {joint.name!r}"
            found.append(
                Assigned(candidate=each, role=role, joint=joint, reason=words, labelled=True)
            )
        elif numbered and each.meaning.index is not None:
            place = each.meaning.index - lowest
            if place >= len(targets) or targets[place].name in taken:
                continue
            joint = targets[place]
            if not admits(each.unit, role, slide=joint.slide):
                continue
            words = f"entry {place + 1} of {role} {each.meaning.group[1]!r}, in the joints' order"
            found.append(Assigned(candidate=each, role=role, joint=joint, reason=words))
        else:
            continue
        taken.add(joint.name)
    return found


def _rates(moving: Sequence[Candidate], step: float) -> dict[int, int]:
    """Number of a channel -> number of the one that is its velocity."""
    slopes = [derivative(each.values, step) for each in moving]
    pairs = [
        (correlation(slopes[i], moving[j].values), i, j)
        for i in range(len(moving))
        for j in range(len(moving))
        if i != j and is_rate(moving[j].unit, moving[i].unit)
    ]
    found: dict[int, int] = {}
    # The exact derivative goes first; of equal ones the one with the same sign.
    for value, i, j in sorted(pairs, key=lambda p: (-round(abs(p[0]), 2), -p[0], p[1:])):
        if abs(value) < _RATE:
            break
        if i not in found and j not in found.values() and j not in found:
            found[i] = j
    return {i: j for i, j in found.items() if i not in found.values()}


def _commands(
    moving: Sequence[Candidate], left: Sequence[int], rates: dict[int, int], step: float
) -> list[tuple[int, int, float, float]]:
    """Pairs of position and command among channels, each with correlation and delay."""
    pairs = []
    for at, i in enumerate(left):
        for j in left[at + 1 :]:
            if not same_quantity(moving[i].unit, moving[j].unit):
                continue
            found = likeness(moving[i].values, moving[j].values, step)
            lead, follow, lag = (i, j, found.lag) if found.lag > 0 else (j, i, -found.lag)
            if lag < step / 2 or (follow not in rates and lead in rates):
                # The channel whose velocity was recorded, too, is the measured one.
                lead, follow = (j, i) if i in rates or j not in rates else (i, j)
            pairs.append((abs(found.correlation), lead, follow, found.correlation, lag))
    taken: set[int] = set()
    found_pairs = []
    for strength, lead, follow, value, lag in sorted(pairs, reverse=True):
        if strength < _ALIKE:
            break
        if lead not in taken and follow not in taken:
            taken |= {lead, follow}
            found_pairs.append((follow, lead, value, lag))
    return found_pairs
