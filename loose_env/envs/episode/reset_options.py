"""Options of `reset`, and a true arm that differs from the nominal one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, Mismatch, MismatchDraw
from loose_env.envs.faults.sampler import FaultSampler
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults import KINDS, SEVERAL_FAULTS, Fault, hypotheses, is_fault, preloaded
from loose_env.io import is_finite

__all__ = ["ResetOptions", "checked_true_arm"]


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
    """Return whether values are equal, numbers to rounding."""
    if isinstance(own, np.ndarray):
        return bool(np.array_equal(own, np.asarray(other)))
    if isinstance(own, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(own) == len(other) and all(map(_alike, own, other))
    if isinstance(own, float) and isinstance(other, float):
        return bool(np.isclose(own, other, rtol=1e-9, atol=1e-12))
    return own == other


_KNOWN = ("fault", "pose", "mismatch_scale", "preload_g")


@dataclass(frozen=True, kw_only=True, eq=False)
class ResetOptions:
    """Options of one episode; what is not given is drawn as ever."""

    arm: Arm
    fault: Fault | str | None = None
    """A fault, or the name of a hypothesis under which to draw one."""
    pose: NDArray[np.float64] | None = None
    """First pose [rad, m where a joint slides] (n,)."""
    mismatch_scale: float = 1.0
    """Factor on the standard deviations of the mismatch [1]."""
    preload_g: float = 0.0
    """Constant load on every loose seat, over the weight it carries [1]."""

    @classmethod
    def of(cls, given: Mapping[str, Any] | None, arm: Arm) -> ResetOptions:
        """Check the options that a user gave.

        Raises
        ------
        UnknownName
            If there is no such option or no such fault.
        InvalidSetting
            If a pose does not fit the arm, or a number is none.

        Examples
        --------
        >>> from loose_env.arms import planar
        >>> ResetOptions.of({"fault": "backlash@joint2", "mismatch_scale": 3}, planar(2)).fault
        'backlash@joint2'
        """
        if given is not None and not isinstance(given, Mapping):
            raise InvalidSetting(
                "options of reset() are a mapping such as {'fault': 'healthy'}, got "
                f"{given!r:.60}"
            )
        options = dict(given or {})
        unknown = set(options) - set(_KNOWN)
        if unknown:
            raise UnknownName(
                f"unknown reset options {sorted(unknown, key=str)}; known: {', '.join(_KNOWN)}"
            )
        scale = _number("mismatch_scale", options.get("mismatch_scale"), 1.0)
        if scale < 0:
            raise InvalidSetting(f"mismatch_scale is a factor, zero or more; got {scale:g}")
        return cls(
            arm=arm,
            fault=_fault(options.get("fault"), arm),
            pose=_pose(options.get("pose"), arm),
            mismatch_scale=scale,
            preload_g=_number("preload_g", options.get("preload_g"), 0.0),
        )

    def hidden_fault(self, sampler: FaultSampler, rng: np.random.Generator) -> Fault:
        """Return the fault to hide; it takes from ``rng`` only what is to be drawn."""
        fault = self.fault
        if fault is None:
            fault = sampler.draw(rng)
        elif fault == SEVERAL_FAULTS:
            fault = sampler.several(rng)
        elif isinstance(fault, str):
            fault = sampler.draw(rng, hypothesis=fault)
        return preloaded(self.arm, fault, self.preload_g) if self.preload_g else fault

    def first_pose(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the pose to start in; drawn from ``rng`` if none was given."""
        return self.arm.random_pose(rng) if self.pose is None else self.pose

    def true_arm(self, mismatch: Mismatch, rng: np.random.Generator) -> MismatchDraw:
        """Draw how the true arm differs from the nominal one.

        The same generator gives the same draw at every scale, only larger or smaller.
        """
        scale = self.mismatch_scale
        return (mismatch if scale == 1 else mismatch.scaled(scale)).draw(self.arm, rng)


def _number(name: str, given: Any, default: float) -> float:
    if given is None:
        return default
    if not is_finite(given):
        raise InvalidSetting(f"{name} must be a finite number, got {given!r}")
    return float(given)


def _fault(given: Any, arm: Arm) -> Fault | str | None:
    """Check a fault; it may lie outside the hypotheses of the environment."""
    if given is None or is_fault(given):
        return given  # type: ignore[no-any-return]
    names = (*hypotheses(arm, KINDS, everywhere=True), SEVERAL_FAULTS)
    if isinstance(given, str) and given in names:
        return given
    raise UnknownName(
        f"unknown fault {given!r}; give a fault of loose_env.faults or one of {list(names)}"
    )


def _pose(given: Any, arm: Arm) -> NDArray[np.float64] | None:
    if given is None:
        return None
    try:
        pose = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        pose = np.empty(0)
    if pose.shape != (arm.n,) or not np.isfinite(pose).all():
        raise InvalidSetting(f"a pose is {arm.n} finite numbers [rad or m], got {given!r}")
    if not arm.within_ranges(pose).all():
        ranges = [r and (float(r[0]), float(r[1])) for r in arm.joint_ranges]
        raise InvalidSetting(f"pose {pose.tolist()} leaves the joint ranges {ranges} [rad or m]")
    return arm.wrap(pose)
