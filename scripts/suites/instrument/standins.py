"""Stand-ins for real machines from ``../shared/standins``, with the interface of `physics`.

They were written by others, in plain MuJoCo: an arm with harmonic drives (``ur``), a SCARA with
belts (``scara``) and a desktop arm of hobby servos (``desk``).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array
from scripts.suites.instrument import physics
from scripts.suites.instrument.machines import STEP, Sensor, Sheet, add_interfaces
from scripts.suites.instrument.physics import GRAVITY, Chances, Fault, Played, World, press_shut

FOLDER = Path(__file__).resolve().parents[4] / "shared" / "standins"
"""Where the stand-ins lie, beside the repository."""
_TURN = 2 * np.pi

SHEETS: Mapping[str, Sheet] = {
    "ur": Sheet(
        name="ur",
        joints=("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint",
                "wrist_2_joint", "wrist_3_joint"),
        bodies=("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link",
                "wrist_2_link", "wrist_3_link"),
        slides=(False,) * 6, low=(-1.5, -2.3, 0.5, -2.5, -2.2, -2.5),
        high=(1.5, -0.8, 2.2, 1.0, 2.2, 2.5), torque=(150.0,) * 3 + (28.0,) * 3,
        speed=(1.5,) * 3 + (2.5,) * 3, acceleration=(14.0, 14.0, 18.0, 40.0, 40.0, 40.0),
        command="position", command_hz=500.0, latency=0.002, interpolated=False,
        bandwidth_hz=25.0, encoders="motor", log_hz=500.0, torques="current",
        resolution=(_TURN / 2**14,) * 6,
        sensor=Sensor(rate_hz=1600.0, corner_hz=500.0, noise_ug=90.0),
        strike=(15.0, 50.0), friction=(1.5, 12.0), payload=(0.3, 2.5),
    ),
    "scara": Sheet(
        name="scara", joints=("J1", "J2", "J3", "J4"), bodies=("arm1", "arm2", "quill", "flange"),
        slides=(False, False, True, False), low=(-1.0, -2.0, -0.13, -2.5),
        high=(1.0, 2.0, -0.02, 2.5), torque=(160.0, 75.0, 500.0, 9.0),
        speed=(3.0, 3.5, 0.8, 8.0), acceleration=(40.0, 60.0, 14.0, 150.0), command="position",
        command_hz=1000.0, latency=0.001, interpolated=False, bandwidth_hz=29.0,
        encoders="motor", log_hz=1000.0, torques="current",
        resolution=(5e-6, 5e-6, 5e-6, 5e-6),
        sensor=Sensor(rate_hz=1000.0, corner_hz=400.0, noise_ug=130.0, range_g=8.0),
        strike=(15.0, 50.0), friction=(1.5, 12.0), payload=(0.2, 1.5), base="column",
    ),
    "desk": Sheet(
        name="desk", joints=("pan", "lift", "elbow", "pitch", "roll"),
        bodies=("turn", "upper", "fore", "hand", "grip"), slides=(False,) * 5,
        low=(-1.0, -1.0, -0.8, -1.2, -2.0), high=(1.0, 1.0, 1.4, 1.2, 2.0), torque=(2.9,) * 5,
        speed=(3.0,) * 5, acceleration=(25.0, 25.0, 25.0, 30.0, 40.0), command="position",
        command_hz=50.0, latency=0.008, interpolated=False, bandwidth_hz=11.0, encoders="link",
        log_hz=100.0, torques="none", resolution=(_TURN / 4096,) * 5,
        sensor=Sensor(rate_hz=1000.0, corner_hz=260.0, noise_ug=400.0, range_g=4.0),
        strike=(2.0, 8.0), friction=(0.15, 0.6), payload=(0.03, 0.12), base="foot",
        least_play=0.009, hobby=True,
    ),
}  # fmt: skip
"""What users know of the stand-ins."""
_FILES = {"ur": "ur5e.xml", "scara": "scara.xml", "desk": "desk.xml"}


def absent() -> str:
    """Reason for which the stand-ins cannot be used; empty if they can."""
    return "" if (FOLDER / "common.py").is_file() else f"the stand-ins are not in {FOLDER}"


@cache
def _module(name: str) -> ModuleType:
    if words := absent():
        raise InvalidSetting(f"{words}; choose numbers of other machines")
    sys.path.insert(0, str(FOLDER))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(FOLDER))


def nominal(name: str) -> mujoco.MjSpec:
    """Rigid model of a stand-in as its user has it."""
    spec = mujoco.MjSpec.from_file(str(FOLDER / _FILES[name]))
    _module("common").strip(spec)
    spec.option.timestep = 0.002
    add_interfaces(spec, SHEETS[name])
    return spec


class StandIn:
    """A stand-in on one day."""

    def __init__(
        self, name: str, chances: Chances, faults: tuple[Fault, ...] = (),
        world: World | None = None,
    ) -> None:  # fmt: skip
        self.sheet, self.chances, self.faults = SHEETS[name], chances, faults
        self.world = world or World()
        given: list[tuple[Any, ...]] = [
            ("loose", f.at, f.direction, f.clearance, f.friction)
            if f.kind == "structural_looseness"
            else ("play", f.at, f.clearance)
            for f in faults
        ]
        if self.world.base:
            given.append(("base", self.world.base))
        seed = int(chances.machine(0).integers(2**31))
        build = _module("ur").build if name == "ur" else _module("others").build
        words = (seed,) if name == "ur" else (name, seed)
        self.bench, _ = build(*words, tuple(given), self.world.payload)
        self._make_day()

    def _make_day(self) -> None:
        """Friction, gears and mount of the day, preloads, and the servo's tick with the world."""
        m, day = self.bench.m, self.chances.today(1)
        for fault in self.faults:
            press_shut(m, "seat", fault)
        friction = np.ones(len(self.sheet.joints))
        if self.chances.day:
            friction += 0.15 * day.uniform(-1, 1, len(friction))
            gears = [j for j in range(m.njnt) if m.joint(j).name.startswith("flex_")]
            m.jnt_stiffness[gears] *= 1 + 0.03 * day.uniform(-1, 1, len(gears))
            site = m.site("tool").id
            m.site_quat[site] = physics.turned(
                m.site_quat[site], physics.rotation_off(day, 0.3, 0.7)
            )
        servo = self.bench.tick
        self._force: Array | None = None
        self._ground: Array | None = None
        body = m.body(self.sheet.bodies[self.world.cable_body]).id

        def tick(k: int, data: Any, wanted: Any, first: bool, rng: Any) -> None:
            servo(k, data, wanted, first, rng)
            m.dof_frictionloss[self.bench.va] *= friction
            if k >= 0 and not first:
                if self._force is not None:
                    data.xfrc_applied[body, :3] = self._force[k]
                if self._ground is not None:
                    m.opt.gravity[:] = GRAVITY - self._ground[k]

        self.bench.tick = tick

    def play(self, pose: Array, command: Array, rate: float, run: int) -> Played:
        """Move to a pose and follow a command given at a rate [Hz]."""
        world, rng, bench = self.world, self.chances.today(3, run), self.bench
        target = np.array(pose, float)
        wanted, _ = physics.resampled(command, rate, self.sheet, 1000.0, target)
        count, inside = len(wanted), round(1e-3 / STEP)
        force, ground = physics.outside(world, self.sheet, rng, count * inside, run)
        bench.m.opt.gravity[:] = GRAVITY
        self._force = None if force is None else force.reshape(count, inside, 3).mean(axis=1)
        self._ground = None if ground is None else ground[::inside]
        acceleration, motor, link, torque = bench.simulate(
            target, lambda k: wanted[k] if k >= 0 else target, count,
            settle_ms=round(1000 * physics.SETTLE), rng=rng,
        )  # fmt: skip
        if not np.isfinite(acceleration).all() or np.abs(acceleration).max() > 3000:
            raise InvalidData(f"{self.sheet.name}: the simulation of run {run} diverged")
        keep = round(1000 / self.sheet.log_hz)
        moved = {name: values[1] for name, values in bench.last.items()}
        travel = {
            f.name: moved["seat" if f.direction is not None else f"play_{f.at}"] / f.clearance
            for f in self.faults
        }
        return Played(
            acceleration=acceleration, motor=motor[::keep], link=link[::keep],
            torque=torque[::keep], travel=travel,
        )  # fmt: skip
