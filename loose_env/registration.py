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

from loose_env.errors import InvalidSetting

__all__ = ["GAP_ID", "IDS", "TIERS", "make_arm", "make_arm_vector", "register"]

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

REWARD_THRESHOLDS = dict(zip(IDS, (0.80, 0.82, 0.65), strict=False))
"""Mean return from which an id counts as solved: what the best agents reach, rounded down
(docs/agents.md)."""

_OF_ANY = ("hold", "levels", "gravity")
_SINGLE = ("render_mode", "rig", "threads", "true_arm")
_VECTOR = ("render_mode", "threads", "true_arm", "autoreset_mode", "max_episode_steps")
_ON_LINKS = "link_accelerometers"


def register() -> None:
    """Register all ids with Gymnasium; those already there are left alone."""
    names = dict(zip(IDS, ("vera", "planar", "six_axis", "scara", "arm"), strict=True))
    every: dict[str, tuple[str, Mapping[str, Any]]] = {env_id: (env_id, {}) for env_id in IDS}
    every |= TIERS
    for env_id, (of, arguments) in every.items():
        if env_id not in gymnasium.registry:
            entry = f"loose_env.registration:make_{names[of]}"
            gymnasium.register(
                id=env_id,
                entry_point=entry,
                vector_entry_point=f"{entry}_vector",
                reward_threshold=REWARD_THRESHOLDS.get(env_id),
                kwargs=dict(arguments),
            )
    if GAP_ID not in gymnasium.registry:
        gymnasium.register(id=GAP_ID, entry_point="loose_env.envs:make_model_gap")


def _makers(arm: str, *own: str) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Entry points of an arm of the library, which has arguments of its own."""
    of_arm = (*own, *_OF_ANY)

    def maker(kind: str, *others: str) -> Callable[..., Any]:
        def make(**arguments: Any) -> Any:
            """Make the environments of the arm in the name."""
            from loose_env import envs

            nominal, how = _nominal(arm, arguments, of_arm), _take(arguments, *others)
            return getattr(envs, kind)(nominal, _settings(arguments, (*of_arm, *others)), **how)

        return make

    return maker("DiagnosisEnv", *_SINGLE), maker("DiagnosisVectorEnv", "num_envs", *_VECTOR)


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

    model, true_model = own.pop("model", None), own.pop("true_model", None)
    if true_model is not None:
        if arguments.get("true_arm") is not None:
            raise InvalidSetting("give the true arm as true_model or as true_arm, not as both")
        arguments["true_arm"] = _varied(arms.arm_from_file, {"path": true_model, **own})
    return _varied(arms.arm_from_file, {"path": arms.DESK_ARM if model is None else model, **own})


def _varied(make: Callable[..., Any], own: dict[str, Any]) -> Any:
    """Make an arm, then change its levels and the gravity that it stands in, where asked."""
    levels, gravity = own.pop("levels", None), own.pop("gravity", None)
    arm = make(**own)
    if gravity is not None:
        arm = arm.under_gravity(gravity)
    return arm if levels is None else arm.with_levels(levels)


def _take(arguments: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: arguments.pop(name) for name in names if name in arguments}


def _settings(arguments: dict[str, Any], others: tuple[str, ...]) -> Any:
    from loose_env.envs import DiagnosisSettings, Difficulty, Prices, refuse_unknown
    from loose_env.io import restored
    from loose_env.sensors import SensorSuite

    own = (f.name for f in fields(DiagnosisSettings))
    refuse_unknown("arguments", arguments, (*others, _ON_LINKS, *own))
    for name, kind in (("prices", Prices), ("difficulty", Difficulty)):
        if isinstance(given := arguments.get(name), Mapping):
            refuse_unknown(name, given, [f.name for f in fields(kind)])
            arguments[name] = restored(kind, dict(given), name)
    links, sensors = arguments.pop(_ON_LINKS, None), arguments.get("sensors", SensorSuite())
    # One of the sensors' settings: given as JSON, these cannot be.
    if links is not None and isinstance(sensors, SensorSuite):
        arguments["sensors"] = replace(sensors, link_accelerometers=links)
    return DiagnosisSettings(**arguments)
