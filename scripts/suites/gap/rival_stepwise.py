"""Stepwise least squares on the inverse-dynamics regressor as a tool of the suite."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy import linalg, optimize, stats

from loose_env.gap import NamedEffect
from loose_env.recording import Recording, read_recording
from loose_env.typing import Array
from scripts.suites.gap.rival_data import (
    Actuators,
    FilterSettings,
    Finding,
    JointRun,
    joint_runs,
    noise_replicas,
    write_finding,
)

Motion = tuple[Array, Array, Array]
"""Position, velocity and acceleration, each of shape (t, n)."""
_ANGLE = 1e-4
"""Step of angles [rad]: its square is far below the noise, its rounding error too."""
_LENGTH = 1e-3
"""Step of centres of mass [m]; torques are quadratic in them, with a small square."""


Read = Callable[[Array], dict[str, float]]
"""Parameters of an effect from its coefficients."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """Columns of one effect at one location."""

    kind: str
    where: str
    width: int
    """Number of columns."""
    read: Read
    """Parameters of the effect from its coefficients."""
    grid: bool = False
    """Whether it is one value of a grid."""
    positive: bool = False
    """Whether the first coefficient cannot be negative: friction brakes, rotors add inertia."""
    nominal: float = 0.0
    """Nominal value in the unit of the first coefficient: within the tolerance of it an effect
    does not count."""
    least: float = 0.0
    """Value of the first coefficient beyond that up to which an effect does not count."""
    largest: float = np.inf
    """Largest coefficient for which the columns, which are derivatives, hold."""


@dataclass(frozen=True, kw_only=True)
class Nuisance:
    """A nominal parameter that is known within a relative tolerance."""

    name: str
    factor: float = 1.0
    """Of the tolerance told."""


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Regressor of one run: rows are samples, then joints."""

    target: Array
    """Actuator torque minus nominal torque, of shape (t, n) [N m or N]."""
    nuisance: Array
    """Torque per relative change of a nominal parameter, of shape (t, n, p)."""
    candidates: Array
    """Columns of all groups side by side, of shape (t, n, c)."""
    nuisances: tuple[Nuisance, ...]
    groups: tuple[Group, ...]


@dataclass(frozen=True, kw_only=True)
class InverseDynamics:
    """Inverse dynamics of the nominal model of a recording; torques of shape (t, n)."""

    recording: Recording

    def torque(self, motion: Motion, edit: Callable[[mujoco.MjModel], None] | None = None) -> Array:
        """Torque for a motion, of the model or of an edited copy of it."""
        model = self.recording.model()
        if edit is not None:
            edit(model)
        data = mujoco.MjData(model)
        out = np.empty_like(motion[0])
        for k, (q, v, a) in enumerate(zip(*motion, strict=True)):
            data.qpos, data.qvel, data.qacc = q, v, a
            mujoco.mj_inverse(model, data)
            out[k] = data.qfrc_inverse
        return out

    def mass(self, motion: Motion, body: int, base: Array) -> Array:
        """Derivative by the relative mass of a body, its inertia growing with it."""

        def double(model: mujoco.MjModel) -> None:
            model.body_mass[body] *= 2.0
            model.body_inertia[body] *= 2.0

        return self.torque(motion, double) - base

    def inertia(self, motion: Motion, body: int, base: Array) -> Array:
        """Derivative by the relative inertia of a body about its centre of mass."""

        def double(model: mujoco.MjModel) -> None:
            model.body_inertia[body] *= 2.0

        return self.torque(motion, double) - base

    def centre(self, motion: Motion, body: int, base: Array) -> Array:
        """Derivatives by the centre of mass of a body in its own frame, of shape (t, n, 3)."""
        columns = []
        for axis in range(3):

            def move(model: mujoco.MjModel, axis: int = axis) -> None:
                model.body_ipos[body, axis] += _LENGTH

            columns.append((self.torque(motion, move) - base) / _LENGTH)
        return np.stack(columns, axis=-1)

    def point_mass(self, motion: Motion, body: int, place: Array, base: Array) -> Array:
        """Torque of a kilogram at a place of a body, and by its first moment: (t, n, 4)."""

        def loaded(shift: Array) -> Array:
            def add(model: mujoco.MjModel) -> None:
                _add_point(model, body, place + shift)

            return self.torque(motion, add) - base

        at = loaded(np.zeros(3))
        moves = [(loaded(_LENGTH * axis) - at) / _LENGTH for axis in np.eye(3)]
        return np.stack([at, *moves], axis=-1)

    def tilt(self, motion: Motion, base: Array) -> Array:
        """Derivatives by a turn of the base about the world's x and y, of shape (t, n, 2)."""
        columns = []
        for axis in np.eye(3)[:2]:

            def lean(model: mujoco.MjModel, axis: Array = axis) -> None:
                # the base turns, so gravity turns back in its frame
                model.opt.gravity[:] += np.cross(-_ANGLE * axis, model.opt.gravity)

            columns.append((self.torque(motion, lean) - base) / _ANGLE)
        return np.stack(columns, axis=-1)

    def position(self, motion: Motion, joint: int, base: Array) -> Array:
        """Derivative by the position of a joint."""
        moved = motion[0].copy()
        moved[:, joint] += _ANGLE
        return (self.torque((moved, motion[1], motion[2])) - base) / _ANGLE

    def weight(self, motion: Motion, body: int) -> Array:
        """Torque that carries the weight of a body at rest."""
        still = (motion[0], np.zeros_like(motion[0]), np.zeros_like(motion[0]))
        return self.mass(still, body, self.torque(still))


def _add_point(model: mujoco.MjModel, body: int, place: Array) -> None:
    """Add a kilogram to a body, in place; the new tensor gets principal axes again."""
    mass, centre = model.body_mass[body], model.body_ipos[body].copy()
    whole = mass + 1.0
    middle = (mass * centre + place) / whole
    tensor = _tensor(model, body)
    for weight, arm in ((mass, centre - middle), (1.0, place - middle)):
        tensor += weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    model.body_mass[body], model.body_ipos[body] = whole, middle
    _set_tensor(model, body, tensor)


def _tensor(model: mujoco.MjModel, body: int) -> Array:
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    axes = turn.reshape(3, 3)
    return np.asarray(axes @ np.diag(model.body_inertia[body]) @ axes.T)


def _set_tensor(model: mujoco.MjModel, body: int, tensor: Array) -> None:
    values, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.linalg.det(axes)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    model.body_inertia[body], model.body_iquat[body] = values, quaternion


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
    """Regressor of a run."""
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

        def group(kind: str, *names: str, nominal: float = 0.0, where: str = name) -> Group:
            return Group(
                kind=kind, where=where, width=len(names), read=_plain(*names),
                positive=True, nominal=nominal,
            )  # fmt: skip

        found.at_joint(group("coulomb_friction", "torque"), j, [coulomb])
        damping = float(model.dof_damping[j])
        found.at_joint(group("viscous_friction", "damping", nominal=damping), j, [viscous])
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
                    grid=True, positive=True,
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
                    read=_gain("factor"), nominal=1.0,
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
            Group(kind="actuator_gain", where=name, width=1, read=_inverse_gain,
                  nominal=1.0),
            j, [base[:, j]],
        )  # fmt: skip
        for kind, read, least, column in (
            ("command_delay", _plain("delay"), clock, slope[:, j]),
            ("actuator_lag", _plain("time_constant"), clock, rate[:, j]),
            ("dead_zone", _plain("width"), 0.0, zone),
        ):
            group = Group(kind=kind, where=name, width=1, read=read, positive=True, least=least)
            found.at_joint(group, j, [column])
    everywhere = Group(
        kind="command_delay", where="all", width=1, read=_plain("delay"),
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
            Group(kind="gravity_compensation", where=name, width=1, read=_plain("share")),
            -dynamics.weight(motion, b)[..., None],
        )
    site = next((s for s in range(model.nsite) if model.site(s).name == "tool"), None)
    if site is not None:
        body, place = int(model.site_bodyid[site]), model.site_pos[site].copy()
        found.add(
            Group(kind="payload", where="tool", width=4, read=_payload, positive=True),
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
              largest=grid.largest_angle),
        dynamics.tilt(motion, base),
    )  # fmt: skip
    for j in range(model.njnt):
        name, q = model.joint(j).name, motion[0][:, j]
        if _is_slide(model, j):
            continue
        found.add(
            Group(kind="encoder_offset", where=name, width=1, read=_plain("offset"),
                  largest=grid.largest_angle),
            -dynamics.position(motion, j, base)[..., None],
        )  # fmt: skip
        for order in grid.ripple_orders:
            found.at_joint(
                Group(kind="torque_ripple", where=name, width=2, read=_ripple(order),
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


_RIDGE = 1e-10
"""Ridge relative to the diagonal of the normal equations: it only keeps them solvable."""
_RANK = 1e-7
"""Share of a column that has to be left by the others, squared, for it to be a direction."""


@dataclass(frozen=True, kw_only=True)
class RegressionSettings:
    """Settings of the regression."""

    tolerance: float = 0.03
    """Largest relative error of nominal parameters."""
    confidence: float = 0.95
    """Of intervals."""
    longest_lag_s: float = 0.3
    """Longest lag at which autocorrelation of the residual counts [s]."""
    filter: FilterSettings = field(default_factory=FilterSettings)
    grid: GridSettings = field(default_factory=GridSettings)

    @property
    def prior_sd(self) -> float:
        """Prior standard deviation of a relative error within ± tolerance, all equally likely."""
        return float(self.tolerance / np.sqrt(3.0))


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A fit of some groups."""

    chosen: tuple[int, ...]
    """Numbers of the groups."""
    coefficients: Array
    """Of nuisances, then of the chosen groups in their order."""
    covariance: Array
    """Of the coefficients, with the autocorrelation of the residual in it."""
    bound: tuple[int, ...]
    """Numbers of the nominal parameters that are on the bound of their tolerance."""
    objective: float
    """Weighted sum of squares, with that of the prior."""


@dataclass(frozen=True, kw_only=True)
class Regression:
    """Rows of all runs; training rows as normal equations in units of weighted residuals."""

    settings: RegressionSettings
    runs: tuple[str, ...]
    groups: tuple[Group, ...]
    nuisances: int
    """Number of nuisance columns, which come first."""
    weights: Array
    """Standard deviation of a row of each joint for the fit, of shape (n,) [N m or N]."""
    noise: Array
    """What of that is the sensors' noise, of shape (n,)."""
    rows: tuple[Array, ...]
    """For each run, of shape (t, n, columns + 1): nuisances, groups, target [N m or N]."""
    rate_hz: float
    """Rate of the rows."""
    driven: bool
    """Whether there are torques."""
    inflation: float = 1.0
    """Rows for each independent one."""

    def span(self, group: int) -> slice:
        """Columns of a group."""
        start = self.nuisances + sum(g.width for g in self.groups[:group])
        return slice(start, start + self.groups[group].width)

    def columns(self, chosen: Sequence[int]) -> Array:
        """Numbers of the nuisance columns and those of the chosen groups."""
        spans = [np.arange(self.nuisances)]
        spans += [np.arange(self.span(g).start, self.span(g).stop) for g in chosen]
        return np.concatenate(spans)

    @property
    def scale(self) -> tuple[Group, ...]:
        """Groups that give the scale of a response without torques, and have to stay nominal."""
        if self.driven:
            return ()
        kinds = ("link_mass", "rotor_inertia")
        return tuple(next(g for g in self.groups if g.kind == kind) for kind in kinds)

    @property
    def training(self) -> tuple[int, ...]:
        """Numbers of the runs that are fitted."""
        return tuple(range(max(1, len(self.rows) - 1)))

    def gram(self, runs: Sequence[int] | None = None) -> Array:
        """Normal equations of some runs with the prior: training runs by default."""
        which = self.training if runs is None else runs
        total = np.zeros((self.rows[0].shape[-1],) * 2)
        for i in which:
            flat = (self.rows[i] / self.weights[:, None]).reshape(-1, total.shape[0])
            total += flat.T @ flat
        own = np.arange(self.nuisances)
        total[own, own] += 1.0 / self.settings.prior_sd**2
        return total

    @property
    def independent_rows(self) -> float:
        """Number of independent training rows."""
        count = sum(self.rows[i].shape[0] * self.rows[i].shape[1] for i in self.training)
        return float(count / self.inflation)

    def fit(self, chosen: Sequence[int], gram: Array | None = None) -> Fit:
        """Fit some groups beside the nominal parameters, which stay within the tolerance."""
        gram = self.gram() if gram is None else gram
        at = self.columns(chosen)
        inner, right = gram[np.ix_(at, at)], gram[at, -1]
        scale = np.sqrt(np.diag(inner))
        scale[scale == 0] = 1.0
        factor = linalg.cholesky(
            inner / np.outer(scale, scale) + _RIDGE * np.eye(len(at)), check_finite=False
        )
        limits = np.full(len(at), np.inf)
        limits[: self.nuisances] = self.settings.tolerance * scale[: self.nuisances]
        wanted = linalg.solve_triangular(factor, right / scale, trans="T")
        values = linalg.solve_triangular(factor, wanted)
        bound = np.zeros(len(at), dtype=bool)
        if (np.abs(values) > limits).any():
            solved = optimize.lsq_linear(factor, wanted, (-limits, limits), method="bvls")
            values, bound = solved.x, solved.active_mask != 0
        inverse = np.zeros_like(inner)
        free = np.flatnonzero(~bound)
        inverse[np.ix_(free, free)] = linalg.inv((factor.T @ factor)[np.ix_(free, free)])
        values, inverse = values / scale, inverse / np.outer(scale, scale)
        return Fit(
            chosen=tuple(chosen),
            coefficients=values,
            covariance=inverse * self.inflation,
            bound=tuple(map(int, np.flatnonzero(bound))),
            objective=float(gram[-1, -1] - 2 * right @ values + values @ inner @ values),
        )

    def gains(self, fit: Fit, gram: Array | None = None) -> Array:
        """What each group takes off the objective when it joins a fit, of shape (groups,)."""
        gram = self.gram() if gram is None else gram
        at = self.columns(fit.chosen)
        bound = list(fit.bound)
        fixed, own = at[bound], np.delete(at, bound)
        target = gram[:, -1] - gram[:, fixed] @ fit.coefficients[bound]
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        inner = gram[np.ix_(own, own)] / np.outer(scale[own], scale[own])
        factor = linalg.cho_factor(inner + _RIDGE * np.eye(len(own)))
        cross = gram[own] / scale[own][:, None]
        solved = linalg.cho_solve(factor, np.column_stack((cross, target[own] / scale[own])))
        left = target - cross.T @ solved[:, -1]
        gains = np.zeros(len(self.groups))
        for g in range(len(self.groups)):
            if g in fit.chosen:
                continue
            span = self.span(g)
            size = scale[span]
            schur = gram[span, span] - cross[:, span].T @ solved[:, span]
            inverse = linalg.pinvh(schur / np.outer(size, size), rtol=_RANK, atol=_RANK)
            values = inverse @ (left[span] / size)
            if self._possible(self.groups[g], values / size):
                gains[g] = (left[span] / size) @ values
        return gains

    @staticmethod
    def _possible(group: Group, values: Array) -> bool:
        right_sign = not group.positive or values[0] > 0.0
        return bool(right_sign and np.all(np.abs(values) <= group.largest))

    def counts(self, fit: Fit, position: int) -> bool:
        """Whether an effect is possible and beyond what the tolerance of the model allows."""
        group, values = self.groups[fit.chosen[position]], fit.coefficients
        own = values[self.within(fit, position)]
        allowed = self.settings.tolerance * group.nominal + group.least
        return self._possible(group, own) and bool(np.abs(own[0]) > allowed)

    def residual(self, fit: Fit, run: int) -> Array:
        """Residual torque of a run, of shape (t, n) [N m or N]."""
        rows = self.rows[run]
        return np.asarray(rows[..., -1] - rows[..., self.columns(fit.chosen)] @ fit.coefficients)

    def held_out(self, fit: Fit) -> float:
        """Root mean square of the held-out run's residual [noise sd]."""
        return float(np.sqrt(np.mean((self.residual(fit, -1) / self.noise) ** 2)))

    def effect(self, fit: Fit, position: int) -> NamedEffect:
        """Effect at a position among the chosen ones; intervals by the delta method."""
        group, at = self.groups[fit.chosen[position]], self.within(fit, position)
        values, covariance = fit.coefficients[at], fit.covariance[at, at]
        parameters = group.read(values)
        z = float(stats.norm.ppf(0.5 + 0.5 * self.settings.confidence))
        slopes = {name: np.zeros(len(values)) for name in parameters}
        for i, sd in enumerate(np.sqrt(np.diag(covariance))):
            step = 1e-3 * sd + 1e-12
            up, down = (group.read(values + sign * step * _unit(i, values)) for sign in (1, -1))
            for name in parameters:
                slopes[name][i] = (up[name] - down[name]) / (2 * step)
        intervals = {}
        for name, slope in slopes.items():
            half = z * float(np.sqrt(slope @ covariance @ slope))
            if half > 0:
                intervals[name] = (parameters[name] - half, parameters[name] + half)
        return NamedEffect(
            kind=group.kind,
            where=group.where,
            parameters=parameters,
            interval_95=intervals,
            in_model=False,
        )

    def within(self, fit: Fit, position: int) -> slice:
        """Coefficients of the group at a position among the chosen ones."""
        widths = [self.groups[g].width for g in fit.chosen]
        start = self.nuisances + sum(widths[:position])
        return slice(start, start + widths[position])

    def finding(self, method: str, fit: Fit, settings: Mapping[str, Any]) -> Finding:
        """What a method found: the groups of a fit, beside the fit of none."""
        return Finding(
            method=method,
            before=self.held_out(self.fit([])),
            after=self.held_out(fit),
            held_out=self.runs[-1],
            effects=[self.effect(fit, i) for i in range(len(fit.chosen))],
            settings=settings,
        )


def _unit(i: int, like: Array) -> Array:
    out = np.zeros_like(like)
    out[i] = 1.0
    return out


def regression_of(
    folder: Path, tolerance: float, rng: np.random.Generator, **options: object
) -> Regression:
    """Read a recording and set up its regression."""
    settings = RegressionSettings(tolerance=tolerance, **options)  # type: ignore[arg-type]
    recording = read_recording(folder)
    runs = joint_runs(recording, settings.filter)
    columns = [columns_of(recording, run, settings.grid) for run in runs]
    noise = _noise(recording, runs, columns, settings, rng)
    rows = tuple(
        np.concatenate((c.nuisance, c.candidates, c.target[..., None]), axis=-1) for c in columns
    )
    low_pass = runs[0].low_pass
    first = Regression(
        settings=settings,
        runs=tuple(run.name for run in runs),
        groups=columns[0].groups,
        nuisances=len(columns[0].nuisances),
        weights=noise,
        noise=noise,
        rows=rows,
        rate_hz=low_pass.rate_hz / low_pass.stride,
        driven=any(bool(run.torque.any()) for run in runs),
    )
    return _reweighted(first)


def _noise(
    recording: Recording,
    runs: tuple[JointRun, ...],
    columns: Sequence[Columns],
    settings: RegressionSettings,
    rng: np.random.Generator,
) -> Array:
    """Noise of the residual torque of each joint, of shape (n,)."""
    dynamics, total, count = InverseDynamics(recording=recording), 0.0, 0
    for own, replica in zip(columns, noise_replicas(recording, runs, rng), strict=True):
        target = replica.low_pass.reduced(replica.torque) - dynamics.torque(replica.motion())
        total = total + np.sum((target - own.target) ** 2, axis=0)
        count += len(target)
    return np.asarray(np.sqrt(total / count))


def _reweighted(first: Regression) -> Regression:
    """Weights and autocorrelation from what a fit of all groups outside grids leaves."""
    # without torques the whole regressor would fit any motion by an arm of no inertia
    fit = first.fit([i for i, g in enumerate(first.groups) if not g.grid] * first.driven)
    residuals = [first.residual(fit, i) for i in first.training]
    left = np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0))
    weights = np.maximum(first.noise, left) if first.driven else first.noise
    lags = round(first.settings.longest_lag_s * first.rate_hz)
    inflation = _inflation([r / weights for r in residuals], lags)
    return dataclasses.replace(first, weights=weights, inflation=inflation)


def _inflation(residuals: Sequence[Array], lags: int) -> float:
    """Rows for each independent one: 1 + 2 sum of autocorrelations up to the first below zero."""
    total = sum(float(np.sum(r * r)) for r in residuals)
    inflation = 1.0
    for lag in range(1, lags + 1):
        share = sum(float(np.sum(r[lag:] * r[:-lag])) for r in residuals) / total
        if share <= 0.0:
            break
        inflation += 2.0 * share
    return inflation


@dataclass(frozen=True, kw_only=True)
class StepwiseSettings:
    """Settings of the selection."""

    least_drop: float = 10.0
    """Least drop of the criterion by a group: above 10 the evidence is very strong (Kass and
    Raftery, JASA 1995)."""
    most_groups: int = 15
    """Groups after which selection ends: as many as a whole machine may have."""
    seed: int = 0
    """Seed of the noise replica by which the noise of the residual is measured."""


def run_stepwise_bic(recording: Path, folder: Path, tolerance: float) -> None:
    """Select effects of a recording stepwise and write the result."""
    settings = StepwiseSettings()
    regression = regression_of(recording, tolerance, np.random.default_rng(settings.seed))
    fit = selected(regression, settings)
    told = {"tolerance": tolerance, "seed": settings.seed}
    write_finding(folder, regression.finding("stepwise_bic", fit, told))


def selected(regression: Regression, settings: StepwiseSettings) -> Fit:
    """Fit of the groups that forward steps with deletions choose."""
    gram = regression.gram()
    search = 2.0 * np.log(len(regression.groups))
    widths = np.array([group.width for group in regression.groups])
    prices = widths * np.log(regression.independent_rows) + search
    fit = regression.fit([], gram)
    while len(fit.chosen) < settings.most_groups:
        drops = regression.gains(fit, gram) / regression.inflation - prices
        best = int(np.argmax(drops))
        if drops[best] < settings.least_drop:
            break
        larger = regression.fit([*fit.chosen, best], gram)
        drop = (fit.objective - larger.objective) / regression.inflation - prices[best]
        if drop < settings.least_drop or not regression.counts(larger, len(fit.chosen)):
            prices[best] = np.inf  # nominal parameters inside the tolerance explain it
            continue
        fit = _without_idle(regression, larger, prices, gram, settings.least_drop)
    return fit


def _without_idle(
    regression: Regression, fit: Fit, prices: np.ndarray, gram: np.ndarray, least_drop: float
) -> Fit:
    """Drop groups, the least useful first, that the others have made superfluous."""
    newest = fit.chosen[-1]
    while len(fit.chosen) > 1:
        smaller = {g: regression.fit(_others(fit.chosen, g), gram) for g in fit.chosen[:-1]}
        worth = {
            g: (own.objective - fit.objective) / regression.inflation - prices[g]
            for g, own in smaller.items()
        }
        if not worth:
            break
        idle = min(worth, key=lambda g: worth[g])
        if worth[idle] >= least_drop:
            break
        fit = smaller[idle]
    assert newest in fit.chosen
    return fit


def _others(chosen: Sequence[int], group: int) -> list[int]:
    return [g for g in chosen if g != group]
