"""Public benchmark: made from a secret, answered in JSON by anyone, scored against commitments."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")


from loose_env.errors import InvalidData, InvalidSetting
from scripts.suites.gap.grading import SAID
from scripts.suites.gap.public import (
    PAGE,
    UNPUBLISHED,
    Answer,
    Answered,
    Made,
    answer_schema,
    catalogue,
    drawn_numbers,
    leaderboard,
    main,
    make,
    mark_case,
    open_truths,
    read_answer,
    read_score,
    read_suite,
    score,
    stored_scores,
    total,
)

pytestmark = pytest.mark.slow

PHRASE = "of the tests"


def made(folder: Path, *numbers: str, phrase: str = PHRASE) -> Made:
    return Made(folder=folder, numbers=numbers or ("310", "1910"), seed_phrase=phrase, name="tests")


@pytest.fixture(scope="session")
def suite_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("suite")
    make(made(folder))
    return folder


def perfect(truth: dict[str, Any]) -> dict[str, Any]:
    """The answer of someone who knows the truth."""
    effects = []
    for effect in truth["effects"]:
        kind, words = catalogue()[effect["kind"]], SAID.get(effect["kind"], {})
        said = {words.get(name, name): value for name, value in effect["parameters"].items()}
        values = {name: said[name] for name in kind.scored if name in said}
        intervals = {name: [value, value] for name, value in values.items()}
        effects.append(
            {"kind": effect["kind"], "where": effect["where"], "parameters": values,
             "interval_95": intervals, "probability": 1.0}
        )  # fmt: skip
    verdict = "named" if effects else "no_gap"
    return {"format": "gap-answer/1", "verdict": verdict, "effects": effects, "cpu_seconds": 1.5}


def answers_in(folder: Path, suite: Path, *, knowing: bool) -> Path:
    folder.mkdir(exist_ok=True)
    truths, _ = open_truths(suite, read_suite(suite))
    empty = {"format": "gap-answer/1", "verdict": "no_gap"}
    for name, truth in truths.items():
        whole = perfect(truth) if knowing else empty
        (folder / f"{name}.json").write_text(json.dumps(whole))
    return folder


def truth(role: str, *effects: tuple[str, str, dict[str, float]]) -> dict[str, Any]:
    return {
        "format": "gap-truth/1", "case": "case-0001", "role": role, "form": "forward",
        "effects": [
            {"kind": kind, "where": where, "parameters": values, "size": {"ratio": 4.0}}
            for kind, where, values in effects
        ],
    }  # fmt: skip


def test_making_is_deterministic_and_resumes(suite_folder: Path, tmp_path: Path) -> None:
    again = make(made(tmp_path / "again"))
    assert again == read_suite(suite_folder)
    told = json.loads((suite_folder / "protocol.json").read_text())
    for case in told["cases"].values():  # and nothing of the truth
        assert set(case) == {"tolerance", "sample_rate_hz", "runs", "held_out", "places"}
    one, same, other = (drawn_numbers(24, seed) for seed in (1, 1, 2))
    assert one == same != other and len(set(one)) == 24
    assert all(number % 1000 >= UNPUBLISHED for number in one)
    for pattern in ("recordings/*/*", "sealed/truth/*.json"):
        files = sorted(path.relative_to(suite_folder) for path in suite_folder.glob(pattern))
        assert files
        for file in files:
            assert (suite_folder / file).read_bytes() == (tmp_path / "again" / file).read_bytes()
    name = next(iter(again.cases))
    before = (tmp_path / "again" / "commitments.json").read_text()
    (tmp_path / "again" / "sealed" / "truth" / f"{name}.json").unlink()  # as if interrupted there
    make(made(tmp_path / "again"))
    assert (tmp_path / "again" / "commitments.json").read_text() == before
    assert not list((tmp_path / "again").rglob("*.part*"))
    with pytest.raises(InvalidSetting, match="another secret"):
        make(made(tmp_path / "again", phrase="other"))
    with pytest.raises(InvalidSetting, match="other cases"):
        make(made(tmp_path / "again", "310"))


def test_a_tampered_truth_fails_its_commitment(suite_folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(suite_folder, copy)
    suite = read_suite(copy)
    file = copy / "sealed" / "truth" / f"{next(iter(suite.cases))}.json"
    file.write_text(file.read_text().replace('"role"', '"Role"'))
    with pytest.raises(InvalidData, match="not the one committed to"):
        open_truths(copy, suite)


def test_a_perfect_answer_scores_one_and_an_empty_one_nothing(
    suite_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    best = answers_in(tmp_path / "best", suite_folder, knowing=True)
    main(["score", str(suite_folder), str(best), "--name", "oracle", "--open"])
    found = read_score(best / "score.json")
    assert found.precision == found.recall == found.f1 == 1.0
    assert found.brier == 0.0 and found.parameter_error == 0.0
    assert found.coverage.hits == found.coverage.of > 0
    assert found.cpu_seconds == 1.5 and len(found.cases) == 2
    assert "| oracle | 2/2 | 1.00 |" in capsys.readouterr().out
    none = answers_in(tmp_path / "none", suite_folder, knowing=False)
    (none / "case-x.json").write_text("{}")
    with pytest.raises(InvalidData, match="the suite has no case 'case-x'"):
        score(suite_folder, none)
    (none / "case-x.json").unlink()
    empty = score(suite_folder, none)
    assert empty.recall == 0.0 and np.isnan(empty.precision) and empty.f1 == 0.0
    assert empty.false_alarms.hits == 0 and empty.false_alarms.of == 1
    assert empty.cases == ()
    board = leaderboard([empty, found])
    assert board.index("oracle") < board.index("none")


EFFECT = {"kind": "coulomb_friction", "where": "joint1"}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "the answer cannot be read"),
        ("{", "is no JSON"),
        ('{"format": "gap-answer/2"}', "'gap-answer/1' is needed"),
        ({"verdict": "nothing"}, "is none of 'no_gap', 'named' or 'unexplained'"),
        ({"verdict": "named"}, "'named' has one or more"),
        ({"verdict": "no_gap", "effects": [EFFECT]}, "the others have none"),
        ({"verdict": "named", "effect": [EFFECT]}, "did you mean 'effects'?"),
        ({"effects": [{**EFFECT, "kind": "coulomb"}]}, "did you mean 'coulomb_friction'?"),
        ({"effects": [{**EFFECT, "where": "elbow"}]}, "allowed: joint1, joint2"),
        ({"effects": [{**EFFECT, "parameters": {"mu": 1.0}}]}, "it has torque"),
        ({"effects": [{**EFFECT, "parameters": {"torque": float("nan")}}]}, "NaN is no number"),
        ({"effects": [{**EFFECT, "parameters": {"torque": None}}]}, "a finite number is needed"),
        ({"effects": [{**EFFECT, "interval_95": {"torque": [2, 1]}}]}, "the lower end comes first"),
        ({"effects": [{**EFFECT, "probability": 90}]}, "a number from 0 to 1"),
        ({"effects": [EFFECT, EFFECT]}, "is named twice"),
        ({"effects": "coulomb_friction"}, "a list is needed"),
        ({"verdict": "no_gap", "cpu_seconds": -1}, "a time of 0 s or more"),
    ],
)  # fmt: skip
def test_malformed_answers_end_with_one_clear_line(
    suite_folder: Path,
    tmp_path: Path,
    content: str | dict[str, Any] | None,
    said: str,
) -> None:
    answers = answers_in(tmp_path / "answers", suite_folder, knowing=False)
    file = min(answers.iterdir())
    if content is None:
        file.unlink()
    elif isinstance(content, str):
        file.write_text(content)
    else:
        file.write_text(json.dumps({"format": "gap-answer/1", "verdict": "named", **content}))
    with pytest.raises(SystemExit) as ended:
        main(["score", str(suite_folder), str(answers)])
    line = str(ended.value.code)
    assert line.startswith("gap benchmark score: ") and "\n" not in line
    assert str(file) in line and said in line


def test_metrics_are_those_of_the_page() -> None:
    friction = ("coulomb_friction", "joint2", {"torque": 2.0})
    half = Answered(kind="coulomb_friction", where="joint2", parameters={"torque": 2.2},
                    interval_95={"torque": (1.9, 2.1)}, probability=0.8)  # fmt: skip
    wrong = Answered(kind="backlash", where="joint1", probability=0.3)
    cases = [
        mark_case(Answer(verdict="named", effects=(half, wrong)), truth("single", friction)),
        mark_case(Answer(verdict="no_gap"), truth("single", friction)),
        mark_case(Answer(verdict="unexplained"), truth("none")),
        mark_case(Answer(verdict="unexplained"), truth("outside", ("voltage_sag", "all", {}))),
    ]
    found = total(cases, name="hand", suite="hand", identity="0")
    assert (found.found, found.named, found.true) == (1, 2, 2)
    assert found.precision == found.recall == found.f1 == 0.5
    assert found.brier == pytest.approx((0.2**2 + 0.3**2 + 1.0) / 4)
    assert found.calibration_error == pytest.approx((0.2 + 0.3) / 2)
    assert found.parameter_error == pytest.approx(0.1)
    assert (found.coverage.hits, found.coverage.of) == (1, 1)
    assert (found.right.hits, found.right.of) == (1, 4)
    assert (found.false_alarms.hits, found.false_alarms.of) == (1, 1)


def test_the_example_of_the_page_is_an_answer(suite_folder: Path, tmp_path: Path) -> None:
    text = re.search(r"```json\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL)
    assert text is not None
    suite = read_suite(suite_folder)
    file = tmp_path / "case.json"
    file.write_text(text[1])
    assert read_answer(file, next(iter(suite.cases.values())), suite.kinds).verdict == "named"
    schema = pytest.importorskip("jsonschema")
    schema.validate(json.loads(text[1]), answer_schema(catalogue()))
    with pytest.raises(schema.ValidationError):
        schema.validate({"verdict": "maybe"}, answer_schema(catalogue()))


def test_the_leaderboard_of_the_page_is_that_of_the_stored_scores() -> None:
    scores = [read_score(path) for path in stored_scores()]
    assert leaderboard(scores) in PAGE.read_text("utf-8")
    for found in scores:
        told = {"name": found.name, "suite": found.suite, "identity": found.identity}
        again = total(found.cases, **told)
        assert (again.right, again.found, again.named) == (found.right, found.found, found.named)
        assert (again.recall, again.brier) == pytest.approx((found.recall, found.brier))
