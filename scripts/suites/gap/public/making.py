"""Making of a suite: recordings in two formats, protocol, commitments, sealed truths."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import secrets
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.io import read_result_file, restored, whole_of, write_text
from loose_env.recording import read_recording
from scripts.suites.gap.cases.cases import HELD_OUT, LAST, SEED, Case, name_of
from scripts.suites.gap.cases.draw import draw_case, tolerance_of
from scripts.suites.gap.cases.recordings import is_written, write_case
from scripts.suites.gap.effects.types import FREE, MIXED
from scripts.suites.gap.public.catalogue import Kind, catalogue, places_of
from scripts.suites.gap.public.lerobot import write_lerobot
from scripts.suites.gap.simulator.simulate import SAMPLE

__all__ = ["CaseEntry", "MakeSettings", "Suite", "make", "open_truths", "read_suite"]

PROTOCOL, COMMITMENTS, SECRET = "protocol.json", "commitments.json", "sealed/secret.json"
"""Files of a suite; what lies in ``sealed`` is kept back."""
FORMAT, COMMITTED, SEALED = "gap-benchmark/1", "gap-commitments/1", "gap-sealed/1"
"""Formats of these files."""
GROUPS = ("none", "single", "pair", "single", "outside", "none", "single", "pair", "single",
          "triple", "none", "single")  # fmt: skip
"""Groups of the cases of a suite, again and again."""
UNPUBLISHED = 500
"""First number within a group that the published suite does not use."""
_KEY = 5  # of the random numbers that choose cases, beside those of a case
_FIRST = {"none": 0, "single": 1000, "pair": 2000, "outside": 3000, "triple": 4000}


@dataclasses.dataclass(frozen=True, kw_only=True)
class MakeSettings:
    """Settings of a suite."""

    cases: int = 12
    """Number of cases, drawn from numbers that the published suite does not use."""
    numbers: tuple[int, ...] = ()
    """Numbers of the cases, in the place of drawn ones."""
    seed_phrase: str = ""
    """Secret from which all is drawn; "" draws one and keeps it in ``sealed``."""
    name: str = ""
    """Name of the suite on the leaderboard; "" for that of its folder."""

    def __post_init__(self) -> None:
        if not 1 <= self.cases <= 1000:
            raise InvalidSetting(f"a suite has 1 to 1000 cases, not {self.cases}")
        wrong = [number for number in self.numbers if not 0 <= number <= LAST]
        if wrong or len(set(self.numbers)) < len(self.numbers):
            raise InvalidSetting(f"numbers of cases are different ones from 0 to {LAST}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class CaseEntry:
    """What entrants are told of a case."""

    tolerance: float
    """Largest relative error of nominal masses, inertias, dampings, gains and rotors."""
    sample_rate_hz: float
    """Sampling rate of all runs [Hz]."""
    runs: tuple[str, ...]
    """Files of the runs, in the order of the episodes."""
    held_out: tuple[str, ...]
    """Runs to which no parameter is fitted."""
    places: Mapping[str, tuple[str, ...]]
    """Locations by group."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Suite:
    """The content of ``protocol.json``: all that entrants are told beside the recordings."""

    name: str
    """Name on the leaderboard."""
    identity: str
    """Hash of the names of the cases: the same for everyone who has this suite."""
    cases: Mapping[str, CaseEntry]
    """Cases by name."""
    kinds: Mapping[str, Kind]
    """Kinds that an answer may name."""
    answer_format: str = "gap-answer/1"
    """Format of answers."""
    format: str = FORMAT
    """Format of the file."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Secret:
    """The content of ``sealed/secret.json``."""

    seed: str
    """Seed in hexadecimal digits."""
    numbers: Mapping[str, int]
    """Number of each case by its name."""
    salts: Mapping[str, str]
    """Salt of the commitment of each case, hexadecimal digits."""
    format: str = SEALED
    """Format of the file."""


def seed_of(phrase: str) -> int:
    """Seed of a phrase.

    Examples
    --------
    >>> seed_of("open-1") == seed_of("open-1"), seed_of("open-1") == seed_of("open-2")
    (True, False)
    """
    return int.from_bytes(hashlib.sha256(phrase.encode("utf-8")).digest()[:16], "big")


def drawn_numbers(count: int, seed: int) -> tuple[int, ...]:
    """Numbers of cases, of the groups of `GROUPS` in turn.

    Examples
    --------
    >>> from scripts.suites.gap.cases.cases import role_of
    >>> numbers = drawn_numbers(12, 1)
    >>> [role_of(n) for n in numbers] == list(GROUPS), min(n % 1000 for n in numbers) >= 500
    (True, True)
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, _KEY]))
    order = {role: rng.permutation(range(UNPUBLISHED, 1000)) for role in _FIRST}
    taken = dict.fromkeys(_FIRST, 0)
    found = []
    for k in range(count):
        role = GROUPS[k % len(GROUPS)]
        found.append(_FIRST[role] + int(order[role][taken[role]]))
        taken[role] += 1
    return tuple(found)


def make(
    folder: Path, settings: MakeSettings, *, say: Callable[[str], None] = lambda line: None
) -> Suite:
    """Write a suite, or what is missing of it.

    Parameters
    ----------
    folder : Path
        Folder of the suite. ``sealed`` in it is for the organiser alone.
    settings : MakeSettings
        Cases and secret.
    say : callable
        Is given a line for each case.

    Returns
    -------
    Suite
        What entrants are told.

    Raises
    ------
    InvalidSetting
        If the folder holds a suite of another secret or of other cases.
    """
    secret = _secret(folder, settings)
    seed = int(secret.seed, 16)
    entries: dict[str, CaseEntry] = {}
    commitments: dict[str, str] = {}
    truths = folder / "sealed" / "truth"
    # in the order of the names, so that times of files tell nothing
    for count, name in enumerate(sorted(secret.numbers), start=1):
        number = secret.numbers[name]
        case = draw_case(number, seed=seed)
        if not is_written(number, name, recordings=folder / "recordings", truth=truths):
            write_case(case, recordings=folder / "recordings", truth=truths)
        dataset = folder / "lerobot" / name
        if not dataset.is_dir():
            write_lerobot(dataset, read_recording(folder / "recordings" / name))
        entries[name] = _entry(case, number)
        commitments[name] = commitment(secret.salts[name], (truths / f"{name}.json").read_bytes())
        say(f"{name}: {count} of {len(secret.numbers)}")
    suite = Suite(
        name=settings.name or folder.resolve().name,
        identity=hashlib.sha256("\n".join(sorted(entries)).encode()).hexdigest()[:12],
        cases=entries,
        kinds=catalogue(),
    )
    _write(folder / PROTOCOL, dataclasses.asdict(suite))
    _write(folder / COMMITMENTS, {"format": COMMITTED, "sha256": commitments})
    return suite


def commitment(salt: str, truth: bytes) -> str:
    """SHA-256 of a salt followed by a file of truth, in hexadecimal digits.

    Examples
    --------
    >>> commitment("00ff", b"{}")[:8]
    'd74d568b'
    """
    return hashlib.sha256(bytes.fromhex(salt) + truth).hexdigest()


def open_truths(folder: Path, suite: Suite) -> tuple[dict[str, dict[str, Any]], Secret]:
    """Truths of a suite by case, each checked against its commitment.

    Raises
    ------
    InvalidData
        If one is missing, or is not the one that was committed to.
    """
    secret = _read(folder / SECRET, Secret, SEALED, "secret")
    sealed = _read(folder / COMMITMENTS, _Commitments, COMMITTED, "file of commitments").sha256
    found = {}
    for name in suite.cases:
        path = folder / "sealed" / "truth" / f"{name}.json"
        if not path.is_file():
            raise InvalidData(f"{path}: the sealed truth is missing; only its organiser can score")
        if name not in sealed or name not in secret.salts:
            raise InvalidData(f"{folder / COMMITMENTS}: there is no commitment for {name}")
        if commitment(secret.salts[name], path.read_bytes()) != sealed[name]:
            raise InvalidData(f"{path}: the truth is not the one committed to in {COMMITMENTS}")
        found[name] = json.loads(path.read_text("utf-8"))
    return found, secret


def read_suite(folder: Path) -> Suite:
    """Read ``protocol.json`` of a suite.

    Raises
    ------
    InvalidData
        If it is missing or damaged.
    """
    suite: Suite = _read(folder / PROTOCOL, Suite, FORMAT, "protocol")
    return suite


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Commitments:
    sha256: Mapping[str, str]


def _read(path: Path, kind: type[Any], format: str, noun: str) -> Any:
    return read_result_file(
        path, lambda text: restored(kind, whole_of(text, format=format, noun=noun), noun), noun=noun
    )


def _secret(folder: Path, settings: MakeSettings) -> Secret:
    """The secret in the folder, or a new one, written before anything else."""
    path = folder / SECRET
    if path.is_file():
        there: Secret = _read(path, Secret, SEALED, "secret")
        seed = int(there.seed, 16)
        asked = settings.numbers or drawn_numbers(settings.cases, seed)
        other = settings.seed_phrase and seed_of(settings.seed_phrase) != seed
        if other or set(asked) != set(there.numbers.values()):
            raise InvalidSetting(
                f"{folder} holds a suite of {'another secret' if other else 'other cases'}; give "
                "the options it was made with, or another folder"
            )
        return there
    seed = seed_of(settings.seed_phrase or secrets.token_hex(32))
    if seed == SEED:
        raise InvalidSetting("this phrase gives the published seed; take another one")
    numbers = settings.numbers or drawn_numbers(settings.cases, seed)
    by_name = {name_of(number, seed=seed): number for number in numbers}
    secret = Secret(
        seed=f"{seed:x}",
        numbers=dict(sorted(by_name.items())),
        salts={name: secrets.token_hex(32) for name in sorted(by_name)},
    )
    folder.joinpath("sealed").mkdir(parents=True, exist_ok=True)
    os.chmod(folder / "sealed", 0o700)
    _write(path, dataclasses.asdict(secret))
    return secret


def _entry(case: Case, number: int) -> CaseEntry:
    runs = tuple(f"run-{k + 1:02d}.parquet" for k in range(len(case.motions)))
    # of a machine with runs of two forms in turn, one of each
    held_out = runs[-2:] if case.form == MIXED else runs[HELD_OUT:]
    places: Mapping[str, Sequence[str]] = places_of(case.arm.figures, drives=case.form != FREE)
    return CaseEntry(
        tolerance=tolerance_of(number),
        sample_rate_hz=round(1.0 / SAMPLE, 6),
        runs=runs,
        held_out=held_out,
        places={group: tuple(names) for group, names in places.items()},
    )


def _write(path: Path, whole: Mapping[str, Any]) -> None:
    write_text(path, json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
