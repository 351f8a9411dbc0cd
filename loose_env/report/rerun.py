"""File of the Rerun viewer: measured, nominal and corrected motion of the held-out runs.

Runs follow one another on one time axis. Entities: ``/channels/CHANNEL/measured`` (and ``nominal``,
``corrected``) are scalars in the unit of the recording; ``/arm/measured`` (and so on) are the
model's bodies at the joint positions measured and predicted. A joint without a position sensor
stands at its reference position; where a model predicts no position, it follows the measurement.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from loose_env.errors import MissingExtra
from loose_env.gap import GapSolution, Series
from loose_env.io import written_beside
from loose_env.recording import joint_sensors
from loose_env.report.gap import by_channel
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
    """Write the held-out runs of a comparison as a file of Rerun (``.rrd``).

    Parameters
    ----------
    path : str or Path
        The file; replaced if it exists.
    solution : GapSolution
        The finished search.

    Raises
    ------
    MissingExtra
        If ``rerun-sdk`` is not installed.
    """
    rerun = require_rerun()
    models = {
        "nominal": by_channel(solution, solution.base.held_out_residual),
        "corrected": by_channel(solution, solution.best.held_out_residual),
    }
    lengths = [float(t.time[-1]) + _PAUSE for t in solution.problem.held_out_whole.trials]
    starts = np.cumsum([0.0, *lengths[:-1]])

    def write(beside: Path) -> None:
        with rerun.RecordingStream("loose gap", send_properties=False) as stream:
            stream.save(beside)
            worst = _log_channels(rerun, stream, solution, models, starts)
            _log_arms(rerun, stream, solution, models, starts)
            stream.send_blueprint(_layout(worst))
            stream.flush()
            stream.disconnect()

    return written_beside(Path(path), write)


Models = dict[str, dict[str, list[Series]]]
"""Kind of model -> channel -> residual of each held-out run."""


def _log_channels(
    rerun: Any, stream: RecordingStream, solution: GapSolution, models: Models, starts: Array
) -> list[str]:
    """Log every channel; return the entities of those with the largest residual."""
    held, residuals = solution.problem.held_out_whole, {}
    for c, channel in enumerate(held.channels):
        entity = f"/channels/{rerun.escape_entity_path_part(channel.name)}"
        parts = []
        for start, trial in zip(starts, held.trials, strict=True):
            read = np.flatnonzero(np.isfinite(trial.measured[:, c]))
            parts.append(("measured", start + trial.time[read], trial.measured[read, c]))
        for kind, by_name in models.items():
            for one in by_name.get(channel.name, ()):
                times = starts[one.trial] + one.time
                parts.append((kind, times, _predicted(solution, one, c)))
        for kind, times, values in parts:
            if len(times):
                stream.send_columns(
                    f"{entity}/{kind}",
                    indexes=[rerun.TimeColumn("time", duration=times)],
                    columns=rerun.Scalars.columns(scalars=values),
                )
        for kind, colour in _COLOURS.items():
            look = rerun.SeriesLines(colors=[colour], names=[kind])
            stream.log(f"{entity}/{kind}", look, static=True)
        nominal = [one.rms for one in models["nominal"].get(channel.name, ())]
        if nominal:
            residuals[entity] = max(nominal)
    return sorted(residuals, key=lambda entity: -residuals[entity])[:_VIEWS]


def _predicted(solution: GapSolution, one: Series, channel: int) -> Array:
    """Predicted readings of a channel at the samples of its residual (N,)."""
    held = solution.problem.held_out_whole
    measured = held.trials[one.trial].measured[one.sample, channel]
    return np.asarray(measured - one.residual * held.scales[one.trial, channel])


def _log_arms(
    rerun: Any, stream: RecordingStream, solution: GapSolution, models: Models, starts: Array
) -> None:
    """Log the arm's bodies at measured, nominal and corrected joint positions."""
    stream.log("/arm", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    machine = solution.problem.machine
    model, data = machine.model, mujoco.MjData(machine.model)
    names = {b: rerun.escape_entity_path_part(model.body(b).name) for b in range(1, model.nbody)}
    for kind in _COLOURS:
        for body, name in names.items():
            _log_shapes(rerun, stream, f"/arm/{kind}/{name}", model, body, kind)
    addresses = [int(model.joint(name).qposadr[0]) for name in machine.joints]
    for kind, time, position in _motions(solution, models, starts):
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


def _motions(
    solution: GapSolution, models: Models, starts: Array
) -> Iterator[tuple[str, Array, Array]]:
    """Kind of motion, times (T,) and joint positions (T, joints) of each held-out run."""
    machine, held = solution.problem.machine, solution.problem.held_out_whole
    sensors = joint_sensors(machine.model)
    columns = {channel.name: c for c, channel in enumerate(held.channels)}
    for t, trial in enumerate(held.trials):
        length = float(trial.time[-1])
        grid = np.linspace(0.0, length, max(2, int(length * _FRAMES) + 1))
        base = np.tile(machine.model.qpos0, (len(grid), 1))
        for j, joint in enumerate(machine.joints):
            values = trial.motion.get(joint)
            if values is not None and np.isfinite(values).any():
                good = np.isfinite(values)
                base[:, j] = np.interp(grid, trial.time[good], values[good])
        yield "measured", starts[t] + grid, base
        for kind, by_name in models.items():
            position = base.copy()
            read = [
                (j, one)
                for j, joint in enumerate(machine.joints)
                if joint in sensors
                for name in sensors[joint].position
                for one in by_name.get(f"sensor.{name}", ())
                if one.trial == t
            ]
            for j, one in read:
                values = _predicted(solution, one, columns[one.channel])
                shown = np.interp(grid, one.time, values, left=np.nan, right=np.nan)
                position[:, j] = np.where(np.isnan(shown), position[:, j], shown)
            if read:
                yield kind, starts[t] + grid, position


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
