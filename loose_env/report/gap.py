"""Report of `loose gap` as text, HTML and page: what is missing, joint by joint, and how sure."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from loose_env.envs import FAINT, INK, MEASURED, MUTED, TRUTH
from loose_env.errors import MissingExtra
from loose_env.gap import (
    LARGE,
    ChannelVerdict,
    Correlation,
    EffectLocation,
    GapResult,
    GapSolution,
    Identifiability,
    NamedEffect,
    Overlay,
    Played,
    VisibleEffect,
    effect_words,
    how_to_see,
    how_to_separate,
    kind_words,
)
from loose_env.io import begun, write_text
from loose_env.report.figures import DASHED, labels, legend, panels, plain_log_ticks
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
    first_ones,
    percent,
    rivals_words,
    together,
)
from loose_env.typing import Array, ComplexArray
from loose_env.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEADLINE = 140  # letters of the effects in the headline
_OVERLAYS, _RESPONSES = 4, 4  # figures of measured against model, and of frequency responses
_STRETCH_S = 4.0  # length of simulated motion that is drawn
_SAMPLES = 500  # of an overlay
_CORRELATED = 0.8  # correlation of two parameters from which data hardly split them
_LIKELY = 0.01  # probability from which a set of effects is listed beside the best
_AT_NOISE = 1.5  # noise standard deviations of a residual that leave nothing to explain
_EFFECTS = ["missing effect", "kind", "probability", "value (95 % interval)", "or instead"]
_CHANNELS = ["joint or reading", "verdict", "effects", "explained", "before", "after"]
_DOUBTFUL = "Fitted, and not named"
_MORE = "named, more missing"
_PULLED = "Beyond its tolerance"
BEFORE, AFTER = TRUTH, MEASURED  # colours of the nominal and of the corrected model
_QUANTITIES = {"N·m": "torque", "N": "force", "rad": "position", "m": "position"}
_CAUTIONS = {
    "actuator_lag": "Before the first step fill the filter, data.act[model.actuator_actadr[k]], of "
    "{} with the first command: it begins at zero.",
    "command_delay": "Before the first step fill the buffer, mujoco.mj_initCtrlHistory, of {} with "
    "the first command: it begins at zero.",
    "sensor_delay": "Read {} in data.sensordata, for data.qpos is not late; before the first step "
    "fill its buffer, mujoco.mj_initSensorHistory, with the first reading: it begins at zero.",
}
"""Effects of model.xml that need care, by kind."""
_VERDICTS = {
    _MORE: "more than three noise standard deviations are left there.",
    "not needed": "within tolerances and noise the model is right.",
    "cannot tell": "one of these effects, or none.",
    "unexplained": "much is left by everything that was tried.",
}
"""Verdict of a joint or reading -> its meaning."""
_COMPARED = (
    "compared: share of the time in which a joint moves, is not knocked, and its drive is not at a "
    "limit; speed, acceleration: 95 % of the time at most this"
)
_UNIT = "before, after: residual on held-out data, in noise standard deviations (noise alone: 1)"


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
        if open_ := [each.channel for each in result.channels if each.verdict == "cannot tell"]:
            words = _channel_words(open_)
            return f"No model error found; the recording does not tell about {words}."
        return "No model error: the model explains the measurement."
    if result.verdict == "unexplained":
        if left:
            return f"Nothing tried explains {_channel_words(left)}."
        return "The recording cannot tell which effect is missing."
    more = [c.channel for c in result.channels if _verdict(c) == _MORE]
    words = together(result.effects)
    if len(words) > _HEADLINE:
        words = _by_joint(result)
    if more:
        named = [c.channel for c in result.channels if c.verdict == "named"]
        where = "each of them" if more == named and len(more) > 1 else _channel_words(more)
        words += f", and something more at {where} that nothing tried explains"
    if left:
        words += f"; {_channel_words(left)} {'is' if len(left) == 1 else 'are'} unexplained"
    return f"The model lacks {words}."


def _verdict(channel: ChannelVerdict) -> str:
    """Verdict of a joint or reading, with what is left where effects are named."""
    named = channel.verdict == "named"
    return _MORE if named and channel.after > LARGE else channel.verdict


def _by_joint(result: GapResult) -> str:
    """Named effects in words, joints that lack the same kinds together."""
    places: dict[frozenset[str], list[ChannelVerdict]] = {}
    for channel in result.channels:
        if channel.verdict == "named":
            places.setdefault(frozenset(e.kind for e in channel.effects), []).append(channel)
    return "; ".join(
        f"{_kinds(own[0].effects)} at {_channel_words([c.channel for c in own])}"
        for own in places.values()
    )


def _channel_words(names: Sequence[str]) -> str:
    """Names of joints and readings, or their number where they are many."""
    shown = list(map(_reading, names))
    return named_list(shown) if len(shown) < 8 else f"{len(shown)} joints and readings"


def not_in_model(result: GapResult) -> list[str]:
    """Named effects that model.xml lacks, and what applies them."""
    if not (apart := [each for each in result.effects if not each.in_model]):
        return []
    remedy = "apply the lines of code in result.json at each step" if result.code else "add them"
    alone = len(apart) == len(result.effects)
    same = " and simulates as the nominal one does" * alone
    return [f"model.xml lacks {together(apart)}{same}, for MJCF has no means for it: {remedy}"]


def _quantities(result: GapResult) -> list[str]:
    """Errors on held-out data in physical units: of the force balance, and of simulations."""
    found: dict[str, list[str]] = {}
    for key, (before, after) in result.gap.by_quantity.items():
        name, unit = key.rstrip("]").split(" [")
        balance = name in ("joint torque", "joint force")
        where = (
            "missing along the measured motion" if balance else "error of one-second simulations"
        )
        words = f"{name} {before:.3g} {unit} before, {after:.3g} {unit} after"
        if after > before and not balance and result.effects:
            words += ", worse: do not believe the effects before you know why"
        found.setdefault(where, []).append(words)
    return [f"{where}: {'; '.join(words)}" for where, words in found.items()]


def _brief(result: GapResult, *, warnings: bool) -> Brief:
    effects = [row for effect in result.effects for row in _effect_rows(effect)]
    return Brief(
        headline=gap_headline(result),
        parts=[
            ("", "  ", [_EFFECTS, *effects] if effects else []),
            ("", "  ", [_CHANNELS, *_channel_rows(result)]),
            ("Residual", "  ", [_UNIT, *_quantities(result)]),
            ("Not in model.xml", "", not_in_model(result)),
            (_PULLED, f"{_PULLED.lower()}: ", first_ones([each.words for each in result.pulled])),
            *(graded_parts(result.graded_warnings) if warnings else []),
        ],
    )


def _channel_rows(result: GapResult) -> list[list[str]]:
    """One row for each joint and reading, readings without an error in one, and all together."""
    fine = [c for c in result.channels if c.verdict == "not needed"]
    quiet = [c for c in fine if c.channel.startswith("sensor.")]
    quiet = quiet if len(quiet) > 1 else []
    tried = {(e.kind, e.where) for e in (*result.effects, *result.doubtful)}

    def kinds(c: ChannelVerdict) -> str:
        if c.verdict != "unexplained":
            return _kinds(c.effects)
        own = [e for e in c.effects if (e.kind, e.where) in tried]
        return f"not named: {_kinds(own)}" if own else ""

    rows = [
        [_reading(c.channel), _verdict(c), kinds(c), *_sides(c.before, c.after)]
        for c in result.channels
        if c not in quiet
    ]
    if quiet:
        most = max(c.before for c in quiet), max(c.after for c in quiet)
        rows.append([f"{len(quiet)} other readings", "not needed", "", *_sides(*most)])
    if len(rows) != 1:
        rows.append(["all together", "", "", *_sides(result.gap.before, result.gap.after)])
    return rows


def _sides(before: float, after: float) -> list[str]:
    """Share of a residual's power that is explained, and the residual before and after."""
    share = (percent(1 - (after / before) ** 2) if after < before else "0 %") * (before > _AT_NOISE)
    ends = (f"{v:.0f}" if abs(v) >= 1e3 else f"{v:.3g}" for v in (before, after))
    return [share, *(end.replace("nan", "-") for end in ends)]


def _reading(channel: str) -> str:
    """A channel as one says it."""
    return channel.removeprefix("sensor.")


def _kinds(effects: Sequence[EffectLocation]) -> str:
    """Kinds of effects at one joint, as one says them."""
    return named_list(list(dict.fromkeys(kind_words(e.kind) for e in effects)))


def _effect_rows(effect: NamedEffect) -> list[list[str]]:
    """Rows of an effect's parameters; the first names the effect."""
    likely = "" if effect.probability is None else percent(effect.probability)
    if effect.ambiguous_with and effect.probability_alone is not None:
        likely += f" (alone {percent(effect.probability_alone)})"
    name, rows = effect_words(effect.kind, effect.where), []
    if effect.mountings:  # another payload in some runs
        name += " in " + "; turned in ".join(", ".join(runs) for runs in effect.mountings)
    first = [name, effect.kind, likely]
    others = "; ".join(filter(None, [*rivals_words(effect), effect.note]))
    # less the directions that the motion does not excite
    still = {p for p, ends in effect.interval_95.items() if ends == (0.0, 0.0)}
    for parameter in [p for p in effect.parameters if p not in still] or effect.parameters:
        value = f"{parameter.replace('_', ' ')} {effect.value_in_words(parameter)}"
        rows.append([*first, value, others])
        first, others = [""] * len(first), ""
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
      joint or reading  verdict  effects  explained  before  after
      all together                                   1.04    1.04
      before, after: residual on held-out data, in noise standard deviations (noise alone: 1)
    """
    return _brief(result, warnings=warnings).text()


def gap_html(result: GapResult) -> str:
    """Result of `loose gap` as a fragment of HTML."""
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
    kinds: dict[str, list[VisibleEffect]] = {}
    for effect in found.effects:
        kinds.setdefault(effect.kind, []).append(effect)
    seen = [["effect", "smallest visible change", "not visible at"]]
    for kind, own in kinds.items():
        unseen = [e.where for e in own if not e.visible]
        places = "all of them" if len(unseen) == len(own) else ", ".join(unseen)
        seen.append([kind_words(kind), _sizes([e for e in own if e.visible]), places])
    wanted = [textwrap.fill(line, 120, subsequent_indent="  ") for line in _wanted(found.effects)]
    moved = [*aligned(_excitation(found)), textwrap.fill(_COMPARED, 120)]
    parts = [moved, aligned(seen), ["to record next, what tells most first:", *wanted]]
    return "\n\n".join("\n".join(part) for part in parts if len(part) > 1)


def _excitation(found: Identifiability) -> list[list[str]]:
    """How much each joint moves, headings first."""
    rows = [["joint", "travel", "speed", "acceleration", "compared"]]
    for each in found.joints:
        moved = zip((each.travel, each.speed, each.acceleration), ("", "/s", "/s²"), strict=True)
        units = [f"{x:.3g} {each.unit}{per}" for x, per in moved]
        rows.append([each.joint, *units, f"{100 * each.used:.0f} %"])
    return rows


def _sizes(effects: Sequence[VisibleEffect]) -> str:
    """Smallest visible sizes of one kind, from where most to where least shows, by unit."""
    found: dict[str, list[tuple[float, str]]] = {}
    for each in effects:
        first = next(iter(each.smallest), "")
        for name, value in each.smallest.items():
            if each.units.get(name) == each.units.get(first):
                found.setdefault(each.units.get(name, ""), []).append((value, name))
    words = []
    for unit, sizes in found.items():
        names = ", ".join(sorted({name.replace("_", " ") for _, name in sizes}))
        ends = dict.fromkeys(f"{size:.3g}" for size, _ in (min(sizes), max(sizes)))
        words.append(f"{names} {'below ' * effects[0].below}{' to '.join(ends)} {unit}".rstrip())
    return "; ".join(words)


def _wanted(effects: Sequence[VisibleEffect]) -> list[str]:
    """Motions that would show what these do not, or tell apart what these confuse, most first."""
    unseen: dict[str, dict[str, list[str]]] = {}
    for each in effects:
        if not each.visible:
            kinds = unseen.setdefault(how_to_see(each.kind), {})
            kinds.setdefault(each.kind, []).append(each.where)
    lines = [
        (
            sum(map(len, kinds.values())),
            f"To see {named_list([effect_words(k, named_list(w)) for k, w in kinds.items()])}: "
            f"{advice}.",
        )
        for advice, kinds in unseen.items()
    ]
    alike = [(e, e.confusable_with) for e in effects if e.visible and e.confusable_with]
    lines += _separating("tell", alike, lambda e: kind_words(e.kind))
    return [words for _, words in sorted(lines, key=lambda line: -line[0])]


def _separating(
    verb: str,
    pairs: Iterable[tuple[EffectLocation, EffectLocation]],
    words: Callable[[EffectLocation], str],
) -> list[tuple[int, str]]:
    """Motions that tell pairs of effects apart, each motion and each pair once, with their number.

    Of several pairs with one effect in common that stands before the others.
    """
    found: dict[str, list[frozenset[str]]] = {}
    for one, other in pairs:
        advice = how_to_separate(one.kind, one.where, other.kind, other.where)
        said = frozenset(map(words, (one, other)))
        if one.kind == other.kind:  # of the same words
            said = frozenset(effect_words(e.kind, e.where) for e in (one, other))
        own = found.setdefault(advice[:1].lower() + advice[1:], [])
        own += [said] * (said not in own)
    lines = []
    for advice, own in found.items():
        counts, groups = Counter(name for pair in own for name in pair), dict[str, list[str]]()
        for pair in own:
            head, *rest = sorted(pair, key=lambda name: (-counts[name], name))
            groups.setdefault(head, []).extend(rest)
        told = "; ".join(f"{head} from {named_list(rest)}" for head, rest in groups.items())
        lines.append((len(own), f"To {verb} {told}: {advice}"))
    return lines


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
    except Exception as error:  # whatever a page fails by, model and result do not need it
        kind = "" if isinstance(error, MissingExtra) else f"{type(error).__name__}: "
        say(f"no report.html: {kind}{error}")
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
    given = {k: v for k, v in result.settings.items() if v not in ((), [], None)}
    tolerances = ", ".join(f"{k} {v:g}" for k, v in given.pop("tolerances", {}).items())
    settings = ", ".join(f"{k} {v}" for k, v in given.items())
    held = ", ".join(result.held_out_runs) or "every run, or every other stretch, once in turn"
    return render_page(
        gap_headline(result),
        [
            _effects_section(solution),
            _channels_section(solution),
            Section(heading="What to do next", points=gap_steps(result), code=result.code),
            warnings_section(result.graded_warnings),
            _overlay_section(solution),
            _residual_section(solution),
            _response_section(solution),
            _motions_section(result),
        ],
        kicker=[solution.answer.recording.folder.name, "model error"],
        text=[f"{begun(words)}." for words in _quantities(result)],
        notes=[
            f"Held out: {held}. All numbers stand in result.json.",
            f"Settings: {settings}. Tolerances: {tolerances}.",
            f"{date.today().isoformat()}, loose-env {__version__}, {solution.seconds:.1f} s.",
        ],
    )


def gap_steps(result: GapResult) -> list[str]:
    """Recommended next steps."""
    steps = []
    lost = not_in_model(result)
    if any(each.in_model for each in result.effects):
        said = "It is a plain MJCF file, and the recording's columns are valid in it"
        beside = f" and the lines below: {lost[0]}." if lost else f". {said}."
        steps.append(f"Simulate with model.xml{beside}")
    elif lost:
        steps.append(f"Simulate with the lines below: {lost[0]}.")
    for kind, words in _CAUTIONS.items():
        if own := [e.where for e in result.effects if e.kind == kind and e.in_model]:
            steps.append(words.format(named_list(own)))
    if result.effects:
        steps.append(
            "loose export takes the effects to mujoco.sysid, mjlab, Isaac Lab, URDF, USD or BAM, "
            "and lists what these cannot express: loose export --help"
        )
    if any(each.verdict == "unexplained" for each in result.channels):
        steps.append(
            "If you know the effect, add it: one small class in a file that is given as --effects "
            "FILE.py is fitted like those of the catalogue; loose_env.gap.register says how."
        )
    if result.pulled:
        steps.append(
            "Check these figures of the model, which the data pull beyond their tolerances and "
            f"model.xml keeps: {'; '.join(first_ones([each.words for each in result.pulled]))}"
        )
    if result.verdict == "no_gap":
        steps.append(
            "To look closer, record motions that strain what you suspect: slow and fast, with "
            "reversals, over the whole range, with and without load."
        )
    return [step if step.endswith(".") else f"{step}." for step in steps]


def gap_motions(result: GapResult) -> list[str]:
    """Motions to record for what is open: confusable effects, and joints that are not explained."""
    alike = [(e, other) for e in result.effects for other in e.ambiguous_with[:RIVALS]]
    motions = [
        m for _, m in _separating("separate", alike, lambda e: effect_words(e.kind, e.where))
    ]
    left = [c for c in result.channels if c.verdict in ("unexplained", "cannot tell")]
    motions += [
        f"{_reading(c.channel)}, {c.verdict}: {c.advice.rstrip('.')}."
        for c in left
        if c.advice and c.verdict == "cannot tell"
    ]
    places = {c.channel for c in left} | {e.where for c in left for e in c.effects}
    return motions + _wanted([e for e in result.identifiability.effects if e.where in places])


def _effects_section(solution: GapSolution) -> Section:
    """Named and doubtful effects with their parameters and strong correlations."""
    result = solution.result

    def cells(effect: NamedEffect) -> dict[str, str]:
        names, kinds, likely, values, others = zip(*_effect_rows(effect), strict=True)
        first = [begun(names[0]), kinds[0], likely[0] or "-", "; ".join(values), others[0] or "-"]
        row = dict(zip(map(begun, _EFFECTS), first, strict=True))
        if not effect.doubt:
            return row
        return {k: row[k] for k in row if k not in ("Probability", "Or instead")} | {
            "Not named because": effect.doubt
        }

    note = (
        "Probability: that the machine has the effect or, in its place, one of those under 'or "
        "instead', if the catalogue has all that is missing there; alone: this very one. Where a "
        "joint stays far above the noise (after, in the next table), something else is missing "
        "too, and probabilities and intervals say less. Interval: as wide as the fit is uncertain, "
        "or as the stretches of the recording disagree. Not determined: it reaches an end of what "
        "is possible, or spans a factor of ten. Kind: its name in --kinds and result.json."
    )
    names, (_, values) = list[str](), solution.parameters
    for term in solution.answer.decision.fit.terms:
        own = [p.name.replace("_", " ") for p in term.effect.parameters]
        if len(own) != len(term.columns):  # directions that the motion tells apart
            own = [f"direction {k + 1}" for k in range(len(term.columns))]
        names += [f"{effect_words(*term.name)}{f', {each}' * (len(own) > 1)}" for each in own]
    pairs = [(values[i, k], names[i], names[k]) for i in range(len(names)) for k in range(i)]
    strong = sorted((p for p in pairs if abs(p[0]) >= _CORRELATED), key=lambda p: -abs(p[0]))
    sure = {True: "their sum is sure, their split is not", False: "their difference is sure"}
    correlated = [
        {"Parameter": one, "And": other, "Correlation": f"{value:.2f}", "Hence": sure[value < 0]}
        for value, one, other in strong
    ]
    sets = [
        {"Set": begun(together(each.effects) or "none"), "Probability": percent(each.probability)}
        for each in result.ranking
        if each.probability > _LIKELY
    ]
    tables = [
        Table(rows=_filled([cells(effect) for effect in result.effects]), note=note),
        Table(title=_DOUBTFUL, rows=_filled([cells(effect) for effect in result.doubtful])),
        Table(title="Correlated parameters", rows=correlated),
        Table(title="Sets of effects that explain about as much", rows=sets * (len(sets) > 1)),
    ]
    return Section(heading="What the model lacks", tables=tables)


def _channels_section(solution: GapSolution) -> Section:
    """One line for each joint and reading."""
    result, fitted = solution.result, "the named effects alone"
    if solution.answer.decision.simulated and result.doubtful:
        fitted = "all that was fitted in simulation, named or not"
    left = {_reading(c.channel): c.advice for c in result.channels if c.verdict != "cannot tell"}
    rows = [
        {begun(head): cell or "-" for head, cell in zip(_CHANNELS, row, strict=True)}
        | {"What is left": left.get(row[0]) or "-"}
        for row in _channel_rows(result)
    ]
    said = {_verdict(c) for c in result.channels}
    meanings = (f"{begun(word)}: {means}" for word, means in _VERDICTS.items() if word in said)
    note = (
        f"{begun(_UNIT)}. Before: the nominal model within its tolerances; after: with "
        f"{fitted}. Explained: share of the squared residual that they remove. {' '.join(meanings)}"
    )
    return Section(heading="Joint by joint", tables=[Table(rows=_filled(rows), note=note)])


def _filled(rows: Sequence[Mapping[str, str]]) -> list[dict[str, str]]:
    """Rows without the columns in which none of them has a word."""
    said = {name for row in rows for name, cell in row.items() if cell != "-"}
    return [{name: cell for name, cell in row.items() if name in said} for row in rows]


def _played_overlays(played: Played) -> list[Overlay]:
    """Positions of each joint where the simulated nominal model misses most."""
    found = []
    for joint in played.machine.joints:
        if (own := played.column_of(joint)) is None:  # taken as the nominal model moves it
            continue
        unit, pieces = "rad" if played.machine.turns(joint) else "m", []
        models = zip(played.nominal, played.corrected, strict=True)
        for trial, begin, both in zip(played.trials, played.begins, models, strict=True):
            length = max(int(_STRETCH_S * trial.rate), 1)
            for first in range(0, len(trial.time), length):
                rows = slice(first, first + length)
                measured, nominal, corrected = (x[rows, own] for x in (trial.measured, *both))
                pieces.append(
                    Overlay(
                        channel=joint, run=trial.name, unit=unit,
                        time=begin + trial.time[rows], measured=measured,
                        nominal=nominal, corrected=corrected,
                    )
                )  # fmt: skip
        off = [float(np.mean(np.nan_to_num(o.measured - o.nominal) ** 2)) for o in pieces]
        found.append(pieces[int(np.argmax(off))])
    return found


def _overlay_section(solution: GapSolution) -> Section:
    """Measured against model where most is left, joint by joint."""
    played = solution.played if solution.answer.decision.simulated else None
    shown = solution.overlays if played is None else _played_overlays(played)
    fine = [c.channel for c in solution.result.channels if c.verdict == "not needed"]
    order = [c.channel for c in solution.result.channels]
    cards = []
    for each in sorted(shown[:_OVERLAYS], key=lambda own: order.index(own.channel)):
        compared = np.isfinite(each.corrected)
        if each.channel in fine or not compared.any():
            continue
        thin = slice(None, None, max(1, len(each.time) // _SAMPLES))
        models = [np.where(compared, x, np.nan) for x in (each.nominal, each.corrected)]
        lines = (each.time, each.measured, *models)
        figure = overlay_figure(*(x[thin] for x in lines), unit=each.unit)
        off = [float(np.sqrt(np.nanmean((each.measured - x) ** 2))) for x in models]
        unit = "" if each.unit == "as recorded" else f" {each.unit}"
        cards.append(
            FigureCard(
                title=f"{_reading(each.channel)} in {each.run}",
                image=figure,
                caption=f"The nominal model is off by {off[0]:.3g}{unit}, the corrected one by "
                f"{off[1]:.3g}{unit} (root mean square).",
            )
        )
    which = "The few seconds in which the nominal model is most wrong, of the worst channels."
    if played is not None:
        how = (
            "Both models follow the recorded commands from the beginning of the run. The corrected "
            "one has the named effects alone."
        )
    else:
        how = (
            "Of a joint: the force of its drive (measured, or computed from commands and motion) "
            "against the force that each model needs for the same motion, each within its "
            "tolerances and fitted to other data. The corrected model has the named effects alone. "
            "Lines break where nothing is compared: at rest, where dry friction takes any value, "
            "at knocks, and at a drive's limit."
        )
    return Section(heading="Measured against model", intro=[f"{which} {how}"], cards=cards)


def _residual_section(solution: GapSolution) -> Section:
    """Correlation of the residuals in time and with the motion."""
    if solution.answer.decision.simulated:  # of forces, which did not decide
        return Section()
    white = [test.channel for test in solution.result.residual_tests if test.white]
    cards = [
        FigureCard(
            title=_reading(each.channel),
            image=correlation_figure(each),
            caption=f"Correlation of the residual with itself, and with the speed of {each.joint}.",
        )
        for k, each in enumerate(solution.correlations)
        if k == 0 or each.channel not in white
    ]
    intro = (
        "Whether the residual of the corrected model is noise: its correlation with itself, and "
        "with the joint's speed, a time lag later. Noise alone stays within the grey band (95 %); "
        "what stands out is still missing in the model."
    )
    return Section(heading="Correlation of the residual", intro=[intro], cards=cards)


def _response_section(solution: GapSolution) -> Section:
    """Frequency responses of servoed joints."""
    cards = [
        FigureCard(
            title=each.joint,
            image=response_figure(each.frequency, each.gains),
            caption=f"Position of {each.joint} over its command.",
        )
        for each in solution.responses[:_RESPONSES]
    ]
    intro = (
        "How a joint follows its command: size (gain) and lateness (phase) of its motion, measured "
        "and simulated from the same commands, at the frequencies that the command contains."
    )
    return Section(heading="Frequency response", intro=[intro], cards=cards)


def _motions_section(result: GapResult) -> Section:
    """Excitation, and what to record for what is open."""
    heads, *rows = _excitation(result.identifiability)
    points = gap_motions(result)
    more = [c.channel for c in result.channels if _verdict(c) in (_MORE, "unexplained")]
    open_ = "No effect or joint is open. "
    if more:
        open_ = f"No motion is known that tells what is missing at {_channel_words(more)}. "
    note = (
        f"{begun(_COMPARED)}. "
        f"{'Below: motions for what is open. ' if points else open_}"
        "'loose gap RECORDING --check' prints from what size each effect would show, and what else "
        "these motions cannot show or tell apart."
    )
    excitation = [dict(zip(map(begun, heads), row, strict=True)) for row in rows]
    return Section(
        heading="What to record next",
        tables=[Table(title="How the joints moved", rows=excitation, note=note)],
        points=points,
    )


# Figures


def overlay_figure(
    time: Array, measured: Array, nominal: Array, corrected: Array, *, unit: str
) -> Figure:
    """Measured, nominal and corrected values (N,) over time, and the residual of each model."""
    figure, (top, low) = panels(2, 1.8)
    top.plot(time, measured, ".", color=MUTED, markersize=3.2, label="measured")
    for values, label, colour, line in (
        (nominal, "nominal", BEFORE, DASHED),
        (corrected, "corrected", AFTER, "-"),
    ):
        look: dict[str, Any] = {"color": colour, "linestyle": line, "linewidth": 1.4}
        top.plot(time, values, label=label, **look)
        low.plot(time, measured - values, **look)
    for axes in (top, low):
        axes.set_xlim(time[0], time[-1])
    low.ticklabel_format(axis="y", scilimits=(-2, 3), useMathText=True)
    top.tick_params(labelbottom=False)
    labels(top, above=f"{_QUANTITIES.get(unit, 'reading')} [{unit}]")
    labels(low, x="time [s]", above=f"measured less model [{unit}]")
    low.title.set_position((0.12, 1.0))
    legend(figure, top)
    return figure


def correlation_figure(given: Correlation) -> Figure:
    """Autocorrelation and cross-correlation of a residual by lag, with a 95 % band."""
    figure, axes = panels(2, 1.5)
    interval, band = given.interval, given.band
    parts = ((given.own, "with itself"), (given.other, f"with the speed of {given.joint}"))
    for each, (values, words) in zip(axes, parts, strict=True):
        lag = np.arange(len(values)) * interval
        each.axhspan(-band, band, color=FAINT, alpha=0.6, linewidth=0)
        each.vlines(lag, 0, values, color=AFTER, linewidth=1.6)
        each.set_xlim(-0.5 * interval, lag[-1] + 0.5 * interval)
        reach = max(1.2 * float(np.max(np.abs(values[1:]), initial=0.0)), 2.5 * band)
        each.set_ylim(-min(reach, 1.05), min(reach, 1.05))
        labels(each, above=words)
    labels(axes[-1], x="lag [s]")
    return figure


def response_figure(frequency: Array, gains: Mapping[str, ComplexArray]) -> Figure:
    """Gain and phase of a frequency response, measured and of both models."""
    figure, (top, low) = panels(2, 1.7, grid="both")
    looks: dict[str, dict[str, Any]] = {
        "measured": {"color": INK, "marker": ".", "linestyle": "", "markersize": 4},
        "nominal": {"color": BEFORE, "linestyle": DASHED, "linewidth": 1.4},
        "corrected": {"color": AFTER, "linestyle": "-", "linewidth": 1.6},
    }
    for name, values in gains.items():
        top.plot(frequency, np.abs(values), label=name, **looks[name])
        low.plot(frequency, np.degrees(np.unwrap(np.angle(values))), **looks[name])
    for axes in (top, low):
        axes.set_xscale("log")
        plain_log_ticks(axes, "x")
    labels(top, above="gain")
    labels(low, x="frequency [Hz]", above="phase [°]")
    legend(figure, top)
    return figure
