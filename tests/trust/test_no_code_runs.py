"""Loading a model, a recording or weights never runs code from them."""

from __future__ import annotations

import ast
import base64
import io
import json
import pickle
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from loose_env.errors import InvalidData, LooseEnvError

ROOT = Path(__file__).resolve().parents[2]


class Trap:
    """Unpickling it leaves a file behind."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.place,)


@pytest.fixture
def trap(tmp_path: Path) -> Iterator[bytes]:
    """A pickle; whoever loads it is found out."""
    place = tmp_path / "executed"
    data = pickle.dumps(Trap(place))
    yield data
    assert not place.exists(), "code of the file was run"
    pickle.loads(data)
    assert place.exists()  # the trap works


# ---- nothing in the sources could

OWN = {
    (
        "loose_env/arms/arm.py",
        "ctypes.CDLL",
    ): "MuJoCo's own library, and only if `import mujoco` has loaded it already",
    (
        "scripts/suites/trust/soak.py",
        "ctypes.CDLL",
    ): "the C library of the process, by which the soak gives memory back to the system",
}
"""Calls that are allowed, and why."""
NEVER = {
    *("eval", "exec", "compile", "__import__", "os.system", "os.popen", "pickle.load"),
    *("pickle.loads", "pickle.Unpickler", "marshal.loads", "marshal.load", "shelve.open"),
    *("joblib.load", "cloudpickle.loads", "cloudpickle.load", "dill.load", "dill.loads"),
    *("yaml.load", "yaml.unsafe_load", "yaml.full_load", "pandas.read_pickle", "runpy.run_path"),
    *("mujoco.mj_loadPluginLibrary", "mujoco.mj_loadAllPluginLibraries", "ctypes.CDLL"),
    *("model_class.load", "PPO.load", "RecurrentPPO.load", "MaskablePPO.load"),
    *("load_from_zip_file", "json_to_data"),
}
"""Calls that run, or may run, what a file says."""
SAFE_WITH = {"torch.load": ("weights_only", True), "np.load": ("allow_pickle", False)}
"""Calls that are safe with one keyword."""
ASKED = ("weights_only", "allow_pickle", "shell")


def dotted(node: ast.expr) -> str:
    """Name of what is called, as far as it is one."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def faults(source: str, name: str) -> list[str]:
    """Calls in a source that could run a file's code."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        called = dotted(node.func)
        keywords = {k.arg: ast.unparse(k.value) for k in node.keywords if k.arg in ASKED}
        word, value = SAFE_WITH.get(called, ("", None))
        if called in NEVER and (name, called) not in OWN:
            found.append(f"{name}:{node.lineno}: {called}")
        elif word and keywords.get(word) != repr(value):
            found.append(f"{name}:{node.lineno}: {called} without {word}={value}")
        elif keywords.get("shell") == "True" or keywords.get("allow_pickle") == "True":
            found.append(f"{name}:{node.lineno}: {called} with {keywords}")
    return found


def test_no_source_calls_what_could_run_a_file() -> None:
    found = []
    for folder in ("loose_env", "agents", "scripts"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            found += faults(file.read_text(encoding="utf-8"), str(file.relative_to(ROOT)))
    assert found == []


# ---- and no loader does


def zipped(tmp_path: Path, *, tensors: object, described: dict[str, Any]) -> Path:
    """A model's file as stable-baselines3 lays it out."""
    torch = pytest.importorskip("torch")
    stored = io.BytesIO()
    torch.save(tensors, stored)
    file = tmp_path / "model.zip"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", json.dumps(described))
        archive.writestr("policy.pth", stored.getvalue())
    return file


def test_the_settings_of_a_stored_model_are_not_unpickled(tmp_path: Path, trap: bytes) -> None:
    pytest.importorskip("sb3_contrib")
    from loose_agents.rl.model_files import activation_of, read_model

    serialized = base64.b64encode(trap).decode()
    kwargs = {":type:": "<class 'dict'>", ":serialized:": serialized, "net_arch": [4]}
    described = {"policy_kwargs": kwargs, "learning_rate": {":serialized:": serialized}}
    stored = read_model(zipped(tmp_path, tensors={}, described=described))
    assert activation_of(stored) == "tanh"
    odd = {"policy_kwargs": {"activation_fn": "<class 'os.system'>"}}
    # A word that no network knows.
    assert activation_of(read_model(zipped(tmp_path, tensors={}, described=odd))) == "system"
    file = zipped(tmp_path, tensors={"a": Trap(tmp_path / "executed")}, described={})
    with pytest.raises(InvalidData, match=r"model\.zip holds no model that can be read"):
        read_model(file)


def test_the_posterior_s_checkpoint_is_read_without_its_code(tmp_path: Path, trap: bytes) -> None:
    torch = pytest.importorskip("torch")
    from loose_agents.posterior_training import PosteriorTraining

    file = tmp_path / "checkpoint.pt"
    torch.save({"layers": Trap(tmp_path / "executed")}, file)
    with pytest.raises(InvalidData, match=r"cannot go on from .*checkpoint\.pt"):
        PosteriorTraining._restore(None, file)  # type: ignore[arg-type]


def test_words_of_a_command_line_are_not_run(tmp_path: Path) -> None:
    from loose_agents.rl.hyperparameters import value_of

    place = tmp_path / "executed"
    for text in (
        f"__import__('pathlib').Path({str(place)!r}).touch()",
        f"[open({str(place)!r}, 'w')]",
        f"dict(a=open({str(place)!r}, 'w'))",
        "().__class__.__bases__",
        "f'{1}'",
    ):
        with suppress(LooseEnvError):
            value_of(text)
    assert not place.exists()
