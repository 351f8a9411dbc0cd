"""Generated runs of an arm: simulated where the model allows it, then damaged as recorders do."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from hypothesis import strategies as st

from loose_env.recording import Run
from loose_env.typing import Array

__all__ = ["DAMAGES", "RunPlan", "make_run", "run_plans"]

DAMAGES = (
    "quantised", "stuck", "saturated", "corrupt", "mostly corrupt", "missing", "noisy", "degrees",
)  # fmt: skip
"""Faults of a channel."""
_CLOCKS = (*["even"] * 9, "uneven", "uneven", "pause", "pause", "jump", "duplicate", "backwards")
_FASTEST = 50.0
"""Largest simulated speed that counts as motion of an arm [rad/s, m/s]."""


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """Recipe of a run."""

    seed: int
    rate: float
    """Samples per second."""
    samples: int
    clock: str
    """Defect of the time stamps; "even" has none."""
    columns: str
    """"ctrl", "torque", "both" or "free"."""
    damages: tuple[str, ...]
    """Faults of channels, each of a channel chosen by the seed."""
    without: float
    """Share of columns left out."""
    still: bool
    """Whether nothing moves."""


def run_plans() -> st.SearchStrategy[RunPlan]:
    """Recipes of runs from 5 Hz to 20 kHz."""
    return st.builds(
        RunPlan,
        seed=st.integers(0, 2**31),
        rate=st.sampled_from([5.0, 20.0, 50.0, 190.0, 500.0, 1000.0, 4000.0, 20000.0]),
        samples=st.sampled_from([10, 40, 150, 400, 1000, 1000, 3000]),
        clock=st.sampled_from(_CLOCKS),
        columns=st.sampled_from(["ctrl", "ctrl", "torque", "both", "free"]),
        damages=st.one_of(
            st.just(()), st.lists(st.sampled_from(DAMAGES), min_size=1, max_size=2).map(tuple)
        ),
        without=st.sampled_from([0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.8]),
        still=st.sampled_from([False, False, False, False, True]),
    )


def make_run(model: mujoco.MjModel, plan: RunPlan, number: int) -> Run:
    """Make the run of a recipe; the same recipe and model give the same run."""
    rng = np.random.default_rng([plan.seed, number])
    time = np.arange(plan.samples) / plan.rate
    controls, readings, torques = _simulated(model, plan, time, rng)
    columns = {f"ctrl.{name}": v for name, v in controls.items()}
    columns |= {f"sensor.{name}": v for name, v in readings.items()}
    columns |= {f"torque.{name}": v for name, v in torques.items()}
    for damage in plan.damages:
        name = str(rng.choice(list(columns)))
        columns[name] = _damaged(columns[name], damage, rng)
    for name in list(columns):
        if len(columns) > 1 and rng.random() < plan.without:
            del columns[name]

    def group(prefix: str) -> dict[str, Array]:
        head = f"{prefix}."
        return {n.removeprefix(head): v for n, v in columns.items() if n.startswith(head)}

    return Run(
        name=f"run-{number}.csv",
        time=_stamped(time, plan, rng),
        controls=group("ctrl") if plan.columns in ("ctrl", "both") else {},
        sensors=group("sensor"),
        torques=group("torque") if plan.columns in ("torque", "both") else {},
    )


def _simulated(
    model: mujoco.MjModel, plan: RunPlan, time: Array, rng: np.random.Generator
) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """Commands, readings and joint torques at the times (T,), with noise."""
    count = len(time)
    sines = np.array(
        [
            np.sin(2 * np.pi * np.outer(time, rng.uniform(0.3, 3, 3)) + rng.uniform(0, 6, 3)).sum(1)
            for _ in range(max(model.nu, model.nv))
        ]
    ).T * (0.0 if plan.still else 0.3)
    data = mujoco.MjData(model)
    most = 4000
    every = max(float(time[-1]) / most, float(model.opt.timestep))
    model.opt.timestep = min(every, 0.004)
    read = np.zeros((count, model.nsensordata))
    torque = np.zeros((count, model.nv))
    for k, now in enumerate(time):
        data.ctrl[: model.nu] = sines[k, : model.nu]
        for _ in range(max(0, round((now - data.time) / model.opt.timestep))):
            if not plan.still:
                mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        diverged = data.time < now - 2 * model.opt.timestep  # the engine began anew
        if diverged or np.abs(data.qvel).max(initial=0) > _FASTEST:
            mujoco.mj_resetData(model, data)
            data.time = now
            mujoco.mj_forward(model, data)
        read[k] = data.sensordata
        torque[k] = data.qfrc_actuator + data.qfrc_applied
    read += 1e-4 * (1 + np.abs(read).max(axis=0)) * rng.normal(size=read.shape)
    torque += 0.1 * sines[:, : model.nv] + 1e-3 * rng.normal(size=torque.shape)
    controls = {model.actuator(a).name: sines[:, a] for a in range(model.nu)}
    readings = {}
    for s in range(model.nsensor):
        at, width = int(model.sensor_adr[s]), int(model.sensor_dim[s])
        values = read[:, at : at + width]
        readings[model.sensor(s).name] = values[:, 0] if width == 1 else values
    joints = [j for j in range(model.njnt) if int(model.jnt_type[j]) in (2, 3)]
    torques = {model.joint(j).name: torque[:, int(model.jnt_dofadr[j])] for j in joints}
    return controls, readings, torques


def _damaged(values: Array, damage: str, rng: np.random.Generator) -> Array:
    values = np.array(values)
    size = float(np.ptp(values)) or 1.0
    some = rng.random(len(values)) < 0.03
    absurd = rng.choice([1e282, -1e30, 1e9, 1e5])
    if damage == "quantised":
        return np.asarray(np.round(values / (size / 8)) * (size / 8))
    if damage == "stuck":
        values[:] = values[0]
    elif damage == "saturated":
        values = np.clip(values, values.min() + size / 4, values.max() - size / 4)
    elif damage == "corrupt":
        values[some] = absurd
    elif damage == "mostly corrupt":
        values[rng.random(len(values)) < 0.7] = absurd
    elif damage == "missing":
        values[some] = np.nan
    elif damage == "noisy":
        values += size * rng.normal(size=values.shape)
    else:
        values *= 180 / np.pi
    return values


def _stamped(time: Array, plan: RunPlan, rng: np.random.Generator) -> Array:
    time, middle = time.copy(), len(time) // 2
    if plan.clock == "uneven":
        time += rng.uniform(-0.4, 0.4, len(time)) / plan.rate
    elif plan.clock == "pause":
        time[middle:] += rng.choice([0.5, 30.0])
    elif plan.clock == "jump":
        time[middle:] += rng.choice([1e5, 1.7e9, 1e15])
    elif plan.clock == "duplicate":
        time[middle] = time[middle - 1]
    elif plan.clock == "backwards":
        time[middle:] -= 2.5 / plan.rate
    return time
