"""Chapter 5 of the thesis: motion distributions of a loose arm, ridge fits, correlation loops."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from loose_env.envs import INK, MEASURED, MUTED, TRUTH
from loose_env.report import AGENTS
from loose_env.statistics import axial_difference
from loose_env.typing import Array
from scripts.charts import Panel, axis, chart, curve, points, ring
from scripts.thesis.estimators import correlation_loop, kurtosis, lowest_correlation_direction
from scripts.thesis.matching import ANGLE, HALF_WIDTH, exact_errors, sampled_errors
from scripts.thesis.page import Section, printed, section
from scripts.thesis.planar_motion import (
    LoosePlanarArm,
    MonteCarlo,
    draw_tool_acceleration,
    draw_tool_displacement,
    draw_tool_velocity,
    looseness_direction,
)
from scripts.thesis.plots import contours

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[[MonteCarlo, int, np.random.Generator], Array]

POSES = (30.0, 90.0, 150.0)
"""Angles of joint 2 [deg]; joint 1 is at zero."""
BETA = math.radians(15.0)
"""Angle of the slide from link 2 [rad]."""
SAMPLES = 400_000
"""Draws behind a set of contours."""
SHARES = (0.5, 0.9, 0.99)
"""Shares of the data that the contours enclose."""
KINDS: tuple[tuple[str, Draw], ...] = (
    ("displacement", draw_tool_displacement),
    ("velocity", draw_tool_velocity),
    ("acceleration", draw_tool_acceleration),
)


Motion = tuple[float, Array, Array, Array]
"""Angle of joint 2 [deg], unit vector along the slide in the world (2,), and the tool's motion in
this pose, tight and loose (2, N)."""


def draw_motions(draw: Draw, seed: int, first: int) -> list[Motion]:
    """Draw the motion in each pose from the seeds ``[seed, first + i]``."""
    found = []
    for k, theta2 in enumerate(POSES):
        loose = MonteCarlo(
            arm=LoosePlanarArm(beta=BETA),
            theta=(0.0, math.radians(theta2)),
            angle_sd=1e-4,
            rate_sd=0.1,
            acceleration_sd=100.0,
        )
        tight, slack = (
            draw(setting, SAMPLES, np.random.default_rng([seed, first + 2 * k + j]))
            for j, setting in enumerate((replace(loose, seat=None), loose))
        )
        found.append((theta2, looseness_direction(loose.arm, loose.theta), tight, slack))
    return found


def simulations(seed: int) -> Section:
    """Motion distributions of a loose arm, and the fit of a Gaussian ridge to histograms."""
    told = printed("simulations")["matching"]
    motions = {name: draw_motions(draw, seed, 10 * k) for k, (name, draw) in enumerate(KINDS)}
    every = [(name, *m) for name, group in motions.items() for m in group]
    excess = [
        (kurtosis(tight, u), kurtosis(loose, u), kurtosis(loose, [-u[1], u[0]]))
        for *_, u, tight, loose in every
    ]
    along, across = [along for _, along, _ in excess], [across for *_, across in excess]
    # Four deviations of the kurtosis of a Gaussian sample, sqrt(24 / N), since there are many.
    limit = 4.0 * math.sqrt(24.0 / SAMPLES)
    part = told["trial_values_within_percent"] / 100.0
    exact = np.abs(exact_errors(part)).max(axis=0)
    many, few = 6000, int(told["trials"])
    promise = f"{told['parameter_error_percent']} %"
    error_rows = [("the model's own counts (worst)", promise, *(_tiny(100 * x) for x in exact))]
    cases = ((few, 10, 40, promise), (many, 30, 12, ""))
    sampled = [
        np.median(np.abs(sampled_errors(n, bins, sets, [seed, 50 + k], part)), axis=0)
        for k, (n, bins, sets, _) in enumerate(cases)
    ]
    for (n, *_, said), (height, exponent, turn) in zip(cases, sampled, strict=True):
        sizes = (f"{100 * x:.0f} %" for x in (height, exponent))
        error_rows.append((f"{n} samples", said, *sizes, f"{math.degrees(turn):.1f}°"))
    off, worst = sampled[0], _tiny(100 * float(exact.max()))
    half, tilt = HALF_WIDTH, ANGLE
    stays = "stays" if np.abs(across).max() < limit else "does not stay"
    distinct, low, high = sum(abs(value) > limit for value in along), min(along), max(along)
    count = len(across)
    return section(
        "simulations",
        locals(),
        [[(*each[:2], *row) for each, row in zip(every, excess, strict=True)], error_rows],
        [_contours(motions["displacement"], 1e3, "mm"), _contours(motions["velocity"], 1.0, "m/s")],
    )


def _tiny(percent: float) -> str:
    return "below 0.0001 %" if percent < 1e-4 else f"{percent:.2g} %"


def _contours(motions: list[Motion], scale: float, unit: str) -> Figure:
    reach = scale * max(float(np.quantile(np.abs(loose), 0.9995)) for *_, loose in motions)
    length = 10.0 ** math.floor(math.log10(reach))
    look: dict[str, Any] = {"shares": SHARES, "linewidths": np.linspace(0.8, 1.8, 3), "bins": 50}
    scale_bar = curve(
        [-0.95 * reach, length - 0.95 * reach], [-0.93 * reach] * 2, f"{length:g} {unit}", color=INK
    )
    limits = {"xlim": (-reach, reach), "ylim": (-reach, reach)}
    panels = [
        Panel(
            title=f"{name}, θ₂ = {theta2:g}°",
            curves=[
                contours(scale * samples, colors=[colour], **look),
                axis(0.95 * reach * slide, "slide", color=MUTED, linewidth=1.0, dashes=(3, 3)),
                *([scale_bar] if name == "loose" else []),
            ],
            look=limits,
        )
        for name, colour in (("tight", MEASURED), ("loose", TRUTH))
        for theta2, slide, *both in motions
        for samples in [both[name == "loose"]]
    ]
    return chart(panels, columns=3, height=1.8, bare=True)


# Correlation vectors of motions whose directions are known (5.3.2).

SETS = 200
"""Data sets behind each error of a direction."""
LOOP = np.linspace(0.0, math.pi, 361)
"""Angles of a loop [rad]; the other half of the turn repeats it."""
RATIOS = (0.1, 0.5, 1.0, 2.0, 10.0)
"""Variance of the component that is correlated, to that of the other."""
MIXES = ((1, 10), (1, 5), (1, 1), (5, 1), (10, 1))
"""Half range of the uniform component and variance of the Gaussian one."""


class Loop(NamedTuple):
    """Loop and direction errors of one ratio."""

    name: str
    slope: float
    """Change of the correlation per radian where it is zero, from the model [1/rad]."""
    loop: Array
    """Correlation at the angles of `LOOP` (K,), of one data set."""
    errors: Array
    """Errors of the direction of lowest correlation over data sets [rad] (S,)."""
    predicted: float
    """Sampling deviation of the direction, from the model [rad]."""

    @property
    def rms(self) -> float:
        """Root mean square error [deg]."""
        return math.degrees(float(np.sqrt(np.mean(self.errors**2))))

    @property
    def low(self) -> float:
        """Share of directions whose correlation is below 0.1, from the model [1]."""
        # |r| < 0.1 where |cot phi| < t / slope, with t = 0.1 / sqrt(1 - 0.1²).
        return 2.0 * math.atan(0.1 / math.sqrt(0.99) / self.slope) / math.pi


def scaled_normal(count: int, ratio: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw a Gaussian signal x and a motion: x with its variance scaled, across it another."""
    x, other = rng.standard_normal((2, count))
    return x, np.stack([math.sqrt(ratio) * x, other])


def uniform_across(
    count: int, width: float, variance: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw a Gaussian signal x and a motion: x itself, and across it one uniform in ± width."""
    x = math.sqrt(variance) * rng.standard_normal(count)
    return x, np.stack([x, rng.uniform(-width, width, count)])


def lowest_correlation_search(x: Array, a: Array, tolerance: float = 1e-9) -> float:
    """Direction of lowest correlation by the thesis's bisection from 0 to pi [rad]."""
    low, high = 0.0, math.pi
    at_low = correlation_loop(x, a, [low])[0]
    while high - low > tolerance:
        middle = 0.5 * (low + high)
        if correlation_loop(x, a, [middle])[0] * at_low > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _loop(name: str, slope: float, count: int, sets: Sequence[tuple[Array, Array]]) -> Loop:
    """Loop of the first set and errors of all; slope: deviation along over deviation across."""
    errors = [axial_difference(lowest_correlation_direction(x, a), math.pi / 2) for x, a in sets]
    predicted = 1.0 / (slope * math.sqrt(count))
    return Loop(name, slope, correlation_loop(*sets[0], LOOP), np.array(errors), predicted)


def correlation_simulations(seed: int) -> Section:
    """Correlation loops of scaled Gaussian motions and of uniform ones, and their minima."""
    count = int(printed("correlation_simulations")["samples"])

    def rngs(k: int) -> list[np.random.Generator]:
        return [np.random.default_rng([seed, k, s]) for s in range(SETS)]

    scaled = [
        _loop(f"{q:g}", math.sqrt(q), count, [scaled_normal(count, q, rng) for rng in rngs(k)])
        for k, q in enumerate(RATIOS)
    ]
    mixed = [
        _loop(
            f"a{w}b{v}",
            math.sqrt(3.0 * v) / w,
            count,
            [uniform_across(count, w, v, rng) for rng in rngs(10 + k)],
        )
        for k, (w, v) in enumerate(MIXES)
    ]
    x, a = uniform_across(count, 5.0, 1.0, np.random.default_rng([seed, 30]))
    direct, loop = lowest_correlation_direction(x, a), correlation_loop(x, a, LOOP)
    louder = axial_difference(lowest_correlation_direction(x, 10.0 * a), direct)
    both = [*scaled, *mixed]
    biased = [r.name for r in both if abs(r.errors.mean()) > 4 * r.errors.std() / math.sqrt(SETS)]
    factors = [float(np.sqrt(np.mean(r.errors**2))) / r.predicted for r in both]
    worst = max(mixed, key=lambda r: r.rms)

    searched = abs(axial_difference(lowest_correlation_search(x, a), direct))
    opposite = np.abs(loop + correlation_loop(x, a, LOOP + math.pi)).max()
    louder_words = (
        "leaves the direction as it is" if abs(louder) < 1e-12 else "changes the direction"
    )
    biased_words = "error is within four of its own deviations at every ratio"
    if biased:
        biased_words = f"error is beyond four of its own deviations at {', '.join(biased)}"
    last, least, most = (scaled[-1], mixed[-1]), min(factors), max(factors)
    turned = np.mean(np.abs(worst.errors) > math.pi / 4)
    return section(
        "correlation_simulations",
        locals(),
        [[(r, math.pi / 2 + r.errors.mean(), 2.0 / r.slope) for r in rs] for rs in (scaled, mixed)],
        [_loops(scaled, mixed), _error_figure(scaled, mixed)],
    )


def _loops(scaled: list[Loop], mixed: list[Loop]) -> Figure:
    cosine, sine = np.cos(LOOP), np.sin(LOOP)
    panels = []
    for title, results in (("scaled Gaussian", scaled), ("uniform across", mixed)):
        curves = [
            curve(r.loop * cosine, r.loop * sine, r.name, color=AGENTS[j], linewidth=1.8)
            for j, r in enumerate(results)
        ]
        panels.append(Panel(title=title, curves=[ring(0.5), ring(1.0), *curves]))
    return chart(panels, columns=2, height=2.8, bare=True)


def _error_figure(scaled: list[Loop], mixed: list[Loop]) -> Figure:
    slopes = np.geomspace(0.15, 6.5, 30)
    count = 1.0 / (scaled[0].predicted * scaled[0].slope) ** 2
    expected = np.degrees(1.0 / (slopes * math.sqrt(count)))
    curves = [curve(slopes, expected, "from the model", color=MUTED)]
    for name, results, k in (("scaled Gaussian", scaled, 0), ("uniform across", mixed, 1)):
        x, y = [r.slope for r in results], [r.rms for r in results]
        curves.append(points(x, y, name, marker="os"[k], color=AGENTS[k], markersize=6))
    look = {"xscale": "log", "yscale": "log"}
    panel = Panel(title="rms error of the direction [°]", curves=curves, look=look)
    return chart([panel], across="deviation along over deviation across", height=2.3)
