"""Seat directions with 95 % cones, in the link frame and in the tool frame."""

from __future__ import annotations

import numpy as np

from loose_env.diagnosis import ToolFrames
from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.laplace_fit import Fit
from loose_env.instrument.inference.posterior import ModelComparison
from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm
from loose_env.instrument.result import HEALTHY, Vector
from loose_env.instrument.settings.thresholds import (
    CONE_95,
    DIRECTION_SD_DEG,
    DIRECTION_SD_FACTOR,
    WIDEST_CONE_DEG,
)
from loose_env.typing import Array


def cone(fit: Fit) -> tuple[Vector | None, float | None]:
    """Seat direction in the link frame, and half-angle of its 95 % cone [degrees]."""
    if fit.axis is None or fit.covariance is None:
        return None, None
    half = _half(fit.covariance)
    if half > np.radians(WIDEST_CONE_DEG):
        return None, None
    return _vector(_signed(fit.axis)), float(np.degrees(half))


def seen_in_tool(
    uncertain: UncertainArm, comparison: ModelComparison, lines: Lines
) -> tuple[Vector | None, float | None]:
    """Tool-frame direction of the most likely fault in a run, with cone [degrees]."""
    loose = {name: p for name, p in comparison.posterior.items() if name != HEALTHY}
    best = max(loose, key=lambda name: loose[name])
    if comparison.posterior[HEALTHY] > 0.5:
        return None, None
    fit, nominal = comparison.fits[best], uncertain.arm.nominal
    frames, where = ToolFrames(nominal), uncertain.arm.hypotheses.index(best) - 1
    pose = lines.pose[None]
    if where >= nominal.n:
        line = np.zeros(3)
        line[list(nominal.axes)] = frames.unit_lines(pose)[0, where - nominal.n]
        return (_vector(_signed(line)), 3.0) if np.linalg.norm(line) > 0.5 else (None, None)
    direction, angle = cone(fit)
    if direction is None:
        return None, None
    image = frames.images(pose)[0, where] @ np.array(direction)
    return _vector(_signed(image / np.linalg.norm(image))), angle


def _half(covariance: Array) -> float:
    widest = float(np.linalg.eigvalsh(covariance)[-1])
    return float(
        CONE_95
        * np.hypot(DIRECTION_SD_FACTOR * np.sqrt(max(widest, 0.0)), np.radians(DIRECTION_SD_DEG))
    )


def _signed(axis: Array) -> Array:
    """Axis sign convention: the largest component is positive."""
    return np.asarray(axis if axis[int(np.argmax(np.abs(axis)))] > 0 else -axis)


def _vector(values: Array) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z
