"""Speed and size of the vector environment, each as a ratio within one run.

Usage: python scripts/dev/benchmark.py [--arms 64] [--rounds 4] [--ids ...] [--model arm.xml]
[--engines] [--quick]
"""

from __future__ import annotations

import argparse
import io
import os
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import mujoco.rollout
import numpy as np
from gymnasium.vector import AsyncVectorEnv

import loose_env  # noqa: F401  (registers the ids)
from loose_env.arms import DESK_ARM, quiet
from loose_env.envs import DiagnosisEnv, EpisodeBatch
from loose_env.errors import InvalidSetting
from loose_env.rig import SimulatedRig

EARLIER = "e3f7207"
"""Last commit whose reduced engine worked out one record after the other."""
IDS = ("loose_env/Vera-v0", "loose_env/Planar-v0", "loose_env/SixAxis-v0")


class PythonLoopRig(SimulatedRig):
    """Rival: `mj_step` called from Python, one arm after the other."""

    def _simulate(self, run: Any) -> None:
        for k, job in enumerate(run.jobs):
            model = self.plants[job.slot].model
            data = mujoco.MjData(model)
            spec = mujoco.mjtState.mjSTATE_INTEGRATION
            mujoco.mj_setState(model, data, self._batch.state[job.slot], spec)
            control, recorded, sensordata = run.delivered[k], run.recorded[k], data.sensordata
            for i in range(len(control)):
                data.ctrl[:] = control[i]
                mujoco.mj_step(model, data)
                recorded[i] = sensordata


class RolloutRig(SimulatedRig):
    """Rival: `mujoco.rollout`, which simulates many models on a thread pool."""

    def _simulate(self, run: Any) -> None:
        models = [self.plants[job.slot].model for job in run.jobs]
        if not hasattr(self, "_pool"):
            threads = os.cpu_count() or 1
            self._datas = [mujoco.MjData(models[0]) for _ in range(threads)]
            self._pool = mujoco.rollout.Rollout(nthread=threads)
        state = mujoco.mjtState
        states = []
        scratch = mujoco.MjData(models[0])
        inputs = state.mjSTATE_CTRL | state.mjSTATE_EQ_ACTIVE
        size = mujoco.mj_stateSize(models[0], inputs)
        count = run.delivered.shape[1]
        controls = np.empty((len(models), count, size))
        for k, job in enumerate(run.jobs):
            mujoco.mj_setState(
                models[k], scratch, self._batch.state[job.slot], state.mjSTATE_INTEGRATION
            )
            full = np.empty(mujoco.mj_stateSize(models[k], state.mjSTATE_FULLPHYSICS))
            mujoco.mj_getState(models[k], scratch, full, state.mjSTATE_FULLPHYSICS)
            states.append(full)
            n = run.delivered.shape[2]
            controls[k, :, :n] = run.delivered[k]
            controls[k, :, n:] = scratch.eq_active
        self._pool.rollout(
            models,
            self._datas,
            np.array(states),
            controls,
            control_spec=inputs,
            nstep=count,
            sensordata=run.recorded,
        )


def actions_of(batch: EpisodeBatch, rng: np.random.Generator, duration: int | None) -> list[Any]:
    """Draw one joint at a random level and random moves for every arm; None: random lengths."""
    n = batch.arm.n
    chosen = []
    for _ in range(batch.num):
        levels = np.zeros(n, dtype=np.intp)
        levels[rng.integers(n)] = rng.integers(1, 4)
        moves = rng.integers(0, len(batch.settings.moves), n)
        length = int(rng.integers(len(batch.settings.durations))) if duration is None else duration
        chosen.append(batch.actions.encode(moves=moves, levels=levels, duration=length))
    return chosen


def new_batch(
    env_id: str,
    arms: int,
    rig: type[SimulatedRig] | None = None,
    *,
    engine: str = "mujoco",
    threads: int = 0,
) -> EpisodeBatch:
    """Make the episodes behind an id, on a rival rig if one is given."""
    env = gymnasium.make(env_id, engine=engine).unwrapped
    arm, settings = env.arm, env.settings  # type: ignore[attr-defined]
    made = None if rig is None else rig(arm, slots=arms, sensors=settings.sensors)
    batch = EpisodeBatch(arm, settings, num=arms, rig=made, threads=threads)
    for slot in range(arms):
        batch.start(slot, seed=slot, number=0)
    return batch


@quiet()  # the same for every rival: no timers in the engine
def seconds_per_record(
    batch: EpisodeBatch, rounds: int, duration: int | None, *, of_processor: bool = False
) -> float:
    """Time the steps of a batch; every third round starts new episodes, as agents do.

    Seconds of processor time, of all threads together, do not depend on what else runs.
    """
    clock = time.process_time if of_processor else time.perf_counter
    rng = np.random.default_rng(0)
    batch.step(range(batch.num), actions_of(batch, rng, duration))  # warm up
    begin = clock()
    for k in range(rounds):
        if k % 3 == 0:
            for slot in range(batch.num):
                batch.start(slot, seed=slot, number=1 + k)
        batch.step(range(batch.num), actions_of(batch, rng, duration))
    return (clock() - begin) / (rounds * batch.num)


@quiet()
def bare_seconds_per_record(env_id: str, arms: int, rounds: int, duration: int | None) -> float:
    """Time `mujoco.batch` alone on the same models, states, controls and threads."""
    batch = new_batch(env_id, arms)
    rig = batch.rig
    assert isinstance(rig, SimulatedRig)
    rng = np.random.default_rng(0)
    kept: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    simulate = rig._simulate

    def keep(run: Any) -> None:
        ids = np.array([job.slot for job in run.jobs])
        kept.append((ids, rig._batch.state[ids].copy(), run.delivered))
        simulate(run)  # type: ignore[arg-type]

    rig._simulate = keep  # type: ignore[method-assign]
    batch.step(range(arms), actions_of(batch, rng, duration))
    # One call for each record length, all of its arms together.
    runs = []
    for steps in sorted({k[2].shape[1] for k in kept}):
        same = [k for k in kept if k[2].shape[1] == steps]
        ids, states, controls = (np.concatenate([k[i] for k in same]) for i in range(3))
        out = np.empty((len(ids), steps, rig._batch.model.nsensordata))
        runs.append((steps, ids, states, controls, {"sensordata": out}))
    spent = 0.0
    for k in range(rounds + 1):
        for _, ids, states, _, _ in runs:
            rig._batch.state[ids] = states
        begin = time.perf_counter()
        for steps, ids, _, controls, out in runs:  # type: ignore[assignment]
            rig._batch.rollout(steps, controls, record=("sensordata",), ids=ids, out=out)
        if k > 0:  # the first one warms up
            spent += time.perf_counter() - begin
    return spent / (rounds * arms)


def make_rival(env_id: str) -> gymnasium.Env[Any, Any]:
    """Make the single environment on the Python loop."""
    env = gymnasium.make(env_id).unwrapped
    arm, settings = env.arm, env.settings  # type: ignore[attr-defined]
    return DiagnosisEnv(arm, settings, rig=PythonLoopRig(arm, sensors=settings.sensors))


def subprocess_seconds_per_record(env_id: str, records: int, duration: int | None) -> float:
    """Time the Python loop as Gymnasium runs it in two subprocesses."""
    batch = new_batch(env_id, 2)
    rivals = AsyncVectorEnv([partial(make_rival, env_id)] * 2, context="spawn")
    rivals.reset(seed=0)
    rng = np.random.default_rng(0)
    rivals.step(np.array(actions_of(batch, rng, duration)))  # warm up
    begin = time.perf_counter()
    for _ in range(records // 2):
        rivals.step(np.array(actions_of(batch, rng, duration)))
    spent = time.perf_counter() - begin
    rivals.close()
    return spent / (2 * (records // 2))


@contextmanager
def earlier_code(commit: str) -> Iterator[Path | None]:
    """Folder with this repository's package as of a commit; None where git does not have it."""
    with tempfile.TemporaryDirectory() as folder:
        top = Path(__file__).parents[2]
        command = ["git", "-C", str(top), "archive", commit, "loose_env"]
        packed = subprocess.run(command, capture_output=True, check=False)
        if packed.returncode:
            yield None
            return
        with tarfile.open(fileobj=io.BytesIO(packed.stdout)) as archive:
            archive.extractall(folder, filter="data")
        yield Path(folder)


def engine_times(
    env_id: str, arms: Sequence[int], rounds: int, duration: int | None, earlier: Path | None
) -> list[tuple[int, float, float, float, float, float]]:
    """Time the reduced engine and its rivals in turn; all but the reduced ones once.

    Returns
    -------
    list of (int, float, float, float, float, float)
        For each number of arms: itself, then seconds a record of the reduced engine; seconds of
        processor time of it, of its earlier code (NaN without it) and of MuJoCo; seconds of two
        processes. MuJoCo and these are timed at the smallest number: more arms change little.
    """
    least = min(arms)
    wall: dict[int, list[float]] = {count: [] for count in arms}
    ours: dict[int, list[float]] = {count: [] for count in arms}
    before: dict[int, list[float]] = {count: [] for count in arms}
    for _ in range(2):
        for count in arms:
            batch = new_batch(env_id, count, engine="reduced")
            wall[count].append(seconds_per_record(batch, rounds, duration))
            batch = new_batch(env_id, count, engine="reduced", threads=1)
            ours[count].append(seconds_per_record(batch, rounds, duration, of_processor=True))
            if earlier is not None:
                code = (
                    "import sys\n"
                    f"sys.path[:0] = [{str(earlier)!r}, {str(Path(__file__).parent)!r}]\n"
                    "import benchmark as b\n"
                    f"made = b.new_batch({env_id!r}, {count}, engine='reduced')\n"
                    f"print(b.seconds_per_record(made, {rounds}, {duration}, of_processor=True))"
                )
                before[count].append(float(child(code)))
    mujoco = seconds_per_record(new_batch(env_id, least, threads=1), 1, duration, of_processor=True)
    loop = subprocess_seconds_per_record(env_id, max(least, 16), duration)
    return [
        (n, min(wall[n]), min(ours[n]), min(before[n], default=float("nan")), mujoco, loop)
        for n in arms
    ]


def print_engines(
    ids: Sequence[str], arms: Sequence[int], rounds: int, *, commit: str = EARLIER
) -> None:
    """Print the reduced engine beside its own earlier code and the other ways to simulate."""
    print("\nratios to the earlier code and to MuJoCo are of processor time on one thread")
    head = f"{'environment':22}{'record':>8}{'arms':>6}{'records/s':>11}{'per CPU s':>11}"
    print(head + f"{'vs ' + commit[:7]:>12}{'vs mujoco':>11}{'vs 2 processes':>16}")
    with earlier_code(commit) as earlier:
        for env_id in ids:
            durations = new_batch(env_id, 1).settings.durations
            for duration in (len(durations) - 1, None):
                name = "mixed" if duration is None else f"{durations[duration]} s"
                try:
                    found = engine_times(env_id, arms, rounds, duration, earlier)
                except InvalidSetting as error:  # numba is missing, or the arm stands at a shaker
                    print(f"{env_id:22}{error}")
                    break
                for count, wall, ours, before, mujoco, loop in found:
                    print(
                        f"{env_id:22}{name:>8}{count:>6}{1 / wall:>11.1f}{1 / ours:>11.1f}"
                        f"{before / ours:>12.2f}{mujoco / ours:>11.2f}{loop / wall:>16.2f}",
                        flush=True,
                    )


def child(code: str) -> str:
    """Run code in a fresh interpreter and return what it prints."""
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.strip()


def memory_of(env_id: str, arms: int) -> float:
    """Peak memory of a vector environment through three steps of full records [GiB]."""
    code = (
        "import resource, numpy as np, gymnasium, loose_env\n"
        f"v = gymnasium.make_vec({env_id!r}, num_envs={arms}); v.reset(seed=0)\n"
        f"a = np.array([v.actions.encode(levels=np.full(v.arm.n, 3))] * {arms})\n"
        "for _ in range(3): v.step(a)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)"
    )
    return float(child(code))


def import_time() -> tuple[float, bool]:
    """Time `import loose_env` in a fresh interpreter [s], and say whether torch came along."""
    code = (
        "import sys, time; t = time.perf_counter(); import loose_env\n"
        "print(time.perf_counter() - t, 'torch' in sys.modules)"
    )
    answers = [child(code).split() for _ in range(3)]
    return min(float(a[0]) for a in answers), any(a[1] == "True" for a in answers)


def file_times(model: Path, arms: int) -> tuple[float, float, float]:
    """Time an arm from its file to a running vector environment, in a fresh interpreter [s].

    Returns
    -------
    tuple of 3 floats
        The imports alone; from file to environment, reset included; its first step, in which every
        arm shakes one joint for 1.2 s.
    """
    code = (
        "import time, warnings; warnings.simplefilter('ignore'); begin = time.perf_counter()\n"
        "import numpy as np, loose_env, loose_env.envs.vector_env\n"
        "from loose_env.arms import arm_from_file\n"
        "imported = time.perf_counter()\n"
        f"arm = arm_from_file({str(model)!r})\n"
        f"env = loose_env.envs.vector_env.DiagnosisVectorEnv(arm, num_envs={arms})\n"
        "env.reset(seed=0)\n"
        "running = time.perf_counter()\n"
        "shake = env.actions.encode(levels=np.eye(arm.n, dtype=int)[0])\n"
        f"env.step(np.array([shake] * {arms})); stepped = time.perf_counter()\n"
        "print(imported - begin, running - imported, stepped - running)"
    )
    times = np.array([[float(t) for t in child(code).split()] for _ in range(3)])
    imports, running, step = times.min(axis=0)
    return float(imports), float(running), float(step)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table of ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=64, help="arms side by side")
    parser.add_argument("--many", type=int, default=256, help="arms in the engines' further rows")
    parser.add_argument("--engines", action="store_true", help="only the table of engines")
    parser.add_argument("--earlier", default=EARLIER, help="commit of the earlier reduced engine")
    parser.add_argument("--rounds", type=int, default=4, help="timed steps of the whole batch")
    parser.add_argument("--ids", nargs="*", default=list(IDS), help="environments to time")
    parser.add_argument("--model", type=Path, default=DESK_ARM, help="file of an arm to start from")
    parser.add_argument("--quick", action="store_true", help="fewer arms and rounds")
    options = parser.parse_args(arguments)
    arms, rounds = (16, 1) if options.quick else (options.arms, options.rounds)
    print(f"{os.cpu_count()} processors, {arms} arms, times per record\n")
    counts = sorted({arms, arms if options.quick else options.many})
    if options.engines:
        print_engines(options.ids, counts, rounds, commit=options.earlier)
        return
    head = f"{'environment':22}{'record':>8}{'ours':>10}{'records/s':>11}"
    print(head + f"{'of bare batch':>15}{'vs 2 processes':>16}{'vs rollout':>12}")
    for env_id in options.ids:
        durations = new_batch(env_id, 1).settings.durations
        for duration in (len(durations) - 1, 0, None):
            # In turn and more than once, so that a slow spell of the machine hits all of them.
            ours, bare, rollout = [], [], []
            for _ in range(2):
                ours.append(seconds_per_record(new_batch(env_id, arms), rounds, duration))
                bare.append(bare_seconds_per_record(env_id, arms, rounds, duration))
                rollout.append(
                    seconds_per_record(new_batch(env_id, arms, RolloutRig), rounds, duration)
                )
            name = "mixed" if duration is None else f"{durations[duration]} s"
            loop = subprocess_seconds_per_record(env_id, max(arms, 16), duration)
            mine = min(ours)
            print(
                f"{env_id:22}{name:>8}{1e3 * mine:>7.1f} ms{1 / mine:>11.1f}"
                f"{min(bare) / mine:>15.2f}{loop / mine:>16.2f}{min(rollout) / mine:>12.2f}",
                flush=True,
            )
    print_engines(options.ids, counts, rounds, commit=options.earlier)
    many = 4 * arms
    for env_id in options.ids:
        print(
            f"\npeak memory of {many} arms of {env_id}: {memory_of(env_id, many):.2f} GiB", end=""
        )
    if options.model.is_file():
        imports, running, step = file_times(options.model, 16)
        print(
            f"\n{options.model.name} to a running environment of 16 arms: {running:.2f} s after "
            f"imports of {imports:.2f} s; first step of 1.2 s records {step:.2f} s",
            end="",
        )
    seconds, torch = import_time()
    print(f"\nimport loose_env: {seconds:.2f} s, {'with' if torch else 'without'} torch")


if __name__ == "__main__":
    main()
