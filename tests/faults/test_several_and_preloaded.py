"""Seats on several links at once, seats that a load presses on a stop, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, MismatchDraw, planar, scara, six_axis, vera
from loose_env.errors import InvalidSetting
from loose_env.excitation import at_levels
from loose_env.faults import (
    SEVERAL_FAULTS,
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    LooseFault,
    Preload,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
    gaps_of,
    part_seats,
    parts_of,
    preloaded,
    seat_names,
    seat_weight,
    twist_of,
)
from loose_env.rig import Job, Plant, PlantShop, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

ARMS: dict[str, Callable[[], Arm]] = {
    "planar3": lambda: planar(3),
    "vera": vera,
    "six_axis": six_axis,
    "scara": scara,
}


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> Arm:
    return ARMS[request.param]()


def slide(link: int, **changes: Any) -> StructuralLooseness:
    figures = {"direction": (0.6, 0.8, 0.0), "gap": 2e-4, "stiffness": (2e4, 3e4)}
    return StructuralLooseness(**{"link": link, **figures, **changes})


def play(joint: int, **changes: Any) -> Backlash:
    return Backlash(**{"joint": joint, "gap": 1e-3, "stiffness": (2e2, 4e2), **changes})


def rocking(link: int, **changes: Any) -> RotationalLooseness:
    figures = {"axis": (0, 0, 1), "gap": 1e-3, "stiffness": (2e2, 2e2), "pivot": (0.01, 0.03, 0)}
    return RotationalLooseness(**{"link": link, **figures, **changes})


def plant_of(arm: Arm, fault: Fault, *, gravity: bool = True) -> Plant:
    shop = PlantShop(arm, timestep=arm.timestep, link_accelerometers=False)
    plant = shop.build(fault, MismatchDraw.none(arm))
    if not gravity:
        plant.model.opt.gravity[:] = 0.0
    return plant


def at_pose(plant: Plant, pose: Array) -> mujoco.MjData:
    data = mujoco.MjData(plant.model)
    data.qpos[plant.position] = plant.hold_at(pose)
    return data


def pose_of(arm: Arm) -> Array:
    return arm.random_pose(np.random.default_rng(7))


def inertia_of(plant: Plant, pose: Array, names: tuple[str, ...]) -> Array:
    """Inertia matrix of named joints (k, k)."""
    model, data = plant.model, at_pose(plant, pose)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dofs = [int(model.joint(name).dofadr[0]) for name in names]
    return full[np.ix_(dofs, dofs)]


def test_every_seat_stands_where_it_would_stand_alone(arm: Arm) -> None:
    pose, full = pose_of(arm), LinearArm(arm, points=4, rotations=True)
    at = full.at(pose)
    for first, second in ((slide(1), play(2)), (play(1), slide(2)), (play(1), rocking(2))):
        both = plant_of(arm, SeveralFaults(faults=(first, second)))
        for own, alone in (("seat", plant_of(arm, first)), ("seat2", plant_of(arm, second))):
            np.testing.assert_allclose(
                inertia_of(both, pose, (*arm.joints, own)),
                inertia_of(alone, pose, (*arm.joints, "seat")),
                rtol=1e-12,
                atol=1e-14,
            )
        # How they couple, from the arm with every seat open that knows no faults.
        columns = np.zeros((len(at.inertia), 2))
        for k, part in enumerate((first, second)):
            columns[full.twist_dofs[k], k] = twist_of(arm, part)
        coupling = float(columns[:, 0] @ at.inertia @ columns[:, 1])
        assert inertia_of(both, pose, ("seat", "seat2"))[0, 1] == pytest.approx(coupling, rel=1e-8)
        assert abs(coupling) > 1e-3


def test_a_compound_seat_beside_another_keeps_its_parts_in_order(arm: Arm) -> None:
    cross = CompoundLooseness(link=1, parts=(slide(1), rocking(1)))
    fault = SeveralFaults(faults=(cross, play(2)))
    assert parts_of(fault) == (slide(1), rocking(1), play(2))
    assert part_seats(fault) == ((1, 1, 2), ("slide", "hinge", "play"))
    assert gaps_of(fault) == (2e-4, 1e-3, 1e-3)
    assert fault.hypothesis == fault.kind == SEVERAL_FAULTS
    plant = plant_of(arm, fault)
    assert plant.parts == 3 and seat_names(plant.model) == ("seat", "seat2", "seat3")
    bodies = [int(plant.model.joint(s).bodyid[0]) for s in seat_names(plant.model)]
    wanted = [plant.model.body(arm.seat_bodies[k]).id for k in (0, 0, 1)]
    assert bodies == wanted


def records(arm: Arm, faults: list[Fault], slots: list[int] | None = None) -> list[Array]:
    """Tool acceleration with ideal sensors of several arms, measured together (d, N) each."""
    rig = SimulatedRig(arm, slots=len(faults), sensors=SensorSuite.ideal(), threads=1)
    for slot, fault in enumerate(faults):
        rig.mount(slot, fault)
    pose = pose_of(arm)
    excitation, _ = at_levels(rig.nominal.at(pose), np.full(arm.n, arm.levels[1]), duration=0.2)
    jobs = [
        Job(slot=slot, pose=pose, excitation=excitation, rng=np.random.default_rng(3))
        for slot in range(len(faults))
    ]
    found = rig.measure_many(jobs)
    assert all(m.failure is None for m in found)
    return [m.tool for m in found]


def size(record: Array) -> float:
    return float(np.sqrt(np.mean(record**2)))


def test_a_seat_that_nothing_opens_leaves_the_other_as_it_is_alone(arm: Arm) -> None:
    loose, shut = slide(1, friction=0.5), play(2, friction=1e6)
    alone, beside, both = records(
        arm, [loose, SeveralFaults(faults=(loose, shut)), SeveralFaults(faults=(loose, play(2)))]
    )
    start = slice(0, 60)  # later on, strikes of the stops magnify the last digits
    assert size(beside[:, start] - alone[:, start]) < 0.03 * size(alone[:, start])
    assert size(both[:, start] - alone[:, start]) > 0.05 * size(alone[:, start])


def test_records_do_not_depend_on_what_stands_in_other_slots(arm: Arm) -> None:
    fault = SeveralFaults(faults=(slide(1), play(2)))
    across = CompoundLooseness(link=2, parts=(slide(2), rocking(2)))
    (alone,) = records(arm, [fault])
    mixed = records(arm, [Healthy(), fault, across, slide(2)])
    np.testing.assert_array_equal(mixed[1], alone)


def test_stops_that_are_slow_enough_alone_may_be_refused_together() -> None:
    arm = planar(3)
    alone = [slide(k, direction=(0, 1, 0), stiffness=(1.0, 1.0)) for k in (1, 2, 3)]
    firm: list[LooseFault] = []
    for fault in alone:
        model = plant_of(arm, fault).model
        weight = float(model.tendon_invweight0[model.tendon("seat_low").id])
        most = 0.99 * (1.4 / arm.timestep) ** 2 / weight
        firm.append(replace(fault, stiffness=(most, most)))
        plant_of(arm, firm[-1])
    with pytest.raises(InvalidSetting, match=r"too fast for a step|too stiff together"):
        plant_of(arm, SeveralFaults(faults=tuple(firm)))


@pytest.mark.parametrize("load", [20.0, -3.5])
def test_a_preload_is_a_constant_force_on_the_seat(arm: Arm, load: float) -> None:
    for fault in (slide(2, preload=load), play(1, preload=load), rocking(2, preload=load)):
        plant = plant_of(arm, fault)
        data, dof = at_pose(plant, pose_of(arm)), int(plant.model.joint("seat").dofadr[0])
        for place in (-0.5, 0.0, 0.5):
            data.qpos[plant.seat_positions] = place * fault.gap
            mujoco.mj_forward(plant.model, data)
            assert data.qfrc_passive[dof] == pytest.approx(load, rel=1e-6)


def settled(plant: Plant, pose: Array, push: float) -> float:
    """Where a seat comes to rest under a further force on it [m or rad]."""
    data, dof = at_pose(plant, pose), int(plant.model.joint("seat").dofadr[0])
    data.qfrc_applied[dof] = push
    for _ in range(round(1.0 / plant.model.opt.timestep)):
        mujoco.mj_step(plant.model, data)
    assert abs(data.qvel[dof]) < 1e-5
    return float(data.qpos[plant.seat_positions[0]])


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
        parts += [slide(link), rocking(link), play(link)]
    for part in parts:
        plant = plant_of(arm, part)
        data, dof = mujoco.MjData(plant.model), int(plant.model.joint("seat").dofadr[0])
        forces = []
        for axis in np.eye(3):
            plant.model.opt.gravity[:] = 9.81 * axis
            mujoco.mj_forward(plant.model, data)
            forces.append(data.qfrc_bias[dof])
        assert seat_weight(arm, part) == pytest.approx(float(np.linalg.norm(forces)), rel=1e-9)


def test_every_loose_seat_of_a_fault_is_pressed() -> None:
    arm = planar(3)
    cross = CompoundLooseness(link=1, parts=(slide(1), rocking(1)))
    for fault in (slide(2), play(3), rocking(1), cross, SeveralFaults(faults=(cross, play(2)))):
        pressed = preloaded(arm, fault, 0.5)
        assert type(pressed) is type(fault)
        for before, after in zip(parts_of(fault), parts_of(pressed), strict=True):
            assert after == replace(before, preload=0.5 * seat_weight(arm, before))  # type: ignore[type-var,call-arg]
    tight = Preload(link=1, direction=(1, 0, 0), stiffness=1e6)
    assert preloaded(arm, tight, 1.0) is tight and preloaded(arm, Healthy(), 1.0) == Healthy()
