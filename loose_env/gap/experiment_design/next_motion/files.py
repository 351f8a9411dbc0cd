"""Files of the next motion: commands as CSV and Parquet, its reasons as JSON; text lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.gap.experiment_design.next_motion.choice import NextMotion, PairGain
from loose_env.gap.experiment_design.next_motion.open_pairs import NOTHING
from loose_env.gap.experiment_design.next_motion.settings import NextMotionSettings
from loose_env.io import json_text, restored, whole_of, write_text
from loose_env.recording import table_of, write_csv, write_parquet
from loose_env.typing import Array

NEXT_MOTION = "next_motion"
"""Name of the files, without the ending."""
FORMAT = "loose-next-motion/1"
"""Format of the JSON file."""
_REPEATS = 2
"""How often a motion is recorded: one run is fitted, the other one held out."""


@dataclass(frozen=True, kw_only=True)
class NextMotionSummary:
    """What a motion is expected to tell, for ``next_motion.json``."""

    words: str
    """The motion: kind, joints, amplitude and speed."""
    seconds: float
    """Length of one run [s]."""
    repeats: int
    """How often it is recorded, each as a run of its own: one is fitted, the last one held out."""
    pairs: tuple[PairGain, ...]
    """Expected gain for each open pair."""
    checked: tuple[str, ...]
    """What was checked, with the corrected model, and the margins left."""
    motion: Mapping[str, Any]
    """Configuration of the motion."""
    limits: Mapping[str, Any]
    """Limits by joint, and where they come from."""
    settings: Mapping[str, Any]
    """Settings of the choice."""
    considered: int
    """Motions that were compared."""
    refused: tuple[tuple[str, str], ...]
    """Motions that do not fit, each with the reason."""
    columns: tuple[str, ...]
    """Columns of the tables."""
    format: str = FORMAT
    """Format of the file."""

    @property
    def file_description(self) -> str:
        """The file with its length and motion."""
        return f"{NEXT_MOTION}.csv ({self.seconds:.0f} s: {self.words})"

    def gain_of(self, one: str, other: str) -> float | None:
        """Expected gain of a pair, of effects such as "payload at tool"; None if not separated.

        The larger of both, if either effect is the right one.
        """
        for pair in self.pairs:
            if {pair.effect, pair.rival} == {one, other} and pair.separates:
                return pair.nats
        return None


def summary_of(chosen: NextMotion, settings: NextMotionSettings) -> NextMotionSummary:
    """Summarise a chosen motion."""
    limits = chosen.limits
    table = table_of(chosen.runs.run(NEXT_MOTION, chosen.candidate.played))
    return NextMotionSummary(
        words=chosen.description,
        seconds=chosen.seconds,
        repeats=_REPEATS,
        pairs=chosen.gains,
        checked=chosen.checked,
        motion=asdict(chosen.candidate.motion),
        limits={
            "joints": list(limits.joints),
            "first_pose": _plain(limits.home),
            "low": _plain(limits.low),
            "high": _plain(limits.high),
            "speed": _plain(limits.speed),
            "torque": _plain(limits.torque),
            "sources": dict(zip(("position", "speed", "torque"), limits.sources, strict=True)),
        },
        settings=asdict(settings),
        considered=chosen.considered,
        refused=chosen.refused,
        columns=tuple(table),
    )


def _plain(values: Array) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]


def write_next_motion(
    folder: Path, chosen: NextMotion, settings: NextMotionSettings
) -> tuple[NextMotionSummary, list[Path]]:
    """Write ``next_motion.csv``, ``next_motion.parquet`` and ``next_motion.json``.

    The tables have the columns of a run of the recording: the time, the commands in each
    actuator's unit, and the joint positions and torques that are expected of the machine.
    """
    summary = summary_of(chosen, settings)
    table = table_of(chosen.runs.run(NEXT_MOTION, chosen.candidate.played))
    files = [folder / f"{NEXT_MOTION}.{ending}" for ending in ("csv", "parquet", "json")]
    write_csv(files[0], table)
    write_parquet(files[1], table)
    write_text(files[2], json_text(asdict(summary)))
    return summary, files


def read_next_motion(file: Path) -> NextMotionSummary:
    """Read ``next_motion.json``.

    Raises
    ------
    InvalidData
        If it is none of the format.
    """
    whole = whole_of(file.read_text(encoding="utf-8"), format=FORMAT, noun="next motion")
    return restored(NextMotionSummary, whole, "next motion")


def next_motion_lines(motion: NextMotionSummary) -> list[str]:
    """Lines on a motion for a reader: what it is, what it tells, what was checked."""
    found = [
        f"next motion: {motion.file_description}, recorded {motion.repeats} times, "
        f"{motion.repeats * motion.seconds:.0f} s in all"
    ]
    for pair in motion.pairs:
        if pair.separates and pair.effect == NOTHING:
            found.append(f"  shows {pair.rival} if it is there: expected gain {pair.nats:.0f} nats")
        elif pair.separates:
            found.append(
                f"  separates {pair.effect} from {pair.rival}: expected gain "
                f"{pair.if_effect_nats:.0f} nats ({pair.if_rival_nats:.0f} if it is the other); "
                f"{pair.so_far_nats:.1f} so far"
            )
        elif pair.effect != NOTHING:
            found.append(f"  does not separate {pair.effect} from {pair.rival}")
    found.append(f"  checked with the corrected model: {'; '.join(motion.checked)}")
    return found
