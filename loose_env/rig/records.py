"""Measurements, one or many as arrays, and what is asked of a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from loose_env.excitation import Excitation, Shaping
from loose_env.typing import Array, IndexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement:
    """Readings of one record in one pose.

    All channels are sampled together at ``rate``. Encoder channels have one sample more at
    either end, so that accelerations can be formed by differences.
    """

    pose: Array
    """Commanded pose [rad] (n,)."""
    excitation: Excitation
    """What was played."""
    rate: float
    """Sampling rate [Hz]."""
    command: Array
    """Random part of the commanded torque [N·m] (n, N)."""
    encoder: Array
    """Encoder readings, motor side [rad] (n, N + 2)."""
    tool: Array
    """Tool accelerometer, tool frame, proper acceleration [m/s²] (d, N)."""
    links: Array | None = None
    """Link accelerometers, link frames [m/s²] (L, d, N); None where there are none.

    One for each of the L links that carry one, base first; d is 1 where they are tangential."""
    probes: Mapping[str, Array] = field(default_factory=dict)
    """Further accelerometers by their site, along its own axes [m/s²] (3, N) each."""
    shaker_force: Array | None = None
    """Commanded force of the shaker [N] (N,); None where there is no shaker."""
    failure: str | None = None
    """Why the record is worthless; None for a good one."""

    @property
    def excited(self) -> NDArray[np.bool_]:
        """Whether each joint was excited (n,)."""
        return np.array(self.excitation.excited)


@dataclass(frozen=True, kw_only=True, eq=False)
class Records:
    """Readings of J records of one length: fields as of `Measurement`, an axis more in front."""

    pose: Array
    torque_rms: Array
    """Rms torque of every joint [N·m] (J, n)."""
    duration: float
    """Length of each record [s]."""
    band: tuple[float, float]
    """Band of the excitation [Hz]."""
    rate: float
    command: Array
    encoder: Array
    tool: Array
    links: Array | None = None
    probes: Mapping[str, Array] = field(default_factory=dict)
    shaker_force: Array | None = None
    failures: tuple[str | None, ...]
    """Why a record is worthless; None for a good one."""

    @classmethod
    def of(cls, measurements: Sequence[Measurement]) -> Records:
        """Put measurements of one arm, alike in length and band, together."""
        first = measurements[0]

        def stacked(name: str) -> Array:
            return np.array([getattr(each, name) for each in measurements])

        return cls(
            torque_rms=np.array([each.excitation.torque_rms for each in measurements]),
            duration=first.excitation.duration,
            band=first.excitation.band,
            rate=first.rate,
            links=None if any(m.links is None for m in measurements) else stacked("links"),
            failures=tuple(each.failure for each in measurements),
            pose=stacked("pose"),
            command=stacked("command"),
            encoder=stacked("encoder"),
            tool=stacked("tool"),
        )

    def __len__(self) -> int:
        return len(self.pose)

    def measurement(self, k: int, excitation: Excitation | None = None) -> Measurement:
        """Measurement of one record; its excitation where it was more than torques."""
        if excitation is None:
            rms = tuple(self.torque_rms[k].tolist())
            excitation = Excitation(torque_rms=rms, duration=self.duration, band=self.band)
        return Measurement(
            pose=self.pose[k],
            excitation=excitation,
            rate=self.rate,
            command=self.command[k],
            encoder=self.encoder[k],
            tool=self.tool[k],
            links=None if self.links is None else self.links[k],
            probes={site: signal[k] for site, signal in self.probes.items()},
            shaker_force=None if self.shaker_force is None else self.shaker_force[k],
            failure=self.failures[k],
        )

    def some(self, rows: NDArray[np.intp]) -> Records:
        """Some of the records."""
        if len(rows) == len(self):
            return self
        own = {name: getattr(self, name)[rows] for name in _STACKED}
        links = None if self.links is None else self.links[rows]
        failures = tuple(self.failures[k] for k in rows)
        return replace(self, links=links, failures=failures, probes={}, shaker_force=None, **own)


_STACKED = ("pose", "torque_rms", "command", "encoder", "tool")


@dataclass(frozen=True, kw_only=True, eq=False)
class Trials:
    """J measurements to take, of one length and band, each on a slot of its own."""

    slots: IndexArray
    """Arms of the rig (J,)."""
    poses: Array
    """Commanded poses [rad] (J, n)."""
    torque_rms: Array
    """Rms torque of every joint [N·m] (J, n)."""
    shaker_rms: Array
    """Rms force of the shaker [N] (J,)."""
    duration: float
    """Length of each record [s]."""
    band: tuple[float, float]
    """Band of the excitation [Hz]."""
    rngs: Sequence[np.random.Generator]
    """Source of each one's excitation, sensor noise and places of the seat in its gap."""
    shaping: Sequence[tuple[Shaping | None, ...] | None] | None = None
    """Spectra of each one's torques; flat ones by default."""
    gravity: Array | None = None
    """Torque that holds each joint of the nominal arm against gravity, where it is known (J, n)."""

    def __len__(self) -> int:
        return len(self.slots)

    @property
    def excited(self) -> NDArray[np.bool_]:
        """Whether each joint is excited (J, n)."""
        return self.torque_rms > 0

    def some(self, rows: IndexArray) -> Trials:
        """Some of the measurements."""
        own = {name: getattr(self, name)[rows] for name in ("slots", "poses", "torque_rms")}
        return replace(
            self,
            shaker_rms=self.shaker_rms[rows],
            rngs=[self.rngs[k] for k in rows],
            shaping=None if self.shaping is None else [self.shaping[k] for k in rows],
            gravity=None if self.gravity is None else self.gravity[rows],
            **own,
        )
