"""Stiffness of compliant joints from measured torques, as starting values of their fits.

Behind a compliant joint the link is where the joint is read, less the torque behind its rotor over
the stiffness (Spong, J. Dyn. Syst. Meas. Control 109, 1987, 310, solved for what is measured). What
the arm then needs less than for the measured motion is linear in a small compliance, resonance
included: that finds springs that ring, of which a simulation has to begin near the true frequency.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np

from loose_env.gap.data.smoothing import filled
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.simulation.inverse_dynamics import InverseDynamics
from loose_env.typing import Array

_SMALL = 1e-4
"""Deflection by which torques are differentiated [rad, m]."""


def joint_stiffness(comparison: ResidualModel, hypothesis: Hypothesis) -> dict[str, float]:
    """Stiffness of each joint that would explain most of the residual torques by itself."""
    inverse, machine = comparison.inverse, comparison.machine
    if inverse is None:
        return {}
    rigid = [(effect, values) for effect, values in hypothesis.pairs if not effect.adds_motion]
    known = hypothesis.with_effects(rigid)
    model = known.model(machine, machine.time_step)
    predicted = inverse.predict([known])[0]
    along, sizes = np.zeros((2, len(machine.joints)))
    for t, (trial, motion) in enumerate(zip(inverse.trials, inverse.motions, strict=True)):
        read = np.atleast_1d(np.isfinite(trial.measured).any(axis=0))  # torques of this run
        residual = inverse.measured(t)[motion.chosen] - predicted[t][motion.chosen]
        weight = 1.0 / inverse.floors(t) ** 2
        for own_channel, joint in inverse.torque_joints.items():
            if not read[own_channel]:
                continue
            change = _change(inverse, model, t, own_channel)
            for channel, other in inverse.torque_joints.items():
                good = np.isfinite(residual[:, channel])
                own = change[good, other]
                if good.any():
                    along[joint] += weight[channel] * float(own @ residual[good, channel])
                    sizes[joint] += weight[channel] * float(own @ own)
    return {
        name: float(size / gain)
        for name, gain, size in zip(machine.joints, along, sizes, strict=True)
        if gain > 0
    }


def _change(inverse: InverseDynamics, model: mujoco.MjModel, run: int, channel: int) -> Array:
    """Change of the torques (E, joints) per compliance of a channel's joint, where compared."""
    motion, trial, joint = inverse.motions[run], inverse.trials[run], inverse.torque_joints[channel]
    measured = filled(trial.time, trial.measured[:, channel], motion.time)
    spring = motion.band.smooth(measured)
    rotor = model.dof_armature[joint] * motion.acceleration[:, joint]
    spring = spring - rotor - model.dof_damping[joint] * motion.speed[:, joint]
    interval = float(motion.time[1])
    once = np.gradient(spring, interval)
    unit = _SMALL / max(float(np.std(spring)), 1e-12)
    parts = [motion.position.copy(), motion.speed.copy(), motion.acceleration.copy()]
    for part, change in zip(parts, (spring, once, np.gradient(once, interval)), strict=True):
        part[:, joint] -= unit * change
    moved = replace(motion, position=parts[0], speed=parts[1], acceleration=parts[2])
    link = copy.copy(model)  # rotor and bearing stay on the motor's side
    link.dof_armature[joint] = link.dof_damping[joint] = 0.0
    shifted, still = inverse.rigid(link, [moved, motion])
    return np.asarray((shifted - still) / unit)
