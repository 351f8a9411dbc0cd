"""Commands matched to joints by the motion that follows, torques by those that a model needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from scipy import ndimage
from scipy.optimize import linear_sum_assignment

from loose_env.importing.guessing.joint_targets import JointTarget, inverse_torques
from loose_env.importing.guessing.roles import Assigned, Candidate
from loose_env.importing.guessing.signals import (
    Likeness,
    correlation,
    derivative,
    likeness,
    moves,
)
from loose_env.typing import Array

_CLEAR = 0.2
"""Difference of correlations from which another joint counts as the one commanded [1]."""
_TORQUE = 0.6
"""Least correlation of a channel with the model's torque for which it is one [1]."""
_SMOOTHED = 9
"""Samples over which positions are averaged before they are differentiated twice."""


def matched_commands(
    commands: Sequence[Assigned], motion: Mapping[str, Array], step: float
) -> list[tuple[Assigned, Likeness | None]]:
    """Assign commands to the joints whose motion follows them.

    Names decide where they have the joint's; else the assignment of largest correlations in sum
    does.
    """
    joints = {each.joint.name: each.joint for each in commands if each.joint.name in motion}
    names = [n for n in joints if moves(motion[n])]
    usable = [each for each in commands if moves(each.candidate.values)]
    table = [
        [likeness(each.candidate.values, motion[name], step) for name in names] for each in usable
    ]
    better: dict[int, str] = {}
    if table and names:
        strength = np.array([[abs(cell.correlation) for cell in row] for row in table])
        rows, columns = linear_sum_assignment(-strength)
        better = {int(i): names[int(j)] for i, j in zip(rows, columns, strict=True)}
    found: list[tuple[Assigned, Likeness | None]] = []
    for each in commands:
        i = usable.index(each) if each in usable else -1
        own = each.joint.name
        if i < 0 or own not in names:
            found.append((each, None))
            continue
        like, other = table[i][names.index(own)], better.get(i, own)
        reason, joint = each.reason, each.joint
        best = table[i][names.index(other)]
        if other != own and abs(best.correlation) > abs(like.correlation) + _CLEAR:
            if each.labelled:
                reason += f"; but {other!r} follows it, {best.correlation:.2f}: check"
            else:
                reason = f"{other!r} follows it, and not {own!r} ({like.correlation:.2f})"
                joint, like = joints[other], best
        words = f"; correlation {like.correlation:.2f}, delay {like.lag:.3g} s"
        found.append((replace(each, joint=joint, reason=reason + words), like))
    return found


def commanded_motion(
    targets: Sequence[JointTarget],
    positions: Mapping[str, Array],
    torques: Array | None,
    model: mujoco.MjModel,
    step: float,
) -> dict[str, Array]:
    """Quantity that the actuator of each joint commands, by the joint's name [SI]."""
    found = {}
    for each in targets:
        if each.drive == "torque":
            if torques is not None:
                found[each.name] = torques[:, model.joint(each.name).dofadr[0]]
        elif each.name in positions:
            own = positions[each.name]
            found[each.name] = own if each.drive == "position" else derivative(own, step)
    return found


def needed_torques(
    model: mujoco.MjModel, positions: Mapping[str, Array], step: float
) -> Array | None:
    """Torques that the model needs for a measured motion, as `inverse_torques`; smoothed."""
    if not positions:
        return None
    smooth = {name: smoothed(p) for name, p in positions.items()}
    return inverse_torques(model, smooth, step)


def smoothed(values: Array) -> Array:
    """Average over as many samples as the positions that torques are derived from, shape (T,)."""
    return np.asarray(ndimage.uniform_filter1d(values, _SMOOTHED))


def torques_by_signal(
    candidates: Sequence[Candidate],
    targets: Sequence[JointTarget],
    torques: Array,
    model: mujoco.MjModel,
) -> list[tuple[Assigned, float]]:
    """Channels that correlate with the torque that the model needs, each with the correlation."""
    moving = [each for each in candidates if moves(each.values)]
    if not moving:
        return []
    columns = [int(model.joint(each.name).dofadr[0]) for each in targets]
    table = np.array(
        [[correlation(each.values, torques[:, c]) for c in columns] for each in moving]
    )
    found = []
    for i, j in zip(*linear_sum_assignment(-np.abs(table)), strict=True):
        value = float(table[i, j])
        if abs(value) < _TORQUE:
            continue
        words = f"correlates {value:.2f} with the torque that the model needs for the motion"
        assigned = Assigned(
            candidate=moving[int(i)], role="torque", joint=targets[int(j)], reason=words
        )
        found.append((assigned, value))
    return found
