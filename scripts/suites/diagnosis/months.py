"""Months of sessions with simulated machines: false alarms, delay of `loose diagnose --before`.

Each machine is measured once a month in the same poses with the same signals, by the integrator of
the blind suite. From session to session a healthy one scatters: its servos and dampers drift, its
cables lie otherwise, it comes back to its poses within a milliradian, and the accelerometer is
mounted anew. From some month on a wearing machine has play in one joint that grows, or the drive of
that joint slowly loses stiffness. Run as

    python -m scripts.suites.diagnosis.months --out DIR

Finished sessions are kept; every machine gets its trend page, `DIR/MACHINE/trend.html`.
"""

from __future__ import annotations

import dataclasses
import itertools
import tempfile
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

import numpy as np

from loose_env.cli.command import command
from loose_env.errors import InvalidData
from loose_env.instrument import (
    DiagnoseSettings,
    Diagnosis,
    Trend,
    TrendSettings,
    change_since,
    diagnose,
    read_diagnosis,
)
from loose_env.recording import Run, read_recording, write_recording
from loose_env.report import write_trend_page
from scripts.suites.diagnosis.cases import Case, motion, taken
from scripts.suites.gap.arms import model_xml, planar3
from scripts.suites.gap.dynamics import Factors
from scripts.suites.gap.effects import Effect, Place
from scripts.suites.gap.machine import Noise, TrueArm

SEED = 81_247
"""Of the printed numbers; nothing was developed on it."""
BAND, SECONDS = (4.0, 100.0), 2.0
"""Band [Hz] and length [s] of the signals."""
EXCITED = (1, 2)
"""Joints that are excited in each session, one pose each."""
SCATTER = {"mass": 2e-3, "inertia": 2e-3, "armature": 0.0, "damping": 0.05, "kp": 3e-3, "kv": 0.01}
"""Standard deviation of each factor between sessions [1]."""
REPOSE, MOUNT_RAD, MOUNT_GAIN = 1e-3, 3e-3, 2e-3
"""The same of the pose [rad], of the accelerometer's mounting [rad] and of its gain [1]."""
WEARING = 1
"""Joint that wears, from 0."""
PLAY, SOFTER = 2e-4, 0.004
"""Growth of its play [rad] and loss of its drive's stiffness [1] a month."""
KINDS = ("healthy", "play", "softer drive")
"""Kinds of machine."""
STOPS = {"stop_mode": 110.0, "stop_damping_ratio": 0.3}


def machine(number: int, seed: int) -> Case:
    """A healthy planar arm whose parameters are 1 to 3 % off its model's."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, number]))
    figures = planar3()
    return Case(
        number=number,
        seed=seed,
        arm=TrueArm(figures=figures, factors=Factors.draw(figures.joints, rng)),
        noise=Noise.draw(figures, rng),
        sensor=np.eye(3),
        reference=False,
    )


def as_found(case: Case, month: int, kind: str, worn: int) -> Case:
    """The machine in one month: its ordinary scatter, and so many months of wear."""
    rng = case.rng(7, month)
    factors = {
        name: getattr(case.arm.factors, name)
        * (1 + spread * rng.normal(size=case.arm.figures.joints))
        for name, spread in SCATTER.items()
    }
    if kind == "softer drive":
        factors["kp"][WEARING] *= (1 - SOFTER) ** worn
    turn = MOUNT_RAD * rng.normal(size=3)
    skew = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])
    effects: tuple[Effect, ...] = ()
    if kind == "play" and worn:
        place = Place(name=f"joint{WEARING + 1}", index=WEARING)
        effects = (Effect(kind="backlash", place=place, parameters={"gap": PLAY * worn, **STOPS}),)
    return dataclasses.replace(
        case,
        arm=dataclasses.replace(case.arm, factors=Factors(**factors), effects=effects),
        sensor=(1 + MOUNT_GAIN * rng.normal()) * (np.eye(3) + skew),
    )


def session_runs(case: Case, month: int, kind: str, worn: int) -> list[Run]:
    """Runs of one session: the signals of every other month, in poses met within a milliradian."""
    found, figures = as_found(case, month, kind, worn), case.arm.figures
    places = figures.home + figures.reach * np.array([[0.5, -0.4, 0.3], [-0.6, 0.5, -0.5]])
    runs = []
    for k, joint in enumerate(EXCITED):
        pose = places[k] + REPOSE * case.rng(8, month, k).normal(size=figures.joints)
        link = figures.links[joint]
        played = motion(
            found, pose, joint, 0.2 * link.limit / link.kp, BAND, SECONDS, case.rng(9, k)
        )
        noise = case.rng(10, month, k)
        runs.append(taken(found, played, f"run-{k + 1}.parquet", noise, sound=False))
    return runs


def diagnosed(case: Case, month: int, kind: str, worn: int, file: Path) -> Diagnosis:
    """Diagnosis of one month's session; a finished one is read."""
    if file.is_file():
        try:
            return read_diagnosis(file)
        except InvalidData:  # cut off: diagnosed anew
            pass
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, "session")
        runs = session_runs(case, month, kind, worn)
        write_recording(folder, model_xml=model_xml(case.arm.figures), runs=runs)
        found = diagnose(read_recording(folder), DiagnoseSettings(), plan=False)
    day = date(2024 + month // 12, 1 + month % 12, 15).isoformat()
    found = dataclasses.replace(found, date=day)
    found.write(file)
    return found


def trend_of(
    case: Case, kind: str, months: int, folder: Path, settings: TrendSettings, *, onset: int
) -> Trend:
    """Trend of a machine over its months; worn from the month of ``onset`` on, from 0."""
    sessions = []
    for month in range(months):
        worn = max(month - onset + 1, 0)
        file = folder / f"session-{month + 1:03d}.json"
        sessions.append((file.stem, diagnosed(case, month, kind, worn, file)))
    *before, (name, new) = sessions
    return change_since(new, before, name=name, settings=settings)


def alarms_of(trend: Trend) -> list[int]:
    """Sessions in which an alarm was raised, each once."""
    return sorted({session for series in trend.series for session in series.alarms})


def table(trends: Mapping[str, Sequence[Trend]], onset: int, settings: TrendSettings) -> str:
    """False-alarm rate before any wear, and delay of detection of each kind of wear."""
    tested = false = 0
    lines = []
    for kind, many in trends.items():
        for trend in many:
            until = len(trend.sessions) if kind == "healthy" else onset
            tested += _tested(trend, until)
            false += sum(session < until for session in alarms_of(trend))
        if kind == "healthy":
            continue
        after = [[s for s in alarms_of(trend) if s >= onset] for trend in many]
        delays = [sessions[0] - onset + 1 for sessions in after if sessions]
        words = f"  {kind}: found on {len(delays)} of {len(many)} machines"
        if delays:
            words += f", after {np.median(delays):g} worn sessions (median), at most {max(delays)}"
        lines.append(words)
    share = 100 * false / max(tested, 1)
    stated = 100 * settings.false_alarm_rate
    first = (
        f"false alarms: {false} in {tested} sessions without wear ({share:.1f} %; stated: at most "
        f"{stated:.2g} %)"
    )
    return "\n".join([first, *lines])


def _tested(trend: Trend, until: int) -> int:
    """Sessions before an index that have a statistic."""
    rows = np.array([series.statistic for series in trend.series], dtype=float)
    return int(np.isfinite(rows[:, :until]).any(axis=0).sum())


@dataclasses.dataclass(frozen=True, kw_only=True)
class MonthsSettings:
    """Machines and sessions."""

    out: Path
    """Folder of finished sessions."""
    machines: int = 6
    """Machines of each kind."""
    sessions: int = 24
    """Months, one session each."""
    onset: int = 12
    """Month from which they wear, from 0."""
    seed: int = SEED
    """Seed of the draw."""
    rate: float = TrendSettings.false_alarm_rate
    """False-alarm rate."""


def run(given: MonthsSettings) -> None:
    """Diagnose what is missing, write the trend pages and print the table."""
    settings = TrendSettings(false_alarm_rate=given.rate)
    trends: dict[str, list[Trend]] = {kind: [] for kind in KINDS}
    for number, (k, kind) in itertools.product(range(given.machines), enumerate(KINDS)):
        folder = given.out / f"{kind.replace(' ', '-')}-{number:02d}-{given.seed}"
        case = machine(len(KINDS) * number + k, given.seed)
        trend = trend_of(case, kind, given.sessions, folder, settings, onset=given.onset)
        trend.write(folder / "trend.json")
        page = write_trend_page(folder / "trend.html", trend, recording=folder.name)
        trends[kind].append(trend)
        said = ", ".join(str(session + 1) for session in alarms_of(trend)) or "none"
        print(f"{kind} {number}: alarms in sessions {said}; {page}", flush=True)
    print(table(trends, given.onset, settings))


if __name__ == "__main__":
    command("months", __doc__, MonthsSettings, run, interrupted="finished sessions are kept")
