"""Public benchmark of missing physics: make a suite, answer it, score answers, leaderboard.

    python -m scripts.suites.gap.public make FOLDER [--cases 60]     # FOLDER/sealed is kept back
    python -m scripts.suites.gap.public answer RECORDING OUT         # run loose gap on a recording
    python -m scripts.suites.gap.public score FOLDER ANSWERS --name NAME
    python -m scripts.suites.gap.public board [SCORE ...] [--docs]

docs/accuracy.md describes the formats.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from loose_env.cli.command import Actions, commands
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.io import write_text
from scripts.study import write_between
from scripts.suites.gap.cases import FIRST_JUDGED, TOLERANCES, draw_case, name_of, write_case
from scripts.suites.gap.effects import CATALOGUE, KINDS
from scripts.suites.gap.grading import LINES, grade, table
from scripts.suites.gap.run import tool_of

PROTOCOL, COMMITMENTS, SECRET = "protocol.json", "commitments.json", "sealed/secret.json"
"""Files of a suite; what lies in ``sealed`` is kept back."""
PAGE = Path(__file__).resolve().parents[3] / "docs" / "accuracy.md"
SCORES = PAGE.parent / "gap_benchmark"
"""Page and stored scores of the leaderboard."""
VERDICTS = ("no_gap", "named", "unexplained")


@dataclass(frozen=True, kw_only=True)
class Made:
    """Write a suite, or what is missing of it."""

    folder: Positional[Path]
    """Folder of the suite."""
    cases: int = 60
    """Number of cases; sixty have ten of each world."""
    phrase: str = ""
    """All is drawn from it; by default one is drawn and kept in FOLDER/sealed."""


def make(given: Made) -> dict[str, Any]:
    """Write recordings, protocol and commitments, and what is sealed; return the protocol."""
    folder, kept = given.folder, given.folder / SECRET
    phrase = given.phrase or secrets.token_hex(16)
    if kept.is_file():
        secret = json.loads(kept.read_text(encoding="utf-8"))
        if given.phrase not in ("", secret["phrase"]) or given.cases != secret["cases"]:
            raise InvalidSetting(f"{folder} has a suite of another phrase or size; take another")
        phrase = secret["phrase"]
    secret = {"phrase": phrase, "cases": given.cases}
    write_text(kept, json.dumps(secret))
    numbers = range(FIRST_JUDGED, FIRST_JUDGED + given.cases)
    commitments, truths = {}, folder / "sealed" / "truth"
    for number in numbers:
        name = name_of(number, phrase)
        if not (truths / f"{name}.json").is_file():
            case = draw_case(number, phrase)
            write_case(case, recordings=folder / "recordings", truth=truths)
            print(name, flush=True)
        commitments[name] = _commitment(phrase, truths / f"{name}.json")
    protocol = {
        "format": "gap-benchmark/2", "suite": _digest(phrase.encode())[:12],
        "cases": sorted(commitments), "tolerances": TOLERANCES, "verdicts": VERDICTS,
        "kinds": {name: dict(KINDS[name].units) for name in CATALOGUE},
    }  # fmt: skip
    write_text(folder / PROTOCOL, json.dumps(protocol, indent=1) + "\n")
    write_text(folder / COMMITMENTS, json.dumps(dict(sorted(commitments.items())), indent=1) + "\n")
    return protocol


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _commitment(phrase: str, truth: Path) -> str:
    """SHA-256 of the phrase and a file of truth: neither can be changed afterwards."""
    return _digest(phrase.encode() + truth.read_bytes())


@dataclass(frozen=True, kw_only=True)
class Asked:
    """Run a tool on a recording."""

    recording: Positional[Path]
    """Folder of the recording."""
    out: Positional[Path]
    """Folder for CASE.json."""
    tool: str = "loose_gap"
    """loose_gap, sysid, stepwise or module:function."""


def _answer(given: Asked) -> None:
    result = tool_of(given.tool)(given.recording)
    write_text(given.out / f"{given.recording.name}.json", json.dumps(dict(result)))


@dataclass(frozen=True, kw_only=True)
class Scored:
    """Score answers against the sealed truth."""

    folder: Positional[Path]
    """Folder of the suite, with what is sealed."""
    answers: Positional[Path]
    """Folder of answers, CASE.json each; gets score.json."""
    name: str
    """Name on the leaderboard."""


def read_answer(path: Path) -> dict[str, Any]:
    """An answer, checked: what ``result.json`` of `loose gap` holds, of which this is graded."""
    try:
        answer = json.loads(path.read_text(encoding="utf-8"))
        right = answer["verdict"] in VERDICTS
        for effect in answer.get("effects", ()):
            known = effect["kind"] in KINDS and isinstance(effect["where"], str)
            values = effect.get("parameters") or {}
            spans = effect.get("interval_95") or {}
            numbers = [float(x) for x in values.values()]
            numbers += [float(x) for low, high in spans.values() for x in (low, high)]
            right = right and known and all(x == x for x in numbers)
    except OSError as wrong:
        raise InvalidData(f"{path}: no answer; every case needs one") from wrong
    except (ValueError, KeyError, TypeError, AttributeError) as wrong:
        raise InvalidData(f"{path}: {type(wrong).__name__} {wrong}; see {PROTOCOL}") from wrong
    if not right:
        raise InvalidData(f"{path}: a verdict is one of {VERDICTS}, a kind one of {PROTOCOL}")
    return answer  # type: ignore[no-any-return]


def score(given: Scored) -> dict[str, Any]:
    """Marks of all cases of a suite; refused where a truth is not the committed one."""
    folder = given.folder
    protocol, commitments = (
        json.loads((folder / name).read_text(encoding="utf-8")) for name in (PROTOCOL, COMMITMENTS)
    )
    phrase = json.loads((folder / SECRET).read_text(encoding="utf-8"))["phrase"]
    rows = []
    for name in protocol["cases"]:
        truth = folder / "sealed" / "truth" / f"{name}.json"
        if _commitment(phrase, truth) != commitments[name]:
            raise InvalidData(f"{truth} is not the truth that {COMMITMENTS} was made from")
        answer = read_answer(given.answers / f"{name}.json")
        rows.append(grade(answer, json.loads(truth.read_text(encoding="utf-8"))))
    whole = {"format": "gap-score/2", "name": given.name, "suite": protocol["suite"], "rows": rows}
    write_text(given.answers / "score.json", json.dumps(whole, indent=1) + "\n")
    return whole


@dataclass(frozen=True, kw_only=True)
class Board:
    """Print the leaderboard."""

    scores: Positional[tuple[Path, ...]] = ()
    """Files score.json; those of docs/gap_benchmark by default."""
    docs: bool = False
    """Also write it into docs/accuracy.md."""


def leaderboard(scores: Sequence[dict[str, Any]]) -> str:
    """A table of entries, a column each, for every suite."""
    parts = []
    for suite in sorted({one["suite"] for one in scores}):
        own = [one for one in scores if one["suite"] == suite]
        lines = [f"Suite `{suite}`, {len(own[0]['rows'])} cases.", ""]
        lines += [f"| | {' | '.join(one['name'] for one in own)} |", "|---|" + "---|" * len(own)]
        for words, _, cell in LINES:
            lines.append(f"| {words} | {' | '.join(cell(one['rows']) for one in own)} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts) or "No entries yet."


def _board(given: Board) -> None:
    files = given.scores or tuple(sorted(SCORES.glob("*.json")))
    text = leaderboard([json.loads(file.read_text(encoding="utf-8")) for file in files])
    print(text)
    if given.docs:
        write_between(PAGE, text, name="leaderboard")


def _score(given: Scored) -> None:
    print(table(score(given)["rows"]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    actions: Actions = {
        "make": (Made, lambda given: print(len(make(given)["cases"]), "cases")),
        "answer": (Asked, _answer),
        "score": (Scored, _score),
        "board": (Board, _board),
    }
    commands("gap benchmark", __doc__, actions, arguments, interrupted="the same command goes on")


if __name__ == "__main__":
    main()
