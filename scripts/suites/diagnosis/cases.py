"""Cases of the diagnosis suite by number: arm, fault, sensors; their runs, and their rig."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import signal

from loose_env.excitation import Excitation
from loose_env.recording import Run
from loose_env.typing import Array
from scripts.suites.diagnosis.machines import GAPS
from scripts.suites.gap.arms import ARMS, model_xml
from scripts.suites.gap.dynamics import SAMPLE, Factors, Signals
from scripts.suites.gap.effects import KINDS as EFFECTS
from scripts.suites.gap.effects import Effect, Spot
from scripts.suites.gap.machine import Motion, Noise, TrueArm, add_noise

KINDS = ("healthy", "structural_looseness", "structural_looseness", "backlash")
"""Kinds in turn, by the case's number."""
CROSS_AXIS = 0.03
"""Largest leakage of an accelerometer axis into another."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A case, drawn."""

    number: int
    seed: int
    arm: TrueArm
    noise: Noise
    sensor: Array
    """Reading of the accelerometer per true acceleration (3, 3)."""
    reference: bool
    """True if the recording has runs of the healthy arm."""

    @property
    def fault(self) -> Effect | None:
        """What is loose."""
        return self.arm.effects[0] if self.arm.effects else None

    @property
    def model_xml(self) -> str:
        """The user's model."""
        return model_xml(self.arm.figures)

    @property
    def facts(self) -> dict[str, object]:
        """What the tables part cases by."""
        return {"joints": self.arm.figures.joints, "servoed": True, "rate": 1 / SAMPLE,
                "disturbances": {}}  # fmt: skip

    def rng(self, *purpose: int) -> np.random.Generator:
        """Generator for one purpose."""
        return np.random.default_rng(np.random.SeedSequence([self.seed, self.number, *purpose]))


def draw(number: int, seed: int) -> Case:
    """Draw a case by its number."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, number, 0]))
    kind = KINDS[number % len(KINDS)]
    names = sorted(ARMS)
    figures = ARMS[names[int(rng.integers(len(names)))]]()
    arm = TrueArm(figures=figures, factors=Factors.draw(figures.joints, rng))
    effects: tuple[Effect, ...] = ()
    if kind != "healthy":
        sort = EFFECTS[kind]
        places = sort.places(figures)
        place = places[int(rng.integers(len(places)))]
        gap = float(np.exp(rng.uniform(*np.log(GAPS[kind]))))
        parameters = sort.make(gap, Spot(figures, place, rng))
        effects = (Effect(kind=kind, place=place, parameters=parameters),)
    leaks = CROSS_AXIS * rng.uniform(-1, 1, (3, 3)) * (1 - np.eye(3))
    return Case(
        number=number,
        seed=seed,
        arm=dataclasses.replace(arm, effects=effects),
        noise=Noise.draw(figures, rng),
        sensor=np.eye(3) + leaks,
        reference=bool(rng.random() < 0.5),
    )


SHARES = (0.06, 0.2)
"""Rms force of the shaken drive over its limit, log-uniform, of random runs."""
SECONDS = 4.0
"""Length of random runs [s]."""


def motion(
    case: Case, pose: Array, joint: int, command: float, band: tuple[float, float],
    seconds: float, rng: np.random.Generator,
) -> Motion:  # fmt: skip
    """Commands that hold a pose and shake a joint with an rms command [rad or m]."""
    count = round(seconds / SAMPLE)
    filtered = signal.butter(4, band, "bandpass", fs=1 / SAMPLE, output="sos")
    noise = signal.sosfilt(filtered, rng.normal(size=count + 1000))[1000:]
    swell = np.minimum(np.arange(count) * SAMPLE / 0.2, 1.0)
    commands = np.tile(pose, (count, 1))
    commands[:, joint] += command * swell * noise / noise.std()
    return Motion(commands=commands, excited=joint, pose=pose, family="shaken")


def taken(case: Case, played: Motion, name: str, rng: np.random.Generator, *, sound: bool) -> Run:
    """Simulated run with sensor noise."""
    arm = case.arm.without() if sound else case.arm
    true = _run(arm, played)
    read = dataclasses.replace(true, acceleration=true.acceleration @ case.sensor.T)
    signals = add_noise(read, case.noise, rng)
    joints = range(arm.figures.joints)
    sensors: dict[str, Array] = {"tool_acc": signals.acceleration}
    for j in joints:
        sensors[f"joint{j + 1}_pos"] = signals.position[:, j]
        sensors[f"joint{j + 1}_vel"] = signals.velocity[:, j]
    assert played.excited is not None and played.pose is not None
    return Run(
        name=name,
        time=np.arange(len(signals.position)) * SAMPLE,  # type: ignore[arg-type]
        controls={f"motor{j + 1}": played.commands[:, j] for j in joints},
        sensors=sensors,
        excited=(f"joint{played.excited + 1}",),
        pose={f"joint{j + 1}": float(played.pose[j]) for j in joints},
        condition="healthy" if sound else "suspect",
    )


def _run(arm: TrueArm, played: Motion) -> Signals:
    """Readings without noise; the last few are kept, for they are asked for twice."""
    key = (id(arm), played.commands.tobytes(), bool(arm.effects))
    if key not in _KEPT:
        while len(_KEPT) > 40:
            del _KEPT[next(iter(_KEPT))]
        _KEPT[key] = (arm, arm.run(played))
    return _KEPT[key][1]


def random_motion(case: Case, number: int, purpose: int) -> Motion:
    """A random pose, joint, level and band."""
    rng, figures = case.rng(purpose, number), case.arm.figures
    joint = int(rng.integers(figures.joints))
    pose = figures.home + figures.reach * rng.uniform(-0.8, 0.8, figures.joints)
    share = float(np.exp(rng.uniform(*np.log(SHARES))))
    link = figures.links[joint]
    band = (4.0, float(rng.uniform(60.0, 120.0)))
    return motion(case, pose, joint, share * link.limit / link.kp, band, SECONDS, rng)


def random_runs(case: Case, count: int) -> tuple[list[Run], list[float]]:
    """Runs of a recording, references first where the case has them, and what the fault shows."""
    references = [
        taken(case, random_motion(case, i, 1), f"healthy-{i + 1}", case.rng(2, i), sound=True)
        for i in range(2 if case.reference else 0)
    ]
    played = [random_motion(case, i, 3) for i in range(count)]
    runs = [
        taken(case, one, f"run-{i + 1}", case.rng(4, i), sound=False)
        for i, one in enumerate(played)
    ]
    return [*references, *runs], shown(case, played)


def shown(case: Case, played: list[Motion]) -> list[float]:
    """Change of the tool's motion by the fault, over the motion, in each run."""
    found = []
    for one in played if case.fault is not None else ():
        loose, sound = _run(case.arm, one).acceleration, case.arm.without().run(one).acceleration
        moved = sound - sound.mean(axis=0)
        change = loose - sound - (loose - sound).mean(axis=0)
        found.append(float(np.sqrt(np.mean(change**2) / np.mean(moved**2))))
    return found


_KEPT: dict[tuple[int, bytes, bool], tuple[TrueArm, Signals]] = {}


class BlindArm:
    """Rig of a case: measures a pose and an excitation."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.played: list[Motion] = []

    def measure(self, pose: Array, excitation: Excitation) -> Run:
        """Play noise of the wanted force on the position command of the joint."""
        case, number = self.case, len(self.played)
        joint = int(np.argmax(excitation.torque_rms))
        command = excitation.torque_rms[joint] / case.arm.figures.links[joint].kp
        played = motion(
            case, np.asarray(pose), joint, command, excitation.band, excitation.duration,
            case.rng(5, number),
        )  # fmt: skip
        self.played.append(played)
        return taken(case, played, f"run-{number + 1}", case.rng(6, number), sound=False)
