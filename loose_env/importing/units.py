"""Units of a mapping, dates, and the quantity of each column of a recording."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.recording import nearest
from loose_env.sensors import STANDARD_GRAVITY


@dataclass(frozen=True, kw_only=True)
class Unit:
    """A unit: its quantity, and its factor to SI units."""

    quantity: str
    factor: float


_DEG, _TURN, _INCH = math.pi / 180, 2 * math.pi, 0.0254
_TABLE = {
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": _DEG, "°": _DEG, "arcmin": _DEG / 60, "rev": _TURN},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "in": _INCH},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "speed": {"m/s": 1.0, "m/min": 1 / 60, "mm/min": 1e-3 / 60, "cm/s": 1e-2, "mm/s": 1e-3,
              "in/s": _INCH},
    "angular speed": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEG, "°/s": _DEG, "dps": _DEG,
                      "rpm": _TURN / 60, "rev/s": _TURN},
    "acceleration": {"m/s^2": 1.0, "cm/s^2": 1e-2, "mm/s^2": 1e-3, "g": STANDARD_GRAVITY,
                     "mg": 1e-3 * STANDARD_GRAVITY, "in/s^2": _INCH},
    "angular acceleration": {"rad/s^2": 1.0, "deg/s^2": _DEG},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": 4.4482216152605, "kip": 4448.2216152605},
    "torque": {"N*m": 1.0, "mN*m": 1e-3, "kN*m": 1e3, "N*cm": 1e-2, "N*mm": 1e-3,
               "lbf*in": 0.1129848290276167, "lbf*ft": 1.3558179483314004},
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6},
    "current": {"A": 1.0, "mA": 1e-3},
    "number": {"1": 1.0, "%": 1e-2},
}  # fmt: skip
"""Quantity -> units, with their factors to SI units."""
UNITS = {
    name: Unit(quantity=quantity, factor=factor)
    for quantity, units in _TABLE.items()
    for name, factor in units.items()
}
"""Name -> unit. Also read are ``m/s2`` and ``m/s²``, and ``Nm``, ``N·m`` and ``N.m``."""

_SAME = {
    given: name
    for name, all_given in {
        "N*m": "Nm", "mN*m": "mNm", "kN*m": "kNm", "N*cm": "Ncm", "N*mm": "Nmm", "um": "μm",
        "us": "μs", "deg": "degree degrees", "s": "sec", "g": "g's gn", "rad": "radians",
        "V": "volt", "deg/s": "degps degs", "rad/s": "rads radps", "rev": "turn turns",
        "rpm": "RPM 1/min min-1 U/min r/min", "m/s^2": "mps2", "%": "percent pct",
    }.items()
    for given in all_given.split()
}  # fmt: skip
_QUANTITIES = {
    f"mjSENS_{kind}": quantities.split(", ")
    for kinds, quantities in {
        "ACCELEROMETER FRAMELINACC": "acceleration", "FRAMEANGACC": "angular acceleration",
        "VELOCIMETER FRAMELINVEL SUBTREELINVEL": "speed", "GYRO FRAMEANGVEL": "angular speed",
        "FORCE TOUCH": "force", "TORQUE": "torque", "FRAMEPOS RANGEFINDER": "length",
        "FRAMEXAXIS FRAMEYAXIS FRAMEZAXIS": "number", "JOINTPOS": "angle, length",
        "JOINTVEL": "angular speed, speed", "JOINTACTFRC JOINTLIMITFRC": "torque, force",
    }.items()
    for kind in kinds.split()
}  # fmt: skip
"""Kind of sensor -> its quantity; of a joint that turns, and of one that slides."""


def unit_named(name: str, place: str) -> Unit:
    """Find a unit by its name; nothing is evaluated, a table is looked up.

    Examples
    --------
    >>> unit_named("rpm", "here").quantity
    'angular speed'
    >>> unit_named("m/s²", "here") == unit_named("m/s2", "here") == UNITS["m/s^2"]
    True
    """
    found = UNITS.get(_plain(name))
    if found is None:
        raise InvalidData(
            f"{place}: unknown unit {name[:40]!r}; known are {known_units()}"
            f"{nearest(name[:40], list(UNITS))}"
        )
    return found


def quantity_of(unit: str) -> str:
    """Quantity of a unit; "" for none, or for one that is not known.

    Examples
    --------
    >>> quantity_of("mm"), quantity_of("g"), quantity_of("counts")
    ('length', 'acceleration', '')
    """
    try:
        return unit_named(unit, "").quantity if unit else ""
    except InvalidData:
        return ""


def nearest_unit(size: float, units: Iterable[str]) -> tuple[str, float]:
    """Unit whose values are so many times those in SI units, and the logarithm it is off by.

    Examples
    --------
    >>> nearest_unit(55.0, ("rad/s", "deg/s"))[0]
    'deg/s'
    """
    away = {unit: abs(math.log(max(abs(size), 1e-9) * UNITS[unit].factor)) for unit in units}
    best = min(away, key=lambda unit: away[unit])
    return best, away[best]


def known_units() -> str:
    """List of all units by quantity."""
    return "; ".join(f"{quantity}: {' '.join(units)}" for quantity, units in _TABLE.items())


def column_quantity(model: mujoco.MjModel, column: str) -> str | None:
    """Quantity of a column of a recording; None where the model does not determine it."""
    group, _, name = column.partition(".")
    if group == "torque":
        quantities, joint = ["torque", "force"], int(model.joint(name).id)
    elif group == "sensor":
        names = {model.sensor(i).name: i for i in range(model.nsensor)}
        index = names.get(name, names.get(name[:-2]))
        kind = "" if index is None else mujoco.mjtSensor(int(model.sensor_type[index])).name
        quantities = _QUANTITIES.get(kind, [])
        joint = -1 if index is None else int(model.sensor_objid[index])
    else:
        return None  # an actuator's input is in the unit that its gain takes
    if len(quantities) < 2:
        return next(iter(quantities), None)
    return quantities[int(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE)]


def _plain(name: str) -> str:
    plain = "".join(name.split()).strip("[]()")
    for given, taken in (("²", "^2"), ("**2", "^2"), ("s2", "s^2"), ("·", "*"), ("⋅", "*"),
                         ("N.m", "N*m"), ("N-m", "N*m")):  # fmt: skip
        plain = plain.replace(given, taken)
    return _SAME.get(plain, plain)


_MARKED = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")
_TAILED = re.compile(r"_([a-zA-Z/0-9^]+)$")


def unit_in(name: str) -> str:
    """Unit that the name of a column ends with, such as "[deg]" or "_ms"; "" for none.

    Examples
    --------
    >>> unit_in("gyro_x_dps"), unit_in("Winkel [deg]"), unit_in("data_g")
    ('dps', 'deg', '')
    """
    for pattern in (_MARKED, _TAILED):
        found = pattern.search(name)
        if found is None or _plain(found.group(1)) not in UNITS or found.group(1).isdigit():
            continue
        # One letter after an underscore is more often an axis or a number than a unit.
        if pattern is _MARKED or len(found.group(1)) > 1:
            return found.group(1)
    return ""


NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|[+-]?inf", re.IGNORECASE | re.ASCII)
_DATE = re.compile(
    r"(?:(\d{1,4})([./-])(\d{1,2})\2(\d{1,4})[T ,]\s*)?(\d{1,2}):(\d{2})(?::(\d{2})"
    r"(?:[.,](\d{1,9})\d*)?)?\s*([AaPp])?[Mm]?\s*(?:Z|([+-])(\d{2}):?(\d{2}))?",
    re.ASCII,
)


def dates_ns(cells: Sequence[str]) -> NDArray[np.int64] | None:
    """Dates, or times of day, in nanoseconds since 1970; None where a cell is none.

    The order of day and month is the one in which all cells are dates and the log is shortest; of
    equals the day stands first. Without a zone they are in UTC.

    Examples
    --------
    >>> dates_ns(["1970-01-01T00:00:01.000000250Z", "1970-01-02T00:00:00+01:00"]).tolist()
    [1000000250, 82800000000000]
    """
    found = [_DATE.fullmatch(cell.strip()) for cell in cells]
    if not found or any(each is None for each in found):
        return None
    groups = [each.groups() for each in found if each is not None]
    clock = []
    for *_, hour, minute, second, fine, half, sign, hours, minutes in groups:
        whole = int(hour) % 12 + 12 * (half in "Pp") if half else int(hour)
        zone = int(f"{sign}1") * (int(hours) * 60 + int(minutes)) if sign else 0
        seconds = whole * 3600 + (int(minute) - zone) * 60 + int(second or 0)
        clock.append(seconds * 10**9 + int((fine or "0").ljust(9, "0")))
    best: NDArray[np.int64] | None = None
    for year, month, day in ((0, 2, 3), (3, 2, 0), (3, 0, 2)):
        try:
            days = {
                own[:4]: _day(own[year], own[month], own[day], first=year == 0) for own in groups
            }
        except ValueError:
            continue
        own_ns = np.array(clock) + np.array([days[own[:4]] for own in groups])
        if best is None or np.ptp(own_ns) < np.ptp(best):
            best = own_ns
    return best


def _day(year: str | None, month: str | None, day: str | None, *, first: bool) -> int:
    if year is None or month is None or day is None:
        return 0
    if len(year) not in ((4,) if first else (2, 4)) or len(day) > 2:
        raise ValueError("no date")
    whole = f"{'20' * (len(year) == 2)}{year}-{int(month):02d}-{int(day):02d}"
    return int(np.datetime64(whole, "ns").astype(np.int64))
