"""Experiments Two and Three: two accelerometers and a resolver (6.3.1, 6.3.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import welch

from loose_env.statistics import bandpass
from loose_env.thesis.ch6_experiments.slide.directions import angle_part, angles, shares_within
from loose_env.thesis.ch6_experiments.slide.figures import (
    angle_card,
    moment_card,
    resolver_card,
    velocity_card,
)
from loose_env.thesis.ch6_experiments.slide.records import (
    SlideRecords,
    resolver_records,
    slide_records,
)
from loose_env.thesis.ch6_experiments.slide.velocities import (
    order_table,
    resolver_part,
    velocity_part,
)
from loose_env.thesis.methods.motion.signals import subtract_base
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.plots import rms
from loose_env.thesis.shared.sections import Section, Table

PAIRS = 12
"""Pairs of accelerometers that are drawn."""

_MODULE = "loose_env.thesis.methods.motion.signals"
EQUATIONS: dict[str, str] = {
    "6.7": f"{_MODULE}.rms_motion",
    "6.8": f"{_MODULE}.rms_motion",
    "6.9": f"{_MODULE}.quadrature_steps",
    "6.10": f"{_MODULE}.quadrature_steps",
    "6.13": f"{_MODULE}.differentiate",
    "6.14": f"{_MODULE}.differentiate",
}
"""Function of each equation."""


def section(seed: int) -> Section:
    """Find directions, velocities and derivatives from simulated records of both experiments."""
    told = printed("signals")
    records, turned = slide_records(seed), resolver_records(seed)
    low, high = told["rms_band_hz"]
    found = angles(records, (low, high))
    words, angle_table = angle_part(found, told)
    start, end = told["angle_range_deg"]
    inside = (found.alpha >= start) & (found.alpha <= end)
    off = float(np.median(np.abs(found.by_rms - found.alpha)[inside]))
    seen = " and ".join(f"{f:.0f} Hz" for f in _bench_peaks(records, told["bench_peaks_hz"]))
    given = " and ".join(f"{f:g} Hz" for f in told["bench_peaks_hz"])
    shares = shares_within(
        seed, PAIRS, band=(low, high), angles=(start, end), percent=told["angle_within_percent"]
    )
    words.append(
        f"That share depends on the pair of accelerometers: over {PAIRS} pairs drawn with 1 % of "
        f"gain and 2 % of cross-axis sensitivity it runs from {shares.min():.0f} % to "
        f"{shares.max():.0f} %, {np.median(shares):.0f} % in the median. The printed "
        f"{told['angle_share_percent']} % belongs to one pair."
    )
    velocity_words, velocity_table, case = velocity_part(records, told, seed)
    resolver_words, resolver_table, resolver_fails = resolver_part(turned, told)
    base_words, base_table = _base_part(records, (low, high))
    return Section(
        key="signals",
        title="Experiments Two and Three: two accelerometers and a resolver (6.3.1, 6.3.2)",
        finding=(
            f"{np.median(shares):.0f} % of the angles come out within "
            f"{told['angle_within_percent']} % (printed {told['angle_share_percent']} %), off by "
            f"{off:.1f}° in the median; differentiating the resolver fails, as printed."
            if resolver_fails
            else f"The direction of motion is off by {off:.1f}° in the median; differentiating "
            "the resolver works here, other than printed."
        ),
        words=(
            "A slide is shaken along its rails; a cube with two perpendicular accelerometers "
            "is turned on it by a known angle α. The records here come from a simulated rig with "
            "the printed slide, stinger mode and bench modes; forces, masses of shaker and "
            "bench, and the noise of the tape are estimates. Across the motion the cube "
            f"shows peaks at {seen}, the bench's own (printed: {given}).",
            *words,
            *velocity_words,
            *resolver_words,
            *base_words,
        ),
        tables=(angle_table, velocity_table, order_table(told), resolver_table, base_table),
        cards=(
            angle_card(found),
            moment_card(records),
            velocity_card(records, case, told),
            resolver_card(turned),
        ),
        equations=EQUATIONS,
        left_out=(
            "An independent check of the error sizes: the stinger and bench modes are set to the "
            "printed ones, and force, tape noise, bench damping and gear play were chosen with the "
            "printed errors, bench peaks and resolver motion in view. Their agreement shows that "
            "the account is possible, not that it is the only one.",
            "4.22, 4.23, 4.25 and 4.26 (joint velocity from back EMF, torque from current): the "
            "thesis names them as other ways and measures nothing by them.",
            "The printed signals themselves: they exist as plots only, so correlations are "
            "compared, not waveforms.",
        ),
    )


def _bench_peaks(records: SlideRecords, near: Sequence[float]) -> list[float]:
    """Frequencies of the highest lines near given ones, seen across the motion [Hz]."""
    frequency, power = welch(records.x[-1], records.rate, nperseg=8192)
    found = []
    for one in near:
        inside = np.abs(frequency - one) < 15.0
        found.append(float(frequency[inside][np.argmax(power[inside])]))
    return found


def _base_part(records: SlideRecords, band: tuple[float, float]) -> tuple[list[str], Table]:
    rows, left, gains = [], {}, {}
    for name, run in records.shaken_by.items():
        slide, base, truth = (
            bandpass(s - s.mean(), records.rate, band) for s in (run.slide, run.base, run.relative)
        )
        fitted = subtract_base(slide, base, fit=True)
        kinds = (slide, subtract_base(slide, base).signal, fitted.signal)
        left[name] = [100 * rms(kind - truth) / rms(truth) for kind in kinds]
        gains[name] = float(fitted.gain)
        rows.append(
            (
                name,
                f"{np.corrcoef(base, truth)[0, 1]:+.2f}",
                *(f"{value:.0f} %" for value in left[name]),
                f"{gains[name]:+.2f}",
            )
        )
    wrong = [name for name, gain in gains.items() if abs(gain - 1.0) > 0.5]
    plain_wins = all(kinds[1] < min(kinds[0], kinds[2]) for kinds in left.values())
    words = [
        "The bench moves as well, and its motion can be subtracted (4.1.4). "
        + (
            "Plain subtraction is best in every case here. "
            if plain_wins
            else "Plain subtraction is not the best in every case here. "
        )
        + "A gain fitted by least squares should mend sensors of unequal gain; about +1 is right, "
        f"and {' and '.join(f'{g:+.1f}' for g in gains.values())} are found."
        + (
            f" Where the bench is moved by {' and by '.join(wrong)}, the motion that is wanted is "
            "itself correlated with the bench's, and the fit takes that away too."
            if wrong
            else ""
        )
    ]
    return words, Table(
        caption="Motion of the slide relative to the bench: error left, over its true rms, between "
        f"{band[0]:.0f} and {band[1]:.0f} Hz.",
        columns=(
            "what shakes the bench",
            "correlation of bench and slide",
            "nothing subtracted",
            "bench subtracted",
            "with a fitted gain",
            "fitted gain",
        ),
        rows=tuple(rows),
    )
