"""Text of a plan's motion: limits and peaks, the way to the pose, repeats and references."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.instrument import (
    FIRST,
    QUANTITIES,
    TRANSIT,
    MotionPeak,
    Plan,
    PlannedRun,
    Signal,
    unit_of,
)

__all__ = ["file_words", "further_steps", "kind_words", "limit_lines", "peak_rows", "transit_words"]

_FILE_ENDINGS = {"csv": ".csv", "parquet": ".parquet", "ros2": ".yaml"}
_KINDS = {
    "torque": "torques of all joints (N·m, N where one slides), to be added to what your "
    "controller gives to hold the arm",
    "position": "positions of all joints (rad, m where one slides), which your controller follows",
    "velocity": "velocities of all joints (rad/s, m/s where one slides), which your controller "
    "follows",
}


def kind_words(signal: Signal) -> str:
    """Kind of a signal's commands in words; "" for those of the model's actuators."""
    return _KINDS.get(signal.kind, "")


def file_words(plan: Plan, stem: str) -> str:
    """Names of a signal's files, the first outside brackets."""
    formats = plan.settings.get("signal_format") or ("csv", "parquet")
    first, *others = (f"{stem}{_FILE_ENDINGS[name]}" for name in formats)
    return f"{first} (or {', '.join(others)})" if others else first


def peak_rows(plan: Plan, signal: Signal) -> list[dict[str, str]]:
    """Peaks of a run beside their limits: of the shaken joint, and of others near a limit."""
    rows = []
    for peak in signal.peaks:
        near = peak.limit is not None and peak.value >= 0.5 * peak.limit
        if peak.joint != signal.joint and not near:
            continue
        rows.append(
            {
                "Quantity": f"{peak.quantity} of the {peak.of}",
                "Joint": peak.joint,
                "Peak": _with_unit(peak.value, peak.unit),
                "Limit": "none" if peak.limit is None else _with_unit(peak.limit, peak.unit),
                "Source": _source(peak),
            }
        )
    return rows


def _source(peak: MotionPeak) -> str:
    return peak.source or "not stated"


def _with_unit(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}"


def limit_lines(plan: Plan) -> list[str]:
    """Limits of the joints with their sources, one line for each quantity."""
    lines = []
    for quantity in QUANTITIES:
        values, sources = plan.limits.values[quantity], plan.limits.sources[quantity]
        if not np.isfinite(values).any():
            lines.append(f"{quantity}: no limit stated")
            continue
        groups: dict[tuple[float, str, bool], list[str]] = {}
        for name, value, source, slides in zip(
            plan.arm.joints, values, sources, plan.arm.nominal.sliding, strict=True
        ):
            groups.setdefault((float(value), source, bool(slides)), []).append(name)
        said = []
        for (value, source, slides), names in groups.items():
            whose = "all joints" if len(names) == len(plan.arm.joints) else ", ".join(names)
            limit = f"{value:.4g} {unit_of(quantity, slides)}" if np.isfinite(value) else "no limit"
            said.append(f"{whose} {limit}" + (f" ({source})" if source else ""))
        lines.append(f"{quantity}: {'; '.join(said)}")
    bandwidth = plan.limits.bandwidth_hz
    if np.isfinite(bandwidth):
        lines.append(f"command bandwidth: {bandwidth:g} Hz (--command-bandwidth-hz)")
    else:
        lines.append("command bandwidth: not stated")
    return lines


def transit_words(plan: Plan) -> str:
    """Sentence about the move to the pose."""
    move = plan.transit
    if move.duration_s == 0:
        return "The arm is there already."
    fastest = max(
        (peak for peak in move.peaks if peak.quantity == "speed" and peak.limit),
        key=lambda peak: peak.value / (peak.limit or 1.0),
    )
    return (
        f"{file_words(plan, TRANSIT)} moves all joints there together in {move.duration_s:.1f} s, "
        f"{fastest.joint} at up to {fastest.value:.2g} {fastest.unit}; it begins at "
        f"{plan.start_origin}."
    )


def further_steps(plan: Plan, planned: Sequence[PlannedRun]) -> list[str]:
    """Steps for repeats of the first run and for references."""
    said = []
    repeats = [one for one in planned if one.kind == "repeat"]
    if repeats:
        names = ", ".join(f"recording/{one.file}" for one in repeats)
        again = "" if repeats[0].pose == plan.next.pose else " Move back to the first pose for it."
        times = "once" if len(repeats) == 1 else f"{len(repeats)} times"
        said.append(
            f"When the session ends, play the first run's signal {file_words(plan, FIRST)} "
            f"{times} more in its pose, as {names}: what differs from the first run is drift and "
            f"scatter of machine and sensors.{again} A repeat that is not there is left out."
        )
    references = [one for one in planned if one.kind == "reference"]
    if references:
        names = ", ".join(f"recording/{one.file}" for one in references)
        said.append(
            f"On the same machine when it is healthy, play the same as {names}: with a reference "
            "faults are found by the difference of two measurements, without the errors of the "
            "model. References count as soon as their files are there."
        )
    return said
