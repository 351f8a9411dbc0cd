"""Kinematic Monte Carlo and matching of a distribution to its histogram (thesis chapter 5)."""

from __future__ import annotations

import math

import numpy as np

from loose_env.report import FigureCard
from loose_env.thesis.ch5_simulation.distribution_matching import (
    ANGLE,
    HALF_WIDTH,
    STARTS,
    Case,
    Found,
    SpatialFound,
    basin_figure,
    exact_surface,
    far_success,
    near_errors,
    planar_study,
    spatial_study,
)
from loose_env.thesis.ch5_simulation.tool_motion import (
    KINDS,
    STEPS,
    card,
    draw_motions,
    kurtosis_table,
    motion_words,
    transitions,
)
from loose_env.thesis.methods.motion.distribution_matching import MatchSettings
from loose_env.thesis.methods.motion.seat_motion import (
    SeatMotion,
    displacement_chain,
    regions,
    transition_table,
)
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.sections import Section, Table
from loose_env.typing import Array

_PLANAR = "loose_env.thesis.methods.motion.loose_planar_arm"
_SEAT = "loose_env.thesis.methods.motion.seat_motion"
_RIDGE = "loose_env.thesis.methods.motion.gaussian_ridge"
EQUATIONS: dict[str, str] = {
    "3.70": "loose_env.thesis.methods.motion.histogram.marginal",
    "3.71": f"{_PLANAR}.nominal_jacobian",
    "4.1": f"{_RIDGE}.to_plane",
    "4.2": f"{_RIDGE}.rotation",
    "4.3": f"{_RIDGE}.planar_ridge",
    "4.4": f"{_RIDGE}.along",
    "4.5": f"{_RIDGE}.planar_ridge",
    "4.6": f"{_RIDGE}.planar_ridge",
    "4.7": f"{_RIDGE}.variance_trial",
    "4.8": f"{_RIDGE}.exponent_from_sd",
    "4.9": f"{_RIDGE}.planar_trial",
    "5.1": f"{_SEAT}.region_probabilities",
    "5.2": f"{_SEAT}.region_probabilities",
    "5.3": f"{_PLANAR}.tool_position",
    "5.4": f"{_PLANAR}.tool_velocity",
    "5.5": f"{_PLANAR}.link_rate",
    "5.6": f"{_PLANAR}.tool_acceleration",
}
"""Function of each equation."""


def section(seed: int) -> Section:
    """Motion distributions of a loose arm, and the fit of a Gaussian ridge to histograms."""
    source = printed("simulations")
    told = source["matching"]
    motions = {name: draw_motions(draw, seed, 10 * k) for k, (name, draw) in enumerate(KINDS)}
    seat = SeatMotion()
    chain = displacement_chain(seat, STEPS, np.random.default_rng([seed, 40]))
    table = transition_table(regions(seat, chain))
    part = told["trial_values_within_percent"] / 100.0
    surface, truth = exact_surface()
    exact = near_errors(surface, truth, part)
    far, by_offset = far_success(surface, truth)
    many, few = 6000, int(told["trials"])
    cases = (
        Case(name=f"{few} samples", trials=few, bins=10, sets=40),
        Case(name=f"{many} samples", trials=many, bins=30, sets=12),
        Case(
            name=f"{many} samples,\nempty bins too",
            trials=many,
            bins=20,
            sets=8,
            settings=MatchSettings(bins="all", iterations=50),
        ),
    )
    found = [planar_study(case, [seed, 50 + k], part) for k, case in enumerate(cases)]
    spatial = [
        spatial_study(Case(name=f"{n} samples", trials=n, bins=b, sets=8), [seed, 60 + k])
        for k, (n, b) in enumerate(((few, 6), (many, 12)))
    ]
    return Section(
        key="simulations",
        title="Chapter 5: simulated motion distributions and marginal distribution matching",
        finding=(
            f"Matching finds its parameters to {_tiny(100 * float(np.abs(exact).max()))} on a "
            f"smooth histogram (printed: {told['parameter_error_percent']} %); on {few} samples "
            f"{100 * found[0].success[-1]:.0f} % of far starts reach the direction, "
            f"{100 * found[0].searched:.0f} % with several starts."
        ),
        words=(
            *motion_words(motions, table, source),
            *_match_words(exact, far, found, spatial, told),
        ),
        tables=(
            kurtosis_table(motions),
            transitions(table, source),
            _errors(exact, found, told),
            _spatial_table(spatial),
        ),
        cards=(
            card(motions["displacement"], "displacement", "5.6", 1e3, "mm"),
            card(motions["velocity"], "velocity", "5.8", 1.0, "m/s"),
            FigureCard(
                image=basin_figure(found, by_offset),
                title="From how far the match finds the direction",
                caption=(
                    "Share of data sets in which the direction found lies within 5° of the truth, "
                    "against the distance of the trial direction; at the right, the lowest "
                    f"residual of {STARTS} starts."
                ),
            ),
        ),
        equations=EQUATIONS,
        left_out=(
            "Equations 5.7 and 5.8, rigid-body dynamics: the thesis gave them up for Monte Carlo "
            "too; here the dynamics are simulated by MuJoCo.",
            "The fit of an ellipsoid in place of a Gaussian, which is named and not worked out.",
            "The scales of figures 5.6 and 5.8: pose, gap and joint motion are not printed, so "
            "the gap of the test arm is used with joint motion of like size.",
        ),
    )


def _match_words(
    exact: Array,
    exact_far: float,
    found: list[Found],
    spatial: list[SpatialFound],
    told: dict[str, float],
) -> list[str]:
    few, many, all_bins = found
    worst = 100.0 * float(np.abs(exact).max())
    promise = told["parameter_error_percent"]
    errors = 100.0 * np.median(np.abs(few.near[:, :2]), axis=0)
    turn = math.degrees(float(np.median(np.abs(few.near[:, 2]))))
    near, far = few.success[0], few.success[-1]
    gain = few.searched - far
    range_share = math.sqrt(2.0) / 4.0
    least = float(many.success[:-1].min())
    close, beyond = all_bins.success[0], float(all_bins.success[1:].max())
    narrow = close > 0.5 and beyond < 0.5
    begun = math.degrees(ANGLE) * told["trial_values_within_percent"] / 100.0
    kept = math.degrees(float(np.median(np.abs(all_bins.near[:, 2]))))
    stuck = all_bins.converged < 0.5 and kept > 0.5 * begun
    return [
        "Matching fits a Gaussian ridge to the bins of a histogram by orthogonal distances, with "
        "odrpack, the kept descendant of the thesis's own library. The data are Gaussian along "
        f"{math.degrees(ANGLE):.0f}° and uniform across, ±{HALF_WIDTH:g} deviations wide. "
        f"The thesis reports parameters within {promise} % from trial values within "
        f"{told['trial_values_within_percent']} %. On counts that are exactly the model's, the "
        f"largest error here is {_tiny(worst)}: the claim "
        f"{'holds' if worst <= promise else 'fails'}. With height and "
        "exponent wrong by a factor of ten either way and directions up to 80° off, "
        f"{100 * exact_far:.0f} % of the fits still end there. On histograms of "
        f"{told['trials']} samples, as the text has it, the height is off by {errors[0]:.0f} %, "
        f"the exponent by {errors[1]:.0f} % and the direction by {turn:.1f}° (medians): "
        f"{'no' if errors.min() > promise else 'a'} histogram so sparse carries {promise} %.",
        "The thesis found no way to the direction from a poor trial. With "
        f"{many.case.trials} samples, starts up to 80° away succeed in "
        f"{'all' if least == 1.0 else f'{100 * least:.0f} % or more'} of the data sets. With "
        f"{few.case.trials} samples, {100 * near:.0f} % succeed from the true direction and "
        f"{100 * far:.0f} % from 90° away. The lowest residual of {STARTS} starts, which the "
        f"thesis proposes and did not try, succeeds in {100 * few.searched:.0f} %: it "
        f"{'mends the start' if gain > 0.05 else 'does not mend the start'}, and cannot give what "
        "the data do not hold.",
        "These fits leave empty bins out. The ridge of the model is infinite, the uniform motion "
        f"is not: with empty bins fitted too, {100 * all_bins.converged:.0f} % of the fits come to "
        f"an end by themselves, {100 * close:.0f} % of the directions are right from the true one "
        f"and {100 * beyond:.0f} % at best from 10° away or more. "
        f"{'Such a fit seldom searches: points slide onto a ridge that ' if stuck else ''}"
        f"{'narrows where it began, ' if stuck else 'From near, the direction is '}"
        f"{kept:.1f}° off after a trial {begun:.1f}° off. "
        f"{'That would look like the narrow reach that the thesis reports. ' if narrow else ''}"
        f"The lowest of {STARTS} residuals succeeds there in {100 * all_bins.searched:.0f} %.",
        "In space six parameters are fitted. With "
        f"{spatial[1].case.trials} samples the median error from {STARTS} starts is "
        f"{math.degrees(float(np.median(spatial[1].searched))):.1f}°, with "
        f"{spatial[0].case.trials} it is "
        f"{math.degrees(float(np.median(spatial[0].searched))):.1f}°. The printed limit of "
        f"±{told['spatial_search_range_deg']}° in azimuth and elevation covers "
        f"{100 * range_share:.0f} % of all axes, so starts here cover the whole hemisphere. "
        "Equation 4.7 as printed lacks the division by the sum of the counts; it is made here.",
    ]


def _errors(exact: Array, found: list[Found], told: dict[str, float]) -> Table:
    promise = f"{told['parameter_error_percent']} %"
    worst = 100.0 * np.abs(exact).max(axis=0)
    rows = [("the model's own counts (worst)", promise, *(_tiny(w) for w in worst), "")]
    for f in found:
        height, exponent, turn = np.median(np.abs(f.near), axis=0)
        rows.append(
            (
                f.case.name.replace("\n", " "),
                promise if f.case.trials == told["trials"] else "",
                _percent(height),
                _percent(exponent),
                f"{math.degrees(turn):.1f}°",
                f"{100 * f.converged:.0f} %",
            )
        )
    return Table(
        caption=(
            "Section 5.3.1: error of the parameters from trial values within "
            f"{told['trial_values_within_percent']} % (medians over data sets)"
        ),
        columns=("data", "printed", "height a₀", "exponent a₁", "direction a₂", "fits that end"),
        rows=tuple(rows),
    )


def _tiny(percent: float) -> str:
    return "below 0.0001 %" if percent < 1e-4 else f"{percent:.2g} %"


def _percent(part: float) -> str:
    return f"{100 * part:.0f} %" if part < 10.0 else "diverges"


def _spatial_table(spatial: list[SpatialFound]) -> Table:
    offsets = [f"{math.degrees(o):.0f}° away" for o in spatial[0].offsets]
    rows = [
        (
            s.case.name,
            *(f"{e:.1f}°" for e in np.degrees(np.median(s.errors, axis=0))),
            f"{math.degrees(float(np.median(s.searched))):.1f}°",
        )
        for s in spatial
    ]
    return Table(
        caption="Matching in space: median error of the direction, by the trial direction",
        columns=("data", *offsets, f"{STARTS} starts"),
        rows=tuple(rows),
    )
