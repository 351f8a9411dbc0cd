"""Studies: their command line, going on, and showing what is stored."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from loose_agents.execution.command import option, parsed
from loose_agents.execution.study import (
    ClusterRun,
    Row,
    Study,
    StudyRun,
    write_between,
)

from loose_env.errors import InvalidSetting
from loose_env.io import Count

WORKED: list[int] = []


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings."""

    numbers: tuple[int, ...] = (3, 1, 2)
    """Numbers that are squared."""
    factor: float = option(1.0, "factor of the squares")

    def __post_init__(self) -> None:
        if self.factor == 0:
            raise InvalidSetting("factor is 0; give another")


def work(case: int, *, settings: Settings, run: StudyRun, say: Callable[[str], None]) -> list[Row]:
    WORKED.append(case)
    say("squaring")
    return [{"number": case, "square": settings.factor * case**2}]


def show(rows: list[Row], settings: Settings, path: Path, run: StudyRun) -> None:
    print([row["square"] for row in rows], settings.factor)


def study(run: type[StudyRun] = StudyRun) -> Study[Settings, StudyRun]:
    return Study(
        script=__file__,
        about="Squares of numbers.",
        settings=Settings,
        run=run,
        quick={"numbers": (1,)},
        cases=lambda settings, run: settings.numbers,
        work=work,
        case_of=lambda row: row["number"],
        show=show,
    )


def test_rows_go_on_with_the_same_settings_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path)]
    study().main(out)
    path = tmp_path / "test_study.json"
    whole = json.loads(path.read_text())
    assert whole["settings"] == {"numbers": [3, 1, 2], "factor": 1.0}
    assert [row["number"] for row in whole["rows"]] == [3, 1, 2]
    path.write_text(json.dumps(whole | {"rows": whole["rows"][:2]}))
    WORKED.clear()
    study().main(out)
    assert WORKED == [2]
    study().main([*out, "--factor", "2"])
    assert WORKED == [2, 3, 1, 2]
    capsys.readouterr()
    study().main([*out, "--show"])  # as it was stored, with the settings of then
    assert capsys.readouterr().out.startswith("[18.0, 2.0, 8.0] 2.0\n")
    study().main([*out, "--quick", "--afresh"])
    assert capsys.readouterr().out.startswith("[1.0] 1.0\n")


def test_cases_side_by_side_give_the_same_file(tmp_path: Path) -> None:
    settings, files = Settings(), []
    for kind, more in ((StudyRun, {}), (ClusterRun, {"backend": "threading", "workers": 2})):
        run = kind(**more)  # type: ignore[arg-type]
        path = tmp_path / f"{kind.__name__}.json"
        study(kind).rows(path, settings, run)
        files.append(path.read_bytes())
    assert files[0] == files[1]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--factor", "0"], "factor is 0"),
        (["--factor", "x"], "invalid float value"),
        (["--show", "nowhere.json"], "no rows at nowhere.json"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        study().main(words)
    said = f"{ended.value}{capsys.readouterr().err}"
    assert says in said and said.strip().count("\n") == 0


def test_a_count_on_the_command_line_is_refused_by_the_name_of_its_option() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Counted:
        most: Count | None = option(None, "most of them", "--at-most")

    assert parsed(Counted, []) == Counted()
    assert parsed(Counted, ["--at-most", "1"]).most == 1
    for wrong in ("0", "-3"):
        with pytest.raises(InvalidSetting, match=f"--at-most must be .* 1 or more; got {wrong}"):
            parsed(Counted, ["--at-most", wrong])


def test_tables_need_their_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    begin, end = "<!-- {}: begin -->", "<!-- {}: end -->"
    own, other = (f"{begin}\n{end}\n".format(name, name) for name in ("tables", "other"))
    write_between(page, "1", new=f"a\n{own}{other}b\n")
    write_between(page, "2")
    filled = f"{begin}\n\n2\n\n{end}\n".format("tables", "tables")
    assert page.read_text() == f"a\n{filled}{other}b\n"
    write_between(page, "3", name="other")
    assert (
        page.read_text()
        == f"a\n{filled}" + filled.replace("tables", "other").replace("2", "3") + "b\n"
    )
    page.write_text("a\n")
    with pytest.raises(InvalidSetting, match="lacks the lines"):
        write_between(page, "3")
    with pytest.raises(InvalidSetting, match="does not exist"):
        write_between(tmp_path / "none.md", "3")
