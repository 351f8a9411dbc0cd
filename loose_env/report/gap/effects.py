"""Effects in words: their names, what they may be mistaken for, what is lost without them."""

from __future__ import annotations

from loose_env.gap import GapResult, NamedEffect

__all__ = [
    "RIVALS",
    "deletion_words",
    "doubtful_words",
    "effect_words",
    "kind_words",
    "rivals_words",
]

_PLAIN = {
    "viscous_friction": "viscous friction",
    "coulomb_friction": "dry friction",
    "stribeck_friction": "dry friction that grows near rest",
    "quadratic_drag": "drag that grows with the square of the speed",
    "joint_compliance": "a compliant drive",
    "backlash": "backlash",
    "structural_looseness": "a loose link",
    "link_flexibility": "a flexible link",
    "link_mass": "another mass",
    "link_com": "another centre of mass",
    "payload": "a payload",
    "rotor_inertia": "more rotor inertia",
    "actuator_gain": "another gain",
    "actuator_lag": "a lag",
    "command_delay": "late commands",
    "encoder_offset": "an encoder whose zero is off",
    "sensor_misalignment": "a sensor that is mounted askew",
    "sensor_gain": "a sensor whose scale is off",
    "sensor_bias": "a sensor with a bias",
    "sensor_delay": "a late sensor",
    "base_tilt": "a tilted base",
    "torque_ripple": "torque ripple",
    "joint_spring": "a spring",
    "load_friction": "friction that grows with the load",
    "asymmetric_friction": "dry friction that differs by direction",
    "torque_limit": "a limit of the torque",
    "voltage_limit": "a limit of the voltage",
    "dead_zone": "a dead zone",
    "gravity_compensation": "a weight that is carried",
    "torque_constant": "another torque constant",
    "base_compliance": "a base that gives way",
    "gear_eccentricity": "an eccentric gear",
    "sensor_quantisation": "a coarse sensor",
}
RIVALS = 5
"""Confusable effects that are named."""
_PLACES = {
    ("payload", "tool"): "at the tool",
    ("base_tilt", "base"): "",
    ("command_delay", "all"): "at all actuators",
    ("base_compliance", "base"): "",
    ("gravity_compensation", "all"): "of all links",
}
"""Places that are no names of the model; a joint or a link may be called so, too."""


def kind_words(kind: str) -> str:
    """A kind of effect, as one says it."""
    return _PLAIN.get(kind, kind.replace("_", " "))


def effect_words(kind: str, where: str) -> str:
    """An effect and its place, as one says it.

    Examples
    --------
    >>> effect_words("coulomb_friction", "joint2")
    'dry friction (joint2)'
    """
    words = kind_words(kind)
    place = _PLACES.get((kind, where))
    return f"{words} ({where})" if place is None else f"{words} {place}".rstrip()


def rivals_words(effect: NamedEffect) -> list[str]:
    """Confusable effects of one, the first ones by name and the others by their number.

    Examples
    --------
    >>> from loose_env.gap import EffectLocation
    >>> others = tuple(EffectLocation(kind="link_mass", where=f"link{k}") for k in range(9))
    >>> one = NamedEffect(kind="payload", where="tool", parameters={}, ambiguous_with=others)
    >>> rivals_words(one)[-2:]
    ['another mass (link4)', '4 others, listed in result.json']
    """
    named = [effect_words(o.kind, o.where) for o in effect.ambiguous_with]
    more = len(named) - RIVALS
    if more < 2:
        return named
    return [*named[:RIVALS], f"{more} others, listed in result.json"]


def deletion_words(effect: NamedEffect) -> str:
    """Probability of an effect and what is lost without it; "" where neither is known.

    Examples
    --------
    >>> from loose_env.gap import DeletionTest
    >>> test = DeletionTest(
    ...     held_out_z=5.4,
    ...     training_z=9.0,
    ...     share_of_error=0.7,
    ...     share_without=0.98,
    ...     share_in_channel=0.99,
    ... )
    >>> deletion_words(NamedEffect(kind="payload", where="tool", parameters={}, deletion=test))
    'explains 98 % of what is left without it (z 5.4 on held-out runs, 9.0 on fitted ones)'
    >>> by_impacts = NamedEffect(kind="backlash", where="joint2", parameters={}, probability=0.93)
    >>> deletion_words(by_impacts)
    'probability 0.93'
    """
    found = [] if effect.probability is None else [f"probability {effect.probability:.2f}"]
    test = effect.deletion
    if test is not None:
        share = 100 * max(0.0, test.share_without)
        words = f"explains {share:.0f} % of what is left without it"
        if test.share_in_channel > test.share_without + 0.05:
            words += f", {100 * test.share_in_channel:.0f} % in one channel"
        runs = f"z {test.held_out_z:.1f} on held-out runs, {test.training_z:.1f} on fitted ones"
        found.append(f"{words} ({runs})")
    return "; ".join(found)


def doubtful_words(result: GapResult) -> list[str]:
    """Effects that reduce the error and were not identified, one sentence each."""
    return [
        f"{effect_words(effect.kind, effect.where)}: {deletion_words(effect)}; too little to tell "
        "it from a stand-in for something else"
        for effect in result.doubtful
    ]
