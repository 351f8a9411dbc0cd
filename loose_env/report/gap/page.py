"""The page of a comparison of model and measurement: words first, then figures and tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.gap import (
    Dependence,
    GapResult,
    GapSolution,
    JointMotion,
    ResidualDiagnostics,
    main_band,
    strongest,
)
from loose_env.io import duration_words, sentence
from loose_env.report.gap.effects import deletion_words, doubtful_words, effect_words
from loose_env.report.gap.figures import (
    channel_bars,
    horizon_curves,
    residual_panels,
)
from loose_env.report.gap.overlay import overlay_group
from loose_env.report.gap.parameters import parameters_group
from loose_env.report.gap.spectra import by_channel, spectra_group
from loose_env.report.gap.text import (
    headline,
    mistaken_words,
    next_steps,
    ranked_words,
    shown_group,
    size_words,
    summary_words,
)
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.sections import graded, group, signed, spread
from loose_env.report.pages.template import template, write_whole

__all__ = ["render_gap_page", "write_gap_page"]


_PANELS = ("position", "velocity", "load")
_UNITS = {
    "N·m": {"position": "rad", "velocity": "rad/s", "load": "N·m"},
    "N": {"position": "m", "velocity": "m/s", "load": "N"},
}
"""Unit of each regressor, by that of what drives the joint."""
_RANKED = 12
"""Lines of the ranking."""
_BARS = 24
"""Channels whose gap is drawn."""


def write_gap_page(
    path: Path, solution: GapSolution, evidence: ResidualDiagnostics, result: GapResult
) -> Path:
    """Write the page, beside its final name first.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    return write_whole(path, render_gap_page(solution, evidence, result))


def render_gap_page(solution: GapSolution, evidence: ResidualDiagnostics, result: GapResult) -> str:
    """Return the page that `write_gap_page` writes."""
    first = [
        _next_group(result),
        parameters_group(result),
        overlay_group(solution),
    ]
    groups = [
        _residual_group(evidence, result),
        spectra_group(solution, evidence, result),
        _motion_group(solution, evidence),
        _location_group(evidence),
        _ranking_group(result),
        _remaining_group(result),
        shown_group(result.identifiability),
    ]
    page: str = template("loose_env.report/gap_page.html").render(
        title=headline(result),
        kicker=" · ".join(filter(None, [solution.problem.recording, "model error"])),
        summary=summary_words(result),
        first=[group for group in first if group],
        questions=_questions(result),
        warnings=graded([(s, sentence(w)) for s, w in result.graded_warnings]),
        groups=[group for group in groups if group],
        notes=_notes(result),
    )
    return page


def _questions(result: GapResult) -> list[tuple[str, list[str]]]:
    """Findings, each under its heading."""
    found = []
    if result.effects:
        named = [
            ", ".join(
                filter(
                    None,
                    (
                        f"{effect_words(e.kind, e.where)}: {e.kind} at {e.where}",
                        deletion_words(e),
                    ),
                )
            )
            for e in result.effects
        ]
        found.append(("Missing effects", named))
    if result.doubtful:
        found.append(("Reduce the error, not identified", doubtful_words(result)))
    if result.location_words and result.verdict != "no_gap":
        found.append(("Location of the residual", list(result.location_words)))
    found.append(("Size of the model error", size_words(result)))
    if result.remaining and result.verdict == "named":
        found.append(("Remaining residual", list(result.remaining)))
    if result.effects:
        found.append(("Confusable effects", mistaken_words(result)))
    return found


def _residual_group(evidence: ResidualDiagnostics, result: GapResult) -> dict[str, Any]:
    """Residual by channel and by horizon, side by side."""
    pairs = sorted(result.gap.by_channel.items(), key=lambda item: -item[1][0])
    dropped = len(pairs) - _BARS
    cards = [
        FigureCard(
            title="Channel by channel",
            image=channel_bars(dict(pairs[:_BARS])),
            caption="Residual of each channel over its noise floor, before and after, on a "
            "logarithmic scale; the dashed line is the noise floor."
            + (f" The {_BARS} largest of {len(pairs)} channels." if dropped > 0 else ""),
        )
    ]
    if evidence.before:
        cards.append(
            FigureCard(
                title="Prediction error by horizon",
                image=horizon_curves(
                    [e.horizon for e in evidence.before],
                    [e.rms for e in evidence.before],
                    [e.rms for e in evidence.after],
                ),
                caption="The simulation was restarted from the measured state "
                f"{evidence.before[0].starts} times and run open loop: root mean square error of "
                "all channels over their noise floors.",
            )
        )
    return group(
        "Residual before and after correction",
        "On the held-out runs: the nominal model, fitted within its tolerance, and the corrected "
        "one. 1 is sensor noise alone.",
        cards=cards if pairs else [],
    )


def _motion_group(solution: GapSolution, evidence: ResidualDiagnostics) -> dict[str, Any]:
    """Residual against position, velocity and load, as torque where the motion allows it."""
    cards = []
    for joint, number in _joints_to_show(solution, evidence):
        motions = evidence.held_out_motions
        card = _torque_card(motions, joint, number)
        if card is not None:
            cards.append(card)
    reading = _reading_card(solution, evidence)
    if reading is not None:
        cards.append(reading)
    return group(
        "Residual against motion and load",
        "What an effect looks like: friction steps where the motion turns round, a spring goes by "
        "position, a wrong mass by load. Dots are samples of the held-out runs, lines are means.",
        cards=cards,
    )


def _joints_to_show(solution: GapSolution, evidence: ResidualDiagnostics) -> list[tuple[str, int]]:
    """Joints of the named effects, or the one with the largest torque unexplained."""
    joints = solution.problem.machine.joints
    named = [e.where for e in solution.effects if e.where in joints]
    if not named:
        gaps = [g for g in evidence.location.joints if np.isfinite(g.residual / g.noise)]
        worst = max(gaps, key=lambda g: g.residual / max(g.noise, 1e-12), default=None)
        named = [worst.joint] if worst is not None else []
    return [(joint, joints.index(joint)) for joint in dict.fromkeys(named)][:2]


def _torque_card(motions: Sequence[JointMotion], joint: str, number: int) -> FigureCard | None:
    missing = np.concatenate([m.residual_torque[:, number] for m in motions])
    if not np.isfinite(missing).any():
        return None
    floors = [float(m.residual_noise[number]) for m in motions]
    unit = motions[0].units[number]
    panels = [
        (
            f"{name} of {joint} [{_UNITS[unit][name]}]",
            np.concatenate([m.regressor(name, number) for m in motions]),
        )
        for name in _PANELS
    ]
    return FigureCard(
        title=f"{'Torque' if unit == 'N·m' else 'Force'} at {joint} not explained by the model",
        image=residual_panels(
            panels, missing, None, floor=float(np.nanmean(floors)), label=f"[{unit}]"
        ),
        caption=f"What was applied at {joint} beyond what the nominal model, fitted within its "
        "tolerance, needs for the measured motion: friction shows as what grows with the "
        "velocity. The grey band is what noise makes of it.",
    )


def _reading_card(solution: GapSolution, evidence: ResidualDiagnostics) -> FigureCard | None:
    """Residual of the worst channel, before and after."""
    before = by_channel(solution, solution.base.held_out_residual)
    after = by_channel(solution, solution.best.held_out_residual)
    gaps = {
        name: np.sqrt(np.mean(np.concatenate([s.residual for s in many]) ** 2))
        for name, many in before.items()
    }
    if not gaps:
        return None
    channel = max(gaps, key=lambda name: float(gaps[name]))
    motions, many = evidence.held_out_motions, before[channel]
    joint = _joint_of(evidence, channel, solution)
    units = _UNITS[motions[0].units[joint]]
    panels = [
        (
            f"{name} of {solution.problem.machine.joints[joint]} [{units[name]}]",
            np.concatenate([motions[s.trial].at(name, joint, s.time) for s in many]),
        )
        for name in _PANELS
    ]
    if not any(np.isfinite(values).any() for _, values in panels):
        return None
    return FigureCard(
        title=f"Residual of {channel}",
        image=residual_panels(
            [panel for panel in panels if np.isfinite(panel[1]).any()],
            np.concatenate([s.residual for s in many]),
            np.concatenate([s.residual for s in after[channel]]),
            floor=1.0,
            label="in noise standard deviations",
        ),
        caption=f"What {channel} shows beyond the model, before and after. The grey band is the "
        "noise floor.",
    )


def _joint_of(evidence: ResidualDiagnostics, channel: str, solution: GapSolution) -> int:
    """Joint against whose motion a channel's residual is drawn."""
    own = [g for g in evidence.location.channels if g.channel == channel]
    found: Dependence | None = None
    for gap in own:
        each = strongest(gap.dependences)
        if each is not None and (found is None or each.share > found.share):
            found = each
    return solution.problem.machine.joints.index(found.joint) if found is not None else 0


def _location_group(evidence: ResidualDiagnostics) -> dict[str, Any]:
    """Location of the gap by channel, over all runs."""
    rows = []
    channels = dict.fromkeys(g.channel for g in evidence.location.channels)
    for channel in channels:
        own = [g for g in evidence.location.channels if g.channel == channel]
        worst = max(own, key=lambda g: g.rms)
        band = main_band(worst)
        found = strongest(worst.dependences)
        rows.append(
            {
                "Channel": channel,
                "RMS / noise": spread([g.rms for g in own]),
                "Worst run": worst.run,
                "Mean": signed(worst.offset),
                "Most between": "noise alone"
                if band is None
                else f"{band.low:g} and {band.high:g} Hz",
                "Depends on": "none significant"
                if found is None
                else f"{found.regressor} of {found.joint}, {100 * found.share:.0f} %",
            }
        )
    rows.sort(key=lambda row: -float(str(row["RMS / noise"]).split(" to ")[-1]))
    table = {
        "rows": rows,
        "note": "Nominal model, fitted within its tolerance, on all runs. RMS / noise: residual "
        "over the noise floor, from the best run to the worst. Mean: constant part, in noise "
        "standard deviations. Depends on: share of the residual's power in the worst run that is a "
        "function of that quantity.",
    }
    return group("Residual by channel", "", tables=[table])


def _ranking_group(result: GapResult) -> dict[str, Any]:
    """What was tried."""
    tables = []
    for step in sorted({r.step for r in result.ranking}):
        own = [r for r in result.ranking if r.step == step][:_RANKED]
        tables.append(
            {
                "title": "" if step == 1 else f"Effect number {step}, beside those before",
                "rows": [
                    {
                        "Effect": ranked_words(r),
                        "Held-out residual": f"{r.held_out:.3f}",
                        "Improvement": signed(r.improvement_z),
                        "BIC": signed(r.bic, 0),
                    }
                    for r in own
                ],
                "note": "",
            }
        )
    if tables:
        tables[-1]["note"] = (
            "Held-out residual: over the noise floor. z: improvement over the step before on the "
            "held-out runs. BIC: with the effective "
            "sample size, against the step before; negative pays for the parameters."
        )
    return group("Candidate fits", "", tables=tables)


def _remaining_group(result: GapResult) -> dict[str, Any]:
    rows = []
    for left in sorted(result.residual_tests, key=lambda t: -t.rms):
        found = strongest(left.dependences)
        rows.append(
            {
                "Channel": left.channel,
                "RMS / noise": f"{left.rms:.2f}",
                "Autocorrelation": "by features"
                if np.isnan(left.autocorrelation)
                else signed(left.autocorrelation),
                "Correlation time": "by features"
                if np.isnan(left.largest_autocorrelation)
                else "white"
                if left.white
                else duration_words(left.correlation_time),
                "Depends on": "none significant"
                if found is None
                else f"{found.regressor} of {found.joint}, {100 * found.share:.0f} %",
                "Drift": signed(left.trend) if left.trend_z >= 3 else "none significant",
            }
        )
    note = (
        "The corrected model on the held-out runs. Autocorrelation: of neighbouring "
        "samples, 0 for noise. Drift: from the beginning of a run "
        "to its end, in noise standard deviations. By features: of chaotic runs with impacts, "
        "over what a right model scatters by, without an order in time."
    )
    return group("Remaining residual", "", tables=[{"rows": rows, "note": note}] if rows else [])


def _next_group(result: GapResult) -> dict[str, Any]:
    return group("What to do next", "", points=next_steps(result), code=result.code)


def _notes(result: GapResult) -> list[str]:
    settings = ", ".join(f"{k} {v}" for k, v in result.settings.items() if not isinstance(v, dict))
    return [
        f"Held-out runs: {', '.join(result.held_out_runs)}. All numbers stand in result.json.",
        *([f"Settings: {settings}."] if settings else []),
    ]
