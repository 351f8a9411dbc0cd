"""Results files of the benchmark, ``loose-benchmark/1``: made by playing, checked by replay."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

import loose_env
from loose_agents.base import Agent, Problem
from loose_agents.belief import (
    setting_name,
    usual_estimator,
    weights_path,
)
from loose_agents.benchmark.episodes import (
    SETS,
    TASKS,
    UNLIKE,
    EpisodeSet,
    evaluate_kind,
    rig_for,
    set_named,
    settings_for,
    task_problem,
)
from loose_agents.comparison import information_limits, success_limits
from loose_agents.jobs import Store, spans
from loose_agents.registry import AGENTS, LEARNED, content_of, is_outside, make_agent
from loose_env.envs import EpisodeBatch
from loose_env.errors import InvalidAction, InvalidData, InvalidSetting
from loose_env.io import read_result_file, restored, whole_of, write_text
from loose_env.typing import Array

_UNTRAINED = ("always_healthy", "always_unsure", "random", "classical", "classical_literal",
              "outward", "inward", "bisection", "local", "images")  # fmt: skip


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
    """Fingerprint of the problem that was played, `loose_agents.base.Problem`."""
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
    agent_seed: int = 0,
    named: bool = True,
    say: Callable[[str], None] = lambda words: None,
) -> Results:
    """Play a set of episodes; episodes stored in the folder are not played again."""
    episodes = set_named(set_name)
    played = episodes.episodes if count is None else count
    if not 1 <= played <= episodes.episodes:
        raise InvalidSetting(
            f"the set {set_name!r} has 1 to {episodes.episodes} episodes, got {played}"
        )
    problem = task_problem(task, episodes)
    player = make_agent(agent, problem, seed=agent_seed)
    kept = {
        "task": task, "set": asdict(episodes), "agent": agent, "agent_seed": agent_seed,
        "fingerprint": problem.fingerprint, "version": loose_env.__version__,
        "content": content_of(agent),
    }  # fmt: skip
    name = f"{task}-{set_name}-{agent}".replace("/", "_").replace(":", "_")
    store, parts = Store(folder / name, kept), spans(played, SHARD)
    for part in store.missing(parts):
        begin = time.process_time()
        rows = _play(player, agent, problem, episodes, part)
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
    problem = task_problem(results.task, results.episodes)
    if results.fingerprint != problem.fingerprint:
        raise InvalidData(
            f"fingerprint {results.fingerprint!r:.20} is not that of {results.task} here, "
            f"{problem.fingerprint!r}: the file was made by another version"
        )
    if results.verdicts != problem.verdicts:
        raise InvalidData(f"verdicts of {results.task} are {list(problem.verdicts)}")
    whole = len(results.reward)
    count = min(episodes, whole)
    numbers = sorted(rng.choice(whole, size=count, replace=False).tolist())
    _replay(results, problem, numbers)
    words = f"{count} of {whole} episodes replayed from their actions"
    if results.agent is None or not by_agent:
        return f"{words}; returns equal bit for bit"
    player = make_agent(results.agent, problem, seed=results.agent_seed)
    for number in numbers:
        row = _play(player, results.agent, problem, results.episodes, range(number, number + 1))[0]
        _same(number, "actions", results.actions[number], row["actions"])
        _same(number, "return", results.reward[number], row["reward"])
        told = None if row["confidence"] is None else round(row["confidence"], 5)
        _same(number, "confidence", results.confidence[number], told)
    return f"{words} and by the agent {results.agent!r}; returns equal bit for bit"


def _play(
    player: Agent, name: str, problem: Problem, episodes: EpisodeSet, numbers: range
) -> list[dict[str, Any]]:
    rows = evaluate_kind(
        player, name, problem, episodes.kind,
        episodes=len(numbers), first=numbers.start, seed=episodes.seed,
    )  # fmt: skip
    return [asdict(row) for row in rows]


def _replay(results: Results, problem: Problem, numbers: Sequence[int]) -> None:
    """Play recorded actions, all episodes side by side."""
    episodes = results.episodes
    batch = EpisodeBatch(
        problem.arm,
        settings_for(episodes.kind, problem),
        num=len(numbers),
        threads=1,
        rig=rig_for(episodes.kind, problem, len(numbers)),
    )
    options = UNLIKE[episodes.kind][1]
    actions = []
    for slot, number in enumerate(numbers):
        batch.start(slot, seed=episodes.seed, number=number, options=options)
        try:
            found = [batch.actions.from_code(code) for code in results.actions[number].split()]
        except InvalidAction as error:
            raise InvalidData(f"episode {number}: {error}") from error
        if not 0 < len(found) <= problem.settings.max_records + 1:
            raise InvalidData(
                f"episode {number}: 1 to {problem.settings.max_records + 1} actions, the last one "
                f"a verdict, are needed, got {len(found)}"
            )
        actions.append(found)
    prices = np.zeros(len(numbers))
    going = list(range(len(numbers)))
    for taken in range(max(map(len, actions))):
        slots = [slot for slot in going if taken < len(actions[slot])]
        for slot, outcome in zip(
            slots, batch.step(slots, [actions[slot][taken] for slot in slots]), strict=True
        ):
            number = numbers[slot]
            if not outcome.terminated:
                prices[slot] -= outcome.reward
            if not (outcome.terminated or outcome.truncated):
                continue
            going.remove(slot)
            ended = outcome.reward if outcome.terminated else 0.0
            info = outcome.info
            _same(number, "number of actions", len(actions[slot]), taken + 1)
            _same(number, "return", results.reward[number], float(ended - prices[slot]))
            _same(number, "records", results.records[number], info["records"])
            for name, told in (("truth", info["fault"]), ("verdict", info["verdict"])):
                here = problem.verdicts
                index = here.index(told) if told in here else OUTSIDE
                _same(number, name, getattr(results, name)[number], index)
    if going:
        raise InvalidData(f"episode {numbers[going[0]]}: its actions end without a verdict")


def _same(number: int, name: str, given: Any, found: Any) -> None:
    if given != found:
        raise InvalidData(f"episode {number}: the file says {name} {given!r}, replayed {found!r}")
