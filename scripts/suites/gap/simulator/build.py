"""From an arm's figures to the arrays that are integrated, and the factors that make it untrue."""

from __future__ import annotations

import dataclasses

import numpy as np

from loose_env.typing import Array
from scripts.suites.gap.simulator.arms import GRAVITY, Figures
from scripts.suites.gap.simulator.dynamics import BODY
from scripts.suites.gap.simulator.laws import ACTUATOR, DAMPING, GAIN, KP, KV, LAWS, LIMIT
from scripts.suites.gap.simulator.simulate import System

TOLERANCE = 0.03
"""Largest relative error of the nominal masses, inertias, dampings, gains and rotors."""
LEAST_ERROR = 0.01
"""Smallest relative error that a true arm has."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Factors:
    """True over nominal figures; each of shape (n,)."""

    mass: Array
    inertia: Array
    armature: Array
    damping: Array
    kp: Array
    kv: Array

    @classmethod
    def ones(cls, joints: int) -> Factors:
        """An arm that is exactly the nominal one."""
        return cls(**{name: np.ones(joints) for name in FACTORS})

    @classmethod
    def draw(
        cls,
        joints: int,
        rng: np.random.Generator,
        *,
        least: float = LEAST_ERROR,
        most: float = TOLERANCE,
    ) -> Factors:
        """Errors of random sign, by default of 1 to 3 %."""
        return cls(
            **{
                name: 1 + rng.uniform(least, most, joints) * rng.choice([-1, 1], joints)
                for name in FACTORS
            }
        )

    def changed(self, name: str, joint: int, by: float) -> Factors:
        """The same factors with one of them moved by `by`."""
        values = getattr(self, name).copy()
        values[joint] += by
        return dataclasses.replace(self, **{name: values})

    def flat(self) -> Array:
        """All factors, of shape (6 n,), in the order of `FACTORS`."""
        return np.concatenate([getattr(self, name) for name in FACTORS])


FACTORS = tuple(field.name for field in dataclasses.fields(Factors))
"""Names of the factors: the nuisance parameters of every recording."""


def body_row(
    kind: str, axis: object, offset: object, mass: float, com: object, inertia: Array, rotor: float
) -> Array:
    """One row of `System.bodies`; `inertia` is of shape (3, 3) about the centre of mass."""
    row = np.zeros(BODY)
    row[0] = float(kind == "slide")
    row[1:4], row[4:7], row[7], row[8:11] = axis, offset, mass, com  # type: ignore[call-overload]
    row[11:20] = inertia.ravel()
    row[20] = rotor
    return row


def build(figures: Figures, factors: Factors) -> System:
    """The arm without any missing effect."""
    bodies, laws, drives = [], [], []
    for i, link in enumerate(figures.links):
        bodies.append(
            body_row(
                link.kind, link.axis, link.offset, link.mass * factors.mass[i], link.com,
                np.diag(link.inertia) * factors.inertia[i], link.armature * factors.armature[i],
            )
        )  # fmt: skip
        law = np.zeros(LAWS)
        law[DAMPING] = link.damping * factors.damping[i]
        laws.append(law)
        drive = np.zeros(ACTUATOR)
        drive[0] = i
        drive[KP], drive[KV] = link.kp * factors.kp[i], link.kv * factors.kv[i]
        drive[LIMIT], drive[GAIN] = link.limit, 1.0
        drives.append(drive)
    return System(
        bodies=np.array(bodies),
        laws=np.array(laws),
        drives=np.array(drives),
        gravity=np.array([0.0, 0.0, -GRAVITY]),
        tool=np.array(figures.links[-1].end, dtype=float),
        proximal=np.arange(figures.joints),
        distal=np.arange(figures.joints),
    )
