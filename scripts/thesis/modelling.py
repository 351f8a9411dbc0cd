"""Seven models of looseness compared; a loose seat's effect on Jacobian and inertia matrix.

Every alternative predicts one measured quantity from others; what is left over is called the
disagreement. A loose seat changes it, the sensors' noise adds to it, and what the model does not
know is in it even when the arm is healthy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np

from loose_env.arms import Arm, LinearArm, LinearPose, MismatchDraw, planar, vera
from loose_env.envs import MEASURED, MUTED, SHAKEN
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import Backlash, Healthy, StructuralLooseness
from loose_env.kinematics import Chain, Frame, geometric_jacobian
from loose_env.rig import PlantShop
from loose_env.sensors import SensorSuite
from loose_env.typing import Array, ComplexArray
from scripts.charts import Panel, chart, curve, points
from scripts.thesis.loose_joint import (
    Condition,
    backlash_condition,
    changed_columns,
    condition_of,
    displaced,
    insert_looseness,
    joint_torques,
    link_of_changed_columns,
    placed,
    seated_inertia,
    simulate_docked,
)
from scripts.thesis.page import Rows, Section, printed, section
from scripts.thesis.rigs import LOOSE_GAP

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALTERNATIVES = {
    "displacement": ("3.1", "tool place by tracker, joint angles", "m"),
    "velocity": ("3.3", "tool accelerometer integrated, joint angles differenced", "m/s"),
    "acceleration": ("3.9", "tool accelerometer, joint angles differenced twice", "m/s²"),
    "static force": ("3.10", "jig force, joint torques", "N·m"),
    "unconstrained dynamics": ("3.17", "tool accelerometer, joint torques and angles", "m/s²"),
    "flexible dynamics": ("none", "tool accelerometer, joint torques; modes known", "m/s²"),
    "constrained dynamics": (
        "3.20",
        "jig force, joint torques, joint angles differenced twice",
        "N·m",
    ),
}
"""The seven in the thesis's order: equation, measured quantities, unit of the prediction."""
SENSORS = SensorSuite()
TRACKER_NOISE = 20e-6
"""Rms noise of a tool position per axis [m]; assumed, as of a laser tracker."""
FORCE_NOISE = 0.05
"""Rms noise of the jig's force sensor per axis [N]; assumed, as of a six-axis sensor."""
TORQUE_NOISE = 0.005
"""Rms error of a joint's torque, as a share of its peak torque; assumed."""
DURATION, LEVEL = 1.2, 3
"""Length of a record [s], and the excitation level of each joint, from 1."""
SLOW_BAND = (1.0, 10.0)
"""Band of the static-force test [Hz]; friction and inertia hardly matter there."""
SLOW_SHARE = 0.1
"""Rms torque of the static-force test, as a share of the peak torque."""
POSES = (0.6, 1.2, 1.9)
"""Angles of joint 2 at which the alternatives are compared [rad]."""
SEAT = StructuralLooseness(
    link=2,
    direction=(float(np.cos(np.radians(-15))), float(np.sin(np.radians(-15))), 0.0),
    gap=LOOSE_GAP,
    stiffness=(2e5, 2e5),
    damping=(20.0, 20.0),
    friction=0.1,
)
"""The seat of link 2, loose along VERA's slide, -15°."""
_FRAMES: tuple[Frame, ...] = ("tool", "world", "base")
_INERTIA_POSES = 20


class Disagreement(NamedTuple):
    """Rms disagreements of one alternative over its band, in the unit of what it predicts."""

    name: str
    gap: float
    """Change that the gap makes in the disagreement."""
    noise: float
    """Disagreement due to sensor noise."""
    model: float
    """Disagreement of the healthy arm without noise: the model error."""

    @property
    def against_noise(self) -> float:
        """Signal-to-noise ratio of the gap, amplitudes; the model taken as perfect."""
        return self.gap / self.noise

    @property
    def against_all(self) -> float:
        """The same with the model's error counted as noise."""
        return self.gap / float(np.hypot(self.noise, self.model))


class _Free(NamedTuple):
    """Motion of the free arm at every step of a whole period, tool frame of the pose."""

    angle: Array
    place: Array
    acceleration: Array
    torque: Array
    joint: Array


def compare_alternatives(arm: Arm, pose: Array, rng: np.random.Generator) -> list[Disagreement]:
    """Compare the seven alternatives (3.1, 3.3, 3.9, 3.10, 3.17, flexible, 3.20).

    The free arm is shaken in its band, all joints at once. For the two alternatives with a
    constrained tool a pin holds it; the static one is driven slowly. Healthy and loose arm get
    the same torques, and the gap counts by the rms difference of their disagreements, in velocity
    J q' (4.21) as in all others: the loose arm's less the nominal one's (3.34).
    """
    linear = LinearArm(arm).at(pose)
    kinematic, inertia = linear.kinematic, seated_inertia(arm, pose, Healthy())
    run_in = round(arm.settling / arm.timestep)
    slow = Excitation(
        torque_rms=tuple(SLOW_SHARE * t for t in arm.torque_limits),
        duration=DURATION,
        band=SLOW_BAND,
    )
    fast_torque, slow_torque = (
        torque_signals(shake, timestep=arm.timestep, before=run_in, after=0, rng=rng)
        for shake in (_excitation(arm, linear), slow)
    )
    count = fast_torque.shape[1] - run_in
    frequency = np.asarray(np.fft.rfftfreq(count, arm.timestep), dtype=np.float64)

    def spectrum(x: Array) -> ComplexArray:
        return np.asarray(np.fft.rfft(x[..., -count:], axis=-1) / count)

    def rate_of(x: Array) -> ComplexArray:
        """Spectrum of the integrator's own velocities, which are these differences."""
        return spectrum(np.diff(x, prepend=0.0) / arm.timestep)

    states = (Healthy(), SEAT)
    free = [_shake(arm, pose, fault, fast_torque) for fault in states]
    docked = {
        name: [simulate_docked(arm, pose, fault, torque, jig="pin") for fault in states]
        for name, torque in (
            ("static force", slow_torque),
            ("constrained dynamics", fast_torque),
        )
    }
    # The pin's force is in world axes, the Jacobian in those of the tool.
    turn = placed(arm, pose).site(arm.tool).xmat.reshape(3, 3)[:2, :2]
    flexible = _interpolated(linear, frequency)
    forward = kinematic @ np.linalg.inv(inertia)

    def left_over(name: str, k: int) -> ComplexArray:
        m = free[k]
        if name == "displacement":
            return spectrum(m.place - kinematic @ m.angle)
        if name == "velocity":
            return rate_of(m.place) - kinematic @ rate_of(m.angle)
        if name == "acceleration":
            return spectrum(m.acceleration - kinematic @ m.joint)
        if name == "unconstrained dynamics":
            return np.asarray(spectrum(m.acceleration) - forward @ spectrum(m.torque))
        if name == "flexible dynamics":
            predicted = np.einsum("kdm,mk->dk", flexible, spectrum(fast_torque))
            return np.asarray(spectrum(m.acceleration) - predicted)
        held = docked[name][k]
        rest = spectrum(held.torques) + kinematic.T @ turn.T @ spectrum(held.forces)
        if name == "constrained dynamics":
            rest = rest - inertia @ spectrum(held.accelerations)
        return np.asarray(rest)

    density = _noise(arm, kinematic, inertia, flexible, frequency)
    step, found = frequency[1], []
    for name in ALTERNATIVES:
        low, high = SLOW_BAND if name == "static force" else arm.band
        if name == "displacement":  # slow motion of the seat counts as well
            low = 1 / DURATION
        inside = (frequency >= low - 1e-9) & (frequency <= high + 1e-9)
        healthy, loose = left_over(name, 0)[:, inside], left_over(name, 1)[:, inside]
        noise = float(np.sqrt((density[name] + 0 * frequency)[inside].sum() * step))
        found.append(Disagreement(name, _rms(loose - healthy), noise, _rms(healthy)))
    return found


def _rms(lines: ComplexArray) -> float:
    """Rms of a signal vector from its one-sided Fourier lines."""
    return float(np.sqrt(2 * (np.abs(lines) ** 2).sum()))


def _excitation(arm: Arm, linear: LinearPose) -> Excitation:
    """Torques that give the tool the level from each joint, all of them free to move."""
    answer = linear.response([True] * arm.n).tool
    per_torque = np.sqrt(np.mean(np.sum(np.abs(answer) ** 2, axis=1), axis=0))
    torque = np.minimum(arm.levels[LEVEL - 1] / per_torque, np.array(arm.torque_limits) / 3)
    return Excitation(torque_rms=tuple(float(t) for t in torque), duration=DURATION, band=arm.band)


def _shake(arm: Arm, pose: Array, fault: Healthy | StructuralLooseness, torque: Array) -> _Free:
    """Simulate the free arm; every joint driven, none braked."""
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    plant = shop.build(fault, MismatchDraw.none(arm))
    model = plant.model
    data = mujoco.MjData(model)
    data.qpos[plant.indices.position] = plant.hold_at(pose)
    data.eq_active[:] = model.eq_active0
    data.eq_active[plant.indices.brakes] = False
    mujoco.mj_forward(model, data)
    tool = model.site(arm.tool).id
    start, turn = data.site_xpos[tool].copy(), data.site_xmat[tool].reshape(3, 3).copy()
    joints = [model.joint(name) for name in arm.joints]
    dofs = np.array([j.dofadr[0] for j in joints])
    stiffness = model.jnt_stiffness[[j.id for j in joints]]
    steps, n = torque.shape[1], arm.n
    rows = np.empty((steps, 3 * n + 4))
    for k in range(steps):
        data.ctrl[:n] = torque[:, k]
        angle = data.qpos[plant.indices.position] - pose
        passive = stiffness * angle + model.dof_damping[dofs] * data.qvel[dofs]
        mujoco.mj_step(model, data)
        # After the step, site and accelerometer still are those of the state before it.
        moved = ((data.site_xpos[tool] - start) @ turn)[:2]
        net = torque[:, k] - passive
        rows[k] = np.concatenate([angle, moved, data.sensordata[:2], net, data.qacc[dofs]])
    return _Free(*np.split(rows.T, [n, n + 2, n + 4, 2 * n + 4]))


def _interpolated(linear: LinearPose, frequency: Array) -> ComplexArray:
    """Tool acceleration per torque of the flexible model at the record's lines (K, d, m)."""
    answer = linear.response([True] * linear.linear.arm.n)
    out = np.zeros((len(frequency), *answer.tool.shape[1:]), dtype=complex)
    for d, m in np.ndindex(out.shape[1:]):
        h = answer.tool[:, d, m]
        real = np.interp(frequency, answer.frequency, h.real)
        out[:, d, m] = real + 1j * np.interp(frequency, answer.frequency, h.imag)
    return out


def _noise(
    arm: Arm, kinematic: Array, inertia: Array, flexible: ComplexArray, frequency: Array
) -> dict[str, Array]:
    """One-sided density of every disagreement when there is nothing but sensor noise."""
    encoder, accelerometer = SENSORS.encoder, SENSORS.accelerometer
    per_hz = 2 / SENSORS.rate  # one-sided density of a channel of rms 1
    angle = (encoder.noise**2 + encoder.resolution**2 / 12) * per_hz
    sampled = accelerometer.noise_density**2 + accelerometer.resolution**2 / 12 * per_hz
    torque = (TORQUE_NOISE * np.array(arm.torque_limits)) ** 2 * per_hz
    omega = 2 * np.pi * frequency
    forward = kinematic @ np.linalg.inv(inertia)
    axes, lever = len(kinematic), float((kinematic**2).sum())
    force = lever * FORCE_NOISE**2 * per_hz
    return {
        "displacement": np.asarray(axes * TRACKER_NOISE**2 * per_hz + lever * angle),
        "velocity": axes * sampled / np.maximum(omega, 1e-9) ** 2 + lever * angle * omega**2,
        "acceleration": axes * sampled + lever * angle * omega**4,
        "static force": np.asarray(torque.sum() + force),
        "unconstrained dynamics": np.asarray(axes * sampled + float((forward**2 @ torque).sum())),
        "flexible dynamics": axes * sampled + np.einsum("kdm,m->k", np.abs(flexible) ** 2, torque),
        "constrained dynamics": torque.sum() + force + float((inertia**2).sum()) * angle * omega**4,
    }


def compare(arm: Arm, seed: int, k: int) -> list[Disagreement]:
    """Compare in each pose; rms over the poses. The draw of pose p is ``[seed, 10 * k + p]``."""
    runs = [
        compare_alternatives(arm, np.array([0.3, q]), np.random.default_rng([seed, 10 * k + p]))
        for p, q in enumerate(POSES)
    ]
    return [
        Disagreement(
            same[0].name,
            *(float(np.sqrt(np.mean(np.square(x)))) for x in list(zip(*same, strict=True))[1:]),
        )
        for same in zip(*runs, strict=True)
    ]


def carried_torque(seed: int, level: float) -> float:
    """Share of slow joint torque that the docked tool does not get, at a share of the peak."""
    arm, pose = vera(), np.array([0.3, POSES[1]])
    rms = tuple(level * t for t in arm.torque_limits)
    torque = torque_signals(
        Excitation(torque_rms=rms, duration=DURATION, band=SLOW_BAND),
        timestep=arm.timestep,
        before=0,
        after=0,
        rng=np.random.default_rng([seed, 200]),
    )
    record = simulate_docked(arm, pose, SEAT, torque, jig="pin")
    jacobian = geometric_jacobian(Chain.of(arm, pose))[:2]
    rest = record.torques + joint_torques(jacobian, record.forces)
    inside = slice(round(SLOW_BAND[0] * DURATION), round(SLOW_BAND[1] * DURATION) + 1)
    missing, played = (
        float(np.sum(np.abs(np.fft.rfft(x)[:, inside] / rest.shape[1]) ** 2))
        for x in (rest, record.torques)
    )
    return float(np.sqrt(missing / played))


def jacobian_columns() -> tuple[Rows, int, float]:
    """Columns that a seat at its stop changes in three frames (3.33), links named, largest change.

    The change is that of a column's linear part over the column [1].
    """
    chain = Chain.of(planar(4), [0.2, 0.5, -0.8, 0.6])
    rows, right, largest = [], 0, 0.0
    for link in range(1, chain.n + 1):
        loose = displaced(chain, link, [0.6, 0.8, 0.0], LOOSE_GAP / 2)
        cells = [str(link)]
        for frame in _FRAMES:
            before, after = geometric_jacobian(chain, frame), geometric_jacobian(loose, frame)
            changed = changed_columns(before, after)
            cells.append(", ".join(str(k + 1) for k in np.flatnonzero(changed)) or "none")
            if frame == "tool":
                right += link_of_changed_columns(changed, frame) == link
                size = np.linalg.norm(before[:3], axis=0)
                share = np.linalg.norm((after - before)[:3], axis=0) / size
                largest = max(largest, float(share.max()))
        rows.append(cells)
    return rows, right, largest


def jacobian_rank(n: int) -> list[int]:
    """Rank of the planar Jacobian of n joints: nominal, with a slide, with play in a joint."""
    chain = Chain.of(planar(n), np.linspace(0.3, 0.9, n))
    loose = (
        chain,
        insert_looseness(chain, n, [0.6, 0.8, 0.0]),
        insert_looseness(chain, n, [0, 0, 1], kind="revolute"),
    )
    return [int(np.linalg.matrix_rank(geometric_jacobian(c)[[0, 1, 5]])) for c in loose]


def inertia_condition(seed: int) -> tuple[Rows, dict[str, float], list[tuple[str, int, float]]]:
    """Compare the condition of the inertia matrix with a slide and with play in a joint.

    Returns the rows, the largest median of the scaled condition by seat, and by arm and joint its
    motor side over its link side with play [1].
    """
    rows, joints, worst = [], [], {"slide": 0.0, "play": 0.0}

    def medians(found: list[Condition], kind: str = "") -> tuple[str, str]:
        raw, scaled = np.median(found, axis=0)
        worst[kind] = max(worst.get(kind, 0.0), float(scaled))
        return f"{raw:.0f}", f"{scaled:.3g}"

    for a, arm in enumerate((planar(4), vera())):
        rng = np.random.default_rng([seed, 100 + a])
        poses = [arm.random_pose(rng) for _ in range(_INERTIA_POSES)]
        nominal = [condition_of(seated_inertia(arm, q, Healthy())) for q in poses]
        rows.append((f"{arm.name}, nothing loose", *medians(nominal), "–"))
        for link in range(1, arm.n + 1):
            slide = replace(SEAT, link=link, direction=(0.6, 0.8, 0.0), stiffness=(1e5, 1e5))
            found = [condition_of(seated_inertia(arm, q, slide)) for q in poses]
            rows.append((f"{arm.name}, slide at link {link}", *medians(found, "slide"), "–"))
        for joint in range(1, arm.n + 1):
            play = Backlash(joint=joint, gap=1e-4, stiffness=(1e4, 1e4))
            matrices = [seated_inertia(arm, q, play) for q in poses]
            cells = medians([condition_of(m) for m in matrices], "play")
            ratio = float(np.median([m[joint - 1, joint - 1] / m[-1, -1] - 1 for m in matrices]))
            joints.append((arm.name, joint, ratio))
            rows.append((f"{arm.name}, play in joint {joint}", *cells, f"{ratio:.2g}"))
    return rows, worst, joints


def modelling(seed: int) -> Section:
    """Reproduce section 3.2: modelling alternatives, Jacobian and inertia matrix."""
    told, arm, step = printed("modelling"), vera(), LOOSE_GAP / 2
    flexible = compare(arm, seed, 0)
    halved = compare(replace(arm, timestep=arm.timestep / 2), seed, 0)
    stiff = compare(planar(2), seed, 1)
    shown = {w.name for w in flexible if w.against_all >= 1}
    chosen = " and ".join(told["alternatives_chosen"])
    counts = [sum(w.against_all >= 1 for w in found) for found in (stiff, flexible)]
    lost = len(set(told["alternatives_chosen"]) & shown)
    hidden = ", ".join(w.name for w in flexible if w.name not in shown)
    above_noise = sum(w.against_noise >= 1 for w in flexible)
    best, stiff_best = (max(found, key=lambda w: w.against_all) for found in (flexible, stiff))
    moved = max(abs(h.gap / w.gap - 1) for w, h in zip(flexible[1:], halved[1:], strict=True))
    strong = 5 * SLOW_SHARE
    missing, missing_strong = carried_torque(seed, SLOW_SHARE), carried_torque(seed, strong)
    columns, right, largest = jacobian_columns()
    ranks = {n: jacobian_rank(n) for n in (2, 3, 4)}
    gains = [rank - ranks[2][0] for rank in ranks[2][1:]]
    matrix_rows, matrix, joints = inertia_condition(seed)
    low = min(r for *_, r in joints)
    play_most = max(backlash_condition(r) for *_, r in joints)
    direct = backlash_condition(low / 100)
    sizes = [len(seated_inertia(arm, [0.3, POSES[1]], fault)) for fault in (Healthy(), SEAT)]
    density = SENSORS.accelerometer.noise_density / 9.80665e-6

    def table(found: list[Disagreement]) -> list[tuple[Any, ...]]:
        both = [(w, (w.against_noise, w.against_all)) for w in found]
        return [
            (w, ALTERNATIVES[w.name][2], *(f"{r:.2g}" if r < 10 else f"{r:.0f}" for r in ratios))
            for w, ratios in both
        ]

    rank_rows = [
        (f"{n} joints", *map(str, rank), "+1" if n == 2 else "not said", "+0")
        for n, rank in ranks.items()
    ]
    return section(
        "modelling",
        locals(),
        [
            [(name, equation, measures) for name, (equation, measures, _) in ALTERNATIVES.items()],
            table(flexible),
            table(stiff),
            columns,
            rank_rows,
            matrix_rows,
        ],
        [ratios_figure(flexible), condition_figure(joints)],
    )


def ratios_figure(compared: Sequence[Disagreement]) -> Figure:
    """Draw two points an alternative: the gap over noise, and over noise and model error."""
    places = -np.arange(len(compared), dtype=float)
    curves = [
        points([w.against_noise for w in compared], places, "over noise", color=MEASURED),
        points(
            [w.against_all for w in compared], places, "over noise and model", "s", color=SHAKEN
        ),
    ]
    ticks = {"yticks": places, "yticklabels": [w.name for w in compared]}
    panel = Panel(curves=curves, marks=[1.0], look=ticks | {"xscale": "log"})
    return chart([panel], across="disagreement from the gap, over the rest", height=2.4)


def condition_figure(joints: Sequence[tuple[str, int, float]]) -> Figure:
    """Draw the closed form of `backlash_condition` and where the joints of the arms lie."""
    ratio = np.logspace(-3, 2, 200)
    curves = [curve(ratio, [backlash_condition(r) for r in ratio], color=MUTED, linewidth=1.8)]
    for name, words, marker, colour in (
        ("planar4", "joints of the four-link arm", "o", MEASURED),
        ("vera", "joints of VERA", "s", SHAKEN),
    ):
        own = [r for n, _, r in joints if n == name]
        curves.append(
            points(own, [backlash_condition(r) for r in own], words, marker, color=colour)
        )
    panel = Panel(title="condition", curves=curves, look={"xscale": "log", "yscale": "log"})
    return chart([panel], across="inertia of motor side over link side", height=2.2)
