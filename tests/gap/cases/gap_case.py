"""A small finished comparison, made without a search: an arm that lacks viscous friction."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np

from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.holdout_score import Scorer
from loose_env.gap.fitting.model_structure import ModelStructure, Nuisance
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.friction import ViscousFriction
from loose_env.gap.model.effects.sensors import SensorGain
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.nominal_parameters import NominalParameters
from loose_env.gap.model.parameter import free_of
from loose_env.gap.output.result import EffectLocation, NamedEffect, RankedHypothesis
from loose_env.gap.residuals.preparation.prepare import GapProblem
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.pipeline import GapSolution
from loose_env.recording import Recording, Run, write_recording
from loose_env.statistics import noise_floor
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR

DAMPING, GAIN = 3.0, 1.25
"""What the recorded arm has beyond its model: at joint2 [N·m·s/rad], and of the sensor rate3."""
STEP, COUNT = 0.002, 1100
MODEL = PLANAR.replace('timestep="0.001"', 'timestep="0.002"').replace(
    'integrator="implicitfast"', 'integrator="RK4"'
)


def model_with(suffix: str) -> str:
    """The model whose joints, links, servos and sensors have names with a suffix."""
    return re.sub(
        r'"((?:joint|link|servo|encoder|rate)\d|shake)"', lambda m: f'"{m[1]}{suffix}"', MODEL
    )


def record(
    folder: Path,
    *,
    runs: int = 3,
    suffix: str = "",
    missing: bool = True,
    edit: Callable[[mujoco.MjSpec], None] = lambda spec: None,
) -> Recording:
    """Write a recording of an arm with noise, with the two effects if missing, and an edit."""
    xml = model_with(suffix)
    spec = mujoco.MjSpec.from_string(xml)
    spec.joint(f"joint2{suffix}").damping = np.array([0.5 + DAMPING * missing, 0, 0])
    edit(spec)
    model = spec.compile()
    time = np.arange(COUNT) * STEP
    rng = np.random.default_rng(8)
    found = []
    for k in range(runs):
        data = mujoco.MjData(model)
        controls = 0.5 * np.sin(np.outer(time, [2.0 + k, 3.3 + 0.7 * k, 5.1 - k]))
        controls *= np.minimum(2 * time, 1.0)[:, None]
        shown = np.zeros((COUNT, model.nsensordata))
        for row, command in zip(shown, controls, strict=True):
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
            row[:] = data.sensordata
        shown[:, 3] *= GAIN if missing else 1.0
        shown += rng.normal(0, [2e-5, 2e-5, 2e-5, 2e-3, 0.02, 0.02, 0.02], shown.shape)
        names = [f"{name}{suffix}" for name in ("encoder1", "encoder2", "encoder3", "rate3")]
        found.append(
            Run(
                name=f"run-{k + 1:02d}.csv",
                time=time,
                controls={f"servo{j + 1}{suffix}": controls[:, j] for j in range(3)},
                sensors={n: shown[:, j] for j, n in enumerate(names)}
                | {f"shake{suffix}": shown[:, 4:]},
            )
        )
    return write_recording(folder, model_xml=xml, runs=found, file_format="csv")


def stated(comparison: ResidualModel, effects: Sequence[Effect], values: Sequence[Array]) -> Fit:
    """Effects beside the nominal parameters as they are, stated and not searched for."""
    nominal = NominalParameters(comparison.machine, tolerance=0.03)
    structure = ModelStructure(nuisance=Nuisance(nominal=nominal)).with_effects(effects)
    own = [free_of(e.parameters, v) for e, v in zip(effects, values, strict=True)]
    free = np.concatenate([structure.nominal_start, *own])
    residual = comparison.residuals([structure.hypothesis(free)])[0]
    return Fit(
        structure=structure,
        free=free,
        residual=residual,
        jacobian=np.zeros((len(residual), len(free))),
        cost=float(residual @ residual),
    )


def solution_for(recording: Recording, *, suffix: str = "") -> GapSolution:
    """The comparison as a search would have ended; the last run is held out."""
    machine = NominalModel(recording.spec(), step=STEP)
    channels = channels_of(list(recording.runs))
    trials = [align_run(run, machine, channels, step=STEP) for run in recording.runs]
    floors = np.array(
        [np.median([noise_floor(t.measured[:, c]) for t in trials]) for c in range(len(channels))]
    )
    fitted = ResidualModel(machine, trials[:-1], channels, floors, threads=1)
    held = ResidualModel(machine, trials[-1:], channels, floors, threads=1)
    scorer = Scorer(fitted, held)
    friction, gain = (
        ViscousFriction(machine, f"joint2{suffix}"),
        SensorGain(machine, f"rate3{suffix}"),
    )
    values = [np.array([DAMPING]), np.array([GAIN])]
    return GapSolution(
        problem=GapProblem(
            settings=GapSettings(tolerance=0.03, seed=1, threads=1), machine=machine,
            integration=None, search=fitted, fit=fitted, held_out=held, held_out_whole=held,
            recording=recording.folder.name, model_path=recording.model_path,
        ),
        base=scorer.score(stated(fitted, [], [])),
        best=scorer.score(stated(fitted, [friction, gain], values)),
        verdict="named",
        effects=(
            NamedEffect(
                kind="viscous_friction", where=f"joint2{suffix}", parameters={"damping": DAMPING},
                interval_95={"damping": (2.9, 3.1)}, units={"damping": "N·m·s/rad"},
                ambiguous_with=(EffectLocation(kind="actuator_gain", where=f"servo2{suffix}"),),
            ),
            NamedEffect(
                kind="sensor_gain", where=f"rate3{suffix}", parameters={"gain": GAIN},
                interval_95={"gain": (1.24, 1.26)}, units={"gain": ""}, in_model=False,
            ),
        ),
        ranking=(
            RankedHypothesis(
                kind="viscous_friction", where=f"joint2{suffix}", held_out=3.1, bic=-300.0,
                improvement_z=12.0
            ),
            RankedHypothesis(
                kind="coulomb_friction", where=f"joint2{suffix}", held_out=9.0, bic=-20.0,
                improvement_z=2.0
            ),
            RankedHypothesis(
                kind="sensor_gain", where=f"rate3{suffix}", held_out=1.0, bic=-90.0,
                step=2, improvement_z=9.0
            ),
        ),
        warnings=("the step is coarse",),
    )  # fmt: skip
