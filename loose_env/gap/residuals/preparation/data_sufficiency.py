"""Notes on recordings that are too short or have too little motion to identify effects."""

from __future__ import annotations

from math import ceil

import numpy as np

from loose_env.gap.residuals.residual_model import LONGEST, SHORTEST, ResidualModel
from loose_env.gap.settings import (
    ACCEPTED_Z,
    CONFIRMED_Z,
    MOVING,
    SPARE_BLOCKS,
)
from loose_env.statistics import noise_floor


def sufficiency_notes(fitted: ResidualModel, held: ResidualModel) -> list[str]:
    """Describe shortfalls of the data in sentences; none if the data suffice.

    An improvement of k standard deviations over blocks of time needs k² blocks that all agree.
    """
    found = []
    for which, comparison, improvement in (
        ("to fit to", fitted, ACCEPTED_Z),
        ("held out", held, CONFIRMED_Z),
    ):
        lengths = [float(trial.time[-1]) for trial in comparison.trials]
        blocks = len(np.unique(comparison.rows.block))
        needed = ceil(SPARE_BLOCKS * improvement**2)
        if blocks < needed:
            more = (needed - blocks) * min(max(sum(lengths) / max(blocks, 1), SHORTEST), LONGEST)
            found.append(
                f"the runs {which} last {sum(lengths):.2g} s in all, {blocks} blocks that count as "
                f"independent; to be sure of an effect {needed} are needed: record at least "
                f"{more:.1g} s more of them"
            )
    machine = fitted.machine
    driven = set(machine.actuated_joint.values()) or set(machine.joints)
    for joint in machine.joints:
        ranges = [_range(trial.motion[joint]) for trial in fitted.trials if joint in trial.motion]
        if joint in driven and ranges and max(ranges) < MOVING:
            found.append(
                f"{joint} hardly moves in the runs to fit to: friction, play, springs and "
                "inertias there cannot be seen, nor told from those of its neighbours. Record a "
                "run in which it turns round several times, slowly and fast"
            )
    return found


def _range(values: np.ndarray) -> float:
    """Range of motion of a joint, over the noise of its sensor."""
    floor = noise_floor(values)
    if not np.isfinite(floor) or floor <= 0:
        return float("inf")
    low, high = np.nanquantile(values, (0.005, 0.995))
    return float((high - low) / floor)
