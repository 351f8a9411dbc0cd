"""Experiment One: repeatability of a large cylindrical arm (6.2.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

from loose_env.thesis.ch6_experiments.arm.experiment_one_figures import (
    end_card,
    shudder_card,
    spectrum_card,
    time_card,
)
from loose_env.thesis.ch6_experiments.arm.guideway import (
    POSES,
    Guideway,
    StrokePose,
    Strokes,
    shift_end,
    stroke_many,
    transfer_point,
)
from loose_env.thesis.printed import printed
from loose_env.thesis.rigs.cylindrical import LIFT, REACH
from loose_env.thesis.shared.plots import rms
from loose_env.thesis.shared.sections import Section, Table
from loose_env.typing import Array

EQUATIONS: dict[str, str] = {}  # the section has none
SHUDDER_BAND = (12.0, 120.0)
"""Band that holds the boom's shudder and leaves out the stroke itself [Hz]."""
SHIFTED_POSE = "A"
"""Pose whose end point is moved."""


@dataclass(frozen=True, kw_only=True)
class Repeatability:
    """Agreement of the strokes of a set."""

    spread: float
    """Rms of a stroke about the mean of its set; unit of the signal."""
    lowest_correlation: float
    """Lowest correlation of a stroke with the mean of the others [1]."""


@dataclass(frozen=True, kw_only=True)
class Shudder:
    """The boom going over from one pair of blocks to the other."""

    size: float
    """Rms of the mean acceleration in the shudder's band, in the 0.2 s after the boom lands."""
    leaves: float
    lands: float
    """Reach at which the boom leaves its rear seat and lands on the other, means [m]."""
    spread: float
    """Standard deviation of the latter over strokes [m]."""


def repeatability(strokes: Array) -> Repeatability:
    """Compare each stroke with the others of its set.

    ``strokes`` (strokes, N): one signal a stroke.

    Examples
    --------
    >>> wave = np.sin(np.arange(100))
    >>> repeatability(np.array([wave, wave, 2 * wave])).lowest_correlation
    1.0
    """
    mean = strokes.mean(axis=0)
    others = (len(strokes) * mean - strokes) / (len(strokes) - 1)
    lowest = min(np.corrcoef(s, o)[0, 1] for s, o in zip(strokes, others, strict=True))
    return Repeatability(
        spread=float(np.sqrt(np.mean((strokes - mean) ** 2))), lowest_correlation=float(lowest)
    )


def right_sets(sets: Mapping[str, Array]) -> float:
    """Share of strokes nearest to the mean of their own set, themselves left out of it.

    Examples
    --------
    >>> right_sets({"low": np.array([[0.0], [0.1]]), "high": np.array([[1.0], [1.1]])})
    1.0
    """
    means = {name: strokes.mean(axis=0) for name, strokes in sets.items()}
    right, count = 0, 0
    for own, strokes in sets.items():
        n = len(strokes)
        for stroke in strokes:
            to = {name: np.mean((stroke - mean) ** 2) for name, mean in means.items()}
            to[own] = np.mean((stroke - (n * means[own] - stroke) / (n - 1)) ** 2)
            right += min(to, key=lambda name: to[name]) == own
            count += 1
    return right / count


def shudder(strokes: Strokes, settings: Guideway) -> Shudder | None:
    """Find the shudder from the boom's true pitch; None if the boom does not go over."""
    half = settings.gap / 2
    over = (strokes.pitch[:, 0] < -0.9 * half) & (strokes.pitch[:, -1] > 0.9 * half)
    if half == 0 or not over.all():
        return None
    leaves, lands, size = [], [], []
    quick = _quick(strokes, settings)
    for reach, pitch in zip(strokes.reach, strokes.pitch, strict=True):
        landed = int(np.argmax(pitch >= half))
        # The last instant on the rear seat before that.
        left = int(np.flatnonzero(pitch[:landed] <= -half)[-1])
        leaves.append(reach[left])
        lands.append(reach[landed])
        size.append(quick[landed : landed + round(0.2 * settings.rate)].std())
    return Shudder(
        size=float(np.mean(size)),
        leaves=float(np.mean(leaves)),
        lands=float(np.mean(lands)),
        spread=float(np.std(lands)),
    )


def ringing(settings: Guideway, pose: StrokePose) -> float:
    """Frequency at which the arm rings after a stroke without noise [Hz]."""
    still = replace(
        settings, potentiometer_noise=0.0, accelerometer_noise=0.0, trigger_jitter=0.0, record=2.4
    )
    found = stroke_many(pose, 1, still, np.random.default_rng(0))
    tail = found.acceleration[0, found.time > 1.15]
    spectrum = np.abs(np.fft.rfft((tail - tail.mean()) * np.hanning(len(tail)), 16384))
    frequency = np.fft.rfftfreq(16384, 1 / settings.rate)
    inside = (frequency > 4.0) & (frequency < 40.0)
    return float(frequency[inside][np.argmax(spectrum[inside])])


def section(seed: int) -> Section:
    """Stroke the arm in five poses, with its end point moved, and without the play."""
    told = printed("experiment_one")
    settings, count = Guideway(), int(told["strokes_per_set"])
    sets = {
        name: stroke_many(POSES[name], count, settings, np.random.default_rng([seed, k]))
        for k, name in enumerate(told["poses"])
    }
    shifted = {0: sets[SHIFTED_POSE]} | {
        by: stroke_many(
            shift_end(POSES[SHIFTED_POSE], by / 1000),
            count,
            settings,
            np.random.default_rng([seed, 10 + k]),
        )
        for k, by in enumerate(told["end_shifts_mm"])
    }
    tight = stroke_many(
        POSES["B"], count, replace(settings, play=0.0), np.random.default_rng([seed, 20])
    )
    raised = StrokePose(name="raised", swing=0.0, lift=LIFT, start=REACH - 0.5, end=REACH)
    rings = ringing(settings, raised)

    own = {name: repeatability(s.acceleration) for name, s in sets.items()}
    apart = {
        (p, q): rms(sets[p].acceleration.mean(axis=0) - sets[q].acceleration.mean(axis=0))
        for p in sets
        for q in sets
        if p < q
    }
    nearest = min(apart, key=lambda pair: apart[pair])
    spread = max(r.spread for r in own.values())
    lowest = min(r.lowest_correlation for r in own.values())
    told_apart = right_sets({name: s.acceleration for name, s in sets.items()})
    by_end = {str(by): s.acceleration for by, s in shifted.items()}
    ends_apart = right_sets(by_end)
    smallest = min(
        rms(s.acceleration.mean(axis=0) - shifted[0].acceleration.mean(axis=0))
        for by, s in shifted.items()
        if by
    )
    goes_over = {name: shudder(s, settings) for name, s in sets.items()}
    crossing = [name for name, found in goes_over.items() if found is not None]
    with_play, without, quiet = _same_window(sets["B"], tight, settings)
    weight_over = transfer_point()

    finding = (
        f"Within a pose strokes differ by {spread:.3f} m/s² rms at most, the nearest two poses by "
        f"{apart[nearest]:.3f} m/s²; the guideway's shudder comes in {_list(crossing)} and is gone "
        "without the play."
    )
    words = [
        "A hydraulic arm of six axes strokes its boom out again and again, in five poses: A out "
        "and low, B in and low, C out and high, D in and high, E as C but swung by "
        f"{told['swing_of_pose_e_deg']}°. Recorded are the acceleration of the wrist along the "
        "boom and the potentiometer. The thesis had such records on paper only and judged them "
        "by eye: good repeatability within a pose, other signals and spectra in other poses, "
        "and a shudder where the weight of the boom goes from one pair of guide blocks to the "
        "other.",
        f"Here the same is simulated, {count} strokes a set, every one run with its own noise of "
        "the potentiometer (which also goes through the servo), of the accelerometer and of the "
        f"trigger. Within a pose a stroke differs from the mean by at most {spread:.3f} m/s² rms, "
        f"and correlates with the mean of the others by {lowest:.3f} or more. The two poses most "
        f"alike, {nearest[0]} and {nearest[1]}, differ by {apart[nearest]:.3f} m/s² rms. A stroke "
        f"lies nearest to the mean of its own pose in {100 * told_apart:.0f} % of cases. "
        + (
            "Poses differ by more than strokes do, as the thesis found."
            if apart[nearest] > spread
            else "The nearest poses differ by less than single strokes do."
        ),
        f"Moving the end point by 2 mm changes the mean signal by {smallest:.3f} m/s² rms, "
        f"{smallest / own[SHIFTED_POSE].spread:.1f} times the spread within a set; a stroke is put "
        f"to its own one of the five end points in {100 * ends_apart:.0f} % of cases "
        "(20 % by chance).",
        f"The boom goes over in {_list(crossing)}, whose strokes pass {weight_over:.3f} m of "
        "reach, where the weight lies over the middle of the guide"
        + (
            "; in the other poses it stays on one pair of blocks. "
            if len(crossing) < len(sets)
            else ". "
        )
        + _shudder_words(goes_over, weight_over)
        + f" In pose B the shudder has {with_play:.2f} m/s² rms between "
        f"{SHUDDER_BAND[0]:.0f} and {SHUDDER_BAND[1]:.0f} Hz; with the play taken out "
        f"{without:.3f} m/s² is left there, against {quiet:.3f} m/s² with play "
        "before the boom goes over.",
        f"After a stroke at full height and reach the arm rings at {rings:.1f} Hz (printed: "
        f"{told['mode_raised_extended_hz']} Hz). The column's mode is set to 8 Hz with all joints "
        "locked; guide and servo move it.",
    ]
    return Section(
        key="experiment_one",
        title="Experiment One: repeatability of a large cylindrical arm (6.2.1)",
        finding=finding,
        words=words,
        tables=(
            _pose_table(own, goes_over, apart),
            _end_table(shifted),
            _summary(told, rings, weight_over, goes_over, (with_play, without)),
        ),
        cards=(
            time_card(sets, tight),
            spectrum_card(sets, int(told["spectrum_averages"]), settings),
            end_card(shifted, SHIFTED_POSE),
            shudder_card(sets["B"], tight, weight_over),
        ),
        equations=EQUATIONS,
        left_out=(
            "An independent check of sizes: play, servo, ramp and filter were chosen so that the "
            "shudder stands clear of the noise, the trigger's jitter is assumed, and the column's "
            "mode is set to the printed one. How well sets are told apart follows from these.",
            "The masses, lengths and servo gains of the Prab FA600 are not printed; those of the "
            "model are estimates, so its signals are compared in kind, not in size.",
            f"The end point is moved in pose {SHIFTED_POSE} only.",
            "Sticking servovalves, drift after shutdown and the leak of the vertical axis: the "
            "thesis names them as troubles of its controller and gives no figures.",
        ),
    )


def _list(names: list[str]) -> str:
    if not names:
        return "no pose"
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _shudder_words(found: Mapping[str, Shudder | None], weight_over: float) -> str:
    at = [s for s in found.values() if s is not None]
    if not at:
        return "No shudder is seen."
    leaves, lands = np.mean([s.leaves for s in at]), np.mean([s.lands for s in at])
    return (
        f"It leaves its seat at {leaves:.3f} m, {1000 * (leaves - weight_over):+.0f} mm from "
        f"there, and lands at {lands:.3f} m, since it takes a while to fall. It lands at the same "
        f"reach within {1000 * max(s.spread for s in at):.1f} mm (one standard deviation): the "
        "shudder is repeatable."
        if max(s.spread for s in at) < 0.1 * abs(lands - weight_over)
        else f"It leaves its seat at {leaves:.3f} m and lands at {lands:.3f} m, scattered by "
        f"{1000 * max(s.spread for s in at):.1f} mm."
    )


def _quick(strokes: Strokes, settings: Guideway) -> Array:
    """Mean acceleration of a set in the shudder's band [m/s²] (N,)."""
    filter_ = butter(4, SHUDDER_BAND, "bandpass", fs=settings.rate, output="sos")
    return np.asarray(sosfiltfilt(filter_, strokes.acceleration.mean(axis=0)))


def _same_window(loose: Strokes, tight: Strokes, settings: Guideway) -> tuple[float, float, float]:
    """Shudder with play and without, and the quiet part before; mean records, rms [m/s²]."""
    mean = [_quick(strokes, settings) for strokes in (loose, tight)]
    landed = int(np.argmax(loose.pitch.mean(axis=0) >= settings.gap / 2))
    width = round(0.2 * settings.rate)
    window, before = slice(landed, landed + width), slice(landed - width - 150, landed - 150)
    return rms(mean[0][window]), rms(mean[1][window]), rms(mean[0][before])


def _pose_table(
    own: Mapping[str, Repeatability],
    goes_over: Mapping[str, Shudder | None],
    apart: Mapping[tuple[str, str], float],
) -> Table:
    rows = []
    for name, found in own.items():
        others = {q if p == name else p: d for (p, q), d in apart.items() if name in (p, q)}
        nearest = min(others, key=lambda q: others[q])
        seen = goes_over[name]
        rows.append(
            (
                name,
                f"{found.spread:.3f}",
                f"{found.lowest_correlation:.4f}",
                f"{others[nearest]:.3f} ({nearest})",
                "none" if seen is None else f"{seen.size:.2f} from {seen.lands:.3f} m",
            )
        )
    return Table(
        caption="Strokes within a pose against strokes of other poses, acceleration of the wrist "
        "along the boom (figure 6.15).",
        columns=(
            "pose",
            "spread within the pose [m/s²]",
            "lowest correlation of a stroke",
            "to the nearest other pose [m/s²]",
            "shudder [m/s²]",
        ),
        rows=tuple(rows),
    )


def _end_table(shifted: Mapping[int, Strokes]) -> Table:
    base = shifted[0]
    spread = repeatability(base.acceleration).spread
    volts = repeatability(base.potentiometer).spread
    rows = []
    for by in sorted(shifted):
        acceleration = rms(shifted[by].acceleration.mean(axis=0) - base.acceleration.mean(axis=0))
        rest = [s.potentiometer[:, -100:].mean() for s in (shifted[by], base)]
        moved = 1000 * (rest[0] - rest[1]) / Guideway().potentiometer_scale
        pair = right_sets({"here": shifted[by].acceleration, "base": base.acceleration})
        rows.append(
            (
                f"{by:+d} mm" if by else "0",
                f"{acceleration:.3f}" if by else "-",
                f"{acceleration / spread:.1f}" if by else "-",
                f"{moved:+.2f} mm" if by else "-",
                f"{100 * pair:.0f} %" if by else "-",
            )
        )
    return Table(
        caption=f"End point moved in pose {SHIFTED_POSE}. Spread within the set: {spread:.3f} "
        f"m/s², potentiometer {1000 * volts:.1f} mV.",
        columns=(
            "end point moved by",
            "change of the mean signal [m/s²]",
            "over the spread",
            "by the potentiometer at rest",
            "strokes told from those unmoved",
        ),
        rows=tuple(rows),
    )


def _summary(
    told: Mapping[str, object],
    rings: float,
    weight_over: float,
    goes_over: Mapping[str, Shudder | None],
    sizes: tuple[float, float],
) -> Table:
    crossing = [name for name, found in goes_over.items() if found is not None]
    return Table(
        caption="Observations of Experiment One.",
        columns=("observation", "printed", "here"),
        rows=(
            (
                "mode with the arm raised and extended",
                f"{told['mode_raised_extended_hz']} Hz",
                f"{rings:.1f} Hz",
            ),
            (
                "shudder",
                "where the preload goes over to the other diagonal pair",
                f"in {_list(crossing)}, past {weight_over:.3f} m of reach",
            ),
            (
                "shudder without play",
                "not tried",
                f"{100 * sizes[1] / sizes[0]:.0f} % of that with play",
            ),
        ),
    )
