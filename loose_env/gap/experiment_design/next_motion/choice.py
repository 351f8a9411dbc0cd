"""Choice of the next motion: the largest expected gain per time over pairs not yet told apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from loose_env.arms import quiet
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap.experiment_design.library import motion_library
from loose_env.gap.experiment_design.motions import Motion
from loose_env.gap.experiment_design.next_motion.expected_gain import GainModel, Gains, value_of
from loose_env.gap.experiment_design.next_motion.limits import MotionLimits, limits_of
from loose_env.gap.experiment_design.next_motion.motion_trials import MotionRuns, Played
from loose_env.gap.experiment_design.next_motion.open_pairs import (
    NOTHING,
    Hypotheses,
    words_of,
)
from loose_env.gap.experiment_design.next_motion.settings import NextMotionSettings
from loose_env.gap.experiment_design.servo_arm import Sensing, ServoArm
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.progress import counted
from loose_env.gap.residuals.residual_model import ResidualModel

_AT_A_TIME = 4
"""Motions whose gains are worked out together, the most promising first."""
_WORKED_OUT = 12
"""Most motions whose gains are worked out with all parameters: a matter of cost."""
_SERVO_HZ = 3.0
"""Bandwidth of the servos that stand in for a controller where the model has none [Hz]."""
_LEAST = 2.0
"""Gain of a pair below which no motion tells the two apart [nats]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A motion as the corrected model plays it."""

    motion: Motion
    """Its configuration."""
    played: Played
    """Commands, and what the model does."""


@dataclass(frozen=True, kw_only=True)
class PairGain:
    """Expected gain of a motion for one pair."""

    effect: str
    """Effect of the answer and its location, or "nothing"."""
    rival: str
    """What may be there instead."""
    so_far_nats: float
    """Log evidence of the answer over the rival in the runs so far [nats]."""
    if_effect_nats: float
    """Expected gain of that log evidence if the answer is right [nats]."""
    if_rival_nats: float
    """Expected gain of the rival if it is right [nats]."""

    @property
    def separates(self) -> bool:
        """Return whether the motion is expected to tell the two apart at all."""
        return self.nats >= _LEAST

    @property
    def nats(self) -> float:
        """Expected gain, by how probable each of the two is now.

        Of an effect that the runs would not show it is that if the effect is there.
        """
        if self.effect == NOTHING:
            return self.if_rival_nats
        odds = 1.0 / (1.0 + float(np.exp(-np.clip(self.so_far_nats, -50.0, 50.0))))
        return odds * self.if_effect_nats + (1 - odds) * self.if_rival_nats


@dataclass(frozen=True, kw_only=True, eq=False)
class NextMotion:
    """The chosen motion."""

    candidate: Candidate
    """The motion."""
    gains: tuple[PairGain, ...]
    """Expected gain for each open pair."""
    checked: tuple[str, ...]
    """What was checked, with the margins."""
    limits: MotionLimits
    """Limits that it keeps."""
    considered: int
    """Motions that were compared."""
    refused: tuple[tuple[str, str], ...]
    """Motions that were left out, each with the reason."""
    runs: MotionRuns
    """Predicts runs of it."""

    @property
    def seconds(self) -> float:
        """Length [s]."""
        return self.candidate.played.seconds

    @property
    def description(self) -> str:
        """The motion with the names of its joints."""
        return motion_words(self.candidate.motion, self.limits.joints)


def motion_words(motion: Motion, joints: Sequence[str]) -> str:
    """A motion with the names of its joints."""
    which = "all joints" if len(motion.joints) == len(joints) > 1 else (
        ", ".join(joints[j] for j in motion.joints)
    )  # fmt: skip
    pose = "" if motion.centre is None else " about ({})".format(
        ", ".join(f"{value:.2f}" for value in motion.centre)
    )  # fmt: skip
    return f"{motion.kind.replace('_', ' ')} of {which}{pose}, {motion.amplitude:.2g} rad"


def choose_motion(
    comparison: ResidualModel,
    hypotheses: Hypotheses,
    settings: NextMotionSettings | None = None,
    *,
    motions: Sequence[Motion] | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> NextMotion | None:
    """Choose the motion with the largest expected gain over the open pairs per time."""
    settings = settings or NextMotionSettings()
    if not hypotheses.pairs:
        return None
    answer = hypotheses.answer.hypothesis.of_model
    with quiet():
        runs = MotionRuns(comparison, answer, hypotheses.weights)
        if runs.form == "free":
            raise InvalidData(
                "the recorded runs have neither commands nor torques, so that no command is known "
                "to move the machine; record runs with ctrl. or torque. columns for --next"
            )
        limits = limits_of(comparison.machine, comparison.trials, settings)
        arm = _arm(comparison.machine, limits, runs.rate)
        wanted = motions_for(arm, settings) if motions is None else tuple(motions)
        candidates, refused = _played(wanted, arm, runs, limits, settings)
        if not candidates:
            raise InvalidData(
                f"no motion fits the machine; of {len(wanted)} tried the first does not, since "
                f"{refused[0][1]}"
            )
        say(f"next motion: {len(candidates)} motions, {len(hypotheses.pairs)} open pairs")
        model = GainModel(hypotheses, runs)
        best, gains = _best(model, candidates, hypotheses, settings)
        gains = model.confirmed(best.played, gains)
    rows = zip(hypotheses.pairs, gains.if_answer, gains.if_rival, strict=True)
    pairs = tuple(
        PairGain(
            effect=words_of(pair.effect),
            rival=words_of(pair.rival),
            so_far_nats=pair.nats,
            if_effect_nats=max(ahead, 0.0),
            if_rival_nats=max(behind, 0.0),
        )
        for pair, ahead, behind in rows
    )
    if not any(pair.separates for pair in pairs):
        return None
    return NextMotion(
        candidate=best,
        gains=pairs,
        checked=limits.notes(best.played),
        limits=limits,
        considered=len(candidates),
        refused=tuple(refused),
        runs=runs,
    )


def motions_for(arm: ServoArm, settings: NextMotionSettings) -> tuple[Motion, ...]:
    """The library of an arm, each motion long enough, without those that are too long."""
    least = min(settings.next_least_seconds, settings.next_seconds)
    found = (replace(m, seconds=max(m.seconds, least)) for m in motion_library(arm, brief=False))
    return tuple(m for m in dict.fromkeys(found) if m.seconds <= settings.next_seconds)


def _played(
    wanted: Sequence[Motion],
    arm: ServoArm,
    runs: MotionRuns,
    limits: MotionLimits,
    settings: NextMotionSettings,
) -> tuple[list[Candidate], list[tuple[str, str]]]:
    """Motions that fit the limits under the corrected model, and the reasons of the others."""
    found, refused = [], []
    for motion in counted("motions checked", wanted):
        words = motion_words(motion, limits.joints)
        try:
            desired = motion.commands(arm)
        except InvalidSetting as error:
            refused.append((words, str(error)))
            continue
        if len(desired) / runs.rate > settings.next_seconds + 1.0 / runs.rate:
            refused.append((words, f"it takes longer than {settings.next_seconds:g} s"))
            continue
        played = runs.played(desired)
        reason = limits.refusal(played)
        if reason:
            refused.append((words, reason))
        else:
            found.append(Candidate(motion=motion, played=played))
    return found, refused


def _best(
    model: GainModel,
    candidates: Sequence[Candidate],
    hypotheses: Hypotheses,
    settings: NextMotionSettings,
) -> tuple[Candidate, Gains]:
    """Motion of the largest value per time; only those whose bound is promising are worked out."""

    def rate(candidate: Candidate, gains: Gains) -> float:
        seconds = candidate.played.seconds + settings.next_setup_s
        return value_of(gains, hypotheses.pairs) / seconds

    bounds = model.bounds([each.played for each in candidates])
    hopes = [rate(each, gains) for each, gains in zip(candidates, bounds, strict=True)]
    order = sorted(range(len(candidates)), key=lambda k: -hopes[k])
    best: tuple[float, int, Gains] = (-1.0, order[0], bounds[order[0]])
    for first in range(0, min(len(order), _WORKED_OUT), _AT_A_TIME):
        group = order[first : first + _AT_A_TIME]
        taken = [k for k in group if hopes[k] > best[0] and _promising(bounds[k])]
        if not taken:
            break
        for k, gains in zip(taken, model.gains([candidates[k].played for k in taken]), strict=True):
            value = rate(candidates[k], gains)
            if value > best[0]:
                best = value, k, gains
    return candidates[best[1]], best[2]


def _promising(gains: Gains) -> bool:
    """Return whether a motion may tell any pair apart."""
    return max(*gains.if_answer, *gains.if_rival) >= _LEAST


def _arm(machine: NominalModel, limits: MotionLimits, rate: float) -> ServoArm:
    """The machine for the library: servos where it has none, its own home pose and ranges."""
    spec = machine.spec.copy()
    for key in list(spec.keys):
        spec.delete(key)
    servos = all(machine.model.actuator_biasprm[:, 1] != 0) and machine.model.nu > 0
    if not servos:
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        stiffness = machine.inertias * (2 * np.pi * _SERVO_HZ) ** 2
        for joint, stiff, inertia in zip(machine.joints, stiffness, machine.inertias, strict=True):
            servo = spec.add_actuator(
                name=f"servo of {joint}", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            servo.set_to_position(kp=float(stiff), kv=float(2 * inertia * 2 * np.pi * _SERVO_HZ))
    for k, joint in enumerate(machine.joints):
        own = spec.joint(joint)
        own.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        own.range = [float(limits.low[k]), float(limits.high[k])]
    gears = np.stack([machine.gears(j) for j in machine.joints])
    control = limits.home @ gears if servos else limits.home
    spec.add_key(name="home", qpos=limits.home.tolist(), ctrl=control.tolist())
    return ServoArm(spec, Sensing(rate=rate), max_speed=float(np.max(limits.speed)))
