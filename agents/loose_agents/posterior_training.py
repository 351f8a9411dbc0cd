"""Training of the learned posterior on a bank: likelihood, novelty reference.

The loss is the log score of the hypotheses after each record, and beside it, in small part, of
direction and friction where the truth is loose: the sums over them stay meaningful, and policies
may read them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from torch import Tensor, nn

from loose_agents.base import Problem
from loose_agents.jobs import ProgressLine
from loose_agents.record_bank import RecordBank, RecordFeatures
from loose_env.diagnosis import (
    NOVELTY_STATISTICS,
    REFERENCE,
    AmortisedBelief,
    NoveltyReference,
    SeatFeatures,
    SeatNetwork,
    Seen,
    seen_in,
    used_columns,
)
from loose_env.errors import InvalidData
from loose_env.evaluation import expected_calibration_error
from loose_env.io import written_beside
from loose_env.statistics import fit_gaussian_mixture
from loose_env.typing import Array
from loose_env.wrappers import records_from


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """Architecture and optimisation settings of the training."""

    hidden: int = 48
    """Hidden units."""
    frictions: int = 6
    """Nodes of friction."""
    steps: int = 6000
    """Steps of the optimiser."""
    batch: int = 64
    """Episodes a step."""
    learning_rate: float = 2e-3
    """Highest learning rate; it rises over 100 steps and falls as a cosine."""
    further: float = 0.1
    """Weight of the log score of direction and friction."""
    seed: int = 1
    """Seed of the first weights and of the order of episodes."""
    checkpoint: int = 250
    """Steps between two checkpoints."""


class _Layers(nn.Module):
    """Trainable form of `SeatNetwork`."""

    def __init__(
        self, features: RecordFeatures, settings: TrainingSettings, hypotheses: int
    ) -> None:
        super().__init__()
        c, q, w = features.place.shape[-1], features.record.shape[-1], settings.hidden
        rng = np.random.default_rng(0)
        some = rng.choice(len(features.place), min(3000, len(features.place)), replace=False)
        rows = features.place[some].astype(np.float32).reshape(-1, c)
        self.register_buffer("place_mean", torch.from_numpy(rows.mean(0)))
        self.register_buffer("place_scale", torch.from_numpy(rows.std(0) + 1e-3))
        self.register_buffer("record_mean", torch.from_numpy(features.record.mean(0)))
        self.register_buffer("record_scale", torch.from_numpy(features.record.std(0) + 1e-3))
        self.place, self.record_in = nn.Linear(c, w), nn.Linear(q, w)
        self.record_out, self.hidden = nn.Linear(w, w), nn.Linear(w, w)
        self.hypothesis = nn.Linear(hypotheses, w, bias=False)
        self.out = nn.Linear(w, settings.frictions)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        self.temper = nn.Parameter(torch.zeros(12))

    def forward(self, place: Tensor, record: Tensor, one_hot: Tensor) -> Tensor:
        """Likelihood (N, P, F)."""
        x = (place.float() - self.place_mean) / self.place_scale  # type: ignore[operator]
        r = (record - self.record_mean) / self.record_scale  # type: ignore[operator]
        whole = self.record_out(nn.functional.silu(self.record_in(r)))
        y = self.place(x) + self.hypothesis(one_hot) + whole[:, None]
        found: Tensor = self.out(nn.functional.silu(self.hidden(nn.functional.silu(y))))
        return found


class PosteriorTraining:
    """Training state: data, network and optimiser; resumes from a checkpoint."""

    def __init__(
        self,
        features: RecordFeatures,
        *,
        joints: int,
        directions: NDArray[np.float64],
        friction: tuple[float, float],
        settings: TrainingSettings | None = None,
    ) -> None:
        self.settings = s = TrainingSettings() if settings is None else settings
        torch.manual_seed(s.seed)
        self.features, self.n = features, joints
        self.directions = torch.from_numpy(directions.astype(np.float32))
        count = len(directions)
        hypothesis = np.concatenate(
            [np.repeat(np.arange(joints), count), joints + np.arange(joints)]
        )
        self.one_hot = nn.functional.one_hot(torch.from_numpy(hypothesis), 2 * joints).float()
        self.layers = _Layers(features, s, 2 * joints)
        self.optimiser = torch.optim.AdamW(self.layers.parameters(), weight_decay=1e-4)
        self.step = 0
        third = np.log(1 / 3)
        each = third - np.log(joints)
        self.prior = torch.tensor([third] + [each] * (2 * joints), dtype=torch.float32)
        # An arm in space has a finer grid for its size: neighbours share the truth.
        axes = directions.shape[1]
        self.spread = 1.2 * np.pi / count if axes == 2 else np.sqrt(2 * np.pi / count) / 2
        with np.errstate(divide="ignore"):
            level = np.log(1 / features.ratio / friction[0]) / np.log(friction[1] / friction[0])
        node = np.floor(np.nan_to_num(level, neginf=0.0, posinf=0.0) * s.frictions)
        self.node = torch.from_numpy(np.clip(node, 0, s.frictions - 1).astype(np.int64))

    def posterior(
        self, features: RecordFeatures, rows: NDArray[np.intp], records: int
    ) -> tuple[Tensor, Tensor]:
        """Log-probabilities (B, R, H) and log-weights (B, R, P, F)."""
        place, record = torch.from_numpy(features.place[rows]), features.record[rows]
        each = self.layers(place, torch.from_numpy(record), self.one_hot)
        total = each.reshape(-1, records, *each.shape[1:]).cumsum(1)
        return self._log_probabilities(total, self.layers.temper[:records])

    def _log_probabilities(self, total: Tensor, temper: Tensor) -> tuple[Tensor, Tensor]:
        """Log-probabilities (B, R, H) and tempered log-weights, from sums over records."""
        total = total * torch.exp(temper)[None, :, None, None] - np.log(self.settings.frictions)
        by_place = torch.logsumexp(total, -1)
        slides = self.n * len(self.directions)
        by_link = by_place[..., :slides].unflatten(-1, (self.n, len(self.directions)))  # type: ignore[no-untyped-call]
        slide = torch.logsumexp(by_link, -1) - np.log(len(self.directions))
        healthy = torch.zeros_like(slide[..., :1])
        log = torch.cat([healthy, slide, by_place[..., slides:]], -1) + self.prior
        return torch.log_softmax(log, -1), total

    def train(
        self,
        folder: Path | None = None,
        report: Callable[[int, float], None] | None = None,
        *,
        stream: TextIO | None = None,
    ) -> None:
        """Train to the last step, writing checkpoints and resuming from an existing one."""
        s = self.settings
        checkpoint = None if folder is None else folder / "checkpoint.pt"
        if checkpoint is not None and checkpoint.is_file():
            self._restore(checkpoint)
        counts = np.unique(self.features.count[self.features.count > 0])
        groups = [np.flatnonzero(self.features.count == c) for c in counts]
        # Lengths take turns by how many records they hold.
        shares = np.array([len(g) * c for g, c in zip(groups, counts, strict=True)], dtype=float)
        with ProgressLine(s.steps, done=self.step, unit="steps", stream=stream) as line:
            while self.step < s.steps:
                rng = np.random.default_rng([s.seed, self.step])
                which = int(rng.choice(len(groups), p=shares / shares.sum()))
                records = int(counts[which])
                size = max(8, s.batch * int(counts.min()) // records)
                loss = self._loss(rng.choice(groups[which], size), records, rng)
                for group in self.optimiser.param_groups:
                    group["lr"] = self._rate()
                self.optimiser.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                nn.utils.clip_grad_norm_(self.layers.parameters(), 1.0)
                self.optimiser.step()
                self.step += 1
                score = float(loss.detach())
                line.advance(1, f"loss {score:.3f}")
                if self.step % s.checkpoint == 0 or self.step == s.steps:
                    if checkpoint is not None:
                        self._keep(checkpoint)
                    if report is not None:
                        report(self.step, score)

    def _rate(self) -> float:
        s = self.settings
        fall = 0.5 * (1 + np.cos(np.pi * self.step / s.steps))
        return float(s.learning_rate * min(1.0, (self.step + 1) / 100) * fall + 1e-5)

    def _loss(self, episodes: NDArray[np.intp], records: int, rng: np.random.Generator) -> Tensor:
        rows = self.features.rows(episodes, records).reshape(-1, records)
        # The records of an episode have no order.
        rows = rng.permuted(rows, axis=1).ravel()  # type: ignore[assignment]
        log, total = self.posterior(self.features, rows, records)
        truth = torch.from_numpy(self.features.truth[episodes])
        score = -log.gather(-1, truth[:, None, None].expand(-1, records, 1)).mean()
        return score + self.settings.further * self._further(episodes, truth, total)

    def _further(self, episodes: NDArray[np.intp], truth: Tensor, total: Tensor) -> Tensor:
        """Log score of direction and friction, conditional on the true hypothesis."""
        n, count = self.n, len(self.directions)
        node = self.node[torch.from_numpy(episodes)]
        loss = torch.zeros(())
        slides = torch.nonzero((truth >= 1) & (truth <= n)).ravel()
        if len(slides):
            true = torch.from_numpy(self.features.direction[episodes])[slides]
            cosine = (true[:, : self.directions.shape[1]] @ self.directions.T).abs().clamp(max=1)
            near = torch.softmax(-((torch.arccos(cosine) / self.spread) ** 2) / 2, -1)
            own = total[:, :, : n * count].unflatten(2, (n, count))[slides, :, truth[slides] - 1]  # type: ignore[no-untyped-call]
            log = torch.log_softmax(own.flatten(-2), -1).reshape(own.shape)
            log = log[torch.arange(len(slides)), :, :, node[slides]]
            loss = loss - (near[:, None] * log).sum(-1).mean() * len(slides) / len(truth)
        plays = torch.nonzero(truth > n).ravel()
        if len(plays):
            own = torch.log_softmax(total[:, :, n * count :], -1)[plays, :, truth[plays] - 1 - n]
            log = own[torch.arange(len(plays)), :, node[plays]]
            loss = loss - log.mean() * len(plays) / len(truth)
        return loss

    def calibrate(self, features: RecordFeatures) -> None:
        """Fit the temperatures that maximise the log score on held-out episodes.

        One factor for each of the first four numbers of records, one for all above, where
        held-out episodes are few. Training leaves the posterior a little less sure than it may be.
        """
        for first, last in ((1, 1), (2, 2), (3, 3), (4, 4), (5, len(self.layers.temper))):
            chosen = np.flatnonzero(features.count >= last)
            if len(chosen) >= 50:
                self._calibrate(features, chosen, first, last)

    def _calibrate(
        self, features: RecordFeatures, chosen: NDArray[np.intp], first: int, last: int
    ) -> None:
        truth = torch.from_numpy(features.truth[chosen])[:, None, None]
        with torch.no_grad():
            temper = self.layers.temper[:last].clone()
            parts = []
            for some in (chosen[i : i + 50] for i in range(0, len(chosen), 50)):
                _, tempered = self.posterior(features, features.rows(some, last), last)
                parts.append(tempered[:, first - 1 :])
            tempered = torch.cat(parts) + np.log(self.settings.frictions)
            total = tempered / torch.exp(temper[first - 1 :])[None, :, None, None]

            def score(change: float) -> float:
                log, _ = self._log_probabilities(total, temper[first - 1 :] + change)
                return -float(log.gather(-1, truth.expand(-1, log.shape[1], 1)).mean())

            best = minimize_scalar(
                score, bounds=(-0.7, 0.7), method="bounded", options={"xatol": 0.02}
            )
            self.layers.temper[first - 1 : last] += float(best.x)

    def scores(self, features: RecordFeatures, *, most: int = 4) -> list[dict[str, float]]:
        """Scores on held-out episodes by number of records."""
        chosen = np.flatnonzero(features.count >= most)
        parts = [features.rows(chosen[i : i + 50], most) for i in range(0, len(chosen), 50)]
        with torch.no_grad():
            log = torch.cat([self.posterior(features, rows, most)[0] for rows in parts])
        truth = features.truth[chosen]
        found = []
        for k in range(most):
            each = log[:, k].numpy()
            right = each.argmax(1) == truth
            found.append(
                {
                    "records": k + 1,
                    "episodes": len(chosen),
                    "success": float(right.mean()),
                    "score": float(each[np.arange(len(truth)), truth].mean()),
                    "ece": expected_calibration_error(np.exp(each.max(1)), right, bins=10),
                }
            )
        return found

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Return all tensors of `SeatNetwork`."""
        state = self.layers.state_dict()
        return {name: state[name].cpu().numpy().copy() for name in SeatNetwork.shapes}

    def _keep(self, path: Path) -> None:
        kept = {
            "layers": self.layers.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.step,
        }
        written_beside(path, lambda beside: torch.save(kept, beside))

    def _restore(self, path: Path) -> None:
        try:
            kept = torch.load(path, weights_only=True)  # tensors and plain values, never code
            self.layers.load_state_dict(kept["layers"])
            self.optimiser.load_state_dict(kept["optimiser"])
            self.step = int(kept["step"])
        except Exception as error:  # torch and zipfile raise a dozen kinds
            reason = " ".join(str(error).split())[:200]
            raise InvalidData(
                f"cannot go on from {path}; remove it to begin anew: {type(error).__name__}: "
                f"{reason}"
            ) from error


_RARE = 0.99  # what one episode in a hundred exceeds
_EVEN = 1e-3  # spread of scores that are all alike


@dataclass(frozen=True, kw_only=True)
class NoveltySettings:
    """Settings of the reference fit."""

    components: int = 12
    """Gaussians of each mixture."""
    fitted: int = 2000
    """Episodes that the mixtures are fitted to, at most."""
    points: int = 15_000
    """Records of theirs, each counted anew after every further record, at most."""
    ranked: int = 2500
    """Held-out episodes in the table of scores, at most."""
    tables: int = 5
    """Tables of scores: after 1, 2, ... records; the last is for so many or more."""
    regularisation: float = 1e-3
    """Added to the variances of scaled features."""
    seed: int = 1
    """Seed of the mixtures' start, and of which records they are fitted to."""


def seen_episodes(
    problem: Problem, features: SeatFeatures, bank: RecordBank
) -> Iterator[list[Seen]]:
    """Iterate over the episodes of a bank that have records, with their statistics."""
    for slots in bank.slots:
        shown = slots[slots[:, 0] > 0.5]
        if len(shown):
            yield seen_in(features, records_from(problem.layout, shown))


def episode_sights(
    network: SeatNetwork,
    seen: Sequence[Seen],
    *,
    directions: Array,
    prior: Array,
    counts: Sequence[int],
) -> list[Array]:
    """Novelty statistics of an episode after a number of records."""
    n = (len(prior) - 1) // 2
    hypothesis = np.concatenate([np.repeat(np.arange(n), len(directions)), n + np.arange(n)])
    total = np.cumsum([network.likelihood(s.location, s.record, hypothesis) for s in seen], axis=0)
    return [
        AmortisedBelief(
            total=total[records - 1],
            records=records,
            temper=network.temper(records),
            prior=prior,
            directions=directions,
            hypothesis=hypothesis,
            seen=tuple(seen[:records]),
        ).sights
        for records in counts
    ]


def fit_reference(
    tensors: Mapping[str, NDArray[Any]],
    trained: Iterable[Sequence[Seen]],
    held: Iterable[Sequence[Seen]],
    *,
    directions: Array,
    settings: NoveltySettings | None = None,
) -> NoveltyReference:
    """Fit the mixtures and rank the held-out episodes."""
    s = NoveltySettings() if settings is None else settings
    network = SeatNetwork(tensors)
    n = network.sizes["H"] // 2
    third = np.log(1 / 3)
    prior = np.concatenate([[third], np.full(2 * n, third - np.log(n))])

    def sights_of(episodes: Iterable[Sequence[Seen]], most: int) -> list[list[Array]]:
        """Novelty statistics of each episode, by number of records."""
        found: list[list[Array]] = [[] for _ in range(s.tables)]
        for _, seen in zip(range(most), episodes, strict=False):
            counts = range(1, len(seen) + 1)
            for columns in episode_sights(
                network, seen, directions=directions, prior=prior, counts=counts
            ):
                found[min(len(columns), s.tables) - 1].append(columns)
        return [each for each in found if each]

    fitted, ranked = sights_of(trained, s.fitted), sights_of(held, s.ranked)
    if not fitted or not ranked:
        raise InvalidData("no episode has a record: nothing to fit to, or to rank new ones among")
    tables = min(len(fitted), len(ranked))
    points = np.concatenate([columns for each in fitted for columns in each])
    mean, scale = points.mean(0), points.std(0) + 1e-6
    rng = np.random.default_rng(s.seed)
    scaled = (points[rng.permutation(len(points))[: s.points]] - mean) / scale
    mixtures = tuple(
        fit_gaussian_mixture(
            scaled[:, used_columns(name)], s.components, rng, regularisation=s.regularisation
        )
        for name in NOVELTY_STATISTICS
    )
    level = np.zeros((tables, len(NOVELTY_STATISTICS)))
    plain = NoveltyReference(
        mean=mean,
        scale=scale,
        mixtures=mixtures,
        usual=level,
        spread=level + 1.0,
        scores=tuple(np.zeros(1) for _ in range(tables)),
    )
    usual, spread = level.copy(), level.copy()
    for k, episodes in enumerate(fitted[:tables]):
        means = np.stack([plain.novelty(columns).mean(0) for columns in episodes])
        usual[k] = np.median(means, axis=0)
        spread[k] = np.maximum(np.quantile(means, _RARE, axis=0) - usual[k], _EVEN)
    # Ranked is what will be read again, not what was rounded when it was stored.
    read = NoveltyReference.of(_rounded(replace(plain, usual=usual, spread=spread)))
    scores = tuple(
        np.sort([read.score(read.novelty(columns)) for columns in episodes])
        for episodes in ranked[:tables]
    )
    return replace(read, scores=tuple(each.astype(np.float32).astype(float) for each in scores))


def with_reference(
    tensors: Mapping[str, NDArray[Any]], reference: NoveltyReference
) -> dict[str, NDArray[Any]]:
    """Store a reference beside a network's tensors, replacing an existing one."""
    kept = {name: values for name, values in tensors.items() if not name.startswith(REFERENCE)}
    return kept | {REFERENCE + name: values for name, values in _rounded(reference).items()}


def _rounded(reference: NoveltyReference) -> dict[str, NDArray[np.float32]]:
    return {name: values.astype(np.float32) for name, values in reference.tensors().items()}
