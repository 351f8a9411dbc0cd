"""Next motion: the one that best separates what the runs of a real machine do not tell apart.

A question to the same evidence. Motions are played on the corrected model, measured as the recorded
runs were, and whitened together with them: the expected gain of one is how much further it drives
the predictions of two sets of effects apart, with all tolerances fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.core.balance import Balance
from loose_env.gap.core.catalogue import Term, terms_of
from loose_env.gap.core.evidence import Channel, Evidence, whiten
from loose_env.gap.core.find import Answer, silent
from loose_env.gap.core.identifiability import unexplained
from loose_env.gap.core.motion import smooth
from loose_env.gap.core.selection import Selection, Set, SetFit, neighbours
from loose_env.gap.core.tolerances import nuisances
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.motions import Motion, long_motions, scaled_until
from loose_env.gap.planned_motion import (
    MotionLimits,
    NextMotionSettings,
    PlannedMotion,
    Player,
    limits_of,
)
from loose_env.inference import log_determinant
from loose_env.io import json_text, restored, whole_of, write_text
from loose_env.recording import Run, table_of, write_csv, write_parquet
from loose_env.typing import Array, IndexArray

Say = Callable[[str], None]
NEXT_MOTION = "next_motion"
"""Name of the files, without the ending."""
FORMAT = "loose-next-motion/1"
"""Format of the JSON file."""
NOTHING = "nothing"
"""What an effect is told from that may not be there."""
DECIDED = 5.0
"""Log evidence from which a pair is decided [nats]: very strong (Kass and Raftery 1995)."""
_LEAST = 2.0
"""Gain of a pair below which no motion tells the two apart [nats]."""
_NARROWED = 0.7
"""Share of an interval above which a motion tells no more than the same runs once more."""
_SHAPES = 3
"""Shapes in which a rival is tried."""
_STANDS = 0.05
"""Speed of a joint in a run over that in the fastest one, below which it stands."""
_MEMORY = 40_000_000
"""Numbers of columns that are held at a time, 320 MB."""
_TRIES = 8
"""Sizes in which a motion of the library is tried."""
_REPEATS = 2
"""How often a motion is recorded: each of the runs is held out in turn."""


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
        """Expected gain, by how probable each of the two is now.

        Of an effect that may be beside the answer it is that if it is there.
        """
        if self.effect == NOTHING:
            return self.if_rival_nats
        odds = 1.0 / (1.0 + float(np.exp(-np.clip(self.so_far_nats, -50.0, 50.0))))
        return odds * self.if_effect_nats + (1 - odds) * self.if_rival_nats


@dataclass(frozen=True, kw_only=True)
class Narrowing:
    """What a motion does to the interval of a named effect."""

    effect: str
    """Effect and its location."""
    share: float
    """Expected share that is left of its intervals."""


@dataclass(frozen=True, kw_only=True)
class Gains:
    """What a motion is expected to tell."""

    pairs: tuple[PairGain, ...] = ()
    """Gain for each open pair."""
    narrowed: tuple[Narrowing, ...] = ()
    """What is left of the intervals of the named effects."""
    nats: float = 0.0
    """Fall of half the log determinant of their covariance."""

    @property
    def value(self) -> float:
        """Worth of a motion: by open pairs, each by the logarithm of its gain over what decides it.

        The logarithm prefers to decide one more pair to deciding one twice.
        """
        if not self.pairs:
            return self.nats
        return sum(float(np.log1p(pair.nats / DECIDED)) for pair in self.pairs)

    @property
    def tells(self) -> bool:
        """Return whether anything is told that the same runs once more would not."""
        if self.pairs:
            return any(pair.separates for pair in self.pairs)
        return any(each.share < _NARROWED for each in self.narrowed)


@dataclass(frozen=True, eq=False)
class Side:
    """One member of a pair: the effect with its values, and the shapes in which it is fitted."""

    term: Term
    values: Array
    shapes: tuple[Term, ...]

    @property
    def words(self) -> str:
        """Kind and location."""
        return "{} at {}".format(*self.term.name)


@dataclass(frozen=True, eq=False)
class OpenPair:
    """Two sets of effects that the runs do not tell apart, which differ in one member."""

    effect: Side | None
    """The effect of the answer; None for one that may be beside it."""
    rival: Side
    """What may be there."""
    others: Set
    """Effects that both sets have."""
    nats: float
    """Log evidence of the first over the second so far."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NextMotion:
    """The chosen motion."""

    motion: Motion
    """Its configuration."""
    planned: PlannedMotion
    """Commands, and what the corrected model does."""
    gains: Gains
    """What it is expected to tell."""
    limits: MotionLimits
    """Limits that it keeps."""
    considered: int
    """Motions that were compared."""
    refused: tuple[tuple[str, str], ...]
    """Motions that were left out, each with the reason."""
    run: Run
    """The motion as a run of the recording."""
    settings: NextMotionSettings
    """Settings of the choice."""


def open_pairs(answer: Answer) -> tuple[OpenPair, ...]:
    """List what the runs do not tell apart, the closest first.

    An effect and those that explain the data nearly as well in its place; an effect that is not
    named, or not by much, and nothing; an effect that may be beside the answer.
    """
    selection, decision = answer.selection, answer.decision
    fit = decision.fit
    machine, form = selection.evidence.balance.machine, selection.whole(fit.powers, fit)
    found, beside = [], {(kind, where) for _, kind, where in decision.rivals}
    rests = {t: tuple(o for o in fit.terms if o is not t) for t in fit.terms}
    sides = {f.term: Side(f.term, f.values, (f.term,)) for f in decision.findings}
    for own in decision.findings:
        near = neighbours(machine, own.term.effect.where)
        likely = {name for name in beside if name[1] in near} | set(own.confusable)
        for name in sorted(likely - {t.name for t in fit.terms}):
            rival = _fitted(selection, form, rests[own.term], name, fit)
            if rival is not None:
                nats = 0.5 * (rival[1].total - fit.total)
                found.append(OpenPair(sides[own.term], rival[0], rests[own.term], nats))
        nats = 0.5 * (fit.total - selection.solve(rests[own.term], fit.powers).total)
        if not own.named or nats > -DECIDED:
            found.append(OpenPair(None, sides[own.term], rests[own.term], nats))
    for name in sorted(beside):
        more = _fitted(selection, form, fit.terms, name, fit)
        if more is not None:
            nats = 0.5 * (more[1].total - fit.total)
            found.append(OpenPair(None, more[0], fit.terms, nats))
    closest: dict[tuple[str, str], OpenPair] = {}
    for pair in sorted((p for p in found if p.nats < DECIDED), key=lambda p: abs(p.nats)):
        closest.setdefault(pair.rival.term.name, pair)
    return tuple(closest.values())


def _fitted(
    selection: Selection, form: Any, rest: Set, name: tuple[str, str], fit: SetFit
) -> tuple[Side, SetFit] | None:
    """Effect of a name beside others, in its best shapes; None if none is allowed."""
    forms = [t for t in selection.evidence.terms if t.name == name]
    shapes = tuple(t for _, t in selection.screened(form, rest, forms)[:_SHAPES])
    fits = [(selection.solve((*rest, t), fit.powers), t) for t in shapes]
    fits = [(own, t) for own, t in fits if own.allowed]
    if not fits:
        return None
    best, term = min(fits, key=lambda pair: pair[0].total)
    own = np.searchsorted(best.numbers, selection.evidence.columns_of(term))
    return Side(term, term.values(best.values[own]), shapes), best


class Questions:
    """Open pairs, or the values of the named effects, asked of runs that were not made yet."""

    def __init__(self, answer: Answer, pairs: Sequence[OpenPair], player: Player) -> None:
        self.answer, self.pairs, self.player = answer, tuple(pairs), player
        self._named = tuple(f.term for f in answer.decision.findings if f.named)

    @cached_property
    def _terms(self) -> dict[int, Term]:
        """All effects in question, by identity."""
        found = list(self.answer.decision.fit.terms)
        for pair in self.pairs:
            found += [t for side in (pair.effect, pair.rival) if side for t in side.shapes]
        return {id(term): term for term in found}

    @cached_property
    def _sides(self) -> list[Side]:
        """Effects that are predicted at their values."""
        own = [Side(f.term, f.values, (f.term,)) for f in self.answer.decision.findings]
        return [*own, *(s for p in self.pairs for s in (p.effect, p.rival) if s is not None)]

    def gains(self, motions: Sequence[PlannedMotion]) -> list[Gains]:
        """Expected gains of motions, as many together as memory holds."""
        evidence = self.answer.selection.evidence
        thin = round(evidence.balance.motion.step * self.player.rate)
        columns = len(evidence.nuisances) + len(self._terms) + len(self._sides)
        most = _MEMORY // (columns * len(evidence.balance.channels))
        groups: list[list[PlannedMotion]] = [[]]
        room = most
        for motion in motions:
            samples = len(motion.time) // thin
            if samples > room and groups[-1]:
                groups.append([])
                room = most
            groups[-1].append(motion)
            room -= samples
        return [found for group in groups for found in self._together(group)]

    def _together(self, motions: Sequence[PlannedMotion]) -> list[Gains]:
        """Gains of motions that are whitened beside the recorded runs."""
        recording, settings = self.answer.recording, self.answer.settings
        machine = self.answer.selection.evidence.balance.machine
        names = [f"{NEXT_MOTION} {k}" for k in range(len(motions))]
        more = (self.player.run(n, m, noise=True) for n, m in zip(names, motions, strict=True))
        motion = smooth(replace(recording, runs=(*recording.runs, *more)), machine)
        balance = Balance(machine, motion)
        again = {key: _again(balance, term) for key, term in self._terms.items()}
        at_values = {id(side): _at_values(balance, side) for side in self._sides}
        terms = [t for t in (*again.values(), *at_values.values()) if t is not None]
        tolerances = nuisances(balance, settings.tolerances)
        evidence = whiten(balance, terms, tolerances, law=settings.tolerances.law)
        grams = self._grams(evidence, {k: t for k, t in at_values.items() if t is not None})
        new = [k for k, run in enumerate(motion.runs) if run.name in names]
        order = {run.name: k for k, run in enumerate(motion.runs)}
        old = grams.sum(axis=0) - grams[new].sum(axis=0)
        asked = _Asked(evidence, again, at_values)
        return [self._of(asked, old, old + grams[order[name]]) for name in names]

    def _grams(self, evidence: Evidence, predicted: Mapping[int, Term]) -> Array:
        """Gram matrix of all columns in each run (runs, K, K), cells weighted as in the answer.

        Cells in which the laws of the answer miss more than noise say less.
        """
        found = np.zeros((len(evidence.balance.motion.runs), *2 * [len(evidence.centre)]))
        own = [
            evidence.columns_of(predicted[id(side)])[0]
            for side in self._sides[: len(self.answer.decision.findings)]
            if id(side) in predicted
        ]
        for channel in evidence.channels:
            at, weight = channel.columns, self._weight(evidence, channel)
            among = np.flatnonzero(np.isin(at, own))
            missed = evidence.inexact[at[among]] ** 2 * channel.square[:, among]
            weight = weight * channel.count / (channel.count + missed.sum(axis=1))
            for run in _moving(evidence.balance, channel):
                every = np.arange(len(at))
                own_cells = weight * (channel.run == run)
                found[run][np.ix_(at, at)] += channel.products(own_cells, every, every)
        return found

    def _weight(self, evidence: Evidence, channel: Channel) -> Array:
        """Weight of each cell: that of its band in the answer's fit of the recorded runs (C,)."""
        selection, powers = self.answer.selection, self.answer.decision.fit.powers
        for k, known in enumerate(selection.evidence.channels):
            if known.joint == channel.joint:
                turns, band = np.unique(known.turn, return_inverse=True)
                counted = np.bincount(band, known.count)
                total = np.bincount(band, known.count * selection.weights(k, powers[k]))
                return np.interp(np.log(channel.turn), np.log(turns), total / counted)
        return np.ones(len(channel.count))

    def _of(self, asked: _Asked, old: Array, joint: Array) -> Gains:
        """Gains of one motion by the Gram matrices without and with it."""
        if not self.pairs:
            return asked.narrowing(self._named, self.answer.decision.fit.terms, old, joint)
        found = []
        for pair in self.pairs:
            ahead = asked.apart(pair.effect, pair.rival, pair.others, old, joint)
            behind = asked.apart(pair.rival, pair.effect, pair.others, old, joint)
            found.append(
                PairGain(
                    effect=NOTHING if pair.effect is None else pair.effect.words,
                    rival=pair.rival.words, so_far_nats=pair.nats, if_effect_nats=ahead,
                    if_rival_nats=behind,
                )
            )  # fmt: skip
        return Gains(pairs=tuple(found))


def _moving(balance: Balance, channel: Channel) -> list[int]:
    """Runs of a channel in which its joint moves: at rest its dry friction takes any value."""
    if channel.joint >= len(balance.machine.joints):
        return sorted({int(run) for run in channel.run})
    speeds = np.array([
        np.percentile(np.abs(own[:, channel.joint]), 95)
        for own in balance.motion.split(balance.speed)
    ])  # fmt: skip
    return [int(run) for run in np.flatnonzero(speeds > _STANDS * speeds.max())]


def _again(balance: Balance, term: Term) -> Term | None:
    """The same effect with its columns along another motion; None if that does not show it."""
    found = terms_of(balance, term.effect, term.axes, term.law, (term.contact,))
    return found[0] if found else None


def _at_values(balance: Balance, side: Side) -> Term | None:
    """One column: the force of an effect at its values."""
    values = (tuple(map(float, side.values)),)
    found = terms_of(balance, side.term.effect, values, True, (side.term.contact,))
    return found[0] if found else None


@dataclass(frozen=True, eq=False)
class _Asked:
    """Effects in question in the evidence of recorded and planned runs."""

    evidence: Evidence
    again: Mapping[int, Term | None]
    at_values: Mapping[int, Term | None]

    def columns(self, terms: Sequence[Term]) -> IndexArray:
        """Columns of some effects, those of the tolerances first."""
        seen = (self.again[id(term)] for term in terms)
        own = {k for term in seen if term is not None for k in self.evidence.columns_of(term)}
        return np.array([*range(self.evidence.tolerances), *sorted(own)], dtype=np.intp)

    def apart(
        self, true: Side | None, other: Side | None, rest: Set, old: Array, joint: Array
    ) -> float:
        """Half of the squared distance that a motion adds between one set and the other [nats].

        Of what one effect does, in noise standard deviations, beyond the other effect in any of
        its shapes, the common effects and all tolerances.
        """
        term = None if true is None else self.at_values[id(true)]
        if term is None:
            return 0.0
        at = self.evidence.columns_of(term)[0]
        shapes: list[Set] = [()] if other is None else [(shape,) for shape in other.shapes]
        ends = [min(self._left(gram, at, rest, shape) for shape in shapes) for gram in (old, joint)]
        return 0.5 * max(ends[1] - ends[0], 0.0)

    def _left(self, gram: Array, at: int, rest: Set, shape: Set) -> float:
        """Squared distance of a column from what a set of effects can do, and what that costs."""
        numbers = self.columns((*rest, *shape))
        precision = self.evidence.precision[numbers]
        # common effects may change by their priors; a law begins at its size
        own = np.isin(numbers, self.columns(shape)[self.evidence.tolerances :])
        centre = np.where(own, self.evidence.centre[numbers], 0.0)
        normal, cross = gram[np.ix_(numbers, numbers)], gram[numbers, at][:, None]
        return float(unexplained(gram[at, [at]], cross, normal, np.diag(precision), centre)[0])

    def narrowing(self, named: Set, terms: Set, old: Array, joint: Array) -> Gains:
        """Fall of the covariance of named effects beside all others and the tolerances."""
        numbers = self.columns(terms)
        wanted = self.columns(named)[self.evidence.tolerances :]
        inner = np.searchsorted(numbers, wanted)
        prior = np.diag(self.evidence.precision[numbers])
        wholes = (np.linalg.inv(gram[np.ix_(numbers, numbers)] + prior) for gram in (old, joint))
        before, after = (np.asarray(whole[np.ix_(inner, inner)], float) for whole in wholes)
        shares = 0.5 * np.log(np.diag(after) / np.diag(before))
        found = []
        for term in named:
            own = np.isin(wanted, self.columns((term,)))
            if own.any():
                share = float(np.exp(shares[own].mean()))
                found.append(Narrowing(effect="{} at {}".format(*term.name), share=share))
        nats = 0.5 * (log_determinant(before) - log_determinant(after))
        return Gains(narrowed=tuple(found), nats=float(nats))


def choose_next(
    answer: Answer,
    corrected: Hypothesis,
    settings: NextMotionSettings | None = None,
    *,
    motions: Sequence[Motion] | None = None,
    say: Say = lambda _: None,
) -> NextMotion | None:
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

    Raises
    ------
    InvalidData
        If the runs have neither commands nor torques, or no motion keeps the limits.
    """
    settings = settings or NextMotionSettings()
    balance = answer.selection.evidence.balance
    with silent():
        pairs = open_pairs(answer)[: settings.next_rivals]
        if not pairs and not any(f.named for f in answer.decision.findings):
            say("next motion: nothing is missing and nothing is open; none is needed")
            return None
        player = Player(answer.recording, balance.machine, balance.motion, corrected)
        limits = limits_of(balance.machine, balance.motion, settings)
        fitting, refused = _played(player, limits, settings, motions)
        say(f"next motion: {len(fitting)} motions, {len(pairs)} open pairs")
        questions = Questions(answer, pairs, player)
        chosen, gains = _best(questions, [planned for _, planned in fitting], settings)
    if not gains.tells:
        say("next motion: none tells more than the same runs once more")
        return None
    motion, planned = fitting[chosen]
    return NextMotion(
        motion=motion, planned=planned, gains=gains, limits=limits, considered=len(fitting),
        refused=refused, run=player.run(NEXT_MOTION, planned), settings=settings,
    )  # fmt: skip


def _best(
    questions: Questions, planned: Sequence[PlannedMotion], settings: NextMotionSettings
) -> tuple[int, Gains]:
    """Motion of the largest gain per time, with its gains if it alone is recorded."""
    rates = [
        gains.value / (motion.seconds + settings.next_setup_s)
        for motion, gains in zip(planned, questions.gains(planned), strict=True)
    ]
    best = int(np.argmax(rates))
    return best, questions.gains([planned[best]])[0]


def _played(
    player: Player,
    limits: MotionLimits,
    settings: NextMotionSettings,
    wanted: Sequence[Motion] | None,
) -> tuple[list[tuple[Motion, PlannedMotion]], tuple[tuple[str, str], ...]]:
    """Motions that keep the limits under the corrected model, and the reasons of the others."""
    arm = limits.arm(player.machine, player.rate)

    def checked(motion: Motion) -> tuple[PlannedMotion | None, str]:
        desired = motion.commands(arm)
        if len(desired) > settings.next_seconds * player.rate + 1:
            return None, f"it takes longer than {settings.next_seconds:g} s"
        planned = player.play(desired)
        return planned, limits.refusal(planned)

    tries = 1
    if wanted is None:
        tries, least = _TRIES, min(settings.next_least_seconds, settings.next_seconds)
        wanted = [replace(m, seconds=max(m.seconds, least)) for m in long_motions(arm)]
    found, refused = [], []
    for motion in dict.fromkeys(wanted):
        fitting, planned, reason = scaled_until(motion, checked, tries)
        if planned is not None and not reason:
            found.append((fitting, planned))
        else:
            refused.append((motion_words(motion, limits.joints), reason))
    if not found:
        raise InvalidData(
            f"no motion fits the machine; of {len(refused)} tried the first does not, since "
            f"{refused[0][1]}"
        )
    return found, tuple(refused)


def motion_words(motion: Motion, joints: Sequence[str]) -> str:
    """A motion with the names of its joints."""
    which = ", ".join(joints[j] for j in motion.joints)
    if len(motion.joints) == len(joints) > 1:
        which = "all joints"
    pose = ", ".join(f"{value:.2f}" for value in motion.centre or ())
    where = f" about ({pose})" if pose else ""
    return f"{motion.kind.replace('_', ' ')} of {which}{where}, {motion.amplitude:.2g} rad"


@dataclass(frozen=True, kw_only=True)
class NextMotionSummary:
    """What a motion is expected to tell, for ``next_motion.json``."""

    words: str
    """The motion: kind, joints, amplitude and speed."""
    seconds: float
    """Length of one run [s]."""
    repeats: int
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


def summary_of(chosen: NextMotion) -> NextMotionSummary:
    """Summarise a chosen motion."""
    limits = chosen.limits
    shown = {"first_pose": limits.home, "low": limits.low, "high": limits.high}
    shown |= {"speed": limits.speed, "torque": limits.torque}
    return NextMotionSummary(
        words=motion_words(chosen.motion, limits.joints), seconds=chosen.planned.seconds,
        repeats=_REPEATS, pairs=chosen.gains.pairs, narrowed=chosen.gains.narrowed,
        checked=limits.notes(chosen.planned), motion=asdict(chosen.motion),
        limits={
            "joints": list(limits.joints),
            **{name: [float(v) if np.isfinite(v) else None for v in values]
               for name, values in shown.items()},
            "sources": dict(zip(("position", "speed", "torque"), limits.sources, strict=True)),
        },
        settings=asdict(chosen.settings), considered=chosen.considered, refused=chosen.refused,
        columns=tuple(table_of(chosen.run)),
    )  # fmt: skip


def write_next_motion(folder: Path, chosen: NextMotion) -> list[Path]:
    """Write ``next_motion.csv``, ``next_motion.parquet`` and ``next_motion.json``.

    The tables have the columns of a run of the recording: the time, the commands in each actuator's
    unit, and the readings that are expected of the machine.
    """
    table = table_of(chosen.run)
    files = [folder / f"{NEXT_MOTION}.{ending}" for ending in ("csv", "parquet", "json")]
    write_csv(files[0], table)
    write_parquet(files[1], table)
    write_text(files[2], json_text(asdict(summary_of(chosen))))
    return files


def read_next_motion(file: Path) -> NextMotionSummary:
    """Read ``next_motion.json``.

    Raises
    ------
    InvalidData
        If it is none of the format.
    """
    whole = whole_of(file.read_text(encoding="utf-8"), format=FORMAT, noun="next motion")
    return restored(NextMotionSummary, whole, "next motion")


def next_motion_lines(motion: NextMotionSummary) -> list[str]:
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
