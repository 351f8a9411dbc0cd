"""The public suite: recordings without their truths, and the answers to them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import secrets
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap import GapResult
from loose_env.io import json_text, read_result_file, restored, whole_of, write_text
from scripts.suites.gap.arms import Figures
from scripts.suites.gap.cases import (
    HELD_OUT,
    LAST,
    SEED,
    Case,
    draw_case,
    is_written,
    name_of,
    tolerance_of,
    write_case,
)
from scripts.suites.gap.dynamics import SAMPLE
from scripts.suites.gap.effects import FREE, MIXED
from scripts.suites.gap.grading import OTHERS, PARAMETERS, SAID


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
    return {
        name: Kind(
            at=tuple(at.split()),
            about=about,
            parameters=dict(parameters),
            scored=_scored(name, parameters),
            covered=tuple(each for each in OTHERS.get(name, {}) if each in parameters),
        )
        for name, (at, about, parameters) in _KINDS.items()
    }


def _scored(kind: str, parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Names in an answer of the parameters by which a kind is judged in the truth."""
    words = SAID.get(kind, {})
    names = [words.get(each, each) for each in PARAMETERS[kind]]
    return tuple(name for name in names if name in parameters)


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


def make(
    folder: Path, settings: MakeSettings, *, say: Callable[[str], None] = lambda line: None
) -> Suite:
    """Write a suite, or what is missing of it."""
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
    """SHA-256 of a salt followed by a file of truth, in hexadecimal digits."""
    return hashlib.sha256(bytes.fromhex(salt) + truth).hexdigest()


def open_truths(folder: Path, suite: Suite) -> tuple[dict[str, dict[str, Any]], Secret]:
    """Truths of a suite by case, each checked against its commitment."""
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
    """Read ``protocol.json`` of a suite."""
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


ANSWER_FORMAT = "gap-answer/1"
"""Format of an answer."""
Verdict = Literal["no_gap", "named", "unexplained"]
VERDICTS = ("no_gap", "named", "unexplained")
_CONFIDENT = 1.0


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
    probability: float = _CONFIDENT
    """Probability that the effect is there, of this kind at this location."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Answer:
    """An answer for one case."""

    verdict: Verdict
    """``no_gap``: nothing is missing; ``named``: `effects` are missing; ``unexplained``: something
    is missing that the catalogue does not have."""
    effects: tuple[Answered, ...] = ()
    """Effects, where the verdict is ``named``."""
    cpu_seconds: float | None = None
    """Processor time spent on the case [s]."""
    format: str = ANSWER_FORMAT
    """Format of the file."""

    def to_json(self) -> str:
        """Text of the file."""
        return json_text(dataclasses.asdict(self))

    def as_result(self) -> dict[str, Any]:
        """The same as a result of format ``loose-gap/1``, which `grading.grade` takes."""
        effects = [dataclasses.asdict(effect) for effect in self.effects]
        return {"format": "loose-gap/1", "verdict": self.verdict, "effects": effects, "gap": None}


def read_answer(path: Path, case: CaseEntry, kinds: Mapping[str, Kind]) -> Answer:
    """Read an answer and check it against the protocol."""

    def parse(text: str) -> Answer:
        whole = whole_of(text, format=ANSWER_FORMAT, noun="answer")
        answer = restored(Answer, whole, "answer")
        _check_keys("answer", whole, Answer)
        for k, each in enumerate(whole.get("effects", ())):
            _check_keys(f"answer.effects[{k}]", each, Answered)
        _check(answer, case, kinds)
        return answer

    return read_result_file(path, parse, noun="answer")


def read_answers(folder: Path, suite: Suite) -> dict[str, Answer]:
    """Read the answers to all cases of a suite, ``CASE.json`` each."""
    if not folder.is_dir():
        raise InvalidData(f"{folder}: there is no such folder of answers, one CASE.json a case")
    strange = sorted({path.stem for path in folder.glob("*.json")} - {*suite.cases, "score"})
    if strange:
        raise InvalidData(
            f"{folder / strange[0]}.json: the suite has no case {strange[0]!r}"
            f"{_near(strange[0], suite.cases)}"
        )
    return {
        name: read_answer(folder / f"{name}.json", entry, suite.kinds)
        for name, entry in suite.cases.items()
    }


def _check_keys(place: str, given: Mapping[str, Any], kind: type[Answer | Answered]) -> None:
    """Refuse misspelt keys, which would else be passed over."""
    known = {each.name: None for each in dataclasses.fields(kind)}
    strange = [key for key in given if key not in known]
    if strange:
        raise InvalidData(
            f"{place}: {strange[0]!r:.60} is no key of it{_near(strange[0], known)}; "
            f"keys: {', '.join(known)}"
        )


def _check(answer: Answer, case: CaseEntry, kinds: Mapping[str, Kind]) -> None:
    if (answer.verdict == "named") != bool(answer.effects):
        raise InvalidData(
            f"answer: the verdict is {answer.verdict!r} with {len(answer.effects)} effects; "
            "'named' has one or more, the others have none"
        )
    if answer.cpu_seconds is not None and not 0 <= answer.cpu_seconds < math.inf:
        raise InvalidData("answer.cpu_seconds: a time of 0 s or more is needed, or null")
    seen: set[tuple[str, str]] = set()
    for k, effect in enumerate(answer.effects):
        place = f"answer.effects[{k}]"
        if effect.kind not in kinds:
            raise InvalidData(
                f"{place}.kind: {effect.kind!r:.60} is no kind of the catalogue in protocol.json"
                f"{_near(effect.kind, kinds)}"
            )
        kind = kinds[effect.kind]
        allowed = [name for group in kind.at for name in case.places[group]]
        if effect.where not in allowed:
            raise InvalidData(
                f"{place}.where: {effect.kind} is not at {effect.where!r:.60}; "
                f"allowed: {', '.join(allowed) or 'nowhere in this case'}"
            )
        if (effect.kind, effect.where) in seen:
            raise InvalidData(f"{place}: {effect.kind} at {effect.where} is named twice")
        seen.add((effect.kind, effect.where))
        _check_numbers(place, effect, kind)


def _check_numbers(place: str, effect: Answered, kind: Kind) -> None:
    for part in ("parameters", "interval_95"):
        for name, values in getattr(effect, part).items():
            own = f"{place}.{part}.{name}"
            if name not in kind.parameters:
                raise InvalidData(
                    f"{own}: {effect.kind} has no such parameter; it has "
                    f"{', '.join(kind.parameters)}"
                )
            if not all(map(math.isfinite, values if part == "interval_95" else (values,))):
                raise InvalidData(f"{own}: a finite number is needed; leave out unknown ones")
    for name, (low, high) in effect.interval_95.items():
        if low > high:
            raise InvalidData(f"{place}.interval_95.{name}: the lower end comes first")
    if not 0.0 <= effect.probability <= 1.0:
        raise InvalidData(f"{place}.probability: a number from 0 to 1 is needed")


def _near(name: str, known: Mapping[str, Any]) -> str:
    """The nearest of the known names, as a question."""
    close = get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def answer_of(result: GapResult, *, cpu_seconds: float | None = None) -> Answer:
    """Answer of a result of ``loose gap``."""
    effects = tuple(
        Answered(
            kind=effect.kind,
            where=effect.where,
            parameters=_finite(effect.parameters),
            interval_95={
                name: (low, high)
                for name, (low, high) in effect.interval_95.items()
                if math.isfinite(low) and math.isfinite(high)
            },
            probability=0.95 / (1 + len(effect.ambiguous_with))
            if effect.probability is None
            else effect.probability,
        )
        for effect in result.effects
        if result.verdict == "named"
    )
    return Answer(verdict=result.verdict, effects=effects, cpu_seconds=cpu_seconds)


def _finite(values: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in values.items() if math.isfinite(value)}


def write_answer(path: Path, answer: Answer) -> Path:
    """Write an answer; the file is renamed into place."""
    return write_text(path, answer.to_json())


def answer_schema(kinds: Mapping[str, Kind]) -> dict[str, Any]:
    """JSON Schema (2020-12) of an answer; locations are checked against the case beside it."""
    number = {"type": "number"}
    interval = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
    effect = {
        "type": "object",
        "required": ["kind", "where"],
        "properties": {
            "kind": {"enum": list(kinds)},
            "where": {"type": "string"},
            "parameters": {"type": "object", "additionalProperties": number},
            "interval_95": {"type": "object", "additionalProperties": interval},
            "probability": {"type": "number", "minimum": 0, "maximum": 1},
        },
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": ANSWER_FORMAT,
        "type": "object",
        "required": ["format", "verdict"],
        "properties": {
            "format": {"const": ANSWER_FORMAT},
            "verdict": {"enum": list(VERDICTS)},
            "effects": {"type": "array", "items": effect},
            "cpu_seconds": {"type": ["number", "null"], "minimum": 0},
        },
    }


# ------------------------------------------------------------------------------ the command
