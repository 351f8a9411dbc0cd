"""Chapter 3.2: seven ways to model looseness, and what a loose seat does to two matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from loose_env.arms import planar, vera
from loose_env.envs import INK, MEASURED, MUTED, SHAKEN
from loose_env.report import FigureCard, new_figure, quiet_axes
from loose_env.thesis.methods.looseness.modelling_alternatives import Disagreement

if TYPE_CHECKING:
    from matplotlib.figure import Figure

from loose_env.thesis.ch3_modelling.alternatives import (
    carried_torque,
    compare,
    disagreement_table,
    finding,
    opening_words,
    step_words,
    verdicts,
    what_table,
)
from loose_env.thesis.ch3_modelling.matrices import (
    inertia_condition,
    jacobian_columns,
    jacobian_ranks,
)
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.sections import Section

EQUATIONS: dict[str, str] = {
    **dict.fromkeys(("3.2", "3.28", "3.29", "3.32"), "loose_env.kinematics.geometric_jacobian"),
    **dict.fromkeys(
        ("3.3", "3.30"), "loose_env.thesis.methods.looseness.looseness_joint.tool_velocity"
    ),
    "3.1": "loose_env.kinematics.Chain.of",
    "3.26": "loose_env.thesis.methods.looseness.looseness_joint.looseness_transform",
    "3.27": "loose_env.thesis.methods.looseness.looseness_joint.slot_direction",
    "3.31": "loose_env.thesis.methods.looseness.looseness_joint.insert_looseness",
    "3.33": "loose_env.thesis.methods.looseness.looseness_joint.displaced",
    "3.34": "loose_env.thesis.methods.looseness.looseness_joint.velocity_error",
    **dict.fromkeys(
        ("3.9", "3.15", "3.16", "3.17", "3.20", "3.21", "3.23", "3.24"),
        "loose_env.thesis.methods.looseness.static_force_test.tool_acceleration",
    ),
    "3.10": "loose_env.thesis.methods.looseness.static_force_test.joint_torques",
    "3.11": "loose_env.thesis.methods.motion.joint_loads.arm_loads",
    **dict.fromkeys(
        ("3.18", "3.19"), "loose_env.thesis.methods.looseness.static_force_test.simulate_docked"
    ),
    "3.22": "loose_env.thesis.methods.looseness.static_force_test.docked_acceleration",
    "3.25": "loose_env.thesis.methods.looseness.static_force_test.dock_force",
    **dict.fromkeys(
        ("3.35", "3.36"), "loose_env.thesis.methods.motion.seat_motion.draw_seat_velocity"
    ),
    "3.43": "loose_env.thesis.methods.looseness.looseness_joint.seated_inertia",
    "4.21": "loose_env.thesis.methods.looseness.looseness_joint.tool_velocity",
    "4.24": "loose_env.thesis.methods.looseness.static_force_test.tool_acceleration",
}
"""Function of each equation."""


def section(seed: int) -> Section:
    """Reproduce section 3.2: modelling alternatives, Jacobian and inertia matrix.

    Examples
    --------
    >>> from loose_env.thesis.methods.looseness.modelling_alternatives import ALTERNATIVES
    >>> from loose_env.thesis.printed import printed
    >>> len(ALTERNATIVES) == printed("modelling")["alternatives_count"]
    True
    """
    told = printed("modelling")
    arm = vera()
    flexible = compare(arm, seed, 0)
    halved = compare(replace(arm, timestep=arm.timestep / 2), seed, 0)
    stiff = compare(planar(2), seed, 1)
    columns_table, columns_words = jacobian_columns()
    rank_table, rank_words = jacobian_ranks(told)
    inertia_table, inertia_words, inertia_card = inertia_condition(seed, told)
    return Section(
        key="modelling",
        title="Modelling looseness (3.2)",
        finding=finding(flexible, stiff, told["alternatives_chosen"]),
        words=[
            opening_words(),
            *verdicts(flexible, stiff, told["alternatives_chosen"]),
            step_words(flexible, halved),
            carried_torque(seed),
            columns_words,
            rank_words,
            inertia_words,
        ],
        tables=[
            what_table(),
            disagreement_table(flexible, "VERA, whose first bending mode lies inside the band"),
            disagreement_table(stiff, "A stiff planar arm of two links"),
            columns_table,
            rank_table,
            inertia_table,
        ],
        cards=[
            FigureCard(
                image=ratios_figure(flexible),
                title="How far the gap stands out, by alternative",
                caption="Disagreement made by a gap of 0.2 mm on VERA over the noise of the "
                "sensors (blue), and over noise and the model's own error together (orange). "
                "Left of the line the gap is hidden.",
            ),
            inertia_card,
        ],
        equations=EQUATIONS,
        left_out=[
            "Estimating the parameters k from each model by least squares (3.4, 3.7): here they "
            "are known, and the question is how far the gap shows. The velocity term of the "
            "acceleration model (3.6) is in the simulated motion, but not in the model.",
            "Errors of the flexible model's own figures: it is given the true bending mode, so "
            "that its ratio is an upper bound.",
            "The link-to-link recursions of velocity and acceleration (3.5, 3.8) and the closed "
            "loop behind (3.12, 3.13): the simulation solves the whole equations of motion.",
            "The equations of motion of the loose arm as printed (3.37 to 3.42, 3.44 to 3.48) and "
            "the torque without potential loads (3.14): no function writes them out. MuJoCo "
            "integrates the arm with its seat; tests integrate the printed equations beside it.",
            "Mechanical friction of the joints beyond viscous damping: it would weigh most on "
            "the static-force alternative, whose ratio is therefore an upper bound.",
            "Noise of tracker, force sensor and drive torque is assumed, not taken from a "
            "measured sensor; the ratios scale with it.",
        ],
    )


def ratios_figure(compared: Sequence[Disagreement]) -> Figure:
    """Draw two bars an alternative: the gap over noise, and over noise and model error."""
    height = 0.52 * len(compared) + 0.75
    figure = new_figure(height)
    axes = figure.add_axes((0.03, 0.5 / height, 0.94, 1 - 0.62 / height))
    values = [r for w in compared for r in (w.against_noise, w.against_all)]
    low, high = 10 ** np.floor(np.log10(min(values))), 10 ** np.ceil(np.log10(max(values)))
    for k, w in enumerate(compared):
        y = -float(k)
        for ratio, shift, colour, word in (
            (w.against_noise, 0.11, MEASURED, "noise"),
            (w.against_all, -0.11, SHAKEN, "noise and model"),
        ):
            left, width = min(ratio, 1.0), abs(ratio - 1.0)
            axes.barh(y + shift, width, left=left, height=0.17, color=colour, zorder=2)
            if k == 0:
                axes.text(
                    max(w.against_noise, 1.0) * 1.15,
                    y + shift,
                    f"over {word}",
                    color=INK,
                    fontsize=8,
                    va="center",
                )
        axes.text(low, y + 0.23, w.name, color=INK, fontsize=9.5, va="bottom")
        axes.text(
            high,
            y + 0.23,
            f"{w.against_noise:.2g} and {w.against_all:.2g}",
            color=INK,
            fontsize=9.5,
            ha="right",
            va="bottom",
        )
        axes.plot([1.0, 1.0], [y - 0.24, y + 0.22], color=INK, linewidth=1.2, zorder=3)
    axes.set_xscale("log")
    axes.set(xlim=(low, high), ylim=(0.6 - len(compared), 0.62))
    axes.set_yticks([])
    ticks = 10.0 ** np.arange(np.log10(low), np.log10(high) + 0.5)
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    first, *_, last = axes.get_xticklabels()
    first.set_horizontalalignment("left")
    last.set_horizontalalignment("right")
    axes.minorticks_off()
    quiet_axes(axes, grid="x", spines=(), pad=6, size=9)
    axes.set_xlabel("disagreement from the gap, over the rest", color=MUTED, fontsize=9)
    return figure
