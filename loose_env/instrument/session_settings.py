"""What a plan was told about choosing measurements, for the diagnosis of the runs it asked for."""

from __future__ import annotations

from pathlib import Path

from loose_env.errors import InvalidData
from loose_env.instrument.next_settings import NextSettings
from loose_env.instrument.plan_files import PLAN, read_plan

__all__ = ["settings_beside"]


def settings_beside(recording: str | Path) -> NextSettings | None:
    """Settings of the plan that lies beside a recording; None where none does.

    A limit that was given to the first plan of a session, such as ``most_tool``, holds in this
    way for what a diagnosis asks for next.

    Parameters
    ----------
    recording : str or Path
        Folder of the recording.

    Raises
    ------
    InvalidData
        If the plan has settings that make no sense.
    """
    folder = Path(recording).resolve()
    path = folder.parent / PLAN
    whole = read_plan(path)
    if whole is None or whole.get("recording") != folder.name:
        return None
    settings = whole.get("settings")
    if not isinstance(settings, dict):
        raise InvalidData(f"{path}: settings are a mapping, got {settings!r:.60}")
    return NextSettings.within(settings, f"{path}: settings")
