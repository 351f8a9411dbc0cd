"""Specs as plain data: MuJoCo's specs cannot be pickled, and its XML rounds to six digits.

So a packed spec is its XML, which has the structure, and beside it every number of every element,
which has the digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

__all__ = ["PackedSpec"]

_KINDS = (
    *("bodies", "joints", "sites", "geoms", "cameras", "lights", "meshes", "materials"),
    *("actuators", "sensors", "equalities", "tendons", "excludes", "pairs"),
)
_SETTINGS = ("option", "compiler", "stat")
_OWN = ("id", "classname", "signature")
"""Attributes that belong to the object, not to what it describes."""


@dataclass(frozen=True, kw_only=True)
class PackedSpec:
    """A spec as text and numbers.

    Examples
    --------
    >>> spec = mujoco.MjSpec()
    >>> body = spec.worldbody.add_body(name="rod", mass=1 / 3, inertia=[0.1, 0.2, 0.2])
    >>> body.explicitinertial = True
    >>> PackedSpec.of(spec).unpack().body("rod").mass
    0.3333333333333333
    """

    xml: str
    """Its XML."""
    numbers: dict[tuple[str, int, str], Any]
    """Numbers by kind of element, index and attribute."""

    @classmethod
    def of(cls, spec: mujoco.MjSpec) -> PackedSpec:
        """Pack a spec, which stays as it is."""
        written = spec.copy()
        written.compile()
        return cls(xml=written.to_xml(), numbers=dict(_numbers(spec)))

    def unpack(self) -> mujoco.MjSpec:
        """Build the spec."""
        spec = mujoco.MjSpec.from_string(self.xml)
        elements = dict(_elements(spec))
        for (kind, index, name), value in self.numbers.items():
            element = elements[kind, index]
            now = getattr(element, name)
            if isinstance(now, np.ndarray):
                now[:] = value
            elif now != value:
                setattr(element, name, value)
        return spec


def _elements(spec: mujoco.MjSpec) -> Iterator[tuple[tuple[str, int], Any]]:
    """Elements and settings of a spec, in order."""
    for kind in _KINDS:
        for index, element in enumerate(getattr(spec, kind)):
            yield (kind, index), element
    for kind in _SETTINGS:
        yield (kind, 0), getattr(spec, kind)


def _numbers(spec: mujoco.MjSpec) -> Iterator[tuple[tuple[str, int, str], Any]]:
    """Every number of a spec."""
    for (kind, index), element in _elements(spec):
        for name in dir(element):
            if name.startswith("_") or name in _OWN:
                continue
            value = getattr(element, name)
            if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
                yield (kind, index, name), np.array(value)
            elif isinstance(value, (int, float)):
                yield (kind, index, name), value
