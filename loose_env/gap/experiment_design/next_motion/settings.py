"""Settings of the next motion: limits of speed, reach, torque and time; number of rivals."""

from __future__ import annotations

from dataclasses import dataclass

from loose_env.io import Checked, Count, NonNegative, NonNegativeCount, Positive


@dataclass(frozen=True, kw_only=True)
class NextMotionSettings(Checked):
    """Limits of the next motion, and what it costs.

    Examples
    --------
    >>> NextMotionSettings(next_max_speed_rad_s=-1.0)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: NextMotionSettings.next_max_speed_rad_s must be ...
    """

    next_max_speed_rad_s: NonNegative = 0.0
    """Largest joint speed [rad/s]; of slides a fifth of it [m/s]; 0 for the fastest that the
    recorded runs were."""
    next_reach_rad: Positive = 1.0
    """Furthest from the first pose of the recording, where the model has no joint limit [rad]; of
    slides a fifth of it [m]."""
    next_torque_share: Positive = 0.8
    """Share of a drive's torque limit that a motion may take [1]."""
    next_seconds: Positive = 15.0
    """Longest motion [s]."""
    next_least_seconds: Positive = 6.0
    """Shortest excitation [s]: effects are accepted by z-scores over blocks of time, which take
    many of them."""
    next_setup_s: NonNegative = 10.0
    """Time that a recording costs beside its motion [s]: of two motions that separate equally well
    the shorter one is taken."""
    next_rivals: Count = 6
    """Most rivals that are compared."""
    next_unseen: NonNegativeCount = 4
    """Most effects that these runs would not show for which a motion is looked for."""
