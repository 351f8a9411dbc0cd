"""Nominal machines of the gap suite: parameters of eleven serial machines, and their MJCF."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np

from loose_env.typing import Array

GRAVITY = 9.81
"""Acceleration of free fall [m/s²]; the world's z axis points up."""
Three = tuple[float, float, float]
BAR_CENTRE = 0.48
"""Centre of mass of a bar over its length."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Link:
    """A joint, the rigid body it moves and the drive of the joint; of a slide in m, N and kg."""

    kind: str = "hinge"
    """`hinge` or `slide`."""
    axis: Three
    """Axis of the joint, a unit vector in the link's frame."""
    offset: Three
    """Origin of the link's frame in the frame of the link before [m]."""
    end: Three
    """Distal end of the link, in its own frame [m]."""
    mass: float
    """Mass [kg]."""
    com: Three
    """Centre of mass in the link's frame [m]."""
    inertia: Three
    """Moments of inertia about the centre of mass, along the link's frame [kg m²]."""
    armature: float
    """Inertia of the rotor, seen at the joint [kg m²]."""
    damping: float
    """Viscous damping of the joint [N m s/rad]."""
    kp: float
    """Position gain of the servo [N m/rad]."""
    kv: float
    """Velocity gain of the servo [N m s/rad]."""
    limit: float
    """Largest torque of the servo [N m]."""
    home: float
    """Middle of the joint's range of motion [rad]."""
    reach: float
    """Half of the joint's range of motion [rad]."""

    @property
    def length(self) -> float:
        """Length by which tolerances of its centre go [m]."""
        return max(float(np.linalg.norm(self.end)), 0.1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Figures:
    """A nominal arm: what its model.xml says."""

    name: str
    """A word for the arm; never written into a recording."""
    links: tuple[Link, ...]
    """The links from the base."""
    hanging: tuple[float, ...] | None = None
    """Joint positions in which the arm hangs at rest with its drives off, if there are any."""

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.links)

    @property
    def home(self) -> Array:
        """Middles of the ranges of motion, of shape (n,) [rad or m]."""
        return np.array([link.home for link in self.links])

    @property
    def reach(self) -> Array:
        """Half ranges of motion, of shape (n,) [rad or m]."""
        return np.array([link.reach for link in self.links])


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


def rod(mass: float, length: float, radius: float) -> Three:
    """Moments of inertia of a round bar along x about its middle [kg m²]."""
    across = mass * (length**2 / 12 + radius**2 / 4)
    return (mass * radius**2 / 2, across, across)


def _link(line: str) -> Link:
    """A link of the table."""
    body, drive = line.split("|")
    word, axis, *places = body.replace(";", "").split()
    x = [float(number) for number in places]
    if word == "bar":  # its mass is around the middle
        mass, length, radius = x[3:]
        rigid = (length, 0.0, 0.0, BAR_CENTRE * length, 0.0, 0.0, *rod(mass, length, radius))
        x = [*x[:4], *rigid]
    own = ("armature", "damping", "kp", "kv", "limit", "home", "reach")
    figures = dict(zip(own, map(float, drive.split()), strict=True))
    return Link(
        kind="slide" if word == "slide" else "hinge",
        axis=(float(axis == "x"), float(axis == "y"), float(axis == "z")),
        offset=(x[0], x[1], x[2]), mass=x[3], end=(x[4], x[5], x[6]), com=(x[7], x[8], x[9]),
        inertia=(x[10], x[11], x[12]), **figures,
    )  # fmt: skip


def _machine(name: str) -> Figures:
    """A machine of the table."""
    lines = iter(_TABLE.strip().splitlines())
    head = next(line for line in lines if line.split()[0] == name).split()
    links = []
    for line in lines:
        if "|" not in line:
            break
        links.append(_link(line))
    hanging = tuple(map(float, head[2:])) if "hangs" in head else None
    return Figures(name=name, links=tuple(links), hanging=hanging)


MACHINES: dict[str, Callable[[], Figures]] = {
    line.split()[0]: partial(_machine, line.split()[0])
    for line in _TABLE.strip().splitlines()
    if "|" not in line
}
"""Makers of the nominal machines by name."""
ARMS = {name: MACHINES[name] for name in ("planar3", "spatial3", "scara4", "elbow4")}
"""Those on which parts rattle."""
planar3, spatial3 = MACHINES["planar3"], MACHINES["spatial3"]


def varied(figures: Figures, rng: np.random.Generator) -> Figures:
    """A machine of other lengths, masses and stiffness, with the same shape."""
    long, heavy, stiff = np.exp(rng.uniform(np.log(0.8), np.log(1.25), 3))
    links = []
    for link in figures.links:
        slide = link.kind == "slide"
        inert, way = (heavy, long) if slide else (heavy * long**2, 1.0)
        scales = {
            "mass": heavy, "offset": long, "end": long, "com": long, "inertia": heavy * long**2,
            "armature": inert, "damping": inert, "kp": inert * stiff**2, "kv": inert * stiff,
            "limit": heavy if slide else heavy * max(long, long**2), "reach": way, "home": way,
        }  # fmt: skip
        changed = {
            name: tuple(scale * x for x in own) if isinstance(own, tuple) else scale * own
            for name, scale in scales.items()
            for own in [getattr(link, name)]
        }
        links.append(dataclasses.replace(link, **changed))  # type: ignore[arg-type]
    return dataclasses.replace(figures, links=tuple(links))


TIME_STEP = 5e-4
"""Time step of the model [s]: with the Runge-Kutta method its own error is about 1e-8 rad."""


def _text(values: object) -> str:
    return " ".join(f"{value:.10g}" for value in values)  # type: ignore[attr-defined]


def joint_names(figures: Figures) -> list[str]:
    """Names of the joints in the model."""
    return [f"joint{i + 1}" for i in range(figures.joints)]


def model_xml(
    figures: Figures,
    *,
    drives: str = "position",
    speeds: bool = True,
    accelerometer: bool = True,
    plain: bool = False,
) -> str:
    """MJCF of the nominal arm, with position servos, with motors, or "" for no drives.

    `plain` has MuJoCo's usual integrator and time step, as a user's file has.
    """
    option = (
        'timestep="0.001" integrator="implicitfast"'
        if plain
        else f'timestep="{TIME_STEP:g}" integrator="RK4"'
    )
    lines = [
        '<mujoco model="arm">',
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option {option} gravity="0 0 -9.81"/>',
        "  <worldbody>",
    ]
    indent = "    "
    for i, link in enumerate(figures.links):
        lines += [
            f'{indent}<body name="link{i + 1}" pos="{_text(link.offset)}">',
            f'{indent}  <inertial mass="{link.mass:.10g}" pos="{_text(link.com)}" '
            f'diaginertia="{_text(link.inertia)}"/>',
            f'{indent}  <joint name="joint{i + 1}" type="{link.kind}" axis="{_text(link.axis)}" '
            f'damping="{link.damping:.10g}" armature="{link.armature:.10g}"/>',
        ]
        indent += "  "
    lines.append(f'{indent}<site name="tool" pos="{_text(figures.links[-1].end)}"/>')
    for _ in figures.links:
        indent = indent[:-2]
        lines.append(f"{indent}</body>")
    lines.append("  </worldbody>")
    if drives:
        lines.append("  <actuator>")
        lines += [
            f'    <{drives} name="motor{i + 1}" joint="joint{i + 1}" '
            + f'kp="{link.kp:.10g}" kv="{link.kv:.10g}" ' * (drives == "position")
            + f'forcerange="{-link.limit:.10g} {link.limit:.10g}"/>'
            for i, link in enumerate(figures.links)
        ]
        lines.append("  </actuator>")
    lines.append("  <sensor>")
    for name in joint_names(figures):
        lines.append(f'    <jointpos name="{name}_pos" joint="{name}"/>')
        if speeds:
            lines.append(f'    <jointvel name="{name}_vel" joint="{name}"/>')
    if accelerometer:
        lines.append('    <accelerometer name="tool_acc" site="tool"/>')
    lines += ["  </sensor>", "</mujoco>", ""]
    return "\n".join(lines)
