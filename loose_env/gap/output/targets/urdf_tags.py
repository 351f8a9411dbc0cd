"""Export of joint friction as ``<dynamics damping= friction=>`` tags of URDF.

The URDF specification defines ``damping`` [N·m·s/rad, N·s/m] and ``friction``, the static friction
[N·m, N], as attributes of ``<dynamics>`` in a ``<joint>`` (wiki.ros.org/urdf/XML/joint).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from loose_env.errors import InvalidData
from loose_env.gap.output.targets.drives import JointValues, joint_values
from loose_env.gap.output.targets.source import (
    ALL,
    Export,
    ExportSource,
    not_carried,
    number,
)

_CARRIED = {"viscous_friction": ALL, "coulomb_friction": ALL}


def urdf_export(source: ExportSource, urdf: Path | None = None) -> Export:
    """Write the joint friction of the corrected model for URDF."""
    left = not_carried(source.result.effects, _CARRIED)
    joints = joint_values(source.model)
    if urdf is None:
        return Export(files={"dynamics.urdf.xml": _snippets(joints, left)}, not_expressed=left)
    root = _read(urdf)
    there = {each.get("name"): each for each in root.findall("joint")}
    named = {e.where for e in source.result.effects if e.kind in _CARRIED}
    lacking = sorted(named - set(there))
    if lacking:
        raise InvalidData(
            f"{urdf} has no joint {lacking[0]!r}, where the result names friction; it has "
            f"{sorted(str(name) for name in there)}"
        )
    for joint in joints:
        if joint.name in there:
            _set_tag(there[joint.name], joint)
    if left:
        root.insert(0, ET.Comment(_comment(left)))
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode", xml_declaration=False)
    return Export(
        files={urdf.name: f'<?xml version="1.0"?>\n{text}\n'},
        not_expressed=left,
        notes=(f"paths of meshes in {urdf.name} are relative to the folder of the original",),
    )


def _read(urdf: Path) -> ET.Element:
    try:
        parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
        root = ET.fromstring(urdf.read_text(encoding="utf-8"), parser=parser)
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise InvalidData(f"{urdf} is not XML: {error}") from error
    if root.tag != "robot":
        raise InvalidData(
            f"{urdf} is no URDF: its first element is <{root.tag}>, not <robot>; leave --urdf out "
            "for tags to paste"
        )
    return root


def _set_tag(element: ET.Element, joint: JointValues) -> None:
    tag = element.find("dynamics")
    if tag is None:
        tag = ET.SubElement(element, "dynamics")
    tag.set("damping", number(joint.damping))
    tag.set("friction", number(joint.frictionloss))


def _snippets(joints: tuple[JointValues, ...], left: tuple[str, ...]) -> str:
    """Element ``<joint>`` with its tag, for each joint."""
    root = ET.Element("robot", name="dynamics")
    root.append(ET.Comment(" paste each <dynamics> into the <joint> of the same name "))
    if left:
        root.append(ET.Comment(_comment(left)))
    for joint in joints:
        kind = "revolute" if joint.turns else "prismatic"
        _set_tag(ET.SubElement(root, "joint", name=joint.name, type=kind), joint)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _comment(left: tuple[str, ...]) -> str:
    listed = "".join(f"\n  - {words}" for words in left).replace("--", "−−")
    return f" not expressed:{listed}\n"
