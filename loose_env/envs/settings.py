"""Settings of the diagnosis environment."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from loose_env.arms.arm import Arm
from loose_env.envs.difficulty import Difficulty, difficulty_named
from loose_env.errors import InvalidSetting
from loose_env.sensors import SensorSuite

__all__ = ["DiagnosisSettings", "Prices"]


@dataclass(frozen=True, kw_only=True)
class Prices:
    """What right and wrong verdicts and measurements are worth."""

    correct: float = 1.0
    """Reward for naming the right hypothesis."""
    wrong: float = -1.0
    """Reward for naming a wrong one, where the two below do not say otherwise."""
    false_alarm: float | None = None
    """Reward for naming a fault on a healthy arm; None: as `wrong`."""
    miss: float | None = None
    """Reward for calling a faulty arm healthy; None: as `wrong`."""
    record: float = 0.05
    """Price of one record."""
    second: float = 0.02
    """Price of one second of excitation."""
    level: float = 0.002
    """Price of one joint excited one level up, per record."""

    def __post_init__(self) -> None:
        for name in ("record", "second", "level"):
            if not np.isfinite(getattr(self, name)) or getattr(self, name) < 0:
                raise InvalidSetting(
                    f"the price per {name} must be finite, zero or more; got {getattr(self, name)}"
                )

    def verdict(self, named: str, truth: str) -> float:
        """Reward of a verdict."""
        if named == truth:
            return self.correct
        if truth == "healthy" and self.false_alarm is not None:
            return self.false_alarm
        if named == "healthy" and self.miss is not None:
            return self.miss
        return self.wrong


@dataclass(frozen=True, kw_only=True)
class DiagnosisSettings:
    """Everything about the environment but the arm itself."""

    difficulty: str | Difficulty = "default"
    """Ranges of the hidden faults: "easy", "default", "hard" or a Difficulty."""
    prices: Prices = field(default_factory=Prices)
    """Rewards and prices."""
    max_records: int = 12
    """Records an episode may take; after the last one only a verdict is left."""
    moves: tuple[float, ...] = (-90.0, -45.0, 0.0, 45.0, 90.0)
    """Relative moves a joint can make before a record [deg]."""
    durations: tuple[float, ...] = (0.2, 0.4, 1.2)
    """Record lengths to choose from [s]."""
    sensors: SensorSuite = field(default_factory=SensorSuite)
    """What reads the motion."""
    raw: bool = False
    """Whether `info` carries the measurement itself, raw signals included."""

    def __post_init__(self) -> None:
        difficulty_named(self.difficulty)
        if isinstance(self.max_records, bool) or self.max_records < 1:
            raise InvalidSetting(f"max_records must be 1 or more, got {self.max_records!r}")
        if 0.0 not in self.moves:
            raise InvalidSetting(f"moves must contain 0, got {self.moves}")
        if not self.durations or min(self.durations) <= 0:
            raise InvalidSetting(f"durations must be positive seconds, got {self.durations}")

    @property
    def stay(self) -> int:
        """Index of the move that leaves a joint where it is."""
        return self.moves.index(0.0)

    def level_names(self, arm: Arm) -> tuple[str, ...]:
        """Levels of an arm in words."""
        return ("off", *(f"{level:g} m/s² rms at the tool" for level in arm.levels))
