"""Pose sets chosen by section 4.2.3 against sets drawn at random, in the linear arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import spearmanr

from loose_env.arms import Arm, LinearArm
from loose_env.kinematics import chebyshev_poses, choose_poses, reactions, worst_push
from loose_env.thesis.ch4_diagnosis.pose_figures import Comparison
from loose_env.thesis.methods.motion.manipulability import submanipulator
from loose_env.thesis.shared.sections import Table
from loose_env.typing import Array

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Chosen and random pose sets of one arm."""

    arm: Arm
    candidates: int
    poses: Array
    pushes: Array
    rows: Sequence[tuple[str, ...]]
    wins: dict[tuple[bool, Drive], float]
    gains: dict[tuple[bool, Drive], float]
    follows: dict[tuple[bool, Drive], float]
    proximal: dict[Drive, float]
    least_sine: dict[tuple[bool, str], float]
    moves: Sequence[tuple[str, ...]]
    comparisons: list[Comparison]


def trial(arm: Arm, seed: list[int]) -> Trial:
    """Choose sets per energy and per torque and set their drive beside that of random sets."""
    rng = np.random.default_rng(seed)
    linear = LinearArm(arm, remember=4)
    candidates = chebyshev_poses(arm, _POINTS[arm.n])
    drawn = np.array([arm.random_pose(rng) for _ in range(RANDOM_POSES)])
    groups = rng.integers(0, RANDOM_POSES, (RANDOM_SETS, SET))
    chosen, scores_drawn, moves = {}, {}, []
    least_sine: dict[tuple[bool, str], float] = {}
    for per_energy in (True, False):
        scores = np.array([worst_push(arm, q, normalised=per_energy) for q in candidates])
        scores_drawn[per_energy] = [worst_push(arm, q, normalised=per_energy) for q in drawn]
        for difference in ("angle", "sine"):
            picked = candidates[choose_poses(candidates, scores, SET, difference=difference)]
            if difference == "sine":
                chosen[per_energy] = picked
            row, least_sine[per_energy, difference] = _moves(arm, per_energy, difference, picked)
            moves.append(row)
    rows, comparisons = [], []
    wins: dict[tuple[bool, Drive], float] = {}
    gains: dict[tuple[bool, Drive], float] = {}
    follows: dict[tuple[bool, Drive], float] = {}
    narrow = [submanipulator(arm, q, arm.n).lengths[-1] for q in drawn]
    proximal: dict[Drive, float] = {}
    for per, unit in _PER:
        drive = np.array([_worst(linear, q, per) for q in drawn])
        sets = drive[groups].mean(axis=1)
        marks = []
        for per_energy, picked in chosen.items():
            own = float(np.mean([_worst(linear, q, per) for q in picked]))
            key: tuple[bool, Drive] = (per_energy, per)
            wins[key] = float((sets < own).mean())
            gains[key] = own / float(drive.mean())
            follows[key] = float(spearmanr(scores_drawn[per_energy], drive).statistic)
            marks.append(("per energy" if per_energy else "per torque", own))
            rows.append(
                (
                    arm.name,
                    "energy" if per_energy else "torque",
                    unit,
                    f"{drive.mean():.2g}",
                    f"{own:.2g}",
                    f"{gains[key]:.2f}",
                    f"{100 * wins[key]:.0f} %",
                    f"{follows[key]:.2f}",
                )
            )
        last = [seat_drive(linear, q, arm.n, per=per)[0] for q in drawn]
        proximal[per] = float(spearmanr(narrow, last).statistic)
        comparisons.append(Comparison(title=f"{arm.name}, per {unit}", random=sets, chosen=marks))
    pushes = np.array([reactions(arm, q).per_energy[-1, :2] for q in chosen[True]])
    return Trial(
        arm=arm,
        candidates=len(candidates),
        poses=chosen[True],
        pushes=pushes,
        rows=rows,
        wins=wins,
        gains=gains,
        follows=follows,
        proximal=proximal,
        least_sine=least_sine,
        moves=moves,
        comparisons=comparisons,
    )


def seat_drive(
    linear: LinearArm, pose: Array, link: int, *, per: Drive = "torque"
) -> tuple[float, float]:
    """Force transmitted by a link's slide in the linear arm: worst direction and total.

    Each joint is excited in turn over the arm's band while the others are held; the powers add.
    Returns the rms force along the direction least driven, and the rms of the whole force
    [N per unit of drive].

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> worst, whole = seat_drive(LinearArm(planar(2)), np.array([0.0, 1.5]), 2)
    >>> 0 < worst < whole
    True
    """
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


def _moves(
    arm: Arm, per_energy: bool, difference: str, poses: Array
) -> tuple[tuple[str, ...], float]:
    """Row of the table of moves, and the smallest |sin| of a move."""
    first, second = np.triu_indices(len(poses), 1)
    angle = np.abs((poses[first] - poses[second] + np.pi) % (2 * np.pi) - np.pi)
    least = float(np.abs(np.sin(angle)).min())
    row = (
        arm.name,
        "energy" if per_energy else "torque",
        difference,
        f"{np.degrees(angle.min()):.0f}°",
        f"{np.degrees(angle.mean()):.0f}°",
        f"{least:.2f}",
    )
    return row, least


def trial_table(trials: list[Trial]) -> Table:
    """Drive of chosen sets beside that of random ones."""
    return Table(
        caption=f"Rms force in the least-driven direction of the worst seat [N per unit of drive], "
        f"mean over {SET} chosen poses and over {RANDOM_POSES} random ones; share of "
        f"{RANDOM_SETS} random sets driven less; rank correlation of the score with the drive. "
        "Each joint is excited in turn, the others braked.",
        columns=("arm", "chosen per", "drive", "random", "chosen", "ratio", "beaten", "ranks"),
        rows=tuple(row for t in trials for row in t.rows),
    )


def move_table(trials: list[Trial]) -> Table:
    """Joint moves within the chosen sets."""
    return Table(
        caption="How much the joints differ between the poses of a set: smallest and mean move of "
        "any joint between any two poses, and the smallest |sin| of a move, by which (4.31) "
        "divides.",
        columns=("arm", "chosen per", "difference by", "smallest", "mean", "smallest |sin|"),
        rows=tuple(row for t in trials for row in t.moves),
    )


def trial_words(trials: list[Trial]) -> list[str]:
    """Paragraphs on the gain from the choice of poses."""

    def held(key: tuple[bool, Drive]) -> str:
        return " and ".join(f"{100 * t.wins[key]:.0f} %" for t in trials)

    def ratio(key: tuple[bool, Drive]) -> str:
        return " and ".join(f"{t.gains[key]:.2f}" for t in trials)

    sizes = " and ".join(f"{t.candidates} for {t.arm.name}" for t in trials)
    first = (
        "The pose set is chosen as 4.2.3 says: Chebyshev points over the joints' ranges "
        f"({sizes}), a score for each pose, and from the best quarter the set whose joints differ "
        "most. The score is the push in the direction least pushed, of the seat that fares worst. "
        "The pushes are counted per root of the energy that links j to n get, as the thesis "
        "wants, and for comparison per torque."
    )
    better = all(t.wins[True, "tool"] > 0.8 for t in trials)
    torque = all(t.wins[True, "torque"] > 0.9 for t in trials)
    second = (
        f"Driven so that the tool moves equally, poses chosen per energy load the worst seat "
        f"{ratio((True, 'tool'))} times as hard as random poses on "
        f"{' and '.join(t.arm.name for t in trials)}, and beat {held((True, 'tool'))} of random "
        f"sets: the rule {'works' if better else 'does not work on both'}. Per torque the same "
        f"sets have {ratio((True, 'torque'))} times the drive and beat "
        f"{held((True, 'torque'))}; "
        + ("they serve there too. " if torque else "on that scale they are no sure gain. ")
        + f"Poses chosen per torque have {ratio((False, 'torque'))} times the drive per torque "
        f"({held((False, 'torque'))} of sets beaten) and {ratio((False, 'tool'))} times per motion "
        f"({held((False, 'tool'))}). "
        + "Which normalisation is right depends on what limits the drive: motion or torque. The "
        "drive comes from the linear arm with its brakes and bending modes, the scores from rigid "
        "links; their rank correlation per torque is "
        + " and ".join(f"{t.follows[False, 'torque']:.2f}" for t in trials)
        + ", so for torque the comparison tests the search more than the physics."
    )
    third = (
        "Section 8.2.3 proposes the dynamic manipulability of the proximal part, with the distal "
        "part as its end effector. Over random poses the shorter axis of that energy-weighted "
        "ellipsoid has a rank correlation with the drive of the last seat of "
        + " and ".join(
            f"{t.proximal['torque']:.2f} per torque and {t.proximal['tool']:.2f} per motion of the "
            f"tool ({t.arm.name})"
            for t in trials
        )
        + "."
    )
    fourth = (
        "A half turn of a joint leaves a looseness axis where it was, and (4.31) divides by the "
        "sine of the move, so moves are better counted by |sin| than by their angle. Doing so "
        "takes the smallest |sin| in the sets chosen per energy from "
        + " and from ".join(
            f"{t.least_sine[True, 'angle']:.2f} to {t.least_sine[True, 'sine']:.2f} ({t.arm.name})"
            for t in trials
        )
        + ". Where it stays small the best quarter of the grid holds no better set, or the greedy "
        "choice does not find it."
    )
    return [first, second, third, fourth]
