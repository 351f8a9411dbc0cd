"""Sensor models: accelerometers (noise, gain, cross-axis), encoders, and the suite of an arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Predicate

from loose_env.arms import Arm, Place
from loose_env.errors import InvalidSetting
from loose_env.io import Checked, Count, NonNegative, Rule, positive

__all__ = ["Accelerometer", "Encoder", "LinkAccelerometers", "SensorSuite", "link_choice"]

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of free fall, the unit g of data sheets [m/s²]."""


@dataclass(frozen=True, kw_only=True)
class Accelerometer(Checked):
    """A two- or three-axis accelerometer and its recorder.

    Gains, cross-axis sensitivity and mounting differ from arm to arm: they are part of
    `loose_env.arms.mismatch.Mismatch` and reach the readings as one matrix.
    """

    noise_density: NonNegative = 100e-6 * STANDARD_GRAVITY
    """White noise [m/s² per √Hz]; capacitive sensors have 22 to 300 µg/√Hz."""
    bandwidth: NonNegative = 400.0
    """Half-amplitude frequency of the recorder's low-pass [Hz]; linear-phase, delay taken out."""
    resolution: NonNegative = 2 * 50 * STANDARD_GRAVITY / 2**16
    """Step of the digitiser [m/s²]: 16 bits over ±50 g."""


@dataclass(frozen=True, kw_only=True)
class Encoder(Checked):
    """A joint encoder on the motor side."""

    resolution: NonNegative = 2 * np.pi / 2**20
    """Step of the reading [rad]: 20 bits a turn."""
    noise: NonNegative = 2e-6
    """Rms noise of one reading before it is rounded [rad]."""
    linear_resolution: NonNegative = 1e-6
    """Step of the linear scale of a sliding joint [m]."""
    linear_noise: NonNegative = 2e-7
    """Rms noise of one reading of that scale before it is rounded [m]."""


_LINKS = Rule(
    "numbers from 1 at the base, increasing, or None for every link",
    (Predicate(lambda links: links is None or list(links) == sorted(set(links))),),
)


@dataclass(frozen=True, kw_only=True)
class LinkAccelerometers(Checked):
    """Accelerometers on links: links, location and measured axes (8.3.3, 8.3.4).

    Examples
    --------
    >>> LinkAccelerometers(links=(1, 3), tangential=True).place
    'distal'
    """

    links: Annotated[tuple[Count, ...] | None, _LINKS] = None
    """Numbers of the links that carry one, increasing; None for every link."""
    tangential: bool = False
    """True for a single axis along the tangent of the link's own joint motion.

    Else it has the arm's axes, in the frame of the body that carries it."""
    place: Place = "distal"
    """End of the link; see `loose_env.arms.arm.link_site`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tangential and self.place == "proximal":
            raise InvalidSetting(
                "the proximal end lies on the axis of the link's own joint and has no tangent; "
                "put tangential accelerometers at the distal end"
            )

    def on(self, arm: Arm) -> tuple[int, ...]:
        """Numbers of the links of an arm that carry one.

        Raises
        ------
        UnknownName
            If the arm has no such link.
        """
        if self.links is None:
            return tuple(range(1, arm.n + 1))
        return tuple(arm.link_number(link) for link in self.links)


@dataclass(frozen=True, kw_only=True)
class SensorSuite(Checked):
    """All sensors of an arm and the rate at which they are recorded."""

    rate: Annotated[float, positive("Hz")] = 1000.0
    """Sampling rate [Hz]."""
    accelerometer: Accelerometer = Accelerometer()
    """Accelerometer at the tool, and on every link where `link_accelerometers` is set."""
    encoder: Encoder = Encoder()
    """Encoder of every joint."""
    link_accelerometers: bool | LinkAccelerometers = False
    """Accelerometers on links (8.3.3): which, or True for one at the proximal end of each."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.accelerometer.bandwidth >= self.rate / 2:
            raise InvalidSetting(
                f"an accelerometer bandwidth of {self.accelerometer.bandwidth} Hz needs a "
                f"sampling rate above twice that, got {self.rate} Hz"
            )

    @property
    def on_links(self) -> LinkAccelerometers | None:
        """Accelerometers on links; None where there are none."""
        return link_choice(self.link_accelerometers)

    @classmethod
    def ideal(cls, *, rate: float = 1000.0) -> SensorSuite:
        """Sensors that add nothing but their sampling and band."""
        return cls(
            rate=rate,
            accelerometer=Accelerometer(noise_density=0.0, resolution=0.0),
            encoder=Encoder(resolution=0.0, noise=0.0, linear_resolution=0.0, linear_noise=0.0),
        )


def link_choice(given: bool | LinkAccelerometers) -> LinkAccelerometers | None:
    """Spell out a choice of accelerometers on links; None where there are none."""
    if isinstance(given, LinkAccelerometers):
        return given
    return LinkAccelerometers(place="proximal") if given else None
