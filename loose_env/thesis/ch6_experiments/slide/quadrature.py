"""Quadrature and differences: order of accuracy, and a link's rate from its resolver (6.3.2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from loose_env.thesis.ch6_experiments.slide.records import (
    GEAR_PLAY,
    LINK_BAND,
    RESOLVER_UNIT,
    ResolverRecords,
)
from loose_env.thesis.methods.motion.signals import (
    DIFFERENCES,
    QUADRATURES,
    differentiate,
    quadrature_steps,
)
from loose_env.thesis.shared.section import Table
from loose_env.thesis.shared.signal_panels import rms

__all__ = ["order_table", "resolver_part"]


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
