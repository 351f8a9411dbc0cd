"""Elastic gears between the motors and the links of an arm: their figures, and their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.typing import Array

__all__ = ["GEAR_DAMPING", "GEAR_MODE_HZ", "Figures", "Gears", "each_joint"]

Figures = float | Sequence[float]


GEAR_MODE_HZ = 60.0
"""Mode of each gear with all that it carries, where no stiffness is known [Hz]: the upper part
of the 10 to 80 Hz at which industrial arms sway on their drives, as small arms do."""


GEAR_DAMPING = 0.05
"""Damping ratio of that mode [1]; an estimate between steel (0.01) and a lubricated gear (0.1)."""


@dataclass(frozen=True, kw_only=True)
class Gears:
    """Elastic gears of an arm: stiffness, or the mode that it gives, and damping.

    Drives of industrial arms have 1e4 to 1e6 N·m/rad, those of small wrists less.
    """

    stiffness: tuple[float, ...] | None = None
    """Stiffness of each joint's gear, at the joint [N·m/rad, or N/m where it slides]."""
    mode_hz: float | tuple[float, ...] = GEAR_MODE_HZ
    """Mode of each gear, motor braked, all other gears stiff, the arm where it is heaviest for the
    joint [Hz]. Not looked at where a stiffness is given."""
    damping_ratio: float | tuple[float, ...] = GEAR_DAMPING
    """Damping ratio of that mode [1]."""

    def __post_init__(self) -> None:
        for name in ("stiffness", "mode_hz", "damping_ratio"):
            value = getattr(self, name)
            if value is None:
                continue
            figures = np.atleast_1d(_numbers(value))
            low = figures < 0 if name == "damping_ratio" else figures <= 0
            if figures.ndim != 1 or not np.isfinite(figures).all() or low.any():
                raise InvalidSetting(
                    f"{name} of the gears must be finite and positive, one number or one for each "
                    f"joint; got {value!r}"
                )

    def figures(self, carried: Array) -> tuple[Array, Array]:
        """Stiffness and damping of each gear that carries an inertia [kg·m², or kg] (n,).

        Raises
        ------
        InvalidSetting
            If there are not as many figures as joints.
        """
        n = len(carried)
        ratio = each_joint("damping_ratio", self.damping_ratio, n)
        if self.stiffness is None:
            stiffness = carried * (2 * np.pi * each_joint("mode_hz", self.mode_hz, n)) ** 2
        else:
            stiffness = each_joint("stiffness", self.stiffness, n)
        return stiffness, 2 * ratio * np.sqrt(stiffness * carried)


def each_joint(name: str, value: Figures, n: int) -> Array:
    """Check figures of the joints, one for all or one for each, and return (n,) of them."""
    figures = _numbers(value)
    wrong = figures < 0 if name == "damping_ratio" else figures <= 0
    if figures.shape not in ((), (n,)) or not np.isfinite(figures).all() or wrong.any():
        raise InvalidSetting(
            f"{name} is one positive number, or one for each of {n} joints; got {value!r}"
        )
    return np.broadcast_to(figures, n).astype(float)


def _numbers(value: object) -> Array:
    """What was given as floats; NaN, which no check lets pass, where it is no number."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return np.array(np.nan)
