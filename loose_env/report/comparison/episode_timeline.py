"""Timeline of one episode: a figure of each record, the verdict and the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from loose_env.arms import Arm
from loose_env.envs import DiagnosisSettings, EpisodeBatch, Picture, fault_words, hypothesis_words
from loose_env.faults import UNSURE
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.svg import to_svg


class Player(Protocol):
    """An agent: stable-baselines3's ``predict``."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose actions for observations (num, size); carry the state along."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class EpisodeTimeline:
    """Figures and outcome of one episode."""

    cards: tuple[FigureCard, ...]
    """The first pose, every record and the end, in order."""
    truth: str
    """The hypothesis that was true."""
    verdict: str | None
    """The verdict of the agent."""
    records: int
    """Records taken."""
    words: str
    """The outcome in a sentence."""


def episode_timeline(
    agent: Player, arm: Arm, settings: DiagnosisSettings, *, seed: int, number: int = 0
) -> EpisodeTimeline:
    """Run an episode with an agent and draw each step.

    Parameters
    ----------
    agent : Player
        The agent.
    arm : Arm
        The nominal arm; it must move in a plane.
    settings : DiagnosisSettings
        Settings of the environment.
    seed, number : int
        Index of the episode: the same one as that of a comparison with this seed.
    """
    batch = EpisodeBatch(arm, settings, threads=1)
    picture = Picture(batch.nominal, show=False, sensors=settings.sensors)
    batch.start(0, seed=seed, number=number)
    episode = batch.episode(0)
    cards = [FigureCard(image=to_svg(picture.figure(episode)), caption="The first pose")]
    state: Any = None
    info: dict[str, Any] = {}
    while not episode.ended:
        actions, state = agent.predict(
            batch.observe(0)[None], state, np.array([episode.records == 0]), deterministic=True
        )
        info = batch.step([0], [np.asarray(actions)[0]])[0].info
        if episode.ended:
            break
        caption = f"Record {episode.records}"
        cards.append(FigureCard(image=to_svg(picture.figure(episode)), caption=caption))
    verdict = info["verdict"]
    named = hypothesis_words(verdict)
    truth = fault_words(episode.fault)
    last = picture.figure(episode, verdict=verdict)
    cards.append(FigureCard(image=to_svg(last), caption="Verdict and truth"))
    mark = "Correct." if verdict == info["fault"] else f"Wrong; the truth: {truth}."
    if verdict == UNSURE:
        mark = f"The truth: {truth}."
    spent = f"After {episode.records} record{'' if episode.records == 1 else 's'}"
    said = "there was no verdict" if verdict is None else f"the verdict was: {named}"
    return EpisodeTimeline(
        cards=tuple(cards),
        truth=info["fault"],
        verdict=verdict,
        records=episode.records,
        words=f"{spent} {said}. {mark}",
    )
