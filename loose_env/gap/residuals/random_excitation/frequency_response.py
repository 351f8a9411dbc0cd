"""Linear response of readings to a random command by segment, and the incoherent remainder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from loose_env.errors import InvalidData
from loose_env.typing import Array, ComplexArray

_BINS = 16
"""Frequencies over which a response counts as a parabola, apart from those that are used up."""
FEWEST = 200
"""Fewest samples of a run."""
_TAPER = 0.15
"""Share of the run that fades in, and that fades out."""
_SEGMENT = 0.5
"""Length of the pieces from which a smooth response is estimated [s]."""
_FAINT = 1e-8
"""Share of the command's largest power below which a frequency is not excited."""


@dataclass(frozen=True, eq=False)
class CommandResponse:
    """Splits readings into a linear response to the command and an incoherent part.

    The run is tapered by a window w, and its spectrum is cut into segments of a few frequencies
    each. In a segment the spectrum of w y is regressed on that of w u, on the same multiplied by
    the frequency and its square, and on that of w' u: the response is a parabola there, and the
    last regressor carries the effect of the window. The residual of the regression is incoherent:
    noise, impacts and all nonlinear response.

    References
    ----------
    Pintelon and Schoukens, System Identification (2012), section 7.2 (local polynomial method).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> command, noise = rng.normal(size=(2, 4000, 1))
    >>> rest = CommandResponse(command, 1000.0).incoherent(2 * np.roll(command, 1) + 0.1 * noise)
    >>> bool(abs(rest.density.mean() / 0.1**2 - 1) < 0.1)
    True
    """

    commands: Array
    rate: float

    def __post_init__(self) -> None:
        """Check the values."""
        values = self.commands
        if values.ndim != 2 or len(values) < FEWEST or not np.isfinite(values).all():
            raise InvalidData(
                f"commands have shape {values.shape}; they must be finite, (T, m), with at least "
                f"{FEWEST} samples"
            )
        still = np.flatnonzero(np.ptp(values, axis=0) <= 0)
        if len(still):
            raise InvalidData(
                f"command {still[0]} of the excited joints is constant; random excitation varies"
            )

    @cached_property
    def centred(self) -> Array:
        """Commands less their means (T, m)."""
        return np.asarray(self.commands - self.commands.mean(axis=0))

    @cached_property
    def window(self) -> Array:
        """Taper of the run (T,)."""
        count = len(self.commands)
        size = max(2, round(_TAPER * count))
        slope = 0.5 - 0.5 * np.cos(np.pi * (np.arange(size) + 0.5) / size)
        shape = np.ones(count)
        shape[:size], shape[-size:] = slope, slope[::-1]
        return shape

    @cached_property
    def frequencies(self) -> Array:
        """Centre frequencies of the segments [Hz] (P,)."""
        middle = self._pieces.mean(axis=1)
        return np.asarray(middle * self.rate / len(self.commands))

    @cached_property
    def _pieces(self) -> NDArray[np.intp]:
        """Frequency indices of each segment (P, bins), without zero."""
        bins = _BINS + 4 * self.commands.shape[1]
        count = (len(self.commands) // 2 - 1) // bins
        return 1 + np.arange(count * bins).reshape(count, bins)

    @cached_property
    def _explained(self) -> ComplexArray:
        """Orthonormal basis of the coherent part in each segment (P, bins, 4m)."""
        window = self.window
        plain = fft.rfft(self.centred * window[:, None], axis=0)[self._pieces]
        edges = fft.rfft(self.centred * np.gradient(window)[:, None], axis=0)[self._pieces]
        along = np.linspace(-1, 1, self._pieces.shape[1])[None, :, None]
        basis = np.concatenate([plain, plain * along, plain * along**2, edges], axis=2)
        basis /= np.maximum(np.linalg.norm(basis, axis=1, keepdims=True), 1e-300)
        return np.asarray(np.linalg.qr(basis)[0])

    @cached_property
    def _adjoint(self) -> ComplexArray:
        return np.ascontiguousarray(self._explained.conj().swapaxes(1, 2))

    def incoherent(self, values: Array) -> Incoherent:
        """Return the incoherent part of readings (T, C)."""
        window, explained = self.window, self._explained
        rows = np.ascontiguousarray(values.T)
        rows = (rows - (rows @ window / window.sum())[:, None]) * window
        count, bins, _ = explained.shape
        whole = fft.rfft(rows)[:, 1 : 1 + count * bins]
        spectra = np.ascontiguousarray(np.moveaxis(whole.reshape(-1, count, bins), 0, 2))
        spectra = spectra - explained @ (self._adjoint @ spectra)
        used = explained.shape[2] / explained.shape[1]
        scale = 1.0 / np.sqrt((1 - used) * np.sum(window**2))
        return Incoherent(spectra=spectra * scale, pieces=self._pieces, samples=len(values))

    def smooth(self, values: Array) -> Array:
        """Smoothed response to each command, estimated from the other half of the run.

        This keeps it free of the noise of its own half.
        """
        count = len(values)
        half = count // 2
        found = np.empty((*values.shape, self.commands.shape[1]))
        size = fft.next_fast_len(2 * count, real=True)
        source = fft.rfft(self.centred, size, axis=0)
        grid = np.linspace(0, 0.5, len(source))
        for own, other in (
            (slice(0, half), slice(half, count)),
            (slice(half, count), slice(0, half)),
        ):
            nodes, response = self._welch(values[other], self.centred[other])
            for c in range(values.shape[1]):
                for i in range(source.shape[1]):
                    shape = np.interp(grid, nodes, response[:, c, i].real) + 1j * np.interp(
                        grid, nodes, response[:, c, i].imag
                    )
                    whole = fft.irfft(shape * source[:, i], size)[:count]
                    found[own, c, i] = whole[own]
        return found

    def _welch(self, values: Array, commands: Array) -> tuple[Array, ComplexArray]:
        """Welch estimate: frequencies (cycles a sample) and responses (K, C, m)."""
        length = int(np.clip(_SEGMENT * self.rate, 16, len(values) // 4)) // 2 * 2
        starts = np.arange(0, len(values) - length + 1, length // 2)
        at = starts[:, None] + np.arange(length)
        shape = np.hanning(length + 2)[1:-1, None]

        def spectra(signals: Array) -> ComplexArray:
            pieces = signals[at]
            return np.asarray(
                fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * shape, axis=1)
            )

        u, y = spectra(commands), spectra(values)
        power = np.einsum("ski,skj->kij", u.conj(), u)
        cross = np.einsum("ski,skc->kic", u.conj(), y)
        level = np.einsum("kii->k", power).real
        # Positive where the command rests in this half of the run and has no power.
        ridge = max(_FAINT * float(level.max()), 1e-300) * np.eye(commands.shape[1])
        response = np.linalg.solve(power + ridge, cross).swapaxes(1, 2)
        response[level < 100 * _FAINT * level.max()] = 0.0
        return np.arange(len(level)) / length, response


@dataclass(frozen=True, eq=False)
class Incoherent:
    """Spectra of the incoherent part, by segment."""

    spectra: ComplexArray
    """Spectrum, scaled so that the mean square is the density (P, bins, C)."""
    pieces: NDArray[np.intp]
    """Frequency indices (P, bins)."""
    samples: int
    """Number of samples of the run."""

    @cached_property
    def density(self) -> Array:
        """Two-sided density times the rate (P, C): that of white noise is its variance."""
        real, imaginary = self.spectra.real, self.spectra.imag
        total = np.einsum("pbc,pbc->pc", real, real) + np.einsum(
            "pbc,pbc->pc", imaginary, imaginary
        )
        return np.asarray(total / self.spectra.shape[1])

    def series(self, kept: NDArray[np.bool_]) -> Array:
        """Return the selected segments (P,), as a stationary time series (T, C)."""
        whole = np.zeros((self.spectra.shape[2], self.samples // 2 + 1), dtype=complex)
        whole[:, self.pieces[kept].ravel()] = self.spectra[kept].reshape(-1, len(whole)).T
        return np.asarray(fft.irfft(whole * np.sqrt(self.samples), self.samples)).T
