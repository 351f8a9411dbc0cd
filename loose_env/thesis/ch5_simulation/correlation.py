"""Correlation vectors of simulated motions whose directions are known (thesis 5.3.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs import FAINT, INK, MUTED
from loose_env.report import AGENTS, FigureCard, new_figure, quiet_axes
from loose_env.statistics import (
    axial_difference,
    correlation_loop,
    lowest_correlation_direction,
)
from loose_env.thesis.methods.motion.signals import lowest_correlation_search
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.sections import Section, Table
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


EQUATIONS: dict[str, str] = {
    "4.10": "loose_env.statistics.correlation.correlation_loop",
    "4.11": "loose_env.statistics.correlation.correlation_loop",
    "4.12": "loose_env.statistics.correlation.correlation_loop",
    "4.13": "loose_env.statistics.correlation.correlation_loop",
    "4.14": "loose_env.statistics.correlation.correlation_loop",
    "4.15": "loose_env.statistics.correlation.correlation_loop",
}
"""Function of each equation."""


SETS = 200
"""Data sets behind each error of a direction."""
LOOP = np.linspace(0.0, math.pi, 361)
"""Angles of a loop [rad]; the other half of the turn repeats it."""
RATIOS = (0.1, 0.5, 1.0, 2.0, 10.0)
"""Variance of the component that is correlated, to that of the other."""
MIXES = ((1, 10), (1, 5), (1, 1), (5, 1), (10, 1))
"""Half range of the uniform component and variance of the Gaussian one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Result:
    """Loop and direction errors of one ratio."""

    name: str
    loop: Array
    """Correlation at the angles of `LOOP` (K,), of one data set."""
    errors: Array
    """Errors of the direction of lowest correlation over data sets [rad] (S,)."""
    slope: float
    """Change of the correlation per radian where it is zero, from the model [1/rad]."""
    predicted: float
    """Sampling deviation of the direction, from the model [rad]."""
    low: float
    """Share of directions whose correlation is below 0.1, from the model [1]."""


def scaled_normal(count: int, ratio: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw a Gaussian signal x and a motion: x with its variance scaled, across it another.

    ``ratio``: variance of the motion along x over that across it. Returns ``x`` (N,): signal; ``a``
    (2, N): motion; row 0 is x scaled.
    """
    x, other = rng.standard_normal((2, count))
    return x, np.stack([math.sqrt(ratio) * x, other])


def uniform_across(
    count: int, width: float, variance: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw a Gaussian signal x and a motion: x itself, and across it a uniform component.

    ``width``: half the range of the uniform component, as the thesis counts it. Returns ``x`` (N,):
    signal; ``a`` (2, N): motion; row 0 is x.
    """
    x = math.sqrt(variance) * rng.standard_normal(count)
    return x, np.stack([x, rng.uniform(-width, width, count)])


def section(seed: int) -> Section:
    """Correlation loops of scaled Gaussian motions and of uniform ones, and their minima."""
    source = printed("correlation_simulations")
    count = int(source["samples"])
    scaled = [
        _result(f"{q:g}", math.sqrt(q), count, [scaled_normal(count, q, rng) for rng in rngs])
        for k, q in enumerate(RATIOS)
        for rngs in [[np.random.default_rng([seed, k, s]) for s in range(SETS)]]
    ]
    mixed = [
        _result(
            f"a{w}b{v}",
            math.sqrt(3.0 * v) / w,
            count,
            [uniform_across(count, w, v, rng) for rng in rngs],
        )
        for k, (w, v) in enumerate(MIXES)
        for rngs in [[np.random.default_rng([seed, 10 + k, s]) for s in range(SETS)]]
    ]

    def rms(result: _Result) -> float:
        return math.degrees(float(np.sqrt(np.mean(result.errors**2))))

    return Section(
        key="correlation_simulations",
        title="Section 5.3.2: the direction of lowest correlation in simulated motions",
        finding=(
            f"Scaled by 0.1 to 10 the minimum stays where it was, with {rms(scaled[0]):.1f}° down "
            f"to {rms(scaled[-1]):.1f}° of scatter (RMS); the thesis's shift with a wide uniform "
            f"component is scatter too, {rms(mixed[-1]):.1f}° at {mixed[-1].name}."
        ),
        words=_words(scaled, mixed, seed, count),
        tables=(
            _table(
                scaled,
                "Figures 5.9 and 5.10: scaled Gaussian component, minimum expected at 90°",
                "variance ratio",
            ),
            _table(
                mixed,
                "Figure 5.11: uniform component across, minimum expected at 90° "
                f"({source['expected_direction_deg']}° in the thesis, the same axis)",
                "half range : variance",
            ),
        ),
        cards=(
            FigureCard(
                image=_loops(scaled, mixed),
                title="Correlation loops",
                caption=(
                    "Figures 5.9 to 5.11: correlation as distance from the origin, against "
                    "direction. Left, the correlated component scaled (variance ratio; 1 is figure "
                    "5.9). Right, a uniform component across (aWbV: half range W, variance V). "
                    "Each loop passes through the origin along 90°."
                ),
            ),
            FigureCard(
                image=_error_figure(scaled, mixed),
                title="Error of the direction",
                caption=(
                    f"Root mean square over {SETS} sets of {count} samples (dots) and the sampling "
                    "deviation that follows from the slope (line)."
                ),
            ),
        ),
        equations=EQUATIONS,
        left_out=("The ratios between 0.1 and 10 that the thesis drew are not all printed.",),
    )


def _result(name: str, slope: float, count: int, sets: Sequence[tuple[Array, Array]]) -> _Result:
    """Loop of the first set and errors of all; slope: deviation along over deviation across."""
    errors = [axial_difference(lowest_correlation_direction(x, a), math.pi / 2) for x, a in sets]
    # |r| < 0.1 where |cot phi| < t / slope, with t = 0.1 / sqrt(1 - 0.1^2).
    near = math.atan(0.1 / math.sqrt(0.99) / slope)
    return _Result(
        name=name,
        loop=correlation_loop(*sets[0], LOOP),
        errors=np.array(errors),
        slope=slope,
        predicted=1.0 / (slope * math.sqrt(count)),
        low=2.0 * near / math.pi,
    )


def _words(scaled: list[_Result], mixed: list[_Result], seed: int, count: int) -> list[str]:
    x, a = uniform_across(count, 5.0, 1.0, np.random.default_rng([seed, 30]))
    direct, searched = lowest_correlation_direction(x, a), lowest_correlation_search(x, a)
    louder = lowest_correlation_direction(x, 10.0 * a)
    loop = correlation_loop(x, a, LOOP)
    opposite = float(np.abs(loop + correlation_loop(x, a, LOOP + math.pi)).max())
    both = [*scaled, *mixed]
    biased = [r.name for r in both if abs(r.errors.mean()) > 4 * r.errors.std() / math.sqrt(SETS)]
    factors = [_rms(r) / r.predicted for r in both]
    worst = max(mixed, key=_rms)
    turned = float(np.mean(np.abs(worst.errors) > math.pi / 4))
    same = abs(axial_difference(louder, direct)) < 1e-12
    return [
        f"A motion of {count} samples has one component that follows a Gaussian signal and one, "
        "across it, that is independent. The correlation with the signal is taken along every "
        "direction; it is zero across the component that follows, at 90°. No trial direction is "
        "needed. The thesis's bisection and the closed form differ by "
        f"{abs(axial_difference(searched, direct)):.0e} rad, and the correlation of opposite "
        f"directions sums to {opposite:.0e} at most (4.15).",
        "With r = s cos φ / √(s² cos² φ + sin² φ), s the ratio of the deviations, the correlation "
        "crosses zero with slope s, and the curvature of the loop at the origin is 2 / s. So a "
        "strong component gives a flat loop and a sharp direction, as the thesis found: from "
        f"ratio {scaled[0].name} to {scaled[-1].name} the error falls from "
        f"{math.degrees(_rms(scaled[0])):.2f}° to {math.degrees(_rms(scaled[-1])):.2f}°. "
        "Its advice to amplify the tool's signal does not follow: a factor on the whole signal "
        f"{'leaves the direction as it is' if same else 'changes the direction'}; only "
        "the share of the motion that follows the joint counts.",
        "The thesis found that with a wide uniform component the minimum moves towards the "
        "direction of the Gaussian one. With independent components it does not move: the mean "
        + (
            "error is within four of its own deviations at every ratio"
            if not biased
            else f"error is beyond four of its own deviations at {', '.join(biased)}"
        )
        + ". What grows is the sampling error, 1 / (s √N) radians; measured over predicted lies "
        f"between {min(factors):.2f} and {max(factors):.2f}. At {worst.name} it is "
        f"{math.degrees(_rms(worst)):.1f}°, and {100 * turned:.0f} % of the sets end nearer to the "
        "Gaussian direction. The loop also becomes thin there: the correlation is below 0.1 in "
        f"{100 * worst.low:.0f} % of all directions, against {100 * mixed[0].low:.1f} % at "
        f"{mixed[0].name}, so a minimum read from a plot may lie anywhere in them.",
    ]


def _rms(result: _Result) -> float:
    return float(np.sqrt(np.mean(result.errors**2)))


def _table(results: list[_Result], caption: str, first: str) -> Table:
    rows = [
        (
            r.name,
            f"{90 + math.degrees(float(r.errors.mean())):.2f}°",
            f"{math.degrees(_rms(r)):.2f}°",
            f"{math.degrees(r.predicted):.2f}°",
            f"{r.slope:.2f}",
            f"{2.0 / r.slope:.2f}",
            f"{100 * r.low:.1f} %",
        )
        for r in results
    ]
    columns = (
        first,
        "mean direction",
        "rms error",
        "predicted",
        "slope [1/rad]",
        "curvature",
        "|r| < 0.1",
    )
    return Table(caption=caption, columns=columns, rows=tuple(rows))


def _loops(scaled: list[_Result], mixed: list[_Result]) -> Figure:
    figure = new_figure(5.0)
    for k, results in enumerate((scaled, mixed)):
        axes = figure.add_axes((0.02 + 0.5 * k, 0.07, 0.46, 0.87))
        axes.set_title(
            ("scaled Gaussian", "uniform across")[k], fontsize=9.5, color=INK, x=0.02, ha="left"
        )
        turn = np.linspace(-math.pi / 2, math.pi / 2, 181)
        for radius in (0.5, 1.0):
            axes.plot(radius * np.cos(turn), radius * np.sin(turn), color=FAINT, linewidth=0.8)
        for angle, label in ((0, "0°"), (45, "45°"), (90, "90°"), (-45, "135°")):
            c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
            axes.plot([0.0, c], [0.0, s], color=FAINT, linewidth=0.8, zorder=0)
            axes.text(
                1.08 * c, 1.08 * s, label, fontsize=8.5, color=MUTED, ha="center", va="center"
            )
        for j, result in enumerate(results):
            axes.plot(
                result.loop * np.cos(LOOP),
                result.loop * np.sin(LOOP),
                color=AGENTS[j],
                linewidth=1.8,
            )
        _key(axes, [r.name for r in results])
        axes.set(xlim=(-0.12, 1.2), ylim=(-1.7, 1.16), aspect="equal")
        axes.axis("off")
    return figure


def _key(axes: Axes, names: Sequence[str]) -> None:
    """Name the loops below them, in three rows."""
    for j, name in enumerate(names):
        x, y = 0.08 + 0.55 * (j // 3), -1.33 - 0.15 * (j % 3)
        axes.plot([x, x + 0.11], [y, y], color=AGENTS[j], linewidth=2.0)
        axes.text(x + 0.16, y, name, fontsize=8.5, color=INK, va="center")


def _error_figure(scaled: list[_Result], mixed: list[_Result]) -> Figure:
    figure = new_figure(3.0)
    axes = figure.add_axes((0.12, 0.17, 0.82, 0.70))
    slopes = np.geomspace(0.15, 6.5, 30)
    count = 1.0 / (scaled[0].predicted * scaled[0].slope) ** 2
    axes.plot(slopes, np.degrees(1.0 / (slopes * math.sqrt(count))), color=MUTED, linewidth=1.2)
    for results, colour, marker in ((scaled, AGENTS[0], "o"), (mixed, AGENTS[1], "s")):
        axes.plot(
            [r.slope for r in results],
            [math.degrees(_rms(r)) for r in results],
            color=colour,
            marker=marker,
            markersize=6,
            linestyle="none",
        )
    axes.text(0.19, 4.8, "uniform across", color=INK, fontsize=9)
    axes.text(1.12, 0.78, "scaled Gaussian", color=INK, fontsize=9)
    axes.set(xscale="log", yscale="log", xlim=(0.13, 8.0), ylim=(0.09, 7.0))
    axes.set_xticks([0.2, 0.5, 1, 2, 5], ["0.2", "0.5", "1", "2", "5"], minor=False)
    axes.set_yticks([0.1, 0.3, 1, 3], ["0.1°", "0.3°", "1°", "3°"], minor=False)
    axes.set_xticks([], minor=True)
    axes.set_yticks([], minor=True)
    axes.set_xlabel("deviation along over deviation across", color=MUTED, fontsize=9)
    axes.text(0.13, 8.0, "rms error of the direction", color=MUTED, fontsize=9)
    quiet_axes(axes, size=9)
    return figure
