"""Every link takes a seat, a shut seat shows nowhere, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch
from numpy.typing import NDArray

from loose_env.arms import Arm, MismatchDraw, planar, vera
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import (
    SEAT,
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    Preload,
    RotationalLooseness,
    SeatKind,
    SeveralFaults,
    StructuralLooseness,
    hypotheses,
    place_of,
    preloaded,
    seat_names,
    seat_of,
    seated_spec,
    seats_of,
    set_seat,
    twist_of,
)
from loose_env.rig import Plant, PlantShop, SimulatedRig
from loose_env.typing import Array

KINDS: tuple[SeatKind, ...] = ("slide", "hinge", "play")
ARMS: dict[str, Callable[[], Arm]] = {
    **{f"planar{n}": (lambda n=n: planar(n)) for n in (2, 4, 7)},  # type: ignore[misc]
    "planar3v": lambda: planar(3, vertical=True),
    "vera": vera,
}


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> Arm:
    return ARMS[request.param]()


def places(arm: Arm) -> list[tuple[int, SeatKind]]:
    return [(link, kind) for link in range(1, arm.n + 1) for kind in KINDS]


def shut(arm: Arm) -> list[Plant]:
    """The healthy nominal arm, once with every seat it can have."""
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    none = MismatchDraw.none(arm)
    return [Plant(shop.template(*place), arm, Healthy(), none) for place in places(arm)]


def loosened(kind: SeatKind, link: int, **changes: Any) -> Fault:
    settings = {"gap": 1e-4, "stiffness": (1e4, 2e4), "damping": (1.0, 2.0), **changes}
    if kind == "play":
        return Backlash(joint=link, **settings)
    if kind == "hinge":
        return RotationalLooseness(**{"link": link, "axis": (0.0, 0.0, 1.0), **settings})
    return StructuralLooseness(**{"link": link, "direction": (0.0, 1.0, 0.0), **settings})


def test_every_link_takes_all_kinds_of_seat(arm: Arm) -> None:
    for link, kind in places(arm):
        model = seated_spec(arm, link, kind).compile()
        assert model.nv == arm.model.nv + 1
        seat = model.joint(SEAT)
        assert model.body(seat.bodyid[0]).name == arm.seat_bodies[link - 1]
        wanted = mujoco.mjtJoint.mjJNT_SLIDE if kind == "slide" else mujoco.mjtJoint.mjJNT_HINGE
        assert seat.type[0] == wanted


def shaken(arm: Arm, plants: list[Plant], excited: NDArray[np.bool_]) -> Array:
    """Readings of all plants under the same torque: (plants, steps, channels)."""
    batch = Batch(plants[0].model, len(plants), 1)
    shake = Excitation(
        torque_rms=tuple(np.where(excited, np.array(arm.torque_limits) / 4, 0.0)),
        duration=0.2,
        band=arm.band,
    )
    torque = torque_signals(
        shake, timestep=arm.timestep, before=0, after=0, rng=np.random.default_rng(0)
    )
    position, active = batch.bind("qpos"), batch.bind("eq_active")
    for k, plant in enumerate(plants):
        position[k, plant.position] = plant.hold_at(np.linspace(0.3, 0.9, arm.n))
        active[k] = plant.model.eq_active0
        active[k, plant.brakes] = ~excited
    batch.set_models([plant.model for plant in plants])
    control = np.broadcast_to(torque.T, (len(plants), *torque.T.shape))
    found: Array = batch.rollout(control.shape[1], control, record=("sensordata",))["sensordata"]
    assert not batch.warning[..., 1].any()
    return found


@pytest.mark.parametrize("all_excited", [False, True], ids=["brakes on", "brakes off"])
def test_a_shut_seat_shows_nowhere(arm: Arm, all_excited: bool) -> None:
    # All seats in one batch: their layouts are the same.
    excited = np.ones(arm.n, dtype=bool) if all_excited else np.arange(arm.n) == 0
    readings = shaken(arm, shut(arm), excited)
    mean = readings.mean(axis=0)
    for channels in (slice(0, 2), slice(3, 3 + arm.n)):  # tool in the plane, encoders
        moved = np.linalg.norm(mean[:, channels] - mean[0, channels])
        assert moved > 0
        for seat, own in zip(places(arm), readings, strict=True):
            error = np.linalg.norm(own[:, channels] - mean[:, channels])
            assert error < 1e-4 * moved, f"{seat} reads differently by {error / moved:.1e}"


def test_a_seat_can_be_set_again() -> None:
    arm = planar(3)
    spec = seated_spec(arm, 2, "slide")
    spec.option.timestep = arm.timestep
    once, again = spec.compile(), spec.compile()
    final = loosened("slide", 2, direction=(1.0, 1.0, 0.0), friction=2.0)
    set_seat(once, final)
    for first in (
        Healthy(),
        Preload(link=2, direction=(0.0, 1.0, 0.0), stiffness=1e6, damping=10.0),
        loosened("slide", 2, gap=3e-4),
    ):
        set_seat(again, first)
    set_seat(again, final)
    for field in (
        "eq_active0",
        "eq_solref",
        "jnt_axis",
        "jnt_stiffness",
        "dof_damping",
        "dof_frictionloss",
        "tendon_range",
        "tendon_solref_lim",
    ):
        np.testing.assert_array_equal(getattr(again, field), getattr(once, field), err_msg=field)


def test_hypotheses_name_every_place_and_each_fault_its_own(arm: Arm) -> None:
    names = hypotheses(arm, ("healthy", "structural_looseness", "backlash", "rotational_looseness"))
    assert len(names) == len(set(names)) == 3 * arm.n + 1
    assert Healthy().hypothesis in names
    for link, kind in places(arm):
        fault = loosened(kind, link)
        assert fault.hypothesis in names
        assert place_of(fault.hypothesis) == link
        assert seats_of(fault) == (link, (kind,))


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
        set_seat(model, loosened(kind, 2, stiffness=tuple(stiffness)))
    # The message names a stiffness and a step that are allowed: they must be.
    named = re.search(r"use (\S+) at most, or a step of (\S+) s at most", str(refusal.value))
    assert named is not None
    allowed, step = float(named[1]), float(named[2])
    set_seat(model, loosened(kind, 2, stiffness=(0.99 * allowed, 0.99 * allowed)))
    model.opt.timestep = 0.95 * step
    set_seat(model, loosened(kind, 2, stiffness=tuple(stiffness)))


# ---- what is refused


NAN, INF = float("nan"), float("inf")
SLIDE: dict[str, Any] = {"link": 2, "direction": (1, 0, 0), "gap": 1e-3, "stiffness": (1e4, 1e4)}
ROCK: dict[str, Any] = {"link": 2, "axis": (0, 0, 1), "gap": 1e-3, "stiffness": (1e3, 1e3)}
PLAY: dict[str, Any] = {"joint": 2, "gap": 1e-3, "stiffness": (1e3, 1e3)}
TIGHT: dict[str, Any] = {"link": 2, "direction": (1, 0, 0), "stiffness": 1e6}
slide, rock, play = StructuralLooseness(**SLIDE), RotationalLooseness(**ROCK), Backlash(**PLAY)
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
        (CompoundLooseness, {"link": 2}, {"parts": parts}, said)
        for parts, said in (
            ((), "two to six parts"),
            ((slide,), "for one use StructuralLooseness"),
            ([slide, rock], "a tuple of two to six"),
            ((Healthy(), rock), r"parts .* are StructuralLooseness or"),
            ((replace(slide, link=1), rock), "lie on its link 2; got one on link 1"),
            (
                (slide, replace(slide, direction=(0, 1, 0)), replace(slide, direction=(1, 1, 0))),
                "directions of the slides must be independent, three at most",
            ),
            ((rock, replace(rock, pivot=(1.0, 0, 0))), "axes of the rotations must be independent"),
        )
    ),
    *(
        (SeveralFaults, {}, {"faults": faults}, said)
        for faults, said in (
            ((slide,), "two or more"),
            ([replace(slide, link=1), play], "tuple"),
            ((slide, Healthy()), "each of several faults"),
            ((slide, Preload(**TIGHT)), "each of several faults"),
            ((slide, play), "different numbers"),
            ((slide, slide), "different numbers"),
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
    return seated_spec(planar(2), 1, kinds).compile()


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        *(
            (lambda link=link: seated_spec(planar(3), link, "slide"), UnknownName, "1 to 3")
            for link in (0, 4, -1, 1.0, True, "1", None)
        ),
        (lambda: seat("ball"), UnknownName, r"'slide', a 'hinge' or a 'play', got 'ball'"),
        (lambda: seat(), InvalidSetting, "1 to 6 degrees of freedom, got 0"),
        (lambda: seat(*["slide"] * 4), InvalidSetting, "three slides and three hinges at most"),
        (lambda: seated_spec(planar(3), (1, 2), ("slide",)), InvalidSetting, "one link"),
        (lambda: set_seat(seat("slide"), replace(slide, gap=5.0)), InvalidSetting, "gap of 5 is"),
        (lambda: set_seat(seat("slide"), rock), InvalidSetting, "needs a hinge, which 'seat'"),
        (
            lambda: set_seat(seat("slide"), CompoundLooseness(link=2, parts=(slide, rock))),
            InvalidSetting,
            "2 loose degrees of freedom, the model's seat has 1",
        ),
        (lambda: set_seat(seat("slide", "hinge"), slide), InvalidSetting, "has 1 loose"),
        (lambda: seat_of("backlash"), UnknownName, r"Healthy, Preload.*got str: 'backlash'"),  # type: ignore[arg-type]
        (lambda: seat_of(rock), InvalidSetting, "is not dealt with here"),
        (
            lambda: seats_of(SeveralFaults(faults=(replace(slide, link=1), play))),
            InvalidSetting,
            "part_seats",
        ),
        (lambda: twist_of(planar(2), Healthy()), InvalidSetting, "one loose degree of freedom"),
        (lambda: preloaded(planar(2), slide, NAN), InvalidSetting, "finite"),
        (
            lambda: SimulatedRig(planar(2)).mount(0, Preload(**TIGHT | {"stiffness": 1e10})),
            InvalidSetting,
            "too fast for a step",
        ),
        (
            lambda: SimulatedRig(planar(2)).mount(0, replace(slide, damping=(1e3, 1e6))),
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
