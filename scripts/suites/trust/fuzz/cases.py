"""Kinds of files that are damaged, and what reads each of them."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.arms import arm_from_file
from scripts.suites.trust.fuzz import documents, instrument_cases
from scripts.suites.trust.fuzz.damage import csv, description, model, parquet, paths, pickled, xml
from scripts.suites.trust.fuzz.hostile import YAML
from scripts.suites.trust.fuzz.mutations import PATHS, damaged_bytes, damaged_json, damaged_text
from scripts.suites.trust.fuzz.surroundings import Surroundings
from scripts.suites.trust.fuzz.watch import Attempt

__all__ = ["KINDS", "attempt"]

Rng = np.random.Generator
Make = Callable[[Surroundings, Rng], Attempt]


def attempt(kind: str, number: int, around: Surroundings, seed: int) -> Attempt:
    """Make one damaged file; the same seed, kind and number always give the same."""
    sequence = np.random.SeedSequence(seed, spawn_key=(list(KINDS).index(kind), number))
    return KINDS[kind](around, np.random.default_rng(sequence))


def _recording_of(change: Callable[[dict[str, bytes], Surroundings, Rng], str]) -> Make:
    def make(around: Surroundings, rng: Rng) -> Attempt:
        from loose_env.recording import read_recording

        files = dict(documents.recording())
        damage = change(files, around, rng)
        home = around.fresh(files)

        def read() -> Any:
            found = read_recording(home)
            for run in found.runs:
                assert np.isfinite(run.time).all() and (np.diff(run.time) > 0).all()
                for values in (*run.sensors.values(), *run.controls.values()):
                    assert not np.isinf(values).any()
            names = [found.model().body(k).name for k in range(found.model().nbody)]
            return [run.name for run in found.runs], names

        return Attempt(damage=damage, read=read, names=(*files, "part.xml", home.name))

    return make


def _arm(text: Callable[[], bytes], name: str) -> Make:
    def make(around: Surroundings, rng: Rng) -> Attempt:
        import warnings

        from loose_env.arms import describe_file

        damage, data = xml(text(), around, rng)
        home = around.fresh({name: data, "two.stl": documents.tetrahedron()})
        whole = rng.random() < 0.15  # building an arm takes a second

        def read() -> Any:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                if whole:
                    arm = arm_from_file(home / name)
                    assert np.isfinite(arm.spec.compile().body_mass).all()
                    return arm.joints
                return str(describe_file(home / name))

        # What a file includes is named where that is at fault.
        others = ("part.xml", "inner.xml")
        return Attempt(damage=damage, read=read, names=(name, f"arm {Path(name).stem!r}", *others))

    return make


def _json_file(
    name: str, whole: Callable[[], bytes], reader: Callable[[], Callable[[Path], Any]]
) -> Make:
    def make(around: Surroundings, rng: Rng) -> Attempt:
        damage, data = damaged_json(whole(), rng)
        if rng.random() < 0.03:
            damage, data = "a pickle", pickled(around)
        home = around.fresh({name: data})
        read = reader()
        return Attempt(damage=damage, read=lambda: read(home / name), names=(name,))

    return make


def _gap_reader() -> Callable[[Path], Any]:
    from loose_env.gap import read_result

    return read_result


def _rows(around: Surroundings, rng: Rng) -> Attempt:
    from loose_env.evaluation import read_rows

    name = str(rng.choice(["rows.json", "rows.parquet"]))
    data = documents.rows()[name]
    damage, data = (damaged_json if name == "rows.json" else damaged_bytes)(data, rng)
    home = around.fresh({name: data})
    return Attempt(damage=damage, read=lambda: read_rows(home / name), names=(name,))


def _mapping(around: Surroundings, rng: Rng) -> Attempt:
    from loose_env.importing import read_mapping

    damage, data = damaged_text(documents.MAPPING, rng)
    home = around.fresh({"map.toml": data})
    return Attempt(damage=damage, read=lambda: read_mapping(home / "map.toml"), names=("map.toml",))


def _hyperparameters(around: Surroundings, rng: Rng) -> Attempt:
    from loose_agents.rl.hyperparameters import (
        HYPERPARAMETERS,
        model_arguments,
        read_hyperparameters,
    )

    hostile = YAML
    if rng.random() < 0.3:
        k = int(rng.integers(len(hostile)))
        damage, data = f"hostile YAML {k}", hostile[k].encode()
    else:
        source = HYPERPARAMETERS / str(rng.choice(["ppo.yml", "maskable_ppo.yml"]))
        damage, data = damaged_text(source.read_bytes(), rng)
    home = around.fresh({"conf.yml": data})

    def read() -> Any:
        found = read_hyperparameters(home / "conf.yml", "loose_env/Vera-v0")
        return sorted(model_arguments(found, "ppo"))

    # What is wrong with one of them is said by its own name.
    names = ("conf.yml", "hyperparameter", "policy", "normalize", "is a number", "known are")
    return Attempt(damage=damage, read=read, names=names)


def _arguments(around: Surroundings, rng: Rng) -> Attempt:
    from loose_agents.evaluation import arguments_of, diagnosis_env

    ids = ("loose_env/Planar-v0", "loose_env/Vera-v0", "loose_env/Arm-v0")
    whole = {
        "n_links": 2, "difficulty": "hard", "hold": "servo", "max_records": 4,
        "durations": [0.2, 0.4], "moves": [0.0, 45.0], "kinds": ["backlash"], "engine": "mujoco",
    }  # fmt: skip
    some = {k: v for k, v in whole.items() if rng.random() < 0.5} or {"hold": "servo"}
    if rng.random() < 0.2:
        some["model"] = str(rng.choice([*PATHS, "link.xml"]))
    env_id = str(rng.choice(ids))
    damage, data = damaged_json(json.dumps(some).encode(), rng)
    around.fresh()
    text = data.decode("utf-8", "replace")

    def read() -> Any:
        import gymnasium

        try:
            return diagnosis_env(env_id, arguments_of(text)).arm.name
        except gymnasium.error.Error as error:
            if "\n" in str(error):
                raise AssertionError("an error of several lines") from error
            return "refused by gymnasium"

    return Attempt(damage=damage, read=read, names=("",))


def _tensors(folder: str, name: str, described: str, load: Callable[[Path], Any]) -> Make:
    def make(around: Surroundings, rng: Rng) -> Attempt:
        source = documents.WEIGHTS / folder
        files = {n: (source / n).read_bytes() for n in (name, described)}
        if rng.random() < 0.35:
            damage, files[described] = damaged_json(files[described], rng)
        elif rng.random() < 0.1:
            damage, files[name] = "a pickle", pickled(around)
        else:
            damage, files[name] = _safetensors(files[name], rng)
        home = around.fresh(files)
        return Attempt(damage=damage, read=lambda: load(home), names=(name, described, str(home)))

    return make


def _safetensors(data: bytes, rng: Rng) -> tuple[str, bytes]:
    """Damage a file of tensors: its bytes, the length of its header, or what the header says."""
    size = struct.unpack("<Q", data[:8])[0]
    choice = rng.random()
    if choice < 0.3:
        return damaged_bytes(data, rng)
    if choice < 0.45:
        length = int(rng.choice([0, 1, size + 1, size - 1, 2**31, 2**62]))
        return "a huge header", struct.pack("<Q", length) + data[8:]
    if choice < 0.55:
        values = np.frombuffer(data[8 + size :], dtype="<f4").copy()
        values[rng.integers(len(values), size=5)] = rng.choice([np.nan, np.inf, -np.inf, 3e38])
        return "not finite", data[: 8 + size] + values.tobytes()
    damage, header = damaged_json(data[8 : 8 + size].rstrip(b" "), rng)
    return f"header: {damage}", struct.pack("<Q", len(header)) + header + data[8 + size :]


def _policy(home: Path) -> Any:
    from loose_agents.rl.agents import LearnedAgent

    agent = LearnedAgent.load(_problem(), home)
    size = agent.form.observation_space.shape
    logits, _ = agent.network.logits(np.zeros(size, dtype=np.float32), agent.network.begin())
    assert np.isfinite(logits).all(), "the policy's logits are not finite"
    return logits.shape


def _posterior(home: Path) -> Any:
    from loose_env.diagnosis import AmortisedPosterior
    from loose_env.envs import difficulty_named

    problem = _problem()
    posterior = AmortisedPosterior.load(
        home,
        problem.linear,
        problem.settings.sensors,
        difficulty_named(problem.settings.difficulty).mismatch,
    )
    assert np.isfinite(posterior.frictions).all()
    return posterior.features.locations


_KNOWN: list[Any] = []


def _problem() -> Any:
    from loose_agents.base import Problem

    from loose_env.arms import vera
    from loose_env.envs import DiagnosisSettings

    if not _KNOWN:
        _KNOWN.append(Problem.of(vera(), DiagnosisSettings()))
    return _KNOWN[0]


KINDS: dict[str, Make] = {
    "recording.json": _recording_of(description),
    "paths in recording.json": _recording_of(paths),
    "CSV": _recording_of(csv),
    "Parquet": _recording_of(parquet),
    "model of a recording": _recording_of(model),
    "MJCF": _arm(lambda: documents.MODEL.encode(), "arm.xml"),
    "MJCF, six joints": _arm(documents.arm_text, "desk.xml"),
    "URDF": _arm(lambda: documents.URDF.encode(), "arm.urdf"),
    "gap result": _json_file("result.json", documents.gap_result, _gap_reader),
    "diagnosis result": instrument_cases.result,
    "rows": _rows,
    "mapping": _mapping,
    "hyperparameters": _hyperparameters,
    "arguments of an environment": _arguments,
    "policy": _tensors("ppo-vera-default", "policy.safetensors", "configuration.json", _policy),
    "posterior": _tensors(
        "posterior-vera-default", "posterior.safetensors", "configuration.json", _posterior
    ),
    "recording to diagnose": instrument_cases.to_diagnose,
    "plan beside a recording": instrument_cases.plan_beside,
    "MCAP": instrument_cases.log("log.mcap"),
    "UFF": instrument_cases.log("log.uff"),
    "table of a logger": instrument_cases.log("log.csv"),
}
"""Kind of file -> what makes one damaged file of it."""
