"""Fixtures that several folders of tests share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from hypothesis import settings

from loose_env.arms import DESK_ARM, Arm, MismatchDraw, arm_from_file, planar, scara, six_axis, vera
from loose_env.envs import BatchRig, DiagnosisEnv, DiagnosisSettings, DiagnosisVectorEnv
from loose_env.faults import Fault
from loose_env.rig import Records, Trials
from loose_env.typing import IndexArray

settings.register_profile("loose_env", deadline=None, derandomize=True, database=None)
settings.load_profile("loose_env")


def _desk(**arguments: Any) -> Arm:
    return arm_from_file(DESK_ARM, **arguments)


ARMS: dict[str, Callable[..., Arm]] = {
    "planar": planar,
    "vera": vera,
    "six_axis": six_axis,
    "scara": scara,
    "desk": _desk,
}


class SpyRig:
    """A rig that notes what is asked of it and passes it on."""

    def __init__(self, rig: BatchRig) -> None:
        self.rig = rig
        self.asked: list[Trials] = []

    def mount_all(
        self, slots: IndexArray, faults: Sequence[Fault], mismatches: Sequence[MismatchDraw]
    ) -> None:
        self.rig.mount_all(slots, faults, mismatches)

    def record(self, asked: Sequence[Trials]) -> Iterator[tuple[int, IndexArray, Records]]:
        self.asked += asked
        return self.rig.record(asked)


def _take_arm(arguments: dict[str, Any]) -> dict[str, Any]:
    names = ("n_links", "vertical", "hold")
    return {name: arguments.pop(name) for name in names if name in arguments}


@pytest.fixture
def make_env() -> Iterator[Callable[..., DiagnosisEnv]]:
    """Make a single environment without wrappers: arm's name, its arguments, settings."""
    made: list[DiagnosisEnv] = []

    def make(name: str = "planar", *, rig: BatchRig | None = None, **arguments: Any) -> Any:
        arm = ARMS[name](**_take_arm(arguments))
        made.append(DiagnosisEnv(arm, DiagnosisSettings(**arguments), rig=rig, threads=1))
        return made[-1]

    yield make
    for env in made:
        env.close()


@pytest.fixture
def make_vector() -> Iterator[Callable[..., DiagnosisVectorEnv]]:
    """Make a vector environment: arm's name, its arguments, number of arms, settings."""
    made: list[DiagnosisVectorEnv] = []

    def make(name: str = "planar", num_envs: int = 2, threads: int = 1, **arguments: Any) -> Any:
        arm = ARMS[name](**_take_arm(arguments))
        env = DiagnosisVectorEnv(
            arm, DiagnosisSettings(**arguments), num_envs=num_envs, threads=threads
        )
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


@pytest.fixture
def spy_on() -> Callable[[DiagnosisEnv | DiagnosisVectorEnv], SpyRig]:
    """Put a spy between an environment and its rig; returns the spy."""

    def spy(env: DiagnosisEnv | DiagnosisVectorEnv) -> SpyRig:
        env.batch.rig = SpyRig(env.batch.rig)
        return env.batch.rig

    return spy
