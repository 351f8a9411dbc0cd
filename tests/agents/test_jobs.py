"""Work in parallel gives the same results everywhere, survives a worker's death and resumes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import make_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("joblib")

from loose_agents.jobs import (
    BackendSettings,
    Store,
    WorkerDied,
    canonical,
    results_of,
    run_stored,
    spans,
)

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.evaluation import configuration_hash

SPANS = spans(11, 3)
CONFIGURATION = {"seed": 5, "arm": {"links": 4}}
THREADS = BackendSettings(backend="threading", workers=1)
TWO = BackendSettings(workers=2)


def rows_of(span: range) -> list[dict[str, Any]]:
    """A row an episode, random in the way that evaluation is."""
    return [{"episode": k, "reward": float(np.random.default_rng([5, k]).normal())} for k in span]


def arrays_of(span: range) -> dict[str, np.ndarray]:
    rows = rows_of(span)
    return {name: np.array([row[name] for row in rows]) for name in ("episode", "reward")}


def dying_rows(folder: Path, times: int, span: range) -> list[dict[str, Any]]:
    """Kill the worker of the second span the first times."""
    if span.start == 3 and len(list(folder.glob("death-*"))) < times:
        (folder / f"death-{time.time_ns()}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return rows_of(span)


def failing_rows(folder: Path, span: range) -> list[dict[str, Any]]:
    (folder / f"try-{span.start}-{time.time_ns()}").touch()
    if span.start == 6:
        raise ValueError("the gap is negative")
    return rows_of(span)


def counted_rows(folder: Path, span: range) -> list[dict[str, Any]]:
    (folder / f"run-{span.start}").touch()
    return rows_of(span)


def threads_of_blas(span: range) -> str | None:
    return os.environ.get("OMP_NUM_THREADS")


def all_rows(settings: BackendSettings, work: Any = rows_of) -> list[dict[str, Any]]:
    """Rows of every span in order; one that came twice or not at all is an error."""
    found = list(results_of(work, SPANS, settings))
    assert sorted(position for position, _ in found) == list(range(len(SPANS)))
    return [row for _, rows in sorted(found, key=lambda pair: pair[0]) for row in rows]


EXPECTED = [row for span in SPANS for row in rows_of(span)]


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "workers"), [("loky", 1), ("loky", 2), ("threading", 3)])
def test_rows_are_the_same_for_every_number_of_workers(backend: Any, workers: int) -> None:
    assert all_rows(BackendSettings(backend=backend, workers=workers)) == EXPECTED
    whole = results_of(rows_of, spans(11, 4), THREADS)
    assert [row for _, rows in whole for row in rows] == EXPECTED


def test_a_killed_worker_loses_and_doubles_no_row(tmp_path: Path) -> None:
    assert all_rows(TWO, partial(dying_rows, tmp_path, 1)) == EXPECTED
    assert len(list(tmp_path.glob("death-*"))) == 1
    assert {found for _, found in results_of(threads_of_blas, SPANS, TWO)} == {"1"}


@pytest.mark.slow
def test_a_task_that_always_kills_its_worker_is_named(tmp_path: Path) -> None:
    settings = BackendSettings(workers=2, retries=1)
    with pytest.raises(WorkerDied, match="task 1 ended its worker every time") as caught:
        all_rows(settings, partial(dying_rows, tmp_path, 100))
    assert caught.value.position == 1 and "fewer workers" in str(caught.value)


@pytest.mark.parametrize("settings", [THREADS, TWO], ids=["threads", "processes"])
def test_an_error_of_the_work_is_raised_and_not_tried_again(
    settings: BackendSettings, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match="the gap is negative"):
        all_rows(settings, partial(failing_rows, tmp_path))
    assert len(list(tmp_path.glob("try-6-*"))) == 1


def test_interrupted_work_resumes_with_what_is_missing(tmp_path: Path) -> None:
    (runs := tmp_path / "runs").mkdir()
    store = Store(tmp_path / "rows", CONFIGURATION)
    with pytest.raises(ValueError, match="negative"):
        run_stored(partial(failing_rows, tmp_path), SPANS, store, THREADS)
    again = Store(tmp_path / "rows", CONFIGURATION)
    assert again.missing(SPANS) == SPANS[2:]
    run_stored(partial(counted_rows, runs), SPANS, again, THREADS)
    assert sorted(file.name for file in runs.iterdir()) == ["run-6", "run-9"]
    assert [row for span in SPANS for row in again.read(span)] == EXPECTED


STOPPED = """
import os, time
from pathlib import Path
from loose_agents.jobs import BackendSettings, Store, run_stored, spans

def work(span):
    if span.start == 3:
        beside = Path({pid!r} + ".part")
        beside.write_text(str(os.getpid()))
        beside.replace({pid!r})
        time.sleep(300.0)
    return [{{"episode": k}} for k in span]

if __name__ == "__main__":
    store = Store({rows!r}, {{}})
    try:
        run_stored(work, spans(11, 3), store, BackendSettings(workers=2))
    except KeyboardInterrupt:
        print("stopped")
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_stopped_command_keeps_what_is_done_and_ends_its_workers(
    name: str, tmp_path: Path
) -> None:
    script = tmp_path / "command.py"
    script.write_text(STOPPED.format(rows=str(tmp_path / "rows"), pid=str(tmp_path / "pid")))
    command = subprocess.Popen(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heed_interrupts,
    )
    wait_for((tmp_path / "pid").exists)
    worker = int((tmp_path / "pid").read_text())
    if name == "SIGINT":
        os.killpg(command.pid, signal.SIGINT)  # a terminal sends it to every process
    else:
        command.kill()
    out, _ = command.communicate(timeout=60)
    assert out == ("stopped\n" if name == "SIGINT" else "")
    wait_for(lambda: not runs(worker))
    store = Store(tmp_path / "rows", {})
    assert SPANS[1] in store.missing(SPANS)
    assert not list((tmp_path / "rows").glob("*.part"))


def heed_interrupts() -> None:
    """Undo that tests started in a shell's background ignore the interrupts of a terminal."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def wait_for(condition: Callable[[], bool]) -> None:
    for _ in range(600):
        if condition():
            return
        time.sleep(0.1)
    pytest.fail("it has not happened within a minute")


def runs(pid: int) -> bool:
    """Whether a process runs; one that has ended and waits to be collected does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in "ZX"


@pytest.mark.parametrize("arrays", [False, True], ids=["rows", "arrays"])
@pytest.mark.parametrize("kept", [0.0, 0.97])
def test_a_file_cut_short_is_made_again(tmp_path: Path, arrays: bool, kept: float) -> None:
    work = arrays_of if arrays else rows_of
    store = Store(tmp_path, CONFIGURATION, arrays=arrays)
    run_stored(work, SPANS, store, THREADS)
    path = store.path(SPANS[2])
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * kept)])
    with pytest.raises(InvalidData, match="cut short or broken"):
        store.read(SPANS[2])
    run_stored(work, SPANS, store, THREADS)
    assert path.read_bytes() == whole


def test_a_flipped_bit_of_an_array_is_noticed_and_arrays_come_back(tmp_path: Path) -> None:
    store = Store(tmp_path, CONFIGURATION, arrays=True)
    given = {
        "records": np.arange(6000, dtype=np.int16).reshape(20, 300),
        "truth": np.array(["healthy", "link 2"]),
        "none": np.zeros((0, 4)),
    }
    store.write(SPANS[0], given)
    found = store.read(SPANS[0])
    for name, array in given.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)
    content = bytearray(store.path(SPANS[0]).read_bytes())
    content[len(content) // 2] ^= 1
    store.path(SPANS[0]).write_bytes(content)
    assert store.missing(SPANS[:1]) == SPANS[:1]


def test_another_configuration_is_refused_and_what_differs_is_named(tmp_path: Path) -> None:
    store = Store(tmp_path, CONFIGURATION)
    Store(tmp_path, {"arm": {"links": 4.0}, "seed": np.int64(5)})
    with pytest.raises(InvalidSetting, match=r"arm\.links is 4 there and 5 here; ") as caught:
        Store(tmp_path, {**CONFIGURATION, "arm": {"links": 5}})
    assert "seed" not in str(caught.value)
    with pytest.raises(InvalidSetting, match=r"noise is absent there and 0\.5 here"):
        Store(tmp_path, {**CONFIGURATION, "noise": 0.5})
    store.write(SPANS[0], rows_of(SPANS[0]))
    assert store.missing(spans(11, 4)) == spans(11, 4)  # spans of another size do not mix
    (tmp_path / "configuration.json").unlink()
    with pytest.raises(InvalidSetting, match=r"no configuration\.json"):
        Store(tmp_path, CONFIGURATION)
    (tmp_path / "configuration.json").write_text("{")
    with pytest.raises(InvalidSetting, match="cannot be read"):
        Store(tmp_path, CONFIGURATION)


def test_the_hash_tells_values_apart_and_nothing_else() -> None:
    def hashed(value: Any) -> str:
        return configuration_hash(canonical(value))

    base = hashed({"a": 1, "b": (1, 2), "path": Path("x/y")})
    assert base == hashed({"path": "x/y", "b": np.array([1.0, 2.0]), "a": 1})
    assert base != hashed({"a": 1, "b": (2, 1), "path": "x/y"})
    hinge, slide = (make_dataclass(name, [("gap", float)])(0.1) for name in ("Hinge", "Slide"))
    assert hashed(hinge) != hashed(slide)
    assert hashed({"a": True}) != hashed({"a": 1})
    with pytest.raises(InvalidData, match="cannot hold"):
        hashed({"a": {1, 2}})
