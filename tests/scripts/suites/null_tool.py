"""Tool of the instrument suite that plans a session and never decides."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from loose_env.typing import Array

POSES, PERIODS, LEAD, REST = 6, 4, 1.0, 0.4
"""Poses; periods of a second in each; time of fading in, and of rest before it [s]."""


class Null:
    """Shakes all joints at once in a few poses, and leaves every case open."""

    variants = ("silent",)

    def plan(self, folder: Path) -> dict[str, Any]:
        """Odd random-phase multisines within speed, acceleration and torque."""
        session = json.loads((folder / "session.json").read_text("utf-8"))
        model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
        controller, rng = session["controller"], np.random.default_rng(7)
        low, high = np.array(controller["low"]), np.array(controller["high"])
        rate = min(float(controller["rate_hz"]), 1000.0)
        runs = []
        for k in range(POSES):
            pose = low + (high - low) * (0.12 + 0.76 * rng.random(len(low)))
            command = self._command(model, controller, pose, rate, np.random.default_rng(11))
            runs.append({"name": f"run-{k + 1:02d}", "pose": pose.tolist(), "command": command})
        return {"rate_hz": rate, "runs": runs}

    def _command(
        self, model: Any, controller: Mapping[str, Any], pose: Array, rate: float,
        rng: np.random.Generator,
    ) -> Array:  # fmt: skip
        data, n = mujoco.MjData(model), len(pose)
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        inertia = np.zeros((n, n))
        mujoco.mj_fullM(model, data, inertia)
        limit = np.array(controller["max_torque"], float)
        spare = np.clip(0.7 * limit - np.abs(data.qfrc_bias), 0.1 * limit, None)
        peak = np.minimum(controller["max_acceleration"], 0.6 * spare / np.diag(inertia))
        time = np.arange(round((REST + LEAD + PERIODS) * rate)) / rate - REST
        omega = 2 * np.pi * np.arange(3, max(controller["bandwidth_hz"], 7) + 1, 2)
        command = np.zeros((len(time), n))
        for j in range(n):
            angle = np.outer(time, omega) + rng.uniform(0, 2 * np.pi, len(omega))
            crest = np.abs(np.cos(angle).sum(axis=1)).max()
            speed = (np.sin(angle) / omega).sum(axis=1) / crest
            size = min(peak[j], 0.8 * controller["max_speed"][j] / np.abs(speed).max())
            shapes = {
                "position": -(np.cos(angle) / omega**2).sum(axis=1) / crest, "velocity": speed,
                "torque": inertia[j, j] * np.cos(angle).sum(axis=1) / crest,
            }  # fmt: skip
            command[:, j] = size * shapes[controller["command"]] * np.clip(time / 0.3, 0, 1) ** 2
        return command + (pose if controller["command"] == "position" else 0.0)

    def diagnose(self, folder: Path, variant: str = "") -> dict[str, Any]:
        """Leave the case open."""
        runs = json.loads((folder / "recording" / "recording.json").read_text("utf-8"))["runs"]
        remark = "" if variant == "silent" else f"{len(runs)} runs, none looked at"
        return {
            "verdict": "open", "settled": False, "places": [], "several": False, "tested": {},
            "remarks": [remark] if remark else [], "remedy": "give another --tool",
        }  # fmt: skip
