"""Chapters 4.2.3 and 8.2.3: manipulability ellipsoids, and poses chosen to load every seat."""

from __future__ import annotations

from typing import Any

import numpy as np

from loose_env.arms import Arm, planar, vera
from loose_env.kinematics import Chain, geometric_jacobian, reactions, wrench_rank
from loose_env.report import FigureCard
from loose_env.thesis.ch4_diagnosis.pose_figures import (
    EllipsoidPanel,
    comparison_figure,
    ellipsoid_figure,
    set_figure,
)
from loose_env.thesis.ch4_diagnosis.pose_trials import (
    RANDOM_SETS,
    SET,
    move_table,
    trial,
    trial_table,
    trial_words,
)
from loose_env.thesis.methods.motion.manipulability import (
    axis_difference_deg,
    direction_deg,
    ellipsoid,
    rotation_line,
)
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.sections import Section, Table

EQUATIONS: dict[str, str] = {}
"""Function of each equation; sections 4.2.3 and 8.2.3 number none."""

AGREES_DEG = 2.0
"""Largest difference from a printed direction that counts as agreement [deg]."""


def section(seed: int) -> Section:
    """Compare the printed ellipsoids and choose pose sets by section 4.2.3."""
    told = printed("pose_choice")
    ellipsoid_table, ellipsoid_words, panels = _ellipsoids(told)
    push_table, push_words = _thesis_poses(told)
    trials = [trial(arm, [seed, k]) for k, arm in enumerate((vera(), planar(4)))]
    return Section(
        key="pose_choice",
        title="Manipulability, and the choice of poses (4.2.3, 6.4.1, 8.2.3)",
        finding="Poses chosen by 4.2.3 drive the worst seat "
        + " and ".join(f"{t.gains[True, 'tool']:.2f} ({t.arm.name})" for t in trials)
        + " times as hard as random ones, per motion of the tool.",
        words=[*ellipsoid_words, *push_words, *trial_words(trials)],
        tables=[ellipsoid_table, push_table, trial_table(trials), move_table(trials)],
        cards=[
            FigureCard(
                image=ellipsoid_figure(vera(), panels),
                title="Kinematic manipulability in the five poses",
                caption="Frame of link 2, its y axis up; the dark dot is joint 1, the square the "
                "accelerometers. Titles in red: the printed major axis is not that of the "
                "ellipsoid.",
                heading="Poses",
            ),
            FigureCard(
                image=set_figure([(t.arm, t.poses, t.pushes) for t in trials]),
                title="Chosen pose sets",
                caption="The four poses chosen for each arm so that the least-pushed direction of "
                "the worst seat is pushed most, per energy, and the joints differ most (by the "
                "sine). Red: push of the last link's seat from each joint. Joint angles above.",
            ),
            FigureCard(
                image=comparison_figure([c for t in trials for c in t.comparisons]),
                title="Chosen against random",
                caption=f"Grey: mean drive of {RANDOM_SETS} random sets of {SET} poses, in the "
                "least-driven direction of the worst seat, over the excitation band of the linear "
                "arm. Red: set chosen per energy; blue: set chosen per torque.",
            ),
        ],
        equations=EQUATIONS,
        left_out=[
            "The gravity wrench of 4.2.3: VERA and the planar arm move across gravity, which so "
            "never loads a seat along the plane. arm_loads in "
            "loose_env.thesis.methods.motion.joint_loads has it for other arms.",
            "Three independent wrenches: in the plane there are two directions of looseness, so "
            "two are wanted. The functions take spatial arms.",
        ],
    )


def _ellipsoids(told: dict[str, Any]) -> tuple[Table, list[str], list[EllipsoidPanel]]:
    arm = vera()
    rows, panels, agree_p1, agree_major = [], [], 0, []
    leans = [
        abs(axis_difference_deg(_major(arm, np.radians(t)), 0.0)) for t in np.arange(1.0, 360.0)
    ]
    aspect = 0.0
    for k, theta in enumerate(told["theta2_deg"]):
        pose = np.radians([0.0, theta])
        found = ellipsoid(geometric_jacobian(Chain.of(arm, pose), "tool")[:2])
        line = rotation_line(arm, pose)
        major, p1 = direction_deg(found.axes[:, 0]), direction_deg(line)
        told_major, told_p1 = told["ellipsoid_major_axis_deg"][k], told["p1_line_deg"][k]
        off_major, off_p1 = axis_difference_deg(told_major, major), axis_difference_deg(told_p1, p1)
        same = abs(off_major) <= AGREES_DEG
        agree_p1 += abs(off_p1) <= AGREES_DEG
        if same:
            agree_major.append(theta)
        if k == 0:
            aspect = found.aspect
        rows.append(
            (
                f"{theta}°",
                f"{told_p1}",
                f"{_like(p1, told_p1):.1f}",
                f"{told_major}" if same else f"{told_major} (slip)",
                f"{_like(major, told_major):.1f}",
                f"{off_major:+.1f}",
                f"{found.aspect:.2f}",
            )
        )
        tilt = np.radians(told_major)
        panels.append(
            EllipsoidPanel(
                title=f"θ₂ = {theta}°" + ("" if same else f": printed {told_major}°"),
                pose=pose,
                half_axes=found.axes * found.lengths,
                line=line,
                printed=np.array([-np.sin(tilt), np.cos(tilt)]),
                agrees=same,
            )
        )
    table = Table(
        caption="Directions in the frame of link 2 [deg], counter-clockwise from its y axis, "
        "modulo 180°: line in which joint 1 moves the tool, and major axis of the kinematic "
        f"ellipsoid (6.4.1). A slip is a printed direction more than {AGREES_DEG:g}° off.",
        columns=("θ₂", "line, printed", "here", "major axis, printed", "here", "off by", "aspect"),
        rows=tuple(rows),
    )
    count = len(rows)
    slips = [
        (t, p)
        for t, p in zip(told["theta2_deg"], told["ellipsoid_major_axis_deg"], strict=True)
        if t not in agree_major
    ]
    words = (
        "For each pose of experiment five the thesis prints two directions that follow from the "
        "arm's geometry alone: the line in which joint 1 moves the tool, z × R, and the major axis "
        "of the kinematic manipulability ellipsoid. Counted counter-clockwise from link 2's y "
        f"axis, the line agrees in {agree_p1} of {count} poses (within {AGREES_DEG:g}°; for equal "
        f"links it is −θ₂/2), the ellipsoid in {len(agree_major)} of {count}. "
    )
    if slips:
        told_leans = [abs(axis_difference_deg(p, 0.0)) for _, p in slips]
        words += "The others are " + " and ".join(f"{p}° at θ₂ = {t}°" for t, p in slips)
        if min(told_leans) > max(leans):
            words += (
                ". They belong to no pose of an arm with equal links: its major axis never leans "
                f"more than {max(leans):.0f}° from the y axis, and these lean "
                + " and ".join(f"{lean:.0f}°" for lean in told_leans)
                + ", so they are slips of the source"
            )
        words += ". "
    words += (
        f"The aspect of {told['ellipsoid_aspect_case_1']:g}:1 that it prints for the first pose is "
        f"{aspect:.1f}:1 here."
    )
    return table, [words], panels


def _major(arm: Arm, theta: float) -> float:
    jacobian = geometric_jacobian(Chain.of(arm, [0.0, theta]), "tool")[:2]
    return direction_deg(ellipsoid(jacobian).axes[:, 0])


def _like(angle: float, example: float) -> float:
    """The end of an axis that lies nearer to an example [deg]."""
    return float((example - axis_difference_deg(example, angle)) % 360)


def _thesis_poses(told: dict[str, Any]) -> tuple[Table, list[str]]:
    arm, link = vera(), told["looseness_link"] - 1
    slope = np.radians(told["looseness_deg"])
    slide = np.array([-np.sin(slope), np.cos(slope)])
    rows, shares, ranks = [], [], []
    for theta in told["theta2_deg"]:
        found = reactions(arm, np.radians([0.0, theta]))
        push = found.per_energy[link]
        one = push[:2, 0]
        # The reciprocal product of push and slide is the power of the one on the other.
        shares.append(abs(float(one @ slide)) / float(np.linalg.norm(one)))
        rank, values = wrench_rank(push[:2])
        ranks.append(rank)
        rows.append(
            (
                f"{theta}°",
                f"{direction_deg(one) % 180:.0f}",
                f"{100 * shares[-1]:.0f} %",
                str(rank),
                f"{values[-1]:.2f}",
            )
        )
    table = Table(
        caption="Push of link 2's seat in the thesis's poses: direction of the push from joint 1 "
        "[deg from y, modulo 180°], its share along the looseness at "
        f"{told['looseness_deg']}°, number of independent pushes from both joints, and the push in "
        "the direction least pushed [√kg, per root of twice the energy of link 2].",
        columns=("θ₂", "from joint 1", "along looseness", "independent", "least"),
        rows=tuple(rows),
    )
    least = int(np.argmin(shares))
    errors = np.abs(told["direction_error_deg"])
    weak = np.argsort(shares)[:2]
    strong = np.argsort(shares)[2:]
    words = (
        "A seat is loaded by what lies beyond it: a torque at a joint accelerates that part, and "
        "the seat has to push it. Looseness moves only if the push has a part along it; the "
        "reciprocal product of push and looseness twist is zero otherwise. Section 4.2.3 asks for "
        f"{told['reciprocal_wrenches_wanted']} reciprocal wrenches; what it needs, by its own next "
        "sentence, is as many independent wrenches, so that no looseness is reciprocal to all of "
        f"them. With joint 1 alone, the thesis's five poses load its looseness with "
        f"{100 * min(shares):.0f} to {100 * max(shares):.0f} % of the push, least at θ₂ = "
        f"{told['theta2_deg'][least]}°. The two poses with the smallest share "
        + ("are" if errors[weak].min() > errors[strong].max() else "are not")
        + " those in which the thesis found the direction worst "
        f"({' and '.join(f'{e:.0f}°' for e in errors[weak])} off, the others "
        f"{errors[strong].min():.0f}° to {errors[strong].max():.0f}°); {len(shares)} poses are too "
        "few for more than a hint. With both joints in turn, "
        f"{sum(r == 2 for r in ranks)} of {len(ranks)} poses load every direction in the plane."
    )
    return table, [words]
