"""Velocity of the slide by quadrature, step by step and summed (6.3.1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.signal import welch

from loose_env.thesis.ch6_experiments.slide.records import SlideRecords
from loose_env.thesis.methods.motion.signals import (
    QUADRATURES,
    integrate,
    line_of_motion,
    quadrature_steps,
)
from loose_env.thesis.shared.section import Table
from loose_env.thesis.shared.signal_panels import centred, rms
from loose_env.typing import Array

__all__ = ["velocity_correlations", "velocity_part"]


_RULES = {"two_point": "6.9", "newton_cotes": "6.10"}


def velocity_correlations(
    x: Array, y: Array, rate: float, window: float
) -> dict[tuple[str, str], float]:
    """Correlation of two axes' velocities, median over windows, by rule and by use of its steps.

    ``x``, ``y`` (N,): accelerations [m/s²]. ``rate``: sampling rate [Hz]. ``window``: length of a
    window [s]. Returns by rule and by ``"step by step"`` or ``"summed"`` from the start of the
    window.
    """
    length = round(window * rate)
    found = {}
    for rule in QUADRATURES:
        for use, method in (("step by step", quadrature_steps), ("summed", integrate)):
            values = []
            for start in range(0, len(x) - length + 1, length):
                part = slice(start, start + length)
                one = method(x[part], 1 / rate, rule)  # type: ignore[arg-type]
                other = method(y[part], 1 / rate, rule)  # type: ignore[arg-type]
                values.append(np.corrcoef(one, other)[0, 1])
            found[rule, use] = float(np.median(values))
    return found


def velocity_part(
    records: SlideRecords, told: Mapping[str, Any], seed: int
) -> tuple[list[str], Table, int]:
    """Correlate the two axes' velocities, as printed; the last value is the record used."""
    case = int(np.argmin(np.abs(np.degrees(records.alpha) - told["velocity_angle_deg"])))
    x, y, rate = records.x[case], records.y[case], records.rate
    window = told["velocity_windows_s"][0]
    clean = velocity_correlations(centred(x), centred(y), rate, window)
    offset = velocity_correlations(x, y, rate, window)
    # Noise on both axes until the accelerations correlate as the printed ones did.
    rng = np.random.default_rng([seed, 30])
    wanted = told["acceleration_correlation_same_signals"]
    level, noisy_x, noisy_y = 0.0, centred(x), centred(y)
    extra = rng.standard_normal((2, len(x)))
    while line_of_motion(noisy_x, noisy_y).correlation > wanted:
        level += 0.02 * rms(centred(x))
        noisy_x, noisy_y = centred(x) + level * extra[0], centred(y) + level * extra[1]
    noisy = velocity_correlations(noisy_x, noisy_y, rate, window)
    opposed, two_point = _opposed_offset(
        centred(x), centred(y), rate, window, told["velocity_correlation_newton_cotes"]
    )
    r = line_of_motion(x, y).correlation
    frequency, power = welch(x, rate, nperseg=2048)
    peak = float(frequency[np.argmax(power)])
    gap = max(
        abs(c["two_point", "summed"] - c["newton_cotes", "summed"]) for c in (clean, noisy, offset)
    )
    cells = (
        (f"accelerations correlate by {r:.4f}, offsets removed", clean),
        (f"noise added until they correlate by {wanted}", noisy),
        ("as recorded, with the tape's offset", offset),
    )
    words = [
        f"Velocities are found at α = {told['velocity_angle_deg']}° over windows of {window} s. "
        f"The motion is dominated by {peak:.0f} Hz, the slide on its stinger (printed: "
        f"{told['dominant_frequency_hz']} Hz). The thesis found the two axes' velocities "
        f"correlated by {told['velocity_correlation_two_point']} with the two-point rule (6.9) and "
        f"by {told['velocity_correlation_newton_cotes']} with Newton-Cotes (6.10), and put that "
        "down to the rule. Its caption of figure 6.21 gives the two-point velocity as one step, "
        "Δt (1.5 g₁ − 0.5 g₂): that is not summed, so it is the acceleration times a constant "
        "and keeps its correlation.",
        f"Summed, the two rules weigh all but the first and last samples alike. Here their "
        f"correlations then differ by {gap:.3f} at most in the three cases of the table. "
        f"With the accelerations at the printed {wanted}, steps of the two-point rule "
        f"correlate by {noisy['two_point', 'step by step']:.2f}, those of Newton-Cotes by "
        f"{noisy['newton_cotes', 'step by step']:.2f} because that rule multiplies white noise by "
        f"{QUADRATURES['newton_cotes'].noise_gain:.1f} against "
        f"{QUADRATURES['two_point'].noise_gain:.1f}; the sums of both drift, and correlate by "
        f"{noisy['two_point', 'summed']:.2f} and {noisy['newton_cotes', 'summed']:.2f}. "
        f"Offsets of {opposed:.2f} m/s² with opposite signs on the two axes, "
        f"{100 * opposed / rms(centred(x)):.0f} % of the signal's rms, are enough to bring the "
        f"sums of Newton-Cotes to {told['velocity_correlation_newton_cotes']}, and those of the "
        f"two-point rule to {two_point:.2f}. "
        + (
            "So a step set beside a sum with drift left in it would give the printed contrast; "
            "the two rules, each used alike, do not."
            if gap < 0.1 and abs(two_point - told["velocity_correlation_newton_cotes"]) < 0.1
            else "So the rules do differ when summed."
        ),
    ]
    rows = [
        (
            f"{_RULES[rule]}, {use}",
            _printed_velocity(rule, use, told),
            *(f"{values[rule, use]:.2f}" for _, values in cells),
        )
        for rule in QUADRATURES
        for use in ("step by step", "summed")
    ]
    return (
        words,
        Table(
            caption=f"Correlation of the two axes' velocities, median over windows of {window} s "
            "(figures 6.20 to 6.24). Which use the printed values belong to is read from the "
            "captions and the drift described.",
            columns=("rule and use", "printed", *(f"here: {name}" for name, _ in cells)),
            rows=tuple(rows),
        ),
        case,
    )


def _opposed_offset(
    x: Array, y: Array, rate: float, window: float, wanted: float
) -> tuple[float, float]:
    """Offset on x, its opposite on y, that brings the sums of Newton-Cotes to a correlation.

    Returns the offset [m/s²] and the correlation that the sums of the two-point rule have then.
    """
    low, high = 0.0, rms(x)
    found: dict[tuple[str, str], float] = {}
    for _ in range(20):
        offset = (low + high) / 2
        found = velocity_correlations(x + offset, y - offset, rate, window)
        if found["newton_cotes", "summed"] > wanted:
            low = offset
        else:
            high = offset
    return (low + high) / 2, found["two_point", "summed"]


def _printed_velocity(rule: str, use: str, told: Mapping[str, Any]) -> str:
    if (rule, use) == ("two_point", "step by step"):
        return str(told["velocity_correlation_two_point"])
    if (rule, use) == ("newton_cotes", "summed"):
        return str(told["velocity_correlation_newton_cotes"])
    return "-"
