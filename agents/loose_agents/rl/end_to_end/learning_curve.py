"""Learning curve of a training: budget, evaluations on fixed episodes, points, checkpoints."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from loose_agents.evaluation.evaluate import EpisodeRow
from loose_agents.rl.training_run import GeneratorStates, write_model
from loose_env.errors import InvalidData
from loose_env.faults import UNSURE
from loose_env.io import write_bytes

__all__ = ["Budget", "CurveCallback", "CurvePoint", "CurveState", "point_of", "read_curve"]


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """Evaluation of a policy in training on the held-out episodes."""

    steps: int
    """Steps of the training: records and verdicts."""
    records: int
    """Records of the training."""
    seconds: float
    """Time of the training, its evaluations included [s]."""
    episodes: int
    """Episodes of the evaluation."""
    mean_return: float
    """Their mean return."""
    return_error: float
    """Standard error of that mean."""
    right: float
    """Share of the episodes with the right verdict."""
    unsure: float
    """Share of the episodes with the verdict "unsure"."""
    records_per_episode: float
    """Mean number of records of an episode."""


def point_of(rows: Sequence[EpisodeRow], *, steps: int, records: int, seconds: float) -> CurvePoint:
    """Summarise the episodes of an evaluation."""
    returns = np.array([row.reward for row in rows])
    return CurvePoint(
        steps=steps,
        records=records,
        seconds=round(seconds, 1),
        episodes=len(rows),
        mean_return=float(returns.mean()),
        return_error=float(returns.std() / np.sqrt(len(returns))),
        right=float(np.mean([row.success for row in rows])),
        unsure=float(np.mean([row.verdict == UNSURE for row in rows])),
        records_per_episode=float(np.mean([row.records for row in rows])),
    )


def write_curve(path: Path, points: Sequence[CurvePoint]) -> None:
    """Write the points of a curve as CSV, one a line."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, [each.name for each in fields(CurvePoint)], lineterminator="\n")
    writer.writeheader()
    for point in points:
        writer.writerow(
            {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in asdict(point).items()}
        )
    write_bytes(path, text.getvalue().encode())


def read_curve(path: Path) -> list[CurvePoint]:
    """Read the points of a curve.

    Raises
    ------
    InvalidData
        If the file is missing or no such table.
    """
    whole = ("steps", "records", "episodes")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [
                CurvePoint(**{k: int(v) if k in whole else float(v) for k, v in line.items()})  # type: ignore[arg-type]
                for line in csv.DictReader(file)
            ]
    except (OSError, TypeError, ValueError) as error:
        raise InvalidData(f"{path} is no learning curve: {error}") from error


@dataclass
class Budget:
    """Steps and wall-clock time of a training; the one that runs out first ends it."""

    steps: int
    """Steps in all."""
    seconds: float | None = None
    """Time in all [s], over all resumptions; None without limit."""
    spent: float = 0.0
    """Time spent before this process took the run up [s]."""
    begun: float | None = None
    """Clock when it did."""

    def begin(self, spent: float) -> None:
        """Start the clock of a run that has taken some time already [s]."""
        self.spent, self.begun = spent, time.perf_counter()

    @property
    def elapsed(self) -> float:
        """Time of the run so far [s]."""
        return self.spent + (0.0 if self.begun is None else time.perf_counter() - self.begun)

    def timed_out(self) -> bool:
        """Return whether the time is spent."""
        return self.seconds is not None and self.elapsed >= self.seconds

    def left(self, steps_left: float) -> float:
        """Share of the budget that is left, 1 to 0, given the share of the steps that is."""
        if self.seconds is None:
            return steps_left
        return max(0.0, min(steps_left, 1.0 - self.elapsed / self.seconds))


class BudgetSchedule:
    """Schedule over the budget that runs out first, in place of one over the steps."""

    def __init__(self, schedule: Callable[[float], float], budget: Budget) -> None:
        self.schedule, self.budget = schedule, budget

    def __call__(self, left: float) -> float:
        """Value at a remaining fraction of the steps."""
        return self.schedule(self.budget.left(left))


@dataclass
class CurveState(GeneratorStates):
    """State of a run stored in its checkpoint beside the model."""

    points: list[dict[str, Any]] = field(default_factory=list)
    """Points of the curve so far."""
    records: int = 0
    """Records taken."""
    seconds: float = 0.0
    """Time spent [s]."""


class CurveCallback(BaseCallback):
    """Evaluates at equal shares of the budget, keeps the curve and the checkpoint.

    All of it happens between updates, where the model is whole.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    budget : Budget
        When the training ends.
    evaluate : callable
        Plays so many held-out episodes with the model as it is.
    evaluations : int
        Evaluations, the last one at the end.
    episodes, last_episodes : int
        Episodes of an evaluation, and of the last one.
    show : callable
        Called with every point.
    """

    model: Any

    def __init__(
        self,
        folder: Path,
        budget: Budget,
        evaluate: Callable[[int], Sequence[EpisodeRow]],
        *,
        evaluations: int,
        episodes: int,
        last_episodes: int,
        show: Callable[[CurvePoint], None],
    ) -> None:
        super().__init__()
        self.folder, self.budget, self.evaluate, self.show = folder, budget, evaluate, show
        self.evaluations, self.episodes, self.last = evaluations, episodes, last_episodes

    @property
    def state(self) -> CurveState:
        """State of the run."""
        found: CurveState = self.model.run_state
        return found

    def _on_training_start(self) -> None:
        self._due = self._number()
        if not self.state.points:
            self._add(self.episodes)

    def _on_rollout_start(self) -> None:
        if self._number() > self._due:
            self._due = self._number()
            self._add(self.episodes)

    def _on_step(self) -> bool:
        # A step is a record or ends the episode with a verdict.
        self.state.records += int(np.count_nonzero(~self.locals["dones"]))
        return not self.budget.timed_out()

    def _on_training_end(self) -> None:
        self._add(self.last)

    def _number(self) -> int:
        """Number of evaluations that are due."""
        steps_left = 1.0 - self.model.num_timesteps / self.budget.steps
        return int((1.0 - self.budget.left(steps_left)) * self.evaluations)

    def _add(self, episodes: int) -> None:
        """Evaluate, and write curve and checkpoint."""
        state = self.state
        point = point_of(
            self.evaluate(episodes),
            steps=self.model.num_timesteps,
            records=state.records,
            seconds=self.budget.elapsed,
        )
        state.points.append(asdict(point))
        state.seconds = self.budget.elapsed
        state.remember_generators()
        write_model(self.folder / "checkpoint.zip", self.model)
        write_curve(self.folder / "curve.csv", [CurvePoint(**each) for each in state.points])
        self.show(point)
