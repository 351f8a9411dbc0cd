"""Advice in words on motions and sensors that make an effect visible, or tell two apart."""

from __future__ import annotations

_SPRING = (
    "Hold the joint at many angles in two poses of the other joints: a spring goes by its own "
    "angle, gravity by that of the "
)
_PAIRS = {
    "command_delay joint_compliance": (
        "Tap the arm while it is held: a compliance rings at its own frequency, a delay does not. "
        "A sensor on the link behind the joint separates them too."
    ),
    "payload link_mass": (
        "Move the last joint by itself, with its axis level: the load at the tool has the longer "
        "lever. Or record once with a known weight at the tool."
    ),
    "actuator_gain payload": (
        "Hold several poses and move fast in one pose: a gain scales every torque, a payload adds "
        "gravity and inertia."
    ),
    "backlash coulomb_friction": (
        "Reverse slowly with gravity pulling to one side, then where it pulls to neither: a gap "
        "shows only where the load changes sides, friction always."
    ),
    "base_tilt sensor_bias": (
        "Hold several poses that turn the sensor: a bias stays with the sensor, gravity from "
        "elsewhere turns with the base."
    ),
    "joint_spring link_mass": _SPRING + "link.",
    "joint_spring link_com": _SPRING + "link.",
    "joint_spring payload": _SPRING + "tool.",
    "base_tilt joint_spring": (
        "Hold the joint at many angles with the others folded and stretched: gravity's share "
        "changes, a spring's does not."
    ),
    "actuator_gain viscous_friction": (
        "Move at several constant speeds and hold several loads at rest: friction vanishes at "
        "rest, a gain does not."
    ),
    "base_tilt encoder_offset": (
        "With the first joint's axis level these are the same for every motion; a spirit level on "
        "the base decides."
    ),
    "command_delay sensor_delay": (
        "Command a motion that two sensors of different kinds see: a late command moves both, a "
        "late sensor only itself."
    ),
    "joint_compliance link_flexibility": (
        "Put an accelerometer on the link between the joint and the tool: a compliant joint moves "
        "it, a flexible link moves only what lies beyond."
    ),
    "actuator_lag command_delay": (
        "Command a sweep to well above 1 / (2π time constant): behind a lag the motion fades, "
        "behind a delay it keeps its size."
    ),
    "coulomb_friction stribeck_friction": (
        "Move at a few speeds down to creeping: Coulomb friction is the same at all, Stribeck's "
        "grows towards rest."
    ),
    "coulomb_friction viscous_friction": (
        "Move at several constant speeds: Coulomb friction is the same at all, viscous friction "
        "grows with the speed."
    ),
    "quadratic_drag viscous_friction": (
        "Move at several constant speeds, the highest included: drag grows with the square."
    ),
    "link_com link_mass": (
        "Hold the link level and upright, and move it fast: the mass alone changes what the "
        "joints before it carry."
    ),
    "link_mass rotor_inertia": (
        "Accelerate the joint alike in poses of different reach and hold several: a rotor's "
        "inertia never changes and has no weight."
    ),
    "backlash joint_compliance": (
        "Reverse slowly under small and under large load: a gap has the same size at both, a "
        "compliance yields in proportion."
    ),
    "load_friction coulomb_friction": (
        "Reverse slowly under several loads: one share grows with the load, dry friction does not."
    ),
    "asymmetric_friction joint_spring": (
        "Move slowly both ways at many angles: a friction has its sign from the direction, a "
        "spring from the angle."
    ),
    "gravity_compensation link_mass": (
        "Hold poses, then accelerate hard where the link is upright: a carried weight leaves the "
        "inertia as it is."
    ),
    "torque_limit voltage_limit": (
        "Stall the drive, then move at its highest speed: a limit of the torque is the same at "
        "both."
    ),
    "torque_constant actuator_gain": (
        "Hold a known load and read the torque: a wrong constant shows another one."
    ),
    "structural_looseness backlash": (
        "Shake one joint at a time with an accelerometer at the tool: a loose link moves along a "
        "direction of its own, a joint about its axis."
    ),
}
"""Two kinds, in either order -> what tells them apart."""

_GRAVITY = "hold many poses, the level ones and the stretched ones among them"
_SEE = {
    "viscous_friction": "move at several constant speeds, the highest included",
    "coulomb_friction": "reverse the joint slowly, many times",
    "stribeck_friction": "reverse the joint slowly, and creep at a few low speeds",
    "quadratic_drag": "move at the highest speed",
    "joint_compliance": "accelerate hard and stop, or shake the joint up to well above 10 Hz",
    "backlash": "reverse slowly under a small load that changes sides",
    "structural_looseness": "shake one joint at a time, hard, with an accelerometer at the tool",
    "link_flexibility": "accelerate hard and stop, with an accelerometer at the tool",
    "link_mass": _GRAVITY,
    "link_com": _GRAVITY,
    "payload": _GRAVITY,
    "rotor_inertia": "accelerate and brake hard, to and fro",
    "actuator_gain": "hold known loads at rest, and accelerate hard",
    "actuator_lag": "command sweeps to well above 1 / (2π time constant)",
    "command_delay": "command fast sweeps or steps",
    "sensor_delay": "move fast, and read densely",
    "encoder_offset": _GRAVITY,
    "sensor_misalignment": "turn the sensor into many directions, and shake it in each",
    "sensor_gain": "let the sensor read over its whole range",
    "sensor_bias": "hold several poses at rest that turn the sensor",
    "base_tilt": _GRAVITY,
    "torque_ripple": "turn slowly at a constant speed over a whole turn or as far as it goes",
    "joint_spring": "hold the joint at many angles over its whole range",
    "load_friction": "reverse slowly under several loads, a large one among them",
    "asymmetric_friction": "move slowly at a constant speed in either direction, many times",
    "torque_limit": "accelerate as hard as the drive allows, with the largest load",
    "voltage_limit": "move at the highest speed the drive reaches, and stall it",
    "dead_zone": "command tiny steps about several poses, under small loads",
    "gravity_compensation": _GRAVITY,
    "torque_constant": "hold known loads at rest",
    "base_compliance": "accelerate the first joints hard and stop; read accelerations at the tool",
    "gear_eccentricity": "turn slowly over a whole turn or as far as it goes",
    "sensor_quantisation": "move slowly over many of the sensor's steps",
}
_OF_KIND = {
    "sensor": "Let a second sensor see the same motion.",
    "actuator": "Hold known loads at rest, and move at several speeds and accelerations.",
    "joint": "Move the joint alone, slowly and fast, both ways, over its whole range.",
}


def how_to_separate(kind: str, where: str, other: str, elsewhere: str) -> str:
    """Name a motion or a measurement that tells two effects apart.

    Examples
    --------
    >>> how_to_separate("payload", "tool", "link_mass", "link3").split(":")[0]
    'Move the last joint by itself, with its axis level'
    >>> how_to_separate("viscous_friction", "joint1", "viscous_friction", "joint2")
    'Move joint1 while joint2 is held, and the other way round.'
    >>> how_to_separate("command_delay", "motor1", "command_delay", "all")
    'Command the drives one at a time.'
    """
    known = _PAIRS.get(f"{kind} {other}") or _PAIRS.get(f"{other} {kind}")
    if known:
        return known
    if kind == other and "all" in (where, elsewhere):
        return "Command the drives one at a time."
    if where != elsewhere and kind == other:
        return f"Move {where} while {elsewhere} is held, and the other way round."
    for each in (kind, other):
        for family in ("sensor", "actuator"):
            if each.startswith(family):
                return _OF_KIND[family]
    return _OF_KIND["joint"]


def how_to_see(kind: str) -> str:
    """Name a motion that shows an effect.

    Examples
    --------
    >>> how_to_see("coulomb_friction")
    'reverse the joint slowly, many times'
    >>> how_to_see("own_effect")
    'move the joint alone, slowly and fast, both ways, over its whole range'
    """
    general = _OF_KIND["joint"].rstrip(".")
    return _SEE.get(kind, general[0].lower() + general[1:])
