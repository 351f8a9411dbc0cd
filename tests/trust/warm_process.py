"""A command of Python in a forked process, which finds the large packages loaded."""

from __future__ import annotations

import multiprocessing
import os
import runpy
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import BinaryIO

ROOT = Path(__file__).resolve().parents[2]
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    [
        *("loose_agents.rl.model_files", "loose_env.gap.workflow.pipeline"),
        *("loose_env.instrument.pipeline", "loose_env.report", "matplotlib.pyplot"),
        *("stable_baselines3", "sb3_contrib"),
    ]
)


class WarmProcess:
    """A process of its own that runs the words after ``python``; ended as a `Popen` is."""

    def __init__(self, words: Sequence[str], said: BinaryIO) -> None:
        ready, child = FORKS.Pipe(duplex=False)
        self.process = FORKS.Process(target=_run, args=(list(words[1:]), said.name, child))
        self.process.start()
        child.close()
        ready.recv()  # it leads its group from here on
        assert self.process.pid is not None
        self.pid: int = self.process.pid

    @property
    def returncode(self) -> int | None:
        return self.process.exitcode

    def poll(self) -> int | None:
        return self.process.exitcode

    def wait(self) -> int | None:
        self.process.join()
        return self.process.exitcode


def _run(words: list[str], said: str, ready: Connection) -> None:
    os.setsid()
    os.chdir(ROOT)
    for path, stream in ((os.devnull, 1), (said, 2)):
        os.dup2(os.open(path, os.O_WRONLY), stream)
    ready.send(True)
    ready.close()
    if words[0] == "-c":
        sys.argv = ["-c", *words[2:]]
        exec(compile(words[1], "-c", "exec"), {"__name__": "__main__"})
    elif words[0] == "-m":
        sys.argv = words[1:]
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        sys.argv = words
        sys.path.insert(0, str(Path(words[0]).resolve().parent))
        runpy.run_path(words[0], run_name="__main__")
