"""Structure of the package: import order, faces, circles, length of files."""

from __future__ import annotations

import ast
import importlib
import json
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "loose_env"
AGENTS = ROOT / "agents" / "loose_agents"
MOST_LINES = 900

# From the bottom up. A part imports itself and what stands above it in this list, never
# what stands below it or beside it.
ORDER = (
    ("errors", "typing", "version", "io", "streams"),
    ("arms",),
    ("faults",),
    ("excitation",),
    ("sensors",),
    ("recording",),
    ("importing",),
    ("rig",),
    ("statistics",),
    ("inference",),
    ("kinematics",),
    ("doctor",),
    ("diagnosis", "gap"),
    ("envs",),
    ("wrappers",),
    ("simulation",),
    ("registration",),
    ("evaluation",),
    ("instrument",),
    ("report",),
    ("api",),
    ("cli",),
)
RANK = {part: rank for rank, parts in enumerate(ORDER) for part in parts}
BASICS = {"errors", "typing", "streams"}  # modules that anything may import, io included

# The statistics are functions of arrays: they know neither the rig nor the simulator.
SEALED = {"statistics": {"loose_env.rig", "mujoco"}}

# No part of the package may import these at all.
OUTSIDE = {"loose_agents", "agents", "scripts", "tests"}

# Deep modules that others may import: one needs an optional extra, one is the command itself.
DEEP = {"loose_env.envs.sb3", "loose_env.cli.command", "loose_env.cli.main"}

HEAVY = {
    "jinja2",
    "matplotlib",
    "mcap",
    "odrpack",
    "pandas",
    "pyarrow",
    "sb3_contrib",
    "stable_baselines3",
    "tensorboard",
    "torch",
}

# Functions and classes that users begin with: each has an example that runs.
ENTRY_POINTS = {
    "api": ("diagnose", "explain_gap"),
    "arms": (
        "LinearArm", "arm_from_file", "describe_file", "planar", "scara", "servoed", "six_axis",
        "vera", "with_compliance",
    ),
    "diagnosis": ("FaultPosterior", "predict", "statistics_of"),
    "doctor": ("DoctorSettings", "examine"),
    "envs": ("DiagnosisEnv", "DiagnosisSettings", "DiagnosisVectorEnv", "Difficulty"),
    "evaluation": ("paired_difference", "standings", "wilson"),
    "faults": ("hypotheses", "seated_spec"),
    "gap": ("try_effect", "GapSettings", "Parameter", "solve_gap", "read_result", "register"),
    "importing": ("propose", "read_mapping"),
    "instrument": ("diagnose", "plan", "read_arm"),
    "kinematics": ("reactions",),
    "recording": ("Run", "read_recording"),
    "rig": ("ReducedRig", "SimulatedRig"),
    "statistics": ("bandpass", "covariances", "phase_delay"),
}  # fmt: skip


def sources(*folders: Path) -> list[Path]:
    return sorted(path for folder in folders or (PACKAGE,) for path in folder.rglob("*.py"))


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


def imported(tree: ast.AST, package: str) -> Iterator[tuple[int, str]]:
    """Line and full name of every import of a module that lies in `package`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                home = package.split(".")
                parents = home[: len(home) - node.level + 1]
                base = ".".join([*parents, base] if base else parents)
            if base == "loose_env":
                yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)
            else:
                yield node.lineno, base


def lies_in(name: str, module: str) -> bool:
    return name == module or name.startswith(module + ".")


def is_module(name: str) -> bool:
    place = ROOT.joinpath(*name.split("."))
    return place.is_dir() or place.with_suffix(".py").is_file()


def complaint(part: str, name: str) -> str | None:
    """Why `part` may not import the module called `name`, or None where it may."""
    if name.split(".")[0] in OUTSIDE:
        return f"imports {name}, which is built on the package"
    if any(lies_in(name, sealed) for sealed in SEALED.get(part, ())):
        return f"imports {name}, which {part} must not know"
    if not lies_in(name, "loose_env"):
        return None
    target = name.removeprefix("loose_env").lstrip(".").split(".")[0]
    if target == part:
        return None
    if target not in RANK:
        return f"imports {name}: import a name from the module that defines it"
    if RANK[target] >= RANK[part] and not (part == "io" and target in BASICS):
        return f"imports {name}, which does not stand below {part}"
    if name.count(".") > 1 and name not in DEEP and is_module(name):
        return f"imports {name}: import from the face, loose_env.{target}"
    return None


def complaints(source: str, path: Path) -> list[str]:
    """What is wrong with the imports of one file of the package."""
    inside = path.relative_to(PACKAGE).with_suffix("")
    package = ".".join(["loose_env", *inside.parts[:-1]])
    part = inside.parts[0]
    if part in {"__init__", "__main__"}:
        part = "cli"  # the front of the package imports what it likes
    if part not in RANK:
        return [f"{path.name}: give the new part {part!r} its place in ORDER"]
    return [
        f"{path.relative_to(ROOT)}:{line} {why}"
        for line, name in imported(ast.parse(source), package)
        if (why := complaint(part, name))
    ]


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import json, sys, loose_env; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    loaded = {name.split(".")[0] for name in json.loads(done.stdout)}
    assert not loaded & (HEAVY | OUTSIDE | {"mujoco", "scipy"})


def optional_modules() -> set[str]:
    """Modules that only an extra brings, by the requirements that `pyproject.toml` states."""

    def names(lines: Iterable[str]) -> set[str]:
        own = (line for line in lines if "extra ==" not in line)
        return {re.split(r"[^\w.-]", line)[0].lower().replace("_", "-") for line in own}

    stated = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    needed: set[str] = set()
    new = names(stated["dependencies"])
    while new:
        needed |= new
        known = (name for name in new if name in {d.lower() for d in installed()})
        new = {n for name in known for n in names(metadata.requires(name) or ())} - needed
    extras = set().union(*map(names, stated["optional-dependencies"].values())) - needed
    return {
        module
        for module, owners in metadata.packages_distributions().items()
        if {owner.lower().replace("_", "-") for owner in owners} <= extras
    }


@cache
def installed() -> frozenset[str]:
    """Installed distributions."""
    owners = metadata.packages_distributions().values()
    return frozenset(name.replace("_", "-") for own in owners for name in own)


def test_every_part_is_there_without_the_extras() -> None:
    absent = sorted(optional_modules())
    assert {"torch", "numba", "matplotlib"} <= set(absent)
    parts = [p for parts in ORDER for p in parts if p not in ("cli", "version")]
    code = f"""
import importlib, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {absent}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
for part in {parts}:
    importlib.import_module("loose_env." + part)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_no_part_imports_upward() -> None:
    found = [line for path in sources() for line in complaints(path.read_text("utf-8"), path)]
    assert not found, "\n".join(found)


def test_agents_and_scripts_use_the_faces() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line} imports {name}"
        for path in sources(AGENTS, ROOT / "scripts")
        for line, name in imported(parsed(path), "")
        if lies_in(name, "loose_env") and name.count(".") > 1 and name not in DEEP
        if is_module(name)
    ]
    assert not found, "\n".join(found)


def module_name(path: Path) -> str:
    inside = path.relative_to(AGENTS.parent if path.is_relative_to(AGENTS) else ROOT)
    parts = inside.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def graph() -> dict[str, set[str]]:
    """Modules that each module imports, within the repository; faces aside."""
    modules = {module_name(p): p for p in sources(PACKAGE, AGENTS, ROOT / "scripts")}
    arrows: dict[str, set[str]] = defaultdict(set)
    for name, path in modules.items():
        if path.name == "__init__.py":
            continue
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    deep = f"{node.module}.{alias.name}"
                    target = deep if deep in modules else node.module
                    if target in modules and target != name:
                        arrows[name].add(target)
    return arrows


def circle(arrows: dict[str, set[str]]) -> list[str]:
    """One circle of a graph; empty where there is none."""
    done: set[str] = set()

    def visit(node: str, way: list[str]) -> list[str]:
        if node in way:
            return [*way[way.index(node) :], node]
        if node in done:
            return []
        for after in sorted(arrows.get(node, ())):
            if found := visit(after, [*way, node]):
                return found
        done.add(node)
        return []

    return next((found for node in sorted(arrows) if (found := visit(node, []))), [])


def test_no_imports_go_in_circles() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}}) == ["a", "b", "c", "a"]
    assert not circle(graph())


def test_every_part_and_module_says_what_it_is() -> None:
    silent = [
        str(path.relative_to(ROOT))
        for path in sources(PACKAGE, AGENTS, ROOT / "scripts")
        if path.name != "__init__.py" or path.parent.parent in (PACKAGE, AGENTS.parent)
        if not ast.get_docstring(parsed(path))
    ]
    assert not silent, "\n".join(silent)


@pytest.mark.parametrize("part", sorted({p for parts in ORDER for p in parts} - {"cli"}))
def test_every_public_name_is_there_and_documented(part: str) -> None:
    face = importlib.import_module(f"loose_env.{part}")
    names = getattr(face, "__all__", None) or [
        name for name, value in vars(face).items() if getattr(value, "__module__", "") == part
    ]
    for name in names:
        value = getattr(face, name)
        if isinstance(value, type) or hasattr(value, "__code__"):
            assert value.__doc__, f"loose_env.{part}.{name} has no docstring"
    for name in ENTRY_POINTS.get(part, ()):
        assert name in names, f"loose_env.{part} does not offer {name}"
        assert ">>>" in getattr(face, name).__doc__, f"{name} has no example"


def test_no_file_is_too_long() -> None:
    lengths = {p: len(p.read_text("utf-8").splitlines()) for p in sources(PACKAGE, AGENTS)}
    found = [
        f"{path.relative_to(ROOT)} has {length} lines; split it, {MOST_LINES} is the most"
        for path, length in lengths.items()
        if length > MOST_LINES
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("file", "source", "allowed"),
    [
        ("rig/simulated.py", "from loose_env.arms import Arm", True),
        ("rig/simulated.py", "from loose_env.rig.base import Rig", True),
        ("rig/simulated.py", "from .base import Rig", True),
        ("rig/simulated.py", "from ..errors import LooseError", True),
        ("rig/simulated.py", "from loose_env import faults", True),
        ("rig/simulated.py", "import mujoco", True),
        ("faults.py", "from .arms import Arm", True),
        ("__init__.py", "from loose_env.registration import register", True),
        ("rig/simulated.py", "from loose_env.registration import register", False),
        ("rig/simulated.py", "from ..statistics import transmission", False),
        ("rig/simulated.py", "from loose_env import statistics", False),
        ("rig/simulated.py", "from loose_env import Arm", False),
        ("rig/simulated.py", "from .. import Arm", False),
        ("rig/simulated.py", "import loose_env", False),
        ("rig/simulated.py", "def late():\n    import loose_env.diagnosis", False),
        ("arms/vera.py", "from loose_env.faults import Healthy", False),
        ("gap/closing.py", "from loose_env.diagnosis import links", False),
        ("statistics/spectra.py", "from loose_env.rig import Measurement", False),
        ("statistics/spectra.py", "import mujoco", False),
        ("envs/arm.py", "from loose_agents.classical import Classical", False),
        ("envs/arm.py", "from loose_env.gap.model.effect import Effect", False),
        ("io/files.py", "from loose_env.errors import LooseEnvError", True),
        ("cli.py", "import scripts.agents.train", False),
        ("helpers.py", "import numpy", False),
    ],
)
def test_the_rule_tells_downward_from_upward(file: str, source: str, allowed: bool) -> None:
    assert (not complaints(source, PACKAGE / file)) is allowed
