"""Chapters 5.2 and 6.1.2: sizing VERA's drives and links, and where its joints are loaded most."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from loose_env.arms import LINK_LENGTH, vera
from loose_env.report import FigureCard
from loose_env.thesis.ch6_experiments.arm.sizing_figures import (
    CaseCurves,
    force_figure,
    torque_figure,
)
from loose_env.thesis.ch6_experiments.arm.structures import structures
from loose_env.thesis.methods.motion.joint_loads import (
    JointLoads,
    PeakForce,
    TwoLinks,
    arm_loads,
    peak_force,
    two_link_loads,
)
from loose_env.thesis.printed import printed
from loose_env.thesis.shared.sections import Section, Table
from loose_env.typing import Array

EQUATIONS: dict[str, str] = {
    "3.41": "loose_env.thesis.methods.motion.joint_loads.two_link_loads",
    "6.1": "loose_env.thesis.methods.motion.loose_planar_arm.tool_position",
    "6.2": "loose_env.thesis.methods.motion.joint_loads.two_link_loads",
    "6.3": "loose_env.thesis.methods.motion.joint_loads.two_link_loads",
    "6.4": "loose_env.thesis.methods.motion.joint_loads.two_link_loads",
    "6.5": "loose_env.thesis.methods.motion.joint_loads.two_link_loads",
    "6.6": "loose_env.thesis.ch6_experiments.arm.structures.beam_frequency",
    "6.11": "loose_env.thesis.ch6_experiments.arm.structures.stinger_frequency",
    "6.12": "loose_env.thesis.ch6_experiments.arm.structures.rod_stiffness",
}
"""Function of each equation."""

MOTIONS = 200
"""Random motions in which the closed form is held against MuJoCo."""
_ANGLES = 181
_RATES = 41


def demand(
    links: TwoLinks, told: dict[str, Any], rate: float, accelerations: tuple[float, float]
) -> tuple[Array, Array, JointLoads]:
    """Sweep joint 2 over its angles and rates in one motion of joint 1 (6.1.2).

    ``told``: printed limits of angle and rate of joint 2. ``rate``: of joint 1 [rad/s].
    ``accelerations``: of both joints [rad/s²]. Returns angles [rad] (K, 1), rates of joint 2
    [rad/s] (1, R), loads of shape (K, R, ...).
    """
    limit = math.radians(told["theta2_limit_deg"])
    angles = np.linspace(-limit, limit, _ANGLES)[:, None]
    top = told["theta2_rate_limit_rad_per_s"]
    rates = np.linspace(-top, top, _RATES)[None]
    both = np.stack(np.broadcast_arrays(np.full_like(angles, rate), rates), axis=-1)
    return angles, rates, two_link_loads(links, angles, both, np.array(accelerations))


def section(seed: int) -> Section:
    """Size VERA as section 6.1.2 does and find where its joint forces peak (5.2, 7.2.2).

    Examples
    --------
    >>> from loose_env.thesis.printed import printed
    >>> printed("sizing")["link_1"]["frequency_hz"]
    83.0
    """
    told = printed("sizing")
    arm = vera()
    links = TwoLinks.of(arm)
    limits = arm.torque_limits
    cases = [
        (rate, acc)
        for rate in told["theta1_rate_rad_per_s"]
        for acc in told["varied_acceleration_rad_per_s2"]
    ]
    torque_table, force_table, curves, words = _cases(links, told, limits, cases)
    readings_table, readings_words = _readings(links, told, limits, cases)
    structure_table, structure_words = structures(told)
    gap = _closed_form_error(seed)
    top = told["theta2_rate_limit_rad_per_s"]
    peaks = [max(float(np.abs(c.reach[..., k]).max()) for c in curves) for k in (0, 1)]
    return Section(
        key="sizing",
        title="Sizing of the robot, and where its joints are loaded most (5.2, 6.1.2)",
        finding=(
            "Peak demand of the four cases "
            + " and ".join(f"{peak:.1f}" for peak in peaks)
            + " N·m, where the drives give "
            + " and ".join(f"{limit:g}" for limit in limits)
            + " N·m: "
            + (
                "the drives carry every case."
                if all(p <= m for p, m in zip(peaks, limits, strict=True))
                else "they do not carry every case over the whole sweep."
            )
        ),
        words=[
            "The equations of motion of two rigid links say what torque each drive must give and "
            "what force each joint carries. They are programmed in closed form, with the two slips "
            f"of (3.41) and (6.2) mended, and held against MuJoCo's inverse dynamics: over "
            f"{MOTIONS} random motions of VERA the two differ by at most {gap:.0e} of the largest "
            f"load. Lengths, drives and the masses of link 1 are the thesis's; joint 1's gear "
            f"wheel, the rotors and link 2 ({links.masses[1]:.2f} kg) are estimates, as the "
            "thesis does not print them.",
            *readings_words,
            *words,
            *structure_words,
        ],
        tables=[torque_table, readings_table, force_table, structure_table],
        cards=[
            FigureCard(
                image=torque_figure(curves, limits, top),
                title="Torque against the angle of joint 2",
                caption="Shaded: all rates of joint 2 between the two limits. Rows: rate and "
                "acceleration of joint 1; joint 2 does not accelerate, and its torque does not "
                "depend on its own rate (6.3). The same sweep as figures 6.7 and 6.8.",
                heading="Torque and force over the workspace",
            ),
            FigureCard(
                image=force_figure(curves),
                title="Joint force against the angle of joint 2",
                caption="Greatest force over all rates of joint 2, split into its part along the "
                "link that the joint moves and its part across it, in the plane.",
            ),
        ],
        equations=EQUATIONS,
        left_out=[
            "The values of figures 6.7 and 6.8 and of the preliminary parameters: the thesis gives "
            "the plots only, and no masses of link 2. Only their statements in words are compared.",
            "Bearings, gears, resolvers and the controller (6.1.2 to 6.1.4): hardware choices "
            "without a figure to compute.",
        ],
    )


def _closed_form_error(seed: int) -> float:
    arm = vera()
    links = TwoLinks.of(arm)
    rng = np.random.default_rng([seed, 0])
    worst = 0.0
    for pose, rate, acc in rng.uniform(-1, 1, (MOTIONS, 3, 2)) * [[[np.pi], [5.0], [10.0]]]:
        closed, simulated = (
            two_link_loads(links, pose[1], rate, acc),
            arm_loads(arm, pose, rate, acc),
        )
        for name in ("torque", "force", "moment"):
            a, b = getattr(closed, name), getattr(simulated, name)
            worst = max(worst, float(np.abs(a - b).max() / np.abs(b).max()))
    return worst


def _cases(
    links: TwoLinks,
    told: dict[str, Any],
    limits: tuple[float, ...],
    cases: list[tuple[float, float]],
) -> tuple[Table, Table, list[CaseCurves], list[str]]:
    torque_rows, force_rows, curves = [], [], []
    peaks: list[tuple[PeakForce, PeakForce, PeakForce]] = []
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
            within = float((size <= limits[k]).mean())
            cells += [
                f"{found[0]:.2f}",
                f"{found[1]:.0f}°, {found[2]:+.0f}",
                f"{100 * within:.0f} %",
            ]
        torque_rows.append(tuple(cells))
        own = [peak_force(loads.force[..., k, :], [degrees, rates]) for k in (0, 1)]
        end = peak_force(_in_link_1(loads.force[..., 1, :], angles), [degrees, rates])
        peaks.append((own[0], own[1], end))
        force_rows.append((cells[0], *(_force_cell(p) for p in peaks[-1])))
        middle = rates.shape[1] // 2
        curves.append(
            CaseCurves(
                name=f"θ₁' = {rate:g} rad/s, θ₁'' = {acc:g} rad/s²",
                angles=degrees[:, 0],
                torque=loads.torque[:, [0, middle, -1]],
                reach=np.stack([loads.torque.min(axis=1), loads.torque.max(axis=1)], axis=1),
                force=np.abs(loads.force[..., :2]).max(axis=1).transpose(0, 2, 1),
            )
        )
    torque_table = Table(
        caption="Peak torque [N·m] in the four cases of 6.1.2, read as accelerations of joint 1; "
        f"the drives give {limits[0]:g} and {limits[1]:g} N·m. 'At' is θ₂ and θ₂' [rad/s], "
        "'within' the share of the sweep inside the drive's torque.",
        columns=("θ₁', θ₁''", "joint 1", "at", "within", "joint 2", "at", "within"),
        rows=tuple(torque_rows),
    )
    force_table = Table(
        caption="Greatest joint force in the plane in the same cases: size, larger part, θ₂. The "
        "last column is the force at joint 2 seen from the distal end of link 1. Printed: "
        f"{told['highest_force_direction_5_2']} at the distal end of the proximal link (5.2), "
        f"{told['highest_force_direction_6_1_2']} on both links at θ₂ = "
        f"{told['highest_force_theta2_deg']:g}° (6.1.2).",
        columns=("θ₁', θ₁''", "joint 1", "joint 2", "distal end of link 1"),
        rows=tuple(force_rows),
    )
    return torque_table, force_table, curves, _peak_words(told, limits, highest, cases, peaks)


def _peak_words(
    told: dict[str, Any],
    limits: tuple[float, ...],
    highest: list[tuple[float, float, float]],
    cases: list[tuple[float, float]],
    peaks: list[tuple[PeakForce, PeakForce, PeakForce]],
) -> list[str]:
    bent = (
        abs(highest[0][1]) > 45 and abs(highest[0][2]) > 0.9 * told["theta2_rate_limit_rad_per_s"]
    )
    over = [f"joint {k + 1}" for k in (0, 1) if highest[k][0] > limits[k]]
    first = (
        f"The thesis found the highest torques with the arm {told['highest_torque']}. "
        f"Here joint 1 needs most, {highest[0][0]:.1f} N·m, at θ₂ = {highest[0][1]:.0f}° and "
        f"θ₂' = {highest[0][2]:+.0f} rad/s: {'the same' if bent else 'not the same'}. "
    )
    if over:
        first += (
            f"That is beyond the drive at {' and '.join(over)}, so with these masses the four "
            "cases cannot all be driven over the whole sweep; the thesis speaks of verifying the "
            "gear ratios and does not say that they can."
        )
    else:
        first += "Every case lies within the drives' torque."
    slow = [p for (rate, _), p in zip(cases, peaks, strict=True) if rate < 1]
    fast = [p for (rate, _), p in zip(cases, peaks, strict=True) if rate >= 1]

    def count(which: list[tuple[PeakForce, PeakForce, PeakForce]], k: int, kind: str) -> int:
        return sum(p[k].direction == kind for p in which)

    top = max(peaks, key=lambda p: p[0].size)
    second = (
        "Where looseness should start, by peak force, the thesis says twice and differently: "
        f"{told['highest_force_direction_5_2']} at the distal end of a link (5.2), and along both "
        f"links at θ₂ = {told['highest_force_theta2_deg']:g}° (6.1.2). Both occur here. With "
        "joint 1 slow, acceleration decides: the force at joint 1 is tangential in "
        f"{count(slow, 0, 'tangential')} of {len(slow)} cases, and so is the force at the distal "
        f"end of link 1 in {count(slow, 2, 'tangential')}, arm bent. With joint 1 fast, "
        f"centripetal force decides: it is longitudinal in {count(fast, 0, 'longitudinal')} of "
        f"{len(fast)} cases at joint 1 and {count(fast, 1, 'longitudinal')} at joint 2. The "
        f"largest of all, {top[0].size:.0f} N at joint 1, is {top[0].direction} at θ₂ = "
        f"{top[0].at[0]:.0f}°, and joint 2 carries {top[1].size:.0f} N, {top[1].direction}, in "
        "the same case."
    )
    return [first, second]


def _in_link_1(force: Array, angle: Array) -> Array:
    """Force given in link 2's axes, in link 1's."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = force[..., 0], force[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _force_cell(peak: PeakForce) -> str:
    return f"{peak.size:.1f} N, {peak.direction}, {peak.at[0]:.0f}°"


def _readings(
    links: TwoLinks,
    told: dict[str, Any],
    limits: tuple[float, ...],
    cases: list[tuple[float, float]],
) -> tuple[Table, list[str]]:
    """The printed text gives the varied acceleration to joint 2 and also fixes it, twice."""
    one, none = told["fixed_theta2_acceleration_rad_per_s2"]
    readings = (
        (f"θ₁'' varied, θ₂'' = {none:g}", lambda a: (a, none)),
        (f"θ₁'' varied, θ₂'' = {one:g}", lambda a: (a, one)),
        ("θ₂'' varied, θ₁'' = 0", lambda a: (0.0, a)),
    )
    rows, tips, fits = [], [], []
    largest = max(told["varied_acceleration_rad_per_s2"])
    for name, accelerations in readings:
        peaks = []
        for rate, acc in cases:
            loads = demand(links, told, rate, accelerations(acc))[2]
            peaks.append(np.abs(loads.torque).max(axis=(0, 1)))
        a1, a2 = accelerations(largest)
        tips.append(LINK_LENGTH * (2 * a1 + a2))
        fits.append(sum(bool((p <= limits).all()) for p in peaks))
        rows.append((name, f"{tips[-1]:.1f}", *(f"{p[0]:.1f} / {p[1]:.1f}" for p in peaks)))
    wanted = told["tip_acceleration_m_per_s2"]
    best = int(np.argmin(np.abs(np.array(tips) - wanted)))
    radius = told["workspace_outer_diameter_m"]
    head = tuple(f"{rate:g}, {acc:g}" for rate, acc in cases)
    table = Table(
        caption="What the contradictory text could mean: tangential acceleration of the straight "
        f"arm's tip at the larger value [m/s²] (printed: almost {wanted:g}) and peak torques of "
        "joints 1 / 2 [N·m], by θ₁' [rad/s] and the varied acceleration [rad/s²].",
        columns=("reading", "tip", *head),
        rows=tuple(rows),
    )
    words = [
        "The text of 6.1.2 contradicts itself about the four cases. Two rates of joint 1 are "
        "clear. The other variable is printed as the acceleration of joint 2, which is then held "
        f"fixed, at {one:g} rad/s² in one place and at {none:g} in another. The acceleration it "
        f"names for the tip, almost {wanted:g} m/s², decides: it is {tips[0]:.1f} to "
        f"{tips[1]:.1f} m/s² if joint 1 accelerates and {tips[2]:.1f} if joint 2 does"
        + (", so joint 1 is meant. " if best != 2 else ", so joint 2 is meant. ")
        + f"The workspace's 'outer diameter' of {radius:g} m is a slip as well: twice the link "
        f"length, {2 * LINK_LENGTH:.2f} m, is the outer radius. The number of cases within both "
        f"drives' torque is {fits[0]}, {fits[1]} and {fits[2]} of {len(cases)} in the three "
        "readings."
    ]
    return table, words
