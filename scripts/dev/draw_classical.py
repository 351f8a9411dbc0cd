"""Draw episodes of the classical method: pose, direction, turn, what is left, decision.

Each row is one episode with a hidden fault of four links in the plane, each panel one record: the
arm in its pose, the direction of the change of motion at its tool, and beside it how far the best
place's own direction lies off. The text printed says the same in a line per record.

Usage: python scripts/dev/draw_classical.py [--out FOLDER]
"""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from loose_agents.base import Problem
from loose_agents.policies.classical import ClassicalAgent, Search
from loose_agents.registry import make_agent

from loose_env.arms import Arm, planar
from loose_env.envs import EDGE, INK, MEASURED, MUTED, DiagnosisSettings, EpisodeBatch
from loose_env.report import pyplot, save_figure
from loose_env.typing import Array

SEED = 1
"""Seed of the episodes, one that training may use."""
FAULTS = ("structural_looseness@link2", "backlash@joint3", "healthy")
"""What the episodes hide, a row of the figure each."""
EPISODES = (3, 0, 1)
"""Numbers of the episodes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One record and what the agent made of it."""

    pose: Array
    """Pose [rad] (n,)."""
    direction: float
    """Direction of the change of motion, tool frame, 0 to 180 [deg]."""
    moved: str
    """Joints that moved before the record, and by how much."""
    gain: float
    """Change along the best place in all records up to it, chi-square [1]."""
    left: tuple[str, ...]
    """Places left, best first; empty if nothing is seen."""
    decision: str
    """The verdict, or what is done next."""


def play(arm: Arm, settings: DiagnosisSettings, fault: str, number: int) -> list[Step]:
    """Play one episode and keep every step."""
    agent = make_agent("classical", Problem.of(arm, settings))
    assert isinstance(agent, ClassicalAgent)
    batch = EpisodeBatch(arm, settings, num=1, threads=1)
    batch.start(0, seed=SEED, number=number, options={"fault": fault})
    state: Any = None
    steps: list[Step] = []
    before: Array | None = None
    while True:
        pose = agent.problem.layout.pose_of(batch.observe(0))
        action, state = agent.predict(batch.observe(0), state)
        memory: Search = state[0]
        decoded = batch.actions.decode(action)
        verdict = batch.verdicts[decoded.verdict - 1] if decoded.verdict else None
        alone = None if memory.driven is None else memory.driven + 1
        moved = moves_of(before, pose)
        decision = verdict or next_of(decoded.moves, settings)
        if alone is not None:  # the record that it asks for, then the one that it judges
            moved = f"joint {alone} driven alone" if verdict else moved
            decision = verdict or f"drive {alone} alone"
        if memory.pool.records:
            x, y = memory.pool.records[-1].direction
            steps.append(
                Step(
                    pose=pose,
                    direction=float(np.degrees(np.arctan2(y, x)) % 180.0),
                    moved=moved,
                    gain=memory.pool.gain,
                    left=memory.left,
                    decision=decision,
                )
            )
            before = pose
        if batch.step([0], [action])[0].terminated:
            return steps


def moves_of(before: Array | None, after: Array) -> str:
    """Joints that moved between two poses, in words."""
    if before is None:
        return "first pose"
    change = np.degrees((after - before + np.pi) % (2 * np.pi) - np.pi)
    moved = [f"{j + 1} by {d:+.0f}°" for j, d in enumerate(change) if abs(d) > 0.5]
    return f"joint {', '.join(moved)}" if moved else "no joint"


def next_of(moves: Any, settings: DiagnosisSettings) -> str:
    """What is moved next, in words."""
    moved = [str(j + 1) for j, k in enumerate(moves) if k != settings.stay]
    return f"move {', '.join(moved)}" if moved else "stay"


def short(name: str) -> str:
    """Short form of a hypothesis."""
    kind, _, place = name.partition("@")
    if not place:
        return kind
    return f"{'slide' if kind.startswith('structural') else 'play'} {place[-1]}"


def text_of(fault: str, steps: Sequence[Step]) -> str:
    """A line for each record."""
    lines = [
        f"hidden: {fault}",
        f"{'record':>6}  {'moved':24} {'direction':>9} {'turned':>7} {'gain':>7}  "
        f"{'left, best first':34} decision",
    ]
    for k, step in enumerate(steps):
        turned = ""
        if k:
            turn = (step.direction - steps[k - 1].direction + 90.0) % 180.0 - 90.0
            turned = f"{turn:+.0f}°"
        left = ", ".join(short(name) for name in step.left[:5]) or "nothing seen"
        lines.append(
            f"{k + 1:>6}  {step.moved:24} {step.direction:>8.0f}° {turned:>7} {step.gain:>7.1f}  "
            f"{left:34} {short(step.decision)}"
        )
    return "\n".join(lines)


def points_of(arm: Arm, pose: Array) -> tuple[Array, float]:
    """Joints and tool in the plane (n + 1, 2) [m], and the tool frame's angle [rad]."""
    model, data = arm.model, mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_kinematics(model, data)
    tool = data.site(arm.tool)
    rows = [*data.xanchor[[model.joint(name).id for name in arm.joints]], tool.xpos]
    frame = tool.xmat.reshape(3, 3)
    return np.array(rows)[:, :2], float(np.arctan2(frame[1, 0], frame[0, 0]))


def draw(arm: Arm, episodes: Sequence[tuple[str, list[Step]]], out: Path) -> Path:
    """Draw a row for each episode and a panel for each record."""
    plt = pyplot()
    most = max(len(steps) for _, steps in episodes)
    figure, axes = plt.subplots(
        len(episodes), most, figsize=(2.9 * most, 3.0 * len(episodes)), squeeze=False
    )
    figure.subplots_adjust(left=0.02, right=0.98, top=0.92, bottom=0.07, hspace=0.55, wspace=0.1)
    half = 0.5 * arm.reach  # arms are seldom stretched
    for (fault, steps), row in zip(episodes, axes, strict=True):
        for k, panel in enumerate(row):
            panel.set_axis_off()
            if k >= len(steps):
                continue
            step = steps[k]
            points, angle = points_of(arm, step.pose)
            points = points - points[0]
            panel.plot(*points.T, "-o", color=INK, lw=2.0, ms=4)
            seen = angle + np.radians(step.direction)
            along = 0.4 * half * np.array([np.cos(seen), np.sin(seen)])
            line = np.stack([points[-1] - along, points[-1] + along])
            panel.plot(*line.T, color=MEASURED if step.left else EDGE, lw=2.5)
            ends = np.concatenate([points, line])
            x, y = (ends.min(axis=0) + ends.max(axis=0)) / 2
            panel.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")
            left = ", ".join(short(name) for name in step.left[:3]) or "nothing seen"
            panel.set_title(
                (f"hidden: {short(fault)}\n" if k == 0 else "")
                + textwrap.fill(f"{k + 1}: {step.moved}", 34),
                fontsize=8,
                color=INK,
            )
            panel.text(
                0.5,
                -0.02,
                f"left: {left}\n-> {short(step.decision)}",
                transform=panel.transAxes,
                ha="center",
                va="top",
                fontsize=7,
                color=MUTED,
            )
    out.mkdir(parents=True, exist_ok=True)
    path = out / "classical_steps.svg"
    save_figure(plt, figure, path)
    return path


def main(arguments: Sequence[str] | None = None) -> None:
    """Play the episodes, print their steps and draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/figures"), help="folder")
    options = parser.parse_args(arguments)
    arm, settings = planar(4), DiagnosisSettings(engine="reduced")
    episodes = [
        (fault, play(arm, settings, fault, number))
        for fault, number in zip(FAULTS, EPISODES, strict=True)
    ]
    for fault, steps in episodes:
        print(text_of(fault, steps), end="\n\n")
    print(f"Figure: {draw(arm, episodes, options.out)}")


if __name__ == "__main__":
    main()
