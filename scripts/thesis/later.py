"""Studies of the thesis's future work: faults in motor torque and encoder, and more sensors.

Usage: python scripts/thesis/later.py joint_side --arms 64
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import mannwhitneyu

from loose_env.arms import Arm, LinearArm, planar, vera
from loose_env.cli.command import Actions, commands
from loose_env.diagnosis import SensorFloor, predict, statistics_of
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Fault, Healthy
from loose_env.io import Count
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.sensors import LinkAccelerometers, SensorSuite
from loose_env.statistics import acceleration_from_angle, bandpass, shape_of
from loose_env.typing import Array
from scripts.thesis.estimators import transfer_function
from scripts.thesis.loose_joint import placed

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


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a study, with errors in one line."""
    studies = (joint_side, sensors)
    actions: Actions = {
        study.__name__: (type("Study", (Settings,), {"__doc__": study.__doc__}), study)
        for study in studies
    }
    commands("later", __doc__, actions, arguments)


if __name__ == "__main__":
    main()
