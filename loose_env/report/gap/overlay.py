"""Overlay in time of measured, nominal and corrected readings, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from loose_env.gap import GapSolution, Series
from loose_env.recording import joint_sensors
from loose_env.report.gap.figures import Overlay, overlay_figure
from loose_env.report.gap.spectra import by_channel
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.sections import group
from loose_env.typing import Array

__all__ = ["overlay_group"]

_JOINTS = 8
"""Joints that are drawn: those with the largest residual."""
_SECONDS = 2.0
"""Time that is drawn, about the largest residual [s]."""
_SAMPLES = 400
"""Samples of a curve."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pair:
    """One channel of a run on held-out data, by the nominal and the corrected model."""

    nominal: Series
    corrected: Series


def overlay_group(solution: GapSolution) -> dict[str, Any]:
    """Section with measured, nominal and corrected readings of each joint over time."""
    nominal = by_channel(solution, solution.base.held_out_residual)
    corrected = by_channel(solution, solution.best.held_out_residual)
    chosen: dict[str, _Pair] = {}
    for joint, channels in _channels(solution).items():
        pairs = [
            _Pair(nominal=one, corrected=other)
            for channel in channels
            if channel in nominal and channel in corrected
            for one, other in zip(nominal[channel], corrected[channel], strict=False)
            if one.trial == other.trial and len(one.time) == len(other.time) > 8
        ]
        if pairs:
            chosen[joint] = max(pairs, key=lambda pair: pair.nominal.rms)
    worst = sorted(chosen, key=lambda joint: -chosen[joint].nominal.rms)[:_JOINTS]
    cards = [
        FigureCard(
            title=joint,
            image=overlay_figure(_overlay(solution, chosen[joint], joint)),
            caption=f"{chosen[joint].nominal.channel} of {chosen[joint].nominal.run}, held out "
            f"from all fits. Residual {chosen[joint].nominal.rms:.2f} before and "
            f"{chosen[joint].corrected.rms:.2f} after correction, in noise standard deviations.",
        )
        for joint in chosen
        if joint in worst
    ]
    return group(
        "Measured, nominal and corrected",
        f"Up to {_SECONDS:g} s about the largest residual of the nominal model.",
        cards=cards,
    )


def _channels(solution: GapSolution) -> Mapping[str, list[str]]:
    """Joint -> channels that show it: its torque, position and velocity."""
    machine = solution.problem.machine
    sensors = joint_sensors(machine.model)
    return {
        joint: [
            f"torque.{joint}",
            *(f"sensor.{name}" for name in sensors[joint].position),
            *(f"sensor.{name}" for name in sensors[joint].velocity),
        ]
        for joint in machine.joints
        if joint in sensors
    }


def _overlay(solution: GapSolution, pair: _Pair, joint: str) -> Overlay:
    held, one, other = solution.problem.held_out_whole, pair.nominal, pair.corrected
    trial = held.trials[one.trial]
    column = next(c for c, each in enumerate(held.channels) if each.name == one.channel)
    scale = float(held.scales[one.trial, column])
    measured: Array = trial.measured[one.sample, column]
    width = min(25, len(one.residual))
    smooth = np.convolve(np.abs(one.residual), np.ones(width) / width, mode="same")
    centre = float(one.time[int(np.argmax(smooth))])
    start = min(max(centre - _SECONDS / 2, one.time[0]), max(one.time[-1] - _SECONDS, one.time[0]))
    inside = np.flatnonzero((one.time >= start) & (one.time <= start + _SECONDS))
    few = inside[np.unique(np.linspace(0, len(inside) - 1, _SAMPLES).astype(int))]
    model = solution.problem.machine.model
    slides = model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    name = one.channel.removeprefix("sensor.")
    if one.channel.startswith("torque."):
        unit = "N" if slides else "N·m"
    else:
        moving = name in joint_sensors(model)[joint].velocity
        unit = f"{'m' if slides else 'rad'}{'/s' if moving else ''}"
    return Overlay(
        time=one.time[few],
        measured=measured[few],
        nominal=(measured - one.residual * scale)[few],
        corrected=(measured - other.residual * scale)[few],
        channel=one.channel,
        unit=unit,
    )
