"""The seven modelling alternatives on two simulated arms: how far a gap stands out (3.2.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.arms import Arm, vera
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import StructuralLooseness
from loose_env.kinematics import Chain, geometric_jacobian
from loose_env.thesis.methods.looseness.modelling_alternatives import (
    ALTERNATIVES,
    MEASURES,
    AlternativeSettings,
    Disagreement,
    compare_alternatives,
)
from loose_env.thesis.methods.looseness.static_force_test import joint_torques, simulate_docked
from loose_env.thesis.rigs.slide import LOOSE_GAP
from loose_env.thesis.shared.sections import Table

DIRECTION = (float(np.cos(np.radians(-15))), float(np.sin(np.radians(-15))), 0.0)
"""Direction of VERA's slide in link 2, -15°."""
POSES = (0.6, 1.2, 1.9)
"""Angles of joint 2 at which the alternatives are compared [rad]."""
_EQUATIONS = ("3.1", "3.3", "3.9", "3.10", "3.17", "none", "3.20")


def loose_seat() -> StructuralLooseness:
    """Return the seat of link 2, loose along VERA's slide."""
    return StructuralLooseness(
        link=2,
        direction=DIRECTION,
        gap=LOOSE_GAP,
        stiffness=(2e5, 2e5),
        damping=(20.0, 20.0),
        friction=0.1,
    )


def compare(arm: Arm, seed: int, k: int) -> list[Disagreement]:
    """Compare the seven alternatives in each pose; rms over the poses.

    The excitation of pose p is drawn from ``[seed, 10 * k + p]``.
    """
    runs = [
        compare_alternatives(
            arm, np.array([0.3, q]), loose_seat(), np.random.default_rng([seed, 10 * k + p])
        )
        for p, q in enumerate(POSES)
    ]

    def mean(pick: Sequence[float]) -> float:
        return float(np.sqrt(np.mean(np.square(pick))))

    return [
        Disagreement(
            name=same[0].name,
            measures=same[0].measures,
            unit=same[0].unit,
            gap=mean([w.gap for w in same]),
            noise=mean([w.noise for w in same]),
            model=mean([w.model for w in same]),
        )
        for same in zip(*runs, strict=True)
    ]


def opening_words() -> str:
    """Say what is compared, on which arms and with which sensors."""
    s = AlternativeSettings()
    suite = s.sensors
    return (
        "Every model of an arm predicts one measured quantity from others. What is left over, the "
        "disagreement, holds three things: what a loose seat does, the noise of the sensors, and "
        "what the model leaves out. The thesis lists seven models and weighs them in words. Here "
        f"each is computed on the same two simulated arms with a gap of {LOOSE_GAP * 1e3:g} mm in "
        f"link 2, in {len(POSES)} poses. Sensors: encoders with "
        f"{suite.encoder.noise * 1e6:.0f} µrad rms and {suite.encoder.resolution * 1e6:.1f} µrad "
        f"steps, an accelerometer with {suite.accelerometer.noise_density / 9.80665e-6:.0f} µg "
        f"per √Hz, a tracker with {s.tracker_noise * 1e6:.0f} µm, a force sensor with "
        f"{s.force_noise:g} N and joint torques known to {100 * s.torque_noise:g} % of their "
        "peak. The last three are assumed."
    )


def verdicts(
    flexible: list[Disagreement], stiff: list[Disagreement], chosen: Sequence[str]
) -> list[str]:
    """Say where the gap stands out, and whether it does in those the thesis chose."""
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


def finding(flexible: list[Disagreement], stiff: list[Disagreement], chosen: Sequence[str]) -> str:
    """Say in one sentence in how many models the gap stands out."""
    count = [sum(w.against_all >= 1 for w in arm) for arm in (stiff, flexible)]
    lost = [w.name for w in flexible if w.name in chosen and w.against_all < 1]
    return (
        f"The gap stands above noise and model error in {count[0]} of {len(stiff)} models on a "
        f"stiff arm and in {count[1]} of {len(flexible)} on VERA; of the two that the thesis "
        f"chose, {len(chosen) - len(lost)} show it there."
    )


def step_words(compared: list[Disagreement], halved: list[Disagreement]) -> str:
    """Sensitivity of the gap's disagreements to halving the simulation step.

    ``compared``, ``halved``: VERA's alternatives under the same excitation, displacement first.
    """
    first, *rest = (abs(h.gap / w.gap - 1) for w, h in zip(compared, halved, strict=True))
    most = max(rest)
    before, after = compared[0], halved[0]
    return (
        f"Halving the simulation step moves VERA's displacement figure from "
        f"{1e6 * before.gap:.0f} to {1e6 * after.gap:.0f} µm, the other alternatives by "
        f"{100 * most:.1g} % at most. "
        + (
            "Displacement counts from the lowest frequency, where the seat wanders slowly from "
            "stop to stop, and a record holds few of these wanderings: its ratio of "
            f"{before.against_all:.2g} ({after.against_all:.2g} with the finer step) is rough."
            if first > max(0.05, most)
            else "None of the ratios hangs on the step here; single records of the displacement, "
            "in which the seat wanders slowly from stop to stop, still may."
        )
    )


def carried_torque(seed: int) -> str:
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
        record = simulate_docked(arm, pose, loose_seat(), torque, jig="pin")
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


def what_table() -> Table:
    """Tabulate what each alternative has to measure."""
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


def disagreement_table(compared: list[Disagreement], arm: str) -> Table:
    """Tabulate the disagreements of one arm and their ratios."""
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
            for w in compared
        ),
    )
