"""Elements of the observation: names, units, scaling and bounds, in their order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from loose_env.arms import Arm, held_inertia
from loose_env.diagnosis import link_axes
from loose_env.envs.episode.actions import JointPose
from loose_env.envs.settings import DiagnosisSettings

__all__ = ["Element", "global_elements", "slot_elements"]

Scaling = Literal["linear", "log10", "asinh"]
_AXES = "xyz"


@dataclass(frozen=True, kw_only=True)
class Element:
    """One number of the observation."""

    name: str
    """Name; elements of record k start with ``record<k>.``."""
    unit: str
    """Unit before scaling; 1 for a pure number."""
    scaling: Scaling
    """Linear: value / scale. log10: log10(value / scale). asinh: asinh(value / scale)."""
    scale: float
    """Scale, in the element's unit."""
    low: float
    """Lower bound after scaling; smaller values are clipped to it."""
    high: float
    """Upper bound after scaling."""


def global_elements(arm: Arm, settings: DiagnosisSettings) -> Iterator[Element]:
    """Elements of the pose and of what has been spent."""

    def linear(name: str, unit: str, scale: float, low: float, high: float) -> Element:
        return Element(name=name, unit=unit, scaling="linear", scale=scale, low=low, high=high)

    for name, unit in JointPose(arm).elements:
        yield linear(f"now.{name}", unit, 1.0, -1.0, 1.0)
    yield linear("spent.records", "1", 1.0, 0.0, 1.0)
    longest = settings.max_records * max(settings.durations)
    yield linear("spent.seconds", "s", longest, 0.0, 1.0)
    most = settings.max_records * arm.n * len(arm.levels)
    yield linear("spent.levels", "1", float(most), 0.0, 1.0)
    yield linear("left.records", "1", 1.0, 0.0, 1.0)


def slot_elements(arm: Arm, settings: DiagnosisSettings) -> Iterator[Element]:
    """Elements of one record; those of accelerometers on links come last, where there are any."""
    axes = [_AXES[a] for a in arm.axes]
    pairs = [(a, b) for i, a in enumerate(axes) for b in axes[i + 1 :]]
    products = [(a, b) for i, a in enumerate(axes) for b in axes[i:]]
    joints = list(zip(arm.joints, arm.sliding, strict=True))
    top = arm.levels[-1]

    def linear(name: str, unit: str, scale: float, low: float, high: float) -> Element:
        return Element(name=name, unit=unit, scaling="linear", scale=scale, low=low, high=high)

    def asinh(name: str, unit: str, scale: float) -> Element:
        return Element(name=name, unit=unit, scaling="asinh", scale=scale, low=-6.0, high=6.0)

    def log(name: str, unit: str, scale: float) -> Element:
        return Element(name=name, unit=unit, scaling="log10", scale=scale, low=-4.0, high=4.0)

    inertias = held_inertia(arm.spec, arm.joints)

    def second_order(prefix: str) -> Iterator[Element]:
        for kind in ("transmission", "transmission_by_instrument"):
            for joint, slides in joints:
                unit, scale = ("1", 0.25) if slides else ("m", 0.25 * arm.reach)
                for axis in axes:
                    yield asinh(f"{prefix}{kind}.{joint}_{axis}", unit, scale)
        for joint, slides in joints:
            unit, scale = ("m/s²", top) if slides else ("rad/s²", top / arm.reach)
            yield log(f"{prefix}joint_rms.{joint}", unit, scale)

    def inertia(prefix: str) -> Iterator[Element]:
        for (joint, slides), carried in zip(joints, inertias, strict=True):
            # A bending mode can make the apparent inertia negative (joint 1 of VERA).
            # Bounds of 200 scales hold twice what the joint carries, on heavy arms too.
            unit, least = ("kg", 1.0) if slides else ("kg·m²", 0.1)
            yield asinh(f"{prefix}inertia.{joint}", unit, max(least, round(carried / 100, 3)))

    def tool(prefix: str) -> Iterator[Element]:
        for axis in axes:
            yield log(f"{prefix}tool_rms.{axis}", "m/s²", top)
        for a, b in pairs:
            yield linear(f"{prefix}tool_correlation.{a}{b}", "1", 1.0, -1.0, 1.0)
        for a, b in products:
            yield linear(f"{prefix}lowest_direction.{a}{b}", "1", 1.0, -1.0, 1.0)
        yield linear(f"{prefix}coherence.lowest", "1", 1.0, 0.0, 1.0)
        yield linear(f"{prefix}correlation.maximum", "1", 1.0, 0.0, 1.0)

    yield linear("valid", "1", 1.0, 0.0, 1.0)
    for name, unit in JointPose(arm).elements:
        yield linear(name, unit, 1.0, -1.0, 1.0)
    for joint in arm.joints:
        yield linear(f"level.{joint}", "1", float(len(arm.levels)), 0.0, 1.0)
    for joint in arm.joints:
        yield linear(f"torque.{joint}", "of limit", 1.0, 0.0, 1.0)
    for joint in arm.joints:
        yield linear(f"level_share.{joint}", "1", 1.0, 0.0, 1.0)
    yield linear("duration", "s", max(settings.durations), 0.0, 1.0)
    yield from second_order("")
    yield from inertia("")
    yield from tool("")
    for axis in axes:
        yield asinh(f"skewness.{axis}", "1", 1.0)
    for axis in axes:
        yield asinh(f"kurtosis.{axis}", "1", 1.0)
    yield asinh("lowest_skewness", "1", 1.0)
    yield asinh("lowest_kurtosis", "1", 1.0)
    yield from second_order("nominal_")
    yield from inertia("nominal_")
    yield from tool("nominal_")
    choice = settings.sensors.on_links
    if choice is None:
        return
    measured = [(link, axis) for link in choice.on(arm) for axis in link_axes(arm, choice)]
    for prefix in ("", "nominal_"):
        for link, axis in measured:
            for joint, slides in joints:
                unit, scale = ("1", 0.25) if slides else ("m", 0.25 * arm.reach)
                group = f"{prefix}link_transmission_by_instrument"
                yield asinh(f"{group}.link{link}_{axis}_{joint}", unit, scale)
    for link, axis in measured:
        yield log(f"link_rms.link{link}_{axis}", "m/s²", top)
