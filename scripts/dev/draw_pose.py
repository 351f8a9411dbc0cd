"""Draw an arm with a hidden fault, as `render` gives it: one record, and the truth.

Without options this is the figure of the documentation.

Usage: python scripts/dev/draw_pose.py [--arm vera] [--links 4] [--vertical] [--model arm.xml]
           [--seed 12] [--difficulty easy] [--fault structural_looseness@link2]
           [--levels 0 3] [--before] [--out docs/figures/render.png]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import DESK_ARM, arm_from_file, planar, scara, six_axis, vera
from loose_env.envs import DiagnosisEnv, DiagnosisSettings
from loose_env.errors import InvalidSetting, LooseEnvError

ARMS = {"vera": vera, "planar": planar, "six_axis": six_axis, "scara": scara}
FIGURE = Path(__file__).resolve().parents[2] / "docs" / "figures" / "render.png"


def main() -> None:
    """Read the options, draw, and save beside the final name first."""
    options = read_options()
    try:
        pixels = draw(options)
    except LooseEnvError as error:
        raise SystemExit(f"draw_pose: {error}") from error
    from matplotlib.image import imsave

    options.out.parent.mkdir(parents=True, exist_ok=True)
    beside = options.out.with_name(f".{options.out.name}.part")
    imsave(beside, pixels, format="png", metadata={"Software": "loose-env"})
    beside.replace(options.out)
    print(options.out)


def read_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Draw an arm with a hidden fault.")
    parser.add_argument("--arm", choices=(*ARMS, "file"), default="vera")
    parser.add_argument("--model", type=Path, default=DESK_ARM, help="MJCF or URDF of --arm file")
    parser.add_argument("--links", type=int, default=4, help="links of the planar arm")
    parser.add_argument("--vertical", action="store_true", help="planar arm in a vertical plane")
    parser.add_argument("--seed", type=int, default=12, help="of the fault's figures and the pose")
    parser.add_argument("--difficulty", default="easy")
    parser.add_argument("--fault", default="structural_looseness@link2", help="what to hide")
    parser.add_argument(
        "--levels", type=int, nargs="+", help="level of each joint, 0 to hold it; default: last 3"
    )
    parser.add_argument("--before", action="store_true", help="stop before the truth is out")
    parser.add_argument("--out", type=Path, default=FIGURE)
    return parser.parse_args()


def draw(options: argparse.Namespace) -> NDArray[np.uint8]:
    """Play one record and, if wanted, the end; return the pixels."""
    if options.arm == "planar":
        arm = planar(options.links, vertical=options.vertical)
    else:
        arm = arm_from_file(options.model) if options.arm == "file" else ARMS[options.arm]()
    levels = [0] * (arm.n - 1) + [3] if options.levels is None else options.levels
    if len(levels) != arm.n:
        raise InvalidSetting(f"--levels needs {arm.n} numbers for arm {arm.name!r}, got {levels}")
    settings = DiagnosisSettings(difficulty=options.difficulty)
    env = DiagnosisEnv(arm, settings, render_mode="rgb_array")
    env.reset(seed=options.seed, options={"fault": options.fault})
    env.step(env.actions.encode(levels=np.array(levels)))
    if not options.before:
        env.step(env.actions.encode(verdict=1 + env.hypotheses.index(options.fault)))
    pixels: NDArray[np.uint8] = env.render()
    env.close()
    return pixels


if __name__ == "__main__":
    main()
