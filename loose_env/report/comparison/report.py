"""The page of a comparison, from the rows of its episodes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from loose_env.evaluation import (
    RATIO_EDGES,
    Row,
    Standing,
    by_agent,
    calibration_of,
    crossing,
    divisions,
    runs_of,
    standings,
    success_after,
    table_of,
    trained_agents,
    who_won,
)
from loose_env.report.comparison.confusion_matrix import confusion_matrix, ordered_hypotheses
from loose_env.report.comparison.cost_figures import (
    reliability_curves,
    success_and_records,
    success_by_group,
)
from loose_env.report.comparison.episode_timeline import EpisodeTimeline
from loose_env.report.comparison.page import render_page
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.figures import success_against_records, success_bars
from loose_env.report.pages.palette import agent_colours
from loose_env.report.pages.table import (
    PageTable,
    calibration_tables,
    crossed_page_table,
    division_page_table,
    trainings_page_table,
)
from loose_env.report.pages.template import write_whole

_MATRICES = 6  # confusion matrices on the page; more are hard to take in
_COLUMNS = (
    "Accuracy: verdicts equal to the hidden fault. Location: verdicts with its link or joint, "
    "whatever the kind. False alarms: healthy arms called faulty. Missed faults: faulty arms "
    "called healthy. Poses, records, seconds of excitation and return are means."
)
_MARGIN = "± is half the 95 % bootstrap interval."
_PAIRED = (
    "The last column is the return less that of {} on the same arms, with its paired 95 % interval."
)

_MATRIX = (
    "Number of arms by truth (rows) and verdict (columns); the stronger the colour, the larger the "
    "share of the arms in that row. Correct verdicts lie in the framed cells."
)
_READING = (
    "The blue loop on the tool is the correlation of its acceleration with the excited joint, by "
    "direction; on the grey circle it is 1. The blue line is the direction of lowest correlation. "
    "Dashed: the healthy arm. A clear difference between the two indicates a loose link or joint."
)


def write_comparison(
    path: str | os.PathLike[str],
    rows: Sequence[Row],
    *,
    title: str,
    played: str | Sequence[str],
    hypotheses: Sequence[str] | None = None,
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
    hypotheses : sequence of str, optional
        All hypotheses in order; by default those that the rows mention.
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
        One episode, from `loose_env.report.comparison.episode_timeline.episode_timeline`.
    timeline_agent : str
        Who played it.
    notes : str or sequence of str
        Paragraphs at the foot of the page: how to make it again.

    Returns
    -------
    Path
        The file written.
    """
    own = by_agent(rows)
    found = standings(rows, reference=reference, rng=rng)
    best, *rest = who_won(rows)
    colours = agent_colours(list(own))
    chapters = [
        _success(rows, forced, found, colours, chance),
        _crossed(found),
        _divided(rows, colours),
        _calibrated(forced or rows, colours),
        _trained(rows, rng),
        _confused(own, found, colours, hypotheses),
    ]
    note = _COLUMNS if rng is None else f"{_COLUMNS} {_MARGIN}"
    page = render_page(
        title=title,
        text=played,
        result=[best, *([" ".join(rest)] if rest else []), *said],
        table=table_of(found, reference=reference),
        table_note=note if reference is None else f"{note} {_PAIRED.format(reference)}",
        colours=colours,
        figures=[item for chapter in chapters for item in chapter],
        timeline=() if timeline is None else timeline.cards,
        timeline_text=() if timeline is None else _told(timeline, timeline_agent),
        notes=notes,
    )
    return write_whole(path, page)


def _success(
    rows: Sequence[Row],
    forced: Sequence[Row],
    found: Sequence[Standing],
    colours: Mapping[str, str],
    chance: float | None,
) -> list[FigureCard | PageTable]:
    curves = success_after(forced)
    lines = "Lines: accuracy after so many records of agents that may not stop. "
    cards: list[FigureCard | PageTable] = [
        FigureCard(
            heading="Accuracy",
            image=success_bars(rows, colours=colours, chance=chance),
            caption="Share of arms with a correct verdict, with its 95 % interval.",
        ),
        FigureCard(
            image=success_and_records(found, curves=curves, colours=colours),
            caption="Accuracy against mean records; upright lines are 95 % intervals. "
            f"{lines if curves else ''}The dashed line is the Pareto front.",
        ),
    ]
    if not curves:
        cards.append(
            FigureCard(
                image=success_against_records(rows, colours=colours),
                caption="Share of correct verdicts after at most so many records.",
            )
        )
    return cards


def _crossed(found: Sequence[Standing]) -> list[FigureCard | PageTable]:
    crossed = crossing(found)
    return [] if crossed is None else [crossed_page_table(crossed)]


def _divided(rows: Sequence[Row], colours: Mapping[str, str]) -> list[FigureCard | PageTable]:
    parts: list[FigureCard | PageTable] = []
    for k, division in enumerate(divisions(rows)):
        heading = "Accuracy by stratum" if k == 0 else ""
        parts.append(division_page_table(division, heading=heading))
        parts.append(
            FigureCard(
                image=success_by_group(division, colours=colours),
                caption=f"Accuracy by {division.heading}, with 95 % intervals.",
            )
        )
    return parts


def _calibrated(rows: Sequence[Row], colours: Mapping[str, str]) -> list[FigureCard | PageTable]:
    figure = reliability_curves(rows, colours=colours)
    if figure is None:
        return []
    calibrated = [
        calibration_of(agent, own, edges=RATIO_EDGES) for agent, own in by_agent(rows).items()
    ]
    caption = (
        "Accuracy by predicted probability. The dashed line is perfect calibration; below it the "
        "agent is overconfident. Small marks stand for few predictions."
    )
    return [
        *calibration_tables([c for c in calibrated if c is not None]),
        FigureCard(image=figure, caption=caption),
    ]


def _trained(rows: Sequence[Row], rng: np.random.Generator | None) -> list[FigureCard | PageTable]:
    runs = trained_agents(str(row["agent"]) for row in rows)
    if rng is None or not runs:
        return []
    counts = {agent: len(names) for agent, names in runs.items()}
    return [trainings_page_table(runs_of(rows, rng=rng), counts)]


def _confused(
    own: Mapping[str, Sequence[Row]],
    found: Sequence[Standing],
    colours: Mapping[str, str],
    hypotheses: Sequence[str] | None,
) -> list[FigureCard | PageTable]:
    names = hypotheses
    if names is None:
        names = ordered_hypotheses([row for some in own.values() for row in some])
    left = len(found) - _MATRICES
    more = (
        f" The {_MATRICES} best by return; the raw rows hold the other {left}." if left > 0 else ""
    )
    return [
        FigureCard(
            heading="Confusion matrices" if k == 0 else "",
            intro=_MATRIX + more,
            title=standing.agent,
            image=confusion_matrix(
                own[standing.agent], hypotheses=names, colour=colours[standing.agent]
            ),
            caption=f"Confusion matrix of {standing.agent}",
        )
        for k, standing in enumerate(found[:_MATRICES])
    ]


def _told(timeline: EpisodeTimeline, teller: str) -> list[str]:
    return [f"Played by {teller}. {timeline.words}" if teller else timeline.words, _READING]
