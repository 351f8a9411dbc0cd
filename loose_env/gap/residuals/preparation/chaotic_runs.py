"""Names of chaotic random-excitation runs, which are compared by features, not by samples.

After an impact two simulations diverge within milliseconds. Where slightly stiffer stops or a
slightly different initial state would change the simulated trajectory entirely, the trajectory
carries no information, since stops are never known that accurately; the run is compared by features
instead. Where the trajectory is reproducible, samples are more informative.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.errors import InvalidData
from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.random_excitation.features import RandomFeatures
from loose_env.gap.residuals.random_excitation.frequency_response import FEWEST
from loose_env.gap.settings import (
    CHAOTIC_POWER,
    CHAOTIC_SHARE,
)
from loose_env.gap.simulation.simulator import Simulator
from loose_env.typing import Array

NUDGE = 1e-5
"""Change of where a run begins that does not matter [rad, m]."""
_OF_STOPS = {"stiffness": 1.3, "damping_ratio": 1.5}
"""Factors on parameters of stops that do not matter: no law of contact is that exact."""
LOOKED_AT = 2.0
"""How much of a run is simulated to see whether trajectories diverge, where it is least like the
nominal model [s]; at least as much as features need."""
_NOMINAL = Hypothesis(effects=(), values=())


def chaotic_runs(
    machine: NominalModel,
    trials: Sequence[Trial],
    channels: tuple[Channel, ...],
    floors: Array,
    candidates: Sequence[Effect],
    *,
    threads: int = 0,
) -> frozenset[str]:
    """Return names of the random runs that are compared by features.

    Those whose incoherent part exceeds that of the nominal model, if a machine with clearance is
    chaotic in any of them: sensitive to slightly different stops or initial states. A run that has
    no features, since it is too short or its command does not vary, is not among them: it can only
    be compared sample by sample.
    """
    with_stops = [effect for effect in candidates if effect.has_stops]
    runs = [trial for trial in trials if _driven(trial, machine)]
    if not with_stops or not runs:
        return frozenset()
    nominal = Simulator(machine, runs, channels, threads=threads).predict([_NOMINAL])[0]
    loud: list[tuple[Trial, RandomFeatures]] = []
    for run, seen in zip(runs, nominal, strict=True):
        features = _features(run, machine, channels, floors)
        if features is None or not np.isfinite(seen[:, features.used]).all():
            continue
        if features.incoherence(seen) > CHAOTIC_POWER:
            window = _least_like(run, seen, floors)
            # A window may lie where the command rests or a sensor dropped out; the whole run does
            # not.
            own = _features(window, machine, channels, floors)
            loud.append((run, features) if own is None else (window, own))
    if not loud:
        return frozenset()
    simulator = Simulator(machine, [run for run, _ in loud], channels, threads=threads)
    for effect in with_stops:
        predicted = simulator.predict(_pairs(effect, len(loud), len(machine.joints)))
        for first, second in zip(predicted[::2], predicted[1::2], strict=True):
            for (_, features), one, two in zip(loud, first, second, strict=True):
                finite = np.isfinite(one).all() and np.isfinite(two).all()
                if finite and features.chaotic_share(one, two) > CHAOTIC_SHARE:
                    return frozenset(run.name for run, _ in loud)
    return frozenset()


def _features(
    trial: Trial, machine: NominalModel, channels: tuple[Channel, ...], floors: Array
) -> RandomFeatures | None:
    """Features of a run; None where it is too short, or its command does not vary."""
    try:
        return RandomFeatures.of_trial(trial, machine, channels, floors)
    except InvalidData:
        return None


def _least_like(run: Trial, seen: Array, floors: Array) -> Trial:
    """Window of the run with the largest deviation from its simulation (T, C)."""
    size = max(round(LOOKED_AT * run.rate), FEWEST)
    apart = np.nansum(((run.measured - seen) / floors) ** 2, axis=1)
    summed = np.concatenate([[0.0], np.cumsum(apart)])
    if size >= len(apart):
        return run
    first = int(np.argmax(summed[size:] - summed[:-size]))
    return run.between(first, first + size)


def _pairs(effect: Effect, runs: int, joints: int) -> list[Hypothesis]:
    """Pairs of an effect at each start with the stiffest stops, and slightly changed."""
    nudge = np.full((runs, joints), NUDGE)
    names = [parameter.name for parameter in effect.parameters]
    changed = {names.index(n): by for n, by in _OF_STOPS.items() if n in names}
    found = []
    for start in _with_hardest_stops(effect.starts, names):
        values = np.array(start)
        other = values.copy()
        for number, factor in changed.items():
            other[number] *= factor
        found += [
            Hypothesis(effects=(effect,), values=(values,)),
            Hypothesis(effects=(effect,), values=(other,), position=nudge),
        ]
    return found


def _with_hardest_stops(
    starts: Sequence[tuple[float, ...]], names: Sequence[str]
) -> list[tuple[float, ...]]:
    """Starts with the stiffest stops; all where the effect has no stop stiffness."""
    if "stiffness" not in names:
        return list(starts)
    number = names.index("stiffness")
    hardest = max(start[number] for start in starts)
    return [start for start in starts if start[number] == hardest]


def _driven(trial: Trial, machine: NominalModel) -> bool:
    """Return whether a run is one of random excitation through an actuator."""
    joints = {machine.actuated_joint.get(name) for name in machine.actuators}
    return trial.form == "forward" and bool(joints & set(trial.excited))
