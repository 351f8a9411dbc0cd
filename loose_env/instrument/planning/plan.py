"""Plan of a session's next step: pose, joint, signal to play, expected observations, warnings.

`plan` takes a model and what is known so far, a `loose_env.instrument.result.Diagnosis` or
nothing, and says what to measure next and what to expect. Where the diagnosis says already what
to measure next, that is what is planned.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.instrument.model.clearance import Ground
from loose_env.instrument.model.holding_commands import why_not_held
from loose_env.instrument.model.instrumented_arm import InstrumentedArm, read_arm
from loose_env.instrument.model.motion_limits import MotionLimits, motion_limits
from loose_env.instrument.planning.excitation import unlimited
from loose_env.instrument.planning.expected_observations import Expected, expected_of
from loose_env.instrument.planning.next_measurement import next_measurement
from loose_env.instrument.planning.plan_warnings import plan_warnings, shown_position
from loose_env.instrument.planning.prior_knowledge import Known, known_of
from loose_env.instrument.planning.rationale import other_settings, why_not_reached
from loose_env.instrument.planning.signals.band_choice import best_band, level_cap, within_bandwidth
from loose_env.instrument.planning.signals.signal import Signal, make_signal
from loose_env.instrument.planning.signals.transit import Transit, transit
from loose_env.instrument.result import Diagnosis, NextMeasurement
from loose_env.instrument.settings.arm_and_plan import ModelSettings, PlanSettings
from loose_env.instrument.settings.command_line import unlike
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.instrument.settings.thresholds import DETECTABLE_Z, LEAST_LEVEL
from loose_env.typing import Array

_ONCE = ("joint", "pose_deg", "from_deg")
"""Settings that are for one measurement, not for a session."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Plan of the next measurement."""

    arm: InstrumentedArm
    """The arm."""
    next: NextMeasurement
    """Pose, joints, band, levels, length and why."""
    signals: tuple[Signal, ...]
    """Signal of each joint to be excited."""
    expected: Mapping[str, Expected]
    """Expected observation of the first record under each hypothesis."""
    warnings: tuple[str, ...]
    """Warnings, in sentences."""
    limits: MotionLimits
    """Limits of the controller, with their sources."""
    transit: Transit
    """Move from the present pose to that of the runs."""
    start_origin: str
    """Origin of the present pose."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Everything that the plan depends on besides the model and the diagnosis."""
    again: Mapping[str, Any] = field(default_factory=dict)
    """Those of them that the next plan of the session has to be given again."""

    @property
    def pose(self) -> Array:
        """Joint positions, base first [rad or m] (n,)."""
        return np.array([self.next.pose[name] for name in self.arm.joints])


def next_for(
    arm: InstrumentedArm,
    known: Diagnosis | Known | None = None,
    settings: NextSettings | None = None,
    own: PlanSettings | None = None,
    motion: MotionSettings | None = None,
) -> NextMeasurement:
    """Choose the next measurement, clear of collisions and of the ground.

    What `plan` uses, and what a diagnosis can put into `Diagnosis.next`, so that both agree.

    Parameters
    ----------
    arm : InstrumentedArm
        From `read_arm`.
    known : Diagnosis or Known, optional
        Prior knowledge; none by default. `Diagnosis.next` is ignored.
    settings : NextSettings, optional
        Settings of the choice.
    own : PlanSettings, optional
        Choices that the user fixes.
    motion : MotionSettings, optional
        Limits of the controller and its commands; none by default.

    Returns
    -------
    NextMeasurement

    Raises
    ------
    InvalidData
        If the diagnosis is of another model, or no pose will do.

    Examples
    --------
    >>> from loose_env.arms import DESK_ARM
    >>> desk = read_arm(DESK_ARM)
    >>> first = next_for(desk, settings=NextSettings(poses=2))
    >>> set(first.pose) == set(desk.joints)
    True
    """
    rules = NextSettings() if settings is None else settings
    own = PlanSettings() if own is None else own
    nominal = arm.nominal
    so_far = known_of(known, arm.links, arm.joints) if isinstance(known, Diagnosis) else known
    ground = Ground.of(nominal, rules.ground_m)
    # A pose that somebody has decided on is looked at with a warning alone.
    stays_above = not own.pose_deg

    def allowed(pose: Array) -> bool:
        if not ground.clear(pose) or arm.collisions.touch(pose):
            return False
        return not why_not_held(arm, pose)

    def reachable(here: Array, pose: Array) -> bool:
        if arm.collisions.touch_between(here, pose):
            return False
        return not stays_above or ground.clear_between(here, pose)

    cap = None
    if motion is not None:
        limits = motion_limits(arm, motion)
        rules = within_bandwidth(rules, nominal.band, limits)
        cap = level_cap(arm, arm.linear, limits, motion.commands)
    return next_measurement(
        nominal,
        arm.linear,
        so_far,
        rules,
        links=arm.links,
        joints=arm.joints,
        allowed=allowed,
        reachable=reachable,
        start=_start(arm, so_far, own)[0],
        shakable=[d.joint for d in arm.drives if d is not None],
        only=own.joint,
        pose=_typed(arm, "pose_deg", own.pose_deg),
        cap=cap,
    )


def plan(
    model: str | Path,
    known: Diagnosis | None = None,
    *,
    arm: ModelSettings | None = None,
    choice: NextSettings | None = None,
    own: PlanSettings | None = None,
    motion: MotionSettings | None = None,
) -> Plan:
    """Plan the next step of a session.

    Parameters
    ----------
    model : str or Path
        MJCF or URDF of the arm.
    known : Diagnosis, optional
        Prior knowledge; none by default.
    arm : ModelSettings, optional
        Properties that the file lacks.
    choice : NextSettings, optional
        Settings of the choice of the pose; length, rate and noise of records. By default those of
        the diagnosis; with others the measurement is chosen anew.
    own : PlanSettings, optional
        Layout of the signal, and choices that the user fixes.
    motion : MotionSettings, optional
        Limits of the controller, kind of commands and files.

    Returns
    -------
    Plan
        The same for the same model, diagnosis and settings.

    Raises
    ------
    InvalidSetting, InvalidData, UnknownName
        If the model cannot be used, the diagnosis is of another one, or no pose will do.

    Examples
    --------
    >>> plan("no_model.xml")
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidSetting: there is no file 'no_model.xml' in ...
    """
    if choice is None:
        choice = NextSettings() if known is None else known.choice
    own = PlanSettings() if own is None else own
    instrumented = read_arm(model, arm)
    so_far = None if known is None else known_of(known, instrumented.links, instrumented.joints)
    motion = MotionSettings() if motion is None else motion
    limits = motion_limits(instrumented, motion)
    rules = within_bandwidth(choice, instrumented.nominal.band, limits)
    asked = None if known is None else known.next
    chosen, anew = asked, ""
    if asked is not None:
        anew = _why_anew(instrumented, so_far, asked, rules, own)
        anew = anew or _too_limited(instrumented, asked, limits, motion)
    if chosen is None or anew:
        chosen = next_for(instrumented, so_far, choice, own, motion)
    wanted = chosen.band_hz
    chosen, signals, narrowed = _signals(instrumented, so_far, chosen, rules, own, motion, limits)
    expected = expected_of(instrumented, instrumented.linear, so_far, chosen, rules)
    start, origin = _start(instrumented, so_far, own)
    pose = np.array([chosen.pose[name] for name in instrumented.joints])
    usual = (ModelSettings(), NextSettings(), PlanSettings(), MotionSettings())
    given = (arm or ModelSettings(), choice, own, motion)
    again = {
        k: v for one, two in zip(given, usual, strict=True) for k, v in unlike(one, two).items()
    }
    return Plan(
        arm=instrumented,
        next=chosen,
        signals=signals,
        expected=expected,
        warnings=(
            *([f"not what the diagnosis asks for next: {anew}"] if anew else ()),
            *_narrower(wanted, chosen.band_hz, narrowed),
            *plan_warnings(instrumented, known, chosen, signals, choice, expected),
        ),
        limits=limits,
        transit=transit(instrumented, start, pose, limits, signals[0].rate_hz),
        start_origin=origin,
        settings={name: value for one in given for name, value in asdict(one).items()},
        again={name: value for name, value in again.items() if name not in _ONCE},
    )


def _signals(
    arm: InstrumentedArm,
    so_far: Known | None,
    chosen: NextMeasurement,
    choice: NextSettings,
    own: PlanSettings,
    motion: MotionSettings,
    limits: MotionLimits,
) -> tuple[NextMeasurement, tuple[Signal, ...], str]:
    """Measurement with the band and levels of its signals, the signals, what narrows the band."""
    pose = np.array([chosen.pose[name] for name in arm.joints])
    seed = np.random.SeedSequence([choice.seed, 0 if so_far is None else len(so_far.records), 1])
    children = seed.spawn(len(chosen.joints))
    weights = {} if so_far is None else so_far.probabilities
    played = [arm.joints.index(joint) for joint in chosen.joints]
    torques = unlimited(arm.nominal, arm.linear, pose, played, chosen, choice)

    def made(number: int, band: tuple[float, float], torque: float) -> Signal:
        return make_signal(
            arm,
            arm.linear,
            pose,
            chosen.joints[number],
            torque_rms=torque,
            band=band,
            seconds=chosen.seconds,
            rate=limits.command_rate_hz or chosen.rate_hz,
            ramp=own.ramp_s,
            hold=own.hold_s,
            rng=np.random.default_rng(children[number]),
            torque_share=choice.torque_share,
            limits=limits,
            kind=motion.commands,
        )

    def judged(signal: Signal, band: tuple[float, float]) -> float:
        one = replace(
            chosen,
            band_hz=band,
            joints=(signal.joint,),
            levels=(signal.joint_rms,),
            torques=(signal.torque_rms,),
        )
        seen = expected_of(arm, arm.linear, so_far, one, choice)
        return float(
            sum(
                weights.get(name, 1.0) * min(each.deviations / DETECTABLE_Z, 1.0)
                for name, each in seen.items()
            )
        )

    first, band, narrowed = best_band(
        lambda band, torque: made(0, band, torque),
        judged,
        chosen.band_hz,
        torques[0],
        seconds=chosen.seconds,
        most_tool=choice.most_tool,
    )
    others = (made(k, band, torques[k]) for k in range(1, len(chosen.joints)))
    signals = (first, *others)
    chosen = replace(
        chosen,
        band_hz=band,
        levels=tuple(signal.joint_rms for signal in signals),
        torques=tuple(signal.torque_rms for signal in signals),
    )
    return chosen, signals, narrowed


def _narrower(
    wanted: tuple[float, float], played: tuple[float, float], limit: str
) -> tuple[str, ...]:
    """Warning about a band that limits have made narrower."""
    if played == wanted:
        return ()
    return (
        f"the band ends at {played[1]:.4g} Hz instead of {wanted[1]:.4g} Hz: {limit}, "
        "and at lower frequencies more torque keeps within that",
    )


def _start(arm: InstrumentedArm, so_far: Known | None, own: PlanSettings) -> tuple[Array, str]:
    """Present pose (n,) [rad or m], and where it is known from."""
    given = _typed(arm, "from_deg", own.from_deg)
    if given is not None:
        return given, "as given"
    if so_far is not None and so_far.records:
        return so_far.records[-1].pose, "the pose of the last run"
    return arm.home, "the model's first keyframe or reference, for none is given with --from-deg"


def _why_anew(
    arm: InstrumentedArm,
    so_far: Known | None,
    asked: NextMeasurement,
    choice: NextSettings,
    own: PlanSettings,
) -> str:
    """Reason why the plan differs from the diagnosis's proposal; "" if it does not."""
    given = [name for name in _ONCE if getattr(own, name) not in (None, ())]
    given += other_settings(asked, choice)
    if given:
        return f"another {', '.join(given)} is given here"
    here = so_far.records[-1].pose if so_far and so_far.records else arm.home
    ground = Ground.of(arm.nominal, choice.ground_m)
    blocked = why_not_reached(arm, ground, here, asked)
    return f"its pose is not taken, {blocked}" if blocked else ""


def _too_limited(
    arm: InstrumentedArm, asked: NextMeasurement, limits: MotionLimits, motion: MotionSettings
) -> str:
    """Reason why the controller's limits forbid the diagnosis's proposal; "" if they do not."""
    cap = level_cap(arm, arm.linear, limits, motion.commands)
    pose = arm.pose_of(asked.pose)
    for joint, torque in zip(asked.joints, asked.torques, strict=True):
        share = cap(pose, arm.joints.index(joint), asked.band_hz) / max(torque, 1e-12)
        if share < LEAST_LEVEL:
            return f"the controller's limits leave {share:.0%} of the level that it asks for"
    return ""


def _typed(arm: InstrumentedArm, name: str, given: tuple[float, ...]) -> Array | None:
    """A pose as it was typed in: degrees, and millimetres where a joint slides."""
    if not given:
        return None
    nominal = arm.nominal
    if len(given) != nominal.n or not np.isfinite(given).all():
        raise InvalidSetting(
            f"{name} has one finite number for each of {', '.join(arm.joints)}, got {given}"
        )
    pose = np.where(nominal.sliding, np.array(given) * 1e-3, np.radians(given))
    outside = np.flatnonzero(~nominal.within_ranges(pose))
    if len(outside):
        j = int(outside[0])
        allowed = nominal.joint_ranges[j]
        assert allowed is not None
        raise InvalidSetting(
            f"{name}: joint {arm.joints[j]} at {given[j]:g} is outside its range "
            f"{shown_position(nominal.sliding[j], allowed[0])} to "
            f"{shown_position(nominal.sliding[j], allowed[1])}"
        )
    return np.asarray(pose)
