"""Split of a body in an MJCF spec: its children, sites and geoms moved to a new body."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from loose_env.gap.model.effects.mjcf.joint_effect import added_name
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

_MOVED = "moved_"
"""Prefix of what is on its way; only copies of the model's defaults keep it."""
_NOT_COPIED = frozenset(
    (
        "id", "parent", "signature", "frame", "name", "info", "plugin", "classname", "compiler",
        "pos", "quat", "fromto",
    )
)  # fmt: skip
_ROUNDING = 1e-9


def move_children(
    machine: NominalModel,
    spec: mujoco.MjSpec,
    old: mujoco.MjsBody,
    new: mujoco.MjsBody,
    along: Array,
) -> None:
    """Move the bodies on the far side of ``new`` from ``old`` to it, with subtrees.

    MuJoCo cannot move a body within a spec; a copy of it is attached instead. References by name,
    actuators and sensors among them, keep their order: the names are released before the originals
    are deleted and reassigned to the copies.
    """
    here = np.array(new.pos)
    moving = []
    for child in list(old.bodies):
        place, turn = _pose(machine, child)
        if child.name != new.name and (place - here) @ along >= -_ROUNDING:
            moving.append((child.name, place - here, turn))
    if not moving:
        return
    copy = spec.copy()
    for several in (
        copy.actuators, copy.sensors, copy.equalities, copy.tendons, copy.keys, copy.excludes,
        copy.pairs,
    ):  # fmt: skip
        for element in list(several):
            copy.delete(element)
    frame = new.add_frame()
    for name, place, turn in moving:
        original = spec.body(name)
        for element in _elements(original):
            if element.name:
                element.name = _MOVED + "old_" + element.name
        spec.delete(original)
        prefix = f"{_MOVED}{name}_"  # a separate copy, since every copy brings the defaults along
        moved = frame.attach_body(copy.body(name), prefix, "")
        moved.pos = place
        if turn is not None:
            moved.quat = turn
            moved.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        for element in _elements(moved):
            element.name = element.name.removeprefix(prefix)


def move_sites(
    machine: NominalModel,
    spec: mujoco.MjSpec,
    old: mujoco.MjsBody,
    new: mujoco.MjsBody,
    along: Array,
) -> None:
    """Move the sites on the far side of ``new`` from ``old`` to it."""
    here = np.array(new.pos)
    known = {machine.model.site(s).name for s in range(machine.model.nsite)}
    for site in list(old.sites):
        place, turn = np.array(site.pos), np.array(site.quat)
        if site.name in known:  # with frames and angles resolved
            number = machine.model.site(site.name).id
            place, turn = machine.model.site_pos[number], machine.model.site_quat[number]
        if (place - here) @ along >= -_ROUNDING:
            moved = new.add_site()
            _move(spec, site, moved, {"pos": place - here, "quat": turn})
            moved.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def move_geoms(spec: mujoco.MjSpec, old: mujoco.MjsBody, new: mujoco.MjsBody, along: Array) -> None:
    """Move the geoms beyond ``new`` from ``old`` to it; those in frames stay."""
    here = np.array(new.pos)
    for geom in list(old.geoms):
        ends = np.array(geom.fromto).reshape(2, 3)
        spanned = bool(np.isfinite(ends).all())
        place = ends.mean(axis=0) if spanned else np.array(geom.pos)
        if geom.frame is not None or (place - here) @ along < -_ROUNDING:
            continue
        if spanned:
            _move(spec, geom, new.add_geom(), {"fromto": (ends - here).ravel()})
        else:
            _move(spec, geom, new.add_geom(), {"pos": place - here, "quat": geom.quat})


def insert_first(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str) -> None:
    """Move a joint of a body before its others, which MuJoCo's order of creation does not allow.

    The others are copied behind it; references by name are kept.
    """
    for joint in list(body.joints):
        if joint.name != name:
            _move(spec, joint, body.add_joint(), {"pos": np.array(joint.pos)})


def keep_from_touching(spec: mujoco.MjSpec, near: mujoco.MjsBody, far: mujoco.MjsBody) -> None:
    """Exclude contacts that the link could not have before it was cut.

    MuJoCo excludes contacts between a body and its parent, and bodies fixed to either. Once ``far``
    is a child of ``near``, the links beyond it are no longer children of ``near``, and it is no
    longer a child of the parent of ``near``.
    """
    if spec.option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        return
    carrier = near.parent
    while carrier.name != "world" and not list(carrier.joints):
        carrier = carrier.parent
    ends = _fixed_together(far)
    beyond = [b for end in ends for link in end.bodies if list(link.joints)
              for b in _fixed_together(link)]  # fmt: skip
    pairs = [(a, b) for a in _fixed_together(near) for b in beyond]
    if carrier.name != "world":
        pairs += [(a, b) for a in _fixed_together(carrier) for b in ends]
    for several in pairs:
        for number, body in enumerate(several):
            if not body.name:
                body.name = added_name(spec, far.name, f"part_{number}")
        spec.add_exclude(bodyname1=several[0].name, bodyname2=several[1].name)


def _fixed_together(body: mujoco.MjsBody) -> list[mujoco.MjsBody]:
    """Return a body and those that are fixed to it."""
    fixed = [child for child in body.bodies if not list(child.joints)]
    return [body, *(each for child in fixed for each in _fixed_together(child))]


def _move(spec: mujoco.MjSpec, old: Any, new: Any, placed: dict[str, Array]) -> None:
    """Transfer all of ``old`` but its pose to ``new``, name included; delete ``old``."""
    for name in dir(old):
        value = getattr(old, name)
        if name.startswith("_") or name in _NOT_COPIED or callable(value):
            continue
        if name == "alt":
            for part in ("type", "axisangle", "xyaxes", "zaxis", "euler"):
                setattr(new.alt, part, getattr(value, part))
        else:
            setattr(new, name, value)
    for name, value in placed.items():
        setattr(new, name, value)
    name, old.name = old.name, f"{_MOVED}old_{old.name}" if old.name else ""
    spec.delete(old)
    new.name = name


def _elements(body: mujoco.MjsBody) -> Iterator[Any]:
    """List all named elements in a body and in its subtree."""
    yield body
    for several in (body.joints, body.geoms, body.sites, body.cameras, body.lights):
        yield from several
    for child in body.bodies:
        yield from _elements(child)


def _pose(machine: NominalModel, body: mujoco.MjsBody) -> tuple[Array, Array | None]:
    """Pose of a body in its parent; its quaternion too if a frame lies in between."""
    if body.frame is None:
        return np.array(body.pos), None
    model = machine.model
    if body.name not in {model.body(b).name for b in range(model.nbody)}:
        return np.array(body.pos), None
    number = model.body(body.name).id
    place = np.array(model.body_pos[number])
    return place, np.array(model.body_quat[number])
