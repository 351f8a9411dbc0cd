"""Odd random-phase multisines on all joints at once, within a controller's limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.instrument.arm import PoseModel
from loose_env.instrument.controllers import Controller
from loose_env.typing import Array, IndexArray

LOWEST_HZ = 3.0
"""Lowest line [Hz]: below it a joint's acceleration asks for more travel than a cell has room."""
_TRIES = 30
"""Draws of phases of which the one with the lowest crest is taken."""
_SPARE = 0.6
"""Share of the torque left beside the static load that a line sum's peak may ask for [1]: rotors
and friction, which a rigid model lacks, take the rest."""
_FADE_S = 0.6
"""Time over which the signal swells, and in which it ebbs away at the end [s]: shorter, its slope
adds to the peak acceleration."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Multisine:
    """Lines and phases of a signal, the same for every pose and level; n joints, K lines."""

    period_s: float
    """Period [s]; lines are whole multiples of its inverse."""
    periods: int
    """Whole periods played after the lead."""
    lead_s: float
    """Time before them in which the signal swells and the arm settles into it [s]."""
    tail_s: float
    """Time after them in which it ebbs away [s]: no controller can stop at once."""
    excited: IndexArray
    """Excited lines, as multiples of the inverse period (K,)."""
    silent: IndexArray
    """Odd lines left out: what shows there is distortion."""
    phases: Array
    """Phase of each joint's lines (n, K) [rad]."""
    crest: Array
    """Peak of each joint's line sum at unit amplitudes (n,)."""

    @property
    def hertz(self) -> Array:
        """Excited lines [Hz] (K,)."""
        return self.excited / self.period_s

    @property
    def seconds(self) -> float:
        """Length of what is played [s]."""
        return self.lead_s + self.periods * self.period_s + self.tail_s

    def accelerations(self, peak: Array, samples: int) -> Array:
        """One period of joint acceleration (samples, n) with peaks (n,) [rad/s², m/s²]."""
        angle = 2 * np.pi * np.outer(np.arange(samples) / samples, self.excited)
        waves = np.cos(angle[:, None] + self.phases).sum(-1)
        found: Array = waves * (peak / self.crest)
        return found

    def played(self, peak: Array, commands: str, pose: Array, inertia: Array, rate: float) -> Array:
        """Commands of all joints over the whole run (T, n), absolute for positions."""
        t = np.arange(round(self.seconds * rate)) / rate
        w = 2 * np.pi * self.hertz
        # The lines' phase is that of the first sample after the lead.
        angle = np.multiply.outer(t - self.lead_s, w)[:, None] + self.phases
        scale = peak / self.crest
        fade = _swelling(t / _FADE_S)[:, None]
        if self.tail_s:
            fade = fade * _swelling((t[-1] - t) / self.tail_s)[:, None]
        found: Array
        if commands == "position":
            found = pose - fade * scale * (np.cos(angle) / w**2).sum(-1)
        elif commands == "velocity":
            found = fade * scale * (np.sin(angle) / w).sum(-1)
        else:
            found = fade * scale * np.diag(inertia) * np.cos(angle).sum(-1)
        return found


def _swelling(u: Array) -> Array:
    """Share from 0 to 1 without a kink: acceleration stays within its limit."""
    u = np.clip(u, 0, 1)
    found: Array = u**3 * (10 - 15 * u + 6 * u**2)
    return found


def multisine(
    n: int,
    highest_hz: float,
    rng: np.random.Generator,
    *,
    period_s: float = 1.0,
    periods: int = 4,
    lead_s: float = 1.0,
) -> Multisine:
    """Draw lines and phases for n joints, up to a highest frequency [Hz].

    Of every three neighbouring odd lines one is left out at random; even lines are never excited.
    A line sum of random phases has a low crest, of several draws the lowest is taken (Pintelon and
    Schoukens, System Identification, 2012, section 5.3).

    Examples
    --------
    >>> signal = multisine(2, 25.0, np.random.default_rng(0))
    >>> bool((signal.excited % 2 == 1).all()), float(signal.hertz.max()) <= 25
    (True, True)
    """
    odd = np.arange(round(LOWEST_HZ * period_s) | 1, highest_hz * period_s + 1e-9, 2).astype(
        np.intp
    )
    if len(odd) < 3:
        raise InvalidSetting(
            f"a bandwidth of {highest_hz:g} Hz leaves {len(odd)} lines from {LOWEST_HZ:g} Hz on; "
            "at least 3 are needed: 8 Hz or more"
        )
    groups = [g for g in np.split(odd, range(3, len(odd), 3)) if len(g) == 3]
    silent = np.array([g[rng.integers(3)] for g in groups], dtype=np.intp)
    excited = np.setdiff1d(odd, silent)
    t = np.arange(1000) / 1000
    phases, crests = [], []
    for _ in range(n):
        tries = rng.uniform(0, 2 * np.pi, (_TRIES, len(excited)))
        waves = np.cos(2 * np.pi * np.multiply.outer(t, excited)[:, None] + tries).sum(-1)
        crest = np.abs(waves).max(0)
        phases.append(tries[crest.argmin()])
        crests.append(crest.min())
    return Multisine(
        period_s=period_s,
        periods=periods,
        lead_s=lead_s,
        tail_s=_FADE_S,
        excited=excited,
        silent=silent,
        phases=np.array(phases),
        crest=np.array(crests),
    )


def peaks(
    signal: Multisine,
    controller: Controller,
    model: PoseModel,
    joints: tuple[str, ...],
    torque_limit: Array,
    *,
    travel: Array | float = np.inf,
) -> Array:
    """Largest peak acceleration of each joint (n,) within all limits [rad/s², m/s²].

    Parameters
    ----------
    travel : ndarray or float
        Room to either side of the pose (n,) [rad, m].
    """
    limit = controller.each("max_torque_nm", joints, torque_limit)
    spare = np.clip(0.7 * limit - np.abs(model.torque), 0.1 * limit, None)
    inertia = np.diag(model.inertia)
    with np.errstate(invalid="ignore"):
        by_torque = _SPARE * spare / inertia
    found = np.minimum(controller.each("max_acceleration_rad_s2", joints), by_torque)
    w = 2 * np.pi * signal.hertz
    angle = np.multiply.outer(np.arange(1000) / 1000 * signal.period_s, w)[:, None] + signal.phases
    for power, most in (
        (-1, controller.each("max_speed_rad_s", joints)),
        (-2, np.broadcast_to(travel, len(joints))),
        (1, controller.each("max_jerk_rad_s3", joints)),
    ):
        turned = angle + power * np.pi / 2
        unit = np.abs((np.cos(turned) * w**power).sum(-1)).max(0) / signal.crest
        found = np.minimum(found, most / unit)
    return found
