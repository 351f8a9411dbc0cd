"""What `reset` can be asked for: a fault, a pose, a larger mismatch, a load on the seat."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, Mismatch, MismatchDraw
from loose_env.envs.faults.sampler import FaultSampler
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults import KINDS, SEVERAL_FAULTS, Fault, hypotheses, is_fault, preloaded

__all__ = ["ResetOptions"]

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
    if (
        isinstance(given, (bool, np.bool_))
        or not isinstance(given, Real)
        or not np.isfinite(float(given))
    ):
        raise InvalidSetting(f"{name} must be a finite number, got {given!r}")
    return float(given)


def _fault(given: Any, arm: Arm) -> Fault | str | None:
    """Check a fault; it may lie outside the hypotheses of the environment."""
    if given is None or is_fault(given):
        return given  # type: ignore[no-any-return]
    names = (*hypotheses(arm, KINDS), SEVERAL_FAULTS)
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
