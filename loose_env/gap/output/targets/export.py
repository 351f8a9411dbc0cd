"""Export of a result to mujoco.sysid, mjlab, Isaac Lab, URDF, BAM or ranges, as files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from loose_env.errors import UnknownName
from loose_env.gap.output.targets.actuator_configs import isaaclab_export, mjlab_export
from loose_env.gap.output.targets.bam_files import bam_export
from loose_env.gap.output.targets.ranges import ranges_export
from loose_env.gap.output.targets.source import Export, ExportSource, read_source
from loose_env.gap.output.targets.sysid_parameters import sysid_export
from loose_env.gap.output.targets.urdf_tags import urdf_export
from loose_env.io import Checked, Positive, write_text


@dataclass(frozen=True, kw_only=True)
class ExportSettings(Checked):
    """Settings of an export."""

    timestep: Positive | None = None
    """Physics step of the trainer, in which mjlab and Isaac Lab count delays [s]; by default that
    of model.xml."""
    servo: str = ""
    """Name of the servo in BAM, such as xl330; needed for that target."""


_Exporter = Callable[[ExportSource, ExportSettings, Path | None], Export]
TARGETS: Mapping[str, _Exporter] = {
    "sysid": lambda source, settings, urdf: sysid_export(source),
    "mjlab": lambda source, settings, urdf: mjlab_export(source, settings.timestep),
    "isaaclab": lambda source, settings, urdf: isaaclab_export(source, settings.timestep),
    "urdf": lambda source, settings, urdf: urdf_export(source, urdf),
    "bam": lambda source, settings, urdf: bam_export(source, settings.servo),
    "ranges": lambda source, settings, urdf: ranges_export(source),
}
"""Target -> its export."""


def export_result(
    path: str | Path,
    target: str,
    settings: ExportSettings | None = None,
    *,
    urdf: Path | None = None,
) -> Export:
    """Export the named effects of a result.

    Parameters
    ----------
    path : str or Path
        ``result.json`` of ``loose gap``, or the folder with it.
    target : str
        One of `TARGETS`: "sysid", "mjlab", "isaaclab", "urdf", "bam" or "ranges".
    settings : ExportSettings, optional
        Settings of the export.
    urdf : Path, optional
        URDF of the arm, for the target "urdf".

    Raises
    ------
    InvalidData
        If there is no result of this version, or it names no effect.
    InvalidSetting
        If a setting that the target needs is missing.
    UnknownName
        If there is no such target.

    Examples
    --------
    >>> export_result("arm-gap", "gazebo")
    Traceback (most recent call last):
        ...
    loose_env.errors.UnknownName: no export to 'gazebo'; there are sysid, mjlab, isaaclab, ...
    """
    if target not in TARGETS:
        raise UnknownName(f"no export to {target!r}; there are {', '.join(TARGETS)}")
    return TARGETS[target](read_source(path), settings or ExportSettings(), urdf)


def write_export(folder: str | Path, export: Export) -> list[Path]:
    """Write the files of an export into a folder, each complete or not at all.

    Returns
    -------
    list of Path
        The files.
    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    return [write_text(place / name, text) for name, text in export.files.items()]
