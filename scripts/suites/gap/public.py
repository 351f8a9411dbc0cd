"""Public benchmark of missing physics: make a suite, answer it, score answers, leaderboard.

    python -m scripts.suites.gap.public make FOLDER [--cases 12]      # FOLDER/sealed is kept back
    python -m scripts.suites.gap.public answer RECORDING OUT          # run loose gap on a recording
    python -m scripts.suites.gap.public score FOLDER RESULTS --name NAME
    python -m scripts.suites.gap.public board [SCORES ...] [--docs]

docs/accuracy.md describes the formats.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import os
import secrets
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import TypeAdapter
from tyro.conf import Positional

from loose_env.cli.command import Actions, commands
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.evaluation import expected_calibration_error
from loose_env.gap import GapResult, GapSettings, explain_gap
from loose_env.io import (
    Count,
    json_text,
    nearest,
    read_result_file,
    restored,
    whole_of,
    write_text,
)
from loose_env.recording import read_recording
from scripts.study import write_between
from scripts.suites.gap.arms import Figures
from scripts.suites.gap.cases import (
    HELD_OUT,
    SEED,
    Case,
    draw_case,
    is_written,
    name_of,
    numbers_of,
    tolerance_of,
    write_case,
)
from scripts.suites.gap.dynamics import SAMPLE
from scripts.suites.gap.effects import FREE, MIXED
from scripts.suites.gap.grading import (
    NAMED,
    OTHERS,
    PARAMETERS,
    SAID,
    grade,
    judged_intervals,
    matched,
    parameter_error,
    separable_by_data,
)
from scripts.suites.gap.run import stated

ANSWER, SCORE = "gap-answer/1", "gap-score/1"
"""Formats of an answer and of ``score.json``."""
PROTOCOL, COMMITMENTS, SECRET = "protocol.json", "commitments.json", "sealed/secret.json"
"""Files of a suite; what lies in ``sealed`` is kept back."""
FORMAT, COMMITTED, SEALED = "gap-benchmark/1", "gap-commitments/1", "gap-sealed/1"
"""Formats of these files."""


# ---------------------------------------------------------------------- kinds and locations


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of effect, as an answer may name it."""

    at: tuple[str, ...]
    """Groups of locations where it can be: keys of `places_of`."""
    about: str
    """The effect, in one line."""
    parameters: Mapping[str, str]
    """Unit of each parameter, "" for a ratio; the second unit is that of a sliding joint."""
    scored: tuple[str, ...] = ()
    """Parameters whose error counts, as one vector."""
    covered: tuple[str, ...] = ()
    """Further parameters whose intervals count."""


def places_of(figures: Figures, *, drives: bool) -> dict[str, list[str]]:
    """Locations of an arm by group."""
    numbers = range(1, figures.joints + 1)
    return {
        "joint": [f"joint{k}" for k in numbers],
        "link": [f"link{k}" for k in numbers],
        "actuator": [f"motor{k}" for k in numbers] if drives else [],
        "encoder": [f"joint{k}_{what}" for k in numbers for what in ("pos", "vel")],
        "accelerometer": ["tool_acc"],
        "tool": ["tool"],
        "base": ["base"],
        "all": ["all"],
    }


def catalogue() -> dict[str, Kind]:
    """All kinds by name."""
    found = {}
    for name, (at, about, units) in _KINDS.items():
        scored = [SAID.get(name, {}).get(each, each) for each in PARAMETERS[name]]
        found[name] = Kind(
            at=tuple(at.split()),
            about=about,
            parameters=dict(units),
            scored=tuple(each for each in scored if each in units),
            covered=tuple(each for each in OTHERS.get(name, {}) if each in units),
        )
    return found


_FORCE = "N·m or N"
_ANGLE = "rad or m"
_SPEED = "rad/s or m/s"
_SPRING = "N·m/rad or N/m"
_XYZ = {axis: "m" for axis in "xyz"}

_KINDS: dict[str, tuple[str, str, dict[str, str]]] = {
    "viscous_friction": ("joint", "friction torque proportional to speed",
        {"damping": "N·m·s/rad or N·s/m"}),
    "coulomb_friction": ("joint", "dry friction of constant size against the motion",
        {"torque": _FORCE}),
    "stribeck_friction": ("joint", "dry friction, static_ratio times larger near rest",
        {"torque": _FORCE, "static_ratio": "", "speed": _SPEED}),
    "quadratic_drag": ("joint", "friction torque proportional to speed squared",
        {"drag": "N·m·s²/rad² or N·s²/m²"}),
    "joint_compliance": ("joint", "elastic gear between motor and link",
        {"stiffness": _SPRING, "damping_ratio": ""}),
    "backlash": ("joint", "free travel between motor and link, stop to stop",
        {"gap": _ANGLE, "stiffness": _SPRING, "damping_ratio": "", "friction": _FORCE}),
    "structural_looseness": ("link", "link that slides in its seat between stops",
        {"gap": "m", "friction": "N", "stiffness": "N/m", "damping_ratio": "", "angle": "rad",
         "azimuth": "rad", "elevation": "rad"}),
    "link_flexibility": ("link", "link that bends; position as a share of its length",
        {"stiffness": "N·m/rad", "damping_ratio": "", "position": ""}),
    "link_mass": ("link", "mass beyond that of the model", {"mass": "kg"}),
    "link_com": ("link", "shift of the centre of mass, in the link's frame", _XYZ),
    "payload": ("tool", "point mass at the tool; x, y, z from the site `tool`",
        {"mass": "kg", **_XYZ}),
    "rotor_inertia": ("joint", "inertia about the joint beyond that of the model",
        {"inertia": "kg·m² or kg"}),
    "actuator_gain": ("actuator", "true over nominal servo gains", {"gain": ""}),
    "actuator_lag": ("actuator", "first-order lag of the drive", {"time_constant": "s"}),
    "command_delay": ("actuator all", "dead time of the command; `all` for all actuators alike",
        {"delay": "s"}),
    "encoder_offset": ("joint", "zero of the encoder", {"offset": _ANGLE}),
    "sensor_misalignment": ("accelerometer", "rotation vector of the sensor, in its own frame",
        {f"turn_{axis}": "rad" for axis in "xyz"}),
    "sensor_gain": ("encoder accelerometer", "reading over truth", {"gain": ""}),
    "sensor_bias": ("encoder accelerometer",
        "constant in the reading; bias of an encoder, bias_x to bias_z of an accelerometer",
        {"bias": "rad or m, rad/s or m/s", **{f"bias_{axis}": "m/s²" for axis in "xyz"}}),
    "sensor_delay": ("encoder accelerometer", "dead time of the reading", {"delay": "s"}),
    "base_tilt": ("base", "rotation vector by which the base is tilted",
        {"tilt_x": "rad", "tilt_y": "rad"}),
    "torque_ripple": ("joint", "amplitude · sin(periods · angle + phase)",
        {"amplitude": _FORCE, "periods": "1/turn or 1/m", "phase": "rad"}),
    "joint_spring": ("joint", "spring to the ground side with its rest position",
        {"stiffness": _SPRING, "reference": _ANGLE}),
    "load_friction": ("joint", "dry friction as a share of the transmitted torque",
        {"share": "", "static_ratio": "", "speed": _SPEED, "load_share": ""}),
    "asymmetric_friction": ("joint", "dry friction that differs by direction",
        {"forward": _FORCE, "backward": _FORCE}),
    "torque_limit": ("actuator", "largest torque of the drive", {"limit": _FORCE}),
    "voltage_limit": ("actuator", "torque limit that falls with speed",
        {"stall_torque": _FORCE, "no_load_speed": _SPEED}),
    "dead_zone": ("actuator", "servo error without a torque, half its width",
        {"width": _ANGLE}),
    "gravity_compensation": ("link all", "share of the weight that something else carries",
        {"share": ""}),
    "torque_constant": ("joint", "measured over true torque", {"factor": ""}),
    "base_compliance": ("base", "base on a rotational spring",
        {"stiffness": "N·m/rad", "damping_ratio": ""}),
    "gear_eccentricity": ("joint", "encoder error once a turn: sine · sin + cosine · cos of angle",
        {"sine": "rad", "cosine": "rad"}),
    "sensor_quantisation": ("encoder", "step to which the reading is rounded",
        {"step": "rad or m, rad/s or m/s"}),
}  # fmt: skip
"""Groups of locations, description, parameters with units."""


# ---------------------------------------------------------------------------- making a suite

GROUPS = ("none", "single", "pair", "single", "outside", "none", "single", "pair", "single",
          "triple", "none", "single")  # fmt: skip
"""Groups of the cases of a suite, again and again."""
UNPUBLISHED = 500
"""First number within a group that the published suite does not use."""
_KEY = 5  # of the random numbers that choose cases, beside those of a case
_FIRST = {"none": 0, "single": 1000, "pair": 2000, "outside": 3000, "triple": 4000}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Made:
    """Write a suite, or what is missing of it."""

    folder: Positional[Path]
    """Folder of the suite."""
    cases: Count = 12
    """Number of cases, drawn from numbers that the published suite does not use."""
    numbers: tuple[str, ...] = ()
    """Chosen cases, as in 1901 or 300-302, in place of drawn ones."""
    seed_phrase: str = ""
    """All is drawn from it; by default one is drawn and kept in FOLDER/sealed."""
    name: str = ""
    """Name of the suite; by default that of FOLDER."""


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
    """Seed of a phrase."""
    return int.from_bytes(hashlib.sha256(phrase.encode("utf-8")).digest()[:16], "big")


def drawn_numbers(count: int, seed: int) -> tuple[int, ...]:
    """Numbers of cases, of the groups of `GROUPS` in turn."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, _KEY]))
    order = {role: rng.permutation(range(UNPUBLISHED, 1000)) for role in _FIRST}
    taken = dict.fromkeys(_FIRST, 0)
    found = []
    for k in range(count):
        role = GROUPS[k % len(GROUPS)]
        found.append(_FIRST[role] + int(order[role][taken[role]]))
        taken[role] += 1
    return tuple(found)


def make(given: Made) -> Suite:
    """Write a suite, or what is missing of it."""
    folder, secret = given.folder, _secret(given)
    seed = int(secret.seed, 16)
    entries: dict[str, CaseEntry] = {}
    commitments: dict[str, str] = {}
    truths = folder / "sealed" / "truth"
    # in the order of the names, so that times of files tell nothing
    for count, name in enumerate(sorted(secret.numbers), start=1):
        number = secret.numbers[name]
        case = draw_case(number, seed=seed)
        if not is_written(name, recordings=folder / "recordings", truth=truths):
            write_case(case, recordings=folder / "recordings", truth=truths)
        entries[name] = _entry(case, number)
        commitments[name] = commitment(secret.salts[name], (truths / f"{name}.json").read_bytes())
        print(f"{name}: {count} of {len(secret.numbers)}", file=sys.stderr)
    suite = Suite(
        name=given.name or folder.resolve().name,
        identity=hashlib.sha256("\n".join(sorted(entries)).encode()).hexdigest()[:12],
        cases=entries,
        kinds=catalogue(),
    )
    _write(folder / PROTOCOL, dataclasses.asdict(suite))
    _write(folder / COMMITMENTS, {"format": COMMITTED, "sha256": commitments})
    _write(folder / "answer.schema.json", answer_schema(suite.kinds))
    print(f"{folder}: {len(suite.cases)} cases, suite {suite.identity}")
    print(f"keep back: {folder / 'sealed'}")
    return suite


def commitment(salt: str, truth: bytes) -> str:
    """SHA-256 of a salt followed by a file of truth, in hexadecimal digits."""
    return hashlib.sha256(bytes.fromhex(salt) + truth).hexdigest()


def open_truths(folder: Path, suite: Suite) -> tuple[dict[str, dict[str, Any]], Secret]:
    """Truths of a suite by case, each checked against its commitment."""
    secret = _read(folder / SECRET, Secret, SEALED, "secret")
    committed = (folder / COMMITMENTS).read_text("utf-8")
    sealed = whole_of(committed, format=COMMITTED, noun="file of commitments")["sha256"]
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
    """Read ``protocol.json`` of a suite."""
    suite: Suite = _read(folder / PROTOCOL, Suite, FORMAT, "protocol")
    return suite


def _read(path: Path, kind: type[Any], format: str, noun: str) -> Any:
    return read_result_file(
        path, lambda text: restored(kind, whole_of(text, format=format, noun=noun), noun), noun=noun
    )


def _secret(given: Made) -> Secret:
    """The secret in the folder, or a new one, written before anything else."""
    path, asked = given.folder / SECRET, tuple(numbers_of(given.numbers))
    if path.is_file():
        there: Secret = _read(path, Secret, SEALED, "secret")
        seed = int(there.seed, 16)
        other = given.seed_phrase and seed_of(given.seed_phrase) != seed
        if other or set(asked or drawn_numbers(given.cases, seed)) != set(there.numbers.values()):
            raise InvalidSetting(
                f"{given.folder} holds a suite of {'another secret' if other else 'other cases'}; "
                "give the options it was made with, or another folder"
            )
        return there
    seed = seed_of(given.seed_phrase or secrets.token_hex(32))
    if seed == SEED:
        raise InvalidSetting("this phrase gives the published seed; take another one")
    numbers = asked or drawn_numbers(given.cases, seed)
    by_name = {name_of(number, seed=seed): number for number in numbers}
    secret = Secret(
        seed=f"{seed:x}",
        numbers=dict(sorted(by_name.items())),
        salts={name: secrets.token_hex(32) for name in sorted(by_name)},
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    os.chmod(path.parent, 0o700)
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


# ------------------------------------------------------------------------------- answers


@dataclasses.dataclass(frozen=True, kw_only=True)
class Answered:
    """An effect that an answer names."""

    kind: str
    """Kind, of the catalogue in ``protocol.json``."""
    where: str
    """Location, of the case's locations in ``protocol.json``."""
    parameters: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Values, in the units of the catalogue; any may be left out."""
    interval_95: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    """Ends of 95 % intervals; any may be left out."""
    probability: float = 1.0
    """Probability that the effect is there, of this kind at this location."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Answer:
    """An answer for one case."""

    verdict: Literal["no_gap", "named", "unexplained"]
    """``no_gap``: nothing is missing; ``named``: `effects` are missing; ``unexplained``: something
    is missing that the catalogue does not have."""
    effects: tuple[Answered, ...] = ()
    """Effects, where the verdict is ``named``."""
    cpu_seconds: float | None = None
    """Processor time spent on the case [s]."""
    format: str = ANSWER
    """Format of the file."""

    def to_json(self) -> str:
        """Text of the file."""
        return json_text(dataclasses.asdict(self))


def read_answer(path: Path, case: CaseEntry, kinds: Mapping[str, Kind]) -> Answer:
    """Read an answer and check it against the protocol."""

    def parse(text: str) -> Answer:
        whole = whole_of(text, format=ANSWER, noun="answer")
        answer = restored(Answer, whole, "answer")
        _check_keys("answer", whole, Answer)
        for k, each in enumerate(whole.get("effects", ())):
            _check_keys(f"answer.effects[{k}]", each, Answered)
        if wrong := _wrong(answer, case, kinds):
            raise InvalidData(f"answer{wrong}")
        return answer

    return read_result_file(path, parse, noun="answer")


def read_answers(folder: Path, suite: Suite) -> dict[str, Answer]:
    """Read the answers to all cases of a suite, ``CASE.json`` each."""
    if not folder.is_dir():
        raise InvalidData(f"{folder}: there is no such folder of answers, one CASE.json a case")
    for strange in sorted({path.stem for path in folder.glob("*.json")} - {*suite.cases, "score"}):
        raise InvalidData(
            f"{folder / strange}.json: the suite has no case {strange!r}"
            f"{nearest(strange, list(suite.cases))}"
        )
    return {
        name: read_answer(folder / f"{name}.json", entry, suite.kinds)
        for name, entry in suite.cases.items()
    }


def _check_keys(place: str, given: Mapping[str, Any], kind: type[Answer | Answered]) -> None:
    """Refuse misspelt keys, which would else be passed over."""
    known = [each.name for each in dataclasses.fields(kind)]
    for key in given:
        if key not in known:
            raise InvalidData(
                f"{place}: {key!r:.60} is no key of it{nearest(key, known)}; "
                f"keys: {', '.join(known)}"
            )


def _wrong(answer: Answer, case: CaseEntry, kinds: Mapping[str, Kind]) -> str:
    """What of an answer the protocol does not allow, with its place; "" where it allows all."""
    if (answer.verdict == NAMED) != bool(answer.effects):
        return (
            f": the verdict is {answer.verdict!r} with {len(answer.effects)} effects; "
            "'named' has one or more, the others have none"
        )
    if answer.cpu_seconds is not None and not 0 <= answer.cpu_seconds < math.inf:
        return ".cpu_seconds: a time of 0 s or more is needed, or null"
    seen: set[tuple[str, str]] = set()
    for k, effect in enumerate(answer.effects):
        own = f".effects[{k}]"
        if effect.kind not in kinds:
            return (
                f"{own}.kind: {effect.kind!r:.60} is no kind of the catalogue in protocol.json"
                f"{nearest(effect.kind, list(kinds))}"
            )
        kind = kinds[effect.kind]
        allowed = [name for group in kind.at for name in case.places[group]]
        if effect.where not in allowed:
            return (
                f"{own}.where: {effect.kind} is not at {effect.where!r:.60}; "
                f"allowed: {', '.join(allowed) or 'nowhere in this case'}"
            )
        if (effect.kind, effect.where) in seen:
            return f"{own}: {effect.kind} at {effect.where} is named twice"
        seen.add((effect.kind, effect.where))
        singles = {name: (value,) for name, value in effect.parameters.items()}
        for part, numbers in (("parameters", singles), ("interval_95", effect.interval_95)):
            for name, values in numbers.items():
                if name not in kind.parameters:
                    known = ", ".join(kind.parameters)
                    return (
                        f"{own}.{part}.{name}: {effect.kind} has no such parameter; it has {known}"
                    )
                if not all(map(math.isfinite, values)):
                    return f"{own}.{part}.{name}: a finite number is needed; leave out unknown ones"
                if values[0] > values[-1]:
                    return f"{own}.{part}.{name}: the lower end comes first"
        if not 0.0 <= effect.probability <= 1.0:
            return f"{own}.probability: a number from 0 to 1 is needed"
    return ""


def answer_of(result: GapResult, *, cpu_seconds: float | None = None) -> Answer:
    """Answer of a result of ``loose gap``."""
    effects = tuple(
        Answered(
            kind=effect.kind,
            where=effect.where,
            parameters={n: value for n, value in effect.parameters.items() if math.isfinite(value)},
            interval_95={
                n: ends for n, ends in effect.interval_95.items() if np.isfinite(ends).all()
            },
            probability=0.95 / (1 + len(effect.ambiguous_with))
            if effect.probability is None
            else effect.probability,
        )
        for effect in result.effects
        if result.verdict == NAMED
    )
    return Answer(verdict=result.verdict, effects=effects, cpu_seconds=cpu_seconds)


def answer_schema(kinds: Mapping[str, Kind]) -> dict[str, Any]:
    """JSON Schema (2020-12) of an answer; locations are checked against the case beside it."""
    schema = TypeAdapter(Answer).json_schema()
    schema["properties"]["format"] = {"const": ANSWER}
    schema["$defs"]["Answered"]["properties"]["kind"] = {"enum": list(kinds)}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": ANSWER,
        "required": ["format", "verdict"],
    }


@dataclasses.dataclass(frozen=True, kw_only=True)
class Asked:
    """Run loose gap on a recording."""

    recording: Positional[Path]
    """Folder of the recording."""
    out: Positional[Path]
    """File, or folder for CASE.json."""
    tolerance: float = 0.03
    """Largest relative error of the nominal parameters, as protocol.json says."""


def _answer(given: Asked) -> None:
    began = time.process_time()
    settings = GapSettings(threads=1, tolerances=stated(given.tolerance))
    result = explain_gap(read_recording(given.recording), settings)
    answer = answer_of(result, cpu_seconds=round(time.process_time() - began, 1))
    file = given.out
    if file.suffix != ".json":
        file = file / f"{given.recording.resolve().name}.json"
    print(f"{write_text(file, answer.to_json())}: {answer.verdict}")


# -------------------------------------------------------------------------------- scores

BINS = 5
"""Bins of the calibration error: a suite has some tens of named effects."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Hits:
    """Hits among trials."""

    hits: int = 0
    """Trials that were right."""
    of: int = 0
    """All trials."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class CaseScore:
    """Marks of one case. They tell the truth: written only for suites that are open."""

    case: str
    """Name of the recording."""
    group: str
    """`none`, `single`, `pair`, `triple`, `outside` or `machine`."""
    truth: tuple[str, ...]
    """True effects, ``kind@where``."""
    answered: tuple[str, ...]
    """Named effects, ``kind@where``; the verdict alone where none is named."""
    right: bool
    """Verdict, kinds and locations all right, none too many."""
    found: int
    """Named effects that are there."""
    named: int
    """Named effects."""
    true: int
    """Effects that are there."""
    brier: float
    """Sum of (p - y)² over effects named or there; p is 0 for one that is not named."""
    probabilities: tuple[float, ...] = ()
    """Probabilities of the named effects."""
    hits: tuple[bool, ...] = ()
    """Whether each of them is there."""
    parameter_error: tuple[float, ...] = ()
    """Relative error of the parameters of each effect named by its own name."""
    covered: tuple[bool, ...] = ()
    """Whether each 95 % interval holds the truth."""
    cpu_seconds: float = math.nan
    """Processor time [s], NaN if not told."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Score:
    """The content of ``score.json``."""

    name: str
    """Name of the entry."""
    suite: str
    """Name of the suite."""
    identity: str
    """Identity of the suite: scores of different ones are not compared."""
    right: Hits
    """Cases that are right in everything."""
    groups: Mapping[str, Hits]
    """The same by group of cases."""
    found: int
    """TP: named effects that are there."""
    named: int
    """TP + FP: named effects."""
    true: int
    """TP + FN: effects of the catalogue that are there."""
    precision: float
    """TP / (TP + FP); NaN where nothing is named."""
    recall: float
    """TP / (TP + FN)."""
    f1: float
    """2 TP / (2 TP + FP + FN)."""
    false_alarms: Hits
    """Cases with nothing missing that were not answered ``no_gap``."""
    brier: float
    """Sum of (p - y)² over effects named or there, over the number of cases."""
    calibration_error: float
    """Expected calibration error of the probabilities, in `BINS` bins; NaN where none is named."""
    parameter_error: float
    """Median relative error of the parameters; NaN where none was right."""
    coverage: Hits
    """95 % intervals that hold the truth."""
    cpu_seconds: float
    """Median processor time of a case [s]; NaN if not told for every case."""
    cases: tuple[CaseScore, ...] = ()
    """Marks by case, of an open suite."""
    format: str = SCORE
    """Format of the file."""


def score(folder: Path, answers: Path, *, name: str = "", opened: bool = False) -> Score:
    """Grade the answers to a suite, whose truths are checked against their commitments."""
    suite = read_suite(folder)
    given = read_answers(answers, suite)
    truths, secret = open_truths(folder, suite)
    cases = []
    for case, answer in given.items():
        ask = separable_by_data(secret.numbers[case], seed=int(secret.seed, 16))
        cases.append(mark_case(answer, truths[case], separable=functools.cache(ask)))
    found = total(
        cases, name=name or answers.resolve().name, suite=suite.name, identity=suite.identity
    )
    return found if opened else dataclasses.replace(found, cases=())


def mark_case(
    answer: Answer,
    truth: Mapping[str, Any],
    *,
    separable: Any = lambda effect, named: True,
) -> CaseScore:
    """Mark one answer."""
    whole = dataclasses.asdict(answer) | {"format": "loose-gap/1", "gap": None}
    marks = grade(whole, truth, separable=separable)
    # grading takes an effect outside the catalogue for one that cannot be named
    true = () if marks.role == "outside" else marks.truth
    effects = answer.effects if answer.verdict == NAMED else ()
    match = matched(true, marks.said, separable, one_by_one=marks.role == "machine")
    own = [
        (truth["effects"][i], dataclasses.asdict(effects[j]))
        for i, j in match.items()
        if true[i] == marks.said[j]
    ]
    hits = tuple(j in match.values() for j in range(len(effects)))
    misses = len(true) - len(match)
    probabilities = tuple(effect.probability for effect in effects)
    return CaseScore(
        case=marks.case,
        group=marks.role,
        truth=tuple(f"{kind}@{where}" for kind, where in marks.truth),
        answered=tuple(f"{kind}@{where}" for kind, where in marks.said) or (answer.verdict,),
        right=marks.right,
        found=len(match),
        named=len(effects),
        true=len(true),
        brier=misses + sum((p - hit) ** 2 for p, hit in zip(probabilities, hits, strict=True)),
        probabilities=probabilities,
        hits=hits,
        parameter_error=tuple(e for each in own if math.isfinite(e := parameter_error(*each))),
        covered=tuple(judged.held for each in own for judged in judged_intervals(*each)),
        cpu_seconds=math.nan if answer.cpu_seconds is None else answer.cpu_seconds,
    )


def total(cases: Sequence[CaseScore], *, name: str, suite: str, identity: str) -> Score:
    """Micro-averages over all effects of all cases."""
    found, named, true = (
        sum(getattr(c, what) for c in cases) for what in ("found", "named", "true")
    )
    errors = [error for case in cases for error in case.parameter_error]
    covered = [held for case in cases for held in case.covered]
    healthy = [case for case in cases if case.group == "none"]
    groups = {
        group: _hits([case.right for case in cases if case.group == group])
        for group in dict.fromkeys(case.group for case in cases)
    }
    return Score(
        name=name,
        suite=suite,
        identity=identity,
        right=_hits([case.right for case in cases]),
        groups=dict(sorted(groups.items())),
        found=found,
        named=named,
        true=true,
        precision=_ratio(found, named),
        recall=_ratio(found, true),
        f1=_ratio(2 * found, named + true),
        false_alarms=_hits([not case.right for case in healthy]),
        brier=_ratio(sum(case.brier for case in cases), len(cases)),
        calibration_error=expected_calibration_error(
            [p for case in cases for p in case.probabilities],
            [hit for case in cases for hit in case.hits],
            bins=BINS,
        ),
        parameter_error=float(np.median(errors)) if errors else math.nan,
        coverage=_hits(covered),
        cpu_seconds=float(np.median([case.cpu_seconds for case in cases])) if cases else math.nan,
        cases=tuple(cases),
    )


def _hits(trials: Sequence[bool]) -> Hits:
    return Hits(hits=sum(trials), of=len(trials))


def _ratio(hits: float, of: float) -> float:
    return hits / of if of else math.nan


def number(value: float, *, digits: int = 2) -> str:
    """A number with so many decimals, "-" where there is none."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


PAGE = Path(__file__).resolve().parents[3] / "docs" / "accuracy.md"
"""Page of the leaderboard; scores lie in the folder of its name beside it."""
COLUMNS: dict[str, Callable[[Score], str]] = {
    "entry": lambda score: score.name.replace("|", "\\|"),
    "cases right": lambda score: _of(score.right),
    "precision": lambda score: number(score.precision),
    "recall": lambda score: number(score.recall),
    "F1": lambda score: number(score.f1),
    "false alarms": lambda score: _of(score.false_alarms),
    "Brier": lambda score: number(score.brier),
    "calibration error": lambda score: number(score.calibration_error),
    "parameter error": lambda score: number(score.parameter_error, digits=3),
    "coverage": lambda score: _of(score.coverage),
    "CPU [s]": lambda score: number(score.cpu_seconds, digits=0),
}
"""Columns of the leaderboard."""


def read_score(path: Path) -> Score:
    """Read ``score.json``."""
    found: Score = _read(path, Score, SCORE, "score")
    return found


def stored_scores() -> list[Path]:
    """Score files of the repository."""
    return sorted(PAGE.with_name("gap_benchmark").glob("*.json"))


def leaderboard(scores: Sequence[Score]) -> str:
    """Scores as Markdown, the best F1 first, a table for each suite."""
    if not scores:
        raise InvalidData("there are no scores; give files that the command score has written")
    parts = []
    for identity in dict.fromkeys(each.identity for each in scores):
        own = [each for each in scores if each.identity == identity]
        names = [each.name for each in own]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InvalidData(f"two entries are called {twice[0]!r}; score one with another --name")
        first = own[0]
        parts.append(
            f"Suite `{first.suite}` (`{identity}`): {first.right.of} cases, {first.true} effects "
            "of the catalogue."
        )
        own.sort(key=lambda each: (-each.f1 if each.f1 == each.f1 else 1.0, each.brier, each.name))
        lines = [" | ".join(COLUMNS), " | ".join(["---", *["---:"] * (len(COLUMNS) - 1)])]
        lines += [" | ".join(cell(each) for cell in COLUMNS.values()) for each in own]
        parts.append("\n".join(f"| {line} |" for line in lines))
    return "\n\n".join(parts)


def _of(count: Hits) -> str:
    return f"{count.hits}/{count.of}" if count.of else "-"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scored:
    """Grade answers; writes RESULTS/score.json."""

    folder: Positional[Path]
    """Folder of the suite."""
    results: Positional[Path]
    """Folder of CASE.json."""
    name: str = ""
    """Name of the entry; by default that of RESULTS."""
    open: bool = False
    """Also write marks by case, which tell the truths."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Board:
    """Leaderboard of stored scores."""

    scores: Positional[tuple[Path, ...]] = ()
    """Files of scores; by default those beside the page."""
    docs: bool = False
    """Write it to docs/accuracy.md."""


def _score(given: Scored) -> None:
    found = score(given.folder, given.results, name=given.name, opened=given.open)
    groups = (f"{group} {_of(count)}" for group, count in found.groups.items())
    print(leaderboard([found]), f"Cases right by group: {', '.join(groups)}.", sep="\n\n")
    for case in found.cases:
        print(
            f"{case.case}  {'right' if case.right else 'WRONG'}  true "
            f"{' + '.join(case.truth) or 'nothing'}  answered {' + '.join(case.answered)}"
        )
    file = write_text(given.results / "score.json", json_text(dataclasses.asdict(found)))
    print(file, file=sys.stderr)


def _board(given: Board) -> None:
    board = leaderboard([read_score(path) for path in given.scores or stored_scores()])
    print(board)
    if given.docs:
        write_between(PAGE, board, name="leaderboard")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    actions: Actions = {
        "make": (Made, make),
        "answer": (Asked, _answer),
        "score": (Scored, _score),
        "board": (Board, _board),
    }
    commands("gap benchmark", __doc__, actions, arguments, interrupted="the same command goes on")


if __name__ == "__main__":
    main()
