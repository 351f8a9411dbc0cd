"""Kill commands at random moments, let them go on, and look at what they left.

    python -m scripts.suites.trust.kills --kills 20

Nothing half-written may count, no row may be lost or doubled, and a command that was killed and run
again ends with the result of one that was let through.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from loose_env.cli.command import command
from loose_env.evaluation import read_rows
from loose_env.gap import read_result
from loose_env.instrument import read_diagnosis
from scripts.example_recording import loose_arm
from scripts.suites.golden import GAPS, write_gap_recording

ROOT = Path(__file__).resolve().parents[3]
POLL = 0.004
"""Time between two looks at the folder [s]."""
LONGEST = 900.0
"""Longest that a run may take [s]."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command that writes to a folder and goes on when it is run again."""

    words: Callable[[Path], Sequence[str]]
    """Words after ``python``, for an output folder."""
    result: Callable[[Path], Any]
    """What the finished command wrote, to be compared with another run's."""
    readers: Mapping[str, Callable[[Path], object]]
    """What reads the files of a pattern, at whatever moment, and raises where one is not whole."""

    def problems(self, out: Path) -> list[str]:
        """What is wrong with what lies in the folder."""
        found = []
        for pattern, read in self.readers.items():
            # What is being written has a name that begins with a dot until it is whole.
            for file in (f for f in out.glob(pattern) if not f.name.startswith(".")):
                try:
                    read(file)
                except Exception as error:  # whatever it is, the file is not whole
                    found.append(f"{file.name}: {type(error).__name__}: {error}")
        return found


@dataclass
class Killed:
    """What came of killing a command."""

    kills: int = 0
    runs: int = 0
    """Runs that ended by themselves."""
    problems: list[str] = field(default_factory=list)
    """Everything that was wrong."""


def kill_often(made: Command, place: Path, *, kills: int, rng: np.random.Generator) -> Killed:
    """Kill a command again and again until it was killed so often; let the last one through."""
    found = Killed()
    pauses = _watched(made, place / "whole")
    assert pauses is not None
    wanted = made.result(place / "whole")
    found.problems += [f"unkilled: {p}" for p in made.problems(place / "whole")]
    while found.kills < kills or not found.runs:
        out = place / f"chain-{found.runs}"
        moment = int(rng.integers(len(pauses)))
        delay = rng.random() * pauses[moment]
        if found.kills < kills and _watched(made, out, moment, delay) is None:
            found.kills += 1
            found.problems += [f"kill {found.kills}: {p}" for p in made.problems(out)]
            if found.kills < kills:
                continue
        if found.kills >= kills:
            _watched(made, out)
        found.problems += [f"end of chain {found.runs}: {p}" for p in made.problems(out)]
        if repr(made.result(out)) != repr(wanted):
            found.problems.append(f"end of chain {found.runs}: another result than unkilled")
        found.runs += 1
    return found


def _watched(
    made: Command, out: Path, moment: int | None = None, delay: float = 0.0
) -> list[float] | None:
    """Run a command; time to each change of its folder, and to its end [s].

    None where it was killed, with all that it started, some time after a change.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    told = out.with_name(f"{out.name}.said")
    paths = os.pathsep.join([str(ROOT), str(ROOT / "agents")])
    with told.open("wb") as said:
        process = subprocess.Popen(
            [sys.executable, *made.words(out)], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=said,
            env=os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}, start_new_session=True,
        )  # fmt: skip
    times, before = [time.monotonic()], _listing(out)
    while process.poll() is None and len(times) - 1 != moment:
        now = _listing(out)
        times += [time.monotonic()] if now != before else []
        before = now
        if time.monotonic() - times[0] > LONGEST:
            os.killpg(process.pid, signal.SIGKILL)
        time.sleep(POLL)
    if process.poll() is None:
        time.sleep(delay)
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    code = process.wait()
    if code not in (0, -signal.SIGKILL if moment is not None else 0):
        raise RuntimeError(f"it ended with {code}: {told.read_text(errors='replace')[-600:]}")
    return None if code else list(np.diff([*times, time.monotonic()]))


def _listing(folder: Path) -> frozenset[tuple[str, int, int, int]]:
    """Files with what changes when they are written anew or in place."""
    found = set()
    for root, _, names in os.walk(folder):  # unlike rglob it takes folders that vanish
        for path in (os.path.join(root, name) for name in names):
            try:
                state = os.stat(path)
            except OSError:  # renamed while it was looked at
                continue
            found.add((path, state.st_ino, state.st_size, state.st_mtime_ns))
    return frozenset(found)


# ------------------------------------------------------------------------------ commands

EPISODES = 24


def commands(place: Path) -> dict[str, Command]:
    """Commands by name; what they read is made below a folder."""
    recording, measured = place / "recording", place / "session" / "recording"
    if not recording.exists():
        write_gap_recording(recording, **GAPS["forward, damping"])
        loose_arm(measured)
    kinds = ("--kinds", "viscous_friction", "link_mass", "--threads", "1")
    weights = {"**/*.json": _read_json, "**/*.safetensors": _weights, "**/*.zip": _model}
    return {
        "training": Command(
            words=_training, result=_trained, readers={**weights, "**/curve.csv": _evaluations}
        ),
        "comparison": Command(
            words=_compare, result=lambda out: read_rows(out / "rows.parquet"),
            readers={
                "shards/*/shard-*.json": lambda file: _read_json(file)["rows"],
                "rows.parquet": _played,
            },
        ),
        "gap": Command(
            words=lambda out: ("-m", "loose_env", "gap", str(recording), "--out", str(out), *kinds),
            result=lambda out: [(out / n).read_text("utf-8") for n in ("result.json", "model.xml")],
            readers={
                "result.json": lambda file: (read_result(file), _model_of(file)),
                "model.xml": _model_of, "report.html": _page,
            },
        ),
        "diagnosis": Command(
            words=lambda out: ("-m", "loose_env", "diagnose", str(measured), "--out", str(out)),
            result=lambda out: {**_read_json(out / "result.json"), "seconds": None},
            readers={"result.json": read_diagnosis, "report.html": _page},
        ),
    }  # fmt: skip


def _training(out: Path) -> Sequence[str]:
    return (
        *("scripts/agents/train.py", "--env", "loose_env/Planar-v0", "-n", "96", "-f", str(out)),
        *("--env-kwargs", "n_links:2", "durations:[0.2]", "max_records:4", "threads:1"),
        *("-params", "n_envs:4", "n_steps:4", "batch_size:8", "n_epochs:1"),
        *("policy_kwargs:dict()", "--eval-freq", "32", "--eval-episodes", "3", "--export"),
        str(out / "export"),
    )


def _compare(out: Path) -> Sequence[str]:
    return (
        *("scripts/agents/compare.py", "--env", "loose_env/Planar-v0", "--out", str(out)),
        *("--arguments", '{"n_links": 2}', "--agents", "random", "posterior/random"),
        *("--episodes", str(EPISODES), "--shard", "4", "--workers", "1"),
    )


def _read_json(file: Path) -> Any:
    return json.loads(file.read_text("utf-8"))


def _weights(file: Path) -> None:
    from safetensors.numpy import load_file

    load_file(file)
    assert file.with_name("configuration.json").exists(), "no configuration beside it"


def _once(steps: Sequence[int]) -> Sequence[int]:
    """Steps of evaluations, each there once."""
    assert sorted(set(steps)) == steps, f"evaluations at {steps}"
    return steps


def _model(file: Path) -> Any:
    """The run that a model's file holds, which a checkpoint has."""
    from loose_agents.rl.model_files import read_model

    run = read_model(file).run
    if file.name == "checkpoint.zip":
        assert run is not None, "the run is missing"
        _once([point["steps"] for point in run["state"]["points"]])
    return run


def _evaluations(file: Path) -> Sequence[int]:
    from loose_agents.rl.training import read_curve

    return _once([point.steps for point in read_curve(file)])


def _trained(out: Path) -> Any:
    """What does not depend on the faults that a resumed run meets: counts and names of files."""
    (checkpoint,) = out.rglob("checkpoint.zip")
    names = sorted(str(p.relative_to(out)) for p in out.rglob("*") if ".part" not in p.name)
    return _model(checkpoint)["counters"], _evaluations(next(out.rglob("curve.csv"))), names


def _played(file: Path) -> None:
    rows, _ = read_rows(file)
    played = {(row["agent"], row["episode"]) for row in rows}
    assert len(rows) == len(played) == 2 * EPISODES, f"{len(rows)} rows, {len(played)} different"


def _model_of(file: Path) -> Any:
    """The model beside a result, which is there before it."""
    return mujoco.MjModel.from_xml_path(str(file.with_name("model.xml")))


def _page(file: Path) -> None:
    assert "</html>" in file.read_text("utf-8")[-40:], "cut short"


@dataclass(frozen=True, kw_only=True)
class KillSettings:
    """What is killed, and how often."""

    kills: int = 20
    """Kills of each command."""
    only: tuple[str, ...] = ("training", "comparison", "gap", "diagnosis")
    """Commands."""
    seed: int = 1
    """Seed of the moments."""


def run(given: KillSettings) -> None:
    """Kill the commands and print a table."""
    wrong = False
    print("| command | kills | runs to the end | problems |\n| --- | ---: | ---: | ---: |")
    for name in given.only:
        with tempfile.TemporaryDirectory() as place:
            made = commands(Path(place))[name]
            rng = np.random.default_rng(given.seed)
            found = kill_often(made, Path(place) / "killed", kills=given.kills, rng=rng)
        print(f"| {name} | {found.kills} | {found.runs} | {len(found.problems)} |", flush=True)
        print("".join(f"  {problem}\n" for problem in found.problems), end="", file=sys.stderr)
        wrong |= bool(found.problems)
    if wrong:
        sys.exit(1)


if __name__ == "__main__":
    command("kills", __doc__, KillSettings, run)
