"""Plan of runs whose tool is struck or shaken: pose, directions of force, way to the pose.

A force along u at the tool makes the joints move by x = Z⁻¹ J_xᵀ u, and the closed seat of a link
transmits Q = M_sx a_x - J_sᵀ u. With the rms force F it opens against its static load W by about
min(1, (F |Q| / 0.6 W)²), as one that a drive excites. The pose is taken in which that is largest,
summed over the links, with one direction of the force for each half of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.arms import LinearPose
from loose_env.errors import InvalidSetting
from loose_env.excitation import Excitation, torque_signals
from loose_env.instrument.model.clearance import Ground
from loose_env.instrument.model.holding_commands import why_not_held
from loose_env.instrument.model.instrumented_arm import InstrumentedArm, read_arm
from loose_env.instrument.model.motion_limits import MotionLimits, motion_limits
from loose_env.instrument.planning.candidate_poses import candidate_poses
from loose_env.instrument.planning.excitation import limited
from loose_env.instrument.planning.signals.transit import Transit, transit
from loose_env.instrument.result import Diagnosis
from loose_env.instrument.settings.arm_and_plan import ExcitationKind, ModelSettings, PlanSettings
from loose_env.instrument.settings.command_line import unlike
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.instrument.settings.thresholds import OPENING_FORCE
from loose_env.typing import Array

_DIRECTIONS: Mapping[str, tuple[float, float, float]] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
"""Directions of the force in the tool frame: faces of a tool that a hammer can reach."""
_LEAST_RUNS = 2
_POINTS = 24
_NEW_POSE = 0.2
"""Largest difference of a joint from which a pose is another one [rad or m]."""


@dataclass(frozen=True, kw_only=True)
class ToolRun:
    """Run whose tool is struck or shaken along one direction."""

    name: str
    """Direction in words: an axis of the tool frame with its sign."""
    direction: tuple[float, float, float]
    """The same as a unit vector of the tool frame."""
    opens: Mapping[str, float]
    """Link -> expected opening of its seat at the planned force, 0 shut to 1 free."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolPlan:
    """Plan of runs with a measured force on the tool, all in one pose."""

    arm: InstrumentedArm
    """The arm, with a sensor for the force."""
    kind: ExcitationKind
    """Hammer or shaker."""
    pose: Array
    """Joint positions [rad or m] (n,)."""
    runs: tuple[ToolRun, ...]
    """Directions, the one that opens most first."""
    band_hz: tuple[float, float]
    """Band in which the force has to act [Hz]."""
    seconds: float
    """Length of each run [s]."""
    rate_hz: float
    """Samples per second of the recorder [Hz]."""
    force_n: float
    """Rms force while it acts [N]."""
    signal: Mapping[str, Array] | None
    """Columns of a shaker's signal: time [s] and force.tool [N]; None for a hammer."""
    limits: MotionLimits
    """Limits of the way to the pose."""
    transit: Transit
    """The way to the pose."""
    start_origin: str
    """Origin of the present pose."""
    warnings: tuple[str, ...]
    """Warnings, in sentences."""
    settings: Mapping[str, Any]
    """Everything that the plan depends on."""
    again: Mapping[str, Any]
    """Settings that the next plan has to be given again."""

    @property
    def next_pose(self) -> dict[str, float]:
        """Pose by the joints' names."""
        return self.arm.by_joint(self.pose)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a measured run."""
        made = self.arm.recording_model
        sensors = (str(self.arm.tool_force), made.accelerometer)
        return (
            "time",
            *(f"sensor.{name}.{axis}" for name in sensors for axis in "xyz"),
            *(f"sensor.{name}" for name in made.positions),
        )


def plan_tool(
    model: str | Path,
    known: Diagnosis | None = None,
    *,
    arm: ModelSettings,
    choice: NextSettings | None = None,
    own: PlanSettings | None = None,
    motion: MotionSettings | None = None,
) -> ToolPlan:
    """Plan the next pose in which the tool is struck or shaken, and the directions.

    Parameters
    ----------
    model : str or Path
        MJCF or URDF of the arm.
    known : Diagnosis, optional
        Prior knowledge: its poses are not taken again.
    arm : ModelSettings
        Properties that the file lacks, with the kind of excitation.
    choice : NextSettings, optional
        Number of candidate poses, length, rate and band of the runs.
    own : PlanSettings, optional
        Force, pose and runs.
    motion : MotionSettings, optional
        Limits of the way to the pose.

    Raises
    ------
    InvalidSetting, InvalidData
        If the model cannot be used, or no pose will do.

    Examples
    --------
    >>> from loose_env.arms import DESK_ARM
    >>> hammer = ModelSettings(excitation="hammer")
    >>> made = plan_tool(DESK_ARM, arm=hammer, choice=NextSettings(poses=3))
    >>> len(made.runs), made.columns[:2]
    (2, ('time', 'sensor.tool_force.x'))
    """
    rules = choice or (NextSettings() if known is None else known.choice)
    own, motion = own or PlanSettings(), motion or MotionSettings()
    made = read_arm(model, arm)
    limits = motion_limits(made, motion)
    nominal, linear = limited(made.nominal, made.linear, rules)
    measured = [made.pose_of(r.pose) for r in (known.records if known is not None else ())]
    start, origin = made.home, "the model's first keyframe or reference"
    if measured:
        start, origin = measured[-1], "the pose of the last run"
    if own.from_deg:
        start, origin = _typed(made, "from_deg", own.from_deg), "as given"
    ground = Ground.of(nominal, rules.ground_m)

    def allowed(pose: Array) -> bool:
        if any(np.abs(pose - other).max() < _NEW_POSE for other in measured):
            return False
        if not ground.clear(pose) or made.collisions.touch(pose):
            return False
        return not why_not_held(made, pose) and not made.collisions.touch_between(start, pose)

    if own.pose_deg:
        where = np.atleast_2d(_typed(made, "pose_deg", own.pose_deg))
    else:
        rng = np.random.default_rng([rules.seed, len(measured)])
        where = candidate_poses(
            nominal, linear, count=rules.poses, margin=rules.margin, rng=rng, here=start,
            allowed=allowed,
        )  # fmt: skip
    vectors = np.array(list(_DIRECTIONS.values()))
    opens = np.array([_opens(linear.at(q), nominal.band, vectors, own.force_n) for q in where])
    best = int(np.argmax(opens.max(axis=1).sum(axis=1)))
    chosen = _directions(opens[best], max(_LEAST_RUNS, rules.in_turn))
    names = list(_DIRECTIONS)
    runs = tuple(
        ToolRun(
            name=names[k],
            direction=_DIRECTIONS[names[k]],
            opens=dict(zip(made.links, opens[best, k].tolist(), strict=True)),
        )
        for k in chosen
    )
    defaults = (ModelSettings(), NextSettings(), PlanSettings(), MotionSettings())
    given = (arm, rules, own, motion)
    again: dict[str, Any] = {}
    for one, usual in zip(given, defaults, strict=True):
        again |= unlike(one, usual)
    once = ("joint", "pose_deg", "from_deg")
    return ToolPlan(
        arm=made,
        kind=arm.excitation,
        pose=where[best],
        runs=runs,
        band_hz=nominal.band,
        seconds=rules.seconds,
        rate_hz=rules.rate_hz,
        force_n=own.force_n,
        signal=_signal(nominal.band, rules, own) if arm.excitation == "shaker" else None,
        limits=limits,
        transit=transit(made, start, where[best], limits, rules.rate_hz),
        start_origin=origin,
        warnings=_warnings(made, runs),
        settings={k: v for one in given for k, v in asdict(one).items()},
        again={name: value for name, value in again.items() if name not in once},
    )


def _opens(at: LinearPose, band: tuple[float, float], directions: Array, force: float) -> Array:
    """Expected opening of every link's seat by a force along each direction (D, n)."""
    lin, arm = at.linear, at.linear.arm
    joints, slides = lin.joint_dofs, lin.slide_dofs
    jacobian = np.zeros((3, at.jacobian.shape[1]))
    jacobian[list(arm.axes)] = at.jacobian
    push = directions @ jacobian  # (D, nv)
    spring = np.array(arm.centring.stiffness) + np.array(arm.holding.stiffness)
    damper = np.array(arm.centring.damping) + np.array(arm.holding.damping)
    total = np.zeros((len(directions), arm.n))
    for frequency in np.linspace(*band, _POINTS):
        s = 2j * np.pi * frequency
        z = s**2 * at.inertia[np.ix_(joints, joints)] + np.diag(spring + s * damper)
        acceleration = s**2 * np.linalg.solve(z, push[:, joints].T)  # (n, D)
        for i, own in enumerate(slides):
            across = at.inertia[np.ix_(own, joints)] @ acceleration - push[:, own].T
            total[:, i] += np.sum(np.abs(across) ** 2, axis=0) / _POINTS
    load = np.linalg.norm(at.seat_load, axis=1)
    return np.asarray(
        np.minimum(1.0, force**2 * total / np.maximum(OPENING_FORCE * load, 1e-9) ** 2)
    )


def _directions(opens: Array, count: int) -> list[int]:
    """Directions that open most together, one axis once (count,)."""
    found: list[int] = []
    reached = np.zeros(opens.shape[1])
    for _ in range(min(count, len(opens) // 2)):
        taken = {k // 2 for k in found}
        gains = [
            -1.0 if k // 2 in taken else float(np.maximum(reached, own).sum() + 1e-6 * own.sum())
            for k, own in enumerate(opens)
        ]
        found.append(int(np.argmax(gains)))
        reached = np.maximum(reached, opens[found[-1]])
    return found


def _signal(band: tuple[float, float], rules: NextSettings, own: PlanSettings) -> dict[str, Array]:
    """Force of a shaker: band-limited noise between ramps [N]."""
    noise = Excitation(torque_rms=(own.force_n,), duration=rules.seconds, band=band)
    rng = np.random.default_rng([rules.seed, 2])
    force = torque_signals(noise, timestep=1 / rules.rate_hz, before=0, after=0, rng=rng)[0]
    force = force * own.force_n / np.sqrt(np.mean(force**2))
    swell = max(round(own.ramp_s * rules.rate_hz), 1)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(swell) + 0.5) / swell)
    index = np.arange(-swell, len(force) + swell) % len(force)
    envelope = np.concatenate([rise, np.ones(len(force)), rise[::-1]])
    played = envelope * force[index]
    return {"time": np.arange(len(played)) / rules.rate_hz, "force.tool": played}


def _typed(arm: InstrumentedArm, name: str, given: tuple[float, ...]) -> Array:
    """A pose as it was typed in: degrees, and millimetres where a joint slides."""
    if len(given) != arm.n or not np.isfinite(given).all():
        raise InvalidSetting(
            f"{name} has one finite number for each of {', '.join(arm.joints)}, got {given}"
        )
    pose = np.where(arm.nominal.sliding, np.array(given) * 1e-3, np.radians(given))
    if not arm.nominal.within_ranges(pose).all():
        raise InvalidSetting(
            f"{name}: {given} is outside the joints' ranges {arm.nominal.joint_ranges}"
        )
    return np.asarray(pose)


def _warnings(arm: InstrumentedArm, runs: tuple[ToolRun, ...]) -> tuple[str, ...]:
    said = []
    shut = [link for link in arm.links if max(run.opens[link] for run in runs) < OPENING_FORCE**2]
    if shut:
        said.append(
            f"this force opens seats at {', '.join(shut)} little or not at all in this pose: "
            "strike harder (--force-n), or plan a further pose"
        )
    if not arm.collisions.known:
        said.append(
            "the model has no shapes that collide: nothing is known about collisions; look before "
            "the arm moves"
        )
    return tuple(dict.fromkeys((*said, *arm.notes)))
