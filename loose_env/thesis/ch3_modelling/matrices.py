"""Effect of a loose seat on the Jacobian and on the inertia matrix (3.2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from loose_env.arms import planar, vera
from loose_env.envs import FAINT, INK, MEASURED, MUTED, SHAKEN
from loose_env.faults import Backlash, Healthy, StructuralLooseness
from loose_env.kinematics import Chain, Frame, geometric_jacobian
from loose_env.report import FigureCard, new_figure, quiet_axes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

from loose_env.thesis.ch3_modelling.alternatives import POSES, loose_seat
from loose_env.thesis.methods.looseness.looseness_joint import (
    backlash_condition,
    changed_columns,
    condition_of,
    displaced,
    insert_looseness,
    link_of_changed_columns,
    seated_inertia,
)
from loose_env.thesis.rigs.slide import LOOSE_GAP
from loose_env.thesis.shared.sections import Table

_FRAMES: tuple[tuple[Frame, str], ...] = (
    ("tool", "tool point, tool axes"),
    ("world", "tool point, world axes"),
    ("base", "world origin, world axes"),
)
_INERTIA_POSES = 20


def jacobian_columns() -> tuple[Table, str]:
    """Show which columns of the Jacobian a seat at its stop changes, in three frames (3.33)."""
    chain = Chain.of(planar(4), [0.2, 0.5, -0.8, 0.6])
    rows, right, world_distal, base_proximal = [], 0, True, True
    largest = 0.0
    for link in range(1, chain.n + 1):
        loose = displaced(chain, link, [0.6, 0.8, 0.0], LOOSE_GAP / 2)
        cells = [str(link)]
        for frame, _ in _FRAMES:
            before, after = geometric_jacobian(chain, frame), geometric_jacobian(loose, frame)
            changed = changed_columns(before, after, tolerance=1e-9)
            cells.append(", ".join(str(k + 1) for k in np.flatnonzero(changed)) or "none")
            if frame == "tool":
                right += link_of_changed_columns(changed, frame) == link
                moved, whole = (after - before)[:3], before[:3]
                share = np.linalg.norm(moved, axis=0) / np.linalg.norm(whole, axis=0)
                largest = max(largest, float(share.max()))
            if frame == "base":
                base_proximal &= not changed[:link].any()
            if frame == "world":
                world_distal &= bool(changed[:link].all() and not changed[link:].any())
        rows.append(tuple(cells))
    words = (
        f"A seat that stands at its stop, {LOOSE_GAP / 2 * 1e3:g} mm off, changes columns of the "
        "Jacobian. In tool coordinates the columns beyond the seat stay, as the thesis says, and "
        f"the last column that changes names the link ({right} of {chain.n} here). For world "
        "coordinates the thesis says that the columns before the seat stay (3.33). That is so "
        "for their axes"
        + (", and for the twist at the world's origin; " if base_proximal else "; ")
        + (
            "for the velocity of the tool point, which (3.29) gives, a slide does the opposite: "
            "the columns before it change, because the tool point moves, and those beyond stay. "
            if world_distal
            else "at the tool point the columns change without such an order. "
        )
        + f"The largest change of a column's linear part is {100 * largest:.2g} %: the Jacobian "
        "must be known better than that to find the link this way."
    )
    return (
        Table(
            caption="Columns that change when the seat of a link stands at its stop; planar arm "
            "of four links (3.33).",
            columns=("loose link", *(name for _, name in _FRAMES)),
            rows=tuple(rows),
        ),
        words,
    )


def jacobian_ranks(told: dict[str, object]) -> tuple[Table, str]:
    """Count the motions that a slide and play in a joint add, beside the printed counts."""
    rows, gains = [], {}
    for n in (2, 3, 4):
        chain = Chain.of(planar(n), np.linspace(0.3, 0.9, n))
        rank = [
            int(np.linalg.matrix_rank(geometric_jacobian(c)[[0, 1, 5]]))
            for c in (
                chain,
                insert_looseness(chain, n, [0.6, 0.8, 0.0]),
                insert_looseness(chain, n, [0, 0, 1], kind="revolute"),
            )
        ]
        gains[n] = (rank[1] - rank[0], rank[2] - rank[0])
        added = f"+{told['rank_added_by_slide']}" if n == 2 else "not said"
        rows.append((f"{n} joints", *map(str, rank), added, f"+{told['rank_added_by_backlash']}"))
    full = [n for n, gain in gains.items() if gain[0] == 0]
    words = (
        "A slide may add a dimension to the tool's motion, play in a joint adds none: with two "
        f"joints the rank grows by {gains[2][0]} and {gains[2][1]} (printed: "
        f"{told['rank_added_by_slide']} and {told['rank_added_by_backlash']})."
        + (
            f" With {' and '.join(map(str, full))} joints a planar arm has all three motions "
            "already, and the rank says nothing."
            if full
            else ""
        )
    )
    return (
        Table(
            caption="Rank of the planar Jacobian: nominal, with a slide, with play in a joint.",
            columns=("arm", "nominal", "slide", "play", "printed: slide", "printed: play"),
            rows=tuple(rows),
        ),
        words,
    )


def inertia_condition(seed: int, told: dict[str, object]) -> tuple[Table, str, FigureCard]:
    """Compare the condition of the inertia matrix with a slide and with play in a joint."""
    rows, points = [], []
    worst = {"slide": 0.0, "play": 0.0}
    for a, arm in enumerate((planar(4), vera())):
        rng = np.random.default_rng([seed, 100 + a])
        poses = [arm.random_pose(rng) for _ in range(_INERTIA_POSES)]
        nominal = [condition_of(seated_inertia(arm, q, Healthy())) for q in poses]
        rows.append((f"{arm.name}, nothing loose", *_medians(nominal), "–"))
        for link in range(1, arm.n + 1):
            slide = StructuralLooseness(
                link=link, direction=(0.6, 0.8, 0.0), gap=LOOSE_GAP, stiffness=(1e5, 1e5)
            )
            found = [condition_of(seated_inertia(arm, q, slide)) for q in poses]
            worst["slide"] = max(worst["slide"], float(np.median([c.scaled for c in found])))
            rows.append((f"{arm.name}, slide at link {link}", *_medians(found), "–"))
        for joint in range(1, arm.n + 1):
            play = Backlash(joint=joint, gap=1e-4, stiffness=(1e4, 1e4))
            matrices = [seated_inertia(arm, q, play) for q in poses]
            found = [condition_of(m) for m in matrices]
            worst["play"] = max(worst["play"], float(np.median([c.scaled for c in found])))
            ratio = float(np.median([m[joint - 1, joint - 1] / m[-1, -1] - 1 for m in matrices]))
            points.append((arm.name, joint, ratio))
            rows.append((f"{arm.name}, play in joint {joint}", *_medians(found), f"{ratio:.2g}"))
    low = min(r for *_, r in points)
    q = np.array([0.3, POSES[1]])
    sizes = [len(seated_inertia(vera(), q, fault)) for fault in (Healthy(), loose_seat())]
    direct = backlash_condition(low / 100)
    agrees = worst["play"] > worst["slide"]
    words = (
        f"With a seat the inertia matrix of two joints grows from {told['inertia_size_nominal']} "
        f"rows to {told['inertia_size_loose']} (printed), here from {sizes[0]} to {sizes[1]}. "
        "The thesis expects it to be "
        "ill-conditioned for backlash, because a motor has little inertia against its link. The "
        "plain condition number mixes kg and kg·m² and changes with the unit of length, so the "
        "matrix is also scaled to a unit diagonal. Largest median of the scaled figure: "
        f"{worst['play']:.0f} with play, {worst['slide']:.0f} with a slide"
        + (": the order is the thesis's. " if agrees else ": not the order the thesis expects. ")
        + "What decides is the motor side seen through its gear, which multiplies the rotor's "
        f"inertia by the square of the ratio: the motor sides here are {low:.2g} and more of "
        "their links, and one joint with such play has a condition of at most "
        f"{max(backlash_condition(r) for *_, r in points):.0f}; with a tenth of "
        f"the gear ratio it would be up to {direct:.0f}. As an indicator the number needs the "
        "acceleration of the seat itself, which no sensor of the arm gives."
    )
    card = FigureCard(
        image=condition_figure(points),
        title="Condition with play in one joint",
        caption="Scaled condition number of one joint with play against the inertia of its motor "
        "side over that of its link side (line, closed form), and where the joints of the two "
        "arms lie on it.",
    )
    return (
        Table(
            caption=f"Condition number of the inertia matrix, medians over {_INERTIA_POSES} "
            "random poses (3.2.2).",
            columns=("arm and seat", "in SI units", "scaled", "motor over link"),
            rows=tuple(rows),
        ),
        words,
        card,
    )


def _medians(found: Sequence[object]) -> tuple[str, str]:
    raw = float(np.median([c.raw for c in found]))  # type: ignore[attr-defined]
    scaled = float(np.median([c.scaled for c in found]))  # type: ignore[attr-defined]
    return f"{raw:.0f}", f"{scaled:.3g}"


def condition_figure(points: Sequence[tuple[str, int, float]]) -> Figure:
    """Draw the closed form of `backlash_condition` and where the joints of the arms lie.

    Each point is an arm ("planar4" or "vera"), a joint, and its motor side over its link side.
    """
    figure = new_figure(2.9)
    axes = figure.add_axes((0.12, 0.17, 0.84, 0.72))
    ratio = np.logspace(-3, 2, 200)
    axes.plot(ratio, [backlash_condition(r) for r in ratio], color=MUTED, linewidth=1.8, zorder=2)
    for name, colour, marker, side in (("planar4", MEASURED, "o", 1), ("vera", SHAKEN, "s", -1)):
        own = [(j, r) for n, j, r in points if n == name]
        axes.plot(
            [r for _, r in own],
            [backlash_condition(r) for _, r in own],
            linestyle="none",
            marker=marker,
            markersize=6,
            color=colour,
            zorder=3,
        )
        middle = float(np.exp(np.mean([np.log(r) for _, r in own])))
        at = backlash_condition(middle)
        axes.annotate(
            f"joints of {'VERA' if name == 'vera' else 'the four-link arm'}",
            xy=(middle, at),
            xytext=(middle * (2.2 if side > 0 else 1 / 3), at * (6 if side > 0 else 1 / 3.2)),
            color=INK,
            fontsize=9,
            ha="left" if side > 0 else "right",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 1.0},
        )
    axes.set(xscale="log", yscale="log", xlim=(1e-3, 1e2), ylim=(1, 1e4))
    axes.grid(color=FAINT, linewidth=0.8)
    # Plain numbers: the exponents of a power of ten are too small to read.
    ratios, conditions = 10.0 ** np.arange(-3, 3), 10.0 ** np.arange(5)
    axes.set_xticks(ratios, [f"{r:g}" for r in ratios])
    axes.set_yticks(conditions, [f"{c:.0f}" for c in conditions])
    axes.minorticks_off()
    quiet_axes(axes, grid="y", spines=(), pad=6, size=9)
    axes.set_xlabel("inertia of motor side over link side", color=MUTED, fontsize=9)
    axes.text(0.0, 1.04, "condition", color=MUTED, fontsize=9, transform=axes.transAxes)
    return figure
