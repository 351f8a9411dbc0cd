"""Interactive search: fit built-in or custom effects one at a time and add them.

Each step is that of the automatic search: the nominal parameters are fitted jointly within their
tolerance, an effect is fitted from its best screened start, and scored on held-out runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np

from loose_env.arms import quiet
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap.diagnostics.residual_spectra import Series, series_of
from loose_env.gap.fitting.confidence_intervals import bootstrap, widened
from loose_env.gap.fitting.holdout_score import Improvement, ScoredFit, Scorer, improvement_of
from loose_env.gap.fitting.model_structure import nuisance_of
from loose_env.gap.fitting.refit import refit_with_new_jacobian, with_new_jacobian
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.corrected_model import correction_code, write_model
from loose_env.gap.output.export_check import exported
from loose_env.gap.output.result import NamedEffect
from loose_env.gap.residuals.preparation.prepare import GapProblem, prepare
from loose_env.gap.residuals.windows import screening_seconds, windowed
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.selection.candidate_fits import CandidateFits
from loose_env.gap.selection.forward_selection import nominal_fit
from loose_env.gap.selection.screening.data_driven_starts import proposals, residual_torque
from loose_env.gap.selection.screening.screening import ScreenedCandidate, screen
from loose_env.gap.settings import (
    GapSettings,
    SearchSettings,
)
from loose_env.gap.workflow.pipeline import named_effects
from loose_env.recording import Recording
from loose_env.typing import Array

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class TriedEffect:
    """One effect, fitted beside the current model and scored on held-out runs."""

    effect: Effect
    """The fitted effect."""
    parameters: dict[str, float]
    """Fitted parameter values."""
    held_out: float
    """Residual on the held-out runs, root mean square in noise standard deviations."""
    before: float
    """The same without the effect."""
    improvement: Improvement
    """Improvement (z) over the model without it, and the explained share."""
    accepted: bool
    """Whether the search would name it: surely ahead, by enough, and not by a limit or by noise.
    Beside a part with impacts against its stops the search takes what these leave as noise, and
    may name what is hidden by that here."""
    scored: ScoredFit = field(repr=False)
    """The scored fit."""

    def __str__(self) -> str:
        """Format as one line."""
        units = {p.name: p.unit for p in self.effect.parameters}
        values = ", ".join(f"{k} {v:.4g} {units[k]}".rstrip() for k, v in self.parameters.items())
        return (
            f"{self.effect!r}: {values}; residual on held-out runs {self.before:.2f} before, "
            f"{self.held_out:.2f} with it; z {self.improvement.held_out:.1f} there, "
            f"{self.improvement.training:.1f} on training runs; "
            f"{'accepted' if self.accepted else 'not accepted'}"
        )

    def _repr_html_(self) -> str:
        """Return a short table, as notebooks show it."""
        units = {p.name: p.unit for p in self.effect.parameters}
        rows = [[k, f"{v:.4g}", units[k]] for k, v in self.parameters.items()]
        rows += [
            ["held-out runs, before", f"{self.before:.2f}", "noise standard deviations"],
            ["held-out runs, with it", f"{self.held_out:.2f}", "noise standard deviations"],
            ["improvement there", f"{self.improvement.held_out:.1f}", "z-score"],
            ["improvement on training runs", f"{self.improvement.training:.1f}", "z-score"],
            ["accepted", "yes" if self.accepted else "no", ""],
        ]
        lines = [f"<th>{escape(repr(self.effect))}</th><th></th><th></th>"]
        lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
        return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualTorque:
    """Residual torque of one joint, at samples of all runs with commands."""

    position: Array
    """Position [rad, m] (N,)."""
    speed: Array
    """Velocity [rad/s, m/s] (N,)."""
    acceleration: Array
    """Acceleration [rad/s², m/s²] (N,)."""
    torque: Array
    """Actuator torque beyond the inverse dynamics of the model [N·m, N] (N,)."""


class GapSession:
    """The comparison of a recording with its model, step by step.

    Parameters
    ----------
    recording : Recording
        Measured runs and the nominal model.
    settings : GapSettings, optional
        Settings of the comparison.
    say : callable
        Receives progress messages, line by line.

    Attributes
    ----------
    problem : GapProblem
        Aligned and split runs, the chosen step, the noise.
    nominal : ScoredFit
        The nominal model, fitted within the tolerance.
    best : ScoredFit
        The current model, with the added effects.

    Raises
    ------
    InvalidData
        If the recording has too few runs, or a run lacks what its comparison needs.

    Examples
    --------
    A pendulum is let go, and has more friction than its model:

    >>> import tempfile
    >>> import mujoco
    >>> from loose_env.recording import Run, write_recording
    >>> xml = '''<mujoco><option timestep="0.01" integrator="RK4"/><worldbody><body name="rod">
    ...   <joint name="pivot" axis="0 1 0" damping="{}"/><inertial pos="0 0 -0.3" mass="0.5"
    ...   diaginertia="0.01 0.01 0.001"/></body></worldbody>
    ...   <sensor><jointpos name="encoder" joint="pivot"/></sensor></mujoco>'''
    >>> model, rng = mujoco.MjModel.from_xml_string(xml.format(0.03)), np.random.default_rng(1)
    >>> runs = []
    >>> for number, begin in enumerate((0.5, 0.8, 1.1)):
    ...     data, shown = mujoco.MjData(model), np.zeros(300)
    ...     data.qpos[0] = begin
    ...     for k in range(300):
    ...         mujoco.mj_step(model, data)
    ...         shown[k] = data.sensordata[0] + 1e-4 * rng.normal()
    ...     runs.append(
    ...         Run(
    ...             name=f"run-{number}.csv", time=0.01 * np.arange(300), sensors={"encoder": shown}
    ...         )
    ...     )
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     recording = write_recording(
    ...         f"{folder}/rod", model_xml=xml.format(0.01), runs=runs, file_format="csv"
    ...     )
    ...     steps = GapSession(recording, GapSettings(threads=1))
    >>> tried = steps.try_effect("viscous_friction", "pivot")
    >>> round(tried.parameters["damping"], 2), tried.held_out < 0.01 * tried.before, tried.accepted
    (0.02, True, True)
    """

    def __init__(
        self,
        recording: Recording,
        settings: GapSettings | None = None,
        *,
        say: Say = lambda _: None,
    ) -> None:
        self.settings, self.say = settings or GapSettings(), say
        with quiet():  # diverging simulations are part of a fit
            self.problem: GapProblem = prepare(recording, self.settings)
            search = self.problem.search
            tolerance = self.settings.tolerance
            self._scorer = Scorer(search, self.problem.held_out_whole)
            self._short = windowed(search, screening_seconds(search))
            nuisance = nuisance_of(search, tolerance=tolerance)
            self.nominal = nominal_fit(search, self._short, self._scorer, nuisance)
        self.best = self.nominal
        say(f"nominal model: {self.nominal.held_out_rms:.2f} noise standard deviations held out")

    @property
    def machine(self) -> NominalModel:
        """The nominal model, with the step, typical loads and speeds of the recording."""
        return self.problem.machine

    @property
    def added(self) -> tuple[Effect, ...]:
        """Effects added so far."""
        return self.best.fitted.effects

    def try_effect(
        self,
        effect: Effect | type[Effect] | str,
        where: str | None = None,
        *,
        start: Sequence[float] | None = None,
    ) -> TriedEffect:
        """Fit an effect beside those added, and score it on the held-out runs.

        Parameters
        ----------
        effect : Effect, type of Effect or str
            One of `machine`, or a class, or the identifier of one in the catalogue; it need not be
            registered.
        where : str, optional
            Location of a class or an identifier: one of its `locations`.
        start : sequence of float, optional
            Starting values of the fit; by default the best of its own by screening.

        Raises
        ------
        InvalidSetting
            If the location is missing, or given for an effect that has one; or if a spring or a
            clearance was added there already.
        InvalidData
            If the effect changes nothing that was measured.
        UnknownName
            If it cannot be there, or the catalogue has no such effect.
        """
        found, search = self._not_added(self._effects(effect, where)), self.problem.search
        with quiet():
            short = self._short
            candidate_fits = CandidateFits(search, short, self._scorer, self.best)
            screened: list[ScreenedCandidate]
            if start is not None:
                values = tuple(float(v) for v in start)
                screened = [ScreenedCandidate(effect=found[0], values=values, predicted=1.0, z=1.0)]
            else:
                proposed = proposals(search, self.best.fitted.hypothesis, found)
                screened = screen(short, candidate_fits.windows.before, found, proposed=proposed)[
                    :1
                ]
            fits = candidate_fits.fit_candidates(screened)
            if not fits:
                raise InvalidData(f"{found[0]!r} changes nothing that was measured, from any start")
            tried = self._tried(self._scorer.score(refit_with_new_jacobian(search, fits[0].fitted)))
        self.say(str(tried))
        return tried

    def add(self, tried: TriedEffect) -> None:
        """Add an effect to the current model; later fits include it.

        Raises
        ------
        InvalidSetting
            If another effect was added since it was tried.
        """
        count = len(self.best.fitted.effects)
        if tried.scored.fitted.effects[:count] != self.best.fitted.effects:
            raise InvalidSetting(
                f"{tried.effect!r} was tried before {self.added[-1]!r} was added; try it again"
            )
        self.best = tried.scored
        self.say(f"{tried.effect!r} added: {self.best.held_out_rms:.2f} held out")

    def residuals(self) -> tuple[Series, ...]:
        """Residual of each channel in each held-out run, in noise standard deviations."""
        held = self.problem.held_out_whole
        found = series_of(self.best.held_out_residual, held.rows, held.trials, held.channels)
        return tuple(found)

    def residual_torque(self, joint: str) -> ResidualTorque:
        """Return the residual torque of a joint in the runs with commands, for plotting.

        Against position it shows springs and cogging, against speed friction. It is smoothed like
        the measured motion, and noisy where drives are stiff.

        Raises
        ------
        InvalidData
            If no run has commands and is long enough.
        UnknownName
            If the model has no such joint.
        """
        if joint not in self.machine.joints:
            raise UnknownName(f"the model has no joint {joint!r}; it has {self.machine.joints}")
        number = self.machine.joint_number(joint)
        found = residual_torque(self.problem.search, self.best.fitted.hypothesis)
        if found is None:
            raise InvalidData("no run has commands and is long enough for a torque that is missing")
        position, speed, acceleration, torque, _ = (part[:, number] for part in found)
        return ResidualTorque(
            position=position, speed=speed, acceleration=acceleration, torque=torque
        )

    def named(self) -> tuple[NamedEffect, ...]:
        """Added effects with 95 % intervals, in the form of a result."""
        search = self.problem.search
        with quiet():
            fitted = with_new_jacobian(self.best.fitted, search)
            rng = np.random.default_rng(self.settings.seed)
            intervals = widened(search, fitted, bootstrap(search, fitted, rng))
        return named_effects(fitted, intervals)

    @property
    def code(self) -> str:
        """Python lines that apply effects which MJCF cannot express; "" if none."""
        return correction_code(self.best.fitted.hypothesis)

    def write_model(self, path: str | Path) -> list[Path]:
        """Write the model with the added effects, and the files it needs beside it.

        Raises
        ------
        InvalidData
            If it does not compile.
        """
        corrected = self.best.fitted.hypothesis.of_model
        own = exported(self.problem.held_out_whole, corrected, self.best.held_out_residual)
        for words in own.notes():
            self.say(f"warning: {words}")
        return write_model(
            Path(path),
            self.machine,
            corrected,
            step=own.step,
            source=self.problem.model_path,
        )

    def _effects(self, effect: Effect | type[Effect] | str, where: str | None) -> list[Effect]:
        """Instances of an effect at a location, in every variant."""
        if isinstance(effect, Effect):
            if where is not None:
                raise InvalidSetting(f"{effect!r} has a location already; leave out {where!r}")
            return [effect]
        if isinstance(effect, str):
            if effect not in CATALOGUE:
                raise UnknownName(f"unknown effect {effect!r}; the catalogue has {list(CATALOGUE)}")
            effect = CATALOGUE[effect]
        if where is None:
            locations = list(effect.locations(self.machine))
            raise InvalidSetting(f"{effect.kind} needs a location, one of {locations}")
        effect(self.machine, where)  # raises for other locations
        forms = effect.variants_at(self.machine, where)
        return [effect(self.machine, where, variant) for variant in forms]

    def _not_added(self, effects: list[Effect]) -> list[Effect]:
        """Filter effects that can still be added: one spring or clearance per axis."""
        added = {effect.key for effect in self.added if effect.adds_motion}
        left = [effect for effect in effects if effect.key not in added]
        if not left:
            raise InvalidSetting(
                f"{effects[0]!r} was added already, and there is room for one of it only; try "
                "another effect or another location"
            )
        return left

    def _tried(self, scored: ScoredFit) -> TriedEffect:
        fitted, search = scored.fitted, self.problem.search
        acceptance = Acceptance(search, self._scorer, self.nominal, self.best, SearchSettings())
        effect, values = fitted.hypothesis.pairs[-1]
        return TriedEffect(
            effect=effect,
            parameters={p.name: float(v) for p, v in zip(effect.parameters, values, strict=True)},
            held_out=scored.held_out_rms,
            before=self.best.held_out_rms,
            improvement=improvement_of(scored, self.best),
            accepted=acceptance.accepts(scored) and not acceptance.objection(scored),
            scored=scored,
        )
