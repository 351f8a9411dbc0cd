"""Learned choice of records: calibrated probabilities, and what each record will leave of doubt.

Two small networks look at the analytic posterior and at the arm's geometry. One corrects the
posterior's probabilities; the other foretells, for every record that could be taken next, the
entropy of the corrected probabilities after it. Both learn from simulated arms, whose fault is
known (`loose_agents.rl.foresight_training`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from loose_agents.base import Problem
from loose_agents.rl.model_files import one_line
from loose_agents.stored import tuning_name, weights_path
from loose_env.arms import ArmGeometry
from loose_env.errors import InvalidData
from loose_env.io import write_bytes, write_text
from loose_env.typing import Array, IndexArray

FORMAT, FILE = "loose-foresight/1", "foresight.safetensors"
WIDTH, DROPOUT = 128, 0.1
"""Units of the two hidden layers; share of them that is left out while it learns."""
CUT = 5.0
"""Standardised numbers are cut off here."""
_LEAST, _SMALL = 1e-6, 1e-3
"""Least probability in logarithms; added to lengths that divide."""

Numbers = NDArray[Any]


class Views:
    """Numbers that the networks see of posteriors: with an arm's pose, and with a record, too.

    A posterior is the probabilities of the hypotheses (M, H) and what `Tracker.features` tells of
    it (M, features).
    """

    def __init__(self, problem: Problem) -> None:
        self.arm, self.kinds = problem.arm, len(problem.hypotheses)
        d, n = len(problem.arm.axes), problem.arm.n
        self._upper, self._pairs = np.triu_indices(d), np.triu_indices(n, 1)
        self._slides = np.flatnonzero(problem.arm.sliding)

    def of_poses(self, p: Numbers, shown: Numbers, at: ArmGeometry) -> tuple[Numbers, Numbers]:
        """What M posteriors say of M poses (M, numbers), and the links' sliding directions.

        These are the mean products of their components in the base's axes, times the root of the
        probability that the link is loose (M, n, 3, 3).
        """
        n, d, count = self.arm.n, len(self.arm.axes), self.arm.n * len(self._upper[0])
        products = np.zeros((len(p), n, d, d), dtype=np.float32)
        given = shown[:, :count].reshape(len(p), n, -1)
        products[:, :, *self._upper] = products[:, :, *self._upper[::-1]] = given
        slides = at.slides.astype(np.float32)
        turned = slides @ products @ slides.mT
        root = np.sqrt(np.trace(turned, axis1=2, axis2=3)) + np.float32(_SMALL)
        turned /= root[..., None, None]
        flat = turned.reshape(len(p), n, 9)
        # What lies alike in a pose is not told apart there.
        alike = (flat @ flat.mT)[:, *self._pairs]
        most = -np.sort(-p, axis=1)[:, : min(3, self.kinds)]
        parts = [p, np.log(np.maximum(p, _LEAST)) / 7.0, most, entropy_of(p)[:, None]]
        parts += [np.log(np.maximum(1 - most[:, :1], _LEAST)), shown[:, count:], root, alike]
        parts += [turned[..., *np.triu_indices(3)], at.places / self.arm.reach, slides[..., 0]]
        return _joined(parts), turned

    def of_records(
        self, turned: Numbers, at: ArmGeometry, rows: IndexArray, joints: IndexArray
    ) -> Numbers:
        """What M records show by exciting a joint each in the poses of some rows (M, numbers).

        Sliding directions along the tool's motion and along the force on each seat, by the joint's
        motion while all others are held. What lies beyond a seat is taken to weigh in the middle
        between it and the tool, as much as there are links.
        """
        n, reach, which = self.arm.n, self.arm.reach, np.arange(len(rows))
        places, axis = at.places[rows].astype(np.float32), at.axes[rows, joints].astype(np.float32)
        motion = at.motion[rows, joints].astype(np.float32)
        size = np.linalg.norm(motion, axis=1, keepdims=True)
        along = motion / (size + np.float32(_SMALL))
        frame = np.stack([along, np.cross(axis, along), axis], axis=1)
        beyond = np.maximum(np.arange(n), joints[:, None])
        lever = places[which[:, None], beyond] / 2 - places[which, joints][:, None]
        slides = np.isin(joints, self._slides)[:, None, None]
        push = np.where(slides, axis[:, None], np.cross(axis[:, None], lever))
        strength = np.linalg.norm(push, axis=2)
        push /= strength[..., None] + np.float32(_SMALL)
        own, back = turned[rows], frame.mT
        half = (frame @ own.swapaxes(1, 2).reshape(-1, 3, 3 * n)).reshape(-1, 3 * n, 3) @ back
        seen = half.reshape(-1, 3, n, 3).swapaxes(1, 2)[..., *np.triu_indices(3)]
        pushed = np.einsum("mipq,miq->mip", own, push)
        parts = [seen, pushed @ back, (pushed * push).sum(-1), push @ back, places @ back / reach]
        parts += [strength / (size + np.float32(_SMALL)) * (n - beyond) / n, size / reach]
        return _joined([*parts, motion / reach, axis, np.eye(n)[joints]])


def _joined(parts: Sequence[NDArray[Any]]) -> Numbers:
    """Arrays (M, ...) as rows of numbers (M, numbers)."""
    return np.concatenate([part.reshape(len(part), -1).astype(np.float32) for part in parts], 1)


def entropy_of(p: Numbers) -> Array:
    """Entropy of probabilities (..., H) [nat]."""
    return np.asarray(-(p * np.log(np.maximum(p, 1e-12))).sum(-1))


class Standardised(nn.Module):
    """Layers on standardised numbers."""

    mean: Tensor
    gain: Tensor

    def __init__(self, seen: int, out: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(seen))
        self.register_buffer("gain", torch.ones(seen))
        self.layers = nn.Sequential(
            *(nn.Linear(seen, WIDTH), nn.ReLU(), nn.Dropout(DROPOUT)),
            *(nn.Linear(WIDTH, WIDTH), nn.ReLU(), nn.Dropout(DROPOUT)),
            nn.Linear(WIDTH, out),
        )

    def forward(self, numbers: Tensor) -> Tensor:
        """Answers (M, out) to numbers (M, seen)."""
        found: Tensor = self.layers(((numbers - self.mean) * self.gain).clamp(-CUT, CUT))
        return found

    def of_parts(self, first: Tensor, second: Tensor, times: int) -> Tensor:
        """The same, where each row of the first numbers goes with so many of the second."""
        cut, layer = first.shape[1], cast(nn.Linear, self.layers[0])
        parts = ((first, slice(None, cut)), (second, slice(cut, None)))
        one, two = (
            ((given - self.mean[own]) * self.gain[own]).clamp(-CUT, CUT) @ layer.weight[:, own].T
            for given, own in parts
        )
        hidden = (two.reshape(len(one), times, -1) + (one + layer.bias)[:, None]).flatten(0, 1)
        found: Tensor = self.layers[1:](hidden)
        return found


class Foresight(nn.Module):
    """Both networks: corrections of the log-probabilities, and the entropy after a record."""

    def __init__(self, problem: Problem) -> None:
        super().__init__()
        self.problem, self.views = problem, Views(problem)
        at = problem.linear.geometry(np.zeros((1, problem.arm.n)))
        count = problem.arm.n * (len(problem.arm.axes) * (len(problem.arm.axes) + 1) // 2 + 2)
        kinds, none = len(problem.hypotheses), np.zeros(1, dtype=np.intp)
        pose, turned = self.views.of_poses(np.ones((1, kinds)) / kinds, np.zeros((1, count)), at)
        record = self.views.of_records(turned, at, none, none)
        self.correction = Standardised(pose.shape[1], kinds)
        self.after = Standardised(pose.shape[1] + record.shape[1], 1)
        self.eval()

    def corrected(self, p: Numbers, shown: Numbers, at: ArmGeometry) -> Array:
        """Probabilities (M, H) that came true as often as they say, from the posterior's."""
        with torch.inference_mode():
            seen = torch.from_numpy(self.views.of_poses(p, shown, at)[0])
            logits = np.log(np.maximum(p, _LEAST)) + self.correction(seen).numpy()
        found = np.exp(logits - logits.max(axis=1, keepdims=True))
        return np.asarray(found / found.sum(axis=1, keepdims=True))

    def entropies(self, p: Numbers, shown: Numbers, at: ArmGeometry) -> Array:
        """Entropy after a record in each of M poses by each joint alone [nat] (M, n)."""
        n, count = self.problem.arm.n, len(p)
        pose, turned = self.views.of_poses(p, shown, at)
        rows, joints = np.repeat(np.arange(count), n), np.tile(np.arange(n), count)
        record = self.views.of_records(turned, at, rows, joints)
        with torch.inference_mode():
            found = self.after.of_parts(torch.from_numpy(pose), torch.from_numpy(record), n)
        return np.asarray(found.reshape(count, n), dtype=float)

    def save(self, folder: Path, described: dict[str, Any]) -> None:
        """Write the weights atomically, and beside them how they were trained."""
        from safetensors.torch import save

        tensors = {name: value.contiguous() for name, value in self.state_dict().items()}
        write_bytes(folder / FILE, save(tensors, metadata={"format": FORMAT}))
        write_text(folder / "configuration.json", json.dumps(described, indent=1) + "\n")

    @classmethod
    def load(cls, problem: Problem, folder: Path | None = None) -> Foresight:
        """Read the weights of a task, by default those that ship.

        Raises
        ------
        InvalidData
            If there are none, or they are of another task.
        """
        from safetensors import SafetensorError, safe_open

        path = (folder_of(problem) if folder is None else folder) / FILE
        again = "train them with scripts/agents/train_foresight.py"
        if not path.is_file():
            raise InvalidData(f"no learned choice of records for this task at {path}; {again}")
        try:
            with safe_open(str(path), framework="pt") as file:
                tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
                if (file.metadata() or {}).get("format") != FORMAT:
                    raise RuntimeError(f"their format is not {FORMAT!r}")
            found = cls(problem)
            found.load_state_dict(tensors)
        except (SafetensorError, RuntimeError) as error:
            raise InvalidData(
                f"{path} holds no weights of this task: {one_line(error)}; {again}"
            ) from error
        return found


def folder_of(problem: Problem) -> Path:
    """Folder of the weights of a task."""
    return weights_path(f"foresight-{tuning_name(problem)}")
