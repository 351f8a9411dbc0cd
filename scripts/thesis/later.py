"""Studies of the thesis's future work: whitening, compliance, motor signals, sensors, stopping.

Usage: python scripts/thesis/later.py compensation --arms 400
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from scipy.stats import mannwhitneyu
from scipy.stats import t as student

from loose_env.arms import CREST_FACTOR, Arm, LinearArm, LinearPose, planar, servoed, vera
from loose_env.cli.command import Actions, commands
from loose_env.diagnosis import SensorFloor, predict, statistics_of
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import Excitation, Shaping, at_levels
from loose_env.faults import Fault, Healthy
from loose_env.io import Count
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.sensors import LinkAccelerometers, SensorSuite
from loose_env.statistics import acceleration_from_angle, bandpass, shape_of
from loose_env.typing import Array
from scripts.thesis.estimators import transfer_function
from scripts.thesis.loose_joint import placed
from scripts.thesis.shaken_vera import spectral_flatness

DURATION = 1.2
"""Length of a record [s], as in the thesis."""
DRAWS = 2000
"""Resamples of arms for 95 % intervals."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a study."""

    arms: Count = 64
    """Arms of each kind, each with its own fault, mismatch and pose, and a healthy twin."""
    level: Count = 3
    """Excitation level, from 1."""
    seed: int = 0
    """Root of all draws."""


Pair = tuple[Measurement, Measurement]
"""Record of the loose arm and of its healthy twin."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Twins:
    """Loose arms, each with its mismatch, fault and pose, and a healthy twin of each."""

    linear: LinearArm
    rig: SimulatedRig
    faults: Sequence[Fault]
    poses: Sequence[Array]

    @classmethod
    def draw(
        cls,
        arm: Arm,
        count: int,
        seed: Sequence[int],
        *,
        place: str = "structural_looseness@link",
        difficulty: Difficulty | None = None,
        sensors: SensorSuite | None = None,
    ) -> Twins:
        """Draw arms; the loose links or joints take turns."""
        hard, linear = Difficulty() if difficulty is None else difficulty, LinearArm(arm)
        sampler, faults, poses = FaultSampler(linear, hard), [], []
        rig = SimulatedRig(arm, slots=2 * count, sensors=sensors or SensorSuite())
        for k in range(count):
            rng = np.random.default_rng([*seed, k])
            faults.append(sampler.draw(rng, hypothesis=f"{place}{1 + k % arm.n}"))
            mismatch = hard.mismatch.draw(arm, rng)
            rig.mount(2 * k, faults[-1], mismatch)
            rig.mount(2 * k + 1, Healthy(), mismatch)
            poses.append(arm.random_pose(rng))
        return cls(linear=linear, rig=rig, faults=faults, poses=poses)

    def one_joint(
        self,
        joint: int,
        level: float,
        *,
        duration: float = DURATION,
        arms: Sequence[int] | None = None,
    ) -> list[Excitation]:
        """Excitation of one joint (from 0) in arms, by the rms of the nominal tool [m/s²]."""
        levels = np.where(np.arange(self.linear.arm.n) == joint, level, 0.0)
        poses = self.poses if arms is None else [self.poses[k] for k in arms]
        return [at_levels(self.linear.at(q), levels, duration=duration)[0] for q in poses]

    def measure(
        self,
        shakes: Sequence[Excitation],
        seed: Sequence[int],
        *,
        arms: Sequence[int] | None = None,
        more: Sequence[int] = (),
    ) -> list[Pair | None]:
        """Measure pairs, all by default; None where a record failed.

        Draws are ``[*seed, arm, *more, twin]``.
        """
        jobs = [
            Job(
                slot=2 * k + twin,
                pose=self.poses[k].copy(),
                excitation=shake,
                rng=np.random.default_rng([*seed, k, *more, twin]),
            )
            for k, shake in zip(
                range(len(self.poses)) if arms is None else arms, shakes, strict=True
            )
            for twin in (0, 1)
        ]
        found = self.rig.measure_many(jobs)
        pairs = zip(found[::2], found[1::2], strict=True)
        return [None if a.failure or b.failure else (a, b) for a, b in pairs]

    def slide(self, k: int) -> Array:
        """Direction of an arm's slide in the nominal tool's axes, unit vector (d,)."""
        arm, fault = self.linear.arm, self.faults[k]
        data = placed(arm, self.poses[k])
        link = data.body(arm.seat_bodies[fault.link - 1]).xmat.reshape(3, 3)  # type: ignore[union-attr]
        tool = data.site(arm.tool).xmat.reshape(3, 3)
        seen = (tool.T @ link @ np.array(fault.direction))[list(arm.axes)]  # type: ignore[union-attr]
        return np.asarray(seen / np.linalg.norm(seen))


def change_of(pair: Pair, joint: int) -> Array:
    """Change of the tool's transmission from an excited joint (from 0) to the healthy twin (d,)."""
    loose, healthy = (statistics_of(m).transmission_by_instrument[:, joint] for m in pair)
    return np.asarray(loose - healthy)


def angle_deg(one: Array, other: Array) -> float:
    """Angle between two axes [deg], 0 to 90."""
    cosine = abs(float(one @ other)) / float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.degrees(np.arccos(min(cosine, 1.0))))


Compensation = Literal["flat torque", "white joint motion", "white tool motion"]
RANGE = 10.0
"""Largest over smallest amplitude of the shaped torque [1]: so that a deep antiresonance does not
take all the power."""
CLOSE = 20.0
"""Error of a direction that the thesis claims [deg] (6.5.1)."""


def joint_motion(record: Measurement, joint: int) -> Array:
    """Acceleration of a joint (from 0) by its encoder [rad/s²]."""
    return acceleration_from_angle(record.encoder[[joint]], record.rate, record.excitation.band)


def shaping_of(healthy: Measurement, joint: int, kind: Compensation) -> Shaping:
    """Inverse of the transfer function of a healthy flat record, within `RANGE` of its median."""
    rate, (low, high) = healthy.rate, healthy.excitation.band
    motion = joint_motion(healthy, joint) if kind == "white joint motion" else healthy.tool
    found = transfer_function(healthy.command[joint], motion, rate, segments=8)
    inside = (found.frequencies >= low) & (found.frequencies <= high)
    size = np.sqrt(np.sum(np.abs(found.response[:, inside]) ** 2, axis=0))
    inverse = 1 / np.maximum(size, 1e-12 * size.max())
    middle = np.median(inverse)
    inverse = np.clip(inverse, middle / np.sqrt(RANGE), middle * np.sqrt(RANGE))
    return lambda at: np.asarray(np.interp(at, found.frequencies[inside], inverse))


def shaped(flat: Excitation, pose: LinearPose, joint: int, shape: Shaping) -> Excitation:
    """Shape the torque of one joint (from 0) at the same rms motion of the nominal tool."""
    arm = pose.linear.arm
    power = np.sum(np.abs(pose.response(flat.excited).tool[:, :, 0]) ** 2, axis=1)
    weight = shape(pose.linear.frequency) ** 2
    factor = np.sqrt(power.mean() / ((weight * power).mean() / weight.mean()))
    spare = arm.torque_limits[joint] - abs(pose.gravity_torque[joint])
    torque = list(flat.torque_rms)
    torque[joint] = min(torque[joint] * float(factor), spare / CREST_FACTOR)
    shapes = tuple(shape if j == joint else None for j in range(arm.n))
    return replace(flat, torque_rms=tuple(torque), shaping=shapes)


def compensated_errors(settings: Settings) -> dict[Compensation, Array]:
    """Errors of lowest correlation and of the change [deg], and flatness of the joint's motion [1].

    A row (3,) for each excited joint of each arm (cases, 3).
    """
    arm = vera()
    twins = Twins.draw(arm, settings.arms, [settings.seed, 51])
    rows: dict[Compensation, list[tuple[float, ...]]] = {k: [] for k in get_args(Compensation)}
    for joint in range(arm.n):
        flat = twins.one_joint(joint, arm.levels[settings.level - 1])
        reference = twins.measure(flat, [settings.seed, 52, joint, 0])
        for number, kind in enumerate(rows):
            pairs = reference
            if number:
                shakes = [
                    shaped(shake, twins.linear.at(q), joint, shaping_of(pair[1], joint, kind))
                    if pair
                    else shake
                    for shake, q, pair in zip(flat, twins.poses, reference, strict=True)
                ]
                pairs = twins.measure(shakes, [settings.seed, 52, joint, number])
            for k, pair in enumerate(pairs):
                if pair is None:
                    rows[kind].append((np.nan,) * 3)
                    continue
                motion, truth = joint_motion(pair[1], joint)[0], twins.slide(k)
                lowest = angle_deg(statistics_of(pair[0]).lowest_direction, truth)
                flatness = float(spectral_flatness(motion, pair[1].rate, arm.band))
                rows[kind].append((lowest, angle_deg(change_of(pair, joint), truth), flatness))
    return {kind: np.array(found) for kind, found in rows.items()}


def difference(one: Array, other: Array, arms: int, seed: int) -> str:
    """Difference of median errors [deg] and its 95 % interval, by resampling arms."""
    rng = np.random.default_rng([seed, 53])
    pairs = np.stack([one, other]).reshape(2, -1, arms)
    draws = rng.integers(arms, size=(DRAWS, arms))
    found = [np.nanmedian(pairs[:, :, d].reshape(2, -1), axis=1) for d in draws]
    low, high = np.quantile(np.diff(np.array(found), axis=1)[:, 0], [0.025, 0.975])
    return f"{np.nanmedian(other) - np.nanmedian(one):+.1f} ({low:+.1f} to {high:+.1f})"


def compensation(settings: Settings) -> None:
    """Excitation that whitens the motion, by an inverse transfer function, against flat (8.2.2)."""
    found = compensated_errors(settings)
    base = found["flat torque"]
    print(f"VERA, {settings.arms} arms, each joint in turn, level {settings.level}")
    head = ("excitation", "flatness", "direction by", "median error", "within 20 deg", "difference")
    print("{:20s} {:>8s}   {:22s} {:>12s} {:>14s}   {}".format(*head))
    for kind, rows in found.items():
        for column, name in enumerate(("lowest correlation", "change of transmission")):
            errors = rows[:, column]
            turn = difference(base[:, column], errors, settings.arms, settings.seed)
            close = 100 * np.mean(errors < CLOSE)
            print(
                f"{kind:20s} {np.nanmedian(rows[:, 2]):8.2f}   {name:22s} "
                f"{np.nanmedian(errors):12.1f} {close:12.0f} %   {'-' if rows is base else turn}"
            )
    print("difference: of the median error against flat torque [deg], with its 95 % interval")


MODES = (300.0, 150.0, 100.0, 70.0, 30.0, 15.0)
"""Mode of each joint on its servo, all others held [Hz]."""
ESTIMATORS = ("healthy records", "kinematics", "dynamic model")
LEVEL = 3.0
"""Rms acceleration at the nominal tool [m/s²]."""
OPEN = Difficulty(gap=(0.03e-3, 0.4e-3), friction=(0.02, 0.1))
"""Gaps [m] and friction over the seat drive of the top level: seats that open."""


def errors_of(arm: Arm, settings: Settings) -> tuple[Array, float]:
    """Errors of each estimator (arms, estimators) [deg], and the median change of transmission.

    The change is relative to the healthy arm's.
    """
    twins = Twins.draw(arm, settings.arms, [settings.seed], difficulty=OPEN)
    floor = SensorFloor.of(twins.rig.sensors, arm.band)
    shape = (settings.arms, 4, len(arm.axes), arm.n)
    columns = np.full(shape, np.nan)  # loose, healthy, kinematic, modelled
    for joint in range(arm.n):
        shakes = twins.one_joint(joint, LEVEL)
        for k, pair in enumerate(twins.measure(shakes, [settings.seed, 1, joint])):
            if pair is None:
                continue
            at = twins.linear.at(twins.poses[k])
            model = predict(at, shakes[k], floor).transmission_by_instrument[:, 0]
            seen = (statistics_of(m).transmission_by_instrument[:, joint] for m in pair)
            columns[k, :, :, joint] = [*seen, at.kinematic[:, joint], model]
    errors, ratios = [], []
    for k, (loose, *references) in enumerate(columns):
        if np.isfinite(loose).all():
            axes = [np.linalg.svd(loose - other)[0][:, 0] for other in references]
            errors.append([angle_deg(axis, twins.slide(k)) for axis in axes])
            healthy = references[0]
            ratios.append(np.linalg.norm(loose - healthy) / np.linalg.norm(healthy))
    return np.array(errors), float(np.median(ratios))


def compliant_joints(settings: Settings) -> None:
    """Direction of looseness as the joints that hold the arm become compliant (8.2.1).

    Compared are references of healthy records, rigid kinematics and the dynamic model; the tool is
    excited with 3 m/s² rms whatever the level.
    """
    stiff = planar(3)
    print(f"{stiff.name}, {settings.arms} arms a row: median error of the direction [deg] against")
    print(f"{'held by':14s} {'|dB|/|B|':>9s}" + "".join(f"{e:>17s}" for e in ESTIMATORS))
    arms = {"brakes": stiff} | {f"servo {m:.0f} Hz": servoed(stiff, mode_hz=m) for m in MODES}
    for name, arm in arms.items():
        errors, ratio = errors_of(arm, settings)
        middle = "".join(f"{error:17.1f}" for error in np.median(errors, axis=0))
        print(f"{name:14s} {ratio:9.2f}{middle}")


INDICES = ("apparent inertia", "incoherence", "kurtosis of the joint", "tool, transmission")


def indices_of(record: Measurement, twins: Twins, joint: int) -> list[float]:
    """Indices of a record with one joint (from 0) excited, in the order of `INDICES` [1]."""
    found, (low, high) = statistics_of(record), record.excitation.band
    floor = SensorFloor.of(SensorSuite(), twins.linear.arm.band)
    nominal = predict(twins.linear.at(record.pose), record.excitation, floor)
    motion = acceleration_from_angle(record.encoder[joint], record.rate, (low, high))
    answer = transfer_function(record.command[joint], motion, record.rate, segments=8)
    inside = (answer.frequencies >= low) & (answer.frequencies <= high)
    expected = nominal.transmission_by_instrument[:, 0]
    change = found.transmission_by_instrument[:, joint] - expected
    return [
        abs(float(found.inertia[joint] / nominal.inertia[0]) - 1.0),
        1.0 - float(np.mean(answer.coherence[..., inside])),
        float(shape_of(motion)[1]),
        float(np.linalg.norm(change) / np.linalg.norm(expected)),
    ]


def joint_side_indices(arm: Arm, place: str, settings: Settings) -> Array:
    """Largest indices over the joints, of loose arms and of their twins (2, arms, indices)."""
    twins = Twins.draw(arm, settings.arms, [settings.seed, 61], place=place)
    found = np.full((arm.n, 2, settings.arms, len(INDICES)), np.nan)
    for joint in range(arm.n):
        shakes = twins.one_joint(joint, arm.levels[settings.level - 1])
        for k, pair in enumerate(twins.measure(shakes, [settings.seed, 62, joint])):
            if pair is not None:
                found[joint, :, k] = [indices_of(record, twins, joint) for record in pair]
    return np.asarray(np.nanmax(found, axis=0))


def auc(both: Array) -> float:
    """Probability that a loose arm's index exceeds a healthy one's (2, arms), ties as half."""
    return float(mannwhitneyu(*both).statistic / both.shape[1] ** 2)


def joint_side(settings: Settings) -> None:
    """Faults in motor torque and encoder alone, without accelerometer (2.2.2, 4.22-4.26).

    Indices: apparent inertia against the nominal arm, incoherence of joint acceleration and torque,
    excess kurtosis of the joint acceleration; beside them the change of the tool's transmission
    against the nominal arm. The area under the ROC curve (AUC) is the probability that a loose arm
    shows more of an index, its largest over the joints, than a healthy one: 0.5 is chance.
    """
    print(f"AUC (95 % interval), {settings.arms} arms a row, level {settings.level}")
    print("{:10s} {:22s}".format("arm", "fault") + "".join(f"{i:>26s}" for i in INDICES))
    rng = np.random.default_rng([settings.seed, 63])
    for arm in (planar(4), vera()):
        for place in ("structural_looseness@link", "backlash@joint"):
            cells = []
            for both in np.moveaxis(joint_side_indices(arm, place, settings), 2, 0):
                draws = rng.integers(settings.arms, size=(1000, settings.arms))
                low, high = np.quantile([auc(both[:, d]) for d in draws], [0.025, 0.975])
                cells.append(f"{auc(both):.2f} ({low:.2f} to {high:.2f})")
            row = "".join(f"{cell:>26s}" for cell in cells)
            print(f"{arm.name:10s} {place.partition('@')[0]:22s}{row}")


FALSE_ALARMS = 0.05
"""Share of healthy arms that pass the threshold of detection."""


def gains(record: Measurement, joint: int) -> Array:
    """Acceleration of every link (rows) and of the tool per command of a joint (links + 1, 3)."""
    rate, band = record.rate, record.excitation.band
    command = bandpass(record.command[joint], rate, band)
    tool, links = record.tool, record.links
    assert links is not None
    padded = np.zeros((1, links.shape[1], tool.shape[1]))
    padded[0, : len(tool)] = tool
    signals = bandpass(np.concatenate([links, padded]), rate, band)
    return np.asarray(signals @ command / (command @ command))


def sensor_changes(arm: Arm, settings: Settings) -> tuple[Array, Array, Array, Array]:
    """Changes at each sensor of loose and of healthy arms, loose links, and direction errors [deg].

    Changes (arms, links + 1) are root sums of squares over the excited joints, relative to the
    healthy gains.
    """
    every = LinkAccelerometers()
    suite = SensorSuite(link_accelerometers=every)
    twins = Twins.draw(arm, settings.arms, [settings.seed, 71], sensors=suite)
    loose, quiet = np.zeros((2, settings.arms, arm.n + 1))
    tool = np.zeros((settings.arms, arm.n, len(arm.axes)))
    for joint in range(arm.n):
        shakes = twins.one_joint(joint, arm.levels[settings.level - 1])
        first, second = (twins.measure(shakes, [settings.seed, 72, joint, r]) for r in (0, 1))
        for k, (pair, again) in enumerate(zip(first, second, strict=True)):
            if pair is None or again is None:
                continue
            seen, before, after = (gains(m, joint) for m in (*pair, again[1]))
            size = np.linalg.norm(before, axis=1) + 1e-12
            loose[k] += (np.linalg.norm(seen - before, axis=1) / size) ** 2
            quiet[k] += (np.linalg.norm(after - before, axis=1) / size) ** 2
            tool[k, joint] = change_of(pair, joint)
    directions = [np.linalg.svd(change)[2][0] for change in tool]
    errors = np.array([angle_deg(u, twins.slide(k)) for k, u in enumerate(directions)])
    links = np.array([fault.link for fault in twins.faults])  # type: ignore[union-attr]
    return np.sqrt(loose), np.sqrt(quiet), links, errors


def sensors(settings: Settings) -> None:
    """One accelerometer at the tool against one on every link as well (8.3.3, 8.3.4).

    A seat changes what lies beyond it most: the first link whose sensor changes by half of the
    largest change is named. The tool alone sees that something is loose, and its direction, but in
    one pose not where.
    """
    print(f"{settings.arms} arms, each joint in turn in one pose, level {settings.level}")
    print(
        f"{'arm':9s} {'sensors':20s} {'detected':>9s} {'link right':>11s} {'direction error':>16s}"
    )
    for arm in (vera(), planar(4)):
        loose, quiet, links, errors = sensor_changes(arm, settings)
        noise = np.median(quiet, axis=0)  # a sensor that hardly moves scatters most
        for name, sensors in (("tool", [arm.n]), ("tool + all links", list(range(arm.n + 1)))):
            most = loose[:, sensors].max(axis=1)
            seen, healthy = ((x / noise)[:, sensors].max(axis=1) for x in (loose, quiet))
            found = seen > np.quantile(healthy, 1 - FALSE_ALARMS, method="higher")
            # The last sensor is the tool's, which is carried by the last link.
            first = np.argmax(loose[:, sensors] > 0.5 * most[:, None], axis=1)
            named = np.minimum(1 + first, arm.n) if len(sensors) > 1 else np.full(len(links), arm.n)
            right = np.mean(named == links)
            print(
                f"{arm.name:9s} {name:20s} {100 * found.mean():7.0f} % {100 * right:9.0f} % "
                f"{np.median(errors):12.1f} deg"
            )


WANTED = (5.0, 2.0, 1.0, 0.5)
"""Half widths of the interval at which a measurement stops [deg]."""
RECORDS, SECONDS = 24, 0.2
"""Most records of each joint, and their length [s]."""
FIRST = 4
"""Records before the first look: fewer tell little of their scatter."""


def axis_of(change: Array) -> Array:
    """Direction of a change of transmission (d, joints): its largest left singular vector."""
    return np.asarray(np.linalg.svd(change)[0][:, 0])


def half_width(changes: Array) -> float:
    """Half width of the direction's 95 % interval [deg] from records (R, d, joints)."""
    count, pooled = len(changes), axis_of(changes.mean(axis=0))
    left_out = [
        angle_deg(axis_of(np.delete(changes, r, axis=0).mean(axis=0)), pooled) for r in range(count)
    ]
    deviation = np.sqrt((count - 1) / count * np.sum(np.square(left_out)))
    return float(student.ppf(0.975, count - 1) * deviation)


def pooled_changes(settings: Settings) -> tuple[Array, list[Array]]:
    """Changes of transmission of every record (arms, R, d, joints), and the true directions."""
    arm = planar(3)
    twins = Twins.draw(
        arm, settings.arms, [settings.seed, 81], difficulty=Difficulty(friction=(0.02, 0.1))
    )
    shape = (settings.arms, RECORDS, len(arm.axes), arm.n)
    changes = np.zeros(shape)
    for joint in range(arm.n):
        level = arm.levels[settings.level - 1]
        shakes = twins.one_joint(joint, level, duration=SECONDS)
        for r in range(RECORDS):
            for k, pair in enumerate(twins.measure(shakes, [settings.seed, 82, joint, r])):
                if pair is not None:
                    changes[k, r, :, joint] = change_of(pair, joint)
    return changes, [twins.slide(k) for k in range(settings.arms)]


def stopping(settings: Settings) -> None:
    """Measure only until the 95 % interval of the direction is as narrow as wanted (8.1.1).

    Scatter falls with the root of time, so that half the angle takes four times as long; what
    sensors and model get wrong does not fall at all.
    """
    changes, truths = pooled_changes(settings)
    print(f"planar arm of 3 links, {settings.arms} arms, records of {SECONDS:g} s a joint")
    print(f"{'wanted':>8s} {'reached':>9s} {'seconds':>9s} {'median error':>14s} {'within':>8s}")
    for wanted in WANTED:
        reached, spent, errors = [], [], []
        for records, truth in zip(changes, truths, strict=True):
            for count in range(FIRST, RECORDS + 1):
                width = half_width(records[:count])
                if width <= wanted or count == RECORDS:
                    break
            reached.append(width <= wanted)
            spent.append(count * SECONDS)
            errors.append(angle_deg(axis_of(records[:count].mean(axis=0)), truth))
        within = np.mean(np.array(errors) <= wanted)
        print(
            f"{wanted:6g} ° {100 * np.mean(reached):7.0f} % {np.median(spent):9.1f} "
            f"{np.median(errors):12.1f} ° {100 * within:6.0f} %"
        )
    print("seconds: of records for each joint, median; within: errors no larger than wanted")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a study, with errors in one line."""
    studies = (compensation, compliant_joints, joint_side, sensors, stopping)
    actions: Actions = {
        study.__name__: (type("Study", (Settings,), {"__doc__": study.__doc__}), study)
        for study in studies
    }
    commands("later", __doc__, actions, arguments)


if __name__ == "__main__":
    main()
