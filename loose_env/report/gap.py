"""Report of `loose gap` as text, HTML and page: headline, next steps, parameters, residuals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import log1p
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from loose_env.errors import MissingExtra
from loose_env.gap import (
    ACCEPTED_Z,
    NOISE_RMS,
    Dependence,
    EffectLocation,
    FeatureChannel,
    GapResult,
    GapSolution,
    Identifiability,
    JointMotion,
    NamedEffect,
    QuickLook,
    RankedHypothesis,
    ResidualDiagnostics,
    Series,
    how_to_see,
    how_to_separate,
    in_bands,
    main_band,
    quantity_notes,
    series_of,
    spectrum,
    strongest,
)
from loose_env.io import begun, duration_words, write_text
from loose_env.recording import joint_sensors
from loose_env.report.gap_figures import (
    channel_bars,
    horizon_curves,
    overlay_figure,
    residual_panels,
    spectrum_curves,
)
from loose_env.report.page import (
    Brief,
    FigureCard,
    Section,
    Table,
    aligned,
    graded_parts,
    named_list,
    render_page,
    warnings_section,
)
from loose_env.report.words import (
    RIVALS,
    Located,
    deletion_words,
    effect_words,
    kind_words,
    rivals_words,
    together,
)
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ZERO = frozenset(
    {
        "amplitude", "damping", "delay", "drag", "gap", "inertia", "mass", "offset",
        "time_constant", "torque", "backward", "cosine", "forward", "share", "sine", "width",
    }
)  # fmt: skip
_VECTORS = frozenset({"link_com", "sensor_misalignment", "sensor_bias", "base_tilt"})
"""Parameters that are zero where the effect is absent, and effects of which all components are."""
_ONE = frozenset({"factor", "gain", "static_ratio"})
_HEADLINE = 36  # letters of the effects in the headline
_ROWS, _PARAMETERS, _BARS = 12, 16, 24  # rows of a table, of that of parameters; channels drawn
_MOVED = 1e-3  # deviation of a factor from 1 from which it is listed
_SPECTRA, _JOINTS = 4, 8  # channels with a spectrum, and joints with an overlay
_SECONDS, _SAMPLES = 2.0, 400  # time of an overlay [s], and its samples
_PANELS = ("position", "velocity", "load")
_UNITS = {"N·m": ("rad", "rad/s", "N·m"), "N": ("m", "m/s", "N")}
_EFFECTS = ["missing effect", "probability", "parameter", "value", "95 % interval", "unit"]
_QUICK = ["may be missing", "parameter", "value", "unit", "explains", "z", "residual left"]


# Headline, text


def gap_headline(result: GapResult) -> str:
    """The outcome of `loose gap` in one line.

    Examples
    --------
    >>> from loose_env.gap import Gap
    >>> gap_headline(GapResult(verdict="no_gap", gap=Gap(before=1.0, after=1.0)))
    'No model error: the model explains the measurement.'
    """
    if result.verdict == "no_gap":
        return "No model error: the model explains the measurement."
    if result.verdict == "unexplained":  # nothing is named then
        likely = _unsure(result)
        if likely is None:
            return "An effect is missing that is not in the catalogue."
        return f"An effect is missing, perhaps {_short(likely.places)}."
    return f"The model lacks {_short(result.effects)}{', and a further effect' * _open(result)}."


def _short(effects: Sequence[Located]) -> str:
    """Effects in one line: with their locations, else without, else their number."""
    kinds = dict.fromkeys(kind_words(e.kind) for e in effects)
    fits = (w for w in (together(effects), named_list(list(kinds))) if len(w) <= _HEADLINE)
    return next(fits, f"{len(effects)} effects")


def _open(result: GapResult) -> bool:
    """True if a large residual remains after the identified effects."""
    return bool(result.remaining) and result.gap.after > NOISE_RMS and _by_impacts(result) is None


def _by_impacts(result: GapResult) -> NamedEffect | None:
    """A part with stops, identified by its impact power."""
    return next((e for e in result.effects if e.impact_power_explained is not None), None)


def _unsure(result: GapResult) -> RankedHypothesis | None:
    """Insignificant hypothesis that explains an unexplained residual; None if there is none."""
    if result.verdict != "unexplained" or result.gap.before <= NOISE_RMS:
        return None
    first = (r for r in result.ranking if r.step == 1 and r.improvement_z < ACCEPTED_Z)
    return next((r for r in first if r.held_out <= NOISE_RMS), None)


def summary_words(result: GapResult) -> list[str]:
    """Effects with their locations, and the residual before and after, below the headline."""
    found, likely = [], _unsure(result)
    if result.effects:
        found.append(f"{begun(together(result.effects))}.")
    elif likely is not None:
        found.append(f"It may be {together(likely.places)}; that is not significant in these runs.")
    after = "" if result.verdict == "no_gap" else f", {result.gap.after:.2f} after correction"
    found.append(
        f"Residual on held-out runs: {result.gap.before:.2f} noise standard deviations{after} "
        "(sensor noise alone: 1)."
    )
    return found


def _brief(result: GapResult, *, warnings: bool) -> Brief:
    effects = [row for effect in result.effects for row in _effect_rows(effect)]
    gap = result.gap
    sizes = [
        ("nominal model", gap.before),
        ("corrected model", gap.after),
        ("sensor noise alone", gap.noise_floor),
    ]
    top = log1p(max(NOISE_RMS, *(value for _, value in sizes)))
    residual = [[name, log1p(value) / top, f"{value:.2f}"] for name, value in sizes]
    heads = ["residual on held-out runs", "logarithmic", "noise standard deviations"]
    where = result.location_words if result.verdict == "unexplained" else ()
    return Brief(
        headline=gap_headline(result),
        parts=[
            ("Location of the residual", "  ", where),
            ("", "  ", [[*_EFFECTS, "confusable with"], *effects] if effects else []),
            ("", "  ", [heads, *residual]),
            ("In physical units", "  ", quantity_notes(gap.by_quantity)),
            ("Remaining", "remaining: ", result.remaining if result.verdict == "named" else ()),
            *(graded_parts(result.graded_warnings) if warnings else []),
        ],
    )


def _effect_rows(effect: NamedEffect) -> list[list[str]]:
    """Rows of an effect's parameters; the first names the effect."""
    likely = "" if effect.probability is None else f"{100 * effect.probability:.0f} %"
    name, others, rows = (
        effect_words(effect.kind, effect.where),
        ", ".join(rivals_words(effect)),
        [],
    )
    for parameter, value in effect.parameters.items():
        ends = effect.interval_95.get(parameter)
        between = "" if ends is None else f"{ends[0]:.4g} to {ends[1]:.4g}"
        words, unit = parameter.replace("_", " "), effect.units.get(parameter, "")
        rows.append([name, likely, words, f"{value:.4g}", between, unit, others])
        name = likely = others = ""
    return rows


def gap_text(result: GapResult, *, warnings: bool = True) -> str:
    """Result of `loose gap` in a few lines of text.

    Parameters
    ----------
    result : GapResult
        Result.
    warnings : bool
        True to end with the warnings.

    Examples
    --------
    >>> from loose_env.gap import Gap
    >>> print(gap_text(GapResult(verdict="no_gap", gap=Gap(before=1.04, after=1.04))))
    No model error: the model explains the measurement.
      residual on held-out runs  noise standard deviations
      nominal model              1.04
      corrected model            1.04
      sensor noise alone         1.00
    """
    return _brief(result, warnings=warnings).text()


def gap_html(result: GapResult) -> str:
    """Result of `loose gap` as a fragment of HTML, with the residuals drawn as bars."""
    return _brief(result, warnings=True).html()


def quick_text(look: QuickLook) -> str:
    """Result of `loose gap --quick` in a few lines of text.

    Examples
    --------
    >>> print(quick_text(QuickLook(before=1.02)))
    Residual on held-out windows: 1.02 noise standard deviations; it is white.
    A quick look ranks and does not decide: run the command without --quick.
    """
    rows = [_QUICK]
    for each in look.candidates:
        shares = [f"{100 * each.explained:.0f} %", f"{each.held_out_z:.1f}", f"{each.held_out:.2f}"]
        for k, effect in enumerate(each.effects):
            name = f"{'and ' * (k > 0)}{effect_words(effect.kind, effect.where)}"
            for parameter, value in each.parameters[k].items():
                words, unit = parameter.replace("_", " "), each.units[k][parameter]
                rows.append([name, words, f"{value:.4g}", unit, *shares])
                name, shares = "", ["", "", ""]
    size = f"Residual on held-out windows: {look.before:.2f} noise standard deviations"
    lines = [f"{size}." if look.candidates else f"{size}; it is white."]
    table = aligned(rows) if look.candidates else []
    lines += [f"  {words}" for words in (*look.location_words, *table)]
    lines.append("A quick look ranks and does not decide: run the command without --quick.")
    return "\n".join(lines)


# Page


def write_gap_report(
    folder: Path,
    solution: GapSolution,
    evidence: ResidualDiagnostics,
    result: GapResult,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> Path | None:
    """Write ``report.html``; None where it cannot be drawn or written.

    A search may have taken hours, and its model and result are worth more than the page: whatever
    it fails by is said, not raised, and an earlier page does not stay.

    Parameters
    ----------
    folder : Path
        Where it goes.
    solution, evidence, result
        As of `loose_env.gap.write_gap`, whose ``report`` this is.
    say : callable
        Receives the reason why there is no page.
    """
    try:
        return write_text(folder / "report.html", render_gap_page(solution, evidence, result))
    except MissingExtra as error:
        say(f"no report.html: {error}")
    except Exception as error:  # whatever a page fails by, model and result do not need it
        say(f"no report.html: {type(error).__name__}: {error}")
    folder.joinpath("report.html").unlink(missing_ok=True)
    return None


def render_gap_page(solution: GapSolution, evidence: ResidualDiagnostics, result: GapResult) -> str:
    """Return the page of a model-error analysis.

    Parameters
    ----------
    solution, evidence, result
        As of `loose_env.gap.write_gap`.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    before = by_channel(solution, solution.base.held_out_residual)
    after = by_channel(solution, solution.best.held_out_residual)
    settings = ", ".join(f"{k} {v}" for k, v in result.settings.items() if not isinstance(v, dict))
    return render_page(
        gap_headline(result),
        [
            Section(heading="What to do next", points=gap_steps(result), code=result.code),
            parameters_section(result),
            overlay_section(solution, before, after),
            Section(answers=_answers(result)),
            warnings_section(result.graded_warnings),
            _residual_section(evidence, result),
            _spectra_section(evidence, result, before, after),
            _motion_section(solution, evidence, before, after),
            _location_section(evidence),
            _ranking_section(result),
            _remaining_section(result),
            _identifiability_section(result.identifiability),
        ],
        kicker=[solution.problem.recording, "model error"],
        text=summary_words(result),
        notes=[
            f"Held-out runs: {', '.join(result.held_out_runs)}. All numbers stand in result.json.",
            *([f"Settings: {settings}."] if settings else []),
        ],
    )


def gap_steps(result: GapResult) -> list[str]:
    """Recommended next steps."""
    steps, likely = [], _unsure(result)
    if result.verdict == "named":
        steps.append(
            "Simulate with model.xml. It is a plain MJCF file, and the recording's columns are "
            "valid in it."
        )
    if result.code:
        steps.append(
            "Apply the lines below to the simulation: MJCF has no means for them, so model.xml "
            "does not carry them."
        )
    for effect in result.effects:
        for other in effect.ambiguous_with[:RIVALS]:
            advice = how_to_separate(effect.kind, effect.where, other.kind, other.where)
            names = [effect_words(each.kind, each.where) for each in (effect, other)]
            steps.append(f"To separate {' from '.join(names)}: {advice[0].lower()}{advice[1:]}")
    if likely is not None:
        steps.append(
            f"Record more of these motions, or longer ones: {together(likely.places)} reduces the "
            f"residual from {result.gap.before:.2f} to {likely.held_out:.2f}, but with a z-score "
            f"of only {likely.improvement_z:.1f}."
        )
    if result.verdict == "unexplained":
        steps += [f"Look here: {words}" for words in result.location_words]
    elif _open(result):
        steps += [f"Look here for the missing effect: {words}" for words in result.remaining[1:]]
    if result.verdict == "unexplained" or _open(result):
        steps.append(
            "If you know the effect, add it: it is one small class in one file, and is fitted like "
            "those of the catalogue."
        )
    if result.verdict == "no_gap":
        steps.append(
            "To look closer, record motions that strain what you suspect: slow and fast, with "
            "reversals, over the whole range, with and without load."
        )
    drifts = [t.channel for t in result.residual_tests if t.trend_z >= 4 and abs(t.trend) > 0.5]
    if drifts:
        steps.append(
            f"{named_list([*drifts[:3], *(['others'] if len(drifts) > 3 else [])])} drift within a "
            "run: something warms up or creeps. Record a long run at constant motion."
        )
    return steps


def _answers(result: GapResult) -> dict[str, Sequence[str]]:
    """Findings, each under its heading."""
    named = [
        f"{effect_words(e.kind, e.where)}: {e.kind} at {e.where}, {deletion_words(e)}"
        for e in result.effects
    ]
    doubtful = [
        f"{effect_words(e.kind, e.where)}: {deletion_words(e)}; too little to tell it from a "
        "stand-in for something else"
        for e in result.doubtful
    ]
    found: dict[str, Sequence[str]] = {
        "Missing effects": [each.rstrip(", ") for each in named],
        "Reduce the error, not identified": doubtful,
        "Location of the residual": result.location_words if result.verdict != "no_gap" else (),
        "Size of the model error": size_words(result),
        "Remaining residual": result.remaining if result.verdict == "named" else (),
        "Confusable effects": mistaken_words(result),
    }
    return {heading: words for heading, words in found.items() if words}


def size_words(result: GapResult) -> list[str]:
    """Size of the model error, before and after correction."""
    gap, count = result.gap, len(result.held_out_runs)
    said = (
        f"Residual of the nominal model on {'one run' if count == 1 else f'{count} runs'} held out "
        f"from all fits: {gap.before:.2f} noise standard deviations (sensor noise alone: 1)"
    )
    if result.verdict == "no_gap":
        return [f"{said}, explained by its tolerance and the noise."]
    left = "Most of it remains."
    if gap.after <= NOISE_RMS:
        left = "The residual is down to the noise."
    elif (impact_fit := _by_impacts(result)) is not None:
        left = (
            "The times of impacts are not reproducible; of their power the corrected model "
            f"explains {100 * (impact_fit.impact_power_explained or 0.0):.0f} %."
        )
    elif gap.after < 0.7 * gap.before:
        left = "It is reduced, not eliminated: see the remaining residual."
    units = [f"{begun(words)}." for words in quantity_notes(gap.by_quantity)]
    return [f"{said}; of the corrected model: {gap.after:.2f}. {left}", *units]


def mistaken_words(result: GapResult) -> list[str]:
    """Confusable effects of each identified one."""
    said, impact_fit = [], _by_impacts(result)
    groups: dict[tuple[int, tuple[EffectLocation, ...]], list[NamedEffect]] = {}
    for effect in result.effects:
        if not effect.ambiguous_with and effect is not impact_fit:
            own = EffectLocation(kind=effect.kind, where=effect.where)
            first = next((r for r in result.ranking if own in r.places), None)
            groups.setdefault((first.step, first.places) if first else (0, ()), []).append(effect)
    for (step, fitted), effects in groups.items():
        words = together(effects)
        others = sum(row.step == step and row.places != fitted for row in result.ranking)
        if not others:
            said.append(f"No other hypothesis was fitted to whole runs in place of {words}.")
            continue
        rivals = (
            "the one other hypothesis that was fitted to whole runs does not explain"
            if others == 1
            else f"none of the {others} other hypotheses that were fitted to whole runs explains"
        )
        said.append(f"In place of {words}, {rivals} the held-out runs as well.")
        if len(fitted) > 1:
            said.append(
                "These were fitted jointly; another effect at one of the locations, with the "
                "others unchanged, was not tried."
            )
    if impact_fit is not None and not impact_fit.ambiguous_with:
        words = effect_words(impact_fit.kind, impact_fit.where)
        said.append(f"No play at another location explains the impact power as well as {words}.")
    said += [
        f"The held-out runs do not separate {effect_words(e.kind, e.where)} from "
        f"{' or from '.join(rivals_words(e))}."
        for e in result.effects
        if e.ambiguous_with
    ]
    return said


def parameters_section(result: GapResult) -> Section:
    """The one table of parameters: those of the effects, then the nominal ones."""
    rows = [
        _parameter(
            f"{effect_words(effect.kind, effect.where)}: {name.replace('_', ' ')}",
            _absent(effect.kind, name),
            value,
            effect.interval_95.get(name),
            effect.units.get(name, "") or "1",
        )
        for effect in result.effects
        for name, value in effect.parameters.items()
    ]
    moved = sorted(result.nominal_parameters.items(), key=lambda item: -abs(item[1] - 1))
    kept = [item for item in moved if abs(item[1] - 1) >= _MOVED][: max(_PARAMETERS - len(rows), 4)]
    rows += [_parameter(name, "1", value, None, "factor") for name, value in kept]
    note = (
        "Nominal: value in the recording's model, or with which the effect is absent. Factors are "
        "of nominal parameters, fitted within their tolerance and never reported as an effect; "
        "model.xml carries them."
    )
    if len(kept) < len(moved):
        note += f" The other {len(moved) - len(kept)} are closer to 1: see result.json."
    return Section(heading="Parameters", tables=[Table(rows=rows, note=note)] if rows else [])


def _parameter(
    name: str, nominal: str, found: float, ends: tuple[float, float] | None, unit: str
) -> dict[str, str]:
    return {
        "Parameter": begun(name) if " " in name else name,
        "Nominal": nominal,
        "Found": f"{found:.4g}",
        "95 % interval": "–" if ends is None else f"{ends[0]:.4g} to {ends[1]:.4g}",
        "Unit": unit,
    }


def _absent(kind: str, name: str) -> str:
    """Value of a parameter where the effect is absent; a dash where it only shapes the effect."""
    if name in _ONE:
        return "1"
    if name == "stiffness":
        return "0" if kind == "joint_spring" else "rigid"
    return "0" if name in _ZERO or kind in _VECTORS else "–"


BySeries = Mapping[str, Sequence[Series]]


def by_channel(solution: GapSolution, residual: Array) -> dict[str, list[Series]]:
    """Series of a residual on the held-out runs, those of each channel together."""
    held = solution.problem.held_out_whole
    found: dict[str, list[Series]] = {}
    for series in series_of(residual, held.rows, held.trials, held.channels):
        found.setdefault(series.channel, []).append(series)
    return found


def overlay_section(solution: GapSolution, before: BySeries, after: BySeries) -> Section:
    """Measured, nominal and corrected readings of the joints over time."""
    machine = solution.problem.machine
    sensors = joint_sensors(machine.model)
    chosen: dict[str, tuple[Series, Series]] = {}
    for joint in machine.joints:
        if joint in sensors:
            read = (*sensors[joint].position, *sensors[joint].velocity)
            pairs = [
                (one, other)
                for channel in (f"torque.{joint}", *(f"sensor.{name}" for name in read))
                for one, other in zip(before.get(channel, ()), after.get(channel, ()), strict=False)
                if one.trial == other.trial and len(one.time) == len(other.time) > 8
            ]
            if pairs:
                chosen[joint] = max(pairs, key=lambda pair: pair[0].rms)
    worst = sorted(chosen, key=lambda joint: -chosen[joint][0].rms)[:_JOINTS]
    cards = [
        FigureCard(
            title=joint,
            image=_overlay(solution, one, other, joint),
            caption=f"{one.channel} of {one.run}, held out from all fits. Residual {one.rms:.2f} "
            f"before and {other.rms:.2f} after correction, in noise standard deviations.",
        )
        for joint, (one, other) in chosen.items()
        if joint in worst
    ]
    intro = f"Up to {_SECONDS:g} s about the largest residual of the nominal model."
    return Section(heading="Measured, nominal and corrected", intro=[intro], cards=cards)


def _overlay(solution: GapSolution, one: Series, other: Series, joint: str) -> Figure:
    held, model = solution.problem.held_out_whole, solution.problem.machine.model
    column = next(c for c, each in enumerate(held.channels) if each.name == one.channel)
    scale = float(held.scales[one.trial, column])
    measured: Array = held.trials[one.trial].measured[one.sample, column]
    width = min(25, len(one.residual))
    smooth = np.convolve(np.abs(one.residual), np.ones(width) / width, mode="same")
    centre = float(one.time[int(np.argmax(smooth))])
    start = min(max(centre - _SECONDS / 2, one.time[0]), max(one.time[-1] - _SECONDS, one.time[0]))
    inside = np.flatnonzero((one.time >= start) & (one.time <= start + _SECONDS))
    few = inside[np.unique(np.linspace(0, len(inside) - 1, _SAMPLES).astype(int))]
    slides = model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    unit = (
        ("N" if slides else "N·m")
        if one.channel.startswith("torque.")
        else "m"
        if slides
        else "rad"
    )
    if one.channel.removeprefix("sensor.") in joint_sensors(model)[joint].velocity:
        unit += "/s"
    models = (measured[few], *((measured - m.residual * scale)[few] for m in (one, other)))
    return overlay_figure(one.time[few], *models, channel=one.channel, unit=unit)


def _residual_section(evidence: ResidualDiagnostics, result: GapResult) -> Section:
    """Residual by channel and by horizon, side by side."""
    pairs = sorted(result.gap.by_channel.items(), key=lambda item: -item[1][0])
    cards = []
    if pairs:
        more = f" The {_BARS} largest of {len(pairs)} channels." if len(pairs) > _BARS else ""
        cards.append(
            FigureCard(
                title="Channel by channel",
                image=channel_bars(dict(pairs[:_BARS])),
                caption="Residual of each channel over its noise floor, before and after, on a "
                f"logarithmic scale; the dashed line is the noise floor.{more}",
            )
        )
    if pairs and evidence.before:
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
    intro = (
        "On the held-out runs: the nominal model, fitted within its tolerance, and the corrected "
        "one. 1 is sensor noise alone."
    )
    return Section(heading="Residual before and after correction", intro=[intro], cards=cards)


def _spectra_section(
    evidence: ResidualDiagnostics, result: GapResult, before: BySeries, after: BySeries
) -> Section:
    """Spectra of the channels that disagree most."""
    first, then = (
        _spectra(before, evidence.features_before), _spectra(after, evidence.features_after)
    )  # fmt: skip
    worst = sorted(result.gap.by_channel, key=lambda c: -result.gap.by_channel[c][0])[:_SPECTRA]
    cards = []
    for channel in worst:
        if channel in first and channel in then and len(first[channel][0]) > 1:
            said = f"Spectrum of what {channel} shows beyond the model, over that of its noise"
            if channel not in before:
                said = (
                    f"By how much the power of {channel} differs from the simulated power, over "
                    "that of its noise: impacts make the trajectories chaotic"
                )
            image = spectrum_curves(first[channel], then[channel])
            caption = f"{said}. The dashed line is the noise floor."
            cards.append(FigureCard(title=channel, image=image, caption=caption))
    intro = "Spectra of the residual on the held-out runs, of the channels with the largest one."
    return Section(heading="Spectra before and after", intro=[intro], cards=cards)


def _spectra(
    series: BySeries, features: Sequence[FeatureChannel]
) -> dict[str, tuple[Array, Array]]:
    """Spectrum of every channel's residual; of runs without trajectory if of no other."""
    own: dict[str, list[FeatureChannel]] = {}
    for each in features:
        if len(each.power):
            own.setdefault(each.gap.channel, []).append(each)
    found = {}
    for channel, runs in own.items():
        frequency = min((s.frequency for s in runs), key=len)
        power = np.mean([np.interp(frequency, s.frequency, s.power) for s in runs], axis=0)
        found[channel] = in_bands(frequency, power)
    return found | {channel: spectrum(many) for channel, many in series.items()}


def _motion_section(
    solution: GapSolution, evidence: ResidualDiagnostics, before: BySeries, after: BySeries
) -> Section:
    """Residual against position, velocity and load, as torque where the motion allows it."""
    machine = solution.problem.machine
    named = [e.where for e in solution.effects if e.where in machine.joints]
    if not named:  # the joint with the largest torque unexplained
        gaps = [g for g in evidence.location.joints if np.isfinite(g.residual / g.noise)]
        worst = max(gaps, key=lambda g: g.residual / max(g.noise, 1e-12), default=None)
        named = [worst.joint] if worst is not None else []
    cards = [
        _torque_card(evidence.held_out_motions, joint, machine.joints.index(joint))
        for joint in list(dict.fromkeys(named))[:2]
    ]
    cards.append(_reading_card(solution, evidence, before, after))
    intro = (
        "What an effect looks like: friction steps where the motion turns round, a spring goes by "
        "position, a wrong mass by load. Dots are samples of the held-out runs, lines are means."
    )
    return Section(
        heading="Residual against motion and load",
        intro=[intro],
        cards=[card for card in cards if card is not None],
    )


def _torque_card(motions: Sequence[JointMotion], joint: str, number: int) -> FigureCard | None:
    missing = np.concatenate([m.residual_torque[:, number] for m in motions])
    if not np.isfinite(missing).any():
        return None
    unit = motions[0].units[number]
    panels = {
        f"{name} of {joint} [{own}]": np.concatenate([m.regressor(name, number) for m in motions])
        for name, own in zip(_PANELS, _UNITS[unit], strict=True)
    }
    floor = float(np.nanmean([float(m.residual_noise[number]) for m in motions]))
    return FigureCard(
        title=f"{'Torque' if unit == 'N·m' else 'Force'} at {joint} not explained by the model",
        image=residual_panels(panels, missing, None, floor=floor, label=f"[{unit}]"),
        caption=f"What was applied at {joint} beyond what the nominal model, fitted within its "
        "tolerance, needs for the measured motion: friction shows as what grows with the "
        "velocity. The grey band is what noise makes of it.",
    )


def _reading_card(
    solution: GapSolution, evidence: ResidualDiagnostics, before: BySeries, after: BySeries
) -> FigureCard | None:
    """Residual of the worst channel, before and after."""
    if not before:
        return None
    joined = {name: np.concatenate([s.residual for s in many]) for name, many in before.items()}
    channel = max(joined, key=lambda name: float(np.mean(joined[name] ** 2)))
    depends = [
        each
        for gap in evidence.location.channels
        if gap.channel == channel and (each := strongest(gap.dependences)) is not None
    ]
    joints, motions = solution.problem.machine.joints, evidence.held_out_motions
    joint = joints.index(max(depends, key=lambda d: d.share).joint) if depends else 0
    panels = {
        f"{name} of {joints[joint]} [{unit}]": np.concatenate(
            [motions[s.trial].at(name, joint, s.time) for s in before[channel]]
        )
        for name, unit in zip(_PANELS, _UNITS[motions[0].units[joint]], strict=True)
    }
    panels = {name: values for name, values in panels.items() if np.isfinite(values).any()}
    if not panels:
        return None
    left = np.concatenate([s.residual for s in after[channel]])
    label = "in noise standard deviations"
    return FigureCard(
        title=f"Residual of {channel}",
        image=residual_panels(panels, joined[channel], left, floor=1.0, label=label),
        caption=f"What {channel} shows beyond the model, before and after. The grey band is the "
        "noise floor.",
    )


def _depends(found: Dependence | None) -> str:
    if found is None:
        return "none significant"
    return f"{found.regressor} of {found.joint}, {100 * found.share:.0f} %"


def _location_section(evidence: ResidualDiagnostics) -> Section:
    """Location of the residual by channel, over all runs."""
    own: dict[str, list[Any]] = {}
    for gap in evidence.location.channels:
        own.setdefault(gap.channel, []).append(gap)
    rows = []
    for channel, gaps in sorted(own.items(), key=lambda item: -max(g.rms for g in item[1])):
        worst, low = max(gaps, key=lambda g: g.rms), min(f"{g.rms:.2f}" for g in gaps)
        band, high = main_band(worst), f"{worst.rms:.2f}"
        rows.append(
            {
                "Channel": channel,
                "RMS / noise": high if low == high else f"{low} to {high}",
                "Worst run": worst.run,
                "Mean": f"{worst.offset:.2f}",
                "Most between": f"{band.low:g} and {band.high:g} Hz" if band else "noise alone",
                "Depends on": _depends(strongest(worst.dependences)),
            }
        )
    note = (
        "Nominal model, fitted within its tolerance, on all runs. RMS / noise: residual over the "
        "noise floor, from the best run to the worst. Mean: constant part, in noise standard "
        "deviations. Depends on: share of the residual's power in the worst run that is a function "
        "of that quantity."
    )
    return Section(heading="Residual by channel", tables=[Table(rows=rows, note=note)])


def _ranking_section(result: GapResult) -> Section:
    """Hypotheses that were fitted to whole runs, by step."""
    tables = []
    note = (
        "Held-out residual: over the noise floor. Improvement: z-score over the step before on the "
        "held-out runs. BIC: with the effective sample size, against the step before; negative "
        "pays for the parameters."
    )
    steps = sorted({r.step for r in result.ranking})
    for step in steps:
        rows = [
            {
                "Effect": together(r.places, plain=False),
                "Held-out residual": f"{r.held_out:.3f}",
                "Improvement": f"{r.improvement_z:.2f}",
                "BIC": f"{r.bic:.0f}",
            }
            for r in result.ranking
            if r.step == step
        ]
        title = "" if step == 1 else f"Effect number {step}, beside those before"
        tables.append(Table(title=title, rows=rows[:_ROWS], note=note if step == steps[-1] else ""))
    return Section(heading="Candidate fits", tables=tables)


def _remaining_section(result: GapResult) -> Section:
    rows = []
    for left in sorted(result.residual_tests, key=lambda t: -t.rms):
        time = "white" if left.white else duration_words(left.correlation_time)
        features = np.isnan(left.autocorrelation)
        rows.append(
            {
                "Channel": left.channel,
                "RMS / noise": f"{left.rms:.2f}",
                "Autocorrelation": "by features" if features else f"{left.autocorrelation:.2f}",
                "Correlation time": "by features"
                if np.isnan(left.largest_autocorrelation)
                else time,
                "Depends on": _depends(strongest(left.dependences)),
                "Drift": f"{left.trend:.2f}" if left.trend_z >= 3 else "none significant",
            }
        )
    note = (
        "The corrected model on the held-out runs. Autocorrelation: of neighbouring samples, 0 for "
        "noise. Drift: from the beginning of a run to its end, in noise standard deviations. By "
        "features: of chaotic runs with impacts, over what a right model scatters by, without an "
        "order in time."
    )
    return Section(heading="Remaining residual", tables=[Table(rows=rows, note=note)])


def _identifiability_section(found: Identifiability) -> Section:
    """Effects that these motions do not show or separate; empty where there is none."""

    def more(seconds: float | None) -> str:
        return "no help" if seconds is None else duration_words(seconds)

    unseen = [
        {
            "Effect": f"{each.kind} at {each.where}",
            "At a size of": ", ".join(f"{k} {v:.3g}" for k, v in each.parameters.items()),
            "z": f"{each.z:.1f}",
            "More of the same": more(each.additional_s),
            "Better": how_to_see(each.kind),
        }
        for each in sorted(found.unidentifiable, key=lambda e: -e.z)
    ]
    alike = [
        {
            "Effect": f"{pair.kind} at {pair.where}",
            "Confusable with": f"{pair.other_kind} at {pair.other_where}",
            "z": f"{pair.z:.1f}",
            "More of the same": more(pair.additional_s),
            "Better": how_to_separate(pair.kind, pair.where, pair.other_kind, pair.other_where),
        }
        for pair in found.confusable
    ]
    tables = []
    for title, rows in (("Not identifiable", unseen), ("Confusable", alike)):
        rest = f"{_ROWS} of {len(rows)}; all stand in result.json." if len(rows) > _ROWS else ""
        tables.append(Table(title=title, rows=rows[:_ROWS], note=rest))
    intro = (
        "Every effect at a size that matters, simulated on the training runs: its signature beyond "
        "the tolerance of the nominal parameters, as a z-score; 5 is needed."
    )
    return Section(heading="Identifiability from these motions", intro=[intro], tables=tables)
