"""Experiments Two and Three: what two accelerometers and a resolver can say (6.3.1, 6.3.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from loose_env.statistics.signals import (
    DIFFERENCES,
    QUADRATURES,
    differentiate,
    instantaneous_motion,
    integrate,
    line_of_motion,
    quadrature_steps,
    rms_motion,
    subtract_base,
)
from loose_env.statistics.spectra import bandpass
from loose_env.thesis.printed import printed
from loose_env.thesis.section import Section, Table
from loose_env.thesis.signal_figures import (
    angle_plate,
    moment_plate,
    resolver_plate,
    velocity_plate,
)
from loose_env.thesis.slide_records import (
    GEAR_PLAY,
    LINK_BAND,
    RESOLVER_UNIT,
    ResolverRecords,
    SlideRecords,
    resolver_records,
    slide_records,
)

__all__ = ["Angles", "angles", "section", "velocity_correlations"]

Array = NDArray[np.float64]

_MODULE = "loose_env.statistics.signals"
_RULES = {"two_point": "6.9", "newton_cotes": "6.10"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Angles:
    """Direction of the slide's motion by each method, one entry an angle of the cube."""

    alpha: Array
    """Angle of the cube as read [deg]."""
    by_rms: Array
    """Direction from rms accelerations (6.8) [deg]."""
    by_line: Array
    """Direction of the regression line [deg]."""
    correlation: Array
    """Correlation r of that line, by size [1]."""
    spread: Array
    """Spread of the instantaneous direction about its middle [deg]."""


def angles(records: SlideRecords, band: tuple[float, float]) -> Angles:
    """Estimate the direction of motion at every angle of the cube.

    The rms is taken within `band` [Hz]; line and instantaneous direction use the whole signal. The
    instantaneous direction is that of samples larger than the rms; its spread is half the
    range that holds 68 % of them.
    """
    x = bandpass(_centred(records.x), records.rate, band)
    y = bandpass(_centred(records.y), records.rate, band)
    by_line, correlation, spread = [], [], []
    for one, other in zip(_centred(records.x), _centred(records.y), strict=True):
        fit = line_of_motion(one, other)
        by_line.append(np.degrees(fit.direction))
        correlation.append(abs(fit.correlation))
        now = instantaneous_motion(one, other)
        large = now.magnitude > np.sqrt(np.mean(now.magnitude**2))
        # Turn the line upright before taking the spread: its direction has no ends there.
        middle = rms_motion(one, other).direction
        turned = (now.direction[large] - middle + np.pi / 2) % np.pi - np.pi / 2
        low, high = np.percentile(turned, [16, 84])
        spread.append(np.degrees(high - low) / 2)
    return Angles(
        alpha=np.degrees(records.alpha),
        by_rms=np.degrees(rms_motion(x, y).direction),
        by_line=np.array(by_line),
        correlation=np.array(correlation),
        spread=np.array(spread),
    )


def velocity_correlations(
    x: Array, y: Array, rate: float, window: float
) -> dict[tuple[str, str], float]:
    """Correlation of two axes' velocities, median over windows, by rule and by use of its steps.

    Parameters
    ----------
    x, y : array (N,)
        Accelerations [m/s²].
    rate : float
        Sampling rate [Hz].
    window : float
        Length of a window [s].

    Returns
    -------
    dict
        By rule and by ``"step by step"`` or ``"summed"`` from the start of the window.
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


def section(seed: int) -> Section:
    """Find directions, velocities and derivatives from simulated records of both experiments."""
    told = printed("signals")
    records, turned = slide_records(seed), resolver_records(seed)
    low, high = told["rms_band_hz"]
    found = angles(records, (low, high))
    words, angle_table = _angle_part(found, told)
    seen = " and ".join(f"{f:.0f} Hz" for f in _bench_peaks(records, told["bench_peaks_hz"]))
    given = " and ".join(f"{f:g} Hz" for f in told["bench_peaks_hz"])
    velocity_words, velocity_table, case = _velocity_part(records, told, seed)
    resolver_words, resolver_table = _resolver_part(turned, told)
    base_words, base_table = _base_part(records, (low, high))
    return Section(
        key="signals",
        title="Experiments Two and Three: two accelerometers and a resolver (6.3.1, 6.3.2)",
        words=(
            "A slide is shaken along its rails; a cube with two perpendicular accelerometers "
            "is turned on it by a known angle α. The records here come from a simulated rig with "
            "the printed slide, stinger mode and bench modes; forces, masses of shaker and "
            "bench, and the noise of the tape are estimates. Across the motion the cube "
            f"shows peaks at {seen}, the bench's own (printed: {given}).",
            *words,
            *velocity_words,
            *resolver_words,
            *base_words,
        ),
        tables=(angle_table, velocity_table, _order_table(told), resolver_table, base_table),
        plates=(
            angle_plate(found),
            moment_plate(records),
            velocity_plate(records, case, told),
            resolver_plate(turned),
        ),
        equations={
            "6.7": f"{_MODULE}.rms_motion",
            "6.8": f"{_MODULE}.rms_motion",
            "6.9": f"{_MODULE}.quadrature_steps",
            "6.10": f"{_MODULE}.quadrature_steps",
            "6.13": f"{_MODULE}.differentiate",
            "6.14": f"{_MODULE}.differentiate",
        },
        left_out=(
            "An independent check of the error sizes: the stinger and bench modes are set to the "
            "printed ones, and force, tape noise, bench damping and gear play were chosen with the "
            "printed errors, bench peaks and resolver motion in view. Their agreement shows that "
            "the account is possible, not that it is the only one.",
            "4.22, 4.23, 4.25 and 4.26 (joint velocity from back EMF, torque from current): the "
            "thesis names them as other ways and measures nothing by them.",
            "The printed signals themselves: they exist as plots only, so correlations are "
            "compared, not waveforms.",
        ),
    )


def _centred(signal: Array) -> Array:
    return np.asarray(signal - signal.mean(axis=-1, keepdims=True))


def _rms(signal: Array) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def _bench_peaks(records: SlideRecords, near: Sequence[float]) -> list[float]:
    """Frequencies of the highest lines near given ones, seen across the motion [Hz]."""
    frequency, power = welch(records.x[-1], records.rate, nperseg=8192)
    found = []
    for one in near:
        inside = np.abs(frequency - one) < 15.0
        found.append(float(frequency[inside][np.argmax(power[inside])]))
    return found


def _angle_part(found: Angles, told: Mapping[str, Any]) -> tuple[list[str], Table]:
    low, high = told["angle_range_deg"]
    within, share = told["angle_within_percent"], told["angle_share_percent"]
    off = np.abs(found.by_rms - found.alpha)
    inside = (found.alpha >= low) & (found.alpha <= high)
    of_angle = 100 * np.mean(off[inside] <= within / 100 * found.alpha[inside])
    of_right = 100 * np.mean(off[inside] <= within / 100 * 90)
    ends = 100 * off[[0, -1]] / 90
    middle = (found.alpha >= 20) & (found.alpha <= 70)
    lowest = found.correlation[middle].min()
    best = found.alpha[np.argmax(found.correlation)]
    line_off = np.abs(found.by_line - found.alpha)[inside]
    words = [
        f"From rms accelerations between {told['rms_band_hz'][0]} and {told['rms_band_hz'][1]} "
        f"Hz, {of_angle:.0f} % of the angles from {low}° to {high}° come out within {within} % "
        f"of the angle, and {of_right:.0f} % within {within} % of a right angle; the thesis "
        f"printed {share} % and does not say of what. With the cube along the motion and across "
        f"it the error is {ends[0]:.1f} % and {ends[1]:.1f} % of a right angle (printed: within "
        f"{told['perpendicular_within_percent'][0]} % and "
        f"{told['perpendicular_within_percent'][1]} %). "
        + (
            "Near the axes the direction is drawn towards 45°: an rms cannot tell the bench's own "
            "motion and the tape's noise from the slide's. "
            if found.by_rms[0] > found.alpha[0] and found.by_rms[-1] < found.alpha[-1]
            else ""
        )
        + "An idle axis with 5 % of the motion by itself is read as 2.9°, yet it adds only 0.4° at "
        "10°.",
        f"The regression of one signal on the other is off by {np.median(line_off):.2f}° in the "
        f"median against {np.median(off[inside]):.2f}° by rms. Its correlation is highest at "
        f"{best:.0f}° and at least {lowest:.3f} from 20° to 70° (printed: above "
        f"{told['regression_correlation_above']} near 45°). The spread of the instantaneous "
        f"direction is {found.spread[inside].min():.1f}° to {found.spread[inside].max():.1f}° "
        f"over {low}° to {high}°, {_at(found, 45):.1f}° at 45°: "
        + (
            "it hardly depends on the angle, since noise of equal size on both axes turns a vector "
            "by the same amount wherever it points; what improves near 45° is the correlation."
            if found.spread[inside].max() < 1.5 * found.spread[inside].min()
            else "it depends on the angle."
        ),
    ]
    rows = tuple(
        (
            f"{a:.0f}°",
            f"{r:.1f}°",
            f"{line:.1f}°",
            f"{c:.3f}",
            f"{s:.1f}°",
        )
        for a, r, line, c, s in zip(
            found.alpha[::2],
            found.by_rms[::2],
            found.by_line[::2],
            found.correlation[::2],
            found.spread[::2],
            strict=True,
        )
    )
    return words, Table(
        caption="Direction of the slide's motion from two perpendicular accelerometers (figures "
        "6.18 and 6.19).",
        columns=("α", "by rms (6.8)", "by regression", "|r|", "spread, each instant"),
        rows=rows,
    )


def _at(found: Angles, degrees: float) -> float:
    return float(found.spread[np.argmin(np.abs(found.alpha - degrees))])


def _velocity_part(
    records: SlideRecords, told: Mapping[str, Any], seed: int
) -> tuple[list[str], Table, int]:
    case = int(np.argmin(np.abs(np.degrees(records.alpha) - told["velocity_angle_deg"])))
    x, y, rate = records.x[case], records.y[case], records.rate
    window = told["velocity_windows_s"][0]
    clean = velocity_correlations(_centred(x), _centred(y), rate, window)
    offset = velocity_correlations(x, y, rate, window)
    # Noise on both axes until the accelerations correlate as the printed ones did.
    rng = np.random.default_rng([seed, 30])
    wanted = told["acceleration_correlation_same_signals"]
    level, noisy_x, noisy_y = 0.0, _centred(x), _centred(y)
    extra = rng.standard_normal((2, len(x)))
    while line_of_motion(noisy_x, noisy_y).correlation > wanted:
        level += 0.02 * _rms(_centred(x))
        noisy_x, noisy_y = _centred(x) + level * extra[0], _centred(y) + level * extra[1]
    noisy = velocity_correlations(noisy_x, noisy_y, rate, window)
    opposed, two_point = _opposed_offset(
        _centred(x), _centred(y), rate, window, told["velocity_correlation_newton_cotes"]
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
        f"{100 * opposed / _rms(_centred(x)):.0f} % of the signal's rms, are enough to bring the "
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
    low, high = 0.0, _rms(x)
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


def _order_table(told: Mapping[str, Any]) -> Table:
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


def _resolver_part(turned: ResolverRecords, told: Mapping[str, Any]) -> tuple[list[str], Table]:
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
            error, r = _rms(rate - truth) / _rms(truth), np.corrcoef(rate, truth)[0, 1]
            twice = differentiate(rate, dt, rule)  # type: ignore[arg-type]
            exact = np.gradient(turned.velocity, dt)[: len(twice)]
            worse = _rms(twice - exact) / _rms(exact)
            cells.append(f"{100 * error:.0f} %, r = {r:.2f}; {100 * worse:.0f} %")
            worst[name, rule] = error, float(r)
        rows.append((name, *cells))
    units = float(np.ptp(turned.resolver))
    last = list(read)[-1]
    lowest = min(worst[last, rule][0] for rule in DIFFERENCES)
    words = [
        f"Link 1 of VERA, driven from outside, turns by {np.ptp(turned.angle) / RESOLVER_UNIT:.1f} "
        f"resolver units peak to peak; behind {GEAR_PLAY / RESOLVER_UNIT:.0f} units of play in the "
        f"gear its resolver moves by {units:.0f} (printed: typically less than "
        f"{told['resolver_motion_units']}). One unit from one reading to the next is "
        f"{RESOLVER_UNIT / dt:.3f} rad/s; the link's velocity has {_rms(turned.velocity):.3f} "
        f"rad/s rms. The better of the two differences is off by {100 * lowest:.0f} % of that: "
        + (
            "differentiation does not succeed, as the thesis found."
            if lowest > 0.5
            else "differentiation succeeds, unlike in the thesis."
        )
        + " Even from the exact angle the errors are those of the first row: a reading every "
        f"{1000 * dt:.0f} ms is slow for a motion of up to {LINK_BAND[1]:.0f} Hz."
    ]
    return words, Table(
        caption="Link velocity by forward differences: rms error over the true rms, correlation; "
        f"then the error of the acceleration by the same formula twice. {turned.rate:.0f} readings "
        "a second.",
        columns=("angle read", "6.13", "6.14"),
        rows=tuple(rows),
    )


def _base_part(records: SlideRecords, band: tuple[float, float]) -> tuple[list[str], Table]:
    rows, left, gains = [], {}, {}
    for name, run in records.shaken_by.items():
        slide, base, truth = (
            bandpass(s - s.mean(), records.rate, band) for s in (run.slide, run.base, run.relative)
        )
        fitted = subtract_base(slide, base, fit=True)
        kinds = (slide, subtract_base(slide, base).signal, fitted.signal)
        left[name] = [100 * _rms(kind - truth) / _rms(truth) for kind in kinds]
        gains[name] = float(fitted.gain)
        rows.append(
            (
                name,
                f"{np.corrcoef(base, truth)[0, 1]:+.2f}",
                *(f"{value:.0f} %" for value in left[name]),
                f"{gains[name]:+.2f}",
            )
        )
    plain_wins = all(kinds[1] < min(kinds[0], kinds[2]) for kinds in left.values())
    words = [
        "The bench moves as well, and its motion can be subtracted (4.1.4). "
        + (
            "Plain subtraction is best in every case here. "
            if plain_wins
            else "Plain subtraction is not the best in every case here. "
        )
        + "A gain fitted by least squares should mend sensors of unequal gain, but the fitted "
        f"gains are {' and '.join(f'{g:+.1f}' for g in gains.values())} where about +1 is right: "
        "the motion that is wanted is itself correlated with the bench's, which the shaker pushes "
        "off from and over which the slide hangs almost free, and the fit takes that away too."
    ]
    return words, Table(
        caption="Motion of the slide relative to the bench: error left, over its true rms, between "
        f"{band[0]:.0f} and {band[1]:.0f} Hz.",
        columns=(
            "what shakes the bench",
            "correlation of bench and slide",
            "nothing subtracted",
            "bench subtracted",
            "with a fitted gain",
            "fitted gain",
        ),
        rows=tuple(rows),
    )
