"""Interactive comparison: try built-in or own effects one at a time, and add them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidSetting, UnknownName
from loose_env.gap.core.catalogue import Term, shapes, shows, terms_of
from loose_env.gap.core.decision import Finding, decide, held_out_rms
from loose_env.gap.core.evidence import append
from loose_env.gap.core.find import evidence_of, silent
from loose_env.gap.core.selection import SetFit
from loose_env.gap.core.tolerances import GapSettings
from loose_env.gap.explain import named_effect, pooled_rms
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import effect_class
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.output.corrected_model import correction_code, write_model
from loose_env.recording import Recording
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TriedEffect:
    """One effect, fitted beside those that were added."""

    finding: Finding
    """The effect with values, intervals and what held-out data say of it."""
    before: float
    """Held-out residual without it [noise standard deviations]."""
    after: float
    """The same with it."""
    fit: SetFit = field(repr=False)
    """The fitted set."""

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.finding.term.effect

    @property
    def parameters(self) -> dict[str, float]:
        """Fitted parameter values."""
        return dict(named_effect(self.finding).parameters)

    @property
    def accepted(self) -> bool:
        """Whether a comparison would name it: probable, no interval across zero, held-out gain."""
        return self.finding.named

    def __str__(self) -> str:
        """Format as one line."""
        found = named_effect(self.finding)
        gains = ", ".join(f"{gain:.0f} by {way}" for way, gain in found.held_out_gain.items())
        words = [
            *(f"{name} {found.value_in_words(name)}" for name in found.parameters),
            f"residual on held-out data {self.before:.2f} before, {self.after:.2f}",
            f"rise of twice the held-out log likelihood {gains}",
            f"not accepted: {found.doubt}" if found.doubt else "accepted",
        ]
        return f"{self.effect!r}: {'; '.join(words)}"

    def _repr_html_(self) -> str:
        return f"<p>{escape(str(self))}</p>"


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

    Raises
    ------
    InvalidData
        If the position of a joint was not read, or no joint moves.

    Examples
    --------
    >>> from loose_env.recording import read_recording
    >>> session = GapSession(read_recording("recordings/arm"))  # doctest: +SKIP
    >>> tried = session.try_effect("coulomb_friction", "joint2")  # doctest: +SKIP
    >>> session.add(tried)  # doctest: +SKIP
    """

    def __init__(
        self,
        recording: Recording,
        settings: GapSettings | None = None,
        *,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.recording, self.say = recording, say
        with silent():
            self.selection = evidence_of(recording, settings or GapSettings(), say)
            self.fit = self.selection.solve(())
            self.held_out = self._left(self.fit)
            """Residual on held-out data with what was added [noise standard deviations]."""
        self.balance = self.selection.evidence.balance
        self.tried: tuple[TriedEffect, ...] = ()
        """Effects that were added."""

    @property
    def added(self) -> tuple[Effect, ...]:
        """Effects that were added."""
        return tuple(each.effect for each in self.tried)

    def try_effect(
        self, effect: Effect | type[Effect] | str, where: str | None = None
    ) -> TriedEffect:
        """Fit one effect, in its best shape, beside those that were added.

        Parameters
        ----------
        effect : Effect, class of an effect, or str
            The effect, or its identifier in the catalogue.
        where : str, optional
            Its location, unless it has one.

        Raises
        ------
        UnknownName
            If there is no such effect, or it cannot be there.
        InvalidSetting
            If a location is missing, or the recording does not show the effect at all.
        """
        with silent():
            terms = [term for each in self._forms(effect, where) for term in self._terms(each)]
            if not terms:
                raise InvalidSetting(
                    f"these motions do not show {effect!r}; record a motion in which it acts"
                )
            fits = [self.selection.solve((*self.fit.terms, term)) for term in terms]
            best = min(fits, key=lambda f: (not f.allowed, f.total))
            found = decide(self.selection, best).findings
            return TriedEffect(
                finding=next(f for f in found if f.term not in self.fit.terms),
                before=self.held_out, after=self._left(best), fit=best,
            )  # fmt: skip

    def add(self, tried: TriedEffect) -> None:
        """Add an effect that was tried.

        Raises
        ------
        InvalidSetting
            If another effect was added since it was tried.
        """
        if {*tried.fit.terms} != {*self.fit.terms, tried.finding.term}:
            raise InvalidSetting(
                f"{tried.effect!r} was tried before {self.added[-1]!r} was added; try it again"
            )
        self.fit, self.held_out, self.tried = tried.fit, tried.after, (*self.tried, tried)
        self.say(f"{tried.effect!r} added: {tried.after:.2f} on held-out data")

    def residual_force(self, joint: str) -> Array:
        """Force that the nominal model lacks at a joint along its `motion` [N·m, N] (T,).

        Raises
        ------
        UnknownName
            If the model has no such joint.
        """
        return np.asarray(self.balance.residual[:, self._number(joint)])

    def motion(self, joint: str) -> tuple[Array, Array, Array]:
        """Position, speed and acceleration of a joint, all runs one after the other (T,) each."""
        k, own = self._number(joint), self.balance
        return own.position[:, k], own.speed[:, k], own.acceleration[:, k]

    @property
    def hypothesis(self) -> Hypothesis:
        """The effects that were added, at their values in the last fit."""
        fit, columns = self.fit, self.selection.evidence.columns_of
        return Hypothesis().with_effects(
            [(t.effect, t.values(fit.values[fit.places(columns(t))])) for t in fit.terms]
        )

    @property
    def code(self) -> str:
        """Python lines that apply effects which MJCF cannot express; "" if none."""
        return correction_code(self.hypothesis)

    def write_model(self, path: str | Path) -> list[Path]:
        """Write the model with the added effects, and the files it needs beside it.

        Raises
        ------
        InvalidData
            If it does not compile.
        """
        source = self.recording.model_path
        return write_model(Path(path), self.balance.machine, self.hypothesis, source=source)

    def _left(self, fit: SetFit) -> float:
        return pooled_rms(self.selection, held_out_rms(self.selection, fit)[1])

    def _number(self, joint: str) -> int:
        names = self.balance.machine.joints
        if joint not in names:
            raise UnknownName(f"the model has no joint {joint!r}; it has {', '.join(names)}")
        return names.index(joint)

    def _terms(self, effect: Effect) -> list[Term]:
        """Terms of one effect: those of the evidence, else new ones."""
        evidence, balance, own = self.selection.evidence, self.balance, type(effect)
        known = [t for t in evidence.terms if t.name == (effect.kind, effect.where)]
        known = [t for t in known if type(t.effect) is own]
        if known or not shows(balance, effect):
            return known
        found = [t for form in shapes(balance, effect) for t in terms_of(balance, effect, *form)]
        append(evidence, *found)
        for name in ("_places", "_shapes"):  # counted anew with what was added
            self.selection.__dict__.pop(name, None)
        return found

    def _forms(self, effect: Effect | type[Effect] | str, where: str | None) -> list[Effect]:
        """Instances of an effect at a location, in every variant."""
        machine = self.balance.machine
        if isinstance(effect, Effect):
            if where is not None:
                raise InvalidSetting(f"{effect!r} has a location already; leave out {where!r}")
            return [effect]
        if isinstance(effect, str):
            effect = effect_class(effect)
        if where is None:
            locations = list(effect.locations(machine))
            raise InvalidSetting(f"{effect.kind} needs a location, one of {locations}")
        effect(machine, where)  # raises for other locations
        return [effect(machine, where, v) for v in effect.variants_at(machine, where)]
