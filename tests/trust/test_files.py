"""Damaged files of every kind are refused with a name, or read; nothing else is touched or run."""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator
from functools import partial

import pytest

pytest.importorskip("safetensors")
pytest.importorskip("yaml")
pytest.importorskip("sb3_contrib")

from scripts.suites.trust.fuzz import ELEMENTS, FINE, KINDS, MODEL, Trap, Watch, tetrahedron, tried

EACH = 20
"""Files of a kind; `python -m scripts.suites.trust.fuzz` reads 10,000."""


@pytest.fixture(scope="module")
def watch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watch]:
    made, before = Watch(tmp_path_factory.mktemp("fuzz") / "root"), os.getcwd()
    os.chdir(made.cwd)
    yield made
    os.chdir(before)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_by_name_or_read(watch: Watch, kind: str) -> None:
    found = [tried(kind, number, watch) for number in range(EACH)]
    assert [each for each in found if each[0] not in FINE] == []
    assert any(outcome == "refused" for outcome, _ in found)


RESULTS = ("gap result", "diagnosis result", "plan", "rows")
"""Kinds for which the tools are run first."""


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(k, marks=pytest.mark.slow) if k in RESULTS else k
        for k in KINDS
        if "MJCF" not in k
    ],
)
def test_a_pickle_in_the_place_of_a_file_is_refused_and_not_loaded(watch: Watch, kind: str) -> None:
    data = pickle.dumps(Trap(watch.cwd / "EXECUTED"))
    for name in KINDS[kind].damaged:
        home = watch.fresh(KINDS[kind].files() | {name: data})
        outcome, said = watch.judged(partial(KINDS[kind].read, home))
        assert outcome == "refused", (name, outcome, said)
    assert not (watch.cwd / "EXECUTED").exists()
    pickle.loads(data)  # the trap works
    (watch.cwd / "EXECUTED").unlink()


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(ELEMENTS)))
def test_no_hostile_element_gets_another_file_code_or_all_memory(watch: Watch, number: int) -> None:
    from loose_env.arms import compile_spec, load_spec

    element = ELEMENTS[number].replace("{secret}", str(watch.secret))
    text = MODEL.replace("</mujoco>", f"{element}</mujoco>")
    home = watch.fresh({"arm.xml": text.encode(), "two.stl": tetrahedron()})

    def read() -> list[str]:
        file, _, spec = load_spec(home / "arm.xml")
        model = compile_spec(spec, file)
        return [model.body(k).name for k in range(model.nbody)]

    outcome, said = watch.judged(read)
    assert outcome in FINE, said
