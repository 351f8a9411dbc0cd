"""Cases of the instrument suite by number: machine, fault or disturbance, damage, months.

A number below `FIRST_JUDGED` is for development. Those from there on are drawn from a phrase, so
that nobody has seen their cases before the phrase is chosen, and two classes of machines appear
there only.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from functools import cache
from typing import Any, Literal

import mujoco
import numpy as np

from scripts.suites.blind import FIRST_JUDGED, drawn_from
from scripts.suites.instrument import standins
from scripts.suites.instrument.machines import DESIGNS, Sheet, nominal_spec
from scripts.suites.instrument.physics import KINDS, Chances, Fault, Simulated, World
from scripts.suites.instrument.sensing import DAMAGES

Machine = Simulated | standins.StandIn
SEED = 71_003
"""Seed of the development numbers."""
SHEETS: Mapping[str, Sheet] = {
    **standins.SHEETS,
    **{name: design.sheet for name, design in DESIGNS.items()},
}
"""All classes of machines."""
CLASSES = tuple(SHEETS)
DEVELOPED = tuple(name for name, sheet in SHEETS.items() if not sheet.judged_only)
"""Classes that development numbers have."""
Series = Literal["cases", "damaged", "months"]
SERIES: tuple[Series, ...] = ("cases", "damaged", "months")
"""Sessions; sessions of which files are damaged; twelve monthly sessions of a machine."""
HEALTHY = {
    "plain": 0.35, "cable": 0.15, "mount": 0.12, "base": 0.10, "payload": 0.13, "press": 0.10,
    "hand": 0.05,
}  # fmt: skip
"""Kinds of healthy machines and their shares."""
SHARE_HEALTHY, SHARE_ONE = 0.45, 0.45
"""Shares of healthy machines and of one fault; the others have two."""
PRELOADED = 0.12
"""Share of the seats that a preload presses shut."""
OPENED = 0.5
"""Share of its clearance that a fault has to use in some run to count as opened."""
MONTHS = 12
GROWS_FROM = 6
"""First month in which the fault of a series has any clearance."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A case as drawn."""

    number: int
    series: Series
    name: str
    """Name of its folder; it tells nothing."""
    machine: str
    role: str
    """``healthy``, ``one`` or ``two``."""
    kind: str
    """Kind of healthy machine, or the faults' kinds."""
    faults: tuple[Fault, ...]
    world: World
    damage: str
    seed: tuple[int, ...]

    @property
    def sheet(self) -> Sheet:
        """What the user knows of the machine."""
        return SHEETS[self.machine]

    def suspect(self) -> Machine:
        """The machine on the day it is suspected."""
        return built(self.machine, Chances(seed=self.seed, day=0), self.faults, self.world)

    def reference(self) -> Machine:
        """The same machine before anything was wrong, on another day."""
        return built(self.machine, Chances(seed=self.seed, day=1))

    def in_month(self, month: int) -> Machine:
        """The machine of a series of months, with what its fault has come to."""
        share = max(0, month - GROWS_FROM + 1) / (MONTHS - GROWS_FROM + 1)
        faults = tuple(
            dataclasses.replace(f, clearance=f.clearance * share) for f in self.faults if share
        )
        return built(self.machine, Chances(seed=self.seed, day=1 + month), faults)

    def truth(self) -> dict[str, Any]:
        """What is kept from the tool."""
        own = dataclasses.asdict(self)
        own["base"], own["hobby"] = self.sheet.base, self.sheet.hobby
        own["bodies"], own["joints"] = self.sheet.bodies, self.sheet.joints
        return own


def built(
    name: str, chances: Chances, faults: tuple[Fault, ...] = (), world: World | None = None
) -> Machine:
    """A machine of a class, as built, on a day."""
    if name in DESIGNS:
        return Simulated(DESIGNS[name], chances, faults, world)
    return standins.StandIn(name, chances, faults, world)


@cache
def nominal_xml(name: str) -> str:
    """Model of a class that its user has, as MJCF."""
    spec = nominal_spec(DESIGNS[name]) if name in DESIGNS else standins.nominal(name)
    spec.compile()
    return str(spec.to_xml())


def seed_of(number: int, phrase: str, series: Series) -> tuple[int, ...]:
    """Seed of a case; judged ones need a phrase."""
    return (drawn_from(number, phrase, SEED), SERIES.index(series), number)


def machine_of(number: int) -> str:
    """Class of a case's machine, in turn."""
    classes = DEVELOPED if number < FIRST_JUDGED else CLASSES
    return classes[number % len(classes)]


def _round(number: int) -> int:
    """How often all classes have had their turn before."""
    return number // len(DEVELOPED if number < FIRST_JUDGED else CLASSES)


def skipped(number: int) -> str:
    """Reason for which a case cannot be played here; empty if it can."""
    return standins.absent() if machine_of(number) in standins.SHEETS else ""


def drawn(number: int, phrase: str = "", series: Series = "cases") -> Case:
    """Draw a case."""
    seed, machine = seed_of(number, phrase, series), machine_of(number)
    rng, sheet = np.random.default_rng([*seed, 0]), SHEETS[machine]
    dice, kind, world = rng.random(), "", World()
    faults: tuple[Fault, ...] = ()
    if series == "months":
        role = "one" if _round(number) % 2 == 0 else "healthy"
        kind = "plain"
    else:
        role = ("healthy" if dice < SHARE_HEALTHY
                else "one" if dice < SHARE_HEALTHY + SHARE_ONE else "two")  # fmt: skip
    if role == "healthy" and series == "cases":
        kind = str(rng.choice(list(HEALTHY), p=list(HEALTHY.values())))
        world = _world(kind, sheet, rng)
    elif role == "healthy":
        kind = "plain"
    else:
        faults = _faults(machine, 1 if role == "one" else 2, rng, series)
        kind = "+".join(sorted(fault.kind for fault in faults))
    damage = list(DAMAGES)[_round(number) % len(DAMAGES)] if series == "damaged" else ""
    name = hashlib.sha256(repr((seed, "name")).encode()).hexdigest()[:10]
    return Case(
        number=number, series=series, name=f"case-{name}", machine=machine, role=role, kind=kind,
        faults=faults, world=world, damage=damage, seed=seed,
    )  # fmt: skip


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _world(kind: str, sheet: Sheet, rng: np.random.Generator) -> World:
    """Draw what disturbs a healthy machine; the run of a press or a hand counts from 0."""
    run = int(rng.integers(6))
    if kind == "cable":
        body = int(rng.integers(len(sheet.bodies) // 2, len(sheet.bodies)))
        return World(cable=rng.uniform(2, 7), cable_body=body)
    if kind == "mount":
        axes = [int(rng.integers(3))] if rng.random() < 0.5 else [0, 1, 2]
        high = 0.9 * sheet.sensor.corner_hz
        found = [(axis, rng.uniform(100, high), rng.uniform(0.02, 0.08)) for axis in axes]
        return World(mount=tuple(found))
    if kind == "base":
        return World(base=_log_uniform(rng, 1e-4, 6e-4))
    if kind == "payload":
        at = tuple(float(x) for x in rng.uniform(-0.04, 0.04, 3))
        return World(payload=rng.uniform(*sheet.payload), payload_at=at)  # type: ignore[arg-type]
    if kind == "press":
        every = rng.uniform(0.6, 1.6)
        return World(press=_log_uniform(rng, 0.5, 4.0), press_every=every, run=run)
    if kind == "hand":
        return World(hand=rng.uniform(*sheet.strike), run=run)
    return World()


@cache
def _weights(machine: str) -> tuple[float, ...]:
    """Weight of each link with all beyond it [N]."""
    model = mujoco.MjModel.from_xml_string(nominal_xml(machine))
    bodies = SHEETS[machine].bodies
    return tuple(9.81 * float(model.body_subtreemass[model.body(b).id]) for b in bodies)


def _faults(
    machine: str, count: int, rng: np.random.Generator, series: Series
) -> tuple[Fault, ...]:
    """Draw faults at places of their own; two of a stand-in are of both kinds."""
    sheet = SHEETS[machine]
    kinds = list(rng.choice(KINDS, count, p=[0.55, 0.45]))
    if machine in standins.SHEETS and count == 2:
        kinds = list(KINDS)
    found: list[Fault] = []
    while len(found) < count:
        fault = _fault(str(kinds[len(found)]), machine, sheet, rng, series)
        if fault.name not in {other.name for other in found}:
            found.append(fault)
    return tuple(found)


def _fault(
    kind: str, machine: str, sheet: Sheet, rng: np.random.Generator, series: Series
) -> Fault:
    index = int(rng.integers(len(sheet.joints)))
    stop: dict[str, Any] = {"stop_ratio": rng.uniform(0.12, 0.35)}
    if kind == "backlash":
        stop["stop_hz"] = rng.uniform(800, 1400)
        slide = 0.1 if sheet.slides[index] else 1.0
        size = 3e-3 if series == "months" else _log_uniform(rng, 3e-4, 3e-3)
        return Fault(
            kind=kind, at=sheet.joints[index], index=index, **stop,
            clearance=size * slide + sheet.least_play,
            friction=_log_uniform(rng, 3e-4, 3e-3) * sheet.torque[index],
        )  # fmt: skip
    stop["stop_hz"] = rng.uniform(350, 900)
    way = rng.standard_normal(3)
    way /= np.linalg.norm(way)
    size = 3e-4 if series == "months" else _log_uniform(rng, 5e-5, 3e-4)
    pressed = series == "cases" and rng.random() < PRELOADED
    preload = rng.uniform(1.5, 4.0) * _weights(machine)[index] if pressed else 0.0
    return Fault(
        kind=kind, at=sheet.bodies[index], index=index, clearance=size * (2 if sheet.hobby else 1),
        direction=(float(way[0]), float(way[1]), float(way[2])),
        friction=_log_uniform(rng, *sheet.friction), preload=float(preload), **stop,
    )  # fmt: skip
