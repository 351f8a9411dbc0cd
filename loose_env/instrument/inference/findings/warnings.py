"""Warnings that limit the validity of a diagnosis: of the runs, of the model, of the fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.findings.free_travel import Travel
from loose_env.instrument.inference.laplace_fit import fitted_pieces, seats_of
from loose_env.instrument.inference.opening_probability import open_probability, seat_forces
from loose_env.instrument.inference.posterior import ModelComparison
from loose_env.instrument.inference.response.timing import ClockOffset, ServoTiming
from loose_env.instrument.inference.seat_motion import Seat
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.result import HEALTHY
from loose_env.instrument.settings.thresholds import (
    FEWEST_LINES,
    JOINT_SIGNAL,
    MODEL_ERROR,
    MOTION_ERROR,
    OPENING_PROBABILITY,
    PARAMETER_ERROR,
    PRESSED_FORCE,
    SERVO_DELAY_NOTED_S,
    SHORT_RUN_S,
    TOOL_SIGNAL,
)
from loose_env.statistics import axes_grid


def warnings_of(
    arm: InstrumentedArm,
    comparison: ModelComparison,
    notes: Sequence[str],
    travel: Travel | None,
    *,
    clocks: Sequence[ClockOffset] = (),
    servos: Sequence[ServoTiming] = (),
) -> tuple[str, ...]:
    """Collect the warnings, most severe first."""
    said: list[str] = []
    suspect = [one for one in comparison.evidence.lines if not one.healthy]
    said += model_warnings(comparison)
    said += _of_timing(clocks, servos)
    said += _of_seats(arm, comparison, suspect)
    if travel is not None and travel.linear:
        said.append(
            "the force across the seat is as well that of a spring without free travel: it may be "
            "a loose seat pressed to one stop, or a compliant part; a pose in which gravity does "
            "not press on it tells them apart"
        )
    for one in suspect:
        said += _of_run(arm, one)
    if any(one.folded > 0 for one in comparison.lines):
        said.append(
            "the sensors seem to be sampled without a filter: what is faster than half the rate "
            "is folded into the band, whose upper part is trusted less; switch on the recorder's "
            "filter"
        )
    unknown = arm.actuators.unknown
    if unknown:
        said.append(
            f"the law of actuator {', '.join(unknown)} is not a force linear in command, position "
            "and velocity; what it does is taken as unknown"
        )
    said += notes
    return tuple(dict.fromkeys(said))


def model_warnings(comparison: ModelComparison) -> list[str]:
    """Warnings that the model is not that of the arm: they invalidate a result."""
    fit = comparison.fits[comparison.best]
    names = comparison.evidence.uncertain.names
    expected = comparison.evidence.uncertain.expected(0)
    errors = np.abs(fit.errors[: len(names)] - expected)
    worst = int(np.argmax(errors)) if len(errors) else 0
    strain = float(errors[worst]) if len(errors) else 0.0
    misfit = float(np.sqrt(comparison.misfit))
    motion = _motion_error(comparison)
    found = []
    if misfit > MODEL_ERROR:
        found.append(f"{misfit:.0%} of the motion remains unexplained")
    if motion > MOTION_ERROR:
        found.append(f"the motion of the excited joints is off by {motion:.0%}")
    if strain > PARAMETER_ERROR:
        found.append(f"{names[worst]} is off by {strain:.1f} times its tolerance")
    if not found:
        return []
    return [
        f"the model is not that of this arm: {', '.join(found)}. The location and the "
        "probabilities below are less certain than stated; find the model error with 'loose gap', "
        "and diagnose with the corrected model"
    ]


def _motion_error(comparison: ModelComparison) -> float:
    """Median relative error of the motion of the excited joints, over the runs [1]."""
    index, fit = comparison.evidence.index, comparison.fits[comparison.best]
    errors = [
        np.sqrt(fit.variances[index.columns(one.number, change=False)[joint]])
        for one in comparison.lines
        if one.beside is None
        for joint in one.excited
        if not one.blind[joint]
    ]
    return float(np.median(errors)) if errors else 0.0


def _of_timing(clocks: Sequence[ClockOffset], servos: Sequence[ServoTiming]) -> list[str]:
    said = []
    for clock in clocks:
        if clock.noted:
            said.append(
                f"{clock.words} against the joints' sensors (standard deviation "
                f"{clock.sd * 1e3:.2g} ms); the readings were shifted by it: put both on one clock"
            )
    for servo in servos:
        if abs(servo.delay_s) > SERVO_DELAY_NOTED_S:
            late = "after" if servo.delay_s > 0 else "before"
            band = "" if servo.bandwidth_hz is None else f", bandwidth {servo.bandwidth_hz:.0f} Hz"
            said.append(
                f"joint {servo.joint} moves {abs(servo.delay_s) * 1e3:.1f} ms {late} what the "
                f"model makes of its commands (servo delay or gains{band})"
            )
    return said


def _of_seats(
    arm: InstrumentedArm, comparison: ModelComparison, suspect: Sequence[Lines]
) -> list[str]:
    """Warnings about seats that no run could open."""
    grid = axes_grid(24)
    never: list[str] = []
    pressed: list[str] = []
    pieces = fitted_pieces(comparison.evidence, comparison.fits[comparison.best])
    for name, seat in seats_of(arm.hypotheses, arm.n).items():
        if not isinstance(seat, Seat):
            continue
        axes = grid if seat.slides else np.ones((1, 1))
        chance = np.zeros(len(axes))
        heavy = np.zeros(len(axes), dtype=bool)
        for piece in pieces:
            if piece.lines.healthy:
                continue
            chance = np.maximum(chance, open_probability(piece.response, seat.columns, axes))
            drive, load = seat_forces(piece.response, seat.columns, axes)
            heavy |= load > PRESSED_FORCE * drive
        if float(chance.mean()) < OPENING_PROBABILITY:
            (pressed if heavy.mean() > 0.5 else never).append(name.split("@", 1)[1])
    said = []
    healthy = comparison.posterior[HEALTHY] > 0.3
    what = "a looseness there would not have been seen" if healthy else "nothing is said about them"
    if never:
        said.append(
            f"no run shook hard enough to open a seat at {', '.join(never)} against friction: "
            f"{what}; shake harder, or excite the joints next to it"
        )
    if pressed:
        said.append(
            f"gravity kept seats at {', '.join(pressed)} shut in every run: {what}; take poses "
            "that lay other directions across gravity, or shake harder"
        )
    return said


def _of_run(arm: InstrumentedArm, one: Lines) -> list[str]:
    said = []
    if one.seconds < SHORT_RUN_S:
        said.append(f"{one.run}: {one.seconds:.2g} s is short; take {SHORT_RUN_S:g} s or more")
    if len(one.frequency) < FEWEST_LINES:
        said.append(
            f"{one.run}: only {len(one.frequency)} lines were excited; a wider band tells more"
        )
    lines = np.maximum(one.read.sum(axis=0), 1)
    signal = np.sum(np.where(one.read, np.abs(one.readings) ** 2, 0.0), axis=0) / lines
    noise = np.sum(np.where(one.read, one.noise, 0.0), axis=0) / lines
    tool = [k for k, (r, _) in enumerate(one.row) if r.kind == "acceleration"]
    if float(signal[tool].sum()) < TOOL_SIGNAL * float(noise[tool].sum()):
        said.append(f"{one.run}: the accelerometer hardly rises above its noise; shake harder")
    for joint in one.excited:
        own = [
            k
            for k, (r, _) in enumerate(one.row)
            if r.kind in ("position", "velocity") and r.at == joint
        ]
        name = arm.joints[joint]
        if not own:
            said.append(f"{one.run}: no sensor of the excited joint {name} was recorded")
        elif max(float(signal[k] / noise[k]) for k in own) < JOINT_SIGNAL:
            said.append(
                f"{one.run}: the sensors of joint {name} are too coarse for its motion; the model "
                "stands for them: shake harder, or at lower frequencies"
            )
    driven = [j for j in one.excited if one.blind[j]]
    if driven:
        names = ", ".join(arm.joints[j] for j in driven)
        said.append(
            f"{one.run}: neither command nor torque of the excited joint {names} is on record; its "
            "motion alone is used"
        )
    return said
