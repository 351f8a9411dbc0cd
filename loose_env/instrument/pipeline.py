"""Diagnosis of a recorded session (diagnose): what knocks, where, and what was not tested."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument import decide, knocks
from loose_env.instrument.arm import BOLTS, PoseModel, SuspectArm, read_arm
from loose_env.instrument.clocks import read_run_on_one_clock
from loose_env.instrument.decide import Alarm, Scores
from loose_env.instrument.locate import (
    Heard,
    Rhythm,
    foretold,
    hear,
    names_of,
    rhythm_of,
)
from loose_env.instrument.motion import Gears, fit_gears
from loose_env.instrument.plan import Plan, is_sweep, read_plan
from loose_env.instrument.poses import is_tested_share, tested_share
from loose_env.instrument.records import Record, Unusable, exchanged, followed_hz, shares_followed
from loose_env.instrument.reference import Change, change, pairs
from loose_env.instrument.result import Diagnosis, Place, PlaceVerdict, RunSeen, Verdict
from loose_env.instrument.ringing import GRID, amplitude
from loose_env.instrument.signals import LEAST_BANDWIDTH_HZ, Multisine
from loose_env.recording import Recording
from loose_env.typing import Array
from loose_env.version import __version__

_SHOWN = 100
"""Samples of a rhythm in the result."""


@dataclass(frozen=True, kw_only=True)
class DiagnoseSettings:
    """Settings of a diagnosis.

    Examples
    --------
    >>> DiagnoseSettings(sure=1.5)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: sure is a probability between 0.5 and 1, got 1.5
    """

    sure: float = decide.Numbers.sure
    """Probability of a place from which it is settled."""
    reference: bool = True
    """True to compare with the healthy runs that the recording holds."""

    def __post_init__(self) -> None:
        """Check."""
        if not (isinstance(self.sure, float | int) and 0.5 <= self.sure < 1):
            raise InvalidSetting(f"sure is a probability between 0.5 and 1, got {self.sure!r}")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Session:
    """Records of a session that can be used, in pairs where there is a reference."""

    suspect: tuple[Record, ...]
    healthy: tuple[Record, ...]
    """The healthy record of each; empty without a reference."""
    runs: tuple[RunSeen, ...]
    remarks: tuple[str, ...]

    @property
    def used(self) -> int:
        """Number of runs of the suspect machine."""
        return len({record.name for record in self.suspect})


def diagnose(
    recording: Recording,
    settings: DiagnoseSettings | None = None,
    *,
    plan: Plan | None = None,
    numbers: decide.Numbers | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Say what knocks in a session that was planned by `plan`, and what was not tested.

    Parameters
    ----------
    recording : Recording
        Runs of the plan.
    settings : DiagnoseSettings, optional
        What is asked for.
    plan : Plan, optional
        The plan; by default the one that lies in the recording's folder, or beside it.
    numbers : Numbers, optional
        Numbers that decide, for ablations.
    say : callable
        Receives what is being done, line by line.

    Raises
    ------
    InvalidData
        If there is no plan, or another arm's, or the model is no serial arm.

    Examples
    --------
    >>> from loose_env.recording import read_recording
    >>> found = diagnose(read_recording("session/recording"))  # doctest: +SKIP
    >>> found.headline  # doctest: +SKIP
    'The seat of link forearm is loose.'
    """
    own = settings or DiagnoseSettings()
    limits = replace(numbers or decide.Numbers(), sure=own.sure)
    return judge(listen(recording, own, plan=plan, say=say), limits)


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What a session says before anything is decided."""

    recording: Recording
    plan: Plan
    arm: SuspectArm
    session: _Session
    exchanged: tuple[str, ...]
    """Columns that are not what they are called, in sentences."""
    started: float
    """Processor time at which it was begun [s]."""
    rang: _Rang | None = None
    """What rang; None where too few runs can be used or columns are exchanged."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rang:
    """What rang in a session, and which places foretell it."""

    gears: Gears
    heard: Heard
    rhythm: Rhythm
    change: Change | None
    """Against the healthy session; None without."""


def listen(
    recording: Recording,
    settings: DiagnoseSettings,
    *,
    plan: Plan | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Evidence:
    """Read a session, follow the loads of every place, and compare with what rang."""
    started = time.process_time()
    plan, arm = plan or read_plan(recording.folder), read_arm(recording.model_path)
    if plan.joints != arm.joints:
        raise InvalidData(
            f"{recording.folder}: the plan is for the joints {', '.join(plan.joints)}, the model "
            f"has {', '.join(arm.joints)}; give the recording the plan that it was played by"
        )
    signal = plan.signal.signal
    shaken = tuple(run for run in recording.runs if not is_sweep(run.name))
    recording = replace(recording, runs=shaken)
    session = _read(arm, recording, plan, settings)
    enough = session.used >= decide.FEWEST_POSES
    twisted = exchanged(session.suspect, signal, arm.joints) if enough else ()
    found = Evidence(
        recording=recording, plan=plan, arm=arm, session=session, exchanged=twisted, started=started
    )
    if twisted or not enough:
        return found
    models = [arm.at(record.pose, record.sensor) for record in session.suspect]
    say(f"fitting {arm.n} gears from encoders to tool by {session.used} runs")
    gears, compared = _gears(arm, session, models, signal)
    heard = hear(arm, session.suspect, models, gears, signal, healthy=session.healthy or None)
    say(f"following the loads of {len(arm.places)} places")
    rhythm = rhythm_of(heard, knocks.sphere(knocks.DIRECTIONS))
    session = replace(session, remarks=session.remarks + _short(session, plan))
    rang = _Rang(gears=gears, heard=heard, rhythm=rhythm, change=compared)
    return replace(found, session=session, rang=rang)


def judge(found: Evidence, numbers: decide.Numbers) -> Diagnosis:
    """Decide what the evidence of a session means."""
    done, session, rang = _Finished(found, numbers), found.session, found.rang
    if found.exchanged:
        return done.refused()
    if rang is None:
        return done.unread()
    steady = decide.repeats(session.suspect)
    alarm = decide.detect(rang.rhythm, numbers, change=rang.change, repeats=steady)
    scores = decide.score(
        found.arm, rang.rhythm, session.suspect, rang.gears,
        numbers=numbers, change=rang.change, healthy=session.healthy or None,
    )  # fmt: skip
    return done.judged(rang, alarm, scores)


def _read(arm: SuspectArm, recording: Recording, plan: Plan, own: DiagnoseSettings) -> _Session:
    """Read all runs, and pair those of a healthy day; what cannot be used is said."""
    signal = plan.signal.signal
    levels = {Path(run.file).stem: run.level for run in plan.runs}
    records: dict[str, list[Record]] = {"suspect": [], "healthy": []}
    runs, remarks = [], []
    for run in recording.runs:
        if run.condition == "healthy" and not own.reference:
            continue
        sensors = [s for s in arm.accelerometers if s in run.sensors]
        sensors = sensors or [arm.recording_model.accelerometer]
        each = {
            sensor: read_run_on_one_clock(
                arm,
                run,
                signal,
                level=levels.get(Path(run.name).stem, 1.0),
                corner_hz=plan.settings.corner_hz,
                sensor=sensor,
            )
            for sensor in sensors
        }
        good = [record for record in each.values() if isinstance(record, Record)]
        bad = {s: f"{r.why}: {r.remedy}" for s, r in each.items() if isinstance(r, Unusable)}
        if not good:
            why = "; ".join(dict.fromkeys(bad.values()))  # all sensors may lack the same
            remarks.append(f"{run.name} is not used: {why}")
            runs.append(
                RunSeen(file=run.name, condition=run.condition, pose={}, used=False, why=why)
            )
            continue
        remarks += [f"{run.name}: {sensor} is not used: {why}" for sensor, why in bad.items()]
        runs.append(_seen(arm, good[0], signal))
        for record in good:
            at = f" ({record.sensor})" if len(good) > 1 else ""
            remarks += [f"{run.name}{at}: {remark}" for remark in record.remarks]
        records[run.condition] += good
    there = {Path(run.name).stem for run in recording.runs}
    missing = [r.file for r in plan.runs if Path(r.file).stem not in there]
    late = [f for f in missing if f.startswith("run-")]
    if late:
        remarks.append(f"{len(late)} of the planned runs are not there, such as {late[0]}")
    suspect, healthy = records["suspect"], records["healthy"]
    together = pairs(suspect, healthy)
    if healthy and len({suspect[k].name for k, _ in together}) < decide.FEWEST_POSES:
        remarks.append("too few healthy runs are in the same poses: compared with none")
        healthy = []
    elif healthy:
        alone = len({r.name for r in suspect} - {suspect[k].name for k, _ in together})
        if alone:
            remarks.append(f"{alone} runs have no healthy run in their pose and are left out")
        suspect = [suspect[k] for k, _ in together]
        healthy = [healthy[r] for _, r in together]
    return _Session(
        suspect=tuple(suspect),
        healthy=tuple(healthy),
        runs=tuple(runs),
        remarks=tuple(remarks),
    )


def _short(session: _Session, plan: Plan) -> tuple[str, ...]:
    """Remark on joints that did not follow their commands up to the highest line."""
    peaks = {Path(run.file).stem: run.peak for run in plan.runs}
    played = [r for r in session.suspect if Path(r.name).stem in peaks]
    signal = plan.signal.signal
    if not played or plan.settings.limits.commands == "torque":
        return ()
    own = [peaks[Path(r.name).stem] for r in played]
    shares = shares_followed([r.joints for r in played], own, signal, plan.joints)
    short = [j for j, each in zip(plan.joints, shares.T, strict=True)
             if 0 < followed_hz(each[:, None], signal) < signal.hertz.max()]  # fmt: skip
    if not short:
        return ()
    hertz = followed_hz(shares, signal)
    words = f"{', '.join(short)} followed less than half of the command at the highest lines"
    if LEAST_BANDWIDTH_HZ <= hertz < signal.hertz.max():
        words += (
            f": plans with --bandwidth-hz {hertz:g} shake harder below it, and compare among "
            "themselves alone"
        )
    return (words,)


def _gears(
    arm: SuspectArm, session: _Session, models: Sequence[PoseModel], signal: Multisine
) -> tuple[Gears, Change | None]:
    """Gears of the session, those of the healthy day where there is one; and what changed."""
    gears = fit_gears(arm, session.suspect, models, signal)
    if not session.healthy:
        return gears, None
    then = [arm.at(record.pose, record.sensor) for record in session.healthy]
    known = fit_gears(arm, session.healthy, then, signal)
    mixed = Gears(
        rotation=gears.rotation,
        late=gears.late,
        spring=known.spring,
        rotor=known.rotor,
        left=gears.left,
    )
    found = change(session.suspect, session.healthy, models, mixed, known, signal)
    return mixed, found


def _seen(arm: SuspectArm, record: Record, signal: Multisine) -> RunSeen:
    lines = np.arange(1, len(record.tool))
    thinned = record.ring.repeating(0).reshape(_SHOWN, GRID // _SHOWN).mean(1)
    return RunSeen(
        file=record.name,
        condition=record.condition,
        pose=dict(zip(arm.joints, record.pose.round(5).tolist(), strict=True)),
        used=True,
        repeats=round(record.repeats, 3),
        heard=tuple(amplitude(np.maximum(thinned, 0)).round(5).tolist()),
        lines_hz=tuple((lines / signal.period_s).tolist()),
        lines=tuple(np.linalg.norm(record.tool[lines], axis=1).round(6).tolist()),
    )


@dataclass(frozen=True, eq=False)
class _Finished:
    """Makes the result of a session."""

    found: Evidence
    numbers: decide.Numbers

    def unread(self) -> Diagnosis:
        """Result of a session with too few records."""
        session = self.found.session
        used = session.used
        why = [run.why for run in session.runs if not run.used]
        headline = (
            f"Nothing can be said: {used} of {len(session.runs)} runs can be used, "
            f"{decide.FEWEST_POSES} are needed."
        )
        first = why[0] if why else "record the runs that are still planned"
        remedy = f"{first[0].upper()}{first[1:]}."
        return self._result("open" if used else "refused", headline, remedy, self._untold())

    def refused(self) -> Diagnosis:
        """Result of a session whose columns are not what they are called."""
        reasons = self.found.exchanged
        headline = f"The recording is not that of the plan: {reasons[0]}."
        remedy = "Correct the columns' names or signs in the mapping, and import again."
        return self._result("refused", headline, remedy, self._untold(), reasons=reasons)

    def judged(self, rang: _Rang, alarm: Alarm, scores: Scores) -> Diagnosis:
        """Result of a session that can be judged."""
        hobby, left = self.found.plan.hobby, rang.gears.left
        top = scores.order[0]
        told = foretold(rang.heard, rang.rhythm, scores.best[top])
        sure = bool(scores.probability[top] >= self.numbers.sure)  # JSON has no numpy.bool
        # a place that direction and softness choose is itself heard to knock
        own = scores.knocks[top] > decide.knock_limit(1, self.numbers.healthy)
        settled = alarm.loose and sure and own and not hobby
        places = _places(self.found.arm, rang.rhythm, alarm, scores, settled=settled)
        remarks = list(self.found.session.remarks)
        heavier = alarm.evidence.get("payload_kg", 0.0)
        if heavier and not alarm.loose:
            remarks.append(
                f"the arm moves as if its tool carried {abs(heavier):.2g} kg "
                f"{'more' if heavier > 0 else 'less'} than on the healthy day"
            )
        if left > _POOR:
            remarks.append(
                f"the model leaves {100 * left:.0f} % of the tool's slow motion: check "
                "link lengths, joint zeros and the accelerometer's place in the model"
            )
        headline, remedy = _words(places, alarm, settled=settled, hobby=hobby)
        runs = self._with_told(rang.heard, told, alarm.loose)
        verdict: Verdict = (
            "loose" if alarm.loose else "open" if alarm.louder or alarm.masked else "tight"
        )
        return self._result(
            verdict, headline, remedy, places,
            settled=settled, reasons=alarm.reasons, remarks=tuple(remarks),
            evidence={**alarm.evidence, "gears_left": left}, runs=runs,
        )  # fmt: skip

    def _with_told(self, heard: Heard, told: Sequence[Array], loose: bool) -> tuple[RunSeen, ...]:
        """Runs with what the best place foretells, and the healthy day's lines."""
        session = self.found.session
        own: dict[str, int] = {}
        for number, record in enumerate(session.suspect):
            own.setdefault(record.name, number)  # a page shows one accelerometer
        thin = {k: told[k].reshape(_SHOWN, GRID // _SHOWN).mean(1) for k in own.values()}
        seen = {run.file: np.array(run.heard) for run in session.runs if run.condition == "suspect"}
        scale = sum(float(seen[name] @ thin[k]) for name, k in own.items()) / max(
            sum(float(t @ t) for t in thin.values()), 1e-30
        )
        found = []
        for run in session.runs:
            k = own.get(run.file)
            if k is not None:
                each = asdict(run)
                if loose:
                    each["foretold"] = tuple((thin[k] * scale).round(5).tolist())
                if session.healthy:
                    then = np.linalg.norm(session.healthy[k].tool[1:], axis=1)
                    each["healthy_lines"] = tuple(then.round(6).tolist())
                run = RunSeen(**each)
            found.append(run)
        return tuple(found)

    def _result(
        self,
        verdict: Verdict,
        headline: str,
        remedy: str,
        places: tuple[Place, ...],
        *,
        settled: bool = False,
        reasons: tuple[str, ...] = (),
        remarks: tuple[str, ...] | None = None,
        evidence: Mapping[str, float] | None = None,
        runs: tuple[RunSeen, ...] | None = None,
    ) -> Diagnosis:
        recording, session = self.found.recording, self.found.session
        files = [recording.folder / run.name for run in recording.runs]
        times = [file.stat().st_mtime for file in files if file.is_file()]
        latest = datetime.fromtimestamp(max(times), UTC) if times else None
        return Diagnosis(
            verdict=verdict,
            headline=headline,
            remedy=remedy,
            places=places,
            settled=settled,
            reasons=reasons,
            remarks=session.remarks if remarks is None else remarks,
            evidence=evidence or {},
            runs=session.runs if runs is None else runs,
            reference=bool(session.healthy),
            hobby=self.found.plan.hobby,
            model=recording.model_path.name,
            date="" if latest is None else latest.isoformat(timespec="seconds"),
            version=__version__,
            seconds=round(time.process_time() - self.found.started, 2),
            shaken_s=round(
                sum(r.time[-1] - r.time[0] for r in recording.runs if r.condition == "suspect"),
                2,
            ),
            settings=asdict(self.numbers),
        )

    def _untold(self) -> tuple[Place, ...]:
        """All places, of which a session says nothing."""
        arm = self.found.arm
        return tuple(
            Place(
                kind=place.split("@", 1)[0],
                at=place.split("@", 1)[1],
                verdict="not tested",
                probability=0.0,
                rhythm=0.0,
                tested=0.0,
                why="no run can be used",
                base=place == arm.places[-1],
            )
            for place in arm.places
        )


_POOR = 0.3
"""Share of the tool's slow motion left from which the model is said to be another's [1]."""


_LISTED = 0.05
"""Probability from which a place is a suspect [1]."""


def _places(
    arm: SuspectArm, rhythm: Rhythm, alarm: Alarm, scores: Scores, *, settled: bool
) -> tuple[Place, ...]:
    """Verdict of every place, best first."""
    reversed_ = tested_share(rhythm.reversing, arm.n, knocks.DIRECTIONS)
    shares = dict(zip(arm.places, reversed_.tolist(), strict=True))
    names = np.array(names_of(arm, rhythm))
    lattice = names[: len(rhythm.held)]
    slides = dict(zip(arm.joints, arm.slides, strict=True))
    found = []
    for rank, place in enumerate(scores.order):
        kind, at = place.split("@", 1)
        timing = float(rhythm.timing[names == place].max())
        best = scores.best[place]
        chance = scores.probability[place] if alarm.loose else 0.0
        direction = None
        if kind == BOLTS and place != arm.places[-1]:
            d = rhythm.directions[rhythm.labels[best][2]]
            direction = (round(float(d[0]), 5), round(float(d[1]), 5), round(float(d[2]), 5))
        verdict: PlaceVerdict
        if alarm.loose and rank == 0 and settled:
            verdict = "loose"
            why = f"it knocks: correlation {timing:.2f}, evidence {scores.knocks[place]:.1f} nats"
            if direction is not None:
                ways = ", ".join(f"{x:.2f}" for x in direction)
                why += f"; it slides along ({ways}) of its frame"
        elif alarm.loose and (chance >= _LISTED or rank == 0) and not settled:
            verdict = "suspect"
            alone = rank == 0 and chance > 1 - _LISTED
            why = (
                "the tool rings in its rhythm"
                if alone
                else "the session does not tell it from the other suspects"
            )
        elif alarm.masked:
            verdict, why = "not tested", "other strikes hide whether it knocks"
        elif is_tested_share(shares[place]):
            verdict = "tight"
            turns = place == arm.places[-1] or (kind != BOLTS and not slides[at])
            most = float(f"{np.median(rhythm.held[lattice == place]):.2g}")
            held = f"{most:g} {'N·m' if turns else 'N'}"
            why = f"its load reversed by up to {held}, and " + (
                "rhythm and direction fit another place better"
                if alarm.loose
                else "it was not heard"
            )
        else:
            verdict, why = "not tested", _untested_words(shares[place], kind)
        found.append(
            Place(
                kind=kind,
                at=at,
                verdict=verdict,
                probability=round(float(chance), 4),
                rhythm=round(timing, 4),
                tested=round(shares[place], 3),
                direction=direction,
                why=why,
                base=place == arm.places[-1],
            )
        )
    return tuple(found)


def _untested_words(share: float, kind: str) -> str:
    if kind == BOLTS and share > 0:
        return f"its load reversed in {100 * share:.0f} % of the directions only"
    return "its load never reversed beyond friction: it would stay shut if it were loose"


def _words(places: Sequence[Place], alarm: Alarm, *, settled: bool, hobby: bool) -> tuple[str, str]:
    """Headline and remedy."""
    untested = [p for p in places if p.verdict == "not tested"]
    if alarm.masked:
        return (
            "Something strikes, in no rhythm that tells a place of the arm.",
            "Tie cables down, keep hands and neighbours away, and repeat the session.",
        )
    if alarm.mount:
        return (
            f"Nothing knocks, but the accelerometer's mount may be loose: {alarm.mount}.",
            "Screw or glue the accelerometer to bare metal, and repeat the session.",
        )
    if alarm.louder:
        return (
            "Nothing knocks, but the arm rings louder than on the healthy day.",
            "Tighten the sensor's mount, tie cables down, take the same payload, and repeat.",
        )
    if not alarm.loose:
        tight = len(places) - len(untested)
        headline = f"Nothing knocks: {tight} of {len(places)} places are tight"
        if not untested:
            return f"{headline}.", "Nothing to do; keep the recording as the healthy reference."
        return (
            f"{headline}, {len(untested)} {'was' if len(untested) == 1 else 'were'} not tested.",
            f"To test {untested[0].words if len(untested) == 1 else 'these'} too: "
            "loose plan --known, with its poses.",
        )
    top = places[0]
    if hobby:
        return (
            "Something knocks, as in every arm of this class.",
            "Compare with the same session of another month: loose trend.",
        )
    if settled:
        return f"{top.words[0].upper()}{top.words[1:]} is loose.", _work(top)
    listed = " or ".join([p.words for p in places if p.verdict == "suspect"][:3])
    return (
        f"Something knocks: {listed}.",
        "Plan the poses that tell them apart: loose plan --known.",
    )


def _work(place: Place) -> str:
    if place.kind == BOLTS:
        return f"Torque the bolts at {place.words}, then repeat the session: {_AGAIN}."
    return f"Measure the play at {place.words}, repair it, then repeat the session: {_AGAIN}."


_AGAIN = "a second loose place is heard once the louder one is tight"
