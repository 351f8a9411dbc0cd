"""Seats: where they stand, alone and together, what a load does to them, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, planar, vera
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults import (
    SEAT,
    SEVERAL_FAULTS,
    Backlash,
    Healthy,
    Preload,
    RotationalLooseness,
    SeatKind,
    SeveralFaults,
    StructuralLooseness,
    gaps_of,
    hypotheses,
    part_seats,
    parts_of,
    place_of,
    preloaded,
    seat_names,
    seat_weight,
    seated_spec,
    set_seat,
    twist_of,
)
from loose_env.rig import Plant, SimulatedRig
from loose_env.typing import Array
from tests.faults.seats import (
    ARMS,
    at_pose,
    inertia_of,
    plant_of,
    play,
    pose_of,
    records,
    rock,
    slide,
)

KINDS: tuple[SeatKind, ...] = ("slide", "hinge", "play")
MAKE: dict[SeatKind, Callable[..., Any]] = {"slide": slide, "hinge": rock, "play": play}
FLAT: dict[str, Callable[[], Arm]] = {
    "planar4": lambda: planar(4),
    "planar3v": lambda: planar(3, vertical=True),
    "vera": vera,
}


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> Arm:
    return ARMS[request.param]()


@pytest.fixture(params=FLAT)
def flat(request: pytest.FixtureRequest) -> Arm:
    return FLAT[request.param]()


def places(arm: Arm) -> list[tuple[int, SeatKind]]:
    return [(link, kind) for link in range(1, arm.n + 1) for kind in KINDS]


def test_every_link_takes_all_kinds_of_seat(flat: Arm) -> None:
    for link, kind in places(flat):
        model = seated_spec(flat, link, kind).compile()
        assert model.nv == flat.model.nv + 1
        seat = model.joint(SEAT)
        assert model.body(seat.bodyid[0]).name == flat.seat_bodies[link - 1]
        wanted = mujoco.mjtJoint.mjJNT_SLIDE if kind == "slide" else mujoco.mjtJoint.mjJNT_HINGE
        assert seat.type[0] == wanted


def test_a_shut_seat_shows_nowhere(flat: Arm) -> None:
    specs = [flat.spec.copy(), *(seated_spec(flat, *place) for place in places(flat))]
    ends = []
    for spec in specs:
        spec.option.timestep = flat.timestep
        model = spec.compile()
        set_seat(model, Healthy())
        data, torque = mujoco.MjData(model), np.array(flat.torque_limits) / 4
        for k, name in enumerate(flat.joints):
            data.joint(name).qpos[0], data.joint(name).qfrc_applied[0] = 0.3 + 0.3 * k, torque[k]
        mujoco.mj_step(model, data, round(0.2 / flat.timestep))
        mujoco.mj_forward(model, data)
        turned = [data.joint(name).qpos[0] - 0.3 - 0.3 * k for k, name in enumerate(flat.joints)]
        ends.append(np.concatenate([turned, data.site(flat.tool).xpos]))
    bare, *seated = np.array(ends)
    assert np.abs(bare[: flat.n]).min() > 1e-3
    for place, own in zip(places(flat), seated, strict=True):
        np.testing.assert_allclose(own, bare, atol=1e-4 * np.abs(bare).max(), err_msg=str(place))


def test_hypotheses_name_every_place_and_each_fault_its_own(flat: Arm) -> None:
    names = hypotheses(flat)
    assert len(names) == len(set(names)) == 2 * flat.n + 1
    assert Healthy().hypothesis in names
    for link, kind in places(flat):
        fault = MAKE[kind](link)
        assert (fault.hypothesis in names) == (kind != "hinge")  # a link that rocks is none
        assert place_of(fault.hypothesis) == link
        assert part_seats(fault) == ((link,), (kind,))


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_a_stop_too_stiff_for_the_step_is_refused_with_what_would_do(
    kind: SeatKind, side: int
) -> None:
    arm = planar(3)
    model = seated_spec(arm, 2, kind).compile()
    model.opt.timestep = arm.timestep
    stiffness = [100.0, 100.0]
    stiffness[side] = 1e9
    with pytest.raises(InvalidSetting, match=r"1e\+09 .* Hz, too fast for a step of") as refusal:
        set_seat(model, MAKE[kind](2, stiffness=tuple(stiffness)))
    # The message names a stiffness and a step that are allowed: they must be.
    named = re.search(r"use (\S+) at most, or a step of (\S+) s at most", str(refusal.value))
    assert named is not None
    allowed, step = float(named[1]), float(named[2])
    set_seat(model, MAKE[kind](2, stiffness=(0.99 * allowed, 0.99 * allowed)))
    model.opt.timestep = 0.95 * step
    set_seat(model, MAKE[kind](2, stiffness=tuple(stiffness)))


def test_every_seat_stands_where_it_would_stand_alone(arm: Arm) -> None:
    pose = pose_of(arm)
    for first, second in ((slide(1), play(2)), (play(1), slide(2)), (play(1), rock(2))):
        both = plant_of(arm, SeveralFaults(faults=(first, second)))
        for own, alone in (("seat", plant_of(arm, first)), ("seat2", plant_of(arm, second))):
            np.testing.assert_allclose(
                inertia_of(both.model, at_pose(both, pose), (*arm.joints, own)),
                inertia_of(alone.model, at_pose(alone, pose), (*arm.joints, "seat")),
                rtol=1e-12,
                atol=1e-14,
            )


def test_seats_of_several_links_keep_their_order(arm: Arm) -> None:
    fault = SeveralFaults(faults=(play(2), slide(1)))
    assert parts_of(fault) == (play(2), slide(1))
    assert part_seats(fault) == ((2, 1), ("play", "slide"))
    assert gaps_of(fault) == (1e-3, 2e-4)
    assert fault.hypothesis == fault.kind == SEVERAL_FAULTS
    plant = plant_of(arm, fault)
    assert plant.parts == 2 and seat_names(plant.model) == ("seat", "seat2")
    bodies = [int(plant.model.joint(s).bodyid[0]) for s in seat_names(plant.model)]
    assert bodies == [plant.model.body(arm.seat_bodies[k]).id for k in (1, 0)]


def test_a_seat_that_nothing_opens_leaves_the_other_as_it_is_alone(arm: Arm) -> None:
    loose, shut = slide(1, friction=0.5), play(2, friction=1e6)
    alone, beside, both = records(
        arm, [loose, SeveralFaults(faults=(loose, shut)), SeveralFaults(faults=(loose, play(2)))]
    )
    start = slice(0, 60)  # later on, strikes of the stops magnify the last digits
    size = np.linalg.norm(alone[:, start])
    assert np.linalg.norm(beside[:, start] - alone[:, start]) < 0.03 * size
    assert np.linalg.norm(both[:, start] - alone[:, start]) > 0.05 * size


@pytest.mark.parametrize("load", [20.0, -3.5])
def test_a_preload_is_a_constant_force_on_the_seat(arm: Arm, load: float) -> None:
    for fault in (slide(2, preload=load), play(1, preload=load), rock(2, preload=load)):
        plant = plant_of(arm, fault)
        data, dof = at_pose(plant, pose_of(arm)), int(plant.model.joint("seat").dofadr[0])
        for place in (-0.5, 0.0, 0.5):
            data.qpos[plant.indices.seat_positions] = place * fault.gap
            mujoco.mj_forward(plant.model, data)
            assert data.qfrc_passive[dof] == pytest.approx(load, rel=1e-6)


def settled(plant: Plant, pose: Array, push: float) -> float:
    """Where a seat comes to rest under a further force on it [m or rad]."""
    data, dof = at_pose(plant, pose), int(plant.model.joint("seat").dofadr[0])
    data.qfrc_applied[dof] = push
    mujoco.mj_step(plant.model, data, round(1.0 / plant.model.opt.timestep))
    assert abs(data.qvel[dof]) < 1e-5
    return float(data.qpos[plant.indices.seat_positions[0]])


@pytest.mark.parametrize("make", [slide, play])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pressed_seat_rests_on_its_stop_until_the_drive_exceeds_the_load(
    make: Callable[..., StructuralLooseness | Backlash], sign: float
) -> None:
    arm = planar(3)
    pose, load = np.array([0.1, 0.5, 0.3]), sign * (8.0 if make is slide else 0.4)
    springs, dampers = (
        ((2e4, 3e4), (300.0, 300.0)) if make is slide else ((1e4, 2e4), (100.0, 100.0))
    )
    fault = make(2, preload=load, stiffness=springs, damping=dampers)
    plant = plant_of(arm, fault)
    side = 1 if sign > 0 else 0
    for share in (0.0, 0.5, 0.9, -0.5):
        # On the stop that the load presses on, as deep as what is left of it pushes.
        left = (1 - share) * abs(load)
        wanted = sign * (fault.gap / 2 + left / fault.stiffness[side])
        assert settled(plant, pose, -share * load) == pytest.approx(wanted, rel=1e-3)
    wanted = -sign * (fault.gap / 2 + 0.5 * abs(load) / fault.stiffness[1 - side])
    assert settled(plant, pose, -1.5 * load) == pytest.approx(wanted, rel=1e-3)


def test_the_weight_on_a_seat_is_the_most_that_gravity_can_do(arm: Arm) -> None:
    parts: list[Any] = []
    for link in range(1, arm.n + 1):
        parts += [slide(link), rock(link), play(link)]
    for part in parts:
        plant = plant_of(arm, part)
        data, dof = mujoco.MjData(plant.model), int(plant.model.joint("seat").dofadr[0])
        forces = []
        for axis in np.eye(3):
            plant.model.opt.gravity[:] = 9.81 * axis
            mujoco.mj_forward(plant.model, data)
            forces.append(data.qfrc_bias[dof])
        assert seat_weight(arm, part) == pytest.approx(float(np.linalg.norm(forces)), rel=1e-9)


# ---- what is refused


NAN, INF = float("nan"), float("inf")
SLIDE: dict[str, Any] = {"link": 2, "direction": (1, 0, 0), "gap": 1e-3, "stiffness": (1e4, 1e4)}
ROCK: dict[str, Any] = {"link": 2, "axis": (0, 0, 1), "gap": 1e-3, "stiffness": (1e3, 1e3)}
PLAY: dict[str, Any] = {"joint": 2, "gap": 1e-3, "stiffness": (1e3, 1e3)}
TIGHT: dict[str, Any] = {"link": 2, "direction": (1, 0, 0), "stiffness": 1e6}
SLIDING, ROCKING, PLAYING = slide(2), rock(2), play(2)
REFUSED: list[tuple[Any, dict[str, Any], dict[str, Any], str]] = [
    *(
        (kind, given, {name: bad if name in ("gap", "friction") else (1.0, bad)}, "zero or more")
        for kind, given in (
            (StructuralLooseness, SLIDE), (RotationalLooseness, ROCK), (Backlash, PLAY)
        )
        for name in ("gap", "stiffness", "damping", "friction")
        for bad in (-1e-4, NAN, INF)
    ),
    *((Preload, TIGHT, {name: -1.0}, "zero or more") for name in ("stiffness", "damping")),
    *(
        (StructuralLooseness, SLIDE, {"stiffness": bad}, "stiffness must be two finite numbers")
        for bad in (1e4, (1e4,), (1e4, 1e4, 1e4), ("1", "2"))
    ),
    *(
        (kind, given, {"direction": bad}, "direction must be three finite numbers, not all zero")
        for kind, given in ((StructuralLooseness, SLIDE), (Preload, TIGHT))
        for bad in ((0.0, 0.0, 0.0), (1.0, 0.0), (NAN, 0.0, 1.0), (INF, 0.0, 0.0))
    ),
    *((RotationalLooseness, ROCK, {"axis": bad}, "axis must be three") for bad in ((0, 0, 0), "x")),
    *(
        (RotationalLooseness, ROCK, {"pivot": bad}, "pivot must be three finite numbers")
        for bad in ((0.0, NAN, 0.0), (0.0, 1.0), None)
    ),
    *(
        (Backlash, PLAY, {"preload": bad}, "preload must be a finite number")
        for bad in (NAN, INF, "1", None)
    ),
    *(
        (SeveralFaults, {}, {"faults": faults}, said)
        for faults, said in (
            *(
                (faults, "faults must be a tuple of two or more loose faults")
                for faults in (
                    (SLIDING,),
                    (SLIDING, Healthy()),
                    (SLIDING, Preload(**TIGHT)),
                )
            ),
            ((SLIDING, PLAYING), "different numbers"),
            ((SLIDING, SLIDING), "different numbers"),
        )
    ),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "given", "changes", "words"), REFUSED)
def test_a_fault_that_is_none_is_refused(
    kind: Any, given: dict[str, Any], changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(InvalidSetting, match=words):
        kind(**given | changes)


def seat(*kinds: Any) -> mujoco.MjModel:
    return seated_spec(planar(2), range(1, 1 + len(kinds)), kinds).compile()


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        *(
            (lambda link=link: seated_spec(planar(3), link, "slide"), UnknownName, "1 to 3")
            for link in (0, 4, -1, 1.0, True, "1", None)
        ),
        (lambda: seat("ball"), UnknownName, r"'slide', a 'hinge' or a 'play', got 'ball'"),
        (lambda: seat(), InvalidSetting, "each of 0 degrees of freedom"),
        (lambda: seated_spec(planar(3), (1, 1), ["slide"] * 2), InvalidSetting, "of its own"),
        (lambda: seated_spec(planar(3), (1, 2), ("slide",)), InvalidSetting, "of its own"),
        (lambda: set_seat(seat("slide"), replace(SLIDING, gap=5.0)), InvalidSetting, "gap of 5 is"),
        (lambda: set_seat(seat("slide"), ROCKING), InvalidSetting, "needs a hinge, which 'seat'"),
        (
            lambda: set_seat(seat("slide"), SeveralFaults(faults=(SLIDING, play(1)))),
            InvalidSetting,
            "2 loose degrees of freedom, the model's seat has 1",
        ),
        (lambda: set_seat(seat("slide", "hinge"), SLIDING), InvalidSetting, "has 1 loose"),
        (lambda: part_seats("backlash"), UnknownName, r"Healthy, Preload.*got str: 'backlash'"),  # type: ignore[arg-type]
        (lambda: twist_of(planar(2), Healthy()), InvalidSetting, "one loose degree of freedom"),
        (lambda: preloaded(planar(2), SLIDING, NAN), InvalidSetting, "finite"),
        (
            lambda: SimulatedRig(planar(2)).mount(0, Preload(**TIGHT | {"stiffness": 1e10})),
            InvalidSetting,
            "too fast for a step",
        ),
        (
            lambda: SimulatedRig(planar(2)).mount(0, replace(SLIDING, damping=(1e3, 1e6))),
            InvalidSetting,
            "use less than",
        ),
    ],
)
def test_a_seat_that_cannot_be_is_refused(call: Any, error: Any, words: str) -> None:
    with pytest.raises(error, match=words):
        call()


def test_a_healthy_arm_may_stand_in_any_seat() -> None:
    model = seat("slide", "hinge")
    set_seat(model, Healthy())
    assert model.eq_active0[[model.equality(f"{name}_lock").id for name in seat_names(model)]].all()
