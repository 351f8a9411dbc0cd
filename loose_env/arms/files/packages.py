"""ROS packages of a URDF: its meshes by ``package://`` and ``../``, within one folder."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import mujoco

from loose_env.errors import InvalidData, InvalidSetting

__all__ = ["package_root", "urdf_spec"]

_MANIFEST = "package.xml"
_SCHEME = "package://"


def package_root(file: Path, given: str | Path | None) -> Path | None:
    """Folder within which a URDF may name files.

    Parameters
    ----------
    file : Path
        The URDF, resolved.
    given : str or Path, optional
        Folder of the package, or of several packages. By default the folder above the file that
        holds a ``package.xml``.

    Returns
    -------
    Path or None
        None where there is none: then files lie beside the URDF.

    Raises
    ------
    InvalidSetting
        If there is no such folder.
    """
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

    Raises
    ------
    InvalidData
        If a path leaves the folder.
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
    """Read a URDF whose meshes lie in a package.

    Raises
    ------
    InvalidData
        If a path leaves the package's folder.
    ValueError
        If MuJoCo cannot read it.
    """
    return mujoco.MjSpec.from_string(_urdf_text(file, root))
