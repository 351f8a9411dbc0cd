"""Effects that logs of real machines ask for.

They are beside `loose_env.gap.model.effects.catalogue`, for they have no simulation of their own.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import mujoco
import numpy as np

from loose_env.gap.model.effect import Effect, JointEffect, Parameter
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.effects.mjcf import add_constant, added_name
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array


class TorqueOffset(JointEffect):
    """Constant torque at a joint: the zero of a torque sensor, or a preload."""

    kind = "torque_offset"
    exact_law: ClassVar[bool] = True
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Torque in the joint's direction that the model lacks."""
        starts = (-0.1, 0.1)
        return (Parameter.sized("torque", self.torque_unit, self.load, -20, 20, starts=starts),)

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add an actuator without input that gives the torque."""
        if values[0] != 0:
            name = added_name(spec, self.where, self.kind)
            add_constant(spec, self.where, name, -float(values[0]))


class FrictionBehindSlack(JointEffect):
    """Dry friction of an element that is coupled with slack and an elastic way.

    The force is zero within the slack, grows over the elastic way, and slides at its bound: a
    friction damper with play in its joints.
    """

    kind = "friction_behind_slack"
    proportional: ClassVar[int | None] = 0
    needs_data_starts: ClassVar[bool] = True
    has_memory: ClassVar[bool] = True
    in_model: ClassVar[bool] = False
    null_values: ClassVar[tuple[float, ...] | None] = (0.0, 1.0, 1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Friction, slack, and elastic way; the way is of the order of that in a second."""
        way = Parameter.sized(
            "slack", self.angle_unit, self.speed, 1e-5, 10, scale=1.0, starts=(0.3,), log=True
        )
        return (
            Parameter.sized("torque", self.torque_unit, self.load, 0, 20, starts=(0.2,)),
            way,
            replace(way, name="elastic", starts=(0.1 * self.speed,)),
        )

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Start at slacks from a hundredth to a third of the way, on stiff and soft elements."""
        way = float(np.ptp(angle))
        return tuple(
            (0.2 * self.load, slack * way, stretch * slack * way)
            for slack in np.geomspace(0.01, 0.33, 8)
            for stretch in (0.15, 0.5, 1.2)
        )

    def torque(self, position: Array, speed: Array, values: Array) -> Array:
        """Force along a path (T, joints)."""
        joint = self.machine.joint_number(self.where)
        found = np.zeros_like(position)
        found[:, joint] = -values[0] * behind_slack(position[:, joint], values[1], values[2])
        return found


class CommandInterpolation(Effect):
    """Commands that reach the drives along straight lines, where a model holds each one.

    Many controllers interpolate between the set points that a log shows.
    """

    kind = "command_interpolation"
    acts_on: ClassVar[str] = "arm"
    proportional: ClassVar[int | None] = 0
    in_model: ClassVar[bool] = False
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return all drives together."""
        return ("all",) if machine.actuators else ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Share of the way from a held command to the straight line."""
        return (Parameter(name="share", unit="", low=0.0, high=1.0, starts=(1.0,)),)

    def command(self, time: Array, controls: Array, values: Array) -> Array:
        """Draw lines between the steps of the commands."""
        steps = np.flatnonzero(np.any(np.diff(controls, axis=0) != 0, axis=1)) + 1
        at = np.concatenate([[0], steps, [len(time) - 1]])
        lines = np.array([np.interp(time, time[at], column[at]) for column in controls.T]).T
        return np.asarray(controls + values[0] * (lines - controls))


def behind_slack(position: Array, slack: float, elastic: float) -> Array:
    """Share of the friction that acts along a path (T,)."""
    anchor, found = float(position[0]), np.empty_like(position)
    for k, x in enumerate(position):
        stretch = abs(x - anchor) - slack / 2
        if stretch > elastic:
            anchor = x - np.sign(x - anchor) * (slack / 2 + elastic)
            stretch = elastic
        found[k] = np.sign(x - anchor) * max(stretch, 0.0) / elastic
    return found


EFFECTS: Mapping[str, type[Effect]] = ChainMap(
    {effect.kind: effect for effect in (TorqueOffset, FrictionBehindSlack, CommandInterpolation)},
    CATALOGUE,
)
"""Identifier -> class, of all effects, those that users register included."""
