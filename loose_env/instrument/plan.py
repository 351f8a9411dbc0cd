"""Plan of a session: poses, levels and the signal, written for the machine that plays it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.arm import SuspectArm, read_arm
from loose_env.instrument.controllers import Controller, adjusted, preset
from loose_env.instrument.motion import MODE_HZ
from loose_env.instrument.poses import (
    Candidate,
    candidate,
    choose_poses,
    is_tested_share,
    tested_share,
)
from loose_env.instrument.records import (
    FEWEST_PERIODS,
    Unusable,
    followed_hz,
    read_motion,
    shares_followed,
)
from loose_env.instrument.result import Diagnosis
from loose_env.instrument.signals import LEAST_BANDWIDTH_HZ, Multisine, multisine
from loose_env.io import JsonFile, json_text, read_result_file, write_text
from loose_env.recording import (
    DESCRIPTION,
    RunEntry,
    read_description,
    read_recording,
    write_csv,
)
from loose_env.recording import FORMAT as RECORDING_FORMAT
from loose_env.typing import Array

FORMAT = "loose-plan/2"
PLAN, RECORDING, MODEL, SWEEP = "plan.json", "recording", "model.xml", "sweep.csv"
_MARGIN = 0.05
"""Share of a joint's range that poses keep from its ends [1]."""
_OCTAVE, _SAMPLES = 2.0, 4.0
"""A sweep reaches an octave beyond the assumed bandwidth, with four commands a cycle or more: fewer
are no sine [1]. Beyond the usual mode of gears the links do not follow their encoders."""
_SEED = 1995
"""Of the phases: the same signal every month, so that sessions compare."""


@dataclass(frozen=True, kw_only=True)
class PlanSettings:
    """Settings of a session.

    Examples
    --------
    >>> PlanSettings(poses=2)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: poses is 3 to 24, got 2
    """

    controller: str = "ur_rtde"
    """Controller that plays the plan: ur_rtde, ros2_jtc, kuka_rsi, franka_fci, fanuc_stream,
    velocity_drive, hobby_servo or plc_csv."""
    commands: str | None = None
    """Kind of command, where it is not the controller's usual: position, velocity or torque."""
    rate_hz: float | None = None
    """Rate of the commands [Hz], where it is not the controller's usual."""
    bandwidth_hz: float | None = None
    """Highest frequency that the joints follow [Hz], where it is known; by default a sweep measures
    it."""
    max_speed_rad_s: tuple[float, ...] = ()
    """Largest speed, one value or one a joint [rad/s; m/s where it slides]."""
    max_acceleration_rad_s2: tuple[float, ...] = ()
    """Largest acceleration, one value or one a joint [rad/s²; m/s² where it slides]."""
    max_jerk_rad_s3: tuple[float, ...] = ()
    """Largest jerk, one value or one a joint [rad/s³; m/s³ where it slides]."""
    max_torque_nm: tuple[float, ...] = ()
    """Peak torque of each drive, where the model states none [N·m; N where it slides]."""
    poses: int = 6
    """Number of poses."""
    levels: tuple[float, ...] = (1.0,)
    """Levels, lowest first, as shares of the limits [1]: the next is played only where the one
    before does not show a knock."""
    low: tuple[float, ...] = ()
    """Lowest position of each joint that poses may take [rad, m]; by default the model's range."""
    high: tuple[float, ...] = ()
    """Highest position of each joint that poses may take [rad, m]."""
    corner_hz: float | None = None
    """Highest frequency that the accelerometer passes [Hz]; by default 0.45 of its rate."""
    reference: bool = False
    """Plan the same runs on a healthy machine too: before the fault, or after the repair."""
    tool: str | None = None
    """Site or body that carries the accelerometer; by default the model's own."""
    package_path: str | None = None
    """Folder of the ROS package in which the meshes of a URDF lie."""
    payload_kg: float = 0.0
    """Mass at the tool that the model lacks [kg]."""
    payload_at_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Its centre in the tool frame, x y z [m]."""

    def __post_init__(self) -> None:
        """Check."""
        if not 3 <= self.poses <= 24:
            raise InvalidSetting(f"poses is 3 to 24, got {self.poses}")
        if not self.levels or not all(0 < x <= 1 for x in self.levels):
            raise InvalidSetting(
                f"levels are shares of the limits, above 0 and at most 1, got {self.levels}"
            )
        if list(self.levels) != sorted(set(self.levels)):
            raise InvalidSetting(f"levels go upwards, each once, got {self.levels}")
        if self.commands not in (None, "position", "velocity", "torque"):
            raise InvalidSetting(f"commands is position, velocity or torque, got {self.commands!r}")
        if self.corner_hz is not None and not self.corner_hz > 0:
            raise InvalidSetting(f"corner_hz is above 0 Hz, got {self.corner_hz!r}")
        if not 0 <= self.payload_kg < np.inf or len(self.payload_at_m) != 3:
            raise InvalidSetting(
                "payload_kg is zero or more, and payload_at_m three numbers, got "
                f"{self.payload_kg!r} and {self.payload_at_m!r}"
            )

    @property
    def limits(self) -> Controller:
        """The controller with what was stated of it."""
        return adjusted(
            preset(self.controller).controller,
            **{each.name: getattr(self, each.name) for each in fields(Controller)},
        )


@dataclass(frozen=True, kw_only=True)
class PlannedRun:
    """A run to be played and recorded."""

    file: str
    """Table of commands, and of the recording."""
    pose: Mapping[str, float]
    """Positions about which it shakes [rad, m where a joint slides]."""
    level: float
    """Share of the limits [1]."""
    condition: str
    """"suspect", or "healthy" for a reference."""
    peak: Mapping[str, float]
    """Peak acceleration of each joint [rad/s², m/s²]."""


@dataclass(frozen=True, kw_only=True)
class Lines:
    """The signal as ``plan.json`` keeps it."""

    period_s: float
    periods: int
    lead_s: float
    excited: tuple[int, ...]
    silent: tuple[int, ...]
    phases: tuple[tuple[float, ...], ...]
    crest: tuple[float, ...]
    tail_s: float = 0.0

    def __post_init__(self) -> None:
        """Check."""
        phases = [phase for row in self.phases for phase in row]
        numbers = (self.period_s, self.lead_s, self.tail_s, *self.crest, *phases)
        lines = (*self.excited, *self.silent)
        if not (
            np.isfinite(numbers).all()
            and min(self.period_s, self.lead_s, *self.crest) > 0
            and self.tail_s >= 0
            and self.periods >= FEWEST_PERIODS
            and self.excited
            and min(lines) > 0
            and len(self.crest) == len(self.phases)
            and all(len(row) == len(self.excited) for row in self.phases)
        ):
            raise InvalidData(
                "a signal has a positive period and lead, no negative tail, 2 periods or more, "
                "positive lines, a phase for each line and a crest for each joint; take the "
                "plan.json that 'loose plan' wrote"
            )

    @classmethod
    def of(cls, signal: Multisine) -> Lines:
        """The same without arrays, to a millionth."""
        return cls(
            period_s=signal.period_s,
            periods=signal.periods,
            lead_s=signal.lead_s,
            tail_s=signal.tail_s,
            excited=tuple(signal.excited.tolist()),
            silent=tuple(signal.silent.tolist()),
            phases=tuple(tuple(row) for row in signal.phases.round(6).tolist()),
            crest=tuple(signal.crest.round(6).tolist()),
        )

    @property
    def signal(self) -> Multisine:
        """The same with arrays."""
        return Multisine(
            period_s=self.period_s,
            periods=self.periods,
            lead_s=self.lead_s,
            tail_s=self.tail_s,
            excited=np.array(self.excited, dtype=np.intp),
            silent=np.array(self.silent, dtype=np.intp),
            phases=np.array(self.phases),
            crest=np.array(self.crest),
        )


@dataclass(frozen=True, kw_only=True)
class Plan(JsonFile):
    """The content of ``plan.json``."""

    noun = "plan"

    model: str
    """Model file that it was made of."""
    joints: tuple[str, ...]
    links: tuple[str, ...]
    settings: PlanSettings
    signal: Lines
    runs: tuple[PlannedRun, ...]
    tested: Mapping[str, float]
    """Place -> share of its directions that the poses test at full level [1]."""
    sweep: PlannedRun | None = None
    """First run, which measures the bandwidth; None where it is known."""
    slides: tuple[str, ...] = ()
    """Joints that slide, among those that turn."""
    hobby: bool = False
    notes: tuple[str, ...] = ()
    format: str = FORMAT

    def __post_init__(self) -> None:
        """Check."""
        if len(self.signal.phases) != len(self.joints):
            raise InvalidData(
                f"the signal is for {len(self.signal.phases)} joints, and the plan has "
                f"{', '.join(self.joints)}; take the plan.json that 'loose plan' wrote"
            )

    @property
    def untested(self) -> tuple[str, ...]:
        """Places that the poses do not test in full."""
        return tuple(p for p, share in self.tested.items() if not is_tested_share(share))

    def signal_of(self, run: PlannedRun) -> Multisine:
        """Signal that a run plays."""
        if run == self.sweep:
            return _sweep_signal(len(self.joints), self.settings.limits)
        return self.signal.signal

    @property
    def seconds(self) -> float:
        """Time of shaking of the runs under test [s]."""
        runs = [r for r in self.runs if r.condition == "suspect"]
        return len(runs) * self.signal.signal.seconds


def plan(
    model: str | Path,
    settings: PlanSettings | None = None,
    *,
    known: Diagnosis | None = None,
    first: int = 1,
) -> tuple[Plan, SuspectArm]:
    """Plan a session: which poses, which levels, which signal.

    Parameters
    ----------
    model : str or Path
        MJCF or URDF of a serial arm on a fixed base.
    settings : PlanSettings, optional
        Controller, limits, poses.
    known : Diagnosis, optional
        What a session found: the poses then test what was not tested, or tell the places that are
        still open apart.
    first : int
        Number of the first run; from 2 on, where runs are measured already, no sweep is planned.

    Returns
    -------
    Plan
        What ``plan.json`` holds.
    SuspectArm
        The arm it was made for.

    Raises
    ------
    InvalidData, InvalidSetting, UnknownName
        If there is no such arm, or no pose in the room.

    Examples
    --------
    >>> from loose_env.arms import SIX_AXIS_SERVO_ARM
    >>> made, arm = plan(SIX_AXIS_SERVO_ARM, PlanSettings(controller="ros2_jtc", poses=3))
    >>> len(made.runs), round(made.seconds, 1), arm.joints[0]
    (3, 16.8, 'joint1')
    """
    own = settings or PlanSettings()
    arm = read_arm(
        model,
        tool=own.tool,
        package=own.package_path,
        payload_kg=own.payload_kg,
        payload_at_m=own.payload_at_m,
    )
    limits = own.limits
    low, high = _room(arm, own)
    signal = multisine(arm.n, limits.bandwidth_hz, np.random.default_rng(_SEED))
    wanted = () if known is None else _open_places(arm, known)
    rng = np.random.default_rng([_SEED, first])
    chosen = choose_poses(arm, signal, limits, own.poses, rng, low=low, high=high, wanted=wanted)
    runs = _runs(arm, chosen, own, first)
    share = tested_share(np.array([c.reversing for c in chosen]), arm.n)
    sweep = None
    if own.bandwidth_hz is None and limits.commands != "torque" and known is None and first == 1:
        wide = _sweep_signal(arm.n, limits)
        peak = candidate(arm, chosen[0].pose, wide, limits).peak
        sweep = _run(arm, SWEEP, chosen[0].pose, own.levels[0], "suspect", peak)
    made = Plan(
        model=Path(model).name,
        joints=arm.joints,
        links=arm.links,
        settings=own,
        signal=Lines.of(signal),
        runs=runs,
        tested=dict(zip(arm.places, share.round(3).tolist(), strict=True)),
        sweep=sweep,
        slides=tuple(j for j, slide in zip(arm.joints, arm.slides, strict=True) if slide),
        hobby=preset(own.controller).hobby,
        notes=arm.notes,
    )
    return made, arm


def _room(arm: SuspectArm, own: PlanSettings) -> tuple[Array, Array]:
    """Lowest and highest pose, within the model's ranges less a margin."""
    wide = np.where(arm.slides, np.inf, np.pi)
    margin = _MARGIN * (arm.high - arm.low)
    low, high = np.maximum(arm.low + margin, -wide), np.minimum(arm.high - margin, wide)
    for name, given in (("low", own.low), ("high", own.high)):
        if given and len(given) != arm.n:
            raise InvalidSetting(
                f"{name} has one position for each of {', '.join(arm.joints)}; got {len(given)}"
            )
    low = np.maximum(low, own.low) if own.low else low
    high = np.minimum(high, own.high) if own.high else high
    if not (low < high).all():
        j = int((low >= high).argmax())
        raise InvalidSetting(
            f"joint {arm.joints[j]} has no room: {low[j]:.3g} to {high[j]:.3g}; widen --low, --high"
        )
    return low, high


def _open_places(arm: SuspectArm, known: Diagnosis) -> list[int]:
    """Numbers of the places that a diagnosis left open."""
    if known.verdict == "loose":
        names = {p.name for p in known.places if p.verdict in ("loose", "suspect")}
    else:
        names = set(known.untested)
    if not {p.name for p in known.places} <= set(arm.places):
        raise InvalidData(
            f"the diagnosis is of another arm, with {known.places[0].name}; this one has "
            f"{', '.join(arm.places)}: give the diagnosis of a session of this model"
        )
    return [k for k, place in enumerate(arm.places) if place in names]


def _runs(
    arm: SuspectArm, chosen: Sequence[Candidate], own: PlanSettings, first: int
) -> tuple[PlannedRun, ...]:
    found = []
    for condition, stem in (("suspect", "run"), ("healthy", "reference"))[: 1 + own.reference]:
        number = first
        for level in own.levels:
            for one in chosen:
                file = f"{stem}-{number:02d}.csv"
                found.append(_run(arm, file, one.pose, level, condition, one.peak))
                number += 1
    return tuple(found)


def _run(
    arm: SuspectArm, file: str, pose: Array, level: float, condition: str, peak: Array
) -> PlannedRun:
    """Run in a pose, at a share of the peaks at full level (n,)."""
    return PlannedRun(
        file=file,
        pose=dict(zip(arm.joints, pose.round(4).tolist(), strict=True)),
        level=level,
        condition=condition,
        peak=dict(zip(arm.joints, (level * peak).round(4).tolist(), strict=True)),
    )


def _sweep_signal(n: int, limits: Controller) -> Multisine:
    """Signal of the sweep for n joints."""
    known = max(limits.bandwidth_hz, MODE_HZ)
    highest = min(_OCTAVE * limits.bandwidth_hz, limits.rate_hz / _SAMPLES, known)
    return multisine(n, max(highest, LEAST_BANDWIDTH_HZ), np.random.default_rng(_SEED))


def swept(folder: Path) -> tuple[float, str] | None:
    """Bandwidth that the sweep of a session measured, as `PlanSettings.bandwidth_hz` takes it.

    Parameters
    ----------
    folder : Path
        The session.

    Returns
    -------
    (float, str) or None
        Highest line that the joints follow by half their commands [Hz], and a sentence on it; None
        where no sweep is measured, or runs of the plan are already.

    Raises
    ------
    InvalidData
        If the sweep cannot be used.
    """
    recording = folder / RECORDING
    if not (folder / PLAN).is_file() or not (recording / DESCRIPTION).is_file():
        return None
    made, measured = read_plan(folder), _measured(recording)
    if made.sweep is None or [is_sweep(e.file) for e in measured] != [True]:
        return None
    found, signal = read_recording(recording), made.signal_of(made.sweep)
    file = recording / measured[0].file
    motion = read_motion(read_arm(found.model_path), found.runs[0], signal)
    again = f"play {SWEEP} again, or state --bandwidth-hz"
    if isinstance(motion, Unusable):
        raise InvalidData(f"{file}: {motion.why}; {again}")
    shares = shares_followed([motion.lines], [made.sweep.peak], signal, made.joints)
    hertz = followed_hz(shares, signal)
    if not hertz:
        none = "the joints follow none of its lines by half their commands"
        raise InvalidData(f"{file}: {none}; {again}")
    each = zip(made.joints, shares.T[:, :, None], strict=True)
    still = [joint for joint, own in each if not followed_hz(own, signal)]
    assumed = made.settings.limits.bandwidth_hz
    said = f"{SWEEP}: the joints follow half their commands up to {hertz:g} Hz"
    if still:
        said += f", and {' and '.join(still)} none of them: see drive and encoder"
    if hertz < LEAST_BANDWIDTH_HZ:
        said += f", and the runs need {LEAST_BANDWIDTH_HZ:g} Hz, more than they follow"
    return max(hertz, LEAST_BANDWIDTH_HZ), f"{said}; {assumed:g} Hz were assumed"


def is_sweep(file: str) -> bool:
    """Whether a run is the sweep, whatever the format of its table."""
    return Path(file).stem == Path(SWEEP).stem


def _measured(recording: Path) -> list[RunEntry]:
    """Runs of a recording whose tables are there, of whatever format."""
    entries = read_description(recording / DESCRIPTION).runs
    return [entry for entry in entries if (recording / entry.file).is_file()]


def commands_of(made: Plan, arm: SuspectArm, run: PlannedRun) -> tuple[Array, Array]:
    """Times (T,) and commands (T, n) of a run, in the controller's kind and rate."""
    limits = made.settings.limits
    pose = arm.pose_of(dict(run.pose))
    peak = np.array([run.peak[j] for j in arm.joints])
    inertia = arm.at(pose).inertia
    signal = made.signal_of(run)
    played = signal.played(peak, limits.commands, pose, inertia, limits.rate_hz)
    return np.arange(len(played)) / limits.rate_hz, played


def write_plan(folder: Path, made: Plan, arm: SuspectArm) -> list[Path]:
    """Write ``plan.json``, a table of commands for each run, and the recording to be filled.

    Runs that were measured under an earlier plan of the same arm stay in the recording.

    Raises
    ------
    InvalidData
        If the folder holds the recording of another arm, or runs of another signal.
    """
    recording = folder / RECORDING
    kept: list[PlannedRun] = []
    if (recording / DESCRIPTION).exists():
        model = recording / MODEL
        if not model.is_file() or model.read_text("utf-8") != arm.recording_model.xml:
            raise InvalidData(
                f"{recording}: the recording there was planned with another model, tool or "
                "payload; give another --out"
            )
        earlier = read_plan(recording)
        known = {Path(run.file).stem: run for run in earlier.runs}
        for entry in _measured(recording):
            if is_sweep(entry.file):
                continue
            pose, condition = dict(entry.pose or {}), entry.condition
            other = PlannedRun(file=entry.file, pose=pose, level=1.0, condition=condition, peak={})
            run = known.get(Path(entry.file).stem, other)
            kept.append(replace(run, file=entry.file))
        if kept and earlier.signal != made.signal:
            raise InvalidData(
                f"{recording}: its runs were planned with another signal, up to "
                f"{earlier.signal.signal.hertz.max():g} Hz where this one reaches "
                f"{made.signal.signal.hertz.max():g} Hz; plan with the same controller and "
                "bandwidth, or give another --out"
            )
        taken = {Path(run.file).stem: run.file for run in kept}
        clash = [taken[stem] for run in made.runs if (stem := Path(run.file).stem) in taken]
        if clash:
            raise InvalidData(
                f"{recording}: {clash[0]} is measured already; plan(..., first=K) begins with "
                "another number"
            )
    sweep = () if made.sweep is None else (made.sweep,)
    whole = replace(made, runs=(*kept, *made.runs))
    written = [write_text(recording / MODEL, arm.recording_model.xml)]
    description = {
        "format": RECORDING_FORMAT,
        "model": MODEL,
        "runs": [_entry(run) for run in (*sweep, *whole.runs)],
    }
    written.append(write_text(recording / DESCRIPTION, json_text(description)))
    kind = made.settings.limits.commands
    for run in (*sweep, *made.runs):
        if run.condition == "healthy":
            continue
        time, played = commands_of(made, arm, run)
        columns = {"time": time, **{f"{kind}.{j}": played[:, k] for k, j in enumerate(arm.joints)}}
        path = folder / run.file
        write_csv(path, columns)
        written.append(path)
    return [*written, whole.write(recording / PLAN), whole.write(folder / PLAN)]


def _entry(run: PlannedRun) -> dict[str, object]:
    return {
        "file": run.file,
        "pose": dict(run.pose),
        "condition": run.condition,
        "planned": True,
    }


def read_plan(folder: Path) -> Plan:
    """Read ``plan.json`` of a session, or of its recording.

    Raises
    ------
    InvalidData
        If there is none, or it is none of the format.
    """
    place = folder / PLAN if folder.is_dir() else folder
    if not place.is_file() and (folder.parent / PLAN).is_file():
        place = folder.parent / PLAN
    if not place.is_file():
        raise InvalidData(
            f"{folder}: there is no {PLAN}; a diagnosis needs runs of a plan: "
            "loose plan MODEL --out SESSION"
        )
    return read_result_file(place, Plan.from_json, noun="plan")


def next_number(folder: Path) -> int:
    """Number of the first run to come in a session's folder."""
    if not (folder / RECORDING / DESCRIPTION).exists():
        return 1
    named = [re.search(r"-(\d+)$", Path(e.file).stem) for e in _measured(folder / RECORDING)]
    return max((int(number[1]) for number in named if number), default=0) + 1
