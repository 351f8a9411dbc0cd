"""Settings of the diagnosis environment."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Real
from typing import Literal, get_args

import numpy as np

from loose_env.arms import Arm
from loose_env.envs.faults.difficulty import Difficulty, difficulty_named
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults import DEFAULT_KINDS, UNSURE, FaultKind
from loose_env.sensors import SensorSuite

__all__ = ["DiagnosisSettings", "Engine", "Prices"]

Engine = Literal["mujoco", "reduced"]
"""What simulates the arms."""


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and bool(np.isfinite(float(value)))


@dataclass(frozen=True, kw_only=True)
class Prices:
    """What right and wrong verdicts and measurements are worth.

    At these prices it pays to be unsure where the best verdict is right with less than 37.5 %:
    there p * correct + (1 - p) * wrong falls below -0.25.
    """

    correct: float = 1.0
    """Reward for naming the right hypothesis."""
    wrong: float = -1.0
    """Reward for naming a wrong one, where the two below do not say otherwise."""
    false_alarm: float | None = None
    """Reward for naming a fault on a healthy arm; None: as `wrong`."""
    miss: float | None = None
    """Reward for calling a faulty arm healthy; None: as `wrong`."""
    unsure: float = -0.25
    """Reward for the verdict "unsure", whatever the truth: nothing is named."""
    record: float = 0.05
    """Price of one record."""
    second: float = 0.02
    """Price of one second of excitation."""
    level: float = 0.002
    """Price of one joint excited one level up, per record."""

    def __post_init__(self) -> None:
        for name in ("correct", "wrong", "false_alarm", "miss", "unsure"):
            value = getattr(self, name)
            optional = value is None and name in ("false_alarm", "miss")
            if not optional and not _is_number(value):
                raise InvalidSetting(
                    f"the reward for {name!r} must be a finite number, got {value!r}"
                )
        for name in ("record", "second", "level"):
            value = getattr(self, name)
            if not _is_number(value) or value < 0:
                raise InvalidSetting(
                    f"the price per {name} must be a finite number, zero or more; got {value!r}"
                )

    def verdict(self, named: str, truth: str) -> float:
        """Reward of a verdict.

        Parameters
        ----------
        named : str
            A hypothesis, or "unsure".
        truth : str
            Hypothesis under which the true arm falls. One that no verdict can name leaves every
            name wrong.

        Examples
        --------
        >>> prices = Prices(miss=-2.0)
        >>> prices.verdict("healthy", "several_faults"), prices.verdict("unsure", "healthy")
        (-2.0, -0.25)
        """
        if named == UNSURE:
            return self.unsure
        if named == truth:
            return self.correct
        if truth == "healthy" and self.false_alarm is not None:
            return self.false_alarm
        if named == "healthy" and self.miss is not None:
            return self.miss
        return self.wrong


@dataclass(frozen=True, kw_only=True)
class DiagnosisSettings:
    """Everything about the environment but the arm itself.

    Examples
    --------
    >>> DiagnosisSettings(difficulty="hard", max_records=3).max_records
    3
    """

    difficulty: str | Difficulty = "default"
    """Ranges of the hidden faults: "easy", "default", "hard" or a Difficulty."""
    kinds: tuple[FaultKind, ...] = DEFAULT_KINDS
    """Which kinds of fault are hypotheses, "healthy" always; their order does not matter."""
    prices: Prices = field(default_factory=Prices)
    """Rewards and prices."""
    max_records: int = 12
    """Records an episode may take; after the last one only a verdict is left."""
    moves: tuple[float, ...] = (-90.0, -45.0, 0.0, 45.0, 90.0)
    """Relative moves a joint can make before a record [deg]. A joint that slides goes in
    proportion through its range: 90 degrees are half of it."""
    durations: tuple[float, ...] = (0.2, 0.4, 1.2)
    """Record lengths to choose from [s]."""
    sensors: SensorSuite = field(default_factory=SensorSuite)
    """What reads the motion."""
    engine: Engine = "mujoco"
    """What simulates the arms: MuJoCo's batched engine, or "reduced", the same equations about
    the pose in a compiled loop: 5 to 8 times faster, for faults of one degree of freedom. It
    needs numba."""
    raw: bool = False
    """Whether the observation becomes a Dict with the latest record's signals beside the
    statistics, and `info` carries the measurement itself."""

    def __post_init__(self) -> None:
        difficulty_named(self.difficulty).probabilities(self.kinds)
        for name, kind in (("prices", Prices), ("sensors", SensorSuite)):
            if not isinstance(getattr(self, name), kind):
                raise InvalidSetting(
                    f"{name} must be a {kind.__name__}, got {getattr(self, name)!r}"
                )
        if self.engine not in get_args(Engine):
            raise UnknownName(f"engine is one of {list(get_args(Engine))}, got {self.engine!r}")
        records = self.max_records
        if isinstance(records, bool) or not isinstance(records, (int, np.integer)) or records < 1:
            raise InvalidSetting(f"max_records must be a whole number, 1 or more; got {records!r}")
        if not all(map(_is_number, self.moves)) or 0.0 not in self.moves:
            raise InvalidSetting(f"moves must be finite degrees, 0 among them; got {self.moves!r}")
        durations = self.durations
        if not durations or not all(_is_number(d) and d > 0 for d in durations):
            raise InvalidSetting(f"durations must be positive seconds, got {durations!r}")

    @property
    def stay(self) -> int:
        """Index of the move that leaves a joint where it is."""
        return self.moves.index(0.0)

    def level_names(self, arm: Arm) -> tuple[str, ...]:
        """Levels of an arm in words."""
        return ("off", *(f"{level:g} m/s² rms at the tool" for level in arm.levels))
