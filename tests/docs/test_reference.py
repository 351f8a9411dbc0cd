"""How the pages of the reference are written from the code."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

from tests.docs.pages import ROOT


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    spec = spec_from_file_location("docs_reference", ROOT / "docs" / "reference.py")
    assert spec is not None and spec.loader is not None
    found = module_from_spec(spec)
    sys.modules["docs_reference"] = found
    spec.loader.exec_module(found)
    return found


def test_no_part_of_the_package_is_forgotten(reference: ModuleType) -> None:
    here = {
        path.stem
        for path in (ROOT / "loose_env").iterdir()
        if (path.suffix == ".py" or (path / "__init__.py").is_file()) and path.stem[0] != "_"
    }
    assert here - set(reference.PARTS) == {"cli", "version"}
    assert set(reference.PARTS) <= here


def test_every_public_module_has_its_page(reference: ModuleType, tmp_path: Path) -> None:
    reference.write(tmp_path / "api")
    pages = {file.stem for file in (tmp_path / "api").iterdir()}
    assert {"index", "loose_env.arms", "loose_env.arms.library", "loose_env.errors"} <= pages
    assert "loose_env.statistics._checks" not in pages
    old = tmp_path / "api" / "loose_env.gone.rst"
    old.write_text("gone")
    before = {file: file.stat().st_mtime_ns for file in (tmp_path / "api").iterdir()}
    reference.write(tmp_path / "api")
    assert not old.exists()  # and what did not change is not written again
    assert all(file.stat().st_mtime_ns == at for file, at in before.items() if file.exists())


def test_prose_of_docstrings_is_no_markup(reference: ModuleType) -> None:
    lines = [
        "Where |x| * 2 is kept_, see `loose_env.arms.arm.Arm` and `n`:",
        "",
        "    code | that * stays_",
        "",
        ">>> a | b",
    ]
    reference.as_meant(None, "function", "f", None, None, lines)
    assert lines[0] == (
        r"Where \|x\| \* 2 is kept\_, see :py:obj:`loose_env.arms.arm.Arm` and ``n``::"
    )
    assert lines[-1] == ">>> a | b"


def test_types_of_arrays_are_short(reference: ModuleType) -> None:
    long = "~numpy.ndarray[tuple[~typing.Any, ...], ~numpy.dtype[~numpy.bool]]"
    assert reference.shortened(f"tuple[{long}, int] | None") == "tuple[NDArray[bool], int] | None"
