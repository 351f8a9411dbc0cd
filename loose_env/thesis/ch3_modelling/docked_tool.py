"""The docked-tool test (8.1.2): hold the tool, wiggle the joints, and see what still moves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from loose_env.arms import Arm, planar
from loose_env.envs import FAINT, INK, MEASURED, MUTED, TRUTH
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import Backlash, Fault, Healthy, StructuralLooseness
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.report import WIDTH, FigureCard, new_figure
from loose_env.sensors import Encoder, read_encoder
from loose_env.thesis.methods.looseness.looseness_joint import insert_looseness, seated_inertia
from loose_env.thesis.methods.looseness.static_force_test import (
    Jig,
    compatible_links,
    docked_acceleration,
    link_frames,
    moving_directions,
    remaining_motions,
    seat_twist,
    simulate_docked,
)
from loose_env.thesis.rigs.slide import LOOSE_GAP
from loose_env.thesis.shared.sections import Table
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SLOPE = (0.6, 0.8, 0.0)
"""Direction of the slide in its link's frame."""
POSES = 5
"""Poses in which the arm is docked."""
DRIVE = 0.03
"""Rms torque in the dock, as a share of the peak torque."""
BAND = (1.0, 12.0)
"""Band of the torque in the dock [Hz]."""
_PLANE = [0, 1, 5]  # rows of the Jacobian that a planar arm can move


def _wiggle(arm: Arm, pose: Array, fault: Fault, jig: Jig, rng: np.random.Generator) -> Array:
    """Dock the arm, drive its joints, and read the encoders (n, N)."""
    shake = Excitation(
        torque_rms=tuple(DRIVE * t for t in arm.torque_limits), duration=1.0, band=BAND
    )
    torque = torque_signals(shake, timestep=arm.timestep, before=0, after=0, rng=rng)
    record = simulate_docked(arm, pose, fault, torque, jig=jig, every=10)
    drawn = rng.standard_normal(record.angles.shape)
    return read_encoder(record.angles, sensor=Encoder(), drawn=drawn)


def _slide(link: int) -> StructuralLooseness:
    return StructuralLooseness(
        link=link, direction=SLOPE, gap=LOOSE_GAP, stiffness=(1e6, 1e6), damping=(100.0, 100.0)
    )


def motion_counts(seed: int, told: dict[str, object]) -> tuple[Table, list[str]]:
    """Count the motions that remain while the tool is held, expected and seen."""
    encoder = Encoder()
    noise = float(np.hypot(encoder.noise, encoder.resolution / np.sqrt(12)))
    faults: tuple[tuple[str, Fault], ...] = (
        ("healthy", Healthy()),
        ("slide at link 2", _slide(2)),
        ("play in joint 2", Backlash(joint=2, gap=5e-4, stiffness=(1e5, 1e5), damping=(50, 50))),
    )
    rows, agree, total = [], 0, 0
    spare: dict[str, float] = {}
    for n in (3, 4):
        arm = planar(n)
        pose = np.array([0.4, 0.9, -0.7, 0.8])[:n]
        chain = Chain.of(arm, pose)
        for jig, held in (("pin", _PLANE[:2]), ("clamp", _PLANE)):
            for f, (name, fault) in enumerate(faults):
                loose = chain
                if isinstance(fault, StructuralLooseness):
                    axis = link_frames(arm, pose)[fault.link - 1] @ SLOPE
                    loose = insert_looseness(chain, fault.link, axis)
                elif isinstance(fault, Backlash):
                    loose = insert_looseness(chain, fault.joint, [0, 0, 1], kind="revolute")
                expected = remaining_motions(geometric_jacobian(loose)[held]).shape[1]
                rng = np.random.default_rng([seed, 1, n, len(held), f])
                angles = _wiggle(arm, pose, fault, "pin" if jig == "pin" else "clamp", rng)
                # Motions of the joints alone; each seat motion drags joints along.
                seen = len(moving_directions(angles, noise))
                agree += seen == expected
                total += 1
                sizes = angles.std(axis=1)
                moving = ", ".join(str(j + 1) for j in range(n) if sizes[j] > 3 * noise)
                if n == 3 and jig == "clamp":
                    spare[name] = float(sizes.max())
                rows.append((f"{n}, {jig}", name, str(expected), str(seen), moving or "none"))
    arm, pose = planar(3), np.array([0.4, 0.9, -0.7])
    still = _docked_dynamics(arm, pose)
    words = [
        "Section 8.1.2 proposes to dock the tool and wiggle the joints. With the tool held, "
        "joints can move only along the null space of the Jacobian's held rows (3.25). A pin "
        "holds two motions of a planar arm, so three joints keep one: the arm turns about the "
        "pin. A clamp holds three, so three joints stand still and four keep one. A loose seat "
        f"adds one to each. In the simulation {agree} of {total} counts are those of the null "
        f"space; the clamped three-joint arm moves by {1e6 * spare['healthy']:.1f} µrad rms "
        f"healthy, which is the encoders' noise, and by {1e3 * spare['slide at link 2']:.2f} mrad "
        "with a slide. "
        + (
            "So a nonredundant arm that is fully held moves only if it is loose, as the thesis "
            "says; a redundant one, or one held by a pin, must be compared with its own count."
            if told["docked_nonredundant_moves_only_if_loose"]
            and spare["healthy"] < 3 * noise < spare["slide at link 2"]
            else "This differs from what the thesis says of a nonredundant arm."
        ),
        f"Equation (3.25) agrees: torques on the clamped arm accelerate its joints by "
        f"{still[0]:.0e} rad/s² healthy and by {still[1]:.1f} rad/s² with the slide. Play shows "
        "in one pose, as the clamped three-joint rows say: the joint with play moves alone.",
    ]
    return (
        Table(
            caption=f"Motions left to a planar arm whose tool is held, and joints that moved; "
            f"torques of {100 * DRIVE:g} % of the peak at {BAND[0]:g} to {BAND[1]:g} Hz.",
            columns=("joints, jig", "arm", "expected", "seen", "joints that moved"),
            rows=tuple(rows),
        ),
        words,
    )


def _docked_dynamics(arm: Arm, pose: Array) -> tuple[float, float]:
    """Largest joint acceleration of the clamped arm, healthy and with a slide (3.25)."""
    chain = Chain.of(arm, pose)
    torque = 0.1 * np.array(arm.torque_limits)
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


def loose_links(seed: int) -> tuple[Table, str, FigureCard]:
    """Find the loose link from the directions of several docked poses."""
    arm = planar(4)
    rows, right, worst = [], 0, 0.0
    shown: list[Array] = []
    for link in range(1, arm.n + 1):
        directions, frames = [], []
        for p in range(POSES):
            rng = np.random.default_rng([seed, 2, p])
            pose = arm.random_pose(rng)
            angles = _wiggle(arm, pose, _slide(link), "clamp", rng)
            twist = seat_twist(geometric_jacobian(Chain.of(arm, pose))[_PLANE], angles)
            directions.append(twist.direction[:2])
            frames.append(link_frames(arm, pose)[:, :2, :2])
        found = compatible_links(directions, frames)
        own = np.einsum("pkdc,pd->kpc", np.array(frames), np.array(directions))
        along = np.abs(own[link - 1] @ SLOPE[:2]) / np.linalg.norm(own[link - 1], axis=1)
        error = float(np.degrees(np.arccos(np.clip(along, 0.0, 1.0))).max())
        right += found.best == link
        worst = max(worst, error)
        if link == 2:
            shown = list(own)
        rows.append(
            (
                f"link {link}",
                *(f"{np.degrees(m):.2g}" for m in found.misfit),
                str(found.best),
                f"{error:.2f}",
            )
        )
    words = (
        "What the joints do at the tool, with the sign changed, is the seat's own motion there. "
        f"Over {POSES} docked poses of a four-joint arm its direction is right to {worst:.2f}°, "
        "and it stays fixed in the frame of one link only: the link is named rightly in "
        f"{right} of {arm.n} cases. No excitation statistics are needed, but a stiff jig in every "
        "pose is, which is why the thesis leaves the method to later work."
    )
    return (
        Table(
            caption=f"Docked arm of four joints, {POSES} poses: rms angle by which the "
            "directions disagree in each link's frame, degrees; link named; largest error of a "
            "direction, degrees.",
            columns=("loose", *(f"in link {k}" for k in range(1, arm.n + 1)), "named", "error, °"),
            rows=tuple(rows),
        ),
        words,
        FigureCard(
            image=_frames_figure(shown, 2),
            title="One frame in which all poses agree",
            caption="Directions of the seat's motion from the docked poses of an arm loose at "
            "link 2, drawn in the frame of each link. In the loose link's frame they fall on one "
            "line.",
        ),
    )


def _frames_figure(own: Sequence[Array], link: int) -> Figure:
    count = len(own)
    side = WIDTH / count
    figure = new_figure(side + 0.2)
    height = side + 0.2
    for k, lines in enumerate(own):
        axes = figure.add_axes(((k + 0.06) / count, 0.03, 0.88 / count, 0.88 * side / height))
        turn = np.linspace(0, 2 * np.pi, 120)
        axes.plot(np.cos(turn), np.sin(turn), color=FAINT, linewidth=1.0)
        loose = k + 1 == link
        for x, y in lines:
            size = float(np.hypot(x, y))
            axes.plot(
                [-x / size, x / size],
                [-y / size, y / size],
                color=TRUTH if loose else MEASURED,
                linewidth=2.0,
            )
        axes.text(
            0.5,
            1.04,
            f"link {k + 1}" + (" (loose)" if loose else ""),
            color=INK if loose else MUTED,
            fontsize=9.5,
            ha="center",
            va="bottom",
            transform=axes.transAxes,
        )
        axes.set(xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), aspect="equal")
        axes.axis("off")
    return figure
