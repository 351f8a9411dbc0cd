"""Sizing of VERA: joint loads over motions, drive torques, frequencies of links and stinger.

Joint loads come twice: in closed form for two links in the plane, and from MuJoCo's inverse
dynamics for any arm. A force at a joint is what the part on the base's side exerts on the part on
the tool's side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from loose_env.arms import BENDING_MODE_HZ, BLOCK_MASS, LINK2_MASS, LINK_LENGTH, Arm, vera
from loose_env.envs import INK, MEASURED, TRUTH
from loose_env.kinematics import carried_bodies
from loose_env.typing import Array
from scripts.charts import DASHED, Curve, Panel, chart, curve
from scripts.thesis.loose_joint import placed
from scripts.thesis.page import Rows, Section, printed, section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOTIONS = 200
"""Random motions in which the closed form is held against MuJoCo."""
STEEL = 7850.0
"""Density of the stinger's rod, which the thesis does not print [kg/m³]."""
SQUARE_INCH = 0.0254**2
"""One square inch [m²]."""
_ANGLES, _RATES = 181, 41


class TwoLinks(NamedTuple):
    """Two rigid links in a horizontal plane (6.2-6.5); centres of mass lie on the links."""

    length: float
    """From joint 1 to joint 2, l1 [m]."""
    masses: Sequence[float]
    """Of either link, m1 and m2 [kg]."""
    centres: Sequence[float]
    """From a link's own joint to its centre of mass, lc1 and lc2 [m]."""
    inertias: Sequence[float]
    """About the centres of mass, I1 and I2 [kg m²]."""
    rotors: Sequence[float] = (0.0, 0.0)
    """Inertia of each drive's rotor seen at its joint [kg m²]; the thesis has none."""


def two_links(arm: Arm) -> TwoLinks:
    """Lump the bodies of a planar arm of two hinges into two links; bending modes at rest."""
    model, data = arm.model, placed(arm, [0.0, 0.0])
    joints = [model.joint(name) for name in arm.joints]
    anchors = data.xanchor[[j.id for j in joints]]
    outer = [carried_bodies(model, int(j.bodyid[0])) for j in joints]
    masses, centres, inertias = [], [], []
    for k, bodies in enumerate((outer[0] & ~outer[1], outer[1])):
        mass = model.body_mass[bodies]
        middle = mass @ data.xipos[bodies] / mass.sum()
        turned = data.ximat[bodies].reshape(-1, 3, 3)[:, 2, :]  # z row: inertia about z
        own = np.einsum("bi,bi->b", turned**2, model.body_inertia[bodies])
        about = own + mass * np.sum((data.xipos[bodies] - middle)[:, :2] ** 2, axis=1)
        masses.append(float(mass.sum()))
        centres.append(float(middle[0] - anchors[k, 0]))
        inertias.append(float(about.sum()))
    rotors = [float(model.dof_armature[j.dofadr[0]]) for j in joints]
    return TwoLinks(float(anchors[1, 0] - anchors[0, 0]), masses, centres, inertias, rotors)


class JointLoads(NamedTuple):
    """Joint loads in the frame of the link each joint moves: x along it, z up."""

    torque: Array
    """Torque of each drive [N m], or force where the joint slides [N] (..., n)."""
    force: Array
    """Force at each joint [N] (..., n, 3)."""
    moment: Array
    """Moment about each joint's anchor, without the rotors' share [N m] (..., n, 3)."""


def two_link_loads(
    links: TwoLinks,
    angle: ArrayLike,
    rates: ArrayLike,
    accelerations: ArrayLike,
    *,
    gravity: float = 9.81,
) -> JointLoads:
    """Loads of two links in closed form (6.2-6.5; their torques are 3.41), gravity along -z.

    The thesis prints I1 + m2 lc1² in (6.2) and (3.41): it is I1 + m1 lc1², as here. In (3.41) it
    prints the bracket after S2 again after C2: the one after C2 is lc2 θ12'' + S2 l1 θ1'² +
    C2 l1 θ1'', as (6.5) has it. ``angle`` (...) is that of joint 2, zero with the arm straight;
    ``rates`` and ``accelerations`` (..., 2) are those of both joints; all three broadcast.
    """
    q, v, a = (np.asarray(x, dtype=float) for x in (angle, rates, accelerations))
    q, v1, v2, a1, a2 = np.broadcast_arrays(q, v[..., 0], v[..., 1], a[..., 0], a[..., 1])
    (m1, m2), (c1, c2), (i1, i2) = links.masses, links.centres, links.inertias
    l1, s, c = links.length, np.sin(q), np.cos(q)
    v12, a12, weight = v1 + v2, a1 + a2, np.full(q.shape, gravity)
    # (6.5)
    x2 = m2 * (-c2 * v12**2 - c * l1 * v1**2 + s * l1 * a1)
    y2 = m2 * (c2 * a12 + s * l1 * v1**2 + c * l1 * a1)
    # (6.3)
    n2 = c2 * m2 * (c2 * a12 + l1 * (s * v1**2 + c * a1)) + i2 * a12
    # (6.4)
    x1 = -m1 * c1 * v1**2 - m2 * (c2 * (c * v12**2 + s * a12) + l1 * v1**2)
    y1 = m1 * c1 * a1 + m2 * (c2 * (-s * v12**2 + c * a12) + l1 * a1)
    # (6.2)
    n1 = (i1 + m1 * c1**2) * a1 + l1 * (s * x2 + c * y2) + n2
    moment = [
        [s * m2 * c2 * weight, -(m1 * c1 + m2 * l1 + c * m2 * c2) * weight, n1],
        [np.zeros(q.shape), -c2 * m2 * weight, n2],
    ]
    force = [[x1, y1, (m1 + m2) * weight], [x2, y2, m2 * weight]]
    torque = [n1 + links.rotors[0] * a1, n2 + links.rotors[1] * a2]
    return JointLoads(
        torque=np.moveaxis(np.array(torque), 0, -1),
        force=np.moveaxis(np.array(force), (0, 1), (-2, -1)),
        moment=np.moveaxis(np.array(moment), (0, 1), (-2, -1)),
    )


def arm_loads(arm: Arm, pose: Array, rates: Array, accelerations: Array) -> JointLoads:
    """Loads of any arm in one pose and motion: (3.11), MuJoCo's inverse dynamics.

    Bending modes are at rest. Friction and springs of the joints are left out, as in 6.1.2.
    """
    model = arm.model
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in arm.joints]
    dofs = [int(j.dofadr[0]) for j in joints]
    data.qpos[arm.pose_addresses], data.qvel[dofs], data.qacc[dofs] = pose, rates, accelerations
    mujoco.mj_inverse(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    force, moment, torque = np.zeros((arm.n, 3)), np.zeros((arm.n, 3)), np.zeros(arm.n)
    for k, joint in enumerate(joints):
        body = int(joint.bodyid[0])
        # MuJoCo's wrench is about the centre of mass of the whole tree, in world axes.
        lever = data.xanchor[joint.id] - data.subtree_com[model.body_rootid[body]]
        push = data.cfrc_int[body, 3:]
        turn = data.cfrc_int[body, :3] - np.cross(lever, push)
        slides = joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
        own = model.dof_armature[dofs[k]] * accelerations[k]
        torque[k] = data.xaxis[joint.id] @ (push if slides else turn) + own
        frame = data.xmat[body].reshape(3, 3)
        force[k], moment[k] = push @ frame, turn @ frame
    return JointLoads(torque=torque, force=force, moment=moment)


def peak_force(force: Array, angles: Array) -> tuple[float, str, float]:
    """Maximum planar force [N] over a sweep (..., 3), the first of equal peaks (5.2).

    With it its larger component, and the angle of joint 2 there [deg].
    """
    size = np.hypot(force[..., 0], force[..., 1])
    where = np.unravel_index(np.argmax(size >= size.max() * (1 - 1e-12)), size.shape)
    along, across = np.abs(force[where][:2])
    kind = "longitudinal" if along >= across else "tangential"
    return float(size[where]), kind, float(np.broadcast_to(angles, size.shape)[where])


# Frequencies of VERA's links and of the stinger (6.1.2, 6.3.2).


def beam_frequency(
    *, modulus: float, second_moment: float, length: float, end_mass: float, beam_mass: float
) -> float:
    """First bending frequency of a clamped beam with a mass at its free end [Hz] (6.6).

    Rayleigh's estimate, a little too high: by 2.7 % without an end mass, by 0.12 % for link 1.
    """
    mass = end_mass + 0.23 * beam_mass
    return math.sqrt(3 * modulus * second_moment / (length**3 * mass)) / (2 * math.pi)


def rod_stiffness(*, area: float, modulus: float, length: float) -> float:
    """Stiffness of a rod pulled along its axis [N/m] (6.12)."""
    return area * modulus / length


def stinger_frequency(*, stiffness: float, mass: float, rod_mass: float) -> float:
    """First longitudinal frequency of a mass on a rod held at its other end [Hz] (6.11)."""
    return math.sqrt(stiffness / (mass + rod_mass / 3)) / (2 * math.pi)


def rod_area(
    *, frequency: float, modulus: float, length: float, mass: float, density: float
) -> float:
    """Section of the rod with which (6.11) and (6.12) give a frequency [m²]."""
    squared = (2 * math.pi * frequency) ** 2
    return squared * mass / (modulus / length - squared * density * length / 3)


def demand(
    links: TwoLinks, told: dict[str, Any], rate: float, accelerations: Sequence[float]
) -> tuple[Array, Array, JointLoads]:
    """Sweep joint 2 over its angles (K, 1) and rates (1, R) in one motion of joint 1 (6.1.2)."""
    limit, top = math.radians(told["theta2_limit_deg"]), told["theta2_rate_limit_rad_per_s"]
    angles = np.linspace(-limit, limit, _ANGLES)[:, None]
    rates = np.linspace(-top, top, _RATES)[None]
    both = np.stack(np.broadcast_arrays(np.full_like(angles, rate), rates), axis=-1)
    return angles, rates, two_link_loads(links, angles, both, np.array(accelerations))


def sizing(seed: int) -> Section:
    """Size VERA as section 6.1.2 does and find where its joint forces peak (5.2, 7.2.2)."""
    told, arm = printed("sizing"), vera()
    links, limits = two_links(arm), arm.torque_limits
    cases = [
        (rate, acc)
        for rate in told["theta1_rate_rad_per_s"]
        for acc in told["varied_acceleration_rad_per_s2"]
    ]
    torque_rows, force_rows, sweeps, peaks = [], [], {}, []
    highest = [(0.0, 0.0, 0.0)] * 2
    for rate, acc in cases:
        angles, rates, loads = demand(links, told, rate, (acc, 0.0))
        degrees = np.degrees(angles)
        cells = [f"{rate:g} rad/s, {acc:g} rad/s²"]
        for k in (0, 1):
            size = np.abs(loads.torque[..., k])
            i, j = np.unravel_index(int(size.argmax()), size.shape)
            found = (float(size[i, j]), float(degrees[i, 0]), float(rates[0, j]))
            highest[k] = max(highest[k], found)
            within = 100 * float((size <= limits[k]).mean())
            cells += [f"{found[0]:.2f}", f"{found[1]:.0f}°, {found[2]:+.0f}", f"{within:.0f} %"]
        torque_rows.append(cells)
        ends = (loads.force[..., 0, :], loads.force[..., 1, :], _in_link_1(loads.force, angles))
        peaks.append([peak_force(force, degrees) for force in ends])
        words = (f"{size:.1f} N, {kind}, {angle:.0f}°" for size, kind, angle in peaks[-1])
        force_rows.append((cells[0], *words))
        sweeps[f"θ₁' = {rate:g} rad/s, θ₁'' = {acc:g} rad/s²"] = loads

    def count(which: Callable[[float], bool], k: int, kind: str) -> int:
        own = (p for (rate, _), p in zip(cases, peaks, strict=True) if which(rate))
        return sum(p[k][1] == kind for p in own)

    slow = [count(lambda rate: rate < 1, k, "tangential") for k in (0, 2)]
    fast = [count(lambda rate: rate >= 1, k, "longitudinal") for k in (0, 1)]
    top = max(peaks, key=lambda p: p[0])
    reading_rows, tips, fits = _readings(links, told, limits, cases)
    error, rate_limit = _closed_form_error(arm, links, seed), told["theta2_rate_limit_rad_per_s"]
    return section(
        "sizing",
        locals() | structures(told),
        [torque_rows, reading_rows, force_rows],
        [torque_figure(sweeps, limits, rate_limit), force_figure(sweeps)],
    )


def _closed_form_error(arm: Arm, links: TwoLinks, seed: int) -> float:
    """Largest difference of closed form and MuJoCo over the largest load, in random motions."""
    rng, worst = np.random.default_rng([seed, 0]), 0.0
    for pose, rate, acc in rng.uniform(-1, 1, (MOTIONS, 3, 2)) * [[[np.pi], [5.0], [10.0]]]:
        closed = two_link_loads(links, pose[1], rate, acc)
        for a, b in zip(closed, arm_loads(arm, pose, rate, acc), strict=True):
            worst = max(worst, float(np.abs(a - b).max() / np.abs(b).max()))
    return worst


def _in_link_1(force: Array, angle: Array) -> Array:
    """Force at joint 2, given in link 2's axes, in link 1's."""
    c, s, x, y = np.cos(angle), np.sin(angle), force[..., 1, 0], force[..., 1, 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _readings(
    links: TwoLinks,
    told: dict[str, Any],
    limits: Sequence[float],
    cases: Sequence[tuple[float, float]],
) -> tuple[Rows, list[float], list[int]]:
    """The printed text gives the varied acceleration to joint 2 and also fixes it, twice.

    Returns for each reading its row, the tip's tangential acceleration with the arm straight
    [m/s²], and the cases within the drives' torque.
    """
    one, none = told["fixed_theta2_acceleration_rad_per_s2"]
    readings: dict[str, Callable[[float], tuple[float, float]]] = {
        f"θ₁'' varied, θ₂'' = {none:g}": lambda a: (a, none),
        f"θ₁'' varied, θ₂'' = {one:g}": lambda a: (a, one),
        "θ₂'' varied, θ₁'' = 0": lambda a: (0.0, a),
    }
    largest = max(told["varied_acceleration_rad_per_s2"])
    rows: list[Sequence[str]] = [("reading", "tip", *(f"{rate:g}, {acc:g}" for rate, acc in cases))]
    tips, fits = [], []
    for name, accelerations in readings.items():
        peaks = [
            np.abs(demand(links, told, rate, accelerations(acc))[2].torque).max(axis=(0, 1))
            for rate, acc in cases
        ]
        a1, a2 = accelerations(largest)
        tips.append(LINK_LENGTH * (2 * a1 + a2))
        fits.append(sum(bool((p <= limits).all()) for p in peaks))
        rows.append((name, f"{tips[-1]:.1f}", *(f"{p[0]:.1f} / {p[1]:.1f}" for p in peaks)))
    return rows, tips, fits


def structures(told: dict[str, Any]) -> dict[str, float]:
    """Frequencies of links and stinger [Hz], and areas of its rod [in²], from the printed data."""
    one, rod = told["link_1"], told["stinger"]
    beam = {
        "second_moment": one["second_moment_m4"],
        "length": one["length_m"],
        "end_mass": one["end_mass_kg"],
        "beam_mass": one["beam_mass_kg"],
    }
    # (6.6) is proportional to the root of the modulus.
    modulus = (one["frequency_rad_per_s"] / (2 * math.pi) / beam_frequency(modulus=1, **beam)) ** 2
    first = beam_frequency(modulus=modulus, **beam)
    second = {"length": LINK_LENGTH, "end_mass": BLOCK_MASS, "beam_mass": LINK2_MASS}
    other = beam_frequency(modulus=modulus, **{**beam, **second})
    bar = {"modulus": rod["modulus_pa"], "length": rod["length_m"]}

    def stinger(area: float) -> float:
        rod_mass = STEEL * area * rod["length_m"]
        stiffness = rod_stiffness(area=area, **bar)
        return stinger_frequency(stiffness=stiffness, mass=rod["slide_mass_kg"], rod_mass=rod_mass)

    def area(frequency: float) -> float:
        mass = rod["slide_mass_kg"]
        return rod_area(frequency=frequency, mass=mass, density=STEEL, **bar) / SQUARE_INCH

    return {
        "first": first,
        "simulated": BENDING_MODE_HZ,
        "modulus_gpa": modulus / 1e9,
        "other": other,
        "inches": stinger(rod["area"] * SQUARE_INCH),
        "as_printed": stinger(rod["area"]),
        "of_printed": area(rod["frequency_hz"]),
        "of_measured": area(rod["measured_hz"]),
        "smaller": 1 - area(rod["measured_hz"]) / rod["area"],
    }


def torque_figure(
    sweeps: Mapping[str, JointLoads], limits: Sequence[float], top_rate: float
) -> Figure:
    """Draw torques at lowest, no and highest rate of joint 2, between those of all rates."""
    words = (f"θ₂' = −{top_rate:g} rad/s", "0", f"+{top_rate:g} rad/s")
    styles: Sequence[Any] = ((0, (1.4, 1.3)), (0, (5, 1.6)), "-")

    def curves(angles: Array, loads: JointLoads, k: int) -> list[Curve]:
        torque = loads.torque[..., k]
        ends = [torque.min(axis=1), torque.max(axis=1)]
        found = [
            curve(angles, limit * np.ones_like(angles), "drive", color=TRUTH, linestyle=DASHED)
            for limit in (-limits[k], limits[k])
        ]
        for which, style, name in zip((0, _RATES // 2, -1), styles, words, strict=True):
            middle = torque[:, which]
            y = np.array([middle, *ends]) if which else middle
            found.append(curve(angles, y, name, color=MEASURED, linestyle=style))
        return found

    return _grid(sweeps, curves, [f"torque {k} [N·m]" for k in (1, 2)])


def force_figure(sweeps: Mapping[str, JointLoads]) -> Figure:
    """Draw the greatest forces at both joints, along and across the link each moves."""
    looks = (("along the link", INK, "-"), ("across it", MEASURED, (0, (5, 1.6))))

    def curves(angles: Array, loads: JointLoads, k: int) -> list[Curve]:
        force = np.abs(loads.force[:, :, k, :2]).max(axis=1)
        return [
            curve(angles, part, name, color=colour, linestyle=style)
            for part, (name, colour, style) in zip(force.T, looks, strict=True)
        ]

    return _grid(sweeps, curves, [f"greatest force {k} [N]" for k in (1, 2)])


def _grid(
    sweeps: Mapping[str, JointLoads],
    curves: Callable[[Array, JointLoads, int], list[Curve]],
    up: Sequence[str],
) -> Figure:
    """A row a case, a column a joint."""
    angles = np.linspace(-90, 90, _ANGLES)
    panels = [
        Panel(
            title=name if k == 0 else "",
            up=up[k],
            curves=curves(angles, loads, k),
            look={"xticks": [-90, -45, 0, 45, 90]},
        )
        for name, loads in sweeps.items()
        for k in (0, 1)
    ]
    return chart(panels, across="θ₂ [°]", columns=2, height=1.5, sharey="col")
