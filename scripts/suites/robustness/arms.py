"""Generated arms: MJCF and URDF files of 1 to 12 joints, with the drives that arms have."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import strategies as st

__all__ = ["ACTUATORS", "ArmFile", "arms", "mjcf_arms", "urdf_arms"]

ACTUATORS: dict[str, str] = {
    "motor": '<motor name="a_{j}" joint="{j}" gear="{gear}"/>',
    "position": '<position name="a_{j}" joint="{j}" kp="{kp}" kv="{kv}"/>',
    "velocity": '<velocity name="a_{j}" joint="{j}" kv="{kv}"/>',
    "general": '<general name="a_{j}" joint="{j}" dyntype="filter" dynprm=".02" gainprm="{kp}" '
    'biastype="affine" biasprm="0 -{kp} -{kv}"/>',
    "dcmotor": '<dcmotor name="a_{j}" joint="{j}" motorconst="{kv}" resistance="2"/>',
    "intvelocity": '<intvelocity name="a_{j}" joint="{j}" kp="{kp}" kv="{kv}" actrange="-9 9"/>',
    "damper": '<damper name="a_{j}" joint="{j}" kv="{kv}" ctrlrange="0 1"/>',
}
"""Actuator of a joint in MJCF, by its kind."""
_SENSORS = (
    '<jointpos name="q_{j}" joint="{j}"/>',
    '<jointvel name="v_{j}" joint="{j}"/>',
    '<jointactuatorfrc name="f_{j}" joint="{j}"/>',
)
_TOOL = (
    '<accelerometer name="acc" site="tool"/>',
    '<gyro name="gyro" site="tool"/>',
    '<force name="wrench" site="tool"/>',
    '<framepos name="place" objtype="site" objname="tool"/>',
)


@dataclass(frozen=True, kw_only=True)
class ArmFile:
    """Text of a generated model."""

    text: str
    """The file."""
    joints: int
    """Joints of the chain, those of a gripper included."""
    ending: str
    """"xml" or "urdf"."""


_AXES = st.sampled_from(["1 0 0", "0 1 0", "0 0 1", "0 1 0", "0.6 0 0.8"])
_MASS = st.sampled_from([0.02, 0.1, 1.0, 5.0, 30.0])
_LENGTH = st.sampled_from([0.05, 0.1, 0.3, 0.8])
_JOINTS = st.sampled_from([1, 1, 1, 2, 2, 3, 6, 12])


@st.composite
def mjcf_arms(draw: st.DrawFn) -> ArmFile:
    """Serial arms in MJCF, with any mix of drives, a gripper, a mimic joint or a tendon."""
    count = draw(_JOINTS)
    opened, actuators = "", []
    kinds = draw(st.sampled_from(["none", "mixed", *ACTUATORS]))
    for k in range(count):
        mass, length = draw(_MASS), draw(_LENGTH)
        limits = draw(st.sampled_from(["", "", 'range="-2.5 2.5"', 'range="0 0.5"']))
        extra = draw(
            st.sampled_from(
                ["", 'damping="0.1"', 'armature="0.05" frictionloss="0.2"', 'stiffness="3"',
                 'actuatorfrcrange="-5 5"', 'armature="0.01" damping="1"']
            )
        )  # fmt: skip
        slides = draw(st.sampled_from(["hinge", "hinge", "hinge", "slide"]))
        opened += (
            f'<body name="b{k}" pos="0 0 {length}"><joint name="j{k}" type="{slides}" '
            f'axis="{draw(_AXES)}" {limits} {extra}/>'
            f'<geom type="capsule" fromto="0 0 0 0 {length / 3} {length}" size=".02" '
            f'mass="{mass}" contype="0" conaffinity="0"/>'
        )
        kind = draw(st.sampled_from(["none", *ACTUATORS])) if kinds == "mixed" else kinds
        if kind != "none":
            form = ACTUATORS[kind]
            actuators.append(
                form.format(
                    j=f"j{k}",
                    kp=draw(st.sampled_from([1.0, 50.0, 2000.0])),
                    kv=draw(st.sampled_from([0.1, 5.0])),
                    gear=draw(st.sampled_from([1.0, 1.0, -1.0, 0.05, 100.0])),
                )
            )
    closed, more, joints = "</body>" * count, "", [f"j{k}" for k in range(count)]
    hand = draw(st.sampled_from(["", "", "", "", "gripper", "mimic", "tendon"]))
    fingers = ""
    if hand == "gripper" and count <= 10:
        joints += ["left", "right"]
        for name, sign in (("left", 1), ("right", -1)):
            fingers += (
                f'<body pos="0 {sign * 0.03} .02"><joint name="{name}" type="slide" '
                f'axis="0 {sign} 0" range="0 .04"/><geom size=".01" mass=".02" contype="0" '
                'conaffinity="0"/></body>'
            )
        more = '<equality><joint joint1="left" joint2="right"/></equality>'
        actuators.append('<position name="grip" joint="left" kp="100"/>')
    elif hand == "mimic" and count > 1:
        more = '<equality><joint joint1="j0" joint2="j1" polycoef="0 0.5 0 0 0"/></equality>'
    elif hand == "tendon" and count > 1:
        more = (
            '<tendon><fixed name="cord" stiffness="5" damping=".1"><joint joint="j0" coef="1"/>'
            '<joint joint="j1" coef="-0.5"/></fixed></tendon>'
        )
        if draw(st.booleans()):
            actuators.append('<motor name="pull" tendon="cord"/>')
    read = draw(st.sets(st.sampled_from(_SENSORS), max_size=3)) | {_SENSORS[0]}
    sensors = "".join(form.format(j=j) for form in _SENSORS if form in read for j in joints)
    placed = draw(st.sets(st.sampled_from(_TOOL), max_size=2))
    sensors += "".join(sorted(placed | set(draw(st.sampled_from([_TOOL[:1], _TOOL[:1], ()])))))
    step = draw(st.sampled_from(["0.001", "0.002", "0.005", "0.0001"]))
    how = draw(st.sampled_from(["Euler", "implicitfast", "implicit", "RK4"]))
    text = (
        f'<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="{how}"/>'
        f'<worldbody>{opened}<site name="tool" pos="0 0 .1"/>{fingers}{closed}</worldbody>{more}'
        f"<actuator>{''.join(actuators)}</actuator><sensor>{sensors}</sensor></mujoco>"
    )
    return ArmFile(text=text, joints=len(joints), ending="xml")


@st.composite
def urdf_arms(draw: st.DrawFn) -> ArmFile:
    """Serial arms in URDF: revolute, continuous and prismatic joints, dynamics tags, mimic."""
    count = draw(_JOINTS)
    parts = ['<link name="base"/>']
    for k in range(count):
        mass, length = draw(_MASS), draw(_LENGTH)
        inertia = max(mass * length**2 / 12, 1e-6)
        kind = draw(st.sampled_from(["revolute", "revolute", "continuous", "prismatic", "fixed"]))
        kind = "revolute" if k == 0 else kind
        dynamics = draw(st.sampled_from(["", '<dynamics damping="0.5" friction="0.1"/>']))
        mimic = (
            '<mimic joint="j0" multiplier="-1"/>'
            if k == 1 and draw(st.sampled_from([False, False, True]))
            else ""
        )
        effort = draw(st.sampled_from([0, 10, 300]))
        limit = f'<limit lower="-2" upper="2" effort="{effort}" velocity="3"/>'
        if kind == "fixed":
            limit = dynamics = mimic = ""
        parts.append(
            f'<link name="l{k}"><inertial><origin xyz="0 0 {length / 2}"/><mass value="{mass}"/>'
            f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
            f'</inertial></link><joint name="j{k}" type="{kind}">'
            f'<parent link="{f"l{k - 1}" if k else "base"}"/><child link="l{k}"/>'
            f'<origin xyz="0 0 {length}"/><axis xyz="{draw(_AXES)}"/>'
            f"{limit}{dynamics}{mimic}</joint>"
        )
    text = f'<robot name="arm">{"".join(parts)}</robot>'
    return ArmFile(text=text, joints=count, ending="urdf")


def arms() -> st.SearchStrategy[ArmFile]:
    """Arms of either format."""
    return st.one_of(mjcf_arms(), mjcf_arms(), urdf_arms())
