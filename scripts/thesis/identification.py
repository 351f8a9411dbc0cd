"""Identification of kinematic parameters by joint, and of loose links with the tool held."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from loose_env.arms import Arm, planar
from loose_env.envs import MEASURED, TRUTH
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import Backlash, Fault, Healthy, StructuralLooseness
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.rig import read_encoder
from loose_env.sensors import Encoder
from loose_env.typing import Array
from scripts.charts import Panel, axis, chart, ring
from scripts.thesis.loose_joint import (
    Jig,
    compatible_links,
    distended_angles,
    docked_acceleration,
    identify_planar,
    insert_looseness,
    link_frames,
    moving_directions,
    parameter_deviations,
    remaining_motions,
    seat_twist,
    seated_inertia,
    simulate_docked,
    velocity_components,
)
from scripts.thesis.page import Rows, Section, section
from scripts.thesis.rigs import LOOSE_GAP

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RATE = 0.5
"""Velocity at which each joint is turned for the recursion [rad/s]."""
NOISE = 1e-3
"""Rms noise of each velocity component in the recursion [m/s]."""
SPEED = 10 * NOISE
"""Velocity of the loose seat while joint 3 is turned [m/s]."""
DRAWS = 2000
"""Noisy repetitions of the recursion."""
LENGTH = 0.30
"""Length of every link of the planar arms [m]."""
SLOPE = (0.6, 0.8, 0.0)
"""Direction of the slide in its link's frame."""
DOCKED = 5
"""Poses in which the arm is docked."""
DRIVE, BAND = 0.03, (1.0, 12.0)
"""Rms torque in the dock, as a share of the peak torque, and its band [Hz]."""
_PLANE = [0, 1, 5]  # rows of the Jacobian that a planar arm can move


def identification(seed: int) -> Section:
    """Reproduce section 3.3's recursion and carry out the docked test of 8.1.2."""
    arm, rng = planar(4), np.random.default_rng([seed, 0])
    rates, exact, printed_offsets, own_offsets = np.full(arm.n, RATE), 0.0, [], []
    for _ in range(10):
        q = arm.random_pose(rng)
        v = velocity_components(geometric_jacobian(Chain.of(arm, q))[:2], rates)
        found = identify_planar(v, rates, q)
        exact = max(exact, float(np.abs(found.lengths - LENGTH).max()))
        own_offsets.append(found.offsets)
        printed_offsets.append(_turn(distended_angles(v, rates) - q[1:]))
    drift = np.ptp(np.unwrap(printed_offsets, axis=0), axis=0)
    own, most = np.abs(_turn(np.array(own_offsets))).max(), drift.max()
    wrong = ", ".join(str(j + 2) for j in np.flatnonzero(drift > 1e-6))

    q = np.array([0.3, 0.7, -0.6, 0.9])
    chain = Chain.of(arm, q)
    v = velocity_components(geometric_jacobian(chain)[:2], rates)
    noisy = [
        identify_planar(v + NOISE * rng.standard_normal(v.shape), rates, q) for _ in range(DRAWS)
    ]
    lengths = np.std([d.lengths for d in noisy], axis=0)
    offsets = np.std(_turn(np.array([d.offsets for d in noisy])), axis=0)
    length_sd, offset_sd = parameter_deviations(v, rates, NOISE)
    least, largest = length_sd.min(), length_sd.max()
    # A seat in link 2 moves while joint 3 is turned, and is taken for the joint's motion.
    mixed = v.copy()
    mixed[2] += SPEED * (link_frames(arm, q)[1] @ SLOPE)[:2]
    shift = identify_planar(mixed, rates, q).lengths - LENGTH
    worst = np.abs(shift).max()
    both = zip(1e3 * offsets, 1e3 * offset_sd, strict=True)
    turned = [("–", "–"), *((f"{a:.1f}", f"{b:.1f}") for a, b in both)]
    rounded = np.round(1e3 * shift, 1) + 0.0
    recursion_rows = zip(range(1, arm.n + 1), lengths, length_sd, rounded, turned, strict=True)
    # The same slide on every link in turn: a linear velocity is a free vector.
    columns = [
        geometric_jacobian(insert_looseness(chain, link, SLOPE))[:, link]
        for link in range(1, arm.n + 1)
    ]
    spread = np.ptp(columns, axis=0).max()
    alike = "the tool in exactly the same way" if spread == 0 else f"the tool alike to {spread:.1e}"

    count_rows, agree, spare = motion_counts(seed)
    total = len(count_rows)
    still, moving = _docked_dynamics(planar(3), np.array([0.4, 0.9, -0.7]))
    link_rows, named, error, figure = loose_links(seed)
    return section("identification", locals(), [recursion_rows, count_rows, link_rows], [figure])


def _turn(angle: Array) -> Array:
    """The angle in (-pi, pi]."""
    return np.asarray(np.angle(np.exp(1j * angle)))


def _wiggle(arm: Arm, pose: Array, fault: Fault, jig: Jig, rng: np.random.Generator) -> Array:
    """Dock the arm, drive its joints, and read the encoders (n, N)."""
    rms = tuple(DRIVE * t for t in arm.torque_limits)
    shake = Excitation(torque_rms=rms, duration=1.0, band=BAND)
    torque = torque_signals(shake, timestep=arm.timestep, before=0, after=0, rng=rng)
    record = simulate_docked(arm, pose, fault, torque, jig=jig, every=10)
    drawn = rng.standard_normal(record.angles.shape)
    return read_encoder(record.angles, sensor=Encoder(), drawn=drawn)


def _slide(link: int) -> StructuralLooseness:
    return StructuralLooseness(
        link=link, direction=SLOPE, gap=LOOSE_GAP, stiffness=(1e6, 1e6), damping=(100.0, 100.0)
    )


def motion_counts(seed: int) -> tuple[Rows, int, dict[str, float]]:
    """Count the motions that remain while the tool is held, expected and seen.

    Returns the rows, how many agree, and how far the clamped arm of three joints moves by fault.
    """
    encoder = Encoder()
    noise = float(np.hypot(encoder.noise, encoder.resolution / np.sqrt(12)))
    faults: dict[str, Fault] = {
        "healthy": Healthy(),
        "slide at link 2": _slide(2),
        "play in joint 2": Backlash(joint=2, gap=5e-4, stiffness=(1e5, 1e5), damping=(50, 50)),
    }
    jigs: dict[Jig, list[int]] = {"pin": _PLANE[:2], "clamp": _PLANE}
    rows, agree, spare = [], 0, {}
    for n in (3, 4):
        arm, pose = planar(n), np.array([0.4, 0.9, -0.7, 0.8])[:n]
        chain = Chain.of(arm, pose)
        loose = (
            chain,
            insert_looseness(chain, 2, link_frames(arm, pose)[1] @ SLOPE),
            insert_looseness(chain, 2, [0, 0, 1], kind="revolute"),
        )
        for jig, held in jigs.items():
            for f, (name, fault) in enumerate(faults.items()):
                expected = remaining_motions(geometric_jacobian(loose[f])[held]).shape[1]
                rng = np.random.default_rng([seed, 1, n, len(held), f])
                angles = _wiggle(arm, pose, fault, jig, rng)
                # Motions of the joints alone; each seat motion drags joints along.
                seen = len(moving_directions(angles, noise))
                agree += seen == expected
                sizes = angles.std(axis=1)
                moved = ", ".join(str(j + 1) for j in np.flatnonzero(sizes > 3 * noise)) or "none"
                if n == 3 and jig == "clamp":
                    spare[name] = float(sizes.max())
                rows.append((f"{n}, {jig}", name, str(expected), str(seen), moved))
    return rows, agree, spare


def _docked_dynamics(arm: Arm, pose: Array) -> tuple[float, float]:
    """Largest joint acceleration of the clamped arm, healthy and with a slide (3.25)."""
    chain, torque = Chain.of(arm, pose), 0.1 * np.array(arm.torque_limits)
    healthy = docked_acceleration(
        geometric_jacobian(chain)[_PLANE], seated_inertia(arm, pose, Healthy()), torque
    )
    axis = link_frames(arm, pose)[1] @ SLOPE
    j = geometric_jacobian(insert_looseness(chain, 2, axis))[_PLANE]
    # The inertia matrix has the seat last, the Jacobian has it after joint 2.
    order = [0, 1, 3, 2]
    m = seated_inertia(arm, pose, _slide(2))[np.ix_(order, order)]
    loose = docked_acceleration(j, m, np.insert(torque, 2, 0.0))
    return float(np.abs(healthy).max()), float(np.abs(np.delete(loose, 2)).max())


def loose_links(seed: int) -> tuple[Rows, int, float, Figure]:
    """Find the loose link of four joints from the directions of several docked poses.

    Returns the rows, how many links are named rightly, the largest error of a direction [deg], and
    the directions of the arm loose at link 2 in every link's frame.
    """
    arm = planar(4)
    rows, right, worst, shown = [], 0, 0.0, []
    for link in range(1, arm.n + 1):
        directions, frames = [], []
        for p in range(DOCKED):
            rng = np.random.default_rng([seed, 2, p])
            pose = arm.random_pose(rng)
            angles = _wiggle(arm, pose, _slide(link), "clamp", rng)
            twist = seat_twist(geometric_jacobian(Chain.of(arm, pose))[_PLANE], angles)
            directions.append(twist[:2])
            frames.append(link_frames(arm, pose)[:, :2, :2])
        misfit, best = compatible_links(directions, frames)
        own = np.einsum("pkdc,pd->kpc", np.array(frames), np.array(directions))
        along = np.abs(own[link - 1] @ SLOPE[:2]) / np.linalg.norm(own[link - 1], axis=1)
        error = float(np.degrees(np.arccos(np.clip(along, 0.0, 1.0))).max())
        right += best == link
        worst = max(worst, error)
        if link == 2:
            shown = list(own)
        off = (f"{np.degrees(m):.2g}" for m in misfit)
        rows.append((f"link {link}", *off, str(best), f"{error:.2f}"))
    return rows, right, worst, _frames_figure(shown, 2)


def _frames_figure(own: Sequence[Array], link: int) -> Figure:
    panels = []
    for k, lines in enumerate(own):
        loose = k + 1 == link
        colour = TRUTH if loose else MEASURED
        axes = [axis(end / np.linalg.norm(end), color=colour, linewidth=2.0) for end in lines]
        name = f"link {k + 1}" + (" (loose)" if loose else "")
        panels.append(Panel(title=name, curves=[ring(1.0), *axes]))
    return chart(panels, columns=len(own), height=1.4, bare=True)
