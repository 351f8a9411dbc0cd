"""A small arm and its runs, integrated without MuJoCo: a stand-in for a machine."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from pathlib import Path

import numpy as np

from loose_env.recording import Run
from scripts.suites.diagnosis.cases import Case, motion, taken
from scripts.suites.gap.arms import model_xml, planar3
from scripts.suites.gap.dynamics import Factors
from scripts.suites.gap.effects import Effect, Place
from scripts.suites.gap.machine import Noise, TrueArm

STOPS = {"stop_mode": 110.0, "stop_damping_ratio": 0.3}
SLIDE = Effect(
    kind="structural_looseness",
    place=Place(name="link2", index=1),
    parameters={"gap": 2e-4, "direction": [0.6, 0.0, 0.8], "friction": 0.4, **STOPS},
)
PLAY = Effect(
    kind="backlash", place=Place(name="joint2", index=1), parameters={"gap": 2e-3, **STOPS}
)


@lru_cache(maxsize=4)
def case(kind: str) -> Case:
    """A planar arm whose figures are 1 to 3 % off: "healthy", "slide" or "play"."""
    rng = np.random.default_rng(11)
    figures = planar3()
    arm = TrueArm(figures=figures, factors=Factors.draw(figures.joints, rng))
    effects = {"healthy": (), "slide": (SLIDE,), "play": (PLAY,)}[kind]
    return Case(
        number=0,
        seed=11,
        arm=dataclasses.replace(arm, effects=effects),
        noise=Noise.draw(figures, rng),
        sensor=np.eye(3) + 0.02 * np.array([[0, 1, -1], [1, 0, 1], [-1, 1, 0]]),
        reference=False,
    )


@lru_cache(maxsize=8)
def runs(kind: str, count: int = 2, share: float = 0.2, *, sound: bool = False) -> tuple[Run, ...]:
    """Runs in fixed poses, joints in turn; `share` is the rms force over the drive's limit."""
    whole = case(kind)
    figures = whole.arm.figures
    poses = figures.home + figures.reach * np.array(
        [[0.5, -0.4, 0.3], [-0.6, 0.5, -0.5], [0.1, 0.7, 0.6]]
    )
    found = []
    for k in range(count):
        joint = (k + 1) % figures.joints
        link = figures.links[joint]
        played = motion(
            whole, poses[k], joint, share * link.limit / link.kp, (4.0, 100.0), 2.0,
            np.random.default_rng(k),
        )  # fmt: skip
        name = f"{'healthy' if sound else 'run'}-{k + 1}.parquet"
        found.append(taken(whole, played, name, np.random.default_rng(100 + k), sound=sound))
    return tuple(found)


def write_model(folder: Path) -> Path:
    """Write the nominal model."""
    path = folder / "model.xml"
    path.write_text(model_xml(planar3()), encoding="utf-8")
    return path
