"""One run as a periodic record: lines of joints and tool, and what rings above them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.instrument.arm import SuspectArm
from loose_env.instrument.ringing import TOP_BAND, Ringing, ringing
from loose_env.instrument.signals import Multisine
from loose_env.recording import Run
from loose_env.typing import Array, ComplexArray

_STANDARD_GRAVITY = 9.81
_SWELLS = 0.65
"""Share of the lead that is left when the swelling motion is seen [1]."""
_SEEN = 0.1
"""Share of a period by which the end of motion is seen too early, at most [1]."""
_AGREES = 0.7
"""Mean agreement of the columns with their own commands from which they are theirs [1]."""
_SHORT = 0.02
"""Share of a period by which the last one may be cut [1]: lines are fitted at the true times."""
_CLOCK_OFF, _CLOCK_STEP_S, _CLOCK_ROUNDS = 0.03, 1e-3, 2
"""Largest difference of two clocks [1], that of the worst resonators without a crystal; step in
which it is searched for over a period; rounds, for lines of a clock that is far off are dim."""
FEWEST_PERIODS = 2
"""Whole periods that a record needs: with one nothing can be seen to repeat."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """A run as one accelerometer felt it; n joints, L lines from 0 upwards, all of one period."""

    name: str
    sensor: str
    """Accelerometer."""
    condition: str
    level: float
    """Share of the largest level at which it was played [1]."""
    pose: Array
    """Mean joint positions (n,) [rad, m]."""
    joints: ComplexArray
    """Lines of joint acceleration (L, n) [rad/s², m/s²]."""
    tool: ComplexArray
    """Lines of the accelerometer, sensor frame (L, 3) [m/s²]."""
    tool_noise: Array
    """Variance of these (L, 3)."""
    gravity: Array
    """Mean reading (3,) [m/s²]."""
    motion: float
    """Rms of the tool's motion in the band of the lines [m/s²]."""
    ring: Ringing
    """What rings above the lines."""
    repeats: float
    """Correlation of the highest band's energy between periods [1]: near 1 for what the shaking
    causes, near 0 for a striking cable."""
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Unusable:
    """A run that cannot be used, with the reason and what to do."""

    name: str
    why: str
    remedy: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Motion of the joints in a run of periodic commands."""

    run: Run
    """The run, or its longest stretch without a hole."""
    hole_s: float
    """Longest time for which rows are missing, 0 where none are [s]."""
    time: Array
    """Of the run, from its first sample, by the clock of the commands (T,) [s]."""
    first: float
    """Time of the first whole period [s]."""
    periods: int
    lines: ComplexArray
    """Lines of joint acceleration (L, n) [rad/s², m/s²]."""
    pose: Array
    """Mean joint positions (n,) [rad, m]."""
    fast: float
    """Share by which the run's clock was fast against the commands' [1]; set right."""


def read_motion(
    arm: SuspectArm, run: Run, signal: Multisine, beside: Sequence[str] = ()
) -> Motion | Unusable:
    """Find the periods of a signal in the joints' motion; lines are fitted at the sample times.

    Of a run with missing rows, in positions or the sensors `beside`, the longest stretch is read.
    """

    def useless(why: str, remedy: str) -> Unusable:
        return Unusable(name=run.name, why=why, remedy=remedy)

    needed = [*arm.recording_model.positions, *beside]
    if missing := [s for s in needed if s not in run.sensors]:
        listed = ", ".join(missing)
        return useless(
            f"it has no column for {listed}", f"log sensor.{missing[0]} too, and import again"
        )
    run, hole_s = _longest_whole(run, needed, signal)
    t = run.time - run.time[0]
    q = np.column_stack([_whole(t, run.sensors[s]) for s in arm.recording_model.positions])
    if not np.isfinite(q).all():
        return useless(*_NO_NUMBER)
    window = _moving(t, q)
    if window is None and not hole_s:
        return useless("no joint moves", "play the signal while the logger runs")
    start, end = window or (0.0, 0.0)
    guess, top = start + _SWELLS * signal.lead_s, int(signal.excited.max()) + 4
    first, periods = guess, min(int((end - guess) / signal.period_s), signal.periods)
    if periods >= FEWEST_PERIODS:
        first = _in_phase(t, q, guess, periods, top, signal)
        moved, logged = (np.array([end, t[-1]]) - first) / signal.period_s
        periods = min(int(moved + _SEEN), int(logged + _SHORT), signal.periods)
    if periods < FEWEST_PERIODS and hole_s:
        return useless(
            f"rows are missing for {hole_s:.2g} s, and {t[-1]:.2g} s are left without",
            "see why the logger stops, and run again",
        )
    if periods < FEWEST_PERIODS:
        return useless(
            f"the joints move for {end - start:.2g} s; the signal lasts {signal.seconds:.2g} s",
            "the machine stopped: see its log, lower --levels, and run again",
        )
    omega = 2 * np.pi * np.arange(top + 1) / signal.period_s
    t, each, fast = _by_clock(t - first, q, periods, top, signal, order=2)
    lines = each.mean(0)
    return Motion(
        run=run, hole_s=hole_s, time=t + first, first=first, periods=periods,
        lines=-lines * omega[:, None] ** 2, pose=lines[0].real, fast=fast,
    )  # fmt: skip


_NO_NUMBER = "a channel holds no number", "check the logger's columns"


def read_run(
    arm: SuspectArm, run: Run, signal: Multisine, *, level: float, corner_hz: float | None,
    sensor: str | None = None,
) -> Record | Unusable:  # fmt: skip
    """Read a run of a plan's signal: find its periods, and what repeats in them.

    Clocks need not agree: the signal is found in the joints' motion, and lines are fitted at the
    true sample times.

    Parameters
    ----------
    corner_hz : float, optional
        Highest frequency that the accelerometer passes [Hz]; by default 0.45 of its rate.
    sensor : str, optional
        The accelerometer; by default the tool's.
    """

    def useless(why: str, remedy: str) -> Unusable:
        return Unusable(name=run.name, why=why, remedy=remedy)

    sensor = sensor or arm.recording_model.accelerometer
    motion = read_motion(arm, run, signal, [sensor])
    if isinstance(motion, Unusable):
        return motion
    t, first, periods = motion.time, motion.first, motion.periods
    tool = np.column_stack([_whole(t, a) for a in motion.run.sensors[sensor].T])
    if not np.isfinite(tool).all():
        return useless(*_NO_NUMBER)
    rate, highest = float(1 / np.median(np.diff(t))), float(signal.hertz.max())
    passes = min(corner_hz or np.inf, 0.45 * rate / 0.9)
    if TOP_BAND[0] * passes <= highest:
        return useless(
            f"it holds {passes:.3g} Hz at most, and the signal itself reaches {highest:.3g} Hz: "
            "no band is left for what knocks",
            f"log at {2 * highest / TOP_BAND[0]:.0f} Hz or more with an accelerometer that passes "
            "half of it, or plan with a lower --bandwidth-hz",
        )
    if np.ptp(tool, axis=0).min() == 0:
        axis = "xyz"[int(np.ptp(tool, axis=0).argmin())]
        return useless(
            f"the accelerometer's {axis} axis is constant", "check its cable and range, run again"
        )
    clipped = _clipped(tool)
    if clipped > 0.002:
        return useless(
            f"the accelerometer is at its limit in {100 * clipped:.2g} % of the samples",
            "take a larger range, or plan with lower --levels",
        )
    remarks, top = [], len(motion.lines) - 1
    if periods < signal.periods:
        lost = f": rows are missing for {motion.hole_s:.2g} s" if motion.hole_s else ""
        remarks.append(f"{periods} of {signal.periods} periods are whole{lost}")
    own, several, fast = _by_clock(t - first, tool, periods, top, signal)
    read, scale = several.mean(0), 1.0
    for whose, share in (("log's clock is", motion.fast), ("accelerometer's clock is", fast)):
        if abs(share) * periods * signal.period_s > 1 / rate:
            remarks.append(
                f"the {whose} {100 * abs(share):.2g} % {'fast' if share > 0 else 'slow'}: set right"
            )
    gravity = read[0].real
    if 0.8 < np.linalg.norm(gravity) < 1.2 and np.any(arm.model.opt.gravity):
        scale = _STANDARD_GRAVITY
        remarks.append("the accelerometer is logged in g: taken as such")
    ring = ringing(own, tool * scale, 0.0, periods, signal.period_s, top=passes, highest=highest)
    repeats, foreign = ring.struck()
    if foreign:
        remarks.append(
            f"what rings does not repeat with the shaking (correlation {repeats:.2f}): a cable, a "
            "hand or a neighbour; what every period has is judged"
        )
    excited = read[signal.excited] * scale
    return Record(
        name=run.name,
        sensor=sensor,
        condition=run.condition,
        level=level,
        pose=motion.pose,
        joints=motion.lines,
        tool=read * scale,
        tool_noise=_scatter(several) * scale**2,
        gravity=gravity * scale,
        motion=float(np.sqrt(0.5 * (np.abs(excited) ** 2).sum())),
        ring=ring,
        repeats=repeats,
        remarks=tuple(remarks),
    )


def _longest_whole(run: Run, sensors: Sequence[str], signal: Multisine) -> tuple[Run, float]:
    """Longest stretch of a run without a hole, and the longest hole [s], 0 where there is none.

    A hole is longer than half a wave of the highest line: no line of its period is known then.
    """
    time, holes = run.time, []
    for name in sensors:
        values = run.sensors[name].reshape(len(time), -1)
        at = time[np.isfinite(values).all(1)]
        gaps = np.diff(at)
        least = max(0.5 / signal.hertz.max(), 1.5 * np.median(gaps)) if len(gaps) else 0.0
        for hole in np.flatnonzero(gaps > least):
            holes.append(at[hole : hole + 2])
    if not holes:
        return run, 0.0
    starts, ends = np.transpose(holes)
    outside = ~((time[:, None] > starts) & (time[:, None] < ends)).any(1)
    stretch = (time[:, None] >= ends).sum(1)  # rows of a stretch have the same holes behind them
    best = max(set(stretch[outside]), key=lambda own: np.ptp(time[outside & (stretch == own)]))
    rows = np.flatnonzero(outside & (stretch == best))
    return run.part(slice(rows[0], rows[-1] + 1)), float((ends - starts).max())


def _whole(t: Array, column: Array) -> Array:
    """Column without gaps: missing samples by their neighbours'."""
    there = np.isfinite(column)
    if there.all() or there.sum() < 2:
        return column
    return np.interp(t, t[there], column[there])


def _moving(t: Array, q: Array) -> tuple[float, float] | None:
    """First and last time at which the joints move; None where none does."""
    step = np.median(np.diff(t))
    n = max(3, round(0.05 / step))
    kernel = np.ones(n) / n
    speed = np.zeros(len(t))
    for joint in q.T:
        wave = joint - np.convolve(np.pad(joint, n, mode="edge"), kernel, "same")[n:-n]
        energy = np.convolve(wave**2, kernel, "same")
        most = np.percentile(energy, 75)
        # Encoder steps at rest are no motion: some counts at least.
        if np.sqrt(most) > 1e-5:
            speed += energy / most
    if not speed.any():
        return None
    on = np.flatnonzero(speed > 0.1 * np.percentile(speed, 75))
    return float(t[on[0]]), float(t[on[-1]])


def _clipped(tool: Array) -> float:
    """Largest share of an axis' samples at its own extreme, beyond the two that a wave has."""
    shares = []
    for axis in tool.T:
        for extreme in (axis.max(), axis.min()):
            at = np.abs(axis - extreme) <= 1e-9 * abs(extreme)
            shares.append((at[1:] & at[:-1]).mean())
    return float(max(shares))


def _lines(t: Array, y: Array, periods: int, top: int, period: float) -> ComplexArray:
    """Lines of each period (P, top+1, c) of y by least squares at the true times."""
    angle = 2 * np.pi * np.outer(t / period, np.arange(top + 1))
    basis = np.hstack([np.cos(angle), -np.sin(angle[:, 1:])])
    each = []
    for p in range(periods):
        own = (t >= p * period) & (t < (p + 1) * period)
        part = basis[own]  # nearly orthogonal, so that its products are as good as itself
        found = np.linalg.lstsq(part.T @ part, part.T @ y[own], rcond=None)[0]  # rows may lack
        lines = found[: top + 1].astype(complex)
        lines[1:] += 1j * found[top + 1 :]
        each.append(lines)
    return np.array(each)


def _scatter(several: ComplexArray) -> Array:
    """Variance of the mean of lines of several periods."""
    periods = len(several)
    off = (np.abs(several - several.mean(0)) ** 2).sum(0)
    return np.asarray(off / max((periods - 1) * periods, 1))


def _by_clock(
    t: Array, y: Array, periods: int, top: int, signal: Multisine, *, order: int = 0
) -> tuple[Array, ComplexArray, float]:
    """Times by the clock of the commands, lines of each period, and how fast y's own clock was.

    Lines turn from one period to the next by what the period lasts too long. The signal is flat in
    accelerations: those are y's derivative of an order.
    """
    omega, turned = 2 * np.pi * signal.hertz, t
    shifts = np.arange(-_CLOCK_OFF, _CLOCK_OFF, _CLOCK_STEP_S / signal.period_s) * signal.period_s
    waves = np.exp(1j * np.outer(shifts, omega))
    for _ in range(_CLOCK_ROUNDS):
        several = _lines(turned, y, periods, top, signal.period_s)
        excited = several[:, signal.excited] * signal.excited[:, None] ** order
        turns = np.einsum("pkc,pkc->k", excited[:-1].conj(), excited[1:])
        late = float(shifts[(waves @ turns).real.argmax()])
        angle = np.angle(turns * np.exp(1j * omega * late))
        weight = np.abs(turns) * omega
        late -= float(weight @ angle / max(weight @ omega, 1e-300))
        turned = turned / (1 + late / signal.period_s)
        if abs(late) < _CLOCK_STEP_S:
            break
    fast = float((t[-1] - t[0]) / (turned[-1] - turned[0]) - 1)
    return turned, _lines(turned, y, periods, top, signal.period_s), fast


def _in_phase(t: Array, q: Array, first: float, periods: int, top: int, signal: Multisine) -> float:
    """Start of the first whole period, moved to where the lines have the commands' phases."""
    inside = (t >= first) & (t < first + periods * signal.period_s)
    lines = _lines(t[inside] - first, q[inside], periods, top, signal.period_s).mean(0)
    own = -lines[signal.excited] * signal.excited[:, None] ** 2  # accelerations: there it is flat
    own = own / np.maximum(np.linalg.norm(own, axis=0), 1e-12) / np.sqrt(len(own))
    shift = np.arange(-0.5, 0.5, 1e-3) * signal.period_s
    turned = np.exp(2j * np.pi * np.outer(shift, signal.excited) / signal.period_s)
    # Agreement of each column (j) with each command (i) at every shift.
    each = np.einsum("sk,kj,ik->sji", turned, own, np.exp(-1j * signal.phases)).real
    agreed = np.einsum("sjj->s", each) / len(signal.phases)
    if agreed.max() < _AGREES:
        # Columns may be exchanged or have the opposite sign, which half a period gives all of them.
        largest = np.take_along_axis(each, np.abs(each).argmax(2)[:, :, None], 2)
        agreed = (np.abs(largest) + 0.1 * largest).sum((1, 2))
    return first + float(shift[agreed.argmax()])


def shares_followed(
    moved: Sequence[ComplexArray], peaks: Sequence[Mapping[str, float]], signal: Multisine,
    joints: tuple[str, ...],
) -> Array:  # fmt: skip
    """Share of its command by which each joint followed each excited line, at most 1 (K, n).

    Parameters
    ----------
    moved : sequence of ndarray
        Lines of joint acceleration of each run (L, n) [rad/s², m/s²].
    peaks : sequence of mapping
        Peak acceleration of each joint that was played, by run [rad/s², m/s²].
    """
    found = []
    for lines, peak in zip(moved, peaks, strict=True):
        power = np.abs(lines) ** 2
        # Even lines were not commanded: beside an odd one they show what comes without a command.
        beside = (power[signal.excited - 1] + power[signal.excited + 1]) / 2
        answered = np.sqrt(np.maximum(power[signal.excited] - beside, 0))
        asked = np.array([peak[j] for j in joints]) / signal.crest
        found.append(np.minimum(answered / np.maximum(asked, 1e-12), 1))
    shares: Array = np.median(found, 0)
    return shares


def followed_hz(shares: Array, signal: Multisine) -> float:
    """Highest line that is followed by half, of shares (K, n) taken together; 0 if none is [Hz].

    It is where the sum of all shares, less a half each, is largest: neither a dip below it nor
    noise above it is taken for the end.
    """
    gained = np.cumsum(shares.mean(1) - _FOLLOWS)
    return float(np.r_[0.0, signal.hertz][np.r_[0.0, gained].argmax()])


_FOLLOWS = 0.5
"""Share of its command by which a joint follows a line: 6 dB, the usual end of a bandwidth [1]."""


def exchanged(
    records: Sequence[Record], signal: Multisine, joints: tuple[str, ...]
) -> tuple[str, ...]:
    """Joints whose motion follows another's command, or the opposite of their own, in sentences."""
    n = len(joints)
    agree = np.zeros((n, n))
    for record in records:
        own = record.joints[signal.excited]
        size = np.maximum(np.linalg.norm(own, axis=0), 1e-12)
        for i in range(n):
            turned = own * np.exp(-1j * signal.phases[i])[:, None]
            agree[i] += turned.sum(0).real / size / np.sqrt(len(own)) / len(records)
    found = []
    for j in range(n):
        i = int(np.abs(agree[:, j]).argmax())
        # Commands of a few lines agree by up to 0.6 with one another.
        if abs(agree[i, j]) > max(_AGREES, abs(agree[j, j]) + 0.2):
            found.append(f"the column of {joints[j]} follows the command of {joints[i]}")
        elif agree[j, j] < -0.7:
            found.append(f"the column of {joints[j]} has the opposite sign of its command")
    return tuple(found)
