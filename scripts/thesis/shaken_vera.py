"""Experiments Five and Six, simulated: direction errors on VERA, loose or with backlash."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.signal import welch
from scipy.stats import gmean

from loose_env.arms import BENDING_MODE_HZ, COIL, Arm, LinearArm
from loose_env.envs import FAINT, INK, MUTED
from loose_env.excitation import Excitation
from loose_env.faults import Backlash, Fault, Healthy
from loose_env.rig import Measurement, SimulatedRig
from loose_env.sensors import STANDARD_GRAVITY, Accelerometer, SensorSuite
from loose_env.statistics import (
    axial_difference,
    axial_mean,
    bandpass,
    comparative_index,
    covariances,
    transmission_from,
)
from loose_env.typing import Array
from scripts.charts import Panel, axis, chart, curve
from scripts.thesis.estimators import (
    kurtosis,
    lowest_correlation_direction,
    maximum_correlation,
    skewness,
    transfer_function,
)
from scripts.thesis.page import Rows, Section, printed, section
from scripts.thesis.plots import COLOURS, by_category, contours, loops, rms, state_look
from scripts.thesis.rigs import (
    PROXIMAL,
    SHAKEN_BAND,
    STIFF_PIN_FIT,
    Pin,
    ShakenVeraParameters,
    finger_tight,
    loosened,
    shaken_vera,
)
from scripts.thesis.shaken_arm import ShakenArm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RATE = 2000.0
"""Rate at which the tape is digitised [Hz]."""
RECORDS = 24
"""Records of every case; the thesis had one."""
DURATION = 1.2
"""Length of a record [s], as in tables 6.1 and 6.2."""
FORCE = 20.0
"""Rms force of the shaker [N]: the healthy tool then peaks at 2 to 3 g (table 6.1)."""
LOW_BAND = (20.0, 60.0)
"""Band below the arm's first mode, in which the pinned arm moves as a rigid body [Hz]."""
ALARM = 0.1
"""Index D [1] below which a case counts as no alarm: table 6.6 prints up to 0.055 for low preload,
which is no fault, and table 6.5 at least 0.11 for looseness; 0.1 lies between."""
PARAMETERS = len(fields(ShakenVeraParameters))
"""Parameters of the rig that are fitted to the ten printed numbers of the healthy cases."""
LOOSE_DIRECTION = np.radians(-15.0)
"""Direction of the looseness joint, from the long axis of link 2 [rad]."""
PLAY_DIRECTION = np.pi / 2
"""Direction in which play in joint 2 moves the tool, from the long axis of link 2 [rad]."""
_ALONG = (float(np.cos(LOOSE_DIRECTION)), float(np.sin(LOOSE_DIRECTION)), 0.0)
TIGHT, FINGER, LOOSE = "high preload", "low preload", "looseness"
RELEASED, PLAY = "pin half released", "backlash"
STATES: Mapping[str, tuple[Fault, Pin]] = {
    TIGHT: (Healthy(), "engaged"),
    FINGER: (finger_tight(link=2, direction=_ALONG), "engaged"),
    LOOSE: (loosened(link=2, direction=_ALONG), "engaged"),
    RELEASED: (Healthy(), "half_released"),
    PLAY: (
        Backlash(joint=2, gap=2e-3, stiffness=(2e4, 1e4), damping=(3.0, 2.0), friction=0.02),
        "engaged",
    ),
}
"""States of the rig: what is seated, and how the pin is; the same figures in all poses. A turn of
2 mrad at the pin is the same gap as the looseness joint's."""


class Spread(NamedTuple):
    """A statistic over the records of a case, with what holds 95 % of single records."""

    mean: float
    """Mean over the records (axial for directions)."""
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Spread of plain numbers."""
        low, high = np.quantile(values, [0.025, 0.975])
        return cls(float(np.mean(values)), float(low), float(high))

    @classmethod
    def of_axes(cls, angles: Sequence[float]) -> Spread:
        """Spread of directions [rad]; the ends may leave the half turn to stay in order."""
        centre = axial_mean(np.array(angles))
        low, high = np.quantile(axial_difference(np.array(angles), centre), [0.025, 0.975])
        return cls(float(centre), float(centre + low), float(centre + high))

    def __format__(self, kind: str) -> str:
        """Value and interval, to so many digits; ``axis``: in degrees from the tool's y axis."""
        if kind == "axis":
            return f"{from_y(self.mean):.0f}° ± {np.degrees(self.high - self.low) / 2:.0f}°"
        mean, low, high = (f"{value:.{kind}f}" for value in self)
        return f"{mean} ({low} to {high})"


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One angle of a joint in one state, over all its records."""

    angle: float
    """Angle of the pose, or of the looseness joint [rad]."""
    pairs: Sequence[tuple[Array, Array]]
    """Reference acceleration (N,) and that of the tool (2, N), a pair for every record."""
    records: Sequence[Measurement] = ()

    @property
    def name(self) -> str:
        """The angle."""
        return f"{np.degrees(self.angle):.0f}°"

    @cached_property
    def lowest(self) -> Spread:
        """Direction of lowest correlation from the tool's x axis [rad] (the thesis's φ)."""
        return Spread.of_axes([lowest_correlation_direction(x, a) for x, a in self.pairs])

    @cached_property
    def maximum(self) -> Spread:
        """Maximum correlation over directions (the thesis's C)."""
        return Spread.of([maximum_correlation(x, a) for x, a in self.pairs])

    def moments(self, direction: float, *, third: bool) -> list[float]:
        """Skewness (third moment) or kurtosis along a direction [rad], record by record."""
        unit, moment = [np.cos(direction), np.sin(direction)], skewness if third else kurtosis
        return [moment(a, unit) for _, a in self.pairs]

    @property
    def peaks(self) -> tuple[float, float]:
        """Median over the records of the lowest and the highest tool acceleration [g]."""
        ends = np.median([(a.min(), a.max()) for _, a in self.pairs], axis=0) / STANDARD_GRAVITY
        return float(ends[0]), float(ends[1])

    @property
    def long_axis(self) -> tuple[float, float]:
        """Direction of the long axis of the tool's acceleration [rad], and its aspect ratio."""
        covariance = np.mean([np.cov(a) for _, a in self.pairs], axis=0)
        power, axes = np.linalg.eigh(covariance)
        return float(np.arctan2(axes[1, 1], axes[0, 1])), float(np.sqrt(power[1] / power[0]))

    def index(self, healthy: Case) -> Spread:
        """Comparative index D (6.18) of single records against the mean of the healthy ones."""
        c_n, phi_n = healthy.maximum.mean, healthy.lowest.mean
        found = []
        for x, a in self.pairs:
            c, phi = maximum_correlation(x, a), lowest_correlation_direction(x, a)
            found.append(comparative_index(c_n, phi_n, c, phi).mag_d)
        return Spread.of(found)


Cases = Mapping[str, Sequence[Case]]
"""Cases of every state, in the order of the poses."""


def poses() -> tuple[float, ...]:
    """Angles of joint 2 in the five pose cases [rad]."""
    return tuple(float(np.radians(t)) for t in printed("index_tables")["theta2_deg"])


def printed_healthy() -> list[tuple[float, float, float]]:
    """Printed healthy cases: angle of joint 2, direction from the x axis [rad], magnitude."""
    table = printed("index_tables")
    return [
        (theta2, float(np.radians(case["lowest_high_preload_deg"] + 90)), c)
        for theta2, case, c in zip(
            poses(), table["looseness_cases"], table["table_6_4"]["c_n"], strict=True
        )
    ]


def from_y(angle: float) -> float:
    """Turn an angle from the tool's x axis [rad] into the thesis's, from its y axis [deg]."""
    return float((np.degrees(angle) - 90.0) % 180.0)


def axial_turn(found: float, other_deg: float) -> float:
    """Angle from a printed axis [deg from y] to one found [rad from x], in degrees."""
    return float(np.degrees(axial_difference(found, np.radians(other_deg + 90.0))))


def measure_case(
    arm: Arm,
    fault: Fault,
    shake: Excitation,
    seed: Sequence[int],
    *,
    angle: float,
    pair: Callable[[Measurement], tuple[Array, Array]],
    records: int,
    pose: Sequence[float] = (0.0,),
) -> Case:
    """Measure a fault in a pose by the rig's digitised accelerometers, each record by its seed."""
    sensors = SensorSuite(rate=RATE, accelerometer=Accelerometer(bandwidth=0.45 * RATE))
    rig = SimulatedRig(arm, slots=records, sensors=sensors)
    for k in range(records):
        rig.mount(k, fault)
    rngs = [np.random.default_rng([*seed, k]) for k in range(records)]
    found = rig.measure_all(range(records), pose, shake, rngs)
    measured = [m for m in found if m.failure is None]
    return Case(angle=angle, pairs=[pair(m) for m in measured], records=measured)


@lru_cache(maxsize=8)
def measured_case(seed: int, state: str, *, records: int = RECORDS) -> list[Case]:
    """Measure every pose in one state; the first records are the same for any number."""
    fault, pin = STATES[state]
    shake = Excitation(torque_rms=(0.0, 0.0), duration=DURATION, band=SHAKEN_BAND, shaker_rms=FORCE)
    arm, number = shaken_vera(pin=pin), list(STATES).index(state)
    return [
        measure_case(
            arm,
            fault,
            shake,
            (seed, number, k),
            angle=theta2,
            pair=lambda m: (m.probes[PROXIMAL][1], m.tool),
            records=records,
            pose=(0.0, theta2),
        )
        for k, theta2 in enumerate(poses())
    ]


class Errors(NamedTuple):
    """Errors of four estimators at one pose, record by record [deg]."""

    lowest: Array
    """Direction of lowest correlation with link 1, the thesis's method, local form (R,)."""
    general: Array
    """The same with the shaker's own motion instead of link 1's, the general form (R,)."""
    coherence: Array
    """Direction of lowest mean coherence with link 1 (R,)."""
    change: Array
    """Direction in which the transmission in the low band has changed (R,)."""
    change_size: float
    """That change, relative to the healthy transmission."""


def direction_errors(case: Case, healthy: Case, direction: float) -> Errors:
    """Compare four estimators on the same records, against the fault's true direction [rad]."""

    def errors(found: Sequence[float]) -> Array:
        return np.degrees(axial_difference(np.array(found), direction))

    def low(x: Array, a: Array) -> Array:
        cov = covariances(bandpass(x, RATE, LOW_BAND), bandpass(a, RATE, LOW_BAND))
        return transmission_from(cov).reshape(2)

    reference = np.mean([low(x, a) for x, a in healthy.pairs], axis=0)
    changes = np.array([low(x, a) - reference for x, a in case.pairs])
    lowest = lowest_correlation_direction
    return Errors(
        lowest=errors([lowest(x, a) for x, a in case.pairs]),
        general=errors([lowest(m.probes[COIL][0], m.tool) for m in case.records]),
        coherence=errors([lowest_coherence(x, a) for x, a in case.pairs]),
        change=errors([float(np.arctan2(c[1], c[0])) for c in changes]),
        change_size=float(np.median(np.hypot(*changes.T)) / np.hypot(*reference)),
    )


def coherence_by_direction(x: Array, a: Array, angles: Array) -> Array:
    """Coherence of the motion along each direction with x, mean over the band (K,)."""
    along = np.stack([np.cos(angles), np.sin(angles)]).T @ np.asarray(a)
    found = transfer_function(x, along, RATE)
    low, high = SHAKEN_BAND
    inside = (found.frequencies >= low) & (found.frequencies <= high)
    return np.asarray(found.coherence[:, inside].mean(axis=1))


def lowest_coherence(x: Array, a: Array) -> float:
    """Direction of lowest mean coherence, to 3 degrees [rad] (3.4, 4.1.2)."""
    angles = np.radians(np.arange(0.0, 180.0, 3.0))
    return float(angles[np.argmin(coherence_by_direction(x, a, angles))])


def spectral_flatness(
    signal: Array, rate: float, band: tuple[float, float], segments: int = 8
) -> Array:
    """Geometric over arithmetic mean of a Welch spectrum in a band (4.1.2), 0 to 1."""
    half = signal.shape[-1] // (segments + 1)
    frequency, power = welch(signal[..., : half * (segments + 1)], rate, nperseg=2 * half)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    return np.asarray(gmean(power[..., inside], axis=-1) / power[..., inside].mean(axis=-1))


def rms_over_poses(errors: Sequence[Array]) -> Spread:
    """RMS error over the poses, for every set of single records [deg]."""
    count = min(len(e) for e in errors)
    return Spread.of([rms(np.array([e[k] for e in errors])) for k in range(count)])


def _estimators(errors: Sequence[Errors]) -> dict[str, Spread]:
    names = ("lowest", "general", "coherence", "change")
    return {name: rms_over_poses([getattr(e, name) for e in errors]) for name in names}


def error_rows(cases: Sequence[Case], errors: Sequence[Errors], told: Sequence[float]) -> Rows:
    """Errors of the four estimators beside the printed ones, pose by pose and altogether."""
    rows: list[Sequence[str]] = []
    for case, theirs, e in zip(cases, told, errors, strict=True):
        cells = (f"{np.mean(v):+.0f}° (RMS {rms(v):.0f}°)" for v in e[:4])
        rows.append((case.name, f"{theirs:+g}°", *cells, f"{100 * e.change_size:.0f} %"))
    altogether = (f"{spread:1}" for spread in _estimators(errors).values())
    return [*rows, ("RMS", f"{rms(np.array(told)):.1f}°", *altogether, "")]


def peak_rows(cases: Cases, told: Mapping[str, Sequence[Sequence[float]]]) -> Rows:
    """Range of the tool's acceleration, printed beside found, in the states told [g]."""
    return [
        (
            case.name,
            *(
                f"{low:.1f} to {high:.1f}"
                for state, ranges in told.items()
                for low, high in (ranges[k], cases[state.replace("_", " ")][k].peaks)
            ),
        )
        for k, case in enumerate(cases[TIGHT])
    ]


def experiment_five(seed: int) -> Section:
    """Measure the five poses in four states and set them beside the printed cases."""
    cases = {state: measured_case(seed, state) for state in (TIGHT, FINGER, LOOSE, RELEASED)}
    tight, finger, loose, released = cases.values()
    table, healthy, rig = printed("index_tables"), printed_healthy(), ShakenVeraParameters()
    told = table["table_6_3"]["looseness_error_deg"]
    errors = [direction_errors(f, n, LOOSE_DIRECTION) for f, n in zip(loose, tight, strict=True)]
    by, theirs = _estimators(errors), rms(np.array(told))
    ours, change, general, coherence = (by[k] for k in ("lowest", "change", "general", "coherence"))
    closed = _closed_forms()
    off = {name: turn_of(found, [phi for _, phi, _ in healthy]) for name, found in closed.items()}
    soft_turn = turn_of(closed["pin half released"], closed["pin"])
    stiff_turn = turn_of(closed["stiff refitted half released"], closed["stiff refitted"])
    pin_stiffness, bending_hz = rig.pin_stiffness / 1e4, BENDING_MODE_HZ

    groups: dict[str, list[str]] = {"closer": [], "about as close": [], "farther off": []}
    for case, e in zip(tight, errors, strict=True):
        changed, lowest = rms(e.change), rms(e.lowest)
        # An RMS of 24 records is known to about 15 %, a ratio of two to about 20 %; within half
        # as much again they count as alike.
        ratio = changed / lowest
        key = "closer" if ratio < 2 / 3 else "about as close" if ratio < 3 / 2 else "farther off"
        words = f"{changed:.0f}° against {lowest:.0f}°, change {100 * e.change_size:.0f} %"
        groups[key].append(f"{case.name} ({words})")
    by_pose = "; ".join(f"{key} at {', '.join(at)}" for key, at in groups.items() if at)
    weak = [k for k, e in enumerate(errors) if rms(e.change) > theirs]
    strong = rms_over_poses([e.change for e in errors if rms(e.change) <= theirs]).mean
    weak_poses = ", ".join(tight[k].name for k in weak)
    one_pose = "one pose" if len(weak) == 1 else "some poses"
    least_change = min(errors[k].change_size for k in weak)
    preload_index = [p.index(n) for p, n in zip(finger, tight, strict=True)]
    loose_index = [f.index(n) for f, n in zip(loose, tight, strict=True)]
    apart = [
        case.name
        for case, a, b in zip(tight, preload_index, loose_index, strict=True)
        if a.high < b.low
    ]
    n_apart, apart_poses = len(apart), ", ".join(apart) or "none"
    most_preload = max(s.high for s in preload_index)

    turned = ", ".join(
        case.name
        for case, (_, phi, _) in zip(tight, healthy, strict=True)
        if abs(axial_difference(phi, case.lowest.mean))
        > max(case.lowest.high - case.lowest.low, np.radians(10)) / 2
    )
    magnitudes, found = [c for *_, c in healthy], [case.maximum.mean for case in tight]
    told_range = (min(magnitudes), max(magnitudes), min(found), max(found))
    ranges = table["table_6_1_histogram_range_g"]
    fall = np.mean(np.ptp(ranges["looseness"], axis=1) / np.ptp(ranges["high_preload"], axis=1))
    both = zip(loose, tight, strict=True)
    fall_here = np.mean([np.ptp(f.peaks) / np.ptp(n.peaks) for f, n in both])
    leans, axis_rows = [], []
    for k, case in enumerate(table["looseness_cases"]):
        row = [tight[k].name]
        for state, which in ((TIGHT, "preload"), (LOOSE, "looseness")):
            axis, aspect = case.get(f"histogram_axis_{which}_deg"), case.get(f"aspect_{which}")
            angle, ratio = cases[state][k].long_axis
            said = "-" if axis is None else f"{axis % 180}°"
            said += "" if aspect is None else f", {aspect:g}:1"
            row += [said, f"{from_y(angle):.0f}°, {ratio:.1f}:1"]
            if axis is not None:
                leans.append(abs(axial_turn(angle, axis)))
        axis_rows.append(row)
    least_lean, most_lean = min(leans), max(leans)
    turns = [
        float(np.degrees(axial_difference(p.lowest.mean, n.lowest.mean)))
        for p, n in zip(released, tight, strict=True)
    ]
    least_turn, most_turn = min(map(abs, turns)), max(map(abs, turns))

    def column(group: str, name: str) -> list[float]:
        return [case[name] % 180 for case in table[group]]

    turned_by = [
        (from_y(phi), *(from_y(closed[m][k]) for m in ("rigid", "bending", "stiff refitted")))
        for k, (_, phi, _) in enumerate(healthy)
    ]
    off_by = [axial_turn(case.lowest.mean, f[0]) for case, f in zip(tight, turned_by, strict=True)]
    healthy_rows = zip(tight, turned_by, off_by, magnitudes, strict=True)
    loose_rows = zip(
        loose,
        column("looseness_cases", "lowest_looseness_deg"),
        table["table_6_4"]["c_f"],
        table["table_6_5_looseness"]["mag_d"],
        loose_index,
        strict=True,
    )
    preload_rows = zip(
        finger,
        column("looseness_cases", "lowest_low_preload_deg"),
        table["table_6_6_low_preload"]["mag_d"],
        preload_index,
        strict=True,
    )
    pin_rows = zip(tight, released, turns, strict=True)
    vera = [error_rows(tight, errors, told), peak_rows(cases, ranges), axis_rows]
    return section(
        "experiment_five",
        locals(),
        [healthy_rows, loose_rows, preload_rows, *vera, pin_rows],
        _figures(cases, (TIGHT, LOOSE, FINGER), LOOSE_DIRECTION, "looseness joint"),
    )


def _closed_forms() -> dict[str, list[float]]:
    """Healthy directions [rad from x] by the closed form, for each model of the rig."""
    kinematic = LinearArm(shaken_vera())

    def rigid(theta2: float) -> Array:
        return np.asarray(kinematic.at([0.0, theta2]).kinematic[:, 0])

    def shaken(arm: Arm) -> Callable[[float], Array]:
        linear = ShakenArm(arm)
        return lambda theta2: linear.at([0.0, theta2]).covariances(PROXIMAL, 1)[1]

    models = {
        "rigid": rigid,
        "pin": shaken(shaken_vera()),
        "pin half released": shaken(shaken_vera(pin="half_released")),
        "bending": shaken(shaken_vera(pin="rigid")),
        "stiff refitted": shaken(shaken_vera(parameters=STIFF_PIN_FIT)),
        "stiff refitted half released": shaken(
            shaken_vera(pin="half_released", parameters=STIFF_PIN_FIT)
        ),
    }
    columns = {name: [model(t) for t in poses()] for name, model in models.items()}
    return {
        name: [float(np.arctan2(c[1], c[0]) + np.pi / 2) for c in found]
        for name, found in columns.items()
    }


def turn_of(one: Sequence[float], other: Sequence[float]) -> float:
    """RMS angle between directions [deg]."""
    return float(np.degrees(rms(axial_difference(np.array(one), np.array(other)))))


def experiment_six(seed: int) -> Section:
    """Measure the five poses with play in joint 2 and set them beside the printed cases."""
    cases = {state: measured_case(seed, state) for state in (TIGHT, PLAY)}
    tight, play = cases.values()
    table = printed("index_tables")
    told = table["table_6_3"]["backlash_error_deg"]
    errors = [direction_errors(b, n, PLAY_DIRECTION) for b, n in zip(play, tight, strict=True)]
    by, theirs = _estimators(errors), rms(np.array(told))
    ours, change = by["lowest"], by["change"]
    index = [b.index(n) for b, n in zip(play, tight, strict=True)]
    said = table["table_6_7_backlash"]["mag_d"]
    quiet = [case.name for case, d in zip(tight, index, strict=True) if d.mean < ALARM]
    low = ", ".join(quiet) or "no pose"
    both = [c.name for c, d in zip(tight, said, strict=True) if d < ALARM and c.name in quiet]
    agreed = ", ".join(both) or "none of them"
    loud = [(c.name, d, i.mean) for c, d, i in zip(tight, said, index, strict=True) if d >= ALARM]
    printed_high = " and ".join(f"{d:.2f}" for _, d, _ in loud)
    high = " and ".join(f"{name} ({here:.2f} here)" for name, _, here in loud)
    claimed, apart, fallen, rows = table["claimed_error_deg"], [], [], []
    for k, (n, b) in enumerate(zip(tight, play, strict=True)):
        axis = table["backlash_cases"][k]["lowest_backlash_deg"]
        c_n, c_b = (table["table_6_4"][name][k] for name in ("c_n", "c_b"))
        if abs(axial_turn(b.lowest.mean, axis)) > claimed:
            apart.append(f"{n.name} (printed {axis % 180}°, here {from_y(b.lowest.mean):.0f}°)")
        if c_b < c_n / 2:
            here = f"here from {n.maximum.mean:.2f} to {b.maximum.mean:.2f}"
            fallen.append(f"{n.name} (from {c_n:.2f} to {c_b:.2f}; {here})")
        rows.append((n, b, axis % 180, c_n, c_b, said[k], index[k]))
    apart_poses, fallen_poses = ", ".join(apart) or "no pose", " and ".join(fallen)
    ranges = table["table_6_2_histogram_range_g"]
    wide = np.ptp(ranges["backlash"], axis=1) / np.ptp(ranges["high_preload"], axis=1)
    here_wide = [np.ptp(b.peaks) / np.ptp(n.peaks) for b, n in zip(play, tight, strict=True)]
    span = (min(wide), max(wide), min(here_wide), max(here_wide))
    return section(
        "experiment_six",
        locals(),
        [rows, error_rows(tight, errors, told), peak_rows(cases, ranges)],
        _figures(cases, (TIGHT, PLAY), PLAY_DIRECTION, "backlash motion", pose=2),
    )


def loops_of(
    cases: Cases, states: Sequence[str], direction: float, symbol: str, columns: int = 3
) -> Figure:
    """Loops of the first record of each case, a panel an angle."""
    panels = [
        Panel(
            title=f"{symbol} = {case.name}",
            curves=loops({s: cases[s][k].pairs[0] for s in states}, direction),
        )
        for k, case in enumerate(cases[states[0]])
    ]
    return chart(panels, columns=columns, height=5.4 / columns, bare=True)


def moment_figures(
    cases: Cases, states: Sequence[str], direction: float, xlabel: str
) -> list[Figure]:
    """Skewness and kurtosis along a direction at each angle, with intervals of single records."""
    return [
        by_category(
            {
                s: np.transpose([Spread.of(c.moments(direction, third=third)) for c in cases[s]])
                for s in states
            },
            [case.name for case in cases[TIGHT]],
            ylabel="skewness" if third else "kurtosis",
            xlabel=xlabel,
            symlog=True,
        )
        for third in (True, False)
    ]


def _figures(
    cases: Cases, states: Sequence[str], direction: float, label: str, *, pose: int = 0
) -> list[Figure]:
    """Loops, histograms, moments along the fault, and what the thesis left aside, by direction."""
    return [
        loops_of(cases, states, direction, "θ₂"),
        histogram_panels(cases, states, direction),
        *moment_figures(cases, states, direction, "pose θ₂"),
        direction_figure(cases, states[:2], direction, label, pose=pose),
    ]


def direction_figure(
    cases: Cases, states: Sequence[str], direction: float, label: str, *, pose: int
) -> Figure:
    """Kurtosis, flatness of the spectrum and coherence against direction, first record."""
    angles = np.radians(np.arange(90.0, 270.0, 3.0))
    units, shown = np.stack([np.cos(angles), np.sin(angles)]), np.degrees(angles) - 90
    statistics: dict[str, Callable[[Array, Array], Array]] = {
        "kurtosis": lambda x, a: np.array([kurtosis(a, u) for u in units.T]),
        "flatness": lambda x, a: spectral_flatness(units.T @ a, RATE, SHAKEN_BAND),
        "coherence": lambda x, a: coherence_by_direction(x, a, angles),
    }
    panels = [
        Panel(
            title=name,
            curves=[
                curve(shown, of(*cases[state][pose].pairs[0]), state, **state_look(k))
                for k, state in enumerate(states)
            ],
            marks=[from_y(direction)],
            look={"xticks": range(0, 181, 30)},
        )
        for name, of in statistics.items()
    ]
    across = f"direction from the tool's y axis [deg]; dashed: {label}"
    return chart(panels, across=across, height=1.5)


def histogram_panels(cases: Cases, states: Sequence[str], direction: float) -> Figure:
    """Draw the contour that holds 90 % of the samples, every state in every pose."""
    samples = {
        (state, k): np.concatenate([a for _, a in cases[state][k].pairs], axis=1) / STANDARD_GRAVITY
        for state in states
        for k in range(len(cases[state]))
    }
    most = 1.15 * max(float(np.quantile(np.abs(a), 0.99)) for a in samples.values())
    tick = 1.0 if most < 3 else 2.0
    end = most * np.array([np.cos(direction), np.sin(direction)])
    drawn = [
        axis(end, color=INK, linewidth=1.0, zorder=1),
        *(axis(u, color=FAINT, linewidth=0.8) for u in ((most, 0), (0, most))),
        curve([0.1 * most, 0.1 * most + tick], [-0.93 * most] * 2, f"{tick:.0f} g", color=MUTED),
        *(curve([], [], s, color=c) for s, c in zip(states, COLOURS, strict=False)),
    ]
    panels = [
        Panel(
            title=f"θ₂ = {case.name}",
            curves=[
                *drawn,
                *(
                    contours(samples[s, k], bins=31, shares=(0.9,), colors=[c], linewidths=1.4)
                    for s, c in zip(states, COLOURS, strict=False)
                ),
            ],
        )
        for k, case in enumerate(cases[states[0]])
    ]
    return chart(panels, columns=3, height=1.8, bare=True)
