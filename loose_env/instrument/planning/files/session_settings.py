"""Settings of a plan, kept for the diagnosis of its runs and for the next plan."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from loose_env.errors import InvalidData
from loose_env.instrument.planning.files.plan_folder import PLAN, read_plan
from loose_env.instrument.settings.arm_and_plan import ModelSettings, PlanSettings
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.instrument.settings.validation import settings_within

__all__ = ["KEPT", "SessionSettings", "session_beside"]

KEPT = ("ramp_s", "hold_s", "repeat", "reference", "force_n")
"""Settings of a plan itself that hold for a session; its joint and pose are of one measurement."""


@dataclass(frozen=True, kw_only=True)
class SessionSettings:
    """Settings of a session that hold until others are given."""

    arm: ModelSettings = field(default_factory=ModelSettings)
    choice: NextSettings = field(default_factory=NextSettings)
    own: PlanSettings = field(default_factory=PlanSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    known: str = ""
    """Result that the plan was made with, as it was given; "" for none."""
    path: Path | None = None
    """The plan's file; None where there is none."""

    def is_newer_than(self, known: Path) -> bool:
        """True if the plan was made with a diagnosis, which then takes precedence."""
        result = known / "result.json" if known.is_dir() else known
        if self.path is None or self.known != str(known):
            return False
        try:
            return self.path.stat().st_mtime >= result.stat().st_mtime
        except OSError:
            return False


def session_beside(recording: str | Path) -> SessionSettings:
    """Settings of the plan that lies beside a recording; the usual ones where none does.

    A limit that was given to the first plan of a session, such as ``most_tool``, holds in this
    way for what a diagnosis asks for next, and for the next plan.

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
        return SessionSettings()
    settings, place = whole.get("settings"), f"{path}: settings"
    if not isinstance(settings, dict):
        raise InvalidData(f"{path}: settings are a mapping, got {settings!r:.60}")
    kept = {name: settings[name] for name in KEPT if name in settings}
    return SessionSettings(
        arm=settings_within(ModelSettings, settings, place),
        choice=settings_within(NextSettings, settings, place),
        own=settings_within(PlanSettings, kept, place),
        motion=settings_within(MotionSettings, settings, place),
        known=str(whole.get("known", "")),
        path=path,
    )
