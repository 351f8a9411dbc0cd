"""Sessions: a tool's plan, checked and played on a machine, and what is left in folders.

``recordings/CASE/`` has what a tool may see: the model, the session's sheet, the recording, the
reference and raw logs. ``truth/CASE.json`` has the rest.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData
from loose_env.io import plain, write_text
from loose_env.typing import Array
from scripts.suites.instrument import sensing
from scripts.suites.instrument.cases import MONTHS, OPENED, Case, Machine, nominal_xml
from scripts.suites.instrument.machines import MARGIN, Sheet
from scripts.suites.instrument.physics import Chances, World

MOST_SECONDS = 240.0
"""Longest session [s]."""
Plan = Mapping[str, Any]
Enough = Callable[[Path], bool]


def pack(plan: Plan, path: Path) -> None:
    """Write a plan, as it comes from a tool, to a file of numbers."""
    runs = [dict(run) for run in plan["runs"]]
    arrays: dict[str, Any] = {
        f"command-{i}": np.asarray(run.pop("command"), float) for i, run in enumerate(runs)
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path,
        about=json.dumps(plain({"rate_hz": plan["rate_hz"], "runs": runs}, digits=15)),
        **arrays,
    )


def unpack(path: Path) -> Plan:
    """Read a plan."""
    with np.load(path, allow_pickle=False) as file:
        plan: dict[str, Any] = json.loads(str(file["about"]))
        for i, run in enumerate(plan["runs"]):
            run["command"] = file[f"command-{i}"]
    return plan


def plan_hash(plan: Plan) -> str:
    """Hash of what a plan makes a machine do."""
    digest = hashlib.sha256(f"{float(plan['rate_hz']):g}".encode())
    for run in plan["runs"]:
        digest.update(repr((run["name"], run.get("level"))).encode())
        digest.update(np.round(np.asarray(run["pose"], float), 9).tobytes())
        digest.update(np.round(np.asarray(run["command"], float), 9).tobytes())
    return digest.hexdigest()[:8]


def check_plan(plan: Plan, sheet: Sheet) -> None:
    """Refuse a plan that the machine's controller would not take."""
    rate, n = float(plan["rate_hz"]), len(sheet.joints)
    runs = list(plan["runs"])
    names = [run["name"] for run in runs]
    if not runs or len(set(names)) < len(names) or not 10 <= rate <= 10_000:
        raise InvalidData(f"plan: {len(runs)} runs at {rate:g} Hz; give runs with unlike names")
    seconds = sum(len(run["command"]) for run in runs) / rate
    if seconds > MOST_SECONDS:
        raise InvalidData(f"plan: {seconds:.0f} s of shaking; at most {MOST_SECONDS:.0f} s")
    margin = np.array([MARGIN[slide] for slide in sheet.slides])
    low, high = np.array(sheet.low) - margin, np.array(sheet.high) + margin
    for run in runs:
        command, pose = np.asarray(run["command"], float), np.asarray(run["pose"], float)
        where = f"plan: {run['name']}"
        if command.ndim != 2 or command.shape[1] != n or pose.shape != (n,) or len(command) < 10:
            raise InvalidData(f"{where}: command {command.shape}; give (samples, {n} joints)")
        if not np.isfinite(command).all() or not np.isfinite(pose).all():
            raise InvalidData(f"{where}: command or pose is not finite")
        angles = command if sheet.command == "position" else pose[None]
        if (angles < low).any() or (angles > high).any():
            raise InvalidData(f"{where}: leaves the joints' range")
        if sheet.command == "position" and np.abs(command[0] - pose).max() > 0.05:
            raise InvalidData(f"{where}: the first command is not the pose")
        speed = np.diff(command, axis=0) * rate if sheet.command == "position" else command
        most = np.array(sheet.torque if sheet.command == "torque" else sheet.speed)
        if (over := (np.abs(speed).max(axis=0) / most).max()) > 1.05:
            raise InvalidData(f"{where}: {over:.2f} times the largest speed or torque")


def lay_out(case: Case, folder: Path) -> None:
    """Write what a tool plans from: the model and the session's sheet."""
    write_text(folder / "model.xml", nominal_xml(case.machine))
    write_text(folder / "session.json", json.dumps(case.sheet.session(), indent=1) + "\n")


def levels_of(runs: Sequence[Mapping[str, Any]]) -> list[list[int]]:
    """Runs, in order, in groups between which a tool is asked whether it has enough."""
    groups: list[list[int]] = []
    for i, run in enumerate(runs):
        if i and run.get("level") == runs[i - 1].get("level"):
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def played(
    machine: Machine, world: World, chances: Chances, plan: Plan, which: Sequence[int],
    folder: Path, raw: Path | None,
) -> dict[str, list[float]]:  # fmt: skip
    """Play runs of a plan into a folder; travel of each fault in each run, over its clearance."""
    travel: dict[str, list[float]] = {}
    for i in which:
        run = plan["runs"][i]
        command: Array = np.asarray(run["command"], float)
        found = machine.play(np.asarray(run["pose"], float), command, float(plan["rate_hz"]), i)
        log = sensing.logged(found, machine.sheet, world, chances, i)
        sensing.write_run(folder, run["name"], sensing.columns_of(log, machine.sheet))
        if raw is not None:
            sensing.write_raw(raw, run["name"], log, machine.sheet)
        for name, share in found.travel.items():
            travel.setdefault(name, []).append(round(share, 3))
    return travel


def play_case(case: Case, plan: Plan, folder: Path, enough: Enough | None) -> dict[str, Any]:
    """Play a case's session and its reference into a folder; returns the truth."""
    check_plan(plan, case.sheet)
    shutil.rmtree(folder, ignore_errors=True)
    lay_out(case, folder)
    model, joints, runs = nominal_xml(case.machine), case.sheet.joints, list(plan["runs"])
    if case.world.run >= len(runs):
        once = dataclasses.replace(case.world, run=case.world.run % len(runs))
        case = dataclasses.replace(case, world=once)
    suspect, done, travel = case.suspect(), list[int](), dict[str, list[float]]()
    groups = levels_of(runs)
    for group in groups:
        for name, shares in played(
            suspect, case.world, Chances(seed=case.seed, day=0), plan, group,
            folder / "recording", folder / "raw",
        ).items():  # fmt: skip
            travel.setdefault(name, []).extend(shares)
        done += group
        sensing.write_index(folder / "recording", model, [runs[i] for i in done], joints, "suspect")
        if group is not groups[-1] and enough is not None and enough(folder):
            break
    played(case.reference(), World(), Chances(seed=case.seed, day=1), plan, done,
           folder / "reference", None)  # fmt: skip
    sensing.write_index(folder / "reference", model, [runs[i] for i in done], joints, "healthy")
    if case.damage:
        names = [runs[i]["name"] for i in done]
        shutil.rmtree(folder / "raw")
        sensing.damage(folder / "recording", case.damage, names, case.sheet, case.seed)
    seconds = sum(len(runs[i]["command"]) for i in done) / float(plan["rate_hz"])
    opened = {name: max(shares) >= OPENED for name, shares in travel.items()}
    return {**case.truth(), "travel": travel, "opened": opened, "shaken": round(seconds, 1)}


def play_months(case: Case, plan: Plan, folder: Path) -> dict[str, Any]:
    """Play a series of months: ``month-01`` and so on, each with the reference of its beginning."""
    check_plan(plan, case.sheet)
    shutil.rmtree(folder, ignore_errors=True)
    model, joints, runs = nominal_xml(case.machine), case.sheet.joints, list(plan["runs"])
    travel = []
    for month in range(MONTHS + 1):
        there = folder / f"month-{month:02d}"
        lay_out(case, there)
        found = played(
            case.in_month(month), World(), Chances(seed=case.seed, day=1 + month), plan,
            range(len(runs)), there / "recording", None,
        )  # fmt: skip
        travel.append({name: max(shares) for name, shares in found.items()})
        condition = "suspect" if month else "healthy"
        sensing.write_index(there / "recording", model, runs, joints, condition)
    for month in range(1, MONTHS + 1):
        there = folder / f"month-{month:02d}" / "reference"
        shutil.copytree(folder / "month-00" / "recording", there, copy_function=os.link)
    shutil.rmtree(folder / "month-00")
    seconds = MONTHS * sum(len(run["command"]) for run in runs) / float(plan["rate_hz"])
    return {**case.truth(), "travel": travel, "shaken": round(seconds, 1)}


def without_reference(folder: Path, copy: Path) -> Path:
    """A folder with links to all of another but its reference."""
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir(parents=True)
    for each in folder.iterdir():
        if each.name != "reference":
            (copy / each.name).symlink_to(each.resolve())
    return copy
