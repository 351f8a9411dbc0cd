"""Decision variables of `mujoco.sysid` on an arm, and the effects that their values stand for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import mujoco
import numpy as np

from loose_env.gap import NamedEffect
from loose_env.typing import Array
from scripts.suites.gap.rivals.joint_data import JointRun

__all__ = ["PRIOR", "Prepared", "SysidSettings", "Value", "named", "package", "parameters_of"]


@dataclass(frozen=True, kw_only=True)
class SysidSettings:
    """Settings of the windows, bounds and the optimiser."""

    windows: int = 3
    """Windows of each run."""
    window_s: float = 0.4
    """Length of a window [s]: several time constants of a servo."""
    torque_window_s: float = 0.15
    """The same where torques drive the model [s]: nothing calls it back, and errors grow."""
    stride: int = 5
    """Samples from one residual to the next."""
    off_bound: float = 0.02
    """Share of its range by which a parameter on a bound starts off it."""
    difference: float = 1e-5
    """Step of finite differences, in the parameters' units: the solver of dry friction stops at
    1e-8, which a smaller step would see."""
    iterations: int = 6
    """Iterations of the optimiser."""
    scale_bounds: tuple[float, float] = (0.2, 4.0)
    """Bounds of masses, armatures and gains over their nominal values."""
    centre_bound_m: float = 0.15
    """Bound of a centre of mass about its nominal place [m]."""
    torque_share: float = 0.2
    """Bound of dry friction, and of damping at one unit of speed, over the largest torque used."""
    confidence: float = 0.95
    """Of the intervals."""
    seed: int = 0
    """Seed of the noise replica by which the noise of the residual is measured."""


@dataclass(frozen=True, kw_only=True)
class Value:
    """One decision variable, the effect that it stands for and how it is judged."""

    kind: str
    where: str
    names: tuple[str, ...]
    offset: Array
    """What is taken off the fitted value to have the parameter of the effect."""
    allowed: Array
    """Departure from the nominal value that the tolerance allows."""


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """What the package works on."""

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    runs: tuple[JointRun, ...]
    inputs: tuple[Array, ...]
    """Controls of each run, of shape (T, m)."""
    noise: Array
    """Noise of positions, then of velocities, of shape (2 n,)."""
    measured: bool
    """Whether the inputs are measured torques."""
    servo: bool
    """Whether the inputs are commands."""


def package() -> Any:
    """The package, which ships types of its own that are no part of MuJoCo's."""
    return import_module("mujoco.sysid")


def parameters_of(ready: Prepared, tolerance: float, settings: SysidSettings) -> tuple[Any, Any]:
    """Decision variables and what each stands for, in the same order."""
    sysid = package()
    found, values = sysid.ParameterDict(), []
    model, (low, high) = ready.model, settings.scale_bounds

    def add(
        name: str,
        nominal: float,
        bounds: tuple[float, float],
        write: Callable[[mujoco.MjSpec, float], None],
        value: Value | None,
    ) -> None:
        def modifier(spec: mujoco.MjSpec, own: Any) -> None:
            write(spec, float(own.value[0]))

        found.add(sysid.Parameter(name, nominal, *bounds, modifier=modifier))
        values.append(value)

    largest = np.max([np.abs(run.torque).max(axis=0) for run in ready.runs], axis=0)
    weight = np.abs(model.body_mass.sum() * 9.81 * 0.1)
    for j in range(model.njnt):
        name, dof = model.joint(j).name, int(model.jnt_dofadr[j])
        damping, armature = float(model.dof_damping[dof]), float(model.dof_armature[dof])
        most = settings.torque_share * max(float(largest[dof]), 0.1 * weight)

        def damp(spec: mujoco.MjSpec, value: float, name: str = name) -> None:
            spec.joint(name).damping = value

        def rub(spec: mujoco.MjSpec, value: float, name: str = name) -> None:
            spec.joint(name).frictionloss = value

        def load(spec: mujoco.MjSpec, value: float, name: str = name) -> None:
            spec.joint(name).armature = value

        add(
            f"{name}_damping", damping, (0.0, damping + most), _array(damp),
            _scalar("viscous_friction", name, "damping", damping, tolerance * damping),
        )  # fmt: skip
        add(
            f"{name}_frictionloss", 0.0, (0.0, most), rub,
            _scalar("coulomb_friction", name, "torque", 0.0, 0.0),
        )  # fmt: skip
        add(
            f"{name}_armature", armature, (low * armature, high * armature + 1e-6), load,
            _scalar("rotor_inertia", name, "inertia", armature, tolerance * armature),
        )  # fmt: skip
    if ready.measured or ready.model.actuator_biasprm.any():
        _add_gains(add, ready, tolerance, settings)
    for b in range(1, model.nbody):
        if model.body_mass[b] <= 0 or not model.body_dofnum[b]:
            continue
        own = sysid.body_inertia_param(
            ready.spec, model, model.body(b).name,
            inertia_type=sysid.InertiaType.MassIpos,
            scale_rot_inertia=True,
            mass_bound_mult=np.array([low, high]),
            ipos_bound_off=np.array([-settings.centre_bound_m, settings.centre_bound_m]),
        )  # fmt: skip
        found.add(own)
        values.append(
            Value(
                kind="link", where=model.body(b).name, names=("mass", "x", "y", "z"),
                offset=own.nominal.copy(),
                allowed=np.array([tolerance * float(own.nominal[0]), 0.0, 0.0, 0.0]),
            )
        )  # fmt: skip
    return found, values


def _array(
    write: Callable[[mujoco.MjSpec, float], None],
) -> Callable[[mujoco.MjSpec, float], None]:
    """Writer of a number, or of the polynomial that newer versions have in its place."""

    def either(spec: mujoco.MjSpec, value: float) -> None:
        try:
            write(spec, value)
        except TypeError:
            write(spec, np.array([value, 0.0, 0.0]))  # type: ignore[arg-type]

    return either


def _scalar(kind: str, where: str, name: str, offset: float, allowed: float) -> Value:
    return Value(
        kind=kind, where=where, names=(name,), offset=np.array([offset]),
        allowed=np.array([allowed]),
    )  # fmt: skip


def _add_gains(
    add: Callable[..., None], ready: Prepared, tolerance: float, settings: SysidSettings
) -> None:
    """Gain of each actuator, and the ratio of its velocity gain to its position gain."""
    sysid = package()
    for i in range(ready.model.nu):
        name = ready.model.actuator(i).name
        kp, kv = -ready.model.actuator_biasprm[i, 1], -ready.model.actuator_biasprm[i, 2]
        servo = bool(kp)

        def amplify(
            spec: mujoco.MjSpec, value: float, name: str = name, kp: float = kp, kv: float = kv
        ) -> None:
            if not kp:
                spec.actuator(name).gainprm[0] = value
                return
            sysid.apply_pdgain(spec, name, value * np.array([kp, kv]))

        def share(spec: mujoco.MjSpec, value: float, name: str = name) -> None:
            actuator = spec.actuator(name)
            actuator.biasprm[2] = value * actuator.biasprm[2]

        where = name if servo else name.removeprefix("torque_")
        kind, word = ("actuator_gain", "gain") if servo else ("torque_constant", "factor")
        add(
            f"{name}_gain", 1.0, settings.scale_bounds, amplify,
            _scalar(kind, where, word, 0.0, tolerance),
        )  # fmt: skip
        if servo:
            # written after the gain: parameters are applied in their order
            add(f"{name}_{PRIOR}", 1.0, (0.7, 1.4), share, None)


PRIOR = "velocity_ratio"
"""Ending of the parameters that have the tolerance as a prior."""


def named(fitted: Any, values: list[Value | None], half: Array) -> list[NamedEffect]:
    """Effects whose interval excludes all that the tolerance allows."""
    effects, at = [], 0
    for parameter, value in zip(fitted.values(), values, strict=True):
        own = half[at : at + parameter.size]
        at += parameter.size
        if value is None:
            continue
        change = parameter.as_vector() - value.offset
        nominal = parameter.as_nominal_vector() - value.offset
        beyond = np.abs(change - nominal) - own > value.allowed
        parts = {value.kind: slice(None)}
        if value.kind == "link":
            parts = {"link_mass": slice(0, 1), "link_com": slice(1, 4)}
        for kind, part in parts.items():
            if not beyond[part].any():
                continue
            told = _told(kind, value.names[part], change[part], own[part])
            effects.append(
                NamedEffect(
                    kind=kind,
                    where=value.where,
                    parameters={k: m for k, (m, _, _) in told.items()},
                    interval_95={k: (a, b) for k, (_, a, b) in told.items() if np.isfinite(b - a)},
                    in_model=False,
                )
            )
    return effects


def _told(
    kind: str, names: tuple[str, ...], values: Array, half: Array
) -> dict[str, tuple[float, float, float]]:
    """Value and ends of the interval of each parameter."""
    found = {}
    for name, value, own in zip(names, values, half, strict=True):
        low, high = float(value - own), float(value + own)
        if kind == "torque_constant":  # measured over true torque
            ends = sorted(1.0 / max(end, 1e-3) for end in (low, high))
            found[name] = (1.0 / float(value), *ends)
        else:
            found[name] = (float(value), low, high)
    return found  # type: ignore[return-value]
