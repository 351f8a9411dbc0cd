"""Answers of entrants: format ``gap-answer/1``, checked, and made of results of ``loose gap``."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal

from loose_env.errors import InvalidData
from loose_env.gap import GapResult
from loose_env.io import json_text, read_result_file, restored, whole_of, write_text
from scripts.suites.gap.public.catalogue import Kind
from scripts.suites.gap.public.making import CaseEntry, Suite

__all__ = ["FORMAT", "Answer", "Answered", "answer_of", "answer_schema", "read_answer",
           "read_answers", "write_answer"]  # fmt: skip

FORMAT = "gap-answer/1"
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
    format: str = FORMAT
    """Format of the file."""

    def to_json(self) -> str:
        """Text of the file.

        Examples
        --------
        >>> '"verdict": "no_gap"' in Answer(verdict="no_gap").to_json()
        True
        """
        return json_text(dataclasses.asdict(self))

    def as_result(self) -> dict[str, Any]:
        """The same as a result of format ``loose-gap/1``, which `grading.grade` takes."""
        effects = [dataclasses.asdict(effect) for effect in self.effects]
        return {"format": "loose-gap/1", "verdict": self.verdict, "effects": effects, "gap": None}


def read_answer(path: Path, case: CaseEntry, kinds: Mapping[str, Kind]) -> Answer:
    """Read an answer and check it against the protocol.

    Parameters
    ----------
    path : Path
        File of the answer.
    case : CaseEntry
        What entrants are told of its case.
    kinds : mapping of str to Kind
        Kinds that may be named.

    Raises
    ------
    InvalidData
        If it is missing, no JSON, or names what does not exist; the message begins with the file.
    """

    def parse(text: str) -> Answer:
        whole = whole_of(text, format=FORMAT, noun="answer")
        answer = restored(Answer, whole, "answer")
        _check_keys("answer", whole, Answer)
        for k, each in enumerate(whole.get("effects", ())):
            _check_keys(f"answer.effects[{k}]", each, Answered)
        _check(answer, case, kinds)
        return answer

    return read_result_file(path, parse, noun="answer")


def read_answers(folder: Path, suite: Suite) -> dict[str, Answer]:
    """Read the answers to all cases of a suite, ``CASE.json`` each.

    Raises
    ------
    InvalidData
        As `read_answer`; also if a file is named after no case.
    """
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
    """Answer of a result of ``loose gap``.

    A result of a version that gave no probabilities says 0.95, or an equal share with each effect
    that may be confused with it.

    Parameters
    ----------
    result : GapResult
        A result of format ``loose-gap/1``.
    cpu_seconds : float, optional
        Processor time that it took [s].

    Examples
    --------
    >>> from loose_env.gap import Gap
    >>> answer_of(GapResult(verdict="no_gap", gap=Gap(before=1.0, after=1.0))).verdict
    'no_gap'
    """
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
    """JSON Schema (2020-12) of an answer; locations are checked against the case beside it.

    Examples
    --------
    >>> from scripts.suites.gap.public.catalogue import catalogue
    >>> answer_schema(catalogue())["required"]
    ['format', 'verdict']
    """
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
        "title": FORMAT,
        "type": "object",
        "required": ["format", "verdict"],
        "properties": {
            "format": {"const": FORMAT},
            "verdict": {"enum": list(VERDICTS)},
            "effects": {"type": "array", "items": effect},
            "cpu_seconds": {"type": ["number", "null"], "minimum": 0},
        },
    }
