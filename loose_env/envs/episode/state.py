"""State of one episode, and its latest record as raw signals."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.arms import Arm, MismatchDraw
from loose_env.diagnosis import link_axes
from loose_env.envs.episode.observation import ObservationLayout
from loose_env.envs.settings import DiagnosisSettings
from loose_env.faults import Fault
from loose_env.rig import Measurement
from loose_env.typing import Array

__all__ = ["Episode", "Outcome", "RawMeasurement", "raw_observation", "raw_space"]


@dataclass(kw_only=True, eq=False)
class Episode:
    """The state of one episode."""

    seed: int
    number: int
    fault: Fault
    pose: Array
    slots: NDArray[np.float32]
    mismatch: MismatchDraw | None = None
    records: int = 0
    seconds: float = 0.0
    levels: int = 0
    visited: set[bytes] = field(default_factory=set)
    last: Measurement | None = None
    ended: bool = False
    verdict: str | None = None

    @property
    def measured(self) -> int:
        """Number of records that show something."""
        return int(np.count_nonzero(self.slots[:, 0]))

    def stream(self, kind: int, index: int = 0) -> np.random.Generator:
        """Return the generator of one kind of draw."""
        key = (self.number, kind, index)
        return np.random.Generator(
            np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=key))
        )


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of one step."""

    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]


_LIMIT = 1e3  # bound of every channel: signals beyond it are clipped


class RawMeasurement(Measurement):
    """A measurement as it stands in `info`: equal to another one of the same values."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Measurement) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)
        )


def raw_space(arm: Arm, settings: DiagnosisSettings, layout: ObservationLayout) -> spaces.Dict:
    """Space of the statistics and the latest record's signals, padded to the longest record."""
    n, d, count = arm.n, len(arm.axes), _longest(settings)

    def box(*shape: int) -> spaces.Box:
        return spaces.Box(-_LIMIT, _LIMIT, shape, dtype=np.float32)

    signals: dict[str, spaces.Space[Any]] = {
        "statistics": layout.space,
        "command": box(n, count),
        "encoder": box(n, count),
        "tool": box(d, count),
    }
    choice = settings.sensors.on_links
    if choice is not None:
        signals["links"] = box(len(choice.on(arm)), len(link_axes(arm, choice)), count)
    return spaces.Dict(signals)


def raw_observation(
    arm: Arm, settings: DiagnosisSettings, flat: NDArray[np.float32], last: Measurement | None
) -> dict[str, NDArray[np.float32]]:
    """Lay the signals of the latest record beside the statistics.

    The command is in N·m, or N where the joint slides; the encoder in mrad, or mm, off the
    commanded pose; the tool in m/s², and so the links where they carry accelerometers.
    """
    n, d, count = arm.n, len(arm.axes), _longest(settings)
    signals = {
        "command": np.zeros((n, count), dtype=np.float32),
        "encoder": np.zeros((n, count), dtype=np.float32),
        "tool": np.zeros((d, count), dtype=np.float32),
    }
    choice = settings.sensors.on_links
    if choice is not None:
        shape = (len(choice.on(arm)), len(link_axes(arm, choice)), count)
        signals["links"] = np.zeros(shape, dtype=np.float32)
    if last is not None and last.failure is None:
        channels = {
            "command": last.command,
            "encoder": 1e3 * (last.encoder[:, 1:-1] - last.pose[:, None]),
            "tool": last.tool,
        }
        if choice is not None and last.links is not None:
            channels["links"] = last.links
        for name, channel in channels.items():
            signals[name][..., : channel.shape[-1]] = np.clip(channel, -_LIMIT, _LIMIT)
    return {"statistics": flat, **signals}


def _longest(settings: DiagnosisSettings) -> int:
    return round(max(settings.durations) * settings.sensors.rate)
