"""Preparation of a recording (GapProblem): alignment, hold-out split, windows, step, noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.gap.data.aligned_run import Channel, Trial, align_run, channels_of
from loose_env.gap.data.holdout_split import split_runs
from loose_env.gap.data.measured_runs import measured_runs
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.model.effects.link_inertia import payload_notes
from loose_env.gap.model.element_names import naming_notes
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.preparation.chaotic_runs import chaotic_runs
from loose_env.gap.residuals.preparation.data_sufficiency import sufficiency_notes
from loose_env.gap.residuals.preparation.integrator_choice import Integration, choose_integration
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.residuals.windows import windows_as_runs
from loose_env.gap.settings import GapSettings
from loose_env.gap.simulation.simulator import Simulator
from loose_env.recording import Recording, Run
from loose_env.statistics import channel_floor
from loose_env.typing import Array

_FINEST = 1e-5
"""Share of what channels of a kind show to which one is taken to be read at best. A simulation
without noise is exacter, and no model of a machine is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GapProblem:
    """A recording prepared for comparison with its model."""

    settings: GapSettings
    """Settings of the comparison."""
    machine: NominalModel
    """The nominal model, with the step, typical loads and speeds of the recording."""
    integration: Integration | None
    """The step that was chosen; None where nothing is simulated."""
    search: ResidualModel
    """The training runs used in the effect search."""
    fit: ResidualModel
    """Longer training runs, used in the final fit."""
    held_out: ResidualModel
    """The held-out runs used in the effect search."""
    held_out_whole: ResidualModel
    """The held-out runs at full length."""
    warnings: tuple[str, ...] = ()
    """Notes for the reader."""
    recording: str = ""
    """Name of the recording, for the report."""
    model_path: Path | None = None
    """File of the nominal model; the meshes it refers to are copied with a corrected model."""

    @property
    def sought(self) -> list[Effect]:
        """The catalogue at every location, as far as the runs can show it."""
        kinds = self.settings.kinds or None
        return [each for each in candidates(self.machine, kinds) if self.search.shows(each)]

    def with_noise_scaled(self, factors: Array) -> GapProblem:
        """Copy with the noise of every channel scaled by a factor (C,)."""
        known: dict[int, ResidualModel] = {}

        def again(comparison: ResidualModel) -> ResidualModel:
            if id(comparison) not in known:
                floors = np.asarray(comparison.floors, dtype=float)
                known[id(comparison)] = comparison.like(floors=floors * factors)
            return known[id(comparison)]

        return replace(
            self,
            search=again(self.search),
            fit=again(self.fit),
            held_out=again(self.held_out),
            held_out_whole=again(self.held_out_whole),
        )


def prepare(recording: Recording, settings: GapSettings) -> GapProblem:
    """Align a recording with the model, choose the step, and estimate the noise."""
    recording.check_comparison()
    runs, warnings = _suspect(recording.runs)
    pieces, left_out = measured_runs(runs, recording.model())
    warnings += left_out
    whole_fitted, whole_held = split_runs(
        [run.name for run in runs], share=settings.held_share, held_out=settings.held_out
    )
    numbers = np.repeat(np.arange(len(runs)), [len(own) for own in pieces])
    fitted, held = (np.flatnonzero(np.isin(numbers, k)) for k in (whole_fitted, whole_held))
    runs = [piece for own in pieces for piece in own]
    machine = NominalModel(recording.spec())
    channels = channels_of(runs)
    warnings += naming_notes(recording.spec())
    if not settings.kinds or "payload" in settings.kinds:
        warnings += payload_notes(machine)
    integration = None
    simulated = [run for run in runs if run.comparison != "inverse"]
    step = float(machine.model.opt.timestep)
    if simulated:
        integration = choose_integration(machine, simulated, channels, threads=settings.threads)
        step = integration.step
        warnings += integration.notes(own=float(machine.model.opt.timestep))
    kept = NominalModel(
        machine.spec,
        step=step,
        integrator=None if integration is None else integration.integrator,
        merged_steps=1 if integration is None else integration.merged_steps,
        substeps=1 if integration is None else integration.substeps,
    )
    trials = [align_run(run, kept, channels, step=step) for run in runs]
    unknown, words = _of_changing_gears(kept, channels, trials)
    trials = [t if t.form == "inverse" else _without(t, unknown) for t in trials]
    warnings += words
    floors = _floors(kept, trials, channels)
    still = np.isnan(floors)
    if (said := still & ~unknown).any():
        names = ", ".join(c.name for c, left_out in zip(channels, said, strict=True) if left_out)
        warnings.append(f"{names}: constant, so that its noise is unknown; not compared")
    trials = [_without(trial, still) for trial in trials]
    kept = _scaled(kept, runs, trials, settings.threads)
    chaotic = chaotic_runs(
        kept,
        trials,
        channels,
        floors,
        candidates(kept, settings.kinds or None),
        threads=settings.threads,
    )
    if chaotic:
        warnings.append(
            f"{', '.join(sorted(chaotic))}: chaotic (impacts against stops); no simulation "
            "follows a trajectory; compared by response to the command, covariances, spectra and "
            "moments instead of sample by sample"
        )

    def compared(chosen: NDArray[np.intp]) -> ResidualModel:
        return ResidualModel(
            kept,
            [trials[k] for k in chosen],
            channels,
            floors,
            threads=settings.threads,
            chaotic=chaotic,
        )

    ahead, whole = compared(fitted), compared(held)
    for comparison, role in ((ahead, "to fit to"), (whole, "held out")):
        if not len(comparison):
            names = ", ".join(trial.name for trial in comparison.trials)
            raise InvalidData(
                f"nothing to compare in the runs {role} ({names}): what they are compared "
                "by shows one value throughout, or was not read. Record motions that are large "
                "beside the steps in which it is read"
            )
    warnings += sufficiency_notes(ahead, whole)
    return GapProblem(
        settings=settings,
        recording=recording.folder.name,
        model_path=recording.model_path,
        machine=kept,
        integration=integration,
        search=windows_as_runs(ahead, settings.search_seconds),
        fit=windows_as_runs(ahead, settings.fit_seconds),
        held_out=windows_as_runs(whole, settings.held_seconds),
        held_out_whole=whole,
        warnings=tuple(warnings),
    )


def _suspect(runs: Sequence[Run]) -> tuple[list[Run], list[str]]:
    """Select the suspect runs, or all where none is, with notes on the choice.

    A healthy run was taken before the fault, so that it lacks the fault's effects.
    """
    suspect = [run for run in runs if run.condition == "suspect"]
    healthy = [run.name for run in runs if run.condition == "healthy"]
    if not suspect or not healthy:
        return list(runs), []
    if len(suspect) == 1:
        raise InvalidData(
            f"only {suspect[0].name} is suspect, the other runs are healthy; at least two suspect "
            "runs are needed, so that one can be held out to judge by. Record another, or compare "
            "the healthy runs alone in a recording of their own"
        )
    listed = ", ".join(healthy[:4]) + (" and others" if len(healthy) > 4 else "")
    return suspect, [
        f"{len(healthy)} healthy runs are not used ({listed}): the suspect ones are compared. Put "
        "the healthy ones into a recording of their own to compare them with the model"
    ]


def _floors(machine: NominalModel, trials: list[Trial], channels: tuple[Channel, ...]) -> Array:
    """Noise standard deviation of every channel: the median over runs; NaN if unknown.

    At least `_FINEST` of the range of the channel of its kind with the most motion.
    """
    found = np.full((len(trials), len(channels)), np.nan)
    scatter = np.zeros_like(found)
    for t, trial in enumerate(trials):
        for k in range(len(channels)):
            found[t, k] = channel_floor(trial.measured[:, k])
            if len(read := trial.measured[np.isfinite(trial.measured[:, k]), k]):
                scatter[t, k] = np.std(read)
    floors = np.full(len(channels), np.nan)
    known = np.isfinite(found).any(axis=0)
    floors[known] = np.nanmedian(found[:, known], axis=0)
    kinds = [c.column if c.axis is not None else _kind(machine, c) for c in channels]
    for kind in set(kinds):
        own = np.array([each == kind for each in kinds])
        floors[own] = np.maximum(floors[own], _FINEST * np.max(scatter[:, own], initial=0.0))
    return floors


def _kind(machine: NominalModel, channel: Channel) -> str:
    """Quantity that a scalar channel measures."""
    prefix, _, name = channel.column.partition(".")
    return prefix if prefix != "sensor" else str(int(machine.model.sensor(name).type[0]))


def _of_changing_gears(
    machine: NominalModel, channels: tuple[Channel, ...], trials: list[Trial]
) -> tuple[NDArray[np.bool_], list[str]]:
    """Mask of torque channels (C,) that a simulation cannot predict, with a note.

    A simulation gives actuator forces, and the joint torques where the transmission is the same in
    all poses. Inverse dynamics give the torque itself.
    """
    columns = {f"torque.{joint}" for joint in machine.pose_dependent_joints}
    found = np.array([c.column in columns for c in channels], dtype=bool)
    read = [np.isfinite(t.measured[:, k]).any() for t in trials if t.form != "inverse"
            for k in np.flatnonzero(found)]  # fmt: skip
    if not any(read):
        return found, []
    names = ", ".join(c.name for c, left_out in zip(channels, found, strict=True) if left_out)
    return found, [
        f"{names}: an actuator acts there through a tendon in space, a site, a crank or a body, by "
        "another lever in every pose; not compared in the simulated runs. Have the model "
        "drive the joint itself, or a fixed tendon, to have it compared"
    ]


def _without(trial: Trial, channels: NDArray[np.bool_]) -> Trial:
    """Remove some channels from a run, as if they had not been read."""
    return replace(trial, measured=np.where(channels, np.nan, trial.measured))


def _scaled(
    machine: NominalModel,
    runs: list[Run],
    trials: list[Trial],
    threads: int,
) -> NominalModel:
    """Set the machine's typical speeds and torques to those of the recording."""
    speeds, loads = np.zeros((2, len(machine.joints)))
    for k, joint in enumerate(machine.joints):
        moved = [
            float(np.nanstd(np.diff(t.motion[joint]) / np.diff(t.time)))
            for t in trials
            if joint in t.motion
        ]
        moved = [speed for speed in moved if np.isfinite(speed)]
        speeds[k] = float(np.median(moved)) if moved else 0.0
        torques = [
            np.nanstd(run.torques[joint])
            for run in runs
            if joint in run.torques and np.isfinite(run.torques[joint]).any()
        ]
        loads[k] = float(np.median(torques)) if torques else 0.0
    driven = [t for t in trials if t.form == "forward"][:2]
    if driven and machine.actuators and not loads.any():
        columns = tuple(Channel(f"torque.{joint}") for joint in machine.joints)
        beginnings = [t.until(5.0) for t in driven]
        simulated = Simulator(machine, beginnings, columns, threads=threads).predict(
            [Hypothesis(effects=(), values=())]
        )[0]
        loads = np.sqrt(np.nanmean(np.concatenate(simulated) ** 2, axis=0))
    return replace(
        machine,
        loads=np.where(loads > 0, loads, machine.load_scales),
        speeds=np.where(speeds > 0, speeds, 1.0),
    )
