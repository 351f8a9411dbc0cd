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
from typing import TYPE_CHECKING, Any

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
from scripts.charts import Panel, chart, curve, save
from scripts.study import arm_named

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
EPISODES = {"structural_looseness@link2": 3, "backlash@joint3": 0, "healthy": 1}
"""Fault and number of the episodes, a row of the figure each."""


def steps_of(arm: Arm, settings: DiagnosisSettings, fault: str, number: int) -> list[Panel]:
    """Play one episode and draw every record: pose, direction, what is left, the decision."""
    agent = make_agent("classical", Problem.of(arm, settings))
    assert isinstance(agent, ClassicalAgent)
    batch = EpisodeBatch(arm, settings, num=1, threads=1)
    batch.start(0, seed=SEED, number=number, options={"fault": fault})
    state: Any = None
    before: Array | None = None
    panels: list[Panel] = []
    ended = False
    while not ended:
        pose = agent.problem.layout.pose_of(batch.observe(0))
        action, state = agent.predict(batch.observe(0), state)
        memory: Search = state[0]
        decoded = batch.actions.decode(action)
        verdict = batch.verdicts[decoded.verdict - 1] if decoded.verdict else None
        alone = None if memory.driven is None else memory.driven + 1
        moved = moves_of(before, pose)
        next_moves = [str(j + 1) for j, k in enumerate(decoded.moves) if k != settings.stay]
        decision = verdict or (f"move {', '.join(next_moves)}" if next_moves else "stay")
        if alone is not None:  # the record that it asks for, then the one that it judges
            moved = f"joint {alone} driven alone" if verdict else moved
            decision = verdict or f"drive {alone} alone"
        if memory.pool.records:
            before, (x, y) = pose, memory.pool.records[-1].direction
            left = ", ".join(short(name) for name in memory.left[:3]) or "nothing seen"
            words = [f"hidden: {short(fault)}"] if not panels else []
            words += textwrap.wrap(f"{len(panels) + 1}: {moved}", 34)
            words += [f"left: {left}", f"-> {short(decision)}"]
            panels.append(drawn(arm, pose, np.arctan2(y, x), "\n".join(words), bool(memory.left)))
        ended = batch.step([0], [action])[0].terminated
    return panels


def drawn(arm: Arm, pose: Array, direction: float, words: str, seen: bool) -> Panel:
    """The arm in a pose and a direction of its tool frame [rad]."""
    places, angle = points_of(arm, pose)
    x, y = (places - places[0]).T
    size, seen_at = 0.2 * arm.reach * np.array([-1.0, 1.0]), angle + direction
    ends = x[-1] + size * np.cos(seen_at), y[-1] + size * np.sin(seen_at)
    colour = MEASURED if seen else EDGE
    lines = [
        curve(x, y, color=INK, linewidth=2.0, marker="o", markersize=4),
        curve(ends[0], ends[1], color=colour, linewidth=2.5),
    ]
    return Panel(title=words, curves=lines)


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


def draw_classical(options: Method) -> None:
    """Play the episodes and draw a row for each, a panel a record."""
    arm, settings = planar(4), DiagnosisSettings(engine="reduced")
    rows = [steps_of(arm, settings, fault, number) for fault, number in EPISODES.items()]
    most = max(map(len, rows))
    panels = [panel for row in rows for panel in [*row, *[Panel(curves=())] * (most - len(row))]]
    path = options.out / "classical_steps.svg"
    save(chart(panels, columns=most, bare=True, width=2.9 * most, height=3.0), path)
    print(path)


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
