"""What the arm did: how the sensor is turned, springs of the gears, accelerations of the links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from loose_env.instrument.arm import PoseModel, SuspectArm
from loose_env.instrument.records import Record
from loose_env.instrument.ringing import GRID
from loose_env.instrument.signals import Multisine
from loose_env.typing import Array, ComplexArray, IndexArray

_LOSS = 0.06
"""Loss factor of a gear's spring [1]."""
MODE_HZ, _MODE_SPREAD = 35.0, 3.3
"""Usual mode of an arm on its gears [Hz] and the spread of its logarithm: 20 to 60 Hz in
industrial arms (Klimchik et al. 2014), wide enough for a desk arm and a stiff gantry."""
_ROTOR_SPREAD = 1.0
_SLOPE = 1e-3  # relative step of numerical derivatives
_LATE_S = 2e-3
"""Usual error of an alignment of two clocks [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Gears:
    """What carries the encoders' motion to the tool; n joints."""

    rotation: Array
    """Turns each record's sensor as mounted into the model's (R, 3, 3)."""
    late: Array
    """Time by which each record's accelerometer lags its encoders (R,) [s]."""
    spring: Array
    """Spring of each gear (n,) [N·m/rad, N/m]."""
    rotor: Array
    """Rotor inertia on the link side of the spring (n,) [kg·m², kg]."""
    left: float
    """Share of the tool's motion that they leave [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Lines:
    """Excited lines of a record as the gears see them."""

    hertz: Array
    joints: ComplexArray
    tool: ComplexArray
    model: PoseModel
    scale: float


def links_of(
    joints: ComplexArray,
    model: PoseModel,
    spring: Array,
    rotor: Array,
    hertz: Array,
    loss: Array | float,
) -> ComplexArray:
    """Lines of link acceleration (..., k, n) from the motors' (k, n), the links on springs.

    By springs, rotors and losses of the gears (..., n), of one set or of several.
    """
    stiff = (spring * (1 + 1j * np.asarray(loss)))[..., None, :]
    omega2 = (2 * np.pi * hertz[:, None, None]) ** 2
    diagonal = np.eye(spring.shape[-1])
    inertia = model.inertia + rotor[..., None] * diagonal
    system = stiff[..., None] * diagonal - omega2 * inertia[..., None, :, :]
    return np.asarray(np.linalg.solve(system, (joints * stiff)[..., None])[..., 0])


def turned(
    record: Record, gears: Gears, index: int, lines: IndexArray, period: float
) -> ComplexArray:
    """Lines of the tool (k, 3) in the model's frame and on the encoders' clock."""
    late = np.exp(2j * np.pi * lines / period * gears.late[index])[:, None]
    found: ComplexArray = (record.tool[lines] * late) @ gears.rotation[index].T
    return found


def mounted(records: Sequence[Record], models: Sequence[PoseModel], signal: Multisine) -> Array:
    """Turn of each record's sensor (R, 3, 3), by gravity and slow motion (Wahba's problem)."""
    each = {name: np.zeros((3, 3)) for name in {record.sensor for record in records}}
    for record, model in zip(records, models, strict=True):
        b = each[record.sensor]  # one in all poses
        if np.any(model.up):
            b += 3 * np.outer(model.up, record.gravity) / (model.up @ model.up)
        slow = np.arange(1, len(record.joints))
        hertz = slow / signal.period_s
        slow = slow[(hertz >= 3) & (hertz <= 8)]
        own = record.joints[slow]
        told = own @ model.jacobian.T + model.tilt(own, slow / signal.period_s)
        read = record.tool[slow]
        b += np.real(told.T @ read.conj()) / max(float((np.abs(read) ** 2).sum()), 1e-12)
    u, _, v = np.linalg.svd(np.array([each[record.sensor] for record in records]))
    u[:, :, 2] *= np.linalg.det(u @ v)[:, None]
    rotation: Array = u @ v
    return rotation


def fit_gears(
    arm: SuspectArm, records: Sequence[Record], models: Sequence[PoseModel], signal: Multisine
) -> Gears:
    """Springs of the gears that carry the encoders' motion to the tool, as it was measured.

    Linear, without servo or friction; from the low lines upward, since a start above a mode falls
    into a wrong valley.
    """
    rotation = mounted(records, models, signal)
    n, excited = arm.n, signal.excited
    data = [
        _Lines(
            hertz=signal.hertz,
            joints=record.joints[excited],
            tool=record.tool[excited] @ turn.T,
            model=model,
            scale=float(np.sqrt(np.mean(np.abs(record.tool[excited]) ** 2))),
        )
        for record, model, turn in zip(records, models, rotation, strict=True)
    ]
    own = np.mean([np.diag(d.model.inertia) for d in data], 0)

    def parts(p: Array) -> tuple[Array, Array]:
        rotor = arm.rotors / (1 + np.exp(-p[..., n : 2 * n]))
        return (own + rotor) * (2 * np.pi * np.exp(p[..., :n])) ** 2, rotor

    def misses(p: Array, highest: float) -> Array:
        """Of several sets of parameters (P, parameters), all at once (P, rows)."""
        use = signal.hertz <= highest
        spring, rotor = parts(p)
        found = [
            (p[:, :n] - np.log(MODE_HZ)) / _MODE_SPREAD,
            (p[:, n : 2 * n] + 4.0) / _ROTOR_SPREAD,
            p[:, 2 * n :],
        ]
        for k, d in enumerate(data):
            moved = links_of(d.joints[use], d.model, spring, rotor, d.hertz[use], _LOSS)
            told = moved @ d.model.jacobian.T + d.model.tilt(moved, d.hertz[use])
            late = np.exp(2j * np.pi * d.hertz[use] * _LATE_S * p[:, [2 * n + k]])[..., None]
            e = (d.tool[use] * late - told) / d.scale
            e = e / np.sqrt(1 + np.abs(e) ** 2)  # a resonance missed by a hair must not rule
            found += [e.real.reshape(len(p), -1), e.imag.reshape(len(p), -1)]
        return np.concatenate(found, axis=1)

    def miss(p: Array, highest: float) -> Array:
        return np.asarray(misses(p[None], highest)[0])

    def slopes(p: Array, highest: float) -> Array:
        steps = _SLOPE * np.maximum(np.abs(p), 1.0)
        base, *moved = misses(np.vstack([p, p + np.diag(steps)]), highest)
        return np.asarray(((moved - base) / steps[:, None]).T)

    top = float(signal.hertz.max())
    best = None
    for mode in (20.0, 35.0, 60.0):
        p = np.r_[np.full(n, np.log(mode)), np.full(n, -4.0), np.zeros(len(data))]
        for highest in (9.0, 13.0, 19.0, top):
            if highest <= top:
                fit = least_squares(miss, p, slopes, max_nfev=12, args=(highest,))
                p = fit.x
        best = fit if best is None or fit.cost < best.cost else best
    assert best is not None
    spring, rotor = parts(best.x)
    return Gears(
        rotation=rotation,
        late=_LATE_S * best.x[2 * n :],
        spring=spring,
        rotor=rotor,
        left=float(np.mean(best.fun[2 * n + len(data) :] ** 2) * 2),
    )


def wave(lines: ComplexArray) -> Array:
    """Real waves (GRID, c) of lines (L, c)."""
    full = np.zeros((GRID // 2 + 1, lines.shape[1]), dtype=complex)
    full[: len(lines)] = lines / 2
    full[0] = 0.0
    found: Array = np.fft.irfft(full * GRID, GRID, axis=0)
    return found


def accelerations(
    record: Record, model: PoseModel, gears: Gears, index: int, period: float
) -> Array:
    """Link accelerations over a period (GRID, n).

    Encoders through the gears, then moved as little as needed toward the tool as measured.
    """
    k = np.arange(1, len(record.joints))
    hertz = k / period
    own = record.joints[k]
    lines = np.zeros(record.joints.shape, dtype=complex)
    moved = links_of(own, model, gears.spring, gears.rotor, hertz, _LOSS)
    read = turned(record, gears, index, k, period) - model.tilt(moved, hertz)
    spread = np.diag(np.mean(np.abs(moved) ** 2, 0) + 1e-12)
    told = model.jacobian @ spread @ model.jacobian.T
    noise = _TRUST**2 * np.trace(told) / 3 * np.eye(3)
    gain = spread @ model.jacobian.T @ np.linalg.inv(told + noise)
    lines[k] = moved + (read - moved @ model.jacobian.T) @ gain.T
    return wave(lines)


_TRUST = 0.3
"""Error of the springs' tool motion, relative to it, at which encoders and tool weigh alike [1]."""


def rotor_speeds(record: Record, period: float) -> Array:
    """Motor speeds over a period (GRID, n) [rad/s, m/s]."""
    k = np.arange(len(record.joints))
    lines = record.joints.astype(complex)
    lines[1:] = lines[1:] / (2j * np.pi * k[1:, None] / period)
    return wave(lines)


_SOFTER = (0.15, 0.3, 0.45, 0.6, 0.75, 0.88, 1.0)
"""Springs tried, over the healthy one's [1]."""
_LOSSIER = (_LOSS, 0.3, 0.8)
_HEAVIER = (-0.4, 4.0)
"""Range of the mass at the tool, over the mass that the tool feels like when it is pushed [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Softening:
    """Share of the tool's motion left by the healthy gears, and by others [1]; n joints."""

    none: float
    """With the healthy gears."""
    joints: Array
    """With the one joint softer that is best (n,)."""
    payload: float
    """With the payload that is best."""
    payload_kg: float
    """That payload, over the healthy day's [kg]."""


def softening(
    records: Sequence[Record],
    models: Sequence[PoseModel],
    gears: Gears,
    signal: Multisine,
) -> Softening:
    """Tool motion left where one joint has become softer, or the tool heavier."""
    n = len(gears.spring)
    rotors = np.diag(gears.rotor)
    felt = [3 / np.trace(np.linalg.solve(m.inertia + rotors, m.held)) for m in models]
    reads = [turned(r, gears, k, signal.excited, signal.period_s) for k, r in enumerate(records)]

    def left(factors: Array, losses: Array, load: float) -> float:
        """Share left with springs by factors, and a mass at the tool."""
        shares = []
        for record, model, read in zip(records, models, reads, strict=True):
            inertia = model.inertia + load * model.held
            moved = links_of(
                record.joints[signal.excited], replace(model, inertia=inertia),
                gears.spring * factors, gears.rotor, signal.hertz, losses,
            )  # fmt: skip
            told = moved @ model.jacobian.T + model.tilt(moved, signal.hertz)
            e = np.abs(read - told) ** 2 / float(np.mean(np.abs(read) ** 2))
            shares.append(np.mean(e / (1 + e)))
        return float(np.mean(shares))

    ones, loss = np.ones(n), np.full(n, _LOSS)
    softer = np.zeros((n, len(_SOFTER), len(_LOSSIER)))
    for j, a, b in np.ndindex(softer.shape):
        at = np.arange(n) == j
        softer[j, a, b] = left(np.where(at, _SOFTER[a], 1.0), np.where(at, _LOSSIER[b], _LOSS), 0.0)
    bounds = np.array(_HEAVIER) * float(np.mean(felt))
    heavy = minimize_scalar(
        lambda load: left(ones, loss, load), bounds=bounds, options={"xatol": 0.01 * bounds[1]}
    )
    return Softening(
        none=left(ones, loss, 0.0),
        joints=softer.min((1, 2)),
        payload=float(heavy.fun),
        payload_kg=float(heavy.x),
    )
