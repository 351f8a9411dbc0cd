"""Rig that replays recorded runs, for trying a session without a machine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.errors import InvalidData
from loose_env.excitation import Excitation
from loose_env.recording import Recording, Run
from loose_env.typing import Array

__all__ = ["RecordedRig"]


_JOINT = 3.0
"""Distance between poses that counts like another joint than the one asked for [rad or m]."""


class RecordedRig:
    """Answers every measurement with the nearest recorded run, each run once.

    Parameters
    ----------
    recording : Recording
        Runs with ``pose`` and ``excited``. Healthy references are not given out.
    joints : sequence of str
        Joints in the order of the poses that will be asked for, base first.

    Raises
    ------
    InvalidData
        If no run has a pose and excited joints.
    """

    def __init__(self, recording: Recording, joints: Sequence[str]) -> None:
        self.joints = tuple(joints)
        self._left = [
            run
            for run in recording.runs
            if run.condition == "suspect" and run.pose is not None and run.excited
        ]
        if not self._left:
            raise InvalidData(
                "the recording has no run of the arm under test with 'pose' and 'excited'; note "
                "both in recording.json"
            )

    @property
    def left(self) -> int:
        """Runs not yet replayed."""
        return len(self._left)

    def measure(self, pose: Array, excitation: Excitation) -> Run:
        """Replay the run nearest in pose with the same excited joint, if there is one.

        Raises
        ------
        InvalidData
            If all runs were given out.
        """
        if not self._left:
            raise InvalidData("all runs of the recording were given out; record more")
        asked = {j for j, on in zip(self.joints, excitation.excited, strict=True) if on}

        def unlike(run: Run) -> float:
            assert run.pose is not None
            there = np.array([run.pose.get(j, q) for j, q in zip(self.joints, pose, strict=True)])
            away = float(np.linalg.norm(there - pose))
            return away + (0.0 if asked & set(run.excited) else _JOINT)

        nearest = min(self._left, key=unlike)
        self._left.remove(nearest)
        return nearest
