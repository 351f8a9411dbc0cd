"""The Gaussian mixture: its density, its tails, and the fit."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.statistics import GaussianMixture, fit_gaussian_mixture

WIDE = np.array([[2.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 0.5]])


def two() -> GaussianMixture:
    return GaussianMixture(
        weights=np.array([0.7, 0.3]),
        means=np.array([[0.0, 0.0, 0.0], [5.0, -4.0, 3.0]]),
        covariances=np.array([WIDE, np.diag([0.5, 2.0, 1.0])]),
    )


def draw(mixture, count, rng):
    which = rng.choice(len(mixture.weights), size=count, p=mixture.weights)
    return np.array(
        [rng.multivariate_normal(mixture.means[k], mixture.covariances[k]) for k in which]
    )


def test_the_density_of_one_gaussian_is_scipys():
    rng = np.random.default_rng(0)
    points, mean = rng.normal(size=(20, 3)), np.array([0.3, -1.0, 2.0])
    one = GaussianMixture(weights=np.ones(1), means=mean[None], covariances=WIDE[None])
    expected = multivariate_normal(mean, WIDE).logpdf(points)
    assert one.log_densities(points)[:, 0] == pytest.approx(expected)


def test_the_upper_tail_is_the_integral_of_the_density():
    mixture, others = two(), np.array([-2.0, 1.5])
    grid = np.linspace(-15, 20, 20001)
    points = np.column_stack([grid, np.tile(others, (len(grid), 1))])
    density = np.exp(mixture.log_densities(points)).sum(axis=1)
    for at in (-1.0, 2.0, 5.0):
        expected = density[grid >= at].sum() / density.sum()
        found = np.exp(mixture.log_upper_tail([[at, *others]])[0])
        assert found == pytest.approx(expected, abs=2e-3)


def test_the_upper_tail_far_out_keeps_its_logarithm():
    one = GaussianMixture(weights=np.ones(1), means=np.zeros((1, 2)), covariances=np.eye(2)[None])
    assert one.log_upper_tail([[50.0, 0.0]])[0] == pytest.approx(norm.logsf(50.0))


def test_the_fit_finds_the_mixture_that_points_were_drawn_from():
    true = two()
    fit = fit_gaussian_mixture(
        draw(true, 6000, np.random.default_rng(1)), 2, np.random.default_rng(2)
    )
    order = np.argsort(-fit.weights)
    assert fit.weights[order] == pytest.approx(true.weights, abs=0.03)
    assert fit.means[order] == pytest.approx(true.means, abs=0.15)
    assert fit.covariances[order] == pytest.approx(true.covariances, abs=0.2)


def test_a_fit_depends_on_its_generator_alone():
    points = draw(two(), 300, np.random.default_rng(3))
    fits = [fit_gaussian_mixture(points, 3, np.random.default_rng(4)) for _ in range(2)]
    assert np.array_equal(fits[0].means, fits[1].means)


def test_a_constant_dimension_and_equal_points_do_not_break_the_fit():
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.normal(size=200), np.full(200, 7.0)])
    assert np.isfinite(fit_gaussian_mixture(points, 2, rng).log_densities(points)).all()
    assert np.isfinite(fit_gaussian_mixture(np.ones((50, 2)), 3, rng).means).all()


def test_wrong_input_is_refused():
    rng = np.random.default_rng(6)
    with pytest.raises(InvalidData, match="too few"):
        fit_gaussian_mixture(np.zeros((3, 5)), 1, rng)
    with pytest.raises(InvalidSetting, match="components"):
        fit_gaussian_mixture(np.zeros((30, 2)), 0, rng)
    with pytest.raises(InvalidData, match="shape"):
        two().log_densities(np.zeros((4, 2)))
    with pytest.raises(InvalidData, match="add up"):
        GaussianMixture(weights=np.ones(2), means=np.zeros((2, 1)), covariances=np.ones((2, 1, 1)))
    with pytest.raises(InvalidData, match="positive definite"):
        GaussianMixture(weights=np.ones(1), means=np.zeros((1, 1)), covariances=-np.ones((1, 1, 1)))
