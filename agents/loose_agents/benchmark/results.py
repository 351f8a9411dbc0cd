"""Results files of the benchmark (``loose-benchmark/1``): play, reading, schema, replay check."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import mujoco
import numpy as np
from annotated_types import Ge, Le
from pydantic import ConfigDict, TypeAdapter

import loose_env
from loose_agents.base import Agent, EpisodeAgent, Problem, action_of
from loose_agents.belief import usual_estimator
from loose_agents.benchmark.episodes import (
    HIDDEN,
    ROUNDS,
    SETS,
    TASKS,
    EpisodeSet,
    commitment_of,
    evaluate_kind,
    set_named,
    task_problem,
)
from loose_agents.jobs import Store, spans
from loose_agents.registry import AGENTS, LEARNED, content_of, is_outside, make_agent
from loose_agents.sharded_play import information_limits, success_limits
from loose_agents.stored import setting_name, tuning_name, weights_path
from loose_env.errors import InvalidAction, InvalidData, InvalidSetting
from loose_env.io import NonNegativeCount, read_result_file, restored, whole_of
from loose_env.typing import Array

_UNTRAINED = ("always_healthy", "always_unsure", "random", "classical", "classical_literal",
              "outward", "inward", "bisection", "local", "rhythm")  # fmt: skip


def training_of(agent: str, problem: Problem) -> int | None:
    """Number of records behind a shipped agent's weights, tuning left out.

    None of an agent from outside, whose training is not known here.
    """
    plain, _, number = agent.partition("#")
    if plain in _UNTRAINED:
        return 0
    estimator = plain.partition("/")[0] if "/" in plain else usual_estimator(problem)
    if plain not in AGENTS and is_outside(agent):
        return None
    name, records = setting_name(problem), 0
    if estimator == "amortised":
        records = _of_bank(_described(f"posterior-{name}").get("bank"), problem)
    if estimator == "calibrated":
        records = int(_described(f"foresight-{tuning_name(problem)}").get("records", 0))
    if plain in LEARNED:
        suffix = f"-{number}" if number not in ("", "1") else ""
        trained = _described(f"{plain}-{name}{suffix}").get("trained", {})
        records += int(trained.get("steps", 0))
    return records


def _of_bank(bank: dict[str, Any] | None, problem: Problem) -> int:
    """Records of a bank: episodes of a few, and some of as many as the rules allow."""
    if bank is None:
        return 0
    few, every = int(bank["records"]["records"]), int(bank["records"]["long_every"])
    return round(int(bank["episodes"]) * (few + (problem.settings.max_records - few) / every))


def _described(name: str) -> dict[str, Any]:
    path = weights_path(name) / "configuration.json"
    found: dict[str, Any] = {}
    if path.is_file():
        found = json.loads(path.read_text(encoding="utf-8"))
    return found


FORMAT = "loose-benchmark/1"
"""Format of the files; it fixes tasks, sets and metrics too."""

OUTSIDE = -1
"""Index of what is no verdict: a truth outside the hypotheses, or no verdict given."""

_Index = Annotated[int, Ge(OUTSIDE)]
_Share = Annotated[float, Ge(0), Le(1)]


@dataclass(frozen=True, kw_only=True)
class Results:
    """Episodes of one entry on one set of one task.

    Lists have an item for each episode, from number 0; one that has fewer than the set is
    provisional.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    task: str
    """Id of the environment."""
    set: str
    """Set of episodes."""
    salt: str = ""
    """Salt of the hidden set, published when its round closes; empty for other sets."""
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
    training_records: NonNegativeCount | None = None
    """Records taken from the simulator in training and tuning, all seeds; None: not told."""
    fingerprint: str
    """Fingerprint of the problem that was played, `loose_agents.base.Problem`."""
    verdicts: tuple[str, ...]
    """What the next two lists count: hypotheses, then "unsure"; -1 stands for none of them."""
    truth: tuple[_Index, ...]
    """Index of the hidden fault's hypothesis."""
    verdict: tuple[_Index, ...]
    """Index of the verdict."""
    reward: tuple[float, ...]
    """Return, every digit."""
    records: tuple[NonNegativeCount, ...]
    """Records taken."""
    confidence: tuple[_Share | None, ...]
    """Probability of the verdict as the agent saw it; None of an agent that keeps none."""
    actions: tuple[str, ...]
    """Actions with spaces between, the verdict last: `loose_agents.base.code_of`."""
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
        return set_named(self.set, self.salt)

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
    """Make results of played episodes."""
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
    """Read a results file and check it against the format."""

    def parse(text: str) -> Results:
        results = restored(Results, whole_of(text, format=FORMAT, noun="results file"), "results")
        _check(results)
        return results

    return read_result_file(path, parse, noun="results file")


def _check(results: Results) -> None:
    """Refuse what does not fit together."""
    for name, known in (("task", TASKS), ("set", SETS)):
        if getattr(results, name) not in known:
            raise InvalidData(f"results.{name}: {getattr(results, name)!r:.60} is none of "
                              f"{list(known)}")  # fmt: skip
    if (results.set == HIDDEN) != bool(results.salt):
        raise InvalidData(f"results.salt: the set {HIDDEN!r} has a salt, and no other; got "
                          f"{results.salt!r:.60}")  # fmt: skip
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
        if max(getattr(results, name)) > last:
            raise InvalidData(f"results.{name}: indices run from -1 to {last}")
    if not np.isfinite(results.returns).all():
        raise InvalidData("results.reward: returns are finite numbers")
    if not results.entry.strip():
        raise InvalidData("results.entry: give the entry a name")


def results_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of a results file; lists are checked against the set beside it."""
    schema = TypeAdapter(Results).json_schema()
    own = {"format": {"const": FORMAT}, "task": {"enum": list(TASKS)}, "set": {"enum": list(SETS)}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": FORMAT,
        "required": [*schema["required"], "format"],
        "properties": {**schema["properties"], **own},
    }


SHARD = 40
"""Episodes after which what was played is stored."""


def play_results(
    task: str,
    set_name: str,
    agent: str,
    *,
    told: dict[str, Any],
    folder: Path,
    count: int | None = None,
    salt: str = "",
    agent_seed: int = 0,
    named: bool = True,
    say: Callable[[str], None] = lambda words: None,
) -> Results:
    """Play a set of episodes; episodes stored in the folder are not played again."""
    episodes = set_named(set_name, salt)
    played = episodes.episodes if count is None else count
    if not 1 <= played <= episodes.episodes:
        raise InvalidSetting(
            f"the set {set_name!r} has 1 to {episodes.episodes} episodes, got {played}"
        )
    problem = task_problem(task, episodes, agent)
    player = make_agent(agent, problem, seed=agent_seed)
    kept = {
        "task": task, "set": asdict(episodes), "agent": agent, "agent_seed": agent_seed,
        "fingerprint": problem.fingerprint, "version": loose_env.__version__,
        "content": content_of(agent),
    }  # fmt: skip
    round_of = f"-{commitment_of(salt)[:8]}" if salt else ""
    name = f"{task}-{set_name}{round_of}-{agent}".replace("/", "_").replace(":", "_")
    store, parts = Store(folder / name, kept), spans(played, SHARD)
    for part in store.missing(parts):
        begin = time.process_time()
        rows = _rows(player, agent, problem, episodes, part.start, len(part))
        spent = (time.process_time() - begin) / len(rows)
        store.write(part, [{**row, "cpu_seconds": spent} for row in rows])
        say(f"{task} {set_name} {agent}: {part.stop} of {played} episodes")
    rows = [row for part in parts for row in store.read(part)]
    return results_of(
        rows,
        problem,
        cpu_seconds=sum(row["cpu_seconds"] for row in rows),
        task=task,
        set=set_name,
        salt=salt,
        agent=agent if named else None,
        agent_seed=agent_seed,
        versions={
            "loose_env": loose_env.__version__,
            "mujoco": mujoco.__version__,
            "numpy": np.__version__,
            "gymnasium": gymnasium.__version__,
        },
        **told,
    )


def check_results(
    results: Results,
    *,
    episodes: int,
    rng: np.random.Generator,
    by_agent: bool = True,
) -> str:
    """Play a sample of a file's episodes again and compare bit for bit.

    The recorded actions are played, and return, verdict, truth and number of records compared.
    Where the file names its agent, that plays too, and its actions and confidence are compared.
    """
    if results.set == HIDDEN and commitment_of(results.salt) not in ROUNDS:
        raise InvalidData(
            "results.salt: no round was committed to it; whoever drew it may know the arms"
        )
    problem = task_problem(results.task, results.episodes, results.agent)
    if results.fingerprint != problem.fingerprint:
        raise InvalidData(
            f"fingerprint {results.fingerprint!r:.20} is not that of {results.task} here, "
            f"{problem.fingerprint!r}: the file was made by another version"
        )
    if results.verdicts != problem.verdicts:
        raise InvalidData(f"verdicts of {results.task} are {list(problem.verdicts)}")
    whole = len(results.reward)
    count = min(episodes, whole)
    player = None
    if results.agent is not None and by_agent:
        player = make_agent(results.agent, problem, seed=results.agent_seed)
    for number in sorted(rng.choice(whole, size=count, replace=False).tolist()):
        recorded = _Recorded(problem, number, results.actions[number])
        _compare(results, number, *_rows(recorded, "", problem, results.episodes, number, 1))
        if player is not None:
            (row,) = _rows(player, str(results.agent), problem, results.episodes, number, 1)
            _compare(results, number, row)
            p = row["confidence"]
            _same(number, "confidence", results.confidence[number], p if p is None else round(p, 5))
    words = f" and by the agent {results.agent!r}" if player else ""
    return (
        f"{count} of {whole} episodes replayed from their actions{words}; returns equal bit for bit"
    )


def _rows(
    player: Agent, name: str, problem: Problem, episodes: EpisodeSet, first: int, count: int
) -> list[dict[str, Any]]:
    rows = evaluate_kind(
        player, name, problem, episodes.kind, episodes=count, first=first, seed=episodes.seed
    )
    return [asdict(row) for row in rows]


class _Recorded(EpisodeAgent):
    """Plays the recorded actions of one episode."""

    def __init__(self, problem: Problem, number: int, actions: str) -> None:
        super().__init__(problem)
        try:
            self.actions = [action_of(problem.actions, code) for code in actions.split()]
        except InvalidAction as error:
            raise InvalidData(f"episode {number}: {error}") from error
        self.number = number

    def begin(self, rng: np.random.Generator) -> Any:
        """Start with the first action."""
        return iter(self.actions)

    def act(self, observation: Any, memory: Any) -> Any:
        """Take the next action."""
        action = next(memory, None)
        if action is None:
            raise InvalidData(f"episode {self.number}: its actions end without a verdict")
        return action


def _compare(results: Results, number: int, row: Mapping[str, Any]) -> None:
    """Refuse a file that says something else of an episode than was played."""
    _same(number, "actions", results.actions[number], row["actions"])
    names = results.verdicts
    for name in ("truth", "verdict"):
        index = names.index(row[name]) if row[name] in names else OUTSIDE
        _same(number, name, getattr(results, name)[number], index)
    _same(number, "return", results.reward[number], row["reward"])
    _same(number, "records", results.records[number], row["records"])


def _same(number: int, name: str, given: Any, found: Any) -> None:
    if given != found:
        raise InvalidData(f"episode {number}: the file says {name} {given!r}, replayed {found!r}")
