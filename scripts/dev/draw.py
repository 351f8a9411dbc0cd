"""Draw an arm with a hidden fault as `render` gives it: one record, and the truth.

Usage: python scripts/dev/draw.py --arm six_axis
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loose_env.arms import arm_from_file
from loose_env.cli.command import command
from loose_env.envs import DiagnosisEnv, DiagnosisSettings
from loose_env.errors import InvalidSetting
from loose_env.io import written_beside
from scripts.study import arm_named

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


if __name__ == "__main__":
    command("draw", __doc__, Pose, draw_pose)
