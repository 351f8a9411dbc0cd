"""Settings kept in a plan's folder, for the diagnosis of its runs and for the next plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.model.motion_limits import QUANTITIES
from loose_env.instrument.planning.files.plan_folder import PLAN, read_plan
from loose_env.instrument.settings.arm_and_plan import ModelSettings, PlanSettings
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.instrument.settings.validation import settings_within

KEPT = ("ramp_s", "hold_s", "repeat", "reference", "force_n")
"""Settings of a plan itself that hold for a session; its joint and pose are of one measurement."""


@dataclass(frozen=True, kw_only=True)
class SessionSettings:
    """Settings of a session that hold until others are given."""

    arm: ModelSettings = field(default_factory=ModelSettings)
    choice: NextSettings = field(default_factory=NextSettings)
    own: PlanSettings = field(default_factory=PlanSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    limits: MotionSettings | None = None
    """The same, with the limits that the arm's own file states, which the model of a recording may
    lack; None where there is no plan."""
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
    """Settings of the plan in the session's folder; the usual ones where there is none.

    They hold for every recording in that folder: that of the plan, and a corrected copy of it.

    A limit that was given to the first plan of a session, such as ``most_tool``, holds in this
    way for what a diagnosis asks for next, and for the next plan.

    Parameters
    ----------
    recording : str or Path
        Folder of the recording.

    Raises
    ------
    InvalidData
        If the plan is damaged, or has settings that make no sense.
    """
    folder = Path(recording).resolve()
    path = folder.parent / PLAN
    whole = read_plan(path)
    if whole is None:
        return SessionSettings()
    settings, place = whole.get("settings"), f"{path}: settings"
    if not isinstance(settings, dict):
        raise InvalidData(f"{path}: settings are a mapping, got {settings!r:.60}")
    motion = settings_within(MotionSettings, settings, place)
    kept = {name: settings[name] for name in KEPT if name in settings}
    return SessionSettings(
        arm=settings_within(ModelSettings, settings, place),
        choice=settings_within(NextSettings, settings, place),
        own=settings_within(PlanSettings, kept, place),
        motion=motion,
        limits=_limits(motion, whole.get("limits"), f"{path}: limits"),
        known=str(whole.get("known", "")),
        path=path,
    )


def _limits(motion: MotionSettings, stated: Any, place: str) -> MotionSettings:
    """Motion settings with the limits that a plan found, where all joints have one."""
    if stated is None:
        return motion
    found: dict[str, tuple[float, ...]] = {}
    for quantity, name in QUANTITIES.items():
        joints = stated.get(quantity, {}) if isinstance(stated, Mapping) else None
        try:
            values = tuple(each["limit"] for each in joints.values())  # type: ignore[union-attr]
        except (AttributeError, KeyError, TypeError):
            raise InvalidData(
                f'{place}: a mapping of quantities to joints is needed, each with its "limit"; '
                "'loose plan' writes it anew"
            ) from None
        if values and None not in values and not getattr(motion, name):
            found[name] = values
    try:
        return replace(motion, **found)  # type: ignore[arg-type]
    except InvalidSetting as error:
        raise InvalidData(f"{place}: {error}") from None
