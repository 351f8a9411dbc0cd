"""Manipulability ellipsoids and pushes on the loose seat in the poses of Experiment Five.

Directions are in the frame of the tool, from its y axis as in the thesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import Arm, LinearArm, vera
from loose_env.envs import EDGE, INK, MEASURED, TRUTH
from loose_env.kinematics import reactions, wrench_rank
from loose_env.typing import Array
from scripts.charts import DASHED, Panel, axis, chart, curve, points
from scripts.thesis.page import Section, printed, section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AGREES_DEG = 2.0
"""Largest difference from a printed direction that counts as agreement [deg]."""


def direction_deg(vector: ArrayLike) -> float:
    """Angle of a vector (2,) from the y axis, counter-clockwise as in the thesis [deg], to 360."""
    x, y = np.asarray(vector, dtype=float)
    return float(np.degrees(np.arctan2(-x, y)) % 360)


def axis_difference_deg(a: float, b: float) -> float:
    """Signed difference of two undirected axes, a - b, from -90 to 90 [deg]."""
    return float((a - b + 90) % 180 - 90)


def pose_choice(seed: int) -> Section:
    """Compare the printed ellipsoids, and the pushes on the loose seat with the printed errors."""
    told, arm = printed("pose_choice"), vera()
    linear = LinearArm(arm)

    def ellipsoid(theta2: float) -> tuple[Array, Array]:
        """Half axes of the kinematic manipulability ellipsoid, longest first; in columns."""
        axes, lengths, _ = np.linalg.svd(linear.at(np.radians([0.0, theta2])).kinematic)
        return lengths, axes

    def like(angle: float, example: float) -> str:
        """The end of an axis that lies nearer to an example."""
        return f"{(example - axis_difference_deg(example, angle)) % 360:.1f}"

    ellipsoid_rows, places, agree_line, slips = [], [], 0, []
    for theta, major, line in zip(
        told["theta2_deg"], told["ellipsoid_major_axis_deg"], told["p1_line_deg"], strict=True
    ):
        pose, (lengths, axes) = np.radians([0.0, theta]), ellipsoid(theta)
        column = linear.at(pose).kinematic[:, 0]
        moved = column / np.linalg.norm(column)
        here, here_line = direction_deg(axes[:, 0]), direction_deg(moved)
        off = axis_difference_deg(major, here)
        same = abs(off) <= AGREES_DEG
        agree_line += abs(axis_difference_deg(line, here_line)) <= AGREES_DEG
        if not same:
            slips.append((theta, major, abs(axis_difference_deg(major, 0.0))))
        told_axis, ratio = f"{major}" + " (slip)" * (not same), lengths[0] / lengths[1]
        ellipsoid_rows.append(
            (theta, line, like(here_line, line), told_axis, like(here, major), off, ratio)
        )
        tilt, slip = np.radians(major), "" if same else f": printed {major}°"
        said = np.array([-np.sin(tilt), np.cos(tilt)])
        places.append((f"θ₂ = {theta}°{slip}", pose, axes * lengths, moved, said))
    n_agree, aspect = len(places) - len(slips), ellipsoid_rows[0][-1]
    lean = max(
        abs(axis_difference_deg(direction_deg(ellipsoid(t)[1][:, 0]), 0.0))
        for t in np.arange(1.0, 360.0)
    )

    link, slope = told["looseness_link"] - 1, np.radians(told["looseness_deg"])
    push_rows, shares, ranks = [], [], []
    for theta in told["theta2_deg"]:
        push = reactions(arm, np.radians([0.0, theta])).per_energy[link]
        one = push[:2, 0]
        # The reciprocal product of push and slide is the power of the one on the other.
        along = abs(float(one @ np.array([-np.sin(slope), np.cos(slope)])))
        shares.append(along / float(np.linalg.norm(one)))
        rank, values = wrench_rank(push[:2])
        ranks.append(rank)
        push_rows.append((theta, direction_deg(one) % 180, shares[-1], rank, values[-1]))
    least, most, order = min(shares), max(shares), np.argsort(shares)
    worst_pose = told["theta2_deg"][order[0]]
    errors = np.abs(told["direction_error_deg"])[order]
    others, full = (errors[2:].min(), errors[2:].max()), sum(rank == 2 for rank in ranks)

    return section(
        "pose_choice",
        locals(),
        [ellipsoid_rows, push_rows],
        [ellipsoid_figure(arm, places)],
    )


def ellipsoid_figure(arm: Arm, shown: Sequence[tuple[str, Array, Array, Array, Array]]) -> Figure:
    """Draw the arm and its manipulability ellipsoid in the tool frame, y up, a panel a pose.

    Shown are a title, the pose, the half axes in columns [m] (2, 2), the direction in which joint 1
    moves the tool (2,), and the printed one of the major axis (2,).
    """
    turn, length = np.linspace(0, 2 * np.pi, 121), 0.36 * arm.reach
    panels = []
    for title, pose, half_axes, line, said in shown:
        data = mujoco.MjData(arm.model)
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_kinematics(arm.model, data)
        tool = data.site(arm.tool)
        joints = [data.joint(name).xanchor for name in arm.joints]
        links = ((np.array([*joints, tool.xpos]) - tool.xpos) @ tool.xmat.reshape(3, 3)).T[:2]
        small = half_axes / 3
        x, y = small @ np.array([np.cos(turn), np.sin(turn)])
        major = small[:, 0] / np.linalg.norm(small[:, 0])
        dotted = (0, (1.2, 1.2))
        curves = [
            curve(*links, color="#8e9aa6", linewidth=4, solid_capstyle="round"),
            points(*links[:, :-1], color="white", markeredgecolor=EDGE),
            points(links[0, -1:], links[1, -1:], marker="s", color=EDGE, markersize=4),
            points(*links[:, :1], color=EDGE),
            curve(x, y, "ellipsoid", color=MEASURED),
            axis(length * major, "its major axis", color=MEASURED, linewidth=1.1),
            axis(length * said, "major axis, printed", color=TRUTH, linestyle=DASHED),
            axis(length * line, "line of joint 1", color=INK, linestyle=dotted),
        ]
        panels.append(Panel(title=title, curves=curves))
    return chart(panels, columns=3, height=1.6, bare=True)
