"""Nominal machines of the gap suite: parameters of eleven serial machines, and their MJCF."""

from __future__ import annotations

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from loose_env.typing import Array

GRAVITY = 9.81  # acceleration of free fall [m/s²]; the world's z axis points up
BAR_CENTRE = 0.48  # centre of mass of a bar over its length


@dataclasses.dataclass(frozen=True, kw_only=True)
class Machine:
    """A nominal serial machine: arrays with a row a link, from the base; a slide's in m, N, kg."""

    name: str  # A word for the machine; never written into a recording
    hanging: Array | None
    """Joint positions in which it hangs at rest with its drives off, if there are any."""
    slide: NDArray[np.bool_]  # Joints that slide; the others turn
    axis: Array  # Axis of the joint, a unit vector in the link's frame
    offset: Array  # Origin of the link's frame in the frame of the link before [m]
    end: Array  # Distal end of the link, in its own frame [m]
    mass: Array  # Mass [kg]
    com: Array  # Centre of mass in the link's frame [m]
    inertia: Array
    """Moments of inertia about the centre of mass, along the link's frame [kg m²]."""
    armature: Array  # Inertia of the rotor, seen at the joint [kg m²]
    damping: Array  # Viscous damping of the joint [N m s/rad]
    kp: Array  # Position gain of the servo [N m/rad]
    kv: Array  # Velocity gain of the servo [N m s/rad]
    limit: Array  # Largest torque of the servo [N m]
    home: Array  # Middle of the joint's range of motion [rad]
    reach: Array  # Half of the joint's range of motion [rad]

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.slide)

    @property
    def length(self) -> Array:
        """Lengths by which tolerances of the links' centres go, of shape (n,) [m]."""
        return np.array([max(float(np.linalg.norm(end)), 0.1) for end in self.end])

    def link(self, j: int) -> SimpleNamespace:
        """Numbers of one link, by the names of the arrays."""
        rows = {name: values[j] for name, values in vars(self).items() if name not in _WHOLE}
        return SimpleNamespace(**rows, length=self.length[j])


# A link: its axis, | rest of the drive: armature damping kp kv limit home reach.
# A `bar` along x has mass, length and radius; a `part` mass; end; centre; moments of inertia.
_TABLE = """
rig1 hangs 1.5707963
bar y 0 0 0     1.2 .35 .02  | .02 .1 160 6 12 .4 1.2
turntable1
bar z 0 0 .2    3.0 .30 .06  | .15 .6 700 26 40 0 1.5
planar2 hangs 1.5707963 0
bar y 0 0 0     .35 .18 .02  | .012 .06 40 1.4 6 -.5 .8
bar y .18 0 0   .22 .15 .015 | .006 .03 16 .5 3 .8 .9
planar3 hangs 1.5707963267948966 0 0
bar y 0 0 0     4.0 .40 .05  | .40 3 4000 160 160 -.6 .6
bar y .40 0 0   2.5 .35 .04  | .18 1.5 2000 70 80 .9 .7
bar y .35 0 0   1.4 .25 .03  | .05 .5 500 14 25 .4 .9
spatial3 hangs 0 1.5707963267948966 0
part z 0 0 .3   6.0; 0 0 .12; .01 0 .05; .035 .035 .028 | .35 2.5 3500 140 140 0 .9
bar y 0 0 .12   3.2 .42 .05  | .30 2 3500 130 140 -.7 .5
bar y .42 0 0   1.8 .38 .035 | .10 .8 1200 40 50 1 .7
gantry3
slide x 0 0 1   22; .1 0 0; .02 .05 0; 1.2 .4 1.4    | 12 90 60000 2400 900 .2 .3
slide y .1 0 0  9; 0 0 -.1; 0 .02 .03; .12 .1 .1     | 6 50 32000 1200 450 .1 .25
slide z 0 0 -.1 4; 0 0 -.3; .01 0 -.12; .04 .04 .01  | 4 60 22000 800 320 .05 .12
leg3 hangs 0 0 0
part x 0 0 .6    .7; 0 .085 0; -.005 .01 0; .0005 .0008 .0006   | .011 .08 60 2 24 0 .5
part y 0 .085 0  1.15; 0 0 -.213; -.004 -.02 -.03; .006 .006 .001 | .011 .08 60 2 24 .7 .7
part y 0 0 -.213 .16; 0 0 -.213; .006 0 -.12; .0014 .0014 .00003 | .025 .1 60 2 40 -1.4 .6
scara4
bar z 0 0 .4    5.0 .35 .06  | .30 2 3000 110 100 .2 .9
bar z .35 0 0   3.0 .30 .05  | .12 1 1200 40 50 .7 .9
slide z .3 0 0  1.5; 0 0 -.2; .01 0 -.1; .006 .006 .001 | 2 30 12000 350 180 .05 .08
part z 0 0 -.2  .8; .1 0 -.05; .04 .01 -.02; .0008 .0015 .0016 | .02 .15 80 2.2 8 0 1.4
elbow4
part z 0 0 .25  5.0; 0 0 .1; 0 .01 .04; .03 .03 .02 | .30 2 3000 120 120 .1 .8
bar y 0 0 .1    3.0 .36 .05  | .28 1.8 3200 120 130 -.8 .5
bar y .36 0 0   1.8 .32 .04  | .12 .8 1200 40 50 1.1 .6
bar y .32 0 0   .9 .16 .03   | .03 .25 250 6 15 .2 .9
upright6
part z 0 0 .3   6.5; 0 0 .12; 0 .01 .05; .04 .04 .03 | .45 3 4000 170 160 0 .8
bar y 0 0 .12   4.0 .40 .05  | .45 2.5 4500 180 180 -.8 .45
bar y .40 0 0   2.6 .34 .04  | .20 1.2 2000 75 90 1.1 .55
part x .34 0 0  1.1; .1 0 0; .05 0 .005; .002 .003 .003 | .04 .3 300 8 20 .1 1.2
bar y .1 0 0    .8 .12 .03   | .03 .25 220 6 15 .5 .9
part x .12 0 0  .4; .06 0 .03; .03 .01 .02; .0005 .0006 .0006 | .012 .08 60 1.6 6 0 1.4
redundant7
part z 0 0 .3   5.5; 0 0 .12; .01 0 .05; .035 .035 .025 | .4 2.6 3600 150 150 .1 .8
bar y 0 0 .12   3.6 .26 .035 | .45 2.5 4200 170 170 -.9 .4
bar x .26 0 0   2.4 .18 .035 | .25 1.4 1500 55 90 .1 .8
bar y .18 0 0   2.2 .22 .035 | .22 1.3 1900 70 90 1 .5
bar x .22 0 0   1.4 .16 .035 | .08 .6 600 18 40 0 1
bar y .16 0 0   1.1 .12 .035 | .05 .4 400 11 25 .6 .8
part x .12 0 0  .5; .06 .02 .02; .03 .012 .01; .0003 .00042 .00042 | .015 .1 80 2.2 8 0 1.3
"""
_WHOLE = ("name", "hanging")
_DRIVE = ("armature", "damping", "kp", "kv", "limit", "home", "reach")


def _machine(text: str) -> Machine:
    """A machine of the table."""
    head, *lines = text.splitlines()
    name, *hanging = head.replace("hangs", "").split()
    links = []
    for line in lines:
        body, drive = line.split("|")
        word, axis, *places = body.replace(";", "").split()
        x = [float(number) for number in places]
        if word == "bar":  # its mass is around the middle
            mass, length, radius = x[3:]
            across = mass * (length**2 / 12 + radius**2 / 4)
            x = [*x[:4], length, 0, 0, BAR_CENTRE * length, 0, 0]
            x += [mass * radius**2 / 2, across, across]
        unit = [float(axis == each) for each in "xyz"]
        links.append([word == "slide", *unit, *x, *map(float, drive.split())])
    slide, axes, offset, heavy, end, com, inertia, drives = np.split(
        np.array(links, dtype=float), [1, 4, 7, 8, 11, 14, 17], axis=1
    )
    return Machine(
        name=name, hanging=np.array(hanging, dtype=float) if hanging else None,
        slide=slide[:, 0] > 0, axis=axes, offset=offset, mass=heavy[:, 0], end=end, com=com,
        inertia=inertia, **dict(zip(_DRIVE, drives.T, strict=True)),
    )  # fmt: skip


MACHINES = {each.name: each for each in map(_machine, re.split(r"\n(?=[a-z]+\d)", _TABLE.strip()))}
"""Nominal machines by name."""


def varied(machine: Machine, rng: np.random.Generator) -> Machine:
    """A machine of other lengths, masses and stiffness, with the same shape."""
    long, heavy, stiff = np.exp(rng.uniform(np.log(0.8), np.log(1.25), 3))
    slide, turned = machine.slide, heavy * long**2
    inert, way = np.where(slide, heavy, turned), np.where(slide, long, 1.0)
    scales = {
        "mass": heavy, "offset": long, "end": long, "com": long, "inertia": turned,
        "armature": inert, "damping": inert, "kp": inert * stiff**2, "kv": inert * stiff,
        "limit": np.where(slide, heavy, heavy * max(long, long**2)), "reach": way, "home": way,
    }  # fmt: skip
    changed = {name: scale * getattr(machine, name) for name, scale in scales.items()}
    return dataclasses.replace(machine, **changed)


TIME_STEP = 5e-4
"""Time step of the model [s]: with the Runge-Kutta method its own error is about 1e-8 rad."""


def _text(*values: float) -> str:
    return " ".join(f"{value:.10g}" for value in values)


def model_xml(
    machine: Machine, *, servos: bool = True, speeds: bool = True, accelerometer: bool = True,
    plain: bool = False,
) -> str:  # fmt: skip
    """MJCF of the nominal machine; plain with MuJoCo's usual integrator and step, as users have."""
    fine = f'timestep="{TIME_STEP:g}" integrator="RK4"'
    option = 'timestep="0.001" integrator="implicitfast"' if plain else fine
    lines = [
        '<mujoco model="arm">',
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option {option} gravity="0 0 -9.81"/>',
        "  <worldbody>",
    ]
    motors, sensors, m = [], [], machine
    for i in range(m.joints):
        indent, number, kind = "    " + "  " * i, i + 1, "slide" if m.slide[i] else "hinge"
        lines += [
            f'{indent}<body name="link{number}" pos="{_text(*m.offset[i])}">',
            f'{indent}  <inertial mass="{_text(m.mass[i])}" pos="{_text(*m.com[i])}" '
            f'diaginertia="{_text(*m.inertia[i])}"/>',
            f'{indent}  <joint name="joint{number}" type="{kind}" axis="{_text(*m.axis[i])}" '
            f'damping="{_text(m.damping[i])}" armature="{_text(m.armature[i])}"/>',
        ]
        motors.append(
            f'    <position name="motor{number}" joint="joint{number}" kp="{_text(m.kp[i])}" '
            f'kv="{_text(m.kv[i])}" forcerange="{_text(-m.limit[i], m.limit[i])}"/>'
        )
        read = ["jointpos", "jointvel"] if speeds else ["jointpos"]
        sensors += [f'    <{x} name="joint{number}_{x[5:]}" joint="joint{number}"/>' for x in read]
    lines.append(f'{indent}  <site name="tool" pos="{_text(*m.end[-1])}"/>')
    lines += ["    " + "  " * i + "</body>" for i in reversed(range(m.joints))]
    lines.append("  </worldbody>")
    if servos:
        lines += ["  <actuator>", *motors, "  </actuator>"]
    if accelerometer:
        sensors.append('    <accelerometer name="tool_acc" site="tool"/>')
    return "\n".join([*lines, "  <sensor>", *sensors, "  </sensor>", "</mujoco>", ""])
