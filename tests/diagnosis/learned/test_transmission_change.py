"""Sampling covariance of the motion in step with the commands, against records drawn."""

from __future__ import annotations

import numpy as np

from loose_env.diagnosis.learned.transmission_change import sampling_covariance


def test_it_is_the_scatter_of_records_with_gaussian_commands() -> None:
    rng = np.random.default_rng(1)
    lines, axes, commands, records = 20, 2, 2, 20_000
    rest = rng.standard_normal((lines, axes, commands, 2)) @ [1.0, 1j]
    rest[:, 0] *= 5.0  # one axis moves more
    rest -= rest.real.mean(axis=0)  # nothing in step
    drawn = rng.standard_normal((records, lines, commands, 2)) @ [1.0, 1j] / np.sqrt(2)
    moved = np.einsum("fij,rfj->rfi", rest, drawn)
    in_step = np.einsum("rfi,rfj->rij", moved, drawn.conj()).real / lines
    noise = np.diag([0.3, 0.1])
    # Noise of an axis is uncorrelated with every command.
    in_step += rng.standard_normal(in_step.shape) * np.sqrt(np.diag(noise) / (2 * lines))[:, None]
    found = np.cov(in_step.reshape(records, -1).T)
    expected = sampling_covariance(rest, noise, 2 * lines)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs(found - expected).max() < 0.05 * size.max()
    assert (np.abs(found - expected) < 0.05 * size).all()
