"""The tables in the documents are those the code prints."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_environment_tables_are_up_to_date() -> None:
    written = (ROOT / "docs" / "environments.md").read_text(encoding="utf-8")
    assert written == script("write_docs").environments()


def test_every_element_of_every_environment_is_in_the_document() -> None:
    import gymnasium

    from loose_env.envs.registration import IDS

    text = (ROOT / "docs" / "environments.md").read_text(encoding="utf-8")
    for env_id in IDS:
        layout = gymnasium.make(env_id).unwrapped.layout  # type: ignore[attr-defined]
        for element in layout.slot_elements:
            assert f".{element.name} | {element.unit} |" in text
