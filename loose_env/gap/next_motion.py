"""Next motion: the one that best separates what the runs of a real machine do not tell apart.

A question to the same evidence. Motions are played on the corrected model, measured as the recorded
runs were, and whitened together with them: the expected gain of one is how much further it drives
the predictions of two sets of effects apart, with all tolerances fitted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from math import ceil
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from scipy.linalg import block_diag
from scipy.special import expit

from loose_env.errors import InvalidData
from loose_env.gap.core.balance import USUAL, Balance
from loose_env.gap.core.catalogue import Term, neighbours
from loose_env.gap.core.evidence import grid_of
from loose_env.gap.core.find import Answer, Say, silent
from loose_env.gap.core.identifiability import unexplained
from loose_env.gap.core.motion import Motion as Measured
from loose_env.gap.core.motion import smooth
from loose_env.gap.core.selection import Form, Set, SetFit
from loose_env.gap.core.tolerances import nuisances
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel, addresses
from loose_env.gap.motions import Motion, fitting, loaded_poses, long_motions
from loose_env.gap.output.corrected_model import step_for
from loose_env.gap.runs import steady_activations
from loose_env.gap.servo_arm import SLIDE, MotionLimits, PlannedMotion, followed
from loose_env.gap.simulator import sensed
from loose_env.inference import log_determinant
from loose_env.io import Checked, NonNegative, Positive, json_text, write_text
from loose_env.recording import Recording, Run, table_of, write_csv, write_parquet
from loose_env.typing import Array, IndexArray

CommandMode = Literal["position", "speed", "torque", "none"]
"""What commands of the recording's actuators are; "none" where runs have no commands."""
NEXT_MOTION = "next_motion"  # name of the files, without the ending
FORMAT = "loose-next-motion/1"  # of the JSON file
NOTHING = "nothing"  # what an effect is told from that may not be there
DECIDED = 5.0
"""Log evidence from which a pair is decided [nats]: very strong (Kass and Raftery 1995)."""
_LEAST = 2.0  # gain of a pair below which no motion tells the two apart [nats]
_NARROWED = 0.7
"""Share of an interval above which a motion tells no more than the same runs once more."""
_SHAPES = 3  # shapes in which a rival is tried
_STANDS = 0.05  # speed of a joint in a run over that in the fastest one, below which it stands
_TRIES = 8  # sizes in which a motion of the library is tried
_REPEATS = 2  # how often a motion is recorded: each of the runs is held out in turn
_CONTROL_HZ = 3.0  # bandwidth of the controller that is assumed where the model has no servo [Hz]
_SHORTEST_S = 6.0  # shortest excitation [s]: stretches of it are held out in turn
_SETUP_S = 10.0
"""Time that a recording costs beside its motion [s]: of two motions that separate equally well the
shorter one is taken."""
_RIVALS = 6  # pairs that are compared, the closest first


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


@dataclass(frozen=True, kw_only=True)
class PairGain:
    """Expected gain of a motion for one pair."""

    effect: str
    """Effect of the answer and its location, or "nothing"."""
    rival: str
    """What may be there instead, or beside the answer."""
    so_far_nats: float
    """Log evidence against the rival in the runs so far [nats]."""
    if_effect_nats: float
    """Expected gain of that log evidence if the rival is not there [nats]."""
    if_rival_nats: float
    """Expected gain of the rival if it is there [nats]."""

    @property
    def separates(self) -> bool:
        """Return whether the motion is expected to tell the two apart at all."""
        return self.nats >= _LEAST

    @property
    def nats(self) -> float:
        """Expected gain, by how probable each of the two is now."""
        # Of an effect that may be beside the answer it is that if it is there.
        odds = 0.0 if self.effect == NOTHING else float(expit(self.so_far_nats))
        return odds * self.if_effect_nats + (1 - odds) * self.if_rival_nats


@dataclass(frozen=True, kw_only=True)
class Narrowing:
    """What a motion does to the interval of a named effect."""

    effect: str
    """Effect and its location."""
    share: float
    """Expected share that is left of its intervals."""


@dataclass(frozen=True, kw_only=True)
class NextMotion:
    """The chosen motion and what it is expected to tell: content of ``next_motion.json``."""

    words: str
    """The motion: kind, joints, amplitude and speed."""
    seconds: float
    """Length of one run [s]."""
    repeats: int = _REPEATS
    """How often it is recorded, each as a run of its own, held out in turn."""
    pairs: tuple[PairGain, ...]
    """Expected gain for each open pair."""
    narrowed: tuple[Narrowing, ...] = ()
    """What is left of the intervals of the named effects; empty while pairs are open."""
    checked: tuple[str, ...]
    """What was checked, with the corrected model, and the margins left."""
    motion: Mapping[str, Any]
    """Configuration of the motion."""
    limits: Mapping[str, Any]
    """Limits by joint, and where they come from."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the choice."""
    considered: int
    """Motions that were compared."""
    refused: tuple[tuple[str, str], ...]
    """Motions that do not fit, each with the reason."""
    columns: tuple[str, ...]
    """Columns of the tables."""
    format: str = FORMAT
    """Format of the file."""


@dataclass(frozen=True, eq=False)
class _Gains:
    """What a motion is expected to tell."""

    pairs: tuple[PairGain, ...] = ()
    narrowed: tuple[Narrowing, ...] = ()
    nats: float = 0.0  # Fall of half the log determinant of the covariance of the named effects

    @property
    def value(self) -> float:
        """Worth of a motion: to decide one more pair is better than to decide one twice."""
        return self.nats + sum(float(np.log1p(pair.nats / DECIDED)) for pair in self.pairs)

    @property
    def tells(self) -> bool:
        """Whether anything is told that the same runs once more would not."""
        separated = any(pair.separates for pair in self.pairs)
        return separated or any(each.share < _NARROWED for each in self.narrowed)


@dataclass(frozen=True, eq=False)
class Side:
    """One member of a pair: the effect as it was fitted, and the shapes in which it is fitted."""

    term: Term
    coefficients: Array  # Of its columns
    shapes: tuple[Term, ...]

    @property
    def words(self) -> str:
        """Kind and location."""
        return "{} at {}".format(*self.term.name)


@dataclass(frozen=True, eq=False)
class OpenPair:
    """Two sets of effects that the runs do not tell apart, which differ in one member."""

    effect: Side | None  # The effect of the answer; None for one that may be beside it
    rival: Side  # What may be there
    others: Set  # Effects that both sets have
    nats: float  # Log evidence of the first over the second so far


def open_pairs(answer: Answer) -> tuple[OpenPair, ...]:
    """List what the runs do not tell apart, the closest first.

    An effect and those that explain the data nearly as well in its place; an effect that is not
    named, or not by much, and nothing; an effect that may be beside the answer.
    """
    selection, decision, fit = answer.selection, answer.decision, answer.decision.fit
    evidence, form = selection.evidence, Form(selection, fit.powers, fit)
    found, beside = list[OpenPair](), {(kind, where) for _, kind, where in decision.rivals}

    def side(own: SetFit, term: Term, shapes: Set) -> Side:
        return Side(term, selection.shares(own, term), shapes)

    def against(effect: Side | None, rest: Set, names: Iterable[tuple[str, str]]) -> None:
        """Add pairs of an effect and those of some names, in their best shapes, beside others."""
        for name in sorted(names):
            forms = [t for t in evidence.terms if t.name == name]
            shapes = tuple(t for _, t in selection.screened(form, rest, forms)[:_SHAPES])
            fits = [(selection.solve((*rest, t), fit.powers), t) for t in shapes]
            if allowed := [pair for pair in fits if pair[0].allowed]:
                best, term = min(allowed, key=lambda pair: pair[0].total)
                nats = 0.5 * (best.total - fit.total)
                found.append(OpenPair(effect, side(best, term, shapes), rest, nats))

    for own in decision.findings:
        rest = tuple(term for term in fit.terms if term is not own.term)
        near = neighbours(evidence.balance.machine, own.term.effect.where)
        likely = {name for name in beside if name[1] in near} | set(own.confusable)
        effect = side(fit, own.term, (own.term,))
        against(effect, rest, likely - {t.name for t in fit.terms})
        nats = 0.5 * (fit.total - selection.solve(rest, fit.powers).total)
        if not own.named or nats > -DECIDED:
            found.append(OpenPair(None, effect, rest, nats))
    against(None, fit.terms, beside)
    closest: dict[tuple[str, str], OpenPair] = {}
    for pair in sorted((p for p in found if p.nats < DECIDED), key=lambda p: abs(p.nats)):
        closest.setdefault(pair.rival.term.name, pair)
    return tuple(closest.values())


class Questions:
    """Open pairs, or the values of the named effects, asked of runs that were not made yet.

    Columns are those of the answer: all tolerances, then the effects in question.
    """

    def __init__(self, answer: Answer, pairs: Sequence[OpenPair], player: Player) -> None:
        self.answer, self.pairs, self.player = answer, tuple(pairs), player
        selection, fit = answer.selection, answer.decision.fit
        evidence = selection.evidence
        sides = [s for pair in self.pairs for s in (pair.effect, pair.rival) if s is not None]
        own = [*fit.terms, *(t for s in sides for t in (s.term, *s.shapes))]
        self.terms = tuple({id(term): term for term in own}.values())
        every, free = selection.columns(self.terms), len(evidence.nuisances)
        self._numbers = every[evidence.tolerances :]
        self.precision = np.append(np.ones(free), evidence.precision[self._numbers])
        self.centre = np.append(np.zeros(free), evidence.centre[self._numbers])
        # of the tolerances themselves: a motion may feel what the runs did not
        spread = block_diag(evidence.mixed, np.eye(len(self._numbers)))
        gram = Form(selection, fit.powers).between(every, every)
        gram -= np.diag(evidence.precision[every])
        self.recorded: Array = spread @ gram @ spread.T
        """Gram matrix of the recorded runs at the weights of the answer (K, K)."""
        self._missed = np.zeros(len(self.precision))
        for finding in answer.decision.findings:
            at = evidence.columns_of(finding.term)
            force = evidence.inexact[list(at)] * fit.values[fit.places(at)]
            self._missed[self._at(finding.term)] = force

    def _at(self, *terms: Term) -> IndexArray:
        """Columns of some effects."""
        own = (k for term in terms for k in self.answer.selection.evidence.columns_of(term))
        free = len(self.precision) - len(self._numbers)
        return free + np.searchsorted(self._numbers, np.fromiter(own, dtype=np.intp))

    def _beside(self, terms: Iterable[Term]) -> IndexArray:
        """Columns of the tolerances and of some effects."""
        free = len(self.precision) - len(self._numbers)
        return np.append(np.arange(free), np.unique(self._at(*terms)))

    def gains(self, motion: PlannedMotion) -> _Gains:
        """Expected gains of a motion."""
        joint = self.recorded + self.gram(motion)
        if not self.pairs:
            return self._narrowing(joint)
        found = [
            PairGain(
                effect=NOTHING if pair.effect is None else pair.effect.words,
                rival=pair.rival.words, so_far_nats=pair.nats,
                if_effect_nats=self._apart(pair.effect, pair.rival, pair.others, joint),
                if_rival_nats=self._apart(pair.rival, pair.effect, pair.others, joint),
            )
            for pair in self.pairs
        ]  # fmt: skip
        return _Gains(pairs=tuple(found))

    def gram(self, motion: PlannedMotion) -> Array:
        """Gram matrix along a planned motion, whitened as the recorded runs (K, K)."""
        # Cells in which the laws of the answer miss more than noise say less.
        known = self.answer.selection.evidence
        machine = known.balance.machine
        run = self.player.run(NEXT_MOTION, motion)
        recording = replace(self.answer.recording, runs=(run,))
        balance = Balance(machine, smooth(recording, machine, like=known.balance.motion))
        balance = balance.beside(known.balance.found)  # as the columns of the recorded runs
        balance.residual[:] = 0.0
        changes = {n.name: n.change for n in nuisances(balance, self.answer.settings.tolerances)}
        columns = {k: changes[n.name] for k, n in enumerate(known.nuisances) if n.name in changes}
        for term in self.terms:
            direction = balance.directions[term.contact or USUAL]
            for k, values in zip(self._at(term), term.axes, strict=True):
                forces = balance.forces(term.effect, np.array(values))
                columns[int(k)] = balance.change(np.nan_to_num(forces.with_contact(direction)))
        found = np.zeros_like(self.recorded)
        for channel in range(len(balance.channels)):
            at = [k for k, change in columns.items() if change.reaches(channel)]
            if not at or not self._moves(balance, channel):
                continue
            grid = grid_of(balance, channel)
            rows = grid.whitened(np.stack([columns[k].at(channel) for k in at], axis=1))
            missed = np.bincount(grid.cell, rows**2 @ self._missed[at] ** 2)
            weight = self._weight(channel, grid.turn) * grid.count / (grid.count + missed)
            found[np.ix_(at, at)] += (rows * weight[grid.cell][:, None]).T @ rows
        return found

    def _moves(self, balance: Balance, channel: int) -> bool:
        """Whether a channel says anything: at rest the dry friction of a joint takes any value."""
        if channel >= len(balance.machine.joints):
            return True
        if not balance.seen[:, channel].any() or not grid_of(balance, channel).pieces:
            return False
        known = self.answer.selection.evidence.balance.usual[channel]
        return bool(balance.usual[channel] > _STANDS * max(balance.usual[channel], known))

    def _weight(self, channel: int, turn: Array) -> Array:
        """Weight of each cell: that of its band in the answer's fit of the recorded runs (C,)."""
        selection, powers = self.answer.selection, self.answer.decision.fit.powers
        for k, known in enumerate(selection.evidence.channels):
            if known.joint == channel:
                turns, band = np.unique(known.turn, return_inverse=True)
                counted = np.bincount(band, known.count)
                total = np.bincount(band, known.count * selection.weights(k, powers[k]))
                return np.interp(np.log(turn), np.log(turns), total / counted)
        return np.ones(len(turn))

    def _apart(self, true: Side | None, other: Side | None, rest: Set, joint: Array) -> float:
        """Half of the squared distance that a motion adds between one set and the other [nats]."""
        # Of what one effect does, in noise standard deviations, beyond the other effect in any of
        # its shapes, the common effects and all tolerances.
        if true is None:
            return 0.0
        at, force, ends = self._at(true.term), true.coefficients, np.full(2, np.inf)
        for shape in [()] if other is None else [(shape,) for shape in other.shapes]:
            numbers = self._beside((*rest, *shape))
            # common effects may change by their priors; a law begins at its size
            centre = np.where(np.isin(numbers, self._at(*shape)), self.centre[numbers], 0.0)
            for k, gram in enumerate((self.recorded, joint)):
                cross = gram[:, at] @ force
                square, slope = np.array([force @ cross[at]]), cross[numbers][:, None]
                normal, prior = gram[np.ix_(numbers, numbers)], np.diag(self.precision[numbers])
                ends[k] = min(ends[k], *unexplained(square, slope, normal, prior, centre))
        return 0.5 * max(float(ends[1] - ends[0]), 0.0)

    def _narrowing(self, joint: Array) -> _Gains:
        """Fall of the covariance of the named effects beside all others and the tolerances."""
        numbers = self._beside(self.answer.decision.fit.terms)
        named = [f.term for f in self.answer.decision.findings if f.named]
        of = [np.searchsorted(numbers, self._at(term)) for term in named]
        inner, prior = np.concatenate(of), np.diag(self.precision[numbers])
        before, after = (
            np.linalg.inv(gram[np.ix_(numbers, numbers)] + prior) for gram in (self.recorded, joint)
        )
        shares = np.sqrt(np.diag(after) / np.diag(before))
        means = (float(np.exp(np.log(shares[at]).mean())) for at in of)
        words = ("{} at {}".format(*term.name) for term in named)
        found = [Narrowing(effect=w, share=s) for w, s in zip(words, means, strict=True)]
        fall = [log_determinant(np.asarray(w[np.ix_(inner, inner)])) for w in (before, after)]
        return _Gains(narrowed=tuple(found), nats=0.5 * (fall[0] - fall[1]))


def limits_of(
    machine: NominalModel, motion: Measured, settings: NextMotionSettings
) -> MotionLimits:
    """Collect the limits: of the settings, else of the model, else what the recording showed."""
    model: mujoco.MjModel = machine.model
    unit, home = np.where(machine.hinges, 1.0, SLIDE), np.array(motion.runs[0].position[0])
    limited, reach = model.jnt_limited.astype(bool), settings.next_reach_rad * unit
    low = np.where(limited, model.jnt_range[:, 0], home - reach)
    high = np.where(limited, model.jnt_range[:, 1], home + reach)
    known = ("joint limits of the model", "--next-reach-rad")
    of_range = ", else ".join(known) if limited.any() else known[1]
    stated = _stated_speed(model, unit)
    if settings.next_max_speed_rad_s > 0:
        speed, of_speed = settings.next_max_speed_rad_s * unit, "--next-max-speed-rad-s"
    elif stated is not None:
        speed, of_speed = stated, "max_speed_rad_s of the model"
    else:
        seen, of_speed = np.abs(motion.stacked("speed")).max(axis=0), "the fastest of the runs"
        # a joint that never moved may move as fast as others
        speed = np.where(seen > 0.05 * seen.max(), seen, max(float(seen.max()), 0.1))
    return MotionLimits(
        joints=machine.joints, turning=machine.hinges, rate=1 / _interval(motion), home=home,
        low=np.minimum(low, home), high=np.maximum(high, home), speed=speed,
        torque=settings.next_torque_share * machine.torque_limits,
        sources=(
            known[0] if limited.all() else of_range, of_speed,
            f"{settings.next_torque_share:g} of the drives' limits",
        ),
    )  # fmt: skip


def _interval(motion: Measured) -> float:
    """Interval of the log's samples [s]."""
    return float(np.median([run.log_step for run in motion.runs]))


def _stated_speed(model: mujoco.MjModel, unit: Array) -> Array | None:
    """Speed limits that a model states as a custom number (joints,); None if it does not."""
    stated = {(own := model.numeric(k)).name: own.data for k in range(model.nnumeric)}
    if (told := stated.get("max_speed_rad_s")) is None:
        return None
    if told.size not in (1, len(unit)):
        raise InvalidData(
            f"max_speed_rad_s of the model has {told.size} values; it must have one, or one for "
            f"each of the {len(unit)} joints (of a slide in m/s)"
        )
    return np.asarray(told * unit if told.size == 1 else told, dtype=float)


def drive_of(machine: NominalModel) -> CommandMode:
    """Return what the commands of a model's actuators are."""
    kinds: set[CommandMode] = {
        "position" if place else "speed" if rate else "torque"
        for place, rate in machine.model.actuator_biasprm[:, 1:3]
    }
    if len(kinds) > 1:
        raise InvalidData(
            f"the actuators of the model take {' and '.join(sorted(kinds))} commands; a motion is "
            "written for actuators of one kind"
        )
    return kinds.pop() if kinds else "none"


class Player:
    """Plays desired positions on the corrected model, in the columns of a recording.

    Raises
    ------
    InvalidData
        If the runs have neither commands nor torques, or the actuators differ in kind.
    """

    def __init__(
        self, recording: Recording, machine: NominalModel, motion: Measured, corrected: Hypothesis
    ) -> None:
        self.machine = machine
        forms = {run.form for run in motion.runs}
        if forms == {"free"}:
            raise InvalidData(
                "the recorded runs have neither commands nor torques, so that no command is known "
                "to move the machine; record runs with ctrl. or torque. columns for --next"
            )
        self.drive: CommandMode = drive_of(machine) if "forward" in forms else "none"
        self._interval = _interval(motion)
        step = min(machine.time_step, step_for(machine, corrected))
        parts = ceil(self._interval / step - 1e-9)
        self._model = corrected.model(
            machine, self._interval / parts, released=self.drive == "none"
        )
        self._at, self._dofs = addresses(self._model, machine.joints)
        common = set.intersection(*(set(run.sensors) for run in recording.runs))
        self._sensors = [name for name in machine.sensors if name in common]
        self._torques = set().union(*(run.torques for run in recording.runs))

    def play(self, desired: Array) -> PlannedMotion:
        """Play desired joint positions (T, joints), sampled as the recording, on the model."""
        model, data, at, dofs = self._model, mujoco.MjData(self._model), self._at, self._dofs
        count, gears = len(self.machine.actuators), self.machine.moments
        rates = np.gradient(desired, self._interval, axis=0)
        turn, inertias = 2 * np.pi * _CONTROL_HZ, self.machine.inertias
        data.qpos[at] = desired[0]
        given = {"position": desired, "speed": rates}.get(self.drive)
        if given is not None:
            data.act[:] = steady_activations(model, given[0] @ gears)

        def command(row: int) -> None:
            if given is not None:
                data.ctrl[:count] = given[row] @ gears
                return
            # without servos a controller follows the motion
            off, late = desired[row] - data.qpos[at], rates[row] - data.qvel[dofs]
            effort = data.qfrc_bias[dofs] - data.qfrc_passive[dofs]
            effort = effort + inertias * (turn**2 * off + 2 * turn * late)
            if self.drive == "torque":
                data.ctrl[:count] = np.linalg.lstsq(gears, effort, rcond=None)[0]
            else:
                data.qfrc_applied[dofs] = effort

        held = given is not None
        return followed(model, data, desired, self._interval, (at, dofs), command, held=held)

    def run(self, name: str, motion: PlannedMotion) -> Run:
        """Motion in the recording's columns."""
        joints, controls, torques = self.machine.joints, dict[str, Array](), dict[str, Array]()
        sensors = {name: sensed(self._model, name, motion.readings) for name in self._sensors}
        if self.drive == "none":
            torques = {j: motion.torque[:, k] for k, j in enumerate(joints) if j in self._torques}
        else:
            controls = dict(zip(self.machine.actuators, motion.controls.T, strict=False))
        return Run(name=name, time=motion.time, controls=controls, sensors=sensors, torques=torques)


def choose_next(
    answer: Answer,
    corrected: Hypothesis,
    settings: NextMotionSettings | None = None,
    *,
    motions: Sequence[Motion] | None = None,
    say: Say = lambda _: None,
) -> tuple[NextMotion, Run] | None:
    """Choose the motion with the largest expected gain per time; None where none tells more.

    Parameters
    ----------
    answer : Answer
        What the model lacks.
    corrected : Hypothesis
        The named effects at their values, on which motions are played.
    settings : NextMotionSettings, optional
        Limits of the motion.
    motions : sequence of Motion, optional
        Motions to choose from; by default the library of the arm.
    say : callable
        Receives progress messages, line by line.

    Returns
    -------
    NextMotion, Run
        The motion with what it is expected to tell, and as a run of the recording: its commands,
        and the readings that are expected of the machine.

    Raises
    ------
    InvalidData
        If the runs have neither commands nor torques, or no motion keeps the limits.
    """
    settings = settings or NextMotionSettings()
    balance = answer.selection.evidence.balance
    with silent():
        pairs = open_pairs(answer)[:_RIVALS]
        if not pairs and not any(f.named for f in answer.decision.findings):
            say("next motion: nothing is missing and nothing is open; none is needed")
            return None
        player = Player(answer.recording, balance.machine, balance.motion, corrected)
        limits = limits_of(balance.machine, balance.motion, settings)
        found, refused = _played(player, limits, settings, motions)
        say(f"next motion: {len(found)} motions, {len(pairs)} open pairs")
        questions = Questions(answer, pairs, player)
        told = [questions.gains(planned) for _, planned in found]
        seconds = [planned.time[-1] + _SETUP_S for _, planned in found]
        best = int(np.argmax(np.divide([gains.value for gains in told], seconds)))
        (motion, planned), gains = found[best], told[best]
    if not gains.tells:
        say("next motion: none tells more than the same runs once more")
        return None
    run = player.run(NEXT_MOTION, planned)
    chosen = NextMotion(
        words=motion.described(limits.joints), seconds=float(planned.time[-1]), pairs=gains.pairs,
        narrowed=gains.narrowed, checked=limits.notes(planned), motion=asdict(motion),
        limits={
            "joints": list(limits.joints), "first_pose": limits.home.tolist(),
            **{name: getattr(limits, name).tolist() for name in ("low", "high", "speed", "torque")},
            "sources": dict(zip(("position", "speed", "torque"), limits.sources, strict=True)),
        },
        settings=asdict(settings), considered=len(found), refused=refused,
        columns=tuple(table_of(run)),
    )  # fmt: skip
    return chosen, run


def _played(
    player: Player,
    limits: MotionLimits,
    settings: NextMotionSettings,
    wanted: Sequence[Motion] | None,
) -> tuple[list[tuple[Motion, PlannedMotion]], tuple[tuple[str, str], ...]]:
    """Motions that keep the limits under the corrected model, and the reasons of the others."""
    unit, machine, tries = limits.unit, player.machine, 1
    fast = replace(limits, speed=unit * np.max(limits.speed / unit))  # slower ones are reduced
    if wanted is None:
        tries, least = _TRIES, min(_SHORTEST_S, settings.next_seconds)
        torque = np.where(np.isfinite(limits.torque), limits.torque, machine.load_scales)
        every = np.arange(len(limits.joints))
        poses = loaded_poses(machine.model, limits.home, every, limits, torque)
        wanted = [replace(m, seconds=max(m.seconds, least)) for m in long_motions(*poses)]

    def checked(motion: Motion) -> tuple[PlannedMotion | None, str]:
        desired = motion.commands(fast)
        if len(desired) > settings.next_seconds * limits.rate + 1:
            return None, f"it takes longer than {settings.next_seconds:g} s"
        planned = player.play(desired)
        return planned, limits.refusal(planned)

    found, others = fitting(wanted, checked, tries)
    refused = tuple((motion.described(limits.joints), reason) for motion, reason in others)
    if not found:
        raise InvalidData(
            f"no motion fits the machine; of {len(refused)} tried the first does not, since "
            f"{refused[0][1]}"
        )
    return found, refused


def write_next_motion(folder: Path, motion: NextMotion, run: Run) -> list[Path]:
    """Write ``next_motion.csv``, ``next_motion.parquet`` and ``next_motion.json``.

    The tables have the columns of a run of the recording: the time, the commands in each actuator's
    unit, and the readings that are expected of the machine.
    """
    table = table_of(run)
    files = [folder / f"{NEXT_MOTION}.{ending}" for ending in ("csv", "parquet", "json")]
    write_csv(files[0], table)
    write_parquet(files[1], table)
    write_text(files[2], json_text(asdict(motion)))
    return files


def next_motion_lines(motion: NextMotion) -> list[str]:
    """Lines on a motion for a reader: what it is, what it tells, what was checked."""
    found = [
        f"next motion: {NEXT_MOTION}.csv ({motion.seconds:.0f} s: {motion.words}), recorded "
        f"{motion.repeats} times, {motion.repeats * motion.seconds:.0f} s in all"
    ]
    for pair in motion.pairs:
        if pair.separates and pair.effect == NOTHING:
            found.append(f"  shows {pair.rival} if it is there: expected gain {pair.nats:.0f} nats")
        elif pair.separates:
            found.append(
                f"  separates {pair.effect} from {pair.rival}: expected gain "
                f"{pair.if_effect_nats:.0f} nats ({pair.if_rival_nats:.0f} if it is the other); "
                f"{pair.so_far_nats:.1f} so far"
            )
        elif pair.effect != NOTHING:
            found.append(f"  does not separate {pair.effect} from {pair.rival}")
    found += [f"  narrows {n.effect} to {n.share:.0%} of its interval" for n in motion.narrowed]
    found.append(f"  checked with the corrected model: {'; '.join(motion.checked)}")
    return found
