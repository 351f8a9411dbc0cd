"""Checks of the time column: rate, even steps, pauses, length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import signal

from loose_env.doctor.channels import Channel, Machine, filled
from loose_env.doctor.findings import Finding
from loose_env.doctor.thresholds import (
    BAND_POWER,
    BAND_SHARE,
    HIGHEST_RATE_HZ,
    LEAST_RATE_HZ,
    LEAST_RUN_S,
    ODD_RATE,
    PAUSE_S,
    PAUSE_STEPS,
    SLOWEST_RATE_HZ,
    UNEVEN_STEP,
    VERY_UNEVEN_STEP,
)
from loose_env.importing import median_step
from loose_env.recording import Run
from loose_env.typing import Array


def check_sampling(machine: Machine, run: Run, channels: Sequence[Channel]) -> Iterator[Finding]:
    """Check the time of one run."""
    step = median_step(run.time)
    rate = 1 / step
    length = float(run.time[-1] - run.time[0])
    if rate < SLOWEST_RATE_HZ or rate > HIGHEST_RATE_HZ:
        yield Finding(
            check="rate",
            severity="error",
            run=run.name,
            channel="time",
            found=f"sampled at {rate:.4g} Hz over {length:.4g} s",
            value=rate,
            unit="Hz",
            consequence="the times are not in seconds, and every frequency is wrong",
            remedy="import the times with their unit",
        )
        return
    if rate < LEAST_RATE_HZ:
        yield Finding(
            check="rate",
            severity="error" if run.excited else "warning",  # no joint is shaken so slowly
            run=run.name,
            channel="time",
            found=f"sampled at {rate:.4g} Hz over {length:.4g} s",
            value=rate,
            unit="Hz",
            consequence=f"motion above {rate / 2:.3g} Hz is not resolved, and servos reach 5 to "
            "10 Hz",
            remedy=f"record at {LEAST_RATE_HZ:g} Hz or more; where the times are not in seconds, "
            "import them with their unit",
        )
    if length < LEAST_RUN_S:
        yield Finding(
            check="length",
            severity="warning",
            run=run.name,
            channel="time",
            found=f"{length:.3g} s long",
            value=length,
            unit="s",
            consequence="spectra of so short a run have few lines, and its results scatter",
            remedy="record 1 s or more; where the times are not in seconds, import them with "
            "their unit",
        )
    yield from _steps(run, step)
    if run.excited:
        yield from _band(machine, run, channels, rate)


def _steps(run: Run, step: float) -> Iterator[Finding]:
    steps = np.diff(run.time) / step
    pauses = np.flatnonzero((steps > PAUSE_STEPS) & (steps * step > PAUSE_S))
    if pauses.size:
        longest = int(pauses[np.argmax(steps[pauses])])
        seconds = float(steps[longest] * step)
        yield Finding(
            check="pauses",
            severity="warning",
            run=run.name,
            channel="time",
            found=f"{pauses.size} pause{'s' * (pauses.size > 1)} of the recorder, the longest "
            f"{seconds:.3g} s from {run.time[longest]:.4g} s on",
            value=seconds,
            unit="s",
            consequence="a diagnosis uses the longest piece without a pause alone",
            remedy="record the run again without pauses, or cut it to a piece without one",
        )
    even = np.delete(steps, pauses)
    # Whole missing rows are no jitter.
    off = even - np.maximum(np.round(even), 1.0)
    jitter = float(np.sqrt(np.mean(off**2))) if even.size else 0.0
    if jitter > UNEVEN_STEP:
        yield Finding(
            check="uneven",
            severity="warning" if jitter > VERY_UNEVEN_STEP else "note",
            run=run.name,
            channel="time",
            found=f"time steps scatter by {1e3 * jitter * step:.3g} ms rms about their median of "
            f"{1e3 * step:.3g} ms",
            value=jitter * step,
            unit="s",
            consequence="spectra above about a quarter of the rate are less exact",
            remedy="where it is the stamps that jitter and not the samples, import with "
            "even = true; else record with a hardware clock",
        )


def _band(
    machine: Machine, run: Run, channels: Sequence[Channel], rate: float
) -> Iterator[Finding]:
    for channel in channels:
        joint = _driven(machine, channel)
        if joint not in run.excited:
            continue
        top = band_top(run.time, channel.values)
        if top is not None and top > BAND_SHARE * rate:
            yield Finding(
                check="rate",
                severity="warning",
                run=run.name,
                channel=channel.name,
                found=f"its noise reaches {top:.3g} Hz, and the sampling rate is {rate:.4g} Hz",
                value=top,
                unit="Hz",
                consequence=f"above {BAND_SHARE:g} of the rate anti-aliasing filters attenuate, "
                "and without one readings are aliased",
                remedy=f"record at {top / BAND_SHARE:.4g} Hz or more, or narrow the noise to "
                f"{BAND_SHARE * rate:.3g} Hz",
            )


def _driven(machine: Machine, channel: Channel) -> str:
    if channel.kind == "torque":
        return channel.of
    drive = machine.drives.get(channel.of) if channel.kind == "command" else None
    return "" if drive is None else drive.joint


def band_top(time: Array, values: Array) -> float | None:
    """Frequency below which the power of a command lies [Hz]; None for a command at rest."""
    column = signal.detrend(filled(time, values))
    if column.std() <= 1e-12 * (1 + np.abs(values[np.isfinite(values)]).max(initial=0.0)):
        return None
    frequency, power = signal.welch(column, 1 / median_step(time), nperseg=min(len(column), 1024))
    share = np.cumsum(power) / power.sum()
    return float(frequency[int(np.searchsorted(share, BAND_POWER))])


def check_rates(runs: Sequence[Run]) -> Iterator[Finding]:
    """Compare the rates of all runs."""
    rates = np.array([1 / median_step(run.time) for run in runs])
    odd = np.flatnonzero(np.abs(rates / np.median(rates) - 1) > ODD_RATE)
    if odd.size:
        run = runs[int(odd[0])]
        yield Finding(
            check="rate",
            severity="note",
            run=run.name,
            channel="time",
            found=f"sampled at {rates[odd[0]]:.4g} Hz, the other runs at "
            f"{float(np.median(rates)):.4g} Hz",
            value=float(rates[odd[0]]),
            unit="Hz",
            consequence="runs of different rates are compared over the band of the slower",
            remedy="record all runs at one rate; check that the times are in seconds",
        )
