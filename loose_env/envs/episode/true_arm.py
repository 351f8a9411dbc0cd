"""A true arm beside the nominal one: what is measured, where the nominal model lacks an effect.

The difficulty's mismatch covers a model whose figures are a little off. A model that lacks an
effect, such as a spring in a drive, is another matter: the arm that is measured then has a spec of
its own. Faults and mismatch are drawn for the true arm; what is predicted, commanded and observed
rests on the nominal one. So with one true arm every nominal arm meets the same hidden faults.
"""

from __future__ import annotations

import numpy as np

from loose_env.arms import Arm
from loose_env.errors import InvalidSetting

__all__ = ["checked_true_arm"]


def checked_true_arm(true_arm: Arm | None, arm: Arm) -> Arm:
    """Return the arm that is measured: the nominal one where none is given.

    Parameters
    ----------
    true_arm : Arm, optional
        The arm that is measured. Its drives carry what gravity puts on it, as servos do.
    arm : Arm
        The nominal arm.

    Raises
    ------
    InvalidSetting
        If they differ in their joints, ranges, tool axes or band: a pose or a record of one would
        mean something else on the other.

    Examples
    --------
    >>> from loose_env.arms import planar, with_compliance
    >>> checked_true_arm(with_compliance(planar(2), mode_hz=60.0), planar(2)).name
    'planar2-compliant'
    >>> checked_true_arm(planar(3), planar(2))
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidSetting: the true arm 'planar3' differs from the nominal arm \
'planar2' in joints: ('joint1', 'joint2', 'joint3') and ('joint1', 'joint2')...
    """
    if true_arm is None:
        return arm
    if not isinstance(true_arm, Arm):
        raise InvalidSetting(f"true_arm is an Arm, as `arm_from_file` makes it; got {true_arm!r}")
    for name in ("joints", "sliding", "joint_ranges", "axes", "band"):
        own, other = getattr(true_arm, name), getattr(arm, name)
        if not _alike(own, other):
            raise InvalidSetting(
                f"the true arm {true_arm.name!r} differs from the nominal arm {arm.name!r} in "
                f"{name}: {own} and {other}; both are to be moved and read alike"
            )
    if (true_arm.shaker is None) != (arm.shaker is None) or true_arm.probes != arm.probes:
        raise InvalidSetting(
            f"the true arm {true_arm.name!r} has another shaker or other probes than the nominal "
            f"arm {arm.name!r}; both are to be moved and read alike"
        )
    return true_arm


def _alike(own: object, other: object) -> bool:
    """Whether figures are the same, numbers to rounding."""
    if isinstance(own, np.ndarray):
        return bool(np.array_equal(own, np.asarray(other)))
    if isinstance(own, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(own) == len(other) and all(map(_alike, own, other))
    if isinstance(own, float) and isinstance(other, float):
        return bool(np.isclose(own, other, rtol=1e-9, atol=1e-12))
    return own == other
