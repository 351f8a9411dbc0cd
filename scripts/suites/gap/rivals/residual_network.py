"""Residual torque learned by a small network: it predicts, and cannot name.

A multilayer perceptron takes position, velocity and command of all joints and predicts the torque
that the nominal model, fitted within its tolerance, does not account for. Training stops where the
error on a further run, which is not trained on, no longer falls. The verdict is `unexplained` where
the prediction of the held-out run is better than none by more than its scatter, and `no_gap` else.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loose_env.recording import read_recording
from loose_env.typing import Array
from scripts.suites.gap.rivals.joint_data import joint_runs
from scripts.suites.gap.rivals.regression import regression_of
from scripts.suites.gap.rivals.results import Finding, VerdictSettings, write_finding

__all__ = ["NetworkSettings", "improvement_z", "predicted", "run_residual_network"]


@dataclass(frozen=True, kw_only=True)
class NetworkSettings:
    """Settings of the network and its training."""

    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers."""
    epochs: int = 400
    """Most passes through the training runs."""
    patience: int = 40
    """Passes without a better validation after which training ends."""
    batch: int = 256
    """Samples of a step."""
    learning_rate: float = 2e-3
    """Step of Adam."""
    weight_decay: float = 1e-3
    """Decay of the weights, AdamW's."""
    block_s: float = 0.25
    """Length of the blocks of time over which the improvement scatters [s]."""
    least_z: float = 3.0
    """Improvement over its standard error from which it is no chance."""
    seed: int = 0
    """Seed of weights, order of samples and the noise replica."""


def run_residual_network(recording: Path, folder: Path, tolerance: float) -> None:
    """Train the network on a recording and write the result.

    Parameters
    ----------
    recording : Path
        Folder of the recording.
    folder : Path
        Folder of the result.
    tolerance : float
        Largest relative error of the nominal parameters.
    """
    settings = NetworkSettings()
    rng = np.random.default_rng(settings.seed)
    regression = regression_of(recording, tolerance, rng)
    nominal = regression.fit([])
    residuals = [
        regression.residual(nominal, i) / regression.noise for i in range(len(regression.rows))
    ]
    inputs = _inputs(recording)
    prediction = predicted(inputs, residuals, settings, rng)
    held_out = residuals[-1]
    after = held_out - prediction
    z = improvement_z(held_out, after, regression.rate_hz, settings)
    rms = float(np.sqrt(np.mean(held_out**2)))
    if z < settings.least_z:
        # a prediction that is no better is not made
        prediction, after = np.zeros_like(held_out), held_out
    # by this method only its own improvement says that something is missing
    limit = VerdictSettings(no_gap=0.0 if z >= settings.least_z else np.inf)
    write_finding(
        folder,
        Finding(
            method="residual_network",
            before=rms,
            after=float(np.sqrt(np.mean(after**2))),
            held_out=regression.runs[-1],
            settings={"tolerance": tolerance, "seed": settings.seed, "improvement_z": z},
        ),
        limit,
    )


def _inputs(folder: Path) -> list[Array]:
    """Position, velocity and torque of the command or as measured, of shape (t, 3 n), per run."""
    found = []
    for run in joint_runs(read_recording(folder)):
        position, velocity, _ = run.motion()
        found.append(np.hstack((position, velocity, run.low_pass.reduced(run.torque))))
    return found


def predicted(
    inputs: list[Array], residuals: list[Array], settings: NetworkSettings, rng: np.random.Generator
) -> Array:
    """Prediction of the last run's residual by a network trained on the others."""
    import torch

    torch.manual_seed(int(rng.integers(2**31)))
    mean = np.mean(np.concatenate(inputs[:-1]), axis=0)
    scale = np.std(np.concatenate(inputs[:-1]), axis=0) + 1e-12
    size = max(1.0, float(np.std(np.concatenate(residuals[:-1]))))
    x = [torch.as_tensor((i - mean) / scale, dtype=torch.float32) for i in inputs]
    y = [torch.as_tensor(r / size, dtype=torch.float32) for r in residuals[:-1]]
    # the last training run tells when to stop, where there are several
    own = slice(0, -1) if len(y) > 1 else slice(None)
    train_x, train_y = torch.cat(x[:-1][own]), torch.cat(y[own])
    layers: list[torch.nn.Module] = []
    width = train_x.shape[1]
    for hidden in settings.hidden:
        layers += [torch.nn.Linear(width, hidden), torch.nn.Tanh()]
        width = hidden
    network = torch.nn.Sequential(*layers, torch.nn.Linear(width, train_y.shape[1]))
    optimiser = torch.optim.AdamW(
        network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
    )
    best, waited, kept = np.inf, 0, network.state_dict()
    for _ in range(settings.epochs):
        order = torch.as_tensor(rng.permutation(len(train_x)))
        for batch in torch.split(order, settings.batch):
            optimiser.zero_grad()
            loss = torch.nn.functional.mse_loss(network(train_x[batch]), train_y[batch])
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
        with torch.no_grad():
            error = float(torch.nn.functional.mse_loss(network(x[:-1][-1]), y[-1]))
        if error < best:
            best, waited = error, 0
            kept = {name: value.clone() for name, value in network.state_dict().items()}
        else:
            waited += 1
            if waited > settings.patience:
                break
    network.load_state_dict(kept)
    with torch.no_grad():
        return np.asarray(network(x[-1]).numpy(), dtype=np.float64) * size


def improvement_z(before: Array, after: Array, rate_hz: float, settings: NetworkSettings) -> float:
    """Fall of the mean square over its standard error, over blocks of time."""
    gain = np.mean(before**2 - after**2, axis=1)
    length = max(1, round(settings.block_s * rate_hz))
    count = len(gain) // length
    if count < 2:
        return 0.0
    blocks = gain[: count * length].reshape(count, length).mean(axis=1)
    error = float(blocks.std(ddof=1)) / np.sqrt(count)
    return float(blocks.mean() / max(error, 1e-12))
