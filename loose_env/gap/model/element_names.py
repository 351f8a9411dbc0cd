"""Names given to unnamed bodies, sites and actuators of a spec, with notes on unnamed links."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco

_LISTED = 6
"""Names that a sentence lists."""


def with_names(given: mujoco.MjSpec) -> mujoco.MjSpec:
    """Copy a spec so that every body, site and actuator has a name.

    A link, the body that a joint moves, is named after its first joint; others by their index.

    Examples
    --------
    >>> spec = mujoco.MjSpec.from_string('''<mujoco><worldbody><body><joint name="elbow"/>
    ... <geom size=".1"/><site/></body></worldbody></mujoco>''')
    >>> named = with_names(spec)
    >>> [body.name for body in named.bodies], [site.name for site in named.sites]
    (['world', 'elbow_link'], ['site_0'])
    """
    spec = given.copy()
    _name(spec.bodies[1:], "body", spec.bodies)
    _name(spec.sites, "site", spec.sites)
    _name(spec.actuators, "actuator", spec.actuators)
    return spec


def naming_notes(given: mujoco.MjSpec) -> list[str]:
    """Describe links of a model without a name of their own; none if all have one."""
    before, after = given.bodies[1:], with_names(given).bodies[1:]
    links = [new.name for old, new in zip(before, after, strict=True) if not old.name if new.joints]
    if not links:
        return []
    shown = ", ".join(links[:_LISTED]) + (" and others" if len(links) > _LISTED else "")
    return [
        f"links of the model without a name are called after their joint, {shown}, here and in "
        "model.xml; give their bodies names to see your own"
    ]


def _name(elements: Iterable[Any], noun: str, every: Iterable[Any]) -> None:
    taken = {element.name for element in every}
    for number, element in enumerate(elements):
        if element.name:
            continue
        joint = element.joints[0].name if noun == "body" and element.joints else ""
        wanted = f"{joint}_link" if joint else f"{noun}_{number}"
        name, again = wanted, 2
        while name in taken:
            name, again = f"{wanted}_{again}", again + 1
        element.name = name
        taken.add(name)
