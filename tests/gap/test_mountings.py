"""A payload that some runs lack, or that is turned between runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import tests.gap.cases.gap_case as gap_case
from loose_env.gap import GapSettings, solve_gap
from loose_env.recording import Recording
from tests.gap.cases.gap_case import torque_log

Edit = Callable[[Any], None]
MASSES = GapSettings(
    threads=1, kinds=("payload", "link_mass", "link_com", "coulomb_friction", "torque_offset")
)


def carries(mass: float, x: float = 0.0, z: float = 0.0) -> Edit:
    """A machine with a payload at its tool."""

    def edit(spec: Any) -> None:
        load = spec.body("lower").add_body(name="load", pos=[0.25 + x, 0, z])
        load.mass, load.inertia, load.ipos = mass, [1e-5] * 3, [0, 0, 0]
        load.explicitinertial = True

    return edit


def bare(spec: Any) -> None:
    """A machine without one."""


def mixed(folder: Path, edits: Sequence[Edit], monkeypatch: pytest.MonkeyPatch) -> Recording:
    """Recording whose runs are of machines edited one way each."""
    monkeypatch.setattr(gap_case, "COUNT", 1800)
    made = [torque_log(folder / str(k), edit=e, runs=len(edits)) for k, e in enumerate(edits)]
    return replace(made[0], runs=tuple(m.runs[k] for k, m in enumerate(made)))


def test_a_payload_of_some_runs_is_said_of_these(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = mixed(tmp_path, [carries(0.5), bare, carries(0.5), bare], monkeypatch)
    found = solve_gap(recording, MASSES).result
    (effect,) = found.effects
    names = [run.name for run in recording.runs]
    assert effect.kind == "payload" and effect.mountings == ((names[0], names[2]),)
    assert effect.parameters["mass"] == pytest.approx(0.5, rel=0.03)


@pytest.mark.parametrize("edits", [[bare] * 3, [carries(0.5, 0.03)] * 3])
def test_where_all_runs_are_alike_no_run_is_said(
    edits: list[Edit], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = solve_gap(mixed(tmp_path, edits, monkeypatch), MASSES).result
    assert not any(effect.mountings for effect in found.effects)
    assert [e.kind for e in found.effects] == ([] if edits[0] is bare else ["payload"])
