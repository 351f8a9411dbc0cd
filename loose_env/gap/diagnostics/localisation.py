"""Location of model error by channel, run, frequency and dependence; as data and in words.

All functions here are computed from existing residuals. Readings show the error in noise standard
deviations; in addition the residual torque of each joint gives the driving or braking torque beyond
the nominal model.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.diagnostics.joint_torque_residual import JointMotion
from loose_env.gap.diagnostics.regressors import REGRESSORS, dependence
from loose_env.gap.diagnostics.residual_spectra import Series, band_edges, density, series_of
from loose_env.gap.output.evidence_schema import (
    Band,
    ChannelResidual,
    Dependence,
    JointResidual,
    Location,
)
from loose_env.gap.residuals.autocorrelation import LaggedProducts, largest
from loose_env.gap.residuals.residual_model import LONGEST, Rows
from loose_env.gap.settings import (
    DEPENDENCE_SHARE,
    DEPENDENCE_Z,
    SIMPLER_DEPENDENCE,
    UNEXPLAINED_Z,
    VISIBLE_RMS,
)
from loose_env.typing import Array

_SAMPLES = 2500
"""Samples of a run that are held against motion and load, at most."""


_SIMPLEST = ("direction", "position", "velocity", "load", "acceleration")


def locate(
    residual: Array,
    rows: Rows,
    trials: Sequence[Trial],
    channels: Sequence[Channel],
    motions: Sequence[JointMotion],
) -> Location:
    """Locate the model error in a residual."""
    many = series_of(residual, rows, trials, channels)
    sums = np.zeros((len(trials), len(channels)))
    if many:
        group = rows.trial * len(channels) + rows.channel
        found = largest(LaggedProducts(rows).by_group(residual, group))
        sums.flat[: len(found)] = found
    number = {channel.name: c for c, channel in enumerate(channels)}
    return Location(
        channels=tuple(
            _channel_gap(series, motions, float(sums[series.trial, number[series.channel]]))
            for series in many
        ),
        joints=tuple(
            gap for trial, motion in zip(trials, motions, strict=True)
            for gap in _joint_gaps(trial.name, motion)
        ),
    )  # fmt: skip


def _channel_gap(
    series: Series, motions: Sequence[JointMotion], products: float
) -> ChannelResidual:
    count = len(series.residual)
    return ChannelResidual(
        run=series.run,
        channel=series.channel,
        rms=series.rms,
        offset=float(np.mean(series.residual)),
        bands=_bands(series),
        dependences=depends_on([series], motions),
        autocorrelated_rms=float(np.sqrt(products / count)),
        autocorrelation_z=products / max(series.rms**2 * float(np.sqrt(count)), 1e-300),
    )


def _bands(series: Series) -> tuple[Band, ...]:
    frequency, power = density(series)
    if not len(frequency):
        return ()
    total = float(power.sum())
    edges = band_edges(float(frequency[-1]))
    found = []
    for low, high in pairwise(edges):
        inside = (frequency > low) & (frequency <= high * (1 + 1e-9))
        if inside.any():
            found.append(
                Band(
                    low=low,
                    high=high,
                    rms=float(np.sqrt(np.mean(power[inside]))),
                    share=float(power[inside].sum() / total) if total > 0 else 0.0,
                )
            )
    return tuple(found)


def depends_on(many: Sequence[Series], motions: Sequence[JointMotion]) -> tuple[Dependence, ...]:
    """Find, by regressor, the joint that explains most of a channel's series.

    ``motions`` are those of all runs, by index of the trial.
    """
    thinned = [(s, np.arange(0, len(s.sample), max(1, len(s.sample) // _SAMPLES))) for s in many]
    residual = np.concatenate([s.residual[keep] for s, keep in thinned])
    block = np.concatenate([s.block[keep] for s, keep in thinned])
    joints = motions[many[0].trial].joints
    found = []
    for on in REGRESSORS:
        best: Dependence | None = None
        for j, joint in enumerate(joints):
            values = np.concatenate(
                [motions[s.trial].at(on, j, s.time[keep]) for s, keep in thinned]
            )
            each = dependence(residual, values, block, on=on, of=joint)
            if each is not None and (best is None or each.share > best.share):
                best = each
        if best is not None:
            found.append(best)
    return tuple(found)


def _joint_gaps(run: str, motion: JointMotion) -> list[JointResidual]:
    found = []
    every = max(1, len(motion.time) // _SAMPLES)
    block = (motion.time[::every] // LONGEST).astype(np.intp)
    for j, joint in enumerate(motion.joints):
        missing = motion.residual_torque[::every, j]
        good = np.isfinite(missing)
        if not good.any():
            continue
        depends = (
            dependence(missing, motion.regressor(on, j)[::every], block, on=on, of=joint)
            for on in REGRESSORS
        )
        found.append(
            JointResidual(
                run=run,
                joint=joint,
                unit=motion.units[j],
                residual=_without_noise(missing[good], float(motion.residual_noise[j])),
                noise=float(motion.residual_noise[j]),
                load=float(np.sqrt(np.nanmean(motion.load[:, j] ** 2))),
                dependences=tuple(d for d in depends if d is not None),
            )
        )
    return found


def _without_noise(torque: Array, noise: float) -> float:
    """Root mean square of a residual torque after the noise of the readings is taken out."""
    power = float(np.mean(torque**2))
    return (
        float(np.sqrt(max(power - noise**2, 0.0))) if np.isfinite(noise) else float(np.sqrt(power))
    )


def strongest(
    depends: Sequence[Dependence], *, least: float = DEPENDENCE_SHARE
) -> Dependence | None:
    """Select the simplest dependence that explains about as much as the strongest.

    Parameters
    ----------
    depends : sequence of Dependence
        Dependences of one channel.
    least : float
        Minimum share of the residual's power.
    """
    sure = [d for d in depends if d.z >= DEPENDENCE_Z and d.share >= least]
    if not sure:
        return None
    most = max(d.share for d in sure)
    good = [d for d in sure if d.share >= SIMPLER_DEPENDENCE * most]
    return min(good, key=lambda d: _SIMPLEST.index(d.regressor))


def main_band(gap: ChannelResidual) -> Band | None:
    """Band with most of the power beyond that of noise; None if there is only noise."""
    return _loudest(gap) if _shows(gap) else None


def _loudest(gap: ChannelResidual) -> Band | None:
    """Band with most of the power beyond that of noise, if any has more."""
    excess = {b: (b.rms**2 - 1) * (b.high - b.low) for b in gap.bands}
    band = max(excess, key=lambda b: excess[b], default=None)
    return band if band is not None and excess[band] > 0 else None


def _shows(gap: ChannelResidual) -> bool:
    """Return whether a residual exceeds noise: in size, or by autocorrelation."""
    return gap.rms >= VISIBLE_RMS or gap.autocorrelation_z >= UNEXPLAINED_Z


def location_notes(location: Location, *, most: int = 3, always: bool = False) -> list[str]:
    """Describe the location of a model error in sentences, worst channels first.

    Examples
    --------
    >>> gap = ChannelResidual(
    ...     run="a.csv",
    ...     channel="sensor.q",
    ...     rms=8.0,
    ...     offset=0.1,
    ...     dependences=(),
    ...     bands=(Band(low=0, high=1, rms=9.0, share=0.9),),
    ... )
    >>> location_notes(Location(channels=(gap,)))[0].split(", ")  # doctest: +NORMALIZE_WHITESPACE
    ['sensor.q has a residual of up to 8.0 noise standard deviations (a.csv)',
    'most of it between 0 and 1 Hz.']
    """
    torques = _torque_notes(location.joints, most)
    large = _worst([g for g in location.channels if g.rms >= VISIBLE_RMS], faint=False)
    told = {gap.channel for gap in large}
    faint = [g for g in location.channels if _shows(g) and g.channel not in told]
    told_of = [*large, *_worst(faint, faint=True)][:most]
    if always and not told_of and not torques:
        told_of = _worst(location.channels, faint=True)[:1]
    said = [_channel_note(gap, whole=always) for gap in told_of]
    return said + torques


def _channel_note(gap: ChannelResidual, *, whole: bool) -> str:
    """Describe one channel; with ``whole``, also that no regressor explains it."""
    faint = gap.rms < VISIBLE_RMS
    # The autocorrelated part: of a small residual most of the power is noise.
    share = min((gap.autocorrelated_rms / gap.rms) ** 2, 1.0) if faint and gap.rms else 1.0
    if faint:
        words = (
            f"{gap.channel} has a residual of about its noise ({gap.rms:.2f} standard deviations, "
            f"{gap.run}), of which {gap.autocorrelated_rms:.2f} are autocorrelated"
        )
    else:
        words = (
            f"{gap.channel} has a residual of up to {gap.rms:.1f} noise standard deviations "
            f"({gap.run})"
        )
    band = _loudest(gap)
    if band is not None:
        words += f", most of it between {band.low:g} and {band.high:g} Hz"
    found = strongest(gap.dependences, least=DEPENDENCE_SHARE * share)
    if abs(gap.offset) > 0.7 * gap.rms:
        words += "; it is almost constant"
    elif found is not None:
        of_it = min(found.share / max(share, 1e-12), 1.0)
        words += f"; {100 * of_it:.0f} % of it depends on the {found.regressor} of {found.joint}"
    elif whole:
        words += f"; no significant dependence on {', '.join(REGRESSORS)}"
    return words + "."


def _worst(gaps: Sequence[ChannelResidual], *, faint: bool) -> list[ChannelResidual]:
    """The worst run of every channel, the worst channel first."""

    def size(gap: ChannelResidual) -> float:
        return gap.autocorrelation_z if faint else gap.rms

    worst: dict[str, ChannelResidual] = {}
    for gap in gaps:
        if gap.channel not in worst or size(gap) > size(worst[gap.channel]):
            worst[gap.channel] = gap
    return sorted(worst.values(), key=lambda gap: -size(gap))


def _torque_notes(joints: Sequence[JointResidual], most: int) -> list[str]:
    """Describe the residual torque by joint."""
    shares: dict[str, list[JointResidual]] = {}
    for gap in joints:
        if np.isfinite(gap.noise) and gap.residual > VISIBLE_RMS * gap.noise:
            shares.setdefault(gap.joint, []).append(gap)
    ranked = sorted(
        shares.items(), key=lambda item: -max(g.residual / max(g.load, 1e-12) for g in item[1])
    )
    said = []
    for joint, gaps in ranked[:most]:
        gap = max(gaps, key=lambda g: g.residual)
        words = (
            f"{joint} has a residual torque of {gap.residual:.3g} {gap.unit} (RMS without noise; "
            f"model {gap.load:.3g} {gap.unit}, {gap.run}); sensor noise adds {gap.noise:.2g} "
            f"{gap.unit}"
        )
        found = strongest(gap.dependences)
        if found is not None:
            words += f"; {100 * found.share:.0f} % of it depends on its {found.regressor}"
        said.append(words + ".")
    return said
