"""Frequency response of the uncertain arm to commands and seat motion; spectral leakage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.response.sensor_rows import rows_of, sensing_of, stepped_of
from loose_env.instrument.inference.response.uncertain_linear_arm import PoseModel
from loose_env.instrument.settings.tolerances import Tolerances
from loose_env.typing import Array, ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Response for given nuisance parameters; m coordinates, s = 7 n seats, c channels."""

    at: PoseModel
    lines: Lines
    errors: Array
    inertia: Array
    """Inertia for these parameters (m + s, m + s)."""
    jacobian: Array
    """Jacobians of the sites for them (S, 3, m + s)."""
    compliance: ComplexArray
    """Displacement per force (K, m, m)."""
    rows: ComplexArray
    """Readings per displacement (K, c, m), the sensors' errors in them."""
    push: ComplexArray
    """Readings per force (K, c, m)."""
    columns: ComplexArray
    """Readings per acceleration of each seat (K, c, s)."""
    sudden: Array
    """Readings of accelerometers per acceleration of each seat that is faster than the samples
    can follow: inertia alone answers (c, s)."""
    coupling: Array
    """Force on the coordinates per acceleration of each seat, negative (K, m, s)."""
    force: ComplexArray
    """Force of the commands on the moving coordinates (K, m)."""
    pushed: ComplexArray
    """Force on them that was measured at the tool, within `force` (K, m)."""
    motion: ComplexArray
    """Displacement that it makes (K, m)."""
    jump: ComplexArray
    """Acceleration just after the commands have stepped, less what held commands make on average
    (K, m)."""
    step: ComplexArray
    """Readings of accelerometers that are sampled just then, for it (K, c)."""
    mean: ComplexArray
    """Readings of the healthy arm (K, c)."""
    beside: Response | None = None
    """Response to the same run of the healthy arm, if the run is compared with it."""

    @property
    def expected(self) -> ComplexArray:
        """Readings expected of the healthy arm (K, c), by the run it is compared with too."""
        return self.mean if self.beside is None else np.asarray(self.mean + self.beside.residual)

    @property
    def unexplained(self) -> float:
        """Share of the accelerometers' power that the healthy arm leaves unexplained [1]."""
        rows = [
            k for k, (reading, _) in enumerate(self.lines.row) if reading.kind == "acceleration"
        ]
        left = np.sum(np.abs(self.residual[:, rows]) ** 2)
        return float(left / max(np.sum(np.abs(self.lines.readings[:, rows]) ** 2), 1e-300))

    @property
    def residual(self) -> ComplexArray:
        """Residual of the healthy arm (K, c), less that of the run it is compared with."""
        return np.asarray(self.lines.readings - self.expected)

    @property
    def acceleration(self) -> Array:
        """Size of all accelerations that are read (K,) [m/s²]."""
        rows = [r.kind == "acceleration" for r, _ in self.lines.row]
        return np.asarray(np.linalg.norm(self.lines.readings[:, rows], axis=1))

    def joint_columns(self) -> ComplexArray:
        """Readings per acceleration of each joint by a force on it alone (K, c, n)."""
        n = self.at.of.arm.n
        own = np.diagonal(self.compliance[:, :n, :n], axis1=1, axis2=2)
        omega2 = (2 * np.pi * self.lines.frequency[:, None]) ** 2
        return np.asarray(self.push[:, :, :n] / (-omega2 * own)[:, None, :])

    def floating(self, seats: NDArray[np.intp], axes: Array) -> Array:
        """Acceleration of a frictionless seat, by axis (U, K) [m/s² or rad/s²]."""
        load, mass = self.across_seat(seats)
        drive = axes @ load.T
        pairs = (axes[:, :, None] * axes[:, None, :]).reshape(len(axes), -1)
        heavy = pairs @ mass.reshape(len(mass), -1).T
        return np.asarray(np.abs(drive) / np.maximum(np.abs(heavy), 1e-12))

    def across(self, seats: NDArray[np.intp], axes: Array) -> ComplexArray:
        """Force transmitted by the closed seat, by axis (U, K)."""
        return np.asarray(axes @ self.across_seat(seats)[0].T)

    def across_seat(self, seats: NDArray[np.intp]) -> tuple[ComplexArray, ComplexArray]:
        """Force across a closed seat (K, s'), and apparent mass behind it (K, s', s')."""
        m = self.at.size
        inertia, jacobian = self.inertia, self.jacobian
        omega2 = ((2 * np.pi * self.lines.frequency) ** 2)[:, None]
        coupling = inertia[m:, :m][seats]
        force = -omega2 * self.motion @ coupling.T
        force = force - self.lines.tool_force @ jacobian[0, :, m:][:, seats]
        own = inertia[m:, m:][np.ix_(seats, seats)]
        by_seat = -self.compliance @ self.coupling[:, :, seats]  # displacement
        moved = -omega2[:, :, None] * (coupling @ by_seat)
        return force, own + moved

    def slopes(self, seat: ComplexArray) -> ComplexArray:
        """Jacobian of the residual's model with respect to the nuisance parameters (K, c, P)."""
        own = self._slopes(seat)
        return own if self.beside is None else own - self.beside.slopes(np.zeros_like(seat))

    def _slopes(self, seat: ComplexArray) -> ComplexArray:
        """Jacobian of the channels with respect to the nuisance parameters (K, c, P)."""
        at, lines, of = self.at, self.lines, self.at.of
        arm, t = of.arm, of.tolerances
        n, m = arm.n, at.size
        omega = 2 * np.pi * lines.frequency
        s = 1j * omega
        pulled = self.coupling @ seat[:, :, None]
        motion = self.motion - (self.compliance @ pulled)[:, :, 0]
        whole = np.concatenate([-(omega**2)[:, None] * motion, seat], axis=1)  # accelerations
        slopes = np.zeros((*lines.readings.shape, len(self.errors)), dtype=complex)
        push = self.push
        sampled = lines.sampled
        inertia, jacobian = self.inertia, self.jacobian
        force = -_each(at.inertia_by_row, whole)
        ease, r = _ease(at, inertia), at.rigid
        jump = np.zeros_like(whole)
        jump[:, :r] = sampled * self.jump[:, :r]
        stepped = -_each(at.inertia_by_row, jump)[:, :, :m] @ ease if sampled else None
        slopes[:, :, of.bodies] = push @ force.swapaxes(1, 2)
        sensing = sensing_of(at, lines, self.errors)
        for k, (reading, axis) in enumerate(lines.row):
            if reading.kind == "acceleration":
                along = sensing.get(reading.sensor, np.eye(3))[axis] @ at.jacobian[:, reading.at]
                slopes[:, k, of.bodies] += whole @ along.T
                slopes[:, k, of.bodies] += sampled * (self.jump @ along[:, :m].T)
                own = sensing.get(reading.sensor, np.eye(3))[axis] @ jacobian[reading.at, :, :m]
                if stepped is not None:
                    slopes[:, k, of.bodies] += stepped @ own
        drives = arm.actuators
        driving = self.force[:, :n] - self.pushed[:, :n]
        of_drive = ~(lines.measured | lines.blind)
        kept = [
            -s[:, None] * _own_damping(at, n) * motion[:, :n] * t.damping,
            -drives.stiffness * of_drive * motion[:, :n] * t.servo_gain
            + np.where((drives.stiffness > 0) & of_drive, t.servo_gain, 0.0) * driving,
            -s[:, None] * drives.damping * of_drive * motion[:, :n] * t.servo_gain,
            driving * _gain_error(at),
        ]
        for j in range(n):
            for part, values in enumerate(kept):
                slopes[:, :, of.springs.start + part * n + j] = push[:, :, j] * values[:, j, None]
        pulled = -(motion[:, None, None, at.rigid :] @ at.elastic_slopes(self.errors))[:, :, 0]
        slopes[:, :, of.stiffnesses] = push[:, :, at.rigid :] @ pulled.swapaxes(1, 2)
        # Gains and delays act on what steps as on what is held.
        per_force = _stepping(self, jacobian, sensing, ease)
        hold = _held(omega, lines.period)
        noted = lines.force * _late(self.at, lines, self.errors)[0][:, None]
        unheld = sampled * (driving - noted) * (1 / hold - 1)[:, None]
        unheld[:, ~of_drive] = 0.0
        for part, size in (
            (1, np.where((drives.stiffness > 0) & of_drive, t.servo_gain, 0.0)),
            (3, _gain_error(at)),
        ):
            for j in range(n):
                slopes[:, :, of.springs.start + part * n + j] += (
                    per_force[:, :, j] * (unheld[:, j] * size[j])[:, None]
                )
        late = np.einsum("kcm,km->kc", push, -s[:, None] * self.force)
        late = late + sampled * -s[:, None] * self.step
        delays = of.delays(lines.number)
        slopes[:, :, delays.start] = t.command_delay * late
        readings = self.mean + np.einsum("kcs,ks->kc", self.columns, seat)
        on_sites = np.array([r.on_site for r, _ in lines.row])
        low_pass, by_lag = _low_pass(s, t, float(self.errors[of.reading_lag][1]))
        for column, each in (
            (delays.start + 1, -t.sensor_delay * s),
            (of.reading_lag.start, -t.sensor_clock * s),
            (of.reading_lag.start + 1, by_lag / low_pass),
        ):
            slopes[:, on_sites, column] = each[:, None] * readings[:, on_sites]
        for at_sensor, k in enumerate(of.sensors):
            sensor = arm.readings[k].sensor
            own = [i for i, (r, _) in enumerate(lines.row) if r.sensor == sensor]
            if len(own) != 3:
                continue
            for i in range(3):
                for j in range(3):
                    spread = t.sensor_gain if i == j else t.cross_axis
                    column = of.sensing.start + 9 * at_sensor + 3 * i + j
                    slopes[:, own[i], column] = spread * readings[:, own[j]]
        return slopes


def respond(at: PoseModel, lines: Lines, errors: Array) -> Response:
    """Frequency response for given nuisance parameters, in standard deviations (P,)."""
    of = at.of
    arm, t = of.arm, of.tolerances
    n, m = arm.n, at.size
    omega = 2 * np.pi * lines.frequency
    s = np.asarray(1j * omega, dtype=complex)
    inertia, jacobian = at.parts(errors)
    stiffness, damping = at.springs(errors)
    drives = arm.actuators
    held, slow = np.split(errors[of.springs], 3)[1:]
    free = lines.measured | lines.blind
    joints = np.arange(n)
    stiffness[joints, joints] -= np.where(free, drives.stiffness * (1 + t.servo_gain * held), 0.0)
    damping[:n] -= np.where(free, drives.damping * (1 + t.servo_gain * slow), 0.0)
    # Gravity's stiffness is all of the load's change but for what the servo's target takes.
    dynamic: ComplexArray = np.asarray(
        -(omega**2)[:, None, None] * inertia[:m, :m] + at.weight[:m] + stiffness, dtype=complex
    )
    dynamic[:, np.arange(m), np.arange(m)] += s[:, None] * damping
    compliance: ComplexArray = np.asarray(np.linalg.inv(dynamic), dtype=complex)
    hold = _held(omega, lines.period)
    late, late_site = _late(at, lines, errors)
    command = lines.command * (hold * late)[:, None] / (1 + s[:, None] * drives.lag)
    noted = lines.force * late[:, None]
    force = np.zeros((len(omega), m), dtype=complex)
    factor = (1 + t.servo_gain * held * (drives.stiffness > 0)) * (
        1 + _gain_error(at) * errors[of.gains]
    )
    force[:, :n] = np.where(free, 0.0, factor * (command @ drives.force.T)) + noted
    jump = np.zeros_like(force)
    jump[:, :n] = np.where(free, 0.0, force[:, :n] - noted) * (1 / hold - 1)[:, None]
    pushed = (lines.tool_force * late[:, None]) @ jacobian[0, :, :m]
    force = force + pushed
    coupling = inertia[:m, m:] - at.weight[m:].T / (omega**2)[:, None, None]
    motion = np.asarray((compliance @ force[:, :, None])[:, :, 0], dtype=complex)
    rows, own = rows_of(at, lines, jacobian, s)
    sensing = sensing_of(at, lines, errors)
    for sensor, matrix in sensing.items():
        k = [i for i, (r, _) in enumerate(lines.row) if r.sensor == sensor]
        rows[:, k] = late_site[:, None, None] * (matrix @ rows[:, k])
        own[:, k] = late_site[:, None, None] * (matrix @ own[:, k])
    push = np.asarray(rows @ compliance, dtype=complex)
    columns = own - push @ coupling
    jump = np.asarray(jump @ _ease(at, inertia), dtype=complex)
    step = stepped_of(at, lines, jacobian, jump, motion)
    for sensor, matrix in sensing.items():
        k = [i for i, (r, _) in enumerate(lines.row) if r.sensor == sensor]
        step[:, k] = late_site[:, None] * (step[:, k] @ matrix.T)
    mean = (rows @ motion[:, :, None])[:, :, 0] + lines.sampled * step + lines.leaked
    return Response(
        at=at, lines=lines, errors=errors, inertia=inertia, jacobian=jacobian,
        compliance=compliance, rows=rows, push=push, columns=columns, coupling=coupling,
        sudden=_sudden(at, lines, inertia, jacobian, sensing),
        force=force, pushed=pushed, motion=motion, jump=jump, step=step, mean=mean,
    )  # fmt: skip


def _late(at: PoseModel, lines: Lines, errors: Array) -> tuple[ComplexArray, ComplexArray]:
    """Delay factors of a run's commands, and of its accelerometers with their filter (K,) each."""
    of, t = at.of, at.of.tolerances
    own = errors[of.delays(lines.number)]
    command, sensor = own if len(own) else (0.0, 0.0)  # errors may be those of the arm alone
    clock, lag = errors[of.reading_lag]
    s = 2j * np.pi * lines.frequency
    late = np.exp(-s * (t.sensor_delay * sensor + t.sensor_clock * clock))
    return np.exp(-s * t.command_delay * command), late * _low_pass(s, t, float(lag))[0]


def _low_pass(s: Any, t: Tolerances, lag: float) -> tuple[ComplexArray, ComplexArray]:
    """Filter of the accelerometers (Butterworth, second order), and its change by ``lag`` (K,)."""
    slow = s * t.sensor_lag * np.exp(t.sensor_lag_sd * lag)
    found = 1 / (1 + np.sqrt(2) * slow + slow**2)
    return found, -t.sensor_lag_sd * (np.sqrt(2) * slow + 2 * slow**2) * found**2


def _each(matrices: Array, rows: ComplexArray) -> ComplexArray:
    """Product of every matrix (j, G, i) with every row (K, j): (K, G, i)."""
    wide = matrices.reshape(len(matrices), -1)
    flat = np.ascontiguousarray(rows.real) @ wide + 1j * (np.ascontiguousarray(rows.imag) @ wide)
    return np.asarray(flat.reshape(len(rows), *matrices.shape[1:]))


def with_leakage(at: PoseModel, lines: Lines) -> Lines:
    """Lines with their predicted spectral leakage set, to first order.

    The taper mixes every line with its two neighbours. Where the arm's answer changes from line to
    line, what comes from the neighbours was answered a little otherwise; to first order that is
    the slope of the answer times what the neighbours differ by. The nominal arm is good enough, but
    for the size of its answer: a joint that friction locks leaks as little as it moves.
    """
    nominal = at.of.nominal
    command, force = lines.lean
    here = replace(
        lines, command=command, force=force, tool_force=lines.tool_lean,
        leaked=np.zeros_like(lines.readings),
    )  # fmt: skip
    there = replace(here, frequency=lines.frequency + lines.next)
    mean = respond(at, here, nominal).mean
    leaked = respond(at, there, nominal).mean - mean
    measured, predicted = (np.linalg.norm(lines.read * x, axis=0) for x in (lines.readings, mean))
    share = np.minimum(measured / np.maximum(predicted, 1e-150), 1.0)
    return replace(lines, leaked=share * leaked)


def _held(omega: Array, period: float) -> ComplexArray:
    """Zero-order-hold response of a command relative to a continuous one."""
    half = 0.5j * omega * period
    return np.asarray(np.exp(-half) * np.sinc(omega * period / (2 * np.pi)))


def _ease(at: PoseModel, inertia: Array) -> Array:
    """Acceleration per sudden force on the coordinates (m, m); see `PoseModel.rigid`."""
    found, r = np.zeros((at.size, at.size)), at.rigid
    found[:r, :r] = np.linalg.inv(inertia[:r, :r])
    return found


def _sudden(
    at: PoseModel, lines: Lines, inertia: Array, jacobian: Array, sensing: dict[str, Array]
) -> Array:
    m = at.size
    whole = np.vstack([-_ease(at, inertia) @ inertia[:m, m:], np.eye(len(inertia) - m)])
    found = np.zeros((len(lines.row), whole.shape[1]))
    for k, (reading, axis) in enumerate(lines.row):
        if reading.kind == "acceleration":
            along = sensing.get(reading.sensor, np.eye(3))[axis]
            found[k] = along @ jacobian[reading.at] @ whole
    return found


def _stepping(response: Response, jacobian: Array, sensing: dict[str, Array], ease: Array) -> Array:
    """Accelerometer response to a force step on the coordinates (1, c, m)."""
    lines, m = response.lines, response.at.size
    rows = np.zeros((1, len(lines.row), m))
    for k, (reading, axis) in enumerate(lines.row):
        if reading.kind == "acceleration":
            along = sensing.get(reading.sensor, np.eye(3))[axis]
            rows[0, k] = along @ jacobian[reading.at, :, :m] @ ease
    return rows


def _own_damping(at: PoseModel, n: int) -> Array:
    """Passive joint damping (n,)."""
    return np.asarray(at.of.linear.springs[1][at.of.moving][:n])


def _gain_error(at: PoseModel) -> Array:
    """Relative standard deviation of each drive's gain, stiffness excluded (n,).

    A position servo's command and stiffness share one gain; a quarter of its tolerance is left.
    """
    drives, t = at.of.arm.actuators, at.of.tolerances
    return np.asarray(np.where(drives.stiffness > 0, 0.25, 1.0) * t.servo_gain)
