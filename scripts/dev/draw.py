"""Draw figures of the pages: a record with its truth, the method, the classical method's steps.

Usage: python scripts/dev/draw.py pose --arm six_axis
       python scripts/dev/draw.py method
       python scripts/dev/draw.py classical

pose draws an arm with a hidden fault, as `render` gives it: one record, and the truth. method
writes method_loops.svg, one record of a healthy and of a loose arm; method_turning.svg, the loose
direction as the tool sees it in three poses; method_seat.svg, the dead zone of a loose seat and
what it does at three levels. classical draws episodes of the classical method: each row is one
episode, each panel one record with the pose, the direction of the change of motion at the tool,
what is left and what is done next.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np
from loose_agents import Problem, make_agent
from loose_agents.policies.classical import ClassicalAgent, Search
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, arm_from_file, planar
from loose_env.cli.command import Actions, commands
from loose_env.diagnosis import SensorFloor, predict
from loose_env.envs import (
    EDGE,
    FAINT,
    INK,
    MEASURED,
    MUTED,
    TRUTH,
    ArmDrawing,
    CorrelationByDirection,
    DiagnosisEnv,
    DiagnosisSettings,
    EpisodeBatch,
    draw_arrow,
    draw_section,
    measured_correlation,
    predicted_correlation,
)
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation
from loose_env.faults import Fault, Healthy, StructuralLooseness
from loose_env.io import write_text, written_beside
from loose_env.report import standalone, to_svg
from loose_env.rig import SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.typing import Array
from scripts.study import arm_named, pyplot, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures"


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Draw an arm with a hidden fault."""

    arm: str = "vera"
    """Arm: vera, six_axis, scara, planar4[v], or an MJCF or URDF file."""
    seed: int = 12
    """Seed of the fault's figures and the pose."""
    difficulty: str = "easy"
    """Difficulty."""
    fault: str = "structural_looseness@link2"
    """What to hide."""
    levels: tuple[int, ...] | None = None
    """Level of each joint, 0 to hold it; by default 3 for the last one."""
    before: bool = False
    """Stop before the truth is out."""
    out: Path = FIGURES / "render.png"
    """Picture."""


def draw_pose(options: Pose) -> None:
    """Play one record and, if wanted, the end, and write the picture."""
    from matplotlib.image import imsave

    arm = arm_from_file(options.arm) if Path(options.arm).suffix else arm_named(options.arm)
    levels = [0] * (arm.n - 1) + [3] if options.levels is None else options.levels
    if len(levels) != arm.n:
        raise InvalidSetting(f"--levels needs {arm.n} numbers for arm {arm.name!r}, got {levels}")
    settings = DiagnosisSettings(difficulty=options.difficulty)
    env = DiagnosisEnv(arm, settings, render_mode="rgb_array")
    env.reset(seed=options.seed, options={"fault": options.fault})
    env.step(env.actions.encode(levels=np.array(levels)))
    if not options.before:
        env.step(env.actions.encode(verdict=1 + env.hypotheses.index(options.fault)))
    pixels = env.render()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    told = {"Software": "loose-env"}
    written_beside(options.out, lambda file: imsave(file, pixels, format="png", metadata=told))
    print(options.out)
    env.close()


# Method

LOOSE = 2
"""The loose link of the pictures."""
ALONG = (0.35, 0.94, 0.0)
"""Direction in which it slides, in its own frame."""
POSE = np.radians([25.0, -70.0, 60.0])
SECONDS, BAND, SHAKEN, TORQUE = 1.2, (30.0, 150.0), 0, 6.0
"""Of the record [s, Hz], the excited joint, and its rms torque [N·m]."""
WIDTH = 7.2
"""Width of every picture [inch]."""


@dataclass(frozen=True, kw_only=True)
class Method:
    """Draw what a loose link does to a record, or the classical method's episodes."""

    out: Path = FIGURES
    """Folder of the pictures."""


def draw_method(options: Method) -> None:
    """Draw all of them."""
    arm = planar(3)
    for name, figure in (
        ("method_loops", loops(arm)),
        ("method_turning", turning(arm)),
        ("method_seat", seat()),
    ):
        print(write_text(options.out / f"{name}.svg", standalone(to_svg(figure), name)))


def loose(link: int = LOOSE) -> StructuralLooseness:
    """The fault of the pictures."""
    return StructuralLooseness(
        link=link, direction=ALONG, gap=2e-4, stiffness=(1e7, 1e7), damping=(200.0, 200.0),
        friction=1.0,
    )  # fmt: skip


def loops(arm: Arm) -> Figure:
    """The arm, and the correlation loops of one record: healthy and with a loose link."""
    figure = blank(3.0)
    sketch = panel(figure, 0.0, 0.36)
    draw_arm(sketch, arm, POSE, loose(), shaken=SHAKEN)
    title(figure, 0.18, "link 2 is loose, joint 1 is excited")
    expected = predicted_correlation(
        predict(LinearArm(arm).at(POSE), excitation(arm), SensorFloor.of(SensorSuite(), BAND))
    )
    for left, words, fault in ((0.36, "healthy arm", Healthy()), (0.68, "loose link", loose())):
        axes = panel(figure, left, 0.32)
        found = measured(arm, fault)
        healthy = expected.facing(found).sections[0]
        draw_section(axes, found.sections[0], healthy, ("x", "y"))
        if isinstance(fault, StructuralLooseness):
            lost = in_tool(arm, POSE, fault)
            draw_arrow(axes, -lost, lost, color=TRUTH, both=True)
        title(figure, left + 0.16, words)
    key(
        figure,
        [("- -", MUTED, "healthy, by the model"), ("■", MEASURED, "measured"),
         ("↔", TRUTH, "direction of the slide")],
    )  # fmt: skip
    return figure


def excitation(arm: Arm) -> Excitation:
    """What is played."""
    torque = [0.0] * arm.n
    torque[SHAKEN] = TORQUE
    return Excitation(torque_rms=tuple(torque), duration=SECONDS, band=BAND)


def measured(arm: Arm, fault: Fault) -> CorrelationByDirection:
    """The loop of a simulated record."""
    rig = SimulatedRig(arm)
    rig.mount(0, fault)
    return measured_correlation(rig.measure(POSE, excitation(arm), rng=np.random.default_rng(3)))


def turning(arm: Arm) -> Figure:
    """The loose direction in the tool frame: before, after a move of joint 1, of joint 3."""
    moved = [
        ("first pose", POSE),
        ("joint 1 moved: it stays", POSE + np.radians([50.0, 0.0, 0.0])),
        ("joint 3 moved: it turns", POSE + np.radians([0.0, 0.0, 60.0])),
    ]
    figure = blank(4.3)
    first = in_tool(arm, POSE, loose())
    for k, (words, pose) in enumerate(moved):
        left, wide = k / 3, 1 / 3
        axes = panel(figure, left, wide, bottom=0.46, height=0.42)
        draw_arm(axes, arm, pose, loose())
        below = panel(figure, left, wide, bottom=0.02, height=0.4)
        draw_section(below, None, None, ("x", "y"))
        if k:
            below.plot(*np.outer([-1, 1], first).T, color=MUTED, linewidth=1.3, dashes=(4, 2.5))
        now = in_tool(arm, pose, loose())
        draw_arrow(below, -now, now, color=TRUTH, both=True)
        title(figure, left + 0.5 * wide, words)
    figure.text(0.02, 0.435, "seen from the tool:", color=MUTED, fontsize=9.5, va="center")
    return figure


def seat() -> Figure:
    """The force of a loose seat over its travel, and what it lets through at three levels."""
    figure = blank(2.9)
    axes = figure.add_axes((0.07, 0.2, 0.38, 0.6))
    gap, stiff = 1.0, 4.0
    x = np.linspace(-0.95, 0.95, 400)
    force = stiff * np.where(x > gap / 2, x - gap / 2, np.where(x < -gap / 2, x + gap / 2, 0.0))
    axes.axvspan(-gap / 2, gap / 2, color=FAINT, alpha=0.45, linewidth=0)
    axes.plot(x, force, color=MEASURED, linewidth=2.2)
    axes.axhline(0.0, color=MUTED, linewidth=0.8, zorder=1)
    look: dict[str, Any] = {"color": INK, "fontsize": 9.5, "ha": "center", "va": "center"}
    axes.text(0.0, 1.25, "the gap:\nno force", **look)
    axes.text(-0.71, -1.75, "stop", **look | {"ha": "left"})
    axes.text(0.71, 1.75, "stop", **look | {"ha": "right"})
    axes.set(xlim=(-0.95, 0.95), ylim=(-2.0, 2.0), xticks=[], yticks=[])
    axes.set_xlabel("travel of the seat", color=MUTED, fontsize=9.5)
    axes.set_ylabel("force it passes on", color=MUTED, fontsize=9.5)
    bare(axes)
    title(figure, 0.26, "a dead zone between two stops")
    time = np.linspace(0.0, 1.0, 600)
    push = np.sin(2 * np.pi * 3 * time) * (1 + 0.15 * np.sin(2 * np.pi * 1.3 * time))
    for k, (level, words) in enumerate(
        ((0.5, "too weak: friction holds the seat shut"),
         (1.6, "right: it floats, the motion is lost"),
         (5.0, "too strong: it strikes the stops"))
    ):  # fmt: skip
        own = figure.add_axes((0.54, 0.6 - 0.235 * k, 0.43, 0.15))
        own.plot(time, push, color=MUTED, linewidth=1.1, dashes=(4, 2.5))
        own.plot(time, passed_on(level * push, time) / level, color=MEASURED, linewidth=1.7)
        own.set(xlim=(0.0, 1.0), ylim=(-1.5, 1.5), xticks=[], yticks=[])
        bare(own)
        figure.text(0.54, 0.775 - 0.235 * k, words, color=INK, fontsize=9.5, va="center")
    title(figure, 0.755, "drive (dashed), and what gets across")
    return figure


def passed_on(drive: NDArray[np.float64], time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Force across a seat with friction 1, a gap and stiff stops, on a mass that it drives.

    The two sides are driven apart by the force; friction passes on up to 1, the stops the rest.
    """
    steps = 40
    fine = np.linspace(time[0], time[-1], steps * (len(time) - 1) + 1)
    force = np.interp(fine, time, drive)
    dt, half, stiff, damp = float(fine[1] - fine[0]), 0.005, 2.0e4, 60.0
    place, speed, found = 0.0, 0.0, np.empty_like(fine)
    for k, push in enumerate(force):
        over = place - np.clip(place, -half, half)
        stop = stiff * over + (damp * speed if over else 0.0)
        held = np.clip(push - stop + speed / dt, -1.0, 1.0)
        speed += dt * (push - stop - held)
        place += dt * speed
        found[k] = held + stop
    return found[::steps]


def in_tool(arm: Arm, pose: NDArray[np.float64], fault: StructuralLooseness) -> Any:
    """Direction of a slide along the two measured axes of the tool frame (2,)."""
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(arm.model, data)
    frame = data.site(arm.tool).xmat.reshape(3, 3)
    link = data.body(arm.seat_bodies[fault.link - 1]).xmat.reshape(3, 3)
    seen = (frame.T @ link @ np.asarray(fault.direction))[list(arm.axes)]
    return seen / np.linalg.norm(seen)


def blank(height: float) -> Figure:
    """An empty picture."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH, height))


def panel(
    figure: Figure, left: float, width: float, *, bottom: float = 0.1, height: float = 0.78
) -> Axes:
    """A part of the picture without a frame, as wide as high within."""
    axes = figure.add_axes((left, bottom, width, height))
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3))
    return axes


def draw_arm(
    axes: Axes,
    arm: Arm,
    pose: NDArray[np.float64],
    fault: StructuralLooseness,
    *,
    shaken: int | None = None,
) -> None:
    """The arm with its loose link and the way it slides."""
    drawing = ArmDrawing(arm)
    excited = None if shaken is None else np.arange(arm.n) == shaken
    drawing.draw(axes, drawing.marks(pose, excited=excited, fault=fault))


def title(figure: Figure, x: float, words: str) -> None:
    """Name a part of the picture."""
    figure.text(x, 0.955, words, color=INK, fontsize=10.5, ha="center", va="center")


def key(figure: Figure, entries: Sequence[tuple[str, str, str]]) -> None:
    """Name the colours at the bottom."""
    x = 0.33
    for mark, colour, words in entries:
        figure.text(x, 0.045, mark, color=colour, fontsize=11, va="center")
        figure.text(x + 0.03, 0.045, words, color=INK, fontsize=9.5, va="center")
        x += 0.055 + 0.0105 * len(words)


def bare(axes: Axes) -> None:
    """Leave of the frame only what helps reading."""
    axes.patch.set_alpha(0.0)
    for spine in axes.spines.values():
        spine.set_color(EDGE)
        spine.set_linewidth(0.8)


# Classical method

SEED = 1
"""Seed of the episodes, one that training may use."""
FAULTS = ("structural_looseness@link2", "backlash@joint3", "healthy")
"""What the episodes hide, a row of the figure each."""
EPISODES = (3, 0, 1)
"""Numbers of the episodes."""


class Step(NamedTuple):
    """One record and what the agent made of it."""

    pose: Array
    """Pose [rad] (n,)."""
    direction: float
    """Direction of the change of motion, tool frame [rad]."""
    moved: str
    """Joints that moved before the record, and by how much."""
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
    ended = False
    while not ended:
        pose = agent.problem.layout.pose_of(batch.observe(0))
        action, state = agent.predict(batch.observe(0), state)
        memory: Search = state[0]
        decoded = batch.actions.decode(action)
        verdict = batch.verdicts[decoded.verdict - 1] if decoded.verdict else None
        alone = None if memory.driven is None else memory.driven + 1
        moved = moves_of(steps[-1].pose if steps else None, pose)
        next_moves = [str(j + 1) for j, k in enumerate(decoded.moves) if k != settings.stay]
        decision = verdict or (f"move {', '.join(next_moves)}" if next_moves else "stay")
        if alone is not None:  # the record that it asks for, then the one that it judges
            moved = f"joint {alone} driven alone" if verdict else moved
            decision = verdict or f"drive {alone} alone"
        if memory.pool.records:
            x, y = memory.pool.records[-1].direction
            steps.append(Step(pose, float(np.arctan2(y, x)), moved, memory.left, decision))
        ended = batch.step([0], [action])[0].terminated
    return steps


def moves_of(before: Array | None, after: Array) -> str:
    """Joints that moved between two poses, in words."""
    if before is None:
        return "first pose"
    change = np.degrees((after - before + np.pi) % (2 * np.pi) - np.pi)
    moved = [f"{j + 1} by {d:+.0f}°" for j, d in enumerate(change) if abs(d) > 0.5]
    return f"joint {', '.join(moved)}" if moved else "no joint"


def short(name: str) -> str:
    """Short form of a hypothesis."""
    kind, _, place = name.partition("@")
    if not place:
        return kind
    return f"{'slide' if kind.startswith('structural') else 'play'} {place[-1]}"


def points_of(arm: Arm, pose: Array) -> tuple[Array, float]:
    """Joints and tool in the plane (n + 1, 2) [m], and the tool frame's angle [rad]."""
    model, data = arm.model, mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_kinematics(model, data)
    tool = data.site(arm.tool)
    rows = [*data.xanchor[[model.joint(name).id for name in arm.joints]], tool.xpos]
    frame = tool.xmat.reshape(3, 3)
    return np.array(rows)[:, :2], float(np.arctan2(frame[1, 0], frame[0, 0]))


def draw_steps(arm: Arm, episodes: Sequence[tuple[str, list[Step]]], out: Path) -> Path:
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
            seen = angle + step.direction
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
            words = f"left: {left}\n-> {short(step.decision)}"
            look: dict[str, Any] = {"ha": "center", "va": "top", "fontsize": 7, "color": MUTED}
            panel.text(0.5, -0.02, words, transform=panel.transAxes, **look)
    out.mkdir(parents=True, exist_ok=True)
    path = out / "classical_steps.svg"
    save_figure(plt, figure, path)
    return path


def draw_classical(options: Method) -> None:
    """Play the episodes and draw them."""
    arm, settings = planar(4), DiagnosisSettings(engine="reduced")
    pairs = zip(FAULTS, EPISODES, strict=True)
    episodes = [(fault, play(arm, settings, fault, number)) for fault, number in pairs]
    print(draw_steps(arm, episodes, options.out))


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the figure that is named."""
    actions: Actions = {
        "pose": (Pose, draw_pose),
        "method": (Method, draw_method),
        "classical": (Method, draw_classical),
    }
    commands("draw", __doc__, actions, arguments)


if __name__ == "__main__":
    main()
