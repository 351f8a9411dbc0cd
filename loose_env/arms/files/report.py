"""Report of an arm's file, as a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from loose_env.arms.files.model_reader import ModelFile
from loose_env.arms.files.serial_chain import Chain

__all__ = ["FileReport", "FoundJoint", "Payload", "report"]


@dataclass(frozen=True, kw_only=True)
class FoundJoint:
    """A driven joint of a file."""

    name: str
    kind: Literal["hinge", "slide"]
    range: tuple[float, float] | None
    """Allowed positions [rad or m]; None where it has no limits."""
    torque_limit: float | None
    """Peak drive torque [N·m, or N where it slides]; None where the file says nothing."""


@dataclass(frozen=True, kw_only=True)
class Payload:
    """A branch that rides on a link, its joints frozen."""

    body: str
    link: str
    joints: tuple[str, ...]
    mass: float
    """Mass of the branch [kg]."""


@dataclass(frozen=True, kw_only=True)
class FileReport:
    """Joints, links, tool and payload of a file. Its text is a table."""

    file: str
    format: Literal["MJCF", "URDF"]
    joints: tuple[FoundJoint, ...]
    """Driven joints, base first."""
    links: tuple[str, ...]
    """Body that each joint moves."""
    link_masses: tuple[float, ...]
    """Mass of each link with all that rides on it [kg]."""
    tool: str
    """Site of the tool, or the body whose frame it is."""
    tool_origin: str
    """Origin of the tool, in words."""
    payload: tuple[Payload, ...]
    gravity: tuple[float, float, float]
    """Gravity [m/s²]."""
    warnings: tuple[str, ...]
    """Elements left out, and assumptions."""
    springs: tuple[str, ...] = ()
    """Elastic joints, which bend and have no drive, base first."""
    spring_modes: tuple[float, ...] = ()
    """Mode of each with all it carries, everything else held, where the file has it [Hz]."""

    def __str__(self) -> str:
        rows = [("", "joint", "kind", "range", "peak torque", "link", "mass")]
        for number, (joint, link, mass) in enumerate(
            zip(self.joints, self.links, self.link_masses, strict=True), start=1
        ):
            hinge = joint.kind == "hinge"
            low, high = joint.range or (0.0, 0.0)
            span = f"{low:.3g} to {high:.3g} {'rad' if hinge else 'm'}"
            unit = "N·m" if hinge else "N"
            limit = joint.torque_limit
            rows.append(
                (
                    str(number),
                    joint.name,
                    joint.kind,
                    "no limits" if joint.range is None else span,
                    "not given" if limit is None else f"{limit:.3g} {unit}",
                    link,
                    f"{mass:.3g} kg",
                )
            )
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        lines = [f"{self.file} ({self.format}): {len(self.joints)} joints"]
        lines += [
            "  ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)).rstrip() for r in rows
        ]
        lines.append(f"tool: {self.tool}, {self.tool_origin}")
        for spring, mode in zip(self.springs, self.spring_modes, strict=True):
            lines.append(f"elastic: {spring}, {mode:.3g} Hz with all it carries")
        for branch in self.payload:
            frozen = f", frozen: {', '.join(branch.joints)}" if branch.joints else ""
            lines.append(f"payload: {branch.body} on {branch.link}, {branch.mass:.3g} kg{frozen}")
        lines += [f"note: {warning}" for warning in self.warnings]
        return "\n".join(lines)


def report(file: ModelFile, chain: Chain) -> FileReport:
    """Report the chain of a file."""
    m = file.model
    found = tuple(
        FoundJoint(
            name=m.joint(j).name,
            kind="slide" if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE else "hinge",
            range=(float(m.jnt_range[j][0]), float(m.jnt_range[j][1]))
            if m.jnt_limited[j]
            else None,
            torque_limit=_torque_limit(file, j),
        )
        for j in chain.joints
    )
    owner = np.array(chain.owner)
    masses = tuple(float(m.body_mass[owner == k].sum()) for k in range(1, len(found) + 1))
    body = m.body(chain.tool_body).name
    off = m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    gravity = np.zeros(3) if off else m.opt.gravity
    return FileReport(
        file=file.path.name,
        format=file.format,
        joints=found,
        links=tuple(m.body(b).name for b in chain.links),
        link_masses=masses,
        tool=body if chain.tool_site is None else m.site(chain.tool_site).name,
        tool_origin=chain.tool_origin,
        payload=_payload(m, chain),
        gravity=(float(gravity[0]), float(gravity[1]), float(gravity[2])),
        warnings=(*file.warnings, *chain.warnings, *_left_out(m, chain)),
        springs=tuple(m.joint(j).name for j in chain.springs),
        spring_modes=_modes(m, chain.springs),
    )


def _modes(m: mujoco.MjModel, springs: tuple[int, ...]) -> tuple[float, ...]:
    """Mode of each spring with all that it carries [Hz]."""
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    inertia = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, data, inertia)
    dofs = [int(m.jnt_dofadr[j]) for j in springs]
    return tuple(
        float(np.sqrt(m.jnt_stiffness[j] / inertia[d, d]) / (2 * np.pi))
        for j, d in zip(springs, dofs, strict=True)
    )


def _payload(m: mujoco.MjModel, chain: Chain) -> tuple[Payload, ...]:
    """Branches that begin at a frozen joint of a link."""
    branches = []
    bending = {int(m.jnt_bodyid[j]) for j in chain.springs}
    for body in range(1, m.nbody):
        parent = int(m.body_parentid[body])
        own = chain.owner[body]
        if own == 0 or body in (*chain.links, *bending) or not m.body_jntnum[body]:
            continue
        carriers = [m.body_weldid[b] for b in (chain.links[own - 1], *bending)]
        if m.body_weldid[parent] not in carriers:
            continue  # further out on a branch
        inside = [b for b in range(body, m.nbody) if _under(m, b, body)]
        branches.append(
            Payload(
                body=m.body(body).name,
                link=m.body(chain.links[own - 1]).name,
                joints=tuple(
                    m.joint(j).name for j in range(m.njnt) if int(m.jnt_bodyid[j]) in inside
                ),
                mass=float(m.body_mass[inside].sum()),
            )
        )
    return tuple(branches)


def _under(m: mujoco.MjModel, body: int, root: int) -> bool:
    while body > root:
        body = int(m.body_parentid[body])
    return body == root


def _left_out(m: mujoco.MjModel, chain: Chain) -> list[str]:
    notes = []
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    place = (
        data.xpos[chain.tool_body] if chain.tool_site is None else data.site_xpos[chain.tool_site]
    )
    for j in chain.joints:
        dof = int(m.jnt_dofadr[j])
        name, axis = m.joint(j).name, data.xaxis[j]
        if m.dof_frictionloss[dof] > 0:
            notes.append(
                f"dry friction of {m.dof_frictionloss[dof]:.3g} in joint {name} is left out"
            )
        if np.any(m.jnt_stiffnesspoly[j]) or np.any(m.dof_dampingpoly[dof]):
            notes.append(f"joint {name}: spring and damper are kept to first order")
        if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE:
            lever = float(np.linalg.norm(np.cross(axis, place - data.xanchor[j])))
            if lever < 1e-3 and j == chain.joints[-1]:
                notes.append(
                    f"the tool lies on the axis of joint {name} and does not feel it turn; a "
                    "site beside the axis would"
                )
    if m.body_gravcomp[list(chain.links)].any():
        notes.append("gravity compensation is left out: the drives hold the arm")
    return notes


def _torque_limit(file: ModelFile, j: int) -> float | None:
    """The tighter of what the joint and its actuators allow; None where neither says."""
    m = file.model
    drives = [d for d in file.drives if d.joint == m.joint(j).name]
    found = []
    if m.jnt_actfrclimited[j]:
        found.append(float(np.abs(m.jnt_actfrcrange[j]).max()))
    if drives and all(d.limit is not None for d in drives):
        found.append(sum(d.limit for d in drives if d.limit is not None))
    found = [x for x in found if np.isfinite(x) and x > 0]
    return min(found, default=None)
