"""Training of the neural ratio estimator on a bank of records, by the library `sbi`."""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.core.ratio_posterior import RatioSettings, hypothesis_codes, ratio_network
from loose_agents.posterior_training.record_bank import RecordBank

__all__ = ["RatioTraining", "episode_parts", "train_ratio"]


@dataclass(frozen=True, kw_only=True)
class RatioTraining:
    """Settings of the training; the library's own where it has one."""

    epochs: int = 60
    """Most passes over the records."""
    patience: int = 6
    """Passes without a better validation loss after which it ends."""
    batch: int = 400
    """Examples of a step."""
    learning_rate: float = 1e-3
    """Step of Adam."""
    seed: int = 1
    """Seed of the training."""


def episode_parts(bank: RecordBank, records: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Beginnings of every episode: its first record, its first two, and so on.

    A posterior is asked after any number of records.

    Parameters
    ----------
    bank : RecordBank
        The episodes.
    records : int
        Most records that an observation holds.

    Returns
    -------
    ndarray (N, records, elements)
        Records, zero beyond the beginning.
    ndarray (N,)
        True hypothesis of each.
    """
    taken = bank.slots[:, :, 0] > 0.5
    slots, truth = [], []
    for length in range(1, bank.slots.shape[1] + 1):
        own = taken[:, length - 1]
        part = bank.slots[own].copy()
        part[:, length:] = 0.0
        slots.append(part)
        truth.append(bank.truth[own])
    every = np.concatenate(slots)
    room = ((0, 0), (0, records - every.shape[1]), (0, 0))
    return np.pad(every, room), np.concatenate(truth)


def train_ratio(
    problem: Problem,
    bank: RecordBank,
    settings: RatioSettings | None = None,
    training: RatioTraining | None = None,
) -> Any:
    """Train sbi's classifier (NRE-B) to tell records of a hypothesis from records of any.

    Parameters
    ----------
    problem : Problem
        Arm and rules of the bank.
    bank : RecordBank
        Episodes with their truth.
    settings : RatioSettings, optional
        Size of the network.
    training : RatioTraining, optional
        Settings of the training.

    Returns
    -------
    sbi.neural_nets.ratio_estimators.RatioEstimator
        The trained network.

    Raises
    ------
    MissingExtra
        Without the package `sbi`.
    """
    chosen, how = settings or RatioSettings(), training or RatioTraining()
    network = ratio_network(problem, chosen)
    import torch
    from sbi.inference import NRE_B
    from sbi.utils.tracking import TensorBoardTracker
    from torch.utils.tensorboard.writer import SummaryWriter

    torch.manual_seed(how.seed)
    slots, truth = episode_parts(bank, problem.layout.slots)
    codes = hypothesis_codes(len(problem.hypotheses))[truth]
    with (
        tempfile.TemporaryDirectory() as logs,  # the library's default is the working folder
        SummaryWriter(logs) as writer,
        warnings.catch_warnings(),
    ):
        # records that were not taken are constant, and nothing is scaled by a deviation
        warnings.filterwarnings("ignore", message="Data has constant values")
        warnings.filterwarnings("ignore", message="Maximum number of epochs")
        inference = NRE_B(
            classifier=lambda theta, x: network,
            tracker=TensorBoardTracker(writer),
            show_progress_bars=False,
        )
        inference.append_simulations(torch.from_numpy(codes), torch.from_numpy(slots))
        return inference.train(
            num_atoms=len(problem.hypotheses),
            training_batch_size=how.batch,
            learning_rate=how.learning_rate,
            max_num_epochs=how.epochs,
            stop_after_epochs=how.patience,
        )
