"""Evidence in a result: residuals by channel, band and joint, residual tests, identifiability."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "Alike",
    "Band",
    "ChannelGap",
    "Dependence",
    "Identifiability",
    "JointGap",
    "LeftOver",
    "Location",
    "Unseen",
]


@dataclass(frozen=True, kw_only=True)
class Dependence:
    """How much of a residual one regressor explains."""

    on: str
    """One of `REGRESSORS`."""
    of: str
    """Joint whose position, velocity, ... it is."""
    share: float
    """Share of the residual's power, its mean left out, that blocks of time not looked at confirm
    (0 to 1)."""
    explained: float
    """Root mean square of that part, in the unit of the residual."""
    sureness: float
    """Over the scatter from block to block, in standard deviations."""


@dataclass(frozen=True, kw_only=True)
class Band:
    """A residual within a frequency band."""

    low: float
    """[Hz]."""
    high: float
    """[Hz]."""
    over_floor: float
    """Root mean square over that of the channel's noise in the same band; 1: noise alone."""
    share: float
    """Share of the residual's power (0 to 1)."""


@dataclass(frozen=True, kw_only=True)
class ChannelGap:
    """The disagreement of one channel in one run."""

    run: str
    """File of the run."""
    channel: str
    """As in the recording."""
    over_floor: float
    """Root mean square residual over the noise floor."""
    offset: float
    """Mean residual, in noise standard deviations."""
    bands: tuple[Band, ...]
    """From low frequencies to high ones."""
    depends: tuple[Dependence, ...]
    """For each regressor the joint that explains most; explained parts in noise deviations."""
    together: float = 0.0
    """The part that hangs together in time, which noise does not, in noise standard deviations."""
    sureness: float = 0.0
    """Of that part, over what white noise shows by chance, in standard deviations."""


@dataclass(frozen=True, kw_only=True)
class JointGap:
    """Torque or force at one joint that the nominal model does not explain, in one run."""

    run: str
    """File of the run."""
    joint: str
    """Its name."""
    unit: str
    """ "N·m", or "N" where it slides."""
    missing: float
    """Root mean square, in that unit."""
    floor: float
    """What the noise of the readings makes of it."""
    load: float
    """Root mean square of what the nominal model needs for the motion."""
    depends: tuple[Dependence, ...]
    """On the joint's own motion and load; explained parts in that unit."""


@dataclass(frozen=True, kw_only=True)
class Location:
    """Where the nominal model, fitted within its tolerance, disagrees with the measurement."""

    channels: tuple[ChannelGap, ...] = ()
    """By run and channel."""
    joints: tuple[JointGap, ...] = ()
    """By run and joint; empty where the machine's motion was not measured."""


@dataclass(frozen=True, kw_only=True)
class LeftOver:
    """What is left of one channel on the held-out runs."""

    channel: str
    """As in the recording."""
    over_floor: float
    """Root mean square over the noise floor; 1: noise alone."""
    autocorrelation: float
    """Of neighbouring samples; 0 for white noise."""
    whiteness_95: float
    """What the largest autocorrelation of white noise stays below, 95 times in 100."""
    largest: float
    """Largest autocorrelation over all lags looked at."""
    correlation_time: float
    """Time over which what is left hangs together [s]; the sample interval for white noise."""
    trend: float
    """Growth from the beginning of a run to its end, in noise standard deviations."""
    trend_sureness: float
    """Over its scatter from block to block, in standard deviations."""
    depends: tuple[Dependence, ...]
    """On motion and load, those that are sure and matter; explained parts in noise deviations."""

    @property
    def white(self) -> bool:
        """Whether it cannot be told from white noise by its autocorrelation."""
        return self.largest <= self.whiteness_95


@dataclass(frozen=True, kw_only=True)
class Unseen:
    """An effect that would not be seen at a size that matters."""

    kind: str
    """Identifier of the catalogue."""
    where: str
    """Its place."""
    parameters: dict[str, float]
    """The size."""
    sureness: float
    """What it changes beyond all that can be mistaken for it, in standard deviations; 5 needed."""
    more_s: float | None
    """How much more of the same runs would show it [s]; None where no length would."""


@dataclass(frozen=True, kw_only=True)
class Alike:
    """Two effects that these motions do not tell apart."""

    kind: str
    """Of the first; a named one, if either is."""
    where: str
    """Its place."""
    other_kind: str
    """Of the second."""
    other_where: str
    """Its place."""
    sureness: float
    """What of the first the second cannot take up, in standard deviations; 5 are needed."""
    more_s: float | None
    """How much more of the same runs would tell them apart [s]; None where no length would."""


@dataclass(frozen=True, kw_only=True)
class Identifiability:
    """What these motions can show."""

    unseen: tuple[Unseen, ...] = ()
    """Effects that they do not show."""
    alike: tuple[Alike, ...] = ()
    """Pairs that they do not tell apart, those with a named effect first."""
