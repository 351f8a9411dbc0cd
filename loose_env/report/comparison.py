"""The page of a comparison, from the rows of its episodes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from loose_env.report.colours import agent_colours
from loose_env.report.confusion import confusion_matrix, ordered_hypotheses
from loose_env.report.figures import success_against_records, success_bars
from loose_env.report.page import write_comparison_page
from loose_env.report.plate import Plate
from loose_env.report.standings import Row, by_agent, standings, table_of, who_won
from loose_env.report.story import Story

__all__ = ["write_comparison"]

_MATRIX = (
    "Number of arms by truth (rows) and verdict (columns); the stronger the colour, the larger the "
    "share of the arms in that row. Right verdicts lie in the framed cells."
)
_READING = (
    "How to read the pictures: the blue loop on the tool shows, direction by direction, how well "
    "the tool follows the shaken joint; on the grey circle it follows perfectly. The blue line is "
    "the direction in which it follows least. Dashed is what a healthy arm would show. Where the "
    "two differ clearly, something may be loose."
)


def write_comparison(
    path: str | os.PathLike[str],
    rows: Sequence[Row],
    *,
    title: str,
    played: str | Sequence[str],
    hypotheses: Sequence[str] | None = None,
    chance: float | None = None,
    story: Story | None = None,
    story_of: str = "",
    notes: str | Sequence[str] = (),
) -> Path:
    """Write the page of a comparison: words, table, figures, and one episode in pictures.

    Parameters
    ----------
    path : path-like
        Where the page goes.
    rows : sequence of Row
        Episodes of all agents.
    title : str
        Title of the page.
    played : str or sequence of str
        What was played, in plain words; who won is added below.
    hypotheses : sequence of str, optional
        All hypotheses in order; by default those that the rows mention.
    chance : float, optional
        Success rate of a blind guess [1].
    story : Story, optional
        One episode, from `loose_env.report.story.tell_episode`.
    story_of : str
        Who played it.
    notes : str or sequence of str
        Paragraphs at the foot of the page: how to make it again.

    Returns
    -------
    Path
        The file written.
    """
    own, found = by_agent(rows), standings(rows)
    best, *rest = who_won(rows)
    colours = agent_colours(list(own))
    names = ordered_hypotheses(rows) if hypotheses is None else tuple(hypotheses)
    figures = [
        Plate(
            heading="How often they were right",
            image=success_bars(rows, colours=colours, chance=chance),
            caption="Share of arms whose fault was named rightly. The line is the 95 % interval: "
            "where the true rate lies, given this number of arms.",
        ),
        Plate(
            image=success_against_records(rows, colours=colours),
            caption="Share decided rightly after at most so many records. Steep and early is good: "
            "every record costs.",
        ),
    ]
    for k, standing in enumerate(found):
        figures.append(
            Plate(
                heading="What they took for what" if k == 0 else "",
                intro=_MATRIX,
                title=standing.agent,
                image=confusion_matrix(
                    own[standing.agent], hypotheses=names, colour=colours[standing.agent]
                ),
                caption=f"Confusion matrix of {standing.agent}",
            )
        )
    return write_comparison_page(
        path,
        title=title,
        text=played,
        result=[best, " ".join(rest)] if rest else best,
        table=table_of(found),
        colours=colours,
        figures=figures,
        story=() if story is None else story.plates,
        story_text=() if story is None else _told(story, story_of),
        notes=notes,
    )


def _told(story: Story, teller: str) -> list[str]:
    return [f"Played by {teller}. {story.words}" if teller else story.words, _READING]
