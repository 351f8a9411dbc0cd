"""Alternative readings of a recording by which the model explains the measured torques.

For the joint positions and torques as recorded, and for each alternative (a reversed sign,
exchanged joints, another unit, another direction of gravity, a clock offset, a current in place of
a torque), the torque of joint j is

    tau_j = ID_j(q) + f_j tanh(v_j / v_0) + d_j v_j + a_j dv_j/dt + o_j,   f_j, d_j, a_j >= 0,

with ID the inverse dynamics of the nominal model; friction, rotor inertia and an offset are fitted
to each joint. The share of the torque's variance that is left tells the alternatives apart: one is
named where the recording as it stands leaves more than `UNEXPLAINED`, and the alternative leaves at
most 1 / `CLEARER` of that, less than `EXPLAINED`, and at most 1 / `BETTER` of what the best single
error of the model leaves: what a payload or a gain explains is left to `loose gap`.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from loose_env.doctor.channels import Factors, Machine, Runs, filled, positions
from loose_env.doctor.corrections import Correction
from loose_env.doctor.findings import Finding
from loose_env.doctor.model_checks.forces import recorded_forces
from loose_env.doctor.model_checks.model_errors import left_by_model_errors
from loose_env.doctor.model_checks.torque_fit import (
    TorqueData,
    compared_points,
    left_as_recorded,
    mapped,
    measured_torque,
    needed_torque,
    nuisance,
    share_left,
    torque_data,
    with_friction,
)
from loose_env.doctor.thresholds import (
    ALIKE_SHARE,
    BETTER,
    CLEARER,
    EXPLAINED,
    FOLLOWS_OTHER,
    FOLLOWS_OWN,
    GRAVITY_MATCH,
    LARGEST_GAIN,
    LARGEST_OFFSET_S,
    LEAST_OFFSET_S,
    SERVO_RUNS,
    TURNED_GRAVITY_DEG,
    UNEXPLAINED,
)


@dataclass(frozen=True, kw_only=True)
class _Alternative:
    left: float
    """Share of the variance left [1]."""
    channel: str
    words: str
    check: str
    fix: Correction


def check_alternatives(
    machine: Machine,
    runs: Runs,
    factors: Factors,
) -> Iterator[Finding]:
    """Name the change of a recording by which the model explains its torques."""
    yield from _exchanged_servos(machine, runs)
    names = _columns(machine, runs)
    if names is None:
        return
    positions, torques = names
    data = torque_data(machine, runs, factors, list(torques))
    if data is None:
        return
    dofs = [int(machine.model.jnt_dofadr[machine.model.joint(j).id]) for j in torques]
    as_is = left_as_recorded(machine, data, dofs)
    measured = [run.name for run, _ in runs]
    yield from _by_factors(machine, data, dofs, positions, factors, as_is, measured)
    if as_is <= UNEXPLAINED:
        return
    tried = [*_reversed(machine, data, dofs, positions, torques)]
    tried += _exchanged(machine, data, dofs, positions, torques)
    tried += _degrees(machine, data, dofs, positions)
    tried += _late(machine, data, dofs, torques)
    tried += _gravity(machine, data, dofs)
    tried += _gains(machine, data, dofs, torques)
    most = min(EXPLAINED, as_is / CLEARER)
    if all(a.left > most for a in tried):
        return
    most = min(most, left_by_model_errors(machine, data, dofs) / BETTER)
    good = sorted((a for a in tried if a.left <= most), key=lambda a: a.left)
    if not good:
        return
    best = good[0]
    others = [a.words for a in good[1:4] if a.left <= ALIKE_SHARE * max(best.left, 1e-3)]
    also = f"; {' and '.join(others)} explain{'s' * (len(others) == 1)} it alike" if others else ""
    yield _finding(
        check=best.check,
        channel=best.channel,
        found=f"{best.words}: the model then leaves {best.left:.1%} of the torques' variance, as "
        f"recorded {_part(as_is)}{also}",
        value=best.left,
        fix=best.fix,
    )


def _part(share: float) -> str:
    """Share in words: as a percentage, or as a multiple from ten on."""
    return f"{share:.0%}" if share < 10 else f"{share:.3g} times as much"


def _finding(
    *, check: str, channel: str, found: str, value: float, fix: Correction, run: str = ""
) -> Finding:
    """Error that a correction of the recording mends."""
    return Finding(
        check=check,
        severity="error",
        run=run,
        channel=channel,
        found=found,
        value=value,
        unit="1",
        consequence="effects found would make up for it",
        remedy=f"check it at the machine; --fix DIR writes the recording with {fix.words}",
        fix=fix,
    )


def _by_factors(
    machine: Machine,
    data: TorqueData,
    dofs: list[int],
    positions: Mapping[str, str],
    factors: Factors,
    corrected: float,
    names: Sequence[str],
) -> Iterator[Finding]:
    """Confirm by the torques what limits and poses say of a position's unit or sign."""
    found: dict[tuple[str, float], list[str]] = {}
    for (run, joint), factor in factors.items():
        if factor != 1.0:
            found.setdefault((joint, factor), []).append(run)
    scales = [
        np.array([factors.get((run, joint), 1.0) for joint in machine.joints]) for run in data.runs
    ]
    if not found or all((scale == 1.0).all() for scale in scales):
        return
    recorded = [q / scale for q, scale in zip(data.positions, scales, strict=True)]
    as_is = left_as_recorded(machine, replace(data, positions=recorded), dofs)
    if as_is <= UNEXPLAINED or corrected > as_is / CLEARER:
        return
    for (joint, factor), own in found.items():
        fix = Correction(kind="scale", columns=(positions[joint],), factor=factor)
        for run in [""] if set(own) >= set(names) else own:
            yield _finding(
                check="units" if factor > 0 else "sign",
                channel=positions[joint],
                run=run,
                found=f"multiplied by {factor:.4g}, the model leaves {corrected:.1%} of the "
                f"torques' variance, as recorded {_part(as_is)}",
                value=factor,
                fix=fix.of(run),
            )


def _columns(machine: Machine, runs: Runs) -> tuple[dict[str, str], dict[str, str]] | None:
    """Position and torque column of each joint; None where a position is not measured."""
    model = machine.model
    if model.nv != len(machine.joints) or not runs:
        return None
    run, channels = runs[0]
    encoders = {joint: c.name for joint, c in positions(channels).items()}
    torques = {j: column for j, (column, _) in recorded_forces(machine, run, channels).items()}
    ordered = {j: torques[j] for j in machine.joints if j in torques}
    return (encoders, ordered) if set(encoders) >= set(machine.joints) and torques else None


def _reversed(
    machine: Machine,
    data: TorqueData,
    dofs: list[int],
    positions: Mapping[str, str],
    torques: Mapping[str, str],
) -> Iterator[_Alternative]:
    measured = list(torques)
    for k, joint in enumerate(machine.joints):
        flip = np.ones(len(machine.joints))
        flip[k] = -1.0
        turned = np.ones(len(measured))
        both: tuple[str, ...] = (positions[joint],)
        if joint in measured:
            turned[measured.index(joint)] = -1.0
            both = (positions[joint], torques[joint])
            left = left_as_recorded(machine, mapped(data, torques=np.diag(turned)), dofs)
            yield _sign(left, torques[joint])
        yield _sign(
            left_as_recorded(machine, mapped(data, positions=np.diag(flip)), dofs), positions[joint]
        )
        if len(both) > 1:
            changed = mapped(data, positions=np.diag(flip), torques=np.diag(turned))
            yield _sign(left_as_recorded(machine, changed, dofs), *both)


def _sign(left: float, *columns: str) -> _Alternative:
    names = " and ".join(columns)
    return _Alternative(
        left=left,
        channel=", ".join(columns),
        words=f"the opposite sign of {names}",
        check="sign",
        fix=Correction(kind="scale", columns=columns, factor=-1.0),
    )


def _exchanged(
    machine: Machine,
    data: TorqueData,
    dofs: list[int],
    positions: Mapping[str, str],
    torques: Mapping[str, str],
) -> Iterator[_Alternative]:
    for names, columns in ((machine.joints, positions), (list(torques), torques)):
        for a, b in combinations(range(len(names)), 2):
            order = np.eye(len(names))
            order[:, [a, b]] = order[:, [b, a]]
            changed = mapped(data, **{"positions" if columns is positions else "torques": order})
            pair = (columns[names[a]], columns[names[b]])
            yield _Alternative(
                left=left_as_recorded(machine, changed, dofs),
                channel=", ".join(pair),
                words=f"{pair[0]} and {pair[1]} exchanged",
                check="names",
                fix=Correction(kind="exchange", columns=pair),
            )


def _degrees(
    machine: Machine, data: TorqueData, dofs: list[int], positions: Mapping[str, str]
) -> Iterator[_Alternative]:
    hinges = [j for j in machine.joints if machine.hinge(j)]
    for joints in ([hinges] if len(hinges) > 1 else []) + [[j] for j in hinges]:
        factor = np.array([np.pi / 180 if j in joints else 1.0 for j in machine.joints])
        columns = tuple(positions[j] for j in joints)
        yield _Alternative(
            left=left_as_recorded(machine, mapped(data, positions=np.diag(factor)), dofs),
            channel=", ".join(columns),
            words=f"{' and '.join(columns)} in degrees",
            check="units",
            fix=Correction(kind="scale", columns=columns, factor=float(np.pi / 180)),
        )


def _late(
    machine: Machine, data: TorqueData, dofs: list[int], torques: Mapping[str, str]
) -> Iterator[_Alternative]:
    needed, speed, change = needed_torque(machine, data, dofs)

    def left(offset: float) -> float:
        measured = []
        for step, own in zip(data.steps, data.torques, strict=True):
            grid = step * np.arange(len(own))
            moved = np.stack([np.interp(grid + offset, grid, t) for t in own.T], axis=1)
            measured.append(moved[compared_points(len(own))])
        return share_left(np.concatenate(measured), needed, speed, change)

    offsets = np.arange(-LARGEST_OFFSET_S, LARGEST_OFFSET_S + 1e-9, 0.01)
    shares = [left(d) for d in offsets]
    best = float(offsets[int(np.argmin(shares))])
    fine = best + np.arange(-0.01, 0.0101, 0.001)
    offset = float(fine[int(np.argmin([left(d) for d in fine]))])
    if LEAST_OFFSET_S <= abs(offset) < LARGEST_OFFSET_S:
        word = "late" if offset > 0 else "early"
        yield _Alternative(
            left=left(offset),
            channel="torques",
            words=f"the torques {1e3 * abs(offset):.0f} ms {word} against the positions",
            check="clock",
            fix=Correction(kind="shift", columns=tuple(torques.values()), seconds=offset),
        )


def _gravity(machine: Machine, data: TorqueData, dofs: list[int]) -> Iterator[_Alternative]:
    """Gravity by least squares: the torque is linear in it."""
    own = machine.model.opt.gravity.copy()
    size = float(np.linalg.norm(own)) or 9.81
    changed = copy.copy(machine.model)
    changed.opt.gravity[:] = 0.0
    free, speed, change = needed_torque(machine, data, dofs, changed)
    unit = []
    for axis in np.eye(3):
        changed.opt.gravity[:] = axis
        unit.append(needed_torque(machine, data, dofs, changed)[0] - free)
    measured = measured_torque(data)
    rows, right = [], []
    for j in range(measured.shape[1]):
        basis = np.linalg.qr(nuisance(speed[:, j], change[:, j]))[0]
        both = np.column_stack([*(u[:, j] for u in unit), measured[:, j] - free[:, j]])
        both = (both - basis @ (basis.T @ both)) / max(float(np.std(measured[:, j])), 1e-12)
        rows.append(both[:, :3])
        right.append(both[:, 3])
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=1e-6)[0]
    length = float(np.linalg.norm(found))
    if not np.isfinite(length) or abs(length / size - 1) > GRAVITY_MATCH:
        return
    cosine = float(found @ own) / (length * size) if np.any(own) else -1.0
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    if angle < TURNED_GRAVITY_DEG:
        return
    vector = found * size / length
    needed = free + sum(u * g for u, g in zip(unit, vector, strict=True))
    x, y, z = (round(float(g), 3) for g in vector)
    yield _Alternative(
        left=share_left(measured, needed, speed, change),
        channel="gravity",
        words=f"gravity along ({x:g}, {y:g}, {z:g}) m/s², {angle:.0f} degrees from the model's",
        check="gravity",
        fix=Correction(kind="gravity", vector=(x, y, z)),
    )


def _gains(
    machine: Machine, data: TorqueData, dofs: list[int], torques: Mapping[str, str]
) -> Iterator[_Alternative]:
    """Recorded values that are the torque times one gain for each joint: currents, other units."""
    needed, speed, change = needed_torque(machine, data, dofs)
    measured = measured_torque(data)
    gains, parts = [], []
    for j in range(measured.shape[1]):
        found, rest = with_friction(measured[:, j], speed[:, j], change[:, j], [needed[:, j]])
        gains.append(float(found[0]))
        parts.append(rest / max(float(np.var(measured[:, j])), 1e-300))
    for j, (joint, column) in enumerate(torques.items()):
        gain = gains[j]
        if gain <= 0 or 1 / LARGEST_GAIN < gain < LARGEST_GAIN:
            continue
        others = [k for k in range(len(gains)) if k != j]
        alone = needed.copy()
        alone[:, j] *= gain
        left = share_left(measured, alone, speed, change) if others else parts[j]
        unit = "N·m" if machine.hinge(joint) else "N"
        yield _Alternative(
            left=left,
            channel=column,
            words=f"{column} is {gain:.3g} times the torque in {unit}: a current or another unit",
            check="units",
            fix=Correction(kind="scale", columns=(column,), factor=1 / gain),
        )


def _exchanged_servos(machine: Machine, runs: Runs) -> Iterator[Finding]:
    """Name two servos each of which follows the other's command."""
    followed: dict[tuple[str, str], list[float]] = {}
    columns: dict[str, str] = {}
    for run, channels in runs[:SERVO_RUNS]:
        measured = positions(channels)
        commands = {}
        for c in channels:
            drive = machine.drives.get(c.of) if c.kind == "command" else None
            if drive is not None and drive.follows:
                commands[drive.joint] = filled(run.time, c.values) * (drive.gear or 1.0)
        columns |= {joint: c.name for joint, c in measured.items()}
        for a, command in commands.items():
            for b, position in measured.items():
                own = filled(run.time, position.values)
                if np.std(command) > 0 and np.std(own) > 0:
                    followed.setdefault((a, b), []).append(float(np.corrcoef(command, own)[0, 1]))
    mean = {pair: float(np.mean(values)) for pair, values in followed.items()}
    for a, b in combinations([j for j in machine.joints if (j, j) in mean], 2):
        across = min(mean.get((a, b), 0.0), mean.get((b, a), 0.0))
        straight = max(abs(mean[a, a]), abs(mean[b, b]))
        if across < FOLLOWS_OTHER or straight > FOLLOWS_OWN:
            continue
        fix = Correction(kind="exchange", columns=(columns[a], columns[b]))
        yield _finding(
            check="names",
            channel=f"{columns[a]}, {columns[b]}",
            found=f"each follows the other's command (correlation {across:.2f}, with its own "
            f"{straight:.2f}): exchanged",
            value=across,
            fix=fix,
        )
