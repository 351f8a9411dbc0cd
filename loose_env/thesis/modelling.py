"""Chapter 3.2: seven ways to model looseness, and what a loose seat does to two matrices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, planar, vera
from loose_env.diagnosis.alternatives import (
    ALTERNATIVES,
    MEASURES,
    AlternativeSettings,
    Weighing,
    weigh_alternatives,
)
from loose_env.diagnosis.docked import simulate_docked
from loose_env.diagnosis.inertia import backlash_condition, condition_of, seated_inertia
from loose_env.diagnosis.jacobian import (
    Chain,
    Frame,
    changed_columns,
    displaced,
    geometric_jacobian,
    insert_looseness,
    link_of_changed_columns,
)
from loose_env.diagnosis.static_force import joint_torques
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import Backlash, Healthy, StructuralLooseness
from loose_env.report.plate import Plate
from loose_env.thesis.modelling_figures import condition_figure, ratios_figure
from loose_env.thesis.printed import printed
from loose_env.thesis.section import Section, Table

__all__ = ["section"]

Array = NDArray[np.float64]
GAP = 2e-4
"""Travel of the loose seat [m], as on VERA."""
DIRECTION = (float(np.cos(np.radians(-15))), float(np.sin(np.radians(-15))), 0.0)
"""Direction of VERA's slide in link 2, -15°."""
POSES = (0.6, 1.2, 1.9)
"""Angles of joint 2 at which the alternatives are weighed [rad]."""
_FRAMES: tuple[tuple[Frame, str], ...] = (
    ("tool", "tool point, tool axes"),
    ("world", "tool point, world axes"),
    ("base", "world origin, world axes"),
)
_EQUATIONS = ("3.1", "3.3", "3.9", "3.10", "3.17", "none", "3.20")
_INERTIA_POSES = 20


def section(seed: int) -> Section:
    """Reproduce section 3.2: modelling alternatives, Jacobian and inertia matrix.

    Examples
    --------
    >>> from loose_env.thesis.printed import printed
    >>> len(ALTERNATIVES) == printed("modelling")["alternatives_count"]
    True
    """
    told = printed("modelling")
    flexible = _weigh(vera(), seed, 0)
    stiff = _weigh(planar(2), seed, 1)
    columns_table, columns_words = _columns()
    rank_table, rank_words = _ranks(told)
    inertia_table, inertia_words, inertia_plate = _inertia(seed, told)
    return Section(
        key="modelling",
        title="Modelling looseness (3.2)",
        words=[
            _opening(),
            *_verdicts(flexible, stiff, told["alternatives_chosen"]),
            _carried(seed),
            columns_words,
            rank_words,
            inertia_words,
        ],
        tables=[
            _what_table(),
            _weighing_table(flexible, "VERA, whose first bending mode lies inside the band"),
            _weighing_table(stiff, "A stiff planar arm of two links"),
            columns_table,
            rank_table,
            inertia_table,
        ],
        plates=[
            Plate(
                image=ratios_figure(flexible),
                title="How far the gap stands out, by alternative",
                caption="Disagreement made by a gap of 0.2 mm on VERA over the noise of the "
                "sensors (blue), and over noise and the model's own error together (orange). "
                "Left of the line the gap is hidden.",
            ),
            inertia_plate,
        ],
        equations=_EQUATION_MAP,
        left_out=[
            "Estimating the parameters k from each model by least squares (3.4, 3.7): here they "
            "are known, and the question is how far the gap shows. The velocity term of the "
            "acceleration model (3.6) is in the simulated motion, but not in the model.",
            "Errors of the flexible model's own figures: it is given the true bending mode, so "
            "that its ratio is an upper bound.",
            "The link-to-link recursions of velocity and acceleration (3.5, 3.8) and the closed "
            "loop behind (3.12, 3.13): the simulation solves the whole equations of motion.",
            "Mechanical friction of the joints beyond viscous damping: it would weigh most on "
            "the static-force alternative, whose ratio is therefore an upper bound.",
            "Noise of tracker, force sensor and drive torque is assumed, not taken from a "
            "measured sensor; the ratios scale with it.",
        ],
    )


_EQUATION_MAP = {
    **dict.fromkeys(
        ("3.2", "3.28", "3.29", "3.32"), "loose_env.diagnosis.jacobian.geometric_jacobian"
    ),
    **dict.fromkeys(("3.3", "3.30"), "loose_env.diagnosis.jacobian.tool_velocity"),
    "3.1": "loose_env.diagnosis.jacobian.Chain",
    "3.26": "loose_env.diagnosis.jacobian.looseness_transform",
    "3.27": "loose_env.diagnosis.jacobian.slot_direction",
    "3.31": "loose_env.diagnosis.jacobian.insert_looseness",
    "3.33": "loose_env.diagnosis.jacobian.changed_columns",
    "3.34": "loose_env.diagnosis.jacobian.velocity_error",
    **dict.fromkeys(
        ("3.9", "3.14", "3.15", "3.16", "3.17", "3.20", "3.21", "3.23", "3.24"),
        "loose_env.diagnosis.static_force.tool_acceleration",
    ),
    "3.10": "loose_env.diagnosis.static_force.joint_torques",
    "3.11": "loose_env.diagnosis.inertia.seated_inertia",
    **dict.fromkeys(("3.18", "3.19"), "loose_env.diagnosis.docked.simulate_docked"),
    "3.22": "loose_env.diagnosis.static_force.docked_acceleration",
    "3.25": "loose_env.diagnosis.static_force.dock_force",
    **dict.fromkeys(("3.35", "3.36"), "loose_env.faults.set_seat"),
}


def _fault() -> StructuralLooseness:
    return StructuralLooseness(
        link=2,
        direction=DIRECTION,
        gap=GAP,
        stiffness=(2e5, 2e5),
        damping=(20.0, 20.0),
        friction=0.1,
    )


def _weigh(arm: Arm, seed: int, k: int) -> list[Weighing]:
    """Weigh the alternatives in each pose; rms over the poses."""
    runs = [
        weigh_alternatives(
            arm, np.array([0.3, q]), _fault(), np.random.default_rng([seed, 10 * k + p])
        )
        for p, q in enumerate(POSES)
    ]

    def mean(pick: Sequence[float]) -> float:
        return float(np.sqrt(np.mean(np.square(pick))))

    return [
        Weighing(
            name=same[0].name,
            measures=same[0].measures,
            unit=same[0].unit,
            gap=mean([w.gap for w in same]),
            noise=mean([w.noise for w in same]),
            model=mean([w.model for w in same]),
        )
        for same in zip(*runs, strict=True)
    ]


def _opening() -> str:
    s = AlternativeSettings()
    suite = s.sensors
    return (
        "Every model of an arm predicts one measured quantity from others. What is left over, the "
        "disagreement, holds three things: what a loose seat does, the noise of the sensors, and "
        "what the model leaves out. The thesis lists seven models and weighs them in words. Here "
        f"each is computed on the same two simulated arms with a gap of {GAP * 1e3:g} mm in "
        f"link 2, in {len(POSES)} poses. Sensors: encoders with "
        f"{suite.encoder.noise * 1e6:.0f} µrad rms and {suite.encoder.resolution * 1e6:.1f} µrad "
        f"steps, an accelerometer with {suite.accelerometer.noise_density / 9.80665e-6:.0f} µg "
        f"per √Hz, a tracker with {s.tracker_noise * 1e6:.0f} µm, a force sensor with "
        f"{s.force_noise:g} N and joint torques known to {100 * s.torque_noise:g} % of their "
        "peak. The last three are assumed."
    )


def _verdicts(flexible: list[Weighing], stiff: list[Weighing], chosen: Sequence[str]) -> list[str]:
    hidden = [w.name for w in flexible if w.against_all < 1]
    best = max(flexible, key=lambda w: w.against_all)
    stiff_hidden = [w.name for w in stiff if w.against_all < 1]
    stiff_best = max(stiff, key=lambda w: w.against_all)
    by_name = {w.name: w for w in flexible}
    lost = [name for name in chosen if by_name[name].against_all < 1]
    noisy = [w.name for w in flexible if w.against_noise < 1]
    first = (
        f"On the stiff arm the gap stands out in {len(stiff) - len(stiff_hidden)} of "
        f"{len(stiff)} models"
        + (f" (not in: {', '.join(stiff_hidden)})" if stiff_hidden else "")
        + f"; most in {stiff_best.name}, {stiff_best.against_all:.0f} times what else is in the "
        f"disagreement. On VERA, which is shaken less and bends inside the band, it stands above "
        f"sensor noise in {len(flexible) - len(noisy)} of {len(flexible)}, but above noise and "
        f"model error together in {len(flexible) - len(hidden)}."
        + (f" Hidden there: {', '.join(hidden)}." if hidden else "")
        + f" Best there: {best.name}, {best.against_all:.0f} times."
    )
    second = (
        f"The thesis chose {' and '.join(chosen)}, for their linearity and their cheap sensors. "
        + (
            f"Taken as absolute predictions, {' and '.join(lost)} would hide the gap on VERA: the "
            "bending of link 1 disagrees more than the gap does. This is no objection to the "
            "thesis's statistics, which compare the same arm before and after; it says that the "
            "healthy arm must be measured, not computed from rigid kinematics."
            if lost
            else "Both hold on VERA as well, as absolute predictions."
        )
    )
    return [first, second]


def _carried(seed: int) -> str:
    """Share of slow joint torque that the docked tool does not get, at two levels."""
    arm, pose = vera(), np.array([0.3, POSES[1]])
    s = AlternativeSettings()
    chain = Chain.of(arm, pose)
    shares = []
    levels = (s.slow_share, 5 * s.slow_share)
    for level in levels:
        torque = torque_signals(
            Excitation(
                torque_rms=tuple(level * t for t in arm.torque_limits),
                duration=s.duration,
                band=s.slow_band,
            ),
            timestep=arm.timestep,
            before=0,
            after=0,
            rng=np.random.default_rng([seed, 200]),
        )
        record = simulate_docked(arm, pose, _fault(), torque, jig="pin")
        rest = record.torques + joint_torques(geometric_jacobian(chain)[:2], record.forces)
        count = rest.shape[1]
        inside = slice(round(s.slow_band[0] * s.duration), round(s.slow_band[1] * s.duration) + 1)
        missing, played = (
            float(np.sum(np.abs(np.fft.rfft(x)[:, inside] / count) ** 2))
            for x in (rest, record.torques)
        )
        shares.append(float(np.sqrt(missing / played)))
    return (
        f"In the static test, with torques of {100 * levels[0]:g} % of the peak, "
        f"{100 * shares[0]:.0f} % of the slow torque (rms) never reaches the jig: "
        "it moves the arm across the gap. A seat "
        f"pressed on a stop carries force again; at {100 * levels[1]:g} % of the peak "
        f"{100 * shares[1]:.0f} % is missing. "
        + (
            "The test wants small torques, as long as they overcome the friction of the guide."
            if shares[1] < shares[0]
            else "Here that makes no difference."
        )
    )


def _what_table() -> Table:
    return Table(
        caption="The seven alternatives (3.2.1) and what each has to measure.",
        columns=("alternative", "equation", "measured"),
        rows=tuple(
            (name, equation, measures)
            for name, equation, (measures, _) in zip(
                ALTERNATIVES, _EQUATIONS, MEASURES, strict=True
            )
        ),
    )


def _weighing_table(weighed: list[Weighing], arm: str) -> Table:
    return Table(
        caption=f"{arm}: rms disagreement from the gap, from sensor noise and from what the "
        "model leaves out. Ratios: gap over noise, and gap over noise and model error.",
        columns=("alternative", "gap", "noise", "model", "unit", "gap / noise", "gap / all"),
        rows=tuple(
            (
                w.name,
                f"{w.gap:.2g}",
                f"{w.noise:.2g}",
                f"{w.model:.2g}",
                w.unit,
                f"{w.against_noise:.2g}" if w.against_noise < 10 else f"{w.against_noise:.0f}",
                f"{w.against_all:.2g}" if w.against_all < 10 else f"{w.against_all:.0f}",
            )
            for w in weighed
        ),
    )


def _columns() -> tuple[Table, str]:
    chain = Chain.of(planar(4), [0.2, 0.5, -0.8, 0.6])
    rows, right, world_distal, base_proximal = [], 0, True, True
    largest = 0.0
    for link in range(1, chain.n + 1):
        loose = displaced(chain, link, [0.6, 0.8, 0.0], GAP / 2)
        cells = [str(link)]
        for frame, _ in _FRAMES:
            before, after = geometric_jacobian(chain, frame), geometric_jacobian(loose, frame)
            changed = changed_columns(before, after, tolerance=1e-9)
            cells.append(", ".join(str(k + 1) for k in np.flatnonzero(changed)) or "none")
            if frame == "tool":
                right += link_of_changed_columns(changed, frame) == link
                moved, whole = (after - before)[:3], before[:3]
                share = np.linalg.norm(moved, axis=0) / np.linalg.norm(whole, axis=0)
                largest = max(largest, float(share.max()))
            if frame == "base":
                base_proximal &= not changed[:link].any()
            if frame == "world":
                world_distal &= bool(changed[:link].all() and not changed[link:].any())
        rows.append(tuple(cells))
    words = (
        f"A seat that stands at its stop, {GAP / 2 * 1e3:g} mm off, changes columns of the "
        "Jacobian. In tool coordinates the columns beyond the seat stay, as the thesis says, and "
        f"the last column that changes names the link ({right} of {chain.n} here). For world "
        "coordinates the thesis says that the columns before the seat stay (3.33). That is so "
        "for their axes"
        + (", and for the twist at the world's origin; " if base_proximal else "; ")
        + (
            "for the velocity of the tool point, which (3.29) gives, a slide does the opposite: "
            "the columns before it change, because the tool point moves, and those beyond stay. "
            if world_distal
            else "at the tool point the columns change without such an order. "
        )
        + f"The largest change of a column's linear part is {100 * largest:.2g} %: the Jacobian "
        "must be known better than that to find the link this way."
    )
    return (
        Table(
            caption="Columns that change when the seat of a link stands at its stop; planar arm "
            "of four links (3.33).",
            columns=("loose link", *(name for _, name in _FRAMES)),
            rows=tuple(rows),
        ),
        words,
    )


def _ranks(told: dict[str, object]) -> tuple[Table, str]:
    rows, gains = [], {}
    for n in (2, 3, 4):
        chain = Chain.of(planar(n), np.linspace(0.3, 0.9, n))
        rank = [
            int(np.linalg.matrix_rank(geometric_jacobian(c)[[0, 1, 5]]))
            for c in (
                chain,
                insert_looseness(chain, n, [0.6, 0.8, 0.0]),
                insert_looseness(chain, n, [0, 0, 1], kind="revolute"),
            )
        ]
        gains[n] = (rank[1] - rank[0], rank[2] - rank[0])
        added = f"+{told['rank_added_by_slide']}" if n == 2 else "not said"
        rows.append((f"{n} joints", *map(str, rank), added, f"+{told['rank_added_by_backlash']}"))
    full = [n for n, gain in gains.items() if gain[0] == 0]
    words = (
        "A slide may add a dimension to the tool's motion, play in a joint adds none: with two "
        f"joints the rank grows by {gains[2][0]} and {gains[2][1]} (printed: "
        f"{told['rank_added_by_slide']} and {told['rank_added_by_backlash']})."
        + (
            f" With {' and '.join(map(str, full))} joints a planar arm has all three motions "
            "already, and the rank says nothing."
            if full
            else ""
        )
    )
    return (
        Table(
            caption="Rank of the planar Jacobian: nominal, with a slide, with play in a joint.",
            columns=("arm", "nominal", "slide", "play", "printed: slide", "printed: play"),
            rows=tuple(rows),
        ),
        words,
    )


def _inertia(seed: int, told: dict[str, object]) -> tuple[Table, str, Plate]:
    rows, points = [], []
    worst = {"slide": 0.0, "play": 0.0}
    for a, arm in enumerate((planar(4), vera())):
        rng = np.random.default_rng([seed, 100 + a])
        poses = [arm.random_pose(rng) for _ in range(_INERTIA_POSES)]
        nominal = [condition_of(seated_inertia(arm, q, Healthy())) for q in poses]
        rows.append((f"{arm.name}, nothing loose", *_medians(nominal), "–"))
        for link in range(1, arm.n + 1):
            slide = StructuralLooseness(
                link=link, direction=(0.6, 0.8, 0.0), gap=GAP, stiffness=(1e5, 1e5)
            )
            found = [condition_of(seated_inertia(arm, q, slide)) for q in poses]
            worst["slide"] = max(worst["slide"], float(np.median([c.scaled for c in found])))
            rows.append((f"{arm.name}, slide at link {link}", *_medians(found), "–"))
        for joint in range(1, arm.n + 1):
            play = Backlash(joint=joint, gap=1e-4, stiffness=(1e4, 1e4))
            matrices = [seated_inertia(arm, q, play) for q in poses]
            found = [condition_of(m) for m in matrices]
            worst["play"] = max(worst["play"], float(np.median([c.scaled for c in found])))
            ratio = float(np.median([m[joint - 1, joint - 1] / m[-1, -1] - 1 for m in matrices]))
            points.append((arm.name, joint, ratio))
            rows.append((f"{arm.name}, play in joint {joint}", *_medians(found), f"{ratio:.2g}"))
    low = min(r for *_, r in points)
    q = np.array([0.3, POSES[1]])
    sizes = [len(seated_inertia(vera(), q, fault)) for fault in (Healthy(), _fault())]
    direct = backlash_condition(low / 100)
    agrees = worst["play"] > worst["slide"]
    words = (
        f"With a seat the inertia matrix of two joints grows from {told['inertia_size_nominal']} "
        f"rows to {told['inertia_size_loose']} (printed), here from {sizes[0]} to {sizes[1]}. "
        "The thesis expects it to be "
        "ill-conditioned for backlash, because a motor has little inertia against its link. The "
        "plain condition number mixes kg and kg·m² and changes with the unit of length, so the "
        "matrix is also scaled to a unit diagonal. Largest median of the scaled figure: "
        f"{worst['play']:.0f} with play, {worst['slide']:.0f} with a slide"
        + (": the order is the thesis's. " if agrees else ": not the order the thesis expects. ")
        + "What decides is the motor side seen through its gear, which multiplies the rotor's "
        f"inertia by the square of the ratio: the motor sides here are {low:.2g} and more of "
        "their links, and one joint with such play has a condition of at most "
        f"{max(backlash_condition(r) for *_, r in points):.0f}; with a tenth of "
        f"the gear ratio it would be up to {direct:.0f}. As an indicator the number needs the "
        "acceleration of the seat itself, which no sensor of the arm gives."
    )
    plate = Plate(
        image=condition_figure(points),
        title="Condition with play in one joint",
        caption="Scaled condition number of one joint with play against the inertia of its motor "
        "side over that of its link side (line, closed form), and where the joints of the two "
        "arms lie on it.",
    )
    return (
        Table(
            caption=f"Condition number of the inertia matrix, medians over {_INERTIA_POSES} "
            "random poses (3.2.2).",
            columns=("arm and seat", "in SI units", "scaled", "motor over link"),
            rows=tuple(rows),
        ),
        words,
        plate,
    )


def _medians(found: Sequence[object]) -> tuple[str, str]:
    raw = float(np.median([c.raw for c in found]))  # type: ignore[attr-defined]
    scaled = float(np.median([c.scaled for c in found]))  # type: ignore[attr-defined]
    return f"{raw:.0f}", f"{scaled:.3g}"
