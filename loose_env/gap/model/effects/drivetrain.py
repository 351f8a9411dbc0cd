"""Effects of a drivetrain: rotor inertia, torque ripple (cogging), and gear eccentricity.

Torque ripple is periodic in the joint's angle, from cogging or gear teeth. An eccentric gear makes
an error of the measured angle once a turn.
"""

from __future__ import annotations

from math import atan2, hypot, pi
from typing import ClassVar

import mujoco
import numpy as np
from scipy.signal import lombscargle

from loose_env.gap.model.driven_effect import DrivenEffect
from loose_env.gap.model.effect import Readings
from loose_env.gap.model.effects.mjcf.joint_effect import JointEffect, added_name, fitted_rate
from loose_env.gap.model.effects.mjcf.passive_actuators import add_cogging
from loose_env.gap.model.effects.mjcf.sensor_columns import column_of
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import Parameter
from loose_env.typing import Array


class RotorInertia(JointEffect):
    """Rotor inertia added to that of the model; negative down to a total of zero."""

    kind = "rotor_inertia"
    exact_law: ClassVar[bool] = True
    null_values: ClassVar[tuple[float, ...] | None] = (0.0,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Added inertia."""
        moved = self.machine.inertia(self.where)
        return (
            Parameter(
                name="inertia",
                unit="kg·m²" if self.machine.turns(self.where) else "kg",
                low=-float(self.machine.model.dof_armature[self._dof]),
                high=100 * moved,
                scale=0.1 * moved,
                usual=10 * moved,  # the gear's ratio squared
                natural_low=True,
            ),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a fifth of the inertia that the joint moves, and the same again."""
        moved = self.machine.inertia(self.where)
        return ((0.2 * moved,), (1.0 * moved,))

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add to the joint's armature."""
        joint = spec.joint(self.where)
        joint.armature = max(joint.armature + float(values[0]), 0.0)

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose a start by regression of torque on acceleration."""
        return ((self.parameters[0].clipped(fitted_rate(acceleration, torque)),),)


_MOST_PERIODS = 400.0
"""Periods per turn that are tried at most."""
_TRIED = 4000
"""Numbers of periods in the search, at most."""
_PROPOSED = 3
"""Peaks that become starts."""
_SAMPLES = 4000
"""Samples that the search looks at."""


class TorqueRipple(JointEffect):
    """Torque ripple: a sine of the joint's position, per turn or per metre.

    A sin(N q + phase) on a hinge of N periods per turn, A sin(2π N q + phase) on a slide of N
    periods per metre.
    """

    kind = "torque_ripple"
    proportional: ClassVar[int | None] = 0
    needs_data_starts: ClassVar[bool] = True
    null_values: ClassVar[tuple[float, ...] | None] = (0.0, 1.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitude, periods per turn or per metre, phase."""
        one = 1.0 / self._rate
        return (
            Parameter(
                name="amplitude",
                unit=self.torque_unit,
                low=0.0,
                high=10 * self.load,
                scale=0.1 * self.load,
            ),
            Parameter(
                name="periods",
                unit="1/turn" if self.machine.turns(self.where) else "1/m",
                low=0.5 * one,
                high=2 * self._most,
                scale=one,
            ),
            Parameter(name="phase", unit="rad", low=-2 * pi, high=2 * pi, scale=0.5),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts with a few numbers of periods; only `propose` can cover all of them."""
        lone = 1.0 if self.machine.turns(self.where) else 1 / 0.1
        return tuple(
            (0.1 * self.load, n * lone, phase) for n in (2.0, 6.0) for phase in (0.0, pi / 2)
        )

    @property
    def _most(self) -> float:
        return _MOST_PERIODS if self.machine.turns(self.where) else 1 / 1e-3

    @property
    def _rate(self) -> float:
        """Phase per unit of position of one period per turn or per metre [1, rad/m]."""
        return 1.0 if self.machine.turns(self.where) else 2 * pi

    def edit(self, spec: mujoco.MjSpec, values: Array) -> None:
        """Add an actuator without input, with the ripple as its cogging."""
        name = added_name(spec, self.where, self.kind)
        amplitude, periods, phase = (float(v) for v in values)
        add_cogging(spec, self.where, name, [amplitude, self._rate * periods, phase])

    def interval_includes_null(self, low: Array, high: Array) -> bool:
        """Return whether the amplitude's interval includes zero."""
        return bool(low[0] <= 0 <= high[0])

    def passive_actuator_torque(self, angle: Array, speed: Array, values: Array) -> Array:
        """Joint torque against the ripple."""
        amplitude, periods, phase = values
        return np.asarray(-amplitude * np.sin(self._rate * periods * angle + phase))

    def propose(
        self, angle: Array, speed: Array, acceleration: Array, torque: Array
    ) -> tuple[tuple[float, ...], ...]:
        """Propose starts by a least-squares periodogram over a fine grid of periods.

        The periodogram is that of Lomb and Scargle. The grid, of phase per unit of position, has
        the resolution of the range of motion. The strongest peaks that are not neighbours become
        starts.
        """
        good = np.isfinite(angle) & np.isfinite(torque)
        every = max(1, int(good.sum()) // _SAMPLES)
        q, force = angle[good][::every], -torque[good][::every]
        width = float(np.ptp(q)) if len(q) else 0.0
        if len(q) < 10 or width <= 0:
            return ()
        lowest = max(0.5, pi / width)
        highest = min(self._rate * self._most, lowest + _TRIED * 0.25 * 2 * pi / width)
        if highest <= lowest:
            return ()
        spacing = 0.25 * 2 * pi / width
        grid = np.arange(lowest, highest, spacing)
        power = lombscargle(q, force - force.mean(), grid, floating_mean=True)
        found: list[tuple[float, ...]] = []
        amplitude, periods, _ = self.parameters
        while len(found) < _PROPOSED and np.any(power > 0):
            best = float(grid[int(np.argmax(power))])
            power[np.abs(grid - best) < 2 * pi / width] = 0.0
            waves = np.stack([np.sin(best * q), np.cos(best * q), np.ones(len(q))], axis=1)
            sine, cosine, _ = np.linalg.lstsq(waves, force, rcond=None)[0]
            found.append(
                (
                    amplitude.clipped(hypot(sine, cosine)),
                    periods.clipped(best / self._rate),
                    atan2(cosine, sine),
                )
            )
        return tuple(found)


_POSITION, _SPEED = mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL


class GearEccentricity(DrivenEffect, JointEffect):
    """Once-per-turn error of the measured angle: a gear or a code wheel that turns off its centre.

    The encoder shows q + sine · sin q + cosine · cos q, and the servo closes its loop on that.
    """

    kind = "gear_eccentricity"
    is_additive: ClassVar[bool] = True
    null_values: ClassVar[tuple[float, ...] | None] = (0.0, 0.0)

    @classmethod
    def locations(cls, machine: NominalModel) -> tuple[str, ...]:
        """Return hinges with an encoder."""
        model = machine.model
        seen = {
            int(model.sensor_objid[k])
            for k in range(model.nsensor)
            if model.sensor_type[k] == int(_POSITION)
        }
        return tuple(n for k, n in enumerate(machine.joints) if k in seen and machine.turns(n))

    def __init__(self, machine: NominalModel, where: str, variant: str | None = None) -> None:
        super().__init__(machine, where, variant)
        model, joint = machine.model, machine.joint_number(where)
        self._joint = joint
        self._columns = {
            kind: [
                column_of(model.sensor(k).name)
                for k in range(model.nsensor)
                if model.sensor_type[k] == int(kind) and model.sensor_objid[k] == joint
            ]
            for kind in (_POSITION, _SPEED)
        }
        self._servos: list[tuple[int, float, float, float]] = [
            (k, float(model.actuator_gear[k, 0]), *self._gains(k))
            for k, name in enumerate(machine.actuators)
            if machine.actuated_joint.get(name) == where and model.actuator_biasprm[k, 1] != 0
        ]

    def _gains(self, actuator: int) -> tuple[float, float]:
        """Position and velocity feedback of a servo over the gain of its command."""
        model = self.machine.model
        gain = model.actuator_gainprm[actuator, 0] or 1.0
        bias = model.actuator_biasprm[actuator]
        return float(bias[1] / gain), float(bias[2] / gain)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitudes of both phases."""
        return tuple(
            Parameter(name=name, unit="rad", low=-0.5, high=0.5, scale=0.005)
            for name in ("sine", "cosine")
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starts: a third of a degree in either phase, which add up."""
        return ((0.005, 0.005),)

    def feedback(self, command: Array, position: Array, speed: Array, values: Array) -> Array:
        """Shift the commands of the joint's servos as the shown position and speed do."""
        error, slope = _eccentric(position[..., self._joint], values)
        found = command.copy()
        for number, gear, per_angle, per_speed in self._servos:
            shift = per_angle * error + per_speed * slope * speed[..., self._joint]
            found[..., number] += gear * shift
        return found

    def feedback_code(self, values: Array) -> str:
        """Python lines: the commands shifted by the error of what the servo sees."""
        joint, (sine, cosine) = self._joint, (float(v) for v in values)
        angle, speed = f"position[{joint}]", f"speed[{joint}]"
        error = f"({sine!r} * np.sin({angle}) + {cosine!r} * np.cos({angle}))"
        slope = f"({sine!r} * np.cos({angle}) - {cosine!r} * np.sin({angle}))"
        return "\n".join(
            f"command[{number}] += {gear!r} * ({p!r} * {error} + {d!r} * {slope} * {speed})"
            for number, gear, p, d in self._servos
        )

    def read(self, time: Array, readings: Readings, values: Array) -> Readings:
        """Add the error to the encoder's reading, its rate to that of the speed.

        A speed is shown by its own slope of the error where the position is shown too.
        """
        found = dict(readings)
        shown = [column for column in self._columns[_POSITION] if column in readings]
        angle = readings[shown[0]] if shown else None
        for column in shown:
            found[column] = readings[column] + _eccentric(readings[column], values)[0]
        for column in self._columns[_SPEED]:
            if column in readings and angle is not None:
                found[column] = readings[column] * (1 + _eccentric(angle, values)[1])
        return found

    def code(self, values: Array) -> str:
        """Python lines: the readings with the error."""
        sine, cosine = (float(v) for v in values)
        names = [column.removeprefix("sensor.") for column in self._columns[_POSITION]]
        rates = [column.removeprefix("sensor.") for column in self._columns[_SPEED]]
        return "\n".join(
            (
                "import numpy as np",
                f"angle = float(data.sensor({names[0]!r}).data[0])",
                *(
                    f"data.sensor({name!r}).data *= "
                    f"1 + {sine!r} * np.cos(angle) - {cosine!r} * np.sin(angle)"
                    for name in rates
                ),
                *(
                    f"data.sensor({name!r}).data += "
                    f"{sine!r} * np.sin(angle) + {cosine!r} * np.cos(angle)"
                    for name in names
                ),
            )
        )


def _eccentric(angle: Array, values: Array) -> tuple[Array, Array]:
    """Error of the shown angle, and its slope."""
    sine, cosine = values
    return (
        sine * np.sin(angle) + cosine * np.cos(angle),
        sine * np.cos(angle) - cosine * np.sin(angle),
    )
