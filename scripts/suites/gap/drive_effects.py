"""Effects of drives and sensors, and effects outside the catalogue."""

from __future__ import annotations

import numpy as np

from scripts.suites.gap.arms import Figures
from scripts.suites.gap.dynamics import (
    BACK_EMF,
    DEAD,
    DELAY,
    ECCENTRIC_COSINE,
    ECCENTRIC_SINE,
    FRICTION,
    GAIN,
    GRAIN,
    HYSTERESIS,
    LAG,
    LIMIT,
    LOADED,
    LOADED_BUMP,
    LOADED_EXTERNAL,
    LOADED_SMOOTH,
    LOADED_SPEED,
    OFFSET,
    SAG,
    SMOOTH_SPEED,
    STRIBECK_SPEED,
    STROKE,
    WARM_TIME,
)
from scripts.suites.gap.effects import (
    FORWARD,
    FREE,
    INVERSE,
    RANDOM,
    Kind,
    Parameters,
    Place,
    Readings,
    actuators,
    either_sign,
    hinges,
    joints,
    log_uniform,
    moved_axes,
    nothing,
    rotation,
    scalar,
)
from scripts.suites.gap.simulate import System

LEAST_TIME = 3e-4
"""Shortest lag or delay [s]: shorter ones only say on which side of a command's step a sample
was taken."""


def _size_gain(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"gain": 1.0 + drawn["sign"] * size}


def _gain(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    system.drives[place.index, GAIN] *= p["gain"]


def _lag(system: System, readings: Readings, figures: Figures, place: Place, p: Parameters) -> None:
    system.drives[place.index, LAG] = p["time"]


def _all_or_one(figures: Figures) -> list[Place]:
    # a bus delays all drives alike: as likely as one of them
    one = actuators(figures)
    return one + [Place(name="all", index=-1)] * len(one)


def _delay(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    rows = slice(None) if place.index < 0 else place.index
    system.drives[rows, DELAY] += p["delay"]


def _offset(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    # the servo closes on the shifted reading too
    system.drives[place.index, OFFSET] += p["offset"]


def _offset_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    return 1e-5, 0.25 * figures.links[place.index].reach


def _offset_places(figures: Figures) -> list[Place]:
    # the zero of a first joint about the vertical, or of a slide, changes nothing that is measured
    up = np.array([0.0, 0.0, 1.0])
    first_upright = abs(np.array(figures.links[0].axis) @ up) > 0.99
    return [
        place
        for place in joints(figures)
        if figures.links[place.index].kind == "hinge" and not (place.index == 0 and first_upright)
    ]


def _draw_loaded(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    unit = 0.2 if figures.links[place.index].kind == "slide" else 1.0
    return {
        "static_ratio": rng.uniform(1.0, 1.6),
        "speed": log_uniform(rng, 0.03, 0.25) * unit,
        "smooth_speed": log_uniform(rng, 1e-3, 4e-3) * unit,
        "load_ratio": float(rng.choice([0.0, rng.uniform(0.2, 0.8)])),
    }


def _loaded(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    row = system.drives[place.index]
    row[LOADED], row[LOADED_BUMP] = p["share"], p["static_ratio"] - 1.0
    row[LOADED_SPEED], row[LOADED_SMOOTH] = p["speed"], p["smooth_speed"]
    row[LOADED_EXTERNAL] = p["load_ratio"] * p["share"]


def _size_limit(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"limit": figures.links[place.index].limit / size, **drawn}


def _limit(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    system.drives[place.index, LIMIT] = p["limit"]


def _draw_voltage(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    # of the velocity gain this much is back-EMF
    return {"back_emf": rng.uniform(0.3, 1.0) * figures.links[place.index].kv}


def _size_voltage(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    stall = figures.links[place.index].limit / size
    return {"stall_torque": stall, "no_load_speed": stall / drawn["back_emf"], **drawn}


def _voltage(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    row = system.drives[place.index]
    row[LIMIT], row[BACK_EMF] = p["stall_torque"], p["back_emf"]


def _dead(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    system.drives[place.index, DEAD] = p["width"]


def _dead_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    link = figures.links[place.index]
    return 1e-6 * link.limit / link.kp, 0.3 * link.limit / link.kp


def _draw_eccentric(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {"phase": rng.uniform(-np.pi, np.pi)}


def _size_eccentric(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    phase = drawn["phase"]
    return {
        "amplitude": size,
        "sine": float(size * np.cos(phase)),
        "cosine": float(size * np.sin(phase)),
    }


def _eccentric(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    row = system.drives[place.index]
    row[ECCENTRIC_SINE], row[ECCENTRIC_COSINE] = p["sine"], p["cosine"]


DRIVE_KINDS = (
    Kind(name="actuator_gain", places=actuators, draw=either_sign,
         bounds=lambda figures, place: (0.01, 0.6), size=_size_gain, apply=_gain,
         forms=(FORWARD, INVERSE)),
    Kind(name="actuator_lag", places=actuators, draw=nothing,
         bounds=lambda figures, place: (LEAST_TIME, 0.1), size=scalar("time"), apply=_lag,
         forms=(FORWARD, RANDOM)),
    Kind(name="command_delay", places=_all_or_one, draw=nothing,
         bounds=lambda figures, place: (LEAST_TIME, 0.06), size=scalar("delay"), apply=_delay,
         forms=(FORWARD, RANDOM)),
    Kind(name="encoder_offset", places=_offset_places, draw=either_sign, bounds=_offset_bounds,
         size=scalar("offset"), apply=_offset, forms=(FORWARD, INVERSE, FREE)),
    Kind(name="load_friction", places=joints, draw=_draw_loaded,
         bounds=lambda figures, place: (0.005, 0.7), size=scalar("share"), apply=_loaded,
         forms=(FORWARD, INVERSE), rivals=("coulomb_friction",)),
    Kind(name="torque_limit", places=actuators, draw=nothing,
         bounds=lambda figures, place: (1.05, 20.0), size=_size_limit, apply=_limit,
         forms=(FORWARD,)),
    Kind(name="voltage_limit", places=actuators, draw=_draw_voltage,
         bounds=lambda figures, place: (1.05, 20.0), size=_size_voltage, apply=_voltage,
         forms=(FORWARD,), rivals=("torque_limit",)),
    Kind(name="dead_zone", places=actuators, draw=nothing, bounds=_dead_bounds,
         size=scalar("width"), apply=_dead, forms=(FORWARD,)),
    Kind(name="gear_eccentricity", places=hinges, draw=_draw_eccentric,
         bounds=lambda figures, place: (1e-5, 0.03), size=_size_eccentric, apply=_eccentric,
         forms=(FORWARD,), rivals=("encoder_offset",)),
)  # fmt: skip


ACCELEROMETER = "tool_acc"
"""Name of the accelerometer at the tool."""


def _accelerometer(figures: Figures) -> list[Place]:
    return [Place(name=ACCELEROMETER, index=0)]


def _speeds(figures: Figures) -> list[Place]:
    return [Place(name=f"joint{i + 1}_vel", index=i) for i in range(figures.joints)]


def _speed_or_acceleration(figures: Figures) -> list[Place]:
    return _accelerometer(figures) * 2 + _speeds(figures)


def _any(figures: Figures) -> list[Place]:
    positions = [Place(name=f"joint{i + 1}_pos", index=i) for i in range(figures.joints)]
    return _accelerometer(figures) * 3 + _speeds(figures) + positions


def _draw_turn(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    axis = rng.normal(size=3)
    return {"direction": (axis / np.linalg.norm(axis)).tolist()}


def _size_turn(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    turn = size * np.array(drawn["direction"])
    return {"angle": size, **dict(zip("xyz", turn.tolist(), strict=True))}


def _turn(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    # the sensor is turned by (x, y, z) in the tool's frame
    readings.rotation = rotation(np.array([p["x"], p["y"], p["z"]])).T @ readings.rotation


def _reading_size_gain(
    size: float, drawn: Parameters, figures: Figures, place: Place
) -> Parameters:
    return {"gain": 1.0 + drawn["sign"] * size}


def _reading_gain(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    readings.gain[place.name] = p["gain"]


def _draw_bias(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    if place.name != ACCELEROMETER:
        return either_sign(rng, figures, place)
    return _draw_turn(rng, figures, place)


def _size_bias(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    if "sign" in drawn:
        return {"bias": drawn["sign"] * size}
    bias = size * np.array(drawn["direction"])
    return {"size": size, **dict(zip("xyz", bias.tolist(), strict=True))}


def _bias(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    value = [p["bias"]] if "bias" in p else [p["x"], p["y"], p["z"]]
    readings.bias[place.name] = np.array(value)


def _bias_bounds(figures: Figures, place: Place) -> tuple[float, float]:
    return (1e-4, 1.5) if place.name == ACCELEROMETER else (1e-6, 0.05)


def _reading_delay(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    readings.delay[place.name] = p["delay"]


def _encoders(figures: Figures) -> list[Place]:
    return [Place(name=f"joint{i + 1}_pos", index=i) for i in range(figures.joints)]


def _round(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    readings.step[place.name] = p["step"]


def _constant(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    readings.torque[place.index] = p["factor"]


def _size_constant(size: float, drawn: Parameters, figures: Figures, place: Place) -> Parameters:
    return {"factor": 1.0 + drawn["sign"] * size}


SENSOR_KINDS = (
    Kind(name="sensor_misalignment", places=_accelerometer, draw=_draw_turn,
         bounds=lambda figures, place: (1e-5, 0.35), size=_size_turn, apply=_turn,
         forms=(FORWARD, RANDOM)),
    Kind(name="sensor_gain", places=_speed_or_acceleration, draw=either_sign,
         bounds=lambda figures, place: (1e-4, 0.4), size=_reading_size_gain, apply=_reading_gain,
         forms=(FORWARD, RANDOM)),
    Kind(name="sensor_bias", places=_speed_or_acceleration, draw=_draw_bias, bounds=_bias_bounds,
         size=_size_bias, apply=_bias, forms=(FORWARD, FREE)),
    Kind(name="sensor_delay", places=_any, draw=nothing,
         bounds=lambda figures, place: (LEAST_TIME, 0.04), size=scalar("delay"),
         apply=_reading_delay, forms=(FORWARD, RANDOM)),
    Kind(name="torque_constant", places=joints, draw=either_sign,
         bounds=lambda figures, place: (0.005, 0.5), size=_size_constant, apply=_constant,
         forms=(INVERSE,)),
    Kind(name="sensor_quantisation", places=_encoders, draw=nothing,
         bounds=lambda figures, place: (1e-4, 0.05), size=scalar("step"), apply=_round,
         forms=(FORWARD,)),
)  # fmt: skip


def _torque(low: float, high: float):  # type: ignore[no-untyped-def]
    def bounds(figures: Figures, place: Place) -> tuple[float, float]:
        limit = figures.links[place.index].limit
        return low * limit, high * limit

    return bounds


def _draw_warming(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {"warm_time": log_uniform(rng, 1.5, 4.0)}


def _warming(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    law = system.laws[int(system.drives[place.index, 0])]
    law[FRICTION], law[WARM_TIME] = p["torque"], p["warm_time"]
    law[SMOOTH_SPEED], law[STRIBECK_SPEED] = 3e-3, 0.1


def _pairs(figures: Figures) -> list[Place]:
    turning = [place.index for place in hinges(figures)]
    return [Place(name=f"joint{i + 1}", index=i) for i in turning if any(j > i for j in turning)]


def _draw_cable(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    others = [p.index for p in hinges(figures) if p.index > place.index]
    return {
        "other": int(rng.choice(others)),
        "ratio": float(rng.uniform(0.6, 1.5) * rng.choice([-1.0, 1.0])),
        "slack": float(rng.uniform(-0.3, 0.3)),
    }


def _cable(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    other, ratio = p["other"], p["ratio"]
    home = figures.home
    rest = home[place.index] + ratio * home[other] + p["slack"]
    dofs = system.joint_dofs
    system.cable = np.array([dofs[place.index], dofs[other], ratio, p["stiffness"], rest])


def _tool(figures: Figures) -> list[Place]:
    return [Place(name="tool", index=figures.joints - 1)]


def _draw_fan(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    basis = moved_axes(figures)
    mix = rng.normal(size=len(basis)) @ basis
    return {
        "direction": (mix / np.linalg.norm(mix)).tolist(),
        "frequency": log_uniform(rng, 6.0, 40.0),
        "phase": rng.uniform(-np.pi, np.pi),
    }


def _fan(system: System, readings: Readings, figures: Figures, place: Place, p: Parameters) -> None:
    push = p["force"] * np.array(p["direction"])
    system.fan = np.array([*push, p["frequency"], p["phase"]])


def _draw_none(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {}


def _sag(system: System, readings: Readings, figures: Figures, place: Place, p: Parameters) -> None:
    system.drives[:, SAG] = p["sag"]


def _draw_tight(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    return {"waves": float(rng.integers(3, 9)), "phase": rng.uniform(-np.pi, np.pi)}


def _tight(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    # a bent shaft rubs in some angles and runs free in others
    law = system.laws[int(system.drives[place.index, 0])]
    law[FRICTION], law[GRAIN], law[GRAIN + 1] = p["torque"], p["waves"], p["phase"]
    law[SMOOTH_SPEED], law[STRIBECK_SPEED] = 3e-3, 0.1


def _draw_hysteresis(rng: np.random.Generator, figures: Figures, place: Place) -> Parameters:
    reach = figures.links[place.index].reach
    return {"stroke": rng.uniform(0.25, 0.6) * reach}


def _hysteresis(
    system: System, readings: Readings, figures: Figures, place: Place, p: Parameters
) -> None:
    law = system.laws[int(system.drives[place.index, 0])]
    law[HYSTERESIS], law[STROKE] = p["torque"], p["stroke"]


def _all(figures: Figures) -> list[Place]:
    return [Place(name="all", index=-1)]


OUTSIDE_KINDS = (
    Kind(name="warming_friction", places=hinges, draw=_draw_warming, bounds=_torque(1e-4, 0.2),
         size=scalar("torque"), apply=_warming, forms=(FORWARD,), group="outside",
         rivals=("coulomb_friction", "viscous_friction")),
    Kind(name="cable_coupling", places=_pairs, draw=_draw_cable, bounds=_torque(1e-4, 0.3),
         size=scalar("stiffness"), apply=_cable, forms=(FORWARD,), group="outside",
         rivals=("joint_spring",)),
    Kind(name="shaking_force", places=_tool, draw=_draw_fan, bounds=_torque(1e-5, 1.0),
         size=scalar("force"), apply=_fan, forms=(FORWARD,), group="outside"),
    Kind(name="voltage_sag", places=_all, draw=_draw_none,
         bounds=lambda figures, place: (1e-3, 2.0), size=scalar("sag"), apply=_sag,
         forms=(FORWARD,), group="outside", rivals=("actuator_gain",)),
    Kind(name="tight_spots", places=hinges, draw=_draw_tight, bounds=_torque(1e-4, 0.3),
         size=scalar("torque"), apply=_tight, forms=(FORWARD,), group="outside",
         rivals=("coulomb_friction", "asymmetric_friction")),
    Kind(name="drive_hysteresis", places=joints, draw=_draw_hysteresis,
         bounds=_torque(1e-5, 0.15), size=scalar("torque"), apply=_hysteresis, forms=(FORWARD,),
         group="outside", rivals=("coulomb_friction", "joint_spring")),
)  # fmt: skip
