"""From two accelerations to a motion: direction, velocity, and what the base adds.

Rules for one interval of samples have a bounded error each; what happens when their results are
summed, or divided by the step, follows from each rule's `noise_gain`.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import welch
from scipy.stats import gmean

from loose_env.errors import InvalidData
from loose_env.statistics import correlation_loop
from loose_env.typing import Array

DifferenceRule = Literal["two_point", "three_point"]
QuadratureRule = Literal["two_point", "newton_cotes"]


@dataclass(frozen=True, kw_only=True)
class Rule:
    """A sum of neighbouring samples that stands for an integral or a derivative."""

    weights: tuple[float, ...]
    """Weights of consecutive samples, the earliest first [1]."""
    order: int
    """Power of the step with which the error falls."""

    @property
    def noise_gain(self) -> float:
        """Standard deviation of the result over that of white noise in the samples [1].

        In units of the step for an integral, of its inverse for a derivative.
        """
        return float(np.sqrt(np.sum(np.square(self.weights))))


QUADRATURES: dict[str, Rule] = {
    # The integral lies over the interval that ends at the first sample used.
    "two_point": Rule(weights=(3 / 2, -1 / 2), order=3),
    "newton_cotes": Rule(weights=(55 / 24, -59 / 24, 37 / 24, -9 / 24), order=5),
}
"""Open quadratures over one interval (6.9, 6.10)."""
DIFFERENCES: dict[str, Rule] = {
    "two_point": Rule(weights=(-1.0, 1.0), order=1),
    "three_point": Rule(weights=(-3 / 2, 2.0, -1 / 2), order=2),
}
"""Forward differences (6.13, 6.14)."""


class PlaneMotion(NamedTuple):
    """Size and direction of a motion measured by two perpendicular accelerometers."""

    magnitude: Array
    """Same unit as the accelerations."""
    direction: Array
    """Angle from the first accelerometer's axis, rad."""


class LineFit(NamedTuple):
    """Straight line y = slope x + intercept through pairs of samples."""

    slope: float
    intercept: float
    correlation: float
    """Correlation r of the pairs, -1 to 1."""
    direction: float
    """Angle of the line from the x axis, rad, from -pi/2 to pi/2."""


class BaseRemoved(NamedTuple):
    """A signal without the motion of the base."""

    signal: Array
    """Shape (N,) or (d, N), as the signal given."""
    gain: Array
    """Share of the base motion taken off: 1 unless fitted; shape () or (d,)."""


def rms_motion(x: ArrayLike, y: ArrayLike) -> PlaneMotion:
    """Find size and direction of a motion from the rms of two perpendicular accelerations.

    Magnitude sqrt(x_rms^2 + y_rms^2) (6.7), direction arctan(y_rms / x_rms) (6.8), in which means
    are removed first. An rms has no sign, so the direction lies between 0 and pi/2, and what
    either channel adds by itself pulls it off the axes: noise of rms n on the y channel of a
    motion A along x gives arctan(n / A).

    ``x``, ``y`` (..., N): accelerations along two perpendicular axes, m/s^2. Returns magnitude,
    m/s^2, and direction, rad; both of shape (...).

    Examples
    --------
    >>> wave = np.sin(np.arange(1000))
    >>> found = rms_motion(3 * wave, -4 * wave)
    >>> round(float(np.degrees(found.direction)), 2)
    53.13
    """
    first, second = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    rms = first.std(axis=-1), second.std(axis=-1)
    magnitude = np.hypot(*rms)
    if not (magnitude > 0.0).all():
        raise InvalidData("neither x nor y varies, so the motion has no direction")
    return PlaneMotion(np.asarray(magnitude), np.asarray(np.arctan2(rms[1], rms[0])))


def instantaneous_motion(x: ArrayLike, y: ArrayLike) -> PlaneMotion:
    """Find size and direction of the motion at every sample (6.7 and 6.8 without the means).

    A motion to and fro along a line has one direction, so it is given from -pi/2 to pi/2. Where
    both accelerations pass through zero it is that of the noise: leave out samples of small
    magnitude.

    ``x``, ``y`` (..., N): accelerations along two perpendicular axes, m/s^2, sampled at the same
    instants. Returns magnitude, m/s^2, and direction, rad; both of shape (..., N). The direction of
    a sample that is zero on both axes is 0.

    Examples
    --------
    >>> found = instantaneous_motion([1.0, -1.0, 2.0, 0.0], [1.0, -1.0, -2.0, 1.0])
    >>> np.degrees(found.direction).round().tolist()
    [45.0, 45.0, -45.0, 90.0]
    """
    first, second = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    flip = np.where((first < 0.0) | ((first == 0.0) & (second < 0.0)), -1.0, 1.0)
    return PlaneMotion(np.hypot(first, second), np.arctan2(flip * second, flip * first))


def line_of_motion(x: ArrayLike, y: ArrayLike) -> LineFit:
    """Fit a straight line to one acceleration against the other, by least squares.

    Errors are taken to lie in y alone, so noise in x turns the line towards the x axis.

    ``x``, ``y`` (N,): signals sampled at the same instants, of one unit.

    Examples
    --------
    >>> wave = np.sin(np.arange(100))
    >>> fit = line_of_motion(wave, 2 * wave + 1)
    >>> round(fit.slope, 6), round(fit.intercept, 6), round(fit.correlation, 6)
    (2.0, 1.0, 1.0)
    """
    first, second = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    dx, dy = first - first.mean(), second - second.mean()
    sizes = float(dx @ dx), float(dy @ dy)
    if min(sizes) == 0.0:
        raise InvalidData(f"{'x' if sizes[0] == 0.0 else 'y'} does not vary; both must")
    slope = float(dx @ dy) / sizes[0]
    correlation = float(np.clip(dx @ dy / np.sqrt(sizes[0] * sizes[1]), -1.0, 1.0))
    intercept = float(second.mean() - slope * first.mean())
    return LineFit(slope, intercept, correlation, float(np.arctan(slope)))


def quadrature_steps(g: ArrayLike, dt: float, rule: QuadratureRule) -> Array:
    """Integrate over each interval by an open quadrature of the samples that follow it.

    With g_1 at the end of the interval: dt/2 (3 g_1 - g_2) (6.9), or the Newton-Cotes formula
    dt/24 (55 g_1 - 59 g_2 + 37 g_3 - 9 g_4) (6.10). Errors of one interval fall as dt^3 and
    dt^5. (The thesis gives dt^2 for 6.9, which is the error of dt g_1.) White noise in the
    samples comes through 1.6 and 3.7 times dt.

    ``g`` (..., N): samples of the rate, such as an acceleration, m/s^2. Returns (..., N - 1) or
    (..., N - 3): change over the interval that ends at sample k, for every k with samples enough
    after it.

    Examples
    --------
    >>> t = 0.1 * np.arange(20)
    >>> steps = quadrature_steps(3 * t**2, 0.1, "newton_cotes")
    >>> bool(np.allclose(steps, t[:17] ** 3 - (t[:17] - 0.1) ** 3))
    True
    """
    return _filter(g, QUADRATURES[rule]) * dt


def integrate(g: ArrayLike, dt: float, rule: QuadratureRule) -> Array:
    """Sum the steps of a quadrature from zero: velocity from acceleration.

    In the sum all but the first and last few samples have weight one, whatever the rule: the
    rules differ by the end terms only, and each gathers the same drift from noise and offset.

    ``g``, ``dt``, ``rule``: as for `quadrature_steps`. Returns (..., N - 1) or (..., N - 3):
    integral up to sample k, from one sample before the first.

    Examples
    --------
    >>> t = 0.01 * np.arange(200)
    >>> v = integrate(np.cos(t), 0.01, "newton_cotes")
    >>> bool(np.allclose(v, np.sin(t[:197]) - np.sin(-0.01), atol=1e-8))
    True
    """
    return np.asarray(np.cumsum(quadrature_steps(g, dt, rule), axis=-1))


def differentiate(g: ArrayLike, dt: float, rule: DifferenceRule) -> Array:
    """Differentiate samples by a forward difference.

    (g_1 - g_0) / dt (6.13), or (-g_2 + 4 g_1 - 3 g_0) / (2 dt) (6.14). Errors fall as dt and
    dt^2. (The thesis gives dt^2 and dt^3, which are those before the division by dt.) White
    noise in the samples comes through 1.4 / dt and 2.5 / dt.

    ``g`` (..., N): samples, such as an angle, rad. Returns (..., N - 1) or (..., N - 2): derivative
    at sample k.

    Examples
    --------
    >>> t = 0.1 * np.arange(5)
    >>> differentiate(t**2, 0.1, "three_point").round(6).tolist()
    [0.0, 0.2, 0.4]
    """
    return _filter(g, DIFFERENCES[rule]) / dt


def subtract_base(signal: ArrayLike, base: ArrayLike, *, fit: bool = False) -> BaseRemoved:
    """Take the motion of the base off the motion of the point of interest (4.1.4).

    Plain subtraction is right where both sensors have the same axis and gain and the base
    carries the point along rigidly. A gain fitted by least squares mends an unequal gain, but it
    is biased wherever the wanted motion is itself correlated with the base's: it then takes part
    of the wanted motion off too.

    ``signal`` (N,) or (d, N): acceleration of the point, m/s^2. ``base`` (N,): acceleration of the
    base along the same axis, m/s^2. Returns the signal without the base's motion, and the gain.

    Examples
    --------
    >>> base = np.array([1.0, -1.0, 1.0, -1.0])
    >>> found = subtract_base(2 * base + [1, 1, -1, -1], base, fit=True)
    >>> found.signal.tolist(), float(found.gain)
    ([1.0, 1.0, -1.0, -1.0], 2.0)
    """
    samples, ground = np.asarray(signal, dtype=float), np.asarray(base, dtype=float)
    gain = np.ones(samples.shape[:-1])
    if fit:
        varying = ground - ground.mean()
        power = float(varying @ varying)
        if power == 0.0:
            raise InvalidData("base does not vary, so no gain can be fitted; use fit=False")
        gain = np.asarray(samples @ varying / power)
    return BaseRemoved(samples - gain[..., None] * ground, gain)


def _filter(g: ArrayLike, rule: Rule) -> Array:
    samples = np.asarray(g, dtype=float)
    count = samples.shape[-1] - len(rule.weights) + 1
    terms = (w * samples[..., k : k + count] for k, w in enumerate(rule.weights))
    return np.asarray(sum(terms))


def lowest_correlation_search(x: ArrayLike, a: ArrayLike, tolerance: float = 1e-9) -> float:
    """Direction of lowest correlation by bisection; it changes sign from 0 to pi (4.15) [rad]."""
    low, high = 0.0, np.pi
    at_low = correlation_loop(x, a, [low])[0]
    while high - low > tolerance:
        middle = 0.5 * (low + high)
        if correlation_loop(x, a, [middle])[0] * at_low > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def spectral_flatness(
    signal: Array, rate: float, band: tuple[float, float], segments: int = 8
) -> Array:
    """Geometric over arithmetic mean of a Welch spectrum in a band (4.1.2), 0 to 1."""
    half = signal.shape[-1] // (segments + 1)
    frequency, power = welch(signal[..., : half * (segments + 1)], rate, nperseg=2 * half)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    return np.asarray(gmean(power[..., inside], axis=-1) / power[..., inside].mean(axis=-1))
