"""Residual of an answer: in time, whitened, and of simulations, before and after the correction."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import csd, welch
from scipy.signal.windows import tukey

from loose_env.arms import quiet
from loose_env.gap.core.balance import Balance
from loose_env.gap.core.catalogue import Term
from loose_env.gap.core.decision import folds_of
from loose_env.gap.core.evidence import stretches_of, weight_of
from loose_env.gap.core.exact import Exact
from loose_env.gap.core.find import Answer
from loose_env.gap.core.motion import Motion, smooth
from loose_env.gap.core.selection import Selection, SetFit
from loose_env.gap.model.effects.sensors import quantity_of
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.result import ResidualTest
from loose_env.gap.runs import Channel, Trial, align_run, measured_runs
from loose_env.gap.simulator import Simulator
from loose_env.recording import Recording
from loose_env.typing import Array, ComplexArray

LAGS = 50
"""Lags of correlations that are looked at."""
OVERLAY_S = 4.0
"""Length of the stretch that is shown of a channel [s]."""
_EDGE_PERIODS = 2.0  # ends of a run that are not shown [periods of the end of the band]
_MOVING = 0.1  # speed over its root mean square above which a joint is shown moving
_TAPER = 0.3  # share of a run that is faded, at both ends together, before its spectrum is divided
_PLAYED_S = 60.0  # length of runs that are simulated for frequency responses, about: cost [s]
_SEGMENTS = 4
"""Segments of a run in a frequency response, overlapping by half; runs are averaged, too."""


def left_by(selection: Selection, fit: SetFit) -> tuple[Array, Array]:
    """Residual on data that a set was not fitted to, without its effects and with (T, channels)."""
    # Each run, or each alternate stretch of the only one, is left by the fit to the others.
    # Without, tolerances are as beside the effects: alone they would be pulled far to stand in for
    # them.
    balance, channels = selection.evidence.balance, selection.evidence.channels
    sides, stretches = (balance.residual.copy(), balance.residual.copy()), stretches_of(balance)
    for held in folds_of(selection, fit.terms)[0]:
        own = selection.without(held, fit)
        own_stretches = {int(s) for c, h in zip(channels, held, strict=True) for s in c.stretch[h]}
        for side, terms in zip(sides, ((), fit.terms), strict=True):
            parts = balance.motion.split(side)  # views
            whole = balance.motion.split(_remainder(selection, own, terms))
            for k in own_stretches:
                run, rows = stretches[k]
                parts[run][rows] = whole[run][rows]
    return sides


def _remainder(selection: Selection, fit: SetFit, terms: Iterable[Term]) -> Array:
    """Residual less the fitted tolerances and the columns of some effects (T, channels)."""
    left = selection.evidence.balance.residual.copy()
    parts = [(n.change, x) for n, x in selection.pulls(fit)]
    for term in terms:
        shares = selection.shares(fit, term)
        parts += [(c.change, x) for c, x in zip(term.columns, shares, strict=True)]
    for change, size in parts:
        left[:, : change.shape[1]] -= size * change.whole()
    return left


def _inner(balance: Balance) -> list[slice]:
    """Samples of each run without its ends, where the smoother knows one side alone."""
    runs, found, first = balance.motion.runs, [], 0
    for run in runs:
        count = len(run.position)
        edge = min(int(_EDGE_PERIODS / balance.motion.band / run.step), count // 10)
        found.append(slice(first + edge, first + count - edge))
        first += count
    return found


def whitened(balance: Balance, values: Array, channel: int) -> tuple[list[Array], float]:
    """Series of one channel in noise standard deviations, run by run, and its interval [s]."""
    # Its spectrum is divided by that of the noise, and cut at the end of the band: at an interval
    # of half that period noise alone is white.
    motion, found = balance.motion, []
    weight = weight_of(balance, channel)
    interval = motion.step
    for own in motion.split(values * weight):
        count = len(own)
        window = tukey(count, _TAPER)
        own = own * window / np.sqrt(np.mean(window**2))
        frequency: Array = np.asarray(np.fft.rfftfreq(count, motion.step), dtype=float)
        spectrum = np.fft.rfft(own) / balance.noise(channel, frequency)
        kept = max(int(np.sum(frequency <= motion.band)), 4)
        fewer = min(2 * (kept - 1), count)
        series = np.fft.irfft(spectrum[:kept], fewer) * np.sqrt(fewer / count)
        interval = motion.step * count / fewer
        found.append(series)
    return found, interval


def _correlation(one: Sequence[Array], other: Sequence[Array]) -> Array:
    """Mean correlation of series, run by run, at lags from 0 on (lags + 1,)."""
    lags = min(LAGS, *(len(series) - 2 for series in one))
    total = np.zeros(lags + 1)
    power = np.zeros(2)
    for a, b in zip(one, other, strict=True):
        x, y = a - a.mean(), b - b.mean()
        total += [x[lag:] @ y[: len(y) - lag] for lag in range(lags + 1)]
        power += x @ x, y @ y
    return np.asarray(total / max(float(np.sqrt(power.prod())), 1e-300))


def _rms(series: Sequence[Array]) -> float:
    """Root mean square of whitened series."""
    return float(np.sqrt(np.mean(np.concatenate(series) ** 2)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Correlation:
    """Correlation in time of a channel's residual on held-out data."""

    channel: str
    """Joint, or reading with its axis."""
    joint: str
    """Joint whose speed it is compared with."""
    interval: float
    """Interval of the lags [s]."""
    own: Array
    """Autocorrelation at lags from 0 on (L,)."""
    other: Array
    """Cross-correlation with that speed (L,)."""
    band: float
    """95 % band of one correlation of white series."""


def residual_tests(
    selection: Selection, left: Array
) -> tuple[tuple[ResidualTest, ...], tuple[Correlation, ...]]:
    """Whiteness of each channel's residual on held-out data, with the correlations that tell it."""
    balance, tests, found = selection.evidence.balance, [], []
    joints = balance.machine.joints
    for channel in selection.evidence.channels:
        k = channel.joint
        series, interval = whitened(balance, left[:, k], k)
        motion = [k] if k < len(joints) else range(len(joints))
        fastest = max(motion, key=lambda j: float(np.std(balance.speed[:, j])))
        speed, _ = whitened(balance, balance.speed[:, fastest], k)
        own, count = _correlation(series, series), sum(map(len, series))
        found.append(
            Correlation(
                channel=balance.channels[k], joint=joints[fastest], interval=interval, own=own,
                other=_correlation(series, speed), band=float(1.96 / np.sqrt(count)),
            )
        )  # fmt: skip
        ahead = own[1:]
        # of independent normal numbers the largest stays below this 95 times in 100
        limit = float(np.sqrt(2 * np.log(max(len(ahead), 1) / 0.0513) / count))
        together = ahead[: int(np.argmax(ahead <= limit))] if (ahead <= limit).any() else ahead
        tests.append(
            ResidualTest(
                channel=balance.channels[k], rms=_rms(series), autocorrelation=float(ahead[0]),
                whiteness_95=limit, largest_autocorrelation=float(np.max(np.abs(ahead))),
                correlation_time=interval * (1 + 2 * float(together.sum())),
            )
        )  # fmt: skip
    return tuple(tests), tuple(found)


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlay:
    """The stretch of a channel in which the nominal model misses most of the motion."""

    channel: str  # Joint, or reading with its axis
    run: str  # File of the run
    unit: str  # Unit of the values
    time: Array  # Times by the clock of the log [s] (T,)
    measured: Array  # Force of the drive, or what was read (T,)
    nominal: Array  # The same as the nominal model needs or foretells it (T,)
    corrected: Array  # The same of the corrected model (T,)


def overlays(selection: Selection, before: Array, after: Array, most: int) -> tuple[Overlay, ...]:
    """Measured against both models, of the channels that the nominal one misses most."""
    balance = selection.evidence.balance
    machine, readings = balance.machine, balance.motion.stacked("readings")
    logged = balance.motion.stacked("logged")
    length = int(OVERLAY_S / balance.motion.step)
    found: list[tuple[float, Overlay]] = []
    for k in (channel.joint for channel in selection.evidence.channels):
        at_joint = k < len(machine.joints)
        lost = weight_of(balance, k) * before[:, k] ** 2
        if at_joint:  # at rest it is judged where it hardly moves, and there is nothing to see
            speed = np.abs(balance.speed[:, k])
            lost *= speed > _MOVING * np.sqrt(np.mean(speed**2))
        stretches = [
            (run, slice(first, min(first + length, inner.stop)))
            for run, inner in enumerate(_inner(balance))
            for first in range(inner.start, max(inner.stop - length // 2, inner.start + 1), length)
        ]
        run, rows = max(stretches, key=lambda own: float(np.mean(lost[own[1]])))
        measured = balance.drive[rows, k] if at_joint else readings[rows, k - len(machine.joints)]
        unit = "as recorded" if not at_joint else "N·m" if machine.turns(machine.joints[k]) else "N"
        overlay = Overlay(
            channel=balance.channels[k], run=balance.motion.runs[run].name, unit=unit,
            time=logged[rows], measured=measured, nominal=measured - before[rows, k],
            corrected=measured - after[rows, k],
        )  # fmt: skip
        found.append((_rms(whitened(balance, before[:, k], k)[0]), overlay))
    return tuple(each for _, each in sorted(found, key=lambda pair: -pair[0])[:most])


def parameter_correlation(selection: Selection, fit: SetFit) -> tuple[tuple[str, ...], Array]:
    """Names of the coefficients of a set, and their posterior correlation (K, K)."""
    names, at = [], []
    for term in fit.terms:
        own = selection.evidence.columns_of(term)
        for number in range(1, len(own) + 1):
            axis = f" {number}" * (len(own) > 1)
            names.append(f"{term.effect.kind} {term.effect.where}{axis}")
        at += fit.places(own).tolist()
    covariance = np.linalg.inv(fit.normal)[np.ix_(at, at)] if at else np.zeros((0, 0))
    scale = 1 / np.sqrt(np.diag(covariance))
    return tuple(names), np.asarray(covariance * np.outer(scale, scale))


# Simulation


def simulated(
    answer: Answer, corrected: Hypothesis
) -> tuple[dict[str, tuple[float, float]], Played | None]:
    """Errors by quantity, and the beginnings of the runs, by the nominal and corrected model."""
    # Errors are of simulations of one second, between the windows that were fitted to or in the
    # runs that were kept out. Nothing of recordings whose drives do not follow commands.
    balance = answer.selection.evidence.balance
    if balance.released.any():
        return {}, None
    recording = answer.recording
    with quiet():
        if answer.held_out is not None:
            recording = answer.held_out
            balance = Balance(balance.machine, smooth(recording, balance.machine))
        exact = Exact(recording, balance, threads=answer.settings.threads, between=True)
        errors = _errors(exact, _predicted(exact.simulator, corrected))
        played = _beginnings(recording, balance.motion, exact)
        nominal, found = _predicted(played, corrected)
    return errors, Played(
        machine=balance.machine, trials=tuple(played.trials), channels=exact.channels,
        nominal=tuple(nominal), corrected=tuple(found),
        begins=tuple(float(run.logged[0]) for run in balance.motion.runs),
    )  # fmt: skip


def _predicted(simulator: Simulator, corrected: Hypothesis) -> list[list[Array]]:
    """Readings of all runs by the nominal and the corrected model, each as its payload was."""
    differ = any(effect.mountings for effect in corrected.effects)
    runs = [trial.name if differ else "" for trial in simulator.trials]
    models = {run: corrected.in_run(run) for run in runs}
    nominal, *found = simulator.predict([Hypothesis(), *models.values()])
    order = list(models)
    return [list(nominal), [found[order.index(run)][k] for k, run in enumerate(runs)]]


def _errors(exact: Exact, predicted: Sequence[Sequence[Array]]) -> dict[str, tuple[float, float]]:
    """Root mean square error by quantity of the nominal and of the corrected model."""
    each = (c.column.partition(".") for c in exact.channels)
    unknown, machine = ("", ""), exact.balance.machine
    told = [quantity_of(machine, n) if kind == "sensor" else unknown for kind, _, n in each]
    names = np.array([f"{words} [{unit}]" if words else "" for words, unit in told])
    measured = np.concatenate([trial.measured for trial in exact.simulator.trials])
    seen = np.isfinite(measured)
    off = [np.where(seen, measured - np.concatenate(own), 0.0) for own in predicted]
    squares = np.nan_to_num(np.sum(np.square(off), axis=1), nan=np.inf)
    found = {}
    for name in filter(None, dict.fromkeys(names.tolist())):
        of = names == name
        nominal, corrected = np.sqrt(squares[:, of].sum(axis=1) / seen[:, of].sum())
        found[name] = float(nominal), float(corrected)
    return found


def _beginnings(recording: Recording, motion: Motion, exact: Exact) -> Simulator:
    """Simulator of the beginnings of the runs, each from its smoothed state."""
    machine = exact.balance.machine
    trials = []
    for run, state in zip(
        measured_runs(recording.runs, machine.model)[0], motion.runs, strict=True
    ):
        whole = align_run(run, machine, exact.channels, step=machine.time_step)
        last = state.begin + _PLAYED_S / len(motion.runs)
        first, end = np.searchsorted(whole.time, [state.begin, last])
        trial = whole.between(int(first), int(end) + 1)
        trials.append(replace(trial, position=state.position[0], speed=state.speed[0]))
    return Simulator(machine, trials, exact.channels, threads=exact.simulator.threads)


def force_errors(answer: Answer, before: Array, after: Array) -> dict[str, tuple[float, float]]:
    """Root mean square force that is missing on held-out data, of hinges and of slides."""
    evidence = answer.selection.evidence
    balance, joints = evidence.balance, evidence.balance.machine.joints
    inner = np.concatenate([np.arange(s.start, s.stop) for s in _inner(balance)])
    own = [c.joint for c in evidence.channels if c.joint < len(joints)]
    turning = balance.machine.hinges[own]
    found = {}
    for quantity, of in (("joint torque [N·m]", turning), ("joint force [N]", ~turning)):
        if of.any():
            at = np.ix_(inner, np.array(own)[of])
            weight = np.stack([weight_of(balance, k) for k in at[1][0]], axis=1)[inner]
            total = max(float(weight.sum()), 1e-300)
            sides = (float(np.sqrt(np.sum(weight * x[at] ** 2) / total)) for x in (before, after))
            found[quantity] = next(sides), next(sides)
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """Runs simulated from their commands by the nominal and by the corrected model."""

    machine: NominalModel
    """The nominal model."""
    trials: tuple[Trial, ...]
    """The runs."""
    channels: tuple[Channel, ...]
    """Their columns."""
    nominal: tuple[Array, ...]
    """Readings of the nominal model at the samples of each run (T, C)."""
    corrected: tuple[Array, ...]
    """Readings of the corrected model."""
    begins: tuple[float, ...]
    """Times at which each begins, by the clock of the log [s]."""

    def column_of(self, joint: str) -> int | None:
        """Which column reads the position of a joint; None where none does."""
        read = (self.machine.encoders.get(c.column.removeprefix("sensor.")) for c in self.channels)
        return next((k for k, own in enumerate(read) if own == joint), None)


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Frequency response of a joint to the command of its drive."""

    joint: str  # Name of the joint
    frequency: Array  # Frequencies [Hz] (F,)
    gains: Mapping[str, ComplexArray]  # "measured", "nominal" and "corrected" -> complex gain (F,)


def responses(shown: Played, band: float) -> tuple[Response, ...]:
    """Frequency responses of servoed joints, measured and simulated from the same commands."""
    # Of the frequencies in which the command has a hundredth of its largest power.
    machine, found = shown.machine, []
    for number, actuator in machine.servos.items():
        joint = machine.joints[number]
        if (read := shown.column_of(joint)) is None:
            continue
        parts = []
        for trial, *models in zip(shown.trials, shown.nominal, shown.corrected, strict=True):
            readings = np.stack([values[:, read] for values in (trial.measured, *models)])
            if len(trial.time) >= 64 and np.isfinite(readings[0]).all():
                command = trial.at_samples(trial.controls)[:, actuator]
                rate = {"fs": trial.rate, "nperseg": max(2 * len(command) // (_SEGMENTS + 1), 32)}
                frequency, power = welch(command, **rate)
                parts.append((frequency, [power, *csd(command, readings, **rate)[1]]))
        if not parts:
            continue
        grid = min((frequency for frequency, _ in parts), key=len)
        grid = grid[(grid > 0) & (grid <= band)]
        power, *cross = np.sum(
            [[np.interp(grid, frequency, row) for row in rows] for frequency, rows in parts], axis=0
        )
        excited = power.real > 0.01 * power.real.max(initial=0.0)
        if excited.sum() >= 3:
            gains = zip(("measured", "nominal", "corrected"), cross / power, strict=True)
            known = {kind: each[excited] for kind, each in gains if np.isfinite(each).all()}
            found.append(Response(joint=joint, frequency=grid[excited], gains=known))
    return tuple(found)
