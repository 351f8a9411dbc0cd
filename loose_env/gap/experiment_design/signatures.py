"""Signatures on one motion: change of its readings by every candidate at every size, stored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.experiment_design.library import check_motion
from loose_env.gap.experiment_design.motions import Motion
from loose_env.gap.experiment_design.servo_arm import ServoArm
from loose_env.gap.experiment_design.sizing import STEP, SizedRays, nuisance_columns, residuals
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.io import written_beside
from loose_env.typing import Array


@dataclass(frozen=True, eq=False)
class MotionSignatures:
    """Signatures on one motion, in its own directions.

    V base vectors: the nominal parameters, the points of all rays, their shape derivatives.
    """

    basis: NDArray[np.float32]
    """Orthonormal directions (n C, K)."""
    nominal: NDArray[np.float32]
    """Readings of the nominal model (n, C) [rad, m, N·m, N]."""
    vectors: NDArray[np.float32]
    """Base vectors (K, V)."""
    outside: float
    """Largest length of a base vector beyond the directions [noise standard deviations]."""
    seconds: float
    """Machine time [s]."""
    wear: float
    """Integral of the squared torque shares [s]."""

    def projected(self, readings: Array, noise: Array) -> tuple[Array, float]:
        """Residual of readings (n, C): its coordinates (K,) and the rms of the rest."""
        residual = ((readings - self.nominal) / noise).ravel()
        inside = self.basis.T @ residual
        rest = float(residual @ residual - inside @ inside)
        return np.asarray(inside), float(np.sqrt(max(rest, 0.0) / max(len(residual), 1)))

    def write(self, path: Path) -> None:
        """Write them to an .npz file."""
        arrays = {name: np.asarray(value) for name, value in vars(self).items()}

        def stored(beside: Path) -> None:
            with beside.open("wb") as out:
                np.savez(out, **arrays)  # type: ignore[arg-type]

        written_beside(path, stored)

    @classmethod
    def read(cls, path: Path) -> MotionSignatures | None:
        """Stored ones; None where there are none, or none that can be read."""
        try:
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as stored:
                arrays = [stored[name] for name in ("basis", "nominal", "vectors")]
                return cls(*arrays, *(float(stored[k]) for k in ("outside", "seconds", "wear")))
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None


def motion_signatures(
    arm: ServoArm, motion: Motion, sized: SizedRays, rank: int
) -> MotionSignatures:
    """Simulate a motion with every candidate at every size, and project its signatures."""
    checked, commands = check_motion(motion, arm), motion.commands(arm)
    rays, sizes = sized.rays, sized.sizes
    base = residuals(arm, commands, [Hypothesis()])[0]
    columns: list[NDArray[np.floating[Any]]] = [nuisance_columns(arm, commands, base)]
    points = [
        ray.hypothesis(ray.values(float(size)))
        for ray, own in zip(rays, sizes, strict=True)
        for size in own
    ]
    moved = np.array(residuals(arm, commands, points), dtype=np.float32)
    shaped, origins, begun = [], [], 0
    for ray, own in zip(rays, sizes, strict=True):
        middle = len(own) // 2
        for which in range(len(ray.shape_parameters)):
            off = np.zeros(len(ray.shape_parameters))
            off[which] = STEP
            shaped.append(ray.hypothesis(ray.values(float(own[middle]), off)))
            origins.append(begun + middle)
        begun += len(own)
    columns.append((moved - base).T)
    if shaped:
        there = np.array(residuals(arm, commands, shaped), dtype=np.float32)
        columns.append(((there - moved[origins]) / STEP).T)
    vectors = np.nan_to_num(np.concatenate(columns, axis=1)).astype(np.float32)
    vectors = np.clip(vectors, -1e5, 1e5)
    basis = _basis(vectors, rank)
    inside = basis.T @ vectors
    outside = np.sqrt(np.maximum(np.sum(vectors**2, axis=0) - np.sum(inside**2, axis=0), 0.0))
    nominal = (base.reshape(-1, len(arm.channels)) * arm.noise).astype(np.float32)
    return MotionSignatures(
        basis, nominal, inside.astype(np.float32), float(outside.max()), checked.seconds,
        checked.wear,
    )  # fmt: skip


def _basis(vectors: NDArray[np.float32], rank: int) -> NDArray[np.float32]:
    """Orthonormal directions of base vectors, the large ones bounded in weight (N, K).

    A randomised range finder with one power iteration (Halko, Martinsson and Tropp, SIAM Review 53,
    2011, 217).
    """
    lengths = np.linalg.norm(vectors, axis=0)
    weighted = vectors / np.sqrt(np.maximum(lengths, 1.0))
    rng = np.random.default_rng(0)
    count = min(rank + 20, weighted.shape[0], weighted.shape[1])
    first = weighted @ rng.normal(size=(weighted.shape[1], count)).astype(np.float32)
    rough = np.linalg.qr(weighted @ (weighted.T @ np.linalg.qr(first)[0]))[0]
    left, _, _ = np.linalg.svd(rough.T @ weighted, full_matrices=False)
    return np.asarray((rough @ left)[:, :rank], dtype=np.float32)
