"""Site of the tool accelerometer, all sensed sites, and the body beyond the last link."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.arms import Chain, ModelFile

_APART = 1e-3
"""Distance from the last link's frame at which a fixed body counts as farther out [m]."""
_MARK = "loose_env_tool"
"""Name of the custom text in which a model says which site is the tool's."""


def mark_tool(spec: mujoco.MjSpec, site: str) -> None:
    """Mark the tool site in a model, as `tool_site` reads it."""
    for text in list(spec.texts):
        if text.name == _MARK:
            spec.delete(text)
    spec.add_text(name=_MARK, data=site)


def tool_site(spec: mujoco.MjSpec) -> str | None:
    """Site of the tool accelerometer; None if no accelerometer has a named site.

    It is the one that `mark_tool` marked, else the one with most joints between it and the base;
    of several of these the first sensor's.

    Examples
    --------
    >>> body = '<body><joint/><geom size=".1"/><site name="a"/><site name="b"/></body>'
    >>> sensors = '<accelerometer site="b"/><accelerometer site="a"/>'
    >>> worldbody = f"<worldbody>{body}</worldbody><sensor>{sensors}</sensor>"
    >>> spec = mujoco.MjSpec.from_string(f"<mujoco>{worldbody}</mujoco>")
    >>> tool_site(spec)
    'b'
    >>> mark_tool(spec, "a")
    >>> tool_site(spec)
    'a'
    """
    sites = sensed_sites(spec)
    marked = next((text.data for text in spec.texts if text.name == _MARK), None)
    if marked in sites:
        return str(marked)
    return max(sites, key=lambda name: _depth(spec, name), default=None)


def sensed_sites(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Sites with an accelerometer, unique, in sensor order."""
    kind = mujoco.mjtSensor.mjSENS_ACCELEROMETER
    there = {site.name for site in spec.sites}
    names = (s.objname for s in spec.sensors if s.type == kind)
    return tuple(dict.fromkeys(str(name) for name in names if name and name in there))


def _depth(spec: mujoco.MjSpec, site: str) -> int:
    """Number of joints between a site and the base."""
    depth, body = 0, spec.site(site).parent
    while body.name != "world":
        depth += len(body.joints)
        body = body.parent
    return depth


def body_beyond(file: ModelFile, chain: Chain) -> str | None:
    """Outermost body fixed to the last link, such as a URDF flange."""
    m, last = file.model, chain.links[-1]
    if chain.tool_site is not None or chain.tool_body != last:
        return None
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    fixed = [b for b in range(last + 1, m.nbody) if m.body_weldid[b] == last]
    away = [float(np.linalg.norm(data.xpos[b] - data.xpos[last])) for b in fixed]
    if not fixed or max(away) < _APART:
        return None
    # Of equals the one that comes last: tool0 rather than the flange it lies on.
    far = max(range(len(fixed)), key=lambda k: (round(away[k], 6), k))
    return str(m.body(fixed[far]).name)
