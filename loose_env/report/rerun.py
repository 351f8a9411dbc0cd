"""File of the Rerun viewer: measured, nominal and corrected motion of the simulated runs.

Runs follow one another on one time axis. Entities: ``/channels/CHANNEL/measured`` (and ``nominal``,
``corrected``) are scalars in the unit of the recording; ``/arm/measured`` (and so on) are the
model's bodies at the joint positions measured and predicted. A joint without a position sensor
stands at its reference position.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from loose_env.errors import InvalidData, MissingExtra
from loose_env.gap import GapSolution, Played
from loose_env.io import written_beside
from loose_env.recording import joint_sensors
from loose_env.typing import Array

if TYPE_CHECKING:
    from rerun import RecordingStream

_PAUSE = 0.5  # time between two runs [s]
_FRAMES = 50.0  # frames of the moving arm per second
_VIEWS = 12  # channels that the layout shows at first: those with the largest residual
_COLOURS = {
    "measured": (120, 120, 120, 255),
    "nominal": (214, 96, 77, 150),
    "corrected": (33, 102, 172, 200),
}
"""Kind of motion -> colour, RGBA from 0 to 255."""


def require_rerun() -> Any:
    """Return the module ``rerun``.

    Raises
    ------
    MissingExtra
        If it is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise MissingExtra(
            "--rerun needs the package rerun-sdk: install it with pip install 'loose-env[rerun]'"
        ) from error
    return rerun


def write_rerun(path: str | Path, solution: GapSolution) -> Path:
    """Write the simulated runs of a comparison as a file of Rerun (``.rrd``).

    Parameters
    ----------
    path : str or Path
        The file; replaced if it exists.
    solution : GapSolution
        The finished comparison.

    Raises
    ------
    MissingExtra
        If ``rerun-sdk`` is not installed.
    InvalidData
        If no run is driven by commands, so that none was simulated.
    """
    rerun = require_rerun()
    shown = solution.played
    if shown is None:
        raise InvalidData(
            "no run of the recording is driven by commands, so that there is no simulated motion "
            "for --rerun; leave it out"
        )
    starts = np.cumsum([0.0, *(float(t.time[-1]) + _PAUSE for t in shown.trials[:-1])])

    def write(beside: Path) -> None:
        with rerun.RecordingStream("loose gap", send_properties=False) as stream:
            stream.save(beside)
            worst = _log_channels(rerun, stream, shown, starts)
            _log_arms(rerun, stream, shown, starts)
            stream.send_blueprint(_layout(worst))
            stream.flush()
            stream.disconnect()

    return written_beside(Path(path), write)


def _sides(shown: Played) -> dict[str, Sequence[Array]]:
    """Kind of motion -> readings of each run (T, C)."""
    measured = [trial.measured for trial in shown.trials]
    return {"measured": measured, "nominal": shown.nominal, "corrected": shown.corrected}


def _log_channels(rerun: Any, stream: RecordingStream, shown: Played, starts: Array) -> list[str]:
    """Log every channel; return the entities of those with the largest residual."""
    residuals = {}
    for c, channel in enumerate(shown.channels):
        entity = f"/channels/{rerun.escape_entity_path_part(channel.name)}"
        off = np.concatenate([t.measured[:, c] - n[:, c] for t, n in zip(
            shown.trials, shown.nominal, strict=True)])  # fmt: skip
        spread = np.nanstd(np.concatenate([t.measured[:, c] for t in shown.trials]))
        residuals[entity] = float(np.nanmean(off**2)) / max(float(spread) ** 2, 1e-300)
        for kind, many in _sides(shown).items():
            for start, trial, values in zip(starts, shown.trials, many, strict=True):
                read = np.flatnonzero(np.isfinite(values[:, c]) & np.isfinite(trial.measured[:, c]))
                if len(read):
                    stream.send_columns(
                        f"{entity}/{kind}",
                        indexes=[rerun.TimeColumn("time", duration=start + trial.time[read])],
                        columns=rerun.Scalars.columns(scalars=values[read, c]),
                    )
            look = rerun.SeriesLines(colors=[_COLOURS[kind]], names=[kind])
            stream.log(f"{entity}/{kind}", look, static=True)
    return sorted(residuals, key=lambda entity: -residuals[entity])[:_VIEWS]


def _log_arms(rerun: Any, stream: RecordingStream, shown: Played, starts: Array) -> None:
    """Log the arm's bodies at measured, nominal and corrected joint positions."""
    stream.log("/arm", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    machine = shown.machine
    model, data = machine.model, mujoco.MjData(machine.model)
    names = {b: rerun.escape_entity_path_part(model.body(b).name) for b in range(1, model.nbody)}
    for kind in _COLOURS:
        for body, name in names.items():
            _log_shapes(rerun, stream, f"/arm/{kind}/{name}", model, body, kind)
    addresses = [int(model.joint(name).qposadr[0]) for name in machine.joints]
    for kind, time, position in _motions(shown, starts):
        place = np.zeros((len(time), model.nbody, 3))
        turn = np.zeros((len(time), model.nbody, 4))
        for k, row in enumerate(position):
            data.qpos[addresses] = row
            mujoco.mj_kinematics(model, data)
            place[k], turn[k] = data.xpos, data.xquat
        for body, name in names.items():
            stream.send_columns(
                f"/arm/{kind}/{name}",
                indexes=[rerun.TimeColumn("time", duration=time)],
                columns=rerun.Transform3D.columns(
                    translation=place[:, body], quaternion=turn[:, body][:, [1, 2, 3, 0]]
                ),
            )


def _motions(shown: Played, starts: Array) -> Iterator[tuple[str, Array, Array]]:
    """Kind of motion, times (T,) and joint positions (T, joints) of each run."""
    machine, columns = shown.machine, [c.column for c in shown.channels]
    sensors = joint_sensors(machine.model)
    read = [
        next((columns.index(f"sensor.{n}") for n in sensors[joint].position
              if f"sensor.{n}" in columns), None)
        for joint in machine.joints
    ]  # fmt: skip
    for kind, many in _sides(shown).items():
        for start, trial, values in zip(starts, shown.trials, many, strict=True):
            length = float(trial.time[-1])
            grid = np.linspace(0.0, length, max(2, int(length * _FRAMES) + 1))
            position = np.tile(machine.model.qpos0, (len(grid), 1))
            for j, column in enumerate(read):
                if column is not None and (good := np.isfinite(values[:, column])).any():
                    position[:, j] = np.interp(grid, trial.time[good], values[good, column])
            yield kind, start + grid, position


def _log_shapes(
    rerun: Any, stream: RecordingStream, entity: str, model: mujoco.MjModel, body: int, kind: str
) -> None:
    """Log the shapes of a body, or lines from it to its children where it has none."""
    colour = _COLOURS[kind]
    shapes = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
    for g in shapes:
        shape, (w, x, y, z) = _shape(rerun, model, g, colour), model.geom_quat[g]
        if shape is not None:
            turn = rerun.Transform3D(translation=model.geom_pos[g], quaternion=[x, y, z, w])
            stream.log(f"{entity}/shape{g}", turn, static=True)
            stream.log(f"{entity}/shape{g}", shape, static=True)
    if not shapes:
        children = [b for b in range(1, model.nbody) if model.body_parentid[b] == body]
        ends = [*(model.body_pos[b] for b in children), model.body_ipos[body]]
        lines = [np.stack([np.zeros(3), end]) for end in ends]
        stream.log(f"{entity}/lines", rerun.LineStrips3D(lines, colors=[colour]), static=True)


def _shape(
    rerun: Any, model: mujoco.MjModel, geom: int, colour: tuple[int, int, int, int]
) -> Any | None:
    """A geom's shape in its own frame; None for planes, height fields and the like."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    shapes = mujoco.mjtGeom
    look = {"colors": [colour], "fill_mode": rerun.components.FillMode.Solid}
    if kind == shapes.mjGEOM_BOX:
        return rerun.Boxes3D(half_sizes=[size], **look)
    if kind in (shapes.mjGEOM_SPHERE, shapes.mjGEOM_ELLIPSOID):
        radii = size if kind == shapes.mjGEOM_ELLIPSOID else np.full(3, size[0])
        return rerun.Ellipsoids3D(half_sizes=[radii], **look)
    tube = {"lengths": [2 * size[1]], "radii": [size[0]]}
    if kind == shapes.mjGEOM_CYLINDER:
        return rerun.Cylinders3D(**tube, **look)
    if kind == shapes.mjGEOM_CAPSULE:  # Rerun's begins at the origin, and is centred in MuJoCo
        return rerun.Capsules3D(translations=[[0, 0, -size[1]]], **tube, **look)
    if kind == shapes.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
        return rerun.Mesh3D(
            vertex_positions=model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])],
            triangle_indices=model.mesh_face[face : face + int(model.mesh_facenum[mesh])],
            albedo_factor=colour,
        )
    return None


def _layout(entities: list[str]) -> Any:
    """Layout of the viewer: the arm beside the channels with the largest residual."""
    from rerun import blueprint

    views = [
        blueprint.TimeSeriesView(origin=each, name=each.removeprefix("/channels/"))
        for each in entities
    ]
    arm = blueprint.Spatial3DView(origin="/arm", name="arm")
    return blueprint.Blueprint(
        blueprint.Horizontal(arm, blueprint.Vertical(*views)) if views else arm
    )
