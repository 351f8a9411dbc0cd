"""Damage to the files of a recording: its description, its tables, its model."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from scripts.suites.trust.fuzz.hostile import ELEMENTS, WHOLE
from scripts.suites.trust.fuzz.mutations import (
    HUGE,
    PATHS,
    damaged_bytes,
    damaged_json,
    damaged_text,
    damaged_xml,
)
from scripts.suites.trust.fuzz.surroundings import Surroundings

__all__ = ["Trap", "csv", "description", "model", "parquet", "paths", "pickled", "values", "xml"]

Rng = np.random.Generator


class Trap:
    """Unpickling it makes a file: the proof that something ran."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.place / "EXECUTED",)


def pickled(around: Surroundings) -> bytes:
    """A pickle that would leave a file behind."""
    return pickle.dumps(Trap(around.cwd))


def description(files: dict[str, bytes], around: Surroundings, rng: Rng) -> str:
    """Damage what describes the recording."""
    damage, files["recording.json"] = damaged_json(files["recording.json"], rng)
    return damage


def paths(files: dict[str, bytes], around: Surroundings, rng: Rng) -> str:
    """Put a path that leads elsewhere, or nowhere, in the place of a file."""
    whole = json.loads(files["recording.json"])
    place = str(rng.choice([*PATHS, str(around.secret / "secret.csv")]))
    if rng.random() < 0.3:
        whole["model"] = place.replace("csv", "xml")
    else:
        whole["runs"][0]["file"] = place
    files["recording.json"] = json.dumps(whole).encode("utf-8", "surrogatepass")
    return f"a path: {place[:20]!r}"


def csv(files: dict[str, bytes], around: Surroundings, rng: Rng) -> str:
    """Damage the table in text."""
    if rng.random() < 0.4:
        damage, files["run.csv"] = damaged_text(files["run.csv"], rng)
        return damage
    lines = [line.split(",") for line in files["run.csv"].decode().splitlines()]
    row, column = int(rng.integers(len(lines))), int(rng.integers(len(lines[0])))
    damage = str(rng.choice(["a cell", "a row lost", "rows swapped", "a cell lost", "a column"]))
    if damage == "a cell":
        cells = (*HUGE, "", "text", "=1+1", "\x00", "１", '"', "1;2", "inf", "-inf", "1e5000")
        lines[row][column] = str(rng.choice(cells))
    elif damage == "a row lost":
        del lines[row]
    elif damage == "rows swapped":
        other = int(rng.integers(len(lines)))
        lines[row], lines[other] = lines[other], lines[row]
    elif damage == "a cell lost":
        del lines[row][column]
    else:
        lines[0][column] = str(
            rng.choice([lines[0][0], "sensor.none", "", "time", "ctrl.", "a" * 9999])
        )
    files["run.csv"] = "\n".join(map(",".join, lines)).encode()
    return damage


def values(files: dict[str, bytes], around: Surroundings, rng: Rng) -> str:
    """Give the table numbers that can be read, and that no arm made: as a broken recorder does."""
    lines = files["run.csv"].decode().splitlines()
    names = lines[0].split(",")
    table = np.array([line.split(",") for line in lines[1:]], dtype=float)
    damage = str(
        rng.choice(["jump", "clock", "pause", "rate", "missing", "still", "scaled", "few"])
    )
    row, column = int(rng.integers(len(table))), int(rng.integers(1, len(names)))
    if damage == "jump":
        table[row:, 0] += float(rng.choice([0.01, 1.0, 9.0, 1e6, 1e12, 1e300]))
    elif damage == "clock":
        table[:, 0] *= float(rng.choice([1e-12, 1e-3, 1e3, 1e9]))
    elif damage == "pause":
        table = np.delete(table, np.s_[row : row + int(rng.integers(1, len(table)))], axis=0)
    elif damage == "rate":
        table = table[:: int(rng.integers(2, 30))]
    elif damage == "missing":
        table[row : row + int(rng.integers(1, len(table))), column] = np.nan
    elif damage == "still":
        table[:, column] = table[0, column]
    elif damage == "scaled":
        table[:, column] *= float(rng.choice([0.0, -1.0, 1e-9, 1e3, 1e6, 1e200]))
    else:
        table = table[: int(rng.integers(0, 100))]
    rows = [",".join("" if np.isnan(v) else repr(float(v)) for v in each) for each in table]
    files["run.csv"] = "\n".join([lines[0], *rows, ""]).encode()
    return damage


def parquet(files: dict[str, bytes], around: Surroundings, rng: Rng) -> str:
    """Damage the table in Parquet, or put a pickle in its place."""
    if rng.random() < 0.15:
        files["run.parquet"] = pickled(around)
        return "a pickle"
    damage, files["run.parquet"] = damaged_bytes(files["run.parquet"], rng)
    return damage


def model(files: dict[str, bytes], around: Surroundings, rng: Rng) -> str:
    """Damage the model."""
    damage, files["model.xml"] = xml(files["model.xml"], around, rng)
    return damage


def xml(data: bytes, around: Surroundings, rng: Rng) -> tuple[str, bytes]:
    """Damage a model: its elements, or the whole of it."""
    if rng.random() < 0.05:
        k = int(rng.integers(len(WHOLE)))
        return f"whole file {k}", WHOLE[k].encode()
    damage, changed = damaged_xml(data, rng, ELEMENTS)
    return damage, changed.replace(b"{secret}", str(around.secret).encode())
