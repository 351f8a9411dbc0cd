"""Nominal arms of the gap suite: parameters of six serial arms, and their MJCF."""

from __future__ import annotations

import dataclasses

import numpy as np

from loose_env.typing import Array

GRAVITY = 9.81
"""Acceleration of free fall [m/s²]; the world's z axis points up."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Link:
    """A joint, the rigid body it moves and the drive of the joint."""

    kind: str = "hinge"
    """`hinge` or `slide`."""
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Axis of the joint, a unit vector in the link's frame."""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the link's frame in the frame of the link before [m]."""
    end: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Distal end of the link, in its own frame [m]."""
    mass: float
    """Mass [kg]."""
    com: tuple[float, float, float]
    """Centre of mass in the link's frame [m]."""
    inertia: tuple[float, float, float]
    """Moments of inertia about the centre of mass, along the link's frame [kg m²]."""
    armature: float
    """Inertia of the rotor, seen at the joint [kg m²; slide: kg]."""
    damping: float
    """Viscous damping of the joint [N m s/rad; slide: N s/m]."""
    kp: float
    """Position gain of the servo [N m/rad; slide: N/m]."""
    kv: float
    """Velocity gain of the servo [N m s/rad; slide: N s/m]."""
    limit: float
    """Largest torque of the servo [N m; slide: N]."""
    home: float
    """Middle of the joint's range of motion [rad; slide: m]."""
    reach: float
    """Half of the joint's range of motion [rad; slide: m]."""

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


def rod(mass: float, length: float, radius: float) -> tuple[float, float, float]:
    """Moments of inertia of a round bar along x about its middle [kg m²]."""
    across = mass * (length**2 / 12 + radius**2 / 4)
    return (mass * radius**2 / 2, across, across)


def _bar(mass: float, length: float, radius: float, **rest: object) -> Link:
    """A link along its x axis with its mass around the middle."""
    return Link(
        mass=mass,
        com=(0.48 * length, 0.0, 0.0),
        inertia=rod(mass, length, radius),
        end=(length, 0.0, 0.0),
        **rest,  # type: ignore[arg-type]
    )


def planar3() -> Figures:
    """Three hinges in a vertical plane."""
    return Figures(
        name="planar3",
        links=(
            _bar(4.0, 0.40, 0.05, armature=0.40, damping=3.0, kp=4000.0, kv=160.0, limit=160.0,
                 home=-0.6, reach=0.6),
            _bar(2.5, 0.35, 0.04, offset=(0.40, 0.0, 0.0), armature=0.18, damping=1.5, kp=2000.0,
                 kv=70.0, limit=80.0, home=0.9, reach=0.7),
            _bar(1.4, 0.25, 0.03, offset=(0.35, 0.0, 0.0), armature=0.05, damping=0.5, kp=500.0,
                 kv=14.0, limit=25.0, home=0.4, reach=0.9),
        ),
        hanging=(np.pi / 2, 0.0, 0.0),
    )  # fmt: skip


def spatial3() -> Figures:
    """Waist, shoulder and elbow."""
    return Figures(
        name="spatial3",
        links=(
            Link(axis=(0.0, 0.0, 1.0), offset=(0.0, 0.0, 0.3), end=(0.0, 0.0, 0.12), mass=6.0,
                 com=(0.01, 0.0, 0.05), inertia=(0.035, 0.035, 0.028), armature=0.35, damping=2.5,
                 kp=3500.0, kv=140.0, limit=140.0, home=0.0, reach=0.9),
            _bar(3.2, 0.42, 0.05, offset=(0.0, 0.0, 0.12), armature=0.30, damping=2.0, kp=3500.0,
                 kv=130.0, limit=140.0, home=-0.7, reach=0.5),
            _bar(1.8, 0.38, 0.035, offset=(0.42, 0.0, 0.0), armature=0.10, damping=0.8, kp=1200.0,
                 kv=40.0, limit=50.0, home=1.0, reach=0.7),
        ),
        hanging=(0.0, np.pi / 2, 0.0),
    )  # fmt: skip


def scara4() -> Figures:
    """Two hinges about the vertical, a vertical slide and a turning wrist."""
    up = (0.0, 0.0, 1.0)
    return Figures(
        name="scara4",
        links=(
            _bar(5.0, 0.35, 0.06, axis=up, offset=(0.0, 0.0, 0.4), armature=0.30, damping=2.0,
                 kp=3000.0, kv=110.0, limit=100.0, home=0.2, reach=0.9),
            _bar(3.0, 0.30, 0.05, axis=up, offset=(0.35, 0.0, 0.0), armature=0.12, damping=1.0,
                 kp=1200.0, kv=40.0, limit=50.0, home=0.7, reach=0.9),
            Link(kind="slide", axis=up, offset=(0.30, 0.0, 0.0), end=(0.0, 0.0, -0.2), mass=1.5,
                 com=(0.01, 0.0, -0.1), inertia=(0.006, 0.006, 0.001), armature=2.0, damping=30.0,
                 kp=12000.0, kv=350.0, limit=180.0, home=0.05, reach=0.08),
            Link(axis=up, offset=(0.0, 0.0, -0.2), end=(0.10, 0.0, -0.05), mass=0.8,
                 com=(0.04, 0.01, -0.02), inertia=(0.0008, 0.0015, 0.0016), armature=0.02,
                 damping=0.15, kp=80.0, kv=2.2, limit=8.0, home=0.0, reach=1.4),
        ),
    )  # fmt: skip


def elbow4() -> Figures:
    """Waist, shoulder, elbow and a pitching wrist."""
    return Figures(
        name="elbow4",
        links=(
            Link(axis=(0.0, 0.0, 1.0), offset=(0.0, 0.0, 0.25), end=(0.0, 0.0, 0.10), mass=5.0,
                 com=(0.0, 0.01, 0.04), inertia=(0.03, 0.03, 0.02), armature=0.30, damping=2.0,
                 kp=3000.0, kv=120.0, limit=120.0, home=0.1, reach=0.8),
            _bar(3.0, 0.36, 0.05, offset=(0.0, 0.0, 0.10), armature=0.28, damping=1.8, kp=3200.0,
                 kv=120.0, limit=130.0, home=-0.8, reach=0.5),
            _bar(1.8, 0.32, 0.04, offset=(0.36, 0.0, 0.0), armature=0.12, damping=0.8, kp=1200.0,
                 kv=40.0, limit=50.0, home=1.1, reach=0.6),
            _bar(0.9, 0.16, 0.03, offset=(0.32, 0.0, 0.0), armature=0.03, damping=0.25, kp=250.0,
                 kv=6.0, limit=15.0, home=0.2, reach=0.9),
        ),
    )  # fmt: skip


def upright6() -> Figures:
    """Waist, shoulder, elbow and a wrist of three axes."""
    return Figures(
        name="upright6",
        links=(
            Link(axis=(0.0, 0.0, 1.0), offset=(0.0, 0.0, 0.3), end=(0.0, 0.0, 0.12), mass=6.5,
                 com=(0.0, 0.01, 0.05), inertia=(0.04, 0.04, 0.03), armature=0.45, damping=3.0,
                 kp=4000.0, kv=170.0, limit=160.0, home=0.0, reach=0.8),
            _bar(4.0, 0.40, 0.05, offset=(0.0, 0.0, 0.12), armature=0.45, damping=2.5, kp=4500.0,
                 kv=180.0, limit=180.0, home=-0.8, reach=0.45),
            _bar(2.6, 0.34, 0.04, offset=(0.40, 0.0, 0.0), armature=0.20, damping=1.2, kp=2000.0,
                 kv=75.0, limit=90.0, home=1.1, reach=0.55),
            Link(axis=(1.0, 0.0, 0.0), offset=(0.34, 0.0, 0.0), end=(0.10, 0.0, 0.0), mass=1.1,
                 com=(0.05, 0.0, 0.005), inertia=(0.002, 0.003, 0.003), armature=0.04, damping=0.3,
                 kp=300.0, kv=8.0, limit=20.0, home=0.1, reach=1.2),
            _bar(0.8, 0.12, 0.03, offset=(0.10, 0.0, 0.0), armature=0.03, damping=0.25, kp=220.0,
                 kv=6.0, limit=15.0, home=0.5, reach=0.9),
            Link(axis=(1.0, 0.0, 0.0), offset=(0.12, 0.0, 0.0), end=(0.06, 0.0, 0.03), mass=0.4,
                 com=(0.03, 0.01, 0.02), inertia=(0.0005, 0.0006, 0.0006), armature=0.012,
                 damping=0.08, kp=60.0, kv=1.6, limit=6.0, home=0.0, reach=1.4),
        ),
    )  # fmt: skip


def redundant7() -> Figures:
    """Seven hinges that turn and bend in turn."""
    along, across = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    rows = (
        # axis, length, mass, armature, damping, kp, kv, limit, home, reach
        (across, 0.26, 3.6, 0.45, 2.5, 4200.0, 170.0, 170.0, -0.9, 0.4),
        (along, 0.18, 2.4, 0.25, 1.4, 1500.0, 55.0, 90.0, 0.1, 0.8),
        (across, 0.22, 2.2, 0.22, 1.3, 1900.0, 70.0, 90.0, 1.0, 0.5),
        (along, 0.16, 1.4, 0.08, 0.6, 600.0, 18.0, 40.0, 0.0, 1.0),
        (across, 0.12, 1.1, 0.05, 0.4, 400.0, 11.0, 25.0, 0.6, 0.8),
        (along, 0.08, 0.5, 0.015, 0.1, 80.0, 2.2, 8.0, 0.0, 1.3),
    )
    links = [
        Link(axis=(0.0, 0.0, 1.0), offset=(0.0, 0.0, 0.3), end=(0.0, 0.0, 0.12), mass=5.5,
             com=(0.01, 0.0, 0.05), inertia=(0.035, 0.035, 0.025), armature=0.4, damping=2.6,
             kp=3600.0, kv=150.0, limit=150.0, home=0.1, reach=0.8)
    ]  # fmt: skip
    offset = (0.0, 0.0, 0.12)
    for axis, length, mass, armature, damping, kp, kv, limit, home, reach in rows:
        links.append(
            _bar(mass, length, 0.035, axis=axis, offset=offset, armature=armature, damping=damping,
                 kp=kp, kv=kv, limit=limit, home=home, reach=reach)
        )  # fmt: skip
        offset = (length, 0.0, 0.0)
    # the last axis is the bar's own, on which a tool that is off it turns
    last = dataclasses.replace(links[-1], com=(0.03, 0.012, 0.01), end=(0.06, 0.02, 0.02))
    return Figures(name="redundant7", links=(*links[:-1], last))


def rig1() -> Figures:
    """A bar on one motor, under gravity."""
    return Figures(
        name="rig1",
        links=(
            _bar(1.2, 0.35, 0.02, armature=0.02, damping=0.1, kp=160.0, kv=6.0, limit=12.0,
                 home=0.4, reach=1.2),
        ),
        hanging=(np.pi / 2,),
    )  # fmt: skip


def turntable1() -> Figures:
    """A load on one motor with an upright axis."""
    return Figures(
        name="turntable1",
        links=(
            _bar(3.0, 0.30, 0.06, axis=(0.0, 0.0, 1.0), offset=(0.0, 0.0, 0.2), armature=0.15,
                 damping=0.6, kp=700.0, kv=26.0, limit=40.0, home=0.0, reach=1.5),
        ),
    )  # fmt: skip


def planar2() -> Figures:
    """Two hinges in a vertical plane, of hobby size."""
    return Figures(
        name="planar2",
        links=(
            _bar(0.35, 0.18, 0.02, armature=0.012, damping=0.06, kp=40.0, kv=1.4, limit=6.0,
                 home=-0.5, reach=0.8),
            _bar(0.22, 0.15, 0.015, offset=(0.18, 0.0, 0.0), armature=0.006, damping=0.03,
                 kp=16.0, kv=0.5, limit=3.0, home=0.8, reach=0.9),
        ),
        hanging=(np.pi / 2, 0.0),
    )  # fmt: skip


def gantry3() -> Figures:
    """Three slides, the last one upright."""
    return Figures(
        name="gantry3",
        links=(
            Link(kind="slide", axis=(1.0, 0.0, 0.0), offset=(0.0, 0.0, 1.0), end=(0.1, 0.0, 0.0),
                 mass=22.0, com=(0.02, 0.05, 0.0), inertia=(1.2, 0.4, 1.4), armature=12.0,
                 damping=90.0, kp=60000.0, kv=2400.0, limit=900.0, home=0.2, reach=0.30),
            Link(kind="slide", axis=(0.0, 1.0, 0.0), offset=(0.1, 0.0, 0.0), end=(0.0, 0.0, -0.1),
                 mass=9.0, com=(0.0, 0.02, 0.03), inertia=(0.12, 0.10, 0.10), armature=6.0,
                 damping=50.0, kp=32000.0, kv=1200.0, limit=450.0, home=0.1, reach=0.25),
            Link(kind="slide", axis=(0.0, 0.0, 1.0), offset=(0.0, 0.0, -0.1), end=(0.0, 0.0, -0.3),
                 mass=4.0, com=(0.01, 0.0, -0.12), inertia=(0.04, 0.04, 0.01), armature=4.0,
                 damping=60.0, kp=22000.0, kv=800.0, limit=320.0, home=0.05, reach=0.12),
        ),
    )  # fmt: skip


def leg3() -> Figures:
    """Hip, thigh and calf of a leg whose body is held."""
    return Figures(
        name="leg3",
        links=(
            Link(axis=(1.0, 0.0, 0.0), offset=(0.0, 0.0, 0.6), end=(0.0, 0.085, 0.0), mass=0.70,
                 com=(-0.005, 0.01, 0.0), inertia=(0.0005, 0.0008, 0.0006), armature=0.011,
                 damping=0.08, kp=60.0, kv=2.0, limit=24.0, home=0.0, reach=0.5),
            Link(offset=(0.0, 0.085, 0.0), end=(0.0, 0.0, -0.213), mass=1.15,
                 com=(-0.004, -0.02, -0.03), inertia=(0.006, 0.006, 0.001), armature=0.011,
                 damping=0.08, kp=60.0, kv=2.0, limit=24.0, home=0.7, reach=0.7),
            Link(offset=(0.0, 0.0, -0.213), end=(0.0, 0.0, -0.213), mass=0.16,
                 com=(0.006, 0.0, -0.12), inertia=(0.0014, 0.0014, 0.00003), armature=0.025,
                 damping=0.1, kp=60.0, kv=2.0, limit=40.0, home=-1.4, reach=0.6),
        ),
        hanging=(0.0, 0.0, 0.0),
    )  # fmt: skip


MACHINES = {
    make.__name__: make
    for make in (rig1, turntable1, planar2, planar3, spatial3, gantry3, leg3, scara4, elbow4,
                 upright6, redundant7)
}  # fmt: skip
"""Makers of the nominal machines by name."""
ARMS = {name: MACHINES[name] for name in ("planar3", "spatial3", "scara4", "elbow4")}
"""Those on which parts rattle."""


def varied(figures: Figures, rng: np.random.Generator) -> Figures:
    """A machine of other lengths, masses and stiffness, with the same shape."""
    long, heavy, stiff = np.exp(rng.uniform(np.log(0.8), np.log(1.25), 3))
    weight, turn = heavy * long, heavy * long**2
    links = []
    for link in figures.links:
        slide = link.kind == "slide"
        inert = heavy if slide else turn
        links.append(
            dataclasses.replace(
                link, mass=heavy * link.mass,
                offset=tuple(long * x for x in link.offset), end=tuple(long * x for x in link.end),
                com=tuple(long * x for x in link.com),
                inertia=tuple(turn * x for x in link.inertia),
                armature=inert * link.armature, damping=inert * link.damping,
                kp=inert * stiff**2 * link.kp, kv=inert * stiff * link.kv,
                limit=(heavy if slide else max(weight, turn)) * link.limit,
                reach=(long if slide else 1.0) * link.reach,
                home=(long if slide else 1.0) * link.home,
            )
        )  # fmt: skip
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
