"""Results files of the benchmark: format ``loose-benchmark/1``, checked when read."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from loose_agents.benchmark.tasks import SETS, TASKS, EpisodeSet
from loose_agents.core.base import Problem
from loose_agents.evaluation.record_bounds import information_limits, success_limits
from loose_env.errors import InvalidData
from loose_env.io import read_result_file, restored, whole_of, write_text
from loose_env.typing import Array

__all__ = ["FORMAT", "Results", "read_results", "results_of", "results_schema", "write_results"]

FORMAT = "loose-benchmark/1"
"""Format of the files; it fixes tasks, sets and metrics too."""

OUTSIDE = -1
"""Index of what is no verdict: a truth outside the hypotheses, or no verdict given."""


@dataclass(frozen=True, kw_only=True)
class Results:
    """Episodes of one entry on one set of one task.

    Lists have an item for each episode, from number 0; one that has fewer than the set is
    provisional.
    """

    task: str
    """Id of the environment."""
    set: str
    """Set of episodes."""
    entry: str
    """Name on the leaderboard."""
    agent: str | None
    """Name by which `loose_agents.registry.make_agent` makes the agent; None: actions alone."""
    agent_seed: int = 0
    """Seed of what the agent draws."""
    about: str
    """The method in a sentence."""
    code: str = ""
    """Address of code and weights."""
    log: str = ""
    """Learning curve or training log: path in the repository, or address."""
    training_records: int | None = None
    """Records taken from the simulator in training and tuning, all seeds; None: not told."""
    fingerprint: str
    """Fingerprint of the problem that was played, `loose_agents.core.base.Problem`."""
    verdicts: tuple[str, ...]
    """What the next two lists count: hypotheses, then "unsure"; -1 stands for none of them."""
    truth: tuple[int, ...]
    """Index of the hidden fault's hypothesis."""
    verdict: tuple[int, ...]
    """Index of the verdict."""
    reward: tuple[float, ...]
    """Return, every digit."""
    records: tuple[int, ...]
    """Records taken."""
    confidence: tuple[float | None, ...]
    """Probability of the verdict as the agent saw it; None of an agent that keeps none."""
    actions: tuple[str, ...]
    """Actions with spaces between, the verdict last: `loose_env.envs.ActionLayout.code`."""
    information: tuple[float, ...] = ()
    """Upper 95 % limits of the mean information of the 1st, 2nd, ... record [nat]."""
    guesses: tuple[float, ...] = ()
    """Upper 95 % limits of the accuracy of the best guess after 1, 2, ... records."""
    cpu_seconds: float | None = None
    """Processor time per record, simulation and agent [s]."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Versions of the packages."""
    format: str = FORMAT
    """Format of the file."""

    @property
    def returns(self) -> Array:
        """Return of each episode (episodes,)."""
        return np.array(self.reward, dtype=float)

    @property
    def episodes(self) -> EpisodeSet:
        """The set that was played."""
        return SETS[self.set]

    def to_json(self) -> str:
        """Text of the file, a line for each entry, floats as they are."""
        lines = (f"{json.dumps(k)}: {json.dumps(v)}" for k, v in asdict(self).items())
        return "{\n" + ",\n".join(lines) + "\n}\n"


def results_of(
    rows: Sequence[Mapping[str, Any]],
    problem: Problem,
    *,
    cpu_seconds: float | None = None,
    **told: Any,
) -> Results:
    """Make results of played episodes.

    Parameters
    ----------
    rows : sequence of mapping
        Episodes in order, as `loose_agents.evaluation.evaluate.EpisodeRow`.
    problem : Problem
        What was played.
    cpu_seconds : float, optional
        Processor time in all [s].
    told : keyword arguments
        The fields of `Results` that say what was played and by whom.
    """
    names = problem.verdicts

    def index(name: str | None) -> int:
        return names.index(name) if name in names else OUTSIDE

    records = tuple(int(row["records"]) for row in rows)
    spent = None if cpu_seconds is None else round(cpu_seconds / max(sum(records), 1), 4)
    confidence = (row["confidence"] for row in rows)
    return Results(
        fingerprint=problem.fingerprint,
        verdicts=names,
        truth=tuple(index(row["truth"]) for row in rows),
        verdict=tuple(index(row["verdict"]) for row in rows),
        reward=tuple(float(row["reward"]) for row in rows),
        records=records,
        confidence=tuple(None if p is None else round(float(p), 5) for p in confidence),
        actions=tuple(str(row["actions"]) for row in rows),
        information=tuple(round(x, 4) for x in information_limits(problem, rows)),
        guesses=tuple(round(x, 4) for x in success_limits(rows)),
        cpu_seconds=spent,
        **told,
    )


def read_results(path: Path) -> Results:
    """Read a results file and check it against the format.

    Raises
    ------
    InvalidData
        If it is missing, no JSON, lacks an entry, has one too many, or entries do not fit
        together; the message begins with the file.
    """

    def parse(text: str) -> Results:
        whole = whole_of(text, format=FORMAT, noun="results")
        results = restored(Results, whole, "results")
        strange = sorted(set(whole) - {each.name for each in fields(Results)})
        if strange:
            raise InvalidData(
                f"results: unknown entries {strange}; known are "
                f"{[each.name for each in fields(Results)]}"
            )
        _check(results)
        return results

    return read_result_file(path, parse, noun="results")


def _check(results: Results) -> None:
    """Refuse what does not fit together."""
    for name, known in (("task", TASKS), ("set", SETS)):
        if getattr(results, name) not in known:
            raise InvalidData(f"results.{name}: {getattr(results, name)!r:.60} is none of "
                              f"{list(known)}")  # fmt: skip
    most, count = results.episodes.episodes, len(results.reward)
    if not 1 <= count <= most:
        raise InvalidData(f"results.reward: the set {results.set!r} has 1 to {most} episodes, got "
                          f"{count}")  # fmt: skip
    for name in ("truth", "verdict", "records", "confidence", "actions"):
        if len(getattr(results, name)) != count:
            raise InvalidData(
                f"results.{name}: {count} episodes as in results.reward are needed, got "
                f"{len(getattr(results, name))}"
            )
    last = len(results.verdicts) - 1
    for name in ("truth", "verdict"):
        if not all(OUTSIDE <= k <= last for k in getattr(results, name)):
            raise InvalidData(f"results.{name}: indices run from -1 to {last}")
    if not np.isfinite(results.returns).all():
        raise InvalidData("results.reward: returns are finite numbers")
    if not all(p is None or 0 <= p <= 1 for p in results.confidence):
        raise InvalidData("results.confidence: probabilities run from 0 to 1, or are null")
    if not results.entry.strip():
        raise InvalidData("results.entry: give the entry a name")


def write_results(path: Path, results: Results) -> Path:
    """Write a results file; it is renamed into place."""
    return write_text(path, results.to_json())


def results_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of a results file; lists are checked against the set beside it.

    Examples
    --------
    >>> results_schema()["properties"]["format"]
    {'const': 'loose-benchmark/1'}
    """
    text, number = {"type": "string"}, {"type": "number"}
    whole = {"type": "integer"}

    def of(item: Mapping[str, Any]) -> dict[str, Any]:
        return {"type": "array", "items": item}

    share = {"type": ["number", "null"], "minimum": 0, "maximum": 1}
    properties: dict[str, Any] = {
        "format": {"const": FORMAT},
        "task": {"enum": list(TASKS)},
        "set": {"enum": list(SETS)},
        "entry": {"type": "string", "minLength": 1},
        "agent": {"type": ["string", "null"]},
        "agent_seed": whole,
        **dict.fromkeys(("about", "code", "log"), text),
        "training_records": {"type": ["integer", "null"], "minimum": 0},
        "fingerprint": {"type": "string", "pattern": "^[0-9a-f]{16}$"},
        "verdicts": of(text),
        **dict.fromkeys(("truth", "verdict"), of({"type": "integer", "minimum": OUTSIDE})),
        "reward": of(number),
        "records": of({"type": "integer", "minimum": 0}),
        "confidence": of(share),
        "actions": of({"type": "string", "pattern": "^[0-9a-z ]*$"}),
        **dict.fromkeys(("information", "guesses"), of(number)),
        "cpu_seconds": {"type": ["number", "null"], "minimum": 0},
        "versions": {"type": "object", "additionalProperties": text},
    }
    optional = (
        *("agent_seed", "code", "log", "training_records", "information", "guesses"),
        *("cpu_seconds", "versions"),
    )
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": FORMAT,
        "type": "object",
        "required": [name for name in properties if name not in optional],
        "properties": properties,
        "additionalProperties": False,
    }
