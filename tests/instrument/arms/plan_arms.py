"""Small arms to plan for: on servos over a floor, with torque motors, and a URDF without either."""

from __future__ import annotations

from pathlib import Path

SERVOED = """<mujoco model="servoed">
<option timestep="0.0002" integrator="implicitfast"/>
<worldbody><geom type="plane" size="3 3 .1"/>
<body name="post" pos="0 0 .25"><joint name="pan" axis="0 0 1" range="-170 170" armature=".05"/>
<geom type="capsule" fromto="0 0 0 0 0 .2" size=".05" density="900"/>
<body name="upper" pos="0 0 .25"><joint name="lift" axis="0 1 0" range="-120 120" armature=".05"/>
<geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" density="900"/>
<body name="fore" pos=".4 0 0"><joint name="elbow" axis="0 1 0" range="-150 150" armature=".03"/>
<geom type="capsule" fromto="0 0 0 .35 0 0" size=".025" density="900"/>
<site name="tool" pos=".35 .03 0"/></body></body></body></worldbody>
<actuator>
<position name="pan_servo" joint="pan" kp="800" kv="30" forcerange="-80 80" ctrlrange="-3 3"/>
<position name="lift_servo" joint="lift" kp="900" kv="30" forcerange="-90 90" ctrlrange="-2.2 2.2"/>
<general name="elbow_servo" joint="elbow" dyntype="filter" dynprm=".002" gainprm="450"
 biastype="affine" biasprm="0 -450 -12" gear="2" forcerange="-25 25" ctrlrange="-5.3 5.3"/>
</actuator></mujoco>
"""
"""Three joints on position servos, one with a gear of 2 and a lag; its links collide."""

MOTORS = """<mujoco model="motors">
<worldbody>
<body name="upper" pos="0 0 1"><joint name="lift" axis="0 1 0" range="-60 60" armature=".02"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" density="900"/>
<body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" range="-90 90" armature=".02"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" density="900"/>
<site name="tip" pos=".25 0 0"/></body></body></worldbody>
<actuator><motor name="m1" joint="lift" gear="50" ctrlrange="-1 1"/>
<motor name="m2" joint="elbow" gear="20" ctrlrange="-1 1"/></actuator>
<sensor><accelerometer name="vibration" site="tip"/><jointpos name="q2" joint="elbow"/></sensor>
</mujoco>
"""
"""Two joints with torque motors, an accelerometer and an encoder."""

URDF = """<robot name="plain"><link name="base"/>
<link name="l1"><collision><geometry><mesh filename="package://x/l1.stl"/></geometry></collision>
<inertial><mass value="2"/><origin xyz="0 0 .2"/>
<inertia ixx=".02" iyy=".02" izz=".004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="l2"><inertial><mass value="1"/><origin xyz="0 0.02 .15"/>
<inertia ixx=".01" iyy=".01" izz=".002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="flange"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="80" velocity="2"/></joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0 0 .4"/>
<axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" effort="30" velocity="2"/></joint>
<joint name="f" type="fixed"><parent link="l2"/><child link="flange"/><origin xyz="0 0 .3"/></joint>
</robot>
"""
"""Two joints, no actuators, meshes that are missing."""


def written(folder: Path, text: str, name: str = "arm.xml") -> Path:
    """Write a model into a folder."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def doubled(*further: str) -> str:
    """The servoed arm with further actuators before its own."""
    return SERVOED.replace("<actuator>", "<actuator>" + "".join(further))
