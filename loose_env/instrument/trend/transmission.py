"""Transmission spectra from joint to tool, measured and by the most probable hypotheses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.data.spectral_lines import Lines, thinned
from loose_env.instrument.inference.evidence import Evidence
from loose_env.instrument.inference.laplace_fit import Fit, best_powers, fitted_pieces, seats_of
from loose_env.instrument.inference.posterior import ModelComparison
from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm
from loose_env.instrument.inference.seat_motion import Piece, Seat, joint_readings
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.result import HEALTHY, TransmissionSpectrum
from loose_env.instrument.settings.thresholds import MENTIONED
from loose_env.typing import ComplexArray

_NARROW = 32
"""Narrow bands of a spectrum."""
_LINES = 240
"""Lines of a run by which the hypotheses are drawn."""
_FAULTS = 2
"""Most probable faults that are drawn beside the healthy arm."""


def transmission_spectra(
    arm: InstrumentedArm,
    lines: Lines,
    *,
    record: int,
    predicted: Mapping[str, tuple[Lines, ComplexArray]] | None = None,
) -> tuple[TransmissionSpectrum, ...]:
    """Transmission of a run from its excited joint to each axis of the tool's accelerometer."""
    if not len(lines.excited):
        return ()
    joint, drive, unit = _drive(arm, lines)
    power = np.abs(drive) ** 2
    if not power.sum() > 0:
        return ()
    narrow = _narrow_bands(len(lines.frequency))
    tool = [k for k, (r, _) in enumerate(lines.row) if r.kind == "acceleration"]
    own = [k for k in tool if lines.row[k][0].at == 0] or tool
    found = []
    for k in own:
        reading, axis = lines.row[k]
        kept = [np.flatnonzero((narrow == b) & lines.read[:, k]) for b in range(narrow[-1] + 1)]
        kept = [lot for lot in kept if len(lot) and power[lot].sum() > 0]
        if not kept:
            continue
        frequency = [float(lines.frequency[lot].mean()) for lot in kept]
        shown = {
            name: _at(frequency, few, readings[:, k], _drive(arm, few)[1])
            for name, (few, readings) in (predicted or {}).items()
        }
        found.append(
            TransmissionSpectrum(
                record=record,
                joint=arm.joints[joint],
                channel=f"{reading.sensor}.{'xyz'[axis]}",
                unit=f"m/s² per {unit}",
                drive_rms=float(np.sqrt(2 * power.sum()) * lines.period / lines.seconds),
                frequency_hz=tuple(frequency),
                measured=tuple(
                    float(np.sqrt(np.sum(np.abs(lines.readings[lot, k]) ** 2) / power[lot].sum()))
                    for lot in kept
                ),
                predicted=shown,
            )
        )
    return tuple(found)


def spectra_by_fit(
    uncertain: UncertainArm, comparison: ModelComparison, records: Mapping[int, int]
) -> tuple[TransmissionSpectrum, ...]:
    """Transmission of all runs, with that of the most probable hypotheses."""
    arm = uncertain.arm
    few = [thinned(one, _LINES) for one in comparison.lines]
    evidence = Evidence(uncertain=uncertain, lines=few, known_runs=comparison.evidence.runs)
    ranked = sorted(comparison.posterior.items(), key=lambda item: -item[1])
    faults = [n for n, p in ranked if n != HEALTHY and p >= MENTIONED][:_FAULTS]
    seats = seats_of(arm.hypotheses, arm.n)
    by_run: list[dict[str, tuple[Lines, ComplexArray]]] = [{} for _ in few]
    for name in (HEALTHY, *faults):
        for k, readings in enumerate(_predicted(evidence, comparison.fits[name], seats[name])):
            by_run[k][name] = (few[k], readings)
    return tuple(
        spectrum
        for one, predicted in zip(comparison.lines, by_run, strict=True)
        for spectrum in transmission_spectra(
            arm, one, record=records[one.number], predicted=predicted
        )
    )


def _predicted(evidence: Evidence, fit: Fit, seat: Seat | None) -> list[ComplexArray]:
    """Readings of every run by a fitted hypothesis (K, c), the seat's motion at its mean."""
    return [_readings(piece, fit, seat) for piece in fitted_pieces(evidence, fit)]


def _readings(piece: Piece, fit: Fit, seat: Seat | None) -> ComplexArray:
    response = piece.response
    if seat is None or fit.axis is None or piece.lines.healthy:
        return response.expected + _joints(piece, fit, response.residual)
    column = response.columns[:, :, seat.columns] @ fit.axis
    sudden = response.sudden[:, seat.columns] @ fit.axis
    both = np.stack([column, np.broadcast_to(sudden, column.shape)], axis=2)
    weighted = piece.weight @ both
    inside = both.conj().swapaxes(1, 2) @ weighted
    inside[:, [0, 1], [0, 1]] += 1 / best_powers(piece, seat, fit.axis)
    seen = weighted.conj().swapaxes(1, 2) @ response.residual[:, :, None]
    motion = np.linalg.solve(inside, seen)
    moved = np.asarray((both @ motion)[:, :, 0])
    return np.asarray(response.expected + moved + _joints(piece, fit, response.residual - moved))


def _joints(piece: Piece, fit: Fit, residual: ComplexArray) -> ComplexArray:
    """Readings that the joints' motion beside the model most probably makes (K, c)."""
    return joint_readings(piece, fit.variances, piece.weight @ residual[:, :, None])


def _drive(arm: InstrumentedArm, lines: Lines) -> tuple[int, ComplexArray, str]:
    """Most excited joint, its driving force or else its acceleration (K,), and the unit."""
    force = lines.command @ arm.actuators.force.T + lines.force
    powers = [float(np.sum(np.abs(force[:, j]) ** 2)) for j in lines.excited]
    joint = int(lines.excited[int(np.argmax(powers))])
    slides = bool(arm.shown.sliding[joint])
    if max(powers) > 0:
        return joint, np.asarray(force[:, joint]), "N" if slides else "N·m"
    omega = 2 * np.pi * lines.frequency
    for k, (reading, _) in enumerate(lines.row):
        if reading.kind in ("velocity", "position") and reading.at == joint:
            order = omega if reading.kind == "velocity" else omega**2
            unit = "m/s²" if slides else "rad/s²"
            return joint, np.asarray(order * lines.readings[:, k]), unit
    return joint, np.zeros(len(omega), dtype=complex), ""


def _narrow_bands(count: int) -> NDArray[np.intp]:
    """Narrow band of each of the lines (K,), of about as many lines each."""
    bands = min(_NARROW, max(count // 2, 1))
    return np.asarray(np.arange(count) * bands // count, dtype=np.intp)


def _at(
    frequency: list[float], lines: Lines, reading: ComplexArray, drive: ComplexArray
) -> tuple[float, ...]:
    """Amplitude of a predicted reading over the drive at the narrow bands' centres."""
    answer, power = np.abs(reading) ** 2, np.abs(drive) ** 2
    edges = np.concatenate([[-np.inf], 0.5 * (np.array(frequency)[1:] + frequency[:-1]), [np.inf]])
    lot = np.searchsorted(edges, lines.frequency, side="right") - 1
    count = len(frequency)
    above = np.bincount(lot, weights=answer, minlength=count)
    below = np.bincount(lot, weights=power, minlength=count)
    known = np.flatnonzero(below > 0)
    amplitude = np.sqrt(above[known] / below[known])
    return tuple(np.interp(frequency, np.array(frequency)[known], amplitude).tolist())
