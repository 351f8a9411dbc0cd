"""Registration of environment ids with Gymnasium; arms and settings from their arguments.

The simulator is imported when an environment is made: `import loose_env` stays light.

Every id takes ``hold``: "brake", "servo" or "compliant"; see `loose_env.arms.holding`;
``levels``, the excitation levels, ``gravity``, a vector in the world's axes [m/s²], and
``link_accelerometers``, short for sensors that have them. ``prices`` and ``difficulty`` may be
mappings of their fields.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any

import gymnasium

from loose_env.errors import InvalidSetting, UnknownName

__all__ = [
    "GAP_ID",
    "IDS",
    "TIERS",
    "make_arm",
    "make_arm_vector",
    "make_planar",
    "make_planar_vector",
    "make_scara",
    "make_scara_vector",
    "make_six_axis",
    "make_six_axis_vector",
    "make_vera",
    "make_vera_vector",
    "register",
]

IDS = (
    "loose_env/Vera-v0",
    "loose_env/Planar-v0",
    "loose_env/SixAxis-v1",
    "loose_env/Scara-v1",
    "loose_env/Arm-v1",
)
"""Ids by arm."""

_ONE_EXCITER = {"max_excited": 1, "durations": (0.2,)}
TIERS: Mapping[str, tuple[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "loose_env/ControlTier-v0": ("loose_env/Vera-v0", {}),
        "loose_env/StoppingTier-v0": (
            "loose_env/Planar-v0",
            {"difficulty": "hard", **_ONE_EXCITER},
        ),
        "loose_env/GravityTier-v1": (
            "loose_env/SixAxis-v1",
            {"gravity": (9.81, 0.0, 0.0), "levels": (1.0, 2.0), **_ONE_EXCITER},
        ),
        "loose_env/WeakDriveTier-v1": (
            "loose_env/SixAxis-v1",
            {"levels": (1.0, 2.0), **_ONE_EXCITER},
        ),
        "loose_env/SearchTier-v0": (
            "loose_env/Planar-v0",
            {
                "n_links": 7,
                "vertical": True,
                "difficulty": {"kinds": {"healthy": 0.125, "structural_looseness": 0.875}},
                "kinds": ("healthy", "structural_looseness"),
                "prices": {"record": 0.15},
                "max_moved": 1,
                **_ONE_EXCITER,
            },
        ),
    }
)
"""Ids of the tiers: the arm's id and its arguments, which others given to `make` replace."""

GAP_ID = "loose_env/Gap-v0"
"""Id of the environment that chooses motions to find what a model lacks. Its vector form is
Gymnasium's synchronous one: environments of a process share the arm's signatures."""

REWARD_THRESHOLDS = (0.80, 0.82, 0.65, None, None)
"""Mean return from which an id counts as solved: what the best agents reach, rounded down
(docs/agents.md); None where no agent is published."""

_OF_ANY = ("hold", "levels", "gravity")
_SINGLE = ("render_mode", "rig", "threads", "true_arm")
_VECTOR = ("render_mode", "threads", "true_arm", "autoreset_mode", "max_episode_steps")
_ON_LINKS = "link_accelerometers"


def register() -> None:
    """Register all ids with Gymnasium; those already there are left alone."""
    here = "loose_env.registration"
    names = ("vera", "planar", "six_axis", "scara", "arm")
    by_arm = dict(zip(IDS, zip(names, REWARD_THRESHOLDS, strict=True), strict=True))
    every: dict[str, tuple[str, float | None, dict[str, Any]]] = {
        env_id: (*by_arm[env_id], {}) for env_id in IDS
    }
    every |= {tier: (by_arm[of][0], None, dict(how)) for tier, (of, how) in TIERS.items()}
    for env_id, (name, threshold, arguments) in every.items():
        if env_id not in gymnasium.registry:
            gymnasium.register(
                id=env_id,
                entry_point=f"{here}:make_{name}",
                vector_entry_point=f"{here}:make_{name}_vector",
                reward_threshold=threshold,
                kwargs=arguments,
            )
    if GAP_ID not in gymnasium.registry:
        gymnasium.register(id=GAP_ID, entry_point="loose_env.envs:make_model_gap")


def _makers(arm: str, *own: str) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Entry points of an arm of the library, which has arguments of its own."""
    of_arm = (*own, *_OF_ANY)

    def make(**arguments: Any) -> gymnasium.Env[Any, Any]:
        """Make the environment of the arm in the name."""
        return _single(_nominal(arm, arguments, of_arm), arguments, of_arm)

    def make_vector(num_envs: int = 1, **arguments: Any) -> Any:
        """Make the vector environment of the arm in the name."""
        return _vector(_nominal(arm, arguments, of_arm), num_envs, arguments, of_arm)

    return make, make_vector


make_vera, make_vera_vector = _makers("vera")
make_planar, make_planar_vector = _makers("planar", "n_links", "vertical")
make_six_axis, make_six_axis_vector = _makers("six_axis")
make_scara, make_scara_vector = _makers("scara")
make_arm, make_arm_vector = _makers("arm", "model", "true_model", "tool", "tool_offset", "joints")


def _nominal(arm: str, arguments: dict[str, Any], of_arm: tuple[str, ...]) -> Any:
    """Take the arguments of an arm, and make it."""
    from loose_env import arms

    own = _take(arguments, *of_arm)
    if arm != "arm":
        return _varied(getattr(arms, arm), own)

    def made(*, path: Any, **how: Any) -> Any:
        return arms.arm_from_file(path, **how)

    model, true_model = own.pop("model", None), own.pop("true_model", None)
    if true_model is not None:
        if arguments.get("true_arm") is not None:
            raise InvalidSetting("give the true arm as true_model or as true_arm, not as both")
        arguments["true_arm"] = _varied(made, {"path": true_model, **own})
    return _varied(made, {"path": arms.DESK_ARM if model is None else model, **own})


def _varied(make: Callable[..., Any], own: dict[str, Any]) -> Any:
    """Make an arm, then change its levels and the gravity that it stands in, where asked."""
    levels, gravity = own.pop("levels", None), own.pop("gravity", None)
    arm = make(**own)
    if gravity is not None:
        arm = arm.under_gravity(gravity)
    return arm if levels is None else arm.with_levels(levels)


def _take(arguments: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: arguments.pop(name) for name in names if name in arguments}


def _single(
    arm: Any, arguments: dict[str, Any], of_arm: tuple[str, ...]
) -> gymnasium.Env[Any, Any]:
    from loose_env.envs import DiagnosisEnv

    own = _take(arguments, *_SINGLE)
    return DiagnosisEnv(arm, _settings(arguments, (*of_arm, *_SINGLE)), **own)


def _vector(arm: Any, num_envs: int, arguments: dict[str, Any], of_arm: tuple[str, ...]) -> Any:
    from loose_env.envs import DiagnosisVectorEnv

    own = _take(arguments, *_VECTOR)
    settings = _settings(arguments, (*of_arm, *_VECTOR))
    return DiagnosisVectorEnv(arm, settings, num_envs=num_envs, **own)


def _settings(arguments: dict[str, Any], others: tuple[str, ...]) -> Any:
    from loose_env.envs import DiagnosisSettings, Difficulty, Prices
    from loose_env.io import restored
    from loose_env.sensors import SensorSuite

    def check(what: str, given: Mapping[str, Any], kind: Any, *others: str) -> None:
        known = [*others, *(f.name for f in fields(kind))]
        if unknown := sorted(set(given) - set(known)):
            raise UnknownName(f"unknown {what} {unknown}; known are {known}")

    check("arguments", arguments, DiagnosisSettings, *others, _ON_LINKS)
    for name, kind in (("prices", Prices), ("difficulty", Difficulty)):
        if isinstance(given := arguments.get(name), Mapping):
            check(name, given, kind)
            arguments[name] = restored(kind, dict(given), name)
    links, sensors = arguments.pop(_ON_LINKS, None), arguments.get("sensors", SensorSuite())
    # One of the sensors' settings: given as JSON, these cannot be.
    if links is not None and isinstance(sensors, SensorSuite):
        arguments["sensors"] = replace(sensors, link_accelerometers=links)
    return DiagnosisSettings(**arguments)
