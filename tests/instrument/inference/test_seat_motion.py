"""Evidence for a seat's motion, by its regressors' inner products."""

from __future__ import annotations

import numpy as np

from loose_env.instrument.inference.seat_motion import Products, explained


def products(g11: float, g22: float, coherence: float, b: tuple[complex, complex]) -> Products:
    """Inner products of two regressors and the residual, (1, 1) each."""
    g12 = coherence * np.sqrt(g11 * g22) * np.exp(0.3j)
    mixed, first, second = (np.array([[value]], dtype=complex) for value in (g12, *b))
    return np.array([[g11]]), np.array([[g22]]), mixed, first, second


def test_collinear_regressors_keep_the_evidence_finite_at_any_power() -> None:
    rng = np.random.default_rng(3)
    x, y, e = rng.normal(size=(3, 1, 500)) + 1j * rng.normal(size=(3, 1, 500))
    # One channel reads: its two regressors are collinear.
    terms = (np.abs(x) ** 2, np.abs(y) ** 2, x.conj() * y, x.conj() * e, y.conj() * e)
    for power in np.geomspace(1.0, 1e20, 21):
        found, log_determinant = explained(terms, power * np.ones(1), power * np.ones(1))
        assert np.all(log_determinant >= 0.0) and np.all(found >= 0.0), power
        if power <= 1e6:  # above, the rounding of the products themselves counts
            total = power * (terms[0] + terms[1])
            np.testing.assert_allclose(log_determinant, np.log1p(total), rtol=1e-6)
            np.testing.assert_allclose(found, np.abs(e) ** 2 * total / (1 + total), rtol=1e-6)


def test_the_evidence_is_that_of_the_two_by_two_matrices() -> None:
    terms = products(3.0, 2.0, 0.6, (1.0 + 0.5j, -0.4 + 1.1j))
    g11, g22, g12, b1, b2 = (each.item() for each in terms)
    gram = np.array([[g11, g12], [np.conj(g12), g22]])
    prior, b = np.diag([0.7, 1.9]), np.array([b1, b2])
    found, log_determinant = explained(terms, np.array([[0.7]]), np.array([[1.9]]))
    expected = (b.conj() @ np.linalg.solve(np.linalg.inv(prior) + gram, b)).real
    np.testing.assert_allclose(found, expected)
    np.testing.assert_allclose(
        log_determinant, np.linalg.slogdet(np.eye(2) + prior @ gram).logabsdet
    )
