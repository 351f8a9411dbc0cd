"""Runs that are played: poses, shaken joints, bands and levels as a plan would have them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import mujoco
import numpy as np

from scripts.suites.machines.arms import STEP, Arm, Array, Fault, nominal_xml
from scripts.suites.machines.disturbances import Disturbances

SHARES = (0.08, 0.3)
"""Rms torque of the excitation over the limit, log-uniform."""
MOST_TOOL = 15.0
"""Rms acceleration of the tool that a plan would ask for at most [m/s²]."""
CHOSEN, CANDIDATES = 0.6, 30
"""Probability of a pose chosen among random ones, and their number: a plan chooses poses in which
gravity leaves seats open. Healthy cases have the poses of a fault that is not there."""
PEAK, CREST = 0.9, 3.5
"""Peak torque over the limit, and over its rms, that a plan would allow."""
SETTLE, RISE = 0.4, 0.15
"""Time at rest, and of the rising noise, before the record begins [s]."""
AFTER = 0.02
"""Time simulated after the record [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class CaseSettings:
    """Size of a recording."""

    runs: int = 6
    """Suspect runs, and healthy ones where there are any."""
    poses: int = 3
    """Poses among them."""
    seconds: float = 1.2
    """Length of a run [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunPlan:
    """A run to play."""

    pose: Array
    """Pose [rad] (n,)."""
    joint: int
    """Joint that is shaken."""
    noise: Array
    """Noise of rms one by integration step (T,)."""
    level: float
    """Rms of the excitation [rad, N m of torque motors]."""


def draw_plans(
    arm: Arm, fault: Fault, disturbances: Disturbances, rate: float, settings: CaseSettings,
    rng: np.random.Generator, quiet: float,
) -> tuple[RunPlan, ...]:  # fmt: skip
    """Draw poses, joints, noise and level of the runs of a case.

    Parameters
    ----------
    arm : Arm
        Its gains and limits bound the level.
    fault : Fault
        The one that poses are chosen for, also where it is not there.
    disturbances : Disturbances
        The servo's rate bounds the band.
    rate : float
        Sampling rate of the recorder [Hz].
    settings : CaseSettings
        Runs, poses and their length.
    rng : Generator
        Of the draw.
    quiet : float
        Factor on the level.
    """
    servo = disturbances.size("sampled_servo", "rate", 1 / STEP)
    n = arm.joints
    high = min(float(rng.uniform(60.0, 90.0)), 0.35 * rate, 0.2 * servo)
    band = (float(rng.uniform(6.0, 12.0)), high)
    share = float(np.exp(rng.uniform(*np.log(SHARES))))
    joints = rng.permutation(n)[: max(1, settings.runs // settings.poses)]
    count = round((SETTLE + RISE + settings.seconds + AFTER) / STEP)
    plans: list[RunPlan] = []
    load = _load(arm, fault)
    pose = np.zeros(n)
    for i in range(settings.runs):
        if i % len(joints) == 0:
            tried = CANDIDATES if rng.random() < CHOSEN else 1
            pose = min(rng.uniform(-1.3, 1.3, (tried, n)), key=load)
        joint = int(joints[i % len(joints)])
        noise = _noise(band, count, rng)
        torque = share * arm.limit[joint]
        torque *= min(1.0, MOST_TOOL / max(_moved(arm, pose, joint) * torque, 1e-9))
        spare = PEAK * arm.limit[joint] - abs(weight_of(arm, pose)[joint])
        torque = max(min(torque, spare / CREST), 0.02 * arm.limit[joint])
        level = quiet * torque / (arm.kp[joint] if arm.servoed else 1.0)
        plans.append(RunPlan(pose=pose, joint=joint, noise=noise, level=level))
    return tuple(plans)


def _load(arm: Arm, fault: Fault) -> Callable[[Array], float]:
    """Weight that keeps a fault shut, as a function of the pose; only its order counts."""
    model = mujoco.MjModel.from_xml_string(nominal_xml(arm))
    data = mujoco.MjData(model)
    body = model.body(f"link{fault.link + 1}").id

    def load(pose: Array) -> float:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        if fault.kind == "backlash":
            return float(abs(data.qfrc_bias[fault.link]))
        return float(abs(data.xmat[body].reshape(3, 3)[2] @ fault.direction))

    return load


def _noise(band: tuple[float, float], count: int, rng: np.random.Generator) -> Array:
    """Band-limited Gaussian noise of rms one that rises after the time at rest."""
    spectrum = np.fft.rfft(rng.normal(size=2 * count))
    frequency = np.fft.rfftfreq(2 * count, STEP)
    spectrum[(frequency < band[0]) | (frequency > band[1])] = 0
    noise = np.fft.irfft(spectrum)[:count]
    time = np.arange(count) * STEP
    swell = np.clip((time - SETTLE) / (0.7 * RISE), 0, 1)
    return np.asarray(swell * noise / noise.std())


def _moved(arm: Arm, pose: Array, joint: int) -> float:
    """Acceleration of the tool per torque of a joint, the others held [m/s²/(N m)]."""
    model = mujoco.MjModel.from_xml_string(nominal_xml(arm))
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("tool").id)
    return float(np.linalg.norm(jacobian[:, joint]) / full[joint, joint])


def weight_of(arm: Arm, pose: Array) -> Array:
    """Torques that hold the arm's weight by its model [N m]."""
    model = mujoco.MjModel.from_xml_string(nominal_xml(arm))
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    return np.array(data.qfrc_bias)
