"""Velocity of the slide by quadrature, step by step and summed (6.3.1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.signal import welch

from loose_env.thesis.ch6_experiments.slide.records import (
    GEAR_PLAY,
    LINK_BAND,
    RESOLVER_UNIT,
    ResolverRecords,
    SlideRecords,
)
from loose_env.thesis.methods.motion.signals import (
    DIFFERENCES,
    QUADRATURES,
    differentiate,
    integrate,
    line_of_motion,
    quadrature_steps,
)
from loose_env.thesis.shared.plots import centred, rms
from loose_env.thesis.shared.sections import Table
from loose_env.typing import Array

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


def order_table(told: Mapping[str, Any]) -> Table:
    """Order of accuracy measured on a sine, printed beside."""
    rows = []
    for number, name, rules, rule in (
        ("6.9", "two_point_quadrature", QUADRATURES, "two_point"),
        ("6.10", "newton_cotes", QUADRATURES, "newton_cotes"),
        ("6.13", "two_point_difference", DIFFERENCES, "two_point"),
        ("6.14", "three_point_difference", DIFFERENCES, "three_point"),
    ):
        errors = []
        for dt in (0.02, 0.01):
            g = np.sin(1.0 + dt * np.arange(6))
            if rules is QUADRATURES:
                exact = np.cos(1.0 - dt) - np.cos(1.0)
                errors.append(abs(quadrature_steps(g, dt, rule)[0] - exact))  # type: ignore[arg-type]
            else:
                errors.append(abs(differentiate(g, dt, rule)[0] - np.cos(1.0)))  # type: ignore[arg-type]
        order = float(np.log2(errors[0] / errors[1]))
        given = told[f"error_order_{name}"]
        mark = "" if round(order) == given else " (a slip)"
        gain = rules[rule].noise_gain
        unit = "Δt" if rules is QUADRATURES else "/ Δt"
        rows.append((number, f"Δt^{given}{mark}", f"Δt^{order:.1f}", f"{gain:.2f} {unit}"))
    return Table(
        caption="Error of one step of each formula, found by halving the step on a sine, and its "
        "gain for white noise. The printed order of 6.9 is that of Δt g₁; those of 6.13 and 6.14 "
        "stand before the division by Δt.",
        columns=("formula", "printed error", "here", "noise gain"),
        rows=tuple(rows),
    )


def resolver_part(
    turned: ResolverRecords, told: Mapping[str, Any]
) -> tuple[list[str], Table, bool]:
    """Differentiate the resolver's angle and hold it against the link's true velocity.

    The last value says whether that fails: more than half of the velocity is wrong.
    """
    dt = 1 / turned.rate
    read = {
        "exact angle of the link": turned.angle,
        f"{told['resolver_bits']}-bit steps only": RESOLVER_UNIT
        * np.floor(turned.angle / RESOLVER_UNIT),
        "steps and the gear's play": RESOLVER_UNIT * turned.resolver,
    }
    worst, rows = {}, []
    for name, angle in read.items():
        cells = []
        for rule in DIFFERENCES:
            rate = differentiate(angle, dt, rule)  # type: ignore[arg-type]
            truth = turned.velocity[: len(rate)]
            error = rms(rate - truth) / rms(truth)
            # A resolver that does not move follows nothing.
            r = np.corrcoef(rate, truth)[0, 1] if np.ptp(rate) > 0 else 0.0
            twice = differentiate(rate, dt, rule)  # type: ignore[arg-type]
            exact = np.gradient(turned.velocity, dt)[: len(twice)]
            worse = rms(twice - exact) / rms(exact)
            cells.append(f"{100 * error:.0f} %, r = {r:.2f}; {100 * worse:.0f} %")
            worst[name, rule] = error, float(r)
        rows.append((name, *cells))
    units = float(np.ptp(turned.resolver))
    last = list(read)[-1]
    lowest = min(worst[last, rule][0] for rule in DIFFERENCES)
    fails = lowest > 0.5
    words = [
        f"Link 1 of VERA, driven from outside, turns by {np.ptp(turned.angle) / RESOLVER_UNIT:.1f} "
        f"resolver units peak to peak; behind {GEAR_PLAY / RESOLVER_UNIT:.0f} units of play in the "
        f"gear its resolver moves by {units:.0f} (printed: typically less than "
        f"{told['resolver_motion_units']}). One unit from one reading to the next is "
        f"{RESOLVER_UNIT / dt:.3f} rad/s; the link's velocity has {rms(turned.velocity):.3f} "
        f"rad/s rms. The better of the two differences is off by {100 * lowest:.0f} % of that: "
        + (
            "differentiation does not succeed, as the thesis found."
            if fails
            else "differentiation succeeds, unlike in the thesis."
        )
        + " Even from the exact angle the errors are those of the first row: a reading every "
        f"{1000 * dt:.0f} ms is slow for a motion of up to {LINK_BAND[1]:.0f} Hz."
    ]
    table = Table(
        caption="Link velocity by forward differences: rms error over the true rms, correlation; "
        f"then the error of the acceleration by the same formula twice. {turned.rate:.0f} readings "
        "a second.",
        columns=("angle read", "6.13", "6.14"),
        rows=tuple(rows),
    )
    return words, table, fails
