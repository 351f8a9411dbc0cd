"""Public benchmark "naming missing physics": recordings to download, answers in JSON, scores.

Data flow: catalogue -> lerobot -> making -> answers -> scoring -> board.

`catalogue` says what may be answered, `lerobot` writes recordings as a LeRobotDataset, `making`
writes a suite with its sealed truths, `answers` reads and checks answers, `scoring` grades them,
`board` writes the leaderboard. `python -m scripts.suites.gap.public` is the command.
"""

from scripts.suites.gap.public.answers import Answer, Answered, answer_of, read_answer, read_answers
from scripts.suites.gap.public.board import leaderboard, read_score
from scripts.suites.gap.public.catalogue import Kind, catalogue
from scripts.suites.gap.public.lerobot import write_lerobot
from scripts.suites.gap.public.making import MakeSettings, Suite, make, open_truths, read_suite
from scripts.suites.gap.public.scoring import Score, score

__all__ = [
    "Answer",
    "Answered",
    "Kind",
    "MakeSettings",
    "Score",
    "Suite",
    "answer_of",
    "catalogue",
    "leaderboard",
    "make",
    "open_truths",
    "read_answer",
    "read_answers",
    "read_score",
    "read_suite",
    "score",
    "write_lerobot",
]
