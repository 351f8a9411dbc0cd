"""`loose gap` as one call: recording in, result and files out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from math import nan
from pathlib import Path

import numpy as np
from scipy.special import softmax

from loose_env.doctor import Finding as Preflight
from loose_env.errors import InvalidSetting
from loose_env.gap.core import residual
from loose_env.gap.core.catalogue import Term, shown
from loose_env.gap.core.decision import Finding, decide, held_out_rms
from loose_env.gap.core.evidence import weight_of
from loose_env.gap.core.exact import LARGE, ExactFit
from loose_env.gap.core.find import Answer, Say, evidence_of, find_gap, readable, silent
from loose_env.gap.core.identifiability import identifiability
from loose_env.gap.core.residual import Correlation, Overlay, Played, Response
from loose_env.gap.core.selection import Selection, SetFit
from loose_env.gap.core.tolerances import GapSettings
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import effect_class
from loose_env.gap.model.effects.inertia import payload_notes
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import naming_notes
from loose_env.gap.next_motion import NEXT_MOTION, NextMotion, write_next_motion
from loose_env.gap.output.corrected_model import correction_code, model_notes, write_model
from loose_env.gap.output.result import (
    ChannelVerdict,
    EffectLocation,
    FittedEffect,
    Gap,
    GapResult,
    Identifiability,
    NamedEffect,
    RankedSet,
    TolerancePull,
    Verdict,
    how_to_see,
    how_to_separate,
)
from loose_env.gap.runs import measured_runs
from loose_env.recording import CommandTiming, Recording, Run
from loose_env.typing import Array

PULLED = 2.0
"""Standard deviations from which the pull of a tolerance is told: 1 in 20 by chance."""
FIGURES = 4  # channels of which a report draws figures of one sort
_RANKED = 20  # sets of effects that a result lists
_RIVAL = 0.01  # probability from which a simulated set is a rival of the best
_DECADE = 10.0  # ratio of an interval's ends from which no order of magnitude is known
_COMMON = 0.5  # squared correlation from which most of two residuals is the same
_EARLY = "torques that are logged early, or before the drive gives them"


@dataclass(frozen=True, kw_only=True, eq=False)
class GapSolution:
    """A finished comparison, with what its report draws."""

    answer: Answer
    """Evidence, decision and exact fits."""
    corrected: Hypothesis
    """The named effects at their values, as ``model.xml`` has them."""
    overlays: tuple[Overlay, ...]
    """Measured against both models where most is missing; NaN of the corrected one where samples
    are not compared: at rest, knocked, or at a limit of the drive."""
    correlations: tuple[Correlation, ...]
    """Correlations in time of the largest residuals that are left."""
    parameters: tuple[tuple[str, ...], Array]
    """Names of the effects' coefficients, and their correlation (K, K)."""
    played: Played | None
    """Runs simulated by both models; None of torque logs and free swings."""
    responses: tuple[Response, ...]
    """Frequency responses of servoed joints."""
    result: GapResult
    """Content of ``result.json``."""
    seconds: float
    """Time that it took [s]."""


Report = Callable[[Path, GapSolution], Path | None]
"""Writes a report into a folder; returns its file, or None where it cannot be made."""


def solve_gap(
    recording: Recording,
    settings: GapSettings | None = None,
    *,
    preflight: Sequence[Preflight] = (),
    say: Say = lambda _: None,
) -> GapSolution:
    """Identify effects that a model lacks, with all that result and report need.

    Parameters
    ----------
    recording : Recording
        Measured runs and the nominal model.
    settings : GapSettings, optional
        Settings of the comparison.
    preflight : sequence of Finding
        What `loose_env.doctor` found in the recording.
    say : callable
        Receives progress messages, line by line.

    Raises
    ------
    InvalidData
        If the position of a joint was not read, or no joint moves.

    Examples
    --------
    Some seconds, on a recording of one's own; `loose_env.explain_gap` also shows the result:

    >>> from loose_env.recording import read_recording
    >>> result = solve_gap(read_recording("recordings/arm")).result  # doctest: +SKIP
    >>> result.verdict, [(effect.kind, effect.where) for effect in result.effects]
    ... # doctest: +SKIP
    ('named', [('coulomb_friction', 'joint2')])
    """
    begun = time.monotonic()
    answer = find_gap(recording, settings, say=say)
    say("residuals on held-out data")
    with silent():
        selection, decision, fit = answer.selection, answer.decision, answer.decision.fit
        findings = sorted(answer.findings, key=lambda f: f.term.name)
        named = [f for f in findings if f.named]
        corrected = Hypothesis().with_effects([(f.term.effect, f.values) for f in named])
        # of what is in model.xml or the code, not of what was fitted and is not named
        terms = tuple(t for t in fit.terms if t.name in {f.term.name for f in named})
        fitted = fit if terms == fit.terms else selection.solve(terms, fit.powers)
        before, after = residual.left_by(selection, fitted)
        tests, correlations = residual.residual_tests(selection, after)
        errors, played = residual.simulated(answer, corrected)
        evidence, own = selection.evidence, decision.channels
        sides = held_out_rms(selection, fitted)
        if decision.simulated:  # what a balance leaves says little there
            count = len(evidence.balance.machine.joints)
            of = [k for k, c in enumerate(evidence.channels) if c.joint < count]
            sides[:, of] = np.transpose([(own[k].before, own[k].after) for k in of])
        else:
            errors = residual.force_errors(answer, before, after) | errors
        pairs = map(tuple, sides.T.tolist())
        gap = Gap(
            before=_pooled_rms(selection, sides[0]),
            after=_pooled_rms(selection, sides[1]),
            by_channel=dict(zip((each.channel for each in own), pairs, strict=True)),
            by_quantity=errors,
        )
        cells = _ranked(answer, selection.fits.values())
        ranking = _ranked(answer, answer.exact) if len(answer.exact) > 1 else cells
        told = _told(answer, ranking, cells)
        result = GapResult(
            verdict=_verdict(answer), gap=gap,
            effects=tuple(each for each in told if not each.doubt),
            doubtful=tuple(each for each in told if each.doubt),
            channels=_channels(answer, gap, after, played), pulled=_pulled(answer),
            held_out_runs=tuple(r.name for r in answer.held_out.runs) if answer.held_out else (),
            ranking=tuple(ranking[:_RANKED]), code=correction_code(corrected),
            residual_tests=tests, identifiability=identifiability(selection),
            commands={n: t for run in recording.runs for n, t in run.commands.items()
                      if t != CommandTiming()},
            warnings=_warnings(answer, recording), preflight=tuple(preflight),
            settings=asdict(answer.settings),
        )  # fmt: skip
        largest = np.argsort([test.rms for test in tests])[::-1][: FIGURES - 1]
        shown = after.copy()
        for channel in evidence.channels:
            shown[weight_of(evidence.balance, channel.joint) < 0.5, channel.joint] = nan
    return GapSolution(
        answer=answer, corrected=corrected,
        overlays=residual.overlays(selection, before, shown, FIGURES),
        correlations=tuple(correlations[k] for k in sorted(largest)), played=played,
        parameters=residual.parameter_correlation(selection, fit),
        responses=residual.responses(played, evidence.balance.motion.band) if played else (),
        result=result, seconds=time.monotonic() - begun,
    )  # fmt: skip


def check_gap(
    recording: Recording, settings: GapSettings | None = None, *, say: Say = lambda _: None
) -> Identifiability:
    """Ask what a recording could show, without selecting any effect.

    Parameters
    ----------
    recording, settings, say
        As of `solve_gap`.

    Raises
    ------
    InvalidData
        If the position of a joint was not read, or no joint moves.
    """
    with silent():
        own = settings or GapSettings()
        return identifiability(evidence_of(readable(recording, say), own, say))


def try_effect(answer: Answer, effect: type[Effect] | str, where: str) -> NamedEffect:
    """Fit one effect, in its best shape, beside the others of an answer.

    Parameters
    ----------
    answer : Answer
        Result of `find_gap`, or `answer` of a solution.
    effect : class of an effect, or str
        The effect, which need not be registered, or its identifier in the catalogue.
    where : str
        Its location.

    Returns
    -------
    NamedEffect
        Values, intervals and gain on held-out data; `doubt` says why it would not be named.

    Raises
    ------
    UnknownName
        If there is no such effect, or it cannot be there.
    InvalidSetting
        If the recording does not show the effect at all.

    Examples
    --------
    >>> answer = find_gap(recording)  # doctest: +SKIP
    >>> try_effect(answer, "coulomb_friction", "joint2").doubt  # doctest: +SKIP
    'its interval includes no effect'
    """
    selection, fit = answer.selection, answer.decision.fit
    evidence, balance = selection.evidence, selection.evidence.balance
    own, machine = effect_class(effect) if isinstance(effect, str) else effect, balance.machine
    own(machine, where)  # raises for other locations
    name = own.kind, where
    with silent():
        terms = [t for t in evidence.terms if t.name == name and type(t.effect) is own]
        forms = (own(machine, where, v) for v in own.variants_at(machine, where))
        if not (terms := terms or shown(balance, forms)):
            raise InvalidSetting(
                f"these motions do not show {own.kind} at {where}; record one in which it acts"
            )
        new = [term for term in terms if id(term) not in evidence.places]
        selection.consider(*new)
        rest = [term for term in fit.terms if term.name != name]
        fits = [selection.solve((*rest, term)) for term in terms]
        best = min(fits, key=lambda f: (not f.allowed, f.total))
        findings = decide(selection, best).findings
        return named_effect(next(f for f in findings if f.term.name == name))


def write_gap(
    folder: str | Path,
    solution: GapSolution,
    *,
    report: Report = lambda *_: None,
    next_motion: tuple[NextMotion, Run] | None = None,
    say: Say = lambda _: None,
) -> list[Path]:
    """Write ``model.xml``, the files it needs, a report and ``result.json``, the result last.

    Parameters
    ----------
    folder : str or Path
        Where they go; made where there is none.
    solution : GapSolution
        The finished comparison.
    report : callable
        Writes the report (`loose_env.report.write_gap_report`); none by default.
    next_motion : NextMotion and Run, optional
        Result of `choose_next`, written as ``next_motion.csv``, ``.parquet`` and ``.json``.
    say : callable
        Receives progress messages, line by line.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    InvalidData
        If the corrected model does not compile.
    """
    place, result = Path(folder), solution.result
    machine = solution.answer.selection.evidence.balance.machine
    # An earlier result must not stand beside a later model if this run is cut short.
    endings = ("json", "csv", "parquet")
    for earlier in ("result.json", *(f"{NEXT_MOTION}.{ending}" for ending in endings)):
        place.joinpath(earlier).unlink(missing_ok=True)
    say("writing model, result and report")
    models = write_model(
        place / "model.xml", machine, solution.corrected, notes=model_notes(result),
        source=solution.answer.recording.model_path,
    )  # fmt: skip
    page = report(place, solution)
    motions = [] if next_motion is None else write_next_motion(place, *next_motion)
    file = result.write(place / "result.json")
    return [*models, *([] if page is None else [page]), *motions, file]


def _verdict(answer: Answer) -> Verdict:
    if any(finding.named for finding in answer.findings):
        return "named"
    # where two or three noise standard deviations are left, there is little to look for
    left = [c for c in answer.decision.channels if c.verdict in ("unexplained", "cannot tell")]
    return "unexplained" if any(channel.after > LARGE for channel in left) else "no_gap"


def _pooled_rms(selection: Selection, rms: Array) -> float:
    """Residual over the values of all channels, of that of each one (C,)."""
    counts = np.array([c.count.sum() for c in selection.evidence.channels])
    return float(np.sqrt(np.average(rms**2, weights=counts)))


def named_effect(found: Finding) -> NamedEffect:
    """An effect of the answer in the form of a result."""
    effect, own = found.term.effect, _fitted(found.term, found.values)
    bounds = np.transpose([(p.low, p.high) for p in effect.parameters])
    ends = list(map(tuple, np.clip([found.low, found.high], *bounds).T.tolist()))
    gains = {"run": found.by_run, "stretch": found.by_stretch}
    return NamedEffect(
        **vars(own), variant=effect.variant,
        interval_95=dict(zip(own.parameters, ends, strict=True)),
        undetermined=tuple(
            p.name  # either end of a size, both of a coordinate, which may be zero
            for p, (low, high) in zip(effect.parameters, ends, strict=True)
            if (low <= p.low and high >= p.high)
            or (p.low >= 0 and (low <= p.low or high >= p.high or high > _DECADE * low))
        ),
        ambiguous_with=tuple(FittedEffect(kind=k, where=w) for k, w in found.confusable),
        mountings=effect.mountings, in_model=effect.in_model, probability=found.probability,
        probability_alone=found.alone, z=found.z, doubt=found.doubt,
        held_out_gain=gains if found.by_run != found.by_stretch else {"stretch": found.by_run},
    )  # fmt: skip


def _fitted(term: Term, values: Array) -> FittedEffect:
    """An effect at some values."""
    effect = term.effect
    return FittedEffect(
        kind=effect.kind, where=effect.where, units={p.name: p.unit for p in effect.parameters},
        parameters=dict(zip((p.name for p in effect.parameters), values.tolist(), strict=True)),
    )  # fmt: skip


def _ranked(answer: Answer, fits: Iterable[SetFit | ExactFit]) -> list[RankedSet]:
    """Sets of effects at their values, the best first; each of kinds and locations once."""
    once = dict[frozenset[object], SetFit | ExactFit]()
    for fit in sorted(fits, key=lambda own: own.total):
        if isinstance(fit, ExactFit) or fit.allowed:
            once.setdefault(frozenset(term.name for term in fit.terms), fit)
    behind = np.array([fit.total for fit in once.values()])
    behind -= behind[0]
    ranked = []
    for fit, above, chance in zip(once.values(), behind, softmax(-behind / 2), strict=True):
        values = answer.selection.values_in(fit) if isinstance(fit, SetFit) else fit.values
        ranked.append(
            RankedSet(
                effects=tuple(sorted(map(_fitted, fit.terms, values), key=_name)),
                behind=float(above), probability=float(chance),
                source="simulation" if isinstance(fit, ExactFit) else "force balance",
            )
        )  # fmt: skip
    return ranked


def _name(effect: EffectLocation) -> tuple[str, str]:
    """Kind and location."""
    return effect.kind, effect.where


def _told(
    answer: Answer, ranking: Sequence[RankedSet], cells: Sequence[RankedSet]
) -> list[NamedEffect]:
    """Effects of the answer, joint by joint, with what may be there in place of each."""
    decision, balance = answer.decision, answer.selection.evidence.balance
    sets = [({_name(e): e for e in own.effects}, own.probability) for own in ranking]
    known = [*(own for own, _ in sets), *({_name(e): e for e in own.effects} for own in cells)]
    best = {found.term.name for found in answer.findings}
    channels = enumerate(decision.channels[::-1])
    order = {_name(e): -k for k, own in channels for e in own.effects}
    late = balance.encoders if (balance.forms == "inverse").any() else ()
    told = []
    for found in sorted(answer.findings, key=lambda f: (order.get(f.term.name, 1), f.term.name)):
        name, effect = found.term.name, named_effect(found)
        instead = set(found.confusable) - best  # what is named itself is in nobody's place
        if (
            decision.simulated and found not in answer.rounded
        ):  # sets with one other effect in its place
            others = [own.keys() - best for own, p in sets if p > _RIVAL and name not in own]
            instead = {rival for each in others if len(each) == 1 for rival in each}
            group = sum(chance for own, chance in sets if own.keys() & {name, *instead})
            way = "run" if len(balance.motion.runs) > 1 else "stretch"
            gain = {way: found.by_run}
            effect = replace(effect, probability=min(group, 1.0), held_out_gain=gain)
        without = [own for own in known if name not in own]
        rivals = [
            next((own[k, w] for own in without if (k, w) in own), FittedEffect(kind=k, where=w))
            for k, w in sorted(instead)
        ]
        early = name[0] == "sensor_delay" and name[1] in late
        told.append(replace(effect, ambiguous_with=tuple(rivals), note=_EARLY * early))
    return told


def _channels(
    answer: Answer, gap: Gap, after: Array, played: Played | None
) -> tuple[ChannelVerdict, ...]:
    """Verdict of every joint and reading; joints that stand still cannot tell."""
    found, joints = [], answer.selection.evidence.balance.machine.joints
    alike = moving_alike(answer, after)
    for number, own in enumerate(answer.decision.channels):
        ends, said = gap.by_channel[own.channel], alike.get(own.channel, "")
        advice = "; ".join(filter(None, [_advice(answer, number, own, played), said]))
        found.append(replace(own, before=ends[0], after=ends[1], advice=advice))
    advice = "it hardly moves, or its torque was not read: record runs in which it moves"
    still = ChannelVerdict(channel="", verdict="cannot tell", before=nan, after=nan, advice=advice)
    return *found, *(replace(still, channel=j) for j in joints if j not in gap.by_channel)


def moving_alike(answer: Answer, after: Array) -> dict[str, str]:
    """Unexplained joints whose residual is mostly that of another one, in words."""
    balance, verdicts = answer.selection.evidence.balance, answer.decision.channels
    joints = balance.machine.joints
    open_ = [v.channel for v in verdicts if v.verdict == "unexplained" and v.channel in joints]
    if len(open_) < 2:
        return {}
    numbers = map(joints.index, open_)
    series = [np.concatenate(residual.whitened(balance, after[:, k], k)[0]) for k in numbers]
    alike, found = np.corrcoef(series) - np.eye(len(open_)), {}
    for joint, row in zip(open_, alike, strict=True):
        other = int(np.argmax(np.abs(row)))
        if row[other] ** 2 > _COMMON:
            found[joint] = (
                f"its residual moves with that of {open_[other]} (correlation {row[other]:.2f}), "
                "as where gears couple them, which the catalogue has not"
            )
    return found


def _advice(answer: Answer, number: int, own: ChannelVerdict, played: Played | None) -> str:
    """Motion that would tell, or where most of the residual is."""
    if own.verdict == "cannot tell":
        if len(own.effects) > 1:
            one, other = own.effects[:2]
            return how_to_separate(one.kind, one.where, other.kind, other.where)
        return how_to_see(own.effects[0].kind) if own.effects else "record more of its motion"
    if own.verdict == "not needed" or own.after <= LARGE:
        return ""
    share = max(1 - (own.after / max(own.before, 1e-300)) ** 2, 0.0)
    said = [f"all that was tried explains {100 * share:.0f} %"] * (own.verdict == "unexplained")
    balance = answer.selection.evidence.balance
    channel = answer.selection.evidence.channels[number]
    if not answer.decision.simulated:
        excess = answer.decision.fit.powers[number] - channel.count
        loudest = int(np.argmax(np.bincount(channel.run, excess)))
        turns, at = np.unique(channel.turn, return_inverse=True)
        frequency = turns[int(np.argmax(np.bincount(at, excess)))] / (2 * np.pi)
        said.append(
            f"most is left in {balance.motion.runs[loudest].name}, around {frequency:.2g} Hz"
        )
    elif played is not None and own.channel in balance.machine.joints:
        run, frequency = _loudest(played, own.channel)
        said += [f"most is left in {run}, around {frequency:.2g} Hz"] * bool(run)
    return "; ".join(said)


def _loudest(played: Played, joint: str) -> tuple[str, float]:
    """Run and frequency in which the corrected model misses most of a joint's position."""
    own, loudest = played.column_of(joint), (-1.0, "", nan)
    for trial, corrected in zip(played.trials, played.corrected, strict=True):
        if own is None:
            break
        off = np.nan_to_num(trial.measured[:, own] - corrected[:, own])
        power = np.abs(np.fft.rfft(off))[1:] ** 2 / len(off)
        most = (int(np.argmax(power)) + 1) * trial.rate / len(off)
        loudest = max(loudest, (float(np.mean(off**2)), trial.name, most))
    return loudest[1:]


def _pulled(answer: Answer) -> tuple[TolerancePull, ...]:
    """Tolerances pulled by more than two standard deviations, the most first."""
    found = [
        TolerancePull(
            name=n.name, deviations=x, value=x * n.size, tolerance=abs(n.size), unit=n.unit
        )
        for n, x in answer.selection.pulls(answer.decision.fit)
        if abs(x) > PULLED
    ]
    return tuple(sorted(found, key=lambda each: -abs(each.deviations)))


def _warnings(answer: Answer, recording: Recording) -> tuple[str, ...]:
    """Cautions: samples left out, one run alone, effects that no file carries."""
    balance = answer.selection.evidence.balance
    split = measured_runs(recording.runs, balance.machine.model)[1]
    found = [*split, *naming_notes(recording.spec())]
    if any(each.term.effect.kind == "payload" for each in answer.decision.findings):
        found += payload_notes(balance.machine)
    unread = ", ".join(balance.machine.joints[k] for k in balance.motion.foretold)
    if unread:
        found.append(
            f"{unread}: no position reading follows the motion; it is taken as the nominal model "
            "moves under the commands, and nothing is said of it: check its encoder and its column"
        )
    if len(balance.motion.runs) == 1:
        found.append(
            "one run alone: alternate stretches of it are held out, so that what every stretch of "
            "it has in common is not tested; record a second run with another motion"
        )
    for each in answer.findings:
        effect = each.term.effect
        alone = Hypothesis(effects=(effect,), values=(each.values,))
        if each.named and not (effect.in_model or correction_code(alone)):
            found.append(
                f"{effect.kind} at {effect.where} is named, and no file applies it: neither MJCF "
                "nor a line of code has means for it"
            )
    return tuple(found)
