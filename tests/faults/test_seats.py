"""Every link of every arm takes a seat, and a shut seat shows nowhere."""

from __future__ import annotations

import re
from collections.abc import Callable
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
    Fault,
    Healthy,
    Preload,
    RotationalLooseness,
    SeatKind,
    StructuralLooseness,
    hypotheses,
    place_of,
    seat_of,
    seated_spec,
    seats_of,
    set_seat,
)
from loose_env.rig import Plant, PlantShop, SimulatedRig
from loose_env.typing import Array

KINDS: tuple[SeatKind, ...] = ("slide", "hinge", "play")
ARMS: dict[str, Callable[[], Arm]] = {
    **{f"planar{n}": (lambda n=n: planar(n)) for n in range(2, 8)},  # type: ignore[misc]
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


def test_the_arm_s_own_spec_is_left_as_it_was(arm: Arm) -> None:
    before = arm.spec.copy().compile().nv
    seated_spec(arm, 1, "slide")
    assert arm.spec.copy().compile().nv == before


def test_play_turns_about_its_joint(arm: Arm) -> None:
    for link in range(1, arm.n + 1):
        model = seated_spec(arm, link, "play").compile()
        data = mujoco.MjData(model)
        data.qpos[:] = np.random.default_rng(link).uniform(-1, 1, model.nq)
        mujoco.mj_forward(model, data)
        seat, joint = data.joint(SEAT), data.joint(arm.joints[link - 1])
        np.testing.assert_allclose(seat.xaxis, joint.xaxis, atol=1e-12)
        np.testing.assert_allclose(seat.xanchor, joint.xanchor, atol=1e-12)


def test_a_slide_seat_moves_along_its_direction_in_the_link_frame(arm: Arm) -> None:
    for link in range(1, arm.n + 1):
        model = seated_spec(arm, link, "slide").compile()
        set_seat(model, loosened("slide", link, direction=(3.0, -4.0, 0.0)))
        data = mujoco.MjData(model)
        data.qpos[:] = np.random.default_rng(link).uniform(-1, 1, model.nq)
        mujoco.mj_forward(model, data)
        frame = data.body(arm.seat_bodies[link - 1]).xmat.reshape(3, 3)
        np.testing.assert_allclose(data.joint(SEAT).xaxis, frame @ [0.6, -0.8, 0.0], atol=1e-12)


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


def test_a_loose_seat_shows(arm: Arm) -> None:
    # The comparison above could see a seat that moves.
    plants = shut(arm)
    loose = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False).build(
        loosened("slide", 1), MismatchDraw.none(arm)
    )
    readings = shaken(arm, [plants[0], loose], np.arange(arm.n) == 0)[..., :2]
    moved = np.linalg.norm(readings[0] - readings[0, 0])
    assert np.linalg.norm(readings[1] - readings[0]) > 1e-2 * moved


def test_mass_and_inertia_do_not_depend_on_the_seat(arm: Arm) -> None:
    pose = np.random.default_rng(3).uniform(-1, 1, arm.n)
    bare = arm.model
    data = mujoco.MjData(bare)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(bare, data)
    expected = np.zeros((bare.nv, bare.nv))
    mujoco.mj_fullM(bare, data, expected)
    for link, kind in places(arm):
        model = seated_spec(arm, link, kind).compile()
        assert model.body_mass.sum() == pytest.approx(bare.body_mass.sum(), rel=1e-12)
        data = mujoco.MjData(model)
        for name, value in zip(arm.joints, pose, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        rest = np.delete(np.arange(model.nv), model.joint(SEAT).dofadr[0])
        np.testing.assert_allclose(full[np.ix_(rest, rest)], expected, rtol=1e-9, atol=1e-12)


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


@pytest.mark.parametrize("link", [0, 4, -1, 1.0, True, "1", None])
def test_a_link_the_arm_lacks_is_refused(link: Any) -> None:
    with pytest.raises(UnknownName, match="1 to 3") as refusal:
        seated_spec(planar(3), link, "slide")
    assert repr(link) in str(refusal.value)


def test_an_unknown_kind_of_seat_is_refused() -> None:
    with pytest.raises(UnknownName, match=r"'slide', a 'hinge' or a 'play', got 'ball'"):
        seated_spec(planar(2), 1, "ball")  # type: ignore[arg-type]


def test_a_fault_of_no_known_kind_is_refused() -> None:
    with pytest.raises(UnknownName, match=r"Healthy, Preload.*got str: 'backlash'"):
        seat_of("backlash")  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bad", [-1e-4, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["gap", "stiffness", "damping", "friction"])
def test_figures_below_zero_or_not_finite_are_refused(
    kind: SeatKind, name: str, bad: float
) -> None:
    values = [(bad, 1.0), (1.0, bad)] if name in ("stiffness", "damping") else [bad]
    for value in values:
        with pytest.raises(InvalidSetting, match=f"{name} must be.*zero or more.*{bad}"):
            loosened(kind, 1, **{name: value})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bad", [1e4, (1e4,), (1e4, 1e4, 1e4)])
def test_a_stiffness_that_is_not_one_for_each_stop_is_refused(kind: SeatKind, bad: Any) -> None:
    with pytest.raises(InvalidSetting, match="stiffness must be two finite numbers") as refusal:
        loosened(kind, 1, stiffness=bad)
    assert repr(bad) in str(refusal.value)


@pytest.mark.parametrize("name", ["stiffness", "damping"])
@pytest.mark.parametrize("bad", [-1.0, float("nan"), float("inf")])
def test_a_preload_below_zero_or_not_finite_is_refused(name: str, bad: float) -> None:
    settings = {"stiffness": 1e6, "damping": 1.0, name: bad}
    with pytest.raises(InvalidSetting, match=f"{name} must be.*zero or more.*{bad}"):
        Preload(link=1, direction=(1.0, 0.0, 0.0), **settings)


@pytest.mark.parametrize("make", [StructuralLooseness, Preload])
@pytest.mark.parametrize(
    "direction", [(0.0, 0.0, 0.0), (1.0, 0.0), (float("nan"), 0.0, 1.0), (float("inf"), 0.0, 0.0)]
)
def test_a_direction_that_points_nowhere_is_refused(make: Any, direction: Any) -> None:
    settings: dict[str, Any] = {"link": 1, "direction": direction}
    if make is StructuralLooseness:
        settings |= {"gap": 1e-4, "stiffness": (1e4, 1e4)}
    else:
        settings |= {"stiffness": 1e6}
    with pytest.raises(InvalidSetting, match="three finite numbers, not all zero"):
        make(**settings)


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


def test_a_preloaded_seat_too_stiff_for_the_step_is_refused() -> None:
    rig = SimulatedRig(planar(2))
    seat = Preload(link=1, direction=(1.0, 0.0, 0.0), stiffness=1e10)
    with pytest.raises(InvalidSetting, match="too fast for a step"):
        rig.mount(0, seat)


def test_a_stop_damped_too_hard_for_the_step_is_refused() -> None:
    rig = SimulatedRig(planar(2))
    stop = StructuralLooseness(
        link=2, direction=(1.0, 0.0, 0.0), gap=1e-4, stiffness=(1e6, 1e6), damping=(1e3, 1e6)
    )
    with pytest.raises(InvalidSetting, match="use less than"):
        rig.mount(0, stop)
