"""`find_gap`: what is missing is named with its value, and nothing where nothing is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap import (
    GapSettings,
    GapSolution,
    Tolerances,
    check_gap,
    find_gap,
    solve_gap,
    try_effect,
)
from loose_env.gap.core.balance import Balance
from loose_env.gap.core.catalogue import Term
from loose_env.gap.core.evidence import grid_of, operator_noise, whiten
from loose_env.gap.core.find import evidence_of, readable, relinearised, silent
from loose_env.gap.core.motion import smooth
from loose_env.gap.core.residual import overlays
from loose_env.gap.core.selection import Selection, SetFit
from loose_env.gap.core.tolerances import missed_by_laws, nuisances
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Recording, Run, read_recording, write_recording
from loose_env.typing import Array
from tests.gap.cases.gap_case import (
    FEW,
    FRICTION,
    MODEL,
    lacks_friction,
    record,
    torque_log,
)

ONE = GapSettings(threads=1)
DRY = GapSettings(threads=1, simulate=False, kinds=("coulomb_friction",))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("arm") / "recording")


@pytest.fixture(scope="module")
def solution(recording: Recording) -> GapSolution:
    return solve_gap(recording, FEW)


def test_missing_friction_of_a_servoed_arm_is_named_with_its_value(recording: Recording) -> None:
    result = solve_gap(recording, ONE).result
    assert result.verdict == "named"
    (friction,) = result.effects
    assert (friction.kind, friction.where) == ("coulomb_friction", "elbow")
    low, high = friction.interval_95["torque"]
    assert low < FRICTION < high and high - low < 0.5 * FRICTION
    assert friction.units == {"torque": "N·m"} and (friction.probability or 0) > 0.5
    words = {each.channel: each.verdict for each in result.channels}
    assert words == {"shoulder": "not needed", "elbow": "named"}
    assert result.gap.after < 1.6 < result.gap.before
    before, after = result.gap.by_quantity["joint position [rad]"]
    assert after < 0.5 * before


def test_a_payload_is_named_in_a_torque_log(tmp_path: Path) -> None:
    def edit(spec: mujoco.MjSpec) -> None:
        lower = spec.body("lower")  # 0.5 kg at the tool
        lower.mass, lower.ipos = 1.5, [(0.12 + 0.5 * 0.25) / 1.5, 0, 0]
        shift = 1.0 * 0.5 / 1.5 * (0.25 - 0.12) ** 2
        lower.inertia = [0.003, 0.008 + shift, 0.008 + shift]

    result = solve_gap(torque_log(tmp_path / "log", edit), ONE).result
    assert [(e.kind, e.where) for e in result.effects] == [("payload", "tool")]
    assert result.effects[0].parameters["mass"] == pytest.approx(0.5, rel=0.1)
    assert set(result.gap.by_quantity) == {"joint torque [N·m]"}


def test_a_payload_far_beside_the_tool_is_named_with_its_centre(tmp_path: Path) -> None:
    def edit(spec: mujoco.MjSpec) -> None:
        load = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [1e-3, 0, 0], "mass": 0.5}
        spec.body("lower").add_body(pos=[0.25, 0, 0.15]).add_geom(**load)

    own = replace(ONE, kinds=("payload", "link_mass", "link_com", "coulomb_friction"))
    result = solve_gap(torque_log(tmp_path / "log", edit), own).result
    assert [(e.kind, e.where) for e in result.effects] == [("payload", "tool")]
    mass, z = (result.effects[0].parameters[name] for name in ("mass", "z"))
    assert mass == pytest.approx(0.5, rel=0.15) and z == pytest.approx(0.15, rel=0.15)
    assert result.effects[0].undetermined == ("y",)  # across the plane of the arm


def test_commands_that_a_torque_log_lacks_put_no_drive_at_its_limit(tmp_path: Path) -> None:
    limited = MODEL.replace("<position ", '<position forcerange="-5 5" ')
    plain, own = (
        check_gap(torque_log(tmp_path / name, nominal=xml), FEW)
        for name, xml in (("plain", MODEL), ("limited", limited))
    )
    used = [joint.used for joint in own.joints]
    assert used == [joint.used for joint in plain.joints] and min(used) > 0.5


def test_nothing_is_named_where_nothing_is_missing(tmp_path: Path) -> None:
    result = solve_gap(record(tmp_path / "whole", edit=lambda spec: None), ONE).result
    assert result.verdict == "no_gap" and not result.effects and not result.doubtful
    assert {each.verdict for each in result.channels} == {"not needed"}
    assert result.gap.after < 1.6 and all(test.rms < 1.6 for test in result.residual_tests)


@pytest.mark.parametrize(
    "others",
    [
        (),
        pytest.param(
            ("viscous_friction", "actuator_gain", "load_friction"), marks=pytest.mark.slow
        ),
    ],
    ids=["alone", "among others"],
)
def test_friction_of_joints_that_mostly_stand_still_is_found_in_simulation(
    others: tuple[str, ...], tmp_path: Path
) -> None:
    settings = GapSettings(threads=1, kinds=("coulomb_friction", *others))
    answer = find_gap(record(tmp_path / "steps", steps_s=1.0, runs=2), settings)
    assert answer.exact, "nothing was simulated"
    (friction,) = (f for f in answer.decision.findings if f.named)
    assert friction.term.name == ("coulomb_friction", "elbow")
    assert friction.values == pytest.approx([FRICTION], rel=0.1)


@pytest.mark.parametrize(("step", "named"), [(0.01, True), (0.0015, False)])
def test_coarse_steps_of_an_encoder_are_named_by_its_readings(
    recording: Recording, step: float, named: bool
) -> None:
    (name, *_) = NominalModel(recording.spec()).encoders

    def rounded(run: Run) -> Run:
        read = step * np.round(run.sensors[name] / step)
        return replace(run, sensors={**run.sensors, name: read})

    settings = replace(ONE, kinds=("sensor_quantisation", "coulomb_friction"))
    found = solve_gap(replace(recording, runs=tuple(map(rounded, recording.runs))), settings)
    own = [e for e in found.result.effects if e.kind == "sensor_quantisation"]
    assert [e.where for e in own] == [name] * named
    for effect in own:
        low, high = effect.interval_95["step"]
        assert low <= step <= high and high - low < 1e-9
        joint = found.answer.selection.evidence.balance.machine.encoders[name]
        verdict = next(c for c in found.result.channels if c.channel == joint)
        assert name in [each.where for each in verdict.effects]


def test_runs_that_are_held_out_are_predicted_alone(
    recording: Recording, solution: GapSolution
) -> None:
    parted = solve_gap(recording, replace(DRY, held_out=("run-03",)))
    assert parted.result.held_out_runs == ("run-03.csv",)
    assert [run.name for run in parted.answer.recording.runs] == ["run-01.csv", "run-02.csv"]
    assert parted.played is not None
    assert [trial.name for trial in parted.played.trials] == ["run-03.csv"]
    assert not solution.result.held_out_runs


def test_the_check_says_what_could_be_seen(recording: Recording) -> None:
    found = check_gap(recording, FEW)
    assert [joint.joint for joint in found.joints] == ["shoulder", "elbow"]
    assert all(0.5 < joint.used <= 1 and joint.travel > 0.5 for joint in found.joints)
    seen = {(each.kind, each.where): each for each in found.effects}
    friction = seen["coulomb_friction", "elbow"]
    assert friction.visible and 0 < friction.smallest["torque"] < 0.5 * FRICTION
    # a tighter tolerance of the model shows smaller errors of a gain
    tight = GapSettings(
        kinds=FEW.kinds, tolerances=Tolerances(torque=1e-3, mass=1e-3, inertia=1e-3)
    )
    closer = {(e.kind, e.where): e for e in check_gap(recording, tight).effects}
    wide, near = (each["actuator_gain", "motor2"].smallest["gain"] for each in (seen, closer))
    assert near < wide


def test_an_effect_is_tried_beside_the_others(solution: GapSolution) -> None:
    answer = solution.answer
    late, friction = (
        try_effect(answer, kind, where)
        for kind, where in (("viscous_friction", "shoulder"), ("coulomb_friction", "elbow"))
    )
    assert late.doubt and not friction.doubt
    assert friction.parameters["torque"] == pytest.approx(FRICTION, rel=0.2)
    for given in (("rust", "elbow"), ("coulomb_friction", "knee")):
        with pytest.raises(UnknownName, match=given[0]):
            try_effect(answer, *given)


@pytest.mark.parametrize("shown", ["constant", "noise", "nothing"])
def test_an_encoder_that_shows_nothing_of_its_joint_spoils_no_other(
    recording: Recording, shown: str
) -> None:
    rng, runs = np.random.default_rng(0), []
    for run in recording.runs:
        count = len(run.time)
        loose = {"constant": np.full(count, 0.2), "noise": rng.normal(size=count)}
        sensors = {**run.sensors, "encoder1": loose.get(shown, run.time)}
        if shown == "nothing":
            del sensors["encoder1"]
        runs.append(replace(run, sensors=sensors))
    result = solve_gap(replace(recording, runs=tuple(runs)), DRY).result
    assert [(e.kind, e.where) for e in result.effects] == [("coulomb_friction", "elbow")]
    assert result.effects[0].parameters["torque"] == pytest.approx(FRICTION, rel=0.2)
    words = {each.channel: each.verdict for each in result.channels}
    assert words == {"elbow": "named", "shoulder": "cannot tell"}
    assert any(note.startswith("shoulder: no position reading") for note in result.warnings)


def test_a_joint_that_stands_still_indeed_is_no_loose_encoder(tmp_path: Path) -> None:
    def stuck(spec: mujoco.MjSpec) -> None:
        spec.joint("elbow").frictionloss = 50.0

    recording = record(tmp_path / "stuck", edit=stuck)
    assert readable(recording) is recording


def broken(recording: Recording, **changes: object) -> list[Run]:
    """The runs with some of their columns changed."""
    return [replace(run, **changes) for run in recording.runs]  # type: ignore[arg-type]


def part(run: Run, count: int) -> Run:
    """The first samples of a run."""
    controls, sensors = ({n: v[:count] for n, v in x.items()} for x in (run.controls, run.sensors))
    return replace(run, time=run.time[:count], controls=controls, sensors=sensors)


def test_what_cannot_be_compared_is_said(recording: Recording, tmp_path: Path) -> None:
    runs = broken(
        recording, sensors={"encoder1": recording.runs[0].sensors["encoder1"]}, controls={}
    )
    unread = write_recording(tmp_path / "unread", model_xml=MODEL, runs=runs)
    with pytest.raises(InvalidData, match="'elbow' has no position"):
        find_gap(unread)
    still = {n: np.full(len(v), 0.3) for n, v in recording.runs[0].sensors.items()}
    noisy = {n: v + 1e-5 * np.sin(1e3 * np.arange(len(v)) ** 2) for n, v in still.items()}
    runs = broken(recording, sensors=noisy, controls={})
    with pytest.raises(InvalidData, match="no joint moves"):
        find_gap(write_recording(tmp_path / "still", model_xml=MODEL, runs=runs))
    speed = {"rate": 1e-3 * np.sin(1e3 * np.arange(len(runs[0].time)) ** 2)}
    runs = broken(recording, sensors=noisy | speed, controls={})
    read = MODEL.replace("</sensor>", '<jointvel name="rate" joint="elbow"/></sensor>')
    with pytest.raises(InvalidData, match="no joint moves"):
        find_gap(write_recording(tmp_path / "rate", model_xml=read, runs=runs))
    short = [part(run, 60) for run in recording.runs]  # 0.3 s
    with pytest.raises(InvalidData, match=r"the longest run lasts 0\.29 s"):
        find_gap(replace(recording, runs=tuple(short)))
    few = replace(recording, runs=(*recording.runs[:2], short[2]))
    with pytest.raises(InvalidData, match="the longest run lasts"):
        find_gap(few, GapSettings(held_out=("run-03",)))
    for settings, error, reason in (
        (GapSettings(kinds=("rust",)), UnknownName, "rust"),
        (GapSettings(held_out=("jump",)), InvalidData, "no run to hold out is called 'jump'"),
        (GapSettings(held_out=("run",)), InvalidData, "none is left to fit to"),
    ):
        with pytest.raises(error, match=reason):
            find_gap(recording, settings)
    for settings, name, value in (
        (GapSettings, "threads", -1),
        (GapSettings, "kinds", "rust"),
        (Tolerances, "mass", 0.0),
        (Tolerances, "law", float("nan")),
    ):
        with pytest.raises(InvalidSetting, match=f"{settings.__name__}.{name} must be"):
            settings(**{name: value})


def test_the_stretch_that_is_shown_of_a_joint_is_one_in_which_it_moves(
    recording: Recording,
) -> None:
    still = recording.runs[0].sensors["encoder2"][:1] + 1e-5 * np.sin(1e3 * np.arange(800) ** 2)
    runs = [
        replace(run, sensors=run.sensors | {"encoder2": still}) if run.name != "run-02.csv" else run
        for run in recording.runs
    ]
    selection = evidence_of(replace(recording, runs=tuple(runs)), FEW, lambda _: None)
    balance = selection.evidence.balance
    large, small = np.ones_like(balance.residual), np.zeros_like(balance.residual)
    large[np.abs(balance.speed) < 0.01] = 100.0
    shown = {each.channel: each.run for each in overlays(selection, large, small, 2)}
    assert shown["elbow"] == "run-02.csv"


def test_a_name_of_the_model_may_be_anything(tmp_path: Path) -> None:
    folder = tmp_path / "odd"
    record(folder, suffix=" (a)", edit=lacks_friction(" (a)"))
    result = solve_gap(read_recording(folder), DRY).result
    assert [effect.where for effect in result.effects] == ["elbow (a)"]


def test_rivals_are_made_again_beside_what_the_best_set_found(tmp_path: Path) -> None:
    def edit(spec: mujoco.MjSpec) -> None:
        spec.body("lower").mass = 1.5

    own = replace(ONE, kinds=("link_mass", "link_com", "payload"))
    with silent():
        selection = evidence_of(torque_log(tmp_path / "log", edit), own, lambda _: None)
        rival = next(t for t in selection.evidence.terms if t.effect.kind == "link_com")
        best = selection.leading[0]
        selection.__dict__["leading"] = [best, selection.solve((rival,))]
        again, (first, second) = relinearised(selection, own)
    assert again is not selection and [t.name for t in first.terms] == [t.name for t in best.terms]
    assert [t.name for t in second.terms] == [rival.name] and second.terms[0] is not rival


def test_a_spring_that_stiffens_is_one_spring(tmp_path: Path) -> None:
    """What its law misses turns with the position: nothing of it is left."""
    log, runs = torque_log(tmp_path / "log"), []
    for run in log.runs:
        way = run.sensors["encoder2"] - 0.2
        spring = 5.0 * way * (1 + 0.1 * (way / 0.8) ** 2)
        runs.append(replace(run, torques={**run.torques, "elbow": run.torques["elbow"] + spring}))
    kinds = ("joint_spring", "link_com", "link_mass", "gravity_compensation", "quadratic_drag")
    stiffening = replace(log, runs=tuple(runs))
    decision = find_gap(stiffening, replace(ONE, kinds=kinds)).decision
    (found,) = (each for each in decision.findings if each.named)
    assert found.term.name == ("joint_spring", "elbow")
    assert found.low[0] < 5.0 < found.high[0] and found.low[1] < 0.2 < found.high[1]
    assert decision.channels[1].channel == "elbow" and decision.channels[1].after < 5.0


def test_a_shape_that_a_search_adds_is_kept_beside_what_laws_miss(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, search = replace(ONE, kinds=("viscous_friction", "coulomb_friction")), Selection.search
    selection = evidence_of(recording, own, lambda _: None)
    assert selection.leading

    def adding(self: Selection, start: Sequence[Term] = ()) -> SetFit:
        fit = search(self, start)
        moved = tuple((2 * row[0], *row[1:]) for row in fit.terms[0].axes)
        return self.replaced(fit, fit.terms[0], moved) or fit

    monkeypatch.setattr(Selection, "search", adding)
    again, (best, *_) = relinearised(selection, own)
    assert [t.name for t in best.terms] == [("coulomb_friction", "elbow")]
    assert all(id(term) in again.evidence.places for term in best.terms)


def test_more_tolerances_leave_the_columns_of_effects(recording: Recording) -> None:
    selection = evidence_of(recording, DRY, lambda _: None)
    known, fit = selection.evidence, selection.search()
    missed = missed_by_laws(known.balance, selection.inexact(fit))
    assert {n.name.partition(" of ")[2] for n in missed} == {"coulomb_friction at elbow"}
    wide = whiten(known.balance, known.terms, known.nuisances, law=known.law, missed=missed)
    assert wide.tolerances == known.tolerances + len(missed)
    pull = np.zeros(wide.tolerances)
    pull[known.tolerances :] = [1.5, 0.0, -0.7, 0.0]
    for one, other in zip(known.channels, wide.channels, strict=True):
        for term in known.terms:
            pairs = zip(known.columns_of(term), wide.columns_of(term), strict=True)
            for k, n in pairs:
                here, there = one.rows[:, one.columns == k], other.rows[:, other.columns == n]
                assert np.array_equal(here, there)
        other.residual = other.residual + other.rows[:, : len(pull)] @ pull
        other.power = other.by_cell(other.residual**2)
    again = Selection(wide).fit(fit.terms)
    found = (wide.mixed @ again.values[: len(pull)])[len(known.nuisances) :]
    assert found == pytest.approx(pull[known.tolerances :], abs=0.25)


LIFT = """<mujoco><worldbody><body><joint name="lift" type="slide" axis="0 0 1" damping="58"
armature="3.9"/><geom size=".1" mass="3.9"/></body></worldbody>
<sensor><jointpos name="scale" joint="lift"/></sensor></mujoco>"""


def test_a_wrong_torque_constant_is_no_wrong_scale_of_the_encoder(tmp_path: Path) -> None:
    """Both fit as well, but for the noise that they make and the weight that one scales."""
    rng, time = np.random.default_rng(4), np.arange(1200) / 100
    runs = []
    for number in range(4):
        turn, at = 2 * np.pi * rng.uniform(0.2, 3.0, 6), rng.uniform(0, 2 * np.pi, 6)
        wave = np.exp(1j * (turn * time[:, None] + at)) * 0.02 / turn * 6
        q, v, a = (np.real(wave * (1j * turn) ** k).sum(1) for k in range(3))
        needed = 1.19 * (8.46 * a + 59 * v + 3.78 * 9.81)  # a rotor of 1.2 times what it says
        runs.append(Run(
            name=f"run-{number}.csv", time=time,
            sensors={"scale": q + rng.normal(0, 1.5e-5, q.shape)},
            torques={"lift": needed + rng.normal(0, 0.7, q.shape)},
        ))  # fmt: skip
    recording = write_recording(tmp_path / "lift", model_xml=LIFT, runs=runs)
    (found,) = solve_gap(recording, ONE).result.effects
    assert (found.kind, found.where) == ("torque_constant", "lift")
    low, high = found.interval_95["factor"]
    assert low < 1.19 < high


@pytest.mark.parametrize("kind", ["servo", "torque"])
def test_a_step_of_a_fit_goes_down_what_it_minimises(
    kind: str, recording: Recording, tmp_path: Path
) -> None:
    given = recording if kind == "servo" else torque_log(tmp_path / "log")
    selection = evidence_of(given, FEW, lambda _: None)
    terms = selection.evidence.terms[:2]
    cells = selection.layout.of(selection.columns(terms))
    values = 0.3 * np.random.default_rng(0).normal(size=len(selection.columns(terms)))
    level = np.concatenate(selection.values)

    def cost(values: Array) -> float:
        excess = cells.state(values).excess
        cost = level * np.log1p(np.maximum(excess, 0) / level)
        return float(np.sum(cost + np.minimum(excess, 0)))

    state = cells.state(values)
    slope = 2 * cells.steps(state, level / (level + np.maximum(state.excess, 0)))[1]
    for own, unit in zip(slope, 1e-5 * np.eye(len(values)), strict=True):
        moved = (cost(values + unit) - cost(values - unit)) / 2e-5
        assert own == pytest.approx(moved, rel=1e-3, abs=1e-3 * np.abs(slope).max())


def test_noise_is_what_the_operator_makes_of_it(tmp_path: Path) -> None:
    """Of an arm that is held nothing but noise is left, in every band, and of a late reading."""
    held = record(tmp_path / "held", edit=lambda spec: None, steps_s=1e3)
    later = held.runs[0].time > 2.0
    runs = [
        replace(
            run, time=run.time[later] - 2.0,
            sensors={name: values[later] for name, values in run.sensors.items()},
            controls={name: values[later] for name, values in run.controls.items()},
        )
        for run in held.runs
    ]  # fmt: skip
    machine = NominalModel(held.spec())
    balance = Balance(machine, smooth(replace(held, runs=tuple(runs)), machine))
    late = [n for n in nuisances(balance, Tolerances()) if n.read_late]
    for joint in range(2):
        grid = grid_of(balance, joint)
        bands, band = np.unique(grid.turn, return_inverse=True)
        counts = np.bincount(band, grid.count)
        (own,) = (n for n in late if n.read_late and n.read_late[0] == joint)
        columns = np.stack([balance.residual[:, joint], own.change.at(joint)], axis=1)
        powers = np.stack(
            [np.bincount(band[grid.cell], x**2) / counts for x in grid.whitened(columns).T]
        )
        delays = np.zeros((1, 2, 2))
        delays[0, 1, joint] = own.size
        still, moved = operator_noise(balance, joint, bands, own.operator[None], delays)
        for power, parts in ((powers[0], still), (powers[1], moved[..., 0])):
            assert power == pytest.approx(np.sum(parts**2, axis=1) / 1.1**2, rel=0.6)
