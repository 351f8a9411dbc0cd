"""A result with its corrected model, as `loose gap` writes them, made without a search."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.drives import ActuatorGain, ActuatorLag, CommandDelay
from loose_env.gap.model.effects.elasticity import Backlash
from loose_env.gap.model.effects.joints import (
    CoulombFriction,
    QuadraticDrag,
    RotorInertia,
    StribeckFriction,
    ViscousFriction,
)
from loose_env.gap.model.effects.sensors import SensorDelay, SensorGain
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.corrected_model import write_model
from loose_env.gap.output.result import Gap, GapResult, NamedEffect

ARM = """<mujoco model="arm"><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.1" frictionloss="0.2"
    armature="0.01"/><geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1"/>
    <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.6"/>
      <body name="hand" pos="0 0 -0.25"><joint name="wrist" axis="0 0 1" damping="0.02"/>
        <geom type="box" size="0.03 0.02 0.04" mass="0.2"/></body></body></body>
  </worldbody><actuator>
  <position name="servo1" joint="shoulder" kp="40" kv="2" forcerange="-8 8"/>
  <position name="servo2" joint="elbow" kp="10" kv="0.5" gear="2" forcerange="-3 3"/>
  </actuator><sensor><jointpos name="encoder1" joint="shoulder"/>
  <jointpos name="encoder2" joint="elbow"/></sensor></mujoco>"""
"""Two servoed joints and one without a drive."""

Sized = tuple[type[Effect], str, tuple[float, ...]]

EFFECTS: tuple[Sized, ...] = (
    (ViscousFriction, "shoulder", (0.3,)),
    (CoulombFriction, "shoulder", (0.4,)),
    (StribeckFriction, "elbow", (0.1, 1.6, 0.25)),
    (RotorInertia, "elbow", (0.004,)),
    (QuadraticDrag, "wrist", (0.06,)),
    (ActuatorGain, "servo2", (0.8,)),
    (CommandDelay, "all", (0.012,)),
    (SensorDelay, "encoder1", (0.005,)),
    (SensorGain, "encoder2", (1.05,)),
    (Backlash, "wrist", (0.02, 40.0, 0.2)),
)
"""Effects that the arm's result names, with their values."""


def machine_of(xml: str = ARM) -> NominalModel:
    return NominalModel(mujoco.MjSpec.from_string(xml))


def write_result(
    folder: Path, effects: Sequence[Sized] = EFFECTS, *, xml: str = ARM, share: float = 0.1
) -> GapResult:
    """Write result.json and model.xml; the intervals reach a share of the values to each side."""
    machine, pairs, named = machine_of(xml), [], []
    for kind, where, values in effects:
        effect = kind(machine, where)
        names = [p.name for p in effect.parameters]
        given = values[: len(names)]
        pairs.append((effect, np.array(given)))
        named.append(
            NamedEffect(
                kind=effect.kind,
                where=where,
                parameters=dict(zip(names, given, strict=True)),
                interval_95={
                    n: (v - share * abs(v), v + share * abs(v))
                    for n, v in zip(names, given, strict=True)
                },
                units={p.name: p.unit for p in effect.parameters},
                variant=effect.variant,
                in_model=effect.in_model,
            )
        )
    folder.mkdir(parents=True, exist_ok=True)
    write_model(folder / "model.xml", machine, Hypothesis().with_effects(pairs))
    result = GapResult(verdict="named", gap=Gap(before=9.0, after=1.0), effects=tuple(named))
    result.write(folder / "result.json")
    return result


LAG: Sized = (ActuatorLag, "servo1", (0.02,))
"""An effect that no target expresses."""
