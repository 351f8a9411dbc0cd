"""Shards give the same results on every backend, survive the death of a worker and resume."""

from __future__ import annotations

import argparse
import importlib.util
import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loose_agents.execution.backends import BACKENDS, BackendSettings, add_backend_options
from loose_agents.execution.configuration_hash import configuration_hash
from loose_agents.execution.local_pools import load_extra
from loose_agents.execution.progress import ProgressLine
from loose_agents.execution.shard_store import ArrayCodec, RowCodec, ShardStore
from loose_agents.execution.shards import (
    Shard,
    ShardFailed,
    map_shards,
    run_shards,
    shard_of,
)

from loose_env.errors import InvalidData, InvalidSetting, MissingExtra, UnknownName

SHARDS = shard_of(11, 3)
CONFIGURATION = {"seed": 5, "arm": {"links": 4}}


def needs(package: str) -> pytest.MarkDecorator:
    missing = importlib.util.find_spec(package) is None
    return pytest.mark.skipif(missing, reason=f"{package} is not installed")


needs_ray, needs_dask, needs_submitit = needs("ray"), needs("distributed"), needs("submitit")
needs_proc = pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="only Linux lists its processes as files"
)
pytestmark = needs("joblib")


def rows_of(shard: Shard, seed: int = 5) -> list[dict[str, Any]]:
    """A row an episode, random in the way that evaluation is."""
    return [
        {"episode": k, "reward": float(np.random.default_rng([seed, k]).normal())}
        for k in shard.episodes
    ]


def arrays_of(shard: Shard) -> dict[str, np.ndarray]:
    rows = rows_of(shard)
    return {
        "episode": np.array([row["episode"] for row in rows]),
        "reward": np.array([row["reward"] for row in rows], dtype=np.float32),
    }


def dying_rows(folder: Path, times: int, shard: Shard) -> list[dict[str, Any]]:
    """Kill the worker of shard 1 the first times; note every run that came to its end."""
    if shard.index == 1 and len(list(folder.glob("death-*"))) < times:
        (folder / f"death-{time.time_ns()}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    (folder / f"done-{shard.index}-{time.time_ns()}").touch()
    return rows_of(shard)


def leaving_rows(folder: Path, shard: Shard) -> list[dict[str, Any]]:
    """Leave the worker by the back door at every shard, once each."""
    marker = folder / f"left-{shard.index}"
    if not marker.exists():
        marker.touch()
        os._exit(3)
    return rows_of(shard)


def counted_rows(folder: Path, shard: Shard) -> list[dict[str, Any]]:
    (folder / f"run-{shard.index}").touch()
    return rows_of(shard)


class BadArm(Exception):
    """An exception that cannot be pickled: it wants two arguments."""

    def __init__(self, name: str, links: int) -> None:
        super().__init__(f"{name} has {links} links")


def failing_rows(folder: Path, kind: str, shard: Shard) -> list[dict[str, Any]]:
    (folder / f"try-{shard.index}-{time.time_ns()}").touch()
    if shard.index == 2:
        if kind == "exit":
            sys.exit("no arm")
        raise BadArm("desk", 9) if kind == "unpicklable" else ValueError("the gap is negative")
    return rows_of(shard)


def threads_of_blas(shard: Shard) -> str | None:
    return os.environ.get("OMP_NUM_THREADS")


def all_rows(backend: str, work: Any = rows_of, **options: Any) -> list[dict[str, Any]]:
    """Rows of every shard in order; a shard that came twice or not at all is an error."""
    found = list(map_shards(work, SHARDS, backend=backend, **options))
    assert sorted(position for position, _ in found) == list(range(len(SHARDS)))
    return [row for _, rows in sorted(found, key=lambda pair: pair[0]) for row in rows]


EXPECTED = [row for shard in SHARDS for row in rows_of(shard)]


@pytest.fixture(scope="module")
def ray_session() -> Iterator[None]:
    """One Ray cluster for all tests: it takes seconds to start."""
    import ray
    from loose_agents.execution.cluster_pools import RayPool

    first = RayPool(BackendSettings(backend="ray", workers=2), 2)
    yield
    first.close()
    assert not ray.is_initialized()


@pytest.fixture
def submitit_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    from submitit.core.core import Job

    monkeypatch.setattr(Job, "_results_timeout_s", 0)  # it waits for slow file systems
    return {
        "backend": "slurm",
        "slurm_cluster": "local",
        "slurm_folder": str(tmp_path / "jobs"),
        "workers": 2,
    }


@pytest.mark.parametrize(("backend", "workers"), [("loky", 1), ("loky", 2), ("threading", 3)])
def test_rows_are_the_same_for_every_number_of_workers(backend: str, workers: int) -> None:
    assert all_rows(backend, workers=workers) == EXPECTED


@needs_ray
def test_rows_are_the_same_on_ray(ray_session: None) -> None:
    assert all_rows("ray", workers=2) == EXPECTED


def test_rows_do_not_depend_on_the_size_of_a_shard() -> None:
    found = map_shards(rows_of, shard_of(11, 4), backend="threading", workers=1)
    assert [row for _, rows in found for row in rows] == EXPECTED


def check_one_death(folder: Path, **options: Any) -> None:
    assert all_rows(work=partial(dying_rows, folder, 1), **options) == EXPECTED
    assert len(list(folder.glob("death-*"))) == 1
    # Only the shard of the dead worker ran again.
    assert len(list(folder.glob("done-*"))) == len(SHARDS)


def test_a_killed_worker_of_loky_loses_and_doubles_no_row(tmp_path: Path) -> None:
    check_one_death(tmp_path, backend="loky", workers=2)


@needs_ray
def test_a_killed_worker_of_ray_loses_and_doubles_no_row(tmp_path: Path, ray_session: None) -> None:
    check_one_death(tmp_path, backend="ray", workers=2)


@needs_dask
def test_a_killed_worker_of_dask_loses_and_doubles_no_row(tmp_path: Path) -> None:
    check_one_death(tmp_path, backend="dask", workers=2)


@needs_submitit
def test_a_killed_job_loses_and_doubles_no_row(
    tmp_path: Path, submitit_options: dict[str, Any]
) -> None:
    check_one_death(tmp_path, **submitit_options)


def test_every_shard_may_lose_its_worker(tmp_path: Path) -> None:
    work = partial(leaving_rows, tmp_path)
    assert all_rows("loky", work, workers=2, retries=1) == EXPECTED


def test_a_shard_that_always_kills_its_worker_is_given_up_and_named(tmp_path: Path) -> None:
    work = partial(dying_rows, tmp_path, 100)
    with pytest.raises(ShardFailed, match=r"shard 1 \(episodes 3 to 5\).*died 3 times") as caught:
        all_rows("loky", work, workers=2, retries=2)
    assert "fewer workers" in str(caught.value) and "SIGKILL" in str(caught.value)
    assert len(list(tmp_path.glob("death-*"))) == 3


@needs_ray
def test_ray_gives_up_too(tmp_path: Path, ray_session: None) -> None:
    with pytest.raises(ShardFailed, match=r"shard 1 .*died 2 times"):
        all_rows("ray", partial(dying_rows, tmp_path, 100), workers=2, retries=1)


@pytest.mark.parametrize("backend", ["loky", "threading"])
def test_an_error_of_the_work_names_the_shard_and_is_not_tried_again(
    backend: str, tmp_path: Path
) -> None:
    work = partial(failing_rows, tmp_path, "plain")
    with pytest.raises(ShardFailed, match=r"shard 2 .*ValueError: the gap is neg") as caught:
        all_rows(backend, work, workers=1)
    assert isinstance(caught.value.__cause__, ValueError)
    assert "in failing_rows" in caught.value.__notes__[0]
    assert len(list(tmp_path.glob("try-2-*"))) == 1


@pytest.mark.parametrize(
    ("kind", "words"), [("unpicklable", "BadArm: desk has 9"), ("exit", "no arm")]
)
def test_an_error_that_cannot_travel_is_told_in_words(
    kind: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(ShardFailed, match=rf"shard 2 .*{words}"):
        all_rows("loky", partial(failing_rows, tmp_path, kind), workers=1)


@needs_ray
def test_an_error_of_the_work_is_the_same_on_ray(tmp_path: Path, ray_session: None) -> None:
    with pytest.raises(ShardFailed, match=r"shard 2 .*ValueError: the gap is neg") as caught:
        all_rows("ray", partial(failing_rows, tmp_path, "plain"), workers=2)
    assert isinstance(caught.value.__cause__, ValueError)
    assert len(list(tmp_path.glob("try-2-*"))) == 1


def test_a_result_that_cannot_travel_names_the_shard() -> None:
    with pytest.raises(ShardFailed, match=r"shard 0 .*could not travel"):
        all_rows("loky", lambda shard: sys._getframe(), workers=1)


def test_workers_compute_with_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    found = map_shards(threads_of_blas, SHARDS[:1], backend="loky", workers=1)
    assert list(found) == [(0, "1")]
    assert os.environ["OMP_NUM_THREADS"] == "7"


@needs_ray
def test_workers_of_ray_compute_with_one_thread(ray_session: None) -> None:
    assert list(map_shards(threads_of_blas, SHARDS[:1], backend="ray")) == [(0, "1")]


@needs_submitit
def test_jobs_compute_with_one_thread_and_leave_only_their_logs(
    monkeypatch: pytest.MonkeyPatch, submitit_options: dict[str, Any]
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    assert list(map_shards(threads_of_blas, SHARDS[:1], **submitit_options)) == [(0, "1")]
    assert not list(Path(submitit_options["slurm_folder"]).glob("*.pkl"))


@needs_submitit
def test_a_machine_without_slurm_says_what_to_do(tmp_path: Path) -> None:
    settings = BackendSettings(backend="slurm", slurm_folder=str(tmp_path), slurm_cluster="sulrm")
    with pytest.raises(InvalidSetting, match="slurm_cluster 'local'"):
        next(map_shards(rows_of, SHARDS, settings=settings))


def test_progress_counts_every_shard() -> None:
    seen: list[tuple[int, int]] = []
    for _ in map_shards(
        rows_of, SHARDS, backend="threading", workers=1, progress=lambda *p: seen.append(p)
    ):
        pass
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


@needs_proc
def test_closing_the_iterator_ends_the_workers() -> None:
    found = map_shards(os_pid, [0, 1, 2, 3], backend="loky", workers=1)
    _, pid = next(found)
    found.close()
    wait_for(lambda: not runs(pid))


def test_a_worker_that_dies_while_it_waits_is_replaced() -> None:
    found = map_shards(os_pid, [0, 1, 2], backend="loky", workers=1)
    done = []
    for position, pid in found:
        done.append(position)
        os.kill(pid, signal.SIGKILL)
    assert sorted(done) == [0, 1, 2]


def os_pid(shard: int) -> int:
    return os.getpid()


def test_no_shards_give_no_results_and_start_nothing() -> None:
    assert list(map_shards(rows_of, [], backend="ray")) == []


def test_a_missing_package_names_its_extra() -> None:
    def absent() -> Any:
        raise ModuleNotFoundError("no ray")

    with pytest.raises(MissingExtra, match=r"loose-env\[ray\]"):
        load_extra("ray", "ray", absent)
    with pytest.raises(MissingExtra, match=r"loose-env\[scale\]"):
        load_extra("loky", "joblib", absent)


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(UnknownName, match="loky, threading, ray, dask, slurm"):
        map_shards(rows_of, SHARDS, backend="spark")
    with pytest.raises(UnknownName, match="no option speed"):
        map_shards(rows_of, SHARDS, speed=3)
    for options in ({"workers": 0}, {"retries": -1}, {"slurm_time": 0}, {"slurm_memory": 0.0}):
        with pytest.raises(InvalidSetting):
            map_shards(rows_of, SHARDS, **options)


def test_the_command_line_has_an_option_for_every_setting() -> None:
    parser = argparse.ArgumentParser()
    add_backend_options(parser)
    assert BackendSettings.of(parser.parse_args([])) == BackendSettings()
    given = ["--backend", "slurm", "--slurm-memory", "3.5", "--retries", "0"]
    expected = BackendSettings(backend="slurm", slurm_memory=3.5, retries=0)
    assert BackendSettings.of(parser.parse_args(given)) == expected
    assert all(name in parser.format_help() for name in BACKENDS)


@pytest.mark.parametrize(("total", "size"), [(10, 3), (9, 3), (2, 5), (0, 4), (1, 1)])
def test_shards_cover_every_episode_once(total: int, size: int) -> None:
    shards = shard_of(total, size)
    assert [k for shard in shards for k in shard.episodes] == list(range(total))
    assert [shard.index for shard in shards] == list(range(len(shards)))
    assert all(len(shard) <= size for shard in shards)


def test_shards_without_episodes_are_refused() -> None:
    with pytest.raises(InvalidSetting, match="size of 1 or more"):
        shard_of(10, 0)
    with pytest.raises(InvalidSetting, match="start < stop"):
        Shard(index=0, start=3, stop=3)


def test_interrupted_work_resumes_with_what_is_missing(tmp_path: Path) -> None:
    (runs := tmp_path / "runs").mkdir()
    store = ShardStore(tmp_path / "rows", CONFIGURATION, RowCodec())
    with pytest.raises(ShardFailed):
        run_shards(
            partial(failing_rows, tmp_path, "plain"),
            SHARDS,
            store,
            stream=io.StringIO(),
            backend="threading",
            workers=1,
        )
    again = ShardStore(tmp_path / "rows", CONFIGURATION, RowCodec())
    assert [shard.index for shard in again.missing(SHARDS)] == [2, 3]
    work = partial(counted_rows, runs)
    options: dict[str, Any] = {"stream": io.StringIO(), "backend": "loky", "workers": 2}
    assert run_shards(work, SHARDS, again, **options) == 2
    assert sorted(file.name for file in runs.iterdir()) == ["run-2", "run-3"]
    assert [row for rows in again.read_all(SHARDS) for row in rows] == EXPECTED
    assert run_shards(work, SHARDS, again, **options) == 0


@needs_proc
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_stopped_command_keeps_what_is_done_and_ends_its_workers(
    name: str, tmp_path: Path
) -> None:
    script = tmp_path / "command.py"
    script.write_text(STOPPED.format(rows=str(tmp_path / "rows"), pid=str(tmp_path / "pid")))
    command = subprocess.Popen(
        [sys.executable, str(script)],
        cwd=Path(__file__).resolve().parents[3],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heed_interrupts,
    )
    wait_for((tmp_path / "pid").exists)
    if name == "SIGINT":
        os.killpg(command.pid, signal.SIGINT)  # a terminal sends it to every process
    else:
        command.kill()
    out, errors = command.communicate()
    assert out == ("stopped\n" if name == "SIGINT" else "")
    assert "Traceback" not in errors
    worker = int((tmp_path / "pid").read_text())
    wait_for(lambda: not runs(worker))
    store = ShardStore(tmp_path / "rows", {}, RowCodec())
    assert [shard.index for shard in store.missing(SHARDS)] == [1, 2, 3]
    assert not list((tmp_path / "rows").glob("*.part"))


STOPPED = """
import os, time
from pathlib import Path
from loose_agents.execution.shard_store import RowCodec, ShardStore
from loose_agents.execution.shards import run_shards, shard_of

def work(shard):
    if shard.index == 1:
        beside = Path({pid!r} + ".part")
        beside.write_text(str(os.getpid()))
        beside.replace({pid!r})
        time.sleep(300.0)
    return [{{"episode": k}} for k in shard.episodes]

if __name__ == "__main__":
    store = ShardStore({rows!r}, {{}}, RowCodec())
    try:
        run_shards(work, shard_of(11, 3), store, workers=1)
    except KeyboardInterrupt:
        print("stopped")
"""


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


@pytest.mark.parametrize("codec", [RowCodec(), ArrayCodec()], ids=["rows", "arrays"])
@pytest.mark.parametrize("kept", [0.0, 0.5, 0.97, -3])
def test_a_file_cut_short_is_made_again(tmp_path: Path, codec: Any, kept: float) -> None:
    work = rows_of if isinstance(codec, RowCodec) else arrays_of
    store = ShardStore(tmp_path, CONFIGURATION, codec)
    options: dict[str, Any] = {"stream": io.StringIO(), "backend": "threading"}
    assert run_shards(work, SHARDS, store, **options) == len(SHARDS)
    path = store.path(SHARDS[2])
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * kept) if kept >= 0.0 else int(kept)])
    with pytest.raises(InvalidData, match="cut short or broken"):
        store.read(SHARDS[2])
    assert run_shards(work, SHARDS, store, **options) == 1
    assert path.read_bytes() == whole


def test_a_flipped_bit_of_an_array_is_noticed(tmp_path: Path) -> None:
    store = ShardStore(tmp_path, CONFIGURATION, ArrayCodec())
    store.write(SHARDS[0], {"records": np.zeros(1000)})
    path = store.path(SHARDS[0])
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert store.missing(SHARDS[:1]) == [SHARDS[0]]


def test_arrays_come_back_as_they_were(tmp_path: Path) -> None:
    store = ShardStore(tmp_path, CONFIGURATION, ArrayCodec())
    given = {
        "file": np.arange(6, dtype=np.int16).reshape(2, 3),
        "truth": np.array(["healthy", "link 2"]),
        "open": np.array(True),
        "none": np.zeros((0, 4)),
    }
    store.write(SHARDS[0], given)
    found = store.read(SHARDS[0])
    assert list(found) == list(given)
    for name, array in given.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)


def test_results_of_another_kind_are_refused_with_the_shard_named(tmp_path: Path) -> None:
    arrays = ShardStore(tmp_path / "a", CONFIGURATION, ArrayCodec())
    for value in ([1, 2], {"a": np.array([object()])}):
        with pytest.raises(InvalidData, match="shard 0 "):
            arrays.write(SHARDS[0], value)
    rows = ShardStore(tmp_path / "r", CONFIGURATION, RowCodec())
    for value in (3, [{1: 2}], [{"a": object()}], "rows"):
        with pytest.raises(InvalidData, match="shard 0 "):
            rows.write(SHARDS[0], value)
    assert not list(tmp_path.glob("*/shard-*"))


def test_another_configuration_is_refused_and_what_differs_is_named(tmp_path: Path) -> None:
    ShardStore(tmp_path, CONFIGURATION, RowCodec())
    ShardStore(tmp_path, {"arm": {"links": 4.0}, "seed": np.int64(5)}, RowCodec())
    with pytest.raises(InvalidSetting, match=r"arm\.links is 4 there and 5 here; ") as caught:
        ShardStore(tmp_path, {**CONFIGURATION, "arm": {"links": 5}}, RowCodec())
    assert "seed" not in str(caught.value)
    with pytest.raises(InvalidSetting, match=r"noise is absent there and 0\.5 here"):
        ShardStore(tmp_path, {**CONFIGURATION, "noise": 0.5}, RowCodec())


def test_shards_of_unknown_origin_are_refused(tmp_path: Path) -> None:
    store = ShardStore(tmp_path, CONFIGURATION, RowCodec())
    store.write(SHARDS[0], rows_of(SHARDS[0]))
    (tmp_path / "configuration.json").unlink()
    with pytest.raises(InvalidSetting, match=r"no configuration\.json"):
        ShardStore(tmp_path, CONFIGURATION, RowCodec())
    (tmp_path / "configuration.json").write_text("{")
    with pytest.raises(InvalidSetting, match="cannot be read"):
        ShardStore(tmp_path, CONFIGURATION, RowCodec())


def test_shards_of_another_size_do_not_mix(tmp_path: Path) -> None:
    store = ShardStore(tmp_path, CONFIGURATION, RowCodec())
    for shard in SHARDS:
        store.write(shard, rows_of(shard))
    other = shard_of(11, 4)
    assert store.missing(other) == list(other)
    # More episodes in shards of the same size keep what is whole.
    assert [shard.start for shard in store.missing(shard_of(15, 3))] == [9, 12]


@dataclass(frozen=True)
class Hinge:
    gap: float


@dataclass(frozen=True)
class Slide:
    gap: float


def test_the_hash_tells_values_apart_and_nothing_else() -> None:
    base = configuration_hash({"a": 1, "b": (1, 2), "path": Path("x/y")})
    assert base == configuration_hash({"path": "x/y", "b": np.array([1.0, 2.0]), "a": 1})
    assert base != configuration_hash({"a": 1, "b": (2, 1), "path": "x/y"})
    assert configuration_hash(Hinge(0.1)) != configuration_hash(Slide(0.1))
    assert configuration_hash({"a": True}) != configuration_hash({"a": 1})
    with pytest.raises(InvalidData, match="cannot hold"):
        configuration_hash({"a": {1, 2}})


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_ten_lines_in_a_log_and_one_on_a_terminal() -> None:
    log, terminal = io.StringIO(), Terminal()
    for stream in (log, terminal):
        with ProgressLine(200, done=100, stream=stream) as line:
            for k in range(100):
                line.advance(1, f"loss {k}")
    lines = log.getvalue().splitlines()
    assert len(lines) == 5
    assert lines[-1].startswith("100%|") and "200/200" in lines[-1]
    assert lines[-1].endswith("episodes/s, loss 99]")
    assert terminal.getvalue().count("\n") == 1
    assert terminal.getvalue().count("\r") >= 2


def test_a_log_ends_with_the_last_unit_where_tenths_do_not_divide_the_work() -> None:
    log = io.StringIO()
    with ProgressLine(25, stream=log) as line:
        for _ in range(25):
            line.advance(1)
    counts = [text.split("|")[2].split()[0] for text in log.getvalue().splitlines()]
    assert counts == [*(f"{k}/25" for k in range(3, 25, 3)), "25/25"]
