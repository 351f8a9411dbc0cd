"""Correlation loops of a run for the report: tool motion against the excited joint's motion."""

from __future__ import annotations

from typing import Literal

import numpy as np

from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.posterior import ModelComparison
from loose_env.instrument.inference.response.frequency_response import respond
from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm
from loose_env.instrument.result import HEALTHY, Loop
from loose_env.typing import ComplexArray

_ANGLES = np.arange(0.0, 180.0, 5.0)
_PLANES: dict[Literal["xy", "xz", "yz"], tuple[int, int]] = {
    "xy": (0, 1),
    "xz": (0, 2),
    "yz": (1, 2),
}


def loops_of(
    uncertain: UncertainArm, comparison: ModelComparison, lines: Lines
) -> tuple[Loop, ...]:
    """Correlation loops of a run in the tool-frame plane of largest motion.

    The correlation along u is that of u . a with the acceleration of the excited joint, over the
    lines that were excited; the joint's acceleration is that of the model, which its own sensor
    only follows with noise.
    """
    site = [k for k, (r, _) in enumerate(lines.row) if r.kind == "acceleration" and r.at == 0]
    if len(site) != 3:
        return ()
    errors = comparison.fits[HEALTHY].errors
    response = respond(uncertain.at(lines.pose), lines, errors)
    measured, expected = lines.readings[:, site], response.mean[:, site]
    power = np.sum(np.abs(measured) ** 2, axis=0)
    plane = max(_PLANES, key=lambda name: float(power[list(_PLANES[name])].sum()))
    first, second = _PLANES[plane]
    turn = np.radians(_ANGLES)
    u = np.zeros((len(turn), 3))
    u[:, first], u[:, second] = np.cos(turn), np.sin(turn)
    omega2 = (2 * np.pi * lines.frequency) ** 2
    found = []
    for joint in lines.excited:
        x = -omega2 * response.motion[:, joint]
        if not np.abs(x).any():
            continue
        found.append(
            Loop(
                joint=uncertain.arm.joints[joint],
                plane=plane,
                angle_deg=tuple(float(a) for a in _ANGLES),
                correlation=_correlation(x, measured @ u.T),
                expected=_correlation(x, expected @ u.T),
            )
        )
    return tuple(found)


def _correlation(x: ComplexArray, along: ComplexArray) -> tuple[float, ...]:
    both = (x.conj() @ along).real
    size = np.sqrt(np.sum(np.abs(x) ** 2) * np.sum(np.abs(along) ** 2, axis=0))
    values = both / np.maximum(size, 1e-30)
    return tuple(round(float(v), 4) for v in values)
