"""Band-limited Gaussian signals of an excitation.

Signals are synthesised in the frequency domain: every Fourier line of the record inside the
band gets an independent complex Gaussian amplitude (a Gaussian process, periodic in the
record length). The run-in before the record is the end of the same period, so the linear
answer is periodic too and nothing leaks out of the band.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidSetting
from loose_env.excitation.levels import Excitation
from loose_env.typing import Array

__all__ = ["torque_periods", "torque_signals"]


def torque_signals(
    excitation: Excitation,
    *,
    timestep: float,
    before: int,
    after: int,
    rng: np.random.Generator,
) -> Array:
    """Draw the torque of every joint, and the force of the shaker where it is on.

    Parameters
    ----------
    excitation : Excitation
        Excitation.
    timestep : float
        Sampling step [s].
    before, after : int
        Samples of run-in and run-out around the record; they continue its period.
    rng : numpy.random.Generator
        Source of the draw. Joints draw in order, whether excited or not, so that the signal
        of a joint does not depend on which others are on; the shaker draws last.

    Returns
    -------
    ndarray (n, before + duration / timestep + after)
        Torques [N·m]; with the shaker on, one more row, its force [N].

    Examples
    --------
    >>> import numpy as np
    >>> e = Excitation(torque_rms=(2.0, 0.0), duration=1.2, band=(30.0, 150.0))
    >>> u = torque_signals(e, timestep=1e-3, before=0, after=0, rng=np.random.default_rng(0))
    >>> u.shape, bool(abs(u[0].std() - 2.0) < 0.3), float(u[1].std())
    ((2, 1200), True, 0.0)
    """
    period, _, joints = torque_periods([excitation], timestep=timestep, rngs=[rng])
    count = period.shape[1]
    torque = np.zeros((len(excitation.levels), before + count + after))
    torque[joints] = period[:, np.arange(-before, count + after) % count]
    return torque


def torque_periods(
    excitations: Sequence[Excitation], *, timestep: float, rngs: Sequence[np.random.Generator]
) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
    """Draw one period of the torque of every excited joint of several records of one length.

    Parameters
    ----------
    excitations : sequence of Excitation
        Excitations of one duration and band.
    timestep : float
        Sampling step [s].
    rngs : sequence of numpy.random.Generator
        Source of each record's draw, as for `torque_signals`.

    Returns
    -------
    ndarray (R, duration / timestep)
        Torques [N·m], or the force of the shaker [N].
    ndarray of int (R,)
        Record of each row.
    ndarray of int (R,)
        Joint of each row; n for the shaker.

    Examples
    --------
    >>> import numpy as np
    >>> e = Excitation(torque_rms=(0.0, 2.0), duration=1.2, band=(30.0, 150.0))
    >>> rows, records, joints = torque_periods(
    ...     [e, e], timestep=1e-3, rngs=[np.random.default_rng(k) for k in range(2)]
    ... )
    >>> rows.shape, records.tolist(), joints.tolist()
    ((2, 1200), [0, 1], [1, 1])
    """
    first = excitations[0]
    low, high = first.band
    if high >= 0.5 / timestep:
        raise InvalidSetting(
            f"band {first.band} Hz reaches half the sampling rate, {0.5 / timestep:g} Hz"
        )
    count = round(first.duration / timestep)
    frequency = np.arange(count // 2 + 1) / (count * timestep)
    inside = np.flatnonzero((frequency >= low - 1e-9) & (frequency <= high + 1e-9))
    owners, joints, lines = [], [], []
    for k, (excitation, rng) in enumerate(zip(excitations, rngs, strict=True)):
        levels = excitation.levels
        draws = rng.standard_normal((len(levels), len(inside), 2))
        for j, rms in enumerate(levels):
            if rms == 0:
                continue
            owners.append(k)
            joints.append(j)
            # E|line|² = 2; the expected rms of the sum of all lines is the one asked for.
            own = (draws[j, :, 0] + 1j * draws[j, :, 1]) * (
                rms * count / (2 * np.sqrt(len(inside)))
            )
            shape = None if excitation.shaping is None else (*excitation.shaping, None)[j]
            if shape is not None:
                weight = shape(frequency[inside])
                own *= weight / np.sqrt(np.mean(weight**2))
            lines.append(own)
    spectra = np.zeros((len(lines), count // 2 + 1), dtype=complex)
    spectra[:, inside] = np.reshape(lines, (len(lines), len(inside)))
    # numpy transforms row by row: no row depends on the others.
    rows = np.fft.irfft(spectra, n=count)
    return rows, np.array(owners, dtype=np.intp), np.array(joints, dtype=np.intp)
