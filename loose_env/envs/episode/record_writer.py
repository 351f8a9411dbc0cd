"""Works out what measured records show, many at once, and writes them into their episodes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loose_env.arms import Arm, LinearPose
from loose_env.diagnosis import (
    NominalLinks,
    SensorFloor,
    link_readings_of_all,
    predictions,
    statistics_of_all,
)
from loose_env.envs.episode.actions import Action
from loose_env.envs.episode.observation import ObservationLayout
from loose_env.envs.episode.state import Episode
from loose_env.envs.settings import DiagnosisSettings
from loose_env.errors import InvalidData
from loose_env.rig import Measurement
from loose_env.typing import Array

__all__ = ["AskedRecord", "RecordWriter"]


_TOGETHER = 64
"""Records worked out at once: their signals fit the processor's cache."""


@dataclass(kw_only=True, eq=False)
class AskedRecord:
    """A record that one arm is asked for in a step, and what becomes of it."""

    slot: int
    episode: Episode
    action: Action
    at: LinearPose
    info: dict[str, Any]
    share: Array | None = None
    measurement: Measurement | None = None
    failure: str | None = None


class RecordWriter:
    """Writes records into the slots of their episodes.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    settings : DiagnosisSettings
        Settings of the environment.
    observations : ObservationLayout
        Layout of the slots.
    floor : SensorFloor
        Noise that statistics are predicted with.
    """

    def __init__(
        self,
        arm: Arm,
        settings: DiagnosisSettings,
        observations: ObservationLayout,
        floor: SensorFloor,
    ) -> None:
        choice = settings.sensors.on_links
        self.observations, self.floor = observations, floor
        self._nominal_links = None if choice is None else NominalLinks(arm, choice)

    def write(self, measured: Iterable[tuple[AskedRecord, Measurement]]) -> None:
        """Write records as they are measured, those of one form together."""
        alike: dict[tuple[object, ...], list[AskedRecord]] = {}
        for asked, measurement in measured:
            asked.measurement, asked.failure = measurement, measurement.failure
            if measurement.failure is None:
                key = (measurement.tool.shape[1], int(measurement.excited.sum()))
                alike.setdefault(key, []).append(asked)
                if len(alike[key]) == _TOGETHER:
                    self._show(alike.pop(key))
        for members in alike.values():
            self._show(members)

    def _show(self, asked: Sequence[AskedRecord]) -> None:
        """Fill the slots of records; one that makes no statistics is marked as failed."""
        try:
            self._fill_slots(asked)
        except InvalidData as error:
            if len(asked) == 1:
                asked[0].failure = f"the readings make no statistics: {error}"
                return
            for each in asked:
                self._show([each])

    def _fill_slots(self, asked: Sequence[AskedRecord]) -> None:
        """Enter records, alike in length and in the number of excited joints, into their slots."""
        measured = [each.measurement for each in asked if each.measurement is not None]
        links = expected = None
        if self._nominal_links is not None:
            links = link_readings_of_all(measured)
            expected = np.array(
                [self._nominal_links.transmission(m.pose, m.excited) for m in measured]
            )
        rows = self.observations.slots_for(
            np.array([each.action.levels for each in asked]),
            np.array([each.share for each in asked]),
            statistics_of_all(measured),
            predictions([each.at for each in asked], [m.excitation for m in measured], self.floor),
            links=links,
            nominal_links=expected,
        )
        for each, row in zip(asked, rows, strict=True):
            each.episode.slots[each.episode.records] = row
