"""Tables of signals and of the move to the pose: CSV, Parquet, JointTrajectory; file names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.planning.files.ros_trajectory import joint_columns, trajectory_text
from loose_env.instrument.planning.signals.signal import Signal
from loose_env.io import write_text, written_beside
from loose_env.recording import write_csv, write_parquet
from loose_env.typing import Array

ENDINGS = {"csv": ".csv", "parquet": ".parquet", "ros2": ".yaml"}
"""Format of a file -> its ending."""
FIRST = "first-signal"
"""Signal of the session's first run, which is repeated."""
TRANSIT = "transit"
"""Move from the present pose to that of the runs."""
_OWN = re.compile(r"(signal(-[1-9]\d*)?|first-signal|transit)\.(csv|parquet|yaml)")


def signal_stems(signals: Sequence[Signal]) -> tuple[str, ...]:
    """Names of the signals' files without their endings."""
    return tuple("signal" if k == 1 else f"signal-{k}" for k in range(1, len(signals) + 1))


def signal_columns(signal: Signal) -> dict[str, Array]:
    """Columns of a signal: time, and the commands that are played."""
    played = signal.played or {f"ctrl.{name}": u for name, u in signal.commands.items()}
    return {"time": signal.time, **played}


def write_table(
    folder: Path,
    stem: str,
    columns: Mapping[str, Array],
    arm: InstrumentedArm,
    formats: Iterable[str],
    pose: Array,
) -> list[Path]:
    """Write columns in some formats, each beside its final name first."""
    written = []
    for name in formats:
        path = folder / f"{stem}{ENDINGS[name]}"
        if name == "ros2":
            played = {key: values for key, values in columns.items() if key != "time"}
            kind, values = joint_columns(arm, played)
            written.append(
                write_text(path, trajectory_text(arm.joints, kind, columns["time"], values, pose))
            )
        else:
            write = write_csv if name == "csv" else write_parquet
            written.append(written_beside(path, partial(_table, write, columns)))
    return written


def own_files(whole: Mapping[str, Any]) -> frozenset[str]:
    """Checked names of the files that a plan lists as its own: it may have been edited."""
    signals = whole.get("signals")
    listed = [one for one in signals if isinstance(one, dict)] if isinstance(signals, list) else []
    names = [str(one.get(key)) for one in listed for key in ("csv", "parquet")]
    files = whole.get("files")
    names += [str(name) for name in files] if isinstance(files, list) else []
    return frozenset(name for name in names if _OWN.fullmatch(name))


def _table(write: Any, columns: Mapping[str, Array], path: Path) -> None:
    write(path, columns)
