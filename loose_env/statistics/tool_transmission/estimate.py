"""Transmission estimates with their covariance, for joining and comparing records."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import as_floats, require_finite, require_rate
from loose_env.statistics.records.covariance import centred, covariances
from loose_env.statistics.sampling.autocorrelation import long_run_covariance
from loose_env.statistics.tool_transmission.change import transmission_by_instrument_from
from loose_env.typing import Array


@dataclass(frozen=True, slots=True, eq=False)
class TransmissionEstimate:
    """Transmission estimate with its covariance."""

    b: Array
    """Transmission, or a change of it, m/s^2 per rad/s^2, shape (d, m)."""
    covariance: Array
    """Covariance of the entries of b, shape (d, m, d, m)."""
    degrees: float = np.inf
    """Degrees of freedom of that covariance."""

    def __post_init__(self) -> None:
        """Check the shapes."""
        if self.b.ndim != 2 or self.covariance.shape != self.b.shape * 2:
            raise InvalidData(
                f"b has shape {self.b.shape} and covariance {self.covariance.shape}; they must "
                "be (d, m) and (d, m, d, m)"
            )

    def minus(self, reference: "TransmissionEstimate | ArrayLike") -> "TransmissionEstimate":
        """Change against a reference, either an estimate or exact values.

        Raises
        ------
        InvalidData
            If the shapes differ or a value is not finite.
        """
        if not isinstance(reference, TransmissionEstimate):
            exact = as_floats(reference, "reference")
            if exact.shape != self.b.shape:
                raise InvalidData(f"reference has shape {exact.shape}; b has {self.b.shape}")
            require_finite(exact, "reference")
            return TransmissionEstimate(self.b - exact, self.covariance, self.degrees)
        if reference.b.shape != self.b.shape:
            raise InvalidData(f"reference has shape {reference.b.shape}; b has {self.b.shape}")
        return TransmissionEstimate(
            self.b - reference.b,
            self.covariance + reference.covariance,
            min(self.degrees, reference.degrees),
        )

    def turned(self, matrix: ArrayLike) -> "TransmissionEstimate":
        """Transform the tool axes by a matrix: T b, with the covariance.

        Parameters
        ----------
        matrix : array, shape (k, d)
            What is applied to the tool axes.

        Raises
        ------
        InvalidData
            If the shape does not fit.
        """
        t = as_floats(matrix, "matrix")
        if t.ndim != 2 or t.shape[1] != len(self.b):
            raise InvalidData(f"matrix has shape {t.shape}; it must be (k, {len(self.b)})")
        covariance = np.einsum("ki,imjn,lj->kmln", t, self.covariance, t)
        return TransmissionEstimate(t @ self.b, covariance, self.degrees)

    def with_errors(self, errors: ArrayLike) -> "TransmissionEstimate":
        """Add independent errors that the records do not reveal.

        Parameters
        ----------
        errors : array, shape (K, d, m)
            Change of b by each error, one standard deviation large.

        Raises
        ------
        InvalidData
            If the shape does not fit or a value is not finite.
        """
        found = as_floats(errors, "errors")
        if found.ndim != 3 or found.shape[1:] != self.b.shape:
            raise InvalidData(
                f"errors has shape {found.shape}; it must be (K, {self.b.shape[0]}, "
                f"{self.b.shape[1]})"
            )
        require_finite(found, "errors")
        added = np.einsum("kim,kjn->imjn", found, found)
        return TransmissionEstimate(self.b, self.covariance + added, self.degrees)


def estimate_transmission(
    x: ArrayLike, a: ArrayLike, rate: float, *, command: ArrayLike | None = None
) -> TransmissionEstimate:
    """Regress tool acceleration on joint accelerations, with the covariance.

    The scatter allows for memory in the signals and for residuals whose size follows the
    excitation, as the motion in a gap does (heteroscedastic and autocorrelated residuals).

    Parameters
    ----------
    x : array, shape (N,) or (m, N)
        Accelerations of the excited joints, rad/s^2.
    a : array, shape (d, N)
        Tool acceleration in the tool frame, m/s^2.
    rate : float
        Sampling rate, Hz.
    command : array, shape (N,) or (m, N), optional
        Commanded torques, N m. They serve as instrument, which encoder noise does not shrink;
        without them x is taken as exact.

    Returns
    -------
    TransmissionEstimate
        Transmission with its covariance.

    Raises
    ------
    InvalidData
        If the record or the rate cannot be used, or the joints do not follow the command.

    References
    ----------
    White, Econometrica 48 (1980); Newey and West, Econometrica 55 (1987).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, noise = rng.standard_normal(2000), rng.standard_normal((3, 2000))
    >>> found = estimate_transmission(x, np.stack((x, 0 * x, 0 * x)) + 0.1 * noise, 1000.0)
    >>> found.b.shape, bool(abs(found.covariance[1, 0, 1, 0] ** 0.5 / (0.1 / 2000**0.5) - 1) < 0.2)
    ((3, 1), True)
    """
    require_rate(rate)
    instrument = x if command is None else command
    cov_a, cov_x = covariances(instrument, a), covariances(instrument, x)
    b = transmission_by_instrument_from(cov_x, cov_a)
    z, joint, tool = centred(instrument), centred(x), centred(a)
    residual = tool - np.einsum("ij,jn->in", b, joint)
    drive = np.linalg.solve(cov_x.xa, z)  # what each sample of z weighs in each column of b
    d, m = b.shape
    influence = (residual[:, None] * drive[None]).reshape(d * m, -1)
    count = influence.shape[1]
    run = long_run_covariance(influence)
    # What m regressors fit of the noise of each row is missing from its residual.
    lost = run.degrees / max(run.degrees - m, 1.0)
    return TransmissionEstimate(
        b, (lost * run.covariance / count).reshape(d, m, d, m), max(run.degrees - m, 1.0)
    )


def join_transmissions(estimates: Sequence[TransmissionEstimate]) -> TransmissionEstimate:
    """Concatenate independent estimates: other joints, or other records.

    Parameters
    ----------
    estimates : sequence of TransmissionEstimate
        Each of shape (d, m_k).

    Returns
    -------
    TransmissionEstimate
        Shape (d, sum of m_k).

    Raises
    ------
    InvalidData
        If there is none, or they have different numbers of rows.

    Examples
    --------
    >>> one = TransmissionEstimate(np.ones((3, 1)), np.eye(3).reshape(3, 1, 3, 1))
    >>> join_transmissions([one, one]).b.shape
    (3, 2)
    """
    if not estimates or len({len(e.b) for e in estimates}) != 1:
        raise InvalidData(
            "one estimate or more is needed, all with the same number of rows; got shapes "
            f"{[e.b.shape for e in estimates]}"
        )
    b = np.concatenate([e.b for e in estimates], axis=1)
    d, m = b.shape
    covariance = np.zeros((d, m, d, m))
    start = 0
    for e in estimates:
        span = slice(start, start + e.b.shape[1])
        covariance[:, span, :, span] = e.covariance
        start = span.stop
    # What all columns say together rests on a typical one of them.
    scarce = sum(1.0 / e.degrees for e in estimates)
    degrees = len(estimates) / scarce if scarce > 0.0 else np.inf
    return TransmissionEstimate(b, covariance, degrees)


def pool_transmissions(estimates: Sequence[TransmissionEstimate]) -> TransmissionEstimate:
    """Precision-weighted mean of independent estimates of one transmission.

    Parameters
    ----------
    estimates : sequence of TransmissionEstimate
        All of shape (d, m).

    Returns
    -------
    TransmissionEstimate
        Their mean, with the covariance it has.

    Raises
    ------
    InvalidData
        If there is none, or the shapes differ.

    Examples
    --------
    >>> one = TransmissionEstimate(np.ones((3, 1)), np.eye(3).reshape(3, 1, 3, 1))
    >>> round(float(pool_transmissions([one, one]).covariance[0, 0, 0, 0]), 6)
    0.5
    """
    if not estimates or len({e.b.shape for e in estimates}) != 1:
        raise InvalidData(
            "one estimate or more is needed, all of one shape; got shapes "
            f"{[e.b.shape for e in estimates]}"
        )
    if len(estimates) == 1:
        return estimates[0]
    shape = estimates[0].b.shape
    size = shape[0] * shape[1]
    precision, weighted = np.zeros((size, size)), np.zeros(size)
    for e in estimates:
        own = np.linalg.inv(_regular(e.covariance.reshape(size, size)))
        precision += own
        weighted += own @ e.b.ravel()
    covariance = np.linalg.inv(precision)
    return TransmissionEstimate(
        (covariance @ weighted).reshape(shape),
        covariance.reshape(*shape, *shape),
        sum(e.degrees for e in estimates),
    )


def _regular(covariance: Array) -> Array:
    """Regularise a covariance so that its inverse exists."""
    most = float(np.max(np.diag(covariance), initial=0.0))
    return np.asarray(covariance + (1e-12 * most + 1e-300) * np.eye(len(covariance)))
