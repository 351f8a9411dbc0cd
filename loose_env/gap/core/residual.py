"""Residual of an answer: in time, whitened, and of simulations, before and after the correction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.signal import csd, welch
from scipy.signal.windows import tukey

from loose_env.arms import quiet
from loose_env.gap.core.balance import Balance
from loose_env.gap.core.decision import folds_of
from loose_env.gap.core.evidence import stretches_of, weight_of
from loose_env.gap.core.exact import Exact, stepped
from loose_env.gap.core.find import Answer
from loose_env.gap.core.motion import smooth
from loose_env.gap.core.selection import Selection, SetFit
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.result import ResidualTest
from loose_env.gap.runs import Channel, Trial, align_run, channels_of, measured_runs
from loose_env.gap.simulator import Simulator
from loose_env.recording import joint_sensors
from loose_env.typing import Array, ComplexArray

LAGS = 50
"""Lags of correlations that are looked at."""
OVERLAY_S = 4.0
"""Length of the stretch that is shown of a channel [s]."""
_EDGE_PERIODS = 2.0
"""Ends of a run that are not shown [periods of the end of the band]."""
_TAPER = 0.3
"""Share of a run that is faded, at both ends together, before its spectrum is divided."""
_PLAYED_S = 60.0
"""Length of runs that are simulated for frequency responses, about: cost [s]."""
_SEGMENTS = 4
"""Segments of a run in a frequency response, overlapping by half; runs are averaged, too."""


def left_by(selection: Selection, fit: SetFit) -> Array:
    """Residual of a fitted set on data it was not fitted to (T, channels).

    Each run, or each alternate stretch of the only one, is left by the fit to the others.
    """
    balance, channels = selection.evidence.balance, selection.evidence.channels
    starts = np.cumsum([0, *(len(run.position) for run in balance.motion.runs)])
    pieces = [
        slice(starts[run] + rows.start, starts[run] + rows.stop)
        for run, rows in stretches_of(balance)
    ]
    found = balance.residual.copy()
    for held in folds_of(selection)[0]:
        own = selection.on([~h for h in held]).fit(fit.terms, fit.powers, 3)
        whole = _remainder(selection, own)
        shown = {int(s) for c, h in zip(channels, held, strict=True) for s in c.stretch[h]}
        for piece in shown:
            found[pieces[piece]] = whole[pieces[piece]]
    return found


def _remainder(selection: Selection, fit: SetFit) -> Array:
    """Residual less all fitted columns (T, channels)."""
    evidence = selection.evidence
    left = evidence.balance.residual.copy()
    pulls = evidence.mixed @ fit.values[: evidence.tolerances]
    place = {k: i for i, k in enumerate(fit.numbers)}
    parts = [(n.change, x) for n, x in zip(evidence.nuisances, pulls, strict=True)]
    for term in fit.terms:
        numbers = evidence.columns_of(term)
        parts += [
            (column.change, fit.values[place[k]])
            for k, column in zip(numbers, term.columns, strict=True)
        ]
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
    """Series of one channel in noise standard deviations, run by run, and its interval [s].

    Its spectrum is divided by that of the noise, and cut at the end of the band: at an interval of
    half that period noise alone is white.
    """
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


def correlation(one: Sequence[Array], other: Sequence[Array], lags: int = LAGS) -> Array:
    """Mean correlation of series, run by run, at lags from 0 on (lags + 1,).

    Examples
    --------
    >>> swing = np.sin(2 * np.pi * np.arange(4000) / 20)
    >>> [round(float(r), 2) for r in correlation([swing], [swing])[[0, 10, 20]]]
    [1.0, -1.0, 0.99]
    """
    lags = min(lags, *(len(series) - 2 for series in one))
    total = np.zeros(lags + 1)
    power = np.zeros(2)
    for a, b in zip(one, other, strict=True):
        x, y = a - a.mean(), b - b.mean()
        total += [x[lag:] @ y[: len(y) - lag] for lag in range(lags + 1)]
        power += x @ x, y @ y
    return np.asarray(total / max(float(np.sqrt(power.prod())), 1e-300))


def _size(balance: Balance, values: Array, channel: int) -> float:
    """Mean square of a channel's series in noise variances."""
    return float(np.mean(np.concatenate(whitened(balance, values[:, channel], channel)[0]) ** 2))


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


def correlations(selection: Selection, left: Array, most: int) -> tuple[Correlation, ...]:
    """Correlations of the channels of the largest residuals, whitened by their noise."""
    balance, found = selection.evidence.balance, []
    joints = balance.machine.joints
    for channel in selection.evidence.channels:
        k = channel.joint
        series, interval = whitened(balance, left[:, k], k)
        motion = [k] if k < len(joints) else range(len(joints))
        fastest = max(motion, key=lambda j: float(np.std(balance.speed[:, j])))
        speed, _ = whitened(balance, balance.speed[:, fastest], k)
        found.append(
            Correlation(
                channel=balance.channels[k], joint=joints[fastest], interval=interval,
                own=correlation(series, series), other=correlation(series, speed),
                band=float(1.96 / np.sqrt(sum(map(len, series)))),
            )
        )  # fmt: skip
    sizes = [_size(balance, left, channel.joint) for channel in selection.evidence.channels]
    return tuple(found[k] for k in np.argsort(sizes)[::-1][:most])


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlay:
    """The stretch of a channel in which the nominal model misses most."""

    channel: str
    """Joint, or reading with its axis."""
    run: str
    """File of the run."""
    unit: str
    """Unit of the values."""
    time: Array
    """Times from the beginning of the stretch [s] (T,)."""
    measured: Array
    """Force of the drive, or what was read (T,)."""
    nominal: Array
    """The same as the nominal model needs or foretells it (T,)."""
    corrected: Array
    """The same of the corrected model (T,)."""


def overlays(selection: Selection, before: Array, after: Array, most: int) -> tuple[Overlay, ...]:
    """Measured against both models, of the channels that the nominal one misses most."""
    balance = selection.evidence.balance
    machine, readings = balance.machine, balance.motion.stacked("readings")
    length = int(OVERLAY_S / balance.motion.step)
    found: list[tuple[float, Overlay]] = []
    for k in (channel.joint for channel in selection.evidence.channels):
        lost = weight_of(balance, k) * before[:, k] ** 2
        stretches = [
            (run, slice(first, min(first + length, inner.stop)))
            for run, inner in enumerate(_inner(balance))
            for first in range(inner.start, max(inner.stop - length // 2, inner.start + 1), length)
        ]
        run, rows = max(stretches, key=lambda own: float(np.mean(lost[own[1]])))
        at_joint = k < len(machine.joints)
        measured = balance.drive[rows, k] if at_joint else readings[rows, k - len(machine.joints)]
        unit = "as recorded" if not at_joint else "N·m" if machine.turns(machine.joints[k]) else "N"
        overlay = Overlay(
            channel=balance.channels[k], run=balance.motion.runs[run].name, unit=unit,
            time=np.asarray(np.arange(len(measured)) * balance.motion.step, dtype=float),
            measured=measured, nominal=measured - before[rows, k],
            corrected=measured - after[rows, k],
        )  # fmt: skip
        found.append((_size(balance, before, k), overlay))
    return tuple(each for _, each in sorted(found, key=lambda pair: -pair[0])[:most])


def parameter_correlation(selection: Selection, fit: SetFit) -> tuple[tuple[str, ...], Array]:
    """Names of the coefficients of a set, and their posterior correlation (K, K)."""
    place = {k: i for i, k in enumerate(fit.numbers)}
    names, at = [], []
    for term in fit.terms:
        own = selection.evidence.columns_of(term)
        for number, k in enumerate(own, start=1):
            axis = f" {number}" * (len(own) > 1)
            names.append(f"{term.effect.kind} {term.effect.where}{axis}")
            at.append(place[k])
    covariance = np.linalg.inv(fit.normal)[np.ix_(at, at)] if at else np.zeros((0, 0))
    scale = 1 / np.sqrt(np.diag(covariance))
    return tuple(names), np.asarray(covariance * np.outer(scale, scale))


def residual_tests(selection: Selection, left: Array) -> tuple[ResidualTest, ...]:
    """Test each channel's residual on held-out data for whiteness."""
    balance, found = selection.evidence.balance, []
    for channel in selection.evidence.channels:
        series, interval = whitened(balance, left[:, channel.joint], channel.joint)
        own = correlation(series, series)
        lags, count = len(own) - 1, sum(map(len, series))
        # of `lags` independent normal numbers the largest stays below this 95 times in 100
        limit = float(np.sqrt(2 * np.log(max(lags, 1) / 0.0513) / count))
        ahead = own[1:]
        together = ahead[: int(np.argmax(ahead <= limit))] if (ahead <= limit).any() else ahead
        found.append(
            ResidualTest(
                channel=balance.channels[channel.joint],
                rms=float(np.sqrt(np.mean(np.concatenate(series) ** 2))),
                autocorrelation=float(ahead[0]),
                whiteness_95=limit,
                largest_autocorrelation=float(np.max(np.abs(ahead))),
                correlation_time=interval * (1 + 2 * float(together.sum())),
            )
        )
    return tuple(found)


# Simulation


def simulated_errors(answer: Answer, corrected: Hypothesis) -> dict[str, tuple[float, float]]:
    """Errors of simulations of one second by quantity, nominal and corrected.

    The windows are of the runs that were kept out, or between those that were fitted to.
    """
    balance = answer.selection.evidence.balance
    machine, recording = balance.machine, answer.recording
    if balance.released.any() or not stepped(corrected.effects):
        return {}
    with quiet():
        if answer.held_out is not None:
            recording = answer.held_out
            balance = Balance(machine, smooth(recording, machine))
        exact = Exact(recording, balance, threads=answer.settings.threads, between=True)
        simulator = exact.simulator
        predicted = simulator.predict([Hypothesis(), corrected])
    found: dict[str, tuple[float, float]] = {}
    names = [quantity_of(machine, c.column) or "" for c in exact.channels]
    for quantity in dict.fromkeys(filter(None, names)):
        own = [k for k, name in enumerate(names) if name == quantity]
        errors = []
        for shown in predicted:
            off = np.concatenate(
                [
                    (trial.measured[:, own] - values[:, own])[np.isfinite(trial.measured[:, own])]
                    for trial, values in zip(simulator.trials, shown, strict=True)
                ]
            )
            errors.append(float(np.sqrt(np.mean(off**2))) if np.isfinite(off).all() else np.inf)
        found[quantity] = errors[0], errors[1]
    return found


def force_errors(answer: Answer, before: Array, after: Array) -> dict[str, tuple[float, float]]:
    """Root mean square force that is missing on held-out data, of hinges and of slides."""
    evidence = answer.selection.evidence
    machine, found = evidence.balance.machine, {}
    for turns, quantity in ((True, "joint torque [N·m]"), (False, "joint force [N]")):
        own = [
            c.joint
            for c in evidence.channels
            if c.joint < len(machine.joints) and machine.turns(machine.joints[c.joint]) == turns
        ]
        if own:
            shown = np.zeros(len(before))
            for inner in _inner(evidence.balance):
                shown[inner] = 1.0
            weight = np.stack([shown * weight_of(evidence.balance, k) for k in own], axis=1)
            total = max(float(weight.sum()), 1e-300)
            one, other = (
                float(np.sqrt(np.sum(weight * x[:, own] ** 2) / total)) for x in (before, after)
            )
            found[quantity] = one, other
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


def played(answer: Answer, corrected: Hypothesis) -> Played | None:
    """Simulate the beginnings of the runs, those that were kept out if there are any.

    None of recordings whose drives do not follow commands, or where an effect has a memory.
    """
    balance = answer.selection.evidence.balance
    machine = balance.machine
    if balance.released.any() or not stepped(corrected.effects):
        return None
    shown = answer.recording if answer.held_out is None else answer.held_out
    pieces, _ = measured_runs(shown.runs, machine.model)
    runs = [run for each in pieces for run in each]
    channels = channels_of(runs)
    trials = [align_run(run, machine, channels, step=machine.time_step) for run in runs]
    trials = [trial.until(_PLAYED_S / len(trials)) for trial in trials]
    simulator = Simulator(machine, trials, channels, threads=answer.settings.threads)
    with quiet():
        nominal, found = simulator.predict([Hypothesis(), corrected])
    return Played(
        machine=machine, trials=tuple(trials), channels=channels, nominal=tuple(nominal),
        corrected=tuple(found),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Frequency response of a joint to the command of its drive."""

    joint: str
    """Name of the joint."""
    frequency: Array
    """Frequencies [Hz] (F,)."""
    gains: Mapping[str, ComplexArray]
    """"measured", "nominal" and "corrected" -> complex gain (F,)."""


def responses(shown: Played, band: float) -> tuple[Response, ...]:
    """Frequency responses of servoed joints, measured and simulated from the same commands.

    Of the frequencies in which the command has a hundredth of its largest power.
    """
    machine, found = shown.machine, []
    sensors = joint_sensors(machine.model)
    for actuator, drive in enumerate(machine.actuators):
        servo = machine.affine_actuators[actuator] and machine.model.actuator_biasprm[actuator, 1]
        if not servo or drive not in machine.actuated_joint:
            continue
        joint = machine.actuated_joint[drive]
        own = [
            k
            for k, channel in enumerate(shown.channels)
            if channel.column in {f"sensor.{name}" for name in sensors[joint].position}
        ]
        parts: dict[str, list[tuple[Array, Array, Array]]] = {}
        for trial, *simulated in zip(shown.trials, shown.nominal, shown.corrected, strict=True):
            if len(trial.time) < 64:
                continue
            command = trial.at_samples(trial.controls)[:, actuator]
            rate = {"fs": trial.rate, "nperseg": max(2 * len(command) // (_SEGMENTS + 1), 32)}
            frequency, power = welch(command, **rate)
            kinds = ("measured", "nominal", "corrected")
            for kind, values in zip(kinds, (trial.measured, *simulated), strict=True):
                if np.isfinite(values[:, own[0]]).all():
                    _, cross = csd(command, values[:, own[0]], **rate)
                    parts.setdefault(kind, []).append((frequency, power, cross))
        whole = _averaged(parts, band)
        if whole is not None:
            found.append(Response(joint=joint, frequency=whole[0], gains=whole[1]))
    return tuple(found)


def _averaged(
    parts: Mapping[str, list[tuple[Array, Array, Array]]], band: float
) -> tuple[Array, dict[str, ComplexArray]] | None:
    """Gains averaged over runs, at the frequencies of the coarsest that are excited."""
    if not parts.get("measured"):
        return None
    grid = min((f for f, _, _ in parts["measured"]), key=len)
    grid = grid[(grid > 0) & (grid <= band)]

    def total(each: Sequence[tuple[Array, Array, Array]], which: int) -> Array:
        return np.asarray(sum(np.interp(grid, part[0], part[which]) for part in each))

    power = total(parts["measured"], 1)
    kept = power > 0.01 * power.max(initial=0.0)
    if kept.sum() < 3:
        return None
    gains = {kind: (total(own, 2) / total(own, 1))[kept] for kind, own in parts.items()}
    return grid[kept], gains


# Quantities

_SENSOR = mujoco.mjtSensor
_OF_A_JOINT = {
    _SENSOR.mjSENS_JOINTPOS: ("joint position", "rad", "m"),
    _SENSOR.mjSENS_ACTUATORPOS: ("drive position", "rad", "m"),
    _SENSOR.mjSENS_JOINTVEL: ("joint speed", "rad/s", "m/s"),
    _SENSOR.mjSENS_ACTUATORVEL: ("drive speed", "rad/s", "m/s"),
    _SENSOR.mjSENS_ACTUATORFRC: ("drive torque", "N·m", "N"),
    _SENSOR.mjSENS_JOINTACTFRC: ("actuator torque", "N·m", "N"),
}
"""Quantity, its unit where the joint turns, and where it slides."""
_OF_A_SITE = {
    _SENSOR.mjSENS_ACCELEROMETER: ("acceleration", "m/s²"),
    _SENSOR.mjSENS_FRAMELINACC: ("acceleration", "m/s²"),
    _SENSOR.mjSENS_GYRO: ("turning rate", "rad/s"),
    _SENSOR.mjSENS_FRAMEANGVEL: ("turning rate", "rad/s"),
    _SENSOR.mjSENS_FRAMEPOS: ("position in space", "m"),
    _SENSOR.mjSENS_VELOCIMETER: ("speed in space", "m/s"),
    _SENSOR.mjSENS_FORCE: ("force", "N"),
    _SENSOR.mjSENS_TORQUE: ("torque at a site", "N·m"),
}


def quantity_of(machine: NominalModel, column: str) -> str | None:
    """Quantity and unit of a sensor's column; None for one of unknown unit."""
    model = machine.model
    source, _, name = column.partition(".")
    if source != "sensor":
        return None
    sensor = model.sensor(name)
    kind, number = mujoco.mjtSensor(int(sensor.type[0])), int(sensor.objid[0])
    if kind in _OF_A_SITE:
        return "{} [{}]".format(*_OF_A_SITE[kind])
    if kind not in _OF_A_JOINT:
        return None
    if int(sensor.objtype[0]) == mujoco.mjtObj.mjOBJ_ACTUATOR:
        if int(model.actuator_trntype[number]) != mujoco.mjtTrn.mjTRN_JOINT:
            return None
        number = int(model.actuator_trnid[number, 0])
    words, turning, sliding = _OF_A_JOINT[kind]
    return f"{words} [{turning if machine.turns(model.joint(number).name) else sliding}]"
