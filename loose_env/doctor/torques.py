"""Corrections of a recording by which the model explains its torques.

For the recording as it is, and for each correction (a reversed sign, exchanged joints, another
unit, another direction of gravity, a clock offset, a current in place of a torque), the torque of
joint j is

    tau_j = ID_j(q) + f_j tanh(v_j / v_0) + d_j v_j + a_j dv_j/dt + o_j,   f_j, d_j, a_j >= 0,

with ID the inverse dynamics of the nominal model; friction, rotor inertia and an offset are fitted
to each joint. The share of the torque's variance that is left tells the corrections apart: one is
offered where the recording as it stands leaves more than `UNEXPLAINED`, and the corrected one at
most 1 / `CLEARER` of that, less than `EXPLAINED`, and at most 1 / `BETTER` of what the best single
error of the model leaves: what a payload or a gain explains is left to `loose gap`. Those errors
are linear in bounded coefficients: mass within a link's reach and its own mass, the masses of all
links, a drive's gain, a spring at a joint, the zero of an encoder, and a base that is not level.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import mujoco
import numpy as np

from loose_env.doctor.corrections import Correction, corrected
from loose_env.doctor.findings import Defect, Finding
from loose_env.doctor.machine import Machine, forces_of, positions_of
from loose_env.importing import dry_friction, filled, inverse_dynamics, median_step, smoothed
from loose_env.recording import Run
from loose_env.typing import Array

# Corrections by torques
UNEXPLAINED = 0.1
"""Share of the torque's variance that model, friction and rotor inertia leave of the recording as
it stands, above which corrections are tried: errors of payload and gravity remain below."""
CLEARER = 5.0
"""Share left as it stands over that left by a correction, from which it is offered: a free choice
among dozens of changes explains some of an unknown effect by chance."""
BETTER = 2.0
"""Share left by the best single error of the model over that left by a correction, from which the
correction is offered: where both explain the torques, the recording need not be wrong. A further
correction that leaves less than so much of the best one is named beside it."""
EXPLAINED = 0.2
"""Largest share that a correction may leave to be offered: the right one leaves unmodelled effects
and noise."""
LARGEST_GAIN = 4.0
"""Gain between recorded and needed torque, or its inverse, from which it is another quantity: gains
of drives and nominal inertias are off by less."""
LARGEST_ZERO_RAD = 0.5
"""Largest error of an encoder's zero that is tried beside the corrections [rad]: the torque is
linear in it up to there."""
TURNED_GRAVITY_DEG = 15.0
"""Angle of fitted gravity to the model's, from which it points elsewhere [deg]: bases are level to
a few degrees."""
GRAVITY_MATCH = 0.3
"""Relative distance of the fitted gravity's size from the model's, up to which it is believed:
masses are off by less."""
LARGEST_OFFSET_S = 0.3
"""Largest clock offset of torques that is tried [s]: recorders started by hand are told by their
first motion."""
LEAST_OFFSET_S = 0.01
"""Least offset of them that is named [s]: below, rotor inertia and damping explain the same."""
TORQUE_BAND_HZ = 5.0
"""End of the band in which torques are compared [Hz]: that of arm motion."""
TORQUE_POINTS = 300
"""Points of a run at which torques are compared: four coefficients of a joint are fitted."""
SPACING = 10
"""Steps from one to the next at most [1]: torques of the band are independent after 0.2 s. Longer
runs are compared about their middle."""
TORQUE_RUNS = 4
"""Runs of that: all are of one recorder."""

_SMALL = 1e-4
"""Change of a position for its derivative [rad or m]."""
_CHECKS = {"scale": "units", "exchange": "names", "shift": "clock", "gravity": "gravity"}
_CHANGED = Defect(
    "units", "error", "effects found would make up for it",
    "check it at the machine; --fix DIR writes the corrected recording",
)  # fmt: skip


def _changed(channel: str, found: str, value: float, fix: Correction) -> Finding:
    check = "sign" if fix.kind == "scale" and fix.factor == -1.0 else _CHECKS[fix.kind]
    return _CHANGED.at(channel, found, value, unit="1", check=check, fix=fix)


def check_torques(machine: Machine, runs: Sequence[Run]) -> Iterator[Finding]:
    """Name the correction of a recording by which the model explains its torques."""
    fit = TorqueFit.of(machine, runs)
    if fit is None or (as_is := fit.left()) <= UNEXPLAINED:
        return
    most = min(EXPLAINED, as_is / CLEARER)
    tried = [(fit.left(fix), words, fix) for words, fix in _corrections(fit)]
    good = sorted((each for each in tried if each[0] <= most), key=lambda each: each[0])
    if good and (rival := _left_by_model_errors(fit) / BETTER) < most:
        good = [each for each in good if each[0] <= rival]
    if not good:
        return
    left, words, fix = good[0]
    others = [also for share, also, _ in good[1:4] if share <= BETTER * max(left, 1e-3)]
    found = f"{words}: the model then leaves {left:.1%} of the torques' variance, as recorded "
    found += _share(as_is)
    found += (
        f"; {' and '.join(others)} explain{'s' * (len(others) == 1)} it alike" if others else ""
    )
    yield _changed(", ".join(fix.columns) or fix.kind, found, left, fix)


def confirmed(machine: Machine, runs: Sequence[Run], found: Sequence[Finding]) -> Iterator[Finding]:
    """Findings on positions; an error, with the share of variance left, where torques confirm.

    What is only probable is left out where the model explains the torques better without.
    """
    sure = [each for each in found if each.fix is None or each.severity == "error"]
    fit = TorqueFit.of(machine, runs) if any(each.fix for each in found) else None
    if fit is not None and len(sure) < len(found):
        with_all, without = (
            fit.left(*(each.fix for each in some if each.fix)) for some in (found, sure)
        )
        found = found if with_all < without else sure
    fixes = [each.fix for each in found if each.fix is not None]
    as_is, left = (fit.left(), fit.left(*fixes)) if fit is not None else (0.0, 0.0)
    if as_is <= UNEXPLAINED or left > as_is / CLEARER:
        yield from found
        return
    more = f"; so corrected, the model leaves {left:.1%} of the torques' variance, as recorded "
    for each in found:
        told = replace(each, severity="error", found=each.found + more + _share(as_is))
        yield told if each.fix is not None else each


def _share(share: float) -> str:
    """Share in words: as a percentage, or as a multiple from ten on."""
    return f"{share:.0%}" if share < 10 else f"{share:.3g} times as much"


class _Rows(NamedTuple):
    """Motion of all joints and torque of some at the compared points of all runs, (E, joints)."""

    q: Array
    v: Array
    a: Array
    torque: Array


class TorqueFit:
    """Recorded torques of smoothed runs beside those that the model needs."""

    def __init__(self, machine: Machine, runs: Sequence[Run], torques: Mapping[str, str]) -> None:
        self.machine, self.runs, self.torques = machine, runs, torques
        model, ids = machine.model, [machine.model.joint(j).id for j in machine.joints]
        self.places, self.dofs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
        self.encoders = {j: c.name for j, c in positions_of(machine, runs[0]).items()}
        self.measured = [[*machine.joints].index(j) for j in torques]
        self.rows = self._rows(runs)
        self.needed = self.needs(self.rows.q)

    @classmethod
    def of(cls, machine: Machine, runs: Sequence[Run]) -> TorqueFit | None:
        """Fit of the first runs that have all positions and the first one's torques, or None."""
        if machine.model.nv != len(machine.joints) or not runs:
            return None
        forces = forces_of(machine, runs[0])
        torques = {j: forces[j][0] for j in machine.joints if j in forces}
        smooth = []
        for run in runs:
            step = max(median_step(run.time), 0.1 / TORQUE_BAND_HZ)
            whole = int((run.time[-1] - run.time[0]) / step) + 1
            count = min(whole, SPACING * TORQUE_POINTS)
            known = set(torques) <= set(forces_of(machine, run))
            known &= set(machine.joints) <= set(positions_of(machine, run))
            if known and count >= 40 and step <= 0.25 / TORQUE_BAND_HZ:
                rows = np.arange(count) + (whole - count) // 2
                smooth.append(_smoothed(run, run.time[0] + step * rows))
        if not torques or not smooth:
            return None
        fit = cls(machine, smooth[:TORQUE_RUNS], torques)
        return fit if fit.rows.torque.std(axis=0).max() > 0 else None

    def _rows(self, runs: Sequence[Run]) -> _Rows:
        parts = []
        for run in runs:
            measured, forces = positions_of(self.machine, run), forces_of(self.machine, run)
            q = np.stack(
                [filled(run.time, measured[j].values) for j in self.machine.joints], axis=1
            )
            v = np.gradient(q, run.time, axis=0)
            a = np.gradient(v, run.time, axis=0)
            torque = np.stack([forces[j][1] for j in self.torques], axis=1)
            # The ends have no derivative.
            at = np.linspace(9, len(q) - 10, min(TORQUE_POINTS, len(q) - 18)).astype(int)
            parts.append(_Rows(*(values[np.unique(at)] for values in (q, v, a, torque))))
        return _Rows(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    def needs(
        self, q: Array, model: mujoco.MjModel | None = None, rows: _Rows | None = None
    ) -> Array:
        """Torque that the model, or a changed copy, needs for the motion, (E, torques)."""
        model, rows = model or self.machine.model, rows or self.rows
        whole = np.tile(model.qpos0, (len(q), 1))
        speed, change = np.zeros((2, len(q), model.nv))
        whole[:, self.places], speed[:, self.dofs], change[:, self.dofs] = q, rows.v, rows.a
        return inverse_dynamics(model, whole, speed, change)[:, self.dofs[self.measured]]

    def left(self, *fixes: Correction) -> float:
        """Share of the torque's variance left in the corrected recording [1]."""
        rows = self._rows([corrected(run, fixes) for run in self.runs]) if fixes else self.rows
        gravity = [fix.vector for fix in fixes if fix.vector is not None]
        if gravity:
            return self.share_left(rows, self.needs(rows.q, self.with_gravity(gravity[-1]), rows))
        same = np.array_equal(rows.q, self.rows.q)
        return self.share_left(rows, self.needed if same else self.needs(rows.q, rows=rows))

    def with_gravity(self, vector: Sequence[float] | Array) -> mujoco.MjModel:
        """Copy of the model in which gravity is a vector."""
        changed = copy.copy(self.machine.model)
        changed.opt.gravity[:] = vector
        return changed

    def share_left(self, rows: _Rows, needed: Array) -> float:
        """Share of the variance left, mean over the joints; infinite where it overflows."""
        if not np.isfinite(needed).all():
            return np.inf
        spread = np.std(rows.torque, axis=0)
        parts = [
            self.with_friction(rows.torque[:, k] - needed[:, k], rows, k)[1] / spread[k] ** 2
            for k in range(len(spread))
            if spread[k] > 1e-3 * spread.max()
        ]
        return float(np.mean(parts)) if parts else 0.0

    def nuisance(self, rows: _Rows, k: int) -> Array:
        """Torque of friction, damping and rotor inertia of one each, and an offset (E, 4)."""
        speed, change = rows.v[:, self.measured[k]], rows.a[:, self.measured[k]]
        return np.stack([dry_friction(speed), speed, change, np.ones_like(speed)], axis=1)

    def with_friction(
        self, values: Array, rows: _Rows, k: int, *more: Array
    ) -> tuple[Array, float]:
        """Non-negative coefficients of further torques and friction; mean square of the rest."""
        from scipy.optimize import nnls  # half a second, and only recordings with torques need it

        columns = np.column_stack([*more, self.nuisance(rows, k), -np.ones(len(values))])
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        found, rest = nnls(columns / size, values, maxiter=1000)  # the offset has either sign
        return found / size, float(rest) ** 2 / len(values)

    def beyond(self, columns: Array) -> Array:
        """Torques (E, J, C) beyond friction and rotor inertia, over their spread (E J, C)."""
        spread, found = self.rows.torque.std(axis=0), []
        for k in range(columns.shape[1]):
            basis = np.linalg.qr(self.nuisance(self.rows, k))[0]
            rest = columns[:, k] - basis @ (basis.T @ columns[:, k])
            found.append(rest / max(float(spread[k]), 1e-12 * float(spread.max()) + 1e-300))
        return np.concatenate(found)


def _smoothed(run: Run, grid: Array) -> Run:
    """Run of slow signals on an even grid."""
    width = max(1, round(0.5 / TORQUE_BAND_HZ / (grid[1] - grid[0])))

    def slow(columns: Mapping[str, Array]) -> dict[str, Array]:
        even = {
            name: np.interp(grid, run.time, filled(run.time, v))
            for name, v in columns.items()
            if v.ndim == 1
        }
        return {name: smoothed(smoothed(v, width), width) for name, v in even.items()}

    controls, sensors, torques = (slow(c) for c in (run.controls, run.sensors, run.torques))
    return replace(run, time=grid, controls=controls, sensors=sensors, torques=torques)


def _corrections(fit: TorqueFit) -> Iterator[tuple[str, Correction]]:
    """Every change of a recording that is tried, in words."""
    encoders = {j: fit.encoders[j] for j in fit.machine.joints}
    signs: list[tuple[str, ...]]
    signs = [(column,) for of in (fit.torques, encoders) for column in of.values()]
    signs += [(encoders[joint], column) for joint, column in fit.torques.items()]
    for columns in signs:
        fix = Correction(kind="scale", columns=columns, factor=-1.0)
        yield f"the opposite sign of {' and '.join(columns)}", fix
    for of in (encoders, fit.torques):
        for pair in combinations(of.values(), 2):
            yield f"{' and '.join(pair)} exchanged", Correction(kind="exchange", columns=pair)
    hinges = [encoders[j] for j in fit.machine.joints if fit.machine.hinge(j)]
    for columns in dict.fromkeys([tuple(hinges), *((column,) for column in hinges)]):
        if columns:
            fix = Correction(kind="scale", columns=columns, factor=float(np.pi / 180))
            yield f"{' and '.join(columns)} in degrees", fix
    yield from _late(fit)
    yield from _gravity(fit)
    for k, (joint, column) in enumerate(fit.torques.items()):
        gain = float(fit.with_friction(fit.rows.torque[:, k], fit.rows, k, fit.needed[:, k])[0][0])
        if gain > 0 and not 1 / LARGEST_GAIN < gain < LARGEST_GAIN:
            unit = "N·m" if fit.machine.hinge(joint) else "N"
            words = f"{column} is {gain:.3g} times the torque in {unit}: a current or another unit"
            yield words, Correction(kind="scale", columns=(column,), factor=1 / gain)


def _late(fit: TorqueFit) -> Iterator[tuple[str, Correction]]:
    """Best clock offset of all torques."""

    def shifted(seconds: float) -> Correction:
        return Correction(kind="shift", columns=tuple(fit.torques.values()), seconds=seconds)

    tried = np.arange(-LARGEST_OFFSET_S, LARGEST_OFFSET_S + 1e-9, 0.01)
    best = 0.0
    for offsets in (tried, np.arange(-0.01, 0.0101, 0.001)):
        best += float(min(offsets, key=lambda d, at=best: fit.left(shifted(at + d))))  # type: ignore[misc]
    if LEAST_OFFSET_S <= abs(best) < LARGEST_OFFSET_S:
        word = "late" if best > 0 else "early"
        yield f"the torques {1e3 * abs(best):.0f} ms {word} against the positions", shifted(best)


def _gravity(fit: TorqueFit) -> Iterator[tuple[str, Correction]]:
    """Gravity by least squares: the torque is linear in it."""
    own = fit.machine.model.opt.gravity
    size = float(np.linalg.norm(own)) or 9.81
    free = fit.needs(fit.rows.q, fit.with_gravity(np.zeros(3)))
    unit = [fit.needs(fit.rows.q, fit.with_gravity(axis)) - free for axis in np.eye(3)]
    right = fit.beyond((fit.rows.torque - free)[:, :, None])[:, 0]
    found = np.linalg.lstsq(fit.beyond(np.stack(unit, axis=2)), right, rcond=1e-6)[0]
    length = float(np.linalg.norm(found))
    if not np.isfinite(length) or abs(length / size - 1) > GRAVITY_MATCH:
        return
    cosine = float(found @ own) / (length * size) if np.any(own) else -1.0
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    if angle >= TURNED_GRAVITY_DEG:
        x, y, z = (round(float(g), 3) for g in found * size / length)
        words = f"gravity along ({x:g}, {y:g}, {z:g}) m/s², {angle:.0f} degrees from the model's"
        yield words, Correction(kind="gravity", vector=(x, y, z))


# ------------------------------------------------------------------------- errors of the model


def _left_by_model_errors(fit: TorqueFit) -> float:
    """Share of the torque's variance that the best single error of the model leaves [1]."""
    from scipy.optimize import lsq_linear  # a second, and most recordings need none

    right, best = fit.beyond((fit.rows.torque - fit.needed)[:, :, None])[:, 0], np.inf
    for torque, low, high in (*_masses(fit), *_at_joints(fit)):
        if np.isfinite(torque).all():
            bounds = np.broadcast_to(low, torque.shape[2]), np.broadcast_to(high, torque.shape[2])
            found = lsq_linear(fit.beyond(torque), right, bounds).x
            best = min(best, fit.share_left(fit.rows, fit.needed + torque @ found))
    return best


_Error = tuple[Array, Array | float, Array | float]
"""Torque by each coefficient of an error (E, J, C), with the coefficients' bounds."""


def _masses(fit: TorqueFit) -> Iterator[_Error]:
    """Mass added at points of a link, or taken from its own; own masses of all links; a tilt."""
    model, q = fit.machine.model, fit.rows.q
    bare = copy.copy(model)
    bare.body_mass[:], bare.body_inertia[:] = 0.0, 0.0
    without, own = fit.needs(q, bare), []
    for link in np.unique(model.body_weldid[model.body_weldid > 0]):
        parts = np.flatnonzero(model.body_weldid == link)
        whole = copy.copy(bare)
        whole.body_mass[parts], whole.body_inertia[parts] = (
            model.body_mass[parts], model.body_inertia[parts],
        )  # fmt: skip
        own.append(fit.needs(q, whole) - without)
        columns = [own[-1]]
        for point in _points(model, int(link)):
            loaded = copy.copy(bare)
            loaded.body_mass[link], loaded.body_ipos[link] = 1.0, point
            columns.append(fit.needs(q, loaded) - without)
        yield np.stack(columns, axis=2), np.where(np.arange(len(columns)) == 0, -1.0, 0.0), np.inf
    yield np.stack(own, axis=2), -1.0, np.inf
    gravity = model.opt.gravity
    tilted = [fit.needs(q, fit.with_gravity(gravity + axis)) - fit.needed for axis in np.eye(3)]
    most = float(np.linalg.norm(gravity)) * np.sin(np.radians(TURNED_GRAVITY_DEG)) + 1e-9
    yield np.stack(tilted, axis=2), -most, most


def _points(model: mujoco.MjModel, link: int) -> Array:
    """Centre of mass of a link and six points about it, as far as the link reaches [m]."""
    engine = mujoco.MjData(model)
    mujoco.mj_kinematics(model, engine)
    parts = np.flatnonzero(model.body_weldid == link)
    outside = np.flatnonzero(np.isin(model.body_parentid, parts))
    at = [engine.xpos[link], *engine.xpos[outside], *engine.xipos[parts]]
    at += [*engine.site_xpos[np.isin(model.site_bodyid, parts)]]
    reach = max(float(np.linalg.norm(point - engine.xipos[link])) for point in at)
    inertia = float(model.body_inertia[link].max()) / max(float(model.body_mass[link]), 1e-9)
    around = max(reach, float(np.sqrt(inertia))) * np.concatenate([np.eye(3), -np.eye(3)])
    return np.asarray(model.body_ipos[link] + np.concatenate([np.zeros((1, 3)), around]))


def _at_joints(fit: TorqueFit) -> Iterator[_Error]:
    """A drive's gain, a spring, and an encoder's zero, at one joint each."""
    for joint, unit in zip(fit.machine.joints, np.eye(len(fit.machine.joints)), strict=True):
        if fit.machine.hinge(joint):
            slope = (fit.needs(fit.rows.q + _SMALL * unit) - fit.needed) / _SMALL
            yield slope[:, :, None], -LARGEST_ZERO_RAD, LARGEST_ZERO_RAD
    for k, own in enumerate(np.eye(len(fit.measured))):
        gain, spring = fit.needed[:, k], fit.rows.q[:, fit.measured[k]]
        yield (gain[:, None] * own)[:, :, None], 1 / LARGEST_GAIN - 1, LARGEST_GAIN - 1
        yield (spring[:, None] * own)[:, :, None], 0.0, np.inf
