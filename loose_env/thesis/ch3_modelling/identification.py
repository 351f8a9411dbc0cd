"""Chapter 3.3 and 8.1.2: kinematic parameters joint by joint, and the docked-tool test."""

from __future__ import annotations

import numpy as np

from loose_env.arms import planar
from loose_env.errors import InvalidData
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.thesis.ch3_modelling.docked_tool import SLOPE, loose_links, motion_counts
from loose_env.thesis.methods.looseness.looseness_joint import insert_looseness
from loose_env.thesis.methods.looseness.parameter_recursion import (
    distended_angles,
    identify_planar,
    parameter_deviations,
    velocity_components,
)
from loose_env.thesis.methods.looseness.static_force_test import link_frames
from loose_env.thesis.printed import printed
from loose_env.thesis.rigs.slide import LOOSE_GAP
from loose_env.thesis.shared.sections import Section, Table

EQUATIONS: dict[str, str] = {
    **dict.fromkeys(
        ("3.49", "3.50", "3.63", "3.64", "3.66", "3.67"),
        "loose_env.thesis.methods.looseness.parameter_recursion.identify_planar",
    ),
    **dict.fromkeys(
        ("3.51", "3.52"),
        "loose_env.thesis.methods.looseness.parameter_recursion.velocity_components",
    ),
    "3.53": "loose_env.thesis.methods.looseness.looseness_joint.tool_velocity",
    **dict.fromkeys(("3.54", "3.55"), "loose_env.kinematics.geometric_jacobian"),
    **dict.fromkeys(
        ("3.56", "3.58", "3.59", "3.60"),
        "loose_env.thesis.methods.looseness.parameter_recursion.rotation_arms",
    ),
    **dict.fromkeys(
        ("3.57", "3.68", "3.69"),
        "loose_env.thesis.methods.looseness.parameter_recursion.slide_direction",
    ),
    **dict.fromkeys(
        ("3.61", "3.65"),
        "loose_env.thesis.methods.looseness.parameter_recursion.distended_angles",
    ),
}
"""Function of each equation."""

RATE = 0.5
"""Velocity at which each joint is turned for the recursion [rad/s]."""
NOISE = 1e-3
"""Rms noise of each velocity component in the recursion [m/s]."""
DRAWS = 2000
"""Noisy repetitions of the recursion."""


def section(seed: int) -> Section:
    """Reproduce section 3.3's recursion and carry out the docked test of 8.1.2.

    Examples
    --------
    >>> from loose_env.thesis.printed import printed
    >>> printed("identification")["recursion_steps"]
    6
    """
    told = printed("identification")
    recursion_table, recursion_words = _recursion(seed, told)
    count_table, count_words = motion_counts(seed, told)
    link_table, link_words, card = loose_links(seed)
    agree = sum(row[2] == row[3] for row in count_table.rows)
    named = sum(row[0] == f"link {row[-2]}" for row in link_table.rows)
    return Section(
        key="identification",
        title="Identification joint by joint, and the docked tool (3.3.1, 8.1.2)",
        finding=(
            f"The docked arm keeps the motions of its null space in {agree} of "
            f"{len(count_table.rows)} cases, and its loose link is named in {named} of "
            f"{len(link_table.rows)}; the printed joint angle (3.65) "
            + ("does not hold" if "although an offset" in recursion_words[1] else "holds")
            + " for inner joints."
        ),
        words=[*recursion_words, _free_vector(), *count_words, link_words],
        tables=[recursion_table, count_table, link_table],
        cards=[card],
        equations=EQUATIONS,
        left_out=[
            "The order of moves that finds the link without a dock (3.3.1, after 3.69): it is "
            "the link-finding method, told in a section of its own.",
            "The place and the angle of joint 1 in the world: a method from velocities cannot "
            f"find these {told['parameters_never_found']} figures, as the thesis says.",
            "The internal angle between two arms (3.62): a link is their difference as vectors, "
            "whose norm is the law of cosines (3.63).",
            "Compliance of the jig, and mechanical friction of the joints and the seat: the "
            "docked test is simulated with a stiff jig and free guides.",
        ],
    )


def _recursion(seed: int, told: dict[str, object]) -> tuple[Table, list[str]]:
    arm, rng = planar(4), np.random.default_rng([seed, 0])
    true = 0.30
    exact, printed_offsets, own_offsets = 0.0, [], []
    rates = np.full(arm.n, RATE)
    for _ in range(10):
        q = arm.random_pose(rng)
        v = velocity_components(geometric_jacobian(Chain.of(arm, q))[:2], rates)
        found = identify_planar(v, rates, q)
        exact = max(exact, float(np.abs(found.lengths - true).max()))
        own_offsets.append(found.offsets)
        printed_offsets.append(np.angle(np.exp(1j * (distended_angles(v, rates) - q[1:]))))
    drift = np.ptp(np.unwrap(printed_offsets, axis=0), axis=0)
    own = float(np.abs(np.angle(np.exp(1j * np.array(own_offsets)))).max())

    q = np.array([0.3, 0.7, -0.6, 0.9])
    v = velocity_components(geometric_jacobian(Chain.of(arm, q))[:2], rates)
    noisy = [
        identify_planar(v + NOISE * rng.standard_normal(v.shape), rates, q) for _ in range(DRAWS)
    ]
    lengths = np.array([d.lengths for d in noisy])
    offsets = np.angle(np.exp(1j * np.array([d.offsets for d in noisy])))
    length_sd, offset_sd = parameter_deviations(v, rates, NOISE)
    # The same noise, and a seat in link 2 that moves while joint 3 is turned.
    speed = 10 * NOISE
    seat = speed * (link_frames(arm, q)[1] @ SLOPE)[:2]
    mixed = v.copy()
    mixed[2] += seat
    shifted = identify_planar(mixed, rates, q)
    rows = []
    for i in range(arm.n):
        rows.append(
            (
                f"link {i + 1}",
                f"{1e3 * true:.0f}",
                f"{1e3 * lengths[:, i].std():.2f}",
                f"{1e3 * length_sd[i]:.2f}",
                f"{round(1e3 * (shifted.lengths[i] - true), 1) + 0.0:+.1f}",
                "–" if i == 0 else f"{1e3 * offsets[:, i - 1].std():.1f}",
                "–" if i == 0 else f"{1e3 * offset_sd[i - 1]:.1f}",
            )
        )
    worst = float(np.abs(shifted.lengths - true).max())
    wrong = [j + 2 for j in range(arm.n - 1) if drift[j] > 1e-6]
    table = Table(
        caption=f"Recursion on an arm of four links, each joint turned at {RATE:g} rad/s, "
        f"velocity noise {1e3 * NOISE:g} mm/s: standard deviations found in {DRAWS} draws and to "
        f"first order, and the error from a seat of link 2 moving at {1e3 * speed:g} mm/s while "
        "joint 3 is turned.",
        columns=(
            "",
            "length, mm",
            "sd found",
            "sd expected",
            "seat's error",
            "offset sd, mrad",
            "expected",
        ),
        rows=tuple(rows),
    )
    words = [
        "Turn one joint alone and the velocity of the tool tells where that joint lies: across "
        "the velocity, at the distance of speed over rate. Going from the tool to the base, the "
        f"differences of neighbouring joints are the links. The {told['recursion_steps']} steps "
        f"give the lengths of a four-link arm to {exact:.0e} m in ten random poses, and its "
        f"offsets to {own:.0e} rad.",
        "The printed joint angle (3.65) is measured to the line from the next joint to the tool. "
        + (
            f"Offsets from it move with the pose by up to {np.degrees(drift.max()):.0f}° "
            f"(joints {', '.join(map(str, wrong))}), although an offset is a constant; only for "
            f"the last joint is it right. Here the angle between links i-1 and i is used."
            if wrong
            else "It gives constant offsets in these poses."
        ),
        f"Noise of {1e3 * NOISE:g} mm/s makes lengths uncertain by "
        f"{1e3 * length_sd.min():.1f} to {1e3 * length_sd.max():.1f} mm: an inner link by √2 more "
        "than the last, since both of its ends are noisy. "
        + (
            "Errors do not build up toward the base, because each joint is located from the tool. "
            if length_sd[0] < 1.01 * length_sd[-2]
            else "Errors grow toward the base. "
        )
        + "Motion of a loose seat that is taken for the joint's is no small error either: "
        f"{1e3 * speed:g} mm/s shift the joint, and a length by {1e3 * worst:.0f} mm, while the "
        f"gap is {1e3 * LOOSE_GAP:g} mm.",
    ]
    return table, words


def _free_vector() -> str:
    """Put the same slide on every link in turn, and try the recursion with a slide in it."""
    chain = Chain.of(planar(4), [0.3, 0.7, -0.6, 0.9])
    columns = [
        geometric_jacobian(insert_looseness(chain, link, SLOPE))[:, link]
        for link in range(1, chain.n + 1)
    ]
    spread = float(np.ptp(columns, axis=0).max())
    ones = np.ones(chain.n)
    v = velocity_components(geometric_jacobian(chain)[:2], ones)
    try:
        identify_planar(v, ones, ones, kinds=["revolute", "revolute", "prismatic", "revolute"])
        refused = False
    except InvalidData:
        refused = True
    return (
        "A slide has no such place. Put on any of the four links along one direction, it moves "
        + ("the tool in exactly the same way" if spread == 0 else f"the tool alike to {spread:.1e}")
        + ": a linear velocity is a free vector, and one pose cannot tell the link. "
        + (
            "The recursion says so and stops, as the thesis found."
            if refused
            else "The recursion runs on, against what the thesis found."
        )
    )
