"""Dataclasses of evidence in result.json: residuals, residual tests, and identifiability."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """Share of a residual explained by one regressor."""

    regressor: str
    """Regressor, one of `REGRESSORS`."""
    joint: str
    """Joint of the regressor."""
    share: float
    """Share of the residual's power, its mean left out, that blocks of time not looked at confirm
    (0 to 1)."""
    explained: float
    """Root mean square of the explained part, in the unit of the residual."""
    z: float
    """z-score of the share, from its scatter between blocks."""


@dataclass(frozen=True, kw_only=True)
class Band:
    """A residual within a frequency band."""

    low: float
    """Lower edge [Hz]."""
    high: float
    """Upper edge [Hz]."""
    rms: float
    """Root mean square over that of the channel's noise in the same band; 1: noise alone."""
    share: float
    """Share of the residual's power (0 to 1)."""


@dataclass(frozen=True, kw_only=True)
class ChannelResidual:
    """Residual of one channel in one run."""

    run: str
    """File of the run."""
    channel: str
    """Name of the channel, as in the recording."""
    rms: float
    """Root mean square residual over the noise floor."""
    offset: float
    """Mean residual, in noise standard deviations."""
    bands: tuple[Band, ...]
    """Bands, from low frequencies to high ones."""
    dependences: tuple[Dependence, ...]
    """For each regressor the joint that explains most, in noise standard deviations."""
    autocorrelated_rms: float = 0.0
    """The autocorrelated part of the residual, in noise standard deviations."""
    autocorrelation_z: float = 0.0
    """Significance (z) of that part, against white noise."""


@dataclass(frozen=True, kw_only=True)
class JointResidual:
    """Residual torque or force at one joint in one run."""

    run: str
    """File of the run."""
    joint: str
    """Name of the joint."""
    unit: str
    """Unit: "N·m", or "N" for a slide."""
    residual: float
    """Root mean square residual torque."""
    noise: float
    """Part due to the noise of the readings."""
    load: float
    """Root mean square of the nominal model's inverse dynamics torque."""
    dependences: tuple[Dependence, ...]
    """Dependence on the joint's own motion and load, in that unit."""


@dataclass(frozen=True, kw_only=True)
class Location:
    """Location of the model error: residuals of the fitted nominal model."""

    channels: tuple[ChannelResidual, ...] = ()
    """Residuals by run and channel."""
    joints: tuple[JointResidual, ...] = ()
    """Residual torques by run and joint; empty where the motion was not measured."""


@dataclass(frozen=True, kw_only=True)
class ResidualTest:
    """Residual tests of one channel on the held-out runs."""

    channel: str
    """Name of the channel, as in the recording."""
    rms: float
    """Root mean square over the noise floor; 1: noise alone."""
    autocorrelation: float
    """Autocorrelation of neighbouring samples; 0 for white noise."""
    whiteness_95: float
    """95 % bound of the largest autocorrelation of white noise."""
    largest_autocorrelation: float
    """Largest autocorrelation over all lags tested."""
    correlation_time: float
    """Correlation time of the residual [s]; the sample interval for white noise."""
    trend: float
    """Trend from the beginning of a run to its end, in noise standard deviations."""
    trend_z: float
    """z-score of the trend, from its scatter between blocks."""
    dependences: tuple[Dependence, ...]
    """Significant dependences on motion and load, in noise standard deviations."""

    @property
    def white(self) -> bool:
        """Return whether the autocorrelation is that of white noise."""
        return self.largest_autocorrelation <= self.whiteness_95


@dataclass(frozen=True, kw_only=True)
class UnidentifiableEffect:
    """An effect not identifiable at a size that matters."""

    kind: str
    """Identifier of the catalogue."""
    where: str
    """Location of the effect."""
    parameters: dict[str, float]
    """Size of the effect, by parameter."""
    z: float
    """Signature beyond all confusable effects, in standard deviations; 5 needed."""
    additional_s: float | None
    """Additional length of the same runs needed [s]; None where no length suffices."""


@dataclass(frozen=True, kw_only=True)
class ConfusablePair:
    """Two confusable effects, not distinguishable from these motions."""

    kind: str
    """Kind of the first effect; an identified one, if either is."""
    where: str
    """Location of the first effect."""
    other_kind: str
    """Kind of the second effect."""
    other_where: str
    """Location of the second effect."""
    z: float
    """Part of the first that the second cannot absorb, in standard deviations; 5 needed."""
    additional_s: float | None
    """Additional length of the same runs needed [s]; None where no length suffices."""


@dataclass(frozen=True, kw_only=True)
class Identifiability:
    """Identifiability of effects from the recorded motions."""

    unidentifiable: tuple[UnidentifiableEffect, ...] = ()
    """Effects that are not identifiable."""
    confusable: tuple[ConfusablePair, ...] = ()
    """Pairs of confusable effects, those with an identified effect first."""
