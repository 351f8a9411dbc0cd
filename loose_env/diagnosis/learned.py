"""Posterior over faults with a learned likelihood; its network read from and written to files.

It keeps the shape of `loose_env.diagnosis.posterior`: log-weights over locations (slide
directions of every link, plays of every joint) and nodes of friction, summed over records, with
direction and friction summed out for the hypotheses. Only what one record says is learned, from
simulated arms whose gap, friction, direction and mismatch are drawn as the environment draws
them. Mismatch, which all records of an arm share, enters as a temper by the number of records.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray
from scipy.special import expit, logsumexp

from loose_env.arms import Arm, LinearArm, Mismatch
from loose_env.diagnosis.features import LOCATION_FEATURES, RECORD_FEATURES, SeatFeatures
from loose_env.diagnosis.novelty import NOVELTY_STATISTICS, NoveltyReference, Seen, sights
from loose_env.diagnosis.posterior import Belief, alike, friction_nodes, location_prior, log_prior
from loose_env.diagnosis.prediction import RecordStatistics
from loose_env.errors import InvalidData
from loose_env.faults import KINDS, hypotheses
from loose_env.io import restored, whole_of, write_text, written_beside
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

_SHAPES: dict[str, tuple[str, ...]] = {
    "place_mean": ("C",),
    "place_scale": ("C",),
    "record_mean": ("Q",),
    "record_scale": ("Q",),
    "place.weight": ("W", "C"),
    "place.bias": ("W",),
    "record_in.weight": ("W", "Q"),
    "record_in.bias": ("W",),
    "record_out.weight": ("W", "W"),
    "record_out.bias": ("W",),
    "hypothesis.weight": ("W", "H"),
    "hidden.weight": ("W", "W"),
    "hidden.bias": ("W",),
    "out.weight": ("F", "W"),
    "out.bias": ("F",),
    "temper": ("R",),
}


class SeatNetwork:
    """The pass of a trained network.

    Parameters
    ----------
    tensors : mapping of str to ndarray
        Weights and scales, named and shaped as `SeatNetwork.shapes` says: C features of a location,
        Q of a record, W hidden units, H hypotheses with a fault, F nodes of friction, R numbers
        of records that have a temper of their own.

    Raises
    ------
    InvalidData
        If a tensor is missing, its shape does not fit the others, or it is not finite.
    """

    shapes = _SHAPES
    """Names of the tensors and their shapes, in letters."""

    def __init__(self, tensors: Mapping[str, Array]) -> None:
        sizes: dict[str, int] = {}
        for name, letters in _SHAPES.items():
            if name not in tensors:
                raise InvalidData(f"the network has no tensor {name!r}; it needs {list(_SHAPES)}")
            shape = tensors[name].shape
            wanted = tuple(sizes.setdefault(x, n) for x, n in zip(letters, shape, strict=False))
            if len(shape) != len(letters) or shape != wanted:
                raise InvalidData(
                    f"tensor {name!r} of the network has shape {shape}, which does not fit "
                    f"{letters} with {sizes}"
                )
            if not np.isfinite(tensors[name]).all():
                raise InvalidData(
                    f"tensor {name!r} of the network holds values that are not finite; train it "
                    "again with scripts/agents/train_posterior.py"
                )
        self.sizes = sizes
        self.tensors = {name: np.asarray(tensors[name], dtype=np.float32) for name in _SHAPES}

    @property
    def frictions(self) -> int:
        """Number of nodes of friction."""
        return self.sizes["F"]

    def hidden(
        self, location: Array, record: Array, hypothesis: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """Last hidden layer (P, W) of locations (P, C), record (Q,) and hypothesis (P,)."""
        w = self.tensors
        x = (location.astype(np.float32) - w["place_mean"]) / w["place_scale"]
        r = (record.astype(np.float32) - w["record_mean"]) / w["record_scale"]
        whole = _silu(w["record_in.weight"] @ r + w["record_in.bias"])
        whole = w["record_out.weight"] @ whole + w["record_out.bias"]
        y = x @ w["place.weight"].T + w["place.bias"] + whole
        y += w["hypothesis.weight"].T[hypothesis]
        return _silu(_silu(y) @ w["hidden.weight"].T + w["hidden.bias"])

    def likelihood(
        self, location: Array, record: Array, hypothesis: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Log-likelihood ratio over a healthy arm, by location and friction (P, F)."""
        hidden = self.hidden(location, record, hypothesis)
        return (hidden @ self.tensors["out.weight"].T + self.tensors["out.bias"]).astype(float)

    def temper(self, records: int) -> float:
        """Exponent on the likelihood of so many records: those of one arm share its mismatch."""
        tempers = self.tensors["temper"]
        return float(np.exp(tempers[min(max(records, 1), len(tempers)) - 1]))


def _silu(x: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.asarray(x * expit(x), dtype=np.float32)


FORMAT = "loose-posterior/1"
"""Format of a stored network's configuration."""
REFERENCE = "reference."
"""Prefix of the names of the tensors of a `NoveltyReference`."""
CONFIGURATION, WEIGHTS = "configuration.json", "posterior.safetensors"
_TRAINER = "scripts/agents/train_posterior.py"


@dataclass(frozen=True, kw_only=True)
class _Configuration:
    """What a stored network was trained for."""

    arm: str
    levels: tuple[float, ...]
    gravity: tuple[float, float, float]
    durations: tuple[float, ...]
    directions: Annotated[int, Ge(1), Le(10_000)]
    friction: tuple[Annotated[float, Gt(0), Lt(1e6)], Annotated[float, Gt(0), Lt(1e6)]]


def trained_for(arm: Arm, durations: Sequence[float]) -> dict[str, Any]:
    """Arm and rules that the likelihood of a record depends on; a configuration holds them."""
    gravity = tuple(float(g) for g in arm.model.opt.gravity)
    own = {"arm": arm.name, "levels": arm.levels, "gravity": gravity}
    return own | {"durations": tuple(durations)}


def misfit(configuration: Mapping[str, Any], arm: Arm, durations: Sequence[float] = ()) -> str:
    """First difference between an arm under its rules and those of training; "" if none.

    Of the durations trained on, some may be left out.
    """
    trained = restored(_Configuration, configuration, f"{CONFIGURATION}:")
    for name, here in trained_for(arm, durations).items():
        there = getattr(trained, name)
        if not set(here) <= set(there) if name == "durations" else here != there:
            return f"{name} {there!r:.60}, not {here!r:.60}"
    return ""


@dataclass(frozen=True, kw_only=True, eq=False)
class AmortisedBelief:
    """Posterior after the records so far."""

    total: Array
    """Log-likelihood ratio over a healthy arm, by location and friction (P, F)."""
    records: int
    """Number of records taken in."""
    temper: float
    """Exponent on the likelihood at that number."""
    prior: Array
    """Log-probability of the hypotheses beforehand, the healthy one first (1 + 2 n,)."""
    directions: Array
    """Sliding directions in a link's frame (A, axes)."""
    hypothesis: NDArray[np.intp]
    """Hypothesis of each location (P,)."""
    seen: tuple[Seen, ...] = ()
    """Features of each record."""
    reference: NoveltyReference | None = None
    """Distribution on arms of the trained kind, if known."""

    @cached_property
    def belief(self) -> Belief:
        """The same as log-weights of everything in question."""
        loose = self.temper * self.total - np.log(self.total.shape[1])
        share = location_prior(self.prior, len(self.directions))
        return Belief(
            healthy=self.prior[:1],
            loose=(loose + share[:, None])[None],
            links=(len(self.prior) - 1) // 2,
            directions=self.directions,
        )

    @property
    def probabilities(self) -> Array:
        """Probability of each hypothesis: healthy, slides, plays (1 + 2 n,)."""
        return self.belief.probabilities

    @cached_property
    def sights(self) -> Array:
        """Statistics of the novelty test under the belief after all records (R, columns)."""
        log = np.asarray(logsumexp(self.belief.loose[0], axis=1))
        loose = float(logsumexp(log))
        return sights(self.seen, np.exp(log - loose), float(self.prior[0]) - loose, self.hypothesis)

    @cached_property
    def novelty(self) -> Array:
        """Excess of each statistic over its usual value, by record [1] (R, statistics).

        In standard deviations of a normal variable; empty without a reference or records.
        """
        if self.reference is None or not self.seen:
            return np.zeros((0, len(NOVELTY_STATISTICS)))
        return self.reference.novelty(self.sights)

    @property
    def surprise(self) -> float:
        """p-value of the episode among those of the trained kind; one where none are known."""
        return 1.0 if self.reference is None else self.reference.surprise(self.novelty)


_TOGETHER = 16
"""Records worked out at once: what the processor's cache holds."""


def seen_in(features: SeatFeatures, records: RecordStatistics) -> list[Seen]:
    """Features of each of B records."""
    found: dict[int, Seen] = {}
    for rows in alike(records, _TOGETHER):
        location, record, change = features.with_changes(records[rows])
        found |= {int(row): Seen(location[k], record[k], change[k]) for k, row in enumerate(rows)}
    return [found[row] for row in range(len(found))]


class AmortisedPosterior:
    """Bayes' rule over faults, with a learned likelihood.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    sensors : SensorSuite
        Figures of the sensors.
    mismatch : Mismatch
        Errors of the nominal model; as in training.
    network : SeatNetwork
        The trained network.
    directions : int
        Sliding directions of a link; as in training.
    friction : (float, float)
        Range of guide friction over the seat drive of the top level that the nodes divide [1].
    kinds : mapping of str to float, optional
        Prior probability of each kind of fault; a third each by default.
    reference : NoveltyReference, optional
        Distribution of records in training, for the novelty.

    Raises
    ------
    InvalidData
        If the network was made for another number of features or joints.
    """

    def __init__(
        self,
        linear: LinearArm,
        sensors: SensorSuite,
        mismatch: Mismatch,
        network: SeatNetwork,
        *,
        directions: int,
        friction: tuple[float, float] = (0.02, 1.0),
        kinds: Mapping[str, float] | None = None,
        reference: NoveltyReference | None = None,
    ) -> None:
        self.linear, self.network, self.friction = linear, network, friction
        self.hypotheses = hypotheses(linear.arm, everywhere=True)
        self.features = SeatFeatures(linear, sensors, mismatch, directions=directions)
        self.reference = reference
        wanted = (len(LOCATION_FEATURES), len(RECORD_FEATURES), 2 * linear.arm.n)
        sizes = tuple(network.sizes[x] for x in "CQH")
        if sizes != wanted:
            raise InvalidData(
                f"the network takes {sizes[0]} features of a location, {sizes[1]} of a record and "
                f"{sizes[2]} faults; arm {linear.arm.name!r} has {wanted}"
            )
        self._prior = log_prior(linear.arm, kinds or dict.fromkeys(KINDS, 1 / 3))

    def start(self) -> AmortisedBelief:
        """Return the prior."""
        return AmortisedBelief(
            total=np.zeros((self.features.locations, self.network.frictions)),
            records=0,
            temper=1.0,
            prior=self._prior,
            directions=self.features.directions,
            hypothesis=self.features.hypothesis,
            reference=self.reference,
        )

    def update(self, belief: AmortisedBelief, record: RecordStatistics) -> AmortisedBelief:
        """Take in one record; the order of records does not matter."""
        return self.update_all([belief], record.several)[0]

    def update_all(
        self, beliefs: Sequence[AmortisedBelief], records: RecordStatistics
    ) -> list[AmortisedBelief]:
        """Take one record each into B beliefs; they do not depend on each other."""
        seen = seen_in(self.features, records)
        return [self.with_seen(*pair) for pair in zip(beliefs, seen, strict=True)]

    def with_seen(self, belief: AmortisedBelief, seen: Seen) -> AmortisedBelief:
        """Take in the features of one record."""
        likelihood = self.network.likelihood(seen.location, seen.record, belief.hypothesis)
        return replace(
            belief,
            total=belief.total + likelihood,
            records=belief.records + 1,
            temper=self.network.temper(belief.records + 1),
            seen=(*belief.seen, seen),
        )

    @property
    def frictions(self) -> Array:
        """Nodes of friction over the seat drive of the top level [1] (F,)."""
        return friction_nodes(self.friction, self.network.frictions)

    @classmethod
    def load(
        cls,
        folder: str | Path,
        linear: LinearArm,
        sensors: SensorSuite,
        mismatch: Mismatch,
        *,
        kinds: Mapping[str, float] | None = None,
        durations: Sequence[float] = (),
    ) -> AmortisedPosterior:
        """Load a trained network; nothing is unpickled. InvalidData if none fits arm and rules."""
        whole, tensors = read_network(folder)
        configuration = restored(_Configuration, whole, f"{Path(folder) / CONFIGURATION}:")
        if unlike := misfit(whole, linear.arm, durations):
            raise InvalidData(
                f"the posterior in {folder} was trained for {unlike}; train one with {_TRAINER}, "
                "or take the analytic posterior"
            )
        start = len(REFERENCE)
        known = {k[start:]: v for k, v in tensors.items() if k.startswith(REFERENCE)}
        try:
            return cls(
                linear,
                sensors,
                mismatch,
                SeatNetwork(tensors),
                directions=configuration.directions,
                friction=configuration.friction,
                kinds=kinds,
                reference=NoveltyReference.of(known) if known else None,
            )
        except (InvalidData, KeyError, TypeError, ValueError, IndexError) as error:
            raise InvalidData(f"{Path(folder) / WEIGHTS}: {error}") from error


def read_network(folder: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read the configuration and the tensors that `write_network` wrote into a folder.

    Raises
    ------
    InvalidData
        If they are missing, broken or of another format.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    where = Path(folder)
    try:
        text = (where / CONFIGURATION).read_text(encoding="utf-8")
        tensors = load_file(str(where / WEIGHTS))
    except FileNotFoundError as error:
        raise InvalidData(
            f"no trained posterior in {where}: {CONFIGURATION} and {WEIGHTS} are needed; train one "
            f"with {_TRAINER}"
        ) from error
    except (ValueError, OSError, SafetensorError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InvalidData(f"the trained posterior in {where} cannot be read: {reason}") from error
    try:
        return whole_of(text, format=FORMAT, noun="trained posterior"), tensors
    except InvalidData as error:
        raise InvalidData(f"{where / CONFIGURATION}: {error}; train it with {_TRAINER}") from error


def write_network(
    folder: str | Path, configuration: Mapping[str, Any], tensors: Mapping[str, Any]
) -> None:
    """Write a network and its configuration, each beside first, then renamed."""
    from safetensors.numpy import save_file

    def write(beside: Path) -> None:
        save_file({k: np.ascontiguousarray(v) for k, v in tensors.items()}, str(beside))
        beside.chmod(0o644)  # safetensors leaves it to its owner alone

    where = Path(folder)
    written_beside(where / WEIGHTS, write)
    text = json.dumps({"format": FORMAT, **configuration}, indent=1)
    write_text(where / CONFIGURATION, text + "\n")
