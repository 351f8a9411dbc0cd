"""A drive without input: what MuJoCo's motor model knows about friction and cogging."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

__all__ = ["add_passive_drive"]

_OPEN_CIRCUIT = 1e12
"""Resistance at which no current brakes the rotor [ohm]."""


def add_passive_drive(
    spec: mujoco.MjSpec,
    joint: str,
    name: str,
    *,
    cogging: Sequence[float] = (0.0, 0.0, 0.0),
    lugre: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
) -> None:
    """Add a drive to a joint, after the model's own actuators and without a command.

    Parameters
    ----------
    spec : MjSpec
        The model.
    joint, name : str
        The joint; the drive.
    cogging : sequence of 3 floats
        Amplitude A [N·m], N and phase of the torque A sin(N q + phase).
    lugre : sequence of 5 floats
        Bristle stiffness [N·m/rad] and damping [N·m·s/rad], Coulomb and static torque [N·m],
        Stribeck speed [rad/s].
    """
    drive = spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    # The model's defaults are not meant for this one.
    drive.forcelimited = drive.ctrllimited = drive.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
    drive.gear = [1, 0, 0, 0, 0, 0]
    drive.dynprm, drive.gainprm, drive.biasprm = np.zeros(10), np.zeros(10), np.zeros(10)
    drive.damping, drive.armature = np.zeros_like(drive.damping), 0.0
    drive.delay, drive.nsample = 0.0, 0
    drive.set_to_dcmotor(
        motorconst=[1.0, 0.0],
        resistance=_OPEN_CIRCUIT,
        cogging=list(np.asarray(cogging, dtype=float)),
        lugre=list(np.asarray(lugre, dtype=float)),
        ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_NONE),
    )
