"""Export of the corrected model: MJCF with notes, and Python code for what MJCF cannot express.

The file loads in any MuJoCo without this package, and lists at its head what was added.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from loose_env.arms import copy_files, files_of
from loose_env.errors import InvalidData
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel, addresses, set_step
from loose_env.gap.output.result import GapResult
from loose_env.io import written_beside
from loose_env.recording import ModelColumns

_HALVINGS = 3  # times that a step is halved, at most


def corrected_spec(
    machine: NominalModel, hypothesis: Hypothesis, *, step: float | None = None
) -> mujoco.MjSpec:
    """Build the nominal model with all effects that MJCF can express."""
    # The time step is that of the nominal model unless one is given. Keyframes keep the positions
    # of the model's own joints; coordinates added by an effect are zero.
    spec = machine.fresh()
    if step is not None:
        set_step(spec, step)
    hypothesis.edit(spec, export=True)
    _keep_keyframes(spec, machine)
    return spec


def step_for(machine: NominalModel, hypothesis: Hypothesis) -> float:
    """Time step of the written model [s]: at most any delay or lag of its drives."""
    # A filter that is much shorter than a step makes a Runge-Kutta method diverge, and MJCF delays
    # commands from step to step.
    step = machine.time_step
    driven = ((e.parameters, values) for e, values in hypothesis.pairs if e.drives)
    each = (pair for own in driven for pair in zip(*own, strict=True))
    late = [float(value) for parameter, value in each if parameter.unit == "s" and value > 0]
    halvings = np.clip(np.ceil(np.log2(step / min(late, default=step))), 0, _HALVINGS)
    return float(step / 2**halvings)


def _keep_keyframes(spec: mujoco.MjSpec, machine: NominalModel) -> None:
    """Rebuild keyframes: MuJoCo appends values at the end, whichever joint was added."""
    nominal = machine.model
    if not nominal.nkey:
        return
    for key in spec.keys:  # of nominal length, they would not fit
        key.qpos, key.qvel, key.act = [], [], []
    model = spec.copy().compile()
    places, dofs = addresses(model, machine.joints)
    for k, key in enumerate(spec.keys):
        position, speed, state = model.qpos0.copy(), np.zeros(model.nv), np.zeros(model.na)
        position[places], speed[dofs] = nominal.key_qpos[k], nominal.key_qvel[k]
        for number in range(nominal.nu):  # actuators keep their order
            at, before = model.actuator_actadr[number], nominal.actuator_actadr[number]
            own = slice(at, at + model.actuator_actnum[number])
            if before >= 0:
                state[own] = nominal.key_act[k, before : before + own.stop - at]
            elif at >= 0:  # a filter that was added has its command
                state[own] = nominal.key_ctrl[k, number]
        key.qpos, key.qvel, key.act = position, speed, state


def correction_code(hypothesis: Hypothesis) -> str:
    """Python lines that apply effects which MJCF cannot express; "" if none."""
    # Terms on the torque are added before each step, and changes of readings after it. The lines
    # work on ``model`` and ``data`` of MuJoCo. A torque is held over a step, and therefore
    # evaluated at its middle: half a step early for an accelerometer.
    pairs = [(e, np.array([float(f"{v:.6g}") for v in own])) for e, own in hypothesis.pairs]
    terms = [line for effect, own in pairs if (line := effect.torque_code(own))]
    readings = [line for effect, own in pairs if (line := effect.code(own))]
    feedback = [line for effect, own in pairs if (line := effect.feedback_code(own))]
    frictions = [line for effect, own in pairs if (line := effect.friction_code(own))]
    if not (terms or feedback or frictions):
        return "\n".join(readings)
    machine = pairs[0][0].machine
    lines = [
        "# before every mj_step",
        "import mujoco",
        "import numpy as np",
        f"joints = [model.joint(name) for name in [{', '.join(map(repr, machine.joints))}]]",
        "dofs = [int(joint.dofadr[0]) for joint in joints]",
        "speed = data.qvel[dofs]",
        "position = data.qpos[[int(joint.qposadr[0]) for joint in joints]]",
        "position = position + 0.5 * model.opt.timestep * speed",
    ]
    if terms:
        lines += [
            "torque = np.zeros(len(joints))  # or forces of your own that you apply in this step",
            *terms,
            "data.qfrc_applied[dofs] = torque",
        ]
    if feedback:
        lines += [
            f"command = data.ctrl[:{len(machine.actuators)}]  # as commanded, set anew each step",
            *feedback,
        ]
    if frictions:
        spec = machine.fresh()
        hypothesis.edit(spec, export=True)
        own = [float(f"{spec.joint(name).frictionloss:.6g}") for name in machine.joints]
        lines += [
            "mujoco.mj_forward(model, data)",
            f"friction = np.array({own})",
            "drive = data.qfrc_actuator[dofs]",
            "load = -data.qfrc_bias[dofs]",
            *frictions,
            "model.dof_frictionloss[dofs] = friction",
        ]
    if readings:
        lines += ["# after every mj_step", *readings]
    kept = ""  # without values that no line after them has
    for line in reversed(lines):
        name, assigned, _ = line.partition(" = ")
        if (
            "\n" in line
            or not (assigned and name.isidentifier())
            or re.search(rf"\b{name}\b", kept)
        ):
            kept = f"{line}\n{kept}"
    return kept.removesuffix("\n")


def write_model(
    path: Path,
    machine: NominalModel,
    hypothesis: Hypothesis,
    *,
    source: Path | None = None,
    notes: Sequence[str] = (),
) -> list[Path]:
    """Write the corrected model, with the meshes and textures it needs beside it.

    Parameters
    ----------
    path : Path
        Path of the model file.
    machine, hypothesis
        The nominal model, and its effects. The step is at most any delay or lag of its drives.
    source : Path, optional
        File of the nominal model; files it refers to are copied.
    notes : sequence of str
        Lines that stand at the head of the file.

    Returns
    -------
    list of Path
        The files written, the model first.

    Raises
    ------
    InvalidData
        If the model does not compile from the file, or a column of the recording would no longer
        name anything in it.
    """
    spec = corrected_spec(machine, hypothesis, step=step_for(machine, hypothesis))
    try:
        spec.compile()
        xml = spec.to_xml()
    except Exception as error:  # MuJoCo raises ValueError and mujoco.FatalError alike
        raise InvalidData(f"the corrected model does not compile: {error}") from error
    if notes:  # -- ends a comment of an XML file
        said = "\n".join(f"  {' '.join(note.split()).replace('--', '−−')}" for note in notes)
        xml = f"<!--\n{said}\n-->\n{xml}"
    copied: list[Path] = []
    if source is not None:  # of files that it includes, those that the new model still has
        home = source.resolve()
        needed = (
            file
            for file in files_of(home) - {home}
            if file.suffix.lower() not in (".xml", ".mjcf") or file.name in xml
        )
        copied = copy_files(needed, home.parent, path.parent)

    def write(beside: Path) -> None:
        beside.write_text(xml, encoding="utf-8")
        try:
            model = mujoco.MjModel.from_xml_path(str(beside))
        except ValueError as error:
            raise InvalidData(f"the corrected model does not compile: {error}") from error
        before, after = ModelColumns.of(machine.model).known, ModelColumns.of(model).known
        lost = [column for column, meaning in before.items() if after.get(column) != meaning]
        if lost:
            raise InvalidData(
                f"the corrected model has no {lost[0]!r} any more: an effect has changed its name"
            )

    return [written_beside(path, write), *copied]


def model_notes(result: GapResult) -> list[str]:
    """Format notes for the head of ``model.xml``: all changes to the nominal model."""
    notes = ["Corrected by loose gap.", "Added to the nominal model:"]
    for each in result.effects:
        place = "" if each.in_model else " (not in model.xml: see result.json, code)"
        notes.append(f"{each.kind} at {each.where}: {each.values_in_words()}{place}")
    if not result.effects:
        notes[-1] = "No effect was added to the nominal model."
    if result.pulled:
        notes.append("Not changed, though the data pull them out of their tolerances:")
    return [*notes, *(each.words for each in result.pulled)]
