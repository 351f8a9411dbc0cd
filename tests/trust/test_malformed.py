"""Damaged files of every kind are refused with a name, or read; nothing else is touched or run.

`python -m scripts.suites.trust.malformed_run` reads 10,000; here are some of them.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("safetensors")
pytest.importorskip("yaml")
pytest.importorskip("sb3_contrib")
pytest.importorskip("mcap")
pytest.importorskip("pyuff")

from scripts.suites.trust.fuzz.cases import KINDS
from scripts.suites.trust.fuzz.hostile import ELEMENTS
from scripts.suites.trust.fuzz.surroundings import Surroundings
from scripts.suites.trust.fuzz.watch import BAD, Attempt, Watch, judged, snapshot
from scripts.suites.trust.malformed_run import rows_of

EACH = 20
"""Files of a kind."""
SEED = 20


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_by_name_or_read(kind: str) -> None:
    rows = list(rows_of(kind, 0, EACH, SEED))
    assert len(rows) == EACH
    assert [row for row in rows if row["outcome"] in BAD] == []
    assert any(row["outcome"] == "refused" for row in rows)


def test_a_file_that_kills_its_process_is_a_row_and_the_next_is_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import scripts.suites.trust.malformed_run as malformed

    # A process that dies at the second file of three, each time it comes to it.
    script = tmp_path / "worker.sh"
    script.write_text(
        "#!/bin/sh\n"
        "i=$4\n"
        'while [ "$i" -lt "$5" ]; do\n'
        '  echo "{\\"number\\": $i, \\"begun\\": true}"\n'
        '  [ "$i" = 1 ] && kill -9 $$\n'
        '  echo "{\\"number\\": $i, \\"outcome\\": \\"read\\"}"\n'
        "  i=$((i + 1))\n"
        "done\n"
    )
    script.chmod(0o755)
    monkeypatch.setattr(malformed.sys, "executable", str(script))
    found = [(row["number"], row["outcome"]) for row in malformed.rows_of("CSV", 0, 3, 1)]
    assert found == [(0, "read"), (1, "died"), (2, "read")]


@pytest.fixture(scope="module")
def watch() -> Watch:
    made = Watch()
    made.install()
    return made


def verdict(around: Surroundings, watch: Watch, read: object, **more: object) -> str:
    watch.secret = around.secret
    made = Attempt(damage="", read=read, names=("",), **more)  # type: ignore[arg-type]
    return judged(made, watch, lambda: snapshot(around.root)).outcome


def test_the_watch_sees_what_is_written_run_and_read_outside(tmp_path: Path, watch: Watch) -> None:
    around = Surroundings(tmp_path)
    home = around.fresh({"a.txt": b"a"})
    assert verdict(around, watch, lambda: (home / "a.txt").read_text()) == "read"
    assert verdict(around, watch, lambda: (around.cwd / "b").write_text("b")) == "wrote"
    assert verdict(around, watch, lambda: (home / "a.txt").write_text("b")) == "wrote"
    assert verdict(around, watch, lambda: os.system("true")) == "ran"
    assert verdict(around, watch, lambda: (home / "link.csv").read_text()) == "leaked"
    assert verdict(around, watch, lambda: ["SECRET"]) == "leaked"
    assert verdict(around, watch, lambda: 1 / 0) == "crash"


@pytest.mark.parametrize("number", range(len(ELEMENTS)))
def test_no_hostile_element_gets_another_file_code_or_all_memory(
    tmp_path: Path, watch: Watch, number: int
) -> None:
    from loose_env.arms import compile_spec, load_spec
    from scripts.suites.trust.fuzz.documents import MODEL, tetrahedron

    around = Surroundings(tmp_path)
    element = ELEMENTS[number].replace("{secret}", str(around.secret))
    text = MODEL.replace("</mujoco>", f"{element}</mujoco>")
    home = around.fresh({"arm.xml": text.encode(), "two.stl": tetrahedron()})

    def read() -> list[str]:
        file, _, spec = load_spec(home / "arm.xml")
        model = compile_spec(spec, file)
        assert model.nmesh == 0 or "two" not in element
        return [model.body(k).name for k in range(model.nbody)]

    assert verdict(around, watch, read) in ("refused", "read")
