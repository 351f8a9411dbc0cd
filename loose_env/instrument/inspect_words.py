"""An inspection as one screen of text."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap

import numpy as np

from loose_env.instrument.findable import Findable
from loose_env.instrument.inspect import Inspection, JointSeen

__all__ = ["screen"]

_WIDTH = 100


def screen(found: Inspection) -> str:
    """Write an inspection for a terminal."""
    machine = found.machine
    report = machine.report
    lines = [f"{report.file} ({report.format}): {len(found.joints)} joints", ""]
    rows: list[tuple[str, ...]] = [("joint", "moves", "mass", "range", "torque", "driven by")]
    rows += [
        (
            joint.name,
            joint.link,
            f"{mass:.3g} kg",
            _range(joint),
            f"{joint.torque_limit:.3g} {_torque(joint)}",
            joint.drive,
        )
        for joint, mass in zip(found.joints, report.link_masses, strict=True)
    ]
    lines += _table(rows)
    lines += ["", f"accelerometer: at {report.tool}, {report.tool_origin}"]
    lines += [
        f"payload: {branch.body} on {branch.link}, {branch.mass:.3g} kg"
        for branch in report.payload
    ]
    lines.append(f"held by: {machine.held_by}")
    pose = ", ".join(
        f"{value * 1e3:.0f} mm" if joint.kind == "slide" else f"{np.degrees(value):.0f}°"
        for joint, value in zip(found.joints, found.pose.values(), strict=True)
    )
    lines.append(f"in the pose {pose}:")
    lines.append(f"  modes of the held arm: {_hertz(found.modes_hz)}")
    lines.append(f"  band to shake in: {found.band_hz[0]:g} to {found.band_hz[1]:g} Hz")
    lines.append("")
    rows = [("shake", "tool, rms", "joint, rms", "torque, rms")]
    for joint in found.joints:
        if joint.torque_rms <= 0:
            rows.append((joint.name, "does not move the tool here", "", ""))
            continue
        turn = "m/s²" if joint.kind == "slide" else "rad/s²"
        rows.append(
            (
                joint.name,
                f"{joint.level_tool:.3g} m/s²",
                f"{joint.level_joint:.3g} {turn}",
                f"{joint.torque_rms:.3g} {_torque(joint)}",
            )
        )
    lines += _table(rows)
    gap = found.settings.get("gap_mm", 0.1)
    lines += [
        "",
        f"faults, in {found.poses} poses, records of {found.seconds:g} s, a gap of {gap:g} mm:",
    ]
    rows = [("fault", "found?", "smallest gap", "with a healthy record", "best shaken by")]
    rows += [
        (
            fault.hypothesis,
            fault.verdict if fault.verdict != "mostly" else f"mostly ({fault.directions:.0%})",
            _gap(found, fault, fault.smallest_gap_model),
            _gap(found, fault, fault.smallest_gap),
            fault.best_joint if fault.verdict != "no" else "",
        )
        for fault in found.faults
    ]
    lines += _table(rows)
    lines += [f"  {fault.hypothesis}: {fault.why}" for fault in found.faults if fault.why]
    lines += [
        f"  {fault.hypothesis} shows the same direction in every pose as {', '.join(fault.alike)}"
        for fault in found.faults
        if fault.alike
    ]
    needed = found.seconds_needed
    if np.isfinite(needed):
        length = "under 0.2" if needed < 0.2 else f"{needed:.2g}"
        lines.append(
            f"record length: after {length} s noise leaves 3° of a direction (accelerometer "
            f"{found.noise_rms * 1e3:.2g} mm/s² rms in the band); longer records do not help "
            "against errors of the model"
        )
    else:
        lines.append("record length: no fault shows at this noise, gap and level, however long")
    for warning in found.warnings:
        lines += wrap(f"note: {warning}", _WIDTH, subsequent_indent="      ")
    return "\n".join(lines)


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  " + "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _range(joint: JointSeen) -> str:
    if joint.range is None:
        return "no limits"
    low, high = joint.range
    if joint.kind == "slide":
        return f"{low * 1e3:.0f} to {high * 1e3:.0f} mm"
    return f"{np.degrees(low):.0f} to {np.degrees(high):.0f}°"


def _torque(joint: JointSeen) -> str:
    return "N" if joint.kind == "slide" else "N·m"


def _hertz(modes: Sequence[float]) -> str:
    shown = [f"{f:.0f}" if f >= 10 else f"{f:.1f}" for f in modes[:8]]
    more = f" and {len(modes) - 8} more" if len(modes) > 8 else ""
    return ", ".join(shown) + f" Hz{more}" if shown else "none"


def _gap(found: Inspection, fault: Findable, gap: float | None) -> str:
    if gap is None:
        return "none shows"
    kind, _, where = fault.hypothesis.partition("@")
    joint = next((j for j in found.joints if j.name == where), None)
    if kind == "backlash" and joint is not None and joint.kind == "hinge":
        return f"{np.degrees(gap) * 60:.2g} arcmin"
    return f"{gap * 1e3:.2g} mm"
