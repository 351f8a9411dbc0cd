"""What a file holds, as ``loose import --describe`` shows it."""

from __future__ import annotations

from dataclasses import dataclass, field

from loose_env.importing.samples import ChannelKey

__all__ = ["Channel", "FileList", "Stream"]


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One channel."""

    key: ChannelKey
    """What a mapping calls it."""
    first: tuple[float, ...] = ()
    """First values, as the file holds them."""
    unit: str = ""
    """Unit that the file itself gives."""
    words: str = ""
    """What else the file says of it."""


@dataclass(frozen=True, kw_only=True)
class Stream:
    """Channels that share their times."""

    topic: str = ""
    """Topic of an MCAP file."""
    kind: str = ""
    """Type and encoding."""
    samples: int = 0
    start_ns: int | None = None
    """First sample [ns since 1970], where the file knows the date."""
    seconds: float | None = None
    """From the first to the last sample [s], where that is known."""
    channels: tuple[Channel, ...] = ()
    note: str = ""

    @property
    def rate_hz(self) -> float | None:
        """Mean rate [Hz]."""
        return (self.samples - 1) / self.seconds if self.seconds and self.samples > 1 else None


@dataclass(frozen=True, kw_only=True)
class FileList:
    """One file."""

    name: str
    kind: str
    """"mcap", "csv" or "uff"."""
    words: str
    """The kind in words."""
    streams: tuple[Stream, ...]
    options: tuple[str, ...] = field(default=())
    """Lines of a mapping that say how to read it."""

    def topics(self) -> list[str]:
        """Names of the topics."""
        return [stream.topic for stream in self.streams]
