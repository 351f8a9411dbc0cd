"""Damaged files that the instrument reads, and the way they take through it."""

from __future__ import annotations

import json
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from scripts.suites.trust.fuzz import damage as damages
from scripts.suites.trust.fuzz import documents
from scripts.suites.trust.fuzz.mutations import damaged_bytes, damaged_json, damaged_text
from scripts.suites.trust.fuzz.surroundings import Surroundings
from scripts.suites.trust.fuzz.watch import Attempt

__all__ = ["log", "plan_beside", "result", "to_diagnose"]

Rng = np.random.Generator

_READ_OF_PLAN = ("format", "recording", "known", "settings")
"""Entries of plan.json that are read again."""
_PLANNED = 0.1
"""Share of the recordings to diagnose for which the next measurement is chosen too."""


def result(around: Surroundings, rng: Rng) -> Attempt:
    """A diagnosis, read, and planned with where it can be read."""
    damage, data = damaged_json(documents.diagnosis_result(), rng)
    if rng.random() < 0.03:
        damage, data = "a pickle", damages.pickled(around)
    home = around.fresh({"result.json": data, "arm.xml": documents.MODEL.encode()})

    def read() -> Any:
        from loose_env.instrument import plan, read_diagnosis

        known = read_diagnosis(home / "result.json")
        # What may be asked for at most takes minutes, and is asked for rightly.
        choice = known.choice
        short = replace(choice, poses=min(choice.poses, 2), seconds=1.0, rate_hz=1000.0)
        with _work(around), _quiet():
            made = plan(home / "arm.xml", known, choice=short)
        assert all(np.isfinite(u).all() for u in made.signals[0].commands.values())
        return made.next.reason

    # That the diagnosis is of another model is said without the file.
    names = ("result.json", "diagnosis", "arm 'arm'", "band", "rate")
    return Attempt(damage=damage, read=read, names=names, may_write=around.work)


def to_diagnose(around: Surroundings, rng: Rng) -> Attempt:
    """A recording of a healthy arm, diagnosed where it can be read."""
    files = dict(documents.shaken())
    ways = (damages.values, damages.values, damages.csv, damages.description, damages.model)
    damage = ways[int(rng.integers(len(ways)))](files, around, rng)
    planned = rng.random() < _PLANNED
    home = around.fresh(files)

    def read() -> Any:
        from loose_env.instrument import DiagnoseSettings, diagnose
        from loose_env.recording import read_recording

        settings = DiagnoseSettings(poses=2, seconds=1.0)
        with _work(around), _quiet():
            found = diagnose(read_recording(home), settings, plan=planned)
        shown = list(found.posterior.values())
        assert np.isfinite(shown).all() and abs(sum(shown) - 1) < 1e-6
        return found.to_json()

    names = (
        *files,
        "arm 'model'",
        "part.xml",
        "inner.xml",
        home.name,
        "model and runs",
        "all runs",
    )
    return Attempt(damage=damage, read=read, names=names, may_write=around.work)


def plan_beside(around: Surroundings, rng: Rng) -> Attempt:
    """The plan beside a recording: what a diagnosis reads of it, its settings above all."""
    whole = json.loads(documents.plan())
    damage, data = damaged_json(json.dumps({k: whole[k] for k in _READ_OF_PLAN}).encode(), rng)
    home = around.fresh({"plan.json": data, "recording/recording.json": b"{}"})

    def read() -> Any:
        from loose_env.instrument import session_beside

        return session_beside(home / "recording")

    return Attempt(damage=damage, read=read, names=("plan.json",))


def log(name: str) -> Callable[[Surroundings, Rng], Attempt]:
    """A logger's file of some kind, described and imported."""

    def make(around: Surroundings, rng: Rng) -> Attempt:
        text = name.endswith(".csv") and rng.random() < 0.7
        damage, data = (damaged_text if text else damaged_bytes)(documents.logs()[name], rng)
        mapping = documents.log_mapping(name)
        home = around.fresh(
            {name: data, "map.toml": mapping, "model.xml": documents.MODEL.encode()}
        )

        def read() -> Any:
            from loose_env.errors import LooseEnvError
            from loose_env.importing import describe_sources, import_recording

            try:
                describe_sources([str(home / name)])
            except LooseEnvError as error:
                assert name in str(error), error
            try:
                with _quiet():
                    found = import_recording([home / name], home / "map.toml", around.work / "made")
                return [(run.name, run.samples) for run in found.runs]
            finally:
                shutil.rmtree(around.work / "made", ignore_errors=True)

        return Attempt(damage=damage, read=read, names=(name, "map.toml"), may_write=around.work)

    return make


@contextmanager
def _work(around: Surroundings) -> Iterator[None]:
    """Temporary files in the folder that may be written to."""
    before, tempfile.tempdir = tempfile.tempdir, str(around.work)
    try:
        yield
    finally:
        tempfile.tempdir = before


@contextmanager
def _quiet() -> Iterator[None]:
    """No words on figures that a model does not give."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
