"""Candidate effects as groups of columns of the inverse-dynamics regressor.

The equation is: torque of the actuators − torque of the nominal model = sum of columns times
coefficients. A group holds the columns of one effect at one location and turns its coefficients
into the parameters of the effect. Effects of sensors, of play and of flexible parts are no part of
a rigid arm's regressor, and are no candidates. Columns that depend on the velocity with a kink are
computed at the full rate and low-passed like the torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from loose_env.recording import Recording
from loose_env.typing import Array
from scripts.suites.gap.rivals.inverse_dynamics import (
    Columns,
    Group,
    InverseDynamics,
    Nuisance,
    Read,
)
from scripts.suites.gap.rivals.joint_data import Actuators, JointRun

__all__ = ["GridSettings", "columns_of"]

TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Parameters of an inertia tensor [kg m²]."""


@dataclass(frozen=True, kw_only=True)
class GridSettings:
    """Values of parameters in which the regressor is not linear."""

    stribeck_speeds: tuple[float, ...] = (0.03, 0.07, 0.15, 0.3)
    """Stribeck speeds [rad/s]."""
    ripple_orders: tuple[int, ...] = tuple(range(4, 29))
    """Periods of torque ripple in a turn."""
    smooth_speed: float = 2e-3
    """Speed within which friction turns round [rad/s]: that of a tachometer's noise."""
    slide_metres: float = 0.2
    """Metres of a slide that count like a radian of a hinge."""
    clock_samples: float = 0.25
    """Samples up to which a delay is the clock of the recording."""
    largest_angle: float = 0.3
    """Largest angle for which a torque is linear in it [rad]."""
    largest_shift: float = 0.5
    """Largest shift of a centre of mass [m]: a link is hardly longer."""


@dataclass
class _Collected:
    """Groups and their columns while they are collected."""

    samples: int
    joints: int
    groups: list[Group] = field(default_factory=list)
    blocks: list[Array] = field(default_factory=list)

    def add(self, group: Group, columns: Array) -> None:
        assert columns.shape == (self.samples, self.joints, group.width), group
        self.groups.append(group)
        self.blocks.append(columns)

    def at_joint(self, group: Group, joint: int, columns: Sequence[Array]) -> None:
        whole = np.zeros((self.samples, self.joints, group.width))
        whole[:, joint] = np.stack(columns, axis=-1)
        self.add(group, whole)


def _plain(*names: str) -> Read:
    def read(values: Array) -> dict[str, float]:
        return dict(zip(names, map(float, values), strict=True))

    return read


def columns_of(recording: Recording, run: JointRun, grid: GridSettings | None = None) -> Columns:
    """Regressor of a run.

    Parameters
    ----------
    recording : Recording
        Its nominal model.
    run : JointRun
        The run.
    grid : GridSettings, optional
        Speeds and orders that are tried.
    """
    grid = grid or GridSettings()
    model, dynamics = recording.model(), InverseDynamics(recording=recording)
    motion = run.motion()
    base = dynamics.torque(motion)
    found = _Collected(samples=len(base), joints=base.shape[1])
    torque = run.low_pass.reduced(run.torque)
    masses = {b: dynamics.mass(motion, b, base) for b in _bodies(model)}
    _friction(found, recording, run, grid)
    _joints(found, model, motion[0], motion[2], run)
    _drives(found, model, run, base, grid)
    _links(found, model, dynamics, motion, base, masses, grid)
    _angles(found, model, dynamics, motion, base, grid)
    nuisances, nuisance = _nuisance(model, dynamics, motion, base, masses, run)
    return Columns(
        target=torque - base,
        nuisance=nuisance,
        candidates=np.concatenate(found.blocks, axis=-1),
        nuisances=nuisances,
        groups=tuple(found.groups),
    )


def _bodies(model: mujoco.MjModel) -> list[int]:
    return [b for b in range(1, model.nbody) if model.body_mass[b] > 0 and model.body_dofnum[b]]


def _is_slide(model: mujoco.MjModel, joint: int) -> bool:
    return bool(model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE))


def _friction(found: _Collected, recording: Recording, run: JointRun, grid: GridSettings) -> None:
    model, speed = recording.model(), run.smooth_velocity()
    reduced = run.low_pass.reduced
    load = np.abs(run.low_pass.smooth(run.torque))
    for j in range(model.njnt):
        name, v = model.joint(j).name, speed[:, j]
        unit = grid.slide_metres if _is_slide(model, j) else 1.0
        side = np.tanh(v / (grid.smooth_speed * unit))
        coulomb = reduced(side)
        viscous = reduced(run.position_rate()[:, j])

        def group(
            kind: str, *names: str, basic: bool = False, nominal: float = 0.0, where: str = name
        ) -> Group:
            return Group(
                kind=kind, where=where, width=len(names), read=_plain(*names), basic=basic,
                positive=True, nominal=nominal,
            )  # fmt: skip

        found.at_joint(group("coulomb_friction", "torque", basic=True), j, [coulomb])
        damping = float(model.dof_damping[j])
        found.at_joint(
            group("viscous_friction", "damping", basic=True, nominal=damping), j, [viscous]
        )
        found.at_joint(group("quadratic_drag", "drag"), j, [reduced(v * np.abs(v))])
        sides = [reduced(np.maximum(side, 0.0)), reduced(np.minimum(side, 0.0))]
        found.at_joint(group("asymmetric_friction", "forward", "backward"), j, sides)
        if load.any():
            found.at_joint(group("load_friction", "share"), j, [reduced(load[:, j] * side)])
        for at in grid.stribeck_speeds:
            bump = reduced(side * np.exp(-((v / (at * unit)) ** 2)))
            found.at_joint(
                Group(
                    kind="stribeck_friction", where=name, width=2, read=_stribeck(at * unit),
                    basic=False, grid=True, positive=True,
                ),
                j, [coulomb, bump],
            )  # fmt: skip


def _stribeck(speed: float) -> Read:
    def read(values: Array) -> dict[str, float]:
        torque = float(values[0])
        ratio = 1.0 + float(values[1]) / torque if torque else 1.0
        return {"torque": torque, "static_ratio": ratio, "speed": speed}

    return read


def _joints(
    found: _Collected, model: mujoco.MjModel, position: Array, acceleration: Array, run: JointRun
) -> None:
    for j in range(model.njnt):
        name, q = model.joint(j).name, position[:, j]
        found.at_joint(
            Group(kind="rotor_inertia", where=name, width=1, read=_plain("inertia"),
                  positive=True, nominal=float(model.dof_armature[j])),
            j, [acceleration[:, j]],
        )  # fmt: skip
        found.at_joint(
            Group(kind="joint_spring", where=name, width=2, read=_spring), j, [q, np.ones_like(q)]
        )


def _spring(values: Array) -> dict[str, float]:
    stiffness = float(values[0])
    reference = -float(values[1]) / stiffness if stiffness else 0.0
    return {"stiffness": stiffness, "reference": reference}


def _gain(name: str) -> Read:
    def read(values: Array) -> dict[str, float]:
        return {name: 1.0 + float(values[0])}

    return read


def _inverse_gain(values: Array) -> dict[str, float]:
    # nominal torque = model's torque / gain
    return {"gain": 1.0 / max(1.0 + float(values[0]), 1e-3)}


def _drives(
    found: _Collected, model: mujoco.MjModel, run: JointRun, base: Array, grid: GridSettings
) -> None:
    reduced = run.low_pass.reduced
    if run.measured is not None:
        for j in range(model.njnt):
            found.at_joint(
                Group(
                    kind="torque_constant", where=model.joint(j).name, width=1,
                    read=_gain("factor"), basic=False, nominal=1.0,
                ),
                j, [base[:, j]],
            )  # fmt: skip
        return
    if not run.command_slope.any():
        return
    actuators = Actuators.of(model)
    slope = reduced(run.command_slope)
    clock = grid.clock_samples / run.low_pass.rate_hz
    rate = run.low_pass.derivative(run.low_pass.smooth(run.torque))
    rate = rate[run.low_pass.rows(len(rate))]
    for name, j in zip(actuators.names, actuators.dof, strict=True):
        gain = actuators.gain[list(actuators.dof).index(j)]
        # a drive without torque inside its dead zone loses that much of its error outside
        zone = reduced(gain * np.tanh(run.proportional[:, j] / (1e-4 * gain)))
        # by the torque of the model, which has no noise of the torque that is explained
        found.at_joint(
            Group(kind="actuator_gain", where=name, width=1, read=_inverse_gain, basic=False,
                  nominal=1.0),
            j, [base[:, j]],
        )  # fmt: skip
        for kind, read, least, column in (
            ("command_delay", _plain("delay"), clock, slope[:, j]),
            ("actuator_lag", _plain("time_constant"), clock, rate[:, j]),
            ("dead_zone", _plain("width"), 0.0, zone),
        ):
            group = Group(
                kind=kind, where=name, width=1, read=read, basic=False, positive=True, least=least
            )
            found.at_joint(group, j, [column])
    everywhere = Group(
        kind="command_delay", where="all", width=1, read=_plain("delay"), basic=False,
        positive=True, least=clock,
    )  # fmt: skip
    found.add(everywhere, slope[..., None])


def _links(
    found: _Collected,
    model: mujoco.MjModel,
    dynamics: InverseDynamics,
    motion: tuple[Array, Array, Array],
    base: Array,
    masses: dict[int, Array],
    grid: GridSettings,
) -> None:
    # the model needs more torque, so the actuators give more than the nominal model asks for
    for b, column in masses.items():
        name, mass = model.body(b).name, float(model.body_mass[b])

        def heavier(values: Array, mass: float = mass) -> dict[str, float]:
            return {"mass": mass * float(values[0])}

        found.add(
            Group(kind="link_mass", where=name, width=1, read=heavier, nominal=1.0),
            column[..., None],
        )
        found.add(
            Group(kind="link_com", where=name, width=3, read=_plain("x", "y", "z"),
                  largest=grid.largest_shift),
            dynamics.centre(motion, b, base),
        )  # fmt: skip
        found.add(
            Group(kind="link_inertia", where=name, width=6, read=_plain(*TENSOR), tensor=True),
            dynamics.moments(motion, b, base),
        )
        found.add(
            Group(
                kind="gravity_compensation", where=name, width=1, read=_plain("share"), basic=False
            ),
            -dynamics.weight(motion, b)[..., None],
        )
    site = next((s for s in range(model.nsite) if model.site(s).name == "tool"), None)
    if site is not None:
        body, place = int(model.site_bodyid[site]), model.site_pos[site].copy()
        found.add(
            Group(kind="payload", where="tool", width=4, read=_payload, basic=False, positive=True),
            dynamics.point_mass(motion, body, place, base),
        )


def _payload(values: Array) -> dict[str, float]:
    mass = float(values[0])
    off = values[1:] / mass if mass else np.zeros(3)
    return {"mass": mass, **dict(zip("xyz", map(float, off), strict=True))}


def _angles(
    found: _Collected,
    model: mujoco.MjModel,
    dynamics: InverseDynamics,
    motion: tuple[Array, Array, Array],
    base: Array,
    grid: GridSettings,
) -> None:
    found.add(
        Group(kind="base_tilt", where="base", width=2, read=_plain("tilt_x", "tilt_y"),
              basic=False, largest=grid.largest_angle),
        dynamics.tilt(motion, base),
    )  # fmt: skip
    for j in range(model.njnt):
        name, q = model.joint(j).name, motion[0][:, j]
        if _is_slide(model, j):
            continue
        found.add(
            Group(kind="encoder_offset", where=name, width=1, read=_plain("offset"), basic=False,
                  largest=grid.largest_angle),
            -dynamics.position(motion, j, base)[..., None],
        )  # fmt: skip
        for order in grid.ripple_orders:
            found.at_joint(
                Group(kind="torque_ripple", where=name, width=2, read=_ripple(order), basic=False,
                      grid=True),
                j, [np.sin(order * q), np.cos(order * q)],
            )  # fmt: skip


def _ripple(order: int) -> Read:
    def read(values: Array) -> dict[str, float]:
        return {"amplitude": float(np.hypot(*values)), "periods": float(order)}

    return read


def _nuisance(
    model: mujoco.MjModel,
    dynamics: InverseDynamics,
    motion: tuple[Array, Array, Array],
    base: Array,
    masses: dict[int, Array],
    run: JointRun,
) -> tuple[tuple[Nuisance, ...], Array]:
    """Columns of the nominal parameters that are known within the tolerance."""
    names: list[Nuisance] = []
    columns: list[Array] = []
    # mass and inertia each have an error of their own; `masses` changes both
    for b in masses:
        inertia = dynamics.inertia(motion, b, base)
        columns += [masses[b] - inertia, inertia]
        names += [Nuisance(name=f"{word} of {model.body(b).name}") for word in ("mass", "inertia")]
    # none of these columns has the noise by which the actuators' torque is computed
    rate, reduced = run.position_rate(), run.low_pass.reduced
    derivative = reduced(run.derivative_gain * rate)
    driven = run.measured is None and bool(run.proportional.any())
    for j in range(model.njnt):
        parts = {
            "armature": model.dof_armature[j] * motion[2][:, j],
            "damping": model.dof_damping[j] * reduced(rate[:, j]),
            "kp": (derivative[:, j] - base[:, j]) * driven,
            "kv": -derivative[:, j],
        }
        for word, values in parts.items():
            column = np.zeros_like(base)
            column[:, j] = values
            columns.append(column)
            names.append(Nuisance(name=f"{word} of {model.joint(j).name}"))
    return tuple(names), np.stack(columns, axis=-1)
