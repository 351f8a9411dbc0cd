"""The way from a recording to the effects that its model lacks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from loose_env.arms import quiet
from loose_env.errors import InvalidData
from loose_env.gap.core.balance import Balance, is_rigid, scaled
from loose_env.gap.core.catalogue import Term, catalogue, moves_at, terms_of
from loose_env.gap.core.decision import (
    Decision,
    Finding,
    by_runs,
    decide,
    decide_simulated,
    held_out_rms,
    left_open,
    pruned,
    rounded,
    with_rounded,
)
from loose_env.gap.core.evidence import whiten
from loose_env.gap.core.exact import LARGE, Exact, ExactFit, open_joints, pool_of
from loose_env.gap.core.motion import LOWEST_HZ, motions_of_model, servo_share, servoed, smooth
from loose_env.gap.core.selection import LEAST_GAIN, Selection, SetFit
from loose_env.gap.core.tolerances import GapSettings, missed_by_laws, nuisances
from loose_env.gap.model.effects.catalogue import EFFECTS, effect_class
from loose_env.gap.model.effects.sensors import SensorQuantisation
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import measured_runs
from loose_env.recording import Recording
from loose_env.statistics import noise_floor

Say = Callable[[str], None]
_AGAIN = 4  # times that the rigid bodies are linearised beside what was found
_FALLS = 10.0  # times as far as it is told that a model goes which does not hold itself
_MOVES = 10.0  # usual encoder noise from which a motion is clear [standard deviations]


@contextmanager
def silent() -> Iterator[None]:
    """Without warnings of simulations that diverge, and of sets far out of their bounds."""
    with quiet(), np.errstate(all="ignore"):
        yield


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """What a model lacks."""

    recording: Recording
    """The runs that were analysed."""
    held_out: Recording | None
    """The runs that were kept out."""
    settings: GapSettings
    """Settings of the comparison."""
    selection: Selection
    """Evidence and fits of sets of effects."""
    decision: Decision
    """Effects and verdicts."""
    exact: tuple[ExactFit, ...]
    """Sets in full simulation, the best first; empty where cells leave nothing open."""
    rounded: tuple[Finding, ...] = ()
    """Encoders that show their steps by themselves, beside the decision's set."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All effects of the answer, named or not."""
        return (*self.decision.findings, *self.rounded)


def find_gap(
    recording: Recording, settings: GapSettings | None = None, *, say: Say = lambda _: None
) -> Answer:
    """Find which force was missing along the motion that was measured.

    Parameters
    ----------
    recording : Recording
        Measured runs and the nominal model.
    settings : GapSettings, optional
        Settings of the comparison.
    say : callable
        Receives progress messages, line by line.

    Raises
    ------
    InvalidData
        If the position of a joint was not read, no joint moves, or no run is long enough.
    """
    settings = settings or GapSettings()
    with silent():
        used, held_out = split_held_out(readable(recording, say), settings)
        selection = evidence_of(used, settings, say)
        say("selection of effects")
        selection, (best, *others) = relinearised(selection, settings)
        best = pruned(selection, best)
        best = by_runs(selection, best)
        before, after = held_out_rms(selection, best)
        left = left_open(selection, before, after)
        rivals = bool(others) and bool(np.any(after > LARGE))
        stepped = settings.simulate and not selection.evidence.balance.released.any()
        if (left or rivals) and stepped and _steps(best):
            sets = [best, *(pruned(selection, fit) for fit in others if _steps(fit))]
            decision, fits = _simulated(used, selection, sets, left, settings, say)
        else:
            say("decision on held-out data")
            decision, fits = decide(selection, best), ()
    asked = not settings.kinds or SensorQuantisation.kind in settings.kinds
    machine, zero = selection.evidence.balance.machine, settings.tolerances.zero
    steps = rounded(used, machine, zero) if asked else ()
    return Answer(
        recording=used, held_out=held_out, settings=settings, selection=selection,
        decision=with_rounded(decision, steps), exact=fits, rounded=steps,
    )  # fmt: skip


def readable(recording: Recording, say: Say = lambda _: None) -> Recording:
    """The recording without position readings that say nothing of their joints: a loose wire.

    Every joint's forces depend on the position of every joint. A reading without most of the motion
    that the nominal servo makes is set aside if the other joints are explained better so; of a
    joint that stands still indeed they are not.

    Raises
    ------
    InvalidData
        If the nominal model falls or diverges under the commands, or no run is long enough.
    """
    _check_runs(recording)
    machine = NominalModel(recording.spec())
    runs = measured_runs(recording.runs, machine.model)[0]
    read = set.intersection(*(set(run.sensors) for run in runs))
    encoders = {machine.joints.index(j): n for n, j in machine.encoders.items() if n in read}
    servos = servoed(machine, runs)
    joints = sorted(servos.keys() & encoders.keys())
    if not joints:
        return recording
    drives = [machine.actuators[servos[k]] for k in joints]
    ratio = np.array([servo_share(machine, servos[k]) for k in joints])
    played = motions_of_model(runs, machine, joints)
    shown = [np.stack([run.sensors[encoders[k]] for k in joints], axis=1) for run in runs]
    moves, asked, noise, misses = np.zeros((4, len(joints)))
    for run, own, seen in zip(runs, played, shown, strict=True):
        commands = [run.controls.get(name, 0 * run.time) for name in drives]
        moves += np.var(own, axis=0)
        asked += np.nanvar(seen, axis=0) + ratio**2 * np.nanvar(commands, axis=1)
        noise += [noise_floor(column) ** 2 for column in seen.T]
        misses += np.nanvar(seen - own, axis=0)
    clear = _MOVES**2 * float(np.quantile(noise, 0.5, method="lower"))
    if not np.sum(moves) < _FALLS**2 * np.sum(asked + clear):
        raise InvalidData(
            f"under these commands the joints of the model move more than {_FALLS:g} times as far "
            "as they are told and as was read: the model falls or diverges; check gains and signs "
            "of its drives, and the unit of the commands"
        )
    doubtful = np.array(joints)[(misses > moves / 2) & (moves / 2 > clear)].tolist()

    def left(tried: Recording) -> float:
        balance = Balance(machine, smooth(tried, machine))
        others = [k for k in range(len(machine.joints)) if k not in doubtful]
        kept = [k for k in others if moves_at(balance, k)]
        return float(np.sum(np.log(np.mean(balance.residual[:, kept] ** 2, axis=0))))

    if not 0 < len(doubtful) < len(joints):
        return recording
    least = left(recording)
    for joint in doubtful:
        name = encoders[joint]
        columns = ({n: v for n, v in run.sensors.items() if n != name} for run in recording.runs)
        pairs = zip(recording.runs, columns, strict=True)
        without = replace(recording, runs=tuple(replace(run, sensors=own) for run, own in pairs))
        if (rest := left(without)) < least:
            say(f"{name} shows nothing of the motion of {machine.joints[joint]} and is set aside")
            recording, least = without, rest
    return recording


def _steps(fit: SetFit) -> bool:
    """Whether simulations have a set: one model for all runs."""
    return not any(t.effect.mountings for t in fit.terms)


def _simulated(
    recording: Recording,
    selection: Selection,
    sets: Sequence[SetFit],
    left: Sequence[int],
    settings: GapSettings,
    say: Say,
) -> tuple[Decision, tuple[ExactFit, ...]]:
    """Decide in simulation among sets that leave channels open in the cells; the best first."""
    say("exact fit in full simulation")
    balance, law = selection.evidence.balance, selection.evidence.law
    exact = Exact(recording, balance, law=law, threads=settings.threads)
    pairs = [(exact.fit(selection, own), own) for own in sets]
    pairs.sort(key=lambda pair: pair[0].total)
    fits, best = [fit for fit, _ in pairs], pairs[0][1]
    nominal = exact.fit(selection, selection.solve(()))
    joints = open_joints(exact, nominal, fits[0], left)
    # an impact is felt at the tool while all joints stay on their ways
    first = len(balance.machine.joints)
    loose = any(k >= first and balance.readings.accelerated(k - first) for k in left)
    exact = exact.beside(selection, best)
    if not (joints or loose):
        say("decision on held-out data")
        decision = decide(selection, best, fits[0])
        open_ = {each.channel for each in decision.channels if each.verdict == "unexplained"}
        if not open_:
            return decision, tuple(fits)
        joints = open_.intersection(balance.machine.joints)
    if joints or loose:
        say(f"search in simulation: {', '.join(sorted(joints)) or 'loose parts'}")
        kinds = settings.kinds or EFFECTS
        places, pool = pool_of(selection, joints, kinds, loose=loose)
        # what cells that say little named there would lead astray
        kept = [k for k, term in enumerate(fits[0].terms) if term.effect.where not in places]
        start = exact.only(selection, fits[0], kept)

        def leaves_open(fit: ExactFit) -> bool:
            return bool(open_joints(exact, nominal, fit, left))

        fits += exact.searched(selection, start, pool, max(len(joints), 1), leaves_open, say)
        fits.sort(key=lambda f: f.total)
    say("decision on held-out runs in simulation")
    return decide_simulated(selection, exact, fits, nominal), tuple(fits)


def evidence_of(recording: Recording, settings: GapSettings, say: Say) -> Selection:
    """Evidence of a recording for all effects of the catalogue, before any is selected."""
    for kind in settings.kinds:
        effect_class(kind)  # refuses an unknown one before any work
    _check_runs(recording)
    machine = NominalModel(recording.spec())
    say(f"motion of {len(recording.runs)} run{'s' * (len(recording.runs) > 1)}")
    motion = smooth(recording, machine)
    if motion.followers:
        carried = ", ".join(machine.joints[k] for k in motion.followers)
        say(f"carried along by equality constraints of the model: {carried}")
    say(f"force balance up to {motion.band:.3g} Hz")
    balance = Balance(scaled(Balance(machine, motion)), motion)
    terms = catalogue(balance, settings.kinds or None)
    tolerances = nuisances(balance, settings.tolerances)
    places = len({term.name for term in terms})
    say(f"evidence: {places} effects in {len(terms)} shapes, {len(tolerances)} tolerances")
    evidence = whiten(balance, terms, tolerances, law=settings.tolerances.law)
    if all(channel.joint >= len(machine.joints) for channel in evidence.channels):
        raise InvalidData(
            "no joint moves by more than its noise, so that no force can be missing along the "
            "motion; record runs in which the joints move"
        )
    return Selection(evidence, say)


def relinearised(selection: Selection, settings: GapSettings) -> tuple[Selection, list[SetFit]]:
    """The leading sets, each searched for again beside what it found; those where one is best."""
    leading = selection.leading
    orders = ((own, *(fit for fit in leading if fit is not own)) for own in leading)
    again = (_beside_itself(selection, order, settings) for order in orders)
    return min(again, key=lambda pair: pair[1][0].total)


def _beside_itself(
    selection: Selection, leading: Sequence[SetFit], settings: GapSettings
) -> tuple[Selection, list[SetFit]]:
    """Some sets, the first searched for again beside what it found, till it stays."""
    # Beside its rigid bodies, with what they change together: of a link whose weight is half borne,
    # a centre that is off has half the moment. And with what the laws of its effects miss. A set
    # counts by its evidence beside itself: what seemed better from elsewhere may not be.
    known, searching = selection.evidence.nuisances, True
    now = found = selection, leading[0], [own.terms for own in leading[1:]]
    for number in range(_AGAIN):
        selection, best, sets = now
        evidence = selection.evidence
        pairs = zip(best.terms, selection.values_in(best), strict=True)
        beside = [(term.effect, values) for term, values in pairs if is_rigid(term.effect)]
        missed = missed_by_laws(evidence.balance, selection.inexact(best))
        if not beside and not selection.feels(missed, best):
            break
        selection.say("search beside what was found")
        balance, again = evidence.balance, {id(term): term for term in evidence.terms}
        if beside or balance.found:
            balance = balance.beside(beside)
            again = {key: _again(balance, term) for key, term in again.items()}
            known = tuple(nuisances(balance, settings.tolerances))
        law = settings.tolerances.law
        whole = whiten(balance, list(again.values()), known, law=law, missed=missed)
        selection = Selection(whole, selection.say)
        own = selection.solve([again[id(term)] for term in best.terms])
        if searching and number and own.total > found[1].total:
            now, searching = found, False  # back, and on beside that one
            continue
        found = selection, own, [tuple(again[id(term)] for term in each) for each in sets]
        better = selection.search(own.terms) if searching else own
        if abs(own.total - best.total) < LEAST_GAIN and own.total < better.total + LEAST_GAIN:
            break
        now = selection, better, found[2]
    selection, best, sets = found
    return selection, [best, *map(selection.solve, sets)]


def _again(balance: Balance, term: Term) -> Term:
    """A term with its columns beside the effects that a balance knows."""
    if not is_rigid(term.effect):
        return term
    found = terms_of(balance, term.effect, term.axes, term.law, (term.contact,))
    return replace(found[0], unseen=(*found[0].unseen, *term.unseen)) if found else term


def split_held_out(
    recording: Recording, settings: GapSettings
) -> tuple[Recording, Recording | None]:
    """Runs to analyse, and those that a user holds out."""
    names = [run.name for run in recording.runs]
    held: set[str] = set()
    for given in settings.held_out:
        own = {name for name in names if given and name.startswith(given)}
        if not own:
            raise InvalidData(
                f"no run to hold out is called {given!r} or begins so; there are {', '.join(names)}"
            )
        held |= own
    if len(held) == len(names):
        raise InvalidData("all runs are held out, and none is left to fit to; hold out fewer")
    parts = [
        replace(recording, runs=tuple(r for r in recording.runs if (r.name in held) == out))
        for out in (False, True)
    ]
    if held:
        _check_runs(parts[1])
    return parts[0], parts[1] if held else None


def _check_runs(recording: Recording) -> None:
    """Refuse runs without a period of the lowest band, or in which no reading changes."""
    longest = max(run.time[-1] - run.time[0] for run in recording.runs)
    if longest < 1 / LOWEST_HZ:
        raise InvalidData(
            f"the longest run lasts {longest:.2g} s and has no period of {LOWEST_HZ:g} Hz, the "
            "lowest band of motion; record some seconds"
        )
    if not any(np.any(v != v[:1]) for run in recording.runs for v in run.sensors.values()):
        raise InvalidData(
            "no reading changes in any run: nothing moved, or the log repeats its first row; "
            "record runs in which the joints move"
        )
