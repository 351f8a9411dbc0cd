"""The page of a comparison of model and measurement: words first, then figures and tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.gap import (
    Dependence,
    Evidence,
    GapResult,
    GapSolution,
    JointMotion,
    main_band,
    strongest,
)
from loose_env.io import duration_words, sentence
from loose_env.report.gap.figures import (
    channel_bars,
    horizon_curves,
    residual_panels,
)
from loose_env.report.gap.spectra import by_channel, spectra_group
from loose_env.report.gap.text import (
    effect_words,
    headline,
    mistaken_words,
    next_steps,
    ranked_words,
    shown_group,
    size_words,
    sure_words,
)
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.sections import group, signed, spread
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
    path: Path, solution: GapSolution, evidence: Evidence, result: GapResult
) -> Path:
    """Write the page, beside its final name first.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    return write_whole(path, render_gap_page(solution, evidence, result))


def render_gap_page(solution: GapSolution, evidence: Evidence, result: GapResult) -> str:
    """Return the page that `write_gap_page` writes."""
    groups = [
        _gap_group(evidence, result),
        spectra_group(solution, evidence, result),
        _motion_group(solution, evidence),
        _location_group(evidence),
        _ranking_group(result),
        _left_group(result),
        shown_group(result.identifiability),
        _figures_group(result),
        _next_group(result),
    ]
    page: str = template("loose_env.report/gap_page.html").render(
        title=headline(result),
        kicker=" · ".join(
            filter(None, [solution.problem.recording, "where model and measurement disagree"])
        ),
        text=[],
        questions=_questions(result),
        warnings=[sentence(warning) for warning in result.warnings],
        groups=[group for group in groups if group],
        notes=_notes(result),
    )
    return page


def _questions(result: GapResult) -> list[tuple[str, list[str]]]:
    """What a reader asks first, with the answers."""
    found = []
    if result.effects:
        named = [f"{effect_words(e.kind, e.where)}: {e.kind} at {e.where}" for e in result.effects]
        found.append(("What is missing", named))
    if result.where_it_lives and result.verdict != "no_gap":
        found.append(("Where it shows", list(result.where_it_lives)))
    found.append(("How large it is", size_words(result)))
    if result.left and result.verdict == "named":
        found.append(("What is left", list(result.left)))
    if result.effects:
        found.append(
            ("How sure", [f"{e.kind} at {e.where}: {sure_words(e)}." for e in result.effects])
        )
        found.append(("What it could be mistaken for", mistaken_words(result)))
    return found


def _gap_group(evidence: Evidence, result: GapResult) -> dict[str, Any]:
    """The gap by channel and by horizon, side by side."""
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
                title="How far a prediction goes wrong",
                image=horizon_curves(
                    [e.horizon for e in evidence.before],
                    [e.over_floor for e in evidence.before],
                    [e.over_floor for e in evidence.after],
                ),
                caption="The simulation was restarted from the measured state "
                f"{evidence.before[0].starts} times and left to itself: root mean square error of "
                "all channels over their noise floors.",
            )
        )
    return group(
        "The gap, before and after",
        "On the held-out runs: the nominal model, fitted within its tolerance, and the corrected "
        "one. At 1 nothing is left but the sensors' noise.",
        cards=cards if pairs else [],
    )


def _motion_group(solution: GapSolution, evidence: Evidence) -> dict[str, Any]:
    """Residual against position, velocity and load, as torque where the motion allows it."""
    cards = []
    for joint, number in _joints_to_show(solution, evidence):
        motions = evidence.motions_held
        card = _torque_card(motions, joint, number)
        if card is not None:
            cards.append(card)
    reading = _reading_card(solution, evidence)
    if reading is not None:
        cards.append(reading)
    return group(
        "Against motion and load",
        "What an effect looks like: friction steps where the motion turns round, a spring goes by "
        "position, a wrong mass by load. Dots are samples of the held-out runs, lines are means.",
        cards=cards,
    )


def _joints_to_show(solution: GapSolution, evidence: Evidence) -> list[tuple[str, int]]:
    """Joints of the named effects, or the one with the largest torque unexplained."""
    joints = solution.problem.machine.joints
    named = [e.where for e in solution.effects if e.where in joints]
    if not named:
        gaps = [g for g in evidence.location.joints if np.isfinite(g.missing / g.floor)]
        worst = max(gaps, key=lambda g: g.missing / max(g.floor, 1e-12), default=None)
        named = [worst.joint] if worst is not None else []
    return [(joint, joints.index(joint)) for joint in dict.fromkeys(named)][:2]


def _torque_card(motions: Sequence[JointMotion], joint: str, number: int) -> FigureCard | None:
    missing = np.concatenate([m.missing[:, number] for m in motions])
    if not np.isfinite(missing).any():
        return None
    floors = [float(m.missing_floor[number]) for m in motions]
    unit = motions[0].units[number]
    panels = [
        (
            f"{name} of {joint} [{_UNITS[unit][name]}]",
            np.concatenate([m.regressor(name, number) for m in motions]),
        )
        for name in _PANELS
    ]
    return FigureCard(
        title=f"{'Torque' if unit == 'N·m' else 'Force'} at {joint} left unexplained",
        image=residual_panels(
            panels, missing, None, floor=float(np.nanmean(floors)), label=f"[{unit}]"
        ),
        caption=f"What was applied at {joint} beyond what the nominal model, fitted within its "
        "tolerance, needs for the measured motion: friction shows as what grows with the "
        "velocity. The grey band is what noise makes of it.",
    )


def _reading_card(solution: GapSolution, evidence: Evidence) -> FigureCard | None:
    """Residual of the worst channel, before and after."""
    before = by_channel(solution, solution.base.held_residual)
    after = by_channel(solution, solution.best.held_residual)
    gaps = {
        name: np.sqrt(np.mean(np.concatenate([s.residual for s in many]) ** 2))
        for name, many in before.items()
    }
    if not gaps:
        return None
    channel = max(gaps, key=lambda name: float(gaps[name]))
    motions, many = evidence.motions_held, before[channel]
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


def _joint_of(evidence: Evidence, channel: str, solution: GapSolution) -> int:
    """Joint against whose motion a channel's residual is drawn."""
    own = [g for g in evidence.location.channels if g.channel == channel]
    found: Dependence | None = None
    for gap in own:
        each = strongest(gap.depends)
        if each is not None and (found is None or each.share > found.share):
            found = each
    return solution.problem.machine.joints.index(found.of) if found is not None else 0


def _location_group(evidence: Evidence) -> dict[str, Any]:
    """Location of the gap by channel, over all runs."""
    rows = []
    channels = dict.fromkeys(g.channel for g in evidence.location.channels)
    for channel in channels:
        own = [g for g in evidence.location.channels if g.channel == channel]
        worst = max(own, key=lambda g: g.over_floor)
        band = main_band(worst)
        found = strongest(worst.depends)
        rows.append(
            {
                "Channel": channel,
                "Over the noise": spread([g.over_floor for g in own]),
                "Worst run": worst.run,
                "Mean": signed(worst.offset),
                "Most between": "noise alone"
                if band is None
                else f"{band.low:g} and {band.high:g} Hz",
                "Goes with": "nothing surely"
                if found is None
                else f"{found.on} of {found.of}, {100 * found.share:.0f} %",
            }
        )
    rows.sort(key=lambda row: -float(str(row["Over the noise"]).split(" to ")[-1]))
    table = {
        "rows": rows,
        "note": "Nominal model, fitted within its tolerance, on all runs. Over the noise: residual "
        "over the noise floor, from the best run to the worst. Mean: constant part, in noise "
        "standard deviations. Goes with: share of the residual's power in the worst run that is a "
        "function of that quantity.",
    }
    return group("Where the disagreement is", "", tables=[table])


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
                        "Held-out gap": f"{r.held_out:.3f}",
                        "Lead": signed(r.lead),
                        "BIC": signed(r.bic, 0),
                    }
                    for r in own
                ],
                "note": "",
            }
        )
    if tables:
        tables[-1]["note"] = (
            "Held-out gap: residual over the noise floor on runs that no fit has seen. Lead: gain "
            "over the step before on these runs, in standard deviations. BIC: with the effective "
            "sample size, against the step before; negative pays for the parameters."
        )
    return group("What was tried", "", tables=tables)


def _left_group(result: GapResult) -> dict[str, Any]:
    rows = []
    for left in sorted(result.left_over, key=lambda t: -t.over_floor):
        found = strongest(left.depends)
        rows.append(
            {
                "Channel": left.channel,
                "Over the noise": f"{left.over_floor:.2f}",
                "Neighbours": "by features"
                if np.isnan(left.autocorrelation)
                else signed(left.autocorrelation),
                "Hangs together": "by features"
                if np.isnan(left.largest)
                else "white"
                if left.white
                else duration_words(left.correlation_time),
                "Goes with": "nothing surely"
                if found is None
                else f"{found.on} of {found.of}, {100 * found.share:.0f} %",
                "Drift in a run": signed(left.trend) if left.trend_sureness >= 3 else "none sure",
            }
        )
    note = (
        "The corrected model on the held-out runs. Neighbours: autocorrelation of neighbouring "
        "samples, 0 for noise. Hangs together: over what time. Drift: from the beginning of a run "
        "to its end, in noise standard deviations. By features: of runs in which stops are struck, "
        "over what a right model scatters by, without an order in time."
    )
    return group("What is left", "", tables=[{"rows": rows, "note": note}] if rows else [])


def _figures_group(result: GapResult) -> dict[str, Any]:
    if not result.nominal_figures:
        return {}
    moved = sorted(result.nominal_figures.items(), key=lambda item: -abs(item[1] - 1))
    rows = [{"Figure": name, "Factor": f"{value:.4f}"} for name, value in moved]
    return group(
        "Nominal figures",
        "Known within the tolerance only, and fitted within it; nothing is named by them. "
        "model.xml carries these factors: the effects were fitted beside them.",
        tables=[{"rows": rows, "note": ""}],
    )


def _next_group(result: GapResult) -> dict[str, Any]:
    return group("What to do next", "", points=next_steps(result), code=result.code)


def _notes(result: GapResult) -> list[str]:
    settings = ", ".join(f"{k} {v}" for k, v in result.settings.items() if not isinstance(v, dict))
    return [
        f"Held-out runs: {', '.join(result.held_out_runs)}. All numbers stand in result.json.",
        *([f"Settings: {settings}."] if settings else []),
    ]
