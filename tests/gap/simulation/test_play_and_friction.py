"""Friction behind play, in measured torques: a damper with slack."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.simulation.inverse_dynamics import InverseDynamics
from loose_env.recording import Run
from loose_env.typing import Array

DAMPER = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0" integrator="RK4"/>
  <worldbody>
    <body name="rod">
      <joint name="stroke" type="slide" axis="1 0 0"/>
      <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/>
    </body>
  </worldbody>
  <sensor><jointpos name="place" joint="stroke"/></sensor>
</mujoco>
"""
GAP, FRICTION, COUNT = 4e-3, 12.0, 4000


def played(place: Array) -> Array:
    """Position of what lies beyond the play and is held by friction: the play operator."""
    found = np.empty_like(place)
    at = place[0]
    for k, p in enumerate(place):
        at = min(max(at, p - GAP / 2), p + GAP / 2)
        found[k] = at
    return found


def test_a_damper_with_slack_gives_no_force_in_the_gap_and_its_friction_beyond() -> None:
    rng = np.random.default_rng(3)
    time = 1e-3 * np.arange(COUNT)
    place = 0.02 * np.sin(2 * np.pi * 0.5 * time) + 0.008 * np.sin(2 * np.pi * 1.1 * time + 1.0)
    speed = np.gradient(played(place), 1e-3)
    force = np.where(np.abs(speed) > 1e-9, FRICTION * np.sign(speed), 0.0)
    run = Run(
        name="run-1",
        time=time,
        sensors={"place": place + 1e-6 * rng.normal(size=COUNT)},
        torques={"stroke": force + 0.05 * rng.normal(size=COUNT)},
    )
    machine = NominalModel(
        mujoco.MjSpec.from_string(DAMPER), loads=np.array([FRICTION]), speeds=np.array([0.06])
    )
    channels = channels_of([run])
    inverse = InverseDynamics(
        machine, [align_run(run, machine, channels, step=1e-3)], channels, threads=1
    )
    play = CATALOGUE["backlash"](machine, "stroke", "rubbing")
    assert inverse.shows(play)
    stiffness = play.parameters[1].high
    slack = Hypothesis(effects=(play,), values=(np.array([GAP, stiffness, 0.5, FRICTION]),))
    friction = CATALOGUE["coulomb_friction"](machine, "stroke")
    firm = Hypothesis(effects=(friction,), values=(np.array([FRICTION]),))
    measured, torque = inverse.measured(0), [c.column for c in channels].index("torque.stroke")
    (nothing,), (shown,), (tight,) = inverse.predict([Hypothesis(), slack, firm])
    none, both, alone = (
        float(np.sqrt(np.nanmean((each - measured)[:, torque] ** 2)))
        for each in (nothing, shown, tight)
    )
    assert alone > 0.5 * none  # without the slack a friction explains little
    assert both < 0.3 * none
