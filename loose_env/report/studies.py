"""Studies on disk, rows with the settings that reproduce them, and the look of their figures."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from loose_env.envs import FAINT, INK, MUTED
from loose_env.errors import InvalidData
from loose_env.io import write_text, written_beside


def study_head(made_by: str, settings: Any, *, version: str, **more: Any) -> dict[str, Any]:
    """Provenance of rows as it will be read back from a file.

    Parameters
    ----------
    made_by : str
        Script that makes the study.
    settings : dataclass or mapping
        Its settings.
    version : str
        Version of this package.
    **more
        Further parts of the provenance.
    """
    versions = {"loose_env": version, "mujoco": mujoco.__version__, "numpy": np.__version__}
    head = {
        "made_by": made_by,
        "settings": dict(settings) if isinstance(settings, Mapping) else asdict(settings),
        **more,
        "versions": versions | {"python": platform.python_version()},
    }
    read_back: dict[str, Any] = json.loads(json.dumps(head))
    return read_back


def write_study(
    path: Path, head: dict[str, Any], rows: Sequence[dict[str, Any]], *, digits: int = 4
) -> None:
    """Write a study atomically, a line for each row.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "study.json")
    ...     write_study(file, {"made_by": "me"}, [{"error": 1.23456}])
    ...     stored_rows(file, {"made_by": "me"}), stored_rows(file, {"made_by": "you"})
    ([{'error': 1.235}], [])
    """
    start = json.dumps(head, indent=1).removesuffix("\n}")
    lines = ",\n".join("  " + json.dumps(rounded(row, digits)) for row in rows)
    write_text(path, f'{start},\n "rows": [\n{lines}\n ]\n}}\n')


def stored_rows(path: Path, head: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of an earlier study, whole or interrupted, if it rests on the same; else none."""
    if not path.exists():
        return []
    stored = read_study(path)
    same = all(stored.get(key) == value for key, value in head.items())
    return list(stored["rows"]) if same else []


def read_study(path: Path) -> dict[str, Any]:
    """Read the file of a study: its rows, and what they rest on.

    Raises
    ------
    InvalidData
        If it is no whole JSON file, or none of a study.
    """
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InvalidData(
            f"{path} is no whole JSON file ({error}); remove it, or give another"
        ) from error
    if not isinstance(stored, dict) or not isinstance(stored.get("rows"), list):
        raise InvalidData(f"{path} holds no rows of a study; remove it, or give another file")
    return stored


def rounded(value: Any, digits: int = 4) -> Any:
    """Round all numbers in it; four digits are more than those of most studies hold."""
    if isinstance(value, dict):
        return {key: rounded(part, digits) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(part, digits) for part in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def pyplot() -> Any:
    """Matplotlib's pyplot without a window, set to the studies' look."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {
            "font.size": 9,
            "text.color": INK,
            "axes.edgecolor": FAINT,
            "axes.labelcolor": INK,
            "xtick.color": MUTED,
            "ytick.color": MUTED,
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    )
    return plt


def save_figure(plt: Any, figure: Any, path: Path, *, dpi: int = 130) -> None:
    """Write a figure to a file atomically, and close it."""
    written_beside(path, lambda beside: figure.savefig(beside, dpi=dpi))
    plt.close(figure)
