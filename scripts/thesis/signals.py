"""Experiments Two and Three, simulated: direction of motion and velocity from sensor signals.

A slide is shaken through a stinger, and link 1 of VERA carries a resolver behind a gear with play.
The rigs' sensors are ideal; accelerometers, protractor and tape are put on their readings, so that
several pairs can be tried on one and the same motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import welch

from loose_env.arms import Arm, Mismatch
from loose_env.envs import INK, MEASURED, SHAKEN, TRUTH
from loose_env.errors import InvalidData
from loose_env.excitation import Excitation
from loose_env.rig import Measurement, SimulatedRig
from loose_env.sensors import Accelerometer, Encoder, SensorSuite
from loose_env.statistics import bandpass
from loose_env.typing import Array
from scripts.charts import Panel, chart, curve, drawing
from scripts.thesis.page import Rows, Section, printed, section
from scripts.thesis.plots import centred, rms
from scripts.thesis.rigs import shaken_vera, slide_rig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAIRS = 12
"""Pairs of accelerometers that are drawn."""
FORCE_RMS, FORCE_BAND = 6.0, (5.0, 2000.0)
"""Force of the shaker [N] and its band [Hz]; estimates. The suspension of its coil takes the
part below 40 Hz away."""
FULL_SCALE = 50.0
"""Full scale of a tape channel [m/s²]; an estimate."""
TAPE_RATIO_DB = 46.0
"""Full scale over noise of an FM tape channel [dB]; an estimate."""
TAPE_OFFSET = 0.005
"""Deviation of a channel's offset over its full scale [1]; an estimate."""
PAIR = replace(Mismatch().scaled(0.0), gain=0.005, cross_axis=0.01)
"""Deviations of gain and cross-axis sensitivity of the accelerometers; estimates."""
PROTRACTOR = np.radians(0.15)
"""Deviation of the angle read [rad]; an estimate."""
RATE, DURATION = 10_000.0, 2.0
RESOLVER_UNIT = 2 * np.pi / 2**16
"""One unit of a resolver of 16 bits [rad]."""
RESOLVER_RATE = 1000.0
"""Readings of the resolver through the computer's digital port [Hz]; an estimate."""
GEAR_PLAY = 3 * RESOLVER_UNIT
"""Play between link and resolver [rad]: one arc-minute; an estimate."""
LINK_BAND = (20.0, 150.0)
"""Band of the shaker that drives link 1 [Hz]: readings at `RESOLVER_RATE` can follow it, so that
what spoils its derivative is the resolver and its gear. An estimate."""
LINK_FORCE_RMS = 48.0
"""Its force [N], for a resolver that moves by the few units printed (6.3.2)."""
VERA_POSE = (0.0, np.pi / 2)
"""Joints of VERA [rad]; the second is pinned."""

# Rules for one interval of samples have a bounded error each; what happens when their results are
# summed, or divided by the step, follows from each rule's gain for white noise.

QUADRATURES: dict[str, tuple[float, ...]] = {
    "two_point": (3 / 2, -1 / 2),
    "newton_cotes": (55 / 24, -59 / 24, 37 / 24, -9 / 24),
}
"""Weights of open quadratures over the interval that ends at the first sample used (6.9, 6.10)."""
DIFFERENCES: dict[str, tuple[float, ...]] = {
    "two_point": (-1.0, 1.0),
    "three_point": (-3 / 2, 2.0, -1 / 2),
}
"""Weights of forward differences, the earliest sample first (6.13, 6.14)."""


def noise_gain(weights: tuple[float, ...]) -> float:
    """Deviation of a rule's result over that of white noise, in steps or inverse steps [1]."""
    return float(np.sqrt(np.sum(np.square(weights))))


def quadrature_steps(g: ArrayLike, dt: float, rule: str) -> Array:
    """Integrate over each interval by an open quadrature of the samples that follow it.

    With g_1 at the end of the interval: dt/2 (3 g_1 - g_2) (6.9), or the Newton-Cotes formula
    dt/24 (55 g_1 - 59 g_2 + 37 g_3 - 9 g_4) (6.10). Errors of one interval fall as dt^3 and dt^5.
    (The thesis gives dt^2 for 6.9, which is the error of dt g_1.)
    """
    return _filter(g, QUADRATURES[rule]) * dt


def integrate(g: ArrayLike, dt: float, rule: str) -> Array:
    """Sum the steps of a quadrature from zero: velocity from acceleration.

    The rules differ by the end terms only, and each gathers the same drift from noise and offset.
    """
    return np.asarray(np.cumsum(quadrature_steps(g, dt, rule), axis=-1))


def differentiate(g: ArrayLike, dt: float, rule: str) -> Array:
    """Differentiate by (g_1 - g_0) / dt (6.13), or (-g_2 + 4 g_1 - 3 g_0) / (2 dt) (6.14).

    Errors fall as dt and dt^2. (The thesis gives dt^2 and dt^3, those before the division by dt.)
    """
    return _filter(g, DIFFERENCES[rule]) / dt


def _filter(g: ArrayLike, weights: tuple[float, ...]) -> Array:
    samples = np.asarray(g, dtype=float)
    count = samples.shape[-1] - len(weights) + 1
    return np.asarray(sum(w * samples[..., k : k + count] for k, w in enumerate(weights)))


def rms_motion(x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Size and direction [rad from x] of a motion, by the rms of two perpendicular accelerations.

    Magnitude sqrt(x_rms^2 + y_rms^2) (6.7), direction arctan(y_rms / x_rms) (6.8), means removed.
    An rms has no sign, so the direction lies between 0 and pi/2, and what either channel adds by
    itself pulls it off the axes.
    """
    first, second = np.asarray(x, dtype=float).std(axis=-1), np.asarray(y, dtype=float).std(axis=-1)
    return np.hypot(first, second), np.arctan2(second, first)


def instantaneous_motion(x: Array, y: Array) -> tuple[Array, Array]:
    """Find size and direction at every sample, -pi/2 to pi/2 (6.7 and 6.8 without the means)."""
    flip = np.where((x < 0.0) | ((x == 0.0) & (y < 0.0)), -1.0, 1.0)
    return np.hypot(x, y), np.arctan2(flip * y, flip * x)


def line_of_motion(x: Array, y: Array) -> tuple[float, float]:
    """Correlation and angle [rad from the x axis] of a line fitted by least squares in y alone."""
    dx, dy = x - x.mean(), y - y.mean()
    correlation = float(np.clip(dx @ dy / np.sqrt(float(dx @ dx) * float(dy @ dy)), -1.0, 1.0))
    return correlation, float(np.arctan(float(dx @ dy) / float(dx @ dx)))


class SlideRecords(NamedTuple):
    """One record for each angle of the cube."""

    alpha: Array
    """Angle of the cube as read from the protractor [rad] (A,)."""
    x: Array
    """Accelerometer at alpha from the rails, as measured [m/s²] (A, N)."""
    y: Array
    """Accelerometer perpendicular to it [m/s²] (A, N)."""


Turned = tuple[Array, Array, Array]
"""Link 1 driven from outside, at `RESOLVER_RATE`: true angle [rad] and velocity [rad/s], and the
reading behind the gear [units of `RESOLVER_UNIT`] (N,)."""


def slide_records(seed: int, *, pair: int = 0) -> SlideRecords:
    """Shake the slide with the cube at 0 to 90 degrees."""
    alpha, runs = _motions(seed)
    rng = np.random.default_rng([seed, 91, pair])
    noise = FULL_SCALE * 10 ** (-TAPE_RATIO_DB / 20)
    sensor = PAIR.draw(slide_rig(), rng).sensor
    # The protractor's error turns the cube, and with it both accelerometers.
    turned = PROTRACTOR * rng.standard_normal(len(alpha))
    c, s = np.cos(turned)[:, None], np.sin(turned)[:, None]
    along, across = np.stack([run.tool for run in runs], axis=1)
    cube = np.array([c * along - s * across, s * along + c * across])
    measured = np.einsum("ij,jkn->ikn", sensor[:2, :2], cube)
    measured += noise * rng.standard_normal(measured.shape)
    measured += TAPE_OFFSET * FULL_SCALE * rng.standard_normal((2, len(alpha), 1))
    return SlideRecords(alpha, measured[0], measured[1])


def resolver_records(seed: int) -> Turned:
    """Drive link 1 of VERA by the shaker and read its resolver behind a gear with play."""
    shake = Excitation(
        torque_rms=(0.0, 0.0), duration=DURATION, band=LINK_BAND, shaker_rms=LINK_FORCE_RMS
    )
    run = _measure(shaken_vera(), np.array(VERA_POSE), shake, [seed, 95])
    every = round(RATE / RESOLVER_RATE)
    angle = run.encoder[0, 1:-1]
    rotor = play(angle, GEAR_PLAY)
    return angle[::every], _velocity(run)[::every], np.floor(rotor[::every] / RESOLVER_UNIT)


def play(driving: Array, width: float) -> Array:
    """Follow a motion through play: the driven side stays until it is pushed."""
    driven = np.array(driving, dtype=float)
    for k in range(1, len(driven)):
        driven[k] = min(max(driven[k - 1], driving[k] - width / 2), driving[k] + width / 2)
    return driven


@lru_cache(maxsize=1)
def _motions(seed: int) -> tuple[Array, tuple[Measurement, ...]]:
    """Angles of the cube, and the motion at each."""
    alpha = np.radians(np.arange(0.0, 91.0, 5.0))
    shake = Excitation(torque_rms=(0.0,), duration=DURATION, band=FORCE_BAND, shaker_rms=FORCE_RMS)
    # The cube's accelerometers turn against its angle: x lies at -alpha in the bench's frame.
    rigs = [slide_rig(cube_angle=-angle, stinger="threaded_rod") for angle in alpha]
    return alpha, tuple(
        _measure(r, np.zeros(1), shake, [seed, 100 + k]) for k, r in enumerate(rigs)
    )


def _measure(arm: Arm, pose: Array, shake: Excitation, key: list[int]) -> Measurement:
    """Measure a healthy arm by sensors that add nothing but their rate and band."""
    sensors = SensorSuite(
        rate=RATE,
        accelerometer=Accelerometer(noise_density=0.0, bandwidth=0.45 * RATE, resolution=0.0),
        encoder=Encoder(resolution=0.0, noise=0.0, linear_resolution=0.0, linear_noise=0.0),
    )
    rig = SimulatedRig(arm, sensors=sensors, threads=1)
    run = rig.measure(pose, shake, rng=np.random.default_rng(key))
    if run.failure is not None:
        raise InvalidData(f"the record of {arm.name!r} is worthless: {run.failure}")
    return run


def _velocity(run: Measurement) -> Array:
    """Velocity of the shaken joint, by central differences of its exact position (N,)."""
    position = run.encoder[0]
    return np.asarray((position[2:] - position[:-2]) * (run.rate / 2))


def by_rms(records: SlideRecords, band: tuple[float, float]) -> Array:
    """Direction from rms accelerations within a band [Hz] at every angle of the cube [deg]."""
    return np.degrees(rms_motion(*(bandpass(centred(s), RATE, band) for s in records[1:3]))[1])


def by_line_and_instant(records: SlideRecords) -> Array:
    """Direction of the regression line [deg], its |r|, and spread of each instant's [deg] (3, A).

    The instantaneous direction is that of samples larger than the rms; its spread is half the
    range that holds 68 % of them.
    """
    rows = []
    for one, other in zip(centred(records.x), centred(records.y), strict=True):
        (correlation, line), (size, now) = (
            line_of_motion(one, other),
            instantaneous_motion(one, other),
        )
        large = size > rms(size)
        # Turn the line upright before taking the spread: its direction has no ends there.
        middle = rms_motion(one, other)[1]
        turned = (now[large] - middle + np.pi / 2) % np.pi - np.pi / 2
        low, high = np.percentile(turned, [16, 84])
        rows.append((np.degrees(line), abs(correlation), np.degrees(high - low) / 2))
    return np.array(rows).T


Correlations = dict[tuple[str, str], float]


def velocity_correlations(x: Array, y: Array, window: float) -> Correlations:
    """Correlation of two axes' velocities, median over windows [s], by rule and use of steps."""
    length, found = round(window * RATE), {}
    uses: dict[str, Callable[..., Array]] = {"step by step": quadrature_steps, "summed": integrate}
    for rule in QUADRATURES:
        for use, method in uses.items():
            values = []
            for start in range(0, len(x) - length + 1, length):
                part = slice(start, start + length)
                one, other = (method(signal[part], 1 / RATE, rule) for signal in (x, y))
                values.append(np.corrcoef(one, other)[0, 1])
            found[rule, use] = float(np.median(values))
    return found


def order_rows(told: Mapping[str, Any]) -> Rows:
    """Order of accuracy measured on a sine, printed beside."""
    rows = []
    for number, name, rules, rule, unit in (
        ("6.9", "two_point_quadrature", QUADRATURES, "two_point", "Δt"),
        ("6.10", "newton_cotes", QUADRATURES, "newton_cotes", "Δt"),
        ("6.13", "two_point_difference", DIFFERENCES, "two_point", "/ Δt"),
        ("6.14", "three_point_difference", DIFFERENCES, "three_point", "/ Δt"),
    ):
        errors = []
        for dt in (0.02, 0.01):
            g = np.sin(1.0 + dt * np.arange(6))
            if rules is QUADRATURES:
                exact = np.cos(1.0 - dt) - np.cos(1.0)
                errors.append(abs(quadrature_steps(g, dt, rule)[0] - exact))
            else:
                errors.append(abs(differentiate(g, dt, rule)[0] - np.cos(1.0)))
        order, given = float(np.log2(errors[0] / errors[1])), told[f"error_order_{name}"]
        mark = "" if round(order) == given else " (a slip)"
        gain = f"{noise_gain(rules[rule]):.2f} {unit}"
        rows.append((number, f"Δt^{given}{mark}", f"Δt^{order:.1f}", gain))
    return rows


def resolver_rows(turned: Turned, bits: int) -> tuple[Rows, float]:
    """Differentiate the resolver's angle and hold it against the link's true velocity.

    Returns the rows, and the error of the better difference of the resolver over the true rms.
    """
    dt, rows, lowest = 1 / RESOLVER_RATE, [], np.inf
    exact_angle, velocity, resolver = turned
    read = {
        "exact angle of the link": exact_angle,
        f"{bits}-bit steps only": RESOLVER_UNIT * np.floor(exact_angle / RESOLVER_UNIT),
        "steps and the gear's play": RESOLVER_UNIT * resolver,
    }
    for name, angle in read.items():
        cells, errors = [name], []
        for rule in DIFFERENCES:
            rate = differentiate(angle, dt, rule)
            truth = velocity[: len(rate)]
            errors.append(rms(rate - truth) / rms(truth))
            # A resolver that does not move follows nothing.
            r = np.corrcoef(rate, truth)[0, 1] if np.ptp(rate) > 0 else 0.0
            twice = differentiate(rate, dt, rule)
            exact = np.gradient(velocity, dt)[: len(twice)]
            worse = 100 * rms(twice - exact) / rms(exact)
            cells.append(f"{100 * errors[-1]:.0f} %, r = {r:.2f}; {worse:.0f} %")
        rows.append(cells)
        lowest = min(errors)  # the resolver comes last
    return rows, lowest


def signals(seed: int) -> Section:
    """Find directions, velocities and derivatives from simulated records of both experiments."""
    told = printed("signals")
    records, turned = slide_records(seed), resolver_records(seed)
    band, limits, within = (2.0, 200.0), told["angle_range_deg"], told["angle_within_percent"]
    frequency, power = welch(records.x[-1], RATE, nperseg=8192)
    peaks = []
    for one in told["bench_peaks_hz"]:
        near = np.abs(frequency - one) < 15.0
        peaks.append(float(frequency[near][np.argmax(power[near])]))

    alpha, found = np.degrees(records.alpha), by_rms(records, band)
    line, correlation, spread = by_line_and_instant(records)
    off = np.abs(found - alpha)
    inside = (alpha >= limits[0]) & (alpha <= limits[1])
    shares = []
    for pair in range(PAIRS):
        own = np.abs(by_rms(slide_records(seed, pair=pair), band) - alpha)
        shares.append(np.mean((own <= within / 100 * alpha)[inside]))
    of_angle = shares[0]
    of_right = np.mean(off[inside] <= within / 100 * 90)
    ends, error = 100 * off[[0, -1]] / 90, np.median(off[inside])
    lowest = correlation[(alpha >= 20) & (alpha <= 70)].min()
    best = alpha[np.argmax(correlation)]
    line_off = np.median(np.abs(line - alpha)[inside])
    spreads = spread[inside].min(), spread[inside].max()
    at_45 = spread[np.argmin(np.abs(alpha - 45))]
    least, most, middle = min(shares), max(shares), np.median(shares)
    angle_rows = list(zip(alpha, found, line, correlation, spread, strict=True))[::2]

    case = int(np.argmin(np.abs(np.degrees(records.alpha) - told["velocity_angle_deg"])))
    x, y, window = records.x[case], records.y[case], told["velocity_windows_s"][0]
    # Noise on both axes until the accelerations correlate as the printed ones did.
    extra = np.random.default_rng([seed, 30]).standard_normal((2, len(x)))
    wanted = told["acceleration_correlation_same_signals"]
    level, noisy = 0.0, centred(np.array([x, y]))
    while line_of_motion(*noisy)[0] > wanted:
        level += 0.02 * rms(centred(x))
        noisy = centred(np.array([x, y])) + level * extra
    as_is = line_of_motion(x, y)[0]
    plain = np.array([x, y])
    variants = {
        f"here: accelerations correlate by {as_is:.4f}, offsets removed": centred(plain),
        f"here: noise added until they correlate by {wanted}": noisy,
        "here: as recorded, with the tape's offset": plain,
    }
    correlated = [velocity_correlations(pair[0], pair[1], window) for pair in variants.values()]
    gap = max(abs(c["two_point", "summed"] - c["newton_cotes", "summed"]) for c in correlated)
    steps, step_sum, cotes, cotes_sum = correlated[1].values()
    newton = told["velocity_correlation_newton_cotes"]
    gains = [noise_gain(weights) for weights in QUADRATURES.values()]
    frequency, power = welch(x, RATE, nperseg=2048)
    peak = float(frequency[np.argmax(power)])
    said = {
        ("two_point", "step by step"): told["velocity_correlation_two_point"],
        ("newton_cotes", "summed"): newton,
    }
    velocity_rows = [
        ("rule and use", "printed", *variants),
        *(
            (
                f"{'6.9' if rule == 'two_point' else '6.10'}, {use}",
                str(said.get((rule, use), "-")),
                *(f"{values[rule, use]:.2f}" for values in correlated),
            )
            for rule, use in correlated[0]
        ),
    ]

    turn_rows, fails = resolver_rows(turned, told["resolver_bits"])
    turns, units = np.ptp(turned[0]) / RESOLVER_UNIT, np.ptp(turned[2])
    play_units, unit_rate = GEAR_PLAY / RESOLVER_UNIT, RESOLVER_UNIT * RESOLVER_RATE
    true_rms, every_ms = rms(turned[1]), 1000 / RESOLVER_RATE
    return section(
        "signals",
        locals(),
        [angle_rows, velocity_rows, order_rows(told), turn_rows],
        [
            angle_figure(alpha, found - alpha, line - alpha, correlation),
            moment_figure(records),
            velocity_figure(records, case, told),
            resolver_figure(*turned),
        ],
    )


def angle_figure(alpha: Array, off: Array, line: Array, correlation: Array) -> Figure:
    """Draw the error of the direction and the correlation against the angle of the cube."""
    inside = slice(1, -1)  # at the ends the regression has nothing to go by
    ticks = {"xticks": range(0, 91, 15)}
    by_line = curve(alpha[inside], line[inside], "regression", color=SHAKEN, marker="s", ms=3)
    panels = [
        Panel(
            title="error of the direction found [°]",
            curves=[curve(alpha, off, "rms", color=MEASURED, marker="o", ms=3.5), by_line],
            look=ticks,
        ),
        Panel(
            title="correlation |r| of one axis with the other",
            curves=[curve(alpha, correlation, color=INK, marker="o", ms=3.5)],
            look=ticks | {"ylim": (0, 1.08)},
        ),
    ]
    return chart(panels, across="angle α of the cube [°]", height=1.6)


def moment_figure(records: SlideRecords) -> Figure:
    """Draw the direction at every instant for three angles of the cube."""
    count, panels = round(0.02 * RATE), []
    time = 1000 * np.arange(count) / RATE
    for k in (int(np.argmin(np.abs(np.degrees(records.alpha) - a))) for a in (10, 45, 80)):
        magnitude, now = instantaneous_motion(*(centred(s[k])[:count] for s in records[1:3]))
        # Within half a turn about the cube's angle.
        true = records.alpha[k]
        direction = np.degrees((now - true + np.pi / 2) % np.pi - np.pi / 2 + true)
        size = 2 + 40 * (magnitude / magnitude.max()) ** 2
        look: dict[str, Any] = {"color": MEASURED, "alpha": 0.6, "linewidth": 0}
        panels.append(
            Panel(
                title=f"direction [°], α = {np.degrees(true):.0f}°",
                curves=[
                    curve(time, np.full(count, np.degrees(true)), color=TRUTH),
                    drawing("scatter", time, direction, s=size, **look),
                ],
                look={"ylim": (np.degrees(true) - 30, np.degrees(true) + 30)},
            )
        )
    return chart(panels, across="time [ms]")


def velocity_figure(records: SlideRecords, case: int, told: Mapping[str, Any]) -> Figure:
    """Draw velocities by quadrature, step by step and summed, of one record."""
    short, long = told["velocity_windows_s"]
    axes = (("x of the cube", records.x[case], MEASURED), ("y", records.y[case], SHAKEN))
    plans: dict[str, tuple[Any, str, float]] = {
        f"two-point rule step by step, {short} s": (quadrature_steps, "two_point", short),
        f"two-point rule summed, {long} s": (integrate, "two_point", long),
        f"Newton-Cotes summed, {long} s": (integrate, "newton_cotes", long),
    }
    panels = []
    for title, (method, rule, window) in plans.items():
        curves = []
        for name, signal, colour in axes:
            v = 1000 * method(signal[: round(window * RATE)], 1 / RATE, rule)
            curves.append(curve(1000 * np.arange(len(v)) / RATE, v, name, color=colour))
        panels.append(Panel(title=title, up="mm/s", curves=curves))
    return chart(panels, across="time [ms]")


def resolver_figure(angle: Array, velocity: Array, resolver: Array) -> Figure:
    """Draw angle and velocity by the resolver beside those of the link."""
    count = round(0.12 * RESOLVER_RATE)
    time = 1000 * np.arange(count) / RESOLVER_RATE
    rate = differentiate(RESOLVER_UNIT * resolver, 1 / RESOLVER_RATE, "two_point")
    units = [
        values[:count] - np.median(values[:count]) for values in (angle / RESOLVER_UNIT, resolver)
    ]
    both = {"angle [resolver units]": units, "velocity [rad/s]": [velocity[:count], rate[:count]]}
    panels = [
        Panel(
            title=title,
            curves=[
                curve(
                    time, read, "resolver behind the gear", color=MEASURED, drawstyle="steps-post"
                ),
                curve(time, true, "link", color=TRUTH),
            ],
        )
        for title, (true, read) in both.items()
    ]
    return chart(panels, across="time [ms]", height=1.6)
