"""Reading an MJCF or URDF file down to what moves: bodies, joints, sites and drive figures."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from loose_env.arms.engine_warnings import quiet
from loose_env.arms.files.packages import package_root, urdf_spec
from loose_env.arms.files.safe_scan import outermost, scan
from loose_env.errors import InvalidData, InvalidSetting

__all__ = [
    "Drive",
    "ModelFile",
    "Tie",
    "compile_spec",
    "load_spec",
    "model_file",
    "read_model_file",
    "require_numbers",
]

_TYPES = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Actuator of a file: limit, rotor inertia and damping at its joint."""

    joint: str
    limit: float | None
    """Largest torque at the joint [N·m, or N where it slides]; None where it has no limit."""
    armature: float
    """Rotor inertia at the joint [kg·m², or kg]."""
    damping: float
    """Damping at the joint [N·m·s/rad, or N·s/m]."""


@dataclass(frozen=True, kw_only=True)
class Tie:
    """An equality constraint of a file: two bodies pinned together, or two joints coupled."""

    kind: Literal["bodies", "joints"]
    names: tuple[str, str]
    """Bodies or joints; "" is the world, or nothing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelFile:
    """Contents of a file that matter to an arm, every element with a name."""

    path: Path
    format: Literal["MJCF", "URDF"]
    name: str
    spec: mujoco.MjSpec
    """All that the file holds, not compiled. Treated as read-only: copy it before editing."""
    model: mujoco.MjModel
    """Bodies, joints and sites, compiled; everything else of the file is left out."""
    drives: tuple[Drive, ...]
    ties: tuple[Tie, ...]
    warnings: tuple[str, ...]


def load_spec(
    path: str | Path, *, package: str | Path | None = None
) -> tuple[Path, str, mujoco.MjSpec]:
    """Look over a file and those it includes from its own folder, and read it.

    Parameters
    ----------
    path : str or Path
        The file.
    package : str or Path, optional
        Folder of the ROS package, or packages, in which the meshes of a URDF lie. By default the
        folder above the file that holds a ``package.xml``.

    Returns
    -------
    tuple
        The file's full path; its outermost element, ``mujoco`` or ``robot``; and the
        specification, not compiled.

    Raises
    ------
    InvalidSetting
        If there is no such file.
    InvalidData
        If it is no MJCF or URDF, refers to anything outside its folder, or cannot be read.
    """
    if not isinstance(path, (str, PathLike)):
        raise InvalidSetting(f"a model is the path of an MJCF or URDF file, got {path!r}")
    file = Path(path)
    try:
        there = file.is_file()
    except OSError as error:  # such as a name that is too long
        raise InvalidSetting(f"{str(file)!r:.80} is no path: {error.strerror}") from None
    if file.is_dir():
        raise InvalidSetting(
            f"{str(file)!r} is a folder; give the path of an MJCF or URDF{_models_in(file)}"
        )
    if not there:
        looked = "" if file.is_absolute() else f" in {Path.cwd()}"
        raise InvalidSetting(
            f"there is no file {str(file)!r}{looked}; give the path of an MJCF or URDF"
        )
    file = file.resolve()
    root = outermost(file)
    whole = package_root(file, package) if root == "robot" else None
    scan(file, whole)
    if root not in ("mujoco", "robot"):
        raise InvalidData(
            f"{file.name}: the outermost element is <{root}>; it is <mujoco> in an MJCF and "
            "<robot> in a URDF"
        )
    try:
        with quiet():
            spec = mujoco.MjSpec.from_file(str(file)) if whole is None else urdf_spec(file, whole)
    except InvalidData:
        raise
    except Exception as error:  # MuJoCo raises ValueError and mujoco.FatalError alike
        raise InvalidData(f"{file.name}: MuJoCo cannot read it: {_one_line(error)}") from error
    return file, root, spec


def compile_spec(spec: mujoco.MjSpec, file: Path) -> mujoco.MjModel:
    """Compile what `load_spec` read from a file.

    Raises
    ------
    InvalidData
        If it does not compile; the message says what to change where that is known.
    """
    try:
        with quiet():
            return spec.compile()
    except Exception as error:
        message = _one_line(error)
        hint = ""
        if "mjMINVAL" in message:
            hint = (
                "; a body that moves needs mass: give it an inertia, or put its joint on the "
                "body that has one"
            )
        elif "singular" in message:
            hint = (
                "; of two joints on one axis of a body, such as a drive and the spring behind it, "
                "the first needs a rotor inertia: give it an armature"
            )
        elif "free joint" in message:
            hint = "; an arm stands on the ground: fix its base, without a free or floating joint"
        raise InvalidData(f"{file.name}: MuJoCo cannot build it: {message}{hint}") from error


def read_model_file(path: str | Path, *, package: str | Path | None = None) -> ModelFile:
    """Read a file and everything it includes from its own folder.

    Meshes are opened only where a body's inertia is to be found from them. Those of a URDF may lie
    in its ROS package, see `load_spec`.

    Raises
    ------
    InvalidSetting
        If there is no such file.
    InvalidData
        If it is no MJCF or URDF, refers to anything outside its folder, or cannot be built.
    """
    file, root, spec = load_spec(path, package=package)
    return model_file(spec, file, "URDF" if root == "robot" else "MJCF")


def model_file(spec: mujoco.MjSpec, file: Path, form: Literal["MJCF", "URDF"]) -> ModelFile:
    """Reduce the specification of a file to what matters to an arm; see `read_model_file`.

    Parameters
    ----------
    spec : mujoco.MjSpec
        As `load_spec` read it; bodies, joints and sites without a name get one.
    file : Path
        Its file, for messages and for meshes.
    form : {"MJCF", "URDF"}
        Format of the file.

    Raises
    ------
    InvalidData
        If it cannot be built.
    """
    _name_all(spec)  # before it is copied: a copy drops what refers to a name that is not there
    whole, spec = spec, spec.copy()
    spec.compiler.fusestatic = False  # a tool may be named after a link that is fixed to the last
    drives, ties, warnings = _drives(spec), *_ties(spec)
    if any(np.ravel(t.stiffness)[0] > 0 for t in spec.tendons):
        warnings.append("springs along tendons are left out")
    _strip(spec, file)
    model = compile_spec(spec, file)
    require_numbers(model, drives, file)
    return ModelFile(
        path=file,
        format=form,
        name=file.stem,
        spec=whole,
        model=model,
        drives=drives,
        ties=ties,
        warnings=tuple(warnings),
    )


def require_numbers(model: mujoco.MjModel, drives: tuple[Drive, ...], file: Path) -> None:
    """Refuse a model with NaN, which MuJoCo takes with a warning, and with dampers that drive.

    Raises
    ------
    InvalidData
        If a figure is not finite, or one that has to be positive is negative.
    """
    bodies = "body_pos body_quat body_mass body_inertia body_ipos body_iquat"
    places = "qpos0 jnt_pos jnt_axis jnt_range site_pos site_quat"
    positive = "dof_damping dof_armature jnt_stiffness"
    for name in f"{bodies} {places} {positive}".split():
        values = getattr(model, name)
        if not np.isfinite(values).all() or (name in positive and (values < 0).any()):
            allowed = "finite, zero or more" if name in positive else "finite"
            raise InvalidData(
                f"{file.name}: {name} has to be {allowed}, got {np.ravel(values).tolist()}"
            )
    if not np.isfinite(model.opt.gravity).all():
        raise InvalidData(f"{file.name}: gravity has to be finite, got {model.opt.gravity}")
    for drive in drives:
        if not (0 <= drive.armature < np.inf and 0 <= drive.damping < np.inf):
            raise InvalidData(
                f"{file.name}: armature and damping of the actuator of joint {drive.joint!r} have "
                f"to be finite, zero or more, got {drive.armature} and {drive.damping}"
            )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).removeprefix("Error: ").split())


def _name_all(spec: mujoco.MjSpec) -> None:
    for kind, elements in (("body", spec.bodies[1:]), ("joint", spec.joints), ("site", spec.sites)):
        taken = {e.name for e in elements}
        for number, element in enumerate(elements, start=1):
            if not element.name:
                name = f"{kind}{number}"
                while name in taken:
                    name += "_"
                element.name = name
                taken.add(name)


def _ranged(state: int, limits: np.ndarray) -> bool:
    if state == int(mujoco.mjtLimited.mjLIMITED_AUTO):
        return bool(limits[0] < limits[1])
    return state == int(mujoco.mjtLimited.mjLIMITED_TRUE)


def _drives(spec: mujoco.MjSpec) -> tuple[Drive, ...]:
    drives = []
    for actuator in spec.actuators:
        if actuator.trntype not in _TYPES:
            continue
        gear = abs(float(actuator.gear[0]))
        limit = None
        if _ranged(int(actuator.forcelimited), actuator.forcerange):
            limit = float(np.abs(actuator.forcerange).max())
        elif (
            # A plain motor: its force is its control times a gain.
            actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
            and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
            and _ranged(int(actuator.ctrllimited), actuator.ctrlrange)
        ):
            limit = float(np.abs(actuator.ctrlrange).max() * abs(actuator.gainprm[0]))
        drives.append(
            Drive(
                joint=actuator.target,
                limit=limit * gear if limit and gear else None,
                armature=float(np.ravel(actuator.armature)[0]) * gear**2,
                damping=float(np.ravel(actuator.damping)[0]) * gear**2,
            )
        )
    return tuple(drives)


def _ties(spec: mujoco.MjSpec) -> tuple[tuple[Tie, ...], list[str]]:
    pins = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
    mocap = {b.name for b in spec.bodies if b.mocap}
    body_of = {s.name: s.parent.name for s in spec.sites}
    ties, warnings = [], []
    for equality in spec.equalities:
        names = (equality.name1 or "", equality.name2 or "")
        place = f"equality {equality.name or ' - '.join(n or 'world' for n in names)!r}"
        if equality.type in pins:
            if equality.objtype == mujoco.mjtObj.mjOBJ_SITE:
                names = (body_of.get(names[0], ""), body_of.get(names[1], ""))
            names = ("", names[1]) if names[0] == "world" else names
            names = (names[0], "") if names[1] == "world" else names
            if mocap & set(names):
                warnings.append(f"{place} pulls on a mocap body and is left out")
            elif not equality.active:
                warnings.append(f"{place} is not active and is left out")
            else:
                ties.append(Tie(kind="bodies", names=names))
        elif equality.type == mujoco.mjtEq.mjEQ_JOINT:
            if equality.active:
                ties.append(Tie(kind="joints", names=names))
        else:
            warnings.append(f"{place} is left out: neither bodies nor joints")
    return tuple(ties), warnings


def _strip(spec: mujoco.MjSpec, file: Path) -> None:
    """Leave bodies, joints and sites, and the geoms from which an inertia is found."""
    for group in (
        spec.keys,
        spec.sensors,
        spec.actuators,
        spec.equalities,
        spec.tendons,
        spec.pairs,
        spec.excludes,
        spec.skins,
        spec.flexes,
        spec.cameras,
        spec.lights,
        spec.texts,
        spec.numerics,
        spec.tuples,
    ):
        for element in list(group):
            spec.delete(element)
    compiler = spec.compiler
    always = compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    never = compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    explicit = {b.name for b in spec.bodies if never or (b.explicitinertial and not always)}
    still = {"world"}
    if compiler.settotalmass <= 0:  # else what stands still shares in the total
        for candidate in spec.bodies[1:]:  # a parent comes before its children
            if not candidate.joints and candidate.parent.name in still:
                still.add(candidate.name)
    meshes = {m.name: m for m in spec.meshes}
    missing: list[str] = []
    for geom in list(spec.geoms):
        body = geom.parent.name
        weightless = geom.mass == 0 or (np.isnan(geom.mass) and geom.density == 0)
        shapeless = geom.type == mujoco.mjtGeom.mjGEOM_HFIELD or body in still
        if body in explicit or weightless or shapeless:
            spec.delete(geom)
            continue
        geom.material = ""
        mesh = meshes.get(geom.meshname)
        if mesh is not None and mesh.file:
            name = Path(mesh.file).name if spec.strippath else mesh.file
            if not (file.parent / (spec.meshdir or "") / name).is_file():
                missing.append(f"{Path(mesh.file).name!r} of body {body!r}")
    if missing:
        raise InvalidData(
            f"{file.name}: mesh files are missing: {', '.join(sorted(set(missing)))}; the "
            "inertia of these bodies is to be found from them. Put the meshes there, or give "
            "the bodies an <inertial>"
        )
    used = {g.meshname for g in spec.geoms}
    for group in (spec.materials, spec.textures, spec.hfields):
        for element in list(group):
            spec.delete(element)
    for name, mesh in meshes.items():
        if name not in used:
            spec.delete(mesh)


def _models_in(folder: Path) -> str:
    """A file that may be meant, as words to end a message with."""
    models = sorted(path for path in folder.glob("*.*") if path.suffix.lower() in (".xml", ".urdf"))
    return f", such as {str(models[0])!r}" if models else ""
