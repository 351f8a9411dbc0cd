"""The whole of it: from a recording to what its model lacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidSetting
from loose_env.gap.ambiguity import indistinct
from loose_env.gap.catalogue import candidates
from loose_env.gap.comparison import Comparison
from loose_env.gap.effect import Effect
from loose_env.gap.integration import Integration, choose_integration
from loose_env.gap.intervals import Intervals, bootstrap
from loose_env.gap.judgement import Judge, Judged
from loose_env.gap.keeping import KeepInFiles
from loose_env.gap.machine import Machine
from loose_env.gap.naming import UNNAMED, Named, NamingSettings, name_effects
from loose_env.gap.noise import noise_floor
from loose_env.gap.nominal import NominalFigures
from loose_env.gap.result import NamedEffect, Place, Ranked, Verdict
from loose_env.gap.simulator import Hypothesis, Simulator
from loose_env.gap.split import split_runs
from loose_env.gap.stages import Stage, fresh
from loose_env.gap.start import StartState
from loose_env.gap.trial import Channel, Trial, channels_of, lay_out
from loose_env.gap.windows import windowed
from loose_env.recording import Recording, Run
from loose_env.rig.quiet import quiet

__all__ = ["GapFound", "GapSettings", "find_gap", "prepare"]

Array = NDArray[np.float64]
Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class GapSettings:
    """How a recording is compared with its model."""

    tolerance: float = 0.03
    """Within which nominal masses, inertias, dampings and gains are known, as a share."""
    most_effects: int = 12
    """Most effects that are named."""
    kinds: tuple[str, ...] = ()
    """Kinds of effect that are considered; all of the catalogue if none is given."""
    held_share: float = 0.25
    """Share of the runs that is held out to judge by."""
    fit_seconds: float = 90.0
    """How much of the recording is fitted to, in all; of longer ones a window of every run [s]."""
    held_seconds: float = 60.0
    """How much of it judges while effects are sought; the result is of whole runs [s]."""
    seed: int = 1
    """Seed of the intervals' bootstrap."""
    threads: int = 0
    """Threads of the simulation; 0: all processors."""

    def __post_init__(self) -> None:
        """Check."""
        if not 0 < self.tolerance < 0.5:
            raise InvalidSetting(
                f"the tolerance is a share above 0 and below 0.5, not {self.tolerance:g}"
            )
        if not 0 < self.held_share < 1:
            raise InvalidSetting(
                f"the share held out is above 0 and below 1, not {self.held_share:g}"
            )
        if not 1 <= self.most_effects <= 30:
            raise InvalidSetting(f"1 to 30 effects can be named, not {self.most_effects}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """A recording, ready to be compared."""

    machine: Machine
    """The nominal model, with the step and the figures that the recording asks for."""
    integration: Integration | None
    """The step that was chosen; None where nothing is simulated."""
    fit: Comparison
    """The runs to fit to."""
    held: Comparison
    """The runs to judge by."""
    whole_held: Comparison
    """The same at their full length, where only windows of them judge."""
    warnings: tuple[str, ...] = ()
    """What a reader should know."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GapFound:
    """What was found."""

    prepared: Prepared
    """What was compared."""
    named: Named
    """Step by step."""
    base: Judged
    """The nominal model, fitted within the tolerance, on whole held-out runs."""
    best: Judged
    """With the effects that were named, on whole held-out runs."""
    verdict: Verdict
    """ "named", "no_gap" or "unexplained"."""
    effects: tuple[NamedEffect, ...]
    """What the model lacks."""
    ranking: tuple[Ranked, ...]
    """What was tried."""


def prepare(recording: Recording, settings: GapSettings) -> Prepared:
    """Lay a recording out, choose the step, and estimate the noise.

    Raises
    ------
    InvalidData
        If the recording has too few runs, or a run lacks what its comparison needs.
    """
    recording.check_comparison()
    runs = list(recording.runs)
    fitted, held = split_runs([run.name for run in runs], share=settings.held_share)
    machine = Machine(recording.spec())
    channels = channels_of(runs)
    warnings: list[str] = []
    integration = None
    simulated = [run for run in runs if run.comparison != "inverse"]
    step = float(machine.model.opt.timestep)
    if simulated:
        integration = choose_integration(machine, simulated, channels, threads=settings.threads)
        step = integration.step
        if integration.nominal_error > 0.5:
            warnings.append(
                f"the model's own step of {machine.model.opt.timestep:g} s is a gap of its own: "
                f"{integration.nominal_error:.1f} noise standard deviations in the worst channel; "
                f"runs were simulated by a Runge-Kutta method at {step:g} s instead"
            )
    kept = Machine(
        machine.spec, step=step, integrator=None if integration is None else integration.integrator
    )
    trials = [lay_out(run, kept, channels, step=step) for run in runs]
    floors = _floors(trials, len(channels))
    kept = _scaled(kept, runs, trials, channels, floors, settings.threads)

    def compared(numbers: list[int]) -> Comparison:
        return Comparison(
            kept, [trials[k] for k in numbers], channels, floors, threads=settings.threads
        )

    whole = compared(held)
    return Prepared(
        machine=kept,
        integration=integration,
        fit=windowed(compared(fitted), settings.fit_seconds),
        held=windowed(whole, settings.held_seconds),
        whole_held=whole,
        warnings=tuple(warnings),
    )


def find_gap(
    recording: Recording,
    settings: GapSettings | None = None,
    *,
    say: Say = lambda _: None,
    stages: Stage = fresh,
) -> GapFound:
    """Find what the model of a recording lacks.

    Parameters
    ----------
    recording : Recording
        Measured runs and the nominal model.
    settings : GapSettings, optional
        How they are compared.
    say : callable
        Told what goes on, line by line.
    stages : callable
        Keeps finished stages, such as `loose_env.gap.stages.Stages`; an interrupted run goes on
        from there.

    Raises
    ------
    InvalidData
        If the recording has too few runs, or a run lacks what its comparison needs.
    """
    settings = settings or GapSettings()
    with quiet():  # simulations that go wild are part of the search
        return _find_gap(recording, settings, say, stages)


def _find_gap(recording: Recording, settings: GapSettings, say: Say, stages: Stage) -> GapFound:
    """Find it, with the engine's warnings on the console or not."""
    prepared = prepare(recording, settings)
    machine = prepared.machine
    given: list[Effect] = [NominalFigures(machine, tolerance=settings.tolerance)]
    start = StartState(machine, prepared.fit.trials, prepared.fit.channels)
    if any(trial.form == "free" for trial in prepared.fit.trials):
        given.insert(0, start)
    named = name_effects(
        prepared.fit,
        prepared.held,
        given,
        [c for c in candidates(machine, settings.kinds or None) if prepared.fit.shows(c)],
        settings=NamingSettings(most=settings.most_effects),
        say=say,
        keep=None if stages is fresh else KeepInFiles(stages, machine, given),
    )
    base, best = named.base, named.best
    if prepared.whole_held is not prepared.held:
        judge = Judge(prepared.fit, prepared.whole_held)
        base, best = judge.judge(base.fitted), judge.judge(best.fitted)
    verdict = _verdict(named)
    effects: tuple[NamedEffect, ...] = ()
    if verdict == "named":
        rng = np.random.default_rng(settings.seed)
        effects = _named(named, bootstrap(prepared.fit, named.best.fitted, rng))
    return GapFound(
        prepared=prepared,
        named=named,
        base=base,
        best=best,
        verdict=verdict,
        effects=effects,
        ranking=_ranking(named, prepared),
    )


_EXPLAINED = 0.8
"""Share of what there was to explain that the named effects must explain together."""
_SURE = 4.0
"""Sureness from which on what is left counts as a gap [standard deviations over blocks]."""


def _verdict(named: Named) -> Verdict:
    """Whether something is missing, and whether the catalogue has it."""
    if not named.steps:
        return "unexplained" if named.base.structure_sureness > _SURE else "no_gap"
    explained = 1 - named.best.structure / max(named.base.structure, 1e-12)
    if explained < _EXPLAINED and named.best.structure_sureness > _SURE:
        return "unexplained"
    return "named"


def _named(named: Named, intervals: Intervals) -> tuple[NamedEffect, ...]:
    """Effects of the best hypothesis, the nominal figures left out."""
    hypothesis = named.best.fitted.hypothesis
    found, at = [], 0
    for effect, values in zip(hypothesis.effects, hypothesis.values, strict=True):
        own = slice(at, at + len(values))
        at += len(values)
        if effect.kind in UNNAMED:
            continue
        names = [p.name for p in effect.parameters]
        ends = zip(intervals.low[own], intervals.high[own], strict=True)
        found.append(
            NamedEffect(
                kind=effect.kind,
                where=effect.where,
                parameters={n: float(v) for n, v in zip(names, values, strict=True)},
                interval_95={
                    n: (float(a), float(b)) for n, (a, b) in zip(names, ends, strict=True)
                },
                ambiguous_with=tuple(
                    Place(kind=e.kind, where=e.where) for e in indistinct(named, effect)
                ),
                units={p.name: p.unit for p in effect.parameters},
                variant=effect.variant,
                in_model=effect.in_model,
            )
        )
    return tuple(found)


def _ranking(named: Named, prepared: Prepared) -> tuple[Ranked, ...]:
    """Everything that was fitted to whole runs."""
    found = []
    for step, rivals in enumerate(named.rivals, start=1):
        before = named.base if step == 1 else named.steps[step - 2]
        for judged, lead in rivals:
            effect: Effect = judged.fitted.effects[-1]
            found.append(
                Ranked(
                    kind=effect.kind,
                    where=effect.where,
                    held_out=judged.held_rms,
                    bic=_bic(judged, before),
                    step=step,
                    lead=lead.held,
                )
            )
    return tuple(found)


def _bic(judged: Judged, before: Judged) -> float:
    """Bayesian information criterion over that of the hypothesis before.

    Blocks of time count as the sample, and the scatter of what is left as the noise: 100,000 rows
    that hang together are no 100,000 observations.
    """
    count = len(judged.held_blocks) + len(judged.fitted_blocks)
    rows = len(judged.held_residual) + len(judged.fitted.residual)
    level = max(judged.total / rows, 1.0)
    width = rows / count
    effective = max(count, 2)
    more = judged.free_count - before.free_count
    gained = (before.total - judged.total) / (level * max(width / effective, 1.0))
    return float(-gained + more * np.log(effective))


def _floors(trials: list[Trial], channels: int) -> Array:
    """Noise standard deviation of every channel: the median over runs."""
    found = np.array(
        [[noise_floor(trial.measured[:, k]) for k in range(channels)] for trial in trials]
    )
    return np.asarray(np.nanmedian(found, axis=0))


def _scaled(
    machine: Machine,
    runs: list[Run],
    trials: list[Trial],
    channels: tuple[Channel, ...],
    floors: Array,
    threads: int,
) -> Machine:
    """The machine with typical speeds and torques of the recording."""
    speeds, loads = np.zeros((2, len(machine.joints)))
    for k, joint in enumerate(machine.joints):
        moved = [
            float(np.nanstd(np.diff(t.motion[joint]) / np.diff(t.time)))
            for t in trials
            if joint in t.motion
        ]
        speeds[k] = float(np.median(moved)) if moved else 0.0
        torques = [np.nanstd(run.torques[joint]) for run in runs if joint in run.torques]
        loads[k] = float(np.median(torques)) if torques else 0.0
    driven = [t for t in trials if t.form == "forward"][:2]
    if driven and machine.actuators and not loads.any():
        columns = tuple(Channel(f"torque.{joint}") for joint in machine.joints)
        beginnings = [t.until(5.0) for t in driven]
        simulated = Simulator(machine, beginnings, columns, threads=threads).predict(
            [Hypothesis(effects=(), values=())]
        )[0]
        loads = np.sqrt(np.nanmean(np.concatenate(simulated) ** 2, axis=0))
    return Machine(
        machine.spec,
        step=machine.step,
        integrator=machine.integrator,
        loads=np.where(loads > 0, loads, machine.load_scales),
        speeds=np.where(speeds > 0, speeds, 1.0),
    )
