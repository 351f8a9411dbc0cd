"""How the package hangs together: what it loads, who imports whom, how long a file is."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "loose_env"
MOST_LINES = 400

# From the bottom up. A part imports itself and what stands above it in this list, never
# what stands below it or beside it.
ORDER = (
    ("errors",),
    ("arms",),
    ("faults",),
    ("excitation",),
    ("sensors",),
    ("recording",),
    ("importing",),
    ("rig",),
    ("statistics",),
    ("diagnosis", "gap"),
    ("envs",),
    ("instrument",),
    ("report",),
    ("thesis",),
    ("cli",),
)
RANK = {part: rank for rank, parts in enumerate(ORDER) for part in parts}

# The statistics are functions of arrays: they know neither the rig nor the simulator.
SEALED = {"statistics": {"loose_env.rig", "mujoco"}}

# No part of the package may import these at all.
OUTSIDE = {"agents", "scripts", "tests"}

HEAVY = {
    "jinja2",
    "matplotlib",
    "mcap",
    "odrpack",
    "pandas",
    "pyarrow",
    "pyuff",
    "sb3_contrib",
    "stable_baselines3",
    "tensorboard",
    "torch",
}


def sources() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


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
    if RANK[target] >= RANK[part]:
        return f"imports {name}, which does not stand below {part}"
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
    assert not loaded & (HEAVY | OUTSIDE)


def test_no_part_imports_upward() -> None:
    found = [line for path in sources() for line in complaints(path.read_text("utf-8"), path)]
    assert not found, "\n".join(found)


def test_no_file_is_too_long() -> None:
    lengths = {path: len(path.read_text("utf-8").splitlines()) for path in sources()}
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
        ("__init__.py", "from loose_env.envs import registration", True),
        ("rig/simulated.py", "from loose_env.envs import registration", False),
        ("rig/simulated.py", "from ..statistics import transmission", False),
        ("rig/simulated.py", "from loose_env import statistics", False),
        ("rig/simulated.py", "from loose_env import Arm", False),
        ("rig/simulated.py", "from .. import Arm", False),
        ("rig/simulated.py", "import loose_env", False),
        ("rig/simulated.py", "def late():\n    import loose_env.diagnosis", False),
        ("arms/vera.py", "from loose_env.faults import Healthy", False),
        ("gap/closing.py", "from loose_env.diagnosis import links", False),
        ("statistics/moments.py", "from loose_env.rig import Measurement", False),
        ("statistics/moments.py", "import mujoco", False),
        ("envs/arm.py", "from agents.classical import Classical", False),
        ("cli.py", "import scripts.agents.train", False),
        ("helpers.py", "import numpy", False),
    ],
)
def test_the_rule_tells_downward_from_upward(file: str, source: str, allowed: bool) -> None:
    assert (not complaints(source, PACKAGE / file)) is allowed
