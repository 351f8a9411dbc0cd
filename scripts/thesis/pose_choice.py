"""Manipulability ellipsoids, and pose sets chosen to load every seat beside random sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Literal, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import spearmanr

from loose_env.arms import Arm, LinearArm, planar, vera
from loose_env.envs import EDGE, FAINT, INK, MEASURED, TRUTH
from loose_env.kinematics import (
    Chain,
    chebyshev_poses,
    choose_poses,
    geometric_jacobian,
    reactions,
    worst_push,
    wrench_rank,
)
from loose_env.typing import Array
from scripts.charts import DASHED, Curve, Panel, axis, chart, curve, drawing, points
from scripts.thesis.loose_joint import mass_matrix, placed
from scripts.thesis.page import Section, printed, section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AGREES_DEG = 2.0
"""Largest difference from a printed direction that counts as agreement [deg]."""
SET = 4
"""Poses in a set."""
RANDOM_POSES = 240
"""Poses drawn over the joints' ranges for comparison."""
RANDOM_SETS = 4000
"""Sets drawn from those."""
_POINTS = {2: 25, 4: 6}  # Chebyshev points a joint, by the number of joints
Drive = Literal["torque", "tool"]
"""Unit of drive: 1 N m rms at each joint, or 1 m/s² rms at the tool from each joint."""
_PER: tuple[tuple[Drive, str], ...] = (("tool", "1 m/s² at the tool"), ("torque", "1 N·m"))
_LINK = "#8e9aa6"


class Ellipsoid(NamedTuple):
    """Manipulability ellipsoid: half axes, longest first (d,), their directions in columns."""

    lengths: Array
    axes: Array


def ellipsoid(jacobian: ArrayLike, inertia: ArrayLike | None = None) -> Ellipsoid:
    """Manipulability ellipsoid of linear rows of a Jacobian, plain or weighted by energy (8.2.3).

    Plain, it is the image of joint rates with |q'| = 1: axes of J Jᵀ. With an inertia matrix it
    is the image of rates with q'ᵀ M q' = 1, of equal kinetic energy: axes of J M⁻¹ Jᵀ.
    """
    j = np.asarray(jacobian, dtype=float)
    if inertia is not None:
        root = np.linalg.cholesky(np.asarray(inertia, dtype=float))
        j = np.linalg.solve(root, j.T).T  # J L⁻ᵀ, so that its square is J M⁻¹ Jᵀ
    axes, lengths, _ = np.linalg.svd(j, full_matrices=True)
    full = np.zeros(j.shape[0])
    full[: len(lengths)] = lengths
    return Ellipsoid(full, axes)


def direction_deg(vector: ArrayLike) -> float:
    """Angle of a vector (2,) from the y axis, counter-clockwise as in the thesis [deg], to 360."""
    x, y = np.asarray(vector, dtype=float)
    return float(np.degrees(np.arctan2(-x, y)) % 360)


def axis_difference_deg(a: float, b: float) -> float:
    """Signed difference of two undirected axes, a - b, from -90 to 90 [deg]."""
    return float((a - b + 90) % 180 - 90)


def rotation_line(arm: Arm, pose: ArrayLike) -> Array:
    """Direction of tool motion due to joint 1, z × R, in the tool frame (d,)."""
    column = geometric_jacobian(Chain.of(arm, pose), "tool")[list(arm.axes), 0]
    return np.asarray(column / np.linalg.norm(column))


def submanipulator(arm: Arm, pose: ArrayLike, link: int) -> Ellipsoid:
    """Energy-weighted ellipsoid of the proximal part that carries a link, J M⁻¹ Jᵀ (8.2.3).

    Joints 1 to ``link`` move; everything distal to them is locked and rides along. The point is
    the centre of mass of the distal segment, which the seat has to drive, in the link's axes.
    """
    data, model = placed(arm, pose), arm.model
    body = model.body(arm.seat_bodies[link - 1]).id
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, data.subtree_com[body], body)
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.joints[:link]]
    frame = data.xmat[body].reshape(3, 3)
    rows = (frame.T @ jacobian)[list(arm.axes)][:, dofs]
    return ellipsoid(rows, mass_matrix(model, data, arm.joints)[:link, :link])


def seat_drive(
    linear: LinearArm, pose: Array, link: int, *, per: Drive = "torque"
) -> tuple[float, float]:
    """Force transmitted by a link's slide in the linear arm: worst direction and total."""
    arm = linear.arm
    at = linear.at(np.asarray(pose, dtype=float))
    power = np.zeros((len(arm.axes),) * 2)
    for joint in range(arm.n):
        answer = at.response(np.arange(arm.n) == joint)
        force = answer.slide[:, arm.link_number(link) - 1, :, 0]
        level = 1.0
        if per == "tool":
            level = float(np.sum(np.abs(answer.tool[:, :, 0]) ** 2)) / len(force)
        power += np.real(force.T @ force.conj()) / (len(force) * level)
    values = np.linalg.eigvalsh(power)
    return float(np.sqrt(max(0.0, values[0]))), float(np.sqrt(values.sum()))


def _worst(linear: LinearArm, pose: Array, per: Drive) -> float:
    return min(seat_drive(linear, pose, k, per=per)[0] for k in range(1, linear.arm.n + 1))


Comparison = tuple[Array, Sequence[tuple[str, float]]]
"""Mean drive of each random set (S,), and name and mean drive of each chosen one, in one unit."""


def trial(arm: Arm, seed: list[int]) -> SimpleNamespace:
    """Choose sets per energy and per torque and set their drive beside that of random sets.

    By score and drive: share of random sets driven less, drive over that of random poses, and rank
    correlation of the score with it; by drive: that of the proximal ellipsoid's shorter axis with
    the last seat's drive; by difference: smallest |sin| of a move in the set chosen per energy.
    """
    rng = np.random.default_rng(seed)
    linear = LinearArm(arm, remember=4)
    candidates = chebyshev_poses(arm, _POINTS[arm.n])
    drawn = np.array([arm.random_pose(rng) for _ in range(RANDOM_POSES)])
    groups = rng.integers(0, RANDOM_POSES, (RANDOM_SETS, SET))
    chosen, scores_drawn, moves, rows = {}, {}, [], []
    comparisons: dict[str, Comparison] = {}
    wins, gains, follows, least_sine = {}, {}, {}, {}
    proximal: dict[str, float] = {}
    for by in ("energy", "torque"):
        scores, scores_drawn[by] = (
            np.array([worst_push(arm, q, normalised=by == "energy") for q in poses])
            for poses in (candidates, drawn)
        )
        for difference in ("angle", "sine"):
            picked = candidates[choose_poses(candidates, scores, SET, difference=difference)]
            chosen[by] = picked  # that by the sine stays
            first, second = np.triu_indices(SET, 1)
            angle = np.abs((picked[first] - picked[second] + np.pi) % (2 * np.pi) - np.pi)
            sine = float(np.abs(np.sin(angle)).min())
            if by == "energy":
                least_sine[difference] = sine
            moves.append((arm.name, by, difference, angle.min(), angle.mean(), sine))
    narrow = [submanipulator(arm, q, arm.n).lengths[-1] for q in drawn]
    for per, unit in _PER:
        drive = np.array([_worst(linear, q, per) for q in drawn])
        sets = drive[groups].mean(axis=1)
        marks = []
        for by, picked in chosen.items():
            own = float(np.mean([_worst(linear, q, per) for q in picked]))
            key = f"{by} {per}"
            wins[key] = float((sets < own).mean())
            gains[key] = own / float(drive.mean())
            follows[key] = float(spearmanr(scores_drawn[by], drive).statistic)
            marks.append((f"per {by}", own))
            scores_of = (gains[key], wins[key], follows[key])
            rows.append((arm.name, by, unit, drive.mean(), own, *scores_of))
        last = [seat_drive(linear, q, arm.n, per=per)[0] for q in drawn]
        proximal[per] = float(spearmanr(narrow, last).statistic)
        comparisons[f"{arm.name}, per {unit}"] = (sets, marks)
    pushes = np.array([reactions(arm, q).per_energy[-1, :2] for q in chosen["energy"]])
    return SimpleNamespace(
        arm=arm,
        candidates=len(candidates),
        poses=chosen["energy"],
        pushes=pushes,
        rows=rows,
        moves=moves,
        wins=wins,
        gains=gains,
        follows=follows,
        proximal=proximal,
        least_sine=least_sine,
        comparisons=comparisons,
    )


def pose_choice(seed: int) -> Section:
    """Compare the printed ellipsoids and choose pose sets by section 4.2.3."""
    told, arm = printed("pose_choice"), vera()

    def plain(theta2: float) -> Ellipsoid:
        return ellipsoid(geometric_jacobian(Chain.of(arm, np.radians([0.0, theta2])), "tool")[:2])

    def like(angle: float, example: float) -> str:
        """The end of an axis that lies nearer to an example."""
        return f"{(example - axis_difference_deg(example, angle)) % 360:.1f}"

    ellipsoid_rows, places, agree_line, slips = [], [], 0, []
    for theta, major, line in zip(
        told["theta2_deg"], told["ellipsoid_major_axis_deg"], told["p1_line_deg"], strict=True
    ):
        pose, found = np.radians([0.0, theta]), plain(theta)
        moved = rotation_line(arm, pose)
        here, here_line = direction_deg(found.axes[:, 0]), direction_deg(moved)
        off = axis_difference_deg(major, here)
        same = abs(off) <= AGREES_DEG
        agree_line += abs(axis_difference_deg(line, here_line)) <= AGREES_DEG
        if not same:
            slips.append((theta, major, abs(axis_difference_deg(major, 0.0))))
        told_axis, ratio = f"{major}" + " (slip)" * (not same), found.lengths[0] / found.lengths[1]
        ellipsoid_rows.append(
            (theta, line, like(here_line, line), told_axis, like(here, major), off, ratio)
        )
        tilt, slip = np.radians(major), "" if same else f": printed {major}°"
        said = np.array([-np.sin(tilt), np.cos(tilt)])
        places.append((f"θ₂ = {theta}°{slip}", pose, found.axes * found.lengths, moved, said))
    n_agree, lengths = len(places) - len(slips), plain(told["theta2_deg"][0]).lengths
    aspect = lengths[0] / lengths[1]
    lean = max(
        abs(axis_difference_deg(direction_deg(plain(t).axes[:, 0]), 0.0))
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

    trials = [trial(each, [seed, k]) for k, each in enumerate((arm, planar(4)))]
    one_arm, other_arm = trials
    return section(
        "pose_choice",
        locals(),
        [
            ellipsoid_rows,
            push_rows,
            [row for t in trials for row in t.rows],
            [row for t in trials for row in t.moves],
        ],
        [
            ellipsoid_figure(arm, places),
            set_figure([(t.arm, t.poses, t.pushes) for t in trials]),
            comparison_figure(one_arm.comparisons | other_arm.comparisons),
        ],
    )


def ellipsoid_figure(
    arm: Arm, shown: Sequence[tuple[str, Array, Array, Array, Array]], *, columns: int = 3
) -> Figure:
    """Draw the arm and its manipulability ellipsoid in the tool frame, y up, a panel a pose.

    Shown are a title, the pose, the half axes in columns [m] (2, 2), the direction in which joint 1
    moves the tool (2,), and the printed one of the major axis (2,).
    """
    turn, length = np.linspace(0, 2 * np.pi, 121), 0.36 * arm.reach
    panels = []
    for title, pose, half_axes, line, said in shown:
        chain = Chain.of(arm, pose)
        world = np.vstack([chain.anchors, chain.tool])
        small = half_axes / 3
        x, y = small @ np.array([np.cos(turn), np.sin(turn)])
        major = small[:, 0] / np.linalg.norm(small[:, 0])
        dotted = (0, (1.2, 1.2))
        curves = [
            *_arm(((world - chain.tool) @ chain.tool_axes)[:, :2]),
            curve(x, y, "ellipsoid", color=MEASURED),
            axis(length * major, "its major axis", color=MEASURED, linewidth=1.1),
            axis(length * said, "major axis, printed", color=TRUTH, linestyle=DASHED),
            axis(length * line, "line of joint 1", color=INK, linestyle=dotted),
        ]
        panels.append(Panel(title=title, curves=curves))
    return chart(panels, columns=columns, height=1.6, bare=True)


def set_figure(arms: Sequence[tuple[Arm, Array, Array]]) -> Figure:
    """Draw the chosen poses, a row an arm, with the pushes on the last link's seat."""
    panels = []
    for arm, poses, pushes in arms:
        for pose, push in zip(poses, pushes, strict=True):
            chain = Chain.of(arm, pose)
            points_of = np.vstack([chain.anchors, chain.tool])[:, :2]
            size = 0.3 * arm.reach / float(np.linalg.norm(push, axis=0).max())
            seat = points_of[-2]
            ends = seat + size * (chain.tool_axes[:2, :2] @ push).T
            arrows = [curve([seat[0], x], [seat[1], y], "push", color=TRUTH) for x, y in ends]
            angles = [f"{a:.0f}°".replace("-", "−") for a in np.degrees(pose)]
            lines = [", ".join(angles[k : k + 2]) for k in range(0, len(angles), 2)]
            panels.append(Panel(title="\n".join(lines), curves=[*_arm(points_of), *arrows]))
    columns = max(len(poses) for _, poses, _ in arms)
    return chart(panels, columns=columns, height=1.7, bare=True)


def comparison_figure(comparisons: Mapping[str, Comparison], *, columns: int = 2) -> Figure:
    """Draw the spread of random sets' drive and mark the chosen sets on it."""
    panels = []
    for title, (drawn, chosen) in comparisons.items():
        unit = float(drawn.mean())
        counts, edges = np.histogram(drawn / unit, bins=24)
        spread = drawing("stairs", counts / counts.max(), edges, color=FAINT, fill=True)
        own = [
            curve([value / unit] * 2, [0, 1.2], name, color=(TRUTH, MEASURED)[k % 2], linewidth=1.8)
            for k, (name, value) in enumerate(chosen)
        ]
        panels.append(
            Panel(title=title, curves=[spread, *own], look={"yticks": [], "xlim": (0, None)})
        )
    return chart(panels, across="drive over the mean of random poses", columns=columns, height=1.4)


def _arm(joints: Array) -> list[Curve]:
    """Links, joints and tool of an arm, base first (n + 1, 2)."""
    x, y = joints.T
    return [
        curve(x, y, color=_LINK, linewidth=4, solid_capstyle="round"),
        points(x[:-1], y[:-1], color="white", markeredgecolor=EDGE),
        points(x[-1:], y[-1:], marker="s", color=EDGE, markersize=4),
        points(x[:1], y[:1], color=EDGE),
    ]
