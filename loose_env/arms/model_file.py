"""Safe reading of MJCF and URDF files: spec, compiled model, drives, equality constraints."""

from __future__ import annotations

import math
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from loose_env.arms.arm import quiet
from loose_env.errors import InvalidData, InvalidSetting

MOST_BYTES = 2**26
"""Largest XML file that is read [bytes]."""
MOST_ELEMENTS = 200_000
"""Most elements of a model once copies and attached models are counted."""

_PIXELS = 2**24
_MOST: Mapping[tuple[str, tuple[str, ...]], int] = {
    ("replicate", ("count",)): 10_000,
    ("flexcomp", ("count",)): 100_000,
    ("composite", ("count",)): 100_000,
    ("texture", ("width", "height")): _PIXELS,
    ("texture", ("gridsize",)): 10_000,
    ("hfield", ("nrow", "ncol")): _PIXELS,
    ("camera", ("resolution",)): _PIXELS,
    ("mesh", ("params",)): 1_000_000,
    ("mesh", ("octree_maxdepth",)): 8,
    ("key", ("nkey",)): 100_000,
    ("size", ("nkey",)): 100_000,
    ("size", ("nuserdata",)): 10_000_000,
    ("size", ("nconmax",)): 10_000_000,
    ("size", ("njmax",)): 1_000_000,
    ("size", ("nstack",)): 1_000_000_000,
    **{
        ("size", (f"nuser_{kind}",)): 1000
        for kind in ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")
    },
    ("numeric", ("size",)): 100_000,
    **{(tag, ("nsample",)): 100_000 for tag in ("general", "motor", "position", "velocity")},
}
"""Element, attributes -> the largest product of the numbers in them."""
_ANYWHERE: Mapping[str, int] = {"nsample": 100_000, "num": 1_000_000}
"""Attributes that ask for memory wherever they stand."""
_MEMORY = 2**32
_UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}


def check_counts(root: ET.Element, file: Path) -> None:
    """Refuse numbers in a file that ask for more than any arm needs."""
    for element in root.iter():
        tag = _local(element)
        for (name, keys), most in _MOST.items():
            if tag == name:
                _check(element, tag, keys, most, file)
        for key, most in _ANYWHERE.items():
            _check(element, tag, (key,), most, file)
        memory = element.get("memory") if tag == "size" else None
        if memory is not None and _bytes(memory) > _MEMORY:
            raise InvalidData(
                f"{file.name}: <size memory={memory!r:.40}> asks for too much; at most 4G is "
                "taken. Leave it out, MuJoCo finds what the model needs"
            )


def check_expanded(
    root: ET.Element, attached: Mapping[str, float], file: Path, included: float = 0.0
) -> float:
    """Elements of a file with its copies, and with the models that it attaches."""
    total = included
    waiting: list[tuple[ET.Element, float]] = [(root, 1.0)]
    while waiting:
        element, copies = waiting.pop()
        total += copies
        tag = _local(element)
        if tag == "replicate":
            copies *= max(_product(element, ("count",)), 1.0)
        elif tag == "attach":
            # A model without a name goes by another one: the largest is counted.
            given = element.get("model", "")
            total += copies * attached.get(given, max(attached.values(), default=0.0))
        if total > MOST_ELEMENTS or copies > MOST_ELEMENTS:
            raise InvalidData(
                f"{file.name}: <{tag}>: with its copies and the models it attaches the file has "
                f"more than {MOST_ELEMENTS} elements, which are not read"
            )
        waiting += [(child, copies) for child in element]
    return total


def _check(element: ET.Element, tag: str, keys: tuple[str, ...], most: int, file: Path) -> None:
    asked = _product(element, keys)
    if asked > most:
        words = " ".join(f"{k}={element.get(k)!r:.40}" for k in keys if element.get(k))
        raise InvalidData(
            f"{file.name}: <{tag} {words}> asks for {asked:.3g}; at most {most} are read"
        )


def _product(element: ET.Element, keys: tuple[str, ...]) -> float:
    """Product of all numbers in some attributes; 0 where there is none."""
    words = [word for key in keys for word in element.get(key, "").split()]
    found = 1.0 if words else 0.0
    for word in words:
        try:
            number = abs(float(word))
        except ValueError:  # left to MuJoCo, which says it better
            return 0.0
        found *= max(number, 1.0) if not math.isnan(number) else 1.0
    return found


def _bytes(text: str) -> float:
    word = text.strip().upper()
    unit = word[-1:] if word[-1:] in _UNITS else ""
    try:
        return float(word.removesuffix(unit)) * _UNITS[unit]
    except ValueError:
        return 0.0


_INCLUDED = ("include", "model")  # elements whose file is XML of its own
_DIRECTORIES = ("assetdir", "meshdir", "texturedir")


def scan(file: Path, root: Path | None = None) -> ET.Element:
    """Parse a file and those it includes, and return its outermost element.

    Files lie in the file's own folder, or in ``root`` where that is given.
    """
    return _looked_over(file, root).parsed[file]


def outermost(file: Path) -> str:
    """Name of the outermost element of a file; raises as `scan`."""
    return str(_parsed(file).tag)


def files_of(file: Path) -> set[Path]:
    """Files that stand for a model: the file, those it includes, and the assets that are there.

    Raises as `scan`. ``file`` has to be resolved, as there.
    """
    found = _looked_over(file)
    return set(found.parsed) | found.assets


def copy_files(files: Iterable[Path], home: Path, folder: Path) -> list[Path]:
    """Copy files below one folder to the same places below another; list those made there."""
    pairs = [(file, folder / file.relative_to(home)) for file in sorted(files)]
    pairs = [(file, copy) for file, copy in pairs if file != copy]
    for file, copy in pairs:
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    return [copy for _, copy in pairs]


@dataclass(kw_only=True)
class _Found:
    """Files to which a file and its includes refer."""

    folders: tuple[Path, ...]
    """Folders in which every file has to lie."""
    parsed: dict[Path, ET.Element] = field(default_factory=dict)
    places: list[Path] = field(default_factory=list)
    """Folders in which assets are looked for: a directory that one file names holds for all."""
    parts: dict[Path, list[tuple[ET.Element, Path]]] = field(default_factory=dict)
    """File -> elements that name a file of XML, and that file."""
    assets: set[Path] = field(default_factory=set)


def _looked_over(file: Path, root: Path | None = None) -> _Found:
    try:
        return _followed(file, root)
    except InvalidData as error:
        if str(error).startswith(f"{file.name}:"):
            raise
        raise InvalidData(f"{file.name}: it includes {error}") from None


def _followed(file: Path, package: Path | None) -> _Found:
    folders = (file.parent,) if package is None else (file.parent, package)
    found = _Found(folders=folders, places=[file.parent])
    waiting = [file]
    while waiting:
        while waiting:
            each = waiting.pop()
            if each not in found.parsed:
                found.parsed[each] = _parsed(each)
                found.places += _directories(each, found)
        # A folder named in one file may be where another one's part lies.
        found.parts, found.assets = {}, set()
        for each, root in found.parsed.items():
            waiting += [part for part in _references(each, root, found) if part not in found.parsed]
    _expanded(file, found, {}, [])
    return found


def _parsed(file: Path) -> ET.Element:
    size = file.stat().st_size
    if size > MOST_BYTES:
        raise InvalidData(f"{file.name}: {size} bytes; at most {MOST_BYTES} are read")
    raw = file.read_bytes()
    if re.search(rb"<!(DOCTYPE|ENTITY)", raw):
        raise InvalidData(
            f"{file.name}: it declares a document type or entities, which are not read; "
            "remove the <!DOCTYPE ...>"
        )
    try:
        root = ET.fromstring(raw)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InvalidData(f"{file.name}: not XML: {error}") from None
    if any("ros.org/wiki/xacro" in str(e.tag) for e in root.iter()):
        raise InvalidData(f"{file.name}: it is a xacro; expand it to a plain URDF first")
    check_counts(root, file)
    return root


def _directories(file: Path, found: _Found) -> list[Path]:
    places = [file.parent]
    for element in found.parsed[file].iter():
        if _local(element) == "compiler":
            for key in _DIRECTORIES:
                given = element.get(key)
                if given:
                    at = (found.places[0], file.parent)
                    places += [_inside(given, p, found.folders, file, "compiler", key) for p in at]
    return [place for place in dict.fromkeys(places) if place not in found.places]


def _references(file: Path, root: ET.Element, found: _Found) -> list[Path]:
    """Check every file that a file names; return those that are XML of their own."""
    parts = found.parts[file] = []
    for element in root.iter():
        tag = _local(element)
        for key, given in element.attrib.items():
            if not key.startswith("file") or not given:
                continue
            for place in dict.fromkeys((*found.places, file.parent)):
                named = _inside(given, place, found.folders, file, tag, key)
                # URDF and the option strippath take the last part of a path alone.
                alone = _inside(named.name, place, found.folders, file, tag, key)
                there = {f for f in (named, alone) if _is_file(f, file, tag, key, given)}
                found.assets |= there
                if tag in _INCLUDED and named in there:
                    parts.append((element, named))
    return [part for _, part in parts]


def _expanded(file: Path, found: _Found, known: dict[Path, float], above: list[Path]) -> float:
    """Elements of a file with what it includes and attaches."""
    if file in above:  # MuJoCo refuses a file that includes itself
        return 0.0
    if file not in known:
        included, attached = 0.0, dict[str, float]()
        for element, part in found.parts[file]:
            size = _expanded(part, found, known, [*above, file])
            if _local(element) == "include":
                included += size
            else:
                names = (element.get("name", ""), part.stem, found.parsed[part].get("model", ""))
                attached |= dict.fromkeys(filter(None, names), size)
        known[file] = check_expanded(found.parsed[file], attached, file, included)
    return known[file]


def _is_file(path: Path, file: Path, tag: str, key: str, given: str) -> bool:
    """Return whether there is a file; refuse a pipe or a device, which would block."""
    if path.is_file():
        return True
    if path.exists() and not path.is_dir():
        raise InvalidData(
            f"{file.name}: <{tag} {key}={given!r:.60}> is no file but a pipe or a device, which "
            "is not read"
        )
    return False


def _inside(
    given: str, place: Path, folders: tuple[Path, ...], file: Path, tag: str, key: str
) -> Path:
    # Packages are not looked up: MuJoCo takes their file's name alone. It also takes a
    # backslash for a slash, on every system.
    local = given.replace("\\", "/").removeprefix("file://").removeprefix("package://")
    words = f"{file.name}: <{tag} {key}={given!r:.200}>"
    try:
        found = (place / local).resolve()
        found.exists()
    except (OSError, RuntimeError, ValueError) as error:
        raise InvalidData(f"{words} leads nowhere: {_reason(error)}") from None
    if "://" in local or not any(found.is_relative_to(folder) for folder in folders):
        raise InvalidData(
            f"{words} lies outside the file's folder and is not "
            "read; copy what it needs beside the file, remove the element or, for meshes of a "
            "URDF's package, name the package's folder with --package-path"
        )
    return found


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _local(element: ET.Element) -> str:
    """Name of an element without its namespace, which MuJoCo does not know."""
    return str(element.tag).rpartition("}")[2]


_MANIFEST = "package.xml"
_SCHEME = "package://"


def package_root(file: Path, given: str | Path | None) -> Path | None:
    """Folder within which a URDF may name files."""
    if given is not None:
        folder = Path(given)
        if not folder.is_dir():
            raise InvalidSetting(
                f"--package-path {str(given)!r} is no folder; give that of the package, which "
                "holds its meshes, or the folder of several packages"
            )
        return folder.resolve()
    return next((each for each in file.parents if (each / _MANIFEST).is_file()), None)


def _urdf_text(file: Path, root: Path) -> str:
    """Text of a URDF whose meshes are named by full paths within a folder.

    ``package://name/rest`` is ``rest`` in ``root``, where root is the package, or ``name/rest``,
    where it holds the packages; any other path counts from the URDF's folder.
    """
    tree = ET.fromstring(file.read_bytes())
    for element in tree.iter():
        given = element.get("filename")
        if not given or str(element.tag) not in ("mesh", "texture"):
            continue
        element.set("filename", str(_resolved(given, file, root)))
    compiler = tree.find("mujoco/compiler")
    if compiler is None:
        extension = tree.find("mujoco")
        extension = ET.SubElement(tree, "mujoco") if extension is None else extension
        compiler = ET.SubElement(extension, "compiler")
    # Paths are full: no folder is put before them, and nothing of them is dropped.
    compiler.set("strippath", "false")
    for key in ("meshdir", "assetdir", "texturedir"):
        compiler.attrib.pop(key, None)
    return ET.tostring(tree, encoding="unicode")


def _resolved(given: str, file: Path, root: Path) -> Path:
    local = given.replace("\\", "/").removeprefix("file://")
    places = list(_places(local, file, root))
    inside = [
        place for place in places if place.is_relative_to(root) or place.is_relative_to(file.parent)
    ]
    if not inside or "://" in local.removeprefix(_SCHEME):
        raise InvalidData(
            f"{file.name}: {given!r:.200} lies outside the package's folder {str(root)!r} and is "
            "not read; name the folder that holds it with --package-path"
        )
    return next((place for place in inside if place.is_file()), inside[0])


def _places(local: str, file: Path, root: Path) -> Iterator[Path]:
    """Where a path may lead, the likeliest first."""
    try:
        if not local.startswith(_SCHEME):
            yield (file.parent / local).resolve()
            return
        name, _, rest = local.removeprefix(_SCHEME).partition("/")
        yield (root / name / rest).resolve()
        yield (root / rest).resolve()
        yield (file.parent / rest).resolve()
        # As without a package: the last part of the path, beside the URDF.
        yield (file.parent / Path(rest).name).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InvalidData(f"{file.name}: {local!r:.200} leads nowhere: {error}") from None


def urdf_spec(file: Path, root: Path) -> mujoco.MjSpec:
    """Read a URDF whose meshes lie in a package."""
    return mujoco.MjSpec.from_string(_urdf_text(file, root))


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


def model_path(path: Any) -> Path:
    """Path of a model's file; refuses what is none."""
    if not isinstance(path, (str, PathLike)):
        raise InvalidSetting(f"a model is the path of an MJCF or URDF file, got {path!r}")
    return Path(path)


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
    file = model_path(path)
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
