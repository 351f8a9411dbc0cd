"""Report of `loose gap` as text, HTML and page: what is missing, joint by joint, and how sure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import date
from math import isfinite, log1p
from pathlib import Path

from loose_env.errors import MissingExtra
from loose_env.gap import (
    ChannelVerdict,
    EffectLocation,
    GapResult,
    GapSolution,
    Identifiability,
    NamedEffect,
    VisibleEffect,
    how_to_see,
    how_to_separate,
    pulled_words,
)
from loose_env.io import begun, write_text
from loose_env.report.gap_figures import (
    channel_bars,
    correlation_figure,
    matrix_figure,
    overlay_figure,
    response_figure,
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
    effect_words,
    kind_words,
    rivals_words,
    together,
)
from loose_env.version import __version__

_HEADLINE = 60  # letters of the effects in the headline
_ROWS, _BARS = 12, 24  # rows of a table, channels drawn
_RESPONSES = 4  # frequency responses drawn
_SAMPLES = 500  # of an overlay
_DOUBTFUL = "Not sure enough to be named"
_EFFECTS = ["missing effect", "probability", "parameter", "value", "95 % interval", "unit"]
_CHANNELS = ["joint or reading", "verdict", "effects", "before", "after"]


# Headline, text


def gap_headline(result: GapResult) -> str:
    """The outcome of `loose gap` in one line.

    Examples
    --------
    >>> from loose_env.gap import Gap
    >>> gap_headline(GapResult(verdict="no_gap", gap=Gap(before=1.0, after=1.0)))
    'No model error: the model explains the measurement.'
    """
    left = [each.channel for each in result.channels if each.verdict == "unexplained"]
    if result.verdict == "no_gap":
        return "No model error: the model explains the measurement."
    if result.verdict == "unexplained":
        if left:
            return f"Nothing tried explains {_channel_words(left)}."
        return "The recording cannot tell which effect is missing."
    rest = f"; {_channel_words(left)} {'is' if len(left) == 1 else 'are'} unexplained"
    return f"The model lacks {_short(result.effects)}{rest * bool(left)}."


def _channel_words(names: Sequence[str]) -> str:
    """Names of joints and readings, or their number where they are many."""
    shown = [name.removeprefix("sensor.") for name in names]
    return named_list(shown) if len(shown) < 4 else f"{len(shown)} joints and readings"


def _short(effects: Sequence[Located]) -> str:
    """Effects in one line: with their locations, else without, else their number."""
    kinds = dict.fromkeys(kind_words(e.kind) for e in effects)
    fits = (w for w in (together(effects), named_list(list(kinds))) if len(w) <= _HEADLINE)
    return next(fits, f"{len(effects)} effects")


def summary_words(result: GapResult) -> list[str]:
    """Effects with their locations, and the residual before and after, below the headline."""
    found = [f"{begun(together(result.effects))}."] if result.effects else []
    after = "" if result.verdict == "no_gap" else f", {result.gap.after:.2f} after correction"
    found.append(
        f"Force that is missing on held-out data: {result.gap.before:.2f} noise standard "
        f"deviations{after} (sensor noise alone: 1)."
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
    top = log1p(max(2.0, *(value for _, value in sizes)))
    residual = [[name, log1p(value) / top, f"{value:.2f}"] for name, value in sizes]
    heads = ["residual on held-out data", "logarithmic", "noise standard deviations"]
    quantities = [
        f"{name}: {before:.3g} {unit} before, {after:.3g} {unit} after"
        for key, (before, after) in gap.by_quantity.items()
        for name, unit in [key.rstrip("]").split(" [")]
    ]
    channels = [
        [c.channel, c.verdict, _kinds(c.effects), f"{c.before:.2f}", f"{c.after:.2f}"]
        for c in result.channels
    ]
    return Brief(
        headline=gap_headline(result),
        parts=[
            ("", "  ", [[*_EFFECTS, "confusable with"], *effects] if effects else []),
            ("", "  ", [heads, *residual]),
            ("", "  ", [_CHANNELS, *channels] if channels else []),
            ("In physical units", "  ", quantities),
            ("Pulled out of their tolerances", "pulled: ", pulled_words(result)[:RIVALS]),
            *(graded_parts(result.graded_warnings) if warnings else []),
        ],
    )


def _kinds(effects: Sequence[EffectLocation]) -> str:
    """Kinds of effects at one joint, as one says them."""
    return named_list(list(dict.fromkeys(kind_words(e.kind) for e in effects)))


def _effect_rows(effect: NamedEffect) -> list[list[str]]:
    """Rows of an effect's parameters; the first names the effect."""
    likely = "" if effect.probability is None else f"{100 * effect.probability:.0f} %"
    name, rows = effect_words(effect.kind, effect.where), []
    others = ", ".join(rivals_words(effect))
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
      residual on held-out data  noise standard deviations
      nominal model              1.04
      corrected model            1.04
      sensor noise alone         1.00
    """
    return _brief(result, warnings=warnings).text()


def gap_html(result: GapResult) -> str:
    """Result of `loose gap` as a fragment of HTML, with the residuals drawn as bars."""
    return _brief(result, warnings=True).html()


def check_text(found: Identifiability) -> str:
    """What a recording could show, as `loose gap --check` prints it.

    Examples
    --------
    >>> print(check_text(Identifiability()))
    No joint moves enough to be compared.
    """
    if not any(joint.used > 0 for joint in found.joints):
        return "No joint moves enough to be compared."
    rows = [["joint", "travel", "speed", "acceleration", "unit", "compared"]]
    rows += [
        [j.joint, f"{j.travel:.3g}", f"{j.speed:.3g}", f"{j.acceleration:.3g}", j.unit,
         f"{100 * j.used:.0f} %"]
        for j in found.joints
    ]  # fmt: skip
    seen = [["would show", "from", "not told from"]]
    seen += [[_name(e), _size(e), _rival_words(e)] for e in found.effects if e.visible]
    unseen = [["would not show", "below", "better"]]
    unseen += [[_name(e), _size(e), how_to_see(e.kind)] for e in found.effects if not e.visible]
    parts = [aligned(part) for part in (rows, seen, unseen) if len(part) > 1]
    return "\n\n".join("\n".join(part) for part in parts)


def _name(effect: VisibleEffect) -> str:
    return f"{effect.kind} at {effect.where}"


def _size(effect: VisibleEffect) -> str:
    """Smallest visible parameters with their units."""
    sizes = effect.smallest.items()
    return ", ".join(f"{k} {v:.3g} {effect.units.get(k, '')}".rstrip() for k, v in sizes)


def _rival_words(effect: VisibleEffect) -> str:
    other = effect.confusable_with
    return "" if other is None else f"{other.kind} at {other.where}"


# Page


def write_gap_report(
    folder: Path, solution: GapSolution, *, say: Callable[[str], None] = lambda _: None
) -> Path | None:
    """Write ``report.html``; None where it cannot be drawn or written.

    Whatever the page fails by is said, not raised: model and result are worth more. An earlier
    page does not stay.

    Parameters
    ----------
    folder : Path
        Where it goes.
    solution : GapSolution
        As of `loose_env.gap.write_gap`, whose ``report`` this is.
    say : callable
        Receives the reason why there is no page.
    """
    try:
        return write_text(folder / "report.html", render_gap_page(solution))
    except MissingExtra as error:
        say(f"no report.html: {error}")
    except Exception as error:  # whatever a page fails by, model and result do not need it
        say(f"no report.html: {type(error).__name__}: {error}")
    folder.joinpath("report.html").unlink(missing_ok=True)
    return None


def render_gap_page(solution: GapSolution) -> str:
    """Return the page of a comparison.

    Parameters
    ----------
    solution : GapSolution
        The finished comparison.

    Raises
    ------
    MissingExtra
        If jinja2 or matplotlib is not installed.
    """
    result = solution.result
    settings = ", ".join(f"{k} {v}" for k, v in result.settings.items() if not isinstance(v, dict))
    tolerances = ", ".join(f"{k} {v:g}" for k, v in result.settings.get("tolerances", {}).items())
    held = ", ".join(result.held_out_runs) or "every run, or every other stretch, once in turn"
    return render_page(
        gap_headline(result),
        [
            _effects_section(result),
            _channels_section(result),
            Section(heading="What to do next", points=gap_steps(result), code=result.code),
            warnings_section(result.graded_warnings),
            _overlay_section(solution),
            _residual_section(solution),
            _response_section(solution),
            _correlation_section(solution),
            _ranking_section(result),
            _identifiability_section(result.identifiability),
        ],
        kicker=[solution.answer.recording.folder.name, "model error"],
        text=summary_words(result),
        notes=[
            f"Held out: {held}. All numbers stand in result.json.",
            f"Settings: {settings}. Tolerances: {tolerances}.",
            f"{date.today().isoformat()}, loose-env {__version__}, {solution.seconds:.1f} s.",
        ],
    )


def gap_steps(result: GapResult) -> list[str]:
    """Recommended next steps."""
    steps = []
    if result.effects:
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
    for each in result.channels:
        if each.verdict in ("cannot tell", "unexplained") and each.advice:
            steps.append(f"{each.channel}, {each.verdict}: {each.advice}")
    if any(each.verdict == "unexplained" for each in result.channels):
        steps.append(
            "If you know the effect, add it: it is one small class in one file, and is fitted like "
            "those of the catalogue."
        )
    if result.pulled:
        steps.append(
            f"Check these figures of the model, which the data contradict: "
            f"{'; '.join(pulled_words(result)[:RIVALS])}"
        )
    if result.verdict == "no_gap":
        steps.append(
            "To look closer, record motions that strain what you suspect: slow and fast, with "
            "reversals, over the whole range, with and without load."
        )
    return [step if step.endswith(".") else f"{step}." for step in steps]


def _effects_section(result: GapResult) -> Section:
    """Named and doubtful effects with their parameters."""

    def cells(effect: NamedEffect) -> dict[str, str]:
        likely = "-" if effect.probability is None else f"{100 * effect.probability:.0f} %"
        values = []
        for name, value in effect.parameters.items():
            ends, unit = effect.interval_95.get(name), effect.units.get(name, "")
            between = "" if ends is None else f" ({ends[0]:.4g} to {ends[1]:.4g})"
            values.append(f"{name.replace('_', ' ')} {value:.4g}{between} {unit}".rstrip())
        return {
            "Missing effect": begun(effect_words(effect.kind, effect.where)),
            "Parameters": "; ".join(values),
            "Probability": likely,
            "Confusable with": ", ".join(rivals_words(effect)) or "-",
        }

    note = (
        "In brackets: 95 % intervals, as wide as the fit is uncertain, or as the stretches of the "
        "recording disagree. Probability: that the machine has the effect, or one that is "
        "confusable with it, among the sets of effects that were compared."
    )
    tables = [
        Table(title=title, rows=[cells(effect) for effect in effects], note=note * (not title))
        for title, effects in (("", result.effects), (_DOUBTFUL, result.doubtful))
    ]
    return Section(heading="What the model lacks", tables=[t for t in tables if t.rows])


def _channels_section(result: GapResult) -> Section:
    """One line for each joint and reading."""

    def words(each: ChannelVerdict) -> dict[str, str]:
        sides = [f"{v:.2f}" if isfinite(v) else "-" for v in (each.before, each.after)]
        return {
            "Joint or reading": each.channel.removeprefix("sensor."),
            "Verdict": each.verdict,
            "Effects": _kinds(each.effects) or "-",
            "Before": sides[0],
            "After": sides[1],
            "Advice": begun(each.advice) or "-",
        }

    note = (
        "Before, after: residual of the nominal model within its tolerances, and of the corrected "
        "one, on held-out data in noise standard deviations. Not needed: no further effect is. "
        "Cannot tell: one of these effects, and the motion that would tell which. Unexplained: "
        "much is left by everything that was tried."
    )
    tables = [Table(rows=[words(each) for each in result.channels], note=note)]
    pulled = [
        {"Tolerance": each.name, "Standard deviations": f"{each.deviations:+.1f}"}
        for each in result.pulled[:_ROWS]
    ]
    tables.append(Table(title="Pulled out of their tolerances", rows=pulled))
    return Section(heading="Joint by joint", tables=[table for table in tables if table.rows])


def _overlay_section(solution: GapSolution) -> Section:
    """Measured against model where most is left, joint by joint."""
    cards = []
    for each in solution.overlays:
        thin = slice(None, None, max(1, len(each.time) // _SAMPLES))
        lines = (each.time, each.measured, each.nominal, each.corrected)
        figure = overlay_figure(*(x[thin] for x in lines), channel=each.channel, unit=each.unit)
        cards.append(
            FigureCard(
                title=f"{each.channel.removeprefix('sensor.')} in {each.run}",
                image=figure,
                caption=f"{each.channel}: given, and by both models; below, the difference.",
            )
        )
    intro = (
        "The stretch in which the nominal model misses most, predicted from other data. Of a "
        "joint, given is the force of its drive, as measured, or as the model's drive makes it of "
        "commands and motion; a model shows the force that the measured motion takes in it. Of a "
        "reading, given is what was read, and a model shows what the motion foretells."
    )
    return Section(heading="Measured against model", intro=[intro], cards=cards)


def _residual_section(solution: GapSolution) -> Section:
    """Residuals by channel, and their correlation in time and with the motion."""
    result = solution.result
    pairs = sorted(result.gap.by_channel.items(), key=lambda item: -item[1][0])[:_BARS]
    cards = [
        FigureCard(
            title="Channel by channel",
            image=channel_bars(dict(pairs)),
            caption="Root mean square on held-out data over the noise: 1 is noise alone.",
        )
    ]
    cards += [
        FigureCard(
            title=f"Correlation of the residual of {each.channel.removeprefix('sensor.')}",
            image=correlation_figure(each),
            caption=f"With itself, and with the speed of {each.joint}, both whitened by the noise. "
            "Within the grey band (95 %) there is nothing left to model.",
        )
        for each in solution.correlations
    ]
    rows = [
        {
            "Joint or reading": test.channel.removeprefix("sensor."),
            "RMS / noise": f"{test.rms:.2f}",
            "Largest autocorrelation": f"{test.largest_autocorrelation:.2f}",
            "White below": f"{test.whiteness_95:.2f}",
            "Correlation time": "white" if test.white else f"{test.correlation_time:.2g} s",
        }
        for test in sorted(result.residual_tests, key=lambda t: -t.rms)
    ]
    quantities = [
        {"Error": key, "Nominal": f"{before:.3g}", "Corrected": f"{after:.3g}"}
        for key, (before, after) in result.gap.by_quantity.items()
    ]
    note = (
        "Torque and force: what is missing along the measured motion. Readings: simulations of one "
        "second from the measured state, between those that were fitted to or in the runs that "
        "were kept out, by the nominal model and by model.xml."
    )
    return Section(
        heading="Residual before and after",
        tables=[
            Table(title="In physical units", rows=quantities, note=note),
            Table(title="Residual of the corrected model", rows=rows),
        ],
        cards=cards,
    )


def _response_section(solution: GapSolution) -> Section:
    """Frequency responses of servoed joints."""
    cards = [
        FigureCard(
            title=f"{each.joint} over its command",
            image=response_figure(each.frequency, each.gains),
            caption="Cross spectrum over the power of the command, averaged over overlapping "
            "segments, where the command has at least a hundredth of its largest power.",
        )
        for each in solution.responses[:_RESPONSES]
    ]
    return Section(heading="Frequency response", cards=cards)


def _correlation_section(solution: GapSolution) -> Section:
    """Correlations of the coefficients of the effects."""
    names, values = solution.parameters
    if len(names) < 2:
        return Section()
    card = FigureCard(
        title="Correlation of the parameters",
        image=matrix_figure(names, values),
        caption="Posterior correlation of the effects' sizes beside all tolerances: near 1 or −1, "
        "only their sum or difference is known.",
    )
    return Section(heading="Parameters beside each other", cards=[card])


def _ranking_section(result: GapResult) -> Section:
    """Sets of effects that were compared, by their difference from the best."""
    best = set(result.ranking[0].effects) if result.ranking else set()

    def words(effects: Sequence[EffectLocation]) -> str:
        own = set(effects)
        sides = [("without", sorted(best - own, key=str)), ("with", sorted(own - best, key=str))]
        parts = [f"{word} {together(side, plain=False)}" for word, side in sides if side]
        return ", ".join(parts) or f"{len(own)} effects, the best" * bool(own) or "no effect"

    rows = [
        {
            "Set of effects": begun(words(each.effects)),
            "Behind": f"{each.behind:.1f}",
            "Probability": f"{100 * each.probability:.1f} %",
            "In simulation": "-" if each.simulated is None else f"{each.simulated:.1f}",
        }
        for each in result.ranking[:_ROWS]
    ]
    note = (
        "Behind: minus twice the log posterior probability above the best set's; 10 is very strong "
        "evidence. In simulation: the same by exact fits of the leading sets, which decide."
    )
    return Section(heading="Sets of effects compared", tables=[Table(rows=rows, note=note)])


def _identifiability_section(found: Identifiability) -> Section:
    """What these motions could show, and what to record for the rest."""
    joints = [
        {
            "Joint": each.joint,
            "Travel": f"{each.travel:.3g} {each.unit}",
            "Speed": f"{each.speed:.3g} {each.unit}/s",
            "Acceleration": f"{each.acceleration:.3g} {each.unit}/s²",
            "Compared": f"{100 * each.used:.0f} %",
        }
        for each in found.joints
    ]
    unseen = [
        {"Effect": _name(e), "Visible from": _size(e), "Record": begun(how_to_see(e.kind))}
        for e in found.effects
        if not e.visible
    ]
    alike = [
        {
            "Effect": _name(e),
            "Not told from": f"{e.confusable_with.kind} at {e.confusable_with.where}",
            "Record": how_to_separate(
                e.kind, e.where, e.confusable_with.kind, e.confusable_with.where
            ),
        }
        for e in found.effects
        if e.confusable_with is not None
    ]
    tables = [Table(title="Excitation", rows=joints)]
    for title, rows in (("Not visible at a usual size", unseen), ("Confusable", alike)):
        rest = f"{_ROWS} of {len(rows)}; all stand in result.json." if len(rows) > _ROWS else ""
        tables.append(Table(title=title, rows=rows[:_ROWS], note=rest))
    intro = (
        "Asked of the motion alone, before any effect was selected: the size from which each "
        "effect pays for its prior probability, beside all tolerances. Speed and acceleration: "
        "95th percentile. Compared: share of the time neither at rest nor knocked."
    )
    return Section(
        heading="What to record next", intro=[intro], tables=[t for t in tables if t.rows]
    )
