"""Coupled joints, closed loops and tendons: positions, forces, and a fault found among them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap import GapSettings, solve_gap
from loose_env.gap.core.followers import Followers
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Recording, Run, write_recording

HEAD = '<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>'
ARM = """<worldbody><body><inertial pos="0.15 0 0" mass="1.5" diaginertia="0.002 0.01 0.01"/>
  <joint name="a" axis="0 1 0" damping="0.3" armature="0.05" frictionloss="{friction}"/>
  <body pos="0.3 0 0"><inertial pos="0.12 0 0" mass="0.8" diaginertia="0.001 0.005 0.005"/>
    <joint name="b" axis="0 1 0" damping="0.2" armature="0.03"/></body></body></worldbody>"""
ENCODERS = '<jointpos name="a_pos" joint="a"/>{b}'
MIMIC = (
    HEAD
    + ARM
    + """<equality><joint joint1="b" joint2="a" polycoef="0.1 0.5 0.2 0 0"/></equality>
<actuator><position name="a" joint="a" kp="200" kv="8"/></actuator>
<sensor><jointpos name="a_pos" joint="a"/></sensor></mujoco>"""
)
TENDON = (
    HEAD
    + ARM
    + """<tendon><fixed name="both"><joint joint="a" coef="1"/><joint joint="b"
 coef="0.5"/></fixed></tendon><actuator><position name="both" tendon="both" kp="200" kv="8"/>
<position name="b" joint="b" kp="120" kv="5"/></actuator><sensor><jointpos name="a_pos" joint="a"/>
<jointpos name="b_pos" joint="b"/></sensor></mujoco>"""
)
LOOP = (
    HEAD
    + """<worldbody><body name="crank"><joint name="crank" axis="0 1 0" damping="0.5"
 armature="0.1" frictionloss="{friction}"/>
 <inertial pos="0.05 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
 <body name="rod" pos="0.1 0 0"><joint name="rod" axis="0 1 0" damping="0.02"/>
  <inertial pos="0.15 0 0" mass="1" diaginertia="0.001 0.01 0.01"/><site name="end" pos="0.3 0 0"/>
 </body></body><body name="slider" pos="0.4 0 0"><joint name="slider" type="slide" axis="1 0 0"
 damping="2"/><inertial pos="0 0 0" mass="3" diaginertia="0.01 0.01 0.01"/><site name="pin"/></body>
</worldbody><equality><connect name="loop" site1="end" site2="pin"/></equality>
<actuator><position name="crank" joint="crank" kp="300" kv="15"/></actuator>
<sensor><jointpos name="crank_pos" joint="crank"/></sensor></mujoco>"""
)


def recorded(folder: Path, xml: str, friction: float) -> Recording:
    """Two runs of a machine with dry friction, and the model without it."""
    runs = []
    for seed in range(2):
        model = mujoco.MjModel.from_xml_string(xml.format(friction=friction))
        data, rng, rows = mujoco.MjData(model), np.random.default_rng(seed), []
        turn = 2 * np.pi * rng.uniform(0.1, 1.0, (model.nu, 3))
        phase = rng.uniform(0, 6, (model.nu, 3))
        for k in range(6_000):
            swing = np.sin(turn * data.time + phase) - np.sin(phase)
            data.ctrl[:] = 0.25 * min(1.0, data.time) * swing.sum(axis=1)
            if k % 4 == 0:
                noisy = data.sensordata + rng.normal(0, 3e-5, model.nsensordata)
                rows.append(np.concatenate([[data.time], data.ctrl, noisy]))
            mujoco.mj_step(model, data)
        time, *columns = np.array(rows).T
        drives = [model.actuator(k).name for k in range(model.nu)]
        sensors = [model.sensor(k).name for k in range(model.nsensor)]
        runs.append(Run(
            name=f"run{seed}", time=time, controls=dict(zip(drives, columns, strict=False)),
            sensors=dict(zip(sensors, columns[model.nu :], strict=True)),
        ))  # fmt: skip
    return write_recording(folder, model_xml=xml.format(friction=0), runs=runs)


@pytest.mark.parametrize(
    ("xml", "joint", "friction"),
    [(MIMIC, "a", 1.5), (TENDON, "a", 1.5), (LOOP, "crank", 2.0)],
    ids=["mimic", "tendon", "loop"],
)
def test_dry_friction_is_found_beside_followers_and_tendons(
    tmp_path: Path, xml: str, joint: str, friction: float
) -> None:
    kinds = ("coulomb_friction", "viscous_friction", "actuator_gain", "payload", "command_delay")
    found = solve_gap(
        recorded(tmp_path, xml, friction), GapSettings(kinds=kinds, simulate=False)
    ).result
    assert [(e.kind, e.where) for e in found.effects] == [("coulomb_friction", joint)]
    assert found.effects[0].parameters["torque"] == pytest.approx(friction, rel=0.05)


def test_followers_are_placed_on_the_loop_and_their_speeds_follow() -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(LOOP.format(friction=0)))
    followers = Followers.of(machine, {"crank"})
    assert [machine.joints[k] for k in followers.numbers] == ["rod", "slider"]
    crank = np.linspace(-0.8, 0.8, 161)
    position = np.stack([crank, np.full(161, np.nan), np.full(161, np.nan)], axis=1)
    followers.fill("run", position, (1, 2))
    rod = -np.arcsin(np.sin(crank) / 3)  # crank of 0.1 m, rod of 0.3 m
    assert position[:, 1] == pytest.approx(rod - crank, abs=1e-6)
    slide = 0.1 * np.cos(crank) + 0.3 * np.cos(rod) - 0.4
    assert position[:, 2] == pytest.approx(slide, abs=1e-6)
    speeds = np.gradient(position[:, 1:], crank, axis=0)
    assert followers.paths(position)[1:-1, :, 0] == pytest.approx(speeds[1:-1], abs=1e-3)


def test_a_joint_that_nothing_carries_needs_a_reading(tmp_path: Path) -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(MIMIC.format(friction=0)))
    position = np.full((20, 2), np.nan)
    with pytest.raises(InvalidData, match="run: joint 'b' has no position reading"):
        Followers.of(machine, {"b"}).fill("run", position, (0, 1))  # a follows b here
    loop = NominalModel(mujoco.MjSpec.from_string(LOOP.format(friction=0)))
    apart = np.array([[0.0, np.nan, 0.2]] * 12)
    with pytest.raises(InvalidData, match=r"do not close .* by 0\.\d+ m or rad; they place rod"):
        Followers.of(loop, {"crank", "slider"}).fill("run", apart, (1,))
