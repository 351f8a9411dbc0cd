"""The next step of a session at the arm: the pose, the joint and the signal to play.

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

from loose_env.diagnosis import propose_excitation
from loose_env.errors import InvalidSetting
from loose_env.instrument.model.clearance import Ground
from loose_env.instrument.model.holding_commands import why_not_held
from loose_env.instrument.model.instrumented_arm import InstrumentedArm, read_arm
from loose_env.instrument.planning.candidate_poses import pose_range
from loose_env.instrument.planning.expected_observations import Expected, expected_of
from loose_env.instrument.planning.next_measurement import next_measurement
from loose_env.instrument.planning.prior_knowledge import Known, known_of
from loose_env.instrument.planning.rationale import other_settings, why_not_reached
from loose_env.instrument.planning.signals.signal import Signal, make_signal
from loose_env.instrument.result import Diagnosis, NextMeasurement
from loose_env.instrument.settings.arm_and_plan import ModelSettings, PlanSettings
from loose_env.instrument.settings.command_line import unlike
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.thresholds import NOTED_SAG_DEG, NOTED_SAG_M, SCALED_LEVEL
from loose_env.typing import Array

__all__ = ["Plan", "next_for", "plan"]


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

    start = _typed(arm, "from_deg", own.from_deg)
    if start is None and not (so_far and so_far.records):
        start = arm.home
    return next_measurement(
        nominal,
        arm.linear,
        so_far,
        rules,
        links=arm.links,
        joints=arm.joints,
        allowed=allowed,
        reachable=reachable,
        start=start,
        shakable=[d.joint for d in arm.drives if d is not None],
        only=own.joint,
        pose=_typed(arm, "pose_deg", own.pose_deg),
    )


def plan(
    model: str | Path,
    known: Diagnosis | None = None,
    *,
    arm: ModelSettings | None = None,
    choice: NextSettings | None = None,
    own: PlanSettings | None = None,
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
    asked = None if known is None else known.next
    chosen, anew = asked, ""
    if asked is not None:
        anew = _why_anew(instrumented, so_far, asked, choice, own)
    if chosen is None or anew:
        chosen = next_for(instrumented, so_far, choice, own)
    linear = instrumented.linear
    pose = np.array([chosen.pose[name] for name in instrumented.joints])
    seed = np.random.SeedSequence([choice.seed, 0 if so_far is None else len(so_far.records), 1])
    signals = tuple(
        make_signal(
            instrumented,
            linear,
            pose,
            joint,
            torque_rms=torque,
            band=chosen.band_hz,
            seconds=chosen.seconds,
            rate=chosen.rate_hz,
            ramp=own.ramp_s,
            hold=own.hold_s,
            rng=np.random.default_rng(child),
            torque_share=choice.torque_share,
        )
        for joint, torque, child in zip(
            chosen.joints, chosen.torques, seed.spawn(len(chosen.joints)), strict=True
        )
    )
    chosen = replace(
        chosen,
        levels=tuple(signal.joint_rms for signal in signals),
        torques=tuple(signal.torque_rms for signal in signals),
    )
    return Plan(
        arm=instrumented,
        next=chosen,
        signals=signals,
        expected=expected_of(instrumented, linear, so_far, chosen, choice),
        warnings=(
            *([f"not what the diagnosis asks for next: {anew}"] if anew else ()),
            *_warnings(instrumented, known, chosen, signals, choice),
        ),
        settings={**asdict(arm or ModelSettings()), **asdict(choice), **asdict(own)},
        again={
            **unlike(arm or ModelSettings(), ModelSettings()),
            **unlike(choice, NextSettings()),
            **{k: v for k, v in unlike(own, PlanSettings()).items() if k not in _ONCE},
        },
    )


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
            f"{_shown(nominal.sliding[j], allowed[0])} to {_shown(nominal.sliding[j], allowed[1])}"
        )
    return np.asarray(pose)


def _sags(arm: InstrumentedArm, signal: Signal) -> list[str]:
    """Warnings about servos that sag under the weight of the arm."""
    sliding = arm.nominal.sliding
    noted = np.where(sliding, NOTED_SAG_M, np.radians(NOTED_SAG_DEG))
    far = [
        f"{arm.joints[j]} by {_shown(sliding[j], abs(float(signal.sags[j])))}"
        for j in np.flatnonzero(np.abs(signal.sags) > noted)
    ]
    if not far:
        return []
    return [
        f"servos sag under the arm's weight: {', '.join(far)}. The signal begins with the "
        "pose as its command, makes up for that before the noise and goes back after it; a "
        "controller that holds joints exactly where it is told would move the arm by so much"
    ]


def _shown(slides: np.bool_, value: float) -> str:
    return f"{value * 1e3:.4g} mm" if slides else f"{np.degrees(value):.4g} degrees"


def _warnings(
    arm: InstrumentedArm,
    known: Diagnosis | None,
    chosen: NextMeasurement,
    signals: tuple[Signal, ...],
    choice: NextSettings,
) -> tuple[str, ...]:
    said: list[str] = []
    pose = np.array([chosen.pose[name] for name in arm.joints])
    if known is not None and known.settled:
        said.append(
            f"the diagnosis is settled: {known.fault.hypothesis} with {known.probability:.1%}; "
            "this measurement would only confirm it"
        )
    unseen = arm.collisions.unseen
    if unseen:
        said.append(
            f"the model has no shapes of {', '.join(unseen)}: what they touch is not known; look "
            "before the arm moves"
        )
    if not arm.collisions.known:
        said.append(
            "the model has no shapes that collide: nothing is known about collisions; look before "
            "the arm moves, and take another pose with --pose-deg if it would touch anything"
        )
    touching = arm.collisions.touch(pose)
    if touching:
        said.append(f"in this pose the model's bodies touch: {', '.join(touching)}")
    if not Ground.of(arm.nominal, choice.ground_m).clear(pose):
        said.append("in this pose a part of the arm is below its base or the ground given")
    low, high = pose_range(arm.nominal, 0.0)
    for j in np.flatnonzero((pose < low + 1e-3) | (pose > high - 1e-3)):
        said.append(f"joint {arm.joints[j]} is at the end of its range")
    said += _sags(arm, signals[0])
    for signal in signals:
        if signal.scale < SCALED_LEVEL:
            said.append(
                f"{signal.joint} is shaken at {signal.scale:.0%} of the level: {signal.limited_by}"
            )
    said += [
        note
        for note in arm.with_joint_names(propose_excitation(arm.nominal, pose).warnings)
        if not note.startswith("the lowest holding mode")  # above its modes an arm is free
    ]
    if arm.hold != "model":
        said.append(
            f"joints are taken to be held by {arm.held_by}; 'loose diagnose' assumes what "
            "the model's actuators do, so put such springs into the model"
        )
    return tuple(dict.fromkeys((*said, *arm.notes)))
