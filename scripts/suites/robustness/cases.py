"""Cases: a command of `loose`, the arm it is given, and the recording."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import hypothesis
import mujoco
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from loose_env.arms import quiet
from loose_env.recording import write_csv
from loose_env.typing import Array
from scripts.suites.robustness.arms import ArmFile, arms, mjcf_arms
from scripts.suites.robustness.runs import RunPlan, make_run, run_plans

__all__ = ["COMMANDS", "Case", "case_of", "cases", "write_case", "write_unchecked"]

COMMANDS = ("gap", "diagnose", "doctor", "inspect", "plan")
"""Commands that are tried."""
_RECORDED = ("gap", "diagnose", "doctor")
_PASSED_OVER = 3


@dataclass(frozen=True, kw_only=True)
class Case:
    """One call of a command."""

    command: str
    arm: ArmFile
    runs: tuple[RunPlan, ...] = ()
    """Recipes of the runs; none for a command that reads a model."""
    kinds: tuple[str, ...] = ()
    """Effects that `loose gap` considers; all where none is named."""

    @property
    def words(self) -> str:
        """Short description."""
        runs = "; ".join(
            f"{r.columns} {r.samples} at {r.rate:g} Hz, {r.clock}, {'+'.join(r.damages) or 'sound'}"
            for r in self.runs
        )
        return f"{self.command}: {self.arm.ending} of {self.arm.joints} joints; {runs}"


def cases(commands: tuple[str, ...] = COMMANDS) -> st.SearchStrategy[Case]:
    """Cases of some commands, equally often."""
    return st.sampled_from(commands).flatmap(_cases_of)


def case_of(number: int, commands: tuple[str, ...] = COMMANDS) -> Case:
    """Case of a number: the same in every run, and unlike its neighbours.

    Hypothesis varies what it drew before, so that cases drawn together are alike; each number is a
    seed of its own, and the first draws, which are the simplest, are passed over.
    """
    drawn: list[Case] = []

    @hypothesis.seed(number)
    @settings(
        max_examples=_PASSED_OVER,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=cases(commands))
    def draw(case: Case) -> None:
        drawn.append(case)

    draw()
    return drawn[-1]


def _cases_of(command: str) -> st.SearchStrategy[Case]:
    if command not in _RECORDED:
        return st.builds(Case, command=st.just(command), arm=arms())
    mixed = st.lists(run_plans(), min_size=1, max_size=3)
    same = run_plans().flatmap(lambda r: st.integers(2, 3).map(lambda n: [r] * n))
    kinds = st.sampled_from([("viscous_friction", "coulomb_friction"), ("backlash",), ("payload",)])
    return st.builds(
        Case,
        command=st.just(command),
        arm=st.one_of(mjcf_arms(), mjcf_arms(), mjcf_arms(), arms()),
        runs=st.one_of(same, same, mixed).map(tuple),
        kinds=kinds if command == "gap" else st.just(()),
    )


def write_case(case: Case, folder: Path) -> list[str]:
    """Write the files of a case as any recorder might, unchecked, and return the command line."""
    folder.mkdir(parents=True, exist_ok=True)
    model_file = folder / f"model.{case.arm.ending}"
    model_file.write_text(case.arm.text, encoding="utf-8")
    out = ["--quiet"]
    if case.command not in _RECORDED:
        more = ["--out", str(folder / "out")] if case.command == "plan" else []
        return [case.command, str(model_file), *more, *out]
    with quiet():
        return _written(case, folder, model_file, out)


def write_unchecked(folder: Path, model: str, runs: Mapping[str, Mapping[str, Array]]) -> None:
    """Write a recording as any recorder might: columns of each run by its file, unchecked."""
    for name, columns in runs.items():
        write_csv(folder / name, dict(columns))
    entries = ", ".join(f'{{"file": "{name}"}}' for name in runs)
    folder.joinpath("recording.json").write_text(
        f'{{"format": "loose-recording/1", "model": "{model}", "runs": [{entries}]}}',
        encoding="utf-8",
    )


def _written(case: Case, folder: Path, model_file: Path, out: list[str]) -> list[str]:
    """Write the recording beside its model."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = mujoco.MjModel.from_xml_string(case.arm.text)
    runs = {}
    for k, plan in enumerate(case.runs):
        run = make_run(model, plan, k)
        columns = {"time": run.time} | {f"ctrl.{n}": v for n, v in run.controls.items()}
        for name, values in run.sensors.items():
            if values.ndim == 1:
                columns[f"sensor.{name}"] = values
            else:
                columns |= {f"sensor.{name}.{a}": values[:, i] for i, a in enumerate("xyz")}
        columns |= {f"torque.{n}": v for n, v in run.torques.items()}
        runs[run.name] = columns
    write_unchecked(folder, model_file.name, runs)
    more = [] if case.command == "doctor" else ["--out", str(folder / "out"), "--ignore-doctor"]
    if case.command == "gap":
        more += ["--kinds", *case.kinds, "--threads", "1"]
    return [case.command, str(folder), *more, *out]
