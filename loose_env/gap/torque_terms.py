"""Torque terms and dry frictions of effects, summed and applied step by step to simulations.

MJCF cannot express them, so that Python adds them to a simulation step by step. A torque held over
a step and evaluated at its beginning is late by half a step, so that a spring adds energy. Under a
Runge-Kutta method the mean of the term along the step is held instead, over positions and speeds
predicted from the acceleration at its beginning; the error of that mean is known after the step,
and the next one corrects it. Sensors at the beginning of a step are computed with the instantaneous
term. A dry friction that depends on the drives' torques is set before each step from those at its
beginning.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeGuard

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.gap.model.effect import DrivenEffect, Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array

Places = slice | NDArray[np.intp]
"""Indices of simulations."""


@dataclass(frozen=True, eq=False)
class Driven:
    """Driven effects with their values, in the order in which they act."""

    pairs: tuple[tuple[DrivenEffect, Array], ...]
    """Effects and values, (P,) or by simulation (P, sims)."""

    @classmethod
    def of(cls, hypothesis: Hypothesis) -> Driven:
        """The driven effects of a hypothesis."""
        return cls(tuple((e, values) for e, values in hypothesis.pairs if _is_driven(e)))

    def frictions(self, drive: Array, load: Array, speed: Array) -> Array:
        """Sum of the dry frictions under torques of drive and load (..., joints) [N·m, N]."""
        found = np.zeros(drive.shape)
        for effect, values in self.pairs:
            if has_friction(effect):
                found += effect.dry_friction(drive, load, speed, values)
        return found

    def commands(self, command: Array, position: Array, speed: Array) -> Array:
        """Commands (..., actuators) that reach the actuators in some states (..., joints)."""
        for effect, values in self.pairs:
            if has_feedback(effect):
                command = effect.feedback(command, position, speed, values)
        return command


def has_friction(effect: Effect) -> bool:
    """Return whether an effect is a dry friction that is set step by step."""
    return _is_driven(effect) and type(effect).dry_friction is not DrivenEffect.dry_friction


def has_feedback(effect: Effect) -> bool:
    """Return whether an effect changes commands step by step."""
    return _is_driven(effect) and type(effect).feedback is not DrivenEffect.feedback


def grouped_driven_effects(hypotheses: Sequence[Hypothesis]) -> list[tuple[Driven, Places]]:
    """Driven effects of some simulations, with the indices of those on which they act.

    Examples
    --------
    >>> grouped_driven_effects([Hypothesis()])  # nothing is driven
    []
    """
    each = [Driven.of(hypothesis) for hypothesis in hypotheses]
    keys = [tuple(id(effect) for effect, _ in driven.pairs) for driven in each]
    found = []
    for key in dict.fromkeys(key for key in keys if key):
        mask = [other == key for other in keys]
        members = [driven.pairs for driven, own in zip(each, mask, strict=True) if own]
        pairs = tuple(
            (same[0][0], np.stack([values for _, values in same], axis=-1))
            for same in zip(*members, strict=True)
        )
        found.append((Driven(pairs), indices(mask)))
    return found


def indices(mask: Sequence[bool]) -> Places:
    """Indices at which a mask is true; a slice where it is everywhere, which makes views."""
    return slice(None) if all(mask) else np.flatnonzero(mask)


def _is_driven(effect: Effect) -> TypeGuard[DrivenEffect]:
    return isinstance(effect, DrivenEffect)


State = tuple[Array, Array]
"""Positions and speeds of the machine's joints, (sims, joints) or (states, sims, joints) each."""

Row = tuple[Hypothesis, Places]
"""A hypothesis and the indices of its simulations."""

_NODES = (0.5 + 0.5 / np.sqrt(3.0) * np.array([-1.0, 1.0]))[:, None, None]
"""Parts of a step at which a term is taken: Gauss's two nodes, whose mean is exact for a cubic."""
_RUNGE_KUTTA = int(mujoco.mjtIntegrator.mjINT_RK4)
STATES = ("qpos", "qvel", "act")
"""State of a simulation: positions, speeds and activations."""


def has_terms(hypothesis: Hypothesis) -> bool:
    """Return whether any effect of a hypothesis has to be applied step by step."""
    return _has_torque(hypothesis) or any(
        isinstance(effect, DrivenEffect) for effect in hypothesis.effects
    )


def torque_terms(hypothesis: Hypothesis, position: Array, speed: Array) -> Array:
    """Sum of the torque terms of a hypothesis (..., joints) [N·m, N]."""
    found = np.zeros(position.shape)
    with np.errstate(all="ignore"):  # a diverging simulation is detected from its state
        for effect, values in hypothesis.pairs:
            if type(effect).torque is Effect.torque:
                continue
            given = np.asarray(effect.torque(position, speed, values))
            if given.shape != position.shape:
                raise InvalidData(
                    f"{effect!r}: torque gives an array of the shape {given.shape}; one number for "
                    f"each joint is needed, {position.shape} as its position"
                )
            found += given
    return found


def with_terms(
    batch: Batch, machine: NominalModel, hypotheses: Sequence[Hypothesis]
) -> Batch | BatchWithTerms:
    """Return the batch itself, or where a hypothesis has terms, one that adds them."""
    if not any(map(has_terms, hypotheses)):
        return batch
    return BatchWithTerms(batch, machine, hypotheses)


class BatchWithTerms:
    """Simulations of a batch on which torque terms act."""

    def __init__(
        self, batch: Batch, machine: NominalModel, hypotheses: Sequence[Hypothesis]
    ) -> None:
        self.batch, self.hypotheses = batch, tuple(hypotheses)
        joints = [batch.model.joint(name) for name in machine.joints]
        self._places = np.array([int(joint.qposadr[0]) for joint in joints])
        self._dofs = np.array([int(joint.dofadr[0]) for joint in joints])
        self._actuators = len(machine.actuators)
        self._feeds = any(
            has_feedback(effect) for hypothesis in hypotheses for effect in hypothesis.effects
        )
        self._own_models: list[mujoco.MjModel] = []
        if any(has_friction(effect) for each in hypotheses for effect in each.effects):
            models = batch.model if batch.models is None else batch.models
            several = models if isinstance(models, (list, tuple)) else [models] * batch.nsim
            # each simulation has its own friction
            self._own_models = [copy.deepcopy(model) for model in several]
            batch.set_models(self._own_models)
            self._losses = [model.dof_frictionloss for model in self._own_models]
            self._base = np.array([loss[self._dofs] for loss in self._losses])

    @property
    def nsim(self) -> int:
        """Number of simulations."""
        return int(self.batch.nsim)

    def bind(self, name: str) -> Array:
        """Live values of a field (sims, ...)."""
        return np.asarray(self.batch.bind(name))

    def rollout(
        self,
        count: int,
        control: Array,
        control_spec: int,
        record: Sequence[str],
        ids: NDArray[np.intp],
    ) -> dict[str, Array]:
        """Advance some simulations, as `mujoco.batch.Batch.rollout` does.

        Readings and forces are those at the beginning of each step, under its own command. A
        simulation with a MuJoCo warning is NaN from the beginning, since a term may make it
        diverge.
        """
        batch = self.batch
        # requested first: a field is computed from the next call on
        needed = (*record, "qpos", "qvel", "qacc", "qfrc_actuator", "qfrc_bias")
        fields = {name: batch.bind(name) for name in needed}
        commands, applied = batch.bind("ctrl"), batch.bind("qfrc_applied")
        found = {name: np.empty((len(ids), count, *fields[name].shape[1:])) for name in record}
        read = [name for name in record if name not in STATES]
        every = len(ids) == batch.nsim
        own, called = (slice(None), None) if every else (ids, ids)
        acting = (own, self._dofs) if every else (ids[:, None], self._dofs)
        terms, driven = self._rows(ids), grouped_driven_effects([self.hypotheses[i] for i in ids])
        warned = np.array(batch.warning[ids])
        models = batch.models if isinstance(batch.models, tuple) else (batch.model,)
        step = float(models[0].opt.timestep)
        looks_ahead = int(models[0].opt.integrator) == _RUNGE_KUTTA
        if self._own_models and not looks_ahead:
            batch.forward(called)  # drive torques of the first step
        owed = mean = np.zeros((len(ids), len(self._dofs)))
        before: State | None = None
        for k in range(count):
            now = fields["qpos"][own][:, self._places], fields["qvel"][own][:, self._dofs]
            commands[own] = self._fed(driven, control[:, k], now)
            if terms:
                applied[acting] = self._terms(terms, (now[0][None], now[1][None]))[0]
            ahead = 0.0 * now[1]
            if looks_ahead:
                batch.forward(called)
                for name in read:
                    found[name][:, k] = fields[name][own]
                ahead = fields["qacc"][own][:, self._dofs]
                if terms and before is not None:
                    along = self._terms(terms, _nodes_between(before, now, step))
                    owed = 0.5 * (along[0] + along[1]) - mean
                if terms:
                    first, second = self._terms(terms, _nodes_ahead(now, ahead, step))
                    mean = 0.5 * (first + second)
                    applied[acting] = mean + owed
                before = now
            if self._feeds:
                middle = _ahead(now, ahead, 0.5 * step)
                commands[own] = self._fed(driven, control[:, k], middle)
            if self._own_models:
                drive = fields["qfrc_actuator"][own][:, self._dofs]
                load = -fields["qfrc_bias"][own][:, self._dofs]
                self._set_friction(ids, driven, (drive, load, now[1]))
            batch.step(called)
            for name in record:
                if not (looks_ahead and name in read):
                    found[name][:, k] = fields[name][own]
        applied[own] = 0.0
        diverged = (batch.warning[ids] != warned).any(axis=(1, 2))
        for values in found.values():
            values[diverged] = np.nan
        return found

    def _rows(self, ids: NDArray[np.intp]) -> list[Row]:
        """Hypotheses with torque terms, and the indices of their simulations."""
        known = {id(self.hypotheses[i]): self.hypotheses[i] for i in ids}
        return [
            (hypothesis, indices([self.hypotheses[i] is hypothesis for i in ids]))
            for hypothesis in known.values()
            if _has_torque(hypothesis)
        ]

    @staticmethod
    def _terms(rows: Sequence[Row], state: State) -> Array:
        """Terms in some states, one after the other (states, sims, joints)."""
        position, speed = state
        found = np.zeros(position.shape)
        for hypothesis, own in rows:
            found[:, own] = torque_terms(hypothesis, position[:, own], speed[:, own])
        return found

    def _fed(self, driven: Sequence[tuple[Driven, Places]], command: Array, state: State) -> Array:
        """Commands (sims, actuators) that reach the actuators in a state."""
        if not self._feeds:
            return command
        found, (position, speed) = command.copy(), state
        for effects, own in driven:
            found[own, : self._actuators] = effects.commands(
                command[own, : self._actuators], position[own], speed[own]
            )
        return found

    def _set_friction(
        self,
        ids: NDArray[np.intp],
        driven: Sequence[tuple[Driven, Places]],
        state: tuple[Array, Array, Array],
    ) -> None:
        """Set the dry friction of some simulations from drive, load and speed (ids, joints)."""
        friction = self._base[ids]
        for effects, own in driven:
            friction[own] += effects.frictions(*(each[own] for each in state))
        for number, row in zip(ids.tolist(), friction, strict=True):
            self._losses[number][self._dofs] = row
        self.batch.set_models(self._own_models)


def _has_torque(hypothesis: Hypothesis) -> bool:
    """Return whether any effect of a hypothesis is a torque term."""
    return any(type(effect).torque is not Effect.torque for effect in hypothesis.effects)


def _nodes_ahead(now: State, rate: Array, step: float) -> State:
    """Positions and speeds at the nodes of the next step, at constant acceleration."""
    return _ahead(now, rate, step * _NODES)


def _ahead(now: State, rate: Array, time: Array | float) -> State:
    """Positions and speeds some time later, at constant acceleration."""
    position, speed = now
    return position + time * (speed + 0.5 * time * rate), speed + time * rate


def _nodes_between(before: State, now: State, step: float) -> State:
    """Positions and speeds at the nodes of a finished step, by cubic Hermite splines."""
    (first, start), (last, end) = before, now
    slope = (last - first) / step
    bend, twist = 3 * slope - 2 * start - end, start + end - 2 * slope
    return (
        first + step * _NODES * (start + _NODES * (bend + _NODES * twist)),
        start + _NODES * (2 * bend + 3 * _NODES * twist),
    )
