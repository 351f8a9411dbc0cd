"""Report of a comparison of agents: tables as text, page, figures, timeline of one episode."""

from __future__ import annotations

import math
import os
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm
from loose_env.envs import (
    INK,
    MUTED,
    DiagnosisSettings,
    EnvBatch,
    Picture,
    fault_words,
    hypothesis_words,
)
from loose_env.evaluation import Interval, Row, Standing, by_agent, reliability, standings
from loose_env.faults import SEVERAL_FAULTS, UNSURE, place_of
from loose_env.io import write_text
from loose_env.report.figures import (
    DASHED,
    MARKERS,
    agent_colours,
    ink_on,
    labels,
    legend,
    new_figure,
    panels,
    percent_ticks,
    quiet_axes,
)
from loose_env.report.outcomes import (
    RATIO_EDGES,
    Division,
    calibration_of,
    claims_of,
    crossing,
    divisions,
    pareto_front,
    ratio_names,
    runs_of,
    success_after,
    trained_agents,
    who_won,
)
from loose_env.report.page import FigureCard, Section, Table, paragraphs, render_page, to_svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MATRICES = 6  # confusion matrices on the page; more are hard to take in
_MISTAKES = 5  # kinds of mistakes in the text
_ENOUGH = 250  # predictions behind a full marker of a reliability diagram
_SAMPLING = (
    "Interquartile mean over trainings with stratified bootstrap intervals (Agarwal et al., "
    "NeurIPS 2021)."
)


# Tables


def _main_table(found: Sequence[Standing], reference: str | None) -> Table:
    """One row an agent; the last column is shorter where it does not fit the terminal."""
    whole = _standings_table(found, reference, compact=False)
    lines = replace(whole, note="").text()
    return _standings_table(found, reference, compact=True) if "\n\n" in lines else whole


def _standings_table(found: Sequence[Standing], reference: str | None, *, compact: bool) -> Table:
    unsure = any(s.unsure for s in found)
    heads = ["agent", "accuracy\n% (95 %)", "loca-\ntion %", "false\nalarms", "missed\nfaults"]
    heads += ["unsure\n%"] * unsure + ["poses", "records", "time\ns", "return"]
    over = "over reference" if compact else "over reference\n(95 %)"
    heads += [over] * (reference is not None)
    rows = []
    for s in found:
        row = {
            "Agent": s.agent,
            "Accuracy [%] (95 %)": f"{100 * s.success:.1f} ({100 * s.low:.1f}-{100 * s.high:.1f})",
            "Location [%]": _share(s.link_success),
            "False alarms [%]": _share(s.false_alarms),
            "Missed faults [%]": _share(s.misses),
            **({"Unsure [%]": _share(s.unsure)} if unsure else {}),
            "Poses": f"{s.poses:.2f}",
            "Records": f"{s.records:.2f}"
            + ("" if s.records_interval is None else f" ±{s.records_interval.half:.2f}"),
            "Time [s]": f"{s.seconds:.2f}",
            "Return": f"{s.reward:+.3f}",
        }
        if reference is not None:
            lead = _over(s.lead, compact=compact)
            row["Over reference"] = "reference" if s.agent == reference else lead
        rows.append(row)
    note = (
        "accuracy: verdicts equal to the hidden fault, with Wilson's 95 % interval; location: "
        "verdicts with its link or joint; false alarms: healthy arms called faulty [%]; missed "
        "faults: faulty arms called healthy [%]; poses, records, time of excitation and return: "
        "means over all episodes; ±: half the 95 % bootstrap interval."
    )
    if reference is not None:
        note += (
            f" Last column: return less that of {reference} on the same arms, with its paired "
            "bootstrap interval."
        )
    return Table(rows=rows, heads=heads, note=note)


def _over(lead: Interval | None, *, compact: bool) -> str:
    if lead is None:
        return ""
    ends = f"±{lead.half:.3f}" if compact else f"({lead.low:+.3f}, {lead.high:+.3f})"
    return f"{lead.estimate:+.3f} {ends}"


def _crossed_table(found: Sequence[Standing]) -> list[Table]:
    """Estimators crossed with policies, where the agents are such."""
    crossed = crossing(found)
    estimators = dict.fromkeys(s.agent.partition("/")[0] for s in found if "/" in s.agent)
    rows = [
        {"policy": policy}
        | {
            e: f"{100 * s.success:.1f} / {s.records:.2f} / {s.reward:+.3f}" if s else "-"
            for e, s in ((e, cells.get(e)) for e in estimators)
        }
        for policy, cells in crossed.items()
    ]
    title = "Policies (lines) and estimators (columns): accuracy [%] / mean records / mean return"
    return [Table(rows=rows, title=title)] if rows else []


def _division_table(division: Division) -> Table:
    """Accuracy and mean records in each group of one division."""
    counts = [cell.episodes for cell in next(iter(division.cells.values()))]
    groups = list(zip(division.groups, counts, strict=True))
    rows = []
    for agent, cells in division.cells.items():
        shown = [
            "-" if math.isnan(c.success) else f"{100 * c.success:.1f} / {c.records:.2f}"
            for c in cells
        ]
        columns = [f"{name} ({count} arms)" for name, count in groups]
        rows.append({"Agent": agent, **dict(zip(columns, shown, strict=True))})
    heads = ["agent\narms", *(f"{name}\n{count}" for name, count in groups)]
    title = f"By {division.heading}: accuracy [%] / mean records"
    return Table(rows=rows, title=title, heads=heads)


def _curve_table(curves: Mapping[str, Sequence[float]]) -> list[Table]:
    """Accuracy after record 1, 2, ... of agents that may not stop."""
    most = max(map(len, curves.values()), default=0)
    rows = []
    for agent, curve in sorted(curves.items(), key=lambda pair: -pair[1][-1]):
        shares = [*map(_share, curve), *[""] * (most - len(curve))]
        rows.append({"agent": agent} | {str(k): share for k, share in enumerate(shares, 1)})
    title = "Accuracy [%] after so many records, without stopping"
    return [Table(rows=rows, title=title)] if curves else []


def _calibration_table(rows: Sequence[Row]) -> list[Table]:
    """Calibration of the agents that have probabilities."""
    every = [calibration_of(a, own, edges=RATIO_EDGES) for a, own in by_agent(rows).items()]
    found = [each for each in every if each is not None]
    if not found:
        return []
    last = len(found[0].by_record)
    columns = ["ECE", "verdict", "log score", *(f"rec. {k}" for k in range(1, last)), f"{last}+"]
    columns += [n.replace("below ", "<").replace("above ", ">") for n in ratio_names()]
    lines = []
    for c in found:
        errors = ["-" if math.isnan(e) else f"{e:.3f}" for e in (*c.by_record, *c.by_ratio)]
        cells = [f"{c.error:.3f}", f"{c.at_verdict:.3f}", f"{c.score:.3f}", *errors]
        lines.append({"agent": c.agent, **dict(zip(columns, cells, strict=True))})
    note = (
        "ECE: expected calibration error of the best hypothesis after every record; then at the "
        "verdicts; log score: mean ln of the truth's probability there; then the error after "
        "record 1, 2, ... and by seat drive over friction (faulty arms). No agent sees the "
        "friction: sorted by it even the exact posterior is off."
    )
    return [Table(rows=lines, title="Calibration", note=note)]


def _trainings_table(rows: Sequence[Row], rng: np.random.Generator | None) -> list[Table]:
    """Interquartile means of agents that were trained several times."""
    runs = trained_agents(by_agent(rows))
    if rng is None or not runs:
        return []
    lines = [
        {
            "agent": agent,
            "trainings": str(len(runs[agent])),
            "accuracy [%] (95 %)": _range(by["success"], 100, 1),
            "records (95 %)": _range(by["records"], 1, 2),
            "return (95 %)": _range(by["reward"], 1, 3),
        }
        for agent, by in runs_of(rows, rng=rng).items()
    ]
    return [Table(rows=lines, title="Several trainings", note=_SAMPLING)]


def _share(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.1f}"


def _range(i: Interval, scale: float, digits: int) -> str:
    low, high = (f"{scale * end:.{digits}f}" for end in (i.low, i.high))
    return f"{scale * i.estimate:.{digits}f} ({low} to {high})"


def _mistakes(agent: str, rows: Sequence[Row]) -> str:
    """The most frequent confusions of an agent; empty if it made no mistake."""
    wrong = Counter(
        (str(row["truth"]), row["verdict"]) for row in rows if row["verdict"] != row["truth"]
    )
    said = [
        f"{truth} {'without a verdict' if named is None else f'taken for {named}'} ({count})"
        for (truth, named), count in wrong.most_common(_MISTAKES)
    ]
    words = f"Most frequent mistakes of {agent}: {'; '.join(said)}."
    return textwrap.fill(words, 100) if said else ""


def comparison_text(
    rows: Sequence[Row],
    forced: Sequence[Row] = (),
    *,
    rng: np.random.Generator,
    reference: str | None = None,
    said: Sequence[str] = (),
) -> str:
    """Write the tables of a comparison, at most 120 columns wide.

    Parameters
    ----------
    rows : sequence of Row
        Episodes of all agents.
    forced : sequence of Row
        Episodes of agents that were made to take all records; calibration is computed on these
        where there are any, for then no record is missing because an agent was sure.
    rng : numpy.random.Generator
        Draws the bootstrap.
    reference : str, optional
        Agent whose return the others' is compared with.
    said : sequence of str
        Lines below the first table, such as a bound on records.
    """
    found = standings(rows, reference=reference, rng=rng)
    further = [
        *_crossed_table(found),
        *map(_division_table, divisions(rows)),
        *_curve_table(success_after(forced)),
        *_calibration_table(forced or rows),
        *_trainings_table(rows, rng),
    ]
    parts = [_main_table(found, reference).text(), *said, *(table.text() for table in further)]
    parts.append(_mistakes(found[0].agent, by_agent(rows)[found[0].agent]))
    diverged = Counter(str(row["truth"]).partition("@")[0] for row in rows if row["truncated"])
    if diverged:
        parts.append(f"Episodes ended by a diverging simulation: {dict(diverged)}")
    return "\n\n".join(part for part in parts if part)


# Page


@dataclass(frozen=True, kw_only=True, eq=False)
class EpisodeTimeline:
    """Figures and outcome of one episode."""

    cards: tuple[FigureCard, ...]
    """The first pose, every record and the end, in order."""
    words: str
    """The outcome in a sentence."""


def episode_timeline(
    agent: Any, arm: Arm, settings: DiagnosisSettings, *, seed: int, number: int = 0
) -> EpisodeTimeline:
    """Run an episode with an agent and draw each step.

    Parameters
    ----------
    agent : object
        The agent: stable-baselines3's ``predict``.
    arm : Arm
        The nominal arm.
    settings : DiagnosisSettings
        Settings of the environment.
    seed, number : int
        Index of the episode: the same one as that of a comparison with this seed.
    """
    batch = EnvBatch(arm, settings, threads=1)
    picture = Picture(batch.nominal, sensors=settings.sensors)
    batch.start(0, seed=seed, number=number)
    episode = batch.episode(0)
    cards = [FigureCard(image=to_svg(picture.figure(episode)), caption="The first pose")]
    state: Any = None
    info: dict[str, Any] = {}
    while not episode.ended:
        actions, state = agent.predict(
            batch.observe(0)[None], state, np.array([episode.records == 0]), deterministic=True
        )
        info = batch.step([0], [np.asarray(actions)[0]]).info(0)
        episode = batch.episode(0)
        if not episode.ended:
            caption = f"Record {episode.records}"
            cards.append(FigureCard(image=to_svg(picture.figure(episode)), caption=caption))
    verdict, truth = info["verdict"], fault_words(episode.fault)
    last = picture.figure(episode, verdict=verdict)
    cards.append(FigureCard(image=to_svg(last), caption="Verdict and truth"))
    mark = "Correct." if verdict == info["fault"] else f"Wrong; the truth: {truth}."
    if verdict == UNSURE:
        mark = f"The truth: {truth}."
    spent = f"After {episode.records} record{'' if episode.records == 1 else 's'}"
    said = "there was no verdict"
    if verdict is not None:
        said = f"the verdict was: {hypothesis_words(verdict)}"
    return EpisodeTimeline(cards=tuple(cards), words=f"{spent} {said}. {mark}")


def write_comparison(
    path: str | os.PathLike[str],
    rows: Sequence[Row],
    *,
    title: str,
    played: str | Sequence[str],
    chance: float | None = None,
    forced: Sequence[Row] = (),
    reference: str | None = None,
    rng: np.random.Generator | None = None,
    said: Sequence[str] = (),
    timeline: EpisodeTimeline | None = None,
    timeline_agent: str = "",
    notes: str | Sequence[str] = (),
) -> Path:
    """Write the page of a comparison: text, tables, figures, episode timeline.

    Parameters
    ----------
    path : path-like
        Path of the page.
    rows : sequence of Row
        Episodes of all agents.
    title : str
        Title of the page.
    played : str or sequence of str
        Settings of the comparison; the outcome is added below.
    chance : float, optional
        Success rate of a blind guess [1].
    forced : sequence of Row
        Episodes of agents that were made to take all records.
    reference : str, optional
        Agent whose return the others' is compared with.
    rng : numpy.random.Generator, optional
        Draws the bootstrap; without it there are no intervals of records and return.
    said : sequence of str
        Further paragraphs below the outcome, such as a bound on records.
    timeline : EpisodeTimeline, optional
        One episode, from `episode_timeline`.
    timeline_agent : str
        Who played it.
    notes : str or sequence of str
        Paragraphs at the foot of the page: how to make it again.

    Returns
    -------
    Path
        The file written.
    """
    found = standings(rows, reference=reference, rng=rng)
    best, *rest = who_won(rows)
    colours = agent_colours(list(by_agent(rows)))
    sections = [
        Section(tables=[_main_table(found, reference)]),
        _accuracy(rows, forced, found, colours, chance),
        Section(heading="Estimator and choice of poses", tables=_crossed_table(found)),
        _strata(rows, colours),
        _calibration(forced or rows, colours),
        Section(heading="Variation over training seeds", tables=_trainings_table(rows, rng)),
        _confusion(rows, found, colours),
        _timeline(timeline, timeline_agent),
    ]
    page = render_page(
        title,
        sections,
        text=paragraphs(played),
        result=[best, *([" ".join(rest)] if rest else []), *said],
        notes=notes,
        colours=colours,
    )
    return write_text(Path(path), page)


def _accuracy(
    rows: Sequence[Row],
    forced: Sequence[Row],
    found: Sequence[Standing],
    colours: Mapping[str, str],
    chance: float | None,
) -> Section:
    curves, lines = success_after(forced), "accuracy after so many records, without stopping"
    if not curves:
        curves, lines = _stopped(rows), "correct verdicts after at most so many records"
    cards = [
        FigureCard(
            image=success_bars(rows, colours, chance),
            caption="Share of arms with a correct verdict, with its 95 % interval.",
        ),
        FigureCard(
            image=success_and_records(found, curves, colours),
            caption="Accuracy against mean records; upright lines are 95 % intervals. Lines: "
            f"{lines}. The dashed line is the Pareto front.",
        ),
    ]
    return Section(heading="Accuracy", cards=cards, tables=_curve_table(success_after(forced)))


def _stopped(rows: Sequence[Row]) -> dict[str, list[float]]:
    """Share of correct verdicts after at most 1, 2, ... records of each agent."""
    most = max(int(row["records"]) for row in rows)
    found = {}
    for agent, own in by_agent(rows).items():
        right = np.array([int(row["records"]) for row in own if row["success"]])
        found[agent] = [float(np.sum(right <= k)) / len(own) for k in range(1, most + 1)]
    return found


def _strata(rows: Sequence[Row], colours: Mapping[str, str]) -> Section:
    many = divisions(rows)
    cards = [
        FigureCard(
            image=success_by_group(division, colours),
            caption=f"Accuracy by {division.heading}, with 95 % intervals.",
        )
        for division in many
    ]
    tables = [_division_table(division) for division in many]
    return Section(heading="Accuracy by stratum", tables=tables, cards=cards)


def _calibration(rows: Sequence[Row], colours: Mapping[str, str]) -> Section:
    tables = _calibration_table(rows)
    if not tables:
        return Section()
    card = FigureCard(
        image=reliability_curves(rows, colours),
        caption="Accuracy by predicted probability. The dashed line is perfect calibration; below "
        "it the agent is overconfident. Small marks stand for few predictions.",
    )
    intro = (
        "After every record the best hypothesis has a probability. Of all predictions with a "
        "probability of 80 %, 80 % should be correct. The expected calibration error is the mean "
        "distance from that; 0 is perfect."
    )
    tables = [replace(tables[0], title="")]
    return Section(heading="Calibration", intro=[intro], tables=tables, cards=[card])


def _confusion(
    rows: Sequence[Row], found: Sequence[Standing], colours: Mapping[str, str]
) -> Section:
    names, own = ordered_hypotheses(rows), by_agent(rows)
    cards = [
        FigureCard(
            title=s.agent,
            image=confusion_matrix(own[s.agent], names, colours[s.agent]),
            caption=f"Confusion matrix of {s.agent}",
        )
        for s in found[:_MATRICES]
    ]
    intro = (
        "Number of arms by truth (rows) and verdict (columns); the stronger the colour, the larger "
        "the share of the arms in that row. Correct verdicts lie in the framed cells."
    )
    left = len(found) - _MATRICES
    if left > 0:
        intro += f" The {_MATRICES} best by return; the raw rows hold the other {left}."
    return Section(heading="Confusion matrices", intro=[intro], cards=cards)


def _timeline(timeline: EpisodeTimeline | None, agent: str) -> Section:
    if timeline is None:
        return Section()
    reading = (
        "The blue loop on the tool is the correlation of its acceleration with the excited joint, "
        "by direction; on the grey circle it is 1. The blue line is the direction of lowest "
        "correlation. Dashed: the healthy arm. A clear difference between the two indicates a "
        "loose link or joint."
    )
    said = f"Played by {agent}. {timeline.words}" if agent else timeline.words
    return Section(
        heading="One episode, step by step",
        intro=[said, reading],
        cards=timeline.cards,
        strip=True,
    )


# Figures


def success_bars(
    rows: Sequence[Row], paint: Mapping[str, str], chance: float | None = None
) -> Figure:
    """Draw a bar an agent: accuracy with its 95 % interval."""
    found = standings(rows)
    figure, (axes,) = panels(1, 0.5 * len(found) + 0.45, grid="x")
    for y, s in zip(range(0, -len(found), -1), found, strict=True):
        ends = [[s.success - s.low], [s.high - s.success]]
        look: dict[str, Any] = {"ecolor": INK, "capsize": 3, "error_kw": {"elinewidth": 1.6}}
        axes.barh(y, s.success, height=0.34, color=paint[s.agent], xerr=ends, zorder=2, **look)
        share = f"{100 * s.success:.0f} % ({100 * s.low:.0f} to {100 * s.high:.0f})"
        for x, side, words in ((0.0, "left", s.agent), (1.0, "right", share)):
            axes.text(x, y + 0.27, words, color=INK, fontsize=9.5, ha=side, va="bottom")
    if chance is not None:
        axes.axvline(chance, color=MUTED, linewidth=1.1, linestyle=DASHED, zorder=1)
        axes.text(chance + 0.01, 0.4 - len(found), "blind guess", color=MUTED, fontsize=8.5)
    axes.set(ylim=(0.35 - len(found), 0.72), yticks=[])
    percent_ticks(axes, "x")
    labels(axes, x="accuracy")
    return figure


def success_and_records(
    found: Sequence[Standing], curves: Mapping[str, Sequence[float]], paint: Mapping[str, str]
) -> Figure:
    """Draw accuracy against mean records: a point an agent, and the Pareto front."""
    figure, (axes,) = panels(1, 2.9, rows=(len(found) + 2) // 2)
    for agent, curve in curves.items():
        counts = np.arange(1, len(curve) + 1)
        axes.plot(counts, curve, color=paint[agent], linewidth=1.3, alpha=0.75, zorder=2)
    records, success = np.array([[s.records, s.success] for s in found]).T
    front = np.flatnonzero(pareto_front(records, success))
    front = front[np.argsort(records[front])]
    look: dict[str, Any] = {"color": MUTED, "linewidth": 1.0, "linestyle": DASHED}
    axes.step(records[front], success[front], where="post", label="Pareto front", **look)
    for k, s in enumerate(found):
        ends = [[s.success - s.low], [s.high - s.success]]
        axes.errorbar(
            s.records, s.success, ends, color=paint[s.agent], marker=MARKERS[k % len(MARKERS)],
            markersize=7.0, markeredgecolor=INK, markeredgewidth=0.7, linestyle="", label=s.agent,
            zorder=4,
        )  # fmt: skip
    axes.set_xlim(left=0)
    percent_ticks(axes, "y")
    labels(axes, x="mean records", above="accuracy")
    legend(figure, axes)
    return figure


def success_by_group(division: Division, paint: Mapping[str, str]) -> Figure:
    """Draw the accuracy of every agent in every stratum, with 95 % intervals."""
    count = len(division.cells)
    figure, (axes,) = panels(1, 3.0, rows=(count + 1) // 2)
    place = np.arange(len(division.groups), dtype=float)
    for k, (agent, cells) in enumerate(division.cells.items()):
        at = place + 0.045 * (k - 0.5 * (count - 1))
        share, low, high = np.array([[c.success, c.low, c.high] for c in cells]).T
        axes.errorbar(
            at, share, [share - low, high - share], color=paint[agent], label=agent, elinewidth=1.2,
            marker=MARKERS[k % len(MARKERS)], markersize=5.0, linewidth=1.4, clip_on=False,
            linestyle="-" if division.ordered else "", zorder=3,
        )  # fmt: skip
    counts = [cell.episodes for cell in next(iter(division.cells.values()))]
    ticks = [f"{name}\n{n} arms" for name, n in zip(division.groups, counts, strict=True)]
    axes.set_xticks(place, ticks)
    axes.set_xlim(-0.4, len(place) - 0.6)
    percent_ticks(axes, "y")
    labels(axes, x=division.heading, above="accuracy")
    legend(figure, axes)
    return figure


def reliability_curves(rows: Sequence[Row], paint: Mapping[str, str]) -> Figure:
    """Draw a reliability diagram of the agents with probabilities."""
    beliefs = {agent: claims_of(own) for agent, own in by_agent(rows).items()}
    beliefs = {agent: claims for agent, claims in beliefs.items() if len(claims.record)}
    figure, (axes,) = panels(1, 2.9, rows=(len(beliefs) + 1) // 2)
    axes.plot([0, 1], [0, 1], color=MUTED, linewidth=1.0, linestyle=DASHED, zorder=1)
    for k, (agent, claims) in enumerate(beliefs.items()):
        found = reliability(claims.confidence, claims.right, bins=10)
        area = 8.0 + 34.0 * np.minimum(found.count / _ENOUGH, 1.0)
        look: dict[str, Any] = {"color": paint[agent], "clip_on": False}
        axes.plot(found.confidence, found.right, linewidth=1.3, zorder=2, **look)
        look |= {"marker": MARKERS[k % len(MARKERS)], "label": agent, "zorder": 3}
        axes.scatter(found.confidence, found.right, s=area, **look)
    percent_ticks(axes, "x")
    percent_ticks(axes, "y")
    labels(axes, x="probability of the best hypothesis", above="accuracy")
    legend(figure, axes)
    return figure


def ordered_hypotheses(rows: Sequence[Row]) -> tuple[str, ...]:
    """All hypotheses that rows mention: healthy, then links, then joints, each by number."""
    named = {str(row[k]) for row in rows for k in ("truth", "verdict") if row[k] is not None}
    last = {"healthy": 0, "backlash": 2, SEVERAL_FAULTS: 3}

    def rank(hypothesis: str) -> tuple[int, int]:
        return last.get(hypothesis.partition("@")[0], 1), place_of(hypothesis) or 0

    return tuple(sorted((named - {UNSURE}) | {"healthy"}, key=rank))


def confusion_counts(rows: Sequence[Row], hypotheses: Sequence[str]) -> NDArray[np.intp]:
    """Confusion counts by truth and verdict; last columns unsure and none (h, h + 2)."""
    columns = [*hypotheses, UNSURE, None]
    counts = np.zeros((len(hypotheses), len(columns)), dtype=np.intp)
    for row in rows:
        counts[hypotheses.index(str(row["truth"])), columns.index(row["verdict"])] += 1
    return counts


def confusion_matrix(rows: Sequence[Row], names: Sequence[str], colour: str) -> Figure:
    """Draw the confusion matrix of one agent's rows: number of arms by truth and verdict."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Rectangle

    counts = confusion_counts(rows, names)
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    down, across = counts.shape
    figure = new_figure(0.9 + 4.2 * down / across)
    figure.set_layout_engine("constrained")
    axes = figure.subplots()
    quiet_axes(axes, grid=None, spines=(), pad=2)
    tints = LinearSegmentedColormap.from_list("tints", [(colour, 0.06), (colour, 1.0)])
    axes.pcolormesh(share, cmap=tints, vmin=0, vmax=1, edgecolors="none")
    size = float(np.clip(31 * 4.2 / across, 6.0, 10.0))
    for (i, j), count in np.ndenumerate(counts):
        ink = ink_on(colour) if share[i, j] > 0.55 else INK
        words = str(count) if count else ""
        axes.text(j + 0.5, i + 0.5, words, color=ink, fontsize=size, ha="center", va="center")
    for i in range(down):
        axes.add_patch(Rectangle((i, i), 1, 1, facecolor="none", edgecolor=MUTED))
    shown = [_cell_words(name) for name in (*names, UNSURE)] + ["none"]
    axes.set_xticks(np.arange(across) + 0.5, shown, rotation=90)
    axes.set_yticks(np.arange(down) + 0.5, shown[:down])
    axes.xaxis.tick_top()
    axes.tick_params(labelsize=size, labelcolor=INK)
    axes.set(xlim=(0, across), ylim=(down, 0), aspect="equal")
    for axis, name in ((axes.xaxis, "verdict"), (axes.yaxis, "truth")):
        axis.set_label_text(name, color=MUTED, fontsize=9, fontstyle="italic")
    axes.xaxis.set_label_position("top")
    return figure


def _cell_words(hypothesis: str) -> str:
    """Name of a row or column of the confusion matrix."""
    kind, _, where = hypothesis.partition("@")
    if not where:
        return "several" if kind == SEVERAL_FAULTS else kind
    return f"{'joint' if kind == 'backlash' else 'link'} {place_of(hypothesis)}"
